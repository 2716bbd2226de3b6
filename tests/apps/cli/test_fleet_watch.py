"""``m100link fleet log`` over a real network: what was cut off goes on; who flies comes first."""

from __future__ import annotations

import asyncio
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from m100link.apps.agent import orders
from m100link.apps.fleet.asking import Asker
from m100link.apps.fleet.client import open_fleet
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.payloads import LogQuestion, Outcome, What, pack
from m100link.log import read
from tests.apps.cli.test_fleet import Site, site
from tests.waiting import PATIENCE

__all__ = [
    "site",
]


pytest.importorskip("zenoh", reason="the extra fleet is not installed")


pytestmark = pytest.mark.pty

STOP = orders.Stop()
OLD = "m100link-20260101-000000.mcap"
SIZE = 1_000_000


@pytest.fixture
def onboard(tmp_path: Path) -> Path:
    """The folder on board, with one old log."""
    folder = tmp_path / "m100link/flights/a1"
    folder.mkdir(parents=True)
    (folder / OLD).write_bytes(random.Random(1).randbytes(SIZE))
    return folder


def agent(site: Site, *words: str) -> subprocess.Popen[str]:
    process = site.start("agent", "sim://", "--name", "a1", *words)
    assert [card["connection"] for card in site.listed(1)] == ["connected"]
    return process


def cut_off(site: Site, here: Path, at: int = 150_000) -> subprocess.Popen[str]:
    """A fetch under way, of which so much is here."""
    process = site.start("log", "fetch", "a1", "--file", OLD, "--output", str(here))
    part = here / f"a1-{OLD}.part"
    ends = time.monotonic() + PATIENCE
    while time.monotonic() < ends and (not part.exists() or part.stat().st_size < at):
        time.sleep(0.02)
    assert process.poll() is None
    return process


def fetched(site: Site, here: Path) -> dict[str, Any]:
    status, [told] = site.ask("log", "fetch", "a1", "--file", OLD, "--output", str(here))
    assert (status, told["outcome"]) == (0, "ok")
    return told


def test_logs_are_listed_and_fetched_and_one_that_is_written_is_said(
    site: Site, onboard: Path, tmp_path: Path
) -> None:
    agent(site)
    status, told = site.ask("log", "list", "--all")
    assert status == 0
    assert [(one["name"], one["log"], one["is_written"]) for one in told][1:] == [
        ("a1", OLD, False)
    ]
    assert told[0]["is_written"]
    listed = subprocess.run(
        [sys.executable, "-m", "m100link", "fleet", "log", "list", "a1", "--table"],
        capture_output=True,
        text=True,
        env=site.environment,
        timeout=PATIENCE,
        check=True,
    ).stdout.splitlines()
    assert [line.split()[1] for line in listed] == ["log", told[0]["log"], OLD]
    assert "1.0 MB" in listed[2]
    assert listed[1].endswith(", and still")
    status, [newest] = site.ask("log", "fetch", "a1", "--output", str(tmp_path / "here"))
    assert (status, newest["log"], newest["is_written"]) == (0, told[0]["log"], True)
    assert not read(newest["path"]).summary().is_whole
    assert fetched(site, tmp_path / "here")["came"] == SIZE
    assert (tmp_path / "here" / f"a1-{OLD}").read_bytes() == (onboard / OLD).read_bytes()
    assert fetched(site, tmp_path / "here")["came"] == 0


def test_mistakes_are_reported_with_what_to_do(site: Site, onboard: Path, tmp_path: Path) -> None:
    agent(site)
    status, [told] = site.ask("log", "fetch", "a1", "--file", "../a2/x", "--output", str(tmp_path))
    assert (status, told["outcome"]) == (1, "refused")
    assert told["remedy"] == "m100link fleet log list a1"
    status, [told] = site.ask("log", "fetch", "a7")
    assert (status, told["outcome"]) == (1, "unreachable")
    assert site.ask("log", "fetch")[0] == 2


def test_ctrl_c_ends_it_at_once_and_the_next_one_goes_on(
    site: Site, onboard: Path, tmp_path: Path
) -> None:
    agent(site, "--log-rate", "0.2")
    process = cut_off(site, tmp_path)
    began = time.monotonic()
    process.send_signal(signal.SIGINT)
    assert process.wait(PATIENCE) == 130
    assert time.monotonic() - began < 5.0
    there = (tmp_path / f"a1-{OLD}.part").stat().st_size
    assert there >= 150_000
    assert fetched(site, tmp_path)["came"] == SIZE - there
    assert (tmp_path / f"a1-{OLD}").read_bytes() == (onboard / OLD).read_bytes()


def test_whichever_is_killed_meanwhile_the_next_one_goes_on(
    site: Site, onboard: Path, tmp_path: Path
) -> None:
    on_board = agent(site, "--log-rate", "0.2")
    process = cut_off(site, tmp_path)
    process.kill()
    process.wait(PATIENCE)
    first = (tmp_path / f"a1-{OLD}.part").stat().st_size
    process = cut_off(site, tmp_path, first + 100_000)
    on_board.kill()
    assert process.wait(PATIENCE) == 1
    second = (tmp_path / f"a1-{OLD}.part").stat().st_size
    assert second > first
    agent(site)
    assert fetched(site, tmp_path)["came"] == SIZE - second
    assert (tmp_path / f"a1-{OLD}").read_bytes() == (onboard / OLD).read_bytes()


def test_stop_is_quick_however_many_fetch(site: Site, onboard: Path) -> None:
    """A hundred at once ask for as much as goes in one answer, without a pause."""
    agent(site, "--log-rate", "20")
    keys = Keys("site", "a1")

    async def attack() -> tuple[list[float], int]:
        async with (
            open_fleet("client", connect=(site.place,)) as flood,
            open_fleet("client", connect=(site.place,)) as pilot,
        ):
            strangers = Asker(flood, keys, "everybody")
            question = LogQuestion(What.PIECE, OLD, 0, 256 * 1024)
            answered = 0

            async def fetch() -> None:
                nonlocal answered
                while True:
                    payload = pack(strangers.around(question))
                    answered += len(await flood.ask(keys.log, payload, timeout=1.0))

            async with asyncio.TaskGroup() as group:
                flooding = [group.create_task(fetch()) for _ in range(100)]
                await asyncio.sleep(1.0)
                took = []
                for _ in range(20):
                    began = time.monotonic()
                    reply = await Asker(pilot, keys, "anna").ask(STOP)
                    assert reply.outcome is Outcome.OK
                    took.append(time.monotonic() - began)
                    await asyncio.sleep(0.2)
                for one in flooding:
                    one.cancel()
        return took, answered

    took, answered = asyncio.run(attack())
    assert answered > 0
    assert max(took) < 1.0, took
