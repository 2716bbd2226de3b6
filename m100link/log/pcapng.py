"""A flight log as pcapng, for Wireshark: a packet per frame, and per run of bytes of no frame."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from importlib.resources import files
from struct import calcsize, pack
from typing import IO, Any

from m100link.link import Direction
from m100link.log.reading import Chunk, FlightLog
from m100link.protocol.codes import AckCode, MissionCode, SystemCode, VersionCode
from m100link.protocol.command import Acknowledged, Command
from m100link.protocol.commands import activation, control, gimbal, monitor, virtual_rc
from m100link.protocol.commands.missions import (
    EVENTS,
    STATUSES,
    Answer,
    DownloadAnswer,
    MissionStatus,
    Reached,
    WaypointEvent,
)
from m100link.protocol.commands.registry import COMMANDS
from m100link.protocol.commands.waypoint import WaypointPoint
from m100link.protocol.describing import Describer
from m100link.protocol.fields import Laid, Layout, Nibbles, Number, Numbers, Reserved
from m100link.protocol.firmware import PROFILES, FirmwareProfile, profile
from m100link.wire import Cipher, FrameDecoder, encode_frame
from m100link.wire.crc import START_VALUE, frame_crc32
from m100link.wire.frame import HEADER_SIZE, SOF, frame_length

# -- every frame of a log, decoded: what went over the line, in its order --------------------------


_SAME_S = 2e-6  # times are written to a microsecond


def in_order(chunks: Iterable[Chunk]) -> Iterator[Chunk]:
    """The chunks; of those of the same moment sent ones come first, as they do on virtual time."""
    group: list[Chunk] = []
    for chunk in chunks:
        if group and chunk.at - group[0].at > _SAME_S:
            yield from sorted(group, key=_is_received)
            group = []
        group.append(chunk)
    yield from sorted(group, key=_is_received)


def _is_received(chunk: Chunk) -> bool:
    return chunk.direction is Direction.RECEIVED


def read_frames(
    flight: FlightLog,
    *,
    firmware: str | FirmwareProfile | None = None,
    cipher: Cipher | None = None,
) -> Iterator[dict[str, Any]]:
    """The frames of both directions in order of time, as ``m100link decode`` describes them.

    Each has ``utc`` and ``at`` (POSIX time and the event loop's clock, s, of the read or write that
    ended it) and ``direction`` (``rx`` or ``tx``) besides. Damaged frames come where they were
    passed over: ``discards``, their number, and ``cause``.

    Args:
        flight: The log.
        firmware: Profile to read them by; by default that of the flight.
        cipher: Decrypts; without one encrypted data stays as it travelled.

    Raises:
        UsageError: The firmware of the flight was never known, and none is given.
    """
    chosen = flight.firmware if firmware is None else profile(firmware)
    if chosen is None:
        raise flight.nameless("firmware='1.0', or --firmware")
    sent, received = Describer(chosen, cipher), Describer(chosen, cipher)
    sent.answered, received.answered = received.asked, sent.asked
    last: dict[str, Any] = {}
    both = {Direction.SENT: sent, Direction.RECEIVED: received}
    for chunk in in_order(flight.chunks()):
        describer = both[chunk.direction]
        before = dict(describer.decoder.discards)
        last[chunk.direction.value] = head = {
            "utc": round(chunk.utc, 6),
            "at": round(chunk.at, 6),
            "direction": chunk.direction.value,
        }
        for frame in describer.feed(chunk.data):
            yield head | frame
        yield from _lost(head, describer, before)
    for direction, describer in both.items():
        if direction.value in last:
            before = dict(describer.decoder.discards)
            for frame in describer.close():
                yield last[direction.value] | frame
            yield from _lost(last[direction.value], describer, before)


def _lost(
    head: dict[str, Any], describer: Describer, before: dict[Any, int]
) -> Iterator[dict[str, Any]]:
    """The bytes passed over since."""
    now = describer.decoder.discards
    if now == before:
        return
    for cause, count in now.items():
        if count > before.get(cause, 0):
            yield head | {"discards": count - before.get(cause, 0), "cause": str(cause)}


# -- pcapng ----------------------------------------------------------------------------------------

LINKTYPE = 147  # DLT_USER0
_SECTION, _INTERFACE, _PACKET = 0x0A0D0D0A, 1, 6
_NAME, _DESCRIPTION, _RESOLUTION, _FLAGS = 2, 3, 9, 2
_INBOUND, _OUTBOUND = 1, 2
_LAST_NS = (1 << 64) - 1


def write_pcapng(
    flight: FlightLog,
    stream: IO[bytes],
    *,
    firmware: str | FirmwareProfile | None = None,
    cipher: Cipher | None = None,
) -> int:
    """Write the traffic of the line.

    The description of the interface says the firmware, which the dissector reads. With a key, each
    encrypted frame is followed by its plain content, on a second interface.

    Args:
        flight: The log.
        stream: The file that takes the bytes.
        firmware: Profile to name; by default that of the flight.
        cipher: Decrypts.

    Returns:
        How many packets of the line there are.
    """
    known = flight.firmware if firmware is None else profile(firmware)
    begin_pcapng(stream, known, is_decrypted=cipher is not None)
    waiting = {Direction.RECEIVED: b"", Direction.SENT: b""}
    last = 0
    count = 0
    for chunk in in_order(flight.chunks()):
        last = round(chunk.utc * 1e9)
        pieces, waiting[chunk.direction] = cut(waiting[chunk.direction] + chunk.data)
        for piece in pieces:
            count += 1
            _write(stream, piece, last, chunk.direction, cipher)
    for direction, rest in waiting.items():
        for piece in cut(rest, is_end=True)[0]:
            count += 1
            _write(stream, piece, last, direction, cipher)
    return count


def begin_pcapng(
    stream: IO[bytes], firmware: FirmwareProfile | None, *, is_decrypted: bool = False
) -> None:
    """Write the head before the packets: a section, and one or two interfaces."""
    firmware_name = "" if firmware is None else f", firmware {firmware.name}"
    stream.write(_block(_SECTION, pack("<IHHq", 0x1A2B3C4D, 1, 0, -1)))
    for name in ("m100link", "m100link decrypted")[: 2 if is_decrypted else 1]:
        options = (
            _option(_NAME, name.encode())
            + _option(_DESCRIPTION, f"{name}{firmware_name}".encode())
            + _option(_RESOLUTION, b"\x09")
            + _option(0, b"")
        )
        stream.write(_block(_INTERFACE, pack("<HHI", LINKTYPE, 0, 0) + options))


def cut(data: bytes, *, is_end: bool = False) -> tuple[list[bytes], bytes]:
    """Cut a stream into frames, damaged ones too, and runs of other bytes.

    Returns the pieces, and what may go on with the bytes that follow.
    """
    pieces: list[bytes] = []
    at = begun = 0
    while at < len(data):
        length = frame_length(data, at)
        if not length:
            if not is_end and len(data) - at < HEADER_SIZE and data[at] == SOF:
                break
            at += 1
            continue
        if len(data) - at < length and not is_end:
            break
        if at > begun:
            pieces.append(data[begun:at])
        end = min(at + length, len(data))
        if not _is_good(data[at:end]):
            # Bytes of it were lost: the next one begins within.
            end = next((n for n in range(at + 1, end) if frame_length(data, n)), end)
        pieces.append(data[at:end])
        at = begun = end
    rest = data[at:] if at < len(data) else b""
    if at > begun:
        pieces.append(data[begun:at])
    return pieces, rest


def _is_good(frame: bytes) -> bool:
    return len(frame) == HEADER_SIZE or frame_crc32(frame) == 0


def _write(
    stream: IO[bytes], piece: bytes, at_ns: int, direction: Direction, cipher: Cipher | None
) -> None:
    stream.write(packet(0, piece, at_ns, direction))
    if cipher is not None:
        for plain in _plain(piece, cipher):
            stream.write(packet(1, plain, at_ns, direction))


def _plain(piece: bytes, cipher: Cipher) -> Iterator[bytes]:
    """The content of an encrypted frame, as a frame that is not."""
    for frame in FrameDecoder(cipher).feed(piece):
        if frame.encrypted:
            yield encode_frame(
                frame.data, session=frame.session, sequence=frame.sequence, is_ack=frame.is_ack
            )


def packet(interface: int, data: bytes, at_ns: int, direction: Direction) -> bytes:
    """A packet of an interface at a POSIX time, ns; times have 64 bits."""
    at_ns = min(at_ns, _LAST_NS)
    flag = _INBOUND if direction is Direction.RECEIVED else _OUTBOUND
    head = pack("<IIIII", interface, at_ns >> 32, at_ns & 0xFFFFFFFF, len(data), len(data))
    options = _option(_FLAGS, pack("<I", flag)) + _option(0, b"")
    return _block(_PACKET, head + _padded(data) + options)


def _block(kind: int, body: bytes) -> bytes:
    size = pack("<I", 12 + len(body))
    return pack("<I", kind) + size + body + size


def _option(code: int, value: bytes) -> bytes:
    return pack("<HH", code, len(value)) + _padded(value)


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % 4)


# -- A dissector for Wireshark, made of the firmware profiles and the layouts of the commands ------
# The layouts of commands that have none of their own are declared here once more, for Wireshark;
# the golden vectors judge it.


_XYZ = (Number("flag"), Number("x", "f"), Number("y", "f"))
_MOVE = Layout(*_XYZ, Number("throttle", "f"), Number("yaw", "f"))
_MOVE_OF_DOCUMENT = Layout(*_XYZ, Number("yaw", "f"), Number("throttle", "f"))
_ANGLES = (Number("yaw", "h"), Number("roll", "h"), Number("pitch", "h"))
_ANY = Layout(Number("any"))

_LAYOUTS: dict[type[Command], tuple[Layout, ...]] = {
    activation.GetVersion: (_ANY,),
    activation.Activate: (
        Layout(
            Number("app_id", "I"),
            Number("level", "I"),
            Number("version", "I"),
            Numbers("bundle_id", activation.BUNDLE_ID_SIZE, Number("byte", "s")),
        ),
    ),
    activation.SetTelemetryRates: (Layout(Numbers("rates", 16, Number("rate"))),),
    control.RequestAuthority: (Layout(Number("obtain")),),
    control.Move: (_MOVE,),
    control.Arm: (Layout(Number("on")),),
    gimbal.GimbalSpeed: (Layout(*_ANGLES, Number("flags")),),
    gimbal.GimbalAngle: (Layout(*_ANGLES, Number("mode"), Number("duration")),),
    virtual_rc.VirtualRcSettings: (Layout(Number("flags")),),
}
_KINDS: dict[type[Command], Mapping[int, Layout]] = {
    MissionStatus: {kind.KIND: kind.LAYOUT for kind in STATUSES},
    WaypointEvent: {kind.KIND: kind.LAYOUT for kind in EVENTS},
}
# As DJI's last library lists it: without the last of its reserved bytes.
_SHORTER = {(WaypointEvent, Reached.KIND)}
_SERIAL = Numbers("serial", 11, Number("byte", "s"))
_PROTOCOL_NAME = Numbers("version", 32, Number("byte", "s"))
_VERSION_ACKS = tuple(
    Layout(Number("crc", "I"), *parts) for parts in ((_PROTOCOL_NAME,), (_SERIAL, _PROTOCOL_NAME))
)
_INTEGERS = {"B": "uint32", "H": "uint32", "I": "uint32", "b": "int32", "h": "int32", "i": "int32"}


def dissector() -> str:
    """The whole plugin as Lua, for Wireshark 3.6 and later."""
    tables = _Tables()
    text = (files("m100link.log") / "dissector.lua").read_text("utf-8")
    return f"-- Made by m100link; not to be edited.\nlocal M = {_lua(tables.made())}\n{text}"


class _Tables:
    def __init__(self) -> None:
        self._kinds: dict[str, str] = {}
        self._words: dict[str, dict[int, str]] = {}

    def made(self) -> dict[str, Any]:
        telemetry = {name: self._telemetry(name) for name in PROFILES}
        commands = {
            int.from_bytes(bytes(address)): self._command(command)
            for address, command in COMMANDS.items()
        }
        return {
            "start": START_VALUE,
            "push": int.from_bytes(bytes(monitor.PushTelemetry.ADDRESS)),
            "firmwares": list(PROFILES),
            "system": {int(code): code.name for code in SystemCode},
            "telemetry": telemetry,
            "commands": commands,
            "fields": [
                {
                    "kind": kind,
                    "abbreviation": abbreviation,
                    "name": abbreviation.rsplit(".", 1)[1],
                    "words": self._words.get(abbreviation),
                }
                for abbreviation, kind in sorted(self._kinds.items())
            ],
        }

    def _telemetry(self, firmware: str) -> list[dict[str, Any]]:
        from m100link.protocol.items import BY_NAME

        made = []
        for name, layout in PROFILES[firmware].items.items():
            formats = _letters(layout.format)
            parts = [Number(*pair) for pair in zip(layout.fields, formats, strict=True)]
            made.append(
                {
                    "flag": 1 << BY_NAME[name].bit,
                    "name": name,
                    "size": layout.size,
                    "parts": self._parts(f"m100.telemetry.{name}", Layout(*parts)),
                }
            )
        return made

    def _command(self, command: type[Command]) -> dict[str, Any]:
        prefix = f"m100.{command.NAME}"
        made: dict[str, Any] = {"name": command.NAME}
        if command in _KINDS:
            self._kinds[f"{prefix}.kind"] = "uint32"
            made["kinds"] = {
                kind: self._forms(prefix, (layout,)) for kind, layout in _KINDS[command].items()
            }
            for kind, forms in made["kinds"].items():
                if (command, kind) in _SHORTER:
                    forms |= {size - 1: parts for size, parts in forms.items()}
        elif issubclass(command, activation.MobileData):
            made["forms"] = {-1: [self._part(f"{prefix}.mobile_data", 0, "bytes", 0, 1, "bytes")]}
        elif issubclass(command, Laid):
            made["forms"] = self._forms(prefix, (command.LAYOUT,))
            if command is WaypointPoint:
                made["forms"] |= self._forms(prefix, (_of_document(command.LAYOUT),))
        elif command in _LAYOUTS:
            made["forms"] = self._forms(prefix, _LAYOUTS[command])
        if command is control.Move:
            document = self._forms(prefix, (_MOVE_OF_DOCUMENT,))
            made["by_firmware"] = {
                name: document for name, one in PROFILES.items() if not one.throttle_before_yaw
            }
        if issubclass(command, gimbal.TakePhoto | gimbal.StartVideo | gimbal.StopVideo):
            made["forms"][0] = []  # the byte that may be anything may be left out
        if issubclass(command, Acknowledged):
            made["ack"] = self._ack(f"{prefix}.ack", command)
        return made

    def _ack(self, prefix: str, command: type[Acknowledged[Any]]) -> dict[str, Any]:
        answer = command.ANSWER
        codes: Iterable[Any] = ()
        made: dict[str, Any] = {"is_byte": False}
        if issubclass(answer, Answer):
            layout = answer.RECORD.LAYOUT if issubclass(answer, DownloadAnswer) else answer.LAYOUT
            made["forms"] = self._forms(prefix, (layout,))
            codes = MissionCode
        elif issubclass(answer, AckCode):
            codes = answer
        elif command is activation.GetVersion:
            made["forms"] = self._forms(prefix, _VERSION_ACKS)
            codes = VersionCode
        made["is_byte"] = codes is MissionCode
        made["codes"] = {int(code): code.name for code in (*SystemCode, *codes)}
        return made

    def _forms(self, prefix: str, layouts: Iterable[Layout]) -> dict[int, Any]:
        return {layout.size: self._parts(prefix, layout) for layout in layouts}

    def _parts(self, prefix: str, layout: Layout) -> list[dict[str, Any]]:
        made = []
        for offset, part in layout.offsets():
            if isinstance(part, Reserved):
                continue
            if isinstance(part, Nibbles):
                pairs = ((part.low, "low"), (part.high, "high"))
                for name, half in pairs:
                    made.append(self._part(f"{prefix}.{name}", offset, half, 1, 1, "uint32"))
                continue
            each = part.each if isinstance(part, Numbers) else part
            many = part.many if isinstance(part, Numbers) else 1
            kind = _INTEGERS.get(each.format, "string" if each.format == "s" else "double")
            abbreviation = f"{prefix}.{part.name}"
            if each.words:
                self._words[abbreviation] = dict(enumerate(each.words))
            size = calcsize(f"<{each.format}")
            made.append(self._part(abbreviation, offset, each.format, many, size, kind))
        return made

    def _part(
        self, abbreviation: str, offset: int, format_: str, many: int, size: int, kind: str
    ) -> dict[str, Any]:
        # A value that is a whole number in one firmware and not in another is shown as the latter.
        known = self._kinds.setdefault(abbreviation, kind)
        if known != kind:
            self._kinds[abbreviation] = "double"
            self._words.pop(abbreviation, None)
        return {
            "abbreviation": abbreviation,
            "format": format_,
            "offset": offset,
            "many": many,
            "size": size,
        }


def _letters(format_: str) -> str:
    """A letter per value: ``2d2fB`` is ``ddffB``."""
    made, count = "", ""
    for letter in format_:
        if letter.isdigit():
            count += letter
        else:
            made += letter * int(count or 1)
            count = ""
    return made


def _of_document(layout: Layout) -> Layout:
    """The 87 bytes that the documents print: 15 actions and 15 parameters."""
    parts = [part for _, part in layout.offsets()]
    fewer = [part._replace(many=15) if isinstance(part, Numbers) else part for part in parts]
    return Layout(*fewer)


def _lua(value: Any) -> str:
    if value is None:
        return "nil"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, Mapping):
        pairs = (f"[{_lua(key)}]={_lua(one)}" for key, one in value.items() if one is not None)
        return "{" + ",".join(pairs) + "}"
    return "{" + ",\n".join(map(_lua, value)) + "}"
