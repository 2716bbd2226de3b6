"""``m100link config``."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("cyclopts")
from m100link.apps.cli.configuration import read_configuration
from m100link.apps.cli.outcome import ExitCode
from m100link.apps.cli.settings import _EXAMPLE
from tests.apps.cli.conftest import CommandLine
from tests.apps.cli.test_configuration import FILE


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
