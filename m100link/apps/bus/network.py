"""The network interface of fleets and nodes of ROS 2.

Keys are words with ``/`` between them; in a pattern ``*`` stands for one word and ``**`` for any
number. There are two ways to hear. A :class:`Bus` hands over each message in the event loop that
opened the session: an agent answers questions at once. On a :class:`PolledBus` a message waits in
rings outside of Python until a step takes it: nothing of the process runs for a flood.
"""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Any, Protocol, TypeVar

_logger = logging.getLogger(__name__)


T = TypeVar("T")

SETTLED_S = 0.1
"""Seconds for an answer that contradicts. A silent session must not hold up a proved answer."""

DEPTH = 1024
"""The most messages that wait for one taker; of more than that the oldest is lost."""


@dataclass(frozen=True, slots=True)
class Received:
    payload: bytes  # empty if it is longer than its taker reads
    attachment: bytes  # sent beside them; empty where there is none


@dataclass(frozen=True, slots=True)
class Question:
    key: str  # of the question, which may be a pattern
    payload: bytes  # as in :class:`Received`
    # Takes key, payload and attachment of the answer, once. Under a key of one's own: of two
    # answers under one key the network hands over one.
    answer: Callable[..., None]
    drop: Callable[[], None]  # ends it without an answer
    attachment: bytes = b""  # as in :class:`Received`


@dataclass(frozen=True, slots=True)
class QueryAnswer:
    key: str
    payload: bytes
    session: str = ""  # id of the session that answered, as it says itself; empty when it does not
    is_proved: bool = False  # whether its signature is that of the owner of the key


Settles = Callable[[QueryAnswer], bool]


@dataclass(frozen=True, slots=True)
class TokenChange:
    key: str
    is_there: bool


class Held(Protocol):
    __slots__ = ()

    def close(self) -> None:
        """End it; may be called any number of times."""


class Outlet(Held, Protocol):
    __slots__ = ()

    def put(self, payload: bytes, attachment: bytes | None = None) -> None:
        """Send one; never waits, and a message that the network does not take is lost."""

    def put_later(self, make: Callable[..., bytes], *what: Any) -> None:
        """Send what this makes when it goes, if anything: at once, where it does not wait."""
        if payload := make(*what):
            self.put(payload)

    def is_wanted(self) -> bool:
        """Whether anybody is known to listen; kept messages are for late listeners."""
        ...


class Inbox(Protocol[T]):
    def take(self) -> list[T]:
        """All of it, oldest first; never waits."""
        ...


class Session(Protocol):
    """The common part of both kinds of a session."""

    @property
    def session(self) -> str: ...

    def declare(self, token: str) -> Held:
        """Show a token as long as the session is there, and no longer."""
        ...


class Bus(Session, Protocol):
    def publish(self, key: str, *, within: float = 0.0) -> Outlet:
        """Offer messages under a key to other sessions; one does not hear itself.

        ``within``: seconds that a message of ``put_later`` may wait for others to go with it: where
        many go, that costs a fraction. None waits for longer than until an outlet is closed.
        """
        ...

    def subscribe(
        self,
        pattern: str,
        take: Callable[[str, bytes], None],
        *,
        depth: int = DEPTH,  # what waits at most; of more than that the oldest is lost
        within: float = 0.0,
    ) -> Held:
        """Hear messages.

        ``within``: seconds that a message may wait outside of Python for others to be taken with
        it: where many come, that costs a fraction.
        """
        ...

    def serve(
        self,
        key: str,
        take: Callable[[Question], None],
        *,
        depth: int = DEPTH,
        is_first: Callable[[Question], bool] = lambda _: False,
    ) -> Held:
        """Hear questions; one that is lost or dropped looks to its asker like nobody.

        ``is_first``: what waits behind no other question, and is not lost for one. Called by other
        threads.
        """
        ...

    async def ask(
        self,
        key: str,
        payload: bytes = b"",
        *,
        timeout: float,
        attachment: bytes = b"",  # sent beside the payload
        # Called with each answer as it comes; behind one for which it is true, others have
        # :data:`SETTLED_S` seconds.
        settles: Settles | None = None,
    ) -> list[QueryAnswer]:
        """Ask everybody who serves it.

        Those who did not answer within ``timeout`` seconds are not waited for. An empty list says
        nothing at all: nobody is there, or may not answer, or did not in time, or the way there or
        back is cut.
        """
        ...

    def watch(self, pattern: str, take: Callable[[str, bool], None]) -> Held:
        """See tokens come (True) and go (False), those first that are there."""
        ...

    async def tokens(self, pattern: str, *, timeout: float) -> list[str]: ...


class PolledBus(Session, Protocol):
    """One session, in which messages wait to be taken."""

    def publish(self, key: str, *, kept: int = 0) -> Outlet:
        """Offer messages under a key to other sessions; one does not hear itself.

        So many are ``kept`` for late listeners.
        """
        ...

    def inbox(self, pattern: str, depth: int) -> Inbox[Received]:
        """Hear messages; of those not taken in time the newest ``depth`` stay."""
        ...

    def questions(self, key: str, depth: int) -> Inbox[Question]:
        """Hear questions; those that are too many get no answer."""
        ...

    def changes(self, pattern: str) -> Inbox[TokenChange]:
        """See tokens come and go, those first that are there; :data:`DEPTH` of them wait."""
        ...

    def is_alone(self) -> bool:
        """Whether it is connected to nobody: then nobody can find what it declares."""
        ...

    def probe(self, key: str, *, timeout: float) -> Inbox[bool]:
        """Ask whether anybody answers, for so many seconds: true for each who does."""
        ...


