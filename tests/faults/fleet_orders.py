"""Orders to a fleet in bad weather, counted by the aircraft.

``python -m tests.faults.fleet_orders``

A pilot sends messages to the app behind one aircraft, each with a number of its own, through a
network that loses, repeats, delays and reorders; the agent loses its memory now and then, as if it
had been killed, and keeps its ledger. The app counts how often each number arrived. What may not
be: a number twice, ``ok`` for one that did not arrive, and one that arrived for which anything but
``ok`` or ``unknown`` was reported.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
from collections import Counter, deque
from collections.abc import Iterable
from contextlib import AsyncExitStack
from dataclasses import dataclass

from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.lease import Lease
from m100link.apps.agent.server.agent import Agent
from m100link.apps.agent.server.connection import by_driver
from m100link.apps.agent.server.server import AgentServer
from m100link.apps.agent.transports import memory_channels
from m100link.apps.fleet.agent import FleetAgent
from m100link.apps.fleet.asking import Asker
from m100link.apps.fleet.client import Fleet
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.order_log import MemoryOrderLog
from m100link.apps.fleet.payloads import Outcome, outcome_of
from m100link.errors import M100Error
from m100link.sim import VirtualClockEventLoop
from m100link.sim.ports.driver import Driver
from m100link.sim.virtual import VirtualAircraft
from tests.apps.bus.memory import MemoryNetwork, Weather

__all__ = ["Counted", "Ordering", "run"]

# Of several at once under one lease the newest wins, and those that it overtook are refused.
_TASKS = 1
_KEYS = Keys("field", "a1")
_WEATHER = Weather(loss=0.1, repeat=0.2, delay_s=0.005, jitter_s=0.2)


@dataclass(frozen=True)
class Counted:
    """What was seen.

    Attributes:
        outcomes: How often each was reported.
        restarts: How often the agent lost its memory.
        twice: Numbers that arrived more than once.
        false_ok: Numbers reported as ``ok`` that did not arrive.
        hidden: Numbers that arrived and were reported as not done.
    """

    outcomes: Counter[Outcome]
    restarts: int
    twice: int
    false_ok: int
    hidden: int

    @property
    def is_good(self) -> bool:
        """Whether nothing was that may not be."""
        return not (self.twice or self.false_ok or self.hidden)


class Ordering:
    """Who orders, keeps the lease, and notes the outcome of each order.

    Args:
        count: Orders.
        activates: Let the aircraft be activated whenever the lease is a new one.

    Attributes:
        told: What became of each, by its number.
        most: How many may have an outcome by now; what is to happen among them may take its time.
    """

    def __init__(self, count: int, *, activates: bool = False) -> None:
        self.told: dict[int, Outcome] = {}
        self.most = count
        self._activates = activates
        self._lease: Lease | None = None
        self._numbers = iter(range(count))

    async def keep(self, asker: Asker) -> None:
        """Have the lease as far as that is possible, until cancelled."""
        while True:
            try:
                if self._lease is None:
                    lease, _ = await asker.take_lease(asker.lease_request())
                    if self._activates:
                        activate = orders.Activate()
                        await asker.ask(activate, fence=lease.number, token=lease.token)
                    self._lease = lease
                await asyncio.sleep(0.3)
                if self._lease is not None:  # an order may have heard meanwhile that it ended
                    await asker.renew(self._lease, within=0.5)
            except M100Error:
                self._lease = None  # it ended, or its agent did: another one is asked for
                await asyncio.sleep(0.3)

    async def order(self, asker: Asker) -> None:
        """Give one order after the other."""
        for number in self._numbers:
            while not await self._may_order(asker, number):  # noqa: ASYNC110 - others do that
                await asyncio.sleep(0.1)
            ask = orders.SendToMobile(b"%d" % number)
            lease = self._lease
            assert lease is not None
            try:
                await asker.ask(ask, fence=lease.number, token=lease.token)
                self.told[number] = Outcome.OK
            except M100Error as error:
                self.told[number] = outcome_of(error)
                if self.told[number] is Outcome.STALE_LEASE and self._lease is lease:
                    self._lease = None

    async def _may_order(self, asker: Asker, number: int) -> bool:
        """Whether an order would be one: to an agent that is not there none is sent."""
        is_due = number < self.most and self._lease is not None
        return is_due and await asker.is_there() and self._lease is not None

    def counted(self, received: Iterable[bytes], restarts: int) -> Counted:
        """Compare the outcomes with what arrived at the app."""
        arrived = Counter(map(int, received))
        good = (Outcome.OK, Outcome.UNKNOWN)
        return Counted(
            outcomes=Counter(self.told.values()),
            restarts=restarts,
            twice=sum(times > 1 for times in arrived.values()),
            false_ok=sum(told is Outcome.OK and not arrived[n] for n, told in self.told.items()),
            hidden=sum(told not in good and arrived[n] > 0 for n, told in self.told.items()),
        )


class Run:
    """One aircraft, its agent, and who orders.

    Args:
        seed: Of the weather.
        count: Orders.
        restarts: How often the agent is to lose its memory.
    """

    def __init__(self, seed: int, count: int, restarts: int) -> None:
        self._count, self._restarts = count, restarts
        self.network = MemoryNetwork(seed)
        self.aircraft = VirtualAircraft(seed=seed)
        self.aircraft.vehicle.app.received = deque()
        self.ledger = MemoryOrderLog()
        self._ordering = Ordering(count)

    async def run(self) -> Counted:
        """Send all orders."""
        async with AsyncExitStack() as stack:
            driver = Driver(self.aircraft)
            stack.callback(driver.stop)
            agent = await stack.enter_async_context(
                Agent(by_driver(driver), credentials=self.aircraft.credentials)
            )
            service = AgentServer(agent)
            ours, its = memory_channels()
            service.attach(its)
            client = await stack.enter_async_context(AgentClient(ours, "fleet"))
            async with asyncio.timeout(60.0):
                while not client.is_connected:  # noqa: ASYNC110 - virtual time
                    await asyncio.sleep(0.1)
            await agent.ask(orders.Activate())
            agent_task = agent.background.spawn(self._agents(client), "agents")
            fleet = Fleet(self.network.session(), site=_KEYS.site)
            await asyncio.sleep(0.1)
            await stack.enter_async_context(fleet)
            self.network.weather = _WEATHER
            keeping = agent.background.spawn(self._ordering.keep(fleet["a1"].asker), "lease")
            async with asyncio.TaskGroup() as group:
                for _ in range(_TASKS):
                    group.create_task(self._ordering.order(fleet["a1"].asker))
            self.network.weather = Weather()
            await asyncio.sleep(5.0)  # what was late has come
            keeping.cancel()
            agent_task.cancel()
        return self._ordering.counted(self.aircraft.vehicle.app.received, self._restarts)

    async def _agents(self, client: AgentClient) -> None:
        """One agent after the other; each knows of the one before what is in its ledger."""
        due = [self._count * n // (self._restarts + 1) for n in range(1, self._restarts + 1)]
        while True:
            bus = self.network.session()
            one = FleetAgent(client, bus, _KEYS, self.ledger)
            work = asyncio.ensure_future(one.run())
            try:
                while not (due and len(self._ordering.told) >= due[0]):  # noqa: ASYNC110 - virtual time
                    await asyncio.sleep(0.05)
                due.pop(0)
            finally:
                work.cancel()
                await asyncio.gather(work, return_exceptions=True)
                self.network.cut(bus)
            self.ledger = MemoryOrderLog(self.ledger)


def run(seed: int, count: int, restarts: int) -> Counted:
    """Send so many orders on virtual time."""
    with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
        return runner.run(Run(seed, count, restarts).run())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--orders", type=int, default=100_000)
    parser.add_argument("--restarts", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    found = run(given.seed, given.orders, given.restarts)
    sys.stdout.write(f"seed {given.seed}: {found}\n")
    sys.exit(0 if found.is_good else 1)
