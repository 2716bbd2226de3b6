"""What `nox` runs. Every session reads its packages from the dependency groups of pyproject.toml.

`nox` alone runs the sessions that must be green: lint, types, docs, examples, interop, browser and
tests. They use the Python that runs nox. `nox --list` names the others.
"""

from __future__ import annotations

import concurrent.futures
import re
import subprocess
import tarfile
import zipfile
from functools import partial
from pathlib import Path

import nox

nox.needs_version = ">=2025.2.9"
# Tests come last, so that a run ends with what they have to say.
nox.options.sessions = ["lint", "types", "docs", "examples", "interop", "browser", "tests"]
nox.options.reuse_venv = "yes"

PYPROJECT = nox.project.load_toml("pyproject.toml")
EXTRAS = PYPROJECT["project"].get("optional-dependencies", {})
PACKAGE = f".[{','.join(EXTRAS)}]"
DOCS_OUTPUT = "docs/_build"
# Branch coverage that `nox -s coverage` asks for, in percent.
COVERED = {"m100link/wire": 100, "m100link/session": 100, "m100link/protocol": 100, "m100link": 93}
PAGES = ("CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")
PARALLEL = ("-n", "2", "--dist", "worksteal")


def group(*names: str) -> list[str]:
    """The packages of some dependency groups."""
    return list(nox.project.dependency_groups(PYPROJECT, *names))


def existing(*names: str) -> list[str]:
    """Those of the paths that exist."""
    return [name for name in names if Path(name).exists()]


@nox.session
def lint(session: nox.Session) -> None:
    """Style, formatting, and the arrows of the architecture."""
    session.install(*group("lint"))
    session.run("ruff", "check", ".")
    session.run("ruff", "format", "--check", ".")
    session.run("lint-imports")


@nox.session
def types(session: nox.Session) -> None:
    """mypy --strict and pyright."""
    session.install("-e", PACKAGE, *group("types", "test", "docs", "bench", "browser", "interop"))
    checked = existing("m100link", "tests", "examples", "benchmarks", "noxfile.py", "docs/_ext")
    session.run("mypy", *checked)
    session.run("pyright", "--pythonpath", f"{session.bin}/python")


@nox.session
def docs(session: nox.Session) -> None:
    """The manual: every warning is an error, every example in it is run."""
    session.install(PACKAGE, *group("docs", "test"))  # m100link.testing needs pytest
    options = ("--nitpicky", "--fail-on-warning", "--keep-going", "--quiet")
    for builder in ("html", "doctest"):
        session.run("sphinx-build", *options, "-b", builder, "docs", f"{DOCS_OUTPUT}/{builder}")


@nox.session
def examples(session: nox.Session) -> None:
    """Every example program flies, against a virtual aircraft."""
    session.install(PACKAGE)
    programs = sorted(Path("examples").glob("*.py"))
    # They fly in real time and mostly wait: side by side they take as long as the longest.
    with concurrent.futures.ThreadPoolExecutor(len(programs)) as pool:
        ends = list(pool.map(partial(fly, f"{session.bin}/python"), programs))
    for program, (status, output) in zip(programs, ends, strict=True):
        session.log(f"{program}: exit status {status}\n{output}")
    if any(status for status, _ in ends):
        session.error("an example failed")


