"""The gimbal and the camera, as far as commands and telemetry show them.

Commands 0x01/0x1A, 0x1B and 0x20 to 0x22 came with firmware 2.3; the document only announces them.
"""

from __future__ import annotations

from struct import Struct

from m100link.geodesy import normalize_degrees

__all__ = ["Camera", "GimbalMount"]

_RATE = Struct("<3hB")
_ANGLE = Struct("<3h2B")
_LIMITS = ((-320.0, 320.0), (-35.0, 35.0), (-90.0, 30.0))  # yaw, roll, pitch


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

    def turn(self, value: bytes, now: float) -> bool:
        """0x01/0x1A: rates of yaw, roll and pitch in 0.1 degrees per second, and flags.

        Effective for half a second, and only with bit 7 of the flags. Returns False if malformed.
        """
        if len(value) != _RATE.size:
            return False
        *rates, flags = _RATE.unpack(value)
        if flags & 0x80:
            self._rates = [max(-180.0, min(180.0, rate / 10.0)) for rate in rates]
            self._rate_until = now + 0.5
            self._targets = None
        return True

    def point(self, value: bytes, heading_deg: float) -> bool:
        """0x01/0x1B: angles of yaw, roll and pitch in 0.1 degrees, a mode byte, a duration.

        Bit 0 of the mode: absolute (yaw against north) rather than relative to the present
        angles; bits 1 to 3: leave yaw, roll, pitch alone. Returns False if malformed.
        """
        if len(value) != _ANGLE.size:
            return False
        yaw, roll, pitch, mode, duration = _ANGLE.unpack(value)
        present = [self.yaw, self.roll, self.pitch]
        if mode & 1:
            wanted = [normalize_degrees(yaw / 10.0 - heading_deg), roll / 10.0, pitch / 10.0]
        else:
            wanted = [present[0] + yaw / 10.0, present[1] + roll / 10.0, present[2] + pitch / 10.0]
        targets = [
            now if mode & (2 << axis) else max(low, min(high, want))
            for axis, (now, want, (low, high)) in enumerate(
                zip(present, wanted, _LIMITS, strict=True)
            )
        ]
        seconds = max(0.1, duration / 10.0)
        self._targets = targets
        self._rates = [
            max(-400.0, min(400.0, (target - now) / seconds))
            for target, now in zip(targets, present, strict=True)
        ]
        return True

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
