"""The station in two processes: here who flies, in the other who talks to strangers.

This process owns the port, control authority, the lease and the log, and listens to nobody but its
fronts. Those run in a child at a lower priority, behind a Unix socket in a private directory. The
listening sockets are opened here and given to the child: when it dies, clients wait for the next
one, which is started beside the flying agent. A child that hangs or dies costs a hover.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from m100link.apps.agent.server.agent import Agent
from m100link.apps.agent.transports import private_directory, serve_unix
from m100link.apps.station.child import Child
from m100link.apps.station.config import ONLY_NAME, Settings
from m100link.apps.station.fronts import Sockets, open_sockets
from m100link.apps.station.run import Owner, owning
from m100link.sim.orders.ctl import CtlServer
from m100link.sim.virtual import VirtualAircraft

__all__ = ["RunningApart", "front_process", "front_settings", "kept", "running_apart"]

_NOT_FOR_FRONTS = ("url", "key", "key_file", "app_id", "token_file", "record", "origins", "unused")


@dataclass(frozen=True, slots=True)
class RunningApart:
    """A station in two processes.

    Attributes:
        owner: What owns the aircraft, in this process.
        front: The other process.
        sockets: Where the fronts listen.
    """

    owner: Owner
    front: Child
    sockets: Sockets

    @property
    def agent(self) -> Agent:
        """The aircraft and its lease."""
        return self.owner.agent

    @property
    def has_authority(self) -> bool:
        """Whether an aircraft obeys this station."""
        return self.agent.holding.has_authority

    @property
    def ports(self) -> list[int]:
        """Ports of rosbridge, in the order of the settings."""
        return self.sockets.ports

    @property
    def console_port(self) -> int | None:
        """Port of the console, None without it."""
        return self.sockets.console_port

    @property
    def metrics_port(self) -> int | None:
        """Port of the numbers for Prometheus, None without them."""
        return self.sockets.metrics_port

    @property
    def foxglove_port(self) -> int | None:
        """Port of Foxglove's viewers, None without them."""
        return self.sockets.foxglove_port

    @property
    def mavlink(self) -> list[str]:
        """Where MAVLink is served."""
        return self.sockets.mavlink_addresses

    def console_path(self) -> str:
        """Path that opens the console in a browser, with a code that works once where needed."""
        return str(self.front.answer["console_path"])


def front_settings(settings: Settings) -> dict[str, Any]:
    """What the fronts have to know, as JSON takes it: nothing of the app and its key.

    Raises:
        UsageError: The token cannot be one.
    """
    given = {
        one.name: getattr(settings, one.name)
        for one in fields(settings)
        if one.name not in _NOT_FOR_FRONTS
    }
    given["token"] = settings.access_token()
    return as_json(given)


def as_json(given: dict[str, Any]) -> dict[str, Any]:
    """Settings by name, as JSON takes them and :mod:`m100link.apps.station.config` reads them."""
    return {
        name: str(value) if isinstance(value, Path) else value
        for name, value in given.items()
        if value is not None
    }


def front_process(
    settings: Settings,
    sockets: Sockets,
    agents: dict[str, Path],
    orders: dict[str, Path],
    note: Callable[[str, str], None],
) -> Child:
    """The process of the fronts, not yet started.

    Args:
        settings: Who may connect, and what is served.
        sockets: Listening sockets to hand over.
        agents: Where each agent serves, by the name of its aircraft.
        orders: Where each virtual aircraft takes orders.
        note: Takes what happens to the process, and its level.

    Raises:
        UsageError: Something in the settings cannot be.
    """
    datagrams = [one.fileno() for one in sockets.mavlink]
    console = None if sockets.console is None else sockets.console.fileno()
    metrics = None if sockets.metrics is None else sockets.metrics.fileno()
    foxglove = None if sockets.foxglove is None else sockets.foxglove.fileno()
    numbers = [one.fileno() for one in sockets.rosbridge]
    request = {
        "settings": front_settings(settings),
        "rosbridge": numbers,
        "console": console,
        "metrics": metrics,
        "foxglove": foxglove,
        "mavlink": datagrams,
        "agents": as_json(dict(agents)),
        "orders": as_json(dict(orders)),
    }
    others = [one for one in (console, metrics, foxglove) if one is not None]
    inherited = [*numbers, *datagrams, *others]
    return Child("m100link.apps.station.front", "the fronts", request, note, inherited=inherited)


@asynccontextmanager
async def kept(child: Child) -> AsyncIterator[None]:
    """Start a child, start it again while the block runs, and end it."""
    async with AsyncExitStack() as stack:
        await child.start()
        stack.push_async_callback(child.end)
        keeping = asyncio.create_task(child.keep(), name="m100link station: child")
        stack.push_async_callback(_ended, keeping)
        yield


@asynccontextmanager
async def running_apart(
    settings: Settings,
    *,
    with_console: bool = False,
    with_rosbridge: bool = True,
    virtual: VirtualAircraft | None = None,
) -> AsyncIterator[RunningApart]:
    """Run a station while the block runs, with its fronts in a process of their own.

    Args:
        settings: What it needs to know.
        with_console: Serve the console, too.
        with_rosbridge: Serve rosbridge.
        virtual: The virtual aircraft to use with ``sim``; by default one that stands ready.

    Raises:
        UsageError, PortBusy, PortFailed: Something in the settings cannot be, or a port is taken.
    """
    front_settings(settings)
    settings.niceness()  # both before anything is bound
    async with AsyncExitStack() as stack:
        sockets = open_sockets(
            stack, settings, with_console=with_console, with_rosbridge=with_rosbridge
        )
        owner = await stack.enter_async_context(owning(settings, virtual))
        directory = stack.enter_context(private_directory())
        agent_path = directory / "agent.sock"
        await stack.enter_async_context(serve_unix(agent_path, owner.service.attach))
        orders = {}
        if owner.virtual is not None and with_console:
            server = CtlServer([owner.virtual], directory / "orders.sock")
            await server.start()
            stack.push_async_callback(server.stop)
            orders[ONLY_NAME] = server.path
        note = owner.agent.journal.note
        front = front_process(settings, sockets, {ONLY_NAME: agent_path}, orders, note)
        await stack.enter_async_context(kept(front))
        # Before the child is waited for: one that hangs must not fly on until its lease ends.
        stack.callback(owner.service.close)
        yield RunningApart(owner, front, sockets)


async def _ended(task: asyncio.Task[None]) -> None:
    task.cancel()
    with suppress(asyncio.CancelledError):
        await task
