"""A dissector for Wireshark, made of the firmware profiles and the layouts of the commands.

What a command without a layout of its own holds is declared here once more, for Wireshark alone;
the golden vectors judge it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from importlib.resources import files
from struct import calcsize
from typing import Any

from m100link.protocol.codes import AckCode, MissionCode, SystemCode, VersionCode
from m100link.protocol.command import Acknowledged, Command
from m100link.protocol.commands import activation, camera, control, gimbal, monitor, virtual_rc
from m100link.protocol.commands.mission_acks import Answer, DownloadAnswer
from m100link.protocol.commands.missions import (
    EVENTS,
    STATUSES,
    MissionStatus,
    Reached,
    WaypointEvent,
)
from m100link.protocol.commands.registry import COMMANDS
from m100link.protocol.commands.waypoint import WaypointPoint
from m100link.protocol.fields import Laid, Layout, Nibbles, Number, Numbers, Reserved
from m100link.protocol.firmware import PROFILES
from m100link.wire.crc import START_VALUE

__all__ = ["dissector"]

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
    control.StartTask: (Layout(Number("task_sequence"), Number("task")),),
    control.QueryTask: (Layout(Number("task_sequence")),),
    control.Move: (_MOVE,),
    control.Arm: (Layout(Number("on")),),
    gimbal.GimbalSpeed: (Layout(*_ANGLES, Number("flags")),),
    gimbal.GimbalAngle: (Layout(*_ANGLES, Number("mode"), Number("duration")),),
    camera.TakePhoto: (_ANY,),
    camera.StartVideo: (_ANY,),
    camera.StopVideo: (_ANY,),
    monitor.AuthorityChanged: (Layout(Number("code")),),
    virtual_rc.VirtualRcSettings: (Layout(Number("flags")),),
    virtual_rc.VirtualRcData: (Layout(Numbers("channels", 16, Number("channel", "I"))),),
}
_DATA: frozenset[type[Command]] = frozenset({activation.SendToMobile, monitor.FromMobile})
_KINDS: dict[type[Command], Mapping[int, Layout]] = {
    MissionStatus: {kind.KIND: kind.LAYOUT for kind in STATUSES},
    WaypointEvent: {kind.KIND: kind.LAYOUT for kind in EVENTS},
}
# As DJI's last library lists it: without the last of its reserved bytes.
_SHORTER = {(WaypointEvent, Reached.KIND)}
_SERIAL = Numbers("serial", 11, Number("byte", "s"))
_NAME = Numbers("version", 32, Number("byte", "s"))
_VERSION_ACKS = tuple(Layout(Number("crc", "I"), *parts) for parts in ((_NAME,), (_SERIAL, _NAME)))
_INTEGERS = {"B": "uint32", "H": "uint32", "I": "uint32", "b": "int32", "h": "int32", "i": "int32"}


def dissector() -> str:
    """The whole plugin as Lua, for Wireshark 3.6 and later."""
    tables = _Tables()
    text = (files("m100link.log") / "dissector.lua").read_text("utf-8")
    return f"-- Made by m100link; not to be edited.\nlocal M = {_lua(tables.made())}\n{text}"


class _Tables:
    """What the Lua part reads."""

    def __init__(self) -> None:
        self._kinds: dict[str, str] = {}
        self._words: dict[str, dict[int, str]] = {}

    def made(self) -> dict[str, Any]:
        telemetry = {name: self._telemetry(name) for name in PROFILES}
        commands = {
            address.command_set * 256 + address.command_id: self._command(command)
            for address, command in COMMANDS.items()
        }
        push = monitor.PushTelemetry.ADDRESS
        return {
            "start": START_VALUE,
            "push": push.command_set * 256 + push.command_id,
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
        elif command in _DATA:
            made["forms"] = {-1: [self._data(f"{prefix}.mobile_data")]}
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
        if issubclass(command, camera.TakePhoto | camera.StartVideo | camera.StopVideo):
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

    def _data(self, abbreviation: str) -> dict[str, Any]:
        self._kinds[abbreviation] = "bytes"
        return {"abbreviation": abbreviation, "format": "bytes", "offset": 0, "many": 0, "size": 1}

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
        # What is a whole number in one firmware and not in another is shown as the latter.
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
    """A value of Python as Lua writes it."""
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
