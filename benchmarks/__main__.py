"""All benchmarks, one after the other, and one table in the end.

    python -m benchmarks [PROGRAM | ROW …] [--rounds N] [--json] [--quick] [--beside TREE]

Each program runs in a process of its own. One that fails leaves its rows unmeasured and the others
as they are; the exit status is 1 then. No figure makes it fail. ``--rounds`` makes fewer rounds
of a program than it has by default, never more.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from typing import Any

from benchmarks import report
from benchmarks.program import PROGRAMS, ROOT, choose, load, options
from benchmarks.rows import Program, Row, UnknownName

PATIENCE_S = 1800  # for one program; a machine that is busy is no reason to give up


def wanted(names: Sequence[str]) -> list[tuple[Program, list[Row] | None]]:
    """Programs and their rows by names of either; all without a name. None: every row."""
    programs = [load(name) for name in PROGRAMS]
    whole = {program.name for program in programs} & set(names)
    rows = choose([n for n in names if n not in whole], [r for p in programs for r in p.rows])
    found: list[tuple[Program, list[Row] | None]] = []
    for program in programs:
        chosen = [row for row in rows or () if row in program.rows]
        if not names or program.name in whole:
            found.append((program, None))
        elif chosen:
            found.append((program, chosen))
    return found


def run(program: Program, rows: list[Row] | None, asked: argparse.Namespace) -> dict[str, Any]:
    """The result of one program; what ended otherwise has rows that say so."""
    command = [sys.executable, "-m", f"benchmarks.{program.name}", "--json"]
    command += [row.name for row in rows or ()]
    rounds = None if asked.rounds is None else min(asked.rounds, program.rounds)
    for option, value in (("rounds", rounds), ("beside", asked.beside), ("codec", asked.codec)):
        command += [] if value is None else [f"--{option}", str(value)]
    command += ["--quick"] if asked.quick else []
    try:
        ended = subprocess.run(
            command, stdout=subprocess.PIPE, cwd=ROOT, timeout=PATIENCE_S, check=True
        )
        found: dict[str, Any] = json.loads(ended.stdout)
    except subprocess.TimeoutExpired:
        missing = f"the program had not ended after {PATIENCE_S} s"
    except subprocess.CalledProcessError as error:
        missing = f"the program ended with status {error.returncode}"
    else:
        return found
    chosen = program.rows if rows is None else rows
    return report.result(
        [report.row_result(program.name, row, [], None, missing) for row in chosen], []
    ) | {"failed": missing}


def run_all(arguments: Sequence[str] | None = None) -> int:
    """What ``python -m benchmarks`` does; returns its exit status."""
    parser = options(__doc__, "NAME")
    asked = parser.parse_args(arguments)
    try:
        programs = wanted(asked.names)
    except UnknownName as error:
        parser.error(str(error))
    results = []
    for program, rows in programs:
        print(f"{program.name} …", file=sys.stderr, flush=True)
        results.append(run(program, rows, asked))
    whole = report.result(
        [row for one in results for row in one["rows"]],
        [cost for one in results for cost in one["costs"]],
        before=asked.beside,
    )
    print(json.dumps(whole, indent=1) if asked.json else report.table(whole))
    return int(any("failed" in one for one in results))


if __name__ == "__main__":
    sys.exit(run_all())
