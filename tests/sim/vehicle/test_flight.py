"""Movement commands (document 2.2.2.3 and 3.2): 14 modes, two frames, ranges, silence."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from m100link.geodesy import dji_offset
from m100link.protocol import (
    ControlMode,
    Device,
    Horizontal,
    Move,
    Position,
    ReferenceFrame,
    RequestAuthority,
    Setpoint,
    Vertical,
    Yaw,
)
from m100link.protocol.records import RcMode
from m100link.sim import Airframe
from m100link.sim.vehicle.dynamics import GRAVITY, STEP_S
from m100link.sim.vehicle.flight import Maneuver
from tests.sim.host import Host, aircraft

VECTORS = json.loads((Path(__file__).parents[2] / "vectors" / "movement.json").read_text())
MODES = [
    ControlMode(horizontal, vertical, yaw)
    for vertical in Vertical
    for horizontal in Horizontal
    for yaw in Yaw
    if ControlMode(horizontal, vertical, yaw).is_legal
]
NORTH = Setpoint.velocity(north=3, east=0, up=0, yaw_rate_deg_s=0)


def airborne(heading_deg: float = 0.0, firmware: str = "3.1", height: float = 30.0) -> Host:
    """In the air with authority, at a heading."""
    host = Host(firmware=firmware).flying()
    host.motion.place(0.0, 0.0, height, heading_deg)
    return host


# --- the 14 modes ---------------------------------------------------------------------------


def horizontal_values(mode: ControlMode) -> tuple[float, float]:
    return (4.0, -6.0) if mode.horizontal is not Horizontal.VELOCITY else (2.0, -1.5)


@pytest.mark.parametrize("frame", ReferenceFrame)
@pytest.mark.parametrize("heading", [0.0, 120.0])
@pytest.mark.parametrize("mode", MODES, ids=lambda mode: f"mode{mode.number}")
def test_each_mode_does_what_its_three_parts_say(
    mode: ControlMode, heading: float, frame: ReferenceFrame
) -> None:
    host = airborne(heading)
    x, y = horizontal_values(mode)
    z = {Vertical.VELOCITY: 1.0, Vertical.HEIGHT: 36.0, Vertical.THRUST: 50.0}[mode.vertical]
    yaw = 20.0 if mode.yaw is Yaw.RATE else heading
    if mode.yaw is Yaw.RATE:
        yaw = 0.0
    setpoint = Setpoint(mode, x, y, z, yaw, frame)
    data = setpoint.to_move(host.profile)
    if mode.horizontal is Horizontal.POSITION_OFFSET:
        # An offset is meant from the present place: sent once, held while the aircraft flies it.
        host.vehicle.flight.move(setpoint)
        host.wait(0.2)  # its dead time has passed
        host.vehicle.flight._setpoint_until = math.inf
        host.wait(6.0)
    else:
        for _ in range(300):
            host.send(data.encode(host.profile), session=0, cipher=host.cipher)
            host.wait(0.02)
    check_horizontal(host, mode, (x, y), heading if frame is ReferenceFrame.BODY else 0.0)
    if mode.vertical is Vertical.VELOCITY:
        assert host.motion.velocity_up == pytest.approx(1.0, abs=0.02)
    elif mode.vertical is Vertical.HEIGHT:
        assert host.motion.height == pytest.approx(36.0, abs=0.1)
    else:
        assert host.motion.velocity_up > 0.5
    assert math.degrees(host.motion.yaw) == pytest.approx(heading, abs=0.5)


def check_horizontal(
    host: Host, mode: ControlMode, values: tuple[float, float], turn_deg: float
) -> None:
    motion, (x, y) = host.motion, values
    turn = math.radians(turn_deg)
    if mode.horizontal is Horizontal.TILT:
        heading = motion.yaw - turn
        roll, pitch = math.radians(x), math.radians(y)
        assert motion.roll == pytest.approx(
            roll * math.cos(heading) + pitch * math.sin(heading), abs=0.002
        )
        assert motion.pitch == pytest.approx(
            pitch * math.cos(heading) - roll * math.sin(heading), abs=0.002
        )
        return
    north = x * math.cos(turn) - y * math.sin(turn)
    east = x * math.sin(turn) + y * math.cos(turn)
    if mode.horizontal is Horizontal.VELOCITY:
        assert (motion.velocity_north, motion.velocity_east) == pytest.approx(
            (north, east), abs=0.02
        )
    else:
        assert (motion.north, motion.east) == pytest.approx((north, east), abs=0.15)


@pytest.mark.parametrize(("rate", "turned"), [(30.0, 90.0), (-30.0, -90.0)])
def test_positive_yaw_rate_turns_right(rate: float, turned: float) -> None:
    host = airborne()
    host.fly(Setpoint.velocity(north=0, east=0, up=0, yaw_rate_deg_s=rate), 3.0)
    lag = (0.12 + 0.10) * rate  # its lag, and its dead time
    assert math.degrees(host.motion.yaw) == pytest.approx(turned - lag, abs=1.0)


@pytest.mark.parametrize("target", [-180.0, -90.0, 0.0, 45.0, 180.0])
def test_yaw_angle_is_measured_from_north_whatever_the_frame(target: float) -> None:
    host = airborne(heading_deg=70.0)
    host.fly(Setpoint.velocity(forward=1, right=0, up=0, yaw_deg=target), 8.0)
    error = math.remainder(math.degrees(host.motion.yaw) - target, 360.0)
    assert error == pytest.approx(0.0, abs=0.5)


def test_accuracy_of_half_a_degree_and_0_2_m_s() -> None:
    host = airborne()
    host.fly(Setpoint.velocity(north=7, east=-5, up=1, yaw_rate_deg_s=0), 8.0)
    assert host.motion.velocity_north == pytest.approx(7, abs=0.2)
    assert host.motion.velocity_east == pytest.approx(-5, abs=0.2)
    host.fly(Setpoint.tilt(roll_deg=8, pitch_deg=-3, up=0, yaw_rate_deg_s=0), 2.0)
    assert math.degrees(host.motion.roll) == pytest.approx(8, abs=0.5)
    assert math.degrees(host.motion.pitch) == pytest.approx(-3, abs=0.5)


@pytest.mark.parametrize("heading", [0.0, 90.0, -45.0])
def test_tilt_in_1_0_is_always_in_the_body_frame(heading: float) -> None:
    """A negative pitch flies along the nose although the flag says ground frame."""
    host = airborne(heading, firmware="1.0")
    move = Move(0x08, 0.0, -8.0, 0.0, 0.0)
    for _ in range(100):
        host.send(move.encode(host.profile), session=0)
        host.wait(0.02)
    track = math.degrees(math.atan2(host.motion.velocity_east, host.motion.velocity_north))
    assert track == pytest.approx(heading, abs=1.0)


# --- dead time ------------------------------------------------------------------------------


def test_a_command_takes_effect_after_the_dead_time_of_the_airframe() -> None:
    """0.10 s on firmware 3.1, to the step; none in the document's airframe."""
    for firmware, dead_steps in (("3.1", 10), ("2.3", 0)):
        host = airborne(firmware=firmware)
        steps = 0
        while host.motion.roll == pytest.approx(0.0, abs=1e-9):
            move = Move(0x0A, 10.0, 0.0, 0.0, 0.0)
            host.send(move.encode(host.profile), session=0)
            host.wait(STEP_S)
            steps += 1
        assert steps == dead_steps + 1, firmware


