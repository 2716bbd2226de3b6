"""Circles around a point, DJI's "hotpoint", and following a target: firmware 3.1.

Hotpoint is 0x03/0x20 to 0x27, follow is 0x03/0x30 to 0x33.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from m100link.protocol.codes import MissionCode
from m100link.protocol.commands.missions import (
    Answer,
    DownloadAnswer,
    MissionRequest,
    PauseResume,
    Unconfirmed,
)
from m100link.protocol.fields import AnyByte, Laid, Layout, Number, Reserved, latitude, longitude

_RADIUS = 5.0, 500.0
_RATE = Number("angular_rate", "f", 0.0, 30.0, "°/s")
_CLOCKWISE = Number("clockwise", words=("counter_clockwise", "clockwise"))


@dataclass(frozen=True, slots=True)
class HotpointStartAnswer(Answer):
    """Ack of a start."""

    LAYOUT: ClassVar[Layout] = Layout(Number("largest_radius", "f", unit="m"))

    code: MissionCode  #: The code.
    largest_radius: float = 0.0  #: Metres that the limits of the aircraft leave.

    def _tail_raw(self) -> dict[str, Any]:
        return {"max_radius": self.largest_radius}  # DJI's name for it


@dataclass(frozen=True, slots=True)
class HotpointStart(Laid, MissionRequest[HotpointStartAnswer], address=(0x03, 0x20), moves=True):
    """0x03/0x20, circle around a point, at once."""

    LAYOUT: ClassVar[Layout] = Layout(
        Number("version", "B", 0, 0),
        latitude(),
        longitude(),
        Number("altitude", "d", 5.0, 500.0, "m"),
        Number("radius", "d", *_RADIUS, "m"),
        _RATE,
        _CLOCKWISE,
        Number("start_point", words=("north", "south", "west", "east", "nearest")),
        Number("yaw_mode", words=("along_path", "to_centre", "outwards", "by_rc", "as_at_start")),
        Reserved(11),
    )

    latitude: float  #: The centre in radians.
    longitude: float  #: The centre in radians.
    altitude: float  #: 5 to 500 m above the take-off point, not above the sea.
    radius: float  #: 5 to 500 m.
    #: 0 to 30 degrees per second; the aircraft refuses more than about 10 m/s along the circle.
    angular_rate: float
    clockwise: int = 1  #: 1 clockwise seen from above, 0 counter-clockwise.
    #: Where the circle is entered, 0 north, 1 south, 2 west, 3 east of the centre, 4 at the nearest
    #: place.
    start_point: int = 4
    #: 0 nose along the path, 1 to the centre, 2 outwards, 3 by the remote control, 4 as at the
    #: start.
    yaw_mode: int = 1
    version: int = 0  #: 0.


@dataclass(frozen=True, slots=True)
class HotpointStop(AnyByte, MissionRequest[MissionCode], address=(0x03, 0x21)):
    """0x03/0x21, end the circle and hover."""


@dataclass(frozen=True, slots=True)
class HotpointPauseResume(PauseResume, address=(0x03, 0x22)):
    """0x03/0x22, pause (0) or resume (1) the circle."""


@dataclass(frozen=True, slots=True)
class HotpointSetRate(Laid, Unconfirmed, address=(0x03, 0x23)):
    """0x03/0x23, change direction and rate."""

    LAYOUT: ClassVar[Layout] = Layout(_CLOCKWISE, _RATE)

    clockwise: int  #: 1 clockwise seen from above, 0 counter-clockwise.
    angular_rate: float  #: 0 to 30 degrees per second.


@dataclass(frozen=True, slots=True)
class HotpointSetRadius(Laid, Unconfirmed, address=(0x03, 0x24)):
    """0x03/0x24, change the radius."""

    LAYOUT: ClassVar[Layout] = Layout(Number("radius", "f", *_RADIUS, "m"))

    radius: float  #: 5 to 500 m.


@dataclass(frozen=True, slots=True)
class HotpointResetYaw(AnyByte, Unconfirmed, address=(0x03, 0x25)):
    """0x03/0x25, turn the nose back to where the yaw mode wants it."""


@dataclass(frozen=True, slots=True)
class HotpointDownloadAnswer(DownloadAnswer[HotpointStart]):
    """Ack with the circle that the aircraft flies."""

    code: MissionCode  #: ``NOT_RUNNING`` when it flies none.
    hotpoint: HotpointStart  #: The circle, or zeros.


@dataclass(frozen=True, slots=True)
class HotpointDownload(AnyByte, MissionRequest[HotpointDownloadAnswer], address=(0x03, 0x26)):
    """0x03/0x26, ask for the circle that the aircraft flies."""


@dataclass(frozen=True, slots=True)
class HotpointAutoRadius(Laid, MissionRequest[MissionCode], address=(0x03, 0x27), moves=True):
    """0x03/0x27, let the radius change by itself; DJI's documents call it not available."""

    LAYOUT: ClassVar[Layout] = Layout(Number("enable", words=("off", "on")), Number("rate", "b"))

    enable: int  #: 1 on, 0 off.
    rate: int = 0  #: How fast; no source states its unit.


# -- following a target: 0x03/0x30 to 0x33 of firmware 3.1 -----------------------------------------


_TARGET = (
    latitude(),
    longitude(),
    Number("altitude", "H", unit="m"),
    Number("angle", "H", 0, 0),
)


@dataclass(frozen=True, slots=True)
class FollowStart(Laid, MissionRequest[MissionCode], address=(0x03, 0x30), moves=True):
    """0x03/0x30, follow a target, at once, keeping the distance of the beginning."""

    LAYOUT: ClassVar[Layout] = Layout(
        Number("mode", "B", 0, 0),
        Number("yaw_mode", words=("by_rc", "to_target")),
        *_TARGET,
        Number("sensitivity", "B", 0, 1),
    )

    latitude: float  #: The target in radians.
    longitude: float  #: The target in radians.
    altitude: int = 0  #: Whole metres above the sea, 0 to 65535; 0 does not follow in height.
    mode: int = 0  #: 0; there is no other.
    yaw_mode: int = 1  #: 1 nose to the target, 0 by the remote control.
    angle: int = 0  #: 0, reserved.
    sensitivity: int = 1  #: DJI's library sends 1, its document says 0; ignored.


@dataclass(frozen=True, slots=True)
class FollowStop(AnyByte, MissionRequest[MissionCode], address=(0x03, 0x31)):
    """0x03/0x31, stop following and hover."""


@dataclass(frozen=True, slots=True)
class FollowPauseResume(PauseResume, address=(0x03, 0x32)):
    """0x03/0x32, pause (0) or resume (1) following."""


@dataclass(frozen=True, slots=True)
class FollowTarget(Laid, Unconfirmed, address=(0x03, 0x33)):
    """0x03/0x33, where the target is; once to ten times a second."""

    LAYOUT: ClassVar[Layout] = Layout(*_TARGET)

    latitude: float  #: Radians.
    longitude: float  #: Radians.
    altitude: int = 0  #: Whole metres above the sea, 0 to 65535; 0 does not follow in height.
    angle: int = 0  #: 0, reserved.
