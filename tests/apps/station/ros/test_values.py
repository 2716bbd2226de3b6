"""What rosbridge tells and takes, as tables: values in, values out by DJI's nodes and REP 103.

DJI's node of June 2015 has the topics without a prefix; that of 2018, for the Matrice 100, those of
``/dji_sdk``: ENU and FLU, m, rad, s; the gimbal's angles in degrees of the wire, mode and gear of
the remote raw. Services that both later nodes have differ in their units: 3.1 counts in tenths of
a degree. No value here is computed by the library.
"""

from __future__ import annotations

import base64
import math
import struct
import time
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import replace
from functools import cache
from typing import Any

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.messages import (
    Activating,
    Ask,
    AuthorityTaken,
    Event,
    MissionReport,
    MobileMessage,
    RemoteError,
    State,
    Steer,
    Telemetry,
)
from m100link.apps.agent.orders import CameraUse, Order
from m100link.apps.agent.transports import memory_channels
from m100link.apps.station.ros.dji_sdk import DjiSdk
from m100link.apps.station.ros.graph import Graph, add_rosout
from m100link.apps.station.ros.leases import Clients
from m100link.apps.station.ros.node_2015 import Node2015
from m100link.errors import AuthorityLost
from m100link.protocol.firmware import FIRMWARE_3_1
from m100link.protocol.records import (
    Acceleration,
    AngularVelocity,
    Attitude,
    Battery,
    ControlDevice,
    FlightStatus,
    Gimbal,
    Position,
    RemoteControl,
    Velocity,
)
from m100link.sim.clock import virtual_clock_loop
from tests.apps.station.conftest import FakeClient, Rig
from tests.known import (
    HOTPOINT,
    LATITUDE,
    LONGITUDE,
    MISSION,
    POINT,
    STICKS_ALONE,
    KnownAgent,
    angles,
    felt,
    position,
    quaternion,
    rates,
)

NAN = math.nan


class KnownRig(Rig):
    """The nodes, and a played agent instead of an aircraft."""

    page: FakeClient

    def __init__(self) -> None:
        self.graph = Graph()

    @asynccontextmanager
    async def running(self) -> AsyncIterator[KnownRig]:
        ours, its = memory_channels(as_bytes=True)
        self.known = KnownAgent(its)
        async with AgentClient(ours, "station") as self.front:
            self.agent = self.front  # type: ignore[assignment]  # clients ask it for the time alone
            clients = Clients(self.front, self.graph)
            Node2015(self.front, self.graph, clients)
            DjiSdk(self.front, self.graph, clients)
            add_rosout({"m100": self.front}, self.graph)
            yield self


def run(work: Callable[[KnownRig], Any]) -> KnownRig:
    rig = KnownRig()

    async def all_of_it() -> None:
        async with rig.running():
            await work(rig)

    anyio.run(all_of_it, backend_options={"loop_factory": virtual_clock_loop})
    return rig


# -- what it tells --------------------------------------------------------------------------------

# Metres per radian along the meridian and the parallel, on the ellipsoid of WGS 84.
_SQUEEZED = 1.0 - 0.00669437999014 * math.sin(math.radians(LATITUDE)) ** 2
NORTH_M = 6_378_137.0 * (1.0 - 0.00669437999014) / _SQUEEZED**1.5
EAST_M = 6_378_137.0 / math.sqrt(_SQUEEZED) * math.cos(math.radians(LATITUDE))
FIRST = position(  # 30 m south and 70 m east of the known aircraft, and 32.15 m lower
    latitude=LATITUDE - math.degrees(30.0 / NORTH_M),
    longitude=LONGITUDE + math.degrees(70.0 / EAST_M),
    altitude=55.5,
)

MISSION_FLIES = State(
    0.0,
    connection="connected",
    firmware="3.1",
    is_activated=True,
    has_authority=True,
    mission="waypoint mission",
    mission_index=3,
    mission_status=6,
)


def close(value: float) -> Any:
    return pytest.approx(value, rel=2e-7, abs=2e-7)


def xyz(*values: float) -> dict[str, Any]:
    return {name: close(value) for name, value in zip("xyz", values, strict=True)}


def header(frame: str) -> dict[str, Any]:
    return {"frame_id": frame}


_W, *_XYZ = quaternion(10.0, 20.0, 90.0 + 130.0 - 360.0)
ORIENTATION = xyz(*_XYZ) | {"w": close(_W)}
ZEROS = [0.0] * 9
"""A covariance that nobody knows."""

# JSON has no NaN: what is not known is null.
BATTERY: dict[str, Any] = {
    "header": header(""),
    **dict.fromkeys(("voltage", "current", "charge", "capacity", "design_capacity")),
    **dict.fromkeys(("power_supply_status", "power_supply_health"), 0),
    "power_supply_technology": 0,
    "present": True,
    "cell_voltage": [],
    "location": "",
    "serial_number": "",
}

PUBLISHED_2016 = {
    f"/dji_sdk/{one}"
    for one in (
        *("time_stamp", "attitude_quaternion", "global_position", "local_position", "velocity"),
        *("acceleration", "odometry", "gimbal", "rc_channels", "compass", "power_status"),
        *("flight_control_info", "activation", "data_received_from_remote_device"),
        *("A3_GPS", "A3_RTK"),
    )
}
SERVICES_2016 = {
    *("attitude_control", "velocity_control", "local_position_control", "version_check"),
    *("global_position_control", "virtual_rc_enable_control", "virtual_rc_data_control"),
    *("sync_flag_control", "message_frequency_control", "send_data_to_remote_device"),
    *("mission_followme_upload", "mission_followme_set_target"),
}
"""Of the node of 2016: the values are in ``test_node_2016.py``."""

