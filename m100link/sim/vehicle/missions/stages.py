"""How far missions are, and which orders each stage refuses: two tables.

What a table does not refuse is taken, or judged by its contents and the state of the aircraft.
"""

from __future__ import annotations

from enum import Enum, auto

from m100link.protocol.codes import MissionCode

__all__ = ["CIRCLE_REFUSALS", "WAYPOINT_REFUSALS", "Order", "Stage"]


class Stage(Enum):
    """How far a mission of one kind is. Hotpoint and follow know EMPTY, FLYING and PAUSED."""

    EMPTY = auto()
    """Nothing was uploaded, or it has ended."""
    PLANNED = auto()
    """The mission is there, points are missing."""
    READY = auto()
    """All points are there and fit together."""
    FLYING = auto()
    PAUSED = auto()
    OTHER = auto()
    """A mission of another kind runs."""


class Order(Enum):
    """What can be asked for."""

    UPLOAD = auto()
    ADD = auto()
    START = auto()
    STOP = auto()
    PAUSE = auto()
    RESUME = auto()
    DOWNLOAD = auto()
    DOWNLOAD_POINT = auto()
    SPEED = auto()


_GROUNDED = (Stage.EMPTY, Stage.PLANNED, Stage.READY)
_UNDER_WAY = (Stage.FLYING, Stage.PAUSED)

WAYPOINT_REFUSALS: dict[tuple[Order, Stage], MissionCode] = {
    **{(Order.UPLOAD, stage): MissionCode.RUNNING for stage in _UNDER_WAY},
    **{(Order.ADD, stage): MissionCode.RUNNING for stage in _UNDER_WAY},
    (Order.ADD, Stage.EMPTY): MissionCode.NO_MISSION,
    (Order.START, Stage.EMPTY): MissionCode.NO_POINTS,
    (Order.START, Stage.PLANNED): MissionCode.NO_POINTS,
    **{(Order.START, stage): MissionCode.ALREADY_SO for stage in _UNDER_WAY},
    **{(Order.STOP, stage): MissionCode.NOT_STARTED for stage in _GROUNDED},
    **{(Order.PAUSE, stage): MissionCode.NOT_STARTED for stage in _GROUNDED},
    **{(Order.RESUME, stage): MissionCode.NOT_STARTED for stage in _GROUNDED},
    (Order.PAUSE, Stage.PAUSED): MissionCode.ALREADY_SO,
    (Order.RESUME, Stage.FLYING): MissionCode.ALREADY_SO,
    (Order.DOWNLOAD, Stage.EMPTY): MissionCode.NO_MISSION,
    (Order.DOWNLOAD_POINT, Stage.EMPTY): MissionCode.NO_POINTS,
    (Order.SPEED, Stage.EMPTY): MissionCode.NO_MISSION,
}
"""Waypoints (facts W8, W12, W21 to W23)."""

_IDLE = (Stage.EMPTY, Stage.OTHER)

CIRCLE_REFUSALS: dict[tuple[Order, Stage], MissionCode] = {
    **{(Order.START, stage): MissionCode.RUNNING for stage in _UNDER_WAY},
    (Order.START, Stage.OTHER): MissionCode.OTHER_RUNNING,
    **{(Order.STOP, stage): MissionCode.NOT_RUNNING for stage in _IDLE},
    **{(Order.PAUSE, stage): MissionCode.NOT_RUNNING for stage in _IDLE},
    **{(Order.RESUME, stage): MissionCode.NOT_RUNNING for stage in _IDLE},
    **{(Order.DOWNLOAD, stage): MissionCode.NOT_RUNNING for stage in _IDLE},
    (Order.PAUSE, Stage.PAUSED): MissionCode.ALREADY_PAUSED,
    (Order.RESUME, Stage.FLYING): MissionCode.NOT_PAUSED,
}
"""Hotpoint (facts M1, H8) and, with the same codes, follow."""
