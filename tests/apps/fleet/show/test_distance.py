"""How near two tracks come: against arithmetic, and against looking everywhere."""

from __future__ import annotations

import math
import random

import pytest

from m100link.apps.fleet.show.plan.track import apart, closest, under
from tests.apps.fleet.show.shows import random_track, track


def test_two_that_cross_meet_where_arithmetic_says() -> None:
    """One flies north through the middle, the other east, 2 m higher and as fast."""
    first = track("a1", (0, -20, 0, 5), (10, 20, 0, 5), (20, 60, 0, 5))
    second = track("a2", (0, 0, -20, 7), (10, 0, 20, 7), (20, 0, 60, 7))
    found = closest(first, second)
    assert found is not None
    distance, at = found
    # By symmetry both are at the middle at the same time, above each other.
    assert distance == pytest.approx(2.0, abs=2e-3)
    assert first.moment(at).place[0] == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("seed", range(25))
def test_no_moment_is_nearer_than_the_nearest(seed: int) -> None:
    chance = random.Random(seed)
    first, second = random_track(chance, "a"), random_track(chance, "b")
    found = closest(first, second)
    assert found is not None
    distance, when = found
    last = max(first.end, second.end)

    def at(time: float) -> float:
        return apart(
            first.moment(time).place,
            second.moment(time).place,
            first_ended=time >= first.end,
            second_ended=time >= second.end,
        )

    everywhere = [at(last * index / 5000) for index in range(5001)]
    assert min(everywhere) >= distance - 1.1e-3
    assert distance == pytest.approx(at(when), abs=1e-9)
    fastest = math.hypot(*first.fastest) + math.hypot(*second.fastest)
    assert distance >= min(everywhere) - fastest * last / 5000 - 1.1e-3


def test_whoever_has_ended_may_be_anywhere_below_its_last_point() -> None:
    ended = track("a1", (0, 0, 0, 10), (5, 1, 0, 10))
    below = track("a2", (0, -20, 0, 3), (10, -20, 0, 3), (20, 20, 0, 3), (30, 40, 0, 3))
    above = track("a3", (0, -20, 0, 14), (10, -20, 0, 14), (20, 20, 0, 14), (30, 40, 0, 14))
    for first, second in ((ended, below), (below, ended)):
        found = closest(first, second)
        assert found is not None
        assert found[0] == pytest.approx(0.0, abs=2e-3)  # flown under, where it may be landing
        assert 10 < found[1] < 20
    over = closest(above, ended)
    assert over is not None
    assert over[0] == pytest.approx(4.0, abs=2e-3)


def test_two_that_land_are_as_near_as_their_spots() -> None:
    high = track("a1", (0, 0, 0, 5), (10, 10, 0, 20))
    low = track("a2", (0, 20, 0, 5), (10, 13, 0, 2))
    found = closest(high, low)
    assert found is not None
    assert found[0] == pytest.approx(3.0, abs=2e-3)
    assert found[1] == 10


def test_who_is_far_enough_is_of_no_interest() -> None:
    first = track("a1", (0, 0, 0, 5), (10, 10, 0, 5))
    second = track("a2", (0, 0, 8, 5), (10, 10, 8, 5))
    third = track("a3", (0, 0, 30, 5), (10, 10, 30, 5))
    assert closest(first, second, below=8.0) is None
    found = closest(first, second, below=8.01)
    assert found is not None
    assert found[0] == pytest.approx(8.0)
    pairs = list(under([first, second, third], lambda _a, _b: 9.0))
    assert [(a.name, b.name) for a, b, *_ in pairs] == [("a1", "a2")]
