"""A waypoint mission as it was uploaded, and the checks that it has to pass.

The aircraft finds a fault of one command at once, and a fault of the whole plan when the last
point arrives (DJI's test of the hardware): its ack carries the code.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum, auto
from itertools import pairwise

from m100link.protocol.codes import MissionCode
from m100link.protocol.commands.missions import Uploaded
from m100link.protocol.commands.waypoint import WaypointMission, WaypointPoint
from m100link.sim.vehicle.missions.route import (
    LocalPlace,
    MissionSettings,
    RouteLeg,
    Site,
    distance,
    is_on_earth,
    legs_between,
)

STOP_S = 4.0
"""The time that braking, arriving and starting again cost at each stop, estimated, seconds."""


class ActionKind:
    STAY, PHOTO, START_VIDEO, STOP_VIDEO, YAW, GIMBAL_PITCH = range(6)


class FinishAction:
    NONE, GO_HOME, LAND, FIRST_POINT, ENDLESS = range(5)


class YawMode:
    ALONG, AS_AT_START, BY_RC, BY_POINT = range(4)


def mission_code(mission: WaypointMission) -> MissionCode:
    """The code for 0x03/0x10, judged by its values alone.

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
    """The code for 0x03/0x11, judged by its values alone; the index is judged elsewhere."""
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
class StoredPlan:
    mission: WaypointMission  # as 0x03/0x10 had it
    points: tuple[WaypointPoint, ...]  # as 0x03/0x11 had them, by index
    places: tuple[
        LocalPlace, ...
    ]  # where they are, in metres from where the aircraft was switched on

    @property
    def is_curved(self) -> bool:
        """Whether it flies coordinated turns instead of stopping at each point."""
        return self.mission.trace_mode == 1

    def legs(self) -> list[RouteLeg]:
        dampings = [point.damping for point in self.points] if self.is_curved else None
        return legs_between(list(self.places), dampings)

    def check(self, settings: MissionSettings, home: LocalPlace | None, site: Site) -> MissionCode:
        """The code for the whole plan."""
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
    def _ends(self) -> tuple[LocalPlace, LocalPlace]:
        return self.places[0], self.places[-1]

    def _curves_fit(self, lengths: list[float]) -> bool:
        """Whether no two neighbouring curves together are longer than the leg between them."""
        radii = [0.0, *(point.damping for point in self.points[1:-1]), 0.0]
        pairs = zip(pairwise(radii), lengths, strict=True)
        return all(before + after <= length for (before, after), length in pairs)

    @property
    def cruise_speed(self) -> float:
        """The speed that the aircraft flies, or could, while nobody touches the stick, m/s."""
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


# -- what was uploaded of a waypoint mission, and its checks as they are due -----------------------


class WaypointUpload:
    """The memory for one waypoint mission.

    ``mission``: as 0x03/0x10 had it, with the idle speed that was set since; None without one.
    ``points``: waypoints, by index. ``plan``: all of it, once the check of the whole has passed.
    """

    def __init__(self, settings: MissionSettings, site: Site) -> None:
        self._settings = settings
        self._site = site  # where they may go
        self.forget()

    def forget(self) -> None:
        self.mission: WaypointMission | None = None
        self.points: dict[int, WaypointPoint] = {}
        self.plan: StoredPlan | None = None

    def begin(self, mission: WaypointMission) -> MissionCode:
        """Take a mission; a former one is gone, whether this one is legal or not."""
        self.forget()
        code = mission_code(mission)
        if not code:
            self.mission = mission
        return code

    def add(
        self, point: WaypointPoint, home: LocalPlace | None
    ) -> tuple[MissionCode, Uploaded | None]:
        """Take a point; with the last one that was missing, the whole is judged and reported."""
        if self.mission is None:
            return MissionCode.NO_MISSION, None
        if point.index >= self.mission.count:
            return MissionCode.INDEX_TOO_LARGE, None
        code = point_code(point)
        if code:
            return code, None
        self.points[point.index] = point
        if len(self.points) < self.mission.count:
            return code, None
        points = tuple(self.points[index] for index in range(self.mission.count))
        places = tuple(self._site.place(p.latitude, p.longitude, p.altitude) for p in points)
        plan = StoredPlan(self.mission, points, places)
        code = plan.check(self._settings, home, self._site)
        if code:
            self.points.clear()  # all of them have to come again
            self.plan = None
            return code, Uploaded(valid=0)
        self.plan = plan
        return code, Uploaded(valid=1, estimated_time=min(0xFFFF, round(plan.estimate())))

    def set_idle_speed(self, speed: float) -> MissionCode:
        """Change the speed without the stick."""
        mission = self.mission
        if mission is None:
            return MissionCode.NO_MISSION
        if not -mission.max_speed <= speed <= mission.max_speed:
            return MissionCode.BAD_SPEED
        self.mission = replace(mission, idle_speed=speed)
        if self.plan is not None:
            self.plan = replace(self.plan, mission=self.mission)
        return MissionCode.SUCCESS


