"""Messages of MAVLink 2 that the bridge speaks: a row each, as the public definitions have them.

``messages.txt`` has the rows, ``number NAME: fields``, in the order of the wire; what stands behind
``|`` are extensions, which older programs leave out. The extra byte of the checksum follows from
names and types, so a field that is wrong there is a message that nobody understands.
"""

from __future__ import annotations

import hashlib
import hmac
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from struct import Struct
from typing import Any, NamedTuple

import crcmod

from m100link.apps.mavlink.translator.numbers import MavCommand

DEFINITIONS = Path(__file__).with_name("messages.txt").read_text(encoding="utf-8")
"""All of them; each row may go on in lines that are indented."""


# -- MAVLink 2 as bytes: a datagram into messages, a message into a frame, with signatures ---------
# A codec of our own because every datagram has to be read by itself: a reader of streams that meets
# a false start byte swallows the valid command behind it. No I/O and no clock: the time of
# signatures is an argument.


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

Sender = tuple[int, int, int]  # system, component and link of who signs

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
class MavlinkMessage:
    name: str  # as in the definitions
    fields: Mapping[str, Any]  # values by name; a text for characters, a tuple for other arrays
    system: int = 0  # who sent it; 0 for what is to be sent
    component: int = 0  # which part of that system

    def __getitem__(self, name: str) -> Any:
        return self.fields[name]


Address = tuple[str, int]  # host and port
MOST_PEERS = 16  # ground stations and programs at once: each costs the telemetry of every aircraft


@dataclass(frozen=True, slots=True)
class Peer:
    address: Address  # where its datagrams come from
    system: int
    component: int

    @property
    def name(self) -> str:
        return f"MAVLink {self.system} at {self.address[0]}:{self.address[1]}"

    @property
    def target(self) -> dict[str, int]:
        """The fields of a message that is for it alone."""
        return {"target_system": self.system, "target_component": self.component}


@dataclass(frozen=True, slots=True)
class _Field:
    """A field: name, whether it is text, and how many values it has (0: it is not an array)."""

    name: str
    is_text: bool
    count: int


@dataclass(frozen=True, slots=True)
class MessageLayout:
    number: int
    name: str
    # The byte that its checksum ends with: two ends with different definitions do not understand
    # each other.
    crc_extra: int
    _struct: Struct
    _fields: tuple[_Field, ...]

    @property
    def fields(self) -> tuple[str, ...]:
        """Names, in the order of the wire."""
        return tuple(one.name for one in self._fields)

    @property
    def size(self) -> int:
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


def _layout(row: str) -> MessageLayout:
    number, name, columns = re.fullmatch(r"(\d+) (\w+): (.+)", row).groups()  # type: ignore[union-attr]  # a row of ours
    basic, _, extensions = columns.partition(" | ")
    extra, codes, fields = f"{name} ".encode(), "<", []
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
    crc = _crc(extra)
    return MessageLayout(int(number), name, (crc & 0xFF) ^ (crc >> 8), Struct(codes), tuple(fields))


LAYOUTS: dict[str, MessageLayout] = {
    layout.name: layout
    for layout in map(_layout, DEFINITIONS.replace("\n    ", " ").strip().splitlines())
}
"""By name."""

_BY_NUMBER = {layout.number: layout for layout in LAYOUTS.values()}


@dataclass
class PacketSigner:
    """A secret that both ends know: who has it not is not obeyed.

    A frame is taken once: its time has to be later than that of any frame before it from the same
    sender, which is noted only when the signature is right.
    """

    key: bytes = field(repr=False)  # 32 bytes
    link: int = 0  # which of several links signs
    refused: int = 0  # frames that were not taken
    sent: int = 0  # newest time that was signed or taken; later starts begin with it
    # Newest time that was taken of each sender.
    newest: dict[Sender, int] = field(default_factory=dict)
    oldest: int = 0  # what is not later is not taken from anybody who is heard first

    def sign(self, frame: bytes, now: int) -> bytes:
        """The signature of a frame that ends with its checksum; ``now`` in 10 µs since 2015."""
        self.sent = max(self.sent + 1, now)
        stamp = bytes([self.link]) + self.sent.to_bytes(6, "little")
        return stamp + self._digest(frame + stamp)

    def takes(self, frame: bytes, sender: tuple[int, int], now: int) -> bool:
        """Whether the signature at the end is right, and the frame not an old one."""
        stamp = frame[-_SIGNATURE:-6]
        when = int.from_bytes(stamp[1:], "little")
        stream = (*sender, stamp[0])
        # A sender that is heard first may not be more than a minute behind.
        since = max(now, self.sent) - NEW_WITHIN
        newest = self.newest.get(stream, max(since, self.oldest))
        is_right = hmac.compare_digest(self._digest(frame[:-6]), frame[-6:])
        if not is_right or not newest < when <= LAST_SIGNATURE:
            return False
        if stream not in self.newest and len(self.newest) >= _MOST_SENDERS:
            # A forgotten sender counts as new: frames as old as its last one are refused.
            self.newest = {one: at for one, at in self.newest.items() if at > since}
            if len(self.newest) >= _MOST_SENDERS:
                return False
        self.newest[stream] = when
        # A peer with a later clock would refuse frames that are signed by ours.
        self.sent = max(self.sent, when)
        return True

    def _digest(self, data: bytes) -> bytes:
        return hashlib.sha256(self.key + data).digest()[:6]


