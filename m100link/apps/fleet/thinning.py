"""Telemetry for a wall: each item a few times a second, in packages as they came."""

from __future__ import annotations

import math
from functools import cache

WALL_HZ = 5.0
"""Times a second that a wall is told of each item."""

WALL_WITHIN_S = 0.05
"""Seconds that what is told to a wall may wait for others to go, or to be taken, with it."""

_BITS = 16  # of the word that says which items are in a package


@cache
def _items(flags: int) -> tuple[int, ...]:
    return tuple(bit for bit in range(_BITS) if flags >> bit & 1)


class Thinner:
    """Chooses the packages that go on (pure logic, the time is an argument).

    A package has the items that were due at its time. It goes on for the sake of an item whose next
    one, by the time between its last two, would be farther from the interval of the wall than this
    one. So what comes often waits for the package with what comes seldom, one package tells all of
    them, and each is told at its own rate or that of the wall.
    """

    def __init__(self, rate_hz: float = WALL_HZ) -> None:
        self._interval = 1.0 / rate_hz
        self._told_at = [-math.inf] * _BITS
        self._seen_at = [-math.inf] * _BITS

    def goes_on(self, flags: int, at: float) -> bool:
        """Whether a package goes on.

        ``at``: when it came, s.
        """
        told, seen, is_due = self._told_at, self._seen_at, False
        items = _items(flags)
        for bit in items:
            between = at - seen[bit]
            seen[bit] = at
            if at + between / 2 >= told[bit] + self._interval:
                is_due = True
        if is_due:
            for bit in items:
                told[bit] = at
        return is_due
