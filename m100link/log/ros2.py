"""A flight log as a bag of ROS 2: an MCAP file with its messages in CDR.

Frames and units of REP 103 and 105: east, north, up on the ground (``map``); forward, left, up in
the body (``base_link``).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import IO, Any

from m100link.log.cdr import definition, encode
from m100link.log.channels import COMMAND, EVENT
from m100link.log.reading import FlightLog
from m100link.log.records import mcap_module
from m100link.protocol.firmware import FirmwareProfile
from m100link.protocol.records import (
    Acceleration,
    AngularVelocity,
    Attitude,
    Battery,
    FlightStatus,
    Position,
    RemoteControl,
    Velocity,
)
from m100link.telemetry.limits import GOOD_GPS
from m100link.telemetry.sample import Sample

__all__ = ["TOPICS", "write_bag"]

TOPICS = {
    "/m100/fix": "sensor_msgs/NavSatFix",
    "/m100/imu": "sensor_msgs/Imu",
    "/m100/velocity": "geometry_msgs/TwistStamped",
    "/m100/acceleration": "geometry_msgs/Vector3Stamped",
    "/m100/battery": "sensor_msgs/BatteryState",
    "/m100/joy": "sensor_msgs/Joy",
    "/m100/flight_status": "std_msgs/UInt8",
    "/m100/events": "std_msgs/String",
    "/tf": "tf2_msgs/TFMessage",
}
"""What is in a bag: topic and message."""

_MAP, _BODY = "map", "base_link"
_UNKNOWN = [0.0] * 9
_NOT_THERE = [-1.0] + [0.0] * 8  # as sensor_msgs/Imu says it
_NO_FIX, _FIX, _GPS = -1, 0, 1
_STICK = 10_000.0
_NAN = math.nan


def write_bag(
    flight: FlightLog, stream: IO[bytes], *, firmware: str | FirmwareProfile | None = None
) -> int:
    """Write a bag that ``rosbags``, ``ros2 bag`` and Foxglove read.

    A message per package and item, with the time at which the package arrived; what a package does
    not have is not made up. Commands, answers and events are JSON on ``/m100/events``.

    Args:
        flight: The log.
        stream: What takes the bytes.
        firmware: As for :meth:`FlightLog.samples`.

    Returns:
        How many messages.
    """
    writer: Any = mcap_module("writer").Writer(stream)
    writer.start(profile="ros2", library="m100link log ros2")
    channels = {}
    for topic, name in TOPICS.items():
        package, message = name.split("/")
        kind = f"{package}/msg/{message}"
        schema = writer.register_schema(kind, "ros2msg", definition(name).encode())
        channels[topic] = writer.register_channel(
            topic, "cdr", schema, {"offered_qos_profiles": ""}
        )
    count = 0
    for topic, at_ns, content in _messages(flight, firmware):
        writer.add_message(
            channel_id=channels[topic],
            log_time=at_ns,
            publish_time=at_ns,
            data=encode(TOPICS[topic], content),
        )
        count += 1
    writer.finish()
    return count


def _messages(
    flight: FlightLog, firmware: str | FirmwareProfile | None
) -> Iterator[tuple[str, int, dict[str, Any]]]:
    offset = None
    for message in flight.messages(COMMAND, EVENT):
        text = message.data.decode("utf-8", "replace")
        yield "/m100/events", max(0, round(message.utc * 1e9)), {"data": text}
    for message in flight.messages():
        offset = message.utc - message.at
        break
    if offset is None:
        return
    for sample in flight.samples(firmware=firmware):
        at_ns = max(0, round((sample.received_at + offset) * 1e9))
        for topic, content in _told(sample, at_ns):
            yield topic, at_ns, content


def _told(sample: Sample, at_ns: int) -> Iterator[tuple[str, dict[str, Any]]]:
    ground, body = _header(at_ns, _MAP), _header(at_ns, _BODY)
    position = sample.get(Position)
    if position is not None:
        yield "/m100/fix", _fix(body, position)
    attitude, rates = sample.get(Attitude), sample.get(AngularVelocity)
    if attitude is not None or rates is not None:
        yield "/m100/imu", _imu(body, attitude, rates)
    if attitude is not None and position is not None:
        transform = {
            "translation": _vector(0.0, 0.0, position.height_m),
            "rotation": dict(zip("xyzw", attitude.enu_flu_xyzw, strict=True)),
        }
        named = {"header": ground, "child_frame_id": _BODY, "transform": transform}
        yield "/tf", {"transforms": [named]}
    velocity = sample.get(Velocity)
    if velocity is not None:
        twist = {"linear": _vector(*velocity.enu), "angular": _vector(0.0, 0.0, 0.0)}
        yield "/m100/velocity", {"header": ground, "twist": twist}
    acceleration = sample.get(Acceleration)
    if acceleration is not None:
        yield "/m100/acceleration", {"header": ground, "vector": _vector(*acceleration.enu)}
    battery = sample.get(Battery)
    if battery is not None:
        yield "/m100/battery", _battery(body, battery)
    rc = sample.get(RemoteControl)
    if rc is not None:
        axes = [one / _STICK for one in (rc.roll, rc.pitch, rc.yaw, rc.throttle)]
        yield "/m100/joy", {"header": body, "axes": axes, "buttons": [rc.mode, rc.gear or 0]}
    status = sample.get(FlightStatus)
    if status is not None:
        yield "/m100/flight_status", {"data": status.status}


def _header(at_ns: int, frame: str) -> dict[str, Any]:
    return {"stamp": {"sec": at_ns // 10**9, "nanosec": at_ns % 10**9}, "frame_id": frame}


def _vector(x: float, y: float, z: float) -> dict[str, float]:
    return {"x": x, "y": y, "z": z}


def _fix(header: dict[str, Any], position: Position) -> dict[str, Any]:
    is_good = position.gps_health is None or position.gps_health >= GOOD_GPS
    return {
        "header": header,
        "status": {"status": _FIX if is_good else _NO_FIX, "service": _GPS},
        "latitude": position.latitude_deg,
        "longitude": position.longitude_deg,
        "altitude": position.altitude_m,
        "position_covariance": _UNKNOWN,
        "position_covariance_type": 0,
    }


def _imu(
    header: dict[str, Any], attitude: Attitude | None, rates: AngularVelocity | None
) -> dict[str, Any]:
    # The acceleration of the package is in the ground frame and without gravity, which is not what
    # this message means: it has a topic of its own.
    turned = (0.0, 0.0, 0.0, 1.0) if attitude is None else attitude.enu_flu_xyzw
    turning = (
        (0.0, 0.0, 0.0)
        if rates is None
        else (rates.forward_rad_s, -rates.right_rad_s, -rates.down_rad_s)
    )
    return {
        "header": header,
        "orientation": dict(zip("xyzw", turned, strict=True)),
        "orientation_covariance": _NOT_THERE if attitude is None else _UNKNOWN,
        "angular_velocity": _vector(*turning),
        "angular_velocity_covariance": _NOT_THERE if rates is None else _UNKNOWN,
        "linear_acceleration": _vector(0.0, 0.0, 0.0),
        "linear_acceleration_covariance": _NOT_THERE,
    }


def _battery(header: dict[str, Any], battery: Battery) -> dict[str, Any]:
    unknown = ("voltage", "temperature", "current", "charge", "capacity", "design_capacity")
    kinds = ("power_supply_status", "power_supply_health", "power_supply_technology")
    return {
        "header": header,
        **dict.fromkeys(unknown, _NAN),
        "percentage": battery.percent / 100.0,
        **dict.fromkeys(kinds, 0),
        "present": True,
        "cell_voltage": [],
        "cell_temperature": [],
        "location": "",
        "serial_number": "",
    }