def write_frame(
    message: MavlinkMessage,
    *,
    system: int,
    sequence: int,
    signer: PacketSigner | None = None,
    now: int = 0,
) -> bytes:
    """A frame of version 2 from component 1 of a system, 1 to 255; ``now`` in 10 µs since 2015."""
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


class MessageReader:
    """The valid messages of a datagram, each searched from the end of the one before.

    With a signer nothing is taken without a signature: by a HEARTBEAT alone anybody could look, or
    have all telemetry sent to a third party. ``now`` is the time of signatures, 10 µs since 2015.
    When :attr:`checked` is ``most``, the rest is left unread: a datagram can be made to look like
    many overlapping frames, each of which is checked to its end.
    """

    def __init__(
        self,
        data: bytes,
        *,
        signer: PacketSigner | None = None,
        now: int = 0,
        most: int | None = None,
    ) -> None:
        # Bytes that looked like a frame, so far, counted again where such frames overlap: what
        # reading cost. Bytes between frames are skipped and cost next to nothing.
        self.checked = 0
        self._data = data
        self._signer = signer
        self._now = now
        self._most = most

    def __iter__(self) -> Iterator[MavlinkMessage]:
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
            # A byte looked like a start and was none: the next one may be one.
            start = _START.search(data, found.end or at + 1)


# Where the sender, the number and the payload of a frame begin, by its first byte.
_PLACES = {_V2: (5, 7, _HEADER_V2.size), _V1: (3, 5, _HEADER_V1.size)}
# Bytes of a datagram with one command: SET_MODE of version 1, and a command with its signature.
_SHORTEST_COMMAND, LONGEST_COMMAND = 14, 64
_ENDING = frozenset(
    (
        *(MavCommand.NAV_LAND, MavCommand.NAV_RETURN_TO_LAUNCH, MavCommand.COMPONENT_ARM_DISARM),
        *(MavCommand.DO_SET_MODE, MavCommand.DO_SET_STANDARD_MODE),
        *(MavCommand.DO_PAUSE_CONTINUE, MavCommand.DO_REPOSITION),
    )
)


def ending_command(data: bytes) -> tuple[int, int, int, int] | None:
    """System, component, target and number of a command that may end a flight; None of any other.

    Nothing is read or checked: it costs less than a microsecond, in a flood as well.
    """
    if not _SHORTEST_COMMAND <= len(data) <= LONGEST_COMMAND or data[0] not in _PLACES:
        return None
    sender, number, begin = _PLACES[data[0]]
    payload = data[begin : begin + data[1]].ljust(32, b"\0")  # zeros at its end are left out
    command = int.from_bytes(payload[28:30], "little")
    if data[number] == 11:  # SET_MODE
        return data[sender], data[sender + 1], payload[4], MavCommand.DO_SET_MODE
    if data[number] in (75, 76) and command in _ENDING:
        return data[sender], data[sender + 1], payload[30], command
    return None


class _Found(NamedTuple):
    message: MavlinkMessage | None  # the message, if it is one for us
    end: int  # where the frame ends; 0 if there is none
    checked: int  # bytes that were looked at


_NO_FRAME = _Found(None, 0, _HEADER_V2.size)


def _frame_v2(data: bytes, at: int, signer: PacketSigner | None, now: int) -> _Found:
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
    if signer is not None:
        sender = system, component
        if not (is_signed and signer.takes(data[at:whole], sender, now)):
            signer.refused += 1
            return _Found(None, whole, whole - at)
    fields = layout.read(data[begin : begin + size])
    message = MavlinkMessage(layout.name, fields, system, component)
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
    if is_signed:
        return _Found(None, end, end - at)
    fields = layout.read(data[begin : begin + size])
    message = MavlinkMessage(layout.name, fields, system, component)
    return _Found(message, end, end - at)


def _is_whole(data: bytes, at: int, end: int, layout: MessageLayout) -> bool:
    (checksum,) = _CHECKSUM.unpack_from(data, end - 2)
    return bool(checksum == _crc(data[at + 1 : end - 2] + bytes([layout.crc_extra])))
