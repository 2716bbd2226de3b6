"""A network inside one event loop, with the weather of real ones: for tests on virtual time.

What a :class:`Weather` does to a message is drawn from a seeded source, so a test that failed can
be run again. Sessions are cut off from each other by :meth:`MemoryNetwork.cut`.
"""

from __future__ import annotations

import asyncio
import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, TypeVar

from m100link.apps.bus.network import (
    DEPTH,
    SETTLED_S,
    Held,
    Inbox,
    Outlet,
    QueryAnswer,
    Question,
    Received,
    Settles,
    TokenChange,
)

T = TypeVar("T")

_TICK_S = 1e-9


@lru_cache(10_000)  # each sample of each aircraft asks for the same few
def fits(pattern: str, key: str) -> bool:
    """Whether a key is one of those that a pattern names."""
    return _fits(pattern.split("/"), key.split("/"))


def _fits(pattern: list[str], key: list[str]) -> bool:
    if not pattern:
        return not key
    if pattern[0] == "**":
        return any(_fits(pattern[1:], key[start:]) for start in range(len(key) + 1))
    return bool(key) and pattern[0] in ("*", key[0]) and _fits(pattern[1:], key[1:])


@dataclass(slots=True)
class Weather:
    """What happens to messages on their way."""

    loss: float = 0.0  # share that is lost, 0 to 1
    repeat: float = 0.0  # share that arrives twice
    delay_s: float = 0.0  # least time on the way
    jitter_s: float = 0.0  # up to so much more for each: later ones overtake
    presence_s: float = 1.5  # after which a session that was cut off counts as gone


class _Declared:
    """One thing that a session declares."""

    def __init__(self, session: MemoryBus, key: str, take: Callable[..., None] | None) -> None:
        self.session, self.key, self.take = session, key, take
        self.is_open = True

    def close(self) -> None:
        if self.is_open:
            self.is_open = False
            self.session.network.forget(self)


class MemoryInbox(Inbox[T]):
    """What waits to be taken; of too much the oldest is lost."""

    def __init__(self, depth: int) -> None:
        self.waiting: deque[T] = deque(maxlen=depth)

    def take(self) -> list[T]:
        found = list(self.waiting)
        self.waiting.clear()
        return found


class _Outlet(Outlet):
    def __init__(self, session: MemoryBus, key: str, *, is_kept: bool) -> None:
        self._session, self._key, self._is_kept = session, key, is_kept

    def put(self, payload: bytes, attachment: bytes | None = None) -> None:
        network, sender = self._session.network, self._session
        what = Received(payload, attachment or b"")
        for one in network.takers("subscribe", self._key):
            if one.session is sender:
                continue
            network.carry(sender, one.session, partial(one.session.hand, one, self._key, what))

    def is_wanted(self) -> bool:
        return self._is_kept or any(
            one.session is not self._session
            and not self._session.network.is_cut(self._session, one.session)
            for one in self._session.network.takers("subscribe", self._key)
        )

    def close(self) -> None:
        """Nothing is held."""


class _Asking:
    """A question on its way to each who serves its key, and what they answer on its way back."""

    def __init__(
        self,
        asker: MemoryBus,
        key: str,
        payload: bytes,
        hear: Callable[[QueryAnswer], None],
        attachment: bytes = b"",
    ) -> None:
        network = self._network = asker.network
        self._asker, self._hear = asker, hear
        asked = [
            one for one in network.takers("serve", key) if not network.is_cut(asker, one.session)
        ]
        self._asked = set(asked)
        self.ended = asyncio.Event()  # nobody is waited for any more
        if not asked:
            self.ended.set()
        for one in asked:
            ways = partial(self._answer, one), partial(self._end, one)
            question = Question(key, payload, *ways, attachment)
            network.carry(asker, one.session, partial(one.session.hand, one, question))

    def _answer(
        self, one: _Declared, key: str, payload: bytes, _attachment: bytes | None = None
    ) -> None:
        def arrive() -> None:
            self._hear(QueryAnswer(key, payload, one.session.session))
            self._end(one)

        self._network.carry(one.session, self._asker, arrive)

    def _end(self, one: _Declared) -> None:
        self._asked.discard(one)
        if not self._asked:
            self.ended.set()


