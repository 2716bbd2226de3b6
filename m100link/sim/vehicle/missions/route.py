"""The line that a waypoint mission flies: straight legs, and rounded corners between them.

Plain geometry in metres north, east and up. A :class:`Leg` runs from one place where the aircraft
stops, or turns sharply, to the next; within a leg the line is smooth.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from typing import NamedTuple

__all__ = ["Leg", "OnLeg", "Place", "distance", "legs_between"]

_STRAIGHT = math.radians(0.5)  # a smaller turn needs no curve
_SHARP_M = 0.1  # a smaller radius is none


class Place(NamedTuple):
    """A place, or a vector between two: metres north, east and up."""

    north: float
    east: float
    up: float

    def plus(self, other: Place, times: float = 1.0) -> Place:
        """This one and a multiple of another."""
        return Place(
            self.north + times * other.north,
            self.east + times * other.east,
            self.up + times * other.up,
        )

    def dot(self, other: Place) -> float:
        """The scalar product."""
        return self.north * other.north + self.east * other.east + self.up * other.up

    def scaled(self, factor: float) -> Place:
        """A multiple of it."""
        return Place(factor * self.north, factor * self.east, factor * self.up)


_NOWHERE = Place(0.0, 0.0, 0.0)


def distance(one: Place, other: Place) -> float:
    """Metres between two places, in all three dimensions."""
    return math.dist(one, other)


def _direction(start: Place, end: Place) -> Place:
    length = distance(start, end)
    return end.plus(start, -1.0).scaled(1.0 / length) if length > 0.0 else _NOWHERE


class OnLeg(NamedTuple):
    """One place of a leg.

    Attributes:
        place: Where it is.
        tangent: Unit vector along the leg.
        bend: Curvature as a vector towards the centre, 1/m; zero on straight parts.
    """

    place: Place
    tangent: Place
    bend: Place


@dataclass(frozen=True, slots=True)
class _Line:
    start: Place
    tangent: Place
    length: float
    radius: float = math.inf

    def at(self, s: float) -> OnLeg:
        return OnLeg(self.start.plus(self.tangent, s), self.tangent, _NOWHERE)


@dataclass(frozen=True, slots=True)
class _Arc:
    """From ``start`` along ``tangent``, bending towards ``normal``."""

    start: Place
    tangent: Place
    normal: Place
    radius: float
    length: float

    def at(self, s: float) -> OnLeg:
        angle = s / self.radius
        sine, cosine = math.sin(angle), math.cos(angle)
        towards = self.normal.scaled(cosine).plus(self.tangent, -sine)
        place = self.start.plus(self.normal, self.radius).plus(towards, -self.radius)
        tangent = self.tangent.scaled(cosine).plus(self.normal, sine)
        return OnLeg(place, tangent, towards.scaled(1.0 / self.radius))


class Leg:
    """A smooth line from one waypoint to another, past those between them.

    Attributes:
        first, last: Indexes of the waypoints at its ends.
        length: Metres.
        marks: Where along it which waypoint is passed: pairs of metres and index, in order.
        curves: Where it bends: start, end and radius, metres.
    """

    __slots__ = ("_pieces", "_starts", "curves", "first", "last", "length", "marks")

    def __init__(self, pieces: list[_Line | _Arc], marks: list[tuple[float, int]]) -> None:
        self._pieces = pieces
        self._starts: list[float] = []
        self.curves: list[tuple[float, float, float]] = []
        total = 0.0
        for piece in pieces:
            self._starts.append(total)
            if piece.radius < math.inf:
                self.curves.append((total, total + piece.length, piece.radius))
            total += piece.length
        self.length = total
        self.marks = marks
        self.first, self.last = marks[0][1], marks[-1][1]

    @classmethod
    def straight(cls, start: Place, end: Place, first: int, last: int) -> Leg:
        """A line between two places."""
        length = distance(start, end)
        return cls([_Line(start, _direction(start, end), length)], [(0.0, first), (length, last)])

    def at(self, s: float) -> OnLeg:
        """The place after ``s`` metres."""
        s = max(0.0, min(self.length, s))
        index = max(0, bisect_right(self._starts, s) - 1)
        return self._pieces[index].at(s - self._starts[index])

    def nearest(self, place: Place, s: float) -> float:
        """Where along the leg a place beside it is, in the neighbourhood of ``s``."""
        for _ in range(2):
            here = self.at(s)
            s = max(0.0, min(self.length, s + place.plus(here.place, -1.0).dot(here.tangent)))
        return s

    def between(self, s: float) -> tuple[int, int, float]:
        """The waypoints before and behind a place of the leg, and how far along between them."""
        after = min(len(self.marks) - 1, max(1, bisect_right(self.marks, (s, 1 << 16))))
        (start, first), (end, last) = self.marks[after - 1], self.marks[after]
        share = (s - start) / (end - start) if end > start else 1.0
        return first, last, max(0.0, min(1.0, share))


def legs_between(places: list[Place], dampings: list[float] | None) -> list[Leg]:
    """The legs of a route.

    Args:
        places: The waypoints, two or more.
        dampings: Radius of the curve at each, for coordinated turns; at the first and the last
            it does not count, and 0 is a corner without a curve. None stops at every waypoint.

    A curve begins at most its damping before the waypoint, so that those of neighbours always fit
    when the two are together not longer than the leg: a turn of more than 90 degrees has a
    smaller radius than its damping.
    """
    legs: list[Leg] = []
    pieces: list[_Line | _Arc] = []
    marks: list[tuple[float, int]] = [(0.0, 0)]
    at, done = places[0], 0.0
    for index in range(1, len(places)):
        curve = None
        if dampings is not None and index < len(places) - 1:
            before, point, after = places[index - 1 : index + 2]
            curve = _curve(before, point, after, dampings[index])
        end = places[index] if curve is None else curve.start
        line = _Line(at, _direction(at, end), distance(at, end))
        pieces.append(line)
        done += line.length
        at = end
        if curve is None:
            marks.append((done, index))
            if dampings is None or index == len(places) - 1 or not _goes_on(places, index):
                legs.append(Leg(pieces, marks))
                pieces, marks, done = [], [(0.0, index)], 0.0
        else:
            pieces.append(curve)
            marks.append((done + curve.length / 2.0, index))
            done += curve.length
            at = curve.at(curve.length).place
    return legs


def _turn(before: Place, point: Place, after: Place) -> float:
    cosine = _direction(before, point).dot(_direction(point, after))
    return math.acos(max(-1.0, min(1.0, cosine)))


def _goes_on(places: list[Place], index: int) -> bool:
    """Whether the line goes straight on at a waypoint."""
    before, point, after = places[index - 1 : index + 2]
    return _turn(before, point, after) < _STRAIGHT


def _curve(before: Place, point: Place, after: Place, damping: float) -> _Arc | None:
    angle = _turn(before, point, after)
    if angle < _STRAIGHT or damping <= 0.0:
        return None
    tangent, onwards = _direction(before, point), _direction(point, after)
    half = math.tan(angle / 2.0)
    ahead = min(damping, damping * half)  # how far before the waypoint the curve begins
    radius = ahead / half
    if radius < _SHARP_M:
        return None
    sideways = onwards.plus(tangent, -onwards.dot(tangent))
    normal = sideways.scaled(1.0 / math.hypot(*sideways))
    return _Arc(point.plus(tangent, -ahead), tangent, normal, radius, radius * angle)
