"""Plans written for QGroundControl."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from hypothesis import given

from m100link import (
    AtEnd,
    BadPlan,
    GimbalPitch,
    Heading,
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
from tests.missions.qgroundcontrol import file, survey, waypoint
from tests.missions.qgroundcontrol_rules import faults_of


@given(plans())
def test_what_was_written_is_read(plan: WaypointPlan) -> None:
    assert WaypointPlan.from_qgroundcontrol(plan.to_qgroundcontrol()) == plan


@given(plans())
def test_every_file_is_as_qgroundcontrol_wants_it(plan: WaypointPlan) -> None:
    assert faults_of(plan.to_qgroundcontrol()) == []


def changed_at(path: tuple[str | int, ...], value: object) -> str:
    """The file of the plan below with one thing changed, or taken out."""
    part = document = json.loads(PLAN.to_qgroundcontrol())
    for step in path[:-1]:
        part = part[step]
    if value is None:
        del part[path[-1]]
    else:
        part[path[-1]] = value
    return json.dumps(document)


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (("fileType",), "Mission", "fileType"),
        (("version",), 2, "file has version 2"),
        (("geoFence",), None, "no geoFence"),
        (("rallyPoints", "points"), None, "no points"),
        (("geoFence", "version"), 1, "geoFence has version 1"),
        (("mission", "version"), 3, "mission has version 3"),
        (("mission", "firmwareType"), None, "no firmwareType"),
        (("mission", "plannedHomePosition"), [47.0, 8.0], "plannedHomePosition"),
        (("mission", "cruiseSpeed"), "5", "cruiseSpeed"),
        (("mission", "items", 1, "type"), "Simple", "type Simple"),
        (("mission", "items", 1, "autoContinue"), 1, "autoContinue"),
        (("mission", "items", 1, "params"), [0] * 6, "seven"),
        (("mission", "items", 1, "AltitudeMode"), None, "no AltitudeMode"),
        (("mission", "items", 1, "frame"), 99, "frame 99"),
        (("mission", "items", 1, "doJumpId"), 1, "stands twice"),
    ],
)
def test_the_rules_see_what_is_wrong(
    path: tuple[str | int, ...], value: object, words: str
) -> None:
    assert words in " ".join(faults_of(changed_at(path, value)))


def test_files_that_it_writes_itself_keep_the_rules() -> None:
    second = waypoint(50) | {"doJumpId": 2}
    assert faults_of(json.dumps(file(waypoint(0), second))) == []
    assert faults_of(json.dumps(file(waypoint(0), survey(second)))) != []  # we write simple ones


def same_way(action: WaypointAction) -> WaypointAction:
    """To the south is 180 and -180."""
    return TurnTo(180) if action == TurnTo(-180) else action


@given(plans())
def test_the_items_alone_are_the_nearest_that_mavlink_has(plan: WaypointPlan) -> None:
    document = json.loads(plan.to_qgroundcontrol())
    del document["m100link"]
    read = WaypointPlan.from_qgroundcontrol(json.dumps(document))
    by_waypoint = plan.heading is Heading.BY_WAYPOINT
    assert read.heading is (Heading.BY_WAYPOINT if by_waypoint else Heading.ALONG_PATH)
    assert read.at_end is (
        plan.at_end if plan.at_end in (AtEnd.GO_HOME, AtEnd.LAND) else AtEnd.HOVER
    )
    for found, wanted in zip(read.waypoints, plan.waypoints, strict=True):
        assert (found.latitude_deg, found.longitude_deg, found.height) == (
            wanted.latitude_deg,
            wanted.longitude_deg,
            wanted.height,
        )
        assert list(map(same_way, found.actions)) == list(map(same_way, wanted.actions))
    if plan.speed > 0:
        assert read.speed == plan.speed


PLAN = WaypointPlan(
    [Waypoint(47.3977, 8.5456, 30.0), Waypoint(47.399, 8.5456, 35.0, damping=3)],
    trace=Trace.COORDINATED_TURNS,
)


@pytest.mark.parametrize("heading", [Heading.BY_WAYPOINT, Heading.ALONG_PATH])
@pytest.mark.parametrize("at_end", [AtEnd.LAND, AtEnd.GO_HOME, AtEnd.HOVER])
def test_each_item_is_the_command_of_mavlink_with_its_parameters(
    heading: Heading, at_end: AtEnd
) -> None:
    """common.xml: metres above home (frame 3), degrees, seconds; an item without a place has
    frame 2, and a yaw that is not given is null."""
    actions = [Stay(2.5), TakePhoto(), StartVideo(), StopVideo(), TurnTo(-90), GimbalPitch(-60)]
    points = [
        Waypoint(47.25, -8.5, 30.0, heading_deg=-45, actions=actions, turn_clockwise=False),
        Waypoint(47.252, -8.501, 35.5, heading_deg=170, actions=[TurnTo(45)]),
    ]
    plan = WaypointPlan(points, speed=4.5, heading=heading, at_end=at_end)
    document = json.loads(plan.to_qgroundcontrol())
    yaws = (-45, 170) if heading is Heading.BY_WAYPOINT else (None, None)
    ends: dict[AtEnd, list[tuple[int, int, list[float | None]]]] = {
        AtEnd.LAND: [(21, 3, [0, 0, 0, None, 47.252, -8.501, 0])],
        AtEnd.GO_HOME: [(20, 2, [0] * 7)],
        AtEnd.HOVER: [],
    }
    items = document["mission"]["items"]
    assert [(item["command"], item["frame"], item["params"]) for item in items] == [
        (178, 2, [1, 4.5, -1, 0, 0, 0, 0]),  # DO_CHANGE_SPEED: of the ground, m/s, no throttle
        (16, 3, [0, 0, 0, yaws[0], 47.25, -8.5, 30.0]),
        (93, 2, [2.5, -1, -1, -1, 0, 0, 0]),  # NAV_DELAY: seconds, no time of the day
        (2000, 2, [0, 0, 1, 0, 0, 0, 0]),  # IMAGE_START_CAPTURE: one
        (2500, 2, [0] * 7),
        (2501, 2, [0] * 7),
        (115, 2, [270, 0, -1, 0, 0, 0, 0]),  # CONDITION_YAW: 0 to 360°, -1 is anticlockwise
        (205, 2, [-60, 0, 0, 0, 0, 0, 2]),  # DO_MOUNT_CONTROL: pitch, mode of angles
        (16, 3, [0, 0, 0, yaws[1], 47.252, -8.501, 35.5]),
        (115, 2, [45, 0, 1, 0, 0, 0, 0]),
        *ends[at_end],
    ]
    assert [item["doJumpId"] for item in items] == list(range(1, len(items) + 1))
    assert {item["autoContinue"] for item in items} == {True}
    placed = [item for item in items if item["frame"] == 3]
    assert [(item["Altitude"], item["AltitudeMode"]) for item in placed[:2]] == [(30, 1), (35.5, 1)]
    mission = document["mission"]
    assert (mission["firmwareType"], mission["vehicleType"]) == (12, 2)  # PX4, a quadrotor
    assert (mission["cruiseSpeed"], mission["hoverSpeed"]) == (4.5, 4.5)
    assert mission["plannedHomePosition"] == [47.25, -8.5, 0]


@pytest.mark.parametrize(("speed", "written"), [(0, 1), (-3, 1), (0.5, 1), (1.5, 1.5)])
def test_what_only_the_stick_moves_has_no_speed_of_its_own(speed: float, written: float) -> None:
    document = json.loads(replace(PLAN, speed=speed).to_qgroundcontrol())
    assert document["mission"]["cruiseSpeed"] == document["mission"]["hoverSpeed"] == written
    commands = [item["command"] for item in document["mission"]["items"]]
    assert commands == ([178] if speed > 0 else []) + [16, 16]


def test_a_file_that_was_changed_is_read_by_its_items() -> None:
    document = json.loads(PLAN.to_qgroundcontrol())
    assert document["fileType"] == "Plan"
    document["mission"]["items"][1]["params"][6] = 50
    changed = WaypointPlan.from_qgroundcontrol(json.dumps(document))
    assert changed.waypoints[0].height == 50
    assert changed.trace is Trace.STOP_AT_POINTS
    document = json.loads(PLAN.to_qgroundcontrol())
    document["m100link"]["waypoints"][0]["height"] = 50
    assert WaypointPlan.from_qgroundcontrol(json.dumps(document)).waypoints[0].height == 30


def test_a_plan_beside_the_items_that_is_none_is_refused() -> None:
    document = json.loads(PLAN.to_qgroundcontrol())
    document["m100link"]["speeed"] = 5
    with pytest.raises(BadPlan, match="there is no field"):
        WaypointPlan.from_qgroundcontrol(json.dumps(document))
    document = json.loads(PLAN.to_qgroundcontrol())
    document["rallyPoints"]["points"] = [[1, 2, 3]]
    with pytest.raises(BadPlan, match="rallyPoints"):
        WaypointPlan.from_qgroundcontrol(json.dumps(document))


def test_landing_and_home_are_the_last_items() -> None:
    for at_end, command in ((AtEnd.LAND, 21), (AtEnd.GO_HOME, 20), (AtEnd.HOVER, 16)):
        items = json.loads(replace(PLAN, at_end=at_end).to_qgroundcontrol())["mission"]["items"]
        assert items[-1]["command"] == command
        assert [one["doJumpId"] for one in items] == list(range(1, len(items) + 1))
