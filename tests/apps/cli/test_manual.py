"""``m100link docs``: pages as they are written, and as text."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import m100link
from m100link.apps.cli.app import VERBS
from m100link.apps.cli.configuration import read_configuration
from m100link.apps.cli.manual import _EXAMPLE, _Page, _pages, _plain
from m100link.apps.cli.terminal import ExitCode
from m100link.apps.ros2.topics import OUTPUTS, SERVICES
from m100link.log.cdr import full_name
from tests.apps.cli.conftest import ROOT, CommandLine
from tests.apps.cli.test_configuration import FILE
from tests.waiting import PATIENCE

NOWHERE = Path("no such folder")


def test_every_page_has_a_topic_of_its_own(cli: CommandLine) -> None:
    rows = [(one["topic"], one["title"]) for one in cli("docs").objects]
    topics = [topic for topic, _ in rows]
    folders = ("tutorial", "howto", "reference", "explanation")
    written = {path.stem for folder in folders for path in (ROOT / "docs" / folder).glob("*.md")}
    assert len(topics) == len(set(topics))
    assert set(topics) == written - {"index"}
    assert ("safety", "Safety") in rows
    assert all(title for _, title in rows)


def test_pages_are_listed_as_the_index_of_their_folder_lists_them(cli: CommandLine) -> None:
    listed = [one["topic"] for one in cli("docs").objects]
    for folder in ("howto", "reference", "explanation"):
        index = (ROOT / "docs" / folder / "index.md").read_text(encoding="utf-8")
        order = re.findall(r"\]\(([\w-]+)\.md\)", index)
        sidebar = re.findall(r"^([\w-]+)$", index[index.index(":hidden:") :], re.MULTILINE)
        written = {path.stem for path in (ROOT / "docs" / folder).glob("*.md")} - {"index"}
        assert order == sidebar == [topic for topic in listed if topic in written]


def test_a_terminal_shows_pages_under_headings(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    lines = cli("docs").out.splitlines()
    below = lines.index("How-to guides: Set up the aircraft")
    assert lines[below + 1].split(maxsplit=1) == ["connect-hardware", "Connect the hardware"]
    assert lines.count("Tutorial") == 1


@pytest.mark.parametrize("asked", ["safety", "explanation/safety.md", "Safety"])
def test_a_page_is_printed(cli: CommandLine, asked: str) -> None:
    outcome = cli("docs", asked)
    assert (outcome.status, outcome.err) == (ExitCode.OK, "")
    assert "Take the propellers off" in outcome.out
    assert "\x1b" not in outcome.out
    assert max(map(len, outcome.out.splitlines())) <= 100


# What needs the builder: pictures, measurements, and lists with links.
BUILT = r"(\w+ )?picture.*|benchmark .*|csv table|records|cli help|url examples|\w+ (list|layouts)"
BUILT += "|errata index|command classes|command layouts|answer codes"
HEADS = (" Hold +4.3 ", " 192 +DO_REPOSITION ", " VFR_HUD +4 ", " NAV_WAYPOINT ", " MPC_XY_CR")


def test_tables_are_made_of_the_code_and_nothing_is_left_of_what_the_builder_understands(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who installs from the source has no Sphinx: the page on MAVLink had none of its tables."""
    pages = [_Page(path) for path in sorted((ROOT / "docs").glob("*/*.md"))]
    pages = [one for one in pages if one.path.parent.name != "project" and one.topic != "index"]
    assert len(pages) > 40
    made = ("tables", "command_tables", "mavlink_tables", "ros2_tables")
    for name in made:
        monkeypatch.delitem(sys.modules, name, raising=False)
    for name in ("docutils", "docutils.statemachine", "sphinx", "sphinx.util.docutils"):
        monkeypatch.setitem(sys.modules, name, None)
    try:
        page = cli("docs", "mavlink").out
        plain = {one.topic: _plain(one.text, one.path.parents[1]) for one in pages}
    finally:
        for name in made:
            sys.modules.pop(name, None)
    assert [row for row in HEADS if not re.search(row, page)] == []
    syntax = re.compile(r"^```\{|\{[\w:]+\}`|^\.\. |\]\([\w./-]*\.md", re.MULTILINE)
    assert [topic for topic, text in plain.items() if syntax.search(text)] == []
    left = re.findall(r"\*\((.+): made of", "".join(plain.values()))
    assert [one for one in left if not re.fullmatch(BUILT, one)] == []


def test_no_table_cuts_a_type_or_another_word(cli: CommandLine) -> None:
    page = cli("docs", "fly-by-ros2").out
    for whole in (OUTPUTS, SERVICES):
        assert [row.kind for row in whole.values() if full_name(row.kind) not in page] == []
    assert max(map(len, page.splitlines())) <= 100


