"""Limits for strangers: connections, places and dear answers.

Each limit is a rule of its own; none waits or reads a clock, except for the last.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Collection
from typing import TYPE_CHECKING, Protocol, TypeVar

from m100link.apps.station.web.access_control import answer

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send


FRAME_SIZE = 64 * 1024  # bytes of a frame of a client, and of a message from fragments


# -- how many connections may speak HTTP -----------------------------------------------------------


class Visitor(Protocol):
    """A connection, as the door sees it."""

    peer: str  # address that it comes from

    @property
    def is_answered(self) -> bool:
        """Whether it asked nothing that is being answered now."""
        ...

    def turn_out(self) -> None:
        """Close it at once."""


class ConnectionLimit:
    """Lets connections in; when there are too many, the one that was idle longest goes.

    A peer that opens connections and asks nothing loses them to those that ask. WebSockets are
    counted by the application that serves them: they have left the door.
    """

    def __init__(self, *, per_peer: int = 32, total: int = 128) -> None:
        self._per_peer, self._total = per_peer, total
        self._open: dict[Visitor, None] = {}  # those that were answered last stand last
        self._count: Counter[str] = Counter()

    def __len__(self) -> int:
        return len(self._open)

    def enter(self, visitor: Visitor) -> None:
        self._open[visitor] = None
        self._count[visitor.peer] += 1
        if self._count[visitor.peer] > self._per_peer:
            self._make_room(visitor.peer, visitor)
        elif len(self._open) > self._total:
            self._make_room(self._count.most_common(1)[0][0], visitor)

    def answered(self, visitor: Visitor) -> None:
        """It asked something and has its answer."""
        if visitor in self._open:
            del self._open[visitor]
            self._open[visitor] = None

    def leave(self, visitor: Visitor) -> None:
        """It was closed, or does not speak HTTP any more."""
        if visitor in self._open:
            del self._open[visitor]
            self._count[visitor.peer] -= 1
            if not self._count[visitor.peer]:
                del self._count[visitor.peer]

    def _make_room(self, peer: str, newcomer: Visitor) -> None:
        idle = (one for one in self._open if one.peer == peer and one.is_answered)
        victim = next(idle, newcomer)
        self.leave(victim)
        victim.turn_out()


# -- who makes room when all places are taken ------------------------------------------------------

FIRST_WORD = 0.5  # seconds in which a client has to say anything at all, where places are rare
SILENCE = 10.0  # seconds without a word after which a client may have to make room for another


class Guest(Protocol):
    peer: str  # address that it comes from
    heard_at: float  # when it last said anything; when it came, if it never did
    has_spoken: bool  # whether it ever said anything

    @property
    def subscribes(self) -> bool: ...


G = TypeVar("G", bound=Guest)


def to_evict(guests: Collection[G], peer: str, now: float) -> G | None:
    """The guest whose place a newcomer gets; None if nobody has to go for it.

    First those that never said anything; then one of an address with at least two more places
    than the newcomer's would have; then one that was silent for long, and gets nothing rather than
    something.
    """
    mute = [one for one in guests if not one.has_spoken and now - one.heard_at >= FIRST_WORD]
    if mute:
        return min(mute, key=lambda one: one.heard_at)
    count = Counter(one.peer for one in guests)
    greediest, most = max(count.items(), key=lambda item: item[1], default=("", 0))
    if most >= count[peer] + 2:
        return min((one for one in guests if one.peer == greediest), key=lambda one: one.heard_at)
    silent = [one for one in guests if now - one.heard_at >= SILENCE]
    return min(silent, key=lambda one: (one.subscribes, one.heard_at), default=None)


# -- dear answers one at a time --------------------------------------------------------------------
# Building a page holds up the event loop, and with it the keys of the operator. One page costs a
# few lost key repeats, which the lifetime of a setpoint bridges; one after the other they would
# cost the flight. So each is followed by a pause that is some times as long as it took, however
# fast the machine is. A client that comes while too many wait gets a request to come again.

PAUSE = 3.0  # length of the pause after an answer, in times that it took
LONGEST_PAUSE = 1.0  # seconds that a pause lasts at most
PLACES = 8  # how many may wait

_BUSY = (
    '<!doctype html><meta http-equiv="refresh" content="1"><title>m100link</title>'
    "<p>Many clients requested this page at once. It retries by itself.</p>"
)


class PageRateLimit:
    """Lets requests for one path through to an ASGI application one at a time."""

    def __init__(self, app: ASGIApp, path: str) -> None:
        self._app = app
        self._path = path
        self._waiting = 0
        self._turn = asyncio.Lock()
        self._opens_at = 0.0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope["path"] != self._path:
            await self._app(scope, receive, send)
        elif self._waiting >= PLACES:
            headers = {"content-type": "text/html; charset=utf-8", "retry-after": "1"}
            await answer(send, 503, headers, _BUSY)
        else:
            await self._take_turn(scope, receive, send)

    async def _take_turn(self, scope: Scope, receive: Receive, send: Send) -> None:
        clock = asyncio.get_running_loop().time
        self._waiting += 1
        try:
            await self._turn.acquire()
        finally:
            self._waiting -= 1
        try:
            await asyncio.sleep(max(0.0, self._opens_at - clock()))
        except BaseException:
            self._turn.release()
            raise
        began, is_over = clock(), False

        def end() -> None:
            nonlocal is_over
            if not is_over:
                is_over = True
                now = clock()
                self._opens_at = now + min(PAUSE * (now - began), LONGEST_PAUSE)
                self._turn.release()

        async def send_built(message: Message) -> None:
            end()  # how fast its client reads is no matter of the others
            await send(message)

        try:
            await self._app(scope, receive, send_built)
        finally:
            end()
