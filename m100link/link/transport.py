"""Opening the line: serial ports (ptys included), TCP, and transports that plug themselves in.

The only importer of pyserial and pyserial-asyncio. They open and configure the port. The bytes go
through :class:`~m100link.link.serial_transport.SerialTransport`, and through pyserial-asyncio's own
transport only where an event loop cannot watch a port: there, each override in
:class:`_PolledTransport` names the fault that it is for.
"""

from __future__ import annotations

import asyncio
import errno
import functools
import logging
import os
import socket
import time
from collections.abc import Awaitable, Callable
from typing import Any
from weakref import WeakValueDictionary

import serial
import serial_asyncio

from m100link.errors import (
    BadURL,
    LinkError,
    OutOfResources,
    PortBusy,
    PortFailed,
    PortNotFound,
    PortPermissionDenied,
)
from m100link.link.gate import GUARDIAN_NAME
from m100link.link.serial_transport import HIGH_WATER, PORT_GONE, SerialTransport
from m100link.link.url import LIKE_THESE, ConnectionString

_logger = logging.getLogger(__name__)


Opener = Callable[[ConnectionString, asyncio.Protocol], Awaitable[asyncio.Transport]]
"""A plug-in transport: an entry point in the group ``m100link.transports``."""

CONNECT_TIMEOUT = 12.0  # seconds: a network may take 5 s each way

_TCP_UNSENT = 4096
"""Bytes of the system for what a host did not take: by default megabytes, and setpoints for half an
hour, which it would take all at once when it goes on."""

_TCP_BUFFER = 65_536
"""The same with what is on its way: setpoints of some three seconds, as the system counts them."""

_HOST_GONE_MS = 20_000
"""Without a sign of a host that was sent something, or that takes nothing: the line is lost."""

_LOOK_S = 1.0  # seconds in which the owners of a port are looked for: others are left unnamed

_CAN_WATCH_PORTS = os.name == "posix"

_opened: WeakValueDictionary[str, SerialTransport] = WeakValueDictionary()
"""The last connection of this program to a port, by its device."""


class _PolledTransport(serial_asyncio.SerialTransport):
    """pyserial-asyncio 0.6 without the faults that its users suffer from; it polls on Windows."""

    def abort(self) -> None:
        # A second abort, or one after the port was lost, raises AttributeError there.
        if self._loop is not None and not (self._closing and self.get_write_buffer_size() == 0):
            super().abort()

    def _fatal_error(self, exc: BaseException, message: str = "") -> None:
        # There, pulling the plug during a write also reports to the loop's exception handler.
        # The same exception reaches connection_lost, which is report enough.
        _logger.debug("%s: %s", message or "serial port failed", exc)
        self._abort(exc)

    def _call_connection_lost(self, exc: BaseException | None) -> None:
        # There, tcdrain() runs here on the event loop and blocks it until the other end has read
        # everything. Link.close has already waited for the bytes that have to go out.
        if self._serial is None:
            return
        try:
            self._serial.reset_output_buffer()
        except PORT_GONE as error:
            _logger.debug("the port was gone before its output could be dropped: %s", error)
        super()._call_connection_lost(exc)


def find_transport(address: ConnectionString) -> Opener:
    """The function that opens a line of this scheme; nothing is opened yet.

    Raises ``BadURL``: no transport of that scheme is installed.
    """
    if address.scheme == "serial":
        return _open_serial
    if address.scheme == "tcp":
        return _open_tcp
    # Loading it takes a fifth of what the whole package takes, and few connections get here.
    from importlib.metadata import entry_points

    for entry_point in entry_points(group="m100link.transports", name=address.scheme):
        opener: Opener = entry_point.load()
        return opener
    if address.scheme == "replay":
        raise BadURL(
            f"{address} is a recorded flight, and not a line to look at",
            remedy="connect(…) plays it for a program, `m100link replay FILE` in the console",
        )
    raise BadURL(
        f"there is no transport called {address.scheme!r}",
        remedy=LIKE_THESE,
    )


