"""Ctrl-C at the verbs of a fleet that move an aircraft; and how many of twenty take off."""

from __future__ import annotations

import asyncio
import json
import signal
import socket
import subprocess
from collections.abc import Callable
from pathlib import Path

import anyio
import anyio.to_thread
import pytest

from m100link.apps.bus.network import Question
from m100link.apps.cli.fleet import Left, told_when_interrupted
from m100link.apps.fleet.client import Fleet, connect
from m100link.apps.fleet.keys import DEFAULT_SITE, Keys
from m100link.apps.fleet.payloads import Card
from m100link.sim.vehicle.activation import DEMO_APP_ID, DEMO_KEY
from tests.apps.cli.terminal import Terminal, terminal
from tests.apps.cli.test_fleet import Site, site
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


CTRL_C = "\x03"


def ended(screen: Terminal) -> str:
    """What a person is told who presses Ctrl-C."""
    screen.type(CTRL_C)
    assert screen.end() == _INTERRUPTED, screen.shown
    return " ".join(screen.shown.split())


@pytest.mark.anyio
async def test_what_goes_on_on_board_is_told_and_ends_as_it_is_told(site: Site) -> None:
    site.start("agent", "sim://", "--name", "a1")
    async with connect(site.place, name="watcher") as watcher:
        await until(watcher, lambda card: card.connection == "connected")
        with terminal("fleet", "takeoff", "--all", environment=site.environment) as screen:
            await until(watcher, lambda card: (card.height_m or 0.0) > 0.2)
            told = await anyio.to_thread.run_sync(ended, screen)
        assert "a1 unknown interrupted: control goes back" in told
        assert "what has left the ground hovers" in told
        assert "m100link fleet land a1" in told
        await until(watcher, lambda card: not card.holder and not card.task)
        before = await until(watcher, lambda card: (card.height_m or 0.0) > 0.5)
        await anyio.sleep(2.0)
        after = await until(watcher, bool)
        assert before.height_m is not None
        assert after.height_m == pytest.approx(before.height_m, abs=1.0), "it hovers"

        latitude, longitude = place(after)
        async with watcher["a1"].control() as control:
            await control.fly_to(latitude_deg=latitude, longitude_deg=longitude, height=20.0)
        with terminal("fleet", "land", "a1", environment=site.environment) as screen:
            await until(watcher, lambda card: card.task == "land")
            told = await anyio.to_thread.run_sync(ended, screen)
        assert "a1 unknown interrupted: a landing that it has heard of goes on" in told
        assert "m100link fleet stop a1 ends it: it hovers" in told
        low = await until(watcher, lambda card: (card.height_m or 0.0) < 17.0)
        assert low.task == "land", "it goes on"
        assert await anyio.to_thread.run_sync(site.ask, "stop", "a1") == (
            0,
            [{"name": "a1", "outcome": "ok"}],
        )
        await until(watcher, lambda card: not card.task and not card.holder)
        before = await until(watcher, bool)
        await anyio.sleep(2.0)
        after = await until(watcher, bool)
        assert (after.height_m or 0.0) > 1.0
        assert after.height_m == pytest.approx(before.height_m, abs=0.5), "it hovers"


@pytest.mark.anyio
async def test_a_stop_that_nobody_answers_is_unknown_and_told_as_that(site: Site) -> None:
    keys = Keys(DEFAULT_SITE, "a1")
    asked: list[Question] = []  # kept: one that is thrown away is answered by nobody, at once
    async with connect(site.place, name="one that hangs") as there:
        held = (
            there.bus.declare(keys.live_by(there.bus.session)),
            there.bus.serve(keys.command, asked.append),
        )
        with terminal("fleet", "stop", "a1", "nobody", environment=site.environment) as screen:
            with anyio.fail_after(PATIENCE):
                while not asked:  # noqa: ASYNC110 - the network sets no event
                    await anyio.sleep(0.05)
            told = await anyio.to_thread.run_sync(ended, screen)
        for one in held:
            one.close()
    assert "a1 unknown interrupted: it stops if it has heard of it" in told
    assert "m100link fleet stop a1 again" in told


@pytest.mark.anyio
async def test_what_is_told_of_one_order_is_told_only_when_it_is_interrupted(
    capfd: pytest.CaptureFixture[str],
) -> None:
    left = Left("it may fly", "m100link fleet stop {name} ends it")
    with told_when_interrupted("a1", left):
        pass
    assert capfd.readouterr().err == ""
    with pytest.raises(asyncio.CancelledError), told_when_interrupted("a1", left):
        raise asyncio.CancelledError
    told = capfd.readouterr().err
    assert told == "a1: interrupted: it may fly\nm100link fleet stop a1 ends it\n"


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
