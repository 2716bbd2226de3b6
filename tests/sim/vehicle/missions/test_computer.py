"""How missions end: by whom, what the aircraft does then, and what it tells."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from m100link.protocol import QueryTask, RequestAuthority, StartTask, Task
from m100link.protocol.codes import MissionCode as Code
from m100link.protocol.codes import TaskStartCode
from m100link.protocol.commands.missions import Uploaded
from m100link.protocol.commands.waypoint import (
    WaypointDownloadMission,
    WaypointMission,
    WaypointPauseResume,
    WaypointSetIdleSpeed,
    WaypointStartStop,
)
from m100link.sim.vehicle.flight import Maneuver
from tests.sim.host import Host
from tests.sim.vehicle.missions.flights import (
    OK,
    begin,
    events,
    fly,
    host,
    hotpoint,
    point,
    upload,
    where,
)

LONG = [point(0, 0, 0, 12), point(1, 80, 0, 12), point(2, 80, 60, 12)]


def on_the_way(program: Host | None = None, **fields: Any) -> Host:
    program = program or host()
    begin(program, LONG, **fields)
    program.wait(20.0)
    assert program.motion.velocity_north > 4.0
    return program


def _land(program: Host) -> None:
    assert program.ask(StartTask(9, Task.LAND)) == TaskStartCode.STARTED


def _go_home(program: Host) -> None:
    assert program.ask(StartTask(9, Task.GO_HOME)) == TaskStartCode.STARTED


def _release(program: Host) -> None:
    for _ in range(program.profile.authority_requests):
        program.ask(RequestAuthority(False))


def _battery(percent: float) -> Callable[[Host], None]:
    def lower(program: Host) -> None:
        program.aircraft.battery_percent = percent

    return lower


def _gps(program: Host) -> None:
    program.aircraft.gps_health = 2


HOVERS, LANDS = {Maneuver.NONE}, {Maneuver.DESCEND}
GOES_HOME = {Maneuver.CLIMB_HOME, Maneuver.FLY_HOME}
ENDINGS: dict[str, tuple[Callable[[Host], Any], Code, set[Maneuver]]] = {
    "the mode switch leaves F": (lambda p: p.aircraft.leave_f(), Code.RC_NOT_IN_F, HOVERS),
    "the app takes over": (lambda p: p.aircraft.app_takes_control(), Code.AUTHORITY_NEEDED, HOVERS),
    "released": (_release, Code.AUTHORITY_NEEDED, HOVERS),
    "api switched off": (lambda p: p.aircraft.enable_api(False), Code.AUTHORITY_NEEDED, HOVERS),
    "landing task": (_land, Code.LANDING, LANDS),
    "the pilot lands": (lambda p: p.aircraft.pilot_lands(), Code.LANDING, LANDS),
    "go-home task": (_go_home, Code.GOING_HOME, GOES_HOME),
    "low battery": (_battery(25.0), Code.BATTERY_LOW, GOES_HOME),
    "critical battery": (_battery(9.0), Code.BATTERY_LOW, LANDS),
    "remote control lost": (lambda p: p.aircraft.rc_lost(), Code.SUCCESS, GOES_HOME),
    "weak GPS": (_gps, Code.GPS_TOO_WEAK, HOVERS),
}


@pytest.mark.parametrize("is_paused", [False, True], ids=["flying", "paused"])
@pytest.mark.parametrize("cause", ENDINGS)
def test_whatever_breaks_a_mission_off_is_reported(cause: str, is_paused: bool) -> None:
    act, reason, then = ENDINGS[cause]
    settings = {"low_battery_percent": 5.0} if cause == "critical battery" else {}
    program = on_the_way(host(settings=settings))
    if is_paused:
        assert program.ask(WaypointPauseResume(0)) == OK
    act(program)
    program.wait(3.3)
    last = program.vehicle.missions.last
    assert (last.last_mission, last.flags, last.reason) == (1, 1, reason)
    assert program.pushes(0x03)[-1].frame.data[2:6] == bytes((0, 1, 1, reason))
    assert program.vehicle.flight.maneuver in then
    if then is HOVERS:
        program.aircraft.gps_health = 5
        program.wait(4.0)
        assert program.motion.speed < 0.2
    # It is over for good: neither a return to F nor a resume brings it back.
    program.aircraft.return_to_f()
    program.wait(0.5)
    assert program.vehicle.missions.running is None
    assert program.ask(WaypointPauseResume(1)) == Code.NOT_STARTED
    assert program.ask(WaypointDownloadMission()).mission.count == 0


@pytest.mark.parametrize("cause", ["the mode switch leaves F", "released", "remote control lost"])
@pytest.mark.parametrize("after", [0.5, 2.5])
def test_a_mission_may_be_broken_off_while_it_takes_off(cause: str, after: float) -> None:
    program = host()
    begin(program, LONG)
    program.wait(after)
    ENDINGS[cause][0](program)
    program.wait(3.4)
    last = program.vehicle.missions.last
    assert (last.last_mission, last.flags, last.reason) == (1, 1, ENDINGS[cause][1])
    program.wait(20.0)
    assert program.motion.height < 2.0


def test_after_a_stop_it_hovers_and_the_mission_is_gone() -> None:
    program = on_the_way()
    assert program.ask(WaypointStartStop(1)) == OK
    program.wait(4.0)
    assert program.motion.speed < 0.1
    last = program.vehicle.missions.last
    assert (last.last_mission, last.flags, last.reason) == (1, 0, 0)
    assert program.ask(WaypointStartStop(0)) == Code.NO_POINTS
    begin(program, LONG)  # uploaded again, it starts


def test_a_stop_on_the_ground_switches_the_motors_off() -> None:
    program = host()
    begin(program, LONG)
    program.wait(0.5)
    assert program.motion.motors_on
    assert program.ask(WaypointStartStop(1)) == OK
    assert not program.motion.motors_on
    program.wait(5.0)
    assert program.motion.on_ground


def test_without_the_remote_control_it_goes_on_where_that_was_asked_for() -> None:
    program = on_the_way(rc_lost_action=1)
    program.aircraft.rc_lost()
    fly(program)
    assert math.dist(where(program), (80, 60, 12)) < 0.6
    assert program.vehicle.missions.last.flags == 0
    # Then nothing keeps the failsafe back.
    program.wait(1.0)
    assert program.vehicle.flight.maneuver is Maneuver.CLIMB_HOME


@pytest.mark.parametrize("is_in_f", [True, False])
def test_a_remote_control_that_comes_back_leaves_the_mission_alone_in_f_only(is_in_f: bool) -> None:
    program = on_the_way(rc_lost_action=1)
    program.aircraft.rc_lost()
    program.wait(5.0)
    if not is_in_f:
        program.aircraft.leave_f()
    program.aircraft.rc_back()
    program.wait(0.5)
    assert (program.vehicle.missions.running is not None) is is_in_f
    if not is_in_f:
        assert program.vehicle.missions.last.reason == Code.RC_NOT_IN_F


def test_a_short_loss_of_the_remote_control_changes_nothing() -> None:
    program = on_the_way()
    program.aircraft.rc_lost()
    program.wait(2.0)
    program.aircraft.rc_back()
    fly(program)
    assert program.vehicle.missions.last.flags == 0


def test_going_home_at_low_battery_may_be_switched_off() -> None:
    program = on_the_way(host(low_battery_returns=False))
    program.aircraft.battery_percent = 24.0
    program.wait(1.0)
    assert program.vehicle.missions.running is not None


def test_the_status_comes_at_its_rate_from_the_first_mission_on() -> None:
    program = host(status_when_idle=False, status_hz=5.0)
    program.wait(20.0)
    assert not program.pushes(0x03)
    begin(program, LONG)
    program.wait(2.0)
    assert len(program.pushes(0x03)) == pytest.approx(10, abs=1)


def test_a_restart_forgets_everything() -> None:
    program = on_the_way(host(status_when_idle=False))
    program.aircraft.reboot()
    program.wait(3.0)
    missions = program.vehicle.missions
    assert missions.running is None
    assert missions.upload.mission is None
    assert not missions.is_active
    assert program.motion.height > 10.0


def test_a_take_off_task_during_a_mission_is_rejected() -> None:
    program = on_the_way()
    assert program.ask(StartTask(3, Task.TAKE_OFF)) == TaskStartCode.REJECTED
    assert program.ask(QueryTask(3)) == 1
    assert program.vehicle.missions.running is not None


# --- pauses by the pilot --------------------------------------------------------------------


def test_the_mode_switch_may_pause_instead() -> None:
    program = on_the_way(host(leaving_f_pauses=True))
    program.aircraft.leave_f()
    program.wait(3.0)
    missions = program.vehicle.missions
    assert (missions.running is not None, missions.is_paused) == (True, True)
    assert program.ask(WaypointPauseResume(1)) == Code.RC_NOT_IN_F
    program.aircraft.move_stick(roll=0.5)  # meanwhile the pilot flies
    program.wait(4.0)
    program.aircraft.release_sticks()
    assert program.motion.east > 5.0
    program.aircraft.return_to_f()
    program.wait(5.0)
    assert program.motion.speed < 0.1
    assert program.ask(WaypointPauseResume(1)) == OK
    track = fly(program)
    assert math.dist(track[-1], (80, 60, 12)) < 0.6


@pytest.mark.parametrize(
    "act",
    [
        lambda p: p.aircraft.pilot_lands(),
        lambda p: p.aircraft.rc_lost(),
        lambda p: p.ask(WaypointStartStop(1)),
    ],
    ids=["landing", "RC lost", "stop"],
)
def test_a_mission_that_waits_for_the_pilot_may_end(act: Callable[[Host], Any]) -> None:
    program = on_the_way(host(leaving_f_pauses=True), rc_lost_action=1)
    program.aircraft.leave_f()
    program.wait(0.5)
    act(program)
    program.wait(3.5)
    assert program.vehicle.missions.running is None


@pytest.mark.parametrize("cause", ["released", "the app takes over"])
def test_others_who_take_over_break_it_off_all_the_same(cause: str) -> None:
    program = on_the_way(host(leaving_f_pauses=True))
    ENDINGS[cause][0](program)
    program.wait(0.2)
    assert program.vehicle.missions.last.reason == Code.AUTHORITY_NEEDED


@pytest.mark.parametrize("stick", ["roll", "throttle"])
def test_a_stick_may_pause(stick: str) -> None:
    for chosen in (False, True):
        program = on_the_way(host(stick_pauses=chosen))
        program.aircraft.move_stick(pitch=0.2, yaw=0.3)
        program.wait(0.5)
        assert not program.vehicle.missions.is_paused
        program.aircraft.move_stick(**{stick: -0.4})
        program.wait(0.5)
        assert program.vehicle.missions.is_paused is chosen


# --- uploads --------------------------------------------------------------------------------


def test_a_repeated_index_overwrites_and_the_order_does_not_matter() -> None:
    program = host()
    wrong = point(2, 5000, 0, 12)
    mission = [wrong, LONG[1], LONG[2], LONG[0]]
    assert program.ask(_mission(3)) == OK
    assert [program.ask(each).code for each in mission] == [OK] * 4
    assert program.ask(WaypointStartStop(0)) == OK


def _mission(count: int) -> Any:
    return WaypointMission(count, 10.0, 5.0)


def test_after_a_failed_check_all_points_have_to_come_again() -> None:
    program = host()
    far = [LONG[0], point(1, 3000, 0, 12)]
    assert upload(program, far) == (OK, [OK, Code.POINTS_TOO_FAR])
    assert program.ask(WaypointStartStop(0)) == Code.NO_POINTS
    program.wait(0.1)
    assert events(program) == [Uploaded(valid=0)]
    assert [program.ask(each).code for each in LONG[:2]] == [OK, OK]
    program.wait(0.1)
    (_, told) = events(program)
    assert isinstance(told, Uploaded)
    assert told.valid == 1
    assert program.ask(WaypointStartStop(0)) == OK


def test_a_speed_that_is_set_before_the_start_is_flown() -> None:
    program = host()
    upload(program, LONG)
    assert program.ask(WaypointSetIdleSpeed(9.0)).code == OK
    assert program.ask(WaypointStartStop(0)) == OK
    program.wait(14.0)
    assert program.motion.velocity_north == pytest.approx(9.0, abs=0.3)


def test_an_index_beyond_the_count() -> None:
    program = host()
    program.ask(_mission(2))
    assert program.ask(LONG[2]).code == Code.INDEX_TOO_LARGE


def test_a_point_that_comes_again_is_checked_with_the_others() -> None:
    program = host()
    upload(program, LONG)
    assert program.ask(point(1, 0.5, 0, 12)).code == Code.POINTS_TOO_CLOSE
    assert program.ask(WaypointStartStop(0)) == Code.NO_POINTS


def test_another_kind_may_start_after_the_end() -> None:
    program = on_the_way()
    program.ask(WaypointStartStop(1))
    assert program.ask(hotpoint(80.0)).code == OK
    program.wait(1.0)
    assert program.vehicle.missions.name == "hotpoint"
