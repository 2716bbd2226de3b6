"""Several aircraft and one operator: what is steered, what hovers, and whose control lasts."""

from __future__ import annotations

import asyncio
import json
import math
import pickle
import random
import signal
import time
from array import array
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import AsyncExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from urllib.parse import parse_qs, urlsplit

import anyio
import pytest

from m100link import Credentials, connect
from m100link.apps.agent import orders
from m100link.apps.agent.control_session import ControlSession
from m100link.apps.agent.messages import Event, State
from m100link.apps.agent.server.server import AgentServer
from m100link.apps.agent.transports import memory_channels
from m100link.apps.station.console import kept
from m100link.apps.station.console.kept import (
    COLUMNS,
    COMMANDED,
    INTERVAL,
    KEPT_S,
    PlotHistory,
    Recorded,
    analyse,
    analysed,
    begin_analysis,
)
from m100link.apps.station.console.tab import Tab
from m100link.apps.station.console.tabs import MOVE_PATIENCE, Tabs
from m100link.apps.station.console.view.alarms import MOMENT_S, AlarmName
from m100link.apps.station.console.view.header import Cause
from m100link.apps.station.console.view.situation import Inputs, RecordedFlight
from m100link.apps.station.console.view.view_model import Memory, view_of
from m100link.errors import M100Error
from m100link.log import recorder
from m100link.log.reading import Message
from m100link.log.story import Curves, FlightSummary, read_story
from m100link.protocol import profile
from m100link.protocol.records import Attitude, Position, quaternion
from m100link.protocol.setpoint import Setpoint
from m100link.sim import VirtualClockEventLoop
from m100link.sim.orders import perform
from m100link.sim.ports import driver
from m100link.sim.virtual import VirtualAircraft
from tests.apps.agent.server.test_replays import station
from tests.apps.station.conftest import Rig
from tests.apps.station.console.test_tab import Browser
from tests.known import seen
from tests.log.flight import APP_ID, KEY
from tests.waiting import PATIENCE

pytestmark = pytest.mark.anyio

NORTH = {"x": -4.0}


@dataclass
class Fleet:
    """Two virtual aircraft, and the console's tabs for them."""

    rigs: dict[str, Rig]
    tabs: Tabs

    def page(self, aircraft: str, address: str = "") -> Browser:
        """A page of that aircraft, opened by the address that the one before gave."""
        asked = {name: one[0] for name, one in parse_qs(urlsplit(address).query).items()}
        assert not address or asked["aircraft"] == aircraft
        _, tab = self.tabs.open(aircraft, asked.get("moved", ""))
        page = Browser(self.rigs[aircraft], tab.session.name)
        page.tab.close()
        page.tab = tab
        return page

    async def flown(self, aircraft: str) -> Browser:
        """A page whose aircraft hovers above the ground."""
        page, rig = self.page(aircraft), self.rigs[aircraft]
        page.say("alive")
        await page.tab.session.ask(orders.Activate())
        await page.tab.session.obtain()
        rig.front.background.spawn(keep_alive(page), "page")
        await page.tab.session.ask(orders.TakeOff())
        return page


async def keep_alive(page: Browser) -> None:
    """What the page says as long as it is there."""
    while True:
        page.say("alive")
        await anyio.sleep(0.5)


@pytest.fixture
async def fleet() -> AsyncIterator[Fleet]:
    rigs = {"kite": Rig(VirtualAircraft(seed=5)), "crow": Rig(VirtualAircraft(seed=6))}
    async with AsyncExitStack() as stack:
        for rig in rigs.values():
            await stack.enter_async_context(rig.running())
        yield Fleet(rigs, Tabs({name: rig.front for name, rig in rigs.items()}))


def is_steered(rig: Rig) -> bool:
    return bool(rig.moves) and (rig.moves[-1].roll_or_x, rig.moves[-1].pitch_or_y) != (0.0, 0.0)


async def test_beats_reach_the_aircraft_of_their_page_and_no_other(fleet: Fleet) -> None:
    kite, crow = await fleet.flown("kite"), await fleet.flown("crow")
    before = len(fleet.rigs["crow"].moves)
    await kite.hold(0.5, **NORTH)
    assert is_steered(fleet.rigs["kite"])
    assert not any(move.roll_or_x or move.pitch_or_y for move in fleet.rigs["crow"].moves[before:])
    assert kite.tab.session.has_lease
    assert crow.tab.session.has_lease


