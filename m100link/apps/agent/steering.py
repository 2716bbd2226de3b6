"""What keys, sticks and the 2015 Quaternion mean as setpoints."""

from __future__ import annotations

from m100link.errors import UsageError
from m100link.protocol.setpoint import ReferenceFrame, Setpoint

__all__ = ["ANGLE_MODE", "SETPOINT_LIFETIME", "VELOCITY_MODE", "setpoint_of"]

SETPOINT_LIFETIME = 0.2
"""Seconds that a setpoint of a program lasts when it is not renewed."""

ANGLE_MODE = 1
"""Key 8: tilt angles in the body frame, climb rate, yaw rate (mode 2 of the document, 0x0a)."""

VELOCITY_MODE = 2
"""Key 9: velocities in the ground frame, climb rate, yaw rate (mode 4 of the document, 0x48)."""


def setpoint_of(mode: int, x: float, y: float, z: float, w: float) -> Setpoint:
    """The setpoint for the four numbers of ``/sdk_request_ctrl``.

    The first movement value is ``y`` and the second is ``x``, as DJI's node has it; ``z`` is the
    yaw rate and ``w`` the climb rate.

    Args:
        mode: :data:`ANGLE_MODE` or :data:`VELOCITY_MODE`.
        x: Pitch (°, negative flies forward), or velocity to the east (m/s).
        y: Roll (°, positive to the right), or velocity to the north (m/s).
        z: Yaw rate, °/s, clockwise from above.
        w: Climb rate, m/s.

    Raises:
        UsageError: There is no such mode.
        BadSetpoint: A value outside its range.
    """
    if mode == ANGLE_MODE:
        return Setpoint.tilt(
            roll_deg=y, pitch_deg=x, up=w, yaw_rate_deg_s=z, frame=ReferenceFrame.BODY
        )
    if mode == VELOCITY_MODE:
        return Setpoint.velocity(north=y, east=x, up=w, yaw_rate_deg_s=z)
    raise UsageError(f"there is no control mode {mode}", remedy="1 is angles, 2 is velocities")
