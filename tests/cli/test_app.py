"""The command line as a whole: what it knows, and what it says when it is asked wrongly."""

from __future__ import annotations

import pytest

import m100link
from m100link.cli.app import VERBS, app, application
from m100link.cli.outcome import ExitCode
from tests.cli.conftest import CommandLine


@pytest.mark.parametrize(
    "arguments",
    [
        ("no-such-command",),
        ("info", "sim://", "--no-such-option"),
        ("info", "sim://", "--seconds", "soon"),
        ("demo", "--speed", "0"),
        ("demo", "--speed", "1000"),
        ("demo", "--side", "0.5"),
        ("info", "sim://?wind=3"),
        ("info", "sim://?seed=x"),
        ("info", "sim://", "--firmware", "9.9"),
        ("echo", "sim://", "no_such_item"),
        ("echo", "sim://", "--csv", "--json"),
        ("plot", "sim://", "position.colour"),
    ],
    ids=" ".join,
)
def test_what_is_asked_wrongly_is_a_usage_error_without_a_traceback(
    cli: CommandLine, arguments: tuple[str, ...]
) -> None:
    outcome = cli(*arguments)
    assert outcome.status == ExitCode.USAGE
    assert "Traceback" not in outcome.err + outcome.out
    assert outcome.err + outcome.out


def test_help_and_version(cli: CommandLine) -> None:
    version = cli("--version")
    assert (version.status, version.out) == (0, f"{m100link.__version__}\n")
    overview = cli("--help")
    for command in ("demo", "info", "activate", "monitor", "decode", "sim", "takeoff", "fly"):
        assert command in overview.out


def test_each_verb_is_listed_with_the_first_sentence_of_its_own_help(cli: CommandLine) -> None:
    overview = cli("--help").out
    for verb, (_, sentence) in VERBS.items():
        assert (app[verb].help or "").split("\n\n")[0] == sentence
        assert sentence.replace("`", "") in overview
    assert application(overview=True)["sim"].name == ("sim",)
    assert "hex" in cli("decode", "--help").out


def test_a_log_level_that_does_not_exist(cli: CommandLine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("M100LINK_LOG", "LOUD")
    outcome = cli("info", "sim://")
    assert outcome.status == ExitCode.USAGE
    assert "DEBUG, INFO, WARNING or ERROR" in outcome.err
