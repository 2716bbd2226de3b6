"""What a node tells and takes, as tables: values in, values out by the definitions of ROS.

REP 103: east, north, up on the ground; forward, left, up in the body; m, rad, s; yaw from east,
counter-clockwise. REP 105: map, odom, base_link. The rest is in the comments of sensor_msgs and
nav_msgs, and for ``dji_sdk`` in DJI's node of 2018. No value here is computed by the library.
"""

from __future__ import annotations

import math
import struct
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.messages import (
    Ask,
    Event,
    GuardLimits,
    LeaseChanged,
    MissionReport,
    State,
    Steer,
    Telemetry,
)
from m100link.apps.agent.orders import FlyTo, GuidedFlight
from m100link.apps.ros2 import actions, control, endpoints, node
from m100link.apps.ros2.actions import FLIGHTS
from m100link.apps.ros2.graph import data_key
from m100link.apps.ros2.publishers import ALL_OUTPUTS
from m100link.apps.ros2.topics import DJI_OUTPUTS, INPUTS, SERVICES
from m100link.errors import UsageError
from m100link.log.cdr import decode
from m100link.protocol.firmware import FIRMWARE_3_1
from m100link.protocol.records import (
    Acceleration,
    AngularVelocity,
    Attitude,
    Battery,
    FlightStatus,
    Gimbal,
    Magnetometer,
    Position,
    RemoteControl,
    Time,
    Velocity,
)
from m100link.sim.clock import virtual_clock_loop
from tests import limits
from tests.apps.ros2.conftest import UTC
from tests.apps.ros2.known import KnownRig
from tests.apps.ros2.test_actions import Client
from tests.known import (
    LATITUDE,
    LONGITUDE,
    MISSION,
    POINT,
    STICKS_ALONE,
    angles,
    felt,
    in_body,
    position,
    quaternion,
    rates,
)

NAN = math.nan
SEC = int(UTC)

# -- the numbers of docs/howto/fly-by-ros2.md ------------------------------------------------------

MANUAL = [
    (control, "SILENCE_S", 0.5),
    (control, "LIFETIME", 0.3),
    (control, "IDLE_S", 60.0),
    (actions, "FEEDBACK_S", 0.5),
    (control, "MOST_HZ", 100.0),
    (endpoints, "ASK_S", 0.5),
    (endpoints, "SILENCE_S", 1.5),
    (node, "MOST_BYTES", 32_768),
]


@pytest.mark.parametrize(
    ("module", "name", "value"), MANUAL, ids=[f"{m.__name__}.{name}" for m, name, _ in MANUAL]
)
def test_a_limit_is_that_of_the_manual(module: Any, name: str, value: float) -> None:
    """Other tests of it may read the limit where the code has it."""
    assert getattr(module, name) == value


# -- what it tells --------------------------------------------------------------------------------

SECOND_AT = 1.5
"""Of the second of two packages: 30 m north and 70 m west of where GPS was good first."""

# Metres per radian along the meridian and the parallel, on the ellipsoid of WGS 84.
_SQUEEZED = 1.0 - 0.00669437999014 * math.sin(math.radians(LATITUDE)) ** 2
NORTH_M = 6_378_137.0 * (1.0 - 0.00669437999014) / _SQUEEZED**1.5
EAST_M = 6_378_137.0 / math.sqrt(_SQUEEZED) * math.cos(math.radians(LATITUDE))
FIRST = position(
    latitude=LATITUDE - math.degrees(30.0 / NORTH_M),
    longitude=LONGITUDE + math.degrees(70.0 / EAST_M),
    altitude=55.5,
    height=3.75,
)

STATE = State(
    0.0,
    connection="connected",
    firmware="3.1",
    has_authority=True,
    task="go home",
    round_trip=0.0123,
    discards=77,
    late_acks=5,
    dropped_writes=6,
    mismatches=8,
)


def stamp(at: float) -> dict[str, Any]:
    return {"sec": SEC + int(at), "nanosec": pytest.approx((at % 1.0) * 1e9, abs=1000)}


def header(frame: str, at: float = SECOND_AT) -> dict[str, Any]:
    return {"stamp": stamp(at), "frame_id": frame}


def xyz(*values: float) -> dict[str, Any]:
    return {name: close(value) for name, value in zip("xyz", values, strict=True)}


def turned(roll: float, pitch: float, yaw: float) -> dict[str, Any]:
    """Degrees of REP 103: pitch is positive with the nose down, yaw is from east to the left."""
    w, x, y, z = quaternion(roll, pitch, math.remainder(yaw, 360.0))  # so w is not negative
    return xyz(x, y, z) | {"w": close(w)}


def close(value: float) -> Any:
    return pytest.approx(value, rel=2e-7, abs=2e-7)


def flu(forward: float, right: float, down: float) -> tuple[float, float, float]:
    return forward, -right, -down


ORIENTATION = turned(10.0, 20.0, 90.0 + 130.0)
FELT = xyz(*flu(*felt()))
RATES = xyz(*flu(0.11, -0.23, 0.37))
VELOCITY = xyz(-1.57, 3.21, 0.84)
ACCELERATION = xyz(-2.5, 1.5, 0.7)
PLACE = {one: pytest.approx(at, abs=0.01) for one, at in (("x", -70.0), ("y", 30.0), ("z", 12.34))}
NOTHING = xyz(0.0, 0.0, 0.0)
UNKNOWN, ABSENT = (0.0,) * 9, (-1.0, *(0.0,) * 8)
"""Covariances as sensor_msgs has them: zeros are not known; -1 says that the value is not there."""

IMU = {
    "orientation": ORIENTATION,
    "orientation_covariance": UNKNOWN,
    "angular_velocity": RATES,
    "angular_velocity_covariance": UNKNOWN,
    "linear_acceleration": FELT,
    "linear_acceleration_covariance": UNKNOWN,
}