async def open_transport(
    address: ConnectionString, protocol: asyncio.Protocol
) -> asyncio.Transport:
    """Open the line and attach a protocol to it.

    Raises ``PortNotFound, PortPermissionDenied, PortBusy, PortFailed``: see each class. Raises
    ``BadURL``: no transport of that scheme is installed.
    """
    # A transport that plugs itself in is loaded in the event loop, once in a program: in a thread,
    # the virtual clock of a test would run on meanwhile, and over its time-outs.
    return await find_transport(address)(address, protocol)


async def _open_serial(address: ConnectionString, protocol: asyncio.Protocol) -> asyncio.Transport:
    loop = asyncio.get_running_loop()
    device = address.target
    if device.startswith("~"):
        from m100link.errors.texts import read_path  # its parsers cost a tenth of the start

        device = str(read_path(device))
    # An inter-byte time-out, if only of 0, makes an empty read mean that the device is gone.
    open_port = functools.partial(
        serial.Serial,
        device,
        baudrate=address.number or 0,
        exclusive=True,
        timeout=0,
        inter_byte_timeout=0,
    )
    try:
        # Opening can take a second on some adapters: not on the event loop.
        port = await _kept_or_closed(loop.run_in_executor(None, open_port))
    except (serial.SerialException, OSError, ValueError) as error:
        # It looks at every process of the machine, while another task of this program may fly.
        raise await asyncio.to_thread(_translate, device, address, error) from error
    if not _CAN_WATCH_PORTS:
        polled = _PolledTransport(loop, protocol, port)
        polled.set_write_buffer_limits(high=HIGH_WATER)
        return polled
    try:
        transport = SerialTransport(loop, protocol, port)
    except BaseException:
        loop.remove_reader(port.fileno())
        port.close()
        raise
    _keep(device, transport)
    return transport


async def _kept_or_closed(opening: asyncio.Future[serial.Serial]) -> serial.Serial:
    """The port; if this is cancelled, only after the port is closed again.

    The thread that opens cannot be cancelled: it would take the port from the next program that
    opens it, this one included. A second cancellation does not wait.
    """
    try:
        await asyncio.wait([opening])
    except asyncio.CancelledError:
        opening.add_done_callback(_close_opened)
        await asyncio.wait([opening])
        raise
    return opening.result()


def _close_opened(opening: asyncio.Future[serial.Serial]) -> None:
    if not opening.cancelled() and opening.exception() is None:
        opening.result().close()


def _keep(device: str, transport: SerialTransport) -> None:
    _opened[os.path.realpath(device)] = transport


def _is_ours(device: str) -> bool:
    """Whether a connection of this program has the port.

    Its process may have it for other reasons: as a terminal, or to be a simulator at its other end.
    """
    transport = _opened.get(os.path.realpath(device))
    return transport is not None and not transport.is_closing()


def _translate(device: str, address: ConnectionString, error: Exception) -> LinkError:
    number = _errno_of(error)
    if number == errno.ENOENT:
        ports = serial_ports()
        return PortNotFound(
            f"there is no device {device}",
            cause="the adapter is not plugged in, or has another name",
            remedy=f"ports on this machine: {', '.join(ports)}"
            if ports
            else "plug it in and look at what `dmesg | tail` says",
        )
    if number in (errno.EACCES, errno.EPERM):
        return PortPermissionDenied(
            f"this user may not open {device}",
            cause="serial ports belong to a group, usually dialout",
            remedy="sudo usermod -aG dialout $USER, then log out and in again",
        )
    if number in (errno.EBUSY, errno.EAGAIN, errno.EWOULDBLOCK):
        owners = port_owners(device)
        names = ", ".join(f"{name} (process {pid})" for pid, name in owners)
        if _is_ours(device):
            return PortBusy(
                f"{device} is in use by this program itself",
                owners=owners,
                cause="a connection was dropped without aclose(): it stays open until its event "
                "loop ends",
                remedy="`async with connect(...)`, or keep the aircraft and await its aclose()",
            )
        if any(name == GUARDIAN_NAME for _, name in owners):
            return PortBusy(
                f"{device} is in use by {names}",
                owners=owners,
                cause="the guardian of a program that is gone ends its flight there",
                remedy="leave it alone: a release takes it a second, a landing a minute",
            )
        return PortBusy(
            f"{device} is in use" + (f" by {names}" if names else ""),
            owners=owners,
            cause="only one program can talk to the aircraft",
            remedy="end the other program, or have it share the aircraft",
        )
    if number in (errno.ENOTTY, errno.EISDIR):
        return PortFailed(
            f"{device} is not a serial port",
            cause="a folder" if number == errno.EISDIR else "a file, or a device of another kind",
            remedy=f"ports on this machine: {', '.join(serial_ports()) or 'none'}",
        )
    if number == errno.EINVAL or isinstance(error, ValueError):
        return PortFailed(
            f"{device} cannot be used at {address.number} baud: {error}",
            cause="an adapter that does not know this rate",
            remedy="check the baud rate that is set in the PC assistant",
        )
    return PortFailed(f"{device} cannot be opened: {error}", **_of_a_full_table(number))


