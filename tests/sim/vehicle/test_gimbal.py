"""The gimbal: free it keeps its direction, following it turns with the nose; ways, rates, stops."""

from __future__ import annotations

import math
from random import Random

import pytest

from m100link.protocol.commands.gimbal import GimbalAngle, GimbalAngleMode, GimbalSpeed
from m100link.protocol.firmware import profile
from m100link.sim import AircraftSettings, Vehicle
from m100link.sim.vehicle.gimbal import Camera, GimbalMount


def run(gimbal: GimbalMount, seconds: float, heading_deg: float | None = None) -> None:
    """Let time pass from 0, with the nose on its way to a heading."""
    steps = round(seconds * 20)
    begin = math.degrees(gimbal.heading)
    for step in range(1, steps + 1):
        if heading_deg is not None:
            gimbal.carry(math.radians(begin + (heading_deg - begin) * step / steps))
        gimbal.advance(step / 20, 0.05)


def test_free_it_keeps_looking_where_it_looked() -> None:
    gimbal = GimbalMount()
    run(gimbal, 3.0, 90.0)
    assert gimbal.yaw == pytest.approx(-90.0)


def test_following_it_turns_with_the_nose() -> None:
    gimbal = GimbalMount(follows=True)
    run(gimbal, 3.0, 90.0)
    assert gimbal.yaw == 0.0


@pytest.mark.parametrize("turn", [1.0, -1.0])
def test_the_stop_of_the_axis_takes_it_along(turn: float) -> None:
    gimbal = GimbalMount()
    run(gimbal, 5.0, turn * 400.0)
    assert gimbal.yaw == pytest.approx(-turn * 320.0)
    assert gimbal.limits & 4
    run(gimbal, 1.0, turn * 390.0)
    assert gimbal.yaw == pytest.approx(-turn * 310.0)


@pytest.mark.parametrize(
    ("follows", "yaw", "relative"),
    [(False, 90.0, 40.0), (False, -170.0, 140.0), (True, 90.0, 90.0), (True, -170.0, -170.0)],
)
def test_absolute_yaw_counts_from_north_or_from_the_nose(
    follows: bool, yaw: float, relative: float
) -> None:
    gimbal = GimbalMount(math.radians(50.0), follows=follows)
    gimbal.point(GimbalAngle(yaw, 0.0, -30.0, GimbalAngleMode.ABSOLUTE, 1.0))
    run(gimbal, 1.5)
    assert (gimbal.yaw, gimbal.pitch) == pytest.approx((relative, -30.0))


def test_a_target_stays_where_it_is_while_the_aircraft_turns() -> None:
    gimbal = GimbalMount()
    gimbal.point(GimbalAngle(90.0, 0.0, 0.0, GimbalAngleMode.ABSOLUTE, 2.0))
    run(gimbal, 3.0, -60.0)
    assert gimbal.yaw == pytest.approx(150.0)


def test_it_takes_the_shortest_way_that_its_axis_has() -> None:
    gimbal = GimbalMount()
    run(gimbal, 3.0, 200.0)
    assert gimbal.yaw == pytest.approx(-200.0)  # looks north, 200 degrees to the left of the nose
    gimbal.point(GimbalAngle(10.0, 0.0, 0.0, GimbalAngleMode.ABSOLUTE, 1.0))
    run(gimbal, 0.5)
    assert gimbal.yaw == pytest.approx(-195.0, abs=1.0)
    run(gimbal, 1.0)
    assert gimbal.yaw == pytest.approx(-190.0)


def test_relative_angles_count_from_the_present_ones_and_some_axes_are_left_alone() -> None:
    gimbal = GimbalMount(math.radians(50.0))
    gimbal.point(GimbalAngle(30.0, 10.0, -20.0, 0, 1.0))
    run(gimbal, 1.5)
    gimbal.point(GimbalAngle(30.0, 10.0, -20.0, GimbalAngleMode.KEEP_ROLL, 1.0))
    run(gimbal, 1.5)
    assert (gimbal.yaw, gimbal.roll, gimbal.pitch) == pytest.approx((60.0, 10.0, -40.0))


