"""So much at once, so much per second: what one client may use of anything."""

from __future__ import annotations

__all__ = ["Allowance"]


class Allowance:
    """Fills with time up to a limit, and is spent (pure logic, ``now`` is an argument).

    Args:
        rate: What is gained per second.
        burst: What can be saved up; it is there at the beginning.
    """

    __slots__ = ("_at", "_burst", "_level", "_rate")

    def __init__(self, rate: float, burst: float) -> None:
        self._rate, self._burst = rate, burst
        self._level = burst
        self._at: float | None = None

    def _fill(self, now: float) -> None:
        if self._at is not None:
            self._level = min(self._burst, self._level + (now - self._at) * self._rate)
        self._at = now

    def take(self, now: float, cost: float = 1.0) -> bool:
        """Spend what is there for it; False, and nothing is spent, if that is too little."""
        self._fill(now)
        if self._level < cost:
            return False
        self._level -= cost
        return True

    def spend(self, now: float, cost: float) -> None:
        """Spend what was used already; that may be more than there is."""
        self._fill(now)
        self._level -= cost

    def wait(self, now: float) -> float:
        """Seconds until there is anything."""
        self._fill(now)
        return max(0.0, -self._level / self._rate)
