"""``m100link fleet mission`` over a real network, from one shell and from two."""

from __future__ import annotations

import json
import os
import signal
import stat
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("zenoh", reason="the extra fleet is not installed")

from m100link.apps.cli.fleet import borrowed, lease_file, shared
from m100link.errors import UsageError
from m100link.geodesy import LocalFrame
from m100link.missions.plan import WaypointPlan
from m100link.missions.waypoint import Waypoint
from tests.apps.cli.test_fleet import Site, site
from tests.waiting import PATIENCE

__all__ = ["site"]


@pytest.fixture
def plan(site: Site, tmp_path: Path) -> Path:
    """An aircraft of firmware 3.1 that is there, and a plan beside it."""
    site.environment["XDG_RUNTIME_DIR"] = str(tmp_path)
    site.start("agent", "sim://", "--name", "a1", "--firmware", "3.1", "--no-record")
    [card] = site.listed(1, lambda card: card.get("latitude_deg") is not None)
    frame = LocalFrame(card["latitude_deg"], card["longitude_deg"])
    points = [Waypoint(*frame.to_geodetic(north, 0), height=6) for north in (10, 40)]
    path = tmp_path / "plan.json"
    # Slow: it lasts longer than a busy machine takes to begin two more commands.
    path.write_text(WaypointPlan(points, speed=2).to_json())
    return path


def until(site: Site, is_so: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
    """How far the mission is, when it is so."""
    ends = time.monotonic() + 2 * PATIENCE
    while time.monotonic() < ends:
        status, told = site.ask("mission", "progress", "a1")
        if status == 0 and is_so(told[0]):
            return told[0]
    raise AssertionError(f"it did not come so far: {told}")


def fly(site: Site, plan: Path) -> subprocess.Popen[str]:
    return site.start("mission", "fly", "a1", str(plan), "--take-off", "--yes", "--json")


@pytest.mark.pty
def test_it_flies_to_its_end_and_is_paused_from_another_shell(site: Site, plan: Path) -> None:
    flying = fly(site, plan)
    until(site, lambda card: card["stage"] == "flying")
    assert site.ask("mission", "pause", "a1")[0] == 0
    paused = until(site, lambda card: card["is_paused"])
    assert paused["points"] == 2
    assert site.ask("mission", "resume", "a1")[0] == 0
    told, _ = flying.communicate(timeout=4 * PATIENCE)
    assert flying.returncode == 0
    events = [json.loads(line)["event"] for line in told.splitlines()]
    plain = [event for event in events if event != "mission_progress"]
    assert [one for one in plain if one not in ("paused", "resumed")] == [
        *("uploaded", "started", "reached", "reached", "finished")
    ]
    assert plain.index("paused") < plain.index("resumed")
    over = until(site, lambda card: card["stage"] in ("over", "none"))
    assert (over["is_finished"], over["fault"]) == (True, None)
    assert site.ask("mission", "pause", "a1")[0] == 2, "nobody has control any more"


@pytest.mark.pty
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_whatever_ends_the_command_ends_the_mission(
    site: Site, plan: Path, how: signal.Signals
) -> None:
    flying = fly(site, plan)
    until(site, lambda card: card["stage"] == "flying")
    flying.send_signal(how)
    assert flying.wait(PATIENCE) == (-9 if how is signal.SIGKILL else 130)
    over = until(site, lambda card: card["stage"] in ("over", "none"))
    assert not over["is_finished"]
    assert until(site, lambda card: card["kind"] == "no mission")
    assert [card["phase"] for card in site.listed(1, lambda card: card.get("phase") == "in air")]


@pytest.mark.pty
def test_steps_go_under_the_lease_that_another_shell_holds(site: Site, plan: Path) -> None:
    assert site.ask("mission", "upload", "a1", str(plan))[0] == 2
    holder = site.start("lease", "a1", "--json")
    assert holder.stdout is not None
    assert holder.stdout.readline()
    assert site.ask("mission", "start", "a1")[0] == 2
    assert site.ask("mission", "upload", "a1", str(plan))[0] == 0
    assert site.ask("mission", "start", "a1", "--take-off")[0] == 0
    assert until(site, lambda card: card["stage"] == "flying")["by"]
    assert site.ask("mission", "stop", "a1")[0] == 0
    over = until(site, lambda card: card["stage"] == "over")
    assert over["fault"]["kind"] == "NotObserved"
    holder.send_signal(signal.SIGINT)
    assert holder.wait(PATIENCE) == 0
    assert site.ask("mission", "start", "a1")[0] == 2


@pytest.mark.pty
def test_mistakes_are_told_before_anything_flies(site: Site, plan: Path, tmp_path: Path) -> None:
    assert site.ask("mission", "fly", "a1", str(tmp_path / "none.json"), "--yes")[0] == 2
    assert site.ask("mission", "fly", "a7", str(plan), "--yes")[0] == 1
    assert site.ask("mission", "progress", "a7")[0] == 1
    done = subprocess.run(
        [sys.executable, "-m", "m100link", "fleet", "mission", "fly", "a1", str(plan)],
        input="",
        capture_output=True,
        text=True,
        env=site.environment,
        timeout=PATIENCE,
        check=False,
    )
    assert done.returncode == 2
    assert "--yes" in done.stderr
    assert until(site, lambda card: card["stage"] == "none")


def test_a_lease_is_shared_with_nobody_else_and_no_longer_than_it_is_held(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    path = lease_file("site", "a1")
    assert path.is_relative_to(tmp_path)
    with shared("site", "a1", (3, "secret 3")):
        assert borrowed("site", "a1") == (3, "secret 3")
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        with pytest.raises(UsageError, match="no command of this account"):
            borrowed("site", "a2")
        with shared("site", "a1", (4, "secret 4")):
            assert borrowed("site", "a1") == (4, "secret 4")
    assert not path.exists()
    for junk in ("", "[]", "{", '{"fence": "x", "token": 1}'):
        path.write_text(junk)
        with pytest.raises(UsageError, match="cannot be read"):
            borrowed("site", "a1")
    path.unlink()
    other = tmp_path / "other"
    other.write_text("mine")
    path.symlink_to(other)
    with shared("site", "a1", (5, "secret 5")):
        assert not path.is_symlink()
    assert other.read_text() == "mine"
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    assert lease_file("site", "a1").is_relative_to(os.environ["XDG_STATE_HOME"])


@pytest.mark.parametrize("name", ["../a1", "/etc/x", "", "a/b"])
def test_a_name_does_not_lead_out_of_the_folder_of_leases(name: str) -> None:
    with pytest.raises(UsageError):
        lease_file("site", name)
    with pytest.raises(UsageError):
        lease_file(name, "a1")
