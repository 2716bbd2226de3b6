"""A station for as long as a block runs: the agents that own aircraft, and their fronts.

What ``m100link serve`` runs is :func:`running_apart`, or :func:`running_several` for more than one
aircraft: one process flies, and another one talks to strangers. :func:`running` has both in one
event loop, for tests and for looking into it.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from m100link.apps.agent import transports
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.messages import Event
from m100link.apps.agent.server.agent import Agent
from m100link.apps.agent.server.connection import Connect, by_driver, by_url, envelope_of
from m100link.apps.agent.server.replays import Replays
from m100link.apps.agent.server.server import AgentServer
from m100link.apps.station.config import ONLY_NAME, Settings
from m100link.apps.station.listeners import (
    FRONTS,
    Fronts,
    Sockets,
    keep_reached,
    open_sockets,
    serving_fronts,
)
from m100link.apps.station.supervisor import BegunFronts, ChildProcess, as_json, supervised
from m100link.errors import UsageError
from m100link.geodesy import LocalFrame
from m100link.log.folder import Flights, default_folder
from m100link.protocol.commands.activation import Credentials
from m100link.protocol.firmware import FIRMWARE_1_0
from m100link.sim.orders import CtlServer, orders_in_process
from m100link.sim.ports.driver import Driver
from m100link.sim.vehicle.activation import DEMO_APP_ID, DEMO_KEY
from m100link.sim.vehicle.settings import AircraftSettings
from m100link.sim.virtual import VirtualAircraft

if TYPE_CHECKING:
    from m100link.apps.station.web.server import RosbridgeServer


END_TIMEOUT = 15.0  # seconds that an agent has to give control authority back and end

_FOR_AGENTS = (
    *("url", "baud_rate", "firmware", "timeout", "acceleration", "sim"),
    *("app_id", "key", "key_file", "level"),
    *("app_version", "bundle_id", "max_height", "max_radius"),
    *("record", "no_record", "record_keep", "record_keep_mb"),
)

Tell = Callable[[str, Event], None]

BESIDE = 10.0  # metres to the east from one virtual aircraft of a station to the next


@dataclass(frozen=True, slots=True)
class AgentProcess:
    agent: Agent  # the aircraft and its lease
    service: AgentServer  # what serves fronts
    virtual: VirtualAircraft | None  # the virtual aircraft that it brought, or None


def _virtual(credentials: Credentials | None, firmware: str | None, place: int) -> VirtualAircraft:
    settings = AircraftSettings(noise=1.0)
    if place:
        first = LocalFrame(settings.latitude_deg, settings.longitude_deg)
        latitude, longitude = first.to_geodetic(0.0, BESIDE * place)
        settings = replace(settings, latitude_deg=latitude, longitude_deg=longitude)
    firmware = firmware or FIRMWARE_1_0.name  # what forces a real one chooses this one
    known: dict[str, Any] = {}
    if credentials is not None:
        known = {name: getattr(credentials, name) for name in ("app_id", "key", "level")}
    return VirtualAircraft(firmware=firmware, settings=settings, **known)


def _flights(settings: Settings, tell: Callable[[str, str], None]) -> Flights | None:
    """Where connections are recorded; None for nowhere."""
    if settings.record is None or settings.no_record:
        return None
    # In a folder of theirs nothing is removed. In ours an aircraft of a fleet has its own.
    is_ours = default_folder() in (settings.record, settings.record.parent)
    keep, keep_mb = (settings.record_keep, settings.record_keep_mb) if is_ours else (0, 0)
    return Flights(settings.record, keep=keep, keep_mb=keep_mb, tell=tell)


@asynccontextmanager
async def owning(
    settings: Settings,
    virtual: VirtualAircraft | None = None,
    *,
    place: int = 0,  # where a virtual aircraft stands in the row of several
    leases_before: int = 0,  # number of the last lease that another process may have granted
) -> AsyncIterator[AgentProcess]:
    """Own the aircraft while the block runs.

    Raises ``UsageError, BadKey``: something in the settings cannot be.
    """
    credentials = settings.credentials()

    def tell(text: str, level: str) -> None:
        agent.journal.note(text, level)

    flights = _flights(settings, tell)
    async with AsyncExitStack() as stack:
        replay: Replays | None = None
        if settings.url is not None and settings.is_replay:
            credentials, flights = None, None
            replay = Replays(settings.url, settings.firmware)
            await replay.look()
            connect: Connect = replay.connect
        elif settings.sim:
            virtual = virtual or _virtual(credentials, settings.firmware, place)
            credentials = virtual.credentials
            driver = Driver(virtual)
            driver.start()
            stack.callback(driver.stop)
            connect = by_driver(driver, flights=flights)
        elif settings.url is not None:
            if settings.url.startswith("sim:") and credentials is None:
                credentials = Credentials(DEMO_APP_ID, DEMO_KEY)  # those that it knows
            connect = by_url(
                settings.url,
                baud_rate=settings.baud_rate,
                firmware=settings.firmware,
                timeout=settings.timeout,
                flights=flights,
                acceleration=settings.acceleration,
            )
        else:
            raise UsageError(
                "no aircraft was named",
                remedy="give its URL, sim:// for a virtual one, or set M100LINK_URL",
            )
        agent = await stack.enter_async_context(
            Agent(
                connect,
                credentials=credentials,
                envelope=envelope_of(settings.max_height, settings.max_radius),
                leases_before=leases_before,
                replay=replay,
            )
        )
        service = AgentServer(agent)
        stack.callback(service.close)
        yield AgentProcess(agent, service, virtual)


# -- in one event loop -----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class RunningStation:
    """A station that runs in one event loop: to look into it, not to fly."""

    agent: Agent  # the aircraft and its lease
    virtual: VirtualAircraft | None  # the virtual aircraft that it brought, or None
    fronts: Fronts  # what strangers reach
    sockets: Sockets  # where

    @property
    def has_authority(self) -> bool:
        return self.agent.holding.has_authority

    @property
    def bridge(self) -> RosbridgeServer:
        return cast("RosbridgeServer", self.fronts.made["rosbridge"])

    def console_path(self) -> str:
        return self.fronts.console_path()


@asynccontextmanager
async def running(
    settings: Settings,
    *,
    with_console: bool = False,
    with_rosbridge: bool = True,
    virtual: VirtualAircraft | None = None,
) -> AsyncIterator[RunningStation]:
    """Run a station in this event loop while the block runs.

    Raises ``UsageError, PortBusy, PortFailed``: something in the settings cannot be, or a port is
    taken.
    """
    settings.access_token()  # before anything is bound
    async with AsyncExitStack() as stack:
        sockets = open_sockets(
            stack, settings, with_console=with_console, with_rosbridge=with_rosbridge
        )
        for name in sockets.of:
            FRONTS[name].load()  # takes a second, in which a connected aircraft hears nothing
        owner = await stack.enter_async_context(owning(settings, virtual))

        async def reach() -> transports.Channel:
            ours, its = transports.memory_channels()
            owner.service.attach(its)
            return ours

        orders = {}
        if owner.virtual is not None:
            orders[ONLY_NAME] = orders_in_process(owner.virtual)
        fronts = await stack.enter_async_context(
            serving_fronts(settings, sockets, {ONLY_NAME: reach}, orders)
        )
        yield RunningStation(owner.agent, owner.virtual, fronts, sockets)


# -- in two processes ------------------------------------------------------------------------------
# This process owns the port, control authority, the lease and the log, and listens to nobody but
# its fronts, behind a Unix socket in a private directory. The fronts run in a child at a lower
# priority. A child that hangs or dies costs a hover.


@dataclass(frozen=True, slots=True)
class RunningTwoProcess:
    agent: Agent  # the aircraft and its lease, in this process
    virtual: VirtualAircraft | None  # the virtual aircraft that it brought, or None
    front: ChildProcess  # the other process
    sockets: Sockets  # where the fronts listen

    @property
    def has_authority(self) -> bool:
        return self.agent.holding.has_authority

    def console_path(self) -> str:
        return str(self.front.answer["console_path"])


def _reached(agents: Mapping[str, Path], orders: Mapping[str, Path]) -> dict[str, Any]:
    """Where each agent serves and each virtual aircraft takes orders, by the aircraft's name."""
    return {"agents": as_json(agents), "orders": as_json(orders)}


