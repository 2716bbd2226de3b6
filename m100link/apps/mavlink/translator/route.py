"""The meaning of a mission: its items as flights of the agent, and those not flown.

An item of a payload that no mission moves is left out, and named. Any other item that the M100
cannot fly refuses the mission. Both lists are here, and the manual is made from them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from m100link.apps.agent.orders import FlyAround, FlyTo
from m100link.apps.mavlink.translator.codec import MavlinkMessage
from m100link.apps.mavlink.translator.numbers import RELATIVE, SEA_LEVEL, MavCommand, MissionResult
from m100link.apps.mavlink.translator.vehicle_state import Mode
from m100link.errors import BadPlan
from m100link.geodesy import normalize_degrees
from m100link.missions.checks import MOST_ACTIONS
from m100link.missions.plan import AtEnd, Heading, Stay, Waypoint, WaypointPlan
from m100link.missions.qgroundcontrol import command_name
from m100link.protocol.commands.waypoint import WaypointMission
from m100link.protocol.firmware import PROFILES

_LONGEST_WAIT, _MOST_TURNS = 600.0, 100.0
_SLOWEST_M_S, FASTEST_M_S = 0.1, 10.0
"""Of a leg, and what the pilot's stick adds to a mission that the aircraft flies included."""

_LOWEST_M = 1.0  # of a first place that is flown to, above the ground
WITHOUT_EFFECT = frozenset(
    {*range(181, 185), 187, 189, 195, 196, 197, *range(200, 208), 211, 214, 530, 531, 532}
    | {1000, 1001, 2000, 2001, 2003, 2500, 2501}
)
"""Items of a payload, and marks: without them a mission has the same way."""

_REMEDIES = {
    82: "use NAV_WAYPOINT: the M100 flies straight lines",
    84: "use NAV_TAKEOFF",
    85: "use NAV_LAND",
    177: "no loop is, write its items out",
    179: "take it out: home is where the aircraft took off",
    192: "use NAV_WAYPOINT",
}


class Refused(Exception):
    def __init__(self, why: str, result: MissionResult = MissionResult.INVALID) -> None:
        super().__init__(why)
        self.result = result  # for the ground station
        self.why = why


@dataclass(frozen=True, slots=True)
class RoutePoint:
    item: int  # number of the item
    order: FlyTo | FlyAround
    wait: float = 0.0  # seconds to hover there


