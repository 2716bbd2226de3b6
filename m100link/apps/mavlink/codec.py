"""MAVLink 2 as bytes: a datagram into messages, a message into a frame, with signatures.

A codec of our own because every datagram has to be read by itself: a reader of streams that meets
a false start byte swallows the valid command behind it. No I/O and no clock: the time of signatures
is an argument.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from struct import Struct
from typing import Any, NamedTuple

import crcmod

from m100link.apps.mavlink.definitions import DEFINITIONS

__all__ = [
    "LAST_SIGNATURE",
    "LAYOUTS",
    "NEW_WITHIN",
    "Layout",
    "Message",
    "Reading",
    "Sender",
    "Signer",
    "read_datagram",
    "write_frame",
]

_crc = crcmod.mkCrcFun(0x11021, initCrc=0xFFFF, rev=True, xorOut=0)

_V1, _V2 = 0xFE, 0xFD
_HEADER_V1, _HEADER_V2 = Struct("<BBBBBB"), Struct("<BBBBBBBHB")
_START = re.compile(rb"[\xfd\xfe]")
_CHECKSUM = Struct("<H")
_SIGNED = 0x01
_SIGNATURE = 13
_MOST_SENDERS = 64

NEW_WITHIN = 60_000_00
"""How old a sender may be that is heard first: one minute in the unit of signatures, 10 us."""

LAST_SIGNATURE = 2**48 - 2**40
"""Time of a signature that is still taken: its field is not counted to its end by mistake."""

Sender = tuple[int, int, int]
"""System, component and link of who signs."""

_TYPES = {
    "u8": ("uint8_t", "B"),
    "i8": ("int8_t", "b"),
    "u16": ("uint16_t", "H"),
    "i16": ("int16_t", "h"),
    "u32": ("uint32_t", "I"),
    "i32": ("int32_t", "i"),
    "u64": ("uint64_t", "Q"),
    "i64": ("int64_t", "q"),
    "f32": ("float", "f"),
    "char": ("char", "s"),
}


@dataclass(frozen=True, slots=True)
class Message:
    """One message.

    Attributes:
        name: As in the definitions.
        fields: Values by name; a text for characters, a tuple for other arrays.
        system: Who sent it; 0 for what is to be sent.
        component: Which part of that system.
        is_signed: Whether it came with a signature that is right.
    """

    name: str
    fields: Mapping[str, Any]
    system: int = 0
    component: int = 0
    is_signed: bool = field(default=False, compare=False)

    def __getitem__(self, name: str) -> Any:
        return self.fields[name]


@dataclass(frozen=True, slots=True)
class _Field:
    """A field: name, whether it is text, and how many values it has (0: it is not an array)."""

    name: str
    is_text: bool
    count: int


@dataclass(frozen=True, slots=True)
class Layout:
    """How a message lies on the wire.

    Attributes:
        number: Its number.
        name: Its name.
        crc_extra: The byte that its checksum ends with: two ends with different definitions do not
            understand each other.
        least: Bytes without extensions: what version 1 of the protocol carries.
    """

    number: int
    name: str
    crc_extra: int
    least: int
    _struct: Struct
    _fields: tuple[_Field, ...]

    @property
    def fields(self) -> tuple[str, ...]:
        """Names, in the order of the wire."""
        return tuple(one.name for one in self._fields)

    @property
    def size(self) -> int:
        """Bytes with extensions."""
        return self._struct.size

    def write(self, values: Mapping[str, Any]) -> bytes:
        """The payload; what is not named is 0."""
        flat: list[Any] = []
        for one in self._fields:
            value = values.get(one.name)
            if one.is_text:
                flat.append(b"" if value is None else value.encode("ascii", "replace"))
            elif one.count:
                given = () if value is None else value
                flat += [*given, *(0,) * (one.count - len(given))]
            else:
                flat.append(0 if value is None else value)
        return self._struct.pack(*flat)

    def read(self, payload: bytes) -> dict[str, Any]:
        """The fields; zeros at the end may have been left out, and more than we know is ignored."""
        whole = payload[: self._struct.size].ljust(self._struct.size, b"\0")
        flat = iter(self._struct.unpack(whole))
        found: dict[str, Any] = {}
        for one in self._fields:
            if one.is_text:
                found[one.name] = next(flat).split(b"\0", 1)[0].decode("ascii", "replace")
            elif one.count:
                found[one.name] = tuple(next(flat) for _ in range(one.count))
            else:
                found[one.name] = next(flat)
        return found


def _layout(row: str) -> Layout:
    number, name, told = re.fullmatch(r"(\d+) (\w+): (.+)", row).groups()  # type: ignore[union-attr]  # a row of ours
    basic, _, extensions = told.partition(" | ")
    extra, codes, fields = f"{name} ".encode(), "<", []
    least = 0
    for is_extension, part in ((False, basic), (True, extensions)):
        for one in filter(None, part.split(", ")):
            kind, called = one.split(" ")
            base, count = re.fullmatch(r"(\w+?)(?:\[(\d+)\])?", kind).groups()  # type: ignore[union-attr]  # likewise
            full, code = _TYPES[base]
            size = int(count or 0)
            if not is_extension:
                extra += f"{full} {called} ".encode() + (bytes([size]) if size else b"")
            codes += f"{size or ''}{code}"
            fields.append(_Field(called, base == "char", size))
        if not is_extension:
            least = Struct(codes).size
    crc = _crc(extra)
    return Layout(int(number), name, (crc & 0xFF) ^ (crc >> 8), least, Struct(codes), tuple(fields))


LAYOUTS: dict[str, Layout] = {
    layout.name: layout
    for layout in map(_layout, DEFINITIONS.replace("\n    ", " ").strip().splitlines())
}
"""By name."""

_BY_NUMBER = {layout.number: layout for layout in LAYOUTS.values()}


@dataclass
class Signer:
    """A secret that both ends know: who has it not is not obeyed.

    A frame is taken once: its time has to be later than that of any frame before it from the same
    sender, which is noted only when the signature is right.

    Attributes:
        key: 32 bytes.
        link: Which of several links signs.
        refused: Frames that were not taken.
        sent: Newest time that was signed or taken; later starts begin with it.
        newest: Newest time that was taken of each sender.
        oldest: What is not later is not taken from anybody who is heard first.
    """

    key: bytes = field(repr=False)
    link: int = 0
    refused: int = 0
    sent: int = 0
    newest: dict[Sender, int] = field(default_factory=dict)
    oldest: int = 0

    def sign(self, frame: bytes, now: int) -> bytes:
        """What follows the frame.

        Args:
            frame: From its first byte to its checksum.
            now: Time in 10 microseconds since 2015.
        """
        self.sent = max(self.sent + 1, now)
        told = bytes([self.link]) + self.sent.to_bytes(6, "little")
        return told + self._digest(frame + told)

    def takes(self, frame: bytes, sender: tuple[int, int], now: int) -> bool:
        """Whether the signature at the end is right, and the frame not an old one."""
        told = frame[-_SIGNATURE:-6]
        when = int.from_bytes(told[1:], "little")
        stream = (*sender, told[0])
        # A sender that is heard first may not be more than a minute behind.
        since = max(now, self.sent) - NEW_WITHIN
        newest = self.newest.get(stream, max(since, self.oldest))
        is_right = hmac.compare_digest(self._digest(frame[:-6]), frame[-6:])
        if not is_right or not newest < when <= LAST_SIGNATURE:
            return False
        if stream not in self.newest and len(self.newest) >= _MOST_SENDERS:
            # Who is forgotten is heard first again: what is old enough for that is refused.
            self.newest = {one: at for one, at in self.newest.items() if at > since}
            if len(self.newest) >= _MOST_SENDERS:
                return False
        self.newest[stream] = when
        # Who has a later clock would refuse what is signed with ours.
        self.sent = max(self.sent, when)
        return True

    def _digest(self, data: bytes) -> bytes:
        return hashlib.sha256(self.key + data).digest()[:6]


def write_frame(
    message: Message, *, system: int, sequence: int, signer: Signer | None = None, now: int = 0
) -> bytes:
    """A frame of version 2 from component 1 of a system.

    Args:
        message: What to send.
        system: Whose it is, 1 to 255.
        sequence: Counts frames of that system; modulo 256 on the wire.
        signer: Signs it.
        now: Time for the signature.
    """
    layout = LAYOUTS[message.name]
    payload = layout.write(message.fields).rstrip(b"\0") or b"\0"
    number = layout.number
    header = _HEADER_V2.pack(
        *(_V2, len(payload), 0 if signer is None else _SIGNED, 0, sequence & 0xFF),
        *(system, message.component or 1, number & 0xFFFF, number >> 16),
    )
    body = header + payload
    frame = body + _CHECKSUM.pack(_crc(body[1:] + bytes([layout.crc_extra])))
    return frame if signer is None else frame + signer.sign(frame, now)


class Reading:
    """The valid messages of a datagram, each searched from the end of the one before.

    With a signer only HEARTBEAT is taken without a signature: it moves nothing.

    Args:
        data: The datagram.
        signer: Refuses what is not signed.
        now: Time of signatures, 10 microseconds since 2015.
        most: What :attr:`checked` may become before the rest is left unread: a datagram can be made
            to look like many overlapping frames, each of which is checked to its end.

    Attributes:
        checked: Bytes that looked like a frame, so far, counted again where such frames overlap:
            what reading cost. Bytes between frames are skipped and cost next to nothing.
    """

    def __init__(
        self, data: bytes, *, signer: Signer | None = None, now: int = 0, most: int | None = None
    ) -> None:
        self.checked = 0
        self._data = data
        self._signer = signer
        self._now = now
        self._most = most

    def __iter__(self) -> Iterator[Message]:
        data, signer = self._data, self._signer
        start = _START.search(data)
        while start is not None:
            at = start.start()
            if data[at] == _V2:
                found = _frame_v2(data, at, signer, self._now)
            else:
                found = _frame_v1(data, at, is_signed=signer is not None)
            self.checked += found.checked
            if found.message is not None:
                yield found.message
            if self._most is not None and self.checked > self._most:
                return
            # What looked like a start and was none: the next byte may be one.
            start = _START.search(data, found.end or at + 1)


def read_datagram(data: bytes, *, signer: Signer | None = None, now: int = 0) -> Iterator[Message]:
    """The valid messages of a datagram, see :class:`Reading`."""
    return iter(Reading(data, signer=signer, now=now))


class _Found(NamedTuple):
    """What stands behind a start byte.

    Attributes:
        message: The message, if it is one for us.
        end: Where the frame ends; 0 if there is none.
        checked: Bytes that were looked at.
    """

    message: Message | None
    end: int
    checked: int


_NO_FRAME = _Found(None, 0, _HEADER_V2.size)


def _frame_v2(data: bytes, at: int, signer: Signer | None, now: int) -> _Found:
    begin = at + _HEADER_V2.size
    if begin + 2 > len(data):
        return _NO_FRAME
    _, size, incompatible, _, _, system, component, low, high = _HEADER_V2.unpack_from(data, at)
    layout = _BY_NUMBER.get(low | high << 16)
    end = begin + size + 2
    is_signed = bool(incompatible & _SIGNED)
    whole = end + (_SIGNATURE if is_signed else 0)
    if incompatible & ~_SIGNED or whole > len(data) or layout is None:
        return _NO_FRAME
    if not _is_whole(data, at, end, layout):
        return _Found(None, 0, end - at)
    is_owed = signer is not None and (is_signed or layout.name != "HEARTBEAT")
    if signer is not None and is_owed:
        sender = system, component
        if not (is_signed and signer.takes(data[at:whole], sender, now)):
            signer.refused += 1
            return _Found(None, whole, whole - at)
    payload = data[begin : begin + size]
    is_right = signer is not None and is_signed
    message = _message(layout, payload, system, component, is_signed=is_right)
    return _Found(message, whole, whole - at)


def _frame_v1(data: bytes, at: int, *, is_signed: bool) -> _Found:
    begin = at + _HEADER_V1.size
    if begin + 2 > len(data):
        return _NO_FRAME
    _, size, _, system, component, number = _HEADER_V1.unpack_from(data, at)
    layout = _BY_NUMBER.get(number)
    end = begin + size + 2
    if layout is None or end > len(data):
        return _NO_FRAME
    if not _is_whole(data, at, end, layout):
        return _Found(None, 0, end - at)
    if is_signed and layout.name != "HEARTBEAT":
        return _Found(None, end, end - at)
    message = _message(layout, data[begin : begin + size], system, component)
    return _Found(message, end, end - at)


def _is_whole(data: bytes, at: int, end: int, layout: Layout) -> bool:
    (told,) = _CHECKSUM.unpack_from(data, end - 2)
    return bool(told == _crc(data[at + 1 : end - 2] + bytes([layout.crc_extra])))


def _message(
    layout: Layout, payload: bytes, system: int, component: int, *, is_signed: bool = False
) -> Message | None:
    try:
        return Message(layout.name, layout.read(payload), system, component, is_signed)
    except struct.error:
        return None
