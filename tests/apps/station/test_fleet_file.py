"""A fleet of one file, and a doctor that names each fault that is planted in it, and no other."""

from __future__ import annotations

import asyncio
import shutil
import socket
from collections import namedtuple
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("zenoh", reason="the extra fleet is not installed")

import m100link
from m100link.apps.agent.messages import RemoteError
from m100link.apps.agent.orders import AskTakeOver
from m100link.apps.cli.fleet_setup import _settings_of
from m100link.apps.fleet import pki
from m100link.apps.fleet.agent import FleetAgent
from m100link.apps.fleet.client import open_fleet
from m100link.apps.fleet.identity import Reason, Rights
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.payloads import Card
from m100link.apps.fleet.signing import tls_options
from m100link.apps.station import fleet
from m100link.apps.station import fleet_file as module
from m100link.apps.station.fleet_file import (
    FleetFault,
    agent_of,
    examine,
    routing,
)
from m100link.errors import CommandRefused, NotAllowed, OutcomeUnknown, UsageError
from m100link.sim.clock import virtual_clock_loop
from tests.apps.fleet.test_pki import free_port

FLEET = """
[router.base]
hosts = ["127.0.0.1"]
port = {}
[router.mast]
hosts = ["127.0.0.1"]
port = {}
[aircraft.a1]
[aircraft.a2]
[identity.anna]
fly = ["*"]
[identity.bert]
stop = ["*"]
[identity.wall]
watch = ["a1"]
"""
_Usage = namedtuple("_Usage", "total used free")


class Planted:
    """A fleet with two routers and two virtual aircraft in this process, and a fault in it."""

    def __init__(self, folder: Path, patch: pytest.MonkeyPatch) -> None:
        self.patch = patch
        self.path = folder / "fleet.toml"
        self.path.write_text(FLEET.format(free_port(), free_port()))
        pki.make(self.rights, now=datetime.now(UTC))
        self.routers = {"base": self.rights, "mast": self.rights}
        self.agents = {"a1": self.rights, "a2": self.rights}
        self.after: list[Callable[[AsyncExitStack], Any]] = []

    @property
    def rights(self) -> Rights:
        return Rights.read(self.path)

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        async with AsyncExitStack() as stack:
            for name, rights in self.routers.items():
                await stack.enter_async_context(routing(rights, name))
            for name, rights in self.agents.items():
                settings = replace(_settings_of(rights, name, is_real=False), no_record=False)
                settings = replace(settings, record=self.path.parent / "flights" / name)
                own = agent_of(rights, name, is_real=False)
                serving = fleet.serving_fleet({name: settings}, own, lambda *_: None)
                await stack.enter_async_context(serving)
            for plant in self.after:
                made = plant(stack)
                if made is not None:
                    await made
            yield

    def card(self, name: str, **changes: Any) -> None:
        """Let the agent of one aircraft say something else of itself."""
        true = FleetAgent.card

        def card(agent: FleetAgent) -> Any:
            found = true(agent)
            of = {key: one(found) for key, one in changes.items()}
            return replace(found, **of) if found.name == name else found

        self.patch.setattr(FleetAgent, "card", card)

    def disk(self, megabytes: float) -> None:
        def usage(path: Path) -> _Usage:
            left = megabytes if path.name in ("flights", "a2") else 1e6
            return _Usage(10**12, 0, int(left * 1e6))

        (self.path.parent / "flights" / "a2").mkdir(parents=True)
        self.patch.setattr(shutil, "disk_usage", usage)

    def text(self, before: str, after: str) -> Rights:
        """The fleet file with another text in it, beside the same keys."""
        path = self.path.with_name("other.toml")
        path.write_text(self.path.read_text().replace(before, after))
        return Rights.read(path)


def clock(one: Planted) -> None:
    one.card("a2", at=lambda card: card.at + 3600.0)


def version(one: Planted) -> None:
    one.card("a1", version=lambda _: "0.1.0")


def expired(one: Planted) -> None:
    now = datetime.now(UTC) - timedelta(days=31)
    pki.issue(one.rights.pki, pki.Kind.PILOT, "bert", now=now, force=True)


def right(one: Planted) -> None:
    one.agents["a2"] = one.text('fly = ["*"]', 'fly = ["a1"]\nstop = ["*"]')


def revoked(one: Planted) -> None:
    one.after.append(lambda _: pki.revoke(one.rights.pki, ["bert"], now=datetime.now(UTC)) and None)


def leg(one: Planted) -> None:
    del one.agents["a2"]


