"""Missions at the agent: whole plans, the one that was meant, once, and no longer than wanted."""

from __future__ import annotations

import asyncio
import uuid
from types import SimpleNamespace
from typing import Any, cast

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.messages import MissionReport
from m100link.apps.agent.orders import UploadPlan
from m100link.apps.fleet.control import FleetControl
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.lost_link import LostAction, LostLinkPlan
from m100link.apps.fleet.missions.manager import MissionManager
from m100link.apps.fleet.payloads import MissionCard, MissionInput, MissionStage, Outcome, after
from m100link.errors import GuardRefused, M100Error, MissionRunning, StaleLease, UsageError
from tests.apps.bus.memory import Weather
from tests.apps.fleet.conftest import SITE, OnBoard, Rig
from tests.apps.fleet.missions.conftest import away, kind, on_board

pytestmark = pytest.mark.anyio


async def flying(rig: Rig, one: OnBoard, control: FleetControl, *north: float) -> None:
    digest = await control.missions.upload(away(one, *(north or (20, 140))))
    await control.missions.start(digest, take_off=True)
    await rig.until(lambda: one.speed > 2.0)


async def test_a_plan_goes_up_whole_and_nothing_flies_before_its_start(rig: Rig) -> None:
    one = await on_board(rig)
    plan = away(one, 20, 60)
    async with (await rig.pilot())["a1"].control() as control:
        digest = await control.missions.upload(plan)
        assert digest == UploadPlan.of(plan).digest
        card = await (await rig.pilot("b"))["a1"].mission()
        assert (card.stage, card.digest, card.points) == (MissionStage.UPLOADED, digest, 2)
        assert card.by == "pilot"
        await anyio.sleep(5.0)
        assert one.height < 0.1
        assert kind(one) != "waypoint mission"
        await control.missions.start(digest, take_off=True)
        assert one.fleet_agent.missions.stage is MissionStage.FLYING
        await rig.until(lambda: one.fleet_agent.missions.stage is MissionStage.OVER)
        card = await (await rig.pilot("c"))["a1"].mission()
        assert (card.reached, card.is_finished, card.fault) == (b"\x00\x01", True, None)


async def test_another_plan_than_the_one_that_is_named_does_not_start(rig: Rig) -> None:
    one = await on_board(rig)
    async with (await rig.pilot())["a1"].control() as control:
        first = await control.missions.upload(away(one, 20, 60))
        second = await control.missions.upload(away(one, 20, 80))
        assert first != second
        with pytest.raises(UsageError, match="not the one on board"):
            await control.missions.start(first, take_off=True)
        with pytest.raises(UsageError, match="not the one on board"):
            await control.missions.start("0" * 64)
        assert one.height < 0.1


async def test_what_is_no_plan_is_refused_and_flies_nothing(rig: Rig) -> None:
    one = await on_board(rig)
    told = UploadPlan.of(away(one, 20, 60, 100))
    halves = [
        UploadPlan(told.mission, told.points[:2]),
        UploadPlan(told.mission[:-1], told.points),
        UploadPlan(b"", told.points),
        UploadPlan(told.mission, (told.points[0], told.points[0], told.points[2])),
        UploadPlan(told.mission, (*told.points[:2], b"")),
    ]
    async with (await rig.pilot())["a1"].control() as control:
        for half in halves:
            with pytest.raises(UsageError):
                await control.ask(half)
            with pytest.raises(UsageError):
                await control.missions.start(half.digest, take_off=True)
        assert one.height < 0.1


