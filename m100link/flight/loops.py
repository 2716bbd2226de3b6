"""Closed loops: fly to a place or along a path, climb, turn, orbit.

The autopilot's position mode takes offsets from where the aircraft is, so the loop measures what
remains and sends that anew at each tick (document 3.2, "offset"; DJI's own samples do the same).
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from m100link.errors import UsageError
from m100link.flight.guards import MAX_COMMAND_M_S, GuardKeeper, known
from m100link.flight.guidance import (
    Arrival,
    Call,
    Guidance,
    GuidanceProgress,
    Progress,
    heading_of,
    position_of,
)
from m100link.flight.path import LAG_S, Path
from m100link.geodesy import LocalFrame, normalize_degrees
from m100link.protocol.records import Attitude, Position, Velocity
from m100link.protocol.setpoint import Setpoint
from m100link.telemetry.state import STEER_S

if TYPE_CHECKING:
    from m100link.telemetry.state import AircraftState


# -- where to steer on a circle: from place and velocity to the next velocity. No I/O, no clock ----


_GRAVITY = 9.80665
_MAX_TILT_DEG = 20.0  # that the circle may take: the rest of the tilt is for wind and drag
_MAX_TURN_RAD_S = 0.7  # behind faster turns the velocity would lag by half a radian
_ACCELERATION = 0.8  # m/s² along the circle
_BRAKING = 0.5  # m/s along the circle for each metre that remains
_CREEP_M_S = 0.2  # until the end
_RADIAL_GAIN = 1.2  # m/s inwards per metre outside the circle
_RADIAL_DAMPING = 0.5
_FACING_DEG = 5.0  # it begins to move when it looks at the centre: tilt lags behind a fast turn


@dataclass(frozen=True, slots=True)
class LoopOutput:
    """The velocity and heading to fly now."""

    north: float  # velocity, m/s
    east: float  # velocity, m/s
    yaw_deg: float  # heading, towards the centre
    off_m: float  # distance from the circle
    to_go_deg: float


class Orbit:
    """A circle that begins and ends at rest, flown by velocity setpoints.

    ``turns``: how many, more than 0. Raises ``UsageError``: it cannot be flown: with the tilt or
    the turn rate that it needs.
    """

    def __init__(
        self, *, radius: float, speed: float, turns: float, clockwise: bool, max_speed: float
    ) -> None:
        if not 1.0 <= radius < math.inf or not 0 < speed <= 10 or not 0 < turns < math.inf:
            raise UsageError(
                f"{turns:g} turns of {radius:.1f} m radius at {speed:g} m/s cannot be flown",
                remedy="radius 1 m or more, speed up to 10 m/s, turns more than 0",
            )
        self._check_airframe(radius, speed)
        self._radius = radius  # metres, 1 or more
        self._speed = speed  # along the circle, m/s, up to 10
        self._sense = 1.0 if clockwise else -1.0
        self._max_speed = max_speed  # of the velocity that is asked for, m/s
        self._to_go_deg = 360.0 * turns
        self._bearing: float | None = None  # from the centre, at the tick before
        self._along = 0.0  # speed along the circle that was asked for at the tick before
        self._is_moving = False

    @staticmethod
    def _check_airframe(radius: float, speed: float) -> None:
        centripetal = speed * speed / radius
        tilt = math.degrees(math.atan(centripetal / _GRAVITY))
        limit = math.tan(math.radians(_MAX_TILT_DEG)) * _GRAVITY
        slowest = min(math.sqrt(limit * radius), _MAX_TURN_RAD_S * radius)
        widest = max(speed * speed / limit, speed / _MAX_TURN_RAD_S)
        what = f"a circle of {radius:.1f} m radius at {speed:g} m/s cannot be flown"
        remedy = f"at most {slowest:.1f} m/s on this radius, or at least {widest:.1f} m of radius"
        if tilt > _MAX_TILT_DEG:
            raise UsageError(
                f"{what}: v²/r is {centripetal:.1f} m/s², a tilt of {tilt:.0f}°, and "
                f"{_MAX_TILT_DEG:g}° are left for it",
                remedy=remedy,
            )
        if speed / radius > _MAX_TURN_RAD_S:
            raise UsageError(
                f"{what}: it turns by {math.degrees(speed / radius):.0f}°/s, and the velocity of "
                f"the aircraft follows up to {math.degrees(_MAX_TURN_RAD_S):.0f}°/s",
                remedy=remedy,
            )

    def steer(
        self,
        place: tuple[float, float],  # metres north and east of the centre
        velocity: tuple[float, float] | None,  # north and east, m/s; None when it is unknown
        heading_deg: float | None,  # of the nose; None when it is unknown
        elapsed: float,  # seconds since the call before
    ) -> LoopOutput:
        """The next velocity."""
        bearing = math.degrees(math.atan2(place[1], place[0]))
        if self._bearing is not None:
            self._to_go_deg -= self._sense * normalize_degrees(bearing - self._bearing)
        self._bearing = bearing
        yaw_deg = math.degrees(math.atan2(-place[1], -place[0]))
        if heading_deg is None or abs(normalize_degrees(yaw_deg - heading_deg)) < _FACING_DEG:
            self._is_moving = True
        distance = math.hypot(*place) or 1e-6
        out = place[0] / distance, place[1] / distance
        ahead = -out[1] * self._sense, out[0] * self._sense
        along, inward = self._velocity(distance, out, ahead, velocity, elapsed)
        return LoopOutput(
            north=ahead[0] * along - out[0] * inward,
            east=ahead[1] * along - out[1] * inward,
            yaw_deg=yaw_deg,
            off_m=abs(distance - self._radius),
            to_go_deg=self._to_go_deg,
        )

    def _velocity(
        self,
        distance: float,
        out: tuple[float, float],
        ahead: tuple[float, float],
        velocity: tuple[float, float] | None,
        elapsed: float,
    ) -> tuple[float, float]:
        """The setpoint's velocity along the circle and inwards, m/s."""
        before, self._along = self._along, self._wanted_speed(elapsed)
        gain = max(-1.5, (self._along - before) / elapsed) if elapsed > 0 else 0.0
        if velocity is None:
            running, leaving = self._along, 0.0
        else:
            running = velocity[0] * ahead[0] + velocity[1] * ahead[1]
            leaving = velocity[0] * out[0] + velocity[1] * out[1]
        # The velocity lags behind the setpoint: tangents would lead out of the circle. So inwards
        # by lag times centripetal acceleration; distance and drift outwards correct the rest.
        inward = (
            LAG_S * running * running / distance
            + _RADIAL_GAIN * (distance - self._radius)
            + _RADIAL_DAMPING * leaving
        )
        # Faster by the lag while it accelerates, and slower by it while it drifts outwards.
        along = self._along + LAG_S * (gain - running * leaving / distance)
        # Where both are too much, keeping to the circle comes before being fast.
        limit = self._max_speed
        inward = max(-0.8 * limit, min(0.8 * limit, inward))
        # A hair below: rounded up, both together would be beyond the limit, and no setpoint.
        fastest = math.sqrt(limit * limit - inward * inward) * (1 - 1e-6)
        return max(-fastest, min(fastest, along)), inward

    def _wanted_speed(self, elapsed: float) -> float:
        """Speed along the circle: gently up from rest, down over the last degrees."""
        arc = math.radians(self._to_go_deg) * self._radius
        if not self._is_moving or arc <= 0:
            return 0.0
        braking = _CREEP_M_S + _BRAKING * arc
        return min(self._speed, braking, self._along + _ACCELERATION * elapsed)


