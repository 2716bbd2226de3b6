"""For every way in which a mission can end: the stop goes out, and nothing keeps flying.

The aircraft shares no line with the library or its simulator.
"""

from __future__ import annotations

import asyncio
import logging
from types import SimpleNamespace
from typing import Any, cast

import pytest

from m100link import (
    Aborted,
    AckTimeout,
    Aircraft,
    AtEnd,
    AuthorityLost,
    Control,
    Finished,
    LinkClosed,
    LinkLost,
    MissionAborted,
    MissionKind,
    MissionRefused,
    NotObserved,
    Reached,
    Started,
    TelemetryStalled,
    UsageError,
)
from m100link.flight.missions import mission_session
from m100link.flight.missions.events import RunState
from m100link.flight.missions.mission_session import MissionSession
from tests.flight.foreign_aircraft import (
    GOING_HOME,
    LANDING,
    ONBOARD,
    STANDBY,
    ForeignInMemory,
    frame,
)
from tests.flight.missions.foreign import assert_rests, foreign, orders, plan
from tests.rig import NORTH

pytestmark = pytest.mark.anyio

SLOW = plan(speed=1.0)
CODE_ALONE = b"\xaa\x11\x00"  # how the ack of a start, stop or pause begins


async def fly_on(aircraft: Aircraft, stop: str = "hover") -> None:
    """A program that watches its mission and never expects anything."""
    async with aircraft.control(stop="land" if stop == "land" else "hover") as control:
        async with control.waypoint_mission(SLOW) as mission:
            async for _ in mission:
                pass


async def begun(
    there: ForeignInMemory, aircraft: Aircraft, stop: str = "hover"
) -> asyncio.Task[None]:
    task = asyncio.create_task(fly_on(aircraft, stop))
    await asyncio.sleep(4.0)
    assert there.missions.flying
    return task


def stops(there: ForeignInMemory) -> list[int | None]:
    """What the stops were answered."""
    found = there.missions.orders
    return [order.answer for order in found if (order.number, order.value) == (0x12, b"\1")]


async def assert_stopped(there: ForeignInMemory) -> None:
    """By our stop; authority was given back."""
    assert stops(there)[0] == 0
    assert there.device != ONBOARD
    await assert_rests(there)


# -- endings of the program -----------------------------------------------------------------------


@pytest.mark.parametrize("stop", ["hover", "land"])
async def test_an_exception_stops_it(stop: str) -> None:
    async with foreign() as (there, aircraft):
        with pytest.raises(ZeroDivisionError):
            async with aircraft.control(stop="land" if stop == "land" else "hover") as control:
                async with control.waypoint_mission(SLOW):
                    await asyncio.sleep(2.0)
                    raise ZeroDivisionError
        await assert_stopped(there)
        assert there.tasks == ([6] if stop == "land" else [])


@pytest.mark.parametrize("stop", ["hover", "land"])
async def test_a_cancellation_stops_it(stop: str) -> None:
    async with foreign() as (there, aircraft):
        task = await begun(there, aircraft, stop)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        await assert_stopped(there)
        assert there.tasks == ([6] if stop == "land" else [])


async def test_a_second_cancellation_does_not_spare_it_the_stop() -> None:
    async with foreign() as (there, aircraft):
        task = await begun(there, aircraft)
        there.is_deaf = True
        task.cancel()
        for _ in range(10):
            await asyncio.sleep(0.02)
            task.cancel()
        there.is_deaf = False
        with pytest.raises(asyncio.CancelledError):
            await task
        await assert_stopped(there)


@pytest.mark.parametrize("moment", [step * 0.05 for step in range(20)])
async def test_a_cancellation_at_any_moment_of_the_beginning_leaves_nothing_in_flight(
    moment: float,
) -> None:
    async with foreign(seed=int(moment * 100)) as (there, aircraft):
        there.loss = 0.2
        task = asyncio.create_task(fly_on(aircraft))
        await asyncio.sleep(moment)
        task.cancel()
        there.loss = 0.0
        with pytest.raises(asyncio.CancelledError):
            await task
        await assert_rests(there)


async def test_closing_the_connection_stops_it() -> None:
    async with foreign() as (there, aircraft):
        task = await begun(there, aircraft)
        await aircraft.aclose()
        await assert_stopped(there)
        with pytest.raises(LinkClosed):
            await task


