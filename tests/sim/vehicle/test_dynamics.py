"""The flight model against closed forms, and its parts against each other."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from m100link.errors import UsageError
from m100link.protocol import Attitude
from m100link.protocol.records import Device
from m100link.sim import AircraftSettings, PilotRemote, VirtualAircraft, read_airframe
from m100link.sim.vehicle.dynamics import (
    GRAVITY,
    STEP_S,
    Airframe,
    Dynamics,
    DynamicsInput,
    ModelHorizontal,
    ModelVertical,
    ModelYaw,
)

STILL = Airframe(drag=0.0)


def hovering(airframe: Airframe | None = None, *, yaw_deg: float = 0.0) -> Dynamics:
    motion = Dynamics(airframe)
    motion.place(0.0, 0.0, 50.0, yaw_deg)
    return motion


def run(motion: Dynamics, guidance: DynamicsInput, seconds: float) -> None:
    for _ in range(round(seconds / STEP_S)):
        motion.step(guidance)


# --- step responses -------------------------------------------------------------------------


@pytest.mark.parametrize("axis", ["roll", "pitch"])
@pytest.mark.parametrize("seconds", [0.05, 0.1, 0.2, 0.5, 1.0])
def test_tilt_responds_as_a_critically_damped_second_order_system(
    axis: str, seconds: float
) -> None:
    motion, wanted, w = hovering(), math.radians(10), Airframe().tilt_frequency
    a, b = (wanted, 0.0) if axis == "roll" else (0.0, wanted)
    run(motion, DynamicsInput(ModelHorizontal.TILT, a, b), seconds)
    closed_form = wanted * (1 - (1 + w * seconds) * math.exp(-w * seconds))
    assert getattr(motion, axis) == pytest.approx(closed_form, rel=1e-9)


@pytest.mark.parametrize("damping", [0.3, 0.85, 1.7])
@pytest.mark.parametrize("seconds", [0.05, 0.2, 0.5, 1.0])
def test_tilt_responds_with_the_damping_of_the_airframe(seconds: float, damping: float) -> None:
    w, wanted = 11.9, math.radians(10)
    motion = hovering(Airframe(tilt_frequency=w, tilt_damping=damping))
    run(motion, DynamicsInput(ModelHorizontal.TILT, wanted, 0.0), seconds)
    if damping < 1.0:
        swing = w * math.sqrt(1.0 - damping**2)
        lag = damping * w / swing * math.sin(swing * seconds) + math.cos(swing * seconds)
        left = math.exp(-damping * w * seconds) * lag
    else:
        slow, fast = (w * (damping + sign * math.sqrt(damping**2 - 1.0)) for sign in (-1, 1))
        left = (fast * math.exp(-slow * seconds) - slow * math.exp(-fast * seconds)) / (fast - slow)
    assert motion.roll == pytest.approx(wanted * (1.0 - left), rel=1e-9)


def test_lift_grows_with_a_power_of_thrust() -> None:
    """At twice the hover thrust and an exponent of 0.68: 2^0.68 = 1.602 times the weight."""
    motion = hovering(Airframe(hover_thrust=38.2, thrust_exponent=0.68, vertical_drag=0.0))
    run(motion, DynamicsInput(vertical=ModelVertical.THRUST, up=76.4), 1.0)
    assert motion.velocity_up == pytest.approx(0.602 * GRAVITY, rel=1e-3)
    motion.hover_thrust = 76.4  # by its battery
    run(motion, DynamicsInput(vertical=ModelVertical.THRUST, up=76.4), 1.0)
    assert motion.acceleration_up == pytest.approx(0.0, abs=1e-9)


def test_the_thrust_of_velocity_control_is_the_one_that_flies_alike() -> None:
    """The two ways of steering agree about lift: one accelerates, the other sets thrust."""
    airframe = Airframe(hover_thrust=38.2, thrust_exponent=0.68, vertical_drag=0.0)
    one, two = hovering(airframe), hovering(airframe)
    for _ in range(100):
        one.step(DynamicsInput(vertical=ModelVertical.VELOCITY, up=3.0))
        two.step(DynamicsInput(vertical=ModelVertical.THRUST, up=one.thrust))
    assert two.velocity_up == pytest.approx(one.velocity_up, abs=1e-9)


@pytest.mark.parametrize("seconds", [0.1, 0.35, 1.0])
def test_climb_rate_responds_as_a_first_order_lag(seconds: float) -> None:
    motion, lag = hovering(), Airframe().vertical_time_constant
    run(motion, DynamicsInput(vertical=ModelVertical.VELOCITY, up=1.5), seconds)
    assert motion.velocity_up == pytest.approx(1.5 * (1 - math.exp(-seconds / lag)), rel=1e-9)


@pytest.mark.parametrize("seconds", [0.1, 0.5, 2.0])
def test_yaw_rate_responds_as_a_first_order_lag(seconds: float) -> None:
    motion, lag, rate = hovering(), Airframe().yaw_time_constant, math.radians(60)
    run(motion, DynamicsInput(yaw_mode=ModelYaw.RATE, yaw=rate), seconds)
    angle = rate * (seconds - lag * (1 - math.exp(-seconds / lag)))
    assert motion.yaw == pytest.approx(angle, rel=1e-9)


def test_velocity_at_constant_tilt_without_drag_grows_with_g_tan_tilt() -> None:
    motion = hovering(STILL)
    guidance = DynamicsInput(ModelHorizontal.TILT, 0.0, math.radians(-10))
    run(motion, guidance, 2.0)
    before = motion.velocity_north
    run(motion, guidance, 3.0)
    assert motion.velocity_north - before == pytest.approx(
        3.0 * GRAVITY * math.tan(math.radians(10)), rel=1e-6
    )


def test_velocity_at_constant_tilt_ends_where_drag_balances_it() -> None:
    motion = hovering()
    run(motion, DynamicsInput(ModelHorizontal.TILT, math.radians(5), 0.0), 30.0)
    assert motion.velocity_east == pytest.approx(
        GRAVITY * math.tan(math.radians(5)) / Airframe().drag, rel=1e-3
    )


def test_drag_slows_exponentially() -> None:
    motion = hovering()
    motion.velocity_north = 5.0
    run(motion, DynamicsInput(ModelHorizontal.TILT), 4.0)
    assert motion.velocity_north == pytest.approx(5.0 * math.exp(-4.0 * Airframe().drag), rel=0.01)


def test_velocity_control_takes_about_a_second_and_hardly_overshoots() -> None:
    motion = hovering()
    guidance = DynamicsInput(ModelHorizontal.VELOCITY, 4.0, 0.0)
    reached, highest = 0.0, 0.0
    for step in range(1, 600):
        motion.step(guidance)
        highest = max(highest, motion.velocity_north)
        if not reached and motion.velocity_north > 0.63 * 4.0:
            reached = step * STEP_S
    assert 0.5 < reached < 1.3
    assert highest < 4.0 * 1.03
    assert motion.velocity_north == pytest.approx(4.0, abs=0.02)


def test_position_control_arrives_and_stays() -> None:
    motion = hovering()
    guidance = DynamicsInput(ModelHorizontal.POSITION, 12.0, -7.0)
    run(motion, guidance, 20.0)
    assert (motion.north, motion.east) == pytest.approx((12.0, -7.0), abs=0.02)
    assert motion.speed < 0.02


def test_height_control_arrives_and_stays() -> None:
    motion = hovering()
    run(motion, DynamicsInput(vertical=ModelVertical.HEIGHT, up=60.0), 15.0)
    assert motion.height == pytest.approx(60.0, abs=0.01)
    assert abs(motion.velocity_up) < 0.01


@pytest.mark.parametrize(
    ("start", "target", "turn"), [(170, -170, 20), (-170, 170, -20), (0, 90, 90), (90, -45, -135)]
)
def test_yaw_angle_turns_the_short_way(start: float, target: float, turn: float) -> None:
    motion = hovering(yaw_deg=start)
    guidance = DynamicsInput(yaw_mode=ModelYaw.ANGLE, yaw=math.radians(target))
    turned, before = 0.0, motion.yaw
    for _ in range(1000):
        motion.step(guidance)
        turned += math.remainder(motion.yaw - before, 2 * math.pi)
        before = motion.yaw
    assert math.degrees(turned) == pytest.approx(turn, abs=0.1)


def test_braking_stops_and_holds_the_place() -> None:
    motion = hovering()
    run(motion, DynamicsInput(ModelHorizontal.VELOCITY, 8.0, 0.0), 5.0)
    run(motion, DynamicsInput(), 6.0)
    place = motion.north, motion.east
    run(motion, DynamicsInput(), 20.0)
    assert motion.speed < 0.01
    assert (motion.north, motion.east) == pytest.approx(place, abs=0.05)


def test_hovering_thrust_keeps_the_height_and_more_climbs() -> None:
    airframe = Airframe(vertical_drag=0.0)
    motion = hovering(airframe)
    thrust = airframe.hover_thrust
    run(motion, DynamicsInput(ModelHorizontal.TILT, vertical=ModelVertical.THRUST, up=thrust), 5.0)
    assert motion.height == pytest.approx(50.0)
    run(
        motion,
        DynamicsInput(ModelHorizontal.TILT, vertical=ModelVertical.THRUST, up=1.1 * thrust),
        2.0,
    )
    assert motion.velocity_up == pytest.approx(0.1 * GRAVITY * 2.0, rel=1e-9)
    assert motion.height == pytest.approx(50.0 + 0.5 * 0.1 * GRAVITY * 2.0**2, rel=1e-9)


# --- limits ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("guidance", "read", "limit"),
    [
        (DynamicsInput(ModelHorizontal.TILT, 1.5, 0.0), "roll", math.radians(30)),
        (DynamicsInput(ModelHorizontal.TILT, 0.0, -1.5), "pitch", -math.radians(30)),
        (DynamicsInput(up=9.0), "velocity_up", 4.0),
        (DynamicsInput(up=-9.0), "velocity_up", -4.0),
        (DynamicsInput(yaw_mode=ModelYaw.RATE, yaw=9.0), "rate_z", math.radians(100)),
    ],
)
def test_limits_of_the_document_are_kept(guidance: DynamicsInput, read: str, limit: float) -> None:
    motion = hovering()
    run(motion, guidance, 3.0)
    assert getattr(motion, read) == pytest.approx(limit, rel=1e-3)


def test_lift_and_thrust_of_a_tilted_aircraft() -> None:
    """Of the thrust, cos 20 x cos 30 = 0.8138 carries; vertical drag is 0.35 1/s."""
    motion = hovering()
    motion.roll, motion.pitch, motion.velocity_up = math.radians(20), math.radians(-30), 2.0
    lift = motion._lift(DynamicsInput(vertical=ModelVertical.THRUST, up=67.5))
    assert lift == pytest.approx(1.5 * 0.81380 * GRAVITY - 0.35 * 2.0, rel=1e-4)
    assert motion._lift(DynamicsInput(up=2.0)) == GRAVITY
    assert motion.thrust == pytest.approx(45.0 / 0.81380, rel=1e-4)


@pytest.mark.parametrize(("steep", "tilt"), [(False, 25.0), (True, 35.0)])
def test_a_mission_may_tilt_it_further_than_the_cruise(steep: bool, tilt: float) -> None:
    motion = hovering(STILL)
    run(motion, DynamicsInput(ModelHorizontal.VELOCITY, 60.0, 0.0, steep=steep), 1.0)
    assert math.degrees(motion.pitch) == pytest.approx(-tilt, abs=0.1)


def test_braking_aims_for_where_it_will_stand() -> None:
    motion = hovering()
    motion.velocity_north, motion.velocity_east = 0.16, -0.08
    motion.step(DynamicsInput())
    assert (motion._hold_north, motion._hold_east) == pytest.approx((0.1, -0.05))
    for velocity in ((0.1, 5.0), (5.0, 0.1)):
        fast = hovering()
        fast.velocity_north, fast.velocity_east = velocity
        fast.step(DynamicsInput())
        assert not fast._brake, "first it becomes slower"


def test_tilt_stays_below_the_cruise_tilt_in_velocity_control() -> None:
    motion = hovering()
    guidance = DynamicsInput(ModelHorizontal.VELOCITY, 10.0, 10.0)
    for _ in range(500):
        motion.step(guidance)
        tilt = math.acos(math.cos(motion.roll) * math.cos(motion.pitch))
        assert math.degrees(tilt) < Airframe().cruise_tilt_deg + 1.5


# --- signs, frames --------------------------------------------------------------------------


def test_forward_is_a_negative_pitch_and_right_a_positive_roll() -> None:
    motion = hovering(yaw_deg=0)
    run(motion, DynamicsInput(ModelHorizontal.VELOCITY, 3.0, 2.0, body=True), 0.5)
    assert motion.pitch < 0 < motion.roll
    assert motion.velocity_north > 0
    assert motion.velocity_east > 0


@pytest.mark.parametrize("yaw_deg", [0, 37, 90, 180, -135])
@pytest.mark.parametrize("horizontal", [ModelHorizontal.VELOCITY, ModelHorizontal.TILT])
def test_ground_frame_tracks_ignore_the_heading(
    yaw_deg: float, horizontal: ModelHorizontal
) -> None:
    motion, reference = hovering(yaw_deg=yaw_deg), hovering()
    a, b = (0.05, -0.1) if horizontal is ModelHorizontal.TILT else (3.0, 1.0)
    for each in (motion, reference):
        run(each, DynamicsInput(horizontal, a, b), 4.0)
    assert (motion.north, motion.east) == pytest.approx((reference.north, reference.east), abs=0.03)


@pytest.mark.parametrize("yaw_deg", [0, 37, 90, 180, -135])
@pytest.mark.parametrize("horizontal", [ModelHorizontal.VELOCITY, ModelHorizontal.TILT])
def test_body_frame_tracks_turn_with_the_heading(
    yaw_deg: float, horizontal: ModelHorizontal
) -> None:
    motion, reference = hovering(yaw_deg=yaw_deg), hovering()
    a, b = (0.05, -0.1) if horizontal is ModelHorizontal.TILT else (3.0, 1.0)
    for each in (motion, reference):
        run(each, DynamicsInput(horizontal, a, b, body=True), 4.0)
    yaw = math.radians(yaw_deg)
    assert (motion.north, motion.east) == pytest.approx(
        (
            reference.north * math.cos(yaw) - reference.east * math.sin(yaw),
            reference.north * math.sin(yaw) + reference.east * math.cos(yaw),
        ),
        abs=1e-6,
    )


def test_a_turning_body_frame_velocity_flies_a_circle() -> None:
    """At v and yaw rate w the radius is v / w; one turn ends where it began."""
    motion, rate = hovering(), math.radians(20)
    guidance = DynamicsInput(
        ModelHorizontal.VELOCITY, 3.0, 0.0, body=True, yaw_mode=ModelYaw.RATE, yaw=rate
    )
    run(motion, guidance, 10.0)
    start = motion.north, motion.east
    places = []
    for _ in range(1800):
        motion.step(guidance)
        places.append((motion.north, motion.east))
    assert (motion.north, motion.east) == pytest.approx(start, abs=0.05)
    across = max(north for north, _ in places) - min(north for north, _ in places)
    assert across / 2 == pytest.approx(motion.speed / rate, rel=0.01)


# --- consistency ----------------------------------------------------------------------------


def wild_flight() -> list[DynamicsInput]:
    return [
        DynamicsInput(ModelHorizontal.VELOCITY, 6.0, -4.0, up=2.0, yaw=0.8),
        DynamicsInput(ModelHorizontal.TILT, 0.3, -0.2, body=True, up=-1.0, yaw=-1.2),
        DynamicsInput(
            ModelHorizontal.POSITION, -20.0, 30.0, vertical=ModelVertical.HEIGHT, up=70.0
        ),
        DynamicsInput(),
        DynamicsInput(
            ModelHorizontal.TILT, -0.1, 0.4, vertical=ModelVertical.THRUST, up=60.0, yaw=1.0
        ),
    ]


def test_velocity_is_the_sum_of_acceleration_and_position_that_of_velocity() -> None:
    motion = hovering()
    motion.wind_north, motion.wind_east = 3.0, -2.0
    for guidance in wild_flight():
        for _ in range(200):
            before = [getattr(motion, f"velocity_{axis}") for axis in ("north", "east", "up")]
            place = [motion.north, motion.east, motion.height]
            motion.step(guidance)
            after = [getattr(motion, f"velocity_{axis}") for axis in ("north", "east", "up")]
            for index, axis in enumerate(("north", "east", "up")):
                acceleration = getattr(motion, f"acceleration_{axis}")
                assert after[index] - before[index] == pytest.approx(
                    acceleration * STEP_S, abs=1e-12
                )
                moved = (motion.north, motion.east, motion.height)[index] - place[index]
                assert moved == pytest.approx(
                    (before[index] + after[index]) / 2 * STEP_S, abs=1e-12
                )


def test_thrust_along_the_body_axis_makes_the_acceleration() -> None:
    """Thrust rotated by the quaternion gives what the velocities show, less gravity and drag."""
    motion = hovering()
    for guidance in wild_flight():
        for _ in range(150):
            velocity = motion.velocity_north, motion.velocity_east
            motion.step(guidance)
            q0, q1, q2, q3 = motion.quaternion()
            down = 2 * (q1 * q3 + q0 * q2), 2 * (q2 * q3 - q0 * q1), q0**2 - q1**2 - q2**2 + q3**2
            drag = Airframe().drag
            lift = motion.acceleration_up + GRAVITY
            thrust = lift / down[2]
            assert motion.acceleration_north == pytest.approx(
                -thrust * down[0] - drag * velocity[0], abs=1e-9
            )
            assert motion.acceleration_east == pytest.approx(
                -thrust * down[1] - drag * velocity[1], abs=1e-9
            )


def test_quaternion_and_angles_say_the_same() -> None:
    """Read back by the formulas that DJI's later libraries use."""
    motion = hovering()
    for guidance in wild_flight():
        for _ in range(150):
            motion.step(guidance)
            attitude = Attitude(*motion.quaternion())
            assert sum(value * value for value in attitude) == pytest.approx(1.0)
            assert attitude.roll_deg == pytest.approx(math.degrees(motion.roll), abs=1e-9)
            assert attitude.pitch_deg == pytest.approx(math.degrees(motion.pitch), abs=1e-9)
            assert attitude.yaw_deg == pytest.approx(math.degrees(motion.yaw), abs=1e-9)


