"""Files of shows: what they say, and what is refused by its name."""

from __future__ import annotations

import itertools
import json
import math
import random
import struct
import xml.etree.ElementTree as ET
import zlib
from collections.abc import Callable
from contextlib import suppress
from itertools import combinations, permutations
from pathlib import Path
from typing import Any

import pytest

from m100link.apps.fleet.show.plan.document import (
    SKEW_S,
    Show,
    check,
    distances,
    imported,
    needed_m,
    svg,
)
from m100link.apps.fleet.show.plan.track import (
    BadShow,
    TimedPoint,
    TimedTrack,
    Windows,
    apart,
    closest,
)
from m100link.errors import BadPlan
from m100link.flight.guards import Envelope
from m100link.geodesy import LocalFrame
from m100link.missions.plan import WaypointPlan
from tests.apps.fleet.show.shows import FIVE, five, show_of, track


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
        (at("origin", "latitude_deg")(91), "the origin is at 91°"),
        (at("aircraft")([]), "aircraft is []"),
        (at("aircraft")([{}] * 201), "aircraft is [{}"),
        (at("aircraft", 1)(7), "aircraft 1 is 7"),
        (at("aircraft", 1, "name")("a1"), "two of the aircraft have the name a1"),
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
    with pytest.raises(BadShow, match=r"nowhere\.json' cannot be read") as caught:
        Show.read(tmp_path / "nowhere.json")
    with pytest.raises(BadPlan) as same:
        WaypointPlan.read(tmp_path / "nowhere.json")
    assert (caught.value.cause, caught.value.remedy) == (same.value.cause, same.value.remedy)
    assert same.value.remedy


# -- what is wrong with a show: every rule by a show that breaks this one --------------------------


HERE = track("a1", (0, 0, 0, 5), (20, 20, 0, 5))


def said(show: Show, envelope: Envelope | None = None) -> list[str]:
    report = check(show, envelope)
    assert report.ok == (not report.problems)
    return [problem.seen for problem in report.problems]


def test_the_example_may_be_flown() -> None:
    report = check(Show.read(FIVE))
    assert report.ok
    assert report.remarks == ()
    assert report.closest is not None
    assert {report.closest.first, report.closest.second} <= {"a1", "a2", "a3", "a4", "a5"}
    assert report.closest.distance_m == pytest.approx(10.0, abs=2e-3)
    assert report.closest.needed_m < 7


def test_one_alone_comes_near_to_nobody() -> None:
    assert check(show_of(HERE)).closest is None
    assert distances(show_of(HERE)) == []


@pytest.mark.parametrize("names", [*itertools.permutations(("a1", "a2", "a3"))])
def test_the_nearest_two_of_three_are_named_in_whatever_order_they_stand(
    names: tuple[str, ...],
) -> None:
    places = {"a1": 0, "a2": 9, "a3": 60}  # metres east
    tracks = [track(one, (0, 0, places[one], 5), (20, 20, places[one], 5)) for one in names]
    closest = check(show_of(*tracks)).closest
    assert closest is not None
    assert {closest.first, closest.second} == {"a1", "a2"}
    assert closest.distance_m == pytest.approx(9.0, abs=1e-3)


@pytest.mark.parametrize(
    ("points", "words"),
    [
        ([(0, 0, 0, 5), (60, 0, 0, 60)], "a height of 60.0 m was refused"),
        ([(0, 0, 0, 5), (200, 160, 0, 5)], "160 m from the start was refused"),
        ([(0, 0, 0, 5), (20, 20, 0, 0.5)], "flies 0.5 m above its take-off point"),
        ([(0, 0, 0, 5), (15, 90, 0, 5)], "flies 9.0 m/s between 0 and 15 s"),
        ([(0, 0, 0, 5), (10, 0, 0, 25)], "climbs or descends at 3.0 m/s between 0 and 10 s"),
        ([(0, 0, 0, 5), (2, 3, 0, 5)], "accelerates by 4.5 m/s² between 0 and 2 s"),
    ],
)
def test_limits_of_one_aircraft(
    points: list[tuple[float, float, float, float]], words: str
) -> None:
    assert words in "\n".join(said(show_of(track("a1", *points))))


