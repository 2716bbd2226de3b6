"""Telemetry for a wall: each item a few times a second, in packages as they came."""

from __future__ import annotations

__all__ = ["WALL_HZ", "Thinner"]

WALL_HZ = 5.0
"""Times a second that a wall is told of each item."""

_EARLY = 0.9  # of the interval: packages come with jitter, and the next one may be late


class Thinner:
    """Chooses the packages that go on (pure logic, the time is an argument).

    A package has the items that were due at its time. It goes on when it has one that was not told
    for an interval: then every item is told at its own rate, or that of the wall.

    Args:
        rate_hz: Times a second for each item.
    """

    def __init__(self, rate_hz: float = WALL_HZ) -> None:
        self._interval = _EARLY / rate_hz
        self._told_at: dict[int, float] = {}

    def goes_on(self, flags: int, at: float) -> bool:
        """Whether a package goes on.

        Args:
            flags: The items in it, a bit for each.
            at: When it came, s.
        """
        told, interval = self._told_at, self._interval
        bits = [bit for bit in range(16) if flags >> bit & 1]
        if all(at - told.get(bit, -1e9) < interval for bit in bits):
            return False
        told.update(dict.fromkeys(bits, at))
        return True
