"""What flies within one control block: setpoints, one task, one program."""

from __future__ import annotations

from collections.abc import Callable

import anyio
import pytest

from m100link.errors import BadSetpoint, GuardRefused, NoAuthority, TaskRefused
from m100link.flight.control import Control
from m100link.protocol.commands.control import Task
from m100link.protocol.setpoint import Setpoint
from tests.agent.conftest import Rig

pytestmark = pytest.mark.anyio

NORTH = Setpoint.velocity(north=1.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)
EAST = Setpoint.velocity(north=0.0, east=1.0, up=0.0, yaw_rate_deg_s=0.0)


async def go_east(control: Control, send: Callable[[Setpoint], None]) -> None:
    async for _ in control.ticks():
        send(EAST)


async def airborne(rig: Rig) -> None:
    await rig.agent.obtain(rig.token)
    await rig.agent.fly(rig.token, Task.TAKE_OFF)


def east(rig: Rig) -> float:
    return float(list(rig.aircraft.autopilot.received_movements)[-1].pitch_or_y)


async def test_a_stick_ends_a_program_and_letting_go_of_it_does_not(rig: Rig) -> None:
    await airborne(rig)
    rig.agent.start_pattern(rig.token, "east", go_east)
    await anyio.sleep(0.5)
    assert (rig.holding.pattern, east(rig)) == ("east", 1.0)
    rig.agent.steer(rig.token, NORTH.neutral())
    await anyio.sleep(0.1)
    assert (rig.holding.pattern, east(rig)) == ("east", 1.0)
    rig.agent.steer(rig.token, NORTH)
    await anyio.sleep(0.05)
    assert (rig.holding.pattern, east(rig)) == (None, 0.0)


async def test_one_program_ends_another(rig: Rig) -> None:
    await airborne(rig)
    rig.agent.start_pattern(rig.token, "first", go_east)
    rig.agent.start_pattern(rig.token, "second", go_east)
    await anyio.sleep(0.1)
    assert rig.holding.pattern == "second"
    told = [event.text for event in rig.agent.journal.events]
    assert "first ended: another one begins" in told


async def test_a_program_whose_setpoint_is_refused_ends_with_the_reason(rig: Rig) -> None:
    async def too_high(control: Control, send: Callable[[Setpoint], None]) -> None:
        async for _ in control.ticks():
            send(Setpoint.tilt(roll_deg=0, pitch_deg=0, height=500, yaw_rate_deg_s=0))

    await airborne(rig)
    rig.agent.start_pattern(rig.token, "too high", too_high)
    await anyio.sleep(0.5)
    assert rig.holding.pattern is None
    ends = [one.text for one in rig.agent.journal.events if one.text.startswith("too high ended")]
    assert len(ends) == 1
    assert "500" in ends[0]


async def test_a_refused_setpoint_stops_what_flew_before(rig: Rig) -> None:
    await airborne(rig)
    rig.agent.steer(rig.token, EAST, 1.0)
    await anyio.sleep(0.1)
    assert east(rig) == 1.0
    with pytest.raises((GuardRefused, BadSetpoint)):
        rig.agent.steer(
            rig.token, Setpoint.tilt(roll_deg=0, pitch_deg=0, height=500, yaw_rate_deg_s=0)
        )
    await anyio.sleep(0.05)
    assert east(rig) == 0.0


async def test_one_task_at_a_time(rig: Rig) -> None:
    await rig.agent.obtain(rig.token)
    async with anyio.create_task_group() as group:
        group.start_soon(rig.agent.fly, rig.token, Task.TAKE_OFF)
        await anyio.sleep(0.5)
        with pytest.raises(TaskRefused, match="land was asked for during take off"):
            await rig.agent.fly(rig.token, Task.LAND)


async def test_a_block_that_ends_ends_what_used_it(rig: Rig) -> None:
    await airborne(rig)
    flying = rig.holding.require()
    rig.agent.start_pattern(rig.token, "east", go_east)
    await anyio.sleep(0.1)
    await rig.agent.release(rig.token)
    assert flying.pattern is None
    assert not flying.has_authority
    with pytest.raises(NoAuthority):
        flying.steer(NORTH)
    await anyio.sleep(0.5)
    assert east(rig) == 0.0
