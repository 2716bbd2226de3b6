"""Surveys: lines over an area, as the aircraft would fly them."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import pytest

from m100link import AtEnd, BadPlan, GimbalPitch, TakePhoto, UsageError
from m100link.geodesy import LocalFrame
from m100link.missions.survey import line_spacing, survey

FRAME = LocalFrame(52.1, 4.31)
FIELD = [(0.0, 0.0), (60.0, 0.0), (60.0, 40.0), (0.0, 40.0)]


def area(corners: list[tuple[float, float]] | None = None) -> list[tuple[float, float]]:
    return [FRAME.to_geodetic(*corner) for corner in corners or FIELD]


def flown(**options: Any) -> list[tuple[float, float]]:
    wanted: dict[str, Any] = {"height": 30.0, "spacing": 10.0} | options
    plan = survey(area(), **wanted)
    return [FRAME.to_local(one.latitude_deg, one.longitude_deg) for one in plan.waypoints]


def test_lines_lie_in_the_area_and_apart() -> None:
    way = flown()
    assert len(way) == 8
    assert sorted({round(east) for _, east in way}) == [5, 15, 25, 35]
    assert all(-1e-3 < north < 60.001 for north, _ in way)
    lines = list(zip(way[::2], way[1::2], strict=True))
    assert all(math.dist(*line) == pytest.approx(60.0, abs=0.01) for line in lines)
    # To and fro: from the end of a line to the next it is one spacing.
    assert all(
        math.dist(one[1], other[0]) == pytest.approx(10.0, abs=0.01)
        for one, other in pairwise(lines)
    )


def test_lines_turn_with_the_angle() -> None:
    way = flown(angle_deg=90.0)
    assert sorted({round(north) for north, _ in way}) == [5, 15, 25, 35, 45, 55]


@pytest.mark.parametrize("corner", FIELD)
def test_it_begins_near_the_start(corner: tuple[float, float]) -> None:
    first = flown(start=FRAME.to_geodetic(*corner))[0]
    assert math.dist(first, corner) < 6.0


def test_photographs_are_waypoints_with_the_camera_down() -> None:
    plan = survey(area(), height=30, spacing=20, photo_every=12, at_end=AtEnd.GO_HOME)
    assert len(plan.waypoints) == 2 * 6
    assert plan.waypoints[0].actions == (GimbalPitch(-90.0), TakePhoto())
    assert all(one.actions == (TakePhoto(),) for one in plan.waypoints[1:])
    assert plan.at_end is AtEnd.GO_HOME
    assert {one.height for one in plan.waypoints} == {30.0}


@pytest.mark.parametrize(
    ("every", "apart"),
    [(2.0, 60 / 29), (2.01, 60 / 29), (2.05, 60 / 29), (2.5, 2.5), (2.9, 60 / 21)],
)
def test_photographs_are_as_near_as_the_aircraft_takes_waypoints(
    every: float, apart: float
) -> None:
    """A line of 60 m: at 2 m, every other photograph was missing."""
    plan = survey(area(), height=30, spacing=40, photo_every=every)
    way = [FRAME.to_local(one.latitude_deg, one.longitude_deg) for one in plan.waypoints]
    found = [math.dist(*pair) for pair in pairwise(way)]
    assert len(way) == round(60 / apart) + 1
    assert (min(found), max(found)) == pytest.approx((apart, apart), abs=1e-4)


@pytest.mark.parametrize(("length", "parts"), [(5.0, 2), (4.1, 2), (3.9, 1), (2.5, 1)])
def test_a_short_line_has_a_photograph_at_each_end(length: float, parts: int) -> None:
    field = area([(0, 0), (length, 0), (length, 5), (0, 5)])
    plan = survey(field, height=30, spacing=5, photo_every=2.0)
    way = [FRAME.to_local(one.latitude_deg, one.longitude_deg) for one in plan.waypoints]
    assert len(way) == parts + 1
    assert math.dist(way[0], way[-1]) == pytest.approx(length, abs=1e-3)


def test_photographs_of_a_mistake_in_the_units_are_counted_not_made() -> None:
    field = area([(0, 0), (3000, 0), (3000, 100), (0, 100)])
    with pytest.raises(UsageError, match="every 2 m are more than 10000"):
        survey(field, height=30, spacing=10, photo_every=2.0)


def test_the_tip_of_a_triangle_has_no_points_too_near_to_each_other() -> None:
    plan = survey(area([(0, 0), (50, 0), (25, 40)]), height=20, spacing=3.9)
    places = [FRAME.to_local(one.latitude_deg, one.longitude_deg) for one in plan.waypoints]
    assert min(math.dist(*pair) for pair in pairwise(places)) >= 2.0


def test_the_spacing_is_what_the_overlap_leaves_of_a_photograph() -> None:
    assert line_spacing(10.0, 0.0, 90.0) == pytest.approx(20.0)
    assert line_spacing(10.0, 0.75, 90.0) == pytest.approx(5.0)
    assert line_spacing(10.0, 0.0, 60.0) == pytest.approx(20 / math.sqrt(3))
    assert line_spacing(20.0, 0.5, 120.0) == pytest.approx(20 * math.sqrt(3))


@pytest.mark.parametrize(
    ("height", "overlap", "angle"), [(0, 0.5, 80), (10, 1.0, 80), (10, -0.1, 80), (10, 0.5, 180)]
)
def test_a_spacing_of_nonsense_is_refused(height: float, overlap: float, angle: float) -> None:
    with pytest.raises(UsageError, match="make no survey"):
        line_spacing(height, overlap, angle)


@pytest.mark.parametrize(
    ("corners", "options"),
    [
        (area()[:2], {}),
        ([(95.0, 0.0), (0.0, 1.0), (1.0, 1.0)], {}),
        ([(math.nan, 0.0), (0.0, 1.0), (1.0, 1.0)], {}),
        (area(), {"spacing": 0.0}),
        (area(), {"spacing": math.nan}),
        (area(), {"photo_every": 1.0}),
        (area(), {"photo_every": math.nan}),
        (area(), {"height": math.inf}),
        (area([(0, 0), (0, 0), (0, 0)]), {}),
    ],
)
def test_what_is_not_a_survey_is_refused(
    corners: list[tuple[float, float]], options: dict[str, Any]
) -> None:
    wanted: dict[str, Any] = {"height": 30.0, "spacing": 10.0} | options
    with pytest.raises(UsageError):
        survey(corners, **wanted)


def test_what_the_aircraft_would_refuse_is_reported_as_of_every_plan() -> None:
    with pytest.raises(BadPlan, match="99"):
        survey(area(), height=30, spacing=2.5, photo_every=5)
    with pytest.raises(BadPlan, match="height"):
        survey(area(), height=900, spacing=10)
    with pytest.raises(BadPlan, match="speed"):
        survey(area(), height=30, spacing=10, speed=20)
