"""What the two hooks of the suite make of tests, seen from outside: pytest runs pytest."""

from __future__ import annotations

import errno
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import judged, speeds
from tests.affected import affected, changed
from tests.judged import Machine, descendants

# Each runs pytest in a process, or reads the whole house.
pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent


def outcome(folder: Path, text: str, *options: str, under: tuple[str, ...] = ()) -> tuple[int, str]:
    """Run pytest on a file with both hooks; its exit status, and what it printed."""
    imports = "import os, time, pytest\nfrom tests import judged, speeds"
    (folder / "test_it.py").write_text(f"{imports}\n{text}")
    (folder / "pytest.ini").write_text("[pytest]\nmarkers =\n pty:\n slow:\n smoke:\n")
    hooks = ("-p", "tests.speeds", "-p", "tests.judged", "-p", "no:cacheprovider")
    plain = {name: os.environ[name] for name in os.environ if not name.startswith("COVERAGE")}
    done = subprocess.run(
        [sys.executable, *under, "-m", "pytest", *hooks, "-q", *options, str(folder)],
        capture_output=True,
        text=True,
        env=plain | {"PYTHONPATH": str(ROOT)},
        cwd=folder,
        check=False,
    )
    return done.returncode, done.stdout


# So long on a quiet machine, whatever takes the processors of this one.
DEAR = """
def test_it():
    for _ in range(round({0} / speeds.WORK_S)):
        speeds.work()
"""


@pytest.mark.parametrize("others", [0.0, 0.9])
def test_what_is_dear_and_not_called_slow_fails_the_run_on_a_quiet_machine(
    tmp_path: Path, others: float
) -> None:
    machine = f"from tests import speeds\nspeeds.taken_by_others = lambda: {others}\n"
    # Far above the limit: beside others, one measurement of the machine may be twice off.
    status, told = outcome(tmp_path, machine + DEAR.format(4.0))
    assert (status, "1 passed" in told) == (0 if others else 1, True)
    assert "SLOW test_it.py::test_it: " in told
    assert ("Not judged: others took 90 %" in told) is bool(others)
    assert outcome(tmp_path, f"{machine}@pytest.mark.slow" + DEAR.format(2.0))[0] == 0


def test_what_the_list_would_just_not_name_passes_on_a_busy_machine(tmp_path: Path) -> None:
    endless = [sys.executable, "-c", "while True: pass"]
    busy = [subprocess.Popen(endless, start_new_session=True) for _ in range(2)]  # of others
    try:
        status, told = outcome(tmp_path, DEAR.format(speeds.MARKED_S))
    finally:
        for process in busy:
            process.kill()
            process.wait()
    assert (status, "1 passed" in told) == (0, True), told


def test_an_import_is_not_charged_to_the_first_that_needs_it(tmp_path: Path) -> None:
    (tmp_path / "dear.py").write_text(f"from tests import speeds{DEAR.format(2.0)}\ntest_it()")
    assert outcome(tmp_path, "def test_it(): import dear")[0] == 0


CHILD = r"""
import subprocess, sys
from tests import speeds
speeds.taken_by_others, speeds.LIMIT_S = lambda: 0.0, 0.3
TEXT = "import time\nwhile time.process_time() < 1.2: pass\nprint(flush=True)\ninput()"
begun = []

def begin():
    pipes = dict(stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    begun.append(subprocess.Popen([sys.executable, "-c", TEXT], **pipes))
    begun[-1].stdout.readline()  # it has computed, and waits

def end():
    begun.pop().communicate(b"\n")

@pytest.fixture
def one():
    yield begin()
    end()

"""


@pytest.mark.parametrize(
    ("tests", "charged"),
    [
        ("def test_a(): begin()\ndef test_b(): end()", []),
        ("def test_a(): begin()\ndef test_b(): begin(), end(), end()", []),
        ("def test_a(): begin(), end()\ndef test_b(): pass", ["test_a"]),
        ("def test_a(one): pass\ndef test_b(): pass", ["test_a"]),
        ("def test_a(): begin()\ndef test_b(): begin(), end()", ["test_b"]),
    ],
)
def test_a_child_is_charged_to_the_test_that_began_it_or_to_none(
    tmp_path: Path, tests: str, charged: list[str]
) -> None:
    """A test of 20 ms that waits for the child of an earlier one is not slow."""
    _, told = outcome(tmp_path, CHILD + tests)
    assert (re.findall(r"SLOW test_it.py::(\w+)", told), "2 passed" in told) == (charged, True)


