"""Virtual aircraft on an event loop: time passes, and ports connect them to programs.

Each aircraft has one :class:`Driver`: one timer, no task, no thread. Ports are in-memory cables
(:meth:`Driver.connect`), pseudo-terminals (:mod:`m100link.sim.ports.pty`) and TCP sockets. As on
the real one there is one serial line: what several ports write arrives mixed.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any, Literal, Protocol, get_args, get_origin, get_type_hints
from urllib.parse import parse_qsl

from m100link.errors import BadURL, UsageError
from m100link.link import MemoryTransport, connect_in_memory
from m100link.link.url import ConnectionString
from m100link.protocol.records import AccelerationMode
from m100link.sim.clock import LockstepEventLoop, VirtualClockEventLoop, loop_factory
from m100link.sim.line import LineFaults, is_telemetry
from m100link.sim.vehicle.activation import DEMO_APP_ID, DEMO_KEY
from m100link.sim.vehicle.dynamics import read_airframe
from m100link.sim.vehicle.missions.route import MissionSettings
from m100link.sim.vehicle.settings import AircraftSettings, AssistantSettings
from m100link.sim.virtual import VirtualAircraft

_OVERSLEPT_S = 1.0


class Port(Protocol):
    """Where the bytes of an aircraft go."""

    def write(self, frames: list[bytes]) -> None:
        """Send frames, or drop what there is no room for."""

    def unplug(self) -> None:
        """Disconnect the peer."""

    def replug(self) -> None:
        """Come back."""

    def close(self) -> None:
        """End for good."""


class TimedScenario(Protocol):
    """Events of an aircraft, by its own clock."""

    def advance(self, aircraft: VirtualAircraft) -> object:
        """Do what is due; an order that cannot be done raises ``UsageError``."""
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
        self.scenario: TimedScenario | None = None
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
            try:
                self.scenario.advance(aircraft)
            except UsageError as error:
                aircraft.vehicle.log(f"scenario: {error.seen}")
        if line.is_plugged is not self._was_plugged:
            self._plug(line.is_plugged)
        if not line.to_aircraft.is_clean:
            for piece in line.from_host(b"", now):
                autopilot.receive_data(piece, now)
        self._flush(now)
        self._schedule(now)

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
    with contextlib.suppress(NotImplementedError):  # the usual loop of Windows watches no sockets
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


# -- ``sim://`` URLs: a virtual aircraft by its options, as ``m100link sim`` has them --------------


LINE_OPTIONS: dict[str, str] = {
    one.name: {"baud_rate": "line-baud"}.get(one.name, one.name.replace("_", "-"))
    for one in fields(LineFaults)
}
"""The option name of each field of :class:`LineFaults`."""

_SITE_NAMES = {
    "latitude_deg": "latitude",
    "longitude_deg": "longitude",
    "heading_deg": "heading",
    "noise": "sensor-noise",
}
SITE_OPTIONS: dict[str, str] = {
    name: _SITE_NAMES.get(name, name.replace("_", "-"))
    for name in (
        *("latitude_deg", "longitude_deg", "ground_altitude", "heading_deg"),
        *("wind_north", "wind_east", "gusts", "noise", "movement_timeout", "server_delay"),
        *("gimbal_follows", "rc_lost_reads"),
    )
}
"""The option name of each field of :class:`AircraftSettings` that is an option."""

MISSION_OPTIONS: dict[str, str] = {
    **{"status_hz": "mission-status-hz", "takes_off_by_itself": "mission-takes-off"},
    **{name: name.replace("_", "-") for name in ("hotpoint_acks", "follow_yaw_reversed")},
    **{"radius_limit": "radius-limit", "never_logged_in": "never-logged-in"},
}
"""The option name of each field of :class:`MissionSettings` that is an option."""

_EXAMPLE = "sim://?firmware=3.1&speed=10&loss=0.1&seed=7"
_OWN: dict[str, Any] = {
    **{"firmware": str, "seed": int, "app-id": int, "key": str, "level": int},
    **{"cold": bool, "activated": bool, "speed": str, "pace": bool, "baud": int},
    **{"airframe": str, "acceleration": str},
}
_TRUE, _FALSE = ("1", "true", "yes", "on", ""), ("0", "false", "no", "off")


def _bad(url: str, why: str) -> BadURL:
    return BadURL(f"{url}: {why}", remedy=f"write it like {_EXAMPLE}")


def _options(url: str) -> dict[str, Any]:
    before, _, query = url.partition("?")
    if name := before.strip().removeprefix("sim://"):
        raise _bad(url, f"nothing stands between sim:// and its options, and here is {name!r}")
    found: dict[str, Any] = {}
    kinds = _kinds()
    for given, text in parse_qsl(query, keep_blank_values=True):
        name = given.replace("_", "-")
        if name not in kinds:
            raise _bad(url, f"sim:// has no option {given!r}; it has {', '.join(sorted(kinds))}")
        found[name] = _read(url, name, text, kinds[name])
    return found


def _kinds() -> dict[str, Any]:
    kinds = dict(_OWN)
    sources: tuple[tuple[type, dict[str, str]], ...] = (
        (LineFaults, LINE_OPTIONS),
        (AircraftSettings, SITE_OPTIONS),
        (MissionSettings, MISSION_OPTIONS),
    )
    for source, names in sources:
        hints = get_type_hints(source)
        kinds |= {option: hints[field] for field, option in names.items()}
    return kinds


def _read(url: str, name: str, text: str, kind: Any) -> Any:
    if kind is bool:
        if text.lower() not in (*_TRUE, *_FALSE):
            raise _bad(url, f"{name} is 1 or 0, not {text!r}")
        return text.lower() in _TRUE
    if kind is str:
        return text
    if words := get_args(kind) if get_origin(kind) is Literal else ():
        if text not in words:
            raise _bad(url, f"{name} is {' or '.join(words)}, not {text!r}")
        return text
    try:
        return int(text) if kind is int or kind == (int | None) else float(text)
    except ValueError:
        raise _bad(url, f"{name} is a number, not {text!r}") from None


def speed_of(url: str) -> float:
    """How many of its seconds a real one has; infinity for ``speed=max``.

    Raises ``BadURL``: it is not a speed.
    """
    text = _options(url).get("speed", "1")
    try:
        speed = float("inf") if text == "max" else float(text)
    except ValueError:
        speed = 0.0
    if not speed > 0:
        raise _bad(url, f"speed is a number above 0, or max, not {text!r}")
    return speed


def clock_of(line: object) -> Callable[[], asyncio.AbstractEventLoop] | None:
    """The event loop that a line wants for itself; None: any will do.

    With ``speed=max`` it is the one whose time passes while another thread waits.
    """
    if not isinstance(line, str) or not line.startswith("sim:"):
        return None
    speed = speed_of(line)
    if speed == 1.0:
        return None
    return LockstepEventLoop if speed == float("inf") else loop_factory(speed)


def check_clock(url: str, loop: asyncio.AbstractEventLoop) -> None:
    """Whether time passes here as fast as the URL says: the aircraft lives on the program's clock.

    Raises ``UsageError``: it does not.
    """
    if "speed" not in _options(url):
        return
    wanted = speed_of(url)
    there = getattr(loop, "speed", float("inf") if isinstance(loop, VirtualClockEventLoop) else 1.0)
    if wanted != there:
        raise UsageError(
            f"{url} asks for a speed of {wanted:g}, and the time of this event loop passes at "
            f"{there:g}",
            cause="a virtual aircraft in a program lives on the clock of its event loop",
            remedy="asyncio.Runner(loop_factory=m100link.sim.loop_factory(SPEED)), "
            "infinity for max; or m100link.sync, which makes its own; or `m100link sim --speed N`",
        )


def aircraft_of(url: str) -> VirtualAircraft:
    """The virtual aircraft that a URL describes.

    Raises ``BadURL``: an option that does not exist, or a value that it cannot have.
    """
    options = _options(url)

    def taken(names: Mapping[str, str]) -> dict[str, Any]:
        return {field: options[option] for field, option in names.items() if option in options}

    cold = options.get("cold", False)
    try:
        assistant = AssistantSettings(
            api_control_enabled=not cold,
            baud_rate=options.get("baud", 230_400),
            acceleration=options.get("acceleration", AccelerationMode.FUSED),
        )
        return VirtualAircraft(
            seed=options.get("seed", 0),
            firmware=options.get("firmware", "1.0"),
            app_id=options.get("app-id", DEMO_APP_ID),
            key=options.get("key", DEMO_KEY),
            level=options.get("level", 2),
            cold=cold,
            activated=options.get("activated", False),
            settings=AircraftSettings(
                **taken(SITE_OPTIONS),
                airframe=read_airframe(options["airframe"]) if "airframe" in options else None,
                missions=MissionSettings(**taken(MISSION_OPTIONS)),
            ),
            assistant=assistant,
            faults=LineFaults(**taken(LINE_OPTIONS)),
            paced=options.get("pace", False),
        )
    except ValueError as error:
        raise _bad(url, str(error)) from error
