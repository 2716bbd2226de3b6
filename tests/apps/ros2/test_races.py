"""Orders that cross each other: whatever wins, nothing flies that somebody ended."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import anyio
import pytest

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.transports import memory_channels
from m100link.apps.ros2.actions import GoalStatus
from tests.apps.ros2.conftest import Program, Rig
from tests.apps.ros2.test_actions import Client

pytestmark = pytest.mark.anyio


@pytest.fixture
def client(rig: Rig) -> Client:
    return Client(rig)


def north(rig: Rig) -> float:
    return float(rig.aircraft.vehicle.flight.dynamics.north)


# -- a goal and its end in one step of the node ---------------------------------------------------


async def test_a_goal_that_is_cancelled_with_it_does_not_fly(rig: Rig, client: Client) -> None:
    await client.call("~/obtain_control")
    goal, cancelled = await asyncio.gather(
        client.send("~/take_off", height=5.0), client.cancel("~/take_off")
    )
    assert goal is not None
    assert cancelled == (0, 1)
    assert (await client.result("~/take_off", goal))[0] is GoalStatus.CANCELED
    await anyio.sleep(5.0)
    assert not rig.motors_on


async def test_a_goal_that_comes_with_a_landing_does_not_fly(rig: Rig, client: Client) -> None:
    await client.up()
    place = client.place(60.0, 0.0)
    goal, landed = await asyncio.gather(
        client.send("~/fly_to", **place, height=4.0, speed=6.0), client.call("~/land")
    )
    assert landed["success"]
    assert goal is None or (await client.result("~/fly_to", goal))[0] is not GoalStatus.SUCCEEDED
    await rig.until(lambda: not rig.motors_on)
    assert abs(north(rig)) < 1.0


# -- a mission that hovers between two legs -------------------------------------------------------


async def _pilot(rig: Rig) -> None:
    rig.aircraft.vehicle.remote.set_mode("P")
    await anyio.sleep(1.0)
    rig.aircraft.vehicle.remote.set_mode("F")
    await anyio.sleep(1.0)


async def _stop(rig: Rig) -> None:
    assert (await Program(rig, 9).call("~/stop"))["success"]


async def _stop_at_the_console(rig: Rig) -> None:
    await rig.agent.stop()


async def _hover_at_the_console(rig: Rig) -> None:
    ours, its = memory_channels()
    rig.service.attach(its)
    async with AgentClient(ours, "the console") as console:
        console.halt("hover, said somebody")
        await anyio.sleep(0.1)


async def _given_back(rig: Rig) -> None:
    assert (await Program(rig, 9).call("~/release_control"))["success"]


@pytest.mark.parametrize(
    "end", [_pilot, _stop, _stop_at_the_console, _hover_at_the_console, _given_back]
)
@pytest.mark.parametrize("obtained", [True, False])
async def test_a_mission_that_waits_is_ended_for_good(
    rig: Rig, client: Client, end: Callable[[Rig], Awaitable[None]], obtained: bool
) -> None:
    await client.up()
    legs = [{**client.place(3.0, 0.0), "height": 3.0, "wait": 60.0}]
    legs += [{**client.place(60.0, 0.0), "height": 3.0, "wait": 0.0}]
    goal = await client.send("~/fly_mission", waypoints=legs, speed=5.0)
    assert goal is not None
    await anyio.sleep(15.0)
    await end(rig)
    assert (await client.result("~/fly_mission", goal))[0] is GoalStatus.CANCELED
    if obtained:
        assert (await client.call("~/obtain_control"))["success"]
    await anyio.sleep(80.0)
    assert north(rig) < 5.0


# -- those who ask for much -----------------------------------------------------------------------


async def test_who_waits_for_results_keeps_nobody_from_stopping_and_landing(
    rig: Rig, client: Client
) -> None:
    await client.up()
    place = client.place(60.0, 0.0)
    goal = await client.send("~/fly_to", **place, height=4.0, speed=2.0)
    assert goal is not None
    asked = {"goal_id": {"uuid": list(goal)}}
    waiting = []
    for number in range(80):
        asking = Program(rig, 100 + number).call(
            client.inner("~/fly_to", "get_result"), "m100_msgs/action/FlyTo_GetResult", **asked
        )
        waiting.append(asyncio.ensure_future(asking))
        if number % 8 == 7:
            await anyio.sleep(0.1)
    assert (await client.cancel("~/fly_to", goal)) == (0, 1)
    assert (await client.call("~/stop"))["success"]
    assert (await client.call("~/land"))["success"]
    answers = await asyncio.gather(*waiting)
    assert {one.get("status") for one in answers} == {GoalStatus.CANCELED, None}


async def test_who_asks_for_very_many_parameters_has_no_answer(rig: Rig, program: Program) -> None:
    for name in ("get_parameters", "describe_parameters", "get_parameter_types"):
        kind = "rcl_interfaces/srv/" + "".join(one.capitalize() for one in name.split("_"))
        for many in (65, 4000, 60000):
            assert await program.call(f"~/{name}", kind, names=["x"] * many) == {"success": None}
        assert len(await program.call(f"~/{name}", kind, names=["x"] * 64)) == 1
    assert rig.node.ends.junk == 9


# -- stop -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("stop", [_stop, _stop_at_the_console])
async def test_who_sends_speeds_during_a_goal_does_not_fly_after_stop(
    rig: Rig, client: Client, stop: Callable[[Rig], Awaitable[None]]
) -> None:
    await client.up()
    assert await client.send("~/fly_to", **client.place(60.0, 0.0), height=4.0, speed=3.0)
    program = Program(rig, 9)
    await program.fly(3.0, 2.0)
    await stop(rig)
    await program.fly(2.0, 2.0)  # brakes
    for _ in range(100):
        await program.fly(0.05, 2.0)
        assert rig.speed < 0.3


async def test_a_cancel_after_stop_lets_nobody_fly_on(rig: Rig, client: Client) -> None:
    await client.up()
    assert await client.send("~/fly_to", **client.place(60.0, 0.0), height=4.0, speed=3.0)
    program = Program(rig, 9)
    await program.fly(3.0, 2.0)
    stopped = asyncio.ensure_future(rig.agent.stop())
    await client.cancel("~/fly_to")
    await stopped
    await program.fly(2.0, 2.0)  # brakes
    for _ in range(100):
        await program.fly(0.05, 2.0)
        assert rig.speed < 0.3
