"""How the station reaches its aircraft: by URL, or in memory when it brings its own."""

from __future__ import annotations

from typing import TYPE_CHECKING

from m100link.aircraft import Aircraft, connect
from m100link.errors import PortNotFound
from m100link.flight.guards import Envelope
from m100link.link import Link
from m100link.protocol.firmware import profile

if TYPE_CHECKING:
    from m100link.agent.connection import Connect
    from m100link.sim.ports.driver import Driver

__all__ = ["by_driver", "by_url", "envelope_of"]


def envelope_of(max_height: float, max_radius: float) -> Envelope:
    """The envelope of an agent: metres above the take-off point, and from where control began.

    Raises:
        UsageError: One of them cannot be.
    """
    return Envelope(max_height_m=max_height, max_radius_m=max_radius)


def by_url(
    url: str,
    *,
    baud_rate: int | None = None,
    firmware: str | None = None,
    timeout: float = 3.0,
) -> Connect:
    """Open a connection string.

    Raises (when it is called):
        UsageError: There is no such firmware profile.
    """
    forced = None if firmware is None else profile(firmware)

    async def opened() -> Aircraft:
        return await connect(url, firmware=forced, baud_rate=baud_rate, timeout=timeout)

    return opened


def by_driver(driver: Driver, *, timeout: float = 3.0) -> Connect:
    """Plug into a virtual aircraft of this process; it outlives the connection."""

    async def plugged_in() -> Aircraft:
        link = Link()
        try:
            driver.connect(link)
        except ConnectionRefusedError as error:
            raise PortNotFound(str(error), remedy="plug it in again") from error
        await link.wait_connected()
        link.name = "sim://"
        return await connect(link, timeout=timeout)

    return plugged_in
