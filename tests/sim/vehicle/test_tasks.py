"""Flight mode commands (document 2.2.2.2), flight status, battery, arm."""

from __future__ import annotations

import itertools

import pytest

from m100link.protocol import (
    FlightPhase,
    QueryTask,
    RequestAuthority,
    Setpoint,
    StartTask,
    Task,
    TaskResultCode,
    TaskStartCode,
)
from m100link.sim.vehicle.flight import Maneuver, TaskMachine, TaskState
from m100link.wire import encode_frame
from tests.sim.host import Host, aircraft

GO_HOME, TAKE_OFF, LAND = Task
NORTH = Setpoint.velocity(north=3, east=0, up=0, yaw_rate_deg_s=0)


def away(host: Host, north: float = 60.0, height: float = 10.0, east: float = 0.0) -> Host:
    host.motion.place(north, east, height)
    return host


# --- the machine ----------------------------------------------------------------------------


def test_start_code_2_conditions_met() -> None:
    assert Host().ready().ask(StartTask(1, TAKE_OFF)) == TaskStartCode.STARTED


@pytest.mark.parametrize("task", [LAND, TAKE_OFF, GO_HOME])
def test_start_code_1_while_another_is_executing(task: Task) -> None:
    host = Host().ready()
    host.ask(StartTask(1, TAKE_OFF))
    assert host.ask(StartTask(2, task)) == TaskStartCode.REJECTED
    assert host.ask(QueryTask(1)) == TaskResultCode.EXECUTING


@pytest.mark.parametrize("number", [0, 2, 3, 5, 7, 8, 9, 21, 255])
def test_start_code_1_for_numbers_that_are_no_task(number: int) -> None:
    assert Host().ready().ask(StartTask(1, number)) == TaskStartCode.REJECTED


@pytest.mark.parametrize("value", [b"", b"\x01", b"\x01\x04\x00"])
def test_start_code_1_for_another_length(value: bytes) -> None:
    ack = Host().ready().ask_raw(b"\x01\x01" + value)
    assert ack is not None
    assert ack.data == b"\x01\x00"


def test_start_code_1_without_authority() -> None:
    host = Host()
    host.activate()
    assert host.ask(StartTask(1, TAKE_OFF)) == TaskStartCode.REJECTED
    assert not host.motion.motors_on


def test_start_code_1_take_off_in_the_air() -> None:
    assert Host().flying().ask(StartTask(2, TAKE_OFF)) == TaskStartCode.REJECTED


def test_k7_take_off_with_running_motors_is_accepted_and_fails() -> None:
    host = Host(firmware="3.1").ready()
    assert arm(host, True) == 0
    assert host.ask(StartTask(2, TAKE_OFF)) == TaskStartCode.STARTED
    assert host.ask(QueryTask(2)) == TaskResultCode.FAILED
    host.wait(8.0)
    assert host.ask(QueryTask(2)) == TaskResultCode.FAILED
    assert (host.phase(), host.motion.on_ground) == (FlightPhase.STANDBY, True)
    assert arm(host, False) == 0
    assert host.ask(StartTask(3, TAKE_OFF)) == TaskStartCode.STARTED
    host.wait(8.0)
    assert host.phase() is FlightPhase.IN_AIR


def test_start_code_1_landing_on_the_ground() -> None:
    assert Host().ready().ask(StartTask(1, LAND)) == TaskStartCode.REJECTED


def test_a_landing_by_itself_on_the_ground_changes_nothing() -> None:
    """One that a lost remote control or a lost program begins, and no task."""
    host = Host().ready()
    host.aircraft.vehicle.flight.land()
    assert host.phase() is FlightPhase.STANDBY
    host.wait(1.0)
    assert host.phase() is FlightPhase.STANDBY


def test_start_code_1_going_home_without_home_point_or_gps() -> None:
    host = Host().ready()
    assert host.ask(StartTask(1, GO_HOME)) == TaskStartCode.REJECTED
    host.take_off()
    host.aircraft.gps_health = 2
    assert host.ask(StartTask(2, GO_HOME)) == TaskStartCode.REJECTED


