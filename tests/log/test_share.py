"""A copy for strangers: nothing of the original is found in its bytes, and the shape stays."""

from __future__ import annotations

import json
import math
import random
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from m100link import Credentials, Position, connect
from m100link.log import read
from m100link.log.channels import RX, TX
from m100link.log.share import share
from m100link.log.story import read_story
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
    assert removed["positions, moved"] > 100
    assert removed["names, replaced"] > 5
    shared = read(copy)
    assert shared.damage.is_ended
    secrets = [*NAMES, f"{latitude:.3f}", f"{longitude:.3f}", "SDK-v1.0", str(APP_ID), KEY]
    secrets += ["Muster", "10.1.2.3", "SN0K"]
    samples = flight.samples(firmware=firmware)
    places = [place for one in samples if (place := one.get(Position)) is not None]
    true = {struct.pack("<d", one.latitude_rad) for one in places[:: len(places) // 40]}
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
            found = list(numbers(json.loads(message.data)))
            hits = [
                [one for one in found if is_near(one, place)] for place in (latitude, longitude)
            ]
            assert not (hits[0] and hits[1]), (message.topic, hits)
    # The shape: each place is where it was, seen from the first.
    before, after = (read_story(one, firmware=firmware).path for one in (flight, shared))
    assert before.frame is not None
    assert after.frame is not None
    one, other = before.track.places(), after.track.places()
    assert math.dist(one[-1][1:3], (6.0, -4.0)) < 1.5
    assert math.dist(one[-1][1:3], other[-1][1:3]) < 0.2


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
