"""What `nox` runs. Every session reads its packages from the dependency groups of pyproject.toml.

`nox` alone runs `check`: lint, types, docs and every test that is not slow, side by side in one
environment. `nox -s full` runs everything. `nox -s lint` runs one kind in an environment of its
own. They use the Python that runs nox, and the versions of requirements-dev.txt. `nox --list` names
the others.
"""

from __future__ import annotations

import concurrent.futures
import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import tarfile
import time
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

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
    100: "wire session protocol errors",
    99: "missions telemetry",
    98: "link aircraft",
    97: "flight agent fleet sim log",
    96: "ros2 doctor",
    95: "bus",
    94: "mavlink",
    90: "sync",
    72: "station",
    70: "cli",
}
PYTHONS = ["3.11", "3.12", "3.13", "3.14"]
ROSBRIDGE_SUITE, ROSBRIDGE_RELEASE = "https://github.com/RobotWebTools/rosbridge_suite", "0.11.17"
ROS_PACKAGES = (
    "python3-rospy python3-rosmaster python3-rosservice python3-rostopic python3-bson python3-pil "
    "python3-std-msgs python3-std-srvs python3-sensor-msgs python3-geometry-msgs"
)
PAGES = ("CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")

# A version query in a frame, and a short flight, for the wheel.
GET_VERSION = "aa130001000000000500302e000000b493113d"
FLIGHT = """
import asyncio
from m100link import *
from m100link.sim import DEMO_APP_ID, DEMO_KEY, VirtualClockEventLoop

async def main():
    async with connect("sim://") as aircraft:
        await aircraft.activate(Credentials(app_id=DEMO_APP_ID, key=DEMO_KEY))
        async with aircraft.control() as control:
            await control.take_off()
            await control.fly_to(north=2.0, east=0.0, up=0.0)
            await control.land()
        print(aircraft.state.flight_status, aircraft.state.position)

with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
    runner.run(main())
"""


def group(*names: str) -> list[str]:
    """The packages of some dependency groups."""
    return list(nox.project.dependency_groups(PYPROJECT, *names))


def existing(*names: str) -> list[str]:
    """Those of the paths that exist."""
    return [name for name in names if Path(name).exists()]


def workers(count: int) -> tuple[str, ...]:
    """Options of pytest for so many processes; none of them keeps a cache that another writes."""
    return "-n", str(count), "--dist", "worksteal", "-p", "no:cacheprovider"


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
    commands: dict[str, list[tuple[str, ...]]]
    groups: tuple[str, ...] = ()
    package: bool = True


def pytest(*arguments: str) -> tuple[str, ...]:
    """A run of pytest on the installed package.

    Appending the tree to the path instead of prepending it leaves `import m100link` to that one.
    """
    return "pytest", "--import-mode=append", *arguments


def sphinx(builder: str) -> tuple[str, ...]:
    """A build of the manual in which every warning is an error; both builders read it once."""
    options = ("--nitpicky", "--fail-on-warning", "--keep-going", "--quiet")
    places = ("-d", f"{DOCS_OUTPUT}/doctrees", "docs", f"{DOCS_OUTPUT}/{builder}")
    return "sphinx-build", *options, "-b", builder, *places


def marked(mark: str, folder: str = "tests") -> list[str]:
    """Files with tests of a mark: to read all of them would take each process ten seconds."""
    files = sorted(Path(folder).rglob("test_*.py"))
    return [str(path) for path in files if f"pytest.mark.{mark}" in path.read_text("utf-8")]


def elsewhere(*folders: str) -> list[str]:
    """Options of pytest that leave these folders out."""
    return [f"--ignore={folder}" for folder in folders]


MAVLINK, ROS2 = "tests/interop/mavlink", "tests/interop/ros2"
ROSBRIDGE = "tests/interop/test_rosbridge_library.py"  # needs a library that no index has
VIRTUAL = elsewhere("tests/interop", "tests/browser")
CHECKED = existing("m100link", "tests", "examples", "benchmarks", "noxfile.py", "docs/_ext")
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
        {"docs": [sphinx("html"), sphinx("doctest")]},
        groups=("docs", "test"),
    ),
    "quick": Kind(
        "Tests that are not slow, and some in real time: a flight for each front among them.",
        {
            "tests": [pytest(*workers(2), "-m", "not slow and not smoke", *VIRTUAL)],
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
        "What others wrote: roslibpy, roslib where node is, Wireshark's tshark where that is.",
        {"interop": [pytest(*elsewhere(ROSBRIDGE, MAVLINK, ROS2), "tests/interop")]},
        groups=("test", "interop"),
    ),
}
# What takes longest begins first.
DEFAULT = ("quick", "types", "docs", "lint")
FULL = ("tests", "types", "docs", "lint", "browser", "examples", "interop")


