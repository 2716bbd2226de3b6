"""Frames and bytes (document 1.1 and 1.2; docs: reference/wire-format).

A frame is a 12-byte header with its own CRC16, up to 1007 bytes of data and a CRC32::

    0      1–2             3                 4              5–7    8–9   10–11   12…    LEN−4…
    0xAA   LEN:10 VER:6    SESSION:5 A:1 0:2 PADDING:5 ENC:3 0      SEQ   CRC16   DATA   CRC32

An empty payload makes a frame of the header alone, without a CRC32.
"""

from __future__ import annotations

import re
from enum import StrEnum
from functools import lru_cache
from struct import Struct
from typing import NamedTuple
from zlib import crc32

from m100link.errors import PayloadTooLarge, UsageError
from m100link.wire.cipher import BLOCK_SIZE, Cipher
from m100link.wire.crc import (
    FRAME_RESIDUE,
    HEADER_RESIDUE,
    ZLIB_START,
    frame_crc32,
    header_crc16,
    header_crc16_of_word,
)
from m100link.wire.crc import SEQUENCE_CRC16_HIGH as _HIGH
from m100link.wire.crc import SEQUENCE_CRC16_LOW as _LOW

__all__ = [
    "HEADER_SIZE",
    "MAX_DATA_SIZE",
    "MAX_FRAME_SIZE",
    "MAX_SESSION",
    "OVERHEAD",
    "SOF",
    "Discard",
    "Frame",
    "FrameDecoder",
    "encode_frame",
]

SOF = 0xAA
HEADER_SIZE = 12
CRC32_SIZE = 4
OVERHEAD = HEADER_SIZE + CRC32_SIZE
MAX_FRAME_SIZE = 1023
MAX_DATA_SIZE = MAX_FRAME_SIZE - OVERHEAD
MAX_SESSION = 31

_HEADER = Struct("<QHH")  # first eight bytes, sequence number, CRC16
_unpack_header = _HEADER.unpack_from
_new = tuple.__new__
_WORD = Struct("<Q")
_CRC32 = Struct("<I")


class Frame(NamedTuple):
    """One frame, decrypted and without padding.

    Attributes:
        session: Session id, 0 to 31 (document 1.4).
        is_ack: True for an acknowledgement, False for a command or push.
        sequence: Sequence number, 0 to 65535. An ack repeats that of its command.
        encrypted: Whether the data travelled encrypted.
        padding: Padding bytes that encryption added, 0 when plain.
        data: The payload: command set, command id and value, or the value of an ack.
    """

    session: int
    is_ack: bool
    sequence: int
    encrypted: bool
    padding: int
    data: bytes


class Discard(StrEnum):
    """Why the decoder passed over a start byte or a frame."""

    HEADER_CRC = "header_crc"
    FRAME_CRC = "frame_crc"
    LENGTH = "length"
    RESERVED_BITS = "reserved_bits"
    VERSION = "version"
    PADDING = "padding"
    NO_KEY = "no_key"
    TRUNCATED = "truncated"


def encode_frame(
    data: bytes,
    *,
    session: int,
    sequence: int,
    is_ack: bool = False,
    cipher: Cipher | None = None,
) -> bytes:
    """Build the bytes of one frame.

    Args:
        data: Payload, 0 to 1007 bytes (0 to 991 encrypted: the last block is always padding, in
            whole or in part). An empty payload gives a header alone and is never encrypted.
        session: 0 to 31.
        sequence: 0 to 65535.
        is_ack: True for an acknowledgement.
        cipher: Encrypts the payload; None sends it plain.

    Raises:
        PayloadTooLarge: The frame would not fit into the 10 bits of its length field.
        UsageError: Session or sequence number out of range.
    """
    if not 0 <= session <= MAX_SESSION:
        raise UsageError(f"session {session} does not exist", remedy="sessions are 0 to 31")
    if not 0 <= sequence <= 0xFFFF:
        raise UsageError(f"sequence number {sequence} does not fit into 16 bits")
    padding = encryption = 0
    if cipher is not None and data:
        data, padding = cipher.encrypt(data)
        encryption = 1
    length = len(data) + OVERHEAD if data else HEADER_SIZE
    if length > MAX_FRAME_SIZE:
        limit = MAX_DATA_SIZE // BLOCK_SIZE * BLOCK_SIZE - 1 if padding else MAX_DATA_SIZE
        raise PayloadTooLarge(
            f"{len(data) - padding} bytes of data do not fit into one frame",
            cause=f"a frame carries at most {limit} bytes{' encrypted' if padding else ''}",
            remedy="split the data",
        )
    word = SOF | length << 8 | (session | is_ack << 5) << 24 | (padding | encryption << 5) << 32
    crc16 = _crc16_of_word(word) ^ _LOW[sequence & 0xFF] ^ _HIGH[sequence >> 8]
    header = _HEADER.pack(word, sequence, crc16)
    if not data:
        return header
    body = header + data
    return body + _CRC32.pack(frame_crc32(body))


