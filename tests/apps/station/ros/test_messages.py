"""Values against ROS types, and their packings."""

from __future__ import annotations

import base64
import json
import math
import struct
import zlib
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from m100link.apps.station.ros.messages import (
    MESSAGES,
    SERVICES,
    BadMessage,
    Reassembly,
    canonical_type,
    definition,
    fragments,
    serialise,
    to_png,
)


def test_what_is_missing_gets_its_default() -> None:
    message = MESSAGES["geometry_msgs/QuaternionStamped"].read({"quaternion": {"w": 1}})
    assert message == {
        "header": {"seq": 0, "stamp": {"secs": 0, "nsecs": 0}, "frame_id": ""},
        "quaternion": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
    }


@pytest.mark.parametrize(
    ("kind", "value", "says"),
    [
        ("std_msgs/Float32", {"dta": 1}, "no field 'dta'"),
        ("std_msgs/Float32", {"data": "1"}, "data is not a number"),
        ("std_msgs/Float32", {"data": True}, "data is not a number"),
        ("std_msgs/Float32", {"data": 1e39}, "float32"),
        ("std_msgs/Float32", {"data": 10**400}, None),
        ("std_msgs/Float32", [], "is not an object"),
        ("std_msgs/UInt8", {"data": 256}, "outside 0 to 255"),
        ("std_msgs/UInt8", {"data": 1.5}, "data is not of type uint8"),
        ("std_msgs/UInt8", {"data": False}, "data is not of type uint8"),
        ("std_msgs/Bool", {"data": 1}, "true or false"),
        ("std_msgs/String", {"data": 1}, "not a string"),
        ("std_msgs/Header", {"stamp": 5}, "stamp is not a time"),
        ("std_msgs/Header", {"stamp": {"secs": -1}}, "outside 0"),
        ("sensor_msgs/Joy", {"axes": "1"}, "axes is not a list"),
        ("sensor_msgs/Joy", {"buttons": [1 << 31]}, "outside -2147483648 to 2147483647"),
        ("sensor_msgs/Joy", {"axes": [0.0, None, "x"]}, r"axes\[2\] is not a number"),
        ("sensor_msgs/Joy", {"header": {"stamp": {"x": 1}}}, "header.stamp is not a time"),
        ("sensor_msgs/Imu", {"orientation_covariance": [0.0]}, "takes 9"),
        ("dji_sdk/MissionWaypointAction", {"command_list": [0] * 14}, "has 14 elements"),
        ("dji_sdk/MissionWaypointAction", {"command_list": [0] * 17}, "more than 16"),
        ("dji_sdk/MissionWaypointAction", {"command_parameter": [-32769] * 16}, "outside -32768"),
        ("dji_sdk/MissionWaypointAction", {"command_parameter": [65536] * 16}, "outside 0 to 65"),
        ("dji_sdk/MissionWaypointAction", {"command_parameter": ["x"] * 16}, r"parameter\[0\]"),
        ("dji_sdk/MobileData", {"data": "?"}, "base64"),
        ("dji_sdk/MobileData", {"data": [300]}, "base64"),
        ("dji_sdk/MobileData", {"data": 5}, "base64"),
    ],
)
def test_an_error_names_the_field(kind: str, value: Any, says: str | None) -> None:
    if says is None:
        assert math.isinf(MESSAGES[kind].read(value)["data"])
        return
    with pytest.raises(BadMessage, match=says):
        MESSAGES[kind].read(value)


@pytest.mark.parametrize(
    ("part", "fields"),
    [
        ("Goal", "header:std_msgs/Header goal_id:actionlib_msgs/GoalID goal"),
        ("Result", "header:std_msgs/Header status:actionlib_msgs/GoalStatus result"),
        ("Feedback", "header:std_msgs/Header status:actionlib_msgs/GoalStatus feedback"),
    ],
)
def test_around_each_part_of_an_action_stands_what_actionlib_puts_there(
    part: str, fields: str
) -> None:
    task = "dji_sdk/DroneTask"
    found = " ".join(f"{one.name}:{one.type}" for one in MESSAGES[f"{task}Action{part}"].fields)
    assert found == f"{fields}:{task}{part}"


def test_null_is_no_number_both_ways() -> None:
    kind = MESSAGES["std_msgs/Float32"]
    assert math.isnan(kind.read({"data": None})["data"])
    assert kind.to_json({"data": math.nan}) == kind.to_json({"data": math.inf}) == '{"data":null}'


def test_bytes_travel_as_base64_or_as_a_list() -> None:
    kind = MESSAGES["dji_sdk/MobileData"]
    assert kind.read({"data": "AQID"}) == kind.read({"data": [1, 2, 3]}) == {"data": b"\1\2\3"}
    assert kind.to_json({"data": b"\1\2\3"}) == '{"data":"AQID"}'


def test_a_whole_number_written_as_a_float_is_an_integer() -> None:
    # JavaScript knows one kind of number.
    assert MESSAGES["std_msgs/UInt8"].read({"data": 4.0}) == {"data": 4}