def diagonal(*deviations: float) -> Any:
    """Their squares, as a matrix by rows."""
    matrix = [0.0] * len(deviations) ** 2
    matrix[:: len(deviations) + 1] = [one**2 for one in deviations]
    return pytest.approx(tuple(matrix))


# What PX4 and ArduPilot take for the noise of their sensors: tilt, heading, rates, acceleration.
KNOWN = {
    "orientation_covariance": diagonal(0.1, 0.1, 0.3),
    "angular_velocity_covariance": diagonal(0.015, 0.015, 0.015),
    "linear_acceleration_covariance": diagonal(0.35, 0.35, 0.35),
}
# Of NavSatStatus: 0 is a fix, -1 none; service 1 is GPS.
FIX = {
    "status": {"status": 0, "service": 1},
    "latitude": pytest.approx(LATITUDE, abs=1e-9),
    "longitude": pytest.approx(LONGITUDE, abs=1e-9),
    "altitude": close(87.65),
    "position_covariance": UNKNOWN,
    "position_covariance_type": 0,
}
BATTERY = {
    "percentage": close(0.63),  # 0 to 1
    **dict.fromkeys(("voltage", "temperature", "current"), NAN),
    **dict.fromkeys(("charge", "capacity", "design_capacity"), NAN),
    **dict.fromkeys(("power_supply_status", "power_supply_health"), 0),
    "power_supply_technology": 0,
    "present": True,
    **dict.fromkeys(("cell_voltage", "cell_temperature"), ()),
    **dict.fromkeys(("location", "serial_number"), ""),
}
STICKS = (close(0.1), close(-0.2), close(0.3), close(-0.4))


def pose(orientation: Mapping[str, Any] = ORIENTATION) -> dict[str, Any]:
    return {"position": PLACE, "orientation": orientation}


def transform(parent: str, child: str, at: float, place: Any, rotation: Any) -> dict[str, Any]:
    moved = {"translation": place, "rotation": rotation}
    one = {"header": header(parent, at), "child_frame_id": child, "transform": moved}
    return {"transforms": {"0": one}}


def status(place: int, name: str, level: int, message: str, /, **values: str) -> dict[str, Any]:
    """Of DiagnosticStatus: level 0 is OK, 1 a warning, 2 an error, 3 stale."""
    said = {
        str(at): {"key": key.replace("_", " "), "value": value}
        for at, (key, value) in enumerate(values.items())
    }
    head = {"level": level, "name": f"m100: {name}", "message": message}
    return {str(place): head | {"hardware_id": "DJI Matrice 100", "values": said}}


NOT_DONE = {"payloads_that_could_not_be_read": "0"} | {
    f"setpoints_{why}": "0" for why in ("late", "other", "closed")
}
DIAGNOSTICS = (
    status(
        0,
        "line",
        0,
        "connected",
        firmware="3.1",
        round_trip_ms="12.3",
        damaged_frames="77",
        late_acks="5",
        dropped_writes="6",
        packages_that_do_not_fit="8",
    )
    | status(2, "navigation", 0, "good", position_test_ratio="0.0", height_test_ratio="0.0")
    | status(3, "control", 0, "programs have control", lease="somebody", task="go home")
    | status(4, "battery", 0, "charged", percent="63")
    | status(5, "node", 0, "no failures since the start", **NOT_DONE)
)

TOLD: dict[str, dict[str, Any]] = {
    "~/imu": {"header": header("base_link"), **IMU, **KNOWN},
    "~/fix": {
        "header": header("base_link"),
        **FIX,
        "position_covariance": diagonal(2.5, 2.5, 2.0),
        "position_covariance_type": 1,  # approximated
    },
    # The pose is of child_frame_id in frame_id; the twist is in child_frame_id.
    "~/odom": {
        "header": header("odom"),
        "child_frame_id": "base_link",
        "pose": {"pose": pose(), "covariance": diagonal(2.5, 2.5, 2.0, 0.1, 0.1, 0.3)},
        "twist": {
            "twist": {"linear": xyz(*flu(*in_body(3.21, -1.57, -0.84))), "angular": RATES},
            "covariance": diagonal(0.3, 0.3, 0.3, 0.015, 0.015, 0.015),
        },
    },
    "~/pose": {"header": header("odom"), "pose": pose()},
    "~/velocity": {"header": header("odom"), "twist": {"linear": VELOCITY, "angular": NOTHING}},
    "~/battery": {"header": header("base_link"), **BATTERY},
    # Tesla, of 32 nT for each raw unit: DJI calls 1000 to 2000 normal, the Earth has 25 to 65 µT.
    "~/magnetic_field": {
        "header": header("base_link"),
        "magnetic_field": {
            axis: pytest.approx(raw * 32e-9, rel=1e-9)
            for axis, raw in (("x", 313.0), ("y", 1127.0), ("z", -851.0))
        },
        "magnetic_field_covariance": UNKNOWN,
    },
    "~/joy": {"header": header("base_link"), "axes": STICKS, "buttons": (8000, -4545)},
    "~/gimbal": {"header": header("odom"), "quaternion": turned(4.5, 37.25, 90.0 - 118.75)},
    # 255 stands for unknown.
    "~/flight_status": {
        "header": {"frame_id": "base_link"},
        "phase": 3,
        "has_authority": True,
        "holder": "somebody",
        "task": "go home",
        "mode_switch": "F",
        "gps_health": 4,
        "battery_percent": 63,
        "firmware": "3.1",
        "connection": "connected",
    },
    "~/mission_event": {"header": {"frame_id": "base_link"}, "event": 2, "data": (9, 4, 0, 0, 0)},
    "/tf": transform("odom", "base_link", SECOND_AT, PLACE, ORIENTATION),
    "/tf_static": transform("map", "odom", 0.0, NOTHING, turned(0.0, 0.0, 0.0)),
    "/diagnostics": {"header": {"frame_id": ""}, "status": DIAGNOSTICS},
    # Of rcl_interfaces/Log: 20 is information, 30 a warning, 40 an error.
    "/rosout": {
        "stamp": stamp(0.75),
        "level": 30,
        "name": "m100",
        "msg": "a bird",
        "file": "",
        "function": "",
        "line": 0,
    },
    "/clock": {"clock": stamp(SECOND_AT)},
    # As DJI's node for the Matrice 100: frames, and gimbal angles in degrees of the wire.
    "dji_sdk/attitude": {"header": header("body_FLU"), "quaternion": ORIENTATION},
    "dji_sdk/imu": {"header": header("body_FLU"), **IMU},
    "dji_sdk/gps_position": {"header": header("gps"), **FIX},
    "dji_sdk/gps_health": {"data": 4},
    "dji_sdk/height_above_takeoff": {"data": close(12.34)},
    "dji_sdk/velocity": {"header": header("ground_ENU"), "vector": VELOCITY},
    "dji_sdk/angular_velocity_fused": {"header": header("body_FLU"), "vector": RATES},
    "dji_sdk/acceleration_ground_fused": {
        "header": header("ground_ENU"),
        "vector": ACCELERATION,
    },
    "dji_sdk/rc": {
        "header": header("rc"),
        "axes": (*STICKS, close(8000.0), close(-4545.0)),
        "buttons": (),
    },
    "dji_sdk/gimbal_angle": {"header": header("ground_ENU"), "vector": xyz(4.5, -37.25, 118.75)},
    "dji_sdk/flight_status": {"data": 3},
    "dji_sdk/battery_state": {"header": header(""), **BATTERY, "percentage": close(63.0)},
}