@asynccontextmanager
async def running_apart(
    settings: Settings, fronts: BegunFronts, *, virtual: VirtualAircraft | None = None
) -> AsyncIterator[RunningTwoProcess]:
    """Run a station while the block runs; ``UsageError``: something in the settings cannot be."""
    sockets, front = fronts
    async with AsyncExitStack() as stack:
        directory = stack.enter_context(transports.private_directory())

        def note(text: str, level: str) -> None:
            owner.agent.journal.note(text, level)

        front.note = note
        owner = await stack.enter_async_context(owning(settings, virtual))
        agent_path = directory / "agent.sock"
        await stack.enter_async_context(transports.serve_unix(agent_path, owner.service.attach))
        orders = {}
        if owner.virtual is not None and "console" in sockets.of:
            orders[ONLY_NAME] = directory / "orders.sock"
            server = CtlServer([owner.virtual], orders[ONLY_NAME])
            await server.start()
            stack.push_async_callback(server.stop)
        front.request |= _reached({ONLY_NAME: agent_path}, orders)
        await stack.enter_async_context(supervised(front))
        # Before the child is waited for: one that hangs must not fly on until its lease ends.
        stack.callback(owner.service.close)
        yield RunningTwoProcess(owner.agent, owner.virtual, front, sockets)