@lru_cache(maxsize=4096)
def _crc16_of_word(word: int) -> int:
    # The first eight bytes of a header are the same for every frame of a kind.
    return header_crc16_of_word(_WORD.pack(word))


class _Header(NamedTuple):
    """What a header says but for its sequence number, remembered so that repeats cost one lookup.

    ``discard`` is None for a usable header. ``crc`` is the CRC16 with sequence number 0.
    """

    crc: int
    length: int
    session: int
    is_ack: bool
    encrypted: bool
    padding: int
    discard: Discard | None


def _parse_header(raw: bytes) -> _Header:
    length = raw[1] | (raw[2] & 0x03) << 8
    discard: Discard | None = None
    if raw[2] >> 2:
        discard = Discard.VERSION
    elif raw[3] >> 6 or raw[5] or raw[6] or raw[7]:
        discard = Discard.RESERVED_BITS
    elif length < OVERHEAD and length != HEADER_SIZE:
        discard = Discard.LENGTH
    return _Header(
        header_crc16_of_word(raw[:8]),
        length,
        raw[3] & 0x1F,
        bool(raw[3] & 0x20),
        bool(raw[4] >> 5),  # DJI's codec takes any value but 0 for AES
        raw[4] & 0x1F,
        discard,
    )


_CACHE_LIMIT = 4096


