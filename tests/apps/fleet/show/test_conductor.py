"""A show over a network in memory: agents, signatures, a conductor; one is killed, one refuses."""

from __future__ import annotations

import ast
import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial
from itertools import combinations
from math import dist
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import anyio
import pytest

from m100link.apps.agent.latency import Offset
from m100link.apps.agent.messages import MessageError
from m100link.apps.fleet.identity import Rights, Signer
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.payloads import (
    AskShow,
    LoadTrack,
    OrderReply,
    SendTrack,
    ShowCard,
    ShowStage,
    StartShow,
    TakePlace,
)
from m100link.apps.fleet.show import track_executor
from m100link.apps.fleet.show.conductor import Conductor, Part, _part
from m100link.apps.fleet.show.plan.document import Show, check
from m100link.apps.fleet.show.plan.steering import ShowRefused, Why
from m100link.apps.fleet.show.plan.track import BadShow, TimedTrack
from m100link.apps.fleet.show.service import ShowService
from m100link.apps.fleet.show.track_executor import Leave
from m100link.apps.fleet.signing import verifying
from m100link.errors import GuardRefused, M100Error, NotAllowed, Unreachable, UsageError
from m100link.flight.guards import Envelope, Guards
from m100link.geodesy import LocalFrame
from m100link.protocol.codes import TaskStartCode
from m100link.protocol.commands.control import Task
from m100link.sim.vehicle.settings import AircraftSettings
from m100link.sim.virtual import VirtualAircraft
from tests.apps.bus.memory import Weather
from tests.apps.fleet.conftest import SITE, OnBoard, Rig, anyio_backend, rig
from tests.apps.fleet.show.shows import ORIGIN, row
from tests.apps.fleet.show.shows import track as points_track

__all__ = ["anyio_backend", "rig"]

pytestmark = pytest.mark.anyio

ANNA = Signer("anna", b"a" * 32)
RIGHTS = Rights.parse(
    f'[identity.anna]\npublic_key = "{ANNA.public_key.hex()}"\nfly = ["*"]\n[identity.bert]\n'
    f'public_key = "{Signer("bert", b"b" * 32).public_key.hex()}"\nstop = ["*"]\n'
)


class Company:
    """Aircraft at their places with their agents, and the reports."""

    def __init__(self, rig: Rig, count: int) -> None:
        self.rig = rig
        self.show = Show("", tuple(row(count)))
        self.on_board: list[OnBoard] = []
        self.performing: list[ShowService] = []
        self.services: list[asyncio.Task[None]] = []
        self.told: list[str] = []
        self.off = 0.0  # by which the calendars on board are wrong, s

    async def come(self) -> None:
        for index, track in enumerate(self.show.tracks):
            first = track.points[0]
            place = LocalFrame(*ORIGIN).to_geodetic(first.north, first.east)
            settings = AircraftSettings(latitude_deg=place[0], longitude_deg=place[1])
            virtual = VirtualAircraft(seed=index, settings=settings)
            one = await self.rig.aircraft(track.name, virtual=virtual)
            verify = verifying(RIGHTS, [track.name], lambda: self.rig.utc() + self.off)
            service = ShowService(
                one.client, one.bus, Keys(SITE, track.name), one.fleet_agent.boot, verify=verify
            )
            self.performing.append(service)
            self.services.append(asyncio.ensure_future(service.run()))
            self.on_board.append(one)

    def conductor(self, **options: Any) -> Conductor:
        options.setdefault("sign", ANNA)
        options.setdefault("utc", self.rig.utc)
        self.ground = self.rig.network.session()
        return Conductor(self.ground, SITE, "anna", self.show, tell=self.told.append, **options)

    def places(self) -> list[tuple[float, float, float]]:
        found = []
        for one, track in zip(self.on_board, self.show.tracks, strict=True):
            (north, east), first = one.aircraft.position, track.points[0]
            found.append((first.north + north, first.east + east, one.height))
        return found

    async def nearest(self) -> float:
        """The nearest of any two from now on, until this is cancelled."""
        found = 1e9
        try:
            while True:
                await anyio.sleep(0.05)
                found = min(found, *(dist(a, b) for a, b in combinations(self.places(), 2)))
        except asyncio.CancelledError:
            return found


