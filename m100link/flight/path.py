"""Where to steer on a path with rounded corners: from place to the next velocity. No I/O, no clock.

Metres north, east and up from an origin of the caller's choice; heights are above take-off.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

from m100link.errors import UsageError

LAG_S = 0.65  # by which the velocity follows its setpoint, in the model of the virtual aircraft
_ACCELERATION = 1.0  # m/s² along the path
_BRAKING = 0.4  # m/s along the path for each metre that remains
_CROSS_GAIN = 1.0  # m/s towards the path per metre beside it
_CROSS_DAMPING = 0.4
_CORNER_ACCELERATION = 1.5  # m/s², v²/r on a rounded corner: a tilt of 9°
_MAX_TURN_RAD_S = 0.5  # of the velocity, on a rounded corner
_CORNER_M_S = 0.4  # round a corner that is not rounded
_REACHED_M = 0.3  # from such a corner, when the next leg begins
_CLIMB_M_S = 2.0  # a steeper leg is flown more slowly
_WAITS_M = 2.0  # from the height of the path; it slows down from a metre less on
_TOO_SHORT_M = 0.05  # two points of a path so near to each other are one
_SHARP_M = 0.5  # a smaller radius is a corner

_Point = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class PathSteering:
    """The velocity, height and heading to fly now."""

    north: float  # velocity, m/s
    east: float  # velocity, m/s
    height: float  # above take-off, m
    ahead_deg: float  # direction of the path here, °
    off_m: float  # horizontal distance from the path
    to_go_m: float  # length of the path that remains, negative beyond its end


@dataclass(frozen=True, slots=True)
class _Leg:
    start: tuple[float, float]  # north and east, m
    ahead: tuple[float, float]  # direction, of length 1
    length: float  # m
    begins_at: float  # length of the path before it, m
    curvature: ClassVar[float] = 0.0  # of the velocity, 1/m, positive to the right

    def locate(self, place: tuple[float, float]) -> tuple[float, float, tuple[float, float]]:
        """How far along it a place is, how far to its right, and the direction there."""
        north, east = place[0] - self.start[0], place[1] - self.start[1]
        along = north * self.ahead[0] + east * self.ahead[1]
        right = east * self.ahead[0] - north * self.ahead[1]
        return along, right, self.ahead


@dataclass(frozen=True, slots=True)
class _Bend:
    centre: tuple[float, float]  # north and east, m
    radius: float  # m
    start: float  # bearing of its first point from the centre, rad
    sense: float  # 1 to the right, −1 to the left
    length: float  # m
    begins_at: float  # length of the path before it, m

    def locate(self, place: tuple[float, float]) -> tuple[float, float, tuple[float, float]]:
        """See :meth:`_Leg.locate`."""
        north, east = place[0] - self.centre[0], place[1] - self.centre[1]
        bearing = math.atan2(east, north)
        turned = math.remainder((bearing - self.start) * self.sense, math.tau)
        out = math.cos(bearing), math.sin(bearing)
        ahead = -out[1] * self.sense, out[0] * self.sense
        right = (self.radius - math.hypot(north, east)) * self.sense
        return turned * self.radius, right, ahead

    @property
    def curvature(self) -> float:
        """See :attr:`_Leg.curvature`."""
        return self.sense / self.radius


class Path:
    """A path through points, flown by velocity setpoints with a height.

    ``points``: north, east and height of each, the first one where it begins; 2 or more.
    ``corner_radius``: of rounded corners, m; smaller where a leg is too short for it. 0: each
    corner is flown to, almost stopping. Raises ``UsageError``: it cannot be flown.
    """

    def __init__(
        self, points: Sequence[_Point], *, speed: float, corner_radius: float, max_speed: float
    ) -> None:
        for index, point in enumerate(points):
            if len(point) != 3 or not all(map(math.isfinite, point)) or point[2] < 0:
                raise UsageError(
                    f"point {index} of the path cannot be flown to: {point}",
                    remedy="each is north, east and height: finite numbers, height 0 m or more",
                )
        if not 0 < speed <= max_speed:
            raise UsageError(f"a path cannot be flown at {speed:g} m/s; up to {max_speed:g} m/s")
        if not 0 <= corner_radius < math.inf:
            raise UsageError(f"{corner_radius:g} m is not the radius of a corner")
        corners = [points[0]]
        leaving = [points[0][2]]  # the height with which the next leg begins
        for point in points[1:]:
            if math.dist(point[:2], corners[-1][:2]) >= _TOO_SHORT_M:
                corners.append(point)
                leaving.append(point[2])
            else:  # straight up or down, before the next leg
                leaving[-1] = point[2]
        if len(corners) < 2:
            raise UsageError(
                "the points of the path are all one place",
                remedy="climb_to() climbs in place",
            )
        self._speed = speed  # on straight legs, m/s
        self._max_speed = max_speed  # of the velocity that is asked for, m/s
        self._pieces: list[_Leg | _Bend] = []
        # Where along the path which height is wanted, and how fast it may be flown.
        self._heights: list[tuple[float, float]] = [(0.0, leaving[0])]
        self._limits: list[tuple[float, float, float]] = []  # from, to, m/s
        self.length = 0.0  # horizontal, m
        self._lay(corners, leaving, corner_radius)
        self._limits.append((self.length, self.length, 0.0))
        for (begin, low), (end, high) in pairwise(self._heights):
            if high != low and end > begin:
                self._limits.append((begin, end, _CLIMB_M_S * (end - begin) / abs(high - low)))
        self._index = 0  # of the piece that is flown
        self._asked = 0.0  # speed along the path at the tick before

    # -- laying the path -------------------------------------------------------------------------

    def _lay(self, corners: list[_Point], leaving: list[float], corner_radius: float) -> None:
        at = corners[0][:2]
        for index in range(1, len(corners)):
            corner = corners[index]
            if index + 1 == len(corners):
                self._add_leg(at, corner[:2])
                self._add_height(corner[2], leaving[index])
                return
            before, after = corners[index - 1], corners[index + 1]
            radius, cut, turn = _rounding(before, corner, after, corner_radius)
            is_sharp = radius < _SHARP_M and abs(turn) > math.radians(5)
            if is_sharp or leaving[index] != corner[2]:
                self._add_leg(at, corner[:2])
                self._add_height(corner[2], leaving[index])
                self._limits.append((self.length, self.length, _CORNER_M_S))
                at = corner[:2]
                continue
            begin, end = _towards(corner, before, cut), _towards(corner, after, cut)
            self._add_leg(at, begin)
            if cut > 0:
                self._add_bend(begin, corner, radius, turn)
                self._heights.append((self.length - radius * abs(turn) / 2, corner[2]))
            else:
                self._heights.append((self.length, corner[2]))
            at = end

    def _add_height(self, arriving: float, leaving: float) -> None:
        """At the end of what is laid; where the two differ, it climbs or descends in place."""
        if arriving == leaving:
            self._heights.append((self.length, arriving))
            return
        reached = self.length - _REACHED_M
        self._heights += (reached, arriving), (reached, leaving), (self.length, leaving)

    def _add_leg(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        length = math.dist(start, end)
        if length > 1e-6:
            ahead = (end[0] - start[0]) / length, (end[1] - start[1]) / length
            self._pieces.append(_Leg(start, ahead, length, self.length))
            self.length += length

    def _add_bend(
        self, begin: tuple[float, float], corner: _Point, radius: float, turn: float
    ) -> None:
        heading = math.atan2(corner[1] - begin[1], corner[0] - begin[0])
        sense = math.copysign(1.0, turn)
        to_centre = heading + sense * math.pi / 2
        centre = begin[0] + radius * math.cos(to_centre), begin[1] + radius * math.sin(to_centre)
        length = radius * abs(turn)
        bend = _Bend(centre, radius, heading - sense * math.pi / 2, sense, length, self.length)
        self._pieces.append(bend)
        slow = min(math.sqrt(_CORNER_ACCELERATION * radius), _MAX_TURN_RAD_S * radius)
        self._limits.append((self.length, self.length + length, slow))
        self.length += length

    # -- flying it -------------------------------------------------------------------------------

    def steer(
        self, place: _Point, velocity: tuple[float, float] | None, elapsed: float
    ) -> PathSteering:
        """The next velocity.

        ``place``: north, east and height, m. ``velocity``: north and east, m/s; None when it is
        unknown. ``elapsed``: seconds since the call before.
        """
        piece, along, right, ahead = self._locate(place[:2])
        at = piece.begins_at + along
        to_go = self.length - at
        speed = self._wanted_speed(at, to_go, place[2], elapsed)
        to_right = -ahead[1], ahead[0]
        running, drifting = speed, 0.0
        if velocity is not None:
            running = velocity[0] * ahead[0] + velocity[1] * ahead[1]
            drifting = velocity[0] * to_right[0] + velocity[1] * to_right[1]
        sideways = -_CROSS_GAIN * right - _CROSS_DAMPING * drifting
        # The velocity lags behind: on a bend its turn is asked for early.
        sideways += LAG_S * running * abs(running) * self._curvature(at + running * LAG_S)
        sideways = max(-0.8 * self._max_speed, min(0.8 * self._max_speed, sideways))
        fastest = math.sqrt(self._max_speed**2 - sideways**2) * (1 - 1e-6)
        speed = max(-fastest, min(fastest, speed))
        return PathSteering(
            north=ahead[0] * speed + to_right[0] * sideways,
            east=ahead[1] * speed + to_right[1] * sideways,
            height=self._height(at + running * LAG_S),
            ahead_deg=math.degrees(math.atan2(ahead[1], ahead[0])),
            off_m=abs(right),
            to_go_m=to_go,
        )

    def _locate(
        self, place: tuple[float, float]
    ) -> tuple[_Leg | _Bend, float, float, tuple[float, float]]:
        """The piece that is flown, how far along it, how far to its right, and its direction."""
        # Only onwards: where a path crosses itself, the nearest piece may be another one.
        while True:
            piece = self._pieces[self._index]
            along, right, ahead = piece.locate(place)
            if self._index + 1 == len(self._pieces):
                return piece, along, right, ahead
            following = self._pieces[self._index + 1]
            is_corner = isinstance(piece, _Leg) and isinstance(following, _Leg)
            if along < piece.length - (_REACHED_M if is_corner else 0.0):
                return piece, along, right, ahead
            self._index += 1

    def _wanted_speed(self, at: float, to_go: float, height: float, elapsed: float) -> float:
        """Speed along the path: gently up, down before what is slow; back when it flew beyond."""
        wanted = self._speed
        for begin, end, limit in self._limits:
            if at <= end:
                wanted = min(wanted, limit + _BRAKING * max(0.0, begin - at))
        # It does not leave a place below or above the path that somebody laid over an obstacle.
        off = abs(self._height(at) - height)
        wanted *= max(0.0, min(1.0, _WAITS_M - off))
        if to_go < 0:
            wanted = _BRAKING * to_go
        self._asked = min(wanted, max(0.0, self._asked) + _ACCELERATION * elapsed)
        return self._asked

    def _curvature(self, at: float) -> float:
        for piece in self._pieces[self._index :]:
            if at <= piece.begins_at + piece.length:
                return piece.curvature
        return 0.0

    def _height(self, at: float) -> float:
        for (begin, low), (end, high) in pairwise(self._heights):
            if at <= end and end > begin:
                return low + (high - low) * max(0.0, at - begin) / (end - begin)
        return self._heights[-1][1]


def _towards(point: _Point, other: _Point, distance: float) -> tuple[float, float]:
    """The place so far from a point towards another, horizontally."""
    share = distance / math.dist(point[:2], other[:2])
    north, east = other[0] - point[0], other[1] - point[1]
    return point[0] + north * share, point[1] + east * share


def _rounding(
    before: _Point, corner: _Point, after: _Point, wanted: float
) -> tuple[float, float, float]:
    """Radius of a rounded corner, what it cuts off each leg, and the turn to the right, rad."""
    coming = math.atan2(corner[1] - before[1], corner[0] - before[0])
    going = math.atan2(after[1] - corner[1], after[0] - corner[0])
    turn = math.remainder(going - coming, math.tau)
    if abs(turn) < 1e-6:
        return wanted, 0.0, 0.0
    # To turn back has no arc: it is flown to, as a sharp corner is.
    if abs(turn) > math.radians(175):
        return 0.0, 0.0, turn
    per_radius = math.tan(abs(turn) / 2)
    # Half a leg for the corner at each of its ends: two arcs must not overlap.
    room = 0.5 * min(math.dist(before[:2], corner[:2]), math.dist(corner[:2], after[:2]))
    if abs(turn) < math.pi / 2:  # as near to the corner as one of 90° is passed
        wanted *= (math.sqrt(2) - 1) / (1 / math.cos(turn / 2) - 1)
    cut = min(wanted * per_radius, room)
    return cut / per_radius, cut, turn
