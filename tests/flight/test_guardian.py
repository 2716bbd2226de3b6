"""What no program survives, and what the guardian then does for the aircraft.

Real processes, an aircraft that shares no line with the library, judged by the bytes that it got:
the order of what came, never when it came.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import mmap
import os
import random
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import cast

import pytest

import m100link
from m100link.errors import GuardianFailed, GuardianTookOver, PortBusy, UsageError
from m100link.flight import guardian as guardian_module
from m100link.flight import guardian_process as page
from m100link.flight.guardian import Guardian, GuardianPlan, GuardianStep, patience_of
from m100link.link import Link
from tests.flight import foreign_aircraft as foreign
from tests.flight.foreign_aircraft import ForeignAircraft, ForeignMatrice, foreign_aircraft
from tests.flight.guarded_program import ENDS, guardian_of
from tests.rig import NORTH
from tests.waiting import PATIENCE, blocking_until

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="there is a guardian on Linux alone"
)

ROOT = Path(__file__).parent.parent.parent
MODES = ("hover", "land", "mission")
FROM_OUTSIDE = {"SIGQUIT": signal.SIGQUIT, "SIGKILL": signal.SIGKILL}


class ForeignOverTcp(ForeignMatrice):
    """One behind a host between, for one connection; ``delay``: seconds each way."""

    def __init__(self, firmware: str, delay: float = 0.0) -> None:
        super().__init__(firmware)
        self._delay = delay
        self._coming: deque[tuple[float, bytes]] = deque()  # what is on its way, and when it is due
        self._going: deque[tuple[float, bytes]] = deque()
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
        is_open = True
        with self._line:
            while not self._is_over.is_set() and (is_open or self._coming):
                if self.now() >= self._next_at:
                    self.step()
                wait = max(0.0, min(self._next_at, *self._due()) - self.now())
                if is_open and select.select([self._line], [], [], wait)[0]:
                    try:
                        data = self._line.recv(4096)
                    except OSError:
                        data = b""
                    is_open = bool(data)
                    self._coming.append((self.now() + self._delay, data))
                elif not is_open:
                    time.sleep(wait)
                while self._coming and self._coming[0][0] <= self.now():
                    self.receive(self._coming.popleft()[1])
                while is_open and self._going and self._going[0][0] <= self.now():
                    self._send(self._going.popleft()[1])

    def _due(self) -> list[float]:
        return [queue[0][0] for queue in (self._coming, self._going) if queue] or [math.inf]

    def _write(self, data: bytes) -> None:
        self._going.append((self.now() + self._delay, data))

    def _send(self, data: bytes) -> None:
        if self._line is not None and select.select([], [self._line], [], 0.0)[1]:
            try:
                self._line.sendall(data)
            except OSError:
                self._is_over.set()


Foreign = ForeignAircraft | ForeignOverTcp


@contextmanager
def over_tcp(firmware: str, delay: float = 0.0) -> Iterator[ForeignOverTcp]:
    there = ForeignOverTcp(firmware, delay)
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


@pytest.mark.pty
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("end", [*ENDS, *FROM_OUTSIDE])
def test_the_flight_is_ended_whatever_becomes_of_the_program(end: str, mode: str) -> None:
    with foreign_aircraft("3.1") as there, flown(there, mode, end) as process:
        if end in FROM_OUTSIDE:
            process.send_signal(FROM_OUTSIDE[end])
        assert_ended_in_order(there, mode)


@pytest.mark.pty
@pytest.mark.parametrize("firmware", ["1.0", "2.3"])
@pytest.mark.parametrize("mode", ["hover", "land"])
def test_the_flight_is_ended_for_aircraft_of_every_firmware(firmware: str, mode: str) -> None:
    with foreign_aircraft(firmware) as there, flown(there, mode, "kill"):
        assert_ended_in_order(there, mode)


@pytest.mark.pty
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("end", ["kill", "sleep", "execv"])
def test_the_flight_is_ended_over_tcp(end: str, mode: str) -> None:
    with over_tcp("3.1") as there, flown(there, mode, end):
        assert_ended_in_order(there, mode)


@pytest.mark.pty
@pytest.mark.parametrize("mode", MODES)
def test_the_flight_is_ended_over_a_line_that_takes_a_second_each_way(mode: str) -> None:
    with over_tcp("3.1", delay=1.0) as there, flown(there, mode, "kill"):
        assert_ended_in_order(there, mode)


@pytest.mark.pty
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


@pytest.mark.pty
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


@pytest.mark.pty
def test_a_landing_that_was_begun_by_the_stop_path_goes_on_when_the_program_is_killed() -> None:
    with foreign_aircraft("3.1") as there, flown(there, "land", "never") as process:
        process.send_signal(signal.SIGTERM)
        blocking_until(lambda: 6 in there.tasks)
        process.kill()
        assert_ended_in_order(there, "land")


@pytest.mark.pty
def test_the_next_program_hears_who_has_the_port_and_to_leave_it_alone() -> None:
    async def come(name: str) -> None:
        with pytest.raises(PortBusy, match="m100link-guard") as caught:
            async with m100link.connect(name):
                pass
        assert "leave it alone" in caught.value.remedy

    with foreign_aircraft("3.1") as there, flown(there, "land", "kill") as process:
        process.wait(timeout=PATIENCE)
        blocking_until(lambda: 6 in there.tasks)
        asyncio.run(come(there.name))


@pytest.mark.pty
def test_the_pilot_who_took_the_aircraft_keeps_it() -> None:
    with foreign_aircraft("3.1") as there, flown(there, "land", "never") as process:
        there.leave_f()
        assert process.wait(timeout=PATIENCE) == 1
        blocking_until(lambda: there.releases >= 1)  # its last word was read
        assert there.tasks == [], "nothing lands what the pilot flies"


# -- the program lives on, or comes back ----------------------------------------------------------


@asynccontextmanager
async def connected(there: ForeignAircraft) -> AsyncIterator[m100link.Aircraft]:
    async with m100link.connect(there.name) as aircraft:
        await aircraft.activate(m100link.Credentials(app_id=foreign.APP_ID, key=foreign.KEY))
        await aircraft.wait_for(lambda state: state.flight_status is not None, timeout=PATIENCE)
        yield aircraft


@pytest.mark.pty
def test_a_program_that_comes_back_gets_an_error_and_may_ask_for_control_again() -> None:
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


@pytest.mark.pty
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


@pytest.mark.pty
def test_without_a_guardian_by_name_there_is_none() -> None:
    async def fly(there: ForeignAircraft) -> None:
        async with connected(there) as aircraft:
            async with aircraft.control(guardian=False) as control:
                assert not control.has_guardian
                with pytest.raises(AssertionError, match="no guardian"):
                    guardian_of(os.getpid())

    with foreign_aircraft() as there:
        asyncio.run(fly(there))


@pytest.mark.pty
def test_a_guardian_that_is_lost_is_reported_and_the_flight_goes_on(
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


@pytest.mark.pty
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


@pytest.mark.pty
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


@pytest.mark.pty
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


@pytest.mark.pty
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


# -- the program's side alone, by a clock of the test ----------------------------------------------


class Handle:
    """A timer that was set for so many seconds."""

    def __init__(self, delay: float) -> None:
        self.delay, self.is_cancelled = delay, False

    def cancel(self) -> None:
        self.is_cancelled = True


class Program:
    """A guardian without its process: the page and the words are seen by the test.

    Attributes:
        now: Milliseconds of both clocks.
        wanted: What the aircraft needs if the program ends now.
        told: The errors that say that it has taken over.
        killed: How often its process was killed.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, patience_s: float | None = 2.0) -> None:
        self.now, self.wanted = 10_000, "a"
        self.told: list[GuardianTookOver] = []
        self.killed = 0
        self.descriptor: int | None = 7
        self.gate: object = None
        self.timers: list[Handle] = []
        self.readers: list[object] = []
        self.other: socket.socket
        self.said = page.READY
        monkeypatch.setattr(page, "milliseconds", lambda: self.now & 0xFFFFFFFF)
        self.guardian = Guardian(
            cast(Link, self), lambda: self.wanted, self.plan, self.told.append, patience_s
        )
        monkeypatch.setattr(self.guardian, "_spawn", self._spawn)

    def plan(self, wanted: str) -> GuardianPlan:
        frame = wanted.encode()
        return GuardianPlan(
            (GuardianStep(frame),), (GuardianStep(frame, 30, 2), GuardianStep(b"never", 1, 0))
        )

    def _spawn(self, descriptor: int) -> None:
        assert descriptor == 7
        self.guardian._socket, self.other = socket.socketpair()
        for one in (self.guardian._socket, self.other):
            one.setblocking(False)
        self.guardian._map = mmap.mmap(-1, page.PAGE_SIZE)
        self.guardian._process = cast("subprocess.Popen[bytes]", self)

    # A loop, and a process.
    loop = property(lambda self: self)

    async def sock_recv(self, _: socket.socket, size: int) -> bytes:
        assert size == 1
        return self.said

    def add_reader(self, one: socket.socket, _: object) -> None:
        self.readers.append(one)

    def remove_reader(self, one: socket.socket) -> None:
        self.readers.remove(one)

    def call_later(self, delay: float, _: object) -> Handle:
        self.timers.append(Handle(delay))
        return self.timers[-1]

    def time(self) -> float:
        return self.now / 1000

    def kill(self) -> None:
        self.killed += 1

    def wait(self, timeout: float) -> int:
        assert timeout == 1.0
        return 0

    # What the test sees.
    @property
    def words(self) -> memoryview:
        assert self.guardian._words is not None
        return self.guardian._words

    @property
    def halves(self) -> list[tuple[object, ...]]:
        """What the halves say that are written, the older one first."""
        shared, found = self.guardian._map, []
        assert shared is not None
        for number in range(2):
            at = page.HALVES_AT + number * page.HALF_SIZE
            found.append(page.opened(shared[at : at + page.HALF_SIZE]))
        return sorted(half for half in found if half is not None)

    @property
    def half(self) -> object:
        """What the newer half says."""
        return self.halves[-1]

    def heard(self) -> bytes:
        try:
            return self.other.recv(64)
        except BlockingIOError:
            return b""

    def renew(self, after: int) -> None:
        self.now += after
        self.guardian._renew()

    def close(self) -> None:
        self.guardian._tear_down()
        if hasattr(self, "other"):
            self.other.close()


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> Iterator[Program]:
    with contextlib.closing(Program(monkeypatch)) as there:
        asyncio.run(there.guardian.start())
        yield there


