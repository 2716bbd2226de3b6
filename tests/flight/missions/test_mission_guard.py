"""A mission that somebody else started: found, refused beside, stopped, left in flight by name."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import pytest

from m100link import (
    AckTimeout,
    AuthorityLost,
    Control,
    LinkLost,
    LossReason,
    MissionKind,
    MissionRefused,
    MissionRunning,
    NotObserved,
    UsageError,
    Waypoint,
    WaypointFlight,
    WaypointPlan,
)
from m100link.flight.authority import AuthorityState
from m100link.flight.mission_state import MissionWatch
from m100link.flight.missions.events import (
    IN_THE_AIR,
    ORDERS,
    OWES_A_STOP,
    TRANSITIONS,
    RunInput,
    RunState,
)
from m100link.flight.missions.mission_guard import MissionGuard
from m100link.flight.stop_path import StopAction
from m100link.geodesy import LocalFrame
from m100link.protocol.codes import MissionCode
from m100link.protocol.commands.missions import HotpointStatus, IdleStatus, MissionStatus, Status
from tests.flight.foreign_aircraft import ONBOARD, ForeignInMemory
from tests.flight.missions.foreign import assert_rests, foreign, orders, plan
from tests.rig import NORTH, Rig, rig

pytestmark = pytest.mark.anyio


def start_from_a_phone(there: ForeignInMemory) -> None:
    """A mission that no program of ours knows."""
    mission, points = plan().to_wire()
    missions = there.missions
    missions.mission = struct.pack("<Bff", mission.count, 10.0, 1.0) + bytes(42)
    firmware = None
    for point in points:
        value = point.value(firmware)  # type: ignore[arg-type] # the layout is that of every one
        missions.points[point.index] = value
    missions.speed, missions.flying = 1.0, "waypoint"


async def test_a_mission_that_runs_already_is_found_and_setpoints_are_refused() -> None:
    async with foreign() as (there, aircraft):
        assert aircraft.mission.kind is MissionKind.NONE
        start_from_a_phone(there)
        await asyncio.sleep(0.5)
        found = aircraft.mission
        assert (found.kind, found.index, found.is_running) == (MissionKind.WAYPOINT, 0, True)
        async with aircraft.control() as control:
            with pytest.raises(MissionRunning, match="this block did not start it"):
                control.send(NORTH)
            with pytest.raises(MissionRunning):
                async with control.waypoint_mission(plan()):
                    pytest.fail("entered")
            assert await control.stop_mission() is MissionKind.WAYPOINT
            control.send(NORTH)
        await assert_rests(there)


async def test_a_mission_is_left_in_flight_once_and_for_the_first_reason(
    caplog: pytest.LogCaptureFixture,
) -> None:
    guard, told = MissionGuard(cast(Any, SimpleNamespace(missions=None))), list[object]()
    guard.give_up(None, "there is none")
    assert (guard.left_in_flight, caplog.text) == ("", "")
    guard._run = cast(Any, SimpleNamespace(name="orbit", is_in_the_air=True, give_up=told.append))
    first, then = AuthorityLost("lost", reason=LossReason.UNKNOWN), LinkLost("pulled")
    guard.give_up(first, "its plan orders that for a lost RC")
    guard.give_up(then, "no stop can reach it")
    assert (guard.left_in_flight, told) == ("orbit", [first])
    assert [one.message for one in caplog.records] == [
        "the orbit flies on by itself: its plan orders that for a lost RC"
    ]


@pytest.mark.parametrize("is_ours", [True, False])
async def test_control_stop_lets_the_aircraft_hover_whatever_flies_it(is_ours: bool) -> None:
    async with foreign() as (there, aircraft):
        if not is_ours:
            start_from_a_phone(there)
            await asyncio.sleep(0.5)
        async with aircraft.control() as control:
            if is_ours:
                async with control.waypoint_mission(plan(speed=1.0)) as mission:
                    await asyncio.sleep(2.0)
                    await control.stop()
                    assert mission.is_over
            else:
                await control.stop()
            assert not there.missions.flying
            control.send(NORTH)
        await assert_rests(there)


async def test_one_that_is_not_ours_is_not_stopped_by_leaving_control() -> None:
    async with foreign() as (there, aircraft):
        start_from_a_phone(there)
        await asyncio.sleep(0.5)
        async with aircraft.control() as control:
            assert await control.pause_mission() is MissionKind.WAYPOINT
            assert control.detach_mission() is MissionKind.WAYPOINT
        assert orders(there, 0x12, 0x13) == [(0x13, 0)]
        assert there.missions.flying
        assert there.device == ONBOARD


async def test_where_nothing_is_pushed_every_kind_is_stopped() -> None:
    async with foreign() as (there, aircraft):
        there.missions.is_pushing = False
        start_from_a_phone(there)
        async with aircraft.control() as control:
            assert await control.stop_mission() is MissionKind.WAYPOINT
            assert await control.stop_mission() is MissionKind.NONE
            with pytest.raises(UsageError, match="Ground Station Status"):
                await control.pause_mission()
            with pytest.raises(UsageError):
                control.detach_mission()
        assert orders(there)[:3] == [(0x12, 0), (0x21, 0xD4), (0x31, 0xD4)]
        await assert_rests(there)


async def test_a_detached_mission_flies_on_and_is_found_by_the_next_block() -> None:
    async with foreign() as (there, aircraft):
        async with aircraft.control(stop="land") as control:
            async with control.waypoint_mission(plan(speed=1.0)) as mission:
                await asyncio.sleep(2.0)
                mission.detach()
                assert [type(event).__name__ async for event in mission]
        assert there.missions.flying
        assert aircraft.authority.state is AuthorityState.HELD
        assert not there.tasks
        async with aircraft.control() as control:
            assert aircraft.mission.is_running
            assert await control.stop_mission() is MissionKind.WAYPOINT
        await assert_rests(there)
        assert there.device != ONBOARD


async def test_one_that_was_detached_and_has_ended_leaves_an_ordinary_end() -> None:
    async with foreign() as (there, aircraft):
        async with aircraft.control() as control:
            async with control.waypoint_mission(plan()) as mission:
                mission.detach()
            await asyncio.sleep(60.0)
            assert not there.missions.flying
            control.send(NORTH)
        assert there.device != ONBOARD


async def test_one_that_was_detached_and_then_stopped_does_not_keep_authority() -> None:
    async with foreign() as (there, aircraft):
        there.missions.is_pushing = False
        async with aircraft.control() as control:
            async with control.waypoint_mission(plan(speed=1.0)) as mission:
                await asyncio.sleep(1.0)
                mission.detach()
            await control.stop_mission()
        assert there.device != ONBOARD
        await assert_rests(there)


@pytest.mark.parametrize("stop", ["hover", "land"])
async def test_what_was_refused_beside_a_mission_of_somebody_else_does_not_end_it(
    stop: StopAction, caplog: pytest.LogCaptureFixture
) -> None:
    async with foreign() as (there, aircraft):
        start_from_a_phone(there)
        await asyncio.sleep(0.5)
        with pytest.raises(MissionRunning):
            async with aircraft.control(stop=stop) as control:
                await control.take_off()
        await asyncio.sleep(2.0)
        assert there.missions.flying
        assert there.device == ONBOARD
        assert not there.tasks
        assert "authority is not given back" in caplog.text


async def test_a_take_off_beside_a_mission_is_not_first_a_matter_of_the_battery() -> None:
    async with foreign() as (there, aircraft):
        there.battery = 10
        start_from_a_phone(there)
        await asyncio.sleep(0.5)
        async with aircraft.control() as control:
            with pytest.raises(MissionRunning):
                await control.take_off()


async def test_a_detached_mission_is_not_broken_off_by_a_later_block() -> None:
    async with foreign() as (there, aircraft):
        async with aircraft.control() as control:
            async with control.waypoint_mission(plan(speed=1.0)) as mission:
                mission.detach()
        await asyncio.sleep(2.0)
        async with aircraft.control():
            pass
        await asyncio.sleep(2.0)
        assert there.missions.flying
        assert aircraft.authority.state is AuthorityState.HELD


async def test_a_block_that_could_not_be_entered_does_not_give_back_what_another_obtained() -> None:
    async with foreign() as (there, aircraft):
        start_from_a_phone(there)
        await asyncio.sleep(0.5)
        async with aircraft.control():
            pass
        execute = there._execute

        def unheard(group: int, number: int, value: bytes) -> bytes | None:
            answer = execute(group, number, value)
            return None if (group, number, value) == (1, 0, b"\1") else answer

        there._execute = unheard  # type: ignore[method-assign] # the ack is lost
        with pytest.raises(AckTimeout):
            async with aircraft.control():
                pytest.fail("entered")
        assert there.missions.flying
        assert there.device == ONBOARD


async def test_one_of_somebody_else_that_was_stopped_in_vain_does_not_keep_authority() -> None:
    async with foreign() as (there, aircraft):
        start_from_a_phone(there)
        await asyncio.sleep(0.5)
        there.missions.answers = {0x12: 0xD4}  # none is running, it says, and pushes that one is
        async with aircraft.control() as control:
            assert await control.stop_mission() is MissionKind.NONE
        assert there.device != ONBOARD


@pytest.mark.parametrize("answer", [0xD4, 0xFE])
async def test_a_landing_is_not_kept_from_an_aircraft_that_did_not_stop(answer: int) -> None:
    async with foreign() as (there, aircraft):
        start_from_a_phone(there)
        await asyncio.sleep(0.5)
        there.missions.answers = {0x12: answer}
        async with aircraft.control() as control:
            with pytest.raises(MissionRunning, match="a phone did"):
                await control.land()
            assert not there.tasks
            with suppress(MissionRefused):
                await control.stop_mission()
            with pytest.raises(MissionRunning):
                control.send(NORTH)
            await control.land()
        assert there.tasks


async def test_a_detached_mission_is_called_that_where_something_is_refused_beside_it() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        async with control.waypoint_mission(plan(speed=1.0)) as mission:
            await asyncio.sleep(1.0)
            mission.detach()
        with pytest.raises(MissionRunning, match="it was detached"):
            control.send(NORTH)
        assert there.missions.flying


# -- an ack alone stops and pauses nothing ---------------------------------------------------------


def away(flown: Rig, north: float) -> tuple[float, float]:
    """Latitude and longitude of a place so many metres to the north, °."""
    here = flown.aircraft.state.position
    assert here is not None
    return LocalFrame(here.latitude_deg, here.longitude_deg).to_geodetic(north, 0.0)


def circle_around(flown: Rig) -> dict[str, Any]:
    latitude, longitude = away(flown, 10.0)
    center = {"latitude_deg": latitude, "longitude_deg": longitude}
    return {**center, "height": 10.0, "radius": 10.0, "rate_deg_s": 15.0}


@asynccontextmanager
async def disobedient(
    monkeypatch: pytest.MonkeyPatch, what: str
) -> AsyncIterator[tuple[Rig, Control, WaypointFlight]]:
    """An aircraft that flies a mission; it takes an order about it, and flies on."""
    async with rig(firmware="3.1") as flown, flown.aircraft.control() as control:
        await control.take_off()
        ways = [Waypoint(*away(flown, north), height=10.0) for north in (120.0, 140.0)]
        plan = WaypointPlan(ways, speed=5.0)
        async with control.waypoint_mission(plan) as mission:
            await asyncio.sleep(12.0)
            assert flown.speed > 3.0
            with monkeypatch.context() as patched:
                missions = flown.virtual.vehicle.missions
                patched.setattr(missions, what, lambda *_: MissionCode.SUCCESS)
                yield flown, control, mission


@pytest.mark.parametrize("by", ["mission", "control"])
async def test_a_pause_that_is_taken_and_not_carried_out_raises(
    by: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with disobedient(monkeypatch, "pause") as (flown, control, mission):
        pause = mission.pause if by == "mission" else control.pause_mission
        with pytest.raises(NotObserved, match=r"took the pause .* flies on at 5\.\d m/s"):
            await pause()
        assert not mission.is_paused
        assert flown.speed > 3.0


async def test_a_pause_is_done_when_it_hovers() -> None:
    async with rig(firmware="3.1") as flown, flown.aircraft.control() as control:
        await control.take_off()
        async with control.hotpoint(**circle_around(flown)) as circle:
            await asyncio.sleep(12.0)
            await circle.pause()
            assert flown.speed < 1.0


@pytest.mark.parametrize("by", ["mission", "control"])
async def test_a_stop_that_is_taken_and_not_carried_out_raises(
    by: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with disobedient(monkeypatch, "stop") as (flown, control, mission):
        stop = mission.stop if by == "mission" else control.stop_mission
        began_at = flown.now
        with pytest.raises(NotObserved, match=r"took the stop .* reports it still"):
            await stop()
        assert flown.now - began_at < 2.5
        assert flown.speed > 3.0


async def test_a_stop_that_is_carried_out_waits_for_two_pushes_only() -> None:
    async with rig(firmware="3.1") as flown, flown.aircraft.control() as control:
        await control.take_off()
        async with control.hotpoint(**circle_around(flown)) as circle:
            await asyncio.sleep(12.0)
            began_at = flown.now
            await circle.stop()
            assert flown.now - began_at < 0.6


# -- each state of ours, beside what is pushed of somebody else's ----------------------------------


class Ours:
    """A waypoint mission in a state; ``told`` has the orders that it gets."""

    kind, name, started_at = MissionKind.WAYPOINT, MissionKind.WAYPOINT.value, 100.0
    flies_all_the_same = False

    def __init__(self, state: RunState) -> None:
        self.state, self.told = state, list[str]()
        self.is_in_the_air, self.owes_a_stop = state in IN_THE_AIR, state in OWES_A_STOP

    async def order(self, what: str) -> None:
        self.told.append(what)

    def feed(self, what: RunInput) -> None:
        self.state = TRANSITIONS[self.state][what]

    async def stop(self) -> None:
        self.told.append("stop")

    async def stop_seen(self) -> None:
        self.told.append("stop, seen")

    def detach(self) -> None:
        self.told.append("detach")


class Beside:
    """A guard with a mission of its own, or none, and pushes of somebody's hotpoint, or none."""

    def __init__(self, state: RunState | None, *, is_pushed: bool, slack_s: float = 0.0) -> None:
        self.now, self.sent, self.answer = 100.2, list[Any](), MissionCode.SUCCESS
        self.ours = None if state is None else Ours(state)
        self.watch = MissionWatch(lambda: self.now)
        if is_pushed:
            self.push(HotpointStatus(1, radius_cm=1000), 100.0)
            self.push(HotpointStatus(1, radius_cm=1000), 100.1)
        loop = SimpleNamespace(time=lambda: self.now)
        link = SimpleNamespace(loop=loop, latency=SimpleNamespace(slack_s=slack_s))
        commander = SimpleNamespace(missions=self.watch, link=link, requests=self)
        commander.state = SimpleNamespace(fresh=lambda record, within=None: None)
        self.guard = MissionGuard(cast(Any, commander))
        self.guard._run = cast(Any, self.ours)

    def push(self, status: Status, at: float) -> None:
        self.watch.on_status(MissionStatus(status), at)

    async def execute(self, request: Any, **_: object) -> MissionCode:
        self.sent.append(request)
        return self.answer


