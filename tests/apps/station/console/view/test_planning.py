"""What the Plan view says of a draft, and of what is uploaded."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import pytest

from m100link import TakePhoto, Waypoint, WaypointPlan
from m100link.apps.station.console.view.draft import Draft, checked
from m100link.apps.station.console.view.planning import (
    drawing,
    profile_options,
    row_of,
    summary_of,
    upload_of,
)
from m100link.apps.station.console.view.units import METRIC, Language, LengthUnit, Units
from m100link.apps.station.console.view.words import Speaker

SAY = Speaker()
DRAFT = Draft().added((52.1, 4.31), 20.0).added((52.101, 4.31), 30.0)


def said(draft: Draft, speaker: Speaker = SAY) -> str:
    return speaker(summary_of(draft, checked(draft)))


def test_a_draft_in_one_line() -> None:
    assert said(Draft()) == "No points yet"
    assert said(DRAFT) == "2 waypoints, 112 m, 20 m to 30 m; 0:26 min, 3 % of a battery"
    # At 1 m/s nearly two minutes: the way alone takes 112 s.
    assert re.search(r"; 1:5\d min, 1\d % of", said(replace(DRAFT, speed=1.0)))
    feet = Speaker(Language.GERMAN, Units(LengthUnit.FOOT))
    assert said(DRAFT, feet).startswith("2 Wegpunkte, 367 ft, 66 ft bis 98 ft; 0:26 min")
    assert said(replace(DRAFT, speed=0.0)).endswith("as fast as the pilot's stick")
    assert "would refuse" in said(DRAFT.changed(0, height=900.0))


def test_a_waypoint_in_one_line() -> None:
    point = Waypoint(52.1, 4.31, height=20.5, actions=[TakePhoto()])
    assert SAY(row_of(3, point)) == "3: 20.5 m, photo"
    assert SAY(row_of(4, replace(point, actions=()))) == "4: 20.5 m"


def told(plan: WaypointPlan | None, uploaded: WaypointPlan | None) -> str:
    return SAY(upload_of(plan, uploaded, "tower"))


def test_whether_start_flies_what_is_drawn_here() -> None:
    plan = DRAFT.plan()
    mission, points = plan.to_wire()
    as_told = WaypointPlan.from_wire(mission, points)  # single precision, whole degrees
    assert told(plan, None) == "Not uploaded"
    assert told(plan, as_told) == "Uploaded: start flies this plan"
    assert told(replace(plan, speed=3.0), as_told).endswith("tower uploaded another one")
    assert told(None, as_told).endswith("tower uploaded another one")


def test_what_the_map_draws_says_which_points_are_wrong() -> None:
    draft = DRAFT.changed(1, height=900.0).cornered((52.0, 4.0))
    assert drawing(draft, checked(draft), 1) == {
        "points": [[52.1, 4.31, False], [52.101, 4.31, True]],
        "area": [[52.0, 4.0]],
        "chosen": 1,
    }


@pytest.mark.parametrize("points", [[], [(0.0, 20.0), (112.34, 30.0)]])
def test_the_chart_has_each_waypoint(points: list[tuple[float, float]]) -> None:
    found: Any = profile_options(points, METRIC)
    [series] = found["series"]
    assert series["data"] == [[round(far, 1), height] for far, height in points]


def test_the_chart_is_in_the_unit_that_was_chosen() -> None:
    found: Any = profile_options([(100.0, 30.48)], Units(LengthUnit.FOOT))
    assert found["series"][0]["data"] == [[328.1, 100.0]]
    assert found["yAxis"]["axisLabel"]["formatter"] == "{value} ft"
