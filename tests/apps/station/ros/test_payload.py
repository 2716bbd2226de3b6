"""Gimbal, camera and motors by the names of the later node: they reach the aircraft."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from typing import Any

import anyio
import pytest

from m100link.protocol.commands.gimbal import GimbalAngle, GimbalSpeed
from m100link.sim.virtual import VirtualAircraft
from tests.apps.station.conftest import FakeClient, Rig

pytestmark = pytest.mark.anyio

HEADER = {"seq": 0, "stamp": {"secs": 0, "nsecs": 0}, "frame_id": ""}


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    async with AsyncExitStack() as stack:
        aircraft = VirtualAircraft(seed=5, firmware="3.1")
        one = await stack.enter_async_context(Rig(aircraft).running())
        await one.activated()
        yield one


def sent(rig: Rig, kind: type[Any]) -> list[Any]:
    received = rig.aircraft.autopilot.received_commands
    return [one.command for one in received if isinstance(one.command, kind)]


async def answer(rig: Rig, client: FakeClient, service: str, **args: Any) -> Any:
    before = len(client.answers())
    client.call(f"/dji_sdk/{service}", **args)
    await rig.until(lambda: len(client.answers()) > before)
    return client.answers()[-1]


def point(client: FakeClient, **degrees: float | None) -> None:
    asked = {name: degrees.pop(name, 0.0) for name in ("yaw", "pitch", "roll")}
    angles = {name: one if one is None else math.radians(one) for name, one in asked.items()}
    rest: Any = {"header": HEADER, "ts": 1, "mode": 1} | degrees | angles
    client.publish("/dji_sdk/gimbal_angle_cmd", **rest)


async def test_the_gimbal_points_where_radians_say(rig: Rig) -> None:
    page = rig.client()
    page.subscribe("/dji_sdk/gimbal_angle")
    point(page, yaw=30, pitch=-45, roll=5, ts=2)
    await anyio.sleep(2.5)
    [command] = sent(rig, GimbalAngle)
    assert command.angles_deg == pytest.approx((30, 5, -45), abs=0.05)
    assert (command.mode, command.duration_s) == (1, 2.0)
    shown = [one["msg"] for one in page.read() if one.get("topic") == "/dji_sdk/gimbal_angle"][-1]
    assert shown["vector"] == pytest.approx({"x": 5, "y": -45, "z": 30}, abs=0.2)
    point(page, pitch=10, mode=0b0110, ts=0)  # from where it looks, the others left alone
    await anyio.sleep(1.0)
    command = sent(rig, GimbalAngle)[-1]
    assert (command.mode, command.duration_s) == (0b0110, 0.1)
    assert rig.aircraft.vehicle.gimbal.pitch == pytest.approx(-35, abs=0.2)


async def test_one_rate_turns_it_for_half_a_second(rig: Rig) -> None:
    page = rig.client()
    vector: Any = {"x": 0.0, "y": math.radians(-20), "z": math.radians(40)}
    header: Any = HEADER
    page.publish("/dji_sdk/gimbal_speed_cmd", header=header, vector=vector)
    await anyio.sleep(2.0)
    [command] = sent(rig, GimbalSpeed)
    assert (command.yaw_deg_s, command.pitch_deg_s) == pytest.approx((40, -20), abs=0.1)
    gimbal = rig.aircraft.vehicle.gimbal
    assert (gimbal.yaw, gimbal.pitch) == pytest.approx((20, -10), abs=2.1)


@pytest.mark.parametrize(
    ("values", "words"),
    [({"pitch": 45}, "pitch"), ({"yaw": 400}, "yaw"), ({"pitch": None}, "pitch")],
)
async def test_what_the_gimbal_does_not_have_is_reported_and_not_sent(
    rig: Rig, values: dict[str, float | None], words: str
) -> None:
    page = rig.client()
    point(page, **values)
    await anyio.sleep(1.0)
    assert words in page.statuses()[-1]
    assert sent(rig, GimbalAngle) == []


@pytest.mark.parametrize("number", [0, 1, 2])
async def test_the_camera_is_ordered_without_control(rig: Rig, number: int) -> None:
    camera = rig.aircraft.vehicle.camera
    camera.is_recording = number == 2
    assert await answer(rig, rig.client(), "camera_action", camera_action=number) == {
        "result": True
    }
    await anyio.sleep(0.1)
    assert (camera.photos, camera.is_recording) == [(1, False), (0, True), (0, False)][number]
    assert not rig.aircraft.vehicle.authority.is_requested


async def test_a_client_without_control_does_not_turn_the_camera_of_the_holder(rig: Rig) -> None:
    flying, other = await rig.open("first"), rig.client("second")
    failed = await answer(rig, other, "camera_action", camera_action=0)
    assert failed["result"] is False
    assert "first" in failed["values"]
    point(other, pitch=-45)
    await anyio.sleep(0.5)
    assert any("first" in text for text in other.statuses())
    assert (rig.aircraft.vehicle.camera.photos, sent(rig, GimbalAngle)) == (0, [])
    assert await answer(rig, flying, "camera_action", camera_action=0) == {"result": True}
    point(flying, pitch=-45)
    await anyio.sleep(1.5)
    assert rig.aircraft.vehicle.gimbal.pitch == pytest.approx(-45, abs=0.1)


async def test_numbers_without_meaning(rig: Rig) -> None:
    page = await rig.open()
    assert "0 (photo)" in (await answer(rig, page, "camera_action", camera_action=3))["values"]
    assert "arm is 1" in (await answer(rig, page, "drone_arm_control", arm=2))["values"]


async def test_motors_need_control_and_stop_on_the_ground(rig: Rig) -> None:
    page = rig.client()
    failed = await answer(rig, page, "drone_arm_control", arm=1)
    assert failed["result"] is False
    assert "this client has no control" in failed["values"]
    page = await rig.open()
    done = {"result": True, "cmd_set": 1, "cmd_id": 5, "ack_data": 0}
    assert await answer(rig, page, "drone_arm_control", arm=1) == done
    assert rig.aircraft.vehicle.flight.dynamics.motors_on
    assert await answer(rig, page, "drone_arm_control", arm=0) == done
    assert not rig.aircraft.vehicle.flight.dynamics.motors_on


async def test_in_the_air_motors_are_not_stopped(rig: Rig) -> None:
    page = await rig.airborne()
    refused = await answer(rig, page, "drone_arm_control", arm=0)
    assert refused == {"result": False, "cmd_set": 0, "cmd_id": 0, "ack_data": 3}
    assert any("in the air" in text for text in page.statuses())
    assert rig.aircraft.vehicle.flight.dynamics.motors_on


async def test_motors_that_were_armed_stop_when_control_is_closed(rig: Rig) -> None:
    page = await rig.open()
    await answer(rig, page, "drone_arm_control", arm=1)
    page.leave()
    await rig.until(lambda: not rig.agent.holding.has_authority)
    await rig.until(lambda: not rig.aircraft.vehicle.flight.dynamics.motors_on, within=5.0)


async def test_older_firmware_says_that_it_has_none() -> None:
    async with Rig(VirtualAircraft(seed=5)).running() as rig:
        await rig.activated()
        page = rig.client()
        refused = await answer(rig, page, "camera_action", camera_action=0)
        assert refused == {"result": False}
        assert any("does not know take_photo" in text for text in page.statuses())


async def test_the_services_of_the_node_for_3_1_take_tenths(rig: Rig) -> None:
    page = rig.client()
    angles = {"yaw": 300, "roll": 50, "pitch": -450, "duration": 20, "roll_cmd_ignore": True}
    done = {"result": True}
    asked = angles | {"absolute_or_incremental": True}
    assert await answer(rig, page, "gimbal_angle_control", **asked) == done
    await anyio.sleep(2.5)
    [command] = sent(rig, GimbalAngle)
    assert (command.angles_deg, command.mode, command.duration_s) == ((30, 0, -45), 0b0101, 2.0)
    gimbal = rig.aircraft.vehicle.gimbal
    assert (gimbal.yaw, gimbal.roll, gimbal.pitch) == pytest.approx((30, 0, -45), abs=0.1)
    kept = {"roll_cmd_ignore": False, "yaw_cmd_ignore": True, "pitch_cmd_ignore": True}
    assert await answer(rig, page, "gimbal_angle_control", **angles | kept) == done
    assert await answer(rig, page, "gimbal_angle_control", roll=-50) == done
    modes = [(one.mode, one.duration_s) for one in sent(rig, GimbalAngle)[1:]]
    assert modes == [(0b1010, 2.0), (0, 0.1)]
    unmoved = {f"{axis}_cmd_ignore": True for axis in ("yaw", "roll", "pitch")}
    assert "no angle" in (await answer(rig, page, "gimbal_angle_control", **unmoved))["values"]
    rates = {"yaw_rate": 400, "roll_rate": 10, "pitch_rate": -200}
    assert await answer(rig, page, "gimbal_speed_control", **rates) == done
    [speed] = sent(rig, GimbalSpeed)
    assert speed.raw() == {"yaw": 400, "roll": 10, "pitch": -200, "flags": 0x80}
    assert await answer(rig, page, "camera_action_control", camera_action=0) == done
    assert rig.aircraft.vehicle.camera.photos == 1


@pytest.mark.parametrize(
    ("service", "values", "words"),
    [
        ("gimbal_angle_control", {"duration": 300}, "duration"),
        ("gimbal_speed_control", {"roll_rate": 1801}, "roll speed"),
    ],
)
async def test_those_services_refuse_what_the_gimbal_does_not_have(
    rig: Rig, service: str, values: dict[str, int], words: str
) -> None:
    failed = await answer(rig, rig.client(), service, **values)
    assert failed["result"] is False
    assert words in failed["values"]
    assert sent(rig, GimbalAngle) == sent(rig, GimbalSpeed) == []


@pytest.mark.parametrize(
    ("asked", "turned"),
    [
        # DJI's demo of 2016 asks for 180° up and down.
        ({"pitch": 1800}, (0, 0, 300)),
        ({"pitch": -1800}, (0, 0, -900)),
        ({"roll": 400, "yaw": -3300}, (-3200, 350, 0)),
    ],
)
async def test_the_service_of_2016_turns_as_far_as_the_gimbal_can(
    rig: Rig, asked: dict[str, int], turned: tuple[int, int, int]
) -> None:
    assert await answer(rig, rig.client(), "gimbal_angle_control", **asked) == {"result": True}
    [angles] = sent(rig, GimbalAngle)
    raw = angles.raw()
    assert (raw["yaw"], raw["roll"], raw["pitch"]) == turned


async def test_those_services_leave_the_camera_to_the_flying_client(rig: Rig) -> None:
    await rig.open("first")
    for service in ("gimbal_angle_control", "gimbal_speed_control", "camera_action_control"):
        failed = await answer(rig, rig.client("second"), service)
        assert "first" in failed["values"]
    assert sent(rig, GimbalAngle) == sent(rig, GimbalSpeed) == []
    assert rig.aircraft.vehicle.camera.photos == 0
