"""The whole station for as long as a block runs: aircraft, rosbridge, console."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass

from m100link.agent.agent import Agent
from m100link.agent.carriers.memory import memory_channels
from m100link.agent.client import AgentClient
from m100link.agent.connect import by_driver, by_url
from m100link.agent.connection import Connect
from m100link.agent.service import Service
from m100link.errors import UsageError
from m100link.protocol.commands.activation import Credentials
from m100link.sim.ports.driver import Driver
from m100link.sim.vehicle.settings import AircraftSettings
from m100link.sim.virtual import VirtualAircraft
from m100link.station.config import Settings
from m100link.station.web.access import Access
from m100link.station.web.server import Bridge, Server, listen

__all__ = ["Running", "running"]


@dataclass(frozen=True, slots=True)
class Running:
    """A station that runs.

    Attributes:
        agent: The aircraft and its lease.
        bridge: What rosbridge clients reach.
        ports: Ports of rosbridge, in the order of the settings.
        console_port: Port of the console, None without it.
        virtual: The virtual aircraft that it brought, or None.
        console_access: What browsers have to show, None where nothing is needed.
    """

    agent: Agent
    bridge: Bridge
    ports: list[int]
    console_port: int | None
    virtual: VirtualAircraft | None
    console_access: Access | None = None

    def console_path(self) -> str:
        """Path that opens the console in a browser, with a code that works once where needed."""
        return "/" if self.console_access is None else f"/?code={self.console_access.new_code()}"


def _virtual(credentials: Credentials | None) -> VirtualAircraft:
    settings = AircraftSettings(noise=1.0)
    if credentials is None:
        return VirtualAircraft(settings=settings)
    return VirtualAircraft(
        app_id=credentials.app_id,
        key=credentials.key,
        level=credentials.level,
        settings=settings,
    )


@asynccontextmanager
async def running(
    settings: Settings, *, with_console: bool = False, virtual: VirtualAircraft | None = None
) -> AsyncIterator[Running]:
    """Run a station while the block runs.

    Args:
        settings: What it needs to know.
        with_console: Serve the console, too.
        virtual: The virtual aircraft to use with ``sim``; by default one that stands ready.

    Raises:
        UsageError, PortBusy, PortFailed: Something in the settings cannot be, or a port is taken.
    """
    credentials = settings.credentials()
    settings.access_token()  # before anything is bound
    async with AsyncExitStack() as stack:
        if settings.sim:
            virtual = virtual or _virtual(credentials)
            credentials = virtual.credentials
            driver = Driver(virtual)
            driver.start()
            stack.callback(driver.stop)
            connect: Connect = by_driver(driver)
        elif settings.url is not None:
            connect = by_url(settings.url, baud_rate=settings.baud_rate, firmware=settings.firmware)
        else:
            raise UsageError(
                "no aircraft was named",
                remedy="give its URL, set M100LINK_URL, or use --sim for a virtual one",
            )
        sockets = [listen(settings.host, port) for port in (settings.port, *settings.also_ports)]
        for one in sockets:
            stack.callback(one.close)
        agent = await stack.enter_async_context(Agent(connect, credentials=credentials))
        service = Service(agent)
        front = await _front(stack, service, "rosbridge")
        bridge = Bridge(front, max_clients=settings.max_clients, pages=settings.pages)
        server = Server.make(bridge.app(settings), settings)
        await stack.enter_async_context(_serving(server, sockets))
        console_port = access = None
        if with_console:
            front = await _front(stack, service, "console")
            console_port, access = await _add_console(stack, front, settings, virtual)
        yield Running(
            agent,
            bridge,
            [one.getsockname()[1] for one in sockets],
            console_port,
            virtual,
            access,
        )


async def _front(stack: AsyncExitStack, service: Service, name: str) -> AgentClient:
    """A front's end of a way to the agent inside this process."""
    ours, its = memory_channels()
    service.attach(its)
    return await stack.enter_async_context(AgentClient(ours, name))


async def _add_console(
    stack: AsyncExitStack,
    agent: AgentClient,
    settings: Settings,
    virtual: VirtualAircraft | None,
) -> tuple[int, Access | None]:
    try:
        from m100link.station.console.app import console_app
    except ModuleNotFoundError as error:
        raise UsageError(
            f"the console needs {error.name}, which is not installed",
            remedy="pip install 'm100link[station]'",
        ) from None
    listening = listen(settings.host, settings.console_port)
    stack.callback(listening.close)
    app = console_app(agent, settings, virtual)
    server = Server.make(app, settings, lifespan="on")
    await stack.enter_async_context(_serving(server, [listening]))
    port: int = listening.getsockname()[1]
    return port, app.access


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
