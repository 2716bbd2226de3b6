"""A mission as the aircraft flies it by itself: a plan of waypoints, or why there is none.

What a plan of the aircraft cannot say is flown by the agent instead. Two things that MAVLink says
for a leg and the plan for the whole are made up for: the speed, which is changed on the way, and
the heading, which stays what it was where an item names none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from m100link.apps.mavlink.modes import Mode
from m100link.apps.mavlink.route import FASTEST_M_S, Leg
from m100link.errors import BadPlan
from m100link.geodesy import normalize_degrees
from m100link.missions.checks import MOST_ACTIONS
from m100link.missions.plan import AtEnd, Heading, Stay, Waypoint, WaypointPlan
from m100link.protocol.commands.waypoint import WaypointMission
from m100link.protocol.firmware import PROFILES

__all__ = ["Unfit", "flies_missions", "plan_of"]

_LONGEST_STAY = 32.767
_ENDS = {Mode.HOLD: AtEnd.HOVER, Mode.RTL: AtEnd.GO_HOME, Mode.LAND: AtEnd.LAND}


class Unfit(Exception):
    """The aircraft cannot fly this mission by itself; the text says why."""


def flies_missions(firmware: str) -> bool:
    """Whether an aircraft of that firmware knows waypoint missions."""
    profile = PROFILES.get(firmware)
    return profile is not None and WaypointMission.is_known_to(profile)


def plan_of(legs: Sequence[Leg], then: Mode, *, yaw_deg: float | None) -> WaypointPlan:
    """The plan that flies these legs.

    Args:
        legs: Places, in order.
        then: How the mission ends: RTL, LAND, or hovering.
        yaw_deg: Heading at its start; None while nobody knows.

    Raises:
        Unfit: There is none.
    """
    if not legs:
        raise Unfit("no place is left to fly to")
    headings = _headings(legs, yaw_deg)
    points = []
    before = headings[0]
    for leg, heading in zip(legs, headings, strict=True):
        order = leg.order
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
    is_named = any(leg.order.yaw_deg is not None for leg in legs)
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


def _headings(legs: Sequence[Leg], yaw_deg: float | None) -> list[float]:
    """Of each leg: what its item names, or what it was before."""
    named = [leg.order.yaw_deg for leg in legs]
    if all(one is None for one in named):
        return [0.0] * len(legs)  # the plan says that the heading stays
    if named[0] is None and yaw_deg is None:
        raise Unfit("nobody knows the heading that it begins with")
    heading, found = yaw_deg or 0.0, []
    for one in named:
        heading = heading if one is None else one
        found.append(heading)
    return found


def _stays(leg: Leg) -> list[Stay]:
    parts = math.ceil(leg.wait / _LONGEST_STAY)
    if parts > MOST_ACTIONS:
        raise Unfit(f"item {leg.item}: it hovers for {leg.wait:g} s")
    return [Stay(leg.wait / max(1, parts))] * parts


def _seen(problem: BadPlan, legs: Sequence[Leg]) -> str:
    """What is wrong, by the number of the item."""
    if problem.point is None:
        return problem.seen
    return problem.seen.replace(f"waypoint {problem.point}", f"item {legs[problem.point].item}", 1)