@pytest.mark.parametrize(
    ("kind", "shown"),
    [
        ("testsetup", ""),  # what a reader does not need
        ("toctree", ""),
        ("testcode", "```python\nbody\n```"),
        ("doctest", "```python\nbody\n```"),
        ("warning", "> **Warning.** body"),
        ("note", "> **Note.** body"),
    ],
)
def test_each_kind_of_block_is_shown_as_markdown_has_it(kind: str, shown: str) -> None:
    assert _plain(f"```{{{kind}}}\nbody\n```\n", NOWHERE).strip() == shown


def test_names_of_the_reference_come_with_what_they_are() -> None:
    text = _plain("```{eval-rst}\n.. autofunction:: m100link.connect\n   :members:\n```\n", NOWHERE)
    assert "- `m100link.connect`: Connect to an aircraft" in text
    assert _plain("see {py:exc}`m100link.errors.BadURL`", NOWHERE) == "see `errors.BadURL`"
    assert _plain("[Safety](../explanation/safety.md#x), [why](safety.md)", NOWHERE) == (
        "Safety, why (→ safety)"
    )
    assert _plain("```{warning}\nOpen\nblades.\n```\n", NOWHERE) == "> **Warning.** Open blades.\n"


def test_a_program_that_a_page_shows_is_in_it(cli: CommandLine, tmp_path: Path) -> None:
    assert "async with m100link.connect" in cli("docs", "gimbal-and-camera").out
    text = "```{literalinclude} ../../examples/first_flight.py\n:language: python\n```\n"
    assert _plain(text, tmp_path / "docs") == "`../../examples/first_flight.py`\n"
    (tmp_path / "examples").mkdir()
    (tmp_path / "examples/first_flight.py").write_text("fly()\n")
    assert _plain(text, tmp_path / "docs") == "```python\nfly()\n```\n"


def test_a_page_that_is_not_there_names_those_that_are_near(cli: CommandLine) -> None:
    outcome = cli("docs", "autority")
    assert outcome.status == ExitCode.USAGE
    assert "did you mean authority?" in outcome.err
    assert "errors" in cli("docs", "error").err
    assert "did you mean fly-by-ros2 or" in cli("docs", "ros2").err
    assert "m100link docs --find zzz" in cli("docs", "zzz").err


def test_the_code_of_an_error_shows_what_the_manual_says_of_it(cli: CommandLine) -> None:
    shown = cli("docs", "m100-link-lost", "--table")
    assert shown.status == 0
    assert shown.out.splitlines()[0] == "code: M100-LINK-LOST"
    assert "usual cause: unplugged" in shown.out
    assert "what to do: check cable" in shown.out
    unknown = cli("docs", "M100-LINK-LOSST")
    assert unknown.status == 2
    assert "M100-LINK-LOST" in unknown.err
    assert unknown.err.endswith("code:         M100-USAGE\n")


def test_words_are_found_with_their_topics(cli: CommandLine) -> None:
    outcome = cli("docs", "--find", "PROPELLERS")
    assert outcome.status == ExitCode.OK
    assert "safety" in {one["topic"] for one in outcome.objects}
    outcome = cli("docs", "wire", "--find", "propellers")
    assert outcome.status == ExitCode.FAILED
    assert outcome.err == "no paragraph of that page has 'propellers'\n"


def test_words_of_a_paragraph_are_found_on_several_lines_under_their_heading(
    cli: CommandLine,
) -> None:
    found = cli("docs", "safety", "--find", "serial cmd_vel").objects
    assert len(found) >= 2
    assert {one["heading"] for one in found} == {"When two programs send"}
    assert cli("docs", "safety", "--find", "serial no-such-word").status == ExitCode.FAILED


