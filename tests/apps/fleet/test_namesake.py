"""Two agents of one name, behind routers that were joined after both had begun."""

from __future__ import annotations

import asyncio

import anyio
import pytest

from m100link.apps.fleet.agent import DuplicateNames
from m100link.apps.fleet.client import Fleet
from m100link.apps.fleet.expiry import Dropped
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.payloads import (
    Asked,
    OrderMessage,
    OrderReply,
    Outcome,
    StartShow,
    TakePlace,
    pack,
    unpack,
)
from m100link.apps.fleet.show.service import ShowService
from m100link.errors import M100Error, UsageError
from m100link.protocol.setpoint import Setpoint
from tests.apps.fleet.conftest import SITE, OnBoard, Rig

pytestmark = pytest.mark.anyio

NORTH = Setpoint.velocity(north=3.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


def test_one_is_there_while_it_is_heard_again() -> None:
    ones = DuplicateNames("a1", "mine")
    for at in range(10):
        ones.hear("mine", float(at))
    ones.require_none(10.0)
    ones.hear("other", 10.0)
    assert not ones.is_there(10.0), "it may be the last word of one that was killed"
    ones.hear("other", 11.0)
    assert ones.is_there(11.0)
    with pytest.raises(UsageError, match="two agents are named a1"):
        ones.require_none(16.0)
    ones.require_none(16.1)
    ones.hear("other", 30.0)
    assert not ones.is_there(30.0), "it begins anew"
    for at in range(31, 51):
        ones.hear("other", float(at))
        assert ones.is_there(float(at)), "once a second is enough, however long"


@pytest.mark.parametrize(
    ("first", "last", "now", "is_there"),
    [
        (10.0, 10.5, 10.5, True),
        (10.0, 10.4, 10.4, False),  # one word may be the last of one that was killed
        (10.0, 10.5, 15.5, True),
        (10.0, 10.5, 15.6, False),
        (10.0, 15.0, 15.0, True),
        (10.0, 15.1, 15.1, False),  # it was gone meanwhile, and begins anew
    ],
)
def test_another_of_the_same_name_is_there_from_half_a_second_on_until_five_after_its_last_word(
    first: float, last: float, now: float, is_there: bool
) -> None:
    ones = DuplicateNames("a1", "mine")
    ones.hear("other", first)
    ones.hear("other", last)
    assert ones.is_there(now) is is_there


def test_several_are_distinguished_and_do_not_fill_the_memory() -> None:
    ones = DuplicateNames("a1", "mine")
    for at in range(3):
        for boot in range(1000):
            ones.hear(f"{boot}", float(at))
    assert ones.is_there(2.0)
    assert len(ones._heard) <= 16


async def two(rig: Rig) -> tuple[OnBoard, OnBoard, Fleet]:
    """The second one is behind a router of its own, which nobody else knows yet."""
    one, pilot = await rig.aircraft("a1"), await rig.pilot()
    twin = await rig.aircraft("a1")
    rig.network.cut(twin.bus)
    await anyio.sleep(2.0)  # its token is gone as well
    return one, twin, pilot


async def test_what_a_pilot_flies_hovers_and_nobody_else_flies(rig: Rig) -> None:
    one, twin, pilot = await two(rig)
    await anyio.sleep(5.0)
    told: list[M100Error] = []

    async def fly() -> None:
        try:
            async with pilot["a1"].control() as control:
                await control.take_off()
                async with control.hold(NORTH):
                    await anyio.sleep(60.0)
        except M100Error as error:
            told.append(error)

    async with anyio.create_task_group() as group:
        group.start_soon(fly)
        await rig.until(lambda: one.speed > 2.5)
        await anyio.sleep(2.0)
        assert one.speed > 2.5
        rig.network.join(twin.bus)
        await anyio.sleep(4.0)
        assert one.speed < 0.3
    assert told, "one of both answers that the lease is none, or both answer"
    for agent in (one, twin):
        assert any("another agent is named a1" in event.text for event in agent.client.events)
    other = await rig.pilot("other")
    for result in (await other.each(lambda aircraft: aircraft.take_off(), ["a1"])).values():
        assert result.outcome is not Outcome.OK
    assert twin.height < 0.1
    assert twin.agent.leases.holder(twin.agent.now) is None
    await other.land(["a1"])
    await rig.until(lambda: one.height < 0.1)
    rig.network.cut(twin.bus)
    await anyio.sleep(7.0)
    await other["a1"].take_off()
    assert one.height > 1.0


async def test_setpoints_of_a_pilot_who_does_not_see_that_there_are_two_do_not_fly(
    rig: Rig,
) -> None:
    one, twin, pilot = await two(rig)
    control = pilot["a1"].control()
    async with anyio.create_task_group() as group:

        async def fly() -> None:
            with pytest.raises(M100Error):
                async with control:
                    await control.take_off()
                    async with control.hold(NORTH):
                        await anyio.sleep(30.0)

        group.start_soon(fly)
        await rig.until(lambda: one.speed > 2.5)
        declared = rig.network.takers("serve", f"m100/{SITE}/a1/*")
        for one_of in declared + rig.network.takers("token", Keys(SITE, "a1").live):
            if one_of.session is twin.bus:
                one_of.close()
        rig.network.join(twin.bus)
        await anyio.sleep(5.0)
        assert one.speed < 0.3
        assert one.fleet_agent.dropped[Dropped.DUPLICATE] > 0
        rig.network.cut(twin.bus)
        await anyio.sleep(8.0)
        assert one.speed < 0.3, "nothing resumes by itself"
        group.cancel_scope.cancel()


async def test_the_agent_before_that_was_killed_is_no_namesake(rig: Rig) -> None:
    one = await rig.aircraft("a1")
    await anyio.sleep(5.0)
    one.kill()
    after = await one.next()
    await anyio.sleep(5.0)
    assert not after.fleet_agent.duplicates.is_there(after.client.now)


async def test_a_show_begins_with_neither(rig: Rig) -> None:
    one = await rig.aircraft("a1")
    namesakes = one.fleet_agent.duplicates
    service = ShowService(
        one.client, one.bus, Keys(SITE, "a1"), one.fleet_agent.boot, names=namesakes
    )
    running = asyncio.ensure_future(service.run())
    await anyio.sleep(0.1)
    for at in (0.0, 1.0):
        namesakes.hear("other", one.client.now - 1.0 + at)
    asked: list[Asked] = [TakePlace("r"), StartShow("r", "", 1.0, 0.0)]
    for number, do in enumerate(asked):
        head = (f"{number:032x}", SITE, "a1", "anna", 0, 0.0)
        order = OrderMessage(*head, do, one.client.now)
        [answer] = await rig.network.session().ask(Keys(SITE, "a1").show, pack(order), timeout=1.0)
        reply: OrderReply = unpack(OrderReply, answer.payload)
        assert reply.fault is not None
        assert "two agents" in reply.fault.seen
    running.cancel()


async def test_nonsense_under_its_key_is_no_namesake(rig: Rig) -> None:
    one = await rig.aircraft("a1")
    outlet = rig.network.session().publish(Keys(SITE, "a1").state)
    for _ in range(10):
        for payload in (b"", b"\x01{}", b"\x07junk", b"\x01" + b"[" * 60_000):
            outlet.put(payload)
        await anyio.sleep(1.0)
    one.fleet_agent.duplicates.require_none(one.client.now)
    assert not one.work.done()
