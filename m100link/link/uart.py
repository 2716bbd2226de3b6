"""What a UART makes of a line that does not do what it expects."""

from __future__ import annotations

from collections.abc import Iterator

__all__ = ["read_inverted"]

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
    """What is read of bytes sent without a pause, at the right rate, on a line of inverted levels.

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
