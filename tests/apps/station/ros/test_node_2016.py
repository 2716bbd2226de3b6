"""DJI's node of 2016 as tables: values in, values out by its source, which copies the wire.

Ground north and east, heights and climb rates upwards; body forward, right, down; quaternions
scalar first; degrees, clockwise from north. No value here is computed by the library.
"""

from __future__ import annotations

import base64
import math
import struct
from typing import Any
from unittest.mock import MagicMock

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.messages import JournalNote, MobileMessage, Steer
from m100link.apps.station.ros import node_2016
from m100link.apps.station.ros.node_2016 import TOPICS, local_of, percent, place_of
from m100link.protocol.firmware import FIRMWARE_3_1
from m100link.protocol.records import Attitude, Battery, Position, Time, Velocity
from tests.apps.agent.conftest import task_of
from tests.apps.station.conftest import FakeClient, Rig
from tests.apps.station.ros.test_values import KnownRig, agree, close, flying, header, run
from tests.known import LATITUDE, LONGITUDE, PITCH, ROLL, YAW, position, quaternion

EARTH_M = 6_378_137.0
W, X, Y, Z = quaternion(ROLL, PITCH, YAW)
WORLD, TS = header("/world"), {"ts": 123_457}
# The first good fix: 30 m south and 70 m east of the known aircraft, on DJI's sphere.
FIRST = position(
    latitude=LATITUDE - math.degrees(30.0 / EARTH_M),
    longitude=LONGITUDE + math.degrees(70.0 / EARTH_M / math.cos(math.radians(LATITUDE))),
)
LOCAL = {
    "x": pytest.approx(30.0, abs=0.01),
    "y": pytest.approx(-70.0, abs=0.01),
    "z": close(12.34),
}

PUBLISHED: dict[tuple[str, str], dict[str, Any]] = {
    ("time_stamp", "dji_sdk/TimeStamp"): {
        "header": header("/time"),
        "time": 123_457,
        "time_ns": 987_654_321,
        "sync_flag": 1,
    },
    ("attitude_quaternion", "dji_sdk/AttitudeQuaternion"): {
        "header": WORLD,
        **TS,
        **{
            name: close(value)
            for name, value in zip(("q0", "q1", "q2", "q3"), (W, X, Y, Z), strict=True)
        },
        "wx": close(0.11),
        "wy": close(-0.23),
        "wz": close(0.37),
    },
    ("global_position", "dji_sdk/GlobalPosition"): {
        "header": WORLD,
        **TS,
        "latitude": pytest.approx(LATITUDE, abs=1e-9),
        "longitude": pytest.approx(LONGITUDE, abs=1e-9),
        "altitude": close(87.65),
        "height": close(12.34),
        "health": 4,
    },
    ("local_position", "dji_sdk/LocalPosition"): {"header": WORLD, **TS, **LOCAL},
    ("velocity", "dji_sdk/Velocity"): {
        "header": WORLD,
        **TS,
        "vx": close(3.21),
        "vy": close(-1.57),
        "vz": close(0.84),
        "health_flag": 1,
    },
    ("acceleration", "dji_sdk/Acceleration"): {
        "header": WORLD,
        **TS,
        "ax": close(1.5),
        "ay": close(-2.5),
        "az": close(0.7),
    },
    ("odometry", "nav_msgs/Odometry"): {
        "header": WORLD,
        "child_frame_id": "",
        "pose": {
            "pose": {
                "position": LOCAL,
                "orientation": {"w": close(W), "x": close(X), "y": close(Y), "z": close(Z)},
            },
            "covariance": [0.0] * 36,
        },
        "twist": {
            "twist": {
                "linear": {"x": close(3.21), "y": close(-1.57), "z": close(0.84)},
                "angular": {"x": close(0.11), "y": close(-0.23), "z": close(0.37)},
            },
            "covariance": [0.0] * 36,
        },
    },
    ("gimbal", "dji_sdk/Gimbal"): {
        "header": header("/gimbal"),
        **TS,
        "mode": 0,
        "roll": close(4.5),
        "pitch": close(-37.25),
        "yaw": close(118.75),
    },
    ("rc_channels", "dji_sdk/RCChannels"): {
        "header": header("/rc"),
        **TS,
        "roll": 1000.0,
        "pitch": -2000.0,
        "yaw": 3000.0,
        "throttle": -4000.0,
        "mode": 8000.0,
        "gear": -4545.0,
    },
    # 313, -1127 and 851 in a byte, as C casts them.
    ("compass", "dji_sdk/Compass"): {"header": WORLD, **TS, "x": 57, "y": -103, "z": 83},
    ("power_status", "dji_sdk/PowerStatus"): {"percentage": 63},
    # 0x1A: device 2, requested, virtual remote on; mode 6.
    ("flight_control_info", "dji_sdk/FlightControlInfo"): {
        "control_mode": 6,
        "cur_ctrl_dev_in_navi_mode": 2,
        "serial_req_status": 1,
        "virtual_rc_status": 1,
    },
    ("flight_status", "std_msgs/UInt8"): {"data": 3},
    ("activation", "std_msgs/UInt8"): {"data": 1},
    ("data_received_from_remote_device", "dji_sdk/TransparentTransmissionData"): {
        "data": base64.b64encode(b"\x01\xfe\x80").decode()
    },
}