SAID_OTHERWISE = {"~/flight_status", "~/mission_event", "/tf_static", "/diagnostics", "/rosout"}
BY_PACKAGE = ALL_OUTPUTS.keys() - SAID_OTHERWISE - {"~/home"}


@cache
def told(
    without: tuple[type[Any], ...] = (),
    changed: tuple[Any, ...] = (),
    pause: float = 0.25,
    wait: float = 1.1,
    first: Position = FIRST,
    state: State = STATE,
) -> dict[str, Any]:
    """What a node says of two packages of the known aircraft, the second one changed so."""
    found: dict[str, Any] = {}

    async def listen() -> None:
        async with KnownRig().running() as rig:
            await anyio.sleep(0.75)
            rig.known.tell(state, LeaseChanged(3, "somebody"), MissionReport(2, b"\x09\x04"))
            rig.known.tell(Event(1, 0.75, "warning", "a bird"))
            await anyio.sleep(SECOND_AT - 0.75 - pause)
            gone = (Time, Battery)  # the battery is sent once a second
            rig.known.tell_package(SECOND_AT - pause, without=gone, changed=(first,))
            await anyio.sleep(pause)
            for name in BY_PACKAGE:
                rig.sent(name).clear()
            rig.known.tell_package(SECOND_AT, without=without, changed=changed)
            await anyio.sleep(wait)
            found.update((name, rig.newest(name)) for name in ALL_OUTPUTS)

    anyio.run(listen, backend_options={"loop_factory": virtual_clock_loop})
    return found