def test_what_is_advised_is_enough() -> None:
    """A leg that gets the time which the message names passes."""
    for points, field, needed in (
        # At 9 m/s where 8 are allowed, and by 4.5 m/s² where 1.5 are: that goes by the square.
        ([(0.0, 0.0, 0.0, 5.0), (15.0, 90.0, 0.0, 5.0)], "flies", 15 * 9 / 8),
        ([(0.0, 0.0, 0.0, 5.0), (2.0, 3.0, 0.0, 5.0)], "accelerates", 2 * 3**0.5),
    ):
        [problem] = [p for p in check(show_of(track("a1", *points))).problems if field in p.seen]
        seconds = float(problem.remedy.removeprefix("give it ").split(" s")[0])
        assert seconds == pytest.approx(needed, abs=0.05)
        slower = [points[0], (seconds + 0.1, *points[1][1:])]
        assert not [one for one in said(show_of(track("a1", *slower))) if field in one]


def test_heights_are_those_above_its_own_take_off_point() -> None:
    points = (0, 0, 0, 5), (60, 0, 0, 45)
    assert said(show_of(track("a1", *points))) == []
    assert "a height of 55.0 m" in said(show_of(track("a1", *points, ground_m=-10)))[0]
    assert "-5.0 m above its take-off" in said(show_of(track("a1", *points, ground_m=10)))[0]


def test_the_envelope_may_be_another_one() -> None:
    far = show_of(track("a1", (0, 0, 0, 5), (100, 160, 0, 5)))
    assert len(said(far)) == 1
    assert said(far, Envelope(max_radius_m=200)) == []
    assert "1.6 m/s are allowed" in said(far, Envelope(max_radius_m=200, max_speed_m_s=2))[0]


# -- together -------------------------------------------------------------------------------------


def test_take_off_spots_and_ends_are_far_enough_apart() -> None:
    over = track("a2", (0, 0, 5, 20), (20, 40, 5, 20))
    assert (
        "a1 and a2 take off 5.0 m from each other, seen from above; 6.0 m"
        in said(show_of(HERE, over))[0]
    )
    ending = track("a2", (0, 60, 0, 20), (30, 60, 9, 20), (60, 25, 0, 20))
    assert "a1 and a2 end 5.0 m from each other" in said(show_of(HERE, ending))[0]


def test_two_that_come_too_near_are_named_with_the_time_and_the_distance() -> None:
    first = track("a1", (0, 0, 0, 5), (20, 30, 0, 5))
    second = track("a2", (0, 30, 3, 5), (20, 0, 3, 5))
    [problem] = check(show_of(first, second)).problems
    assert "a1 and a2 come as near as 3.0 m at 10.00 s; 6.2 m are needed" in problem.seen
    assert problem.aircraft == ("a1", "a2")
    assert problem.at == pytest.approx(10.0, abs=0.1)
    assert problem.measured == pytest.approx(3.0, abs=2e-3)
    assert check(show_of(first, track("a2", (0, 30, 7, 5), (20, 0, 7, 5)))).ok
    # At up to 6 m/s 6.57 m are needed: the boxes of their ways are looked at as far as that.
    first = track("a1", (0, 0, 0, 5), (20, 80, 0, 5))
    second = track("a2", (0, 80, 12.5, 5), (10, 40, 6.5, 5), (20, 0, 12.5, 5))
    _, problem = check(show_of(first, second)).problems
    assert "a1 and a2 come as near as 6.5 m at 10.00 s; 6.6 m are needed" in problem.seen


def test_what_two_need_is_their_tubes_and_what_clocks_are_wrong_by() -> None:
    first = track("a1", (0, 0, 0, 5), (20, 40, 0, 5), tube_m=2.0)  # 3 m/s in the middle
    second = track("a2", (0, 0, 9, 5), (20, 0, 9, 15), tube_m=1.0)  # 0.75 m/s
    expected = 4.0 + 2.0 + 1.0 + SKEW_S * (3.0 + 0.75)
    assert needed_m(show_of(first, second, least=4.0), first, second) == pytest.approx(
        expected, abs=0.01
    )


