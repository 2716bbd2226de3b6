"""What `nox` runs. Every session reads its packages from the dependency groups of pyproject.toml.

`nox` alone runs `check`: all kinds of checks that must be green (lint, types, docs, examples,
interop, browser, tests) in one environment, side by side. `nox -s lint` runs one kind in an
environment of its own. They use the Python that runs nox. `nox --list` names the others.
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
from dataclasses import dataclass
from pathlib import Path

import nox
from nox.command import CommandFailed

nox.needs_version = ">=2025.2.9"
nox.options.sessions = ["check"]
nox.options.reuse_venv = "yes"

# Hundreds of processes begin here: where the environment forbids bytecode, and uv leaves none, each
# of them would compile every package that it imports, for three times the cost of its start.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

PYPROJECT = nox.project.load_toml("pyproject.toml")
EXTRAS = PYPROJECT["project"].get("optional-dependencies", {})
PACKAGE = f".[{','.join(EXTRAS)}]"
DOCS_OUTPUT = "docs/_build"
# Branch coverage that `nox -s coverage` asks for, in percent.
COVERED = {"m100link/wire": 100, "m100link/session": 100, "m100link/protocol": 100, "m100link": 93}
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
        commands: By title. What stands under one runs in this order, to the end; titles depend on
            no other, so they run side by side.
        groups: Dependency groups that it needs.
        package: Whether it needs the package itself, installed as users install it.
    """

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


def without(*tests: str) -> list[str]:
    """Options of pytest that leave these tests out, and what their names begin with."""
    return [f"--deselect={test}" for test in tests]


OWN_SESSIONS = ("tests/interop", "tests/browser")
CONSOLE = "tests/browser/long"
MAVLINK = "tests/interop/mavlink"
ROS2 = "tests/interop/ros2"
FLEET = "tests/interop/fleet"
# It takes off by a page that each message reaches a second late: minutes on a busy machine.
SLOW_WAY = (
    "tests/browser/test_console.py::test_nobody_steers_with_a_second_each_way_and_the_page_says_why"
)
# Five to seven processes each, of which one is lost in flight; in `test_fleet.py` others are, too.
LEGS = "test_a_leg_that_is_cut_costs_a_hover_and_whoever_is_told_is_told_the_truth"
LONG_FLEET = ("tests/attacks/test_fleet_show.py", f"tests/attacks/test_fleet.py::{LEGS}")
# Their tests begin processes and wait for them.
SERVERS = ("tests/attacks", "tests/benchmarks", "tests/cli", "tests/station")
CHECKED = existing("m100link", "tests", "examples", "benchmarks", "noxfile.py", "docs/_ext")
# The longest flight begins first.
PROGRAMS = sorted(
    (*(str(path) for path in Path("examples").glob("*.py")), "examples/mavlink/square.py"),
    key=lambda path: (path != "examples/survey_with_photos.py", path),
)

KINDS = {
    "tests": Kind(
        {
            "tests": [pytest(*workers(2), "-m", "not pty", *elsewhere(*OWN_SESSIONS, *SERVERS))],
            "tests (servers)": [pytest(*workers(2), "-m", "not pty", *SERVERS)],
            # They wait for terminals and processes more than they compute.
            "tests (pty)": [
                pytest(*workers(5), "-m", "pty", *marked("pty"), *without(*LONG_FLEET))
            ],
        },
        groups=("test",),
    ),
    "browser": Kind(
        {
            "browser": [
                pytest(*workers(2), "tests/browser", *elsewhere(CONSOLE), *without(SLOW_WAY))
            ]
        },
        groups=("test", "browser"),
    ),
    "examples": Kind({program: [("python", "-W", "error", program)] for program in PROGRAMS}),
    # Beside rosbridge_suite's own library it has a session to itself.
    "interop": Kind(
        {
            "interop": [
                pytest(
                    "--ignore=tests/interop/test_rosbridge_library.py",
                    f"--ignore={MAVLINK}",
                    f"--ignore={ROS2}",
                    f"--ignore={FLEET}",
                    "tests/interop",
                )
            ]
        },
        groups=("test", "interop"),
    ),
    "types": Kind(
        {"mypy": [("mypy", *CHECKED)], "pyright": [("pyright",)]},
        groups=("types", "test", "docs", "bench", "browser", "interop"),
    ),
    # m100link.testing needs pytest.
    "docs": Kind({"docs": [sphinx("html"), sphinx("doctest")]}, groups=("docs", "test")),
    "lint": Kind(
        {"lint": [("ruff", "check", "."), ("ruff", "format", "--check", "."), ("lint-imports",)]},
        groups=("lint",),
        package=False,
    ),
}


