"""Waypoint missions by the names of the later node: uploaded, flown, reported, stopped."""

from __future__ import annotations

import math
import re
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from dataclasses import replace
from typing import Any

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.lease import Lease
from m100link.apps.agent.messages import EventTopic
from m100link.geodesy import LocalFrame
from m100link.protocol.commands.hotpoint import HotpointSetRate
from m100link.protocol.commands.waypoint import WaypointPoint, WaypointStartStop
from m100link.sim.virtual import VirtualAircraft
from tests.apps.station.conftest import FakeClient, Rig
from tests.apps.station.ros.test_payload import answer, sent

pytestmark = pytest.mark.anyio

DONE = {"result": True, "cmd_set": 3, "ack_data": 0}
START, STOP, PAUSE, RESUME = range(4)


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    async with AsyncExitStack() as stack:
        aircraft = VirtualAircraft(seed=5, firmware="3.1")
        one = await stack.enter_async_context(Rig(aircraft).running())
        await one.activated()
        yield one


def waypoint(rig: Rig, north: float, east: float, **values: Any) -> dict[str, Any]:
    settings = rig.aircraft.vehicle.settings
    latitude, longitude = LocalFrame(settings.latitude_deg, settings.longitude_deg).to_geodetic(
        north, east
    )
    action = {"action_repeat": 15, "command_list": [0] * 16, "command_parameter": [0] * 16}
    return {
        "latitude": latitude,
        "longitude": longitude,
        "altitude": 10.0,
        "damping_distance": 0.0,
        "target_yaw": 0,
        "target_gimbal_pitch": 0,
        "turn_mode": 0,
        "has_action": 0,
        "action_time_limit": 10,
        "waypoint_action": action,
    } | values


def task(rig: Rig, *waypoints: dict[str, Any], **values: Any) -> dict[str, Any]:
    points = list(waypoints) or [
        waypoint(rig, 20, 0),
        waypoint(rig, 20, 20),
        waypoint(rig, 0, 20),
    ]
    return {
        "velocity_range": 10.0,
        "idle_velocity": 5.0,
        "action_on_finish": 0,
        "mission_exec_times": 1,
        "yaw_mode": 4,  # as DJI's ROS demo
        "trace_mode": 0,
        "action_on_rc_lost": 0,
        "gimbal_pitch_mode": 0,
        "mission_waypoint": points,
    } | values


async def upload(rig: Rig, client: FakeClient, **values: Any) -> Any:
    return await answer(rig, client, "mission_waypoint_upload", waypoint_task=task(rig) | values)


async def act(rig: Rig, client: FakeClient, action: int) -> Any:
    return await answer(rig, client, "mission_waypoint_action", action=action)


def told(client: FakeClient, topic: str) -> list[tuple[int, int, int]]:
    return [
        (one["msg"]["type"], one["msg"]["data_1"], one["msg"]["data_2"])
        for one in client.read()
        if one.get("topic") == f"/dji_sdk/{topic}"
    ]


def starts(rig: Rig) -> int:
    received = rig.aircraft.autopilot.received_commands
    return sum(
        isinstance(one.command, WaypointStartStop) and not one.command.stop for one in received
    )


def is_flying(rig: Rig) -> bool:
    return rig.front.state.mission == "waypoint mission"


async def test_a_mission_is_uploaded_flown_and_reported(rig: Rig) -> None:
    page = await rig.airborne()
    page.subscribe("/dji_sdk/mission_status")
    page.subscribe("/dji_sdk/mission_event")
    assert await upload(rig, page) == DONE | {"cmd_id": 0x10}
    assert (starts(rig), await answer(rig, page, "mission_waypoint_getSpeed")) == (
        0,
        {"speed": 5.0, "cmd_set": 3, "cmd_id": 0x17, "ack_data": 0},
    )
    [info] = [await answer(rig, page, "mission_waypoint_getInfo")]
    [first, *_] = info["waypoint_task"]["mission_waypoint"]
    assert first["latitude"] == task(rig)["mission_waypoint"][0]["latitude"]
    assert await act(rig, page, START) == DONE | {"cmd_id": 0x12}
    await rig.until(lambda: is_flying(rig))
    await rig.until(lambda: rig.front.state.mission == "no mission", within=120.0)
    assert rig.aircraft.position == pytest.approx((0.0, 20.0), abs=1.5)
    events = told(page, "mission_event")
    assert events[0][:2] == (0, 1)
    assert [index for kind, index, status in events if (kind, status) == (2, 4)] == [0, 1, 2]
    assert events[-1][0] == 1
    assert {index for kind, index, _ in told(page, "mission_status") if kind == 1} == {0, 1, 2}
    assert any("waypoint 2 reached" in event.text for event in rig.front.events)


