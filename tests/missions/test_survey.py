"""Surveys: lines over an area, as the aircraft would fly them."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import pytest

from m100link import AtEnd, BadPlan, GimbalPitch, Heading, TakePhoto, Trace, UsageError
from m100link.geodesy import LocalFrame
from m100link.missions.survey import _apart, line_spacing, orbit, survey

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
    field = area([(0, 0), (3000, 0), (3000, 70), (0, 70)])  # 7 lines of 1500
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


def around(**options: Any) -> Any:
    wanted: dict[str, Any] = {"radius": 40.0, "height": 40.0} | options
    plan = orbit(FRAME.to_geodetic(100.0, 50.0), **wanted)
    places = [FRAME.to_local(one.latitude_deg, one.longitude_deg) for one in plan.waypoints]
    return plan, [(north - 100.0, east - 50.0) for north, east in places]


def test_an_orbit_goes_around_clockwise_and_looks_at_the_ground_of_its_centre() -> None:
    plan, way = around(start=FRAME.to_geodetic(500.0, 50.0))
    assert len(way) == 25
    assert way[0] == pytest.approx((40.0, 0.0), abs=0.01)  # it came from the north
    assert way[6] == pytest.approx((0.0, 40.0), abs=0.01)  # a quarter later it is in the east
    assert way[-1] == pytest.approx(way[0], abs=0.01)
    assert {round(math.hypot(*place), 2) for place in way} == {40.0}
    looks = [one.heading_deg for one in plan.waypoints[::6]]
    assert looks == [180, -90, 0, 90, 180]
    assert {one.gimbal_pitch_deg for one in plan.waypoints} == {-45}
    # Two fifths of the way between neighbours; the first is the one nearest to the aircraft.
    assert plan.waypoints[5].damping == pytest.approx(0.4 * math.tau * 40.0 / 24.0, rel=1e-4)
    aside = around(start=FRAME.to_geodetic(160.0, -30.0))[1][0]
    assert aside == pytest.approx((24.0, -32.0), abs=0.01)
    assert (plan.heading, plan.gimbal_by_waypoint) == (Heading.BY_WAYPOINT, True)
    assert plan.trace is Trace.COORDINATED_TURNS
    assert not any(one.actions for one in plan.waypoints)


def test_an_orbit_with_photographs_stops_for_each() -> None:
    plan, way = around(photo_every=12.0, at_end=AtEnd.LAND, speed=12.0)
    assert len(way) == 21 + 1  # of 251.3 m
    assert {one.actions for one in plan.waypoints} == {(TakePhoto(),)}
    assert (plan.trace, plan.at_end) == (Trace.STOP_AT_POINTS, AtEnd.LAND)
    assert (plan.speed, plan.max_speed) == (12.0, 12.0)


@pytest.mark.parametrize("radius", [5.0, 7.5, 8.0, 30.0, 500.0])
@pytest.mark.parametrize("photo_every", [None, 2.0, 60.0])
def test_an_orbit_is_a_plan_or_is_refused_for_its_count(
    radius: float, photo_every: float | None
) -> None:
    try:
        plan, way = around(radius=radius, photo_every=photo_every)
    except BadPlan as refused:
        if (photo_every, refused.field) == (2.0, "waypoints"):
            return
        raise
    apart = [math.dist(here, there) for here, there in pairwise(way)]
    assert min(apart) >= 2.0
    assert plan.waypoints[0].height == 40.0


@pytest.mark.parametrize(
    "wrong",
    [{"radius": 4.9}, {"radius": math.nan}, {"radius": 501.0}, {"photo_every": 1.9}],
    ids=str,
)
def test_an_orbit_that_cannot_be_flown_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(UsageError):
        around(**wrong)
    with pytest.raises(UsageError, match="place"):
        orbit((math.nan, 4.0), radius=30.0, height=30.0)


@pytest.mark.parametrize(
    ("speed", "fastest"), [(5.0, 10.0), (10.0, 10.0), (12.5, 12.5), (15.0, 15.0)]
)
def test_the_stick_may_speed_it_up_to_10_m_s_and_no_speed_is_above_15(
    speed: float, fastest: float
) -> None:
    here: dict[str, Any] = {"height": 30.0, "speed": speed}
    assert survey(area(), spacing=20.0, **here).max_speed == fastest
    assert orbit((52.1, 4.31), radius=40.0, **here).max_speed == fastest
    for beyond in (15.5, 16.0, 40.0):
        with pytest.raises(BadPlan) as caught:
            survey(area(), spacing=20.0, height=30.0, speed=beyond)
        assert [one.seen for one in caught.value.problems] == [f"speed {beyond:g} is above 15 m/s"]


def test_places_2_m_apart_are_one_and_beyond_that_two() -> None:
    assert _apart([(0.0, 0.0), (2.0, 0.0)]) == [(0.0, 0.0)]
    assert _apart([(0.0, 0.0), (0.0, 2.001), (0.0, 3.0)]) == [(0.0, 0.0), (0.0, 2.001)]
