"""The other end of a link, for tests: answers what and when the test says."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from m100link.link import Link, MemoryTransport, connect_in_memory
from m100link.wire import Frame

Handler = Callable[["Peer", Frame], None]


def echo(peer: Peer, frame: Frame) -> None:
    """Acknowledge with the data of the command."""
    peer.link.acknowledge(frame, b"ack of " + frame.data)


def silent(peer: Peer, frame: Frame) -> None:
    """Do nothing."""


class Peer:
    """A link that plays the aircraft, and what it received."""

    def __init__(self, handler: Handler = echo) -> None:
        self.received: list[Frame] = []
        self.handler = handler
        self.link = Link(on_received=self._on_received, first_sequence=0)

    def _on_received(self, frame: Frame, now: float) -> None:
        self.received.append(frame)
        if frame.session:
            self.handler(self, frame)

    @property
    def data(self) -> list[bytes]:
        """Data of the frames received."""
        return [frame.data for frame in self.received]


async def connected(
    handler: Handler = echo, *, link: Link | None = None
) -> tuple[Link, Peer, MemoryTransport]:
    """A link, its peer, and the link's end of the cable between them."""
    peer = Peer(handler)
    link = link or Link(first_sequence=0)
    transport = connect_in_memory(link, peer.link)
    await link.wait_connected()
    await peer.link.wait_connected()
    return link, peer, transport


async def settle() -> None:
    """Let everything happen that needs no time."""
    for _ in range(20):
        await asyncio.sleep(0)
