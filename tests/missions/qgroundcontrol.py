"""Files of QGroundControl, as it writes them."""

from __future__ import annotations

import json
from typing import Any

from m100link import WaypointPlan

__all__ = ["HOME", "file", "item", "read", "survey", "waypoint"]

HOME = [47.3977, 8.5456, 488.1]


def item(command: int, *parameters: float | None, frame: int = 2, **others: Any) -> dict[str, Any]:
    """A simple item; missing parameters are 0."""
    return {
        "autoContinue": True,
        "command": command,
        "doJumpId": 1,
        "frame": frame,
        "params": [*parameters, *[0] * (7 - len(parameters))],
        "type": "SimpleItem",
    } | others


def waypoint(
    north: float, height: float = 30.0, *, yaw: float | None = None, hold: float = 0, frame: int = 3
) -> dict[str, Any]:
    """So many metres north of home."""
    place = HOME[0] + north / 111_180, HOME[1]
    return item(16, hold, 0, 0, yaw, *place, height, frame=frame)


def survey(*items: dict[str, Any], kind: str = "survey") -> dict[str, Any]:
    """A complex item that has been laid out."""
    return {
        "type": "ComplexItem",
        "complexItemType": kind,
        "version": 5,
        "polygon": [],
        "TransectStyleComplexItem": {"version": 2, "CameraShots": 6, "Items": list(items)},
    }


def file(*items: object, **others: Any) -> dict[str, Any]:
    """A whole file."""
    mission = {
        "cruiseSpeed": 15,
        "firmwareType": 12,
        "globalPlanAltitudeMode": 1,
        "hoverSpeed": 5,
        "items": list(items),
        "plannedHomePosition": HOME,
        "vehicleType": 2,
        "version": 2,
    }
    return {
        "fileType": "Plan",
        "geoFence": {"circles": [], "polygons": [], "version": 2},
        "groundStation": "QGroundControl",
        "mission": mission,
        "rallyPoints": {"points": [], "version": 2},
        "version": 1,
    } | others


def read(*items: object, **options: Any) -> WaypointPlan:
    """The plan that these items are."""
    return WaypointPlan.from_qgroundcontrol(json.dumps(file(*items)), **options)
