"""Mutation testing: does a test fail when the code says something else?

::

    nox -s mutation -- wire session link flight
    nox -s mutation -- flight --module guards.py
    nox -s mutation -- flight --sample 100 --seed 7
    nox -s mutation -- sim/vehicle geodesy --own --sample 60

A room is a folder of the package, with all below it, or a file that stands in no folder. Its code
is changed in one place at a time, and the tests that run the changed line are run against it, those
of the mirrored test file first. Changes that no test notices are survivors. Those that cannot
matter stand with their reason in ``tests/mutation_survivors.toml``; any other fails the session,
and so does a reason that explains nothing any more.

cosmic-ray makes the changes; no file is written. Programs and browsers that tests start see no
change: those tests are left out, but for the link's, and counted. A sample leaves out the slow
tests, too: what it counts as noticed, `nox` notices.
"""

from __future__ import annotations

import argparse
import math
import os
import random
import resource
import sys
import tempfile
import tomllib
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from hypothesis import Phase, settings

from tests import speeds
from tests.mutation_changes import ROOT, Change, changes_of, text_of
from tests.mutation_trials import ELSEWHERE, Trials, mirrored, own_files
from tests.test_house import PACKAGE, programs

EXPLAINED = Path(__file__).with_name("mutation_survivors.toml")

UNSEEING = tuple(f"tests/{folder}/" for folder in ELSEWHERE)
"""Folders of tests that see no change."""

# -- rooms -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Room:
    """Code that is changed, and its tests.

    Attributes:
        name: Its path in the package, without ``.py``.
    """

    name: str

    @cached_property
    def modules(self) -> tuple[str, ...]:
        """Its files."""
        place = PACKAGE / self.name
        found = sorted(place.rglob("*.py")) if place.is_dir() else [place.with_suffix(".py")]
        return tuple(str(path.relative_to(ROOT)) for path in found)

    @cached_property
    def tests(self) -> tuple[str, ...]:
        """Folders and files of tests: the folder of its name, and what stands elsewhere."""
        own = f"tests/{self.name}"
        folder = {own} if (ROOT / own).is_dir() else set()
        return tuple(
            sorted(folder | {n for n in own_tests(self.modules) if not n.startswith(f"{own}/")})
        )

    @cached_property
    def elsewhere(self) -> list[str]:
        """Files whose own tests need a browser, or programs of others."""
        return [module for module in self.modules if mirrored(module).startswith(UNSEEING)]


def own_tests(modules: Iterable[str]) -> set[str]:
    """Test files of the modules themselves."""
    found = {name for module in modules for name in own_files(module)}
    return {name for name in found if not name.startswith(UNSEEING)}


def rooms() -> dict[str, Room]:
    """Every room of the package by name; those inside another one have a slash in theirs."""
    paths = [path.relative_to(PACKAGE) for path in programs("m100link")]
    folders = {str(parent) for path in paths for parent in path.parents} - {"."}
    loose = {path.stem for path in paths if len(path.parts) == 1}
    return {name: Room(name) for name in sorted(folders | loose)}


ROOMS = rooms()


@dataclass(frozen=True)
class Result:
    """What became of the changes of a room.

    Attributes:
        room: Its name.
        made: Changes that were tried.
        survived: Those that no test noticed.
        unrun: Those of them that no test runs in this process.
        explained: Survivors that the list explains.
        vain: Entries of the list that explain nothing.
    """

    room: str
    made: int
    survived: int
    unrun: int
    explained: int
    vain: int

    @property
    def share(self) -> float:
        """Share of the changes that are noticed, of those that no reason explains."""
        return (self.made - self.survived) / max(1, self.made - self.explained)


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


def explanations(room: Room) -> list[Explanation]:
    """The list of a room, one per line of code."""
    table = tomllib.loads(EXPLAINED.read_text(encoding="utf-8"))
    entries = [entry for found in table.values() for entry in found]
    return [
        Explanation(
            entry["module"],
            source,
            entry.get("within", ""),
            tuple(entry.get("operators", ())),
            entry["reason"],
        )
        for entry in entries
        if entry["module"] in room.modules
        for source in entry["lines"]
    ]


# -- the whole -------------------------------------------------------------------------------------


