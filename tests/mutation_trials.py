"""How mutation testing tries a change: which tests, in which process, and how long at most."""

from __future__ import annotations

import gc
import importlib
import inspect
import json
import math
import os
import resource
import signal
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import spec_from_file_location
from itertools import accumulate
from pathlib import Path
from types import CodeType, FunctionType, ModuleType

import coverage
import pytest

from tests.mutation_changes import ROOT, Change, statement, text_of
from tests.test_house import mirrored as place_of_test
from tests.test_house import name_of

__all__ = ["ELSEWHERE", "Trials", "mirrored", "own_files"]

ENOUGH_S = 12.0
"""Of tests for one change, beside the mirrored ones, as long as they take while coverage is
recorded (a third without): lines that every flight runs would take the whole suite otherwise. A
sample has a third of it, and so much for the mirrored ones."""

PARTNERS = {
    "block": ("by_hand", "handover", "signals", "stop_path"),
    "lifecycle": ("block", "stop_path", "signals"),
    "stop_path": ("block",),
    "watchdog": ("following",),
    "guardian": ("guardian_plan",),
    "loops": ("orbit",),
    "steering": ("control", "guards"),
    "frame": ("frame_properties",),
    "link": ("link_interrupted",),
    "transport": ("serial_pty", "serial_transport"),
}
"""Module, tests beside its own that are about it."""

UNSEEN = {
    "link": "tests/link/test_link_interrupted.py::test_ctrl_c",
    "serial_transport": "tests/link/test_serial_transport.py::test_ctrl_c",
}
"""Module, tests beside it that watch its lines by a tracer of their own: the record misses them."""

IN_THIS_PROCESS = ("tests/link",)
"""Folders whose tests marked ``pty`` start no program of their own, and so see a change."""

ELSEWHERE = ("browser", "interop")
"""Marks of tests that start a browser or a program of others, which see no change."""

Place = tuple[str, int]
"""Qualified name and first line of a function."""


def mirrored(module: str) -> str:
    """The test file of a module, "" if there is none of its name."""
    found = place_of_test(ROOT / module)
    return str(found.relative_to(ROOT)) if found.exists() else ""


def own_files(module: str) -> tuple[str, ...]:
    """The mirrored test file of a module, first, and its partners: those that there are."""
    test = place_of_test(ROOT / module).relative_to(ROOT)
    # Tables of what goes in and comes out are of every module beside them.
    names = (*PARTNERS.get(Path(module).stem, ()), "values", "calls")
    found = (test, *(test.with_name(f"test_{name}.py") for name in names))
    return tuple(str(path) for path in found if (ROOT / path).exists())


