"""Which orders come too late to be wanted still (pure logic, times are arguments).

What moves the aircraft says when it was made, by the agent's own clock. It may wait in a network,
or before an agent that stands still, longer than whoever asked: then somebody may have pressed
STOP, or asked for something else, or have given up.
"""

from __future__ import annotations

import math
from collections import deque

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
        """An order is heard for the first time.

        ``made_at``: when it was made at the earliest, s. ``now``: s.

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

    ``made_at``: when it was made at the earliest, s. ``now``: s.

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


# -- the clock of an agent, as a pilot knows it: from questions and answers, as NTP does -----------


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

        ``asked_at``: own time as it was asked, s. ``its``: the agent's time in its answer, s.
        ``answered_at``: own time as the answer came, s.
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

        ``own``: own time, s. ``answered``: what that clock showed in its agent's last answer, s.

        Raises:
            ValueError: Nothing was heard yet.
        """
        self._made_at = max(self._made_at, answered, self.its_at_least(own))
        return self._made_at
