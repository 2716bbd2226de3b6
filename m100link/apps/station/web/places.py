"""Who makes room when all places are taken (pure logic, ``now`` is an argument)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from typing import Protocol, TypeVar

__all__ = ["FIRST_WORD", "SILENCE", "Guest", "who_makes_room"]

FIRST_WORD = 0.5
"""Seconds in which a client has to say anything at all, where places are rare."""

SILENCE = 10.0
"""Seconds without a word after which a client may have to make room for another."""


class Guest(Protocol):
    """A client, as far as its place goes."""

    @property
    def peer(self) -> str:
        """Address that it comes from."""
        ...

    @property
    def heard_at(self) -> float:
        """When it last said anything; when it came, if it never did."""
        ...

    @property
    def has_spoken(self) -> bool:
        """Whether it ever said anything."""
        ...

    @property
    def subscribes(self) -> bool:
        """Whether it gets anything."""
        ...


G = TypeVar("G", bound=Guest)


def who_makes_room(guests: Collection[G], peer: str, now: float) -> G | None:
    """The guest whose place a newcomer gets; None if nobody has to go for it.

    First those that never said anything; then one of an address with at least two more places
    than the newcomer's would have; then whoever was silent for long, and gets nothing rather than
    something.

    Args:
        guests: Clients that may have to go: never the one that has control.
        peer: Address of the newcomer.
        now: The time.
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
