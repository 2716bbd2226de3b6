"""What every kind of mission can be told, and which answers say that none is running."""

from __future__ import annotations

from typing import NamedTuple

from m100link.flight.mission_state import MissionKind
from m100link.protocol.codes import MissionCode
from m100link.protocol.command import Request
from m100link.protocol.commands.follow import FollowPauseResume, FollowStop
from m100link.protocol.commands.hotpoint import HotpointPauseResume, HotpointStop
from m100link.protocol.commands.waypoint import WaypointPauseResume, WaypointStartStop

__all__ = ["ORDERS", "PAUSED_CODES", "RESUMED_CODES", "STOPPED_CODES", "Orders"]


class Orders(NamedTuple):
    """The requests of one kind of mission."""

    stop: Request[MissionCode]
    pause: Request[MissionCode]
    resume: Request[MissionCode]


ORDERS = {
    MissionKind.WAYPOINT: Orders(
        WaypointStartStop(stop=1), WaypointPauseResume(resume=0), WaypointPauseResume(resume=1)
    ),
    MissionKind.HOTPOINT: Orders(
        HotpointStop(), HotpointPauseResume(resume=0), HotpointPauseResume(resume=1)
    ),
    MissionKind.FOLLOW: Orders(
        FollowStop(), FollowPauseResume(resume=0), FollowPauseResume(resume=1)
    ),
}
"""Every kind that flies by itself."""

_C = MissionCode

STOPPED_CODES = frozenset(
    {_C.NOT_RUNNING, _C.NOT_INITIALISED, _C.NO_MISSION, _C.NO_POINTS, _C.NOT_STARTED}
)
"""Answers to a stop that say that there is nothing to stop."""

PAUSED_CODES = frozenset({_C.SUCCESS, _C.ALREADY_SO, _C.ALREADY_PAUSED})
"""Answers to a pause after which it is paused."""

RESUMED_CODES = frozenset({_C.SUCCESS, _C.ALREADY_SO, _C.NOT_PAUSED})
"""Answers to a resumption after which it flies."""
