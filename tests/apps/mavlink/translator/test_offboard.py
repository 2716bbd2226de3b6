"""Setpoints of a program as a table: each frame and mask in, what is flown out.

Bits of the mask say what is to be ignored: x 1, y 2, z 4, vx 8, vy 16, vz 32, accelerations 64 to
256, yaw 1024, yaw rate 2048; 512 makes a force of an acceleration. z and vz are down.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from m100link.apps.mavlink.translator.codec import MavlinkMessage
from m100link.apps.mavlink.translator.offboard import STICKS_LIFETIME, Manual, Offboard
from m100link.apps.mavlink.translator.parameters import ParameterProtocol
from m100link.protocol.records import Position
from m100link.protocol.setpoint import ReferenceFrame, Setpoint
from tests.apps.mavlink.conftest import world_of
from tests.known import Known, quaternion

LOCAL, LOCAL_OFFSET, BODY_NED, BODY_OFFSET, BODY_FRD = 1, 7, 8, 9, 12
ALL, FORCES = 0xFFF & ~0x200, 0x1C0
PLACE, HEIGHT, SPEED, CLIMB, YAW, RATE = 0b11, 0b100, 0b11000, 0b100000, 0x400, 0x800
HERE = (30.0, -70.0, 12.0)
Four = tuple[float, float, float, float]


def offboard(known: Known | None = None, home: Any = HERE) -> Offboard:
    world = world_of(known or Known(), home=home)
    return Offboard(world, ParameterProtocol(world, 1).values)


def message(frame: int, says: int, **fields: float) -> MavlinkMessage:
    """What it says is not ignored."""
    given = dict.fromkeys(("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz"), 0.0)
    given |= {"yaw": 0.0, "yaw_rate": 0.0} | fields
    mask = {"coordinate_frame": frame, "type_mask": ALL & ~says}
    return MavlinkMessage("SET_POSITION_TARGET_LOCAL_NED", mask | given)


def flown(one: Offboard, given: MavlinkMessage) -> Setpoint:
    assert one.receive(given, 10.0) == ""
    found = one.setpoint(10.0)
    assert found is not None
    return found


def values(found: Setpoint) -> Four:
    return found.x, found.y, found.z, found.yaw


@pytest.mark.parametrize(
    ("says", "fields", "expected"),
    [
        (SPEED, {"vx": 2.0, "vy": -3.0}, (2.0, -3.0, 0.0, 0.0)),
        (SPEED | CLIMB, {"vx": 1.0, "vy": 2.0, "vz": -1.25}, (1.0, 2.0, 1.25, 0.0)),
        (CLIMB, {"vz": 0.75}, (0.0, 0.0, -0.75, 0.0)),
        (CLIMB, {"vz": -9.0}, (0.0, 0.0, 2.0, 0.0)),
        (CLIMB, {"vz": 9.0}, (0.0, 0.0, -1.5, 0.0)),
        (SPEED | RATE, {"vx": 1.0, "yaw_rate": 0.5}, (1.0, 0.0, 0.0, math.degrees(0.5))),
        (SPEED | RATE, {"vx": 1.0, "yaw_rate": -9.0}, (1.0, 0.0, 0.0, -100.0)),
        (SPEED, {"vx": 6.0, "vy": -8.0}, (3.0, -4.0, 0.0, 0.0)),
    ],
)
@pytest.mark.parametrize("frame", [LOCAL, BODY_NED, BODY_OFFSET, BODY_FRD])
def test_a_velocity_is_flown_in_its_frame(
    frame: int, says: int, fields: dict[str, float], expected: Four
) -> None:
    found = flown(offboard(), message(frame, says, **fields))
    assert values(found) == pytest.approx(expected)
    assert found.frame is (ReferenceFrame.GROUND if frame == LOCAL else ReferenceFrame.BODY)
    assert found.mode == Setpoint.velocity(north=0.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0).mode


@pytest.mark.parametrize("frame", [LOCAL, BODY_FRD])
@pytest.mark.parametrize(("yaw", "expected"), [(0.5, 28.6479), (-2.0, -114.5916), (4.0, -130.8169)])
def test_a_heading_is_clockwise_from_north(frame: int, yaw: float, expected: float) -> None:
    found = flown(offboard(), message(frame, SPEED | YAW | RATE, vx=1.0, yaw=yaw, yaw_rate=0.7))
    assert found.yaw == pytest.approx(expected, abs=1e-3)
    assert found.mode == Setpoint.velocity(north=0.0, east=0.0, up=0.0, yaw_deg=0.0).mode


# It is 30 m north, 70 m west and 12 m up of home, and flies 0.8 m/s for each metre that is missing.
@pytest.mark.parametrize(
    ("says", "fields", "expected"),
    [
        (PLACE, {"x": 32.0, "y": -70.0}, (1.6, 0.0, 0.0, 0.0)),
        (PLACE, {"x": 29.0, "y": -73.0}, (-0.8, -2.4, 0.0, 0.0)),
        (PLACE | HEIGHT, {"x": 30.0, "y": -69.0, "z": -13.0}, (0.0, 0.8, 0.8, 0.0)),
        (HEIGHT, {"z": -11.0}, (0.0, 0.0, -0.8, 0.0)),
        (HEIGHT, {"z": -40.0}, (0.0, 0.0, 2.0, 0.0)),
        (HEIGHT, {"z": 40.0}, (0.0, 0.0, -1.5, 0.0)),
        (HEIGHT | CLIMB, {"z": -12.5, "vz": -0.5}, (0.0, 0.0, 0.9, 0.0)),
        (PLACE | SPEED, {"x": 31.0, "y": -70.0, "vx": 1.0, "vy": 0.5}, (1.8, 0.5, 0.0, 0.0)),
        (PLACE, {"x": 60.0, "y": -30.0}, (3.0, 4.0, 0.0, 0.0)),
    ],
)
def test_a_place_is_flown_to_from_home(says: int, fields: dict[str, float], expected: Four) -> None:
    found = flown(offboard(), message(LOCAL, says, **fields))
    # Home is on a sphere here and on the ellipsoid there: up to half a metre of seventy.
    assert values(found) == pytest.approx(expected, abs=0.45)
    assert values(found)[2:] == pytest.approx(expected[2:], abs=1e-6)
    assert found.frame is ReferenceFrame.GROUND


def test_where_nobody_knows_the_place_nothing_is_flown_there() -> None:
    known = Known()
    one = offboard(known)
    del known.items[Position]
    found = flown(one, message(LOCAL, PLACE | HEIGHT, x=100.0, y=100.0, z=-50.0))
    assert values(found) == (0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(("age", "flies"), [(0.49, True), (0.51, False), (1.1, False)])
def test_a_place_is_flown_to_by_a_position_of_half_a_second(age: float, *, flies: bool) -> None:
    """Everything else is new, and the position is still shown."""
    known = Known()
    one = offboard(known)
    known.ages[Position] = age
    found = flown(one, message(LOCAL, PLACE | HEIGHT, x=100.0, y=100.0, z=-50.0))
    assert (values(found) != (0.0, 0.0, 0.0, 0.0)) is flies
    assert known.view.place is not None
    assert values(flown(one, message(LOCAL, SPEED, vx=1.0)))[0] == 1.0, "speeds need no place"


def test_the_agents_limit_is_the_fastest() -> None:
    found = flown(offboard(Known().limited(2.0), None), message(LOCAL, SPEED, vx=3.0, vy=-4.0))
    assert values(found)[:2] == pytest.approx((1.2, -1.6))


@pytest.mark.parametrize(
    "given",
    [
        message(LOCAL_OFFSET, SPEED, vx=1.0),
        *(message(frame, SPEED, vx=1.0) for frame in (0, 2, 3, 5, 6, 10, 13, 20)),
        message(LOCAL, 0),
        message(LOCAL, SPEED, vx=math.nan),
        message(LOCAL, SPEED, vx=math.inf),
        message(LOCAL, SPEED, vx=1.0, vy=math.nan),
        message(LOCAL, CLIMB, vz=math.nan),
        message(LOCAL, HEIGHT, z=math.nan),
        message(LOCAL, SPEED | YAW, vx=1.0, yaw=math.nan),
        message(LOCAL, SPEED | RATE, vx=1.0, yaw_rate=math.nan),
        message(LOCAL, SPEED | 0x40, vx=1.0, afx=0.5),
        message(LOCAL, SPEED | 0x80, vx=1.0, afy=-0.5),
        message(LOCAL, SPEED | 0x100, vx=1.0, afz=0.5),
        # half of a pair, or a place that is counted from the aircraft: flown in part it would be
        # another flight than the one that is asked for
        message(LOCAL, 0b01 | CLIMB, x=40.0),
        message(LOCAL, 0b10 | CLIMB, y=40.0),
        message(LOCAL, 0b01000 | CLIMB, vx=1.0),
        message(LOCAL, 0b10000 | CLIMB, vy=1.0),
        message(BODY_NED, PLACE | SPEED, x=5.0, vx=1.0),
        message(BODY_FRD, HEIGHT | SPEED, z=-5.0, vx=1.0),
    ],
)
def test_what_cannot_be_flown_as_it_is_said_is_refused(given: MavlinkMessage) -> None:
    one = offboard()
    assert one.receive(given, 10.0)
    assert one.target is None
    assert one.setpoint(10.0) is None


def test_accelerations_of_nothing_are_nothing() -> None:
    assert values(flown(offboard(), message(LOCAL, SPEED | FORCES, vx=1.0)))[0] == 1.0


def attitude(
    roll: float, pitch: float, yaw: float, thrust: float = 0.5, **given: Any
) -> MavlinkMessage:
    fields = {"type_mask": 0b111, "thrust": thrust, "q": quaternion(roll, pitch, yaw)}
    rates = dict.fromkeys(("body_roll_rate", "body_pitch_rate", "body_yaw_rate"), 0.0)
    return MavlinkMessage("SET_ATTITUDE_TARGET", fields | rates | given)


# Right wing down and nose up are positive, as in the reported attitude.
@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (attitude(10.0, -5.0, 30.0), (10.0, -5.0, 0.0, 30.0)),
        (attitude(-7.0, 12.0, -140.0), (-7.0, 12.0, 0.0, -140.0)),
        (attitude(50.0, -40.0, 0.0), (30.0, -30.0, 0.0, 0.0)),
        (attitude(0.0, 0.0, 0.0, 0.75), (0.0, 0.0, 1.0, 0.0)),
        (attitude(0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 2.0, 0.0)),
        (attitude(0.0, 0.0, 0.0, 0.25), (0.0, 0.0, -1.0, 0.0)),
        (attitude(0.0, 0.0, 0.0, 0.05), (0.0, 0.0, -1.5, 0.0)),
        (attitude(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)),
        (attitude(0.0, 0.0, 0.0, q=(1.9, 0.0, 0.0, 0.0)), (0.0, 0.0, 0.0, 0.0)),
    ],
)
def test_an_attitude_is_a_tilt_a_climb_and_a_heading(given: MavlinkMessage, expected: Four) -> None:
    found = flown(offboard(), given)
    assert values(found) == pytest.approx(expected, abs=1e-6)
    assert found.mode == Setpoint.tilt(roll_deg=0.0, pitch_deg=0.0, up=0.0, yaw_deg=0.0).mode


@pytest.mark.parametrize(
    ("firmware", "most"), [("", 30.0), ("1.0", 30.0), ("2.3", 30.0), ("3.1", 35.0)]
)
def test_a_tilt_ends_where_the_firmware_has_it(firmware: str, most: float) -> None:
    known = Known()
    known.state = replace(known.state, firmware=firmware)
    found = flown(offboard(known), attitude(50.0, -40.0, 0.0))
    assert (found.x, found.y) == (most, -most)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_nose_straight_up_or_down_is_the_greatest_tilt(sign: float) -> None:
    """Rounded, the sine of its pitch is beyond 1."""
    upright = attitude(0.0, 0.0, 0.0, q=(0.5006, 0.0, sign * 0.5006, 0.0))
    assert flown(offboard(), upright).y == sign * 30.0


@pytest.mark.parametrize(
    "given",
    [
        attitude(0.0, 0.0, 0.0, type_mask=0b111 | 0x80),
        attitude(0.0, 0.0, 0.0, type_mask=0b111 | 0x40),
        attitude(0.0, 0.0, 0.0, 1.01),
        attitude(0.0, 0.0, 0.0, -0.01),
        attitude(0.0, 0.0, 0.0, math.nan),
        attitude(0.0, 0.0, 0.0, q=(0.4, 0.0, 0.0, 0.0)),
        attitude(0.0, 0.0, 0.0, q=(2.1, 0.0, 0.0, 0.0)),
        attitude(0.0, 0.0, 0.0, q=(math.nan, 0.0, 0.0, 0.0)),
        attitude(0.0, 0.0, 0.0, type_mask=0b110, body_roll_rate=0.2),
        attitude(0.0, 0.0, 0.0, type_mask=0b101, body_pitch_rate=0.2),
        attitude(0.0, 0.0, 0.0, type_mask=0b011, body_yaw_rate=-0.2),
    ],
)
def test_an_attitude_that_is_none_is_refused(given: MavlinkMessage) -> None:
    one = offboard()
    assert one.receive(given, 10.0)
    assert one.target is None


def test_rates_that_are_to_be_ignored_and_those_of_nothing_are_no_matter() -> None:
    assert offboard().receive(attitude(1.0, 0.0, 0.0, body_yaw_rate=0.5), 1.0) == ""
    assert offboard().receive(attitude(1.0, 0.0, 0.0, type_mask=0), 1.0) == ""


@pytest.mark.parametrize(
    ("given", "is_up"),
    [
        (message(LOCAL, HEIGHT, z=-0.6), True),
        (message(LOCAL, HEIGHT, z=-0.4), False),
        (message(LOCAL, HEIGHT, z=5.0), False),
        (message(LOCAL, CLIMB, vz=-0.2), True),
        (message(LOCAL, CLIMB, vz=-0.05), False),
        (message(LOCAL, CLIMB, vz=1.0), False),
        (message(LOCAL, HEIGHT | CLIMB, z=-0.1, vz=-1.0), False),
        (message(LOCAL, SPEED, vx=3.0), False),
        (attitude(0.0, 0.0, 0.0, 0.8), True),
        (attitude(0.0, 0.0, 0.0, 0.5), False),
    ],
)
def test_a_take_off_is_asked_for_by_what_leads_up(given: MavlinkMessage, is_up: bool) -> None:
    one = offboard()
    assert one.receive(given, 10.0) == ""
    assert one.wants_up(10.0) is is_up
    assert not one.wants_up(10.6), "half a second later nobody asks for it"


def test_a_setpoint_is_flown_for_as_long_as_the_parameter_says() -> None:
    one = offboard()
    assert not one.is_fresh(10.0)
    assert one.receive(message(LOCAL, SPEED, vx=1.0), 10.0) == ""
    assert one.is_fresh(10.5)
    assert one.setpoint(10.5) is not None
    assert not one.is_fresh(10.51)
    assert one.setpoint(10.51) is None


# -- sticks as a table: MANUAL_CONTROL in, what is flown_by_sticks out -----------------------------
# Expected are the signs and scales of three that agree:
# - MAVLink's definitions (common.xml): x forward, y right, z thrust, r clockwise are 1000. Until
#   mavlink/mavlink#2398 (December 2025) they said r counter-clockwise, as no program had it.
# - QGroundControl sends x as minus its pitch, y as roll, r as yaw to the right, each times 1000;
#   z is its thrust of 0 to 1, times 1000.
# - PX4 (handle_message_manual_control) reads pitch forward x / 1000, roll right y / 1000, yaw
#   clockwise as seen from above r / 1000, and throttle z / 500 - 1, for z of 0 to 1000 alone. It
#   leaves out each axis that is out of its range.


NONE = 0x7FFF


def manual(*, is_tilt: bool, known: Known | None = None) -> Manual:
    world = world_of(known or Known())
    return Manual(world, ParameterProtocol(world, 1).values, is_tilt=is_tilt)


def flown_by_sticks(
    x: float, y: float, z: float, r: float, *, is_tilt: bool = False, known: Known | None = None
) -> Setpoint:
    one = manual(is_tilt=is_tilt, known=known)
    one.receive(MavlinkMessage("MANUAL_CONTROL", {"x": x, "y": y, "z": z, "r": r}), 10.0)
    found = one.setpoint(10.0)
    assert found is not None
    return found


# By default 5 m/s, up 2 m/s, down 1.5 m/s, 60 °/s.
@pytest.mark.parametrize(
    ("sticks", "expected"),
    [
        ((0, 0, 500, 0), (0, 0, 0, 0)),
        ((500, 0, 500, 0), (2.5, 0, 0, 0)),
        ((-300, 0, 500, 0), (-1.5, 0, 0, 0)),
        ((0, 400, 500, 0), (0, 2.0, 0, 0)),
        ((0, -600, 500, 0), (0, -3.0, 0, 0)),
        ((0, 0, 750, 0), (0, 0, 1.0, 0)),
        ((0, 0, 1000, 0), (0, 0, 2.0, 0)),
        ((0, 0, 250, 0), (0, 0, -0.75, 0)),
        ((0, 0, 0, 0), (0, 0, -1.5, 0)),
        ((0, 0, 500, 300), (0, 0, 0, 18.0)),
        ((0, 0, 500, -1000), (0, 0, 0, -60.0)),
        ((200, -300, 600, 400), (1.0, -1.5, 0.4, 24.0)),
        # nothing around the middle
        ((29, -29, 514, 29), (0, 0, 0, 0)),
        ((30, -30, 515, 30), (0.15, -0.15, 0.06, 1.8)),
        ((0, 0, 500, 1000), (0, 0, 0, 60.0)),
        # more than full is no axis, and both together are no faster than one
        ((1001, 400, 500, 0), (0, 2.0, 0, 0)),
        ((500, -1001, 500, 0), (2.5, 0, 0, 0)),
        ((500, 0, 1001, 0), (2.5, 0, 0, 0)),
        ((500, 0, -1, 0), (2.5, 0, 0, 0)),
        ((500, 0, -1000, 0), (2.5, 0, 0, 0)),
        ((500, 0, 500, 1001), (2.5, 0, 0, 0)),
        ((500, 0, 500, -0x8000), (2.5, 0, 0, 0)),
        ((1000, 1000, 500, 0), (5 / math.sqrt(2), 5 / math.sqrt(2), 0, 0)),
        # a joystick without that axis
        ((NONE, 400, 500, 0), (0, 2.0, 0, 0)),
        ((500, NONE, 500, 0), (2.5, 0, 0, 0)),
        ((500, 0, NONE, 0), (2.5, 0, 0, 0)),
        ((500, 0, 500, NONE), (2.5, 0, 0, 0)),
    ],
)
def test_sticks_are_velocities_of_the_body(
    sticks: tuple[float, float, float, float], expected: tuple[float, float, float, float]
) -> None:
    found = flown_by_sticks(*sticks)
    assert found == Setpoint.velocity(
        forward=found.x, right=found.y, up=found.z, yaw_rate_deg_s=found.yaw
    )
    assert found.frame is ReferenceFrame.BODY
    assert (found.x, found.y, found.z, found.yaw) == pytest.approx(expected)


# By default 15°. Forward is nose down, which the M100 has as a negative pitch.
@pytest.mark.parametrize(
    ("sticks", "expected"),
    [
        ((0, 0, 500, 0), (0, 0, 0, 0)),
        ((500, 0, 500, 0), (0, -7.5, 0, 0)),
        ((-200, 0, 500, 0), (0, 3.0, 0, 0)),
        ((0, 600, 500, 0), (9.0, 0, 0, 0)),
        ((0, -1000, 500, 0), (-15.0, 0, 0, 0)),
        ((0, 0, 750, -500), (0, 0, 1.0, -30.0)),
        ((1000, 1000, 250, 0), (15.0, -15.0, -0.75, 0)),
    ],
)
def test_sticks_are_tilts(
    sticks: tuple[float, float, float, float], expected: tuple[float, float, float, float]
) -> None:
    found = flown_by_sticks(*sticks, is_tilt=True)
    assert found == Setpoint.tilt(
        roll_deg=found.x, pitch_deg=found.y, up=found.z, yaw_rate_deg_s=found.yaw
    )
    assert (found.x, found.y, found.z, found.yaw) == pytest.approx(expected)


def test_the_agents_limit_is_the_fastest_of_sticks() -> None:
    assert flown_by_sticks(1000, 0, 500, 0, known=Known().limited(2.0)).x == pytest.approx(2.0)
    assert flown_by_sticks(1000, 0, 500, 0, known=Known().limited(9.0)).x == pytest.approx(5.0)


@pytest.mark.parametrize("is_tilt", [False, True])
def test_sticks_that_are_sent_no_more_are_let_go(is_tilt: bool) -> None:
    one = manual(is_tilt=is_tilt)
    assert one.setpoint(10.0) is None
    assert not one.is_fresh(10.0)
    one.receive(MavlinkMessage("MANUAL_CONTROL", {"x": 500, "y": 0, "z": 500, "r": 0}), 10.0)
    assert one.is_fresh(10.0 + STICKS_LIFETIME)
    assert one.setpoint(10.0 + STICKS_LIFETIME) is not None
    assert not one.is_fresh(10.01 + STICKS_LIFETIME)
    assert one.setpoint(10.01 + STICKS_LIFETIME) is None
    assert STICKS_LIFETIME == 0.5
    assert not one.wants_up(10.0), "sticks do not leave the ground"
