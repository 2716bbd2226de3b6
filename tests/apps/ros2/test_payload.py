"""The gimbal by a service and a topic; the truth is the aircraft's."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator
from typing import Any

import anyio
import pytest

from m100link.apps.ros2.services import angles_of
from tests.apps.ros2.conftest import Program, Rig

pytestmark = pytest.mark.anyio

POINT = "m100_msgs/srv/PointGimbal"


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    async with Rig(firmware="3.1").running() as one:
        yield one


def asked(**more: Any) -> dict[str, Any]:
    angles = dict.fromkeys(("yaw", "pitch", "roll", "duration"), 0.0)
    flags = dict.fromkeys(("is_relative", "keep_yaw", "keep_pitch", "keep_roll"), False)
    return {**angles, **flags, **more}


def rates(program: Program, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> None:
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    program.publish("~/gimbal_speed", {"header": header, "vector": {"x": x, "y": y, "z": z}})


async def test_it_points_where_it_is_told(rig: Rig, program: Program) -> None:
    assert (await program.call("~/obtain_control"))["success"]
    answer = await program.call("~/point_gimbal", POINT, **asked(pitch=-60.0, keep_yaw=True))
    assert answer["success"], answer
    await anyio.sleep(3.0)
    assert rig.aircraft.vehicle.gimbal.pitch == pytest.approx(-60.0, abs=1.0)


async def test_it_turns_as_long_as_it_is_told(rig: Rig, program: Program) -> None:
    assert (await program.call("~/obtain_control"))["success"]
    before = rig.aircraft.vehicle.gimbal.pitch
    for _ in range(20):
        rates(program, y=math.radians(20.0))  # about the axis to the left: down
        await anyio.sleep(0.05)
    await anyio.sleep(2.0)
    turned = rig.aircraft.vehicle.gimbal.pitch - before
    assert turned == pytest.approx(-29.0, abs=6.0)  # a second, and half of one after the last
    await anyio.sleep(2.0)
    assert rig.aircraft.vehicle.gimbal.pitch - before == pytest.approx(turned, abs=0.1)


async def test_without_control_it_stays(rig: Rig, program: Program) -> None:
    before = rig.aircraft.vehicle.gimbal.pitch
    answer = await program.call("~/point_gimbal", POINT, **asked(pitch=-60.0))
    assert "what to do:   call ~/obtain_control first" in answer["message"]
    rates(program, y=1.0)
    await anyio.sleep(2.0)
    assert rig.aircraft.vehicle.gimbal.pitch == before
    assert "~/gimbal_speed: ROS has no control" in rig.texts


@pytest.mark.parametrize("value", [math.nan, math.inf, 100.0])
async def test_angles_that_it_does_not_have_are_refused(
    rig: Rig, program: Program, value: float
) -> None:
    assert (await program.call("~/obtain_control"))["success"]
    answer = await program.call("~/point_gimbal", POINT, **asked(pitch=value))
    assert not answer["success"]
    assert "pitch" in answer["message"]
    rates(program, y=value)
    await anyio.sleep(0.5)
    assert "~/gimbal_speed: " in rig.texts


async def test_older_firmware_says_so() -> None:
    async with Rig(firmware="1.0").running() as rig:
        assert (await rig.program.call("~/obtain_control"))["success"]
        answer = await rig.program.call("~/point_gimbal", POINT, **asked(pitch=-60.0))
        assert not answer["success"]
        assert "2.3" in answer["message"]


def test_each_axis_can_be_left_alone() -> None:
    assert angles_of(asked()).mode == 1
    assert angles_of(asked(is_relative=True)).mode == 0
    assert angles_of(asked(keep_yaw=True)).mode == 3
    assert angles_of(asked(keep_roll=True)).mode == 5
    assert angles_of(asked(keep_pitch=True)).mode == 9
