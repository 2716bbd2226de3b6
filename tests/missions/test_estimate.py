"""Estimates: what each part of a plan adds, and that nothing is forgotten."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from m100link import (
    AtEnd,
    GimbalPitch,
    Heading,
    Stay,
    TakePhoto,
    Trace,
    TurnTo,
    UsageError,
    Waypoint,
    WaypointPlan,
)
from m100link.geodesy import destination
from m100link.missions.waypoint import WaypointAction

HOME = 52.1, 4.31


def at(north: float, east: float = 0.0, height: float = 30.0, **values: Any) -> Waypoint:
    return Waypoint(*destination(*HOME, north, east), height, **values)


STOP_S = 2 + 0.3 * 5
PLAN = WaypointPlan([at(0), at(100), at(200)], speed=5)
SECONDS = 200 / 5 + 2 * STOP_S


def seconds(**values: Any) -> float:
    return replace(PLAN, **values).estimate().duration_s


def with_actions(*actions: WaypointAction, **values: Any) -> float:
    return seconds(waypoints=[at(0), at(100, actions=actions, **values), at(200)]) - SECONDS


def test_a_straight_way_is_its_length_by_its_speed_and_its_stops() -> None:
    made = PLAN.estimate(hover_minutes=20)
    assert made.length_m == pytest.approx(200, abs=0.01)
    assert made.duration_s == pytest.approx(SECONDS, abs=0.01)
    assert made.battery_percent == pytest.approx(SECONDS / 12, abs=0.01)
    assert str(made) == "200 m in 47 s, 4 % of a battery that hovers for 20 min"
    assert seconds(trace=Trace.COORDINATED_TURNS) == pytest.approx(SECONDS - STOP_S, abs=0.01)


def test_a_steep_leg_is_climbed_slowly() -> None:
    steep = WaypointPlan([at(0, height=0), at(1, height=60)], speed=10)
    assert steep.estimate().duration_s == pytest.approx(60 / 3 + 2 + 3, abs=0.01)


def test_actions_take_their_time() -> None:
    assert with_actions(Stay(7)) == pytest.approx(7, abs=0.01)
    assert with_actions(TakePhoto(), GimbalPitch(-90)) == pytest.approx(3.5, abs=0.01)
    assert with_actions(GimbalPitch(-90), action_repeat=9) == pytest.approx(2, abs=0.01)
    assert with_actions(Stay(7), action_repeat=3) == pytest.approx(21, abs=0.01)
    assert with_actions(Stay(7), action_repeat=0) == pytest.approx(7, abs=0.01)
    assert with_actions(Stay(7), action_time_limit=2) == pytest.approx(2, abs=0.01)
    assert with_actions(Stay(7), action_time_limit=None) == pytest.approx(7, abs=0.01)


def test_the_gimbal_is_where_it_was_left() -> None:
    down = [at(0, actions=[GimbalPitch(-90)]), at(100, actions=[GimbalPitch(-90)]), at(200)]
    assert seconds(waypoints=down) == pytest.approx(SECONDS + 2, abs=0.01)
    assert seconds(waypoints=down, gimbal_by_waypoint=True) == pytest.approx(SECONDS + 4, abs=0.01)


def test_turns_go_round_as_the_waypoint_says() -> None:
    assert with_actions(TurnTo(90)) == pytest.approx(2, abs=0.01)
    assert with_actions(TurnTo(90), turn_clockwise=False) == pytest.approx(6, abs=0.01)
    corner = [at(0), at(100), at(100, 100)]
    assert seconds(waypoints=corner) == pytest.approx(SECONDS + 2, abs=0.01)
    assert seconds(waypoints=corner, heading=Heading.BY_RC) == pytest.approx(SECONDS, abs=0.01)
    assert seconds(waypoints=corner, heading=Heading.BY_WAYPOINT) == pytest.approx(
        SECONDS, abs=0.01
    )


def test_a_second_run_begins_where_the_first_began() -> None:
    again = replace(PLAN, repeat=2).estimate()
    assert again.length_m == pytest.approx(600, abs=0.1)
    assert again.duration_s == pytest.approx(2 * SECONDS + 200 / 5 + STOP_S, abs=0.1)
    back = replace(PLAN, at_end=AtEnd.FIRST_POINT).estimate()
    assert back.length_m == pytest.approx(400, abs=0.1)


def test_the_ways_from_and_to_home_count_when_home_is_known() -> None:
    plan = WaypointPlan([at(100), at(200)], speed=5, at_end=AtEnd.GO_HOME)
    without = plan.estimate()
    assert without.length_m == pytest.approx(100 + 30, abs=0.1)  # it lands
    made = plan.estimate(home=HOME)
    assert made.length_m == pytest.approx(30 + 100 + 100 + 200 + 30, abs=0.2)
    assert made.duration_s > without.duration_s + 100 / 5 + 200 / 8
    landing = replace(plan, at_end=AtEnd.LAND).estimate(home=HOME)
    assert landing.length_m == pytest.approx(30 + 100 + 100 + 30, abs=0.2)


@pytest.mark.parametrize("speed", [0, -3])
def test_what_only_the_stick_moves_takes_for_ever(speed: float) -> None:
    made = replace(PLAN, speed=speed).estimate()
    assert made.duration_s == made.battery_percent == math.inf
    assert str(made) == "200 m, as fast as the pilot's stick"


@pytest.mark.parametrize("minutes", [0, -1, math.nan, math.inf])
def test_a_battery_that_lasts_no_time_is_refused(minutes: float) -> None:
    with pytest.raises(UsageError, match="hovers for"):
        PLAN.estimate(hover_minutes=minutes)
