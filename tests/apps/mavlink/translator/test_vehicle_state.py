"""What the bridge knows of an aircraft, as tables: where the flight stands, and what is known."""

from __future__ import annotations

import enum
import math
from dataclasses import replace
from typing import Any

import pytest

from m100link.apps.agent.control_session import ControlInput
from m100link.apps.agent.messages import LeaseChanged, State
from m100link.apps.mavlink.translator import numbers
from m100link.apps.mavlink.translator.vehicle_state import (
    ARM_VERDICTS,
    DISARM_VERDICTS,
    MODES,
    RUNNING,
    VERDICTS,
    FlightSource,
    Mode,
    ModeTransition,
    ModeVerdict,
    VehiclePhase,
    VehicleState,
    heartbeat,
)
from m100link.protocol.records import (
    Attitude,
    Battery,
    FlightStatus,
    Position,
    RemoteControl,
    Velocity,
)
from tests.apps.mavlink.conftest import session_of, world_of
from tests.known import Known, position

GROUND, AIR = FlightStatus(1), FlightStatus(3)
P, A, F = (RemoteControl(0, 0, 0, 0, mode, None) for mode in (-8000, 0, 8000))


def world(*values: Any, **state: Any) -> VehicleState:
    """By name: holder, authority, lease; anything else is of the agent's state."""
    known: Any = Known(*values)
    if state.pop("no_switch", False):
        known.without(RemoteControl)
    known.holder = LeaseChanged(state.pop("holder", 0), "somebody")
    known.has_authority = state.pop("authority", False)
    found = VehicleState(known, session_of(known, number=state.pop("lease", 0)))
    known.state = replace(known.state, **state)
    return found


@pytest.mark.parametrize(
    ("one", "phase", "mode"),
    [
        (world(GROUND, F), VehiclePhase.DISARMED, Mode.HOLD),
        (world(GROUND, P), VehiclePhase.DISARMED, Mode.POSCTL),
        (world(GROUND, A), VehiclePhase.DISARMED, Mode.ALTCTL),
        (world(GROUND, no_switch=True), VehiclePhase.DISARMED, Mode.HOLD),
        (world(AIR, F), VehiclePhase.FREE, Mode.POSCTL),
        (world(AIR, P), VehiclePhase.PILOT, Mode.POSCTL),
        (world(AIR, A), VehiclePhase.PILOT, Mode.ALTCTL),
        (world(AIR, no_switch=True), VehiclePhase.PILOT, Mode.POSCTL),
        (world(AIR, F, mission="hotpoint"), VehiclePhase.FREE, Mode.MISSION),
        (world(AIR, P, mission="hotpoint"), VehiclePhase.PILOT, Mode.POSCTL),
        (world(AIR, F, mission="no kind"), VehiclePhase.FREE, Mode.POSCTL),
        (world(AIR, F, mission="follow mission"), VehiclePhase.FREE, Mode.MISSION),
        (world(GROUND, F, holder=3, lease=3, authority=True), VehiclePhase.ARMED, Mode.HOLD),
        (world(AIR, F, holder=3, lease=3, authority=True), VehiclePhase.AIRBORNE, Mode.POSCTL),
        (world(AIR, F, holder=3, lease=3), VehiclePhase.FREE, Mode.POSCTL),
        (world(AIR, F, holder=3, lease=2, authority=True), VehiclePhase.OTHER, Mode.POSCTL),
        (world(GROUND, F, holder=3), VehiclePhase.OTHER, Mode.POSCTL),
        *(
            (world(AIR, F, holder=3, authority=True, task=task), VehiclePhase.OTHER, mode)
            for task, mode in (
                ("land", Mode.LAND),
                ("take off", Mode.TAKEOFF),
                ("go home", Mode.RTL),
            )
        ),
        (world(AIR, F, holder=3, task="land"), VehiclePhase.OTHER, Mode.POSCTL),
        (
            world(AIR, F, holder=3, authority=True, mission="waypoint mission"),
            VehiclePhase.OTHER,
            Mode.MISSION,
        ),
    ],
)
def test_where_the_flight_stands_and_what_is_shown_of_it(
    one: VehicleState, phase: VehiclePhase, mode: Mode
) -> None:
    assert one.phase is phase
    assert one.mode_of_others() is mode
    assert one.explain(phase)


