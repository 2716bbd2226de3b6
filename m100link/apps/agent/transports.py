"""Channels for messages between an agent and a front."""

from __future__ import annotations

import asyncio
import logging
import os
import socket
import struct
import tempfile
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Protocol

from m100link.apps.agent.background import SparingLogger
from m100link.apps.agent.codec import MAX_SIZE, decode, encode
from m100link.apps.agent.messages import Goodbye, Message, MessageError, Telemetry
from m100link.errors import PortFailed, PortNotFound

_logger = logging.getLogger(__name__)


class Channel(Protocol):
    """One end of a channel for messages, in order and without loss until it is closed."""

    def open(self, on_message: Callable[[Message], None], on_closed: Callable[[str], None]) -> None:
        """Begin to receive.

        Args:
            on_message: Called with each message. An exception of it is logged and ends there.
            on_closed: Called once, with the reason, when the other end has gone or closed it.
        """

    def send(self, message: Message) -> None:
        """Send a message; never waits. On a closed channel nothing happens.

        Raises:
            MessageError: This message cannot be sent at all.
        """

    def close(self, reason: str = "") -> None:
        """Close it, and send the other end the reason. May be called any number of times."""


class ChannelEnd:
    """The side of an end at which messages come: an error of their taker is logged, and no more.

    As with a socket, a failure at one end does not reach the other.
    """

    def __init__(self) -> None:
        self._log = SparingLogger(_logger)
        self._on_message: Callable[[Message], None] | None = None
        self._on_closed: Callable[[str], None] | None = None

    def _hand_over(self, message: Message) -> None:
        try:
            if self._on_message is not None:
                self._on_message(message)
        except Exception:  # noqa: BLE001 (logged)
            self._log.exception("a %s was not taken", type(message).__name__)


# -- A carrier inside one event loop: a message has arrived when ``send`` returns ------------------
# For tests on virtual time, and for an agent and its fronts in a single process.


_MAX_WAITING = 1000


class MemoryChannel(ChannelEnd):
    """One end; see :class:`m100link.apps.agent.transports.Channel`.

    Args:
        as_bytes: Let each message be written and read as bytes on its way: slower, and whatever
            the bytes cannot carry shows.
    """

    def __init__(self, *, as_bytes: bool = False) -> None:
        super().__init__()
        self._as_bytes = as_bytes
        self._peer: MemoryChannel | None = None
        # Messages that came before this end was opened.
        self._waiting: deque[Message] = deque(maxlen=_MAX_WAITING)

    def join(self, peer: MemoryChannel) -> None:
        """Make the two ends of one channel."""
        self._peer, peer._peer = peer, self

    def open(self, on_message: Callable[[Message], None], on_closed: Callable[[str], None]) -> None:
        """Begin to receive; waiting messages come first."""
        self._on_message, self._on_closed = on_message, on_closed
        while self._waiting:
            self._hand_over(self._waiting.popleft())

    def send(self, message: Message) -> None:
        """The other end has it when this returns."""
        if (peer := self._peer) is not None:
            message = decode(encode(message)) if self._as_bytes else message
            (peer._waiting.append if peer._on_message is None else peer._hand_over)(message)

    def close(self, reason: str = "") -> None:
        """Close both ends."""
        peer, self._peer = self._peer, None
        if peer is not None:
            peer._peer = None
            if peer._on_closed is not None:
                peer._on_closed(reason)


def memory_channels(*, as_bytes: bool = False) -> tuple[MemoryChannel, MemoryChannel]:
    """The two ends of a way inside this event loop."""
    one, other = MemoryChannel(as_bytes=as_bytes), MemoryChannel(as_bytes=as_bytes)
    one.join(other)
    return one, other


# -- A carrier between two processes of one user: a Unix socket in a private directory -------------
# Each message is its length, four bytes with the lowest first, and its bytes. An end that does not
# read costs the other one nothing: telemetry is dropped first, then the connection.


DROP_ABOVE = 256 * 1024
"""Bytes that wait to be written above which telemetry is dropped."""

CLOSE_ABOVE = 4 * 1024 * 1024
"""Bytes that wait to be written above which the other end counts as gone."""

AT_ONCE = 64
"""Messages that are taken before others have their turn of the loop."""

_LENGTH = struct.Struct("<I")
_CREDENTIALS = struct.Struct("3i")  # struct ucred: process, user, group


