"""The packages around a program: which are found, and the types that they define."""

from __future__ import annotations

from pathlib import Path

import pytest
from rospy_stand_in.genpy import message_class, service_class
from rospy_stand_in.packages import Finder, packages_in, packages_of, read_types

from m100link.apps.station.ros.messages import MESSAGES, SERVICES

MESSAGE = """
# What a detector saw.
uint8 NONE = 0   # nothing
uint8 TAG=0x10
float32 LIMIT=0.5
bool ON=True
string NAME = a = b
Header header
Corner[4] corners
Corner best
geometry_msgs/Pose[] poses   # in the camera
int32 id
"""


@pytest.fixture
def workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("rospy_stand_in.packages.MESSAGES", messages := dict(MESSAGES))
    monkeypatch.setattr("rospy_stand_in.genpy.MESSAGES", messages)
    for name in ("src/detector", "src/meta/pilot", "src/.hidden", "other"):
        folder = tmp_path / name
        folder.mkdir(parents=True)
        (folder / "package.xml").write_text(f"<package>\n <name> {folder.name} </name></package>")
    detector = tmp_path / "src/detector"
    for name, text in (
        ("msg/Corner.msg", "float64 x\nfloat64 y\n"),
        ("msg/Seen.msg", MESSAGE),
        ("srv/Look.srv", "uint8 HERE=1\nuint8 where\n---\nSeen seen\nbool ok\n"),
        ("action/Find.action", "int32 id\n---\nSeen seen\n---\nuint8 percent\n"),
    ):
        (detector / name).parent.mkdir(exist_ok=True)
        (detector / name).write_text(text)
    return tmp_path


def test_the_packages_of_a_workspace_are_those_beside_the_program(workspace: Path) -> None:
    program = workspace / "src/meta/pilot/scripts/fly.py"
    assert packages_of(program) == {
        "detector": workspace / "src/detector",
        "pilot": workspace / "src/meta/pilot",
    }
    assert packages_in(workspace).keys() == {"detector", "pilot", "other"}
    assert packages_of(workspace / "fly.py") == {}  # lies in no package: nothing is searched


def test_types_of_a_package_become_classes(
    workspace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rospy_stand_in.genpy.SERVICES", services := dict(SERVICES))
    monkeypatch.setattr("rospy_stand_in.packages.SERVICES", services)
    before = dict(MESSAGES)
    try:
        monkeypatch.setattr("rospy_stand_in.packages.MESSAGES", MESSAGES)
        monkeypatch.setattr("rospy_stand_in.genpy.MESSAGES", MESSAGES)
        read_types({"detector": workspace / "src/detector"})
        kind = message_class("detector/Seen")
        assert {name: getattr(kind, name) for name in ("NONE", "TAG", "LIMIT", "ON")} == {
            "NONE": 0,
            "TAG": 16,
            "LIMIT": 0.5,
            "ON": 1,
        }
        assert kind._slot_types == [
            *("std_msgs/Header", "detector/Corner[4]", "detector/Corner"),
            *("geometry_msgs/Pose[]", "int32"),
        ]
        seen = kind(id=5)
        assert [corner.x for corner in seen.corners] == [0.0] * 4  # type: ignore[attr-defined]
        look = service_class("detector/Look")
        assert look._request_class(1).where == look._request_class.HERE  # type: ignore[attr-defined]
        assert look._response_class().seen.id == 0  # type: ignore[attr-defined]
        assert message_class("detector/FindActionGoal")._slot_types[-1] == "detector/FindGoal"
    finally:
        MESSAGES.clear()
        MESSAGES.update(before)


def test_a_definition_that_is_none_is_named(workspace: Path) -> None:
    (workspace / "src/detector/srv/Bad.srv").write_text("int32 id\n")
    with pytest.raises(SyntaxError, match=r"Bad\.srv has 1 parts"):
        read_types({"detector": workspace / "src/detector"})


def test_modules_of_others_are_left_alone(tmp_path: Path) -> None:
    finder = Finder({}, tmp_path, is_old=False)
    for name in ("json", "numpy", "none_such", "std_msgs.none", "Queue"):
        assert finder.find_spec(name) is None
    for name in ("rospy", "std_msgs", "std_msgs.msg", "dji_sdk.srv", "dji_sdk.dji_drone", "tf"):
        assert finder.find_spec(name) is not None
    assert Finder({}, tmp_path, is_old=True).find_spec("Queue") is not None
