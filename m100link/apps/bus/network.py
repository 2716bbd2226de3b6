"""What fleets and nodes of ROS 2 need of a network.

Keys are words with ``/`` between them; in a pattern ``*`` stands for one word and ``**`` for any
number. There are two ways to hear. On a :class:`Bus` whatever comes is handed over in the event
loop that opened the session: who asks an agent is answered at once. On a :class:`PolledBus` it
waits in rings outside of Python until a step takes it: nothing of the process runs for a flood.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

__all__ = [
    "DEPTH",
    "Answer",
    "Answering",
    "Bus",
    "Held",
    "Inbox",
    "Outlet",
    "PolledBus",
    "Question",
    "Received",
    "TokenChange",
    "fits",
]

T = TypeVar("T")

DEPTH = 1024
"""What waits at most for one taker; of more than that the oldest is lost."""


class Answering(Protocol):
    """Takes key, payload and attachment of an answer."""

    def __call__(self, key: str, payload: bytes, attachment: bytes | None = None, /) -> None:
        """Answer."""


@dataclass(frozen=True, slots=True)
class Received:
    """A message.

    Attributes:
        payload: The bytes; none of what is longer than its taker reads.
        attachment: What goes beside them; empty where there is none.
    """

    payload: bytes
    attachment: bytes


@dataclass(frozen=True, slots=True)
class Question:
    """Somebody asks.

    Attributes:
        key: What was asked, which may be a pattern.
        payload: The bytes of the question, as in :class:`Received`.
        answer: Takes the answer, once. Under a key of one's own: of two answers under one key the
            network hands over one.
        drop: Ends it without an answer.
        attachment: As in :class:`Received`.
    """

    key: str
    payload: bytes
    answer: Answering
    drop: Callable[[], None]
    attachment: bytes = b""


@dataclass(frozen=True, slots=True)
class Answer:
    """What somebody answered.

    Attributes:
        key: Under which key.
        payload: The bytes.
        session: Id of the session that answered, as it says itself; empty when it does not.
    """

    key: str
    payload: bytes
    session: str = ""


@dataclass(frozen=True, slots=True)
class TokenChange:
    """A token appeared, or is gone.

    Attributes:
        key: The token.
        is_there: Which of both.
    """

    key: str
    is_there: bool


class Held(Protocol):
    """Something that is declared as long as it is held."""

    def close(self) -> None:
        """End it; may be called any number of times."""


class Outlet(Held, Protocol):
    """Where messages under one key go."""

    def put(self, payload: bytes, attachment: bytes | None = None) -> None:
        """Send one; never waits, and what the network does not take is lost."""

    def put_later(self, make: Callable[[], bytes]) -> None:
        """Send what this makes when it goes: at once, where it does not wait for others."""
        self.put(make())

    def is_wanted(self) -> bool:
        """Whether anybody is known to listen; what is kept is wanted by who comes late."""
        ...


class Inbox(Protocol[T]):
    """What has come and waits."""

    def take(self) -> list[T]:
        """All of it, oldest first; never waits."""
        ...


class Bus(Protocol):
    """One session, which hands over."""

    @property
    def session(self) -> str:
        """Id of the session."""
        ...

    def publish(self, key: str, *, within: float = 0.0) -> Outlet:
        """Offer messages under a key to other sessions; one does not hear itself.

        Args:
            key: Where.
            within: Seconds that a message may wait for others to go with it: where many go, that
                costs a fraction. None waits for longer than it takes until an outlet is closed.
        """
        ...

    def subscribe(
        self,
        pattern: str,
        take: Callable[[str, bytes], None],
        *,
        depth: int = DEPTH,
        within: float = 0.0,
    ) -> Held:
        """Hear messages.

        Args:
            pattern: Which keys.
            take: Called with key and payload.
            depth: What waits at most; of more than that the oldest is lost.
            within: Seconds that a message may wait outside of Python for others to be taken with
                it: where many come, that costs a fraction.
        """
        ...

    def serve(self, key: str, take: Callable[[Question], None], *, depth: int = DEPTH) -> Held:
        """Hear questions; one that is lost or dropped looks to its asker like nobody."""
        ...

    async def ask(self, key: str, payload: bytes = b"", *, timeout: float) -> list[Answer]:
        """Ask everybody who serves it.

        Args:
            key: A key or a pattern.
            payload: The bytes of the question.
            timeout: Seconds after which those who did not answer are not waited for.

        Returns:
            What was answered. An empty list says nothing at all: nobody is there, or may not
            answer, or did not in time, or the way there or back is cut.
        """
        ...

    def declare(self, token: str) -> Held:
        """Show a token as long as the session is there, and no longer."""
        ...

    def watch(self, pattern: str, take: Callable[[str, bool], None]) -> Held:
        """See tokens come (True) and go (False), those first that are there."""
        ...

    async def tokens(self, pattern: str, *, timeout: float) -> list[str]:
        """The tokens that are there."""
        ...


class PolledBus(Protocol):
    """One session, in which what comes waits to be taken."""

    @property
    def session(self) -> str:
        """Id of the session."""
        ...

    def publish(self, key: str, *, kept: int = 0) -> Outlet:
        """Offer messages under a key to other sessions; one does not hear itself.

        Args:
            key: Where.
            kept: How many messages are kept for who comes late.
        """
        ...

    def inbox(self, pattern: str, depth: int) -> Inbox[Received]:
        """Hear messages; of what is not taken in time the newest ``depth`` stay."""
        ...

    def questions(self, key: str, depth: int) -> Inbox[Question]:
        """Hear questions; what is too much is not answered."""
        ...

    def declare(self, token: str) -> Held:
        """Show a token as long as the session is there, and no longer."""
        ...

    def changes(self, pattern: str) -> Inbox[TokenChange]:
        """See tokens come and go, those first that are there; :data:`DEPTH` of them wait."""
        ...

    def probe(self, key: str, *, timeout: float) -> Inbox[bool]:
        """Ask whether anybody answers, for so many seconds: true for each who does."""
        ...


def fits(pattern: str, key: str) -> bool:
    """Whether a key is one of those that a pattern names."""
    return _fits(pattern.split("/"), key.split("/"))


def _fits(pattern: list[str], key: list[str]) -> bool:
    if not pattern:
        return not key
    if pattern[0] == "**":
        return any(_fits(pattern[1:], key[start:]) for start in range(len(key) + 1))
    return bool(key) and pattern[0] in ("*", key[0]) and _fits(pattern[1:], key[1:])
