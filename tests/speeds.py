"""Two speeds of the suite, as hooks of pytest: which tests are slow, and what each costs.

Slow is a test function that the list beside this file names (`nox -s slow` measures and writes
it), that is marked so, or that keeps real time, on a pseudo-terminal or in a browser, and is not
marked `smoke`. `nox` leaves the slow ones out; `nox -s full` runs them. Of a listed function with
many cases it runs a few all the same, so that every change meets what the function asserts.

The cost is time of the processor over all cases of a function, with that of the children that the
test began and waited for. A child of an earlier test costs the one that waits for it nothing. The
time on the clock is the machine's, and others may be using it: what a function waits besides makes
it slow in the list, which a quiet machine writes, and fails no run.

A second of a processor is not the same everywhere: where others use its caches, it does less. The
cost is therefore counted in a fixed piece of work that is measured beside the tests, given in
the seconds that it takes on a quiet machine. The time of imports is left out, and of what else is
done once: the first test that uses a library would pay for all others.
"""

from __future__ import annotations

import importlib
import os
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Generator, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from zlib import crc32

import pytest

LIST = Path(__file__).with_name("slow.txt")
LIMIT_S = 1.5
"""A run fails when all cases of a function that is not slow take longer."""
MARKED_S = 0.6
"""The list names those that take longer than this: what is left between the two is for chance. The
same flight was seen to take 0.69 and 1.12 s."""
SAMPLE_S = 0.25
"""So much of a listed function runs all the same, if it has cases so cheap."""
WAITS_S = 2.0
"""So long they may wait besides, on the quiet machine on which the list is written."""
QUIET = 0.25
"""A machine is quiet if others take less than this share of its processors."""
WORK_S = 0.00084
"""What the piece of work takes there."""
MEASURED_S = 0.05
"""After each part of a test that took longer the work is measured again."""
RECORD = "M100LINK_WRITE_SLOW"
"""Environment variable: write the list anew, from this run."""


def slow() -> dict[str, float]:
    """Test functions that were measured to be slow, with the seconds that each took."""
    rows = (line.split() for line in LIST.read_text("utf-8").splitlines())
    return {function: float(seconds) for seconds, function in rows}


def function_of(nodeid: str) -> str:
    """The name of a test without its parameters, as the list has it."""
    return nodeid.partition("[")[0]


def keeps_real_time(item: pytest.Item) -> bool:
    """Whether it flies, or talks to programs, by a clock that no test can stop."""
    return any(item.get_closest_marker(mark) for mark in ("pty", "browser", "interop"))


def runs_in_real_time(item: pytest.Item) -> bool:
    """The same once it is set up, or its event loop has no other clock, as beside sockets."""
    backend = getattr(item, "funcargs", {}).get("anyio_backend")
    return keeps_real_time(item) or backend == "asyncio"


@pytest.hookimpl(tryfirst=True)  # before `-m` selects
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    named, cases = slow(), defaultdict[str, list[pytest.Item]](list)
    for item in items:
        for folder in ("browser", "interop"):
            if item.nodeid.startswith(f"tests/{folder}/"):
                item.add_marker(folder)
        if keeps_real_time(item) and not item.get_closest_marker("smoke"):
            item.add_marker("slow")
        elif (function := function_of(item.nodeid)) in named:
            cases[function].append(item)
    for function, found in cases.items():
        runs = set(sample(found, named[function]))
        for item in found:
            if item not in runs:
                item.add_marker("slow")


