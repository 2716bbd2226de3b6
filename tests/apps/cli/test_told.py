"""Command lines that the manual and messages tell people to type: each is understood, and runs.

A page has them in shell blocks, to be typed as they stand, or within a sentence. The parser of the
command line judges all of them. Of the blocks, a slow test runs what needs no hardware, no network
and no second shell, in the order of each page, where nothing else is.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from cyclopts import CycloptsError

from m100link.apps.cli.app import VERBS, app
from m100link.apps.cli.manual import error_classes
from tests.apps.cli.conftest import ROOT, CommandLine
from tests.apps.cli.test_app import verbs

_FENCED = re.compile(r"^```([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_INLINE = re.compile(r"`(m100link [^`]+)`")
_NO_COMMANDS = {f"m100link {words}" for words in ("decrypted", "lease 4", "order 4", "seal 4")}
_NO_COMMANDS |= {"m100link audit 1", "m100link track 1"}
"""What else has these words in front: a column of Wireshark, and bytes that are signed."""
_OF_OTHERS = {"--cable", "--codec", "--workspace"}
"""Options of programs that are no verb of m100link."""


@cache
def pages() -> dict[str, str]:
    """Every page that people read, by its path."""
    paths = [
        ROOT / "README.md",
        *(ROOT / "docs").glob("*/*.md"),
        *(ROOT / "examples").rglob("*.md"),
    ]
    paths.remove(ROOT / "docs/howto/move-from-0-2.md")  # tests/test_migration.py has its old names
    return {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for path in sorted(paths)}


def commands(line: str) -> Iterator[tuple[str, ...]]:
    """The words behind each ``m100link`` of a line of shell, up to the next command."""
    lexer = shlex.shlex(line, posix=True, punctuation_chars="&|;<>")
    lexer.whitespace_split, lexer.commenters = True, "#"
    words = [*lexer, ";"]
    while words:
        end = next(at for at, word in enumerate(words) if set(word) <= set("&|;<>"))
        command, words = words[:end], words[end + 1 :]
        names = [Path(word).name for word in command]
        if "m100link" in names:
            yield tuple(command[names.index("m100link") + 1 :])


def in_blocks() -> dict[str, list[tuple[str, ...]]]:
    """Command lines of shell blocks, by page."""
    return {
        page: found
        for page, text in pages().items()
        if (
            found := [
                words
                for kind, block in _FENCED.findall(text)
                if kind in ("sh", "console", "")
                for line in block.replace("\\\n", " ").splitlines()
                if "m100link" in line and ": " not in line.partition("#")[0]
                for words in commands(line)
            ]
        )
    }


TYPED = in_blocks()


def test_the_manual_has_command_lines() -> None:
    """By hand: some that the search has to find."""
    assert ("plan", "check", "field.plan") in TYPED["docs/howto/plan-a-mission.md"]
    assert ("fleet", "router") in TYPED["examples/fleet/README.md"]
    assert sum(map(len, TYPED.values())) > 90


@pytest.mark.parametrize("page", TYPED)
def test_a_command_line_of_a_page_is_understood(page: str) -> None:
    for words in TYPED[page]:
        if words:
            _ = app[words[0]]  # loads it
        try:
            app.parse_args(list(words), exit_on_error=False, print_error=False)
        except CycloptsError as error:
            pytest.fail(f"m100link {' '.join(words)}: {error}")


def in_sentences() -> dict[str, set[str]]:
    """Command lines within sentences of pages, of modules and of the texts of errors, by place."""
    modules = sorted((ROOT / "m100link").rglob("*.py"))
    texts = pages() | {str(p.relative_to(ROOT)): p.read_text(encoding="utf-8") for p in modules}
    found = {
        place: {" ".join(one.split()) for one in _INLINE.findall(texts[place])} for place in texts
    }
    found["texts of errors"] = {
        one
        for kind in error_classes()
        for one in re.findall(r"m100link(?: [a-z-]+)+(?: --[a-z-]+)*", kind.usual_remedy)
        if one.split()[1] in VERBS
    }
    return {place: lines for place, lines in found.items() if lines}


def test_a_verb_and_an_option_that_a_sentence_names_exist() -> None:
    known = {
        verb: {name for one in found.assemble_argument_collection() for name in one.names}
        for verb, found in ((verb, app[verb.split()[0]] and found) for verb, found in verbs())
    }
    groups = {verb.rpartition(" ")[0] for verb in known} - {""}
    wrong, count = [], 0
    for place, lines in in_sentences().items():
        for line in lines:
            words = line.removeprefix("m100link ").split()
            verb = next(
                (v for n in (3, 2, 1) if (v := " ".join(words[:n])) in known.keys() | groups), None
            )
            options = {word.partition("=")[0] for word in words if re.match("--[a-z]", word)}
            names = known.get(verb or "", set()) | {"--help", "--version"}
            count += 1
            if verb is None and not words[0].startswith(("-", "…")) and line not in _NO_COMMANDS:
                wrong.append(f"{place}: {line}: no such verb")
            elif verb in known and options - names:
                wrong.append(f"{place}: {line}: no {', '.join(options - names)}")
    assert not wrong
    assert count > 150
    options = set[str]().union(*known.values()) | {"--help", "--version"}
    told = {one for text in pages().values() for one in re.findall(r"`(--[a-z][a-z-]+)[ =`]", text)}
    assert told - options <= _OF_OTHERS
    assert len(told) > 60


# -- run literally ---------------------------------------------------------------------------------


_ENDLESS = {"record": ("--duration", "1"), "echo": ("--packages", "1")}
"""Verbs that Ctrl-C ends, and what ends them here."""
_ELSEWHERE = {
    *("console", "serve", "mavlink", "ros2", "replay", "sim", "fleet", "map", "completion"),
    *("udev", "mission download", "fly"),
}
"""They need a second shell, a network, an adapter or an earlier flight: other tests run them."""


_PORT = re.compile(r"(?:/dev|/tmp|\.)/(?:tty)?(?:USB\d|m100)|field", re.IGNORECASE)


def runs_alone(words: tuple[str, ...]) -> bool:
    is_long = any(word.startswith("replay://") for word in words)  # a flight of minutes
    return not is_long and not {words[0], " ".join(words[:2])} & _ELSEWHERE


@pytest.fixture
def workshop(
    cli: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, key_file: Path
) -> Path:
    """A folder with the files that pages name, and a home of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("M100LINK_URL", "sim://")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    for name in ("drone.key", "m100.key", "demo.key", ".m100-key"):
        (tmp_path / name).touch(mode=0o600)
        (tmp_path / name).write_bytes(key_file.read_bytes())
    area = ("22.5432,113.9589", "22.5434,113.9589", "22.5434,113.9591")
    lines = ("--height", "10", "--spacing", "10")
    for name in ("survey.json", "field.plan"):
        assert cli("plan", "survey", name, *area, *lines).status == 0
    assert cli("record", "sim://", "-o", "flight.mcap", "--duration", "2").status == 0
    for name in (
        "before",
        "after",
        "m100link-20261122-101500",
        "flights/one",
        "logs/a1-m100link-20261122-101500",
    ):
        copy = tmp_path / f"{name}.mcap"
        copy.parent.mkdir(exist_ok=True)
        copy.write_bytes((tmp_path / "flight.mcap").read_bytes())
    return tmp_path


@pytest.mark.slow
@pytest.mark.usefixtures("workshop")
@pytest.mark.parametrize("page", [page for page in TYPED if any(map(runs_alone, TYPED[page]))])
def test_the_blocks_of_a_page_run_as_they_stand(cli: CommandLine, page: str) -> None:
    """A virtual aircraft is at the end of each port, and knows its own app."""
    for words in filter(runs_alone, TYPED[page]):
        command = list(words)
        for option in {"--app-id", "--key", "--key-file"} & set(words) if words[0] != "log" else ():
            at = command.index(option)
            del command[at : at + 2]
        command = ["sim://?firmware=3.1" if _PORT.fullmatch(word) else word for word in command]
        command = [word.replace("flights/*", "flights/one") for word in command]
        outcome = cli(*command, *_ENDLESS.get(words[0], ()))
        assert outcome.status == 0, (command, outcome)
