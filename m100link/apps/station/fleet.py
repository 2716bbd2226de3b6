"""Both ends of a fleet: agents that own aircraft, and the console over them."""

from __future__ import annotations

import asyncio
import logging
import shutil
import time
from collections.abc import (
    AsyncIterator,
    Callable,
    Collection,
    Coroutine,
    Iterable,
    Mapping,
    Sequence,
)
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.messages import Event
from m100link.apps.agent.orders import Right
from m100link.apps.agent.transports import Channel, memory_channels
from m100link.apps.bus.network import Bus
from m100link.apps.fleet.agent import FleetAgent, Verify
from m100link.apps.fleet.carrier import FleetChannel
from m100link.apps.fleet.client import Fleet, open_fleet
from m100link.apps.fleet.identity import nobody
from m100link.apps.fleet.keys import DEFAULT_SITE, Keys, check_name, in_order
from m100link.apps.fleet.logs.service import RATE, LogService
from m100link.apps.fleet.lost_link import LostLinkPlan
from m100link.apps.fleet.order_log import AuditLog, FileOrderLog, MemoryOrderLog, OrderLog
from m100link.apps.fleet.publisher import StatePublisher
from m100link.apps.fleet.revocations import Revocations, RevocationService
from m100link.apps.fleet.show.service import Beside, ShowService
from m100link.apps.fleet.signing import Seal
from m100link.apps.station.config import Settings
from m100link.apps.station.listeners import (
    Fronts,
    beside,
    keep_reached,
    open_sockets,
    serving_fronts,
)
from m100link.apps.station.run import owning
from m100link.errors import LinkError, M100Error, OutOfResources, Unreachable, UsageError
from m100link.log.folder import state_folder

# -- agents of a fleet, in one process -------------------------------------------------------------

_logger = logging.getLogger(__name__)


def default_order_logs() -> Path:
    """The folder of order logs, in the user's folder for the state of programs."""
    return state_folder() / "fleet"


def recorded_apart(settings: Settings, name: str) -> Settings:
    """The settings with a folder of its own for the logs of this aircraft.

    A client that may watch one aircraft may fetch its logs, and those of no other.
    """
    if settings.record is None:
        return settings
    return replace(settings, record=settings.record / check_name(name))


@dataclass(frozen=True)
class FleetSettings:
    connect: tuple[str, ...] = ()  # endpoints of routers
    site: str = DEFAULT_SITE
    # The end of a flight whose client is lost.
    lost: LostLinkPlan = field(default_factory=LostLinkPlan)
    # Folder of what outlives an agent; None: nothing does, as for virtual aircraft.
    order_logs: Path | None = None
    options: dict[str, str] = field(default_factory=dict)  # more options of zenoh, by name, as JSON
    seals: dict[str, Seal] = field(default_factory=dict)  # by which aircraft sign what they say
    verify: Verify | None = None  # looks at each order; None: the router alone decides who may ask
    # Whose certificates are believed, and who is shut out, whatever the fleet file says.
    revocations: Revocations | None = None
    log_rate: float = RATE  # bytes of flight logs a second that each aircraft gives away at most


@asynccontextmanager
async def serving_fleet(
    aircraft: Mapping[str, Settings],
    fleet: FleetSettings,
    tell: Callable[[str, Event], None],  # called with the name and each event
    place: int = 0,  # of the first virtual aircraft in a row of several
) -> AsyncIterator[dict[str, FleetAgent]]:
    """Own aircraft and be part of a fleet while the block runs.

    Raises ``UsageError``: a name is bad or taken, an order log not writable, no session can be.
    """
    keys = {name: Keys(fleet.site, name) for name in aircraft}  # before anything is opened
    async with AsyncExitStack() as stack:
        bus = await stack.enter_async_context(
            open_fleet(
                "client",
                connect=fleet.connect,
                options=fleet.options,
                is_patient=True,
                seals=fleet.seals,
                authority=fleet.revocations,
            )
        )
        agents = {}
        for number, (name, settings) in enumerate(aircraft.items(), place):
            agents[name] = await _agent(stack, settings, number, keys[name], bus, fleet)
            await agents[name].require_alone()
            for event in agents[name].client.events:
                tell(name, event)
            agents[name].client.on_event.append(partial(tell, name))
        others = Beside()
        served = {
            f"m100link fleet {what}: {name}": work
            for name, one in agents.items()
            for what, work in _services(one, bus, keys[name], aircraft[name], fleet, others).items()
        }
        owned = {f"m100link fleet: {name}": one.run() for name, one in agents.items()}
        async with beside(owned | served):
            yield agents


def _services(
    one: FleetAgent, bus: Bus, keys: Keys, settings: Settings, fleet: FleetSettings, others: Beside
) -> dict[str, Coroutine[Any, Any, None]]:
    verify, revocations = fleet.verify, fleet.revocations
    folder = None if settings.no_record else settings.record
    more: dict[str, Any] = {"verify": verify, "names": one.duplicates, "beside": others}
    more["note"] = one.note_order
    show = ShowService(one.client, bus, keys, one.boot, **more)
    served: dict[str, Coroutine[Any, Any, None]] = {
        "fronts": StatePublisher(one.client, bus, keys, one.boot).run(),
        "show": show.run(),
        "logs": LogService(
            bus, keys, folder, verify=verify, rate=fleet.log_rate, audit=one.audit
        ).run(),
    }
    if revocations is not None:
        shut_out = (one.shut_out, lambda: show.shut_out(revocations.since))
        served["revoked"] = RevocationService(
            bus, keys, one.boot, revocations, shut_out=shut_out, note=one.client.note
        ).run()
    return served


