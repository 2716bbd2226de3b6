"""The fronts on their sockets: rosbridge, console, MAVLink, wherever their agent is."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.transports import Channel
from m100link.apps.station.config import Settings
from m100link.apps.station.console.orders import Orders
from m100link.apps.station.mavlink import open_mavlink, serving_mavlink
from m100link.apps.station.ros2 import check_ros2, serving_ros2
from m100link.apps.station.web.access import Access
from m100link.apps.station.web.intake import Intake
from m100link.errors import LinkError, UsageError

if TYPE_CHECKING:
    from m100link.apps.station.console.tabs import Tabs
    from m100link.apps.station.web.server import Bridge, Server
__all__ = ["Fronts", "Reach", "Sockets", "keep_reached", "open_sockets", "serving_fronts"]

REACH_PAUSE = 0.5
"""Seconds between two looks whether an agent that has gone is there again."""

Reach = Callable[[], Awaitable[Channel]]
"""Opens a way to an agent."""


@dataclass(frozen=True, slots=True)
class Sockets:
    """Listening sockets of a station.

    Attributes:
        rosbridge: Those of rosbridge, in the order of the settings.
        console: That of the console, None without it.
        metrics: That of the numbers for Prometheus, None without them.
        mavlink: Those of MAVLink, for datagrams.
        foxglove: That of Foxglove's viewers, None without them.
    """

    rosbridge: list[socket.socket]
    console: socket.socket | None
    metrics: socket.socket | None = None
    mavlink: tuple[socket.socket, ...] = ()
    foxglove: socket.socket | None = None

    @property
    def mavlink_addresses(self) -> list[str]:
        """Where MAVLink is served."""
        names = (one.getsockname() for one in self.mavlink)
        return [f"udp://{host}:{port}" for host, port in names]

    @property
    def ports(self) -> list[int]:
        """Ports of rosbridge."""
        return [one.getsockname()[1] for one in self.rosbridge]

    @property
    def console_port(self) -> int | None:
        """Port of the console, None without it."""
        return None if self.console is None else self.console.getsockname()[1]

    @property
    def metrics_port(self) -> int | None:
        """Port of the numbers for Prometheus, None without them."""
        return None if self.metrics is None else self.metrics.getsockname()[1]

    @property
    def foxglove_port(self) -> int | None:
        """Port of Foxglove's viewers, None without them."""
        return None if self.foxglove is None else self.foxglove.getsockname()[1]


@dataclass(frozen=True, slots=True)
class Fronts:
    """Fronts that serve.

    Attributes:
        agents: What rosbridge knows of each agent, by the name of its aircraft; where there is only
            a console, what that knows: one that comes later is shown by it, too.
        bridge: What rosbridge clients reach; None without it.
        servers: What listens.
        console_access: What browsers have to show, None where nothing is needed.
        shown: The aircraft that pages of the console show.
    """

    agents: dict[str, AgentClient]
    bridge: Bridge | None
    servers: list[Server]
    console_access: Access | None
    shown: Callable[[], frozenset[str]] = frozenset

    def console_path(self) -> str:
        """Path that opens the console in a browser, with a code that works once where needed."""
        return "/" if self.console_access is None else f"/?code={self.console_access.new_code()}"

    def stop_listening(self) -> None:
        """Leave the ports to another station; connections that are there stay."""
        for server in self.servers:
            server.stop_listening()


def open_sockets(
    stack: AsyncExitStack, settings: Settings, *, with_console: bool, with_rosbridge: bool = True
) -> Sockets:
    """The listening sockets that the settings ask for; closed with the stack.

    Raises:
        PortBusy, PortFailed: A port is taken, or the address cannot be bound.
        UsageError: MAVLink is to be served to other machines, and nothing signs it; or a name in
            ROS cannot be.
    """
    check_ros2(settings)

    def opened(port: int) -> socket.socket:
        from m100link.apps.station.web.server import listen  # what has no page needs no server

        one = listen(settings.host, port)
        stack.callback(one.close)
        return one

    ports = (settings.port, *settings.also_ports) if with_rosbridge else ()
    return Sockets(
        [opened(port) for port in ports],
        opened(settings.console_port) if with_console else None,
        None if settings.metrics_port is None else opened(settings.metrics_port),
        tuple(open_mavlink(stack, settings)),
        None if settings.foxglove_port is None else opened(settings.foxglove_port),
    )


