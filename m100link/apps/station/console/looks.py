"""What operators said of the place before take-off, kept while their page is loaded anew.

A word counts for one person, one aircraft and one connection, for as long as it would have without
the reload, and only while the aircraft was seen to stand on the ground all the time: in a flight,
or in a gap of the telemetry, it may have come to another place. The person is the browser's tab: it
keeps a secret that no other tab has, so nobody takes off on what somebody else has seen.
"""

from __future__ import annotations

import math
import secrets
from dataclasses import dataclass
from itertools import pairwise

from m100link.apps.agent.client import AgentClient
from m100link.apps.station.console.history import History
from m100link.apps.station.console.view.checklist import FREE_FOR_S
from m100link.protocol.records import FlightPhase
from m100link.telemetry.state import AircraftState

__all__ = ["Looks"]

MOST = 256
"""Persons that are remembered."""

_STATUS = "flight_status.status"
_LONGEST_GAP_S = 1.0


@dataclass(frozen=True, slots=True)
class _Look:
    """One word.

    Attributes:
        at: When it was said, on the agent's clock, s.
        connection: The telemetry of the connection then: each connection has another.
    """

    at: float
    connection: AircraftState


class Looks:
    """Words that places are free, by person and aircraft."""

    def __init__(self) -> None:
        self._persons: dict[str, dict[str, _Look]] = {}

    def person(self, secret: object) -> str:
        """The person of whom a tab kept this secret; another one if nobody here knows it."""
        known = secret if isinstance(secret, str) and secret in self._persons else ""
        person = known or secrets.token_urlsafe(16)
        self._persons[person] = self._persons.pop(person, {})  # the newest is the last to go
        while len(self._persons) > MOST:
            del self._persons[next(iter(self._persons))]
        return person

    def say(self, person: str, aircraft: str, agent: AgentClient, *, is_free: bool) -> None:
        """A person looked around now, or takes that back."""
        words = self._persons.get(person)
        if words is None:
            return
        words.pop(aircraft, None)
        if is_free and agent.telemetry is not None:
            words[aircraft] = _Look(agent.now, agent.telemetry)

    def said_at(
        self, person: str, aircraft: str, agent: AgentClient, history: History
    ) -> float | None:
        """When that person looked around, on the agent's clock, s; None: look again."""
        look = self._persons.get(person, {}).get(aircraft)
        if look is None or agent.is_gone or agent.telemetry is not look.connection:
            return None
        age = agent.now - look.at
        if age > FREE_FOR_S:
            return None
        rows = history.rows([_STATUS], last_s=age)
        times = [utc for utc, _ in rows]
        stood = all(status == FlightPhase.STANDBY for _, status in rows)
        longest = max((after - before for before, after in pairwise(times)), default=0.0)
        is_whole = math.isfinite(longest) and longest <= _LONGEST_GAP_S
        return look.at if rows and stood and is_whole else None
