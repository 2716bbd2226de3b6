"""Namespaces: several aircraft in one graph, and what a client has of each."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from typing import Any

import pytest

from m100link.apps.agent.lease import Lease
from m100link.apps.station.ros.client import Client
from m100link.apps.station.ros.graph import Graph
from m100link.sim.virtual import VirtualAircraft
from tests.apps.agent.conftest import task_of
from tests.apps.station.conftest import FakeClient, Rig
from tests.apps.station.ros.test_client import Bench

pytestmark = pytest.mark.anyio


@pytest.fixture
async def rigs() -> AsyncIterator[tuple[Rig, Rig]]:
    """Two aircraft in one graph, the second in a namespace."""
    first, second = Rig(VirtualAircraft(seed=5)), Rig(VirtualAircraft(seed=6))
    second.graph = first.graph.namespace("m100_2")
    async with AsyncExitStack() as stack:
        yield (
            await stack.enter_async_context(first.running()),
            await stack.enter_async_context(second.running()),
        )


def test_what_a_namespace_adds_is_called_by_its_name_and_seen_in_the_whole() -> None:
    whole = Graph()
    part = whole.namespace("m100_2")
    topic = part.add_topic("/flight_status", "std_msgs/Float32")
    part.add_service("/m100link/lease", "m100link/Lease", lambda call: None)
    assert whole.topics == {"/m100_2/flight_status": topic}
    assert list(whole.services) == ["/m100_2/m100link/lease"]
    assert part.namespace("x").prefix == "/m100_2/x"


def test_what_is_known_of_a_client_is_known_of_one_aircraft() -> None:
    whole = Graph()
    part = whole.namespace("m100_2")
    client = Client(whole)
    assert client in part.sessions
    part.known(client)["lease"] = Lease("a", "token", 1)
    assert whole.known(client) == {}


async def test_a_client_has_a_lease_for_each_aircraft(rigs: tuple[Rig, Rig]) -> None:
    first, second = rigs
    await first.activated()
    await second.activated()
    client = first.client()
    client.publish("/m100_2/nav_open_close_request", data=1)
    await second.until(lambda: second.agent.holding.has_authority)
    assert not first.agent.holding.has_authority
    client.publish("/nav_open_close_request", data=1)
    await first.until(lambda: first.agent.holding.has_authority)
    client.leave()
    await first.until(lambda: not first.agent.holding.has_authority)
    await second.until(lambda: not second.agent.holding.has_authority)


async def test_a_setpoint_reaches_the_aircraft_that_it_names(rigs: tuple[Rig, Rig]) -> None:
    first, second = rigs
    other = first.client("other")
    await _fly(second, other)
    before = len(first.moves)
    other.publish("/m100_2/sdk_request_ctrl", x=-2.0, y=0.0, z=0.0, w=0.0)
    await second.until(lambda: any(move.roll_or_x or move.pitch_or_y for move in second.moves))
    assert len(first.moves) == before
    other.publish("/sdk_request_ctrl", x=-2.0, y=0.0, z=0.0, w=0.0)
    assert any(
        "open control first (/nav_open_close_request 1 or " in one for one in other.statuses()
    )


async def _fly(rig: Rig, client: FakeClient) -> None:
    await rig.activated()
    client.publish("/m100_2/nav_open_close_request", data=1)
    await rig.until(lambda: rig.agent.holding.has_authority)
    client.publish("/m100_2/sdk_request_cmd", data=4)
    await rig.until(lambda: task_of(rig.agent) is not None)
    await rig.until(lambda: task_of(rig.agent) is None)


# -- what roslib -----------------------------------------------------------------------------------


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


# -- events are a topic ----------------------------------------------------------------------------


async def test_each_event_is_reported_with_its_level(rig: Rig) -> None:
    client = rig.client()
    client.subscribe("/rosout")
    rig.agent.journal.note("a thing happened")
    rig.agent.journal.note("a bad thing happened", "error")
    await rig.until(lambda: len(client.read()) == 2)
    first, second = (one["msg"] for one in client.read())
    assert (first["level"], first["msg"], first["name"]) == (2, "a thing happened", "/m100link")
    assert (second["level"], second["msg"]) == (8, "a bad thing happened")
    assert second["header"]["seq"] == first["header"]["seq"] + 1
