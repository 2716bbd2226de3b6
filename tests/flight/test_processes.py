"""How the aircraft fares when the program that flies it is interrupted, terminated or killed.

Real processes, a real pseudo-terminal, real time; the aircraft lives in the test.
"""

from __future__ import annotations

import asyncio
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path

import pytest

import m100link
from m100link import FlightPhase, GuardRefused
from m100link.protocol.records import Device
from m100link.sim import Driver, PtyPort, VirtualAircraft
from tests.flight import foreign_aircraft as foreign
from tests.flight.foreign_aircraft import ForeignAircraft, foreign_aircraft
from tests.flight.guarded_program import guardian_of
from tests.rig import FIRMWARES, NORTH, TimedMoves, put_in_the_air
from tests.waiting import PATIENCE, until

pytestmark = [pytest.mark.pty, pytest.mark.anyio]

ROOT = Path(__file__).parent.parent.parent
NEUTRAL, FLOWN = (0.0, 0.0, 0.0, 0.0), (2.0, 0.0, 0.0, 0.0)


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
    def values(self) -> list[tuple[float, ...]]:
        """Values of all movements."""
        return [
            (move.roll_or_x, move.pitch_or_y, move.throttle_or_z, move.yaw) for move in self.moves
        ]

    def assert_neutral_was_the_last_word(self) -> None:
        """After the first neutral nothing else came; on a busy machine one may be all there is."""
        values = self.values
        first = values.index(NEUTRAL)
        assert set(values[:first]) == {FLOWN}
        assert set(values[first:]) == {NEUTRAL}

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


@pytest.mark.smoke
async def test_sigint_stops_releases_and_ends_with_keyboard_interrupt() -> None:
    async with flight() as flown:
        status = await flown.end(signal.SIGINT)
        assert status in (130, -signal.SIGINT)  # Python ends by SIGINT itself
        flown.assert_neutral_was_the_last_word()
        assert flown.virtual.vehicle.authority.device is Device.RC
        await flown.assert_hovers()


async def test_a_second_sigint_does_not_break_the_stop_path() -> None:
    async with flight(firmware="3.1") as flown:
        await flown.end(signal.SIGINT, signal.SIGINT, pause=0.05)
        flown.assert_neutral_was_the_last_word()
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
        flown.assert_neutral_was_the_last_word()
        assert flown.virtual.vehicle.authority.device is Device.RC
        await flown.assert_hovers()


async def test_sigterm_lands_first_where_the_program_wants_it_even_if_sent_twice() -> None:
    async with flight(stop="land") as flown:
        status = await flown.end(signal.SIGTERM, signal.SIGTERM, pause=0.5)
        assert status == -signal.SIGTERM
        assert flown.virtual.height == 0.0
        assert not flown.virtual.vehicle.flight.dynamics.motors_on
        assert flown.virtual.vehicle.authority.device is Device.RC


@pytest.mark.smoke
async def test_after_sigkill_the_guardian_stops_it_and_gives_authority_back() -> None:
    async with flight() as flown:
        status = await flown.end(signal.SIGKILL)
        assert status == -signal.SIGKILL
        await until(lambda: flown.virtual.vehicle.authority.device is Device.RC)
        flown.assert_neutral_was_the_last_word()
        await flown.assert_hovers()


async def test_after_sigkill_the_guardian_lands_where_the_program_wants_it() -> None:
    async with flight(stop="land", firmware="3.1") as flown:
        await flown.end(signal.SIGKILL)
        await until(lambda: flown.virtual.height == 0.0)
        await until(lambda: not flown.virtual.vehicle.flight.dynamics.motors_on)
        flown.assert_neutral_was_the_last_word()


# -- against an aircraft that shares no line with the library --------------------------------------


@contextmanager
def foreign_flight(
    program: str, firmware: str, *others: str
) -> Iterator[tuple[ForeignAircraft, subprocess.Popen[bytes]]]:
    """The foreign aircraft, flown by a process, which may fly others beside it."""
    with foreign_aircraft(firmware) as there:
        ports = there.name, *others
        command = (sys.executable, "-m", "tests.flight.foreign_programs", program, *ports)
        with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE) as process:
            try:
                yield there, process
            finally:
                if process.poll() is None:
                    process.kill()


def assert_given_back(there: ForeignAircraft) -> None:
    """Neutral was the last word, then the release; all of it was obeyed."""
    assert there.device == foreign.RC
    assert there.releases >= 1
    assert all(movement.is_obeyed for movement in there.movements)
    speeds = [movement.values[0] for movement in there.movements]
    assert 2.0 in speeds
    # Fifteen in 0.3 s, which tests on virtual time count; a busy machine sends fewer, and lets a
    # setpoint expire in flight.
    assert speeds[-1] == 0.0


