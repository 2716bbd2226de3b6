"""The manual's table of endings, flown with the virtual aircraft; and a long plan on a bad line."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator
from contextlib import nullcontext
from typing import Any

import pytest

from m100link import (
    Aborted,
    ActionsDone,
    Aircraft,
    AtEnd,
    AuthorityLost,
    CircleHeading,
    Finished,
    GuardRefused,
    Guards,
    LinkLost,
    MissionAborted,
    MissionKind,
    MissionRunning,
    NotObserved,
    OnRCLoss,
    Reached,
    Stay,
    Stopped,
    TakePhoto,
    Target,
    TaskRefused,
    UsageError,
    Waypoint,
    WaypointPlan,
)
from m100link.flight.stop_path import StopAction
from m100link.geodesy import LocalFrame
from m100link.missions.waypoint import WaypointAction
from m100link.protocol.commands.control import Move
from m100link.sim import AircraftSettings, LineFaults
from tests.rig import NORTH, Rig, put_in_the_air, rig

pytestmark = pytest.mark.anyio


def frame(aircraft: Aircraft) -> LocalFrame:
    position = aircraft.state.position
    assert position is not None
    return LocalFrame(position.latitude_deg, position.longitude_deg)


def along(aircraft: Aircraft, *corners: tuple[float, float], **options: Any) -> WaypointPlan:
    here = frame(aircraft)
    points = [Waypoint(*here.to_geodetic(*corner), height=10.0) for corner in corners]
    return WaypointPlan(points, **options)


def long_way(aircraft: Aircraft, **options: Any) -> WaypointPlan:
    """Some minutes of flight."""
    return along(aircraft, (5.0, 0.0), (100.0, 0.0), (0.0, 0.0), **{"speed": 2.0, **options})


async def assert_at_rest(flown: Rig, *, is_on_ground: bool = False) -> None:
    """No mission flies it, and nobody moves it."""
    assert flown.virtual.vehicle.missions.running is None
    await asyncio.sleep(5.0)
    before = flown.virtual.position
    await asyncio.sleep(10.0)
    assert math.dist(before, flown.virtual.position) < 0.3
    assert (flown.virtual.height == 0.0) is is_on_ground


# -- a long plan ----------------------------------------------------------------------------------


async def test_fifty_waypoints_with_actions_on_a_line_that_loses_a_tenth() -> None:
    async with rig(firmware="3.1") as flown:
        here = frame(flown.aircraft)
        points = []
        for index in range(50):
            row, place = divmod(index, 10)
            column = place if row % 2 == 0 else 9 - place
            actions: list[WaypointAction] = (
                [TakePhoto()] if index % 2 else [Stay(0.5), TakePhoto(), Stay(1.5)]
            )
            where = here.to_geodetic(row * 6.0, column * 6.0)
            points.append(Waypoint(*where, height=10.0 + row, actions=actions))
        plan = WaypointPlan(points, speed=8.0, max_speed=10.0)
        flown.virtual.set_faults(LineFaults(loss=0.1))
        guards = Guards(battery_floor_percent=None)
        async with flown.aircraft.control(guards=guards) as control:
            async with control.waypoint_mission(plan, take_off=True) as mission:
                assert await flown.aircraft.download_waypoint_plan() == plan
                events = [event async for event in mission]
            flown.virtual.set_faults()
        assert [e.index for e in events if isinstance(e, Reached)] == list(range(50))
        acted = [e.index for e in events if isinstance(e, ActionsDone)]
        assert acted == sorted(set(acted))
        assert sum(isinstance(event, Finished) for event in events) == 1
        assert flown.virtual.vehicle.camera.photos == 50, "each action once"
        await assert_at_rest(flown)


# -- the table of the manual ----------------------------------------------------------------------


async def fly_on(flown: Rig, guards: Guards | None, **options: Any) -> list[object]:
    """The events of the program, to the last one."""
    events: list[object] = []
    async with flown.aircraft.control(guards=guards) as control:
        plan = long_way(flown.aircraft, **options)
        async with control.waypoint_mission(plan, take_off=True) as mission:
            async for event in mission:
                events.append(event)
    return events


async def begun(
    flown: Rig, guards: Guards | None = None, **options: Any
) -> asyncio.Task[list[object]]:
    task = asyncio.create_task(fly_on(flown, guards, **options))
    await asyncio.sleep(30.0)
    assert flown.virtual.vehicle.missions.running is not None
    return task


async def test_the_pilot_takes_it() -> None:
    async with rig(firmware="3.1") as flown:
        task = await begun(flown)
        flown.virtual.leave_f()
        with pytest.raises(AuthorityLost) as caught:
            await task
        assert caught.value.reason == "mode_switch"
        await assert_at_rest(flown)
        flown.virtual.return_to_f()
        await assert_at_rest(flown)


async def test_the_app_takes_it() -> None:
    async with rig(firmware="3.1") as flown:
        task = await begun(flown)
        flown.virtual.app_takes_control()
        with pytest.raises(AuthorityLost):
            await task
        await assert_at_rest(flown)


async def test_a_program_that_is_gone_leaves_it_in_flight_and_the_next_one_finds_it() -> None:
    async with rig(firmware="3.1") as flown:
        task = await begun(flown)
        flown.virtual.unplug()
        with pytest.raises(LinkLost) as caught:
            await task
        assert "flies on by itself" in caught.value.remedy
        flown.virtual.replug()
        before = flown.virtual.position
        async with flown.virtual.connect() as aircraft:
            aircraft.use_key(flown.virtual.credentials)
            await asyncio.sleep(3.0)
            assert math.dist(before, flown.virtual.position) > 3.0
            assert aircraft.mission.kind is MissionKind.WAYPOINT
            assert aircraft.mission.is_running
            async with aircraft.control() as control:
                assert await control.stop_mission() is MissionKind.WAYPOINT
                await asyncio.sleep(2.0)
                control.send(NORTH.neutral())
            await assert_at_rest(flown)


async def test_the_program_stops_it() -> None:
    async with rig(firmware="3.1") as flown:
        async with flown.aircraft.control() as control:
            plan = long_way(flown.aircraft)
            async with control.waypoint_mission(plan, take_off=True) as mission:
                await asyncio.sleep(20.0)
                await mission.stop()
                assert isinstance([event async for event in mission][-1], Stopped)
            await assert_at_rest(flown)


@pytest.mark.parametrize("stop", ["hover", "land"])
@pytest.mark.parametrize("at_end", [AtEnd.GO_HOME, AtEnd.LAND])
async def test_a_program_that_leaves_on_the_way_home_does_not_leave_it_in_the_air(
    at_end: AtEnd, stop: StopAction
) -> None:
    async with rig(firmware="3.1") as flown:
        plan = along(flown.aircraft, (5.0, 0.0), (40.0, 0.0), speed=8.0, at_end=at_end)
        async with flown.aircraft.control(stop=stop) as control:
            async with control.waypoint_mission(plan, take_off=True) as mission:
                async for event in mission:
                    if isinstance(event, Finished):
                        break
            assert flown.virtual.height > 5.0
        await asyncio.sleep(90.0)
        await assert_at_rest(flown, is_on_ground=True)
        if at_end is AtEnd.GO_HOME and stop == "hover":
            assert math.hypot(*flown.virtual.position) < 2.0


async def test_a_low_battery_meets_the_guard_first() -> None:
    async with rig(firmware="3.1") as flown:
        guards = Guards(battery_floor_percent=50)  # above the aircraft's own first warning
        task = await begun(flown, guards)
        flown.virtual.battery_percent = 49
        with pytest.raises(GuardRefused):
            await task
        await assert_at_rest(flown)


async def test_a_low_battery_without_the_guard_brings_it_home() -> None:
    async with rig(firmware="3.1") as flown:
        guards = Guards(battery_floor_percent=None)
        last: object = None
        with pytest.raises((MissionAborted, AuthorityLost)):
            async with flown.aircraft.control(guards=guards) as control:
                plan = long_way(flown.aircraft)
                async with control.waypoint_mission(plan, take_off=True) as mission:
                    async for event in mission:
                        last = event
                        if isinstance(event, Reached):
                            flown.virtual.battery_percent = 9
        assert last is not None
        await asyncio.sleep(60.0)
        await assert_at_rest(flown, is_on_ground=True)


async def test_a_lost_rc_breaks_it_off_and_the_aircraft_returns() -> None:
    async with rig(firmware="3.1") as flown:
        task = await begun(flown)
        flown.virtual.rc_lost()
        with pytest.raises((MissionAborted, AuthorityLost)):
            await task
        await asyncio.sleep(120.0)
        await assert_at_rest(flown, is_on_ground=True)


@pytest.mark.parametrize("reads", ["zeros", "kept"])
async def test_a_lost_rc_may_be_flown_through_by_name(reads: Any) -> None:
    """Whether its channels show the loss at once, or the aircraft tells of it seconds later."""
    async with rig(firmware="3.1", settings=AircraftSettings(rc_lost_reads=reads)) as flown:
        task = await begun(flown, on_rc_loss=OnRCLoss.CONTINUE)
        flown.virtual.rc_lost()
        await asyncio.sleep(5.0)
        assert flown.virtual.vehicle.missions.running is not None
        with pytest.raises(AuthorityLost) as caught:
            await task
        assert "flies on by itself" in caught.value.remedy
        await asyncio.sleep(180.0)
        assert math.hypot(*flown.virtual.position) < 1.0, "at its last waypoint, which is home"
        await assert_at_rest(flown, is_on_ground=True)


async def test_telemetry_that_stops_ends_it() -> None:
    async with rig(firmware="3.1") as flown:
        task = await begun(flown)
        flown.virtual.line.stall(to_host=True, to_aircraft=False)
        with pytest.raises(Exception, match="no telemetry"):
            await task
        flown.virtual.line.stall(to_host=False, to_aircraft=False)
        await assert_at_rest(flown)


# -- the other kinds ------------------------------------------------------------------------------


async def test_a_circle_keeps_its_radius_and_changes_it() -> None:
    async with rig(firmware="3.1") as flown:
        latitude, longitude = frame(flown.aircraft).to_geodetic(30.0, 0.0)
        async with flown.aircraft.control() as control:
            await control.take_off()
            async with control.hotpoint(
                latitude_deg=latitude,
                longitude_deg=longitude,
                height=12.0,
                radius=20.0,
                rate_deg_s=10.0,
                heading=CircleHeading.TO_CENTRE,
            ) as circle:
                await asyncio.sleep(25.0)
                for _ in range(20):
                    await asyncio.sleep(1.0)
                    north, east = flown.virtual.position
                    assert abs(math.hypot(north - 30.0, east) - 20.0) < 0.5
                assert abs(flown.virtual.height - 12.0) < 0.3
                await circle.set_radius(25.0)
                await asyncio.sleep(10.0)
                north, east = flown.virtual.position
                assert abs(math.hypot(north - 30.0, east) - 25.0) < 0.5
                await circle.set_rate(5.0, clockwise=False)
            await assert_at_rest(flown)


async def test_a_target_is_followed_at_its_distance() -> None:
    async with rig(firmware="3.1") as flown:
        here = frame(flown.aircraft)

        async def walk() -> AsyncIterator[Target]:
            for second in range(30):
                yield Target(*here.to_geodetic(15.0, float(second)))
                await asyncio.sleep(1.0)

        async with flown.aircraft.control() as control:
            await control.take_off()
            await control.climb_to(8.0)
            async with control.follow_target(walk()) as mission:
                events = [event async for event in mission]
            assert isinstance(events[-1], Stopped)
            assert not [event for event in events if isinstance(event, Aborted)]
            north, east = flown.virtual.position
            assert abs(north) < 1.0
            assert 25.0 < east < 31.0
            await assert_at_rest(flown)


# -- what steers makes way -------------------------------------------------------------------------


async def test_no_mission_begins_beside_a_closed_loop() -> None:
    async with rig(firmware="3.1") as flown, flown.aircraft.control() as control:
        await control.take_off()
        climbing = asyncio.create_task(control.climb_to(15.0))
        await asyncio.sleep(1.0)
        with pytest.raises(UsageError, match="closed loop"):
            async with control.waypoint_mission(long_way(flown.aircraft)):
                pytest.fail("entered")
        await climbing
        assert flown.virtual.height == pytest.approx(15.0, abs=0.6)


async def test_a_mission_begins_behind_the_neutral_of_the_setpoint_before_it() -> None:
    async with rig(firmware="3.1") as flown, flown.aircraft.control() as control:
        await control.take_off()
        control.send(NORTH, lifetime=30.0, allow_long_lifetime=True)
        await asyncio.sleep(1.0)
        async with control.waypoint_mission(long_way(flown.aircraft)):
            flown.assert_stopped_in_order()
            count = len(flown.moves)
            await asyncio.sleep(2.0)
            assert len(flown.moves) == count


async def test_no_mission_begins_beside_a_task() -> None:
    async with rig(firmware="3.1") as flown, flown.aircraft.control() as control:
        await control.take_off()
        landing = asyncio.create_task(control.land())
        await asyncio.sleep(0.5)
        with pytest.raises(TaskRefused, match="during land"):
            async with control.waypoint_mission(long_way(flown.aircraft)):
                pytest.fail("entered")
        await landing
        assert flown.virtual.height == 0.0


@pytest.mark.parametrize("order", ["stop", "stop_mission", "land"])
async def test_a_stop_before_it_begins_is_not_forgotten(order: str) -> None:
    """During its own take-off; it began behind that, although the stop had returned."""
    async with rig(firmware="3.1") as flown, flown.aircraft.control() as control:
        mission = control.waypoint_mission(long_way(flown.aircraft), take_off=True)
        entering = asyncio.ensure_future(mission.__aenter__())
        while control.unended_task is None:  # noqa: ASYNC110 - no event tells of it
            await asyncio.sleep(0.05)
        with nullcontext() if order != "land" else pytest.raises(TaskRefused, match="during take"):
            await getattr(control, order)()
        with pytest.raises(NotObserved, match="waypoint mission was stopped before it began"):
            await entering
        await assert_at_rest(flown)
        assert flown.aircraft.mission.kind is MissionKind.NONE
        await control.climb_to(3.0)


async def test_no_mission_begins_on_the_ground_where_its_source_took_its_time() -> None:
    async with rig(firmware="3.1") as flown, flown.aircraft.control() as control:
        put_in_the_air(flown.virtual, 8.0)
        await asyncio.sleep(2.0)
        here = frame(flown.aircraft)

        async def late() -> AsyncIterator[Target]:
            flown.virtual.vehicle.flight.land()  # by the pilot, or a low battery
            await asyncio.sleep(30.0)
            yield Target(*here.to_geodetic(15.0, 0.0))

        with pytest.raises(UsageError, match="follow mission was asked for on the ground"):
            async with control.follow_target(late()):
                pytest.fail("entered")
        assert not flown.is_running


async def test_while_one_flies_the_experts_door_is_shut() -> None:
    async with rig(firmware="3.1") as flown, flown.aircraft.control() as control:
        await control.take_off()
        async with control.waypoint_mission(long_way(flown.aircraft)):
            with pytest.raises(MissionRunning, match="raw movement"):
                control.send_raw_move_as_expert(Move(0, 0.0, 0.0, 0.0, 0.0))
