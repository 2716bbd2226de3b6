"""Device tick to host time: offset, skew, uncertainty; wrap, reboot and late packages."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
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
    assert math.isinf(clock.uncertainty_s)


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


def test_the_rate_is_that_of_the_last_minute() -> None:
    """A crystal that warms up: 80 ppm since a minute and a half, and none before."""
    clock = DeviceClock(TICK_HZ)
    run(clock, seconds=90)
    run(clock, seconds=90, skew=80e-6, offset=1090.0, start_tick=90 * TICK_HZ)
    assert clock.resets == 0
    assert clock.skew_ppm == pytest.approx(80, abs=3)
    [inside] = [one.uncertainty_s for one in [clock.host_time(150 * TICK_HZ)] if one is not None]
    assert inside == pytest.approx(1 / TICK_HZ, abs=3e-5)


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
    run(clock, seconds=30, start_tick=50 * TICK_HZ)
    run(clock, seconds=10, offset=1035.0, start_tick=2 * TICK_HZ)
    assert clock.resets == 1
    assert clock.offset_s == pytest.approx(1033.0, abs=0.03)
    found = clock.host_time(5 * TICK_HZ)
    assert found is not None
    assert found.time == pytest.approx(1038.0, abs=0.03)


@pytest.mark.parametrize("ticks", [1, 300, TICK_HZ * 60])
@pytest.mark.parametrize("seconds", [0.5, 30])
def test_a_step_back_is_one_even_before_a_delay_is_known(seconds: float, ticks: int) -> None:
    """Half of the range of 32 bits is ahead, the other half behind."""
    clock = DeviceClock(TICK_HZ)
    run(clock, seconds=seconds, start_tick=100 * TICK_HZ)
    last = 100 * TICK_HZ + round((seconds - 0.02) * TICK_HZ)
    clock.update(last - ticks, 1000.0 + seconds)
    assert clock.resets == 1
    found = clock.host_time(last - ticks)
    assert found is not None
    assert found.time == pytest.approx(1000.0 + seconds, abs=0.001)


def test_a_tick_that_stands_still_breaks_nothing() -> None:
    """Packages of a device whose clock has stopped: nothing is known of the time any more."""
    clock = DeviceClock(TICK_HZ)
    run(clock, seconds=10)
    for index in range(60 * 50):
        clock.update(TICK_HZ * 10, 1010.0 + index / 50)
        assert clock.host_time(TICK_HZ * 10) is not None
    assert clock.uncertainty_s > 0
    stuck = DeviceClock(TICK_HZ)
    for index in range(60 * 50):
        stuck.update(7, 1000.0 + index / 50)
    assert stuck.skew_ppm == 0


def test_a_stall_of_the_line_is_no_reboot() -> None:
    clock = DeviceClock(TICK_HZ)
    run(clock, seconds=10)
    clock.update(20 * TICK_HZ, 1020.0)
    assert clock.resets == 0


# -- blocks, bursts and steps ----------------------------------------------------------------------

FIRST_DELAY_S = 0.006  # the constant part of every delay, which no clock can see from one side


@dataclass
class World:
    """An aircraft, a line and a host, of which the truth is known.

    A package is taken at ``device``, arrives after a delay that is never below the constant part
    and never overtakes, and is read when the host is not blocked.

    Attributes:
        rate_hz: Packages per second.
        skew: How much faster the host clock runs, parts.
        jitter: The next variable part of a delay, s.
        blocks: From when to when the host reads nothing, host seconds since the start.
        steps: By how much the device clock jumps, and when.
        kept: Packages that are kept for a blocked host; newer ones are lost. None: all.
        chunk: Packages that one read takes from what is waiting; one read takes a millisecond.
    """

    rate_hz: int = 50
    skew: float = 0.0
    jitter: Callable[[], float] = lambda: 0.0
    blocks: Sequence[tuple[float, float]] = ()
    steps: Sequence[tuple[float, float]] = ()
    kept: int | None = None
    chunk: int | None = None

    def packages(self, seconds: float) -> Iterator[tuple[float, float, float]]:
        """Host time since the start of taking and of arriving, and the device clock, s."""
        last = 0.0
        for index in range(round(seconds * self.rate_hz)):
            taken = index / self.rate_hz
            last = max(last, taken + FIRST_DELAY_S + self.jitter())
            device = taken / (1 + self.skew) + sum(by for at, by in self.steps if at <= taken)
            yield taken, last, 86_400.0 + device  # since a day: a rate shows

    def reads(self, seconds: float) -> Iterator[tuple[float, list[tuple[float, float]]]]:
        """Each read of the host: when, and its packages as time of taking and device clock."""
        waiting: dict[float, list[tuple[float, float]]] = {}
        for taken, arrived, device in self.packages(seconds):
            end = max((end for start, end in self.blocks if start <= arrived < end), default=None)
            read_at = arrived if end is None else end
            packages = waiting.setdefault(read_at, [])
            if end is None or self.kept is None or len(packages) < self.kept:
                packages.append((taken, device))
        busy_until = 0.0
        for at, packages in sorted(waiting.items()):
            size = self.chunk or len(packages)
            for first in range(0, len(packages), size):
                busy_until = max(at, busy_until + 0.001)
                yield busy_until, packages[first : first + size]


def tick_of(device: float) -> int:
    return math.floor(device * TICK_HZ + 1e-6)


def errors_beyond_the_bound(world: World, seconds: float) -> list[str]:
    """What the clock states after each read, held against the truth."""
    clock = DeviceClock(TICK_HZ)
    wrong = []
    started = 5000.0
    history: list[tuple[float, int]] = []
    for at, packages in world.reads(seconds):
        for taken, device in packages:
            tick = tick_of(device)
            if history and any(history[-1][0] < step <= taken for step, _ in world.steps):
                history.clear()  # ticks of before the step are those of another clock
            history.append((taken, tick))
            clock.update(tick, started + at)
        for taken, tick in (history[-1], history[len(history) // 2]):
            found = clock.host_time(tick)
            assert found is not None
            error = found.time - (started + taken + FIRST_DELAY_S)
            if abs(error) > found.uncertainty_s:
                wrong.append(f"{at:.3f} s: {error:+.4f} beyond {found.uncertainty_s:.4f}")
    return wrong


def settled_uncertainty(world: World, seconds: float) -> float:
    clock = DeviceClock(TICK_HZ)
    for at, packages in world.reads(seconds):
        for _, device in packages:
            clock.update(tick_of(device), at)
    return clock.uncertainty_s


@pytest.mark.parametrize("chunk", [None, 40, 1])
@pytest.mark.parametrize("kept", [None, 20])
def test_a_blocked_host_does_not_take_what_waited_for_fresh(
    kept: int | None, chunk: int | None
) -> None:
    world = World(blocks=[(20.0, 24.0)], kept=kept, chunk=chunk)
    assert errors_beyond_the_bound(world, 40.0) == []
    assert settled_uncertainty(world, 40.0) <= 3 / TICK_HZ


@pytest.mark.parametrize("chunk", [None, 40, 1])
@pytest.mark.parametrize("kept", [None, 20])
def test_a_burst_at_the_start_is_not_believed(kept: int | None, chunk: int | None) -> None:
    world = World(blocks=[(0.0, 4.0)], kept=kept, chunk=chunk)
    assert errors_beyond_the_bound(world, 20.0) == []
    assert settled_uncertainty(world, 20.0) <= 3 / TICK_HZ


@pytest.mark.parametrize("by", [0.5, -0.5, 0.1, -0.1, 3.0])
@pytest.mark.parametrize("at", [15.0, 15.55])
@pytest.mark.parametrize("blocks", [[], [(15.2, 15.9)]])
def test_a_step_of_the_device_clock_is_noticed_both_ways(
    by: float, at: float, blocks: list[tuple[float, float]]
) -> None:
    world = World(steps=[(at, by)], blocks=blocks)
    assert errors_beyond_the_bound(world, 30.0) == []
    clock = DeviceClock(TICK_HZ)
    for read_at, packages in world.reads(30.0):
        for _, device in packages:
            clock.update(tick_of(device), read_at)
    assert clock.resets == 1
    assert clock.uncertainty_s <= 3 / TICK_HZ


def test_a_step_back_that_a_gap_hides_is_noticed() -> None:
    """The tick goes on rising; only that every package is late from then on tells of it."""
    clock = DeviceClock(TICK_HZ)
    run(clock, seconds=20)
    for index in range(20 * 50):
        device = 22.0 + index / 50  # two seconds later, and the clock half a second back
        clock.update(round((device - 0.5) * TICK_HZ), 1000.0 + device)
        found = clock.host_time(round((device - 0.5) * TICK_HZ))
        assert found is not None
        assert abs(found.time - (1000.0 + device)) <= found.uncertainty_s
    assert clock.resets == 1
    assert clock.uncertainty_s <= 3 / TICK_HZ


@pytest.mark.parametrize(("seconds", "resets"), [(1, 0), (4, 0), (8, 1)])
def test_packages_that_are_late_for_five_seconds_show_a_step_and_before_that_none(
    seconds: int, resets: int
) -> None:
    """By 40 ms, which nothing that waits in the line explains."""
    clock = DeviceClock(TICK_HZ)
    run(clock, seconds=20)
    for index in range(seconds * 50):
        device = 20.0 + index / 50
        clock.update(round(device * TICK_HZ), 1000.04 + device)
    assert clock.resets == resets
    assert clock.offset_s == pytest.approx(1000.04 if resets else 1000.0, abs=2 / TICK_HZ)


def test_a_second_that_was_late_from_end_to_end_is_left_out_and_no_other() -> None:
    """The bound grows by 5 ms over the 4 ms and a tick; the host's clock is 150 ppm slower."""
    clock = DeviceClock(TICK_HZ)
    for index in range(30 * 50):
        late = 0.004 * (index % 3 > 0) if index < 20 * 50 else 0.005 if index < 1075 else 0.0
        clock.update(TICK_HZ * 100 + index * 12, 1000.0 + index / 50 * (1 - 150e-6) + late)
    early, newer = clock.host_time(TICK_HZ * 101), clock.host_time(TICK_HZ * 128)
    assert early is not None
    assert newer is not None
    assert early.time == pytest.approx(1001.0 - 150e-6, abs=1e-6)
    assert early.uncertainty_s == pytest.approx(newer.uncertainty_s, abs=1e-9)
    assert newer.uncertainty_s < 0.005