@dataclass(frozen=True)
class Lane:
    """Commands that go the same way through the machine; lanes go side by side.

    Attributes:
        titles: In the order in which they begin; none: those that no other lane has.
        width: How many of them run at once.
    """

    titles: tuple[str, ...]
    width: int


LANES = (
    # Each of these takes what it can get: one after another.
    Lane(("smoke tests", "tests (pty)", "browser"), 1),
    # One flight each.
    Lane((*PROGRAMS, "interop"), 2),
    Lane((), 1 + (os.cpu_count() or 1)),
)


@nox.session
def check(session: nox.Session) -> None:
    """What must be green before every commit: no test that is slow. Minutes."""
    run_kinds(session, *DEFAULT)


@nox.session(default=False)
def full(session: nox.Session) -> None:
    """Everything, on every Python that is installed: each night, and before a release. Hours."""
    run_kinds(session, *FULL)
    for name in ("coverage", "interop-mavlink", "interop-ros2"):
        session.notify(name)
    for version in PYTHONS:
        session.notify(f"pythons-{version}")


@nox.session(default=False)
def newest(session: nox.Session) -> None:
    """What `nox` runs, with the newest packages instead of the locked ones: each week."""
    run_kinds(session, *DEFAULT, locked=False)


@nox.session(default=False)
def affected(session: nox.Session) -> None:
    """All tests, slow ones too, of files that changed since a commit: `-- main`; or what waits."""
    install(session, PACKAGE, *group("test", "browser", "interop"))
    told = session.run("python", "-m", "tests.affected", *session.posargs, silent=True)
    if files := str(told).split():
        session.run(*pytest(*workers(2), *files))


@nox.session(default=False)
def slow(session: nox.Session) -> None:
    """Measure which tests are slow, and write tests/slow.txt; on a quiet machine."""
    install(session, PACKAGE, *group("test"))
    measured = pytest(*workers(2), "-m", "not pty", *VIRTUAL)
    session.run(*measured, env={"M100LINK_WRITE_SLOW": "1"})


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


@nox.session(name="interop-mavlink", default=False)
def interop_mavlink(session: nox.Session) -> None:
    """MAVSDK in both its kinds and pymavlink fly through the bridge; 30 min, real time."""
    install(session, PACKAGE, *group("test", "interop-mavlink"))
    session.run(*pytest(MAVLINK, *session.posargs))


@nox.session(name="interop-ros2", default=False)
def interop_ros2(session: nox.Session) -> None:
    """zenoh-ros2-sdk and plain zenoh fly the node, and are killed in flight; 10 min, real time."""
    install(session, PACKAGE, *group("test", "interop-ros2"))
    session.run(*pytest(ROS2, *session.posargs))


@nox.session(default=False)
def coverage(session: nox.Session) -> None:
    """The test suite with branch coverage, which takes twice as long, and whether it suffices."""
    install(session, PACKAGE, *group("test"))
    counted = ("--cov", "--cov-report=", *session.posargs)
    session.run(*pytest(*workers(2), "-m", "not pty", *VIRTUAL, *counted))
    session.run(*pytest(*workers(5), "-m", "pty", *marked("pty"), *counted, "--cov-append"))
    session.run("coverage", "combine", "--append", success_codes=[0, 1])  # 1: pytest has done it
    session.run("coverage", "report", "--fail-under=90")
    for percent, rooms in COVERED.items():
        for room in rooms.split():
            place = f"*/m100link/{room}/*"
            session.run("coverage", "report", f"--include={place}", f"--fail-under={percent}")


@nox.session(python=PYTHONS, default=False)
def pythons(session: nox.Session) -> None:
    """The test suite on other Pythons, where they are installed."""
    install(session, PACKAGE, *group("test"))
    run_all(session, KINDS["quick"].commands)


@nox.session(python=PYTHONS, default=False)
def wheel(session: nox.Session) -> None:
    """The wheel in an environment with nothing else: names, command line, a flight."""
    install(session, ".[cli]")
    session.chdir(session.create_tmp())  # what is imported here, is installed
    session.run("m100link", "--version")
    session.run("m100link", "docs", "safety", silent=True)
    session.run("m100link", "decode", GET_VERSION)
    session.run("python", "-W", "error", "-c", FLIGHT)


