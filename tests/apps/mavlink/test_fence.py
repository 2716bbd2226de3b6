"""Fences as tables: items in, which places are inside out."""

from __future__ import annotations

import math
from typing import Any

import pytest

from m100link.apps.mavlink.translator.codec import Message
from m100link.apps.mavlink.translator.missions import read_fence
from m100link.apps.mavlink.translator.numbers import MissionResult
from m100link.apps.mavlink.translator.route import Refused
from m100link.geodesy import LocalFrame

FRAME = LocalFrame(47.4, -8.5)
INSIDE, OUTSIDE, CIRCLE_IN, CIRCLE_OUT = 5001, 5002, 5003, 5004
# Higher than wide, with a notch in the east: no two sides are alike.
CORNERS = [(0.0, 0.0), (40.0, 0.0), (40.0, 10.0), (20.0, 4.0), (0.0, 20.0)]


def item(command: int, north: float, east: float, param1: float) -> Message:
    latitude, longitude = FRAME.to_geodetic(north, east)
    place = {"x": round(latitude * 1e7), "y": round(longitude * 1e7)}
    return Message("MISSION_ITEM_INT", {"command": command, "param1": param1} | place)


def polygon(
    command: int = INSIDE, corners: Any = CORNERS, count: float | None = None
) -> list[Message]:
    many = float(len(corners)) if count is None else count
    return [item(command, north, east, many) for north, east in corners]


def is_free(items: list[Message], north: float, east: float, radius: float = 0.0) -> bool:
    return not read_fence(items).refusal(*FRAME.to_geodetic(north, east), radius)


PLACES = [
    (1.0, 1.0, True),
    (39.0, 1.0, True),
    (39.0, 9.0, True),
    (1.0, 18.0, True),
    (20.0, 3.5, True),
    (20.0, 4.5, False),
    (25.0, 8.0, False),
    (10.0, 13.0, False),
    (10.0, 11.0, True),
    (-0.5, 1.0, False),
    (40.5, 5.0, False),
    (20.0, -0.5, False),
    (0.5, 20.5, False),
]


@pytest.mark.parametrize(("north", "east", "is_in"), PLACES)
@pytest.mark.parametrize("turned", [False, True])
def test_a_polygon_is_what_its_corners_are_around(
    north: float, east: float, is_in: bool, turned: bool
) -> None:
    corners = CORNERS[::-1] if turned else CORNERS
    assert is_free(polygon(corners=corners), north, east) is is_in
    assert is_free(polygon(OUTSIDE, corners), north, east) is not is_in


@pytest.mark.parametrize(
    ("north", "east", "is_in"),
    [
        (5.0, 7.0, True),
        (14.9, 7.0, True),
        (15.1, 7.0, False),
        (5.0, -2.9, True),
        (5.0, -3.1, False),
    ],
)
def test_a_circle_has_its_radius_in_metres(north: float, east: float, is_in: bool) -> None:
    assert is_free([item(CIRCLE_IN, 5.0, 7.0, 10.0)], north, east) is is_in
    assert is_free([item(CIRCLE_OUT, 5.0, 7.0, 10.0)], north, east) is not is_in


def test_areas_to_stay_in_are_one_and_each_to_stay_out_of_counts() -> None:
    two = [item(CIRCLE_IN, 0.0, 0.0, 10.0), item(CIRCLE_IN, 30.0, 0.0, 10.0)]
    assert is_free(two, 0.0, 0.0)
    assert is_free(two, 30.0, 0.0)
    assert not is_free(two, 15.0, 0.0)
    three = [*two, item(CIRCLE_OUT, 30.0, 5.0, 3.0), item(CIRCLE_OUT, 0.0, 5.0, 3.0)]
    assert not is_free(three, 30.0, 5.0)
    assert not is_free(three, 0.0, 5.0)
    assert is_free(three, 30.0, 0.0)
    assert is_free([], 1000.0, 1000.0)
    assert is_free([item(CIRCLE_IN, 0.0, 0.0, 0.0)], 1000.0, 1000.0), "a radius of 0 is none"


@pytest.mark.parametrize(("radius", "is_in"), [(0.0, True), (2.0, True), (4.0, False)])
def test_what_is_flown_around_a_place_counts(radius: float, is_in: bool) -> None:
    for north, east in ((7.0, 0.0), (-7.0, 0.0), (0.0, 7.0), (0.0, -7.0)):
        assert is_free([item(CIRCLE_IN, 0.0, 0.0, 10.0)], north, east, radius) is is_in