def test_packages_of_one_read_are_one_instant() -> None:
    """What waited in one read says as much about delay as its last package."""
    one, many = DeviceClock(TICK_HZ), DeviceClock(TICK_HZ)
    for index in range(1000):
        now = 50.0 + index * 0.1
        for device in (now - 0.08, now - 0.06, now - 0.04, now - 0.02, now):
            many.update(round(device * TICK_HZ), now)
        one.update(round(now * TICK_HZ), now)
    assert many.offset_s == pytest.approx(one.offset_s, abs=1e-6)
    assert many.uncertainty_s == pytest.approx(one.uncertainty_s, abs=1e-4)


@pytest.mark.parametrize("seed", range(40))
def test_the_truth_is_within_the_bound_whatever_the_line_and_the_host_do(seed: int) -> None:
    random = Random(seed)
    scale = random.choice([0.0, 0.0005, 0.003, 0.01])
    jitters: list[Callable[[], float]] = [
        lambda: random.uniform(0.0, 2 * scale),
        lambda: random.expovariate(1 / scale) if scale else 0.0,
        lambda: random.gammavariate(2.0, scale / 2) if scale else 0.0,
    ]
    blocks, at = [], 0.0
    while at < 90.0:
        length = random.choice([0.05, 0.3, 1.0, 4.0]) * random.random()
        blocks.append((at, at + length))
        at += length + random.choice([0.2, 2.0, 20.0]) * random.random()
    steps = [
        (random.uniform(*within), random.choice([-1, 1]) * random.uniform(0.3, 2.0))
        for within in ((10, 40), (55, 80))[: random.randrange(3)]
    ]
    world = World(
        rate_hz=random.choice([10, 50, 100]),
        skew=random.uniform(-100e-6, 100e-6),
        jitter=random.choice(jitters),
        blocks=blocks,
        steps=steps,
        kept=random.choice([None, 20]),
        chunk=random.choice([None, 1, 40]),
    )
    assert errors_beyond_the_bound(world, 90.0) == [], world
    calm = World(rate_hz=world.rate_hz, skew=world.skew, jitter=world.jitter)
    assert settled_uncertainty(calm, 60.0) <= 3 / TICK_HZ + 4 * scale


