"""The geometry of a path, flown by a point whose velocity lags behind its setpoint."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from itertools import pairwise

import pytest

from m100link import UsageError
from m100link.flight.path import Path, PathSteering

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


def test_a_curve_of_many_points_is_flown_at_its_speed() -> None:
    points: list[Point] = [
        (30 * math.sin(angle), 30 - 30 * math.cos(angle), 5)
        for angle in (index / 30 for index in range(180))
    ]
    flown = fly(points, speed=4.0, radius=2.0)
    assert flown.seconds < 1.3 * 179 / 4.0 + 10
    assert flown.off_m < 0.3


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


def turned(vector: tuple[float, float], angle: float) -> tuple[float, float]:
    cos, sin = math.cos(angle), math.sin(angle)
    return vector[0] * cos - vector[1] * sin, vector[0] * sin + vector[1] * cos


@pytest.mark.parametrize("radius", [0.0, 3.0])
def test_a_path_is_the_same_on_each_bearing_and_its_mirror_is_steered_mirrored(
    radius: float,
) -> None:
    """No side is another one's, in legs and in bends, beside them and beyond their end."""
    seed = random.randrange(1 << 32)
    chance = random.Random(seed)
    for _ in range(12):
        angle, away = chance.uniform(-3, 3), (chance.uniform(-99, 99), chance.uniform(-99, 99))
        flat = [(0.0, 0.0)]
        for _ in range(3):
            leg = turned((chance.uniform(8, 20), 0.0), chance.uniform(-3, 3))
            flat.append((flat[-1][0] + leg[0], flat[-1][1] + leg[1]))
        heights = [chance.uniform(3, 9) for _ in flat]

        def moved(at: tuple[float, float]) -> tuple[float, float]:
            north, east = turned(at, angle)  # noqa: B023 (called here)
            return north + away[0], east + away[1]  # noqa: B023

        def made(places: list[tuple[float, float]]) -> Path:
            points = [(*at, height) for at, height in zip(places, heights, strict=True)]  # noqa: B023
            return Path(points, speed=4.0, corner_radius=radius, max_speed=8.0)

        path = made(flat)
        other, mirrored = made([moved(at) for at in flat]), made([(n, -e) for n, e in flat])
        assert other.length == pytest.approx(path.length)
        assert mirrored.length == pytest.approx(path.length)
        for start, end in pairwise(flat):
            for share in (0.0, 0.3, 0.7, 1.0, 1.1):
                at = (
                    start[0] + share * (end[0] - start[0]) + chance.uniform(-1, 1),
                    start[1] + share * (end[1] - start[1]) + chance.uniform(-1, 1),
                )
                flown = chance.uniform(-3, 3), chance.uniform(-3, 3)
                height = chance.uniform(3, 9)
                one = path.steer((*at, height), flown, 0.1)
                two = other.steer((*moved(at), height), turned(flown, angle), 0.1)
                three = mirrored.steer((at[0], -at[1], height), (flown[0], -flown[1]), 0.1)
                asked = turned((one.north, one.east), angle)
                assert (two.north, two.east) == pytest.approx(asked, abs=1e-6), f"seed {seed}"
                assert (three.north, three.east) == pytest.approx(
                    (one.north, -one.east), abs=1e-6
                ), f"seed {seed}"
                for same in (two, three):
                    assert same.to_go_m == pytest.approx(one.to_go_m, abs=1e-6)
                    assert same.off_m == pytest.approx(one.off_m, abs=1e-6)
                    assert same.height == pytest.approx(one.height, abs=1e-6)
                headed = math.remainder(two.ahead_deg - one.ahead_deg - math.degrees(angle), 360)
                assert headed == pytest.approx(0, abs=1e-6), f"seed {seed}"


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


# -- what is asked for at a place, once there was time to become as fast as one may ---------------

STRAIGHT: list[Point] = [(0, 0, 5), (100, 0, 5)]