def test_query_code_1_before_any_task_and_for_another_sequence_number() -> None:
    host = Host().ready()
    assert host.ask(QueryTask(0)) == TaskResultCode.NOT_CURRENT
    host.ask(StartTask(7, TAKE_OFF))
    assert host.ask(QueryTask(8)) == TaskResultCode.NOT_CURRENT
    assert host.ask(QueryTask(7)) == TaskResultCode.EXECUTING


def test_query_code_1_for_a_rejected_task() -> None:
    host = Host().ready()
    assert host.ask(StartTask(3, LAND)) == TaskStartCode.REJECTED
    assert host.ask(QueryTask(3)) == TaskResultCode.NOT_CURRENT


@pytest.mark.parametrize("value", [b"", b"\x01\x01"])
def test_query_code_1_for_another_length(value: bytes) -> None:
    host = Host().ready()
    host.ask(StartTask(1, TAKE_OFF))
    ack = host.ask_raw(b"\x01\x02" + value)
    assert ack is not None
    assert ack.data == b"\x01\x00"


def test_query_code_3_then_5_and_the_result_is_kept() -> None:
    host = Host().ready()
    host.ask(StartTask(1, TAKE_OFF))
    host.wait(1.0)
    assert host.ask(QueryTask(1)) == TaskResultCode.EXECUTING
    host.wait(7.0)
    assert [host.ask(QueryTask(1)) for _ in range(5)] == [TaskResultCode.SUCCEEDED] * 5


@pytest.mark.parametrize("how", ["leave_f", "app_takes_control", "enable_api"])
def test_query_code_4_when_control_is_taken_away(how: str) -> None:
    host = away(Host().flying())
    host.ask(StartTask(2, GO_HOME))
    host.wait(1.0)
    getattr(host.aircraft, how)(*([False] if how == "enable_api" else []))
    host.wait(0.1)
    assert host.ask(QueryTask(2)) == TaskResultCode.FAILED
    assert host.phase() is FlightPhase.IN_AIR


def test_after_the_end_a_new_task_may_begin() -> None:
    host = Host().flying()
    assert host.ask(StartTask(2, LAND)) == TaskStartCode.STARTED
    assert host.ask(QueryTask(1)) == TaskResultCode.NOT_CURRENT


def test_a_repeated_start_repeats_its_ack_and_executes_once() -> None:
    host = Host().ready()
    frame = encode_frame(b"\x01\x01\x01\x04", session=5, sequence=77)
    for _ in range(3):
        host.send_raw(frame)
    assert [ack.data for ack in host.acks(5, 77)] == [b"\x02\x00"] * 3
    assert host.autopilot.endpoint.statistics.repeated_commands == 2


@pytest.mark.parametrize(
    ("state", "start", "query", "other"),
    [
        (TaskState.IDLE, 2, 1, 1),
        (TaskState.EXECUTING, 1, 3, 1),
        (TaskState.SUCCEEDED, 2, 5, 1),
        (TaskState.FAILED, 2, 4, 1),
    ],
)
def test_every_state_of_the_machine(state: TaskState, start: int, query: int, other: int) -> None:
    machine = TaskMachine()
    if state is not TaskState.IDLE:
        machine.start(1, TAKE_OFF, conditions_met=True)
        if state is not TaskState.EXECUTING:
            machine.end(succeeded=state is TaskState.SUCCEEDED)
    assert machine.query(1) == query
    assert machine.query(2) == other
    assert machine.start(3, LAND, conditions_met=False) == 1
    assert machine.state is state
    assert machine.start(4, LAND, conditions_met=True) == start


# --- take-off, landing, go-home -------------------------------------------------------------