async def test_an_upload_that_the_agent_refuses_leaves_no_plan_before_it(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = await on_board(rig)
    async with (await rig.pilot())["a1"].control() as control:
        good = await control.missions.upload(away(one, 20, 60, 100))

        async def breaks(*_: Any) -> object:
            raise UsageError("cut off")

        with monkeypatch.context() as patched:
            patched.setattr(one.client, "ask", breaks)
            with pytest.raises(UsageError, match="cut off"):
                await control.missions.upload(away(one, 30, 70, 110))
        for digest in (good, ""):
            with pytest.raises(UsageError):
                await control.missions.start(digest, take_off=True)
        assert one.height < 0.1


async def test_without_the_lease_nothing_goes_up_and_nothing_starts(rig: Rig) -> None:
    one = await on_board(rig)
    pilot = await rig.pilot()
    asker = pilot["a1"].asker
    with pytest.raises(StaleLease):
        await asker.ask(UploadPlan.of(away(one, 20, 60)))
    async with pilot["a1"].control() as control:
        digest = await control.missions.upload(away(one, 20, 60))
        start = orders.StartMission(digest, take_off=True)
        with pytest.raises(StaleLease):
            await asker.ask(start)
        with pytest.raises(StaleLease):  # a stranger who knows the number of the lease
            await asker.ask(start, fence=control.fence, token="guessed")
    async with pilot["a1"].control() as control:
        with pytest.raises(UsageError, match="not the one on board"):
            await control.missions.start(digest, take_off=True)
    assert one.height < 0.1


async def test_a_start_that_is_repeated_starts_once_and_one_that_is_late_not_at_all(
    rig: Rig,
) -> None:
    one = await on_board(rig)
    pilot = await rig.pilot()
    asker = pilot["a1"].asker
    rig.network.weather = Weather(repeat=0.8, jitter_s=0.1, loss=0.1)
    async with pilot["a1"].control() as control:
        await flying(rig, one, control)
        lease = control._held()
        start = orders.StartMission(one.fleet_agent.missions._digest, take_off=True)
        with pytest.raises(GuardRefused, match="older than 5 s"):
            await asker.ask(
                start, fence=lease.number, token=lease.token, clock=one.client.now - 6.0
            )
        with pytest.raises(MissionRunning):
            await control.missions.start(start.digest, take_off=True)
        with pytest.raises(MissionRunning):
            await control.missions.upload(away(one, 20, 60))
        begins = [event.text for event in one.client.events if "begins" in event.text]
        assert sum("mission" in text for text in begins) == 1


async def test_an_agent_that_begins_anew_does_not_start_it_a_second_time(rig: Rig) -> None:
    one = await on_board(rig)
    identity = uuid.uuid4().hex
    one.order_log.begun[identity] = rig.utc()
    second = await rig.aircraft("a2", virtual=one.aircraft, order_log=one.order_log)
    result = None
    pilot = await rig.pilot()
    async with pilot["a2"].control() as control:
        lease = control._held()
        digest = await control.missions.upload(away(one, 20, 60))
        try:
            await pilot["a2"].asker.ask(
                orders.StartMission(digest, take_off=True),
                fence=lease.number,
                token=lease.token,
                clock=second.client.now,
                identity=identity,
            )
        except M100Error as error:
            result = error
    assert result is not None
    assert "restarted" in result.seen
    assert one.height < 0.1


@pytest.mark.parametrize("how", ["stop", "halt", "mission stop", "lease"])
async def test_whatever_ends_it_the_aircraft_hovers(rig: Rig, how: str) -> None:
    one = await on_board(rig)
    pilot = await rig.pilot()
    async with pilot["a1"].control() as control:
        await flying(rig, one, control)
        if how == "stop":
            await (await rig.pilot("anybody"))["a1"].stop()
        elif how == "halt":
            await control.missions.stop()
        elif how == "mission stop":
            await control.ask(orders.StopMission())
        else:
            await control._leave()
        began = anyio.current_time()
        await rig.until(lambda: one.speed < 0.3, within=5.0)
        assert anyio.current_time() - began < 3.0
        missions = one.fleet_agent.missions
        await rig.until(lambda: missions.stage in (MissionStage.OVER, MissionStage.NONE), within=5)
        await rig.until(lambda: kind(one) == "no mission", within=5.0)
        await anyio.sleep(10.0)
        assert one.speed < 0.3
        assert one.height > 1.0
        assert (await pilot["a1"].card()).task == ""
        card = await pilot["a1"].mission()
        assert card.fault is not None
        assert card.points == 2


async def test_a_start_that_waited_behind_a_stop_does_not_fly(rig: Rig) -> None:
    """Two starts and a STOP between them: the second one is refused, not kept for later."""
    one = await on_board(rig)
    pilot = await rig.pilot()
    async with pilot["a1"].control() as control:
        digest = await control.missions.upload(away(one, 20, 140))
        refused: list[M100Error] = []

        async def start() -> None:
            try:
                await control.missions.start(digest, take_off=True)
            except M100Error as error:
                refused.append(error)

        async with anyio.create_task_group() as group:
            for _ in range(3):
                group.start_soon(start)
            await anyio.sleep(1.0)
            await (await rig.pilot("anybody"))["a1"].stop()
        assert len(refused) == 3
        await anyio.sleep(20.0)
        assert one.speed < 0.3
        assert kind(one) != "waypoint mission"


@pytest.mark.parametrize(("action", "height"), [("hover", 6.0), ("land", 0.0)])
async def test_when_the_pilot_is_lost_it_does_what_lost_says(
    rig: Rig, action: LostAction, height: float
) -> None:
    one = await on_board(rig, lost=LostLinkPlan(action, 4.0))
    pilot = await rig.pilot()
    with pytest.raises(M100Error):
        async with pilot["a1"].control() as control:
            await flying(rig, one, control)
            await anyio.sleep(3.0)
            assert one.speed > 2.0
            rig.cut(pilot)
            cut_at = anyio.current_time()
            await rig.until(lambda: one.speed < 0.3, within=10.0)
            assert anyio.current_time() - cut_at < 6.0
            await anyio.sleep(30.0)
    await anyio.sleep(30.0)
    assert kind(one) != "waypoint mission"
    assert one.speed < 0.3
    assert one.height == pytest.approx(height, abs=0.7)


async def test_a_mission_is_paused_and_goes_on_and_its_card_says_so(rig: Rig) -> None:
    one = await on_board(rig)
    pilot = await rig.pilot()
    async with pilot["a1"].control() as control:
        await flying(rig, one, control)
        await rig.until(lambda: one.fleet_agent.missions.words == "mission, 1 of 2")
        await control.pause_mission()
        await rig.until(lambda: one.speed < 0.3, within=10.0)
        card = await pilot["a1"].mission()
        assert (card.stage, card.is_paused) == (MissionStage.FLYING, True)
        assert card.distance_m is not None
        assert (await pilot["a1"].card()).task == "mission, 1 of 2, paused"
        await control.resume_mission()
        await rig.until(lambda: one.speed > 2.0, within=10.0)
        assert not (await pilot["a1"].mission()).is_paused
        assert (await pilot["a1"].mission()).index == 1


async def test_a_refusal_of_the_aircraft_is_reported_and_leaves_it_on_the_ground(rig: Rig) -> None:
    one = await rig.aircraft("a1")  # firmware 1.0 flies none
    pilot = await rig.pilot()
    results = {}
    async with pilot["a1"].control() as control:
        digest = await control.missions.upload(away(one, 20, 60))
        results = await pilot.each(lambda _: control.missions.start(digest, take_off=True), ["a1"])
    assert results["a1"].outcome is Outcome.REFUSED
    assert one.height < 0.1
    assert one.fleet_agent.missions.stage is not MissionStage.FLYING


async def test_of_a_flood_of_questions_few_cost_anything(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = await on_board(rig)
    missions, made = one.fleet_agent.missions, 0
    card = missions.card

    def counted(name: str, boot: str) -> MissionCard:
        nonlocal made
        made += 1
        return card(name, boot)

    monkeypatch.setattr(missions, "card", counted)
    pilot = await rig.pilot()
    for _ in range(50):
        async with anyio.create_task_group() as group:
            for _ in range(20):
                group.start_soon(lambda: pilot.bus.ask(Keys(SITE, "a1").mission, timeout=1.0))
        await anyio.sleep(0.02)
    assert made < 40
    await anyio.sleep(0.1)
    before = made
    assert (await pilot["a1"].mission()).stage is MissionStage.NONE
    assert made == before + 1


# -- every stage of a mission with everything that may happen, by hand -----------------------------


NONE, UPLOADED, STARTING, FLYING, OVER = MissionStage
PLAN, ASKED, BEGUN, ENDED, LEASE = MissionInput

EXPECTED = {
    (NONE, PLAN): UPLOADED,
    (NONE, ASKED): STARTING,  # of a plan that a front has brought in pieces
    (NONE, BEGUN): NONE,
    (NONE, ENDED): NONE,
    (NONE, LEASE): NONE,
    (UPLOADED, PLAN): UPLOADED,  # the newer one
    (UPLOADED, ASKED): STARTING,
    (UPLOADED, BEGUN): UPLOADED,
    (UPLOADED, ENDED): UPLOADED,
    (UPLOADED, LEASE): NONE,  # nobody flies what somebody else left
    (STARTING, PLAN): None,
    (STARTING, ASKED): None,
    (STARTING, BEGUN): FLYING,
    (STARTING, ENDED): OVER,  # refused, or stopped before it began
    (STARTING, LEASE): OVER,
    (FLYING, PLAN): None,
    (FLYING, ASKED): None,
    (FLYING, BEGUN): FLYING,
    (FLYING, ENDED): OVER,
    (FLYING, LEASE): OVER,
    (OVER, PLAN): UPLOADED,
    (OVER, ASKED): STARTING,  # the plan lies there still
    (OVER, BEGUN): OVER,  # what a lost lease overtook does not fly
    (OVER, ENDED): OVER,
    (OVER, LEASE): OVER,
}


def test_the_table_is_whole() -> None:
    assert EXPECTED.keys() == {(stage, one) for stage in MissionStage for one in MissionInput}


@pytest.mark.parametrize(("stage", "happens"), EXPECTED)
def test_each_pair(stage: MissionStage, happens: MissionInput) -> None:
    expected = EXPECTED[stage, happens]
    if expected is None:
        what = {PLAN: "a plan", ASKED: "the start of a mission"}[happens]
        said = f"{what} came while a mission is {stage.value}; nothing was changed"
        with pytest.raises(MissionRunning, match=said):
            after(stage, happens)
    else:
        assert after(stage, happens) is expected


# -- the agent is killed while a mission flies: the aircraft flies on, until the next one is th ----


@pytest.mark.parametrize("action", ["hover", "land"])
async def test_the_next_agent_ends_the_mission_and_does_what_lost_says(
    rig: Rig, action: LostAction
) -> None:
    plan = LostLinkPlan(action, 4.0)
    one = await on_board(rig, lost=plan)
    pilot = await rig.pilot()
    with pytest.raises(M100Error):
        async with pilot["a1"].control() as control:
            digest = await control.missions.upload(away(one, 20, 140))
            await control.missions.start(digest, take_off=True)
            await rig.until(lambda: one.speed > 2.0)
            one.kill()
            await anyio.sleep(60.0)
    assert one.speed > 1.0, "nobody ordered the mission to stop"
    second = await one.next(lost=plan)
    await rig.until(lambda: second.speed < 0.3, within=5.0)
    assert kind(second) == "no mission"
    await anyio.sleep(30.0)
    assert second.speed < 0.3
    assert second.height < 0.1 if action == "land" else second.height > 5.0
    assert second.fleet_agent.missions.stage is MissionStage.NONE


# -- values, by what the aircraft reports ----------------------------------------------------------


def manager() -> tuple[MissionManager, Any]:
    state = SimpleNamespace(mission="no mission", mission_index=-1, mission_status=-1)
    client: Any = SimpleNamespace(on_mission_report=[], on_lease=[], state=state, now=40.0)
    client.view = SimpleNamespace(get=lambda _: None)
    return MissionManager(client), client


async def test_nothing_is_started_while_a_plan_is_uploaded() -> None:
    """A start that waited for it could begin behind a STOP."""
    one, _ = manager()
    one.stage, one._digest, nothing = MissionStage.UPLOADED, "ab", cast(Any, None)
    async with one._telling:
        with pytest.raises(UsageError, match="a plan is being uploaded; nothing was started"):
            await asyncio.wait_for(one.start(nothing, orders.StartMission("ab"), None), 1.0)
    assert one.stage is MissionStage.UPLOADED


def test_points_are_reached_when_the_second_byte_is_four() -> None:
    """Event 2 says that a point was reached, event 1 that the mission is over."""
    one, client = manager()
    for event, data in ((2, b"\3\4"), (2, b"\5\6"), (3, b"\6\4"), (2, b"\7\4\1")):
        client.on_mission_report[0](MissionReport(event, data))
    assert (bytes(one._reached), one._is_finished) == (b"\x03\x07", False)
    client.on_mission_report[0](MissionReport(1, b"\x01\x04"))
    assert (bytes(one._reached), one._is_finished) == (b"\x03\x07", True)
    for number in range(2000):
        client.on_mission_report[0](MissionReport(2, bytes([number % 200, 4])))
    assert len(one._reached) == 1024
    assert one._reached[-1] == 1999 % 200
    assert one.card("kite", "run").reached_count == 2002


@pytest.mark.parametrize(
    ("stage", "is_paused", "mission", "words"),
    [
        (MissionStage.FLYING, False, "waypoint mission", "mission, 2 of 5"),
        (MissionStage.FLYING, True, "waypoint mission", "mission, 2 of 5, paused"),
        (MissionStage.UPLOADED, False, "no mission", ""),
        (MissionStage.NONE, False, "hotpoint", "hotpoint"),
    ],
)
def test_a_mission_in_words(stage: MissionStage, is_paused: bool, mission: str, words: str) -> None:
    one, client = manager()
    client.state.mission = mission
    one.stage, one._points = stage, 5
    one._reached[:] = b"\x00\x01\x01"
    one.paused(is_paused=is_paused)
    assert one.words == words
    assert one._is_paused is (is_paused and stage is MissionStage.FLYING)


def test_the_time_of_a_mission_counts_from_its_begin_to_its_end() -> None:
    one, client = manager()
    assert one.card("kite", "run").elapsed_s == 0.0
    one._begun_at = 27.5
    assert one.card("kite", "run").elapsed_s == 12.5
    one._ended_at = 35.25
    client.now = 99.0
    card = one.card("kite", "run")
    assert (card.elapsed_s, card.index, card.status, card.distance_m) == (7.75, None, None, None)
    client.state.mission_index, client.state.mission_status = 0, 0
    card = one.card("kite", "run")
    assert (card.index, card.status) == (0, 0)
