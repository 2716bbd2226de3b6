"""Whether the aircraft would take a plan: every rule of a waypoint mission, before a byte is sent.

The autopilot answers a bad point with a code alone, and a bad whole only when its last point has
arrived. Here each problem is a :class:`~m100link.errors.BadPlan` that names point, field, value and
limit. The limits are those of DJI's documents, programs and tests of firmware 3.1: E0, E1 and E8 of
the ack codes are the fields, E2 to E7 the whole.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

from m100link.errors import BadPlan, UsageError
from m100link.errors.texts import shortened
from m100link.geodesy import bearing_deg, distance_m, normalize_degrees
from m100link.missions.waypoint import (
    ACTIONS,
    CHOICES,
    AtEnd,
    GimbalPitch,
    Heading,
    OnRCLoss,
    PlanValues,
    Stay,
    Trace,
    TurnTo,
    Waypoint,
    number,
)

FEWEST_POINTS, MOST_POINTS = 2, 99
MOST_ACTIONS = 15
NEAREST_M, FARTHEST_M = 2.0, 2000.0
"""Between neighbours, in three dimensions. Documents since 2017 allow 0.5 m, the M100's say 2."""
LONGEST_M = 30_000.0  # from the first point to the last; twice that with the ways of home and back
SMALLEST_DAMPING_M, LARGEST_DAMPING_M = 0.2, 1000.0
FASTEST_M_S = 15.0
MOST_REPEATS = 15


class _Range(NamedTuple):
    low: float
    high: float
    unit: str
    note: str = ""

    def __str__(self) -> str:
        return f"{self.low:g} to {self.high:g} {self.unit}".replace(" °", "°").rstrip() + self.note


_HEADING = _Range(-180, 180, "°")
_PITCH = _Range(-90, 0, "°")
_POINT = {
    "latitude_deg": _Range(-89, 89, "°"),
    "longitude_deg": _Range(-180, 180, "°"),
    "height": _Range(-200, 500, "m", " above the take-off point"),
    "heading_deg": _HEADING,
    "gimbal_pitch_deg": _PITCH,
}
_DAMPING = _Range(SMALLEST_DAMPING_M, LARGEST_DAMPING_M, "m", ", or 0")
_TIME_LIMIT = _Range(0, 999, "s", ", or None")
_ACTION_REPEAT = _Range(0, MOST_REPEATS, "")
_MAX_SPEED = _Range(2, FASTEST_M_S, "m/s")
_REPEAT = _Range(1, 2, "")
_ACTIONS = "Stay, TakePhoto, StartVideo, StopVideo, TurnTo, GimbalPitch"
_PARAMETERS = {Stay: _Range(0, 32.767, "s"), TurnTo: _HEADING, GimbalPitch: _PITCH}


def problems(plan: PlanValues) -> Iterator[BadPlan]:
    """Everything that is wrong with a plan, from the whole to its points; nothing if it is good."""
    fields = [*_problems_of_choices(plan), *_problems_of_speed(plan)]
    for index, waypoint in enumerate(plan.waypoints[:MOST_POINTS]):
        fields += _problems_of_point(index, waypoint, plan.trace)
    yield from _problems_of_count(plan.waypoints)
    yield from fields
    # Only where every point is somewhere: distances from a NaN would say nothing.
    if not fields and len(plan.waypoints) <= MOST_POINTS:
        yield from _problems_of_way(plan)


def wrong(
    field: str,
    value: object,
    said: str,
    remedy: str,
    limit: object = None,
    point: int | None = None,
) -> BadPlan:
    """The error of a field of a plan, or of one of its points."""
    place = field if point is None else f"waypoint {point}: {field}"
    return BadPlan(
        f"{place} {said}", point=point, field=field, value=value, limit=limit, remedy=remedy
    )


def _outside(
    value: object, limits: _Range, field: str, point: int | None = None, *, whole: bool = False
) -> Iterator[BadPlan]:
    found = number(value)
    if found is None or not math.isfinite(found):
        said = f"is {shortened(repr(value))}, not a finite number"
    elif not limits.low <= found <= limits.high:
        above = found > limits.high
        limit = limits.high if above else limits.low
        side = "above" if above else "below"
        said = f"{found:g} is {side} {limit:g} {limits.unit}".replace(" °", "°").rstrip()
    elif whole and found != int(found):
        said = f"is {found:g}, not a whole number"
    else:
        return
    remedy = str(limits)
    if limits is _HEADING and found is not None and abs(found) <= 360:
        remedy += f"; {found - math.copysign(360, found):g}° is the same direction"
    yield wrong(field, value, said, remedy, limits[:2], point)


