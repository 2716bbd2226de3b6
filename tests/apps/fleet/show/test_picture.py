"""The picture of a show: well-formed, with everybody in it and what the check found."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pytest

from m100link.apps.fleet.show.plan.document import Show, check, svg
from tests.apps.fleet.show.shows import FIVE, show_of, track

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


def test_the_nearest_two_are_told_at_their_time() -> None:
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
