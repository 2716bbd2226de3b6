"""How benchmark programs run: rounds, rows by name, another tree, and all of them at once."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from benchmarks import __main__ as everything
from benchmarks import program as frame
from benchmarks.program import PROGRAMS, costs_of, load, measure
from benchmarks.rows import (
    Absent,
    Costs,
    NotMeasured,
    Program,
    Row,
    Setting,
    Side,
    at_most,
    beside_today,
    ratio,
)

ROOT = Path(__file__).parents[2]
ROW_KEYS = {
    *("program", "name", "unit", "must", "aim", "is_floor", "rounds", "now", "before", "verdict"),
    "missing",
}


class Contest:
    """Two sides whose costs are known; the second fails in its second round."""

    def __init__(self) -> None:
        self.runs: list[str] = []

    def ours(self, setting: Setting, stack: ExitStack) -> Iterable[Side]:
        def run() -> float:
            self.runs.append("ours")
            return 2.0

        yield Side("ours", run)

    def others(self, setting: Setting, stack: ExitStack) -> Iterable[Side | Absent]:
        def run() -> dict[str, float]:
            self.runs.append("theirs")
            if self.runs.count("theirs") == 2:
                raise NotMeasured("the line was too slow")
            return {"cpu": float(self.runs.count("theirs"))}

        yield Side("theirs", run)
        yield Absent("floor", "no C compiler")

    def program(self) -> Program:
        return Program(
            "contest",
            (
                Row("ours ÷ theirs", ratio("ours", "theirs, cpu"), at_most(1.0)),
                Row("ours ÷ floor", ratio("ours", "floor")),
                Row("ours ÷ today's", beside_today("ours")),
            ),
            self.ours,
            self.others,
        )


def test_rows_have_the_figures_of_all_rounds_that_have_one() -> None:
    contest = Contest()
    found = measure(contest.program(), Setting(), rounds=4)
    against, floor, today = found["rows"]
    # 2 divided by 1, 3 and 4: the second round has none, and says why.
    assert against["rounds"] == 3
    assert against["now"]["median"] == pytest.approx(2 / 3, rel=1e-3)
    assert against["verdict"] == "must"
    assert against["missing"] == "the line was too slow"
    assert (floor["now"], floor["missing"]) == (None, "no C compiler")
    assert (today["now"], today["missing"]) == (None, "needs another tree: --beside")
    assert contest.runs.count("ours") == contest.runs.count("theirs") == 4


def test_only_the_sides_of_the_wanted_rows_run() -> None:
    contest = Contest()
    program = contest.program()
    found = measure(program, Setting(), rounds=3, rows=program.rows[1:2])
    assert [row["name"] for row in found["rows"]] == ["ours ÷ floor"]
    assert contest.runs == ["ours"] * 3


def test_the_costs_of_a_row_are_found_without_measuring() -> None:
    def figure(costs: Costs) -> float:
        return (costs["a"] - costs.today["b"]) / 3

    assert costs_of(Row("difference", figure)) == {"a", "b"}


def test_the_sides_of_a_round_run_in_changing_order() -> None:
    contest = Contest()
    measure(contest.program(), Setting(), rounds=6)
    pairs = {tuple(contest.runs[at : at + 2]) for at in range(0, 12, 2)}
    assert pairs == {("ours", "theirs"), ("theirs", "ours")}


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system pins nobody")
def test_the_process_is_pinned_only_while_it_measures() -> None:
    before = os.sched_getaffinity(0)
    seen = []

    def run() -> float:
        seen.append(len(os.sched_getaffinity(0)))
        return 1.0

    for is_pinned in (True, False):
        program = Program("one", (), lambda *_: [Side("one", run)], is_pinned=is_pinned)
        measure(program, Setting(), rounds=1)
    assert seen == [1, len(before)]
    assert os.sched_getaffinity(0) == before


def test_a_row_that_does_not_exist_is_an_error_that_names_those_that_do(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit) as ended:
        frame.main(Contest().program(), ["ours ÷ nobody"])
    assert ended.value.code == 2
    told = capsys.readouterr().err
    assert "there is no row 'ours ÷ nobody'" in told
    assert "ours ÷ floor" in told


def test_a_program_that_does_not_exist_is_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        everything.run_all(["fames"])
    assert ended.value.code == 2
    assert "'fames'" in capsys.readouterr().err


def test_programs_and_rows_can_be_asked_for_by_name() -> None:
    [(program, rows)] = everything.wanted(["frames"])
    assert (program.name, rows) == ("frames", None)
    [(program, rows)] = everything.wanted(["movement command, pymavlink ÷ ours"])
    assert program.name == "frames"
    assert [row.name for row in rows or ()] == ["movement command, pymavlink ÷ ours"]
    assert [program.name for program, _ in everything.wanted([])] == list(PROGRAMS)


def test_names_of_rows_are_unique() -> None:
    names = [row.name for name in PROGRAMS for row in load(name).rows]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("name", PROGRAMS)
def test_every_program_runs(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    program = load(name)
    frame.main(program, ["--quick", "--json"])
    found = json.loads(capsys.readouterr().out)
    assert found["schema"] == 1
    assert [row["name"] for row in found["rows"]] == [row.name for row in program.rows]
    for row in found["rows"]:
        assert row.keys() == ROW_KEYS
        assert row["now"] or row["missing"], row["name"]
    assert found["costs"]


def test_a_program_that_fails_leaves_its_rows_unmeasured_and_the_others_run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A codec that does not exist ends `frames`; `hostile` has nothing to do with it."""
    monkeypatch.setattr(everything, "ROOT", ROOT)
    status = everything.run_all(["frames", "hostile", "--quick", "--json", "--codec", "/nowhere"])
    rows: list[dict[str, Any]] = json.loads(capsys.readouterr().out)["rows"]
    by_program = {row["program"]: row for row in rows}
    assert status == 1
    assert by_program["frames"]["missing"] == "the program ended with status 1"
    assert by_program["hostile"]["now"]