def test_an_aircraft_above_another_is_remarked() -> None:
    lower = track("a1", (0, 0, 0, 5), (20, 30, 0, 5))
    upper = track("a2", (0, 30, 0, 20), (20, 0, 0, 20))
    report = check(show_of(lower, upper))
    assert report.ok
    [remark] = report.remarks
    assert remark.startswith("a2 is above a1 at ")
    assert remark.endswith("if it fails or lands there, it falls on it")


def test_the_curve_of_distances_never_goes_below_the_nearest() -> None:
    show = Show.read(FIVE)
    nearest = check(show).closest
    assert nearest is not None
    found = distances(show)
    assert (found[0][0], found[-1][0]) == (0, 36)
    assert min(distance for _, distance in found) >= nearest.distance_m - 1e-3
    assert all(math.isfinite(distance) for _, distance in found)


@pytest.mark.parametrize("is_higher", ["a1", "a2"])
@pytest.mark.parametrize("ends_first", ["a1", "a2"])
def test_the_curve_counts_one_that_has_ended_as_landing(ends_first: str, is_higher: str) -> None:
    """Anywhere between its last point and the ground: 5 m beside that, whatever the height."""
    tracks = []
    for name, east in (("a1", 0), ("a2", 5)):
        place = 0, east, 20 if name == is_higher else 6
        tracks.append(track(name, (0, *place), (10 if name == ends_first else 20, *place)))
    found = distances(show_of(*tracks))
    before = {round(distance, 3) for at, distance in found if at < 10}
    after = {round(distance, 3) for at, distance in found if 10 <= at < 20}
    assert len(before) == len(after) == 1
    assert min(before) > 5.0
    # The lower one lands below the other: the height between them is left.
    assert after == ({5.0} if ends_first == is_higher else before)
    assert found[-1] == pytest.approx((20.0, 5.0))  # both, seen from above


# -- the picture of a show: well-formed, with everybody in it and what the check found -------------


SVG = "{http://www.w3.org/2000/svg}"


def words(root: ET.Element) -> list[str]:
    return [one.text or "" for one in root.iter(f"{SVG}text")]


def drawn(show: Show) -> ET.Element:
    return ET.fromstring(svg(show, check(show)))


def test_every_aircraft_has_a_line_and_a_name() -> None:
    root = drawn(Show.read(FIVE))
    titles = [one.text for one in root.iterfind(f"{SVG}g/{SVG}title")]
    assert titles == ["a1", "a2", "a3", "a4", "a5"]
    assert {"a1", "a5", "N ↑", "36 s"} <= set(words(root))
    assert len(root.findall(f"{SVG}g/{SVG}polyline")) == 5


def test_the_nearest_two_are_reported_at_their_time() -> None:
    first = track("a1", (0, 0, 0, 5), (20, 30, 0, 5))
    second = track("a2", (0, 30, 3, 5), (20, 0, 3, 5))
    told = words(drawn(show_of(first, second)))
    assert "a1 and a2: 3.0 m at 10.0 s" in told
    assert "6.2 m needed" in told


def test_north_is_up_and_scales_are_equal() -> None:
    root = drawn(show_of(track("a1", (0, 0, 0, 5), (20, 30, 0, 5), (40, 30, 10, 5))))
    line = root.find(f"{SVG}g/{SVG}polyline")
    assert line is not None
    spots = [tuple(map(float, pair.split(","))) for pair in line.get("points", "").split()]
    (x0, y0), (x2, y2) = spots[0], spots[-1]
    assert y2 < y0
    assert (y0 - y2) / (x2 - x0) > 2.9


def test_names_are_words_and_no_markup() -> None:
    root = drawn(show_of(track("<b>&", (0, 0, 0, 5), (20, 30, 0, 5))))
    assert "<b>&" in words(root)


def spots_of(line: ET.Element) -> list[tuple[float, float]]:
    pairs = (pair.split(",") for pair in line.get("points", "").split())
    return [(float(x), float(y)) for x, y in pairs]


