"""Two processes: what happens to the aircraft, and to those who look, when one of them goes."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager, nullcontext
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import pytest
from websockets.asyncio.client import ClientConnection

from m100link.apps.station import run, supervisor
from m100link.apps.station.config import Settings, resolve
from m100link.apps.station.listeners import Sockets
from m100link.apps.station.run import (
    RunningMultiVehicle,
    RunningTwoProcess,
    agent_settings,
    running_apart,
)
from m100link.apps.station.supervisor import front_settings
from m100link.errors import M100Error, UsageError
from m100link.log import read
from tests.apps.agent.conftest import task_of
from tests.apps.station.conftest import apart, several
from tests.attacks.losses import front_of
from tests.sockets import connect
from tests.waiting import PATIENCE, until

pytest.importorskip("uvicorn")


pytestmark = pytest.mark.anyio


def test_a_setting_of_zero_or_false_reaches_the_fronts_and_none_does_not() -> None:
    found = front_settings(Settings(sim=False, port=0, metrics_port=None, tiles=Path("a.mbtiles")))
    assert (found["port"], found["sim"], found["tiles"]) == (0, False, "a.mbtiles")
    assert "metrics_port" not in found
    assert front_settings(Settings(url="sim://?firmware=3.1"))["sim"]  # the URL itself stays here


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


class Pilot:
    """A rosbridge client that flies."""

    def __init__(self, client: ClientConnection) -> None:
        self.client = client

    async def send(self, op: str, **fields: Any) -> None:
        await self.client.send(json.dumps({"op": op, **fields}))

    async def call(self, service: str, **args: Any) -> Any:
        await self.send("call_service", service=service, args=args)
        async with asyncio.timeout(PATIENCE):
            while True:
                answer = json.loads(await self.client.recv())
                if answer["op"] == "service_response":
                    return answer

    async def take_off(self) -> None:
        await self.call("/dji_sdk/activation")
        assert (await self.call("/dji_sdk/sdk_control_authority", control_enable=1))["result"]
        assert (await self.call("/dji_sdk/drone_task_control", task=4))["result"]

    async def fly(self) -> None:
        """A setpoint again and again."""
        topic = "/dji_sdk/flight_control_setpoint_ENUvelocity_yawrate"
        await self.send("advertise", topic=topic, type="sensor_msgs/Joy")
        while True:
            await self.send("publish", topic=topic, msg={"axes": [1.0, 0.0, 0.0, 0.0]})
            await asyncio.sleep(0.05)


@asynccontextmanager
async def flying(
    *, with_console: bool = False, **more: Any
) -> AsyncIterator[tuple[RunningTwoProcess, asyncio.Task[None]]]:
    """A station in two processes whose aircraft flies to the east."""
    async with AsyncExitStack() as stack:
        settings = Settings(sim=True, port=0, console_port=0, **more)
        one = await stack.enter_async_context(apart(settings, with_console=with_console))
        client = await stack.enter_async_context(
            connect(f"ws://127.0.0.1:{one.sockets.port('rosbridge')}")
        )
        pilot = Pilot(client)
        await pilot.take_off()
        await until(lambda: task_of(one.agent) is None)
        work = asyncio.create_task(pilot.fly())
        await until(lambda: east(one) == 1.0)
        yield one, work
        work.cancel()
        await asyncio.gather(work, return_exceptions=True)


def east(one: RunningTwoProcess) -> float:
    """Velocity to the east of the last frame that reached the aircraft, m/s."""
    assert one.virtual is not None
    moves = one.virtual.autopilot.received_movements
    return float(moves[-1].pitch_or_y) if moves else 0.0


async def test_fronts_run_lower_and_know_nothing_of_the_app() -> None:
    settings = Settings(sim=True, port=0, app_id=7, key="00" * 32)
    told = json.loads(json.dumps(front_settings(settings)))
    assert not {"key", "key_file", "app_id", "url"} & set(told)
    assert resolve(told, {}).port == 0
    async with apart(settings) as one:
        assert one.front.pid is not None
        ours = os.getpriority(os.PRIO_PROCESS, 0)
        theirs = os.getpriority(os.PRIO_PROCESS, one.front.pid)
        assert theirs == min(ours + 5, 19)


async def test_a_front_that_is_killed_costs_a_hover_and_comes_back() -> None:
    async with flying() as (one, _):
        killed = one.front.pid
        assert killed is not None
        os.kill(killed, signal.SIGKILL)
        await until(lambda: east(one) == 0.0)
        await until(lambda: not one.agent.holding.has_authority)
        assert one.virtual is not None
        assert one.virtual.height > 1.0
        await until(lambda: one.front.pid not in (None, killed))
        async with connect(f"ws://127.0.0.1:{one.sockets.port('rosbridge')}") as client:
            answer = await Pilot(client).call("/dji_sdk/sdk_control_authority", control_enable=1)
            assert answer["values"]["result"] is True
        told = [event.text for event in one.agent.journal.events]
        assert "the fronts ended (SIGKILL), to be started again" in told


async def test_a_front_that_hangs_costs_a_hover() -> None:
    async with flying() as (one, _):
        assert one.front.pid is not None
        os.kill(one.front.pid, signal.SIGSTOP)
        try:
            await until(lambda: east(one) == 0.0)
            await until(lambda: one.agent.leases.holder(one.agent.now) is None)
            await until(lambda: not one.agent.holding.has_authority)
        finally:
            os.kill(one.front.pid, signal.SIGCONT)


async def get(port: int) -> bytes:
    """The console's page, as a browser asks for it."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    host = f"127.0.0.1:{port}"
    writer.write(f"GET / HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n".encode())
    try:
        return await reader.read()
    finally:
        writer.close()


