"""Times and messages as genpy of ROS Noetic has them."""

from __future__ import annotations

import math
from typing import Any

import pytest
from rospy_stand_in.genpy import RosDuration as Duration
from rospy_stand_in.genpy import RosTime as Time
from rospy_stand_in.genpy import (
    SerializationError,
    from_json,
    message_class,
    service_class,
    to_json,
)

from m100link.apps.station.ros.messages import MESSAGES, SERVICES

Joy: Any = message_class("sensor_msgs/Joy")
Odometry: Any = message_class("nav_msgs/Odometry")


@pytest.mark.parametrize(
    ("time", "secs", "nsecs"),
    [
        (Time(3, 5), 3, 5),
        (Time(3, 1_500_000_000), 4, 500_000_000),
        (Time(2.25), 2, 250_000_000),
        (Time.from_sec(1.5), 1, 500_000_000),
        (Duration(-1.5), -2, 500_000_000),
        (Duration(0.02), 0, 20_000_000),
        (Time(5) - Time(3, 1), 1, 999_999_999),
        (Time(5) + Duration(1.5), 6, 500_000_000),
        (Duration(1) + Time(5), 6, 0),
        (Time(5) - Duration(1.5), 3, 500_000_000),
        (Duration(3) * 0.5, 1, 500_000_000),
        (Duration(3) / 2, 1, 500_000_000),
        (-Duration(1), -1, 0),
        (abs(Duration(-1)), 1, 0),
    ],
)
def test_times(time: Any, secs: int, nsecs: int) -> None:
    assert (time.secs, time.nsecs) == (secs, nsecs)
    assert time.to_sec() == pytest.approx(secs + nsecs * 1e-9)
    assert time.to_nsec() == secs * 10**9 + nsecs


def test_times_compare_and_are_of_their_kind() -> None:
    assert Time(1) < Time(1, 1) <= Time(1, 1) > Time(1)
    assert Time(1) != Duration(1)
    assert isinstance(Time(2) - Time(1), Duration)
    assert Duration(6) / Duration(4) == 1.5
    assert not Duration()
    assert Time().is_zero()
    with pytest.raises(TypeError):
        Time(-1)
    assert abs(Time.now().to_sec() - __import__("time").time()) < 60


def test_a_message_has_its_fields_and_no_others() -> None:
    joy = Joy()
    assert (joy.axes, joy.buttons, joy.header.seq, joy.header.frame_id) == ([], [], 0, "")
    assert joy.header.stamp == Time()
    assert Joy(axes=[1.0]) == Joy(joy.header, [1.0], []) != joy
    assert Joy._type == "sensor_msgs/Joy"
    assert Joy._slot_types == ["std_msgs/Header", "float32[]", "int32[]"]
    with pytest.raises(TypeError):
        Joy([1, 2, 3, 4])
    with pytest.raises(TypeError):
        Joy(joy.header, axes=[])
    with pytest.raises(AttributeError):
        Joy(axis=[1.0])
    with pytest.raises(AttributeError):
        joy.axis = [1.0]
    assert Odometry().pose.covariance == [0.0] * 36
    assert str(message_class("std_msgs/String")(data="a")) == 'data: "a"'


def test_constants_are_of_the_class() -> None:
    assert message_class("sensor_msgs/NavSatStatus").STATUS_NO_FIX == -1  # type: ignore[attr-defined]
    assert message_class("visualization_msgs/Marker").SPHERE == 2  # type: ignore[attr-defined]
    task: Any = service_class("dji_sdk/DroneTaskControl")
    assert task._request_class.TASK_TAKEOFF == 4
    assert task._request_class(4).task == task._request_class(task=4).task == 4
    assert task._response_class().ack_data == 0


@pytest.mark.parametrize("name", MESSAGES)
def test_every_message_goes_out_and_comes_back(name: str) -> None:
    """What rosbridge sends is a message whose every value JSON can carry."""
    kind = message_class(name)
    message = kind()
    assert from_json(kind, to_json(message)) == message
    MESSAGES[name].read(to_json(message))


@pytest.mark.parametrize("name", SERVICES)
def test_every_service_has_its_two_classes(name: str) -> None:
    kind = service_class(name)
    SERVICES[name].read_request(to_json(kind._request_class()))
    assert kind._response_class._type == f"{name}Response"


def test_values_are_written_as_their_fields_say() -> None:
    numpy = pytest.importorskip("numpy")
    joy = Joy(axes=numpy.array([1, 2.5]), buttons=(numpy.int64(3), True))
    assert to_json(joy)["axes"] == [1.0, 2.5]
    assert to_json(joy)["buttons"] == [3, 1]
    assert to_json(message_class("std_msgs/UInt8")(data=numpy.uint8(4))) == {"data": 4}
    assert to_json(message_class("std_msgs/Float32")(data=math.nan)) == {"data": None}
    assert to_json(message_class("dji_sdk/MobileData")(data=[1, 254])) == {"data": "Af4="}
    assert to_json(message_class("dji_sdk/MobileData")(data="\x01\xfe")) == {"data": "Af4="}
    assert to_json(message_class("std_msgs/Time")(data=Time(3, 5))) == {
        "data": {"secs": 3, "nsecs": 5}
    }


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        ("std_msgs/UInt8", {"data": 4.5}),
        ("std_msgs/UInt8", {"data": "four"}),
        ("std_msgs/String", {"data": 4}),
        ("std_msgs/Float32", {"data": "x"}),
        ("sensor_msgs/Joy", {"axes": 5}),
        ("sensor_msgs/Joy", {"header": "now"}),
        ("std_msgs/Header", {"stamp": 1.5}),
    ],
)
def test_a_wrong_value_is_named(kind: str, values: dict[str, Any]) -> None:
    with pytest.raises(SerializationError, match=next(iter(values))):
        to_json(message_class(kind)(**values))


def test_what_comes_may_have_more_or_less_than_the_class() -> None:
    """Generations of one name: DJI's Gimbal of 2016 has no mode."""
    gimbal: Any = from_json(message_class("dji_sdk/Gimbal"), {"pitch": 4.5, "new": 1})
    assert (gimbal.pitch, gimbal.yaw, gimbal.mode) == (4.5, 0.0, 0)
    number: Any = from_json(message_class("std_msgs/Float32"), {"data": None})
    assert math.isnan(number.data)
