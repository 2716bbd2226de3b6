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
from typing import Any

import pytest

pytest.importorskip("zenoh", reason="the extra fleet is not installed")

from m100link.apps.cli.fleet_setup import _settings_of
from m100link.apps.fleet import pki
from m100link.apps.fleet.agent import FleetAgent
from m100link.apps.fleet.client import open_fleet
from m100link.apps.fleet.identity import Rights
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.signing import tls_options
from m100link.apps.station import fleet
from m100link.apps.station.fleet_file import (
    FleetFault,
    agent_of,
    examine,
    routing,
)
from tests.apps.fleet.test_pki import free_port

pytestmark = pytest.mark.pty

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


def test_a_healthy_fleet_has_no_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert findings(tmp_path, monkeypatch) == []


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
