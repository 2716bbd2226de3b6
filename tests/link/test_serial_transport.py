"""Every state with every thing that can happen in it, and Ctrl-C between any two lines."""

from __future__ import annotations

import asyncio
import errno
import sys
import termios
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

import pytest

from m100link.link import serial_transport
from m100link.link.serial_transport import PortState, SerialTransport
from tests.link.line import Bench, Recorder

GONE = OSError(errno.EIO, "Input/output error")


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    return Bench(monkeypatch)


# -- every state with every thing that happens ----------------------------------------------------


def block(bench: Bench) -> None:
    bench.line.room = 0
    bench.transport.write(b"waiting")


def block_full(bench: Bench) -> None:
    bench.line.room = 0
    bench.transport.write(bytes(3000))


def close_blocked(bench: Bench) -> None:
    block(bench)
    bench.transport.close()


def end(bench: Bench) -> None:
    bench.transport.abort()
    bench.loop.run()


STATES: dict[str, Callable[[Bench], None]] = {
    "flowing": lambda _: None,
    "blocked": block,
    "full": block_full,
    "not reading": lambda bench: bench.transport.pause_reading(),
    "closing": close_blocked,
    "ending": lambda bench: bench.transport.abort(),
    "closed": end,
}


def room(bench: Bench) -> None:
    bench.line.room = 1_000_000
    bench.loop.run()


def arrive(bench: Bench) -> None:
    bench.line.incoming.append(b"news")
    bench.loop.run()


def hang_up(bench: Bench) -> None:
    bench.line.incoming.append(b"")
    bench.loop.run()


def fail_reading(bench: Bench) -> None:
    bench.line.incoming.append(GONE)
    bench.loop.run()


def fail_writing(bench: Bench) -> None:
    bench.line.errors.append(GONE)
    bench.transport.write(b"x")
    bench.loop.run()


def then_run(act: Callable[[SerialTransport], None]) -> Callable[[Bench], None]:
    def happen(bench: Bench) -> None:
        act(bench.transport)
        bench.loop.run()

    return happen


EVENTS: dict[str, Callable[[Bench], None]] = {
    "write": then_run(lambda transport: transport.write(b"frame")),
    "room": room,
    "bytes": arrive,
    "hang-up": hang_up,
    "read error": fail_reading,
    "write error": fail_writing,
    "pause": then_run(lambda transport: transport.pause_reading()),
    "resume": then_run(lambda transport: transport.resume_reading()),
    "close": then_run(lambda transport: transport.close()),
    "abort": then_run(lambda transport: transport.abort()),
}