def test_control_that_came_back_before_somebody_looked_was_lost() -> None:
    one = world(AIR, F, holder=3, lease=3, authority=True)
    one.session.feed(ControlInput.AUTHORITY_TAKEN)
    phases = [one.phase]
    one.session.heard()
    assert [*phases, one.phase] == [VehiclePhase.FREE, VehiclePhase.AIRBORNE]


def test_nothing_begins_before_the_manager_knows_that_control_is_held() -> None:
    """What was asked for in between was forgotten by the answer, and flown all the same."""
    one = world(GROUND, F, holder=3, lease=3, authority=True)
    one.session.feed(ControlInput.OBTAIN)
    phases = [one.phase]
    one.session.feed(ControlInput.OBEYED)
    assert [*phases, one.phase] == [VehiclePhase.DISARMED, VehiclePhase.ARMED]


def test_a_lease_that_the_bridge_gives_back_is_nobody_elses() -> None:
    one = world(AIR, F, holder=3, lease=3)
    one.session.let_go()
    phases = [one.phase]
    known: Any = one.known
    known.holder = LeaseChanged(4, "somebody")
    assert [*phases, one.phase] == [VehiclePhase.FREE, VehiclePhase.OTHER]


def test_the_holder_of_control_is_named_where_a_mode_is_refused() -> None:
    assert world(AIR, P).explain(VehiclePhase.PILOT) == "the pilot flies: the mode switch is in P"
    unknown = world(AIR, no_switch=True).explain(VehiclePhase.PILOT)
    assert unknown == "the pilot flies: the mode switch is unknown"
    assert world(AIR, holder=3).explain(VehiclePhase.OTHER) == "somebody has control"


@pytest.mark.parametrize(
    ("age", "is_heard"), [(0.0, True), (1.2, True), (1.3, False), (None, False)]
)
def test_an_aircraft_that_says_nothing_is_away(age: float | None, is_heard: bool) -> None:
    known = Known(GROUND, F)
    known.newest_age = age
    assert world_of(known).known.view.is_heard is is_heard
    assert (world_of(known).phase is VehiclePhase.AWAY) is not is_heard
    known.newest_age, known.is_connected = 0.0, False
    assert world_of(known).phase is VehiclePhase.AWAY
    assert world_of(known).known.view.get(Attitude) is None
    known.is_connected, known.telemetry = True, None
    assert world_of(known).phase is VehiclePhase.AWAY


@pytest.mark.parametrize(
    ("one", "is_armed"),
    [
        (world(GROUND), False),
        (world(AIR), True),
        (world(FlightStatus(9)), True),
        (world(GROUND, authority=True), True),
        (world(GROUND, holder=2), False),
    ],
)
def test_motors_that_may_turn_count_as_armed(one: VehicleState, is_armed: bool) -> None:
    assert one.is_armed is is_armed
    one.may_take_off = True
    assert one.is_armed, "a take-off that was called off may be flown all the same"


def test_how_old_a_value_may_be() -> None:
    known = Known()
    for record in (FlightStatus, Battery, Attitude, Position, Velocity, RemoteControl):
        assert world_of(known).known.view.get(record) is not None
    others = dict.fromkeys((Attitude, Position, Velocity, RemoteControl), 1.2)
    assert known.within == {FlightStatus: 2.5, Battery: 5.0, **others}


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_not_known(wrong: float) -> None:
    one = world_of(Known(Velocity(0.0, wrong, 0.0, 3), position(altitude=wrong)))
    assert (
        one.known.view.get(Velocity),
        one.known.view.place,
        one.height,
        one.ground_altitude,
    ) == (None,) * 4