def test_quaternion_of_level_flight_to_north_and_east() -> None:
    assert hovering(yaw_deg=0).quaternion() == pytest.approx((1, 0, 0, 0))
    half = math.sqrt(0.5)
    assert hovering(yaw_deg=90).quaternion() == pytest.approx((half, 0, 0, half))


def test_body_rates_turn_the_quaternion() -> None:
    """q' = q * (0, w) / 2, measured over one step."""
    motion = hovering()
    for guidance in wild_flight():
        for _ in range(150):
            q0, q1, q2, q3 = motion.quaternion()
            x0, y0, z0 = motion.rate_x, motion.rate_y, motion.rate_z
            motion.step(guidance)
            x, y, z = (x0 + motion.rate_x) / 2, (y0 + motion.rate_y) / 2, (z0 + motion.rate_z) / 2
            after = motion.quaternion()
            if q0 * after[0] + q1 * after[1] + q2 * after[2] + q3 * after[3] < 0:
                after = tuple(-value for value in after)  # type: ignore[assignment]
            expected = (
                q0 - STEP_S / 2 * (q1 * x + q2 * y + q3 * z),
                q1 + STEP_S / 2 * (q0 * x + q2 * z - q3 * y),
                q2 + STEP_S / 2 * (q0 * y + q3 * x - q1 * z),
                q3 + STEP_S / 2 * (q0 * z + q1 * y - q2 * x),
            )
            assert after == pytest.approx(expected, abs=3e-4)


