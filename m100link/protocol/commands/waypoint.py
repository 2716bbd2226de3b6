"""Waypoint missions: 0x03/0x10 to 0x17 of firmware 3.1.

A mission is uploaded, then its points, then it is started. The aircraft keeps it and flies on
whatever becomes of the program that started it. Positions are in radians, heights in metres above
the take-off point.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Self

from m100link.protocol.codes import MissionCode
from m100link.protocol.command import Problem
from m100link.protocol.commands.missions import (
    Answer,
    DownloadAnswer,
    MissionRequest,
    PauseResume,
)
from m100link.protocol.fields import (
    AnyByte,
    Laid,
    Layout,
    Nibbles,
    Number,
    Numbers,
    Reserved,
    latitude,
    longitude,
)
from m100link.protocol.firmware import FirmwareProfile

_LARGEST_SPEED = 15.0


@dataclass(frozen=True, slots=True)
class WaypointMission(Laid, MissionRequest[MissionCode], address=(0x03, 0x10)):
    """0x03/0x10, begin the upload of a waypoint mission."""

    LAYOUT: ClassVar[Layout] = Layout(
        Number("count", "B", 2, 99),
        Number("max_speed", "f", 2.0, _LARGEST_SPEED, "m/s"),
        Number("idle_speed", "f", -_LARGEST_SPEED, _LARGEST_SPEED, "m/s"),
        Number("finish_action", words=("hover", "go_home", "land", "first_point", "endless")),
        Number("repeat", "B", 1, 2),
        Number("yaw_mode", words=("along_path", "as_at_start", "by_rc", "by_point")),
        Number("trace_mode", words=("stop_at_points", "rounded_corners")),
        Number("rc_lost_action", words=("failsafe", "go_on")),
        Number("gimbal_pitch_mode", words=("free", "by_point")),
        latitude("focus_latitude"),
        longitude("focus_longitude"),
        Number("focus_altitude", "f", unit="m"),
        Reserved(16),
    )

    count: int  #: Waypoints, 2 to 99.
    max_speed: float  #: Largest speed with the pilot's stick, 2 to 15 m/s.
    idle_speed: float  #: Speed without it, at most ``max_speed`` either way.
    #: 0 hover, 1 go home, 2 land, 3 back to the first point, 4 stay in the mission.
    finish_action: int = 0
    repeat: int = 1  #: How often it is flown, 1 or 2.
    #: 0 nose along the path, 1 as at the start, 2 by the remote control, 3 as set per point.
    yaw_mode: int = 0
    trace_mode: int = 0  #: 0 stop at each point, 1 rounded corners without actions.
    rc_lost_action: int = 0  #: 0 leave the mission for the failsafe, 1 go on.
    gimbal_pitch_mode: int = 0  #: 0 free, 1 as set per point.
    focus_latitude: float = 0.0  #: Radians and metres; the aircraft ignores them.
    focus_longitude: float = 0.0  #: Radians and metres; the aircraft ignores them.
    focus_altitude: float = 0.0  #: Radians and metres; the aircraft ignores them.

    def problems(self) -> list[Problem]:
        """With a cruise that is faster than the largest speed."""
        found = self.LAYOUT.problems(self)
        if not found and abs(self.idle_speed) > self.max_speed:
            limit = f"at most max_speed, {self.max_speed:g} m/s, either way"
            found.append(Problem("idle_speed", self.idle_speed, limit))
        return found


ACTIONS = ("stay", "take_photo", "start_video", "stop_video", "turn_to", "gimbal_pitch")
"""Actions at a waypoint, by their number."""

ACTION_PARAMETERS = {
    "stay": Number("parameter", "h", 0, 32767, "ms"),
    "turn_to": Number("parameter", "h", -180, 180, "°"),
    "gimbal_pitch": Number("parameter", "h", -90, 0, "°"),
}
"""Range of the parameter of an action; that of the others means nothing."""

_SLOTS = 16
USED_SLOTS = 15  # actions of a point at most, although there are 16 places for them


@dataclass(frozen=True, slots=True)
class WaypointPointAnswer(Answer):
    """Ack of a waypoint."""

    LAYOUT: ClassVar[Layout] = Layout(Number("index"))

    code: MissionCode  #: Of this waypoint; of the whole mission when it was the last one.
    index: int = 0  #: The waypoint.

    def raw(self) -> dict[str, Any]:
        """A code of one byte: two that look like a system code are code and index as well."""
        return {"code": int(self.code) & 0xFF, "index": self.index}


@dataclass(frozen=True, slots=True)
class WaypointPoint(Laid, MissionRequest[WaypointPointAnswer], address=(0x03, 0x11)):
    """0x03/0x11, upload one waypoint. The ack of the last one tells of the whole mission."""

    LAYOUT: ClassVar[Layout] = Layout(
        Number("index", "B", 0, 98),
        latitude(),
        longitude(),
        Number("altitude", "f", -200.0, 500.0, "m"),
        Number("damping", "f", 0.2, 1000.0, "m", besides=(0.0,)),
        Number("yaw", "h", -180, 180, "°"),
        Number("gimbal_pitch", "h", -90, 30, "°"),
        Number("turn_mode", words=("clockwise", "counter_clockwise")),
        Reserved(8),
        Number("has_action", "B", 0, 1),
        Number("action_time_limit", "H", 0, 999, "s", besides=(65535,)),
        Nibbles("action_count", "action_repeat"),
        Numbers("actions", _SLOTS, Number("action", words=ACTIONS)),
        Numbers("parameters", _SLOTS, Number("parameter", "h")),
    )
    DOCUMENT_SIZE: ClassVar[int] = LAYOUT.size - 3

    index: int  #: From 0 on, below the mission's ``count``.
    latitude: float  #: Radians.
    longitude: float  #: Radians.
    altitude: float  #: -200 to 500 m above the take-off point.
    damping: float = 0.0  #: Radius of a rounded corner, 0 or 0.2 to 1000 m.
    yaw: int = 0  #: Heading, -180 to 180 degrees.
    gimbal_pitch: int = 0  #: -90 to 30 degrees.
    turn_mode: int = 0  #: 0 turn clockwise, 1 counter-clockwise.
    has_action: int = 0  #: 1 when the actions count; 0 makes the aircraft ignore them.
    #: Seconds after which all its actions are cut off, 0 to 999; DJI's programs send 65535, too.
    action_time_limit: int = 999
    action_count: int = 0  #: How many of the actions count, 0 to 15.
    action_repeat: int = 0  #: How often the list is gone through, 0 to 15.
    #: 16 numbers of :data:`ACTIONS`, of which 15 are used.
    actions: tuple[int, ...] = (0,) * _SLOTS
    #: 16 numbers, milliseconds to stay, or degrees to turn or pitch to.
    parameters: tuple[int, ...] = (0,) * _SLOTS

    @classmethod
    def parse(cls, value: bytes, profile: FirmwareProfile) -> Self:
        """90 bytes, or the 87 that the documents print: 15 actions and 15 parameters."""
        if len(value) == cls.DOCUMENT_SIZE:
            actions = cls.LAYOUT.size - 3 * _SLOTS
            parameters = actions + USED_SLOTS
            value = value[:parameters] + b"\0" + value[parameters:] + b"\0\0"
        return super(WaypointPoint, cls).parse(value, profile)

    def _used(self) -> range:
        return range(min(self.action_count, USED_SLOTS) if self.has_action else 0)

    def problems(self) -> list[Problem]:
        """With parameters that do not fit their action."""
        found = self.LAYOUT.problems(self)
        if not found:
            for slot in self._used():
                allowed = ACTION_PARAMETERS.get(ACTIONS[self.actions[slot]])
                parameter = self.parameters[slot]
                if allowed and not allowed.fits(parameter):
                    found.append(Problem(f"parameters[{slot}]", parameter, allowed.limit))
        return found

    def shown(self) -> dict[str, Any]:
        """The actions that count, each with its parameter."""
        shown = self.LAYOUT.shown(self)
        del shown["parameters"]
        shown["actions"] = [
            _action(self.actions[slot], self.parameters[slot]) for slot in self._used()
        ]
        return shown


def _action(action: int, parameter: int) -> dict[str, Any]:
    word = ACTIONS[action] if action < len(ACTIONS) else action
    if word == "stay":
        return {"action": word, "time_s": parameter / 1000.0}
    return {"action": word} | ({"angle_deg": parameter} if word in ACTION_PARAMETERS else {})


@dataclass(frozen=True, slots=True)
class WaypointStartStop(Laid, MissionRequest[MissionCode], address=(0x03, 0x12)):
    """0x03/0x12, start (0) or stop (1) the uploaded mission."""

    LAYOUT: ClassVar[Layout] = Layout(Number("stop", words=("start", "stop")))

    stop: int

    @property
    def sets_in_motion(self) -> bool:
        """A start does."""
        return self.stop != 1


@dataclass(frozen=True, slots=True)
class WaypointPauseResume(PauseResume, address=(0x03, 0x13)):
    """0x03/0x13, pause (0) or resume (1) the mission."""


@dataclass(frozen=True, slots=True)
class WaypointMissionAnswer(DownloadAnswer[WaypointMission]):
    """Ack with the mission that the aircraft has."""

    code: MissionCode  #: ``NO_MISSION`` when there is none.
    mission: WaypointMission  #: The mission, or zeros.


@dataclass(frozen=True, slots=True)
class WaypointDownloadMission(AnyByte, MissionRequest[WaypointMissionAnswer], address=(0x03, 0x14)):
    """0x03/0x14, ask for the mission that the aircraft has; its count is 0 when it has ended."""


@dataclass(frozen=True, slots=True)
class WaypointDownloadedPoint(DownloadAnswer[WaypointPoint]):
    """Ack with one waypoint."""

    code: MissionCode  #: ``NO_POINTS`` when it is not there.
    point: WaypointPoint  #: The waypoint, or zeros.


@dataclass(frozen=True, slots=True)
class WaypointDownloadPoint(Laid, MissionRequest[WaypointDownloadedPoint], address=(0x03, 0x15)):
    """0x03/0x15, ask for one waypoint of the mission that the aircraft has."""

    LAYOUT: ClassVar[Layout] = Layout(Number("index", "B", 0, 98))

    index: int


_IDLE_SPEED = Layout(Number("idle_speed", "f", -_LARGEST_SPEED, _LARGEST_SPEED, "m/s"))


@dataclass(frozen=True, slots=True)
class IdleSpeedAnswer(Answer):
    """Ack with the speed in force."""

    LAYOUT: ClassVar[Layout] = _IDLE_SPEED

    code: MissionCode  #: ``BAD_SPEED`` beyond the mission's largest speed.
    idle_speed: float = 0.0  #: m/s.


@dataclass(frozen=True, slots=True)
class WaypointSetIdleSpeed(Laid, MissionRequest[IdleSpeedAnswer], address=(0x03, 0x16), moves=True):
    """0x03/0x16, change the cruise while the mission runs."""

    LAYOUT: ClassVar[Layout] = _IDLE_SPEED

    idle_speed: float  #: -15 to 15 m/s; below 0 the route is flown backwards.


@dataclass(frozen=True, slots=True)
class WaypointGetIdleSpeed(AnyByte, MissionRequest[IdleSpeedAnswer], address=(0x03, 0x17)):
    """0x03/0x17, ask for the cruise."""