@pytest.mark.parametrize("far", [(200.0, 3.0), (3.0, 200.0), (0.2, 0.1)])
def test_everything_is_inside_of_the_picture(far: tuple[float, float]) -> None:
    """However long and narrow the show is; its tracks fill the map one way and leave an edge."""
    first = track("a1", (0, 0, 0, 5), (60, far[0], far[1], 5))
    second = track("a2", (0, 0, 9, 5), (60, far[0], far[1] + 9, 15))
    root = drawn(show_of(first, second))
    width, height = map(float, root.get("viewBox", "").split()[2:])
    tracks = [spot for line in root.iterfind(f"{SVG}g/{SVG}polyline") for spot in spots_of(line)]
    lines = [spot for line in root.iter(f"{SVG}polyline") for spot in spots_of(line)]
    words = [(float(one.get("x", "")), float(one.get("y", ""))) for one in root.iter(f"{SVG}text")]
    for x, y in [*lines, *words]:
        assert 0 <= x <= width
        assert 0 <= y <= height
    assert min(x for x, _ in tracks) >= 8
    assert min(y for _, y in tracks) >= 8
    wide = max(x for x, _ in tracks) - min(x for x, _ in tracks)
    tall = max(y for _, y in tracks) - min(y for _, y in tracks)
    assert wide > 0.5 * width or tall > 0.25 * height


def test_the_distance_is_drawn_from_its_first_to_its_last_second_and_upwards() -> None:
    first = track("a1", (0, 0, 0, 5), (20, 30, 0, 5))
    second = track("a2", (0, 30, 3, 5), (20, 0, 3, 5))
    axes, needed, curve = (
        spots_of(line) for line in drawn(show_of(first, second)).findall(f"{SVG}polyline")
    )
    (left, top), (_, bottom), (right, _) = axes
    assert (curve[0][0], curve[-1][0]) == (left, right)
    assert [x for x, _ in needed] == [left, right]
    lowest = max(curve, key=lambda spot: spot[1])
    assert lowest[0] == pytest.approx((left + right) / 2, abs=5), "they pass each other at 10 s"
    metre = (bottom - lowest[1]) / 3.0  # and are 3 m apart then
    assert bottom - needed[0][1] == pytest.approx(6.2 * metre, rel=0.03)
    assert bottom - curve[0][1] == pytest.approx(30.15 * metre, rel=0.03)
    assert top < curve[0][1] < bottom


@pytest.mark.parametrize(("begins", "apart", "anchor"), [(5, 9, "start"), (35, 3, "end")])
def test_words_stand_beside_what_they_name(begins: float, apart: float, anchor: str) -> None:
    """Up to 14 pixels from that; the map is above the distances."""
    times = 0, begins, begins + 20, 60
    first = track(
        "a1", *((at, north, 0, 5) for at, north in zip(times, (0, 0, 30, 30), strict=True))
    )
    ways = zip(times, (30, 30, 0, 0), strict=True)
    second = track("a2", *((at, north, apart, 5) for at, north in ways))
    root = drawn(show_of(first, second))
    found = {one.text or "": one for one in root.iter(f"{SVG}text")}
    placed = {
        words: (float(one.get("x", "")), float(one.get("y", ""))) for words, one in found.items()
    }
    axes, needed, _ = map(spots_of, root.findall(f"{SVG}polyline"))
    (left, top), (_, bottom), (right, _) = axes
    starts = [spots_of(line)[0] for line in root.iterfind(f"{SVG}g/{SVG}polyline")]
    [nearest] = root.findall(f"{SVG}circle")
    near = float(nearest.get("cx", "")), float(nearest.get("cy", ""))
    [said] = [words for words in placed if words.startswith("a1 and a2: ")]
    [limit] = [words for words in placed if words.endswith(" needed")]
    [most] = [words for words in placed if words.isdecimal() and words != "0"]
    assert found[said].get("text-anchor") == anchor
    assert placed[said][1] < bottom
    for words, (x, y), right_of, below in (
        ("a1", starts[0], 1, -1),
        ("a2", starts[1], 1, -1),
        ("least distance of any two, m", (0.0, top), 1, -1),
        (most, (left, top), -1, 1),
        ("0", (left, bottom), -1, 1),
        ("60 s", (right, bottom), -1, 1),
        (limit, needed[1], -1, -1),
        (said, near, 1 if anchor == "start" else -1, 1),
    ):
        assert 0 <= (placed[words][0] - x) * right_of <= 14, words
        assert 0 <= (placed[words][1] - y) * below <= 14, words
    [bar] = root.findall(f"{SVG}path")
    assert float(bar.get("d", "").split("v")[0].split()[1]) + 4 < 420 < top, "the map has that"


