"""The transport of an open serial port: one ``os.read`` or ``os.write`` per turn of the loop.

pyserial opens and configures the port. The asyncio transport on top of it registers and removes a
writer for each frame, asks ``select`` again what the loop knows already, and forgets what it was
writing when Ctrl-C comes between two of its lines. Here a frame is written at once, the loop
watches for room only while the line takes no more, and each step can be cut off by a
``KeyboardInterrupt``: what was read is delivered and what was accepted is sent all the same.
"""

from __future__ import annotations

import asyncio
import errno
import importlib.util
import logging
import os
import warnings
from collections import deque
from collections.abc import Iterator
from enum import Enum
from typing import Any, Protocol

_logger = logging.getLogger(__name__)


# -- what a UART makes of a line that does not do what it expects ----------------------------------


_BITS = 8


def _levels(data: bytes) -> Iterator[int]:
    """The inverted levels of bytes sent without a pause (8N1), between two idle ones."""
    yield 0
    for byte in data:
        yield 1  # the start bit, which is 0 on a line as it should be
        for bit in range(_BITS):
            yield 1 - (byte >> bit & 1)
        yield 0
    yield from (0,) * (_BITS + 2)


def read_inverted(data: bytes) -> bytes:
    """Bytes as received, sent without a pause at the right rate, on a line of inverted levels.

    Such are the levels of RS-232, and of radios and adapters that invert. Idle looks like a start
    bit without end, so the receiver waits for the first 1 and takes the next fall for a start. A
    byte whose stop bit is 0 is delivered as it is, as a terminal in raw mode has it; the receiver
    then waits for a 1 again.
    """
    levels = list(_levels(data))
    read, at = bytearray(), 0
    while (at := _fall(levels, at)) + _BITS + 1 < len(levels):
        read.append(sum(levels[at + 1 + bit] << bit for bit in range(_BITS)))
        at += _BITS + 1  # the stop bit, and a fall may follow it
    return bytes(read)


def _fall(levels: list[int], at: int) -> int:
    """Where the next 0 after a 1 is; the end if there is none."""
    while at < len(levels) and not levels[at]:
        at += 1
    while at < len(levels) and levels[at]:
        at += 1
    return at


# -- serial transport ------------------------------------------------------------------------------

HIGH_WATER = 2048  # 200 ms of a line at 115200 baud: more would only make setpoints old
_LOW_WATER = 512
_MOST_UNSENT = 65_536  # for a line that takes nothing, from a protocol that does not pause
_READ_SIZE = 4096  # what the terminal layer of the system holds

PORT_GONE: tuple[type[Exception], ...] = (OSError,)  # serial.SerialException is one
if importlib.util.find_spec("termios") is not None:  # not on Windows
    import termios

    PORT_GONE += (termios.error,)  # which is none, although it carries an errno


class SerialPort(Protocol):
    """The part of a port that a transport uses; ``serial.Serial`` has it."""

    def fileno(self) -> int:
        """The open file, of which an empty read means that the device is gone (VMIN is 1)."""
        ...

    @property
    def out_waiting(self) -> int:
        """Bytes that the system still holds for the line."""
        ...

    def reset_output_buffer(self) -> object:
        """Drop what the system still holds for the line."""

    def close(self) -> object:
        """Give the port back; a second time nothing happens."""


class PortState(Enum):
    """Where a transport is between its first byte and its end."""

    OPEN = "open"  # bytes go both ways
    CLOSING = "closing"
    """``close()`` came: what was accepted still leaves, nothing is accepted or read."""
    ENDING = "ending"
    """Nothing is sent or read; the protocol hears of the end in the next turn of the loop."""
    CLOSED = "closed"
    """The port is given back."""


_OPEN = PortState.OPEN

# Accepted bytes, and what os.write of them returned, once it did.
_Unsent = tuple[bytes, list[int]]
_NOTHING: _Unsent = (b"", [])


def _rest(unsent: _Unsent) -> bytes:
    """The bytes that the system has not taken."""
    data, taken = unsent
    return data[taken[0] :] if taken else data


