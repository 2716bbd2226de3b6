"""How far a waypoint mission is, read from its pushes. No clock and no line: values in, news out.

Pushes are not acknowledged. An event that was lost is made up for by what the status says later, so
that a program is told of each waypoint once and in order.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from m100link.flight.known import known
from m100link.flight.missions.deck import Over
from m100link.flight.missions.events import (
    Aborted,
    ActionsDone,
    Finished,
    MissionEvent,
    MissionProgress,
    Reached,
)
from m100link.geodesy import LocalFrame
from m100link.missions.plan import AtEnd, WaypointPlan
from m100link.protocol.codes import MissionCode
from m100link.protocol.commands import missions as wire
from m100link.protocol.commands.waypoint import WaypointDownloadMission, WaypointMissionAnswer
from m100link.protocol.records import Position

if TYPE_CHECKING:
    from m100link.telemetry.state import AircraftState

__all__ = ["WaypointTrack", "broken_off"]

_BEFORE_ACTIONS, _AFTER_ACTIONS = 4, 6  # status of the event "reached" (facts W19)

News = list[MissionEvent | Over]


def broken_off(status: wire.IdleStatus | wire.IocStatus, index: int | None = None) -> Aborted:
    """What the push says that follows a mission which the aircraft broke off."""
    if not status.reason:
        return Aborted(None, "it gives no reason: the remote controller was lost, perhaps", index)
    return Aborted(status.reason, MissionCode(status.reason).meaning, index)


class WaypointTrack:
    """Reads the pushes of one waypoint mission.

    Args:
        plan: What is flown.

    Attributes:
        estimated_time: Seconds that the aircraft expects it to take; None until it says so.
        index: Waypoint that it flies to; None until a push tells.
        poll: What is asked when nothing is pushed.
    """

    poll = WaypointDownloadMission()

    def __init__(self, plan: WaypointPlan) -> None:
        self._plan = plan
        self._last = len(plan.waypoints) - 1
        self.estimated_time: float | None = None
        self.index: int | None = None
        self._status: int | None = None
        self._is_seen = False  # whether a push told of this mission: what is older says nothing
        self._reached = -1  # the newest waypoint of this run of which the program was told
        self._acted = -1  # the newest whose actions were told to have ended
        self._runs_left = plan.repeat - 1
        self._is_finished = False

    @property
    def ends_by_landing(self) -> bool:
        """Whether the plan ends with going home or landing."""
        return self._plan.at_end in (AtEnd.GO_HOME, AtEnd.LAND)

    def take(self, push: wire.MissionStatus | wire.WaypointEvent) -> News:
        """A push came."""
        told = push.status if isinstance(push, wire.MissionStatus) else push.event
        return list(self._read(told))

    def _read(self, told: object) -> Iterator[MissionEvent | Over]:
        match told:
            case wire.WaypointStatus():
                self._is_seen = True
                yield from self._fly_to(told.index)
                self._status = told.status
            case wire.IdleStatus() | wire.IocStatus() if self._is_seen:
                yield from self._idle(told)
            case wire.HotpointStatus() | wire.FollowStatus() if self._is_seen:
                yield Aborted(None, "another mission flies the aircraft", self.index)
            case wire.Uploaded() if told.valid:
                self.estimated_time = float(told.estimated_time)
            case wire.Reached():
                yield from self._reach(told.index, told.status)
            case wire.Finished():
                yield from self._finish()

    def _fly_to(self, index: int) -> Iterator[MissionEvent]:
        """It flies to that waypoint: those before it were reached."""
        if not 0 <= index <= self._last:
            return
        before, self.index = self.index, index
        if before is not None and index > before:
            yield from self._pass(index - 1)
        elif before is not None and index == 0 and before == self._last and self._runs_left:
            yield from self._begin_again()

    def _pass(self, index: int) -> Iterator[MissionEvent]:
        """Every waypoint up to that one was reached, whether events told it or not."""
        while self._reached < index:
            self._reached += 1
            yield Reached(self._reached, is_inferred=True)

    def _reach(self, index: int, status: int) -> Iterator[MissionEvent]:
        if not 0 <= index <= self._last:
            return
        if index == 0 and self._reached == self._last and self._runs_left:
            yield from self._begin_again()
        yield from self._pass(index - 1)
        if self._reached < index:
            self._reached = index
            yield Reached(index)
        if status == _AFTER_ACTIONS and self._acted < index:
            self._acted = index
            yield ActionsDone(index)

    def _begin_again(self) -> Iterator[MissionEvent]:
        """The way is flown once more, from the first waypoint."""
        yield from self._pass(self._last)
        self._runs_left -= 1
        self._reached = self._acted = -1

    def _finish(self) -> Iterator[MissionEvent | Over]:
        """The event "finished". It may come at the end of each run (facts W18, inferred).

        One run too many believed would leave an aircraft in flight that nobody stops: so it counts
        on the last waypoint, when no run is to come by our own count; otherwise the status tells.
        """
        if self.index != self._last and self._reached < self._last:
            return  # repeated or late: that of a mission before
        if self._runs_left:
            yield from self._pass(self._last)
            return
        yield from self._finished()
        if self._plan.at_end is AtEnd.HOVER:  # behind the others something goes on
            yield Over()

    def _finished(self) -> Iterator[MissionEvent]:
        if not self._is_finished:
            self._is_finished = True
            yield from self._pass(self._last)
            yield Finished()

    def _idle(self, told: wire.IdleStatus | wire.IocStatus) -> Iterator[MissionEvent | Over]:
        """No mission flies any more."""
        if not self._is_finished and (told.is_broken_off or told.reason):
            yield broken_off(told, self.index)
            return
        yield from self._finished()
        yield Over()

    def polled(self, answer: WaypointMissionAnswer) -> News:
        """What the aircraft has stored: nothing, when the mission has ended (facts K14)."""
        is_gone = answer.code in (MissionCode.NO_MISSION, MissionCode.NOT_STARTED)
        if is_gone or (answer.code is MissionCode.SUCCESS and answer.mission.count == 0):
            return [*self._finished(), Over()]
        return []

    def progress(self, elapsed: float, state: AircraftState) -> MissionProgress:
        """Where it is on its way."""
        position = known(state, Position)
        distance = None
        if position is not None and self.index is not None:
            target = self._plan.waypoints[self.index]
            here = LocalFrame(position.latitude_deg, position.longitude_deg)
            distance = math.hypot(*here.to_local(target.latitude_deg, target.longitude_deg))
        return MissionProgress(
            elapsed,
            index=self.index,
            status=self._status,
            distance_m=distance,
            height_m=None if position is None else position.height_m,
        )