def test_a_command_counts_for_its_time_after_the_dead_time_and_then_it_hovers() -> None:
    host = airborne()
    began = host.now
    move = Move(0x4A, 5.0, 0.0, 0.0, 0.0)
    host.send(move.encode(host.profile), session=0)
    host.wait(0.5)
    assert host.vehicle.flight.timeouts == 0
    before = host.motion.velocity_north
    host.wait(0.09)
    assert host.motion.velocity_north > before, "still in effect at 0.59 s"
    host.wait(0.03)
    assert host.now - began == pytest.approx(0.62)
    assert host.vehicle.flight.timeouts == 1
    assert host.vehicle.flight.setpoint is None


def test_commands_under_way_are_forgotten_when_control_passes_away() -> None:
    host = airborne()
    host.send(Move(0x0A, 20.0, 0.0, 0.0, 0.0).encode(host.profile), session=0)
    host.wait(0.05)
    host.aircraft.set_rc_mode(RcMode.P)
    host.wait(0.5)
    host.aircraft.set_rc_mode(RcMode.F)
    host.wait(0.1)
    host.send(Move(0x0A, 0.0, 0.0, 0.0, 0.0).encode(host.profile), session=0)
    for _ in range(40):
        host.wait(STEP_S)
        assert abs(host.motion.roll) < 1e-6, "the old tilt came back"


