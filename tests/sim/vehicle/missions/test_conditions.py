"""Codes of a start that come from the state of the aircraft: DJI's, in an order of ours."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from m100link.protocol import RequestAuthority, StartTask, Task
from m100link.protocol.codes import MissionCode as Code
from m100link.protocol.commands.hotpoint import FollowStart
from m100link.protocol.commands.waypoint import WaypointMission, WaypointStartStop
from m100link.sim import Airframe
from m100link.sim.vehicle.missions.route import NoFlyZone
from tests.sim.host import Host
from tests.sim.vehicle.missions.flights import OK, SQUARE, host, hotpoint, point, upload

POINTS = [point(index, *place) for index, place in enumerate(SQUARE)]
Prepare = Callable[[Host], Any]


def release(program: Host) -> None:
    for _ in range(program.profile.authority_requests):
        program.ask(RequestAuthority(False))


def weak_gps(program: Host) -> None:
    program.aircraft.gps_health = 2


def low_battery(program: Host) -> None:
    program.aircraft.battery_percent = 30.0


def no_home(program: Host) -> None:
    program.vehicle.flight.home = None


def go_home(program: Host) -> None:
    program.motion.place(60.0, 0.0, 15.0)
    assert program.ask(StartTask(2, Task.GO_HOME)) == 2


def land(program: Host) -> None:
    assert program.ask(StartTask(2, Task.LAND)) == 2


CONDITIONS: dict[str, tuple[Prepare, dict[str, Any], Code]] = {
    "not in F": (lambda p: p.aircraft.leave_f(), {}, Code.RC_NOT_IN_F),
    "the app holds control": (
        lambda p: p.aircraft.app_takes_control(),
        {},
        Code.AUTHORITY_NEEDED,
    ),
    "released": (release, {}, Code.AUTHORITY_NEEDED),
    "IOC": (lambda p: p.aircraft.set_ioc(), {}, Code.IOC_ON),
    "landing": (land, {}, Code.LANDING),
    "landing, one code": (land, {"busy_is_one_code": True}, Code.BUSY),
    "going home": (go_home, {}, Code.GOING_HOME),
    "weak GPS": (weak_gps, {}, Code.GPS_TOO_WEAK),
    "no home": (no_home, {}, Code.HOME_NOT_RECORDED),
    "battery": (low_battery, {}, Code.BATTERY_LOW),
    "battery, another level": (low_battery, {"least_battery_percent": 29.0}, OK),
    "beginner": (lambda p: None, {"beginner_mode": True}, Code.BEGINNER_MODE),
    "nothing": (lambda p: None, {}, OK),
}


def start_waypoints(program: Host) -> Code:
    code: Code = program.ask(WaypointStartStop(0))
    return code


def start_hotpoint(program: Host) -> Code:
    code: Code = program.ask(hotpoint()).code
    return code


def start_follow(program: Host) -> Code:
    here = hotpoint()
    code: Code = program.ask(FollowStart(here.latitude, here.longitude))
    return code


def in_the_air(**missions: Any) -> Host:
    program = host(**missions)
    program.take_off()
    program.motion.place(0.0, 0.0, 15.0)
    assert upload(program, POINTS) == (OK, [OK] * 4)
    return program


@pytest.mark.parametrize("start", [start_waypoints, start_hotpoint, start_follow])
@pytest.mark.parametrize("name", CONDITIONS)
def test_every_mission_asks_for_the_same_conditions(
    name: str, start: Callable[[Host], Code]
) -> None:
    prepare, missions, code = CONDITIONS[name]
    program = in_the_air(**missions)
    prepare(program)
    program.wait(0.1)
    assert start(program) == code
    assert (program.vehicle.missions.running is not None) is (code == OK)


@pytest.mark.parametrize(
    ("after", "code"), [(0.5, Code.STARTING_MOTORS), (2.0, Code.TAKING_OFF), (8.0, OK)]
)
def test_no_mission_starts_during_another_take_off(after: float, code: Code) -> None:
    program = host()
    upload(program, POINTS)
    program.ask(StartTask(1, Task.TAKE_OFF))
    program.wait(after)
    assert start_waypoints(program) == code


def test_conditions_are_judged_in_their_order() -> None:
    """What is put right one after the other uncovers the next code."""
    program = in_the_air(beginner_mode=True)
    weak_gps(program)
    low_battery(program)
    program.aircraft.leave_f()
    seen = [start_waypoints(program)]
    program.aircraft.return_to_f()
    program.aircraft.app_takes_control()
    seen.append(start_waypoints(program))
    program.aircraft.app_releases_control()
    program.obtain()
    seen.append(start_waypoints(program))
    program.aircraft.gps_health = 5
    seen.append(start_waypoints(program))
    program.aircraft.battery_percent = 80.0
    seen.append(start_waypoints(program))
    assert seen == [
        Code.RC_NOT_IN_F,
        Code.AUTHORITY_NEEDED,
        Code.GPS_TOO_WEAK,
        Code.BATTERY_LOW,
        Code.BEGINNER_MODE,
    ]


def test_an_upload_needs_control_and_a_point_only_a_mission() -> None:
    program = host()
    program.aircraft.leave_f()
    assert program.ask(WaypointMission(2, 10.0, 5.0)) == Code.RC_NOT_IN_F
    program.aircraft.return_to_f()
    assert upload(program, POINTS) == (OK, [OK] * 4)
    program.aircraft.leave_f()
    assert program.ask(WaypointMission(2, 10.0, 5.0)) == Code.RC_NOT_IN_F
    assert program.vehicle.missions.upload.mission is not None  # what was there is untouched
    assert program.ask(POINTS[0]).code == OK


PLANS: dict[str, tuple[list[tuple[float, float, float]], dict[str, Any], dict[str, Any], Code]] = {
    "too high": ([(0, 0, 10), (0, 0, 121)], {}, {}, Code.TOO_HIGH),
    "as high as allowed": ([(0, 0, 10), (0, 0, 120)], {}, {}, OK),
    "outside the radius": (
        [(0, 0, 10), (90, 50, 10)],
        {},
        {"radius_limit": 100.0},
        Code.TOO_FAR_FROM_HOME,
    ),
    "inside the radius": ([(0, 0, 10), (80, 50, 10)], {}, {"radius_limit": 100.0}, OK),
    "never logged in, high": (
        [(0, 0, 10), (0, 0, 31)],
        {},
        {"never_logged_in": True},
        Code.TOO_HIGH,
    ),
    "never logged in, far": (
        [(0, 0, 10), (51, 0, 10)],
        {},
        {"never_logged_in": True},
        Code.TOO_FAR_FROM_HOME,
    ),
    "longer than the battery": (
        [(0, 0, 10), (1900, 0, 10)],
        {"idle_speed": 1.0},
        {},
        Code.TAKES_TOO_LONG,
    ),
    "twice is too long": (
        [(0, 0, 10), (1900, 0, 10)],
        {"idle_speed": 2.5, "repeat": 2},
        {},
        Code.TAKES_TOO_LONG,
    ),
    "once is not": ([(0, 0, 10), (1900, 0, 10)], {"idle_speed": 2.5}, {}, OK),
    "too far for the battery": (
        [(1500, 0, 10), (600, 0, 10)],  # 22 minutes, less a tenth: 1,188 s, not 750 + 458
        {"idle_speed": 2.0},
        {},
        Code.TAKES_TOO_LONG,
    ),
    "not too far for it": ([(1400, 0, 10), (600, 0, 10)], {"idle_speed": 2.0}, {}, OK),
    "begins far away": ([(2001, 0, 10), (2050, 0, 10)], {}, {}, Code.TOO_FAR_AWAY),
    "begins as far as allowed": ([(1999, 0, 10), (2050, 0, 10)], {}, {}, OK),
    "in a zone": ([(0, 0, 10), (30, 0, 10)], {}, {"no_fly_zones": ()}, OK),
}


@pytest.mark.parametrize("name", PLANS)
def test_a_plan_against_the_limits(name: str) -> None:
    places, fields, missions, code = PLANS[name]
    given = {"radius_limit": math.inf} | missions
    program = host({"airframe": Airframe()}, **given)  # whose battery hovers for 22 minutes
    points = [point(index, *place) for index, place in enumerate(places)]
    assert upload(program, points, **fields)[1][-1] == OK
    assert start_waypoints(program) == code


@pytest.mark.parametrize(("north", "code"), [(499.0, OK), (501.0, Code.TOO_FAR_FROM_HOME)])
def test_the_radius_of_the_app_is_500_m(north: float, code: Code) -> None:
    """As owners report (Mobile-SDK-Android 317 and 809), whatever the app shows."""
    program = host()
    upload(program, [point(0, 0, 0, 10), point(1, north, 0, 10)])
    assert start_waypoints(program) == code


def test_in_a_no_fly_zone_nothing_starts() -> None:
    program = in_the_air()
    zone = NoFlyZone(22.5431, 113.9589, 5.0)
    closed = host(no_fly_zones=(zone,))
    closed.take_off()
    closed.motion.place(0.0, 0.0, 15.0)
    assert start_hotpoint(closed) == Code.IN_NO_FLY_ZONE
    assert start_hotpoint(program) == OK


@pytest.mark.parametrize(("takes_off", "code"), [(True, OK), (False, Code.NOT_IN_THE_AIR)])
def test_a_start_on_the_ground(takes_off: bool, code: Code) -> None:
    program = host(takes_off_by_itself=takes_off)
    upload(program, POINTS)
    assert start_waypoints(program) == code
    program.wait(10.0)
    assert (program.motion.height > 1.0) is takes_off
