"""An agent on a virtual aircraft, on virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from itertools import count
from typing import Any

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.background import ignore
from m100link.apps.agent.server.agent import Agent
from m100link.apps.agent.server.authority import HoldingState
from m100link.apps.agent.server.connection import ConnectionState, by_driver
from m100link.apps.agent.transports import MemoryChannel
from m100link.missions.plan import WaypointPlan
from m100link.sim.clock import virtual_clock_loop
from m100link.sim.ports.driver import Driver
from m100link.sim.virtual import VirtualAircraft


@pytest.fixture
def anyio_backend() -> tuple[str, dict[str, Any]]:
    return "asyncio", {"loop_factory": virtual_clock_loop}


class Rig:
    """An agent with an activated virtual aircraft, and one client's lease."""

    def __init__(self, *, firmware: str = "1.0", **options: Any) -> None:
        self.aircraft = VirtualAircraft(seed=5, firmware=firmware)
        self.driver = Driver(self.aircraft)
        credentials = self.aircraft.credentials
        self.agent = Agent(by_driver(self.driver), credentials=credentials, **options)
        self.holding = self.agent.holding
        self.states: list[HoldingState] = []
        self.holding.on_change.append(lambda _, after: self.states.append(after))

    @asynccontextmanager
    async def running(self) -> AsyncIterator[Rig]:
        async with self.agent:
            await self.until(lambda: self.agent.connection.state is ConnectionState.CONNECTED)
            await self.agent.ask(orders.Activate())
            self.token = self.agent.leases.acquire("client", self.agent.now).token
            self.renewing = self.agent.background.spawn(self._renew(), "renewal")
            yield self
            self.renewing.cancel()
        self.driver.stop()

    async def _renew(self) -> None:
        while True:
            await anyio.sleep(0.5)
            self.agent.leases.renew(self.token, self.agent.now)

    async def until(self, predicate: Callable[[], bool], within: float = 30.0) -> None:
        with anyio.fail_after(within):
            while not predicate():  # noqa: ASYNC110 - virtual time: it costs nothing
                await anyio.sleep(0.01)


async def airborne(rig: Rig) -> None:
    await rig.agent.ask(orders.Obtain(), rig.token)
    await rig.agent.ask(orders.TakeOff(), rig.token)


async def mission(rig: Rig, plan: WaypointPlan, *, begun: Callable[[], None] | None = None) -> None:
    """Upload a plan and let it fly; until it is over where somebody wants to know its begin."""
    upload = orders.UploadPlan.of(plan)
    await rig.agent.ask(upload, rig.token)
    start = orders.StartMission(upload.digest, until_over=begun is not None)
    await rig.agent.ask(start, rig.token, begun or ignore)


def guided(rig: Rig) -> object:
    """Where somebody has pointed and the aircraft flies to, or None."""
    flying = rig.agent.holding.flying
    return flying and flying.guiding.order


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    async with Rig().running() as one:
        yield one


def hears_late(its: MemoryChannel, seconds: float) -> None:
    """Make a front slow: whatever the agent sends by its end of the way arrives that much later."""
    arrives, sent = its.send, count()

    def send(message: Any) -> None:
        late = seconds + 1e-7 * next(sent)  # none overtakes another
        asyncio.get_running_loop().call_later(late, arrives, message)

    its.send = send  # type: ignore[method-assign]  # for this test


def has_begun(agent: Agent, what: str) -> bool:
    """Whether its journal says that this began."""
    return any(event.text == f"{what} begins" for event in agent.journal.events)


def task_of(one: Any) -> str | None:
    """The task that an agent watches; also of a test's rig that has its ``holding``."""
    flying = one.holding.flying
    return None if flying is None else str(flying.task) if flying.task else None


def pattern_of(one: Any) -> str | None:
    """The program that it flies."""
    flying = one.holding.flying
    return None if flying is None else flying.pattern and str(flying.pattern)