async def test_pause_resume_speed_and_stop(rig: Rig) -> None:
    page = await rig.airborne()
    await upload(rig, page)
    await act(rig, page, START)
    await rig.until(lambda: rig.aircraft.position[0] > 5.0)
    assert await act(rig, page, PAUSE) == DONE | {"cmd_id": 0x13}
    await anyio.sleep(4.0)
    held = rig.aircraft.position
    await anyio.sleep(3.0)
    assert rig.aircraft.position == pytest.approx(held, abs=0.3)
    assert await answer(rig, page, "mission_waypoint_setSpeed", speed=2.0) == {"result": True}
    assert (await answer(rig, page, "mission_waypoint_getSpeed"))["speed"] == 2.0
    beyond = await answer(rig, page, "mission_waypoint_setSpeed", speed=12.0)
    assert "max_speed" in beyond["values"]
    assert await act(rig, page, RESUME) == DONE | {"cmd_id": 0x13}
    await rig.until(lambda: rig.aircraft.position[0] > held[0] + 2.0)
    assert await act(rig, page, STOP) == DONE | {"cmd_id": 0x12}
    await rig.until(lambda: not is_flying(rig))
    await anyio.sleep(5.0)
    held = rig.aircraft.position
    await anyio.sleep(3.0)
    assert rig.aircraft.position == pytest.approx(held, abs=0.3)
    assert (
        "no waypoint mission flies"
        in (await answer(rig, page, "mission_waypoint_setSpeed", speed=2.0))["values"]
    )


async def test_while_it_flies_setpoints_are_refused_and_a_landing_ends_it(rig: Rig) -> None:
    page = await rig.airborne()
    await upload(rig, page)
    await act(rig, page, START)
    await rig.until(lambda: is_flying(rig))
    page.publish("/sdk_request_ctrl_mode", data=2)
    page.publish("/sdk_request_ctrl", x=1, y=0, z=0, w=0)
    page.publish("/sdk_request_ctrl", x=0, y=0, z=0, w=0)  # letting go says nothing
    refused = await answer(rig, page, "drone_task_control", task=4)
    assert "while a mission flies" in refused["values"]
    assert any("while a mission flies" in text for text in page.statuses())
    await anyio.sleep(2.0)
    assert is_flying(rig)
    assert "while a mission flies" in (await act(rig, page, START))["values"]
    assert (await answer(rig, page, "drone_task_control", task=6))["result"]
    await rig.until(lambda: not is_flying(rig), within=5.0)
    await rig.until(lambda: rig.aircraft.height < 0.1, within=60.0)


@pytest.mark.parametrize("how", ["leaves", "closes", "stop button", "halt"])
async def test_it_is_stopped_with_the_control_of_its_starter(rig: Rig, how: str) -> None:
    page = await rig.airborne()
    await upload(rig, page)
    await act(rig, page, START)
    await rig.until(lambda: is_flying(rig))
    if how == "leaves":
        page.leave()
    elif how == "closes":
        page.publish("/nav_open_close_request", data=0)
    elif how == "stop button":
        await rig.front.stop()
    else:
        rig.front.hover("somebody saw a child")
    await rig.until(lambda: not is_flying(rig), within=5.0)
    assert rig.aircraft.vehicle.flight.dynamics.motors_on
    await anyio.sleep(5.0)
    held = rig.aircraft.position
    await anyio.sleep(3.0)
    assert rig.aircraft.position == pytest.approx(held, abs=0.3)


async def test_that_it_was_broken_off_is_reported_for_programs(rig: Rig) -> None:
    page = await rig.airborne()
    await upload(rig, page)
    await act(rig, page, START)
    await rig.until(lambda: is_flying(rig))
    assert {event.topic for event in rig.front.events} == {EventTopic.NONE}
    rig.aircraft.battery_percent = 15.0

    def broken() -> list[str]:
        events = rig.front.events
        return [event.text for event in events if event.topic is EventTopic.MISSION_ABORTED]

    # Later than the mission ends: one push that says so may be false.
    await rig.until(lambda: bool(broken()), within=10.0)
    assert not is_flying(rig)
    [text] = broken()
    assert "battery" in text


