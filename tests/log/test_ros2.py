"""A log as a bag of ROS 2, read by rosbags: every value is that of the samples."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import pytest

from m100link import Attitude, Position, Velocity
from m100link.log import read
from m100link.log.ros2 import TOPICS, write_bag
from m100link.protocol.records import (
    Acceleration,
    AngularVelocity,
    Battery,
    FlightStatus,
    RemoteControl,
)
from tests.known import position, sample
from tests.log.flight import flown

if TYPE_CHECKING:
    from m100link.log.reading import FlightLog

rosbag2: Any = pytest.importorskip("rosbags.rosbag2", reason="the judge is not installed")

pytestmark = pytest.mark.anyio


async def bag(tmp_path: Path) -> tuple[Any, dict[str, list[tuple[int, Any]]]]:
    """The log, and the messages of its bag by topic, with their times."""
    from rosbags.typesys import Stores, get_typestore

    await flown(tmp_path / "flight.mcap")
    flight = read(tmp_path / "flight.mcap")
    path = tmp_path / "bag.mcap"
    with path.open("xb") as stream:
        count = write_bag(flight, stream)
    store = get_typestore(Stores.LATEST)
    found: dict[str, list[tuple[int, Any]]] = {topic: [] for topic in TOPICS}
    with rosbag2.Reader(path) as reader:
        assert {
            one.topic: one.msgtype.replace("/msg/", "/") for one in reader.connections
        } == TOPICS
        for connection, at_ns, data in reader.messages():
            message = store.deserialize_cdr(data, connection.msgtype)
            found[connection.topic].append((at_ns, message))
    assert sum(map(len, found.values())) == count
    return flight, found


async def test_rosbags_reads_the_values_of_the_samples(tmp_path: Path) -> None:
    flight, found = await bag(tmp_path)
    samples = list(flight.samples())
    positions = [p for one in samples if (p := one.get(Position)) is not None]
    fixes = [message for _, message in found["/m100/fix"]]
    assert [(m.latitude, m.longitude, m.altitude) for m in fixes] == [
        (p.latitude_deg, p.longitude_deg, p.altitude_m) for p in positions
    ]
    assert {m.status.status for m in fixes} == {0}
    velocities = [v for one in samples if (v := one.get(Velocity)) is not None]
    twists = [message.twist.linear for _, message in found["/m100/velocity"]]
    assert [(m.x, m.y, m.z) for m in twists] == [v.enu for v in velocities]
    charges = [b.percent for one in samples if (b := one.get(Battery)) is not None]
    batteries = [message for _, message in found["/m100/battery"]]
    assert [round(100 * m.percentage) for m in batteries] == charges
    assert all(math.isnan(m.voltage) for m in batteries)
    rates = [r for one in samples if (r := one.get(AngularVelocity)) is not None]
    turning = [message.angular_velocity for _, message in found["/m100/imu"]]
    assert [(m.x, -m.y, -m.z) for m in turning] == [tuple(r) for r in rates]
    attitudes = [a for one in samples if (a := one.get(Attitude)) is not None]
    orientations = [message.orientation for _, message in found["/m100/imu"]]
    assert [(m.x, m.y, m.z, m.w) for m in orientations] == [a.enu_flu_xyzw for a in attitudes]


async def test_frames_are_those_of_rep_103(tmp_path: Path) -> None:
    _, found = await bag(tmp_path)
    # It flies north and up: the second and the third axis of east, north, up.
    linear = [message.twist.linear for _, message in found["/m100/velocity"]]
    assert max(one.y for one in linear) > 1.0 > max(abs(one.x) for one in linear)
    assert max(one.z for one in linear) > 0.3
    _, last = found["/tf"][-1]
    [transform] = last.transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("map", "base_link")
    # It stands level and looks north: a quarter turn from east.
    rotation = transform.transform.rotation
    assert abs(rotation.x) + abs(rotation.y) < 0.02
    assert 2 * math.degrees(math.atan2(rotation.z, rotation.w)) == pytest.approx(90, abs=2)


async def test_times_are_those_of_arrival_and_commands_are_there(tmp_path: Path) -> None:
    flight, found = await bag(tmp_path)
    columns, rows = flight.rows(Position)
    utc = [row[columns.index("utc")] for row in rows if not math.isnan(row[-1])]
    times = [at_ns for at_ns, _ in found["/m100/fix"]]
    assert [at / 1e9 for at in times] == pytest.approx(utc, abs=1e-6)
    stamp = found["/m100/fix"][3][1].header.stamp
    assert stamp.sec * 10**9 + stamp.nanosec == times[3]
    told = Counter("take_off" in message.data for _, message in found["/m100/events"])
    assert told[True] == 1


class KnownLog:
    """A log with packages of the known aircraft, 0.25 s after each other."""

    def __init__(self, *packages: dict[str, Any]) -> None:
        self.packages = packages

    def messages(self, *topics: str) -> Iterator[Any]:
        utc = 1_800_000_004.25
        return iter([SimpleNamespace(utc=utc, at=4.25, data=b"a bird")])

    def samples(self, *, firmware: object) -> list[Any]:
        return [sample(at=4.25 + 0.25 * place, **one) for place, one in enumerate(self.packages)]


def read_known(path: Path, *packages: dict[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """The messages of its bag by topic, as rosbags reads them."""
    from tests.apps.ros2.known import read as flat

    with path.open("xb") as stream:
        write_bag(cast("FlightLog", KnownLog(*packages)), stream)
    found: dict[str, list[dict[str, Any]]] = {topic: [] for topic in TOPICS}
    with rosbag2.Reader(path) as reader:
        for connection, at_ns, data in reader.messages():
            assert abs(at_ns - 1_800_000_004_250_000_000) < 1000, "POSIX time"
            found[connection.topic].append(flat(connection.msgtype, data))
    return found


@pytest.mark.parametrize("topic", TOPICS)
def test_the_bag_has_the_values_of_the_node(topic: str, tmp_path: Path) -> None:
    """In the frames map and base_link; without an origin a place is above the take-off point."""
    from tests.apps.ros2.test_values import ACCELERATION, ORIENTATION, TOLD, agree, header, xyz

    at = 4.25
    usual = {f"/m100/{name}": TOLD[f"~/{name}"] for name in ("imu", "fix", "battery", "joy")}
    above = {"translation": xyz(0.0, 0.0, 12.34), "rotation": ORIENTATION}
    expected = {
        **{name: one | {"header": header("base_link", at)} for name, one in usual.items()},
        "/m100/velocity": TOLD["~/velocity"] | {"header": header("map", at)},
        "/m100/acceleration": {"header": header("map", at), "vector": ACCELERATION},
        "/m100/flight_status": {"data": 3},
        "/m100/events": {"data": "a bird"},
        "/tf": {
            "transforms": {
                "0": {
                    "header": header("map", at),
                    "child_frame_id": "base_link",
                    "transform": above,
                }
            }
        },
    }
    [found] = read_known(tmp_path / "bag.mcap", {})[topic]
    agree(found, expected[topic])


@pytest.mark.parametrize(
    ("record", "silent"),
    [
        (Attitude, {"/tf"}),
        (Position, {"/tf", "/m100/fix"}),
        (Velocity, {"/m100/velocity"}),
        (Acceleration, {"/m100/acceleration"}),
        (Battery, {"/m100/battery"}),
        (RemoteControl, {"/m100/joy"}),
        (FlightStatus, {"/m100/flight_status"}),
        (AngularVelocity, set()),
    ],
)
def test_what_a_package_has_not_is_not_in_the_bag(
    record: type[Any], silent: set[str], tmp_path: Path
) -> None:
    found = read_known(tmp_path / "bag.mcap", {"without": (record,)})
    assert {topic for topic, messages in found.items() if not messages} == silent


@pytest.mark.parametrize("place", [position(latitude=math.nan), position(height=math.nan)])
def test_what_cannot_be_a_place_is_no_transform_and_no_fix(place: Position, tmp_path: Path) -> None:
    found = read_known(tmp_path / "bag.mcap", {"changed": (place,)})
    assert found["/tf"] == []
    assert found["/m100/fix"][0]["status.status"] == -1
