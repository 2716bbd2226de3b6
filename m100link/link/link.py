"""The link: an :class:`asyncio.Protocol` around the session layer, futures and one timer.

No task of its own runs here. Bytes come in by ``data_received``; requests are futures that acks
resolve; one ``call_at`` wakes the session layer when it asked to be woken.
"""

from __future__ import annotations

import asyncio
import logging
import math
import os
from asyncio import _get_running_loop  # the other one raises where none runs
from collections.abc import Callable, Iterator
from typing import cast

from m100link.errors import AckTimeout, LinkClosed, LinkError, LinkLost
from m100link.errors.usage import of_another_loop
from m100link.link.gate import WriteGate, descriptor_of, lose_at_fork, lose_line
from m100link.link.statistics import (
    LinkStatistics,
    RoundTrips,
    Tap,
    TappedProtocol,
    excerpt,
)
from m100link.link.transport import open_transport
from m100link.link.url import ConnectionString, parse_url
from m100link.session.endpoint import Endpoint
from m100link.session.events import Acked, Event, Expired, Latency, SessionMode
from m100link.wire.cipher import Cipher
from m100link.wire.frame import Frame

_logger = logging.getLogger(__name__)


CLOSE_TIMEOUT = 1.0  # seconds that closing waits for written bytes to leave

FORGET_AFTER = 5.0
"""Seconds after which the same number is a new command, not a repeat.

The document forgets never (1.4). But an end that restarts counts from the start again, and a loss
of authority must not be taken for one that came before.
"""

_HEADER = 12
_SILENT_S = 1.0  # without telemetry of 1 Hz, or any: it is not the one frame that was lost
_LEVEL_S = 0.1  # between two looks at the level of the log


def ignore(*_: object) -> None:
    """The default of the callbacks."""


def require_loop(own: asyncio.AbstractEventLoop, name: str = "aircraft.link.loop") -> None:
    """Refuse a call when another event loop runs here, or its own elsewhere or nowhere.

    ``own``: the event loop in which the connection was made. Raises ``UsageError``: it is another
    one.
    """
    here = _get_running_loop()
    # Between two runs of its loop, as at a prompt, none runs here.
    if here is not own and (here or own.is_running() or own.is_closed()):
        raise of_another_loop(name)