@pytest.mark.parametrize("firmware", ["1.0", "2.3", "3.1"])
def test_take_off_ends_in_a_hover_at_about_1_2_m_as_the_samples_expect(firmware: str) -> None:
    host = Host(firmware=firmware).ready()
    host.ask(StartTask(1, TAKE_OFF))
    host.wait(0.5)
    assert host.phase() is FlightPhase.TAKING_OFF, "within 2 s"
    host.wait(5.5)
    assert host.phase() is FlightPhase.IN_AIR
    assert host.ask(QueryTask(1)) == TaskResultCode.SUCCEEDED, "within 7 s"
    host.wait(4.0)
    assert host.motion.height == pytest.approx(1.2, abs=0.1)
    assert host.motion.speed < 0.05


def test_status_sequence_of_a_flight_1_2_3_4_5_1() -> None:
    host = Host().ready()
    host.wait(0.5)
    for sequence, task in ((1, TAKE_OFF), (2, LAND)):
        host.ask(StartTask(sequence, task))
        host.wait(10.0)
    statuses = [p.flight_status.status for p in host.packets() if p.flight_status]
    assert [status for status, _ in itertools.groupby(statuses)] == [1, 2, 3, 4, 5, 1]
    assert 19 <= statuses.count(5) <= 21, "two seconds at 10 Hz"
    assert not host.motion.motors_on
    assert host.ask(QueryTask(2)) == TaskResultCode.SUCCEEDED


def test_status_3_as_soon_as_it_leaves_the_ground() -> None:
    host = Host().ready()
    host.ask(StartTask(1, TAKE_OFF))
    while host.phase() is not FlightPhase.IN_AIR:
        host.wait(0.01)
        assert host.now < 5.0
    assert host.motion.height < 0.05
    assert host.ask(QueryTask(1)) == TaskResultCode.EXECUTING


def test_landing_from_a_height() -> None:
    host = away(Host().flying(), north=0.0, height=30.0)
    host.ask(StartTask(2, LAND))
    host.wait(40.0)
    assert host.phase() is FlightPhase.STANDBY
    assert host.motion.touchdown_speed < 0.8


def test_go_home_climbs_flies_to_the_home_point_and_lands() -> None:
    host = away(Host().flying(), north=150.0, height=5.0, east=-40.0)
    host.ask(StartTask(2, GO_HOME))
    highest, maneuvers = 0.0, []
    for _ in range(800):
        host.wait(0.1)
        highest = max(highest, host.motion.height)
        maneuvers.append(host.vehicle.flight.maneuver)
        if maneuvers[-1] is Maneuver.FLY_HOME:
            assert host.motion.height > 19.6, "first it climbs"
        if host.motion.north > 120.0:
            assert host.phase() is FlightPhase.IN_AIR
    assert [maneuver for maneuver, _ in itertools.groupby(maneuvers)] == [
        Maneuver.CLIMB_HOME,
        Maneuver.FLY_HOME,
        Maneuver.DESCEND,
        Maneuver.FINISH,
        Maneuver.NONE,
    ]
    assert highest == pytest.approx(20.0, abs=0.5)
    assert (host.motion.north, host.motion.east) == pytest.approx((0.0, 0.0), abs=0.4)
    assert host.ask(QueryTask(2)) == TaskResultCode.SUCCEEDED


def test_go_home_near_home_lands_in_place() -> None:
    host = away(Host().flying(), north=15.0, height=5.0)
    host.ask(StartTask(2, GO_HOME))
    host.wait(20.0)
    assert host.phase() is FlightPhase.STANDBY
    assert host.motion.north == pytest.approx(15.0, abs=0.2)
    assert host.ask(QueryTask(2)) == TaskResultCode.SUCCEEDED


def test_go_home_where_it_stands_at_home_has_succeeded_already() -> None:
    host = Host().flying()
    host.ask(StartTask(2, LAND))
    host.wait(10.0)
    assert host.ask(StartTask(3, GO_HOME)) == TaskStartCode.STARTED
    assert host.ask(QueryTask(3)) == TaskResultCode.SUCCEEDED
    assert not host.motion.motors_on


def test_go_home_stops_when_gps_fails() -> None:
    host = away(Host().flying())
    host.ask(StartTask(2, GO_HOME))
    host.wait(2.0)
    host.aircraft.gps_health = 1
    host.wait(0.5)
    assert host.ask(QueryTask(2)) == TaskResultCode.FAILED


