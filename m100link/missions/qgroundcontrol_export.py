"""Plans as ``.plan`` files of QGroundControl.

MAVLink has no words for some of what the M100 flies. The items are the nearest that it has, for
people to look at and for other aircraft; beside them, under ``"m100link"``, stands the plan as it
is. Whoever reads the file back gets that one, as long as the items are those that it makes: a file
that was changed in QGroundControl is read by its items.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from m100link.missions.document import FORMAT, VERSION, from_json, values_of
from m100link.missions.qgroundcontrol import FILE_TYPE
from m100link.missions.waypoint import (
    AtEnd,
    GimbalPitch,
    Heading,
    PlanValues,
    StartVideo,
    Stay,
    StopVideo,
    TakePhoto,
    TurnTo,
    Waypoint,
    WaypointAction,
)

EXTRA = "m100link"
_RELATIVE, _NO_PLACE = 3, 2
_PX4, _MULTIROTOR = 12, 2


def to_text(plan: PlanValues) -> str:
    """See :meth:`m100link.WaypointPlan.to_qgroundcontrol`."""
    return json.dumps(document_of(plan), indent=4) + "\n"


def document_of(plan: PlanValues) -> dict[str, Any]:
    """The file as an object."""
    first = plan.waypoints[0]
    items = [
        item | {"doJumpId": index, "autoContinue": True, "type": "SimpleItem"}
        for index, item in enumerate(_items(plan), start=1)
    ]
    return {
        "fileType": FILE_TYPE,
        "version": 1,
        "groundStation": "m100link",
        "geoFence": {"circles": [], "polygons": [], "version": 2},
        "rallyPoints": {"points": [], "version": 2},
        "mission": {
            "version": 2,
            "firmwareType": _PX4,
            "vehicleType": _MULTIROTOR,
            "globalPlanAltitudeMode": 1,
            "cruiseSpeed": max(plan.speed, 1.0),
            "hoverSpeed": max(plan.speed, 1.0),
            "plannedHomePosition": [first.latitude_deg, first.longitude_deg, 0],
            "items": items,
        },
        EXTRA: {"format": FORMAT, "version": VERSION} | values_of(plan),
    }


def extra_of(document: dict[str, Any]) -> dict[str, Any] | None:
    """Arguments of the plan that stands beside the items; None if there is none.

    Raises ``BadPlan``: it is no plan.
    """
    extra = document.get(EXTRA)
    return from_json(extra) if isinstance(extra, dict) else None


def _item(command: int, *parameters: float | None, frame: int = _NO_PLACE) -> dict[str, Any]:
    return {
        "command": command,
        "frame": frame,
        "params": [*parameters, *[0] * (7 - len(parameters))],
    }


def _items(plan: PlanValues) -> Iterator[dict[str, Any]]:
    if plan.speed > 0:
        yield _item(178, 1, plan.speed, -1)
    for point in plan.waypoints:
        is_headed = plan.heading is Heading.BY_WAYPOINT
        yield _placed(16, point, point.heading_deg if is_headed else None, point.height)
        for action in point.actions:
            yield _action(action, point)
    if plan.at_end is AtEnd.GO_HOME:
        yield _item(20)
    elif plan.at_end is AtEnd.LAND:
        yield _placed(21, plan.waypoints[-1], None, 0)


def _placed(command: int, point: Waypoint, yaw: float | None, height: float) -> dict[str, Any]:
    place = point.latitude_deg, point.longitude_deg, height
    heights = {"AMSLAltAboveTerrain": None, "Altitude": height, "AltitudeMode": 1}
    return _item(command, 0, 0, 0, yaw, *place, frame=_RELATIVE) | heights


def _action(action: WaypointAction, point: Waypoint) -> dict[str, Any]:
    match action:
        case Stay(seconds):
            return _item(93, seconds, -1, -1, -1)
        case TakePhoto():
            return _item(2000, 0, 0, 1)
        case StartVideo():
            return _item(2500)
        case StopVideo():
            return _item(2501)
        case TurnTo(heading):
            return _item(115, heading % 360, 0, 1 if point.turn_clockwise else -1)
        case GimbalPitch(pitch):
            return _item(205, pitch, 0, 0, 0, 0, 0, 2)
    raise TypeError(f"{action!r} is not an action")
