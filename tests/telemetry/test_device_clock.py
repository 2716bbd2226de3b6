"""Device tick to host time: offset, skew, uncertainty; wrap, reboot and late packages."""

from __future__ import annotations

from random import Random

import pytest

from m100link.protocol.records import Time
from m100link.telemetry.device_clock import DeviceClock
from tests.rig import FIRMWARES, rig

TICK_HZ = 600


def run(
    clock: DeviceClock,
    *,
    seconds: float,
    offset: float = 1000.0,
    skew: float = 0.0,
    start_tick: int = 0,
    jitter: float = 0.0,
    seed: int = 1,
) -> None:
    """Feed packages at 50 Hz; the host clock runs faster by ``skew`` parts, each is late by chance.

    The delay is never negative and is exponential: most packages are early, some very late.
    """
    random = Random(seed)
    for index in range(round(seconds * 50)):
        device = index / 50
        tick = (start_tick + round(device * TICK_HZ)) % (1 << 32)
        late = random.expovariate(1 / jitter) if jitter else 0.0
        clock.update(tick, offset + device * (1 + skew) + late)


def test_before_the_first_package_it_knows_nothing() -> None:
    clock = DeviceClock(TICK_HZ)
    assert clock.offset_s is None
    assert clock.host_time(0) is None
    assert clock.uncertainty_s >= 0.02


def test_without_jitter_the_offset_is_exact_within_a_tick() -> None:
    clock = DeviceClock(TICK_HZ)
    run(clock, seconds=30)
    found = clock.host_time(TICK_HZ * 10)
    assert found is not None
    assert found.time == pytest.approx(1010.0, abs=1 / TICK_HZ)
    assert found.uncertainty_s <= 2 / TICK_HZ


@pytest.mark.parametrize("ppm", [-80, 0, 80])
@pytest.mark.parametrize("seed", range(4))
def test_skew_is_found_under_jitter_and_the_truth_lies_within_the_uncertainty(
    ppm: float, seed: int
) -> None:
    clock = DeviceClock(TICK_HZ)
    run(clock, seconds=60, skew=ppm * 1e-6, jitter=0.003, seed=seed)
    assert clock.skew_ppm == pytest.approx(ppm, abs=15)
    for device in (20.0, 40.0, 59.0):
        found = clock.host_time(round(device * TICK_HZ))
        assert found is not None
        truth = 1000.0 + device * (1 + ppm * 1e-6)
        assert abs(found.time - truth) <= found.uncertainty_s
    assert clock.uncertainty_s < 0.01


def test_the_tick_wraps_without_a_jump() -> None:
    clock = DeviceClock(TICK_HZ)
    start = (1 << 32) - 10 * TICK_HZ
    run(clock, seconds=30, start_tick=start)
    assert clock.resets == 0
    before, after = clock.host_time(start), clock.host_time(10 * TICK_HZ)
    assert before is not None
    assert after is not None
    assert before.time == pytest.approx(1000.0, abs=0.005)
    assert after.time == pytest.approx(1020.0, abs=0.005)


def test_a_reboot_starts_anew_and_is_counted() -> None:
    clock = DeviceClock(TICK_HZ)
    run(clock, seconds=30)
    run(clock, seconds=10, offset=1035.0)
    assert clock.resets == 1
    found = clock.host_time(5 * TICK_HZ)
    assert found is not None
    assert found.time == pytest.approx(1040.0, abs=0.03)


def test_a_stall_of_the_line_is_no_reboot() -> None:
    clock = DeviceClock(TICK_HZ)
    run(clock, seconds=10)
    clock.update(20 * TICK_HZ, 1020.0)
    assert clock.resets == 0


@pytest.mark.anyio
@pytest.mark.parametrize("firmware", FIRMWARES)
async def test_over_the_line_with_each_firmwares_own_tick(firmware: str) -> None:
    async with rig(activated=False, firmware=firmware) as flown:
        async with flown.aircraft.telemetry(Time) as samples:
            sample = await anext(samples)
            while flown.now < 10.0:
                sample = await anext(samples)
        clock = flown.aircraft.device_clock
        assert clock.tick_hz == (400 if firmware == "3.1" else 600)
        found = clock.host_time(sample[Time].tick)
        assert found is not None
        assert abs(found.time - sample.received_at) <= found.uncertainty_s
        assert clock.resets == 0