async def test_an_operator_who_turns_to_another_stops_the_first_and_keeps_control_of_both(
    fleet: Fleet,
) -> None:
    first = await fleet.flown("kite")
    rig = fleet.rigs["kite"]
    await first.hold(0.5, **NORTH)
    lease = first.tab.session.lease
    address = fleet.tabs.move(first.tab, "crow")
    await anyio.sleep(0.1)  # less than a beat lasts
    assert not is_steered(rig), "it flew on"
    await first.hold(0.3, **NORTH)  # a finger that is still on the key
    assert not is_steered(rig), "the page that was left still steers"
    assert any("keeps control: it hovers" in event.text for event in rig.front.events)
    second = fleet.page("crow", address)
    fleet.tabs.close(next(key for key, tab in fleet.tabs.tabs.items() if tab is first.tab))
    assert second.tab.session.name == first.tab.session.name
    assert second.tab.kept["kite"].has_lease
    for _ in range(20):
        second.say("alive")
        await anyio.sleep(0.5)
    assert rig.front.holds(lease)
    assert rig.agent.holding.has_authority
    third = fleet.page("kite", fleet.tabs.move(second.tab, "kite"))
    assert third.tab.session.has_lease
    third.say("alive")
    await third.hold(0.3, **NORTH)
    assert is_steered(rig)


async def test_control_that_nobody_takes_along_is_given_back(fleet: Fleet) -> None:
    first = await fleet.flown("kite")
    rig = fleet.rigs["kite"]
    fleet.tabs.move(first.tab, "crow")  # and the other page never opens
    await anyio.sleep(MOVE_PATIENCE - 1.0)
    assert rig.agent.holding.has_authority
    await rig.until(lambda: not rig.agent.holding.has_authority, within=3.0)


async def test_a_page_that_is_slow_to_load_does_not_lose_control(fleet: Fleet) -> None:
    first = await fleet.flown("kite")
    address = fleet.tabs.move(first.tab, "crow")
    await anyio.sleep(2.0)
    second = fleet.page("crow", address)
    await anyio.sleep(MOVE_PATIENCE - 3.0)  # longer than a lease lasts
    second.say("alive")
    await anyio.sleep(1.0)
    assert second.tab.kept["kite"].has_lease
    await anyio.sleep(3.5)  # and from now on it counts whether it is heard
    assert not second.tab.kept["kite"].has_lease


async def test_a_page_that_is_lost_gives_back_everything_it_kept(fleet: Fleet) -> None:
    first = await fleet.flown("kite")
    second = fleet.page("crow", fleet.tabs.move(first.tab, "crow"))
    second.say("alive")
    await anyio.sleep(1.0)
    assert second.tab.kept["kite"].has_lease
    second.tab.lost()
    rig = fleet.rigs["kite"]
    await rig.until(lambda: not rig.agent.holding.has_authority, within=1.0)


async def test_a_page_that_hangs_gives_back_everything_it_kept(fleet: Fleet) -> None:
    first = await fleet.flown("kite")
    second = fleet.page("crow", fleet.tabs.move(first.tab, "crow"))
    second.say("alive")
    await anyio.sleep(2.5)
    rig = fleet.rigs["kite"]
    assert rig.agent.holding.has_authority
    await rig.until(lambda: not rig.agent.holding.has_authority, within=1.5)


async def test_what_the_aircraft_flies_by_itself_goes_on(fleet: Fleet) -> None:
    first = await fleet.flown("kite")
    rig = fleet.rigs["kite"]
    rig.front.background.spawn(
        first.tab.attempt(lambda: first.tab.session.ask(orders.Land())), "landing"
    )
    await rig.until(lambda: bool(rig.front.state.task))
    fleet.page("crow", fleet.tabs.move(first.tab, "crow"))
    assert any(
        event.text.endswith("mission or task that it flies goes on") for event in await told(rig)
    )
    await rig.until(lambda: rig.aircraft.height < 0.1)


async def told(rig: Rig) -> list[Event]:
    await anyio.sleep(0.1)
    return list(rig.front.events)


