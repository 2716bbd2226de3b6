"""The inertial sensors that the fronts tell, of an aircraft with raw or fused acceleration.

An accelerometer feels what keeps it from falling: at rest 1 g upwards. REP 103 and 145 (ROS):
forward, left, up. MAVLink HIGHRES_IMU: forward, right, down. Within 0.05 m/s².
"""

from __future__ import annotations

import math
from typing import Any

import pytest

from m100link.log.ros2 import DJI_TOPICS, Messages
from m100link.protocol import encode_telemetry, profile
from m100link.protocol.records import Acceleration, AngularVelocity, Attitude
from m100link.telemetry.sample import AccelerationReader, Sample
from tests.apps.mavlink.translator.test_telemetry import told
from tests.known import Known

FIRMWARE = profile("3.1")
G = 9.80665
RATES = (0.0, 0.0, 0.0)
_HALF, _20, _35 = math.sqrt(0.5), math.radians(20.0), math.radians(35.7)

# Quaternion from the body (forward, right, down) to north, east, down; acceleration over ground
# (north, east, up); what a sensor feels forward, right, down. All by hand.
MOTIONS: dict[str, tuple[Any, Any, Any]] = {
    "at rest": ((1, 0, 0, 0), (0, 0, 0), (0, 0, -G)),
    "at rest, nose to the south": ((0, 0, 0, 1), (0, 0, 0), (0, 0, -G)),
    "on a slope, nose 20° up": (
        (math.cos(_20 / 2), 0, math.sin(_20 / 2), 0),
        (0, 0, 0),
        (G * math.sin(_20), 0, -G * math.cos(_20)),
    ),
    "on a slope, right side 20° down": (
        (math.cos(_20 / 2), math.sin(_20 / 2), 0, 0),
        (0, 0, 0),
        (0, -G * math.sin(_20), -G * math.cos(_20)),
    ),
    "nose to the east, faster to the north": ((_HALF, 0, 0, _HALF), (2, 0, 0), (0, -2, -G)),
    "nose to the west, slower and down": ((_HALF, 0, 0, -_HALF), (0, 1, -3), (-1, 0, 3 - G)),
    # Its thrust points along the body's axis alone: g / cos 35.7°.
    "35.7° forward at a constant height": (
        (math.cos(_35 / 2), 0, -math.sin(_35 / 2), 0),
        (G * math.tan(_35), 0, 0),
        (0, 0, -G / math.cos(_35)),
    ),
}


def flying(mode: str, motion: str) -> Sample:
    """A package in the air, of a line that stood for a second before."""
    attitude, ground, felt = MOTIONS[motion]
    reader = AccelerationReader()

    def read(acceleration: Any, attitude: Any, status: int, at: float) -> bytes:
        items = {"quaternion": attitude, "acceleration": acceleration, "angular_velocity": RATES}
        value = encode_telemetry(items | {"flight_status": (status,)}, FIRMWARE)
        return reader.read(value, FIRMWARE, at)

    for number in range(102):
        read((0, 0, -1) if mode == "raw" else (0, 0, 0), (1, 0, 0, 0), 1, number / 100)
    assert reader.mode == mode
    raw = tuple(one / G for one in felt)
    value = read(raw if mode == "raw" else ground, attitude, 3, 1.02)
    return Sample(value, FIRMWARE, 1.02)


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("mode", ["raw", "fused"])
def test_rosbridge_ros2_and_mavlink_tell_what_a_sensor_feels(mode: str, motion: str) -> None:
    pytest.importorskip("rosbags", reason="rosbags is not installed")
    from tests.log.test_ros2_messages import read, xyz

    sample = flying(mode, motion)
    forward, right, down = MOTIONS[motion][2]
    flu = pytest.approx((forward, -right, -down), abs=0.05)
    dji = DJI_TOPICS["imu"].make(sample)
    assert dji is not None
    assert tuple(dji["linear_acceleration"].values()) == flu
    data = Messages("odom", "base_link").imu(
        (1, 2), sample.attitude, sample.angular_velocity, sample.acceleration
    )
    assert tuple(xyz(read(data, "sensor_msgs/msg/Imu").linear_acceleration)) == flu
    known = Known(*(sample[one] for one in (Attitude, AngularVelocity, Acceleration)))
    imu = told("HIGHRES_IMU", known)
    assert imu["fields_updated"] == 0b111_111
    assert (imu["xacc"], imu["yacc"], imu["zacc"]) == pytest.approx(
        (forward, right, down), abs=0.05
    )


def test_nothing_is_told_before_the_mode_is_known() -> None:
    items = {"quaternion": (1, 0, 0, 0), "acceleration": (0, 0, -1), "angular_velocity": RATES}
    value = AccelerationReader().read(encode_telemetry(items, FIRMWARE), FIRMWARE, 0.0)
    sample = Sample(value, FIRMWARE, 0.0)
    assert sample.acceleration is None
    assert DJI_TOPICS["imu"].make(sample) is None
    assert DJI_TOPICS["acceleration_ground_fused"].make(sample) is None