# --- wind, ground ---------------------------------------------------------------------------


def test_wind_is_held_against_by_tilting_into_it() -> None:
    """From behind and from the right: the nose goes up, and the left side."""
    motion, drag = hovering(), Airframe().drag
    motion.wind_north, motion.wind_east = 6.0, -4.0
    run(motion, DynamicsInput(ModelHorizontal.POSITION, 0.0, 0.0), 30.0)
    assert (motion.north, motion.east) == pytest.approx((0.0, 0.0), abs=0.02)
    assert math.tan(motion.pitch) * GRAVITY == pytest.approx(drag * 6.0, rel=0.02)
    sideways = math.tan(motion.roll) / math.cos(motion.pitch) * GRAVITY
    assert sideways == pytest.approx(drag * 4.0, rel=0.02)


def test_without_position_control_wind_carries_it_away() -> None:
    motion = hovering()
    motion.wind_east = 4.0
    run(motion, DynamicsInput(ModelHorizontal.TILT), 30.0)
    assert motion.velocity_east == pytest.approx(4.0, abs=0.01)


def test_on_the_ground_with_motors_off_nothing_moves() -> None:
    motion = Dynamics()
    run(motion, DynamicsInput(ModelHorizontal.VELOCITY, 5.0, 5.0, up=4.0), 3.0)
    assert (motion.north, motion.east, motion.height, motion.yaw) == (0, 0, 0, 0)


