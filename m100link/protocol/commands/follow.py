"""Following a target: 0x03/0x30 to 0x33 of firmware 3.1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from m100link.protocol.codes import MissionCode
from m100link.protocol.command import Address
from m100link.protocol.commands.mission_acks import MissionRequest, Unconfirmed
from m100link.protocol.fields import Laid, Layout, Number, latitude, longitude

_TARGET = (
    latitude(),
    longitude(),
    Number("altitude", "H", unit="m"),
    Number("angle", "H", 0, 0),
)


@dataclass(frozen=True, slots=True)
class FollowStart(Laid, MissionRequest[MissionCode]):
    """0x03/0x30, follow a target, at once, keeping the distance of the beginning.

    Attributes:
        latitude, longitude: The target in radians.
        altitude: Whole metres above the sea, 0 to 65535; 0 does not follow in height.
        mode: 0; there is no other.
        yaw_mode: 1 nose to the target, 0 by the remote control.
        angle: 0, reserved.
        sensitivity: DJI's library sends 1, its document says 0; ignored.
    """

    ADDRESS: ClassVar[Address] = Address(0x03, 0x30)
    NAME: ClassVar[str] = "follow_start"
    LAYOUT: ClassVar[Layout] = Layout(
        Number("mode", "B", 0, 0),
        Number("yaw_mode", words=("by_rc", "to_target")),
        *_TARGET,
        Number("sensitivity", "B", 0, 1),
    )

    latitude: float
    longitude: float
    altitude: int = 0
    mode: int = 0
    yaw_mode: int = 1
    angle: int = 0
    sensitivity: int = 1

    @property
    def sets_in_motion(self) -> bool:
        """At once."""
        return True


@dataclass(frozen=True, slots=True)
class FollowStop(Laid, MissionRequest[MissionCode]):
    """0x03/0x31, stop following and hover."""

    ADDRESS: ClassVar[Address] = Address(0x03, 0x31)
    NAME: ClassVar[str] = "follow_stop"
    LAYOUT: ClassVar[Layout] = Layout(Number("any"))

    any: int = 0


@dataclass(frozen=True, slots=True)
class FollowPauseResume(Laid, MissionRequest[MissionCode]):
    """0x03/0x32, pause (0) or resume (1) following."""

    ADDRESS: ClassVar[Address] = Address(0x03, 0x32)
    NAME: ClassVar[str] = "follow_pause_resume"
    LAYOUT: ClassVar[Layout] = Layout(Number("resume", words=("pause", "resume")))

    resume: int

    @property
    def sets_in_motion(self) -> bool:
        """Resuming does."""
        return self.resume != 0


@dataclass(frozen=True, slots=True)
class FollowTarget(Laid, Unconfirmed):
    """0x03/0x33, where the target is; once to ten times a second.

    Attributes:
        latitude, longitude: Radians.
        altitude: Whole metres above the sea, 0 to 65535; 0 does not follow in height.
        angle: 0, reserved.
    """

    ADDRESS: ClassVar[Address] = Address(0x03, 0x33)
    NAME: ClassVar[str] = "follow_target"
    LAYOUT: ClassVar[Layout] = Layout(*_TARGET)

    latitude: float
    longitude: float
    altitude: int = 0
    angle: int = 0