class Trials:
    """The tests of a room, run against one change after the other.

    A change in the body of a function is tried in a copy (fork) of a process that has the project
    imported and the tests collected. What an import runs (constants, tables, defaults, classes) is
    tried in a copy of one that has imported nothing of the project yet.

    Args:
        tests: Files and folders of tests.
        scratch: A folder for output.
        is_quick: Whether slow tests are left out.
    """

    def __init__(self, tests: Sequence[str], scratch: Path, *, is_quick: bool) -> None:
        self._tests = tests
        self._scratch = scratch
        self._is_quick = is_quick
        self._enough_s = ENOUGH_S / 3 if is_quick else ENOUGH_S
        left_out = (
            list(ELSEWHERE)
            if all(test.startswith(IN_THIS_PROCESS) for test in tests)
            else ["pty", *ELSEWHERE]
        )
        if is_quick and "pty" in left_out:
            left_out.append("slow")
        self._marks = " and ".join(f"not {mark}" for mark in left_out)
        self._took: dict[str, float] = {}  # test, seconds of the processor; the fastest first
        # Module, line, tests that run it; "" is the import.
        self._lines: dict[str, dict[int, list[str]]] = {}

    def record(self, modules: Sequence[str], kept: Path) -> None:
        """Run all of them unchanged for the record, and some in the order of the trials.

        Args:
            modules: Those that will be changed.
            kept: Where the record stands or shall stand.
        """
        is_first = not kept.exists()
        if is_first:
            self._run_unchanged(Recorder(modules, kept))
        seen = json.loads(kept.read_text(encoding="utf-8"))
        took = seen["took"]
        self._took = {name: took[name] for name in sorted(took, key=lambda name: took[name])}
        self._lines = {
            module: {int(line): names for line, names in lines.items()}
            for module, lines in seen["lines"].items()
        }
        left_out = ", ".join(f"{count} {mark}" for mark, count in seen["left out"].items())
        print(f"  {len(took)} tests, not {left_out or 'one left out'}", flush=True)
        if is_first and not self._is_quick:
            chosen = self._of_each_family(set(self._took))
            self._run_unchanged(Selection({name: self._took[name] for name in chosen}))

    def _run_unchanged(self, plugin: object) -> None:
        status = self._run(self._tests, plugin, name="unchanged")
        if status not in (0, pytest.ExitCode.NO_TESTS_COLLECTED):
            text = (self._scratch / "unchanged").read_text(encoding="utf-8")
            sys.exit(f"{' '.join(self._tests)} fails unchanged ({status}):\n{text}")

    def try_all(self, changes: Sequence[Change], on_end: Callable[[Change, bool], None]) -> None:
        """Try each; ``on_end`` is called with each and whether a test noticed it."""
        results = self._scratch / "results"
        results.touch()
        status = self._run(self._tests, Bodies(changes, self, results), name="bodies")
        if status not in (0, pytest.ExitCode.NO_TESTS_COLLECTED):
            sys.exit((self._scratch / "bodies").read_text(encoding="utf-8") + str(status))
        ended = dict(json.loads(line) for line in results.read_text().splitlines())
        for place, change in enumerate(changes):
            noticed = ended.get(place)
            on_end(change, self._notices(change) if noticed is None else noticed)

    def _notices(self, change: Change) -> bool:
        took = self.chosen(change)
        if not took:
            return False
        files = sorted({name.partition("::")[0] for name in took})
        try:
            finder = Changed(change)
        except SyntaxError:  # cosmic-ray can make what is not Python, where nobody can miss it
            return True
        selection, at_most = Selection(took), patience(took)
        return self._run(files, selection, name="output", finder=finder, at_most=at_most) != 0

    def tests_of(self, change: Change) -> set[str]:
        """Tests that run the changed statement; "" among them says that its import does."""
        lines = self._lines[change.module]
        return {name for line in statement(change) for name in lines.get(line, [])}

    def chosen(self, change: Change) -> dict[str, float]:
        """Tests to run and their times: the mirrored ones first, then the fastest."""
        names = self.tests_of(change)
        stem = Path(change.module).stem
        first = tuple(f"{name}::" for name in own_files(change.module))
        if "" in names:
            every = self._lines[change.module].values()
            # A module of declarations alone is run by no test and used by any; a table may be read
            # by a test that runs nothing.
            names = {name for found in every for name in found} - {""} or set(self._took)
            names |= {name for name in self._took if name.startswith(first)}
        if stem in UNSEEN:
            names |= {name for name in self._took if name.startswith(UNSEEN[stem])}
        own = sorted((n for n in names if n.startswith(first)), key=self._took.__getitem__)
        if self._is_quick:
            own = self._up_to_enough(own)
        chosen = own + self._up_to_enough(self._of_each_family(names.difference(own)))
        return {name: self._took[name] for name in chosen}

    def _up_to_enough(self, names: Sequence[str]) -> list[str]:
        """As many of the first ones as the time for a change allows."""
        spent = accumulate(self._took[name] for name in names)
        return [name for name, so_far in zip(names, spent, strict=True) if so_far <= self._enough_s]

    def _of_each_family(self, names: set[str]) -> list[str]:
        """The fastest of each family of parameters, which says more than many of one family."""
        slowest_first = [name for name in reversed(self._took) if name in names]
        families = {name.partition("[")[0]: name for name in slowest_first}
        return sorted(families.values(), key=self._took.__getitem__)

    def _run(
        self,
        files: Sequence[str],
        plugin: object,
        *,
        name: str,
        finder: Changed | None = None,
        at_most: float = math.inf,
    ) -> int:
        def run() -> int:
            if finder is not None:
                sys.meta_path.insert(0, finder)
            options = ["-qxs", "-p", "no:cacheprovider"]
            options += ["-m", self._marks]
            options += ["-W", "ignore:Module already imported:pytest.PytestAssertRewriteWarning"]
            return int(pytest.main([*options, *files], plugins=[plugin]))

        return in_copy(run, self._scratch / name, at_most=at_most)


