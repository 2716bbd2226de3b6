"""What becomes of each mission item of QGroundControl, and which are refused."""

from __future__ import annotations

from typing import Any

import pytest

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
    WaypointPlan,
)
from m100link.geodesy import distance_m
from tests.missions.qgroundcontrol import HOME, item, read, survey, waypoint

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
