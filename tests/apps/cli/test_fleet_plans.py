"""Shows at the shell."""

from __future__ import annotations

import asyncio
import io
import json
import os
import signal
import stat
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from contextlib import ExitStack, nullcontext
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

from m100link.apps.cli import fleet_plans
from m100link.apps.cli.fleet import borrowed, lease_file, shared
from m100link.apps.cli.terminal import ExitCode, ReaderGone
from m100link.errors import UsageError
from m100link.geodesy import LocalFrame
from m100link.missions.plan import WaypointPlan
from m100link.missions.waypoint import Waypoint
from tests.apps.cli.conftest import CommandLine
from tests.apps.cli.test_fleet import Site, site
from tests.apps.fleet.show.shows import FIVE, five
from tests.apps.fleet.test_pki import free_port
from tests.waiting import PATIENCE

__all__ = ["site"]

needs_zenoh = pytest.mark.skipif(
    find_spec("zenoh") is None, reason="the extra fleet is not installed"
)

FILE = str(FIVE)


@pytest.mark.parametrize(
    ("ends", "status"),
    [
        (None, ExitCode.OK),
        (ReaderGone(), ExitCode.FAILED),
        (asyncio.CancelledError(), ExitCode.INTERRUPTED),
    ],
    ids=["flown", "reader gone", "cancelled"],
)
def test_a_flight_that_was_ended_from_here_is_no_success(
    ends: BaseException | None, status: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A reader that leaves is success for verbs that only print; here it ends a flight."""
    aircraft = MagicMock()
    for opened in (control := aircraft.__getitem__.return_value.control.return_value, aircraft):
        opened.__aenter__.return_value = opened
        opened.__aexit__.return_value = None
    mission = control.waypoint_mission.return_value
    mission.__aenter__.return_value, mission.__aexit__.return_value = mission, None
    mission.__aiter__.return_value = ["event"]
    monkeypatch.setattr(fleet_plans, "shared", lambda *_: nullcontext())
    monkeypatch.setattr(fleet_plans, "read_plan", MagicMock())
    monkeypatch.setattr(fleet_plans._Show, "tell", MagicMock(side_effect=ends))
    monkeypatch.setattr(fleet_plans._Show, "stopped", lambda _: "it hovers")
    options: Any = SimpleNamespace(place="", open=lambda: aircraft)
    assert fleet_plans.fly("a1", "plan.json", yes=True, options=options) == status


@pytest.fixture
def crossing(tmp_path: Path) -> str:
    """Two of the five fly through each other's place."""
    found: dict[str, Any] = five()
    for point in found["aircraft"][1]["waypoints"][1:3]:
        point["east"], point["north"] = 0, point["north"] + 6
    path = tmp_path / "crossing.json"
    path.write_text(json.dumps(found), encoding="utf-8")
    return str(path)


def test_a_sound_show_is_reported_in_numbers(cli: CommandLine) -> None:
    outcome = cli("fleet", "show", "check", FILE)
    assert outcome.status == ExitCode.OK
    [told] = outcome.objects
    assert (told["ok"], told["problems"], told["remarks"]) == (True, [], [])
    assert told["closest"]["distance_m"] == pytest.approx(10, abs=0.01)
    assert set(told["tracks"]) == {"a1", "a2", "a3", "a4", "a5"}
    assert all(len(digest) == 64 for digest in told["tracks"].values())


def test_a_sound_show_is_reported_in_words(cli: CommandLine) -> None:
    first, second, *rest = cli("fleet", "show", "check", FILE, "--table").out.splitlines()
    assert first == "✓ 5 aircraft, 36 s"
    assert "10.00 m at 36.00 s" in second
    assert len(rest) == 5


def test_an_aircraft_that_comes_too_near_is_named_with_the_time(
    cli: CommandLine, crossing: str
) -> None:
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


def test_tracks_of_other_programs_become_a_show(cli: CommandLine, tmp_path: Path) -> None:
    rows = [f"{at},{at / 2000},0,{min(5.0, at / 500)}" for at in range(0, 10_000, 250)]
    for name, shift in (("a1", "0"), ("a2", "-9")):
        text = "\n".join(("Time [msec],x [m],y [m],z [m]", *rows)).replace(",0,", f",{shift},")
        (tmp_path / f"{name}.csv").write_text(text)
    show = tmp_path / "show.json"
    tracks = [str(tmp_path / f"{name}.csv") for name in ("a1", "a2")]
    made = cli("fleet", "show", "import", str(show), *tracks, "--origin", "52.1,4.31")
    assert made.status == ExitCode.OK, made.err
    found = json.loads(show.read_text())
    assert found["origin"] == {"latitude_deg": 52.1, "longitude_deg": 4.31}
    assert [one["waypoints"][-1]["east"] for one in found["aircraft"]] == [0.0, 9.0]
    again = cli("fleet", "show", "import", str(show), *tracks, "--origin", "52.1,4.31")
    assert again.status == ExitCode.USAGE
    assert cli("fleet", "show", "check", str(show), "--json").status in (0, 2)
    bad = cli("fleet", "show", "import", "-", FILE, "--origin", "52.1,4.31")
    assert bad.status == ExitCode.USAGE
    assert "is no track" in bad.err


def test_what_is_no_show_is_reported(cli: CommandLine, monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_a_picture_goes_to_a_pipe(cli: CommandLine, crossing: str) -> None:
    outcome = cli("fleet", "show", "preview", crossing, "-")
    assert outcome.status == ExitCode.USAGE
    assert outcome.out.startswith("<svg")
    assert "✗ a2 and a3 come as near as" in outcome.err


def test_a_picture_that_cannot_be_written_is_reported(cli: CommandLine) -> None:
    outcome = cli("fleet", "show", "preview", FILE, "/dev/full", "--force")
    assert outcome.status == ExitCode.USAGE
    assert "cannot be written" in outcome.err


# -- ``m100link fleet mission`` over a real network, from one shell and from two -------------------


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
    return site.start("mission", "fly", "a1", str(plan), "--takeoff", "--yes", "--json")


@needs_zenoh
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


@needs_zenoh
@pytest.mark.pty
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGHUP, signal.SIGTERM, signal.SIGKILL])
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