def flat(message: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in message.items():
        where = f"{path}{name}"
        found |= flat(value, f"{where}.") if isinstance(value, Mapping) else {where: value}
    return found


def is_nan(value: Any) -> bool:
    return isinstance(value, float) and math.isnan(value)


def agree(found: Mapping[str, Any], expected: Mapping[str, Any]) -> None:
    for name, value in flat(expected).items():
        assert is_nan(found[name]) if is_nan(value) else found[name] == value, name


def test_the_table_has_every_topic() -> None:
    # This aircraft flies from the beginning: nobody knows where it took off.
    assert TOLD.keys() ^ ALL_OUTPUTS.keys() == {"~/home"}


@pytest.mark.parametrize("name", TOLD)
def test_what_is_reported_of_an_aircraft_whose_numbers_all_differ(name: str) -> None:
    found = told()[name]
    agree(found, TOLD[name])
    if name in BY_PACKAGE:  # of the others, the table leaves times and texts out
        assert found.keys() == flat(TOLD[name]).keys()


@pytest.mark.parametrize(
    ("record", "silent"),
    [
        (Attitude, {"~/odom", "~/pose", "/tf", "dji_sdk/attitude", "dji_sdk/imu"}),
        (AngularVelocity, {"dji_sdk/imu", "dji_sdk/angular_velocity_fused"}),
        (Acceleration, {"dji_sdk/imu", "dji_sdk/acceleration_ground_fused"}),
        (Velocity, {"~/velocity", "dji_sdk/velocity"}),
        (
            Position,
            {"~/fix"}
            | {f"dji_sdk/{one}" for one in ("gps_position", "gps_health", "height_above_takeoff")},
        ),
        (Magnetometer, {"~/magnetic_field"}),
        (RemoteControl, {"~/joy", "dji_sdk/rc"}),
        (Gimbal, {"~/gimbal", "dji_sdk/gimbal_angle"}),
        (FlightStatus, {"dji_sdk/flight_status"}),
        (Battery, {"~/battery", "dji_sdk/battery_state"}),
    ],
)
def test_what_a_package_has_not_is_not_reported(record: type[Any], silent: set[str]) -> None:
    found = told((record,))
    assert {name for name in BY_PACKAGE if found[name] is None} == silent


def test_an_imu_without_attitude_and_rates_is_none() -> None:
    assert told((Attitude, AngularVelocity))["~/imu"] is None


@pytest.mark.parametrize("record", [Velocity, AngularVelocity, Position])
def test_what_came_just_before_belongs_to_a_pose_and_what_is_old_does_not(
    record: type[Any],
) -> None:
    assert told((record,), pause=0.25)["~/odom"] is not None
    assert told((record,), pause=0.35)["~/odom"] is None


@pytest.mark.parametrize(
    ("gone", "unknown"),
    [
        (Attitude, {"orientation", "linear_acceleration"}),  # what the body feels needs both
        (AngularVelocity, {"angular_velocity"}),
        (Acceleration, {"linear_acceleration"}),
    ],
)
def test_an_imu_says_which_of_its_values_are_not_there(gone: type[Any], unknown: set[str]) -> None:
    found = told((gone,))["~/imu"]
    names = ("orientation", "angular_velocity", "linear_acceleration")
    assert {one: found[f"{one}_covariance"] for one in names} == {
        one: ABSENT if one in unknown else KNOWN[f"{one}_covariance"] for one in names
    }
    # A program that does not look at the covariance sees it level and at rest.
    values = {name: found[name] for name in found if name.partition(".")[0] in unknown}
    assert values == {name: 1.0 if name.endswith(".w") else 0.0 for name in values}
    assert len(values) == sum(4 if one == "orientation" else 3 for one in unknown)


@pytest.mark.parametrize(("health", "east", "north"), [(2, 0.0, 0.0), (3, -70.0, 30.0)])
def test_a_place_is_measured_from_where_gps_was_good_first(
    health: int, east: float, north: float
) -> None:
    found = told(first=FIRST._replace(gps_health=health))["~/odom"]
    place = (found["pose.pose.position.x"], found["pose.pose.position.y"])
    assert place == pytest.approx((east, north), abs=0.01)


@pytest.mark.parametrize(("health", "fix"), [(0, -1), (2, -1), (3, 0), (5, 0)])
def test_a_fix_is_one_from_health_three(health: int, fix: int) -> None:
    found = told(changed=(position(health=health),))
    for name in ("~/fix", "dji_sdk/gps_position"):
        assert found[name]["status.status"] == fix
    assert found["dji_sdk/gps_health"]["data"] == health


@pytest.mark.parametrize("place", [position(latitude=NAN), position(longitude=math.inf)])
def test_what_cannot_be_a_place_is_no_fix(place: Position) -> None:
    found = told(changed=(place,))
    for name in ("~/fix", "dji_sdk/gps_position"):
        assert found[name]["status.status"] == -1
    assert found["~/odom"] is found["~/pose"] is found["/tf"] is None


@pytest.mark.parametrize("percent", [101, 200])
def test_a_battery_of_more_than_all_is_not_known(percent: int) -> None:
    found = told(changed=(Battery(percent),))
    for name in ("~/battery", "dji_sdk/battery_state"):
        assert math.isnan(found[name]["percentage"])
    assert found["~/flight_status"]["battery_percent"] == 255
    assert (found["/diagnostics"]["status.4.level"], found["/diagnostics"]["status.4.message"]) == (
        3,
        "unknown",
    )


def test_a_status_of_long_ago_is_not_known() -> None:
    found = told(wait=3.6)
    agree(
        found["~/flight_status"],
        {
            **dict.fromkeys(("phase", "gps_health", "battery_percent"), 255),
            "mode_switch": "",
            "connection": "silent",
            "has_authority": False,
        },
    )
    assert found["/diagnostics"]["status.0.level"] == 2
    assert found["/diagnostics"]["status.3.message"] == "the pilot flies"


def test_a_pilot_who_flies_is_reported() -> None:
    found = told(state=replace(STATE, has_authority=False, round_trip=None))
    assert found["~/flight_status"]["has_authority"] is False
    assert found["/diagnostics"]["status.3.message"] == "the pilot flies"
    assert found["/diagnostics"]["status.0.values.1.value"] == ""


# -- what it takes --------------------------------------------------------------------------------


def twist(frame: str = "base_link") -> dict[str, Any]:
    """m/s and rad/s: three axes that differ; the turn is the one about up that it takes."""
    linear, angular = {"x": 1.5, "y": 2.5, "z": 0.75}, {"x": 5.0, "y": 6.0, "z": 0.5}
    return {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": frame},
        "twist": {"linear": linear, "angular": angular},
    }


def pose_at(x: float, y: float, z: float, *turned: float, frame: str = "odom") -> dict[str, Any]:
    orientation = dict(zip("xyzw", turned or (0.0,) * 4, strict=True))
    return {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": frame},
        "pose": {
            "position": {"x": x, "y": y, "z": z},
            "orientation": orientation,
        },
    }


# The movement command of DJI's document: a flag; north or forward and east or right, m/s; up, m/s;
# a heading from north, clockwise, ° (flag 0x40), or a rate clockwise, °/s (0x48); 0x02 is the body.
BODY_RATE, GROUND_RATE, GROUND_HEADING = 0x4A, 0x48, 0x40
CLOCKWISE = -28.64789  # °/s of half a radian to the left
YAW_30 = (0.0, 0.0, math.sin(math.radians(15.0)), math.cos(math.radians(15.0)))
TILTED = (*quaternion(25.0, 35.0, 30.0)[1:], quaternion(25.0, 35.0, 30.0)[0])
STEERED: dict[str, tuple[str, dict[str, Any], tuple[float, ...]]] = {
    "body": ("~/cmd_vel", twist(), (BODY_RATE, 1.5, -2.5, 0.75, CLOCKWISE)),
    "no frame": ("~/cmd_vel", twist(""), (BODY_RATE, 1.5, -2.5, 0.75, CLOCKWISE)),
    "odom": ("~/cmd_vel", twist("odom"), (GROUND_RATE, 2.5, 1.5, 0.75, CLOCKWISE)),
    "map": ("~/cmd_vel", twist("map"), (GROUND_RATE, 2.5, 1.5, 0.75, CLOCKWISE)),
    "unstamped": (
        "~/cmd_vel_unstamped",
        twist()["twist"],
        (BODY_RATE, 1.5, -2.5, 0.75, CLOCKWISE),
    ),
    # 0.8 m/s for each metre that is missing from x -70, y 30, z 12.34
    "place": (
        "~/setpoint_position",
        pose_at(-72.0, 33.0, 11.34),
        (GROUND_RATE, 2.4, -1.6, -0.8, 0.0),
    ),
    "heading": (
        "~/setpoint_position",
        pose_at(-70.0, 30.0, 12.34, *YAW_30, frame="map"),
        (GROUND_HEADING, 0.0, 0.0, 0.0, 60.0),
    ),
    "tilted heading": (
        "~/setpoint_position",
        pose_at(-70.0, 30.0, 12.34, *TILTED),
        (GROUND_HEADING, 0.0, 0.0, 0.0, 60.0),
    ),
    # 5 m/s at most along the way, 2 m/s up or down
    "far": (
        "~/setpoint_position",
        pose_at(-100.0, 70.0, 0.0),
        (GROUND_RATE, 4.0, -3.0, -2.0, 0.0),
    ),
    "high": ("~/setpoint_position", pose_at(-70.0, 30.0, 99.0), (GROUND_RATE, 0.0, 0.0, 2.0, 0.0)),
}


def asked(work: Callable[[KnownRig], Any], state: State | None = None) -> KnownRig:
    """A rig after a program did something, in the air and with control."""
    rig = KnownRig()

    async def ask() -> None:
        async with rig.running():
            await anyio.sleep(1.0)
            rig.known.tell_package(1.0, without=(Time,), changed=(FIRST,))
            rig.known.tell_package(1.0)
            assert (await rig.program.call("~/obtain_control"))["success"]
            if state is not None:
                rig.known.tell(state)
            rig.known.heard.clear()
            await work(rig)
            await anyio.sleep(0.2)

    anyio.run(ask, backend_options={"loop_factory": virtual_clock_loop})
    return rig


def steered(name: str, message: dict[str, Any], state: State | None = None) -> list[Steer]:
    async def publish(rig: KnownRig) -> None:
        rig.program.publish(name, message)

    steers: list[Steer] = asked(publish, state).known.asked(Steer)
    return steers


@pytest.mark.parametrize("case", STEERED)
def test_a_setpoint_is_flown_with_its_signs_in_its_frame(case: str) -> None:
    name, message, expected = STEERED[case]
    [steer] = steered(name, message)
    found = struct.unpack("<B4f", steer.setpoint.value(FIRMWARE_3_1))
    assert found == pytest.approx(expected, abs=0.01)
    assert (steer.lifetime, steer.fence) == (0.3, 7)


def test_a_place_is_flown_to_no_faster_than_the_guards_allow() -> None:
    slow = State(
        0.0,
        connection="connected",
        firmware="3.1",
        has_authority=True,
        limits=GuardLimits(max_speed_m_s=2.5),
    )
    [steer] = steered("~/setpoint_position", pose_at(-100.0, 70.0, 12.34), slow)
    assert (steer.setpoint.x, steer.setpoint.y) == pytest.approx((2.0, -1.5), abs=0.01)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("~/cmd_vel", twist("camera")),
        ("~/setpoint_position", pose_at(1.0, 2.0, 3.0, frame="base_link")),
        ("~/setpoint_position", pose_at(1.0, 2.0, NAN)),
        ("~/setpoint_position", pose_at(1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 2.0)),
    ],
)
def test_a_setpoint_that_means_nothing_is_not_flown(name: str, message: dict[str, Any]) -> None:
    assert steered(name, message) == []


