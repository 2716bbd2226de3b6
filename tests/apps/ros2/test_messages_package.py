"""The package m100_msgs, as rosbags reads its files: the same fields and hashes as here."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from m100link.apps.ros2 import MESSAGES
from m100link.apps.ros2.services import ACTIONS as MISSION_ACTIONS
from m100link.log.cdr import ACTIONS, DEFINITIONS, OWN_PACKAGE, SERVICES, full_name, type_hash
from m100link.missions.waypoint import AtEnd, Heading, OnRCLoss, Trace
from m100link.protocol.records import FlightPhase

typesys: Any = pytest.importorskip("rosbags.typesys", reason="the judge is not installed")

FILES = sorted(MESSAGES.rglob("*.msg"))
OWN = [one for one in DEFINITIONS if one.startswith(f"{OWN_PACKAGE}/") and one.count("/") == 1]


OWN_SERVICES = [one for one in SERVICES if one.startswith(f"{OWN_PACKAGE}/")]


def of_file(path: Path) -> str:
    return f"{OWN_PACKAGE}/{path.stem}"


def test_each_message_has_a_file_and_is_built() -> None:
    assert {of_file(path) for path in FILES} == set(OWN)
    built = re.findall(
        r'"((?:msg|srv|action)/\w+\.\w+)"', (MESSAGES / "CMakeLists.txt").read_text()
    )
    there = [str(one.relative_to(MESSAGES)) for one in MESSAGES.rglob("*.*")]
    assert sorted(built) == sorted(
        one for one in there if one.endswith((".msg", ".srv", ".action"))
    )


@pytest.mark.parametrize("release", ["ROS2_JAZZY", "ROS2_KILTED", "LATEST"])
@pytest.mark.parametrize("path", FILES, ids=of_file)
def test_files_have_the_hashes_of_the_node(path: Path, release: str) -> None:
    store = typesys.get_typestore(getattr(typesys.Stores, release))
    for one in FILES:  # they stand in each other
        store.register(typesys.get_types_from_msg(one.read_text(), full_name(of_file(one))))
    name = full_name(of_file(path))
    assert store.hash_rihs01(name) == type_hash(of_file(path))


@pytest.mark.parametrize("name", ACTIONS)
def test_actions_have_the_fields_of_their_files(name: str) -> None:
    text = (MESSAGES / "action" / f"{name.rpartition('/')[2]}.action").read_text()
    text = re.sub(r"#.*", "", text)
    parts = ["\n".join(one.split("\n")) for one in text.split("---")]
    fields = ["\n".join(line for line in part.splitlines() if line.strip()) for part in parts]
    assert tuple(fields) == ACTIONS[name]


@pytest.mark.parametrize("name", OWN_SERVICES)
def test_services_have_the_fields_of_their_files(name: str) -> None:
    text = (MESSAGES / "srv" / f"{name.rpartition('/')[2]}.srv").read_text()
    parts = re.sub(r"#.*|uint8 \w+=\d+", "", text).split("---")
    fields = ["\n".join(line for line in part.splitlines() if line.strip()) for part in parts]
    assert tuple(fields) == SERVICES[name]


@pytest.mark.parametrize("name", ACTIONS)
def test_parts_of_actions_have_the_hashes_of_rosbags(name: str) -> None:
    store = typesys.get_typestore(typesys.Stores.LATEST)
    for path in FILES:
        store.register(typesys.get_types_from_msg(path.read_text(), full_name(of_file(path))))
    for part in ("Goal", "Result", "Feedback", "FeedbackMessage"):
        text = DEFINITIONS[f"{name}_{part}"].replace(f"{name}_Feedback ", "Feedback_ ")
        inner = f"{name}_Feedback"
        if part == "FeedbackMessage":
            text = DEFINITIONS[f"{name}_{part}"]
            assert inner in text
            continue  # rosbags has no messages named by three words within another
        store.register(typesys.get_types_from_msg(text, f"{name}_{part}"))
        assert store.hash_rihs01(f"{name}_{part}") == type_hash(f"{name}_{part}")


def constants(file: str) -> dict[str, int]:
    text = (MESSAGES / file).read_text()
    return {name: int(number) for name, number in re.findall(r"uint8 (\w+)=(\d+)", text)}


def test_numbers_of_missions_are_those_of_the_library() -> None:
    found = constants("srv/UploadMission.srv")
    expected = {one.name: one.value for kind in (Heading, Trace, AtEnd, OnRCLoss) for one in kind}
    expected["BY_POINT"] = expected.pop("BY_WAYPOINT")  # they are called points here
    assert found == expected
    assert list(constants("msg/MissionAction.msg")) == list(MISSION_ACTIONS)
    assert list(constants("msg/MissionAction.msg").values()) == list(range(len(MISSION_ACTIONS)))


def test_phases_are_those_of_the_protocol() -> None:
    assert constants("msg/FlightStatus.msg") == {one.name: one.value for one in FlightPhase} | {
        "UNKNOWN": 255
    }
