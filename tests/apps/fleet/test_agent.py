"""The agent on board: what it tells, what it does once, and whose setpoints fly."""

from __future__ import annotations

import asyncio
import uuid
from collections import Counter
from dataclasses import replace
from functools import partial
from itertools import pairwise
from types import SimpleNamespace
from typing import Any
from zlib import crc32

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.lease import Lease
from m100link.apps.agent.messages import Event, Steer, Telemetry
from m100link.apps.agent.orders import FlyTo
from m100link.apps.agent.transports import memory_channels
from m100link.apps.bus.network import Held
from m100link.apps.fleet.agent import FleetAgent, _each_second, _moments
from m100link.apps.fleet.expiry import Dropped
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.logs.service import LogService
from m100link.apps.fleet.logs.words import unpack_reply
from m100link.apps.fleet.order_log import MemoryOrderLog
from m100link.apps.fleet.payloads import (
    Card,
    Half,
    LeaseRequest,
    LeaveShow,
    LogQuestion,
    OrderMessage,
    OrderReply,
    Outcome,
    Progress,
    TakePlace,
    What,
    ends,
    pack,
    pack_steer,
    unpack,
    unpack_message,
)
from m100link.apps.fleet.show.service import ShowService
from m100link.errors import GuardRefused, NotAllowed, UsageError
from m100link.geodesy import LocalFrame
from m100link.missions.plan import Waypoint, WaypointPlan
from m100link.protocol.setpoint import Setpoint
from m100link.sim.virtual import VirtualAircraft
from tests.apps.agent.conftest import hears_late
from tests.apps.agent.examples import example
from tests.apps.bus.memory import MemoryBus
from tests.apps.fleet.conftest import SITE, OnBoard, Rig, with_camera
from tests.apps.fleet.test_payloads import BOTH, OLD_ORDERS

pytestmark = pytest.mark.anyio