def test_a_place_is_not_flown_to_while_that_of_the_aircraft_is_unknown() -> None:
    async def publish(rig: KnownRig) -> None:
        await anyio.sleep(0.6)
        with pytest.raises(UsageError, match="the position of the aircraft is unknown"):
            rig.node._place(pose_at(1.0, 2.0, 3.0))
        rig.program.publish("~/setpoint_position", pose_at(1.0, 2.0, 3.0))

    assert asked(publish).known.asked(Steer) == []


def test_the_second_half_of_a_stamp_is_nanoseconds() -> None:
    async def publish(rig: KnownRig) -> None:
        for made_at in (7.9, 8.1):
            rig.program.speed(1.0, made_at=made_at)
            await anyio.sleep(0.2)

    rig = asked(publish)
    assert len(rig.known.asked(Steer)) == 2
    assert rig.node.control.mux.refused["late"] == 0


def test_the_id_of_a_goal_that_is_over_is_no_other_goals() -> None:
    async def ask(rig: KnownRig) -> None:
        client, accepted = Client(rig), []
        for repeated in (0, 1, 0):
            client.count -= repeated
            accepted.append((await client.ask_goal("~/take_off", height=5.0))["accepted"])
            await client.cancel("~/take_off")
            await anyio.sleep(0.2)
        assert accepted == [True, False, True]

    asked(ask)


@pytest.mark.parametrize(
    "state",
    [
        State(0.0, connection="connected", firmware="3.1", has_authority=True, task="land"),
        State(0.0, connection="connected", firmware="3.1", has_authority=True, mission="hotpoint"),
        State(0.0, connection="connected", firmware="3.1"),
    ],
)
def test_a_setpoint_is_not_flown_while_something_else_is(state: State) -> None:
    assert steered("~/cmd_vel", twist(), state) == []


def ordered(*calls: tuple[str, dict[str, Any]]) -> list[Any]:
    """What the agent is asked when a program calls these services."""

    async def call(rig: KnownRig) -> None:
        for name, request in calls:
            answer = await rig.program.call(name, SERVICES[name].kind, **request)
            assert answer["success"], answer

    return asked(call).known.asked(Ask)


def test_while_a_goal_flies_no_setpoint_does() -> None:
    async def publish(rig: KnownRig) -> None:
        rig.known.is_slow = True
        assert (await Client(rig).ask_goal("~/take_off", height=5.0))["accepted"]
        rig.program.publish("~/cmd_vel", twist())

    assert asked(publish).known.asked(Steer) == []


