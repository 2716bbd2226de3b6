"""How long a client's messages are on their way (pure logic, ``now`` is an argument)."""

from __future__ import annotations

import math

MAX_LATE = 0.3
"""Seconds that a setpoint may be later than the fastest message of its client."""

MAX_ROUND_TRIP = 0.4
"""Seconds to a page and back above which nobody can steer by what it shows."""

MAX_UNHEARD = 1.0
"""Seconds for which a page that steers may not have heard the station."""

MAX_ORDER_LATE = 2.0
"""Seconds that a pressed button may be on its way: a browser keeps what it cannot send until the
network is back."""

_WINDOW = 15.0


class WayTime:
    """Judges messages by their sender's clock, whatever that clock shows.

    The fastest message of the last half minute tells how the two clocks stand to each other, up to
    the time that it was on its way itself; what is later than that waited somewhere. The round trip
    shows what is slow for all of them alike.
    """

    def __init__(self) -> None:
        # Seconds to the client and back, None before it was measured.
        self.round_trip: float | None = None
        # The smallest difference of the clocks in this window and in the one before.
        self._best = self._before = math.inf
        self._window_ends_at = -math.inf

    def late(self, sent_at: float, now: float) -> float:
        """Seconds that a message is later than the fastest."""
        if now >= self._window_ends_at:
            self._before, self._best = self._best, math.inf
            self._window_ends_at = now + _WINDOW
        self._best = min(self._best, now - sent_at)
        return now - sent_at - min(self._best, self._before)

    def echoed(self, told_at: float, held: float, now: float) -> None:
        """The client sends back a time of ours, which it heard ``held`` seconds ago."""
        self.round_trip = max(0.0, now - told_at - held)
