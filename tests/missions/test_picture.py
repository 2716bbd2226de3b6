"""Plans as pictures."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pytest
from hypothesis import given, settings

from m100link import TakePhoto, Trace, Waypoint, WaypointPlan
from m100link.geodesy import destination
from tests.missions.plans import plans

SVG = "{http://www.w3.org/2000/svg}"


def at(north: float, east: float, height: float = 20.0, photo: bool = False) -> Waypoint:
    actions = [TakePhoto()] if photo else []
    return Waypoint(*destination(52.1, 4.31, north, east), height, actions=actions)


def drawn(plan: WaypointPlan) -> ET.Element:
    return ET.fromstring(plan._repr_svg_())


def circles(picture: ET.Element) -> list[tuple[float, float]]:
    found = picture.iter(f"{SVG}circle")
    return [(float(one.get("cx", "")), float(one.get("cy", ""))) for one in found]


def texts(picture: ET.Element) -> list[str]:
    return [one.text or "" for one in picture.iter(f"{SVG}text")]


def test_north_is_up_and_scales_are_equal() -> None:
    picture = drawn(WaypointPlan([at(0, 0), at(100, 0, photo=True), at(100, 50, 25)]))
    first, second, third = circles(picture)
    assert second[0] - first[0] < 0.5
    up, right = first[1] - second[1], third[0] - second[0]
    assert up > 100
    assert abs(up - 2 * right) < 1
    assert [one.get("fill") for one in picture.iter(f"{SVG}circle")] == [
        *("none", "currentColor", "none"),
    ]
    assert [words for words in texts(picture) if words in "012"] == ["0", "1", "2"]
    assert {"20 m", "25 m", "150 m", "N ↑"} <= set(texts(picture))


def test_heights_stand_over_the_way_and_the_greatest_is_at_the_top() -> None:
    picture = drawn(WaypointPlan([at(0, 0, 10), at(100, 0, 30), at(300, 0, 20)]))
    _, profile = [one.get("points", "") for one in picture.iter(f"{SVG}polyline")]
    spots = [tuple(map(float, spot.split(","))) for spot in profile.split()]
    legs = (100.0**2 + 20**2) ** 0.5, (200.0**2 + 10**2) ** 0.5
    first = 44 + 428 * legs[0] / sum(legs)
    assert [x for x, _ in spots] == pytest.approx([44, first, 472], abs=0.2)
    assert [y for _, y in spots] == pytest.approx([392, 336, 364], abs=0.2)
    at_places = {one.text: float(one.get("y", "")) for one in picture.iter(f"{SVG}text")}
    assert at_places["30 m"] < at_places["10 m"]
    assert f"{sum(legs):.0f} m" in at_places
    assert picture.get("viewBox") == "0 0 480 410"
    titles = [one.text for one in picture.iter(f"{SVG}title")]
    assert titles[-3:] == ["0: 10 m", "1: 30 m", "2: 20 m"]
    level = drawn(WaypointPlan([at(0, 0, 25), at(100, 0, 25)]))
    assert texts(level).count("25 m") == 1


@pytest.mark.parametrize(("count", "named"), [(30, 30), (31, 2)])
def test_thirty_points_have_room_for_their_numbers(count: int, named: int) -> None:
    plan = WaypointPlan([at(5.0 * index, 0) for index in range(count)])
    assert len([words for words in texts(drawn(plan)) if words.isdecimal()]) == named


def test_many_points_have_the_first_and_the_last_number_only() -> None:
    plan = WaypointPlan([at(5.0 * index, 0) for index in range(40)])
    assert {words for words in texts(drawn(plan)) if words.isdecimal()} == {"0", "39"}


@given(plans())
@settings(max_examples=20)
def test_every_plan_is_a_picture_inside_its_frame(plan: WaypointPlan) -> None:
    picture = drawn(plan)
    assert all(0 <= x <= 480 and 0 <= y <= 410 for x, y in circles(picture))
    assert ("corners are rounded" in texts(picture)) == (plan.trace is Trace.COORDINATED_TURNS)