def test_without_control_the_gimbal_is_not_turned() -> None:
    async def turn(rig: KnownRig) -> None:
        rig.known.tell(replace(rig.known.state, has_authority=False))
        flags = dict.fromkeys(("is_relative", "keep_yaw", "keep_pitch", "keep_roll"), False)
        angles = dict.fromkeys(("yaw", "pitch", "roll", "duration"), 1.0)
        kind = SERVICES["~/point_gimbal"].kind
        answer = await rig.program.call("~/point_gimbal", kind, **flags, **angles)
        assert "no control" in answer["message"]
        head = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
        vector = {"x": 0.1, "y": 0.2, "z": 0.3}
        rig.program.publish("~/gimbal_speed", {"header": head, "vector": vector})

    assert asked(turn).known.asked(Ask) == []


def test_on_the_ground_nothing_is_flown() -> None:
    async def publish(rig: KnownRig) -> None:
        for _ in range(4):
            still = Velocity(0.0, 0.0, 0.0, 7)
            rig.known.tell_package(rig.client.now, changed=(FlightStatus(1), still))
            await anyio.sleep(0.25)
        rig.program.publish("~/cmd_vel", twist())

    assert asked(publish).known.asked(Steer) == []


def test_the_gimbal_turns_about_the_axes_of_the_body() -> None:
    """Forward, left, up become roll, pitch up, and clockwise."""

    async def turn(rig: KnownRig) -> None:
        head = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
        vector = {"x": math.radians(5), "y": math.radians(20), "z": math.radians(40)}

        for _ in range(2):  # 20 Hz: what comes 20 ms later is left out
            rig.program.publish("~/gimbal_speed", {"header": head, "vector": vector})
            await anyio.sleep(0.02)

    [ask] = asked(turn).known.asked(Ask)
    assert rates(ask) == (
        -400,
        50,
        -200,
        0x80,
    )


# Bit 0 is absolute; bits 1 to 3 leave yaw, roll, pitch alone.
@pytest.mark.parametrize(
    ("changed", "mode", "tenths"),
    [
        ({}, 1, 25),
        ({"is_relative": True}, 0, 25),
        ({"keep_yaw": True}, 1 + 2, 25),
        ({"keep_roll": True}, 1 + 4, 25),
        ({"keep_pitch": True}, 1 + 8, 25),
        ({"duration": 0.0}, 1, 10),
    ],
)
def test_the_gimbal_points_where_degrees_say(
    changed: dict[str, Any], mode: int, tenths: int
) -> None:
    flags = dict.fromkeys(("is_relative", "keep_yaw", "keep_pitch", "keep_roll"), False)
    request = {"yaw": -110.5, "pitch": -41.5, "roll": 12.5, "duration": 2.5, **flags, **changed}
    [ask] = ordered(("~/point_gimbal", request))
    assert angles(ask) == (
        -1105,
        125,
        -415,
        mode,
        tenths,
    )


TRIGGERS = {
    "~/land": orders.Land(),
    "~/go_home": orders.GoHome(),
    "~/takeoff": orders.TakeOff(),
    "~/arm": orders.StartMotors(),
    "~/disarm": orders.StopMotors(),
    "~/stop": orders.Stop(),
    "~/take_photo": orders.UseCamera(orders.CameraUse.PHOTO),
    "~/start_video": orders.UseCamera(orders.CameraUse.START_VIDEO),
    "~/stop_video": orders.UseCamera(orders.CameraUse.STOP_VIDEO),
    "~/mission/pause": orders.PauseMission(),
    "~/mission/resume": orders.ResumeMission(),
    "~/mission/stop": orders.StopMission(),
    "~/obtain_control": orders.Obtain(),
}


@pytest.mark.parametrize("name", TRIGGERS)
def test_a_trigger_asks_for_what_it_says(name: str) -> None:
    asks = [one.order for one in ordered((name, {}))]
    found = [one for one in asks if not isinstance(one, orders.Halt)]
    assert found == [TRIGGERS[name]]


def test_control_is_given_back_when_it_is_asked_for() -> None:
    async def release(rig: KnownRig) -> None:
        assert (await rig.program.call("~/release_control"))["success"]

    assert asked(release).known.asked(orders.ReleaseLease) == [orders.ReleaseLease("token")]


def mission_point(**changed: Any) -> dict[str, Any]:
    """Degrees and metres; the heading is clockwise from north."""
    return {
        "latitude": -33.1,
        "longitude": 151.2,
        "height": 21.5,
        "heading": -75.0,
        "damping": 1.5,
        "gimbal_pitch": -35.0,
        "turn_counterclockwise": False,
        "actions": [],
    } | changed


# Kinds of m100_msgs/MissionAction in; numbers of the document and their units out: 0 stay (ms),
# 1 photo, 2 and 3 video, 4 turn (°), 5 gimbal pitch (°).
ACTIONS = [(0, 2.5), (1, 0.0), (2, 0.0), (3, 0.0), (4, -60.0), (5, -25.0)]
ACTIONS_OUT = ((0, 1, 2, 3, 4, 5), (2500, 0, 0, 0, -60, -25))
PLAN = {
    "points": [
        mission_point(actions=[{"kind": kind, "value": value} for kind, value in ACTIONS]),
        mission_point(latitude=-33.101, longitude=151.203, turn_counterclockwise=True),
        mission_point(latitude=-33.102, longitude=151.204),
    ],
    "speed": 4.5,
    "max_speed": 7.5,
    "heading": 3,
    "trace": 0,
    "at_end": 2,
    "on_rc_loss": 1,
    "gimbal_by_point": True,
    "repeat": 2,
}


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({}, (3, 7.5, 4.5, 2, 2, 3, 0, 1, 1)),
        ({"gimbal_by_point": False, "at_end": 4}, (3, 7.5, 4.5, 4, 2, 3, 0, 1, 0)),
        ({"speed": 0.0, "max_speed": 0.0, "repeat": 0}, (3, 10.0, 5.0, 2, 1, 3, 0, 1, 1)),
        ({"heading": 1, "trace": 1, "on_rc_loss": 0}, (3, 7.5, 4.5, 2, 2, 1, 1, 0, 1)),
    ],
)
def test_a_mission_is_uploaded_as_it_was_asked_for(
    changed: dict[str, Any], expected: tuple[float, ...]
) -> None:
    """Count, greatest speed, speed, at the end, runs, heading, trace, on RC loss, gimbal."""
    points = PLAN["points"]
    if "trace" in changed:  # rounded corners have no actions
        points = [one | {"actions": []} for one in PLAN["points"]]  # type: ignore[attr-defined]
    [upload] = ordered(("~/mission/upload", PLAN | {"points": points} | changed))
    assert struct.unpack(MISSION, upload.order.mission)[:9] == expected