class Route:
    """A mission that can be flown, as far as it was read.

    ``ground``: altitude of the take-off point above sea level, m; None while nobody knows.
    """

    def __init__(self, ground: float | None, speed: float) -> None:
        self._ground = ground
        self._is_over = False
        self.legs: list[RoutePoint] = []
        # To climb to after a take-off, m above the ground; None without such an item.
        self.height: float | None = None
        self.then = Mode.HOLD  # how it ends: RTL, LAND, or hovering
        self.left_out: list[int] = []  # commands of items that are not carried out
        self.labels: dict[int, str] = {}  # of the items, for people
        self._speed = speed  # of the legs that follow, m/s

    def read(self, number: int, item: MavlinkMessage) -> None:
        command = item["command"]
        row = ITEMS.get(command)
        self.labels[number] = f"item {number}, {command_name(command)}"
        if row is None and command in WITHOUT_EFFECT:
            self.left_out.append(command)
            return
        try:
            if row is None:
                remedy = _REMEDIES.get(command, "take it out")
                raise Refused(f"it cannot be flown: {remedy}", MissionResult.UNSUPPORTED)
            if self._is_over:
                raise Refused("it comes after the item that ends the way")
            if any(math.isinf(item[name]) for name in ("param1", "param2", "param3", "param4")):
                raise Refused("a parameter is infinite")
            row.reader(self, number, item)
        except Refused as refused:
            raise Refused(f"{self.labels[number]}: {refused.why}", refused.result) from None

    def _height(self, item: MavlinkMessage) -> float:
        frame, height = item["frame"], float(item["z"])
        if frame in SEA_LEVEL:
            if self._ground is None:
                raise Refused("the altitude of the ground is unknown", MissionResult.ERROR)
            height -= self._ground
        elif frame not in RELATIVE:
            why = f"frame {frame}: give the altitude above home"
            raise Refused(why, MissionResult.UNSUPPORTED_FRAME)
        if not 0.0 <= height < 1000.0:
            raise Refused(f"{height:.1f} m above the ground: 0 to 1000 m")
        return height

    def take_off(self, number: int, item: MavlinkMessage) -> None:
        if self.legs:
            raise Refused("a take-off in the air: use NAV_WAYPOINT")
        self.height = self._height(item)

    def waypoint(self, number: int, item: MavlinkMessage) -> None:
        self._fly(number, item, _seconds(item["param1"]))

    def loiter(self, number: int, item: MavlinkMessage) -> None:
        """NAV_LOITER_UNLIM: the end."""
        self._fly(number, item, 0.0)
        self._is_over = True

    def circle(self, number: int, item: MavlinkMessage) -> None:
        turns, radius = float(item["param1"]), float(item["param3"])
        if not (0.0 < turns <= _MOST_TURNS and 1.0 <= abs(radius) < math.inf):
            raise Refused(f"{turns:g} turns of {abs(radius):g} m: up to {_MOST_TURNS:g}, from 1 m")
        speed = min(self._speed, math.sqrt(abs(radius)), abs(radius) / 2.0)
        where = self._where(item)
        order = FlyAround(*where, abs(radius), speed, turns, clockwise=radius > 0.0)
        self.legs.append(RoutePoint(number, order))

    def _where(self, item: MavlinkMessage) -> tuple[float, float, float]:
        """Latitude, longitude, height; a loiter without a place stays where the leg before ends."""
        before = self.legs[-1].order if self.legs else None
        is_here = not (item["x"] or item["y"] or item["command"] == MavCommand.NAV_WAYPOINT)
        if not (is_here and isinstance(before, FlyTo)):
            return (*_place(item), self._height(item))
        height = self._height(item) if item["z"] else before.height
        return before.latitude_deg, before.longitude_deg, height

    def _fly(self, number: int, item: MavlinkMessage, wait: float) -> None:
        yaw = item["param4"]
        heading = math.remainder(yaw, 360.0) if math.isfinite(yaw) else None
        order = FlyTo(*self._where(item), self._speed, heading)
        self.legs.append(RoutePoint(number, order, wait))

    def turn(self, number: int, item: MavlinkMessage) -> None:
        """CONDITION_YAW to a heading, at the place before."""
        before = self.legs[-1].order if self.legs else None
        yaw, is_relative = item["param1"], item["param4"]
        if not isinstance(before, FlyTo) or is_relative or not math.isfinite(yaw):
            raise Refused("only an absolute heading, behind a waypoint: name it in the waypoint")
        order = replace(before, yaw_deg=math.remainder(yaw, 360.0))
        self.legs.append(RoutePoint(number, order))

    def delay(self, number: int, item: MavlinkMessage) -> None:
        """NAV_DELAY by seconds."""
        wait = _seconds(item["param1"])
        if not wait or not self.legs:
            raise Refused("only seconds, behind a waypoint")
        last = self.legs[-1]
        self.legs[-1] = replace(last, wait=min(_LONGEST_WAIT, last.wait + wait))

    def change_speed(self, number: int, item: MavlinkMessage) -> None:
        """DO_CHANGE_SPEED of the legs that follow; not of climb and descent, as the loops have."""
        speed = item["param2"]
        if item["param1"] not in (0.0, 1.0):
            self.left_out.append(item["command"])
        elif math.isfinite(speed) and speed > 0.0:
            if not _SLOWEST_M_S <= speed <= FASTEST_M_S:
                raise Refused(f"{speed:g} m/s is not {_SLOWEST_M_S:g} to {FASTEST_M_S:g}")
            self._speed = speed

    def go_home(self, number: int, item: MavlinkMessage) -> None:
        """NAV_RETURN_TO_LAUNCH: the end."""
        self.then, self._is_over = Mode.RTL, True

    def land(self, number: int, item: MavlinkMessage) -> None:
        """NAV_LAND: the end, at a place if one is named."""
        if (item["x"] or item["y"]) and self.legs:
            height = self.legs[-1].order.height
            self.legs.append(RoutePoint(number, FlyTo(*_place(item), height, self._speed)))
        self.then, self._is_over = Mode.LAND, True


def _is_home(items: Sequence[MavlinkMessage], ground: float) -> bool:
    """Whether the first item is home, as in files and uploads of MAVProxy and Mission Planner.

    It is a waypoint with two of three signs: frame of the sea, on the ground, then a take-off.
    """
    first = items[0]
    is_at_sea = first["frame"] in SEA_LEVEL
    is_low = first["z"] - (ground if is_at_sea else 0.0) < _LOWEST_M
    is_before = [item["command"] for item in items[1:2]] == [MavCommand.NAV_TAKEOFF]
    signs = (is_at_sea, is_low, is_before)
    return sum(signs) > 1 and bool(first["command"] == MavCommand.NAV_WAYPOINT)


def _place(item: MavlinkMessage) -> tuple[float, float]:
    latitude, longitude = item["x"] / 1e7, item["y"] / 1e7
    if not (abs(latitude) <= 89.0 and abs(longitude) <= 180.0) or not (latitude or longitude):
        raise Refused(f"there is no place {latitude:g}, {longitude:g} to fly to")
    return latitude, longitude


def _seconds(value: float) -> float:
    if not math.isfinite(value):
        return 0.0
    if not 0.0 <= value <= _LONGEST_WAIT:
        raise Refused(f"{value:g} s of hovering: 0 to {_LONGEST_WAIT:g}")
    return float(value)


@dataclass(frozen=True, slots=True)
class ItemRow:
    reader: Callable[[Route, int, MavlinkMessage], None]  # what reads it
    meaning: str  # for the manual


