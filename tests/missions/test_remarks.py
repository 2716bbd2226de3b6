"""Remarks: each for the plan that it is about, and none about a plain one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from m100link import (
    AtEnd,
    Heading,
    OnRCLoss,
    Stay,
    Trace,
    Waypoint,
    WaypointPlan,
)

PLAN = WaypointPlan([Waypoint(52.1, 4.31, 20), Waypoint(52.101, 4.31, 20)])


def test_a_plain_plan_needs_none() -> None:
    assert PLAN.remarks() == []


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"on_rc_loss": OnRCLoss.CONTINUE}, "no pilot can stop it"),
        ({"speed": 0}, "speed is 0"),
        ({"speed": -2}, "speed is -2"),
        ({"at_end": AtEnd.ENDLESS}, "it never ends by itself"),
    ],
)
def test_what_is_said_of_the_whole(values: dict[str, Any], words: str) -> None:
    [remark] = replace(PLAN, **values).remarks()
    assert words in remark


@pytest.mark.parametrize(
    ("values", "words", "silent"),
    [
        ({"heading_deg": 5}, "headings of waypoints", {"heading": Heading.BY_WAYPOINT}),
        ({"gimbal_pitch_deg": -5}, "gimbal pitches", {"gimbal_by_waypoint": True}),
        ({"damping": 5}, "dampings are ignored", {"trace": Trace.COORDINATED_TURNS}),
        ({"height": 121}, "climbs to 121 m", None),
        ({"height": -3}, "3 m below the take-off point", None),
        ({"actions": [Stay(9)], "action_time_limit": 8}, "about 9 s and are cut off", None),
    ],
)
def test_what_is_said_of_waypoints(
    values: dict[str, Any], words: str, silent: dict[str, Any] | None
) -> None:
    first, last = PLAN.waypoints
    plan = replace(PLAN, waypoints=[first, replace(last, **values)])
    [remark] = plan.remarks()
    assert words in remark
    if silent is not None:
        assert replace(plan, **silent).remarks() == []


def test_more_than_a_battery() -> None:
    stays = [Stay(32)] * 15
    points = [replace(point, actions=stays, action_repeat=2) for point in PLAN.waypoints]
    assert "% of a battery" in replace(PLAN, waypoints=points).remarks()[0]
