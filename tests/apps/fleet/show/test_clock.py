"""The time elsewhere: the bound is kept whatever the network does, and what is nonsense is none."""

from __future__ import annotations

import math
import random

import pytest

from m100link.apps.fleet.show.clock import DRIFT, ClockEstimate


class Other:
    """Another machine's clock, and the way there and back."""

    def __init__(self, chance: random.Random, offset: float, drift: float) -> None:
        self.chance = chance
        self.offset = offset
        self.drift = drift

    def read(self, now: float) -> float:
        return now * (1 + self.drift) + self.offset

    def ask(self, now: float, estimate: ClockEstimate, fastest: float = 0.0002) -> float:
        """One round trip with ways of any length; returns when it ended."""
        there, stay, back = (fastest + self.chance.expovariate(1 / 0.005) for _ in range(3))
        arrived, left = now + there, now + there + stay
        assert estimate.heard(now, self.read(arrived), self.read(left), left + back)
        return left + back


@pytest.mark.parametrize("seed", range(30))
def test_the_true_time_is_always_within_the_bound(seed: int) -> None:
    chance = random.Random(seed)
    drift = chance.uniform(-0.9, 0.9) * DRIFT
    other, estimate, now = Other(chance, chance.uniform(-1e6, 1e6), drift), ClockEstimate(), 1000.0
    for _ in range(200):
        now = other.ask(now, estimate)
        for later in (0.0, chance.uniform(0, 60)):
            found = estimate.offset(now + later)
            assert found is not None
            wrong = other.read(now + later) - (now + later) - found.seconds
            assert abs(wrong) <= found.bound + 1e-9
        now += chance.uniform(0.05, 20)
    assert (estimate.steps, estimate.refused) == (0, 0)


def test_the_bound_is_half_of_the_round_trip_and_more_trips_narrow_it() -> None:
    estimate = ClockEstimate()
    assert estimate.heard(10.0, 110.004, 110.004, 10.010)  # 4 ms there, 6 ms back
    found = estimate.offset(10.010)
    assert found is not None
    assert found.bound == pytest.approx(0.005, abs=1e-5)
    assert found.seconds == pytest.approx(99.999, abs=1e-5)
    assert estimate.heard(11.0, 111.001, 111.001, 11.010)  # 1 ms there, 9 ms back
    narrower = estimate.offset(11.010)
    assert narrower is not None
    assert narrower.bound < 0.0037
    assert abs(narrower.seconds - 100.0) <= narrower.bound


def test_the_bound_widens_while_nobody_answers() -> None:
    estimate = ClockEstimate()
    assert estimate.offset(0.0) is None
    estimate.heard(0.0, 100.0, 100.0, 0.002)
    first, later = estimate.offset(0.002), estimate.offset(100.002)
    assert first is not None
    assert later is not None
    assert later.bound - first.bound == pytest.approx(100 * DRIFT)
    assert later.seconds == pytest.approx(first.seconds)


@pytest.mark.parametrize(
    "times",
    [
        (1.0, 101.0, 101.0, 0.9),  # came before it left
        (1.0, 101.0, 100.9, 1.1),  # there, too
        (1.0, 101.0, 102.0, 1.1),  # kept there for longer than all of it took
        (1.0, math.nan, 101.0, 1.1),
        (1.0, 101.0, math.inf, 1.1),
    ],
)
def test_what_no_clock_says_is_not_believed(times: tuple[float, float, float, float]) -> None:
    estimate = ClockEstimate()
    assert not estimate.heard(*times)
    assert estimate.refused == 1
    assert estimate.offset(1.1) is None


def test_a_clock_that_was_set_is_noticed_and_measured_anew() -> None:
    estimate = ClockEstimate()
    for second in range(5):
        estimate.heard(second, second + 100, second + 100, second + 0.002)
    estimate.heard(5.0, 135.0, 135.0, 5.002)
    assert estimate.steps == 1
    found = estimate.offset(5.002)
    assert found is not None
    assert found.seconds == pytest.approx(130.0, abs=0.002)
