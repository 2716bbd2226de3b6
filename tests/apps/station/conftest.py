"""Everything here flies a virtual aircraft on virtual time."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.server.agent import Agent
from m100link.apps.agent.server.connection import by_driver
from m100link.apps.agent.server.server import AgentServer
from m100link.apps.agent.transports import memory_channels
from m100link.apps.station import run, supervisor
from m100link.apps.station.config import ONLY_NAME, Settings
from m100link.apps.station.ros.client import Client
from m100link.apps.station.ros.dji_sdk import DjiSdk
from m100link.apps.station.ros.graph import Graph, add_rosapi, add_rosout
from m100link.apps.station.ros.leases import Clients
from m100link.apps.station.ros.node_2015 import Node2015
from m100link.apps.station.run import RunningMultiVehicle, RunningTwoProcess
from m100link.sim.clock import virtual_clock_loop
from m100link.sim.ports.driver import Driver
from m100link.sim.virtual import VirtualAircraft
from tests.apps.agent.conftest import task_of


@pytest.fixture
def anyio_backend() -> tuple[str, dict[str, Any]]:
    return "asyncio", {"loop_factory": virtual_clock_loop}


class FakeClient:
    """A rosbridge client without a socket."""

    def __init__(self, rig: Rig, name: str) -> None:
        self._rig = rig
        self.session = Client(rig.graph, name)
        self.session.is_steering = lambda: rig.front.holder.name == name
        self.inbox: list[Any] = []

    def send(self, op: str, **fields: Any) -> None:
        self.session.receive(json.dumps({"op": op, **fields}), self._rig.agent.now)

    def publish(self, topic: str, **message: float) -> None:
        kind = self._rig.graph.topics[topic].type.name
        self.send("advertise", topic=topic, type=kind)
        self.send("publish", topic=topic, msg=message)

    def subscribe(self, *topics: str, **options: Any) -> None:
        for topic in topics:
            self.send("subscribe", topic=topic, **options)

    def call(self, service: str, **args: Any) -> None:
        self.send("call_service", service=service, args=args)

    def read(self) -> list[Any]:
        self.session.outbox.advance(self._rig.agent.now)
        while (frame := self.session.outbox.next_frame()) is not None:
            assert isinstance(frame, str)
            self.inbox.append(json.loads(frame))
        return self.inbox

    def values(self, topic: str) -> list[Any]:
        return [one["msg"]["data"] for one in self.read() if one.get("topic") == topic]

    def statuses(self) -> list[str]:
        return [one["msg"] for one in self.read() if one["op"] == "status"]

    def answers(self) -> list[Any]:
        return [
            one["values"] if one["result"] else one
            for one in self.read()
            if one["op"] == "service_response"
        ]

    def leave(self) -> None:
        self.session.close(self._rig.agent.now)


def serve_rosbridge(agent: AgentClient, graph: Graph) -> None:
    """What a station offers to clients of rosbridge."""
    clients = Clients(agent, graph)
    Node2015(agent, graph, clients)
    DjiSdk(agent, graph, clients)
    add_rosout({"m100": agent}, graph)
    add_rosapi(graph)


class Rig:
    """A station on a virtual aircraft."""

    def __init__(self, aircraft: VirtualAircraft) -> None:
        self.aircraft = aircraft
        self.driver = Driver(aircraft)
        self.agent = Agent(by_driver(self.driver), credentials=aircraft.credentials)
        self.graph = Graph()

    @asynccontextmanager
    async def running(self) -> AsyncIterator[Rig]:
        # As bytes, so that every message of every test also goes through its codec.
        ours, its = self.channels = memory_channels(as_bytes=True)
        self.service = AgentServer(self.agent)
        async with self.agent, AgentClient(ours, "station") as self.front:
            self.service.attach(its)
            serve_rosbridge(self.front, self.graph)
            await self.until(lambda: self.front.is_connected)
            yield self
        self.driver.stop()

    def client(self, name: str = "page") -> FakeClient:
        return FakeClient(self, name)

    async def until(self, predicate: Callable[[], bool], within: float = 60.0) -> None:
        with anyio.fail_after(within):
            while not predicate():  # noqa: ASYNC110 - virtual time: it costs nothing
                await anyio.sleep(0.01)

    async def activated(self) -> None:
        await self.agent.ask(orders.Activate())

    async def open(self, name: str = "page") -> FakeClient:
        """A client that activated and opened control."""
        if not (self.agent.connection.aircraft and self.agent.connection.aircraft.is_activated):
            await self.activated()
        client = self.client(name)
        client.subscribe("/nav_open_close_status")
        client.publish("/nav_open_close_request", data=1)
        await self.until(lambda: self.agent.holding.has_authority)
        return client

    async def airborne(self, name: str = "page") -> FakeClient:
        client = await self.open(name)
        client.publish("/sdk_request_cmd", data=4)
        await self.until(lambda: task_of(self.agent) is not None)
        await self.until(lambda: task_of(self.agent) is None)
        assert self.aircraft.height > 1.0
        return client

    @property
    def moves(self) -> list[Any]:
        """Movement frames that reached the aircraft."""
        return list(self.aircraft.autopilot.received_movements)


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    async with AsyncExitStack() as stack:
        yield await stack.enter_async_context(Rig(VirtualAircraft(seed=5)).running())


@asynccontextmanager
async def apart(settings: Settings, **served: Any) -> AsyncIterator[RunningTwoProcess]:
    """A station in two processes, as a command begins it."""
    async with (
        supervisor.beginning_fronts({ONLY_NAME: settings}, **served) as fronts,
        run.running_apart(settings, fronts) as one,
    ):
        yield one


@asynccontextmanager
async def several(
    aircraft: Mapping[str, Settings], tell: run.Tell = lambda *_: None, **served: Any
) -> AsyncIterator[RunningMultiVehicle]:
    """A station of several aircraft, as a command begins it."""
    async with (
        supervisor.beginning_fronts(aircraft, **served) as fronts,
        run.running_several(aircraft, fronts, tell=tell) as one,
    ):
        yield one