def _problems_of_count(waypoints: Sequence[Waypoint]) -> Iterator[BadPlan]:
    count = len(waypoints)
    if not FEWEST_POINTS <= count <= MOST_POINTS:
        yield BadPlan(
            f"a plan of {count} waypoint{'' if count == 1 else 's'} cannot be flown",
            field="waypoints",
            value=count,
            limit=(FEWEST_POINTS, MOST_POINTS),
            remedy=f"{FEWEST_POINTS} to {MOST_POINTS} waypoints; fly more of them as several plans",
        )


def _problems_of_choices(plan: PlanValues) -> Iterator[BadPlan]:
    for field, kind in CHOICES.items():
        value = getattr(plan, field)
        if not isinstance(value, kind):
            names = ", ".join(f"{kind.__name__}.{one.name}" for one in kind)
            said = f"is {shortened(repr(value))}"
            yield wrong(field, value, said, f"one of {names}", tuple(kind))
    yield from _not_bool(plan.gimbal_by_waypoint, "gimbal_by_waypoint")
    yield from _not_bool(plan.take_off, "take_off")
    yield from _outside(plan.repeat, _REPEAT, "repeat", whole=True)


def _not_bool(value: object, field: str, point: int | None = None) -> Iterator[BadPlan]:
    if not isinstance(value, bool):
        said = f"is {shortened(repr(value))}"
        yield wrong(field, value, said, "True or False", (False, True), point)


def _problems_of_speed(plan: PlanValues) -> Iterator[BadPlan]:
    slow = list(_outside(plan.max_speed, _MAX_SPEED, "max_speed"))
    yield from slow
    # Beside a max_speed that is wrong itself, the limit of the aircraft judges the speed.
    fastest = FASTEST_M_S if slow else plan.max_speed
    for problem in _outside(plan.speed, _Range(-fastest, fastest, "m/s"), "speed"):
        problem.remedy += (
            f", which is max_speed; that may be up to {FASTEST_M_S:g} m/s"
            if fastest < FASTEST_M_S
            else ""
        )
        yield problem


def _problems_of_point(index: int, waypoint: Waypoint, trace: Trace) -> Iterator[BadPlan]:
    if not isinstance(waypoint, Waypoint):
        yield BadPlan(  # type: ignore[unreachable] # what callers without a checker give
            f"waypoint {index} is {shortened(repr(waypoint))}",
            point=index,
            field="waypoints",
            value=waypoint,
            remedy="a Waypoint",
        )
        return
    for field, limits in _POINT.items():
        yield from _outside(getattr(waypoint, field), limits, field, index)
    if number(waypoint.damping) != 0:
        yield from _outside(waypoint.damping, _DAMPING, "damping", index)
    yield from _not_bool(waypoint.turn_clockwise, "turn_clockwise", index)
    yield from _problems_of_actions(index, waypoint, trace)


def _problems_of_actions(index: int, waypoint: Waypoint, trace: Trace) -> Iterator[BadPlan]:
    yield from _outside(waypoint.action_repeat, _ACTION_REPEAT, "action_repeat", index, whole=True)
    if waypoint.action_time_limit is not None:
        yield from _outside(waypoint.action_time_limit, _TIME_LIMIT, "action_time_limit", index)
    actions = waypoint.actions
    if not isinstance(actions, tuple):
        remedy = f"a list of {_ACTIONS}"
        yield wrong("actions", actions, f"is {shortened(repr(actions))}", remedy, point=index)
        return
    if len(actions) > MOST_ACTIONS:
        yield BadPlan(
            f"waypoint {index} has {len(actions)} actions",
            point=index,
            field="actions",
            value=len(actions),
            limit=(0, MOST_ACTIONS),
            remedy=f"{MOST_ACTIONS} at most",
        )
    if actions and trace is Trace.COORDINATED_TURNS:
        yield BadPlan(
            f"waypoint {index} has actions that would never be done",
            point=index,
            field="actions",
            value=actions,
            cause="with trace=Trace.COORDINATED_TURNS the aircraft does not stop at waypoints",
            remedy="Trace.STOP_AT_POINTS, or no actions",
        )
    for place, action in enumerate(actions):
        yield from _problems_of_action(index, f"actions[{place}]", action)