def router(one: Planted) -> None:
    del one.routers["mast"]


def unlinked(one: Planted) -> None:
    alone = {
        name: replace(one.rights, routers={name: one.rights.routers[name]}) for name in one.routers
    }
    one.routers = alone
    one.agents = {"a1": alone["base"], "a2": alone["mast"]}


def full(one: Planted) -> None:
    one.disk(0.2)


def scarce(one: Planted) -> None:
    one.disk(20.0)


def key(one: Planted) -> None:
    place = one.rights.pki / "anna.signing.key"

    def change(_: AsyncExitStack) -> None:
        place.write_text("0a" * 32)

    one.after.append(change)


def board_key(one: Planted) -> None:
    """The board has an older public key of her."""
    one.agents["a1"] = one.text("[identity.anna]", f'[identity.anna]\npublic_key = "{"0a" * 32}"')


def duplicate(one: Planted) -> None:
    async def plant(stack: AsyncExitStack) -> None:
        options = tls_options(one.rights.pki, "a1")
        bus = await stack.enter_async_context(
            open_fleet("client", connect=one.rights.endpoints, options=options)
        )
        stack.callback(bus.declare(Keys(name="a1").live_by(bus.session)).close)

    one.after.append(plant)


def port(one: Planted) -> None:
    del one.routers["mast"]

    def take(stack: AsyncExitStack) -> None:
        taken = stack.enter_context(socket.socket())
        taken.bind(("127.0.0.1", one.rights.routers["mast"].port))
        taken.listen(64)

    one.after.append(take)


def foreign(one: Planted) -> None:
    """The router has certificates of another authority, as from another `fleet make`."""
    other = one.rights.path.parent / "other" / "fleet.toml"
    other.parent.mkdir()
    other.write_text(one.path.read_text())
    pki.make(Rights.read(other), now=datetime.now(UTC))
    one.routers["mast"] = Rights.read(other)


TABLE: list[tuple[Callable[[Planted], object], str, str, str, str]] = [
    (clock, "wrong clock", "a2", "the clock of a2 is 3600 s ahead of this one", "chrony"),
    (expired, "expired certificate", "bert", "of bert expired on", "m100link fleet make"),
    (right, "missing right", "anna", "a2: anna may not fly a2", "[identity.anna] fly"),
    (revoked, "revoked name", "bert", "bert is revoked since", "another name"),
    (leg, "cut leg", "a2", "no agent named a2 is there", "m100link fleet up fleet.toml a2"),
    (router, "cut leg", "mast", "no router answered", "fleet.toml mast; then look at the"),
    (unlinked, "two routers not linked", "base", "base does not show a2", "same fleet file"),
    (full, "full disk", "a2", "a2: full disk: 0 MB are left for", "remove old flight logs"),
    (scarce, "no log space", "a2", "a2: no log space: 20 MB are left for", "another disk"),
    (key, "wrong key", "anna", "signing key of anna does not fit", "m100link fleet make"),
    (board_key, "wrong key", "anna", "a1: the signature of anna does not fit", "public_key"),
    (version, "wrong version", "a1", "a1 has release 0.1.0, and this is", "same release"),
    (duplicate, "duplicate name", "a1", "2 agents are named a1", "end all of them but one"),
    (foreign, "wrong key", "mast", "of mast is not of this fleet", "copy boards/mast there anew"),
    (port, "port busy", "mast", "answers, and is no router of this fleet", "another port"),
]
BESIDE = {
    "unlinked": {("two routers not linked", "mast")},
    "right": {("missing right", "a2")},
    "board_key": {("missing right", "a1")},
}
"""The other router, and the board whose fleet file is another one."""


def findings(
    folder: Path, patch: pytest.MonkeyPatch, *plant: Callable[[Planted], object]
) -> list[FleetFault]:
    async def run() -> list[FleetFault]:
        one = Planted(folder, patch)
        for do in plant:
            do(one)
        async with one.running():
            await asyncio.sleep(1.5)  # each tells of itself once a second
            return await examine(one.rights)

    patch.setattr("m100link.apps.station.fleet_file._START_S", 0.0)

    return asyncio.run(run())


@pytest.mark.pty
def test_a_fleet_that_is_still_being_started_has_no_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, told = Planted(tmp_path, monkeypatch), list[str]()

    async def run() -> list[FleetFault]:
        examining = asyncio.create_task(examine(one.rights, told.append))
        await asyncio.sleep(0.5)
        async with one.running():
            return await examining

    assert asyncio.run(run()) == []
    assert len(told) == len(set(told)) == 6, "each of three operators by each of two routers"


