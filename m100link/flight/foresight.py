"""Time and battery that a closed loop would take, and its refusals, before it is asked for.

Nothing here flies, waits or sends. The times are those of the loops' own laws (the speed falls with
the distance that remains) and of an aircraft that climbs at :data:`CLIMB_M_S` and turns at
:data:`TURN_DEG_S`; the virtual aircraft's flights take as long within 20 %. Nothing of it is
measured on an aircraft. The battery lasts as long as that of a plan's estimate.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from m100link.errors import M100Error, UsageError
from m100link.flight.guards import GuardKeeper, known
from m100link.flight.guidance import heading_of, position_of, require_in_the_air
from m100link.flight.loops import BRAKING_PER_S, Orbit, check_height, check_speed
from m100link.geodesy import LocalFrame, normalize_degrees
from m100link.missions.checks import HOVER_MINUTES
from m100link.protocol.records import Attitude, Position
from m100link.protocol.setpoint import Setpoint

if TYPE_CHECKING:
    from m100link.telemetry.state import AircraftState


CLIMB_M_S = 3.0
TURN_DEG_S = 90.0
ARRIVED_M = 0.5
APPROACH_M_S = 3.0  # of the autopilot to where a circle begins: users report about this value
SETTLE_S = 1.5  # what stopping, and being seen to have stopped, adds to a flight

# The guards of battery and GPS refuse even this where they refuse the setpoints of a loop.
_STAND = Setpoint.velocity(north=0.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


@dataclass(frozen=True, slots=True)
class Foresight:
    """A forecast of a closed loop that begins where the aircraft is."""

    #: Of the way, horizontally; 0 while nobody knows where the aircraft is.
    distance_m: float = 0.0
    climb_m: float = 0.0  #: Positive upwards.
    turn_deg: float = 0.0  #: −180 to 180, positive clockwise.
    seconds: float = 0.0  #: How long it takes, roughly.
    battery_percent: float = 0.0  #: The share of a full battery, roughly.
    #: Errors that would refuse it now, with reason and remedy; empty if it may fly.
    refusals: tuple[M100Error, ...] = ()


# -- times ----------------------------------------------------------------------------------------


def seconds_straight(distance: float, speed: float) -> float:
    """Of a way at a speed that falls with the distance that remains, s."""
    braking_from = speed / BRAKING_PER_S
    fast = max(0.0, distance - braking_from) / speed
    slow = min(distance, braking_from)
    return fast + (math.log(slow / ARRIVED_M) / BRAKING_PER_S if slow > ARRIVED_M else 0.0)


def seconds_climbing(climb: float) -> float:
    """Of a change of height, m, s."""
    return abs(climb) / CLIMB_M_S


def seconds_turning(turn: float) -> float:
    """Of a turn, °, s."""
    return abs(turn) / TURN_DEG_S


def seconds_around(radius: float, speed: float, turns: float) -> float:
    """Of a way along a circle, s."""
    return math.tau * radius * turns / speed


# -- flights --------------------------------------------------------------------------------------


def foresee_flight(
    state: AircraftState,
    guards: GuardKeeper,
    *,
    latitude_deg: float,
    longitude_deg: float,
    height: float,
    speed: float,
    yaw_deg: float | None = None,
) -> Foresight:
    """Of :meth:`m100link.Control.fly_to`, to a place."""
    place = latitude_deg, longitude_deg
    refusals = _refusals(
        *_always(state, guards, "fly_to"),
        lambda: guards.check_round_trip("fly_to"),
        lambda: heading_of(state) if yaw_deg is None else None,
        lambda: frame_at(*place),
        lambda: check_speed(speed),
        lambda: check_height(height),
        lambda: guards.check_target("fly_to", place, height=height, speed=speed),
    )
    distance, climb = _way(state, place, height)
    turn = 0.0 if yaw_deg is None else _turn(state, yaw_deg)
    flying = seconds_straight(distance, speed) if speed > 0 else 0.0
    seconds = max(flying, seconds_climbing(climb), seconds_turning(turn))
    return _foresight(distance, climb, turn, seconds, refusals)


def foresee_orbit(
    state: AircraftState,
    guards: GuardKeeper,
    *,
    latitude_deg: float,
    longitude_deg: float,
    height: float,
    radius: float,
    speed: float,
    turns: float,
) -> Foresight:
    """Of :meth:`m100link.Control.orbit`, around a place, with the way to the circle."""
    place = latitude_deg, longitude_deg

    def circle() -> Orbit:
        fastest = guards.fastest_m_s
        return Orbit(radius=radius, speed=speed, turns=turns, clockwise=True, max_speed=fastest)

    refusals = _refusals(
        *_always(state, guards, "orbit"),
        lambda: guards.check_round_trip("orbit"),
        lambda: frame_at(*place),
        circle,
        lambda: check_height(height),
        lambda: guards.check_target("orbit", place, height=height, radius=radius, speed=speed),
    )
    to_centre, climb = _way(state, place, height)
    approach = abs(to_centre - radius)
    around = seconds_around(radius, speed, turns) if speed > 0 else 0.0
    seconds = max(seconds_straight(approach, APPROACH_M_S), seconds_climbing(climb)) + around
    distance = approach + math.tau * max(0.0, radius * turns)
    return _foresight(distance, climb, 0.0, seconds, refusals)


def foresee_climb(state: AircraftState, guards: GuardKeeper, height: float) -> Foresight:
    """Of :meth:`m100link.Control.climb_to`."""
    refusals = _refusals(
        *_always(state, guards, "climb_to"),
        lambda: check_height(height),
        lambda: guards.check_target("climb_to", height=height),
    )
    _, climb = _way(state, None, height)
    return _foresight(0.0, climb, 0.0, seconds_climbing(climb), refusals)


def foresee_turn(state: AircraftState, guards: GuardKeeper, yaw_deg: float) -> Foresight:
    """Of :meth:`m100link.Control.turn_to`."""
    refusals = _refusals(*_always(state, guards, "turn_to"), lambda: heading_of(state))
    turn = _turn(state, yaw_deg)
    return _foresight(0.0, 0.0, turn, seconds_turning(turn), refusals)


def frame_at(latitude_deg: float, longitude_deg: float) -> LocalFrame:
    """Metres north and east of a place; ``UsageError`` where nothing can be flown to."""
    try:
        return LocalFrame(latitude_deg, longitude_deg)
    except ValueError as error:
        raise UsageError(
            f"{latitude_deg:g}° {longitude_deg:g}° cannot be flown to: {error}"
        ) from None


def _always(
    state: AircraftState, guards: GuardKeeper, name: str
) -> tuple[Callable[[], object], ...]:
    """The conditions of every loop: in the air, a known position, battery and GPS."""
    return (
        lambda: require_in_the_air(state, name),
        lambda: position_of(state),
        lambda: guards.check(_STAND),
    )


def _refusals(*checks: Callable[[], object]) -> tuple[M100Error, ...]:
    found = []
    for check in checks:
        try:
            check()
        except M100Error as error:
            found.append(error)
    return tuple(found)


def _way(
    state: AircraftState, place: tuple[float, float] | None, height: float
) -> tuple[float, float]:
    """Metres to a place and up to a height, as far as anybody knows."""
    here = known(state, Position)
    if here is None:
        return 0.0, 0.0
    climb = height - here.height_m
    if place is None:
        return 0.0, climb
    frame = LocalFrame(here.latitude_deg, here.longitude_deg)  # what is known is within ±89°
    return math.hypot(*frame.to_local(*place)), climb


def _turn(state: AircraftState, yaw_deg: float) -> float:
    attitude = known(state, Attitude)
    return 0.0 if attitude is None else normalize_degrees(yaw_deg - attitude.yaw_deg)


def _foresight(
    distance: float, climb: float, turn: float, seconds: float, refusals: tuple[M100Error, ...]
) -> Foresight:
    seconds += SETTLE_S
    share = 100.0 * seconds / (60.0 * HOVER_MINUTES)
    return Foresight(distance, climb, turn, seconds, share, refusals)