def test_an_installation_shows_its_own_pages(
    cli: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = tmp_path / "m100link" / "manual" / "howto" / "activate.md"
    page.parent.mkdir(parents=True)
    page.write_text("# Activate\n\nAs it is.\n")
    monkeypatch.setattr(m100link, "__file__", str(tmp_path / "m100link" / "__init__.py"))
    assert cli("docs").objects == [{"topic": "activate", "title": "Activate", "part": "Howto"}]
    assert "As it is." in cli("docs", "activate").out
    page.unlink()
    assert "this installation has no manual" in cli("docs").err


def test_the_manual_is_found_where_the_package_is() -> None:
    assert "safety" in {page.topic for page in _pages()}


# -- ``m100link config`` ---------------------------------------------------------------------------


def test_it_says_where_each_value_comes_from(
    cli: CommandLine, configuration_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    configuration_file.write_text(FILE)
    monkeypatch.setenv("M100LINK_APP_ID", "5")
    monkeypatch.setenv("M100LINK_KEY", "ab" * 32)
    outcome = cli("config")
    [told] = outcome.objects
    assert (told["path"], told["exists"]) == (str(configuration_file), True)
    assert told["default"] == "lab-m100"
    assert list(told["aircraft"]) == ["lab-m100", "virtual", "other"]
    assert told["in_force"]["app_id"] == {"value": 5, "source": "environment"}
    assert told["in_force"]["key"] == {"value": "(set)", "source": "environment"}
    assert told["in_force"]["baud"]["source"] == f"{configuration_file} [aircraft.lab-m100]"
    assert told["in_force"]["bundle_id"]["source"] == "default"
    assert "abab" not in outcome.out
    assert cli("config", "virtual").objects[0]["in_force"]["url"]["value"] == "sim://?firmware=2.3"
    assert cli("config", "sim://").objects[0]["in_force"]["url"]["source"] == "command line"


def test_without_a_file_it_says_where_one_belongs(
    cli: CommandLine, configuration_file: Path
) -> None:
    [told] = cli("config").objects
    assert (told["path"], told["exists"]) == (str(configuration_file), False)
    assert "url" not in told["in_force"]


def test_the_example_is_a_file_that_can_be(configuration_file: Path) -> None:
    configuration_file.write_text(_EXAMPLE)
    assert read_configuration().default == "lab-m100"


def test_a_value_of_the_wrong_kind_is_found_before_a_flight(
    cli: CommandLine, configuration_file: Path
) -> None:
    configuration_file.write_text("[aircraft.a]\nurl = 'sim://'\napp_id = 'seven'\n")
    outcome = cli("config")
    assert outcome.status == ExitCode.USAGE
    assert "[aircraft.a]: app_id cannot be 'seven'" in outcome.err


# -- completion in the shells themselves, as far as they are installed -----------------------------


# bash calls the function with the words up to the cursor; it is what readline would do.
BASH = """
source completion
COMP_WORDS=({words} ""); COMP_CWORD={last}
COMP_WORDS[COMP_CWORD]="$1"
_m100link
printf '%s\\n' "${{COMPREPLY[@]}}"
"""


def completed(shell: str, folder: Path, *words: str) -> set[str]:
    """What a shell offers for the last word."""
    script = folder / "completion"
    program = Path(sys.executable).parent
    environment = os.environ | {"PATH": f"{program}{os.pathsep}{os.environ['PATH']}"}
    if shell == "bash":
        known = " ".join(["m100link", *words[:-1]])
        text = BASH.format(words=known, last=len(words))
        command = ["bash", "--norc", "-c", text, "bash", words[-1]]
    else:
        line = " ".join(["m100link", *words])
        command = ["fish", "--no-config", "-c", f"source {script}; complete -C '{line}'"]
    done = subprocess.run(
        command,
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=True,
    )
    return {line.partition("\t")[0] for line in done.stdout.splitlines()}


@pytest.mark.parametrize("shell", ["bash", "fish"])
def test_the_shell_completes_verbs_options_and_aircraft(
    cli: CommandLine, configuration_file: Path, tmp_path: Path, shell: str
) -> None:
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    if not (Path(sys.executable).parent / "m100link").exists():
        pytest.skip("the command is not installed beside this Python")
    configuration_file.write_text(FILE)
    outcome = cli("completion", shell)
    assert outcome.status == ExitCode.OK
    (tmp_path / "completion").write_text(outcome.out)
    assert completed(shell, tmp_path, "") >= VERBS.keys()
    assert completed(shell, tmp_path, "take") == {"takeoff"}
    assert completed(shell, tmp_path, "sim", "ct") == {"ctl"}
    assert completed(shell, tmp_path, "info", "--fi") == {"--firmware"}
    (tmp_path / "survey.plan").touch()
    for verb in (("mission", "fly"), ("plan", "check"), ("plan", "show"), ("plan", "convert")):
        assert completed(shell, tmp_path, *verb, "sur") == {"survey.plan"}
    assert completed(shell, tmp_path, "fly", "la") == {"lab-m100"}
    assert completed(shell, tmp_path, "takeoff", "--url", "v") == {"virtual"}
    assert completed(shell, tmp_path, "echo", "virtual", "magn") == {"magnetometer"}
    height = {"position.height_m"}
    assert completed(shell, tmp_path, "plot", "virtual", "position.he") == height
    assert completed(shell, tmp_path, "info", "--firmware", "2") == {"2.3"}


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_what_is_printed_is_a_script_of_that_shell(
    cli: CommandLine, tmp_path: Path, shell: str
) -> None:
    outcome = cli("completion", shell)
    assert (outcome.status, outcome.err) == (ExitCode.OK, "")
    assert "takeoff" in outcome.out
    if shutil.which(shell) is not None:
        script = tmp_path / "script"
        script.write_text(outcome.out)
        subprocess.run([shell, "-n", str(script)], check=True, timeout=PATIENCE)


def test_it_is_installed_where_the_shell_looks(
    cli: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    outcome = cli("completion", "bash", "--install")
    assert outcome.status == ExitCode.OK
    place = outcome.objects[0]["file"]
    assert Path(place).read_text().count("takeoff") > 1
    assert place in (tmp_path / ".bashrc").read_text()


def test_a_shell_that_nobody_knows_is_asked_for(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    def found() -> str:
        return "powershell"

    monkeypatch.setattr("cyclopts.completion.detect_shell", found)
    outcome = cli("completion")
    assert outcome.status == ExitCode.USAGE
    assert "name it: bash, zsh or fish" in outcome.err
