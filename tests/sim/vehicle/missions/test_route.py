from __future__ import annotations

import itertools
import math
from random import Random

import pytest

from m100link.sim.vehicle.dynamics import Dynamics, ModelYaw
from m100link.sim.vehicle.missions.route import (
    LocalPlace,
    MissionSettings,
    MissionSteering,
    Nose,
    OnLeg,
    RouteLeg,
    distance,
    legs_between,
    slowed,
)

CORNER = [LocalPlace(0.0, 0.0, 10.0), LocalPlace(40.0, 0.0, 10.0), LocalPlace(40.0, 30.0, 10.0)]


def test_without_dampings_each_leg_is_a_line() -> None:
    legs = legs_between(CORNER, None)
    assert [(leg.first, leg.last, leg.length) for leg in legs] == [(0, 1, 40.0), (1, 2, 30.0)]
    assert legs[1].at(10.0).place == LocalPlace(40.0, 10.0, 10.0)
    assert legs[1].at(10.0).tangent == LocalPlace(0.0, 1.0, 0.0)
    assert all(leg.curves == [] for leg in legs)


def test_a_rounded_corner_of_90_degrees_has_its_damping_as_radius() -> None:
    (leg,) = legs_between(CORNER, [0.0, 5.0, 0.0])
    assert leg.length == pytest.approx(35.0 + 5.0 * math.pi / 2.0 + 25.0)
    ((start, end, radius),) = leg.curves
    assert [start, radius] == pytest.approx([35.0, 5.0])
    assert leg.marks[1] == pytest.approx((35.0 + 5.0 * math.pi / 4.0, 1))
    middle = leg.at((start + end) / 2.0)
    centre = LocalPlace(35.0, 5.0, 10.0)
    assert distance(middle.place, centre) == pytest.approx(5.0)
    assert distance(middle.place, CORNER[1]) == pytest.approx(5.0 * (math.sqrt(2.0) - 1.0))
    # The curvature points from there to the centre.
    assert middle.place.plus(middle.bend, 25.0) == pytest.approx(centre)


@pytest.mark.parametrize("seed", range(20))
def test_a_curved_leg_is_smooth_and_measures_itself(seed: int) -> None:
    random = Random(seed)
    places = [
        LocalPlace(random.uniform(-50, 50), random.uniform(-50, 50), random.uniform(5, 40))
        for _ in range(8)
    ]
    lengths = [distance(a, b) for a, b in itertools.pairwise(places)]
    dampings = [0.45 * min(a, b) for a, b in zip([1e9, *lengths], [*lengths, 1e9], strict=True)]
    for leg in legs_between(places, dampings):
        s, step = 0.0, leg.length / 2000.0
        before = leg.at(0.0)
        while s < leg.length - step:
            s += step
            here = leg.at(s)
            assert distance(before.place, here.place) == pytest.approx(step, rel=0.02)
            assert math.hypot(*here.tangent) == pytest.approx(1.0)
            turn = math.acos(max(-1.0, min(1.0, before.tangent.dot(here.tangent))))
            assert turn <= step / min([math.inf, *(curve[2] for curve in leg.curves)]) + 1e-4
            before = here


@pytest.mark.parametrize("angle", [100, 135, 170, 179])
def test_the_curves_of_neighbours_never_overlap(angle: int) -> None:
    turned = math.radians(angle)
    places = [LocalPlace(0, 0, 0), LocalPlace(20, 0, 0)]
    for number in (1, 2):
        way = LocalPlace(20 * math.cos(number * turned), 20 * math.sin(number * turned), 0.0)
        places.append(places[-1].plus(way))
    legs = legs_between(places, [0.0, 10.0, 10.0, 0.0])
    assert sum(leg.length for leg in legs) <= 60.0
    for leg in legs:
        for start, end, _ in leg.curves:
            assert -1e-9 <= start <= end <= leg.length + 1e-9


def test_a_corner_without_a_curve_ends_a_leg_and_a_straight_point_does_not() -> None:
    places = [
        LocalPlace(0, 0, 0),
        LocalPlace(10, 0, 0),
        LocalPlace(20, 0, 0),
        LocalPlace(20, 10, 0),
    ]
    legs = legs_between(places, [0.0] * 4)
    assert [(leg.first, leg.last) for leg in legs] == [(0, 2), (2, 3)]
    assert legs[0].marks == [(0.0, 0), (10.0, 1), (20.0, 2)]


def test_nearest_finds_a_place_beside_the_leg() -> None:
    (leg,) = legs_between(CORNER, [0.0, 5.0, 0.0])
    for s in (3.0, 36.0, 40.0, 60.0):
        on = leg.at(s)
        beside = on.place.plus(LocalPlace(0.0, 0.0, 1.0))
        assert leg.nearest(beside, s - 1.0) == pytest.approx(s, abs=0.05)
    assert leg.nearest(LocalPlace(-9, 0, 10), 0.0) == 0.0
    assert leg.nearest(LocalPlace(40, 99, 10), leg.length) == leg.length