# -- only those that are near are compared: the findings are those of every two --------------------


def drawn_show(seed: int) -> Show:
    """Up to nine aircraft that begin, turn, hover and end at times of their own, often too near."""
    chance = random.Random(seed)
    is_common = chance.random() < 0.5
    wide, tracks = chance.choice([12.0, 40.0]), []
    for number in range(chance.randint(1, 9)):
        at, points = chance.choice([0.0, 2.5]), []
        for _ in range(chance.randint(2, 12)):
            north, east = chance.uniform(-wide, wide), chance.uniform(-wide, wide)
            points.append(TimedPoint(at, north, east, chance.choice([5.0, 10.0, 15.0])))
            at += 4.0 if is_common else chance.uniform(0.5, 9.0)
        tube = chance.choice([0.5, 1.5])
        tracks.append(TimedTrack(f"a{number}", (22.5, 113.9), tuple(points), tube_m=tube))
    return Show("drawn", tuple(tracks), chance.choice([1.0, 3.0]))


def too_near(show: Show) -> list[tuple[tuple[str, ...], float, float]]:
    """Of every two, by the whole of their tracks."""
    found: list[tuple[tuple[str, ...], float, float]] = []
    for first, second in combinations(show.tracks, 2):
        near = closest(first, second, below=needed_m(show, first, second))
        if near is not None:
            found.append(((first.name, second.name), *near))
    return found


def above(show: Show) -> set[tuple[str, str]]:
    found = set()
    for index in range(241):
        at = show.duration * index / 240
        for first, second in permutations(show.tracks, 2):
            a, b = first.moment(at).place, second.moment(at).place
            if math.dist(a[:2], b[:2]) < show.least_distance_m and a[2] > b[2]:
                found.add((first.name, second.name))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(24))
def test_the_findings_are_those_of_every_two(seed: int) -> None:
    show = drawn_show(seed)
    report = check(show)
    pairs = [one for one in report.problems if " as near as " in one.seen]
    assert [(one.aircraft, one.measured, one.at) for one in pairs] == too_near(show)
    nearest = [closest(*two) for two in combinations(show.tracks, 2)]
    if report.closest is None:
        assert not nearest
    else:
        least = min(distance for distance, _ in filter(None, nearest))
        assert abs(report.closest.distance_m - least) <= 2e-3
    remarked = {tuple(one.split(" at ")[0].split(" is above ")) for one in report.remarks}
    assert above(show) <= remarked
    least_at = [
        min(
            apart(
                first.moment(at).place,
                second.moment(at).place,
                first_ended=at >= first.end,
                second_ended=at >= second.end,
            )
            for first, second in combinations(show.tracks, 2)
        )
        for at, _ in distances(show)
    ]
    assert [distance for _, distance in distances(show)] == least_at


