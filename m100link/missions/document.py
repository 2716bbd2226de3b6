"""Plans as JSON of our own: every field by the name that it has in Python, choices by their names.

A part of a file that the reader skipped would be missing in flight without anybody knowing. So it
skips none: it refuses a field that does not exist, or stands there twice, by its name.
"""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from enum import IntEnum
from pathlib import Path
from typing import Any

from m100link.errors import BadPlan
from m100link.errors.texts import read_json, shortened
from m100link.missions.checks import wrong
from m100link.missions.waypoint import (
    ACTIONS,
    CHOICES,
    PlanValues,
    Waypoint,
    WaypointAction,
)

FORMAT = "m100link waypoint plan"
VERSION = 1
_GIVE_A_PLAN = "give a plan as JSON, or a .plan of QGroundControl"

_FIELDS = ("speed", "max_speed", *CHOICES, "gimbal_by_waypoint", "repeat", "take_off")
_POINT_FIELDS = tuple(field.name for field in fields(Waypoint) if field.name != "_")
_NEEDED = ("latitude_deg", "longitude_deg", "height")

# Actions that are a word, and actions that are an object with one number.
_Made = Callable[..., WaypointAction]
_WORDS: dict[str, _Made] = {name: kind for name, kind in ACTIONS.items() if not kind.__match_args__}
_NUMBERED: dict[str, _Made] = {name: kind for name, kind in ACTIONS.items() if kind.__match_args__}


def to_json(plan: PlanValues) -> str:
    """See :meth:`m100link.WaypointPlan.to_json`."""
    lines = [f'  "format": {json.dumps(FORMAT)}', f'  "version": {VERSION}']
    values = values_of(plan)
    points = values.pop("waypoints")
    lines += [f'  "{name}": {json.dumps(value)}' for name, value in values.items()]
    # A line for each point: what changed between two plans is seen in a diff.
    listed = ",\n".join(f"    {json.dumps(point)}" for point in points)
    lines.append(f'  "waypoints": [\n{listed}\n  ]')
    return "{\n" + ",\n".join(lines) + "\n}\n"


def values_of(plan: PlanValues) -> dict[str, Any]:
    """The fields of a plan as JSON has them."""
    values: dict[str, Any] = {}
    for name in _FIELDS:
        value = getattr(plan, name)
        values[name] = value.name.lower() if isinstance(value, IntEnum) else value
    values["waypoints"] = [_point_values(point) for point in plan.waypoints]
    return values


def _point_values(point: Waypoint) -> dict[str, Any]:
    defaults = {field.name: field.default for field in fields(Waypoint)}
    values = {name: getattr(point, name) for name in _POINT_FIELDS}
    values["actions"] = [_action_value(action) for action in point.actions]
    return {
        name: value
        for name, value in values.items()
        if name in _NEEDED or value != (defaults[name] if name != "actions" else [])
    }


def _action_value(action: WaypointAction) -> Any:
    name = next(name for name, kind in ACTIONS.items() if kind is type(action))
    for parameter in ACTIONS[name].__match_args__:
        return {name: getattr(action, parameter)}
    return name


def load_object(text: str | bytes) -> dict[str, Any]:
    """The object that a JSON text is; ``BadPlan``: it is none, or a name stands twice in one."""
    try:
        # Some editors begin a file with a byte order mark, at which JSON ends.
        decoded = text.decode("utf-8-sig") if isinstance(text, bytes) else text.lstrip("\ufeff")
        value = read_json(decoded, pairs=_object)
    except UnicodeDecodeError as error:
        seen = f"the file is not text: byte {error.start} is not UTF-8"
        raise BadPlan(seen, remedy=_GIVE_A_PLAN) from None
    except BadPlan:
        raise
    except ValueError as error:
        raise BadPlan(f"the file is not JSON: {error}", remedy=_GIVE_A_PLAN) from None
    if not isinstance(value, dict):
        raise BadPlan(
            f"the file is JSON, but {_named(value)} and not an object", remedy=_GIVE_A_PLAN
        )
    return value


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    made: dict[str, Any] = {}
    for name, value in pairs:
        if name in made:
            raise BadPlan(
                f"{short(name)} stands twice in one object",
                field=name,
                cause="which of them was meant cannot be known",
                remedy="leave out one",
            )
        made[name] = value
    return made


def _named(value: object) -> str:
    """A value by its kind in JSON, with itself where it is short."""
    kinds = {dict: "an object", list: "a list", str: "a text", bool: "", type(None): "null"}
    return kinds.get(type(value)) or short(value)


def short(value: object) -> str:
    """A value as JSON has it, cut off where it is long."""
    return shortened(json.dumps(value, ensure_ascii=False, default=repr))


