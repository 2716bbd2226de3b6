"""How a mission steers: a nose that turns at a limited rate, and speeds that end in a stop."""

from __future__ import annotations

import math

from m100link.sim.vehicle.dynamics import (
    STEP_S,
    Airframe,
    Dynamics,
    DynamicsInput,
    ModelHorizontal,
    ModelVertical,
    ModelYaw,
)
from m100link.sim.vehicle.missions.route import LocalPlace, OnLeg

BRAKING = 1.8  # deceleration that missions plan with, m/s²
_NEARING = 0.8  # m/s per metre on the last metres before a stop
_SIDEWAYS = 1.0  # m/s per metre beside the line
_FASTEST_SIDEWAYS = 3.0
_CLIMB_SHARE = 0.85  # of the vertical speed that the airframe has, on a steep line
_SPEEDING_UP = 2.5  # m/s²
_LEAD_S = 0.2  # how long the attitude needs to follow


def wrapped(angle: float) -> float:
    """The same direction in -pi to pi."""
    return math.remainder(angle, 2.0 * math.pi)


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
        """Where the aircraft is."""
        motion = self._motion
        return LocalPlace(motion.north, motion.east, motion.height)

    def is_at(self, place: LocalPlace, within: float = 0.3) -> bool:
        """Whether the aircraft stands still at a place."""
        motion = self._motion
        is_still = motion.speed < 0.3 and abs(motion.velocity_up) < 0.3
        return is_still and math.dist(self.here, place) < within

    def hold(self, place: LocalPlace, yaw_mode: ModelYaw, yaw: float) -> DynamicsInput:
        """Stay at a place, or go there straight."""
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
