"""What the guards say to a mission before its first byte is sent."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from m100link.errors import GuardRefused, TelemetryStalled, UsageError
from m100link.flight.known import known
from m100link.flight.tasks import describe_situation
from m100link.geodesy import LocalFrame
from m100link.protocol.records import Battery, FlightPhase, FlightStatus, Position

if TYPE_CHECKING:
    from m100link.flight.guards import Envelope, GuardKeeper
    from m100link.flight.missions.deck import Deck
    from m100link.missions.plan import WaypointPlan
    from m100link.telemetry.state import AircraftState

__all__ = [
    "FAR_M",
    "check_battery",
    "check_envelope",
    "check_plan",
    "check_way",
    "require_airborne",
]

FAR_M = 500.0
"""Horizontal metres to the first waypoint, centre or target from which a mission must be allowed by
name: a plan of another place is a mistake that is made."""

_WHAT = "the waypoint mission"


async def require_airborne(deck: Deck, what: str, *, may_take_off: bool = False) -> bool:
    """Wait for what the guards compare, and see that the aircraft flies, or may take off.

    A mission that is started on the ground may take off by itself (facts W9): nobody is to be
    surprised by that.

    Returns:
        Whether it stands on the ground.

    Raises:
        UsageError: It stands on the ground, and nobody said that it may take off.
        TelemetryStalled: Nobody knows whether it flies.
        GuardRefused: Battery below its floor or unknown, position unknown, GPS too weak.
    """
    await deck.guards.admit_mission(what)
    state = deck.commander.state
    status = known(state, FlightStatus)
    if status is None:
        raise TelemetryStalled(
            f"{what} was asked for, and the flight status does not arrive",
            cause="the item is not sent, or the line is broken",
            remedy="set the item to 1 Hz or more in the PC assistant",
        )
    is_on_ground = status.status == FlightPhase.STANDBY
    if is_on_ground and not may_take_off:
        raise UsageError(
            f"{what} was asked for on the ground ({describe_situation(state.situation())})",
            cause="the aircraft may take off by itself when a mission starts",
            remedy="await control.take_off() first; a waypoint mission takes take_off=True",
        )
    return is_on_ground


def check_envelope(envelope: Envelope, plan: WaypointPlan) -> None:
    """Whether heights and speed of a plan lie inside, wherever the aircraft is.

    Raises:
        GuardRefused: One does not.
    """
    for index, point in enumerate(plan.waypoints):
        envelope.check(f"waypoint {index} of {_WHAT}", height=point.height)
    envelope.check(_WHAT, speed=abs(plan.speed))


def check_plan(
    guards: GuardKeeper, state: AircraftState, plan: WaypointPlan, *, allow_far: bool
) -> None:
    """Whether a plan may be flown from here, within the envelope.

    Raises:
        GuardRefused: With the guard, the waypoint, the measured value and the limit.
    """
    envelope = guards.guards.envelope
    if envelope is not None:
        check_envelope(envelope, plan)
    for index, point in enumerate(plan.waypoints):
        place = point.latitude_deg, point.longitude_deg
        guards.check_target(f"waypoint {index} of {_WHAT}", place)
    first = plan.waypoints[0]
    check_way(state, _WHAT, (first.latitude_deg, first.longitude_deg), allow_far=allow_far)


def check_battery(guards: GuardKeeper, state: AircraftState, plan: WaypointPlan) -> None:
    """Whether the charge lasts for the plan and what the floor wants to be left, by estimate.

    A plan that only the pilot's stick moves has no estimate; the floor ends it in flight.

    Raises:
        GuardRefused: It does not.
    """
    floor = guards.guards.battery_floor_percent
    battery, position = known(state, Battery), known(state, Position)
    if floor is None or battery is None:
        return  # without a charge and with a floor nothing comes here
    home = None if position is None else (position.latitude_deg, position.longitude_deg)
    needed = plan.estimate(home=home).battery_percent
    if math.isfinite(needed) and battery.percent - needed < floor:
        raise GuardRefused(
            f"the waypoint mission was refused: it takes about {needed:.0f} % of a battery, which "
            f"has {battery.percent} %, and {floor} % are to be left",
            guard="battery_floor_percent",
            measured=battery.percent,
            limit=floor + needed,
            cause="the estimate reckons with a TB47D and 500 g; nothing of it was measured",
            remedy="a full battery, a shorter plan, or Guards(battery_floor_percent=…)",
        )


def check_way(
    state: AircraftState, what: str, place: tuple[float, float], *, allow_far: bool
) -> float:
    """How far it is to where a mission begins, m; 0 while the position is unknown.

    Raises:
        GuardRefused: Farther than 500 m, and nobody allowed it.
    """
    position = known(state, Position)
    if position is None:
        return 0.0
    here = LocalFrame(position.latitude_deg, position.longitude_deg)
    distance = math.hypot(*here.to_local(*place))
    if distance > FAR_M and not allow_far:
        raise GuardRefused(
            f"{what} was refused: it begins {distance:.0f} m from here, the limit is {FAR_M:g} m",
            guard="allow_far",
            measured=distance,
            limit=FAR_M,
            cause="a plan of another place, or latitude and longitude in the wrong order",
            remedy="fly nearer, or say allow_far=True",
        )
    return distance
