"""What QGroundControl 4 asks of a ``.plan`` before it shows it, part by part.

Written from its readers of the plan, the mission, its simple items, the fence and the rally points:
which fields have to be there, of which kind, and which versions it takes. Where it wants a number
it takes null, too, as a number that nobody gave.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

__all__ = ["faults_of"]

_NUMBER, _LIST, _OBJECT, _TEXT, _BOOL = "number", "list", "object", "text", "bool"
_KINDS = {_LIST: list, _OBJECT: dict, _TEXT: str, _BOOL: bool}

# By part: field, kind, whether it has to be there.
_FILE = (
    ("fileType", _TEXT, True),
    ("version", _NUMBER, True),
    ("groundStation", _TEXT, False),
    ("mission", _OBJECT, True),
    ("geoFence", _OBJECT, True),
    ("rallyPoints", _OBJECT, True),
)
_MISSION = (
    ("plannedHomePosition", _LIST, True),
    ("items", _LIST, True),
    ("firmwareType", _NUMBER, True),
    ("vehicleType", _NUMBER, False),
    ("cruiseSpeed", _NUMBER, False),
    ("hoverSpeed", _NUMBER, False),
    ("globalPlanAltitudeMode", _NUMBER, False),
)
_FENCE = (("version", _NUMBER, True), ("circles", _LIST, True), ("polygons", _LIST, True))
_RALLY = (("version", _NUMBER, True), ("points", _LIST, True))
_ITEM = (
    ("type", _TEXT, True),
    ("frame", _NUMBER, True),
    ("command", _NUMBER, True),
    ("params", _LIST, True),
    ("autoContinue", _BOOL, True),
    ("doJumpId", _NUMBER, False),
)
# One of them at an item asks for all.
_HEIGHTS = (
    ("AltitudeMode", _NUMBER, True),
    ("Altitude", _NUMBER, True),
    ("AMSLAltAboveTerrain", _NUMBER, True),
)
_VERSIONS = {"file": (1,), "mission": (1, 2), "geoFence": (2,), "rallyPoints": (2,)}
_ALTITUDE_MODES = range(6)  # mixed, relative, absolute, two of the terrain, none
_FRAMES = (0, 2, 3, 5, 6, 10, 11)
_WITH_PLACE = (16, 21, 22)
_PX4, _ARDUPILOT, _GENERIC = 12, 3, 0


def _is(value: object, kind: str) -> bool:
    if kind == _NUMBER:
        return value is None or (isinstance(value, int | float) and not isinstance(value, bool))
    return isinstance(value, _KINDS[kind])


def _fields(part: dict[str, Any], wanted: Any, name: str) -> Iterator[str]:
    for field, kind, is_needed in wanted:
        if field not in part:
            if is_needed:
                yield f"{name} has no {field}"
        elif not _is(part[field], kind):
            yield f"{name}: {field} is {part[field]!r}, not a {kind}"


def _place(place: list[Any], name: str) -> Iterator[str]:
    if len(place) != 3 or not all(_is(one, _NUMBER) for one in place):
        yield f"{name} is not latitude, longitude and altitude: {place!r}"
    elif not (abs(place[0]) <= 90 and abs(place[1]) <= 180):
        yield f"{name} is nowhere: {place!r}"


def _item(item: dict[str, Any], name: str) -> Iterator[str]:
    found = list(_fields(item, _ITEM, name))
    yield from found
    if found:
        return
    if item["type"] != "SimpleItem":
        yield f"{name} is of type {item['type']}"
    if not isinstance(item["command"], int) or not 0 < item["command"] < 65536:
        yield f"{name}: command {item['command']!r}"
    if item["frame"] not in _FRAMES:
        yield f"{name}: frame {item['frame']!r}"
    parameters = item["params"]
    if len(parameters) != 7 or not all(_is(one, _NUMBER) for one in parameters):
        yield f"{name}: params are not seven numbers: {parameters!r}"
    elif item["command"] in _WITH_PLACE:
        yield from _place(parameters[4:], f"the place of {name}")
    if any(field in item for field, *_ in _HEIGHTS):
        yield from _fields(item, _HEIGHTS, name)
        if item.get("AltitudeMode") not in _ALTITUDE_MODES:
            yield f"{name}: AltitudeMode {item.get('AltitudeMode')!r}"


def _mission(mission: dict[str, Any]) -> Iterator[str]:
    yield from _place(mission["plannedHomePosition"], "plannedHomePosition")
    if mission["firmwareType"] not in (_PX4, _ARDUPILOT, _GENERIC):
        yield f"firmwareType {mission['firmwareType']!r}"
    if mission.get("globalPlanAltitudeMode", 0) not in _ALTITUDE_MODES:
        yield f"globalPlanAltitudeMode {mission['globalPlanAltitudeMode']!r}"
    ids = [item.get("doJumpId") for item in mission["items"]]
    if len(set(ids)) != len(ids):
        yield f"doJumpId stands twice: {ids}"
    for number, item in enumerate(mission["items"], start=1):
        yield from _item(item, f"item {number}")


def _no_number(text: str) -> Any:
    raise AssertionError(f"{text} is not JSON")


def faults_of(text: str) -> list[str]:
    """What it would refuse about a file, or read as something else; best an empty list."""
    document = json.loads(text, parse_constant=_no_number)
    faults = list(_fields(document, _FILE, "the file"))
    if faults:
        return faults
    if document["fileType"] != "Plan":
        faults.append(f"fileType is {document['fileType']!r}")
    parts = {"file": document} | {name: document[name] for name in list(_VERSIONS)[1:]}
    for name, versions in _VERSIONS.items():
        if parts[name].get("version") not in versions:
            faults.append(f"{name} has version {parts[name].get('version')!r}")
    for name, wanted in (("mission", _MISSION), ("geoFence", _FENCE), ("rallyPoints", _RALLY)):
        faults += _fields(document[name], wanted, name)
    return faults or list(_mission(document["mission"]))
