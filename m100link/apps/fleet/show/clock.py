"""What time it is elsewhere, and by how much that may be wrong (``now`` is an argument).

A question and its answer bracket the other clock: it was read after the question left and before
the answer came. Each round trip so gives an interval that holds the offset for certain, whatever
the network did; what several of them have in common is narrower. Between round trips the intervals
widen, because no two clocks run alike.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

DRIFT = 100e-6
"""By how much two clocks may run apart, seconds per second: 50 ppm is a cheap crystal."""

_KEPT = 32


@dataclass(frozen=True, slots=True)
class Offset:
    """The other clock less our own.

    Attributes:
        seconds: The middle of what it can be.
        bound: By how much it can be another, s.
    """

    seconds: float
    bound: float


@dataclass(frozen=True, slots=True)
class _Seen:
    """What one round trip says: the offset at that time lies between these."""

    at: float
    low: float
    high: float

    def widened(self, now: float) -> tuple[float, float]:
        more = DRIFT * abs(now - self.at)
        return self.low - more, self.high + more


class ClockEstimate:
    """Measures another clock by round trips.

    Attributes:
        steps: How often the other clock, or our own, was set: what had been measured before then
            contradicts what came, and is forgotten.
        refused: Answers that no clock gives: times that are no numbers or run backwards.
    """

    def __init__(self) -> None:
        self.steps = 0
        self.refused = 0
        self._seen: deque[_Seen] = deque(maxlen=_KEPT)

    def heard(self, sent: float, received_there: float, sent_there: float, received: float) -> bool:
        """Take a round trip into account.

        Args:
            sent: When the question left, by our clock, s.
            received_there: When it came, by the other clock.
            sent_there: When the answer left, by the other clock.
            received: When it came, by our clock.

        Returns:
            Whether it says anything; what comes by a network may be nonsense.
        """
        times = sent, received_there, sent_there, received
        if not all(map(math.isfinite, times)) or received < sent or sent_there < received_there:
            self.refused += 1
            return False
        # The other clock stood at `received_there` after we sent, and at `sent_there` before the
        # answer came. Both are told for the time of the answer, so the first gets older by the way.
        low = sent_there - received
        high = received_there - sent + DRIFT * (received - sent)
        if high < low:  # it says that it had the question for longer than the whole way took
            self.refused += 1
            return False
        new = _Seen(received, low, high)
        self._seen.append(new)
        if self._common(received) is None:
            self.steps += 1
            self._seen.clear()
            self._seen.append(new)
        return True

    def offset(self, now: float) -> Offset | None:
        """What is known at a time of our clock; None before the first round trip.

        While nobody answers the last that was known holds; its bound grows by 6 ms a minute.
        """
        common = self._common(now)
        if common is None:
            return None
        low, high = common
        return Offset((low + high) / 2, (high - low) / 2)

    def _common(self, now: float) -> tuple[float, float] | None:
        if not self._seen:
            return None
        each = [one.widened(now) for one in self._seen]
        low, high = max(low for low, _ in each), min(high for _, high in each)
        return (low, high) if low <= high else None
