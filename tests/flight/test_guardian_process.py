"""The guardian's own process, with a test in place of the program: junk, a full line, signals."""

from __future__ import annotations

import contextlib
import fcntl
import mmap
import os
import random
import select
import signal
import socket
import subprocess
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from zlib import crc32

import pytest

from m100link.flight import guardian_process as page
from tests.flight.foreign_aircraft import ForeignMatrice, frame
from tests.waiting import PATIENCE, again_and_again, blocking_until

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="there is a guardian on Linux alone"
)

STALLED, LAST = 0, 1
MOVING = frame(b"\x01\x03\x48" + b"\x00\x00\x00\x40" + bytes(12), sequence=7)  # 2 m/s
NEUTRAL = frame(b"\x01\x03\x48" + bytes(16), sequence=8)
RELEASE = frame(b"\x01\x00\x00", session=31, sequence=9)
PLAN = [(STALLED, 0, 3, NEUTRAL), (LAST, 0, 5, NEUTRAL), (LAST, 20, 2, RELEASE)]


def seed() -> random.Random:
    number = int(os.environ.get("M100LINK_SEED", "11"))
    print(f"seed {number}")  # noqa: T201 (pytest shows it when the test fails)
    return random.Random(number)


class Aircraft(ForeignMatrice):
    """What reads the line when the test says so."""

    def now(self) -> float:
        return time.monotonic()

    def _write(self, data: bytes) -> None:
        pass


class Program:
    """A program's side without a program."""

    def __init__(self) -> None:
        self.master, self.line = os.openpty()
        tty.setraw(self.line)
        os.set_blocking(self.line, False)
        self.socket, other = socket.socketpair()
        shared = os.memfd_create("test")
        os.ftruncate(shared, page.PAGE_SIZE)
        self.page = mmap.mmap(shared, page.PAGE_SIZE)
        self.words = memoryview(self.page).cast("I")
        passed = self.line, other.fileno(), shared
        self.process = subprocess.Popen(
            (sys.executable, "-I", "-S", page.__file__, *map(str, passed), str(os.getpid())),
            pass_fds=passed,
            start_new_session=True,
        )
        other.close()
        os.close(shared)
        assert self.socket.recv(1) == page.READY
        self.aircraft = Aircraft()
        self.generation = 0

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        self.socket.close()
        self.words.release()
        self.page.close()
        for descriptor in (self.master, self.line):
            with contextlib.suppress(OSError):
                os.close(descriptor)

    def live(self) -> None:
        self.words[page.TOKEN] = page.milliseconds()

    def publish(self, patience_ms: int = 600) -> None:
        self.live()
        self.generation += 1
        half = page.sealed(self.generation, patience_ms, PLAN)
        at = page.HALVES_AT + self.generation % 2 * page.HALF_SIZE
        self.page[at : at + len(half)] = half
        self.socket.send(page.WAKE)

    def is_read(self) -> bool:
        """Whether the guardian has taken what was said to it last."""
        waits = fcntl.ioctl(self.socket, termios.TIOCOUTQ, bytes(4))
        return int.from_bytes(waits, sys.byteorder) == 0

    def read_to_end(self) -> bytes:
        """What the aircraft gets until the guardian has done its work."""
        received = b""
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            has_ended = self.process.poll() is not None  # before the look: then it wrote all
            if select.select([self.master], [], [], 0.1)[0]:
                received += os.read(self.master, 4096)
            elif has_ended:
                break
        self.aircraft.receive(received)
        return received

    @property
    def speeds(self) -> list[float]:
        return [movement.values[0] for movement in self.aircraft.movements]


@contextmanager
def program() -> Iterator[Program]:
    there = Program()
    try:
        yield there
    finally:
        there.close()


# -- the page -------------------------------------------------------------------------------------


def test_a_half_is_read_as_it_was_written() -> None:
    found = page.opened(page.sealed(4, 700, PLAN).ljust(page.HALF_SIZE, b"\xff"))
    assert found == (4, 700, [(0, NEUTRAL)] * 3, [(0, NEUTRAL)] * 5 + [(20, RELEASE)] * 2)