# --- ranges ---------------------------------------------------------------------------------


# Firmware, command, and what the airframe flies: document 3.2, and what owners of 3.1 saw.
BEYOND = [
    *[
        (firmware, move, read, limit)
        for firmware in ("1.0", "2.3", "3.1")
        for move, read, limit in (
            (Move(0x48, 0.0, 0.0, 50.0, 0.0), "velocity_up", 4.0),
            (Move(0x48, 0.0, 0.0, -50.0, 0.0), "velocity_up", -4.0),
            (Move(0x48, 0.0, 0.0, 0.0, 500.0), "rate_z", math.radians(100)),
        )
    ],
    *[
        (firmware, move, read, sign * limit)
        for firmware, speed, tilt in (("1.0", 10.0, 30.0), ("2.3", 10.0, 30.0), ("3.1", 14.0, 35.5))
        for move, read, sign, limit in (
            (Move(0x48, 50.0, 0.0, 0.0, 0.0), "velocity_north", 1, speed),
            (Move(0x48, 0.0, -50.0, 0.0, 0.0), "velocity_east", -1, speed),
            (Move(0x0A, 80.0, 0.0, 0.0, 0.0), "roll", 1, math.radians(tilt)),
            (Move(0x0A, 0.0, -80.0, 0.0, 0.0), "pitch", -1, math.radians(tilt)),
        )
    ],
]


@pytest.mark.parametrize(("firmware", "move", "read", "limit"), BEYOND)
def test_values_beyond_the_range_are_flown_as_far_as_the_airframe_can(
    firmware: str, move: Move, read: str, limit: float
) -> None:
    host = airborne(height=60.0, firmware=firmware)
    for _ in range(300):
        host.send(move.encode(host.profile), session=0)
        host.wait(0.02)
    assert getattr(host.motion, read) == pytest.approx(limit, rel=0.01)


@pytest.mark.parametrize(
    ("asked", "flown"), [(270.0, 180.0), (-270.0, -180.0), (179.0, 179.0), (-179.0, -179.0)]
)
def test_a_heading_beyond_180_degrees_is_180_degrees(asked: float, flown: float) -> None:
    """Document 3.2: -180 to 180, clockwise from north; beyond it nothing wraps to the west."""
    host = airborne(heading_deg=math.copysign(100.0, asked))
    for _ in range(300):
        host.send(Move(0x40, 0.0, 0.0, 0.0, asked).encode(host.profile), session=0)
        host.wait(0.02)
    error = math.remainder(math.degrees(host.motion.yaw) - flown, 360.0)
    assert error == pytest.approx(0.0, abs=0.3)


def test_a_height_below_the_ground_is_the_ground() -> None:
    """It slows down before the ground, and does not come at 4 m/s."""
    speeds = []
    for height in (0.0, -50.0):
        host = airborne(height=5.0)
        while not host.motion.on_ground:
            host.send(Move(0x58, 0.0, 0.0, height, 0.0).encode(host.profile), session=0)
            host.wait(0.02)
        speeds.append(host.motion.touchdown_speed)
    assert speeds[1] == speeds[0] < 1.5


