"""Plans as JSON of our own: what was written is read, and what is not understood is refused."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given

from m100link import (
    AtEnd,
    BadPlan,
    GimbalPitch,
    Heading,
    OnRCLoss,
    StartVideo,
    Stay,
    StopVideo,
    TakePhoto,
    Trace,
    TurnTo,
    Waypoint,
    WaypointPlan,
)
from m100link.missions.waypoint import WaypointAction
from tests.missions.plans import plans

ACTIONS: list[WaypointAction] = [
    Stay(2.5),
    TakePhoto(),
    StartVideo(),
    StopVideo(),
    TurnTo(90),
    GimbalPitch(-60),
]
PLAN = WaypointPlan(
    [Waypoint(52.1, 4.31, 20.0), Waypoint(52.1003, 4.31, 25.5, heading_deg=90, actions=ACTIONS)],
    speed=4.5,
    heading=Heading.BY_WAYPOINT,
    at_end=AtEnd.GO_HOME,
)
TEXT = """\
{
  "format": "m100link waypoint plan",
  "version": 1,
  "speed": 4.5,
  "max_speed": 10.0,
  "heading": "by_waypoint",
  "trace": "stop_at_points",
  "at_end": "go_home",
  "on_rc_loss": "failsafe",
  "gimbal_by_waypoint": false,
  "repeat": 1,
  "take_off": false,
  "waypoints": [
    {"latitude_deg": 52.1, "longitude_deg": 4.31, "height": 20.0},
    {"latitude_deg": 52.1003, "longitude_deg": 4.31, "height": 25.5, "heading_deg": 90, \
"actions": [{"stay": 2.5}, "take_photo", "start_video", "stop_video", {"turn_to": 90}, \
{"gimbal_pitch": -60}]}
  ]
}
"""


def test_a_plan_is_written_so_that_people_and_diffs_can_read_it() -> None:
    assert PLAN.to_json() == TEXT
    assert WaypointPlan.from_json(TEXT) == PLAN
    assert WaypointPlan.from_json(b"\xef\xbb\xbf" + TEXT.encode()) == PLAN  # as Notepad writes it


@given(plans())
def test_what_was_written_is_read(plan: WaypointPlan) -> None:
    assert WaypointPlan.from_json(plan.to_json()) == plan


def changed(**values: Any) -> str:
    """The text with other fields; None takes one away."""
    document = json.loads(TEXT) | values
    return json.dumps({name: value for name, value in document.items() if value is not None})


def point(**values: Any) -> str:
    """The text whose second waypoint has other fields."""
    first, second = json.loads(TEXT)["waypoints"]
    second = {name: value for name, value in (second | values).items() if value is not None}
    return changed(waypoints=[first, second])


def refusal(text: str | bytes) -> BadPlan:
    with pytest.raises(BadPlan) as caught:
        WaypointPlan.from_json(text)
    return caught.value


def test_what_may_be_left_out_has_its_default() -> None:
    plan = WaypointPlan.from_json(
        changed(speed=None, heading=None, at_end=None, on_rc_loss=None, repeat=None)
    )
    assert (plan.speed, plan.at_end, plan.on_rc_loss) == (5.0, AtEnd.HOVER, OnRCLoss.FAILSAFE)


@pytest.mark.parametrize(
    ("text", "field", "words"),
    [
        ("", "", "is not JSON"),
        ("[1, 2", "", "is not JSON"),
        ("[]", "", "a list and not an object"),
        ("null", "", "null and not an object"),
        ("[" * 100_000, "", "nested too deeply|not JSON"),
        (b"\xff\xfe\x00", "", "byte 0 is not UTF-8"),
        ('{"speed": ' + "9" * 5000 + "}", "", "not JSON"),
        ("{}", "format", "the format is null"),
        (changed(format="QGC"), "format", '"QGC"'),
        (changed(version=2), "version", "version 2 of the format is not known"),
        (changed(version=None), "version", "version null"),
        (changed(version=True), "version", "version true"),
        (changed(sped=3), "sped", 'there is no field "sped"'),
        (TEXT.replace('"speed"', '"repeat"'), "repeat", '"repeat" stands twice'),
        (changed(at_end="hver"), "at_end", 'at_end is "hver"'),
        (changed(heading=3), "heading", "heading is 3"),
        (changed(waypoints=None), "waypoints", "waypoints is missing"),
        (changed(waypoints={}), "waypoints", "waypoints is an object"),
        (changed(waypoints=[[52.1, 4.3, 20]] * 2), "waypoints", "waypoint 0 is a list"),
        (point(latitude_deg=None), "latitude_deg", "waypoint 1: latitude_deg is missing"),
        (point(altitude=5), "altitude", 'waypoint 1: there is no field "altitude"'),
        (point(actions={}), "actions", "waypoint 1: actions is an object"),
        (point(actions=["photo"]), "actions[0]", 'actions[0] is "photo"'),
        (point(actions=["stay"]), "actions[0]", 'actions[0] is "stay"'),
        (point(actions=[{"stay": 1, "turn_to": 2}]), "actions[0]", "actions[0] is"),
        (point(actions=[{"take_photo": 1}]), "actions[0]", "actions[0] is"),
        (point(actions=[{"stay": "1"}]), "actions[0].seconds", "not a finite number"),
        (point(height="20"), "height", "waypoint 1: height is '20', not a finite number"),
        (point(height=float("nan")), "height", "waypoint 1: height is nan"),
        (point(_=1), "_", 'there is no field "_"'),
        (changed(speed=[1]), "speed", "not a finite number"),
        (changed(repeat=1.5), "repeat", "not a whole number"),
        (changed(gimbal_by_waypoint=1), "gimbal_by_waypoint", "gimbal_by_waypoint is 1"),
        (changed(take_off="no"), "take_off", "take_off is 'no'"),
    ],
)
def test_what_is_not_understood_is_refused_by_its_name(
    text: str | bytes, field: str, words: str
) -> None:
    error = refusal(text)
    assert error.field == field
    assert any(word in error.seen for word in words.split("|")), error.seen
    if words.startswith("waypoint "):
        assert error.point == int(words.split()[1].rstrip(":"))


# -- plans in files: which kind they are, and what cannot be read or written -----------------------


SMALL = WaypointPlan(
    [Waypoint(52.1, 4.31, 20.0), Waypoint(52.101, 4.31, 20.0, damping=2)],
    trace=Trace.COORDINATED_TURNS,
)


@pytest.mark.parametrize("name", ["a.json", "a.plan", "A.PLAN", "a"])
def test_a_file_is_written_by_its_name_and_read_by_what_it_is(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    SMALL.write(path)
    is_for_qgroundcontrol = '"fileType": "Plan"' in path.read_text(encoding="utf-8")
    assert is_for_qgroundcontrol == name.lower().endswith(".plan")
    renamed = path.rename(tmp_path / "other.txt")
    assert WaypointPlan.read(renamed) == WaypointPlan.read(str(renamed)) == SMALL


def test_what_cannot_be_read_or_written_says_why(tmp_path: Path) -> None:
    with pytest.raises(BadPlan, match=r"missing\.json' cannot be read: No such file"):
        WaypointPlan.read(tmp_path / "missing.json")
    with pytest.raises(BadPlan, match="cannot be read: Is a directory"):
        WaypointPlan.read(tmp_path)
    with pytest.raises(BadPlan, match=r"cannot be read: .*embedded null"):
        WaypointPlan.read("a\0b")
    with pytest.raises(BadPlan, match="cannot be written: Is a directory"):
        SMALL.write(tmp_path)


def test_what_is_far_too_large_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "large"
    with path.open("wb") as file:
        file.truncate(17 * 1024 * 1024)
    with pytest.raises(BadPlan, match="too large for a plan"):
        WaypointPlan.read(path)


def test_a_port_is_not_waited_for() -> None:
    ours, port = os.openpty()
    try:
        for device in (os.ttyname(port), "/dev/zero"):
            with pytest.raises(BadPlan, match="is a device, not a file"):
                WaypointPlan.read(device)
    finally:
        os.close(ours)
        os.close(port)


@pytest.mark.parametrize("text", ["", "{}", "[]", "null", '{"fileType": "plan"}', b"\xff"])
def test_what_is_neither_is_no_plan(text: str | bytes) -> None:
    with pytest.raises(BadPlan):
        WaypointPlan.parse(text)