async def test_an_operator_who_has_no_control_stops_nobody_by_looking_elsewhere(
    fleet: Fleet,
) -> None:
    pilot = await fleet.flown("kite")
    onlooker = fleet.page("kite")
    await pilot.hold(0.3, **NORTH)
    fleet.tabs.move(onlooker.tab, "crow")
    await pilot.hold(0.3, **NORTH)
    assert is_steered(fleet.rigs["kite"])


async def test_two_operators_have_an_aircraft_each(fleet: Fleet) -> None:
    one, other = await fleet.flown("kite"), await fleet.flown("crow")
    other_page = fleet.page("kite")
    await other_page.tab.attempt(other_page.tab.session.obtain)
    assert "has control" in other_page.problem
    one.tab.lost()
    rigs = fleet.rigs
    await rigs["kite"].until(lambda: not rigs["kite"].agent.holding.has_authority)
    assert other.tab.session.has_lease
    await other.hold(0.3, **NORTH)
    assert is_steered(rigs["crow"])


async def test_an_agent_that_dies_stays_shown_and_takes_nothing_of_the_other(fleet: Fleet) -> None:
    first = await fleet.flown("kite")
    second = fleet.page("crow", fleet.tabs.move(first.tab, "crow"))
    second.say("alive")
    await second.tab.session.ask(orders.Activate())
    await second.tab.session.obtain()
    fleet.rigs["crow"].front._closed("killed")
    second.say("beat", mode=1, x=-4.0, y=0, z=0, w=0)
    assert not second.tab.session.has_lease
    assert second.tab.aircraft == "crow"
    for _ in range(10):
        second.say("alive")
        await anyio.sleep(0.5)
    assert second.tab.kept["kite"].has_lease
    assert fleet.rigs["kite"].agent.holding.has_authority


async def test_a_name_that_there_is_not_and_a_code_that_was_used_are_nothing(fleet: Fleet) -> None:
    first = await fleet.flown("kite")
    address = fleet.tabs.move(first.tab, "crow")
    assert "kite" in fleet.page("crow", address).tab.kept
    again: Tab = fleet.page("crow", address).tab
    assert "kite" not in again.kept
    _, tab = fleet.tabs.open("nobody", "guessed")
    assert tab.aircraft == "kite"
    assert not tab.session.has_lease


async def test_control_that_comes_when_its_page_has_gone_is_given_back(fleet: Fleet) -> None:
    """Whichever moment of the request it was, and whatever of it was still to come."""
    rig = fleet.rigs["kite"]
    await fleet.page("kite").tab.session.ask(orders.Activate())
    for turns in range(12):
        page = fleet.page("kite")
        obtaining = [asyncio.create_task(page.tab.session.obtain()) for _ in range(2)]
        for _ in range(turns):
            await asyncio.sleep(0.0)
        page.tab.close()
        await asyncio.gather(*obtaining, return_exceptions=True)
        await anyio.sleep(0.3)
        assert rig.agent.leases.holder(rig.agent.now) is None, turns
        assert not rig.agent.holding.has_authority, turns


async def test_control_that_is_being_obtained_goes_along(fleet: Fleet) -> None:
    first, rig = fleet.page("kite"), fleet.rigs["kite"]
    await first.tab.session.ask(orders.Activate())
    obtaining = asyncio.create_task(first.tab.session.obtain())
    await rig.until(lambda: first.tab.session.has_lease)
    second = fleet.page("crow", fleet.tabs.move(first.tab, "crow"))
    await obtaining
    assert second.tab.kept["kite"].has_control
    assert not first.tab.session.has_lease
    first.tab.close()  # which takes nothing from the other page
    second.say("alive")
    await anyio.sleep(0.1)
    assert second.tab.kept["kite"].has_control