def from_json(document: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of a plan, from an object; see :meth:`m100link.WaypointPlan.from_json`."""
    if document.get("format") != FORMAT:
        raise BadPlan(
            f"the format is {short(document.get('format'))}, not {FORMAT!r}",
            field="format",
            value=document.get("format"),
            limit=FORMAT,
            cause="the file is something else",
            remedy=f'"format": "{FORMAT}", or a .plan of QGroundControl',
        )
    # True equals 1 in Python, and is no version.
    if document.get("version") != VERSION or isinstance(document["version"], bool):
        raise BadPlan(
            f"version {short(document.get('version'))} of the format is not known",
            field="version",
            value=document.get("version"),
            limit=VERSION,
            cause="the file was written by another version of m100link",
            remedy=f'this one reads "version": {VERSION}',
        )
    _refuse_unknown(document, ("format", "version", *_FIELDS, "waypoints"))
    arguments = {name: document[name] for name in _FIELDS if name in document}
    for name, kind in CHOICES.items():
        if name in arguments:
            arguments[name] = _choice(name, kind, arguments[name])
    points = document.get("waypoints")
    if not isinstance(points, list):
        said = "is missing" if points is None else f"is {_named(points)}"
        raise wrong("waypoints", points, said, '"waypoints": a list of objects')
    arguments["waypoints"] = [_waypoint(index, point) for index, point in enumerate(points)]
    return arguments


def _refuse_unknown(
    found: Mapping[str, Any], known: Sequence[str], point: int | None = None
) -> None:
    for name in found:
        if name not in known:
            place = "" if point is None else f"waypoint {point}: "
            raise BadPlan(
                f"{place}there is no field {short(name)}",
                point=point,
                field=name,
                value=found[name],
                limit=tuple(known),
                remedy=f"one of {', '.join(known)}",
            )


def _choice(field: str, kind: type[IntEnum], value: object) -> IntEnum:
    names = {one.name.lower(): one for one in kind}
    if not isinstance(value, str) or value not in names:
        remedy = f"one of {', '.join(names)}"
        raise wrong(field, value, f"is {short(value)}", remedy, tuple(names))
    return names[value]


def _waypoint(index: int, found: object) -> Waypoint:
    if not isinstance(found, dict):
        raise BadPlan(
            f"waypoint {index} is {_named(found)}",
            point=index,
            field="waypoints",
            value=found,
            remedy=f"an object with {', '.join(_NEEDED)}",
        )
    _refuse_unknown(found, _POINT_FIELDS, index)
    for name in _NEEDED:
        if name not in found:
            raise wrong(name, None, "is missing", f"{', '.join(_NEEDED)} are needed", point=index)
    values = dict(found)
    actions = values.get("actions", [])
    if not isinstance(actions, list):
        remedy = 'a list such as ["take_photo", {"stay": 2}]'
        raise wrong("actions", actions, f"is {_named(actions)}", remedy, point=index)
    values["actions"] = [
        _action(index, f"actions[{place}]", action) for place, action in enumerate(actions)
    ]
    return Waypoint(**values)


def _action(index: int, field: str, value: object) -> WaypointAction:
    if isinstance(value, str) and value in _WORDS:
        return _WORDS[value]()
    if isinstance(value, dict) and len(value) == 1:
        [(name, number)] = value.items()
        if name in _NUMBERED:
            return _NUMBERED[name](number)
    choices = [f'"{name}"' for name in _WORDS] + [f'{{"{name}": …}}' for name in _NUMBERED]
    remedy = f"one of {', '.join(choices)}"
    raise wrong(field, value, f"is {short(value)}", remedy, tuple(choices), index)


# -- plans in files: reading, writing, and which kind a file is ------------------------------------


FILE_TYPE = "Plan"  # what QGroundControl writes into a file of a mission

_LARGEST = 16 * 1024 * 1024  # bytes; a survey of thousands of photographs has not half a megabyte


def read(path: str | Path) -> bytes:
    """The bytes of a file; ``BadPlan`` if it cannot be read, is a device, or is far too large."""
    found = b""
    try:
        is_device = stat.S_ISCHR(Path(path).stat().st_mode)
        if not is_device:  # a serial port would be read for ever
            with Path(path).open("rb") as file:
                found = file.read(_LARGEST + 1)
    except (OSError, ValueError) as error:
        raise _unusable(path, "read", error) from error
    if is_device:
        raise BadPlan(f"{os.fspath(path)!r} is a device, not a file", remedy="name a file")
    if len(found) > _LARGEST:
        raise BadPlan(f"{os.fspath(path)} is too large for a plan", remedy="16 MiB at most")
    return found


def write(path: str | Path, text: str) -> None:
    """Put a text into a file, or raise ``BadPlan``."""
    try:
        Path(path).write_text(text, encoding="utf-8")
    except (OSError, ValueError) as error:
        raise _unusable(path, "written", error) from error


def _unusable(path: str | Path, done: str, error: Exception) -> BadPlan:
    reason = getattr(error, "strerror", None) or error
    remedy = "name a file"
    if isinstance(error, FileNotFoundError):
        remedy = "check its name" if done == "read" else "make its folder first"
    elif isinstance(error, PermissionError):
        remedy = f"see who may {'read' if done == 'read' else 'write'} it"
    return BadPlan(f"{os.fspath(path)!r} cannot be {done}: {reason}", remedy=remedy)


def is_named_plan(path: str | Path) -> bool:
    """Whether a file by its name is one of QGroundControl."""
    return os.fspath(path).lower().endswith(".plan")


def is_qgroundcontrol(text: str | bytes) -> bool:
    """Whether a text is one of QGroundControl's files; ``BadPlan`` if it is not JSON."""
    return load_object(text).get("fileType") == FILE_TYPE
