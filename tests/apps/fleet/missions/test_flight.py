"""A mission for who flies it: events in their order, whatever the network loses, and its end."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import AsyncMock

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.messages import MessageError
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.missions import flight
from m100link.apps.fleet.missions.flight import FleetMission, MissionOrders, mission_card
from m100link.apps.fleet.payloads import MissionCard, MissionStage, pack
from m100link.errors import M100Error, MissionAborted, NotObserved, OutcomeUnknown, Unreachable
from m100link.flight.missions.events import (
    Finished,
    MissionEvent,
    MissionProgress,
    Paused,
    Reached,
    Resumed,
    Started,
    Stopped,
    Uploaded,
)
from m100link.missions.plan import AtEnd
from tests.apps.bus.memory import Weather
from tests.apps.fleet.conftest import SITE, OnBoard, Rig
from tests.apps.fleet.missions.conftest import away, kind, on_board

pytestmark = pytest.mark.anyio


async def told(mission: FleetMission) -> list[MissionEvent]:
    return [event async for event in mission if not isinstance(event, MissionProgress)]


@pytest.mark.parametrize(
    "weather",
    [
        pytest.param(Weather(), id="good network"),
        pytest.param(Weather(loss=0.1, repeat=0.2, delay_s=0.02, jitter_s=0.1), id="bad network"),
        pytest.param(Weather(delay_s=1.0), id="long way"),
    ],
)
async def test_all_of_it_is_reported_in_its_order(rig: Rig, weather: Weather) -> None:
    one = await on_board(rig)
    rig.network.weather = weather
    async with (await rig.pilot())["a1"].control() as control:
        plan = away(one, 20, 60, 100)
        async with control.waypoint_mission(plan, take_off=True) as mission:
            events = await told(mission)
        assert events == [
            Uploaded(3, None),
            Started(),
            Reached(0),
            Reached(1),
            Reached(2),
            Finished(),
        ]
        assert mission.is_over
        rig.network.weather = Weather()
        await control.land()
    assert one.height < 0.1


async def test_progress_says_how_far_it_is(rig: Rig) -> None:
    one = await on_board(rig)
    async with (await rig.pilot())["a1"].control() as control:
        async with control.waypoint_mission(away(one, 20, 60), take_off=True) as mission:
            seen = [event async for event in mission if isinstance(event, MissionProgress)]
    assert {event.index for event in seen} == {0, 1}
    times = [event.elapsed for event in seen]
    assert times == sorted(times)
    near = [event.distance_m for event in seen if event.index == 1 and event.distance_m is not None]
    assert near[0] > 30.0
    assert near[-1] < 10.0


async def test_with_a_landing_at_the_end_it_is_over_on_the_ground(rig: Rig) -> None:
    one = await on_board(rig)
    async with (await rig.pilot())["a1"].control() as control:
        plan = away(one, 20, 60, at_end=AtEnd.LAND)
        async with control.waypoint_mission(plan, take_off=True) as mission:
            events = await told(mission)
    assert events[-1] == Finished()
    assert one.height < 0.1


async def test_paused_resumed_and_stopped_are_reported(rig: Rig) -> None:
    one = await on_board(rig)
    async with (await rig.pilot())["a1"].control() as control:
        async with control.waypoint_mission(away(one, 20, 140), take_off=True) as mission:
            events = []
            async for event in mission:
                events.append(event)
                if event == Reached(0):
                    await mission.pause()
                elif event == Paused():
                    await rig.until(lambda: one.speed < 0.3)
                    await mission.resume()
                elif event == Resumed():
                    await rig.until(lambda: one.speed > 1.0)
                    assert await mission.set_speed(3.0) == pytest.approx(3.0)
                    await mission.stop()
            plain = [event for event in events if not isinstance(event, MissionProgress)]
            assert plain[2:] == [Reached(0), Paused(), Resumed(), Stopped()]
            await rig.until(lambda: one.speed < 0.3, within=3.0)
        await control.fly_to(**here(rig, one))  # something else may fly


def here(rig: Rig, one: OnBoard) -> dict[str, float]:
    telemetry = one.client.telemetry
    position = None if telemetry is None else telemetry.position
    assert position is not None
    return {
        "latitude_deg": position.latitude_deg,
        "longitude_deg": position.longitude_deg,
        "height": 8.0,
    }


async def test_leaving_the_block_stops_it(rig: Rig) -> None:
    one = await on_board(rig)
    async with (await rig.pilot())["a1"].control() as control:
        with pytest.raises(KeyError):
            async with control.waypoint_mission(away(one, 20, 140), take_off=True):
                await rig.until(lambda: one.speed > 2.0)
                raise KeyError
        assert kind(one) != "waypoint mission"
        await rig.until(lambda: one.speed < 0.3, within=5.0)
        assert one.height > 1.0


async def test_a_stop_of_somebody_else_is_raised_with_its_reason(rig: Rig) -> None:
    one = await on_board(rig)
    async with (await rig.pilot())["a1"].control() as control:
        with pytest.raises(NotObserved, match="was stopped: stop"):
            async with control.waypoint_mission(away(one, 20, 140), take_off=True) as mission:
                async for event in mission:
                    if event == Reached(0):
                        await (await rig.pilot("anybody"))["a1"].stop()
    assert one.speed < 0.3


async def test_an_agent_that_is_killed_meanwhile_is_an_unknown_end(rig: Rig) -> None:
    one = await on_board(rig)
    pilot = await rig.pilot()
    with pytest.raises(OutcomeUnknown):
        async with pilot["a1"].control() as control:
            async with control.waypoint_mission(away(one, 20, 140), take_off=True) as mission:
                async for event in mission:
                    if event == Reached(0):
                        rig.network.cut(one.bus)
    await anyio.sleep(15.0)
    assert one.speed < 0.3


async def test_an_agent_that_was_started_anew_is_said(rig: Rig) -> None:
    one = await on_board(rig)
    with pytest.raises(OutcomeUnknown, match="restarted"):
        async with (await rig.pilot())["a1"].control() as control:
            async with control.waypoint_mission(away(one, 20, 140), take_off=True) as mission:
                async for _ in mission:
                    mission._boot = "of before"


async def test_where_nobody_tells_it_is_said_with_what_to_do(rig: Rig) -> None:
    pilot, key = await rig.pilot(), Keys(SITE, "a7")
    with pytest.raises(Unreachable):
        await pilot["a7"].mission()
    with pytest.raises(OutcomeUnknown, match="does not report its mission"):
        await mission_card(pilot.asker("a7"), patience=1.0)
    junk = rig.network.session()
    junk.serve(key.mission, lambda q: q.answer(key.mission, b"\x01{]"))
    with pytest.raises(OutcomeUnknown):
        await mission_card(pilot.asker("a7"), patience=1.0)
    junk.declare(key.live_by(junk.session))
    await rig.until(lambda: "a7" in pilot.present)
    with pytest.raises(MessageError):
        await mission_card(pilot.asker("a7"), patience=1.0)


async def test_a_stranger_ends_no_mission_by_telling_that_it_is_over(rig: Rig) -> None:
    """Anybody on the network may answer; the aircraft is the session that shows its token."""
    key = Keys(SITE, "a1").mission
    over = pack(MissionCard("a1", "stranger", MissionStage.OVER, is_finished=True))
    stranger = rig.network.session()
    stranger.serve(key, lambda question: question.answer(key, over))
    one, pilot = await on_board(rig), await rig.pilot()
    async with pilot["a1"].control() as control:
        async with control.waypoint_mission(away(one, 20, 140), take_off=True) as mission:
            for _ in range(20):
                assert (await mission.look()).boot == one.fleet_agent.boot
                await anyio.sleep(0.5)
            assert not mission.is_over
            assert (await pilot["a1"].mission()).stage is MissionStage.FLYING


@pytest.mark.parametrize(
    ("north", "take_off", "why"),
    [(300, True, "the envelope ends at 150 m"), (60, False, "on the ground")],
)
async def test_a_plan_that_is_refused_flies_nothing_and_says_why(
    rig: Rig, north: float, take_off: bool, why: str
) -> None:
    one = await on_board(rig)
    async with (await rig.pilot())["a1"].control() as control:
        with pytest.raises(M100Error, match=why):
            async with control.waypoint_mission(away(one, 20, north), take_off=take_off):
                pass
    assert one.height < 0.1
    assert one.fleet_agent.missions.stage in (MissionStage.OVER, MissionStage.NONE)


# -- what cards become: events once each, in their order -------------------------------------------


def a_card(stage: MissionStage = MissionStage.FLYING, **more: Any) -> MissionCard:
    more.setdefault("reached_count", len(more.get("reached", b"")))
    return MissionCard("a1", "run", stage, **more)


def mission() -> FleetMission:
    asker: Any = SimpleNamespace(keys=Keys(SITE, "a1"))
    nothing: Any = None
    return FleetMission(asker, nothing, nothing, take_off=False)


async def test_each_change_of_a_card_is_one_event() -> None:
    one = mission()
    for card in (
        a_card(elapsed_s=1.5, index=2, status=5, distance_m=40.25, height_m=9.75),
        a_card(reached=b"\1\0"),
        a_card(reached=b"\1\0\2", is_paused=True),
        a_card(reached=b"\1\0\2", is_paused=True),
        a_card(reached=b"\1\0\2"),
        a_card(MissionStage.OVER, reached=b"\1\0\2\3", is_finished=True),
        a_card(MissionStage.OVER, reached=b"\1\0\2\3", is_finished=True),
    ):
        one._note(card)
    assert list(one._events) == [
        MissionProgress(1.5, 2, 5, 40.25, 9.75),
        Reached(1),
        Reached(0),
        Reached(2),
        Paused(),
        Resumed(),
        Reached(3),
        Finished(),
    ]
    assert one.is_over


async def test_a_mission_that_reaches_more_points_than_a_card_has_loses_none() -> None:
    """A plan of 99 waypoints may repeat 255 times; a card has the last 1024 of them."""
    one, flown = mission(), [number % 99 for number in range(2500)]
    for count in (0, 1000, 1024, 1025, 1800, 1800, 2500):
        one._note(a_card(reached=bytes(flown[max(0, count - 1024) : count]), reached_count=count))
    assert [said for said in one._events if isinstance(said, Reached)] == [*map(Reached, flown)]


@pytest.mark.parametrize("stage", [MissionStage.OVER, MissionStage.NONE])
@pytest.mark.parametrize("is_stopped", [True, False])
async def test_the_end_of_one_that_was_stopped_is_said_once(
    stage: MissionStage, is_stopped: bool
) -> None:
    one = mission()
    one._is_stopped = is_stopped
    for _ in range(2):
        one._note(a_card(stage))
    assert list(one._events) == [Stopped()] * is_stopped
    assert one.is_over
    other = mission()
    other._note(a_card(MissionStage.STARTING))
    assert not other.is_over


@pytest.mark.parametrize(
    ("stage", "boot", "digest", "says"),
    [
        (MissionStage.STARTING, "run", "mine", None),
        (MissionStage.FLYING, "run", "mine", None),
        (MissionStage.FLYING, "run", "", None),  # the aircraft says that it flies, not which
        (MissionStage.OVER, "run", "mine", None),
        (MissionStage.NONE, "run", "", None),
        (MissionStage.FLYING, "later", "mine", "restarted"),
        (MissionStage.UPLOADED, "later", "other", "restarted"),
        (MissionStage.FLYING, "run", "other", "another plan"),
        (MissionStage.OVER, "run", "other", "another plan"),
        (MissionStage.UPLOADED, "run", "other", "another plan"),
        (MissionStage.UPLOADED, "run", "mine", "another plan"),  # the same one, once more
        (MissionStage.UPLOADED, "run", "", "another plan"),
    ],
)
async def test_a_mission_whose_place_another_one_took_is_not_reported_as_ours(
    monkeypatch: pytest.MonkeyPatch,
    stage: MissionStage,
    boot: str,
    digest: str,
    says: str | None,
) -> None:
    """A plan that only waits on board flies nowhere, whatever flew before."""

    async def card_of(_: Any) -> MissionCard:
        return MissionCard("a1", boot, stage, digest=digest)

    monkeypatch.setattr(flight, "mission_card", card_of)
    one = mission()
    one._boot, one._digest = "run", "mine"
    if says is None:
        assert (await one.look()).stage is stage
        assert one.is_over is (stage in (MissionStage.OVER, MissionStage.NONE))
        return
    error = OutcomeUnknown if says == "restarted" else MissionAborted
    with pytest.raises(error, match=says):
        await one.look()
    assert not one._events
    assert not one.is_over


async def test_a_stop_whose_end_is_not_told_is_of_unknown_outcome(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    one, began_at, stop = mission(), anyio.current_time(), AsyncMock()
    one._orders, one._boot = cast(Any, SimpleNamespace(stop=stop)), "run"
    monkeypatch.setattr(flight, "mission_card", AsyncMock(return_value=a_card()))
    with anyio.fail_after(60.0), pytest.raises(OutcomeUnknown, match="did not report its end"):
        await one.stop()
    assert anyio.current_time() - began_at == pytest.approx(10.0, abs=1.0)
    stop.assert_called_once_with()


async def test_a_speed_is_in_metres_and_answered_in_millimetres() -> None:
    asked: list[Any] = []

    async def ask(order: Any) -> Any:
        asked.append(order)
        return SimpleNamespace(number=3250, text="the digest")

    found = MissionOrders(ask)
    assert await found.set_speed(4.5) == 3.25
    await found.start("ab" * 32, take_off=True)
    await found.stop()
    await found.stop("rain")
    assert asked == [
        orders.SetMissionSpeed(4.5),
        orders.StartMission("ab" * 32, True),
        orders.Halt("its operator stopped it"),
        orders.Halt("rain"),
    ]