class SerialTransport(asyncio.Transport):
    """Carries bytes between a protocol and a serial port that the event loop can watch.

    It calls the protocol's ``connection_made`` at once, ``pause_writing`` at 2048 unsent bytes and
    ``resume_writing`` at 512. It buffers up to 65,536 bytes of a protocol that writes on
    regardless; a piece that does not fit is dropped whole and counted.
    """

    # A KeyboardInterrupt may come between any two lines. So each step first writes down what makes
    # it be done again, and can be done twice; the tests cut every line off.

    def __init__(
        self, loop: asyncio.AbstractEventLoop, protocol: asyncio.Protocol, port: SerialPort
    ) -> None:
        super().__init__({"serial": port})
        self._loop = loop  # the running event loop
        self._protocol = protocol  # who gets the bytes
        self._port = port  # an open port, which belongs to the transport from here on
        self._fd = port.fileno()
        self.state = PortState.OPEN  # where it is between its first byte and its end
        # False while the protocol wants no bytes.
        self._is_reading = True
        # Bytes read and not delivered: empty between turns, unless something cut one off.
        self._arrived: deque[bytes] = deque()
        # Bytes accepted that the system has not taken: none, unless the line takes no more.
        self._unsent = _NOTHING
        # Whether the protocol was asked to pause, and not yet to resume.
        self._is_protocol_paused = False
        # Whether it has heard of the end.
        self._is_protocol_notified = False
        self.dropped = 0  # pieces that did not fit
        os.set_blocking(self._fd, False)
        protocol.connection_made(self)
        if self.is_reading():
            loop.add_reader(self._fd, self._on_readable)

    def __del__(self) -> None:
        # Its loop has ended, or it would be in there. In a forked child this is a copy, so nothing
        # is said to the line: the file is closed, and that is all.
        if getattr(self, "state", PortState.CLOSED) is not PortState.CLOSED:
            name = getattr(self._port, "name", self._fd)
            text = f"{name} was not closed before its event loop: use `async with`, or aclose()"
            warnings.warn(text, ResourceWarning, source=self, stacklevel=1)
            self._port.close()

    # -- reading ---------------------------------------------------------------------------------

    def _on_readable(self) -> None:
        if self.state is not _OPEN:
            return  # its end is on its way
        try:
            if not self._arrived:  # a turn that was cut off comes first
                self._read()
            self._deliver()
        except BaseException:
            if self._arrived:
                self._loop.call_soon(self._deliver)
            raise

    def _read(self) -> None:
        try:
            # One instruction from the system into the deque: a KeyboardInterrupt comes between two,
            # and bytes on their way into a variable would be lost.
            self._arrived.extend(map(os.read, (self._fd,), (_READ_SIZE,)))
        except (BlockingIOError, InterruptedError):
            return  # another program emptied the port, or a signal came
        except OSError as error:
            self._end(error)

    def _deliver(self) -> None:
        while self._arrived and self._is_reading and self.state is _OPEN:
            if not self._arrived[0]:
                self._end(OSError(errno.EIO, "the device hung up"))
                return
            self._protocol.data_received(self._arrived.popleft())

    def is_reading(self) -> bool:
        """Whether the protocol gets bytes."""
        return self._is_reading and self.state is _OPEN

    def pause_reading(self) -> None:
        """Deliver nothing until :meth:`resume_reading`."""
        self._is_reading = False
        if self.state is _OPEN:
            self._loop.remove_reader(self._fd)

    def resume_reading(self) -> None:
        """Deliver again."""
        self._is_reading = True
        if self.state is _OPEN:
            self._loop.add_reader(self._fd, self._on_readable)
            if self._arrived:
                self._loop.call_soon(self._deliver)

    # -- writing ---------------------------------------------------------------------------------

    def write(self, data: bytes | bytearray | memoryview[Any]) -> None:
        """Send, at once if the line takes it; nothing happens once it is closed."""
        if self.state is not _OPEN or not data:
            return
        waiting = b"" if self._unsent is _NOTHING else _rest(self._unsent)
        if len(waiting) + len(data) > _MOST_UNSENT:
            self.dropped += 1
            return
        try:
            self._unsent = (waiting + bytes(data), [])
            if not waiting:
                self._send()
            if self._unsent is not _NOTHING:
                self._wait_for_room()
        except BaseException:
            if self._unsent is not _NOTHING:
                self._loop.add_writer(self._fd, self._on_writable)
            raise

    def _send(self) -> None:
        data, taken = self._unsent
        try:
            # As in _read: how much was taken is known by the next instruction.
            taken.extend(map(os.write, (self._fd,), (data,)))
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            self._end(error)
            return
        if taken[0] == len(data):
            self._unsent = _NOTHING
        else:
            self._settle()

    def _settle(self) -> None:
        rest = _rest(self._unsent)
        self._unsent = (rest, []) if rest else _NOTHING

    def _wait_for_room(self) -> None:
        if self.state is PortState.ENDING:
            return
        self._loop.add_writer(self._fd, self._on_writable)
        if len(self._unsent[0]) > HIGH_WATER and not self._is_protocol_paused:
            self._is_protocol_paused = True
            self._protocol.pause_writing()

    def _on_writable(self) -> None:
        if self.state in (PortState.ENDING, PortState.CLOSED):
            return
        self._settle()  # a turn that was cut off did not
        if self._unsent is not _NOTHING:
            self._send()
        if self._is_protocol_paused and len(self._unsent[0]) <= _LOW_WATER:
            self._resume_protocol()
        if self._unsent is _NOTHING:
            # Last, because until here whatever cuts this off is made up for by the next call.
            if self.state is PortState.CLOSING:
                self._end(None)
            else:
                self._loop.remove_writer(self._fd)

    def _resume_protocol(self) -> None:
        try:
            self._is_protocol_paused = False
            self._protocol.resume_writing()
        except KeyboardInterrupt:
            self._is_protocol_paused = True  # it may not have heard, and may hear twice
            raise

    def get_write_buffer_size(self) -> int:
        """Bytes that were accepted and are not with the system."""
        return len(_rest(self._unsent))

    def can_write_eof(self) -> bool:
        """Never: a serial line has no end."""
        return False

    # -- the end ---------------------------------------------------------------------------------

    def is_closing(self) -> bool:
        """Whether it is closed or about to be."""
        return self.state is not PortState.OPEN

    def close(self) -> None:
        """Read no more, send what was accepted, then give the port back."""
        if self.state in (PortState.ENDING, PortState.CLOSED):
            return
        self.state = PortState.CLOSING
        self._loop.remove_reader(self._fd)
        if self._unsent is _NOTHING:
            self._end(None)
        else:
            self._loop.add_writer(self._fd, self._on_writable)

    def abort(self) -> None:
        """Give the port back in the next turn of the loop; what is unsent is lost."""
        self._end(None)

    def _end(self, error: OSError | None) -> None:
        if self.state in (PortState.ENDING, PortState.CLOSED):
            return
        for _ in range(2):  # a KeyboardInterrupt can take one
            self._loop.call_soon(self._finish, error)
        self.state = PortState.ENDING

    def _finish(self, error: OSError | None) -> None:
        if self._is_protocol_notified:
            return
        if self.state is not PortState.CLOSED:
            self._loop.remove_reader(self._fd)
            self._loop.remove_writer(self._fd)
            self.state = PortState.CLOSED  # the number of the file may soon be another's
        self._give_back()
        self._protocol.connection_lost(error)
        self._is_protocol_notified = True

    def _give_back(self) -> None:
        """Close the port, without the wait for a line that takes nothing."""
        try:
            # On a pseudo-terminal this also drops what the other end has and did not read yet.
            if self._unsent is not _NOTHING or self._port.out_waiting:
                self._port.reset_output_buffer()
        except PORT_GONE as error:
            _logger.debug("the port was gone before its output could be dropped: %s", error)
        try:
            self._port.close()
        except PORT_GONE as error:
            _logger.debug("the port was gone before it could be closed: %s", error)