PUBLISHED: dict[str, dict[str, Any]] = {
    "/dji_sdk/attitude": {"header": header("body_FLU"), "quaternion": ORIENTATION},
    "/dji_sdk/imu": {
        "header": header("body_FLU"),
        "orientation": ORIENTATION,
        "orientation_covariance": ZEROS,
        "angular_velocity": xyz(0.11, 0.23, -0.37),
        "angular_velocity_covariance": ZEROS,
        "linear_acceleration": xyz(felt()[0], -felt()[1], -felt()[2]),
        "linear_acceleration_covariance": ZEROS,
    },
    "/dji_sdk/gps_position": {
        "header": header("gps"),
        "status": {"status": 0, "service": 1},
        "latitude": pytest.approx(LATITUDE, abs=1e-9),
        "longitude": pytest.approx(LONGITUDE, abs=1e-9),
        "altitude": close(87.65),
        "position_covariance": ZEROS,
        "position_covariance_type": 0,
    },
    "/dji_sdk/gps_health": {"data": 4},
    "/dji_sdk/height_above_takeoff": {"data": close(12.34)},
    # East, north and up of where set_local_pos_ref was called; up by the altitudes.
    "/dji_sdk/local_position": {
        "header": header("/local"),
        "point": {
            "x": pytest.approx(-70.0, abs=0.01),
            "y": pytest.approx(30.0, abs=0.01),
            "z": pytest.approx(32.15, abs=1e-4),
        },
    },
    "/dji_sdk/velocity": {"header": header("ground_ENU"), "vector": xyz(-1.57, 3.21, 0.84)},
    "/dji_sdk/angular_velocity_fused": {
        "header": header("body_FLU"),
        "vector": xyz(0.11, 0.23, -0.37),
    },
    "/dji_sdk/acceleration_ground_fused": {
        "header": header("ground_ENU"),
        "vector": xyz(-2.5, 1.5, 0.7),
    },
    # Roll, pitch, yaw, throttle of -1 to 1; mode and gear raw.
    "/dji_sdk/rc": {
        "header": header("rc"),
        "axes": [close(one) for one in (0.1, -0.2, 0.3, -0.4, 8000.0, -4545.0)],
        "buttons": [],
    },
    # Roll, pitch, yaw in degrees.
    "/dji_sdk/gimbal_angle": {"header": header("ground_ENU"), "vector": xyz(4.5, -37.25, 118.75)},
    "/dji_sdk/flight_status": {"data": 3},
    # 0 to 100, as DJI's node has it, and 0 to 1, as the standard has it.
    "/dji_sdk/battery_state": {"percentage": close(63.0)} | BATTERY,
    "/m100link/battery_state": {"percentage": close(0.63)} | BATTERY,
    "/dji_sdk/from_mobile_data": {"data": base64.b64encode(b"\x01\xfe\x80").decode()},
    # As the push 0x02/0x03: kind 1 is a waypoint mission; target, status.
    "/dji_sdk/mission_status": {"type": 1, "data_1": 3, "data_2": 6}
    | dict.fromkeys(("data_3", "data_4", "data_5"), 0),
    # As the push 0x02/0x04.
    "/dji_sdk/mission_event": {"type": 2, "data_1": 9, "data_2": 4, "data_3": 7, "data_4": 8}
    | {"data_5": 6},
    "/flight_status": {"data": 3.0},
    "/battery_status": {"data": 63.0},  # percent
    "/test_fre": {"data": 26.0},  # the control byte as it is
    "/activation_status": {"data": 5.0},  # the code of the aircraft
    "/nav_open_close_status": {"data": 4.0},  # the app took control
    # Of rosgraph_msgs/Log: 2 is information, 4 a warning, 8 an error.
    "/rosout": {
        "header": {"frame_id": "", "seq": 11},
        "level": 4,
        "name": "/m100link",
        "msg": "a bird",
        "file": "",
        "function": "",
        "line": 0,
        "topics": [],
    },
}


@cache
def told(without: tuple[type[Any], ...] = (), changed: tuple[Any, ...] = ()) -> dict[str, Any]:
    """The newest message of each topic after a package of the known aircraft."""
    found: dict[str, Any] = {}

    async def listen(rig: KnownRig) -> None:
        page = rig.client()
        await anyio.sleep(0.5)
        rig.known.tell_package(rig.front.now, changed=(FIRST,))
        page.call("/dji_sdk/set_local_pos_ref")
        await anyio.sleep(0.1)
        assert page.answers() == [{"result": True}]
        page.subscribe(*PUBLISHED)
        rig.known.tell(MISSION_FLIES, MobileMessage(b"\x01\xfe\x80"))
        rig.known.tell(MissionReport(2, bytes((9, 4, 7, 8, 6))), Activating(5))
        rig.known.tell(AuthorityTaken(RemoteError.of(AuthorityLost("the app took it"))))
        rig.known.tell(Event(11, 0.5, "warning", "a bird"))
        rig.known.tell_package(rig.front.now, without=without, changed=changed)
        await anyio.sleep(1.1)
        found.update((one["topic"], one["msg"]) for one in page.read() if one["op"] == "publish")

    run(listen)
    return found


def agree(found: Any, expected: Any, path: str = "", *, is_whole: bool = True) -> None:
    if not isinstance(expected, Mapping):
        assert found == expected, path
        return
    if is_whole:
        extra = {"seq", "stamp"} if path.endswith("header") else set()
        assert found.keys() - extra == expected.keys() - extra, path
    for name, value in expected.items():
        agree(found[name], value, f"{path}.{name}")


def test_the_table_has_every_topic() -> None:
    rig = run(lambda _: anyio.sleep(0.0))
    there = {one.name for one in rig.graph.all_topics() if one.on_publish is None}
    assert {one for one in there if "_action/" not in one} == PUBLISHED.keys() | PUBLISHED_2016


@pytest.mark.parametrize("name", PUBLISHED)
def test_what_is_reported_of_an_aircraft_whose_numbers_all_differ(name: str) -> None:
    found = told()[name]
    if "quaternion" in found or "orientation" in found:
        turned = found.get("quaternion") or found["orientation"]
        if turned["w"] < 0.0:  # the same rotation
            turned.update((axis, -value) for axis, value in turned.items())
    agree(found, PUBLISHED[name])
    if "header" in found:
        stamp = found["header"]["stamp"]
        assert stamp["secs"] + stamp["nsecs"] * 1e-9 == pytest.approx(time.time(), abs=3600)


