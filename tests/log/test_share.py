"""A copy for strangers: nothing of the original is found in its bytes, and the shape stays."""

from __future__ import annotations

import asyncio
import json
import math
import random
import re
import struct
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import Writer

from m100link import Credentials, Position, connect
from m100link.apps.agent import orders
from m100link.apps.agent.lease import Flown, LeaseChange
from m100link.apps.agent.messages import Stage
from m100link.apps.agent.server.authority import HoldingInput, HoldingState
from m100link.errors import LossReason, UsageError
from m100link.flight.authority import AuthorityState
from m100link.flight.mission_state import MissionKind
from m100link.log import read
from m100link.log.channels import RX, TX
from m100link.log.reading import FlightLog
from m100link.log.records import registered
from m100link.log.share import _EVENTS, _KEPT, _NAMES, _VOCABULARY, _Cleaner, _fits, _Moved, share
from m100link.log.story import read_story
from m100link.protocol.firmware import profile
from m100link.protocol.packet import _plan, telemetry_size
from m100link.protocol.setpoint import Horizontal, ReferenceFrame, Vertical, Yaw
from m100link.sim.ports import driver
from m100link.sim.virtual import VirtualAircraft
from tests.log.flight import APP_ID, KEY, URL

pytestmark = pytest.mark.anyio

NAMES = ("Anna Muster", "MAVLink 255 at 10.1.2.3:14550", "SN0K1DB3511234", "/home/anna/flights")


def numbers(value: Any) -> Iterator[float]:
    if isinstance(value, dict | list):
        for one in value.values() if isinstance(value, dict) else value:
            yield from numbers(one)
    elif isinstance(value, float):
        yield value


def is_near(value: float, true_deg: float) -> bool:
    """Within 50 km, in degrees or radians."""
    return min(abs(value - true_deg), abs(math.degrees(value) - true_deg)) < 0.45


def notes(latitude: float, longitude: float) -> list[tuple[str, dict[str, Any]]]:
    """Every kind of note, with places and names in every field that has any."""
    anna, station, serial, path = NAMES
    place = {"latitude_deg": latitude, "longitude_deg": longitude}
    said = f"{anna} at {latitude:.6f}, {longitude:.6f} {serial} {path}"
    who = {"client": station, "by": anna}
    return [
        ("client", {"name": station, "is_there": True, "reason": said}),
        ("clients", {"names": [anna, station]}),
        ("lease", {"holder": anna, "why": "acquired", "number": 3, "flown": said}),
        ("control", {"before": "none", "after": "held", "why": said}),
        ("order", {**who, "order": "fly to", "stage": "asked", "arguments": place, "id": 1}),
        ("order", {**who, "order": said, "stage": "failed", "seen": said, "error": said, **place}),
        ("setpoints", {**who, "setpoint": {"x": 2.0, **place, "mode": {"yaw": said}}}),
        ("state", {"task": said, "limits": {"max_height_m": 50.0, **place}, "waypoint": said}),
        ("plan", {"name": anna, "waypoints": [[latitude, longitude, 5.0]] * 2}),
        ("journal", {"level": "info", "text": said, "topic": ""}),
        ("text", {**who, "text": said}),
        ("mission", {"report": said, "values": place}),
        ("mine", {"value": said, **place}),
        ("authority", {"before": said, "after": place, "reason": said}),
        ("connection", {"is_connected": True, "error": said}),
        (said, place),
    ]