def run(room: Room, arguments: argparse.Namespace) -> Result:
    """Try a room and say what was seen."""
    modules = [
        name
        for name in room.modules
        if not arguments.module or any(part in name for part in arguments.module)
    ]
    changes = [change for module in modules for change in changes_of(module)]
    print(f"{room.name}: {len(changes)} changes", end="")
    if arguments.sample:
        changes = random.Random(arguments.seed).sample(changes, min(arguments.sample, len(changes)))
        print(f", {len(changes)} of them chosen by seed {arguments.seed}", end="")
    print(flush=True)
    if room.elsewhere:
        print(f"  tested in a browser, or by programs of others: {', '.join(room.elsewhere)}")
    known = explanations(room)
    survivors: list[Change] = []

    def on_end(change: Change, was_noticed: bool) -> None:
        if not was_noticed:
            survivors.append(change)
            if not any(explanation.fits(change) for explanation in known):
                print(f"unexplained: {change}", flush=True)

    tests = room.tests
    if arguments.own:
        tests = tuple(sorted(own_tests({change.module for change in changes})))
    if not changes or not tests:
        for change in changes:
            on_end(change, was_noticed=False)
        return report(room.name, changes, survivors, [], known, is_whole=not arguments.sample)
    with tempfile.TemporaryDirectory() as folder:
        trials = Trials(tests, Path(folder), is_quick=bool(arguments.sample))
        name = room.name.replace("/", "-")
        kept = f"{arguments.record}-{name}.json" if arguments.record else f"{folder}/record"
        trials.record(room.modules, Path(kept))
        trials.try_all(changes, on_end)
        unrun = [change for change in survivors if not trials.tests_of(change)]
    return report(room.name, changes, survivors, unrun, known, is_whole=not arguments.sample)


def report(
    room: str,
    tried: list[Change],
    survivors: list[Change],
    unrun: list[Change],
    known: list[Explanation],
    *,
    is_whole: bool,
) -> Result:
    """The figures of a room, and what its list says in vain."""
    explained = [change for change in survivors if any(reason.fits(change) for reason in known)]
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
    for module in sorted(counts):
        print(f"  {module}: {counts[module]} tried, {lived[module]} survived")
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(f"{room}: {spent.ru_utime + spent.ru_stime:.0f} s of the processor so far", flush=True)
    return Result(room, len(tried), len(survivors), len(unrun), len(explained), vain)


def print_table(results: list[Result]) -> None:
    """A line for each room; the percentage leaves out what is explained."""
    names = ("room", "made", "caught", "survived", "not run", "explained", "percent")
    print(f"{names[0]:24}" + "".join(f"{name:>10}" for name in names[1:]))
    for each in results:
        figures = (each.made, each.made - each.survived, each.survived, each.unrun, each.explained)
        print(f"{each.room:24}" + "".join(f"{n:10}" for n in figures) + f"{each.share:10.1%}")


def prepare() -> None:
    """Import what every try needs but the project, and make chance repeat itself."""
    for name in ("anyio", "cryptography.hazmat.primitives.ciphers", "serial_asyncio", "uvicorn"):
        __import__(name)
    speeds.LIMIT_S = math.inf  # what a test costs here says nothing about the test
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
    parser.add_argument(
        "rooms", nargs="*", choices=[*ROOMS, []], help="all by default", metavar="room"
    )
    parser.add_argument(
        "--module", action="append", help="only files whose path contains this, or another one"
    )
    parser.add_argument(
        "--sample", type=int, default=0, help="try so many changes per room, by tests not slow"
    )
    parser.add_argument("--seed", type=int, default=0, help="which ones a sample has")
    parser.add_argument(
        "--own", action="store_true", help="only by the tests of each module itself: far sooner"
    )
    parser.add_argument(
        "--record", help="keep at this path, for the next run of the same code, what runs what"
    )
    arguments = parser.parse_args()
    prepare()
    print(f"seed {arguments.seed}")
    names = arguments.rooms or [name for name in ROOMS if "/" not in name]
    results = [run(ROOMS[name], arguments) for name in names]
    print_table(results)
    return 0 if all(each.survived == each.explained and not each.vain for each in results) else 1


if __name__ == "__main__":
    sys.exit(main())