@dataclass(frozen=True)
class Lane:
    """Commands that go the same way through the machine; lanes go side by side.

    Attributes:
        titles: In the order in which they begin; none: those that no other lane has.
        width: How many of them run at once.
        gives_way: Whether they only get the time of the processors that other lanes leave.
    """

    titles: tuple[str, ...]
    width: int
    gives_way: bool = False


# What keeps real time begins when nothing computes any more: beside a type checker a flight came to
# stand for half a second, which its guards end.
GIVING_WAY = ("nice", "-n", "10") if shutil.which("nice") else ()
LANES = (
    # Each of these takes what it can get: one after another.
    Lane(("tests (pty)", "browser"), 1),
    # One flight each.
    Lane((*PROGRAMS, "interop"), 2),
    Lane((), 1 + (os.cpu_count() or 1), gives_way=True),
)


@nox.session
def check(session: nox.Session) -> None:
    """All kinds of checks in one environment, side by side; all end, whichever of them fails."""
    install(session, PACKAGE, *group(*sorted({name for k in KINDS.values() for name in k.groups})))
    run_all(session, {title: c for kind in KINDS.values() for title, c in kind.commands.items()})


@nox.session(default=False)
def lint(session: nox.Session) -> None:
    """Style, formatting, and the arrows of the architecture."""
    run_kind(session, "lint")


@nox.session(default=False)
def types(session: nox.Session) -> None:
    """mypy --strict and pyright."""
    run_kind(session, "types")


@nox.session(default=False)
def docs(session: nox.Session) -> None:
    """The manual: every warning is an error, every example in it is run."""
    run_kind(session, "docs")


@nox.session(default=False)
def examples(session: nox.Session) -> None:
    """Every example program flies, against a virtual aircraft."""
    run_kind(session, "examples")


@nox.session(default=False)
def interop(session: nox.Session) -> None:
    """What others wrote: roslibpy, roslib where node is, Wireshark's tshark where that is."""
    run_kind(session, "interop")


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


@nox.session(name="interop-fleet", default=False)
def interop_fleet(session: nox.Session) -> None:
    """Plain zenoh sees a fleet, and its processes are killed and frozen in flight; real time."""
    install(session, PACKAGE, *group("test"))
    files = (FLEET, "tests/attacks/test_fleet.py", "tests/attacks/test_fleet_show.py")
    session.run(*pytest(*files, *session.posargs))


@nox.session(default=False)
def browser(session: nox.Session) -> None:
    """The console in Chromium; skipped with a reason where there is none."""
    run_kind(session, "browser")


@nox.session(default=False)
def console(session: nox.Session) -> None:
    """The console in Chromium at length: every size and input, and what is lost in flight."""
    install(session, PACKAGE, *group("test", "browser"))
    session.run(*pytest(CONSOLE, SLOW_WAY, *session.posargs))


@nox.session(default=False)
def tests(session: nox.Session) -> None:
    """The test suite. `-- tests/session -x` gives pytest its arguments."""
    if session.posargs:
        install(session, PACKAGE, *group("test"))
        session.run(*pytest(*session.posargs))
    else:
        run_kind(session, "tests")


@nox.session(default=False)
def coverage(session: nox.Session) -> None:
    """The test suite with branch coverage, which takes twice as long, and whether it suffices."""
    install(session, PACKAGE, *group("test"))
    counted = ("--cov", "--cov-report=", *session.posargs)
    session.run(*pytest(*workers(2), "-m", "not pty", *elsewhere(*OWN_SESSIONS), *counted))
    session.run(*pytest(*workers(5), "-m", "pty", *marked("pty"), *counted, "--cov-append"))
    for part, percent in COVERED.items():
        session.log(f"{part}: at least {percent} %")
        session.run("coverage", "report", f"--include=*/{part}/*", f"--fail-under={percent}")


