"""Missions of the aircraft's own, by services: a whole flight, and what is refused."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator
from typing import Any

import anyio
import pytest

from m100link.apps.ros2.services import plan_of
from m100link.geodesy import LocalFrame
from m100link.missions.waypoint import AtEnd, Heading, OnRCLoss, Stay, TakePhoto, Trace
from tests.apps.ros2.conftest import Program, Rig

pytestmark = pytest.mark.anyio

UPLOAD, START = "m100_msgs/srv/UploadMission", "m100_msgs/srv/StartMission"
NO_ACTIONS: list[dict[str, Any]] = []


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    async with Rig(firmware="3.1").running() as one:
        yield one


def point(north: float, east: float, height: float = 8.0, **more: Any) -> dict[str, Any]:
    origin = LocalFrame(47.3977419, 8.5455938)
    latitude, longitude = origin.to_geodetic(north, east)
    return {
        "latitude": latitude,
        "longitude": longitude,
        "height": height,
        "heading": 0.0,
        "damping": 0.0,
        "gimbal_pitch": 0.0,
        "turn_counterclockwise": False,
        "actions": NO_ACTIONS,
        **more,
    }


def mission(*points: dict[str, Any], **more: Any) -> dict[str, Any]:
    choices = dict.fromkeys(("heading", "trace", "at_end", "on_rc_loss", "repeat"), 0)
    numbers = {"speed": 5.0, "max_speed": 0.0, "gimbal_by_point": False}
    return {"points": list(points), **numbers, **choices, **more}


def around(rig: Rig) -> list[dict[str, Any]]:
    """Two places near where it stands."""
    fix = rig.said("~/fix")[-1]
    frame = LocalFrame(fix["latitude"], fix["longitude"])
    points = []
    for north, east in ((40.0, 0.0), (40.0, 30.0)):
        latitude, longitude = frame.to_geodetic(north, east)
        points.append(point(0, 0) | {"latitude": latitude, "longitude": longitude})
    return points


async def begun(rig: Rig, program: Program) -> None:
    assert (await program.call("~/obtain_control"))["success"]
    answer = await program.call("~/mission/upload", UPLOAD, **mission(*around(rig)))
    assert answer["success"], answer
    answer = await program.call("~/mission/start", START, take_off=True)
    assert answer["success"], answer


async def test_it_is_flown_paused_resumed_and_over(rig: Rig, program: Program) -> None:
    await begun(rig, program)
    await rig.until(lambda: rig.speed > 3.0)
    assert (await program.call("~/mission/pause"))["success"]
    await anyio.sleep(4.0)
    assert rig.speed < 0.5
    assert (await program.call("~/mission/resume"))["success"]
    await rig.until(lambda: rig.speed > 3.0)
    events = rig.said("~/mission_event")
    await rig.until(lambda: any(one["event"] == 1 for one in rig.said("~/mission_event")), 120.0)
    assert len(rig.said("~/mission_event")) > len(events)
    pose = rig.said("~/odom")[-1]["pose"]["pose"]["position"]
    assert (pose["x"], pose["y"]) == pytest.approx((30.0, 40.0), abs=1.5)
    # It hovers, and flies for whoever has control.
    await anyio.sleep(1.0)
    await program.fly(2.0, 2.0)
    assert rig.speed > 1.5
    assert (await program.call("~/land"))["success"]
    await rig.until(lambda: not rig.motors_on)


async def test_stopped_it_hovers(rig: Rig, program: Program) -> None:
    await begun(rig, program)
    await rig.until(lambda: rig.speed > 3.0)
    assert (await program.call("~/mission/stop"))["success"]
    await anyio.sleep(4.0)
    assert rig.speed < 0.3
    assert rig.height > 5.0
    assert not (await program.call("~/mission/resume"))["success"]


@pytest.mark.parametrize("name", ["~/stop", "~/land", "~/go_home", "~/release_control"])
async def test_what_ends_everything_ends_a_mission(rig: Rig, program: Program, name: str) -> None:
    await begun(rig, program)
    await rig.until(lambda: rig.speed > 3.0)
    answer = await program.call(name)
    assert answer["success"], answer
    await anyio.sleep(4.0)
    if name != "~/go_home":
        assert rig.speed < 2.0  # a landing comes down
    assert rig.client.state.mission in ("", "no mission")


async def test_speeds_are_not_flown_meanwhile(rig: Rig, program: Program) -> None:
    await begun(rig, program)
    await rig.until(lambda: rig.speed > 3.0)
    await program.fly(1.0, -3.0)
    assert "mission flies" in rig.texts
    assert rig.client.state.mission == "waypoint mission"


async def test_nothing_is_uploaded_or_started_without_control(rig: Rig, program: Program) -> None:
    answer = await program.call("~/mission/upload", UPLOAD, **mission(*around(rig)))
    assert not answer["success"]
    answer = await program.call("~/mission/start", START, take_off=True)
    assert "what to do:   call ~/obtain_control first" in answer["message"]
    for name in ("pause", "resume", "stop"):
        assert not (await program.call(f"~/mission/{name}"))["success"]
    assert not rig.motors_on


async def test_what_cannot_be_flown_is_refused_at_the_upload(rig: Rig, program: Program) -> None:
    assert (await program.call("~/obtain_control"))["success"]
    far = point(0, 0) | {"latitude": 10.0}
    bad = {
        "from the one before it": mission(*around(rig), far),
        "waypoints": mission(around(rig)[0]),
        "is no number": mission(*around(rig), point(0, 0) | {"latitude": math.nan}),
        "speed": mission(*around(rig), speed=40.0),
        "an action 9": mission(*around(rig), point(0, 0, actions=[{"kind": 9, "value": 0.0}])),
        "choose one of 0 HOVER": mission(*around(rig), at_end=9),
    }
    for what, request in bad.items():
        answer = await program.call("~/mission/upload", UPLOAD, **request)
        assert not answer["success"], what
        assert what in answer["message"] or what == "is no number", answer
    answer = await program.call("~/mission/start", START, take_off=True)
    assert "no plan" in answer["message"]
    assert not rig.motors_on


async def test_older_firmware_has_no_missions() -> None:
    async with Rig(firmware="1.0").running() as rig:
        assert (await rig.program.call("~/obtain_control"))["success"]
        await rig.program.call("~/mission/upload", UPLOAD, **mission(*around(rig)))
        answer = await rig.program.call("~/mission/start", START, take_off=True)
        assert not answer["success"]
        assert "3.1" in answer["message"]
        assert not rig.motors_on


def test_a_plan_has_all_that_was_asked() -> None:
    actions = [{"kind": 0, "value": 2.5}, {"kind": 1, "value": 0.0}]
    first = point(0, 0, heading=90.0, gimbal_pitch=-45.0, damping=2.0, actions=actions)
    second = point(50, 0, turn_counterclockwise=True)
    plan = plan_of(
        mission(
            first,
            second,
            heading=3,
            at_end=1,
            on_rc_loss=1,
            repeat=2,
            gimbal_by_point=True,
        )
    )
    assert (plan.heading, plan.trace) == (Heading.BY_WAYPOINT, Trace.STOP_AT_POINTS)
    assert (plan.at_end, plan.on_rc_loss) == (AtEnd.GO_HOME, OnRCLoss.CONTINUE)
    assert (plan.repeat, plan.gimbal_by_waypoint, plan.max_speed) == (2, True, 10.0)
    one, other = plan.waypoints
    assert (one.heading_deg, one.gimbal_pitch_deg, one.damping) == (90, -45, 2.0)
    assert one.actions == (Stay(2.5), TakePhoto())
    assert (one.turn_clockwise, other.turn_clockwise) == (True, False)