def test_a_rate_turns_it_against_the_ground() -> None:
    gimbal = GimbalMount()
    gimbal.turn(GimbalSpeed(yaw_deg_s=20.0), 0.0)
    run(gimbal, 0.5, 50.0)
    assert gimbal.yaw == pytest.approx(10.0 - 50.0, abs=1.1)


def test_g2_a_rate_holds_for_half_a_second() -> None:
    gimbal = GimbalMount()
    gimbal.turn(GimbalSpeed(pitch_deg_s=-20.0), 0.0)
    run(gimbal, 3.0)
    assert gimbal.pitch == pytest.approx(-10.0, abs=1.01)


def test_k4_without_bit_7_a_rate_is_ignored() -> None:
    gimbal = GimbalMount()
    gimbal.turn(GimbalSpeed(pitch_deg_s=-20.0, flags=0x7F), 0.0)
    run(gimbal, 1.0)
    assert gimbal.pitch == 0.0
    gimbal.turn(GimbalSpeed(pitch_deg_s=-20.0, flags=0xFF), 0.0)
    run(gimbal, 1.0)
    assert gimbal.pitch < -9.0


@pytest.mark.parametrize(("duration", "seconds"), [(2.0, 2.0), (0.1, 0.75), (0.0, 0.75)])
def test_g3_it_gets_there_in_the_time_but_at_400_degrees_per_second_at_most(
    duration: float, seconds: float
) -> None:
    gimbal = GimbalMount()
    gimbal.point(GimbalAngle(300.0, 0.0, 0.0, 0, duration))
    run(gimbal, seconds - 0.1)
    assert gimbal.yaw < 299.0
    run(gimbal, 0.15)
    assert gimbal.yaw == pytest.approx(300.0)


@pytest.mark.parametrize(
    ("angles", "limits"),
    [((0.0, 0.0, 0.0), 0), ((0.0, 0.0, -95.0), 1), ((0.0, 40.0, 0.0), 2), ((330.0, 0.0, 40.0), 5)],
)
def test_g3_angles_end_at_the_stops_and_the_limit_bits_say_so(
    angles: tuple[float, float, float], limits: int
) -> None:
    gimbal = GimbalMount()
    gimbal.point(GimbalAngle(*angles, 0, 1.0))
    run(gimbal, 2.0)
    assert gimbal.limits == limits
    assert abs(gimbal.yaw) <= 320.0
    assert abs(gimbal.roll) <= 35.0
    assert -90.0 <= gimbal.pitch <= 30.0


def test_g4_a_photo_takes_a_second_and_video_is_switched_once() -> None:
    events: list[str] = []
    camera = Camera(events.append)
    assert [camera.take_photo(at) for at in (0.0, 0.5, 0.99, 1.0)] == [True, False, False, True]
    assert camera.photos == 2
    done = [camera.record(on) for on in (False, True, True, False)]
    assert done == [False, True, False, True]
    assert not camera.is_recording
    assert events == [
        "camera: photo 1",
        "camera: busy with a photo, another one ignored",
        "camera: busy with a photo, another one ignored",
        "camera: photo 2",
        "camera: video is off already",
        "camera: video on",
        "camera: video is on already",
        "camera: video off",
    ]


@pytest.mark.parametrize(("follows", "turned"), [(False, 0.0), (True, 90.0)])
def test_telemetry_shows_the_direction_on_the_ground(follows: bool, turned: float) -> None:
    settings = AircraftSettings(gimbal_follows=follows)
    vehicle = Vehicle(Random(1), profile("3.1"), settings=settings)
    vehicle.flight.take_off()
    read = vehicle.sensors.reader("gimbal")
    for _ in range(600):
        vehicle.step()
    vehicle.remote.move_stick(yaw=0.3)
    directions = []
    for _ in range(300):
        vehicle.step()
        directions.append(read()[2])
    assert directions[-1] == pytest.approx(turned, abs=6.0)
    if not follows:
        assert max(map(abs, directions)) < 1e-6
