"""A pilot's end: who is there, what each is asked, and what is left when a network goes."""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Awaitable, Callable
from random import Random
from typing import Any, cast
from unittest.mock import AsyncMock, MagicMock, call

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.messages import MessageError
from m100link.apps.fleet import client as clients
from m100link.apps.fleet.client import Change, Fleet, FleetAircraft
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.payloads import AskShow, Card, Outcome, pack
from m100link.errors import GuardRefused, LinkError, OutcomeUnknown, Unreachable
from tests.apps.bus.memory import Weather
from tests.apps.fleet.conftest import SITE, OnBoard, Rig, with_camera
from tests.apps.fleet.test_payloads import BOTH, OLD_CARD, OLD_HELLO, OLD_LOGS, OLD_REPLY

pytestmark = pytest.mark.anyio


async def test_all_take_off_and_land(rig: Rig) -> None:
    ones = [await rig.aircraft(name) for name in ("a1", "a2")]
    pilot = await rig.pilot()
    results = await pilot.each(lambda one: one.take_off())
    assert {name: str(one) for name, one in results.items()} == {"a1": "ok", "a2": "ok"}
    assert all(one.height > 1.0 for one in ones)
    results = await pilot.land()
    assert {name: str(one) for name, one in results.items()} == {"a1": "ok", "a2": "ok"}
    assert all(one.height < 0.1 for one in ones)


# The order that each method of an aircraft comes to; None for those that only ask how it is.
ORDERS: dict[str, orders.Order | None] = {
    "take_off": orders.TakeOff(),
    "land": orders.Land(),
    "stop": orders.Stop(),
    **dict.fromkeys(("logs", "fetch_log", "audit", "mission", "card")),
}


