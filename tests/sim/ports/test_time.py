"""A simulator that stands still, or whose time passes faster or slower than the program's."""

from __future__ import annotations

import asyncio
import json
import re
import signal
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

import m100link
from m100link import AckTimeout, Aircraft, AuthorityState, TelemetryStalled
from m100link.sim import DEMO_APP_ID, DEMO_KEY
from tests.rig import NORTH
from tests.waiting import PATIENCE, until

pytestmark = [pytest.mark.anyio, pytest.mark.pty]


@asynccontextmanager
async def simulated(*options: str) -> AsyncIterator[tuple[Aircraft, asyncio.subprocess.Process]]:
    """An activated aircraft of a simulator in another process."""
    simulator = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "m100link", "sim", "--json", "--seed", "1", *options),
        stdout=asyncio.subprocess.PIPE,
    )
    assert simulator.stdout is not None
    try:
        async with asyncio.timeout(PATIENCE):
            url = json.loads(await simulator.stdout.readline())["port"]
            async with m100link.connect(url, timeout=30.0) as aircraft:
                credentials = m100link.Credentials(app_id=DEMO_APP_ID, key=DEMO_KEY)
                await aircraft.activate(credentials)
                await until(lambda: aircraft.state.position is not None)
                yield aircraft, simulator
    finally:
        simulator.send_signal(signal.SIGCONT)
        simulator.terminate()
        await simulator.wait()


async def test_while_it_stands_still_nothing_is_claimed_that_is_not_so() -> None:
    """It is stopped in flight, and goes on: it did not age, and hovers."""
    async with simulated() as (aircraft, simulator):
        height = 0.0

        async def fly() -> None:
            async with aircraft.control() as control:
                await control.take_off()
                simulator.send_signal(signal.SIGSTOP)
                async for _ in control.ticks():
                    control.send(NORTH)

        with pytest.raises(TelemetryStalled):
            await fly()
        assert aircraft.authority.state is not AuthorityState.HELD
        age = aircraft.state.newest_age
        assert age is not None
        assert age > 1.0
        told = re.findall(r"telemetry (\S+) s old", repr(aircraft))
        assert float(told[0]) >= round(age, 2)  # it grows older while the test looks
        with pytest.raises(AckTimeout) as caught:
            await aircraft.version()
        assert "nothing has come from the aircraft for" in caught.value.cause
        position = aircraft.state.position
        assert position is not None
        height = position.height_m

        simulator.send_signal(signal.SIGCONT)
        await until(lambda: (aircraft.state.newest_age or PATIENCE) < 0.5)
        assert (await aircraft.version()).is_activated
        await until(lambda: _speed(aircraft) < 0.2)
        position = aircraft.state.position
        assert position is not None
        assert abs(position.height_m - height) < 0.5, "no time passed for it"
        assert aircraft.statistics().discards == {}
        assert aircraft.telemetry_mismatches == 0
        assert aircraft.device_clock.uncertainty_s > 0.5, "its clock stood still: not to be trusted"


@pytest.mark.parametrize("speed", [1.25, 0.5])  # what runs much faster is late on a busy machine
async def test_at_another_speed_everything_works_and_the_clock_is_not_trusted(speed: float) -> None:
    async with simulated("--speed", str(speed)) as (aircraft, _):
        async with aircraft.telemetry() as samples:
            begun = asyncio.get_running_loop().time()
            for _ in range(100):
                await anext(samples)
            rate = 100 / (asyncio.get_running_loop().time() - begun)
        assert rate < 100 * speed * 1.5
        assert aircraft.device_clock.uncertainty_s > 0.1
        async with aircraft.control() as control:
            await control.take_off()
            async for tick in control.ticks():
                if tick.elapsed > 1.0:
                    break
                control.send(NORTH)
            assert _speed(aircraft) > 0.3
            await control.land()
        assert aircraft.statistics().discards == {}
        assert aircraft.telemetry_mismatches == 0


def _speed(aircraft: Aircraft) -> float:
    velocity = aircraft.state.velocity
    assert velocity is not None
    return max(abs(velocity.north_m_s), abs(velocity.east_m_s))
