"""Which setpoints fly (pure logic, ``now`` is an argument).

A stream of setpoints is begun by its pilot and ends by silence. One that was cut, by a network or
by a process that stood still, does not go on when the way is whole again: the aircraft hovers by
then, and whoever wants it to move begins anew.
"""

from __future__ import annotations

import math
from enum import Enum

from m100link.apps.agent.messages import Steer
from m100link.errors import GuardRefused

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