def test_height_goes_to_the_height_limit_and_not_beyond() -> None:
    host = airborne(height=100.0)
    host.fly(Setpoint.velocity(north=0, east=0, height=500.0, yaw_rate_deg_s=0), 15.0)
    assert host.motion.height == pytest.approx(120.0, abs=0.1)
    host.fly(Setpoint.velocity(north=0, east=0, up=4.0, yaw_rate_deg_s=0), 5.0)
    assert host.motion.height == pytest.approx(120.0, abs=0.5)


@pytest.mark.parametrize(
    "flag",
    [
        pytest.param(0xC8, id="horizontal 11"),
        pytest.param(0x78, id="vertical 11"),
        pytest.param(0x4C, id="reserved bit 2"),
        pytest.param(0x68, id="thrust with velocity"),
        pytest.param(0xA8, id="thrust with position"),
    ],
)
def test_illegal_flags_are_ignored(flag: int) -> None:
    host = airborne()
    host.send(Move(flag, 5.0, 5.0, 1.0, 0.0).encode(host.profile), session=0)
    host.wait(0.4)
    assert host.motion.speed < 0.01
    assert host.autopilot.counters.ignored_movements == 1


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", range(4))
def test_values_that_are_no_numbers_are_ignored(value: float, place: int) -> None:
    host = airborne()
    values = [1.0] * 4
    values[place] = value
    host.send(Move(0x48, *values).encode(host.profile), session=0)
    host.wait(0.4)
    assert host.motion.speed < 0.01
    assert math.isfinite(host.motion.height)


@pytest.mark.parametrize("size", [0, 1, 16, 18, 34])
def test_movement_of_another_length_is_ignored(size: int) -> None:
    host = airborne()
    host.send(b"\x01\x03" + b"\x48" * size, session=0)
    assert host.autopilot.counters.ignored_movements == 1


def test_minimum_thrust_can_be_set() -> None:
    host = Host(aircraft(firmware="3.1", settings={"minimum_thrust": 10.0})).flying()
    host.motion.place(0, 0, 100)
    host.fly(Setpoint.tilt(roll_deg=0, pitch_deg=0, thrust_percent=0, yaw_rate_deg_s=0), 0.5)
    assert host.motion.thrust == 10.0


# --- wire order -----------------------------------------------------------------------------


@pytest.mark.parametrize("index", range(len(VECTORS)))
@pytest.mark.parametrize("order", ["value", "value_in_document_order"])
def test_golden_vectors_move_as_they_should(index: int, order: str) -> None:
    """Throttle before yaw everywhere but in the profile named after the document."""
    vector = VECTORS[index]
    firmware = "1.0-document" if order == "value_in_document_order" else "1.0"
    host = Host(firmware=firmware).flying()
    host.send(b"\x01\x03" + bytes.fromhex(vector[order]), session=0)
    move = host.autopilot.received_movements[-1]
    fields = vector.get("fields", vector)
    assert move.throttle_or_z == pytest.approx(fields["throttle_or_z"], rel=1e-6)
    assert move.yaw == pytest.approx(fields["yaw"], rel=1e-6)


def test_a_climb_is_no_turn() -> None:
    host = airborne(firmware="1.0")
    host.send(bytes.fromhex("010348" + "00000000" * 2 + "0000803f" + "00000000"), session=0)
    host.wait(0.4)
    assert host.motion.velocity_up > 0.5
    assert host.motion.yaw == 0.0


# --- no answer, no authority, on the ground -------------------------------------------------


@pytest.mark.parametrize("session", [0, 1, 2, 31])
@pytest.mark.parametrize("state", ["not activated", "no authority", "flying"])
def test_movement_is_never_acknowledged(session: int, state: str) -> None:
    host = Host()
    if state != "not activated":
        host.activate()
    if state == "flying":
        host.obtain()
        host.take_off()
    data = NORTH.to_move(host.profile).encode(host.profile)
    assert host.ask_raw(data, encrypted=False, session=session) is None


