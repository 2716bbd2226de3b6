"""Where nobody can be sure that a mission has ended, it is stopped."""

from __future__ import annotations

import asyncio
import random
from contextlib import suppress

import pytest

from m100link import (
    AtEnd,
    AuthorityLost,
    Finished,
    MissionAborted,
    MissionKind,
    MissionProgress,
    MissionRefused,
    MissionRunning,
)
from m100link.flight.stop_path import StopAction
from tests.flight.foreign_aircraft import GOING_HOME, MODE_F, ONBOARD, STANDBY, frame
from tests.flight.missions.foreign import assert_rests, foreign, plan, tell_standby_once
from tests.flight.missions.test_mission_guard import start_from_a_phone
from tests.flight.missions.test_mission_session import (
    SLOW,
    assert_stopped,
    begun,
    lose_short_acks,
    stops,
)
from tests.rig import NORTH

pytestmark = pytest.mark.anyio


async def test_a_start_that_was_executed_and_then_refused_as_a_repetition_is_stopped() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        start = there.missions._start

        def start_unheard(status: int) -> int:
            if not there.missions.flying:
                lose_short_acks(there)
                asyncio.get_running_loop().call_later(0.1, there._stored.clear)
            else:
                del there._write
            return start(status)

        there.missions._start = start_unheard  # type: ignore[method-assign] # see above
        with pytest.raises(MissionRefused):
            async with control.waypoint_mission(SLOW):
                pytest.fail("entered")
        assert stops(there) == [0]
        await assert_rests(there)


async def test_a_start_that_is_answered_by_a_code_without_meaning_is_stopped() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        execute = there._execute

        def misname(group: int, number: int, value: bytes) -> bytes | None:
            answer = execute(group, number, value)
            return b"\x42" if (group, number, value) == (3, 0x12, b"\0") else answer

        there._execute = misname  # type: ignore[method-assign] # a firmware with codes of its own
        with pytest.raises(MissionRefused):
            async with control.waypoint_mission(SLOW):
                pytest.fail("entered")
        assert stops(there) == [0]
        await assert_rests(there)


async def test_a_stop_that_was_given_up_is_sent_again_at_the_end() -> None:
    async with foreign() as (there, aircraft):
        async with aircraft.control() as control:
            async with control.waypoint_mission(SLOW) as mission:
                await asyncio.sleep(2.0)
                there.is_deaf = True
                stopping = asyncio.create_task(mission.stop())
                for _ in range(3):  # as a loop that is being closed does
                    await asyncio.sleep(0.01)
                    for task in asyncio.all_tasks() - {asyncio.current_task(), stopping}:
                        if "_send_stop" in repr(task.get_coro()):
                            task.cancel()
                await asyncio.wait([stopping])
                there.is_deaf = False
            assert stops(there) == [0]
        await assert_rests(there)


async def test_a_stop_that_was_refused_once_is_sent_again_at_the_end() -> None:
    async with foreign() as (there, aircraft):
        async with aircraft.control() as control:
            async with control.waypoint_mission(SLOW) as mission:
                await asyncio.sleep(2.0)
                execute, refusals = there._execute, [b"\xde"]

                def refuse(group: int, number: int, value: bytes) -> bytes | None:
                    is_stop = (group, number, value) == (3, 0x12, b"\x01")
                    return refusals.pop() if is_stop and refusals else execute(group, number, value)

                there._execute = refuse  # type: ignore[method-assign] # one stop, and no other
                with pytest.raises(MissionRefused, match="the stop of the waypoint mission"):
                    await mission.stop()
                assert not mission.is_over, "it flies on"
            assert stops(there) == [0]
        await assert_rests(there)


@pytest.mark.parametrize("answer", [b"", b"\0\0\0", b"\x01\xff", b"\0\xff", bytes(53)])
async def test_an_answer_that_says_nothing_does_not_keep_the_stop_from_being_sent(
    answer: bytes,
) -> None:
    async with foreign() as (there, aircraft):
        task = await begun(there, aircraft)
        execute = there._execute

        def garble(group: int, number: int, value: bytes) -> bytes | None:
            return answer if (group, number) == (3, 0x14) else execute(group, number, value)

        there._execute = garble  # type: ignore[method-assign] # see above
        there.missions.break_off = lambda reason: None  # type: ignore[method-assign] # it does not
        there.missions.answers, there.missions.is_pushing = {0x12: 0}, False
        there.leave_f()
        with pytest.raises(AuthorityLost):
            await task
        assert stops(there) == [0]


