"""Channels, sticks, switches and readings: values of the document, all different from each other.

Item RC (2.2.3.1): roll, pitch, yaw, throttle, mode, gear. Virtual channels of firmware 3.1: roll,
pitch, throttle, yaw, gear, a free one and the mode; 1024 is the middle, 660 the travel to each
side. Items: document 2.2.3.1, in the order of their fields.
"""

from __future__ import annotations

import math
from random import Random
from typing import Any, cast

import pytest

from m100link.protocol import Attitude, Setpoint
from m100link.protocol.commands.gimbal import GimbalSpeed
from m100link.protocol.commands.virtual_rc import VirtualRcData, VirtualRcSettings
from m100link.protocol.firmware import profile
from m100link.protocol.records import AccelerationMode, Device, FlightPhase, RcMode
from m100link.sim import AircraftSettings, AssistantSettings, PilotRemote, Vehicle
from m100link.sim.vehicle.gimbal import GimbalMount
from m100link.sim.vehicle.remote import VirtualRemote

ON, NEVER_BACK, OFF = (
    VirtualRcSettings(*flags) for flags in ((True, True), (True, False), (False, True))
)
CHANNELS = (1024 + 66, 1024 - 132, 1024 + 198, 1024 - 264, 1324, 1024, 496, *[1024] * 9)


# -- the virtual remote control ---------------------------------------------------------------


def test_a_channel_moves_its_stick_by_660_of_the_travel() -> None:
    remote = VirtualRemote()
    remote.switch(ON, 5.0)
    remote.feed(VirtualRcData(CHANNELS), 5.0)
    expected = (0.1, -0.2, -0.4, 0.3, RcMode.F, True)  # roll, pitch, yaw, throttle
    assert remote.sticks(5.0) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("place", "value", "field", "shown"),
    [
        (0, 1024 + 700, 0, 1.0),
        (0, 1024 - 700, 0, -1.0),
        (4, 1499, 5, True),
        (4, 1500, 5, False),
        (4, 1684, 5, False),
        *((6, at, 4, RcMode.F) for at in (364, 496, 759)),
        *((6, at, 4, RcMode.A) for at in (761, 1024, 1287)),
        *((6, at, 4, RcMode.P) for at in (1289, 1552, 1684)),
    ],
)
def test_a_channel_has_ends_and_a_switch_is_in_the_nearest_position(
    place: int, value: int, field: int, shown: object
) -> None:
    remote = VirtualRemote()
    remote.switch(ON, 0.0)
    remote.feed(VirtualRcData((*CHANNELS[:place], value, *CHANNELS[place + 1 :])), 0.0)
    sticks = remote.sticks(0.0)
    assert sticks is not None
    assert sticks[field] == shown


@pytest.mark.parametrize(
    ("command", "after", "says", "stays_on", "is_lost"),
    [
        (ON, 1.0, True, True, False),
        (ON, 1.01, False, False, False),
        (NEVER_BACK, 1.0, True, True, False),
        (NEVER_BACK, 1.01, False, True, True),
        (OFF, 0.1, False, False, False),
    ],
)
def test_it_says_something_for_a_second_after_the_last_channels(
    command: VirtualRcSettings, after: float, says: bool, stays_on: bool, is_lost: bool
) -> None:
    remote = VirtualRemote()
    remote.switch(command, 3.0)
    remote.feed(VirtualRcData(CHANNELS), 3.5)
    assert (remote.sticks(3.5 + after) is not None) is says
    assert remote.is_on is stays_on
    assert remote.counts_as_lost(3.5 + after) is is_lost


@pytest.mark.parametrize(("pause", "locks"), [(1.98, True), (1.995, False), (2.0, False)])
def test_settings_within_two_seconds_lock_it(pause: float, locks: bool) -> None:
    remote = VirtualRemote()
    remote.switch(ON, 0.5)
    assert not remote.is_locked
    remote.feed(VirtualRcData(CHANNELS), 0.5)
    remote.switch(ON, 0.5 + pause)
    assert remote.is_locked is locks
    assert remote.sticks(0.5 + pause) is None, "channels come anew"
    remote.reset()
    assert (remote.is_on, remote.is_locked) == (False, False)
    remote.switch(ON, 0.6)
    assert not remote.is_locked, "as at power-on"