def test_home_is_where_the_motors_were_started() -> None:
    host = Host().ready()
    host.motion.north, host.motion.east = 40.0, -30.0
    host.take_off()
    assert host.vehicle.flight.home == (40.0, -30.0)


@pytest.mark.parametrize("task", [TAKE_OFF, LAND, GO_HOME])
def test_movement_during_a_task_is_ignored(task: Task) -> None:
    host = Host().ready()
    if task is not TAKE_OFF:
        host.take_off()
        away(host, height=25.0)
    place = host.motion.north
    assert host.ask(StartTask(9, task)) == TaskStartCode.STARTED
    host.fly(Setpoint.velocity(north=8, east=8, up=0, yaw_rate_deg_s=0), 1.0)
    assert abs(host.motion.east) < 0.5, "8 m/s would be 4 m by now"
    assert host.motion.north < place + 0.1


def test_losing_control_while_the_motors_start_stops_them() -> None:
    host = Host().ready()
    host.ask(StartTask(1, TAKE_OFF))
    host.wait(0.5)
    host.aircraft.leave_f()
    assert host.phase() is FlightPhase.STANDBY
    assert not host.motion.motors_on


def test_flown_to_the_ground_by_setpoints_the_motors_stop() -> None:
    host = Host().flying()
    host.fly(Setpoint.velocity(north=0, east=0, up=-1, yaw_rate_deg_s=0), 3.0)
    assert host.phase() in (FlightPhase.IN_AIR, FlightPhase.FINISHING_LANDING)
    host.wait(4.0)
    assert host.phase() is FlightPhase.STANDBY
    assert not host.motion.motors_on


# --- arm ------------------------------------------------------------------------------------


def arm(host: Host, on: bool) -> int:
    from m100link.protocol import Arm

    code: int = host.ask(Arm(on))
    return code


def test_an_arm_value_that_does_not_exist_is_no_command() -> None:
    host = Host(firmware="3.1").ready()
    ack = host.ask_raw(b"\x01\x05\xff")
    assert ack is not None
    assert ack.data == b"\x00\xff"
    assert not host.motion.motors_on


def test_a1_arm_codes_of_3_1() -> None:
    host = Host(firmware="3.1")
    host.activate()
    assert arm(host, True) == 1, "control needed"
    host.obtain()
    assert arm(host, False) == 2, "already in that state"
    assert arm(host, True) == 0, "done"
    assert host.motion.motors_on
    assert host.phase() is FlightPhase.STANDBY
    assert arm(host, True) == 2, "already in that state"
    host.fly(Setpoint.velocity(north=0, east=0, up=1, yaw_rate_deg_s=0), 3.0)
    assert host.phase() is FlightPhase.IN_AIR
    assert arm(host, False) == 3, "in the air"


def test_disarm_on_the_ground() -> None:
    host = Host(firmware="3.1").ready()
    arm(host, True)
    assert arm(host, False) == 0
    assert not host.motion.motors_on


@pytest.mark.parametrize(
    "setpoint",
    [
        Setpoint.tilt(roll_deg=0, pitch_deg=0, thrust_percent=80, yaw_rate_deg_s=0),
        Setpoint.velocity(north=0, east=0, up=1, yaw_rate_deg_s=0),
        Setpoint.velocity(north=0, east=0, height=3, yaw_rate_deg_s=0),
    ],
    ids=["thrust", "velocity", "height"],
)
def test_a1_the_status_stays_1_until_thrust_velocity_or_height_takes_it_off(
    setpoint: Setpoint,
) -> None:
    host = Host(firmware="3.1").ready()
    arm(host, True)
    host.fly(Setpoint.velocity(north=2, east=0, up=0, yaw_rate_deg_s=0), 3.0)
    assert (host.phase(), host.motion.on_ground) == (FlightPhase.STANDBY, True)
    assert abs(host.motion.north) < 0.1
    host.fly(setpoint, 3.0)
    assert host.phase() is FlightPhase.IN_AIR
    assert host.motion.height > 0.5


