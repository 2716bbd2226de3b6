"""The later names: standard types, REP 103 frames, services."""

from __future__ import annotations

import math
from typing import Any

import anyio
import pytest

from m100link.errors import BadSetpoint
from m100link.log.ros2 import joy_move
from m100link.protocol.setpoint import ReferenceFrame
from tests.apps.agent.conftest import task_of
from tests.apps.station.conftest import FakeClient, Rig

pytestmark = pytest.mark.anyio


async def newest(rig: Rig, client: FakeClient, topic: str) -> Any:
    client.subscribe(topic)
    await anyio.sleep(1.2)
    found = [one["msg"] for one in client.read() if one.get("topic") == topic]
    assert found, f"nothing on {topic}"
    return found[-1]


@pytest.mark.parametrize(
    ("heading", "expected"),
    [
        (0.0, (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))),  # north: 90° from east
        (90.0, (0.0, 0.0, 0.0, 1.0)),  # east: no turn
    ],
)
async def test_attitude_is_flu_in_enu(
    rig: Rig, heading: float, expected: tuple[float, ...]
) -> None:
    rig.aircraft.vehicle.flight.dynamics.yaw = math.radians(heading)
    message = await newest(rig, rig.client(), "/dji_sdk/attitude")
    q = message["quaternion"]
    got = (q["x"], q["y"], q["z"], q["w"])
    sign = math.copysign(1.0, sum(a * b for a, b in zip(got, expected, strict=True)))
    assert [sign * value for value in got] == pytest.approx(expected, abs=1e-3)
    assert message["header"]["frame_id"] == "body_FLU"
    assert message["header"]["stamp"]["secs"] > 1_600_000_000


async def test_an_imu_at_rest_feels_gravity_upwards(rig: Rig) -> None:
    message = await newest(rig, rig.client(), "/dji_sdk/imu")
    felt = message["linear_acceleration"]
    assert (felt["x"], felt["y"]) == pytest.approx((0, 0), abs=0.01)
    assert felt["z"] == pytest.approx(9.80665, abs=0.01)


async def test_a_tilted_imu_feels_the_same_push_in_other_axes(rig: Rig) -> None:
    page = await rig.airborne()
    page.subscribe("/dji_sdk/imu")
    for _ in range(30):
        page.publish("/sdk_request_ctrl", x=-15, y=0, z=0, w=0)
        await anyio.sleep(0.05)
    found = [one["msg"] for one in page.read() if one.get("topic") == "/dji_sdk/imu"][-1]
    felt = found["linear_acceleration"]
    # Only thrust pushes (drag is small): forward tilt accelerates, body z carries nearly all of it.
    assert felt["z"] > 9.0
    assert abs(felt["x"]) < 1.5
    assert found["angular_velocity"]["y"] == pytest.approx(0, abs=0.3)


async def test_position_velocity_rc_battery_and_the_rest(rig: Rig) -> None:
    rig.aircraft.move_stick(roll=0.5, throttle=-1.0)
    client = rig.client()
    fix = await newest(rig, client, "/dji_sdk/gps_position")
    assert (fix["latitude"], fix["longitude"]) == pytest.approx((22.5431, 113.9589), abs=1e-6)
    assert fix["status"] == {"status": 0, "service": 1}
    assert (await newest(rig, client, "/dji_sdk/gps_health"))["data"] == 5
    rc = await newest(rig, client, "/dji_sdk/rc")
    assert rc["axes"] == [0.5, 0.0, 0.0, -1.0, 8000.0, -4545.0]
    battery = await newest(rig, client, "/dji_sdk/battery_state")
    assert battery["percentage"] == pytest.approx(100, abs=2)
    assert battery["voltage"] is None
    assert (await newest(rig, client, "/dji_sdk/flight_status"))["data"] == 1
    for name in ("velocity", "angular_velocity_fused", "acceleration_ground_fused"):
        vector = (await newest(rig, client, f"/dji_sdk/{name}"))["vector"]
        assert [vector[axis] for axis in "xyz"] == pytest.approx([0, 0, 0], abs=0.01)
    await newest(rig, client, "/dji_sdk/gimbal_angle")
    await newest(rig, client, "/dji_sdk/height_above_takeoff")