async def test_one_that_is_pushed_on_after_its_end_is_stopped_with_the_block() -> None:
    async with foreign() as (there, aircraft):
        async with aircraft.control() as control:
            with pytest.raises(MissionAborted):
                async with control.waypoint_mission(SLOW):
                    await asyncio.sleep(2.0)
                    there._write(frame(b"\x02\x03\0\1\1\xd9\0\0"))
                    await asyncio.sleep(2.0)
            with pytest.raises(MissionRunning):
                control.send(NORTH)
        await assert_stopped(there)


async def test_its_stop_precedes_the_neutral_which_the_aircraft_would_ignore() -> None:
    """As the page on safety has the order of the stop path: a stop that waited would come late."""
    async with foreign() as (there, aircraft):
        execute, stopped_at = there._execute, list[float]()
        clock = asyncio.get_running_loop().time

        def noted(group: int, number: int, value: bytes) -> bytes | None:
            if (group, number, value) == (3, 0x12, b"\x01"):
                stopped_at.append(clock())
            return execute(group, number, value)

        there._execute = noted  # type: ignore[method-assign] # when its stop comes
        async with aircraft.control() as control:
            with pytest.raises(MissionAborted):
                async with control.waypoint_mission(SLOW):
                    await asyncio.sleep(2.0)
                    there.missions.is_pushing = False
                    there._write(frame(b"\x02\x03\0\1\1\xd9\0\0"))
                    await asyncio.sleep(2.0)
            control.send(NORTH)  # nothing says that it flies
            there.missions.is_pushing = True
            await asyncio.sleep(0.15)
            left_at = clock()
        assert [at - left_at < 0.1 for at in stopped_at] == [True]
        await assert_stopped(there)


async def test_one_that_outlives_a_pause_by_the_pilot_is_stopped_with_the_block() -> None:
    """That a lost authority ends it is inferred; its stop was refused meanwhile."""
    async with foreign() as (there, aircraft):
        async with aircraft.control(on_pause="wait") as control:
            async with control.waypoint_mission(SLOW):
                await asyncio.sleep(2.0)
                there.missions.break_off = lambda reason: None  # type: ignore[method-assign] # not it
                there.leave_f()
                await asyncio.sleep(1.0)
            there.mode, there.device = MODE_F, ONBOARD
            await control.wait_resumable()
            control.resume()
            await asyncio.sleep(2.0)
        assert stops(there) == [0xD1, 0]
        await assert_rests(there)


async def test_a_mission_that_somebody_began_after_ours_is_not_stopped() -> None:
    async with foreign() as (there, aircraft):
        async with aircraft.control() as control:
            async with control.waypoint_mission(SLOW):
                await asyncio.sleep(2.0)
            await asyncio.sleep(5.0)
            start_from_a_phone(there)
            await asyncio.sleep(2.0)
        assert stops(there) == [0]


FLYING = frame(b"\x02\x03\1\0\1\0\0\0")
NOT_FLYING = [
    frame(b"\x02\x03" + status)
    for status in (
        b"\0\1\1\xd9\0\0",
        b"\0\1\0\0\0\0",
        b"\2\1\0\0\0\0",
        b"\3\0\0\0\0\0",
        b"\4\0\0\0\0\0",
    )
]


@pytest.mark.parametrize("seed", range(12))
async def test_false_pushes_among_the_true_ones_do_not_leave_it_in_flight(seed: int) -> None:
    dice = random.Random(seed)
    async with foreign(seed=seed) as (there, aircraft):

        async def mix() -> None:
            for _ in range(200):
                there._write(dice.choice([FLYING, *NOT_FLYING]))
                await asyncio.sleep(0.01)

        with suppress(MissionAborted):
            async with aircraft.control() as control, control.waypoint_mission(SLOW):
                await asyncio.sleep(dice.uniform(0.5, 2.0))
                mixing = asyncio.create_task(mix())
                await asyncio.sleep(dice.uniform(0.1, 3.0))
        await mixing
        await assert_stopped(there)


