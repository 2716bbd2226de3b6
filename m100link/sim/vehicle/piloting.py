"""What the pilot's sticks ask the aircraft for."""

from __future__ import annotations

from math import radians
from typing import TYPE_CHECKING

from m100link.protocol.records import RcMode
from m100link.sim.vehicle.dynamics import Guidance, ModelHorizontal

if TYPE_CHECKING:
    from m100link.sim.vehicle.dynamics import Airframe
    from m100link.sim.vehicle.remote import Sticks


_FASTEST = 10.0  # m/s at full deflection


def by_sticks(sticks: Sticks, airframe: Airframe, has_gps: bool) -> Guidance:
    """Velocity along the nose; in mode A, or without GPS, tilt."""
    up = sticks.throttle * airframe.vertical_speed
    yaw = sticks.yaw * radians(airframe.yaw_rate_deg)
    if sticks.mode is RcMode.A or not has_gps:
        tilt = radians(airframe.maximum_tilt_deg)
        roll, pitch = sticks.roll * tilt, -sticks.pitch * tilt
        return Guidance(ModelHorizontal.TILT, roll, pitch, body=True, up=up, yaw=yaw)
    forward, right = sticks.pitch * _FASTEST, sticks.roll * _FASTEST
    return Guidance(ModelHorizontal.VELOCITY, forward, right, body=True, up=up, yaw=yaw)
