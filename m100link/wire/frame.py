"""Frames and bytes (document 1.1 and 1.2; docs: reference/wire-format).

A frame is a 12-byte header with its own CRC16, up to 1007 bytes of data and a CRC32::

    0      1–2             3                 4              5–7    8–9   10–11   12…    LEN−4…
    0xAA   LEN:10 VER:6    SESSION:5 A:1 0:2 PADDING:5 ENC:3 0      SEQ   CRC16   DATA   CRC32

An empty payload makes a frame of the header alone, without a CRC32.
"""

from __future__ import annotations

from enum import StrEnum
from struct import Struct
from typing import NamedTuple

from m100link.errors import PayloadTooLarge, UsageError
from m100link.wire.cipher import BLOCK_SIZE, Cipher
from m100link.wire.crc import (
    FRAME_RESIDUE,
    SEQUENCE_CRC16_HIGH,
    SEQUENCE_CRC16_LOW,
    frame_crc32,
    frame_residue,
    header_crc16_of_word,
    sequence_crc16,
)

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
    crc16 = header_crc16_of_word(_WORD.pack(word)) ^ sequence_crc16(sequence)
    header = _HEADER.pack(word, sequence, crc16)
    if not data:
        return header
    body = header + data
    return body + _CRC32.pack(frame_crc32(body))


class _Header(NamedTuple):
    """What the first eight bytes of a header say, remembered so that repeats cost one lookup.

    ``discard`` is None for a usable header. ``crc`` is the CRC16 with sequence number 0.
    """

    crc: int
    length: int
    session: int
    is_ack: bool
    encrypted: bool
    padding: int
    discard: Discard | None


def _read_word(word: int) -> _Header:
    raw = _WORD.pack(word)
    length = raw[1] | (raw[2] & 0x03) << 8
    discard: Discard | None = None
    if raw[2] >> 2:
        discard = Discard.VERSION
    elif raw[3] >> 6 or raw[5] or raw[6] or raw[7]:
        discard = Discard.RESERVED_BITS
    elif length < OVERHEAD and length != HEADER_SIZE:
        discard = Discard.LENGTH
    return _Header(
        header_crc16_of_word(raw),
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
            data = b"".join(self._parts)
            self._parts.clear()
            self._missing = 0
        return self._scan(data, at_end=False)

    def close(self) -> list[Frame]:
        """End of the stream: give up on an incomplete frame and look inside it."""
        data = b"".join(self._parts)
        self._parts.clear()
        self._missing = 0
        return self._scan(data, at_end=True)

    @property
    def pending(self) -> int:
        """Bytes kept because they may begin a frame, at most 1022."""
        return sum(map(len, self._parts))

    def _scan(self, data: bytes, *, at_end: bool) -> list[Frame]:
        frames: list[Frame] = []
        headers = self._headers
        find, unpack, size = data.find, _HEADER.unpack_from, len(data)
        low, high = SEQUENCE_CRC16_LOW, SEQUENCE_CRC16_HIGH
        position = delivered = false_starts = 0
        while True:
            position = find(SOF, position)
            if position < 0:
                position = size
                break
            if size - position < HEADER_SIZE:
                if at_end:
                    self.discards[Discard.TRUNCATED] += 1
                    position += 1
                    continue
                self._missing = HEADER_SIZE - (size - position)
                break
            word, sequence, crc16 = unpack(data, position)
            header = headers.get(word) or self._remember(word)
            crc, length, session, is_ack, encrypted, padding, discard = header
            if crc ^ low[sequence & 0xFF] ^ high[sequence >> 8] != crc16:
                false_starts += 1
                position += 1
                continue
            if discard is not None:
                self.discards[discard] += 1
                position += 1
                continue
            end = position + length
            if end > size:
                if at_end:
                    self.discards[Discard.TRUNCATED] += 1
                    position += 1
                    continue
                self._missing = end - size
                break
            frame = data[position:end]
            if length > HEADER_SIZE and frame_residue(frame) != FRAME_RESIDUE:
                self.discards[Discard.FRAME_CRC] += 1
                position += 1
                continue
            payload = frame[HEADER_SIZE:-CRC32_SIZE]
            if encrypted or padding:
                opened = self._open(payload, encrypted, padding)
                if opened is None:
                    # An intact frame for which there is no key is passed over whole; one whose
                    # padding cannot be is no frame, so the search goes on inside it.
                    position = end if self.cipher is None and encrypted else position + 1
                    continue
                payload = opened
            frames.append(Frame(session, is_ack, sequence, encrypted, padding, payload))
            delivered += length
            position = end
        if position < size:
            self._parts.append(data[position:])
        self.discards[Discard.HEADER_CRC] += false_starts
        self.discarded_bytes += position - delivered
        self.frames += len(frames)
        return frames

    def _remember(self, word: int) -> _Header:
        if len(self._headers) >= _CACHE_LIMIT:
            self._headers.clear()
        header = self._headers[word] = _read_word(word)
        return header

    def _open(self, payload: bytes, encrypted: bool, padding: int) -> bytes | None:
        """Decrypt and remove the padding; None (and a count) when that cannot be."""
        if padding > BLOCK_SIZE or padding > len(payload):
            self.discards[Discard.PADDING] += 1
            return None
        if not encrypted:
            return payload  # the field means nothing here, DJI's codec ignores it too
        if not payload:
            return payload
        if self.cipher is None:
            self.discards[Discard.NO_KEY] += 1
            return None
        return self.cipher.decrypt(payload)[: len(payload) - padding]
