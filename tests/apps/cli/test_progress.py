"""How far a log is read: shown on a terminal after a second, and nowhere else."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from rich.console import Console

from m100link.apps.cli import display as progress
from tests.apps.cli.conftest import CommandLine


@pytest.fixture
def flight(cli: CommandLine, tmp_path: Path) -> Path:
    pytest.importorskip("mcap", reason="the extra `log` is not installed")
    path = tmp_path / "flight.mcap"
    cli("record", "sim://", "-o", str(path), "--duration", "0.5")
    return path


def shown(flight: Path, monkeypatch: pytest.MonkeyPatch, *, terminal: bool) -> tuple[int, str]:
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=terminal, width=60)
    monkeypatch.setattr(progress, "err", console)
    with progress.reading(flight) as log:
        count = sum(1 for _ in log.messages())
    return count, stream.getvalue()


def test_a_pipe_is_told_nothing(flight: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "_PATIENCE_S", 0.0)
    assert shown(flight, monkeypatch, terminal=False)[1] == ""


def test_a_terminal_is_told_after_a_second(flight: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert shown(flight, monkeypatch, terminal=True)[1] == ""
    monkeypatch.setattr(progress, "_PATIENCE_S", 0.0)
    count, told = shown(flight, monkeypatch, terminal=True)
    assert "reading" in told
    assert count > 10


def test_one_that_was_cut_off_is_read_without_an_end(
    flight: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress, "_PATIENCE_S", 0.0)
    flight.write_bytes(flight.read_bytes()[:-400])
    assert "reading" in shown(flight, monkeypatch, terminal=True)[1]