# -- loops -----------------------------------------------------------------------------------------

_MAX_OFFSET_M = 10.0  # the autopilot flies larger offsets no faster; a wrong fix must not matter
BRAKING_PER_S = 0.5  # speed towards a place, m/s, for each metre that remains
_BEGINS_WITHIN_M = 0.5  # of the first point of an orbit: nearer needs no flight to it

Place = tuple[float, float, float]  # latitude and longitude, °, and height above take-off, m


class ClosedLoops:
    """Flights that measure and correct, over whatever takes setpoints."""

    def __init__(self, state: AircraftState, guards: GuardKeeper, guidance: Guidance) -> None:
        self._state = state
        # Asked for the target before the first setpoint; each setpoint is checked besides.
        self._guards = guards
        self._guidance = guidance

    def local_frame(self) -> LocalFrame:
        """See :meth:`m100link.Control.local_frame`."""
        here = position_of(self._state)
        return LocalFrame(here.latitude_deg, here.longitude_deg)

    async def fly_to(
        self,
        *,
        north: float | None = None,
        east: float | None = None,
        up: float | None = None,
        latitude_deg: float | None = None,
        longitude_deg: float | None = None,
        height: float | None = None,
        frame: LocalFrame | None = None,
        yaw_deg: float | None = None,
        speed: float | None = None,
        tolerance_m: float = 0.5,
        timeout: float = 120.0,
        progress: Progress | None = None,
    ) -> Arrival:
        """Fly to an offset from here, or to a place, and hover there.

        Args:
            north: With ``east``: metres from where the aircraft is now, or in ``frame``.
            east: See ``north``.
            up: Metres from the present height; or ``height``.
            latitude_deg: With ``longitude_deg``, instead of the offset: a place, WGS 84.
            longitude_deg: See ``latitude_deg``.
            height: Metres above the take-off point.
            frame: Where ``north`` and ``east`` count from; see ``Control.local_frame()``.
            yaw_deg: Heading to fly with; by default the present one.
            speed: Horizontally, at most, m/s up to 10; by default as the autopilot flies.
            tolerance_m: Distance and height error that count as arrived.
            timeout: Seconds until it gives up, hovering.
            progress: Called at each tick.

        Raises:
            NotObserved: It did not arrive in time and hovers where it is, or it was stopped or
                landed.
            SetpointsIgnored: For 6 s nothing moved, and it hovers.
            TelemetryStalled: Position or attitude do not arrive.
            GuardRefused: The target lies outside the envelope, or as :meth:`Control.send`.
            UsageError: The target is none, the aircraft stands on the ground, or another closed
                loop is flying.
            NoAuthority: See :meth:`Control.send`.
        """
        call = await self._guidance.prepare("fly_to")
        self._guards.check_round_trip("fly_to")
        here = position_of(self._state)
        place = _place(here, (north, east), frame, (latitude_deg, longitude_deg))
        target = (*place, _target_height(here, up, height))
        self._guards.check_target("fly_to", target[:2], height=target[2], speed=speed or 0.0)
        return await self._fly_straight(
            call,
            target,
            yaw_deg=yaw_deg,
            speed=None if speed is None else check_speed(speed),
            tolerance_m=tolerance_m,
            timeout=timeout,
            progress=progress,
        )

    async def _fly_straight(
        self,
        call: Call,
        target: Place,
        *,
        yaw_deg: float | None,
        speed: float | None,
        tolerance_m: float,
        timeout: float,
        progress: Progress | None,
    ) -> Arrival:
        latitude, longitude, height = target
        there = LocalFrame(latitude, longitude)
        heading = heading_of(self._state) if yaw_deg is None else yaw_deg

        def step() -> tuple[Setpoint, GuidanceProgress]:
            here = position_of(self._state)
            from_north, from_east = there.to_local(here.latitude_deg, here.longitude_deg)
            distance = math.hypot(from_north, from_east)
            setpoint = _towards((-from_north, -from_east), distance, height, heading, speed)
            turn = (
                normalize_degrees(heading - heading_of(self._state)) if yaw_deg is not None else 0.0
            )
            return setpoint, GuidanceProgress(0.0, distance, height - here.height_m, turn)

        def is_within(found: GuidanceProgress) -> bool:
            return (
                found.distance_m <= tolerance_m
                and abs(found.height_error_m) <= tolerance_m
                and abs(found.heading_error_deg) <= 5.0
            )

        return await self._guidance.run(call, step, is_within, timeout, progress)

    async def fly_path(
        self,
        points: Sequence[tuple[float, float, float]],
        *,
        speed: float,
        corner_radius: float = 2.0,
        frame: LocalFrame | None = None,
        face_ahead: bool = False,
        yaw_deg: float | None = None,
        tolerance_m: float = 0.5,
        timeout: float | None = None,
        progress: Progress | None = None,
    ) -> Arrival:
        """Fly through points without stopping at each, and hover at the last one.

        It begins where the aircraft is, and slows down before corners, steep legs and the end.

        Args:
            points: North and east, m, and height above take-off, m, of each.
            speed: On straight legs, m/s, up to 10.
            corner_radius: Corners of 90° and more are rounded by it, m, shallower ones by more, as
                far from the corner; smaller where a leg is too short. 0: each is flown to.
            frame: Where ``north`` and ``east`` count from; by default where the aircraft is now.
            face_ahead: Look along the path.
            yaw_deg: Otherwise, the heading to fly with; by default the present one.
            tolerance_m: Distance and height error that count as arrived.
            timeout: Seconds until it gives up, hovering; by default 60 and three times what the
                path takes at its speed.
            progress: Called at each tick; the distance is what remains of the path.

        Raises: as :meth:`fly_to`. A point outside the envelope, or one that cannot be flown to, is
        named, and nothing is sent.
        """
        call = await self._guidance.prepare("fly_path")
        self._guards.check_round_trip("fly_path")
        here = position_of(self._state)
        frame = frame or LocalFrame(here.latitude_deg, here.longitude_deg)
        start = frame.to_local(here.latitude_deg, here.longitude_deg)
        # The barometer drifts with the weather (errata 45): low down it may say less than 0 m.
        path = Path(
            [(*start, max(0.0, here.height_m)), *points],
            speed=check_speed(speed),
            corner_radius=corner_radius,
            max_speed=self._guards.fastest_m_s,
        )
        for index, (north, east, height) in enumerate(points):
            place = frame.to_geodetic(north, east)
            name = f"point {index} of fly_path"
            self._guards.check_target(name, place, height=height, speed=speed)
        heading = heading_of(self._state) if yaw_deg is None else yaw_deg
        if timeout is None:
            timeout = 60.0 + 3 * path.length / speed
        clock = asyncio.get_running_loop().time
        before = clock()
        last_height = points[-1][2]

        def step() -> tuple[Setpoint, GuidanceProgress]:
            nonlocal before
            here = position_of(self._state)
            now = clock()
            place = frame.to_local(here.latitude_deg, here.longitude_deg)
            steering = path.steer((*place, here.height_m), _velocity(self._state), now - before)
            before = now
            setpoint = Setpoint.velocity(
                north=steering.north,
                east=steering.east,
                height=steering.height,
                yaw_deg=steering.ahead_deg if face_ahead else heading,
            )
            to_go = math.hypot(steering.to_go_m, steering.off_m)
            return setpoint, GuidanceProgress(0.0, to_go, last_height - here.height_m, 0.0)

        def is_within(found: GuidanceProgress) -> bool:
            return found.distance_m <= tolerance_m and abs(found.height_error_m) <= tolerance_m

        return await self._guidance.run(call, step, is_within, timeout, progress)

    async def climb_to(
        self,
        height: float,
        *,
        tolerance_m: float = 0.3,
        timeout: float = 60.0,
        progress: Progress | None = None,
    ) -> Arrival:
        """Climb or descend in place to a height above the take-off point, m.

        Raises: as :meth:`fly_to`.
        """
        call = await self._guidance.prepare("climb_to")
        self._guards.check_target("climb_to", height=check_height(height))

        def step() -> tuple[Setpoint, GuidanceProgress]:
            here = position_of(self._state)
            setpoint = Setpoint.velocity(north=0.0, east=0.0, height=height, yaw_rate_deg_s=0.0)
            return setpoint, GuidanceProgress(0.0, 0.0, height - here.height_m, 0.0)

        return await self._guidance.run(
            call, step, lambda found: abs(found.height_error_m) <= tolerance_m, timeout, progress
        )

    async def turn_to(
        self,
        yaw_deg: float,
        *,
        tolerance_deg: float = 2.0,
        timeout: float = 30.0,
        progress: Progress | None = None,
    ) -> Arrival:
        """Turn in place to a heading, −180 to 180°, 0 north, 90 east.

        Raises: as :meth:`fly_to`.
        """
        # Without prepare(), which waits for a position: a turn needs none.
        call = self._guidance.admit("turn_to")
        setpoint = Setpoint.velocity(north=0.0, east=0.0, up=0.0, yaw_deg=yaw_deg)

        def step() -> tuple[Setpoint, GuidanceProgress]:
            turn = normalize_degrees(yaw_deg - heading_of(self._state))
            return setpoint, GuidanceProgress(0.0, 0.0, 0.0, turn)

        return await self._guidance.run(
            call, step, lambda it: abs(it.heading_error_deg) <= tolerance_deg, timeout, progress
        )

    async def orbit(
        self,
        *,
        center_north: float,
        center_east: float,
        frame: LocalFrame | None = None,
        radius: float | None = None,
        height: float | None = None,
        start_deg: float | None = None,
        speed: float = 2.0,
        turns: float = 1.0,
        clockwise: bool = True,
        timeout: float = 300.0,
        progress: Progress | None = None,
        approach: Progress | None = None,
    ) -> Arrival:
        """Fly a circle around a point, looking at it.

        By default the circle goes through where the aircraft is now; otherwise it flies to where
        the circle begins. It turns to the centre first, then accelerates along the circle.

        Args:
            center_north: Metres to the centre, north, from here or in ``frame``.
            center_east: Metres to the centre, east, from here or in ``frame``.
            frame: Where the centre counts from; see ``Control.local_frame()``.
            radius: Of the circle, m, 1 or more; by default the present distance from the centre.
            height: Above the take-off point, m; by default the present one.
            start_deg: Where the circle begins, seen from the centre, ° clockwise from north; by
                default in the present direction.
            speed: Along the circle, up to 10 m/s; at most 0.7/s times the radius, and v²/r at most
                3.6 m/s², a tilt of 20°.
            turns: How many, more than 0.
            clockwise: Seen from above.
            timeout: Seconds until it gives up, hovering; for the flight to its beginning as well.
            progress: Called at each tick on the circle.
            approach: Called at each tick on the way to it, with what remains of that.

        Raises: as :meth:`fly_to`.
        """
        call = await self._guidance.prepare("orbit")
        self._guards.check_round_trip("orbit")
        here = position_of(self._state)
        if frame is None:
            frame = LocalFrame(here.latitude_deg, here.longitude_deg)
            north, east = -center_north, -center_east
        else:
            north, east = frame.to_local(here.latitude_deg, here.longitude_deg)
            north, east = north - center_north, east - center_east
        center = LocalFrame(*frame.to_geodetic(center_north, center_east))
        radius = math.hypot(north, east) if radius is None else radius
        bearing = math.atan2(east, north) if start_deg is None else math.radians(start_deg)
        height = here.height_m if height is None else height
        orbit = Orbit(
            radius=radius,
            speed=speed,
            turns=turns,
            clockwise=clockwise,
            max_speed=self._guards.fastest_m_s,
        )
        place = center.latitude_deg, center.longitude_deg
        self._guards.check_target("orbit", place, height=height, radius=radius, speed=speed)
        first = radius * math.cos(bearing), radius * math.sin(bearing)
        is_there = math.dist(first, (north, east)) < _BEGINS_WITHIN_M
        if not is_there or abs(height - here.height_m) > _BEGINS_WITHIN_M:
            await self._fly_straight(
                call,
                (*center.to_geodetic(*first), height),
                yaw_deg=math.degrees(math.atan2(-first[1], -first[0])),
                speed=None,
                tolerance_m=_BEGINS_WITHIN_M,
                timeout=timeout,
                progress=approach,
            )
            # Between the two flights another loop may have begun, or the aircraft have landed.
            self._guidance.admit("orbit")
        return await self._fly_around(call, orbit, center, height, timeout, progress)

    async def _fly_around(
        self,
        call: Call,
        orbit: Orbit,
        center: LocalFrame,
        height: float,
        timeout: float,
        progress: Progress | None,
    ) -> Arrival:
        clock = asyncio.get_running_loop().time
        before = clock()

        def step() -> tuple[Setpoint, GuidanceProgress]:
            nonlocal before
            here = position_of(self._state)
            attitude = known(self._state, Attitude, within=STEER_S)
            now = clock()
            steering = orbit.steer(
                center.to_local(here.latitude_deg, here.longitude_deg),
                _velocity(self._state),
                None if attitude is None else attitude.yaw_deg,
                now - before,
            )
            before = now
            setpoint = Setpoint.velocity(
                north=steering.north, east=steering.east, height=height, yaw_deg=steering.yaw_deg
            )
            return setpoint, GuidanceProgress(
                0.0, steering.off_m, height - here.height_m, steering.to_go_deg
            )

        def is_within(found: GuidanceProgress) -> bool:
            return found.heading_error_deg <= 2.0

        return await self._guidance.run(call, step, is_within, timeout, progress)


