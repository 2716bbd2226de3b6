"""Speeds and places of ROS, in the words of the aircraft."""

from __future__ import annotations

import math
from typing import Any

import pytest

from m100link.apps.ros2.control import Frames, speed, toward
from m100link.errors import BadSetpoint, UsageError
from m100link.protocol.setpoint import Setpoint


def twist(x: float, y: float, z: float, turn: float) -> dict[str, Any]:
    return {
        "linear": {"x": x, "y": y, "z": z},
        "angular": {"x": 0.0, "y": 0.0, "z": turn},
    }


def test_speeds() -> None:
    turn = math.radians(30)
    turned = math.degrees(-turn)
    body = Setpoint.velocity(forward=1.0, right=-2.0, up=3.0, yaw_rate_deg_s=turned)
    assert speed(twist(1.0, 2.0, 3.0, turn), is_body=True) == body
    ground = Setpoint.velocity(north=2.0, east=1.0, up=3.0, yaw_rate_deg_s=turned)
    assert speed(twist(1.0, 2.0, 3.0, turn), is_body=False) == ground


@pytest.mark.parametrize("bad", [math.nan, math.inf, -1e6])
def test_numbers_that_fly_nowhere(bad: float) -> None:
    for place in range(4):
        numbers = [0.0] * 4
        numbers[place] = bad
        with pytest.raises(BadSetpoint):
            speed(twist(*numbers), is_body=True)


def test_frames() -> None:
    frames = Frames(("odom", "map"), ("base_link",))
    assert frames.is_body("", "a speed")
    assert frames.is_body("base_link", "a speed")
    assert not frames.is_body("map", "a speed")
    with pytest.raises(UsageError, match="'camera'") as refusal:
        frames.is_body("camera", "a speed")
    assert refusal.value.remedy == "frames are base_link, map, odom"


def pose(x: float, y: float, z: float, *turned: float) -> dict[str, Any]:
    return {
        "position": {"x": x, "y": y, "z": z},
        "orientation": dict(zip("xyzw", turned or (0.0, 0.0, 0.0, 0.0), strict=True)),
    }


def test_places() -> None:
    found = toward(pose(1.0, 2.0, 3.0), (0.0, 2.0, 2.0), fastest=None)
    assert found == Setpoint.velocity(north=0.0, east=0.8, up=0.8, yaw_rate_deg_s=0.0)
    far = toward(pose(300.0, 400.0, 90.0, 0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0), fastest=2.0)
    assert (far.x, far.y, far.z, far.yaw) == pytest.approx((1.6, 1.2, 2.0, 90.0))


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("place", range(7))
def test_places_that_are_nowhere(bad: float, place: int) -> None:
    numbers = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    numbers[place] = bad
    with pytest.raises(BadSetpoint):
        toward(pose(*numbers), (0.0, 0.0, 0.0), fastest=5.0)


@pytest.mark.parametrize(
    "turned", [(0.0, 0.0, 1.0, 1.0), (1e200, 1e200, 1e200, 1e200), (0.0, 0.0, 0.0, 0.5)]
)
def test_what_is_no_rotation_is_no_heading(turned: tuple[float, ...]) -> None:
    with pytest.raises(BadSetpoint, match="no rotation"):
        toward(pose(0.0, 0.0, 1.0, *turned), (0.0, 0.0, 0.0), fastest=5.0)
    # As float32 has it.
    toward(pose(0.0, 0.0, 1.0, 0.0, 0.0, 0.70710677, 0.70710677), (0.0, 0.0, 0.0), fastest=5.0)
