"""What a front hears of a guided order before it gives it."""

from __future__ import annotations

import math

import anyio
import pytest

from m100link.apps.agent.messages import GuardLimits
from m100link.apps.agent.orders import ChangeHeading, ChangeHeight, FlyAround, FlyTo, GuidedOrder
from m100link.apps.agent.preview import preview, preview_plan
from m100link.errors import GuardRefused
from m100link.geodesy import LocalFrame
from m100link.missions.plan import Waypoint, WaypointPlan
from m100link.telemetry.state import AircraftState
from tests.apps.agent.conftest import Rig, airborne

pytestmark = pytest.mark.anyio


async def hovering(rig: Rig) -> tuple[AircraftState, LocalFrame]:
    await airborne(rig)
    await rig.agent.ask(ChangeHeight(10.0), rig.token)
    state = rig.agent.connection.require_aircraft().state
    assert state.position is not None
    return state, LocalFrame(state.position.latitude_deg, state.position.longitude_deg)


async def test_each_order_has_its_distance_time_and_battery(rig: Rig) -> None:
    state, frame = await hovering(rig)
    limits = rig.holding.require().limits
    place = frame.to_geodetic(30.0, 40.0)
    there = preview(FlyTo(*place, 15.0), state, limits)
    assert there.distance_m == pytest.approx(50.0, abs=0.2)
    assert there.climb_m == pytest.approx(5.0, abs=0.4)
    assert there.seconds > 10.0
    assert there.battery_percent > 0.5
    around = preview(FlyAround(*place, 10.0, 10.0, turns=2.0), state, limits)
    assert around.distance_m == pytest.approx(40.0 + 40 * math.pi, abs=0.5)
    assert preview(ChangeHeight(5.0), state, limits).climb_m == pytest.approx(-5.0, abs=0.4)
    assert preview(ChangeHeading(90.0), state, limits).turn_deg == pytest.approx(90.0, abs=1.0)
    assert there.refusals == around.refusals == ()


@pytest.mark.parametrize(
    ("limits", "guard"),
    [
        (GuardLimits(), ""),
        (GuardLimits(max_radius_m=20.0), "envelope"),
        (GuardLimits(max_height_m=12.0), "envelope"),
        (GuardLimits(max_speed_m_s=3.0), "envelope"),
    ],
)
async def test_the_limits_are_those_that_are_reported(
    rig: Rig, limits: GuardLimits, guard: str
) -> None:
    state, frame = await hovering(rig)
    order = FlyTo(*frame.to_geodetic(30.0, 0.0), 15.0, speed=5.0)
    found = preview(order, state, limits)
    assert [one.guard for one in found.refusals if isinstance(one, GuardRefused)] == (
        [guard] if guard else []
    )


async def test_the_radius_counts_from_where_control_began(rig: Rig) -> None:
    state, frame = await hovering(rig)
    origin = frame.to_geodetic(-100.0, 0.0)
    limits = GuardLimits(max_radius_m=120.0, latitude_deg=origin[0], longitude_deg=origin[1])
    order = FlyTo(*frame.to_geodetic(50.0, 0.0), 15.0)
    (refusal,) = preview(order, state, limits).refusals
    assert "150 m from the start" in refusal.seen
    assert refusal.remedy


@pytest.mark.parametrize(
    "order",
    [FlyTo(0, 0, 5), FlyAround(0, 0, 5, 10), ChangeHeight(5), ChangeHeading(5)],
    ids=lambda one: type(one).__name__,
)
async def test_without_an_aircraft_everything_is_refused(order: GuidedOrder) -> None:
    (refusal,) = preview(order, None, GuardLimits()).refusals
    assert "no aircraft" in refusal.seen
    found = preview(order, AircraftState(anyio.current_time), GuardLimits())
    assert found.refusals
    assert found.distance_m == 0.0 or isinstance(order, FlyAround)


@pytest.mark.parametrize(
    ("limits", "guards"),
    [
        (GuardLimits(), []),
        (GuardLimits(max_height_m=12.0), ["envelope"]),
        (GuardLimits(max_radius_m=20.0, battery_floor_percent=100), ["envelope", "battery"]),
        (GuardLimits(battery_floor_percent=20), []),
    ],
)
async def test_a_plan_is_refused_by_the_guards_that_its_start_would_ask(
    rig: Rig, limits: GuardLimits, guards: list[str]
) -> None:
    state, frame = await hovering(rig)
    points = [Waypoint(*frame.to_geodetic(north, 0.0), height=15) for north in (30, 60)]
    found = preview_plan(WaypointPlan(points), state, limits)
    assert [one.guard.split("_")[0] for one in found] == guards
    assert preview_plan(WaypointPlan(points), None, limits) == ()


async def test_a_plan_of_another_place_is_refused(rig: Rig) -> None:
    state, frame = await hovering(rig)
    points = [Waypoint(*frame.to_geodetic(north, 0.0), height=15) for north in (600, 630)]
    (refusal,) = preview_plan(WaypointPlan(points), state, GuardLimits())
    assert refusal.guard == "allow_far"