def test_it_begins_with_a_plan_a_token_and_the_gate(watched: Program) -> None:
    assert watched.guardian.is_watching
    assert watched.gate is watched.guardian
    assert watched.words[page.TOKEN] == 10_000
    assert watched.half == (1, 2000, [(0, b"a")], [(30, b"a")] * 2)
    assert watched.heard() == page.WAKE
    assert [timer.delay for timer in watched.timers] == [0.1, 0.1], "Ctrl-C can take one"


def test_a_plan_is_published_when_it_changes_into_the_other_half(watched: Program) -> None:
    watched.heard()
    watched.guardian.update()
    assert watched.heard() == b""
    watched.wanted = "b"
    watched.renew(100)
    assert watched.half == (2, 2000, [(0, b"b")], [(30, b"b")] * 2)
    assert watched.heard() == page.WAKE
    assert watched.words[page.TOKEN] == 10_100
    assert [timer.is_cancelled for timer in watched.timers] == [True, True, False, False]


def test_the_half_of_before_stays_whole_for_a_program_that_is_killed_while_it_writes(
    watched: Program,
) -> None:
    for generation, wanted in enumerate("bcdef", start=2):
        watched.wanted = wanted
        watched.guardian.update()
        assert [half[0] for half in watched.halves] == [generation - 1, generation]


