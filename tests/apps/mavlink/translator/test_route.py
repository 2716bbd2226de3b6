"""Items of a mission: what each means for the flight, by common.xml; and legs as a plan."""

from __future__ import annotations

import math
from typing import Any

import pytest

from m100link.apps.agent.orders import FlyAround, FlyTo
from m100link.apps.mavlink.translator.codec import MavlinkMessage
from m100link.apps.mavlink.translator.numbers import MissionResult
from m100link.apps.mavlink.translator.route import (
    Refused,
    Route,
    RoutePoint,
    Unfit,
    flies_missions,
    plan_of,
    read_route,
)
from m100link.apps.mavlink.translator.vehicle_state import Mode
from m100link.missions.plan import AtEnd, Heading

GLOBAL, MISSION, RELATIVE, GLOBAL_INT, RELATIVE_INT, TERRAIN = 0, 2, 3, 5, 6, 10
GROUND = 432.5
X, Y = -331_234_567, 1_512_345_678


def item(command: int, **given: Any) -> MavlinkMessage:
    fields: dict[str, Any] = {"command": command, "frame": RELATIVE_INT, "x": X, "y": Y, "z": 21.5}
    fields |= {"param1": 0.0, "param2": 0.0, "param3": 0.0, "param4": math.nan} | given
    return MavlinkMessage("MISSION_ITEM_INT", fields)


def read(*items: MavlinkMessage, ground: float | None = GROUND) -> Route:
    return read_route(items, ground=ground, speed=3.5)


def leg(
    height: float = 21.5, speed: float = 3.5, yaw: float | None = None, **more: Any
) -> RoutePoint:
    return RoutePoint(0, FlyTo(-33.1234567, 151.2345678, height, speed, yaw), **more)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, leg()),
        ({"frame": RELATIVE}, leg()),
        ({"frame": GLOBAL, "z": 450.0}, leg(17.5)),
        ({"frame": GLOBAL_INT, "z": 450.0}, leg(17.5)),
        ({"param1": 2.5}, leg(wait=2.5)),
        ({"param1": 600.0}, leg(wait=600.0)),
        ({"param1": math.nan}, leg()),
        ({"param4": 90.0}, leg(yaw=90.0)),
        ({"param4": 270.0}, leg(yaw=-90.0)),
        ({"param4": -45.0}, leg(yaw=-45.0)),
        ({"z": 0.0}, leg(0.0)),
    ],
)
@pytest.mark.parametrize("command", [16, 19])
def test_a_place_of_a_mission(command: int, given: dict[str, float], expected: RoutePoint) -> None:
    route = read(item(command, **given))
    assert route.legs == [expected]
    assert (route.height, route.then, route.left_out) == (None, Mode.HOLD, [])


@pytest.mark.parametrize(
    ("items", "result"),
    [
        ([item(16, frame=MISSION)], MissionResult.UNSUPPORTED_FRAME),
        ([item(16, frame=TERRAIN)], MissionResult.UNSUPPORTED_FRAME),
        ([item(16, z=-0.1)], MissionResult.INVALID),
        ([item(16, z=1000.0)], MissionResult.INVALID),
        ([item(16, z=math.nan)], MissionResult.INVALID),
        ([item(16, frame=GLOBAL, z=432.0)], MissionResult.INVALID),
        ([item(16, x=0, y=0)], MissionResult.INVALID),
        ([item(16, x=891_000_000)], MissionResult.INVALID),
        ([item(16, y=1_801_000_000)], MissionResult.INVALID),
        ([item(16, param1=-1.0)], MissionResult.INVALID),
        *(([item(16, **{f"param{n}": math.inf})], MissionResult.INVALID) for n in range(1, 5)),
        ([item(16, param1=601.0)], MissionResult.INVALID),
        ([item(16), item(22), item(16)], MissionResult.INVALID),
        ([item(16), item(16), item(22)], MissionResult.INVALID),
        ([item(20), item(16)], MissionResult.INVALID),
        ([item(16), item(17), item(16)], MissionResult.INVALID),
        ([item(16), item(21), item(16)], MissionResult.INVALID),
        ([item(93, param1=5.0)], MissionResult.INVALID),
        ([item(16), item(93, param1=0.0)], MissionResult.INVALID),
        ([item(178, param1=1.0, param2=10.5), item(16)], MissionResult.INVALID),
        ([item(178, param1=1.0, param2=0.09), item(16)], MissionResult.INVALID),
        ([item(22)], MissionResult.INVALID),
        ([item(2000)], MissionResult.INVALID),
        ([item(18, param1=1.0, param3=0.5)], MissionResult.INVALID),
        ([item(18, param1=0.0, param3=5.0)], MissionResult.INVALID),
        ([item(18, param1=1.0, param3=math.nan)], MissionResult.INVALID),
        ([item(18, param1=1.0, param3=5.0, x=0, y=0)], MissionResult.INVALID),
        ([item(115, param1=90.0, param4=0.0)], MissionResult.INVALID),
        ([item(16), item(115, param1=90.0, param4=1.0)], MissionResult.INVALID),
        ([item(16), item(115, param1=90.0)], MissionResult.INVALID),
    ],
)
def test_what_is_not_flown_as_it_is_said_refuses_the_mission(
    items: list[MavlinkMessage], result: MissionResult
) -> None:
    with pytest.raises(Refused) as caught:
        read(*items)
    assert caught.value.result is result