@asynccontextmanager
async def serving_fronts(
    settings: Settings,
    sockets: Sockets,
    reach: Mapping[str, Reach],
    orders: Mapping[str, Orders],
    *,
    is_far: bool = False,
) -> AsyncIterator[Fronts]:
    """Serve while the block runs.

    Args:
        settings: Who may connect, and what is served.
        sockets: Where.
        reach: Opens a way to an agent, by the name of its aircraft; called for each front, and
            again when one of several agents has gone.
        orders: What the console's panel does to virtual aircraft.
        is_far: The agents are elsewhere, and the only one, too, is looked for when it has gone.

    Raises:
        UsageError: Something in the settings cannot be.
        LinkError: An agent cannot be reached.
    """
    async with AsyncExitStack() as stack:
        reached = partial(_reached, stack, reach, is_kept=is_far or len(reach) > 1)
        agents: dict[str, AgentClient] = {}
        bridge: Bridge | None = None
        servers: list[Server] = []
        intake = Intake()  # of all servers of this process
        if sockets.rosbridge:
            agents = await reached("rosbridge")
            bridge, server = _rosbridge(agents, settings, intake)
            await stack.enter_async_context(_serving(server, sockets.rosbridge))
            servers.append(server)
        access: Access | None = None
        shown: Callable[[], frozenset[str]] = frozenset
        dropped_by_tabs: Callable[[], Mapping[str, int]] = dict
        if sockets.console is not None:
            console = await reached("console")
            server, access, tabs = _console(
                console, settings, orders, dict if bridge is None else bridge.dropped, intake
            )
            dropped_by_tabs, shown = tabs.dropped, tabs.shown
            agents = agents or console
            await stack.enter_async_context(_serving(server, [sockets.console]))
            servers.append(server)
        agents = agents or await reached("ROS 2" if settings.ros2 else "fronts")
        if sockets.mavlink:
            vehicles = await reached("mavlink")
            await stack.enter_async_context(serving_mavlink(vehicles, settings, sockets.mavlink))
        if settings.ros2:
            has_own = bool(sockets.rosbridge) or sockets.console is not None
            flown = await reached("ROS 2") if has_own else agents
            await stack.enter_async_context(serving_ros2(flown, settings))
        if sockets.metrics is not None and bridge is not None:
            servers.append(_metrics(bridge, settings, dropped_by_tabs, intake))
            await stack.enter_async_context(_serving(servers[-1], [sockets.metrics]))
        if sockets.foxglove is not None:
            viewed = await reached("foxglove")
            servers.append(await _foxglove(stack, viewed, settings, intake))
            await stack.enter_async_context(_serving(servers[-1], [sockets.foxglove]))
        yield Fronts(agents, bridge, servers, access, shown)


def _rosbridge(
    agents: Mapping[str, AgentClient], settings: Settings, intake: Intake
) -> tuple[Bridge, Server]:
    from m100link.apps.station.web.server import Bridge, Server

    bridge = Bridge(agents, max_clients=settings.max_clients, pages=settings.pages)
    return bridge, Server.make(bridge.app(settings), settings, intake=intake)


def _console(
    agents: Mapping[str, AgentClient],
    settings: Settings,
    orders: Mapping[str, Orders],
    dropped_by_clients: Callable[[], Mapping[str, int]],
    intake: Intake,
) -> tuple[Server, Access | None, Tabs]:
    try:
        from m100link.apps.station.console.app import console_app
        from m100link.apps.station.console.tabs import Tabs
        from m100link.apps.station.web.server import Server
    except ModuleNotFoundError as error:
        raise UsageError(
            f"the console needs {error.name}, which is not installed",
            remedy="pip install '.[station]' in a clone of m100link",
        ) from None
    tabs = Tabs(agents, dropped_by_clients)
    app = console_app(agents, settings, orders, tabs)
    return Server.make(app, settings, lifespan="on", intake=intake), app.access, tabs


def _metrics(
    bridge: Bridge,
    settings: Settings,
    dropped_by_tabs: Callable[[], Mapping[str, int]],
    intake: Intake,
) -> Server:
    try:
        from m100link.apps.station.web.metrics import metrics_app
        from m100link.apps.station.web.server import Server
    except ModuleNotFoundError as error:
        raise UsageError(
            f"the metrics need {error.name}, which is not installed",
            remedy="pip install '.[station]' in a clone of m100link",
        ) from None
    app = metrics_app(bridge, settings, dropped_by_tabs)
    return Server.make(app, settings, intake=intake)


async def _foxglove(
    stack: AsyncExitStack,
    agents: Mapping[str, AgentClient],
    settings: Settings,
    intake: Intake,
) -> Server:
    from m100link.apps.station.foxglove.app import FoxgloveServer
    from m100link.apps.station.web.server import Server

    viewed = FoxgloveServer(agents)
    await stack.enter_async_context(viewed.feeding())
    return Server.make(viewed.app(settings), settings, intake=intake)


@asynccontextmanager
async def _serving(server: Server, sockets: list[socket.socket]) -> AsyncIterator[None]:
    serving = asyncio.create_task(server.run_on(sockets), name="m100link station: server")
    started = asyncio.create_task(server.wait_started())
    try:
        await asyncio.wait((serving, started), return_when=asyncio.FIRST_COMPLETED)
        if serving.done():
            await serving
        yield
    finally:
        started.cancel()
        serving.cancel()
        await asyncio.gather(serving, started, return_exceptions=True)


async def _reached(
    stack: AsyncExitStack, reach: Mapping[str, Reach], name: str, *, is_kept: bool
) -> dict[str, AgentClient]:
    """All agents, each for the front of that name."""
    agents = {}
    for aircraft, way in reach.items():
        agent = await stack.enter_async_context(AgentClient(await way(), name))
        if is_kept:
            agent.background.spawn(keep_reached(agent, way), f"way to {aircraft}")
        agents[aircraft] = agent
    return agents


async def keep_reached(agent: AgentClient, reach: Reach) -> None:
    """Whenever the agent has gone, look for the one that is started instead, until cancelled."""
    while True:
        await asyncio.sleep(REACH_PAUSE)
        if agent.is_gone:
            with suppress(LinkError):
                agent.reopen(await reach())