def _problems_of_action(index: int, field: str, action: object) -> Iterator[BadPlan]:
    kind: Any = type(action)
    if kind not in ACTIONS.values():
        said, remedy = f"is {shortened(repr(action))}", f"one of {_ACTIONS}"
        if isinstance(action, type) and action in ACTIONS.values():
            said = f"is the class {action.__name__}"
            remedy = f"an action is made by calling it: {action.__name__}(…)"
        yield wrong(field, action, said, remedy, point=index)
        return
    for name in kind.__match_args__:
        yield from _outside(getattr(action, name), _PARAMETERS[kind], f"{field}.{name}", index)


def leg_length(here: Waypoint, there: Waypoint) -> float:
    """Metres from a point to another, climbs included: along the ellipsoid and up."""
    return math.hypot(distance_m(*_place(here), *_place(there)), there.height - here.height)


def leg_lengths(waypoints: Sequence[Waypoint]) -> list[float]:
    """Metres from each point to the next."""
    return [leg_length(here, there) for here, there in pairwise(waypoints)]


def _problems_of_way(plan: PlanValues) -> Iterator[BadPlan]:
    lengths = leg_lengths(plan.waypoints)
    for index, length in enumerate(lengths, start=1):
        if not NEAREST_M <= length <= FARTHEST_M:
            near = length < NEAREST_M
            yield BadPlan(
                f"waypoint {index} is {length:.2f} m from the one before it",
                point=index,
                field="waypoints",
                value=length,
                limit=(NEAREST_M, FARTHEST_M),
                remedy=f"at least {NEAREST_M:g} m, measured in height too; leave one of them out"
                if near
                else f"at most {FARTHEST_M:g} m; put others between them",
            )
    if plan.trace is Trace.COORDINATED_TURNS:
        yield from _problems_of_damping(plan.waypoints, lengths)
    if sum(lengths) > LONGEST_M:
        yield BadPlan(
            f"the way is {sum(lengths) / 1000:.1f} km long",
            field="waypoints",
            value=sum(lengths),
            limit=LONGEST_M,
            remedy=f"at most {LONGEST_M / 1000:g} km; fly it as several plans",
        )


def _problems_of_damping(
    waypoints: Sequence[Waypoint], lengths: Sequence[float]
) -> Iterator[BadPlan]:
    """Corners must not overlap; there is none at the first and at the last point."""
    dampings = [0.0, *(point.damping for point in waypoints[1:-1]), 0.0]
    for index, ((before, after), length) in enumerate(
        zip(pairwise(dampings), lengths, strict=True), start=1
    ):
        if before + after > length:
            point = index if after else index - 1
            yield BadPlan(
                f"waypoint {point}: corners of {before:g} m and {after:g} m do not fit into the "
                f"{length:.2f} m from waypoint {index - 1} to waypoint {index}",
                point=point,
                field="damping",
                value=before + after,
                limit=length,
                remedy="smaller dampings, together at most the distance",
            )


# -- how long a plan takes, and how much of the battery: an estimate, and what it reckons with -----
# Nothing of it is measured on an aircraft. Along the way it flies at the plan's speed, more slowly
# where it climbs or descends faster than :data:`CLIMB_M_S`. A stop costs :data:`STOP_S` to settle
# and :data:`STOP_S_PER_M_S` for braking and speeding up again; turns on the spot take their angle
# at :data:`TURN_DEG_S`, and so does the gimbal; an action of the camera takes :data:`CAMERA_S`. The
# virtual aircraft's flights take as long within 15 %. The battery lasts as long as DJI says that a
# Matrice 100 hovers with it: flying forwards takes about as much.


HOVER_MINUTES = 17.0
"""DJI's figure for a TB47D and 500 g of payload; 22 without any, 13 with 1 kg. A TB48D: 20, 28, 16.
A camera, a computer and their supply are about 500 g."""
STOP_S, STOP_S_PER_M_S = 2.0, 0.3
CLIMB_M_S = 3.0
LANDING_M_S = 1.5
HOMEWARD_M_S = 8.0
TURN_DEG_S = 45.0
CAMERA_S = 1.5  # a photograph, and the beginning and end of a video


