"""What a node tells: each topic read back by rosbags, /diagnostics, and times of packages."""

from __future__ import annotations

import struct
from collections.abc import Callable
from itertools import pairwise
from random import Random
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import Mock

import anyio
import pytest

from m100link.apps.agent.messages import Event, MissionReport, State
from m100link.apps.ros2.graph import Names, read_attachment
from m100link.apps.ros2.publishers import (
    DiagnosticLevel,
    MessageMaker,
    Stamps,
    Status,
    _Rate,
    _Source,
    diagnostics,
)
from m100link.apps.ros2.topics import OUTPUTS
from m100link.log.cdr import full_name
from m100link.protocol import encode_telemetry
from m100link.protocol.firmware import PROFILES, FirmwareProfile
from m100link.protocol.records import Battery, FlightPhase, Position, Time
from m100link.telemetry.device_clock import DeviceClock
from m100link.telemetry.integrity import Integrity, IntegrityState
from m100link.telemetry.sample import Sample
from m100link.telemetry.state import AircraftState
from m100link.telemetry.subscription import Newest
from tests import known
from tests.apps.ros2.conftest import UTC, Program, Rig, judge
from tests.known import Known

pytestmark = pytest.mark.anyio

AT_EACH_PACKAGE = [name for name, row in OUTPUTS.items() if row.hz >= 50]


def read(name: str, data: bytes) -> Any:
    typesys = judge()
    store = typesys.get_typestore(typesys.Stores.LATEST)
    return store.deserialize_cdr(data, full_name(OUTPUTS[name].kind))


async def told(rig: Rig, seconds: float) -> tuple[list[Sample], dict[str, list[bytes]]]:
    """The samples of a while, and what was sent meanwhile."""
    for outlet in rig.bus.outlets.values():
        outlet.sent.clear()
    samples: list[Sample] = []
    async with rig.client.samples(Newest(10_000)) as subscription:
        with anyio.move_on_after(seconds):
            async for sample in subscription:
                samples.append(sample)
    return samples, {name: [one for one, _ in rig.outlet(name).sent] for name in OUTPUTS}


async def test_every_value_is_that_of_the_sample(rig: Rig, program: Program) -> None:
    await program.up()
    samples, sent = await told(rig, 3.0)
    velocities = [read("~/velocity", one).twist.linear for one in sent["~/velocity"]]
    expected = {one.velocity.enu for one in samples if one.velocity is not None}
    assert {(one.x, one.y, one.z) for one in velocities} <= expected
    assert len(velocities) == pytest.approx(150, abs=3)
    imus = [read("~/imu", one) for one in sent["~/imu"]]
    turned = [(i.orientation.x, i.orientation.y, i.orientation.z, i.orientation.w) for i in imus]
    attitudes = [one.attitude.enu_flu_xyzw for one in samples if one.attitude is not None]
    assert set(turned) <= set(attitudes)
    assert len(turned) == pytest.approx(150, abs=3)  # thinned to 50 Hz
    felt = imus[-1].linear_acceleration
    assert felt.z == pytest.approx(9.8, abs=0.5)  # it hovers
    places = {one[Position] for one in samples if one.get(Position) is not None}
    fixes = [read("~/fix", one) for one in sent["~/fix"]]
    assert {(f.latitude, f.longitude, f.altitude) for f in fixes} <= {
        (p.latitude_deg, p.longitude_deg, p.altitude_m) for p in places
    }
    assert len(fixes) == pytest.approx(30, abs=2)  # thinned to 10 Hz
    charges = {one[Battery].percent for one in samples if one.get(Battery) is not None}
    batteries = [read("~/battery", one) for one in sent["~/battery"]]
    assert {round(100 * one.percentage) for one in batteries} <= charges
    assert read("~/odom", sent["~/odom"][-1]).pose.pose.position.z == pytest.approx(
        rig.height, abs=0.6
    )


