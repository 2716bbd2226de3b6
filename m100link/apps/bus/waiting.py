"""What waits between zenoh's threads and the event loop: on its way in, and on its way out.

Where a thousand aircraft are told of, waking a thread for each message costs twenty times what the
message itself does. So what may wait a moment goes with others, and what comes can wait in rings.
"""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Callable
from functools import partial
from time import perf_counter
from typing import Any, TypeVar

from m100link.apps.bus.network import Held, Inbox, Outlet

__all__ = ["Bundle", "Looks", "Patient", "Queue", "Ring"]

_logger = logging.getLogger(__name__)

T = TypeVar("T")

AT_ONCE = 256
"""What is taken from one queue before others have their turn."""

TURN = 0.005
"""Seconds after which they have it in any case: a payload may be dear to read."""

_SENT_AT_ONCE = 256
"""Of many more, zenoh's queue would be full while others use the processor, and drop the rest."""

_NEXT_S = 0.001


class Queue:
    """From threads of zenoh into the event loop."""

    def __init__(
        self, loop: asyncio.AbstractEventLoop, take: Callable[..., None], depth: int
    ) -> None:
        self._loop, self._take = loop, take
        self._waiting: deque[tuple[Any, ...]] = deque(maxlen=depth)
        self._is_due = False

    def put(self, *what: Any) -> None:
        """Called by other threads."""
        self._waiting.append(what)
        if not self._is_due:
            self._is_due = True
            try:
                self._loop.call_soon_threadsafe(self._empty)
            except RuntimeError:
                _logger.debug("the event loop has ended: nobody takes this")

    def _empty(self) -> None:
        self._is_due = False
        until = perf_counter() + TURN
        for _ in range(AT_ONCE):
            if not self._waiting:
                return
            try:
                self._take(*self._waiting.popleft())
            except Exception:
                # What one message leads to does not happen to the next one.
                _logger.exception("a message was not taken")
            if perf_counter() >= until:
                break
        if not self._is_due:
            self._is_due = True
            self._loop.call_soon(self._empty)


class Ring(Inbox[T]):
    """A channel of zenoh's with room for ``depth``, and what is made of each thing in it.

    Args:
        declared: What has the channel.
        make: Makes of each thing what is taken.
        depth: How many are taken at most.
        ended: What it raises when its session has ended.
    """

    def __init__(
        self, declared: Any, make: Callable[[Any], T], depth: int, ended: type[Exception]
    ) -> None:
        self._declared, self._make, self._depth = declared, make, depth
        self._ended = ended

    def take(self) -> list[T]:
        """What is in it, oldest first."""
        found: list[T] = []
        try:
            # A flood fills it as fast as it is emptied: what comes meanwhile waits.
            while len(found) < self._depth and (one := self._declared.try_recv()) is not None:
                found.append(self._make(one))
        except self._ended:
            pass  # the session is closed: nothing comes any more
        return found


class Bundle:
    """Messages that wait a moment for others: one wake-up of zenoh's thread sends all of them.

    What is made when it goes costs a fraction of what it costs when it comes: the processor has all
    of it at hand from the one before.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._waiting: deque[Callable[[], None]] = deque()
        self._timer: asyncio.TimerHandle | None = None

    def put(self, send: Callable[[], None], within: float) -> None:
        """Let one wait for so many seconds at most."""
        self._waiting.append(send)
        if self._timer is None or self._timer.when() > self._loop.time() + within:
            self._send_in(within)

    def _send_in(self, seconds: float) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self._loop.call_later(seconds, self._send)

    def _send(self) -> None:
        self._timer = None
        for _ in range(min(_SENT_AT_ONCE, len(self._waiting))):
            try:
                self._waiting.popleft()()
            except Exception:
                # What one message leads to does not happen to the next one.
                _logger.exception("a message was not sent")
        if self._waiting:
            self._send_in(_NEXT_S)

    def flush(self) -> None:
        """Send what waits."""
        while self._waiting:
            self._send()


class Patient(Outlet):
    """An outlet whose messages wait for others."""

    def __init__(self, outlet: Outlet, bundle: Bundle, within: float) -> None:
        self._outlet, self._bundle, self._within = outlet, bundle, within

    def put(self, payload: bytes, attachment: bytes | None = None) -> None:
        """Let one wait, and go."""
        self._bundle.put(partial(self._outlet.put, payload, attachment), self._within)

    def put_later(self, make: Callable[[], bytes]) -> None:
        """Let one wait, be made, and go."""
        self._bundle.put(partial(self._outlet.put_later, make), self._within)

    def is_wanted(self) -> bool:
        """Whether anybody is known to listen."""
        return self._outlet.is_wanted()

    def close(self) -> None:
        """Send what waits, and end."""
        self._bundle.flush()
        self._outlet.close()


class Looks(Held):
    """Takes what a ring has, again and again, until it is closed.

    Args:
        declared: What is closed with it.
        ring: What it looks at.
        take: Called with each thing in it.
        within: Seconds between two looks.
    """

    def __init__(
        self, declared: Held, ring: Inbox[T], take: Callable[[T], None], within: float
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._declared, self._within = declared, within
        self._ring: Inbox[Any] = ring
        self._take: Callable[[Any], None] = take
        self._found: deque[Any] = deque()  # taken from the ring, and not handed on yet
        self._is_full = False  # the ring, when it was taken from: there is more
        self._is_open = True
        self._timer = self._loop.call_later(within, self._look)

    def _look(self) -> None:
        until = perf_counter() + TURN
        if not self._found:
            self._found.extend(self._ring.take())
            self._is_full = len(self._found) >= AT_ONCE
        while self._found and self._is_open:
            try:
                self._take(self._found.popleft())
            except Exception:
                # What one message leads to does not happen to the next one.
                _logger.exception("a message was not taken")
            if perf_counter() >= until:
                break
        if self._is_open:
            # Others have their turn, and then what is left or came meanwhile.
            pause = 0.0 if self._is_full or self._found else self._within
            self._timer = self._loop.call_later(pause, self._look)

    def close(self) -> None:
        """Look no more."""
        self._is_open = False
        self._timer.cancel()
        self._declared.close()
