"""``m100link link``, on virtual time."""

from __future__ import annotations

import sys

import pytest

from tests.apps.cli.conftest import CommandLine


def test_the_line_is_measured(cli: CommandLine) -> None:
    url = "sim://?seed=1&delay=0.02&key=" + "5a" * 32
    outcome = cli("link", url, "--duration", "0.4", "--rate", "50")
    assert outcome.status == 0
    [found] = outcome.objects
    assert "5a5a" not in outcome.out
    assert found["asked"] >= 5
    assert found["unanswered"] == 0
    assert found["round_trips"]["count"] >= found["asked"]
    assert sum(found["round_trips"]["up_to_ms"].values()) == found["round_trips"]["count"]
    assert found["round_trips"]["mean_ms"] == pytest.approx(40.0, abs=0.1)  # there and back
    assert found["line"]["frames_received"] > 10
    assert found["telemetry"]["position"] is not None
    assert "round_trips" not in found["line"]


def test_people_get_tables_and_what_is_wrong(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    outcome = cli("link", "sim://?seed=1&damage=0.3", "--duration", "0.6", "--firmware", "3.1")
    assert outcome.status == 0
    assert "frame_crc" in outcome.out
    assert "answers after" in outcome.out
    assert "do not fit this firmware" in outcome.out
    assert "█" in outcome.out


@pytest.mark.parametrize("wrong", [("--rate", "0"), ("--duration", "-1")])
def test_what_cannot_be_measured_is_refused(cli: CommandLine, wrong: tuple[str, str]) -> None:
    assert cli("link", "sim://", *wrong).status == 2