def _of_a_full_table(number: int | None) -> dict[str, str]:
    """Cause and remedy, where the system has no file descriptor left."""
    if number not in (errno.EMFILE, errno.ENFILE):
        return {}
    return {"cause": OutOfResources.usual_cause, "remedy": OutOfResources.usual_remedy}


def _errno_of(error: BaseException) -> int | None:
    """The system's number; where configuring fails, pyserial keeps it in the error before only."""
    number = getattr(error, "errno", None)
    if number is None and error.__context__ is not None:
        number = next(iter(error.__context__.args), None)
    return number if isinstance(number, int) else None


def port_owners(device: str, processes: str = "/proc") -> tuple[tuple[int, str], ...]:
    """Processes that hold a device open, as ``(pid, name)``, where the system tells.

    The holder of the master of a pseudo-terminal is its other end, and holds the terminal once for
    that. Looks for a second at the most, and so never from an event loop.
    """
    from pathlib import Path

    wanted = os.path.realpath(device)
    owners = []
    until = time.monotonic() + _LOOK_S
    for process in sorted(Path(processes).glob("[0-9]*")):
        if time.monotonic() > until:
            break
        try:
            files = [os.path.realpath(fd) for fd in (process / "fd").iterdir()]
            is_its_end = wanted.startswith("/dev/pts/") and "/dev/ptmx" in files
            if files.count(wanted) > is_its_end:
                owners.append(
                    (int(process.name), (process / "comm").read_text("utf-8", "replace").strip())
                )
        except OSError:
            continue  # gone meanwhile, or not ours to look into
    return tuple(owners)


def serial_ports() -> list[str]:
    """Serial devices that this machine shows."""
    from serial.tools.list_ports import comports

    return sorted(port.device for port in comports())


async def _open_tcp(address: ConnectionString, protocol: asyncio.Protocol) -> asyncio.Transport:
    loop = asyncio.get_running_loop()
    try:
        async with asyncio.timeout(CONNECT_TIMEOUT):
            transport, _ = await loop.create_connection(
                lambda: protocol, address.target, address.number or 0
            )
    except (socket.gaierror, UnicodeError) as error:  # the latter of a name like "a..b"
        raise PortFailed(
            f"no host called {address.target} is known: {error.args[-1]}",
            cause="a typing error, or no network that knows names",
            remedy="check the name, or give the address: tcp://192.168.1.5:7000",
        ) from error
    except (OSError, TimeoutError) as error:
        words = _of_a_full_table(error.errno)
        if words:
            raise PortFailed(f"{address} cannot be opened: {error}", **words) from error
        raise PortFailed(
            f"nothing answers at {address}: {str(error) or 'no connection in time'}",
            cause="the program that should listen there is not running",
            remedy="start it, and check host and port",
        ) from error
    transport.set_write_buffer_limits(high=HIGH_WATER)
    options = transport.get_extra_info("socket")
    # Where the system does not distinguish the two, the line has to be quick.
    may_be_slow = hasattr(socket, "TCP_NOTSENT_LOWAT")
    if may_be_slow:
        options.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, _TCP_UNSENT)
    buffer = _TCP_BUFFER if may_be_slow else _TCP_UNSENT
    options.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, buffer)
    if hasattr(socket, "TCP_USER_TIMEOUT"):  # by default it is found gone after half an hour
        options.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _HOST_GONE_MS)
    return transport


# -- a cable inside the process: two transports, what one writes the other's protocol receives -----


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
