"""The line that a waypoint mission flies, and how an aircraft is steered along it.

Plain geometry in metres north, east and up. A :class:`RouteLeg` runs from one place where the
aircraft stops, or turns sharply, to the next. Within a leg the line is smooth.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from typing import NamedTuple

from m100link.geodesy import LocalFrame
from m100link.sim.vehicle.dynamics import (
    STEP_S,
    Airframe,
    Dynamics,
    DynamicsInput,
    ModelHorizontal,
    ModelVertical,
    ModelYaw,
    wrapped,
)

# -- what can be chosen about missions: the numbers and open questions of command set 0x03 ---------


@dataclass(frozen=True, slots=True)
class NoFlyZone:
    """A circle on the map that no mission may enter."""

    latitude_deg: float  #: Its centre.
    longitude_deg: float  #: Its centre.
    radius: float  #: Metres.


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionSettings:
    """How the flight controller takes missions.

    Only questions that neither documents nor real aircraft settle have a switch: the defaults are
    the best reading of sources that are silent or disagree, which
    ``docs/explanation/simulator-limits.md`` lists.

    Attributes:
        status_hz: Rate of the status push 0x02/0x03. At 0 no mission pushes anything: the box
            *Ground Station Status* of the assistant is not ticked.
        status_when_idle: Push the status before the first mission, too, as an owner of a 3.1.10
            reports.
        takes_off_by_itself: A waypoint mission started on the ground takes off; else it is refused.
        busy_is_one_code: Answer "conditions not met" for all of taking off, landing, going home
            and starting motors, instead of a code for each.
        closest_points: Neighbouring waypoints are at least so far apart, metres (0.5 in the
            documents of 2017).
        farthest_points: And at most so far, metres.
        longest_route: From the first waypoint to the last, metres.
        longest_way: The route with the ways from and to home, metres; DJI's support says 40 km.
        farthest_start: A mission farther away than this does not start, metres.
        least_battery_percent: At this charge or below, no mission starts.
        low_battery_returns: At the low-battery level a mission is broken off for going home.
        leaving_f_pauses: When the pilot leaves F, the mission waits, paused, until control has come
            back and a program resumes it; else it is broken off.
        stick_pauses: The pilot's roll or throttle stick pauses a waypoint mission. (Pitch is its
            speed, and yaw its heading where the yaw mode says so.)
        radius_limit: Greatest distance of a mission from home, metres. The app's is 500 m as a
            rule, and holds even where the app shows it as off; infinity is none.
        never_logged_in: Nobody ever logged in to the app: limits of 30 m height, 50 m around home.
        beginner_mode: The app's beginner mode, in which no mission starts.
        no_fly_zones: Circles that no mission may enter.
        turn_rate_deg: How fast a mission turns the nose on the spot, degrees per second.
        photo_seconds: How long a photo or video action takes, seconds.
        hotpoint_acks: Answer 0x03/0x23 to 0x25, which a real aircraft does not.
        radial_speed: How fast a hotpoint's radius changes, m/s.
        hotpoint_reach: Farther than this outside its circle, a hotpoint mission cannot resume.
        follow_yaw_reversed: Yaw mode 0 looks at the target and 1 obeys the remote control.
        follow_silence: Seconds without a new target until the aircraft hovers.
        follow_lost: Seconds without a new target until the mission is broken off.
        follow_jump: A target that moved farther at once is ignored, metres.
        follow_speed: Fastest pursuit, m/s.
    """

    status_hz: float = 10.0
    status_when_idle: bool = True
    takes_off_by_itself: bool = True
    busy_is_one_code: bool = False
    closest_points: float = 2.0
    farthest_points: float = 2_000.0
    longest_route: float = 30_000.0
    longest_way: float = 40_000.0
    farthest_start: float = 2_000.0
    least_battery_percent: float = 30.0
    low_battery_returns: bool = True
    leaving_f_pauses: bool = False
    stick_pauses: bool = False
    radius_limit: float = 500.0
    never_logged_in: bool = False
    beginner_mode: bool = False
    no_fly_zones: tuple[NoFlyZone, ...] = ()
    turn_rate_deg: float = 45.0
    photo_seconds: float = 1.2
    hotpoint_acks: bool = False
    radial_speed: float = 3.0
    hotpoint_reach: float = 100.0
    follow_yaw_reversed: bool = False
    follow_silence: float = 6.0
    follow_lost: float = 30.0
    follow_jump: float = 200.0
    follow_speed: float = 10.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.status_hz <= 100.0:
            raise ValueError(f"mission status is pushed at 0 to 100 Hz, not {self.status_hz}")


# -- route -----------------------------------------------------------------------------------------

_STRAIGHT = math.radians(0.5)  # a smaller turn needs no curve
_SHARP_M = 0.1  # a smaller radius is none


class LocalPlace(NamedTuple):
    """A place, or a vector between two: metres north, east and up."""

    north: float
    east: float
    up: float

    def plus(self, other: LocalPlace, times: float = 1.0) -> LocalPlace:
        return LocalPlace(
            self.north + times * other.north,
            self.east + times * other.east,
            self.up + times * other.up,
        )

    def dot(self, other: LocalPlace) -> float:
        return self.north * other.north + self.east * other.east + self.up * other.up

    def scaled(self, factor: float) -> LocalPlace:
        return LocalPlace(factor * self.north, factor * self.east, factor * self.up)


_NOWHERE = LocalPlace(0.0, 0.0, 0.0)


def distance(one: LocalPlace, other: LocalPlace) -> float:
    """Metres between two places, in all three dimensions."""
    return math.dist(one, other)


def _direction(start: LocalPlace, end: LocalPlace) -> LocalPlace:
    length = distance(start, end)
    return end.plus(start, -1.0).scaled(1.0 / length) if length > 0.0 else _NOWHERE


class OnLeg(NamedTuple):
    place: LocalPlace
    tangent: LocalPlace  # unit vector along the leg
    bend: LocalPlace  # curvature as a vector towards the centre, 1/m; zero on straight parts


@dataclass(frozen=True, slots=True)
class _Line:
    start: LocalPlace
    tangent: LocalPlace
    length: float
    radius: float = math.inf

    def at(self, s: float) -> OnLeg:
        return OnLeg(self.start.plus(self.tangent, s), self.tangent, _NOWHERE)


@dataclass(frozen=True, slots=True)
class _Arc:
    """From ``start`` along ``tangent``, bending towards ``normal``."""

    start: LocalPlace
    tangent: LocalPlace
    normal: LocalPlace
    radius: float
    length: float

    def at(self, s: float) -> OnLeg:
        angle = s / self.radius
        sine, cosine = math.sin(angle), math.cos(angle)
        towards = self.normal.scaled(cosine).plus(self.tangent, -sine)
        place = self.start.plus(self.normal, self.radius).plus(towards, -self.radius)
        tangent = self.tangent.scaled(cosine).plus(self.normal, sine)
        return OnLeg(place, tangent, towards.scaled(1.0 / self.radius))


class RouteLeg:
    """A smooth line from one waypoint to another, past those between them.

    ``first``: indexes of the waypoints at its ends.
    """

    def __init__(self, pieces: list[_Line | _Arc], marks: list[tuple[float, int]]) -> None:
        self._pieces = pieces
        self._starts: list[float] = []
        # Where it bends: start, end and radius, metres.
        self.curves: list[tuple[float, float, float]] = []
        total = 0.0
        for piece in pieces:
            self._starts.append(total)
            if piece.radius < math.inf:
                self.curves.append((total, total + piece.length, piece.radius))
            total += piece.length
        self.length = total  # metres
        # Where along it which waypoint is passed: pairs of metres and index, in order.
        self.marks = marks
        self.first, self.last = marks[0][1], marks[-1][1]

    @classmethod
    def straight(cls, start: LocalPlace, end: LocalPlace, first: int, last: int) -> RouteLeg:
        length = distance(start, end)
        return cls([_Line(start, _direction(start, end), length)], [(0.0, first), (length, last)])

    def at(self, s: float) -> OnLeg:
        s = max(0.0, min(self.length, s))
        index = max(0, bisect_right(self._starts, s) - 1)
        return self._pieces[index].at(s - self._starts[index])

    def nearest(self, place: LocalPlace, s: float) -> float:
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


def legs_between(places: list[LocalPlace], dampings: list[float] | None) -> list[RouteLeg]:
    """The legs of a route.

    A curve begins at most its damping before the waypoint, so that those of neighbours always fit
    when the two are together not longer than the leg: a turn of more than 90 degrees has a
    smaller radius than its damping.

    ``places``: the waypoints, two or more. ``dampings``: radius of the curve at each, for
    coordinated turns; at the first and the last it does not count, and 0 is a corner without a
    curve. None stops at every waypoint.
    """
    legs: list[RouteLeg] = []
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
                legs.append(RouteLeg(pieces, marks))
                pieces, marks, done = [], [(0.0, index)], 0.0
        else:
            pieces.append(curve)
            marks.append((done + curve.length / 2.0, index))
            done += curve.length
            at = curve.at(curve.length).place
    return legs


def _turn(before: LocalPlace, point: LocalPlace, after: LocalPlace) -> float:
    cosine = _direction(before, point).dot(_direction(point, after))
    return math.acos(max(-1.0, min(1.0, cosine)))


def _goes_on(places: list[LocalPlace], index: int) -> bool:
    """Whether the line goes straight on at a waypoint."""
    before, point, after = places[index - 1 : index + 2]
    return _turn(before, point, after) < _STRAIGHT


def _curve(before: LocalPlace, point: LocalPlace, after: LocalPlace, damping: float) -> _Arc | None:
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


# -- where missions may go: places on the map in metres, no-fly zones, limits around home ----------


_UNKNOWN_APP_HEIGHT, _UNKNOWN_APP_RADIUS = 30.0, 50.0


def is_on_earth(latitude: float, longitude: float) -> bool:
    """Whether there is such a place, in radians; nothing is where a number is not finite."""
    return abs(latitude) <= math.pi / 2.0 and abs(longitude) <= math.pi


class Site:
    """The map around the place where the aircraft was switched on."""

    def __init__(
        self,
        latitude_deg: float,
        longitude_deg: float,
        height_limit: float,  # nothing climbs beyond it, metres
        settings: MissionSettings,
    ) -> None:
        self._frame = LocalFrame(latitude_deg, longitude_deg)
        self._zones = [
            (*self._frame.to_local(zone.latitude_deg, zone.longitude_deg), zone.radius)
            for zone in settings.no_fly_zones
        ]
        self.farthest_start = settings.farthest_start  # how far away a mission may begin, metres
        limited = settings.never_logged_in
        # Limits of missions, metres.
        self.height_limit = min(height_limit, _UNKNOWN_APP_HEIGHT) if limited else height_limit
        radius = settings.radius_limit
        self.radius_limit = min(radius, _UNKNOWN_APP_RADIUS) if limited else radius

    def place(self, latitude: float, longitude: float, height: float) -> LocalPlace:
        """A place given in radians, as on the wire; one that :func:`is_on_earth`."""
        north, east = self._frame.to_local(math.degrees(latitude), math.degrees(longitude))
        return LocalPlace(north, east, height)

    def is_within_radius(self, place: LocalPlace, home: tuple[float, float] | None) -> bool:
        """Whether a place is within the radius limit around home."""
        north, east = home or (0.0, 0.0)
        return math.hypot(place.north - north, place.east - east) <= self.radius_limit

    def is_forbidden(self, start: LocalPlace, end: LocalPlace) -> bool:
        """Whether the straight way between two places, or the one place, enters a no-fly zone."""
        return any(
            _distance_to_line(start, end, north, east) < radius
            for north, east, radius in self._zones
        )


def _distance_to_line(start: LocalPlace, end: LocalPlace, north: float, east: float) -> float:
    along_n, along_e = end.north - start.north, end.east - start.east
    square = along_n * along_n + along_e * along_e
    share = 0.0
    if square > 0.0:
        share = ((north - start.north) * along_n + (east - start.east) * along_e) / square
        share = max(0.0, min(1.0, share))
    return math.hypot(start.north + share * along_n - north, start.east + share * along_e - east)


# -- how an aircraft is steered along a route ------------------------------------------------------


BRAKING = 1.8  # deceleration that missions plan with, m/s²
_NEARING = 0.8  # m/s per metre on the last metres before a stop
_SIDEWAYS = 1.0  # m/s per metre beside the line
_FASTEST_SIDEWAYS = 3.0
_CLIMB_SHARE = 0.85  # of the vertical speed that the airframe has, on a steep line
_SPEEDING_UP = 2.5  # m/s²
_LEAD_S = 0.2  # how long the attitude needs to follow


def stopping_speed(distance: float) -> float:
    """The speed from which the aircraft still stops within a distance."""
    distance = max(0.0, distance)
    return min(_NEARING * distance, math.sqrt(2.0 * BRAKING * distance))


def slowed(speed: float, left: float) -> tuple[float, float]:
    """A speed that still lets the aircraft stop, and the deceleration along with it.

    ``speed``: the wanted speed, m/s, not negative. ``left``: metres to where it has to stand.
    """
    stopping = stopping_speed(left)
    if stopping >= speed:
        return speed, 0.0
    return stopping, -min(BRAKING, _NEARING * stopping)


class Nose:
    """The heading that a mission asks for, in radians, turning no faster than it may.

    ``heading``: the heading asked for now.
    """

    def __init__(self, heading: float, rate_deg: float) -> None:
        self.heading = self._target = heading
        self._rate = math.radians(rate_deg)

    def turn_to(self, heading: float, turn_mode: int | None = None) -> None:
        """Turn to a heading, clockwise for turn mode 0, the other way for 1, else the short way."""
        turn = wrapped(heading - self.heading)
        if abs(turn) > 1e-3:
            if turn_mode == 0 and turn < 0.0:
                turn += 2.0 * math.pi
            elif turn_mode == 1 and turn > 0.0:
                turn -= 2.0 * math.pi
        self._target = self.heading + turn

    def look(self, heading: float) -> None:
        """Look there at once; the aircraft follows as fast as it turns."""
        self.heading = self._target = heading

    def step(self) -> float:
        """Turn on for one step; returns the heading to ask for."""
        turn = self._target - self.heading
        most = self._rate * STEP_S
        self.heading += max(-most, min(most, turn))
        return self.heading

    @property
    def has_turned(self) -> bool:
        """Whether it asks for its target already; the aircraft itself lags behind."""
        return self._target == self.heading


class MissionSteering:
    """Turns places, lines and speeds into guidance for the dynamics."""

    def __init__(self, motion: Dynamics, airframe: Airframe) -> None:
        self._motion = motion
        self._airframe = airframe

    @property
    def here(self) -> LocalPlace:
        motion = self._motion
        return LocalPlace(motion.north, motion.east, motion.height)

    def is_at(self, place: LocalPlace, within: float = 0.3) -> bool:
        motion = self._motion
        is_still = motion.speed < 0.3 and abs(motion.velocity_up) < 0.3
        return is_still and math.dist(self.here, place) < within

    def hold(self, place: LocalPlace, yaw_mode: ModelYaw, yaw: float) -> DynamicsInput:
        return DynamicsInput(
            ModelHorizontal.POSITION,
            place.north,
            place.east,
            vertical=ModelVertical.HEIGHT,
            up=place.up,
            yaw_mode=yaw_mode,
            yaw=yaw,
        )

    def steepest(self, tangent: LocalPlace) -> float:
        """The fastest speed along a direction that climbs and descends as the airframe can."""
        slope = abs(tangent.up)
        return _CLIMB_SHARE * self._airframe.vertical_speed / slope if slope > 1e-6 else math.inf

    def along(
        self, on: OnLeg, ahead: OnLeg, speed: float, gain: float, yaw_mode: ModelYaw, yaw: float
    ) -> DynamicsInput:
        """Fly along a line.

        ``on``: the place of the line beside the aircraft. ``ahead``: the one that it reaches while
        its attitude follows (:meth:`lead`). ``speed``: m/s along the line, negative backwards.
        ``gain``: m/s² of acceleration along the line that this asks for.
        """
        airframe, here = self._airframe, self.here
        beside = on.place.plus(here, -1.0)
        off = math.hypot(beside.north, beside.east)
        back = min(_SIDEWAYS, _FASTEST_SIDEWAYS / off) if off > 0.0 else 0.0
        # Velocity control asks for gain × the difference of velocity, so that an acceleration
        # which is known beforehand is asked for by a difference.
        lead = 1.0 / airframe.velocity_gain
        motion, tangent = self._motion, on.tangent
        present = LocalPlace(motion.velocity_north, motion.velocity_east, motion.velocity_up)
        # Nor more than it can do while it is kept on the line.
        reach, along = _SPEEDING_UP * lead, present.dot(tangent)
        wanted = tangent.scaled(max(along - reach, min(along + reach, speed + gain * lead)))
        # Climbing goes with the speed that there is: first the line, then the time.
        reach = _SPEEDING_UP * airframe.vertical_time_constant
        climb = tangent.up * max(along - reach, min(along + reach, speed))
        wanted = wanted.plus(ahead.bend, speed * speed * lead)
        return DynamicsInput(
            ModelHorizontal.VELOCITY,
            wanted.north + back * beside.north,
            wanted.east + back * beside.east,
            vertical=ModelVertical.VELOCITY,
            up=climb + airframe.height_gain * beside.up,
            yaw_mode=yaw_mode,
            yaw=yaw,
            steep=True,
        )

    @staticmethod
    def lead(speed: float) -> float:
        """How far ahead of the aircraft the line is looked at, metres."""
        return speed * _LEAD_S