def test_times_of_ros_2_are_read() -> None:
    header = MESSAGES["std_msgs/Header"].read({"stamp": {"sec": 1, "nanosec": 2}})
    assert header["stamp"] == {"secs": 1, "nsecs": 2}
    assert canonical_type("std_msgs/msg/Float32") == "std_msgs/Float32"


def test_service_arguments_come_as_object_list_or_nothing() -> None:
    kind = SERVICES["dji_sdk/DroneTaskControl"]
    assert kind.read_request({"task": 4}) == kind.read_request([4]) == {"task": 4}
    assert kind.read_request(None) == kind.read_request([]) == {"task": 0}
    with pytest.raises(BadMessage, match="takes 1"):
        kind.read_request([4, 5])


@pytest.mark.parametrize("name", sorted(MESSAGES))
def test_every_type_survives_its_own_json(name: str) -> None:
    kind = MESSAGES[name]
    assert kind.read(json.loads(kind.to_json(kind.default()))) == kind.default()


def test_numeric_arrays_become_typed_arrays_in_cbor() -> None:
    import cbor2

    kind = MESSAGES["sensor_msgs/Joy"]
    message = kind.read({"axes": [1.5, -2.0], "buttons": [7, -1]})
    value = cbor2.loads(cbor2.dumps(kind.to_cbor(message)))
    assert (value["axes"].tag, value["axes"].value) == (85, struct.pack("<2f", 1.5, -2.0))
    assert (value["buttons"].tag, value["buttons"].value) == (78, struct.pack("<2i", 7, -1))


def unpack_png(frame: str) -> str:
    """Read the pixels back; knows only what the writer may use."""
    image = base64.b64decode(json.loads(frame)["data"])
    assert image[:8] == b"\x89PNG\r\n\x1a\n"
    chunks, at = {}, 8
    while at < len(image):
        (size,) = struct.unpack_from(">I", image, at)
        kind, data = image[at + 4 : at + 8], image[at + 8 : at + 8 + size]
        assert struct.unpack_from(">I", image, at + 8 + size)[0] == zlib.crc32(kind + data)
        chunks[kind] = data
        at += 12 + size
    width, height, depth, colour = struct.unpack_from(">IIBB", chunks[b"IHDR"])
    assert (depth, colour) == (8, 2)
    assert abs(width - height) <= 3, "about a square"
    rows, stride = zlib.decompress(chunks[b"IDAT"]), 3 * width + 1
    assert len(rows) == height * stride
    return b"".join(rows[i * stride + 1 : (i + 1) * stride] for i in range(height)).decode()


def test_what_is_no_value_of_a_message_is_not_written_as_null() -> None:
    with pytest.raises(TypeError, match="object is not a value of a ROS message"):
        MESSAGES["std_msgs/String"].to_json({"data": object()})


@given(st.text(min_size=1, max_size=300))
def test_a_png_carries_its_text(text: str) -> None:
    written = json.dumps(text)
    assert json.loads(unpack_png(to_png(written))) == text


@given(st.text(max_size=80), st.integers(1, 50), st.randoms())  # 12 signs each, and 1,000 pieces
def test_fragments_in_any_order_make_the_text(text: str, size: int, random: Any) -> None:
    pieces = [json.loads(one) for one in fragments(json.dumps({"t": text}), size, "7")]
    if len(pieces) == 1:
        assert pieces == [{"t": text}]
        return
    random.shuffle(pieces)
    reassembly = Reassembly(100_000)
    results = [reassembly.add(piece, 0.0) for piece in pieces]
    assert results[:-1] == [None] * (len(pieces) - 1)
    assert json.loads(results[-1] or "") == {"t": text}


@pytest.mark.parametrize(
    "fragment",
    [
        {},
        {"id": [], "data": "x", "num": 0, "total": 1},
        {"id": "1", "data": 5, "num": 0, "total": 1},
        {"id": "1", "data": "x", "num": True, "total": 1},
        {"id": "1", "data": "x", "num": 0.0, "total": 1},
        {"id": "1", "data": "x", "num": 1, "total": 1},
        {"id": "1", "data": "x", "num": -1, "total": 1},
        {"id": "1", "data": "x", "num": 0, "total": 1001},
        {"id": "1", "data": "x" * 101, "num": 0, "total": 2},
    ],
)
def test_fragments_that_cannot_be_are_refused(fragment: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"fragment|longer|integers"):
        Reassembly(100).add(fragment, 0.0)


def test_unfinished_messages_are_few_and_forgotten() -> None:
    reassembly = Reassembly(100)
    for number in range(4):
        reassembly.add({"id": number, "data": "x", "num": 0, "total": 2}, 0.0)
    with pytest.raises(ValueError, match="unfinished"):
        reassembly.add({"id": 9, "data": "x", "num": 0, "total": 2}, 9.0)
    assert reassembly.add({"id": 9, "data": "x", "num": 0, "total": 2}, 10.1) is None
    with pytest.raises(ValueError, match="does not fit"):
        reassembly.add({"id": 9, "data": "x", "num": 0, "total": 2}, 10.2)  # the same one again


# -- bytes and definitions as ROS 1 has them, written out by hand ----------------------------------

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