@pytest.mark.parametrize(
    ("record", "silent"),
    [
        (Attitude, {"attitude", "imu"}),
        (AngularVelocity, {"imu", "angular_velocity_fused"}),
        (Acceleration, {"imu", "acceleration_ground_fused"}),
        (Velocity, {"velocity"}),
        (Position, {"gps_position", "gps_health", "height_above_takeoff", "local_position"}),
        (RemoteControl, {"rc"}),
        (Gimbal, {"gimbal_angle"}),
        (FlightStatus, {"flight_status"}),
    ],
)
def test_what_a_package_has_not_is_not_reported(record: type[Any], silent: set[str]) -> None:
    found = told((record,))
    assert PUBLISHED.keys() - found.keys() == {f"/dji_sdk/{one}" for one in silent}


def test_a_package_without_a_battery_tells_none() -> None:
    names = {"/dji_sdk/battery_state", "/m100link/battery_state"}
    assert PUBLISHED.keys() - told((Battery,)).keys() == names


def test_without_a_control_byte_there_is_none() -> None:
    assert "/test_fre" not in told((ControlDevice,))


@pytest.mark.parametrize(("health", "fix"), [(0, -1), (2, -1), (3, 0), (5, 0)])
def test_a_fix_is_one_from_health_three(health: int, fix: int) -> None:
    found = told(changed=(position(health=health),))
    assert found["/dji_sdk/gps_position"]["status"]["status"] == fix


@pytest.mark.parametrize("place", [position(latitude=NAN), position(latitude=89.5)])
def test_what_cannot_be_a_place_is_no_fix(place: Position) -> None:
    found = told(changed=(place,))
    assert found["/dji_sdk/gps_position"]["status"]["status"] == -1
    assert "/dji_sdk/local_position" not in found


@pytest.mark.parametrize("percent", [101, 200])
def test_a_battery_of_more_than_all_is_not_known(percent: int) -> None:
    found = told(changed=(Battery(percent),))
    assert found["/dji_sdk/battery_state"]["percentage"] is None


def test_a_gear_that_nobody_tells_is_not_made_up() -> None:
    async def listen(rig: KnownRig) -> None:
        page = rig.client()
        page.subscribe("/dji_sdk/rc")
        await anyio.sleep(0.1)
        rig.known.tell(Telemetry(STICKS_ALONE, "1.0-document", 0.0))
        await anyio.sleep(0.1)
        [one] = [one["msg"] for one in page.read() if one["op"] == "publish"]
        assert one["axes"] == [0.1, -0.2, 0.3, -0.4, 8000.0, None]

    run(listen)


@pytest.mark.parametrize(("level", "number"), [("info", 2), ("warning", 4), ("error", 8)])
def test_levels_are_those_of_rosgraph(level: str, number: int) -> None:
    async def listen(rig: KnownRig) -> None:
        page = rig.client()
        page.subscribe("/rosout")
        rig.known.tell(Event(1, 0.0, level, "a bird"))
        await anyio.sleep(0.1)
        [one] = [one["msg"] for one in page.read() if one["op"] == "publish"]
        assert (one["level"], one["header"]["seq"]) == (number, 1)

    run(listen)


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        ("no mission", (0, 6, 0)),
        ("waypoint mission", (1, 3, 6)),
        ("hotpoint", (2, 6, 0)),
        ("follow mission", (3, 6, 0)),
        ("IOC", (4, 6, 0)),
        ("", None),
    ],
)
def test_a_mission_is_reported_as_the_aircraft_pushes_it(kind: str, values: Any) -> None:
    async def listen(rig: KnownRig) -> None:
        page = rig.client()
        page.subscribe("/dji_sdk/mission_status")
        rig.known.tell(replace(MISSION_FLIES, mission=kind))
        await anyio.sleep(0.4)
        found = [one["msg"] for one in page.read() if one["op"] == "publish"]
        assert [(one["type"], one["data_1"], one["data_2"]) for one in found] == (
            [] if values is None else [values]
        )

    run(listen)


def test_nothing_is_reported_of_an_aircraft_that_is_gone() -> None:
    """As before the first package: zeros."""

    async def listen(rig: KnownRig) -> None:
        page = rig.client()
        rig.known.tell_package(-0.3)
        page.subscribe("/flight_status", "/battery_status")
        for _ in range(6):
            await anyio.sleep(1.01)
            rig.known.tell(rig.known.state)
        assert page.values("/flight_status") == [3.0, 3.0, 0.0, 0.0, 0.0, 0.0]
        assert page.values("/battery_status") == [63.0, 63.0, 63.0, 63.0, 0.0, 0.0]

    run(listen)


def test_nothing_is_reported_of_an_aircraft_whose_agent_hangs() -> None:
    async def listen(rig: KnownRig) -> None:
        page = rig.client()
        rig.known.tell_package(0.0)
        page.subscribe("/flight_status", "/battery_status")
        await anyio.sleep(3.1)
        assert page.values("/battery_status") == [63.0, 63.0, 0.0]
        assert page.values("/flight_status") == [3.0, 3.0, 0.0]

    run(listen)


# -- what it takes --------------------------------------------------------------------------------


def flying(work: Callable[[KnownRig, FakeClient], Any], settle: float = 0.1) -> KnownRig:
    """A rig after a client that has control did something."""

    async def do(rig: KnownRig) -> None:
        page = rig.client()
        rig.known.tell_package(0.0)
        page.call("/dji_sdk/sdk_control_authority", control_enable=1)
        await anyio.sleep(0.1)
        assert page.answers()[-1]["result"], page.answers()
        rig.known.heard.clear()
        await work(rig, page)
        await anyio.sleep(settle)
        page.read()
        rig.page = page

    return run(do)


def flown(topic: str, *messages: dict[str, Any]) -> tuple[list[Steer], list[str]]:
    """The setpoints that these messages become, and what the client hears."""

    async def publish(rig: KnownRig, page: FakeClient) -> None:
        for message in messages:
            page.publish(topic, **message)

    rig = flying(publish)
    return rig.known.asked(Steer), rig.page.statuses()