def test_nothing_is_dear_while_lines_are_counted(tmp_path: Path) -> None:
    counted = ("-m", "coverage", "run", f"--data-file={tmp_path / 'lines'}")
    assert outcome(tmp_path, DEAR.format(2.0), under=counted)[0] == 0


OURS = r"""
import subprocess, sys, time
from tests import speeds
text = "import time\nwhile time.process_time() < 1.0: pass\nprint(flush=True)\ninput()"
pipes = dict(stdin=subprocess.PIPE, stdout=subprocess.PIPE)
own = speeds.spent()[0]
busy = subprocess.Popen([sys.executable, "-c", text], start_new_session={0}, **pipes)
busy.stdout.readline()
print(speeds.spent()[0] - own > 0.9)
"""


@pytest.mark.parametrize("is_of_others", [True, False])
def test_ours_is_what_the_same_command_began(is_of_others: bool) -> None:
    """As type checkers beside the tests, and the other parts of the suite."""
    told = subprocess.run(
        [sys.executable, "-c", OURS.format(is_of_others)],
        capture_output=True,
        text=True,
        cwd=ROOT,
        start_new_session=True,
        check=True,
    )
    assert told.stdout == f"{not is_of_others}\n"


def test_what_keeps_real_time_is_left_out_but_for_smoke_tests(tmp_path: Path) -> None:
    both = "@pytest.mark.pty\ndef test_a(): pass\n@pytest.mark.pty\n@pytest.mark.smoke\n"
    _, told = outcome(tmp_path, f"{both}def test_b(): pass\ndef test_c(): pass\n", "-m", "not slow")
    assert "2 passed, 1 deselected" in told


@pytest.mark.parametrize(
    ("cost", "runs"), [(2.0, [0, 8, 16, 24, 32]), (10.0, [0]), (11.0, []), (0.6, [])]
)
def test_some_cheap_cases_of_a_listed_function_run_all_the_same(
    tmp_path: Path, cost: float, runs: list[int]
) -> None:
    """40 cases of 50 ms: five of them. One of 0.25 s runs, none that is dearer, none that waits."""
    listed = f"speeds.slow = lambda: {{'test_it.py::test_it': {cost}}}\n"
    cases = "@pytest.mark.parametrize('number', range(40))\ndef test_it(number): pass\n"
    _, told = outcome(tmp_path, listed + cases, "-m", "not slow", "-vv")
    assert [int(one) for one in re.findall(r"test_it\[(\d+)\] PASSED", told)] == runs


# A machine that stands still is stood in for: none does when it is asked to.
STANDS = """
class Stood(judged.Machine):
    def __exit__(self, *how):
        super().__exit__(*how)
        self.stood_s = {0}

judged.Machine = Stood
"""
FAILS = "@pytest.mark.pty\ndef test_it():\n    with open({0!r}, 'a') as log: log.write('x')\n    "


@pytest.mark.parametrize(
    ("stood", "ends", "times", "told"),
    [
        ("0.6", "assert 0, ' ab'[len(open(log.name).read())]", 2, "1 not judged"),
        ("0.6", "assert 0, ' aab'[len(open(log.name).read())]", 3, "1 not judged"),
        ("0.6", "assert 0.5 < -len(open(log.name).read())", 3, "1 failed"),
        ("0.6", "assert len(open(log.name).read()) == 2", 2, "1 passed"),
        ("0.6", "assert len(open(log.name).read()) > 2", 3, "1 passed"),
        ("0.1", "assert False", 1, "1 failed"),
        ("0.6", "pass", 1, "1 passed"),
    ],
    ids=[
        "another failure",
        "another failure at last",
        "the same failure",
        "stands once",
        "stands twice",
        "does not stand",
        "stands and passes",
    ],
)
def test_a_failure_while_the_machine_stands_is_repeated_and_red_if_it_stays_the_same(
    tmp_path: Path, stood: str, ends: str, times: int, told: str
) -> None:
    log = tmp_path / "log"
    _, shown = outcome(tmp_path, STANDS.format(stood) + FAILS.format(str(log)) + ends)
    assert log.read_text() == "x" * times
    assert told in shown
    assert ("the loop stood 600 ms and 600 ms" in shown) is ("not judged" in told)


