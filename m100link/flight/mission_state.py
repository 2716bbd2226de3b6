"""The mission that flies the aircraft, as its pushes report it, also somebody else's.

Missions live in the flight controller. One that a phone started, or a program that is gone, is
in the same pushes as one of ours (seen on an M100).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from operator import itemgetter
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from m100link.protocol.commands.missions import MissionStatus, WaypointEvent

__all__ = ["MissionKind", "MissionState"]

# Seconds for which a push that names a mission is believed; they come at about 10 Hz (inferred).
BELIEVED_S = 3.0
# Seconds in which two pushes come. For so long a reported mission may fly, whatever the newest push
# says: one alone may be wrong.
DENIED_S = 0.25
# Seconds after the end of a mission in which pushes may still report it: they were under way.
_ECHO_S = 1.0


class MissionKind(Enum):
    """The kinds of missions."""

    UNKNOWN = "unknown"  # nothing was pushed: the box in the PC assistant is not ticked
    NONE = "no mission"
    WAYPOINT = "waypoint mission"
    HOTPOINT = "hotpoint"
    FOLLOW = "follow mission"
    IOC = "IOC"  # flown by the pilot's sticks: no mission that could be stopped

    @property
    def is_mission(self) -> bool:
        """Whether setpoints are ignored while it flies."""
        return self in (MissionKind.WAYPOINT, MissionKind.HOTPOINT, MissionKind.FOLLOW)


@dataclass(frozen=True, slots=True)
class MissionState:
    """The newest push about missions."""

    kind: MissionKind = MissionKind.UNKNOWN  #: The mission that flies the aircraft.
    index: int | None = None  #: Waypoint that it flies to, counted from 0; None for other missions.
    #: Status value of a waypoint mission (0 on the way to the first point, 1 flying, 2 turning, 3
    #: to 5 action, 6 reached; inferred) or of a hotpoint (0 on the way, 1 circling, 2 paused); None
    #: for others.
    status: int | None = None
    #: Since when pushes tell of this kind, with gaps of at most 3 s, on the event loop's clock;
    #: None when none of late did.
    since: float | None = None
    is_running: bool = False  #: Whether it flies the aircraft now, as reported within the last 3 s.


_KINDS = (
    MissionKind.NONE,
    MissionKind.WAYPOINT,
    MissionKind.HOTPOINT,
    MissionKind.FOLLOW,
    MissionKind.IOC,
)  # by the first byte of the push

Listener = Callable[["MissionStatus | WaypointEvent"], None]


class MissionWatch:
    """Remembers the newest push, and hands each one to the mission that this program flies."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock  # of the event loop
        # Gets every push as it comes; None while this program flies no mission.
        self.listener: Listener | None = None
        # When the newest status push came; minus infinity before the first.
        self.received_at = -math.inf
        self._kind = MissionKind.UNKNOWN
        self._status: MissionStatus | None = None
        # From when to when pushes reported each kind, without a longer gap than one is believed.
        self._reported: dict[MissionKind, tuple[float, float]] = {}
        self._is_claimed = False  # by a block that entered a mission, whatever came of it
        self.may_fly = False  # a mission, ours or another's: setpoints ask no more while none may
        # Until when pushes that name a mission which has ended are taken for late ones.
        self._echo: tuple[MissionKind, float] | None = None

    @property
    def state(self) -> MissionState:
        """The newest push, read."""
        values: dict[str, Any] = {} if self._status is None else self._status.raw()
        is_fresh = self._clock() - self.received_at <= BELIEVED_S
        return MissionState(
            kind=self._kind,
            index=values.get("index"),
            status=values.get("status"),
            since=self.reported_since(self._kind),
            is_running=is_fresh and self._kind.is_mission,
        )

    @property
    def flying(self) -> tuple[MissionKind, ...]:
        """The missions that may fly the aircraft, by all pushes of the last moment."""
        # Pushes that disagree may report several. The kind that they have reported for the longest
        # time stands first: one push after the other reports a mission that flies.
        now = self._clock()
        newest = self._kind if now - self.received_at <= BELIEVED_S else None
        kinds = [
            (since, kind)
            for kind, (since, until) in self._reported.items()
            if kind.is_mission and (now - until <= DENIED_S or kind is newest)
        ]
        return tuple(map(itemgetter(1), sorted(kinds, key=itemgetter(0))))

    def claim(self) -> None:
        """A control block enters a mission: pushes may tell of it later than it flies."""
        self._is_claimed = self.may_fly = True

    def on_status(self, push: MissionStatus, now: float) -> None:
        """A status push came (0x02/0x03)."""
        # A kind that no source lists neither begins nor ends a mission here.
        if push.kind >= len(_KINDS):
            return
        kind = _KINDS[push.kind]
        if self._echo is not None:
            ended, until = self._echo
            if kind is ended and now < until:
                return
            self._echo = None
        self.received_at, self._status, self._kind = now, push, kind
        self._reported[kind] = now if (since := self.reported_since(kind)) is None else since, now
        reported = [one for one in self._reported if self.reported_since(one) is not None]
        self.may_fly = self._is_claimed or any(one.is_mission for one in reported)
        if self.listener is not None:
            self.listener(push)

    def on_event(self, push: WaypointEvent, now: float) -> None:
        """A waypoint event came (0x02/0x04)."""
        if self.listener is not None:
            self.listener(push)

    def reported_since(self, kind: MissionKind) -> float | None:
        """Since when pushes tell of it, others between them or not; None when none did of late."""
        since, until = self._reported.get(kind, (0.0, -math.inf))
        return since if self._clock() - until <= BELIEVED_S else None

    def ended(self, kind: MissionKind, *, is_echoing: bool) -> None:
        """A mission ended; ``is_echoing``: pushes that still tell of it may be under way."""
        self._reported.pop(kind, None)
        if self._kind is kind:
            # Not when a push reported the end: they come in order, and a later one contradicts.
            if is_echoing:
                self._echo = kind, self._clock() + _ECHO_S
            self._kind, self._status = MissionKind.NONE, None