async def test_each_method_of_an_aircraft_gives_its_order(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    lacks = sorted(
        name
        for name, one in vars(FleetAircraft).items()
        if inspect.iscoroutinefunction(one) and not name.startswith("_") and name not in ORDERS
    )
    assert not lacks, f"ORDERS of this file has no row for {lacks}"
    await rig.aircraft("a1")
    aircraft = (await rig.pilot())["a1"]
    ask, asked = aircraft.asker.ask, list[orders.Order]()

    async def asks(order: orders.Order, **options: Any) -> Any:
        asked.append(order)
        return await ask(order, **options)

    monkeypatch.setattr(aircraft.asker, "ask", asks)
    for name, order in ORDERS.items():
        if order is not None:
            await getattr(aircraft, name)()
            assert order in asked, name
            asked.clear()


async def test_a_stop_of_all_reports_that_nobody_is_there(rig: Rig) -> None:
    await rig.aircraft("a1")
    fleet = Fleet(rig.network.session(), site="hangar", utc=rig.utc)
    for ask in (fleet.stop, fleet.land):
        with pytest.raises(Unreachable, match="no agent is there at site hangar; nothing was sent"):
            await ask()
    assert "no agent named a1 is there at site hangar" in str((await fleet.stop(["a1"]))["a1"])


async def test_a_name_that_is_not_there_is_unreachable(rig: Rig) -> None:
    results = await (await rig.pilot()).land(["a7"])
    assert results["a7"].outcome is Outcome.UNREACHABLE


OLD: dict[str, bytes] = {
    **dict.fromkeys(("cmd", "lease", "show", "status/*"), OLD_REPLY),
    **{"log": OLD_LOGS, "state": OLD_CARD, "mission": OLD_CARD, "told": OLD_HELLO},
}
"""What an agent of an old release answers under each key."""

ASKING: dict[str, Callable[[FleetAircraft], Awaitable[object]]] = {
    **{name: getattr(FleetAircraft, name) for name in ORDERS if name != "fetch_log"},
    "look at a show": lambda one: one.asker.once(one.keys.show, AskShow("r"), within=1.0),
}


@pytest.mark.parametrize("what", ASKING)
async def test_an_old_agent_is_reported_with_both_versions(rig: Rig, what: str) -> None:
    board, pilot = rig.network.session(), await rig.pilot()
    board.declare(Keys(SITE, "a1").live_by(board.session))

    def serve(key: str, payload: bytes) -> None:
        board.serve(Keys(SITE, "a1").of(key), lambda asked: asked.answer(asked.key, payload))

    for key, payload in OLD.items():
        serve(key, payload)
    if what == "card":
        assert str((await pilot.cards())["a1"].fault).count(BOTH)
        with pytest.raises(LinkError, match=BOTH):
            await pilot.reach("a1")
        return
    with pytest.raises((MessageError, OutcomeUnknown), match=BOTH) as caught:
        await ASKING[what](pilot["a1"])
    assert caught.value.remedy == "install the same release on both"


async def test_aircraft_that_appear_and_that_are_gone(rig: Rig) -> None:
    pilot = await rig.pilot()
    one = await rig.aircraft("a1")
    changes = pilot.changes()
    assert await anext(changes) == Change("a1", True)
    await anyio.sleep(2.0)
    rig.network.cut(one.bus)
    began = anyio.current_time()
    change = await anext(changes)
    assert (change.name, change.is_there) == ("a1", False)
    assert anyio.current_time() - began < 2.0


async def test_what_can_be_no_name_is_nobody(rig: Rig) -> None:
    """One token of a stranger ended the list, the console and what is done with all."""
    rig.network.session().declare(f"m100-live/{SITE}/no name/9f")
    pilot = await rig.pilot()
    await rig.aircraft("a1")
    assert await pilot.names() == sorted(await pilot.cards()) == sorted(pilot.present) == ["a1"]


async def test_a_card_of_another_name_than_that_of_its_key_is_not_shown_as_it(rig: Rig) -> None:
    """Rules of a router go by keys: messages under one's own may say anything."""
    await rig.aircraft("a1")
    other = rig.network.session()
    keys = Keys(SITE, "a2")
    lie = Card("a1", "00", 0.0, "connected", task="none at all")
    other.serve(keys.state, lambda question: question.answer(keys.state, pack(lie)))
    found = await (await rig.pilot()).cards()
    assert found["a1"].task == ""
    assert found["a2"].connection == "unreadable"


async def test_an_operator_without_the_time_lands_all_the_same(rig: Rig) -> None:
    """The first word of a program: its age is not known, and asked for."""
    one, pilot = await rig.aircraft("a1"), await rig.pilot()
    await pilot["a1"].take_off()
    assert (await (await rig.pilot("another")).land())["a1"].is_ok
    assert one.height < 0.1


async def test_an_operator_with_an_old_time_lands_all_the_same(rig: Rig) -> None:
    one, pilot = await rig.aircraft("a1"), await rig.pilot()
    aircraft = pilot["a1"]
    await aircraft.take_off()
    await anyio.sleep(600.0)
    await aircraft.land()
    assert one.height < 0.1


@pytest.mark.parametrize("has_asked_before", [True, False])
async def test_a_landing_that_was_given_up_does_not_end_the_flight_of_another(
    rig: Rig, has_asked_before: bool
) -> None:
    """It travels for a minute, and was reported as unknown after five seconds."""
    one, pilot, other = await rig.aircraft("a1"), await rig.pilot(), await rig.pilot("other")
    aircraft = pilot["a1"]
    if has_asked_before:
        await aircraft.stop()
    rig.network.weather = Weather(delay_s=60.0)
    with pytest.raises(OutcomeUnknown):
        await aircraft.land()
    rig.network.weather = Weather()
    async with other["a1"].control() as control:
        await control.take_off()
        await anyio.sleep(90.0)
        assert one.height > 1.0
        assert one.client.holder.name == "other"


# -- orders over ways of seconds, and what is lost on them: each has its outcome -------------------


async def told(
    rig: Rig, do: Callable[[FleetAircraft], Awaitable[object]], **options: Any
) -> Outcome:
    pilot = await rig.pilot(**options)
    return (await pilot.each(do, ["a1"]))["a1"].outcome


async def in_the_air(rig: Rig) -> OnBoard:
    one, pilot = await rig.aircraft("a1"), await rig.pilot()
    await pilot["a1"].take_off()
    await anyio.sleep(4.0)  # nobody has the lease any more
    return one


@pytest.mark.parametrize("way", [1.0, 2.0, 3.0])
async def test_what_needs_no_lease_has_its_outcome_over_long_ways(rig: Rig, way: float) -> None:
    await in_the_air(rig)
    rig.network.weather = Weather(delay_s=way)
    assert await told(rig, FleetAircraft.stop) is Outcome.OK


@pytest.mark.parametrize("way", [1.0, 2.0, 3.0])
async def test_a_landing_is_flown_and_reported_over_long_ways(rig: Rig, way: float) -> None:
    one = await in_the_air(rig)
    rig.network.weather = Weather(delay_s=way)
    assert await told(rig, FleetAircraft.land) is Outcome.OK
    assert one.height < 0.1


async def test_a_landing_that_is_asked_for_again_is_older_than_a_stop_since_the_first_time(
    rig: Rig,
) -> None:
    """Its first order says no time, and only the refusal says what it is there."""
    one = await in_the_air(rig)
    rig.network.weather = Weather(delay_s=1.5)
    landing = asyncio.ensure_future(told(rig, FleetAircraft.land))
    await anyio.sleep(4.0)
    assert not one.client.holder.number
    await one.agent.stop()
    assert await landing is Outcome.REFUSED
    await anyio.sleep(5.0)
    assert one.height > 1.0


@pytest.mark.parametrize("seed", [7, 15, 44, 56])  # of those in which the estimate is wrong most
async def test_what_is_asked_for_behind_the_answer_to_a_stop_is_newer_than_it(
    rig: Rig, seed: int
) -> None:
    """However slow the answers are by which a program estimates the agent's clock."""
    draw = Random(seed)
    ahead = draw.uniform(0.0, 3000.0)  # the clock of the agent
    one, pilot, other = await in_the_air(rig), await rig.pilot(), await rig.pilot("other")
    for own in (one.agent, one.client):
        own._clock = lambda: anyio.current_time() + ahead
    await anyio.sleep(2.0)
    rig.network.weather = Weather(delay_s=draw.uniform(0.3, 1.0), jitter_s=draw.uniform(0.0, 1.0))
    assert (await pilot.stop())["a1"].is_ok, seed
    landing = asyncio.ensure_future(draw.choice([pilot, other]).land())
    await anyio.sleep(draw.uniform(0.0, 0.3))  # no order has arrived by then
    await one.agent.stop()
    late = (await landing)["a1"].error
    assert isinstance(late, GuardRefused), (seed, late)
    assert late.guard == "stopped", (seed, late)
    await anyio.sleep(1.0)
    assert one.height > 1.0, seed

    rig.network.weather = Weather(delay_s=draw.uniform(0.0, 0.3), jitter_s=draw.uniform(0.0, 1.5))
    stopped = await pilot.stop()
    assert stopped["a1"].is_ok, (seed, stopped)
    if seed % 2:
        async with pilot["a1"].control():
            assert one.client.holder.number, seed
    landed = await pilot.land()
    assert landed["a1"].is_ok, (seed, landed)
    assert one.height < 0.1, seed


async def test_each_doubtful_agent_is_asked_to_land_as_of_the_time_of_the_first_order() -> None:
    """Two agents of one name answered, with the times 100 s and 200 s; the first order was lost."""
    made: list[tuple[float, float]] = []

    class Asker:
        bus = keys = None
        doubtful_clocks: list[float] = []  # noqa: RUF012 - each landing makes its own

        def its_time(self, at: float) -> float:
            return 0.0

        async def ask(self, order: orders.Order, *, since: float, clock: float = 0.0) -> None:
            assert isinstance(order, orders.Land)
            if clock:
                return made.append((clock, since))
            await anyio.sleep(2.0)
            self.doubtful_clocks = [100.0, 200.0]
            raise OutcomeUnknown("nobody knows")

    await anyio.sleep(30.0)
    with pytest.raises(OutcomeUnknown):
        await FleetAircraft(cast("Any", Asker()), "operator").land()
    # A STOP that came there within those two seconds is younger than the order, and ends it.
    assert [clock for clock, _ in made] == [100.0, 200.0]
    assert [since for _, since in made] == pytest.approx([98.0, 198.0])


async def test_a_landing_that_takes_ever_longer_is_refused_for_its_age(rig: Rig) -> None:
    """Its program answers for the round trip that it has seen, and for no longer one."""
    one = await in_the_air(rig)
    rig.network.weather = Weather(delay_s=2.0)
    landing = asyncio.ensure_future(told(rig, FleetAircraft.land, patience=30.0))
    for delay in (4.5, 9.0, 18.0):
        await anyio.sleep(3.0)
        rig.network.weather = Weather(delay_s=delay)
        await anyio.sleep(2.0 * delay)
    assert await landing is not Outcome.OK
    await anyio.sleep(10.0)
    assert one.height > 1.0


async def test_a_lease_is_held_and_a_take_off_reported_over_a_way_of_a_second(rig: Rig) -> None:
    one = await rig.aircraft("a1")
    rig.network.weather = Weather(delay_s=1.0)
    assert await told(rig, FleetAircraft.take_off) is Outcome.OK
    assert one.height > 1.0


async def test_a_mission_is_reported_over_a_way_of_a_second(rig: Rig) -> None:
    await rig.aircraft("a1")
    rig.network.weather = Weather(delay_s=1.0)
    pilot = await rig.pilot()
    assert (await pilot["a1"].mission()).points == 0


@pytest.mark.parametrize("way", [2.0, 3.0])
async def test_no_lease_can_be_held_over_longer_ways_and_that_is_reported(
    rig: Rig, way: float
) -> None:
    """It ends 3 s after the last word, and the first word under it comes later."""
    one = await rig.aircraft("a1")
    rig.network.weather = Weather(delay_s=way)
    assert await told(rig, FleetAircraft.take_off) is Outcome.STALE_LEASE
    assert one.height < 0.1


@pytest.mark.parametrize("silent_s", [4.0, 8.0])
async def test_what_became_of_an_order_is_reported_when_the_way_is_there_again(
    rig: Rig, silent_s: float
) -> None:
    """What answers is lost for longer than three questions wait."""
    one, pilot = await rig.aircraft("a1", virtual=with_camera()), await rig.pilot()
    await one.agent.ask(orders.Activate())
    asker = pilot["a1"].asker
    lease, _ = await asker.take_lease(asker.lease_request())

    async def break_off() -> None:
        await rig.until(lambda: one.aircraft.vehicle.camera.photos)
        rig.network.cut(one.bus)
        await anyio.sleep(silent_s)
        rig.network.join(one.bus)

    async with anyio.create_task_group() as group:
        group.start_soon(break_off)
        await asker.ask(
            orders.UseCamera(orders.CameraUse.PHOTO), fence=lease.number, token=lease.token
        )
    assert one.aircraft.vehicle.camera.photos == 1


async def test_the_patience_is_what_one_asks_for(rig: Rig) -> None:
    await in_the_air(rig)
    rig.network.weather = Weather(delay_s=3.0)
    pilot = await rig.pilot(patience=4.0)
    began = anyio.current_time()
    with pytest.raises(OutcomeUnknown, match="no answer for 4 s"):
        await pilot["a1"].stop()
    assert anyio.current_time() - began == pytest.approx(4.0, abs=0.5)
    rig.network.weather = Weather(delay_s=7.0)
    assert await told(rig, FleetAircraft.stop, patience=20.0) is Outcome.OK


@pytest.mark.parametrize("seed", range(4))
async def test_what_is_lost_on_a_way_of_a_second_is_asked_again(rig: Rig, seed: int) -> None:
    await in_the_air(rig)
    rig.network.seed(seed)
    rig.network.weather = Weather(loss=0.3, delay_s=1.0, jitter_s=0.2)
    assert await told(rig, FleetAircraft.stop) is Outcome.OK, f"seed {seed}"


# -- values: who is asked, with what, and what is left of it ---------------------------------------


def at(name: str, session: str = "beef") -> str:
    return f"m100-live/field/{name}/{session}"


class Ground:
    """A client whose network is made of mocks; ``tokens`` are those that it answers with."""

    def __init__(self, *tokens: str, **options: Any) -> None:
        self.held: Any = MagicMock()
        self.bus: Any = MagicMock(tokens=AsyncMock(return_value=list(tokens)), ask=AsyncMock())
        self.bus.watch.return_value = self.held
        self.fleet = Fleet(self.bus, site="field", name="anna", **options)


async def test_a_client_hears_tokens_as_long_as_it_is_open() -> None:
    one = Ground(at("kite"), at("hawk"), "m100-live/field/no name/9f", patience=7.5)
    async with one.fleet as fleet:
        assert fleet.present == {"kite", "hawk"}
        asked = call.tokens("m100-live/field/*/*", timeout=7.5)
        watched = call.watch("m100-live/field/*/*", fleet._on_token)
        assert one.bus.mock_calls == [asked, watched]
        assert one.held.close.call_count == 0
    assert one.held.close.call_count == 1


async def test_the_names_are_those_known_and_those_found_now() -> None:
    one = Ground(at("kite"), at("a10"), "m100-live/field/no name/9f")
    one.fleet._on_token(at("a9"), is_there=True)
    assert await one.fleet.names() == ["a9", "a10", "kite"]


async def test_changes_begin_with_those_that_are_there_and_end_with_their_reader() -> None:
    fleet = Ground().fleet
    for name in ("a10", "a9"):
        fleet._on_token(at(name), is_there=True)
    changes: Any = fleet.changes()
    assert [(await anext(changes)).name for _ in range(2)] == ["a9", "a10"]
    waiting = asyncio.ensure_future(anext(changes))
    await asyncio.sleep(0.0)
    fleet._on_token(at("a9", "f00d"), is_there=True)  # a second session of its name
    await asyncio.sleep(0.1)
    assert not waiting.done()
    fleet._on_token(at("a10"), is_there=False)
    assert await waiting == Change("a10", False)
    await changes.aclose()
    assert fleet._listeners == []


async def test_each_aircraft_has_its_own_result() -> None:
    fleet, asked = Ground(at("kite")).fleet, list[str]()

    async def do(one: FleetAircraft) -> object:
        asked.append(one.name)
        if one.name == "hawk":
            raise GuardRefused("low", guard="battery")
        return len(asked)

    found = await fleet.each(do, ["crow", "hawk", "crow", "wren"])
    assert asked == ["crow", "hawk", "wren"]
    assert [(name, one.outcome, one.value) for name, one in found.items()] == [
        ("crow", Outcome.OK, 1),
        ("hawk", Outcome.REFUSED, None),
        ("wren", Outcome.OK, 3),
    ]
    assert list(await fleet.each(do)) == ["kite"], "those that are present"
    assert await fleet.each(do, []) == {}, "to nobody is not to all"


async def test_who_answers_no_question_to_all_is_asked_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A router with rules lets nobody ask all who may not ask each."""
    kite, hawk = Card("kite", "5c", 1.0), Card("hawk", "5d", 2.0)
    answers = {"*": {"kite": kite}, "hawk": {"hawk": hawk}, "wren": {}}
    asked: list[str] = []

    async def cards(bus: Any, keys: Keys) -> dict[str, Card]:
        assert bus is one.bus
        asked.append(keys.name)
        return dict(answers[keys.name])

    one = Ground(at("kite"), at("hawk"), at("wren"))
    monkeypatch.setattr(clients, "cards", cards)
    assert await one.fleet.cards() == {"kite": kite, "hawk": hawk}
    assert asked == ["*", "hawk", "wren"]
    aircraft, order = one.fleet["wren"], AsyncMock()
    monkeypatch.setattr(aircraft.asker, "ask", order)
    order.side_effect = lambda _: answers.update(wren={"wren": hawk})
    assert await aircraft.card() is hawk
    assert order.mock_calls == [call(orders.AskVersion())], "which says why there is none"


async def test_what_is_asked_of_an_aircraft_reaches_its_reader(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    one = Ground(patience=7.5).fleet["kite"]
    fetcher, mission, reach = MagicMock(), AsyncMock(), AsyncMock()
    fetcher.return_value.fetch = AsyncMock()
    monkeypatch.setattr(clients, "LogFetcher", fetcher)
    monkeypatch.setattr(clients, "mission_card", mission)
    monkeypatch.setattr(clients, "reach", reach)
    progress = MagicMock()
    await one.fetch_log("flight.mcap", "logs", progress)
    fetcher.assert_called_once_with(one.asker)
    fetcher.return_value.fetch.assert_called_once_with("flight.mcap", "logs", progress)
    monkeypatch.setattr(one.asker, "is_there", AsyncMock(side_effect=[False, True]))
    with pytest.raises(Unreachable):
        await one.mission()
    await one.mission()
    mission.assert_called_once_with(one.asker, patience=7.5)
    fleet = Ground().fleet
    asker = MagicMock()
    monkeypatch.setattr(fleet, "asker", asker)
    await fleet.reach("kite")
    reach.call_args.args[0]("console")
    asker.assert_called_once_with("kite", "console")
