"""The events of a mission for its program, and the table of its states."""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import Literal, NamedTuple

from m100link.errors import M100Error, MissionRefused
from m100link.flight.mission_state import MissionKind
from m100link.protocol.codes import MissionCode
from m100link.protocol.command import Request
from m100link.protocol.commands.hotpoint import (
    FollowPauseResume,
    FollowStop,
    HotpointPauseResume,
    HotpointStop,
)
from m100link.protocol.commands.waypoint import WaypointPauseResume, WaypointStartStop

__all__ = [
    "Aborted",
    "ActionsDone",
    "Finished",
    "MissionEvent",
    "MissionProgress",
    "Paused",
    "Reached",
    "Resumed",
    "Started",
    "Stopped",
    "Uploaded",
    "Uploading",
]


@dataclass(frozen=True, slots=True)
class Uploading:
    """The aircraft has taken a waypoint; ``progress`` gets it while a mission is entered."""

    index: int  #: Which, counted from 0.
    total: int  #: How many there are.


@dataclass(frozen=True, slots=True)
class Uploaded:
    """The aircraft has the whole plan and found it good; nothing flies yet."""

    points: int  #: Number of waypoints.
    #: Seconds that the aircraft expects it to take; None if it did not say.
    estimated_time: float | None


@dataclass(frozen=True, slots=True)
class Started:
    """The aircraft accepted the start: from here on it flies by itself and ignores setpoints."""


@dataclass(frozen=True, slots=True)
class Reached:
    """A waypoint was reached. Once for each point and run."""

    index: int  #: Which, counted from 0.
    #: No event of the aircraft reported it, but it flies on to a later one. So it is when an event
    #: was lost, and at the points between with ``Trace.COORDINATED_TURNS``, which are passed by.
    is_inferred: bool = False


@dataclass(frozen=True, slots=True)
class ActionsDone:
    """The actions of a waypoint have ended."""

    index: int  #: Which waypoint, counted from 0.


@dataclass(frozen=True, slots=True)
class MissionProgress:
    """How far it is. At most once a second; one that was not taken gives way to the next."""

    elapsed: float  #: Seconds since the start.
    #: Waypoint that it flies to, counted from 0; None for other missions, and while nobody knows.
    index: int | None = None
    status: int | None = None  #: Value of the status push, see :class:`m100link.MissionState`.
    #: Horizontal distance that remains to that waypoint, to the centre of the circle or to the
    #: target, m; None when the position is unknown.
    distance_m: float | None = None
    height_m: float | None = None  #: Height above the take-off point, m; None when unknown.
    #: Angular rate along the circle of a hotpoint, °/s; None otherwise.
    rate_deg_s: float | None = None


@dataclass(frozen=True, slots=True)
class Paused:
    """It hovers, by order of the program; the mission is kept."""


@dataclass(frozen=True, slots=True)
class Resumed:
    """It goes on, by order of the program."""


@dataclass(frozen=True, slots=True)
class Stopped:
    """The program stopped it: the aircraft hovers, and has forgotten it. The last event."""


@dataclass(frozen=True, slots=True)
class Finished:
    """Every waypoint was flown, and the plan's action for the end begins.

    With :attr:`AtEnd.GO_HOME` and :attr:`AtEnd.LAND` the events go on until the aircraft stands on
    the ground; otherwise it is the last one.
    """


@dataclass(frozen=True, slots=True)
class Aborted:
    """The aircraft broke it off. The last event; :class:`MissionAborted` is raised behind it."""

    code: int | None  #: The reason that the aircraft gave; None when it gave none.
    reason: str  #: The same in words.
    #: Waypoint that it was flying to, counted from 0; None when nobody knows.
    index: int | None = None


MissionEvent = (
    Uploaded
    | Started
    | Reached
    | ActionsDone
    | MissionProgress
    | Paused
    | Resumed
    | Stopped
    | Finished
    | Aborted
)
"""What ``async for event in mission`` gives."""


class Events:
    """Events that wait for the program, oldest first."""

    def __init__(self) -> None:
        self._waiting: deque[MissionEvent] = deque()
        self._news = asyncio.Event()
        # The error to raise behind the last event; None when the end was a good one.
        self.failure: M100Error | None = None
        self.is_over = False  # whether the last event is there

    def add(self, event: MissionEvent) -> None:
        """Something happened; nothing happens behind the end."""
        if self.is_over:
            return
        # A program may take none for long: only progress comes again and again, so that one is
        # replaced, and the others are few.
        if isinstance(event, MissionProgress):
            self._waiting = deque(e for e in self._waiting if not isinstance(e, MissionProgress))
        self._waiting.append(event)
        self._news.set()

    def end(self, failure: M100Error | None = None) -> None:
        """The last event is there."""
        if not self.is_over:
            self.failure, self.is_over = failure, True
            self._news.set()

    async def take(self) -> MissionEvent | None:
        """The next event, None behind the last one."""
        while not self._waiting:
            if self.is_over:
                return None
            self._news.clear()
            await self._news.wait()
        return self._waiting.popleft()


# -- the life of one mission as a table of states and inputs ---------------------------------------
# A mission lives in the flight controller: it flies on when the program dies, and setpoints are
# ignored while it runs (seen on an M100). So from the moment before its start leaves until its end
# is known, whatever ends the program's block owes the aircraft a stop.


class RunState(Enum):
    """Where a mission is in its life, as this program knows it."""

    READY = "nothing was sent that flies"
    STARTING = "the start is under way; nobody knows yet whether it flies"
    FLYING = "the aircraft flies it and ignores setpoints"
    PAUSED = "it hovers by order of the program; setpoints are ignored all the same"
    ENDING = "every waypoint was flown; it flies on to the first one, or waits for the stick"
    RETURNING = "every waypoint was flown, and the aircraft goes home or lands, as planned"
    STOPPING = "a stop is under way"
    UNSTOPPED = "the stop was not answered, or refused: it may be flying on"
    DETACHED = "the program said that it shall fly on, and looks away"
    OVER = "it does not fly any more"


