"""What no program survives, and what the guardian then does for the aircraft.

Real processes, an aircraft that shares no line with the library, judged by the bytes that it got:
the order of what came, never when it came.
"""

from __future__ import annotations

import asyncio
import logging
import os
import random
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path

import pytest

import m100link
from m100link.errors import GuardianFailed, GuardianTookOver, PortBusy, UsageError
from m100link.flight import guardian as guardian_module
from m100link.flight.guardian import patience_of
from tests.flight import foreign_aircraft as foreign
from tests.flight.foreign_aircraft import ForeignAircraft, ForeignMatrice, foreign_aircraft
from tests.flight.guarded_program import ENDS, guardian_of
from tests.rig import NORTH
from tests.waiting import PATIENCE, blocking_until

pytestmark = [
    pytest.mark.pty,
    pytest.mark.skipif(sys.platform != "linux", reason="there is a guardian on Linux alone"),
]

ROOT = Path(__file__).parent.parent.parent
MODES = ("hover", "land", "mission")
FROM_OUTSIDE = {"SIGQUIT": signal.SIGQUIT, "SIGKILL": signal.SIGKILL}


class ForeignOverTcp(ForeignMatrice):
    """One behind a host between, for one connection."""

    def __init__(self, firmware: str) -> None:
        super().__init__(firmware)
        self._server = socket.create_server(("127.0.0.1", 0))
        self.name = f"tcp://127.0.0.1:{self._server.getsockname()[1]}"
        self._line: socket.socket | None = None
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def now(self) -> float:
        return time.monotonic()

    def close(self) -> None:
        self._is_over.set()
        self._thread.join()
        self._server.close()

    def _run(self) -> None:
        while not select.select([self._server], [], [], 0.05)[0]:
            if self._is_over.is_set():
                return
        self._line, _ = self._server.accept()
        with self._line:
            while not self._is_over.is_set():
                if self.now() >= self._next_at:
                    self.step()
                wait = max(0.0, self._next_at - self.now())
                if select.select([self._line], [], [], wait)[0]:
                    try:
                        data = self._line.recv(4096)
                    except OSError:
                        return
                    if not data:
                        return
                    self.receive(data)

    def _write(self, data: bytes) -> None:
        if self._line is not None and select.select([], [self._line], [], 0.0)[1]:
            try:
                self._line.sendall(data)
            except OSError:
                self._is_over.set()


Foreign = ForeignAircraft | ForeignOverTcp


@contextmanager
def over_tcp(firmware: str) -> Iterator[ForeignOverTcp]:
    there = ForeignOverTcp(firmware)
    try:
        yield there
    finally:
        there.close()


@contextmanager
def flown(there: Foreign, mode: str, end: str) -> Iterator[subprocess.Popen[str]]:
    """A process that flies, and says so."""
    command = (sys.executable, "-m", "tests.flight.guarded_program", there.name, mode, end)
    with subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            assert line == "flying\n", process.stderr and process.stderr.read()
            yield process
        finally:
            process.kill()


def descriptors() -> int:
    """How many files this process has open."""
    return len(list(Path("/proc/self/fd").iterdir()))


def assert_ended_in_order(there: Foreign, mode: str) -> None:
    """Stopped or neutral, landing where asked for, given back, and nothing moving behind that."""
    if mode == "land":
        blocking_until(lambda: 6 in there.tasks and there.status == foreign.STANDBY)
        assert there.releases == 0, "a release would end the landing in the air"
    else:
        blocking_until(lambda: there.device == foreign.RC)
    time.sleep(0.4)
    speeds = [movement.values[0] for movement in there.movements]
    if mode == "mission":
        stop = next(order for order in there.missions.orders if (order.number, order.value) == STOP)
        assert stop.answer == 0
        assert not there.missions.flying
        assert not speeds
        return
    assert speeds[-1] == 0.0
    assert set(speeds[-10:]) == {0.0}, speeds[-20:]
    moving = [movement for movement in there.movements if movement.values[0]]
    assert all(movement.is_obeyed for movement in moving)
    assert mode == "land" or there.releases >= 1


STOP = (0x12, b"\x01")


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("end", [*ENDS, *FROM_OUTSIDE])
def test_the_flight_is_ended_whatever_becomes_of_the_program(end: str, mode: str) -> None:
    with foreign_aircraft("3.1") as there, flown(there, mode, end) as process:
        if end in FROM_OUTSIDE:
            process.send_signal(FROM_OUTSIDE[end])
        assert_ended_in_order(there, mode)


@pytest.mark.parametrize("firmware", ["1.0", "2.3"])
@pytest.mark.parametrize("mode", ["hover", "land"])
def test_the_flight_is_ended_for_aircraft_of_every_firmware(firmware: str, mode: str) -> None:
    with foreign_aircraft(firmware) as there, flown(there, mode, "kill"):
        assert_ended_in_order(there, mode)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("end", ["kill", "sleep", "execv"])
