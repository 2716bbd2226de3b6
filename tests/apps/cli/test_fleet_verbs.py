"""What the list of the fleet's verbs says."""

from __future__ import annotations

import asyncio
import json
import random
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from inspect import signature
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("cyclopts")
pytest.importorskip("zenoh")

from m100link.apps.agent.messages import RemoteError
from m100link.apps.agent.orders import Right
from m100link.apps.cli import common, fleet_verbs
from m100link.apps.cli import fleet as fleet_commands
from m100link.apps.cli.fleet import lease_file
from m100link.apps.cli.fleet_verbs import _link, app
from m100link.apps.cli.terminal import ExitCode
from m100link.apps.fleet import pki
from m100link.apps.fleet.client import Fleet
from m100link.apps.fleet.payloads import Card, Result
from m100link.apps.fleet.revocations import LIST, Revocations
from m100link.sim.clock import VirtualClockEventLoop
from tests.apps.bus.memory import MemoryNetwork
from tests.apps.cli.conftest import CommandLine
from tests.apps.cli.test_app import verbs
from tests.apps.fleet.show.shows import five
from tests.apps.fleet.test_signing import note
from tests.flight.missions.foreign import plan as short_plan


def test_every_verb_says_what_it_does_where_all_are_listed() -> None:
    verbs = {name: app[name] for name in app if not name.startswith("-")}
    assert len(verbs) > 10
    assert {name for name, verb in verbs.items() if not verb.help} == set()