def test_on_the_ground_with_idle_motors_only_climbing_moves() -> None:
    motion = Dynamics()
    motion.motors_on = True
    run(motion, DynamicsInput(ModelHorizontal.VELOCITY, 5.0, 5.0, up=0.0, yaw=1.0), 3.0)
    assert (motion.north, motion.east, motion.height, motion.yaw) == (0, 0, 0, 0)
    run(motion, DynamicsInput(up=1.0), 3.0)
    assert motion.height == pytest.approx(3.0 - Airframe().vertical_time_constant, rel=0.01)


def test_sinking_ends_on_the_ground() -> None:
    motion = hovering()
    run(motion, DynamicsInput(up=-4.0), 20.0)
    assert motion.height == 0.0
    assert motion.on_ground
    assert motion.touchdown_speed == pytest.approx(4.0, rel=0.01)
    assert motion.velocity_up == 0.0


def test_motors_off_in_the_air_falls() -> None:
    motion = hovering()
    motion.motors_on = False
    run(motion, DynamicsInput(), 2.0)
    assert motion.height == pytest.approx(50.0 - 0.5 * GRAVITY * 2.0**2, rel=1e-9)
    run(motion, DynamicsInput(), 5.0)
    assert motion.on_ground
    assert motion.touchdown_speed == pytest.approx(math.sqrt(2 * GRAVITY * 50.0), rel=0.01)


