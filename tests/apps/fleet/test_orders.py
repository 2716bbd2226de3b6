"""A landing that needs no lease: whatever flies, the aircraft comes down."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from dataclasses import replace
from random import Random
from typing import Any

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.control_session import ControlSession
from m100link.apps.agent.lease import Flown
from m100link.apps.agent.messages import MessageError, State
from m100link.apps.agent.transports import memory_channels
from m100link.apps.fleet.client import Fleet, FleetAircraft
from m100link.apps.fleet.order_log import MemoryOrderLog
from m100link.apps.fleet.payloads import Outcome
from m100link.errors import GuardRefused, M100Error, StaleLease, TaskRefused, UsageError
from tests.apps.agent.conftest import hears_late, task_of
from tests.apps.fleet.conftest import OnBoard, Rig

pytestmark = pytest.mark.anyio


async def take_off(pilot: Fleet, outcomes: list[Outcome]) -> None:
    results = await pilot.each(FleetAircraft.take_off, ["a1"])
    outcomes.append(results["a1"].outcome)


@pytest.mark.parametrize("after", [0.0, 0.02, 0.1, 0.3, 0.6, 1.0, 1.5, 2.0, 3.0])
async def test_an_aircraft_that_takes_off_is_landed(rig: Rig, after: float) -> None:
    """As the order is heard, as the motors start, and in the climb."""
    one, pilot, other = await rig.aircraft("a1"), await rig.pilot(), await rig.pilot("other")
    await one.agent.ask(orders.Activate())
    await anyio.sleep(1.0)
    outcomes: list[Outcome] = []
    async with anyio.create_task_group() as group:
        group.start_soon(take_off, pilot, outcomes)
        await rig.until(lambda: one.client.holder.number)
        await anyio.sleep(after)
        assert (await other.land())["a1"].outcome is Outcome.OK
    assert Outcome.OK not in outcomes
    for _ in range(100):
        await anyio.sleep(0.1)
        assert one.height < 0.1, "it stays where it is wanted"


@pytest.mark.parametrize("after", [0.0, 0.001, 0.05, 0.3, 0.6, 1.0])
async def test_a_landing_is_true_of_an_aircraft_with_which_a_console_begins_to_take_off(
    rig: Rig, after: float
) -> None:
    """It stands, and the console has control: it asks for a take-off in the same moment."""
    one, other = await rig.aircraft("a1"), await rig.pilot("other")
    ours, its = memory_channels(as_bytes=True)
    one.service.attach(its)
    async with AgentClient(ours, "console") as console:
        session = ControlSession(console, "page")
        await session.obtain()

        async def take_off() -> None:
            await anyio.sleep(0.3)
            with suppress(M100Error):
                await session.ask(orders.TakeOff())

        async with session.kept(), anyio.create_task_group() as group:
            group.start_soon(take_off)
            await anyio.sleep(after)
            assert (await other.land())["a1"].outcome is Outcome.OK
        assert not session.has_lease
    for _ in range(50):
        await anyio.sleep(0.1)
        assert one.height < 0.1, "it stays where it is wanted"


async def test_a_landing_from_before_a_stop_is_not_begun(rig: Rig) -> None:
    one, pilot, other = await rig.aircraft("a1"), await rig.pilot(), await rig.pilot("other")
    await pilot["a1"].take_off()
    asker = other.asker("a1")
    await asker.ask(orders.AskVersion())  # its clock is known now
    clock = asker.its_clock.at_least(one.client.now)
    await anyio.sleep(0.5)
    await one.agent.stop()
    with pytest.raises(GuardRefused, match="STOP was pressed after land was asked for"):
        await asker.ask(orders.Land(), clock=clock)
    await anyio.sleep(3.0)
    assert one.height > 1.0
    assert (await other.land())["a1"].is_ok
    assert one.height < 0.1


async def test_an_aircraft_that_lands_already_is_left_to_land(rig: Rig) -> None:
    one, pilot, other = await rig.aircraft("a1"), await rig.pilot(), await rig.pilot("other")

    async def fly() -> None:
        with pytest.raises(M100Error):  # its lease is taken over
            async with pilot["a1"].control() as control:
                await control.take_off()
                await control.land()

    async with anyio.create_task_group() as group:
        group.start_soon(fly)
        await rig.until(lambda: one.client.state.task == "land")
        assert (await other.land())["a1"].outcome is Outcome.OK
        assert one.height < 0.1


async def going_home(rig: Rig, one: OnBoard, pilot: Fleet) -> None:
    with pytest.raises(M100Error):
        async with pilot["a1"].control() as control:
            await control.take_off()
            await control.go_home()


async def test_an_aircraft_that_flies_home_is_landed_where_it_is(rig: Rig) -> None:
    one, pilot, other = await rig.aircraft("a1"), await rig.pilot(), await rig.pilot("other")
    async with anyio.create_task_group() as group:
        group.start_soon(going_home, rig, one, pilot)
        await rig.until(lambda: one.client.state.task == "go home")
        await anyio.sleep(1.0)
        assert (await other.land())["a1"].outcome is Outcome.OK
    assert one.height < 0.1
    assert any("land is done" in event.text for event in one.client.events)


class FullDisk(MemoryOrderLog):
    """It fails or hangs from a chosen time on."""

    is_full = hangs = False

    async def granted(self, fence: int) -> None:
        if self.hangs:
            await anyio.sleep_forever()
        if self.is_full:
            raise UsageError("no space is left")


@pytest.mark.parametrize("how", ["is_full", "hangs"])
async def test_a_landing_waits_for_no_disk(rig: Rig, how: str) -> None:
    order_log = FullDisk()
    one, pilot = await rig.aircraft("a1", order_log=order_log), await rig.pilot()
    async with pilot["a1"].control() as control:
        await control.take_off()
    setattr(order_log, how, True)
    assert (await (await rig.pilot("other")).land())["a1"].outcome is Outcome.OK
    assert one.height < 0.1
    assert one.client.holder.number == 0


async def test_a_landing_that_was_taken_over_is_not_taken_up_again(rig: Rig) -> None:
    """The pilot who takes over, and gives back, wants it in the air."""
    one, pilot, other = await rig.aircraft("a1"), await rig.pilot(), await rig.pilot("other")
    async with pilot["a1"].control() as control:
        await control.take_off()
    one.client.state = replace(one.client.state, task=Flown.LAND.value)
    telling = one.client._handlers[State]
    one.client._handlers[State] = lambda told: telling(replace(told, task=Flown.LAND.value))
    landing = one.agent.background.spawn(other["a1"].land(), "land")
    await rig.until(lambda: one.client.holder.number)
    async with pilot["a1"].control(take_over=True):
        await anyio.sleep(0.5)
    await anyio.sleep(0.5)
    one.client._handlers[State] = telling
    with pytest.raises(StaleLease):
        await landing
    await anyio.sleep(3.0)
    assert one.height > 1.0
    assert one.client.holder.number == 0


async def test_whenever_a_landing_is_ended_nobody_has_control_then(rig: Rig) -> None:
    """As by the revocation of who asked, or a take-over, at drawn moments."""
    seed = 31
    draw, one, pilot = Random(seed), await rig.aircraft("a1"), await rig.pilot()
    async with pilot["a1"].control() as control:
        await control.take_off()
    ours = one.fleet_agent._orders
    for attempt in range(12):
        landing = asyncio.create_task(ours.descend(orders.Land(), "landing for somebody"))
        for _ in range(draw.randrange(1, 40)):
            await asyncio.sleep(draw.choice([0.0, 0.0, 0.02]))
        assert ours._descent is not None
        if draw.random() < 0.5 or not one.client.holder.number:
            ours._descent.cancel()
        else:
            offer = await one.client.ask_take_over("somebody else")
            one.client.let_go(await one.client.confirm(offer.token))
        await asyncio.gather(landing, return_exceptions=True)
        await anyio.sleep(0.5)
        assert one.client.holder.number == 0, (seed, attempt)
        assert not one.client.state.has_authority, (seed, attempt)
        assert one.speed < 1.0, "it stands, or it lands by itself"
        if one.height < 0.8:
            assert (await pilot.land())["a1"].is_ok
            await pilot["a1"].take_off()


class BorrowLease(orders.LeaseOrder, is_kind=False):
    """An order about the lease that no fleet knows."""

    token: str = ""


async def test_an_order_about_the_lease_that_a_fleet_does_not_know_reaches_no_agent(
    rig: Rig,
) -> None:
    one, pilot = await rig.aircraft("a1"), await rig.pilot()
    async with pilot["a1"].control() as control:
        asked = BorrowLease("anything")
        order = pilot.asker("a1").around(orders.AskVersion(), *control.proof)
        with pytest.raises(MessageError, match="a fleet has no order borrow lease"):
            await one.fleet_agent._orders.carry_out(order, asked)


@pytest.mark.parametrize("late", [0.0, 0.3])
async def test_a_stop_ends_the_way_home_that_is_asked_for_again_and_again(
    rig: Rig, late: float
) -> None:
    """Nobody has control; the aircraft refuses it for a while, as after a task that was ended."""
    one, pilot = await rig.aircraft("a1"), await rig.pilot()
    async with pilot["a1"].control() as control:
        await control.take_off()
    asked, refused = one.client.ask, False

    async def ask(order: orders.Order, *given: Any, **more: Any) -> Any:
        nonlocal refused
        if isinstance(order, orders.GoHome) and not refused:
            refused = True
            raise TaskRefused("a task ends")
        return await asked(order, *given, **more)

    one.client.ask = ask  # type: ignore[method-assign]  # for this test
    hears_late(one.channels[1], late)
    before = one.height
    descent = one.client.background.spawn(
        one.fleet_agent._orders.descend(orders.GoHome(), "operator lost"), "way home"
    )
    await rig.until(lambda: refused)
    await one.agent.stop()
    with pytest.raises(GuardRefused, match="STOP was pressed after"):
        await descent
    await anyio.sleep(4.0)
    assert one.height == pytest.approx(before, abs=0.5)


@pytest.mark.parametrize("after", [0.01, 0.05])
async def test_a_stop_beside_the_one_that_ends_a_task_ends_the_way_home(
    rig: Rig, after: float
) -> None:
    """The aircraft's own STOP, which makes room for the way home, is not taken for a person's."""
    one = await rig.aircraft("a1")
    await one.agent.ask(orders.Activate())
    token = one.agent.leases.acquire("somebody", one.agent.now).token
    await one.agent.ask(orders.Obtain(), token)
    one.client.background.spawn(one.agent.ask(orders.TakeOff(), token), "take-off")
    await rig.until(lambda: one.height > 0.3)
    one.agent.leases.renew(token, one.agent.now)
    stopped: list[float] = []
    stop = one.agent.stop

    async def noted() -> None:
        stopped.append(one.agent.now)
        await anyio.sleep(0.1)  # authority takes a while to go back
        await stop()

    one.agent.stop = noted  # type: ignore[method-assign]  # for this test
    descent = one.client.background.spawn(
        one.fleet_agent._orders.descend(orders.GoHome(), "operator lost"), "way home"
    )
    await rig.until(lambda: bool(stopped))
    await anyio.sleep(after)
    await stop()
    with pytest.raises(GuardRefused, match="STOP was pressed after"):
        await descent
    assert task_of(one.agent) is None


async def test_the_secret_of_a_lease_that_is_over_is_forgotten(rig: Rig) -> None:
    one, pilot = await rig.aircraft("a1"), await rig.pilot()
    service = one.fleet_agent._orders
    async with pilot["a1"].control():
        number = one.client.holder.number
        assert service.leases.keys() == {number}
        assert service.secret(number)
    await rig.until(lambda: one.client.holder.number == 0)
    assert (service.leases, service.secret(number)) == ({}, None)
    async with pilot["a1"].control():
        assert service.leases.keys() == {number + 1}
