"""What is promised stays, or the change log has a line for it; see tests/promised.py."""

from __future__ import annotations

import importlib

import pytest

from tests import promised

FILE = promised.read(promised.FILE.read_text(encoding="utf-8"))


def differ(now: promised.Promises, part: str) -> list[str]:
    """What is promised otherwise than the file says."""
    before = {name: FILE[name] for name in FILE if name in now or kind(name) == part}
    return [
        f"{name}: {before.get(name, 'nothing')} -> {now.get(name, 'nothing')}"
        for name in promised.changes(before, now)
    ]


def kind(name: str) -> str:
    """The part that has a name like this."""
    if name.startswith("M100-"):
        return "failures"
    if name.startswith(("m100link ", "option --")):
        return "command_line"
    return "library" if name.startswith("m100link.") else "wires"


TELL = (
    "name it in a line of the newest section of CHANGELOG.md, then run python -m tests.promised, "
    "which writes tests/promised.txt"
)


def test_names_signatures_and_defaults_are_those_of_the_file() -> None:
    assert not differ(promised.library(), "library"), TELL


def test_verbs_and_options_are_those_of_the_file() -> None:
    assert not differ(promised.command_line(), "command_line"), TELL


def test_codes_exit_statuses_and_wire_versions_are_those_of_the_file() -> None:
    assert not differ(promised.failures(), "failures"), TELL
    assert not differ(promised.wires(), "wires"), TELL


def test_the_file_has_each_kind_of_promise() -> None:
    """Some of each, by hand."""
    by_hand = {
        "m100link.Control.land": "async (self, *, timeout: float | None = None,",
        "m100link.AuthorityCode.OBTAINED": "2",
        "m100link.Guards": "class()(gps: bool = True, envelope: Envelope | None = Envelope(",
        "m100link.Aircraft.firmware": "property(self) -> FirmwareProfile",
        "m100link fly": "[URL] NORTH EAST UP: tuple[str, ...] --acceleration --app-id",
        "option --max-height: float = 50.0": "fly, ",
        "M100-NO-ROUTER": "NoRouter, exit status 9",
        "version of a fleet's messages": "4",
        "firmware profiles": "1.0",
    }
    for name, begin in by_hand.items():
        assert FILE[name].startswith(begin), (name, FILE[name])
    assert not [name for name in FILE if "._" in name or name.startswith(promised.OF_ONE_RELEASE)]


def test_an_application_of_which_nothing_is_promised_says_so() -> None:
    for package in sorted((promised.ROOT / "m100link/apps").glob("*/__init__.py")):
        name = f"m100link.apps.{package.parent.name}"
        text = importlib.import_module(name).__doc__ or ""
        has_names = any(one.startswith(f"{name}.") for one in FILE)
        has_names |= any(one.startswith(f"m100link.{package.parent.name}.") for one in FILE)
        assert ("promised" in text) is (not has_names or "``config``" in text), name


LOG = "# Changelog\n\n## Unreleased\n\n- `land` waits.\n{}\n## 0.2.0\n\n- `hover` is new.\n"
BEFORE = {
    "m100link.Control.land": "(self)",
    "m100link fly": "X --to",
    "option --to: str": "sim",
    "M100-X": "X, exit status 1",
}


@pytest.mark.parametrize(
    ("now", "line", "missing"),
    [
        (BEFORE, "", []),
        (BEFORE | {"m100link.Control.land": "(self, timeout)"}, "", ["m100link.Control.land"]),
        (BEFORE | {"m100link.Control.land": "(self, timeout)"}, "- `land(timeout)`.\n", []),
        (BEFORE | {"m100link.Control.hover": "(self)"}, "", ["m100link.Control.hover"]),
        (BEFORE | {"option --to: str": "sim, demo"}, "- `--to` takes a name.\n", []),
        (BEFORE | {"option --to: str": "sim, demo"}, "- `demo` is new.\n", []),
        (
            BEFORE | {"option --to: str": "sim, demo"},
            "- A page goes to it.\n",
            ["option --to: str"],
        ),
        (BEFORE | {"m100link fly": "X --to --json"}, "- `--json` prints.\n", []),
        (BEFORE | {"m100link fly": "X --to --json"}, "- `fly` prints.\n", ["m100link fly"]),
        (BEFORE | {"m100link fly": "Y --to"}, "- `fly` takes Y.\n", []),
        ({"m100link fly": "X --to"}, "- `land` and `--to` are gone.\n", ["M100-X"]),
    ],
)
def test_a_change_without_a_new_line_of_the_change_log_is_named(
    now: promised.Promises, line: str, missing: list[str]
) -> None:
    assert promised.unnamed(BEFORE, now, LOG.format(""), LOG.format(line)) == missing


@pytest.mark.parametrize("heading", ["Unreleased", "1.0.0rc1 (2026-11-29)"])
def test_the_newest_section_is_the_first_of_a_version(heading: str) -> None:
    log = "# Changelog\n\n## Policy\n\nNone.\n\n" + LOG.partition("\n\n")[2].format("")
    assert promised.newest(log.replace("Unreleased", heading)) == ["", "- `land` waits.", ""]


def test_a_file_is_read_as_it_was_written() -> None:
    assert promised.read(promised.written(BEFORE)) == BEFORE