# -- what waits between zenoh's threads and the event loop: on its way in, and on its way out ------
# At a thousand aircraft, waking a thread for each message costs twenty times as much as the message
# itself. So a message that may wait a moment goes with others, and incoming ones can wait in rings.


AT_ONCE = 256
"""The most messages that are taken from one queue before others have their turn."""

TURN = 0.005
"""Seconds after which they have it in any case: a payload may be dear to read."""

_SENT_AT_ONCE = 256
"""Of many more, zenoh's queue would be full while others use the processor, and drop the rest."""

_NEXT_S = 0.001


def _do(work: Callable[..., Any], *what: Any) -> Any:
    """Make, take or send a message: the error of one, which makes None, reaches no other."""
    try:
        return work(*what)
    except Exception:
        _logger.exception("a message was not taken, or not sent")


class ThreadQueue:
    """From threads of zenoh into the event loop."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        take: Callable[..., None],
        depth: int,
        is_first: Callable[..., bool] = lambda *_: False,  # what waits behind no other
    ) -> None:
        self._loop, self._take, self._is_first = loop, take, is_first
        self._waiting: deque[tuple[Any, ...]] = deque(maxlen=depth)
        self._first: deque[tuple[Any, ...]] = deque(maxlen=depth)
        self._is_due = False

    def put(self, *what: Any) -> None:
        """Called by other threads."""
        (self._first if self._is_first(*what) else self._waiting).append(what)
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
            if not (waiting := self._first or self._waiting):
                return
            _do(self._take, *waiting.popleft())
            if perf_counter() >= until:
                break
        if not self._is_due:
            self._is_due = True
            self._loop.call_soon(self._empty)


class Ring(Inbox[T]):
    """A channel of zenoh's with room for ``depth``, and what is made of each thing in it."""

    def __init__(
        self, declared: Any, make: Callable[[Any], T], depth: int, ended: type[Exception]
    ) -> None:
        self._declared, self._make, self._depth = declared, make, depth
        self._ended = ended

    def take(self) -> list[T]:
        found: list[T] = []
        try:
            # A flood fills it as fast as it is emptied: later messages wait.
            while len(found) < self._depth and (one := self._declared.try_recv()) is not None:
                found.append(self._make(one))
        except self._ended:
            pass  # the session is closed: nothing comes any more
        return found


class Bundle:
    """Messages that wait a moment for others: one wake-up of zenoh's thread sends all of them.

    Packing a message when it goes costs a fraction of packing it when it comes: the processor has
    all of it at hand from the one before. And zenoh's thread wakes up once for those that follow
    each other closely.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._waiting: deque[tuple[Callable[[bytes], None], Callable[..., bytes], Any]] = deque()
        self._timer: asyncio.TimerHandle | None = None
        self._within = 0.0  # how long the first that waits for the timer may wait, s

    def put(
        self, within: float, send: Callable[[bytes], None], make: Callable[..., bytes], *what: Any
    ) -> None:
        """Let one wait for so many seconds at most."""
        self._waiting.append((send, make, what))
        if self._timer is None or (
            within < self._within and self._timer.when() > self._loop.time() + within
        ):
            self._send_in(within)

    def _send_in(self, seconds: float) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._timer, self._within = self._loop.call_later(seconds, self._send), seconds

    def _send(self) -> None:
        self._timer, made = None, []
        for _ in range(min(_SENT_AT_ONCE, len(self._waiting))):
            send, make, what = self._waiting.popleft()
            made.append((send, _do(make, *what)))
        for send, payload in made:
            if payload:
                _do(send, payload)
        if self._waiting:
            self._send_in(_NEXT_S)

    def flush(self) -> None:
        while self._waiting:
            self._send()


class PollingReader(Held):
    """Takes the messages of a ring every ``within`` seconds: one wake-up serves all readers."""

    def __init__(
        self, declared: Held, ring: Inbox[Any], take: Callable[..., None], within: float
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._declared, self._within = declared, within
        self._ring, self._take = ring, take
        self._found: deque[Any] = deque()  # taken from the ring, and not handed on yet
        self._is_full = False  # the ring, when it was taken from: there is more
        self._is_open = True
        self._due = (self._loop.time() // within + 1) * within
        self._timer = self._loop.call_at(self._due, self._look)

    def _look(self) -> None:
        until = perf_counter() + TURN
        if not self._found:
            self._found.extend(self._ring.take())
            self._is_full = len(self._found) >= AT_ONCE
        while self._found and self._is_open:
            _do(self._take, *self._found.popleft())
            if perf_counter() >= until:
                break
        if self._is_open:
            # Others have their turn, and then messages that are left or came meanwhile.
            if not (self._is_full or self._found):
                late, within = self._loop.time() - self._due, self._within
                self._due += within * (1 + late // within)
            self._timer = self._loop.call_at(self._due, self._look)

    def close(self) -> None:
        self._is_open = False
        self._timer.cancel()
        self._declared.close()
