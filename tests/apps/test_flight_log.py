"""The names in a flight log: of those who wanted something, by every front, from the file alone."""

from __future__ import annotations

import asyncio
import json
import logging
import random
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.lease import Lease
from m100link.apps.agent.server import connection as agent_connection
from m100link.apps.agent.server.server import AgentServer
from m100link.apps.agent.transports import memory_channels
from m100link.apps.mavlink.translator.numbers import MissionResult, MissionType
from m100link.errors import M100Error
from m100link.log import Recorder, read
from m100link.log.channels import EVENT
from m100link.sim.clock import virtual_clock_loop
from tests.apps.agent.conftest import Rig
from tests.apps.every_front import (
    OTHER,
    BesideAnAgent,
    Console,
    FarConsole,
    FleetPilot,
    Mavlink,
    Ros2,
    Rosbridge,
)
from tests.apps.mavlink.translator.test_missions import Exchange, item
from tests.rig import NORTH

pytestmark = pytest.mark.anyio
pytest.importorskip("mcap.writer", reason="the extra `log` is not installed")


@pytest.fixture
def anyio_backend() -> tuple[str, dict[str, Any]]:
    return "asyncio", {"loop_factory": virtual_clock_loop}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where every connection of every agent is recorded."""

    @asynccontextmanager
    async def recording(_: object) -> AsyncIterator[Recorder]:
        yield Recorder(tmp_path)

    monkeypatch.setattr(agent_connection, "_recording", recording)
    return tmp_path


Notes = list[dict[str, Any]]


def notes_of(path: Path) -> Notes:
    return [one.content() | {"at": one.at} for one in read(path).messages(EVENT)]


def recorded(folder: Path) -> list[Notes]:
    """The notes of each connection, in their order: names of files are of another clock."""
    # One may be that of a connection which had just begun when the agent ended.
    found = [notes_of(path) for path in folder.iterdir() if path.stat().st_size]
    return sorted((notes for notes in found if notes), key=lambda notes: notes[0]["at"])


def those(notes: Notes, event: str, **values: Any) -> Notes:
    return [
        one
        for one in notes
        if one["event"] == event and all(one.get(name) == value for name, value in values.items())
    ]


@pytest.mark.parametrize(
    ("front", "name"),
    [
        (Console, "tab"),
        (Rosbridge, "program"),
        (Mavlink, "MAVLink 245 at 127.0.0.1:14540"),
        (Ros2, "ROS 2"),
        (FleetPilot, "pilot"),
        (FarConsole, "pilot: tab"),
    ],
    ids=lambda one: getattr(one, "__name__", ""),
)
async def test_every_front_names_who_flew_and_who_stopped(
    folder: Path, front: type[BesideAnAgent], name: str
) -> None:
    user = front()
    async with user.open():
        await user.begin()
        assert await user.holder() == name
        await user.stop_elsewhere()
        await user.passes(2.0)
    notes = recorded(folder)[0]
    taken = those(notes, "lease", why="acquired", holder=name)
    flown = those(notes, "setpoints", by=name)
    other = "anybody" if front in (FleetPilot, FarConsole) else OTHER
    stopped = those(notes, "text", text=f"{other}: STOP")
    pressed = those(notes, "order", order="stop", stage="done")
    held = those(notes, "control", before="obtaining", after="held")
    over = those(notes, "control", before="held", after="releasing")
    assert taken[0]["at"] <= held[0]["at"] <= flown[0]["at"] < pressed[0]["at"] < over[-1]["at"]
    assert stopped[0]["at"] == pressed[0]["at"]
    assert flown[0]["setpoint"]["x"] == pytest.approx(2.0)
    assert those(notes, "state", steered=True)
    assert those(notes, "state", steered=False)[-1]["at"] - pressed[0]["at"] < 0.3
    limits = [one["limits"] for one in those(notes, "state") if "limits" in one]
    assert limits[0]["max_height_m"] == 50.0
    assert those(notes, "journal", topic="stopped")


@pytest.fixture
async def stations(folder: Path) -> AsyncIterator[tuple[Rig, AgentClient, AgentClient]]:
    """An agent that is recorded, and two stations of it."""
    async with Rig().running() as rig:
        rig.renewing.cancel()
        rig.agent.leases.release(rig.token, rig.agent.now)
        service = AgentServer(rig.agent)
        clients = []
        for name in ("first station", "second station"):
            ours, its = memory_channels(as_bytes=True)
            service.attach(its)
            clients.append(AgentClient(ours, name))
        async with clients[0] as one, clients[1] as two:
            yield rig, one, two


async def closed(rig: Rig) -> None:
    """The log of this connection ends."""
    aircraft = rig.agent.connection.aircraft
    assert aircraft is not None
    await aircraft.aclose()


async def keep(client: AgentClient, lease: Lease) -> None:
    while True:
        client.keep(lease)
        await asyncio.sleep(0.5)


async def test_a_refusal_has_its_reason_and_no_secret_is_noted(
    stations: tuple[Rig, AgentClient, AgentClient], folder: Path
) -> None:
    rig, one, two = stations
    lease = await one.acquire("Anna")
    await one.ask(orders.Obtain(), lease)
    await one.ask(orders.Release(), lease)
    await one.ask(orders.Obtain(), lease)
    with pytest.raises(M100Error, match="Anna has control"):
        await two.acquire("Bob")
    offer = await two.ask_take_over("Bob")
    theirs = await two.confirm(offer.token)
    with pytest.raises(M100Error):
        await one.ask(orders.TakeOff(), lease)
    two.note("only for the log", "log")
    two.let_go(theirs)
    await asyncio.sleep(0.3)
    assert "only for the log" not in [event.text for event in rig.agent.journal.events]
    await closed(rig)
    notes = recorded(folder)[0]
    [refused] = those(notes, "order", order="acquire lease", stage="failed")
    assert refused["seen"] == "Anna has control"
    assert (refused["client"], refused["error"]) == ("second station", "M100-LEASE-HELD")
    [late] = those(notes, "order", order="take off", stage="failed")
    assert late["client"] == "first station"
    assert "Bob has control" in late["seen"]
    [asked] = those(notes, "order", order="take off", stage="asked")
    assert notes.index(asked) < notes.index(late)
    assert [(a["why"], a["holder"]) for a in those(notes, "lease")][-3:] == [
        ("acquired", "Anna"), ("taken over", "Bob"), ("released", "")
    ]  # fmt: skip
    ends = [one["why"] for one in those(notes, "control", before="held")]
    assert ends == ["its client gives it back", "the lease has ended"]
    assert those(notes, "text", text="only for the log", client="second station")
    whole = json.dumps(notes)
    for secret in (lease.token, theirs.token, offer.token):
        assert secret not in whole


async def test_a_flood_of_one_station_costs_the_notes_of_no_other(
    stations: tuple[Rig, AgentClient, AgentClient], folder: Path
) -> None:
    """Seeded: 6,000 orders that are refused, and a landing of the other one among them."""
    rig, one, two = stations
    draw = random.Random(35)
    lease = await one.acquire("Anna")
    for number in range(60):
        for _ in range(100):
            two.hover("x" * draw.randrange(4096))
        if number == 30:
            with pytest.raises(M100Error):
                await one.ask(orders.Land(), lease)
        await asyncio.sleep(0.05)
        one.keep(lease)
    await closed(rig)
    notes = recorded(folder)[0]
    [landing] = those(notes, "order", order="land", stage="failed")
    assert landing["by"] == "Anna"
    hovers = those(notes, "order", order="hover")
    assert 100 < len(hovers) < 2000
    assert sum(one.get("left_out", 0) for one in hovers) > 3000
    assert max(len(json.dumps(one)) for one in notes) < 2000


def failing(_: object) -> Iterator[object]:
    raise OSError(28, "No space left on device")


@pytest.mark.parametrize("fails", ["taking", "logging", "writing", "reading the journal"])
async def test_a_log_that_fails_hinders_no_order(
    stations: tuple[Rig, AgentClient, AgentClient],
    folder: Path,
    fails: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig, one, _ = stations
    if fails == "taking":
        monkeypatch.setattr(AgentServer, "_note_state", failing, raising=False)
        monkeypatch.setattr("m100link.apps.agent.server.server.AgentLog._note_state", failing)
    elif fails == "logging":
        handler = logging.Handler()
        handler.emit = failing  # type: ignore[assignment]  # it raises, as a full disk does
        logging.getLogger("m100link").addHandler(handler)
    elif fails == "writing":
        monkeypatch.setattr("m100link.log.recorder.LogWriter.write", failing)
    else:
        rig.agent.journal.on_event.append(failing)  # type: ignore[arg-type]
    lease = await one.acquire("Anna")
    rig.agent.background.spawn(keep(one, lease), "renewal")
    try:
        await one.ask(orders.Obtain(), lease)
        await one.ask(orders.TakeOff(), lease)
        for _ in range(20):
            one.steer(lease, NORTH)
            await asyncio.sleep(0.05)
        assert rig.aircraft.vehicle.flight.dynamics.speed > 0.5
        await one.stop("Anna")
        await asyncio.sleep(3.0)
        assert rig.aircraft.vehicle.flight.dynamics.speed < 0.1
    finally:
        if fails == "logging":
            logging.getLogger("m100link").removeHandler(handler)


async def test_a_line_that_is_lost_in_flight_has_its_end_in_the_file(
    stations: tuple[Rig, AgentClient, AgentClient], folder: Path
) -> None:
    rig, one, _ = stations
    lease = await one.acquire("Anna")
    rig.agent.background.spawn(keep(one, lease), "renewal")
    await one.ask(orders.Obtain(), lease)
    await one.ask(orders.TakeOff(), lease)
    one.steer(lease, NORTH, 0.4)
    await asyncio.sleep(0.5)
    rig.aircraft.unplug()
    await asyncio.sleep(0.5)
    rig.aircraft.replug()
    await rig.until(lambda: rig.agent.connection.aircraft is not None)
    await closed(rig)
    first, second, *_ = recorded(folder)
    [control] = those(first, "authority", before="held")
    assert control["reason"] == "link"
    [lost] = those(first, "control", before="held")
    assert lost["why"] == "the link is gone"
    assert those(first, "journal", text="connection lost: sim:// went away")
    assert not [one for one in second if one.get("earlier_s")]
    [end] = those(first, "connection")
    assert end["error"].startswith("sim:// went away")
    assert those(first, "setpoints", by="Anna")
    both = [one["text"] for one in those([*first, *second], "journal")]
    assert both.count("connection lost: sim:// went away") == 1


async def test_the_log_of_a_new_connection_has_the_fence_in_force(folder: Path) -> None:
    user = Mavlink()
    async with user.open():
        fence = [item(5003, 0.01, 0.01, param1=15.0)]
        found = await Exchange(user.rig.ground).upload(fence, MissionType.FENCE)
        assert found is MissionResult.ACCEPTED
        for value in (3.0, 300.0):
            user.rig.ground.send("PARAM_SET", target_system=1, target_component=1,
                                 param_id="MPC_XY_CRUISE", param_value=value)  # fmt: skip
        await user.passes(1.0)
        user.aircraft.unplug()
        await user.passes(1.0)
        user.aircraft.replug()
        await user.passes(6.0)
    first, second, *_ = recorded(folder)
    said = "MAVLink 245 at 127.0.0.1:14540 uploaded a fence of 1 items: NAV_FENCE_CIRCLE_INCLUSION"
    texts = [one["text"] for one in those(first, "text")]
    assert [one for one in texts if said in one]
    taken, refused = (one for one in texts if "MPC_XY_CRUISE = " in one)
    assert taken == "MAVLink 245 at 127.0.0.1:14540: MPC_XY_CRUISE = 3: taken"
    assert "MPC_XY_CRUISE = 300: refused: MPC_XY_CRUISE is " in refused
    assert [one["text"] for one in those(second, "text") if f"in force: {said}" in one["text"]]
