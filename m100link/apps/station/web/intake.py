"""Parses the input of connections piece by piece and in turn, below HTTP and WebSocket.

A parser goes through all its input without a break: 240 kB of one-byte chunks, or of empty frames,
take a second in which no setpoint goes on. So the intake reads 2 kB of a connection, parses 256
bytes, and then turns to the others. It parses connections that steer in each turn of the loop. All
others share the rest: after each of their turns comes a pause as long as the time that the process
has worked since the last one. So they get half of the time at most.

Each connection also has a budget of bytes and of events. Beyond the budget it waits; the intake
cuts off a connection that waits too long.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import socket
import ssl
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol, cast

from m100link.apps.agent.background import SparingLogger, TokenBucket
from m100link.apps.station.web.limits import ConnectionLimit

_log = SparingLogger(logging.getLogger(__name__))


READ = 2048  # bytes that are taken from a connection before it has had its turn
PIECE = 256  # bytes that are parsed without a break: 42 frames, a millisecond, at most
TURN = 0.002  # seconds after which those that do not steer leave the loop to the others
LONGEST_PAUSE = 0.1  # seconds that they pause after it at most

BYTES_RATE, BYTES_AT_ONCE = 160 * 1024.0, 512 * 1024.0
"""Bytes of one connection, per second over time and at once."""

EVENTS_RATE, EVENTS_AT_ONCE = 400.0, 800.0
"""Frames or parts of a request of one connection, per second over time and at once."""

_STEERING = 5.0  # times as much for one that holds control: its client drops what is too much

_STRAIN_RATE, _STRAIN = 0.25, 5.0
"""Seconds for which a connection may be kept waiting for its budget, per second and at once."""


class Waiting(Protocol):
    @property
    def steers(self) -> bool:
        """Whether it holds control of an aircraft."""
        ...

    @property
    def is_dear(self) -> bool:
        """Whether a step causes more work than it takes itself: only one of these in a turn."""
        ...

    def step(self) -> None:
        """Do one step; ask for another turn if there is more to do."""


class HttpTransport(Protocol):
    """The protocol on a connection: HTTP or WebSocket."""

    @property
    def events(self) -> int:
        """Frames or parts of requests that it has parsed."""
        ...

    @property
    def steers(self) -> bool: ...


class Intake:
    """Gives connections their turns; a process has one for all that it serves.

    ``work``: seconds for which this process has worked until now.
    """

    def __init__(self, work: Callable[[], float] = time.thread_time) -> None:
        self._work = work
        self._worked = work()
        self._first: deque[Waiting] = deque()
        self._others: deque[Waiting] = deque()
        self._first_is_due = self._others_are_due = False
        self._opens_at = 0.0

    def put(self, one: Waiting) -> None:
        loop = asyncio.get_running_loop()
        if one.steers:
            self._first.append(one)
            if not self._first_is_due:
                self._first_is_due = True
                loop.call_soon(self._serve_first)
        else:
            self._others.append(one)
            self._call_others(loop)

    def _call_others(self, loop: asyncio.AbstractEventLoop) -> None:
        if self._others_are_due or not self._others:
            return
        self._others_are_due = True
        if self._opens_at > loop.time():
            loop.call_at(self._opens_at, self._serve_others)
        else:
            loop.call_soon(self._serve_others)

    def _serve_first(self) -> None:
        self._first_is_due = False
        for _ in range(len(self._first)):
            self._first.popleft().step()

    def _serve_others(self) -> None:
        until = time.perf_counter() + TURN
        is_dear = False
        while self._others and not is_dear and time.perf_counter() < until:
            one = self._others.popleft()
            is_dear = one.is_dear
            one.step()
        loop, worked = asyncio.get_running_loop(), self._work()
        self._opens_at = loop.time() + min(worked - self._worked, LONGEST_PAUSE)
        self._worked = worked
        self._others_are_due = False
        self._call_others(loop)


class Metered(asyncio.BufferedProtocol, asyncio.Transport):
    """One connection: the protocol of its transport, and the transport of what speaks on it."""

    is_dear = False

    def __init__(self, intake: Intake, inner: asyncio.Protocol) -> None:
        super().__init__()
        self._intake = intake
        self._inner = inner
        self._loop = asyncio.get_running_loop()
        self._outer: asyncio.Transport  # once a client has come
        self._space = memoryview(bytearray(READ))
        self._begin = self._end = 0  # of the bytes read and not parsed
        self._bytes = TokenBucket(BYTES_RATE, BYTES_AT_ONCE)
        self._events = TokenBucket(EVENTS_RATE, EVENTS_AT_ONCE)
        self._strain = TokenBucket(_STRAIN_RATE, _STRAIN)
        self._is_queued = False  # or waits for its budget
        self._is_held = False  # by what speaks on it
        self._is_over = False

    @property
    def _connection(self) -> HttpTransport:
        return cast(HttpTransport, self._inner)

    @property
    def steers(self) -> bool:
        return self._connection.steers

    @property
    def _share(self) -> float:
        """The share of its input that its budget pays."""
        return 1.0 / _STEERING if self.steers else 1.0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._outer = cast(asyncio.Transport, transport)
        self._inner.connection_made(self)

    def connection_lost(self, exc: Exception | None) -> None:
        self._is_over = True
        self._inner.connection_lost(exc)

    def get_buffer(self, sizehint: int) -> memoryview:
        """Where the next bytes go: nothing is read before the last ones were parsed."""
        return self._space

    def buffer_updated(self, nbytes: int) -> None:
        """Bytes came in: they wait for their turn."""
        if self._is_over:
            return
        self._outer.pause_reading()
        self._begin, self._end = 0, nbytes
        self._bytes.spend(self._loop.time(), nbytes * self._share)
        self._ask_for_turn()

    def eof_received(self) -> bool | None:
        return self._inner.eof_received()

    def pause_writing(self) -> None:
        self._inner.pause_writing()

    def resume_writing(self) -> None:
        self._inner.resume_writing()

    def _ask_for_turn(self) -> None:
        if self._is_queued or self._is_held or self._is_over or self._begin == self._end:
            return
        self._is_queued = True
        now = self._loop.time()
        wait = max(self._bytes.wait(now), self._events.wait(now))
        if wait <= 0.0:
            self._intake.put(self)
        elif self._strain.take(now, wait):
            self._loop.call_later(wait, self._intake.put, self)
        else:
            _log.warning("%s is disconnected: it sends too much", self.get_extra_info("peername"))
            self.abort()

    def step(self) -> None:
        self._is_queued = False
        if self._is_over or self._is_held:
            return
        piece = bytes(self._space[self._begin : min(self._begin + PIECE, self._end)])
        self._begin += len(piece)
        spoken = self._connection  # it may be another one afterwards
        before = spoken.events
        try:
            self._inner.data_received(piece)
        except Exception:  # noqa: BLE001 - a parser's own fault costs this connection alone
            _log.exception("what a connection sent was not understood")
            self.abort()
        self._events.spend(self._loop.time(), (spoken.events - before) * self._share)
        self._go_on()

    def _go_on(self) -> None:
        if self._begin < self._end:
            self._ask_for_turn()
        elif not self._is_over:
            self._outer.resume_reading()

    # -- the side of what speaks on it -----------------------------------------------------------

    def set_protocol(self, protocol: asyncio.BaseProtocol) -> None:
        self._inner = cast(asyncio.Protocol, protocol)

    def get_protocol(self) -> asyncio.BaseProtocol:
        return self._inner

    def put_back(self, count: int) -> None:
        """Give the last bytes back: they are for the new protocol, not for the one before."""
        self._begin -= count

    def pause_reading(self) -> None:
        self._is_held = True

    def resume_reading(self) -> None:
        self._is_held = False
        self._ask_for_turn()

    def close(self) -> None:
        """Close it once all output is sent; drop input that waits to be parsed."""
        self._is_over = True
        self._outer.close()

    def abort(self) -> None:
        self._is_over = True
        self._outer.abort()

    def is_closing(self) -> bool:
        return self._outer.is_closing()

    def write(self, data: Any) -> None:
        self._outer.write(data)

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        return self._outer.get_extra_info(name, default)

    def get_write_buffer_size(self) -> int:
        return self._outer.get_write_buffer_size()


# -- a listening socket that admits connections one by one -----------------------------------------
# asyncio's own server accepts every connection and begins a TLS handshake with each at once. Here a
# connection costs only a descriptor until its first bytes arrive. Then it waits for its turn like
# all input of strangers: one handshake in a turn of the loop.

_AT_ONCE = 8
_FULL_PAUSE = 1.0
"""Seconds without a look after there was no descriptor, or no memory, for one more."""

_FULL = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)


class SocketListener:
    steers, is_dear = False, False

    def __init__(
        self,
        listening: socket.socket,
        intake: Intake,  # gives turns to new connections
        door: ConnectionLimit,  # limits the number of connections
        connection: Callable[[], asyncio.Protocol],  # makes the protocol of a connection
        *,
        context: ssl.SSLContext | None,  # for TLS, None without it
        patience: float,  # seconds for the first bytes, and for a handshake
    ) -> None:
        self._listening = listening
        self._loop = asyncio.get_running_loop()
        self.intake, self.door, self.connection = intake, door, connection
        self.context, self.patience = context, patience
        self._newcomers: set[_Newcomer] = set()
        self._is_closed = False
        self._listen()

    def _listen(self) -> None:
        if not self._is_closed:
            self._loop.add_reader(self._listening, self._ready)

    def _ready(self) -> None:
        self._loop.remove_reader(self._listening)
        self.intake.put(self)

    def step(self) -> None:
        if self._is_closed:
            return
        for _ in range(_AT_ONCE):
            try:
                accepted, address = self._listening.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                break
            except OSError as error:
                _log.error("no connection can be accepted: %s", error.strerror or error)
                if error.errno in _FULL:
                    self._loop.call_later(_FULL_PAUSE, self._listen)
                return
            accepted.setblocking(False)
            self._newcomers.add(_Newcomer(self, accepted, str(address[0])))
        self._listen()

    def forget(self, newcomer: _Newcomer) -> None:
        self._newcomers.discard(newcomer)

    def close(self) -> None:
        if not self._is_closed:
            self._is_closed = True
            self._loop.remove_reader(self._listening)
            for one in list(self._newcomers):
                one.turn_out()

    async def wait_closed(self) -> None:
        """Return at once: closing takes no time."""


class _Newcomer:
    steers, is_answered = False, True

    def __init__(self, listener: SocketListener, accepted: socket.socket, peer: str) -> None:
        self.peer = peer  # address of the client
        self._listener, self._accepted = listener, accepted
        self._loop = asyncio.get_running_loop()
        self._task: asyncio.Task[None] | None = None
        self._is_entering = False  # a task that was made has not begun yet
        self._patience = self._loop.call_later(listener.patience, self.turn_out)
        self._loop.add_reader(accepted, self._ready)
        listener.door.enter(self)

    @property
    def is_dear(self) -> bool:
        """Whether a step costs much: a handshake does."""
        return self._listener.context is not None

    def _ready(self) -> None:
        self._loop.remove_reader(self._accepted)
        self._listener.intake.put(self)

    def turn_out(self) -> None:
        self._leave()
        if self._task is not None:
            self._task.cancel()
        if not self._is_entering:  # else its transport closes the socket
            self._loop.remove_reader(self._accepted)
            self._accepted.close()

    def _leave(self) -> None:
        self._patience.cancel()
        self._listener.door.leave(self)
        self._listener.forget(self)

    def step(self) -> None:
        if self._accepted.fileno() >= 0:
            self._patience.cancel()
            self._task = asyncio.create_task(self._enter(), name="m100link station: newcomer")

    async def _enter(self) -> None:
        self._is_entering = True
        listener = self._listener
        patience = listener.patience if listener.context is not None else None
        try:
            # A handshake that fails or takes too long is its client's affair.
            with contextlib.suppress(OSError):
                await self._loop.connect_accepted_socket(
                    lambda: Metered(listener.intake, listener.connection()),
                    self._accepted,
                    ssl=listener.context,
                    ssl_handshake_timeout=patience,
                    ssl_shutdown_timeout=patience,
                )
        finally:
            self._leave()
