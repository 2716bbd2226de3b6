"""The console over a fleet: a page on the ground for aircraft that are elsewhere.

It owns no aircraft. Each is reached over the network, and what is steered here flies there, under
the lease and the guards of its own agent: a page that hangs, this process killed or a network cut
are a hover on board.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Collection, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from functools import partial

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.transports import Channel
from m100link.apps.fleet.carrier import FleetChannel
from m100link.apps.fleet.client import Fleet
from m100link.apps.fleet.keys import in_order
from m100link.apps.station.config import Settings
from m100link.apps.station.fronts import Fronts, Sockets, keep_reached, open_sockets, serving_fronts
from m100link.errors import LinkError, Unreachable, UsageError

__all__ = ["MOST_SHIPS", "FleetConsole", "Ships", "names_of", "serving_fleet_console"]

MOST_SHIPS = 60
"""Aircraft of one console; a wall of more is ``m100link fleet monitor``."""

_LOOK_S = 0.5
_COME_S = 2.0

_logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class FleetConsole:
    """A console that serves.

    Attributes:
        fronts: What browsers reach.
        sockets: Where.
    """

    fronts: Fronts
    sockets: Sockets

    @property
    def names(self) -> list[str]:
        """Aircraft that it shows."""
        return list(self.fronts.agents)

    @property
    def console_port(self) -> int:
        """Where browsers reach it."""
        port = self.sockets.console_port
        assert port is not None, "it was opened with one"
        return port


class Ships:
    """The aircraft of a console, each by the newest way to it.

    Args:
        fleet: The fleet.
        stack: Ends what is opened here.

    Attributes:
        agents: What is known of each, by name; another one may stand there from the beginning.
    """

    def __init__(self, fleet: Fleet, stack: AsyncExitStack) -> None:
        self._fleet, self._stack = fleet, stack
        self.agents: dict[str, AgentClient] = {}
        self._channels: dict[str, FleetChannel] = {}
        self._unused: dict[str, FleetChannel] = {}

    async def first(self, names: Sequence[str]) -> str:
        """The first of these that answers.

        Raises:
            LinkError: None does.
        """
        for name in names:
            try:
                self._unused[name] = await self._fleet.reach(name)
            except LinkError as error:
                if name == names[-1]:
                    raise
                _logger.warning("%s", error.seen)
            else:
                break
        return name

    async def reach(self, name: str) -> Channel:
        """A way to one.

        Raises:
            LinkError: It does not answer.
        """
        channel = self._unused.pop(name, None) or await self._fleet.reach(name)
        self._channels[name] = channel
        return channel

    async def show(self, name: str) -> None:
        """Show one more, if it answers; one that does not may be tried again."""
        if name in self.agents or len(self.agents) >= MOST_SHIPS:
            return
        try:
            agent = AgentClient(await self.reach(name), "console")
        except LinkError as error:
            _logger.warning("not shown: %s", error.seen)
            return
        self.agents[name] = await self._stack.enter_async_context(agent)
        agent.background.spawn(keep_reached(agent, partial(self.reach, name)), f"way to {name}")

    def look(self, shown: Collection[str]) -> None:
        """These are looked at: they come at their full rate, the rest as for a wall."""
        for name, channel in self._channels.items():
            channel.watch(full=name in shown)

    async def let_go(self) -> None:
        """Give back whatever was granted here."""
        await asyncio.gather(*(one.let_go() for one in self._channels.values()))


async def names_of(fleet: Fleet, names: Sequence[str] = ()) -> list[str]:
    """Whom a console is to show.

    Args:
        fleet: The fleet.
        names: Those that were asked for; none for all that are there.

    Raises:
        Unreachable: One that was named is not there.
        UsageError: Nobody is there, or there are too many.
    """
    there = await fleet.names()
    missing = [name for name in names if name not in there]
    if missing:
        raise Unreachable(
            f"no agent named {', '.join(missing)} is there",
            remedy=f"there are: {', '.join(there) or 'none'}",
        )
    if not there:
        raise UsageError(
            f"no agent is there at site {fleet.keys.site}",
            remedy="start one: m100link fleet agent sim:// --name a1",
        )
    shown = list(dict.fromkeys(names or there))
    if len(shown) > MOST_SHIPS:
        raise UsageError(
            f"{len(shown)} aircraft are too many for one console",
            remedy=f"name up to {MOST_SHIPS}, or look at all by: m100link fleet monitor",
        )
    return shown


@asynccontextmanager
async def serving_fleet_console(
    fleet: Fleet, settings: Settings, names: Sequence[str] = ()
) -> AsyncIterator[FleetConsole]:
    """Serve while the block runs.

    Args:
        fleet: The fleet.
        settings: Who may connect.
        names: Which aircraft; by default those that are there, and whoever comes.

    Raises:
        Unreachable, UsageError: As :func:`names_of`; something in the settings cannot be.
        PortBusy, PortFailed: The port is taken, or the address cannot be bound.
        LinkError: None of them answers.
    """
    there = await names_of(fleet, names)
    settings.access_token()  # before anything is bound
    async with AsyncExitStack() as stack:
        ships = Ships(fleet, stack)
        sockets = open_sockets(stack, settings, with_console=True, with_rosbridge=False)
        first = await ships.first(there)
        fronts = await stack.enter_async_context(
            serving_fronts(settings, sockets, {first: partial(ships.reach, first)}, {}, is_far=True)
        )
        ships.agents = fronts.agents
        for name in there:
            await ships.show(name)

        async def come() -> None:
            while True:
                for name in in_order(names or fleet.present):
                    await ships.show(name)
                await asyncio.sleep(_COME_S)

        async def look() -> None:
            while True:
                ships.look(fronts.shown())
                await asyncio.sleep(_LOOK_S)

        async with asyncio.TaskGroup() as group:
            working = [group.create_task(come()), group.create_task(look())]
            try:
                yield FleetConsole(fronts, sockets)
            finally:
                for one in working:
                    one.cancel()
                await ships.let_go()  # while there are ways