@pytest.mark.parametrize(
    "push", NOT_FLYING, ids=["broken off", "over", "hotpoint", "follow", "IOC"]
)
async def test_a_block_that_is_left_because_of_one_false_push_waits_for_the_next(
    push: bytes,
) -> None:
    async with foreign() as (there, aircraft):
        with suppress(MissionAborted):
            async with aircraft.control() as control, control.waypoint_mission(SLOW) as mission:
                await asyncio.sleep(2.0)
                there._write(push)
                async for _ in mission:
                    pass
        await assert_stopped(there)


async def test_one_that_is_over_delays_the_release_by_two_pushes_at_most() -> None:
    async with foreign() as (there, aircraft):
        with pytest.raises(MissionAborted):
            async with aircraft.control() as control, control.waypoint_mission(SLOW) as mission:
                await asyncio.sleep(2.0)
                there.missions.break_off(0xD9)
                broken_off_at = there.now()
                async for _ in mission:
                    pass
        assert stops(there) == []
        assert there.device != ONBOARD
        assert there.now() - broken_off_at < 0.5


async def test_one_that_is_pushed_on_behind_a_pilot_who_took_the_aircraft_is_stopped() -> None:
    async with foreign() as (there, aircraft):
        with pytest.raises(AuthorityLost):
            async with aircraft.control() as control, control.waypoint_mission(SLOW):
                await asyncio.sleep(2.0)
                there.missions.break_off = lambda reason: None  # type: ignore[method-assign] # not it
                there.missions.answers = {0x12: 0}
                there._write(NOT_FLYING[0])
                there.leave_f()
                await asyncio.sleep(9.0)
        assert stops(there) == [0]


# -- one push alone is not believed ----------------------------------------------------------------

LAST, FINISHED = b"\x02\x03\1\3\1\0\0\0", b"\x02\x04\1\0\0\0\0\0"
MOMENTS = [step * 0.01 for step in range(0, 32, 3)]  # from one push to the next, thrice
NONE = frame(b"\x02\x03" + bytes(6))


@pytest.mark.parametrize("at_end", list(AtEnd))
@pytest.mark.parametrize("seconds", [0.0, 0.05, 0.3, 2.0])
async def test_a_false_finished_behind_a_false_last_waypoint_does_not_leave_it_in_flight(
    at_end: AtEnd, seconds: float
) -> None:
    async with foreign() as (there, aircraft):
        async with aircraft.control() as control:
            async with control.waypoint_mission(plan(speed=1.0, at_end=at_end)) as mission:
                await asyncio.sleep(2.0)
                there._write(frame(LAST) + frame(FINISHED))
                async for event in mission:
                    if isinstance(event, Finished):
                        break
                else:
                    pytest.fail("not finished")
            await asyncio.sleep(seconds)
            if at_end is AtEnd.HOVER:  # it is reported as over: the status decides
                with pytest.raises(MissionRunning):
                    control.send(NORTH)
            else:
                assert stops(there) == [0]
        assert not there.movements
        await assert_stopped(there)


@pytest.mark.parametrize("at_end", list(AtEnd))
@pytest.mark.parametrize("seconds", [0.0, 0.05, 0.3, 2.0])
async def test_a_false_push_of_no_mission_does_not_leave_ours_in_flight(
    at_end: AtEnd, seconds: float
) -> None:
    """Whatever the plan has for its end: it has not come to it."""
    async with foreign() as (there, aircraft):
        async with aircraft.control() as control:
            async with control.waypoint_mission(plan(speed=1.0, at_end=at_end)):
                await asyncio.sleep(2.0)
                there._write(NONE)
                await asyncio.sleep(seconds)
        await assert_stopped(there)


@pytest.mark.parametrize("at_end", [AtEnd.GO_HOME, AtEnd.LAND])
async def test_one_false_standby_on_the_way_home_is_not_the_ground(at_end: AtEnd) -> None:
    async with foreign() as (there, aircraft):
        async with aircraft.control() as control:
            async with control.waypoint_mission(plan(at_end=at_end)) as mission:
                async for event in mission:
                    if isinstance(event, Finished):
                        there.status, there._lands_at = GOING_HOME, there.now() + 10.0
                    if isinstance(event, MissionProgress) and there.status == GOING_HOME:
                        tell_standby_once(there)
                        await asyncio.sleep(0.25)
                        there.items.add("status")
            assert there.status == STANDBY


