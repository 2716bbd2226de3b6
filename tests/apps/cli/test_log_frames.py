"""``m100link log frames`` and ``compare`` as people type them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from m100link.apps.cli.outcome import ExitCode
from m100link.sim.vehicle.activation import DEMO_KEY
from tests.apps.cli.conftest import CommandLine

pytest.importorskip("mcap", reason="the extra `log` is not installed")


@pytest.fixture
def flight(cli: CommandLine, tmp_path: Path) -> Path:
    path = tmp_path / "flight.mcap"
    assert cli("record", "sim://", "-o", str(path), "--duration", "0.5").status == ExitCode.OK
    return path


def test_frames_are_json_in_a_pipe_and_lines_for_people(cli: CommandLine, flight: Path) -> None:
    frames = cli("log", "frames", str(flight)).objects
    assert [one["command"] for one in frames][:2] == ["get_version", "get_version"]
    assert frames[1]["version"].startswith("SDK-v1.0")
    lines = cli("log", "frames", str(flight), "--table").out.splitlines()
    assert len(lines) == len(frames)
    assert " rx " in lines[1]
    assert "ack" in lines[1]


def test_the_head_of_many_frames_ends_without_a_word(flight: Path) -> None:
    command = f"{sys.executable} -m m100link log frames {flight} | head -n 2"
    done = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)
    assert len(done.stdout.splitlines()) == 2
    assert all(json.loads(line) for line in done.stdout.splitlines())
    assert done.stderr == ""


def test_a_key_that_others_can_read_is_not_used(
    cli: CommandLine, flight: Path, tmp_path: Path
) -> None:
    key = tmp_path / "key"
    key.write_bytes(DEMO_KEY.reveal())
    key.chmod(0o644)
    outcome = cli("log", "frames", str(flight), "--key-file", str(key))
    assert outcome.status == ExitCode.USAGE
    assert "can be read by others" in " ".join(outcome.err.split())
    key.chmod(0o600)
    assert cli("log", "frames", str(flight), "--key-file", str(key)).status == ExitCode.OK


def test_a_flight_does_not_differ_from_itself(cli: CommandLine, flight: Path) -> None:
    [found] = cli("log", "compare", str(flight), str(flight), "--json").objects
    assert {one["by"] for one in found["values"]} <= {0, None}
    assert found["commands"] == found["alarms"] == []
    text = cli("log", "compare", str(flight), str(flight)).out
    assert "commands: the same" in text