def test_bytes_count_as_missing_until_they_are_written(watched: Program) -> None:
    assert watched.guardian.opens(30)
    assert watched.guardian.opens(12)
    assert watched.words[page.UNSENT] == 42
    watched.guardian.wrote(5)
    assert watched.words[page.UNSENT] == 5


@pytest.mark.parametrize("hold", [page.MID_FRAME, page.TAKEN])
def test_while_the_guardian_writes_the_program_does_not(watched: Program, hold: int) -> None:
    watched.words[page.HOLD] = hold
    assert not watched.guardian.opens(30)
    assert watched.words[page.UNSENT] == 0


@pytest.mark.parametrize("began", [10_000, 0xFFFFFFFF - 500])
def test_a_program_that_stood_still_for_its_patience_writes_no_more(
    watched: Program, began: int
) -> None:
    watched.now = watched.guardian._renewed = watched.words[page.TOKEN] = began
    watched.heard()
    watched.now += 1_999
    assert watched.guardian.opens(1)
    watched.now += 1
    assert not watched.guardian.opens(1)
    token = watched.words[page.TOKEN]
    watched.renew(0)
    assert watched.words[page.TOKEN] == token, "it does not take back what the guardian may do"
    assert watched.heard() == page.WAKE
    watched.renew(1_000)
    assert watched.killed == 0
    watched.renew(1)
    assert watched.killed == 1, "a guardian that stands still itself is ended"
    assert watched.told == []


