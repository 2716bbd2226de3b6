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
from m100link.missions.checks import PlanEstimate
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
    assert PLAN.estimate(hover_minutes=0.5).battery_percent == pytest.approx(SECONDS / 0.3)
    assert seconds(trace=Trace.COORDINATED_TURNS) == pytest.approx(SECONDS - STOP_S, abs=0.01)


@pytest.mark.parametrize(
    ("heading", "turned"),
    [(Heading.ALONG_PATH, 2.0), (Heading.AS_AT_START, 4.0), (Heading.BY_RC, 4.0)],
)
def test_a_turn_begins_where_the_nose_points(heading: Heading, turned: float) -> None:
    """To 180° at 45°/s: from the east, where it flies; from north, where nobody knows."""
    points = [at(0), at(0, 100, actions=[TurnTo(180)], turn_clockwise=True), at(0, 200)]
    turning = WaypointPlan(points, speed=5, heading=heading).estimate().duration_s
    assert turning - SECONDS == pytest.approx(turned, abs=0.01)


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
    southward = [at(200), at(100, -20), at(0)]  # courses of -169 and 169°: the short way round
    turn = 2 * math.degrees(math.atan2(20, 100)) / 45
    way = 2 * math.hypot(100, 20) / 5 + 2 * STOP_S
    assert seconds(waypoints=southward) == pytest.approx(way + turn, abs=0.01)
    assert with_actions(TurnTo(-90), TurnTo(-90)) == pytest.approx(6, abs=0.01)
    named = [at(0), at(100, heading_deg=90, actions=[TurnTo(45)]), at(200)]
    assert seconds(waypoints=named, heading=Heading.BY_WAYPOINT) == pytest.approx(
        SECONDS + 315 / 45, abs=0.01
    )
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
    assert back.duration_s == pytest.approx(SECONDS + 200 / 5 + STOP_S, abs=0.1)
    both = replace(PLAN, repeat=2, at_end=AtEnd.FIRST_POINT).estimate()
    assert both.length_m == pytest.approx(800, abs=0.2)
    assert both.duration_s == pytest.approx(2 * (SECONDS + 200 / 5 + STOP_S), abs=0.2)


@pytest.mark.parametrize(("first", "last"), [(30, 70), (70, 30)])
def test_the_way_back_to_the_first_point_is_as_long_as_it_climbs(first: int, last: int) -> None:
    """3-4-5: 30 m by 40 m; the climb takes longer than the way."""
    rising = WaypointPlan(
        [at(0, height=first), at(30, height=last)], speed=5, at_end=AtEnd.FIRST_POINT
    ).estimate()
    assert rising.length_m == pytest.approx(50 + 50, abs=0.05)
    assert rising.duration_s == pytest.approx(2 * (40 / 3 + STOP_S), abs=0.05)


def test_a_landing_below_the_take_off_point_takes_as_long_as_one_above() -> None:
    for height in (20, -20):
        landing = WaypointPlan(
            [at(0, height=height), at(50, height=height)], speed=5, at_end=AtEnd.LAND
        ).estimate(home=HOME)
        assert landing.length_m == pytest.approx(20 + 50 + 20, abs=0.05)
        assert landing.duration_s == pytest.approx(
            20 / 3 + STOP_S + 50 / 5 + STOP_S + 20 / 1.5, abs=0.05
        )


@pytest.mark.parametrize(
    ("duration_s", "said"),
    [(59.4, "59 s"), (59.6, "1:00 min"), (65, "1:05 min"), (600, "10:00 min")],
)
def test_seconds_are_said_as_minutes_from_60_on(duration_s: float, said: str) -> None:
    assert str(PlanEstimate(7.4, duration_s, 49.6, 17)) == (
        f"7 m in {said}, 50 % of a battery that hovers for 17 min"
    )


def test_the_ways_from_and_to_home_count_when_home_is_known() -> None:
    plan = WaypointPlan([at(100), at(200)], speed=5, at_end=AtEnd.GO_HOME)
    without = plan.estimate()
    assert without.length_m == pytest.approx(100 + 30, abs=0.1)  # it lands
    made = plan.estimate(home=HOME)
    assert made.length_m == pytest.approx(30 + 100 + 100 + 200 + 30, abs=0.2)
    # The landing with 1.5 m/s; before that the climb with 3 m/s, and the way home with 8 m/s.
    assert without.duration_s == pytest.approx(100 / 5 + STOP_S + 30 / 1.5, abs=0.05)
    around = 30 / 3 + 100 / 5 + STOP_S + 200 / 8 + 2
    assert made.duration_s == pytest.approx(without.duration_s + around, abs=0.05)
    # DJI: 17 minutes with 500 g.
    assert made.battery_percent == pytest.approx(100 * made.duration_s / (17 * 60), abs=0.01)
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