class RunInput(Enum):
    """The inputs of a mission's life."""

    START = "the start is about to be sent"
    STARTED = "the aircraft accepted it"
    REFUSED = "the aircraft refused it"
    PAUSED = "the aircraft accepted a pause"
    RESUMED = "the aircraft accepted that it goes on"
    STOP = "a stop is about to be sent, or was asked for before the start"
    STOPPED = "the aircraft stopped it, or says that none is running"
    NOT_STOPPED = "the stop was not answered, or refused"
    FLOWN = "every waypoint was flown, and the mission goes on"
    RETURNS = "every waypoint was flown, and the aircraft goes home or lands"
    FINISHED = "the aircraft does not fly it any more, and all was well"
    BROKEN_OFF = "the aircraft broke it off"
    DETACH = "the program lets go of it"


_S, _I = RunState, RunInput

_ENDS = {_I.FINISHED: _S.OVER, _I.BROKEN_OFF: _S.OVER}
_IN_FLIGHT = {
    _I.STOP: _S.STOPPING,
    _I.FLOWN: _S.ENDING,
    _I.RETURNS: _S.RETURNING,
    _I.DETACH: _S.DETACHED,
    **_ENDS,
}

TRANSITIONS: dict[RunState, dict[RunInput, RunState]] = {
    _S.READY: {_I.START: _S.STARTING, _I.STOP: _S.OVER},
    _S.STARTING: {
        _I.STARTED: _S.FLYING,
        _I.REFUSED: _S.OVER,
        # A push before the ack waits for it: it may be about another mission.
        _I.STOP: _S.STOPPING,
    },
    _S.FLYING: {_I.PAUSED: _S.PAUSED, **_IN_FLIGHT},
    _S.PAUSED: {_I.RESUMED: _S.FLYING, **_IN_FLIGHT},
    _S.ENDING: {_I.STOP: _S.STOPPING, _I.DETACH: _S.DETACHED, **_ENDS},
    _S.RETURNING: {
        # Asked for by name alone: leaving the block lets the aircraft land where it was to land.
        _I.STOP: _S.STOPPING,
        _I.DETACH: _S.DETACHED,
        # The mission itself is over: further pushes about it change nothing.
        _I.FINISHED: _S.OVER,
    },
    _S.STOPPING: {
        # The pushes of that time may be older than the stop: its answer decides.
        _I.STOPPED: _S.OVER,
        _I.NOT_STOPPED: _S.UNSTOPPED,
    },
    _S.UNSTOPPED: {_I.STOP: _S.STOPPING, _I.DETACH: _S.DETACHED, **_ENDS},
    _S.DETACHED: {},
    _S.OVER: {},
}
"""State, input, next state. A pair that is not in the table changes nothing."""

IN_THE_AIR = frozenset(_S) - {_S.READY, _S.DETACHED, _S.OVER}
"""States in which the aircraft flies by it, as far as anybody knows."""

OWES_A_STOP = IN_THE_AIR - {_S.RETURNING}  # states that nobody may leave behind


# -- the errors for an aircraft that refuses a mission ---------------------------------------------


_REMEDIES = {
    MissionCode.RUNNING: "stop it first: await control.stop_mission()",
    MissionCode.OTHER_RUNNING: "stop that one first: await control.stop_mission()",
}
"""Remedies for a program; those of the codes are a pilot's."""


def mission_refused(
    what: str, code: MissionCode, *, point: int | None = None, remedy: str = ""
) -> MissionRefused:
    """The refusal of an order, with the meaning of its code.

    ``point``: the waypoint that it is about, counted from 0. ``remedy``: what to do about it, if
    what the code says does not fit the order.
    """
    where = "" if point is None else f", waypoint {point}"
    return MissionRefused(
        f"{what} was refused{where}: {code.meaning} (code 0x{code:02X})",
        command=what,
        code=int(code),
        point=point,
        cause=code.cause,
        remedy=remedy or _REMEDIES.get(code, code.remedy),
    )


# -- orders to every kind of mission, and the answers that say that none is running ----------------


class MissionRequests(NamedTuple):
    """The requests of one kind of mission."""

    stop: Request[MissionCode]
    pause: Request[MissionCode]
    resumption: Request[MissionCode]


ORDERS = {
    MissionKind.WAYPOINT: MissionRequests(
        WaypointStartStop(stop=1), WaypointPauseResume(resume=0), WaypointPauseResume(resume=1)
    ),
    MissionKind.HOTPOINT: MissionRequests(
        HotpointStop(), HotpointPauseResume(resume=0), HotpointPauseResume(resume=1)
    ),
    MissionKind.FOLLOW: MissionRequests(
        FollowStop(), FollowPauseResume(resume=0), FollowPauseResume(resume=1)
    ),
}  # of every kind that flies by itself

_C = MissionCode

STOPPED_CODES = frozenset(
    {_C.NOT_RUNNING, _C.NOT_INITIALISED, _C.NO_MISSION, _C.NO_POINTS, _C.NOT_STARTED}
)
"""Answers to a stop that say that there is nothing to stop."""

Ordered = Literal["pause", "resumption"]

DONE_CODES: dict[Ordered, frozenset[MissionCode]] = {
    "pause": frozenset({_C.SUCCESS, _C.ALREADY_SO, _C.ALREADY_PAUSED}),
    "resumption": frozenset({_C.SUCCESS, _C.ALREADY_SO, _C.NOT_PAUSED}),
}
"""Answers to a pause after which it is paused, to a resumption after which it flies."""
