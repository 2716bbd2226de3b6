"""A listening socket that admits connections one by one, once they have sent something.

asyncio's own server accepts every connection and begins a TLS handshake with each at once. Here a
connection costs only a descriptor until its first bytes arrive. Then it waits for its turn like all
input of strangers: one handshake in a turn of the loop.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import socket
import ssl
from collections.abc import Callable

from m100link.apps.station.web.door import Door
from m100link.apps.station.web.intake import Intake, Metered
from m100link.apps.station.web.logs import SparingLogger

__all__ = ["Listener"]

_AT_ONCE = 8
_FULL_PAUSE = 1.0
"""Seconds without a look after there was no descriptor, or no memory, for one more."""

_FULL = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)
_log = SparingLogger(logging.getLogger(__name__))


class Listener:
    """Listens, until it is closed.

    Args:
        listening: The socket.
        intake: Gives turns to new connections.
        door: Limits the number of connections.
        connection: Makes the protocol of a connection.
        context: For TLS, None without it.
        patience: Seconds for the first bytes, and for a handshake.
    """

    steers, is_dear = False, False

    def __init__(
        self,
        listening: socket.socket,
        intake: Intake,
        door: Door,
        connection: Callable[[], asyncio.Protocol],
        *,
        context: ssl.SSLContext | None,
        patience: float,
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
        """Accept some of the waiting connections."""
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
        """Remove a connection from the newcomers."""
        self._newcomers.discard(newcomer)

    def close(self) -> None:
        """Take no new connections."""
        if not self._is_closed:
            self._is_closed = True
            self._loop.remove_reader(self._listening)
            for one in list(self._newcomers):
                one.turn_out()

    async def wait_closed(self) -> None:
        """Return at once: closing takes no time."""


class _Newcomer:
    """A connection that has not been read yet.

    Attributes:
        peer: Address of the client.
        is_answered: Whether it may make room for another one.
    """

    steers, is_answered = False, True

    def __init__(self, listener: Listener, accepted: socket.socket, peer: str) -> None:
        self.peer = peer
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
        """Close it at once."""
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
        """Admit the connection."""
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