OPEN, CLOSING, CLOSED = PortState.OPEN, PortState.CLOSING, PortState.CLOSED
# Per state and event: the state after it, bytes unsent, bytes sent, and the calls of the protocol.
TABLE: dict[str, dict[str, tuple[PortState, int, bytes, str]]] = {
    "flowing": {
        "write": (OPEN, 0, b"frame", ""),
        "room": (OPEN, 0, b"", ""),
        "bytes": (OPEN, 0, b"", "news"),
        "hang-up": (CLOSED, 0, b"", "lost, hung up"),
        "read error": (CLOSED, 0, b"", "lost, error"),
        "write error": (CLOSED, 1, b"", "lost, error"),
        "pause": (OPEN, 0, b"", ""),
        "resume": (OPEN, 0, b"", ""),
        "close": (CLOSED, 0, b"", "lost"),
        "abort": (CLOSED, 0, b"", "lost"),
    },
    "blocked": {
        "write": (OPEN, 12, b"", ""),
        "room": (OPEN, 0, b"waiting", ""),
        "bytes": (OPEN, 7, b"", "news"),
        "hang-up": (CLOSED, 7, b"", "lost, hung up"),
        "read error": (CLOSED, 7, b"", "lost, error"),
        "write error": (CLOSED, 8, b"", "lost, error"),
        "pause": (OPEN, 7, b"", ""),
        "resume": (OPEN, 7, b"", ""),
        "close": (CLOSING, 7, b"", ""),
        "abort": (CLOSED, 7, b"", "lost"),
    },
    "full": {
        "write": (OPEN, 3005, b"", "paused"),
        "room": (OPEN, 0, bytes(3000), "paused, resumed"),
        "bytes": (OPEN, 3000, b"", "paused, news"),
        "hang-up": (CLOSED, 3000, b"", "paused, lost, hung up"),
        "read error": (CLOSED, 3000, b"", "paused, lost, error"),
        "write error": (CLOSED, 3001, b"", "paused, lost, error"),
        "pause": (OPEN, 3000, b"", "paused"),
        "resume": (OPEN, 3000, b"", "paused"),
        "close": (CLOSING, 3000, b"", "paused"),
        "abort": (CLOSED, 3000, b"", "paused, lost"),
    },
    "not reading": {
        "write": (OPEN, 0, b"frame", ""),
        "room": (OPEN, 0, b"", ""),
        "bytes": (OPEN, 0, b"", ""),
        "hang-up": (OPEN, 0, b"", ""),
        "read error": (OPEN, 0, b"", ""),
        "write error": (CLOSED, 1, b"", "lost, error"),
        "pause": (OPEN, 0, b"", ""),
        "resume": (OPEN, 0, b"", ""),
        "close": (CLOSED, 0, b"", "lost"),
        "abort": (CLOSED, 0, b"", "lost"),
    },
    "closing": {
        "write": (CLOSING, 7, b"", ""),
        "room": (CLOSED, 0, b"waiting", "lost"),
        "bytes": (CLOSING, 7, b"", ""),
        "hang-up": (CLOSING, 7, b"", ""),
        "read error": (CLOSING, 7, b"", ""),
        "write error": (CLOSED, 7, b"", "lost, error"),
        "pause": (CLOSING, 7, b"", ""),
        "resume": (CLOSING, 7, b"", ""),
        "close": (CLOSING, 7, b"", ""),
        "abort": (CLOSED, 7, b"", "lost"),
    },
    "ending": dict.fromkeys(EVENTS, (CLOSED, 0, b"", "lost")),
    "closed": dict.fromkeys(EVENTS, (CLOSED, 0, b"", "lost")),
}


def told(protocol: Recorder) -> str:
    """The calls of the protocol, in words."""
    words = ["paused"] if "pause" in protocol.told else []
    words += ["resumed"] if "resume" in protocol.told else []
    words += [data.decode() for data in protocol.received]
    for error in protocol.errors:
        words.append("lost")
        if error is not None:
            words.append("hung up" if "hung up" in str(error) else "error")
    return ", ".join(words)


@pytest.mark.parametrize("event", EVENTS)
@pytest.mark.parametrize("state", STATES)
def test_every_state_and_event(bench: Bench, state: str, event: str) -> None:
    STATES[state](bench)
    EVENTS[event](bench)
    after, unsent, sent, said = TABLE[state][event]
    transport = bench.transport
    assert (transport.state, transport.get_write_buffer_size()) == (after, unsent)
    assert (bench.line.sent, told(bench.protocol)) == (sent, said)
    # What follows from the state, whichever way led there.
    assert bench.line.is_open is (after is not CLOSED)
    assert transport.is_closing() is (after is not OPEN)
    is_watched = (
        after is OPEN and event != "pause" and (state != "not reading" or event == "resume")
    )
    assert (bench.loop.reader is not None) is is_watched is transport.is_reading()
    assert (bench.loop.writer is not None) is (after is not CLOSED and unsent > 0)
    # However it ended, it stays ended.
    bench.transport.abort()
    bench.loop.run()
    bench.transport.abort()
    bench.transport.close()
    bench.loop.run()
    assert bench.protocol.told.count("lost") == 1
    # Bytes for a line that takes none must not make closing wait. Where all have left, nothing is
    # dropped: on a pseudo-terminal that would be what the other end has yet to read.
    assert bench.line.calls == ["reset_output_buffer"] * (unsent > 0) + ["close"]


def test_bytes_that_the_system_holds_do_not_make_closing_wait(bench: Bench) -> None:
    bench.line.out_waiting = 1
    bench.transport.abort()
    bench.loop.run()
    assert bench.line.calls == ["reset_output_buffer", "close"]


def test_the_table_is_whole() -> None:
    assert set(TABLE) == set(STATES)
    assert all(set(row) == set(EVENTS) for row in TABLE.values())


# -- what the system may answer -------------------------------------------------------------------