def told(*without: type[Any], changed: tuple[Any, ...] = (FIRST,)) -> dict[str, Any]:
    found: dict[str, Any] = {}

    async def listen(rig: KnownRig) -> None:
        page = rig.client()
        for name, kind in PUBLISHED:
            page.subscribe(f"dji_sdk/{name}", type=kind)
        await anyio.sleep(0.1)
        rig.known.tell_package(rig.front.now, changed=changed)
        await anyio.sleep(0.1)
        page.read().clear()
        rig.known.tell(rig.known.state, MobileMessage(b"\x01\xfe\x80"))
        rig.known.tell_package(rig.front.now, without=without)
        await anyio.sleep(0.1)
        found.update((one["topic"], one["msg"]) for one in page.read() if one["op"] == "publish")

    run(listen)
    return {name.removeprefix("dji_sdk/"): message for name, message in found.items()}


def test_an_aircraft_whose_numbers_all_differ_is_told_as_the_node_of_2016_did() -> None:
    found = told()
    assert found.keys() == {name for name, _ in PUBLISHED}
    for (name, _), expected in PUBLISHED.items():
        agree(found[name], expected, name)


@pytest.mark.parametrize(
    ("record", "silent"),
    [
        (Attitude, {"attitude_quaternion", "odometry"}),
        (Velocity, {"velocity", "odometry"}),
        (Position, {"global_position", "local_position", "odometry"}),
        (Battery, {"power_status"}),
        (Time, {"time_stamp"}),
    ],
)
def test_what_a_package_has_not_is_not_told(record: type[Any], silent: set[str]) -> None:
    assert {name for name, _ in PUBLISHED} - told(record).keys() == silent


def test_a_name_of_two_generations_has_the_type_that_a_client_asks_for() -> None:
    async def listen(rig: KnownRig) -> None:
        earlier, later, silent = rig.client(), rig.client(), rig.client()
        name = "/dji_sdk/velocity"
        earlier.subscribe("/dji_sdk/velocity", type="dji_sdk/Velocity")
        later.subscribe("/dji_sdk/velocity", type="geometry_msgs/Vector3Stamped")
        silent.subscribe("/dji_sdk/velocity")
        silent.subscribe("/dji_sdk/velocity", type="dji_sdk/Velocity")
        silent.subscribe("/dji_sdk/local_position", type="std_msgs/Bool")
        await anyio.sleep(0.1)
        rig.known.tell_package(rig.front.now)
        await anyio.sleep(0.1)
        [one] = [one["msg"] for one in earlier.read()]
        assert one["vx"] == close(3.21)
        [one] = [one["msg"] for one in later.read()]
        assert one["vector"]["x"] == close(-1.57)
        assert [one["msg"]["vector"]["y"] for one in silent.read() if one["op"] == "publish"] == [
            close(3.21)
        ]
        assert silent.statuses() == [
            f"'{name}' is subscribed as geometry_msgs/Vector3Stamped already, not dji_sdk/Velocity",
            "/dji_sdk/local_position is of type geometry_msgs/PointStamped, not std_msgs/Bool",
        ]

    run(listen)


