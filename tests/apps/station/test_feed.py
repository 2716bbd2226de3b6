"""The messages to Foxglove, as a table: values in, values out by its schemas.

LocationFix: degrees, and m above the ellipsoid. FrameTransform: m, and a rotation of the child in
the parent; here east, north, up of the take-off, and forward, left, up. Log: 2 is information, 3 a
warning, 4 an error. Telemetry has the numbers of the wire. No value is computed by the library.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

import anyio
import pytest

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.messages import Event, LeaseChanged, State
from m100link.apps.agent.transports import memory_channels
from m100link.apps.station.foxglove import Feed
from m100link.protocol.records import AngularVelocity, Attitude, Position, Time
from m100link.sim.clock import virtual_clock_loop
from tests.known import LATITUDE, LONGITUDE, KnownAgent, position, quaternion, sample

UTC = 1_800_000_000.0
AT = 4.25
STAMP = {"sec": 1_800_000_004, "nsec": pytest.approx(250_000_000, abs=1000)}
NAN = math.nan


def close(value: float) -> Any:
    return pytest.approx(value, rel=2e-7, abs=2e-7)


def heard(work: Callable[[Feed, KnownAgent, AgentClient], Any]) -> dict[str, list[Any]]:
    """What is published while that is done, by topic; each time is checked against its stamp."""
    found: dict[str, list[Any]] = {}

    async def listen() -> None:
        ours, its = memory_channels(as_bytes=True)
        known = KnownAgent(its)
        async with AgentClient(ours, "station") as agent:

            def publish(number: int, at_ns: int, data: bytes) -> None:
                [topic] = [one.topic for one in feed.channels if one.number == number >= 1]
                said = json.loads(data, parse_constant=pytest.fail)
                stamp = said.get("timestamp")
                if stamp is not None:
                    assert stamp["sec"] * 10**9 + stamp["nsec"] == at_ns
                found.setdefault(topic, []).append(said)

            feed = Feed({"first": agent}, UTC, lambda _: True, publish)
            work(feed, known, agent)

    anyio.run(listen, backend_options={"loop_factory": virtual_clock_loop})
    return found


_W, *_XYZ = quaternion(10.0, 20.0, 90.0 + 130.0 - 360.0)

Q = quaternion(10.0, -20.0, -130.0)
TOLD: dict[str, Any] = {
    "/m100/fix": {
        "timestamp": STAMP,
        "frame_id": "m100",
        "latitude": pytest.approx(LATITUDE, abs=1e-9),
        "longitude": pytest.approx(LONGITUDE, abs=1e-9),
        "altitude": close(87.65),
        "position_covariance": [0.0] * 9,
        "position_covariance_type": 0,  # unknown
    },
    "/tf": {
        "timestamp": STAMP,
        "parent_frame_id": "takeoff",
        "child_frame_id": "m100",
        "translation": {"x": 0.0, "y": 0.0, "z": close(12.34)},
        "rotation": {axis: close(value) for axis, value in zip("xyz", _XYZ, strict=True)}
        | {"w": close(_W)},
    },
    # North, east, up; forward, right, down; radians and raw numbers, as the wire has them.
    "/m100/telemetry": {
        "received_at": AT,
        **{"time.tick": 123_457, "time.nanoseconds": 987_654_321, "time.sync": 1},
        **{f"quaternion.q{place}": close(part) for place, part in enumerate(Q)},
        **{"acceleration.x": 1.5, "acceleration.y": -2.5, "acceleration.z": close(0.7)},
        **{"velocity.x": close(3.21), "velocity.y": close(-1.57), "velocity.z": close(0.84)},
        "velocity.status": 7,
        "angular_velocity.x": close(0.11),
        "angular_velocity.y": close(-0.23),
        "angular_velocity.z": close(0.37),
        "position.latitude_rad": close(math.radians(LATITUDE)),
        "position.longitude_rad": close(math.radians(LONGITUDE)),
        "position.altitude": close(87.65),
        "position.height": close(12.34),
        "position.gps_health": 4,
        **{"magnetometer.x": 313, "magnetometer.y": -1127, "magnetometer.z": 851},
        **{"rc.roll": 1000, "rc.pitch": -2000, "rc.yaw": 3000, "rc.throttle": -4000},
        **{"rc.mode": 8000, "rc.gear": -4545},
        **{"gimbal.roll": 4.5, "gimbal.pitch": -37.25, "gimbal.yaw": 118.75, "gimbal.limits": 6},
        **{"flight_status.status": 3, "battery.percent": 63},
        **{"control_device.mode": 6, "control_device.control": 0x1A},
    },
    "/m100/log": {
        "timestamp": STAMP,
        "level": 3,
        "message": "a bird",
        "name": "first",
        "file": "",
        "line": 0,
    },
    "/m100/state": {
        "connection": "connected",
        "firmware": "3.1",
        "has_authority": True,
        "task": "go home",
        "mission": "hotpoint",
        "round_trip_ms": close(12.3),
        "holder": "somebody",
    },
}


def everything(feed: Feed, known: KnownAgent, agent: AgentClient) -> None:
    state = State(
        0.0,
        connection="connected",
        firmware="3.1",
        has_authority=True,
        task="go home",
        mission="hotpoint",
        round_trip=0.0123,
    )
    known.tell(state, LeaseChanged(3, "somebody"), Event(1, AT, "warning", "a bird"))
    feed.hear("first", sample(at=AT))
    feed.hear_state("first", agent)


@pytest.mark.parametrize("topic", TOLD)
def test_what_is_reported_of_an_aircraft_whose_numbers_all_differ(topic: str) -> None:
    [found] = heard(everything)[topic]
    rotation = found.get("rotation", {"w": 1.0})
    if rotation["w"] < 0.0:  # the same rotation
        found["rotation"] = {axis: -value for axis, value in rotation.items()}
    assert found == TOLD[topic]


def test_the_table_has_every_topic() -> None:
    assert heard(everything).keys() == TOLD.keys()


@pytest.mark.parametrize(("level", "number"), [("info", 2), ("warning", 3), ("error", 4)])
def test_levels_are_those_of_foxglove(level: str, number: int) -> None:
    found = heard(lambda feed, known, agent: known.tell(Event(1, AT, level, "a bird")))
    assert found["/m100/log"][0]["level"] == number


def packages(*given: Any) -> dict[str, list[Any]]:
    """The messages about packages, 10 ms after each other."""

    def tell(feed: Feed, known: KnownAgent, agent: AgentClient) -> None:
        for place, one in enumerate(given):
            feed.hear("first", sample(at=AT + 0.01 * place, **one))

    return heard(tell)


def test_what_a_package_has_not_is_not_reported() -> None:
    assert packages({"without": (Attitude,)}).keys() == {"/m100/telemetry", "/m100/fix"}
    # Nobody knows how high it is: at 0 m it would lie on the ground.
    assert packages({"without": (Position,)}).keys() == {"/m100/telemetry"}


@pytest.mark.parametrize(
    "place", [position(latitude=NAN), position(height=NAN), position(latitude=91.0)]
)
def test_what_cannot_be_a_place_is_not_reported(place: Position) -> None:
    assert packages({"changed": (place,)}).keys() == {"/m100/telemetry"}


def test_what_came_in_another_package_than_the_one_that_is_due_is_reported() -> None:
    """A position at 10 Hz beside a quaternion at 100 Hz may never be in the package that is due."""
    found = packages(
        *(
            {"without": (Position,)} if place != 3 else {"without": (Attitude,)}
            for place in range(6)
        )
    )
    assert len(found["/m100/telemetry"]) == 2
    assert len(found["/m100/fix"]) == len(found["/tf"]) == 1
    assert found["/tf"][0]["translation"]["z"] == close(12.34)


def test_an_attitude_of_another_package_is_reported() -> None:
    usual: list[Any] = [{"without": (Attitude,)}] * 6
    usual[3] = {}
    assert len(packages(*usual)["/tf"]) == 1


def test_of_two_places_the_newest_is_reported() -> None:
    usual: list[Any] = [{"without": (Position, Attitude)}] * 6
    usual[3], usual[5] = {"changed": (position(latitude=-20.0),)}, {}
    found = packages(*usual)
    assert [one["latitude"] for one in found["/m100/fix"]] == [close(LATITUDE)]


def test_it_is_reported_twenty_times_a_second() -> None:
    found = packages(*[{"without": (Time,)}] * 101)
    assert [len(found[one]) for one in ("/m100/telemetry", "/m100/fix", "/tf")] == [21] * 3


def test_what_the_agent_does_not_have_is_not_reported() -> None:
    def tell(feed: Feed, known: KnownAgent, agent: AgentClient) -> None:
        known.tell(State(0.0, connection="connecting"))
        feed.hear_state("first", agent)

    [found] = heard(tell)["/m100/state"]
    assert (found["round_trip_ms"], found["has_authority"]) == (None, False)
    assert (found["connection"], found["holder"], found["task"]) == ("connecting", "", "")


def test_numbers_that_are_none_are_null() -> None:
    """JSON has no NaN; the reader here refuses what Python writes for it."""
    rates = AngularVelocity(NAN, math.inf, 0.37)
    [found] = packages({"changed": (rates,)})["/m100/telemetry"]
    assert [found[f"angular_velocity.{axis}"] for axis in "xyz"] == [None, None, close(0.37)]