def test_a2_disarm_in_the_air_is_refused_and_nothing_else_happens() -> None:
    host = Host(firmware="3.1").flying()
    before = host.motion.height
    assert arm(host, False) == 3
    host.wait(3.0)
    assert host.motion.motors_on
    assert host.motion.height == pytest.approx(before, abs=0.05)
    assert host.ask(StartTask(2, LAND)) == TaskStartCode.STARTED
    host.wait(10.0)
    assert not host.motion.motors_on, "landing switches them off itself"


def test_a3_armed_with_nothing_commanded_the_motors_stop_after_20_s() -> None:
    host = Host(firmware="3.1").ready()
    arm(host, True)
    host.wait(15.0)
    host.fly(Setpoint.velocity(north=0, east=0, up=0, yaw_rate_deg_s=0), 1.0)
    host.wait(19.0)
    assert host.motion.motors_on, "counted from the last command"
    host.wait(2.0)
    assert not host.motion.motors_on
    assert arm(host, True) == 0, "may be armed again"


def test_a3_the_time_is_a_setting() -> None:
    host = Host(aircraft(firmware="3.1", settings={"armed_idle_seconds": 5.0})).ready()
    arm(host, True)
    host.wait(4.9)
    assert host.motion.motors_on
    host.wait(0.3)
    assert not host.motion.motors_on


@pytest.mark.parametrize("firmware", ["1.0", "2.3"])
def test_arm_is_unknown_before_3_1(firmware: str) -> None:
    assert arm(Host(firmware=firmware).ready(), True) == 0xFF00


# --- battery --------------------------------------------------------------------------------


def test_battery_drains_in_flight_and_hardly_on_the_ground() -> None:
    host = Host().ready()
    host.wait(60.0, step=1.0)
    assert host.aircraft.battery_percent > 99.5
    host.take_off()
    before = host.aircraft.battery_percent
    host.wait(60.0, step=1.0)
    assert before - host.aircraft.battery_percent == pytest.approx(100 / 22, rel=0.05)


def test_battery_item_is_rounded_up() -> None:
    host = Host()
    host.aircraft.battery_percent = 41.2
    host.wait(1.0)
    batteries = [p.battery.percent for p in host.packets() if p.battery]
    assert batteries == [42]


def test_nearly_empty_it_lands_by_itself_and_nothing_stops_it() -> None:
    host = away(Host().flying())
    host.ask(StartTask(2, GO_HOME))
    host.aircraft.battery_percent = 9.0
    host.wait(0.2)
    assert host.phase() is FlightPhase.LANDING
    assert host.ask(QueryTask(2)) == TaskResultCode.FAILED
    host.aircraft.leave_f()
    host.fly(NORTH, 1.0)
    host.wait(20.0)
    assert host.phase() is FlightPhase.STANDBY
    assert any("battery" in entry.text for entry in host.aircraft.vehicle.events)


def test_no_take_off_with_a_nearly_empty_battery() -> None:
    host = Host().ready()
    host.aircraft.battery_percent = 9.0
    assert host.ask(StartTask(1, TAKE_OFF)) == TaskStartCode.REJECTED


def test_an_empty_battery_falls() -> None:
    host = away(Host().flying(), height=20.0)
    host.aircraft.battery_percent = 0.0
    host.wait(3.0)
    assert host.motion.on_ground
    assert host.motion.touchdown_speed > 15.0
    assert host.phase() is FlightPhase.STANDBY


@pytest.mark.parametrize("percent", [-1.0, 100.1])
def test_charge_is_a_percentage(percent: float) -> None:
    with pytest.raises(ValueError, match="percent"):
        aircraft().battery_percent = percent


def test_the_authority_code_of_a_rejected_take_off_is_no_system_code() -> None:
    host = Host()
    host.activate()
    host.ask(RequestAuthority(False))
    assert host.ask(StartTask(1, TAKE_OFF)) == 1
