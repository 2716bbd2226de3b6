"""Sticks as a table: MANUAL_CONTROL in, what is flown out.

Expected are the signs and scales of three that agree:

- MAVLink's definitions (common.xml): x forward, y right, z thrust, r clockwise are 1000. Until
  mavlink/mavlink#2398 (December 2025) they said r counter-clockwise, as no program had it.
- QGroundControl sends x as minus its pitch, y as roll, r as yaw to the right, each times 1000; z is
  its thrust of 0 to 1, times 1000.
- PX4 (handle_message_manual_control) reads pitch forward x / 1000, roll right y / 1000, yaw
  clockwise as seen from above r / 1000, and throttle z / 500 - 1, for z of 0 to 1000 alone. It
  leaves out each axis that is out of its range.
"""

from __future__ import annotations

import math

import pytest

from m100link.apps.mavlink.translator.codec import Message
from m100link.apps.mavlink.translator.offboard import STICKS_LIFETIME, Manual
from m100link.apps.mavlink.translator.parameters import Parameters
from m100link.protocol.setpoint import ReferenceFrame, Setpoint
from tests.apps.mavlink.conftest import world_of
from tests.known import Known

NONE = 0x7FFF


def manual(*, is_tilt: bool, known: Known | None = None) -> Manual:
    world = world_of(known or Known())
    return Manual(world, Parameters(world, 1), is_tilt=is_tilt)


def flown(
    x: float, y: float, z: float, r: float, *, is_tilt: bool = False, known: Known | None = None
) -> Setpoint:
    one = manual(is_tilt=is_tilt, known=known)
    one.receive(Message("MANUAL_CONTROL", {"x": x, "y": y, "z": z, "r": r}), 10.0)
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
    found = flown(*sticks)
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
    found = flown(*sticks, is_tilt=True)
    assert found == Setpoint.tilt(
        roll_deg=found.x, pitch_deg=found.y, up=found.z, yaw_rate_deg_s=found.yaw
    )
    assert (found.x, found.y, found.z, found.yaw) == pytest.approx(expected)


def test_the_agents_limit_is_the_fastest() -> None:
    assert flown(1000, 0, 500, 0, known=Known().limited(2.0)).x == pytest.approx(2.0)
    assert flown(1000, 0, 500, 0, known=Known().limited(9.0)).x == pytest.approx(5.0)


@pytest.mark.parametrize("is_tilt", [False, True])
def test_sticks_that_are_told_no_more_are_let_go(is_tilt: bool) -> None:
    one = manual(is_tilt=is_tilt)
    assert one.setpoint(10.0) is None
    assert not one.is_fresh(10.0)
    one.receive(Message("MANUAL_CONTROL", {"x": 500, "y": 0, "z": 500, "r": 0}), 10.0)
    assert one.is_fresh(10.0 + STICKS_LIFETIME)
    assert one.setpoint(10.0 + STICKS_LIFETIME) is not None
    assert not one.is_fresh(10.01 + STICKS_LIFETIME)
    assert one.setpoint(10.01 + STICKS_LIFETIME) is None
    assert STICKS_LIFETIME == 0.5
    assert not one.wants_up(10.0), "sticks do not leave the ground"
