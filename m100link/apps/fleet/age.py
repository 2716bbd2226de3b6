"""Which orders come too late to be wanted still (pure logic, times are arguments).

What moves the aircraft says when it was made, by the agent's own clock. It may wait in a network,
or before an agent that stands still, longer than whoever asked: then somebody may have pressed
STOP, or asked for something else, or have given up.
"""

from __future__ import annotations

import math

from m100link.errors import GuardRefused

__all__ = ["MOST_AGE_S", "ORDER_AGE", "OrderAges", "require_young"]

ORDER_AGE = "order_age"
"""Name of the guard: what it refuses was not carried out."""

MOST_AGE_S = 5.0
"""Seconds after which an order is not begun any more, by the agent's clock: nobody counts on it."""

MOST_AHEAD_S = 1.0
"""Seconds by which an order may seem to be made later than now. More is a time of before the
agent's computer was started anew, and says nothing of its age."""


class OrderAges:
    """The orders that one agent hears.

    Attributes:
        not_before: What was made before that time has been revoked.
    """

    def __init__(self) -> None:
        self.not_before = -math.inf
        # Of the order that was made last of those that were heard: number of its lease, and when.
        self._newest = (0, -math.inf)

    def revoke(self, now: float) -> None:
        """Somebody wants it stopped, or down: what was asked for before is not wanted any more."""
        self.not_before = now

    def hear(self, fence: int, made_at: float, now: float) -> None:
        """An order is heard for the first time.

        Args:
            fence: Number of its lease.
            made_at: When it was made at the earliest, s.
            now: s.

        Raises:
            GuardRefused: It is not to be carried out.
        """
        self.check(made_at, now)
        if self._newest[0] == fence and made_at < self._newest[1]:
            raise _late("what its asker asked for later was heard before it", made_at, now)
        self._newest = (fence, made_at)

    def check(self, made_at: float, now: float) -> None:
        """Look again as it is about to be carried out.

        Raises:
            GuardRefused: It is not to be carried out.
        """
        require_young(made_at, now)
        if made_at < self.not_before:
            raise _late("stop, hover or landing was asked for after it was made", made_at, now)


def require_young(made_at: float, now: float) -> None:
    """Whether somebody still waits for an order, whatever else was asked for since.

    Args:
        made_at: When it was made at the earliest, s.
        now: s.

    Raises:
        GuardRefused: Nobody does.
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
