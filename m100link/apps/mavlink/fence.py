"""The fence of a ground station: areas to stay in, and areas to stay out of.

It comes on top of the agent's envelope and never widens it. What is flown to has to lie inside; an
aircraft that is about to leave is held, and setpoints are not flown while it is outside.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from m100link.apps.mavlink.codec import Message
from m100link.apps.mavlink.numbers import Command, MissionResult
from m100link.apps.mavlink.route import Refused
from m100link.geodesy import LocalFrame

__all__ = ["Fence", "read_fence"]

_POLYGONS = {
    Command.NAV_FENCE_POLYGON_VERTEX_INCLUSION: True,
    Command.NAV_FENCE_POLYGON_VERTEX_EXCLUSION: False,
}
_CIRCLES = {
    Command.NAV_FENCE_CIRCLE_INCLUSION: True,
    Command.NAV_FENCE_CIRCLE_EXCLUSION: False,
}
_AROUND = 8


@dataclass(frozen=True, slots=True)
class _Area:
    """A polygon, or a circle.

    Attributes:
        is_inside: Whether to stay in it.
        frame: Metres from its first corner, or its centre.
        corners: North and east of that, m; empty for a circle.
        radius: m.
    """

    is_inside: bool
    frame: LocalFrame
    corners: tuple[tuple[float, float], ...] = ()
    radius: float = 0.0

    def has(self, latitude_deg: float, longitude_deg: float) -> bool:
        north, east = self.frame.to_local(latitude_deg, longitude_deg)
        if not self.corners:
            return math.hypot(north, east) <= self.radius
        is_in = False
        before_north, before_east = self.corners[-1]
        for corner_north, corner_east in self.corners:
            if (corner_east > east) != (before_east > east):
                share = (east - corner_east) / (before_east - corner_east)
                is_in ^= north < corner_north + share * (before_north - corner_north)
            before_north, before_east = corner_north, corner_east
        return is_in


@dataclass(frozen=True, slots=True)
class Fence:
    """All areas; without any it refuses nothing.

    Attributes:
        areas: To stay in, or out of.
    """

    areas: tuple[_Area, ...] = ()

    def refusal(self, latitude_deg: float, longitude_deg: float, radius: float = 0.0) -> str:
        """Why nobody may be there, empty where one may.

        Args:
            latitude_deg: WGS 84.
            longitude_deg: WGS 84.
            radius: Of a circle around the place, m.
        """
        if not self.areas:
            return ""
        places = [(latitude_deg, longitude_deg)]
        if radius:
            frame = LocalFrame(latitude_deg, longitude_deg)
            turns = (math.tau * place / _AROUND for place in range(_AROUND))
            places += [
                frame.to_geodetic(radius * math.cos(turn), radius * math.sin(turn))
                for turn in turns
            ]
        inside = [area for area in self.areas if area.is_inside]
        for place in places:
            if inside and not any(area.has(*place) for area in inside):
                return "outside of the fence"
            if any(area.has(*place) for area in self.areas if not area.is_inside):
                return "inside of an area that the fence excludes"
        return ""


def read_fence(items: Sequence[Message]) -> Fence:
    """The fence of these items.

    Raises:
        Refused: It has what is not an area: a fence that is kept in part would be believed in.
    """
    areas: list[_Area] = []
    waiting: list[tuple[float, float]] = []
    wanted, kind = 0, 0
    for number, item in enumerate(items):
        command, place = item["command"], (item["x"] / 1e7, item["y"] / 1e7)
        if command in _POLYGONS:
            if not waiting:
                wanted, kind = _corners(number, item["param1"]), command
            if command != kind or item["param1"] != wanted:
                raise Refused(MissionResult.INVALID, f"fence item {number}: another polygon begins")
            waiting.append(place)
            if len(waiting) == wanted:
                frame = _frame(number, waiting[0])
                corners = tuple(frame.to_local(*corner) for corner in waiting)
                areas.append(_Area(_POLYGONS[command], frame, corners))
                waiting = []
            continue
        if waiting or command not in _CIRCLES:
            raise Refused(MissionResult.UNSUPPORTED, f"fence item {number}: command {command}")
        radius = float(item["param1"])
        if not math.isfinite(radius) or radius < 0.0:
            raise Refused(MissionResult.INVALID, f"fence item {number}: radius {radius:g} m")
        if radius > 0.0:  # how programs write "none"
            areas.append(_Area(_CIRCLES[command], _frame(number, place), radius=radius))
    if waiting:
        raise Refused(MissionResult.INVALID, "a polygon of the fence is not whole")
    return Fence(tuple(areas))


def _corners(number: int, count: float) -> int:
    if not 3 <= count <= 1000 or count != int(count):
        raise Refused(MissionResult.INVALID, f"fence item {number}: a polygon of {count:g} corners")
    return int(count)


def _frame(number: int, place: tuple[float, float]) -> LocalFrame:
    try:
        return LocalFrame(*place)
    except ValueError:
        raise Refused(MissionResult.INVALID, f"fence item {number}: no such place") from None
