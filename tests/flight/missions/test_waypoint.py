"""A plan that the aircraft flies by itself: uploaded, started, reported, stopped."""

from __future__ import annotations

import asyncio

import pytest

from m100link import (
    BadAck,
    Finished,
    MissionProgress,
    MissionRefused,
    MissionRunning,
    Paused,
    Reached,
    Resumed,
    Setpoint,
    Started,
    Stopped,
    Uploaded,
    Uploading,
    UsageError,
)
from tests.flight.missions.foreign import assert_rests, foreign, orders, plan
from tests.rig import NORTH

pytestmark = pytest.mark.anyio


async def test_a_plan_is_uploaded_flown_and_reported_in_order() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        uploading: list[Uploading] = []
        events = []
        async with control.waypoint_mission(plan(), progress=uploading.append) as mission:
            assert mission.estimated_time == 60.0
            async for event in mission:
                events.append(event)
        assert [told.index for told in uploading] == [0, 1, 2, 3]
        assert there.missions.reached == [0, 1, 2, 3]
        steps = [event for event in events if not isinstance(event, MissionProgress)]
        assert steps[:2] == [Uploaded(4, 60.0), Started()]
        assert [e.index for e in steps if isinstance(e, Reached)] == [0, 1, 2, 3]
        assert isinstance(steps[-1], Finished)
        told = [event.elapsed for event in events if isinstance(event, MissionProgress)]
        assert told == pytest.approx([0.2, *range(1, len(told))], abs=0.1)
        assert mission.is_over
        control.send(NORTH)  # the aircraft is the program's again
    needless = "an end needs no stop, and what is pushed is not asked for"
    assert orders(there, 0x12, 0x14) == [(0x12, 0)], needless


async def test_a_name_of_a_file_is_not_a_plan() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        with pytest.raises(UsageError, match=r"the plan is 'plan\.json'") as caught:
            control.waypoint_mission("plan.json")  # type: ignore[arg-type] # what is asked
        assert "WaypointPlan.read" in caught.value.remedy
    assert not there.missions.flying


async def test_leaving_the_block_stops_it() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        async with control.waypoint_mission(plan()):
            await asyncio.sleep(3.0)
            assert there.missions.flying
        assert not there.missions.flying
        await assert_rests(there)


async def test_setpoints_and_tasks_are_refused_while_it_flies() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        async with control.waypoint_mission(plan()) as mission:
            with pytest.raises(MissionRunning, match="waypoint mission flies"):
                control.send(NORTH)
            with pytest.raises(MissionRunning):
                await control.land()
            with pytest.raises(MissionRunning):
                await control.take_off()
            with pytest.raises(MissionRunning):
                await control.fly_to(north=1.0, east=0.0)
            with pytest.raises(MissionRunning):
                async with control.hold(NORTH):
                    pytest.fail("held")
            with pytest.raises(MissionRunning):
                await control.follow(lambda _: NORTH)
            with pytest.raises(MissionRunning):
                async with control.waypoint_mission(plan()):
                    pytest.fail("entered")
            assert there.missions.flying
            await mission.stop()
            control.send(Setpoint.velocity(north=0.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0))
        assert not [move for move in there.movements if not move.is_obeyed]


async def test_pause_resume_and_stop_are_orders_with_events() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        async with control.waypoint_mission(plan()) as mission:
            await asyncio.sleep(1.0)
            await mission.pause()
            assert mission.is_paused
            flown = there.missions.flown_m
            await asyncio.sleep(5.0)
            assert there.missions.flown_m == flown
            await mission.resume()
            await asyncio.sleep(1.0)
            assert there.missions.flown_m > flown
            await mission.stop()
            events = [e async for e in mission if not isinstance(e, MissionProgress)]
        assert [type(event) for event in events[1:]] == [Started, Paused, Resumed, Stopped]
    assert orders(there, 0x12, 0x13) == [(0x12, 0), (0x13, 0), (0x13, 0), (0x12, 0)]


async def test_another_speed_is_the_one_that_the_aircraft_says() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        async with control.waypoint_mission(plan()) as mission:
            assert await mission.set_speed(2.0) == 2.0
            assert there.missions.speed == 2.0
            with pytest.raises(UsageError, match="beyond the plan's max_speed"):
                await mission.set_speed(-15.1)
            there.missions.answers[0x16] = 0xE1
            with pytest.raises(MissionRefused):
                await mission.set_speed(1.0)
            assert there.missions.speed == 2.0


async def test_a_refusal_names_the_waypoint_and_nothing_flies() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        missions, refused = there.missions, dict[int, int]()
        add = missions._add_point
        missions._add_point = lambda value: refused.get(value[0]) or add(value)  # type: ignore[method-assign]
        for answers, of_points, point in (
            ({0x11: 0xE1}, {}, 0),
            ({0x10: 0xE1}, {}, None),
            ({0x12: 0xC9}, {}, None),
            ({}, {3: 0xE8}, 3),
            ({}, {3: 0xE5}, None),  # of the last one, and about the whole
        ):
            missions.answers = answers
            refused |= of_points
            with pytest.raises(MissionRefused) as caught:
                async with control.waypoint_mission(plan()):
                    pytest.fail("entered")
            [code] = [*answers.values(), *of_points.values()]
            assert (caught.value.code, caught.value.point) == (code, point)
        missions._tail = lambda number, value: b"\x07" if number == 0x11 else value[:0]  # type: ignore[method-assign]
        with pytest.raises(BadAck, match="waypoint 0 was acknowledged as waypoint 7"):
            async with control.waypoint_mission(plan()):
                pytest.fail("entered")
        control.send(NORTH)