@pytest.mark.parametrize(("health", "counts"), [(0, False), (3, False), (4, True), (5, True)])
def test_local_positions_count_from_the_first_good_fix(health: int, counts: bool) -> None:
    """Firmware 3.1 wants a health above 3. At 3 the node publishes nothing."""

    async def listen(rig: KnownRig) -> None:
        page = rig.client()
        page.subscribe("/dji_sdk/local_position", type="dji_sdk/LocalPosition")
        await anyio.sleep(0.1)
        rig.known.tell_package(rig.front.now, changed=(position(health=health),))
        await anyio.sleep(0.1)
        assert len(page.read()) == int(counts)

    run(listen)


@pytest.mark.parametrize(
    ("place", "north", "east"),
    [
        # 0.001° is 111.3195 m of DJI's sphere; along a parallel at 60° it is half of that.
        ((60.001, 10.0), 111.3195, 0.0),
        ((60.0, 10.001), 0.0, 55.6597),
        ((60.0, 9.999), 0.0, -55.6597),
    ],
)
def test_places_and_offsets_on_the_sphere_of_that_node(
    place: tuple[float, float], north: float, east: float
) -> None:
    assert local_of((60.0, 10.0), place) == pytest.approx((north, east), abs=1e-3)
    assert place_of((60.0, 10.0), north, east) == pytest.approx(place, abs=1e-7)


@pytest.mark.parametrize(
    ("start", "now", "target", "done"),
    [
        (0.0, 0.0, 10.0, 0),
        (0.0, 2.5, 10.0, 25),
        (0.0, 9.95, 10.0, 100),  # within 0.1
        (0.0, -5.0, 10.0, 0),  # the wrong way
        (10.0, 2.0, 0.0, 80),
        (4.0, 5.0, 4.0, 0),  # there from the beginning, and blown away
        (0.0, 0.05, 0.05, 100),
    ],
)
def test_progress_is_percent_of_the_way(start: float, now: float, target: float, done: int) -> None:
    assert percent(start, now, target, 0.1) == done


# Service, request, and the movement command: flag, x, y, z, yaw, as on the wire.
STEERED: list[tuple[str, dict[str, Any], tuple[float, ...]]] = [
    (
        "attitude_control",
        {"flag": 0x40, "x": 1.5, "y": -2.5, "z": 0.5, "yaw": 90.0},
        (0x40, 1.5, -2.5, 0.5, 90.0),
    ),
    (
        "attitude_control",
        {"flag": 0x0A, "x": 5.0, "y": -7.0, "z": 0.5, "yaw": 20.0},
        (0x0A, 5.0, -7.0, 0.5, 20.0),
    ),
    (
        "attitude_control",
        {"flag": 0x83, "x": 2.0, "y": 3.0, "z": 0.0, "yaw": 0.0},
        (0x83, 2.0, 3.0, 0.0, 0.0),
    ),
    (
        "attitude_control",
        {"flag": 0x2A, "x": 2.0, "y": 3.0, "z": 45.0, "yaw": -9.0},
        (0x2A, 2.0, 3.0, 45.0, -9.0),
    ),
    (
        "velocity_control",
        {"frame": 1, "vx": 1.5, "vy": -2.5, "vz": 0.5, "yawRate": 20.0},
        (0x49, 1.5, -2.5, 0.5, 20.0),
    ),
    (
        "velocity_control",
        {"frame": 0, "vx": 1.5, "vy": -2.5, "vz": 0.5, "yawRate": -20.0},
        (0x4B, 1.5, -2.5, 0.5, -20.0),
    ),
    (  # beyond the limits: as far as they go
        "velocity_control",
        {"frame": 1, "vx": 10.5, "vy": -12.0, "vz": 4.5, "yawRate": 120.0},
        (0x49, 10.0, -10.0, 4.0, 100.0),
    ),
    # The aircraft is 30 m south and 70 m east of the origin: 5 m less, and 3 m more to the east.
    (
        "local_position_control",
        {"x": -25.0, "y": 73.0, "z": 20.5, "yaw": 45.0},
        (0x90, 5.0, 3.0, 20.5, 45.0),
    ),
    (
        "global_position_control",
        {"latitude": LATITUDE + 0.0001, "longitude": LONGITUDE, "altitude": 20.5, "yaw": -45.0},
        (0x90, 41.13195, -70.0, 20.5, -45.0),
    ),
]


