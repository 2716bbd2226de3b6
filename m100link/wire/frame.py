"""Frames and bytes (document 1.1 and 1.2; docs: reference/wire-format).

A frame is a 12-byte header with its own CRC16, up to 1007 bytes of data and a CRC32::

    0      1–2             3                 4              5–7    8–9   10–11   12…    LEN−4…
    0xAA   LEN:10 VER:6    SESSION:5 A:1 0:2 PADDING:5 ENC:3 0      SEQ   CRC16   DATA   CRC32

An empty payload makes a frame of the header alone, without a CRC32.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from enum import StrEnum
from functools import cache
from itertools import compress
from struct import Struct
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar
from zlib import crc32

from m100link.errors import PayloadTooLarge, UsageError
from m100link.wire.cipher import BLOCK_SIZE, Cipher
from m100link.wire.crc import (
    FRAME_RESIDUE,
    HEADER_RESIDUE,
    SEQUENCE_CRC16,
    ZLIB_START,
    header_crc16,
    sequence_crc16_numbers,
)

if TYPE_CHECKING:
    from inspect import Signature


# -- where the next frame may begin, among bytes that are none -------------------------------------
# Anything may arrive: noise, another baud rate, a flood of start bytes. With one checksum for each
# start byte such a flood would cost more than a fast line leaves time for, so where they are many
# the checksums of many places are computed at once.


SOF = 0xAA
HEADER_SIZE = 12

_BLOCK = 64  # bytes that are looked at together
_FEW_BYTES = (
    9  # start bytes in a block up to which one checksum each is cheaper than all places at once
)
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
        if starts <= _FEW_BYTES:
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
    """The share of a byte in that half of a CRC16, by its value, from the tenth to the first.

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


# -- named tuples that are made without a constructor in Python ------------------------------------
# A named tuple takes 240 ns to make by its name, and 120 ns by ``tuple.__new__``, which looks first
# whether it may. A package has twelve records and a frame, a hundred times a second on each line,
# so there a class is asked for by what it has below its constructor: 95 ns.


T = TypeVar("T", bound=tuple[Any, ...])


class _Quick(type):
    """The class of such classes: what their constructor does is done here.

    A constructor of their own would stand in the way of :func:`maker`.
    """

    _of_fields: Callable[..., Any]

    def __call__(cls, *values: Any, **named: Any) -> Any:
        return cls._of_fields(cls, *values, **named)

    @property
    def __signature__(cls) -> Signature:
        import inspect  # which takes longer to load than all that is here

        whole = inspect.signature(cls._of_fields)
        return whole.replace(parameters=list(whole.parameters.values())[1:])


def _getnewargs(self: tuple[Any, ...]) -> tuple[tuple[Any, ...]]:
    """For copies and pickles: all values are one argument."""
    return (tuple(self),)


def quick(named: type[T]) -> type[T]:
    """Decorates a class of :class:`typing.NamedTuple`: it is used as before, see :func:`maker`."""
    own = {name: value for name, value in vars(named).items() if name != "__new__"}
    own["_of_fields"] = vars(named)["__new__"]
    own["__getnewargs__"] = _getnewargs
    own["__qualname__"] = named.__qualname__
    made: Any = _Quick(named.__name__, named.__bases__, own)
    return made  # type: ignore[no-any-return]  # the same class to its users


def maker(named: type[T]) -> Callable[[tuple[Any, ...]], T]:
    """A function that makes a :func:`quick` class of a tuple of all its values, unchecked."""
    make: Callable[[tuple[Any, ...]], T] = type.__call__.__get__(named)
    return make


# -- frame -----------------------------------------------------------------------------------------

CRC32_SIZE = 4
OVERHEAD = HEADER_SIZE + CRC32_SIZE
MAX_FRAME_SIZE = 1023
MAX_DATA_SIZE = MAX_FRAME_SIZE - OVERHEAD
MAX_SESSION = 31

