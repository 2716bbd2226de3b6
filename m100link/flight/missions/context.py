"""The context of a mission, and a tracker for each kind."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from m100link.errors import GuardRefused, M100Error, TelemetryStalled, UsageError
from m100link.flight.guards import known
from m100link.flight.lifecycle import StopCause
from m100link.flight.missions.events import (
    Aborted,
    ActionsDone,
    Finished,
    MissionEvent,
    MissionProgress,
    Reached,
)
from m100link.flight.tasks import describe_situation, is_on_ground, stands
from m100link.geodesy import distance_m
from m100link.missions.plan import AtEnd, WaypointPlan
from m100link.protocol.codes import MissionCode
from m100link.protocol.command import Request
from m100link.protocol.commands import missions as wire
from m100link.protocol.commands.missions import MissionStatus, WaypointEvent
from m100link.protocol.commands.waypoint import WaypointDownloadMission, WaypointMissionAnswer
from m100link.protocol.records import Battery, Position

if TYPE_CHECKING:
    from m100link.flight.guards import Envelope, GuardKeeper
    from m100link.flight.tasks import Commander
    from m100link.telemetry.state import AircraftState


class Over(NamedTuple):
    """The aircraft says that it does not fly the mission any more."""


News = list[MissionEvent | Over]


class MissionTracker(ABC):
    """Tracks one kind of mission: reads its pushes, and the answers to its poll."""

    poll: Request[Any] | None = None  # the question when nothing is pushed; None: there is none
    ends_by_landing = False  # whether the aircraft goes home or lands behind :class:`Finished`

    @abstractmethod
    def take(self, push: MissionStatus | WaypointEvent) -> News:
        """A push came."""

    def polled(self, answer: Any) -> News:
        """The answer to ``poll`` came."""
        return []

    @abstractmethod
    def progress(self, elapsed: float, state: AircraftState) -> MissionProgress:
        """How far it is."""


class Block(Protocol):
    """The part of a control block that a mission in it uses."""

    @property
    def is_open(self) -> bool:
        """Whether the program is in it, and nothing has ended it."""
        ...

    def require_flying(self, what: str) -> None:
        """Raise unless it may send."""

    def waiting(self, what: str) -> AbstractContextManager[None]:
        """End a wait in here with it."""
        ...

    def end(self, cause: StopCause, failure: M100Error | None = None) -> None:
        """End it: its stop path begins."""


@dataclass(frozen=True, slots=True)
class MissionContext:
    """The objects that a mission uses."""

    commander: Commander
    guards: GuardKeeper  # asked before it begins and while it flies
    block: Block  # the control block around it
    make_way: Callable[[str], Awaitable[None]]  # lets nothing else steer


# -- the guards of a mission before its first byte is sent -----------------------------------------


# Horizontal metres to the first waypoint, centre or target from which a mission must be allowed by
# name: a plan of another place is a mistake that is made.
FAR_M = 500.0

_WHAT = "the waypoint mission"


async def require_airborne(
    context: MissionContext, what: str, *, may_take_off: bool = False
) -> bool:
    """Wait for the values of the guards, and see that the aircraft flies, or may take off.

    Returns whether it stands on the ground. Raises ``UsageError``: it stands on the ground, and
    nobody said that it may take off. Raises ``TelemetryStalled``: nobody knows whether it flies.
    Raises ``GuardRefused``: battery below its floor or unknown, position unknown, GPS too weak.
    """
    await context.guards.admit_mission(what)
    state = context.commander.state
    on_ground = await stands(state)
    if on_ground is None:
        raise TelemetryStalled(
            f"{what} was asked for, and nobody knows whether the aircraft is on the ground",
            cause="the flight status is not sent, or velocity or height contradicts it",
            remedy="set the item to 1 Hz or more in the PC assistant",
        )
    # Started on the ground it may take off by itself, as DJI's sample does: by name alone.
    if not may_take_off:
        require_off_ground(state, what)
    return on_ground


def require_off_ground(state: AircraftState, what: str) -> None:
    """Raise ``UsageError`` where it is seen to stand on the ground."""
    if is_on_ground(state):
        raise UsageError(
            f"{what} was asked for on the ground ({describe_situation(state.situation())})",
            cause="the aircraft may take off by itself when a mission starts",
            remedy="await control.take_off() first; a waypoint mission takes take_off=True",
        )


def check_envelope(envelope: Envelope, plan: WaypointPlan) -> None:
    """Raise ``GuardRefused`` where a height or the speed of a plan lies outside, from anywhere."""
    for index, point in enumerate(plan.waypoints):
        envelope.check(f"waypoint {index} of {_WHAT}", height=point.height)
    envelope.check(_WHAT, speed=abs(plan.speed))


def check_plan(
    guards: GuardKeeper, state: AircraftState, plan: WaypointPlan, *, allow_far: bool
) -> None:
    """Raise ``GuardRefused`` unless a plan may be flown from here, within the envelope."""
    envelope = guards.guards.envelope
    if envelope is not None:
        check_envelope(envelope, plan)
    for index, point in enumerate(plan.waypoints):
        place = point.latitude_deg, point.longitude_deg
        guards.check_target(f"waypoint {index} of {_WHAT}", place)
    first = plan.waypoints[0]
    check_way(state, _WHAT, (first.latitude_deg, first.longitude_deg), allow_far=allow_far)


def check_battery(guards: GuardKeeper, state: AircraftState, plan: WaypointPlan) -> None:
    """Raise ``GuardRefused`` unless the charge, by estimate, lasts for the plan and the floor."""
    floor = guards.guards.battery_floor_percent
    battery, position = known(state, Battery), known(state, Position)
    if floor is None or battery is None:
        return  # without a charge and with a floor nothing comes here
    home = None if position is None else (position.latitude_deg, position.longitude_deg)
    needed = plan.estimate(home=home).battery_percent
    # A plan that only the pilot's stick moves has no estimate; the floor ends it in flight.
    if math.isfinite(needed) and battery.percent - needed < floor:
        raise GuardRefused(
            f"the waypoint mission was refused: it takes about {needed:.0f} % of a battery, which "
            f"has {battery.percent} %, and {floor} % are to be left",
            guard="battery_floor_percent",
            measured=battery.percent,
            limit=floor + needed,
            cause="the estimate reckons with a TB47D and 500 g; nothing of it was measured",
            remedy="a full battery, or a shorter plan",
            off="Guards(battery_floor_percent=…)",
        )


def metres_to(state: AircraftState, place: tuple[float, float]) -> float | None:
    """Horizontally, from the aircraft to a latitude and longitude, °; None: nobody knows."""
    here = known(state, Position)
    return None if here is None else distance_m(here.latitude_deg, here.longitude_deg, *place)


def height_of(state: AircraftState) -> float | None:
    """Above the take-off point, m; None: nobody knows."""
    here = known(state, Position)
    return None if here is None else here.height_m


def check_way(
    state: AircraftState, what: str, place: tuple[float, float], *, allow_far: bool
) -> float:
    """Metres to where a mission begins, 0: unknown. ``GuardRefused``: over 500, not allowed."""
    distance = metres_to(state, place) or 0.0
    if distance > FAR_M and not allow_far:
        raise GuardRefused(
            f"{what} was refused: it begins {distance:.0f} m from here, the limit is {FAR_M:g} m",
            guard="allow_far",
            measured=distance,
            limit=FAR_M,
            cause="a plan of another place, or latitude and longitude in the wrong order",
            remedy="fly nearer",
            off="allow_far=True",
        )
    return distance


# -- how far a waypoint mission is, read from its pushes: values in, news out ----------------------
# Pushes are not acknowledged. The status makes up for an event that was lost, so that a program
# gets the event of each waypoint once and in order.


_BEFORE_ACTIONS, _AFTER_ACTIONS = 4, 6  # status of the event "reached"; DJI's comment


def ended_by(report: object) -> News:
    """The end of a mission without an end of its own: a push that shows that it was broken off."""
    match report:
        case wire.IdleStatus() | wire.IocStatus():
            return [broken_off(report)]
        case wire.WaypointStatus() | wire.HotpointStatus() | wire.FollowStatus():
            return [Aborted(None, "another mission flies the aircraft")]
    return []


def broken_off(status: wire.IdleStatus | wire.IocStatus, index: int | None = None) -> Aborted:
    """The event of a push that follows a mission which the aircraft broke off."""
    if not status.reason:
        return Aborted(None, "it gives no reason: the remote controller was lost, perhaps", index)
    return Aborted(status.reason, MissionCode(status.reason).meaning, index)


class WaypointTracker(MissionTracker):
    """Reads the pushes of one waypoint mission."""

    poll = WaypointDownloadMission()  # the question when nothing is pushed

    def __init__(self, plan: WaypointPlan) -> None:
        self._plan = plan
        self._last = len(plan.waypoints) - 1
        # Seconds that the aircraft expects it to take; None until it says so.
        self.estimated_time: float | None = None
        self.index: int | None = None  # waypoint that it flies to; None until a push tells
        self._status: int | None = None
        self._is_seen = False  # whether a push reported this mission: older ones say nothing
        self._reached = -1  # the newest waypoint of this run that the program got an event of
        self._acted = -1  # the newest whose actions were reported to have ended
        self._runs_left = plan.repeat - 1
        self._is_finished = False
        self.ends_by_landing = plan.at_end in (AtEnd.GO_HOME, AtEnd.LAND)

    def take(self, push: MissionStatus | WaypointEvent) -> News:
        """A push came."""
        news = push.status if isinstance(push, MissionStatus) else push.event
        return list(self._read(news))

    def _read(self, news: object) -> Iterator[MissionEvent | Over]:
        match news:
            case wire.WaypointStatus():
                self._is_seen = True
                yield from self._fly_to(news.index)
                self._status = news.status
            case wire.IdleStatus() | wire.IocStatus() if self._is_seen:
                yield from self._idle(news)
            case wire.HotpointStatus() | wire.FollowStatus() if self._is_seen:
                yield Aborted(None, "another mission flies the aircraft", self.index)
            case wire.Uploaded() if news.valid:
                self.estimated_time = float(news.estimated_time)
            case wire.Reached():
                yield from self._reach(news.index, news.status)
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
        """Every waypoint up to that one was reached, with or without an event."""
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
        """The event "finished". It may come at the end of each run (inferred)."""
        # Believed a run too early, it would leave an aircraft in flight that nobody stops. So it
        # counts on the last waypoint, with no run to come by our own count; else the status tells.
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

    def _idle(self, status: wire.IdleStatus | wire.IocStatus) -> Iterator[MissionEvent | Over]:
        if not self._is_finished and (status.is_broken_off or status.reason):
            yield broken_off(status, self.index)
            return
        yield from self._finished()
        yield Over()

    def polled(self, answer: WaypointMissionAnswer) -> News:
        """The stored mission was read: there is none after its end (seen on an M100)."""
        is_gone = answer.code in (MissionCode.NO_MISSION, MissionCode.NOT_STARTED)
        if is_gone or (answer.code is MissionCode.SUCCESS and answer.mission.count == 0):
            return [*self._finished(), Over()]
        return []

    def progress(self, elapsed: float, state: AircraftState) -> MissionProgress:
        """Where it is on its way."""
        distance = None
        if self.index is not None:
            target = self._plan.waypoints[self.index]
            distance = metres_to(state, (target.latitude_deg, target.longitude_deg))
        return MissionProgress(elapsed, self.index, self._status, distance, height_of(state))