async def test_stamps_are_of_the_clock_of_the_aircraft(rig: Rig) -> None:
    rig.node.teller.set_hz("~/imu", 0.0)  # each that there is
    await anyio.sleep(8.0)
    samples, sent = await told(rig, 3.0)
    stamps = [read("~/imu", one).header.stamp for one in sent["~/imu"]]
    times = [one.sec + one.nanosec * 1e-9 - UTC for one in stamps]
    hz = samples[0].profile.tick_hz
    ticks = [one[Time].tick / hz for one in samples if one.attitude is not None]
    gaps = [later - before for before, later in pairwise(times)]
    steps = [later - before for before, later in pairwise(ticks)]
    assert gaps == pytest.approx(steps[: len(gaps)], abs=1e-4)
    assert 8.0 <= samples[0].received_at < samples[-1].received_at <= rig.client.now
    assert times[-1] <= rig.client.now


async def test_nobody_pays_for_what_nobody_hears(rig: Rig) -> None:
    for outlet in rig.bus.outlets.values():
        outlet.has_listeners = False
    await anyio.sleep(1.0)
    _, sent = await told(rig, 2.0)
    assert not any(sent[name] for name in AT_EACH_PACKAGE)
    for outlet in rig.bus.outlets.values():
        outlet.has_listeners = True
    await anyio.sleep(1.0)
    _, sent = await told(rig, 1.0)
    assert all(sent[name] for name in AT_EACH_PACKAGE)