def test_a_half_that_was_not_written_to_its_end_does_not_count() -> None:
    before = page.sealed(2, 600, PLAN).ljust(page.HALF_SIZE, b"\0")
    after = page.sealed(4, 600, [(LAST, 0, 1, RELEASE), *PLAN])
    for cut in range(1, len(after)):
        found = page.opened(after[:cut] + before[cut:])
        assert found is None, f"cut after {cut} bytes"


def test_a_changed_half_does_not_count() -> None:
    chance = seed()
    half = bytearray(page.sealed(2, 600, PLAN).ljust(page.HALF_SIZE, b"\0"))
    size = len(page.sealed(2, 600, PLAN))
    for _ in range(300):
        changed = bytearray(half)
        for _ in range(chance.randint(1, 8)):
            changed[chance.randrange(size)] ^= chance.randint(1, 255)
        assert changed == half or page.opened(bytes(changed)) is None


@pytest.mark.parametrize("size", range(1, 8))
def test_a_half_whose_last_step_is_cut_off_does_not_count(size: int) -> None:
    """The checksum is right, and what is too short for a step stands at the end of the half."""
    whole = page.sealed(2, 600, PLAN)
    body = whole[4:12] + (len(whole) - 16 + size).to_bytes(4, "little") + whole[16:] + bytes(size)
    assert page.opened(crc32(body).to_bytes(4, "little") + body) is None


def test_what_does_not_fit_is_refused() -> None:
    room = page.HALF_SIZE - 16 - 8  # behind the head of a half and that of a step
    assert len(page.sealed(1, 600, [(LAST, 0, 1, bytes(room))])) == page.HALF_SIZE
    with pytest.raises(ValueError, match="do not fit"):
        page.sealed(1, 600, [(LAST, 0, 1, bytes(room + 1))])


# -- the watch, in this process, by a clock of the test --------------------------------------------


