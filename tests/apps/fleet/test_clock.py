"""The agent's clock, by questions and answers."""

from __future__ import annotations

import random

import pytest

from m100link.apps.fleet.expiry import AgentClock


def test_nothing_is_known_before_anything_was_heard() -> None:
    clock = AgentClock()
    assert clock.bound_s is None
    with pytest.raises(ValueError, match="nothing was heard"):
        clock.its(0.0)


@pytest.mark.parametrize("seed", range(20))
def test_it_is_never_wrong_by_more_than_it_says(seed: int) -> None:
    chance = random.Random(seed)
    clock, offset = AgentClock(), chance.uniform(-1e5, 1e5)
    for exchange in range(30):
        now = float(exchange)
        there, back = chance.expovariate(20), chance.expovariate(20)
        clock.heard(now, now + there + offset, now + there + back)
        assert clock.bound_s is not None
        assert abs(clock.its(now) - (now + offset)) <= clock.bound_s + 1e-9


def test_the_shortest_way_of_the_last_eight_is_believed() -> None:
    clock = AgentClock()
    clock.heard(0.0, 100.005, 0.01)
    for _ in range(7):
        clock.heard(1.0, 105.0, 3.0)
    assert clock.bound_s == pytest.approx(0.005)
    clock.heard(2.0, 105.0, 4.0)
    assert clock.bound_s == pytest.approx(1.0), "what is old says nothing of a clock that drifts"