async def test_local_position_is_east_north_up_of_its_reference(rig: Rig) -> None:
    client = rig.client()
    rig.aircraft.vehicle.flight.dynamics.place(0.0, 0.0, 5.0)
    await anyio.sleep(0.1)
    client.call("/dji_sdk/set_local_pos_ref")
    point = (await newest(rig, client, "/dji_sdk/local_position"))["point"]
    assert [point[axis] for axis in "xyz"] == pytest.approx([0, 0, 0], abs=0.05)
    rig.aircraft.vehicle.flight.dynamics.place(3.0, -2.0, 9.0)
    point = (await newest(rig, client, "/dji_sdk/local_position"))["point"]
    assert [point[axis] for axis in "xyz"] == pytest.approx([-2.0, 3.0, 4.0], abs=0.05)
    await rig.open("other")
    client.call("/dji_sdk/set_local_pos_ref")
    await anyio.sleep(0.1)
    refused = client.answers()[-1]
    assert (refused["result"], "the origin of its flight stays" in str(refused)) == (False, True)


async def test_services_activate_obtain_fly_and_release(rig: Rig) -> None:
    client = rig.client()
    for service, args in (
        ("/dji_sdk/activation", {}),
        ("/dji_sdk/sdk_control_authority", {"control_enable": 1}),
        ("/dji_sdk/drone_task_control", {"task": 4}),
    ):
        client.call(service, **args)
        before = len(client.answers())
        await rig.until(lambda n=before: len(client.answers()) > n)  # type: ignore[misc]
        assert client.answers()[-1]["result"] is True
    assert task_of(rig.agent) == "take off"  # answered when accepted, not when done
    client.call("/dji_sdk/drone_task_control", task=4)
    await rig.until(lambda: len(client.answers()) == 4)
    assert client.answers()[-1]["result"] is False  # one task at a time
    await rig.until(lambda: task_of(rig.agent) is None)
    client.publish("/dji_sdk/flight_control_setpoint_ENUvelocity_yawrate")
    joy = {"axes": [1.0, 0.0, 0.0, 0.0]}
    topic = "/dji_sdk/flight_control_setpoint_ENUvelocity_yawrate"
    for _ in range(40):
        client.send("publish", topic=topic, msg=joy)
        await anyio.sleep(0.05)
    north, east = rig.aircraft.position
    assert east > 0.8
    assert abs(north) < 0.1
    client.call("/dji_sdk/sdk_control_authority", control_enable=0)
    await rig.until(lambda: len(client.answers()) == 5)
    assert not rig.agent.holding.has_authority


async def test_a_program_that_stops_publishing_stops_moving(rig: Rig) -> None:
    page = await rig.airborne()
    topic = "/dji_sdk/flight_control_setpoint_generic"
    page.send("advertise", topic=topic, type="sensor_msgs/Joy")
    page.send("publish", topic=topic, msg={"axes": [1.0, 0.0, 0.0, 0.0, 0x48]})
    sent_at = rig.agent.now
    await rig.until(lambda: bool(rig.moves) and rig.moves[-1].pitch_or_y == 0, within=1.0)
    assert rig.agent.now - sent_at == pytest.approx(0.2, abs=0.04)


@pytest.mark.parametrize(
    "axes", [[], [1.0] * 4, [0.0] * 4 + [999.0], [0.0] * 4 + [0xC0], [None] * 5]
)
async def test_setpoints_that_are_none_are_refused(rig: Rig, axes: list[Any]) -> None:
    page = await rig.airborne()
    topic = "/dji_sdk/flight_control_setpoint_generic"
    page.send("advertise", topic=topic, type="sensor_msgs/Joy")
    page.send("publish", topic=topic, msg={"axes": axes})
    await anyio.sleep(0.1)
    assert len(page.statuses()) == 1
    assert rig.moves == []


async def test_refusals_are_answers_and_trouble_is_a_failure(rig: Rig) -> None:
    client = rig.client()
    rig.aircraft.set_rc_mode("P")
    client.call("/dji_sdk/sdk_control_authority", control_enable=1)
    await rig.until(lambda: len(client.answers()) == 1)
    assert client.answers()[0]["result"] is False
    assert client.answers()[0]["ack_data"] == 3  # the switch is not in F
    assert rig.front.state.is_activated  # DJI's node activates when it starts
    client.call("/dji_sdk/drone_task_control", task=4)
    await rig.until(lambda: len(client.answers()) == 2)
    assert "this client has no control" in client.answers()[1]["values"]
    client.call("/dji_sdk/query_drone_version")
    await rig.until(lambda: len(client.answers()) == 3)
    assert client.answers()[2] == {
        "version": 0x01000000,
        "hardware": "M100",
    }


