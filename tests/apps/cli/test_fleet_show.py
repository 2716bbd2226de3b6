"""Shows at the shell."""

from __future__ import annotations

import io
import json
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest

from m100link.apps.cli.outcome import ExitCode
from tests.apps.cli.conftest import CommandLine
from tests.apps.fleet.show.shows import FIVE, five

FILE = str(FIVE)


@pytest.fixture
def crossing(tmp_path: Path) -> str:
    """Two of the five fly through each other's place."""
    found: dict[str, Any] = five()
    for point in found["aircraft"][1]["waypoints"][1:3]:
        point["east"], point["north"] = 0, point["north"] + 6
    path = tmp_path / "crossing.json"
    path.write_text(json.dumps(found), encoding="utf-8")
    return str(path)


def test_a_sound_show_is_told_in_numbers(cli: CommandLine) -> None:
    outcome = cli("fleet", "show", "check", FILE)
    assert outcome.status == ExitCode.OK
    [told] = outcome.objects
    assert (told["ok"], told["problems"], told["remarks"]) == (True, [], [])
    assert told["closest"]["distance_m"] == pytest.approx(10, abs=0.01)
    assert set(told["tracks"]) == {"a1", "a2", "a3", "a4", "a5"}
    assert all(len(digest) == 64 for digest in told["tracks"].values())


def test_a_sound_show_is_told_in_words(cli: CommandLine) -> None:
    first, second, *rest = cli("fleet", "show", "check", FILE, "--table").out.splitlines()
    assert first == "✓ 5 aircraft, 36 s"
    assert "10.00 m at 36.00 s" in second
    assert len(rest) == 5


def test_who_comes_too_near_is_named_with_the_time(cli: CommandLine, crossing: str) -> None:
    outcome = cli("fleet", "show", "check", crossing)
    assert outcome.status == ExitCode.USAGE
    [told] = outcome.objects
    near = [one for one in told["problems"] if one["aircraft"] == ["a2", "a3"]]
    assert near
    assert 0 < near[0]["at"] < 36
    assert near[0]["measured"] < near[0]["limit"]
    words = cli("fleet", "show", "check", crossing, "--table").out
    assert "✗ a2 and a3 come as near as" in words


def test_the_envelope_of_the_agents_counts(cli: CommandLine) -> None:
    outcome = cli("fleet", "show", "check", FILE, "--max-radius", "20")
    assert outcome.status == ExitCode.USAGE
    assert "the envelope ends at 20 m" in outcome.objects[0]["problems"][0]["seen"]


def test_what_is_no_show_is_told(cli: CommandLine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"{}")))
    outcome = cli("fleet", "show", "check", "-")
    assert outcome.status == ExitCode.USAGE
    assert outcome.objects[0]["problems"][0]["seen"].startswith("the format is")
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"{}")))
    outcome = cli("fleet", "show", "check", "-", "--table")
    assert outcome.status == ExitCode.USAGE
    assert "M100-BAD-SHOW" in outcome.err


def test_a_picture_is_written_and_not_over_another(cli: CommandLine, tmp_path: Path) -> None:
    picture = tmp_path / "five.svg"
    assert cli("fleet", "show", "preview", FILE, str(picture)).status == ExitCode.OK
    assert ET.parse(picture).getroot().tag.endswith("svg")
    picture.write_text("mine")
    assert cli("fleet", "show", "preview", FILE, str(picture)).status == ExitCode.USAGE
    assert picture.read_text() == "mine"
    assert cli("fleet", "show", "preview", FILE, str(picture), "--force").status == ExitCode.OK
    assert picture.read_text() != "mine"


def test_a_picture_goes_to_the_terminal_or_to_a_pipe(cli: CommandLine, crossing: str) -> None:
    drawn = cli("fleet", "show", "preview", FILE).out
    assert all(name in drawn for name in ("a1", "a2", "a3", "a4", "a5"))
    assert "least distance of any two" in drawn
    outcome = cli("fleet", "show", "preview", crossing, "-")
    assert outcome.status == ExitCode.USAGE
    assert outcome.out.startswith("<svg")
    assert "✗ a2 and a3 come as near as" in outcome.err


def test_a_picture_that_cannot_be_written_is_told(cli: CommandLine) -> None:
    outcome = cli("fleet", "show", "preview", FILE, "/dev/full", "--force")
    assert outcome.status == ExitCode.USAGE
    assert "cannot be written" in outcome.err