@pytest.mark.parametrize(
    ("ahead", "said"),
    [
        (0.0, "connected"),
        (4.0, "connected"),
        (3600.0, "connected; clock 3600 s ahead of this one"),
        (-3600.0, "connected; clock 3600 s behind this one"),
    ],
)
def test_the_list_names_a_clock_by_which_a_signed_order_would_be_refused(
    ahead: float, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("time.time", lambda: 1.8e9)
    assert _link(Card("a1", "boot", 1.8e9 + ahead, "connected")) == said


@pytest.mark.parametrize("connection", ["connected", "lost"])
def test_the_list_says_what_would_refuse_the_first_order(connection: str) -> None:
    card = Card("a1", "boot", time.time(), connection, fault=RemoteError("M100-X", "no key"))
    assert _link(card) == f"{connection}: no key"


def test_brackets_in_the_words_of_a_stranger_are_shown(capsys: pytest.CaptureFixture[str]) -> None:
    """As a style they would hide a part of a name, or end the list with a traceback."""
    fault = RemoteError("M100-X", "no [/] key")
    cards = {"a1": Card("a1", "b", time.time(), "connected", holder="[red]anna", fault=fault)}
    common.out.print(fleet_verbs._table(["a1"], cards))
    shown = capsys.readouterr().out
    assert ("[/] key" in shown, "[red]anna" in shown) == (True, True), shown


# -- a right that the fleet file here does not give -----------------------------------------------

FILE = """
[router.base]
hosts = ["127.0.0.1"]
[aircraft.a1]
[identity.none]
[identity.wall]
watch = ["a1"]
[identity.bert]
stop = ["a1"]
[identity.anna]
fly = ["a1"]
[identity.root]
fly = ["*"]
"""
WHO: dict[str, int] = {"eve": 0, "none": 0, "wall": 1, "bert": 2, "anna": 3, "root": 3}
"""By name: its highest right; eve has a certificate, and the file does not name her."""

NEEDED: dict[str, tuple[Right, bool, str]] = {
    "takeoff": (Right.FLY, False, "NAME"),
    "goto": (Right.FLY, False, "NAME 52 4 5"),
    "lease": (Right.FLY, False, "NAME"),
    "land": (Right.STOP, True, "NAME"),
    "stop": (Right.STOP, True, "NAME"),
    "watch": (Right.WATCH, False, "NAME --duration 0.1"),
    "console": (Right.WATCH, False, "NAME --console-port 0"),
    "mission fly": (Right.FLY, False, "NAME PLAN --yes"),
    "mission pause": (Right.FLY, True, "NAME"),
    "mission resume": (Right.FLY, False, "NAME"),
    "mission stop": (Right.STOP, True, "NAME"),
    "mission progress": (Right.WATCH, False, "NAME"),
    "log list": (Right.WATCH, False, "NAME"),
    "log fetch": (Right.WATCH, False, "NAME"),
    "log audit": (Right.WATCH, False, "NAME"),
    "pki push": (Right.STOP, True, "NAME"),
    "show fly": (Right.FLY, False, "SHOW --yes"),
}
"""By verb: its right to an aircraft, whether it ends a flight, and its words."""
OF_ALL = {"list", "monitor"}


def test_each_verb_that_asks_a_fleet_has_a_right() -> None:
    asking = {
        words
        for words, verb in verbs(app)
        if "options" in signature(verb.default_command).parameters  # type: ignore[arg-type] # it has one
    }
    assert asking - {"agent"} == {*NEEDED, *OF_ALL}


@pytest.fixture(scope="module")
def secured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fleet file with the keys of all of them, a plan and shows."""
    folder = tmp_path_factory.mktemp("fleet")
    pki.init(folder / "pki", now=datetime.now(UTC))
    for name in WHO:
        pki.issue(folder / "pki", pki.Kind.PILOT, name, now=datetime.now(UTC))
    (folder / "fleet.toml").write_text(FILE)
    (folder / "pki" / LIST).write_bytes(b"")
    (folder / "plan.json").write_text(short_plan().to_json())
    show = five()
    for name in ("a1", "z9"):
        one = show | {"aircraft": [show["aircraft"][0] | {"name": name}]}
        (folder / f"{name}.json").write_text(json.dumps(one))
    return folder


class Called:
    """A command line whose fleet has nobody in it, and what it asked for."""

    def __init__(self, cli: CommandLine, folder: Path, patch: pytest.MonkeyPatch) -> None:
        self.cli, self.folder, self.asked = cli, folder, list[str]()
        patch.setattr(fleet_commands, "connect", self.connect)
        patch.setattr(asyncio.events, "new_event_loop", VirtualClockEventLoop)
        patch.setenv("XDG_RUNTIME_DIR", str(folder))
        for name in ("a1", "z9"):
            held = lease_file("site", name)
            held.parent.mkdir(parents=True, exist_ok=True)
            held.write_text(json.dumps({"fence": 1, "token": "secret"}))

    @asynccontextmanager
    async def connect(self, *_: str, **how: Any) -> AsyncIterator[Fleet]:
        bus = MemoryNetwork(seed=5).session()
        kept = {name: how[name] for name in ("site", "name", "sign")}
        async with Fleet(bus, **kept, patience=1.0) as fleet:
            note(bus, self.asked)
            yield fleet

    def __call__(self, verb: str, who: str, name: str) -> tuple[int, str]:
        self.asked.clear()
        words = NEEDED[verb][2] if verb in NEEDED else ""
        files = {"NAME": name, "PLAN": f"{self.folder}/plan.json"}
        files["SHOW"] = f"{self.folder}/{name}.json"
        given = [files.get(word, word) for word in words.split()]
        place = ("--connect", f"{self.folder}/fleet.toml", "--identity", who)
        found = self.cli("fleet", *verb.split(), *given, *place)
        return found.status, found.out + found.err


@pytest.fixture
def called(cli: CommandLine, secured: Path, monkeypatch: pytest.MonkeyPatch) -> Called:
    return Called(cli, secured, monkeypatch)


def names_a_missing_right(called: Called, verb: str, who: str, name: str) -> None:
    """Before it asks anybody; what ends a flight goes out with a warning."""
    case = f"{verb} {name} by {who}"
    needed, ends, _ = NEEDED[verb]
    status, said = called(verb, who, name)
    is_allowed = WHO[who] >= needed.value and (name == "a1" or who == "root")
    why = f"{who} may not {needed.name.lower()} {name}"
    assert (why in said) is not is_allowed, (case, said)
    if is_allowed or ends:
        assert called.asked, case
        assert "nothing was sent" not in said or "is there at site" in said, (case, said)
        return
    assert called.asked == [], case
    assert status == ExitCode.FAILED, (case, said)
    assert f"{why}; nothing was sent" in said, (case, said)


def test_a_verb_names_a_missing_right_before_it_asks_anybody(called: Called) -> None:
    """Four that are drawn of the table; the case is in what it asserts."""
    for case in random.sample([*product(NEEDED, WHO, ("a1", "z9"))], 4):
        names_a_missing_right(called, *case)


@pytest.mark.slow
@pytest.mark.parametrize("verb", NEEDED)
def test_each_verb_names_each_missing_right(called: Called, verb: str) -> None:
    for who, name in product(WHO, ("a1", "z9")):
        names_a_missing_right(called, verb, who, name)


@pytest.mark.parametrize("verb", ["list", "stop --all"])
def test_what_asks_all_names_whom_it_leaves_out(called: Called, verb: str) -> None:
    assert "left out: a1: none may not watch a1" in called(verb, "none", "")[1]
    assert "left out" not in called(verb, "wall", "")[1]


# -- who ordered what, and when -------------------------------------------------------------------


def test_an_audit_log_is_told_with_the_times_of_order_and_outcome(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """UTC; a line of an older agent has no time of the order."""
    landed = {"number": 2, "at": 1_800_000_020.0, "order": "land", "signer": "anna", "by": "Anna"}
    landed |= {"outcome": "ok", "ordered_at": 1_800_000_000.25}
    older = landed | {"number": 1, "at": 1_799_999_990.0, "signer": "", "outcome": "refused"}
    older |= {"why": "it was late"}
    del older["ordered_at"]
    merged = Result.of("a1", None, ([{"number": 0, "at": 1.0}, landed, older], []))

    async def results_of(*_: object) -> dict[str, Result]:
        return {"a1": merged}

    monkeypatch.setattr(fleet_verbs, "results_of", results_of)
    monkeypatch.setattr(Revocations, "of_folder", lambda _: SimpleNamespace(authority=0))
    outcome = cli("fleet", "log", "audit", "a1", "--table", "--output", "there")
    assert [line.split() for line in outcome.out.splitlines()] == [
        ["a1", "Anna", "land", "2027-01-15", "07:59:50", "refused", "it", "was", "late"],
        ["2027-01-15", "08:00:00", "a1", "anna", "land", "2027-01-15", "08:00:20", "ok"],
    ]
    assert outcome.status == ExitCode.OK
    assert cli("fleet", "log", "audit", "a1", "--table").out == outcome.out
