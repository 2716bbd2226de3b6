"""Agents of a fleet on virtual aircraft, a bus in memory, and pilots: on virtual time."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import anyio
import pytest

from m100link.aircraft import Aircraft
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.server.agent import Agent
from m100link.apps.agent.server.connection import by_driver
from m100link.apps.agent.server.server import AgentServer
from m100link.apps.agent.transports import memory_channels
from m100link.apps.bus.network import Bus
from m100link.apps.fleet.agent import FleetAgent
from m100link.apps.fleet.client import Fleet
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.order_log import MemoryOrderLog, OrderLog
from m100link.apps.fleet.publisher import StatePublisher
from m100link.apps.fleet.revocations import Revocations
from m100link.apps.fleet.signing import Seal, SealedBus
from m100link.sim.clock import virtual_clock_loop
from m100link.sim.ports.driver import Driver
from m100link.sim.virtual import VirtualAircraft
from tests.apps.bus.memory import MemoryBus, MemoryNetwork

UTC = 1_800_000_000.0
"""POSIX time as the clock of the loop begins."""

SITE = "field"


@pytest.fixture
def anyio_backend() -> tuple[str, dict[str, Any]]:
    return "asyncio", {"loop_factory": virtual_clock_loop}


class OnBoard:
    """One aircraft with its agent."""

    def __init__(self, rig: Rig, name: str, aircraft: VirtualAircraft, order_log: OrderLog) -> None:
        self.rig, self.name, self.aircraft, self.order_log = rig, name, aircraft, order_log
        self._is_killed = False

    @asynccontextmanager
    async def running(
        self, *, as_bytes: bool = True, seal: Seal | None = None, **options: Any
    ) -> AsyncIterator[OnBoard]:
        self._driver = driver = Driver(self.aircraft)
        connect = by_driver(driver)

        async def plugged_in() -> Aircraft:
            if self._is_killed:
                await anyio.sleep_forever()
            return await connect()

        self.bus: MemoryBus = self.rig.network.session()
        seals = {} if seal is None else {self.name: seal}
        self.spoken = SealedBus(self.bus, seals, options.pop("authority", None))
        async with AsyncExitStack() as stack:
            self.agent = await stack.enter_async_context(
                Agent(
                    plugged_in,
                    credentials=options.pop("credentials", self.aircraft.credentials),
                    leases_before=self.order_log.leases_before,
                )
            )
            self.service = AgentServer(self.agent)
            ours, its = self.channels = memory_channels(as_bytes=as_bytes)
            self.service.attach(its)
            self.client = await stack.enter_async_context(AgentClient(ours, "fleet"))
            self.fleet_agent = FleetAgent(
                self.client,
                self.spoken,
                Keys(SITE, self.name),
                self.order_log,
                utc=self.rig.utc,
                **options,
            )
            self.work = self.agent.background.spawn(self.fleet_agent.run(), "fleet")
            await self.rig.until(lambda: self.client.is_connected)
            yield self
            self.work.cancel()
        driver.stop()

    def kill(self) -> None:
        """From now on not a byte of this agent leaves, to the network or to the aircraft."""
        self._is_killed = True
        self.rig.network.cut(self.bus)
        self._driver.stop()
        self.work.cancel()

    async def next(self, **options: Any) -> OnBoard:
        """The agent after the one that was killed, with the same aircraft and order log."""
        assert isinstance(self.order_log, MemoryOrderLog)
        order_log = MemoryOrderLog(self.order_log)
        return await self.rig.aircraft(
            self.name, virtual=self.aircraft, order_log=order_log, **options
        )

    @property
    def height(self) -> float:
        return float(self.aircraft.height)

    @property
    def speed(self) -> float:
        return float(self.aircraft.vehicle.flight.dynamics.speed)


class Rig:
    """A network, aircraft, pilots."""

    def __init__(self) -> None:
        self.network = MemoryNetwork(seed=5)
        self.stack = AsyncExitStack()

    def utc(self) -> float:
        return UTC + anyio.current_time()

    async def until(self, predicate: Callable[[], object], within: float = 60.0) -> None:
        with anyio.fail_after(within):
            while not predicate():  # noqa: ASYNC110 - virtual time: it costs nothing
                await anyio.sleep(0.01)

    async def aircraft(
        self, name: str, *, order_log: OrderLog | None = None, **options: Any
    ) -> OnBoard:
        virtual = options.pop("virtual", None) or VirtualAircraft(seed=5)
        one = OnBoard(self, name, virtual, order_log or MemoryOrderLog())
        return await self.stack.enter_async_context(one.running(**options))

    def cut(self, fleet: Fleet) -> None:
        """Cut a pilot off from all others, without a word."""
        self.network.cut(_in_memory(fleet))

    def join(self, fleet: Fleet) -> None:
        """The pilot's cable is whole again."""
        self.network.join(_in_memory(fleet))

    async def served(self, name: str, **options: Any) -> OnBoard:
        """An aircraft whose agent tells fronts that are elsewhere, too."""
        one = await self.aircraft(name, **options)
        told = StatePublisher(one.client, one.spoken, Keys(SITE, name), one.fleet_agent.boot)
        one.agent.background.spawn(told.run(), "fronts")
        await anyio.sleep(0.01)  # it begins
        return one

    async def pilot(
        self, name: str = "pilot", authority: Revocations | None = None, **options: Any
    ) -> Fleet:
        bus: Bus = self.network.session()
        if authority is not None:
            bus = SealedBus(bus, authority=authority)
        fleet = Fleet(bus, site=SITE, name=name, utc=self.utc, **options)
        return await self.stack.enter_async_context(fleet)


def _in_memory(fleet: Fleet) -> MemoryBus:
    assert isinstance(fleet.bus, MemoryBus)
    return fleet.bus


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    made = Rig()
    async with made.stack:
        yield made


def with_camera() -> VirtualAircraft:
    """A photograph is counted by the aircraft, and nothing else changes by it."""
    return VirtualAircraft(seed=5, firmware="2.3")