@pytest.mark.parametrize("error", [BlockingIOError(), InterruptedError()])
def test_a_read_that_brings_nothing_changes_nothing(bench: Bench, error: OSError) -> None:
    bench.line.incoming += [error, b"news"]
    bench.loop.run()
    assert bench.protocol.received == [b"news"]
    assert bench.transport.state is OPEN


@pytest.mark.parametrize("error", [BlockingIOError(), InterruptedError()])
def test_a_write_that_takes_nothing_is_made_again(bench: Bench, error: OSError) -> None:
    bench.line.errors += [error, error]
    bench.transport.write(b"frame")
    assert bench.transport.get_write_buffer_size() == 5
    bench.loop.run()
    assert bench.line.sent == b"frame"
    assert bench.loop.writer is None


def test_a_frame_taken_in_part_is_finished_before_the_next(bench: Bench) -> None:
    bench.line.room = 3
    bench.transport.write(b"first")
    bench.transport.write(b"second")
    assert bench.line.sent == b"fir"
    for _ in range(20):
        bench.line.room += 1
        bench.loop.run()
    assert bench.line.sent == b"firstsecond"
    assert bench.loop.writer is None


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview])
def test_any_bytes_will_do_and_may_change_afterwards(
    bench: Bench, kind: Callable[[bytearray], bytes]
) -> None:
    bench.line.room = 0
    data = bytearray(b"frame")
    bench.transport.write(kind(data))
    data[:] = b"xxxxx"
    room(bench)
    assert bench.line.sent == b"frame"


def test_no_bytes_are_no_write(bench: Bench) -> None:
    bench.transport.write(b"")
    assert bench.line.sent == b""
    assert bench.transport.get_write_buffer_size() == 0


def test_the_loop_is_asked_for_room_only_when_there_is_none(bench: Bench) -> None:
    for _ in range(10):
        bench.transport.write(b"frame")
        assert bench.loop.writer is None
        assert not bench.loop.ready


def test_a_protocol_that_does_not_pause_is_bounded(bench: Bench) -> None:
    bench.line.room = 0
    for number in range(200):
        bench.transport.write(bytes([number]) * 1000)
    assert bench.transport.get_write_buffer_size() == 65_000
    assert bench.transport.dropped == 135
    assert bench.protocol.told == ["made", "pause"]
    room(bench)
    assert bench.line.sent == b"".join(bytes([number]) * 1000 for number in range(65))
    assert bench.protocol.told == ["made", "pause", "resume"]


def test_writing_goes_on_at_a_quarter_of_the_limit(bench: Bench) -> None:
    block_full(bench)
    bench.line.room = 2487
    bench.loop.run()
    assert bench.transport.get_write_buffer_size() == 513
    assert bench.protocol.told == ["made", "pause"]
    bench.line.room = 1
    bench.loop.run()
    assert bench.protocol.told == ["made", "pause", "resume"]


def test_a_protocol_that_writes_when_resumed_is_paused_again(bench: Bench) -> None:
    def write_more() -> None:
        bench.protocol.told.append("resume")
        bench.line.room = 0
        bench.transport.write(bytes(2500))

    bench.protocol.resume_writing = write_more  # type: ignore[method-assign]
    block_full(bench)
    bench.line.room = 3000
    bench.loop.run()
    assert bench.protocol.told == ["made", "pause", "resume", "pause"]
    assert bench.transport.get_write_buffer_size() == 2500
    assert bench.loop.writer is not None


def test_one_read_per_turn(bench: Bench) -> None:
    bench.line.incoming += [b"a", b"b", b"c"]
    bench.loop.turn()
    assert bench.protocol.received == [b"a"]


def test_a_protocol_that_pauses_in_a_read_gets_no_more(bench: Bench) -> None:
    def pause(data: bytes) -> None:
        bench.protocol.received.append(data)
        bench.transport.pause_reading()

    bench.protocol.data_received = pause  # type: ignore[method-assign]
    bench.line.incoming += [b"a", b"b"]
    bench.loop.run()
    assert bench.protocol.received == [b"a"]
    bench.transport.resume_reading()
    bench.loop.run()
    assert bench.protocol.received == [b"a", b"b"]


def test_what_a_cut_off_turn_left_comes_when_reading_goes_on(bench: Bench) -> None:
    """Ctrl-C came between the read and the delivery, and the protocol paused before the next."""
    bench.transport._arrived.append(b"left")
    bench.transport.pause_reading()
    bench.loop.run()
    assert bench.protocol.received == []
    bench.transport.resume_reading()
    bench.loop.run()
    assert bench.protocol.received == [b"left"]