GENERIC = "generic"
CLOCKWISE = -28.64789  # °/s of half a radian to the left
# Axes in; out the movement command of DJI's document: flag, then north or forward, east or right
# (m/s, m) or roll, pitch (°), then up (m/s), height (m) or thrust (%), then a heading from north,
# clockwise (°), or a rate (°/s). By DJI's node: ground x and y change places, y and yaw their sign.
JOYS: list[tuple[str, list[float], tuple[float, ...]]] = [
    ("ENUvelocity_yawrate", [1.5, 2.5, 0.75, 0.5], (0x48, 2.5, 1.5, 0.75, CLOCKWISE)),
    ("ENUposition_yaw", [1.5, 2.5, 20.5, 0.5], (0x90, 2.5, 1.5, 20.5, 61.35211)),
    ("ENUposition_yaw", [1.5, 2.5, 20.5, 3.0], (0x90, 2.5, 1.5, 20.5, -81.88734)),
    ("ENUposition_yaw", [1.5, 2.5, 20.5, -2.5], (0x90, 2.5, 1.5, 20.5, -126.76055)),
    (
        "rollpitch_yawrate_zposition",
        [0.2, 0.1, 20.5, 0.5],
        (0x1A, 11.45916, -5.72958, 20.5, CLOCKWISE),
    ),
    (GENERIC, [1.5, 2.5, 0.75, 0.5, 0x48], (0x48, 2.5, 1.5, 0.75, CLOCKWISE)),
    (GENERIC, [1.5, 2.5, 0.75, 0.5, 0x49], (0x48, 2.5, 1.5, 0.75, CLOCKWISE)),
    (GENERIC, [1.5, 2.5, 0.75, 0.5, 0x4A], (0x4A, 1.5, -2.5, 0.75, CLOCKWISE)),
    (GENERIC, [1.5, 2.5, 0.75, 0.5, 0x40], (0x40, 2.5, 1.5, 0.75, 61.35211)),
    (GENERIC, [1.5, 2.5, 20.5, 0.5, 0x5A], (0x5A, 1.5, -2.5, 20.5, CLOCKWISE)),
    (GENERIC, [1.5, 2.5, 0.75, 0.5, 0x8A], (0x8A, 1.5, -2.5, 0.75, CLOCKWISE)),
    (GENERIC, [0.2, 0.1, 55.5, 0.5, 0x2A], (0x2A, 11.45916, -5.72958, 55.5, CLOCKWISE)),
    # DJI's node reads four axes, whatever follows. Of three it reads a yaw behind the message:
    # here the nose stays, by a rate of zero.
    ("ENUvelocity_yawrate", [1.5, 2.5, 0.75, 0.5, 9.0], (0x48, 2.5, 1.5, 0.75, CLOCKWISE)),
    ("ENUvelocity_yawrate", [1.5, 2.5, 0.75], (0x48, 2.5, 1.5, 0.75, 0.0)),
    ("ENUposition_yaw", [1.5, 2.5, 20.5], (0x98, 2.5, 1.5, 20.5, 0.0)),
    ("rollpitch_yawrate_zposition", [0.2, 0.1, 20.5], (0x1A, 11.45916, -5.72958, 20.5, 0.0)),
    # Tilt is of the body, whatever the flag says.
    (GENERIC, [0.2, 0.1, 0.75, 0.5, 0x08], (0x0A, 11.45916, -5.72958, 0.75, CLOCKWISE)),
]


@pytest.mark.parametrize(("name", "axes", "expected"), JOYS)
def test_a_joy_is_flown_with_its_signs_in_its_frame(
    name: str, axes: list[float], expected: tuple[float, ...]
) -> None:
    [steer], said = flown(f"/dji_sdk/flight_control_setpoint_{name}", {"axes": axes})
    found = struct.unpack("<B4f", steer.setpoint.value(FIRMWARE_3_1))
    assert found == pytest.approx(expected, abs=1e-4)
    assert (steer.fence, steer.lifetime, said) == (7, 0.2, [])


@pytest.mark.parametrize(
    ("name", "axes", "expected"),
    [
        ("ENUvelocity_yawrate", [10.5, 2.0, 0.5, 0.5], (0x48, 2.0, 10.0, 0.5, CLOCKWISE)),
        ("ENUvelocity_yawrate", [1.0, -10.5, 0.5, 0.5], (0x48, -10.0, 1.0, 0.5, CLOCKWISE)),
        ("ENUvelocity_yawrate", [1.0, 2.0, 4.5, 0.5], (0x48, 2.0, 1.0, 4.0, CLOCKWISE)),
        ("ENUvelocity_yawrate", [1.0, 2.0, 0.5, 1.8], (0x48, 2.0, 1.0, 0.5, -100.0)),  # rad/s
        ("rollpitch_yawrate_zposition", [0.7, 0.1, 2.0, 0.0], (0x1A, 35.0, -5.72958, 2.0, 0.0)),
    ],
)
def test_a_joy_beyond_the_limits_is_flown_at_them(
    name: str, axes: list[float], expected: tuple[float, ...]
) -> None:
    [steer], _ = flown(f"/dji_sdk/flight_control_setpoint_{name}", {"axes": axes})
    found = struct.unpack("<B4f", steer.setpoint.value(FIRMWARE_3_1))
    assert found == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize(
    ("name", "axes"),
    [
        ("ENUvelocity_yawrate", [1.0, 2.0]),
        ("ENUposition_yaw", []),
        (GENERIC, [1.0, 2.0, 0.5]),
        ("ENUposition_yaw", [1.0, 2.0, -0.5, 0.5]),
        (GENERIC, [1.0, 2.0, 0.5, 0.5]),
        (GENERIC, [1.0, 2.0, 0.5, 0.5, 0x4C]),  # bit 2 names no frame
        (GENERIC, [1.0, 2.0, 0.5, 0.5, 0x4E]),
        (GENERIC, [1.0, 2.0, 0.5, 0.5, 0xC8]),
        (GENERIC, [1.0, 2.0, 0.5, 0.5, 0x78]),
        (GENERIC, [1.0, 2.0, 0.5, 0.5, 0x68]),  # thrust goes with tilt only
        (GENERIC, [1.0, 2.0, 0.5, 0.5, 256 + 0x48]),
        (GENERIC, [1.0, 2.0, 0.5, 0.5, -1]),
        (GENERIC, [1.0, 2.0, 0.5, 0.5, None]),
        (GENERIC, [None, 2.0, 0.5, 0.5, 0x48]),
    ],
)
def test_a_joy_that_means_nothing_is_not_flown(name: str, axes: list[float | None]) -> None:
    steers, said = flown(f"/dji_sdk/flight_control_setpoint_{name}", {"axes": axes})
    assert (steers, len(said)) == ([], 1)