@nox.session(default=False)
def minimum(session: nox.Session) -> None:
    """The test suite on the lowest versions that pyproject.toml allows."""
    declared = [*PYPROJECT["project"]["dependencies"], *(one for e in EXTRAS.values() for one in e)]
    lowest = [re.sub(r">=\s*", "==", requirement) for requirement in declared]
    install(session, PACKAGE, *group("test"), *lowest, locked=False)
    run_all(session, KINDS["tests"].commands)


class Outcome(NamedTuple):
    """How commands ended: whether well, after how long, and what that took of the processors."""

    is_good: bool
    lasted_s: float
    taken_s: float


def run_kinds(session: nox.Session, *names: str, locked: bool = True) -> None:
    """Kinds of checks, side by side in one environment; all end, whichever of them fails."""
    kinds = [KINDS[name] for name in names]
    groups = sorted({name for kind in kinds for name in kind.groups})
    package = [PACKAGE] if any(kind.package for kind in kinds) else []
    install(session, *package, *group(*groups), locked=locked)
    run_all(session, {title: lines for kind in kinds for title, lines in kind.commands.items()})


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


def run_all(session: nox.Session, commands: dict[str, list[tuple[str, ...]]]) -> None:
    """Run commands and print what each said when it ends; fail at the end.

    What computes comes first and is over before anything flies in real time: beside a type checker
    a flight came to stand for half a second, which its guards end.
    """
    flying = {title for lane in LANES for title in lane.titles}
    ended: dict[str, Outcome] = {}
    for flies in (False, True):
        chosen = {title: c for title, c in commands.items() if (title in flying) is flies}
        ended |= run_in_lanes(session, chosen)
    session.log("            on the clock, of the processors")
    for title, (is_good, lasted, taken) in ended.items():
        session.log(f"{'passed' if is_good else 'FAILED'} {lasted:8.0f} s {taken:8.0f} s  {title}")
    failed = [title for title, outcome in ended.items() if not outcome.is_good]
    if failed:
        session.error(f"failed: {', '.join(failed)}")


def run_in_lanes(
    session: nox.Session, commands: dict[str, list[tuple[str, ...]]]
) -> dict[str, Outcome]:
    """Run commands in their lanes: how each ended, by title."""
    laid = {title for lane in LANES for title in lane.titles}
    ended: dict[str, Outcome] = {}
    started: list[subprocess.Popen[str]] = []
    with contextlib.ExitStack() as stack:
        running: dict[concurrent.futures.Future[Outcome], str] = {}
        pools: list[concurrent.futures.ThreadPoolExecutor] = []
        for lane in LANES:
            pool = stack.enter_context(concurrent.futures.ThreadPoolExecutor(lane.width))
            pools.append(pool)
            for title in lane.titles or [title for title in commands if title not in laid]:
                if title in commands:
                    work = pool.submit(run_lines, session, started, commands[title])
                    running[work] = title
        try:
            for done in concurrent.futures.as_completed(running):
                ended[running[done]] = done.result()
        except BaseException:  # Ctrl-C above all: nothing stays behind
            for pool in pools:
                pool.shutdown(wait=False, cancel_futures=True)
            for process in started:
                process.send_signal(signal.SIGINT)  # pytest ends what its tests have begun
            raise
    return ended


def run_lines(
    session: nox.Session,
    started: list[subprocess.Popen[str]],
    lines: list[tuple[str, ...]],
) -> Outcome:
    """Run programs of the session's environment."""
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
            assert process.stdout is not None
            output = process.stdout.read()
            _, status, used = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
        taken += used.ru_utime + used.ru_stime
        session.log(f"{' '.join(line)}: exit status {process.returncode}\n{output.rstrip()}")
        is_good &= process.returncode == 0
    return Outcome(is_good, time.monotonic() - begun, taken)


@nox.session(default=False)
def foxglove(session: nox.Session) -> None:
    """Foxglove's reader of logs and its client of live flights, both by npm."""
    if not (shutil.which("npm") and shutil.which("node")):
        session.skip("node and npm are not installed")
    place = Path(session.create_tmp())
    packages = ("ws-protocol", "wasm-zstd")
    wanted = ("ws", "@mcap/core", "@mcap/nodejs", *(f"@foxglove/{one}" for one in packages))
    session.run("npm", "install", "--silent", "--prefix", str(place), *wanted, external=True)
    install(session, PACKAGE, *group("test"))
    modules = {"FOXGLOVE_MODULES": str(place / "node_modules")}
    session.run(*pytest("tests/interop/test_foxglove.py"), env=modules)


