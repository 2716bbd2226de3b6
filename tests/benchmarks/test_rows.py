"""Quartiles, goals, costs: the arithmetic of the benchmarks."""

from __future__ import annotations

import time

import pytest

from benchmarks.rows import (
    Absent,
    Costs,
    Goal,
    NotMeasured,
    Setting,
    Side,
    at_least,
    at_most,
    beside_today,
    percentile,
    quartiles,
    ratio,
    timed,
    times,
)


def test_quartiles_are_interpolated_between_the_values() -> None:
    assert quartiles([5, 1, 4, 2, 3]) == (3, 2, 4)
    assert quartiles([1, 2, 3, 4]) == (2.5, 1.75, 3.25)
    assert quartiles([7]) == (7, 7, 7)


def test_quartiles_of_nothing_are_an_error() -> None:
    with pytest.raises(TypeError):
        quartiles([])


def test_percentile_is_a_value_that_was_seen() -> None:
    values = [float(n) for n in range(100, 0, -1)]
    assert percentile(values, 0.5) == 51
    assert percentile(values, 0.99) == 100
    assert percentile(values, 1.0) == 100
    assert percentile([3.0], 0.99) == 3


@pytest.mark.parametrize(
    ("goal", "figure", "verdict"),
    [
        (at_least(10, 11), 11.0, "aim"),
        (at_least(10, 11), 10.0, "must"),
        (at_least(10, 11), 9.99, "missed"),
        (at_most(0.85, 0.65), 0.65, "aim"),
        (at_most(0.85, 0.65), 0.85, "must"),
        (at_most(0.85, 0.65), 0.86, "missed"),
        (at_most(0.35), 0.1, "must"),
        (Goal(), 1.0, ""),
    ],
)
def test_a_figure_is_held_against_its_goal(goal: Goal, figure: float, verdict: str) -> None:
    assert goal.verdict(figure) == verdict


def test_a_ratio_is_made_of_the_costs_of_one_round() -> None:
    costs = Costs({"ours": 2.0}, {"theirs": 6.0}, today={"ours": 4.0})
    assert ratio("theirs", "ours")(costs) == 3.0
    assert beside_today("ours")(costs) == 0.5
    assert times("ours", 1e3)(costs) == 2000.0


def test_a_missing_cost_says_why() -> None:
    costs = Costs({"ours": 2.0}, {}, absent={"floor": "no C compiler"})
    with pytest.raises(NotMeasured, match="no C compiler"):
        costs["floor"]
    with pytest.raises(NotMeasured, match="'theirs' was not measured"):
        ratio("theirs", "ours")(costs)
    with pytest.raises(NotMeasured, match="--beside"):
        beside_today("ours")(costs)


def test_a_side_with_several_figures_names_each() -> None:
    assert Side("pty", lambda: {"cpu": 1.0, "p50": 2.0}).costs() == {"pty, cpu": 1.0, "pty, p50": 2}
    assert Side("decode", lambda: 3.0).costs() == {"decode": 3.0}


def test_what_is_timed_is_cpu_time_of_this_thread_and_not_waiting() -> None:
    def work() -> int:
        time.sleep(0.05)
        return 5

    assert timed("asleep", 5, work).costs()["asleep"] < 0.005


def test_what_is_timed_is_checked() -> None:
    with pytest.raises(RuntimeError, match="lost: 4 of 5 came through"):
        timed("lost", 5, lambda: 4).costs()


def test_a_quick_run_does_little_and_never_nothing() -> None:
    assert Setting().count(3000) == 3000
    assert Setting(is_quick=True).count(3000) == 30
    assert Setting(is_quick=True).count(100) == 4
    assert Setting(is_quick=True).seconds(10.0) < Setting().seconds(10.0)


def test_what_is_absent_has_a_reason() -> None:
    assert Absent("floor", "no C compiler").reason
