"""Virtual aircraft on an event loop: time passes, and ports connect them to programs.

Each aircraft has one :class:`Driver`: one timer, no task, no thread. Ports are in-memory cables
(:meth:`Driver.connect`), pseudo-terminals (:mod:`m100link.sim.ports.pty`) and TCP sockets
(:mod:`m100link.sim.ports.driver`). As on the real one there is one serial line: what several ports
write arrives mixed.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from typing import TYPE_CHECKING, Protocol

from m100link.errors import UsageError
from m100link.link import connect_in_memory
from m100link.sim.line import is_telemetry
from m100link.sim.ports.url import aircraft_of, check_clock

if TYPE_CHECKING:
    from m100link.link import MemoryTransport
    from m100link.link.url import ConnectionString
    from m100link.sim.orders.actions import Scenario
    from m100link.sim.virtual import VirtualAircraft


_OVERSLEPT_S = 1.0


class Port(Protocol):
    """Where the bytes of an aircraft go."""

    def write(self, frames: list[bytes]) -> None:
        """Send frames, or drop what there is no room for."""
        ...

    def unplug(self) -> None:
        """Go away for whoever is connected."""
        ...

    def replug(self) -> None:
        """Come back."""
        ...

    def close(self) -> None:
        """End for good."""
        ...


class Backlog:
    """Frames that wait for a reader who does not keep up; bounded, old telemetry goes first."""

    LIMIT = 256

    def __init__(self) -> None:
        self._frames: deque[bytes] = deque()
        self.dropped = 0  # frames dropped so far

    def __len__(self) -> int:
        return len(self._frames)

    def extend(self, frames: list[bytes]) -> None:
        """Add frames; beyond the limit the oldest telemetry is dropped, then the oldest."""
        self._frames.extend(frames)
        while len(self._frames) > self.LIMIT:
            for index, frame in enumerate(self._frames):
                if is_telemetry(frame):
                    del self._frames[index]
                    break
            else:
                self._frames.popleft()
            self.dropped += 1

    def take(self) -> list[bytes]:
        """Take all of them, oldest first."""
        frames = list(self._frames)
        self._frames.clear()
        return frames

    def clear(self) -> None:
        """Drop all of them."""
        self.dropped += len(self._frames)
        self._frames.clear()


class Driver:
    """Lets time pass for one aircraft and carries bytes between it and its ports.

    Args:
        aircraft: The aircraft.
        loop: The event loop; by default the running one. Its ``time`` is the aircraft's.

    Attributes:
        aircraft: As given.
        ports: The ports attached.
        scenario: Steps to do when their time has come.
    """

    def __init__(
        self, aircraft: VirtualAircraft, loop: asyncio.AbstractEventLoop | None = None
    ) -> None:
        self.aircraft = aircraft
        self.loop = loop or asyncio.get_running_loop()
        self.ports: list[Port] = []
        self.scenario: Scenario | None = None
        # The one timer: the next step of the aircraft, or the next arrival on its line.
        self._timer: asyncio.TimerHandle | None = None
        # The plug as the ports know it; orders only change the line.
        self._was_plugged = True
        self._is_stopped = False

    def start(self) -> None:
        """Switch the aircraft on (or let it go on)."""
        self._is_stopped = False
        if self._timer is None:
            now = self.loop.time()
            self.aircraft.autopilot.skip(now)  # stopped, it did not age
            self.aircraft.autopilot.advance(now)
            self._schedule(now)

    def stop(self) -> None:
        """Stop time for the aircraft and close its ports."""
        self._is_stopped = True
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        for port in list(self.ports):
            port.close()
        self.ports.clear()

    def attach(self, port: Port) -> None:
        """Add a port and start, if not yet started."""
        if port not in self.ports:
            self.ports.append(port)
        self.start()

    def detach(self, port: Port) -> None:
        """Take a port away."""
        if port in self.ports:
            self.ports.remove(port)

    def connect(self, protocol: asyncio.Protocol) -> MemoryTransport:
        """Connect a protocol of the host side by a cable in memory."""
        if not self.aircraft.line.is_plugged:
            raise ConnectionRefusedError("the virtual aircraft is unplugged")
        port = StreamPort(self)
        return connect_in_memory(protocol, port)

    def receive(self, data: bytes) -> None:
        """Bytes that came in through a port."""
        if self._is_stopped:
            return
        now = self.loop.time()
        line = self.aircraft.line
        for piece in line.from_host(data, now):
            self.aircraft.autopilot.receive_data(piece, now)
        self._flush(now)
        arrival = line.next_wakeup()
        if arrival is not None and self._timer is not None and arrival < self._timer.when():
            self._timer.cancel()
            self._timer = self.loop.call_at(arrival, self._on_timer)

    def _on_timer(self) -> None:
        self._timer = None
        aircraft, now = self.aircraft, self.loop.time()
        autopilot, line = aircraft.autopilot, aircraft.line
        due = autopilot.next_wakeup()
        if due is not None and now - due > _OVERSLEPT_S:
            autopilot.skip(now)
        autopilot.advance(now)
        if self.scenario is not None:
            self._play(self.scenario)
        if line.is_plugged is not self._was_plugged:
            self._plug(line.is_plugged)
        if not line.to_aircraft.is_clean:
            for piece in line.from_host(b"", now):
                autopilot.receive_data(piece, now)
        self._flush(now)
        self._schedule(now)

    def _play(self, scenario: Scenario) -> None:
        try:
            scenario.advance(self.aircraft)
        except UsageError as error:
            self.aircraft.vehicle.log(f"scenario: {error.seen}")

    def _plug(self, is_plugged: bool) -> None:
        self._was_plugged = is_plugged
        for port in list(self.ports):
            if is_plugged:
                port.replug()
            else:
                port.unplug()

    def _flush(self, now: float) -> None:
        frames = self.aircraft.line.from_aircraft(self.aircraft.autopilot.frames_to_send(), now)
        if frames:
            for port in self.ports:
                port.write(frames)

    def _schedule(self, now: float) -> None:
        if self._is_stopped:
            return
        due = self.aircraft.autopilot.next_wakeup()
        arrival = self.aircraft.line.next_wakeup()
        if due is None or (arrival is not None and arrival < due):
            due = arrival
        self._timer = self.loop.call_at(now if due is None else due, self._on_timer)


class StreamPort(asyncio.Protocol):
    """A port on any asyncio transport: a cable in memory, a TCP connection."""

    def __init__(self, driver: Driver) -> None:
        self._driver = driver
        self._transport: asyncio.Transport | None = None
        self._is_paused = False
        self.backlog = Backlog()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """The other end is there."""
        assert isinstance(transport, asyncio.Transport)
        if not self._driver.aircraft.line.is_plugged:
            transport.abort()
            return
        self._transport = transport
        transport.set_write_buffer_limits(high=16_384)
        self._driver.attach(self)

    def data_received(self, data: bytes) -> None:
        """Bytes of the host."""
        self._driver.receive(data)

    def pause_writing(self) -> None:
        """The reader does not keep up."""
        self._is_paused = True

    def resume_writing(self) -> None:
        """The reader has caught up."""
        self._is_paused = False
        if self._transport is not None and len(self.backlog):
            self._transport.write(b"".join(self.backlog.take()))

    def connection_lost(self, exc: Exception | None) -> None:
        """The other end has gone."""
        self._transport = None
        self._driver.detach(self)

    def write(self, frames: list[bytes]) -> None:
        """Send frames; a reader who does not keep up loses the oldest telemetry."""
        if self._transport is None:
            return
        if self._is_paused:
            self.backlog.extend(frames)
        else:
            self._transport.write(frames[0] if len(frames) == 1 else b"".join(frames))

    def unplug(self) -> None:
        """Hang up."""
        if self._transport is not None:
            self._transport.abort()

    def replug(self) -> None:
        """A stream that ended stays ended; the host connects anew."""

    def close(self) -> None:
        """Hang up."""
        if self._transport is not None:
            self._transport.close()


async def open_sim(address: ConnectionString, protocol: asyncio.Protocol) -> asyncio.Transport:
    """Transport of ``sim://`` URLs: a new virtual aircraft that lives as long as the connection.

    Raises:
        BadURL: An option that does not exist, or a value that it cannot have.
        UsageError: A speed that the event loop does not have.
    """
    url = f"{address.scheme}://{address.target}"
    check_clock(url, asyncio.get_running_loop())
    return connect_in_memory(protocol, _OwnedPort(Driver(aircraft_of(url))))


class _OwnedPort(StreamPort):
    """The only port of its aircraft: both end together."""

    def connection_lost(self, exc: Exception | None) -> None:
        super().connection_lost(exc)
        self._driver.stop()


# -- programs reach a virtual aircraft by TCP, as through a serial server --------------------------


async def stop_listening(server: asyncio.Server) -> None:
    """Close a listening server without losing a connection on the way in.

    A connection that the event loop has accepted, but not yet made a transport for, would be left
    open by closing the server (CPython 3.11: an assertion fails inside the transport). So nothing
    new is accepted first, then what was accepted gets its transport, then the server is closed.
    """
    loop = asyncio.get_running_loop()
    for listening in server.sockets:
        loop.remove_reader(listening.fileno())
    for _ in range(3):
        await asyncio.sleep(0)
    server.close()


class TcpServer:
    """Listens for one aircraft, like a serial server: a new connection replaces the last."""

    def __init__(self, driver: Driver) -> None:
        self._driver = driver
        self._server: asyncio.Server | None = None
        self._current: StreamPort | None = None
        self.port = 0

    async def start(self, host: str, port: int) -> None:
        """Listen; port 0 chooses a free one (see ``port``)."""
        self._server = await self._driver.loop.create_server(self._make_port, host, port)
        self.port = self._server.sockets[0].getsockname()[1]
        self._driver.start()

    def _make_port(self) -> StreamPort:
        if self._current is not None:
            self._current.close()
        self._current = StreamPort(self._driver)
        return self._current

    async def stop(self) -> None:
        """Stop listening and hang up."""
        if self._server is not None:
            await stop_listening(self._server)
            if self._current is not None:
                self._current.close()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(1.0):
                    await self._server.wait_closed()
            self._server = None


async def serve_tcp(driver: Driver, host: str = "127.0.0.1", port: int = 0) -> TcpServer:
    """Let programs reach an aircraft by ``tcp://host:port``."""
    server = TcpServer(driver)
    await server.start(host, port)
    return server