class Hands:
    """Two operators who press whatever there is, at any moment; agents die and come back."""

    def __init__(self, fleet: Fleet, seed: int) -> None:
        self.fleet, self.draw = fleet, random.Random(seed)
        self.pages = [fleet.page("kite"), fleet.page("crow")]
        self.asked: list[asyncio.Task[object]] = []

    def _begin(self, page: Browser, work: Callable[[], Awaitable[object]]) -> None:
        self.asked.append(asyncio.create_task(page.tab.attempt(work)))

    async def step(self) -> None:
        number = self.draw.randrange(2)
        page, what = self.pages[number], self.draw.randrange(9)
        session, tabs = page.tab.session, self.fleet.tabs
        if what <= 1:
            self._begin(page, session.obtain)
        elif what == 2:
            self._begin(page, self._taking_over(page))
        elif what == 3:
            self._begin(page, session.give_back)
        elif what == 4:
            page.tab.lost()
        elif what == 5:
            other = self.draw.choice(["kite", "crow"])
            address = tabs.move(page.tab, other)
            if self.draw.random() < 0.8:
                self.pages[number] = self.fleet.page(other, address)
            page.tab.close()
        elif what == 6:
            self.reopen(self.draw.choice(list(self.fleet.rigs.values())))
        elif what == 7:
            self._begin(page, page.tab.stop)
        else:
            page.say(self.draw.choice(["alive", "rest"]))
        for _ in range(self.draw.randrange(6)):
            await asyncio.sleep(self.draw.choice([0.0, 0.0, 0.0, 0.02]))

    def _taking_over(self, page: Browser) -> Callable[[], Awaitable[object]]:
        async def take_over() -> None:
            await page.tab.session.confirm(await page.tab.session.ask_take_over())

        return take_over

    def reopen(self, rig: Rig) -> None:
        rig.front._channel.close("killed")
        rig.front._closed("killed")
        ours, its = memory_channels(as_bytes=True)
        AgentServer(rig.agent).attach(its)
        rig.front.reopen(ours)

    def holders(self, name: str) -> list[ControlSession]:
        """The sessions that have that aircraft."""
        tabs = [page.tab for page in self.pages]
        every = [tab.session for tab in tabs if tab.aircraft == name]
        every += [tab.kept[name] for tab in tabs if name in tab.kept]
        return [one for one in every if one.has_lease]


@pytest.mark.parametrize("seed", range(3))
async def test_in_whatever_order_an_aircraft_has_one_hand_and_in_the_end_none(
    fleet: Fleet, seed: int
) -> None:
    rigs = fleet.rigs
    for rig in rigs.values():
        await rig.activated()
    before = {name: len(rig.front.on_lease) for name, rig in rigs.items()}
    hands = Hands(fleet, seed)
    for step in range(60):
        await hands.step()
        for name in rigs:
            assert len(hands.holders(name)) <= 1, (seed, step)
    for page in hands.pages:
        page.tab.close()
    await asyncio.gather(*hands.asked)
    await anyio.sleep(MOVE_PATIENCE + 1.0)
    for name, rig in rigs.items():
        assert rig.agent.leases.holder(rig.agent.now) is None, (seed, name)
        assert not rig.agent.holding.has_authority, (seed, name)
        assert len(rig.front.on_lease) == before[name], (seed, name)


# -- the last minutes of every number --------------------------------------------------------------

STATE = State(at=0.0, round_trip=0.02, discards=3, late_acks=1)
HEIGHT, CHARGE = "position.height_m", "battery.percent"


async def test_rows_are_taken_ten_times_a_second_and_a_stalled_line_is_a_gap(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kept, "time", SimpleNamespace(time=lambda: 1e9))
    await anyio.sleep(0.5)  # at 0 a time has no sign
    history = PlotHistory()
    rig.front.background.spawn(history.keep(rig.front), "history")
    await anyio.sleep(5.0)
    assert history.count == pytest.approx(5.0 / INTERVAL, abs=1)
    assert rig.front.telemetry is not None
    position = rig.front.telemetry.get(Position)
    assert position is not None
    rows = history.rows([HEIGHT, "line.packages_per_s"])
    assert rows[-1][1] == pytest.approx(position.height_m, abs=0.5)
    assert rows[-1][2] == pytest.approx(100.0, abs=5.0)
    assert rows[-1][0] - rows[0][0] == pytest.approx(5.0, abs=0.3)
    assert rows[0][0] == pytest.approx(1e9 + INTERVAL, abs=0.05)
    assert history.lag == pytest.approx(0.0, abs=0.01)
    rig.aircraft.stall_line()
    await anyio.sleep(3.0)
    assert math.isnan(history.rows([HEIGHT])[-1][1])
    loop = cast(VirtualClockEventLoop, asyncio.get_running_loop())
    loop._jumping.now += 0.3  # something else has this processor
    await anyio.sleep(1.0)
    assert history.lag == pytest.approx(0.3, abs=0.1), "the worst of the last second is forgotten"
    await anyio.sleep(1.1)
    assert history.lag == pytest.approx(0.0, abs=0.01)