@needs_zenoh
@pytest.mark.pty
def test_mistakes_are_reported_before_anything_flies(
    site: Site, plan: Path, tmp_path: Path
) -> None:
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


@needs_zenoh
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
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(other))
    refused = pytest.raises(UsageError, match="cannot be written")
    with refused, shared("site", "a1", (6, "secret 6")):
        raise AssertionError("nobody else can order under it")
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    assert lease_file("site", "a1").is_relative_to(os.environ["XDG_STATE_HOME"])
    monkeypatch.setenv("XDG_RUNTIME_DIR", "run")  # the standard has a relative one ignored
    assert lease_file("site", "a1").is_relative_to(os.environ["XDG_STATE_HOME"])


@needs_zenoh
@pytest.mark.parametrize("name", ["../a1", "/etc/x", "", "a/b"])
def test_a_name_does_not_lead_out_of_the_folder_of_leases(name: str) -> None:
    with pytest.raises(UsageError):
        lease_file("site", name)
    with pytest.raises(UsageError):
        lease_file(name, "a1")


# -- A show flown by agents in a process of their own, by the command ------------------------------


def show(folder: Path, names: tuple[str, ...]) -> str:
    """Each flies 4 m north and up, 10 m beside the one before."""
    aircraft = [
        {
            "name": name,
            "waypoints": [
                {"at": 0, "north": 0, "east": 10 * index, "height": 3},
                {"at": 6, "north": 4, "east": 10 * index, "height": 4},
            ],
        }
        for index, name in enumerate(names)
    ]
    origin = {"latitude_deg": 52.1, "longitude_deg": 4.31}
    path = folder / "show.json"
    head = {"format": "m100link show", "version": 1, "origin": origin, "aircraft": aircraft}
    path.write_text(json.dumps(head), encoding="utf-8")
    return str(path)


@pytest.fixture
def show_site(tmp_path: Path) -> Iterator[Site]:
    with ExitStack() as stack:
        made = Site(stack, f"tcp/127.0.0.1:{free_port()}", tmp_path)
        router = made.start("router", "--listen", made.place, "--json")
        assert router.stdout is not None
        assert router.stdout.readline()
        words = []
        for index, name in enumerate(("a1", "a2")):
            latitude, longitude = LocalFrame(52.1, 4.31).to_geodetic(0, 10 * index)
            place = f"latitude={latitude:.8f}&longitude={longitude:.8f}"
            words.append(f"{name}=sim://?{place}")
        agents = made.start("agent", *words, "--json")
        assert agents.stdout is not None
        assert agents.stdout.readline()
        made.listed(2)
        yield made


@needs_zenoh
@pytest.mark.pty
def test_a_show_is_flown_and_who_is_not_there_is_named(show_site: Site, tmp_path: Path) -> None:
    file = show(tmp_path, ("a1", "a2"))
    status, told = show_site.ask("show", "fly", file, "--yes")
    assert (status, [one["stage"] for one in told]) == (ExitCode.OK, ["flown", "flown"])
    assert (
        show_site.ask("land", "--all")[0] == ExitCode.OK
    )  # an aircraft that lands still is in no other show
    status, told = show_site.ask("show", "fly", show(tmp_path, ("a1", "a2", "a3")), "--yes")
    assert (status, told) == (ExitCode.FAILED, [])


@needs_zenoh
@pytest.mark.pty
def test_a_closed_terminal_ends_a_show_that_has_not_begun_and_all_land(
    show_site: Site, tmp_path: Path
) -> None:
    flying = show_site.start("show", "fly", show(tmp_path, ("a1", "a2")), "--yes")
    show_site.listed(2, lambda card: (card.get("height_m") or 0.0) > 0.5)
    flying.send_signal(signal.SIGHUP)
    assert flying.wait(PATIENCE) == ExitCode.INTERRUPTED
    cards = show_site.listed(2, lambda card: (card.get("height_m") or 0.0) < 0.2)
    assert [round(card["height_m"]) for card in cards] == [0, 0]


@needs_zenoh
def test_nobody_takes_off_without_a_yes_or_by_a_show_that_is_not_sound(
    cli: CommandLine, tmp_path: Path
) -> None:
    outcome = cli("fleet", "show", "fly", str(FIVE))
    assert outcome.status == ExitCode.USAGE
    assert "--yes" in outcome.err
    outcome = cli("fleet", "show", "fly", str(FIVE), "--yes", "--max-radius", "5")
    assert outcome.status == ExitCode.USAGE
    assert "the envelope ends at 5 m" in outcome.err
    assert "this show must not be flown" in outcome.err
    assert f"m100link fleet show check {FIVE}" in outcome.err
