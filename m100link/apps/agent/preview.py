"""A preview of a guided order or plan: no message is sent."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import asdict

from m100link.apps.agent.messages import GuardLimits
from m100link.apps.agent.orders import ChangeHeading, ChangeHeight, FlyAround, FlyTo, GuidedOrder
from m100link.errors import GuardRefused, LinkError
from m100link.flight import foresight
from m100link.flight.guards import Envelope, GuardKeeper, Guards
from m100link.flight.missions.context import check_battery, check_plan
from m100link.missions.plan import WaypointPlan
from m100link.telemetry.state import AircraftState

Preview = foresight.Foresight
"""Distance, time, battery, and the refusals that are foreseen."""


def preview(order: GuidedOrder, state: AircraftState | None, limits: GuardLimits) -> Preview:
    """The agent's answer, as far as is known here; it decides again when it gets the order.

    Args:
        order: The order.
        state: Telemetry; None while no aircraft is connected.
        limits: Limits of the guards. Without an origin they count from where the aircraft is.
    """
    if state is None:
        error = LinkError("no aircraft is connected", remedy="wait until it is, then point again")
        return Preview(refusals=(error,))
    guards = _guards_of(state, limits)
    if isinstance(order, FlyTo):
        return foresight.foresee_flight(state, guards, **asdict(order))
    if isinstance(order, FlyAround):
        circle = asdict(order)
        del circle["clockwise"]  # either way is as long
        return foresight.foresee_orbit(state, guards, **circle)
    if isinstance(order, ChangeHeight):
        return foresight.foresee_climb(state, guards, order.height)
    assert isinstance(order, ChangeHeading)
    return foresight.foresee_turn(state, guards, order.yaw_deg)


def require_inside(
    legs: Iterable[GuidedOrder], state: AircraftState | None, limits: GuardLimits
) -> None:
    """Raise the ``GuardRefused`` by which the envelope would end one of these flights.

    It holds on the ground as well: what follows a take-off costs none. Arguments: as
    :func:`preview`.
    """
    for order in legs:
        for error in preview(order, state, limits).refusals:
            if isinstance(error, GuardRefused) and error.guard == "envelope":
                raise error


def preview_plan(
    plan: WaypointPlan, state: AircraftState | None, limits: GuardLimits
) -> tuple[GuardRefused, ...]:
    """The agent's refusals of a mission by its guards, as far as is known here.

    Args:
        plan: The plan.
        state: Telemetry; without any nothing is foreseen.
        limits: Limits of the guards.
    """
    if state is None:
        return ()
    guards = _guards_of(state, limits)
    refusals = []
    checks: tuple[Callable[[], None], ...] = (
        lambda: check_plan(guards, state, plan, allow_far=False),
        lambda: check_battery(guards, state, plan),
    )
    for check in checks:
        try:
            check()
        except GuardRefused as refusal:
            refusals.append(refusal)
    return tuple(refusals)


def _guards_of(state: AircraftState, limits: GuardLimits) -> GuardKeeper:
    bounds = (limits.max_height_m, limits.max_radius_m, limits.max_speed_m_s)
    envelope = Envelope(*(math.inf if one is None else one for one in bounds))
    guards = Guards(envelope=envelope, battery_floor_percent=limits.battery_floor_percent)
    origin = None
    if limits.latitude_deg is not None and limits.longitude_deg is not None:
        origin = foresight.frame_at(limits.latitude_deg, limits.longitude_deg)
    return GuardKeeper(guards, state, origin)