WITHOUT_EFFECT = {
    *(181, 182, 183, 184, 187, 189, 195, 196, 197, 200, 201, 202, 203, 204, 205, 206, 207, 211),
    *(214, 530, 531, 532, 1000, 1001, 2000, 2001, 2003, 2500, 2501),
}
"""Camera, gimbal, gripper, servos and marks, by MAV_CMD of MAVLink's common.xml."""

FLOWN = {16, 17, 18, 19, 20, 21, 22, 93, 115, 178}


def test_every_other_command_refuses_the_mission_and_is_named() -> None:
    """CONDITION_YAW, CONDITION_LOCATION and DO_SET_HOME were left out like a photograph."""
    commands = {*range(1000), *range(1000, 65536, 97), 2000, 2001, 2003, 2500, 2501, 3000} - FLOWN
    for command in WITHOUT_EFFECT:
        assert read(item(16), item(command)).left_out == [command]
    for command in commands - WITHOUT_EFFECT:
        with pytest.raises(Refused, match=rf"item 1, .*\b{command}\b") as caught:
            read(item(16), item(command))
        assert caught.value.result is MissionResult.UNSUPPORTED


def test_a_refusal_has_the_item_its_name_and_the_remedy() -> None:
    for items, why in (
        ([item(16), item(177)], "item 1, DO_JUMP (177): it cannot be flown: no loop is, write"),
        ([item(82)], "item 0, NAV_SPLINE_WAYPOINT (82): it cannot be flown: use NAV_WAYPOINT"),
        ([item(16), item(112)], "item 1, CONDITION_DELAY (112): it cannot be flown: take it out"),
        ([item(16, z=1000.5)], "item 0, NAV_WAYPOINT (16): 1000.5 m above the ground: 0 to 1000"),
        ([item(178, param1=1.0, param2=15.0)], "item 0, DO_CHANGE_SPEED (178): 15 m/s is not 0.1"),
    ):
        with pytest.raises(Refused) as caught:
            read(*items)
        assert caught.value.why.startswith(why)


def test_turns_around_a_place_are_a_circle_at_a_speed_that_is_gentle() -> None:
    there = item(18, param1=2.0, param3=-4.0)
    around = FlyAround(-33.1234567, 151.2345678, 21.5, 4.0, 2.0, 2.0, clockwise=False)
    assert read(there).legs == [RoutePoint(0, around)]
    small: Any = read(item(18, param1=2.0, param3=3.0)).legs[0].order
    assert small.speed == 1.5  # twice around its radius in a second
    here = item(18, param1=0.5, param3=100.0, x=0, y=0, z=0.0)
    around = FlyAround(-33.1234567, 151.2345678, 21.5, 100.0, 3.5, 0.5, clockwise=True)
    assert read(item(16), here).legs == [leg(), RoutePoint(1, around)]


@pytest.mark.parametrize("command", [17, 18, 19])
def test_a_loiter_without_a_place_stays_where_the_leg_before_ends(command: int) -> None:
    """MAVLink: 0, 0 is the present place; a waypoint has to name one."""
    there = {"x": 0, "y": 0, "param1": 2.0, "param3": 4.0}
    for z, height in ((0.0, 21.5), (30.0, 30.0)):
        found = read(item(16), item(command, z=z, **there)).legs[1].order
        place = (found.latitude_deg, found.longitude_deg, found.height)
        assert place == (-33.1234567, 151.2345678, height)
    for before in ([], [item(18, param1=1.0, param3=4.0)]):
        with pytest.raises(Refused, match="there is no place"):
            read(*before, item(command, **there))


