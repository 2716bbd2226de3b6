"""Whether the rest of a track keeps away from where a silent one may stand."""

from __future__ import annotations

import math
import random
import time

import pytest

from m100link.apps.fleet.show.plan.conflicts import RestOfTrack, nearest
from m100link.apps.fleet.show.plan.track import Vector
from tests.apps.fleet.show.shows import random_track, track

NORTH = track("a1", (0, 0, 0, 4), (20, 40, 0, 4))


def test_it_says_when_it_first_comes_near_to_a_place() -> None:
    rest = RestOfTrack(NORTH)
    reached = next(at / 100 for at in range(2000) if NORTH.moment(at / 100).place[0] > 17.0)
    assert rest.meets([(20.0, 0.0, 4.0)], 3.0, 0.0) == pytest.approx(reached, abs=0.2)
    assert rest.meets([(20.0, 3.1, 4.0)], 3.0, 0.0) is None
    assert rest.meets([(20.0, 2.9, 4.0), (90.0, 0.0, 4.0)], 3.0, 0.0) is not None


def test_what_lies_behind_it_does_not_count() -> None:
    rest = RestOfTrack(NORTH)
    assert rest.meets([(10.0, 0.0, 4.0)], 3.0, 10.0) is None
    assert rest.meets([(10.0, 0.0, 4.0)], 3.0, 0.0) is not None


def test_it_stays_at_its_last_point_and_may_land_there() -> None:
    rest = RestOfTrack(NORTH)
    assert rest.meets([(41.0, 1.0, 4.0)], 3.0, 60.0) == 60.0
    assert rest.meets([(40.0, 0.0, 0.0)], 3.0, 0.0) == pytest.approx(20.0, abs=0.2)


def test_one_that_stands_above_may_come_down_and_one_below_does_not_rise() -> None:
    rest = RestOfTrack(NORTH)
    assert rest.meets([(20.0, 0.0, 30.0)], 3.0, 0.0) is not None
    assert rest.meets([(20.0, 0.0, 0.0)], 3.0, 0.0) is None


def test_no_place_that_a_track_comes_near_to_is_overlooked() -> None:
    """Against looking at each hundredth of a second."""
    seed = random.randrange(1 << 32)
    chance = random.Random(seed)
    for _ in range(60):
        one, begin = random_track(chance), chance.uniform(0, 20)
        ways: list[Vector] = [
            (chance.uniform(-40, 40), chance.uniform(-40, 40), chance.uniform(0, 20))
            for _ in range(chance.randint(1, 4))
        ]
        last = max(begin, one.end)
        times = [begin + (last - begin) * index / 2000 for index in range(2000)]
        truth = min(nearest(one.moment(at).place, ways, has_ended=False) for at in times)
        truth = min(truth, nearest(one.moment(last).place, ways, has_ended=True))
        rest = RestOfTrack(one)
        # It looks ten times a second, so no moment is further than that from one it looks at.
        between = 0.05 * math.hypot(*one.fastest)
        assert rest.meets(ways, truth + 0.05 + between, begin) is not None, f"seed {seed}"
        if truth > 0.1:
            assert rest.meets(ways, truth - 0.05, begin) is None, f"seed {seed}"


def test_a_long_track_of_which_many_are_silent_costs_little() -> None:
    """Whoever flies it needs a setpoint every 20 ms."""
    points = [(10.0 * n, 8.0 * (n % 20), 5.0 * (n // 20), 4.0) for n in range(1000)]
    rest = RestOfTrack(track("a1", *points))
    rest.meets([(0.0, 900.0, 4.0)], 3.0, 0.0)
    ways = [(math.sin(n), 900.0, 4.0) for n in range(101)]
    took = []
    for _ in range(5):  # a machine that is shared makes some of them dearer
        began = time.process_time()
        for _ in range(100):
            assert rest.meets(ways, 3.0, 0.0) is None
        took.append(time.process_time() - began)
    assert min(took) < 0.1
