"""A landing that needs no lease: whatever flies, the aircraft comes down."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from dataclasses import replace
from random import Random
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import AsyncMock, MagicMock

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.background import TaskSet
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.control_session import ControlSession
from m100link.apps.agent.lease import Flown, Lease
from m100link.apps.agent.messages import LeaseChanged, MessageError, State
from m100link.apps.agent.transports import memory_channels
from m100link.apps.fleet.client import Fleet, FleetAircraft
from m100link.apps.fleet.identity import nobody
from m100link.apps.fleet.order_log import MemoryOrderLog
from m100link.apps.fleet.orders import Granted, OrderService
from m100link.apps.fleet.payloads import Half, OrderMessage, Outcome
from m100link.errors import (
    GuardRefused,
    M100Error,
    NotAllowed,
    StaleLease,
    TaskRefused,
    UsageError,
)
from m100link.protocol.commands.gimbal import GimbalAngle
from tests.apps.agent.conftest import hears_late, task_of
from tests.apps.fleet.conftest import SITE, OnBoard, Rig

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


# -- who may what, by a client that is given -------------------------------------------------------


class Given:
    """A client that does what it is asked, and keeps it; nobody has the lease."""

    def __init__(self) -> None:
        self.holder = LeaseChanged(0, "")
        self.state = SimpleNamespace(is_activated=False, task="", mission="no mission")
        self.view = SimpleNamespace(is_on_ground=False)
        self.stopped_at = 50.0
        self.now = 60.0
        self.on_lease: list[Any] = []
        self.on_mission_report: list[Any] = []
        self.hovers: list[tuple[Any, ...]] = []
        self.asked: list[tuple[orders.Order, Lease | None, float | None]] = []
        self.let_gone: list[Lease] = []
        self.background = TaskSet()

    def hover(self, why: str, lease: Lease | None, *, begins_anew: bool, at: float) -> None:
        self.hovers.append((why, lease, begins_anew, at))

    async def ask(
        self, order: orders.Order, lease: Lease | None = None, asked_at: float | None = None
    ) -> Any:
        self.asked.append((order, lease, asked_at))
        return SimpleNamespace(text="text", number=4)

    async def acquire(self, name: str, at: float | None) -> Lease:
        self.asked.append((orders.AcquireLease(name), None, at))
        self.holder = LeaseChanged(8, name)
        return Lease(name, "its token", 8)

    def let_go(self, lease: Lease) -> None:
        self.let_gone.append(lease)


HELD = Lease("anna", "of the agent", 7)


def given(revoked: Any = nobody) -> tuple[Given, OrderService]:
    """The agent's token of lease 7 never leaves; orders under it are proved by its secret."""
    client = Given()
    service = OrderService(cast(Any, client), MemoryOrderLog(), revoked)
    client.holder = LeaseChanged(7, "anna")
    service.leases[7] = Granted(HELD, "secret", "anna")
    return client, service


def message(asked: orders.Order, fence: int = 7, secret: str = "secret") -> Any:
    head = ("0b" * 16, SITE, "a1", "bert", fence, 0.0, asked)
    return OrderMessage(*head, clock=55.0, signer="anna").under(secret)


@pytest.mark.parametrize(
    ("fence", "secret", "lease"),
    [(7, "secret", HELD), (7, "another", None), (6, "secret", None), (0, "secret", None)],
)
async def test_an_order_is_given_under_the_lease_that_it_proves(
    fence: int, secret: str, lease: Lease | None
) -> None:
    client, service = given()
    asked = message(orders.TakeOff(), fence, secret)
    if lease is None:
        with pytest.raises(StaleLease, match=f"lease {fence} is not in force; anna has control"):
            await service.carry_out(asked, asked.order)
        assert not client.asked
    else:
        assert await service.carry_out(asked, asked.order) == {"text": "text", "number": 4}
        assert client.asked == [(orders.TakeOff(), HELD, 55.0)]
    client.holder = LeaseChanged(9, "carl")
    with pytest.raises(StaleLease, match="carl has control"):
        await service.carry_out(asked, asked.order)


@pytest.mark.parametrize(
    ("asked", "clock", "secret", "expected"),
    [
        (orders.Halt("why", True), 55.0, "secret", ("why", HELD, True, 55.0)),
        (orders.Halt("why", True), 50.0, "secret", ("why", HELD, False, 50.0)),  # before the STOP
        (orders.Halt("why", False), 55.0, "secret", ("why", HELD, False, 55.0)),
        (orders.Halt("", True), 55.0, "another", ("bert: hover", None, True, 55.0)),
    ],
)
async def test_a_hover_is_done_for_anybody_and_begins_anew_for_who_is_later_than_a_stop(
    asked: orders.Halt, clock: float, secret: str, expected: tuple[Any, ...]
) -> None:
    client, service = given()
    order = replace(message(asked), clock=clock).under(secret)
    assert await service.carry_out(order, asked) == {}
    assert client.hovers == [expected]