@pytest.mark.parametrize("encrypted", [False, True])
def test_movement_is_taken_plain_and_encrypted(encrypted: bool) -> None:
    host = airborne(firmware="1.0")
    data = NORTH.to_move(host.profile).encode(host.profile)
    host.send(data, session=0, cipher=host.cipher if encrypted else None)
    host.wait(0.3)
    assert host.motion.velocity_north > 0.3


def test_plain_movement_can_be_refused() -> None:
    host = Host(aircraft(settings={"encrypted_control_only": True})).flying()
    data = NORTH.to_move(host.profile).encode(host.profile)
    host.send(data, session=0)
    host.wait(0.3)
    assert host.motion.speed < 0.01
    assert host.ask(RequestAuthority(True), encrypted=False) == 0xFF00


def test_without_authority_movement_does_nothing() -> None:
    host = airborne()
    for _ in range(2):
        host.ask(RequestAuthority(False))
    host.fly(NORTH, 2.0)
    assert host.motion.speed < 0.05
    assert host.autopilot.counters.ignored_movements == 100


def test_on_the_ground_with_motors_off_movement_does_nothing() -> None:
    host = Host().ready()
    host.fly(Setpoint.velocity(north=3, east=0, up=2, yaw_rate_deg_s=0), 3.0)
    assert (host.motion.north, host.motion.height) == (0.0, 0.0)
    assert not host.motion.motors_on


# --- rate and silence -----------------------------------------------------------------------


def test_at_the_recommended_50_hz_the_flight_is_smooth() -> None:
    host = airborne()
    host.fly(NORTH, 5.0, rate_hz=50)
    assert host.vehicle.flight.timeouts == 0
    assert host.motion.velocity_north == pytest.approx(3.0, abs=0.05)


def test_when_commands_stop_the_aircraft_brakes_and_hovers() -> None:
    host = airborne()
    host.fly(NORTH, 5.0)
    host.wait(0.45)
    assert host.motion.velocity_north == pytest.approx(3.0, abs=0.05), "not yet"
    host.wait(5.0)
    place = host.motion.north
    host.wait(10.0)
    assert host.motion.north == pytest.approx(place, abs=0.05)
    assert host.vehicle.flight.timeouts == 1
    assert host.device() is Device.ONBOARD


@pytest.mark.parametrize("timeout", [0.1, 0.5, 2.0])
def test_the_silence_until_hovering_is_adjustable(timeout: float) -> None:
    host = Host(aircraft(settings={"movement_timeout": timeout})).flying()
    host.move(NORTH)
    host.wait(timeout - 0.02)
    assert host.vehicle.flight.timeouts == 0
    host.wait(0.05)
    assert host.vehicle.flight.timeouts == 1


def test_at_2_hz_the_aircraft_keeps_starting_and_stopping() -> None:
    host = airborne()
    for _ in range(6):
        host.move(NORTH)
        host.wait(0.6)
    host.wait(0.1)  # the last one had its dead time, too
    assert host.vehicle.flight.timeouts == 6


def test_silence_in_thrust_control_hovers_too() -> None:
    host = airborne()
    host.fly(Setpoint.tilt(roll_deg=5, pitch_deg=0, thrust_percent=60, yaw_rate_deg_s=0), 1.0)
    host.wait(6.0)
    assert abs(host.motion.velocity_up) < 0.05
    assert host.motion.speed < 0.05


def test_all_zeros_in_velocity_control_brakes_and_holds() -> None:
    host = airborne()
    host.fly(NORTH, 4.0)
    host.fly(Setpoint.velocity(north=0, east=0, up=0, yaw_rate_deg_s=0), 6.0)
    assert host.motion.speed < 0.02