def asked_at(
    points: list[Point],
    place: tuple[float, float],
    velocity: tuple[float, float] | None = None,
    *,
    speed: float = 5.0,
    radius: float = 0.0,
    height: float = 5.0,
) -> PathSteering:
    path = Path(points, speed=speed, corner_radius=radius, max_speed=10.0)
    return path.steer((*place, height), velocity, 100.0)


@pytest.mark.parametrize(
    ("right", "drifting", "east"),
    [
        (0.0, 0.0, 0.0),
        (1.0, 0.0, -1.0),
        (-2.0, 0.0, 2.0),
        (0.0, 0.5, -0.2),
        (0.0, -1.0, 0.4),
        (1.0, -1.0, -0.6),
        (50.0, 0.0, -8.0),
        (-50.0, 0.0, 8.0),
    ],
)
def test_beside_the_path_it_is_led_back_and_what_drifts_is_damped(
    right: float, drifting: float, east: float
) -> None:
    steering = asked_at(STRAIGHT, (50.0, right), (5.0, drifting))
    assert (steering.north, steering.east) == pytest.approx((5.0, east))
    assert steering.off_m == pytest.approx(abs(right))
    assert steering.to_go_m == pytest.approx(50.0)


def test_far_beside_a_fast_path_coming_back_goes_before_being_fast() -> None:
    steering = asked_at(STRAIGHT, (50.0, 50.0), speed=9.0)
    assert (steering.north, steering.east) == pytest.approx((6.0, -8.0), abs=1e-4)
    assert math.hypot(steering.north, steering.east) <= 10.0, "more is no setpoint"


def test_it_becomes_faster_by_a_metre_per_second_each_second() -> None:
    path = Path(STRAIGHT, speed=3.0, corner_radius=0.0, max_speed=10.0)
    speeds = [path.steer((10.0, 0.0, 5.0), None, 0.5).north for _ in range(8)]
    assert speeds == pytest.approx([0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.0, 3.0])


@pytest.mark.parametrize(
    ("to_go", "north"), [(20.0, 5.0), (10.0, 4.0), (1.0, 0.4), (0.0, 0.0), (-1.0, -0.4)]
)
def test_towards_its_end_it_becomes_slow_and_beyond_it_comes_back(
    to_go: float, north: float
) -> None:
    assert asked_at(STRAIGHT, (100.0 - to_go, 0.0)).north == pytest.approx(north)


def test_flown_beyond_its_end_it_may_go_forward_again_from_rest() -> None:
    path = Path(STRAIGHT, speed=3.0, corner_radius=0.0, max_speed=10.0)
    assert path.steer((105.0, 0.0, 5.0), None, 0.1).north == pytest.approx(-2.0)
    assert path.steer((90.0, 0.0, 5.0), None, 0.1).north == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("before", "speed", "ahead_deg"),
    [(10.0, 4.4, 0.0), (1.0, 0.8, 0.0), (0.31, 0.524, 0.0), (0.29, 0.4, 90.0)],
)
def test_at_a_sharp_corner_it_is_slow_and_turns_when_it_is_near(
    before: float, speed: float, ahead_deg: float
) -> None:
    points: list[Point] = [(0, 0, 5), (20, 0, 5), (20, 40, 5)]
    steering = asked_at(points, (20.0 - before, 0.0))
    ahead = steering.north if ahead_deg == 0 else steering.east
    assert ahead == pytest.approx(speed, abs=1e-6)
    assert steering.ahead_deg == pytest.approx(ahead_deg)