def test_wind_carries_along_what_falls() -> None:
    motion = hovering(Airframe(drag=0.5))
    motion.motors_on = False
    motion.wind_north, motion.wind_east = 5.0, -3.0
    run(motion, DynamicsInput(), 1.0)
    share = 1.0 - math.exp(-0.5)  # of the wind, after a second
    assert motion.velocity_north == pytest.approx(5.0 * share, rel=0.01)
    assert motion.velocity_east == pytest.approx(-3.0 * share, rel=0.01)
    assert motion.north == pytest.approx(5.0 * (1.0 - share / 0.5), rel=0.02)
    assert motion.east == pytest.approx(-3.0 * (1.0 - share / 0.5), rel=0.02)
    assert motion.acceleration_up == -GRAVITY


def test_equal_inputs_give_equal_flights() -> None:
    first, second = hovering(), hovering()
    for motion in (first, second):
        for guidance in wild_flight():
            run(motion, guidance, 3.0)
    names = ("north", "east", "height", "roll", "pitch", "yaw", "velocity_up")
    assert [getattr(first, name) for name in names] == [getattr(second, name) for name in names]


# --- airframes ------------------------------------------------------------------------------


def test_firmware_3_1_flies_as_measured_and_all_else_as_documented() -> None:
    for firmware, frequency, tilt, dead in (
        *(("1.0", 10.0, 30.0, 0.0), ("2.3", 10.0, 30.0, 0.0)),
        *(("1.0-document", 10.0, 30.0, 0.0), ("3.1", 11.7, 35.5, 0.10)),
    ):
        airframe = VirtualAircraft(firmware=firmware).vehicle.flight.dynamics.airframe
        flown = airframe.tilt_frequency, airframe.maximum_tilt_deg, airframe.command_delay
        assert flown == (frequency, tilt, dead), firmware


