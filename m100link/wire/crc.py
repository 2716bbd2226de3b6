"""The two checksums of a frame.

No edition of the document gives their parameters; they were recovered from DJI's tables and agree
with frames captured from real aircraft (docs: reference/wire-format). Both are reflected, start
from 0x3AA3 in the reflected register and have no final xor. crcmod wants the start value as the
register reads it, so the constants below are used as they stand.
"""

from __future__ import annotations

import sys
import zlib
from array import array
from collections.abc import Callable
from functools import cache

import crcmod

CRC16_POLYNOMIAL = 0x18005
START_VALUE = 0x3AA3

header_crc16: Callable[[bytes], int] = crcmod.mkCrcFun(
    CRC16_POLYNOMIAL, initCrc=START_VALUE, rev=True, xorOut=0
)
"""CRC16 over the first ten bytes of a header; over all twelve it is the residue."""

# zlib's CRC32 has the frame's polynomial, 0x104C11DB7, and complements its register on the way in
# and out, so the frame checksum is its complement with a complemented start value. It is 2.5 times
# as fast as crcmod's C extension and 80 times as fast as crcmod without one.
ZLIB_START = START_VALUE ^ 0xFFFFFFFF

# Data followed by their own checksum leave 0 in the register, which zlib shows complemented: a
# frame is good when ``zlib.crc32(frame, ZLIB_START) == FRAME_RESIDUE``.
HEADER_RESIDUE = 0
FRAME_RESIDUE = 0xFFFFFFFF


def frame_crc32(data: bytes) -> int:
    """CRC32 over header and data as they are sent, encrypted or not."""
    return zlib.crc32(data, ZLIB_START) ^ 0xFFFFFFFF


def _sequence_crc16() -> array[int]:
    """The share of each sequence number, in order: a row of 256 per value of the high byte."""
    zero = header_crc16(bytes(10))
    low, high = (
        [header_crc16(bytes(8) + number.to_bytes(2, order)) ^ zero for number in range(256)]
        for order in ("little", "big")
    )
    table = array("H")
    # A row at a time, as one number of 256 digits, since 65536 single ones delay every import.
    row = int.from_bytes(array("H", low).tobytes(), sys.byteorder)
    ones = int.from_bytes(array("H", [1] * 256).tobytes(), sys.byteorder)
    for share in high:
        table.frombytes((row ^ share * ones).to_bytes(512, sys.byteorder))
    return table


# CRC16 is affine: the checksum of a header is that of its first eight bytes (with a zero sequence
# number behind them) xor a value that depends on the sequence number alone. The first eight bytes
# repeat from frame to frame, so the decoder remembers their part and adds the one looked up here.
SEQUENCE_CRC16 = _sequence_crc16()


@cache
def sequence_crc16_numbers() -> list[int]:
    """The same for all of them at once, for a decoder, which looks one up for each frame.

    A list is read in a third of the time. It takes 2.4 MB and some milliseconds to make, so it
    waits for the first decoder.
    """
    return SEQUENCE_CRC16.tolist()