def in_copy(work: Callable[[], int], output: Path, *, at_most: float = math.inf) -> int:
    """Work in a copy of this process, for some seconds at most.

    Returns:
        Its exit status, negative for a signal.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child:
        deadline = time.monotonic() + at_most
        while (ended := os.waitpid(child, os.WNOHANG if at_most < math.inf else 0))[0] == 0:
            if time.monotonic() > deadline:  # it holds off what ends a test
                os.kill(child, signal.SIGKILL)
            time.sleep(0.005)
        return os.waitstatus_to_exitcode(ended[1])
    status = 2
    try:
        stream = os.open(output, os.O_CREAT | os.O_WRONLY | os.O_TRUNC)
        os.dup2(stream, 1)
        os.dup2(stream, 2)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        status = work()
    except BaseException:  # noqa: BLE001 (nobody is behind this to raise it to)
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def patience(took: dict[str, float]) -> float:
    """How long the tests of one change are waited for, in seconds of a machine that does more."""
    return 60 + 10 * sum(took.values())


def limit_time(item: pytest.Item, took: float) -> None:
    """End this process when a test computes far longer than unchanged, or waits for ever.

    What counts is time of the processor: the load of the machine is not an endless loop.
    """
    item.add_marker(pytest.mark.timeout(8 + 20 * took))
    # Some seconds more than it took: what another test imported before may be imported here.
    limit = int(time.process_time() + 6 + 3 * took)
    resource.setrlimit(resource.RLIMIT_CPU, (limit, resource.RLIM_INFINITY))


# -- plugins of pytest -----------------------------------------------------------------------------


class Recorder:
    """Which test runs which line, and how long each takes."""

    def __init__(self, modules: Sequence[str], path: Path) -> None:
        self._modules = modules
        self._path = path
        self._coverage = coverage.Coverage(
            data_file=None, config_file=False, include=[str(ROOT / module) for module in modules]
        )
        self._coverage.start()
        self._tracer = sys.gettrace()
        self._took: dict[str, float] = {}
        self._left_out: list[str] = []

    def pytest_deselected(self, items: Sequence[pytest.Item]) -> None:
        for item in items:
            marks = [mark for mark in ("pty", *ELSEWHERE) if item.get_closest_marker(mark)]
            self._left_out.append(marks[0] if marks else "slow")

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        sys.settrace(self._tracer)  # a test that counts calls may have put it away
        self._coverage.switch_context(item.nodeid)
        began_at = time.process_time()
        result = yield
        self._took[item.nodeid] = time.process_time() - began_at
        self._coverage.switch_context("")
        return result

    def pytest_sessionfinish(self) -> None:
        self._coverage.stop()
        data = self._coverage.get_data()
        lines = {module: data.contexts_by_lineno(str(ROOT / module)) for module in self._modules}
        seen = {"took": self._took, "lines": lines, "left out": Counter(self._left_out)}
        self._path.write_text(json.dumps(seen), encoding="utf-8")


class Selection:
    """Runs some tests, in an order.

    Args:
        took: Test, seconds that it takes unchanged.
    """

    def __init__(self, took: dict[str, float]) -> None:
        self._took = took
        self._places = {name: place for place, name in enumerate(took)}

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = [item for item in items if item.nodeid in self._places]
        items.sort(key=lambda item: self._places[item.nodeid])

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        limit_time(item, self._took[item.nodeid])
        return (yield)


class Bodies:
    """Tries the changes that stand in bodies of functions, instead of running the tests once."""

    def __init__(self, changes: Sequence[Change], trials: Trials, results: Path) -> None:
        self._changes = changes
        self._trials = trials
        self._results = results
        self._screen = os.fdopen(os.dup(1), "w")  # of who began this: output is kept from here on

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Writes place and outcome of each as a line of JSON."""
        items = {item.nodeid: item for item in session.items}
        output = self._results.with_name("output")
        for place, change in enumerate(self._changes):
            if not place % 100:
                print(f"  {place} of {len(self._changes)}", file=self._screen, flush=True)
            took = self._trials.chosen(change)
            if "" in self._trials.tests_of(change):
                continue
            if took:
                try:
                    bodies = changed_bodies(change)
                except SyntaxError:
                    bodies = None
                if bodies is None:
                    continue
                chosen = [(items[name], time_taken) for name, time_taken in took.items()]
                work = partial(self._try, bodies, chosen, session)
                noticed = in_copy(work, output, at_most=patience(took)) != 0
            else:
                noticed = False
            if not noticed:
                print(f"  not noticed: {change}", file=self._screen, flush=True)
            with self._results.open("a", encoding="utf-8") as lines:
                lines.write(json.dumps([place, noticed]) + "\n")
        return True

    @staticmethod
    def _try(
        bodies: dict[FunctionType, CodeType],
        chosen: Sequence[tuple[pytest.Item, float]],
        session: pytest.Session,
    ) -> int:
        for function, body in bodies.items():
            function.__code__ = body
        following = [item for item, _ in chosen[1:]]
        for (item, took), after in zip(chosen, [*following, None], strict=True):
            limit_time(item, took)
            item.ihook.pytest_runtest_protocol(item=item, nextitem=after)
            if session.testsfailed:
                return 1
        return 0