@nox.session(python=PYTHONS, default=False)
def pythons(session: nox.Session) -> None:
    """The test suite on other Pythons, where they are installed."""
    install(session, PACKAGE, *group("test"))
    run_all(session, KINDS["tests"].commands)


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
    install(session, PACKAGE, *group("test"), *lowest)
    run_all(session, KINDS["tests"].commands)


def run_kind(session: nox.Session, name: str) -> None:
    """One kind of check in an environment of its own."""
    kind = KINDS[name]
    install(session, *([PACKAGE] if kind.package else []), *group(*kind.groups))
    run_all(session, kind.commands)


def install(session: nox.Session, *requirements: str) -> None:
    """Install with uv, which takes a tenth of pip's time, or with pip where uv cannot be had."""
    afresh = ("--reinstall-package", "m100link")  # uv takes a tree for old that has the old version
    if session.venv_backend == "uv":
        session.install(*afresh, *requirements)
        return
    try:
        session.run_install("python", "-m", "pip", "install", "--quiet", "uv")
        environment = ("--python", str(Path(session.bin) / "python"))
        session.run_install("uv", "pip", "install", "--quiet", *environment, *afresh, *requirements)
    except CommandFailed:
        session.log("uv does not work here: pip takes its place")
        session.install(*requirements)


def run_all(session: nox.Session, commands: dict[str, list[tuple[str, ...]]]) -> None:
    """Run commands and print what each said when it ends; fail at the end.

    What computes comes first and is over before anything flies in real time.
    """
    flying = {title for lane in LANES for title in lane.titles}
    ended: dict[str, tuple[bool, float]] = {}
    for flies in (False, True):
        chosen = {title: c for title, c in commands.items() if (title in flying) is flies}
        ended |= run_in_lanes(session, chosen)
    for title, (is_good, seconds) in ended.items():
        session.log(f"{'passed' if is_good else 'FAILED'} {seconds:4.0f} s  {title}")
    failed = [title for title, (is_good, _) in ended.items() if not is_good]
    if failed:
        session.error(f"failed: {', '.join(failed)}")


def run_in_lanes(
    session: nox.Session, commands: dict[str, list[tuple[str, ...]]]
) -> dict[str, tuple[bool, float]]:
    """Run commands in their lanes: by title, whether each was content, and after how long."""
    laid = {title for lane in LANES for title in lane.titles}
    ended: dict[str, tuple[bool, float]] = {}
    started: list[subprocess.Popen[str]] = []
    with contextlib.ExitStack() as stack:
        running: dict[concurrent.futures.Future[tuple[bool, float]], str] = {}
        pools: list[concurrent.futures.ThreadPoolExecutor] = []
        for lane in LANES:
            pool = stack.enter_context(concurrent.futures.ThreadPoolExecutor(lane.width))
            pools.append(pool)
            for title in lane.titles or [title for title in commands if title not in laid]:
                if title in commands:
                    before = GIVING_WAY if lane.gives_way else ()
                    work = pool.submit(run_lines, session, started, commands[title], before)
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
    before: tuple[str, ...],
) -> tuple[bool, float]:
    """Run programs of the session's environment; whether all were content, and after how long."""
    begun = time.monotonic()
    place = Path(session.bin)
    is_good = True
    for line in lines:
        session.log(" ".join(line))
        with subprocess.Popen(
            [*before, place / line[0], *line[1:]],
            env=os.environ | {"PATH": f"{place}{os.pathsep}{os.environ['PATH']}"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        ) as process:
            started.append(process)
            output, _ = process.communicate()
        session.log(f"{' '.join(line)}: exit status {process.returncode}\n{output.rstrip()}")
        is_good &= process.returncode == 0
    return is_good, time.monotonic() - begun


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
    """Mutated inputs for whatever reads bytes of others; half an hour. `-- --engine atheris`."""
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
