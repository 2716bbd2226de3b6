"""What is wrong with a show: limits of each aircraft, and how near any two come to each other."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

from m100link.apps.fleet.show.distance import apart, closest, under
from m100link.apps.fleet.show.document import Show
from m100link.apps.fleet.show.track import BadShow, TimedTrack, Vector
from m100link.errors import GuardRefused
from m100link.flight.guards import Envelope

__all__ = [
    "ACCELERATION_M_S2",
    "CLIMB_M_S",
    "SKEW_S",
    "Closest",
    "Report",
    "check",
    "distances",
    "needed_m",
    "places",
]

SKEW_S = 0.05
"""By how much the clock of an agent may be wrong in a show; more, and it does not begin."""
CLIMB_M_S = 2.0
"""The steepest climb or descent: slower than the aircraft sinks into its own downwash."""
ACCELERATION_M_S2 = 1.5
"""A tilt of 9°, as on the rounded corners of a path."""
_SPARE = 0.8  # of the envelope's speed: with the rest an aircraft that is late catches up
_SAMPLES = 240
"""Moments at which the least distance is drawn."""


@dataclass(frozen=True, slots=True)
class Closest:
    """The nearest that any two come to each other.

    Attributes:
        at: Seconds from the beginning of the show.
        first: Name of one of them.
        second: Of the other one.
        distance_m: Between their tracks.
        needed_m: What these two need there.
    """

    at: float
    first: str
    second: str
    distance_m: float
    needed_m: float


@dataclass(frozen=True, slots=True)
class Report:
    """What the check of a show found.

    Attributes:
        problems: Why it must not be flown; none if it may be.
        remarks: What may surprise.
        closest: The nearest pair; None if there is only one aircraft.
    """

    problems: tuple[BadShow, ...]
    remarks: tuple[str, ...]
    closest: Closest | None

    @property
    def ok(self) -> bool:
        """Whether it may be flown."""
        return not self.problems


def needed_m(show: Show, first: TimedTrack, second: TimedTrack) -> float:
    """How far apart the tracks of two have to be, m.

    What the show wants between aircraft, both tubes, and the way that either flies in the time by
    which its clock may be wrong.
    """
    late = SKEW_S * sum(math.hypot(*track.fastest) for track in (first, second))
    return show.least_distance_m + first.tube_m + second.tube_m + late


def check(show: Show, envelope: Envelope | None = None) -> Report:
    """Look at each aircraft by itself, and at all of them together.

    Args:
        show: The show.
        envelope: Of the agents' guards; by default the guards' own.
    """
    problems = [
        problem for track in show.tracks for problem in _alone(track, envelope or Envelope())
    ]
    problems += _together(show)
    return Report(tuple(problems), tuple(_remarks(show)), _closest(show))


# -- one aircraft ---------------------------------------------------------------------------------


def _alone(track: TimedTrack, envelope: Envelope) -> Iterator[BadShow]:
    """What its guards and its autopilot would not fly."""
    spots = [(point.north, point.east) for point in track.points]
    far = max(math.dist(spots[0], spot) for spot in spots)  # it takes off below its first point
    highest = max(point.height for point in track.points) - track.ground_m
    lowest = min(point.height for point in track.points) - track.ground_m
    across, upright = track.fastest
    try:
        envelope.check(track.name, height=highest, far=far)
    except GuardRefused as error:
        yield BadShow(error.seen, aircraft=(track.name,), remedy=error.remedy)
    if lowest < 1.0:
        yield BadShow(
            f"{track.name} flies {lowest:.1f} m above its take-off point",
            aircraft=(track.name,),
            measured=lowest,
            limit=1.0,
            cause="heights count from the show's origin, ground_m says where it stands",
            remedy="1 m or more above the ground",
        )
    if across > _SPARE * envelope.max_speed_m_s:
        yield _too_much(track, 0, across, _SPARE * envelope.max_speed_m_s)
    if upright > CLIMB_M_S:
        yield _too_much(track, 1, upright, CLIMB_M_S)
    for leg in track.legs:
        if leg.hardest_m_s2 > ACCELERATION_M_S2:
            yield BadShow(
                f"{track.name} accelerates by {leg.hardest_m_s2:.1f} m/s² between {leg.begin:g} "
                f"and {leg.end:g} s, {ACCELERATION_M_S2:g} m/s² are flown",
                aircraft=(track.name,),
                at=leg.begin,
                measured=leg.hardest_m_s2,
                limit=ACCELERATION_M_S2,
                remedy=f"give it {leg.duration * _slower(leg.hardest_m_s2):.1f} s, or put points "
                "where it turns",
            )
            return  # the others are mostly neighbours of the same corner


def _slower(acceleration: float) -> float:
    """How much longer a leg has to take."""
    return math.sqrt(acceleration / ACCELERATION_M_S2)


def _too_much(track: TimedTrack, which: int, speed: float, limit: float) -> BadShow:
    """One leg that is too fast, horizontally or vertically: the fastest."""
    leg = max(track.legs, key=lambda leg: leg.fastest[which])
    does = "climbs or descends at" if which else "flies"
    return BadShow(
        f"{track.name} {does} {speed:.1f} m/s between {leg.begin:g} and {leg.end:g} s, "
        f"{limit:g} m/s may be flown",
        aircraft=(track.name,),
        at=leg.begin,
        measured=speed,
        limit=limit,
        cause="between two points it begins and ends slowly and is 1.5 times as fast in the middle",
        remedy=f"give it {leg.duration * speed / limit:.1f} s, or a shorter way",
    )


# -- all of them ----------------------------------------------------------------------------------


def _together(show: Show) -> Iterator[BadShow]:
    for first, second in combinations(show.tracks, 2):
        for which, word in ((0, "take off"), (-1, "end")):
            a, b = first.points[which], second.points[which]
            apart = math.dist((a.north, a.east), (b.north, b.east))
            needed = show.least_distance_m + first.tube_m + second.tube_m
            if apart < needed:
                yield BadShow(
                    f"{first.name} and {second.name} {word} {apart:.1f} m from each other, seen "
                    f"from above; {needed:.1f} m are needed",
                    aircraft=(first.name, second.name),
                    at=0.0 if which == 0 else show.duration,
                    measured=apart,
                    limit=needed,
                    cause="each climbs to its first point, and may land below its last one",
                    remedy="move one of them aside",
                )
    for first, second, distance, at in under(
        show.tracks, lambda first, second: needed_m(show, first, second)
    ):
        needed = needed_m(show, first, second)
        yield BadShow(
            f"{first.name} and {second.name} come as near as {distance:.1f} m at {at:.2f} s; "
            f"{needed:.1f} m are needed",
            aircraft=(first.name, second.name),
            at=at,
            measured=distance,
            limit=needed,
            cause=f"{show.least_distance_m:g} m between aircraft, their tubes of "
            f"{first.tube_m:g} and {second.tube_m:g} m, and clocks that differ by {SKEW_S:g} s",
            remedy="move a point, or let one pass later",
        )


def _closest(show: Show) -> Closest | None:
    best: Closest | None = None
    for first, second in combinations(show.tracks, 2):
        found = closest(first, second, below=math.inf if best is None else best.distance_m)
        if found is not None:
            distance, at = found
            needed = needed_m(show, first, second)
            best = Closest(at, first.name, second.name, distance, needed)
    return best


def places(show: Show) -> list[tuple[float, list[Vector]]]:
    """Where each one is at a few hundred moments: for a picture, and for what may surprise."""
    return [
        (at, [track.moment(at).place for track in show.tracks])
        for at in (show.duration * index / _SAMPLES for index in range(_SAMPLES + 1))
    ]


def distances(show: Show) -> list[tuple[float, float]]:
    """Time and least distance of any two at a few hundred moments; nothing for one aircraft."""
    ends = [track.end for track in show.tracks]
    return [
        (
            at,
            min(
                apart(first, second, first_ended=at >= ends[i], second_ended=at >= ends[j])
                for (i, first), (j, second) in combinations(enumerate(there), 2)
            ),
        )
        for at, there in places(show)
        if len(there) > 1
    ]


def _remarks(show: Show) -> Iterator[str]:
    """Who flies over whom: what breaks down above somebody comes down there."""
    told: set[tuple[int, int]] = set()
    for at, there in places(show):
        for (i, first), (j, second) in combinations(enumerate(there), 2):
            upper, lower = (i, j) if first[2] > second[2] else (j, i)
            is_near = math.dist(first[:2], second[:2]) < show.least_distance_m
            if is_near and (upper, lower) not in told:
                told.add((upper, lower))
                yield (
                    f"{show.tracks[upper].name} is above {show.tracks[lower].name} at {at:.1f} s: "
                    "if it has to land there, it comes down on it"
                )
