"""Counters of a link."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["LinkStatistics"]


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
