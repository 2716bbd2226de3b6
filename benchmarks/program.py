"""How a benchmark program runs: its options, its rounds, and the process for another tree."""

from __future__ import annotations

import argparse
import importlib
import json
import os
import random
import subprocess
import sys
import traceback
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol

from benchmarks import report
from benchmarks.rows import (
    QUICK_ROUNDS,
    Absent,
    Costs,
    NotMeasured,
    Program,
    Row,
    Setting,
    Side,
    UnknownName,
    belongs,
)

SEED = 2015
PROGRAMS = (
    *("frames", "hostile", "consumer", "fleet", "imports", "virtual_aircraft", "station"),
    *("request", "hop", "ticks", "console", "replay", "ros2"),
)
ROOT = Path(__file__).parent.parent

# The package comes from the other tree, what measures it from this one.
BOOT = """
import sys
tree, here, *rest = sys.argv[1:]
sys.path.insert(0, tree)
import m100link
assert m100link.__file__.startswith(tree), m100link.__file__
sys.path.insert(0, here)
from benchmarks.program import serve
serve(*rest)
"""


# -- where sides run -------------------------------------------------------------------------------


class Place(Protocol):
    """Sides that are ready to run.

    Attributes:
        names: Of the sides.
        absent: Why others are not there.
        untimed: Names of sides whose costs are not seconds.
    """

    names: list[str]
    absent: dict[str, str]
    untimed: list[str]

    def run(self, name: str) -> dict[str, float]:
        """Costs of one side; may raise :class:`NotMeasured`."""
        ...


class Here:
    """Sides in this process."""

    def __init__(self, prepared: Iterable[Side | Absent]) -> None:
        self._sides: dict[str, Side] = {}
        self.absent: dict[str, str] = {}
        for one in prepared:
            if isinstance(one, Side):
                self._sides[one.name] = one
            else:
                self.absent[one.name] = one.reason
        self.names = list(self._sides)
        self.untimed = [side.name for side in self._sides.values() if not side.is_time]

    def run(self, name: str) -> dict[str, float]:
        """See :class:`Place`."""
        return self._sides[name].costs()


