"""Which orders and setpoints come too late.

An order that moves the aircraft says when it was made, by the agent's own clock. It may wait in a
network, or for an agent that stands still, longer than its operator: meanwhile somebody may have
pressed STOP, asked for something else, or given up. Pure logic: times are arguments.
"""

from __future__ import annotations

import math
from enum import Enum

from m100link.apps.agent.messages import Steer
from m100link.apps.agent.orders import AfterStop
from m100link.errors import GuardRefused
from m100link.flight.guards import SUSPENDED_S, SuspendWatch

ORDER_AGE = "order_age"
"""Name of the guard: an order that it refuses was not carried out."""

MOST_AGE_S = 5.0
"""Seconds after which an order is not begun any more, by the agent's clock: nobody counts on it."""

MOST_AHEAD_S = SUSPENDED_S
"""Seconds by which an order may seem to be made later than now. More is a time from before the
agent's computer restarted, and says nothing of its age."""


class OrderExpiry:
    def __init__(self) -> None:
        self._suspended = SuspendWatch()
        self.not_before = -math.inf  # what was made before that time has been revoked
        # Of the order that was made last of those that were heard: number of its lease, and when.
        self._newest = (0, -math.inf)

    def revoke(self, now: float) -> None:
        """Somebody wants it stopped, or down: earlier orders are not wanted any more."""
        self.not_before = now

    def hear(self, fence: int, behind: AfterStop, made_at: float, now: float) -> None:
        """Take an order that is heard for the first time, or refuse it; as :meth:`check`."""
        self.check(behind, made_at, now)
        if self._newest[0] == fence and made_at < self._newest[1]:
            raise _late("what its asker asked for later was heard before it", made_at, now)
        self._newest = (fence, made_at)

    def check(
        self, behind: AfterStop, made_at: float, now: float, began_at: float = math.inf
    ) -> None:
        """Refuse an order that came too late as it is about to be carried out.

        ``behind``: whether it is done behind a STOP. ``made_at``: when it was made at the
        earliest, s. ``began_at``: when the request began of which it is a step, s; by default as
        it. ``now``: s.
        """
        self.require_young(behind, made_at, now)
        if min(made_at, began_at) <= self.not_before and behind is not AfterStop.DONE:
            raise _late("stop, hover or landing was asked for after it was made", made_at, now)

    def require_young(self, behind: AfterStop, made_at: float, now: float) -> None:
        """Refuse an order that nobody waits for any more, whatever else was asked for since."""
        require_young(made_at, now)
        if made_at <= self.look(now) and behind is not AfterStop.DONE:
            raise _late("this computer was suspended meanwhile", made_at, now)

    def look(self, now: float) -> float:
        """Notice a suspend of this computer, once a second; returns until when orders are void."""
        return self._suspended.void_until(now)


def require_young(made_at: float, now: float) -> None:
    """Refuse an order that nobody waits for any more, whatever else was asked for since.

    ``made_at``: when it was made at the earliest, s. ``now``: s.
    """
    if not now - made_at <= MOST_AGE_S:  # NaN is no time
        raise _late(f"it is older than {MOST_AGE_S:g} s", made_at, now)
    if made_at - now > MOST_AHEAD_S:
        raise GuardRefused(
            f"an order from {made_at - now:.1f} s in the future was not carried out",
            guard=ORDER_AGE,
            measured=now - made_at,
            limit=-MOST_AHEAD_S,
            cause="the agent's computer restarted, and the operator's program knew its old clock",
            remedy="give the order again: the answer had the new time",
        )


def _late(why: str, made_at: float, now: float) -> GuardRefused:
    when, cause = f"of {now - made_at:.1f} s ago", "the link is slow, or the agent stood still"
    if made_at == 0.0:
        when, why = "of unknown age", "it does not say when it was made"
        cause = "its program does not know the agent's clock yet"
    return GuardRefused(
        f"an order {when} was not carried out: {why}",
        guard=ORDER_AGE,
        measured=now - made_at,
        limit=MOST_AGE_S,
        cause=cause,
        remedy="look at the aircraft, and give the order again",
    )


# -- which setpoints fly ---------------------------------------------------------------------------
# An operator begins a stream of setpoints, and silence ends it. After a cut, by a network or by a
# process that stood still, it does not go on by itself: the aircraft hovers by then, until
# an operator begins another stream.


MAX_AGE_S = 0.2
"""Seconds that a setpoint may have been on its way, by the agent's own clock."""

BROKEN_S = 1.0
"""Seconds without a setpoint after which a stream has ended."""


class Dropped(Enum):
    DAMAGED = "damaged"
    STALE = "stale"  # of a lease that is not in force, or without its proof
    LATE = "late"  # too long on its way, or from the future
    REPEATED = "repeated"  # or overtaken by a newer one
    BROKEN = "broken"  # of a stream that had ended
    DUPLICATE = "namesake"  # another agent has the same name: operators see two aircraft as one


class SetpointStream:
    def __init__(self) -> None:
        self._newest, self._flown_at = (0, 0.0), 0.0  # fence and stamp; no lease has the number 0

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
    """The error for an operator who goes on with an ended stream."""
    return GuardRefused(
        "the stream of setpoints had ended; the aircraft does not fly the rest of it",
        guard="stream",
        cause=f"none came for {BROKEN_S:g} s: the network was cut, or a process stood still",
        remedy="look where the aircraft is, and begin another stream",
    )