def test_a_heading_of_its_own_is_a_turn_at_the_waypoint_before() -> None:
    turn = item(115, param1=270.0, param4=0.0)
    assert read(item(16), turn, item(16)).legs == [
        leg(),
        RoutePoint(1, leg(yaw=-90.0).order),
        RoutePoint(2, leg().order),
    ]


def test_a_speed_of_climb_is_not_that_of_the_legs() -> None:
    """2: climb, 3: descent (SPEED_TYPE)."""
    route = read(*(item(178, param1=kind, param2=1.0) for kind in (2.0, 3.0)), item(16))
    assert (route.legs[0].order.speed, route.left_out) == (3.5, [178, 178])


# A made-up file as MAVProxy and Mission Planner write and upload it: number, current, frame,
# command, four parameters, latitude, longitude, altitude, autocontinue. Item 0 is home.
WPL = """QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t-33.1240000\t151.2340000\t500.0\t1
1\t0\t3\t22\t0\t0\t0\t0\t0\t0\t12.0\t1
2\t0\t3\t16\t0\t0\t0\t0\t-33.1234567\t151.2345678\t20.0\t1
3\t0\t3\t19\t5\t0\t0\t0\t-33.1235000\t151.2346000\t25.0\t1
4\t0\t3\t20\t0\t0\t0\t0\t0\t0\t0\t1
"""


def of_file(text: str) -> list[MavlinkMessage]:
    """Items as these programs upload the lines of a file."""
    items = []
    for line in text.splitlines()[1:]:
        _, _, frame, command, *numbers = map(float, line.split("\t"))
        values = dict(zip(("param1", "param2", "param3", "param4"), numbers, strict=False))
        place = {"x": round(numbers[4] * 1e7), "y": round(numbers[5] * 1e7), "z": numbers[6]}
        items.append(item(int(command), **values, **place, frame=int(frame)))
    return items


def test_the_first_item_of_a_file_of_mission_planner_is_home() -> None:
    """It was a place to fly to, and the take-off behind it one in the air."""
    route = read(*of_file(WPL))
    assert [(one.item, one.order.height, one.wait) for one in route.legs] == [
        (2, 20.0, 0.0),
        (3, 25.0, 5.0),
    ]
    assert (route.height, route.then) == (12.0, Mode.RTL)


@pytest.mark.parametrize(
    ("first", "is_home"),
    [
        (item(16, frame=GLOBAL, z=GROUND), True),
        (item(16, frame=GLOBAL, z=GROUND + 0.9), True),
        (item(16, frame=GLOBAL, z=0.0), True),  # as some programs write it
        (item(16, frame=GLOBAL, z=GROUND + 1.1), False),
        (item(16, z=0.5), False),
        (item(19, frame=GLOBAL, z=GROUND + 8.0), False),
    ],
)
def test_a_first_waypoint_on_the_ground_is_home_without_a_take_off(
    first: MavlinkMessage, is_home: bool
) -> None:
    assert [one.item for one in read(first, item(16)).legs] == ([1] if is_home else [0, 1])


def test_a_first_waypoint_of_relative_height_zero_is_home_before_a_take_off() -> None:
    assert [one.item for one in read(item(16, z=0.0), item(22), item(16)).legs] == [2]


def test_an_altitude_above_the_sea_needs_that_of_the_ground() -> None:
    assert read(item(16), ground=None).legs == [leg()]
    with pytest.raises(Refused, match="altitude of the ground"):
        read(item(16, frame=GLOBAL), ground=None)


def test_a_whole_mission() -> None:
    route = read(
        item(22, frame=GLOBAL, z=440.0),
        item(178, param1=1.0, param2=7.0),
        item(16),
        item(93, param1=4.0),
        item(2000),
        item(178, param1=1.0, param2=-1.0),
        item(19, param1=6.0, z=30.0),
        item(93, param1=599.0),
        item(20),
    )
    assert route.height == 7.5
    first, second = route.legs
    assert (first.order, first.wait, first.item) == (leg(speed=7.0).order, 4.0, 2)
    assert (second.order, second.wait, second.item) == (leg(30.0, 7.0).order, 600.0, 6)
    assert (route.then, route.left_out) == (Mode.RTL, [2000])