@pytest.mark.parametrize(
    ("slack_s", "since", "is_of_another"),
    [(0.0, 102.9, False), (0.0, 103.1, True), (0.5, 103.4, False), (0.5, 103.6, True)],
)
def test_pushes_within_three_seconds_of_a_stop_tell_of_what_it_ended(
    slack_s: float, since: float, *, is_of_another: bool
) -> None:
    beside = Beside(None, is_pushed=False, slack_s=slack_s)
    beside.guard._stop_asked_at = 100.0
    for at in (since, since + 0.1):
        beside.push(HotpointStatus(1, radius_cm=1000), at)
    beside.now = since + 0.2
    assert beside.guard.is_of_another is is_of_another


@pytest.mark.parametrize("is_pushed", [True, False], ids=["pushed", "silent"])
@pytest.mark.parametrize("state", [None, *RunState], ids=str)
async def test_who_flies_what_is_owed_and_who_is_told(
    state: RunState | None, *, is_pushed: bool
) -> None:
    """Ours while it may be in the air, else what is pushed, which is somebody else's."""
    beside = Beside(state, is_pushed=is_pushed)
    guard, ours = beside.guard, beside.ours
    is_ours = state in IN_THE_AIR
    flies = "waypoint mission" if is_ours else "hotpoint" if is_pushed else ""
    assert guard.flying == flies
    assert guard.is_of_another is (is_pushed and not is_ours)
    owed = state is RunState.READY or state in OWES_A_STOP
    assert guard.to_stop is (MissionKind.WAYPOINT if owed else None)
    assert guard.lands_by_plan is (state is RunState.RETURNING)
    assert guard.is_detached is (state is RunState.DETACHED)

    for is_landing in (False, True):
        # A landing is the last means against a mission that a stop did not end.
        if flies and not (is_landing and state is RunState.UNSTOPPED):
            with pytest.raises(MissionRunning, match=f"while a {flies} flies") as caught:
                guard.require_none("a take-off", is_landing=is_landing)
            assert caught.value.remedy.count("mission.stop()" if is_ours else "stop_mission()") == 1
        else:
            guard.require_none("a take-off", is_landing=is_landing)

    if state is RunState.READY and not is_pushed:
        with pytest.raises(UsageError, match="another mission is being prepared"):
            guard.claim(cast(Any, Ours(RunState.READY)))
        assert cast(Any, guard._run) is ours
    if is_ours:
        assert ours is not None
        assert await guard.order_any("pause") is MissionKind.WAYPOINT
        assert await guard.stop_any() is await guard.stopped_any() is MissionKind.WAYPOINT
        assert guard.detach_any() is MissionKind.WAYPOINT
        assert ours.told == ["pause", "stop", "stop, seen", "detach"]
        assert beside.sent == []
    elif is_pushed:
        hotpoint = ORDERS[MissionKind.HOTPOINT]
        assert await guard.order_any("resumption") is MissionKind.HOTPOINT
        assert guard.detach_any() is MissionKind.HOTPOINT
        assert guard.is_detached
        assert await guard.stop_any() is MissionKind.HOTPOINT
        assert not beside.guard.is_detached, "what was stopped is not left in flight"
        assert beside.sent == [hotpoint.resumption, hotpoint.stop]
    else:
        with pytest.raises(UsageError, match="no mission flies"):
            await guard.order_any("pause")
        with pytest.raises(UsageError, match="no mission that could be detached"):
            guard.detach_any()
        assert beside.sent == []
        await guard.stop_any()
        assert beside.sent == [orders.stop for orders in ORDERS.values()]
    assert ours is None or is_ours or ours.told == []
    if ours is not None and state is RunState.READY:
        assert ours.state is RunState.OVER, "what is being prepared does not begin behind a stop"


