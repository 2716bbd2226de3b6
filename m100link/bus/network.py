"""What a fleet needs of a network.

Keys are words with ``/`` between them; in a pattern ``*`` stands for one word and ``**`` for any
number. Whatever is handed over is called in the event loop that opened the session.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

__all__ = ["DEPTH", "Answer", "Bus", "Held", "Outlet", "Question", "fits"]

DEPTH = 1024
"""What waits at most for one taker; of more than that the oldest is lost."""


@dataclass(frozen=True, slots=True)
class Question:
    """Somebody asks.

    Attributes:
        key: What was asked, which may be a pattern.
        payload: The bytes of the question.
        answer: Takes key and payload of the answer, once. A key of one's own: of two answers under
            one key the network hands over one.
        drop: Ends it without an answer.
    """

    key: str
    payload: bytes
    answer: Callable[[str, bytes], None]
    drop: Callable[[], None]


@dataclass(frozen=True, slots=True)
class Answer:
    """What somebody answered.

    Attributes:
        key: Under which key.
        payload: The bytes.
    """

    key: str
    payload: bytes


class Held(Protocol):
    """Something that is declared as long as it is held."""

    def close(self) -> None:
        """End it; may be called any number of times."""


class Outlet(Held, Protocol):
    """Where messages under one key go."""

    def put(self, payload: bytes) -> None:
        """Send one; never waits, and what the network does not take is lost."""

    def is_wanted(self) -> bool:
        """Whether anybody is known to listen."""
        ...


class Bus(Protocol):
    """One session."""

    def publish(self, key: str) -> Outlet:
        """Offer messages under a key."""
        ...

    def subscribe(
        self, pattern: str, take: Callable[[str, bytes], None], *, depth: int = DEPTH
    ) -> Held:
        """Hear messages: key and payload."""
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


def fits(pattern: str, key: str) -> bool:
    """Whether a key is one of those that a pattern names."""
    return _fits(pattern.split("/"), key.split("/"))


def _fits(pattern: list[str], key: list[str]) -> bool:
    if not pattern:
        return not key
    if pattern[0] == "**":
        return any(_fits(pattern[1:], key[start:]) for start in range(len(key) + 1))
    return bool(key) and pattern[0] in ("*", key[0]) and _fits(pattern[1:], key[1:])
