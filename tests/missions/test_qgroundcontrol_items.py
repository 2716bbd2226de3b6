"""Files of QGroundControl taken apart, and files that are none."""

from __future__ import annotations

import json
from typing import Any

import pytest

from m100link import BadPlan, WaypointPlan
from m100link.missions.qgroundcontrol import MavCommand
from tests.missions.qgroundcontrol import file, item, survey, waypoint

ITEMS = waypoint(0), waypoint(50)


def refusal(document: dict[str, Any], **options: Any) -> BadPlan:
    with pytest.raises(BadPlan) as caught:
        WaypointPlan.from_qgroundcontrol(json.dumps(document), **options)
    return caught.value


def test_commands_have_the_names_of_mavlink() -> None:
    common = pytest.importorskip("pymavlink.dialects.v20.common")
    for name, command in MavCommand.__members__.items():  # one of a wrong number may be an alias
        assert command == getattr(common, f"MAV_CMD_{name}")


@pytest.mark.parametrize(
    "name",
    [
        "survey",
        "CorridorScan",
        "StructureScan",
        "fwLandingPattern",
        "vtolLandingPattern",
        "SpinScan",
    ],
)
@pytest.mark.parametrize("laid_out", [None, {}, {"Items": None}, {"Items": [{"type": "Other"}]}])
def test_complex_items_that_were_not_laid_out_are_refused_by_name(
    name: str, laid_out: dict[str, Any] | None
) -> None:
    entry = {"type": "ComplexItem", "complexItemType": name, "version": 1}
    if laid_out is not None:
        entry["TransectStyleComplexItem"] = laid_out
    found = file(waypoint(0), entry, waypoint(50))
    error = refusal(found)
    assert error.field == "item 2"
    assert f"item 2 is a {name!r} without items of its own" in error.seen
    assert error.remedy
    read = WaypointPlan.from_qgroundcontrol(json.dumps(found), leave_out=[name])
    assert len(read.waypoints) == 2  # only a caller that names it goes without it


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"fileType": "Fence"}, "fileType is 'Fence'"),
        ({"version": 2}, "version 2 of a .plan"),
        ({"version": True}, "version True of a .plan"),
        ({"mission": None}, "the file has no mission"),
        ({"mission": []}, "mission is of another kind"),
        ({"mission": {"version": 1, "items": []}}, "version 1 of a mission"),
        ({"mission": {"version": 2}}, "the mission has no items"),
    ],
)
def test_a_file_of_another_kind_says_so(change: dict[str, Any], words: str) -> None:
    assert words in refusal(file(*ITEMS) | change).seen


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        (None, "item 3 is not an object"),
        ({}, "item 3 is of type None"),
        ({"type": "SimpleItem"}, "item 3 has no command"),
        (item(16) | {"command": "16"}, "command is of another kind"),
        (item(16) | {"params": [1, 2]}, "item 3: params are not 7 numbers"),
        (item(16) | {"params": "1234567"}, "params is of another kind"),
        (item(16) | {"params": ["a"] * 7}, "item 3: params are not 7 numbers"),
        (item(16) | {"params": [float("inf")] * 7}, "item 3: params are not 7 numbers"),
        (item(16) | {"frame": None}, "item 3 has no frame"),
        (item(16) | {"autoContinue": False}, "the mission would wait there"),
        (survey(kind="StructureScan") | {"TransectStyleComplexItem": 1}, "without items"),
        (survey(survey()), "without items"),
        ({"type": "ComplexItem"}, "without items"),
    ],
)
def test_an_item_that_is_none_is_named(entry: object, words: str) -> None:
    assert words in refusal(file(*ITEMS, entry)).seen


@pytest.mark.parametrize(
    "fence",
    [
        {"geoFence": {"circles": [{"radius": 5}], "polygons": [], "version": 2}},
        {"geoFence": {"circles": [], "polygons": [[0, 0]], "version": 2}},
        {"rallyPoints": {"points": [[1, 2, 3]], "version": 2}},
    ],
)
def test_a_fence_is_not_forgotten(fence: dict[str, Any]) -> None:
    [name] = fence
    error = refusal(file(*ITEMS) | fence)
    assert error.field == name
    text = json.dumps(file(*ITEMS) | fence)
    assert WaypointPlan.from_qgroundcontrol(text, leave_out=[name])


@pytest.mark.parametrize("speed", [0, -1, None, "fast"])
def test_a_speed_that_is_none_is_refused(speed: object) -> None:
    document = file(*ITEMS)
    document["mission"]["hoverSpeed"] = speed
    assert "hoverSpeed is" in refusal(document).seen


def test_a_file_without_a_speed_has_the_usual_one() -> None:
    document = file(*ITEMS)
    del document["mission"]["hoverSpeed"]
    assert WaypointPlan.from_qgroundcontrol(json.dumps(document)).speed == 5
