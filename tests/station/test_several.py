"""Several aircraft, a process each: what the loss of one costs the others."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

pytest.importorskip("uvicorn")
from websockets.asyncio.client import ClientConnection

from m100link.errors import UsageError
from m100link.station.config import Settings
from m100link.station.several import RunningSeveral, agent_settings, running_several
from tests.sockets import connect
from tests.station.test_apart import Pilot
from tests.waiting import PATIENCE, until

pytestmark = pytest.mark.anyio

FIRST, SECOND = "", "/m100_2"


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


class NamedPilot(Pilot):
    """A rosbridge client that flies one of several aircraft and sees how fast it is."""

    def __init__(self, client: ClientConnection, prefix: str) -> None:
        super().__init__(client)
        self.prefix = prefix
        self.east = 0.0

    async def reached(self) -> None:
        """Wait until the fronts have found the agent that was started again."""
        async with asyncio.timeout(PATIENCE):
            while not (await self.call(f"{self.prefix}/dji_sdk/activation"))["result"]:  # noqa: ASYNC110 - what is waited for has no event
                await asyncio.sleep(0.1)

    async def take_off(self) -> None:
        for service, more in (
            ("activation", {}),
            ("sdk_control_authority", {"control_enable": 1}),
            ("drone_task_control", {"task": 4}),
        ):
            answer = await self.call(f"{self.prefix}/dji_sdk/{service}", **more)
            assert answer["result"], answer
            assert answer["values"]["result"], answer

    async def fly(self) -> None:
        """A velocity to the east again and again; what it becomes is read beside it."""
        topic = f"{self.prefix}/dji_sdk/flight_control_setpoint_ENUvelocity_yawrate"
        await self.send("advertise", topic=topic, type="sensor_msgs/Joy")
        await self.send("subscribe", topic=f"{self.prefix}/dji_sdk/velocity")
        reading = asyncio.create_task(self._read())
        try:
            while True:
                await self.send("publish", topic=topic, msg={"axes": [1.0, 0.0, 0.0, 0.0]})
                await asyncio.sleep(0.05)
        finally:
            reading.cancel()

    async def _read(self) -> None:
        async for text in self.client:
            message = json.loads(text)
            if message["op"] == "publish":
                self.east = message["msg"]["vector"]["x"]


@asynccontextmanager
async def two() -> AsyncIterator[tuple[RunningSeveral, list[str]]]:
    """A station with two virtual aircraft, and what it tells."""
    told: list[str] = []
    settings = Settings(sim=True, port=0)
    aircraft = {"m100_1": settings, "m100_2": settings}
    async with running_several(
        aircraft, tell=lambda name, e: told.append(f"{name}: {e.text}")
    ) as s:
        yield s, told


async def flown(pilot: NamedPilot) -> asyncio.Task[None]:
    """The pilot flies, well above the ground."""
    await pilot.take_off()
    work = asyncio.create_task(pilot.fly())
    await until(lambda: pilot.east > 0.8, within=PATIENCE)
    return work


async def test_an_agent_that_is_killed_costs_the_other_aircraft_nothing() -> None:
    async with (
        two() as (station, told),
        connect(f"ws://127.0.0.1:{station.ports[0]}") as one,
        connect(f"ws://127.0.0.1:{station.ports[0]}") as other,
    ):
        pilot, bereft = NamedPilot(one, FIRST), NamedPilot(other, SECOND)
        works = [await flown(pilot), await flown(bereft)]
        lease = station.agents["m100_1"].holder
        slowest = [pilot.east]
        watching = asyncio.create_task(_watch(pilot, slowest))
        before = station.owners["m100_2"].pid
        assert before is not None
        os.kill(before, signal.SIGKILL)
        await until(lambda: "m100_2: the agent of m100_2: serving again" in told, within=PATIENCE)
        await until(lambda: station.agents["m100_2"].is_connected, within=PATIENCE)
        watching.cancel()
        assert min(slowest) > 0.5, "the other aircraft slowed down"
        assert station.agents["m100_1"].holder == lease
        assert station.agents["m100_1"].state.has_authority
        # The lease of the agent that died fits nothing: who flew has to take control anew.
        assert station.agents["m100_2"].holder.number == 0
        assert not station.agents["m100_2"].state.has_authority
        for work in works:
            work.cancel()
        await asyncio.gather(*works, return_exceptions=True)
        async with connect(f"ws://127.0.0.1:{station.ports[0]}") as third:
            late = NamedPilot(third, SECOND)
            await late.reached()
            await late.take_off()
            assert station.agents["m100_2"].holder.number > 1_000_000


async def _watch(pilot: NamedPilot, seen: list[float]) -> None:
    while True:
        await asyncio.sleep(0.05)
        seen.append(pilot.east)


def _sockets(runtime: Path) -> list[Path]:
    """Where the agents of the only station in this folder serve."""
    return sorted(runtime.glob("m100link-*/agent*.sock"))


async def test_agents_end_in_order_when_whoever_started_them_is_killed(tmp_path: Path) -> None:
    program = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "m100link", "serve", "first=sim://", "second=sim://"),
        *("--port", "0", "--json"),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
        env={**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)},
    )
    assert program.stdout is not None
    report = json.loads(await program.stdout.readline())
    assert report["aircraft"] == ["first", "second"]
    sockets = _sockets(tmp_path)
    assert len(sockets) == 2
    async with connect(report["rosbridge"][0]) as client:
        pilot = NamedPilot(client, "/second")
        assert (await pilot.call("/second/dji_sdk/query_drone_version"))["result"] is True
        program.kill()
        await program.wait()

        async def refuses(path: Path) -> bool:
            try:
                _, writer = await asyncio.open_unix_connection(str(path))
            except OSError:
                return True
            writer.close()
            return False

        async with asyncio.timeout(PATIENCE):
            for path in sockets:
                while not await refuses(path):  # noqa: ASYNC110 - another process has no event
                    await asyncio.sleep(0.1)
        answer = await pilot.call("/second/dji_sdk/query_drone_version")
        assert "has gone" in answer["values"]


def test_agents_know_nothing_of_who_may_connect() -> None:
    settings = Settings(url="/dev/x", key="00" * 32, app_id=7, token="a-token-of-16-characters")
    told = json.loads(json.dumps(agent_settings(settings)))
    assert told["key"] == "00" * 32
    assert not {"token", "token_file", "host", "port", "pages"} & set(told)


async def test_more_aircraft_than_anybody_watches_are_refused() -> None:
    with pytest.raises(UsageError, match="at most 8"):
        async with running_several({f"a{n}": Settings(sim=True) for n in range(9)}):
            pass


async def test_a_mistake_in_one_of_them_is_told_as_it_is(tmp_path: Path) -> None:
    wrong = Settings(url="/dev/x", app_id=7, key_file=tmp_path / "none")
    with pytest.raises(UsageError, match="none"):
        async with running_several({"a": Settings(sim=True, port=0), "b": wrong}):
            pass