@pytest.mark.parametrize("side", [1, -1], ids=["right", "left"])
@pytest.mark.parametrize(
    ("radius", "slow"), [(1.0, 0.5), (4.0, 2.0), (6.0, 3.0), (8.0, math.sqrt(12.0))]
)
def test_a_rounded_corner_is_as_slow_as_turn_rate_and_tilt_want_it(
    radius: float, slow: float, side: int
) -> None:
    points: list[Point] = [(0, 0, 5), (20, 0, 5), (20, 20 * side, 5)]
    half = radius * math.sqrt(0.5)
    place = 20 - radius + half, (radius - half) * side
    steering = asked_at(points, place, radius=radius)
    assert steering.ahead_deg == pytest.approx(45 * side)
    assert steering.off_m == pytest.approx(0.0, abs=1e-9)
    assert steering.to_go_m == pytest.approx(radius * math.pi / 4 + 20 - radius)
    ahead = (steering.north + side * steering.east) * math.sqrt(0.5)
    inwards = (side * steering.east - steering.north) * math.sqrt(0.5)
    assert ahead == pytest.approx(slow)
    # Turned inwards by the lag of the velocity times the acceleration towards the centre.
    assert inwards == pytest.approx(0.65 * slow * slow / radius)


@pytest.mark.parametrize("side", [1, -1], ids=["right", "left"])
@pytest.mark.parametrize(
    ("turn_deg", "from_corner"),
    # Rounded by 2 m, that is 2 (1 / cos(turn / 2) - 1); a shallower one as a right angle is.
    [(30, 2 * math.sqrt(2) - 2), (60, 2 * math.sqrt(2) - 2), (90, 2 * math.sqrt(2) - 2), (120, 2)],
)
def test_a_rounded_corner_is_passed_at_most_as_far_as_a_right_angle_or_its_radius_want(
    turn_deg: float, from_corner: float, side: int
) -> None:
    turn = side * math.radians(turn_deg)
    end = 20 + 20 * math.cos(turn), 20 * math.sin(turn)
    points: list[Point] = [(0, 0, 5), (20, 0, 5), (*end, 5)]
    inwards = turn / 2 + side * math.pi / 2
    place = 20 + from_corner * math.cos(inwards), from_corner * math.sin(inwards)
    steering = asked_at(points, place, radius=2.0)
    assert steering.off_m == pytest.approx(0.0, abs=1e-9)
    assert steering.ahead_deg == pytest.approx(side * turn_deg / 2)


@pytest.mark.parametrize("outwards", [1.0, -1.0])
def test_beside_a_rounded_corner_it_is_led_back_to_it(outwards: float) -> None:
    points: list[Point] = [(0, 0, 5), (20, 0, 5), (20, 20, 5)]
    share = math.sqrt(0.5) * (4.0 + outwards)
    steering = asked_at(points, (16 + share, 4 - share), (0.0, 0.0), radius=4.0)
    assert steering.off_m == pytest.approx(1.0)
    assert (steering.east - steering.north) * math.sqrt(0.5) == pytest.approx(outwards)


def test_the_turn_is_asked_for_early_and_ended_early() -> None:
    points: list[Point] = [(0, 0, 5), (20, 0, 5), (20, 20, 5)]
    # Where it will be 0.65 s later: on the leg before the bend, or on the bend.
    assert asked_at(points, (14.5, 0.0), (2.0, 0.0), radius=4.0).east == pytest.approx(0.0)
    assert asked_at(points, (15.0, 0.0), (2.0, 0.0), radius=4.0).east == pytest.approx(0.65)
    for turned_deg, still_turns in ((60, True), (80, False)):
        turned = math.radians(turned_deg)
        place = 16 + 4 * math.sin(turned), 4 - 4 * math.cos(turned)
        velocity = 2 * math.cos(turned), 2 * math.sin(turned)
        steering = asked_at(points, place, velocity, radius=4.0)
        towards_deg = math.degrees(math.atan2(steering.east, steering.north))
        assert steering.ahead_deg == pytest.approx(turned_deg)
        assert (towards_deg > turned_deg + 1) is still_turns


@pytest.mark.parametrize(("radius", "is_round"), [(0.45, False), (0.55, True)])
def test_a_radius_below_half_a_metre_is_a_corner(radius: float, is_round: bool) -> None:
    points: list[Point] = [(0, 0, 5), (20, 0, 5), (20, 20, 5)]
    length = Path(points, speed=1.0, corner_radius=radius, max_speed=10.0).length
    assert (length < 40) is is_round


