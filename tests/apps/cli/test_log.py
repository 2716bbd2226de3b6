"""``m100link record`` and ``m100link log`` as people type them."""

from __future__ import annotations

import csv
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from m100link import Aircraft
from m100link.apps.cli.outcome import ExitCode
from m100link.errors import LinkError, LinkLost
from m100link.log import read, recorder
from tests.apps.cli.conftest import ROOT, CommandLine
from tests.waiting import PATIENCE

pytest.importorskip("mcap", reason="the extra `log` is not installed")


@pytest.fixture
def flight(cli: CommandLine, tmp_path: Path) -> Path:
    """Half a second of a virtual aircraft."""
    path = tmp_path / "flight.mcap"
    outcome = cli("record", "sim://", "-o", str(path), "--duration", "0.5")
    assert outcome.status == ExitCode.OK
    assert outcome.out == ""
    assert f"into {path}" in "".join(outcome.err.split("\n"))
    return path


def test_a_log_is_recorded_and_told(cli: CommandLine, flight: Path) -> None:
    outcome = cli("log", "info", str(flight), "--json")
    [told] = outcome.objects
    assert told["is_whole"] is True
    assert told["firmware"] == "1.0"
    assert told["messages"]["/m100/raw/rx"] > 2
    assert [one["name"] for one in told["phases"]] == ["ground"]
    assert [one["name"] for one in told["control"]] == ["pilot"]
    assert told["alarms"] == []
    assert told["maxima"]["height_m"] == 0.0
    assert "closed" in told["ended"]
    text = cli("log", "info", str(flight)).out
    assert "firmware 1.0" in text
    assert "recover" not in text


def test_its_telemetry_is_a_table(cli: CommandLine, flight: Path, tmp_path: Path) -> None:
    out = cli("log", "csv", str(flight), "position").out
    rows = list(csv.DictReader(out.splitlines()))
    assert len(rows) > 20
    assert float(rows[0]["position.latitude_deg"]) == pytest.approx(22.5431, abs=1e-6)
    table = tmp_path / "table.csv"
    assert cli("log", "csv", str(flight), "position", "-o", str(table)).status == ExitCode.OK
    assert table.read_text(encoding="utf-8") == out
    again = cli("log", "csv", str(flight), "-o", str(table))
    assert again.status == ExitCode.USAGE
    assert "is there already" in again.err


def test_what_happened_is_a_line_each(cli: CommandLine, flight: Path) -> None:
    told = cli("log", "events", str(flight)).objects
    assert [one["command"] for one in told if "command" in one][:2] == ["get_version"] * 2
    assert told[-1]["event"] == "connection"


def test_what_was_cut_off_is_told_and_mended(cli: CommandLine, flight: Path) -> None:
    cut = flight.with_name("cut.mcap")
    cut.write_bytes(flight.read_bytes()[:-400])
    assert "log recover" in "".join(cli("log", "info", str(cut)).out.split("\n"))
    assert cli("log", "recover", str(cut)).status == ExitCode.OK
    [told] = cli("log", "info", str(flight.with_name("cut-recovered.mcap")), "--json").objects
    assert told["is_whole"] is True
    again = cli("log", "recover", str(cut))
    assert again.status == ExitCode.USAGE


def test_a_cable_that_is_pulled_ends_the_recording_and_is_told(
    cli: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def wait_closed(_: Aircraft) -> LinkError:
        return LinkLost("the cable is gone")

    monkeypatch.setattr(Aircraft, "wait_closed", wait_closed)
    path = tmp_path / "flight.mcap"
    outcome = cli("record", "sim://", "-o", str(path))
    assert outcome.status == ExitCode.NO_LINK
    assert "the cable is gone" in outcome.err
    assert read(path).summary().is_whole


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_whoever_ends_the_recording_gets_a_whole_file(tmp_path: Path, number: int) -> None:
    path = tmp_path / "flight.mcap"
    process = subprocess.Popen(
        [sys.executable, "-m", "m100link", "record", "sim://", "-o", str(path)],
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )
    assert process.stderr is not None
    with process:
        assert "recording sim://" in process.stderr.readline()
        process.send_signal(number)
        status = process.wait(PATIENCE)
    assert status == (ExitCode.INTERRUPTED if number == signal.SIGINT else ExitCode.OK)
    assert read(path).summary().is_whole


def test_typing_errors_are_told(cli: CommandLine, flight: Path, tmp_path: Path) -> None:
    for words, why in (
        (("log", "info", str(tmp_path / "none.mcap")), "No such file"),
        (("log", "csv", str(flight), "positon"), "position"),
        (("record", "sim://", "-o", str(flight)), "is there already"),
        (("record", "sim://", "-o", str(tmp_path), "--rate", "-1"), "rate"),
    ):
        outcome = cli(*words)
        assert outcome.status == ExitCode.USAGE, words
        assert why in " ".join(outcome.err.split()), words


def test_each_verb_says_what_a_damaged_log_lacks_and_ends_with_1(
    cli: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder, "FLUSH_S", 0.0)  # of the wall clock: a part for each batch
    flight, bad = tmp_path / "flight.mcap", tmp_path / "bad.mcap"
    assert cli("record", "sim://", "-o", str(flight), "--duration", "1.6").status == ExitCode.OK
    data = bytearray(flight.read_bytes())
    parts = [at for at in range(len(data)) if data[at] == 6 and data[at + 41 : at + 45] == b"zstd"]
    assert len(parts) > 1
    data[parts[-1] + 80] ^= 1
    bad.write_bytes(data)
    lost = read(bad).damage.missing_messages
    assert lost > 0
    verbs = "info csv parquet events frames plot recover wireshark ros2"
    for name, *options in (["info", "--json"], *([verb] for verb in verbs.split())):
        shown = cli("log", name, str(bad), *options)
        assert shown.status == ExitCode.FAILED, name
        assert f"{lost} messages are missing" in " ".join((shown.out + shown.err).split()), name
        assert "killed" not in shown.out + shown.err
        whole = cli("log", name, str(flight), *options)
        assert whole.status == ExitCode.OK
        assert "missing" not in whole.err
    shown = cli("log", "compare", str(flight), str(bad))
    assert shown.status == ExitCode.FAILED
    assert f"{lost} messages are missing" in " ".join(shown.err.split())
