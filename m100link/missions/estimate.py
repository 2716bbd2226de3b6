"""How long a plan takes, and how much of the battery: an estimate, and what it reckons with.

Nothing of it is measured on an aircraft. Along the way it flies at the plan's speed, more slowly
where it climbs or descends faster than :data:`CLIMB_M_S`. A stop costs :data:`STOP_S` to settle and
:data:`STOP_S_PER_M_S` for braking and speeding up again; turns on the spot take their angle at
:data:`TURN_DEG_S`, and so does the gimbal; an action of the camera takes :data:`CAMERA_S`. The
virtual aircraft's flights take as long within 15 %. The battery lasts as long as DJI says that a
Matrice 100 hovers with it: flying forwards takes about as much.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from m100link.errors import UsageError
from m100link.geodesy import bearing_deg, distance_m, normalize_degrees
from m100link.missions.checks import leg_lengths
from m100link.missions.waypoint import (
    AtEnd,
    GimbalPitch,
    Heading,
    PlanValues,
    Stay,
    Trace,
    TurnTo,
    Waypoint,
)

__all__ = ["HOVER_MINUTES", "PlanEstimate", "estimate", "seconds_of_actions"]

HOVER_MINUTES = 17.0
"""DJI's figure for a TB47D and 500 g of payload; 22 without any, 13 with 1 kg. A TB48D: 20, 28, 16.
A camera, a computer and their supply are about 500 g."""
STOP_S, STOP_S_PER_M_S = 2.0, 0.3
CLIMB_M_S = 3.0
LANDING_M_S = 1.5
HOMEWARD_M_S = 8.0
TURN_DEG_S = 45.0
CAMERA_S = 1.5
"""A photograph, and the beginning and end of a video."""


@dataclass(frozen=True, slots=True)
class PlanEstimate:
    """What a plan takes, roughly.

    Attributes:
        length_m: Metres flown: each run, and the ways before and behind that are known.
        duration_s: Seconds; infinite for a plan that only the pilot's stick moves.
        battery_percent: Of a full battery, more than 100 if one is not enough; infinite likewise.
        hover_minutes: How long a full one was taken to last.
    """

    length_m: float
    duration_s: float
    battery_percent: float
    hover_minutes: float

    def __str__(self) -> str:
        if math.isinf(self.duration_s):
            return f"{self.length_m:.0f} m, as fast as the pilot's stick"
        minutes, seconds = divmod(round(self.duration_s), 60)
        time = f"{minutes}:{seconds:02d} min" if minutes else f"{seconds} s"
        return (
            f"{self.length_m:.0f} m in {time}, {self.battery_percent:.0f} % "
            f"of a battery that hovers for {self.hover_minutes:g} min"
        )


def estimate(
    plan: PlanValues,
    *,
    home: tuple[float, float] | None = None,
    hover_minutes: float = HOVER_MINUTES,
) -> PlanEstimate:
    """See :meth:`m100link.WaypointPlan.estimate`.

    Raises:
        UsageError: The battery lasts no time.
    """
    if not 0.0 < hover_minutes < math.inf:
        raise UsageError(
            f"a battery that hovers for {hover_minutes:g} min", remedy="more than 0 minutes"
        )
    length, seconds = _run(plan)
    length, seconds = length * plan.repeat, seconds * plan.repeat
    for way, duration in (_back_to_first(plan, plan.repeat - 1), _around(plan, home)):
        length += way
        seconds += duration
    share = 100.0 * seconds / (60.0 * hover_minutes)
    return PlanEstimate(length, seconds, share, hover_minutes)


def _run(plan: PlanValues) -> tuple[float, float]:
    """Metres and seconds from the first waypoint to the last, with what is done there."""
    points = plan.waypoints
    lengths = leg_lengths(points)
    seconds = sum(
        _seconds(length, there.height - here.height, plan.speed)
        for (here, there), length in zip(pairwise(points), lengths, strict=True)
    )
    if plan.trace is Trace.COORDINATED_TURNS:
        return sum(lengths), seconds + _stop(plan)
    headings = _headings(plan)
    seconds += _stop(plan) * len(lengths)
    seconds += sum(
        min(acting, _limit(point))
        for point, acting in zip(points, seconds_of_actions(plan), strict=True)
    )
    return sum(lengths), seconds + _turns(plan, headings)


def _seconds(length: float, climb: float, speed: float) -> float:
    """Of a leg; for ever if nothing but the stick moves the aircraft."""
    if speed <= 0.0:
        return math.inf
    return max(length / speed, abs(climb) / CLIMB_M_S)


def _headings(plan: PlanValues) -> list[float]:
    """Where the nose points when it arrives at each waypoint, °."""
    if plan.heading is Heading.BY_WAYPOINT:
        return [float(point.heading_deg) for point in plan.waypoints]
    if plan.heading is not Heading.ALONG_PATH:
        return [0.0] * len(plan.waypoints)
    courses = _courses(plan.waypoints)
    return [courses[0], *courses]


def _courses(points: Sequence[Waypoint]) -> list[float]:
    return [
        bearing_deg(here.latitude_deg, here.longitude_deg, there.latitude_deg, there.longitude_deg)
        for here, there in pairwise(points)
    ]


def _turns(plan: PlanValues, headings: Sequence[float]) -> float:
    """Seconds of turning to the next leg; between headings of waypoints it turns as it flies."""
    if plan.heading is not Heading.ALONG_PATH:
        return 0.0
    return sum(_turn(here, there) for here, there in pairwise(headings))


def _turn(here: float, there: float) -> float:
    return abs(normalize_degrees(there - here)) / TURN_DEG_S


def _stop(plan: PlanValues) -> float:
    """What stopping, and flying on, costs."""
    return STOP_S + STOP_S_PER_M_S * max(0.0, plan.speed)


def seconds_of_actions(plan: PlanValues) -> list[float]:
    """How long the actions of each waypoint take if nothing cuts them off, s.

    The gimbal looks ahead at first.
    """
    pitch, found = 0.0, []
    for point, heading in zip(plan.waypoints, _headings(plan), strict=True):
        if plan.gimbal_by_waypoint:
            pitch = point.gimbal_pitch_deg
        seconds = 0.0
        for action in [*point.actions] * max(1, point.action_repeat):
            match action:
                case Stay(stay):
                    seconds += stay
                case TurnTo(wanted):
                    angle = wanted - heading if point.turn_clockwise else heading - wanted
                    seconds += angle % 360.0 / TURN_DEG_S
                    heading = wanted
                case GimbalPitch(wanted):
                    seconds += abs(wanted - pitch) / TURN_DEG_S
                    pitch = wanted
                case _:
                    seconds += CAMERA_S
        found.append(seconds)
    return found


def _limit(point: Waypoint) -> float:
    return math.inf if point.action_time_limit is None else point.action_time_limit


def _place(point: Waypoint) -> tuple[float, float]:
    return point.latitude_deg, point.longitude_deg


def _back_to_first(plan: PlanValues, times: int) -> tuple[float, float]:
    """The way to where a run begins again, and that at the end of the mission."""
    times += plan.at_end is AtEnd.FIRST_POINT
    if not times:
        return 0.0, 0.0
    first, last = plan.waypoints[0], plan.waypoints[-1]
    climb = last.height - first.height
    length = math.hypot(distance_m(*_place(last), *_place(first)), climb)
    return times * length, times * (_seconds(length, climb, plan.speed) + _stop(plan))


def _around(plan: PlanValues, home: tuple[float, float] | None) -> tuple[float, float]:
    """From the take-off point to the first waypoint, and what ends on the ground."""
    first, last = plan.waypoints[0], plan.waypoints[-1]
    length = seconds = 0.0
    if home is not None:
        length = distance_m(*home, *_place(first))
        seconds = _seconds(length, 0.0, plan.speed) + _stop(plan)
        length += abs(first.height)
        seconds += abs(first.height) / CLIMB_M_S
    if plan.at_end is AtEnd.GO_HOME and home is not None:
        way = distance_m(*_place(last), *home)
        length += way
        seconds += way / HOMEWARD_M_S + STOP_S
    if plan.at_end in (AtEnd.LAND, AtEnd.GO_HOME):
        length += abs(last.height)
        seconds += abs(last.height) / LANDING_M_S
    return length, seconds
