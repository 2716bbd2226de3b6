"""``m100link fleet agent`` records as other stations do: a folder for each aircraft."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from m100link.apps.cli.fleet_agent import AgentOptions
from m100link.apps.cli.serve import settings_of
from m100link.apps.station.config import Settings
from m100link.apps.station.fleet import recorded_apart
from m100link.apps.station.run import _flights
from m100link.log import read
from m100link.log.folder import default_folder
from tests.apps.cli.test_fleet import Site, site
from tests.waiting import PATIENCE

__all__ = ["site"]

pytest.importorskip("zenoh", reason="the extra fleet is not installed")


def test_every_aircraft_has_a_folder_of_its_own() -> None:
    settings = recorded_apart(settings_of(AgentOptions()), "a1")
    assert settings.record == default_folder() / "a1"
    assert recorded_apart(settings_of(AgentOptions(no_record=True)), "a1").record is None


@pytest.mark.parametrize("is_ours", [True, False])
def test_logs_make_room_in_our_folder_and_in_no_other(tmp_path: Path, is_ours: bool) -> None:
    folder = default_folder() if is_ours else tmp_path
    settings = recorded_apart(Settings(record=folder, record_keep=1), "a1")
    flights = _flights(settings, lambda text, level: None)
    assert flights is not None
    flights.folder.mkdir(parents=True, exist_ok=True)
    paths = [flights.folder / f"m100link-20260101-00000{n}.mcap" for n in range(3)]
    for path in paths:
        with path.open("wb") as stream:
            header = b"\0\0\0\0" + (13).to_bytes(4, "little") + b"m100link 1.23"
            stream.write(b"\x89MCAP0\r\n\x01" + len(header).to_bytes(8, "little") + header)
    flights.make_room()
    assert sum(path.exists() for path in paths) == (1 if is_ours else 3)
    for path in paths:
        path.unlink(missing_ok=True)


@pytest.mark.pty
def test_each_connection_leaves_a_log_that_is_whole(site: Site, tmp_path: Path) -> None:
    agent = site.start("agent", "sim://", "--name", "a", "--count", "2", "--json")
    assert agent.stdout is not None
    assert json.loads(agent.stdout.readline())["agents"] == ["a1", "a2"]
    assert [card["connection"] for card in site.listed(2)] == ["connected"] * 2
    assert site.ask("takeoff", "a2")[0] == 0
    agent.send_signal(signal.SIGTERM)
    assert agent.wait(PATIENCE) == 0
    for name in ("a1", "a2"):
        [path] = (tmp_path / "m100link/flights" / name).iterdir()
        assert read(path).summary().is_whole


@pytest.mark.pty
@pytest.mark.parametrize("is_json", [False, True])
def test_what_happens_is_told_once_and_on_one_line(
    site: Site, tmp_path: Path, is_json: bool
) -> None:
    words = ["agent", "sim://", "--name", "a1", *(["--log-json"] if is_json else [])]
    folder = tmp_path / ("a long name of a folder " * 4).strip()
    agent = subprocess.Popen(
        [sys.executable, "-m", "m100link", "fleet", *words, "--record", str(folder)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=site.environment,
    )
    try:
        site.listed(1)
        assert site.ask("takeoff", "a1")[0] == 0
        holder = site.start("lease", "a1", "--json")
        assert holder.stdout is not None
        assert holder.stdout.readline()
        holder.kill()  # the agent warns: its lease ends by silence
        ends = time.monotonic() + PATIENCE
        while time.monotonic() < ends and site.listed(1)[0]["holder"]:
            time.sleep(0.1)
    finally:
        agent.send_signal(signal.SIGTERM)
        _, told = agent.communicate(timeout=PATIENCE)
    lines = told.splitlines()
    assert sum("gave control back (expired)" in line for line in lines) == 1
    assert sum(f"recorded into {folder}/a1/" in line for line in lines) == (0 if is_json else 1)
    if is_json:
        expired = [json.loads(line) for line in lines if "expired" in line]
        assert [(one["level"], one["aircraft"]) for one in expired] == [("WARNING", "a1")]


@pytest.mark.pty
def test_where_nothing_can_be_written_it_flies_all_the_same(site: Site, tmp_path: Path) -> None:
    taken = tmp_path / "taken"
    taken.touch()
    site.start("agent", "sim://", "--name", "a1", "--record", str(taken))
    site.start("agent", "sim://", "--name", "a2", "--no-record")
    site.listed(2)
    status, told = site.ask("takeoff", "--all")
    assert (status, [one["outcome"] for one in told]) == (0, ["ok", "ok"])
    assert not (tmp_path / "m100link/flights").exists()