_unpack_header = Struct("<QHH").unpack_from  # word (the first eight bytes), sequence, CRC16
_pack_crc32 = Struct("<I").pack
_unpack_word = Struct("<Q").unpack_from
_RESERVED = 0xFFFFFF00_C0000000  # bits of the word
# These, the version, padding, more than 63 bytes, and the start byte: a short frame says SOF only.
_NOT_SIMPLE = 0xFFFFFF1F_C0FFC0FF
_PADS = 0x1F_00000000
_PAYLOAD = slice(HEADER_SIZE, -CRC32_SIZE)

_Unpack = Callable[[bytes], tuple[Any, ...]]


def _unpack_first(data: bytes) -> tuple[int, int, int, bytes]:
    """What :data:`_unpack_whole` has for a size until bytes of that size come."""
    payload = max(0, len(data) - OVERHEAD)
    behind = len(data) - HEADER_SIZE - payload
    unpack: _Unpack = Struct(f"<QHH{payload}s{behind}x").unpack
    _unpack_whole[len(data)] = unpack
    return unpack(data)


def _unpack_nothing(_: bytes) -> tuple[int, int, int, bytes]:
    """The same for bytes that are no frame, too few or too many: a word that no header has."""
    return 0, 0, 0, b""


# By the size of what may be a frame: what takes it apart in one call, into word, sequence, CRC16
# and payload. It reaches beyond the longest by a usual read, for an exception is dearer than it.
_unpack_whole: list[_Unpack] = [
    _unpack_first if HEADER_SIZE <= size <= MAX_FRAME_SIZE else _unpack_nothing
    for size in range(MAX_FRAME_SIZE + 4096)
]


@quick
class Frame(NamedTuple):
    """One frame, decrypted and without padding."""

    session: int  #: Session id, 0 to 31 (document 1.4).
    is_ack: bool  #: True for an acknowledgement, False for a command or push.
    sequence: int  #: Sequence number, 0 to 65535. An ack repeats that of its command.
    encrypted: bool  #: Whether the data travelled encrypted.
    padding: int  #: Padding bytes that encryption added, 0 when plain.
    data: bytes  #: The payload, command set, command id and value, or the value of an ack.


_make_frame = maker(Frame)


def frame_length(data: bytes, at: int) -> int:
    """Length of the frame whose header, with a right CRC16, begins at a place; 0: none does."""
    header = data[at : at + HEADER_SIZE]
    if len(header) < HEADER_SIZE or header[0] != SOF or header_crc16(header) != HEADER_RESIDUE:
        return 0
    length = (header[1] | header[2] << 8) & 0x3FF
    return length if length >= HEADER_SIZE else 0


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


# Their places in a list of counters: a dictionary calls a function for the hash of each member.
_CAUSES = tuple(Discard)
_HEADER_CRC, _FRAME_CRC, _LENGTH, _RESERVED_BITS = range(4)
_VERSION, _PADDING, _NO_KEY, _TRUNCATED = range(4, len(_CAUSES))

# Start bytes among so many bytes up to which one checksum each is cheaper than a hunt.
_FEW, _NEAR = 5, 12

_CACHE_LIMIT = 4096  # kinds of headers that are remembered, in each direction

# By size of the data, session, ack and padding (0: plain): what packs a header and its data, the
# word of the header, and its CRC16 with sequence number 0. A program sends few kinds of frames, and
# those again and again.
_Kind = tuple[Callable[..., bytes], int, int]
_kinds: dict[tuple[int, int, bool, int], _Kind] = {}


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
    if not 0 <= sequence <= 0xFFFF:
        raise UsageError(f"sequence number {sequence} does not fit into 16 bits")
    padding = 0
    if cipher is not None and data:
        data, padding = cipher.encrypt(data)
    try:
        pack, word, crc16 = _kinds[len(data), session, is_ack, padding]
    except KeyError:
        pack, word, crc16 = _check_kind(len(data), session, is_ack, padding)
    body = pack(word, sequence, crc16 ^ SEQUENCE_CRC16[sequence], data)
    return body + _pack_crc32(crc32(body, ZLIB_START) ^ 0xFFFFFFFF) if data else body


