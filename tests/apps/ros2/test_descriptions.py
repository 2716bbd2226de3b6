"""Types of the node by its service: rosbags makes the same hash of what is answered."""

from __future__ import annotations

import hashlib
import json
from typing import Any

import pytest

from m100link.apps.ros2.topics import INPUTS, OUTPUTS, SERVICES
from m100link.log.cdr import full_name
from tests.apps.ros2.conftest import Program, Rig

typesys: Any = pytest.importorskip("rosbags.typesys", reason="the judge is not installed")

pytestmark = pytest.mark.anyio

KIND = "type_description_interfaces/srv/GetTypeDescription"
NAME = "~/get_type_description"


async def described(program: Program, name: str, **more: Any) -> dict[str, Any]:
    asked = {"type_hash": "", "include_type_sources": False, **more}
    return await program.call(NAME, KIND, type_name=name, **asked)


def hash_of(description: dict[str, Any]) -> str:
    """As REP 2016 makes it of a description: without defaults."""
    types = [description["type_description"], *description["referenced_type_descriptions"]]
    for one in types:
        for field in one["fields"]:
            assert field.pop("default_value") == ""
    return f"RIHS01_{hashlib.sha256(json.dumps(description).encode()).hexdigest()}"


async def test_each_message_of_the_table_is_described(rig: Rig, program: Program) -> None:
    store = typesys.get_typestore(typesys.Stores.LATEST)
    kinds = {full_name(row.kind) for table in (OUTPUTS, INPUTS) for row in table.values()}
    for kind in sorted(kinds):
        answer = await described(program, kind)
        assert answer["successful"], answer
        if not kind.startswith("m100_msgs/"):
            assert hash_of(answer["type_description"]) == store.hash_rihs01(kind)


async def test_services_and_parts_of_actions_are_described(rig: Rig, program: Program) -> None:
    for kind in ("m100_msgs/action/FlyTo_SendGoal", KIND, *{s.kind for s in SERVICES.values()}):
        answer = await described(program, kind, include_type_sources=True)
        assert answer["type_description"]["type_description"]["type_name"] == kind
        encodings = {one["type_name"]: one["encoding"] for one in answer["type_sources"]}
        assert encodings[kind] == ("implicit" if "/action/" in kind else "srv")


async def test_sources_are_there_when_they_are_asked_for(rig: Rig, program: Program) -> None:
    name = "sensor_msgs/msg/Imu"
    assert (await described(program, name))["type_sources"] == []
    answer = await described(program, name, include_type_sources=True)
    texts = {one["type_name"]: one["raw_file_contents"] for one in answer["type_sources"]}
    assert "float64[9] orientation_covariance" in texts[name]
    made: dict[str, Any] = {}
    for kind, text in texts.items():
        made |= typesys.get_types_from_msg(text, kind)
    assert set(made) == set(texts)


async def test_what_is_not_known_is_refused(rig: Rig, program: Program) -> None:
    for asked in (
        {"name": "sensor_msgs/msg/Image"},
        {"name": ""},
        {"name": "sensor_msgs/msg/Imu", "type_hash": "RIHS01_00"},
    ):
        answer = await described(program, **asked)
        assert not answer["successful"]
        assert answer["failure_reason"]
