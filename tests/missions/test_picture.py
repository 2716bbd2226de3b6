"""Plans as pictures."""

from __future__ import annotations

import xml.etree.ElementTree as ET

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


def test_many_points_have_the_first_and_the_last_number_only() -> None:
    plan = WaypointPlan([at(5.0 * index, 0) for index in range(40)])
    assert {words for words in texts(drawn(plan)) if words.isdecimal()} == {"0", "39"}


@given(plans())
@settings(max_examples=20)
def test_every_plan_is_a_picture_inside_its_frame(plan: WaypointPlan) -> None:
    picture = drawn(plan)
    assert all(0 <= x <= 480 and 0 <= y <= 410 for x, y in circles(picture))
    assert ("corners are rounded" in texts(picture)) == (plan.trace is Trace.COORDINATED_TURNS)