async def test_data_of_the_app_and_to_the_app(rig: Rig) -> None:
    page = await rig.open()
    page.subscribe("/dji_sdk/from_mobile_data")
    rig.aircraft.send_from_mobile(b"\1\2\3")
    await anyio.sleep(1.0)
    assert [one["msg"]["data"] for one in page.read() if "mobile" in one.get("topic", "")] == [
        "AQID"
    ]
    page.call("/dji_sdk/send_data_to_mobile", data="AQID")
    await rig.until(lambda: len(page.answers()) == 1)
    assert rig.aircraft.app.received[-1] == b"\1\2\3"


def test_joy_frames() -> None:
    ground = joy_move(0x48, 1.0, 2.0, 3.0, math.radians(10))
    assert (ground.x, ground.y, ground.z, ground.yaw) == pytest.approx((2.0, 1.0, 3.0, -10.0))
    body = joy_move(0x4A, 1.0, 2.0, 3.0, 0.0)
    assert (body.frame, body.x, body.y) == (ReferenceFrame.BODY, 1.0, -2.0)
    tilt = joy_move(0x1A, math.radians(5), math.radians(3), 2.0, 0.0)
    assert (tilt.x, tilt.y, tilt.z) == pytest.approx((5.0, -3.0, 2.0))
    for yaw, heading in ((0.0, 90.0), (math.pi / 2, 0.0), (math.pi, -90.0)):
        assert joy_move(0x90, 0, 0, 5.0, yaw).yaw == pytest.approx(heading)
    with pytest.raises(BadSetpoint):
        joy_move(0xC0, 0, 0, 0, 0)


async def test_values_beyond_the_limits_fly_at_them_and_the_client_hears_so(rig: Rig) -> None:
    page = await rig.airborne()
    topic = "/dji_sdk/flight_control_setpoint_ENUvelocity_yawrate"
    page.send("advertise", topic=topic, type="sensor_msgs/Joy")
    page.send("set_level", level="warning")  # as rosbridge, it tells errors alone by default
    page.send("publish", topic=topic, msg={"axes": [0.0, 12.0, -5.0, -4.7]})
    await rig.until(lambda: bool(rig.moves), within=1.0)
    move = rig.moves[0]  # 12 m/s north is 10, 5 m/s down is 4, 269 °/s clockwise is 100
    sent = (move.roll_or_x, move.pitch_or_y, move.throttle_or_z, move.yaw)
    assert sent == pytest.approx((10.0, 0.0, -4.0, 100.0))
    told = "a setpoint beyond the limits of the aircraft: 10, 0, -4, 100 is flown"
    assert page.statuses() == [told]
    assert any(entry.text == f"page sent {told}" for entry in rig.agent.journal.events)
    page.call("/dji_sdk/attitude_control", flag=0x4A, x=2.0, y=0.0, z=9.0, yaw=0.0)
    await rig.until(lambda: rig.moves[-1].throttle_or_z == 4.0, within=1.0)
    assert page.answers()[-1] == {"result": True}


async def test_setpoints_that_waited_on_their_way_are_not_flown(rig: Rig) -> None:
    page = await rig.airborne()
    topic = "/dji_sdk/flight_control_setpoint_ENUvelocity_yawrate"

    def joy(sent_at: float, east: float) -> None:
        secs, part = divmod(1e9 + sent_at, 1.0)  # a clock that has nothing to do with ours
        stamp = {"secs": int(secs), "nsecs": int(part * 1e9)}
        msg = {"header": {"stamp": stamp}, "axes": [east, 0.0, 0.0, 0.0]}
        page.send("publish", topic=topic, msg=msg)

    stopped_at = rig.agent.now
    joy(stopped_at, 0.0)
    await anyio.sleep(2.0)
    count = len([move for move in rig.moves if move.pitch_or_y])
    for number in range(20):  # from before the stop, all at once
        joy(stopped_at + 0.05 * number, 1.0)
    await anyio.sleep(0.5)
    assert len([move for move in rig.moves if move.pitch_or_y]) == count
    assert any("s late" in text for text in page.statuses())
    joy(rig.agent.now, 1.0)
    page.send("publish", topic=topic, msg={"axes": [1.0, 0.0, 0.0, 0.0]})  # no stamp: not judged
    await anyio.sleep(0.2)
    assert len([move for move in rig.moves if move.pitch_or_y]) > count