class UnixChannel(ChannelEnd, asyncio.BufferedProtocol):
    """One end; see :class:`m100link.apps.agent.transports.Channel`.

    Args:
        on_connected: Called when it is connected; for the end that serves.

    ``dropped``: telemetry packages dropped because the other end does not read.
    """

    def __init__(self, on_connected: Callable[[UnixChannel], None] | None = None) -> None:
        super().__init__()
        self._on_connected = on_connected
        self._loop = asyncio.get_running_loop()
        self._transport: asyncio.Transport | None = None
        # Room for the longest message, so that none of it is made anew for each.
        self._received = bytearray(_LENGTH.size + MAX_SIZE)
        self._space = memoryview(self._received)
        self._filled = 0
        self._reason = ""
        self._is_lost = False
        self.dropped = 0

    # -- asyncio's side --------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """The socket is connected; of another user, it is closed at once."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        transport.pause_reading()  # nothing is read before somebody listens
        if not _is_same_user(transport.get_extra_info("socket")):
            self.close("another user")
        elif self._on_connected is not None:
            self._on_connected(self)

    def get_buffer(self, sizehint: int) -> memoryview:
        """Where the next bytes go: behind those of a message that is not whole."""
        return self._space[self._filled :]

    def buffer_updated(self, nbytes: int) -> None:
        """Bytes came in: hand on some of the messages that are whole, keep the rest."""
        self._filled += nbytes
        self._hand_on()

    def _hand_on(self) -> None:
        begin = 0
        for _ in range(AT_ONCE):
            end = self._end_of_message(begin)
            if end is None:
                break
            body = bytes(self._space[begin + _LENGTH.size : end])
            begin = end
            self._take(body)
        self._space[: self._filled - begin] = self._space[begin : self._filled]
        self._filled -= begin
        if self._end_of_message(0) is not None and self._transport is not None:
            # The other end may be attacked, or mad: the flight has its turn before the rest.
            self._transport.pause_reading()
            self._loop.call_soon(self._go_on)

    def _go_on(self) -> None:
        if self._transport is not None:
            self._transport.resume_reading()
            self._hand_on()

    def _end_of_message(self, begin: int) -> int | None:
        """Where the message that begins there ends; None while it is not whole, or never will."""
        if self._filled - begin < _LENGTH.size or self._transport is None:
            return None
        (size,) = _LENGTH.unpack_from(self._received, begin)
        if size > MAX_SIZE:
            self._refuse(f"a message of {size} bytes")
            return None
        end = int(begin + _LENGTH.size + size)
        return end if self._filled >= end else None

    def _take(self, body: bytes) -> None:
        try:
            message = decode(body)
        except MessageError as error:
            self._refuse(error.seen)
            return
        if isinstance(message, Goodbye):
            self._reason = message.reason
            self._end()
        else:
            self._hand_over(message)

    def _refuse(self, reason: str) -> None:
        """End it for a bad message: neither end has asked for that, so both get the reason."""
        self._reason = reason
        self.send(Goodbye(reason))
        self._end()

    def connection_lost(self, exc: Exception | None) -> None:
        self._end()

    def _end(self) -> None:
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.close()
        if not self._is_lost:
            self._is_lost = True
            if self._on_closed is not None:
                self._on_closed(self._reason)

    def open(self, on_message: Callable[[Message], None], on_closed: Callable[[str], None]) -> None:
        self._on_message, self._on_closed = on_message, on_closed
        if self._transport is not None:
            self._transport.resume_reading()
        elif self._is_lost:
            on_closed(self._reason)

    def send(self, message: Message) -> None:
        """Write a message, as far as the other end reads.

        Raises:
            MessageError: This message cannot be sent at all.
        """
        transport = self._transport
        if transport is None:
            return
        waiting = transport.get_write_buffer_size()
        # An end that does not read must not cost the one that flies its memory. Telemetry is
        # replaced by the next package; orders and their outcomes are not, so that channel ends.
        if waiting > DROP_ABOVE and isinstance(message, Telemetry):
            self.dropped += 1
        elif waiting > CLOSE_ABOVE:
            # Its end is heard in a turn of its own. Heard here, within a message that goes to all
            # ends, that of its lease would reach some of them before this message.
            self._reason, self._transport = "the other end does not read", None
            transport.abort()
        else:
            body = encode(message)
            transport.write(_LENGTH.pack(len(body)) + body)

    def close(self, reason: str = "") -> None:
        """Close it, and send the other end the reason."""
        self._on_closed = None  # the caller that closes it knows
        if self._transport is not None:
            self.send(Goodbye(reason))
            self._end()


def _is_same_user(connected: socket.socket) -> bool:
    """Whether the process at the other end is of this user (the directory says so already)."""
    if not hasattr(socket, "SO_PEERCRED"):
        return True
    raw = connected.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    _, user, _ = _CREDENTIALS.unpack(raw)
    return bool(user == os.getuid())


@contextmanager
def private_directory() -> Iterator[Path]:
    """A new directory that only this user can enter; removed at the end."""
    base = os.environ.get("XDG_RUNTIME_DIR")
    place = base if base and Path(base).is_dir() else None
    with tempfile.TemporaryDirectory(prefix="m100link-", dir=place) as name:
        yield Path(name)


@asynccontextmanager
async def serve_unix(path: Path, attach: Callable[[UnixChannel], None]) -> AsyncIterator[None]:
    """Serve fronts on a socket, in a directory that only this user can enter, while the block runs.

    ``attach``: called with the channel of each front. Raises PortFailed: it cannot be made.
    """
    loop = asyncio.get_running_loop()
    try:
        server = await loop.create_unix_server(lambda: UnixChannel(attach), str(path))
    except OSError as error:
        raise PortFailed(f"{path} cannot be served: {error.strerror or error}") from error
    try:
        yield
    finally:
        server.close()


async def connect_unix(path: Path) -> UnixChannel:
    """Connect to the agent behind a socket. Raises PortNotFound: none is there."""
    loop = asyncio.get_running_loop()
    try:
        _, channel = await loop.create_unix_connection(UnixChannel, str(path))
    except OSError as error:
        raise PortNotFound(
            f"no agent answers at {path}: {error.strerror or error}",
            remedy="start the station again",
        ) from error
    return channel
