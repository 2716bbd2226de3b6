"""The station for as long as a block runs: the agent that owns the aircraft, and its fronts.

:func:`running` has both in one event loop, for tests and for looking into it. What ``m100link
serve`` does is in :mod:`m100link.apps.station.apart`: the fronts in a process of their own.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from m100link.apps.agent.connect import by_driver, by_url, envelope_of
from m100link.apps.agent.server.agent import Agent
from m100link.apps.agent.server.connection import Connect
from m100link.apps.agent.server.replays import Replays
from m100link.apps.agent.server.server import Service
from m100link.apps.agent.transports import Channel, memory_channels
from m100link.apps.station.config import ONLY_NAME, Settings
from m100link.apps.station.console.orders import orders_in_process
from m100link.apps.station.fronts import Fronts, Sockets, open_sockets, serving_fronts
from m100link.errors import UsageError
from m100link.geodesy import LocalFrame
from m100link.log.folder import Flights, default_folder
from m100link.protocol.commands.activation import Credentials
from m100link.protocol.firmware import FIRMWARE_1_0
from m100link.sim.ports.driver import Driver
from m100link.sim.vehicle.activation import DEMO_APP_ID, DEMO_KEY
from m100link.sim.vehicle.settings import AircraftSettings
from m100link.sim.virtual import VirtualAircraft

if TYPE_CHECKING:
    from m100link.apps.station.web.server import Bridge

__all__ = ["BESIDE", "Owner", "Running", "owning", "running"]

BESIDE = 10.0
"""Metres to the east from one virtual aircraft of a station to the next."""


@dataclass(frozen=True, slots=True)
class Owner:
    """What owns the aircraft.

    Attributes:
        agent: The aircraft and its lease.
        service: What serves fronts.
        virtual: The virtual aircraft that it brought, or None.
    """

    agent: Agent
    service: Service
    virtual: VirtualAircraft | None


@dataclass(frozen=True, slots=True)
class Running:
    """A station that runs in one event loop.

    Attributes:
        owner: What owns the aircraft.
        fronts: What strangers reach.
        sockets: Where.
    """

    owner: Owner
    fronts: Fronts
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
    def bridge(self) -> Bridge:
        """What rosbridge clients reach."""
        assert self.fronts.bridge is not None
        return self.fronts.bridge

    @property
    def virtual(self) -> VirtualAircraft | None:
        """The virtual aircraft that it brought, or None."""
        return self.owner.virtual

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
        return self.fronts.console_path()


def _virtual(credentials: Credentials | None, firmware: str | None, place: int) -> VirtualAircraft:
    settings = AircraftSettings(noise=1.0)
    if place:
        first = LocalFrame(settings.latitude_deg, settings.longitude_deg)
        latitude, longitude = first.to_geodetic(0.0, BESIDE * place)
        settings = replace(settings, latitude_deg=latitude, longitude_deg=longitude)
    firmware = firmware or FIRMWARE_1_0.name  # what forces a real one chooses this one
    if credentials is None:
        return VirtualAircraft(firmware=firmware, settings=settings)
    return VirtualAircraft(
        firmware=firmware,
        app_id=credentials.app_id,
        key=credentials.key,
        level=credentials.level,
        settings=settings,
    )


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
    place: int = 0,
    leases_before: int = 0,
) -> AsyncIterator[Owner]:
    """Own the aircraft while the block runs.

    Args:
        settings: Which aircraft, and whose app.
        virtual: The virtual aircraft to use with ``sim``; by default one that stands ready.
        place: Where a virtual aircraft stands in the row of several.
        leases_before: Number of the last lease that another process may have granted.

    Raises:
        UsageError, BadKey: Something in the settings cannot be.
    """
    credentials = settings.credentials()

    def tell(text: str, level: str) -> None:
        agent.journal.note(text, level)

    flights = _flights(settings, tell)
    async with AsyncExitStack() as stack:
        replay: Replays | None = None
        if settings.url is not None and settings.url.startswith("replay://"):
            credentials, flights = None, None
            replay = Replays(settings.url, settings.firmware, lambda text: tell(text, "info"))
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
            )
        else:
            raise UsageError(
                "no aircraft was named",
                remedy="give its URL, set M100LINK_URL, or use --sim for a virtual one",
            )
        agent = await stack.enter_async_context(
            Agent(
                connect,
                credentials=credentials,
                keep_authority=settings.keep_authority,
                envelope=envelope_of(settings.max_height, settings.max_radius),
                leases_before=leases_before,
                replay=replay,
            )
        )
        service = Service(agent)
        stack.callback(service.close)
        yield Owner(agent, service, virtual)


@asynccontextmanager
async def running(
    settings: Settings,
    *,
    with_console: bool = False,
    with_rosbridge: bool = True,
    virtual: VirtualAircraft | None = None,
) -> AsyncIterator[Running]:
    """Run a station in this event loop while the block runs.

    Args:
        settings: What it needs to know.
        with_console: Serve the console, too.
        with_rosbridge: Serve rosbridge.
        virtual: The virtual aircraft to use with ``sim``; by default one that stands ready.

    Raises:
        UsageError, PortBusy, PortFailed: Something in the settings cannot be, or a port is taken.
    """
    settings.access_token()  # before anything is bound
    async with AsyncExitStack() as stack:
        sockets = open_sockets(
            stack, settings, with_console=with_console, with_rosbridge=with_rosbridge
        )
        owner = await stack.enter_async_context(owning(settings, virtual))

        async def reach() -> Channel:
            ours, its = memory_channels()
            owner.service.attach(its)
            return ours

        virtual_one = owner.virtual
        orders = {} if virtual_one is None else {ONLY_NAME: orders_in_process(virtual_one)}
        fronts = await stack.enter_async_context(
            serving_fronts(settings, sockets, {ONLY_NAME: reach}, orders)
        )
        yield Running(owner, fronts, sockets)
