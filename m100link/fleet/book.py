"""Which orders were heard, and what became of them (pure logic, ``now`` is an argument).

An order that comes twice is carried out once: the second one is answered from here.
"""

from __future__ import annotations

from m100link.fleet.payloads import Reply

__all__ = ["KEPT_S", "OrderBook"]

KEPT_S = 600.0
"""Seconds that an id is known after it was heard first."""

_MOST = 20_000


class OrderBook:
    """The orders of one agent.

    Args:
        before: Ids that an agent of this name begun, and their POSIX times; what became of them
            nobody knows.
    """

    def __init__(self, before: dict[str, float] | None = None) -> None:
        self._before = set(before or ())
        # None while it runs.
        self._replies: dict[str, Reply | None] = {}
        self._heard_at: dict[str, float] = {}

    def is_known(self, identity: str) -> bool:
        """Whether this agent heard it."""
        return identity in self._replies

    def was_begun_before(self, identity: str) -> bool:
        """Whether an agent before began it."""
        return identity in self._before

    def begin(self, identity: str, now: float) -> None:
        """It is heard for the first time. Those that are old are forgotten."""
        self._replies[identity], self._heard_at[identity] = None, now
        while True:
            old, at = next(iter(self._heard_at.items()))  # in the order in which they were heard
            is_kept = now - at < KEPT_S and len(self._heard_at) <= _MOST
            if is_kept or self._replies[old] is None:  # what runs is kept in any case
                break
            del self._heard_at[old], self._replies[old]

    def end(self, reply: Reply) -> None:
        """It is over."""
        self._replies[reply.id] = reply

    def reply(self, identity: str) -> Reply | None:
        """What became of it; None while it runs, or when it is not known."""
        return self._replies.get(identity)
