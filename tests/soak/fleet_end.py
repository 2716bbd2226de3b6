"""One process of a large fleet: agents, or who watches. Started by :mod:`tests.soak.fleet`.

Told by lines on its standard input what to do next, it tells what it counted in lines of JSON.

A *told* agent is everything of an agent that a fleet has: its client, and the fleet's part with its
keys, token, cards and telemetry. Packages of a virtual aircraft, recorded before, are its aircraft.
A *flying* one has a virtual aircraft of its own, with its physics, and the whole way from it.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time
from collections import Counter
from collections.abc import Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from typing import Any

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.messages import State, Telemetry
from m100link.apps.agent.transports import MemoryChannel, memory_channels
from m100link.apps.bus.network import DEPTH, Held
from m100link.apps.fleet.agent import FleetAgent
from m100link.apps.fleet.client import Fleet, open_fleet
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.order_log import MemoryOrderLog
from m100link.apps.fleet.publisher import WALL_HZ, FleetTelemetry, Thinner
from m100link.apps.fleet.signing import SealedBus
from m100link.apps.station.config import Settings
from m100link.apps.station.run import owning
from m100link.apps.station.supervisor import leave_what_stays
from m100link.sim import VirtualClockEventLoop
from m100link.testing import ConnectableAircraft

__all__ = ["FULL_HZ", "LOOKED_AT", "SITE", "main"]

SITE = "thousand"
LOOKED_AT = "a0"
FULL_HZ = 50.0
_SLICE_S = 0.005
"""Packages that are due are sent in slices of so many seconds: as one turn of a busy loop does."""


class _CountedPublisher:
    """A publisher of zenoh's, where a message leaves: to count earlier would cost four calls."""

    def __init__(self, publisher: Any, sent: Counter[str], kind: str) -> None:
        self._put, self._sent, self._kind = publisher.put, sent, kind
        self.matching_status = publisher.matching_status
        self.declare_matching_listener = publisher.declare_matching_listener
        self.undeclare = publisher.undeclare

    def put(self, payload: bytes, attachment: bytes | None = None) -> None:
        self._sent[self._kind] += 1
        self._put(payload, attachment=attachment)


class _CountedSession:
    def __init__(self, session: Any, sent: Counter[str]) -> None:
        self._session, self._sent = session, sent

    def __getattr__(self, name: str) -> Any:
        return getattr(self._session, name)

    def declare_publisher(self, key: str, **more: Any) -> _CountedPublisher:
        publisher = self._session.declare_publisher(key, **more)
        return _CountedPublisher(publisher, self._sent, key.rpartition("/")[2])


class _CountedBus:
    """A session that counts what goes out and what comes in, by the last word of the key.

    Attributes:
        sent: What was handed to the network.
        heard: What came.
    """

    def __init__(self, bus: SealedBus) -> None:
        self._bus, self.publish = bus, bus.publish
        self.serve, self.ask, self.declare = bus.serve, bus.ask, bus.declare
        self.watch, self.tokens, self.session = bus.watch, bus.tokens, bus.session
        self.sent: Counter[str] = Counter()
        self.heard: Counter[str] = Counter()
        inner: Any = bus._bus
        inner._session = _CountedSession(inner._session, self.sent)

    def subscribe(
        self,
        pattern: str,
        take: Callable[[str, bytes], None],
        *,
        depth: int = DEPTH,
        within: float = 0.0,
    ) -> Held:
        kind = pattern.rpartition("/")[2]

        def heard(key: str, payload: bytes) -> None:
            self.heard[kind] += 1
            take(key, payload)

        return self._bus.subscribe(pattern, heard, depth=depth, within=within)


@dataclass(slots=True)
class _Told:
    """What tells one agent's client what an aircraft said.

    Attributes:
        name: Of the aircraft.
        channel: The end of the agent.
        place: Which package is next.
    """

    name: str
    channel: MemoryChannel
    place: int = 0

    def begin(self) -> None:
        state = State(at=time.monotonic(), connection="connected", firmware="1.0")
        self.channel.send(state)

    def tell(self, packages: list[Telemetry]) -> None:
        one = packages[self.place % len(packages)]
        self.place += 1
        self.channel.send(Telemetry(one.value, one.profile, time.monotonic()))


def recorded(seconds: float = 10.0) -> list[Telemetry]:
    """Packages of a virtual aircraft that suffice for a wall, as it sends them."""

    async def record() -> list[Telemetry]:
        virtual, thinner, found = ConnectableAircraft(seed=1), Thinner(), []
        async with virtual.connect() as aircraft, aircraft.telemetry() as samples:
            ends = asyncio.get_running_loop().time() + seconds
            async for one in samples:
                if thinner.goes_on(one.flags, one.received_at):
                    found.append(Telemetry(one.value, one.profile.name, one.received_at))
                if one.received_at > ends:
                    break
        virtual.stop()
        return found

    with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
        return runner.run(record())