def test_heights_are_above_where_it_stood() -> None:
    one = world_of(Known())
    assert one.height == 12.34
    assert one.ground_altitude == pytest.approx(75.31)
    standing = world_of(Known(GROUND, position(height=0.7)))
    assert (standing.height, standing.ground_altitude) == (0.0, 87.65), "noise is no height"
    assert world_of(Known().without(FlightStatus)).known.view.is_on_ground is None


@pytest.mark.parametrize(
    ("north", "up", "follows"),
    [(0.5, 0.2, False), (1.5, 0.0, True), (0.0, 0.6, True), (-1.5, 0.0, True)],
)
def test_home_is_where_it_stood_last_and_follows_no_noise(
    north: float, up: float, follows: bool
) -> None:
    known = Known(GROUND, position())
    one = world_of(known)
    one.look()
    before = one.home
    assert before is not None
    assert before.altitude_m == 87.65
    moved = position(latitude=-33.1234567 + math.degrees(north / 6_371_000), altitude=87.65 + up)
    known.items[Position] = moved
    known.items[FlightStatus] = AIR
    one.look()
    assert one.home is before, "in the air nothing is home"
    known.items[FlightStatus] = GROUND
    known.items[Position] = moved._replace(gps_health=2)
    one.look()
    assert one.home is before, "without GPS nobody knows where it stands"
    known.items[Position] = moved
    one.look()
    assert (one.home is not before) is follows
    assert world_of(Known(), home=(3.0, 4.0, 5.0)).local == pytest.approx((3.0, 4.0, 5.0), abs=0.05)


def test_the_state_of_the_agent_is_read_each_time() -> None:
    known = Known(AIR, F)
    one, found = world_of(known), []
    for known.state, known.is_connected in (
        (State(0.0), True),
        (State(0.0, mission="waypoint mission"), True),
        (State(0.0, mission="waypoint mission"), False),
    ):
        found.append(one.flies_mission)
    assert found == [False, True, False]


@pytest.mark.parametrize(
    ("known", "status", "base"),
    [
        (Known(), 4, 1 + 8 + 128),
        (Known(FlightStatus(1)), 3, 1 + 8),
        (Known(Battery(19)), 5, 1 + 8 + 128),
        (Known(Battery(20)), 4, 1 + 8 + 128),
        (Known(FlightStatus(1), Battery(5)), 3, 1 + 8),
        (Known().without(FlightStatus), 4, 1 + 8 + 128),
        (Known(FlightStatus(1)).flown(), 4, 1 + 8 + 128),
    ],
)
def test_the_heartbeat_is_armed_where_motors_may_turn(known: Known, status: int, base: int) -> None:
    found = heartbeat(world_of(known), Mode.OFFBOARD, 12)
    assert (found["type"], found["autopilot"], found["mavlink_version"]) == (2, 12, 3)
    assert found["custom_mode"] == 6 << 16
    assert (found["system_status"], found["base_mode"]) == (status, base)


# -- the tables have an answer for every pair, and the numbers are those of others -----------------


@pytest.mark.parametrize("phase", VehiclePhase)
def test_every_wish_has_an_answer_in_every_phase(phase: VehiclePhase) -> None:
    assert set(VERDICTS[phase]) == set(Mode)
    assert {phase} <= ARM_VERDICTS.keys() & DISARM_VERDICTS.keys()


@pytest.mark.parametrize("running", FlightSource)
def test_every_wish_knows_how_it_takes_over(running: FlightSource) -> None:
    assert set(RUNNING[running]) == set(Mode)