KEYS = Keys(SITE, "a1")
NORTH = Setpoint.velocity(north=3.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


def order(message: orders.Order, fence: int = 0, token: str = "", key: bytes = b"") -> OrderMessage:
    """Made now: agents on virtual time go by the clock of the loop."""
    now = anyio.current_time()
    head = (uuid.uuid4().hex, SITE, "a1", "by hand", fence, 1.8e9)
    return OrderMessage(*head, message, now, key=key).under(token)


async def send(rig: Rig, what: OrderMessage, key: str = KEYS.command) -> OrderReply:
    """One question, and until it is over what became of it."""
    bus = rig.network.session()
    [answer] = await bus.ask(key, pack(what), timeout=2.0)
    reply: OrderReply = unpack(OrderReply, answer.payload)
    while reply.progress is Progress.RUNNING:
        [answer] = await bus.ask(KEYS.status(what.id), timeout=2.0)
        reply = unpack(OrderReply, answer.payload)
    return reply


def request(offer: str = "") -> LeaseRequest:
    half, asked = Half(), orders.ConfirmTakeOver(offer) if offer else orders.AcquireLease()
    return LeaseRequest(order(asked, key=half.public), half)


async def lease(rig: Rig, asked: LeaseRequest | None = None) -> Lease:
    asked = asked or request()
    return asked.lease(await send(rig, asked.order, KEYS.lease))


async def in_the_air(rig: Rig, one: OnBoard) -> Lease:
    """The lease, kept as long as it is in force; the aircraft hovers."""
    got = await lease(rig)

    async def keeping() -> None:
        while (await keep(rig, got)).outcome is Outcome.OK:  # noqa: ASYNC110 - each is a question
            await anyio.sleep(0.5)

    one.agent.background.spawn(keeping(), "a pilot")
    for action in (orders.Activate(), orders.Obtain(), orders.TakeOff()):
        reply = await send(rig, order(action, got.number, got.token))
        assert reply.outcome is Outcome.OK
    return got


async def keep(rig: Rig, got: Lease) -> OrderReply:
    renewal = order(orders.RenewLease(), got.number, got.token)
    return await send(rig, renewal, KEYS.lease)


async def test_telemetry_is_the_wire_value_thinned_and_whole_for_who_listens(rig: Rig) -> None:
    one = await rig.aircraft("a1")
    seen: dict[str, list[Telemetry]] = {KEYS.thinned: [], KEYS.telemetry: []}
    sent: list[bytes] = []

    def take(key: str, payload: bytes) -> None:
        message = unpack_message(payload)
        assert isinstance(message, Telemetry)
        seen[key].append(message)

    bus = rig.network.session()
    bus.subscribe(KEYS.thinned, take)
    one.agent.connection.on_sample.append(lambda sample: sent.append(sample.value))
    await anyio.sleep(10.0)
    assert not seen[KEYS.telemetry], "nobody listens"
    assert 45 <= len(seen[KEYS.thinned]) <= 110
    assert {message.value for message in seen[KEYS.thinned]} <= set(sent)
    held = bus.subscribe(KEYS.telemetry, take)
    sent.clear()
    await anyio.sleep(2.0)
    held.close()
    assert [message.value for message in seen[KEYS.telemetry]] == sent
    assert len(sent) > 90


async def test_state_is_reported_and_answered_and_events_are_reported(rig: Rig) -> None:
    one = await rig.aircraft("a1")
    bus, cards, events = rig.network.session(), [], []
    bus.subscribe(KEYS.state, lambda _, payload: cards.append(unpack(Card, payload)))
    bus.subscribe(KEYS.event, lambda _, payload: events.append(unpack_message(payload)))
    await anyio.sleep(5.0)
    assert 4 <= len(cards) <= 6
    [answer] = await bus.ask(Keys(SITE).state, timeout=1.0)
    assert answer.key == KEYS.state
    card: Card = unpack(Card, answer.payload)
    assert (card.name, card.connection, card.phase) == ("a1", "connected", "standby")
    assert card.battery_percent == 100
    one.agent.journal.note("something happened")
    await anyio.sleep(0.1)
    assert isinstance(events[-1], Event)
    assert events[-1].text == "something happened"


async def test_each_tells_where_it_stands_once_a_second_at_one_of_five_moments(rig: Rig) -> None:
    names = [f"a{number}" for number in range(6)]
    for name in names:
        await rig.aircraft(name)
    told: dict[str, list[float]] = {name: [] for name in names}

    def hear(key: str, payload: bytes) -> None:
        card: Card = unpack(Card, payload)
        told[card.name].append(anyio.current_time())

    rig.network.session().subscribe(Keys(SITE).state, hear)
    await anyio.sleep(20.0)
    for times in told.values():
        gaps = [later - earlier for earlier, later in pairwise(times[1:])]
        assert len(gaps) >= 17
        assert gaps == pytest.approx([1.0] * len(gaps), abs=0.002)
    moments = {round(times[-1] % 1.0, 2) for times in told.values()}
    assert len(moments) >= 3


async def test_an_order_that_comes_twice_is_carried_out_once(rig: Rig) -> None:
    one = await rig.aircraft("a1", virtual=with_camera())
    await one.agent.ask(orders.Activate())
    got = await lease(rig)
    photo = order(orders.UseCamera(orders.CameraUse.PHOTO), got.number, got.token)
    first = await send(rig, photo)
    await anyio.sleep(1.0)
    second = await send(rig, photo)
    assert first.outcome is Outcome.OK, first
    assert (first.outcome, second.outcome) == (Outcome.OK, Outcome.OK)
    assert (first.is_repeated, second.is_repeated) == (False, True)
    assert one.aircraft.vehicle.camera.photos == 1
    await send(rig, order(orders.UseCamera(orders.CameraUse.PHOTO), got.number, got.token))
    assert one.aircraft.vehicle.camera.photos == 2


async def test_after_a_restart_what_had_begun_is_unknown_and_not_done_again(rig: Rig) -> None:
    order_log = MemoryOrderLog()
    task = order(orders.TakeOff())
    await order_log.begin(task.id)
    await rig.aircraft("a1", order_log=MemoryOrderLog(order_log))
    reply = await send(rig, task)
    assert reply.outcome is Outcome.UNKNOWN
    [answer] = await rig.network.session().ask(KEYS.status(task.id), timeout=1.0)
    assert unpack(OrderReply, answer.payload).outcome is Outcome.UNKNOWN


async def test_where_words_of_the_ledger_are_lost_orders_of_before_are_unknown_and_not_done(
    rig: Rig,
) -> None:
    """Each of them may be one of those that were begun."""
    before = order(orders.TakeOff(), 7, "of the agent before")
    await anyio.sleep(1.0)
    damaged = MemoryOrderLog()
    damaged.damaged = 2
    one = await rig.aircraft("a1", virtual=with_camera(), order_log=damaged)
    assert [e.text[:38] for e in one.client.events if "order log" in e.text] == [
        "2 records of the order log are damaged"
    ]
    [answer] = await rig.network.session().ask(KEYS.status(before.id), timeout=1.0)
    assert unpack(OrderReply, answer.payload).progress is Progress.NEVER, "it may be sent again"
    assert (await send(rig, before)).outcome is Outcome.UNKNOWN
    await one.agent.ask(orders.Activate())
    got = await lease(rig)
    photo = order(orders.UseCamera(orders.CameraUse.PHOTO), got.number, got.token)
    assert (await send(rig, photo)).outcome is Outcome.OK, "it was made after"
    old = replace(photo, id=uuid.uuid4().hex, clock=before.clock).under(got.token)
    assert (await send(rig, old)).outcome is Outcome.UNKNOWN
    assert one.aircraft.vehicle.camera.photos == 1
    assert (await send(rig, order(orders.Stop()))).outcome is Outcome.OK


async def test_what_the_owner_of_the_aircraft_takes_with_it_is_unknown(rig: Rig) -> None:
    """Not refused: the take-off had begun, and the aircraft goes on with it."""
    one = await rig.aircraft("a1")
    got = await lease(rig)
    for action in (orders.Activate(), orders.Obtain()):
        assert (await send(rig, order(action, got.number, got.token))).outcome is Outcome.OK
    take_off = order(orders.TakeOff(), got.number, got.token)
    await rig.network.session().ask(KEYS.command, pack(take_off), timeout=2.0)
    one.service.close()
    reply = await send(rig, take_off)
    assert reply.outcome is Outcome.UNKNOWN
    assert reply.fault is not None
    assert "may have done it" in reply.fault.seen
    after = await send(rig, order(orders.Stop()))
    assert after.outcome is Outcome.REFUSED, "nothing was asked any more"


async def test_what_was_never_heard_is_reported_as_that(rig: Rig) -> None:
    await rig.aircraft("a1")
    [answer] = await rig.network.session().ask(KEYS.status("ab" * 16), timeout=1.0)
    assert unpack(OrderReply, answer.payload).progress is Progress.NEVER


async def test_movement_needs_the_lease_and_its_proof(rig: Rig) -> None:
    await rig.aircraft("a1")
    assert (await send(rig, order(orders.TakeOff()))).outcome is Outcome.STALE_LEASE
    got = await lease(rig)
    for fence, token in ((got.number, "guessed"), (got.number, ""), (got.number + 1, got.token)):
        reply = await send(rig, order(orders.Obtain(), fence, token))
        assert reply.outcome is Outcome.STALE_LEASE
    changed = replace(order(orders.GoHome(), got.number, got.token), order=orders.Obtain())
    assert (await send(rig, changed)).outcome is Outcome.STALE_LEASE


async def test_stop_and_landing_need_no_lease_and_a_landing_is_shared(rig: Rig) -> None:
    one = await rig.aircraft("a1")
    got = await in_the_air(rig, one)
    assert (await send(rig, order(orders.Stop()))).outcome is Outcome.OK
    await anyio.sleep(0.01)
    replies: list[Outcome] = []

    async def land() -> None:
        replies.append((await send(rig, order(orders.Land()))).outcome)

    async with anyio.create_task_group() as group:
        group.start_soon(land)
        await anyio.sleep(1.0)
        group.start_soon(land)
        assert (await keep(rig, got)).outcome is Outcome.STALE_LEASE
    assert replies == [Outcome.OK, Outcome.OK]
    assert one.height < 0.1
    assert (await send(rig, order(orders.Land()))).outcome is Outcome.OK, "it is down"


async def far_away(rig: Rig) -> FlyTo:
    [answer] = await rig.network.session().ask(KEYS.state, timeout=1.0)
    card: Card = unpack(Card, answer.payload)
    assert card.latitude_deg is not None
    assert card.longitude_deg is not None
    latitude, longitude = LocalFrame(card.latitude_deg, card.longitude_deg).to_geodetic(80.0, 0.0)
    return FlyTo(latitude_deg=latitude, longitude_deg=longitude, height=3.0, speed=5.0)


@pytest.mark.parametrize(
    "revoked_by",
    [orders.Stop(), orders.Halt(), "its asker", "time", "STOP at the station", "hover there"],
)
async def test_an_order_that_was_overtaken_is_not_carried_out(
    rig: Rig, revoked_by: orders.Order | str
) -> None:
    """It waited in the network, under a lease that is in force all the time."""
    one = await rig.aircraft("a1")
    got = await in_the_air(rig, one)
    late = order(await far_away(rig), got.number, got.token)
    await anyio.sleep(0.5)
    if isinstance(revoked_by, orders.Order):
        assert (await send(rig, order(revoked_by))).outcome is Outcome.OK
    elif revoked_by == "its asker":
        assert (await send(rig, order(orders.Obtain(), got.number, got.token))).number == 0
    elif revoked_by == "time":
        await anyio.sleep(5.0)
    else:
        ours, its = memory_channels(as_bytes=True)
        one.service.attach(its)
        async with AgentClient(ours, "a page of the station") as page:
            page.hover("hover") if revoked_by == "hover there" else await page.stop()
    reply = await send(rig, late)
    assert reply.outcome is Outcome.REFUSED
    assert reply.fault is not None
    assert "was not carried out" in reply.fault.seen
    for _ in range(40):
        await anyio.sleep(0.1)
        assert one.speed < 0.3
    if revoked_by not in ("its asker", "time"):  # a program may not have heard of it
        unheard = await send(rig, order(await far_away(rig), got.number, got.token))
        assert unheard.fault is not None
        assert "flight to a place that is asked for next is not begun" in unheard.fault.seen
        await send(rig, order(orders.Obtain(), got.number, got.token))
    again = order(await far_away(rig), got.number, got.token)
    await rig.network.session().ask(KEYS.command, pack(again), timeout=2.0)
    await anyio.sleep(2.0)
    assert one.speed > 1.0, "what is asked for now flies"


@pytest.mark.parametrize(("is_late", "is_heard"), [(True, True), (True, False), (False, True)])
async def test_a_client_that_let_go_before_a_stop_does_not_begin_anew_by_that(
    rig: Rig, is_late: bool, is_heard: bool
) -> None:
    one = await rig.aircraft("a1")
    got = await in_the_air(rig, one)
    let_go = order(orders.Halt(begins_anew=True), got.number, got.token)
    if not is_heard:  # on board, before the hover is read
        hears_late(one.channels[1], 1.0)
    await anyio.sleep(0.2)
    await one.agent.stop()
    if not is_late:
        await anyio.sleep(0.01)
        let_go = order(orders.Halt(begins_anew=True), got.number, got.token)
    assert (await send(rig, let_go)).outcome is Outcome.OK
    await fly(one, got, 2.0)
    assert (one.speed < 0.3) is is_late


async def test_of_a_stop_and_a_let_go_of_one_instant_the_stop_counts(rig: Rig) -> None:
    one = await rig.aircraft("a1")
    got = await in_the_air(rig, one)
    await anyio.sleep(0.2)
    await one.agent.stop()
    let_go = order(orders.Halt(begins_anew=True), got.number, got.token)
    assert let_go.clock == one.client.stopped_at
    assert (await send(rig, let_go)).outcome is Outcome.OK
    await fly(one, got, 2.0)
    assert one.speed < 0.3


async def test_a_landing_that_nobody_waits_for_is_not_begun_but_any_stop_is_done(rig: Rig) -> None:
    """Both waited before a frozen agent; meanwhile another pilot flies."""
    one = await rig.aircraft("a1")
    late = {action: order(action) for action in (orders.Land(), orders.Stop(), orders.Halt())}
    unknown = replace(order(orders.Land()), clock=0.0)
    await anyio.sleep(120.0)
    got = await in_the_air(rig, one)
    for landing in (late[orders.Land()], unknown):
        reply = await send(rig, landing)
        assert reply.outcome is Outcome.REFUSED
        assert reply.fault is not None
        assert reply.fault.details["guard"] == "order_age"
    flying = one.agent.background.spawn(fly(one, got, 6.0), "setpoints")
    await anyio.sleep(5.0)
    assert one.speed > 2.5, "what is refused revokes nothing"
    for action in (orders.Halt(), orders.Stop()):
        assert (await send(rig, late[action])).outcome is Outcome.OK
    await flying
    await anyio.sleep(3.0)
    assert one.speed < 0.3
    assert one.height > 1.0
    assert one.client.holder.number == got.number
    assert (await send(rig, order(orders.Land()))).outcome is Outcome.OK
    assert one.height < 0.1


async def test_a_take_off_that_waits_for_the_disk_is_revoked_by_a_landing(rig: Rig) -> None:
    class Slow(MemoryOrderLog):
        async def begin(self, identity: str) -> None:
            await anyio.sleep(1.0)

    one = await rig.aircraft("a1", order_log=Slow())
    await one.agent.ask(orders.Activate())
    got = await lease(rig)
    await send(rig, order(orders.Obtain(), got.number, got.token))
    take_off = order(orders.TakeOff(), got.number, got.token)
    await rig.network.session().ask(KEYS.command, pack(take_off), timeout=2.0)
    assert (await send(rig, order(orders.Land()))).outcome is Outcome.OK
    assert (await send(rig, take_off)).outcome is not Outcome.OK
    await anyio.sleep(10.0)
    assert one.height < 0.1


async def test_what_ends_a_movement_waits_for_no_disk(rig: Rig) -> None:
    """A card that hangs for a minute would let a mission fly on for that long."""
    order_log = MemoryOrderLog()
    one = await rig.aircraft("a1", order_log=order_log)
    got = await in_the_air(rig, one)
    order_log.begin = lambda _: anyio.sleep_forever()  # type: ignore[method-assign, assignment]
    for ending in (orders.PauseMission(), orders.StopMission(), orders.StopMotors()):
        with anyio.fail_after(30.0):
            reply = await send(rig, order(ending, got.number, got.token))
        assert reply.progress is Progress.DONE, ending
        assert reply.outcome is Outcome.REFUSED, "no mission flies, and it is in the air"
    reply = await send(rig, order(orders.GoHome(), got.number, got.token))
    assert reply.outcome is Outcome.OK
    assert one.height < 0.1
    reply = await send(rig, order(orders.Release(), got.number, got.token))
    assert reply.outcome is Outcome.OK
    assert not one.client.has_authority


async def test_strangers_reach_neither_disk_nor_memory(rig: Rig) -> None:
    one = await rig.aircraft("a1")
    for identity in ("", "x" * 4000, "ab" * 15 + "/*", "AB" * 16):
        bad = replace(order(orders.Stop()), id=identity)
        [answer] = await rig.network.session().ask(KEYS.command, pack(bad), timeout=2.0)
        assert unpack(OrderReply, answer.payload).outcome is Outcome.REFUSED
    assert (await send(rig, order(orders.TakeOff()))).outcome is Outcome.STALE_LEASE
    assert one.order_log.begun == {}


async def test_an_order_under_a_pattern_is_answered_under_each_key_that_heard_it(rig: Rig) -> None:
    await rig.aircraft("a1")
    stop = pack(order(orders.Stop()))
    answers = await rig.network.session().ask(KEYS.of("*"), stop, timeout=2.0)
    assert {one.key for one in answers} >= {KEYS.command, KEYS.lease}


async def test_fences_rise_over_a_restart(rig: Rig) -> None:
    order_log = MemoryOrderLog()
    one = await rig.aircraft("a1", order_log=order_log)
    before = await lease(rig)
    one.work.cancel()
    await anyio.sleep(0.1)
    await rig.aircraft("a1", order_log=MemoryOrderLog(order_log))
    after = await lease(rig)
    assert after.number > before.number


# -- setpoints ------------------------------------------------------------------------------------


async def fly(one: OnBoard, got: Lease, seconds: float, *, age: float = 0.0, by: int = 0) -> None:
    outlet = one.rig.network.session().publish(KEYS.setpoint)
    for number in range(round(20 * seconds)):
        steer = Steer(got.number + by, one.client.now - age, 0.2, NORTH)
        outlet.put(pack_steer(steer, got.token, begins=number == 0))
        await anyio.sleep(0.05)


async def test_setpoints_of_the_holder_fly(rig: Rig) -> None:
    one = await rig.aircraft("a1")
    got = await in_the_air(rig, one)
    await fly(one, got, 3.0)
    assert one.speed > 2.5
    assert not one.fleet_agent.dropped


@pytest.mark.parametrize(
    ("reason", "age", "by"),
    [
        (Dropped.LATE, 0.25, 0),
        (Dropped.LATE, -0.25, 0),
        (Dropped.STALE, 0.0, 1),
        (Dropped.STALE, 0.0, -1),
    ],
)
async def test_setpoints_that_are_old_or_of_another_lease_do_not(
    rig: Rig, reason: Dropped, age: float, by: int
) -> None:
    one = await rig.aircraft("a1")
    got = await in_the_air(rig, one)
    await fly(one, got, 3.0, age=age, by=by)
    assert one.speed < 0.3
    assert one.fleet_agent.dropped == {reason: 60}


async def test_a_setpoint_flies_once_and_not_after_a_newer_one(rig: Rig) -> None:
    one = await rig.aircraft("a1")
    got = await in_the_air(rig, one)
    outlet = rig.network.session().publish(KEYS.setpoint)
    old = pack_steer(Steer(got.number, one.client.now, 0.2, NORTH), got.token, begins=True)
    await anyio.sleep(0.05)
    new = pack_steer(Steer(got.number, one.client.now, 0.2, NORTH), got.token, begins=True)
    for payload in (new, old, new, b"\x01junk", new.ljust(2049, b"\0")):
        outlet.put(payload)
    await anyio.sleep(0.1)
    assert one.fleet_agent.dropped == {Dropped.REPEATED: 2, Dropped.DAMAGED: 2}


# -- who may, and who is there --------------------------------------------------------------------


async def test_an_order_for_another_aircraft_and_one_that_is_not_admitted(rig: Rig) -> None:
    def verify(one: OrderMessage, boot: str) -> None:
        if one.by == "stranger":
            raise NotAllowed("stranger may not")

    await rig.aircraft("a1", verify=verify)
    for what in (
        replace(order(orders.Stop()), aircraft="a2"),
        replace(order(orders.Stop()), by="stranger"),
    ):
        reply = await send(rig, what)
        assert reply.outcome is Outcome.NOT_ALLOWED
    assert (await send(rig, order(orders.Stop()))).outcome is Outcome.OK


async def test_what_cannot_be_read_is_answered(rig: Rig) -> None:
    await rig.aircraft("a1")
    for payload in (b"", b"\x02{}", b"\x01" + pack(order(orders.Stop()))[1:]):
        [answer] = await rig.network.session().ask(KEYS.command, payload, timeout=1.0)
        reply: OrderReply = unpack(OrderReply, answer.payload)
        assert reply.outcome is Outcome.REFUSED
        assert reply.fault is not None


async def test_two_agents_of_one_name_are_refused(rig: Rig) -> None:
    one = await rig.aircraft("a1")
    await anyio.sleep(0.1)
    twin = FleetAgent(one.client, rig.network.session(), KEYS, MemoryOrderLog())
    began_at = rig.utc()
    with pytest.raises(UsageError, match="another agent is named a1") as caught:
        await twin.require_alone()
    assert "another name" in caught.value.remedy
    assert 2.0 <= rig.utc() - began_at < 3.5, "the token of one that was killed is seen for a while"


async def test_stop_is_not_kept_waiting_by_long_orders(rig: Rig) -> None:
    """A stranger's flood costs as much time as there is; it waits for what is short."""
    read: list[str] = []
    await rig.aircraft("a1", verify=lambda one, _: read.append(one.by))
    bus = rig.network.session()
    async with anyio.create_task_group() as group:
        for _ in range(1000):
            long = pack(replace(order(orders.Stop()), by="x" * 60_000))
            group.start_soon(partial(bus.ask, KEYS.command, long, timeout=1.0))
        await anyio.sleep(0.0)
        assert (await send(rig, order(orders.Stop()))).outcome is Outcome.OK
        assert read.index("by hand") <= 1
    await anyio.sleep(2.0)
    assert len(read) < 30, "most of a flood is not read at all"
    last = replace(order(orders.Stop()), by="x" * 60_000)
    assert (await send(rig, last)).outcome is Outcome.OK, "one alone is"


async def test_a_take_over_that_nobody_waits_for_takes_the_lease_from_nobody(rig: Rig) -> None:
    """It was confirmed, and waited in a network: who confirmed it has given up, and renews none."""
    one = await rig.aircraft("a1")
    got = await in_the_air(rig, one)
    offer = await send(rig, order(orders.AskTakeOver()), KEYS.lease)
    late = request(offer.offer).order
    await anyio.sleep(6.0)
    reply = await send(rig, late, KEYS.lease)
    assert reply.outcome is Outcome.REFUSED
    assert one.client.holder.number == got.number
    assert (await lease(rig, request(offer.offer))).number > got.number


async def test_why_a_setpoint_was_not_flown_reaches_no_later_operator(rig: Rig) -> None:
    one = await rig.aircraft("a1")
    got = await in_the_air(rig, one)
    on = Steer(got.number, anyio.current_time(), 0.2, NORTH)
    rig.network.session().publish(KEYS.setpoint).put(pack_steer(on, got.token, begins=False))
    await rig.until(lambda: one.fleet_agent.dropped[Dropped.BROKEN])
    offer = await send(rig, order(orders.AskTakeOver()), KEYS.lease)
    other = await lease(rig, request(offer.offer))
    assert (await keep(rig, other)).fault is None


async def test_an_old_client_hears_both_versions_and_nothing_is_done(rig: Rig) -> None:
    one = await rig.aircraft("a1")
    spawn, bus = one.agent.background.spawn, rig.network.session()
    spawn(ShowService(one.client, one.bus, KEYS, one.fleet_agent.boot).run(), "shows")
    spawn(LogService(one.bus, KEYS, None).run(), "logs")
    await anyio.sleep(0.1)
    for key, payload in OLD_ORDERS.items():
        [answer] = await bus.ask(KEYS.of(key), payload, timeout=2.0)
        reply = (
            unpack_reply(answer.payload)[0] if key == "log" else unpack(OrderReply, answer.payload)
        )
        assert (reply.id, reply.outcome) == ("", Outcome.REFUSED)
        assert reply.fault is not None
        assert (reply.fault.kind, reply.fault.seen) == ("MessageError", BOTH)
    steer = pack_steer(Steer(1, one.client.now, 0.2, NORTH), "", begins=True)
    bus.publish(KEYS.setpoint).put(b"\x02" + steer[1:])
    await anyio.sleep(0.1)
    assert one.fleet_agent.dropped == {Dropped.DAMAGED: 1}
    assert one.client.holder.number == 0


async def test_what_is_asked_under_the_key_of_something_else_is_not_done(rig: Rig) -> None:
    one = await rig.aircraft("a1")
    head = (SITE, "a1", "eve", 0, 1.8e9)
    for asked in (LogQuestion(What.LIST), TakePlace("r"), LeaveShow("r")):
        made = OrderMessage(uuid.uuid4().hex, *head, asked, one.client.now)
        for key in (KEYS.command, KEYS.lease):
            reply = await send(rig, made, key)
            assert reply.outcome is Outcome.REFUSED
            assert reply.fault is not None
            assert reply.fault.seen == f"{type(asked).__name__} does not belong under this key"


@pytest.mark.parametrize("what", ["place", "mission"])
async def test_an_order_from_before_a_stop_that_is_not_heard_yet_moves_nothing(
    rig: Rig, what: str
) -> None:
    """The agent on board reads the network before the way to the agent of the aircraft."""
    one = await rig.aircraft("a1", virtual=VirtualAircraft(seed=5, firmware="3.1"))
    got = await in_the_air(rig, one)
    asked: orders.Order = await far_away(rig)
    if what == "mission":
        assert isinstance(asked, FlyTo)
        there = Waypoint(asked.latitude_deg, asked.longitude_deg, 5.0)
        north = Waypoint(asked.latitude_deg + 1e-4, asked.longitude_deg, 5.0)
        plan = orders.UploadPlan.of(WaypointPlan((there, north)))
        reply = await send(rig, order(plan, got.number, got.token))
        asked = orders.StartMission(reply.text)
    late = order(asked, got.number, got.token)
    hears_late(one.channels[1], 1.0)
    await anyio.sleep(0.05)
    await one.agent.stop()
    reply = await send(rig, late)
    assert reply.fault is not None
    assert "STOP was pressed after" in reply.fault.seen
    for _ in range(40):
        await anyio.sleep(0.1)
        assert one.speed < 0.3


async def test_what_ends_a_flight_waits_behind_no_other_question(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By every key under which an aircraft is stopped, landed, or let go."""
    first: dict[str, object] = {}
    serve = MemoryBus.serve

    def served(bus: MemoryBus, key: str, take: Any, **more: Any) -> Held:
        first[key] = more.get("is_first")
        return serve(bus, key, take, **more)

    monkeypatch.setattr(MemoryBus, "serve", served)
    one = await rig.served("a1")
    show = ShowService(one.client, one.bus, Keys(SITE, "a1"), one.fleet_agent.boot)
    one.agent.background.spawn(show.run(), "show")
    await anyio.sleep(0.1)
    keys = Keys(SITE, "a1")
    assert {key for key, said in first.items() if said is ends} == {
        keys.command,
        keys.lease,
        keys.show,
    }


@pytest.mark.parametrize("kind", orders.ORDERS.values(), ids=orders.ORDERS)
async def test_behind_a_stop_a_fleet_does_what_every_front_does(
    rig: Rig, kind: type[orders.Order]
) -> None:
    """By the class of the order: what ends something is done however long it was under way."""
    if kind.needs is not orders.Needs.LEASE or issubclass(kind, orders.UploadPlan):
        return
    one = await rig.aircraft("a1")
    got = await in_the_air(rig, one)
    late = order(example(kind), got.number, got.token)
    await anyio.sleep(0.2)
    await one.agent.stop()
    reply = await send(rig, late)
    is_overtaken = (
        reply.fault is not None and "stop, hover or landing was asked" in reply.fault.seen
    )
    if not kind.is_kept:  # a landing
        is_overtaken = reply.fault is not None and "STOP was pressed after" in reply.fault.seen
    assert is_overtaken is (kind.after_stop is not orders.AfterStop.DONE), reply


async def test_a_card_says_before_the_first_order_that_there_are_no_credentials(rig: Rig) -> None:
    await rig.aircraft("a1", credentials=None)
    await rig.aircraft("a2")
    cards = await (await rig.pilot()).cards()
    assert [card.connection for card in cards.values()] == ["connected", "connected"]
    fault = cards["a1"].fault
    assert fault is not None
    assert fault.error().seen == "this station has no app id and key"
    assert "--app-id" in (fault.error().remedy or "")
    assert cards["a2"].fault is None


# -- who ordered what -----------------------------------------------------------------------------


async def test_each_order_and_its_outcome_is_in_the_audit_log(rig: Rig) -> None:
    """No question, no renewal; of a flood of refused orders one a second."""
    lines: list[dict[str, Any]] = []
    log: Any = SimpleNamespace(add=lines.append)

    def verify(order: OrderMessage, boot: str) -> None:
        if order.by == "eve":
            raise NotAllowed("eve may not stop a1")

    await rig.aircraft("a1", audit=log, verify=verify)
    ada, eve = await rig.pilot("ada"), await rig.pilot("eve")
    began_at = rig.utc()
    await ada["a1"].take_off()
    assert [(line["by"], line["order"], line["outcome"]) for line in lines] == [
        ("ada", what, "ok")
        for what in ("acquire lease", "activate", "obtain", "take off", "release lease")
        if what in {line["order"] for line in lines}
    ]
    assert {"acquire lease", "take off", "release lease"} <= {line["order"] for line in lines}
    times = [line["ordered_at"] for line in lines]
    assert times == sorted(times), "each by the clock of its sender, in ms"
    assert times[0] == pytest.approx(began_at, abs=0.01)
    assert times[-1] > began_at + 1.0, "a take-off takes its time"
    lines.clear()
    for _ in range(5):
        with pytest.raises(NotAllowed):
            await eve["a1"].stop()
    refused = [(line["by"], line["order"], line["outcome"], line["why"]) for line in lines]
    assert refused == [("eve", "stop", "not_allowed", "eve may not stop a1")] * len(refused)
    assert 1 <= len(refused) < 5


async def test_an_order_of_a_program_that_does_not_know_the_time_yet_is_logged_once(
    rig: Rig,
) -> None:
    lines: list[dict[str, Any]] = []
    log: Any = SimpleNamespace(add=lines.append)
    await rig.aircraft("a1", audit=log, verify=lambda *_: None)
    ada, late = await rig.pilot("ada"), await rig.pilot("late")
    await ada["a1"].take_off()
    await anyio.sleep(20.0)
    lines.clear()
    await (await rig.pilot("new"))["a1"].land()
    assert [(line["by"], line["order"], line["outcome"]) for line in lines] == [
        ("new", "land", "ok")
    ]
    lines.clear()
    with pytest.raises(GuardRefused, match="it is older than 5 s"):
        await late["a1"].asker.ask(orders.Land(), clock=1.0)
    assert [(line["by"], line["outcome"]) for line in lines] == [("late", "refused")]


# -- a timer for all agents of a process ----------------------------------------------------------


async def test_agents_tell_each_second_by_twenty_timers_at_most() -> None:
    """At the fifth of a second that the name says; one that is late leaves out what is over."""
    told, ends, late, loop = Counter[str](), [], list[float](), asyncio.get_running_loop()
    names = [f"a{number}" for number in range(200)]
    await anyio.sleep(0.37)

    def tell(name: str) -> None:
        told[name] += 1
        late.append((loop.time() - crc32(name.encode()) % 5 / 5 + 1e-6) % 1.0)
        if name == "a7":
            raise ValueError("one that fails keeps no other from telling")

    for name in names:
        ends.append(_each_second(name, partial(tell, name)))
    timers = _moments[loop]
    assert len(timers) <= 20
    await anyio.sleep(9.97)
    assert {told[name] for name in names} == {10}
    assert max(late) < 1e-5
    for end in ends:
        end()
    await anyio.sleep(5.0)
    assert told.total() == 2000
    assert all(timer._timer.cancelled() for timer in timers.values())
    end = _each_second("a7", partial(tell, "later"))
    await anyio.sleep(2.01)
    assert told["later"] == 2
    [timer] = [one for one in timers.values() if one.tells]
    timer._timer.cancel()
    timer._due = loop.time() - 2.5
    timer._tell()
    assert timer._due - loop.time() == pytest.approx(0.5)
    end()