def test_the_flight_is_ended_over_tcp(end: str, mode: str) -> None:
    with over_tcp("3.1") as there, flown(there, mode, end):
        assert_ended_in_order(there, mode)


@pytest.mark.parametrize("mode", MODES)
def test_a_computer_that_slept_ends_the_flight_when_it_wakes(mode: str) -> None:
    """Both processes stand still, and the program is the first to go on."""
    with foreign_aircraft("3.1") as there, flown(there, mode, "never") as process:
        guardian = guardian_of(process.pid)
        process.send_signal(signal.SIGSTOP)
        os.kill(guardian, signal.SIGSTOP)
        time.sleep(2.5)
        process.send_signal(signal.SIGCONT)
        time.sleep(0.2)
        os.kill(guardian, signal.SIGCONT)
        assert_ended_in_order(there, mode)


def test_a_kill_at_any_moment_leaves_nothing_behind() -> None:
    """From before authority to the middle of the stop path."""
    seed = int(os.environ.get("M100LINK_SEED", "7"))
    print(f"seed {seed}")  # noqa: T201 (pytest shows it when the test fails)
    chance = random.Random(seed)
    for _ in range(6):
        kill_after(chance.uniform(0.0, 1.2))


def kill_after(seconds: float) -> None:
    """So long after the aircraft gave authority, in blocks that begin and end."""
    with foreign_aircraft("3.1") as there:
        command = (sys.executable, "-m", "tests.flight.foreign_programs", "blocks", there.name)
        with subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL) as process:
            blocking_until(lambda: there.device == foreign.ONBOARD)
            time.sleep(seconds)
            process.kill()
        blocking_until(lambda: there.device == foreign.RC)
        time.sleep(0.4)
        speeds = [movement.values[0] for movement in there.movements]
        assert not speeds or speeds[-1] == 0.0, f"killed after {seconds:.3f} s"


def test_a_landing_that_was_begun_by_the_stop_path_goes_on_when_the_program_is_killed() -> None:
    with foreign_aircraft("3.1") as there, flown(there, "land", "never") as process:
        process.send_signal(signal.SIGTERM)
        blocking_until(lambda: 6 in there.tasks)
        process.kill()
        assert_ended_in_order(there, "land")


def test_the_next_program_is_told_who_has_the_port_and_to_leave_it_alone() -> None:
    async def come(name: str) -> None:
        with pytest.raises(PortBusy, match="m100link-guard") as caught:
            async with m100link.connect(name):
                pass
        assert "leave it alone" in caught.value.remedy

    with foreign_aircraft("3.1") as there, flown(there, "land", "kill") as process:
        process.wait(timeout=PATIENCE)
        blocking_until(lambda: 6 in there.tasks)
        asyncio.run(come(there.name))


def test_the_pilot_who_took_the_aircraft_keeps_it() -> None:
    with foreign_aircraft("3.1") as there, flown(there, "land", "stopped"):
        there.leave_f()
        time.sleep(3.5)
        assert there.tasks == [], "nothing lands what the pilot flies"


# -- the program lives on, or comes back ----------------------------------------------------------


@asynccontextmanager
async def connected(there: ForeignAircraft) -> AsyncIterator[m100link.Aircraft]:
    async with m100link.connect(there.name) as aircraft:
        await aircraft.activate(m100link.Credentials(app_id=foreign.APP_ID, key=foreign.KEY))
        await aircraft.wait_for(lambda state: state.flight_status is not None, timeout=PATIENCE)
        yield aircraft


def test_a_program_that_comes_back_is_told_and_may_ask_for_control_again() -> None:
    async def fly(there: ForeignAircraft) -> None:
        async with connected(there) as aircraft:
            with pytest.raises(GuardianTookOver):
                async with aircraft.control(guardian=0.6) as control:
                    control.send(NORTH, lifetime=5.0, allow_long_lifetime=True)
                    await asyncio.sleep(0.3)
                    time.sleep(1.5)  # noqa: ASYNC251 (the hang that a beginner writes)
                    await asyncio.sleep(PATIENCE)
            assert there.device == foreign.RC
            last = len(there.movements)
            await asyncio.sleep(0.3)
            assert len(there.movements) == last
            assert there.movements[-1].values[0] == 0.0
            async with aircraft.control() as control:
                assert control.has_guardian
                control.send(NORTH)
                await asyncio.sleep(0.1)
            assert there.device == foreign.RC

    with foreign_aircraft("3.1") as there:
        asyncio.run(fly(there))