def test_the_oldest_rows_go() -> None:
    history = PlotHistory()
    size = round(KEPT_S / INTERVAL)
    for number in range(size + 50):
        history.add(float(number), seen(None, state=STATE))
    rows = history.rows(["line.front_lag_ms"])
    assert len(rows) == size
    assert rows[0][0] == 50.0
    assert rows[-1][0] == size + 49.0


def test_without_an_aircraft_nothing_has_a_value() -> None:
    history = PlotHistory()
    history.add(1.0, seen(None, state=STATE))
    ((_, *values),) = history.rows(COLUMNS[:-1])
    assert all(math.isnan(value) for value in values)


@pytest.mark.parametrize("begin", [0, 3, 7])
def test_a_window_that_moves_on_keeps_its_points(begin: int) -> None:
    history = PlotHistory()
    for number in range(100):
        history.add(float(number), seen(None, state=STATE))
    before = [row[0] for row in history.rows([], last_s=5.0, step=10)]
    for number in range(begin):
        history.add(100.0 + number, seen(None, state=STATE))
    after = [row[0] for row in history.rows([], last_s=5.0, step=10)]
    assert before == [50.0, 60.0, 70.0, 80.0, 90.0]
    assert set(after) - set(before) <= {100.0}


def test_what_was_seen_does_not_come_again_and_a_pause_hides_what_came_later() -> None:
    history = PlotHistory()
    for number in range(20):
        history.add(float(number), seen(None, state=STATE))
    assert [row[0] for row in history.rows([], since=18)] == [18.0, 19.0]
    assert [row[0] for row in history.rows([], until=10, last_s=0.3)] == [7.0, 8.0, 9.0]


def test_a_download_has_a_line_for_each_row_and_nothing_where_there_was_no_value() -> None:
    history = PlotHistory()
    history.lag = 0.0125
    for number in range(3):
        history.add(1e9 + number / 10, seen(None, state=STATE))
    text = history.csv([HEIGHT, "line.front_lag_ms"], until=2)
    assert text.splitlines() == [
        "utc,position.height_m,line.front_lag_ms",
        "2001-09-09T01:46:40.000Z,,12.5",
        "2001-09-09T01:46:40.100Z,,12.5",
    ]


# -- a recorded flight -----------------------------------------------------------------------------


_ALARMING: list[bytes] = []