def _velocity(state: AircraftState) -> tuple[float, float] | None:
    velocity = known(state, Velocity, within=STEER_S)
    return None if velocity is None else (velocity.north_m_s, velocity.east_m_s)


def _towards(
    remaining: tuple[float, float],
    distance: float,
    height: float,
    heading: float,
    speed: float | None,
) -> Setpoint:
    """The setpoint towards a place: offsets at the autopilot's speed, or velocity up to one."""
    if speed is None:
        scale = _MAX_OFFSET_M / max(distance, _MAX_OFFSET_M)
        north, east = remaining[0] * scale, remaining[1] * scale
        return Setpoint.position_offset(north=north, east=east, height=height, yaw_deg=heading)
    scale = min(BRAKING_PER_S, speed / distance) if distance else 0.0
    # Rounded up, 10 m/s due north would be more than a setpoint takes.
    north, east = (max(-speed, min(speed, offset * scale)) for offset in remaining)
    return Setpoint.velocity(north=north, east=east, height=height, yaw_deg=heading)


def _place(
    here: Position,
    offset: tuple[float | None, float | None],
    frame: LocalFrame | None,
    place: tuple[float | None, float | None],
) -> tuple[float, float]:
    """Latitude and longitude of the target, from either way of giving it."""
    north, east = offset
    latitude_deg, longitude_deg = place
    if north is not None and east is not None and place == (None, None):
        if not math.isfinite(north) or not math.isfinite(east):
            raise UsageError(f"{north:g} m north, {east:g} m east cannot be flown to")
        frame = frame or LocalFrame(here.latitude_deg, here.longitude_deg)
        return frame.to_geodetic(north, east)
    is_place = latitude_deg is not None and longitude_deg is not None
    if not is_place or offset != (None, None) or frame is not None:
        raise UsageError(
            "the target is given neither as an offset nor as a place",
            remedy="give north and east (with a frame, or from here), or latitude_deg and "
            "longitude_deg; and up, or height",
        )
    assert latitude_deg is not None
    assert longitude_deg is not None
    if not (abs(latitude_deg) <= 89 and abs(longitude_deg) <= 360):
        raise UsageError(
            f"{latitude_deg:g}° {longitude_deg:g}° cannot be flown to",
            remedy="latitude within ±89°, longitude within ±360°",
        )
    return latitude_deg, longitude_deg


def _target_height(here: Position, up: float | None, height: float | None) -> float:
    """Height of the target above take-off, from either way of giving it."""
    if (up is None) == (height is None):
        raise UsageError(
            "the height of the target is given neither from here nor above take-off",
            remedy="give up, or height",
        )
    target = here.height_m + up if up is not None else height
    assert target is not None
    return check_height(target)


def check_height(height: float) -> float:
    """A height above take-off, m, or ``UsageError``: it cannot be flown to."""
    if not math.isfinite(height) or height < 0:
        raise UsageError(
            f"a height of {height:g} m cannot be flown to",
            remedy="a finite number, 0 m or more above take-off",
        )
    return height


def check_speed(speed: float) -> float:
    """A speed, m/s, or ``UsageError``: it cannot be flown."""
    if not 0 < speed <= MAX_COMMAND_M_S:
        raise UsageError(f"{speed:g} m/s cannot be flown", remedy=f"0 to {MAX_COMMAND_M_S:g} m/s")
    return speed
