"""Files of shows: what they say, and what is refused by its name."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from m100link.apps.fleet.show.plan.document import Show
from m100link.apps.fleet.show.plan.track import BadShow
from m100link.geodesy import LocalFrame
from tests.apps.fleet.show.shows import FIVE, five


def parse(found: dict[str, Any]) -> Show:
    return Show.parse(json.dumps(found))


def test_the_example_says_what_it_shows() -> None:
    show = Show.read(FIVE)
    assert show.name == "Five in a row become a wedge"
    assert [track.name for track in show.tracks] == ["a1", "a2", "a3", "a4", "a5"]
    assert (show.duration, show.least_distance_m) == (36, 3)
    assert show.tracks[2].moment(36).place == (42, 0, 5)
    assert {track.tube_m for track in show.tracks} == {1.5}


def test_degrees_are_where_metres_are() -> None:
    found = five()
    frame = LocalFrame(52.1, 4.31)
    for aircraft in found["aircraft"]:
        for point in aircraft["waypoints"]:
            latitude, longitude = frame.to_geodetic(point.pop("north"), point.pop("east"))
            point |= {"latitude_deg": latitude, "longitude_deg": longitude}
    for by_degrees, by_metres in zip(parse(found).tracks, Show.read(FIVE).tracks, strict=True):
        for a, b in zip(by_degrees.points, by_metres.points, strict=True):
            assert a.place == pytest.approx(b.place, abs=1e-5)
    del found["origin"]  # then it is the first waypoint
    first = found["aircraft"][0]["waypoints"][0]
    show = parse(found)
    assert show.tracks[0].origin == (first["latitude_deg"], first["longitude_deg"])
    assert show.tracks[0].points[0].place[:2] == pytest.approx((0, 0))
    assert show.tracks[4].points[0].east == pytest.approx(40, abs=1e-3)


def test_what_an_aircraft_may_have_besides() -> None:
    found = five() | {"tube_m": 2.5}
    found["aircraft"][1] |= {"ground_m": -3, "heading_deg": 90}
    first, second, *_ = parse(found).tracks
    assert (first.ground_m, first.heading_deg, first.tube_m) == (0, None, 2.5)
    assert (second.ground_m, second.heading_deg) == (-3, 90)


Change = Callable[[dict[str, Any]], Any]


def at(*path: Any) -> Callable[[Any], Change]:
    """What puts a value there."""

    def value(new: Any) -> Change:
        def change(found: dict[str, Any]) -> None:
            place: Any = found
            for name in path[:-1]:
                place = place[name]
            place[path[-1]] = new

        return change

    return value


POINT = ("aircraft", 1, "waypoints", 2)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (at("format")("m100link waypoint plan"), "the format is"),
        (at("version")(2), "version 2"),
        (at("version")(True), "version true"),
        (at("speed")(3), 'the show: there is no field "speed"'),
        (at("name")(3), "name is 3"),
        (at("least_distance_m")(0), "least_distance_m is 0"),
        (at("least_distance_m")("3"), 'least_distance_m is "3"'),
        (at("tube_m")(-1), "the tube is -1 m"),
        (at("origin")(None), "the show has no origin"),
        (at("origin")([52, 4]), "origin is [52, 4]"),
        (at("origin")({"latitude_deg": 52}), "origin: longitude_deg is missing"),
        (at("origin", "latitude_deg")(91), "the origin is 91°"),
        (at("aircraft")([]), "aircraft is []"),
        (at("aircraft")([{}] * 201), "aircraft is [{}"),
        (at("aircraft", 1)(7), "aircraft 1 is 7"),
        (at("aircraft", 1, "name")("a1"), "a1 stands twice"),
        (at("aircraft", 1, "colour")("red"), 'a2: there is no field "colour"'),
        (at("aircraft", 1, "waypoints")("x"), 'a2: waypoints is "x"'),
        (at("aircraft", 1, "heading_deg")(270), "a2: the heading is 270°"),
        (at(*POINT)(3), "a2, point 2 is 3"),
        (at(*POINT, "up")(3), 'a2, point 2: there is no field "up"'),
        (at(*POINT, "latitude_deg")(52), 'a2, point 2: there is no field "north"'),
        (at(*POINT, "height")(True), "a2, point 2: height is true"),
        (at(*POINT, "north")(math.nan), "a2, point 2: north is NaN"),
        (at(*POINT, "at")(12), "a2: point 2 is at 12 s, the one before at 12 s"),
        (at(*POINT, "at")(10**400), "an integer of 401 digits"),
        (
            at(*POINT)({"at": 24, "latitude_deg": 95, "longitude_deg": 4, "height": 5}),
            "a2, point 2 is at 95° 4°",
        ),
    ],
)
def test_every_mistake_is_named(change: Change, said: str) -> None:
    found = five()
    change(found)
    with pytest.raises(BadShow) as caught:
        parse(found)
    assert said in caught.value.seen


def test_what_is_missing_is_named() -> None:
    found = five()
    del found["aircraft"][1]["waypoints"][2]["height"]
    with pytest.raises(BadShow, match="a2, point 2: height is missing"):
        parse(found)


@pytest.mark.parametrize("text", ["", "[1]", "{", b"\xff", '{"name": 1, "name": 2}'])
def test_what_is_no_json_is_no_show(text: str | bytes) -> None:
    with pytest.raises(BadShow) as caught:
        Show.parse(text)
    assert caught.value.remedy == "give a show as JSON"


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadShow, match=r"nowhere\.json' cannot be read"):
        Show.read(tmp_path / "nowhere.json")