@pytest.mark.parametrize("mode", Mode)
def test_nothing_moves_an_aircraft_that_others_fly(mode: Mode) -> None:
    for phase in (VehiclePhase.AWAY, VehiclePhase.OTHER, VehiclePhase.PILOT):
        assert VERDICTS[phase][mode] is ModeVerdict.REJECT


@pytest.mark.parametrize("mode", sorted(set(Mode) - {Mode.HOLD, Mode.LAND, Mode.RTL}, key=str))
def test_only_a_hover_and_a_way_to_the_ground_end_a_landing(mode: Mode) -> None:
    assert (
        RUNNING[FlightSource.LAND][mode]
        is RUNNING[FlightSource.GO_HOME][mode]
        is ModeTransition.REFUSE
    )


@pytest.mark.parametrize("phase", [VehiclePhase.AIRBORNE, VehiclePhase.FREE, VehiclePhase.PILOT])
def test_nothing_disarms_in_the_air(phase: VehiclePhase) -> None:
    assert DISARM_VERDICTS[phase] is ModeVerdict.DENY


def test_no_two_modes_have_one_number() -> None:
    assert len({row.number for row in MODES.values()}) == len(MODES)
    assert MODES[Mode.RTL].number == 4 << 16 | 5 << 24


PREFIXES: dict[type[enum.IntEnum] | type[enum.IntFlag], str] = {
    numbers.MavResult: "MAV_RESULT_{}",
    numbers.ParamError: "MAV_PARAM_ERROR_{}",
    numbers.Severity: "MAV_SEVERITY_{}",
    numbers.SystemStatus: "MAV_STATE_{}",
    numbers.BaseMode: "MAV_MODE_FLAG_{}",
    numbers.LandedState: "MAV_LANDED_STATE_{}",
    numbers.Sensor: "MAV_SYS_STATUS_{}",
    numbers.Estimator: "ESTIMATOR_{}",
    numbers.Capability: "MAV_PROTOCOL_CAPABILITY_{}",
    numbers.CameraCap: "CAMERA_CAP_FLAGS_{}",
    numbers.GimbalCap: "GIMBAL_MANAGER_CAP_FLAGS_{}",
    numbers.GimbalFlag: "GIMBAL_MANAGER_FLAGS_{}",
    numbers.MavFrame: "MAV_FRAME_{}",
    numbers.MissionType: "MAV_MISSION_TYPE_{}",
    numbers.MissionResult: "MAV_MISSION_{}",
    numbers.MavCommand: "MAV_CMD_{}",
}
SHORTER = {
    "BaseMode.CUSTOM": "CUSTOM_MODE_ENABLED",
    "BaseMode.AUTO": "AUTO_ENABLED",
    "BaseMode.GUIDED": "GUIDED_ENABLED",
    "BaseMode.MANUAL": "MANUAL_INPUT_ENABLED",
    "BaseMode.ARMED": "SAFETY_ARMED",
    "Sensor.GYRO": "SENSOR_3D_GYRO",
    "Sensor.ACCELEROMETER": "SENSOR_3D_ACCEL",
    "Sensor.MAGNETOMETER": "SENSOR_3D_MAG",
    "Sensor.GPS": "SENSOR_GPS",
    "Sensor.RC": "SENSOR_RC_RECEIVER",
    "Sensor.PREARM": "PREARM_CHECK",
}
"""Members whose name is not the rest of theirs."""


def test_numbers_are_those_of_the_definitions() -> None:
    common: Any = pytest.importorskip("pymavlink.dialects.v20.all")
    own = {
        one for one in vars(numbers).values() if getattr(one, "__module__", "") == numbers.__name__
    }
    assert own | {numbers.MavCommand} == set(PREFIXES)  # the commands are those of missions
    for kind, prefix in PREFIXES.items():
        # A flag of two bits is not iterated over.
        for name, one in kind.__members__.items():
            theirs = SHORTER.get(f"{kind.__name__}.{name}", name)
            assert getattr(common, prefix.format(theirs)) == one.value, one