# -- the pilot's ------------------------------------------------------------------------------


def test_the_item_has_ten_thousandths_of_each_stick_in_its_order() -> None:
    remote = PilotRemote(RcMode.F)
    remote.move_stick(roll=0.1, pitch=-0.2, yaw=-0.4, throttle=0.3)
    assert remote.channels() == (1000, -2000, -4000, 3000, 8000, -4545)
    remote.gear_down = False
    remote.set_mode("A")
    assert remote.channels() == (1000, -2000, -4000, 3000, 0, -10_000)
    remote.virtual.is_locked = True  # the pilot's sticks do nothing; the autopilot reads P
    assert remote.channels() == (0, 0, 0, 0, -8000, -10_000)


@pytest.mark.parametrize("stick", ["roll", "pitch", "yaw", "throttle"])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_stick_is_moved_beyond_five_percent(stick: str, side: float) -> None:
    moved = []
    for by in (0.0, 0.05, 0.051):
        remote = PilotRemote()
        remote.move_stick(**{stick: side * by})
        moved.append(remote.sticks().are_moved)
    assert moved == [False, False, True]


@pytest.mark.parametrize(
    ("roll", "pitch", "yaw", "throttle", "is_corner"),
    [
        (-1.0, -1.0, 1.0, -1.0, True),
        (1.0, -1.0, -1.0, -1.0, True),
        (0.96, -0.96, 0.96, -0.96, True),
        (0.95, -1.0, 1.0, -1.0, False),
        (1.0, -0.95, 1.0, -1.0, False),
        (1.0, -1.0, 0.95, -1.0, False),
        (1.0, -1.0, 1.0, -0.95, False),
        (1.0, 1.0, 1.0, -1.0, False),
        (1.0, -1.0, 1.0, 1.0, False),
    ],
)
def test_both_sticks_down_and_aside_are_the_corner_and_two_seconds_of_it_the_gesture(
    roll: float, pitch: float, yaw: float, throttle: float, is_corner: bool
) -> None:
    remote = PilotRemote()
    remote.move_stick(roll=roll, pitch=pitch, yaw=yaw, throttle=throttle)
    assert remote.sticks().are_in_corner is is_corner
    made = []
    for remote.now in (7.0, 8.99, 9.0, 9.1, 13.0):
        made.append(remote.makes_gesture())
    assert made == [False, False, is_corner, False, False], "it counts once"


def test_the_mode_switch_moves_only_to_another_position() -> None:
    remote = PilotRemote(RcMode.F)
    remote.virtual.is_on = True
    remote.set_mode("F")
    assert (remote.moved_since_power_on, remote.virtual.is_on) == (False, True)
    remote.set_mode("A")
    assert (remote.moved_since_power_on, remote.virtual.is_on) == (True, False)
    remote.virtual.is_on = True
    remote.set_mode("P")
    assert remote.virtual.is_on, "it ends by leaving F"


# -- what telemetry says ----------------------------------------------------------------------


def posed(firmware: str = "3.1", **settings: Any) -> Vehicle:
    """An aircraft in an attitude, at a place and with a motion that are each a different number."""
    vehicle = Vehicle(Random(1), profile(firmware), settings=AircraftSettings(**settings))
    motion = vehicle.flight.dynamics
    motion.place(300.0, -400.0, 12.0, yaw_deg=170.0)
    motion.roll, motion.pitch = math.radians(10.0), math.radians(-20.0)
    motion.velocity_north, motion.velocity_east, motion.velocity_up = 1.0, -2.0, 3.0
    motion.acceleration_north, motion.acceleration_east, motion.acceleration_up = 0.4, -0.5, 0.6
    motion.rate_x, motion.rate_y, motion.rate_z = 0.1, -0.2, 0.3
    return vehicle


def read(vehicle: Vehicle, name: str) -> tuple[float, ...]:
    return vehicle.sensors.reader(name)()


C10, S10, C20, S20, C170, S170 = (
    f(math.radians(a)) for a in (10, 20, 170) for f in (math.cos, math.sin)
)