@pytest.mark.parametrize(
    ("asked", "fence", "holder", "is_let", "lease"),
    [
        (orders.AskVersion(), 0, 7, True, None),  # nothing is needed
        (orders.Activate(), 0, 0, True, None),  # nobody has the lease
        (orders.Activate(), 0, 7, False, None),
        (orders.Activate(), 7, 7, True, HELD),
        (orders.PointGimbal(GimbalAngle(0.0, 0.0, 0.0)), 0, 0, False, None),
        (orders.TakeOff(), 0, 0, False, None),
        (orders.StopMotors(), 0, 0, False, None),
    ],
)
async def test_which_orders_of_a_fleet_need_the_lease(
    asked: orders.Order, fence: int, holder: int, is_let: bool, lease: Lease | None
) -> None:
    client, service = given()
    client.holder = LeaseChanged(holder, "anna" if holder else "")
    order = message(asked, fence)
    if is_let:
        assert service.lease_for(order, asked) is lease
    else:
        who = "anna" if holder else "nobody"
        with pytest.raises(StaleLease, match=f"{who} has control"):
            service.lease_for(order, asked)


async def test_a_lease_is_kept_with_its_secret_and_its_signer() -> None:
    client, service = given()
    half = Half()
    order = replace(message(orders.AcquireLease("bert"), 0), key=half.public)
    answer = await service.carry_out(order, order.order)
    assert (answer["text"], answer["number"]) == ("bert", 8)
    assert service.secret(8) == half.secret(order, answer["key"], answer["key"])
    assert service.leases[8].signer == "anna"
    for number, left in ((8, {8}), (7, {7, 8}), (9, set()), (0, set())):
        client.holder = LeaseChanged(number, "")
        service.leases = {one: Granted(HELD, "secret", "anna") for one in (7, 8)}
        service.refused = M100Error("old")
        client.on_lease[-1](client.holder)
        assert set(service.leases) == left
        found: M100Error | None = service.refused
        assert found is None


async def test_who_is_revoked_while_a_lease_is_granted_does_not_have_it() -> None:
    client, service = given(lambda name: "2026-11-22" if name == "anna" else "")
    order = replace(message(orders.AcquireLease("bert"), 0), key=Half().public)
    with pytest.raises(NotAllowed, match="anna is revoked since 2026-11-22"):
        await service.carry_out(order, order.order)
    assert [lease.number for lease in client.let_gone] == [8]
    assert 8 not in service.leases
    assert service.shut_out() == "anna"
    assert service.leases == {}
    assert service.shut_out() == ""


@pytest.mark.parametrize(
    ("signers", "is_ended"), [(("anna",), True), (("anna", "bert"), False), (("bert",), False)]
)
async def test_a_landing_ends_when_all_are_revoked_who_want_it(
    signers: tuple[str, ...], is_ended: bool
) -> None:
    _, service = given(lambda name: "today" if name == "anna" else "")
    service.leases.clear()
    service._descent = asyncio.create_task(asyncio.sleep(60.0))
    service._descent_signers.update(signers)
    assert service.shut_out() == ("anna" if is_ended else "")
    await asyncio.sleep(0)
    assert service._descent.cancelled() is is_ended
    service._descent.cancel()


@pytest.mark.parametrize(
    ("on_ground", "holder", "underway", "is_flown"),
    [
        (True, 0, 0, False),  # it is where it is wanted
        (True, 7, 0, True),  # who holds it may be about to take off
        (True, 0, 1, True),
        (False, 0, 0, True),
        (None, 0, 0, True),
    ],
)
async def test_what_stands_and_nobody_flies_is_not_landed(
    on_ground: bool | None, holder: int, underway: int, is_flown: bool
) -> None:
    client, service = given()
    client.holder, client.view.is_on_ground = LeaseChanged(holder, ""), on_ground
    service._underway = underway
    flown: list[tuple[orders.Order, str, bool]] = []

    async def descended(task: orders.Order, who: str, *, take_over: bool) -> None:
        flown.append((task, who, take_over))

    service._descended = descended  # type: ignore[method-assign] # for this test
    await service.descend(orders.GoHome(), "anna", take_over=False, signer="anna")
    assert flown == [(orders.GoHome(), "anna", False)] * is_flown


@pytest.mark.parametrize("order", [orders.PauseMission(), orders.ResumeMission()])
async def test_a_card_says_paused_of_a_pause_alone(order: orders.Order) -> None:
    answer, client = SimpleNamespace(text="", number=None), MagicMock()
    client.ask = AsyncMock(return_value=answer)
    service = OrderService(client, MemoryOrderLog())
    service.missions.paused = MagicMock()  # type: ignore[method-assign]
    assert await service._do(order, None, 3.0) == {"text": "", "number": None}
    client.ask.assert_awaited_once_with(order, None, asked_at=3.0)
    is_paused = isinstance(order, orders.PauseMission)
    service.missions.paused.assert_called_once_with(is_paused=is_paused)
