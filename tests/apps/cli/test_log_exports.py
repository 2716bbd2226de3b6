"""``m100link log ros2`` and ``layout`` as people type them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from m100link.apps.cli.outcome import ExitCode
from tests.apps.cli.conftest import CommandLine

pytest.importorskip("mcap", reason="the extra `log` is not installed")


def test_a_log_becomes_a_bag_beside_it(cli: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    cli("record", "sim://", "-o", str(path), "--duration", "0.5")
    before = path.read_bytes()
    outcome = cli("log", "ros2", str(path))
    assert outcome.status == ExitCode.OK
    assert (tmp_path / "flight-ros2.mcap").read_bytes()[8:100].find(b"ros2") > 0
    assert path.read_bytes() == before
    again = cli("log", "ros2", str(path))
    assert again.status == ExitCode.USAGE
    assert "is there already" in again.err
    itself = cli("log", "ros2", str(path), "-o", str(path))
    assert itself.status == ExitCode.USAGE
    assert path.read_bytes() == before


def test_a_layout_is_json_in_a_pipe_or_a_file(cli: CommandLine, tmp_path: Path) -> None:
    target = tmp_path / "layout.json"
    assert cli("log", "layout", "-o", str(target)).status == ExitCode.OK
    assert json.loads(cli("log", "layout").out) == json.loads(target.read_text("utf-8"))
    assert cli("log", "layout", "-o", str(target)).status == ExitCode.USAGE
