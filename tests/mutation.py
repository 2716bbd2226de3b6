"""Mutation testing: does a test fail when the code says something else?

::

    nox -s mutation -- wire session link flight
    nox -s mutation -- flight --module guards.py
    nox -s mutation -- flight --sample 100 --seed 7

The code of a room is changed in one place at a time, and the tests that run the changed line are
run against it, those of the mirrored test file first. Changes that no test notices are survivors.
Those that cannot matter stand with their reason in ``tests/mutation_survivors.toml``; any other
fails the session, and so does a reason that explains nothing any more.

cosmic-ray makes the changes; no file is written. Tests that start programs of their own see no
change: those marked ``pty`` are left out, but for the link's.
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import sys
import tempfile
import tomllib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from hypothesis import Phase, settings

from tests.mutation_changes import ROOT, Change, changes_of, text_of
from tests.mutation_trials import Trials

EXPLAINED = Path(__file__).with_name("mutation_survivors.toml")

FLIGHT = (
    "control steering block lifecycle setpoints signals stop_path cancellation watchdog orbit "
    "pacing guards known handover authority tasks loops path"
)


def files_of(room: str) -> tuple[str, ...]:
    """The code of a whole room."""
    found = (ROOT / "m100link" / room).glob("*.py")
    return tuple(sorted(str(path.relative_to(ROOT)) for path in found if path.stem != "__init__"))


ROOMS: dict[str, tuple[str, ...]] = {
    **{room: files_of(room) for room in ("wire", "session", "link")},
    "flight": tuple(f"m100link/flight/{name}.py" for name in FLIGHT.split()),
}
"""Room: the code that is changed. Its tests are those of the folder of the same name."""

# -- what is explained -----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Explanation:
    """Why no test needs to notice a change of a line.

    Attributes:
        module: The file.
        source: The line, without its indentation.
        within: The function that is meant, where the line stands in several; "" means all.
        operators: Beginnings of the names of the operators that are meant; () means all.
        reason: For a reader.
    """

    module: str
    source: str
    within: str
    operators: tuple[str, ...]
    reason: str

    def fits(self, change: Change) -> bool:
        """Whether it speaks of that change."""
        return (
            (change.module, change.source) == (self.module, self.source)
            and self.within in ("", change.function)
            and (not self.operators or change.operator.startswith(self.operators))
        )

    def stands(self) -> bool:
        """Whether the line is still there."""
        return any(line.strip() == self.source for line in text_of(self.module).splitlines())


def explanations(room: str) -> list[Explanation]:
    """The list of a room, one per line of code."""
    table = tomllib.loads(EXPLAINED.read_text(encoding="utf-8"))
    return [
        Explanation(
            entry["module"],
            source,
            entry.get("within", ""),
            tuple(entry.get("operators", ())),
            entry["reason"],
        )
        for entry in table.get(room, [])
        for source in entry["lines"]
    ]


# -- the whole -------------------------------------------------------------------------------------


def run(room: str, arguments: argparse.Namespace) -> bool:
    """Try a room and say what was seen. Returns whether nothing is left to explain."""
    modules = [name for name in ROOMS[room] if arguments.module in name]
    changes = [change for module in modules for change in changes_of(module)]
    print(f"{room}: {len(changes)} changes", end="")
    if arguments.sample:
        changes = random.Random(arguments.seed).sample(changes, min(arguments.sample, len(changes)))
        print(f", {len(changes)} of them chosen by seed {arguments.seed}", end="")
    print(flush=True)
    known = explanations(room)
    survivors: list[Change] = []

    def on_end(change: Change, was_noticed: bool) -> None:
        if not was_noticed:
            survivors.append(change)
            if not any(explanation.fits(change) for explanation in known):
                print(f"unexplained: {change}", flush=True)

    with tempfile.TemporaryDirectory() as folder:
        trials = Trials(f"tests/{room}", Path(folder))
        kept = f"{arguments.record}-{room}.json" if arguments.record else f"{folder}/record"
        trials.record(ROOMS[room], Path(kept))
        trials.try_all(changes, on_end)
    return report(room, changes, survivors, known, is_whole=not arguments.sample)


def report(
    room: str,
    tried: list[Change],
    survivors: list[Change],
    known: list[Explanation],
    *,
    is_whole: bool,
) -> bool:
    """The figures of a room, and what its list says in vain."""
    unexplained = [
        change for change in survivors if not any(reason.fits(change) for reason in known)
    ]
    modules = {change.module for change in tried}
    vain = 0
    for reason in known:
        if not reason.stands():
            print(f"explained, but no such line: {reason.module}: {reason.source}")
        elif is_whole and any(map(reason.fits, tried)) and not any(map(reason.fits, survivors)):
            print(f"explained, but noticed by a test now: {reason.module}: {reason.source}")
        else:
            continue
        vain += 1
    counts = Counter(change.module for change in tried)
    lived = Counter(change.module for change in survivors)
    for module in sorted(modules):
        print(f"  {module}: {counts[module]} tried, {lived[module]} survived")
    killed = len(tried) - len(survivors)
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(
        f"{room}: {killed} of {len(tried)} changes noticed ({killed / max(1, len(tried)):.1%}), "
        f"{len(survivors)} survived, {len(unexplained)} of them unexplained; "
        f"{spent.ru_utime + spent.ru_stime:.0f} s of the processor so far",
        flush=True,
    )
    return not unexplained and not vain


def prepare() -> None:
    """Import what every try needs but the project, and make chance repeat itself."""
    for name in ("anyio", "cryptography.hazmat.primitives.ciphers", "serial_asyncio", "uvicorn"):
        __import__(name)
    # No test may pass by luck where it failed before, and a failure need not be made small.
    phases = (Phase.explicit, Phase.generate)
    settings.register_profile(
        "mutation", deadline=None, max_examples=60, derandomize=True, database=None, phases=phases
    )
    os.environ["HYPOTHESIS_PROFILE"] = "mutation"
    os.chdir(ROOT)


def main() -> int:
    """Run the rooms named, all by default."""
    parser = argparse.ArgumentParser(prog="nox -s mutation --", description=__doc__)
    parser.add_argument("rooms", nargs="*", choices=[*ROOMS, []], help="all by default")
    parser.add_argument("--module", default="", help="only files whose path contains this")
    parser.add_argument("--sample", type=int, default=0, help="try so many changes per room")
    parser.add_argument("--seed", type=int, default=0, help="which ones a sample has")
    parser.add_argument(
        "--record", help="keep at this path, for the next run of the same code, what runs what"
    )
    arguments = parser.parse_args()
    prepare()
    results = [run(room, arguments) for room in arguments.rooms or ROOMS]
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