def test_it_is_reported_once_that_the_guardian_has_taken_over(watched: Program) -> None:
    watched.words[page.HOLD] = page.TAKEN
    token = watched.words[page.TOKEN]
    watched.renew(100)
    watched.renew(100)
    assert watched.words[page.TOKEN] == token
    (error,) = watched.told
    assert "more than 2 s" in error.seen


def test_a_guardian_that_ended_is_heard_and_let_go(
    watched: Program, caplog: pytest.LogCaptureFixture
) -> None:
    watched.guardian._on_word()  # nothing was said
    was_watching = watched.guardian.is_watching
    watched.other.close()
    watched.guardian._on_word()
    assert (was_watching, watched.guardian.is_watching) == (True, False)
    assert (watched.gate, watched.readers) == (None, [])
    assert all(timer.is_cancelled for timer in watched.timers)
    assert "nobody ends it if this program cannot" in caplog.text
    assert watched.guardian.opens(30), "the flight goes on"


@pytest.mark.parametrize("is_taken", [False, True])
def test_at_the_end_of_a_block_it_is_dismissed_unless_it_has_taken_over(
    watched: Program, caplog: pytest.LogCaptureFixture, is_taken: bool
) -> None:
    if is_taken:
        watched.words[page.HOLD] = page.TAKEN
    watched.heard()

    async def end() -> None:
        ending = asyncio.ensure_future(watched.guardian.end())
        await asyncio.sleep(0)
        half = (1, 2000, [(0, b"a")], [(30, b"a")] * 2) if is_taken else (2, 2000, [], [])
        assert watched.half == half
        assert watched.heard() == (b"" if is_taken else page.WAKE + page.OVER)
        assert not ending.done()
        watched.other.close()
        watched.guardian._on_word()
        await ending

    asyncio.run(end())
    assert len(watched.told) == is_taken
    assert caplog.text == "", "that is expected"


def test_the_child_of_a_fork_has_no_part_in_it(watched: Program) -> None:
    watched.guardian._pid += 1
    watched.wanted = "b"
    watched.renew(100)
    watched.guardian.update()
    asyncio.run(watched.guardian.end())
    assert watched.words[page.TOKEN] == 10_000
    assert watched.half == (1, 2000, [(0, b"a")], [(30, b"a")] * 2)


@pytest.mark.parametrize("why", ["not asked for", "no descriptor"])
def test_without_a_line_or_without_being_asked_for_there_is_none(
    monkeypatch: pytest.MonkeyPatch, why: str
) -> None:
    patience_s = None if why == "not asked for" else 2.0
    there = Program(monkeypatch, patience_s=patience_s)
    there.descriptor = None if why == "no descriptor" else 7
    asyncio.run(there.guardian.start())
    assert not there.guardian.is_watching
    assert there.guardian.opens(30)
    there.guardian.update()
    there.guardian.wrote(3)
    asyncio.run(there.guardian.end())


def test_one_that_says_another_word_did_not_start(monkeypatch: pytest.MonkeyPatch) -> None:
    with contextlib.closing(Program(monkeypatch)) as there:
        there.said = b""
        with pytest.raises(GuardianFailed, match="ended at once"):
            asyncio.run(there.guardian.start())
        assert (there.killed, there.gate) == (1, None)


@pytest.mark.parametrize("descriptor", [0, 1, 2])
def test_a_line_in_the_place_of_a_closed_stream_has_no_guardian_that_could_write_to_it(
    monkeypatch: pytest.MonkeyPatch, descriptor: int
) -> None:
    there = Program(monkeypatch)
    there.descriptor = descriptor
    monkeypatch.setattr(there.guardian, "_spawn", Guardian._spawn.__get__(there.guardian))
    monkeypatch.setattr(subprocess, "Popen", None)
    with pytest.raises(GuardianFailed, match="standard input, output or error was closed"):
        asyncio.run(there.guardian.start())
    assert there.gate is None
