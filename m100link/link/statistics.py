"""Counters of a link, and how long its answers took."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from itertools import accumulate

from m100link.session.endpoint import Endpoint

__all__ = ["ROUND_TRIP_BOUNDS_S", "LinkStatistics", "RoundTripCounter", "RoundTrips", "counted"]

ROUND_TRIP_BOUNDS_S = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
"""Upper bounds of the classes of :class:`RoundTrips`, s: from memory to a radio that repeats."""


@dataclass(frozen=True, slots=True)
class RoundTrips:
    """How long answered requests took, from the call to the answer, repeats included.

    Attributes:
        counts: Requests in each class: up to 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000 and 2000 ms
            (the bound included) and beyond the one before; the last class has those beyond them.
        total_s: All of them together, s.
    """

    counts: tuple[int, ...] = (0,) * (len(ROUND_TRIP_BOUNDS_S) + 1)
    total_s: float = 0.0

    @property
    def count(self) -> int:
        """How many."""
        return sum(self.counts)

    @property
    def mean_s(self) -> float | None:
        """Their mean, s; None without any."""
        return self.total_s / self.count if self.count else None

    def within_s(self, share: float) -> float | None:
        """The bound that this share of them, 0 to 1, kept; infinity beyond the last one.

        None without any.
        """
        if not self.count:
            return None
        place = bisect_left(tuple(accumulate(self.counts)), share * self.count)
        return (*ROUND_TRIP_BOUNDS_S, float("inf"))[min(place, len(ROUND_TRIP_BOUNDS_S))]


class RoundTripCounter:
    """Counts round trips as they end."""

    __slots__ = ("_counts", "_total")

    def __init__(self) -> None:
        self._counts = [0] * (len(ROUND_TRIP_BOUNDS_S) + 1)
        self._total = 0.0

    def add(self, seconds: float) -> None:
        """One more."""
        self._counts[bisect_left(ROUND_TRIP_BOUNDS_S, seconds)] += 1
        self._total += seconds

    def counted(self) -> RoundTrips:
        """All so far."""
        return RoundTrips(tuple(self._counts), self._total)


@dataclass(frozen=True, slots=True)
class LinkStatistics:
    """Counters of a link since it was opened.

    Attributes:
        bytes_received: Bytes read.
        bytes_sent: Bytes written.
        frames_received: Frames with good checksums.
        frames_sent: Frames written.
        discards: Discarded starts and frames per cause.
        discarded_bytes: Bytes that were part of no frame.
        dropped_writes: Frames not written because the line did not drain.
        acks: Acks that answered a request.
        duplicate_acks: Acks of a request answered before.
        late_acks: Acks that came after their request had ended.
        foreign_acks: Acks of nothing that was sent here.
        repeats: Transmissions beyond the first of a request.
        expired: Requests that ran out of tries.
        round_trips: How long answered requests took.
        missed_setpoints: Setpoints that did not go out in their time: the program did not keep up.
    """

    bytes_received: int
    bytes_sent: int
    frames_received: int
    frames_sent: int
    discards: dict[str, int]
    discarded_bytes: int
    dropped_writes: int
    acks: int
    duplicate_acks: int
    late_acks: int
    foreign_acks: int
    repeats: int
    expired: int
    round_trips: RoundTrips
    missed_setpoints: int = 0


def counted(
    endpoint: Endpoint,
    bytes_sent: int,
    frames_sent: int,
    dropped: int,
    round_trips: RoundTrips,
    missed_setpoints: int = 0,
) -> LinkStatistics:
    """The counters of a link as they are now."""
    decoder, sessions = endpoint.decoder, endpoint.statistics
    return LinkStatistics(
        bytes_received=decoder.bytes,
        bytes_sent=bytes_sent,
        frames_received=decoder.frames,
        frames_sent=frames_sent,
        discards={str(cause): count for cause, count in decoder.discards.items() if count},
        discarded_bytes=decoder.discarded_bytes,
        dropped_writes=dropped,
        acks=sessions.acks,
        duplicate_acks=sessions.duplicate_acks,
        late_acks=sessions.late_acks,
        foreign_acks=sessions.foreign_acks,
        repeats=sessions.transmissions - sessions.requests,
        expired=sessions.expired,
        round_trips=round_trips,
        missed_setpoints=missed_setpoints,
    )