@nox.session(default=False)
def rosbridge(session: nox.Session) -> None:
    """The station beside rosbridge_suite's own library. Needs a Python with rospy: ROS_PYTHON.

    ROSBRIDGE_LIBRARY names the folder that holds the package `rosbridge_library`; without it the
    release is fetched by git.
    """
    python = os.environ.get("ROS_PYTHON", "/usr/bin/python3")
    modules = "rospy, rosmaster, rosservice, rostopic, bson, PIL, std_msgs, std_srvs, sensor_msgs"
    needed = [python, "-c", f"import {modules}, geometry_msgs, rosgraph_msgs"]
    if not Path(python).exists() or subprocess.run(needed, check=False).returncode:
        session.skip(f"{python} does not import {modules}, …: on Debian {ROS_PACKAGES}")
    library = os.environ.get("ROSBRIDGE_LIBRARY", "")
    if not library:
        there = Path(session.create_tmp()) / "rosbridge_suite"
        if not there.exists():
            clone = ("git", "clone", "--quiet", "--depth", "1", "--branch", ROSBRIDGE_RELEASE)
            session.run(*clone, ROSBRIDGE_SUITE, str(there), external=True)
        library = str((there / "rosbridge_library" / "src").resolve())
    install(session, PACKAGE, *group("test"))
    session.run(
        *("pytest", "--import-mode=append", "tests/interop/test_rosbridge_library.py"),
        *session.posargs,
        env={"ROSBRIDGE_LIBRARY": library, "ROS_PYTHON": python},
    )


@nox.session(default=False)
def mutation(session: nox.Session) -> None:
    """Changes to the code that no test notices; takes minutes to hours. `-- wire` for one room."""
    session.install(PACKAGE, *group("test", "mutation"))
    session.run("python", "-m", "tests.mutation", *session.posargs)


@nox.session(default=False)
def faults(session: nox.Session) -> None:
    """What bad lines make of reliable commands, as a table; an hour. `-- --commands 1000` less."""
    install(session, PACKAGE, *group("test"))
    session.run("python", "-m", "tests.faults.matrix", *session.posargs)


@nox.session(default=False)
def orders(session: nox.Session) -> None:
    """Orders to a fleet in bad weather, and over cables that are cut to an agent that is killed."""
    install(session, PACKAGE, *group("test"))
    session.run("python", "-m", "tests.faults.fleet_orders", *session.posargs)
    session.run("python", "-m", "tests.faults.fleet_kills")


@nox.session(default=False)
def fuzz(session: nox.Session) -> None:
    """Mutated inputs for whatever reads bytes of others; an hour. `-- --engine atheris`."""
    install(session, PACKAGE, *group("test"))
    if "atheris" in session.posargs:
        session.install("atheris>=3")  # in no group: it has wheels for few systems
    session.run("python", "-m", "tests.fuzz.run", *session.posargs)


@nox.session(default=False)
def soak(session: nox.Session) -> None:
    """A simulated day, a real hour, a thousand connections: nothing grows. `-- --seconds 600`."""
    install(session, PACKAGE, *group("test"))
    session.run("python", "-m", "tests.soak.run", *session.posargs)


@nox.session(default=False)
def thousand(session: nox.Session) -> None:
    """A thousand aircraft of a fleet for ten minutes, real time. `-- --seconds 60` less."""
    install(session, PACKAGE, *group("test"))
    session.run("python", "-m", "tests.soak.fleet", *session.posargs)


@nox.session(default=False)
def uvloop(session: nox.Session) -> None:
    """The tests of the link on real ports and sockets, on uvloop's event loop."""
    session.install(PACKAGE, *group("test", "uvloop"))
    on_uvloop = {"M100LINK_TESTS_ON_UVLOOP": "1"}
    session.run(
        *("pytest", "--import-mode=append", "-m", "pty", "tests/link"),
        *session.posargs,
        env=on_uvloop,
    )


@nox.session(default=False)
def bench(session: nox.Session) -> None:
    """The benchmarks, beside their rivals on the same machine; `-- frames` for one program."""
    session.install("-e", PACKAGE, *group("bench", "browser", "uvloop"))
    session.run("python", "-m", "benchmarks", *session.posargs)