def fly(python: str, program: Path) -> tuple[int, str]:
    """Exit status of an example program, and the end of what it printed."""
    ended = subprocess.run(
        [python, "-W", "error", str(program)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=180,
        check=False,
    )
    return ended.returncode, "\n".join(ended.stdout.splitlines()[-4:])


@nox.session
def tests(session: nox.Session) -> None:
    """The test suite on the installed package.

    What keeps real time over a pseudo-terminal mostly waits, what runs on virtual time never does:
    each kind has the processors to itself.
    """
    run_tests(session, *PARALLEL, "-m", "pty")
    run_tests(session, *PARALLEL, "-m", "not pty")


@nox.session(default=False)
def coverage(session: nox.Session) -> None:
    """The test suite with branch coverage, which takes twice as long, and whether it suffices."""
    run_tests(session, "--cov", "--cov-report=")
    for part, percent in COVERED.items():
        session.log(f"{part}: at least {percent} %")
        session.run("coverage", "report", f"--include=*/{part}/*", f"--fail-under={percent}")


@nox.session(python=["3.11", "3.12", "3.13", "3.14"], default=False)
def pythons(session: nox.Session) -> None:
    """The test suite on other Pythons, where they are installed."""
    run_tests(session)


@nox.session(default=False)
def minimum(session: nox.Session) -> None:
    """The test suite on the lowest versions that pyproject.toml allows."""
    declared = [*PYPROJECT["project"]["dependencies"], *(one for e in EXTRAS.values() for one in e)]
    lowest = [re.sub(r">=\s*", "==", requirement) for requirement in declared]
    run_tests(session, constrained_to=lowest)


def run_tests(session: nox.Session, *options: str, constrained_to: list[str] | None = None) -> None:
    """Install as a user would, with the extras, and run pytest."""
    session.install(PACKAGE, *group("test"), *(constrained_to or []))
    # Appending the tree to the path instead of prepending it leaves `import m100link` to the
    # installed package.
    own_sessions = ("--ignore=tests/interop", "--ignore=tests/browser")
    session.run("pytest", "--import-mode=append", *own_sessions, *options, *session.posargs)


@nox.session
def interop(session: nox.Session) -> None:
    """The ground station and clients that others wrote: roslibpy, and roslib where node is."""
    session.install(PACKAGE, *group("test", "interop"))
    session.run("pytest", "--import-mode=append", "tests/interop", *session.posargs)


@nox.session
def browser(session: nox.Session) -> None:
    """The console in Chromium; skipped with a reason where there is none."""
    session.install(PACKAGE, *group("test", "browser"))
    session.run("pytest", "--import-mode=append", *PARALLEL, "tests/browser", *session.posargs)


@nox.session(default=False)
def mutation(session: nox.Session) -> None:
    """Changes to the code that no test notices; takes minutes to hours. `-- wire` for one room."""
    session.install(PACKAGE, *group("test", "mutation"))
    session.run("python", "-m", "tests.mutation", *session.posargs)


@nox.session(default=False)
def bench(session: nox.Session) -> None:
    """The benchmarks, beside their rivals on the same machine; `-- frames` for one program."""
    session.install("-e", PACKAGE, *group("bench"))
    session.run("python", "-m", "benchmarks.ticks")
    session.run("python", "-m", "benchmarks", *session.posargs)


@nox.session(default=False)
def build(session: nox.Session) -> None:
    """Source archive and wheel, and whether the right files are in them."""
    session.install("build")
    output = Path(session.create_tmp()) / "dist"
    for old in output.glob("m100link-*"):
        old.unlink()
    session.run("python", "-m", "build", "--outdir", str(output), silent=True)
    (wheel,) = output.glob("*.whl")
    (archive,) = output.glob("*.tar.gz")
    with zipfile.ZipFile(wheel) as packed:
        in_wheel = packed.namelist()
    with tarfile.open(archive) as tarred:
        in_archive = [name.partition("/")[2] for name in tarred.getnames()]
    strangers = [n for n in in_wheel if not re.match(r"m100link(-[^/]+\.dist-info)?/", n)]
    if "m100link/py.typed" not in in_wheel:
        session.error("the wheel has no py.typed")
    if strangers:
        session.error(f"the wheel holds more than the package: {strangers}")
    missing = {"LICENSE", "README.md", "noxfile.py", *PAGES} - set(in_archive)
    if missing:
        session.error(f"the source archive lacks {missing}")
    session.log(f"{wheel.name}: {len(in_wheel)} files; {archive.name}: {len(in_archive)} entries")