def test_another_tree_is_measured_beside_in_a_process_of_its_own(
    capsys: pytest.CaptureFixture[str],
) -> None:
    row = "AES ÷ plain, decoding"
    frame.main(load("frames"), [row, "--quick", "--json", "--beside", str(ROOT)])
    [found] = json.loads(capsys.readouterr().out)["rows"]
    assert found["name"] == row
    assert found["now"]
    assert found["before"]


def test_a_tree_that_cannot_be_measured_leaves_the_column_empty(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    package = tmp_path / "m100link"
    package.mkdir()
    (package / "__init__.py").write_text("raise ImportError('of another age')")
    row = "AES ÷ plain, decoding"
    frame.main(load("frames"), [row, "--quick", "--json", "--beside", str(tmp_path)])
    [found] = json.loads(capsys.readouterr().out)["rows"]
    assert found["now"]
    assert found["before"] is None


def tree_without_setpoints(folder: Path) -> Path:
    """A checkout whose package has no :class:`Setpoint` any more, and all else of this one."""
    package = folder / "m100link"
    package.mkdir()
    (package / "__init__.py").write_text(
        f"__path__ = [{str(ROOT / 'm100link')!r}]\n"
        "from m100link.protocol import Setpoint\n"
        "del Setpoint.velocity\n"
    )
    return folder


def test_a_side_that_another_tree_does_not_have_leaves_its_other_sides_measured(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """One of the rows asked for has no setpoint in the older tree, which costs that row alone."""
    rows = ["movement command, pymavlink ÷ ours", "AES ÷ plain, decoding"]
    beside = tree_without_setpoints(tmp_path)
    frame.main(load("frames"), [*rows, "--quick", "--json", "--beside", str(beside)])
    output = capfd.readouterr()
    costs = {cost["name"]: cost for cost in json.loads(output.out)["costs"]}
    assert costs["movement command"]["now"]
    assert costs["movement command"]["before"] is None
    assert costs["decode, one frame per feed"]["before"]
    assert costs["decode AES, one frame per feed"]["before"]
    assert "AttributeError" in output.err


def test_a_side_that_fails_in_the_tree_that_is_judged_ends_the_program(tmp_path: Path) -> None:
    with ExitStack() as stack:
        tree = tree_without_setpoints(tmp_path)
        place = frame.There("frames", Setting(is_quick=True), tree, stack, is_judged=True)
        with pytest.raises(RuntimeError, match=r"AttributeError.*velocity"):
            place.run("movement command")
        assert place.run("encode 118 bytes")["encode 118 bytes"] > 0
