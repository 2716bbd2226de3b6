"""The socket of the bridge, the one part that touches the network."""

from __future__ import annotations

import asyncio
import errno
import ipaddress
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from urllib.parse import urlsplit

from m100link.apps.mavlink.peers import Address
from m100link.errors import PortBusy, PortFailed, UsageError

__all__ = ["bind", "is_loopback", "read_address", "serving"]

_AT_ONCE = 500
_LONGEST = 65536


def read_address(url: str) -> Address:
    """Host and port of ``udp://host:port``.

    Raises:
        UsageError: It is not one.
    """
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if host is None or port is None or not url.startswith("udp://"):
        raise UsageError(
            f"{url!r} is not an address for MAVLink", remedy="udp://127.0.0.1:14550, for example"
        )
    try:
        # A number is looked up nowhere, and a name once.
        found = socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM)[0][4][0]
    except OSError as error:
        raise UsageError(f"{host} has no address: {error.strerror or error}") from None
    return str(found), port


def is_loopback(address: Address) -> bool:
    """Whether only this machine reaches it."""
    return ipaddress.ip_address(address[0]).is_loopback


def bind(address: Address) -> socket.socket:
    """A socket for datagrams.

    Raises:
        PortBusy, PortFailed: Another program has the port, or the address cannot be bound.
    """
    one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    one.setblocking(False)
    try:
        one.bind(address)
    except OSError as error:
        one.close()
        kind = PortBusy if error.errno == errno.EADDRINUSE else PortFailed
        raise kind(
            f"{address[0]}:{address[1]} cannot be served: {error.strerror or error}",
            cause="a ground station, or another bridge, listens there" if kind is PortBusy else "",
            remedy="end it, or choose another --listen; a ground station that listens itself is "
            "reached by --to",
        ) from error
    return one


class _Datagrams(asyncio.DatagramProtocol):
    def __init__(self, bound: socket.socket, received: Callable[[bytes, Address], None]) -> None:
        self._bound = bound
        self._received = received

    def datagram_received(self, data: bytes, addr: Address) -> None:
        self._received(data, (addr[0], addr[1]))
        # The loop reads one each time it turns: in a flood the queue of the socket would be full
        # always, and the system drops what comes then, whoever sent it.
        for _ in range(_AT_ONCE):
            try:
                data, (host, port) = self._bound.recvfrom(_LONGEST)
            except OSError:
                return  # nothing waits any more, or the loop will tell
            self._received(data, (host, port))

    def error_received(self, exc: Exception) -> None:
        """Nobody listens there; that is told by heartbeats that do not come."""


@asynccontextmanager
async def serving(
    bound: socket.socket, received: Callable[[bytes, Address], None]
) -> AsyncIterator[Callable[[bytes, Address], None]]:
    """Receive while the block runs; gives what sends a datagram, and never waits.

    Args:
        bound: The socket; it stays open.
        received: Called with each datagram.
    """
    loop = asyncio.get_running_loop()
    transport, _ = await loop.create_datagram_endpoint(
        lambda: _Datagrams(bound, received), sock=bound.dup()
    )
    try:
        yield transport.sendto
    finally:
        transport.close()
