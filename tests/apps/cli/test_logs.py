"""--log-level and --log-json, and that no secret is in what they show."""

from __future__ import annotations

import ast
import json
import logging
import struct

import pytest

from m100link.apps.cli.outcome import ExitCode
from tests.apps.cli.conftest import CommandLine
from tests.test_house import MODULES, tree

APP_ID = 3_141_592_653
KEY = "c0ffee5a" * 8
BUNDLE_ID = "org.example.secret"


@pytest.fixture
def secretive(cli: CommandLine, monkeypatch: pytest.MonkeyPatch) -> CommandLine:
    """A command line with an app of its own."""
    monkeypatch.setenv("M100LINK_APP_ID", str(APP_ID))
    monkeypatch.setenv("M100LINK_KEY", KEY)
    return cli


def find_secrets(text: str) -> list[str]:
    """The secrets that a text has, however they are written."""
    raw = bytes.fromhex(KEY)
    secrets = {
        "app id": [str(APP_ID), f"{APP_ID:x}", struct.pack("<I", APP_ID).hex(), repr(APP_ID)],
        "key": [KEY[:8], repr(raw)[2:8], str(list(raw[:3]))[1:-1]],
        "bundle id": [BUNDLE_ID, BUNDLE_ID[:5].encode().hex()],
    }
    return [name for name, ways in secrets.items() for way in ways if way in text.lower()]


def test_secrets_would_be_found() -> None:
    assert find_secrets(f"x{APP_ID}x") == ["app id", "app id"]
    assert find_secrets("4DE640BB".lower()) == ["app id"]
    assert find_secrets(KEY.upper()) == ["key"]


@pytest.mark.parametrize("form", [(), ("--log-json",)])
@pytest.mark.parametrize("has_other_app", [False, True], ids=["activated", "refused"])
def test_everything_that_is_logged_of_an_activation_has_no_secret(
    secretive: CommandLine, form: tuple[str, ...], has_other_app: bool
) -> None:
    url = f"sim://?app_id={APP_ID + has_other_app}&key={KEY}"
    words = ("release", url, "--bundle-id", BUNDLE_ID, "--log-level", "debug", *form)
    outcome = secretive(*words)
    assert outcome.status == (ExitCode.ACTIVATION if has_other_app else ExitCode.OK), outcome.err
    assert "0001…" in outcome.err.replace("\\u2026", "…")
    assert find_secrets(outcome.err + outcome.out) == []
    if form:
        lines = [json.loads(line) for line in outcome.err.splitlines() if line.startswith("{")]
        assert {line["aircraft"] for line in lines} == {"sim://?app_id=…&key=…"}
        assert {line["level"] for line in lines} >= {"DEBUG", "INFO"}


def test_the_environment_says_the_level_of_json_lines(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("M100LINK_LOG", "INFO")
    demo = ("demo", "--speed", "max", "--side", "1", "--json", "--no-record")  # a disk may warn
    outcome = cli(*demo, "--log-json")
    lines = [json.loads(line) for line in outcome.err.splitlines()]
    assert {line["level"] for line in lines} == {"INFO"}
    assert outcome.objects[0]["flown"]


def test_a_level_that_does_not_exist_is_refused(cli: CommandLine) -> None:
    outcome = cli("info", "sim://", "--log-level", "loud")
    assert outcome.status == ExitCode.USAGE
    assert "warning" in outcome.err


LONG = ("serve", "console", "sim", "demo", "takeoff", "fly", "land", "home", "monitor", "echo")


@pytest.mark.parametrize("verb", [*LONG, "hz", "plot", "activate", "doctor", "info", "mission fly"])
def test_verbs_that_run_long_have_the_options(cli: CommandLine, verb: str) -> None:
    told = cli(*verb.split(), "--help").out
    assert "--log-level" in told
    assert "--log-json" in told


def test_every_logger_is_that_of_its_module() -> None:
    """So that one room, or one module, can be asked for its log."""
    package = {"m100link.link", "m100link.apps.cli.logs", "m100link.apps.station.log_output"}
    package.add("m100link.flight.reserves")  # it hands the records of others to their loggers
    for module, path in MODULES.items():
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "logging.getLogger":
                asked = ast.unparse(node.args[0])
                is_right = asked in {"__name__", "JOURNAL_LOG"} or module in package
                assert is_right, f"{module}: {asked}"
    assert logging.getLogger("m100link.flight.control").parent is not logging.root
