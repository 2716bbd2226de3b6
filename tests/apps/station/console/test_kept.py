"""Several aircraft and one operator: what is steered, what hovers, and whose control lasts."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from dataclasses import dataclass
from urllib.parse import parse_qs, urlsplit

import anyio
import pytest

from m100link.apps.agent.messages import Event
from m100link.apps.station.console.tab import Tab
from m100link.apps.station.console.tabs import MOVE_PATIENCE, Tabs
from m100link.protocol.commands.control import Task
from m100link.sim.virtual import VirtualAircraft
from tests.apps.station.conftest import Rig
from tests.apps.station.console.test_tab import Browser

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
        page = Browser(self.rigs[aircraft], tab.name)
        page.tab.close()
        page.tab = tab
        return page

    async def flown(self, aircraft: str) -> Browser:
        """A page whose aircraft hovers above the ground."""
        page, rig = self.page(aircraft), self.rigs[aircraft]
        page.say("alive")
        await page.tab.activate()
        await page.tab.obtain()
        rig.front.background.spawn(keep_alive(page), "page")
        await page.tab.fly(Task.TAKE_OFF)
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
    assert kite.tab.has_lease
    assert crow.tab.has_lease


async def test_who_turns_to_another_stops_the_first_and_keeps_control_of_both(
    fleet: Fleet,
) -> None:
    first = await fleet.flown("kite")
    rig = fleet.rigs["kite"]
    await first.hold(0.5, **NORTH)
    lease = first.tab.lease
    address = fleet.tabs.move(first.tab, "crow")
    await anyio.sleep(0.1)  # less than a beat lasts
    assert not is_steered(rig), "it flew on"
    await first.hold(0.3, **NORTH)  # a finger that is still on the key
    assert not is_steered(rig), "the page that was left still steers"
    assert any("keeps control: it hovers" in event.text for event in rig.front.events)
    second = fleet.page("crow", address)
    fleet.tabs.close(next(key for key, tab in fleet.tabs.tabs.items() if tab is first.tab))
    assert second.tab.name == first.tab.name
    assert "kite" in second.tab.kept
    for _ in range(20):
        second.say("alive")
        await anyio.sleep(0.5)
    assert rig.front.holds(lease)
    assert rig.agent.holding.has_authority
    third = fleet.page("kite", fleet.tabs.move(second.tab, "kite"))
    assert third.tab.has_lease
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
    assert "kite" in second.tab.kept
    await anyio.sleep(3.5)  # and from now on it counts whether it is heard
    assert "kite" not in second.tab.kept


async def test_a_page_that_is_lost_gives_back_everything_it_kept(fleet: Fleet) -> None:
    first = await fleet.flown("kite")
    second = fleet.page("crow", fleet.tabs.move(first.tab, "crow"))
    second.say("alive")
    await anyio.sleep(1.0)
    assert len(second.tab.kept) == 1
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
    rig.front.background.spawn(first.tab.attempt(lambda: first.tab.fly(Task.LAND)), "landing")
    await rig.until(lambda: bool(rig.front.state.task))
    fleet.page("crow", fleet.tabs.move(first.tab, "crow"))
    assert any(event.text.endswith("flies by itself goes on") for event in await told(rig))
    await rig.until(lambda: rig.aircraft.height < 0.1)


async def told(rig: Rig) -> list[Event]:
    await anyio.sleep(0.1)
    return list(rig.front.events)


async def test_who_has_no_control_stops_nobody_by_looking_elsewhere(fleet: Fleet) -> None:
    pilot = await fleet.flown("kite")
    onlooker = fleet.page("kite")
    await pilot.hold(0.3, **NORTH)
    fleet.tabs.move(onlooker.tab, "crow")
    await pilot.hold(0.3, **NORTH)
    assert is_steered(fleet.rigs["kite"])


async def test_two_operators_have_an_aircraft_each(fleet: Fleet) -> None:
    one, other = await fleet.flown("kite"), await fleet.flown("crow")
    other_page = fleet.page("kite")
    await other_page.tab.attempt(other_page.tab.obtain)
    assert "has control" in other_page.tab.problem
    one.tab.lost()
    rigs = fleet.rigs
    await rigs["kite"].until(lambda: not rigs["kite"].agent.holding.has_authority)
    assert other.tab.has_lease
    await other.hold(0.3, **NORTH)
    assert is_steered(rigs["crow"])


async def test_an_agent_that_dies_stays_shown_and_takes_nothing_of_the_other(fleet: Fleet) -> None:
    first = await fleet.flown("kite")
    second = fleet.page("crow", fleet.tabs.move(first.tab, "crow"))
    second.say("alive")
    await second.tab.activate()
    await second.tab.obtain()
    fleet.rigs["crow"].front._closed("killed")
    second.say("beat", mode=1, x=-4.0, y=0, z=0, w=0)
    assert not second.tab.has_lease
    assert second.tab.aircraft == "crow"
    for _ in range(10):
        second.say("alive")
        await anyio.sleep(0.5)
    assert "kite" in second.tab.kept
    assert fleet.rigs["kite"].agent.holding.has_authority


async def test_a_name_that_there_is_not_and_a_code_that_was_used_are_nothing(fleet: Fleet) -> None:
    first = await fleet.flown("kite")
    address = fleet.tabs.move(first.tab, "crow")
    assert "kite" in fleet.page("crow", address).tab.kept
    again: Tab = fleet.page("crow", address).tab
    assert len(again.kept) == 0
    _, tab = fleet.tabs.open("nobody", "guessed")
    assert tab.aircraft == "kite"
    assert not tab.has_lease