async def test_nobody_flies_what_somebody_else_left(rig: Rig) -> None:
    first = await rig.airborne("first")
    assert (await upload(rig, first))["result"] is True
    other = rig.client("second")
    for request in (upload(rig, other), act(rig, other, START)):
        failed = await request
        assert failed["result"] is False
        assert "first" in failed["values"]
    first.leave()
    await rig.until(lambda: not rig.agent.holding.has_authority)
    second = await rig.open("second")
    failed = await act(rig, second, START)
    assert "no plan was uploaded under this lease" in failed["values"]
    assert starts(rig) == 0


@pytest.mark.parametrize("service", ["mission_start", "mission_waypoint_action"])
async def test_a_plan_that_another_front_uploaded_meanwhile_is_not_flown(
    rig: Rig, service: str
) -> None:
    page = await rig.airborne()
    more = {"action": START} if "action" in service else {}
    assert (await upload(rig, page))["result"] is True
    mine = rig.front.plan
    assert mine is not None
    lease = Lease("another front of its pilot", "", rig.front.holder.number)
    await rig.front.ask(orders.UploadPlan.of(replace(mine, speed=1.0)), lease)
    failed = await answer(rig, page, service, **more)
    assert "not the one on board; nothing was started" in failed["values"]
    assert starts(rig) == 0
    assert (await upload(rig, page))["result"] is True
    assert (await answer(rig, page, service, **more))["result"] is True
    assert starts(rig) == 1


async def test_on_the_ground_it_is_not_started(rig: Rig) -> None:
    page = await rig.open()
    await upload(rig, page)
    failed = await act(rig, page, START)
    assert "ground" in failed["values"]
    assert (starts(rig), rig.aircraft.vehicle.flight.dynamics.motors_on) == (0, False)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"mission_waypoint": []}, "2 to 99 waypoints"),
        ({"idle_velocity": 11.0}, "speed"),
        ({"velocity_range": 20.0}, "max_speed"),
        ({"mission_exec_times": 0}, "repeat"),
        ({"action_on_finish": 9}, "finish_action|at_end"),
    ],
)
async def test_a_plan_that_cannot_be_flown_is_refused_at_the_upload(
    rig: Rig, values: dict[str, Any], words: str
) -> None:
    page = await rig.airborne()
    failed = await upload(rig, page, **values)
    assert failed["result"] is False
    assert re.search(words, failed["values"]), failed
    assert "no plan" in (await act(rig, page, START))["values"]


async def test_a_refusal_of_the_aircraft_has_its_code(rig: Rig) -> None:
    page = await rig.airborne()
    far = [waypoint(rig, 10, 0), waypoint(rig, 11, 0)]  # the aircraft wants 2 m
    failed = await upload(rig, page, mission_waypoint=far)
    assert failed["result"] is False
    await upload(rig, page)
    failed = await answer(rig, page, "mission_waypoint_action", action=7)
    assert "action is 0 (start)" in failed["values"]


async def test_actions_are_read_with_their_signs(rig: Rig) -> None:
    page = await rig.airborne()
    action = {
        "action_repeat": 0x12,  # two actions, once
        "command_list": [5, 1, *[0] * 14],
        "command_parameter": [0x10000 - 60, *[0] * 15],
    }
    points = [waypoint(rig, 15, 0, has_action=1, waypoint_action=action), waypoint(rig, 0, 15)]
    await upload(rig, page, mission_waypoint=points)
    await act(rig, page, START)
    await rig.until(lambda: rig.aircraft.vehicle.camera.photos == 1, within=60.0)
    assert rig.aircraft.vehicle.gimbal.pitch == pytest.approx(-60, abs=1.0)
    received = rig.aircraft.autopilot.received_commands
    point = next(one.command for one in received if isinstance(one.command, WaypointPoint))
    assert (point.has_action, point.action_count, point.parameters[0]) == (1, 2, -60)


# -- hotpoint --------------------------------------------------------------------------------------