@asynccontextmanager
async def company(rig: Rig, count: int) -> AsyncIterator[Company]:
    made = Company(rig, count)
    await made.come()
    yield made
    for service in made.services:
        service.cancel()
    await asyncio.gather(*made.services, return_exceptions=True)


def stages(parts: dict[str, Part]) -> list[ShowStage | None]:
    return [part.stage for part in parts.values()]


async def test_five_fly_a_show_and_land(rig: Rig) -> None:
    async with company(rig, 5) as made:
        watching = asyncio.ensure_future(made.nearest())
        parts = await made.conductor().fly()
        assert stages(parts) == [ShowStage.FLOWN] * 5
        assert max(part.farthest_m for part in parts.values()) < 0.3
        await rig.until(lambda: all(one.height == 0 for one in made.on_board))
        watching.cancel()
        assert await watching > 8.0
        assert sum("has flown its track" in text for text in made.told) == 5


@pytest.mark.slow
async def test_one_that_does_not_land_behind_its_track_is_named(rig: Rig) -> None:
    """It hovers there, and nobody has control of it."""
    async with company(rig, 1) as made:
        flight = made.on_board[0].aircraft.vehicle.flight
        begin = flight.start_task

        def start_task(number: int, task: Task, has_authority: bool) -> TaskStartCode:
            return begin(number, task, has_authority and task != Task.LAND)

        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(flight, "start_task", start_task)
            parts = await made.conductor(leave="land").fly()
    assert stages(parts) == [ShowStage.FLOWN]
    assert "land was refused" in parts["a1"].why
    assert any("did not land: land was refused" in one for one in made.told)


@pytest.mark.slow
@pytest.mark.parametrize("after", [0.1, 0.5, 0.9, 1.3])
async def test_a_stop_while_tracks_are_uploaded_lets_nobody_take_off(
    rig: Rig, after: float
) -> None:
    """Somebody sees that the wrong show begins, or people among the aircraft."""
    async with company(rig, 1) as made:
        rig.network.weather = Weather(delay_s=0.2)
        flying = asyncio.ensure_future(made.conductor().fly())
        await anyio.sleep(after)
        assert made.performing[0].performer.stage is not ShowStage.PLACING
        await made.on_board[0].agent.stop()
        with pytest.raises(GuardRefused, match="stop, hover or landing was asked for after it"):
            await flying
        assert made.on_board[0].height == 0.0
        rig.network.weather = Weather()
        assert stages(await made.conductor(leave="hover").fly()) == [ShowStage.FLOWN]