@pytest.mark.parametrize("end", [SerialTransport.close, SerialTransport.abort])
def test_nothing_comes_after_the_end_that_the_protocol_asked_for(
    bench: Bench, end: Callable[[SerialTransport], None]
) -> None:
    def take(data: bytes) -> None:
        bench.protocol.received.append(data)
        end(bench.transport)

    bench.protocol.data_received = take  # type: ignore[method-assign]
    bench.transport.pause_reading()
    bench.transport._arrived += [b"left", b"over", b""]
    bench.transport.resume_reading()
    bench.loop.run()
    assert bench.protocol.received == [b"left"]
    assert bench.protocol.told[-1] == "lost"


def test_an_error_of_the_protocol_is_the_loops_and_the_bytes_are_gone(bench: Bench) -> None:
    def fail(data: bytes) -> None:
        bench.protocol.received.append(data)
        raise ValueError("no")

    bench.protocol.data_received = fail  # type: ignore[method-assign]
    bench.line.incoming += [b"a"]
    with pytest.raises(ValueError, match="no"):
        bench.loop.run()
    bench.loop.run()
    assert bench.protocol.received == [b"a"]
    assert bench.transport.state is OPEN


@pytest.mark.parametrize("error", [GONE, termios.error(errno.EIO, "Input/output error")])
@pytest.mark.parametrize("step", ["reset_output_buffer", "close"])
def test_a_port_that_fails_at_its_end_has_ended_all_the_same(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, step: str, error: Exception
) -> None:
    """What the terminal layer raises is no OSError."""

    def fail() -> None:
        raise error

    block(bench)
    monkeypatch.setattr(bench.line, step, fail)
    bench.transport.abort()
    bench.loop.run()
    assert bench.transport.state is CLOSED
    assert bench.protocol.errors == [None]


def test_what_asyncio_asks_of_a_transport(bench: Bench) -> None:
    assert bench.transport.get_extra_info("serial") is bench.line
    assert bench.transport.can_write_eof() is False
    assert isinstance(bench.transport, asyncio.Transport)


# -- Ctrl-C between any two lines -----------------------------------------------------------------


class Interrupt:
    """Raises KeyboardInterrupt before the line (or instruction) of that number in the transport."""

    def __init__(self, number: int, *, instructions: bool = False) -> None:
        self.left = number
        self.instructions = instructions
        self.came_in = ""

    def __enter__(self) -> None:
        self._before = sys.gettrace()  # what measures coverage has to go on
        sys.settrace(self._enter)

    def __exit__(self, *_: object) -> None:
        sys.settrace(self._before)

    def _enter(self, frame: FrameType, event: str, _: object) -> Any:
        if frame.f_code.co_filename != serial_transport.__file__:
            return None
        if self.instructions and frame.f_code.co_name == "_deliver":
            return None  # handing a chunk over is one line, and not one instruction
        frame.f_trace_opcodes = self.instructions
        return self._trace

    def _trace(self, frame: FrameType, event: str, _: object) -> Any:
        if event == ("opcode" if self.instructions else "line") and not self.came_in:
            self.left -= 1
            if self.left < 0:
                self.came_in = f"{frame.f_code.co_name}:{frame.f_lineno}"
                raise KeyboardInterrupt
        return self._trace


class Interrupted:
    """A life of a transport in which one KeyboardInterrupt comes, and everything goes on."""

    def __init__(self, bench: Bench, interrupt: Interrupt) -> None:
        self.bench = bench
        self.interrupt = interrupt
        # What the caller of a write that was cut off does not know.
        self.uncertain: bytes | None = None
        self.accepted: list[bytes] = []

    def write(self, data: bytes) -> None:
        try:
            with self.interrupt:
                self.bench.transport.write(data)
        except KeyboardInterrupt:
            self.uncertain = data
        self.accepted.append(data)

    def do(self, act: Callable[[], None]) -> None:
        """Something that a caller repeats when it was cut off."""
        try:
            with self.interrupt:
                act()
        except KeyboardInterrupt:
            act()

    def run(self) -> None:
        self.do(self.bench.loop.run)

    def was_sent(self) -> bool:
        """Whether each frame left whole and in order, but perhaps the one that was cut off."""
        possible = [self.accepted]
        if self.uncertain is not None:
            possible.append([data for data in self.accepted if data != self.uncertain])
        return self.bench.line.sent in [b"".join(frames) for frames in possible]