def steered(service: str, request: dict[str, Any]) -> tuple[list[Steer], Any, KnownRig]:
    async def call(rig: KnownRig, page: FakeClient) -> None:
        rig.known.tell_package(rig.front.now, changed=(FIRST,))
        await anyio.sleep(0.01)
        page.call(f"/dji_sdk/{service}", **request)

    rig = flying(call)
    return rig.known.asked(Steer), rig.page.answers()[-1], rig


@pytest.mark.parametrize(("service", "request_", "expected"), STEERED)
def test_a_setpoint_service_is_flown_as_the_wire_has_it(
    service: str, request_: dict[str, Any], expected: tuple[float, ...]
) -> None:
    [steer], answer, _ = steered(service, request_)
    found = struct.unpack("<B4f", steer.setpoint.value(FIRMWARE_3_1))
    assert found == pytest.approx(expected, abs=0.01)
    assert (steer.fence, steer.lifetime, answer) == (7, 0.2, {"result": True})


@pytest.mark.parametrize(
    ("service", "request_"),
    [
        ("attitude_control", {"flag": 0xC0}),
        ("attitude_control", {"flag": 0x40, "x": None}),
        ("local_position_control", {"z": -1.0}),
    ],
)
def test_a_setpoint_that_means_nothing_is_not_flown(service: str, request_: dict[str, Any]) -> None:
    steers, answer, rig = steered(service, request_)
    assert (steers, answer, len(rig.page.statuses())) == ([], {"result": False}, 1)


def test_a_place_is_not_flown_to_while_gps_is_bad_or_old() -> None:
    async def call(rig: KnownRig, page: FakeClient) -> None:
        rig.known.tell_package(rig.front.now, changed=(position(health=2),))
        page.call("/dji_sdk/global_position_control", latitude=LATITUDE, longitude=LONGITUDE)
        rig.known.tell_package(rig.front.now)
        await anyio.sleep(0.6)
        page.call("/dji_sdk/local_position_control")

    rig = flying(call)
    assert rig.known.asked(Steer) == []
    assert rig.page.answers()[-2:] == [{"result": False}] * 2


@pytest.mark.parametrize(
    ("service", "request_"),
    [
        ("virtual_rc_enable_control", {"enable": 1, "if_back_to_real": 1}),
        ("virtual_rc_data_control", {"channel_data": [1024] * 16}),
        ("sync_flag_control", {"frequency": 50}),
        ("message_frequency_control", {"frequency": [1] * 16}),
        ("mission_followme_upload", {}),
        ("mission_followme_set_target", {}),
    ],
)
def test_what_the_station_does_not_do_is_answered_so(
    service: str, request_: dict[str, Any]
) -> None:
    _, answer, rig = steered(service, request_)
    assert answer == {"result": False}
    [said] = rig.page.statuses()
    assert said.startswith(f"/dji_sdk/{service} does nothing here")


def test_the_version_is_asked_and_data_go_to_the_phone() -> None:
    async def call(rig: KnownRig, page: FakeClient) -> None:
        page.call("/dji_sdk/version_check")
        page.call("/dji_sdk/send_data_to_remote_device", data=[1, 254])

    rig = flying(call)
    assert rig.page.answers()[-2:] == [{"result": True}] * 2
    assert rig.known.asked(orders.AskVersion)
    assert rig.known.asked(orders.SendToMobile) == [orders.SendToMobile(b"\x01\xfe")]


