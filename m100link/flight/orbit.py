"""Where to steer on a circle: from place and velocity to the next velocity. No I/O, no clock."""

from __future__ import annotations

import math
from dataclasses import dataclass

from m100link.errors import UsageError
from m100link.geodesy import normalize_degrees

__all__ = ["Orbit", "Steering"]

_GRAVITY = 9.80665
_MAX_TILT_DEG = 20.0
"""Tilt that the circle may take; what velocity control has beyond it is for wind and drag."""
_MAX_TURN_RAD_S = 0.7
"""Faster turns than the velocity of the aircraft can follow: its lag would be half a radian."""
_LAG_S = 0.65
"""By how much the velocity follows what is asked for; of the model of the virtual aircraft."""
_ACCELERATION = 0.8  # m/s² along the circle
_BRAKING = 0.5  # m/s along the circle for each metre that remains
_CREEP_M_S = 0.2  # until the end
_RADIAL_GAIN = 1.2  # m/s inwards per metre outside the circle
_RADIAL_DAMPING = 0.5
_FACING_DEG = 5.0  # it begins to move when it looks at the centre: tilt lags behind a fast turn


@dataclass(frozen=True, slots=True)
class Steering:
    """What to fly now.

    Attributes:
        north: Velocity, m/s.
        east: Velocity, m/s.
        yaw_deg: Heading, towards the centre.
        off_m: Distance from the circle.
        to_go_deg: Angle that remains.
    """

    north: float
    east: float
    yaw_deg: float
    off_m: float
    to_go_deg: float


class Orbit:
    """A circle that begins and ends at rest, flown by velocity setpoints.

    The velocity of the aircraft lags behind what it is told. Told to fly along the circle, it would
    fly tangentially out of it. So it is told what makes it fly along the circle: turned inwards by
    lag times centripetal acceleration, a little faster while it accelerates. What remains is
    corrected by the distance from the circle.

    Args:
        radius: Metres, 1 or more.
        speed: Along the circle, m/s, up to 10.
        turns: How many, more than 0.
        clockwise: Seen from above.
        max_speed: Of the velocity that is asked for, m/s.

    Raises:
        UsageError: It cannot be flown: with the tilt or the turn rate that it needs.
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
        self._radius = radius
        self._speed = speed
        self._sense = 1.0 if clockwise else -1.0
        self._max_speed = max_speed
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
        place: tuple[float, float],
        velocity: tuple[float, float] | None,
        heading_deg: float | None,
        elapsed: float,
    ) -> Steering:
        """The next velocity.

        Args:
            place: Metres north and east of the centre.
            velocity: North and east, m/s; None when it is unknown.
            heading_deg: Of the nose; None when it is unknown.
            elapsed: Seconds since the call before.
        """
        bearing = math.degrees(math.atan2(place[1], place[0]))
        if self._bearing is not None:
            self._to_go_deg -= self._sense * normalize_degrees(bearing - self._bearing)
        self._bearing = bearing
        yaw_deg = normalize_degrees(bearing + 180.0)
        if heading_deg is None or abs(normalize_degrees(yaw_deg - heading_deg)) < _FACING_DEG:
            self._is_moving = True
        distance = math.hypot(*place) or 1e-6
        out = place[0] / distance, place[1] / distance
        ahead = -out[1] * self._sense, out[0] * self._sense
        along, inward = self._velocity(distance, out, ahead, velocity, elapsed)
        return Steering(
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
        """What to ask for along the circle and inwards, m/s."""
        before, self._along = self._along, self._wanted_speed(elapsed)
        gain = max(-1.5, (self._along - before) / elapsed) if elapsed > 0 else 0.0
        if velocity is None:
            running, leaving = self._along, 0.0
        else:
            running = velocity[0] * ahead[0] + velocity[1] * ahead[1]
            leaving = velocity[0] * out[0] + velocity[1] * out[1]
        inward = (
            _LAG_S * running * running / distance
            + _RADIAL_GAIN * (distance - self._radius)
            + _RADIAL_DAMPING * leaving
        )
        along = self._along + _LAG_S * (gain - running * leaving / distance)
        # Where both are too much, keeping to the circle comes before being fast.
        limit = self._max_speed
        inward = max(-0.8 * limit, min(0.8 * limit, inward))
        fastest = math.sqrt(limit * limit - inward * inward) * (1 - 1e-6)
        return max(-fastest, min(fastest, along)), inward

    def _wanted_speed(self, elapsed: float) -> float:
        """Speed along the circle: gently up from rest, down over the last degrees."""
        arc = math.radians(self._to_go_deg) * self._radius
        if not self._is_moving or arc <= 0:
            return 0.0
        braking = _CREEP_M_S + _BRAKING * arc
        return min(self._speed, braking, self._along + _ACCELERATION * elapsed)
