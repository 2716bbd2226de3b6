"""The table of what the node offers: topics out, topics in, services.

The manual's table is made from it. Names are private to the node (``~/imu``), global, or those of
REP 105 and 107.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from m100link.apps.ros2.graph import Qos
from m100link.log.cdr import encode
from m100link.log.ros2 import Messages, Stamp
from m100link.telemetry.sample import Sample

SENSOR = Qos(is_reliable=False)
STATE = Qos(is_latched=True, depth=1)
EVENTS = Qos(depth=100)
RELIABLE = Qos()


@dataclass(frozen=True, slots=True)
class Output:
    """A topic that the node publishes."""

    kind: str
    qos: Qos  # its quality of service
    hz: float  # messages per second at most; 0 where they come when there is something to say
    text: str  # what it is, for the manual


OUTPUTS: Mapping[str, Output] = {
    "~/imu": Output(
        "sensor_msgs/Imu",
        SENSOR,
        50,
        "attitude, angular velocity, and what an accelerometer in the body feels, with gravity",
    ),
    "~/fix": Output(
        "sensor_msgs/NavSatFix",
        SENSOR,
        10,
        "position by GPS; the altitude is by the barometer, no covariance is known",
    ),
    "~/odom": Output(
        "nav_msgs/Odometry",
        SENSOR,
        50,
        "pose from where GPS was good first, height above take-off; motion in the body",
    ),
    "~/pose": Output("geometry_msgs/PoseStamped", SENSOR, 50, "the same pose"),
    "~/velocity": Output(
        "geometry_msgs/TwistStamped", SENSOR, 50, "velocity over ground, east, north, up"
    ),
    "~/battery": Output(
        "sensor_msgs/BatteryState", SENSOR, 1, "percentage; the wire has no voltage and no current"
    ),
    "~/magnetic_field": Output(
        "geometry_msgs/Vector3Stamped", SENSOR, 10, "raw numbers without a unit, in the body"
    ),
    "~/joy": Output(
        "sensor_msgs/Joy", SENSOR, 20, "the remote: roll, pitch, yaw, throttle; switch, gear"
    ),
    "~/gimbal": Output(
        "geometry_msgs/QuaternionStamped", SENSOR, 20, "how the camera is turned over ground"
    ),
    "~/flight_status": Output(
        "m100_msgs/FlightStatus", STATE, 1, "phase, who has control, what flies; at each change"
    ),
    "~/mission_event": Output(
        "m100_msgs/MissionEvent", EVENTS, 0, "what the aircraft pushes of a mission of its own"
    ),
    "/tf": Output("tf2_msgs/TFMessage", EVENTS, 50, "odom to base_link"),
    "/tf_static": Output("tf2_msgs/TFMessage", STATE, 0, "map to odom, which are the same"),
    "/diagnostics": Output(
        "diagnostic_msgs/DiagnosticArray", RELIABLE, 1, "line, clock, control, battery, this node"
    ),
    "/rosout": Output(
        "rcl_interfaces/Log", Qos(is_latched=True, depth=100), 0, "events of the aircraft"
    ),
    "/clock": Output(
        "rosgraph_msgs/Clock", Qos(is_reliable=False, depth=1), 50, "of a virtual aircraft alone"
    ),
}
"""By name."""


@dataclass(frozen=True, slots=True)
class Input:
    """A topic that the node listens to."""

    kind: str
    text: str  # what it does, for the manual


INPUTS: Mapping[str, Input] = {
    "~/cmd_vel": Input(
        "geometry_msgs/TwistStamped",
        "fly at this velocity for 0.3 s: forward, left, up in base_link; east, north, up in odom "
        "or map; turn about the axis that points up",
    ),
    "~/cmd_vel_unstamped": Input("geometry_msgs/Twist", "the same in base_link, without a header"),
    "~/setpoint_position": Input(
        "geometry_msgs/PoseStamped",
        "fly towards this place in odom or map for 0.3 s, and turn to its heading",
    ),
    "~/gimbal_speed": Input(
        "geometry_msgs/Vector3Stamped",
        "turn the camera for half a second, rad/s about forward, left, up (firmware 2.3 on)",
    ),
}
"""By name."""


@dataclass(frozen=True, slots=True)
class Service:
    """A service of the node."""

    kind: str
    text: str  # what it does, for the manual


_TRIGGER = "std_srvs/srv/Trigger"

SERVICES: Mapping[str, Service] = {
    "~/obtain_control": Service(_TRIGGER, "take the lease, activate, obtain control authority"),
    "~/release_control": Service(_TRIGGER, "give both back: the aircraft hovers, the pilot flies"),
    "~/takeoff": Service(_TRIGGER, "start the motors and climb to about 1.2 m"),
    "~/land": Service(_TRIGGER, "land in place; control is given back on the ground"),
    "~/go_home": Service(_TRIGGER, "fly to the home point and land there"),
    "~/arm": Service(_TRIGGER, "start the motors on the ground"),
    "~/disarm": Service(_TRIGGER, "stop the motors on the ground"),
    "~/stop": Service(
        _TRIGGER, "stop whatever happens; anybody may, setpoints fly after ~/obtain_control"
    ),
    "~/take_photo": Service(_TRIGGER, "take a photograph; nobody confirms it"),
    "~/start_video": Service(_TRIGGER, "start video; nobody confirms it"),
    "~/stop_video": Service(_TRIGGER, "stop video; nobody confirms it"),
    "~/point_gimbal": Service(
        "m100_msgs/srv/PointGimbal", "point the camera (firmware 2.3 on); nobody confirms it"
    ),
    "~/mission/upload": Service(
        "m100_msgs/srv/UploadMission", "check a plan for the aircraft's own missions (3.1)"
    ),
    "~/mission/start": Service(
        "m100_msgs/srv/StartMission", "upload it to the aircraft, which flies it by itself"
    ),
    "~/mission/pause": Service(_TRIGGER, "let the mission hover where it is"),
    "~/mission/resume": Service(_TRIGGER, "let it fly on"),
    "~/mission/stop": Service(_TRIGGER, "end it: the aircraft hovers"),
}
"""By name."""


# -- topics by the names and types of DJI's ``dji_sdk`` node, for programs that expect them --------
# Frames and units are those that rosbridge serves under these names: ``ground_ENU``, ``body_FLU``,
# degrees of the wire for the gimbal, and mode and gear raw in ``rc``.


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
