"""The fronts on their sockets: rosbridge and the console, wherever their agent is."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass

from m100link.agent.carriers import Channel
from m100link.agent.client import AgentClient
from m100link.errors import UsageError
from m100link.station.config import Settings
from m100link.station.console.orders import Orders
from m100link.station.web.access import Access
from m100link.station.web.server import Bridge, Server, listen

__all__ = ["Fronts", "Sockets", "open_sockets", "serving_fronts"]


@dataclass(frozen=True, slots=True)
class Sockets:
    """Listening sockets of a station.

    Attributes:
        rosbridge: Those of rosbridge, in the order of the settings.
        console: That of the console, None without it.
    """

    rosbridge: list[socket.socket]
    console: socket.socket | None

    @property
    def ports(self) -> list[int]:
        """Ports of rosbridge."""
        return [one.getsockname()[1] for one in self.rosbridge]

    @property
    def console_port(self) -> int | None:
        """Port of the console, None without it."""
        return None if self.console is None else self.console.getsockname()[1]


@dataclass(frozen=True, slots=True)
class Fronts:
    """Fronts that serve.

    Attributes:
        agent: What rosbridge knows of the agent.
        bridge: What rosbridge clients reach.
        servers: What listens.
        console_access: What browsers have to show, None where nothing is needed.
    """

    agent: AgentClient
    bridge: Bridge
    servers: list[Server]
    console_access: Access | None

    def console_path(self) -> str:
        """Path that opens the console in a browser, with a code that works once where needed."""
        return "/" if self.console_access is None else f"/?code={self.console_access.new_code()}"

    def stop_listening(self) -> None:
        """Leave the ports to another station; connections that are there stay."""
        for server in self.servers:
            server.stop_listening()


def open_sockets(stack: AsyncExitStack, settings: Settings, *, with_console: bool) -> Sockets:
    """The listening sockets that the settings ask for; closed with the stack.

    Raises:
        PortBusy, PortFailed: A port is taken, or the address cannot be bound.
    """

    def opened(port: int) -> socket.socket:
        one = listen(settings.host, port)
        stack.callback(one.close)
        return one

    return Sockets(
        [opened(port) for port in (settings.port, *settings.also_ports)],
        opened(settings.console_port) if with_console else None,
    )


@asynccontextmanager
async def serving_fronts(
    settings: Settings,
    sockets: Sockets,
    reach: Callable[[], Awaitable[Channel]],
    orders: Orders | None = None,
) -> AsyncIterator[Fronts]:
    """Serve while the block runs.

    Args:
        settings: Who may connect, and what is served.
        sockets: Where.
        reach: Opens a way to the agent; called once for each front.
        orders: What the console's panel does to a virtual aircraft.

    Raises:
        UsageError: Something in the settings cannot be.
        LinkError: The agent cannot be reached.
    """
    async with AsyncExitStack() as stack:
        agent = await stack.enter_async_context(AgentClient(await reach(), "rosbridge"))
        bridge = Bridge(agent, max_clients=settings.max_clients, pages=settings.pages)
        servers = [Server.make(bridge.app(settings), settings)]
        await stack.enter_async_context(_serving(servers[0], sockets.rosbridge))
        access = None
        if sockets.console is not None:
            console = await stack.enter_async_context(AgentClient(await reach(), "console"))
            server, access = _console(console, settings, orders)
            await stack.enter_async_context(_serving(server, [sockets.console]))
            servers.append(server)
        yield Fronts(agent, bridge, servers, access)


def _console(
    agent: AgentClient, settings: Settings, orders: Orders | None
) -> tuple[Server, Access | None]:
    try:
        from m100link.station.console.app import console_app
    except ModuleNotFoundError as error:
        raise UsageError(
            f"the console needs {error.name}, which is not installed",
            remedy="pip install 'm100link[station]'",
        ) from None
    app = console_app(agent, settings, orders)
    return Server.make(app, settings, lifespan="on"), app.access


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