def sample(cases: list[pytest.Item], cost: float) -> list[pytest.Item]:
    """Cases of a listed function that run all the same, from all over it; cost of all, s."""
    few = int(len(cases) * SAMPLE_S / cost) if cost > MARKED_S else 0  # else it waits
    return [cases[number * len(cases) // few] for number in range(few)]


def work() -> float:
    """What the fixed piece of work takes now, in seconds of the processor: it is like the tests."""
    begun = time.process_time()
    table: dict[str, int] = {}
    total = 0
    for number in range(3_000):
        text = f"{number:05d}"
        table[text] = number
        total = crc32(text.encode(), total)
    return time.process_time() - begun


class Clock:
    """Tells time of the processor in seconds of a quiet machine, without what imports take."""

    def __init__(self) -> None:
        self._left_out_s = 0.0
        self._is_left_out = False
        self._work_s = work()
        # Python looks this one up for every module that it does not have yet, and only for those.
        bootstrap = vars(importlib._bootstrap)  # it is private
        self._load = bootstrap["_find_and_load"]
        bootstrap["_find_and_load"] = self._import

    def _import(self, *arguments: Any) -> Any:
        with self.left_out():
            return self._load(*arguments)

    @contextmanager
    def left_out(self) -> Iterator[None]:
        """What is done here is done once for many tests, and none of them is charged for it."""
        if self._is_left_out or threading.current_thread() is not threading.main_thread():
            yield
            return
        begun = time.process_time()
        self._is_left_out = True
        try:
            yield
        finally:
            self._is_left_out = False
            self._left_out_s += time.process_time() - begun

    def now(self) -> float:
        """Seconds that were taken here, as they are on this machine."""
        return time.process_time() - self._left_out_s

    def quiet(self, seconds: float) -> float:
        """What has just taken so long would take so long on a quiet machine."""
        before = self._work_s
        if seconds > MEASURED_S:
            self._work_s = work()
        # Nothing at all, where a limit of the processor's time makes its clock tick too seldom.
        return seconds * WORK_S / ((before + self._work_s) / 2 or WORK_S)


class Cost:
    """What one test has taken since it was last asked, in seconds of the processor."""

    def __init__(self) -> None:
        self._older = living_children()
        self._begin()

    def _begin(self) -> None:
        self._own, self._children = CLOCK.now(), children_time()

    def taken(self) -> float:
        """Its own time, and its children's unless one ended that another test began."""
        living = living_children()
        own, children = CLOCK.now() - self._own, children_time() - self._children
        cost = CLOCK.quiet(own + children if self._older <= living else own)
        self._older &= living
        self._begin()
        return cost


def living_children() -> set[int]:
    """Processes that this one has begun and not waited for yet."""
    try:
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
    except ChildProcessError:  # as before most tests, and this is cheap
        return set()
    return set(children_of(os.getpid()))


def children_of(process: int) -> Iterator[int]:
    """Processes that a process has begun."""
    for thread in Path(f"/proc/{process}/task").glob("*/children"):
        with suppress(OSError):  # it has just ended
            yield from map(int, thread.read_text("ascii").split())


def children_time() -> float:
    """Seconds that the children took that this process waited for."""
    return sum(os.times()[2:4])


def spent() -> tuple[float, float, float]:
    """Seconds of all processors: in which they worked for us, in which for anybody, and all.

    Ours is the group of processes that one command began: all parts of the suite, type checkers.
    """
    tick, group, ours = os.sysconf("SC_CLK_TCK"), str(os.getpgrp()), 0
    try:
        counted = [int(n) / tick for n in Path("/proc/stat").read_text("ascii").split()[1:9]]
    except OSError:
        return 0.0, 0.0, 0.0  # nobody counts here: quiet
    for place in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it has just ended
            fields = place.read_text("utf-8", "replace").rpartition(")")[2].split()
            if fields[2] == group:
                ours += sum(int(ticks) for ticks in fields[11:15])  # its children's, too
    return ours / tick, sum(counted) - counted[3] - counted[4], sum(counted)


_begun = spent()


def taken_by_others() -> float:
    """The share of the processors that others took since this process began."""
    own, worked, passed = (after - before for after, before in zip(spent(), _begun, strict=True))
    return max(0.0, worked - own) / passed if passed else 0.0


# -- what each test costs -------------------------------------------------------------------------

CLOCK = Clock()
_cost: Cost | None = None
_costs: dict[str, float] = defaultdict(float)
_waits: dict[str, float] = defaultdict(float)
_slow: set[str] = set()
_real: set[str] = set()


@pytest.hookimpl(wrapper=True, tryfirst=True)  # where tests run, not where they are reported
def pytest_runtest_protocol() -> Generator[None, object, object]:
    global _cost
    _cost = Cost()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    vars(report).update(  # plain values: a process of xdist hands them on
        cost=_cost.taken() if _cost else 0.0,
        is_slow=item.get_closest_marker("slow") is not None,
        is_real=keeps_real_time(item),
        is_in_real_time=runs_in_real_time(item),
    )
    return report


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    function = function_of(report.nodeid)
    cost: float = getattr(report, "cost", 0.0)
    _costs[function] += cost
    _waits[function] += report.duration - cost
    if getattr(report, "is_slow", False):
        _slow.add(function)
    if getattr(report, "is_real", False):
        _real.add(function)


def too_dear() -> dict[str, float]:
    """Functions that no list and no mark calls slow, and that are."""
    return {
        function: seconds
        for function, seconds in _costs.items()
        if function not in _slow | _real and seconds > LIMIT_S and not is_counted()
    }


def is_counted() -> bool:
    """Whether coverage counts lines here, which takes time of its own."""
    coverage = sys.modules.get("coverage")
    return coverage is not None and coverage.Coverage.current() is not None


def pytest_sessionfinish(session: pytest.Session) -> None:
    if hasattr(session.config, "workeroutput"):
        return  # the process that began this one counts for all
    if os.environ.get(RECORD):
        rows = (
            f"{cost:6.1f} {function}\n"
            for function, cost in sorted(_costs.items())
            if function not in _real and (cost > MARKED_S or _waits[function] > WAITS_S)
        )
        LIST.write_text("".join(rows), "utf-8")
    elif too_dear() and taken_by_others() < QUIET and session.exitstatus == pytest.ExitCode.OK:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    if not os.environ.get(RECORD):
        others = taken_by_others()
        excuse = f" Not judged: others took {100 * others:.0f} %." if others >= QUIET else ""
        for function, seconds in sorted(too_dear().items()):
            terminalreporter.write_line(
                f"SLOW {function}: {seconds:.1f} s of a processor, and the default run allows "
                f"{LIMIT_S:g}. Make it cheaper, mark it slow, or run nox -s slow.{excuse}",
                red=not excuse,
                yellow=bool(excuse),
            )
