"""The table and the JSON of the benchmarks."""

from __future__ import annotations

from typing import Any

from benchmarks import report
from benchmarks.rows import Row, at_least, at_most, times

ROW = Row("row, theirs ÷ ours", times("ours", 1.0), at_least(10, 11))


def made(**more: Any) -> dict[str, Any]:
    return report.row_result("frames", ROW, [10.5, 10.25, 10.75], None, None) | more


def test_a_row_has_goal_median_quartiles_and_verdict() -> None:
    assert made() == {
        "program": "frames",
        "name": "row, theirs ÷ ours",
        "unit": "",
        "must": 10,
        "aim": 11,
        "is_floor": True,
        "rounds": 3,
        "now": {"median": 10.5, "low": 10.38, "high": 10.62},
        "before": None,
        "verdict": "must",
        "missing": None,
    }


def test_a_row_without_figures_says_why() -> None:
    found = report.row_result("frames", ROW, [], None, "no C compiler")
    assert found["now"] is None
    assert report.cells(found)[-1] == "not measured: no C compiler"


def test_costs_are_reported_in_the_unit_that_fits() -> None:
    def unit(seconds: float) -> tuple[str, float]:
        found = report.cost_result("frames", "decode", "s", [seconds], None)
        return found["unit"], found["now"]["median"]

    assert unit(2.5e-7) == ("ns", 250)
    assert unit(2.5e-6) == ("µs", 2.5)
    assert unit(0.0025) == ("ms", 2.5)
    assert unit(2.5) == ("s", 2.5)
    assert unit(2.5e-10) == ("ns", 0.25)
    assert unit(0.0) == ("s", 0.0)
    bytes_ = report.cost_result("consumer", "a kept sample, bytes", "", [229.0], [230.0])
    assert (bytes_["unit"], bytes_["now"]["median"], bytes_["before"]["median"]) == ("", 229, 230)


def test_the_environment_names_no_machine() -> None:
    found = report.environment()
    assert found.keys() == {
        *("date", "cpu", "cores", "system", "python", "compiler", "pymavlink", "fastcrc", "load"),
        *("commit", "before"),
    }
    assert "/" not in "".join(map(str, found.values()))


def test_the_table_has_the_other_tree_only_where_one_was_measured() -> None:
    alone = report.table(report.result([made()], []))
    beside = report.table(
        report.result([made(before={"median": 6.8, "low": 6.7, "high": 6.9})], [])
    )
    assert "before" not in alone.splitlines()[-2]
    assert "6.80  6.70 to 6.90" in beside
    assert "10.5  10.4 to 10.6  must" in beside


def test_the_columns_of_the_table_stand_below_each_other() -> None:
    slow = report.row_result(
        "frames", Row("short", times("ours", 1.0), at_most(0.5)), [123.0], None, None
    )
    head, first, second = report.table(report.result([made(), slow], [])).splitlines()[-3:]
    assert first.index("≥ 10") + 4 == second.index("≤ 0.5") + 5 == head.index("must") + 4
    assert second.endswith("missed")
