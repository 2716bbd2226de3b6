"""The bridge beside the console and a client of rosbridge: one lease, and a STOP for everybody."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.lease import Lease
from m100link.apps.agent.transports import memory_channels
from m100link.apps.mavlink.translator.numbers import MavCommand, MavResult, MissionResult
from m100link.apps.mavlink.translator.vehicle_state import Mode, VehiclePhase
from m100link.protocol.setpoint import Setpoint
from tests.apps.mavlink.conftest import Ground, Rig
from tests.apps.mavlink.test_bridge import send_velocity
from tests.apps.mavlink.translator.test_missions import Exchange, waypoint

pytestmark = pytest.mark.anyio

SPEED = Setpoint.velocity(north=2.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


@pytest.fixture
async def page(rig: Rig) -> AsyncIterator[AgentClient]:
    """The console, as far as the agent sees of it."""
    async with AsyncExitStack() as stack:
        ours, its = memory_channels()
        rig.service.attach(its)
        yield await stack.enter_async_context(AgentClient(ours, "console"))


async def take_over(page: AgentClient) -> Lease:
    offer = await page.ask_take_over("the page")
    return await page.confirm(offer.token)


async def stands(rig: Rig, within: float = 4.0, for_s: float = 20.0) -> None:
    """It comes to rest, and stays there, whatever the others send."""
    await anyio.sleep(within)
    north, east = rig.aircraft.position
    height = rig.height
    for _ in range(round(for_s * 10)):
        await anyio.sleep(0.1)
        now_north, now_east = rig.aircraft.position
        assert math.hypot(now_north - north, now_east - east) < 0.5
        assert abs(rig.height - height) < 0.5
        assert rig.speed < 0.3


async def streams(ground: Ground, seconds: float, **velocity: float) -> None:
    for _ in range(round(seconds * 20)):
        send_velocity(ground, **velocity)
        await anyio.sleep(0.05)


async def test_a_wait_of_a_mission_ends_with_control(
    rig: Rig, ground: Ground, page: AgentClient
) -> None:
    """The rest of it is not flown for a later holder of control."""
    items = [waypoint(10.0, 0.1, param1=20.0), waypoint(60.0, 0.1)]
    assert await Exchange(ground).upload(items) is MissionResult.ACCEPTED
    await ground.fly(5.0)
    assert await ground.set_mode(Mode.MISSION) is MavResult.ACCEPTED
    await rig.until(lambda: rig.aircraft.position[0] > 9.0 and rig.speed < 0.1)
    await anyio.sleep(3.0)
    lease = await take_over(page)
    await page.ask(orders.Obtain(), lease)
    await anyio.sleep(1.0)
    await page.release_lease(lease.token)
    await rig.until(lambda: not page.holder.number)
    await ground.arm()
    assert ground.mode is Mode.HOLD
    await stands(rig, for_s=40.0)


async def test_a_wait_of_a_mission_ends_when_the_pilot_was_there(rig: Rig, ground: Ground) -> None:
    items = [waypoint(10.0, 0.1, param1=20.0), waypoint(60.0, 0.1)]
    assert await Exchange(ground).upload(items) is MissionResult.ACCEPTED
    await ground.fly(5.0)
    assert await ground.set_mode(Mode.MISSION) is MavResult.ACCEPTED
    await rig.until(lambda: rig.aircraft.position[0] > 9.0 and rig.speed < 0.1)
    rig.aircraft.vehicle.remote.set_mode("P")
    await rig.until(lambda: ground.mode is Mode.POSCTL)
    rig.aircraft.vehicle.remote.set_mode("F")
    await rig.until(lambda: ground.mode is Mode.HOLD)
    await stands(rig, for_s=40.0)


async def waiting_in_a_mission(rig: Rig, ground: Ground) -> None:
    items = [waypoint(10.0, 0.1, param1=20.0), waypoint(60.0, 0.1)]
    assert await Exchange(ground).upload(items) is MissionResult.ACCEPTED
    await ground.fly(5.0)
    assert await ground.set_mode(Mode.MISSION) is MavResult.ACCEPTED
    await rig.until(lambda: rig.aircraft.position[0] > 9.0 and rig.speed < 0.1)


@pytest.mark.parametrize("is_stop", [True, False])
async def test_a_hover_by_anybody_in_the_wait_of_a_mission_ends_the_mission(
    rig: Rig, ground: Ground, page: AgentClient, is_stop: bool
) -> None:
    await waiting_in_a_mission(rig, ground)
    if is_stop:
        await page.stop()
    else:
        page.hover("console: hover")
    await stands(rig, for_s=40.0)
    assert ground.mode is Mode.HOLD
    assert ("stop" if is_stop else "console: hover") in ground.texts


@pytest.mark.parametrize("is_stop", [True, False])
async def test_a_hover_by_anybody_during_the_take_off_is_not_climbed_past(
    rig: Rig, ground: Ground, page: AgentClient, is_stop: bool
) -> None:
    await ground.arm()
    altitude = rig.ground_altitude + 20.0
    args = (0, 0, 0, math.nan, math.nan, math.nan, altitude)
    assert await ground.ask(MavCommand.NAV_TAKEOFF, *args) is MavResult.ACCEPTED
    await rig.until(lambda: rig.height > 0.4)
    if is_stop:
        await page.stop()
    else:
        page.hover("console: hover")
    await stands(rig, within=6.0)
    assert rig.height < 2.0


@pytest.mark.parametrize("is_stop", [True, False])
async def test_setpoints_that_go_on_are_not_flown_over_the_page(
    rig: Rig, ground: Ground, page: AgentClient, is_stop: bool
) -> None:
    await ground.fly(5.0)
    send_velocity(ground, vx=3.0)
    assert await ground.set_mode(Mode.OFFBOARD) is MavResult.ACCEPTED
    await streams(ground, 3.0, vx=3.0)
    assert rig.speed > 2.0
    if is_stop:
        await page.stop()
    else:
        page.hover("console: hover")
    async with anyio.create_task_group() as group:
        group.start_soon(lambda: streams(ground, 30.0, vx=3.0))
        await stands(rig)
        assert ground.mode is Mode.HOLD
        # A station that wants to fly on says so.
        assert await ground.set_mode(Mode.OFFBOARD) is MavResult.ACCEPTED
        await rig.until(lambda: rig.speed > 2.0, within=4.0)


async def test_a_station_that_takes_over_is_not_flown_against(
    rig: Rig, ground: Ground, page: AgentClient
) -> None:
    await ground.fly(5.0)
    send_velocity(ground, vx=3.0)
    assert await ground.set_mode(Mode.OFFBOARD) is MavResult.ACCEPTED
    async with anyio.create_task_group() as group:
        group.start_soon(lambda: streams(ground, 40.0, vx=3.0))
        await rig.until(lambda: rig.speed > 2.0)
        lease = await take_over(page)
        await page.ask(orders.Obtain(), lease)
        for _ in range(100):
            await anyio.sleep(0.1)
            page.keep(lease)
        assert rig.speed < 0.1
        assert rig.vehicle.world.phase is VehiclePhase.OTHER
        assert await ground.set_mode(Mode.LAND) is MavResult.TEMPORARILY_REJECTED
        assert await ground.set_mode(Mode.OFFBOARD) is MavResult.TEMPORARILY_REJECTED
        assert (
            await ground.ask(MavCommand.COMPONENT_ARM_DISARM, 1) is MavResult.TEMPORARILY_REJECTED
        )
        assert "the page has control" in ground.texts
        assert ground.armed()
        await page.release_lease(lease.token)
        await stands(rig, for_s=10.0)
    assert await ground.set_mode(Mode.LAND) is MavResult.ACCEPTED
    await rig.until(lambda: not rig.motors_on)


@pytest.mark.parametrize("wanted", ["goto", "mission", "orbit", "rtl", "land"])
async def test_a_flight_that_was_taken_over_does_not_go_on(
    rig: Rig, ground: Ground, page: AgentClient, wanted: str
) -> None:
    items = [waypoint(30.0, 0.1), waypoint(60.0, 0.1), waypoint(90.0, 0.1)]
    assert await Exchange(ground).upload(items) is MissionResult.ACCEPTED
    await ground.fly(8.0)
    if wanted == "mission":
        assert await ground.set_mode(Mode.MISSION) is MavResult.ACCEPTED
    elif wanted in ("rtl", "land"):
        mode = Mode.RTL if wanted == "rtl" else Mode.LAND
        assert await ground.set_mode(mode) is MavResult.ACCEPTED
    elif wanted == "goto":
        args = (-1.0, 1.0, 0.0, math.nan, math.nan, math.nan, rig.ground_altitude + 40.0)
        assert await ground.ask(MavCommand.DO_REPOSITION, *args) is MavResult.ACCEPTED
    else:
        args = (10.0, 3.0, 0.0, math.nan, math.nan, math.nan, math.nan)
        assert await ground.ask(MavCommand.DO_ORBIT, *args) is MavResult.ACCEPTED
    await anyio.sleep(2.0)
    lease = await take_over(page)
    await page.ask(orders.Obtain(), lease)
    if wanted in (
        "rtl",
        "land",
    ):  # what the autopilot flies is on its way down, and stays there
        await page.stop()
        await page.ask(orders.Obtain(), lease)
    for _ in range(60):
        await anyio.sleep(0.1)
        page.keep(lease)
    assert rig.height > 1.0
    await page.release_lease(lease.token)
    await stands(rig)
    await ground.arm()
    await stands(rig)


async def test_a_page_that_is_closed_leaves_a_hover_and_the_ground_station_lands(
    rig: Rig, ground: Ground, page: AgentClient
) -> None:
    await ground.fly(5.0)
    lease = await take_over(page)
    await page.ask(orders.Obtain(), lease)
    for _ in range(40):
        page.steer(lease, SPEED)
        await anyio.sleep(0.05)
    assert rig.speed > 1.0
    page._channel.close("the tab was closed")
    await stands(rig, for_s=5.0)
    assert rig.vehicle.world.phase is VehiclePhase.FREE
    assert await ground.set_mode(Mode.LAND) is MavResult.ACCEPTED
    await rig.until(lambda: not rig.motors_on)


async def test_a_ground_station_that_is_lost_does_not_halt_the_page(
    rig: Rig, ground: Ground, page: AgentClient
) -> None:
    await ground.fly(5.0)
    lease = await take_over(page)
    await page.ask(orders.Obtain(), lease)
    ground.is_silent = True
    for _ in range(200):
        page.steer(lease, SPEED)
        await anyio.sleep(0.05)
    assert rig.speed > 1.5
    assert "disarmed" not in ground.texts


async def test_a_parameter_of_who_flies_is_set_by_nobody_else(rig: Rig, ground: Ground) -> None:
    other = Ground(rig, ("127.0.0.1", 7000), 246)
    other.beat()
    await ground.fly(5.0)
    fields = {"target_system": 1, "target_component": 1, "param_id": "MPC_XY_VEL_MAX"}
    for one, expected in ((other, 5.0), (ground, 2.0)):
        one.send("PARAM_SET", **fields, param_value=2.0, param_type=9)
        await anyio.sleep(0.5)
        assert one.last("PARAM_VALUE")["param_value"] == expected