# -- the change itself -----------------------------------------------------------------------------


class ChangedModule(SourceFileLoader):
    """Loads one module with its change."""

    def __init__(self, change: Change) -> None:
        super().__init__(name_of(ROOT / change.module), str(ROOT / change.module))
        self._code = compile(change.text(), self.path, "exec")

    def get_code(self, fullname: str) -> CodeType:
        return self._code


class Changed(MetaPathFinder):
    """Finds that module before anybody else does."""

    def __init__(self, change: Change) -> None:
        self._loader = ChangedModule(change)

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        loader = self._loader
        found = name == loader.name
        return spec_from_file_location(name, loader.path, loader=loader) if found else None


def changed_bodies(change: Change) -> dict[FunctionType, CodeType] | None:
    """The functions of the module and their bodies with the change; None if that is not all."""
    path = str(ROOT / change.module)
    importlib.import_module(name_of(ROOT / change.module))  # or one that comes late stays unchanged
    gc.unfreeze()  # or those that were there when the tests had been collected are not named
    before = codes(compile(text_of(change.module), path, "exec"))
    after = codes(compile(change.text(), path, "exec"))
    if before is None or after is None or before.keys() != after.keys():
        return None
    for place, code in before.items():
        other = after[place]
        if alone(code) != alone(other):
            is_body = code.co_flags & inspect.CO_OPTIMIZED
            if not is_body or code.co_freevars != other.co_freevars:
                return None
    return {
        function: after[place]
        for function in gc.get_objects()
        if isinstance(function, FunctionType) and function.__code__.co_filename == path
        if (place := (function.__code__.co_qualname, function.__code__.co_firstlineno)) in after
    }


def codes(code: CodeType) -> dict[Place, CodeType] | None:
    """A code and all inside it; None when two cannot be distinguished."""
    found = {(code.co_qualname, code.co_firstlineno): code}
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            inside = codes(constant)
            if inside is None or inside.keys() & found.keys():
                return None
            found |= inside
    return found


def alone(code: CodeType) -> tuple[object, ...]:
    """What a code does, without those inside it."""
    constants = [None if isinstance(c, CodeType) else repr(c) for c in code.co_consts]
    return code.co_code, code.co_names, code.co_varnames, constants