@dataclass
class _Agents:
    """The agents of one process.

    Attributes:
        clients: Of each, by name.
        told: Those whose aircraft is recorded.
        packages: What they receive.
    """

    packages: list[Telemetry]
    clients: dict[str, AgentClient] = field(default_factory=dict)
    told: list[_Told] = field(default_factory=list)

    async def begin(self, stack: AsyncExitStack, names: list[str], *, flying: bool) -> None:
        for place, name in enumerate(names):
            ours, its = memory_channels()
            if flying:
                settings = Settings(sim=True, no_record=True)
                owner = await stack.enter_async_context(owning(settings, place=place))
                owner.service.attach(its)
            else:
                its.open(lambda _: None, lambda _: None)
                self.told.append(_Told(name, its))
            self.clients[name] = await stack.enter_async_context(AgentClient(ours, "fleet"))
        for one in self.told:
            one.begin()
        while flying and not all(client.is_connected for client in self.clients.values()):  # noqa: ASYNC110 - others bring it
            await asyncio.sleep(0.1)

    async def tell(self, seconds: float) -> None:
        """Five packages a second of each, at phases of their own; fifty of the one looked at."""
        began = time.monotonic()
        pause = 1.0 / (WALL_HZ * max(1, len(self.told)))
        looked_at = [one for one in self.told if one.name == LOOKED_AT]
        wall = [one for one in self.told if one.name != LOOKED_AT]
        done = looked = 0
        while (passed := time.monotonic() - began) < seconds:
            while wall and done * pause <= passed:
                wall[done % len(wall)].tell(self.packages)
                done += 1
            while looked_at and looked / FULL_HZ <= passed:
                looked_at[0].tell(self.packages)
                looked += 1
            await asyncio.sleep(_SLICE_S)


def _line(**what: object) -> None:
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


async def _asked(*words: str) -> float:
    """Wait for a line with one of the words; the number behind it."""
    line = (await asyncio.to_thread(sys.stdin.readline)).split()
    if not line or line[0] not in words:
        raise EOFError(f"{line} instead of {words}")
    return float(line[1]) if len(line) > 1 else 0.0


async def agents(place: str, names: list[str], *, flying: bool) -> None:
    """Agents: for a while alone, which costs what they cost without a fleet, then in one."""
    made = _Agents([] if flying else await asyncio.to_thread(recorded))
    async with AsyncExitStack() as stack:
        await made.begin(stack, names, flying=flying)
        _line(ready=len(names))
        seconds = await _asked("alone")
        cpu = time.process_time()
        await made.tell(seconds)
        _line(cpu=time.process_time() - cpu)
        bus = _CountedBus(await stack.enter_async_context(open_fleet("client", connect=(place,))))
        async with asyncio.TaskGroup() as group:
            running = [
                group.create_task(FleetAgent(client, bus, Keys(SITE, name), MemoryOrderLog()).run())
                for name, client in made.clients.items()
            ]
            seconds = await _asked("together")
            leave_what_stays()
            before, cpu = Counter(bus.sent), time.process_time()
            await made.tell(seconds)
            cpu = time.process_time() - cpu
            for one in running:  # what goes out from here on would be counted by one end alone
                one.cancel()
        _line(cpu=cpu, sent=bus.sent - before)
        await _asked("end")


async def watch(place: str, count: int) -> None:
    """Who watches all of them, and one in full."""
    async with AsyncExitStack() as stack:
        bus = _CountedBus(await stack.enter_async_context(open_fleet("client", connect=(place,))))
        fleet = await stack.enter_async_context(Fleet(bus, site=SITE))
        wall = FleetTelemetry(bus, fleet.keys)
        full = FleetTelemetry(bus, Keys(SITE, LOOKED_AT), full=True)
        while len(fleet.present) < count:  # noqa: ASYNC110 - other processes bring them
            await asyncio.sleep(0.1)
        _line(ready=len(fleet.present))
        await _asked("together")
        leave_what_stays()
        before, walls, cpu = Counter(bus.heard), Counter(wall.received), time.process_time()
        await _asked("end")
        _line(
            cpu=time.process_time() - cpu,
            heard=bus.heard - before,
            walls=wall.received - walls,
            unread=wall.unread + full.unread,
            present=len(fleet.present),
        )


def main(words: list[str]) -> None:
    """One process: ``told PLACE NAME…``, ``flying PLACE NAME…`` or ``watch PLACE COUNT``."""
    role, place, *names = words
    if role == "watch":
        asyncio.run(watch(place, int(names[0])))
    else:
        asyncio.run(agents(place, names, flying=role == "flying"))


if __name__ == "__main__":
    main(sys.argv[1:])
