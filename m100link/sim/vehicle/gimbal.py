"""The gimbal and the camera, as far as commands and telemetry show them.

Commands 0x01/0x1A, 0x1B and 0x20 to 0x22 came with firmware 2.3; the document only announces them.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from m100link.geodesy import normalize_degrees
from m100link.protocol.commands.gimbal import (
    GIMBAL_LIMITS_DEG,
    GimbalAngle,
    GimbalAngleMode,
    GimbalSpeed,
)

_LIMITS = tuple(GIMBAL_LIMITS_DEG.values())  # yaw, roll, pitch
_TAKES_CONTROL = 0x80
_FASTEST = (-400.0, 400.0)  # degrees per second, towards an angle
_FASTEST_BY_RATE = (-180.0, 180.0)


def _within(limits: tuple[float, float], value: float) -> float:
    return max(limits[0], min(limits[1], value))


class GimbalMount:
    """Angles that follow commands at a limited rate.

    Free, its yaw stays fixed to the ground while the aircraft turns below it, until the stop of the
    axis takes it along. Following, it turns with the nose. (Errata 52: the owner of an aircraft
    saw it fixed to the ground whatever mode the app had chosen.)

    ``yaw``: relative to the nose, degrees, clockwise; -320 to 320, so it may have gone round.
    ``roll``: degrees, held level against the ground. ``pitch``: degrees, -90 looks straight down.
    ``heading``: where the nose points, radians, as last given to :meth:`carry`.
    """

    def __init__(self, heading: float = 0.0, *, follows: bool = False) -> None:
        self.yaw = self.roll = self.pitch = 0.0
        self.follows = follows  # as given; may be changed
        self.heading = heading  # where the nose points, radians
        # Degrees per second of yaw, roll and pitch, for a rate command or towards the targets.
        self._rates = [0.0, 0.0, 0.0]
        self._rate_until = 0.0
        # Angles of the last angle command while it is carried out; yaw relative to the nose.
        self._targets: list[float] | None = None

    def carry(self, heading: float) -> None:
        """The aircraft has turned: its nose points to ``heading`` now, in radians."""
        turned = normalize_degrees(math.degrees(heading - self.heading))
        self.heading = heading
        if self.follows:
            return
        self.yaw = _within(_LIMITS[0], self.yaw - turned)
        if self._targets is not None:
            self._targets[0] = _within(_LIMITS[0], self._targets[0] - turned)

    def turn(self, command: GimbalSpeed, now: float) -> None:
        """Turn at these rates for half a second; without the bit that takes control, ignore it."""
        if command.flags & _TAKES_CONTROL:
            rates = command.yaw_deg_s, command.roll_deg_s, command.pitch_deg_s
            self._rates = [_within(_FASTEST_BY_RATE, rate) for rate in rates]
            self._rate_until = now + 0.5
            self._targets = None

    def point(self, command: GimbalAngle) -> None:
        """Go to these angles in the time of the command.

        Absolute yaw counts from north, or from the nose while it follows.
        """
        present = [self.yaw, self.roll, self.pitch]
        wanted = list(command.angles_deg)
        if not command.mode & GimbalAngleMode.ABSOLUTE:
            wanted = [now + by for now, by in zip(present, wanted, strict=True)]
        elif not self.follows:
            wanted[0] = self._shortest_way(wanted[0] - math.degrees(self.heading))
        targets = [
            now if command.mode & (GimbalAngleMode.KEEP_YAW << axis) else _within(limits, want)
            for axis, (now, want, limits) in enumerate(zip(present, wanted, _LIMITS, strict=True))
        ]
        seconds = max(0.1, command.duration_s)
        self._targets = targets
        self._rates = [
            _within(_FASTEST, (target - now) / seconds)
            for target, now in zip(targets, present, strict=True)
        ]

    def _shortest_way(self, yaw: float) -> float:
        """Of the turns of the axis that look in a direction, the nearest that it reaches."""
        low, high = _LIMITS[0]
        ways = (normalize_degrees(yaw) + turn for turn in (-360.0, 0.0, 360.0))
        return min((way for way in ways if low <= way <= high), key=lambda way: abs(way - self.yaw))

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
            angle = angles[axis] + rate * seconds
            if self._targets is not None and (angle - self._targets[axis]) * rate >= 0.0:
                angle = self._targets[axis]
            angles[axis] = _within(_LIMITS[axis], angle)
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
    """Takes photographs and records; nothing that the onboard device hears tells of it."""

    PHOTO_S = 1.0

    def __init__(self, log: Callable[[str], None]) -> None:
        self._log = log  # notes what it does
        self._busy_until = -math.inf  # the photograph that is being taken
        self.photos = 0
        self.is_recording = False  # whether it records video

    def take_photo(self, now: float) -> bool:
        """Take one; it takes a second. False while one is being taken."""
        if now < self._busy_until:
            self._log("camera: busy with a photo, another one ignored")
            return False
        self._busy_until = now + self.PHOTO_S
        self.photos += 1
        self._log(f"camera: photo {self.photos}")
        return True

    def record(self, on: bool) -> bool:
        """Record, or no more. False when that changes nothing."""
        state = "on" if on else "off"
        if self.is_recording is on:
            self._log(f"camera: video is {state} already")
            return False
        self.is_recording = on
        self._log(f"camera: video {state}")
        return True
