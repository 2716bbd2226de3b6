"""A show flown by agents in a process of their own, by the command."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from m100link.apps.cli.outcome import ExitCode
from m100link.geodesy import LocalFrame
from tests.apps.cli.conftest import CommandLine
from tests.apps.cli.test_fleet import Site
from tests.apps.fleet.show.shows import FIVE
from tests.apps.fleet.test_pki import free_port

pytest.importorskip("zenoh", reason="the extra fleet is not installed")


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
def site(tmp_path: Path) -> Iterator[Site]:
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


@pytest.mark.pty
def test_a_show_is_flown_and_who_is_not_there_is_named(site: Site, tmp_path: Path) -> None:
    file = show(tmp_path, ("a1", "a2"))
    status, told = site.ask("show", "fly", file, "--yes")
    assert (status, [one["stage"] for one in told]) == (ExitCode.OK, ["flown", "flown"])
    assert site.ask("land", "--all")[0] == ExitCode.OK  # whoever lands still is in no other show
    status, told = site.ask("show", "fly", show(tmp_path, ("a1", "a2", "a3")), "--yes")
    assert (status, told) == (ExitCode.FAILED, [])


def test_nobody_takes_off_without_a_yes_or_by_a_show_that_is_not_sound(
    cli: CommandLine, tmp_path: Path
) -> None:
    outcome = cli("fleet", "show", "fly", str(FIVE))
    assert outcome.status == ExitCode.USAGE
    assert "--yes" in outcome.err
    outcome = cli("fleet", "show", "fly", str(FIVE), "--yes", "--max-radius", "5")
    assert outcome.status == ExitCode.USAGE
    assert "the envelope ends at 5 m" in outcome.err
    assert "this show is not flown" in outcome.err
