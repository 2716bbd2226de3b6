"""Where the next frame may begin, among bytes that are none.

Anything may arrive: noise, another baud rate, a flood of start bytes. With one checksum for each
start byte such a flood would cost more than a fast line leaves time for, so where they are many the
checksums of many places are computed at once.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from itertools import compress

from m100link.wire.crc import HEADER_RESIDUE, header_crc16

__all__ = ["HEADER_SIZE", "SOF", "right_headers"]

SOF = 0xAA
HEADER_SIZE = 12

_BLOCK = 64  # bytes that are looked at together
_FEW = 9  # start bytes in a block up to which one checksum each is cheaper than all places at once
_FEW_HALVES = 12  # right low halves up to which the same is cheaper than all high halves at once

_LOW, _HIGH = 0, 8  # where a half of a CRC16 begins, bits
_IS_ZERO = bytes([1]) + bytes(255)


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
            piece = data[first : last + HEADER_SIZE - 1]
            wrong = _wrong_halves(piece, _LOW)
            signs, sign, shift = wrong.to_bytes(len(piece), "little"), 0, first
            if signs.count(0, 0, last - first) > _FEW_HALVES:
                yield from compress(range(first, last), _all_right(piece, wrong))
                continue
        at = signs.find(sign, first - shift, last - shift)
        while at >= 0:
            place = at + shift
            header = data[place : place + HEADER_SIZE]
            if header_crc16(header) == HEADER_RESIDUE and header[0] == SOF:
                yield place
            at = signs.find(sign, at + 1, last - shift)


def _all_right(data: bytes, wrong: int) -> bytes:
    """Per place whether a header with a right CRC16 begins there; ``wrong`` is of low halves."""
    other = int.from_bytes(data, "little") ^ int.from_bytes(bytes([SOF]) * len(data), "little")
    wrong |= _wrong_halves(data, _HIGH) | other
    return wrong.to_bytes(len(data), "little").translate(_IS_ZERO)


def _wrong_halves(data: bytes, half: int) -> int:
    """A number of a byte per place: 0 where that half of a header's CRC16 is right."""
    # Each byte is that half of the CRC16 of ten bytes, xor the byte behind them (the second one
    # for the high half): shifted by a byte, the share of the next place comes to stand in it.
    wrong = int.from_bytes(data, "little") >> half
    for shares in _shares(half):
        wrong = wrong >> 8 ^ int.from_bytes(data.translate(shares), "little")
    return wrong


@cache
def _shares(half: int) -> list[bytes]:
    """What a byte adds to that half of a CRC16, by its value, from the tenth to the first.

    CRC16 is affine: that depends on value and place alone, and the ten are added by xor. The first
    has the start value in its share.
    """
    zero = header_crc16(bytes(10))
    shares = []
    for place in reversed(range(10)):
        alone = [
            header_crc16(bytes(place) + bytes((value,)) + bytes(9 - place)) for value in range(256)
        ]
        shares.append(bytes((crc ^ (zero if place else 0)) >> half & 0xFF for crc in alone))
    return shares
