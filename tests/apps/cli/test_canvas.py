"""Pictures of braille characters."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from m100link.apps.cli.display import line_plot, track_plot


def dots(lines: list[str], columns: int) -> set[tuple[int, int]]:
    """The dots that are set, from the top left, by the Unicode standard's numbering."""
    places = [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2), (0, 3), (1, 3)]
    return {
        (2 * x + dx, 4 * y + dy)
        for y, line in enumerate(lines)
        for x, character in enumerate(line[-columns:])
        for bit, (dx, dy) in enumerate(places)
        if ord(character) - 0x2800 & 1 << bit
    }


def test_a_track_has_north_at_the_top_and_east_at_the_right() -> None:
    *picture, caption = track_plot([(0.0, 0.0), (10.0, 0.0)], columns=10, rows=5)
    north = dots(picture, 10)
    assert len({x for x, _ in north}) == 1
    assert len({y for _, y in north}) >= 17
    assert caption == "north up; 10.0 m north to south, 1.0 m east to west"
    *picture, caption = track_plot([(0.0, 0.0), (0.0, 10.0)], columns=10, rows=5)
    east = dots(picture, 10)
    assert len({y for _, y in east}) == 1
    assert caption == "north up; 1.0 m north to south, 10.0 m east to west"


def test_both_axes_of_a_track_have_one_scale() -> None:
    square = [(0.0, 0.0), (8.0, 0.0), (8.0, 8.0), (0.0, 8.0), (0.0, 0.0)]
    drawn = dots(track_plot(square, columns=40, rows=10)[:-1], 40)
    width = max(x for x, _ in drawn) - min(x for x, _ in drawn)
    height = max(y for _, y in drawn) - min(y for _, y in drawn)
    assert width == pytest.approx(height, abs=1)


def test_a_value_over_time_rises_to_the_right_and_is_labelled() -> None:
    *picture, scale = line_plot([(5.0, 1.0), (7.0, 3.0)], unit="m", columns=10, rows=4)
    drawn = dots(picture, 10)
    assert (0, 15) in drawn
    assert (19, 0) in drawn
    assert picture[0].startswith("3.00 ┤")
    assert picture[-1].startswith("1.00 ┤")
    assert scale.split() == ["m", "0", "2.0", "s"]


@pytest.mark.parametrize("plot", [track_plot, line_plot])
def test_nothing_and_one_point_are_pictures_too(plot: Callable[..., list[str]]) -> None:
    assert dots(plot([], columns=5, rows=3), 5) == set()
    assert plot([(1.0, 1.0)], columns=5, rows=3)


def test_names_stand_where_there_is_room_for_them() -> None:
    row = [(0.0, 0.0), (0.0, 1.0), (0.0, 100.0)]
    *picture, _ = track_plot(row, columns=12, rows=3, names=["0", "1", "12"])
    [line] = [line for line in picture if "0" in line]
    assert line.strip("\u2800")[0] == "0"
    assert line.strip("\u2800")[-2:] == "12"
    assert "1" not in line[:-3]
