"""An agent on a virtual aircraft, a node, and a bus in memory: on virtual time."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import anyio
import pytest

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.server.agent import Agent
from m100link.apps.agent.server.connection import by_driver
from m100link.apps.agent.server.server import AgentServer
from m100link.apps.agent.transports import memory_channels
from m100link.apps.bus.network import Held, Inbox, Outlet, Question, Received, TokenChange
from m100link.apps.ros2.graph import Names, data_key, read_attachment, write_attachment
from m100link.apps.ros2.node import Node
from m100link.apps.ros2.topics import INPUTS, OUTPUTS, SERVICES
from m100link.log.cdr import decode, encode
from m100link.sim.clock import virtual_clock_loop
from m100link.sim.ports.driver import Driver
from m100link.sim.virtual import VirtualAircraft
from tests.apps.bus.memory import MemoryInbox
from tests.rig import know_app

UTC = 1_800_000_000.0
"""POSIX time as the clock of the loop begins."""


@pytest.fixture
def anyio_backend() -> tuple[str, dict[str, Any]]:
    return "asyncio", {"loop_factory": virtual_clock_loop}


class RecordingOutlet(Outlet):
    def __init__(self) -> None:
        self.sent: list[tuple[bytes, bytes]] = []
        self.has_listeners = True

    def put(self, payload: bytes, attachment: bytes | None = None) -> None:
        self.sent.append((payload, attachment or b""))

    def is_wanted(self) -> bool:
        return self.has_listeners

    def close(self) -> None:
        """Nothing is held."""


class RecordingBus:
    """A session without a network: tests read what it offers, and fill what it hears.

    Nothing here needs an event loop, and what is put is there at once; over a network with weather
    messages go in ``tests/apps/bus/memory.py``.
    """

    session = "0123456789abcdef"

    def __init__(self) -> None:
        self.outlets: dict[str, RecordingOutlet] = {}
        self.inboxes: dict[str, MemoryInbox[Any]] = {}
        self.tokens: list[str] = []
        self.changed = MemoryInbox[TokenChange](1024)
        self.asked: list[str] = []
        self.answering: set[str] = set()
        self.is_connected = True

    def publish(self, key: str, *, kept: int = 0) -> Outlet:
        return self.outlets.setdefault(key, RecordingOutlet())

    def inbox(self, pattern: str, depth: int) -> Inbox[Received]:
        return self.inboxes.setdefault(pattern, MemoryInbox(depth))

    def questions(self, key: str, depth: int) -> Inbox[Question]:
        return self.inboxes.setdefault(key, MemoryInbox(depth))

    def declare(self, token: str) -> Held:
        self.tokens.append(token)
        return RecordingOutlet()

    def changes(self, pattern: str) -> Inbox[TokenChange]:
        return self.changed

    def is_alone(self) -> bool:
        return not self.is_connected

    def probe(self, key: str, *, timeout: float) -> Inbox[bool]:
        inbox = MemoryInbox[bool](1)
        at, session, every = key.split("/")
        assert (at, every) == ("@", "*")
        self.asked.append(session)
        if session in self.answering:
            inbox.waiting.append(True)
        return inbox


class Program:
    """A ROS program: publishes and calls, with an id of its own."""

    def __init__(self, rig: Rig, number: int = 1) -> None:
        self.rig, self.gid = rig, bytes([number]) * 16
        self.sequence = self.published = 0
        self.late = 0.0
        self.is_cut = False

    def attachment(self) -> bytes:
        self.sequence += 1
        sent_at = self.rig.utc() - self.late
        return write_attachment(self.sequence, round(sent_at * 1e9), self.gid)

    def publish(self, name: str, message: dict[str, Any]) -> None:
        kind = INPUTS[name].kind
        inbox = self.rig.inbox(name, kind)
        self.published += 1  # each end of a node counts what it sends
        sent_at = round((self.rig.utc() - self.late) * 1e9)
        attachment = write_attachment(self.published, sent_at, self.gid)
        if not self.is_cut:
            inbox.waiting.append(Received(encode(kind, message), attachment))

    def speed(self, x: float = 0.0, y: float = 0.0, z: float = 0.0, **more: Any) -> None:
        """~/cmd_vel; ``turn``, ``frame`` and ``made_at`` (POSIX time, s) besides."""
        sec, part = divmod(more.get("made_at", 0.0), 1.0)
        header = {
            "stamp": {"sec": int(sec), "nanosec": int(1e9 * part)},
            "frame_id": more.get("frame", "base_link"),
        }
        angular = {"x": 0.0, "y": 0.0, "z": more.get("turn", 0.0)}
        twist = {"linear": {"x": x, "y": y, "z": z}, "angular": angular}
        self.publish("~/cmd_vel", {"header": header, "twist": twist})

    async def fly(self, seconds: float, x: float = 0.0, y: float = 0.0, **more: Any) -> None:
        """The same at 20 Hz."""
        for _ in range(round(20 * seconds)):
            self.speed(x, y, **more)
            await anyio.sleep(0.05)

    async def call(self, name: str, kind: str = "", **request: Any) -> dict[str, Any]:
        """Ask a service of the table, or any other one whose type is given."""
        kind = kind or SERVICES[name].kind
        key = data_key(0, self.rig.names.full(name), kind)
        return await self.ask(key, name, kind, request) or {"success": None}

    async def ask(
        self, key: str, name: str, kind: str, request: dict[str, Any] | None = None
    ) -> dict[str, Any] | None:
        """Ask a service by a key, or a pattern; None when there is no answer."""
        answers: list[tuple[bytes, bytes]] = []
        attachment = self.attachment()
        asked = Question(
            key,
            encode(f"{kind}_Request", request or {}),
            lambda _, payload, its=b"": answers.append((payload, its or b"")),
            lambda: answers.append((b"", b"")),
            attachment,
        )
        self.rig.inbox(name, kind).waiting.append(asked)
        await self.rig.until(lambda: bool(answers))
        payload, its = answers[0]
        if not payload:
            return None
        ours, theirs = read_attachment(attachment), read_attachment(its)
        assert (theirs.sequence, theirs.gid) == (ours.sequence, ours.gid)
        return decode(f"{kind}_Response", payload)

    async def up(self) -> None:
        """Obtain control, take off, wait for the hover."""
        assert (await self.call("~/obtain_control"))["success"]
        assert (await self.call("~/takeoff"))["success"]
        await self.rig.until(lambda: self.rig.height > 1.0 and not self.rig.client.state.task)


class Rig:
    """The whole: aircraft, agent, node."""

    def __init__(
        self,
        *,
        firmware: str = "1.0",
        names: Names | None = None,
        has_dji_names: bool = False,
        **more: Any,
    ) -> None:
        self.aircraft = VirtualAircraft(seed=5, firmware=firmware)
        know_app(self.aircraft)
        self.driver = Driver(self.aircraft)
        self.agent = Agent(by_driver(self.driver), credentials=self.aircraft.credentials, **more)
        self.bus = RecordingBus()
        self.names = names or Names.of("/", "m100")
        self.has_dji_names = has_dji_names

    def utc(self) -> float:
        return UTC + self.client.now

    @asynccontextmanager
    async def running(self) -> AsyncIterator[Rig]:
        async with AsyncExitStack() as stack:
            await stack.enter_async_context(self.agent)
            self.service = AgentServer(self.agent)
            ours, its = self.channels = memory_channels()
            self.service.attach(its)
            self.client = await stack.enter_async_context(AgentClient(ours, "ROS 2"))
            self.node = Node(
                self.client,
                self.bus,
                self.names,
                has_clock=True,
                has_dji_names=self.has_dji_names,
                utc=self.utc,
            )
            self.work = self.agent.background.spawn(self.node.run(), "node")
            self.program = Program(self)
            await self.until(lambda: bool(self.outlet("~/odom").sent))
            yield self
            self.work.cancel()
        self.driver.stop()

    def inbox(self, name: str, kind: str) -> MemoryInbox[Any]:
        return self.bus.inboxes[data_key(0, self.names.full(name), kind)]

    def outlet(self, name: str) -> RecordingOutlet:
        return self.bus.outlets[data_key(0, self.names.full(name), OUTPUTS[name].kind)]

    def said(self, name: str) -> list[dict[str, Any]]:
        """All messages of a topic."""
        kind = OUTPUTS[name].kind
        return [decode(kind, payload) for payload, _ in self.outlet(name).sent]

    @property
    def texts(self) -> str:
        return "\n".join(one["msg"] for one in self.said("/rosout"))

    async def until(self, predicate: Callable[[], bool], within: float = 60.0) -> None:
        with anyio.fail_after(within):
            while not predicate():  # noqa: ASYNC110 - virtual time: it costs nothing
                await anyio.sleep(0.01)

    @property
    def height(self) -> float:
        return float(self.aircraft.height)

    @property
    def speed(self) -> float:
        return float(self.aircraft.vehicle.flight.dynamics.speed)

    @property
    def motors_on(self) -> bool:
        return bool(self.aircraft.vehicle.flight.dynamics.motors_on)


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    async with Rig().running() as one:
        yield one


@pytest.fixture
def program(rig: Rig) -> Program:
    return rig.program


def judge() -> Any:
    """``rosbags.typesys``: a test that needs it is skipped where it is not installed."""
    return pytest.importorskip("rosbags.typesys", reason="the judge is not installed")
