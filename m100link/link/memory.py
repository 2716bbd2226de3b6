"""A cable inside the process: two transports, what one writes the other's protocol receives."""

from __future__ import annotations

import asyncio
from typing import Any

_HIGH_WATER = 65_536


class MemoryTransport(asyncio.Transport):
    """One end of an in-memory cable.

    Bytes arrive on the next pass of the event loop, in order. A receiver that pauses reading makes
    the writer's ``pause_writing`` fire at 64 KiB, like a socket would.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, protocol: asyncio.Protocol) -> None:
        super().__init__()
        self._loop = loop
        self._protocol = protocol
        self._peer: MemoryTransport | None = None
        self._inbox = bytearray()
        self._is_reading = True
        self._is_closing = False
        self._is_delivering = False
        self._has_paused_peer = False

    def join(self, peer: MemoryTransport) -> None:
        """Plug the two ends together and tell both protocols."""
        self._peer, peer._peer = peer, self
        for end in (self, peer):
            self._loop.call_soon(end._protocol.connection_made, end)

    def get_protocol(self) -> asyncio.BaseProtocol:
        """The protocol of this end."""
        return self._protocol

    def set_protocol(self, protocol: asyncio.BaseProtocol) -> None:
        """Replace the protocol of this end."""
        assert isinstance(protocol, asyncio.Protocol)
        self._protocol = protocol

    def write(self, data: bytes | bytearray | memoryview[Any]) -> None:
        """Send; silently nothing once either end is closed, like a socket's transport."""
        peer = self._peer
        if self._is_closing or peer is None or peer._is_closing:
            return
        peer._inbox += data
        peer._schedule()
        if len(peer._inbox) > _HIGH_WATER and not peer._has_paused_peer:
            peer._has_paused_peer = True
            self._protocol.pause_writing()

    def _schedule(self) -> None:
        if self._is_reading and not self._is_delivering and self._inbox:
            self._is_delivering = True
            self._loop.call_soon(self._deliver)

    def _deliver(self) -> None:
        self._is_delivering = False
        if self._is_closing or not self._is_reading or not self._inbox:
            return
        data = bytes(self._inbox)
        self._inbox.clear()
        if self._has_paused_peer and self._peer is not None:
            self._has_paused_peer = False
            self._peer._protocol.resume_writing()
        self._protocol.data_received(data)

    def get_write_buffer_size(self) -> int:
        """Bytes that the other end has not taken yet."""
        return len(self._peer._inbox) if self._peer is not None else 0

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        """Accepted and ignored: the limit is fixed."""

    def pause_reading(self) -> None:
        """Stop delivering."""
        self._is_reading = False

    def resume_reading(self) -> None:
        """Go on delivering."""
        self._is_reading = True
        self._schedule()

    def is_reading(self) -> bool:
        """Whether bytes are delivered."""
        return self._is_reading

    def is_closing(self) -> bool:
        """Whether this end is closed."""
        return self._is_closing

    def close(self) -> None:
        """Unplug; both protocols get ``connection_lost(None)``."""
        self.break_off(None)

    def abort(self) -> None:
        """The same as :meth:`close`: nothing is buffered on the writing side."""
        self.break_off(None)

    def break_off(self, error: Exception | None) -> None:
        """Unplug with an error that this end's protocol sees, as when a cable is pulled."""
        for end, reason in ((self, error), (self._peer, error)):
            if end is not None and not end._is_closing:
                end._is_closing = True
                self._loop.call_soon(end._protocol.connection_lost, reason)


def connect_in_memory(first: asyncio.Protocol, second: asyncio.Protocol) -> MemoryTransport:
    """Join two protocols by a cable in memory; returns the first one's transport.

    ``connection_made`` of both is called on the next pass of the running loop.
    """
    loop = asyncio.get_running_loop()
    here, there = MemoryTransport(loop, first), MemoryTransport(loop, second)
    here.join(there)
    return here
