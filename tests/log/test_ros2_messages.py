"""Messages of ROS 2 made of records, read back by rosbags, which was written by others."""

from __future__ import annotations

import math
from typing import Any

import pytest

from m100link.log.ros2 import Deviations, Messages
from m100link.protocol.records import (
    Acceleration,
    AngularVelocity,
    Attitude,
    Gimbal,
    Magnetometer,
    Position,
    RemoteControl,
    Velocity,
    in_body,
)

typesys: Any = pytest.importorskip("rosbags.typesys", reason="the judge is not installed")

MADE = Messages("odom", "base_link")
STAMP = 5, 6
HALF = math.sqrt(0.5)
NORTH = Attitude(1.0, 0.0, 0.0, 0.0)
EAST = Attitude(HALF, 0.0, 0.0, HALF)
NOSE_UP = Attitude(HALF, 0.0, HALF, 0.0)  # looks north, then straight up


def read(data: bytes, kind: str) -> Any:
    return typesys.get_typestore(typesys.Stores.LATEST).deserialize_cdr(data, kind)


def xyz(vector: Any) -> list[float]:
    return [vector.x, vector.y, vector.z]


@pytest.mark.parametrize(
    ("attitude", "enu", "flu"),
    [
        (NORTH, (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)),
        (NORTH, (1.0, 0.0, 0.0), (0.0, -1.0, 0.0)),
        (EAST, (1.0, 0.0, 0.0), (1.0, 0.0, 0.0)),
        (EAST, (0.0, 1.0, 0.0), (0.0, 1.0, 0.0)),
        (NOSE_UP, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)),
        (NOSE_UP, (0.0, 1.0, 0.0), (0.0, 0.0, -1.0)),
    ],
)
def test_a_vector_of_the_ground_in_the_body(attitude: Attitude, enu: Any, flu: Any) -> None:
    assert in_body(attitude.enu_flu_xyzw, enu) == pytest.approx(flu, abs=1e-9)


def test_an_aircraft_that_stands_feels_gravity_from_below() -> None:
    standing = read(
        MADE.imu(STAMP, EAST, AngularVelocity(0.1, 0.2, 0.3), Acceleration(0.0, 0.0, 0.0)),
        "sensor_msgs/msg/Imu",
    )
    assert xyz(standing.linear_acceleration) == pytest.approx([0.0, 0.0, 9.80665])
    assert xyz(standing.angular_velocity) == [0.1, -0.2, -0.3]
    turned = standing.orientation
    assert [turned.x, turned.y, turned.z, turned.w] == pytest.approx([0.0, 0.0, 0.0, 1.0])
    assert (standing.header.stamp.sec, standing.header.stamp.nanosec) == STAMP
    assert standing.header.frame_id == "base_link"


@pytest.mark.parametrize("missing", ["orientation", "angular_velocity", "linear_acceleration"])
def test_what_is_not_known_is_said_to_be_unknown(missing: str) -> None:
    known = {
        "orientation": EAST,
        "angular_velocity": AngularVelocity(0.1, 0.2, 0.3),
        "linear_acceleration": Acceleration(1.0, 2.0, 3.0),
    }
    del known[missing]
    given = [known.get(one) for one in ("orientation", "angular_velocity", "linear_acceleration")]
    found = read(MADE.imu(STAMP, *given), "sensor_msgs/msg/Imu")  # type: ignore[arg-type]  # Nones
    assert getattr(found, f"{missing}_covariance")[0] == -1.0
    for name in known:
        # Without an attitude nobody can tell what the body feels.
        is_there = missing != "orientation" or name != "linear_acceleration"
        # PX4's defaults, squared: EKF2_ANGERR_INIT, EKF2_GYR_NOISE, EKF2_ACC_NOISE.
        deviation = {"orientation": 0.1, "angular_velocity": 0.015, "linear_acceleration": 0.35}
        variance = getattr(found, f"{name}_covariance")[0]
        assert variance == pytest.approx(deviation[name] ** 2 if is_there else -1.0)


def test_the_magnetic_field_is_forward_left_up() -> None:
    """DJI's axes are forward, right, down; those of a body are turned about the first (REP 103)."""
    made = MADE.magnetometer(STAMP, Magnetometer(313.0, -1127.0, 851.0))
    found = read(made, "sensor_msgs/msg/MagneticField")
    field = xyz(found.magnetic_field)
    size = math.sqrt(313.0**2 + 1127.0**2 + 851.0**2)
    ours = math.hypot(*field)
    assert [one / ours for one in field] == pytest.approx(
        [313.0 / size, 1127.0 / size, -851.0 / size]
    )
    # Tesla: DJI calls 1000 to 2000 normal, and the field of the Earth is 25 to 65 µT.
    assert 25e-6 < ours < 65e-6
    assert list(found.magnetic_field_covariance) == [0.0] * 9, "sensor_msgs: not known"
    assert found.header.frame_id == "base_link"


