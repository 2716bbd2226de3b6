"""The clock of an agent, as a pilot knows it: from questions and answers, as NTP does."""

from __future__ import annotations

from collections import deque

__all__ = ["AgentClock"]

_KEPT = 8


class AgentClock:
    """What the clock of an agent shows (pure logic, times are arguments).

    Of the last exchanges the one that took the shortest time is believed: it cannot be wrong by
    more than half of that time.
    """

    def __init__(self) -> None:
        self._exchanges: deque[tuple[float, float]] = deque(maxlen=_KEPT)
        self._made_at = 0.0

    def heard(self, asked_at: float, its: float, answered_at: float) -> None:
        """An exchange.

        Args:
            asked_at: Own time as it was asked, s.
            its: The agent's time in its answer, s.
            answered_at: Own time as the answer came, s.
        """
        way = answered_at - asked_at
        self._exchanges.append((way / 2, its - (asked_at + answered_at) / 2))

    @property
    def bound_s(self) -> float | None:
        """By how much it is wrong at most; None before the first exchange."""
        return min(self._exchanges)[0] if self._exchanges else None

    def its(self, own: float) -> float:
        """The agent's time at an own time, s.

        Raises:
            ValueError: Nothing was heard yet.
        """
        if not self._exchanges:
            raise ValueError("nothing was heard of that clock")
        return own + min(self._exchanges)[1]

    def its_at_least(self, own: float) -> float:
        """What the agent's clock shows at an own time at the earliest, s.

        Raises:
            ValueError: Nothing was heard yet.
        """
        return self.its(own) - min(self._exchanges)[0]

    def made_at(self, own: float, answered: float) -> float:
        """When an order that is made now was made at the earliest, by that clock, s.

        What is asked for after an answer was made after it, however well the clock is known; and no
        order was made before the one before it.

        Args:
            own: Own time, s.
            answered: What that clock showed in its agent's last answer, s.

        Raises:
            ValueError: Nothing was heard yet.
        """
        self._made_at = max(self._made_at, answered, self.its_at_least(own))
        return self._made_at
