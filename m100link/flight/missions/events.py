"""What happens to a mission, as its program is told."""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import dataclass

from m100link.errors import M100Error

__all__ = [
    "Aborted",
    "ActionsDone",
    "Events",
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
    """A waypoint has been taken by the aircraft; told to ``progress`` while a mission is entered.

    Attributes:
        index: Which, counted from 0.
        total: How many there are.
    """

    index: int
    total: int


@dataclass(frozen=True, slots=True)
class Uploaded:
    """The aircraft has the whole plan and found it good; nothing flies yet.

    Attributes:
        points: Number of waypoints.
        estimated_time: Seconds that the aircraft expects it to take; None if it did not say.
    """

    points: int
    estimated_time: float | None


@dataclass(frozen=True, slots=True)
class Started:
    """The aircraft accepted the start: from here on it flies by itself and ignores setpoints."""


@dataclass(frozen=True, slots=True)
class Reached:
    """A waypoint was reached. Once for each point and run.

    Attributes:
        index: Which, counted from 0.
        is_inferred: No event of the aircraft told it, but it flies on to a later point. So it is
            when an event was lost, and at the points between with ``Trace.COORDINATED_TURNS``,
            which are passed by.
    """

    index: int
    is_inferred: bool = False


@dataclass(frozen=True, slots=True)
class ActionsDone:
    """The actions of a waypoint have ended.

    Attributes:
        index: Which waypoint, counted from 0.
    """

    index: int


@dataclass(frozen=True, slots=True)
class MissionProgress:
    """How far it is. At most once a second; one that was not taken gives way to the next.

    Attributes:
        elapsed: Seconds since the start.
        index: Waypoint that it flies to, counted from 0; None for other missions, and while
            nobody knows.
        status: What the status push says of it, see :class:`m100link.MissionState`.
        distance_m: Horizontal distance that remains to that waypoint, to the centre of the circle
            or to the target, m; None when the position is unknown.
        height_m: Height above the take-off point, m; None when unknown.
        rate_deg_s: Of a hotpoint: angular rate along the circle, °/s; None otherwise.
    """

    elapsed: float
    index: int | None = None
    status: int | None = None
    distance_m: float | None = None
    height_m: float | None = None
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
    """Every waypoint was flown, and what the plan says for the end begins.

    With :attr:`AtEnd.GO_HOME` and :attr:`AtEnd.LAND` the events go on until the aircraft stands on
    the ground; otherwise it is the last one.
    """


@dataclass(frozen=True, slots=True)
class Aborted:
    """The aircraft broke it off. The last event; :class:`MissionAborted` is raised behind it.

    Attributes:
        code: The reason that the aircraft gave; None when it gave none.
        reason: The same in words.
        index: Waypoint that it was flying to, counted from 0; None when nobody knows.
    """

    code: int | None
    reason: str
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
    """Events that wait for the program, oldest first.

    There are few of them, whatever a program does not take: only progress comes again and again,
    and of that the newest is kept.

    Attributes:
        failure: What is raised behind the last event, and nothing when the end was a good one.
        is_over: Whether the last event is there.
    """

    def __init__(self) -> None:
        self._waiting: deque[MissionEvent] = deque()
        self._news = asyncio.Event()
        self.failure: M100Error | None = None
        self.is_over = False

    def add(self, event: MissionEvent) -> None:
        """Something happened; nothing happens behind the end."""
        if self.is_over:
            return
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
