"""The guardian's own process, with a test in place of the program: junk, a full line, signals."""

from __future__ import annotations

import contextlib
import mmap
import os
import random
import select
import signal
import socket
import subprocess
import sys
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from m100link.flight import guardian_process as page
from tests.flight.foreign_aircraft import ForeignMatrice, frame
from tests.waiting import PATIENCE

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

    def read_to_end(self) -> bytes:
        """What the aircraft gets until the guardian has done its work."""
        received = b""
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            if select.select([self.master], [], [], 0.1)[0]:
                received += os.read(self.master, 4096)
            elif self.process.poll() is not None:
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


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="do not fit"):
        page.sealed(1, 600, [(LAST, 0, 1, bytes(1000))] * 20)


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
    with program() as there:
        there.publish()
        for _ in range(12):
            time.sleep(0.1)
            there.live()
        assert not select.select([there.master], [], [], 0.0)[0]
        assert there.words[page.HOLD] == page.FREE
        there.socket.send(page.OVER)
        assert there.process.wait(timeout=PATIENCE) == 0
        assert not select.select([there.master], [], [], 0.0)[0]


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
            there.publish()
            time.sleep(0.1)  # it has read that
            for _ in range(20):
                at = chance.choice([4 * page.TOKEN, 4 * page.UNSENT, page.HALVES_AT])
                junk = chance.randbytes(4 if at < page.HALVES_AT else 2 * page.HALF_SIZE)
                there.page[at : at + len(junk)] = junk
                with contextlib.suppress(OSError):  # it has taken over, by a token of junk
                    there.socket.send(chance.choice([page.WAKE, b"\0", b"xyz"]))
                time.sleep(0.005)
            there.words[page.TOKEN] = page.milliseconds() - 10_000
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
        there.publish()
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