@pytest.mark.parametrize("mode", ["tilt", "velocity", "position"])
def test_letting_go_means_staying_where_it_stops(mode: str) -> None:
    host = airborne()
    host.wait(3.0)  # hovers: there is a place that it holds
    setpoint = {
        "tilt": Setpoint.tilt(roll_deg=0, pitch_deg=-10, up=0, yaw_rate_deg_s=0),
        "velocity": NORTH,
        "position": Setpoint.position_offset(north=10, east=0, up=0, yaw_rate_deg_s=0),
    }[mode]
    host.fly(setpoint, 4.0)
    gone = host.motion.north
    assert gone > 5.0
    host.wait(15.0)
    assert gone < host.motion.north < gone + 12.0, "it comes to a stop ahead, not behind"
    assert host.motion.speed < 0.02


@pytest.mark.parametrize("stable", [False, True])
def test_stable_mode_brakes_smoothly_and_holds(stable: bool) -> None:
    host = airborne()
    host.fly(Setpoint.velocity(north=8, east=0, up=0, yaw_rate_deg_s=0), 8.0)
    stop = Setpoint.velocity(north=0, east=0, up=0, yaw_rate_deg_s=0, stable=stable)
    hardest = 0.0
    for _ in range(500):
        host.fly(stop, 0.02)
        hardest = max(hardest, -host.motion.acceleration_north)
    assert host.motion.speed < 0.02
    place = host.motion.north
    host.motion.north += 2.0  # something pushes it
    host.fly(stop, 10.0)
    if stable:
        assert 2.0 < hardest < 3.0
        assert host.motion.north == pytest.approx(place, abs=0.05)
    else:
        assert hardest > 4.0
        assert host.motion.north == pytest.approx(place + 2.0, abs=0.05)


def test_stable_mode_changes_nothing_while_there_is_a_velocity() -> None:
    def place(stable: bool) -> float:
        host = airborne()
        host.fly(Setpoint.velocity(north=3, east=0, up=0, yaw_rate_deg_s=0, stable=stable), 5.0)
        north: float = host.motion.north
        return north

    assert place(stable=True) == place(stable=False)


# --- GPS ------------------------------------------------------------------------------------


@pytest.mark.parametrize("health", range(6))
@pytest.mark.parametrize("kind", ["velocity", "position", "tilt"])
def test_gps_health_below_3_ignores_velocity_and_position(health: int, kind: str) -> None:
    host = airborne()
    host.aircraft.gps_health = health
    setpoint = {
        "velocity": NORTH,
        "position": Setpoint.position_offset(north=5, east=0, up=0, yaw_rate_deg_s=0),
        "tilt": Setpoint.tilt(roll_deg=0, pitch_deg=-5, up=0, yaw_rate_deg_s=0),
    }[kind]
    host.fly(setpoint, 2.0)
    assert (host.motion.north > 0.5) == (health >= 3 or kind == "tilt")


def test_without_gps_it_drifts_with_the_wind() -> None:
    host = airborne()
    host.aircraft.set_wind(0.0, 3.0)
    host.wait(10.0)
    assert host.motion.speed < 0.05, "position hold"
    host.aircraft.gps_health = 0
    host.wait(40.0)
    assert host.motion.velocity_east == pytest.approx(3.0, abs=0.1)


# --- position -------------------------------------------------------------------------------


def test_position_values_are_offsets_from_the_place_at_the_time_of_the_command() -> None:
    """The same offset sent again and again never arrives: it keeps flying."""
    host = airborne()
    host.fly(Setpoint.position_offset(north=2, east=0, up=0, yaw_rate_deg_s=0), 20.0)
    assert host.motion.north > 20.0


