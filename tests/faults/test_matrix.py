"""The short form of the table of faults; `nox -s faults` makes the long one."""

from __future__ import annotations

import asyncio
import csv
from dataclasses import fields
from pathlib import Path

import pytest

from m100link.sim import VirtualClockEventLoop
from tests.faults.matrix import BEYOND, CASES, Outcome, run_case
from tests.faults.wire import Faults

SEED = 20151121
COMMANDS = 600
TABLE = Path(__file__).parents[2] / "docs" / "explanation" / "faults.csv"


def over_memory(case: str, faults: Faults) -> Outcome:
    print(f"seed {SEED}")  # noqa: T201 (pytest shows it when the test fails)
    with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
        return runner.run(run_case(case, faults, commands=COMMANDS, seed=SEED))


@pytest.mark.parametrize("case", CASES)
def test_commands_are_executed_once_or_reported_unknown(case: str) -> None:
    told = over_memory(case, CASES[case])
    assert told.answered + told.unknown == COMMANDS
    assert told.answered > COMMANDS / 2
    assert told.wrong == 0, told


@pytest.mark.pty
@pytest.mark.parametrize("case", ["a good line", "all of it"])
def test_the_same_over_a_terminal(case: str) -> None:
    print(f"seed {SEED}")  # noqa: T201 (pytest shows it when the test fails)
    told = asyncio.run(
        run_case(case, CASES[case], commands=COMMANDS // 2, seed=SEED, is_terminal=True)
    )
    assert told.answered + told.unknown == COMMANDS // 2
    assert told.wrong == 0, told


@pytest.mark.parametrize("case", BEYOND)
def test_what_no_cable_does_is_beyond_the_protocol_and_crosses_nothing(case: str) -> None:
    told = over_memory(case, BEYOND[case])
    assert told.twice > 0, "the limit is not one any more: tell it in the manual"
    assert (told.crossed, told.unread, told.busy) == (0, 0, 0)


def test_the_manual_shows_all_cases_and_none_of_them_failed() -> None:
    with TABLE.open(encoding="utf-8") as text:
        lines = list(csv.DictReader(text))
    assert list(lines[0]) == [one.name for one in fields(Outcome)]
    assert [(one["line"], one["case"]) for one in lines] == [
        (line, case) for line in ("memory", "pseudo-terminal") for case in CASES | BEYOND
    ]
    for one in lines:
        wrong = [one[name] for name in ("missed", "twice", "crossed", "unread", "busy")]
        assert one["case"] in BEYOND or set(wrong) == {"0"}, one
