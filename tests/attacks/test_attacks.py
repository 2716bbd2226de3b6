"""While strangers do their worst, the operator flies on, and a welcome client gets in."""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
from collections.abc import AsyncIterator
from typing import Any

import pytest

pytest.importorskip("uvicorn")
pytest.importorskip("starlette")
from websockets.asyncio.client import ClientConnection
from websockets.exceptions import WebSocketException

from m100link.apps.station.run import RunningStation
from tests.apps.station.web.test_server import (
    address,
    opened,
    publish,
    receive,
    send,
    station,
    until,
)
from tests.attacks import gaps, stops
from tests.attacks.gaps import measure, table
from tests.attacks.losses import LOSSES, lose_at_random
from tests.sockets import connect
from tests.waiting import PATIENCE, kept_waiting

pytestmark = [pytest.mark.anyio]

SECONDS = 3.0
ATTACKS = [name for name in gaps.ATTACKS if name != "pages"]  # there is no console here


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"  # real time: the attackers are processes of their own


@contextlib.asynccontextmanager
async def flying(**options: Any) -> AsyncIterator[tuple[RunningStation, ClientConnection]]:
    """A station whose aircraft is in the air, and the client that flies it."""
    async with station(**options) as one, connect(address(one)) as pilot:
        await opened(one, pilot)
        await publish(pilot, "/sdk_request_cmd", "std_msgs/Float32", data=4)
        await until(lambda: bool(one.bridge.agent.state.task))
        await until(lambda: not one.bridge.agent.state.task)
        topic = {"topic": "/sdk_request_ctrl", "type": "geometry_msgs/Quaternion"}
        await send(pilot, "advertise", **topic)
        yield one, pilot


async def fly(
    one: RunningStation, pilot: ClientConnection, attacker: asyncio.subprocess.Process
) -> float:
    """Hold a key until the attack has ended; returns the longest time without a movement frame.

    The attackers take the processor, and so may others: time for which we were ready to run does
    not count.
    """
    assert one.virtual is not None
    loop, counters = asyncio.get_running_loop(), one.virtual.autopilot.counters

    def now() -> float:
        return loop.time() - kept_waiting()

    longest, moved_at, count = 0.0, now(), counters.movements
    key = json.dumps({"op": "publish", "topic": "/sdk_request_ctrl", "msg": {"z": 1.0}})
    next_key = loop.time()
    while attacker.returncode is None:
        if loop.time() >= next_key:
            next_key += 0.033
            await pilot.send(key)
        await asyncio.sleep(0.002)
        if counters.movements != count:
            count = counters.movements
            longest, moved_at = max(longest, now() - moved_at), now()
        assert now() - moved_at < 2.0, "no movement frame for two seconds"
    return longest


async def test_the_pilot_flies_on_through_every_attack() -> None:
    async with flying() as (one, pilot):
        notes = one.agent.journal.events
        holder = one.agent.leases.holder(one.agent.now)
        for name in ATTACKS:
            before = notes[-1].number
            attacker = await asyncio.create_subprocess_exec(
                *(
                    sys.executable,
                    "-m",
                    f"tests.attacks.{name}",
                    str(one.sockets.port("rosbridge")),
                ),
                *("--seconds", str(SECONDS)),
            )
            gap = await fly(one, pilot, attacker)
            assert attacker.returncode == 0, name
            print(f"{name}: longest gap between movement frames {1000 * gap:.0f} ms")  # noqa: T201
            assert one.bridge.agent.state.has_authority, name
            assert one.agent.leases.holder(one.agent.now) == holder, name
            # What happened before can still be read.
            assert notes[-1].number - before < 60, name
            # A setpoint lasts 0.7 s at most.
            assert gap < 0.5, name


@pytest.mark.pty  # two processes and six attackers keep real time
async def test_in_two_processes_the_pilot_keeps_control_through_every_attack() -> None:
    """The times are measured by ``python -m tests.attacks.gaps``; here it is who has control."""
    pytest.importorskip("nicegui")
    rows = await measure(gaps.ATTACKS, seconds=1.0, rounds=1)
    assert [name for name, _, _ in rows] == list(gaps.ATTACKS)
    for name, attacked, alone in rows:
        assert attacked.is_in_control, name
        assert alone.is_in_control, name
    # Of one second nothing may be left on a machine that others use; of twelve there is.
    assert sum(len(alone.gaps) for _, _, alone in rows) > 10
    lines = table(rows).splitlines()
    assert len(lines) == 1 + 2 * len(rows)
    assert not any("LOST" in line for line in lines)


async def gets_in(one: RunningStation) -> bool:
    try:
        async with connect(address(one)) as client:
            await send(client, "subscribe", topic="/flight_status")
            return bool((await receive(client))["op"] == "publish")
    except (OSError, WebSocketException):
        return False


@pytest.mark.parametrize("name", ["half_open", "idle_sockets"])
async def test_a_welcome_client_gets_in(name: str) -> None:
    async with station(max_clients=8) as one:
        attacker = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", f"tests.attacks.{name}", str(one.sockets.port("rosbridge"))),
            *("--seconds", str(PATIENCE)),
        )
        try:
            await asyncio.sleep(3.0)
            async with asyncio.timeout(PATIENCE / 2):
                while not await gets_in(one):  # noqa: ASYNC110 - it tries again
                    await asyncio.sleep(0.1)
        finally:
            attacker.terminate()
            await attacker.wait()


async def test_an_operator_takes_over_from_anybody_while_a_spammer_asks() -> None:
    async with flying() as (one, _):
        attacker = await asyncio.create_subprocess_exec(
            *(
                sys.executable,
                "-m",
                "tests.attacks.orders",
                str(one.sockets.port("rosbridge")),
                "--seconds",
                "20",
            )
        )
        try:
            await asyncio.sleep(2.0)
            async with connect(address(one)) as operator:
                token = ""
                for action in ("take_over", "confirm"):
                    args = {"action": action, "name": "operator", "token": token}
                    await send(operator, "call_service", service="/m100link/lease", args=args)
                    answer = await receive(operator)
                    assert answer["values"]["success"], answer
                    token = answer["values"]["token"]
                    await asyncio.sleep(1.0)  # the operator reads who would lose control
                await send(operator, "call_service", service="/m100link/lease", args=["status"])
                assert (await receive(operator))["values"]["holder"] == "operator"
        finally:
            attacker.terminate()
            await attacker.wait()


@pytest.mark.pty
async def test_a_lost_client_costs_a_hover_and_the_next_flies_on() -> None:
    """One of each; ``python -m tests.attacks.losses`` has as many as are wanted."""
    found = await lose_at_random(LOSSES, times=1, seed=1)
    assert [name for name, _ in found] == [f"{which} {how.name}" for which, how in LOSSES]


@pytest.mark.pty
async def test_sixteen_who_send_whatever_is_dear_hold_up_neither_stop_nor_keys() -> None:
    """A slice; ``python -m tests.attacks.stops --seconds 60`` has as much as is wanted.

    Judged is what the station did: others' time on the processor does not count.
    """
    pytest.importorskip("nicegui")
    attacked, alone = await stops.measure(seconds=6.0, seed=1)
    print(stops.told("attacked", attacked))  # noqa: T201
    print(stops.told("left alone", alone))  # noqa: T201
    for seen in (attacked, alone):
        assert seen.keys.is_in_control
        assert seen.times
        assert max(seen.own) < 0.3
        assert max(seen.keys.own) < 0.1
        assert max(seen.keys.unflown) < 0.1