class Link(asyncio.Protocol):
    """One end of an open line.

    Use :func:`~m100link.link.open_link`, or give an instance to any transport as its protocol.

    Args:
        on_received: Called with each command or push frame and the time it arrived.
        on_lost: Called once with the typed reason when the line is gone.
        first_sequence: First sequence number; random by default.
    """

    # With a dictionary for what programs put there, which tests do, and which is only then made.
    __slots__ = (
        *("__dict__", "__weakref__", "_bytes_sent", "_connected", "_disconnected"),
        *("_dropped_writes", "_endpoint", "_failure", "_frames_sent", "_is_debug"),
        *("_is_failure_reported", "_is_writable", "_level_at", "_loop", "_pending", "_round_trips"),
        *("_timers", "_transport", "gate", "last_received_at", "name", "on_lost", "on_received"),
    )
    _missed_setpoints = 0
    is_recorded = False  # a replay, whose aircraft cannot be asked for anything

    def __init__(
        self,
        *,
        on_received: Callable[[Frame, float], None] = ignore,
        on_lost: Callable[[LinkError], None] = ignore,
        first_sequence: int | None = None,
    ) -> None:
        self._loop = asyncio.get_running_loop()
        if first_sequence is None:
            first_sequence = int.from_bytes(os.urandom(2))
        self._endpoint = Endpoint(first_sequence=first_sequence, forget_after=FORGET_AFTER)
        self.on_received = on_received
        self.on_lost = on_lost
        self.name = "link"
        self.gate: WriteGate | None = (
            None  # asked before each write, where a guardian shares the line
        )
        self._transport: asyncio.Transport | None = None  # until the line is open
        # The waiter for each ack, and the request's name in errors, by the session's token.
        self._pending: dict[int, tuple[asyncio.Future[bytes], str]] = {}
        # The one timer of all requests, and its spare; they stand at the earliest repeat or end of
        # a wait.
        self._timers: tuple[asyncio.TimerHandle, ...] = ()
        # False while the transport's buffer is full: pushes are dropped then, never queued.
        self._is_writable = True
        # The first reason counts; every later caller gets the same one.
        self._failure: LinkError | None = None
        # Whether all who wait, and the owner, know of it.
        self._is_failure_reported = False
        self._connected: asyncio.Future[None] = self._loop.create_future()
        self._disconnected = asyncio.Event()
        # Whether received frames are logged, and when to look again whether they shall be.
        self._is_debug = False
        self._level_at = -math.inf
        self._bytes_sent = self._frames_sent = self._dropped_writes = 0
        self._round_trips = RoundTrips()
        self.last_received_at: float | None = None

    # -- what users of a link call ---------------------------------------------------------------

    @property
    def loop(self) -> asyncio.AbstractEventLoop:
        """The event loop that this link belongs to."""
        return self._loop

    @property
    def clock(self) -> Callable[[], float]:
        """The clock of this line's times, s: the event loop's, or that of a recorded flight."""
        return self._loop.time

    def require_loop(self) -> None:
        """Raise a UsageError when another event loop runs here, or its own elsewhere or nowhere."""
        require_loop(self._loop)

    @property
    def cipher(self) -> Cipher | None:
        """Encrypts and decrypts in both directions; None until there is a key."""
        return self._endpoint.decoder.cipher  # asked with each package of telemetry

    @cipher.setter
    def cipher(self, cipher: Cipher | None) -> None:
        self._endpoint.cipher = cipher

    @property
    def is_open(self) -> bool:
        """Whether bytes can be sent."""
        return self._transport is not None and self._failure is None

    @property
    def is_serial(self) -> bool:
        """Whether it is a serial port, which brings what is sent at once."""
        return self._transport is not None and bool(self._transport.get_extra_info("serial"))

    @property
    def descriptor(self) -> int | None:
        """The open file of the line, None where it has none: in memory, or polled."""
        return None if self._failure else descriptor_of(self._transport)

    @property
    def failure(self) -> LinkError | None:
        """Why the link is not open any more."""
        return self._failure

    def statistics(self) -> LinkStatistics:
        """The counters as they are now."""
        decoder, sessions = self._endpoint.decoder, self._endpoint.statistics
        return LinkStatistics(
            bytes_received=decoder.bytes,
            bytes_sent=self._bytes_sent,
            frames_received=decoder.frames,
            frames_sent=self._frames_sent,
            discards={str(cause): count for cause, count in decoder.discards.items() if count},
            discarded_bytes=decoder.discarded_bytes,
            dropped_writes=self._dropped_writes,
            acks=sessions.acks,
            duplicate_acks=sessions.duplicate_acks,
            late_acks=sessions.late_acks,
            foreign_acks=sessions.foreign_acks,
            repeats=sessions.transmissions - sessions.requests,
            expired=sessions.expired,
            round_trips=self._round_trips,
            missed_setpoints=self._missed_setpoints,
            round_trip_s=self.latency.round_trip_s,
        )

    @property
    def latency(self) -> Latency:
        """How long answers take on this line, as measured."""
        return self._endpoint.sender.latency

    def missed(self, setpoints: int) -> None:
        """Count setpoints that did not go out in their time."""
        self._missed_setpoints += setpoints

    @property
    def is_asking(self) -> bool:
        """Whether a request waits for its answer."""
        return bool(self._pending)

    async def request(
        self,
        data: bytes,
        *,
        name: str = "request",
        mode: SessionMode = SessionMode.RELIABLE,
        encrypted: bool = False,
        timeout: float = 0.5,
        tries: int = 3,
    ) -> bytes:
        """Send a command and await its ack.

        Args:
            data: Data of the frame.
            name: Word for the command in errors.
            mode: ``RELIABLE`` or ``ACK_ONCE``.
            encrypted: Encrypt the data.
            timeout: Seconds to wait after each transmission; after the last one at least as long
                as answers take on this line.
            tries: Transmissions in all; 1 with ``ACK_ONCE``.

        Returns:
            The data of the ack.

        Raises:
            AckTimeout: No ack after the last try; the outcome is unknown.
            LinkLost, LinkClosed: The line went away before the ack came.
            UsageError: See :meth:`Sender.request`.
        """
        self._check_open()
        now = self._loop.time()
        token = self._endpoint.request(
            data,
            now=now,
            mode=mode,
            encrypted=encrypted,
            timeout=timeout,
            tries=tries,
        )
        try:
            future: asyncio.Future[bytes] = self._loop.create_future()
            self._pending[token] = future, name
            self._flush()
            if not self._timers or self._timers[0].when() > now + timeout:
                self._set_timer()
            payload = await future
            self._round_trips = self._round_trips.plus(self._loop.time() - now)
            return payload
        except BaseException:
            self._set_timer()  # what is abandoned ends, too
            raise
        finally:
            # After a cancellation nobody waits: the session core keeps the slot as long as needed.
            self._pending.pop(token, None)
            self._endpoint.abandon(token)

    def push(self, data: bytes, *, encrypted: bool = False) -> bool:
        """Send a frame on session 0.

        Returns:
            False when the line does not drain and the frame was dropped: it would arrive stale.

        Raises:
            LinkLost, LinkClosed: There is no line.
        """
        # Fifty times a second, and nearly always as it should be: no call is made to find that out.
        if self._failure or self._transport is None or _get_running_loop() is not self._loop:
            self._check_open()
        if not self._is_writable:
            self._dropped_writes += 1
            return False
        dropped = self._dropped_writes
        try:
            self._endpoint.push(data, encrypted=encrypted)
            self._flush()
        except BaseException:
            self._endpoint.drop_pushes()  # cut off by Ctrl-C: it would leave with the next one
            raise
        return self._dropped_writes == dropped

    def acknowledge(self, command: Frame, payload: bytes, *, encrypted: bool | None = None) -> None:
        """Answer a command frame that ``on_received`` got; nothing is sent on session 0."""
        if not self.is_open:
            return
        if encrypted is None and command.encrypted and self.cipher is None:
            encrypted = False
        self._endpoint.acknowledge(command, payload, now=self._loop.time(), encrypted=encrypted)
        self._flush()

    async def close(self) -> None:
        """Close the line: pending requests fail with :class:`LinkClosed`.

        Bytes already written get up to a second to leave. May be called any number of times.
        """
        self.require_loop()
        is_attached = self._transport is not None
        if self._failure is None:
            when = "by this side" if is_attached else "before it was open"
            self._failure = LinkClosed(f"the link was closed {when}")
        try:
            self._tell_of_failure()
            if is_attached and not self._disconnected.is_set():
                await self._drain()
        finally:  # a cancelled close has to close the line, too
            if self._transport is not None:
                self._transport.abort()
        if is_attached:
            await self.wait_disconnected()

    async def wait_disconnected(self, timeout: float | None = CLOSE_TIMEOUT) -> None:
        """Wait until the transport has let go of the line; None: however long that takes."""
        self.require_loop()
        try:
            async with asyncio.timeout(timeout):
                await self._disconnected.wait()
        except TimeoutError:
            _logger.warning("%s: the port did not report its end within a second", self.name)

    async def wait_connected(self) -> None:
        """Wait until the transport is attached (an opener may return before it is)."""
        await self._connected

    # -- what the transport calls ----------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """The transport is attached."""
        # By what it does, not by its class: those of uvloop are of no class of asyncio's.
        self._transport = cast(asyncio.Transport, transport)
        lose_at_fork(self)
        if not self._connected.done():
            self._connected.set_result(None)

    def data_received(self, data: bytes) -> None:
        """Bytes from the line."""
        now = self.last_received_at = self._loop.time()
        endpoint = self._endpoint
        if now >= self._level_at:
            self._look_at_level(now)
        try:
            frames = endpoint.decoder.feed(data)
            if len(frames) == 1 and not (frames[0][0] or frames[0][1] or self._is_debug):
                # A push: nearly always, and a hundred times a second. Behind it is nothing to be
                # lost, and nothing to write.
                endpoint.statistics.commands += 1
                receive = self.on_received  # from here a call takes half as long
                receive(frames[0], now)
            elif frames:
                self._dispatch(iter(endpoint._sort_out(frames, now)), now)
                if endpoint.has_output:
                    self._flush()
                    self._set_timer()
        except (KeyboardInterrupt, SystemExit):
            self._loop.call_soon(self._mend)
            raise

    def pause_writing(self) -> None:
        """The other end does not drain."""
        self._is_writable = False

    def resume_writing(self) -> None:
        """It drains again."""
        self._is_writable = True

    def eof_received(self) -> bool:
        """The other end of a socket closed; close this one too."""
        return False

    def connection_lost(self, exc: Exception | None) -> None:
        """The line is gone."""
        try:
            self._disconnected.set()
            if self._failure is None:
                error = LinkLost(
                    f"{self.name} went away" + (f": {str(exc) or repr(exc)}" if exc else ""),
                    cause="unplugged, powered off, or the other end closed",
                    remedy="check cable and power, then connect again",
                )
                error.__cause__ = exc
                self._failure = error
            self._tell_of_failure()
        except KeyboardInterrupt:
            self._loop.call_soon(self.connection_lost, exc)
            raise

    # -- inside ----------------------------------------------------------------------------------

    def _check_open(self) -> None:
        self.require_loop()
        if self._failure is not None:
            raise self._failure.again()
        if self._transport is None:
            raise LinkClosed("the link is not open yet")

    def _look_at_level(self, now: float) -> None:
        """See whether frames are logged, ten times a second: asking takes longer than a frame."""
        self._is_debug = _logger.isEnabledFor(logging.DEBUG)
        self._level_at = now + _LEVEL_S

    def _dispatch(self, events: Iterator[Event], now: float) -> None:
        try:
            for event in events:
                if type(event) is Frame:
                    if self._is_debug:
                        _logger.debug(
                            "< session %d seq %d %s",
                            event.session,
                            event.sequence,
                            excerpt(event.data),
                        )
                    self.on_received(event, now)
                elif isinstance(event, (Acked, Expired)):
                    self._resolve(event)
        except BaseException:
            # A taker of an event raised. The events behind it were read and must not be lost.
            self._loop.call_soon(self._dispatch, events, now)
            raise

    def _resolve(self, event: Acked | Expired) -> None:
        """A request came to its end."""
        pending = self._pending.get(event.token)
        if pending is None or pending[0].done():
            return  # nobody waits for it any more
        future, name = pending
        if isinstance(event, Acked):
            future.set_result(event.payload)
        else:
            future.set_exception(self._timeout(name, event))

    def _timeout(self, name: str, event: Expired) -> AckTimeout:
        cause = "the frame or its ack was lost, or the aircraft ignores the command"
        if not self._is_writable:
            cause = "the other end of the line does not take bytes"
        elif self.last_received_at is None:
            cause = "nothing arrives from the aircraft at all"
        elif (silent_s := self._loop.time() - self.last_received_at) > _SILENT_S:
            cause = (
                f"nothing has come from the aircraft for {silent_s:.1f} s: "
                "it stands still, or the line from it is broken"
            )
        elif self.latency.is_slow:
            cause += f"; {self.latency}"
        return AckTimeout(
            f"no ack of {name} after {event.tries} tries; its outcome is unknown",
            command=name,
            session=event.session,
            sequence=event.sequence,
            tries=event.tries,
            cause=cause,
            remedy="look at telemetry before repeating the command",
        )

    def _flush(self) -> None:
        transport, gate = self._transport, self.gate
        debug = _logger.isEnabledFor(logging.DEBUG)
        for wire in self._endpoint.output():
            if transport is None or self._failure is not None or not self._is_writable:
                self._dropped_writes += 1
                continue
            if gate is not None and not gate.opens(len(wire)):
                self._dropped_writes += 1
                continue
            if debug:
                _logger.debug("> %s", excerpt(wire, data_at=_HEADER))
            self._bytes_sent += len(wire)
            self._frames_sent += 1
            transport.write(wire)
            if gate is not None:
                gate.wrote(transport.get_write_buffer_size())

    def _set_timer(self) -> None:
        """Keep the one timer right, after anything that may have sent a request."""
        wakeup = self._endpoint.next_wakeup()
        if wakeup is None or self._failure is not None:
            return
        # An armed timer that is early stays: waking once too often is cheaper than re-arming for
        # every request.
        if not self._timers or self._timers[0].when() > wakeup:
            before = self._timers
            # A KeyboardInterrupt can take one, and without any no request would ever end.
            self._timers = tuple(self._loop.call_at(wakeup, self._on_timer) for _ in range(2))
            for timer in before:
                timer.cancel()

    def _on_timer(self) -> None:
        try:
            for timer in self._timers:
                timer.cancel()
            self._timers = ()
            now = self._loop.time()
            self._dispatch(iter(self._endpoint.handle_timer(now)), now)
            self._flush()
            self._set_timer()
        except BaseException:
            self._loop.call_soon(self._mend)
            raise

    def _mend(self) -> None:
        """Go on after something (Ctrl-C) cut one of the callbacks off, wherever that was."""
        for token, (future, name) in list(self._pending.items()):
            if not self._endpoint.is_open(token):
                del self._pending[token]
                if not future.done():
                    seen = f"the ack of {name} was cut off; its outcome is unknown"
                    remedy = "look at telemetry before repeating the command"
                    future.set_exception(AckTimeout(seen, command=name, remedy=remedy))
        for timer in self._timers:
            timer.cancel()
        self._timers = ()
        self._flush()
        self._set_timer()

    async def _drain(self) -> None:
        """Give written bytes a bounded time to leave."""
        assert self._transport is not None
        deadline = self._loop.time() + CLOSE_TIMEOUT
        while not self._disconnected.is_set() and self._loop.time() < deadline:
            port = self._transport.get_extra_info("serial")
            try:
                is_empty = not self._transport.get_write_buffer_size()
                is_sent = port is None or not port.out_waiting
            except OSError:
                return  # the port is gone: nothing will leave any more
            if is_empty and is_sent:
                return
            await asyncio.sleep(0.005)

    def after_fork(self) -> None:
        """In the child of a fork: the line is the parent's."""
        if self._transport is not None and not self._disconnected.is_set():
            self._failure = self._failure or lose_line(self._transport, self._loop, self.name)
            self._tell_of_failure()

    def _tell_of_failure(self) -> None:
        """Tell everybody who waits, and the owner; what Ctrl-C cuts off may be done again."""
        if self._is_failure_reported or self._failure is None:
            return
        error = self._failure
        for timer in self._timers:
            timer.cancel()
        self._timers = ()
        for future, _ in list(self._pending.values()):
            if not future.done():
                future.set_exception(error.again())
        if not self._connected.done():
            self._connected.set_exception(error.again())
            self._connected.exception()  # read, so that asyncio does not warn that it never was
        if isinstance(error, LinkLost):
            _logger.warning("%s", error.seen)
        try:
            self._is_failure_reported = True
            self.on_lost(error)
        except KeyboardInterrupt:
            self._is_failure_reported = False  # it may not have heard, and may hear twice
            raise


# -- opening a line --------------------------------------------------------------------------------


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
        await link.wait_disconnected()  # so that the next to open the line finds it free
        raise
    return link
