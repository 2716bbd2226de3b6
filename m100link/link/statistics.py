"""Counters of a link, and how long its answers took."""

from __future__ import annotations

import asyncio
import logging
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from itertools import accumulate
from typing import Any, cast

_logger = logging.getLogger(__name__)


ROUND_TRIP_BOUNDS_S = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
"""Upper bounds of the classes of :class:`RoundTrips`, s: from memory to a radio that repeats."""


@dataclass(frozen=True, slots=True)
class RoundTrips:
    """How long answered requests took, from the call to the answer, repeats included."""

    #: Requests in each class, up to 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000 and 2000 ms (the bound
    #: included) and beyond the one before; the last class has those beyond them.
    counts: tuple[int, ...] = (0,) * (len(ROUND_TRIP_BOUNDS_S) + 1)
    total_s: float = 0.0  #: All of them together, s.

    @property
    def count(self) -> int:
        """How many."""
        return sum(self.counts)

    @property
    def mean_s(self) -> float | None:
        """Their mean, s; None without any."""
        return self.total_s / self.count if self.count else None

    def plus(self, seconds: float) -> RoundTrips:
        """With one more, which took so many seconds."""
        counts = list(self.counts)
        counts[bisect_left(ROUND_TRIP_BOUNDS_S, seconds)] += 1
        return RoundTrips(tuple(counts), self.total_s + seconds)

    def within_s(self, share: float) -> float | None:
        """The bound that this share of them, 0 to 1, kept; infinity beyond the last one.

        None without any.
        """
        if not self.count:
            return None
        place = bisect_left(tuple(accumulate(self.counts)), share * self.count)
        return (*ROUND_TRIP_BOUNDS_S, float("inf"))[min(place, len(ROUND_TRIP_BOUNDS_S))]


@dataclass(frozen=True, slots=True)
class LinkStatistics:
    """Counters of a link since it was opened."""

    bytes_received: int  #: Bytes read.
    bytes_sent: int  #: Bytes written.
    frames_received: int  #: Frames with good checksums.
    frames_sent: int  #: Frames written.
    discards: dict[str, int]  #: Discarded starts and frames per cause.
    discarded_bytes: int  #: Bytes that were part of no frame.
    dropped_writes: int  #: Frames not written because the line did not drain.
    acks: int  #: Acks that answered a request.
    duplicate_acks: int  #: Acks of a request answered before.
    late_acks: int  #: Acks that came after their request had ended.
    foreign_acks: int  #: Acks of nothing that was sent here.
    repeats: int  #: Transmissions beyond the first of a request.
    expired: int  #: Requests that ran out of tries.
    round_trips: RoundTrips  #: How long answered requests took.
    #: Setpoints that did not go out in their time, as the program did not keep up.
    missed_setpoints: int = 0
    #: Time of a question and its answer on this line, s, the shortest of the newest eight; None
    #: before the first answer.
    round_trip_s: float | None = None


# -- A tap on a line shows the bytes of both directions, with their times --------------------------
# It stands between the transport and the link, and only where it was asked for: a line without one
# costs what it did.


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


class TapListener:
    """Calls a tap until it raises."""

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


class _TappedTransport:
    """A transport whose writes are heard; all the rest is its own."""

    def __init__(
        self, transport: asyncio.BaseTransport, listener: TapListener, clock: Callable[[], float]
    ) -> None:
        self._transport = cast(asyncio.Transport, transport)
        self._listener = listener
        self._clock = clock

    def __getattr__(self, name: str) -> Any:
        return getattr(self._transport, name)

    def write(self, data: bytes | bytearray | memoryview[Any]) -> None:
        # Heard first: what raises here must not leave bytes on the line that no log knows.
        self._listener.hear(Direction.SENT, bytes(data), self._clock())
        self._transport.write(data)


class TappedProtocol(asyncio.Protocol):
    """Stands between a transport and the protocol whose line is tapped.

    ``tap``: hears each read before the protocol does, and each of its writes.
    """

    def __init__(self, protocol: asyncio.Protocol, tap: Tap, clock: Callable[[], float]) -> None:
        self._protocol = protocol  # gets everything that the transport tells
        self._listener = TapListener(tap)
        self._clock = clock  # the event loop's clock

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """The transport is attached."""
        tapped = _TappedTransport(transport, self._listener, self._clock)
        self._protocol.connection_made(cast(asyncio.Transport, tapped))

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
    """The bytes of a frame, or of its data, as the log shows them."""
    shown = data[:_LOGGED_BYTES]
    if data.startswith(_ACTIVATION, data_at):
        shown = data[: data_at + len(_ACTIVATION)]
    return shown.hex() + ("…" if len(data) > len(shown) else "")
