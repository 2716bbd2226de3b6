"""The fate of the beats of a press: sent, flown, or refused and why.

The page shows this fate instead of what it sent. A beat counts as flown once the agent took it. The
agent answers only beats that it refuses, and reports its state all the time. So when it has
reported since, and no refusal of a beat older than :data:`CERTAIN_AFTER` seconds came, that beat
was flown.
"""

from __future__ import annotations

import math
from enum import StrEnum

from m100link.apps.agent.client import AgentClient
from m100link.errors import GuardRefused, M100Error
from m100link.protocol.records import FlightPhase, FlightStatus

__all__ = ["CERTAIN_AFTER", "Fate", "Press"]

CERTAIN_AFTER = 0.1
"""Seconds in which the agent would have refused."""

_TOLD_FOR = 0.3  # as long as a beat lasts: it was refused just now
_STATUS_AGE_S = 2.5


class Fate(StrEnum):
    """What the page shows of a held key, stick or gamepad."""

    SENT = "sent"  # nobody knows yet
    FLOWN = "flown"
    NO_CONTROL = "no_control"  # this tab has none, or the aircraft obeys somebody else
    ON_GROUND = "on_ground"  # it stands: setpoints move nothing
    SLOW = "slow"
    LET_GO = "let_go_first"
    REFUSED = "refused"  # the line of problems says why


_GUARDS = {
    "way_late": Fate.SLOW,
    "way_unheard": Fate.SLOW,
    "way_round_trip": Fate.SLOW,
    "setpoint_age": Fate.SLOW,
    "let_go": Fate.LET_GO,
}


class Press:
    """One press of keys, sticks or a gamepad, and how much of it was carried out."""

    def __init__(self) -> None:
        # When it began to go on to the agent, when it last did, and when it was last refused.
        self._since = self._passed_at = self._refused_at = -math.inf
        self._why = Fate.REFUSED

    def passed(self, now: float) -> None:
        """Note that a beat went on to the agent."""
        if now - self._passed_at > _TOLD_FOR:
            self._since = now
        self._passed_at = now

    def refused(self, error: M100Error, now: float) -> None:
        """Note that a beat was refused, here or by the agent."""
        guard = error.guard if isinstance(error, GuardRefused) else ""
        self._why, self._refused_at = _GUARDS.get(guard, Fate.REFUSED), now
        self._passed_at = -math.inf  # what comes after it is another press

    def fate(self, agent: AgentClient, now: float, *, has_lease: bool) -> Fate:
        """Return its fate until now."""
        if not has_lease or not agent.has_authority:
            return Fate.NO_CONTROL
        if now - self._refused_at <= _TOLD_FOR:
            return self._why
        telemetry = agent.telemetry
        status = None if telemetry is None else telemetry.fresh(FlightStatus, within=_STATUS_AGE_S)
        if status is not None and status.status == FlightPhase.STANDBY:
            return Fate.ON_GROUND
        if self._passed_at < self._since or agent.heard_at - self._since < CERTAIN_AFTER:
            return Fate.SENT
        return Fate.FLOWN
