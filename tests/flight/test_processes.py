"""How the aircraft fares when the program that flies it is interrupted, terminated or killed.

Real processes, a real pseudo-terminal, real time; the aircraft lives in the test.
"""

from __future__ import annotations

import asyncio
import signal
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from m100link import FlightPhase
from m100link.protocol.records import Device
from m100link.sim import Driver, PtyPort, VirtualAircraft
from m100link.sim.vehicle.mobile import Grant
from tests.rig import TimedMoves
from tests.waiting import PATIENCE, until

pytestmark = [pytest.mark.pty, pytest.mark.anyio]

ROOT = Path(__file__).parent.parent.parent


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"  # real time


class Flight:
    """A process in the middle of a flight, and the aircraft that it flies."""

    def __init__(self, virtual: VirtualAircraft, process: asyncio.subprocess.Process) -> None:
        self.virtual = virtual
        self.process = process
        self.moves = TimedMoves()
        virtual.autopilot.received_movements = self.moves

    @property
    def last_values(self) -> list[tuple[float, ...]]:
        """Values of the last five movements: the neutral lasts 0.3 s, which is 15 at best."""
        return [
            (move.roll_or_x, move.pitch_or_y, move.throttle_or_z, move.yaw)
            for move in list(self.moves)[-5:]
        ]

    async def end(self, *signals: signal.Signals, pause: float = 0.1) -> int:
        """Send the signals, wait for the process and its last bytes, return its status."""
        for number in signals:
            self.process.send_signal(number)
            await asyncio.sleep(pause)
        async with asyncio.timeout(PATIENCE):
            status = await self.process.wait()
        await asyncio.sleep(0.2)
        return status

    async def assert_hovers(self) -> None:
        count = len(self.moves)
        motion = self.virtual.vehicle.flight.dynamics
        await until(lambda: motion.speed < 0.1)
        await asyncio.sleep(0.5)
        assert motion.speed < 0.1
        assert abs(motion.velocity_up) < 0.05
        assert motion.height > 0.8
        assert self.virtual.vehicle.flight.phase is FlightPhase.IN_AIR
        assert len(self.moves) == count


def put_in_the_air(virtual: VirtualAircraft) -> None:
    """Activated before and hovering at 2 m: saves seconds of real time per test."""
    app = virtual.credentials
    known = virtual.vehicle.activation.known
    known[app.app_id] = Grant(app.app_id, app.key, app.level)
    flight = virtual.vehicle.flight
    flight.start_motors()
    flight.dynamics.place(0.0, 0.0, 2.0)
    flight.phase = FlightPhase.IN_AIR


@asynccontextmanager
async def flight(*, stop: str = "hover", firmware: str = "1.0") -> AsyncIterator[Flight]:
    """An aircraft behind a pseudo-terminal, flown north by a process of its own."""
    virtual = VirtualAircraft(seed=1, firmware=firmware)
    put_in_the_air(virtual)
    driver = Driver(virtual)
    port = PtyPort(driver)
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        *("-W", "error", "-m", "tests.flight.flying_program", port.name, stop),
        cwd=ROOT,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    try:
        assert process.stdout is not None
        async with asyncio.timeout(PATIENCE):
            said = await process.stdout.readline()
        if said != b"flying\n":
            assert process.stderr is not None
            pytest.fail(f"it does not fly: {(await process.stderr.read()).decode()}")
        flown = Flight(virtual, process)
        await until(lambda: len(flown.moves) > 30)
        await until(lambda: virtual.vehicle.flight.dynamics.speed > 0.5)
        yield flown
    finally:
        if process.returncode is None:
            process.kill()
        await process.communicate()
        driver.stop()


async def test_sigint_stops_releases_and_ends_with_keyboard_interrupt() -> None:
    async with flight() as flown:
        status = await flown.end(signal.SIGINT)
        assert status in (130, -signal.SIGINT)  # Python ends by SIGINT itself
        assert set(flown.last_values) == {(0.0, 0.0, 0.0, 0.0)}
        assert flown.virtual.vehicle.authority.device is Device.RC
        await flown.assert_hovers()


async def test_a_second_sigint_does_not_break_the_stop_path() -> None:
    async with flight(firmware="3.1") as flown:
        await flown.end(signal.SIGINT, signal.SIGINT, pause=0.05)
        assert set(flown.last_values) == {(0.0, 0.0, 0.0, 0.0)}
        assert flown.virtual.vehicle.authority.device is Device.RC
        await flown.assert_hovers()


@pytest.mark.parametrize(
    ("firmware", "number"),
    [("1.0", signal.SIGTERM), ("3.1", signal.SIGTERM), ("2.3", signal.SIGHUP)],
)
async def test_a_signal_stops_releases_and_then_ends_as_it_was_meant(
    firmware: str, number: signal.Signals
) -> None:
    async with flight(firmware=firmware) as flown:
        status = await flown.end(number)
        assert status == -number
        assert set(flown.last_values) == {(0.0, 0.0, 0.0, 0.0)}
        assert flown.virtual.vehicle.authority.device is Device.RC
        await flown.assert_hovers()


async def test_sigterm_lands_first_where_the_program_wants_it_even_if_sent_twice() -> None:
    async with flight(stop="land") as flown:
        status = await flown.end(signal.SIGTERM, signal.SIGTERM, pause=0.5)
        assert status == -signal.SIGTERM
        assert flown.virtual.height == 0.0
        assert not flown.virtual.vehicle.flight.dynamics.motors_on
        assert flown.virtual.vehicle.authority.device is Device.RC


async def test_after_sigkill_nothing_is_sent_and_the_aircraft_hovers() -> None:
    async with flight() as flown:
        status = await flown.end(signal.SIGKILL)
        assert status == -signal.SIGKILL
        # Nobody could send a neutral: the last frame is the last setpoint, and then silence.
        assert flown.last_values[-1] == (2.0, 0.0, 0.0, 0.0)
        assert flown.virtual.vehicle.authority.device is Device.ONBOARD
        await flown.assert_hovers()
