"""The time of another clock, and the delay of its messages (pure, ``now`` is given).

The other clock may show anything. A message was sent before it came: the other clock is at most
its *passage* behind ours, our time less the time that the message says. A time of ours that comes
back was sent before it was heard: the other clock is at most that passage ahead. Both hold for
certain, whatever the network did, and the fastest passage in each direction says most. It says less
with time, for no two clocks run alike, and is forgotten once newer ones came for half a minute.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

MAX_LATE = 0.3
"""Seconds that a setpoint may be later than the fastest message of its client."""

MAX_ROUND_TRIP = 0.4
"""Seconds to a page and back above which nobody can steer by its picture."""

MAX_UNHEARD = 1.0
"""Seconds for which a page that steers may not have heard the station."""

MAX_ORDER_LATE = 2.0
"""Seconds that a pressed button may be on its way: a browser keeps what it cannot send until the
network is back."""

PAGE_GRAIN = 0.1
"""Seconds by which a browser may round its times, so that nobody is known by them."""

DRIFT = 100e-6
"""By how much two clocks may run apart, seconds per second: 50 ppm is a cheap crystal."""

_GRAIN = 1e-5
# No clock shows so much. Beyond it a double is coarser than what is measured here.
_MOST_S = 1e10
_WINDOW = 15.0
# The newest round trips show the present delay: earlier fast ones do not.
_TRIPS = 8


@dataclass(frozen=True, slots=True)
class Offset:
    """The other clock less our own."""

    seconds: float  #: the middle of the possible values
    bound: float  #: by how much it can be another, s


class _Way:
    """The fastest passage of one way, in this window and the one before."""

    def __init__(self) -> None:
        # Less the drift until then: what is least now is so at any time.
        self._least = self._before = math.inf
        self._window_ends_at = -math.inf

    def take(self, passage: float, now: float) -> float:
        if now >= self._window_ends_at:
            self._before, self._least = self._least, math.inf
            self._window_ends_at = now + _WINDOW
        self._least = min(self._least, passage - DRIFT * now)
        return min(self._least, self._before) + DRIFT * now

    def fastest(self, now: float) -> float:
        return min(self._least, self._before) + DRIFT * now


class ClockEstimate:
    """Another clock and the path to it, measured by its messages.

    ``grain``: seconds by which the other side may round its times.
    """

    def __init__(self, grain: float = _GRAIN) -> None:
        #: how often the other clock, or our own, was set; what had been measured before then
        #: contradicts what came, and is forgotten
        self.steps = 0
        self._grain = grain
        self._here, self._there = _Way(), _Way()
        self._trips: deque[float] = deque(maxlen=_TRIPS)
        self._answered_at = self._heard_at = -math.inf

    def late(self, sent_at: float, now: float, asked_at: float | None = None) -> float:
        """Take a message, sent at that time of the other clock, s; returns how old it is at least.

        That is by how many seconds it is later than the fastest; infinite for what is no time.
        ``asked_at``: as in :meth:`heard`, where the message says when a time of ours was heard.
        """
        is_answer = asked_at is not None and self.heard(asked_at, sent_at, now)
        if not abs(sent_at) < _MOST_S:  # NaN is none either
            return math.inf
        here = now - sent_at
        return max(
            0.0, here - (self._here.fastest(now) if is_answer else self._take(here, None, now))
        )

    def heard(self, asked_at: float, there: float, now: float) -> bool:
        """Take an answer, or a message that says when the other side heard a time of ours.

        ``asked_at``: when the question left, by our clock, s; and how long the other side had it.
        ``there``: when the answer left, by the other clock. ``now``: when it came, by our clock.

        Returns whether it says anything; nonsense counts as a round trip that does not end.
        """
        trip = now - asked_at
        # Nonsense of a stranger counts as a trip without an end: nobody steers by such a path.
        if not (abs(there) < _MOST_S and -self._grain <= trip < math.inf):
            self._trips.append(math.inf)
            return False
        self._trips.append(max(0.0, trip))
        self._answered_at = now
        self._take(now - there, there - asked_at + DRIFT * abs(trip) + self._grain, now)
        return True

    def _take(self, here: float, there: float | None, now: float) -> float:
        fastest = self._here.take(here, now)
        back = self._there.fastest(now) if there is None else self._there.take(there, now)
        if fastest + back >= 0.0:
            return fastest
        # Both ways together would take less than no time: a clock was set since.
        self.steps += 1
        self._heard_at = -math.inf
        self._here, self._there = _Way(), _Way()
        if there is not None:
            self._there.take(there, now)
        return self._here.take(here, now)

    def oldest(self, sent_at: float, now: float) -> float:
        """The greatest age, s, of a message made at that time of the other clock.

        Infinite where nobody knows: before the first round trip, and for a time that is not yet.
        """
        age = now - sent_at + self._there.fastest(now)
        return age if age >= 0.0 else math.inf

    def offset(self, now: float) -> Offset | None:
        """The offset at a time of our clock; None before the first round trip.

        While nobody answers the last that was known holds; its bound grows by 6 ms a minute.
        """
        here, there = self._here.fastest(now), self._there.fastest(now)
        if there == math.inf:
            return None
        return Offset((there - here) / 2, max(0.0, there + here) / 2)

    def at_least(self, now: float) -> float:
        """The earliest time that the other clock may show; 0 before the first round trip.

        It never goes back: no order was made before the one before it.
        """
        if self._there.fastest(now) == math.inf:
            return 0.0
        self._heard_at = max(self._heard_at, now - self._here.fastest(now))
        return self._heard_at

    @property
    def round_trip(self) -> float | None:
        """Seconds of the newest round trip; None before the first, and for nonsense."""
        return self._trips[-1] if self._trips and self._trips[-1] < math.inf else None

    @property
    def way_s(self) -> float:
        """Half of the shortest of the last eight round trips: the delay of a message sent now.

        Infinite before the first.
        """
        return min(self._trips, default=math.inf) / 2

    def silent_s(self, now: float) -> float:
        """Seconds since the last round trip; infinite before the first."""
        return now - self._answered_at
