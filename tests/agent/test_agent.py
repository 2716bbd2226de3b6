"""The agent as its clients use it: a lease for everything that moves."""

from __future__ import annotations

import anyio
import pytest

from m100link.agent.connection import ConnectionState
from m100link.agent.lease import LeaseRefused
from m100link.errors import M100Error, NoAuthority
from m100link.protocol.commands.control import Task
from m100link.protocol.setpoint import Setpoint
from tests.agent.conftest import Rig

pytestmark = pytest.mark.anyio

NORTH = Setpoint.velocity(north=1.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


async def airborne(rig: Rig) -> None:
    await rig.agent.obtain(rig.token)
    await rig.agent.fly(rig.token, Task.TAKE_OFF)


async def test_a_take_off_tells_when_it_is_accepted(rig: Rig) -> None:
    await rig.agent.obtain(rig.token)
    begun = anyio.Event()
    async with anyio.create_task_group() as group:
        group.start_soon(rig.agent.fly, rig.token, Task.TAKE_OFF, begun.set)
        await begun.wait()
        assert rig.holding.task == "take off"
        assert rig.aircraft.height < 1.0
    assert rig.holding.task is None
    assert rig.aircraft.height > 1.0


async def test_a_setpoint_expires_and_a_halt_stops_at_once(rig: Rig) -> None:
    await airborne(rig)
    moves = rig.aircraft.autopilot.received_movements
    rig.agent.steer(rig.token, NORTH)
    await anyio.sleep(0.1)
    assert list(moves)[-1].roll_or_x == 1.0
    rig.agent.halt()
    await anyio.sleep(0.03)
    assert list(moves)[-1].roll_or_x == 0.0
    rig.agent.steer(rig.token, NORTH)
    await anyio.sleep(0.3)
    assert list(moves)[-1].roll_or_x == 0.0


@pytest.mark.parametrize("token", ["", "wrong"])
async def test_without_the_lease_nothing_moves(rig: Rig, token: str) -> None:
    await airborne(rig)
    with pytest.raises(LeaseRefused):
        rig.agent.steer(token, NORTH)
    for work in (
        rig.agent.obtain(token),
        rig.agent.release(token),
        rig.agent.fly(token, Task.LAND),
        rig.agent.send_to_mobile(token, b"x"),
        rig.agent.activate(token),
    ):
        with pytest.raises(LeaseRefused):
            await work
    await anyio.sleep(0.1)
    assert list(rig.aircraft.autopilot.received_movements) == []
    assert rig.holding.has_authority


async def test_without_authority_nothing_moves(rig: Rig) -> None:
    with pytest.raises(NoAuthority):
        rig.agent.steer(rig.token, NORTH)
    with pytest.raises(NoAuthority):
        await rig.agent.fly(rig.token, Task.TAKE_OFF)


async def test_a_stop_during_a_task_gives_authority_back(rig: Rig) -> None:
    await rig.agent.obtain(rig.token)
    async with anyio.create_task_group() as group:

        async def take_off() -> None:
            with pytest.raises(NoAuthority, match="control ended"):
                await rig.agent.fly(rig.token, Task.TAKE_OFF)

        group.start_soon(take_off)
        await anyio.sleep(2.0)
        await rig.agent.stop()
    assert not rig.holding.has_authority


async def test_the_end_of_a_lease_stops_the_motion_and_gives_authority_back(rig: Rig) -> None:
    await airborne(rig)
    rig.agent.steer(rig.token, NORTH, 1.0)
    await anyio.sleep(0.5)
    rig.agent.desk.release(rig.token, rig.agent.now)
    await anyio.sleep(0.03)
    assert list(rig.aircraft.autopilot.received_movements)[-1].roll_or_x == 0.0
    await rig.until(lambda: not rig.aircraft.vehicle.authority.is_requested, within=2.0)
    assert not rig.holding.has_authority


async def test_a_lost_line_is_opened_again_and_the_key_stays_in_use(rig: Rig) -> None:
    connection = rig.agent.connection
    rig.aircraft.unplug()
    await rig.until(lambda: connection.state is not ConnectionState.CONNECTED)
    assert connection.error is not None
    rig.aircraft.replug()
    await rig.until(lambda: connection.state is ConnectionState.CONNECTED)
    await rig.agent.obtain(rig.token)
    assert rig.holding.has_authority


async def test_an_aircraft_that_is_not_there_is_told_once(rig: Rig) -> None:
    rig.aircraft.unplug()
    await anyio.sleep(10.0)
    told = [event.text for event in rig.agent.journal.events if "not connected" in event.text]
    assert len(told) == 1
    with pytest.raises(M100Error):
        await rig.agent.version()