def _order_log(stack: AsyncExitStack, fleet: FleetSettings, keys: Keys) -> OrderLog:
    if fleet.order_logs is None:
        return MemoryOrderLog()
    order_log = FileOrderLog(fleet.order_logs / keys.site / f"{keys.name}.jsonl", time.time)
    stack.callback(order_log.close)
    return order_log


async def _agent(
    stack: AsyncExitStack,
    settings: Settings,
    place: int,
    keys: Keys,
    bus: Bus,
    fleet: FleetSettings,
) -> FleetAgent:
    order_log = _order_log(stack, fleet, keys)
    owner = await stack.enter_async_context(
        owning(settings, place=place, leases_before=order_log.leases_before)
    )
    ours, its = memory_channels()
    owner.service.attach(its)
    client = await stack.enter_async_context(AgentClient(ours, "fleet"))
    revoked = nobody if fleet.revocations is None else fleet.revocations.since
    kept = [fleet.order_logs, None if settings.no_record else settings.record]
    disks = partial(room, [folder for folder in kept if folder is not None])
    more: dict[str, Any] = {"lost": fleet.lost, "verify": fleet.verify, "revoked": revoked}
    if seal := fleet.seals.get(keys.name):
        kept_at = fleet.order_logs and fleet.order_logs / keys.site / f"{keys.name}.audit"
        more["audit"] = AuditLog(kept_at, seal.audit, time.time)
        stack.push_async_callback(more["audit"].flush)
    return FleetAgent(client, bus, keys, order_log, disks=disks, **more)


FULL_MB, SCARCE_MB = 1, 50
"""Megabytes below which a disk counts as full, and below which a flight has no room for its log."""


def room(folders: Iterable[Path]) -> M100Error | None:
    """The error for a disk without room for order logs or flight logs; None for enough."""
    for folder in folders:
        there = next(one for one in (folder, *folder.parents) if one.is_dir())
        try:
            left = shutil.disk_usage(there).free / 1e6
        except OSError as error:
            return OutOfResources(f"{there} cannot be read: {error.strerror}", remedy="check it")
        if left < SCARCE_MB:
            what = "full disk" if left < FULL_MB else "no log space"
            return OutOfResources(
                f"{what}: {left:.0f} MB are left for {folder}",
                cause="an hour of flight writes ten to forty megabytes",
                remedy="remove old flight logs there, or name a folder of another disk",
            )
    return None


# -- the console over a fleet ----------------------------------------------------------------------
# It owns no aircraft. Each is reached over the network, and what is steered here flies there, under
# the lease and the guards of its own agent: a page that hangs, this process killed or a network cut
# are a hover on board.

MOST_SHIPS = 60  # aircraft of one console; a wall of more is ``m100link fleet monitor``

_LOOK_S = 0.5
_COME_S = 2.0


class Ships:
    """The aircraft of a console, each by the newest way to it."""

    def __init__(self, fleet: Fleet, stack: AsyncExitStack) -> None:
        self._fleet, self._stack = fleet, stack
        # The agents by name; another one may stand there from the beginning.
        self.agents: dict[str, AgentClient] = {}
        self._channels: dict[str, FleetChannel] = {}
        self._unused: dict[str, FleetChannel] = {}

    async def first(self, names: Sequence[str]) -> str:
        """The first of these that answers. Raises ``LinkError``: none does."""
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
        """A way to one. Raises ``LinkError``: it does not answer."""
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
        await asyncio.gather(*(one.let_go() for one in self._channels.values()))


async def names_of(fleet: Fleet, names: Sequence[str] = ()) -> list[str]:
    """Whom a console is to show.

    Raises ``Unreachable``: one that was named is not there. Raises ``UsageError``: nobody is there,
    or there are too many. Raises ``NotAllowed``: as :meth:`Asker.require`.
    """
    for name in names:
        fleet.asker(name).require(Right.WATCH)
    there = await fleet.names()
    missing = [name for name in names if name not in there]
    if missing:
        raise Unreachable(
            f"no agent named {', '.join(missing)} is there",
            remedy=f"there are: {', '.join(there) or 'none'}",
        )
    if not there:
        raise UsageError(
            f"there is no agent at site {fleet.keys.site}",
            remedy="start one: m100link fleet agent sim:// --name a1",
        )
    shown = list(dict.fromkeys(names or there))
    if len(shown) > MOST_SHIPS:
        raise UsageError(
            f"{len(shown)} aircraft are too many for one console",
            remedy=f"name up to {MOST_SHIPS}, or watch all by: m100link fleet monitor",
        )
    return shown


@asynccontextmanager
async def serving_fleet_console(
    fleet: Fleet, settings: Settings, names: Sequence[str] = ()
) -> AsyncIterator[Fronts]:
    """Serve while the block runs.

    Raises ``Unreachable, UsageError, NotAllowed``: as :func:`names_of`; something in the settings
    cannot be. Raises ``PortBusy, PortFailed``: the port is taken, or the address cannot be bound.
    Raises ``LinkError``: none of them answers.
    """
    there = await names_of(fleet, names)
    settings.access_token()  # before anything is bound
    async with AsyncExitStack() as stack, AsyncExitStack() as before:
        ships = Ships(fleet, stack)
        before.push_async_callback(ships.let_go)  # while there are ways: some come while this runs
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

        async with beside({"m100link console: come": come(), "m100link console: look": look()}):
            yield fronts