def _check_kind(size: int, session: int, is_ack: bool, padding: int) -> _Kind:
    """The beginning of a kind of frame, kept if it may be sent; see :func:`encode_frame`."""
    if not 0 <= session <= MAX_SESSION:
        raise UsageError(f"session {session} does not exist", remedy="sessions are 0 to 31")
    length = size + OVERHEAD if size else HEADER_SIZE
    if length > MAX_FRAME_SIZE:
        limit = MAX_DATA_SIZE // BLOCK_SIZE * BLOCK_SIZE - 1 if padding else MAX_DATA_SIZE
        raise PayloadTooLarge(
            f"{size - padding} bytes of data do not fit into one frame",
            cause=f"a frame carries at most {limit} bytes{' encrypted' if padding else ''}",
            remedy="split the data",
        )
    encryption = 1 if padding else 0
    word = SOF | length << 8 | (session | is_ack << 5) << 24 | (padding | encryption << 5) << 32
    if len(_kinds) >= _CACHE_LIMIT:
        _kinds.clear()
    crc16 = header_crc16(word.to_bytes(10, "little"))  # with sequence number 0
    kind = _kinds[size, session, is_ack, padding] = Struct(f"<QHH{size}s").pack, word, crc16
    return kind


# A valid header without its sequence number, remembered so that repeats cost one lookup: its CRC16
# with sequence number 0, length, session, is_ack, encrypted, padding, whether a key stands between
# the bytes and the payload, and which part of decrypted data is no padding.
# Plain tuples: the interpreter takes those apart several times as fast as named ones.
_Header = tuple[int, int, int, bool, bool, int, bool, slice]


def _parse_word(word: int, crc16: int) -> _Header:
    """Read the word of a header that has no fault; its CRC16 is that with sequence number 0."""
    length = word >> 8 & 0x3FF
    padding = word >> 32 & 0x1F
    encrypted = word >> 37 & 0x07 != 0  # DJI's codec takes any value but 0 for AES
    is_secret = encrypted and length > OVERHEAD
    # Padding alone means nothing, DJI's codec ignores it too.
    clear = slice(length - OVERHEAD - padding if is_secret else None)
    session, is_ack = word >> 24 & 0x1F, word >> 29 & 1 != 0
    return crc16, length, session, is_ack, encrypted, padding, is_secret, clear


def _cannot_pad(word: int, length: int) -> bool:
    """Whether a header says that there is more padding than data, or than a block."""
    padding = word >> 32 & 0x1F
    return padding > 0 and (padding > BLOCK_SIZE or padding > length - OVERHEAD)


