"""Messages of ROS 2, read back by rosbags, which was written by others."""

from __future__ import annotations

import math
from typing import Any

import pytest

from m100link.log.cdr import DEFINITIONS, definition, encode

typesys: Any = pytest.importorskip("rosbags.typesys", reason="the judge is not installed")


@pytest.fixture(params=["ROS2_HUMBLE", "ROS2_JAZZY", "LATEST"])
def store(request: pytest.FixtureRequest) -> Any:
    return typesys.get_typestore(getattr(typesys.Stores, request.param))


def full(name: str) -> str:
    package, message = name.split("/")
    return f"{package}/msg/{message}"


@pytest.mark.parametrize("name", DEFINITIONS)
def test_every_definition_is_that_of_ros(store: Any, name: str) -> None:
    ours = typesys.get_types_from_msg(definition(name), full(name))
    for kind, (_, fields) in ours.items():
        assert fields == store.get_msgdef(kind).fields, kind


@pytest.mark.parametrize("frame", ["", "a", "base_link"])
def test_what_is_encoded_is_decoded_by_others(store: Any, frame: str) -> None:
    header = {"stamp": {"sec": 7, "nanosec": 8}, "frame_id": frame}
    unknown = {
        name: math.pi * number
        for number, name in enumerate(
            ("voltage", "temperature", "current", "charge", "capacity", "design_capacity")
        )
    }
    battery = {
        "header": header,
        **unknown,
        "percentage": 0.5,
        "power_supply_status": 1,
        "power_supply_health": 2,
        "power_supply_technology": 3,
        "present": True,
        "cell_voltage": [1.0, 2.0, 3.0],
        "cell_temperature": [],
        "location": "slot",
        "serial_number": "",
    }
    data = encode("sensor_msgs/BatteryState", battery)
    found = store.deserialize_cdr(data, "sensor_msgs/msg/BatteryState")
    assert (found.header.frame_id, found.header.stamp.nanosec) == (frame, 8)
    assert found.current == pytest.approx(2 * math.pi, rel=1e-6)
    assert list(found.cell_voltage) == [1.0, 2.0, 3.0]
    assert (found.present, found.location, found.serial_number) == (True, "slot", "")
    vector = {"x": 1.5, "y": -2.5, "z": 1e300}
    rotation = {"x": 0.1, "y": 0.2, "z": 0.3, "w": 0.4}
    one = {
        "header": header,
        "child_frame_id": frame * 3,
        "transform": {"translation": vector, "rotation": rotation},
    }
    data = encode("tf2_msgs/TFMessage", {"transforms": [one, one]})
    found = store.deserialize_cdr(data, "tf2_msgs/msg/TFMessage")
    assert [each.child_frame_id for each in found.transforms] == [frame * 3] * 2
    assert found.transforms[1].transform.rotation.w == 0.4


def test_an_array_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match="has 9 values"):
        encode("sensor_msgs/NavSatFix", _fix_with([0.0] * 8))


def _fix_with(covariance: list[float]) -> dict[str, Any]:
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    status = {"status": 0, "service": 1}
    place = dict.fromkeys(("latitude", "longitude", "altitude"), 0.0)
    return {"header": header, "status": status, **place, "position_covariance": covariance}
