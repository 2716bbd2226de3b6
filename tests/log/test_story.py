"""What a log tells of a flight, against what its program knows."""

from __future__ import annotations

import asyncio
import contextlib
import math
import random
from bisect import bisect_left
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from mcap.writer import Writer

from m100link import Credentials, Position, Velocity, connect
from m100link.errors import M100Error
from m100link.log import read
from m100link.log.channels import COMMAND
from m100link.log.story import FlightPath, FlightSummary, HomePoint, _CommandReader, read_story
from m100link.protocol.records import Battery
from m100link.sim.line import LineFaults
from m100link.sim.orders import perform
from m100link.sim.ports import driver
from m100link.sim.virtual import VirtualAircraft
from tests.known import LATITUDE, LONGITUDE, position
from tests.log.flight import APP_ID, KEY, flown

pytestmark = pytest.mark.anyio


async def test_the_story_is_that_of_the_flight(tmp_path: Path) -> None:
    seen = await flown(tmp_path / "flight.mcap")
    story = read_story(read(tmp_path / "flight.mcap"))
    assert [span.name for span in story.phases] == [
        "ground",
        "take-off",
        "flight",
        "landing",
        "ground",
    ]
    assert [span.name for span in story.control] == ["pilot", "program", "pilot"]
    assert story.alarms == []
    tasks = [one for one in story.commands if one.command == "start_task"]
    assert [(one.arguments["task"], one.outcome) for one in tasks] == [
        ("take_off", "STARTED"),
        ("land", "STARTED"),
    ]
    [stream] = story.streams
    assert stream.name == "move"
    assert story.phases[2].begin_s < stream.begin_s < stream.end_s < story.phases[3].end_s
    heights = [p.height_m for one in seen if (p := one.get(Position)) is not None]
    speeds = [v.ground_speed_m_s for one in seen if (v := one.get(Velocity)) is not None]
    charges = [b.percent for one in seen if (b := one.get(Battery)) is not None]
    most = story.maxima
    assert most.height_m == max(heights)
    assert most.ground_speed_m_s == max(speeds)
    assert (most.battery_first_percent, most.battery_last_percent) == (charges[0], charges[-1])
    assert most.distance_m == pytest.approx(3.0, abs=0.5)
    assert most.track_m == pytest.approx(3.0, abs=0.8)
    assert most.airborne_s == pytest.approx(
        story.phases[-1].begin_s - story.phases[1].begin_s, abs=1e-6
    )
    assert story.took_off_s == story.phases[1].begin_s
    assert story.packages >= len(seen)


async def test_a_quick_look_finds_the_same_within_its_interval(tmp_path: Path) -> None:
    await flown(tmp_path / "flight.mcap")
    flight = read(tmp_path / "flight.mcap")
    heard: list[float] = []
    whole = read_story(flight)
    quick = read_story(flight, interval_s=0.1, listener=lambda _, at, __: heard.append(at))
    assert [one.name for one in quick.phases] == [one.name for one in whole.phases]
    begins = [one.begin_s for one in quick.phases]
    assert begins == pytest.approx([one.begin_s for one in whole.phases], abs=0.1)
    assert (quick.packages, quick.commands, quick.streams, quick.control[-1]) == (
        *(whole.packages, whole.commands, whole.streams),
        whole.control[-1],
    )
    assert quick.maxima.height_m == pytest.approx(whole.maxima.height_m, abs=0.02)
    assert quick.maxima.silence_s == whole.maxima.silence_s
    assert len(heard) < whole.packages / 2
    assert [one.name for one in quick.alarms] == [one.name for one in whole.alarms]