@pytest.mark.parametrize("seed", range(6))
async def test_nothing_of_the_original_is_in_the_copy(tmp_path: Path, seed: int) -> None:
    draw = random.Random(seed)
    latitude = draw.choice((-1, 1)) * draw.uniform(5.0, 70.0)
    longitude = draw.choice((-1, 1)) * draw.uniform(5.0, 175.0)
    firmware = draw.choice(("1.0", "2.3", "3.1"))
    url = f"{URL}&latitude={latitude}&longitude={longitude}&firmware={firmware}&damage=0.02"
    print(f"{seed=} {latitude=} {longitude=} {firmware=}")  # noqa: T201 (of a failure)
    path, copy = tmp_path / "a.mcap", tmp_path / "b.mcap"
    async with connect(url, record=path, acceleration="fused") as aircraft:
        await aircraft.activate(Credentials(app_id=APP_ID, key=KEY))
        await aircraft.send_to_mobile(NAMES[0].encode())
        for event, values in notes(latitude, longitude):
            aircraft.note(event, **values)
        async with aircraft.control() as control:
            await control.take_off()
            await control.fly_to(north=6.0, east=-4.0, up=1.0)
    flight = read(path)
    with copy.open("xb") as stream:
        removed = share(flight, stream)
    assert "Muster" not in str(removed)
    assert removed["positions, moved"] > 100
    assert removed["names, replaced"] > 5
    shared = read(copy)
    assert shared.damage.is_ended
    secrets = [*NAMES, f"{latitude:.3f}", f"{longitude:.3f}", "SDK-v1.0", str(APP_ID), KEY]
    secrets += ["Muster", "10.1.2.3", "SN0K"]
    samples = flight.samples(firmware=firmware)
    places = [place for one in samples if (place := one.get(Position)) is not None]
    true = {struct.pack("<d", one.latitude_rad) for one in places[:: len(places) // 40]}
    for secret in secrets:  # in what stands outside of the compressed parts
        assert secret.encode() not in copy.read_bytes()
    for message in shared.messages():
        for secret in secrets:
            assert secret.encode() not in message.data, (message.topic, secret)
        assert APP_ID.to_bytes(4, "little") not in message.data
        if message.topic in (RX, TX):
            raw = [
                struct.unpack_from("<d", message.data, at)[0] for at in range(len(message.data) - 7)
            ]
            for first, second in zip(raw, raw[8:], strict=False):
                for one, other in ((first, second), (second, first)):
                    assert not (is_near(one, latitude) and is_near(other, longitude))
            assert not [one for one in true if one in message.data]
        else:
            found = list(numbers(content := json.loads(message.data)))
            assert content.get("error", "") == "" or content["event"] == "connection"
            hits = [
                [one for one in found if is_near(one, place)] for place in (latitude, longitude)
            ]
            assert not (hits[0] and hits[1]), (message.topic, hits)
    assert_same_shape(flight, shared, firmware)


def assert_same_shape(flight: FlightLog, shared: FlightLog, firmware: str) -> None:
    """Each place is where it was, seen from the first, and each setpoint is what it was."""
    stories = [read_story(one, firmware=firmware) for one in (flight, shared)]
    before, after = (one.path for one in stories)
    # The copy begins with its first message, which is not the first of the original.
    sent = [[re.sub(r"at [0-9.]+ s", "", one.text) for one in story.streams] for story in stories]
    assert sent[0] == sent[1]
    assert "m north" in sent[1][0]
    assert stories[1].lost_share is None  # the copy has not the frames that would tell
    assert before.frame is not None
    assert after.frame is not None
    one, other = before.track.places(), after.track.places()
    assert math.dist(one[-1][1:3], (6.0, -4.0)) < 1.5
    assert math.dist(one[-1][1:3], other[-1][1:3]) < 0.2


async def test_a_plan_of_another_site_does_not_cost_the_shape(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was uploaded before the flight began, and stands before the first position."""
    path, copy = tmp_path / "a.mcap", tmp_path / "b.mcap"
    virtual = VirtualAircraft(seed=7)
    virtual.gps_health = 0
    monkeypatch.setattr(driver, "aircraft_of", lambda _: virtual)
    async with connect("sim://", record=path, acceleration="fused") as aircraft:
        aircraft.note("plan", name="x", waypoints=[[10.0, 10.0, 5.0]])
        await aircraft.activate(virtual.credentials)
        await asyncio.sleep(2.0)
        virtual.gps_health = 5
        await asyncio.sleep(2.0)
        async with aircraft.control() as control:
            await control.take_off()
            await control.fly_to(north=6.0, east=-4.0, up=1.0)
    with copy.open("xb") as stream:
        share(read(path), stream)
    assert_same_shape(read(path), read(copy), "1.0")


async def test_a_place_far_from_the_first_does_not_show_how_far_it_was_moved(
    tmp_path: Path,
) -> None:
    path, copy = tmp_path / "a.mcap", tmp_path / "b.mcap"
    async with connect(URL, record=path, acceleration="fused") as aircraft:
        aircraft.note("plan", name="x", waypoints=[[47.1, 11.2, 5.0], [0.0, 0.0, 5.0]])
        aircraft.note("state", waypoint="Anna", steered="Anna", x={"y": "Anna"})
    with copy.open("xb") as stream:
        share(read(path), stream)
    [plan] = [
        one.content()
        for one in read(copy).messages("/m100/event")
        if one.content()["event"] == "plan"
    ]
    assert plan["waypoints"][0] == pytest.approx(plan["waypoints"][1], abs=1e-9)
    assert not [one for one in read(copy).messages() if b"Anna" in one.data]


# -- words: a name may stand in any field of any note ----------------------------------------------


WORDS = (
    "Anna Muster",
    "anna-laptop closed",
    "Muster farm",
    "47.123456",
    "SN0K1DB3511234",
    "MUSTER",
)


def drawn(draw: random.Random, depth: int = 0) -> Any:
    """A value of a note of somebody's own program: a word, a number, a list or more of them."""
    match draw.randrange(6 if depth < 3 else 3):
        case 0 | 1:
            return draw.choice(WORDS)
        case 2:
            return draw.choice((471234567, -471234567, 2**40))
        case 3:
            return [drawn(draw, depth + 1) for _ in range(draw.randrange(3))]
        case _:
            return {draw.choice(FIELDS): drawn(draw, depth + 1) for _ in range(4)}


FIELDS = (*_KEPT, *_NAMES, *WORDS, "seen", "text", "arguments", "discards", "round_trips", "names")


def written(path: Path, *messages: tuple[str, Any]) -> FlightLog:
    """A log of another writer, by topic and content."""
    with path.open("xb") as stream:
        writer: Any = Writer(stream)
        writer.start()
        for number, (topic, content) in enumerate(messages):
            channel = registered(writer, topic)
            at = 10**9 * (number + 1)
            writer.add_message(channel, at, json.dumps(content).encode(), at)
        writer.finish()
    return read(path)


@pytest.mark.parametrize("seed", range(20))
def test_no_word_that_is_not_the_librarys_own_is_copied(tmp_path: Path, seed: int) -> None:
    draw = random.Random(seed)
    print(f"{seed=}")  # noqa: T201 (of a failure)
    messages: list[tuple[str, Any]] = [("/m100/link", {"firmware": "1.0", "bytes_sent": 3})]
    for _ in range(300):
        content = {draw.choice(FIELDS): drawn(draw) for _ in range(8)}
        topic = draw.choice(("/m100/event", "/m100/command", "/m100/link"))
        if topic == "/m100/event":
            content["event"] = draw.choice((*_EVENTS, "plan", "journal", *WORDS))
        elif topic == "/m100/link":
            content["firmware"] = "1.0"
        else:
            content |= {"command": drawn(draw), "ack": {"name": drawn(draw), "code": 1}}
        messages.append((topic, content))
    with (tmp_path / "b.mcap").open("xb") as stream:
        share(written(tmp_path / "a.mcap", *messages), stream)
    copied = read(tmp_path / "b.mcap")
    assert sum(copied.summary().messages.values()) > 50
    for one in copied.messages():
        for secret in ("Muster", "MUSTER", "laptop", "farm", "47.12", "SN0K", "471234567"):
            is_counter = secret.isdecimal() and one.topic == "/m100/link"
            assert is_counter or secret.encode() not in one.data, one


@pytest.mark.parametrize(
    ("kind", "value", "fits"),
    [
        (str, "take_off", True), (str, "Muster", False), (int, "take_off", False),
        (bool, True, True), (int, True, False), (int, 999_999, True), (int, 1_000_000, False),
        (float, 3, True), (float, 0.5, True), (int, 0.5, False), (str, 0.5, False),
    ],
)  # fmt: skip
def test_a_value_is_copied_where_the_library_writes_such_a_one(
    kind: type, value: object, fits: bool
) -> None:
    """A number of seven digits or more may be one of somebody."""
    assert _fits(kind, value) is fits


def test_each_word_of_the_agent_may_be_copied() -> None:
    """A new order whose name is no word of the copy would be lost from it."""

    def kinds(one: type[orders.Order]) -> Iterator[str]:
        for kind in one.__subclasses__():
            is_ours = kind.__module__ == orders.__name__  # a test may have made another
            if is_ours and kind not in (orders.EndingOrder, orders.LeaseOrder):
                yield kind.label
            yield from kinds(kind)

    words = {
        str(one.value)
        for kind in (LeaseChange, Flown, HoldingState, HoldingInput, AuthorityState, LossReason,
                     MissionKind, Stage)
        for one in kind
    }  # fmt: skip
    words |= {
        one.name.lower() for kind in (Horizontal, Vertical, Yaw, ReferenceFrame) for one in kind
    }
    assert words | set(kinds(orders.Order)) <= _VOCABULARY


# -- files and disks -------------------------------------------------------------------------------


def test_a_copy_keeps_its_time_numbers_its_clients_and_lies_in_an_ocean(tmp_path: Path) -> None:
    """30° W on the equator is mid-Atlantic, for a flight near it 150° E: mid-Pacific."""
    moved = [_Moved().place(*one) for one in ((47.1, 11.2), (-5.0, -40.0), (10.0, -70.0))]
    assert moved == [(0.0, -30.0), (0.0, 150.0), (0.0, -30.0)]
    cleaner = _Cleaner()
    assert [cleaner._name(one) for one in ("a", "b", "a")] == ["client 1", "client 2", "client 1"]
    note = ("/m100/event", {"event": "control", "before": "none", "after": "held"})
    flight = written(tmp_path / "a.mcap", ("/m100/link", {"firmware": "1.0"}), note)
    with (tmp_path / "b.mcap").open("xb") as stream:
        share(flight, stream)
    assert next(read(tmp_path / "b.mcap").messages()).utc == 1.0


@pytest.mark.parametrize(
    ("firmware", "why"), [(None, "profile: --firmware 1.0"), ("1.0", "nothing that")]
)
def test_a_log_that_says_nothing_has_no_copy(
    tmp_path: Path, firmware: str | None, why: str
) -> None:
    flight = written(tmp_path / "a.mcap", ("/other", {}))
    with (tmp_path / "b.mcap").open("xb") as stream, pytest.raises(UsageError, match=why):
        share(flight, stream, firmware=firmware)


@pytest.mark.parametrize(
    "messages",
    [
        (),
        (("/other", {}),),
        (("/m100/link", {"firmware": "1.0"}),),
        (("/m100/event", {"event": "journal", "text": "x"}),),
        (("/m100/event", {"event": "order", "stage": "asked"}),),
    ],
)
def test_the_original_stays_whatever_is_in_it(
    tmp_path: Path, messages: tuple[tuple[str, Any], ...]
) -> None:
    """A log with nothing to copy was removed, as that of a port that could not be opened."""
    path = tmp_path / "a.mcap"
    flight = written(path, *messages)
    before = path.read_bytes()
    with (tmp_path / "b.mcap").open("xb") as stream, suppress(UsageError):
        share(flight, stream, firmware="1.0")
    assert path.read_bytes() == before


@pytest.mark.parametrize("lost", ["nothing", "its end", "its middle", "a disk"])
async def test_a_damaged_log_and_a_full_disk_cost_the_copy_alone(tmp_path: Path, lost: str) -> None:
    path = tmp_path / "a.mcap"
    async with connect(URL, record=path, acceleration="fused"):
        await asyncio.sleep(6.0)
    data = bytearray(path.read_bytes())
    if lost == "its end":
        del data[len(data) // 2 :]
    elif lost == "its middle":
        data[len(data) // 2 : len(data) // 2 + 300] = bytes(300)
    path.write_bytes(data)
    with (tmp_path / "b.mcap").open("xb") as stream:
        if lost == "a disk":
            full: Any = Full(stream)
            with pytest.raises(OSError, match="No space"):
                share(read(path), full)
        else:
            share(read(path), stream)
            stream.flush()
            assert read(tmp_path / "b.mcap").damage.is_ended
    assert path.read_bytes() == data


class Full:
    """A disk that takes 5,000 bytes."""

    def __init__(self, stream: Any) -> None:
        self._stream, self._left = stream, 5000

    def write(self, data: bytes) -> int:
        self._left -= len(data)
        if self._left < 0:
            raise OSError(28, "No space left on device")
        return int(self._stream.write(data))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def test_a_package_of_two_layouts_is_left_out_when_the_other_has_a_place() -> None:
    """Read by the firmware that a user guessed, its true place would stay in the copy."""
    wrong, right = profile("3.1"), profile("1.0-document")
    flags = next(
        flags
        for flags in range(1 << 12)
        if flags >> 5 & 1
        and not flags & ~(wrong.item_flags & right.item_flags)
        and telemetry_size(flags, wrong) == telemetry_size(flags, right)
        and (_plan(flags, wrong).span(Position, "latitude_rad")
             != _plan(flags, right).span(Position, "latitude_rad"))
    )  # fmt: skip
    value = bytearray(flags.to_bytes(2, "little") + bytes(telemetry_size(flags, right) - 2))
    for name, degrees in (("latitude_rad", 47.1), ("longitude_rad", 11.3)):
        span = _plan(flags, right).span(Position, name)
        value[span] = struct.pack("<d", math.radians(degrees))
    assert _Cleaner().package(bytes(value), wrong, 0.0) is None
    moved = _Cleaner().package(bytes(value), right, 0.0)
    assert moved is not None
    assert struct.pack("<d", math.radians(47.1)) not in moved
