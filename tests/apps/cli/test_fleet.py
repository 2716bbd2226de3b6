"""``m100link fleet`` as people use it: a router, agents, orders, in processes of their own."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import anyio
import anyio.to_thread
import pytest

from m100link.apps.bus.network import Question
from m100link.apps.cli import fleet as fleet_commands
from m100link.apps.cli.fleet import (
    NO_OPTIONS,
    FleetOptions,
    tell_results,
)
from m100link.apps.cli.terminal import OutputFormat
from m100link.apps.fleet.client import Fleet, connect
from m100link.apps.fleet.keys import DEFAULT_SITE, Keys
from m100link.apps.fleet.payloads import Card, Result
from m100link.errors import StaleLease
from m100link.protocol.items import BY_RECORD
from m100link.protocol.records import Attitude
from m100link.sim.vehicle.activation import DEMO_APP_ID, DEMO_KEY
from tests.apps.cli.terminal import Terminal, terminal
from tests.waiting import PATIENCE

pytest.importorskip("zenoh", reason="the extra fleet is not installed")


class Site:
    """A router, and what is started beside it."""

    def __init__(self, stack: ExitStack, place: str, state: Path) -> None:
        self._stack = stack
        self.environment = os.environ | {"M100LINK_FLEET": place, "XDG_STATE_HOME": str(state)}
        self.place = place

    def start(self, *words: str, verb: str = "fleet") -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "m100link", verb, *words]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=self.environment)
        self._stack.callback(self._end, process)
        return process

    def _end(self, process: subprocess.Popen[str]) -> None:
        process.kill()
        process.wait(PATIENCE)
        if process.stdout is not None:
            process.stdout.close()

    def ask(self, *words: str) -> tuple[int, list[dict[str, Any]]]:
        command = [sys.executable, "-m", "m100link", "fleet", *words, "--json"]
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            env=self.environment,
            timeout=2 * PATIENCE,
            check=False,
        )
        return done.returncode, [json.loads(line) for line in done.stdout.splitlines()]

    def listed(
        self, count: int, is_so: Callable[[dict[str, Any]], object] = bool
    ) -> list[dict[str, Any]]:
        """The cards, when so many are connected and are so.

        A card comes each second, and at first without what its aircraft has not said yet.
        """
        ends = time.monotonic() + 2 * PATIENCE
        found: list[dict[str, Any]] = []
        while time.monotonic() < ends:
            _, found = self.ask("list")
            there = [one for one in found if one.get("connection") == "connected"]
            if sum(bool(is_so(one)) for one in there) == count:
                break
        return found


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        place = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    with ExitStack() as stack:
        one = Site(stack, place, tmp_path)
        router = one.start("router", "--listen", place, "--json")
        assert router.stdout is not None
        assert json.loads(router.stdout.readline()) == {"listen": [place]}
        yield one


@pytest.mark.pty
@pytest.mark.smoke
def test_all_take_off_and_land_and_one_that_is_not_there_is_named(site: Site) -> None:
    agent = site.start("agent", "sim://", "--name", "a", "--count", "2", "--json")
    assert agent.stdout is not None
    assert json.loads(agent.stdout.readline()) == {"fleet": "site", "agents": ["a1", "a2"]}
    assert [card["name"] for card in site.listed(2)] == ["a1", "a2"]
    status, told = site.ask("takeoff", "--all")
    assert (status, [one["outcome"] for one in told]) == (0, ["ok", "ok"])
    in_air = site.listed(2, lambda card: card.get("phase") == "in air")
    assert [card["phase"] for card in in_air] == ["in air", "in air"]
    status, told = site.ask("stop", "a1", "nobody")
    assert status == 1
    outcomes = {one["name"]: one["outcome"] for one in told}
    assert outcomes == {"a1": "ok", "nobody": "unreachable"}
    status, told = site.ask("land", "--all")
    assert (status, [one["outcome"] for one in told]) == (0, ["ok", "ok"])
    agent.send_signal(signal.SIGTERM)
    assert agent.wait(PATIENCE) == 0
    assert site.ask("list") == (0, [])


@pytest.mark.pty
def test_a_wall_one_in_full_and_a_lease_that_is_held(site: Site) -> None:
    site.start("agent", "sim://", "--name", "a", "--count", "2")
    site.listed(2)
    status, told = site.ask("monitor", "--duration", "4")
    assert status == 0
    assert {one["name"] for one in told} == {"a1", "a2"}
    last = told[-1]
    assert last["age"] < 1.0
    assert last["battery"] == {"percent": 100}
    assert 5 <= last["received"] <= 60
    status, packages = site.ask("watch", "a2", "--duration", "3")
    assert status == 0
    assert len(packages) > 100
    assert sum(BY_RECORD[Attitude].name in one for one in packages) > 100
    watched = site.start("watch", "a2")  # as by `| head -1`
    assert watched.stdout is not None
    assert json.loads(watched.stdout.readline())["received_at"] > 0
    watched.stdout.close()
    assert watched.wait(PATIENCE) == 0
    holder = site.start("lease", "a1", "--json")
    assert holder.stdout is not None
    fence = json.loads(holder.stdout.readline())["fence"]
    status, [refused] = site.ask("takeoff", "a1")
    assert (status, refused["outcome"], refused["code"]) == (1, "refused", "M100-LEASE-HELD")
    second = site.start("lease", "a1", "--take-over", "--json")
    assert second.stdout is not None
    assert json.loads(second.stdout.readline())["fence"] > fence
    assert holder.wait(PATIENCE) == 1
    second.send_signal(signal.SIGINT)
    assert second.wait(PATIENCE) == 0


@pytest.mark.pty
def test_a_name_that_is_taken_ends_the_second_agent(site: Site) -> None:
    site.start("agent", "sim://", "--name", "a1")
    site.listed(1)
    second = site.start("agent", "sim://", "--name", "a1")
    assert second.wait(PATIENCE) == 2


@pytest.mark.pty
def test_without_a_router_it_is_said_what_to_do(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "m100link", "fleet", "list", "--connect", "tcp/127.0.0.1:9"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 9
    assert "no router answered" in done.stderr
    assert "m100link fleet router --listen tcp/127.0.0.1:9," in done.stderr


@pytest.mark.pty
def test_a_command_without_names_asks_for_them(site: Site) -> None:
    assert site.ask("takeoff")[0] == 2
    assert site.ask("land", "a1", "--all")[0] == 2


def test_an_empty_identity_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """As of an unset variable of the environment."""
    given: dict[str, Any] = {}
    monkeypatch.setattr(fleet_commands, "connect", lambda *_, **how: given.update(how))
    FleetOptions(identity="").open()
    assert given.keys() == {"site", "name", "patience"}, "nothing that signs or verifies"


def test_results_are_reported_with_reason_and_remedy(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    results = {
        "a1": Result.of("a1", None),
        "a2": Result.of("a2", StaleLease("lease 3 is not in force", remedy="take it")),
    }
    monkeypatch.setattr(OutputFormat, "json", False)
    assert tell_results(results, NO_OPTIONS) == 1
    told = capsys.readouterr()
    assert "ok" in told.out
    assert "lease 3 is not in force" in told.out
    assert "take it" in told.err
    assert told.err.splitlines()[-1] == "1 ok, 1 not"
    assert tell_results({"a1": results["a1"]}, NO_OPTIONS) == 0


@pytest.mark.pty
def test_the_console_of_a_fleet_shows_who_is_there(site: Site) -> None:
    agents = site.start("agent", "sim://", "--name", "a", "--count", "2", "--json")
    assert agents.stdout is not None
    json.loads(agents.stdout.readline())
    site.listed(2)
    words = ("--no-open-browser", "--console-port", "0", "--json")
    console = site.start("console", *words)
    assert console.stdout is not None
    told = json.loads(console.stdout.readline())
    assert told["aircraft"] == ["a1", "a2"]
    with urllib.request.urlopen(told["console"], timeout=PATIENCE) as page:
        assert "m100link" in page.read().decode()
    console.send_signal(signal.SIGINT)
    assert console.wait(PATIENCE) == 0
    code, _ = site.ask("console", "a1", "b7", "--no-open-browser")
    assert code == 1


@pytest.mark.pty
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("is_mute", [False, True], ids=["no router", "a router that says nothing"])
def test_a_command_that_waits_for_a_router_ends_by_its_signal(
    tmp_path: Path, number: int, is_mute: bool
) -> None:
    """Only the one that had come to the router looked whether it has to end."""
    with ExitStack() as stack, socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        if is_mute:
            listener.listen()
        one = Site(stack, f"tcp/127.0.0.1:{listener.getsockname()[1]}", tmp_path)
        command = [sys.executable, "-m", "m100link", "fleet", "agent", "sim://"]
        process = subprocess.Popen(
            command,
            stderr=subprocess.PIPE,
            text=True,
            env=one.environment | {"M100LINK_LOG": "info"},
        )
        stack.callback(one._end, process)
        assert process.stderr is not None
        stack.callback(process.stderr.close)
        if is_mute:
            listener.settimeout(PATIENCE)
            stack.enter_context(listener.accept()[0])
        else:
            said = process.stderr.readline()
            assert "no router answers yet" in said
            assert "fleet router --listen" in said
        process.send_signal(number)
        assert process.wait(PATIENCE) == 0


@pytest.mark.pty
def test_an_agent_of_an_older_release_is_listed_as_that(site: Site) -> None:
    """It shows another token, and answers where it stands in words that are not read any more."""
    zenoh = pytest.importorskip("zenoh")
    config = zenoh.Config()
    for name, value in (("mode", "client"), ("connect/endpoints", [site.place])):
        config.insert_json5(name, json.dumps(value))
    key = "m100/site/old/state"
    with (
        zenoh.open(config) as session,
        session.declare_queryable(key, lambda asked: asked.reply(key, b'\x01{"name": "old"}')),
    ):
        status, told = site.ask("list")
        ends = time.monotonic() + PATIENCE
        while not told and time.monotonic() < ends:
            status, told = site.ask("list")
    assert (status, [one["name"] for one in told]) == (0, ["old"])
    assert told[0]["connection"] == "unreadable"
    assert "version 1" in told[0]["fault"]["seen"]


# -- ctrl-C at the verbs of a fleet that move an aircraft; and how many of twenty take off ---------


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


@pytest.mark.pty
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
    """What Ctrl-C prints."""
    screen.type(CTRL_C)
    assert screen.end() == _INTERRUPTED, screen.shown
    return " ".join(screen.shown.split())


@pytest.mark.pty
@pytest.mark.anyio
async def test_what_goes_on_on_board_is_reported_and_ends_as_ordered(site: Site) -> None:
    site.start("agent", "sim://", "--name", "a1")
    async with connect(site.place, name="watcher") as watcher:
        await until(watcher, lambda card: card.connection == "connected")
        with terminal("fleet", "takeoff", "--all", environment=site.environment) as screen:
            await until(watcher, lambda card: (card.height_m or 0.0) > 0.2)
            told = await anyio.to_thread.run_sync(ended, screen)
        assert "a1 unknown interrupted: control goes back" in told
        assert "an aircraft in the air hovers" in told
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
        assert "a1 unknown interrupted: a landing goes on if the order arrived" in told
        assert "after m100link fleet stop a1 the aircraft hovers" in told
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


@pytest.mark.pty
@pytest.mark.anyio
async def test_a_stop_that_nobody_answers_is_reported_as_unknown(site: Site) -> None:
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
    assert "a1 unknown interrupted: it stops if the order arrived" in told
    assert "m100link fleet stop a1 again" in told


def simulated(site: Site, path: Path, order: str) -> str:
    """Where an aircraft is to which that was done."""
    path.write_text(f'[[step]]\nat = 0.0\ndo = "{order}"\n')
    words = ("--tcp", "127.0.0.1:0", "--scenario", str(path), "--json")
    simulator = site.start(*words, verb="sim")
    assert simulator.stdout is not None
    return str(json.loads(simulator.stdout.readline())["port"])


@pytest.mark.pty
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