@pytest.mark.parametrize(("seconds", "count"), [(1.0, 2), (0.9, 2), (0.1, 1), (0.0, 1)])
def test_a_joy_that_waited_on_its_way_is_not_flown(seconds: float, count: int) -> None:
    """Two of them come a second after each other, and are stamped so many seconds apart."""

    async def publish(rig: KnownRig, page: FakeClient) -> None:
        for nanoseconds in (500_000_000, 500_000_000 + round(seconds * 1e9)):
            more, nsecs = divmod(nanoseconds, 10**9)
            header: Any = {"stamp": {"secs": 1_000_000_000 + more, "nsecs": nsecs}}
            axes: Any = [1.5, 2.5, 0.75, 0.5]
            topic = "/dji_sdk/flight_control_setpoint_ENUvelocity_yawrate"
            page.publish(topic, header=header, axes=axes)
            await anyio.sleep(1.0)

    assert len(flying(publish).known.asked(Steer)) == count


# The Quaternion of 2015: y is the first and x the second number of the command, w the climb, z the
# rate. Mode 1 are angles in °, 0x0A; mode 2 velocities over ground in m/s, 0x48.
@pytest.mark.parametrize(("mode", "flag"), [(None, 0x0A), (1, 0x0A), (2, 0x48)])
def test_the_numbers_of_2015_are_sent_as_they_are(mode: int | None, flag: int) -> None:
    async def publish(rig: KnownRig, page: FakeClient) -> None:
        if mode is not None:
            page.publish("/sdk_request_ctrl_mode", data=mode)
        for x in (1.5, 1.5, -1.5, 0.0):
            page.publish("/sdk_request_ctrl", x=x, y=x and 2.5, z=x and 3.5, w=x and 0.75)

    steers = flying(publish).known.asked(Steer)
    assert [struct.unpack("<B4f", one.setpoint.value(FIRMWARE_3_1)) for one in steers] == [
        (flag, 2.5, 1.5, 0.75, 3.5),
        (flag, 2.5, 1.5, 0.75, 3.5),
        (flag, 2.5, -1.5, 0.75, 3.5),
        (flag, 0.0, 0.0, 0.0, 0.0),
    ]
    # A key that goes down, one that is held, another one, and letting go.
    assert [one.lifetime for one in steers] == [0.7, 0.2, 0.7, 0.2]


@pytest.mark.parametrize("mode", [0, 3, 1.5, -1])
def test_a_mode_that_is_none_is_refused(mode: float) -> None:
    async def publish(rig: KnownRig, page: FakeClient) -> None:
        page.publish("/sdk_request_ctrl_mode", data=mode)

    assert len(flying(publish).page.statuses()) == 1


# -- what it is asked -----------------------------------------------------------------------------


def asks(*calls: tuple[str, dict[str, Any]], topic: str = "") -> tuple[list[Any], list[Any]]:
    """What the agent is asked when a client calls these, or publishes, and the answers."""

    async def do(rig: KnownRig, page: FakeClient) -> None:
        for name, values in calls:
            if topic:
                page.publish(topic, **values)
            else:
                page.call(f"/dji_sdk/{name}", **values)
                await anyio.sleep(0.05)

    rig = flying(do)
    return rig.known.asked(Ask), rig.page.answers()[1:]


def done(command_set: int, command: int, ack: int = 0) -> dict[str, Any]:
    return {"result": True, "cmd_set": command_set, "cmd_id": command, "ack_data": ack}


ONE = {"result": True}
TURNING: dict[str, Any] = {"yaw_rate": 8.5, "direction": 1}
BACK = {"direction": 0}
FAST: dict[str, Any] = {"speed": 8.5, "direction": 1}
# Service, arguments, what the agent is asked, the answer.
ASKED: list[tuple[str, dict[str, Any], Order, dict[str, Any]]] = [
    ("activation", {}, orders.Activate(), done(0, 1)),
    ("sdk_control_authority", {"control_enable": 1}, orders.Obtain(), done(1, 0, 2)),
    ("sdk_control_authority", {"control_enable": 0}, orders.Release(), done(1, 0, 1)),
    ("sdk_permission_control", {"control_enable": 1}, orders.Obtain(), ONE),
    ("sdk_permission_control", {"control_enable": 0}, orders.Release(), ONE),
    ("drone_task_control", {"task": 1}, orders.GoHome(), done(1, 1, 2)),
    ("drone_task_control", {"task": 4}, orders.TakeOff(), done(1, 1, 2)),
    ("drone_task_control", {"task": 6}, orders.Land(), done(1, 1, 2)),
    ("drone_arm_control", {"arm": 1}, orders.StartMotors(), done(1, 5)),
    ("drone_arm_control", {"arm": 0}, orders.StopMotors(), done(1, 5)),
    ("camera_action", {"camera_action": 0}, orders.UseCamera(CameraUse.PHOTO), ONE),
    ("camera_action", {"camera_action": 1}, orders.UseCamera(CameraUse.START_VIDEO), ONE),
    ("camera_action", {"camera_action": 2}, orders.UseCamera(CameraUse.STOP_VIDEO), ONE),
    ("camera_action_control", {"camera_action": 2}, orders.UseCamera(CameraUse.STOP_VIDEO), ONE),
    ("mission_waypoint_action", {"action": 0}, orders.StartMission(""), done(3, 0x12)),
    ("mission_waypoint_action", {"action": 1}, orders.StopMission(), done(3, 0x12)),
    ("mission_waypoint_action", {"action": 2}, orders.PauseMission(), done(3, 0x13)),
    ("mission_waypoint_action", {"action": 3}, orders.ResumeMission(), done(3, 0x13)),
    ("mission_start", {}, orders.StartMission(""), ONE),
    ("mission_pause", {"pause": 0}, orders.PauseMission(), ONE),
    ("mission_pause", {"pause": 1}, orders.ResumeMission(), ONE),
    ("mission_cancel", {}, orders.StopMission(), ONE),
    ("mission_waypoint_setSpeed", {"speed": 2.5}, orders.SetMissionSpeed(2.5), ONE),
    ("mission_waypoint_set_speed", {"speed": -2.5}, orders.SetMissionSpeed(-2.5), ONE),
    ("mission_hotpoint_action", {"action": 1}, orders.StopMission(), done(3, 0x21)),
    ("mission_hotpoint_action", {"action": 2}, orders.PauseMission(), done(3, 0x22)),
    ("mission_hotpoint_action", {"action": 3}, orders.ResumeMission(), done(3, 0x22)),
    (
        "mission_hotpoint_updateRadius",
        {"radius": 7.25},
        orders.SetHotpointRadius(7.25),
        done(3, 36),
    ),
    ("mission_hotpoint_set_radius", {"radius": 7.25}, orders.SetHotpointRadius(7.25), ONE),
    ("mission_hotpoint_updateYawRate", TURNING, orders.SetHotpointRate(8.5), done(3, 0x23)),
    (
        "mission_hotpoint_updateYawRate",
        TURNING | BACK,
        orders.SetHotpointRate(-8.5),
        done(3, 0x23),
    ),
    (
        "mission_hotpoint_set_speed",
        {"speed": 8.5, "direction": 1},
        orders.SetHotpointRate(8.5),
        ONE,
    ),
    (
        "mission_hotpoint_set_speed",
        {"speed": 8.5, "direction": 0},
        orders.SetHotpointRate(-8.5),
        ONE,
    ),
    ("mission_hotpoint_resetYaw", {}, orders.ResetHotpointHeading(), done(3, 0x25)),
    ("mission_hotpoint_reset_yaw", {}, orders.ResetHotpointHeading(), done(3, 0x25)),
]