def circle(rig: Rig, **values: Any) -> dict[str, Any]:
    settings = rig.aircraft.vehicle.settings
    frame = LocalFrame(settings.latitude_deg, settings.longitude_deg)
    latitude, longitude = frame.to_geodetic(20.0, 0.0)
    return {
        "latitude": latitude,
        "longitude": longitude,
        "altitude": 10.0,
        "radius": 10.0,
        "angular_speed": 15.0,
        "is_clockwise": 1,
        "start_point": 4,
        "yaw_mode": 1,
    } | values


def distance(rig: Rig) -> float:
    north, east = rig.aircraft.position
    return math.hypot(north - 20.0, east)


async def test_a_circle_is_flown_changed_and_stopped(rig: Rig) -> None:
    page = await rig.airborne()
    page.subscribe("/dji_sdk/mission_status")
    uploaded = await answer(rig, page, "mission_hotpoint_upload", hotpoint_task=circle(rig))
    assert uploaded == DONE | {"cmd_id": 0x20}
    info = await answer(rig, page, "mission_hotpoint_getInfo")
    assert info["hotpoint_task"] == circle(rig)
    assert rig.front.state.mission in ("", "no mission")
    started = await answer(rig, page, "mission_hotpoint_action", action=START)
    assert started == DONE | {"cmd_id": 0x20}
    await rig.until(lambda: rig.front.state.mission_status == 1)
    await anyio.sleep(5.0)
    assert distance(rig) == pytest.approx(10.0, abs=1.0)
    assert (2, 1, 0) in told(page, "mission_status")
    for service, values in (
        ("updateRadius", {"radius": 20.0}),
        ("updateYawRate", {"yaw_rate": 8.0, "direction": 0}),
        ("resetYaw", {}),
    ):
        assert (await answer(rig, page, f"mission_hotpoint_{service}", **values))["result"] is True
    await rig.until(lambda: abs(distance(rig) - 20.0) < 1.0)
    beyond = await answer(rig, page, "mission_hotpoint_updateRadius", radius=600.0)
    assert beyond["result"] is False
    assert (
        "no waypoint mission flies"
        in (await answer(rig, page, "mission_waypoint_setSpeed", speed=2.0))["values"]
    )
    stopped = await answer(rig, page, "mission_hotpoint_action", action=STOP)
    assert stopped == DONE | {"cmd_id": 0x21}
    await rig.until(lambda: rig.front.state.mission == "no mission")


async def test_a_circle_that_cannot_be_is_refused(rig: Rig) -> None:
    page = await rig.airborne()
    nothing = await answer(rig, page, "mission_hotpoint_action", action=START)
    assert "no hotpoint" in nothing["values"]
    for values in ({"radius": 4.0}, {"start_point": 9}, {"altitude": 3.0}):
        task = circle(rig, **values)
        refused = await answer(rig, page, "mission_hotpoint_upload", hotpoint_task=task)
        assert refused["result"] is False, values
    await answer(rig, page, "mission_hotpoint_upload", hotpoint_task=circle(rig, radius=400.0))
    assert (await answer(rig, page, "mission_hotpoint_action", action=START))["result"] is False
    assert rig.front.state.mission in ("", "no mission")


async def test_the_services_of_the_node_for_3_1_fly_it_too(rig: Rig) -> None:
    page = await rig.airborne()
    done = {"result": True}
    assert "no mission" in (await answer(rig, page, "mission_waypoint_download"))["values"]
    await upload(rig, page)
    info = await answer(rig, page, "mission_waypoint_getInfo")
    assert await answer(rig, page, "mission_waypoint_download") == info
    assert await answer(rig, page, "mission_start") == done
    await rig.until(lambda: is_flying(rig))
    await rig.until(lambda: rig.aircraft.position[0] > 5.0)
    # As in DJI's node 0 pauses, although the field is called pause.
    assert await answer(rig, page, "mission_pause", pause=0) == done
    await anyio.sleep(4.0)
    held = rig.aircraft.position
    await anyio.sleep(3.0)
    assert rig.aircraft.position == pytest.approx(held, abs=0.3)
    assert await answer(rig, page, "mission_waypoint_set_speed", speed=2.0) == done
    assert (await answer(rig, page, "mission_waypoint_get_speed"))["speed"] == 2.0
    assert await answer(rig, page, "mission_pause", pause=1) == done
    await rig.until(lambda: rig.aircraft.position[0] > held[0] + 2.0)
    assert "pause is 0" in (await answer(rig, page, "mission_pause", pause=2))["values"]
    assert await answer(rig, page, "mission_cancel") == done
    await rig.until(lambda: not is_flying(rig))


