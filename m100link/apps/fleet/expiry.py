"""Which orders and setpoints come too late to be wanted still, and what another clock shows.

What moves the aircraft says when it was made, by the agent's own clock. It may wait in a network,
or before an agent that stands still, longer than whoever asked: then somebody may have pressed
STOP, or asked for something else, or have given up. Pure logic: times are arguments.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from enum import Enum

from m100link.apps.agent.messages import Steer
from m100link.errors import GuardRefused

ORDER_AGE = "order_age"
"""Name of the guard: what it refuses was not carried out."""

MOST_AGE_S = 5.0
"""Seconds after which an order is not begun any more, by the agent's clock: nobody counts on it."""

MOST_AHEAD_S = 1.0
"""Seconds by which an order may seem to be made later than now. More is a time of before the
agent's computer was started anew, and says nothing of its age."""


class OrderAges:
    """The orders that one agent hears."""

    def __init__(self) -> None:
        self.not_before = -math.inf  # what was made before that time has been revoked
        # Of the order that was made last of those that were heard: number of its lease, and when.
        self._newest = (0, -math.inf)

    def revoke(self, now: float) -> None:
        """Somebody wants it stopped, or down: what was asked for before is not wanted any more."""
        self.not_before = now

    def hear(self, fence: int, made_at: float, now: float) -> None:
        """Take an order that is heard for the first time, or refuse it.

        ``made_at``: when it was made at the earliest, s. ``now``: s.
        """
        self.check(made_at, now)
        if self._newest[0] == fence and made_at < self._newest[1]:
            raise _late("what its asker asked for later was heard before it", made_at, now)
        self._newest = (fence, made_at)

    def check(self, made_at: float, now: float) -> None:
        """Refuse an order that came too late as it is about to be carried out."""
        require_young(made_at, now)
        if made_at < self.not_before:
            raise _late("stop, hover or landing was asked for after it was made", made_at, now)


def require_young(made_at: float, now: float) -> None:
    """Refuse an order that nobody waits for any more, whatever else was asked for since.

    ``made_at``: when it was made at the earliest, s. ``now``: s.
    """
    if not now - made_at <= MOST_AGE_S:  # NaN is no time
        raise _late("nobody waits for it any more", made_at, now)
    if made_at - now > MOST_AHEAD_S:
        raise GuardRefused(
            f"an order that was made {made_at - now:.1f} s from now was not carried out",
            guard=ORDER_AGE,
            measured=now - made_at,
            limit=-MOST_AHEAD_S,
            cause="the agent's computer was started anew, and whoever asked knew its old clock",
            remedy="ask anew: the answer told what time it is there",
        )


def _late(why: str, made_at: float, now: float) -> GuardRefused:
    return GuardRefused(
        f"an order of {now - made_at:.1f} s ago was not carried out: {why}",
        guard=ORDER_AGE,
        measured=now - made_at,
        limit=MOST_AGE_S,
        cause="the way here takes long, or the agent stood still",
        remedy="look at the aircraft, and ask anew",
    )


# -- which setpoints fly ---------------------------------------------------------------------------
# A stream of setpoints is begun by its pilot and ends by silence. One that was cut, by a network or
# by a process that stood still, does not go on when the way is whole again: the aircraft hovers by
# then, and whoever wants it to move begins anew.


MAX_AGE_S = 0.2
"""Seconds that a setpoint may have been on its way, by the agent's own clock."""

BROKEN_S = 1.0
"""Seconds without a setpoint after which a stream has ended."""


class Dropped(Enum):
    """Why a setpoint is not flown."""

    DAMAGED = "damaged"
    STALE = "stale"  # of a lease that is not in force, or without its proof
    LATE = "late"  # too long on its way, or from the future
    REPEATED = "repeated"  # or overtaken by a newer one
    BROKEN = "broken"  # of a stream that had ended
    NAMESAKE = "namesake"  # another agent has the same name: its pilot sees two aircraft as one


class SetpointStream:
    """The setpoints of one aircraft."""

    def __init__(self) -> None:
        self._newest = (0, -math.inf)  # fence and stamp
        self._flown_at = -math.inf

    def drop(self, steer: Steer, *, begins: bool, fence: int, now: float) -> Dropped | None:
        """Why it is not flown; None when it is.

        ``steer``: the setpoint, stamped by the agent's clock. ``now``: the agent's time, s.
        """
        if steer.fence != fence:
            return Dropped.STALE
        if abs(now - steer.sent_at) > MAX_AGE_S:
            return Dropped.LATE
        if (steer.fence, steer.sent_at) <= self._newest:
            return Dropped.REPEATED
        is_new = steer.fence != self._newest[0] or now - self._flown_at > BROKEN_S
        if is_new and not begins:
            return Dropped.BROKEN
        self._newest, self._flown_at = (steer.fence, steer.sent_at), now
        return None


def broken() -> GuardRefused:
    """What whoever sends on is told."""
    return GuardRefused(
        "the stream of setpoints had ended; those that go on are not flown",
        guard="stream",
        cause=f"none came for {BROKEN_S:g} s: the network was cut, or a process stood still",
        remedy="look where the aircraft is, and begin anew",
    )


# -- what time it is elsewhere, and by how much that may be wrong ----------------------------------
# A question and its answer bracket the other clock: it was read after the question left and before
# the answer came. Each round trip so gives an interval that holds the offset for certain, whatever
# the network did; what several of them have in common is narrower. Between round trips the
# intervals widen, because no two clocks run alike.


DRIFT = 100e-6
"""By how much two clocks may run apart, seconds per second: 50 ppm is a cheap crystal."""

_TRIPS = 32
_NEWEST = 8
"""Round trips that say how slow the way is by now: what was fast before says nothing of it."""


@dataclass(frozen=True, slots=True)
class Offset:
    """The other clock less our own."""

    seconds: float  #: the middle of what it can be
    bound: float  #: by how much it can be another, s


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
    """Measures another clock by round trips."""

    def __init__(self) -> None:
        #: how often the other clock, or our own, was set; what had been measured before then
        #: contradicts what came, and is forgotten
        self.steps = 0
        #: answers that no clock gives, by times that are no numbers or run backwards
        self.refused = 0
        self._told = -math.inf
        self._seen: deque[_Seen] = deque(maxlen=_TRIPS)

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
            self._told = -math.inf
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

    def at_least(self, now: float) -> float:
        """What the other clock shows at the earliest; 0 before the first round trip.

        It never goes back: no order was made before the one before it.
        """
        known = self.offset(now)
        if known is None:
            return 0.0
        self._told = max(self._told, now + known.seconds - known.bound)
        return self._told

    @property
    def way_s(self) -> float:
        """Half of the shortest of the last eight round trips: how long what is sent now may take.

        Infinite before the first.
        """
        last = list(self._seen)[-_NEWEST:]
        return min((one.high - one.low for one in last), default=math.inf) / 2

    def silent_s(self, now: float) -> float:
        """Seconds since the last round trip; infinite before the first."""
        return now - self._seen[-1].at if self._seen else math.inf

    def _common(self, now: float) -> tuple[float, float] | None:
        if not self._seen:
            return None
        each = [one.widened(now) for one in self._seen]
        low, high = max(low for low, _ in each), min(high for _, high in each)
        return (low, high) if low <= high else None
