"""The page on performance is made of one run, which the programs of today could have made."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from benchmarks.program import PROGRAMS, load
from benchmarks.report import SCHEMA

FOLDER = Path(__file__).parents[2] / "docs" / "explanation"
PAGE = (FOLDER / "performance.md").read_text(encoding="utf-8")
RUN: dict[str, Any] = json.loads((FOLDER / "performance.json").read_text(encoding="utf-8"))


def test_rows_of_the_run_are_those_of_today_with_their_goals() -> None:
    """What was declared after the run waits for the next one."""
    declared = [
        (program, row.name, row.unit, row.goal.must, row.goal.aim, row.goal.is_floor)
        for program in PROGRAMS
        for row in load(program).rows
    ]
    keys = ("program", "name", "unit", "must", "aim", "is_floor")
    assert RUN["schema"] == SCHEMA
    shown = [tuple(row[key] for key in keys) for row in RUN["rows"]]
    assert shown
    assert shown == [row for row in declared if row in shown]


def test_the_page_shows_every_program() -> None:
    shown = re.findall(r"^```\{benchmark-(\w+)\} ?(\w*)$", PAGE, re.MULTILINE)
    assert ("machine", "") in shown
    assert ("rows", "") in shown
    assert {name for kind, name in shown if kind == "costs"} == set(PROGRAMS)
    assert {cost["program"] for cost in RUN["costs"]} <= set(PROGRAMS)


def test_the_run_says_when_and_on_what_and_names_no_machine() -> None:
    about = RUN["environment"]
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", about["date"])
    assert about["cpu"]
    assert about["cores"] >= 1
    assert about["python"]
    assert "/home" not in json.dumps(RUN)
    assert "/tmp" not in json.dumps(RUN)


def test_no_figure_stands_in_the_text_of_the_page() -> None:
    """Numbers that a new run would make wrong: ratios, µs, ms and percent."""
    prose = re.sub(r"^```.*?^```$", "", PAGE, flags=re.MULTILINE | re.DOTALL)
    # Two parts were measured by themselves, say so, and bear their date.
    for begin in ("Where the time of a package goes", "Some of the goals above are out of reach"):
        (table,) = re.findall(rf"^{begin}.*?(?=^## |\Z)", prose, flags=re.M | re.S)
        words = " ".join(table.split())
        assert re.search(r"\(\d{4}-\d\d-\d\d, .* not from the run above\)", words)
        prose = prose.replace(table, "")
    assert re.findall(r"\d+\.\d+|\d+ (?:µs|%|times)", prose) == []
