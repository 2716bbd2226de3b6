"""Numbers as people read them."""

from __future__ import annotations

import pytest

from m100link.log.channels import Curve
from m100link.log.picture import Panel, PlotLine, clock, facts, ticks
from m100link.log.story import FlightSummary


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0, "0.0 s"),
        (38.81, "38.8 s"),
        (59.6, "59.6 s"),
        (59.96, "1:00"),
        (125, "2:05"),
        (3725.2, "1:02:05"),
    ],
)
def test_a_time_is_as_people_say_it(seconds: float, text: str) -> None:
    assert clock(seconds) == text


@pytest.mark.parametrize(
    ("low", "high", "found"),
    [
        (0, 100, [0, 50, 100]),
        (-0.8, 3, [0, 1, 2, 3]),
        (0, 2.3, [0, 1, 2]),
        (5, 5, [5]),
        (995, 1003, [996, 998, 1000, 1002]),
        (0, 7000, [0, 2000, 4000, 6000]),
    ],
)
def test_ticks_are_round_and_few(low: float, high: float, found: list[float]) -> None:
    assert ticks(low, high, 4) == pytest.approx(found)


def test_a_scale_holds_every_value_and_has_a_height_without_any() -> None:
    curve = Curve()
    panel = Panel("Speed", (PlotLine("climb", "red", curve),), (0.0, 1.0))
    assert panel.span() == pytest.approx((0.0, 1.04))
    curve.add(1.0, -3.0)
    curve.add(2.0, 7.0)
    low, high = panel.span()
    assert low < -3.0 < 7.0 < high


def test_what_was_never_heard_is_not_reported() -> None:
    assert [name for name, _ in facts(FlightSummary("empty.mcap"))] == [
        "Recorded",
        "Repeats",
        "Firmware",
    ]