@dataclass(frozen=True, slots=True)
class PlanEstimate:
    """Rough length and duration of a plan."""

    length_m: float  #: Metres flown, in each run and on the ways before and behind that are known.
    duration_s: float  #: Seconds; infinite for a plan that only the pilot's stick moves.
    #: Of a full battery, more than 100 if one is not enough; infinite likewise.
    battery_percent: float
    hover_minutes: float  #: How long a full one was taken to last.

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
    """See :meth:`m100link.WaypointPlan.estimate`."""
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
    for point, acting in zip(points, seconds_of_actions(plan), strict=True):
        limit = point.action_time_limit
        seconds += acting if limit is None else min(acting, limit)
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
    places = map(_place, plan.waypoints)
    courses = [bearing_deg(*here, *there) for here, there in pairwise(places)]
    return [courses[0], *courses]


def _turns(plan: PlanValues, headings: Sequence[float]) -> float:
    """Seconds of turning to the next leg; between headings of waypoints it turns as it flies."""
    if plan.heading is not Heading.ALONG_PATH:
        return 0.0
    turns = (abs(normalize_degrees(there - here)) for here, there in pairwise(headings))
    return sum(turns) / TURN_DEG_S


def _stop(plan: PlanValues) -> float:
    """Seconds that stopping, and flying on, costs."""
    return STOP_S + STOP_S_PER_M_S * max(0.0, plan.speed)


def seconds_of_actions(plan: PlanValues) -> list[float]:
    """How long the actions of each waypoint take if nothing cuts them off, s."""
    # The gimbal looks ahead at first.
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


def _place(point: Waypoint) -> tuple[float, float]:
    return point.latitude_deg, point.longitude_deg


def _back_to_first(plan: PlanValues, times: int) -> tuple[float, float]:
    """The way to where a run begins again, and that at the end of the mission."""
    times += plan.at_end is AtEnd.FIRST_POINT
    if not times:
        return 0.0, 0.0
    first, last = plan.waypoints[0], plan.waypoints[-1]
    length = leg_length(last, first)
    seconds = _seconds(length, last.height - first.height, plan.speed)
    return times * length, times * (seconds + _stop(plan))


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


# -- what a plan says and does not mean, or means and does not say: legal, and worth a look --------


FACTORY_HEIGHT_M = 120.0  # up to here an aircraft flies until its app allows more


def remarks(plan: PlanValues) -> Iterator[str]:
    """A sentence for each thing in a plan that may surprise its user."""
    yield from _on_the_whole(plan)
    yield from _on_what_is_ignored(plan)
    if plan.trace is Trace.STOP_AT_POINTS:
        for index, seconds in enumerate(seconds_of_actions(plan)):
            limit = plan.waypoints[index].action_time_limit
            if limit is not None and seconds > limit:
                yield (
                    f"waypoint {index}: its actions take about {seconds:.0f} s and are cut off "
                    f"after {limit:g} s"
                )


def _on_the_whole(plan: PlanValues) -> Iterator[str]:
    heights = [point.height for point in plan.waypoints]
    if plan.on_rc_loss is OnRCLoss.CONTINUE:
        yield "without the RC it flies on, and no pilot can stop it"
    if plan.speed <= 0:
        yield f"speed is {plan.speed:g}: it moves only as the pilot's pitch stick says"
    if plan.at_end is AtEnd.ENDLESS:
        yield "it never ends by itself: after the last waypoint it hovers, still in the mission"
    if max(heights) > FACTORY_HEIGHT_M:
        yield (
            f"it climbs to {max(heights):g} m; a height limit of {FACTORY_HEIGHT_M:g} m, as set in "
            "the factory, refuses it"
        )
    if min(heights) < 0:
        yield f"it descends to {-min(heights):g} m below the take-off point"
    if plan.speed > 0 and (share := estimate(plan).battery_percent) > 100:
        yield f"it takes about {share:.0f} % of a battery"


def _on_what_is_ignored(plan: PlanValues) -> Iterator[str]:
    points = plan.waypoints
    if plan.heading is not Heading.BY_WAYPOINT and any(point.heading_deg for point in points):
        yield "headings of waypoints are ignored: heading is not Heading.BY_WAYPOINT"
    if not plan.gimbal_by_waypoint and any(point.gimbal_pitch_deg for point in points):
        yield "gimbal pitches of waypoints are ignored: gimbal_by_waypoint is False"
    if plan.trace is Trace.STOP_AT_POINTS and any(point.damping for point in points):
        yield "dampings are ignored: it stops at waypoints"