@pytest.mark.parametrize(("name", "values", "order", "answer"), ASKED)
def test_a_service_asks_for_what_its_arguments_say(
    name: str, values: dict[str, Any], order: Order, answer: dict[str, Any]
) -> None:
    found, answers = asks((name, values))
    assert [(one.order, one.fence) for one in found] == [(order, 7)]
    assert answers == [answer]


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("sdk_control_authority", {"control_enable": 2}),
        ("drone_task_control", {"task": 0}),
        ("drone_task_control", {"task": 2}),
        ("drone_arm_control", {"arm": 2}),
        ("camera_action", {"camera_action": 3}),
        ("mission_waypoint_action", {"action": 4}),
        ("mission_hotpoint_action", {"action": 4}),
        ("mission_hotpoint_action", {"action": 0}),  # none was uploaded
        ("mission_pause", {"pause": 2}),
        ("mission_waypoint_setSpeed", {"speed": None}),
        ("mission_hotpoint_updateRadius", {"radius": None}),
        ("mission_hotpoint_updateYawRate", {"yaw_rate": None, "direction": 1}),
        ("gimbal_speed_control", {"yaw_rate": 1801, "roll_rate": 0, "pitch_rate": 0}),
        ("mission_waypoint_getInfo", {}),
        ("mission_waypoint_getSpeed", {}),
        ("mission_hotpoint_getInfo", {}),
    ],
)
def test_a_service_that_means_nothing_asks_for_nothing(name: str, values: dict[str, Any]) -> None:
    found, [answer] = asks((name, values))
    assert (found, answer["result"]) == ([], False)
    assert None not in values.values() or "is a number" in answer["values"]


def test_without_an_origin_nothing_flies_to_a_local_place() -> None:
    async def do(rig: KnownRig) -> None:
        rig.page = rig.client()
        rig.known.tell_package(0.0, changed=[position(health=3)])
        rig.page.call("/dji_sdk/sdk_control_authority", control_enable=1)
        await anyio.sleep(0.1)
        rig.page.call("/dji_sdk/local_position_control", x=1.0, y=2.0, z=3.0, yaw=4.0)
        await anyio.sleep(0.1)

    assert "local positions have no origin yet" in str(run(do).page.read()[-2:])


# The commands of 2015: a float that the C program casts to a byte; the request, and the answer.
ORDERED: list[tuple[str, float, list[Order], dict[str, float]]] = [
    ("/sdk_request_cmd", 4, [orders.TakeOff()], {}),
    ("/sdk_request_cmd", 6.9, [orders.Land()], {}),
    ("/sdk_request_cmd", 257, [orders.GoHome()], {}),
    ("/sdk_request_cmd", 2, [], {}),
    ("/sdk_request_cmd", 0, [], {}),
    ("/nav_open_close_request", 1, [orders.Obtain()], {"/nav_open_close_status": 2.0}),
    ("/nav_open_close_request", 0, [orders.Release()], {"/nav_open_close_status": 1.0}),
    ("/nav_open_close_request", 2, [], {}),
    ("/sdk_request_activation", 1, [orders.Activate()], {}),
    ("/sdk_request_simple_task", 3, [orders.FlyPattern(3)], {}),
    ("/sdk_request_simple_task", 5, [orders.Activate()], {}),
    ("/sdk_request_simple_task", 6, [orders.AskVersion()], {}),
    ("/sdk_request_simple_task", -1, [orders.Halt("page stopped it")], {}),
]


@pytest.mark.parametrize(("topic", "data", "wanted", "statuses"), ORDERED)
def test_an_order_of_2015_asks_for_what_its_number_says(
    topic: str, data: float, wanted: list[Order], statuses: dict[str, float]
) -> None:
    async def publish(rig: KnownRig, page: FakeClient) -> None:
        page.subscribe("/nav_open_close_status", "/activation_status")
        page.publish(topic, data=data)

    rig = flying(publish)
    assert [one.order for one in rig.known.asked(Ask)] == wanted
    told = {one["topic"]: one["msg"]["data"] for one in rig.page.read() if one["op"] == "publish"}
    assert told == statuses
    refused = [one for one in rig.page.statuses() if not one.startswith("version")]
    assert bool(refused) is not bool(wanted)