async def test_a_signal_stops_it() -> None:
    async with foreign() as (there, aircraft):
        controls: list[Control] = []

        async def program() -> None:
            async with aircraft.control() as control:
                controls.append(control)
                async with control.waypoint_mission(SLOW) as mission:
                    async for _ in mission:
                        pass

        task = asyncio.create_task(program())
        await asyncio.sleep(4.0)
        controls[0].interrupt()  # what a signal does
        with pytest.raises(asyncio.CancelledError):
            await task
        await assert_stopped(there)


async def test_control_by_hand_stops_it_at_its_release() -> None:
    async with foreign() as (there, aircraft):
        control = await aircraft.control().obtain()
        mission = control.waypoint_mission(SLOW)
        await mission.__aenter__()
        await asyncio.sleep(2.0)
        await control.release()
        await assert_stopped(there)
        assert mission.is_over


async def test_a_program_that_swallows_its_cancellation_cannot_keep_it_in_flight() -> None:
    async with foreign() as (there, aircraft):
        with pytest.raises(TelemetryStalled):
            async with aircraft.control() as control, control.waypoint_mission(SLOW):
                await asyncio.sleep(2.0)
                there.is_mute = True
                try:
                    await asyncio.sleep(60.0)
                except asyncio.CancelledError:
                    await asyncio.sleep(60.0)
                    assert not there.missions.flying


# -- endings of others ----------------------------------------------------------------------------


@pytest.mark.parametrize("taken_by", ["pilot", "app"])
async def test_anybody_who_takes_the_aircraft_ends_it(taken_by: str) -> None:
    async with foreign() as (there, aircraft):
        task = await begun(there, aircraft)
        there.items.add("device")
        await asyncio.sleep(0.5)
        if taken_by == "pilot":
            there.leave_f()
        else:
            there.take_by_app()
        with pytest.raises(AuthorityLost) as caught:
            await task
        assert caught.value.reason == ("mode_switch" if taken_by == "pilot" else "app")
        assert stops(there) == [], "the taker flies it"
        await assert_rests(there)


@pytest.mark.parametrize("is_pushing", [True, False])
async def test_an_aircraft_that_flies_its_mission_on_without_authority_is_stopped(
    is_pushing: bool,
) -> None:
    """What a lost authority does to a mission is inferred."""
    async with foreign() as (there, aircraft):
        task = await begun(there, aircraft)
        there.missions.break_off = lambda reason: None  # type: ignore[method-assign] # it does not
        there.missions.answers = {0x12: 0}  # nor minds
        there.missions.is_pushing = is_pushing
        there.leave_f()
        with pytest.raises(AuthorityLost):
            await task
        assert stops(there) == [0]


@pytest.mark.parametrize("status", [LANDING, GOING_HOME])
async def test_a_failsafe_on_its_way_is_not_called_off(status: int) -> None:
    """The flight status does not tell of going home; the stored mission is gone, and says so."""
    async with foreign() as (there, aircraft):
        task = await begun(there, aircraft)
        there.missions.is_pushing = False
        there.status = status
        await asyncio.sleep(0.2)
        there.leave_f()
        there.missions.mission = b""
        with pytest.raises(AuthorityLost):
            await task
        assert stops(there) == []


async def test_a_pilot_who_is_waited_for_finds_no_mission_that_goes_on() -> None:
    async with foreign() as (there, aircraft):
        async with aircraft.control(on_pause="wait") as control:
            last: object = None
            with pytest.raises(MissionAborted) as caught:
                async with control.waypoint_mission(SLOW) as mission:
                    await asyncio.sleep(2.0)
                    there.leave_f()
                    async for event in mission:
                        last = event
            assert isinstance(last, Aborted)
            assert caught.value.code == 0xD0
            assert control.is_paused


@pytest.mark.parametrize("stop", ["hover", "land"])
async def test_an_aircraft_that_is_not_heard_any_more_is_stopped(
    stop: str, caplog: pytest.LogCaptureFixture
) -> None:
    async with foreign() as (there, aircraft):
        task = await begun(there, aircraft, stop)
        there.is_mute = True
        with pytest.raises(TelemetryStalled):
            await task
        await assert_stopped(there)
        assert "was not answered" in caplog.text
        assert set(there.tasks) == ({6} if stop == "land" else set())