def test_covariances_are_the_squares_of_the_deviations() -> None:
    """By rows; of a pose x, y, z, roll, pitch, yaw (geometry_msgs/PoseWithCovariance)."""
    made = Messages("odom", "base_link")
    made.deviate(Deviations(1.5, 2.5, 0.5, 0.25, 0.75, 0.125, 2.0))
    rates = AngularVelocity(0.1, 0.2, 0.3)
    data = made.odometry(STAMP, (4.0, 5.0, 6.0), NORTH, Velocity(2.0, 1.0, 0.5, None), rates)
    odometry = read(data, "nav_msgs/msg/Odometry")
    for found, squares in (
        (odometry.pose.covariance, [2.25, 2.25, 6.25, 0.0625, 0.0625, 0.5625]),
        (odometry.twist.covariance, [0.25, 0.25, 0.25, 0.015625, 0.015625, 0.015625]),
    ):
        matrix = found.reshape(6, 6)
        assert list(matrix.diagonal()) == squares
        assert matrix.sum() == pytest.approx(sum(squares))
    fix = read(made.fix(STAMP, Position(0.8, 0.2, 100.0, 5.0, 4)), "sensor_msgs/msg/NavSatFix")
    assert list(fix.position_covariance) == [2.25, 0, 0, 0, 2.25, 0, 0, 0, 6.25]
    assert fix.position_covariance_type == 1, "approximated"
    acceleration = Acceleration(1.0, 2.0, 3.0)
    imu = read(made.imu(STAMP, NORTH, rates, acceleration), "sensor_msgs/msg/Imu")
    assert list(imu.linear_acceleration_covariance) == [4.0, 0, 0, 0, 4.0, 0, 0, 0, 4.0]
    made.deviate(Deviations(position_m=0.0))
    fix = read(made.fix(STAMP, Position(0.8, 0.2, 100.0, 5.0, 4)), "sensor_msgs/msg/NavSatFix")
    assert fix.position_covariance_type == 0, "unknown"


def test_odometry_has_the_motion_in_the_body() -> None:
    velocity = Velocity(2.0, 1.0, 0.5, None)
    rates = AngularVelocity(0.1, 0.2, 0.3)
    data = MADE.odometry(STAMP, (4.0, 5.0, 6.0), NORTH, velocity, rates)
    found = read(data, "nav_msgs/msg/Odometry")
    assert (found.header.frame_id, found.child_frame_id) == ("odom", "base_link")
    assert xyz(found.pose.pose.position) == [4.0, 5.0, 6.0]
    assert xyz(found.twist.twist.linear) == pytest.approx([2.0, -1.0, 0.5])
    assert xyz(found.twist.twist.angular) == [0.1, -0.2, -0.3]
    pose = read(MADE.pose(STAMP, (4.0, 5.0, 6.0), NORTH), "geometry_msgs/msg/PoseStamped")
    assert pose.pose == found.pose.pose


def test_without_gps_there_is_no_fix() -> None:
    for health, status in ((None, 0), (3, 0), (2, -1)):
        data = MADE.fix(STAMP, Position(0.8, 0.2, 100.0, 5.0, health))
        found = read(data, "sensor_msgs/msg/NavSatFix")
        # A place without a fix says nothing, and neither does its covariance.
        kind = 1 if status == 0 else 0
        assert (found.status.status, found.position_covariance_type) == (status, kind)
        assert found.latitude == pytest.approx(math.degrees(0.8))


@pytest.mark.parametrize(
    ("angles", "ahead"),
    [((0, 0, 0), (0, 1, 0)), ((0, 0, 90), (1, 0, 0)), ((0, -90, 0), (0, 0, -1))],
)
def test_a_camera_looks_where_its_angles_say(angles: Any, ahead: Any) -> None:
    roll, pitch, yaw = angles
    found = read(
        MADE.gimbal(STAMP, Gimbal(roll, pitch, yaw, None)), "geometry_msgs/msg/QuaternionStamped"
    ).quaternion
    assert in_body((found.x, found.y, found.z, found.w), ahead) == pytest.approx((1, 0, 0))


def test_sticks_are_axes() -> None:
    found = read(
        MADE.joy(STAMP, RemoteControl(10000, -5000, 0, 2500, 8000, None)), "sensor_msgs/msg/Joy"
    )
    assert list(found.axes) == [1.0, -0.5, 0.0, 0.25]
    assert list(found.buttons) == [8000]  # the gear is not in it