def test_a_short_hang_costs_the_setpoint_and_not_the_flight() -> None:
    async def fly(there: ForeignAircraft) -> None:
        async with connected(there) as aircraft, aircraft.control(guardian=20.0) as control:
            control.send(NORTH)
            await asyncio.sleep(0.1)
            hung = len(there.movements)
            time.sleep(0.9)  # noqa: ASYNC251 (a slow model)
            speeds = [movement.values[0] for movement in there.movements[hung:]]
            assert 0.0 in speeds
            assert speeds[-1] == 0.0
            await asyncio.sleep(0.1)  # telemetry of now
            control.send(NORTH)
            await asyncio.sleep(0.15)
            assert there.movements[-1].values[0] == 2.0, "it flies on"
            assert there.releases == 0

    with foreign_aircraft("3.1") as there:
        asyncio.run(fly(there))


def test_without_a_guardian_by_name_there_is_none() -> None:
    async def fly(there: ForeignAircraft) -> None:
        async with connected(there) as aircraft:
            async with aircraft.control(guardian=False) as control:
                assert not control.has_guardian
                with pytest.raises(AssertionError, match="no guardian"):
                    guardian_of(os.getpid())

    with foreign_aircraft() as there:
        asyncio.run(fly(there))


def test_a_guardian_that_is_lost_is_told_and_the_flight_goes_on(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def fly(there: ForeignAircraft) -> None:
        async with connected(there) as aircraft, aircraft.control() as control:
            control.send(NORTH)
            os.kill(guardian_of(os.getpid()), signal.SIGKILL)
            async with asyncio.timeout(PATIENCE):
                while control.has_guardian:  # noqa: ASYNC110 (it has no event)
                    await asyncio.sleep(0.01)
            control.send(NORTH)
            await asyncio.sleep(0.1)
            assert control.is_flying

    with foreign_aircraft() as there, caplog.at_level(logging.WARNING):
        asyncio.run(fly(there))
        assert there.device == foreign.RC
        assert there.movements[-1].values[0] == 0.0
    assert "the guardian of this flight is gone" in caplog.text


def test_a_block_leaves_no_process_and_no_descriptor() -> None:
    async def fly(there: ForeignAircraft) -> None:
        async with connected(there) as aircraft:
            before = descriptors()
            for _ in range(3):
                async with aircraft.control():
                    child = guardian_of(os.getpid())
                with pytest.raises(ProcessLookupError):
                    os.kill(child, 0)  # it was waited for
            assert descriptors() == before

    with foreign_aircraft() as there:
        asyncio.run(fly(there))


def test_a_guardian_that_cannot_start_is_an_error_and_nothing_was_asked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def fly(there: ForeignAircraft) -> None:
        async with connected(there) as aircraft:
            before = descriptors()
            for executable in ("/nowhere/python", "/bin/true", ""):
                monkeypatch.setattr(sys, "executable", executable)
                with pytest.raises(GuardianFailed) as caught:
                    async with aircraft.control():
                        raise AssertionError("it does not get here")
                assert "guardian=False" in caught.value.usual_remedy
            assert descriptors() == before
            assert there.device == foreign.RC

    with foreign_aircraft() as there:
        asyncio.run(fly(there))


def test_a_frozen_program_does_not_begin_a_second_time_as_its_own_guardian(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def fly(there: ForeignAircraft) -> None:
        async with connected(there) as aircraft:
            monkeypatch.setattr(sys, "frozen", True, raising=False)
            monkeypatch.setattr(subprocess, "Popen", None)
            with pytest.raises(GuardianFailed, match="where Python is"):
                async with aircraft.control():
                    raise AssertionError("it does not get here")

    with foreign_aircraft() as there:
        asyncio.run(fly(there))


def test_a_guardian_that_stands_still_itself_does_not_hold_up_the_program(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def fly(there: ForeignAircraft) -> None:
        async with connected(there) as aircraft:
            async with aircraft.control(guardian=0.5) as control:
                os.kill(guardian_of(os.getpid()), signal.SIGSTOP)
                time.sleep(1.0)  # noqa: ASYNC251 (both stand still)
                async with asyncio.timeout(PATIENCE):
                    while control.has_guardian:  # noqa: ASYNC110 (it has no event)
                        await asyncio.sleep(0.01)
            assert there.device == foreign.RC

    monkeypatch.setattr(guardian_module, "_ACTS_WITHIN_S", 0.3)
    with foreign_aircraft() as there:
        asyncio.run(fly(there))


@pytest.mark.parametrize(
    ("said", "seconds"), [(True, 2.0), (False, None), (0.5, 0.5), (60, 60.0), (3, 3.0)]
)
def test_what_a_program_says_of_it(said: bool | float, seconds: float | None) -> None:
    assert patience_of(said) == seconds


@pytest.mark.parametrize("said", [0, 0.4, 61, -1.0, float("nan"), float("inf")])
def test_what_makes_no_sense_is_refused(said: float) -> None:
    with pytest.raises(UsageError):
        patience_of(said)
