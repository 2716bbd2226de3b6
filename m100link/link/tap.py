"""A tap on a line: whoever asks for it sees the bytes of both directions, with their times.

It stands between the transport and the link, and only where it was asked for: a line without one
costs what it did.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from enum import Enum
from typing import Any, cast

__all__ = ["Direction", "Listener", "Tap", "TappedProtocol", "excerpt"]

_logger = logging.getLogger(__name__)

_LOGGED_BYTES = 64
_ACTIVATION = b"\x00\x01"  # set and id; it has the app id in it and is never encrypted


class Direction(Enum):
    """Which way bytes went, as this end sees it."""

    RECEIVED = "rx"
    SENT = "tx"


Tap = Callable[[Direction, bytes, float], None]
"""Called with each read and each write: which way, the bytes, and the event loop's clock, s.

It runs between the line and what flies, so it only takes note. One that raises is logged and not
called again; the line goes on.
"""


class Listener:
    """Calls a tap until it raises.

    Args:
        tap: What to call.
    """

    __slots__ = ("_tap",)

    def __init__(self, tap: Tap) -> None:
        self._tap: Tap | None = tap  # None once it raised

    def hear(self, direction: Direction, data: bytes, now: float) -> None:
        """Tell it of a read or a write."""
        if self._tap is None:
            return
        try:
            self._tap(direction, data, now)
        except Exception:
            _logger.exception("the tap of a line raised; it is not called again")
            self._tap = None


class _TappedTransport(asyncio.Transport):
    """A transport whose writes are heard."""

    def __init__(
        self, transport: asyncio.Transport, listener: Listener, clock: Callable[[], float]
    ) -> None:
        super().__init__()
        self._transport = transport
        self._listener = listener
        self._clock = clock

    def write(self, data: bytes | bytearray | memoryview[Any]) -> None:
        # Heard first: what raises here must not leave bytes on the line that no log knows.
        self._listener.hear(Direction.SENT, bytes(data), self._clock())
        self._transport.write(data)

    def get_write_buffer_size(self) -> int:
        return self._transport.get_write_buffer_size()

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        self._transport.set_write_buffer_limits(high, low)

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        return self._transport.get_extra_info(name, default)

    def pause_reading(self) -> None:
        self._transport.pause_reading()

    def resume_reading(self) -> None:
        self._transport.resume_reading()

    def is_reading(self) -> bool:
        return self._transport.is_reading()

    def is_closing(self) -> bool:
        return self._transport.is_closing()

    def close(self) -> None:
        self._transport.close()

    def abort(self) -> None:
        self._transport.abort()


class TappedProtocol(asyncio.Protocol):
    """What a transport is given in place of a protocol whose line is tapped.

    Args:
        protocol: Gets everything that the transport tells.
        tap: Hears each read before the protocol does, and each of its writes.
        clock: The event loop's clock.
    """

    def __init__(self, protocol: asyncio.Protocol, tap: Tap, clock: Callable[[], float]) -> None:
        self._protocol = protocol
        self._listener = Listener(tap)
        self._clock = clock

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """The transport is attached."""
        line = cast(asyncio.Transport, transport)
        tapped = _TappedTransport(line, self._listener, self._clock)
        self._protocol.connection_made(tapped)

    def data_received(self, data: bytes) -> None:
        """Bytes from the line."""
        self._listener.hear(Direction.RECEIVED, data, self._clock())
        self._protocol.data_received(data)

    def pause_writing(self) -> None:
        """The other end does not drain."""
        self._protocol.pause_writing()

    def resume_writing(self) -> None:
        """It drains again."""
        self._protocol.resume_writing()

    def eof_received(self) -> bool | None:
        """The other end of a socket closed."""
        return self._protocol.eof_received()

    def connection_lost(self, exc: Exception | None) -> None:
        """The line is gone."""
        self._protocol.connection_lost(exc)


def excerpt(data: bytes, *, data_at: int = 0) -> str:
    """What the log shows of a frame, or of its data."""
    shown = data[:_LOGGED_BYTES]
    if data.startswith(_ACTIVATION, data_at):
        shown = data[: data_at + len(_ACTIVATION)]
    return shown.hex() + ("…" if len(data) > len(shown) else "")
