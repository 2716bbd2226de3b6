"""White noise and errors that wander."""

from __future__ import annotations

import itertools
import math
import statistics
from random import Random

import pytest

from m100link.sim.vehicle.sensors import Wander, noise_source


def test_noise_has_unit_variance_and_comes_from_the_generator() -> None:
    first, again, other = (noise_source(Random(seed)) for seed in (1, 1, 2))
    samples = [value for _ in range(4_000) for value in first()]
    assert samples == [value for _ in range(4_000) for value in again()]
    assert samples != [value for _ in range(4_000) for value in other()]
    assert statistics.fmean(samples) == pytest.approx(0.0, abs=0.05)
    assert statistics.pstdev(samples) == pytest.approx(1.0, rel=0.05)


def test_a_wander_has_its_deviation_in_the_long_run_and_its_memory_in_the_short() -> None:
    error = Wander(Random(7), 0.5, 10.0, 0.1)
    values = []
    for _ in range(100_000):
        error.advance()
        values.append(error.value)
    assert statistics.pstdev(values) == pytest.approx(0.5, rel=0.1)
    steps = [after - before for before, after in itertools.pairwise(values)]
    assert statistics.pstdev(steps) == pytest.approx(0.5 * math.sqrt(2 * 0.1 / 10.0), rel=0.05)
    apart = statistics.correlation(values[:-100], values[100:])  # one memory
    assert apart == pytest.approx(1 / math.e, abs=0.1)


def test_an_error_is_forgotten() -> None:
    error = Wander(Random(1), 0.0, 2.0, 0.5)
    error.value = 1.0
    for _ in range(4):
        error.advance()
    assert error.value == pytest.approx(1 / math.e)