@pytest.mark.parametrize("seed", range(10))
def test_what_it_says_does_not_depend_on_how_often_it_is_asked(seed: int) -> None:
    """Packages are noted, and looked at together or when somebody asks."""
    random = Random(seed)
    world = World(
        rate_hz=random.choice([10, 50, 100]),
        skew=50e-6,
        jitter=lambda: random.expovariate(500),
        blocks=[(5.0, 5.6), (30.2, 31.0)],
        steps=[(12.0, 0.4), (21.0, -0.4)],
        chunk=random.choice([None, 40]),
    )
    clocks = DeviceClock(TICK_HZ), DeviceClock(TICK_HZ)
    for read_at, packages in world.reads(40.0):
        tick = 0
        for _, device in packages:
            tick = tick_of(device)
            for clock in clocks:
                clock.update(tick, read_at)
            assert clocks[0].uncertainty_s >= 0
        if random.random() < 0.01:
            for ask in ("offset_s", "skew_ppm", "uncertainty_s", "resets"):
                assert getattr(clocks[0], ask) == getattr(clocks[1], ask)
            assert clocks[0].host_time(tick) == clocks[1].host_time(tick)
    assert clocks[0].host_time(0) == clocks[1].host_time(0)
    assert clocks[0].resets == clocks[1].resets == 2


def test_an_estimate_far_from_the_last_package_is_less_certain() -> None:
    clock = DeviceClock(TICK_HZ)
    run(clock, seconds=30)
    near, far = clock.host_time(TICK_HZ * 31), clock.host_time(TICK_HZ * 3600)
    assert near is not None
    assert far is not None
    assert near.uncertainty_s < 0.004
    assert 0.01 < far.uncertainty_s < 1.0
    # The line may be off by its own width at both ends of its 29 s, in opposite directions.
    [inside] = {one.uncertainty_s for one in [clock.host_time(TICK_HZ * 15)] if one is not None}
    slope = (far.uncertainty_s - near.uncertainty_s) / (3600 - 31)
    assert slope == pytest.approx(2 * inside / 29, rel=0.05)


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
