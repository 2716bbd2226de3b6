"""What roslib, roslibpy and Foxglove ask before they do anything."""

from __future__ import annotations

from typing import Any

import pytest

from tests.apps.station.ros.test_client import Bench


def ask(name: str, /, **args: Any) -> Any:
    (answer,) = Bench().send("call_service", service=f"/rosapi/{name}", args=args)
    assert answer["result"], answer
    return answer["values"]


def test_topics_and_services() -> None:
    topics = ask("topics")
    assert dict(zip(topics["topics"], topics["types"], strict=True)) == {
        "/height": "std_msgs/Float32",
        "/joy": "sensor_msgs/Joy",
        "/steer": "std_msgs/Float32",
    }
    raw = ask("topics_and_raw_types")
    assert (raw["topics"], raw["types"]) == (topics["topics"], topics["types"])
    assert raw["typedefs_full_text"][0] == "float32 data"
    assert ask("topic_type", topic="height") == {"type": "std_msgs/Float32"}
    assert ask("topic_type", topic="/none") == {"type": ""}
    assert ask("topics_for_type", type="sensor_msgs/msg/Joy") == {"topics": ["/joy"]}
    assert ask("service_type", service="/task") == {"type": "dji_sdk/DroneTaskControl"}
    assert "/task" in ask("services")["services"]
    assert ask("services_for_type", type="dji_sdk/DroneTaskControl") == {"services": ["/task"]}


def test_one_node_does_everything() -> None:
    assert ask("nodes") == {"nodes": ["/m100link"]}
    details = ask("node_details", node="m100link")
    assert details["publishing"] == ["/height", "/joy"]
    assert details["subscribing"] == ["/steer"]
    assert "/task" in details["services"]
    assert ask("node_details", node="/other")["services"] == []
    assert ask("publishers", topic="/height") == {"publishers": ["/m100link"]}
    assert ask("subscribers", topic="/height") == {"subscribers": []}
    assert ask("subscribers", topic="/steer") == {"subscribers": ["/m100link"]}
    assert ask("service_node", service="/task") == {"node": "/m100link"}
    assert ask("service_host", service="/none") == {"host": ""}
    assert ask("service_providers", service="dji_sdk/DroneTaskControl")["providers"]
    assert ask("action_servers") == {"action_servers": []}


def test_types_in_detail() -> None:
    joy, header = ask("message_details", type="sensor_msgs/Joy")["typedefs"]
    assert joy["type"] == "sensor_msgs/Joy"
    assert joy["fieldnames"] == ["header", "axes", "buttons"]
    assert joy["fieldtypes"] == ["std_msgs/Header", "float32", "int32"]
    assert joy["fieldarraylen"] == [-1, 0, 0]
    assert joy["examples"] == ["{}", "[]", "[]"]
    assert header["type"] == "std_msgs/Header"
    (task,) = ask("service_request_details", type="dji_sdk/DroneTaskControl")["typedefs"]
    assert (task["type"], task["fieldnames"]) == ("dji_sdk/DroneTaskControlRequest", ["task"])
    (answer,) = ask("service_response_details", type="dji_sdk/DroneTaskControl")["typedefs"]
    assert answer["fieldnames"] == ["result", "cmd_set", "cmd_id", "ack_data"]


def test_there_are_no_parameters() -> None:
    assert ask("get_param_names") == {"names": []}
    assert ask("has_param", name="/x") == {"exists": False}
    assert ask("get_param", name="/x", default="5") == {"value": "5"}
    assert ask("get_param", name="/x") == {"value": "null"}
    assert ask("search_param", name="x") == {"global_name": ""}
    assert ask("get_time")["time"]["secs"] > 0


@pytest.mark.parametrize(
    ("name", "args"),
    [
        ("message_details", {"type": "no/Type"}),
        ("service_request_details", {"type": "no/Type"}),
        ("set_param", {"name": "/x", "value": "1"}),
        ("delete_param", {"name": "/x"}),
    ],
)
def test_what_cannot_be_answered_fails_and_says_why(name: str, args: Any) -> None:
    (answer,) = Bench().send("call_service", service=f"/rosapi/{name}", args=args)
    assert answer["result"] is False
    assert "there" in answer["values"]
