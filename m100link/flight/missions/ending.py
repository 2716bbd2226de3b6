"""The end of a mission as something told it, until the pushes behind that agree.

A push may be wrong, or about the mission before. One that tells of an end is followed within a
tenth of a second by the next: where that tells of the mission again, the aircraft flies it on.
"""

from __future__ import annotations

import asyncio
import math

from m100link.flight.known import known
from m100link.flight.mission_state import DENIED_S, MissionKind
from m100link.flight.tasks import Commander
from m100link.protocol.records import FlightPhase, FlightStatus

__all__ = ["Ending", "Ground"]

_GOES_ON_S = 3.0  # after it, until when what is pushed of its kind is taken for the same mission
_HEARD_OUT_S = 0.6  # until when contradicting pushes are waited for at most
_MAY_FLY_A_MISSION = (FlightPhase.TAKING_OFF, FlightPhase.IN_AIR)


class Ending:
    """The end of one mission.

    Args:
        commander: The aircraft.
        kind: Which kind of mission.

    Attributes:
        told_at: When it was taken for over, or for on its way home; minus infinity before.
        is_answered: Whether the answer to a stop told it, which is not doubted.
    """

    def __init__(self, commander: Commander, kind: MissionKind) -> None:
        self._commander = commander
        self._clock = commander.link.loop.time
        self._watch = commander.missions
        self._kind = kind
        self.told_at = -math.inf
        self.is_answered = False

    def tell(self, *, is_answered: bool = False) -> None:
        """Something tells that it is over."""
        self.told_at, self.is_answered = self._clock(), is_answered

    def over(self, *, is_answered: bool) -> None:
        """The same, and that the aircraft flies nothing behind it."""
        self.tell(is_answered=is_answered)
        self._watch.ended(self._kind, is_echoing=is_answered)

    @property
    def is_contradicted(self) -> bool:
        """Whether pushes went on to tell of the mission, whatever others say between them."""
        since = self._watch.told_since(self._kind)
        # One that began later is somebody else's.
        return since is not None and since < self.told_at + _GOES_ON_S

    @property
    def is_way_home_contradicted(self) -> bool:
        """Whether pushes tell of the mission behind its end, and it is not seen to land."""
        watch = self._watch
        if watch.state.kind is not self._kind or not self.told_at < watch.received_at:
            return False
        status = known(self._commander.state, FlightStatus)
        return status is None or status.status in _MAY_FLY_A_MISSION

    async def heard_out(self) -> None:
        """Wait until two pushes more have come, and agree on whether it is flown on.

        Not when the answer to a stop told it, nor where nothing is pushed.
        """
        until, watch = self.told_at + _HEARD_OUT_S, self._watch
        while not self.is_answered and self._clock() < until:
            if watch.received_at < self.told_at - DENIED_S:
                return
            is_told = watch.state.kind is self._kind
            if self._clock() >= self.told_at + DENIED_S and is_told is (self._kind in watch.flying):
                return
            await asyncio.sleep(0.02)


class Ground:
    """Whether the aircraft stands, by more than one word.

    Args:
        commander: The aircraft.
    """

    def __init__(self, commander: Commander) -> None:
        self._commander = commander
        self._first_at: float | None = None  # when the first of the words came that agree

    def is_told(self) -> bool:
        """Whether the newest flight status says so, and one before it that was looked at."""
        state = self._commander.state
        status, at = known(state, FlightStatus), state.received_at(FlightStatus)
        if status is None or at is None or status.status != FlightPhase.STANDBY:
            self._first_at = None
            return False
        self._first_at = at if self._first_at is None else self._first_at
        return at > self._first_at