@pytest.mark.parametrize(
    "topic", ["/sdk_request_cmd", "/nav_open_close_request", "/sdk_request_simple_task"]
)
def test_an_order_that_is_no_number_asks_for_nothing(topic: str) -> None:
    async def publish(rig: KnownRig, page: FakeClient) -> None:
        nothing: Any = None  # a NaN, in JSON
        page.publish(topic, data=nothing)

    rig = flying(publish)
    assert rig.known.asked(Ask) == []
    assert len(rig.page.statuses()) == 1


def test_data_goes_to_the_app_as_they_are() -> None:
    data = base64.b64encode(b"\x01\xfe\x80").decode()
    [ask], _ = asks(("send_data_to_mobile", {"data": data}))
    assert ask.order == orders.SendToMobile(b"\x01\xfe\x80")


@pytest.mark.parametrize(
    ("text", "version", "hardware"),
    [
        # What aircraft say, and what DJI's library makes of it: the M100's third number times ten.
        ("SDK-v1.0 BETA M100-03.01.01.00", 0x03010A00, "M100"),
        ("SDK-v1.0 BETA M100-02.03.10.00", 0x02036400, "M100"),
        ("SDK-v1.0 BETA A3-03.01.100.00", 0x03016400, "A3"),
        ("", 0, ""),
        ("strange", 0, ""),
        ("M100-1.2.x", 0x01020000, "M100"),
    ],
)
def test_a_version_is_as_the_later_node_tells_it(text: str, version: int, hardware: str) -> None:
    async def do(rig: KnownRig, page: FakeClient) -> None:
        rig.known.version = text
        page.call("/dji_sdk/query_drone_version")

    assert flying(do).page.answers()[-1] == {"version": version, "hardware": hardware}


# Tenths of a degree and of a second, in 3.1; radians and seconds in the topics of 2018.
ANGLES = {"yaw": -1105, "roll": 125, "pitch": -415, "duration": 25}
KEPT = dict.fromkeys(("yaw_cmd_ignore", "roll_cmd_ignore", "pitch_cmd_ignore"), False)


@pytest.mark.parametrize(
    ("changed", "mode", "tenths"),
    [
        ({}, 1, 25),
        ({"absolute_or_incremental": False}, 0, 25),
        ({"yaw_cmd_ignore": True}, 1 + 2, 25),
        ({"roll_cmd_ignore": True}, 1 + 4, 25),
        ({"pitch_cmd_ignore": True}, 1 + 8, 25),
        ({"duration": 0}, 1, 1),
    ],
)
def test_a_gimbal_points_where_tenths_say(changed: dict[str, Any], mode: int, tenths: int) -> None:
    request = {**ANGLES, **KEPT, "absolute_or_incremental": True, **changed}
    [ask], answers = asks(("gimbal_angle_control", request))
    assert answers == [ONE]
    assert angles(ask) == (
        -1105,
        125,
        -415,
        mode,
        tenths,
    )


@pytest.mark.parametrize(("seconds", "tenths"), [(2, 20), (0, 1)])
def test_a_gimbal_points_where_radians_say(seconds: int, tenths: int) -> None:
    turned = {"yaw": math.radians(-110.5), "roll": math.radians(12.5)}
    pointed: dict[str, Any] = turned | {"pitch": math.radians(-41.5), "ts": seconds, "mode": 0b1001}
    [ask], _ = asks(("", pointed), topic="/dji_sdk/gimbal_angle_cmd")
    assert angles(ask) == (
        -1105,
        125,
        -415,
        0b1001,
        tenths,
    )


def test_a_gimbal_turns_as_fast_as_ordered() -> None:
    """Roll, pitch, yaw in rad/s, with the signs of the wire; in tenths of a degree by 3.1's."""
    vector: Any = {"x": math.radians(5), "y": math.radians(20), "z": math.radians(40)}
    [ask], _ = asks(("", {"vector": vector}), topic="/dji_sdk/gimbal_speed_cmd")
    turned = {"yaw_rate": 400, "roll_rate": 50, "pitch_rate": 200}
    [other], _ = asks(("gimbal_speed_control", turned))
    for one in (ask, other):
        assert rates(one) == (
            400,
            50,
            200,
            0x80,
        )


# -- missions -------------------------------------------------------------------------------------


def waypoint(**changed: Any) -> dict[str, Any]:
    """Degrees, m above the take-off point, s; turn mode 1 is against the clock."""
    action = {"action_repeat": 0x36, "command_list": list(range(6)) + [0] * 10}
    parameters = [2500, 0, 0, 0, 0x10000 - 60, 0x10000 - 25] + [0] * 10
    return {
        "latitude": -33.1,
        "longitude": 151.2,
        "altitude": 21.5,
        "damping_distance": 1.5,
        "target_yaw": -75,
        "target_gimbal_pitch": -35,
        "turn_mode": 1,
        "has_action": 1,
        "action_time_limit": 40,
        "waypoint_action": action | {"command_parameter": parameters},
    } | changed


TASK = {
    "velocity_range": 7.5,
    "idle_velocity": 4.5,
    "action_on_finish": 2,
    "mission_exec_times": 2,
    "yaw_mode": 3,
    "trace_mode": 1,
    "action_on_rc_lost": 1,
    "gimbal_pitch_mode": 0,
    "mission_waypoint": [waypoint(), waypoint(latitude=-33.25, turn_mode=0), waypoint()],
}


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({}, (3, 7.5, 4.5, 2, 2, 3, 1, 1, 0)),
        ({"yaw_mode": 4, "gimbal_pitch_mode": 1}, (3, 7.5, 4.5, 2, 2, 0, 1, 1, 1)),  # DJI's demo
        ({"trace_mode": 0, "action_on_rc_lost": 0}, (3, 7.5, 4.5, 2, 2, 3, 0, 0, 0)),
    ],
)
def test_a_task_is_uploaded_as_it_is(changed: dict[str, Any], expected: tuple[float, ...]) -> None:
    """Count, greatest speed, speed, at the end, runs, heading, trace, on RC loss, gimbal."""
    calls = [("mission_waypoint_upload", {"waypoint_task": TASK | changed})]
    calls += [("mission_waypoint_getInfo", {}), ("mission_waypoint_download", {})]
    calls += [("mission_waypoint_getSpeed", {}), ("mission_waypoint_get_speed", {})]
    found, answers = asks(*calls)
    [upload] = found
    assert struct.unpack(MISSION, upload.order.mission) == (*expected, 0.0, 0.0, 0.0)
    assert answers[0] == done(3, 0x10)
    assert answers[1] == answers[2]
    assert answers[1]["waypoint_task"]["idle_velocity"] == 4.5
    assert answers[3] == answers[4] == {"speed": 4.5, "cmd_set": 3, "cmd_id": 0x17, "ack_data": 0}


