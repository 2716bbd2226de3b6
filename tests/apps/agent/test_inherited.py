"""What an agent that was killed in flight held goes back when the next one reaches the aircraft."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import anyio
import pytest

from m100link.aircraft import Aircraft
from m100link.apps.agent.connect import by_driver
from m100link.apps.agent.server.agent import Agent
from m100link.apps.agent.server.authority import HoldingState
from m100link.apps.agent.server.connection import ConnectionState
from m100link.protocol.commands.control import Task
from m100link.protocol.setpoint import Setpoint
from tests.apps.agent.conftest import Rig

pytestmark = pytest.mark.anyio

NORTH = Setpoint.velocity(north=1.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)
SAID = "the agent before may have left"


async def killed_in_flight(rig: Rig) -> None:
    """The aircraft flies and is held, and whoever held it does and says nothing any more."""
    await rig.agent.obtain(rig.token)
    await rig.agent.fly(rig.token, Task.TAKE_OFF)
    rig.agent.steer(rig.token, NORTH)
    await anyio.sleep(0.1)
    assert rig.aircraft.vehicle.authority.is_requested
    rig.driver.stop()


@asynccontextmanager
async def next_agent(rig: Rig, leases_before: int = 1_000_000) -> AsyncIterator[Agent]:
    agent = Agent(
        by_driver(rig.driver), credentials=rig.aircraft.credentials, leases_before=leases_before
    )
    async with agent:
        await rig.until(lambda: agent.connection.state is ConnectionState.CONNECTED)
        yield agent


def told(agent: Agent) -> list[str]:
    return [event.text for event in agent.journal.events if SAID in event.text]


@pytest.mark.parametrize("firmware", ["1.0", "2.3", "3.1"])
async def test_it_is_given_back_and_said(firmware: str) -> None:
    async with Rig(firmware=firmware).running() as rig:
        await killed_in_flight(rig)
        async with next_agent(rig) as agent:
            await rig.until(lambda: not rig.aircraft.vehicle.authority.is_requested, within=3.0)
            await rig.until(lambda: bool(told(agent)), within=3.0)
            assert len(told(agent)) == 1
            assert agent.holding.state is HoldingState.NONE
            await anyio.sleep(3.0)
            before = rig.aircraft.position
            await anyio.sleep(1.0)
            assert math.dist(rig.aircraft.position, before) < 0.1  # it hovers
            assert rig.aircraft.height > 1.0


async def test_the_first_agent_of_a_station_takes_nothing_from_anybody(rig: Rig) -> None:
    await killed_in_flight(rig)
    async with next_agent(rig, 0) as agent:
        await anyio.sleep(3.0)
        assert rig.aircraft.vehicle.authority.is_requested
        assert told(agent) == []


async def test_who_asks_at_once_has_it_and_keeps_it(rig: Rig) -> None:
    await killed_in_flight(rig)
    async with next_agent(rig) as agent:
        token = agent.desk.acquire("the next", agent.now).token
        await agent.obtain(token)
        assert agent.holding.has_authority
        for _ in range(6):
            await anyio.sleep(0.5)
            agent.desk.renew(token, agent.now)
        assert agent.holding.has_authority
        assert rig.aircraft.vehicle.authority.is_requested


async def test_an_aircraft_that_does_not_answer_is_asked_again_when_it_is_back(rig: Rig) -> None:
    await killed_in_flight(rig)
    agent = Agent(
        by_driver(rig.driver), credentials=rig.aircraft.credentials, leases_before=1_000_000
    )
    unplugged = False

    def unplug(aircraft: Aircraft | None) -> None:
        nonlocal unplugged
        if not unplugged:
            unplugged = True
            rig.aircraft.unplug()

    agent.connection.on_aircraft.append(unplug)
    async with agent:
        await rig.until(lambda: "does not say" in "".join(told(agent)), within=10.0)
        assert rig.aircraft.vehicle.authority.is_requested
        rig.aircraft.replug()
        await rig.until(lambda: not rig.aircraft.vehicle.authority.is_requested)
        await rig.until(lambda: "is given back" in told(agent)[-1])