@pytest.mark.parametrize(
    ("end", "then", "legs"),
    [
        (item(20), Mode.RTL, 1),
        (item(21, x=0, y=0), Mode.LAND, 1),
        (item(21), Mode.LAND, 2),
        (item(21, x=0), Mode.LAND, 2),
        (item(17), Mode.HOLD, 2),
    ],
)
def test_how_it_ends(end: MavlinkMessage, then: Mode, legs: int) -> None:
    route = read(item(16, z=12.0), end)
    assert (route.then, len(route.legs)) == (then, legs)
    if then is Mode.LAND:
        assert route.legs[-1].order.height == 12.0, "it lands from the height of the leg before"
    assert read_route([], ground=None, speed=1.0).legs == []


# -- legs of a mission as a plan that the aircraft flies by itself, or why there is none -----------


def planned(
    number: int, yaw: float | None = None, wait: float = 0.0, height: float = 12.0
) -> RoutePoint:
    return RoutePoint(number, FlyTo(47.0 + number * 1e-4, -8.5, height, 3.5, yaw), wait)


@pytest.mark.parametrize(
    ("then", "at_end"),
    [(Mode.HOLD, AtEnd.HOVER), (Mode.RTL, AtEnd.GO_HOME), (Mode.LAND, AtEnd.LAND)],
)
def test_places_speed_and_end(then: Mode, at_end: AtEnd) -> None:
    plan = plan_of([planned(1), planned(2, height=21.0)], then, yaw_deg=None)
    assert (plan.speed, plan.at_end, plan.heading) == (3.5, at_end, Heading.AS_AT_START)
    found = [(one.latitude_deg, one.longitude_deg, one.height) for one in plan.waypoints]
    assert found == [(47.0001, -8.5, 12.0), (47.0002, -8.5, 21.0)]
    assert plan.max_speed == 10.0, "the pilot's stick may add to it"


def test_a_heading_that_no_item_names_stays_and_turns_the_short_way() -> None:
    legs = [planned(1), planned(2, 170.0), planned(3), planned(4, -170.0), planned(5, 100.0)]
    plan = plan_of(legs, Mode.HOLD, yaw_deg=-30.0)
    assert plan.heading is Heading.BY_WAYPOINT
    assert [one.heading_deg for one in plan.waypoints] == [-30.0, 170.0, 170.0, -170.0, 100.0]
    turns = [one.turn_clockwise for one in plan.waypoints]
    assert turns == [True, False, True, True, False]


@pytest.mark.parametrize(
    ("wait", "parts"), [(0.0, 0), (5.0, 1), (32.767, 1), (33.0, 2), (100.0, 4)]
)
def test_a_wait_is_made_of_those_that_the_wire_can_say(wait: float, parts: int) -> None:
    [first, _] = plan_of([planned(1, wait=wait), planned(2)], Mode.HOLD, yaw_deg=None).waypoints
    assert len(first.actions) == parts
    assert sum(getattr(one, "seconds", 0.0) for one in first.actions) == pytest.approx(wait)


@pytest.mark.parametrize(
    ("legs", "yaw", "why"),
    [
        ([], 0.0, "no place is left"),
        ([planned(1), planned(2, 90.0)], None, "the initial heading is unknown"),
        ([planned(4), planned(7, wait=9_000.0)], None, "item 7: it hovers for 9000 s"),
        ([planned(4), planned(7, height=5_000.0)], None, "item 7"),
        ([planned(4)], None, ""),
        ([planned(4), RoutePoint(7, FlyAround(1.0, 2.0, 8.0, 4.0))], None, "7: it is a circle"),
    ],
)
def test_what_the_aircraft_cannot_fly_is_reported_by_its_item(
    legs: list[RoutePoint], yaw: float | None, why: str
) -> None:
    with pytest.raises(Unfit) as caught:
        plan_of(legs, Mode.HOLD, yaw_deg=yaw)
    assert why in str(caught.value)


@pytest.mark.parametrize(("firmware", "is_one"), [("3.1", True), ("none", False)])
def test_which_firmware_flies_missions(firmware: str, is_one: bool) -> None:
    assert flies_missions(firmware) is is_one