def test_two_hundred_are_compared_with_those_near_them() -> None:
    """A field of 15 by 14: of 19,900 pairs some 800 are looked at."""
    points = [(4.0 * at, math.sin(at), math.cos(at)) for at in range(10)]
    tracks = tuple(
        TimedTrack(
            f"a{number}",
            (22.5, 113.9),
            tuple(
                TimedPoint(at, 8.0 * (number // 15) + north, 8.0 * (number % 15) + east, 10.0)
                for at, north, east in points
            ),
        )
        for number in range(200)
    )
    assert len(Windows(tracks).near(9.0)) < 1200
    points = [(at / 20, math.sin(at), at / 99) for at in range(201)]
    two = [track(name, *((*one, high) for one in points)) for name, high in (("a", 9), ("b", 5))]
    spans = Windows(two).near(5.0)[0, 1]  # of many points: a hundred windows, and what follows
    assert (len(spans), spans[0][0], spans[-1]) == (101, 0.0, (10.0, math.inf))
    assert all(
        a[1] == b[0] == pytest.approx(at / 10)
        for at, (a, b) in enumerate(itertools.pairwise(spans), 1)
    )


# -- tracks of other programs ----------------------------------------------------------------------
# As libskybrush 6 and skybrush-server read and write them: blocks of a type, a length and a body,
# little-endian; a track has its scale, its start in steps of so many mm, and a header, a duration
# in ms and control points for each curve. x is ahead, y to the left, z up.

TRACK = struct.pack("<Bhhhh", 2, 500, -250, 500, 0) + b"".join(
    (
        struct.pack("<BHh", 0b01_0000, 4000, 2500),  # up from 1 m to 5 m
        struct.pack("<BHh", 0b00_0001, 5000, 3000),  # ahead to 6 m
        struct.pack("<BHhhh", 0b00_1000, 10_000, 0, 500, 750),  # a cubic curve to y = 1.5 m
        struct.pack("<BHh", 0b01_0000, 4000, 500),
    )
)


def block(kind: int, body: bytes) -> bytes:
    return struct.pack("<BH", kind, len(body)) + body


def skyb(version: int = 1, track: bytes = TRACK) -> bytes:
    blocks = block(2, b"lights!") + block(1, track) + block(3, b"a comment")
    if version == 1:
        return b"skyb\x01" + blocks
    # CRC-32 of ArduPilot: begins with 0 and is not inverted; over zeros in its place.
    crc = zlib.crc32(b"skyb\x02\x01" + bytes(4) + blocks, 0xFFFFFFFF) ^ 0xFFFFFFFF
    return b"skyb\x02\x01" + struct.pack("<I", crc) + blocks


def at_time(found: dict[str, Any], at: float) -> tuple[float, float, float]:
    [one] = [point for point in found["aircraft"][0]["waypoints"] if point["at"] == at]
    return one["north"], one["east"], one["height"]


@pytest.mark.parametrize("version", [1, 2])
def test_a_track_of_skybrush_is_a_show(tmp_path: Path, version: int) -> None:
    path = tmp_path / "a1.skyb"
    path.write_bytes(skyb(version))
    found = imported([path], (52.0, 4.0))
    [one] = found["aircraft"]
    assert (one["name"], one["ground_m"]) == ("a1", 1.0)
    # It climbs at 1 m/s, which takes 1.67 s and 0.83 m by 0.6 m/s²: so from 1.83 m above that on.
    first, last = one["waypoints"][0], one["waypoints"][-1]
    assert (first["north"], first["east"]) == (1.0, 0.5), "y to the left of north is west"
    assert 2.0 <= first["height"] < 2.0 + 0.25
    assert first["at"] == pytest.approx(2.0 - 1.667, abs=0.001)
    assert (last["at"], last["height"]) == pytest.approx((21.0 + 1.667, first["height"]), abs=0.001)
    assert at_time(found, 9.0) == (6.0, 0.5, 5.0)
    assert at_time(found, 14.0) == (6.0, -0.5, 5.0), "the middle of the curve: y = 0.5 m"
    assert at_time(found, 19.0) == (6.0, -1.5, 5.0)
    assert check(parse(found)).problems[0].seen.startswith("a1 accelerates"), (
        "the corners are sharp"
    )
    turned = imported([path], (52.0, 4.0), orientation_deg=90.0)
    assert at_time(turned, 9.0) == (0.5 - 1.0, 6.0, 5.0), "x to the east, and its left is north"


def test_a_track_in_csv_is_a_show(tmp_path: Path) -> None:
    """As Skybrush Studio exports it: with lights, some times a second."""
    lines = ["Time [msec],x [m],y [m],z [m],Red,Green,Blue"]
    for tick in range(0, 20_001, 100):
        height = 12.0 - 2.0 * math.cos(math.tau * tick / 20_000)
        lines.append(f"{tick},3.5,-2,{height},255,0,0")
    path = tmp_path / "Drone 7.csv"
    path.write_text("\r\n".join(lines), encoding="utf-8-sig")
    found = imported([path], (52.0, 4.0))
    [one] = found["aircraft"]
    assert (one["name"], one["ground_m"]) == ("Drone 7", 10.0)
    times = [point["at"] for point in one["waypoints"]]
    assert 0.0 <= times[0] < 3.34 < 16.66 < times[-1] <= 20.0, "1 m above after a sixth"
    assert min(b - a for a, b in itertools.pairwise(times)) >= 0.2 - 1e-9
    show = parse(found)
    assert show.tracks[0].moment(10.0).place == pytest.approx((3.5, 2.0, 14.0), abs=0.01)
    report = check(show)
    assert report.ok, report.problems
    [remark] = report.remarks  # its first row may have been in the air
    assert remark.startswith("take-off points are 10 to 10 m above the origin: on level ground")


@pytest.mark.parametrize(
    ("data", "seen"),
    [
        (b"", "out of range"),
        (b"x,y,z\n1,2,3\n", "x [m]"),
        (b"time [msec],x [m],y [m],z [m]\n0,0,0,0\n1,0,0,nan\n", "none, or is above"),
        (b"time [msec],x [m],y [m],z [m]\n0,0,0,0\n1000,0,0,1\n", "never high enough"),
        (b"time [msec],x [m],y [m],z [m]\n0,0,0,0\n250,0,0,9\n500,400,0,9", "so fast"),
        (b"time [msec],x [m],y [m],z [m]\n0,0,0\n", "float"),
        (b"time [msec],x [m],y [m],z [m]\n0,0,0,0\n1\r,0,0,1\n", "new-line character"),
        (b"time [msec],x [m],y [m],z [m]\n" + b"9" * 200_000, "field larger than"),
        (skyb()[:40], "no whole track"),
        (skyb(2)[:-1] + b"!", "checksum"),
        (b"skyb\x03" + skyb()[5:], "version 3"),
        (b"skyb\x01" + block(2, b"lights"), "out of range"),
        (skyb(track=b"\0" + TRACK[1:]), "no whole track"),
        (skyb(track=TRACK + struct.pack("<BH", 0, 65_000) * 40), "longer than 2500 s"),
        (skyb(track=TRACK + b"\x03"), "buffer"),
    ],
)
def test_what_is_no_track_is_refused_with_its_reason(
    tmp_path: Path, data: bytes, seen: str
) -> None:
    path = tmp_path / "a1.skyb"
    path.write_bytes(data)
    with pytest.raises(BadShow, match="is no track") as caught:
        imported([path], (52.0, 4.0))
    assert seen in caught.value.seen
    assert ".skyb of Skybrush, or CSV" in caught.value.remedy


def test_what_is_not_there_is_no_track(tmp_path: Path) -> None:
    with pytest.raises(BadShow, match="no track was named"):
        imported([], (52.0, 4.0))
    with pytest.raises(BadShow, match=r"a1\.skyb' cannot be read") as caught:
        imported([tmp_path / "a1.skyb"], (52.0, 4.0))
    assert caught.value.remedy


def test_a_track_that_begins_in_flight_makes_the_others_wait(tmp_path: Path) -> None:
    """3 m/s upwards take 5 s and 7.5 m by 0.6 m/s²: a1 begins so long before its 0.35 s."""
    paths = []
    for name, climbs_m_s in (("a1", 3.0), ("a2", 0.0)):
        lines = ["time [msec],x [m],y [m],z [m]", "100,1,2,0"]
        lines += [f"{350 + 250 * n},1,2,{20 + climbs_m_s * n / 4}" for n in range(40)]
        paths.append(tmp_path / f"{name}.csv")
        paths[-1].write_text("\n".join(lines))
    found = [one["waypoints"] for one in imported(paths, (52.0, 4.0))["aircraft"]]
    first, other = ({point["at"]: point["height"] for point in points} for points in found)
    assert [min(one) for one in (first, other)] == [0.0, 5.0]
    assert [first[at] for at in (0.0, 5.0, 5.25)] == [12.5, 20.0, 20.75]
    assert (other[5.0], len(other)) == (20.0, 40)


@pytest.mark.parametrize("seed", range(20))
def test_a_damaged_track_is_a_show_or_refused(tmp_path: Path, seed: int) -> None:
    draw, path = random.Random(seed), tmp_path / "a1.skyb"
    data = bytearray(skyb())
    for _ in range(draw.randrange(1, 6)):
        data[draw.randrange(5, len(data))] = draw.randrange(256)
    path.write_bytes(data[: draw.randrange(5, len(data) + 1)])
    with suppress(BadShow):
        imported([path], (52.0, 4.0))
