"""A third result for tests in real time: not judged, because the machine stood still meanwhile.

Where others take the processors, a loop that should tick each 20 ms stands still for half a second;
the library then ends what it flies, as it should, and a test that wanted a flight fails. Such a
test is repeated. If it fails in another way on a machine that stands still, it is neither passed
nor failed: it is not judged, and counted. On a quiet machine hardly any may be. Chance strikes here
and there: a test that fails three times in the same way is red, however late the machine was.
"""

from __future__ import annotations

import os
import re
import threading
import time
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest
from _pytest.runner import runtestprotocol

from tests.speeds import QUIET, children_of, keeps_real_time, taken_by_others
from tests.waiting import kept_waiting

STOOD_S = 0.25
"""A loop of the library that ticks so late takes itself for one that stood still."""
LOOK_S = 0.5
SAME = 3
"""Failures in a row, all the same, that no late machine explains."""
ALLOWED = 0.02
"""Share of the tests in real time that may stay without a judgement on a quiet machine."""


class Machine(threading.Thread):
    """Watches for how long this process, or one that it has begun, is kept from running.

    Args:
        at_once: Whether it watches from the beginning of its block, and not only once it is
            started: a second thread costs a flight on virtual time a twentieth.

    Attributes:
        stood_s: The longest time: of this thread in one go, of each within half a second.
    """

    def __init__(self, at_once: bool = True) -> None:
        super().__init__(name="how late the machine is", daemon=True)
        self.stood_s = 0.0
        self._at_once, self._ended = at_once, threading.Event()

    def __enter__(self) -> Machine:
        if self._at_once:
            self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        if self.ident is not None:
            self.join()

    def run(self) -> None:
        waited: dict[tuple[int, int], float] = {}
        looked_at = 0.0
        while True:
            asleep_at = time.monotonic()
            if self._ended.wait(0.02):
                return
            now = time.monotonic()
            self.stood_s = max(self.stood_s, now - asleep_at - 0.02)
            if now - looked_at >= LOOK_S:
                before, looked_at = waited, now
                waited = kept_waiting_by_thread()
                gone_by = (waited[one] - before[one] for one in waited.keys() & before.keys())
                self.stood_s = max(self.stood_s, *gone_by, 0.0)


def kept_waiting_by_thread() -> dict[tuple[int, int], float]:
    """What each thread waited for a processor: of this process, and of those that it has begun.

    A thread that gets a tenth of a processor stands nowhere, and flies nothing in time either.
    """
    try:
        return {
            (process, int(thread.name)): kept_waiting(process, int(thread.name))
            for process in (os.getpid(), *descendants(os.getpid()))
            for thread in Path(f"/proc/{process}/task").glob("*")
        }
    except OSError:  # a test takes all descriptors
        return {}


def descendants(process: int) -> Iterator[int]:
    """Processes that a process has begun, and those that these have begun."""
    for child in children_of(process):
        yield child
        yield from descendants(child)


_machine: Machine | None = None


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(
    fixturedef: pytest.FixtureDef[object],
) -> Generator[None, object, object]:
    """From here on it is known that a test has no other clock than the machine's."""
    value = yield
    is_real = fixturedef.argname == "anyio_backend" and value == "asyncio"
    if is_real and _machine is not None and _machine.ident is None:
        _machine.start()
    return value


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    if not (keeps_real_time(item) or "anyio_backend" in getattr(item, "fixturenames", ())):
        return None
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    stood: list[float] = []
    failures: list[str] = []
    global _machine
    while True:
        with Machine(keeps_real_time(item)) as machine:
            _machine = machine
            reports = runtestprotocol(item, nextitem=nextitem, log=False)
        stood.append(machine.stood_s)
        is_real = any(getattr(report, "is_in_real_time", False) for report in reports)
        if not is_real or machine.stood_s < STOOD_S or not any(one.failed for one in reports):
            break
        failures.append(failure_of(reports))
        if len(set(failures)) > 1:
            reports = [not_judged(report, stood) for report in reports]
            break
        if len(failures) == SAME:
            break
        item._initrequest()  # type: ignore[attr-defined] # as pytest-rerunfailures does
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def failure_of(reports: list[pytest.TestReport]) -> str:
    """Where a run failed and the first line that says how, without numbers, which always differ."""
    text = "\n".join(report.longreprtext for report in reports if report.failed)
    first = re.sub(r"(?m)^(E .*)(\nE .*)+$", r"\1", text)
    return re.sub(r"-?(0x[0-9a-f]+|\d[\d.]*(e-?\d+)?)", "", first)


def not_judged(report: pytest.TestReport, stood: list[float]) -> pytest.TestReport:
    """The report of a failure that may be the machine's."""
    if report.failed:
        times = " and ".join(f"{1000 * seconds:.0f} ms" for seconds in stood)
        told = f"not judged: the loop stood {times}\n{report.longreprtext}"
        file, line, _ = report.location
        vars(report).update(outcome="skipped", unjudged=told, longrepr=(file, line or 0, told))
    return report


def pytest_report_teststatus(
    report: pytest.TestReport,
) -> tuple[str, str, tuple[str, dict[str, bool]]] | None:
    if hasattr(report, "unjudged"):
        return "not judged", "N", ("NOT JUDGED", {"yellow": True})
    return None


# -- how much of that a quiet machine may have ----------------------------------------------------

_ran: dict[str, bool] = {}


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if getattr(report, "is_in_real_time", False):
        _ran[report.nodeid] = _ran.get(report.nodeid, False) or hasattr(report, "unjudged")


def too_many() -> bool:
    return sum(_ran.values()) > ALLOWED * len(_ran) and taken_by_others() < QUIET


@pytest.hookimpl(wrapper=True)
def pytest_sessionfinish(session: pytest.Session) -> Generator[None, None, None]:
    if (
        not hasattr(session.config, "workerinput")  # the process that began this one judges
        and too_many()
        and session.exitstatus == pytest.ExitCode.OK
    ):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
    yield


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    for report in terminalreporter.stats.get("not judged", ()):
        terminalreporter.write_line(f"NOT JUDGED {report.nodeid}: {report.unjudged}", yellow=True)
    if _ran:
        terminalreporter.write_line(
            f"{sum(_ran.values())} of {len(_ran)} tests in real time were not judged; others took "
            f"{100 * taken_by_others():.0f} % of the processors"
            + (": too many for a machine so quiet" if too_many() else "")
        )