def test_a_point_is_uploaded_as_it_was_asked_for() -> None:
    [upload] = ordered(("~/mission/upload", PLAN))
    first, second, third = (struct.unpack(POINT, one) for one in upload.order.points)
    place = (math.radians(-33.1), math.radians(151.2))
    assert first[:3] == (0, *(pytest.approx(one, abs=1e-12) for one in place))
    # height, damping, heading, gimbal, turn (1: against the clock), has actions
    assert first[3:9] == (21.5, 1.5, -75, -35, 0, 1)
    assert first[10] & 0x0F == 6
    assert (first[11:17], first[27:33]) == ACTIONS_OUT
    place = (math.radians(-33.101), math.radians(151.203))
    assert second[:3] == (1, *(pytest.approx(one, abs=1e-12) for one in place))
    assert (second[7], second[8], third[0], third[7]) == (1, 0, 2, 0)


@pytest.mark.parametrize(
    "changed",
    [
        {"heading": 4},
        {"trace": 2},
        {"at_end": 5},
        {"on_rc_loss": 2},
        {"repeat": 3},
        {"points": [mission_point(actions=[{"kind": 6, "value": 0.0}])]},
    ],
)
def test_a_number_that_stands_for_nothing_is_not_uploaded(changed: dict[str, Any]) -> None:
    async def upload(rig: KnownRig) -> None:
        kind = SERVICES["~/mission/upload"].kind
        answer = await rig.program.call("~/mission/upload", kind, **PLAN | changed)
        assert answer["success"] is False
        assert next(iter(changed)) in answer["message"] or "0 to 5: STAY" in answer["message"]

    assert asked(upload).known.asked(Ask) == []


@pytest.mark.parametrize("take_off", [True, False])
def test_a_mission_takes_off_when_it_is_asked_to(take_off: bool) -> None:
    [ask] = ordered(("~/mission/start", {"take_off": take_off}))
    assert ask.order == orders.StartMission("", take_off)


def flown(name: str, goal: dict[str, Any], seconds: float = 0.5) -> list[Any]:
    """What an action asks of the agent, which does it at once."""

    async def send(rig: KnownRig) -> None:
        assert (await Client(rig).ask_goal(name, **goal))["accepted"]
        await anyio.sleep(seconds)

    found = asked(send).known.asked(Ask)
    assert {one.fence for one in found} <= {0, 7}
    return [one.order for one in found]


def test_a_flight_goes_where_degrees_and_metres_say() -> None:
    goal = {"latitude": -33.5, "longitude": 151.75, "height": 17.5, "speed": 3.5}
    [order] = flown("~/fly_to", goal)
    assert (order.latitude_deg, order.longitude_deg) == (-33.5, 151.75)
    assert (order.height, order.speed, order.yaw_deg) == (17.5, 3.5, None)
    [order] = flown("~/fly_to", goal | {"speed": 0.0})
    assert order.speed == 5.0


@pytest.mark.parametrize(
    ("height", "climb"), [(25.5, [25.5]), (0.0, []), (12.5, []), (12.0, [12.0])]
)
def test_a_take_off_climbs_to_the_height_above_it(height: float, climb: list[float]) -> None:
    """The known aircraft is 12.34 m high: less than 0.3 m of that is there already."""
    first, *others = flown("~/take_off", {"height": height})
    assert first == orders.TakeOff()
    assert [one.height for one in others] == climb


def test_a_way_is_flown_point_by_point_with_its_waits() -> None:
    points = [
        {"latitude": -33.5, "longitude": 151.75, "height": 17.5, "wait": 1.0},
        {"latitude": -33.25, "longitude": 151.5, "height": 18.5, "wait": 0.0},
    ]
    goal = {"waypoints": points, "speed": 3.5}
    assert [one.height for one in flown("~/fly_mission", goal, 0.6)] == [17.5]
    legs = flown("~/fly_mission", goal, 1.3)
    assert [(one.latitude_deg, one.longitude_deg, one.speed) for one in legs] == [
        (-33.5, 151.75, 3.5),
        (-33.25, 151.5, 3.5),
    ]


@pytest.mark.parametrize(
    ("name", "goal", "feedback"),
    [
        ("~/take_off", {"height": 0.0}, {"height": 12.34}),
        (
            "~/fly_to",
            {"latitude": -33.5, "longitude": 151.75, "height": 17.5, "speed": 3.5},
            {"distance": 81.5, "seconds": 23.25},
        ),
        (
            "~/fly_mission",
            {
                "waypoints": [
                    {"latitude": -33.5, "longitude": 151.75, "height": 17.5, "wait": 0.0},
                    {"latitude": -33.25, "longitude": 151.5, "height": 18.5, "wait": 60.0},
                ],
                "speed": 3.5,
            },
            {"waypoint": 1, "distance": 81.5, "seconds": 23.25},
        ),
    ],
)
def test_a_goal_tells_how_far_it_is(
    name: str, goal: dict[str, Any], feedback: dict[str, float]
) -> None:
    found: dict[str, Any] = {}

    async def send(rig: KnownRig) -> None:
        guided = GuidedFlight("flight to a place", distance_m=81.5, seconds=23.25)
        rig.known.tell(replace(rig.known.state, guided=guided))
        rig.known.is_slow = name != "~/fly_mission"  # its wait takes time enough
        client = Client(rig)
        assert (await client.ask_goal(name, **goal))["accepted"]
        await anyio.sleep(0.8)
        kind = FLIGHTS[name][0]
        key = data_key(0, client.inner(name, "feedback"), f"{kind}_FeedbackMessage")
        found.update(decode(f"{kind}_FeedbackMessage", rig.bus.outlets[key].sent[-1][0]))

    asked(send)
    assert found["feedback"] == pytest.approx(feedback, abs=1e-5)