@nox.session(default=False)
def audit(session: nox.Session) -> None:
    """Known vulnerabilities of what package and tests install; says so without a database."""
    install(session, PACKAGE, *group("audit", "test", "docs"))
    asked = ("pip-audit", "--local", "--skip-editable", "--progress-spinner", "off", "-f", "json")
    done = subprocess.run(
        [Path(session.bin) / asked[0], *asked[1:], *session.posargs],
        capture_output=True,
        text=True,
        check=False,
    )
    try:
        packages = json.loads(done.stdout)["dependencies"]
    except ValueError:
        session.log(done.stderr.strip())
        packages = []
    # Of a package that its database does not answer for it says so and ends with 0 all the same.
    audited = [package for package in packages if "vulns" in package]
    if not any(package["name"] == "cryptography" for package in audited):
        session.skip("the database of vulnerabilities cannot be reached here: nothing was audited")
    session.log(f"{len(audited)} packages audited, {len(packages) - len(audited)} skipped")
    found = [
        f"{package['name']} {package['version']}: {one['id']}"
        for package in audited
        for one in package["vulns"]
    ]
    if found:
        session.error("known vulnerabilities: " + ", ".join(found))


def built(session: nox.Session, output: Path) -> tuple[Path, Path]:
    """Wheel and source archive, made afresh in a folder."""
    for old in output.glob("m100link-*"):
        old.unlink()
    made_at = subprocess.run(
        ("git", "log", "-1", "--format=%ct"), capture_output=True, text=True, check=False
    ).stdout.strip()
    session.run(
        *("python", "-m", "build", "--no-isolation", "--outdir", str(output)),
        silent=True,
        env={"SOURCE_DATE_EPOCH": os.environ.get("SOURCE_DATE_EPOCH", made_at or "1700000000")},
    )
    (wheel,) = output.glob("*.whl")
    (archive,) = output.glob("*.tar.gz")
    return wheel, archive


def bill_of_materials(session: nox.Session, wheel: Path) -> None:
    """A CycloneDX bill of what an installation of the wheel with all extras consists of."""
    place = wheel.parent / "installed"
    session.run("python", "-m", "venv", "--clear", "--without-pip", str(place))
    python = str(place / "bin" / "python")
    wanted = f"{wheel}[{','.join(EXTRAS)}]"
    session.run("python", "-m", "pip", "--quiet", "--python", python, "install", wanted)
    bill = wheel.with_suffix(".cdx.json")
    session.run(
        *("cyclonedx-py", "environment", python, "--pyproject", "pyproject.toml"),
        *("--output-reproducible", "--output-format", "JSON", "--output-file", str(bill)),
    )
    shutil.rmtree(place)
    components = json.loads(bill.read_text("utf-8"))["components"]
    names = {component["name"].lower() for component in components}
    missing = {"anyio", "cryptography", "pyserial-asyncio"} - names
    if missing:
        session.error(f"the bill of materials lacks {missing}")
    session.log(f"{bill.name}: {len(components)} components")


@nox.session(default=False)
def build(session: nox.Session) -> None:
    """Source archive, wheel (the same bit by bit when built again), and its bill of materials."""
    # What Sphinx needs is here, so that the manual in the wheel has every table and class.
    session.install(PACKAGE, *group("release", "docs", "test"))
    output = Path(session.create_tmp()) / "dist"
    wheel, archive = built(session, output)
    again, _ = built(session, output.with_name("again"))
    if wheel.read_bytes() != again.read_bytes():
        session.error("the wheel was another one when it was built again")
    bill_of_materials(session, wheel)
    with zipfile.ZipFile(wheel) as packed:
        in_wheel = packed.namelist()
    with tarfile.open(archive) as tarred:
        in_archive = [name.partition("/")[2] for name in tarred.getnames()]
    strangers = [n for n in in_wheel if not re.match(r"m100link(-[^/]+\.dist-info)?/", n)]
    if "m100link/py.typed" not in in_wheel:
        session.error("the wheel has no py.typed")
    if strangers:
        session.error(f"the wheel holds more than the package: {strangers}")
    if "m100link/manual/explanation/safety.txt" not in in_wheel:
        session.error("the wheel has no manual, or one that Sphinx did not make")
    missing = {"LICENSE", "README.md", "noxfile.py", *PAGES} - set(in_archive)
    if missing:
        session.error(f"the source archive lacks {missing}")
    session.log(f"{wheel.name}: {len(in_wheel)} files; {archive.name}: {len(in_archive)} entries")
