"""The drawing of a track, read as a program reads it."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET

import pytest

from m100link.geodesy import LocalFrame
from m100link.telemetry.columns import round_length, track_svg

SVG = "{http://www.w3.org/2000/svg}"
HOME = LocalFrame(22.5, 113.9)


def drawn(*track: tuple[float, float]) -> tuple[ET.Element, list[tuple[float, float]]]:
    """The drawing of metres north and east, and the points of its line."""
    root = ET.fromstring(track_svg(HOME.to_geodetic(*place) for place in track))
    line = root.find(f"{SVG}polyline")
    assert line is not None
    points = [point.split(",") for point in line.attrib["points"].split()]
    return root, [(float(x), float(y)) for x, y in points]


def test_north_is_up_and_both_axes_have_one_scale() -> None:
    root, points = drawn((0.0, 0.0), (10.0, 0.0), (10.0, 5.0))
    (x0, y0), (x1, y1), (x2, y2), last = points
    assert last == (x2, y2)
    assert x1 == pytest.approx(x0, abs=0.2)
    assert y0 - y1 == pytest.approx(300, abs=0.2)
    assert x2 - x1 == pytest.approx(150, abs=1.5)
    assert y2 == pytest.approx(y1, abs=0.2)
    text = root.find(f"{SVG}text")
    assert text is not None
    assert text.text == "5 m, north up"
    begin, end = root.findall(f"{SVG}circle")
    assert (float(begin.attrib["cx"]), float(begin.attrib["cy"])) == (x0, y0)
    assert (float(end.attrib["cx"]), float(end.attrib["cy"])) == (x2, y2)
    for x, y in points:
        assert 0 < x < float(root.attrib["width"])
        assert 0 < y < float(root.attrib["height"])


def test_what_stands_still_is_not_blown_up_to_its_noise() -> None:
    _, points = drawn((0.0, 0.0), (0.01, 0.0), (0.0, 0.01))
    assert max(y for _, y in points) - min(y for _, y in points) < 5.0


def test_a_long_track_is_thinned_and_keeps_its_end() -> None:
    _, points = drawn(*((float(n), math.sin(n / 50)) for n in range(20_000)))
    assert 300 <= len(points) <= 610
    assert points[-1][1] == min(y for _, y in points)


def test_places_that_are_not_known_are_passed_over() -> None:
    assert track_svg([]) == ""
    assert track_svg([(math.nan, 113.9)]) == ""
    assert track_svg([(22.5, 113.9)]).count("<circle") == 2


@pytest.mark.parametrize(
    ("most", "length"), [(0.5, 0.5), (0.99, 0.5), (4.2, 2), (73, 50), (100, 100)]
)
def test_lengths_are_round(most: float, length: float) -> None:
    assert round_length(most) == pytest.approx(length)


def test_the_antimeridian_is_no_way_around_the_earth() -> None:
    svg = track_svg([(10.0, 179.9999), (10.0, -179.9999)])
    assert "10 m, north up" in svg