class FrameDecoder:
    """Finds the frames in a stream of bytes.

    Fed with any chunking of the same bytes it gives the same frames. After damage it looks again
    from the next byte, inside the failed frame too, so no valid frame is lost; like DJI's codec it
    keeps at most one incomplete frame (1022 bytes) between calls. Nothing that is fed in raises.

    Cost is linear in the input: a start byte costs one header check, and a header with a good
    CRC16 at most one CRC32 over 1023 bytes.

    Args:
        cipher: Decrypts frame data. Without one, encrypted frames are counted and passed over.

    Attributes:
        cipher: May be set or replaced at any time; it applies to frames completed afterwards.
        discards: Count per :class:`Discard`.
        discarded_bytes: Bytes that were part of no delivered frame.
        frames: Frames delivered.
        bytes: Bytes fed in.
    """

    __slots__ = (
        "_headers",
        "_missing",
        "_parts",
        "bytes",
        "cipher",
        "discarded_bytes",
        "discards",
        "frames",
    )

    def __init__(self, cipher: Cipher | None = None) -> None:
        self.cipher = cipher
        self.discards: dict[Discard, int] = dict.fromkeys(Discard, 0)
        self.discarded_bytes = 0
        self.frames = 0
        self.bytes = 0
        self._parts: list[bytes] = []
        self._missing = 0  # bytes without which the kept parts cannot become a frame
        self._headers: dict[int, _Header] = {}

    def feed(self, data: bytes) -> list[Frame]:
        """Take the next bytes of the stream; returns the frames that they complete."""
        size = len(data)
        self.bytes += size
        if self._missing > size:
            # Joining only when something can come of it keeps dribbled reads linear.
            self._missing -= size
            self._parts.append(bytes(data))
            return []
        if self._parts:
            self._parts.append(data)
            data = self._take_parts()
        return self._scan(data)

    def close(self) -> list[Frame]:
        """End of the stream: give up on an incomplete frame and look inside it."""
        frames: list[Frame] = []
        while self._parts:
            self.discards[Discard.TRUNCATED] += 1
            self.discarded_bytes += 1
            frames += self._scan(self._take_parts()[1:])
        return frames

    @property
    def pending(self) -> int:
        """Bytes kept because they may begin a frame, at most 1022."""
        return sum(map(len, self._parts))

    def _take_parts(self) -> bytes:
        data = b"".join(self._parts)
        self._parts.clear()
        self._missing = 0
        return data

    def _scan(self, data: bytes) -> list[Frame]:
        # Every frame of every link passes here, so this is written for speed: one loop, few calls.
        frames: list[Frame] = []
        headers = self._headers
        size = len(data)
        position = end = delivered = false_starts = 0
        while position < size:
            if data[position] != SOF:
                position = data.find(SOF, position)
                if position < 0:
                    position = size
                    break
            end = position + HEADER_SIZE
            if end > size:
                break
            word, sequence, crc16 = _unpack_header(data, position)
            header = headers.get(word) or self._read_header(word, data[position:end])
            if header is None or header[0] ^ _LOW[sequence & 0xFF] ^ _HIGH[sequence >> 8] != crc16:
                skipped = _flood(data, position) if word == _FLOOD_WORD else 1
                false_starts += skipped
                position += skipped
                continue
            _, length, session, is_ack, encrypted, padding, discard = header
            if discard is not None:
                self.discards[discard] += 1
                position += 1
                continue
            end = position + length
            if end > size:
                break
            frame = data[position:end]
            if length > HEADER_SIZE and crc32(frame, ZLIB_START) != FRAME_RESIDUE:
                self.discards[Discard.FRAME_CRC] += 1
                position += 1
                continue
            payload = frame[HEADER_SIZE:-CRC32_SIZE]
            if encrypted or padding:
                discard, payload = self._open(payload, encrypted, padding)
                if discard is not None:
                    self.discards[discard] += 1
                    # An intact frame for which there is no key is passed over whole; one whose
                    # padding cannot be is not a frame, so the search goes on inside it.
                    position = end if discard is Discard.NO_KEY else position + 1
                    continue
            # Frame(…) would go through a constructor in Python, at twice the cost.
            frames.append(_new(Frame, (session, is_ack, sequence, encrypted, padding, payload)))
            delivered += length
            position = end
        if position < size:
            self._parts.append(data[position:])
            self._missing = end - size
        if false_starts:
            self.discards[Discard.HEADER_CRC] += false_starts
        self.discarded_bytes += position - delivered
        self.frames += len(frames)
        return frames

    def _read_header(self, word: int, raw: bytes) -> _Header | None:
        """What a header says, remembered; None when its CRC16 is wrong."""
        if header_crc16(raw) != HEADER_RESIDUE:
            return None
        if len(self._headers) >= _CACHE_LIMIT:
            self._headers.clear()
        header = self._headers[word] = _parse_header(raw)
        return header

    def _open(self, payload: bytes, encrypted: bool, padding: int) -> tuple[Discard | None, bytes]:
        """Decrypt and remove the padding, or say why that cannot be."""
        if padding > BLOCK_SIZE or padding > len(payload):
            return Discard.PADDING, payload
        if not encrypted or not payload:
            return None, payload  # padding means nothing here, DJI's codec ignores it too
        if self.cipher is None:
            return Discard.NO_KEY, payload
        return None, self.cipher.decrypt(payload)[: len(payload) - padding]


_FLOOD_WORD = int.from_bytes(bytes([SOF] * 8), "little")
_after_flood = re.compile(b"[^\xaa]").search


def _flood(data: bytes, position: int) -> int:
    """How many of the start bytes that follow each other from here begin no header.

    Twelve start bytes in a row are not a header (their CRC16 is wrong), so where a line floods with
    them only the last eleven are worth a look.
    """
    after = _after_flood(data, position)
    run = (after.start() if after else len(data)) - position
    return max(1, run - HEADER_SIZE + 1)