# -- how far missions are, and which orders each stage refuses: two tables -------------------------
# An order that no table refuses is taken, or judged by its contents and the state of the aircraft.


class MissionPhase(Enum):
    """How far a mission of one kind is. Hotpoint and follow know EMPTY, FLYING and PAUSED."""

    EMPTY = auto()
    """Nothing was uploaded, or it has ended."""
    PLANNED = auto()  # the mission is there, points are missing
    READY = auto()
    """All points are there and fit together."""
    FLYING = auto()
    PAUSED = auto()
    OTHER = auto()  # a mission of another kind runs


class MissionOrder(Enum):
    UPLOAD = auto()
    ADD = auto()
    START = auto()
    STOP = auto()
    PAUSE = auto()
    RESUME = auto()
    DOWNLOAD = auto()
    DOWNLOAD_POINT = auto()
    SPEED = auto()


_GROUNDED = (MissionPhase.EMPTY, MissionPhase.PLANNED, MissionPhase.READY)
_UNDER_WAY = (MissionPhase.FLYING, MissionPhase.PAUSED)

WAYPOINT_REFUSALS: dict[tuple[MissionOrder, MissionPhase], MissionCode] = {
    **{(MissionOrder.UPLOAD, stage): MissionCode.RUNNING for stage in _UNDER_WAY},
    **{(MissionOrder.ADD, stage): MissionCode.RUNNING for stage in _UNDER_WAY},
    (MissionOrder.ADD, MissionPhase.EMPTY): MissionCode.NO_MISSION,
    (MissionOrder.START, MissionPhase.EMPTY): MissionCode.NO_POINTS,
    (MissionOrder.START, MissionPhase.PLANNED): MissionCode.NO_POINTS,
    **{(MissionOrder.START, stage): MissionCode.ALREADY_SO for stage in _UNDER_WAY},
    **{(MissionOrder.STOP, stage): MissionCode.NOT_STARTED for stage in _GROUNDED},
    **{(MissionOrder.PAUSE, stage): MissionCode.NOT_STARTED for stage in _GROUNDED},
    **{(MissionOrder.RESUME, stage): MissionCode.NOT_STARTED for stage in _GROUNDED},
    (MissionOrder.PAUSE, MissionPhase.PAUSED): MissionCode.ALREADY_SO,
    (MissionOrder.RESUME, MissionPhase.FLYING): MissionCode.ALREADY_SO,
    (MissionOrder.DOWNLOAD, MissionPhase.EMPTY): MissionCode.NO_MISSION,
    (MissionOrder.DOWNLOAD_POINT, MissionPhase.EMPTY): MissionCode.NO_POINTS,
    (MissionOrder.SPEED, MissionPhase.EMPTY): MissionCode.NO_MISSION,
}
"""Waypoints: the codes are DJI's; most that none of its tests shows are our reading."""

_IDLE = (MissionPhase.EMPTY, MissionPhase.OTHER)

CIRCLE_REFUSALS: dict[tuple[MissionOrder, MissionPhase], MissionCode] = {
    **{(MissionOrder.START, stage): MissionCode.RUNNING for stage in _UNDER_WAY},
    (MissionOrder.START, MissionPhase.OTHER): MissionCode.OTHER_RUNNING,
    **{(MissionOrder.STOP, stage): MissionCode.NOT_RUNNING for stage in _IDLE},
    **{(MissionOrder.PAUSE, stage): MissionCode.NOT_RUNNING for stage in _IDLE},
    **{(MissionOrder.RESUME, stage): MissionCode.NOT_RUNNING for stage in _IDLE},
    **{(MissionOrder.DOWNLOAD, stage): MissionCode.NOT_RUNNING for stage in _IDLE},
    (MissionOrder.PAUSE, MissionPhase.PAUSED): MissionCode.ALREADY_PAUSED,
    (MissionOrder.RESUME, MissionPhase.FLYING): MissionCode.NOT_PAUSED,
}
"""Hotpoint and, with the same codes, follow (DJI's list of codes; errata 59)."""