@pytest.fixture
async def alarming(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The log of a flight with a silence of 3 s, a low battery and authority that was lost."""
    pytest.importorskip("mcap", reason="the extra `log` is not installed")
    path = tmp_path / "flight.mcap"
    if not _ALARMING:  # it is flown once for all who read it
        await fly_alarming(path, monkeypatch)
        _ALARMING.append(path.read_bytes())
    path.write_bytes(_ALARMING[0])
    return path


async def fly_alarming(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder, "FLUSH_S", 0.0)
    aircraft = VirtualAircraft(seed=5, app_id=APP_ID, key=KEY)
    monkeypatch.setattr(driver, "aircraft_of", lambda _: aircraft)
    async with connect("sim://", record=path) as flown:
        await flown.activate(Credentials(app_id=APP_ID, key=KEY))
        with suppress(M100Error):
            async with flown.control() as control:
                await control.take_off()
                await control.fly_to(north=6.0, east=-4.0, up=2.0, speed=1.5)
                perform(aircraft, "rc-mode P")
                await anyio.sleep(3.0)
        for order in ("battery 24", "stall on", "stall off"):
            perform(aircraft, order)
            await anyio.sleep(3.0)


def test_what_cannot_be_read_is_said(tmp_path: Path) -> None:
    assert "No such file" in str(analyse(str(tmp_path / "none.mcap"), ""))
    (tmp_path / "text.mcap").write_text("no log")
    assert isinstance(analyse(str(tmp_path / "text.mcap"), ""), str)


async def test_rows_of_a_file_have_what_was_commanded_beside_what_was_flown(alarming: Path) -> None:
    found = analyse(str(alarming), "")
    assert isinstance(found, Recorded)
    story = found.story
    assert {one.name for one in story.alarms} >= {"link_old", "battery_low", "authority_lost"}
    names = [HEIGHT, *(COMMANDED[name] for name in (HEIGHT, "velocity.north_m_s"))]
    rows = found.between(names, 0.0, story.duration_s, 10_000)
    assert rows[0][0] < 0.5 < story.duration_s - 0.5 < rows[-1][0]
    silent = next(one for one in story.alarms if one.name == "link_old")
    [hole] = [at for at, height, *_ in rows if silent.begin_s < at < silent.end_s]
    assert math.isnan(found.near([HEIGHT], hole)[0])
    assert all(math.isnan(value) for value in found.near(names, silent.end_s - 0.1))
    # It was sent north-west at 1.5 m/s, and follows.
    sent = [row for row in rows if math.isfinite(row[3])]
    assert max(row[3] for row in sent) == pytest.approx(1.5 * 6 / math.hypot(6, 4), abs=0.1)
    at, *_, north = sent[len(sent) // 2]
    assert found.near(["velocity.north_m_s"], at)[0] == pytest.approx(north, abs=0.3)
    began = story.streams[0].begin_s
    assert not [at for at, *_, north in rows if at < began and math.isfinite(north)]
    assert found.near(names, -1.0)[0] != found.near(names, -1.0)[0]
    few = found.between(names, 2.0, 10.0, 10)
    assert len(few) <= 10 + 1
    assert few[0][0] <= 2.0


@pytest.mark.parametrize(
    ("setpoint", "heading", "commanded"),
    [
        (
            Setpoint.velocity(north=3.0, east=-4.0, up=0.5, yaw_rate_deg_s=-20.0),
            90.0,
            {"north_m_s": 3, "east_m_s": -4, "ground_speed_m_s": 5, "up_m_s": 0.5}
            | {"yaw_rate_deg_s": -20},
        ),
        (  # the nose points 4 m to the north by 3 m to the east: 2.5 m along it are 2 and 1.5
            Setpoint.velocity(forward=2.5, right=5.0, height=12.0, yaw_deg=-30.0),
            math.degrees(math.atan2(3.0, 4.0)),
            {"north_m_s": 2 - 3, "east_m_s": 1.5 + 4, "ground_speed_m_s": math.sqrt(31.25)}
            | {"height_m": 12, "yaw_deg": -30},
        ),
        (
            Setpoint.velocity(forward=3.0, right=4.0, up=-0.5, yaw_deg=10.0),
            None,
            {"ground_speed_m_s": 5, "up_m_s": -0.5, "yaw_deg": 10},
        ),
    ],
    ids=["over ground", "by the nose", "by a nose that nobody knows"],
)
def test_what_was_commanded_is_shown_to_the_north_to_the_east_and_up(
    setpoint: Setpoint, heading: float | None, commanded: dict[str, float]
) -> None:
    rows = kept._Rows("3.1")
    if heading is not None:
        nose = Attitude(*quaternion(0.0, 0.0, math.radians(heading)))
        rows._state = cast(Any, SimpleNamespace(get=lambda _: nose))
    content = {"movement": setpoint.to_move(profile("3.1"))._asdict()}
    found = rows._read(cast(Any, SimpleNamespace(content=lambda: content)))
    assert found == pytest.approx(
        {f"commanded.{name}": value for name, value in commanded.items()}, abs=1e-6
    )
    assert found.keys() <= set(COMMANDED.values())


def test_a_row_that_stays_keeps_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept, "MOST_ROWS", 4)
    rows = kept._Rows("1.0", interval=1.0)
    for at in range(8):
        rows.add(float(at), (10.0 * at,))
    assert (list(rows.times), rows.interval) == ([0.0, 4.0, 6.0, 7.0], 4.0)
    assert rows._rows == [(0.0,), (40.0,), (60.0,), (70.0,)]
    empty = kept._Rows("1.0").columns(Curves())
    assert (set(COLUMNS) <= empty.keys(), {len(one) for one in empty.values()}) == (True, {0})


@pytest.mark.parametrize(("most", "times"), [(10, [2, 3, 4, 5, 6]), (2, [2, 5])])
def test_a_part_of_a_flight_has_a_row_on_each_side(most: int, times: list[float]) -> None:
    whole = Recorded(FlightSummary(""), array("d", range(10)), {})
    assert whole.between([], 3.0, 5.5, most) == [(at,) for at in times]


async def test_of_a_long_file_every_second_row_goes(
    alarming: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kept, "MOST_ROWS", 20)
    monkeypatch.setattr(kept, "LARGE", 4 * len(_ALARMING[0]))
    intervals: list[float] = []

    def read_rarely(*flight: Any, interval_s: float, **how: Any) -> FlightSummary:
        intervals.append(interval_s)
        return read_story(*flight, interval_s=interval_s, **how)

    monkeypatch.setattr(kept, "read_story", read_rarely)
    found = analyse(str(alarming), "")
    assert intervals == [0.25], "a second from a file of that size on"
    assert isinstance(found, Recorded)
    assert 10 <= len(found.times) <= 20
    assert {len(column) for column in found.columns.values()} == {len(found.times)}
    assert found.times[-1] > 0.8 * found.story.duration_s


async def test_the_process_that_reads_returns_what_it_read(alarming: Path) -> None:
    [*_, there] = [one async for one in analysed(str(alarming), "1.0")]
    here = analyse(str(alarming), "1.0")
    assert isinstance(there, Recorded)
    assert isinstance(here, Recorded)
    assert there.is_whole
    assert there.story.alarms == here.story.alarms
    assert there.story.path.points() == here.story.path.points()
    assert there.times == here.times
    [none] = [one async for one in analysed("none.mcap", "")]
    assert isinstance(none, str)


async def test_a_page_has_the_track_of_a_large_file_before_it_is_read(
    alarming: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kept, "OUTLINED", 0)
    outlines: list[Recorded] = []
    # As the page has it: by another process.
    whole = analyse(str(alarming), "", lambda one: outlines.append(pickle.loads(pickle.dumps(one))))
    assert isinstance(whole, Recorded)
    [outline] = outlines
    assert (outline.is_whole, whole.is_whole) == (False, True)
    assert outline.story.began_utc == whole.story.began_utc
    assert outline.story.duration_s == pytest.approx(whole.story.duration_s, abs=0.5)
    assert outline.columns.keys() == whole.columns.keys()
    # It flew there: of each row, height and place are those of a moment nearby.
    for at, height in zip(outline.times, outline.columns[HEIGHT], strict=True):
        near = [
            one
            for then, one in zip(whole.times, whole.columns[HEIGHT], strict=True)
            if abs(then - at) <= 0.5
        ]
        assert min(near) - 0.05 <= height <= max(near) + 0.05
    [home], [same] = outline.story.path.homes, whole.story.path.homes
    assert (home.at_s, *home[1:]) == pytest.approx((same.at_s, *same[1:]), abs=0.5)
    assert home[1:] == pytest.approx(same[1:], abs=1e-6)
    assert outline.story.track.length_m == pytest.approx(whole.story.track.length_m, rel=0.1)
    assert not outline.story.alarms
    assert whole.story.alarms


def test_in_an_outline_a_value_ends_that_has_grown_old() -> None:
    """A position counts for 1.2 s, a charge for 5 s; the clock of a file begins anywhere."""
    position = {"latitude_rad": 0.9, "longitude_rad": 0.1, "altitude": 99.0, "height": 7.0}
    first = {f"position.{name}": one for name, one in (position | {"gps_health": 5}).items()}
    whole = first | {"battery.percent": 80}
    packages = [(0, whole), *((n, {f"velocity.{one}": 0.0 for one in "xyz"}) for n in range(1, 8))]
    messages = [
        Message("telemetry", 5000.0 + at, 1.7e9 + at, json.dumps(values).encode())
        for at, values in packages
    ]
    pauses: list[float] = []

    def read(*_: Any, pause_s: float = 0.0) -> Iterator[Message]:
        pauses.append(pause_s)
        return iter(messages)

    flight = SimpleNamespace(path=Path("a.mcap"), messages=read)
    found = kept._outline(cast(Any, flight), 1.0)
    assert pauses == [0.0, 0.5]  # twice as often as rows: none is missed
    assert list(found.times) == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]
    for name, values in ((HEIGHT, [7.0] * 2 + [None] * 6), (CHARGE, [80.0] * 6 + [None] * 2)):
        shown = [None if one is None or math.isnan(one) else one for one in found.columns[name]]
        assert shown == values


async def test_a_process_that_reads_already_is_the_one_that_is_asked(alarming: Path) -> None:
    path = str(alarming)
    for _ in range(2):  # of two replays of one file, or one
        begin_analysis(path, "")
    begun = kept._begun[path]
    found = [one async for one in analysed(path, "")]
    assert isinstance(found[-1], Recorded)
    assert (begun.returncode, kept._begun) == (0, {})


async def test_a_process_that_nobody_asks_any_more_ends_without_a_word(
    alarming: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    begin_analysis(str(alarming), "")
    begun = kept._begun.pop(str(alarming))
    assert begun.stdout is not None
    begun.stdout.close()
    assert await asyncio.to_thread(begun.wait, PATIENCE) == -signal.SIGPIPE
    assert capfd.readouterr() == ("", "")


OUTLINE = """
from m100link.apps.station.console.kept import FlightSummary, Recorded, send
send(Recorded(FlightSummary(""), [], {}, False))
"""


@pytest.mark.parametrize("answer", ["", OUTLINE], ids=["nothing", "an outline"])
async def test_a_reader_that_dies_is_named_beside_what_it_read(
    monkeypatch: pytest.MonkeyPatch, answer: str
) -> None:
    monkeypatch.setattr(kept, "_CHILD", f"{answer}\nimport os; os._exit(7)")
    found = [one async for one in analysed("flight.mcap", "")]
    assert found[-1] == "the process that read flight.mcap ended with 7"
    assert len(found) == (2 if answer else 1)


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(n, marks=pytest.mark.slow) for n in range(1, 20))]
)
async def test_a_replay_on_a_busy_computer_shows_the_alarms_of_its_file_and_no_others(
    alarming: Path, seed: int
) -> None:
    """Up to 50 seeks at any speed; what holds up the process, up to 5 s, is drawn by the seed."""
    found = analyse(str(alarming), "")
    assert isinstance(found, Recorded)
    chance, loop = random.Random(seed), asyncio.get_running_loop()
    assert isinstance(loop, VirtualClockEventLoop)
    spans = {AlarmName(one.name): one for one in found.story.alarms}
    memory = Memory()
    async with station(f"replay://{alarming}") as (_, client):
        for number in range(50 if seed else 20):
            await client.ask(orders.OrderReplay(f"speed {chance.choice([0.5, 1.0, 5.0, 50.0])}"))
            place = chance.uniform(0.0, found.story.duration_s)
            await client.ask(orders.OrderReplay(f"seek {place:.2f}"))
            for _ in range(chance.randrange(1, 4)):
                await anyio.sleep(chance.choice([0.0, 0.01, 0.3]))
                told = client.view.state.replay
                assert told is not None
                at = found.at(told.utc_at(client.view.now))
                view = view_of(
                    Inputs(vehicle=client.view, flight=RecordedFlight(found.story, at)), memory
                )
                for alarm in view.alarms:
                    span, seen_at = spans[alarm.name], (seed, number, alarm.name, at)
                    lasted = span.end_s - span.begin_s or MOMENT_S
                    assert 0.0 <= at - span.begin_s <= lasted, seen_at
                silence = spans[AlarmName.LINK_OLD]
                if view.status.cause is Cause.AIRCRAFT_SILENT:
                    assert silence.begin_s <= at <= silence.end_s + 0.1, (seed, number, at)
                if chance.random() < 0.3:
                    loop._jumping.now += chance.uniform(0.0, 5.0)


async def test_track_and_home_are_kept_for_pages_that_come_later(rig: Rig) -> None:
    history = PlotHistory()
    rig.front.background.spawn(history.keep(rig.front), "history")
    await anyio.sleep(2.0)
    assert rig.front.telemetry is not None
    stood = rig.front.telemetry.position
    assert stood is not None
    home = history.path.home(time.time())
    assert home is not None
    assert home[1:] == pytest.approx((stood.latitude_deg, stood.longitude_deg), abs=1e-6)
    assert history.path.airborne_s(history.newest) is None
    rig.aircraft.stall_line()
    await anyio.sleep(1.0)
    again = history.path.home(time.time())
    assert again is not None
    assert again[1:] == home[1:]
