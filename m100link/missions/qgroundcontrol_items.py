"""The mission items of a ``.plan`` of QGroundControl: a file taken apart, nothing understood."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from typing import Any, NamedTuple

from m100link.errors import BadPlan
from m100link.missions.waypoint import number

__all__ = ["FILE_TYPE", "Item", "bad", "items_of", "refuse_fences"]

FILE_TYPE = "Plan"
_FILE_VERSION, _MISSION_VERSION = 1, 2
_PARAMETERS = 7

# What stands in files of QGroundControl, by its name in MAVLink.
_NAMES = {
    16: "NAV_WAYPOINT",
    17: "NAV_LOITER_UNLIM",
    18: "NAV_LOITER_TURNS",
    19: "NAV_LOITER_TIME",
    20: "NAV_RETURN_TO_LAUNCH",
    21: "NAV_LAND",
    22: "NAV_TAKEOFF",
    82: "NAV_SPLINE_WAYPOINT",
    84: "NAV_VTOL_TAKEOFF",
    85: "NAV_VTOL_LAND",
    93: "NAV_DELAY",
    112: "CONDITION_DELAY",
    113: "CONDITION_CHANGE_ALT",
    114: "CONDITION_DISTANCE",
    115: "CONDITION_YAW",
    177: "DO_JUMP",
    178: "DO_CHANGE_SPEED",
    179: "DO_SET_HOME",
    181: "DO_SET_RELAY",
    183: "DO_SET_SERVO",
    189: "DO_LAND_START",
    195: "DO_SET_ROI_LOCATION",
    196: "DO_SET_ROI_WPNEXT_OFFSET",
    197: "DO_SET_ROI_NONE",
    200: "DO_CONTROL_VIDEO",
    201: "DO_SET_ROI",
    203: "DO_DIGICAM_CONTROL",
    204: "DO_MOUNT_CONFIGURE",
    205: "DO_MOUNT_CONTROL",
    206: "DO_SET_CAM_TRIGG_DIST",
    211: "DO_GRIPPER",
    214: "DO_SET_CAM_TRIGG_INTERVAL",
    530: "SET_CAMERA_MODE",
    531: "SET_CAMERA_ZOOM",
    532: "SET_CAMERA_FOCUS",
    1000: "DO_GIMBAL_MANAGER_PITCHYAW",
    2000: "IMAGE_START_CAPTURE",
    2001: "IMAGE_STOP_CAPTURE",
    2003: "DO_TRIGGER_CONTROL",
    2500: "VIDEO_START_CAPTURE",
    2501: "VIDEO_STOP_CAPTURE",
    3000: "DO_VTOL_TRANSITION",
}


class Item(NamedTuple):
    """One mission item, wherever it stood.

    Attributes:
        place: How a person finds it: ``item 3``, or ``item 3.12`` inside of a survey.
        command: Its number in MAVLink.
        parameters: Seven; NaN where the file has null.
        frame: What its height counts from.
    """

    place: str
    command: int
    parameters: tuple[float, ...]
    frame: int

    def refuse(self, why: str, *, value: object = None, remedy: str = "") -> BadPlan:
        """The error that names it."""
        return BadPlan(
            f"{self.place}, {self.name}: {why}",
            field=self.place,
            value=self.command if value is None else value,
            remedy=remedy,
        )

    @property
    def name(self) -> str:
        """Its name in MAVLink, and its number."""
        name = _NAMES.get(self.command)
        return f"{name} ({self.command})" if name else f"command {self.command}"


def bad(field_name: str, seen: str, value: object, remedy: str = "") -> BadPlan:
    """The error about a part of the file."""
    return BadPlan(seen, field=field_name, value=value, remedy=remedy)


def _part(found: object, name: str, kind: type[Any], what: str) -> Any:
    """A part of an object that has to be there and of a kind."""
    value = found.get(name) if isinstance(found, dict) else None
    if not isinstance(value, kind) or isinstance(value, bool):
        seen = f"{what} has no {name}" if value is None else f"{what}: {name} is of another kind"
        raise bad(name, seen, value, "write the file with QGroundControl again")
    return value


def items_of(
    document: dict[str, Any], leave_out: Collection[int | str]
) -> tuple[dict[str, Any], Iterator[Item]]:
    """The mission of a file, and its items with those of surveys in their place.

    Raises:
        BadPlan: The file is none of these, or has a fence; from the iterator, an item is none.
    """
    if document.get("fileType") != FILE_TYPE:
        kind = document.get("fileType")
        raise bad("fileType", f"fileType is {kind!r}", kind, f"{FILE_TYPE!r}: a mission")
    version = document.get("version")
    if version != _FILE_VERSION or isinstance(version, bool):
        raise bad("version", f"version {version!r} of a .plan is not known", version, "version 1")
    mission = _part(document, "mission", dict, "the file")
    version = mission.get("version")
    if version != _MISSION_VERSION or isinstance(version, bool):
        raise bad("mission.version", f"version {version!r} of a mission is not known", version, "2")
    refuse_fences(document, leave_out)
    return mission, _items(_part(mission, "items", list, "the mission"), leave_out)


def refuse_fences(document: dict[str, Any], leave_out: Collection[int | str]) -> None:
    """A fence that is not kept would be believed in.

    Raises:
        BadPlan: There is one, and nobody said to leave it out.
    """
    for name, parts in (("geoFence", ("circles", "polygons")), ("rallyPoints", ("points",))):
        fence = document.get(name)
        found = isinstance(fence, dict) and any(fence.get(part) for part in parts)
        if found and name not in leave_out:
            raise bad(
                name,
                f"the file has a {name}, which the M100 does not know",
                fence,
                f"leave it out by its name, {name!r}; a control block has guards of its own",
            )


def _items(
    found: Sequence[object], leave_out: Collection[int | str], prefix: str = "item "
) -> Iterator[Item]:
    """The simple items, those of surveys in their place; item 1 is the first, as in the program."""
    for index, entry in enumerate(found, start=1):
        place = f"{prefix}{index}"
        if not isinstance(entry, dict):
            raise bad(place, f"{place} is not an object", entry)
        kind = entry.get("type")
        if kind == "SimpleItem":
            command = _part(entry, "command", int, place)
            if command not in leave_out:
                yield _simple(place, command, entry)
        elif kind == "ComplexItem":
            name = entry.get("complexItemType")
            if name not in leave_out:
                yield from _items(_inner(place, name, entry), leave_out, f"{place}.")
        else:
            raise bad(place, f"{place} is of type {kind!r}", kind, "SimpleItem or ComplexItem")


def _inner(place: str, name: object, entry: dict[str, Any]) -> list[object]:
    """What a survey or a corridor was laid out as: its own items."""
    survey = entry.get("TransectStyleComplexItem")
    items = survey.get("Items") if isinstance(survey, dict) else None
    if not isinstance(items, list) or any(
        not isinstance(item, dict) or item.get("type") != "SimpleItem" for item in items
    ):
        raise bad(
            place,
            f"{place} is a {name!r} without items of its own",
            name,
            "surveys and corridors have them when QGroundControl has saved them; lay the others "
            "out as waypoints",
        )
    return items


def _simple(place: str, command: int, entry: dict[str, Any]) -> Item:
    given = _part(entry, "params", list, place)
    found = [math.nan if value is None else number(value) for value in given]
    if len(found) != _PARAMETERS or None in found or math.inf in map(abs, filter(None, found)):
        raise bad(
            f"{place}.params", f"{place}: params are not 7 numbers", given, "7, or null in places"
        )
    parameters = tuple(value for value in found if value is not None)
    item = Item(place, command, parameters, _part(entry, "frame", int, place))
    if entry.get("autoContinue", True) is not True:
        raise item.refuse("the mission would wait there", value=entry["autoContinue"])
    return item
