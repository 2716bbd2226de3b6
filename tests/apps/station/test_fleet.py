"""Which aircraft a console over a fleet shows, and what it hears of each."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, ExitStack, asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import anyio
import pytest

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.messages import LeaseChanged
from m100link.apps.fleet.keys import Keys
from m100link.apps.station import fleet as module
from m100link.apps.station.config import Settings
from m100link.apps.station.fleet import (
    MOST_SHIPS,
    FleetSettings,
    Ships,
    names_of,
    serving_fleet_console,
)
from m100link.errors import LinkError, Unreachable, UsageError
from m100link.sim.clock import virtual_clock_loop
from tests.apps.fleet.conftest import SITE, Rig

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> tuple[str, dict[str, Any]]:
    return "asyncio", {"loop_factory": virtual_clock_loop}


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    made = Rig()
    async with made.stack:
        yield made


async def test_aircraft_that_are_there_are_shown_and_missing_ones_named(rig: Rig) -> None:
    pilot = await rig.pilot()
    with pytest.raises(UsageError, match="there is no agent at site field"):
        await names_of(pilot)
    for name in ("a2", "a1"):
        await rig.served(name)
    assert await names_of(pilot) == ["a1", "a2"]
    assert await names_of(pilot, ("a2", "a2")) == ["a2"]
    with pytest.raises(Unreachable, match="no agent named b7 is there") as caught:
        await names_of(pilot, ("a1", "b7"))
    assert "a1, a2" in caught.value.remedy


async def test_more_than_a_page_holds_are_refused(rig: Rig) -> None:
    bus = rig.network.session()
    tokens = [bus.declare(Keys(SITE, f"a{n}").live_by(bus.session)) for n in range(MOST_SHIPS + 1)]
    with pytest.raises(UsageError, match="too many"):
        await names_of(await rig.pilot())
    tokens.pop().close()
    assert len(await names_of(await rig.pilot())) == MOST_SHIPS


async def test_one_that_does_not_answer_costs_the_others_nothing(rig: Rig) -> None:
    await rig.aircraft("a1")  # of an older release: it tells nothing
    await rig.served("a2")
    async with AsyncExitStack() as stack:
        ships = Ships(await rig.pilot(), stack)
        assert await ships.first(["a1", "a2"]) == "a2"
        for name in ("a1", "a2"):
            await ships.show(name)
        assert list(ships.agents) == ["a2"]
        with pytest.raises(LinkError, match="a1 does not answer"):
            await ships.first(["a1"])


async def test_what_is_looked_at_comes_whole_and_the_rest_as_for_a_wall(rig: Rig) -> None:
    for name in ("a1", "a2"):
        await rig.served(name)
    heard = {"a1": 0, "a2": 0}
    async with AsyncExitStack() as stack:
        ships = Ships(await rig.pilot(), stack)

        def count(name: str) -> None:
            def on_sample(_: object) -> None:
                heard[name] += 1

            ships.agents[name].on_sample.append(on_sample)

        for name in heard:
            await ships.show(name)
            count(name)
        ships.look(["a2"])
        await anyio.sleep(5.0)
        assert heard["a2"] > 4 * heard["a1"] > 0
        before = dict(heard)
        ships.look(["a1"])
        await anyio.sleep(5.0)
        assert heard["a1"] - before["a1"] > 4 * (heard["a2"] - before["a2"]) > 0


async def test_control_that_was_taken_here_is_given_back_at_the_end(rig: Rig) -> None:
    one, changes = await rig.served("a1"), list[LeaseChanged]()
    one.client.on_lease.append(changes.append)
    async with AsyncExitStack() as stack:
        ships = Ships(await rig.pilot(), stack)
        await ships.show("a1")
        await ships.agents["a1"].acquire("console 1")
        await ships.let_go()
    await anyio.sleep(0.2)
    assert [(bool(one.number), one.why and one.why.value) for one in changes] == [
        (True, "acquired"),
        (False, "released"),
    ]


@pytest.mark.parametrize("name", ["a1", "a2"])
async def test_whichever_aircraft_it_shows_a_console_that_ends_gives_control_back(
    rig: Rig, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """a1 is there when it begins, a2 comes later: its way must not be closed before."""

    @asynccontextmanager
    async def serving(_: object, __: object, reach: Any, *___: object, **____: object) -> Any:
        ((first, way),) = reach.items()
        async with AgentClient(await way(), "console") as agent:
            yield SimpleNamespace(agents={first: agent}, shown=frozenset)

    monkeypatch.setattr(module, "serving_fronts", serving)
    monkeypatch.setattr(module, "open_sockets", lambda *_, **__: None)
    one, changes = await rig.served("a1"), list[LeaseChanged]()
    async with serving_fleet_console(await rig.pilot(), Settings()) as console:
        if name == "a2":
            one = await rig.served("a2")
        await rig.until(lambda: name in console.agents, within=5.0)
        one.client.on_lease.append(changes.append)
        await console.agents[name].acquire("console 1")
    await anyio.sleep(0.2)
    assert [(bool(one.number), one.why and one.why.value) for one in changes] == [
        (True, "acquired"),
        (False, "released"),
    ]


async def test_an_agent_that_is_started_anew_is_found_again(rig: Rig) -> None:
    one = await rig.served("a1")
    async with AsyncExitStack() as stack:
        ships = Ships(await rig.pilot(), stack)
        await ships.show("a1")
        far = ships.agents["a1"]
        await rig.until(lambda: far.is_connected)
        one.work.cancel()
        await rig.until(lambda: far.is_gone, within=3.0)
        one.work = one.agent.background.spawn(one.fleet_agent.run(), "fleet")
        await rig.until(lambda: far.is_connected, within=5.0)


def test_the_order_log_of_an_agent_that_ended_can_be_opened_again(tmp_path: Path) -> None:
    fleet, keys = FleetSettings(order_logs=tmp_path), Keys(SITE, "a1")
    first, then = ExitStack(), ExitStack()
    with then:
        with first:
            log = module._order_log(cast("AsyncExitStack", first), fleet, keys)
            with pytest.raises(UsageError, match="another agent has it"):
                module._order_log(cast("AsyncExitStack", then), fleet, keys)
        assert module._order_log(cast("AsyncExitStack", then), fleet, keys) is not log
