"""How many connections may speak HTTP, and for how long before they ask something."""

from __future__ import annotations

from collections import Counter
from typing import Protocol

__all__ = ["Door", "Visitor"]


class Visitor(Protocol):
    """A connection, as the door sees it."""

    @property
    def peer(self) -> str:
        """Where it comes from."""
        ...

    @property
    def is_answered(self) -> bool:
        """Whether it asked nothing that is being answered now."""
        ...

    def turn_out(self) -> None:
        """Close it at once."""


class Door:
    """Lets connections in; when there are too many, the one that was idle longest goes.

    Who opens connections and asks nothing loses them to those who ask. WebSockets are counted by
    whoever serves them: they have left the door.

    Args:
        per_peer: Connections of one address.
        total: Connections of all addresses.
    """

    def __init__(self, *, per_peer: int = 32, total: int = 128) -> None:
        self._per_peer, self._total = per_peer, total
        self._open: dict[Visitor, None] = {}  # those that were answered last stand last
        self._count: Counter[str] = Counter()

    def __len__(self) -> int:
        return len(self._open)

    def enter(self, visitor: Visitor) -> None:
        """A connection was opened."""
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
