"""Calls of a front in, messages out; and what a front knows once its agent has gone."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.client import PRESSED_AT, AgentClient
from m100link.apps.agent.lease import Lease, LeaseManager, LeaseRefused
from m100link.apps.agent.messages import (
    VERSION,
    Ask,
    Event,
    EventTopic,
    Goodbye,
    Hello,
    JournalNote,
    LeaseChanged,
    LinkCounted,
    Message,
    OrderOutcome,
    Replay,
    Stage,
    State,
    Steer,
)
from m100link.apps.agent.transports import memory_channels
from m100link.errors import LinkError
from m100link.protocol.setpoint import Setpoint
from tests import limits
from tests.known import CONNECTED, KnownAgent

pytestmark = pytest.mark.anyio

NORTH = Setpoint.velocity(north=1.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)
LEASE = Lease("front", "token", 7)
NOW = 5.0

SENT: list[tuple[Callable[[AgentClient], None], Message]] = [
    (lambda c: c.keep(LEASE), Ask(0, orders.RenewLease("token"))),
    (lambda c: c.let_go(LEASE), Ask(0, orders.ReleaseLease("token"))),
    (lambda c: c.steer(LEASE, NORTH), Steer(7, NOW, 0.2, NORTH)),
    (lambda c: c.steer(LEASE, NORTH, 0.75), Steer(7, NOW, 0.75, NORTH)),
    (lambda c: c.hover(), Ask(0, orders.Halt(), 0, NOW)),
    (lambda c: c.hover("why", LEASE), Ask(0, orders.Halt("why"), 7, NOW)),
    (
        lambda c: c.hover("let go", LEASE, begins_anew=True, at=1.5),
        Ask(0, orders.Halt("let go", True), 7, 1.5),
    ),
    (lambda c: c.hover("", LEASE, at=99.0), Ask(0, orders.Halt(), 7, NOW)),
    (lambda c: c.note("what"), JournalNote("info", "what")),
    (lambda c: c.note("what", "warning"), JournalNote("warning", "what")),
]


class Both:
    """A front and the other end of its way, which only listens."""

    def __init__(self) -> None:
        ours, self.its = memory_channels()
        self.heard: list[Message] = []
        self.closed: list[str] = []
        self.its.open(self.heard.append, self.closed.append)
        self.client = AgentClient(ours, "front")


async def at_five() -> Both:
    both = Both()
    await both.client.__aenter__()
    assert both.heard == [Hello(VERSION, "front", both.client.now)]
    await anyio.sleep(NOW - both.client.now)
    both.heard.clear()
    return both


@pytest.mark.parametrize(("call", "message"), SENT)
async def test_what_a_call_sends(call: Callable[[AgentClient], None], message: Message) -> None:
    both = await at_five()
    call(both.client)
    assert both.heard == [message]
    await both.client.__aexit__()
    assert both.closed == ["the front ends"]


@pytest.mark.parametrize("lease", [None, LEASE])
@pytest.mark.parametrize("hears_begin", [False, True])
async def test_a_question_says_under_which_lease_and_of_when(
    lease: Lease | None, hears_begin: bool
) -> None:
    both = await at_five()
    for number, (pressed_at, asked_at, expected) in enumerate(
        ((math.inf, None, NOW), (2.5, None, 2.5), (2.5, 1.25, 1.25)), 1
    ):
        PRESSED_AT.set(pressed_at)
        begun: list[int] = []
        accepted = (lambda begun=begun: begun.append(1)) if hears_begin else None
        asking = both.client.ask(orders.Land(), lease, accepted, asked_at)
        work = both.client.background.spawn(asking, "question")
        await anyio.sleep(0.0)
        fence = 0 if lease is None else 7
        assert both.heard.pop() == Ask(number, orders.Land(), fence, expected, hears_begin)
        both.its.send(OrderOutcome(number, Stage.ACCEPTED))
        both.its.send(OrderOutcome(number, Stage.DONE, text="it"))
        assert (await work).text == "it"
        assert begun == [1] * hears_begin
    PRESSED_AT.set(math.inf)
    await both.client.__aexit__()


async def test_what_is_asked_about_a_lease() -> None:
    both = await at_five()
    client, found = both.client, []
    for number, (asking, order, answer) in enumerate(
        (
            (client.acquire("n", 1.5), orders.AcquireLease("n"), {"lease": LEASE}),
            (client.confirm("t", 2.5), orders.ConfirmTakeOver("t"), {"lease": LEASE}),
            (client.release_lease("t"), orders.ReleaseLease("t"), {}),
            (client.stop(), orders.Stop(), {}),
        ),
        1,
    ):
        work = client.background.spawn(asking, "question")
        await anyio.sleep(0.0)
        asked = both.heard.pop()
        assert isinstance(asked, Ask)
        found.append((asked.order, asked.sent_at))
        assert asked.order == order
        more: dict[str, Any] = answer
        both.its.send(OrderOutcome(number, Stage.DONE, **more))
        assert await work == more.get("lease")
    assert [at for _, at in found] == [1.5, 2.5, NOW, NOW]
    await client.__aexit__()


async def test_what_comes_behind_a_stop_of_the_same_instant_is_later_than_it() -> None:
    both = await at_five()
    both.its.send(Event(1, NOW, "info", "stop", EventTopic.STOPPED))
    assert both.client.stopped_at == NOW
    both.client.hover("", LEASE)
    [halt] = both.heard
    assert isinstance(halt, Ask)
    assert halt.sent_at is not None
    assert NOW < halt.sent_at < NOW + 1e-9
    both.its.send(Event(2, NOW, "info", "something else"))
    assert both.client._stops == 1
    await both.client.__aexit__()


async def test_an_agent_that_has_gone_holds_and_flies_nothing_as_far_as_anybody_knows() -> None:
    both = await at_five()
    guided = orders.GuidedFlight("flight to a place", 52.0, 4.3)
    full = replace(
        CONNECTED, holding="held", task="land", pattern="p", guided=guided, firmware="3.1"
    )
    both.its.send(full)
    both.its.send(LeaseChanged(7, "front"))
    both.its.close("killed")
    state, client = both.client.state, both.client
    assert state.connection_fault is not None
    assert state.connection_fault.seen == "the agent that owns the aircraft has gone: killed"
    assert state == replace(
        full,
        connection="lost",
        connection_fault=state.connection_fault,
        has_authority=False,
        holding="none",
        task="",
        pattern="",
        guided=None,
    )
    assert (client.holder, client.is_gone) == (LeaseChanged(0, ""), True)
    with pytest.raises(LinkError, match="killed"):
        await client.ask(orders.Land())
    client._closed("again")
    assert client.state is state, "the first reason stays"
    await client.__aexit__()


async def test_an_agent_of_another_version_hears_why_and_is_closed() -> None:
    both = await at_five()
    both.its.send(Hello(VERSION + 1, "agent", 0.0))
    why = f"it speaks version {VERSION + 1}, this front {VERSION}"
    assert both.closed == [why]
    fault = both.client.state.connection_fault
    assert fault is not None
    assert why in fault.seen
    assert fault.remedy == "install the same release of m100link at both ends"


async def test_the_agent_that_takes_the_place_of_another_tells_all_of_it_anew() -> None:
    both = await at_five()
    client = both.client
    both.its.send(CONNECTED)
    both.its.send(LinkCounted(1.0, {}, {}, 0.0))
    both.its.send(Event(41, 3.0, "info", "before"))
    assert (client.telemetry is None, client.link is None) == (False, False)
    both.its.close("killed")
    await anyio.sleep(10.0)
    ours, its = memory_channels()
    client.reopen(ours)
    assert (client.telemetry, client.link, client.agents_before) == (None, None, 1)
    assert (client.state, client.heard_at, client.is_gone) == (State(at=15.0), 15.0, False)
    for number, at, text in ((1, 3.0, "before"), (2, 3.5, "after"), (60, 4.0, "later")):
        its.send(Event(number, at, "info", text))
    told = [(event.number, event.text) for event in client.events]
    assert told == [(41, "before"), (42, "after"), (60, "later")]
    await client.__aexit__()


@pytest.mark.parametrize(
    ("message", "is_sign"),
    [
        (CONNECTED, True),
        (LinkCounted(1.0, {}, {}, 0.0), True),
        (Hello(VERSION, "agent", 0.0), True),
        (LeaseChanged(3, "somebody"), False),
        (Event(1, 0.0, "info", "long ago"), False),
        (OrderOutcome(99, Stage.DONE), False),
        (Goodbye("why"), True),
    ],
)
async def test_what_shows_that_the_agent_runs(message: Message, is_sign: bool) -> None:
    both = await at_five()
    both.its.send(message)
    assert both.client.heard_at == (NOW if is_sign else 0.0)
    await both.client.__aexit__()


async def test_telemetry_is_kept_while_the_aircraft_is_connected() -> None:
    ours, its = memory_channels()
    async with AgentClient(ours, "front") as client:
        agent = KnownAgent(its, replace(CONNECTED, connection="lost"))
        agent.tell_package(0.0)
        assert (client.telemetry, client.unread) == (None, 1)
        agent.tell(CONNECTED)
        known = client.telemetry
        agent.tell_package(0.25)
        agent.tell(CONNECTED)
        assert known is not None
        assert client.telemetry is known, "it is not begun anew"
        assert known.newest_at == 0.25


async def test_what_a_replay_played_before_it_was_moved_is_void() -> None:
    ours, its = memory_channels()
    replay = Replay("f", 0.0, 5.0, 5.0, None, 0.0, 60.0, 1.0, False, False, False)
    async with AgentClient(ours, "front") as client:
        agent = KnownAgent(its, replace(CONNECTED, replay=replay))
        for at, newest in ((4.75, None), (5.0, 5.0), (5.25, 5.25), (4.9, 5.25)):
            agent.tell_package(at)
            assert client.telemetry is not None
            assert client.telemetry.newest_at == newest
        before = client.telemetry
        agent.tell(replace(CONNECTED, replay=replace(replay, since=5.5)))
        assert client.telemetry is not before, "of another place of the flight"
        agent.tell_package(5.4)
        assert client.telemetry is not None
        assert (client.telemetry.newest_at, client.unread) == (None, 0)


# -- the lease by the clock ------------------------------------------------------------------------


def test_times_and_names_of_leases() -> None:
    """Three seconds; ten to confirm a take-over; 64 characters that can be shown."""
    manager = LeaseManager()
    assert manager.remaining(0.0) == 0.0
    manager.acquire("a\n" + "b" * 99, 0.0)
    holder = manager.holder(1.0)
    assert holder is not None
    assert (holder.name, holder.number) == ("a" + "b" * 63, 1)
    assert [manager.remaining(at) for at in (0.5, 2.0)] == [2.5, 1.0]
    wanted = manager.ask_take_over(" \t", 2.5)
    assert (wanted.name, wanted.from_name, wanted.number) == ("unnamed", holder.name, 1)
    assert wanted.expires_at == 12.5
    for at in (2.9, 5.8, 8.7, 11.5):
        manager.renew(holder.token, at)
    assert manager.remaining(12.0) == 2.5
    assert manager.confirm(wanted.token, 12.49).number == 2
    with pytest.raises(LeaseRefused, match="unnamed has control"):
        manager.check(holder.token, 12.5)
    again = manager.ask_take_over("c", 12.5)
    manager.void_take_overs()
    with pytest.raises(LeaseRefused):
        manager.confirm(again.token, 12.6)
    with pytest.raises(ValueError, match="a lease of 0 s"):
        LeaseManager(lifetime=0)


def test_old_take_overs_make_room_for_new_ones() -> None:
    manager = LeaseManager(lifetime=1000.0)
    manager.acquire("a", 0.0)
    first = manager.ask_take_over("first", 1.0)
    second = manager.ask_take_over("second", 2.0)
    for number in range(1022):
        manager.ask_take_over(str(number), 2.0)
    assert manager.confirm(second.token, 3.0).name == "second"
    wanted = [manager.ask_take_over(str(number), 20.0) for number in range(1025)]
    with pytest.raises(LeaseRefused):
        manager.confirm(first.token, 20.0)
    with pytest.raises(LeaseRefused):
        manager.confirm(wanted[0].token, 20.0)
    assert manager.confirm(wanted[1].token, 20.0).name == "1"


def test_each_limit_is_as_agreed() -> None:
    assert limits.differences("apps/agent") == []