async def test_a_cable_that_is_pulled_leaves_it_in_flight_and_says_so(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with foreign() as (there, aircraft):
        task = await begun(there, aircraft)
        there.unplug()
        with pytest.raises(LinkLost) as caught:
            await task
        assert "flies on by itself" in caught.value.remedy
        assert "flies on by itself" in caplog.text
        assert there.missions.flying, "nobody can tell it to stop"


async def test_an_aircraft_that_hears_nothing_is_not_said_to_have_stopped() -> None:
    async with foreign() as (there, aircraft):
        with pytest.raises(AckTimeout, match="may be flying it on"):
            async with aircraft.control() as control, control.waypoint_mission(SLOW):
                await asyncio.sleep(2.0)
                there.is_deaf = True


def lose_short_acks(there: ForeignInMemory) -> None:
    """Acks that are a code alone do not arrive any more; waypoints have longer ones."""
    write = type(there)._write

    def lossy(data: bytes) -> None:
        if data[:3] != CODE_ALONE or not data[3] & 0x20:
            write(there, data)

    there._write = lossy  # type: ignore[method-assign] # a line that is bad in one way


async def test_a_stop_whose_answer_is_lost_is_seen_in_the_pushes() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        async with control.waypoint_mission(SLOW) as mission:
            await asyncio.sleep(2.0)
            lose_short_acks(there)
            await mission.stop()
            assert mission.is_over
            del there._write
        await assert_rests(there)


async def test_a_stop_that_is_refused_is_an_error_and_is_tried_again() -> None:
    async with foreign() as (there, aircraft):
        with pytest.raises(MissionRefused) as caught:
            async with aircraft.control() as control, control.waypoint_mission(SLOW):
                await asyncio.sleep(2.0)
                there.missions.answers[0x12] = 0x42
        assert caught.value.code == 0x42
        assert stops(there) == [0x42, 0x42]


async def test_a_start_that_is_not_answered_is_stopped() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        start = there.missions._start

        def start_unheard(status: int) -> int:
            lose_short_acks(there)
            return start(status)

        there.missions._start = start_unheard  # type: ignore[method-assign] # see above
        with pytest.raises(AckTimeout):
            async with control.waypoint_mission(SLOW):
                pytest.fail("entered")
        assert stops(there)[0] == 0
        del there._write
        await assert_rests(there)


@pytest.mark.parametrize("moment", ["start", "flight"])
@pytest.mark.parametrize("at_end", [AtEnd.HOVER, AtEnd.GO_HOME])
async def test_finished_of_a_mission_before_does_not_leave_it_in_flight(
    moment: str, at_end: AtEnd
) -> None:
    late = frame(b"\x02\x04\1\0\0\0\0\0") + frame(b"\x02\x03\0\1\0\0\0\0")
    async with foreign() as (there, aircraft), aircraft.control() as control:
        start = there.missions._start

        def start_late(status: int) -> int:
            there._write(late)
            return start(status)

        if moment == "start":
            there.missions._start = start_late  # type: ignore[method-assign] # see above
        async with control.waypoint_mission(plan(speed=1.0, at_end=at_end)) as mission:
            await asyncio.sleep(1.0)
            if moment == "flight":
                there._write(late[:24])
            await asyncio.sleep(1.0)
            assert not mission.is_over
        assert not there.missions.flying
        await assert_rests(there)


# -- endings of the aircraft ----------------------------------------------------------------------


@pytest.mark.parametrize("reason", [0xD9, 0xF1, 0xF2, 0x00])
async def test_what_the_aircraft_breaks_off_is_raised_with_its_reason(reason: int) -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        with pytest.raises(MissionAborted) as caught:
            async with control.waypoint_mission(SLOW) as mission:
                await asyncio.sleep(2.0)
                there.missions.break_off(reason)
                async for _ in mission:
                    pass
        assert caught.value.code == (reason or None)
        assert caught.value.index == 0
        assert stops(there) == [], "there is nothing to stop"
        control.send(NORTH)


async def test_a_program_that_does_not_look_gets_the_error_when_it_leaves() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        with pytest.raises(MissionAborted):
            async with control.waypoint_mission(SLOW):
                await asyncio.sleep(2.0)
                there.missions.break_off(0xD9)
                await asyncio.sleep(2.0)


async def test_orders_to_one_that_was_broken_off_raise_the_reason() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        async with control.waypoint_mission(SLOW) as mission:
            await asyncio.sleep(1.0)
            there.missions.break_off(0xD9)
            await asyncio.sleep(1.0)
            with pytest.raises(MissionAborted):
                await mission.pause()
        with pytest.raises(UsageError, match="entered before"):
            await mission.__aenter__()


@pytest.mark.parametrize("at_end", [AtEnd.GO_HOME, AtEnd.LAND])
async def test_an_end_on_the_ground_is_waited_for(at_end: AtEnd) -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        async with control.waypoint_mission(plan(at_end=at_end)) as mission:
            events = [event async for event in mission]
        assert Finished() in events
        assert there.status == STANDBY
        assert stops(there) == []


async def test_an_endless_mission_is_stopped_when_it_is_left() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        async with control.waypoint_mission(plan(at_end=AtEnd.ENDLESS)) as mission:
            async for event in mission:
                if isinstance(event, Finished):
                    break
            assert there.missions.flying
        assert not there.missions.flying


async def test_without_pushes_it_is_asked_and_the_box_in_the_assistant_is_named_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        there.missions.is_pushing = False
        async with control.waypoint_mission(plan()) as mission:
            events = [type(event) async for event in mission]
        assert events.count(Started) == events.count(Finished) == 1
        assert caplog.text.count("Ground Station Status") == 1
        assert 5 < len(orders(there, 0x14)) < 60
        assert stops(there) == []


@pytest.mark.parametrize("seed", range(10))
async def test_on_a_bad_line_everything_happens_once_and_in_order(
    seed: int, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.ERROR)
    async with foreign(seed=seed) as (there, aircraft), aircraft.control() as control:
        there.loss = 0.1
        async with control.waypoint_mission(plan()) as mission:
            reached = [event.index async for event in mission if isinstance(event, Reached)]
        assert reached == there.missions.reached == [0, 1, 2, 3]
        await assert_rests(there)


async def test_a_bug_in_the_watch_ends_the_flight(monkeypatch: pytest.MonkeyPatch) -> None:
    async with foreign() as (there, aircraft):
        with pytest.raises(Exception, match="nobody watches"):
            async with aircraft.control() as control:
                async with control.waypoint_mission(SLOW) as mission:
                    monkeypatch.setattr(mission._track, "progress", None)
                    async for _ in mission:
                        pass
        await assert_rests(there)


@pytest.mark.parametrize(
    ("state", "is_asked"), [(RunState.ENDING, True), (RunState.RETURNING, False)]
)
async def test_on_its_way_home_it_is_not_asked_about_a_mission_that_is_over(
    state: RunState, is_asked: bool
) -> None:
    asked: list[object] = []

    async def execute(question: object, **_: object) -> None:
        asked.append(question)

    requests = SimpleNamespace(execute=execute)
    one: Any = SimpleNamespace(
        state=state,
        _track=SimpleNamespace(poll="how far?", polled=lambda _: []),
        _context=SimpleNamespace(commander=SimpleNamespace(requests=requests)),
        _apply=lambda _: None,
    )
    await MissionSession.ask(one)
    assert asked == ["how far?"] * is_asked


@pytest.mark.parametrize("is_replaced", [True, False])
def test_what_ends_lets_go_of_the_pushes_that_nobody_newer_hears(*, is_replaced: bool) -> None:
    def on_push(_: object) -> None: ...

    def newer(_: object) -> None: ...

    missions = SimpleNamespace(listener=newer if is_replaced else on_push)
    context = SimpleNamespace(commander=SimpleNamespace(missions=missions))
    MissionSession._let_go(
        cast(Any, SimpleNamespace(_context=context, _on_push=on_push, _watching=None))
    )
    assert missions.listener is (newer if is_replaced else None)


@pytest.mark.parametrize("slack_s", [0.0, 1.5])
async def test_a_pause_has_to_hover_for_a_while_within_six_seconds(
    slack_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And the slack of a slow line; it hovers when it was slow for 0.4 s."""
    loop = asyncio.get_running_loop()
    link = SimpleNamespace(loop=loop, latency=SimpleNamespace(slack_s=slack_s))
    commander: Any = SimpleNamespace(link=link, state=SimpleNamespace(situation=dict))
    stops_at = 2.0

    def velocity(*_: object) -> SimpleNamespace:
        is_slow = 0.1 <= loop.time() - began < 0.3 or loop.time() - began >= stops_at
        return SimpleNamespace(ground_speed_m_s=0.0 if is_slow else 3.0, up_m_s=0.0)

    monkeypatch.setattr(mission_session, "known", velocity)
    began = loop.time()
    await mission_session._require_hover(commander, MissionKind.WAYPOINT)
    assert 0.0 <= loop.time() - began - stops_at - 0.2 <= 0.4, "looked at each 0.2 s"
    began, stops_at = loop.time(), 99.0
    with pytest.raises(NotObserved):
        await mission_session._require_hover(commander, MissionKind.WAYPOINT)
    assert 0.0 <= loop.time() - began - 6.0 - slack_s <= 0.3
