"""``m100link sim compare`` and ``fit``: bags of both nodes, flight logs, and what is written."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock, call

import pytest

from m100link.apps.cli import sim_fit
from m100link.apps.cli.sim_fit import read_recording
from m100link.apps.cli.terminal import ExitCode
from m100link.errors import UsageError
from m100link.protocol.firmware import PROFILES
from m100link.protocol.records import (
    Acceleration,
    AngularVelocity,
    Attitude,
    Battery,
    FlightStatus,
    Velocity,
    quaternion,
)
from m100link.protocol.setpoint import ControlMode, Horizontal, ReferenceFrame, Vertical, Yaw
from m100link.sim import read_airframe
from m100link.sim.fit import SIGNALS, Fit, FlightRecording, Found, Residual, SpanFlight
from tests.apps.cli.conftest import CommandLine

rosbag1 = pytest.importorskip("rosbags.rosbag1", reason="the extra `analysis` is not installed")
typesys = pytest.importorskip("rosbags.typesys")

MORE = {
    "mav_msgs/msg/RollPitchYawrateThrust": "std_msgs/Header header\nfloat64 roll\nfloat64 pitch\n"
    "float64 yaw_rate\ngeometry_msgs/Vector3 thrust\n",
    "dji_sdk/msg/AttitudeQuaternion": "std_msgs/Header header\nint32 ts\nfloat32 q0\nfloat32 q1\n"
    "float32 q2\nfloat32 q3\nfloat32 wx\nfloat32 wy\nfloat32 wz\n",
    "dji_sdk/msg/Velocity": "std_msgs/Header header\nint32 ts\nfloat32 vx\nfloat32 vy\n"
    "float32 vz\nuint8 health_flag\n",
}
STORE = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
for _name, _text in MORE.items():
    STORE.register(typesys.get_types_from_msg(_text, _name))


def made(kind: str, **values: Any) -> Any:
    return STORE.types[kind](**values)


def header() -> Any:
    stamp = made("builtin_interfaces/msg/Time", sec=0, nanosec=0)
    return made("std_msgs/msg/Header", seq=0, stamp=stamp, frame_id="")


def vector(x: float, y: float, z: float) -> Any:
    return made("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def turned(w: float, x: float, y: float, z: float) -> Any:
    return made("geometry_msgs/msg/Quaternion", w=w, x=x, y=y, z=z)


def write(path: Path, messages: list[tuple[float, str, Any]]) -> Path:
    with rosbag1.Writer(path) as bag:
        connections: dict[str, Any] = {}
        for at, topic, message in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=STORE)
            data = STORE.serialize_ros1(message, kind)
            bag.write(connections[topic], round(at * 1e9) + 10**9, data)
    return path


def imu(roll: float, pitch: float, yaw: float) -> Any:
    """By the angles of REP 103: pitch nose down, yaw from east, counter-clockwise."""
    cr, sr, cp, sp = (
        math.cos(roll / 2),
        math.sin(roll / 2),
        math.cos(pitch / 2),
        math.sin(pitch / 2),
    )
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    rotation = turned(
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
    import numpy

    unknown = numpy.zeros(9)
    return made(
        "sensor_msgs/msg/Imu",
        header=header(),
        orientation=rotation,
        orientation_covariance=unknown,
        angular_velocity=vector(0.1, 0.2, 0.3),
        angular_velocity_covariance=unknown,
        linear_acceleration=vector(1.0, 2.0, 9.8),
        linear_acceleration_covariance=unknown,
    )


def degrees(row: tuple[float, ...]) -> list[float]:
    return [math.degrees(one) for one in row[1:]]


def test_the_frames_of_djis_later_node(tmp_path: Path) -> None:
    """East, north, up and forward, left, up become north, east, up and roll, pitch, heading."""
    velocity = made("geometry_msgs/msg/Vector3Stamped", header=header(), vector=vector(1, 2, 3))
    command = made(
        "mav_msgs/msg/RollPitchYawrateThrust",
        header=header(),
        **{"roll": math.radians(45), "pitch": math.radians(10), "yaw_rate": math.radians(-20)},
        thrust=vector(0.0, 0.0, 42.0),
    )
    angles = (math.radians(10), math.radians(20), math.radians(60))
    path = write(
        tmp_path / "later.bag",
        [
            (0.0, "/uav1/dji_sdk/imu", imu(*angles)),
            (0.5, "/uav1/dji_sdk/velocity", velocity),
            (0.6, "/uav1/command/roll_pitch_yawrate_thrust", command),
        ],
    )
    seen = read_recording(path)
    assert degrees(seen.attitude[0]) == pytest.approx([10, -20, 30])
    assert seen.rates[0][1:] == (0.1, -0.2, -0.3)
    assert seen.velocity[0] == pytest.approx((0.5, 2.0, 1.0, 3.0))
    at, move = seen.moves[0]
    assert at == pytest.approx(0.6)
    assert move.mode == ControlMode(Horizontal.TILT, Vertical.THRUST, Yaw.RATE)
    assert move[1:5] == pytest.approx((45.0, -10.0, 42.0, 20.0))
    assert move.frame is ReferenceFrame.BODY


def test_the_frames_of_the_node_of_2016(tmp_path: Path) -> None:
    """It publishes what the wire has: north, east, up, and a quaternion of north-east-down."""
    half = math.radians(15)
    attitude = made(
        "dji_sdk/msg/AttitudeQuaternion",
        header=header(),
        **{"ts": 0, "q0": math.cos(half), "q1": math.sin(half), "q2": 0.0, "q3": 0.0},
        **{"wx": 0.5, "wy": 0.25, "wz": -0.5},
    )
    velocity = made(
        "dji_sdk/msg/Velocity",
        **{"header": header(), "ts": 0, "vx": 1.0, "vy": -2.0, "vz": 3.0, "health_flag": 1},
    )
    path = write(
        tmp_path / "earlier.bag",
        [(0.0, "/dji_sdk/attitude_quaternion", attitude), (0.1, "/dji_sdk/velocity", velocity)],
    )
    seen = read_recording(path)
    assert degrees(seen.attitude[0]) == pytest.approx([30, 0, 0], abs=1e-4)
    assert seen.rates[0][1:] == (0.5, 0.25, -0.5)
    assert seen.velocity[0][1:] == (1.0, -2.0, 3.0)


def test_a_file_that_is_no_bag_is_refused(tmp_path: Path, cli: CommandLine) -> None:
    path = tmp_path / "bad.bag"
    path.write_bytes(b"#ROSBAG V2.0\n\xff")
    with pytest.raises(UsageError, match="cannot be read"):
        read_recording(path)
    empty = write(tmp_path / "empty.bag", [(0.0, "/dji_sdk/imu", imu(0.0, 0.0, 0.0))])
    outcome = cli("sim", "compare", str(empty))
    assert outcome.status == ExitCode.USAGE
    assert "no flight under movement commands in empty" in outcome.err


@pytest.fixture
def flown(tmp_path: Path) -> Path:
    """A bag of three seconds in which an aircraft holds 36° to the right although 45 are asked."""
    messages: list[tuple[float, str, Any]] = []
    for step in range(150):
        at = step / 50
        roll = 36.0 * (1.0 - (1.0 + 10.0 * at) * math.exp(-10.0 * at))
        speed = made(
            "geometry_msgs/msg/Vector3Stamped", header=header(), vector=vector(3.0 * at, 0.0, 1.0)
        )
        command = made(
            "mav_msgs/msg/RollPitchYawrateThrust",
            **{"header": header(), "roll": math.radians(45), "pitch": 0.0, "yaw_rate": 0.0},
            thrust=vector(0.0, 0.0, 45.0),
        )
        messages += [
            (at, "/dji_sdk/imu", imu(math.radians(roll), 0.0, math.pi / 2)),
            (at, "/dji_sdk/velocity", speed),
            (at, "/command", command),
        ]
    return write(tmp_path / "flown.bag", messages)


def test_a_fit_is_printed_written_and_flown(cli: CommandLine, flown: Path, tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    words = ("sim", "fit", str(flown), "--airframe", "document", "-o", str(file))
    outcome = cli(*words)
    assert outcome.status == ExitCode.OK, outcome.err
    assert "maximum_tilt_deg" in outcome.out
    assert read_airframe(str(file)).maximum_tilt_deg == pytest.approx(36.0, abs=0.3)
    assert read_airframe(str(file)).velocity_gain == 1.6
    [told] = cli("sim", "compare", str(flown), "--airframe", str(file), "--json").objects
    assert told["signals"][0]["signal"] == "roll"
    assert told["signals"][0]["rms"] < 0.5
    [before] = cli("sim", "compare", str(flown), "--airframe", "document", "--json").objects
    assert before["signals"][0]["rms"] > 4.0
    again = cli(*words)
    assert again.status == ExitCode.USAGE
    assert "is there already" in again.err
    assert cli("sim", "fit").status == ExitCode.USAGE


def test_what_cannot_be_written_or_checked_is_refused_before_the_fit(
    cli: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: object) -> None:
        raise AssertionError("it was fitted")

    monkeypatch.setattr("m100link.apps.cli.sim_fit.fit", never)
    there = tmp_path / "there"
    there.write_text("mine", encoding="utf-8")
    for words, why in (
        (("-o", str(there)), "is there already"),
        (("--plot", str(there)), "is there already"),
        (("--check", str(there)), "is not a flight log"),
    ):
        outcome = cli("sim", "fit", str(there), *words)
        assert outcome.status == ExitCode.USAGE
        assert why in outcome.err.replace("\n", " ")
    assert there.read_text(encoding="utf-8") == "mine"


def test_the_list_says_what_each_verb_of_sim_does(cli: CommandLine) -> None:
    listed = " ".join(cli("sim", "--help").out.split())
    assert "compare Fly the commands of recorded flights" in listed
    assert "fit Find the airframe" in listed


# -- each series by its unit, sign and frame: no bag is written ------------------------------------

HEARD: list[tuple[str, str, dict[str, Any], str, tuple[float, ...]]] = [
    ("sensor_msgs/msg/BatteryState", "battery_state", {"percentage": 0.87}, "battery", (87.0,)),
    ("sensor_msgs/msg/BatteryState", "battery_state", {"percentage": 1.0}, "battery", (100.0,)),
    ("sensor_msgs/msg/BatteryState", "battery_state", {"percentage": 1.5}, "battery", (1.5,)),
    ("dji_sdk/msg/PowerStatus", "power", {"percentage": 63}, "battery", (63.0,)),
    ("std_msgs/msg/Float32", "height_above_takeoff", {"data": 12.5}, "height", (12.5,)),
    ("dji_sdk/msg/GlobalPosition", "place", {"height": 7.25}, "height", (7.25,)),
    ("dji_sdk/msg/Acceleration", "a", {"ax": 1.0, "ay": 2.0, "az": 3.0}, "acceleration", (1, 2, 3)),
    ("std_msgs/msg/UInt8", "flight_status", {"data": 1}, "flying", (0.0,)),
    ("std_msgs/msg/UInt8", "flight_status", {"data": 2}, "flying", (1.0,)),
    ("std_msgs/msg/UInt8", "flight_status", {"data": 3}, "flying", (1.0,)),
    ("std_msgs/msg/UInt8", "flight_status", {"data": 4}, "flying", (1.0,)),
    ("std_msgs/msg/UInt8", "flight_status", {"data": 5}, "flying", (0.0,)),
    (
        "geometry_msgs/msg/QuaternionStamped",
        "attitude",
        # The nose east, by REP 103: no rotation.
        {"quaternion": SimpleNamespace(w=1.0, x=0.0, y=0.0, z=0.0)},
        "attitude",
        (0.0, 0.0, math.pi / 2),
    ),
]


@pytest.mark.parametrize(("kind", "last", "values", "series", "row"), HEARD)
def test_a_topic_is_known_by_its_type_and_last_name(
    kind: str, last: str, values: dict[str, Any], series: str, row: tuple[float, ...]
) -> None:
    recording = FlightRecording(name="one")
    hear = sim_fit._hearer(kind, f"/uav1/{last}")
    assert hear is not None
    hear(recording, 2.5, SimpleNamespace(**values))
    [found] = getattr(recording, series)
    assert found == pytest.approx((2.5, *row))
    assert sim_fit._hearer("std_msgs/msg/String", f"/uav1/{last}") is None


SPEEDS = (Horizontal.VELOCITY, Vertical.VELOCITY, Yaw.RATE)
JOYS: list[tuple[str, list[float], Any, tuple[float, ...], Any]] = [
    # East, north, up and counter-clockwise become north, east, up and clockwise.
    ("ENUvelocity_yawrate", [1, 2, 3, math.radians(20)], SPEEDS, (2, 1, 3, -20), 0),
    (
        "ENUposition_yaw",
        [1, 2, 3, math.radians(90)],
        (Horizontal.POSITION_OFFSET, Vertical.HEIGHT, Yaw.ANGLE),
        (2, 1, 3, 0),
        0,
    ),
    (
        "rollpitch_yawrate_zposition",
        [math.radians(5), math.radians(10), 3, math.radians(20)],
        (Horizontal.TILT, Vertical.HEIGHT, Yaw.RATE),
        (5, -10, 3, -20),
        1,
    ),
    # The flag stands behind the axes; its low byte counts.
    ("generic", [1, 2, 3, math.radians(20), 0x4B], SPEEDS, (1, -2, 3, -20), 1),
    ("generic", [1, 2, 3, math.radians(20), 0x149], SPEEDS, (2, 1, 3, -20), 0),
]


@pytest.mark.parametrize(("name", "axes", "mode", "values", "frame"), JOYS)
def test_setpoints_of_programs_are_those_of_the_wire(
    name: str, axes: list[float], mode: Any, values: tuple[float, ...], frame: int
) -> None:
    topic = f"/dji_sdk/flight_control_setpoint_{name}"
    hear = sim_fit._hearer("sensor_msgs/msg/Joy", topic)
    assert hear is not None
    recording = FlightRecording(name="one")
    hear(recording, 2.5, SimpleNamespace(axes=axes))
    [(at, move)] = recording.moves
    assert (at, tuple(move.mode), int(move.frame)) == (2.5, mode, frame)
    assert move[1:5] == pytest.approx(values)
    for refused in (axes[:-1], [math.nan, *axes[1:]], []):
        hear(recording, 3.0, SimpleNamespace(axes=refused))
    if name == "generic":
        hear(recording, 3.0, SimpleNamespace(axes=[*axes[:4], 0xFF]))
    assert len(recording.moves) == 1


def test_a_flight_log_is_read_in_radians_metres_and_percent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """North, east, up. A battery of 0 to 100 %; what is not finite is left out, and order made."""
    move = {"control_flag": 0x48, "roll_or_x": 1.0, "pitch_or_y": -2.0}
    move |= {"throttle_or_z": 3.0, "yaw": 20.0}

    def message(at: float, direction: str, movement: Any) -> Any:
        found = {"direction": direction, "movement": movement}
        return SimpleNamespace(at=at, content=lambda: found)

    def sample(at: float, **items: Any) -> Any:
        names = ["attitude", "velocity", "angular_velocity", "acceleration", "position"]
        names += ["battery", "flight_status"]
        return SimpleNamespace(received_at=at, **dict.fromkeys(names) | items)

    flight = SimpleNamespace(
        firmware=PROFILES["3.1"],
        messages=lambda _: [
            message(2.0, "tx", move),
            message(1.0, "tx", move | {"roll_or_x": -1.0}),
            message(3.0, "rx", move),
            message(4.0, "tx", None),
            message(5.0, "tx", {"control_flag": 0x49}),
            message(6.0, "tx", move | {"roll_or_x": math.nan}),
        ],
        samples=lambda: [
            sample(
                7.0,
                attitude=Attitude(*quaternion(0.1, 0.2, 0.3)),
                velocity=Velocity(1.0, -2.0, 3.0, None),
                angular_velocity=AngularVelocity(0.1, -0.2, 0.3),
                acceleration=Acceleration(1.0, 2.0, -9.0),
                position=SimpleNamespace(height_m=12.5),
                battery=Battery(63),
                flight_status=FlightStatus(3),
            ),
            sample(6.0, battery=Battery(255), flight_status=FlightStatus(1)),
            sample(6.5, position=SimpleNamespace(height_m=math.nan)),
        ],
    )
    monkeypatch.setattr(sim_fit, "read", lambda _: flight)
    found = read_recording(Path("x/flight.mcap"))
    assert found.name == "flight"
    assert [(at, move.x, move.y, move.z, move.yaw) for at, move in found.moves] == [
        *((1.0, -1.0, -2.0, 3.0, 20.0), (2.0, 1.0, -2.0, 3.0, 20.0))
    ]
    [row] = found.attitude
    assert row == pytest.approx((7.0, 0.1, 0.2, 0.3))
    assert (found.velocity, found.height) == ([(7.0, 1.0, -2.0, 3.0)], [(7.0, 12.5)])
    assert found.rates == [(7.0, 0.1, -0.2, 0.3)]
    assert found.acceleration == [(7.0, 1.0, 2.0, -9.0)]
    assert (found.battery, found.flying) == ([(7.0, 63.0)], [(6.0, 0.0), (7.0, 1.0)])
    flight.firmware = None
    flight.nameless = lambda remedy: UsageError("nobody answers", remedy=remedy)
    with pytest.raises(UsageError, match="nobody answers"):
        read_recording(Path("flight.mcap"))


RESIDUALS = [
    Residual("roll", "°", 1.234, 5.678, 0.98765, -0.04),
    Residual("yaw", "°", 0.5, 0.0, math.nan, 0.0),
]


def test_what_was_fitted_is_told_and_written_with_its_error(
    monkeypatch: pytest.MonkeyPatch, cli: CommandLine, tmp_path: Path
) -> None:
    start = read_airframe("document")
    names = [one.name for one in fields(start)]
    fitted = replace(start, **{names[0]: 1.5})
    made_of = Fit(fitted, [Found(names[0], 1.25, 1.5, 0.03125)])
    asked: list[Any] = []

    class Replayed:
        def __init__(self, recordings: list[Any]) -> None:
            self.names = [one.name for one in recordings]

        def fly(self, airframe: Any) -> Any:
            return [SpanFlight([], [], [()] * 250)] * (2 if airframe == fitted else 1)

    def fit(replays: Any, begin: Any, _: object) -> Fit:
        asked.append((replays.names, begin))
        return made_of

    monkeypatch.setattr(sim_fit, "read_recording", lambda path: SimpleNamespace(name=path.stem))
    monkeypatch.setattr(sim_fit, "ReplayedSpans", Replayed)
    monkeypatch.setattr(sim_fit, "residuals", lambda _: RESIDUALS)
    monkeypatch.setattr(sim_fit, "fit", fit)
    output = tmp_path / "mine.toml"
    words = ["sim", "fit", "a.mcap", "--check", "b.mcap", "--airframe", "document"]
    outcome = cli(*words, "--output", str(output), "--json")
    assert (outcome.status, asked) == (0, [(["a"], start)])
    [told] = outcome.objects
    constants = {"name": names[0], "before": 1.25, "value": 1.5, "error": 0.03125}
    assert told["constants"] == {names[0]: constants}
    rows = told["residuals"]
    assert [(one["recording"], one["airframe"]) for one in rows] == [
        *(("a", "fitted"), ("b, not fitted", "fitted"))
    ]
    assert rows[0]["signals"][0] == RESIDUALS[0]._asdict()
    assert rows[0]["signals"][1]["correlation"] is None
    lines = output.read_text().splitlines()
    assert lines[1:3] == [f"# {name}: rms roll 1.2 °, yaw 0.5 °" for name in ("a", "b, not fitted")]
    assert lines[3] == f"{names[0]} = 1.5  # fitted, ± 0.031"
    assert lines[4].endswith("# as in document")
    shown = cli(*words, "--table").out
    assert " ".join(f"{names[0]} 1.25 1.5 0.031".split()) in " ".join(shown.split())
    assert "a: 5.0 s in 2 flights" in shown
    assert "roll 1.234 ° 1.234 ° 5.68 0.988 -0.04 s" in " ".join(shown.split())
    asked.clear()
    compared = cli("sim", "compare", "a.mcap", "--airframe", "document", "--table").out
    assert "a: 2.5 s in 1 flight" in compared
    assert asked == []
    told = cli("sim", "compare", "a.mcap", "b.mcap", "--airframe", "document", "--json").objects
    assert [(one["recording"], one["airframe"]) for one in told] == [
        *(("a", "document"), ("b", "document"))
    ]
    assert cli("sim", "compare", "--json").status == ExitCode.USAGE


def test_a_picture_of_a_fit_has_each_row_at_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    matplotlib = MagicMock()
    grid = [[MagicMock()] for _ in SIGNALS]
    matplotlib.Figure.return_value.subplots.return_value = grid
    monkeypatch.setattr(sim_fit, "of_extra", lambda *_: matplotlib)
    recorded, flown = ([(begin + step,) * 6 for step in (0.0, 1.0)] for begin in (1.0, 3.0))
    sim_fit._drawn([("a", [SpanFlight([5.03, 5.04], [*recorded], [*flown])])])
    for [axes] in grid:
        assert [drawn.args for drawn in axes.plot.call_args_list] == [
            ([5.03, 5.04], [1.0, 2.0]),
            ([5.03, 5.04], [3.0, 4.0]),
        ]
    assert [axes.set_xlabel.call_args for [axes] in grid] == [None] * 5 + [call("s")]