def to_body(north: float, east: float, down: float) -> list[float]:
    """Turn by yaw 170, pitch −20, roll 10 degrees, one rotation after the other."""
    x, y = north * C170 + east * S170, -north * S170 + east * C170
    x, z = x * C20 + down * S20, -x * S20 + down * C20
    return [x, y * C10 + z * S10, -y * S10 + z * C10]


@pytest.mark.parametrize(
    ("name", "settings", "expected"),
    [
        ("velocity", {}, [1.0, -2.0, 3.0, 1]),
        ("velocity", {"vertical_down": True}, [1.0, -2.0, -3.0, 1]),
        ("acceleration", {}, [0.4, -0.5, 0.6]),
        ("acceleration", {"vertical_down": True}, [0.4, -0.5, -0.6]),
        ("angular_velocity", {}, [0.1, -0.2, 0.3]),
        ("magnetometer", {}, [round(one) for one in to_body(1100.0, 0.0, 1020.0)]),
        (
            "position",  # 111.195 km are a degree; at 60° north half of it eastwards
            {"latitude_deg": 60.0, "longitude_deg": 20.0, "ground_altitude": 30.0},
            [math.radians(60.002693), math.radians(19.992825), 42.0, 12.0, 5],
        ),
        ("rc", {}, [0, 0, 0, 0, 8000, -4545]),
        ("flight_status", {}, [FlightPhase.STANDBY]),
    ],
)
def test_a_reading_has_the_value_of_its_field(
    name: str, settings: dict[str, Any], expected: list[float]
) -> None:
    reading = read(posed(**settings), name)
    assert list(reading) == pytest.approx(expected, rel=1e-9, abs=2e-7)


def test_raw_acceleration_is_the_force_that_carries_it_in_g_and_in_the_body() -> None:
    vehicle = posed()
    vehicle.configure(AssistantSettings(acceleration=AccelerationMode.RAW))
    felt = to_body(0.4, -0.5, -0.6 - 9.81)
    expected = [one / 9.81 for one in felt]
    assert list(read(vehicle, "acceleration")) == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize(
    ("firmware", "health", "status"),
    [("1.0", 3, 1), ("2.3", 3, 7), ("3.1", 3, 1), ("3.1", 2, 0), ("2.3", 2, 0)],
)
def test_velocity_is_good_from_gps_health_three_on(firmware: str, health: int, status: int) -> None:
    vehicle = posed(firmware)
    vehicle.set_gps_health(health)
    assert read(vehicle, "velocity")[3] == status
    assert read(vehicle, "position")[4] == health
    vehicle.set_gps_health(0)
    assert read(vehicle, "position") == (0.0, 0.0, 12.0, 12.0, 0)


@pytest.mark.parametrize(
    ("nose", "yaw", "shown"),
    [
        (170.0, 5.0, 175.0),
        (170.0, 10.0, 180.0),
        (170.0, 11.0, -179.0),
        (-170.0, -9.0, -179.0),
        (-170.0, -10.0, 180.0),
        (-170.0, -11.0, 179.0),
    ],
)
def test_the_gimbal_is_shown_by_its_direction_on_the_ground(
    nose: float, yaw: float, shown: float
) -> None:
    vehicle = posed()
    vehicle.flight.dynamics.yaw = math.radians(nose)
    gimbal = vehicle.gimbal
    gimbal.yaw, gimbal.roll, gimbal.pitch = yaw, 3.0, -40.0
    assert read(vehicle, "gimbal") == pytest.approx((3.0, -40.0, shown, 0))
    gimbal.pitch = -90.0
    assert read(vehicle, "gimbal")[3] == 1


@pytest.mark.parametrize(("percent", "shown"), [(100.0, 100), (55.01, 56), (0.2, 1), (0.0, 0)])
def test_the_battery_is_rounded_up(percent: float, shown: int) -> None:
    vehicle = posed()
    vehicle.flight.battery_percent = percent
    assert read(vehicle, "battery") == (shown,)


