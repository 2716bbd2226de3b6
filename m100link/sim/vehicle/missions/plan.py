"""A waypoint mission as it was uploaded, and the checks that it has to pass.

What is wrong with one command alone is found at once, what is wrong with the whole when the last
point arrives (facts W2 to W6): its ack carries the code.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

from m100link.protocol.codes import MissionCode
from m100link.sim.vehicle.missions.route import Leg, Place, distance, legs_between
from m100link.sim.vehicle.missions.settings import MissionSettings
from m100link.sim.vehicle.missions.site import Site, is_on_earth

if TYPE_CHECKING:
    from m100link.protocol.commands.waypoint import WaypointMission, WaypointPoint

__all__ = [
    "STOP_S",
    "ActionKind",
    "FinishAction",
    "WaypointPlan",
    "YawMode",
    "mission_code",
    "point_code",
]

STOP_S = 4.0
"""What braking, arriving and starting again cost at each stop, for the estimate, seconds."""

_TURN_RIGHT, _TURN_LEFT = 0, 1
_PHOTO_LIMIT_S = 6.0


class ActionKind:
    """What the aircraft can be told to do at a waypoint."""

    STAY, PHOTO, START_VIDEO, STOP_VIDEO, YAW, GIMBAL_PITCH = range(6)


class FinishAction:
    """What comes after the last waypoint."""

    NONE, GO_HOME, LAND, FIRST_POINT, ENDLESS = range(5)


class YawMode:
    """Where the nose points."""

    ALONG, AS_AT_START, BY_RC, BY_POINT = range(4)


def mission_code(mission: WaypointMission) -> MissionCode:
    """What is wrong with 0x03/0x10 by itself.

    More runs than two are taken, and yaw mode 4, which DJI's ROS demonstration sends for 0; the
    focus is not looked at.
    """
    is_legal = (
        2 <= mission.count <= 99
        and 2.0 <= mission.max_speed <= 15.0
        and -mission.max_speed <= mission.idle_speed <= mission.max_speed
        and mission.finish_action <= FinishAction.ENDLESS
        and mission.repeat >= 1
        and mission.yaw_mode <= 4
        and mission.trace_mode <= 1
        and mission.rc_lost_action <= 1
        and mission.gimbal_pitch_mode <= 1
    )
    return MissionCode.SUCCESS if is_legal else MissionCode.BAD_MISSION


def point_code(point: WaypointPoint) -> MissionCode:
    """What is wrong with 0x03/0x11 by itself; the index is judged elsewhere."""
    is_legal = (
        is_on_earth(point.latitude, point.longitude)
        and -200.0 <= point.altitude <= 500.0
        and (point.damping == 0.0 or 0.2 - 1e-6 <= point.damping <= 1000.0)
        and -180 <= point.yaw <= 180
        and -90 <= point.gimbal_pitch <= 30
        and point.turn_mode <= 1
    )
    if not is_legal:
        return MissionCode.BAD_POINT
    if point.has_action > 1:
        return MissionCode.BAD_ACTION
    return MissionCode.SUCCESS if not point.has_action else _action_code(point)


def _action_code(point: WaypointPoint) -> MissionCode:
    if not (point.action_time_limit <= 999 or point.action_time_limit == 0xFFFF):
        return MissionCode.BAD_ACTION
    ranges = {
        ActionKind.STAY: (0, 32_767),
        ActionKind.YAW: (-180, 180),
        ActionKind.GIMBAL_PITCH: (-90, 30),
    }
    listed = list(zip(point.actions, point.parameters, strict=True))[: point.action_count]
    for kind, parameter in listed:
        low, high = ranges.get(kind, (-32_768, 32_767))
        if kind > ActionKind.GIMBAL_PITCH or not low <= parameter <= high:
            return MissionCode.BAD_ACTION
    return MissionCode.SUCCESS


@dataclass(frozen=True, slots=True)
class WaypointPlan:
    """A mission with all its points.

    Attributes:
        mission: As 0x03/0x10 had it.
        points: As 0x03/0x11 had them, by index.
        places: Where they are, in metres from where the aircraft was switched on.
    """

    mission: WaypointMission
    points: tuple[WaypointPoint, ...]
    places: tuple[Place, ...]

    @property
    def is_curved(self) -> bool:
        """Whether it flies coordinated turns instead of stopping at each point."""
        return self.mission.trace_mode == 1

    def legs(self) -> list[Leg]:
        """The line to fly."""
        dampings = [point.damping for point in self.points] if self.is_curved else None
        return legs_between(list(self.places), dampings)

    def check(self, settings: MissionSettings, home: Place | None, site: Site) -> MissionCode:
        """What is wrong with the whole."""
        lengths = [distance(a, b) for a, b in pairwise(self.places)]
        if min(lengths) < settings.closest_points:
            return MissionCode.POINTS_TOO_CLOSE
        if max(lengths) > settings.farthest_points:
            return MissionCode.POINTS_TOO_FAR
        if self.is_curved and not self._curves_fit(lengths):
            return MissionCode.BAD_DAMPING
        if sum(lengths) > settings.longest_route:
            return MissionCode.LEG_TOO_LONG
        ways = 0.0 if home is None else sum(distance(home, p) for p in self._ends)
        if sum(lengths) + ways > settings.longest_way:
            return MissionCode.ROUTE_TOO_LONG
        if any(site.is_forbidden(a, b) for a, b in pairwise(self.places)):
            return MissionCode.CROSSES_NO_FLY_ZONE
        return MissionCode.SUCCESS

    @property
    def _ends(self) -> tuple[Place, Place]:
        return self.places[0], self.places[-1]

    def _curves_fit(self, lengths: list[float]) -> bool:
        """Whether no two neighbouring curves together are longer than the leg between them."""
        radii = [0.0, *(point.damping for point in self.points[1:-1]), 0.0]
        pairs = zip(pairwise(radii), lengths, strict=True)
        return all(before + after <= length for (before, after), length in pairs)

    @property
    def cruise_speed(self) -> float:
        """What the aircraft flies while nobody touches the stick, or could, m/s."""
        mission = self.mission
        return mission.idle_speed if mission.idle_speed > 0.0 else mission.max_speed

    def estimate(self) -> float:
        """Seconds that one run takes, roughly; without the ways from and to home."""
        flying = sum(leg.length for leg in self.legs()) / self.cruise_speed
        stops = 2 if self.is_curved else len(self.points)
        acting = 0.0 if self.is_curved else sum(map(_acting_seconds, self.points))
        return flying + stops * STOP_S + acting


def _acting_seconds(point: WaypointPoint) -> float:
    if not point.has_action:
        return 0.0
    total = 0.0
    for kind, parameter in list(zip(point.actions, point.parameters, strict=True))[
        : point.action_count
    ]:
        total += parameter / 1000.0 if kind == ActionKind.STAY else 2.0
    return min(total * max(1, point.action_repeat), float(point.action_time_limit))
