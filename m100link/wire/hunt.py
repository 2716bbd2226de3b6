"""Where the next frame may begin, among bytes that are none.

Anything may arrive: noise, another baud rate, a flood of start bytes. With one checksum for each
start byte such a flood would cost more than a fast line leaves time for, so where they are many the
checksums of many places are computed at once.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

from m100link.wire.crc import HEADER_RESIDUE, header_crc16

__all__ = ["HEADER_SIZE", "SOF", "right_headers"]

SOF = 0xAA
HEADER_SIZE = 12

_BLOCK = 64  # bytes that are looked at together
_FEW = 9  # start bytes in a block up to which one checksum each is cheaper than all places at once


def right_headers(data: bytes, begin: int, end: int) -> Iterator[int]:
    """Those of the places begin to end − 1 where a start byte begins a header with a right CRC16.

    In order, and found when they are asked for. There must be room for a header at each place.
    """
    for first in range(begin, end, _BLOCK):
        last = min(first + _BLOCK, end)
        starts = data.count(SOF, first, last)
        if not starts:
            continue
        if starts <= _FEW:
            signs, sign, shift = data, SOF, 0
        else:
            signs, sign, shift = _low_halves(data[first : last + HEADER_SIZE - 1]), 0, first
        at = signs.find(sign, first - shift, last - shift)
        while at >= 0:
            place = at + shift
            header = data[place : place + HEADER_SIZE]
            if header_crc16(header) == HEADER_RESIDUE and header[0] == SOF:
                yield place
            at = signs.find(sign, at + 1, last - shift)


def _low_halves(data: bytes) -> bytes:
    """Per place 0 where the low half of a header's CRC16 is right: at about one in 256."""
    # A long number has a byte per place. Here that is the low half of the CRC16 of ten bytes, xor
    # the byte behind them: shifted by a byte, the share of the next place comes to stand in it.
    halves = int.from_bytes(data, "little")
    for shares in _shares():
        halves = halves >> 8 ^ int.from_bytes(data.translate(shares), "little")
    return halves.to_bytes(len(data), "little")


@cache
def _shares() -> list[bytes]:
    """What a byte adds to the low half of a CRC16, by its value, from the tenth to the first.

    CRC16 is affine: that depends on value and place alone, and the ten are added by xor. The first
    has the start value in its share.
    """
    zero = header_crc16(bytes(10))
    shares = []
    for place in reversed(range(10)):
        alone = [
            header_crc16(bytes(place) + bytes((value,)) + bytes(9 - place)) for value in range(256)
        ]
        shares.append(bytes((crc ^ (zero if place else 0)) & 0xFF for crc in alone))
    return shares
