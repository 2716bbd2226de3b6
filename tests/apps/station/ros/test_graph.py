"""Namespaces: several aircraft in one graph, and what a client has of each."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack

import pytest

from m100link.apps.agent.lease import Lease
from m100link.apps.station.ros.client import Client
from m100link.apps.station.ros.graph import Graph
from m100link.sim.virtual import VirtualAircraft
from tests.apps.station.conftest import FakeClient, Rig

pytestmark = pytest.mark.anyio


@pytest.fixture
async def rigs() -> AsyncIterator[tuple[Rig, Rig]]:
    """Two aircraft in one graph, the second in a namespace."""
    first, second = Rig(VirtualAircraft(seed=5)), Rig(VirtualAircraft(seed=6))
    second.graph = first.graph.namespace("m100_2")
    async with AsyncExitStack() as stack:
        yield (
            await stack.enter_async_context(first.running()),
            await stack.enter_async_context(second.running()),
        )


def test_what_a_namespace_adds_is_called_by_its_name_and_seen_in_the_whole() -> None:
    whole = Graph()
    part = whole.namespace("m100_2")
    topic = part.add_topic("/flight_status", "std_msgs/Float32")
    part.add_service("/m100link/lease", "m100link/Lease", lambda call: None)
    assert whole.topics == {"/m100_2/flight_status": topic}
    assert list(whole.services) == ["/m100_2/m100link/lease"]
    assert part.namespace("x").prefix == "/m100_2/x"


def test_what_is_known_of_a_client_is_known_of_one_aircraft() -> None:
    whole = Graph()
    part = whole.namespace("m100_2")
    client = Client(whole)
    assert client in part.sessions
    part.known(client)["lease"] = Lease("a", "token", 1)
    assert whole.known(client) == {}


async def test_a_client_has_a_lease_for_each_aircraft(rigs: tuple[Rig, Rig]) -> None:
    first, second = rigs
    await first.activated()
    await second.activated()
    client = first.client()
    client.publish("/m100_2/nav_open_close_request", data=1)
    await second.until(lambda: second.agent.holding.has_authority)
    assert not first.agent.holding.has_authority
    client.publish("/nav_open_close_request", data=1)
    await first.until(lambda: first.agent.holding.has_authority)
    client.leave()
    await first.until(lambda: not first.agent.holding.has_authority)
    await second.until(lambda: not second.agent.holding.has_authority)


async def test_a_setpoint_reaches_the_aircraft_that_it_names(rigs: tuple[Rig, Rig]) -> None:
    first, second = rigs
    other = first.client("other")
    await _fly(second, other)
    before = len(first.moves)
    other.publish("/m100_2/sdk_request_ctrl", x=-2.0, y=0.0, z=0.0, w=0.0)
    await second.until(lambda: any(move.roll_or_x or move.pitch_or_y for move in second.moves))
    assert len(first.moves) == before
    other.publish("/sdk_request_ctrl", x=-2.0, y=0.0, z=0.0, w=0.0)
    assert any("open control first (/nav_open_close_request 1)" in one for one in other.statuses())


async def _fly(rig: Rig, client: FakeClient) -> None:
    await rig.activated()
    client.publish("/m100_2/nav_open_close_request", data=1)
    await rig.until(lambda: rig.agent.holding.has_authority)
    client.publish("/m100_2/sdk_request_cmd", data=4)
    await rig.until(lambda: rig.agent.holding.task is not None)
    await rig.until(lambda: rig.agent.holding.task is None)