def test_position_loop_of_djis_samples_arrives() -> None:
    """Target minus present place from GPS, flat Earth, flag 0x90, 50 Hz."""
    host = Host(firmware="3.1").flying()
    site = host.packets()[-1].position
    assert isinstance(site, Position)
    target = site.latitude_deg + 2e-4, site.longitude_deg - 1e-4
    for _ in range(50 * 30):
        here = next(p.position for p in reversed(host.packets(host.now - 0.1)) if p.position)
        north, east = dji_offset(here.latitude_deg, here.longitude_deg, *target)
        host.send(Move(0x90, north, east, 8.0, 0.0).encode(host.profile), session=0)
        host.wait(0.02)
    assert math.hypot(*dji_offset(here.latitude_deg, here.longitude_deg, *target)) < 0.1
    assert host.motion.height == pytest.approx(8.0, abs=0.1)


def test_position_control_flies_at_its_own_speed() -> None:
    host = airborne()
    host.fly(Setpoint.position_offset(north=1000, east=0, up=0, yaw_rate_deg_s=0), 10.0)
    assert host.motion.velocity_north == pytest.approx(Airframe().position_speed, abs=0.05)


def test_tilt_of_ten_degrees_accelerates_by_g_tan_ten() -> None:
    host = airborne(firmware="1.0")
    host.fly(Setpoint.tilt(roll_deg=10, pitch_deg=0, up=0, yaw_rate_deg_s=0), 0.8)
    packet = next(p for p in reversed(host.packets()) if p.acceleration and p.velocity)
    assert packet.acceleration is not None
    assert packet.velocity is not None
    drag = Airframe().drag * packet.velocity.east_m_s
    assert packet.acceleration.east_m_s2 + drag == pytest.approx(
        GRAVITY * math.tan(math.radians(10)), rel=0.02
    )


def test_an_offset_along_the_nose_is_a_place_on_the_ground() -> None:
    flight = airborne(heading_deg=30.0).vehicle.flight
    motion = flight.dynamics
    motion.north, motion.east = 100.0, -50.0
    forward = Setpoint.position_offset(forward=3.0, right=-2.0, up=0.0, yaw_rate_deg_s=0.0)
    guidance = flight._guidance_for(forward)
    cosine, sine = math.cos(motion.yaw), math.sin(motion.yaw)
    there = (100.0 + 3.0 * cosine + 2.0 * sine, -50.0 + 3.0 * sine - 2.0 * cosine)
    assert (guidance.a, guidance.b) == pytest.approx(there)


@pytest.mark.parametrize(("metres", "speed"), [(50.0, 8.0), (10.0, 6.0)])
def test_it_flies_home_at_8_m_s_and_slower_near_it(metres: float, speed: float) -> None:
    """On a bearing of -53.13 degrees, once it is as high as 0.3 m below the go-home height."""
    flight = airborne(height=19.65).vehicle.flight
    motion = flight.dynamics
    motion.north, motion.east, flight.home = 7.0, 9.0, (7.0 + 0.6 * metres, 9.0 - 0.8 * metres)
    assert flight.distance_home == pytest.approx(metres)
    flight._begin(Maneuver.CLIMB_HOME)
    for height, then in ((19.65, Maneuver.CLIMB_HOME), (19.75, Maneuver.FLY_HOME)):
        motion.height = height
        guidance = flight._homewards()
        assert (guidance.a, guidance.b, guidance.up) == pytest.approx((0.0, 0.0, 20.0))
        assert flight.maneuver is then
    guidance = flight._homewards()
    assert (guidance.a, guidance.b) == pytest.approx((0.6 * speed, -0.8 * speed))
    assert math.degrees(guidance.yaw) == pytest.approx(-53.130, abs=0.001)


def test_control_that_comes_back_finds_no_setpoint_of_before() -> None:
    program = airborne()
    flight, remote = program.vehicle.flight, program.vehicle.remote
    assert flight.move(NORTH)
    flight.now += 0.2
    assert flight._orders(Device.ONBOARD, remote).a == 3.0
    flight.interrupt()
    assert flight._orders(Device.ONBOARD, remote) is flight._hover
    unused = Host(firmware="3.1").vehicle.flight
    unused.gps_health = 0
    assert unused._orders(Device.ONBOARD, remote) is unused._level
