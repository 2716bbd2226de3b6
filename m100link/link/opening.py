"""Opening a line."""

from __future__ import annotations

from collections.abc import Callable

from m100link.errors import LinkError
from m100link.link.link import Link, ignore
from m100link.link.tap import Tap, TappedProtocol
from m100link.link.transport import open_transport
from m100link.link.url import ConnectionString, parse_url
from m100link.wire.frame import Frame

__all__ = ["open_link"]


async def open_link(
    url: str | ConnectionString,
    *,
    baud_rate: int | None = None,
    on_received: Callable[[Frame, float], None] = ignore,
    on_lost: Callable[[LinkError], None] = ignore,
    first_sequence: int | None = None,
    tap: Tap | None = None,
) -> Link:
    """Open a line and return the link on it.

    Args:
        url: Connection string, see :func:`~m100link.link.url.parse_url`.
        baud_rate: Rate when the string has none.
        on_received: See :class:`Link`.
        on_lost: See :class:`Link`.
        first_sequence: See :class:`Link`.
        tap: Called with every read and write, see :data:`~m100link.link.Tap`.

    Raises:
        BadURL, PortNotFound, PortPermissionDenied, PortBusy, PortFailed: See each class.
    """
    address = url if isinstance(url, ConnectionString) else parse_url(url, baud_rate=baud_rate)
    link = Link(on_received=on_received, on_lost=on_lost, first_sequence=first_sequence)
    link.name = str(address)
    protocol = link if tap is None else TappedProtocol(link, tap, link.loop.time)
    transport = await open_transport(address, protocol)
    try:
        await link.wait_connected()
    except BaseException:
        transport.abort()
        await link.wait_disconnected()  # whoever opens it next finds it free
        raise
    return link
