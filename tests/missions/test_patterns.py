from __future__ import annotations

import doctest
import math
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from m100link import UsageError
from m100link.missions import patterns
from m100link.missions.patterns import length_m, survey

FIELD = [(0.0, 0.0), (0.0, 40.0), (30.0, 40.0), (30.0, 0.0)]


def test_what_the_docstrings_show_is_so() -> None:
    assert doctest.testmod(patterns).failed == 0


@given(
    sides=st.tuples(st.floats(1, 200), st.floats(1, 200)),
    spacing=st.floats(0.5, 50),
    angle=st.floats(-360, 360),
    place=st.tuples(st.floats(-100, 100), st.floats(-100, 100)),
)
def test_no_place_of_a_field_is_farther_from_a_line_than_half_the_spacing(
    sides: tuple[float, float], spacing: float, angle: float, place: tuple[float, float]
) -> None:
    (north, east), (n0, e0) = sides, place
    field = [(n0, e0), (n0, e0 + east), (n0 + north, e0 + east), (n0 + north, e0)]
    points = survey(field, spacing=spacing, height=10, angle_deg=angle, start=place)
    cosine, sine = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    across = sorted({round(e * cosine - n * sine, 6) for n, e, _ in points})
    edges = [e * cosine - n * sine for n, e in field]
    assert across[0] - min(edges) <= spacing / 2 + 1e-5
    assert max(edges) - across[-1] <= spacing / 2 + 1e-5
    assert all(b - a <= spacing + 1e-5 for a, b in pairwise(across))
    for n, e, height in points:
        assert n0 - 1e-6 <= n <= n0 + north + 1e-6
        assert e0 - 1e-6 <= e <= e0 + east + 1e-6
        assert height == 10


def test_it_begins_at_the_end_nearest_to_the_aircraft() -> None:
    for corner in FIELD:
        first = survey(FIELD, spacing=10, height=5, start=corner)[0]
        assert math.dist(first[:2], corner) == pytest.approx(5.0)


def test_lines_go_to_and_fro() -> None:
    points = survey(FIELD, spacing=10, height=5)
    assert [n for n, _, _ in points] == [0, 30, 30, 0, 0, 30, 30, 0]
    assert length_m(points) == pytest.approx(4 * 30 + 3 * 10)


def test_a_concave_field_has_lines_in_several_parts() -> None:
    u = [(0, 0), (0, 30), (30, 30), (30, 20), (10, 20), (10, 10), (30, 10), (30, 0)]
    points = survey(u, spacing=5, height=5, angle_deg=90)
    across = [round(n, 3) for n, _, _ in points]
    assert across.count(17.5) == 4  # two parts
    assert across.count(2.5) == 2


def test_a_line_through_corners_enters_and_leaves_there_once() -> None:
    """A rhombus whose middle corners lie on its middle line, which is 60 m long."""
    rhombus = [(0.0, 20.0), (30.0, 0.0), (60.0, 20.0), (30.0, 40.0)]
    points = survey(rhombus, spacing=40.0, height=5)
    assert sorted(points) == [(0.0, 20.0, 5), (60.0, 20.0, 5)]
    # A notch whose tip lies on the line, from either side: the line goes straight on.
    for tip, wall in ((20.0, 40.0), (20.0, 0.0)):
        notched = [(0.0, 40.0 - wall), (60.0, 40.0 - wall), (60.0, wall), (30.0, tip), (0.0, wall)]
        ends = survey(notched, spacing=40.0, height=5)
        assert (min(ends), max(ends)) == ((0.0, 20.0, 5), (60.0, 20.0, 5))
        assert len(ends) % 2 == 0


@pytest.mark.parametrize(
    ("polygon", "options", "words"),
    [
        ([], {}, "0 corners"),
        (FIELD, {"angle_deg": math.nan}, "direction nan"),
        (FIELD, {"angle_deg": math.inf}, "direction inf"),
        ([(0, 0), (1, 1)], {}, "2 corners"),
        ([(0, 0), (1, 1), (2, math.nan)], {}, "finite"),
        (FIELD, {"height": math.inf}, "finite"),
        (FIELD, {"spacing": 0.0}, "0 m apart"),
        (FIELD, {"spacing": math.nan}, "apart"),
        (FIELD, {"spacing": 0.001}, "no survey"),
        ([(0, 0), (1, 0), (2, 0)], {}, "no survey"),
    ],
)
def test_what_makes_no_survey_is_refused(
    polygon: list[tuple[float, float]], options: dict[str, Any], words: str
) -> None:
    with pytest.raises(UsageError, match=words):
        survey(polygon, **{"spacing": 5.0, "height": 5.0, **options})
