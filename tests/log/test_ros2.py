"""A log as a bag of ROS 2, read by rosbags: every value is that of the samples."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from m100link import Attitude, Position, Velocity
from m100link.log import read
from m100link.log.ros2 import TOPICS, write_bag
from m100link.protocol.records import AngularVelocity, Battery
from tests.log.flight import fly

rosbag2: Any = pytest.importorskip("rosbags.rosbag2", reason="the judge is not installed")

pytestmark = pytest.mark.anyio


async def bag(tmp_path: Path) -> tuple[Any, dict[str, list[tuple[int, Any]]]]:
    """The log, and the messages of its bag by topic, with their times."""
    from rosbags.typesys import Stores, get_typestore

    await fly(tmp_path / "flight.mcap")
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
