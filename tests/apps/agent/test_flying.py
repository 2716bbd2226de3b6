"""What flies within one control block: setpoints, one task, one program."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable

import anyio
import pytest

from m100link.apps.agent.guided import ChangeHeight
from m100link.apps.agent.lease import Flown
from m100link.errors import (
    BadSetpoint,
    GuardRefused,
    M100Error,
    MissionRunning,
    NoAuthority,
    NotObserved,
    TaskRefused,
)
from m100link.flight.control import Control
from m100link.geodesy import LocalFrame
from m100link.missions.plan import AtEnd, Waypoint, WaypointPlan
from m100link.protocol.commands.control import Task
from m100link.protocol.setpoint import Setpoint
from tests.apps.agent.conftest import Rig

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


async def test_a_program_that_is_over_says_so_and_makes_way(rig: Rig) -> None:
    async def briefly(control: Control, send: Callable[[Setpoint], None]) -> None:
        send(EAST)
        await anyio.sleep(0.1)

    await airborne(rig)
    rig.agent.start_pattern(rig.token, "briefly", briefly)
    await anyio.sleep(0.05)
    assert rig.holding.require().flown is Flown.PROGRAM
    await anyio.sleep(0.1)
    assert rig.holding.pattern is None
    assert [one.text for one in rig.agent.journal.events][-2:] == [
        "briefly begins",
        "briefly is done",
    ]


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


# -- missions -------------------------------------------------------------------------------------


def away(rig: Rig, *north: float, at_end: AtEnd = AtEnd.HOVER) -> WaypointPlan:
    position = rig.agent.connection.require_aircraft().state.position
    assert position is not None
    frame = LocalFrame(position.latitude_deg, position.longitude_deg)
    points = [Waypoint(*frame.to_geodetic(one, 0), height=6) for one in north]
    return WaypointPlan(points, speed=5, at_end=at_end)


def speed(rig: Rig) -> float:
    return float(rig.aircraft.vehicle.flight.dynamics.speed)


@pytest.fixture
async def waypoints() -> AsyncIterator[Rig]:
    """An aircraft in the air, whose firmware flies missions."""
    async with Rig(firmware="3.1").running() as one:
        await airborne(one)
        yield one


async def test_who_waits_for_the_end_of_a_mission_is_told_that_it_was_flown(waypoints: Rig) -> None:
    rig, begun = waypoints, []
    await rig.agent.fly_mission(
        rig.token, away(rig, 10, 20), begun=lambda: begun.append(speed(rig))
    )
    assert begun
    assert rig.aircraft.position[0] == pytest.approx(20, abs=1.0)
    assert not rig.holding.require().mission.is_flying


@pytest.mark.parametrize("how", ["halt", "stop", "mission stop", "pilot", "lease"])
async def test_who_waits_for_the_end_of_a_mission_is_told_what_ended_it(
    waypoints: Rig, how: str
) -> None:
    rig = waypoints
    async with anyio.create_task_group() as group:

        async def wait() -> None:
            with pytest.raises(NotObserved, match="was stopped"):
                await rig.agent.fly_mission(rig.token, away(rig, 60, 80), begun=lambda: None)
            group.cancel_scope.cancel()

        group.start_soon(wait)
        await rig.until(lambda: speed(rig) > 3.0)
        if how == "halt":
            rig.agent.halt("somebody")
        elif how == "stop":
            await rig.agent.stop()
        elif how == "mission stop":
            await rig.agent.order_mission(rig.token, "stop")
        elif how == "pilot":
            rig.aircraft.vehicle.remote.set_mode("P")
        else:
            rig.renewing.cancel()
            rig.agent.desk.release(rig.token, rig.agent.now)
        await anyio.sleep(10.0)
    await anyio.sleep(3.0)
    assert speed(rig) < 0.1


async def test_a_stop_of_a_mission_makes_way_for_what_comes_next(waypoints: Rig) -> None:
    rig = waypoints
    await rig.agent.fly_mission(rig.token, away(rig, 60, 80))
    with pytest.raises(MissionRunning):
        await rig.agent.fly(rig.token, Task.LAND)
    await rig.agent.order_mission(rig.token, "stop")
    await rig.agent.fly(rig.token, Task.LAND)
    assert rig.aircraft.height < 0.1


async def test_a_stop_ends_a_mission_that_has_not_begun(waypoints: Rig) -> None:
    rig = waypoints
    async with anyio.create_task_group() as group:

        async def begin() -> None:
            with pytest.raises(M100Error):
                await rig.agent.fly_mission(rig.token, away(rig, 60, 80))

        group.start_soon(begin)
        await anyio.sleep(0.02)
        assert rig.holding.require().mission.is_flying
        await rig.agent.order_mission(rig.token, "stop")
        assert not rig.holding.require().mission.is_flying
    await anyio.sleep(5.0)
    assert speed(rig) < 0.1


@pytest.mark.parametrize("at_end", [AtEnd.GO_HOME, AtEnd.LAND])
async def test_stop_ends_the_way_to_the_ground_behind_a_mission(
    waypoints: Rig, at_end: AtEnd
) -> None:
    rig = waypoints
    await rig.agent.fly_mission(rig.token, away(rig, 30, 40, at_end=at_end))
    await rig.until(lambda: rig.holding.require().mission.is_landing, within=60.0)
    await anyio.sleep(1.0)
    await rig.agent.stop()
    await anyio.sleep(3.0)
    height = rig.aircraft.height
    await anyio.sleep(10.0)
    assert rig.aircraft.height == pytest.approx(height, abs=0.3)
    assert height > 2.0
    assert speed(rig) < 0.1


async def test_a_guided_flight_begins_is_told_and_ends_for_a_program(rig: Rig) -> None:
    await airborne(rig)
    flying, began = rig.holding.require(), list[str]()
    order = ChangeHeight(20.0)
    flight = rig.agent.background.spawn(flying.guide(order, lambda: began.append("now")), "flight")
    await rig.until(lambda: began == ["now"])
    await anyio.sleep(0.5)
    flown: object = rig.holding.guided_order
    assert flown is order
    assert flying.flown is Flown.GUIDED
    rig.agent.start_pattern(rig.token, "east", go_east)
    await anyio.sleep(0.5)
    assert flight.done()
    assert (rig.holding.guided_order, rig.holding.pattern, east(rig)) == (None, "east", 1.0)
    height = rig.aircraft.height
    await anyio.sleep(2.0)
    assert rig.aircraft.height == pytest.approx(height, abs=0.3)