@pytest.mark.parametrize("others", [0.0, 0.9])
def test_too_many_that_are_not_judged_fail_on_a_quiet_machine_only(
    tmp_path: Path, others: float
) -> None:
    text = STANDS.format(0.6) + f"judged.taken_by_others = lambda: {others}\nsaid = iter('ab')\n"
    status, told = outcome(tmp_path, f"{text}@pytest.mark.pty\ndef test_it(): assert 0, next(said)")
    assert status == (0 if others else 1)
    assert ("too many for a machine so quiet" in told) is not bool(others)


LOOP = """
from m100link.sim import VirtualClockEventLoop

@pytest.fixture
def anyio_backend():
    return {0}

said = iter("ab")

@pytest.mark.anyio
async def test_it(): assert 0, next(said)
"""


@pytest.mark.parametrize(
    ("backend", "told"),
    [
        ('"asyncio"', "1 not judged"),
        (
            '("asyncio", {"loop_factory": VirtualClockEventLoop})',
            "1 failed",
        ),
    ],
    ids=["real", "virtual"],
)
def test_a_test_by_the_clock_of_the_machine_may_stay_unjudged(
    tmp_path: Path, backend: str, told: str
) -> None:
    assert told in outcome(tmp_path, STANDS.format(0.6) + LOOP.replace("{0}", backend))[1]


def test_a_test_that_computes_is_judged_whatever_the_machine_does(tmp_path: Path) -> None:
    status, told = outcome(tmp_path, STANDS.format(0.6) + "def test_it(): assert False")
    assert (status, "1 failed" in told) == (1, True)


def test_a_process_that_was_begun_is_among_the_descendants() -> None:
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as child:
        assert child.pid in set(descendants(os.getpid()))
        child.communicate(b"\n")


def test_a_machine_that_runs_freely_did_not_stand() -> None:
    with Machine() as machine:
        pass
    assert machine.stood_s < judged.STOOD_S


def test_a_thread_that_gets_too_little_of_a_processor_stands(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(judged, "kept_waiting", lambda *_: 0.9 * time.monotonic())
    with Machine() as machine:
        time.sleep(3 * judged.LOOK_S)
    assert machine.stood_s > judged.STOOD_S


def test_a_watch_of_the_machine_outlives_a_lack_of_descriptors(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def none_left(_: int) -> Iterator[int]:
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(judged, "descendants", none_left)
    with Machine() as machine:
        time.sleep(judged.LOOK_S / 5)
        assert machine.is_alive()


def test_a_clock_that_does_not_tick_during_the_work_leaves_a_cost_as_it_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As under a limit of the processor's time."""
    monkeypatch.setattr(speeds, "work", lambda: 0.0)
    monkeypatch.setattr(speeds.CLOCK, "_work_s", 0.0)
    assert speeds.CLOCK.quiet(2.0) == 2.0


def test_the_list_has_functions_with_their_seconds() -> None:
    assert speeds.slow()
    assert all("[" not in function for function in speeds.slow())


@pytest.mark.parametrize(
    ("changed", "touched", "left"),
    [
        ("m100link/wire/frame.py", "tests/browser/test_flying.py", "tests/apps/bus/test_memory.py"),
        (
            "m100link/apps/mavlink/translator/offboard.py",
            "tests/apps/mavlink/translator/test_commands.py",
            "tests/apps/ros2/test_node.py",
        ),
        ("m100link/apps/cli/demo.py", "tests/apps/cli/test_demo.py", "tests/flight/test_path.py"),
        ("tests/log/flight.py", "tests/log/test_reading.py", "tests/wire/test_crc.py"),
        ("noxfile.py", "tests/test_project.py", "tests/wire/test_crc.py"),
        ("docs/index.md", "tests/test_project.py", "tests/flight/test_path.py"),
        (
            "tests/interop/foxglove/reader.mjs",
            "tests/interop/test_foxglove.py",
            "tests/test_house.py",
        ),
        ("tests/slow.txt", "tests/test_speeds.py", "tests/interop/test_foxglove.py"),
    ],
)
def test_affected_are_those_that_import_what_changed(changed: str, touched: str, left: str) -> None:
    found = affected({changed})
    assert touched in found
    assert left not in found


def test_a_change_of_what_all_stand_on_affects_all() -> None:
    assert len(affected({"pyproject.toml"})) > 350
    assert affected({"LICENSE"}) == []


def test_a_commit_that_does_not_exist_ends_it_with_the_words_of_git() -> None:
    with pytest.raises(SystemExit, match="nonsense"):
        changed("nonsense")
