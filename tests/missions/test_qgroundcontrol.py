"""What becomes of each mission item of QGroundControl, and which are refused."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

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
from m100link.geodesy import distance_m
from m100link.missions.waypoint import WaypointAction
from tests.missions.plans import plans
from tests.missions.qgroundcontrol import HOME, file, item, read, survey, waypoint
from tests.missions.qgroundcontrol_rules import faults_of

RETURN = item(20)
NORTH = waypoint(0), waypoint(50), waypoint(100)
TAKE_OFF = item(22, 15, 0, 0, None, HOME[0], HOME[1], 30, frame=3)


def refusal(*items: object, **options: Any) -> BadPlan:
    with pytest.raises(BadPlan) as caught:
        read(*items, **options)
    return caught.value


def actions(plan: WaypointPlan) -> list[list[object]]:
    return [list(point.actions) for point in plan.waypoints]


def test_a_mission_as_it_is_usually_drawn() -> None:
    plan = read(TAKE_OFF, waypoint(50), item(2000, 0, 0, 1), waypoint(100, hold=5), RETURN)
    assert [round(point.height, 1) for point in plan.waypoints] == [30, 30, 30]
    assert plan.waypoints[0].latitude_deg == HOME[0]
    assert (plan.take_off, read(*NORTH).take_off) == (True, False)
    assert actions(plan) == [[], [TakePhoto()], [Stay(5)]]
    assert (plan.at_end, plan.heading, plan.speed) == (AtEnd.GO_HOME, Heading.ALONG_PATH, 5.0)
    assert plan.trace is Trace.STOP_AT_POINTS


def test_a_take_off_to_the_first_waypoint_is_that_waypoint() -> None:
    plan = read(TAKE_OFF, item(205, -90, 0, 0, 0, 0, 0, 2), *NORTH)
    assert len(plan.waypoints) == 3
    assert actions(plan)[0] == [GimbalPitch(-90)]
    lower = item(22, 0, 0, 0, None, HOME[0], HOME[1], 10, frame=3)
    assert [point.height for point in read(lower, *NORTH).waypoints] == [10, 30, 30, 30]


@pytest.mark.parametrize("place", [(0, 0), (None, None)])
def test_a_take_off_without_a_place_is_at_home(place: tuple[float | None, float | None]) -> None:
    plan = read(item(22, 0, 0, 0, None, *place, 10, frame=3), *NORTH)
    first = plan.waypoints[0]
    assert [first.latitude_deg, first.longitude_deg, first.height] == [*HOME[:2], 10]


@pytest.mark.parametrize(
    ("found", "wanted"),
    [
        (item(93, 2.5, -1, -1, -1), Stay(2.5)),
        (item(112, 4), Stay(4)),
        (item(115, 270, 0, 1), TurnTo(-90)),
        (item(203, 1, 0, 0, 0, 1), TakePhoto()),
        (item(2000, 0, 0, 1), TakePhoto()),
        (item(2500), StartVideo()),
        (item(2501), StopVideo()),
        (item(205, -45.2, 0, 0, 0, 0, 0, 2), GimbalPitch(-45)),
        (item(1000, -60, None, None, None, 0, 0, 0), GimbalPitch(-60)),
    ],
)
def test_an_item_is_an_action_at_the_waypoint_before_it(found: object, wanted: object) -> None:
    assert actions(read(waypoint(0), found, waypoint(50))) == [[wanted], []]


def test_what_comes_before_the_first_waypoint_is_done_there() -> None:
    assert actions(read(item(2500), waypoint(0), waypoint(50)))[0] == [StartVideo()]


@pytest.mark.parametrize(("direction", "clockwise"), [(1, True), (-1, False), (0, True)])
def test_turns_have_the_direction_of_their_item(direction: int, clockwise: bool) -> None:
    plan = read(waypoint(0), item(115, 90, 0, direction), waypoint(50))
    assert plan.waypoints[0].turn_clockwise is clockwise
    assert plan.waypoints[1].turn_clockwise


def test_headings_of_all_waypoints_are_those_of_the_plan() -> None:
    plan = read(TAKE_OFF, waypoint(50, yaw=350), waypoint(100, yaw=90), item(21, 0, 0, 0, 0, 0, 0))
    assert plan.heading is Heading.BY_WAYPOINT
    assert [point.heading_deg for point in plan.waypoints] == [-10, -10, 90]


def test_headings_of_some_waypoints_turn_the_nose_there() -> None:
    plan = read(waypoint(0), waypoint(50, yaw=350, hold=1), waypoint(100))
    assert plan.heading is Heading.ALONG_PATH
    assert actions(plan) == [[], [TurnTo(-10), Stay(1)], []]


def test_the_speed_of_the_whole() -> None:
    assert read(item(178, 1, 8, -1), *NORTH).speed == 8
    assert read(waypoint(0), item(178, 0, 12, 0), *NORTH[1:]).max_speed == 12
    assert read(waypoint(0), item(178, 1, 3), waypoint(50), item(178, 1, 3), NORTH[2]).speed == 3
    error = refusal(*NORTH[:2], item(178, 1, 8, -1), NORTH[2])
    assert error.seen.startswith("item 3, DO_CHANGE_SPEED (178): the speed changes on the way")


def test_landing_elsewhere_flies_there_first() -> None:
    there = item(21, 0, 0, 0, None, HOME[0] - 0.001, HOME[1], 0, frame=3)
    plan = read(*NORTH, there)
    assert plan.at_end is AtEnd.LAND
    assert (len(plan.waypoints), plan.waypoints[-1].height) == (4, 30)
    assert read(waypoint(0), waypoint(50, 40), waypoint(100, 35), there).waypoints[-1].height == 35
    here = item(21, 0, 0, 0, None, HOME[0], HOME[1], 0, frame=3)
    assert len(read(NORTH[1], NORTH[0], here).waypoints) == 2


def test_a_survey_is_its_own_items() -> None:
    plan = read(waypoint(-50), survey(*NORTH, kind="CorridorScan"), RETURN)
    assert len(plan.waypoints) == 4
    error = refusal(NORTH[0], survey(NORTH[1], item(206, 1)))
    assert error.field == "item 2.2"


def test_photographs_by_distance_are_waypoints_of_their_own() -> None:
    shoot = survey(waypoint(0), item(206, 20, 0, 1), *NORTH[1:], item(206, 0), waypoint(200))
    plan = read(shoot)
    first = plan.waypoints[0]
    places = [
        distance_m(first.latitude_deg, first.longitude_deg, p.latitude_deg, p.longitude_deg)
        for p in plan.waypoints
    ]
    assert [round(place) for place in places] == [0, 20, 40, 50, 60, 80, 100, 200]
    photos = [round(place) for place, done in zip(places, actions(plan), strict=True) if done]
    assert photos == [0, 20, 40, 60, 80, 100]


def test_a_photograph_next_to_a_waypoint_is_taken_there() -> None:
    plan = read(waypoint(0), item(206, 49), waypoint(50), waypoint(101))
    assert actions(plan) == [[], [TakePhoto()], [TakePhoto()], []]
    plan = read(waypoint(0), item(206, 53), waypoint(50), waypoint(101))  # 3 m behind it
    assert actions(plan) == [[], [], [TakePhoto()], []]


def test_a_photograph_on_a_climb_is_as_high_as_the_way_is_there() -> None:
    """50 m up over 100 m are 111.8 m; 20 m along them it is 8.94 m higher."""
    plan = read(waypoint(0, 30), item(206, 20), waypoint(100, 80))
    assert plan.waypoints[1].height == pytest.approx(38.94, abs=0.01)


def test_heights_count_from_home() -> None:
    high = waypoint(50, 520, frame=0)
    error = refusal(NORTH[0], high)
    assert "its height 520 counts from sea level" in error.seen
    assert read(NORTH[0], high, home_altitude=490).waypoints[1].height == 30
    assert "the terrain" in refusal(NORTH[0], waypoint(50, frame=10), home_altitude=490).seen
    assert "frame 1" in refusal(NORTH[0], waypoint(50, frame=1)).seen
    assert read(NORTH[0], waypoint(50, frame=6)).waypoints[1].height == 30


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (item(19, 30), "NAV_LOITER_TIME (19): the M100 cannot do that"),
        (item(530, 0, 2), "SET_CAMERA_MODE (530): the M100 cannot do that"),
        (item(31999), "command 31999: the M100 cannot do that"),
        (item(16, 0, 0, 0, None, None, 8.5, 30, frame=3), "it has no place"),
        (item(16, 0, 0, 0, None, 47.3, None, 30, frame=3), "it has no place"),
        (item(16, 0, 0, 0, None, 47.3, 8.5, None, frame=3), "it has no height"),
        (item(16, 0, 0, 9, None, 47.3, 8.5, 30, frame=3), "pass_radius 9 is not possible"),
        (TAKE_OFF, "it comes behind a waypoint"),
        (item(93, -1, 12, 0, 0), "it waits for a time of day"),
        (item(115, 90, 0, 1, 1), "relative 1 is not possible"),
        (item(115, None), "it has no angle"),
        (item(178, 2, 3), "one speed along the way"),
        (item(178, 1, 0), "one speed along the way"),
        (item(178, 1, 5, 50), "one speed along the way"),
        (item(203, 0, 2, 0, 0, 1), "zoom 2 is not possible"),
        (item(203), "it takes no photograph"),
        (item(2000, 0, 2, 0), "photographs by time"),
        (item(205, -45, 0, 30, 0, 0, 0, 2), "yaw 30 is not possible"),
        (item(205, -45, 0, 0, 0, 0, 0, 4), "mode 4 of the mount"),
        (item(1000, None), "it has no pitch"),
        (item(1000, -9, 5), "yaw 5 is not possible"),
        (item(1000, -9, 0, 5), "pitch_rate 5 is not possible"),
        (item(206, 1), "and the M100 stops at each"),
        (item(206, -1), "photographs -1 m apart"),
        (item(206, None), "photographs nan m apart"),
        (item(2001), "IMAGE_STOP_CAPTURE (2001)"),
    ],
)
def test_what_cannot_be_flown_is_refused_by_name_and_number(found: object, words: str) -> None:
    error = refusal(waypoint(0), found, waypoint(50))
    assert error.seen.startswith("item 2, ")
    assert words in error.seen
    assert error.field == "item 2"


def test_two_directions_at_one_waypoint_are_not_possible() -> None:
    error = refusal(waypoint(0), item(115, 90, 0, 1), item(115, 0, 0, -1), waypoint(50))
    assert "turns in one direction" in error.seen
    assert "before the first waypoint" in refusal(item(115, 9), *NORTH).seen


@pytest.mark.parametrize("behind", [waypoint(90), item(2000, 0, 0, 1), RETURN])
def test_nothing_comes_behind_the_end(behind: object) -> None:
    assert "after the item that ends" in refusal(*NORTH[:2], RETURN, behind).seen


def test_what_is_named_is_left_out() -> None:
    scan = survey(kind="StructureScan") | {"TransectStyleComplexItem": None}
    parts = item(530, 0, 2), waypoint(0), item(206, 5), scan, waypoint(50)
    assert len(read(*parts, leave_out=[530, 206, "StructureScan"]).waypoints) == 2
    assert refusal(*parts, leave_out=[530, 206]).field == "item 4"


def test_too_many_photographs_are_counted_not_made() -> None:
    far = item(16, 0, 0, 0, None, HOME[0] + 40, HOME[1], 30, frame=3)
    assert "photographs on one leg" in refusal(waypoint(0), item(206, 2), far).seen


def test_actions_without_a_waypoint() -> None:
    assert refusal(item(2000, 0, 0, 1)).seen == "the mission has no waypoint"
    assert "0 waypoints" in refusal().seen


# -- plans written for QGroundControl --------------------------------------------------------------


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
    assert read.take_off is plan.take_off
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
        Waypoint(47.254, -8.502, 40.0, heading_deg=10),
    ]
    plan = WaypointPlan(points, speed=4.5, heading=heading, at_end=at_end)
    document = json.loads(plan.to_qgroundcontrol())
    yaws = (-45, 170, 10) if heading is Heading.BY_WAYPOINT else (None, None, None)
    ends: dict[AtEnd, list[tuple[int, int, list[float | None]]]] = {
        AtEnd.LAND: [(21, 3, [0, 0, 0, None, 47.254, -8.502, 0])],
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
        (16, 3, [0, 0, 0, yaws[2], 47.254, -8.502, 40.0]),
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