@pytest.mark.parametrize(("apart", "is_one"), [(0.04, True), (0.06, False)])
def test_points_nearer_than_5_cm_are_one(apart: float, is_one: bool) -> None:
    points: list[Point] = [(0, 0, 2), (apart, 0, 7), (20, 0, 7)]
    assert (asked_at(points, (0.0, 0.0)).height == 7.0) is is_one


def test_a_bend_takes_at_most_half_of_the_shorter_leg() -> None:
    points: list[Point] = [(0, 0, 5), (6, 0, 5), (6, 40, 5)]
    path = Path(points, speed=1.0, corner_radius=20.0, max_speed=10.0)
    assert path.length == pytest.approx(3 + 1.5 * math.pi + 37)


@pytest.mark.parametrize(("at", "height"), [(0.0, 5.0), (25.0, 10.0), (50.0, 15.0), (99.0, 24.8)])
def test_the_height_of_a_leg_rises_evenly_and_is_asked_for_ahead_of_the_lag(
    at: float, height: float
) -> None:
    points: list[Point] = [(0, 0, 5), (100, 0, 25)]
    assert asked_at(points, (at, 0.0), (0.0, 0.0)).height == pytest.approx(height)
    assert asked_at(points, (at, 0.0), (1.0, 0.0)).height == pytest.approx(height + 0.13)


@pytest.mark.parametrize(("high", "north"), [(35.0, 2.0), (2.0, 5.0), (65.0, 1.0)])
def test_a_steep_leg_is_as_slow_as_two_metres_per_second_upwards_want_it(
    high: float, north: float
) -> None:
    points: list[Point] = [(0, 0, 5), (30, 0, high), (100, 0, high)]
    assert asked_at(points, (0.0, 0.0)).north == pytest.approx(north)


@pytest.mark.parametrize(
    ("at", "height", "north"),
    [(20.0, 5.0, 5.0), (50.0, 15.0, 2.0), (85.0, 32.5, 5.0), (101.0, 30.0, -0.4)],
)
def test_each_leg_rises_from_where_it_begins_and_the_last_height_is_kept(
    at: float, height: float, north: float
) -> None:
    points: list[Point] = [(0, 0, 5), (40, 0, 5), (70, 0, 35), (100, 0, 30)]
    steering = asked_at(points, (at, 0.0), (0.0, 0.0), height=height)
    assert (steering.height, steering.north) == pytest.approx((height, north))


@pytest.mark.parametrize("side", [1, -1], ids=["above", "below"])
@pytest.mark.parametrize(
    ("off", "north"), [(0.9, 5.0), (1.0, 5.0), (1.5, 2.5), (2.0, 0.0), (3, 0.0)]
)
def test_beyond_a_metre_from_the_height_of_the_path_it_becomes_slow_and_waits_at_two(
    off: float, north: float, side: int
) -> None:
    steering = asked_at(STRAIGHT, (20.0, 0.0), height=5.0 + side * off)
    assert steering.north == pytest.approx(north)


def test_the_greatest_speed_may_be_asked_for() -> None:
    assert asked_at(STRAIGHT, (20.0, 0.0), speed=10.0).north == pytest.approx(10.0, abs=1e-4)


def test_a_bend_begins_where_the_leg_before_it_ends() -> None:
    points: list[Point] = [(0, 0, 5), (20, 0, 5), (20, 20, 5)]
    assert asked_at(points, (15.8, 0.0), radius=4.0).ahead_deg == pytest.approx(0.0)


def test_the_height_of_a_rounded_corner_is_reached_in_its_middle() -> None:
    points: list[Point] = [(0, 0, 5), (20, 0, 15), (20, 20, 15)]
    middle = 16 + math.pi
    steering = asked_at(points, (middle / 2, 0.0), (0.0, 0.0), radius=4.0)
    assert steering.height == pytest.approx(10.0)
