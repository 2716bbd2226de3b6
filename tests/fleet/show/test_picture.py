"""The picture of a show: well-formed, with everybody in it and what the check found."""

from __future__ import annotations

import xml.etree.ElementTree as ET

from m100link.fleet.show.checks import check
from m100link.fleet.show.document import Show
from m100link.fleet.show.picture import svg
from tests.fleet.show.shows import FIVE, show_of, track

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
