"""``m100link log wireshark`` as people type it."""

from __future__ import annotations

from pathlib import Path

import pytest

from m100link.apps.cli.outcome import ExitCode
from tests.apps.cli.conftest import CommandLine

pytest.importorskip("mcap", reason="the extra `log` is not installed")


def test_a_log_becomes_packets(cli: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    cli("record", "sim://", "-o", str(path), "--duration", "0.5")
    outcome = cli("log", "wireshark", str(path))
    assert outcome.status == ExitCode.OK
    assert path.with_suffix(".pcapng").read_bytes().startswith(b"\x0a\x0d\x0d\x0a")
    again = cli("log", "wireshark", str(path))
    assert again.status == ExitCode.USAGE
    assert "is there already" in again.err


def test_the_plugin_goes_where_wireshark_looks_for_it(
    cli: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    for _ in range(2):  # a newer one replaces it
        assert cli("log", "wireshark", "--install").status == ExitCode.OK
    installed = tmp_path / ".local/lib/wireshark/plugins/m100.lua"
    plugin = tmp_path / "elsewhere.lua"
    assert cli("log", "wireshark", "--plugin", str(plugin)).status == ExitCode.OK
    assert plugin.read_text("utf-8") == installed.read_text("utf-8")
    assert "waypoint_point" in plugin.read_text("utf-8")


def test_nothing_at_all_is_asked_about(cli: CommandLine) -> None:
    outcome = cli("log", "wireshark")
    assert outcome.status == ExitCode.USAGE
    assert "--install" in outcome.err
