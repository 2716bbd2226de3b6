"""The columns of :mod:`tests.known`'s aircraft: names, units, signs and values, by hand.

Columns stand in arrays, CSV, Parquet, plots and downloads. Their names are public: a name says its
unit. North, east, up and forward, right, down are positive; angles are right side down, nose up and
clockwise from north.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pytest

__all__ = ["COLUMNS", "OLDER", "WIRE", "are", "on_the_wire"]

COLUMNS: dict[str, float] = {
    "time.tick": 123_457,
    "time.nanoseconds": 987_654_321,
    "time.sync": 1,
    "time.tick_hz": 400,
    "time.seconds": 308.6425,
    "quaternion.q0": 0.428_330_44,
    "quaternion.q1": -0.120_505_80,
    "quaternion.q2": -0.150_897_53,
    "quaternion.q3": -0.882_746_47,
    "quaternion.roll_deg": 10.0,
    "quaternion.pitch_deg": -20.0,
    "quaternion.yaw_deg": -130.0,
    "acceleration.north_m_s2": 1.5,
    "acceleration.east_m_s2": -2.5,
    "acceleration.up_m_s2": 0.7,
    "velocity.north_m_s": 3.21,
    "velocity.east_m_s": -1.57,
    "velocity.up_m_s": 0.84,
    "velocity.status": 7,
    "velocity.ground_speed_m_s": 3.573_373_8,
    "angular_velocity.forward_rad_s": 0.11,
    "angular_velocity.right_rad_s": -0.23,
    "angular_velocity.down_rad_s": 0.37,
    "angular_velocity.roll_rate_deg_s": 6.302_535_7,
    "angular_velocity.pitch_rate_deg_s": -13.178_029,
    "angular_velocity.yaw_rate_deg_s": 21.199_438,
    "position.latitude_rad": -0.578_113_379_057,
    "position.longitude_rad": 2.639_541_150_941,
    "position.altitude_m": 87.65,
    "position.height_m": 12.34,
    "position.gps_health": 4,
    "position.latitude_deg": -33.123_456_7,
    "position.longitude_deg": 151.234_567_8,
    "magnetometer.x": 313,
    "magnetometer.y": -1127,
    "magnetometer.z": 851,
    "rc.roll": 1000,
    "rc.pitch": -2000,
    "rc.yaw": 3000,
    "rc.throttle": -4000,
    "rc.mode": 8000,
    "rc.gear": -4545,
    "rc.mode_switch": 8000,
    "gimbal.roll_deg": 4.5,
    "gimbal.pitch_deg": -37.25,
    "gimbal.yaw_deg": 118.75,
    "gimbal.limits": 6,
    "flight_status.status": 3,
    "flight_status.phase": 3,
    "battery.percent": 63,
    "control_device.control": 0x1A,
    "control_device.mode": 6,
    "control_device.device": 2,
}
"""As firmware 3.1 tells them, in the order of the flag bits."""

_NEW = {"time.nanoseconds", "time.sync", "gimbal.limits", "control_device.mode"}
_TICKS = {"time.tick_hz": 600.0, "time.seconds": 205.761_667}

OLDER: dict[str, dict[str, float]] = {
    "1.0": COLUMNS | dict.fromkeys({*_NEW, "velocity.status"}, math.nan) | _TICKS,
    "2.3": COLUMNS | dict.fromkeys(_NEW, math.nan) | _TICKS,
    "3.1": COLUMNS,
}
"""By firmware: what the older ones do not have is not a number, and their clock is another one."""


WIRE: dict[str, str] = {
    **dict.fromkeys(("time.tick", "time.nanoseconds", "time.sync"), ""),
    **{f"quaternion.q{n}": "" for n in range(4)},
    "acceleration.x": "acceleration.north_m_s2",
    "acceleration.y": "acceleration.east_m_s2",
    "acceleration.z": "acceleration.up_m_s2",
    "velocity.x": "velocity.north_m_s",
    "velocity.y": "velocity.east_m_s",
    "velocity.z": "velocity.up_m_s",
    "velocity.status": "",
    "angular_velocity.x": "angular_velocity.forward_rad_s",
    "angular_velocity.y": "angular_velocity.right_rad_s",
    "angular_velocity.z": "angular_velocity.down_rad_s",
    "position.latitude_rad": "",
    "position.longitude_rad": "",
    "position.altitude": "position.altitude_m",
    "position.height": "position.height_m",
    "position.gps_health": "",
    **{f"magnetometer.{axis}": "" for axis in "xyz"},
    **dict.fromkeys(("rc.roll", "rc.pitch", "rc.yaw", "rc.throttle", "rc.mode", "rc.gear"), ""),
    "gimbal.roll": "gimbal.roll_deg",
    "gimbal.pitch": "gimbal.pitch_deg",
    "gimbal.yaw": "gimbal.yaw_deg",
    "gimbal.limits": "",
    "flight_status.status": "",
    "battery.percent": "",
    "control_device.mode": "",
    "control_device.control": "",
}
"""Names on the wire, as a log's rows have them, and columns of the same value; "" is the same."""


def on_the_wire(firmware: str) -> dict[str, float]:
    """Values by their names on the wire, of those that the firmware sends."""
    values = OLDER[firmware]
    found = {name: values[column or name] for name, column in WIRE.items()}
    return {name: value for name, value in found.items() if not math.isnan(value)}


def are(values: Mapping[str, Any], expected: Mapping[str, float]) -> None:
    """Each has its value, to what a float of 32 bits keeps; places to a millimetre, UTC to 2 ms.

    Raises:
        AssertionError: One has not, or there are others.
    """
    assert list(values) == list(expected), set(values) ^ set(expected) or "in another order"
    for name, value in expected.items():
        found = math.nan if values[name] is None else float(values[name])
        exact = "itude_" in name and "alt" not in name
        kept = 1e-12 if name == "utc" else 1e-10 if exact else 3e-7
        assert found == pytest.approx(value, rel=kept, abs=1e-9, nan_ok=True), name