class MemoryNetwork:
    """The network, whose weather may be changed at any time."""

    def __init__(self, seed: int = 0, weather: Weather | None = None) -> None:
        self.weather = weather or Weather()
        self._random = random.Random(seed)
        self._declared: dict[str, list[_Declared]] = {
            kind: [] for kind in ("subscribe", "serve", "token", "watch")
        }
        self._count = self._sessions = 0
        self._cut: set[MemoryBus] = set()
        # Who is known to be gone by those who are not: after a while, as by a real network.
        self._missed: set[MemoryBus] = set()

    def session(self) -> MemoryBus:
        """Another session."""
        self._sessions += 1
        return MemoryBus(self, self._sessions)

    def seed(self, seed: int) -> None:
        """Begin the weather of a seed."""
        self._random.seed(seed)

    # -- who is cut off --------------------------------------------------------------------------

    def cut(self, *sessions: MemoryBus) -> None:
        """Cut sessions off from all others, without a word."""
        self._cut.update(sessions)
        for one in sessions:
            asyncio.get_running_loop().call_later(self.weather.presence_s, self._miss, one)

    def join(self, *sessions: MemoryBus) -> None:
        """The cable is whole again."""
        for one in sessions:
            self._cut.discard(one)
            if one in self._missed:
                self._missed.discard(one)
                self._tell_tokens_of(one, is_there=True)

    def _miss(self, session: MemoryBus) -> None:
        if session in self._cut and session not in self._missed:
            self._missed.add(session)
            self._tell_tokens_of(session, is_there=False)

    def is_cut(self, one: MemoryBus, other: MemoryBus) -> bool:
        """Whether nothing goes from one to the other."""
        return one is not other and (one in self._cut or other in self._cut)

    # -- what is declared ------------------------------------------------------------------------

    def add(
        self, kind: str, session: MemoryBus, key: str, take: Callable[..., None] | None = None
    ) -> _Declared:
        """Declare something."""
        one = _Declared(session, key, take)
        self._declared[kind].append(one)
        if kind == "token":
            self._tell(one, is_there=True)
        return one

    def forget(self, gone: _Declared) -> None:
        """It is declared no more."""
        for kind, ones in self._declared.items():
            if gone in ones:
                ones.remove(gone)
                if kind == "token":
                    self._tell(gone, is_there=False)

    def takers(self, kind: str, pattern: str) -> list[_Declared]:
        """Who declared what fits, whichever of both is the pattern."""
        return [
            one for one in self._declared[kind] if fits(one.key, pattern) or fits(pattern, one.key)
        ]

    def _tell(self, token: _Declared, *, is_there: bool) -> None:
        for one in self.takers("watch", token.key):
            if not self.is_cut(token.session, one.session) and one.take is not None:
                asyncio.get_running_loop().call_soon(one.take, token.key, is_there)

    def _tell_tokens_of(self, session: MemoryBus, *, is_there: bool) -> None:
        """Those on both sides of a cut see each other go, and come."""
        for token in self._declared["token"]:
            for one in self.takers("watch", token.key):
                crosses = (token.session is session) != (one.session is session)
                if crosses and one.take is not None:
                    one.take(token.key, is_there)

    # -- what goes over it -----------------------------------------------------------------------

    def carry(self, sender: MemoryBus, taker: MemoryBus, deliver: Callable[[], None]) -> None:
        """Bring something to another session, or lose it, or bring it twice."""
        weather, chance = self.weather, self._random
        if self.is_cut(sender, taker) or chance.random() < weather.loss:
            return
        for _ in range(2 if chance.random() < weather.repeat else 1):
            delay = weather.delay_s + weather.jitter_s * chance.random()
            self._later(delay, lambda: None if self.is_cut(sender, taker) else deliver())

    def _later(self, delay: float, deliver: Callable[[], None]) -> None:
        """In the order in which it was sent, where weather does not say otherwise."""
        loop = asyncio.get_running_loop()
        if delay > 0.0:
            self._count += 1  # timers of one time come in any order
            loop.call_later(delay + _TICK_S * self._count, deliver)
        else:
            loop.call_soon(deliver)


