"""What `nox` runs. Every session reads its packages from the dependency groups of pyproject.toml.

`nox` alone runs `check`: lint, types, docs and every test that is not slow, side by side in one
environment. `nox -s full` runs everything. `nox -s lint` runs one kind in an environment of its
own. They use the Python that runs nox, and the versions of requirements-dev.txt. `nox --list` names
the others.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import nox
from nox.command import CommandFailed

nox.needs_version = ">=2025.2.9"
nox.options.sessions = ["check"]
nox.options.reuse_venv = "yes"
nox.options.error_on_missing_interpreters = False  # `full` runs the Pythons that are there

# Hundreds of processes begin here: where the environment forbids bytecode, and uv leaves none, each
# of them would compile every package that it imports, for three times the cost of its start.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

PYPROJECT = nox.project.load_toml("pyproject.toml")
EXTRAS = PYPROJECT["project"].get("optional-dependencies", {})
PACKAGE = f".[{','.join(EXTRAS)}]"
DOCS_OUTPUT = "docs/_build"
LOCK = "requirements-dev.txt"
# Lines and branches that `nox -s coverage` asks for, in percent: what a complete run has seen.
COVERED = {
    "wire session protocol": 100,
    "errors telemetry ros2 agent sync": 99,
    "link aircraft sim fleet missions flight log mavlink station doctor": 98,
    "bus cli": 97,
}
PYTHONS = ["3.11", "3.12", "3.13", "3.14"]
GET_VERSION = "aa130001000000000500302e000000b493113d"  # a version query in a frame


Line = tuple[str, ...]
Commands = dict[str, list[Line]]
Outcome = tuple[bool, float, float]  # whether well, seconds on the clock and of the processors


def group(*names: str) -> list[str]:
    """The packages of some dependency groups."""
    return list(nox.project.dependency_groups(PYPROJECT, *names))


ALONE = ("-p", "no:cacheprovider")  # none keeps a cache that another writes


def workers(count: int) -> Line:
    """Options of pytest for so many processes."""
    return "-n", str(count), "--dist", "worksteal", *ALONE


@dataclass(frozen=True)
class Kind:
    """A kind of check: what it needs and what it runs.

    Attributes:
        about: What `nox --list` says of it.
        commands: By title. What stands under one runs in this order, to the end; titles depend on
            no other, so they run side by side.
        groups: Dependency groups that it needs.
        package: Whether it needs the package itself, installed as users install it.
    """

    about: str
    commands: Commands
    groups: tuple[str, ...] = ()
    package: bool = True


def pytest(*arguments: str) -> Line:
    """A run of pytest on the installed package.

    Appending the tree to the path instead of prepending it leaves `import m100link` to that one.
    """
    return "pytest", "--import-mode=append", *arguments


def sphinx(builder: str) -> Line:
    """A build of the manual in which every warning is an error; all builders read it once."""
    options = ("--nitpicky", "--fail-on-warning", "--keep-going", "--quiet")
    places = ("-d", f"{DOCS_OUTPUT}/doctrees", "docs", f"{DOCS_OUTPUT}/{builder}")
    return "sphinx-build", *options, "-b", builder, *places


def marked(mark: str) -> list[str]:
    """Files with tests of a mark: to read all of them would take each process ten seconds."""
    files = sorted(Path("tests").rglob("test_*.py"))
    line = re.compile(rf"^ *(@|pytestmark\b.*\b)pytest\.mark\.{mark}\b", re.MULTILINE)
    return [str(path) for path in files if line.search(path.read_text("utf-8"))]


def elsewhere(*folders: str) -> list[str]:
    """Options of pytest that leave these folders out."""
    return [f"--ignore={folder}" for folder in folders]


MAVLINK, ROS2 = "tests/interop/mavlink", "tests/interop/ros2"
VIRTUAL = elsewhere("tests/interop", "tests/browser")
QUICK = (*ALONE, "-m", "not slow and not smoke")
AIRBORNE = tuple(f"tests/apps/{room}" for room in ("agent", "fleet", "mavlink", "ros2"))
# The tests that are not slow, in three processes that know nothing of each other: workers that
# report 20,000 tests to one take a tenth more, and each of them has to read all files.
QUIET: Commands = {
    "tests": [pytest(*QUICK, *VIRTUAL, *elsewhere("tests/apps"))],
    "tests of fronts": [pytest(*QUICK, "tests/apps", *elsewhere(*AIRBORNE))],
    "tests of agents": [pytest(*QUICK, *AIRBORNE)],
}
# And in eight of the same length, for a machine on which other programs compete for the processors.
# On one that is quiet they would only cost more: each imports for itself.
SHARES = {
    "tests of flights": ("tests/flight",),
    "tests of agents": ("tests/apps/agent", "tests/apps/cli"),
    "tests of the console": ("tests/apps/station",),
    "tests of MAVLink": ("tests/apps/mavlink",),
    "tests of fleets": ("tests/apps/fleet",),
    "tests of each front": ("tests/apps/test_every_front.py", "tests/apps/ros2"),
    "tests of the simulator": ("tests/sim", "tests/log", "tests/missions", "tests/telemetry"),
}
SHARED = [folder for folders in SHARES.values() for folder in folders]
BUSY: Commands = {
    **{title: [pytest(*QUICK, *folders)] for title, folders in SHARES.items()},
    "other tests": [pytest(*QUICK, *VIRTUAL, *elsewhere(*SHARED))],
}
CHECKED = ("m100link", "tests", "examples", "benchmarks", "noxfile.py", "docs/_ext")
# The longest flight begins first.
PROGRAMS = sorted(
    (*(str(path) for path in Path("examples").glob("*.py")), "examples/mavlink/square.py"),
    key=lambda path: (path != "examples/survey_with_photos.py", path),
)

KINDS = {
    "lint": Kind(
        "Style, formatting, and the arrows of the architecture.",
        {"lint": [("ruff", "check", "."), ("ruff", "format", "--check", "."), ("lint-imports",)]},
        groups=("lint",),
        package=False,
    ),
    "types": Kind(
        "mypy --strict and pyright.",
        {"mypy": [("mypy", *CHECKED)], "pyright": [("pyright",)]},
        groups=("types", "test", "docs", "bench", "browser", "interop"),
    ),
    # m100link.testing needs pytest.
    "docs": Kind(
        "The manual: every warning is an error, every example in it is run.",
        {"docs": [sphinx("dummy"), sphinx("doctest")]},  # writing pages costs half as much again
        groups=("docs", "test"),
    ),
    "manual": Kind(
        "The same, and the manual as pages for a browser.",
        {"manual": [sphinx("html"), sphinx("doctest")]},
        groups=("docs", "test"),
    ),
    "quick": Kind(
        "Tests that are not slow, and some in real time: a flight for each front among them.",
        {
            **QUIET,
            # They wait for terminals, processes and a browser more than they compute.
            "smoke tests": [pytest(*workers(4), "-m", "smoke", *marked("smoke"))],
        },
        groups=("test", "browser", "interop"),
    ),
    "tests": Kind(
        "The test suite, slow tests too. `-- tests/session -x` gives pytest its arguments.",
        {
            "all tests": [pytest(*workers(2), "-m", "not pty", *VIRTUAL)],
            # They wait for terminals and processes more than they compute.
            "tests (pty)": [pytest(*workers(5), "-m", "pty", *marked("pty"))],
        },
        groups=("test",),
    ),
    "browser": Kind(
        "The console in Chromium; skipped with a reason where there is none.",
        {"browser": [pytest(*workers(2), "tests/browser")]},
        groups=("test", "browser"),
    ),
    "examples": Kind(
        "Every example program flies as a program, in real time.",
        {program: [("python", "-W", "error", program)] for program in PROGRAMS},
    ),
    "interop": Kind(
        "Programs of others, where they are: roslibpy, roslib, rosbridge_suite, Foxglove, tshark.",
        {"interop": [pytest("-rs", *elsewhere(MAVLINK, ROS2), "tests/interop")]},
        groups=("test", "interop"),
    ),
}
# What takes longest begins first; but in a new environment the first tests compile what all others
# import, and pyright, which imports nothing, is beside them meanwhile.
DEFAULT = ("types", "quick", "docs", "lint")
FULL = ("types", "manual", "lint", "examples")
COUNTED = ("tests", "browser", "interop")  # under coverage, so that `full` runs them once
# What flies in real time, and how many at once. Each of the first takes what it can get.
LANES = ((("smoke tests", "tests (pty)", "browser"), 1), ((*PROGRAMS, "interop"), 2))
# Flights leave half of the processors idle. These take what is left, and make way at once.
BESIDE = ("mypy", "docs")


@nox.session
def check(session: nox.Session) -> None:
    """What must be green before every commit: no test that is slow. Minutes."""
    run_kinds(session, *DEFAULT)


@nox.session(default=False)
def full(session: nox.Session) -> None:
    """Everything, on every Python that is installed: each night, and before a release. Hours."""
    run_kinds(session, *FULL)
    for name in ("coverage", "interop-mavlink", "interop-ros2", "newcomers"):
        session.notify(name)
    for version in PYTHONS:
        session.notify(f"pythons-{version}")


@nox.session(default=False)
def newest(session: nox.Session) -> None:
    """What `nox` runs, with the newest packages instead of the locked ones: each week."""
    run_kinds(session, *DEFAULT, locked=False)


@nox.session(default=False)
def affected(session: nox.Session) -> None:
    """All tests, slow ones too, that changes since a commit touch: `-- main`; or what waits."""
    install(session, PACKAGE, *group("test", "browser", "interop"))
    told = session.run("python", "-m", "tests.affected", *session.posargs, silent=True)
    if not (files := str(told).split()):
        session.skip("no test can tell the difference")
    session.run(*pytest(*workers(2), *files))


def of_kind(name: str) -> Callable[[nox.Session], None]:
    """The session of one kind of check, which gives pytest what the command line adds."""

    def session_of_it(session: nox.Session) -> None:
        if name == "tests" and session.posargs:
            install(session, PACKAGE, *group("test"))
            session.run(*pytest(*session.posargs))
        else:
            run_kinds(session, name)

    session_of_it.__doc__ = KINDS[name].about
    return session_of_it


for _name in KINDS:
    nox.session(name=_name, default=False)(of_kind(_name))


def tool(name: str, about: str, *lines: str | Line, groups: str = "", **env: str) -> None:
    """A session of programs that run alone, for minutes or hours.

    Args:
        name: Of the session.
        about: What `nox --list` says of it.
        lines: Commands, or modules to run; the command line adds its arguments to the first.
        groups: Dependency groups that they need beside those of the tests.
        env: Variables of their environment.
    """

    def session_of_it(session: nox.Session) -> None:
        # This one is in no group: it has wheels for few systems.
        rare = ["atheris>=3"] if "atheris" in session.posargs else []
        install(session, PACKAGE, *group("test", *groups.split()), *rare)
        for line in lines:
            command = ("python", "-m", line) if isinstance(line, str) else line
            session.run(*command, *(session.posargs if line is lines[0] else ()), env=env)

    session_of_it.__doc__ = about
    nox.session(name=name, default=False)(session_of_it)


SLOW = "Measure which tests are slow, and write tests/slow.txt; on a quiet machine."
BRIDGE = "MAVSDK in both its kinds and pymavlink fly through the bridge; 30 min, real time."
NODE = "rclpy of Jazzy and Kilted, zenoh-ros2-sdk and plain zenoh fly the node; 40 min, real time."
UVLOOP = "The tests of the link on real ports and sockets, on uvloop's event loop."
MUTATION = "Changes to the code that no test notices; minutes to hours. `-- wire` for one room."
FAULTS = "What bad lines make of reliable commands, as a table; an hour. `-- --commands 1000` less."
ORDERS = "Orders to a fleet in bad weather, and over cut cables to an agent that is killed."
FUZZ = "Mutated inputs for whatever reads bytes of others; half an hour. `-- --engine atheris`."
SOAK = "A simulated day, a real hour, a thousand connections: nothing grows. `-- --seconds 600`."
THOUSAND = "A thousand aircraft of a fleet for ten minutes, real time. `-- --seconds 60` less."
NEWCOMERS = "Tutorials from an empty environment, real time; half an hour. `-- fleet` for one."
BENCH = "The benchmarks, beside their rivals on the same machine; `-- frames` for one program."
BUILD = "Source archive, wheel (the same bit by bit when built again), and its bill of materials."
measured = pytest(*workers(2), "-m", "not pty", *VIRTUAL)
on_uvloop = pytest("-m", "pty", "tests/link")
tool("slow", SLOW, measured, M100LINK_WRITE_SLOW="1")
tool("uvloop", UVLOOP, on_uvloop, groups="uvloop", M100LINK_TESTS_ON_UVLOOP="1")
tool("interop-mavlink", BRIDGE, pytest(MAVLINK), groups="interop-mavlink")
tool("interop-ros2", NODE, pytest(ROS2), groups="interop-ros2")
tool("mutation", MUTATION, "tests.mutation", groups="mutation")
tool("faults", FAULTS, "tests.faults.matrix")
tool("orders", ORDERS, "tests.faults.fleet_orders", "tests.faults.fleet_kills")
tool("fuzz", FUZZ, "tests.fuzz.run")
tool("soak", SOAK, "tests.soak.run")
tool("thousand", THOUSAND, "tests.soak.fleet")
tool("newcomers", NEWCOMERS, "tests.tutorials")
tool("bench", BENCH, "benchmarks", groups="bench browser uvloop")
tool("build", BUILD, "tests.release", groups="release")


@nox.session(python="3.14" if shutil.which("python3.14") else None, default=False)
def coverage(session: nox.Session) -> None:
    """All tests with their branches counted, which takes twice as long before Python 3.14."""
    for old in Path().glob(".coverage*"):
        old.unlink()
    try:
        run_kinds(session, *COUNTED, under=("coverage", "run", "-m"))
    finally:
        session.run("coverage", "combine", "--quiet")
        for torn in Path().glob(".coverage.*"):  # of a process that was killed as it wrote
            torn.unlink()
        low = []
        floors = {room: floor for rooms, floor in COVERED.items() for room in rooms.split()}
        for room, floor in floors.items():
            asked = ("report", "--format=total", "--precision=2", f"--include=*/{room}/*")
            seen = float(str(session.run("coverage", *asked, silent=True)))
            session.log(f"{seen:6.2f} % of {room}, at least {floor}")
            low += [room] if seen < floor else []
        if low:
            session.error(f"covered less than before: {', '.join(low)}")


@nox.session(python=PYTHONS, default=False)
def pythons(session: nox.Session) -> None:
    """What nox tests, on other Pythons, where they are installed."""
    run_kinds(session, "quick")


@nox.session(default=False)
def minimum(session: nox.Session) -> None:
    """The test suite on the lowest versions that pyproject.toml allows."""
    declared = [*PYPROJECT["project"]["dependencies"], *(one for e in EXTRAS.values() for one in e)]
    lowest = (re.sub(r">=\s*", "==", requirement) for requirement in declared)
    run_kinds(session, "tests", also=tuple(lowest), locked=False)


@nox.session(python=PYTHONS, default=False)
def wheel(session: nox.Session) -> None:
    """The wheel in an environment with nothing else: names, command line, a flight."""
    install(session, ".[cli]")
    flight = Path("examples/first_flight.py").resolve()
    session.chdir(session.create_tmp())  # what is imported here, is installed
    session.run("m100link", "--version")
    session.run("m100link", "docs", "safety", silent=True)
    session.run("m100link", "decode", GET_VERSION)
    session.run("python", "-W", "error", str(flight))


@nox.session(default=False)
def audit(session: nox.Session) -> None:
    """Known vulnerabilities of what package and tests install; says so without a database."""
    install(session, PACKAGE, *group("audit", "test", "docs"))
    told = session.run("python", "-m", "tests.audit", *session.posargs, silent=True)
    if "nothing was audited" in str(told):
        session.skip(str(told).strip())
    session.log(str(told).strip())


def run_kinds(
    session: nox.Session, *names: str, also: Line = (), locked: bool = True, under: Line = ()
) -> None:
    """Kinds of checks, side by side in one environment; all end, whichever of them fails.

    Args:
        names: Of the kinds.
        also: What is installed besides.
        locked: In the versions of the lock.
        under: The command that runs every command.
    """
    kinds = [KINDS[name] for name in names]
    groups = sorted({name for kind in kinds for name in kind.groups})
    package = [PACKAGE] if any(kind.package for kind in kinds) else []
    install(session, *package, *group(*groups), *also, locked=locked)
    commands = {title: lines for kind in kinds for title, lines in kind.commands.items()}
    run_all(session, {t: [(*under, *line) for line in commands[t]] for t in commands})


def install(session: nox.Session, *requirements: str, locked: bool = True) -> None:
    """Install with uv, which takes a tenth of pip's time, or with pip where uv cannot be had.

    Args:
        locked: In the versions of the lock, whose checksums uv compares. pip does that for all
            packages or for none, and this one has no checksum: pip is given the versions alone.
    """
    afresh = ("--reinstall-package", "m100link")  # uv takes a tree for old that has the old version
    lock = Path(LOCK).resolve()
    wanted = (*requirements, *(("--constraint", str(lock)) if locked else ()))
    if session.venv_backend == "uv":
        session.install(*afresh, *wanted)
        return
    try:
        session.run_install("python", "-m", "pip", "install", "--quiet", "uv")
        environment = ("--python", str(Path(session.bin) / "python"))
        session.run_install("uv", "pip", "install", "--quiet", *environment, *afresh, *wanted)
    except CommandFailed:
        session.log("uv does not work here: pip takes its place, and compares no checksums")
        versions = Path(session.create_tmp(), LOCK).resolve()
        bare = re.sub(r" \\$|\n    --hash=\S+", "", lock.read_text("utf-8"), flags=re.MULTILINE)
        versions.write_text(bare, "utf-8")
        session.install(*requirements, *(("--constraint", str(versions)) if locked else ()))


def run_all(session: nox.Session, commands: Commands) -> None:
    """Run commands and print what each said when it ends; fail at the end.

    What computes comes first and is over before anything flies in real time, or has the priority of
    an idle machine: beside a type checker that had more, a flight came to stand for half a second,
    which its guards end. On a busy machine that priority is none: what has not ended beside the
    flights begins again after them. On one that is busy from the beginning, all that computes runs
    at once, in more processes, and so has more shares of the processors.
    """
    processors = os.cpu_count() or 1
    is_busy = idle_processors() < processors / 4
    if is_busy and commands.keys() >= QUIET.keys():
        commands = {t: commands[t] for t in commands if t not in QUIET} | BUSY
    lanes = [({t: commands[t] for t in ts if t in commands}, width) for ts, width in LANES]
    beside = {t: commands[t] for t in BESIDE if t in commands and not is_busy}
    apart = {title for lane, _ in lanes for title in lane} | beside.keys()
    computing = {t: commands[t] for t in commands if t not in apart}
    ended = side_by_side(session, (computing, len(commands) if is_busy else 1 + processors))
    if any(lane for lane, _ in lanes):
        ended |= side_by_side(session, *lanes, beside=beside)
    rest = {t: beside[t] for t in beside if t not in ended}
    ended |= side_by_side(session, (rest, len(BESIDE)))
    session.log("            on the clock, of the processors")
    for title, (is_good, lasted, taken) in ended.items():
        session.log(f"{'passed' if is_good else 'FAILED'} {lasted:8.0f} s {taken:8.0f} s  {title}")
    if failed := [title for title, (is_good, _, _) in ended.items() if not is_good]:
        session.error(f"failed: {', '.join(failed)}")


def idle_processors() -> float:
    """How many have nothing to do in this second, in which nothing of ours runs.

    The average load of the system still counts what has ended a minute ago.
    """
    if not (counters := Path("/proc/stat")).exists():  # Linux alone has them
        return math.inf
    before = int(counters.read_text("ascii").split()[4])
    time.sleep(1.0)
    passed = int(counters.read_text("ascii").split()[4]) - before
    return passed / os.sysconf("SC_CLK_TCK")


def side_by_side(
    session: nox.Session, *lanes: tuple[Commands, int], beside: Commands | None = None
) -> dict[str, Outcome]:
    """Run commands in lanes, so many of each at once: how each ended, by title.

    Args:
        lanes: Commands, and how many of them run at once.
        beside: What runs as long as these do, at the priority of an idle machine.
    """
    started: list[subprocess.Popen[str]] = []
    idlers: list[subprocess.Popen[str]] = []
    over = threading.Event()
    widths = (*(width for _, width in lanes), len(BESIDE))
    with contextlib.ExitStack() as stack:
        *pools, aside = (stack.enter_context(ThreadPoolExecutor(width)) for width in widths)
        running = {
            title: pool.submit(run_lines, session, started, lines)
            for pool, (commands, _) in zip(pools, lanes, strict=True)
            for title, lines in commands.items()
        }
        idle = {
            title: aside.submit(run_lines, session, idlers, lines, over)
            for title, lines in (beside or {}).items()
        }
        try:
            ended = {title: work.result() for title, work in running.items()}
            over.set()
            for process in idlers:
                process.terminate()  # at their priority, to unwind from Ctrl-C would take minutes
            ended |= {title: work.result() for title, work in idle.items()}
        except BaseException:  # Ctrl-C above all: nothing stays behind
            over.set()
            for pool in (*pools, aside):
                pool.shutdown(wait=False, cancel_futures=True)
            for process in started + idlers:
                process.send_signal(signal.SIGINT)  # pytest ends what its tests have begun
            raise
    return {title: outcome for title, outcome in ended.items() if outcome}


def run_lines(
    session: nox.Session,
    started: list[subprocess.Popen[str]],
    lines: list[Line],
    over: threading.Event | None = None,
) -> Outcome | None:
    """Run programs of the session's environment.

    Args:
        session: It says what they said.
        started: Each process is entered here.
        lines: The programs, one after another.
        over: They have the priority of an idle machine until this is set, and end then.

    Returns:
        How they ended; None where `over` was set before.
    """
    begun, taken = time.monotonic(), 0.0
    place = Path(session.bin)
    is_good = True
    for line in lines:
        session.log(" ".join(line))
        with subprocess.Popen(
            [place / line[0], *line[1:]],
            env=os.environ | {"PATH": f"{place}{os.pathsep}{os.environ['PATH']}"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        ) as process:
            started.append(process)
            if over and hasattr(os, "SCHED_IDLE"):
                os.sched_setscheduler(process.pid, os.SCHED_IDLE, os.sched_param(0))
            if over and over.is_set():
                process.terminate()
            assert process.stdout is not None
            output = process.stdout.read()
            _, status, used = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
        taken += used.ru_utime + used.ru_stime
        if over and over.is_set() and process.returncode:
            return None
        session.log(f"{' '.join(line)}: exit status {process.returncode}\n{output.rstrip()}")
        is_good &= process.returncode == 0
    return is_good, time.monotonic() - begun, taken