@pytest.mark.pty
def test_a_healthy_fleet_has_no_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert findings(tmp_path, monkeypatch) == []


@pytest.mark.pty
@pytest.mark.parametrize("row", TABLE, ids=lambda row: row[0].__name__)
def test_each_planted_fault_is_named_with_its_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, row: tuple[Any, str, str, str, str]
) -> None:
    plant, fault, name, seen, remedy = row
    found = findings(tmp_path, monkeypatch, plant)
    named = [one for one in found if (one.fault, one.name) == (fault, name)]
    assert named, found
    assert any(seen in one.seen and remedy in one.remedy for one in named), named
    assert {(one.fault, one.name) for one in found} <= {(fault, name)} | BESIDE.get(
        plant.__name__, set()
    )


# -- each fault by itself: no router runs, and nothing is signed -----------------------------------


def the_rights(patch: pytest.MonkeyPatch, folder: Path) -> Rights:
    """Those of the file above, with the console of bert; all keys are beside it."""
    text = FLEET.format(7447, 7448) + '[console]\nidentity = "bert"\nconsole_port = 8017\n'
    text = text.replace("[aircraft.a1]", '[aircraft.a1]\nlost = "land"\nlost_after = 2.5')
    rights = replace(Rights.parse(text), path=folder / "fleet.toml")
    rights.pki.mkdir()
    for name in rights.identities:
        (rights.pki / f"{name}.signing.key").write_text("")
    patch.setattr(module, "read_signer", lambda _, name: signer_of(rights, name))
    patch.setattr(module, "listed", lambda _: [])
    patch.setattr(module, "tls_options", lambda *what, **more: {"tls": str((what[1], more))})

    def known(_: Path, who: str, rights: Rights) -> dict[str, Any]:
        return {"tls": str((who, {})), "sign": signer_of(rights, who)}

    patch.setattr(module, "credentials", known)
    lists = SimpleNamespace(of_folder=lambda *_: SimpleNamespace(number=5, since="since"))
    patch.setattr(module, "Revocations", lists)
    return rights


def signer_of(rights: Rights, name: str) -> Any:
    return SimpleNamespace(name=name, public_key=rights.identities[name].public_key)


def on_virtual_time(work: Any) -> Any:
    with asyncio.Runner(loop_factory=virtual_clock_loop) as runner:
        return runner.run(work)


def kinds(found: Any) -> list[tuple[str, str]]:
    return [(one.fault, one.name) for one in found]


HERE = m100link.__version__
NO_PORT = RemoteError("PortNotFound", "no port", remedy="plug it in")
NO_DISK = RemoteError("OutOfResources", "full disk: 0 MB are left", remedy="remove")
CARDS: list[tuple[Card | None, list[tuple[str, str]]]] = [
    (Card("a1", "run", 1000.0, version=HERE), []),
    (None, [("wrong key", "gives no answer that its certificate has signed")]),
    (Card("a1", "", 0.0), [("wrong version", "has release unknown, and this is")]),
    (Card("a1", "", 9e9, version="0.1"), [("wrong version", "has release 0.1, and this is")]),
    (
        Card("a1", "run", 1061.0, version="0.1"),
        [("wrong version", "has release 0.1"), ("wrong clock", "61 s ahead of this one")],
    ),
    (Card("a1", "run", 939.0, version=HERE), [("wrong clock", "61 s behind this one")]),
    (
        Card(
            "a1",
            "run",
            1000.0,
            version=HERE,
            fault=RemoteError("PortNotFound", "no port", remedy="plug it in"),
        ),
        [("no aircraft", "a1: no port")],
    ),
    (
        Card("a1", "run", 1000.0, version=HERE, fault=NO_DISK),
        [("full disk", "a1: full disk: 0 MB")],
    ),
]