class There:
    """Our sides in a process of their own, with the package of one tree.

    Args:
        program: Whose sides.
        setting: What was asked for.
        tree: The checkout.
        stack: Ends the process.
        is_judged: Whether a side that fails ends the program; in a tree of another age it is a
            side that is missing.
    """

    def __init__(
        self, program: str, setting: Setting, tree: Path, stack: ExitStack, *, is_judged: bool
    ) -> None:
        self._tree, self._is_judged = tree.name, is_judged
        environment = {**os.environ, "PYTHONPATH": str(tree)}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        options = json.dumps(asdict(setting))
        self._process = stack.enter_context(
            subprocess.Popen(
                [sys.executable, "-P", "-c", BOOT, str(tree), str(ROOT), program, options],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                cwd=tree,  # `python -m m100link` looks there first
                env=environment,
            )
        )
        stack.callback(self._close)
        self.names: list[str] = []
        self.absent: dict[str, str] = {}
        self.untimed: list[str] = []
        found = self._read()
        self.names, self.absent, self.untimed = found["names"], found["absent"], found["untimed"]

    def run(self, name: str) -> dict[str, float]:
        """See :class:`Place`."""
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):
            print(json.dumps(name), file=self._process.stdin, flush=True)
        found = self._read()
        if "missing" in found:
            raise NotMeasured(found["missing"])
        if "failed" in found:
            why = f"in {self._tree}: {found['failed']}"
            raise RuntimeError(why) if self._is_judged else NotMeasured(why)
        costs: dict[str, float] = found["costs"]
        return costs

    def _close(self) -> None:
        """The end of its input, at which it ends, unless it has ended before it read everything."""
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):
            self._process.stdin.close()

    def _read(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:  # what went wrong stands in its error output
            raise NotMeasured(f"the process with {self._tree} ended: {self._process.wait()}")
        found: dict[str, Any] = json.loads(line)
        return found


def serve(name: str, options: str) -> None:
    """What a :class:`There` starts: prepares our sides and runs those whose names it reads."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # whatever else is printed is no answer
    program = load(name)
    with pinned(program), ExitStack() as stack:
        place = Here(program.ours(Setting(**json.loads(options)), stack))
        found = {"names": place.names, "absent": place.absent, "untimed": place.untimed}
        print(json.dumps(found), file=answers, flush=True)
        for line in sys.stdin:
            try:
                answer: dict[str, Any] = {"costs": place.run(json.loads(line))}
            except NotMeasured as reason:
                answer = {"missing": str(reason)}
            except (AttributeError, ImportError, TypeError) as error:  # what another age has not
                traceback.print_exc()
                answer = {"failed": f"{type(error).__name__}: {error}"}
            print(json.dumps(answer), file=answers, flush=True)


@contextmanager
def pinned(program: Program) -> Iterator[None]:
    """Keep this process to one CPU, where the program wants it and the system can."""
    if not program.is_pinned or not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(before)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


# -- rounds ----------------------------------------------------------------------------------------


class _Wanted(Costs):
    """Notes what a row asks for."""

    def __init__(self) -> None:
        super().__init__({}, {})
        self.names: set[str] = set()

    @property
    def today(self) -> Costs:
        return self

    def __getitem__(self, name: str) -> float:
        self.names.add(name)
        return 1.0


def costs_of(row: Row) -> set[str]:
    """Names of the costs that a row is made of."""
    wanted = _Wanted()
    row.figure(wanted)
    return wanted.names


class Rounds:
    """All costs of all rounds, by place."""

    PLACES = ("ours", "others", "before")

    def __init__(self, places: dict[str, Place], rounds: int, wanted: set[str] | None) -> None:
        dice = random.Random(SEED)
        self._places = places
        self._found: list[dict[str, dict[str, float]]] = []
        self._absent: list[dict[str, str]] = []
        turns = [
            (kind, name)
            for kind, place in places.items()
            for name in place.names
            if wanted is None or any(belongs(cost, name) for cost in wanted)
        ]
        for _ in range(rounds):
            costs: dict[str, dict[str, float]] = {kind: {} for kind in places}
            absent = {name: why for place in places.values() for name, why in place.absent.items()}
            for kind, name in dice.sample(turns, len(turns)):
                try:
                    costs[kind] |= places[kind].run(name)
                except NotMeasured as reason:
                    absent[name] = str(reason)
            self._found.append(costs)
            self._absent.append(absent)

    def figures(self, row: Row, kind: str) -> tuple[list[float], str | None]:
        """A row's figure in each round that has one, and why others have none."""
        figures, missing = [], None
        for costs, absent in zip(self._found, self._absent, strict=True):
            before = costs.get("before")
            ours = costs[kind]
            try:
                figures.append(
                    row.figure(Costs(ours, costs["others"], today=before, absent=absent))
                )
            except NotMeasured as reason:
                missing = str(reason)
        return figures, missing

    def costs(self, program: str) -> Iterable[dict[str, Any]]:
        """Every cost over the rounds."""
        for kind in ("ours", "others"):
            names = dict.fromkeys(name for costs in self._found for name in costs[kind])
            for name in names:
                is_time = not any(belongs(name, side) for side in self._places[kind].untimed)
                now, before = (
                    [costs[k][name] for costs in self._found if name in costs.get(k, {})]
                    for k in (kind, "before")
                )
                yield report.cost_result(program, name, "s" if is_time else "", now, before or None)


def measure(
    program: Program,
    setting: Setting,
    *,
    rounds: int | None = None,
    beside: Path | None = None,
    rows: Sequence[Row] | None = None,
) -> dict[str, Any]:
    """Run a program and return its part of the result.

    Args:
        program: Which.
        setting: What was asked for.
        rounds: How many; None: as the program has it.
        beside: Another checkout, for the column "before".
        rows: Only these, and only the sides that they need; None: all.
    """
    wanted = None if rows is None else set().union(*map(costs_of, rows))
    count = rounds or (QUICK_ROUNDS if setting.is_quick else program.rounds)
    with pinned(program), ExitStack() as stack:
        places: dict[str, Place] = {}
        if beside is None:
            places["ours"] = Here(program.ours(setting, stack))
        else:
            places["ours"] = There(program.name, setting, ROOT, stack, is_judged=True)
            with suppress(NotMeasured):  # a tree of another age; its process has said why
                tree = beside.resolve()
                places["before"] = There(program.name, setting, tree, stack, is_judged=False)
        places["others"] = Here(program.others(setting, stack))
        found = Rounds(places, count, wanted)
    lines = []
    for row in program.rows if rows is None else rows:
        figures, missing = found.figures(row, "ours")
        before = found.figures(row, "before")[0] if "before" in places else None
        lines.append(report.row_result(program.name, row, figures, before or None, missing))
    return report.result(lines, found.costs(program.name), before=beside)


# -- the command line ------------------------------------------------------------------------------


def load(name: str) -> Program:
    """A program by the name of its module."""
    if name not in PROGRAMS:
        raise UnknownName(f"there is no program {name!r}; there are {', '.join(PROGRAMS)}")
    found = importlib.import_module(f"benchmarks.{name}").PROGRAM
    assert isinstance(found, Program)
    return found


def choose(names: Sequence[str], rows: Iterable[Row]) -> list[Row] | None:
    """Rows by name, None for all when no name is given."""
    known = {row.name: row for row in rows}
    unknown = [name for name in names if name not in known]
    if unknown:
        raise UnknownName(
            f"there is no row {unknown[0]!r}; there are:\n  " + "\n  ".join(sorted(known))
        )
    return [known[name] for name in dict.fromkeys(names)] or None


def options(text: str | None, names: str) -> argparse.ArgumentParser:
    """The options that every program has."""
    parser = argparse.ArgumentParser(description=(text or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar=names, help="only these; all by default")
    parser.add_argument("--rounds", type=int, help="how often; each program has its own default")
    parser.add_argument("--quick", action="store_true", help="show that it works, measure nothing")
    parser.add_argument("--json", action="store_true", help="one JSON object instead of the table")
    parser.add_argument("--beside", type=Path, metavar="TREE", help="another checkout: `before`")
    parser.add_argument("--codec", metavar="COMMAND", help="a decoder in another language")
    return parser


def main(program: Program, arguments: Sequence[str] | None = None) -> None:
    """Run one program as the command line asks."""
    parser = options(sys.modules[program.ours.__module__].__doc__, "ROW")
    asked = parser.parse_args(arguments)
    try:
        rows = choose(asked.names, program.rows)
    except UnknownName as error:
        parser.error(str(error))
    found = measure(
        program,
        Setting(is_quick=asked.quick, codec=asked.codec),
        rounds=asked.rounds,
        beside=asked.beside,
        rows=rows,
    )
    print(json.dumps(found, indent=1) if asked.json else report.table(found))
