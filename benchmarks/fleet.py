"""Many aircraft in one process, beside as many pymavlink parsers in the same harness.

    python -m benchmarks.fleet [ROW …] [--rounds 15] [--json] [--beside TREE]

Each of two hundred lines is a pair of sockets that the event loop reads by ``add_reader``, in one
``os.read`` each. A line has a package every 10 ms, at a phase of its own, and time is told in steps
of 1 ms: in each, the packages that fall into it are written, and then the loop runs until all are
read. Only the reading is timed, so neither the writer nor a busy machine is part of it, and no two
packages of a line come together.

Of ours the whole stack is there: link, sessions, state, clock, authority. With a task each, a
subscription of ``async for`` takes every package. pymavlink parses and counts, without a task.

Another row is of one aircraft and its agent: what a signature and the audit log cost ``stop``. Two
agents hear it by turns, of which one verifies and logs; CPU of the thread, from the bytes of the
order until its agent passes it on.
"""

from __future__ import annotations

import asyncio
import os
import random
import socket
import time
from collections.abc import Callable, Iterable
from contextlib import AsyncExitStack, ExitStack
from typing import Any

import m100link
from benchmarks import peers
from benchmarks.consumer import make_aircraft
from benchmarks.frames import telemetry_frames
from benchmarks.program import main
from benchmarks.rows import Absent, Costs, Program, Row, Setting, Side, at_most, percentile, ratio
from m100link.link import Link

AIRCRAFT = 200
PERIOD_MS = 10
PERIODS = 20  # packages of each line per timing
SEED = 2015
BARE = f"{AIRCRAFT} aircraft, per package"
TASKS = f"{AIRCRAFT} aircraft with a task each, per package"
PEER = f"{AIRCRAFT} pymavlink parsers, per message"
STOPS = 200
STOP = "stop of a fleet, until its agent passes it on"

Receive = Callable[[bytes], None]


class Harness:
    """Lines that are written and read in this process.

    Args:
        receivers: Who gets what a line carries.
        wires: What each line carries, one after the other.
        count: How many have arrived at those whose work is timed.
    """

    def __init__(
        self, receivers: list[Receive], wires: list[bytes], count: Callable[[], int]
    ) -> None:
        self._receivers = receivers
        self._wires = wires
        self._count = count

    async def run(self, periods: int) -> float:
        """CPU seconds per package."""
        loop = asyncio.get_running_loop()
        pairs = [socket.socketpair() for _ in self._receivers]
        try:
            for (_, end), receive in zip(pairs, self._receivers, strict=True):
                end.setblocking(False)
                loop.add_reader(end, self._read, end.fileno(), receive)
            return await self._deliver([begin for begin, _ in pairs], periods)
        finally:
            for begin, end in pairs:
                loop.remove_reader(end)
                begin.close()
                end.close()

    @staticmethod
    def _read(fd: int, receive: Receive) -> None:
        receive(os.read(fd, 65536))

    async def _deliver(self, begins: list[socket.socket], periods: int) -> float:
        dice = random.Random(SEED)
        slots: list[list[socket.socket]] = [[] for _ in range(PERIOD_MS)]
        for begin in begins:
            slots[dice.randrange(PERIOD_MS)].append(begin)
        await asyncio.sleep(0)
        sent, spent = self._count(), 0.0
        for period in range(periods):
            wire = self._wires[period]
            for slot in slots:
                for begin in slot:
                    begin.send(wire)
                sent += len(slot)
                began = time.thread_time()
                while self._count() < sent:  # noqa: ASYNC110 - a pass of the loop is what is timed
                    await asyncio.sleep(0)
                spent += time.thread_time() - began
        return spent / (periods * len(begins))


def ours(setting: Setting, stack: ExitStack) -> Iterable[Side]:
    """Aircraft alone, and with a task each."""
    number, periods = setting.count(AIRCRAFT), max(2, setting.count(PERIODS))
    wires = telemetry_frames(periods)

    async def make(count: int) -> list[tuple[m100link.Aircraft, Link]]:
        return await asyncio.gather(*(make_aircraft() for _ in range(count)))

    async def alone() -> float:
        links = [link for _, link in await make(number)]
        taken = 0

        def receiver(data_received: Receive) -> Receive:
            def receive(data: bytes) -> None:
                nonlocal taken
                data_received(data)
                taken += 1

            return receive

        receivers = [receiver(link.data_received) for link in links]
        return await Harness(receivers, wires, lambda: taken).run(periods)

    async def with_tasks() -> float:
        made = await make(number)
        taken = 0

        async def take(aircraft: m100link.Aircraft) -> None:
            nonlocal taken
            async with aircraft.telemetry() as samples:
                async for _ in samples:
                    taken += 1

        tasks = [asyncio.create_task(take(aircraft)) for aircraft, _ in made]
        receivers: list[Receive] = [link.data_received for _, link in made]
        try:
            return await Harness(receivers, wires, lambda: taken).run(periods)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    yield Side(BARE, lambda: asyncio.run(alone()))
    yield Side(TASKS, lambda: asyncio.run(with_tasks()))
    yield Side(STOP, lambda: stops(setting.count(STOPS)))


def stops(count: int) -> dict[str, float]:
    """CPU seconds for ``stop``, at an agent that verifies and logs, and at a plain one."""
    from m100link.sim.clock import virtual_clock_loop  # another tree may lack some of these

    with asyncio.Runner(loop_factory=virtual_clock_loop) as runner:
        return runner.run(_stops(count))