@pytest.mark.parametrize(
    ("items", "result"),
    [
        (polygon()[:4], MissionResult.INVALID),
        ([*polygon()[:4], polygon(OUTSIDE)[4]], MissionResult.INVALID),
        ([*polygon()[:4], polygon(count=4.0)[4]], MissionResult.INVALID),
        ([polygon(count=6.0)[0], *polygon()[1:]], MissionResult.INVALID),
        ([*polygon()[:2], item(CIRCLE_IN, 0.0, 0.0, 5.0)], MissionResult.UNSUPPORTED),
        (polygon(corners=CORNERS[:2]), MissionResult.INVALID),
        (polygon(count=4.5), MissionResult.INVALID),
        (polygon(count=1001.0), MissionResult.INVALID),
        (polygon(count=-5.0), MissionResult.INVALID),
        (polygon(count=math.nan), MissionResult.INVALID),
        (polygon(count=math.inf), MissionResult.INVALID),
        ([item(CIRCLE_IN, 0.0, 0.0, -1.0)], MissionResult.INVALID),
        ([item(CIRCLE_IN, 0.0, 0.0, math.nan)], MissionResult.INVALID),
        ([item(CIRCLE_OUT, 0.0, 0.0, math.inf)], MissionResult.INVALID),
        ([item(5100, 0.0, 0.0, 1.0)], MissionResult.UNSUPPORTED),
        ([item(16, 0.0, 0.0, 1.0)], MissionResult.UNSUPPORTED),
    ],
)
def test_a_fence_that_contradicts_itself_is_refused(
    items: list[Message], result: MissionResult
) -> None:
    with pytest.raises(Refused) as caught:
        read_fence(items)
    assert caught.value.result is result


def test_two_polygons_follow_each_other() -> None:
    far = [(100.0, 0.0), (110.0, 0.0), (110.0, 10.0)]
    both = [*polygon(), *polygon(corners=far)]
    assert is_free(both, 1.0, 1.0)
    assert is_free(both, 108.0, 2.0)
    assert not is_free(both, 60.0, 2.0)


@pytest.mark.parametrize("x", [910_000_000, -2_000_000_000])
def test_a_place_that_is_none_is_refused(x: int) -> None:
    fields = {"command": CIRCLE_IN, "param1": 5.0, "x": x, "y": 0}
    with pytest.raises(Refused):
        read_fence([Message("MISSION_ITEM_INT", fields)])


@pytest.mark.parametrize(
    ("items", "north", "east", "depth"),
    [
        (polygon(), 1.0, 1.0, 0.0),
        (polygon(), -3.0, 1.0, 3.0),
        (polygon(), -3.0, -4.0, 5.0),  # off a corner
        (polygon(), 44.0, 13.0, 5.0),
        (polygon(OUTSIDE), 30.0, 2.0, 2.0),
        (polygon(OUTSIDE), -3.0, 1.0, 0.0),
        ([item(CIRCLE_IN, 10.0, 0.0, 5.0)], 10.0, 12.0, 7.0),
        ([item(CIRCLE_OUT, 10.0, 0.0, 5.0)], 10.0, 2.0, 3.0),
        ([item(CIRCLE_OUT, 10.0, 0.0, 5.0), item(CIRCLE_OUT, 12.0, 0.0, 5.0)], 11.0, 0.0, 4.0),
        ([item(CIRCLE_IN, 0.0, 0.0, 5.0), item(CIRCLE_IN, 20.0, 0.0, 5.0)], 12.0, 0.0, 3.0),
        ([], 0.0, 0.0, 0.0),
    ],
)
def test_how_deep_a_place_lies(
    items: list[Message], north: float, east: float, depth: float
) -> None:
    found = read_fence(items).depth_m(*FRAME.to_geodetic(north, east))
    assert found == pytest.approx(depth, abs=0.05)  # places have seven digits


@pytest.mark.parametrize(
    ("items", "begin", "end", "is_free"),
    [
        (polygon(OUTSIDE), (-5.0, 5.0), (-5.0, 40.0), True),
        (polygon(OUTSIDE), (-5.0, 5.0), (50.0, 5.0), False),  # both ends are allowed
        (polygon(OUTSIDE), (20.0, 20.0), (20.0, 5.0), True),  # into the notch
        (polygon(OUTSIDE), (20.0, 20.0), (20.0, 3.0), False),
        (polygon(OUTSIDE), (20.0, 20.0), (30.0, 5.0), False),
        ([item(CIRCLE_OUT, 0.0, 0.0, 5.0)], (-20.0, 5.5), (20.0, 5.5), True),
        ([item(CIRCLE_OUT, 0.0, 0.0, 5.0)], (-20.0, 4.5), (20.0, 4.5), False),
        ([item(CIRCLE_OUT, 0.0, 0.0, 5.0)], (-20.0, 4.5), (-6.0, 4.5), True),  # ends before it
        ([item(CIRCLE_IN, 0.0, 0.0, 5.0)], (0.0, 0.0), (4.0, 0.0), True),
        ([item(CIRCLE_IN, 0.0, 0.0, 5.0)], (0.0, 0.0), (6.0, 0.0), False),
        ([], (0.0, 0.0), (6.0, 0.0), True),
    ],
)
def test_what_lies_on_a_straight_way(
    items: list[Message], begin: tuple[float, float], end: tuple[float, float], is_free: bool
) -> None:
    places = FRAME.to_geodetic(*begin), FRAME.to_geodetic(*end)
    assert (not read_fence(items).on_the_way(*places)) is is_free
