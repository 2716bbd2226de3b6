"""A station of a recording: it shows what was, and gives nobody control."""

from __future__ import annotations

import asyncio
import random
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mcap", reason="the extra `log` is not installed")

from m100link import Position
from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.server.agent import Agent
from m100link.apps.agent.server.replays import Replays
from m100link.apps.agent.server.server import AgentServer
from m100link.apps.agent.transports import memory_channels
from m100link.errors import M100Error, OnlyRecorded, UsageError
from m100link.log import read, recorder
from m100link.sim import VirtualClockEventLoop
from tests.log.flight import flown

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> tuple[str, dict[str, Any]]:
    return "asyncio", {"loop_factory": VirtualClockEventLoop}


@pytest.fixture
async def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(recorder, "FLUSH_S", 0.0)  # of the wall clock: a part for each batch
    place = tmp_path / "flight.mcap"
    await flown(place)
    return place


@asynccontextmanager
async def station(url: str) -> AsyncIterator[tuple[Agent, AgentClient]]:
    """An agent that owns a recording, and a front of it."""
    replays = Replays(url, None)
    async with (agent := Agent(replays.connect, replay=replays)):
        service = AgentServer(agent)
        ours, its = memory_channels(as_bytes=True)
        service.attach(its)
        async with AgentClient(ours, "front") as client:
            await asyncio.sleep(0.3)
            assert client.is_connected
            yield agent, client
        service.close()


async def test_nobody_gets_control_and_nothing_is_sent(path: Path) -> None:
    async with station(f"replay://{path}") as (agent, client):
        with pytest.raises(OnlyRecorded, match="nothing flies"):
            await client.acquire("somebody")
        with pytest.raises(OnlyRecorded):
            await client.ask_take_over("somebody")
        for action in (
            orders.Activate(),
            orders.UseCamera(orders.CameraUse.PHOTO),
            orders.Obtain(),
            orders.TakeOff(),
        ):
            with pytest.raises(M100Error):
                await client.ask(action)
        await asyncio.sleep(1.0)
        assert client.holder.number == 0
        assert client.state.holding == "none"
        assert not client.has_authority
        assert agent.connection.aircraft is not None
        assert agent.connection.aircraft.statistics().frames_sent == 0


@pytest.mark.parametrize("speed", ["0.5", "1", "5"])
async def test_ages_are_those_of_then_at_any_speed_and_stand_still_with_it(
    path: Path, speed: str
) -> None:
    async with station(f"replay://{path}?speed={speed}") as (_, client):
        telemetry = client.telemetry
        assert telemetry is not None
        await asyncio.sleep(1.0)
        for _ in range(10):
            await asyncio.sleep(0.07)
            age = telemetry.age(Position)
            assert age is not None
            assert -0.01 <= age < 0.05
        await client.ask(orders.OrderReplay("pause"))
        await asyncio.sleep(0.1)
        age = telemetry.age(Position)
        await asyncio.sleep(30.0)
        assert telemetry.age(Position) == pytest.approx(age, abs=1e-3)
        told = client.state.replay
        assert told is not None
        assert told.is_paused


_MORE = [pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 20)]


@pytest.mark.parametrize("seed", [0, *_MORE])
async def test_a_busy_computer_makes_nothing_old_and_a_seek_mixes_no_places(
    path: Path, seed: int
) -> None:
    """Stalls of up to 5 s, seeks, pauses and speeds drawn by seed: all values are the file's."""
    chance = random.Random(seed)
    recorded = {(one.position, one.velocity) for one in read(path).samples() if one.position}
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualClockEventLoop)
    async with station(f"replay://{path}") as (_, client):
        for number in range(50):
            order = chance.choice(["seek {:.2f}", "speed {:.1f}", "pause", "resume", "resume"])
            bound = 50.0 if "speed" in order else 16.0
            await client.ask(orders.OrderReplay(order.format(chance.uniform(0.1, bound))))
            for _ in range(chance.randrange(1, 6)):
                await asyncio.sleep(chance.choice([0.0, 0.0, 0.01, 0.3]))
                view = client.view
                seen = seed, number, order, view.now, view.telemetry_at, view.state.replay
                if view.telemetry_at is not None:
                    assert 0.0 <= view.now - view.telemetry_at < 0.1, seen
                if view.telemetry is not None and (position := view.telemetry.position):
                    assert (position, view.telemetry.velocity) in recorded, seen
                if chance.random() < 0.3:  # something else holds up the whole process
                    loop._jumping.now += chance.uniform(0.0, 5.0)


async def test_it_is_moved_stands_at_its_end_and_goes_on(path: Path) -> None:
    async with station(f"replay://{path}") as (_, client):
        for order, place in (("seek 10", 10.0), ("by -4", 6.0), ("by -100", 0.0), ("seek 8", 8.0)):
            await client.ask(orders.OrderReplay(order))
            await asyncio.sleep(0.3)
            told = client.state.replay
            assert told is not None
            assert told.position_s == pytest.approx(place + 0.3, abs=0.4)
        position = client.telemetry.position if client.telemetry is not None else None
        assert position is not None
        assert position.height_m > 0.5
        await client.ask(orders.OrderReplay("speed max"))
        await asyncio.sleep(5.0)
        told = client.state.replay
        assert told is not None
        assert told.is_at_end
        assert told.path == str(path)
        assert client.is_connected, "it stands still at its end"
        await client.ask(orders.OrderReplay("speed 1"))
        await client.ask(orders.OrderReplay("resume"))
        await asyncio.sleep(1.0)
        told = client.state.replay
        assert told is not None
        assert told.position_s == pytest.approx(1.0, abs=0.4)
        for wrong in ("", "rewind", "seek", "seek nan", "seek inf", "speed 0", "speed 1e9", "by x"):
            with pytest.raises(UsageError):
                await client.ask(orders.OrderReplay(wrong))


async def test_that_its_place_moves_does_not_tell_the_state_more_often(path: Path) -> None:
    async with station(f"replay://{path}") as (_, client):
        told = set[float]()
        for _ in range(400):
            await asyncio.sleep(0.01)
            told.add(client.state.at)
        assert len(told) <= 18
        known = client.state.at
        await client.ask(orders.OrderReplay("pause"))
        await asyncio.sleep(0.01)
        assert client.state.at > known, "a change by people is sent at once"


async def test_an_aircraft_is_not_moved_in_time() -> None:
    async def never() -> Any:
        await asyncio.Event().wait()

    async with Agent(never) as agent:
        with pytest.raises(UsageError, match="not a replay"):
            await agent.ask(orders.OrderReplay("pause"))


async def test_what_cannot_be_played_is_refused_before_anything_is_served(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="No such file"):
        await Replays(f"replay://{tmp_path / 'none.mcap'}", None).look()
    with pytest.raises(UsageError):
        Replays("replay://x?speed=0", None)