def test_a_speed_that_was_set_is_reported() -> None:
    upload = ("mission_waypoint_upload", {"waypoint_task": TASK})
    speed = ("mission_waypoint_setSpeed", {"speed": 2.5})
    _, answers = asks(upload, speed, ("mission_waypoint_getSpeed", {}))
    assert answers[-1]["speed"] == 2.5


def test_waypoints_are_uploaded_as_they_are() -> None:
    [upload], _ = asks(("mission_waypoint_upload", {"waypoint_task": TASK}))
    first, second, third = (struct.unpack(POINT, one) for one in upload.order.points)
    place = (math.radians(-33.1), math.radians(151.2))
    assert first[:3] == (0, *(pytest.approx(one, abs=1e-12) for one in place))
    # altitude, damping, yaw, gimbal, turn, has actions, time limit, runs << 4 | number of actions
    assert first[3:11] == (21.5, 1.5, -75, -35, 1, 1, 40, 0x36)
    assert first[11:27] == (0, 1, 2, 3, 4, 5, *[0] * 10)
    assert first[27:] == (2500, 0, 0, 0, -60, -25, *[0] * 10)
    assert (second[0], third[0], second[7]) == (1, 2, 0)
    assert second[1] == pytest.approx(math.radians(-33.25), abs=1e-12)


# Programs that flew a real M100 send 64000 s; 65535 is no limit.
@pytest.mark.parametrize(("asked", "sent"), [(999, 999), (1000, 65535), (64000, 65535)])
def test_a_time_limit_that_firmware_does_not_take_is_none(asked: int, sent: int) -> None:
    task = TASK | {"mission_waypoint": [waypoint(action_time_limit=asked), waypoint()]}
    [upload], _ = asks(("mission_waypoint_upload", {"waypoint_task": task}))
    assert struct.unpack(POINT, upload.order.points[0])[9] == sent


# DJI's nodes of 2016 send the runs as action_repeat, and always 15 actions.
@pytest.mark.parametrize(
    ("repeat", "commands", "expected"),
    [(2, [0, 1], 0x22), (1, [5, 1, 0, 1], 0x14), (1, [], 0x10), (0x12, [0, 1, 2], 0x12)],
)
def test_how_many_actions_are_done_how_often(
    repeat: int, commands: list[int], expected: int
) -> None:
    action = {
        "action_repeat": repeat,
        "command_list": commands + [0] * (15 - len(commands)),
        "command_parameter": [0] * 15,
    }
    points = [waypoint(waypoint_action=action), waypoint()]
    task = TASK | {"mission_waypoint": points}
    [upload], _ = asks(("mission_waypoint_upload", {"waypoint_task": task}))
    assert struct.unpack(POINT, upload.order.points[0])[10] == expected


@pytest.mark.parametrize("count", [0, 1, 100])
def test_a_task_has_two_to_99_points(count: int) -> None:
    task = TASK | {"mission_waypoint": [waypoint()] * count}
    found, [answer] = asks(("mission_waypoint_upload", {"waypoint_task": task}))
    assert (found, answer["result"]) == ([], False)
    assert f"2 to 99 waypoints, not {count}" in answer["values"]


CIRCLE = {
    "latitude": -33.1,
    "longitude": 151.2,
    "altitude": 21.5,
    "radius": 12.5,
    "angular_speed": 7.5,  # °/s
    "is_clockwise": 1,
    "start_point": 3,
    "yaw_mode": 2,
}


@pytest.mark.parametrize("clockwise", [0, 1])
@pytest.mark.parametrize(("start", "answer"), [("action", done(3, 0x20)), ("start", ONE)])
def test_a_circle_is_flown_as_it_is(clockwise: int, start: str, answer: dict[str, Any]) -> None:
    task = CIRCLE | {"is_clockwise": clockwise}
    begin: dict[str, tuple[str, dict[str, Any]]] = {
        "action": ("mission_hotpoint_action", {"action": 0}),
        "start": ("mission_start", {}),
    }
    found, answers = asks(
        ("mission_hotpoint_upload", {"hotpoint_task": task}),
        ("mission_hotpoint_getInfo", {}),
        ("mission_hotpoint_download", {}),
        begin[start],
    )
    [ask] = found
    assert type(ask.order) is orders.StartHotpoint
    places = (math.radians(-33.1), math.radians(151.2))
    assert struct.unpack(HOTPOINT, ask.order.circle.value(FIRMWARE_3_1)) == (
        0,
        *(pytest.approx(one, abs=1e-12) for one in places),
        *(21.5, 12.5, 7.5, clockwise, 3, 2),
    )
    uploaded, info, download, begun = answers
    assert (uploaded, begun) == (done(3, 0x20), answer)
    assert info == {"hotpoint_task": task, "cmd_set": 3, "cmd_id": 0x26, "ack_data": 0}
    assert download == {"hotpoint_task": task}


def test_the_tables_have_every_service() -> None:
    rig = run(lambda _: anyio.sleep(0.0))
    there = {name.removeprefix("/dji_sdk/") for name in rig.graph.services if "dji_sdk" in name}
    with_values = {
        *("send_data_to_mobile", "query_drone_version", "set_local_pos_ref"),
        *("gimbal_angle_control", "gimbal_speed_control"),
        *(f"mission_waypoint_{one}" for one in ("upload", "getInfo", "getSpeed", "download")),
        *(f"mission_hotpoint_{one}" for one in ("upload", "getInfo", "download")),
        *("mission_waypoint_get_speed", "mission_status"),
    }
    assert {name for name, *_ in ASKED} | with_values | SERVICES_2016 == there