async def test_pages_asked_for_without_pause_do_not_end_a_flight() -> None:
    pytest.importorskip("nicegui")
    async with flying(with_console=True) as (one, work):
        port = one.sockets.port("console")
        assert port is not None
        holder = one.agent.leases.holder(one.agent.now)
        before = one.front.pid
        async with asyncio.timeout(2 * PATIENCE):
            pages = await asyncio.gather(*(get(port) for _ in range(20)))
        assert sum(page.startswith(b"HTTP/1.1 200") for page in pages) >= 1
        assert not work.done()
        assert one.agent.leases.holder(one.agent.now) == holder
        assert one.agent.holding.has_authority
        assert one.front.pid == before
        await until(lambda: east(one) == 1.0)


async def test_the_end_gives_authority_back_before_it_waits_for_a_front_that_hangs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(supervisor, "END_TIMEOUT", 0.5)
    was_running: list[bool] = []
    async with AsyncExitStack() as stack, apart(Settings(sim=True, port=0)) as one:
        address = f"ws://127.0.0.1:{one.sockets.port('rosbridge')}"
        client = await stack.enter_async_context(connect(address, close_timeout=0.1))
        await Pilot(client).take_off()
        await until(lambda: task_of(one.agent) is None)
        assert one.front.pid is not None
        os.kill(one.front.pid, signal.SIGSTOP)
        one.agent.holding.on_change.append(lambda *_: was_running.append(one.front.pid is not None))
    assert was_running, "authority stayed where it was"
    assert was_running[0], "the aircraft flew on while the end waited for the child"


async def test_an_agent_that_is_killed_is_reported_by_its_front_and_its_port_is_free() -> None:
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "m100link", "serve", "--sim", "--port", "0", "--json"),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
    )
    assert process.stdout is not None
    url = json.loads(await process.stdout.readline())["rosbridge"][0]
    async with connect(url) as client:
        pilot = Pilot(client)
        assert (await pilot.call("/dji_sdk/query_drone_version"))["result"] is True
        front = front_of(process)
        process.kill()
        await process.wait()
        answer = await pilot.call("/dji_sdk/query_drone_version")
        assert answer["result"] is False
        assert "the agent that owns the aircraft has gone" in answer["values"]
        port = int(url.rpartition(":")[2])

        async def is_served_anew() -> bool:
            try:
                async with apart(Settings(sim=True, port=port)) as one:
                    return one.sockets.ports("rosbridge") == [port]
            except M100Error:
                return False

        async with asyncio.timeout(PATIENCE):
            while not await is_served_anew():  # noqa: ASYNC110 - another process has no event
                await asyncio.sleep(0.1)
    await until(lambda: not Path(f"/proc/{front}/exe").exists())  # nobody is left to talk to


@pytest.mark.parametrize("with_console", [False, True])
async def test_a_virtual_aircraft_takes_orders_where_there_is_a_console_to_give_them(
    with_console: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    front = MagicMock(request={})
    monkeypatch.setattr(run, "supervised", lambda _: nullcontext())
    settings = Settings(sim=True, port=0, console_port=0)
    sockets = Sockets({"console": []} if with_console else {})
    async with running_apart(settings, (sockets, front)):
        assert list(front.request["orders"]) == (["m100"] if with_console else [])


def files_in(folder: Path) -> list[Path]:
    return sorted(folder.iterdir())


async def test_what_it_is_ordered_to_record_is_recorded_and_reported(tmp_path: Path) -> None:
    settings = Settings(sim=True, port=0, record=tmp_path)
    async with apart(settings) as station:
        connection = station.agent.connection
        await until(lambda: connection.aircraft is not None)
        texts = [event.text for event in station.agent.journal.events]
        await asyncio.sleep(0.5)
    [path] = files_in(tmp_path)
    assert f"recorded into {path}" in texts
    assert read(path).summary().is_whole


async def test_mistakes_in_what_is_served_are_reported_as_ever(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="is not a folder"):
        async with apart(Settings(sim=True, port=0, pages=tmp_path / "none")):
            pass


# -- several aircraft, a process each: what the loss of one costs the others -----------------------


pytest.importorskip("uvicorn")


FIRST, SECOND = "", "/m100_2"


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
async def two() -> AsyncIterator[tuple[RunningMultiVehicle, list[str]]]:
    """A station with two virtual aircraft, and what it tells."""
    told: list[str] = []
    settings = Settings(sim=True, port=0)
    aircraft = {"m100_1": settings, "m100_2": settings}
    async with several(aircraft, tell=lambda name, e: told.append(f"{name}: {e.text}")) as s:
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
        connect(f"ws://127.0.0.1:{station.sockets.port('rosbridge')}") as one,
        connect(f"ws://127.0.0.1:{station.sockets.port('rosbridge')}") as other,
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
        async with connect(f"ws://127.0.0.1:{station.sockets.port('rosbridge')}") as third:
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


async def test_agents_end_in_order_when_their_starter_is_killed(tmp_path: Path) -> None:
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
        async with several({f"a{n}": Settings(sim=True) for n in range(9)}):
            pass


async def test_a_mistake_in_one_of_them_is_reported_as_it_is(tmp_path: Path) -> None:
    wrong = Settings(url="/dev/x", app_id=7, key_file=tmp_path / "none")
    with pytest.raises(UsageError, match="none"):
        async with several({"a": Settings(sim=True, port=0), "b": wrong}):
            pass
