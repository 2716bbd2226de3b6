"""Two speeds of the suite, as hooks of pytest: which tests are slow, and what each costs.

Slow is a test function that the list beside this file names (`nox -s slow` measures and writes
it), that is marked so, or that keeps real time, on a pseudo-terminal or in a browser, and is not
marked `smoke`. `nox` leaves the slow ones out; `nox -s full` runs them.

The cost is time of the processor, children included, over all cases of a function. The time on the
clock is the machine's, and others may be using it: what a function waits besides makes it slow in
the list, which a quiet machine writes, and fails no run.
"""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Generator
from pathlib import Path

import pytest

LIST = Path(__file__).with_name("slow.txt")
LIMIT_S = 1.0
"""All cases of a function may take so long before it is slow."""
WAITS_S = 2.0
"""So long they may wait besides, on the quiet machine on which the list is written."""
SHARED = 3.0
"""A run fails at so many times the limit, and on a quiet machine only: on a processor that others
use the same work takes up to twice the time. The first test that uses a library pays for its
import."""
QUIET = 0.25
"""A machine is quiet if others take less than this share of its processors."""
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
    named = slow()
    for item in items:
        for folder in ("browser", "interop"):
            if item.nodeid.startswith(f"tests/{folder}/"):
                item.add_marker(folder)
        is_left_out = keeps_real_time(item) and not item.get_closest_marker("smoke")
        if is_left_out or function_of(item.nodeid) in named:
            item.add_marker("slow")


# -- what others take of the machine ---------------------------------------------------------------

_workers_time = 0.0


def processor_time() -> float:
    """Seconds that this process and the children that it waited for have taken."""
    return sum(os.times()[:4])


def busy() -> tuple[float, float]:
    """Seconds of all processors: those in which they worked for anybody, and all."""
    tick = os.sysconf("SC_CLK_TCK")
    try:
        counted = [int(n) / tick for n in Path("/proc/stat").read_text("ascii").split()[1:9]]
    except OSError:
        return 0.0, 0.0  # nobody counts here: quiet
    return sum(counted) - counted[3] - counted[4], sum(counted)


_begun = busy()


def taken_by_others() -> float:
    """The share of the processors that others took since this process began."""
    worked, passed = (after - before for after, before in zip(busy(), _begun, strict=True))
    return max(0.0, worked - processor_time() - _workers_time) / passed if passed else 0.0


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: object) -> None:
    global _workers_time
    _workers_time += getattr(node, "workeroutput", {}).get("processor_time", 0.0)


# -- what each test costs --------------------------------------------------------------------------

_began: dict[str, float] = {}
_costs: dict[str, float] = defaultdict(float)
_waits: dict[str, float] = defaultdict(float)
_slow: set[str] = set()
_real: set[str] = set()


def pytest_runtest_logstart(nodeid: str) -> None:
    _began[nodeid] = processor_time()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    now = processor_time()
    vars(report).update(  # plain values: a process of xdist hands them on
        cost=now - _began.get(item.nodeid, now),
        is_slow=item.get_closest_marker("slow") is not None,
        is_real=keeps_real_time(item),
        is_in_real_time=runs_in_real_time(item),
    )
    _began[item.nodeid] = now
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
        if function not in _slow | _real and seconds > SHARED * LIMIT_S
    }


def pytest_sessionfinish(session: pytest.Session) -> None:
    if (output := getattr(session.config, "workeroutput", None)) is not None:
        output["processor_time"] = processor_time()
        return  # the process that began this one counts for all
    if os.environ.get(RECORD):
        rows = (
            f"{cost:6.1f} {function}\n"
            for function, cost in sorted(_costs.items())
            if function not in _real and (cost > LIMIT_S or _waits[function] > WAITS_S)
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