def writing(life: Interrupted) -> None:
    """Through a line that takes all, a part, nothing, and all again."""
    line = life.bench.line
    life.write(b"<first>")
    line.room = 3
    life.write(b"<second>")
    life.write(b"<third>")
    life.run()
    line.room = 9
    life.run()
    life.write(b"<" + bytes(2500) + b">")
    line.room = 1_000_000
    life.run()
    life.write(b"<last>")
    life.run()
    assert life.was_sent(), life.interrupt.came_in
    assert life.bench.transport.get_write_buffer_size() == 0
    assert life.bench.loop.writer is None, "it would be called for ever"
    # Paused and resumed: never left paused.
    assert life.bench.protocol.told[-1] in ("made", "resume")


def reading(life: Interrupted) -> None:
    """Chunks that come one by one, then a pause, then more."""
    line, transport = life.bench.line, life.bench.transport
    line.incoming += [b"a", b"b", BlockingIOError(), b"c"]
    life.run()
    life.do(transport.pause_reading)
    line.incoming += [b"d"]
    life.run()
    life.do(transport.resume_reading)
    life.run()
    assert life.bench.protocol.received == [b"a", b"b", b"c", b"d"], life.interrupt.came_in
    assert life.bench.loop.reader is not None


def ends(happen: Callable[[Interrupted], None]) -> Callable[[Interrupted], None]:
    def live(life: Interrupted) -> None:
        happen(life)
        life.run()
        bench = life.bench
        assert bench.transport.state is PortState.CLOSED, life.interrupt.came_in
        assert bench.line.calls[-1] == "close"
        assert not bench.line.is_open
        assert bench.loop.reader is None
        assert bench.loop.writer is None
        assert "lost" in bench.protocol.told

    return live


def close_a_blocked_line(life: Interrupted) -> None:
    life.bench.line.room = 2
    life.write(b"<first>")
    life.do(life.bench.transport.close)
    life.run()
    life.bench.line.room = 100
    life.run()
    assert life.was_sent(), life.interrupt.came_in


def pull_the_plug(life: Interrupted) -> None:
    life.bench.line.incoming += [b"last words", GONE]
    life.run()
    assert life.bench.protocol.received == [b"last words"]


def pull_the_plug_of_a_blocked_line(life: Interrupted) -> None:
    life.bench.line.room = 2
    life.write(b"<first>")
    life.bench.line.incoming += [b""]
    life.bench.line.errors += [GONE]
    life.run()


LIVES = {
    "writing": writing,
    "reading": reading,
    "close": ends(lambda life: life.do(life.bench.transport.close)),
    "close, blocked": ends(close_a_blocked_line),
    "abort": ends(lambda life: life.do(life.bench.transport.abort)),
    "unplugged": ends(pull_the_plug),
    "unplugged, blocked": ends(pull_the_plug_of_a_blocked_line),
}


def interrupted_everywhere(
    monkeypatch: pytest.MonkeyPatch, live: Callable[[Interrupted], None], *, instructions: bool
) -> Iterator[str]:
    """Live once per line (or instruction) with a KeyboardInterrupt before it."""
    for number in range(10_000):
        bench = Bench(monkeypatch)
        interrupt = Interrupt(number, instructions=instructions)
        live(Interrupted(bench, interrupt))
        if not interrupt.came_in:
            return
        yield interrupt.came_in
    raise AssertionError("it has no end")


@pytest.mark.parametrize("life", LIVES)
def test_ctrl_c_between_any_two_lines(monkeypatch: pytest.MonkeyPatch, life: str) -> None:
    lines = list(interrupted_everywhere(monkeypatch, LIVES[life], instructions=False))
    assert len(lines) > 10


@pytest.mark.parametrize("life", LIVES)
def test_ctrl_c_between_any_two_instructions(monkeypatch: pytest.MonkeyPatch, life: str) -> None:
    lines = list(interrupted_everywhere(monkeypatch, LIVES[life], instructions=True))
    assert len(lines) > 50