WAYPOINT = {"latitude": -33.5, "longitude": 151.75, "height": 17.5}


@pytest.mark.parametrize(
    ("name", "goal"),
    [
        ("~/take_off", {"height": -1.0}),
        ("~/take_off", {"height": NAN}),
        ("~/fly_to", WAYPOINT | {"speed": 10.5}),
        ("~/fly_to", WAYPOINT | {"speed": -1.0}),
        ("~/fly_to", WAYPOINT | {"speed": NAN}),
        ("~/fly_to", WAYPOINT | {"speed": 1.0, "latitude": 89.5}),
        ("~/fly_to", WAYPOINT | {"speed": 1.0, "longitude": -180.5}),
        ("~/fly_to", WAYPOINT | {"speed": 1.0, "height": NAN}),
        ("~/fly_mission", {"waypoints": [], "speed": 1.0}),
        ("~/fly_mission", {"waypoints": [WAYPOINT | {"wait": 0.0}] * 501, "speed": 1.0}),
        ("~/fly_mission", {"waypoints": [WAYPOINT | {"wait": -1.0}], "speed": 1.0}),
        ("~/fly_mission", {"waypoints": [WAYPOINT | {"wait": 601.0}], "speed": 1.0}),
    ],
)
def test_a_goal_that_means_nothing_is_not_accepted(name: str, goal: dict[str, Any]) -> None:
    async def send(rig: KnownRig) -> None:
        assert not (await Client(rig).ask_goal(name, **goal))["accepted"]

    assert asked(send).known.asked(FlyTo) == []


def test_the_tables_have_every_input_and_service() -> None:
    assert {name for name, _, _ in STEERED.values()} | {"~/gimbal_speed"} == set(INPUTS)
    with_values = {"~/point_gimbal", "~/mission/upload", "~/mission/start"}
    assert TRIGGERS.keys() | with_values | {"~/release_control"} == SERVICES.keys()


def test_a_gear_that_nobody_tells_is_not_made_up() -> None:
    async def listen(rig: KnownRig) -> None:
        rig.known.tell(Telemetry(STICKS_ALONE, "1.0-document", 1.1))

    rig = asked(listen)
    for name, gear in (("~/joy", ()), ("dji_sdk/rc", (NAN,))):
        found = rig.newest(name)
        assert found is not None
        values = (*found["axes"], *found["buttons"])
        assert values == pytest.approx((0.1, -0.2, 0.3, -0.4, 8000, *gear), nan_ok=True)


# Messages per second at most; 0 where they come when there is something to say.
HZ = {
    **dict.fromkeys(("~/imu", "~/odom", "~/pose", "~/velocity", "/tf", "/clock"), 50),
    **dict.fromkeys(("~/fix", "~/magnetic_field", "dji_sdk/battery_state"), 10),
    **dict.fromkeys(("~/joy", "~/gimbal"), 20),
    **dict.fromkeys(("~/battery", "~/flight_status", "/diagnostics"), 1),
    **dict.fromkeys(("~/home", "~/mission_event", "/tf_static", "/rosout"), 0),
}


def test_what_is_sent_comes_as_often_as_the_manual_says() -> None:
    there = {name: row.hz for name, row in ALL_OUTPUTS.items()}
    assert there == dict.fromkeys(DJI_OUTPUTS, 50) | HZ


def test_packages_of_a_hundred_a_second_are_thinned_to_that(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The node takes a step at every second one, and looks at the graph and for home at fewer."""
    names = ("~/imu", "~/joy", "~/fix", "~/battery", "~/flight_status", "/diagnostics")
    looks = {"step": 50, "look": 2, "_look_for_home": 10}
    counts: Counter[str] = Counter()

    def counted(name: str, do: Callable[[], None]) -> Callable[[], None]:
        def count() -> None:
            counts[name] += 1
            do()

        return count

    async def listen() -> None:
        async with KnownRig().running() as rig:
            parts = (rig.node, rig.node.ends, rig.node.teller)
            for part, name in zip(parts, looks, strict=True):
                monkeypatch.setattr(part, name, counted(name, getattr(part, name)))
            for _ in range(200):
                rig.known.tell_package(rig.client.now)
                await anyio.sleep(0.01)
            counts.update({name: len(rig.sent(name)) for name in names})

    anyio.run(listen, backend_options={"loop_factory": virtual_clock_loop})
    for name, hz in ({name: HZ[name] for name in names} | looks).items():
        assert counts[name] == pytest.approx(2 * hz, abs=1), name


def test_what_came_late_is_not_made_up_for() -> None:
    """After a second of silence 50 Hz are 50 Hz again at once."""
    count = 0

    async def listen() -> None:
        nonlocal count
        async with KnownRig().running() as rig:
            for pause in (0.1, 1.0, 0.01, 0.01, 0.01):
                await anyio.sleep(pause)
                rig.known.tell_package(rig.client.now)
            count = len(rig.sent("~/imu"))

    anyio.run(listen, backend_options={"loop_factory": virtual_clock_loop})
    assert count == 3


def test_each_limit_is_as_agreed() -> None:
    assert limits.differences("apps/ros2") == []