class MemoryBus:
    """A session: a :class:`m100link.apps.bus.network.Bus` and a
    :class:`m100link.apps.bus.network.PolledBus`.
    """

    def __init__(self, network: MemoryNetwork, number: int = 0) -> None:
        self.network = network
        self._number = number

    @property
    def session(self) -> str:
        """Id of the session."""
        return f"{self._number:032x}"

    def hand(self, taker: _Declared, *what: Any) -> None:
        """Hand something over, unless its taker has gone."""
        if taker.is_open and taker.take is not None:
            taker.take(*what)

    def publish(self, key: str, *, kept: int = 0, within: float = 0.0) -> Outlet:
        """Offer messages under a key; none waits here, and who comes late gets none of them."""
        return _Outlet(self, key, is_kept=bool(kept))

    def subscribe(
        self,
        pattern: str,
        take: Callable[[str, bytes], None],
        *,
        depth: int = DEPTH,
        within: float = 0.0,
    ) -> Held:
        """Hear messages, each as it comes."""

        def heard(key: str, what: Received) -> None:
            take(key, what.payload)

        return self.network.add("subscribe", self, pattern, heard)

    def serve(
        self,
        key: str,
        take: Callable[[Question], None],
        *,
        depth: int = DEPTH,
        is_first: Callable[[Question], bool] = lambda _: False,
    ) -> Held:
        """Hear questions; none waits here."""
        return self.network.add("serve", self, key, take)

    def inbox(self, pattern: str, depth: int) -> Inbox[Received]:
        """Hear messages."""
        inbox = MemoryInbox[Received](depth)
        self.network.add("subscribe", self, pattern, lambda _, what: inbox.waiting.append(what))
        return inbox

    def questions(self, key: str, depth: int) -> Inbox[Question]:
        """Hear questions."""
        inbox = MemoryInbox[Question](depth)
        self.serve(key, inbox.waiting.append)
        return inbox

    def changes(self, pattern: str) -> Inbox[TokenChange]:
        """See tokens come and go."""
        inbox = MemoryInbox[TokenChange](DEPTH)
        self.watch(pattern, lambda key, is_there: inbox.waiting.append(TokenChange(key, is_there)))
        return inbox

    def is_alone(self) -> bool:
        return False

    def probe(self, key: str, *, timeout: float) -> Inbox[bool]:
        """Ask whether anybody answers."""
        inbox = MemoryInbox[bool](DEPTH)
        _Asking(self, key, b"", lambda _: inbox.waiting.append(True))
        return inbox

    async def ask(
        self,
        key: str,
        payload: bytes = b"",
        *,
        timeout: float,
        attachment: bytes = b"",
        settles: Settles | None = None,
    ) -> list[QueryAnswer]:
        """Ask everybody who serves it."""
        answers: dict[tuple[str, str], QueryAnswer] = {}

        def hear(answer: QueryAnswer) -> None:
            answers[answer.session, answer.key] = answer
            if settles is not None and settles(answer):
                asyncio.get_running_loop().call_later(SETTLED_S, asking.ended.set)

        asking = _Asking(self, key, payload, hear, attachment)
        try:
            async with asyncio.timeout(timeout):
                await asking.ended.wait()
        except TimeoutError:
            pass  # those who have not answered are not in the list
        return list(answers.values())

    def declare(self, token: str) -> Held:
        """Show a token."""
        return self.network.add("token", self, token)

    def watch(self, pattern: str, take: Callable[[str, bool], None]) -> Held:
        """See tokens come and go."""
        for token in self._tokens(pattern):
            asyncio.get_running_loop().call_soon(take, token, True)
        return self.network.add("watch", self, pattern, take)

    async def tokens(self, pattern: str, *, timeout: float) -> list[str]:
        """The tokens that are there."""
        return self._tokens(pattern)

    def _tokens(self, pattern: str) -> list[str]:
        found = self.network.takers("token", pattern)
        return [one.key for one in found if not self.network.is_cut(self, one.session)]