@pytest.mark.parametrize("moment", MOMENTS)
@pytest.mark.parametrize("stop", ["hover", "land"])
@pytest.mark.parametrize("is_ours", [True, False])
async def test_one_false_push_of_no_mission_does_not_end_a_detached_one(
    moment: float, stop: StopAction, is_ours: bool
) -> None:
    async with foreign() as (there, aircraft):
        if not is_ours:
            start_from_a_phone(there)
            await asyncio.sleep(0.5)
        async with aircraft.control(stop=stop) as control:
            if is_ours:
                async with control.waypoint_mission(SLOW) as mission:
                    await asyncio.sleep(2.0)
                    mission.detach()
            else:
                control.detach_mission()
            asyncio.get_running_loop().call_later(moment, there._write, NONE)
            await asyncio.sleep(0.15)
        await asyncio.sleep(2.0)
        assert (there.missions.flying, there.device, there.tasks) == ("waypoint", ONBOARD, [])


@pytest.mark.parametrize("moment", MOMENTS)
@pytest.mark.parametrize("stop", ["hover", "land"])
async def test_one_false_push_of_no_mission_does_not_end_that_of_somebody_else(
    moment: float, stop: StopAction
) -> None:
    async with foreign() as (there, aircraft):
        start_from_a_phone(there)
        await asyncio.sleep(0.5)
        async with aircraft.control(stop=stop):
            asyncio.get_running_loop().call_later(moment, there._write, NONE)
            await asyncio.sleep(0.15)
        await asyncio.sleep(2.0)
        assert (there.missions.flying, there.device, there.tasks) == ("waypoint", ONBOARD, [])


@pytest.mark.parametrize("push", [NONE, *NOT_FLYING[2:]], ids=["none", "hotpoint", "follow", "IOC"])
async def test_beside_one_false_push_the_mission_is_refused_paused_and_stopped(
    push: bytes,
) -> None:
    async with foreign() as (there, aircraft):
        start_from_a_phone(there)
        await asyncio.sleep(0.5)
        async with aircraft.control() as control:
            there._write(push)
            await asyncio.sleep(0.005)
            with pytest.raises(MissionRunning):
                control.send(NORTH)
            assert await control.stop_mission() is MissionKind.WAYPOINT
        await assert_rests(there)


async def test_an_end_that_two_pushes_tell_is_believed() -> None:
    async with foreign() as (there, aircraft):
        start_from_a_phone(there)
        await asyncio.sleep(0.5)
        async with aircraft.control() as control:
            control.detach_mission()
            there.missions.break_off(0xD9)
            await asyncio.sleep(0.3)
            control.send(NORTH)
        assert there.device != ONBOARD


async def test_a_detached_mission_whose_end_is_reported_at_the_last_moment_keeps_no_authority() -> (
    None
):
    async with foreign() as (there, aircraft):
        async with aircraft.control() as control:
            async with control.waypoint_mission(SLOW) as mission:
                await asyncio.sleep(2.0)
                mission.detach()
            there.missions.break_off(0xD9)
            there._write(NONE)
        assert there.device != ONBOARD


async def test_a_pilot_who_took_the_aircraft_beside_one_false_push_finds_no_mission() -> None:
    async with foreign() as (there, aircraft):
        with pytest.raises((AuthorityLost, MissionAborted)):
            async with aircraft.control() as control, control.waypoint_mission(SLOW) as mission:
                await asyncio.sleep(2.0)
                there.missions.break_off = lambda reason: None  # type: ignore[method-assign] # not it
                there.missions.answers = {0x12: 0}
                there.leave_f()
                there._write(NONE)
                async for _ in mission:
                    pass
        assert stops(there) == [0]


@pytest.mark.parametrize("at_end", [AtEnd.GO_HOME, AtEnd.LAND])
async def test_one_false_standby_does_not_give_back_what_is_on_its_way_home(
    at_end: AtEnd,
) -> None:
    async with foreign() as (there, aircraft):
        async with aircraft.control() as control:
            async with control.waypoint_mission(plan(at_end=at_end)) as mission:
                async for event in mission:
                    if isinstance(event, Finished):
                        break
                there.status, there._lands_at = GOING_HOME, there.now() + 10.0
                await asyncio.sleep(0.5)
            asyncio.get_running_loop().call_later(0.1, there.items.add, "status")
            tell_standby_once(there)
        assert there.device == ONBOARD
