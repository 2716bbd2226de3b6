"""Setpoints of ROS programs in the words of the aircraft: speeds, and places to be flown to."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Any

from m100link.errors import BadSetpoint, UsageError
from m100link.protocol.setpoint import Setpoint

__all__ = ["Frames", "speed", "toward"]

_GAIN = 0.8
"""Metres per second for each metre that is missing."""

_FASTEST, _CLIMB = 5.0, 2.0
_NO_ROTATION, _NOT_UNIT = 1e-6, 0.01


class Frames:
    """Which frames mean the ground, and which the body.

    Args:
        ground: East, north, up.
        body: Forward, left, up.
    """

    def __init__(self, ground: Collection[str], body: Collection[str]) -> None:
        self._ground, self._body = set(ground), {"", *body}

    def is_body(self, name: str, kind: str) -> bool:
        """Whether a frame turns with the aircraft.

        Args:
            name: Of the frame.
            kind: What has it, for people.

        Raises:
            UsageError: Nobody knows the frame.
        """
        if name in self._body:
            return True
        if name in self._ground:
            return False
        known = ", ".join(sorted((self._ground | self._body) - {""}))
        raise UsageError(f"{kind} in the frame {name!r}", remedy=f"frames are {known}")


def speed(twist: Mapping[str, Any], *, is_body: bool) -> Setpoint:
    """A geometry_msgs/Twist as a setpoint: m/s, and rad/s about the axis that points up.

    Raises:
        BadSetpoint: A number that the aircraft does not take.
    """
    linear, angular = twist["linear"], twist["angular"]
    turn = -math.degrees(angular["z"])
    if is_body:
        return Setpoint.velocity(
            forward=linear["x"], right=-linear["y"], up=linear["z"], yaw_rate_deg_s=turn
        )
    return Setpoint.velocity(
        north=linear["y"], east=linear["x"], up=linear["z"], yaw_rate_deg_s=turn
    )


def toward(
    pose: Mapping[str, Any], here: tuple[float, float, float], *, fastest: float | None
) -> Setpoint:
    """A velocity that leads to a geometry_msgs/Pose: the slower, the nearer.

    Args:
        pose: East, north, up of the origin, m, and the heading; no rotation keeps the present one.
        here: East, north, up of the aircraft, m.
        fastest: Horizontal speed that the guards allow, m/s.

    Raises:
        BadSetpoint: A number that is not finite, or an orientation that is none.
    """
    place, turned = pose["position"], pose["orientation"]
    east, north, up = (_GAIN * (place[axis] - at) for axis, at in zip("xyz", here, strict=True))
    limit = _FASTEST if fastest is None else min(_FASTEST, fastest)
    scale = max(1.0, math.hypot(east, north) / limit)
    x, y, z, w = (turned[axis] for axis in "xyzw")
    climb = max(-_CLIMB, min(_CLIMB, up)) if math.isfinite(up) else up
    motion = {"north": north / scale, "east": east / scale, "up": climb}
    size = math.hypot(x, y, z, w)
    if size < _NO_ROTATION:
        return Setpoint.velocity(**motion, yaw_rate_deg_s=0.0)
    if not abs(size - 1.0) < _NOT_UNIT:
        raise BadSetpoint(
            f"an orientation that is no rotation: a quaternion of length {size:g}",
            remedy="give one of length 1, or zeros to keep the heading",
        )
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return Setpoint.velocity(**motion, yaw_deg=math.remainder(90.0 - math.degrees(yaw), 360.0))
