"""Which aircraft a console over a fleet shows, and what it hears of each."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, ExitStack, asynccontextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import anyio
import pytest

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.messages import LeaseChanged
from m100link.apps.fleet.identity import nobody
from m100link.apps.fleet.keys import Keys
from m100link.apps.station import fleet as module
from m100link.apps.station.config import Settings
from m100link.apps.station.fleet import (
    MOST_SHIPS,
    FleetSettings,
    Ships,
    names_of,
    serving_fleet_console,
)
from m100link.errors import LinkError, Unreachable, UsageError
from m100link.sim.clock import virtual_clock_loop
from tests.apps.fleet.conftest import SITE, Rig

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> tuple[str, dict[str, Any]]:
    return "asyncio", {"loop_factory": virtual_clock_loop}


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    made = Rig()
    async with made.stack:
        yield made


async def test_aircraft_that_are_there_are_shown_and_missing_ones_named(rig: Rig) -> None:
    pilot = await rig.pilot()
    with pytest.raises(UsageError, match="there is no agent at site field"):
        await names_of(pilot)
    for name in ("a2", "a1"):
        await rig.served(name)
    assert await names_of(pilot) == ["a1", "a2"]
    assert await names_of(pilot, ("a2", "a2")) == ["a2"]
    with pytest.raises(Unreachable, match="no agent named b7 is there") as caught:
        await names_of(pilot, ("a1", "b7"))
    assert "a1, a2" in caught.value.remedy


async def test_more_than_a_page_holds_are_refused(rig: Rig) -> None:
    bus = rig.network.session()
    tokens = [bus.declare(Keys(SITE, f"a{n}").live_by(bus.session)) for n in range(MOST_SHIPS + 1)]
    with pytest.raises(UsageError, match="too many"):
        await names_of(await rig.pilot())
    tokens.pop().close()
    assert len(await names_of(await rig.pilot())) == MOST_SHIPS


async def test_one_that_does_not_answer_costs_the_others_nothing(rig: Rig) -> None:
    await rig.aircraft("a1")  # of an older release: it tells nothing
    await rig.served("a2")
    async with AsyncExitStack() as stack:
        ships = Ships(await rig.pilot(), stack)
        assert await ships.first(["a1", "a2"]) == "a2"
        for name in ("a1", "a2"):
            await ships.show(name)
        assert list(ships.agents) == ["a2"]
        with pytest.raises(LinkError, match="a1 does not answer"):
            await ships.first(["a1"])


async def test_what_is_looked_at_comes_whole_and_the_rest_as_for_a_wall(rig: Rig) -> None:
    for name in ("a1", "a2"):
        await rig.served(name)
    heard = {"a1": 0, "a2": 0}
    async with AsyncExitStack() as stack:
        ships = Ships(await rig.pilot(), stack)

        def count(name: str) -> None:
            def on_sample(_: object) -> None:
                heard[name] += 1

            ships.agents[name].on_sample.append(on_sample)

        for name in heard:
            await ships.show(name)
            count(name)
        ships.look(["a2"])
        await anyio.sleep(5.0)
        assert heard["a2"] > 4 * heard["a1"] > 0
        before = dict(heard)
        ships.look(["a1"])
        await anyio.sleep(5.0)
        assert heard["a1"] - before["a1"] > 4 * (heard["a2"] - before["a2"]) > 0


async def test_control_that_was_taken_here_is_given_back_at_the_end(rig: Rig) -> None:
    one, changes = await rig.served("a1"), list[LeaseChanged]()
    one.client.on_lease.append(changes.append)
    async with AsyncExitStack() as stack:
        ships = Ships(await rig.pilot(), stack)
        await ships.show("a1")
        await ships.agents["a1"].acquire("console 1")
        await ships.let_go()
    await anyio.sleep(0.2)
    assert [(bool(one.number), one.why and one.why.value) for one in changes] == [
        (True, "acquired"),
        (False, "released"),
    ]


@pytest.mark.parametrize("name", ["a1", "a2"])
async def test_whichever_aircraft_it_shows_a_console_that_ends_gives_control_back(
    rig: Rig, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """a1 is there when it begins, a2 comes later: its way must not be closed before."""

    @asynccontextmanager
    async def serving(_: object, __: object, reach: Any, *___: object, **____: object) -> Any:
        ((first, way),) = reach.items()
        async with AgentClient(await way(), "console") as agent:
            yield SimpleNamespace(agents={first: agent}, shown=frozenset)

    monkeypatch.setattr(module, "serving_fronts", serving)
    monkeypatch.setattr(module, "open_sockets", lambda *_, **__: None)
    one, changes = await rig.served("a1"), list[LeaseChanged]()
    async with serving_fleet_console(await rig.pilot(), Settings()) as console:
        if name == "a2":
            one = await rig.served("a2")
        await rig.until(lambda: name in console.agents, within=5.0)
        one.client.on_lease.append(changes.append)
        await console.agents[name].acquire("console 1")
    await anyio.sleep(0.2)
    assert [(bool(one.number), one.why and one.why.value) for one in changes] == [
        (True, "acquired"),
        (False, "released"),
    ]


async def test_an_agent_that_is_started_anew_is_found_again(rig: Rig) -> None:
    one = await rig.served("a1")
    async with AsyncExitStack() as stack:
        ships = Ships(await rig.pilot(), stack)
        await ships.show("a1")
        far = ships.agents["a1"]
        await rig.until(lambda: far.is_connected)
        one.work.cancel()
        await rig.until(lambda: far.is_gone, within=3.0)
        one.work = one.agent.background.spawn(one.fleet_agent.run(), "fleet")
        await rig.until(lambda: far.is_connected, within=5.0)


def test_the_order_log_of_an_agent_that_ended_can_be_opened_again(tmp_path: Path) -> None:
    fleet, keys = FleetSettings(order_logs=tmp_path), Keys(SITE, "a1")
    first, then = ExitStack(), ExitStack()
    with then:
        with first:
            log = module._order_log(cast("AsyncExitStack", first), fleet, keys)
            with pytest.raises(UsageError, match="another agent has it"):
                module._order_log(cast("AsyncExitStack", then), fleet, keys)
        assert module._order_log(cast("AsyncExitStack", then), fleet, keys) is not log


# -- what the agent of an aircraft is given, and what is served beside it --------------------------


class Given(SimpleNamespace):
    """What something was made with."""

    def __init__(self, *what: Any, **more: Any) -> None:
        super().__init__(what=what, **more)

    async def run(self) -> None:
        await anyio.sleep(3600.0)

    async def flush(self) -> None:
        self.is_flushed = True


class OwnedAgent(Given):
    """An agent of a fleet that owns nothing."""

    boot, duplicates, note_order, shut_out = "run 7", "names", "note order", "agent shut out"

    def __init__(self, client: Any, bus: Any, keys: Keys, order_log: Any, **more: Any) -> None:
        super().__init__(order_log=order_log, bus=bus, keys=keys, alone=0, **more)
        self.client = client
        self.audit = more.get("audit", "no audit")

    async def require_alone(self) -> None:
        self.alone += 1


class Shown(Given):
    """The service of shows, whose aircraft may be shut out."""

    def shut_out(self, since: Any) -> str:
        return f"show shut out by {since}"


def parts_that_are_given(
    monkeypatch: pytest.MonkeyPatch,
) -> tuple[dict[str, list[Any]], list[tuple[Any, dict[str, Any]]]]:
    """What the parts of agents are made with, by kind, and how each aircraft is owned."""
    made: dict[str, list[Any]] = {}
    owned: list[tuple[Any, dict[str, Any]]] = []

    def making(kind: type[Any], name: str) -> Any:
        def make(*what: Any, **more: Any) -> Any:
            made.setdefault(name, []).append(one := kind(*what, **more))
            return one

        return make

    @asynccontextmanager
    async def owning(settings: Settings, **more: Any) -> AsyncIterator[Any]:
        owned.append((settings, more))
        yield SimpleNamespace(service=SimpleNamespace(attach=lambda _: None))

    @asynccontextmanager
    async def client(_: object, name: str) -> AsyncIterator[Any]:
        assert name == "fleet"
        yield SimpleNamespace(events=["before"], on_event=[], note="client note")

    @asynccontextmanager
    async def open_fleet(mode: str, **more: Any) -> AsyncIterator[str]:
        made["bus"] = [(mode, more)]
        yield "bus"

    for name in ("AuditLog", "StatePublisher", "LogService", "RevocationService"):
        monkeypatch.setattr(module, name, making(Given, name))
    monkeypatch.setattr(module, "ShowService", making(Shown, "ShowService"))
    monkeypatch.setattr(module, "FleetAgent", making(OwnedAgent, "FleetAgent"))
    for name, fake in (("owning", owning), ("AgentClient", client), ("open_fleet", open_fleet)):
        monkeypatch.setattr(module, name, fake)
    return made, owned


@pytest.mark.parametrize("is_kept", [False, True])
async def test_an_agent_of_a_fleet_has_what_the_settings_say(
    is_kept: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, owned = parts_that_are_given(monkeypatch)
    told: list[tuple[str, str]] = []
    revocations: Any = SimpleNamespace(since="since")
    seal: Any = SimpleNamespace(audit="seal")
    verify: Any = "verify"
    fleet = FleetSettings(("tcp/h:1",), SITE, log_rate=5e5)
    if is_kept:
        fleet = replace(
            fleet, order_logs=tmp_path, seals={"a1": seal}, verify=verify, revocations=revocations
        )
    aircraft = {
        "a1": Settings(record=tmp_path / "f1"),
        "a2": Settings(record=tmp_path / "f2", no_record=True),
    }
    serving: Any = module.serving_fleet(aircraft, fleet, lambda *what: told.append(what), place=3)
    async with serving as agents:
        assert list(agents) == ["a1", "a2"]
        for name, agent in agents.items():
            agent.client.on_event[0](f"later {name}")
    assert told == [("a1", "before"), ("a2", "before"), ("a1", "later a1"), ("a2", "later a2")]
    [(mode, how)] = made["bus"]
    assert (mode, how["connect"], how["is_patient"]) == ("client", ("tcp/h:1",), True)
    assert [more["place"] for _, more in owned] == [3, 4]
    one, other = made["FleetAgent"]
    assert (one.alone, other.alone) == (1, 1)
    assert (one.keys, other.keys) == (Keys(SITE, "a1"), Keys(SITE, "a2"))
    assert one.order_log is not other.order_log
    before = [more["leases_before"] for _, more in owned]
    assert before == [one.order_log.leases_before, other.order_log.leases_before]
    folders = [agent.disks.args[0] for agent in (one, other)]
    own = [tmp_path] if is_kept else []
    assert folders == [[*own, tmp_path / "f1"], own], "where nothing is recorded none is needed"
    assert one.revoked == ("since" if is_kept else nobody)
    assert other.audit == "no audit"
    audits = made.get("AuditLog", [])
    assert audits == ([one.audit] if is_kept else [])
    for audit in audits:
        assert audit.what == (tmp_path / SITE / "a1.audit", "seal", time.time)
        assert audit.is_flushed
    if is_kept:
        assert (tmp_path / SITE / "a1.jsonl").exists()
    logs = made["LogService"]
    assert [log.what[2] for log in logs] == [tmp_path / "f1", None]
    assert [(log.rate, log.audit) for log in logs] == [(5e5, one.audit), (5e5, "no audit")]
    shows = made["ShowService"]
    assert shows[0].beside is shows[1].beside, "of one process"
    for show in shows:
        assert (show.names, show.note) == ("names", "note order")
        assert show.what[3] == "run 7"
    for what in (one, *logs[:1], *shows[:1]):
        assert what.verify == ("verify" if is_kept else None)
    services = made.get("RevocationService", [])
    assert len(services) == (2 if is_kept else 0)
    for service in services:
        assert (service.what[3], service.note) == (revocations, "client note")
        assert service.shut_out[0] == "agent shut out"
        assert service.shut_out[1]() == "show shut out by since"


@pytest.mark.parametrize(
    ("left_mb", "seen"),
    [
        (0.9, "full disk: 1 MB are left for"),
        (1.0, "no log space: 1 MB are left for"),
        (49.0, "no log space: 49 MB are left for"),
        (50.0, None),
        (None, "cannot be read: Stale file handle"),
    ],
)
def test_a_disk_has_room_for_a_flight(
    left_mb: float | None, seen: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked: list[Path] = []

    def usage(path: Path) -> Any:
        looked.append(path)
        if left_mb is None:
            raise OSError(116, "Stale file handle")
        return SimpleNamespace(free=1e9 if path == tmp_path else int(left_mb * 1e6))

    monkeypatch.setattr("shutil.disk_usage", usage)
    (there := tmp_path / "there").mkdir()
    found = module.room([tmp_path, there / "not" / "yet"] if left_mb is not None else [there])
    assert looked[-1] == there, "the nearest folder that exists"
    assert (found is None) is (seen is None)
    assert seen is None or (found is not None and seen in found.seen)
    assert module.room([]) is None