async def test_what_is_made_of_a_package_goes_out_together(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []

    def remembered(what: str, doing: Callable[..., Any]) -> Callable[..., Any]:
        def do(*values: Any) -> Any:
            done.append(what)
            return doing(*values)

        return do

    for source in rig.node.teller._sources:
        monkeypatch.setattr(source, "make", remembered("made", source.make))
    for outlet in rig.bus.outlets.values():
        monkeypatch.setattr(outlet, "put", remembered("sent", outlet.put))
    await anyio.sleep(1.0)
    turns = [before for before, after in pairwise(done) if before != after]
    packages = done.count("made") / len(AT_EACH_PACKAGE)
    # A package, not each message of it, has one turn from making to sending.
    assert 40 < turns.count("made") <= packages


async def test_the_status_is_reported_at_each_change(rig: Rig, program: Program) -> None:
    await program.up()
    said = rig.said("~/flight_status")
    assert {one["phase"] for one in said} >= {1, 2, 3}
    assert said[-1]["has_authority"]
    assert said[-1]["holder"] == "ROS 2"
    assert said[-1]["mode_switch"] == "F"
    assert "take off" in {one["task"] for one in said}


async def test_a_status_that_does_not_change_is_reported_once_a_second(rig: Rig) -> None:
    _, sent = await told(rig, 10.0)
    assert 9 <= len(sent["~/flight_status"]) <= 11


async def test_events_are_in_rosout_those_before_the_node_too(rig: Rig, program: Program) -> None:
    await program.call("~/obtain_control")
    said = rig.said("/rosout")
    assert {one["name"] for one in said} == {"m100"}
    assert [one.text for one in rig.client.events] == [one["msg"] for one in said]
    assert said[0]["stamp"]["sec"] == pytest.approx(UTC, abs=30)


async def test_frames_hang_together(rig: Rig) -> None:
    [standing] = rig.said("/tf_static")[0]["transforms"]
    assert (standing["header"]["frame_id"], standing["child_frame_id"]) == ("map", "odom")
    rotation = standing["transform"]["rotation"]
    assert [rotation[axis] for axis in "xyzw"] == pytest.approx([0, 0, 0, 1])
    [moving] = rig.said("/tf")[-1]["transforms"]
    assert (moving["header"]["frame_id"], moving["child_frame_id"]) == ("odom", "base_link")


async def test_each_message_is_counted_by_its_publisher(rig: Rig) -> None:
    attachments = [read_attachment(one) for _, one in rig.outlet("~/odom").sent]
    assert [one.sequence for one in attachments] == list(range(1, len(attachments) + 1))
    assert len({one.gid for one in attachments}) == 1
    first = [outlet.sent[0][1] for outlet in rig.bus.outlets.values() if outlet.sent]
    assert len({read_attachment(one).gid for one in first}) == len(first)


async def test_a_message_has_the_gid_that_others_reckon_from_the_token(rig: Rig) -> None:
    """As ``Entity`` of rmw_zenoh's liveliness_utils.cpp: XXH128 of the key, its low half first."""
    xxhash = pytest.importorskip("xxhash", reason="the extra ros2 brings it")
    for name in ("~/odom", "/tf", "/rosout"):
        [token] = [
            one
            for one in rig.bus.tokens
            if f"/MP/%/%/m100/{rig.names.full(name).replace('/', '%')}/" in one
        ]
        high, low = struct.unpack(">QQ", xxhash.xxh3_128_digest(token.encode()))
        gid = read_attachment(rig.outlet(name).sent[0][1]).gid
        assert gid == struct.pack("<QQ", low, high), name


# -- what /diagnostics says, and that it says it when something is wrong ---------------------------


def levels(rig: Rig) -> dict[str, DiagnosticLevel]:
    told = rig.said("/diagnostics")[-1]["status"]
    assert all(one["name"].startswith("m100: ") for one in told)
    return {one["name"].removeprefix("m100: "): DiagnosticLevel(one["level"]) for one in told}


async def test_all_is_well(rig: Rig) -> None:
    await anyio.sleep(6.0)
    assert set(levels(rig).values()) == {DiagnosticLevel.OK}
    clock = next(one for one in rig.said("/diagnostics")[-1]["status"] if "clock" in one["name"])
    values = {one["key"]: one["value"] for one in clock["values"]}
    assert 0.0 < float(values["bound of stamps ms"]) < 50.0


async def test_a_low_battery_and_a_line_that_is_gone(rig: Rig) -> None:
    rig.aircraft.vehicle.flight.battery_percent = 20.0
    await anyio.sleep(3.0)
    assert levels(rig)["battery"] is DiagnosticLevel.WARN
    rig.service.close()  # the agent has gone
    await anyio.sleep(10.0)
    assert levels(rig)["line"] is DiagnosticLevel.ERROR
    assert levels(rig)["battery"] is DiagnosticLevel.STALE


async def test_what_was_not_done_is_counted(rig: Rig, program: Program) -> None:
    program.speed(1.0)
    await anyio.sleep(2.0)
    node = next(one for one in rig.said("/diagnostics")[-1]["status"] if "node" in one["name"])
    assert {"key": "setpoints closed", "value": "1"} in node["values"]


async def test_a_position_that_cannot_be_true(rig: Rig) -> None:
    flight = rig.aircraft.vehicle.flight
    flight.start_motors()
    flight.phase = FlightPhase.IN_AIR
    flight.dynamics.place(0.0, 0.0, 10.0)
    await anyio.sleep(6.0)
    assert levels(rig)["navigation"] is DiagnosticLevel.OK
    flight.dynamics.place(500.0, 0.0, 10.0)
    await anyio.sleep(1.5)
    assert levels(rig)["navigation"] is DiagnosticLevel.ERROR
    await anyio.sleep(6.0)
    assert levels(rig)["navigation"] is DiagnosticLevel.OK


def found(known: Known, name: str, **clock: Any) -> Status:
    its = cast(DeviceClock, SimpleNamespace(**clock)) if clock else None
    every = diagnostics(known.view, its)
    return next(one for one in every if one.name == name)


def test_numbers_are_in_the_units_of_their_names() -> None:
    known = Known()
    known.integrity = Integrity(IntegrityState.GOOD, "", 0.25, 0.375, 0.0123)
    assert found(known, "navigation").values == {
        "position test ratio": 0.25,
        "height test ratio": 0.38,  # two places
        "delay ms": 12.3,
    }
    clock = found(known, "clock", uncertainty_s=0.0123, skew_ppm=-4.56, resets=2)
    assert clock.values == {"bound of stamps ms": 12.3, "skew ppm": -4.56, "jumps": 2}


@pytest.mark.parametrize(
    ("uncertainty_s", "level"),
    [
        (0.05, DiagnosticLevel.OK),
        (0.051, DiagnosticLevel.WARN),
        (float("inf"), DiagnosticLevel.WARN),
    ],
)
def test_stamps_are_uncertain_beyond_50_ms(uncertainty_s: float, level: DiagnosticLevel) -> None:
    clock = found(Known(), "clock", uncertainty_s=uncertainty_s, skew_ppm=0.0, resets=0)
    assert clock.level is level
    assert found(Known(), "clock").level is DiagnosticLevel.STALE


@pytest.mark.parametrize(
    ("percent", "level"),
    [
        (31, DiagnosticLevel.OK),
        (30, DiagnosticLevel.WARN),
        (0, DiagnosticLevel.WARN),
        (100, DiagnosticLevel.OK),
        (101, DiagnosticLevel.STALE),
    ],
)
def test_a_battery_is_low_from_thirty_percent_down(percent: int, level: DiagnosticLevel) -> None:
    assert found(Known(Battery(percent)), "battery").level is level


@pytest.mark.parametrize(
    ("age", "level"),
    [(1.2, DiagnosticLevel.OK), (1.3, DiagnosticLevel.STALE), (None, DiagnosticLevel.STALE)],
)
def test_a_line_without_telemetry_is_stale(age: float | None, level: DiagnosticLevel) -> None:
    known = Known()
    known.newest_age = age
    assert found(known, "line").level is level


# -- times of packages: by the clock of the aircraft, asked now and then ---------------------------


PROFILE = PROFILES["1.0"]
HZ = PROFILE.tick_hz


def value(ticks: int, profile: FirmwareProfile) -> bytes:
    fields = (ticks, *[0] * (len(profile.items["time"].fields) - 1))
    return encode_telemetry({"time": fields}, profile)


class Line:
    """Packages that come with a delay that jumps about, and the clock of who listens."""

    def __init__(self) -> None:
        self.now = 100.0
        self.stamps = Stamps(lambda: self.now, lambda: UTC + self.now)

    def package(self, made_at: float, delay: float, *, reboots: float = 0.0) -> float:
        """A package comes; returns its stamp as a time of the listener's clock, s."""
        self.now = made_at + delay
        ticks = round((made_at - reboots) * HZ)
        sample = Sample(value(ticks, PROFILE), PROFILE, self.now)
        self.stamps.hear(sample)
        seconds, nanoseconds = self.stamps.of(sample)
        return seconds - UTC + nanoseconds * 1e-9

    def flight(self, count: int, chance: Random) -> None:
        for number in range(count):
            self.package(101.0 + number / 50, 0.004 + 0.01 * chance.random())


@pytest.fixture
def line() -> Line:
    made = Line()
    made.flight(500, Random(11))
    return made


def test_the_clock_says_when_it_was_made_whatever_the_delay(line: Line) -> None:
    chance = Random(3)
    for number in range(200):
        made_at = 111.0 + number / 50
        stamp = line.package(made_at, 0.004 + 0.08 * chance.random() ** 3)
        assert stamp == pytest.approx(made_at + 0.004, abs=0.002)


def test_it_is_never_later_than_it_came(line: Line) -> None:
    assert line.package(111.0, 0.0) <= 111.0


def test_before_the_clock_is_known_it_is_when_it_came() -> None:
    assert Line().package(101.0, 0.05) == pytest.approx(101.05, abs=1e-6)


def test_a_clock_that_begins_anew_is_asked_at_once(line: Line) -> None:
    line.package(111.0, 0.004)
    assert line.package(111.02, 0.03, reboots=111.0) == pytest.approx(111.05, abs=1e-6)


def test_ticks_far_ahead_are_asked_about(line: Line) -> None:
    line.package(111.0, 0.004)
    assert line.package(140.0, 0.2) == pytest.approx(140.004, abs=0.01)


def test_another_firmware_has_another_clock(line: Line) -> None:
    other = PROFILES["3.1"]
    assert other.tick_hz != HZ
    line.now = 120.0
    sample = Sample(value(7, other), other, 120.0)
    line.stamps.hear(sample)
    assert line.stamps.of(sample) == (round(UTC) + 120, 0)
    assert line.stamps.clock is not None
    assert line.stamps.clock.tick_hz == other.tick_hz


@pytest.mark.parametrize(
    ("at", "stamp"),
    [
        (100.0, (1_800_000_200, 250_000_000)),
        (99.5, (1_800_000_199, 750_000_000)),
        (101.75, (1_800_000_202, 0)),
        (-1.9e9, (0, 0)),  # nothing is from before 1970
    ],
)
def test_a_time_of_the_loop_is_posix_time(at: float, stamp: tuple[int, int]) -> None:
    seconds, nanoseconds = Stamps(lambda: 100.0, lambda: 1_800_000_200.25).at(at)
    assert seconds == stamp[0]
    assert nanoseconds == pytest.approx(stamp[1], abs=1000)


class Asked:
    """A clock that says that everything was made 0.125 s before 500 s."""

    tick_hz = HZ

    def __init__(self) -> None:
        self.asked: list[int] = []
        self.uncertainty_s = 0.001

    def update(self, _tick: int, _at: float) -> None:
        """It knows already."""

    def host_time(self, tick: int) -> Any:
        self.asked.append(tick)
        return SimpleNamespace(time=499.875, uncertainty_s=self.uncertainty_s)


def test_a_clock_is_asked_four_times_a_second_and_ticks_count_in_between() -> None:
    stamps, clock = Stamps(lambda: 500.0, lambda: UTC), Asked()
    stamps.clock = cast(Any, clock)

    def of(seconds: float) -> float:
        sample = Sample(value(1000 + round(seconds * HZ), PROFILE), PROFILE, 500.0)
        sec, nanosec = stamps.of(sample)
        return sec - UTC + nanosec * 1e-9

    assert of(0.0) == pytest.approx(-0.125, abs=1e-6)
    assert of(0.0625) == pytest.approx(-0.0625, abs=1e-3)
    assert of(0.2) == 0.0, "never later than it came"
    assert len(clock.asked) == 1
    assert of(0.25) == pytest.approx(-0.125, abs=1e-6), "asked anew"
    assert of(0.2) == pytest.approx(-0.125, abs=1e-6), "ticks that went back are asked about"
    assert len(clock.asked) == 3
    clock.uncertainty_s = float("inf")
    assert of(5.0) == 0.0
    assert of(5.0) == 0.0
    assert len(clock.asked) == 5, "nobody knows: it is asked again at once"


# -- when a topic is due, and what is said of events and of the line -------------------------------


@pytest.mark.parametrize(
    ("hz", "times", "due"),
    [
        (50.0, (1.0,), 1.016),  # a fifth of the time between two may be missing
        (50.0, (1.0, 1.016), 1.036),
        (50.0, (1.0, 1.03), 1.046),
        (10.0, (1.0, 5.0), 5.08),  # what was missed is not made up for
        (10.0, (1.0, 1.08, 1.181), 1.28),
    ],
)
def test_the_next_message_is_due_when_its_rate_says(
    hz: float, times: tuple[float, ...], due: float
) -> None:
    source = _Source("~/imu", cast(Any, None), lambda *_: None, _Rate(hz))
    for now in times:
        assert source.is_due(now)
        source.report(now)
    assert source.rate.due_at == pytest.approx(due)
    assert (source.is_due(due - 1e-6), source.is_due(due + 1e-6)) == (False, True)


def test_topics_of_one_rate_are_made_of_the_same_packages() -> None:
    rate = _Rate(50.0)
    imu, odom = (_Source(name, cast(Any, None), lambda *_: None, rate) for name in ("imu", "odom"))
    imu.report(1.0)
    assert odom.is_due(1.01), "the package before had nothing for it"
    odom.report(1.01)
    assert not any(one.is_due(1.015) for one in (imu, odom))
    assert imu.is_due(1.02)
    imu.report(1.02)
    odom.report(1.02)
    assert not any(one.is_due(1.03) for one in (imu, odom))


@pytest.mark.parametrize("late", [0.01, 0.02, 0.03])
async def test_the_frame_of_a_pose_has_its_stamp_whoever_listened_first(
    rig: Rig, late: float
) -> None:
    """What looks a transform up by the stamp of ~/odom finds it, and guesses nothing."""
    names = ("/tf", "~/odom", "~/pose")
    for place, name in enumerate(names):
        rig.outlet(name).has_listeners = False
        rig.node.ends.look()
        await anyio.sleep(1.0 + place * late)
    for name in names:
        rig.outlet(name).has_listeners = True
        rig.node.ends.look()
        await anyio.sleep(late)
    await anyio.sleep(0.5)
    for name in names:
        rig.outlet(name).sent.clear()
    await anyio.sleep(1.0)
    frames, odom, pose = (rig.said(name) for name in names)
    stamps = [one["transforms"][0]["header"]["stamp"] for one in frames]
    assert len(stamps) == pytest.approx(50, abs=2)
    assert stamps == [one["header"]["stamp"] for one in odom]
    assert stamps == [one["header"]["stamp"] for one in pose]


class Said:
    def __init__(self) -> None:
        self.said: list[dict[str, Any]] = []
        self.is_wanted = True

    def say(self, message: dict[str, Any]) -> None:
        self.said.append(message)


def maker(names: Names) -> tuple[MessageMaker, dict[str, Said]]:
    topics = {name: Said() for name in ("/rosout", "~/mission_event")}
    agent: Any = SimpleNamespace(now=7.25, on_event=[], on_mission_report=[])
    return MessageMaker(agent, names, cast(Any, topics), lambda: 1_800_000_000.5, Mock()), topics


@pytest.mark.parametrize(
    ("level", "number"), [("info", 20), ("warning", 30), ("error", 40), ("odd", 20)]
)
def test_an_event_has_its_level_its_time_and_the_name_of_the_node(level: str, number: int) -> None:
    """Of rcl_interfaces/Log; a logger is named with dots."""
    one, topics = maker(Names.of("/drones/first", "a1"))
    one._event(Event(3, 6.0, level, "a bird"))
    [said] = topics["/rosout"].said
    assert (said["level"], said["name"], said["msg"]) == (number, "drones.first.a1", "a bird")
    assert said["stamp"] == {"sec": 1_799_999_999, "nanosec": pytest.approx(250_000_000, abs=1000)}
    assert one._named == "drones/first/a1"


@pytest.mark.parametrize(
    ("data", "told"),
    [(b"", [0] * 5), (b"\x07\x08", [7, 8, 0, 0, 0]), (bytes(range(1, 9)), [1, 2, 3, 4, 5])],
)
def test_a_mission_event_has_five_bytes(data: bytes, told: list[int]) -> None:
    one, topics = maker(Names.of("/drones/first", "a1"))
    one._mission(MissionReport(2, data))
    [said] = topics["~/mission_event"].said
    assert (said["event"], said["data"]) == (2, told)
    assert said["header"]["frame_id"] == "drones/first/base_link"


def test_rates_are_pauses_and_none_is_each() -> None:
    one, _ = maker(Names.of("/", "m100"))
    rate = _Rate(50.0)
    source = _Source("~/imu", cast(Any, None), lambda *_: None, rate)
    one._sources = [source, _Source("~/odom", cast(Any, None), lambda *_: None, rate)]
    for hz, pause in ((8.0, 0.125), (0.0, 0.0), (50.0, 0.02)):
        one.set_hz("~/imu", hz)
        assert (source.rate.pause, one.hz["~/imu"]) == (pause, hz)
        assert one._sources[1].rate is rate
    assert source.rate is rate


@pytest.mark.parametrize(
    ("heard_at", "is_gone", "connection", "level", "message"),
    [
        (38.0, False, "connected", DiagnosticLevel.OK, "connected"),
        (37.9, False, "connected", DiagnosticLevel.ERROR, "the agent is silent"),
        (40.0, True, "connected", DiagnosticLevel.ERROR, "the agent has gone"),
        (40.0, False, "waiting", DiagnosticLevel.ERROR, "waiting"),
    ],
)
def test_a_line_that_is_not_heard_says_who_is_silent(
    heard_at: float, is_gone: bool, connection: str, level: DiagnosticLevel, message: str
) -> None:
    state = AircraftState(lambda: 40.0)
    state.update(known.sample(at=39.75))
    told = State(0.0, connection, firmware="3.1", round_trip=0.0625)
    view = known.seen(state, 40.0, state=told, heard_at=heard_at, is_gone=is_gone)
    line = next(one for one in diagnostics(view, None) if one.name == "line")
    assert (line.level, line.message) == (level, message)
    assert line.values["round trip ms"] == 62.5
    assert line.status("m100") == {
        "level": level,
        "name": "m100: line",
        "message": message,
        "hardware_id": "DJI Matrice 100",
        "values": [{"key": key, "value": str(one)} for key, one in line.values.items()],
    }