async def test_those_that_are_ready_wait_for_one_that_is_long_on_its_way(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(track_executor, "ATTENDED_S", 5.0)  # for nobody may climb much higher
    async with company(rig, 2) as made:
        high = points_track("a2", (0, 0, 10, 45), (4, 4, 10, 45))
        made.show = Show("", (made.show.tracks[0], high))
        parts = await made.conductor().fly()
        assert stages(parts) == [ShowStage.FLOWN] * 2


async def test_through_a_network_that_loses_and_delays_they_fly_all_the_same(rig: Rig) -> None:
    async with company(rig, 2) as made:
        rig.network.weather = Weather(loss=0.1, repeat=0.1, delay_s=0.005, jitter_s=0.02)
        parts = await made.conductor().fly()
        assert stages(parts) == [ShowStage.FLOWN] * 2


async def test_one_that_is_cut_off_flies_on_and_one_that_is_killed_hovers(rig: Rig) -> None:
    async with company(rig, 3) as made:
        conducting = asyncio.ensure_future(made.conductor(leave="hover").fly())
        await rig.until(lambda: any("begins in" in text for text in made.told))
        await anyio.sleep(9.0)
        cut, killed, _ = made.on_board
        rig.network.cut(cut.bus)
        made.services[1].cancel()  # its executor has gone, and the aircraft is not flown on
        rig.network.cut(killed.bus)
        await anyio.sleep(2.0)
        assert killed.speed < 0.3
        place = made.places()[1]
        parts = await conducting
        assert stages(parts) == [None, None, ShowStage.FLOWN]
        assert "a2 is silent; the others fly on" in made.told
        assert dist(made.places()[1], place) < 0.5
        assert dist(made.places()[0], made.show.tracks[0].points[-1].place) < 0.5


async def test_one_that_has_to_leave_is_named_and_the_others_fly_on(rig: Rig) -> None:
    async with company(rig, 3) as made:
        conducting = asyncio.ensure_future(made.conductor().fly())
        await rig.until(lambda: any("begins in" in text for text in made.told))
        await anyio.sleep(9.0)
        made.on_board[1].aircraft.vehicle.flight.dynamics.east += 2.0
        parts = await conducting
        assert stages(parts) == [ShowStage.FLOWN, ShowStage.LEFT, ShowStage.FLOWN]
        assert "left its track" in parts["a2"].why
        assert any(text.startswith("a2 left: ") for text in made.told)


async def test_all_are_ready_or_none_begins(rig: Rig) -> None:
    """One has a low battery: it refuses to take off, and the others leave and land."""
    async with company(rig, 3) as made:
        made.on_board[1].aircraft.battery_percent = 10.0
        with pytest.raises((ShowRefused, GuardRefused), match=r"a2|battery"):
            await made.conductor().fly()
        await anyio.sleep(15.0)
        assert made.on_board[1].height == 0
        for one in (made.on_board[0], made.on_board[2]):
            assert one.height < 0.1
            assert one.client.holder.number == 0
        assert not any("begins in" in text for text in made.told)


async def test_a_track_of_many_points_arrives(rig: Rig) -> None:
    async with company(rig, 1) as made:
        points = [(0.1 * index, 0.01 * index, 0.0, 4.0) for index in range(200)]
        made.show = Show("", (points_track("a1", *points),))
        parts = await made.conductor().fly()
        assert parts["a1"].digest == made.show.tracks[0].digest
        assert parts["a1"].stage is ShowStage.FLOWN


async def test_one_that_is_not_there_is_named_and_nobody_takes_off(rig: Rig) -> None:
    async with company(rig, 2) as made:
        made.show = Show("", tuple(row(3)))
        with pytest.raises(Unreachable, match="a3 does not answer"):
            await made.conductor().fly()
        assert all(one.height == 0 for one in made.on_board)


@pytest.mark.parametrize(
    ("sign", "said"),
    [
        (None, "signed by nobody"),
        (Signer("bert", b"b" * 32), "bert may not fly"),
        (Signer("bert", b"b" * 32, RIGHTS), "bert may not fly a1; nothing was sent"),
    ],
)
async def test_an_operator_without_the_right_to_fly_conducts_nothing(
    rig: Rig, sign: Any, said: str
) -> None:
    async with company(rig, 1) as made:
        with pytest.raises(NotAllowed, match=said):
            await made.conductor(sign=sign).fly()
        assert made.on_board[0].height == 0
        # Aircraft that were asked for nothing do not have to leave.
        assert len(made.told) == ("nothing was sent" not in said)


@pytest.mark.parametrize("when", ["on their way", "in the countdown"])
async def test_a_conductor_that_is_ended_lets_all_of_them_leave(rig: Rig, when: str) -> None:
    async with company(rig, 2) as made:
        conducting = asyncio.ensure_future(made.conductor().fly())
        if when == "in the countdown":
            await rig.until(lambda: any("begins in" in one for one in made.told))
            await anyio.sleep(4.0)
        else:
            await anyio.sleep(6.0)
        conducting.cancel()
        await asyncio.gather(conducting, return_exceptions=True)
        await anyio.sleep(15.0)
        assert all(one.height < 0.1 for one in made.on_board)
        assert all(one.client.holder.number == 0 for one in made.on_board)
        assert {one.performer.stage for one in made.performing} == {ShowStage.LEFT}


async def test_a_conductor_that_is_ended_later_names_those_that_fly_on(rig: Rig) -> None:
    """Its operator meant to end the show, and has to know that it goes on."""
    async with company(rig, 2) as made:
        conducting = asyncio.ensure_future(made.conductor(leave="hover").fly())
        await rig.until(lambda: any("begins in" in one for one in made.told))
        await anyio.sleep(7.0)
        conducting.cancel()
        await asyncio.gather(conducting, return_exceptions=True)
        assert made.told[-1] == "a1, a2: the show goes on; m100link fleet stop --all stops them"
        await anyio.sleep(2.0)
        assert {one.performer.stage for one in made.performing} == {ShowStage.FLYING}


async def test_a_network_that_is_too_slow_to_tell_the_time_begins_nothing(rig: Rig) -> None:
    async with company(rig, 1) as made:
        rig.network.weather = Weather(delay_s=0.08)
        with pytest.raises(M100Error, match="may be wrong by"):
            await made.conductor().fly()


LINE = ((0, 0, 0, 4), (2, 0, 0, 4), (22, 40, 0, 4), (40, 40, 0, 4))
# It crosses the line of the first one ten seconds after that one has passed.
CROSSING = ((0, 20, -20, 4), (12, 20, -20, 4), (32, 20, 20, 4))
FAR = [((0, 0, 60 + 10 * n, 4), (30, 12, 60 + 10 * n, 6)) for n in range(3)]


@asynccontextmanager
async def crossing(rig: Rig) -> AsyncIterator[Company]:
    """Five, of which the second crosses the way of the first."""
    made = Company(rig, 0)
    points = (LINE, CROSSING, *FAR)
    made.show = Show("", tuple(points_track(f"a{n + 1}", *one) for n, one in enumerate(points)))
    await made.come()
    yield made
    for service in made.services:
        service.cancel()
    await asyncio.gather(*made.services, return_exceptions=True)


async def until_it_flies(made: Company, at: float) -> None:
    await made.rig.until(lambda: any("begins in" in text for text in made.told), within=120.0)
    await anyio.sleep(5.0 + at)


async def test_five_whose_ways_cross_at_different_times_fly_them_to_the_end(rig: Rig) -> None:
    async with crossing(rig) as made:
        assert check(made.show).ok
        parts = await made.conductor(leave="hover").fly()
        assert stages(parts) == [ShowStage.FLOWN] * 5


@pytest.mark.parametrize("leave", ["hover", "land"])
async def test_one_that_is_blown_off_in_anothers_way_is_not_flown_into(
    rig: Rig, leave: Leave
) -> None:
    """As it hovers there; on the ground it is in nobody's way any more."""
    async with crossing(rig) as made:
        conducting = asyncio.ensure_future(made.conductor(leave=leave).fly())
        await until_it_flies(made, 11.5)
        watching = asyncio.ensure_future(made.nearest())
        made.on_board[0].aircraft.vehicle.flight.dynamics.east += 2.0
        parts = await conducting
        await anyio.sleep(10.0)
        watching.cancel()
        second = ShowStage.LEFT if leave == "hover" else ShowStage.FLOWN
        assert stages(parts) == [ShowStage.LEFT, second, *[ShowStage.FLOWN] * 3]
        assert "left its track" in parts["a1"].why
        if second is ShowStage.LEFT:
            assert "a1 would come as near as" in parts["a2"].why
            assert any("a2 left: " in text for text in made.told)
        assert await watching > made.show.least_distance_m


async def test_one_that_is_killed_in_anothers_way_is_not_flown_into(rig: Rig) -> None:
    """Nobody hears it any more, and the others are heard."""
    async with crossing(rig) as made:
        conducting = asyncio.ensure_future(made.conductor(leave="hover").fly())
        await until_it_flies(made, 11.0)
        watching = asyncio.ensure_future(made.nearest())
        made.services[0].cancel()
        rig.network.cut(made.on_board[0].bus)
        parts = await conducting
        await anyio.sleep(10.0)
        watching.cancel()
        assert stages(parts) == [None, ShowStage.LEFT, *[ShowStage.FLOWN] * 3]
        assert "a1 would come as near as" in parts["a2"].why
        assert await watching > made.show.least_distance_m


async def test_a_second_show_with_one_of_them_is_refused_and_the_first_goes_on(rig: Rig) -> None:
    """It ended the first one for that aircraft, in the air, and let nobody know."""
    async with company(rig, 2) as made:
        conducting = asyncio.ensure_future(made.conductor().fly())
        await until_it_flies(made, 3.0)
        made.show = Show("", made.show.tracks[1:])
        with pytest.raises(UsageError, match="a2 is flying in a show of another conductor"):
            await made.conductor().fly()
        assert stages(await conducting) == [ShowStage.FLOWN] * 2


async def test_when_not_all_were_ordered_to_begin_none_begins(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The conductor is killed in between: one would fly where the other one still hovers."""
    async with company(rig, 2) as made:
        conductor = made.conductor(leave="hover")
        start = conductor._start

        async def start_the_first(track: TimedTrack, *more: Any) -> None:
            await (start(track, *more) if track.name == "a1" else anyio.sleep_forever())

        monkeypatch.setattr(conductor, "_start", start_the_first)
        conducting = asyncio.ensure_future(conductor.fly())
        first, second = (service.performer for service in made.performing)
        await rig.until(lambda: first.stage is ShowStage.FLYING, within=120.0)
        monkeypatch.setattr(conductor, "leave", anyio.sleep_forever)  # of a process nothing is left
        rig.network.cut(made.ground)
        place = made.places()[0]
        await anyio.sleep(20.0)
        conducting.cancel()
        assert (first.stage, second.stage) == (ShowStage.LEFT, ShowStage.LEFT)
        assert "1 of the others are silent" in str(first.fault)
        assert dist(made.places()[0], place) < 0.3


async def test_a_clock_that_is_set_in_flight_costs_a_show_nothing(rig: Rig) -> None:
    """Orders are signed with the time of day, too; tracks are flown by a clock that nobody sets."""
    ahead_s = 0.0
    async with company(rig, 1) as made:
        conductor = made.conductor(leave="hover", utc=lambda: rig.utc() + ahead_s)
        conducting = asyncio.ensure_future(conductor.fly())
        await until_it_flies(made, 3.0)
        ahead_s = 3600.0
        parts = await conducting
        assert parts["a1"].stage is ShowStage.FLOWN


@asynccontextmanager
async def two_crossing(rig: Rig) -> AsyncIterator[Company]:
    """Two, of which the second comes to the way of the first when that one has passed."""
    made = Company(rig, 0)
    points = LINE, CROSSING
    made.show = Show("", tuple(points_track(f"a{n + 1}", *one) for n, one in enumerate(points)))
    await made.come()
    yield made
    for service in made.services:
        service.cancel()
    await asyncio.gather(*made.services, return_exceptions=True)


@pytest.mark.parametrize("at", [9.0, 11.0])
async def test_of_two_one_that_is_killed_is_not_flown_into(rig: Rig, at: float) -> None:
    """Who is left hears nobody, and cannot know whether it is itself that is cut off."""
    async with two_crossing(rig) as made:
        conducting = asyncio.ensure_future(made.conductor(leave="hover").fly())
        await until_it_flies(made, at)
        watching = asyncio.ensure_future(made.nearest())
        made.services[0].cancel()
        rig.network.cut(made.on_board[0].bus)
        parts = await conducting
        await anyio.sleep(30.0)
        watching.cancel()
        assert await watching > made.show.least_distance_m
        assert all(one.speed < 0.1 for one in made.on_board)
        assert stages(parts)[0] is None


@pytest.mark.parametrize(("at", "leave"), [(3.0, "hover"), (11.0, "land"), (11.0, "hover")])
async def test_when_nobody_hears_anybody_no_two_meet_whichever_leaves(
    rig: Rig, at: float, leave: Leave
) -> None:
    """The router is gone: each has to count on the other to be killed, to fly on, or to leave."""
    async with two_crossing(rig) as made:
        conducting = asyncio.ensure_future(made.conductor(leave=leave).fly())
        await until_it_flies(made, at)
        watching = asyncio.ensure_future(made.nearest())
        for one in made.on_board:
            rig.network.cut(one.bus)
        await conducting
        await anyio.sleep(60.0)
        watching.cancel()
        assert await watching > made.show.least_distance_m
        first, second = (service.performer.stage for service in made.performing)
        assert first is ShowStage.FLOWN, "the other one's way lies behind it, or is not reached"
        assert second in (ShowStage.FLOWN, ShowStage.LEFT)


async def test_a_track_that_the_guards_on_board_do_not_let_fly_is_not_begun(rig: Rig) -> None:
    async with company(rig, 2) as made:
        slow = Guards(envelope=Envelope(max_speed_m_s=1.0))
        made.on_board[1].agent.holding._guards = slow
        await anyio.sleep(1.0)
        with pytest.raises(M100Error, match=r"a2.*its guards allow 1\.0 m/s"):
            await made.conductor().fly()
        await anyio.sleep(3.0)
        assert [one.height for one in made.on_board] == [0, 0], "none takes off before all compared"
        assert made.told == []


@pytest.mark.parametrize("leave", ["hover", "land"])
async def test_what_has_taken_off_hovers_or_lands_where_another_cannot_begin(
    rig: Rig, leave: Leave
) -> None:
    """As its --leave says, and the conductor names it."""
    async with company(rig, 3) as made:
        made.on_board[2].aircraft.battery_percent = 10.0
        with pytest.raises(M100Error, match="a3"):
            await made.conductor(leave=leave).fly()
        does = {"hover": "hover, and nobody has control of them", "land": "land"}[leave]
        assert f"had to take off: a1, a2, a3; those in the air {does}" in made.told
        await anyio.sleep(10.0)
        heights = [one.height for one in made.on_board]
        assert [height > 0.5 for height in heights] == [leave == "hover"] * 2 + [False], heights
        assert all(one.client.holder.number == 0 for one in made.on_board)


def all_are(made: Company, stage: ShowStage) -> Callable[[], bool]:
    return lambda: {one.performer.stage for one in made.performing} == {stage}


async def test_calendars_that_differ_let_all_leave_a_show(rig: Rig) -> None:
    async with company(rig, 2) as made:
        conductor = made.conductor(leave="hover")
        flight = asyncio.ensure_future(conductor.fly())
        await rig.until(all_are(made, ShowStage.FLYING))
        await anyio.sleep(8.0)
        made.off = 86_400.0  # set in flight
        await conductor.leave()
        assert all_are(made, ShowStage.LEFT)()
        await flight


async def test_who_does_not_confirm_that_it_leaves_is_named(rig: Rig) -> None:
    async with company(rig, 3) as made:
        conductor = made.conductor(leave="hover")
        flight = asyncio.ensure_future(conductor.fly())
        await rig.until(all_are(made, ShowStage.READY))
        rig.network.cut(made.on_board[1].bus)
        flight.cancel()
        await asyncio.wait([flight])
        name = made.show.tracks[1].name
        said = [one for one in made.told if "did not confirm" in one]
        assert said == [f"{name} did not confirm that it leaves: {name} does not answer"]


# -- what a conductor sends, and how long it waits, by answers that are given ----------------------


class Answering:
    """A conductor of two aircraft, and what each answers."""

    def __init__(self, **options: Any) -> None:
        self.told: list[str] = []
        self.asked: list[tuple[float, str, Any]] = []
        tracks = row(2)
        self.show = Show("", tuple(tracks), 4.5)
        bus: Any = None
        self.conductor = Conductor(bus, SITE, "anna", self.show, tell=self.told.append, **options)
        self.began_at = anyio.current_time()
        self.stage: Callable[[str], ShowStage | None] = lambda _name: ShowStage.READY
        self.clock: Offset | None = Offset(250.0, 0.03125)
        for name in ("a1", "a2"):
            once = partial(self.once, name)
            its_clock = SimpleNamespace(offset=lambda _now: self.clock)
            keys = Keys(SITE, name)
            fake: Any = SimpleNamespace(
                once=once, keys=keys, its_clock=its_clock, require=lambda _: None
            )
            self.conductor._askers[name] = fake
        self.track = tracks[0]

    @property
    def now(self) -> float:
        return anyio.current_time() - self.began_at

    async def once(self, name: str, key: str, asked: Any, **how: Any) -> OrderReply | None:
        assert (key, how["within"]) == (f"m100/{SITE}/{name}/show", 1.0)
        self.asked.append((round(self.now, 3), name, asked))
        stage = self.stage(name)
        if stage is None:
            return None
        card = ShowCard(stage, self.track.digest, 0.75, "wind")
        return OrderReply.done("", name, "run", None, clock=83.25, show=card)


async def test_the_time_to_begin_is_sent_by_the_clock_of_each() -> None:
    one = Answering()
    await one.conductor._start(one.track, 1000.0)
    [(_, name, asked)] = one.asked
    assert (name, asked) == (
        "a1",
        StartShow(one.conductor._run, one.track.digest, 1250.0, 0.03125),
    )
    for clock, bound in ((Offset(250.0, 0.0625), "62 ms"), (None, "inf ms")):
        one.clock = clock
        with pytest.raises(ShowRefused, match=f"of a1 may be wrong by {bound}") as caught:
            await one.conductor._start(one.track, 1000.0)
        assert (caught.value.why, caught.value.limit) == (Why.CLOCK, 0.05)
    one.clock = Offset(250.0, 0.05)
    await one.conductor._start(one.track, 1000.0)


async def test_a_track_is_sent_in_pieces_of_800_bytes_with_what_the_others_are() -> None:
    one = Answering(leave="hover")
    points = tuple((n, 0, 0.1 * n, 4) for n in range(60))
    long = points_track("a1", *points)
    one.track = long
    await one.conductor._load(long)
    pieces = [asked for *_, asked in one.asked if isinstance(asked, SendTrack)]
    assert [piece.at for piece in pieces] == [0, 800, 1600]
    assert b"".join(piece.data for piece in pieces) == long.to_bytes()
    run = one.conductor._run  # a place that was recorded at an earlier run is of another show
    assert one.asked[-1][2] == LoadTrack(run, "hover", run[:16], 4.5, 1)
    one.track = row(2)[1]
    with pytest.raises(BadShow, match="a1 has another track"):
        await one.conductor._load(long)


@pytest.mark.parametrize(("ready_at", "is_ready"), [(0.0, True), (179.0, True), (181.0, False)])
async def test_a_place_is_taken_within_three_minutes(ready_at: float, is_ready: bool) -> None:
    await anyio.sleep(1000.0)
    one = Answering()
    one.stage = lambda _: ShowStage.READY if one.now >= ready_at else ShowStage.PLACING
    if is_ready:
        await one.conductor._place(one.track)
        assert one.now == pytest.approx(ready_at, abs=0.6)
        return
    with pytest.raises(ShowRefused, match="a1 did not take its place: wind") as caught:
        await one.conductor._place(one.track)
    assert caught.value.measured == pytest.approx(180.5)
    assert (caught.value.why, caught.value.limit) == (Why.PLACE, 180.0)
    with pytest.raises(MessageError, match="a1 does not report its stage in the show"):
        _part(OrderReply.done("", "a1", "run", None))


@pytest.mark.parametrize("silent", [4.0, 7.0])
async def test_one_that_tells_nothing_for_five_seconds_is_silent(silent: float) -> None:
    one = Answering()

    def stage(_name: str) -> ShowStage | None:
        if 10.0 <= one.now <= 10.0 + silent:
            return None
        return ShowStage.FLOWN if one.now > 30.0 else ShowStage.FLYING

    one.stage = stage
    part = await one.conductor._watch(one.track)
    if silent < 5.0:
        assert part == Part("a1", ShowStage.FLOWN, one.track.digest, 0.75, "wind", 83.25)
        assert one.told == ["a1 has flown its track, and did not land: wind"]
    else:
        assert part == Part("a1", None)
        assert one.told == ["a1 is silent; the others fly on"]
        assert one.conductor._rest("a2") == "", "none is left that flies"
        assert 14.9 <= one.now < 16.0


async def test_it_begins_five_seconds_after_all_are_ready_and_is_heard_every_two() -> None:
    await anyio.sleep(7.0)
    one = Answering()
    order = {
        LoadTrack: ShowStage.LOADED,
        TakePlace: ShowStage.READY,
        StartShow: ShowStage.FLYING,
    }
    stage = {"a1": ShowStage.EMPTY, "a2": ShowStage.EMPTY}
    tracks = {each.name: each for each in one.show.tracks}

    def answer(name: str) -> ShowStage:
        asked = one.asked[-1][2]
        one.track = tracks[name]
        stage[name] = order.get(type(asked), stage[name])
        if isinstance(asked, StartShow) or stage[name] is not ShowStage.FLYING:
            return stage[name]
        return ShowStage.FLOWN if one.now > 12.0 else ShowStage.FLYING

    one.stage = answer
    parts = await one.conductor.fly()
    assert {name: part.stage for name, part in parts.items()} == dict.fromkeys(
        ("a1", "a2"), ShowStage.FLOWN
    )
    starts = [asked.at for *_, asked in one.asked if isinstance(asked, StartShow)]
    began = [at for at, _, asked in one.asked if isinstance(asked, StartShow)]
    assert starts == [pytest.approx(began[0] + one.began_at + 5.0 + 250.0)] * 2
    assert one.told[:3] == [
        "all have their tracks",
        "all are at their places",
        "the show begins in 5.0 s",
    ]
    before = [at for at, name, asked in one.asked if name == "a1" and 0.0 < at < 5.0]
    assert before == pytest.approx([2.0, 4.0], abs=0.01)
    measured = [asked for at, name, asked in one.asked if (at, name) == (0.0, "a1")]
    assert sum(isinstance(asked, AskShow) for asked in measured) == 1 + 1 + 12


def test_each_refusal_of_a_show_says_what_to_do() -> None:
    """But for messages of others that nobody reads: their reader drops them."""
    folder = Path(track_executor.__file__).parent
    lacking = []
    for path in sorted(folder.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Name):
                continue
            if node.func.id in KINDS and "remedy" not in {word.arg for word in node.keywords}:
                lacking.append((path.name, node.lineno))
    assert [name for name, _ in lacking] == ["conflicts.py", "conflicts.py"], lacking


KINDS = (
    *("BadShow", "ShowRefused", "LeftShow", "UsageError", "TelemetryStalled", "M100Error"),
    *("NoAuthority", "NotAllowed", "GuardRefused"),
)