def test_between_tells_the_neighbours_and_the_share() -> None:
    (leg,) = legs_between(CORNER, [0.0, 5.0, 0.0])
    middle = leg.marks[1][0]
    assert leg.between(0.0) == (0, 1, 0.0)
    assert list(leg.between(middle / 2.0)) == pytest.approx([0, 1, 0.5])
    assert leg.between(middle) == (1, 2, 0.0)
    assert leg.between(leg.length) == (1, 2, 1.0)


def test_a_way_of_no_length_is_a_place() -> None:
    here = LocalPlace(1.0, 2.0, 3.0)
    leg = RouteLeg.straight(here, here, 0, 0)
    assert (leg.length, leg.at(0.0).place) == (0.0, here)
    assert leg.nearest(LocalPlace(5.0, 5.0, 5.0), 0.0) == 0.0
    assert leg.between(0.0) == (0, 0, 1.0)


@pytest.mark.parametrize(
    ("speed", "left", "expected"),
    [
        (5.0, 100.0, (5.0, 0.0)),
        (12.0, 20.0, (math.sqrt(2 * 1.8 * 20.0), -1.8)),  # it brakes by 1.8 m/s², and no harder
        (5.0, 1.0, (0.8, -0.64)),  # on the last metres, by 0.8 m/s per metre
        (0.8, 1.0, (0.8, 0.0)),
        (5.0, 0.0, (0.0, 0.0)),
        (5.0, -2.0, (0.0, 0.0)),
        (0.0, 5.0, (0.0, 0.0)),
    ],
)
def test_it_slows_down_so_that_it_stands_in_time(
    speed: float, left: float, expected: tuple[float, float]
) -> None:
    assert slowed(speed, left) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("speed", "along", "climb"),
    [
        (3.0, 3.0 - 1.0 / 1.6, 3.0),
        (9.0, 2.2 + 2.5 / 1.6, 2.2 + 2.5 * 0.35),  # it gains no more than 2.5 m/s²
        (-9.0, 2.2 - 2.5 / 1.6, 2.2 - 2.5 * 0.35),
    ],
)
def test_the_velocity_that_leads_back_to_a_line_and_along_it(
    speed: float, along: float, climb: float
) -> None:
    """10 m beside a line, at 2.2 m/s along it, braking by 1 m/s² before a curve of 10 m."""
    motion = Dynamics()
    motion.place(2.0, 3.0, 10.0)
    motion.velocity_north, motion.velocity_east, motion.velocity_up = 1.0, 0.5, 2.0
    steering = MissionSteering(motion, motion.airframe)
    tangent, bend = LocalPlace(0.6, 0.0, 0.8), LocalPlace(0.04, 0.1, 0.0)
    on = OnLeg(LocalPlace(8.0, 11.0, 12.0), tangent, LocalPlace(9.0, 9.0, 9.0))
    ahead = OnLeg(LocalPlace(0.0, 0.0, 0.0), LocalPlace(9.0, 9.0, 9.0), bend)
    guidance = steering.along(on, ahead, speed, -1.0, ModelYaw.RATE, 0.3)
    # 3 m/s sideways at most; the pull of the curve is asked for by a difference over 1.6 1/s; the
    # height comes back by 1.2 m/s per metre.
    assert (guidance.a, guidance.b, guidance.up) == pytest.approx(
        (
            0.6 * along + 0.3 * 6.0 + 0.04 * speed**2 / 1.6,
            0.3 * 8.0 + 0.1 * speed**2 / 1.6,
            0.8 * climb + 1.2 * 2.0,
        )
    )
    motion.place(7.0, 12.0, 12.0)  # 1.4 m beside it: 1 m/s per metre
    guidance = steering.along(on, on._replace(bend=LocalPlace(0, 0, 0)), 0.0, 0.0, ModelYaw.RATE, 0)
    assert (guidance.a, guidance.b, guidance.up) == pytest.approx((1.0, -1.0, 0.0))


def test_a_steep_line_is_as_fast_as_85_percent_of_the_climb_and_0_2_s_are_looked_ahead() -> None:
    motion = Dynamics()
    steering = MissionSteering(motion, motion.airframe)
    for up in (0.8, -0.8):
        assert steering.steepest(LocalPlace(0.6, 0.0, up)) == pytest.approx(0.85 * 4.0 / 0.8)
    assert steering.lead(5.0) == pytest.approx(1.0)


def test_the_nose_turns_by_its_rate() -> None:
    nose = Nose(0.2, 45.0)
    nose.turn_to(-1.0)
    assert nose.step() == pytest.approx(0.2 - math.radians(0.45))


@pytest.mark.parametrize("rate", [-0.1, 100.1, math.nan])
def test_the_status_comes_at_100_hz_at_most(rate: float) -> None:
    with pytest.raises(ValueError, match="0 to 100 Hz"):
        MissionSettings(status_hz=rate)
