"""The geometry of a path, flown by a point whose velocity lags behind what it is told."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import pytest

from m100link import UsageError
from m100link.flight.path import Path

Point = tuple[float, float, float]

SQUARE: list[Point] = [(0, 0, 5), (20, 0, 5), (20, 20, 8), (0, 20, 5), (0, 0, 5)]
LAWN: list[Point] = [(0 if (i + j) % 2 else 40, 5 * i, 5) for i in range(6) for j in (1, 0)]


@dataclass
class Flown:
    seconds: float
    off_m: float
    fastest: float
    miss_m: float
    heights: list[float]
    places: list[Point]


def fly(
    points: list[Point], *, speed: float, radius: float, lag: float = 0.65, max_speed: float = 10.0
) -> Flown:
    path = Path(points, speed=speed, corner_radius=radius, max_speed=max_speed)
    (north, east), vn, ve, step = points[0][:2], 0.0, 0.0, 0.02
    height, places = points[0][2], []
    off, fastest, heights = 0.0, 0.0, []
    for tick in range(30_000):
        steering = path.steer((north, east, height), (vn, ve), step)
        asked = math.hypot(steering.north, steering.east)
        assert asked <= max_speed + 1e-6
        off = max(off, steering.off_m)
        heights.append(steering.height)
        height += max(-3.0, min(3.0, 1.5 * (steering.height - height))) * step
        places.append((north, east, height))
        vn += (steering.north - vn) * step / lag
        ve += (steering.east - ve) * step / lag
        north, east = north + vn * step, east + ve * step
        fastest = max(fastest, math.hypot(vn, ve))
        is_high = abs(height - points[-1][2]) < 0.5
        if is_high and abs(steering.to_go_m) < 0.3 and math.hypot(vn, ve) < 0.2:
            miss = math.dist((north, east), points[-1][:2])
            return Flown(tick * step, off, fastest, miss, heights, places)
    raise AssertionError("it did not arrive")


@pytest.mark.parametrize("speed", [1.0, 3.0, 5.0, 8.0])
@pytest.mark.parametrize("radius", [0.0, 1.0, 3.0, 5.0, 8.0])
@pytest.mark.parametrize("points", [SQUARE, LAWN], ids=["square", "lawn"])
def test_it_keeps_to_the_path_and_ends_at_its_end(
    points: list[Point], radius: float, speed: float
) -> None:
    flown = fly(points, speed=speed, radius=radius)
    assert flown.off_m < 0.9
    assert flown.fastest < speed + 0.1
    assert flown.miss_m < 0.3


@pytest.mark.parametrize("lag", [0.4, 0.65, 1.0])
def test_another_lag_than_the_models_is_no_reason_to_leave_it(lag: float) -> None:
    assert fly(SQUARE, speed=3.0, radius=3.0, lag=lag).off_m < 1.0


def test_rounded_corners_are_faster_than_corners() -> None:
    assert fly(SQUARE, speed=4.0, radius=5.0).seconds < fly(SQUARE, speed=4.0, radius=0.0).seconds


def test_a_leg_back_the_way_it_came_is_turned_on_the_spot() -> None:
    flown = fly([(0, 0, 5), (10, 0, 5), (0, 0, 5)], speed=3.0, radius=2.0)
    assert flown.off_m < 0.01
    assert flown.miss_m < 0.3


def test_heights_are_reached_along_the_way_and_steep_legs_flown_slowly() -> None:
    steep = fly([(0, 0, 2), (10, 0, 32)], speed=5.0, radius=2.0)
    assert steep.seconds > 14
    assert (
        max(
            later - earlier
            for earlier, later in zip(steep.heights, steep.heights[1:], strict=False)
        )
        < 2.5 * 0.02
    )
    assert steep.heights[-1] == pytest.approx(32, abs=0.5)


@pytest.mark.parametrize("radius", [0.0, 2.0])
@pytest.mark.parametrize(
    "points",
    [
        [(0, 0, 5), (0, 0, 30), (40, 0, 30)],
        [(0, 0, 30), (40, 0, 30), (40, 0, 5), (80, 0, 5)],
        [(0, 0, 5), (40, 0, 5), (40, 0, 30), (40, 40, 30)],
        [(0, 0, 5), (40, 0, 5), (40, 0, 25)],
    ],
    ids=["first", "between", "at a corner", "last"],
)
def test_straight_up_and_down_is_flown_in_place(points: list[Point], radius: float) -> None:
    flown = fly(points, speed=6.0, radius=radius)
    legs = list(pairwise(points))
    assert max(min(_away(place, *leg) for leg in legs) for place in flown.places) < 1.0


def _away(place: Point, start: Point, end: Point) -> float:
    """Metres from a leg."""
    along = [e - s for s, e in zip(start, end, strict=True)]
    share = sum(a * (p - s) for a, s, p in zip(along, start, place, strict=True))
    share = max(0.0, min(1.0, share / sum(a * a for a in along)))
    return math.dist(place, [s + share * a for s, a in zip(start, along, strict=True)])


def test_it_waits_for_a_height_that_it_does_not_have() -> None:
    path = Path([(0, 0, 20), (40, 0, 20)], speed=5.0, corner_radius=0, max_speed=10)
    assert path.steer((10, 0, 15), (0, 0), 1.0).north == pytest.approx(0)
    assert path.steer((10, 0, 19.5), (0, 0), 1.0).north > 0


def test_length_counts_the_rounded_corners() -> None:
    assert Path(SQUARE, speed=1, corner_radius=0, max_speed=10).length == pytest.approx(80)
    rounded = Path(SQUARE, speed=1, corner_radius=4, max_speed=10).length
    assert rounded == pytest.approx(80 - 3 * (8 - math.pi * 2))


def test_points_above_each_other_and_twice_the_same_are_one() -> None:
    path = Path(
        [(0, 0, 2), (0, 0, 5), (10, 0, 5), (10, 0, 5), (10, 10, 5)],
        speed=2,
        corner_radius=0,
        max_speed=10,
    )
    assert path.length == pytest.approx(20)
    assert path.steer((0, 0, 5), None, 0.02).height == pytest.approx(5)


@pytest.mark.parametrize(
    ("points", "options", "words"),
    [
        ([(0, 0, 5), (1, 0, math.nan)], {}, "point 1"),
        ([(0, 0, 5), (1, 0, -1)], {}, "point 1"),
        ([(0, 0, 5), (1, 0)], {}, "point 1"),
        ([(0, 0, 5), (0, 0, 9)], {}, "all one place"),
        (SQUARE, {"speed": 0.0}, "0 m/s"),
        (SQUARE, {"speed": 11.0}, "11 m/s"),
        (SQUARE, {"corner_radius": -1.0}, "radius"),
        (SQUARE, {"corner_radius": math.inf}, "radius"),
    ],
)
def test_what_cannot_be_flown_is_refused_by_name(
    points: list[Point], options: dict[str, float], words: str
) -> None:
    with pytest.raises(UsageError, match=words):
        Path(points, **{"speed": 2.0, "corner_radius": 2.0, "max_speed": 10.0, **options})
