"""A plan as a value: what it tells of itself."""

from __future__ import annotations

import pickle

import pytest

from m100link import Waypoint, WaypointPlan

PLAN = WaypointPlan(
    [Waypoint(52.1, 4.31, 20.0), Waypoint(52.1009, 4.31, 45.0), Waypoint(52.1009, 4.32, -5.0)]
)


def test_a_plan_is_a_value() -> None:
    assert pickle.loads(pickle.dumps(PLAN)) == PLAN
    assert hash(WaypointPlan(list(PLAN.waypoints))) == hash(PLAN)
    with pytest.raises(AttributeError):
        PLAN.speed = 3.0  # type: ignore[misc]


def test_how_long_high_and_far_it_is() -> None:
    assert PLAN.length_m == pytest.approx(103.23 + 686.9, abs=0.5)
    assert PLAN.heights == (-5.0, 45.0)
    assert PLAN.farthest_m(52.1, 4.31) == pytest.approx(692.3, abs=0.5)
