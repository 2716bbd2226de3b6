"""Every frame of a log, decoded: what went over the line, in its order."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from m100link.link import Direction
from m100link.log.reading import Chunk, FlightLog
from m100link.protocol.describing import Describer
from m100link.protocol.firmware import FirmwareProfile, profile
from m100link.wire import Cipher

__all__ = ["in_order", "read_frames"]

_SAME_S = 2e-6  # times are written to a microsecond


def in_order(chunks: Iterable[Chunk]) -> Iterator[Chunk]:
    """What was sent before what came in the same moment, as it does on virtual time."""
    group: list[Chunk] = []
    for chunk in chunks:
        if group and chunk.at - group[0].at > _SAME_S:
            yield from sorted(group, key=_is_received)
            group = []
        group.append(chunk)
    yield from sorted(group, key=_is_received)


def _is_received(chunk: Chunk) -> bool:
    return chunk.direction is Direction.RECEIVED


def read_frames(
    flight: FlightLog,
    *,
    firmware: str | FirmwareProfile | None = None,
    cipher: Cipher | None = None,
) -> Iterator[dict[str, Any]]:
    """The frames of both directions in order of time, as ``m100link decode`` describes them.

    Each has ``utc`` and ``at`` (POSIX time and the event loop's clock, s, of the read or write that
    ended it) and ``direction`` (``rx`` or ``tx``) besides. What belongs to no frame is told where
    it was passed over: ``discarded_bytes``, with the cause.

    Args:
        flight: The log.
        firmware: Profile to read them by; by default that of the flight.
        cipher: Decrypts; without one encrypted data is told as it travelled.

    Raises:
        UsageError: The firmware of the flight was never known, and none is given.
    """
    chosen = flight.firmware if firmware is None else profile(firmware)
    if chosen is None:
        raise flight.nameless("firmware='1.0', or --firmware")
    sent, received = Describer(chosen, cipher), Describer(chosen, cipher)
    sent.answered, received.answered = received.asked, sent.asked
    last: dict[str, Any] = {}
    both = {Direction.SENT: sent, Direction.RECEIVED: received}
    for chunk in in_order(flight.chunks()):
        describer = both[chunk.direction]
        before = dict(describer.decoder.discards)
        last[chunk.direction.value] = head = {
            "utc": round(chunk.utc, 6),
            "at": round(chunk.at, 6),
            "direction": chunk.direction.value,
        }
        for frame in describer.feed(chunk.data):
            yield head | frame
        yield from _lost(head, describer, before)
    for direction, describer in both.items():
        if direction.value in last:
            before = dict(describer.decoder.discards)
            for frame in describer.close():
                yield last[direction.value] | frame
            yield from _lost(last[direction.value], describer, before)


def _lost(
    head: dict[str, Any], describer: Describer, before: dict[Any, int]
) -> Iterator[dict[str, Any]]:
    """What was passed over since."""
    now = describer.decoder.discards
    if now == before:
        return
    for cause, count in now.items():
        if count > before.get(cause, 0):
            yield head | {"discards": count - before.get(cause, 0), "cause": str(cause)}
