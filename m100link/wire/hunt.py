"""Where the next frame may begin, among bytes that are none.

Anything may arrive: noise, another baud rate, a flood of start bytes. With one checksum for each
start byte such a flood would cost more than a fast line leaves time for, so where they are many the
checksums of many places are computed at once.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cache

from m100link.wire.crc import HEADER_RESIDUE, header_crc16

__all__ = ["HEADER_SIZE", "SOF", "right_headers"]

SOF = 0xAA
HEADER_SIZE = 12

_BLOCK = 256  # bytes that are looked at together
_FEW = 10  # start bytes in a block up to which one checksum each is cheaper than all places at once


def right_headers(data: bytes, begin: int, end: int) -> Iterator[int]:
    """Those of the places begin to end − 1 where a start byte begins a header with a right CRC16.

    In order, and found when they are asked for. There must be room for a header at each place.
    """
    for first in range(begin, end, _BLOCK):
        last = min(first + _BLOCK, end)
        starts = data.count(SOF, first, last)
        if starts > _FEW:
            places: Iterable[int] = _likely_places(data, first, last)
        elif starts:
            places = _places_of(SOF, data, first, last)
        else:
            continue
        for place in places:
            header = data[place : place + HEADER_SIZE]
            if header_crc16(header) == HEADER_RESIDUE and header[0] == SOF:
                yield place


def _places_of(byte: int, data: bytes, begin: int, end: int) -> Iterator[int]:
    place = data.find(byte, begin, end)
    while place >= 0:
        yield place
        place = data.find(byte, place + 1, end)


def _likely_places(data: bytes, begin: int, end: int) -> Iterator[int]:
    """The places where the low half of a header's CRC16 is right, about one in 256 of all."""
    data = data[begin : end + HEADER_SIZE - 1]
    # A long number has a byte per place. Here that is the low half of the CRC16 of ten bytes, xor
    # the byte behind them: shifted by a byte, the share of the next place comes to stand in it.
    halves = int.from_bytes(data, "little")
    for shares in _shares():
        halves = halves >> 8 ^ int.from_bytes(data.translate(shares), "little")
    wrong = halves.to_bytes(len(data), "little")
    return (begin + place for place in _places_of(0, wrong, 0, end - begin))


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
