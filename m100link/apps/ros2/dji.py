"""Topics by the names and types of DJI's ``dji_sdk`` node, for programs that expect them.

Frames and units are those that rosbridge serves under these names: ``ground_ENU``, ``body_FLU``,
degrees of the wire for the gimbal, and mode and gear raw in ``rc``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from m100link.apps.ros2.graph import Qos
from m100link.apps.ros2.topics import Output
from m100link.log.cdr import encode
from m100link.log.ros2_messages import Messages, Stamp
from m100link.telemetry.sample import Sample

__all__ = ["DJI_OUTPUTS", "dji_makers"]

_GROUND, _BODY = "ground_ENU", "body_FLU"
_STICK = 10_000.0

_QOS = Qos(is_reliable=False)

DJI_OUTPUTS: Mapping[str, Output] = {
    f"dji_sdk/{name}": Output(kind, _QOS, hz, text)
    for name, kind, hz, text in (
        ("attitude", "geometry_msgs/QuaternionStamped", 50, "attitude, body over ground"),
        ("imu", "sensor_msgs/Imu", 50, "as ~/imu"),
        ("gps_position", "sensor_msgs/NavSatFix", 50, "as ~/fix"),
        ("gps_health", "std_msgs/UInt8", 50, "0 to 5"),
        ("height_above_takeoff", "std_msgs/Float32", 50, "m"),
        ("velocity", "geometry_msgs/Vector3Stamped", 50, "over ground"),
        ("angular_velocity_fused", "geometry_msgs/Vector3Stamped", 50, "in the body"),
        ("acceleration_ground_fused", "geometry_msgs/Vector3Stamped", 50, "without gravity"),
        ("rc", "sensor_msgs/Joy", 50, "roll, pitch, yaw, throttle, mode, gear as axes"),
        ("gimbal_angle", "geometry_msgs/Vector3Stamped", 50, "roll, pitch, yaw in degrees"),
        ("flight_status", "std_msgs/UInt8", 50, "as the aircraft numbers them"),
        ("battery_state", "sensor_msgs/BatteryState", 10, "as ~/battery"),
    )
}
"""By name, relative to the namespace of the node."""


def _header(stamp: Stamp, frame: str) -> dict[str, Any]:
    return {"stamp": {"sec": stamp[0], "nanosec": stamp[1]}, "frame_id": frame}


def _vector(stamp: Stamp, frame: str, values: tuple[float, float, float]) -> bytes:
    vector = dict(zip("xyz", values, strict=True))
    message = {"header": _header(stamp, frame), "vector": vector}
    return encode("geometry_msgs/Vector3Stamped", message)


def _attitude(sample: Sample, stamp: Stamp) -> bytes | None:
    if sample.attitude is None:
        return None
    turned = dict(zip("xyzw", sample.attitude.enu_flu_xyzw, strict=True))
    message = {"header": _header(stamp, _BODY), "quaternion": turned}
    return encode("geometry_msgs/QuaternionStamped", message)


def _health(sample: Sample, stamp: Stamp) -> bytes | None:
    health = None if sample.position is None else sample.position.gps_health
    return None if health is None else encode("std_msgs/UInt8", {"data": health})


def _height(sample: Sample, stamp: Stamp) -> bytes | None:
    if sample.position is None:
        return None
    return encode("std_msgs/Float32", {"data": sample.position.height_m})


def _rates(sample: Sample, stamp: Stamp) -> bytes | None:
    rates = sample.angular_velocity
    if rates is None:
        return None
    return _vector(stamp, _BODY, (rates.forward_rad_s, -rates.right_rad_s, -rates.down_rad_s))


def _remote(sample: Sample, stamp: Stamp) -> bytes | None:
    rc = sample.remote_control
    if rc is None:
        return None
    sticks = [one / _STICK for one in (rc.roll, rc.pitch, rc.yaw, rc.throttle)]
    axes = [*sticks, float(rc.mode), math.nan if rc.gear is None else float(rc.gear)]
    return encode("sensor_msgs/Joy", {"header": _header(stamp, "rc"), "axes": axes, "buttons": []})


def _gimbal(sample: Sample, stamp: Stamp) -> bytes | None:
    found = sample.gimbal
    if found is None:
        return None
    return _vector(stamp, _GROUND, (found.roll_deg, found.pitch_deg, found.yaw_deg))


def _status(sample: Sample, stamp: Stamp) -> bytes | None:
    status = sample.flight_status
    return None if status is None else encode("std_msgs/UInt8", {"data": status.status})


def _imu(messages: Messages, sample: Sample, stamp: Stamp) -> bytes | None:
    parts = sample.attitude, sample.angular_velocity, sample.acceleration
    return None if None in parts else messages.imu(stamp, *parts)


def dji_makers() -> dict[str, Callable[[Sample, Stamp], bytes | None]]:
    """What makes each of :data:`DJI_OUTPUTS` of a package; None where it has nothing for it."""
    messages, gps, bare = Messages(_GROUND, _BODY), Messages(_GROUND, "gps"), Messages(_GROUND, "")
    made: dict[str, Callable[[Sample, Stamp], bytes | None]] = {
        "attitude": _attitude,
        "imu": lambda one, at: _imu(messages, one, at),
        "gps_position": lambda one, at: one.position and gps.fix(at, one.position),
        "gps_health": _health,
        "height_above_takeoff": _height,
        "velocity": lambda one, at: one.velocity and _vector(at, _GROUND, one.velocity.enu),
        "angular_velocity_fused": _rates,
        "acceleration_ground_fused": lambda one, at: (
            one.acceleration and messages.acceleration(at, one.acceleration)
        ),
        "rc": _remote,
        "gimbal_angle": _gimbal,
        "flight_status": _status,
        "battery_state": lambda one, at: one.battery and bare.battery(at, one.battery),
    }
    return {f"dji_sdk/{name}": make for name, make in made.items()}