class Watched:
    """A watch whose clock and whose waiting are the test's.

    Attributes:
        now: Milliseconds.
        waits: For how long it listened, in order, ms.
        events: What happens when it listens for the nth time.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, is_waiting: bool = True) -> None:
        self.aircraft, line = socket.socketpair()
        line.setblocking(False)
        self.aircraft.setblocking(False)
        self.program, other = socket.socketpair()
        self.page = os.memfd_create("test")
        os.ftruncate(self.page, page.PAGE_SIZE)
        self.now = 5_000
        self.waits: list[float] = []
        self.events: dict[int, Callable[[], object]] = {}
        self.ends = line, other
        monkeypatch.setattr(page, "milliseconds", lambda: self.now & 0xFFFFFFFF)
        self.watch = page.Watch(line.fileno(), other.fileno(), self.page, os.getppid())
        self.listen, self.let_pass = self.watch._listen, self.watch._pass
        if is_waiting:
            monkeypatch.setattr(self.watch, "_listen", self._wait)
        monkeypatch.setattr(self.watch, "_pass", lambda seconds: self._wait(1000 * seconds))

    def _wait(self, timeout_ms: float) -> None:
        self.waits.append(timeout_ms)
        assert len(self.waits) < 100
        self.now += round(timeout_ms)
        self.events.get(len(self.waits), lambda: None)()

    def set(self, word: int, value: int) -> None:
        os.pwrite(self.page, (value & 0xFFFFFFFF).to_bytes(4, "little"), 4 * word)

    def word(self, which: int) -> int:
        return int.from_bytes(os.pread(self.page, 4, 4 * which), "little")

    def publish(self, generation: int, *, patience: int = 700, half: int | None = None) -> None:
        data = page.sealed(generation, patience, STEPS)
        number = generation % 2 if half is None else half
        os.pwrite(self.page, data, page.HALVES_AT + number * page.HALF_SIZE)

    def end(self) -> None:
        self.watch._is_over = True

    def close(self) -> None:
        for one in (self.aircraft, self.program, *self.ends):
            one.close()
        os.close(self.page)
        if self.watch._process >= 0:
            os.close(self.watch._process)

    def received(self) -> bytes:
        with contextlib.suppress(BlockingIOError):
            return self.aircraft.recv(1 << 20)
        return b""


STEPS = [(STALLED, 0, 1, b"n"), (STALLED, 20, 2, b"N"), (LAST, 0, 1, b"l"), (LAST, 50, 2, b"L")]


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> Iterator[Watched]:
    with contextlib.closing(Watched(monkeypatch)) as there:
        yield there


@pytest.fixture
def listening(monkeypatch: pytest.MonkeyPatch) -> Iterator[Watched]:
    """One that really listens."""
    with contextlib.closing(Watched(monkeypatch, is_waiting=False)) as there:
        yield there


@pytest.mark.parametrize("token", [5_000, 1, 0xFFFFFFFF])
def test_a_setpoint_is_abandoned_after_300_ms_and_a_flight_after_its_patience(
    watched: Watched, token: int
) -> None:
    watched.publish(1)
    watched.now = token
    watched.set(page.TOKEN, token)
    watched.watch.run()
    # To 300 ms; its three frames, 40 ms; to 700 ms; and the last three with 50 ms between.
    assert watched.waits == [300, 0, 20, 20, 360, 0, 50, 50]
    assert watched.received() == b"nNNlLL"
    assert watched.word(page.HOLD) == page.TAKEN


def test_a_program_that_lives_is_left_alone_and_one_that_is_done_ends_it(watched: Watched) -> None:
    watched.publish(1)
    watched.set(page.TOKEN, 5_000)
    for number in range(1, 5):
        watched.events[number] = lambda: watched.set(page.TOKEN, watched.now - 100)
    watched.events[5] = watched.end
    watched.watch.run()
    assert watched.waits == [300, 200, 200, 200, 200]
    assert watched.received() == b""
    assert watched.word(page.HOLD) == page.FREE


def test_without_a_plan_it_looks_once_a_minute_and_ends_with_the_program(watched: Watched) -> None:
    watched.set(page.TOKEN, 5_000)
    watched.events[3] = lambda: setattr(watched.watch, "_is_dead", True)
    watched.watch.run()
    assert watched.waits == [60_000, 60_000, 60_000]
    assert watched.received() == b""


def test_the_death_of_a_program_is_not_waited_for(watched: Watched) -> None:
    watched.publish(1)
    watched.set(page.TOKEN, 5_000)
    watched.watch._is_dead = True
    watched.watch.run()
    assert watched.received() == b"lLL"


@pytest.mark.parametrize("event", ["lives", "dies", "is done"])
def test_what_a_stall_sends_ends_when_the_program_is_back_or_gone(
    watched: Watched, event: str
) -> None:
    watched.publish(1)
    watched.set(page.TOKEN, 5_000)
    holds: list[int] = []
    happens: dict[str, Callable[[], object]] = {
        "lives": lambda: watched.set(page.TOKEN, 5_310),
        "dies": lambda: setattr(watched.watch, "_is_dead", True),
        "is done": watched.end,
    }
    watched.events[1] = lambda: holds.append(watched.word(page.HOLD))
    watched.events[3] = happens[event]
    watched.events[4] = watched.end
    watched.watch.run()
    assert watched.received() == (b"nlLL" if event == "dies" else b"n")
    assert holds == [page.FREE]


@pytest.mark.parametrize(
    ("token", "now", "age"),
    [
        (5_000, 5_299, 299),
        (5_005, 5_000, 0),  # renewed since the clock was read
        (5_999, 5_000, 0),
        (0xFFFFFF9C, 200, 300),  # the word wraps after 49 days
        (0, 0xFFFF0000, 0xFFFF0000),
    ],
)
def test_the_age_of_a_token(watched: Watched, token: int, now: int, age: int) -> None:
    watched.now = now
    watched.set(page.TOKEN, token)
    assert watched.watch._age() == (age, token)


@pytest.mark.parametrize("generations", [(7, 8, 9), (0xFFFFFFFE, 0xFFFFFFFF, 0, 1), (0, 1, 2)])
def test_the_newer_half_counts_whichever_it_is_and_when_the_number_wraps(
    watched: Watched, generations: tuple[int, ...]
) -> None:
    for generation in generations:
        watched.publish(generation, patience=600 + generation % 50)
        watched.watch._refresh()
        assert watched.watch._generation == generation
        assert watched.watch._patience == 600 + generation % 50


def test_an_older_half_and_junk_change_nothing(watched: Watched) -> None:
    watched.publish(1)
    watched.watch._refresh()
    watched.publish(0xFFFFFFFF)
    watched.watch._refresh()
    assert watched.watch._generation == 1
    os.pwrite(watched.page, b"junk", page.HALVES_AT + page.HALF_SIZE + 20)
    watched.watch._refresh()
    assert watched.watch._stalled == [(0, b"n"), (20, b"N"), (20, b"N")]
    assert watched.watch._last == [(0, b"l"), (50, b"L"), (50, b"L")]


@pytest.mark.parametrize(("unsent", "torn", "zeros"), [(0, 0, 0), (30, 0, 30), (5, 12, 12)])
def test_a_torn_frame_is_completed_with_zeros(
    watched: Watched, unsent: int, torn: int, zeros: int
) -> None:
    watched.set(page.UNSENT, unsent)
    watched.watch._torn = torn
    watched.watch._mend()
    assert watched.received() == bytes(zeros)


def test_no_frame_lacks_more_than_the_longest_has(watched: Watched) -> None:
    """1023 bytes, the length field of ten bits; a word of junk may say anything."""
    watched.set(page.UNSENT, 0xFFFFFFFF)
    watched.watch._mend()
    assert watched.received() == bytes(1023)


def test_a_full_line_is_waited_for_and_what_was_cut_off_is_remembered(
    watched: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page, "_ROOM_WITHIN_S", (0.0, 0.0))
    taken: Iterator[int | None] = iter([3, None, None, 10])

    def write(line: int, data: bytes) -> int:
        del line, data
        result = next(taken)
        if result is None:
            raise BlockingIOError
        return result

    monkeypatch.setattr(os, "write", write)
    watched.watch._write(bytes(10), is_last=False)
    assert watched.watch._torn == 7, "three of ten went out"
    watched.watch._write(bytes(20), is_last=True)
    assert watched.watch._torn == 7, "nothing of that one did"
    watched.watch._write(bytes(10), is_last=True)
    assert watched.watch._torn == 0
    monkeypatch.setattr(page, "_ROOM_WITHIN_S", (60.0, 60.0))
    taken = iter([3, None, 7])
    watched.watch._write(bytes(10), is_last=True)
    assert watched.watch._torn == 0, "the line was full for a moment"


def test_a_line_is_waited_for_a_second_in_flight_and_30_at_the_end() -> None:
    assert page._ROOM_WITHIN_S == (1.0, 30.0)


@pytest.mark.parametrize(("said", "is_over"), [(page.WAKE, False), (page.OVER, True)])
def test_the_words_of_the_program(listening: Watched, said: bytes, is_over: bool) -> None:
    listening.program.send(said)
    listening.listen(10_000)
    assert (listening.watch._is_over, listening.watch._is_dead) == (is_over, False)


def test_a_program_that_closes_its_socket_is_gone(listening: Watched) -> None:
    listening.program.close()
    listening.listen(10_000)
    assert (listening.watch._is_over, listening.watch._is_dead) == (False, True)
    began = time.monotonic()
    listening.listen(30)  # what has ended does not wake it for ever
    assert time.monotonic() - began >= 0.03


def test_another_parent_is_the_end_of_the_program(
    listening: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "getppid", lambda: 1)
    listening.listen(-5)
    assert listening.watch._is_dead


def test_a_process_that_ends_is_seen_though_a_child_holds_its_socket(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    child = os.fork()
    if not child:
        time.sleep(PATIENCE)
        os._exit(0)
    monkeypatch.setattr(os, "getppid", lambda: child)
    with contextlib.closing(Watched(monkeypatch, is_waiting=False)) as there:
        there.listen(0)
        before = there.watch._is_dead
        os.kill(child, signal.SIGKILL)
        there.listen(1000 * PATIENCE)
        assert (before, there.watch._is_dead) == (False, True)
    os.waitpid(child, 0)


def test_time_passes_by_listening_and_for_a_dead_program_by_reading_its_line(
    watched: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(time, "monotonic", lambda: 100 + watched.now / 1000)
    watched.let_pass(2.5)
    assert watched.waits == pytest.approx([1000, 1000, 500])
    read: list[float] = []

    def drain(seconds: float) -> None:
        read.append(seconds)
        watched.now += 400

    monkeypatch.setattr(watched.watch, "_drain", drain)
    watched.watch._is_dead = True
    watched.let_pass(1.0)
    assert read == pytest.approx([1.0, 0.6, 0.2])


def test_an_empty_line_is_looked_at_for_as_long_as_there_is_time(watched: Watched) -> None:
    began = time.monotonic()
    watched.watch._drain(0.03)
    assert 0.03 <= time.monotonic() - began < 10.0


def test_a_dead_programs_line_is_read_and_one_that_is_closed_ends_it(watched: Watched) -> None:
    watched.aircraft.send(b"telemetry")
    watched.watch._drain(1.0)
    assert not select.select([watched.ends[0]], [], [], 0)[0]
    watched.aircraft.close()
    with pytest.raises(page.LineGone):
        watched.watch._drain(1.0)
    with pytest.raises(page.LineGone):
        watched.watch._write(bytes(10), is_last=True)
    os.close(watched.ends[0].detach())  # POLLNVAL
    with pytest.raises(page.LineGone):
        watched.watch._drain(1.0)


# -- the process ----------------------------------------------------------------------------------


def test_a_token_that_grows_old_ends_the_flight() -> None:
    with program() as there:
        there.publish()
        there.read_to_end()
        assert there.speeds == [0.0] * (3 + 5), "first for the setpoint, then for the flight"
        assert there.aircraft.releases == 1, "the second one has the number of the first"
        assert there.words[page.HOLD] == page.TAKEN
        assert there.process.returncode == 0


def test_a_token_that_is_renewed_keeps_it_silent() -> None:
    for _ in again_and_again():
        with program() as there:
            times = [time.monotonic()]
            there.publish()
            for _ in range(12):
                time.sleep(0.1)
                there.live()
                times.append(time.monotonic())
            is_silent = not select.select([there.master], [], [], 0.0)[0]
            hold = there.words[page.HOLD]
            with contextlib.suppress(OSError):  # it has taken over, and ended
                there.socket.send(page.OVER)
            times.append(time.monotonic())
            if max(later - earlier for earlier, later in pairwise(times)) > 0.25:
                continue  # this process did not renew it: after 0.3 s it sends what stops
            assert (is_silent, hold) == (True, page.FREE)
            assert there.process.wait(timeout=PATIENCE) == 0
            assert not select.select([there.master], [], [], 0.0)[0]
            return
    pytest.fail("this process was kept from renewing it again and again")


def test_a_line_that_is_full_with_half_a_frame_at_its_end() -> None:
    """The aircraft would take the first neutral for the rest of that frame."""
    with program() as there:
        sent = 0
        with contextlib.suppress(BlockingIOError):
            while True:
                sent += os.write(there.line, MOVING)
        there.words[page.UNSENT] = len(MOVING)
        there.publish()
        time.sleep(1.0)
        received = there.read_to_end()
        whole, torn = divmod(sent, len(MOVING))
        assert received.startswith(MOVING * whole + MOVING[:torn])
        assert there.speeds[whole:] == [0.0] * len(there.speeds[whole:])
        assert len(there.speeds) >= whole + 5
        assert there.aircraft.releases == 1


@pytest.mark.parametrize("torn", [1, 11, 12, 13, 30])
def test_a_frame_that_a_kill_cut_off_costs_no_frame_of_the_guardian(torn: int) -> None:
    with program() as there:
        os.write(there.line, MOVING[:torn])
        there.words[page.UNSENT] = len(MOVING)
        there.publish()
        there.read_to_end()
        assert there.speeds == [0.0] * 8
        assert there.aircraft.releases == 1


def test_junk_in_the_page_changes_nothing_that_is_sent() -> None:
    """Whatever writes there, the aircraft gets frames of the last good plan, or nothing."""
    chance = seed()
    for _ in range(4):
        with program() as there:
            there.publish(patience_ms=20_000)
            blocking_until(there.is_read)
            there.socket.send(page.WAKE)
            blocking_until(there.is_read)  # between two words it has looked at the page
            for _ in range(20):
                at = chance.choice([4 * page.TOKEN, 4 * page.UNSENT, page.HALVES_AT])
                junk = chance.randbytes(4 if at < page.HALVES_AT else 2 * page.HALF_SIZE)
                there.page[at : at + len(junk)] = junk
                with contextlib.suppress(OSError):  # it has taken over, by a token of junk
                    there.socket.send(chance.choice([page.WAKE, b"\0", b"xyz"]))
                time.sleep(0.005)
            there.words[page.TOKEN] = page.milliseconds() - 30_000
            with contextlib.suppress(OSError):
                there.socket.send(page.WAKE)
            received = there.read_to_end()
            assert received.replace(NEUTRAL, b"").replace(RELEASE, b"").strip(b"\0") == b""
            assert there.speeds[-5:] == [0.0] * 5
            assert there.aircraft.releases == 1


def test_no_signal_that_can_be_ignored_ends_it() -> None:
    with program() as there:
        there.publish(patience_ms=3000)
        for number in signal.valid_signals() - {signal.SIGKILL, signal.SIGSTOP}:
            os.kill(there.process.pid, number)
        os.kill(there.process.pid, signal.SIGCONT)
        there.words[page.TOKEN] = page.milliseconds() - 10_000
        there.read_to_end()
        assert there.aircraft.releases == 1


def test_without_a_plan_the_end_of_the_program_is_its_own() -> None:
    with program() as there:
        there.live()
        there.socket.close()
        assert there.process.wait(timeout=PATIENCE) == 0
        assert not select.select([there.master], [], [], 0.0)[0]


def test_a_line_that_is_gone_ends_it() -> None:
    with program() as there:
        there.publish(patience_ms=400)
        os.close(there.master)
        assert there.process.wait(timeout=PATIENCE) == 1


def test_it_has_nothing_of_the_program_but_what_it_needs() -> None:
    with open(os.devnull, "rb") as other, program() as there:  # noqa: PTH123 (a descriptor)
        os.set_inheritable(other.fileno(), True)
        there.publish(patience_ms=60_000)
        files = Path(f"/proc/{there.process.pid}/fd")
        opened = [str(one.readlink()) for one in files.iterdir()][3:]
        assert len(opened) <= 4, opened
        assert not any(name == os.devnull for name in opened)


def test_it_stands_on_nothing_of_the_package() -> None:
    """What the program can break, an upgrade in flight among it, must not reach it."""
    code = f"import sys; sys.argv[1:] = []; sys.path.insert(0, {str(Path(page.__file__).parent)!r})"
    code += "; import guardian_process; print(*sys.modules)"
    names = subprocess.run(
        (sys.executable, "-I", "-S", "-c", code), capture_output=True, text=True, check=True
    ).stdout.split()
    assert "guardian_process" in names
    assert not {name for name in names if name.startswith(("m100link", "asyncio", "logging"))}
