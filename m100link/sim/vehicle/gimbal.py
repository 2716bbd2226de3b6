"""The gimbal and the camera, as far as commands and telemetry show them.

Commands 0x01/0x1A, 0x1B and 0x20 to 0x22 came with firmware 2.3; the document only announces them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from m100link.geodesy import normalize_degrees
from m100link.protocol.commands.gimbal import GIMBAL_LIMITS_DEG, GimbalAngleMode

if TYPE_CHECKING:
    from m100link.protocol.commands.gimbal import GimbalAngle, GimbalSpeed

__all__ = ["Camera", "GimbalMount"]

_LIMITS = tuple(GIMBAL_LIMITS_DEG.values())  # yaw, roll, pitch
_TAKES_CONTROL = 0x80


class GimbalMount:
    """Angles that follow commands at a limited rate.

    Attributes:
        yaw: Relative to the nose, degrees, clockwise.
        roll: Degrees, held level against the ground.
        pitch: Degrees, -90 looks straight down.
    """

    __slots__ = ("_rate_until", "_rates", "_targets", "pitch", "roll", "yaw")

    def __init__(self) -> None:
        self.yaw = self.roll = self.pitch = 0.0
        self._rates = [0.0, 0.0, 0.0]
        self._rate_until = 0.0
        self._targets: list[float] | None = None

    def turn(self, command: GimbalSpeed, now: float) -> None:
        """Turn at these rates for half a second; without the bit that takes control, ignore it."""
        if command.flags & _TAKES_CONTROL:
            rates = command.yaw_deg_s, command.roll_deg_s, command.pitch_deg_s
            self._rates = [max(-180.0, min(180.0, rate)) for rate in rates]
            self._rate_until = now + 0.5
            self._targets = None

    def point(self, command: GimbalAngle, heading_deg: float) -> None:
        """Go to these angles in the time of the command; absolute yaw counts from north."""
        present = [self.yaw, self.roll, self.pitch]
        wanted = list(command.angles_deg)
        if command.mode & GimbalAngleMode.ABSOLUTE:
            wanted[0] = normalize_degrees(wanted[0] - heading_deg)
        else:
            wanted = [now + by for now, by in zip(present, wanted, strict=True)]
        targets = [
            now if command.mode & (GimbalAngleMode.KEEP_YAW << axis) else max(low, min(high, want))
            for axis, (now, want, (low, high)) in enumerate(
                zip(present, wanted, _LIMITS, strict=True)
            )
        ]
        seconds = max(0.1, command.duration_s)
        self._targets = targets
        self._rates = [
            max(-400.0, min(400.0, (target - now) / seconds))
            for target, now in zip(targets, present, strict=True)
        ]

    def advance(self, now: float, seconds: float) -> None:
        """Move on towards the last command."""
        if self._targets is None:
            if now > self._rate_until:
                return
        elif [self.yaw, self.roll, self.pitch] == self._targets:
            self._targets = None
            self._rate_until = 0.0
            return
        angles = [self.yaw, self.roll, self.pitch]
        for axis, rate in enumerate(self._rates):
            low, high = _LIMITS[axis]
            angle = angles[axis] + rate * seconds
            if self._targets is not None and (angle - self._targets[axis]) * rate >= 0.0:
                angle = self._targets[axis]
            angles[axis] = max(low, min(high, angle))
        self.yaw, self.roll, self.pitch = angles

    @property
    def limits(self) -> int:
        """Limit byte of firmware 3.1: bit 0 pitch, 1 roll, 2 yaw at its stop."""
        result = 0
        for bit, angle, (low, high) in (
            (1, self.pitch, _LIMITS[2]),
            (2, self.roll, _LIMITS[1]),
            (4, self.yaw, _LIMITS[0]),
        ):
            if not low < angle < high:
                result |= bit
        return result


class Camera:
    """Counts what it was told.

    Attributes:
        photos: Photographs taken.
        is_recording: Whether it records video.
    """

    __slots__ = ("is_recording", "photos")

    def __init__(self) -> None:
        self.photos = 0
        self.is_recording = False