@pytest.mark.parametrize("seed", range(3))
async def test_a_quick_look_at_a_drawn_flight_has_what_the_whole_one_has(
    seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Legs, faults and damage of the line by the seed; each value within what moves meanwhile."""
    chance, interval_s = random.Random(seed), 1.0
    aircraft = VirtualAircraft(seed=seed, app_id=APP_ID, key=KEY, faults=LineFaults(damage=0.002))
    monkeypatch.setattr(driver, "aircraft_of", lambda _: aircraft)
    with contextlib.suppress(M100Error):
        async with connect("sim://", record=tmp_path / "flight.mcap") as flown:
            await flown.activate(Credentials(app_id=APP_ID, key=KEY))
            async with flown.control() as control:
                await control.take_off()
                for _ in range(3):
                    north, east = chance.uniform(-9, 9), chance.uniform(-9, 9)
                    await control.fly_to(north=north, east=east, up=chance.uniform(0, 3))
                    perform(aircraft, chance.choice(["battery 24", "gps 2", "gps 5", "stall on"]))
                    await asyncio.sleep(chance.uniform(1.0, 3.0))
                    perform(aircraft, "stall off")
    flight = read(tmp_path / "flight.mcap")
    whole, quick = read_story(flight), read_story(flight, interval_s=interval_s)
    for name in ("packages", "commands", "streams", "repeats", "discarded_bytes", "ended"):
        assert getattr(quick, name) == getattr(whole, name), (seed, name)
    for name in ("phases", "control", "alarms"):
        ours, its = getattr(quick, name), getattr(whole, name)
        assert [one.name for one in ours] == [one.name for one in its], (seed, name)
        for one, other in zip(ours, its, strict=True):
            assert one.begin_s == pytest.approx(other.begin_s, abs=interval_s), (seed, one, other)
    most, least = whole.maxima, quick.maxima
    assert least.silence_s == most.silence_s
    assert most.ground_speed_m_s is not None
    assert most.distance_m is not None
    step_m = most.ground_speed_m_s * interval_s
    assert least.distance_m == pytest.approx(most.distance_m, abs=step_m), seed
    times = [place.at_s for place in whole.track.places()]
    places = whole.track.places()
    for place in quick.track.places():
        near = places[max(0, bisect_left(times, place.at_s) - 1)]
        apart = math.hypot(near.north_m - place.north_m, near.east_m - place.east_m)
        assert apart <= step_m + 0.2, (seed, place, near)


ALARMS = {
    "battery_low": (["battery 24"], "battery 24 %"),
    "battery_critical": (["battery 9"], "battery 9 %"),
    "lands_itself": (["battery 9"], "nobody here asked"),
    "gps": (["gps 2"], "GPS health 2"),
    "link_old": (["stall on", "stall off"], "no telemetry for"),
    "authority_lost": (["rc-mode P"], "control was lost"),
    "link_lost": (["unplug"], ""),
}


@pytest.mark.parametrize("name", ALARMS)
async def test_each_alarm_is_reported_with_its_cause(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    orders, text = ALARMS[name]
    aircraft = VirtualAircraft(seed=5, app_id=APP_ID, key=KEY)
    monkeypatch.setattr(driver, "aircraft_of", lambda _: aircraft)
    path = tmp_path / "flight.mcap"
    begun = 0.0
    with contextlib.suppress(M100Error):
        async with connect("sim://", record=path) as flown:
            await flown.activate(Credentials(app_id=APP_ID, key=KEY))
            async with flown.control() as control:
                await control.take_off()
                begun = asyncio.get_running_loop().time()
                for order in orders:
                    perform(aircraft, order)
                    await asyncio.sleep(3.0)
    story = read_story(read(path))
    quick = read_story(read(path), interval_s=0.1)
    assert [one.name for one in quick.alarms] == [one.name for one in story.alarms]
    found = [alarm for alarm in story.alarms if alarm.name == name]
    assert found, story.alarms
    assert text in found[0].text
    assert begun - 1.0 <= found[0].begin_s <= begun + 5.0
    assert found[0].end_s >= found[0].begin_s


async def test_the_farthest_place_is_that_of_the_whole_flight(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not that of its last phase: it is back at home when it lands."""
    path, flown = tmp_path / "flight.mcap", VirtualAircraft(seed=2, app_id=APP_ID, key=KEY)
    monkeypatch.setattr(driver, "aircraft_of", lambda _: flown)
    async with connect("sim://", record=path) as aircraft:
        await aircraft.activate(Credentials(app_id=APP_ID, key=KEY))
        async with aircraft.control() as control:
            await control.take_off()
            await control.fly_to(north=6.0, east=0.0, up=0.0)
            await control.fly_to(north=-6.0, east=0.0, up=0.0)
            await control.land()
    assert read_story(read(path)).maxima.distance_m == pytest.approx(6.0, abs=0.7)


def test_an_ack_of_ours_is_no_answer_of_the_aircraft() -> None:
    """Both ends number their own requests, from 0 on (document 1.4)."""
    story = FlightSummary("a log")
    reader = _CommandReader(story, 0.0, 0.1, None, None)
    head = {"session": 2, "sequence": 9, "command": "start_task"}
    for at, is_ack, direction, name in (
        (1.0, False, "tx", None),
        (1.1, True, "tx", "ours"),
        (1.2, True, "rx", "STARTED"),
    ):
        content = head | {"is_ack": is_ack, "direction": direction, "ack": {"name": name}}
        reader.hear(cast(Any, SimpleNamespace(at=at, topic=COMMAND, content=content.copy)))
    [asked] = story.commands
    assert asked.outcome == "STARTED"
    assert asked.after_s == pytest.approx(0.2)


@pytest.mark.parametrize("name", ["move", "virtual_rc_data", "follow_target"])
def test_frames_that_are_sent_many_times_a_second_are_spans_and_no_commands(name: str) -> None:
    """A gap of more than half a second parts two."""
    story = FlightSummary("a log")
    reader = _CommandReader(story, 0.0, 0.1, None, None)
    head = {"session": 0, "command": name, "is_ack": False, "direction": "tx"}
    for number, at in enumerate((1.0, 1.5, 2.1)):
        content = head | {"sequence": number}
        reader.hear(cast(Any, SimpleNamespace(at=at, topic=COMMAND, content=content.copy)))
    reader.end()
    assert story.commands == []
    assert [(one.name, one.begin_s, one.end_s) for one in story.streams] == [
        (name, 1.0, 1.5),
        (name, 2.1, 2.1),
    ]


@pytest.mark.parametrize("is_off_ground", [True, False])
def test_where_it_is_counts_as_home_on_the_ground_alone(*, is_off_ground: bool) -> None:
    """A recording that begins in flight does not know where the take-off was."""
    path = FlightPath()
    path.hear_phase(0.0, is_off_ground=is_off_ground)
    path.add(1.0, position())
    home = path.home(2.0)
    assert home == (None if is_off_ground else pytest.approx(HomePoint(2.0, LATITUDE, LONGITUDE)))


async def test_an_empty_log_has_an_empty_story(tmp_path: Path) -> None:
    path = tmp_path / "empty.mcap"
    with path.open("wb") as stream:
        writer: Any = Writer(stream)
        writer.start()
        writer.finish()
    story = read_story(read(path))
    assert (story.began_utc, story.duration_s, story.packages) == (None, 0.0, 0)
    assert [*story.phases, *story.control, *story.alarms, *story.streams] == []


async def test_messages_of_others_are_no_reason_to_fail(tmp_path: Path) -> None:
    path = tmp_path / "foreign.mcap"
    with path.open("wb") as stream:
        writer: Any = Writer(stream)
        writer.start()
        for topic, data in (
            ("/m100/command", b"no JSON"),
            ("/m100/command", b"[1, 2]"),
            ("/m100/event", b'{"event": "authority"}'),
            ("/m100/event", b'{"event": "connection", "is_connected": false, "error": 5}'),
            ("/m100/camera", b"\xff\xfe"),
        ):
            channel = writer.register_channel(topic, "json", 0)
            writer.add_message(channel_id=channel, log_time=5, publish_time=5, data=data)
        writer.finish()
    assert read_story(read(path)).commands == []
