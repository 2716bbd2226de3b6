"""Which orders were heard, and what became of them (pure logic, ``now`` is an argument).

An order that comes twice is carried out once: the second one is answered from here.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from m100link.apps.agent.fault import MessageError
from m100link.apps.fleet.payloads import Reply

__all__ = ["KEPT_S", "OrderBook"]

KEPT_S = 600.0
"""Seconds that an id is known after what it stands for has ended."""

_MOST = 20_000


class OrderBook:
    """The orders of one agent.

    Args:
        before: Ids that an agent of this name begun; what became of them nobody knows.
        unsure_before: Some of them are lost: what was made before that time may be one, s.
    """

    def __init__(self, before: Iterable[str] = (), *, unsure_before: float = -math.inf) -> None:
        self._before = frozenset(before)
        self._unsure_before = unsure_before
        # The digest of what is under way, by id.
        self._running: dict[str, bytes] = {}
        # What became of the others and when, in the order in which they ended.
        self._ended: dict[str, tuple[float, Reply]] = {}

    def is_known(self, identity: str) -> bool:
        """Whether this agent heard it."""
        return identity in self._running or identity in self._ended

    def heard(self, identity: str, digest: bytes) -> bool:
        """Whether it heard this order.

        Raises:
            MessageError: It heard another one of that id. A listener who may order anything could
                else have the answer to its own order told as that to somebody else's.
        """
        if not self.is_known(identity):
            return False
        ended = self.reply(identity)
        if digest != (self._running[identity] if ended is None else ended.order):
            raise MessageError(
                f"another order came under the id {identity}, and this one was not carried out",
                cause="a stranger heard the id and used it first",
                remedy="ask anew: each order has an id of its own",
            )
        return True

    def was_begun_before(self, identity: str) -> bool:
        """Whether an agent before began it."""
        return identity in self._before

    def is_unsure(self, made_at: float) -> bool:
        """Whether an agent before may have begun what was made then, and its word of it is lost."""
        return made_at < self._unsure_before

    def begin(self, identity: str, digest: bytes, now: float) -> None:
        """It is heard for the first time. Those that ended long ago are forgotten."""
        self._running[identity] = digest
        while self._ended:
            old, (at, _) = next(iter(self._ended.items()))
            if now - at < KEPT_S and len(self._ended) <= _MOST:
                break
            del self._ended[old]

    def end(self, reply: Reply, now: float) -> None:
        """It is over."""
        self._running.pop(reply.id, None)
        self._ended[reply.id] = now, reply

    def reply(self, identity: str) -> Reply | None:
        """What became of it; None while it runs, or when it is not known."""
        ended = self._ended.get(identity)
        return None if ended is None else ended[1]
