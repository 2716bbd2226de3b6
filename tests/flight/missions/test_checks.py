"""What the guards say to a mission: before its first byte, and while it flies."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest

from m100link import (
    CommandNotSupported,
    Envelope,
    GuardRefused,
    Guards,
    MissionFlight,
    Target,
    TelemetryStalled,
    UsageError,
    Waypoint,
    WaypointPlan,
)
from tests.flight.foreign_aircraft import STANDBY
from tests.flight.missions.foreign import assert_rests, foreign, orders, plan, spot

pytestmark = pytest.mark.anyio

WIDE = Guards(envelope=Envelope(max_radius_m=2000.0, max_height_m=100.0))


@pytest.mark.parametrize(
    ("found", "guards", "guard"),
    [
        (plan([(0.0, 0.0), (151.0, 0.0)]), Guards(), "envelope"),
        (
            WaypointPlan([Waypoint(*spot(0, 0), height=20), Waypoint(*spot(9, 0), height=51)]),
            Guards(),
            "envelope",
        ),
        (plan(speed=10.5, max_speed=12.0), Guards(), "envelope"),
        (plan([(501.0, 0.0), (510.0, 0.0)]), WIDE, "allow_far"),
    ],
)
async def test_a_plan_that_the_guards_do_not_like_is_refused_before_a_byte(
    found: WaypointPlan, guards: Guards, guard: str
) -> None:
    async with foreign() as (there, aircraft), aircraft.control(guards=guards) as control:
        with pytest.raises(GuardRefused) as caught:
            async with control.waypoint_mission(found):
                pytest.fail("entered")
        assert caught.value.guard == guard
        assert orders(there) == []


async def test_far_away_may_be_said_by_name() -> None:
    async with foreign() as (there, aircraft), aircraft.control(guards=WIDE) as control:
        far = plan([(501.0, 0.0), (510.0, 0.0)])
        async with control.waypoint_mission(far, allow_far=True):
            assert there.missions.flying


@pytest.mark.parametrize("firmware", ["1.0", "2.3"])
async def test_firmware_before_3_1_is_asked_nothing(firmware: str) -> None:
    async with foreign(firmware) as (there, aircraft), aircraft.control() as control:
        with pytest.raises(CommandNotSupported):
            async with control.waypoint_mission(plan()):
                pytest.fail("entered")
        with pytest.raises(CommandNotSupported):
            await control.stop_mission()
        assert orders(there) == []


async def test_on_the_ground_it_starts_by_name_alone() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        there.status, there.missions.height = STANDBY, 0.0
        await asyncio.sleep(0.2)
        with pytest.raises(UsageError, match="on the ground"):
            async with control.waypoint_mission(plan()):
                pytest.fail("entered")
        assert (orders(there), there.tasks) == ([], [])
        async with control.waypoint_mission(plan(), take_off=True):
            assert there.tasks == [4]
            assert there.missions.flying
        await assert_rests(there)


async def test_a_flight_status_that_nobody_knows_is_no_reason_to_start() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        there.items -= {"status"}
        await asyncio.sleep(3.0)
        with pytest.raises(TelemetryStalled, match="flight status"):
            async with control.waypoint_mission(plan()):
                pytest.fail("entered")
        assert orders(there) == []


async def test_a_low_battery_before_the_start_is_refused() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        there.battery = 19
        await asyncio.sleep(0.2)
        with pytest.raises(GuardRefused) as caught:
            async with control.waypoint_mission(plan()):
                pytest.fail("entered")
        assert caught.value.guard == "battery_floor_percent"
        assert orders(there) == []


async def test_a_charge_that_does_not_last_for_the_plan_is_refused() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        there.battery = 25
        await asyncio.sleep(0.2)
        with pytest.raises(GuardRefused, match="takes about") as caught:
            async with control.waypoint_mission(plan(speed=1.0)):
                pytest.fail("entered")
        assert caught.value.guard == "battery_floor_percent"
        assert caught.value.measured == 25
        assert isinstance(caught.value.limit, float)
        assert caught.value.limit > 25, "the floor, and what the plan takes"
        assert orders(there) == []
        async with control.waypoint_mission(plan([(0.0, 0.0), (5.0, 0.0)])):
            pass


@pytest.mark.parametrize("stop", ["hover", "land"])
async def test_a_low_battery_in_flight_stops_it_and_ends_the_block(stop: str) -> None:
    async with foreign() as (there, aircraft):
        with pytest.raises(GuardRefused) as caught:
            async with aircraft.control(stop="land" if stop == "land" else "hover") as control:
                async with control.waypoint_mission(plan(speed=1.0)) as mission:
                    await asyncio.sleep(2.0)
                    there.battery = 15
                    async for _ in mission:
                        pass
        assert caught.value.guard == "battery_floor_percent"
        assert orders(there, 0x12) == [(0x12, 0), (0x12, 0)]
        assert there.tasks == ([6] if stop == "land" else [])
        assert there.releases
        await assert_rests(there)


async def test_a_mission_that_leaves_the_envelope_is_stopped() -> None:
    """The pilot's stick, or wind: what was planned lies inside."""
    async with foreign() as (there, aircraft):
        guards = Guards(integrity=False)  # nothing flies there within 20 ms
        with pytest.raises(GuardRefused) as caught:
            async with aircraft.control(guards=guards) as control:
                async with control.waypoint_mission(plan(speed=1.0)) as mission:
                    await asyncio.sleep(2.0)
                    there.missions.east = 160.0
                    async for _ in mission:
                        pass
        assert caught.value.guard == "envelope"
        await assert_rests(there)


@pytest.mark.parametrize("status", [STANDBY, 3])
@pytest.mark.parametrize("kind", ["waypoint", "hotpoint", "follow"])
async def test_firmware_without_missions_is_refused_before_anything_else(
    kind: str, status: int
) -> None:
    async with foreign("1.0") as (there, aircraft), aircraft.control() as control:
        there.status = status
        await asyncio.sleep(0.5)
        place = spot(10.0, 0.0)
        flights: dict[str, Callable[[], MissionFlight]] = {
            "waypoint": lambda: control.waypoint_mission(plan()),
            "hotpoint": lambda: control.hotpoint(
                latitude_deg=place[0], longitude_deg=place[1], height=1, radius=9, rate_deg_s=10
            ),
            "follow": lambda: control.follow_target(Target(*place)),
        }
        with pytest.raises(CommandNotSupported, match=r"firmware 1\.0 does not know"):
            async with flights[kind]():
                pytest.fail("entered")
