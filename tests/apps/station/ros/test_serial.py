"""Bytes and definitions as ROS 1 has them, written out by hand."""

from __future__ import annotations

import struct

import pytest

from m100link.apps.station.ros.messages import MESSAGES
from m100link.apps.station.ros.serial import definition, serialise

RULE = "\n" + "=" * 80 + "\n"


def test_a_message_with_everything_in_it() -> None:
    kind = MESSAGES["sensor_msgs/Joy"]
    header = {"seq": 7, "stamp": {"secs": 1, "nsecs": 2}, "frame_id": "rc"}
    data = serialise(kind, {"header": header, "axes": [1.0, -2.0], "buttons": [3]})
    assert data == b"".join(
        (
            struct.pack("<III", 7, 1, 2),
            struct.pack("<I", 2) + b"rc",
            struct.pack("<Iff", 2, 1.0, -2.0),
            struct.pack("<Ii", 1, 3),
        )
    )


def test_fixed_arrays_have_no_length_and_bytes_are_bytes() -> None:
    imu = MESSAGES["sensor_msgs/Imu"]
    assert len(serialise(imu, imu.default())) == 16 + 8 * (4 + 9 + 3 + 9 + 3 + 9)
    assert serialise(MESSAGES["dji_sdk/MobileData"], {"data": b"\1\2"}) == b"\2\0\0\0\1\2"


@pytest.mark.parametrize("name", sorted(MESSAGES))
def test_every_type_has_bytes_and_a_definition(name: str) -> None:
    kind = MESSAGES[name]
    assert isinstance(serialise(kind, kind.default()), bytes)
    assert definition(kind).count("MSG: ") == len(set(definition(kind).split("MSG: "))) - 1


def test_a_definition_is_followed_by_those_in_it() -> None:
    assert definition(MESSAGES["geometry_msgs/QuaternionStamped"]) == RULE.join(
        (
            "Header header\ngeometry_msgs/Quaternion quaternion",
            "MSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id",
            "MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w",
        )
    )
    assert "float32[] axes" in definition(MESSAGES["sensor_msgs/Joy"])
    assert "float64[9] orientation_covariance" in definition(MESSAGES["sensor_msgs/Imu"])
