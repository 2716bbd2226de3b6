"""``m100link docs``: pages as they are written, and as text."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytest.importorskip("cyclopts")
import m100link
from m100link.apps.cli.manual import _Page, _pages, _plain
from m100link.apps.cli.outcome import ExitCode
from tests.apps.cli.conftest import ROOT, CommandLine

NOWHERE = Path("no such folder")


def test_every_page_has_a_topic_of_its_own(cli: CommandLine) -> None:
    rows = [line.split("\t") for line in cli("docs").out.splitlines()]
    topics = [topic for topic, _ in rows]
    folders = ("tutorial", "howto", "reference", "explanation")
    written = {path.stem for folder in folders for path in (ROOT / "docs" / folder).glob("*.md")}
    assert len(topics) == len(set(topics))
    assert set(topics) == written - {"index"}
    assert ["safety", "Safety"] in rows
    assert all(title for _, title in rows)


@pytest.mark.parametrize("asked", ["safety", "explanation/safety.md", "Safety"])
def test_a_page_is_printed(cli: CommandLine, asked: str) -> None:
    outcome = cli("docs", asked)
    assert (outcome.status, outcome.err) == (ExitCode.OK, "")
    assert "Take the propellers off" in outcome.out
    assert "\x1b" not in outcome.out
    assert max(map(len, outcome.out.splitlines())) <= 100


def test_nothing_is_left_of_what_only_the_builder_understands() -> None:
    pages = [_Page(path) for path in sorted((ROOT / "docs").glob("*/*.md"))]
    assert len(pages) > 40
    for page in pages:
        if page.folder == "project" or page.topic == "index":
            continue
        text = _plain(page.text, page.path.parents[1])
        assert not re.search(r"^```\{|\{[\w:]+\}`|^\.\. |\]\([\w./-]*\.md", text, re.MULTILINE), (
            page
        )


def test_names_of_the_reference_come_with_what_they_are() -> None:
    text = _plain("```{eval-rst}\n.. autofunction:: m100link.connect\n   :members:\n```\n", NOWHERE)
    assert "- `m100link.connect`: Connect to an aircraft" in text
    assert _plain("see {py:exc}`m100link.errors.BadURL`", NOWHERE) == "see `errors.BadURL`"
    assert _plain("[Safety](../explanation/safety.md#x), [why](safety.md)", NOWHERE) == (
        "Safety, why (→ safety)"
    )
    assert _plain("```{warning}\nOpen\nblades.\n```\n", NOWHERE) == "> **Warning.** Open blades.\n"


def test_a_program_that_a_page_shows_is_in_it(cli: CommandLine, tmp_path: Path) -> None:
    assert "async with m100link.connect" in cli("docs", "first-flight").out
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
    assert "m100link docs --find zzz" in cli("docs", "zzz").err


def test_the_code_of_an_error_shows_what_the_manual_says_of_it(cli: CommandLine) -> None:
    shown = cli("docs", "m100-link-lost")
    assert shown.status == 0
    assert shown.out.splitlines()[0] == "M100-LINK-LOST: LinkLost, a kind of LinkError"
    assert "usual cause: unplugged" in shown.out
    assert "what to do: check cable" in shown.out
    unknown = cli("docs", "M100-LINK-LOSST")
    assert unknown.status == 2
    assert "M100-LINK-LOST" in unknown.err
    assert unknown.err.endswith("code:         M100-USAGE\n")


def test_words_are_found_with_their_topics(cli: CommandLine) -> None:
    outcome = cli("docs", "--find", "PROPELLERS")
    assert outcome.status == ExitCode.OK
    assert any(line.startswith("safety: ") for line in outcome.out.splitlines())
    outcome = cli("docs", "wire", "--find", "propellers")
    assert outcome.status == ExitCode.FAILED
    assert outcome.err == "no line of it has 'propellers'\n"


def test_pages_that_the_builder_made_are_shown_as_they_are(
    cli: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = tmp_path / "m100link" / "manual" / "howto" / "activate.txt"
    page.parent.mkdir(parents=True)
    page.write_text("Activate\n********\n\n   *as it is*\n")
    monkeypatch.setattr(m100link, "__file__", str(tmp_path / "m100link" / "__init__.py"))
    assert cli("docs").out == "activate\tActivate\n"
    assert cli("docs", "activate").out == page.read_text()
    page.unlink()
    assert "this installation has no manual" in cli("docs").err


def test_the_manual_is_found_where_the_package_is() -> None:
    assert {page.path.suffix for page in _pages()} <= {".md", ".txt"}
