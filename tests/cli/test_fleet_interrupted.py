"""Ctrl-C at the verbs of a fleet that move an aircraft; and how many of twenty take off."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
from collections.abc import Callable
from pathlib import Path

import anyio
import anyio.to_thread
import pytest

from m100link.fleet.client import Fleet, connect
from m100link.fleet.payloads import Card
from m100link.sim.vehicle.mobile import DEMO_APP_ID, DEMO_KEY
from tests.cli.test_fleet import Site, site
from tests.waiting import PATIENCE

__all__ = ["site"]

pytest.importorskip("zenoh", reason="the extra fleet is not installed")

pytestmark = pytest.mark.pty

_INTERRUPTED = 130


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


async def until(watcher: Fleet, holds: Callable[[Card], object]) -> Card:
    """The card of a1, as soon as that holds of it."""
    with anyio.fail_after(2 * PATIENCE):
        while True:
            card = (await watcher.cards()).get("a1")
            if card is not None and holds(card):
                return card
            await anyio.sleep(0.05)


def place(card: Card) -> tuple[float, float]:
    assert card.latitude_deg is not None
    assert card.longitude_deg is not None
    return card.latitude_deg, card.longitude_deg


async def interrupted(process: subprocess.Popen[str]) -> None:
    process.send_signal(signal.SIGINT)
    assert await anyio.to_thread.run_sync(process.wait, PATIENCE) == _INTERRUPTED


@pytest.mark.anyio
async def test_ctrl_c_leaves_a_hover_and_does_not_break_off_a_landing(site: Site) -> None:
    site.start("agent", "sim://", "--name", "a1")
    async with connect(site.place, name="watcher") as watcher:
        await until(watcher, lambda card: card.connection == "connected")
        taking_off = site.start("takeoff", "a1")
        await until(watcher, lambda card: card.holder)
        await interrupted(taking_off)
        await until(watcher, lambda card: not card.holder and not card.has_authority)

        await watcher["a1"].take_off()
        latitude, longitude = place(await until(watcher, lambda card: card.phase == "in air"))
        flying = site.start("goto", "a1", f"{latitude + 0.0007}", f"{longitude}", "8")
        await until(watcher, lambda card: place(card)[0] > latitude + 0.00005)  # 5 m
        await interrupted(flying)
        await until(watcher, lambda card: not card.holder and not card.task)
        await anyio.sleep(3.0)  # it brakes
        before = place(await until(watcher, bool))
        await anyio.sleep(2.0)
        after = place(await until(watcher, bool))
        assert after == pytest.approx(before, abs=0.00001), "it hovers"
        assert after[0] < latitude + 0.00063, "the rest of 78 m was not flown"

        landing = site.start("land", "a1")
        await until(watcher, lambda card: card.task == "land")
        await interrupted(landing)
        await until(watcher, lambda card: card.phase == "standby" and not card.holder)


def simulated(site: Site, path: Path, order: str) -> str:
    """Where an aircraft is to which that was done."""
    path.write_text(f'[[step]]\nat = 0.0\ndo = "{order}"\n')
    words = ("--tcp", "127.0.0.1:0", "--scenario", str(path), "--json")
    simulator = site.start(*words, verb="sim")
    assert simulator.stdout is not None
    return str(json.loads(simulator.stdout.readline())["port"])


def test_of_twenty_three_do_not_take_off_and_the_exit_status_says_so(
    site: Site, tmp_path: Path
) -> None:
    """One in P mode, one with an empty battery, one behind a port where nobody is."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        nobody = f"tcp://127.0.0.1:{probe.getsockname()[1]}"
    bad = {
        "b1": simulated(site, tmp_path / "p.toml", "rc-mode P"),
        "b2": simulated(site, tmp_path / "battery.toml", "battery 10"),
        "b3": nobody,
    }
    site.environment |= {
        "M100LINK_APP_ID": str(DEMO_APP_ID),
        "M100LINK_KEY": DEMO_KEY.reveal().hex(),
    }
    site.start("agent", "sim://", "--name", "a", "--count", "17")
    site.start("agent", *(f"{name}={url}" for name, url in bad.items()))
    assert len(site.listed(19)) == 20
    status, told = site.ask("takeoff", "--all")
    outcomes = {one["name"]: one for one in told}
    assert status == 1
    assert len(outcomes) == 20
    assert {name for name, one in outcomes.items() if one["outcome"] != "ok"} == set(bad), told
    assert all(outcomes[name]["seen"] for name in bad), "each with its reason"
    assert "battery" in outcomes["b2"]["seen"]