# -- several aircraft ------------------------------------------------------------------------------
# A process for each, one for all fronts, and this one over them, which owns no aircraft and serves
# nobody. It starts again whichever ends, and tells what happens. An agent that dies or hangs costs
# its own aircraft a hover, and the others nothing; the fronts find the next one by themselves.


@dataclass(frozen=True, slots=True)
class RunningMultiVehicle:
    owners: Mapping[str, ChildProcess]  # the process that owns an aircraft, by its name
    agents: Mapping[str, AgentClient]  # by name
    front: ChildProcess  # the process of the fronts
    sockets: Sockets  # where the fronts listen

    @property
    def has_authority(self) -> bool:
        """Whether one of the aircraft obeys this station, as far as is known here."""
        return any(agent.has_authority for agent in self.agents.values())

    def console_path(self) -> str:
        return str(self.front.answer["console_path"])


def agent_settings(settings: Settings) -> dict[str, Any]:
    """The settings for an agent, as JSON takes it: nothing of access control."""
    found = {one.name: getattr(settings, one.name) for one in fields(settings)}
    return as_json({name: found[name] for name in _FOR_AGENTS})


@asynccontextmanager
async def running_several(
    aircraft: Mapping[str, Settings],
    fronts: BegunFronts,
    *,
    tell: Tell = lambda *_: None,  # called with the name of an aircraft and each of its events
) -> AsyncIterator[RunningMultiVehicle]:
    """Run a station while the block runs; ``UsageError``: something in the settings cannot be."""
    sockets, front = fronts
    async with AsyncExitStack() as stack:
        directory = stack.enter_context(transports.private_directory())
        agents: dict[str, AgentClient] = {}

        def note(name: str, text: str, level: str) -> None:
            # Without an agent there is nobody to keep it: reported here alone.
            agent = agents.get(name)
            if agent is None or agent.is_gone:
                tell(name, Event(0, asyncio.get_running_loop().time(), level, text))
            else:
                agent.note(text, level)

        owners = {
            name: _owner(name, place, one, directory, partial(note, name))
            for place, (name, one) in enumerate(aircraft.items())
        }

        def note_all(text: str, level: str) -> None:
            for name in agents:
                note(name, text, level)

        front.note = note_all
        await stack.enter_async_context(supervised(*owners.values(), timeout=END_TIMEOUT))
        paths = {name: _path(directory, place) for place, name in enumerate(aircraft)}
        for name, path in paths.items():
            reach = partial(transports.connect_unix, path)
            agent = AgentClient(await reach(), "the station")
            agent.on_event.append(partial(tell, name))
            agents[name] = await stack.enter_async_context(agent)
            agent.background.spawn(keep_reached(agent, reach), "agent")
        virtual = {
            name: _path(directory, place, "orders")
            for place, name in enumerate(aircraft)
            if owners[name].answer["is_virtual"]
        }
        front.request |= _reached(paths, virtual if "console" in sockets.of else {})
        await stack.enter_async_context(supervised(front))
        yield RunningMultiVehicle(owners, agents, front, sockets)


def _path(directory: Path, place: int, kind: str = "agent") -> Path:
    return directory / f"{kind}{place}.sock"


def _owner(
    name: str, place: int, settings: Settings, directory: Path, note: Callable[[str, str], None]
) -> ChildProcess:
    request = {
        "name": name,
        "settings": agent_settings(settings),
        "place": place,
        "agent": str(_path(directory, place)),
        "orders": str(_path(directory, place, "orders")),
    }
    return ChildProcess("agent", f"the agent of {name}", request, note)
