"""A serial port, a system and an event loop of which a test decides each answer."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from typing import cast

import pytest

from m100link.link import serial_transport
from m100link.link.serial_transport import SerialTransport

FD = 7


def is_lasting(answer: bytes | OSError) -> bool:
    """A device that is gone stays gone."""
    return answer == b"" or not isinstance(answer, bytes | BlockingIOError | InterruptedError)


class Line:
    """The port, and what stands in for ``os`` in the transport.

    Attributes:
        incoming: What each read returns or raises; nothing in it: EAGAIN.
        sent: What the system took.
        room: Bytes that it takes yet.
        errors: What the next writes raise.
        calls: What was asked of the port.
        out_waiting: What the system holds for the line.
    """

    def __init__(self) -> None:
        self.incoming: deque[bytes | OSError] = deque()
        self.sent = b""
        self.room = 1_000_000
        self.errors: deque[OSError] = deque()
        self.calls: list[str] = []
        self.is_open = True
        self.out_waiting = 0

    # the port

    def fileno(self) -> int:
        return FD

    def reset_output_buffer(self) -> None:
        self.calls.append("reset_output_buffer")

    def close(self) -> None:
        self.calls.append("close")
        self.is_open = False

    # the system

    def set_blocking(self, fd: int, blocking: bool) -> None:
        assert (fd, blocking) == (FD, False)

    def read(self, fd: int, size: int) -> bytes:
        assert fd == FD
        assert self.is_open
        if not self.incoming:
            raise BlockingIOError
        answer = self.incoming[0]
        if not is_lasting(answer):
            self.incoming.popleft()
        if isinstance(answer, OSError):
            raise answer
        assert len(answer) <= size
        return answer

    def write(self, fd: int, data: bytes) -> int:
        assert fd == FD
        assert self.is_open
        assert data
        if self.errors:
            raise self.errors[0] if is_lasting(self.errors[0]) else self.errors.popleft()
        taken = min(self.room, len(data))
        if not taken:
            raise BlockingIOError
        self.sent += data[:taken]
        self.room -= taken
        return taken


class Loop:
    """Who watches the line; a turn is a call."""

    def __init__(self, line: Line) -> None:
        self.line = line
        self.reader: Callable[[], None] | None = None
        self.writer: Callable[[], None] | None = None
        self.ready: deque[Callable[[], None]] = deque()
        self.turns = 0

    def add_reader(self, fd: int, callback: Callable[[], None]) -> None:
        assert fd == FD
        assert self.line.is_open
        self.reader = callback

    def remove_reader(self, fd: int) -> bool:
        assert self.line.is_open
        self.reader = None
        return True

    def add_writer(self, fd: int, callback: Callable[[], None]) -> None:
        assert fd == FD
        assert self.line.is_open
        self.writer = callback

    def remove_writer(self, fd: int) -> bool:
        assert self.line.is_open
        self.writer = None
        return True

    def call_soon(self, callback: Callable[..., None], *args: object) -> None:
        self.ready.append(lambda: callback(*args))

    def turn(self) -> bool:
        """One turn; whether there was anything to do."""
        callbacks = []
        if self.reader is not None and self.line.incoming:
            callbacks.append(self.reader)
        if self.writer is not None and (self.line.room or self.line.errors):
            callbacks.append(self.writer)
        callbacks += self.ready
        self.ready.clear()
        while callbacks:
            try:
                callbacks.pop(0)()
            except BaseException:
                self.ready.extendleft(reversed([c for c in callbacks if c is not self.writer]))
                raise
        self.turns += 1
        return bool(self.ready or self._is_due())

    def _is_due(self) -> bool:
        return bool(
            (self.reader is not None and self.line.incoming)
            or (self.writer is not None and (self.line.room or self.line.errors))
        )

    def run(self) -> None:
        """Turn until there is nothing to do."""
        for _ in range(50):
            if not self.turn():
                return
        raise AssertionError("the loop spins")


class Recorder(asyncio.Protocol):
    """A protocol that writes down its calls."""

    def __init__(self) -> None:
        self.told: list[str] = []
        self.received: list[bytes] = []
        self.errors: list[Exception | None] = []

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.told.append("made")

    def data_received(self, data: bytes) -> None:
        self.received.append(data)

    def pause_writing(self) -> None:
        self.told.append("pause")

    def resume_writing(self) -> None:
        self.told.append("resume")

    def connection_lost(self, exc: Exception | None) -> None:
        self.told.append("lost")
        self.errors.append(exc)


class _Unfiled(SerialTransport):
    """Its line is no file: one that is dropped open leaves nothing behind."""

    def __del__(self) -> None:
        pass


class Bench:
    """A transport between a protocol and a line."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.line = Line()
        self.loop = Loop(self.line)
        self.protocol = Recorder()
        monkeypatch.setattr(serial_transport, "os", self.line)
        loop = cast(asyncio.AbstractEventLoop, self.loop)
        self.transport = _Unfiled(loop, self.protocol, self.line)