def test_settings_may_name_another_airframe() -> None:
    settings = AircraftSettings(airframe=Airframe(drag=0.5))
    virtual = VirtualAircraft(firmware="3.1", settings=settings)
    assert virtual.vehicle.flight.dynamics.airframe == Airframe(drag=0.5)


def test_hover_thrust_rises_evenly_as_the_battery_empties() -> None:
    """38.2 % when full and 44 % when empty: 41.1 % at half; at rest it loses 3 % of a hover."""
    flight = VirtualAircraft(firmware="3.1").vehicle.flight
    flight.battery_percent = 50.0
    flight.step(0.01, Device.ONBOARD, PilotRemote())
    assert flight.dynamics.hover_thrust == pytest.approx(41.1, abs=0.001)
    assert flight.battery_percent == pytest.approx(50.0 - 0.03 * 0.01 * 100.0 / (12.7 * 60.0))


def test_a_file_names_numbers_of_an_airframe_and_its_base(tmp_path: Path) -> None:
    heavy = tmp_path / "heavy.toml"
    heavy.write_text('base = "measured-3.1.10"\nhover_thrust = 52\ncommand_delay = 0.15\n')
    airframe = read_airframe(str(heavy))
    assert (airframe.hover_thrust, airframe.command_delay) == (52.0, 0.15)
    assert airframe.tilt_damping == 0.85
    heavy.write_text("hover_thrust = 52.0\n")
    assert read_airframe(str(heavy)) == Airframe(hover_thrust=52.0)
    assert read_airframe("document") == Airframe()


@pytest.mark.parametrize(
    ("text", "seen"),
    [
        ("drag = -0.1", "drag of an airframe is -0.1"),
        ("drag = nan", "drag of an airframe is nan"),
        ("tilt_frequency = 1e9", "tilt_frequency of an airframe"),
        ("wings = 2", "wings = 2 is no number of an airframe"),
        ("drag = true", "drag = True is no number"),
        ('drag = "0.1"', "drag = '0.1' is no number"),
        ("base = 7", "no airframe is called 7"),
        ("base = [1]", "no airframe is called"),
        ('base = "paper"', "no airframe is called 'paper'"),
        ("drag", "no airframe"),
        ("\udcff", "no airframe"),
    ],
)
def test_a_file_that_is_no_airframe_is_refused(text: str, seen: str, tmp_path: Path) -> None:
    file = tmp_path / "bad.toml"
    file.write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(UsageError, match=re.escape(seen)) as caught:
        read_airframe(str(file))
    assert str(file) in caught.value.seen
    with pytest.raises(UsageError, match="no airframe"):
        read_airframe(str(tmp_path / "missing"))
