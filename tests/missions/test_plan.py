"""A plan as a value: what it tells of itself."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import pytest

from m100link import BadPlan, Waypoint, WaypointPlan
from tests.missions.qgroundcontrol import HOME, file, item, waypoint

PLAN = WaypointPlan(
    [Waypoint(52.1, 4.31, 20.0), Waypoint(52.1009, 4.31, 45.0), Waypoint(52.1009, 4.32, -5.0)]
)


def test_a_plan_is_a_value() -> None:
    assert pickle.loads(pickle.dumps(PLAN)) == PLAN
    assert hash(WaypointPlan(list(PLAN.waypoints))) == hash(PLAN)
    with pytest.raises(AttributeError):
        PLAN.speed = 3.0  # type: ignore[misc]


def test_how_long_high_and_far_it_is() -> None:
    assert PLAN.length_m == pytest.approx(103.23 + 686.9, abs=0.5)
    assert PLAN.heights == (-5.0, 45.0)
    assert PLAN.farthest_m(52.1, 4.31) == pytest.approx(692.3, abs=0.5)


ABSOLUTE = item(16, 0, 0, 0, None, HOME[0] + 0.001, HOME[1], 520.0, frame=0)
CAMERA = item(530, 0, 2)  # sets a mode of the camera: nothing that the M100 does


@pytest.mark.parametrize("how", ["from_qgroundcontrol", "parse", "read"])
@pytest.mark.parametrize(
    ("options", "is_read"),
    [
        ({"home_altitude": 500.0, "leave_out": [530]}, True),
        ({"home_altitude": 500.0}, False),
        ({"leave_out": [530]}, False),
    ],
)
def test_a_file_of_qgroundcontrol_is_read_with_its_options(
    tmp_path: Path, how: str, options: dict[str, Any], is_read: bool
) -> None:
    text = json.dumps(file(waypoint(0), CAMERA, ABSOLUTE))
    path = tmp_path / "file"
    path.write_text(text)
    given: Any = path if how == "read" else text
    if not is_read:
        with pytest.raises(BadPlan):
            getattr(WaypointPlan, how)(given, **options)
        return
    plan = getattr(WaypointPlan, how)(given, **options)
    assert [point.height for point in plan.waypoints][1] == pytest.approx(20.0)


@pytest.mark.parametrize(("name", "is_for_qgroundcontrol"), [("a.plan", True), ("a.json", False)])
def test_a_file_is_written_for_whom_its_name_says(
    tmp_path: Path, name: str, is_for_qgroundcontrol: bool
) -> None:
    path = tmp_path / name
    PLAN.write(path)
    text = path.read_text(encoding="utf-8")
    assert ('"fileType": "Plan"' in text) is is_for_qgroundcontrol
    assert text == (PLAN.to_qgroundcontrol() if is_for_qgroundcontrol else PLAN.to_json())
    assert WaypointPlan.read(path) == WaypointPlan.parse(text) == PLAN