@pytest.mark.parametrize(
    ("firmware", "steps", "tick", "nanoseconds"),
    [
        ("1.0", 123, 738, 230_000_000),
        ("2.3", 123, 738, 230_000_000),
        ("3.1", 251, 1004, 510_000_000),
    ],
)
def test_the_clock_has_600_or_400_ticks_and_the_nanoseconds_of_the_second(
    firmware: str, steps: int, tick: int, nanoseconds: int
) -> None:
    vehicle = posed(firmware)
    vehicle.sensors.ticks = steps
    assert read(vehicle, "time") == (tick, nanoseconds, 0)


@pytest.mark.parametrize(
    ("firmware", "is_requested", "is_pending", "is_virtual", "control"),
    [
        ("2.3", False, False, False, 2),
        ("2.3", True, False, False, 2 | 8),
        ("2.3", False, True, False, 2 | 8),
        ("1.0", True, True, False, 2),
        ("3.1", False, False, True, 2 | 16),
        ("3.1", True, False, True, 2 | 8 | 16),
    ],
)
def test_the_control_device_item_has_a_bit_for_a_request_and_one_for_the_virtual_remote(
    firmware: str, is_requested: bool, is_pending: bool, is_virtual: bool, control: int
) -> None:
    vehicle = posed(firmware)
    authority = vehicle.authority
    authority.device = Device.ONBOARD
    authority.is_requested, authority.is_pending = is_requested, is_pending
    vehicle.remote.virtual.is_on = is_virtual
    assert read(vehicle, "control_device") == (control, 0)


@pytest.mark.parametrize(("device", "shows"), [(Device.ONBOARD, True), (Device.RC, False)])
def test_the_mode_of_movement_is_shown_while_the_onboard_device_has_control(
    device: Device, shows: bool
) -> None:
    vehicle = posed()
    setpoint = Setpoint.velocity(north=1, east=2, up=0, yaw_rate_deg_s=3)
    vehicle.authority.device = device
    vehicle.flight.setpoint = setpoint
    shown = read(vehicle, "control_device")[1]
    assert shown == (setpoint.mode.number if shows else 0)
    assert setpoint.mode.number


@pytest.mark.parametrize(
    ("reads", "expected"), [("zeros", (0,) * 6), ("kept", (0, 0, 0, 0, 8000, -4545))]
)
def test_a_remote_that_is_off_reads_as_the_settings_say(
    reads: str, expected: tuple[int, ...]
) -> None:
    vehicle = posed(rc_lost_reads=reads)
    vehicle.remote.is_switched_on = False
    assert read(vehicle, "rc") == expected


# -- errors of the sensors, and the gimbal ----------------------------------------------------


@pytest.mark.parametrize(("health", "worse"), [(3, 1.0), (2, 20.0), (1, 20.0)])
def test_each_error_is_added_to_its_own_value_and_poor_gps_is_20_times_as_far_off(
    health: int, worse: float
) -> None:
    """Errors of 1.5, −2.5 and 0.25 m: a degree of latitude is 111.195 km."""
    exact, off = posed(), posed(noise=1.0)
    for vehicle in (exact, off):
        vehicle.set_gps_health(health)
    errors = off.sensors._errors
    errors.north.value, errors.east.value, errors.height.value = 1.5, -2.5, 0.25
    for error, value in zip(errors.velocity, (0.1, -0.2, 0.3), strict=True):
        error.value = value
    for error, value in zip(errors.field, (11.0, -12.0, 13.0), strict=True):
        error.value = value
    errors.roll.value, errors.pitch.value, errors.yaw.value = 0.01, -0.02, 0.03
    there, here = read(off, "position"), read(exact, "position")
    metre = math.radians(1.0) / 111_195.0
    assert there[0] - here[0] == pytest.approx(1.5 * worse * metre, rel=1e-2)
    across = metre / math.cos(here[0])
    assert there[1] - here[1] == pytest.approx(-2.5 * worse * across, rel=1e-2)
    assert [a - b for a, b in zip(there[2:], here[2:], strict=True)] == [0.25, 0.25, 0]
    moved = zip(read(off, "velocity")[:3], read(exact, "velocity")[:3], strict=True)
    assert [a - b for a, b in moved] == pytest.approx([0.1, -0.2, 0.3])
    drawn = zip(read(off, "magnetometer"), read(exact, "magnetometer"), strict=True)
    assert [a - b for a, b in drawn] == [11, -12, 13]
    turned = Attitude(*read(off, "quaternion"))
    assert (turned.roll_deg, turned.pitch_deg, turned.yaw_deg) == pytest.approx(
        (10.0 + 0.57296, -20.0 - 1.14592, 170.0 + 1.71887), abs=1e-3
    )


