"""Mutation testing: does a test fail when the code says something else?

::

    nox -s mutation -- wire session link flight

A copy of the tree is changed in one place at a time (cosmic-ray makes the changes) and the tests of
that room are run. Changes that no test notices are survivors. Those that cannot matter stand with
their reason in ``tests/mutation_survivors.toml``; any other fails the session, and so does a reason
that explains nothing any more. It takes minutes to hours, so it is a session of its own.
"""

from __future__ import annotations

import ast
import json
import shlex
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import (
    MutationSpec,
    TestOutcome,
    WorkerOutcome,
    WorkItem,
    WorkResult,
)

ROOT = Path(__file__).parent.parent
EXPLAINED = Path(__file__).with_name("mutation_survivors.toml")

ROOMS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "wire": (("m100link/wire",), ("tests/wire",)),
    "session": (("m100link/session",), ("tests/session",)),
    "link": (("m100link/link",), ("tests/link", "-m", "not pty")),
    "flight": (
        (
            "m100link/flight/control.py",
            "m100link/flight/lifecycle.py",
            "m100link/flight/setpoints.py",
            "m100link/flight/signals.py",
        ),
        ("tests/flight", "-m", "not pty"),
    ),
}
"""Room: the code that is changed, and what pytest runs for each change."""

PER_PLACE = 2  # of the dozen other operators that one can become, so many tell enough


@dataclass(frozen=True, slots=True)
class Survivor:
    """A change that no test noticed."""

    module: str
    operator: str
    line: int
    source: str

    def __str__(self) -> str:
        return f"{self.module}:{self.line}: {self.operator}: {self.source}"


def ignored_lines(path: Path) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Spans in which a change means nothing: annotations, which nobody evaluates."""
    spans = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        for name in ("annotation", "returns"):
            found = getattr(node, name, None)
            if isinstance(found, ast.expr):
                start = (found.lineno, found.col_offset)
                spans.append((start, (found.end_lineno or 0, found.end_col_offset or 0)))
    return spans


def choose(items: list[WorkItem], tree: Path) -> set[str]:
    """Ids of the changes that are worth a run."""
    annotations = {
        str(m.module_path): ignored_lines(tree / m.module_path) for m in mutations(items)
    }
    per_place: dict[tuple[str, str, tuple[int, int]], int] = defaultdict(int)
    chosen = set()
    for item in items:
        (mutation,) = item.mutations
        module, place = str(mutation.module_path), tuple(mutation.start_pos)
        if any(start <= place < end for start, end in annotations[module]):
            continue
        kind = mutation.operator_name.split("_")[0]
        key = (module, kind, (place[0], place[1]))
        per_place[key] += 1
        if per_place[key] <= PER_PLACE:
            chosen.add(item.job_id)
    return chosen


def mutations(items: list[WorkItem]) -> list[MutationSpec]:
    """The one change of each item."""
    return [item.mutations[0] for item in items]


def run(room: str) -> list[Survivor]:
    """Change the code of a room everywhere; returns what no test noticed."""
    code, tests = ROOMS[room]
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns(".*", "_build", "__pycache__"))
        command = shlex.join([sys.executable, "-m", "pytest", "-qxp", "no:cacheprovider", *tests])
        config, session = Path(folder) / "config.toml", Path(folder) / "session.sqlite"
        config.write_text(
            f"""[cosmic-ray]
module-path = {json.dumps(code)}
timeout = 120.0
excluded-modules = []
test-command = {json.dumps(command)}
[cosmic-ray.distributor]
name = "local"
""",
            encoding="utf-8",
        )
        cosmic_ray = [str(Path(sys.executable).with_name("cosmic-ray"))]
        subprocess.run([*cosmic_ray, "init", str(config), str(session)], cwd=tree, check=True)
        with use_db(session, WorkDB.Mode.open) as jobs:
            items = list(jobs.work_items)
            chosen = choose(items, tree)
            for item in items:
                if item.job_id not in chosen:
                    jobs.set_result(item.job_id, WorkResult(WorkerOutcome.SKIPPED))
        print(f"{room}: {len(chosen)} changes of {len(items)}", flush=True)
        subprocess.run([*cosmic_ray, "baseline", str(config)], cwd=tree, check=True)
        subprocess.run([*cosmic_ray, "exec", str(config), str(session)], cwd=tree, check=True)
        with use_db(session, WorkDB.Mode.open) as jobs:
            results = dict(jobs.results)
        return [
            described(item, tree)
            for item in items
            if results[item.job_id].test_outcome is TestOutcome.SURVIVED
        ]


def described(item: WorkItem, tree: Path) -> Survivor:
    """What was changed, in words that outlive line numbers."""
    (mutation,) = item.mutations
    line = mutation.start_pos[0]
    source = (tree / mutation.module_path).read_text(encoding="utf-8").splitlines()[line - 1]
    operator = mutation.operator_name.removeprefix("core/")
    return Survivor(str(mutation.module_path), operator, line, source.strip())


def explained(rooms: list[str]) -> dict[tuple[str, str], str]:
    """Reason per module and line of source."""
    table = tomllib.loads(EXPLAINED.read_text(encoding="utf-8"))
    return {
        (entry["module"], entry["source"]): entry["reason"]
        for room in rooms
        for entry in table.get(room, [])
    }


def main(rooms: list[str]) -> int:
    """Run the rooms named, all by default."""
    rooms = rooms or list(ROOMS)
    unknown = set(rooms) - set(ROOMS)
    if unknown:
        print(f"no room is called {unknown.pop()!r}: {', '.join(ROOMS)}")
        return 2
    reasons = explained(rooms)
    survivors = [survivor for room in rooms for survivor in run(room)]
    seen = {(survivor.module, survivor.source) for survivor in survivors}
    unexplained = [s for s in survivors if (s.module, s.source) not in reasons]
    stale = [place for place in reasons if place not in seen]
    for survivor in unexplained:
        print(f"survived: {survivor}")
    for module, source in stale:
        print(f"explained, but noticed by a test: {module}: {source}")
    print(f"{len(survivors)} survivors, {len(unexplained)} of them unexplained")
    return 1 if unexplained or stale else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
