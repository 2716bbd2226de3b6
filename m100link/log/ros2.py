"""A flight log as a bag of ROS 2: an MCAP file with its messages in CDR.

The ground is ``map``, the body ``base_link``.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import IO, Any

from m100link.log.cdr import definition, encode
from m100link.log.channels import COMMAND, EVENT
from m100link.log.reading import FlightLog
from m100link.log.records import mcap_module
from m100link.log.ros2_messages import Messages, Stamp
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

_MESSAGES = Messages("map", "base_link")


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
    for topic, at_ns, data in _messages(flight, firmware):
        writer.add_message(
            channel_id=channels[topic],
            log_time=at_ns,
            publish_time=at_ns,
            data=data,
        )
        count += 1
    writer.finish()
    return count


def _messages(
    flight: FlightLog, firmware: str | FirmwareProfile | None
) -> Iterator[tuple[str, int, bytes]]:
    offset = None
    for message in flight.messages(COMMAND, EVENT):
        text = encode("std_msgs/String", {"data": message.data.decode("utf-8", "replace")})
        yield "/m100/events", max(0, round(message.utc * 1e9)), text
    for message in flight.messages():
        offset = message.utc - message.at
        break
    if offset is None:
        return
    for sample in flight.samples(firmware=firmware):
        at_ns = max(0, round((sample.received_at + offset) * 1e9))
        for topic, data in _told(sample, divmod(at_ns, 10**9)):
            yield topic, at_ns, data


def _told(sample: Sample, stamp: Stamp) -> Iterator[tuple[str, bytes]]:
    made = _MESSAGES
    position, attitude = sample.get(Position), sample.get(Attitude)
    if position is not None:
        yield "/m100/fix", made.fix(stamp, position)
    rates, acceleration = sample.get(AngularVelocity), sample.get(Acceleration)
    if attitude is not None or rates is not None:
        yield "/m100/imu", made.imu(stamp, attitude, rates, acceleration)
    if attitude is not None and position is not None and position.is_possible:
        yield "/tf", made.transform(stamp, (0.0, 0.0, position.height_m), attitude)
    velocity = sample.get(Velocity)
    if velocity is not None:
        yield "/m100/velocity", made.velocity(stamp, velocity)
    if acceleration is not None:
        yield "/m100/acceleration", made.acceleration(stamp, acceleration)
    battery = sample.get(Battery)
    if battery is not None:
        yield "/m100/battery", made.battery(stamp, battery)
    rc = sample.get(RemoteControl)
    if rc is not None:
        yield "/m100/joy", made.joy(stamp, rc)
    status = sample.get(FlightStatus)
    if status is not None:
        yield "/m100/flight_status", encode("std_msgs/UInt8", {"data": status.status})
