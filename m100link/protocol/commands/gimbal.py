"""The gimbal: 0x01/0x1A and 0x1B of firmware 2.3 on; the V1.0.1 document only announces them.

Angles are sent in tenths of a degree. Nothing answers: telemetry shows what became of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntFlag
from struct import Struct
from typing import Any, Self

from m100link.protocol.command import Problem, Push, exactly, in_range
from m100link.protocol.fields import AnyByte
from m100link.protocol.firmware import FirmwareProfile, Generation

GIMBAL_LIMITS_DEG = {"yaw": (-320.0, 320.0), "roll": (-35.0, 35.0), "pitch": (-90.0, 30.0)}
"""How far each axis turns, in the order of the wire."""

_SPEED_LIMIT_DEG_S = 180.0
_SPEED = Struct("<3hB")
_ANGLE = Struct("<3h2B")
_DURATION_LIMIT_S = 25.5
_SPEED_FLAGS = 0xE0
_MODE_BITS = 0x0F


def _tenths(degrees: tuple[float, float, float]) -> list[int]:
    return [round(angle * 10.0) for angle in degrees]


def _outside(
    raw: Mapping[str, int], limits: Mapping[str, tuple[int, int]], unit: str
) -> list[Problem]:
    return [
        Problem(name, raw[name], f"{low} to {high}, in {unit}")
        for name, (low, high) in limits.items()
        if not low <= raw[name] <= high
    ]


@dataclass(frozen=True, slots=True)
class GimbalSpeed(Push, address=(0x01, 0x1A), level=1, encrypted=True, since=Generation.V2_3):
    """0x01/0x1A, turn the gimbal; it stops half a second after the last command."""

    yaw_deg_s: float = 0.0  #: -180 to 180 degrees per second, sent in tenths.
    roll_deg_s: float = 0.0  #: -180 to 180 degrees per second, sent in tenths.
    pitch_deg_s: float = 0.0  #: -180 to 180 degrees per second, sent in tenths.
    #: Bit 7 takes control of the gimbal; without it the aircraft ignores the command. Bit 6 ignores
    #: the pilot's dial, bit 5 turns yaw back to the centre.
    flags: int = 0x80

    def value(self, profile: FirmwareProfile) -> bytes:
        """7 bytes.

        Raises:
            UsageError: Faster than the gimbal turns.
        """
        speeds = self.yaw_deg_s, self.roll_deg_s, self.pitch_deg_s
        for axis, speed in zip(GIMBAL_LIMITS_DEG, speeds, strict=True):
            in_range(f"{axis} speed", speed, -_SPEED_LIMIT_DEG_S, _SPEED_LIMIT_DEG_S, "°/s")
        for problem in self.problems():
            raise problem.error(self.NAME)
        return _SPEED.pack(*_tenths(speeds), self.flags)

    @classmethod
    def parse(cls, value: bytes, profile: FirmwareProfile) -> Self:
        """7 bytes; rates beyond the limits are kept as they came."""
        yaw, roll, pitch, flags = _SPEED.unpack(exactly(value, _SPEED.size, cls.NAME))
        return cls(yaw / 10.0, roll / 10.0, pitch / 10.0, flags)

    def raw(self) -> dict[str, Any]:
        """Tenths of a degree per second."""
        tenths = _tenths((self.yaw_deg_s, self.roll_deg_s, self.pitch_deg_s))
        return dict(zip(GIMBAL_LIMITS_DEG, tenths, strict=True)) | {"flags": self.flags}

    def problems(self) -> list[Problem]:
        """Faster than the gimbal turns, or a flag without a meaning."""
        limit = round(_SPEED_LIMIT_DEG_S * 10.0)
        found = _outside(self.raw(), dict.fromkeys(GIMBAL_LIMITS_DEG, (-limit, limit)), "0.1 °/s")
        if not 0 <= self.flags <= 0xFF or self.flags & ~_SPEED_FLAGS:
            found.append(Problem("flags", self.flags, "bits 5 to 7"))
        return found


class GimbalAngleMode(IntFlag):
    """How angles are meant, and which axes are left alone."""

    ABSOLUTE = 1
    KEEP_YAW = 2
    KEEP_ROLL = 4
    KEEP_PITCH = 8


@dataclass(frozen=True, slots=True)
class GimbalAngle(Push, address=(0x01, 0x1B), level=1, encrypted=True, since=Generation.V2_3):
    """0x01/0x1B, point the gimbal within a time."""

    #: -320 to 320 degrees; absolute it counts from north, else from the present angle.
    yaw_deg: float = 0.0
    roll_deg: float = 0.0  #: -35 to 35 degrees.
    pitch_deg: float = 0.0  #: -90 (straight down) to 30 degrees.
    #: Bits of :class:`GimbalAngleMode`; other bits are shown and never sent.
    mode: int = GimbalAngleMode.ABSOLUTE
    #: 0.1 to 25.5 seconds; faster than 400 degrees per second is discouraged.
    duration_s: float = 1.0

    @property
    def angles_deg(self) -> tuple[float, float, float]:
        """Yaw, roll and pitch, in the order of the wire."""
        return self.yaw_deg, self.roll_deg, self.pitch_deg

    def check(self) -> None:
        """Whether it could be sent at all.

        Raises:
            UsageError: An angle that the gimbal does not have, or a time that does not fit.
        """
        limits = GIMBAL_LIMITS_DEG.items()
        for (axis, (low, high)), angle in zip(limits, self.angles_deg, strict=True):
            in_range(axis, angle, low, high, "°")
        in_range("mode", self.mode, 0, _MODE_BITS)
        in_range("duration", self.duration_s, 0.0, _DURATION_LIMIT_S, "s")

    def value(self, profile: FirmwareProfile) -> bytes:
        """8 bytes.

        Raises:
            UsageError: See :meth:`check`.
        """
        self.check()
        duration = round(self.duration_s * 10.0)
        return _ANGLE.pack(*_tenths(self.angles_deg), self.mode, duration)

    @classmethod
    def parse(cls, value: bytes, profile: FirmwareProfile) -> Self:
        """8 bytes; angles beyond the limits are kept as they came."""
        *angles, mode, duration = _ANGLE.unpack(exactly(value, _ANGLE.size, cls.NAME))
        yaw, roll, pitch = (angle / 10.0 for angle in angles)
        return cls(yaw, roll, pitch, mode, duration / 10.0)

    def raw(self) -> dict[str, Any]:
        """Tenths of a degree and of a second."""
        return dict(zip(GIMBAL_LIMITS_DEG, _tenths(self.angles_deg), strict=True)) | {
            "mode": int(self.mode),
            "duration": round(self.duration_s * 10.0),
        }

    def problems(self) -> list[Problem]:
        """Angles that the gimbal does not have, or mode bits without a meaning."""
        limits = {
            axis: (round(low * 10.0), round(high * 10.0))
            for axis, (low, high) in GIMBAL_LIMITS_DEG.items()
        }
        found = _outside(self.raw(), limits, "0.1°")
        if not 0 <= self.mode <= _MODE_BITS:
            found.append(Problem("mode", self.mode, f"0 to {_MODE_BITS}"))
        return found

    def fields(self) -> dict[str, Any]:
        """With the mode as a number and in words."""
        words = [bit.name.lower() for bit in GimbalAngleMode if self.mode & bit and bit.name]
        return {
            "yaw_deg": self.yaw_deg,
            "roll_deg": self.roll_deg,
            "pitch_deg": self.pitch_deg,
            "mode": int(self.mode),
            "mode_bits": words,
            "duration_s": self.duration_s,
        }


# -- the camera: 0x01/0x20 to 0x22 of firmware 2.3 on; the V1.0.1 document only announces them -----
# Nothing tells what became of these commands, in no firmware: a program can only say "sent".


@dataclass(frozen=True, slots=True)
class _CameraCommand(AnyByte, Push, level=1, encrypted=True, since=Generation.V2_3):
    """One byte that may be anything, as in the version query."""

    @classmethod
    def parse(cls, value: bytes, profile: FirmwareProfile) -> Self:
        return cls(value[0] if value else 0)

    def fields(self) -> dict[str, Any]:
        """Nothing: the byte has no meaning."""
        return {}


@dataclass(frozen=True, slots=True)
class TakePhoto(_CameraCommand, address=(0x01, 0x20)):
    """0x01/0x20, take one photograph."""


@dataclass(frozen=True, slots=True)
class StartVideo(_CameraCommand, address=(0x01, 0x21)):
    """0x01/0x21, start recording video."""


@dataclass(frozen=True, slots=True)
class StopVideo(_CameraCommand, address=(0x01, 0x22)):
    """0x01/0x22, stop recording video."""
