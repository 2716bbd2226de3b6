"""How long answers take on a line, measured, and how long they are therefore waited for."""

from __future__ import annotations

from collections import deque

SLOW_S = 0.3
"""Round trip, s, from which a line counts as slow. By a cable an answer takes 10 to 50 ms."""

LONGEST_WAIT_S = 30.0
"""Seconds that an answer is waited for at most, after the last transmission of its request."""

_KEPT = 8  # answers that count: one is asked for every two seconds at least while a line is kept
_MARGIN = 1.5  # by how much the next one may take longer than the longest of them


class Latency:
    """How long answers took, from the first transmission of each request.

    A lost frame makes such a time longer by the pause before its repeat, never shorter. So the
    shortest of the newest eight is what the line takes. An answer is waited for as RFC 6298 has it
    (mean and four mean deviations), and half as long again as the longest of the eight at least.
    """

    __slots__ = ("_deviation", "_mean", "_newest")

    def __init__(self) -> None:
        self._newest: deque[float] = deque(maxlen=_KEPT)
        self._mean = self._deviation = 0.0

    def note(self, seconds: float) -> None:
        """An answer came, in time or too late."""
        if not self._newest:
            self._mean, self._deviation = seconds, seconds / 2
        else:  # its alpha and beta
            self._deviation += (abs(seconds - self._mean) - self._deviation) / 4
            self._mean += (seconds - self._mean) / 8
        self._newest.append(seconds)

    @property
    def round_trip_s(self) -> float | None:
        """What a question and its answer take on this line, s; None before the first answer."""
        return min(self._newest, default=None)

    def __str__(self) -> str:
        trip = self.round_trip_s
        if trip is None:
            return "nobody has measured how slow the line is"
        return f"the line is {'slow' if self.is_slow else 'quick'}: {trip:.2g} s round trip"

    @property
    def is_slow(self) -> bool:
        """Whether that is long enough to be told."""
        return min(self._newest, default=0.0) >= SLOW_S

    @property
    def slack_s(self) -> float:
        """Seconds by which an order shows later than by a cable; 0 on a line that is not slow."""
        return _MARGIN * min(self._newest, default=0.0) if self.is_slow else 0.0

    def wait_s(self, least: float) -> float:
        """Seconds to wait for an answer that is usually waited for ``least`` seconds."""
        longest = _MARGIN * max(self._newest, default=0.0)
        return max(least, min(LONGEST_WAIT_S, max(longest, self._mean + 4 * self._deviation)))