@pytest.mark.parametrize("service", ["mission_start", "mission_pause", "mission_cancel"])
async def test_those_services_need_control(rig: Rig, service: str) -> None:
    page = await rig.airborne()
    await upload(rig, page)
    failed = await answer(rig, rig.client("second"), service)
    assert failed["result"] is False
    assert "has control" in failed["values"]
    assert starts(rig) == 0


async def test_control_is_obtained_and_released_by_the_name_of_that_node(rig: Rig) -> None:
    page = rig.client()
    for wanted in (1, 0):
        done = await answer(rig, page, "sdk_permission_control", control_enable=wanted)
        assert done == {"result": True}
        assert rig.agent.holding.has_authority is bool(wanted)
    failed = await answer(rig, page, "sdk_permission_control", control_enable=2)
    assert "control_enable is 1" in failed["values"]


@pytest.mark.parametrize(
    ("repeat", "size", "count", "times"),
    [
        (1, 16, 3, 1),  # as DJI's nodes read it: every action, once
        (1, 15, 3, 1),
        (0, 15, 3, 0),
        (15, 16, 3, 15),
        (0x12, 16, 2, 1),  # as the later definition says: the number, and the runs above it
        (0x23, 16, 3, 2),
    ],
)
async def test_how_many_actions_there_are(
    rig: Rig, repeat: int, size: int, count: int, times: int
) -> None:
    page = await rig.airborne()
    action = {
        "action_repeat": repeat,
        "command_list": [5, 4, 1, *[0] * (size - 3)],
        "command_parameter": [-60, 0x10000 - 90, *[0] * (size - 2)],
    }
    points = [waypoint(rig, 15, 0, has_action=1, waypoint_action=action), waypoint(rig, 0, 15)]
    assert (await upload(rig, page, mission_waypoint=points))["result"] is True
    await act(rig, page, START)
    await rig.until(lambda: bool(sent(rig, WaypointPoint)))
    point = sent(rig, WaypointPoint)[0]
    assert (point.action_count, point.action_repeat) == (count, times)
    assert list(zip(point.actions, point.parameters, strict=True))[:2] == [(5, -60), (4, -90)]


async def test_a_circle_by_the_names_of_that_node(rig: Rig) -> None:
    page = await rig.airborne()
    done = {"result": True}
    await upload(rig, page)
    await answer(rig, page, "mission_hotpoint_upload", hotpoint_task=circle(rig))
    downloaded = await answer(rig, page, "mission_hotpoint_download")
    assert downloaded == {"hotpoint_task": circle(rig)}
    assert await answer(rig, page, "mission_start") == done  # what was uploaded last
    await rig.until(lambda: rig.front.state.mission_status == 1)
    assert await answer(rig, page, "mission_hotpoint_set_radius", radius=20.0) == done
    slower = await answer(rig, page, "mission_hotpoint_set_speed", speed=8.0, direction=0)
    assert slower == done
    [rate] = sent(rig, HotpointSetRate)
    assert (rate.angular_rate, rate.clockwise) == (8.0, 0)
    assert (await answer(rig, page, "mission_hotpoint_reset_yaw"))["result"] is True
    await rig.until(lambda: abs(distance(rig) - 20.0) < 1.0)
    assert await answer(rig, page, "mission_pause", pause=0) == done
    await rig.until(lambda: rig.front.state.mission_status == 2)
    assert await answer(rig, page, "mission_pause", pause=1) == done
    assert await answer(rig, page, "mission_cancel") == done
    await rig.until(lambda: rig.front.state.mission == "no mission")


async def test_a_client_is_told_how_many_of_its_plans_wait(rig: Rig) -> None:
    page, other = await rig.airborne(), rig.client("other")
    counts = ("waypoint_mission_count", "hotpoint_mission_count")
    for asked, expected in ((None, (0, 0)), ("hotpoint", (0, 1)), ("waypoint", (1, 1))):
        if asked == "hotpoint":
            await answer(rig, page, "mission_hotpoint_upload", hotpoint_task=circle(rig))
        elif asked == "waypoint":
            await upload(rig, page)
        found = await answer(rig, page, "mission_status")
        assert tuple(found[name] for name in counts) == expected
    found = await answer(rig, other, "mission_status")
    assert tuple(found[name] for name in counts) == (0, 0)