def test_people_hear_that_setpoints_are_refused_and_how_many() -> None:
    async def publish(rig: KnownRig) -> None:
        page = rig.client("a page")
        for _ in range(1250):  # 25 s of a program without control
            page.publish("/dji_sdk/flight_control_setpoint_ENUvelocity_yawrate", axes=[1.0] * 4)  # type: ignore[arg-type]
            rig.known.tell(rig.known.state)
            await anyio.sleep(0.02)
        notes = [one.text for one in rig.known.heard if isinstance(one, JournalNote)]
        begin = "a page is refused: this client has no control; nothing was sent"
        assert notes[0] == begin
        counts = [int(one.removeprefix(begin).split()[0].lstrip("(")) for one in notes[1:]]
        assert counts == [pytest.approx(500, abs=3), pytest.approx(1000, abs=3)]

    run(publish)


def test_many_refused_clients_do_not_push_out_the_events_of_others() -> None:
    async def publish(rig: KnownRig) -> None:
        for number in range(100):
            page = rig.client(f"page {number}")
            page.publish("/sdk_request_ctrl", x=1.0, y=0.0, z=0.0, w=0.0)
            await anyio.sleep(0.01)
        assert len([one for one in rig.known.heard if isinstance(one, JournalNote)]) <= 5

    run(publish)


pytestmark = pytest.mark.anyio


async def test_a_program_of_2016_activates_obtains_takes_off_and_flies(rig: Rig) -> None:
    """As DJI's client does it: the node activates itself, and setpoints are calls at 50 Hz."""
    client = rig.client()
    client.subscribe("/dji_sdk/local_position", type="dji_sdk/LocalPosition")
    client.call("/dji_sdk/sdk_permission_control", control_enable=1)
    await rig.until(lambda: client.answers() == [{"result": True}])
    client.call("/dji_sdk/drone_task_control", task=4)
    await rig.until(lambda: task_of(rig.agent) is not None)
    await rig.until(lambda: task_of(rig.agent) is None)
    for _ in range(100):
        client.call("/dji_sdk/velocity_control", frame=1, vx=2.0, vy=-1.0, vz=0.5, yawRate=0.0)
        await anyio.sleep(0.02)
    north, east = rig.aircraft.position
    assert north > 2.0
    assert east < -1.0
    await rig.until(lambda: bool(rig.moves) and rig.moves[-1].roll_or_x == 0, within=1.0)
    told = [one["msg"] for one in client.read() if one.get("topic", "").endswith("_position")][-1]
    north, east = rig.aircraft.position
    assert (told["x"], told["y"]) == pytest.approx((north, east), abs=0.5)
    assert told["z"] == pytest.approx(rig.aircraft.height, abs=0.5)


def test_every_topic_of_a_package_is_in_the_table() -> None:
    assert TOPICS.keys() <= {name for name, _ in PUBLISHED}


def test_each_action_flies_what_its_name_says(monkeypatch: pytest.MonkeyPatch) -> None:
    served: dict[str, str] = {}

    def action(
        agent: object, graph: object, clients: object, name: str, kind: str, do: Any
    ) -> None:
        served[name.removeprefix("/dji_sdk/").removesuffix("_action")] = f"{kind} {do.__name__}"

    monkeypatch.setattr(node_2016, "ActionServer", action)
    monkeypatch.setattr(node_2016, "WebGroundStation", lambda *_: None)
    node_2016.Node2016(MagicMock(), MagicMock(), MagicMock())
    assert served == {
        "drone_task": "dji_sdk/DroneTask _do_task",
        "local_position_navigation": "dji_sdk/LocalPositionNavigation _go_local",
        "global_position_navigation": "dji_sdk/GlobalPositionNavigation _go_global",
        "waypoint_navigation": "dji_sdk/WaypointNavigation _go_waypoints",
    }