async def _stops(count: int) -> dict[str, float]:
    from m100link.apps.fleet.identity import Signer

    signer = Signer("anna", bytes(32))
    async with AsyncExitStack() as stack:
        agents = {
            "signed": await Stopped.made(stack, signer),
            "plain": await Stopped.made(stack, None),
        }
        for _ in range(count):
            for agent in agents.values():
                await agent.stop()
    found = {kind: agent.spent[count // 10 :] for kind, agent in agents.items()}  # warm by then
    parts = {"p50": 0.5, "p99": 0.99}
    return {
        f"{kind} {name}": percentile(spent, part)
        for kind, spent in found.items()
        for name, part in parts.items()
    }


class Stopped:
    """A virtual aircraft, its agent, and the agent of the fleet before it.

    Args:
        agent: The one of the fleet.
        client: What tells the aircraft.
        sign: Of the orders.

    Attributes:
        spent: CPU of each stop, s.
    """

    def __init__(self, agent: Any, client: Any, sign: Callable[..., Any]) -> None:
        self._agent, self._sign = agent, sign
        self.spent: list[float] = []
        self._began = 0.0
        tell = client.stop

        async def told(by: str) -> None:
            self.spent.append(time.thread_time() - self._began)
            await tell(by)

        client.stop = told

    @classmethod
    async def made(cls, stack: AsyncExitStack, signer: Any) -> Stopped:
        """One that verifies and logs, where somebody signs."""
        from cryptography.hazmat.primitives.asymmetric import ec
        from cryptography.hazmat.primitives.hashes import SHA256

        from m100link.apps.agent.client import AgentClient
        from m100link.apps.agent.server.agent import Agent
        from m100link.apps.agent.server.connection import by_driver
        from m100link.apps.agent.server.server import AgentServer
        from m100link.apps.agent.transports import memory_channels
        from m100link.apps.fleet.agent import FleetAgent
        from m100link.apps.fleet.identity import Rights
        from m100link.apps.fleet.keys import Keys
        from m100link.apps.fleet.order_log import AuditLog, MemoryOrderLog
        from m100link.apps.fleet.payloads import OrderMessage
        from m100link.apps.fleet.signing import verifying
        from m100link.sim.ports.driver import Driver
        from m100link.sim.virtual import VirtualAircraft

        virtual = VirtualAircraft(seed=SEED)
        driver = Driver(virtual)
        stack.callback(driver.stop)
        agent = Agent(by_driver(driver), credentials=virtual.credentials)
        service = AgentServer(await stack.enter_async_context(agent))
        ours, its = memory_channels()
        service.attach(its)
        client = await stack.enter_async_context(AgentClient(ours, "fleet"))
        while not client.is_connected:  # noqa: ASYNC110 - virtual time: it costs nothing
            await asyncio.sleep(0.01)
        how: dict[str, Any] = {}
        if signer is not None:
            text = f'[identity.anna]\npublic_key = "{signer.public_key.hex()}"\nstop = ["a1"]'
            key = ec.generate_private_key(ec.SECP256R1())
            seal = b"", lambda line: key.sign(line, ec.ECDSA(SHA256()))
            how["verify"] = verifying(Rights.parse(text), ["a1"], time.time)
            how["audit"] = AuditLog(None, seal, time.time)
        bus: Any = None  # its answers go to nobody
        made = FleetAgent(client, bus, Keys(name="a1"), MemoryOrderLog(), **how)
        return cls(made, client, OrderMessage.under if signer is None else signer)

    async def stop(self) -> None:
        """Hand over one order, as it comes from the network."""
        from m100link.apps.agent.orders import Stop
        from m100link.apps.bus.network import Question
        from m100link.apps.fleet.payloads import OrderMessage, pack

        head = (os.urandom(16).hex(), "site", "a1", "anna")
        payload = pack(self._sign(OrderMessage(*head, 0, time.time(), Stop()), ""))
        question = Question("m100/site/a1/cmd", payload, lambda *_: None, lambda: None)
        self._began = time.thread_time()
        await self._agent._answer_order(question.key, question)


def others(setting: Setting, stack: ExitStack) -> Iterable[Side | Absent]:
    """pymavlink's parsers."""
    mavlink = peers.dialect()
    if mavlink is None:
        yield Absent(PEER, peers.MISSING)
        return
    number, periods = setting.count(AIRCRAFT), max(2, setting.count(PERIODS))
    wires = peers.mix(mavlink, periods)

    async def run() -> float:
        parsed = 0

        def receiver() -> Receive:
            parse = peers.parser(mavlink)

            def receive(data: bytes) -> None:
                nonlocal parsed
                parsed += parse(data)

            return receive

        return await Harness([receiver() for _ in range(number)], wires, lambda: parsed).run(
            periods
        )

    yield Side(PEER, lambda: asyncio.run(run()))


def more(part: str) -> Callable[[Costs], float]:
    """What a signed and logged stop costs more, ms."""
    return lambda costs: 1e3 * (costs[f"{STOP}, signed {part}"] - costs[f"{STOP}, plain {part}"])


PROGRAM = Program(
    name="fleet",
    rows=(
        Row(
            "aircraft at 100 Hz in one process, ours ÷ pymavlink",
            ratio(BARE, PEER),
            at_most(0.85, 0.65),
        ),
        Row("the same with a consuming task each", ratio(TASKS, PEER), at_most(1.0, 0.8)),
        Row("stop of a fleet, signed and logged − plain, p50", more("p50"), unit="ms"),
        Row("stop of a fleet, signed and logged − plain, p99", more("p99"), at_most(1.0), "ms"),
    ),
    ours=ours,
    others=others,
)

if __name__ == "__main__":
    main(PROGRAM)
