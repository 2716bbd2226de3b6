"""Both ends of a bad line, in memory or with a pseudo-terminal between."""

from __future__ import annotations

import asyncio
import os
import tty
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from random import Random
from typing import Any

from m100link.link import Link, open_link
from tests.faults.wire import Faults, Wire

__all__ = ["Line", "over_memory", "over_terminal"]

_AGAIN_S = 1e-3


class _End(asyncio.Transport):
    """A transport whose bytes go into a wire."""

    def __init__(self, link: Link) -> None:
        super().__init__()
        self._link = link
        self._is_closing = False
        self.wire: Wire

    def write(self, data: bytes | bytearray | memoryview[Any]) -> None:
        if not self._is_closing:
            self.wire.write(data)

    def receive(self, data: bytes) -> None:
        """Bytes have come out of the other direction."""
        if not self._is_closing:
            self._link.data_received(data)

    def is_closing(self) -> bool:
        return self._is_closing

    def get_write_buffer_size(self) -> int:
        return 0

    def close(self) -> None:
        self.abort()

    def abort(self) -> None:
        if not self._is_closing:
            self._is_closing = True
            asyncio.get_running_loop().call_soon(self._link.connection_lost, None)


class Line:
    """Two links and what is between them.

    Attributes:
        host: The end that asks.
        aircraft: The end that answers.
        there: The direction from host to aircraft.
        back: The other one.
    """

    def __init__(self, host: Link, aircraft: Link, there: Wire, back: Wire) -> None:
        self.host, self.aircraft = host, aircraft
        self.there, self.back = there, back

    def repair(self) -> None:
        """From here on everything passes."""
        self.there.faults = self.back.faults = Faults()


@asynccontextmanager
async def over_memory(aircraft: Link, dice: Random, faults: Faults) -> AsyncIterator[Line]:
    """A line within the process."""
    host = Link(first_sequence=dice.randrange(65536))
    here, opposite = _End(host), _End(aircraft)
    here.wire = Wire(dice, faults, opposite.receive)
    opposite.wire = Wire(dice, faults, here.receive)
    for end, link in ((here, host), (opposite, aircraft)):
        link.connection_made(end)
    try:
        yield Line(host, aircraft, here.wire, opposite.wire)
    finally:
        await host.close()
        await aircraft.close()


class _Terminal:
    """The far side of a pseudo-terminal: what the host wrote, and where to write to it."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self.far, self.near = os.openpty()
        tty.setraw(self.near)
        os.set_blocking(self.far, False)
        self._unsent = bytearray()

    def write(self, data: bytes) -> None:
        """Write, now or as soon as the kernel has room."""
        self._unsent += data
        self._drain()

    def _drain(self) -> None:
        while self._unsent:
            try:
                del self._unsent[: os.write(self.far, self._unsent)]
            except BlockingIOError:
                self._loop.call_later(_AGAIN_S, self._drain)
                return

    def close(self) -> None:
        self._unsent.clear()
        self._loop.remove_reader(self.far)
        os.close(self.far)
        os.close(self.near)


@asynccontextmanager
async def over_terminal(aircraft: Link, dice: Random, faults: Faults) -> AsyncIterator[Line]:
    """A line over a pseudo-terminal, read and written by the transport for serial ports."""
    terminal = _Terminal()
    opposite = _End(aircraft)
    there = Wire(dice, faults, opposite.receive)
    opposite.wire = Wire(dice, faults, terminal.write)
    aircraft.connection_made(opposite)
    loop = asyncio.get_running_loop()
    loop.add_reader(terminal.far, lambda: there.write(os.read(terminal.far, 65536)))
    host = await open_link(os.ttyname(terminal.near), first_sequence=dice.randrange(65536))
    try:
        yield Line(host, aircraft, there, opposite.wire)
    finally:
        await host.close()
        await aircraft.close()
        terminal.close()