class FrameDecoder:
    """Finds the frames in a stream of bytes.

    Fed with any chunking of the same bytes it gives the same frames. After damage it looks again
    from the next byte, inside the failed frame too, so no valid frame is lost; like DJI's codec it
    keeps at most one incomplete frame (1022 bytes) between calls. Nothing that is fed in raises.

    Cost is linear in the input: what cannot begin a frame is passed over many bytes at a time, and
    a header with a good CRC16 costs at most one CRC32 over 1023 bytes.

    Args:
        cipher: Decrypts frame data. Without one, encrypted frames are counted and passed over.

    Attributes:
        cipher: May be set or replaced at any time; it applies to frames completed afterwards.
        discarded_bytes: Bytes that were part of no delivered frame.
        frames: Frames delivered.
    """

    __slots__ = (
        "_delivered",
        "_discards",
        "_headers",
        "_kept",
        "_missing",
        "_sequences",
        "cipher",
        "discarded_bytes",
        "frames",
    )

    def __init__(self, cipher: Cipher | None = None) -> None:
        self.cipher = cipher
        self._discards = [0] * len(_CAUSES)
        self.discarded_bytes = 0
        self.frames = 0
        self._delivered = 0  # bytes of these frames
        self._kept = b""  # what may begin a frame that is not all here, at most 1022 bytes
        self._missing = 0  # bytes without which that cannot become a frame; 0: nothing is kept
        self._headers: dict[int, _Header] = {}  # by word; only those without a fault
        self._sequences = sequence_crc16_numbers()

    def feed(self, data: bytes) -> list[Frame]:
        """Take the next bytes of the stream; returns the frames that they complete."""
        # Every frame of every link passes here, so this is written for speed: mostly the bytes at
        # hand are one frame of a known kind, or another piece of it. The rest is for _search.
        missing = self._missing
        if missing:
            missing -= len(data)
            if missing > 0:  # nothing can come of it yet
                self._missing = missing
                self._kept += data
                return []
            data = self._kept + data
            self._kept, self._missing = b"", 0
        size = len(data)
        try:
            word, sequence, crc16, payload = _unpack_whole[size](data)
        except IndexError:
            return self._search(data, [])
        header = self._headers.get(word)
        if header is None:
            return self._search(data, [])
        base, length, session, is_ack, encrypted, padding, is_secret, clear = header
        if base ^ self._sequences[sequence] != crc16:
            return self._search(data, [])
        frame = data
        if size != length:
            if size < length:
                self._kept, self._missing = data, length - size
                return []
            frame = data[:length]
            payload = frame[_PAYLOAD]
        if crc32(frame, ZLIB_START) != FRAME_RESIDUE and length != HEADER_SIZE:
            return self._search(data, [], self._reject(_FRAME_CRC, data, 0))
        if is_secret:
            cipher = self.cipher
            if cipher is None:
                return self._search(data, [])
            # Whole blocks, which all senders send, without a call in between.
            decrypt = cipher.decrypt if length % BLOCK_SIZE else cipher.decrypt_blocks
            payload = decrypt(payload)[clear]
        self.frames += 1
        self._delivered += length
        frames = [_make_frame((session, is_ack, sequence, encrypted, padding, payload))]
        return frames if size == length else self._search(data, frames, length)

    def _search(self, data: bytes, frames: list[Frame], position: int = 0) -> list[Frame]:
        """Add the frames from that position on to those before; keeps what may begin one more."""
        # The bytes before a header need no test: a word that is remembered begins with a start
        # byte.
        headers = self._headers
        size = len(data)
        last = size - HEADER_SIZE  # the last place where a whole header may stand
        right: Iterator[int] | None = None
        found = delivered = missing = 0
        hunted = -1  # where a hunt found a frame that is right
        while position <= last and not missing:
            word, sequence, crc16 = _unpack_header(data, position)
            header = headers.get(word)
            if header is None and (
                position == hunted
                or (
                    word & _NOT_SIMPLE == SOF
                    and header_crc16(data[position : position + HEADER_SIZE]) == HEADER_RESIDUE
                )
            ):
                header = self._learn(word, sequence, crc16)
            if header is None or header[0] ^ SEQUENCE_CRC16[sequence] != crc16:
                start = self._next_start(data, position, last)
                if start > position:
                    position = start
                    continue
                if right is None:
                    right = right_headers(data, position, last + 1)
                position, missing = self._hunt(data, position, right, last + 1)
                hunted = position
                continue
            _, length, session, is_ack, encrypted, padding, is_secret, clear = header
            end = position + length
            if end > size:
                missing = end - size
                break
            payload = b""
            if length != HEADER_SIZE:
                frame = data[position:end]
                if position != hunted and crc32(frame, ZLIB_START) != FRAME_RESIDUE:
                    position = self._reject(_FRAME_CRC, data, position)
                    continue
                payload = frame[_PAYLOAD]
            if is_secret:
                cipher = self.cipher
                if cipher is None:  # intact, so it is passed over whole
                    position += self._discard(_NO_KEY, length)
                    continue
                payload = cipher.decrypt(payload)[clear]
            frames.append(_make_frame((session, is_ack, sequence, encrypted, padding, payload)))
            found += 1
            delivered += length
            position = end
        self.frames += found
        self._delivered += delivered
        if missing:
            self._kept, self._missing = data[position:], missing
        elif position < size:
            self._keep(data, position, size)
        return frames

    def close(self) -> list[Frame]:
        """End of the stream: give up on an incomplete frame and look inside it."""
        frames: list[Frame] = []
        while self._kept:
            self._discard(_TRUNCATED, 1)
            rest, self._kept, self._missing = self._kept[1:], b"", 0
            frames += self.feed(rest)
        return frames

    @property
    def discards(self) -> dict[Discard, int]:
        """Count per :class:`Discard`."""
        return dict(zip(_CAUSES, self._discards, strict=True))

    @property
    def pending(self) -> int:
        """Bytes kept because they may begin a frame, at most 1022."""
        return len(self._kept)

    def _keep(self, data: bytes, position: int, size: int) -> None:
        """Keep what may begin a header, of bytes that are too few for one."""
        start = data.find(SOF, position)
        if start < 0:
            start = size
        else:
            self._kept, self._missing = data[start:], start + HEADER_SIZE - size
        self.discarded_bytes += start - position

    def _discard(self, cause: int, size: int) -> int:
        """Count a fault and the bytes that are passed over for it; returns their number."""
        self._discards[cause] += 1
        self.discarded_bytes += size
        return size

    def _reject(self, cause: int, data: bytes, position: int) -> int:
        """Count a start byte that begins no frame; returns the place of the next, or the end."""
        start = data.find(SOF, position + 1)
        return position + self._discard(cause, (len(data) if start < 0 else start) - position)

    def _next_start(self, data: bytes, position: int, last: int) -> int:
        """Where a header may begin next, when none that is known begins at the position.

        One checksum for each start byte, where they are few; what is passed over is counted. The
        position itself when they are many, or a header does begin there: that is for a hunt.
        """
        beyond = min(position + _NEAR, last + 1)
        if data.count(SOF, position, beyond) > _FEW:
            return position
        wrong, at = 0, data.find(SOF, position)
        while 0 <= at < beyond and header_crc16(data[at : at + HEADER_SIZE]) != HEADER_RESIDUE:
            wrong += 1
            at = data.find(SOF, at + 1)
        at = len(data) if at < 0 else at
        self._discards[_HEADER_CRC] += wrong
        self.discarded_bytes += at - position
        return at

    def _hunt(self, data: bytes, position: int, right: Iterator[int], end: int) -> tuple[int, int]:
        """Find the next frame that is right, or the header of one that is not all here.

        It counts each start byte that it skips by the fault of the header behind it. ``right``:
        the places of headers with a right CRC16 that were not looked at before. ``end``: the first
        place without room for a header. Returns its place, ``end`` when there is none, and how many
        bytes of its frame are missing.
        """
        begin, known, versions, missing, discards = position, 0, 0, 0, self._discards
        for place in right:
            if place < position:
                continue  # inside a frame
            if data[place + 2] > 0x03:  # the version, behind two bits of length
                versions += 1  # that of the densest floods
                continue
            (word,) = _unpack_word(data, place)
            length = word >> 8 & 0x3FF
            if word & _RESERVED:
                discards[_RESERVED_BITS] += 1
            elif length < OVERHEAD and length != HEADER_SIZE:
                discards[_LENGTH] += 1
            elif place + length > len(data):
                missing = place + length - len(data)
                if word not in self._headers:  # it is looked at again when the rest is here
                    self._learn(*_unpack_header(data, place))
                break
            elif (
                length != HEADER_SIZE
                and crc32(data[place : place + length], ZLIB_START) != FRAME_RESIDUE
            ):
                discards[_FRAME_CRC] += 1
            elif word & _PADS and _cannot_pad(word, length):
                discards[_PADDING] += 1
            else:
                break
            known += 1
        else:
            place = end
        if versions:
            discards[_VERSION] += versions
            known += versions
        discards[_HEADER_CRC] += data.count(SOF, begin, place) - known
        self.discarded_bytes += place - begin
        return place, missing

    def _learn(self, word: int, sequence: int, crc16: int) -> _Header | None:
        """Parse and remember a header with a right CRC16; None if it has a fault."""
        length = word >> 8 & 0x3FF
        if (length < OVERHEAD and length != HEADER_SIZE) or _cannot_pad(word, length):
            return None
        if len(self._headers) >= _CACHE_LIMIT:
            self._headers.clear()
        header = self._headers[word] = _parse_word(word, crc16 ^ SEQUENCE_CRC16[sequence])
        return header

    # Last, because from here on the name is no type.
    @property
    def bytes(self) -> int:
        """Bytes fed in: of frames, discarded, and kept."""
        return self._delivered + self.discarded_bytes + len(self._kept)