ITEMS: Mapping[int, ItemRow] = {
    MavCommand.NAV_TAKEOFF: ItemRow(
        Route.take_off, "height of the climb after the take-off, in place: its place has no meaning"
    ),
    MavCommand.NAV_WAYPOINT: ItemRow(Route.waypoint, "straight there; hold time, heading if named"),
    MavCommand.NAV_LOITER_TIME: ItemRow(Route.waypoint, "the same, with its time"),
    MavCommand.NAV_LOITER_UNLIM: ItemRow(Route.loiter, "straight there, and the end"),
    MavCommand.NAV_LOITER_TURNS: ItemRow(
        Route.circle,
        "up to 100 turns around the place, from 1 m of radius, looking at it, at most at "
        "√(radius in m) m/s",
    ),
    MavCommand.NAV_DELAY: ItemRow(Route.delay, "seconds, at the waypoint before"),
    MavCommand.CONDITION_YAW: ItemRow(Route.turn, "absolute: turns there, at the waypoint before"),
    MavCommand.DO_CHANGE_SPEED: ItemRow(
        Route.change_speed, "of the following items, up to 10 m/s; not of climb and descent"
    ),
    MavCommand.NAV_RETURN_TO_LAUNCH: ItemRow(
        Route.go_home, "the autopilot's return home at the end"
    ),
    MavCommand.NAV_LAND: ItemRow(Route.land, "the autopilot's landing at the end"),
}
"""By number. Any other item refuses the mission, but for those of ``WITHOUT_EFFECT``."""


def read_route(items: Sequence[MavlinkMessage], *, ground: float | None, speed: float) -> Route:
    """The mission as it is flown.

    ``ground``: altitude of the take-off point above sea level, m; None while nobody knows.
    ``speed``: until an item says another one, m/s. Raises Refused: it cannot be flown; with the
    item and the reason.
    """
    route = Route(ground, speed)
    for number, item in enumerate(items):
        if number or not _is_home(items, ground or 0.0):
            route.read(number, item)
    if items and not route.legs:
        raise Refused("the mission has no place to fly to: add a waypoint")
    return route


# -- A mission as the aircraft flies it by itself: a plan of waypoints, or why there is none -------
# The agent flies where no plan of the aircraft can express a mission. Two things that MAVLink says
# for a leg and the plan for the whole are made up for: the speed, which is changed on the way, and
# the heading, which stays what it was where an item names none.


_LONGEST_STAY = 32.767
_ENDS = {Mode.HOLD: AtEnd.HOVER, Mode.RTL: AtEnd.GO_HOME, Mode.LAND: AtEnd.LAND}


class Unfit(Exception):
    """The aircraft cannot fly this mission by itself; the text says why."""


def flies_missions(firmware: str) -> bool:
    profile = PROFILES.get(firmware)
    return profile is not None and WaypointMission.is_known_to(profile)


def plan_of(legs: Sequence[RoutePoint], then: Mode, *, yaw_deg: float | None) -> WaypointPlan:
    """The plan that flies these legs.

    ``yaw_deg``: heading at its start; None while nobody knows. Raises Unfit: there is none.
    """
    if not legs:
        raise Unfit("no place is left to fly to")
    headings = _headings(legs, yaw_deg)
    points = []
    before = headings[0]
    for leg, heading in zip(legs, headings, strict=True):
        order = leg.order
        if isinstance(order, FlyAround):
            raise Unfit(f"item {leg.item}: it is a circle")
        points.append(
            Waypoint(
                order.latitude_deg,
                order.longitude_deg,
                order.height,
                heading_deg=heading,
                turn_clockwise=normalize_degrees(heading - before) >= 0.0,
                actions=_stays(leg),
            )
        )
        before = heading
    is_named = any(_yaw(leg) is not None for leg in legs)
    try:
        return WaypointPlan(
            points,
            speed=legs[0].order.speed,
            max_speed=FASTEST_M_S,
            heading=Heading.BY_WAYPOINT if is_named else Heading.AS_AT_START,
            at_end=_ENDS[then],
        )
    except BadPlan as problem:
        raise Unfit(_seen(problem, legs)) from None


def _yaw(leg: RoutePoint) -> float | None:
    return leg.order.yaw_deg if isinstance(leg.order, FlyTo) else None


def _headings(legs: Sequence[RoutePoint], yaw_deg: float | None) -> list[float]:
    """Of each leg: what its item names, or what it was before."""
    named = [_yaw(leg) for leg in legs]
    if all(one is None for one in named):
        return [0.0] * len(legs)  # the plan says that the heading stays
    if named[0] is None and yaw_deg is None:
        raise Unfit("the initial heading is unknown")
    heading, found = yaw_deg or 0.0, []
    for one in named:
        heading = heading if one is None else one
        found.append(heading)
    return found


def _stays(leg: RoutePoint) -> list[Stay]:
    parts = math.ceil(leg.wait / _LONGEST_STAY)
    if parts > MOST_ACTIONS:
        raise Unfit(f"item {leg.item}: it hovers for {leg.wait:g} s")
    return [Stay(leg.wait / max(1, parts))] * parts


def _seen(problem: BadPlan, legs: Sequence[RoutePoint]) -> str:
    if problem.point is None:
        return problem.seen
    return problem.seen.replace(f"waypoint {problem.point}", f"item {legs[problem.point].item}", 1)