@pytest.mark.parametrize("pushed_at", [100.0, 102.9, 103.1, 110.0])
async def test_what_is_pushed_3_s_after_a_stop_is_another_mission(pushed_at: float) -> None:
    beside = Beside(None, is_pushed=False)
    beside.now = 100.0
    await beside.guard.stop_any()
    for at in (pushed_at, pushed_at + 0.1):
        beside.push(HotpointStatus(1, radius_cm=1000), at)
    beside.now = pushed_at + 0.2
    is_of_another = pushed_at > 103.0
    assert beside.guard.is_of_another is is_of_another
    if is_of_another:
        with pytest.raises(MissionRunning, match="a phone did"):
            beside.guard.require_none("a landing", is_landing=True)
    else:
        beside.guard.require_none("a landing", is_landing=True)


@pytest.mark.parametrize("slack_s", [0.0, 0.5])
async def test_what_was_detached_is_left_in_flight_until_pushes_tell_its_end(
    slack_s: float,
) -> None:
    """A push of its first second may be from before its start, and on a slow line a later one."""
    beside = Beside(RunState.DETACHED, is_pushed=False, slack_s=slack_s)
    assert beside.guard.is_detached
    for after, is_detached in ((0.5, True), (0.9 + slack_s, True), (1.1 + slack_s, False)):
        beside.push(IdleStatus(), 100.0 + after)
        beside.now = 100.1 + after
        assert beside.guard.is_detached is is_detached


C = MissionCode
DONE = {
    "pause": {C.SUCCESS, C.ALREADY_SO, C.ALREADY_PAUSED},
    "resumption": {C.SUCCESS, C.ALREADY_SO, C.NOT_PAUSED},
    # The others of these say that there is nothing to stop.
    "stop": {C.SUCCESS, C.NOT_RUNNING, C.NOT_INITIALISED, C.NO_MISSION, C.NO_POINTS, C.NOT_STARTED},
}


@pytest.mark.parametrize("what", DONE)
async def test_each_answer_to_an_order_is_a_yes_or_a_refusal(what: Any) -> None:
    for code in MissionCode:
        beside = Beside(None, is_pushed=True)
        beside.answer = code
        act = beside.guard.stop_any if what == "stop" else partial(beside.guard.order_any, what)
        if code in DONE[what]:
            was_stopped = what != "stop" or code is C.SUCCESS
            expected = MissionKind.HOTPOINT if was_stopped else MissionKind.NONE
            assert await act() is expected, code
            continue
        with pytest.raises(MissionRefused, match=f"the {what} of the hotpoint") as caught:
            await act()
        assert caught.value.code == code