@pytest.mark.parametrize(("card", "faults"), CARDS)
def test_a_card_tells_its_faults(
    card: Card | None, faults: list[tuple[str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module.time, "time", lambda: 1000.0)  # type: ignore[attr-defined]
    found = list(module._of_card("a1", card))
    assert kinds(found) == [(fault, "a1") for fault, _ in faults]
    for one, (_, seen) in zip(found, faults, strict=True):
        assert seen in one.seen
        assert one.remedy


def test_certificates_and_keys_tell_their_faults(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The doctor reports no strangers beside the file; keys may be on other machines."""
    rights = the_rights(monkeypatch, tmp_path)
    now = datetime.now(UTC)
    late, soon = now - timedelta(seconds=1), now + timedelta(days=1)
    rows = [
        *(("base", soon, ""), ("a1", late, ""), ("bert", late, "2026-01-02"), ("eve", late, "")),
        *(("mallory", soon, "2026-01-02"), ("mast", soon, "2026-01-02")),
    ]
    monkeypatch.setattr(module, "listed", lambda _: rows)

    def read(_: Path, name: str) -> Any:
        if name == "wall":
            raise UsageError("no key here")
        key = b"another" if name == "anna" else rights.identities[name].public_key
        return SimpleNamespace(public_key=key)

    monkeypatch.setattr(module, "read_signer", read)
    found = module._of_files(rights)
    assert kinds(found) == [
        *(("expired certificate", "a1"), ("revoked name", "bert"), ("revoked name", "mast")),
        ("wrong key", "anna"),
    ]
    assert "boards/a1" in found[0].remedy
    assert f"expired on {late:%Y-%m-%d}" in found[0].seen
    assert "boards/anna" in found[3].remedy


ALL = ["AskVersion", "AskTakeOver", "in_force"]


@pytest.mark.parametrize(
    ("who", "met", "reply", "asked", "faults"),
    [
        ("anna", {}, (5, ""), ALL, []),
        ("anna", {"AskTakeOver": CommandRefused("it flies")}, (5, ""), ALL, []),
        ("bert", {}, (5, ""), ["AskVersion", "in_force"], []),
        ("wall", {}, (5, ""), [], []),
        ("anna", {"AskVersion": NotAllowed("no")}, (5, ""), [ALL[0], ALL[2]], ["missing right"]),
        ("anna", {"AskTakeOver": OutcomeUnknown("no")}, (5, ""), ALL, ["missing right"]),
        ("anna", {"in_force": OutcomeUnknown("no")}, (5, ""), ALL, ["missing right"]),
        ("anna", {}, (4, ""), ALL, ["revoked name"]),
        ("anna", {}, (6, ""), ALL, []),
        ("anna", {}, (5, "same"), ALL, []),
        ("anna", {}, (5, "other"), ALL, ["missing right"]),
        ("anna", {}, (4, "other"), ALL, ["revoked name"]),
    ],
)
def test_each_right_of_the_file_is_proved_and_no_other(
    who: str,
    met: dict[str, Exception],
    reply: tuple[int, str],
    asked: list[str],
    faults: list[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    rights, steps = the_rights(monkeypatch, tmp_path), list[str]()

    async def step(name: str) -> Any:
        steps.append(name)
        if name in met:
            raise met[name]
        number, text = reply
        return SimpleNamespace(number=number, text=rights.digest if text == "same" else text)

    async def ask(order: Any) -> Any:
        assert not isinstance(order, AskTakeOver) or order == AskTakeOver(who)
        return await step(type(order).__name__)

    async def in_force(bus: object, keys: object) -> Any:
        assert (bus, keys) == ("bus", "keys of a1")
        return await step("in_force")

    monkeypatch.setattr(module, "in_force", in_force)
    asker = SimpleNamespace(ask=ask, keys="keys of a1")
    here: Any = SimpleNamespace(bus="bus", asker=lambda name: asker)
    found = on_virtual_time(module._of_rights(rights, who, here, "a1"))
    assert steps == asked
    assert [one.fault for one in found] == faults


@pytest.mark.parametrize(
    ("reason", "fault"),
    [
        (Reason.UNKNOWN_KEY, "wrong key"),
        (Reason.BAD_SIGNATURE, "wrong key"),
        (Reason.REVOKED, "revoked name"),
        (Reason.EXPIRED, "wrong clock"),
        (Reason.NOT_ALLOWED, "missing right"),
        (None, "missing right"),
    ],
)
def test_a_refusal_is_named_by_its_reason(
    reason: Reason | None, fault: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    rights, error = the_rights(monkeypatch, tmp_path), NotAllowed("no", remedy="mend it")
    if reason is not None:
        error.reason = reason  # type: ignore[attr-defined]

    async def refuse(*_: object) -> Any:
        raise error

    monkeypatch.setattr(module, "in_force", refuse)
    asker = SimpleNamespace(ask=refuse, keys="")
    here: Any = SimpleNamespace(bus="bus", asker=lambda _: asker)
    found = on_virtual_time(module._of_rights(rights, "bert", here, "a2"))
    assert set(found) == {FleetFault(fault, "bert", "a2: no", "mend it")}


class Seen(SimpleNamespace):
    """A fleet behind a router: names that are there, and tokens of each."""

    async def names(self) -> list[str]:
        return list(self.there)

    async def cards(self) -> dict[str, Card]:
        return {name: Card(name, "run", 0.0, version=HERE) for name in self.there}

    @property
    def bus(self) -> Any:
        async def tokens(key: str, *, timeout: float) -> list[str]:
            return ["one"] * next(n for name, n in self.there.items() if f"/{name}/" in key)

        return SimpleNamespace(tokens=tokens)


@pytest.mark.parametrize(
    ("there", "faults", "proved"),
    [
        ([{"a1": 1, "a2": 1}] * 2, [], 10),
        # The doctor reports a double name once, however many operators see it.
        ([{"a1": 1, "a2": 2}] * 2, [("duplicate name", "a2")], 10),
        ([{"a1": 1}] * 2, [("cut leg", "a2")], 6),
        ([{"a1": 1}, {"a1": 1, "a2": 1}], [("two routers not linked", "base")], 8),
        ([None, {"a1": 1, "a2": 1}], [("no router", "base")], 5),
        ([None, None], [("no router", "base"), ("no router", "mast")], 0),
    ],
)
def test_what_each_operator_sees_by_each_router_is_put_together(
    there: list[dict[str, int] | None],
    faults: list[tuple[str, str]],
    proved: int,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    rights, asked, told = the_rights(monkeypatch, tmp_path), list[str](), list[str]()
    monkeypatch.setattr(module, "_of_card", lambda *_: iter(()))

    @asynccontextmanager
    async def connect(endpoint: str, **how: Any) -> AsyncIterator[Any]:
        seen = there[rights.endpoints.index(endpoint)]
        assert (how["site"], how["patience"], how["sign"].name) == ("site", 3.0, how["name"])
        if seen is None:
            raise UsageError("no router answered")
        yield Seen(there=seen)

    async def of_rights(_: Rights, who: str, __: object, name: str) -> list[FleetFault]:
        asked.append(f"{who} {name}")
        return []

    def no_router(_: Rights, router: Any, error: Exception) -> FleetFault:
        return FleetFault("no router", router.name, str(error), "")

    for name, fake in (("connect", connect), ("_of_rights", of_rights), ("_no_router", no_router)):
        monkeypatch.setattr(module, name, fake)
    monkeypatch.setattr("asyncio.to_thread", at_once)
    assert kinds(on_virtual_time(module._examined(rights, told.append))) == faults
    # Anna and bert watch both aircraft, the wall a1 alone.
    assert len(asked) == proved
    assert "wall a2" not in asked
    ways = [f"{who} by {router}" for router in rights.routers for who in rights.identities]
    well = [router for router, seen in zip(rights.routers, there, strict=True) if seen]
    is_twice = any(2 in seen.values() for seen in there if seen)
    shown = [way for way in ways if way.endswith(tuple(well))]
    wanted = [way for way in shown if not is_twice or way.startswith("wall")]
    assert told == [f"{way}: a1, a2" for way in wanted]


def test_what_is_absent_has_ten_seconds_to_come(monkeypatch: pytest.MonkeyPatch) -> None:
    looks, told = list[float](), list[str]()

    async def examined(_: Rights, tell: Callable[[str], None]) -> list[FleetFault]:
        looks.append(asyncio.get_running_loop().time())
        tell("anna by base: a1")
        return [FleetFault("cut leg", "a2", "no agent named a2 is there", "")]

    monkeypatch.setattr(module, "_examined", examined)
    nothing: Any = None
    assert len(on_virtual_time(examine(nothing, told.append))) == 1
    assert looks == pytest.approx([looks[0] + n / 2 for n in range(21)], abs=0.01)
    assert told == ["anna by base: a1"]


async def at_once(work: Any, *what: Any) -> Any:
    return work(*what)


# -- each part by itself ---------------------------------------------------------------------------


def test_an_agent_of_a_file_is_lost_as_the_file_says(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    rights = the_rights(monkeypatch, tmp_path)
    monkeypatch.setattr(module, "Seal", SimpleNamespace(read=lambda *what: f"seal of {what[1]}"))
    monkeypatch.setattr(module, "verifying", lambda *what: what)
    monkeypatch.setattr(module, "default_order_logs", lambda: tmp_path / "logs")
    own, other = (agent_of(rights, name, is_real=name == "a1") for name in ("a1", "a2"))
    assert [(one.lost.action, one.lost.after_s) for one in (own, other)] == [
        *(("land", 2.5), ("hover", 10.0))
    ]
    assert (own.order_logs, other.order_logs) == (tmp_path / "logs", None)
    assert (own.connect, own.site) == (rights.endpoints, "site")
    seals: Any = own.seals
    assert (seals, own.options) == ({"a1": "seal of a1"}, {"tls": "('a1', {})"})
    assert own.revocations is not None
    verify: Any = own.verify
    assert verify[:2] == (rights, ["a1"])
    assert verify[3] == "since"


class FakeChild(SimpleNamespace):
    """A process that reads its orders from its standard input."""

    def __init__(self, role: str, name: str, request: dict[str, Any], note: Any) -> None:
        super().__init__(role=role, name=name, request=request, note=note, answer={"runs": name})


@pytest.mark.parametrize("has_console", [False, True])
def test_routers_begin_first_and_end_last(
    has_console: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    rights, steps = the_rights(monkeypatch, tmp_path), list[tuple[str, list[str], Any]]()
    children: list[FakeChild] = []

    @asynccontextmanager
    async def supervised(*some: FakeChild, timeout: float | None = None) -> AsyncIterator[None]:
        children.extend(some)
        names = [one.name for one in some]
        steps.append(("begin", names, timeout))
        yield
        steps.append(("end", names, timeout))

    for name, fake in (
        *(("ChildProcess", FakeChild), ("supervised", supervised)),
        *(("agent_settings", vars), ("Rights", SimpleNamespace(read=lambda _: rights))),
    ):
        monkeypatch.setattr(module, name, fake)
    settings: dict[str, Any] = {"base": None, "a1": SimpleNamespace(url="x"), "mast": None}
    settings |= {"console": None} if has_console else {}

    async def run() -> dict[str, Any]:
        async with module.running_parts(rights.path, settings, print, is_real=True) as facts:
            return facts

    assert on_virtual_time(run()) == {name: {"runs": name} for name in settings}
    agents, routers, pages = (["a1"], 15.0), (["base", "mast"], None), (["console"], None)
    order = [routers, agents, *([pages] if has_console else [])]
    assert steps == [*(("begin", *one) for one in order), *(("end", *one) for one in order[::-1])]
    for one in children:
        given = {"url": "x"} if one.name == "a1" else None
        wanted = {"file": str(rights.path), "name": one.name, "settings": given}
        assert (one.role, one.note) == ("part", print)
        assert one.request == wanted | {"is_real": True}


@pytest.mark.parametrize(
    ("name", "facts"),
    [
        ("a2", {"agent": "a2"}),
        ("mast", {"router": "tls/127.0.0.1:7448"}),
        ("console", {"console": "http://127.0.0.1:8017/?code=1"}),
    ],
)
def test_a_part_runs_as_its_kind(
    name: str, facts: dict[str, Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    rights, began = the_rights(monkeypatch, tmp_path), list[Any]()

    def running(kind: str, found: Any = None) -> Any:
        @asynccontextmanager
        async def run(*what: Any, **more: Any) -> AsyncIterator[Any]:
            began.append((kind, what, more))
            yield found

        return run

    served = SimpleNamespace(
        sockets=SimpleNamespace(port=lambda name: {"console": 8017}[name]),
        console_path=lambda: "/?code=1",
    )
    for what, fake in (
        *(("serving_fleet", running("agent")), ("routing", running("router"))),
        *(("connect", running("fleet", "the fleet")), ("agent_of", lambda *_, **__: "how")),
        ("serving_fleet_console", running("console", served)),
        ("Rights", SimpleNamespace(read=lambda _: rights)),
    ):
        monkeypatch.setattr(module, what, fake)

    async def run() -> dict[str, Any]:
        given: Any = "settings" if name == "a2" else None
        async with module.running_part(rights.path, name, given, print, is_real=False) as found:
            return found

    assert on_virtual_time(run()) == facts
    if name == "a2":
        assert began == [("agent", ({"a2": "settings"}, "how", print, 1), {})]
    elif name == "mast":
        assert began == [("router", (rights, "mast"), {})]
    else:
        (_, endpoints, how), (_, (bus, settings), _) = began
        assert (endpoints, how["name"], how["site"]) == (rights.endpoints, "bert", "site")
        assert (how["sign"].name, how["tls"]) == ("bert", "('bert', {})")
        assert (bus, settings.console_port) == ("the fleet", 8017)
