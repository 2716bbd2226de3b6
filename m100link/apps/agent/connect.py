"""How the station reaches its aircraft: by URL, or in memory when it brings its own."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

from m100link.aircraft import Aircraft, connect
from m100link.aircraft.connecting import be_recorded
from m100link.errors import PortNotFound
from m100link.flight.guards import Envelope
from m100link.link import Link
from m100link.link.statistics import TappedProtocol
from m100link.protocol.firmware import profile
from m100link.telemetry.sample import acceleration_mode

if TYPE_CHECKING:
    from m100link.apps.agent.server.connection import Connect
    from m100link.log.folder import Flights
    from m100link.log.recorder import Recorder
    from m100link.sim.ports.driver import Driver


def envelope_of(max_height: float, max_radius: float) -> Envelope:
    """The envelope of an agent: metres above the take-off point, and from where control began.

    Raises UsageError: one of them cannot be.
    """
    return Envelope(max_height_m=max_height, max_radius_m=max_radius)


def by_url(
    url: str,
    *,
    baud_rate: int | None = None,
    firmware: str | None = None,
    timeout: float | None = None,  # seconds until an aircraft has to answer
    flights: Flights | None = None,  # where connections are recorded
    acceleration: str | None = None,  # raw or fused; by default one second at rest shows it
) -> Connect:
    """Open a connection string. A profile or a mode that there is not is a UsageError at once."""
    forced = None if firmware is None else profile(firmware)
    acceleration_mode(acceleration)

    async def opened() -> Aircraft:
        async with _recording(flights) as log:
            return await connect(
                url,
                firmware=forced,
                baud_rate=baud_rate,
                timeout=timeout,
                record=log,
                acceleration=acceleration,
            )

    return opened


def by_driver(
    driver: Driver, *, timeout: float | None = None, flights: Flights | None = None
) -> Connect:
    """Plug into a virtual aircraft of this process; it outlives the connection."""

    async def plugged_in() -> Aircraft:
        link = Link()
        async with _recording(flights) as log:
            try:
                driver.connect(link if log is None else TappedProtocol(link, log.tap, link.clock))
            except ConnectionRefusedError as error:
                raise PortNotFound(str(error), remedy="plug it in again") from error
            await link.wait_connected()
            link.name = "sim://"
            aircraft = await connect(link, timeout=timeout)
            if log is not None:
                be_recorded(aircraft, log)
            return aircraft

    return plugged_in


@asynccontextmanager
async def _recording(flights: Flights | None) -> AsyncIterator[Recorder | None]:
    """A log for what is connected meanwhile; attempts that fail leave none."""
    log = None if flights is None else await flights.begin()
    try:
        yield log
    except BaseException:
        if flights is not None and log is not None:
            await log.aclose()
            # In a thread: another aircraft may fly in this event loop, and a disk take its time.
            await asyncio.to_thread(flights.drop, log)
        raise
    if flights is not None and log is not None:
        flights.keep(log)
