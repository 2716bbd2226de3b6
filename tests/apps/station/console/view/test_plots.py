"""Plots: names for people, and what goes to the page."""

from __future__ import annotations

import json
import math
from itertools import pairwise

import pytest

from m100link.apps.station.console.history import COLUMNS, INTERVAL
from m100link.apps.station.console.view.plots import (
    FIRST_CHOICE,
    MOST,
    RANGES,
    chart,
    height,
    known,
    label,
    points,
    step,
)
from m100link.apps.station.console.view.units import (
    METRIC,
    Language,
    LengthUnit,
    SpeedUnit,
    Units,
)
from m100link.apps.station.console.view.words import Speaker


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("position.height_m", "position: height, m"),
        ("velocity.ground_speed_m_s", "velocity: ground speed, m/s"),
        ("angular_velocity.yaw_rate_deg_s", "angular velocity: yaw rate, °/s"),
        ("battery.percent", "battery: charge, %"),
        ("flight_status.status", "flight status: status"),
        ("line.round_trip_ms", "line: round trip, ms"),
        ("line.packages_per_s", "line: packages, 1/s"),
    ],
)
def test_a_number_is_called_by_what_it_is_and_its_unit(name: str, shown: str) -> None:
    assert Speaker()(label(name)) == shown


def test_lengths_and_speeds_are_drawn_in_the_units_that_were_chosen() -> None:
    speaker = Speaker(Language.GERMAN, Units(LengthUnit.FOOT, SpeedUnit.KM_H))
    names = "position.height_m", "velocity.up_m_s", "acceleration.up_m_s2"
    assert [speaker(label(name)) for name in names] == [
        "Position: Höhe, ft",
        "Geschwindigkeit: nach oben, km/h",
        "Beschleunigung: nach oben, m/s²",
    ]
    made = points([(1.0, 10.0, 10.0, 10.0)], names, speaker.units)
    assert made == [[1000, 32.8084, 36.0, 10.0]]
    assert chart(names, speaker)["yAxis"][0]["name"] == "Position: Höhe, ft"


@pytest.mark.parametrize("language", Language)
def test_every_number_has_a_name_of_its_own(language: Language) -> None:
    speaker = Speaker(language)
    assert len({speaker(label(name)) for name in COLUMNS}) == len(COLUMNS)


def test_every_number_with_a_unit_in_its_name_shows_it() -> None:
    endings = ("_m", "_deg", "_s", "_ms", "_rad", "_hz", "_s2", "percent")
    said = [Speaker()(label(name)) for name in COLUMNS if name.endswith(endings)]
    assert [text for text in said if ", " not in text] == []


def test_only_what_there_is_can_be_drawn_each_once_and_not_too_much() -> None:
    assert known(["battery.percent", "nonsense", "battery.percent"]) == ["battery.percent"]
    assert len(known(COLUMNS)) == MOST
    assert known(FIRST_CHOICE) == list(FIRST_CHOICE)


def test_no_value_is_null_for_the_page_and_not_a_number() -> None:
    made = points([(1.5, 2.0, math.nan)], COLUMNS[:2], METRIC)
    assert made == [[1500, 2.0, None]]
    assert json.loads(json.dumps(made, allow_nan=False)) == [[1500, 2.0, None]]


@pytest.mark.parametrize("count", [0, 1, MOST])
def test_each_number_has_a_stripe_of_its_own_and_one_cursor_reads_all(count: int) -> None:
    options = chart(COLUMNS[:count], Speaker())
    assert len(options["grid"]) == len(options["series"]) == len(options["yAxis"]) == count
    assert options["axisPointer"]["link"] == [{"xAxisIndex": "all"}]
    assert sum(one["axisLabel"]["show"] for one in options["xAxis"]) == min(count, 1)
    assert all(one["axisLabel"]["hideOverlap"] for one in options["xAxis"])
    tops = [grid["top"] for grid in options["grid"]]
    assert all(after - before > 88 for before, after in pairwise(tops))
    assert not tops or tops[-1] + 88 <= height(COLUMNS[:count])


@pytest.mark.parametrize("seconds", RANGES)
def test_a_line_has_no_more_points_than_are_seen(seconds: int) -> None:
    assert seconds / INTERVAL / step(seconds) <= 600
