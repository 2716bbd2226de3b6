"""What the project promises about itself: its commands, its names, its error tree, its files."""

from __future__ import annotations

import ast
import asyncio
import importlib.resources
import importlib.util
import inspect
import os
import re
import shutil
import stat
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import m100link
from m100link import errors
from m100link.apps.cli.app import app as cli
from m100link.apps.fleet.pki import _UNIT
from m100link.errors.usage import INSTALL
from m100link.protocol import records
from m100link.sim import VirtualClockEventLoop
from tests import audit, release
from tests.speeds import slow

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))

FLY = "python3 -m venv .venv && .venv/bin/pip install '.[cli,log]' && .venv/bin/m100link demo"
TEST = "python3 -m venv .venv && .venv/bin/pip install nox && .venv/bin/nox"


def code_blocks(text: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


def test_readme_shows_one_sentence_and_two_commands_before_any_prose() -> None:
    title, sentence, *rest = [block for block in README.split("\n\n") if block]
    assert title == "# m100link"
    assert sentence.count(".") == 1
    commands = code_blocks(README, "sh")
    assert commands == [FLY + "\n", TEST + "\n"]
    before = "\n\n".join(rest)[: "\n\n".join(rest).index(TEST)]
    prose = [
        line for line in before.splitlines() if line and not line.startswith(("```", "python3"))
    ]
    assert all(line.endswith(":") and len(line) < 60 for line in prose), prose


@pytest.mark.parametrize("page", sorted((ROOT / "docs").rglob("*.md")), ids=lambda page: page.stem)
def test_programs_of_the_manual_are_python(page: Path) -> None:
    """Doctest runs the others; a program for hardware or a foreign package is run nowhere else."""
    for program in code_blocks(page.read_text("utf-8"), "python"):
        compile(program, str(page), "exec", ast.PyCF_ALLOW_TOP_LEVEL_AWAIT | ast.PyCF_ONLY_AST)


def test_readme_program_prints_what_readme_says(capsys: pytest.CaptureFixture[str]) -> None:
    [program] = code_blocks(README, "python")
    [expected] = code_blocks(README, "text")
    source, _, call = program.strip().rpartition("\n")
    assert call == "asyncio.run(main())"
    namespace: dict[str, object] = {}
    exec(compile(source, "README.md", "exec"), namespace)
    main = namespace["main"]
    assert inspect.iscoroutinefunction(main)
    with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
        runner.run(main())
    assert capsys.readouterr().out == expected


@pytest.mark.parametrize("page", ["README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md"])
def test_links_of_the_front_pages_lead_somewhere(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    targets = re.findall(r"\]\(([^)#]+)", text)
    assert targets
    missing = [t for t in targets if "://" not in t and not (ROOT / t).exists()]
    assert not missing


def test_what_a_contributor_needs_is_in_the_source_archive() -> None:
    packed = PYPROJECT["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
    pages = {f"/{page.name}" for page in ROOT.glob("*.md")}
    assert pages <= set(packed)


def test_sessions_and_groups_that_contributors_read_of_exist() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    program = (ROOT / "noxfile.py").read_text(encoding="utf-8")
    commands = "\n".join(code_blocks(text, "sh"))
    functions = set(re.findall(r"^def (\w+)\(session: nox", program, re.MULTILINE))
    tools = set(re.findall(r'^tool\(\s*"([\w-]+)"', program, re.MULTILINE))
    folders = (ROOT / name for name in ("docs", "m100link", "tests"))
    pages = [*ROOT.glob("*.md"), *(page for place in folders for page in place.rglob("*.[mp][dy]"))]
    told = "".join(page.read_text("utf-8") for page in pages if "_build" not in page.parts)
    named = set(re.findall(r"nox -s ([a-z][a-z0-9-]*)", told))
    assert {"affected", "soak", "lint"} <= named <= functions | tools | kinds(program)
    assert set(re.findall(r"--group (\w+)", commands)) <= set(PYPROJECT["dependency-groups"])
    for path in re.findall(r"pytest (tests/\S+)", commands):
        assert (ROOT / path).exists(), path


def test_verbs_that_the_readme_names_exist() -> None:
    [line] = re.findall(r"^- A command line: (.*)$", README, re.MULTILINE)
    named = {word.removeprefix("m100link ") for word in re.findall(r"`([^`]+)`", line)}
    assert named
    assert named <= set(cli)


def test_ci_runs_the_command_of_the_readme() -> None:
    script = ROOT / ".ci" / "run"
    assert script.stat().st_mode & stat.S_IXUSR
    lines = script.read_text(encoding="utf-8").splitlines()
    commands = [line for line in lines if line.startswith(("python3 -m venv", '"$place/venv/bin/'))]
    plain = [
        re.sub(r' --quiet| --envdir \S+| "\$@"', "", line).replace('"$place/venv', '".venv')
        for line in commands
    ]
    assert " && ".join(plain).replace('"', "") == TEST


def kinds(program: str) -> set[str]:
    """Kinds of checks that a noxfile has; each is a session."""
    return set(re.findall(r'^    "(\w+)": Kind\(', program, re.MULTILINE))


def test_nox_alone_checks_every_kind_and_full_runs_every_test() -> None:
    program = (ROOT / "noxfile.py").read_text(encoding="utf-8")
    assert 'nox.options.sessions = ["check"]' in program
    default, full, counted = (
        set(re.findall(r'"(\w+)"', line))
        for line in re.findall(r"^(?:DEFAULT|FULL|COUNTED) = .*$", program, re.MULTILINE)
    )
    assert default == {"lint", "types", "docs", "quick"}
    assert full == {"lint", "types", "manual", "examples"}
    assert counted == {"tests", "browser", "interop"}
    assert kinds(program) == default | full | counted
    notified = re.search(r"for name in \((.*)\):\n +session.notify", program)
    assert notified
    assert '"coverage"' in notified[1]


WHOLE = ["m100link/py.typed", *sorted(release.MANUAL), "m100link-1.dist-info/METADATA"]


@pytest.mark.parametrize(
    ("in_wheel", "in_archive", "components", "wrong"),
    [
        (WHOLE, release.PAGES, release.INSTALLED, []),
        (WHOLE[1:], release.PAGES, release.INSTALLED, ["py.typed"]),
        ([*WHOLE, "tests/rig.py"], release.PAGES, release.INSTALLED, ["tests/rig.py"]),
        (WHOLE[:2], release.PAGES, release.INSTALLED, ["safety.md"]),
        ([WHOLE[0], WHOLE[2]], release.PAGES, release.INSTALLED, ["COMMIT"]),
        (WHOLE, release.PAGES - {"LICENSE"}, release.INSTALLED, ["LICENSE"]),
        (WHOLE, release.PAGES, {"anyio", "pyserial-asyncio"}, ["cryptography"]),
    ],
)
def test_what_a_release_lacks_is_reported(
    in_wheel: list[str], in_archive: set[str], components: set[str], wrong: list[str]
) -> None:
    told = release.complaints(in_wheel, sorted(in_archive), sorted(components))
    assert len(told) == len(wrong)
    assert all(word in text for word, text in zip(wrong, told, strict=True))


def hatch_build() -> Any:
    """The module that the build calls."""
    pytest.importorskip("hatchling", reason="only what builds a release has it")
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    assert spec is not None
    assert spec.loader is not None
    hook = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hook)
    return hook


@pytest.mark.parametrize("source", ["", "https://example.org/m100link"])
def test_the_readme_of_a_package_has_no_link_into_a_clone(source: str) -> None:
    metadata: dict[str, Any] = {"version": "1.2.3"} | (
        {"urls": {"Source": source}} if source else {}
    )
    hatch_build().Readme(str(ROOT), {}).update(metadata)
    text = " ".join(metadata["readme"]["text"].split())
    targets = re.findall(r"\]\(([^)]*)\)", text)
    assert all("://" in target for target in targets)
    assert metadata["readme"]["content-type"] == "text/markdown"
    if source:
        page = f"{source}/blob/v1.2.3/docs/explanation/safety.md"
        assert f"[Safety]({page})" in text
        assert f"[a guardian]({page}#the-guardian)" in text
        for target in targets:
            assert (ROOT / target.partition("v1.2.3/")[2].partition("#")[0]).exists(), target
    else:
        assert "Safety (`m100link docs safety`)" in text
        assert "Changelog · Contributing · Security" in text
        named = set(re.findall(r"m100link docs ([\w-]+)`", text))
        assert named <= {page.stem for page in (ROOT / "docs").rglob("*.md")}


def test_a_wheel_is_the_same_whatever_is_installed_where_it_is_built(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    hook = hatch_build()

    def packed(target: str) -> list[str]:
        data: dict[str, Any] = {"force_include": {}}
        hook.Manual(str(ROOT), {}, None, None, str(ROOT), target).initialize("standard", data)
        return sorted(data["force_include"].values())

    with_all = packed("wheel")
    for name in ("sphinx", "myst_parser"):
        monkeypatch.setitem(sys.modules, name, None)
    assert packed("wheel") == with_all
    assert set(with_all) >= release.MANUAL | {"m100link/manual/examples/look_around.py"}
    assert packed("sdist") == ["COMMIT"], "a wheel that is built of it is of the same commit"


@pytest.mark.parametrize(
    ("report", "audited"),
    [
        ("", (0, [])),
        ('{"dependencies": [{"name": "cryptography", "skip_reason": "no answer"}]}', (0, [])),
        ('{"dependencies": [{"name": "cryptography", "version": "1", "vulns": []}]}', (1, [])),
        (
            '{"dependencies": [{"name": "cryptography", "version": "1", "vulns": [{"id": "X"}]}]}',
            (1, ["cryptography 1: X"]),
        ),
    ],
    ids=["no report", "no answer", "clean", "vulnerable"],
)
def test_what_was_not_asked_for_is_not_called_clean(
    report: str, audited: tuple[int, list[str]]
) -> None:
    assert audit.found(report) == audited


def test_what_is_called_slow_exists() -> None:
    for function in slow():
        path, *names = function.split("::")
        assert (ROOT / path).exists(), function
        assert f"def {names[-1]}(" in (ROOT / path).read_text(encoding="utf-8"), function


def test_package_is_marked_as_typed() -> None:
    assert (importlib.resources.files("m100link") / "py.typed").is_file()


def test_versions_agree() -> None:
    version = m100link.__version__
    assert version == PYPROJECT["project"]["version"]
    assert re.fullmatch(r"\d+\.\d+\.\d+((rc|\.dev)\d+)?", version), "vehicle.py reads three numbers"
    package = ROOT / "m100link/apps/ros2/m100_msgs/package.xml"  # ROS knows no candidates
    assert f"<version>{version.partition('rc')[0]}</version>" in package.read_text("utf-8")
    log = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.search(rf"^## (Unreleased|{re.escape(version)} \([\d-]+\))$", log, re.MULTILINE)


def test_each_instruction_installs_from_the_source_and_no_name_that_nobody_owns() -> None:
    """A stranger who registers the name would run code on machines that fly."""
    paths = [
        *ROOT.glob("*.md"),
        *(p for one in ("docs", "examples") for p in (ROOT / one).rglob("*")),
    ]
    paths += (ROOT / "m100link").rglob("*.py")
    texts = {p: p.read_text("utf-8") for p in paths if p.suffix in (".md", ".py", ".ipynb")}
    assert INSTALL == "pip install '.[{}]' in a clone of m100link"
    extras, named = set(PYPROJECT["project"]["optional-dependencies"]), 0
    for path, text in texts.items():
        for line in re.findall(r"pip install (.*)", text):
            assert not re.match(r"(-\S+ )*['\"]?m100link\b", line), (path, line)
            for asked in re.findall(r"'\.\[([\w,]+)\]'", line):
                named += 1
                assert set(asked.split(",")) <= extras, (path, line)
                is_told = path.parent == ROOT or re.search("clone|directory of the package", text)
                assert is_told, path
    assert named > 12


def test_core_dependencies_are_the_four() -> None:
    names = [re.split(r"[<>=!~ ]", d)[0] for d in PYPROJECT["project"]["dependencies"]]
    assert sorted(names) == ["anyio", "crcmod", "cryptography", "pyserial-asyncio"]


def test_the_lock_has_all_that_is_declared_with_checksums_and_no_address() -> None:
    text = (ROOT / "requirements-dev.txt").read_text(encoding="utf-8")
    assert "://" not in text
    parts = [
        PYPROJECT["project"]["dependencies"],
        *PYPROJECT["project"]["optional-dependencies"].values(),
        *PYPROJECT["dependency-groups"].values(),
    ]
    names = {re.split(r"[\[<>=~! ]", one)[0].lower().replace("_", "-") for p in parts for one in p}
    locked = re.findall(r"^([a-z0-9._-]+)==\S+(?: ;[^\n\\]+)? \\\n    --hash=", text, re.MULTILINE)
    assert names <= set(locked)
    assert len(locked) == len(re.findall("^[a-z]", text, re.MULTILINE))


def test_an_upper_limit_has_its_reason_and_the_lock_is_within_all() -> None:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    project = text[text.index("[project]") : text.index("[project.scripts]")]
    for line in project.splitlines():
        assert re.search(r",\s*<\d", line) is None or re.search(r"\S  # \w.{5,}$", line), line
    lock = (ROOT / "requirements-dev.txt").read_text(encoding="utf-8")
    locked = dict(re.findall(r"^([a-z0-9._-]+)==([^\s;]+)", lock, re.MULTILINE))
    extras = PYPROJECT["project"]["optional-dependencies"]
    asked = [*PYPROJECT["project"]["dependencies"], *(one for e in extras.values() for one in e)]
    for requirement in map(Requirement, asked):
        assert locked[canonicalize_name(requirement.name)] in requirement.specifier, requirement


def test_public_names_exist_and_are_listed_once() -> None:
    assert len(m100link.__all__) == len(set(m100link.__all__))
    missing = [name for name in m100link.__all__ if not hasattr(m100link, name)]
    assert not missing


def test_public_names_are_described_in_the_reference() -> None:
    pages = "\n".join(p.read_text(encoding="utf-8") for p in (ROOT / "docs/reference").glob("*.md"))
    described = set(re.findall(r"(?:auto\w+|py:data):: m100link\.(?:[\w.]+\.)?(\w+)", pages))
    assert "```{records}" in pages
    # The errors page and the directive for records describe a whole module each.
    missing = (
        set(m100link.__all__) - described - set(vars(errors)["__all__"]) - set(records.__all__)
    )
    assert not missing, f"describe them in docs/reference: {sorted(missing)}"


def test_errata_are_all_there_and_every_number_in_the_code_exists() -> None:
    page = (ROOT / "docs/explanation/errata.md").read_text(encoding="utf-8")
    headings = re.findall(r"^### (\d+)\. |^\| (\d+) \|", page, re.MULTILINE)
    numbers = sorted(int(a or b) for a, b in headings)
    assert numbers == list(range(1, 74))
    package = Path(str(importlib.resources.files("m100link")))
    for module in package.rglob("*.py"):
        text = module.read_text(encoding="utf-8")
        for cited in re.findall(r"errata (\d+(?:(?:,| and) \d+)*)", text):
            assert {int(n) for n in re.findall(r"\d+", cited)} <= set(numbers), module


def test_code_named_by_the_manual_exists() -> None:
    names = set()
    for page in (ROOT / "docs").rglob("*.md"):
        if page.name == "move-from-0-2.md":  # tests/test_migration.py has its names
            continue
        text = page.read_text(encoding="utf-8")
        names |= set(re.findall(r"(?<![\w/])`(m100link(?:\.\w+)+)`", text))
    assert names
    missing = []
    for name in sorted(names):
        parts = name.split(".")
        for split in range(len(parts), 0, -1):
            try:
                target: object = importlib.import_module(".".join(parts[:split]))
            except ImportError:
                continue
            for part in parts[split:]:
                target = getattr(target, part, None)
            if target is None and name != "m100link.transports":
                missing.append(name)
            break
    assert not missing


def test_nothing_tracked_names_a_place_on_one_machine() -> None:
    owned = [*ROOT.glob("*.md"), ROOT / "noxfile.py", ROOT / ".ci" / "run"]
    home = str(Path.home()) + os.sep
    for path in [*owned, *(ROOT / "docs").rglob("*.md"), *(ROOT / "docs").rglob("*.py")]:
        if "_build" not in path.parts:
            assert home not in path.read_text(encoding="utf-8"), path


ON_BOARD = (ROOT / "docs/howto/on-board.md").read_text(encoding="utf-8")
UNITS = {
    "the page": re.findall(r"```ini\n(.*?)```", ON_BOARD, re.DOTALL)[0],
    "fleet make": _UNIT.format(place="/var/lib/m100/a1", unit="one", name="a1", file="fleet.toml"),
}


@pytest.mark.skipif(
    shutil.which("systemd-analyze") is None, reason="systemd, which judges units, is not installed"
)
@pytest.mark.parametrize("unit", UNITS.values(), ids=UNITS)
def test_a_unit_leaves_little_exposed(unit: str, tmp_path: Path) -> None:
    """At most 4 of 10, by systemd's own scale."""
    place = tmp_path / "m100.service"
    place.write_text(unit, encoding="utf-8")
    judged = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", "--threshold=40", str(place)],
        capture_output=True,
        text=True,
    )
    if "unrecognized option" in judged.stderr:
        pytest.skip("this systemd is older than 250, and judges no files")
    assert judged.returncode == 0, judged.stdout[-200:]