@pytest.mark.parametrize("firmware", FIRMWARES)
@pytest.mark.parametrize("pauses", [(0.03, 0.03), (0.0, 0.0), (0.15, 0.1, 0.02, 0.02)], ids=str)
def test_any_number_of_ctrl_c_gives_the_foreign_aircraft_back(
    firmware: str, pauses: tuple[float, ...]
) -> None:
    """Three within 0.1 s, and some in the stop path; once a program hung for 80 s after that."""
    with foreign_flight("loop", firmware) as (there, process):
        there.wait_for("movements", 25, timeout=PATIENCE)
        process.send_signal(signal.SIGINT)
        for pause in pauses:
            time.sleep(pause)
            process.send_signal(signal.SIGINT)
        assert process.wait(timeout=PATIENCE) in (130, -signal.SIGINT)
        assert_given_back(there)
        assert process.stdout is not None
        assert b"went on" not in process.stdout.read()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_one_signal_gives_both_foreign_aircraft_of_a_program_back(number: signal.Signals) -> None:
    with foreign_aircraft("3.1") as second:
        with foreign_flight("loop", "1.0", second.name) as (first, process):
            for there in (first, second):
                there.wait_for("movements", 25, timeout=PATIENCE)
            process.send_signal(number)
            assert process.wait(timeout=PATIENCE) in (-number, 128 + number)
            assert_given_back(first)
        assert_given_back(second)


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_a_generator_that_breaks_gives_the_foreign_aircraft_back(firmware: str) -> None:
    with foreign_flight("generator", firmware) as (there, process):
        assert process.wait(timeout=PATIENCE) == 0
        assert_given_back(there)
        assert process.stdout is not None
        assert b"entered again" in process.stdout.read()


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_leaving_connect_gives_the_foreign_aircraft_back_before_the_line_closes(
    firmware: str,
) -> None:
    with foreign_flight("task", firmware) as (there, process):
        process.wait(timeout=PATIENCE)
        assert_given_back(there)


@pytest.mark.parametrize("firmware", FIRMWARES)
@pytest.mark.parametrize("program", ["group", "dropped", "stopped", "blocks"])
def test_a_program_that_ends_oddly_gives_the_foreign_aircraft_back(
    firmware: str, program: str
) -> None:
    """A sibling fails, a generator is collected, the loop stops, or blocks begin to the end."""
    with foreign_flight(program, firmware) as (there, process):
        process.wait(timeout=PATIENCE)
        assert_given_back(there)
        assert process.stdout is not None
        assert b"went on" not in process.stdout.read()


@pytest.mark.parametrize("latitude", [math.nan, 89.5, math.inf])
def test_an_impossible_position_of_the_foreign_aircraft_leaves_no_authority_behind(
    latitude: float,
) -> None:
    async def enter(port: str) -> None:
        async with m100link.connect(port) as aircraft:
            await aircraft.activate(m100link.Credentials(app_id=foreign.APP_ID, key=foreign.KEY))
            await aircraft.wait_for(lambda state: state.position is not None, timeout=PATIENCE)
            async with aircraft.control() as control:
                with pytest.raises(GuardRefused):
                    control.send(NORTH)

    with foreign_aircraft() as there:
        there.latitude_deg = latitude
        asyncio.run(enter(there.name))
        assert there.device == foreign.RC
        assert there.movements == []


# -- on a mission, which flies by itself ----------------------------------------------------------


@contextmanager
def mission_flight() -> Iterator[tuple[ForeignAircraft, subprocess.Popen[bytes]]]:
    """The foreign aircraft on a mission that a process watches."""
    with foreign_flight("mission", "3.1") as (there, process):
        deadline = time.monotonic() + PATIENCE
        while not there.missions.flown_m > 0.5:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        yield there, process


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_stops_the_mission_and_gives_the_foreign_aircraft_back(
    number: signal.Signals,
) -> None:
    with mission_flight() as (there, process):
        process.send_signal(number)
        time.sleep(0.05)
        process.send_signal(number)
        assert process.wait(timeout=PATIENCE) in (130, -number)
        last = there.missions.orders[-1]
        assert (last.number, last.value, last.answer) == (0x12, b"\1", 0)
        assert not there.missions.flying
        assert there.device == foreign.RC
        assert process.stdout is not None
        assert b"went on" not in process.stdout.read()


def test_a_mission_that_nobody_stopped_is_found_and_stopped_by_the_next_program() -> None:
    """The program is killed, and its guardian before it."""

    async def look_and_stop(port: str) -> None:
        async with m100link.connect(port) as aircraft:
            aircraft.use_key(m100link.Credentials(app_id=foreign.APP_ID, key=foreign.KEY))
            await aircraft.wait_for(lambda _: aircraft.mission.is_running, timeout=PATIENCE)
            assert aircraft.mission.kind is m100link.MissionKind.WAYPOINT
            async with aircraft.control() as control:
                with pytest.raises(m100link.MissionRunning):
                    control.send(NORTH)
                await control.stop_mission()

    with mission_flight() as (there, process):
        os.kill(guardian_of(process.pid), signal.SIGKILL)
        process.kill()
        process.wait(timeout=PATIENCE)
        flown = there.missions.flown_m
        time.sleep(1.0)
        assert there.missions.flown_m > flown + 0.5, "nobody stopped it"
        asyncio.run(look_and_stop(there.name))
        assert not there.missions.flying
