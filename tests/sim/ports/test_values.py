"""The pseudo-terminal by a clock that the test moves: its names, its rate, what waits, what is old.

What needs a program that reads in real time is in test_pty.py.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import termios
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import pytest

from m100link.errors import PortBusy, PortFailed
from m100link.sim import AssistantSettings, Driver, PtyPort, VirtualAircraft
from m100link.sim.ports.driver import Backlog, StreamPort
from m100link.wire import FrameDecoder, encode_frame
from tests.waiting import blocking_until


class Clock:
    """As much of an event loop as a port asks for; nothing runs by itself."""

    def __init__(self) -> None:
        self.now = 50.0
        self.readers: dict[int, Any] = {}
        self.writers: dict[int, Any] = {}

    def time(self) -> float:
        return self.now

    def is_closed(self) -> bool:
        return False

    def call_at(self, _when: float, _call: Any) -> Clock:
        return self

    def when(self) -> float:
        return self.now + 0.01

    def cancel(self) -> None:
        """Nothing runs by itself."""

    def add_reader(self, file: int, call: Any) -> None:
        self.readers[file] = call

    def add_writer(self, file: int, call: Any) -> None:
        self.writers[file] = call

    def remove_reader(self, file: int) -> None:
        self.readers.pop(file, None)

    def remove_writer(self, file: int) -> None:
        self.writers.pop(file, None)


class Desk:
    """A port, and a program that has its terminal open."""

    def __init__(self, link: Path | None = None, **options: Any) -> None:
        self.clock = Clock()
        assistant = AssistantSettings(baud_rate=options.pop("baud_rate", 230_400))
        self.driver = Driver(VirtualAircraft(assistant=assistant), cast(Any, self.clock))
        self.port = PtyPort(self.driver, link=link, **options)
        self.program = os.open(self.port.device, os.O_RDWR | os.O_NONBLOCK | os.O_NOCTTY)
        self.heard: list[bytes] = []
        cast(Any, self.driver).receive = self.heard.append  # in place of the aircraft

    def set_rate(self, code: int) -> None:
        attributes = termios.tcgetattr(self.program)
        attributes[4] = attributes[5] = code
        termios.tcsetattr(self.program, termios.TCSANOW, attributes)

    def read(self, count: int) -> bytes:
        """What the program reads, so much at least."""
        found = b""

        def enough() -> bool:
            nonlocal found
            with contextlib.suppress(BlockingIOError):
                found += os.read(self.program, 65_536)
            return len(found) >= count

        blocking_until(enough)
        return found

    def say(self, data: bytes) -> bytes:
        """What the aircraft hears of what the program says."""
        os.write(self.program, data)
        [call] = self.clock.readers.values()

        def heard() -> bool:
            call()
            return len(b"".join(self.heard)) >= len(data)

        self.heard.clear()
        blocking_until(heard)
        return b"".join(self.heard)

    def close(self) -> None:
        os.close(self.program)
        self.driver.stop()


@pytest.fixture
def desks() -> Iterator[list[Desk]]:
    made: list[Desk] = []
    yield made
    for desk in made:
        desk.close()


FRAME = encode_frame(b"\x02\x00\x01\x02\x03", session=0, sequence=7)


# -- its names ------------------------------------------------------------------------------------


def test_a_link_leads_to_the_terminal_as_long_as_it_is_its_own(tmp_path: Path) -> None:
    link = tmp_path / "ttyUSB0"
    desk = Desk(link)
    port, device = desk.port, desk.port.device
    assert device.startswith("/dev/pts/")
    assert (port.name, str(link.readlink())) == (str(link), device)
    assert [one.name for one in tmp_path.iterdir()] == ["ttyUSB0"]
    port._make_link(link)  # it leads here already
    port.unplug()
    assert not link.is_symlink()
    assert desk.clock.readers == {}
    port.write([FRAME])  # to nobody
    port.replug()
    assert str(link.readlink()) == port.device
    port.replug()
    assert len(desk.clock.readers) == 1, "it is plugged in already"
    link.unlink()
    link.symlink_to("/dev/null")
    desk.close()
    assert str(link.readlink()) == "/dev/null"
    assert desk.driver.ports == []
    plain = Desk()
    assert plain.port.name == plain.port.device
    plain.close()


@pytest.mark.parametrize(
    ("there", "says"),
    [
        ("nothing", ""),
        ("dead link", ""),
        ("live link", "leads to /dev/null already"),
        ("file", "is not a symbolic link"),
        ("folder", "is not a symbolic link"),
        ("no folder for it", "cannot be made"),
    ],
)
def test_a_link_takes_the_place_of_a_dead_one_alone(tmp_path: Path, there: str, says: str) -> None:
    link = tmp_path / "ttyUSB0"
    if there == "dead link":
        link.symlink_to(tmp_path / "gone")
    elif there == "live link":
        link.symlink_to("/dev/null")
    elif there == "file":
        link.write_text("precious")
    elif there == "folder":
        link.mkdir()
    elif there == "no folder for it":
        link = tmp_path / "missing" / "ttyUSB0"
    if not says:
        desk = Desk(link)
        assert str(link.readlink()) == desk.port.device
        desk.close()
        return
    driver = Driver(VirtualAircraft(), cast(Any, Clock()))
    kind = PortFailed if there == "no folder for it" else PortBusy
    with pytest.raises(kind, match=says):
        PtyPort(driver, link=link)
    assert link.exists() is (there != "no folder for it")
    assert driver.ports == []


# -- its rate -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("aircraft", "code", "follows", "is_understood"),
    [
        (230_400, None, True, True),  # a program that says nothing fits
        (230_400, termios.B230400, True, True),
        (230_400, termios.B115200, True, False),
        (115_200, None, True, True),
        (115_200, termios.B230400, True, False),
        (230_400, termios.B115200, False, True),
    ],
)
def test_another_rate_makes_nonsense_of_as_many_bytes_both_ways(
    desks: list[Desk], aircraft: int, code: int | None, follows: bool, is_understood: bool
) -> None:
    options: dict[str, Any] = {} if follows else {"follow_baud_rate": False}
    desk = Desk(baud_rate=aircraft, **options)
    desks.append(desk)
    if code is not None:
        desk.set_rate(code)
    desk.port.write([FRAME])
    read = desk.read(len(FRAME))
    heard = desk.say(FRAME)
    assert len(read) == len(heard) == len(FRAME)
    assert (read == FRAME, heard == FRAME) == (is_understood, is_understood)
    assert bool(FrameDecoder().feed(read)) is is_understood


# -- what waits, and what is old ------------------------------------------------------------------


def test_what_the_terminal_cannot_hold_waits_in_whole_frames(desks: list[Desk]) -> None:
    """The newest 256 frames, and the rest of the one that is half written."""
    desk = Desk()
    desks.append(desk)
    port, number = desk.port, 0
    while not port._partial or len(port.backlog) < 256 or port.backlog.dropped < 10:
        push = b"\x02\x00" + bytes(101)
        port.write([encode_frame(push, session=0, sequence=number)])
        number += 1
        assert number < 5000
    assert len(port.backlog) == 256
    assert list(desk.clock.writers) == [port._master]
    decoder, found = FrameDecoder(), list[int]()

    def drained() -> bool:
        with contextlib.suppress(BlockingIOError):
            frames = decoder.feed(os.read(desk.program, 65_536))
            found.extend(frame.sequence for frame in frames)
        for call in list(desk.clock.writers.values()):
            call()
        return found[-1:] == [number - 1]

    blocking_until(drained)
    assert decoder.discarded_bytes == 0
    assert found[-256:] == list(range(number - 256, number))
    assert len(found) == number - port.backlog.dropped
    assert (desk.clock.writers, port._partial, len(port.backlog)) == ({}, b"", 0)


def test_bytes_that_nobody_read_for_more_than_a_second_are_thrown_away(desks: list[Desk]) -> None:
    """4000 bytes are a full terminal; it is looked at with each write."""
    desk = Desk()
    desks.append(desk)
    port, clock = desk.port, desk.clock

    def fill(count: int) -> None:
        port.write([bytes(count)])
        blocking_until(lambda: port.unread >= count)

    fill(3999)
    clock.now += 5.0
    port.write([])
    assert (port.flushes, port.unread) == (0, 3999), "it is not full"
    desk.read(3999)
    fill(4050)
    port.write([])
    clock.now += 0.5
    desk.read(4050)
    port.write([])
    fill(4050)
    for passes, flushes in ((0.0, 0), (1.0, 0), (0.01, 1)):
        clock.now += passes
        port.write([])
        assert port.flushes == flushes
    assert port.unread == 0
    assert desk.clock.writers == {}


def test_frames_that_no_terminal_took_for_more_than_a_second_are_dropped(desks: list[Desk]) -> None:
    desk = Desk()
    desks.append(desk)
    port, clock = desk.port, desk.clock

    def is_full() -> bool:  # the system carries bytes on behind the writer, and makes room again
        port.write([FRAME] * 100)
        return port.unread >= 4000 and len(port.backlog) > 200

    blocking_until(is_full)
    waiting, dropped = len(port.backlog), port.backlog.dropped
    clock.now += 1.0
    port._drain()
    assert (len(port.backlog), port.backlog.dropped) == (waiting, dropped)
    is_half_written = bool(port._partial)
    clock.now += 0.01
    port._drain()
    lost = waiting + is_half_written
    assert (len(port.backlog), port.backlog.dropped, port._partial) == (0, dropped + lost, b"")


# -- a stream, and its reader who does not keep up ------------------------------------------------


class Pipe(asyncio.Transport):
    """Keeps what is written."""

    def __init__(self) -> None:
        super().__init__()
        self.sent: list[bytes] = []
        self.limit: int | None = None
        self.ended = ""

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        self.limit = high

    def write(self, data: Any) -> None:
        self.sent.append(bytes(data))

    def abort(self) -> None:
        self.ended = "aborted"

    def close(self) -> None:
        self.ended = "closed"


def test_a_stream_holds_16_kilobytes_and_then_the_newest_frames() -> None:
    """Less than two seconds of telemetry, for what is old in flight is of no use."""
    driver = Driver(VirtualAircraft(), cast(Any, Clock()))
    port, pipe = StreamPort(driver), Pipe()
    port.write([FRAME])  # nobody is there
    port.connection_made(pipe)
    assert (pipe.limit, driver.ports) == (16_384, [port])
    port.write([FRAME])
    port.write([FRAME, b"12"])
    port.pause_writing()
    port.write([b"3", b"4"])
    assert pipe.sent == [FRAME, FRAME + b"12"]
    port.resume_writing()
    assert pipe.sent[2:] == [b"34"]
    port.resume_writing()
    port.write([b"5"])
    assert pipe.sent[3:] == [b"5"]
    port.unplug()
    assert pipe.ended == "aborted"
    port.close()
    assert pipe.ended == "closed"
    port.connection_lost(None)
    assert driver.ports == []
    driver.aircraft.unplug()
    refused = Pipe()
    StreamPort(driver).connection_made(refused)
    assert (refused.ended, driver.ports) == ("aborted", [])
    with pytest.raises(ConnectionRefusedError):
        driver.connect(asyncio.Protocol())
    driver.stop()


def test_of_257_frames_the_oldest_telemetry_goes_or_else_the_oldest() -> None:
    backlog, answers = Backlog(), [bytes([n, 1]) for n in range(256)]
    backlog.extend([*answers[:2], FRAME, *answers[2:]])
    assert (backlog.take(), backlog.dropped) == (answers, 1)
    backlog.extend([*answers, b"x", b"y"])
    assert (backlog.take(), backlog.dropped) == ([*answers[2:], b"x", b"y"], 3)
    backlog.extend([b"x", b"y"])
    backlog.clear()
    assert (len(backlog), backlog.dropped) == (0, 5)