@pytest.mark.parametrize("scale", [1.0, 3.0])
def test_inertial_noise_is_that_of_the_airframe_on_each_axis(scale: float) -> None:
    """Axis by axis: a drawn number of 1.5, −2 and 3, times 0.05 m/s² and 0.005 rad/s."""
    vehicle = posed("1.0", noise=scale)
    vehicle.sensors._noise = lambda: [1.5, -2.0, 3.0]
    exact = posed("1.0")
    for name, deviation in (("acceleration", 0.05), ("angular_velocity", 0.005)):
        off = zip(read(vehicle, name), read(exact, name), strict=True)
        wanted = [scale * deviation * one for one in (1.5, -2.0, 3.0)]
        assert [a - b for a, b in off] == pytest.approx(wanted)
    for one in (vehicle, exact):
        one.configure(AssistantSettings(acceleration=AccelerationMode.RAW))
    felt = zip(read(vehicle, "acceleration"), read(exact, "acceleration"), strict=True)
    wanted = [scale * 0.05 * one / 9.80665 for one in (1.5, -2.0, 3.0)]
    assert [a - b for a, b in felt] == pytest.approx(wanted)


def test_a_quaternion_has_the_sign_of_the_one_before() -> None:
    vehicle = posed()
    shown = read(vehicle, "quaternion")
    for axis in range(4):
        vehicle.sensors._quaternion = cast(Any, [-shown[axis] * (axis == k) for k in range(4)])
        assert read(vehicle, "quaternion") == tuple(-one for one in shown)
        vehicle.sensors._quaternion = cast(Any, [shown[axis] * (axis == k) for k in range(4)])
        assert read(vehicle, "quaternion") == shown


def test_height_counts_from_where_it_stands() -> None:
    """While the motors are off it has no error; errors move on in turn, each after 0.2 s."""
    vehicle = posed(noise=1.0)
    errors = vehicle.sensors._errors
    for is_on, kept in ((False, False), (True, True)):
        vehicle.flight.dynamics.motors_on = is_on
        errors.height.value = 9.0
        for _ in range(4):
            vehicle.sensors.advance()
        assert (abs(errors.height.value) > 8.0) is kept
    assert errors.roll._keep == pytest.approx(math.exp(-0.2 / 30.0))
    assert errors.velocity[0]._keep == pytest.approx(math.exp(-0.2 / 3.0))


@pytest.mark.parametrize(
    ("rates", "turned"),
    [
        ((40.0, -20.0, -30.0), (20.0, -10.0, -15.0)),
        ((250.0, 0.0, 0.0), (90.0, 0.0, 0.0)),  # 180 degrees a second, for half a second
        ((-250.0, 0.0, -250.0), (-90.0, 0.0, -90.0)),
    ],
)
def test_a_gimbal_turns_for_half_a_second_at_180_degrees_a_second_at_most(
    rates: tuple[float, float, float], turned: tuple[float, float, float]
) -> None:
    gimbal, vehicle = GimbalMount(), Vehicle(Random(1), profile("3.1"))
    yaw, roll, pitch = rates
    for one, now in ((gimbal, 7.0), (vehicle.gimbal, vehicle.time)):
        one.turn(GimbalSpeed(yaw_deg_s=yaw, roll_deg_s=roll, pitch_deg_s=pitch), now)
    for step in range(1, 200):
        gimbal.advance(7.0 + step / 100, 0.01)
        vehicle.step()
    for one, step_s in ((gimbal, 0.01), (vehicle.gimbal, 0.05)):
        found = one.yaw, one.roll, one.pitch
        assert found == pytest.approx(turned, abs=180.0 * step_s + 0.1), step_s
