"""A front's end of the channel: what it knows, and the answers that it gets."""

from __future__ import annotations

import asyncio
import random
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack
from functools import partial
from typing import Any

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient, Hearing, PendingRequests
from m100link.apps.agent.lease import Lease, LeaseHeld, LeaseRefused
from m100link.apps.agent.messages import (
    VERSION,
    Ask,
    Hello,
    Message,
    OrderOutcome,
    PlanChanged,
    RemoteError,
    Stage,
    State,
    Telemetry,
    agent_gone,
)
from m100link.apps.agent.orders import ChangeHeight
from m100link.apps.agent.server.agent import Agent
from m100link.apps.agent.server.connection import by_driver
from m100link.apps.agent.server.server import AgentServer
from m100link.apps.agent.transports import MemoryChannel, memory_channels
from m100link.errors import (
    GuardRefused,
    LinkError,
    LinkLost,
    M100Error,
    NoAuthority,
    TaskRefused,
)
from m100link.missions.plan import Waypoint, WaypointPlan
from m100link.protocol.records import Attitude
from m100link.protocol.setpoint import Setpoint
from m100link.telemetry.sample import Sample
from m100link.telemetry.subscription import Newest, Subscription
from tests.aircraft.test_other_loop import assert_told, elsewhere, entered, plainly
from tests.apps.agent.conftest import Rig

pytestmark = pytest.mark.anyio

NORTH = Setpoint.velocity(north=1.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


@pytest.fixture
async def clients(rig: Rig) -> AsyncIterator[list[AgentClient]]:
    rig.agent.leases.release(rig.token, rig.agent.now)
    service = AgentServer(rig.agent)
    async with AsyncExitStack() as stack:
        made = []
        for name in ("first", "second"):
            ours, its = memory_channels(as_bytes=True)
            service.attach(its)
            made.append(await stack.enter_async_context(AgentClient(ours, name)))
        yield made


async def test_telemetry_has_ages_and_subscriptions(rig: Rig, clients: list[AgentClient]) -> None:
    client = clients[0]
    heard: list[Sample] = []
    client.on_sample.append(heard.append)
    async with client.samples(Newest(5)) as samples:
        sample = await anext(samples)
    assert heard[0] is sample
    assert client.telemetry is not None
    assert sample.received_at <= rig.agent.now
    await anyio.sleep(0.5)
    assert client.telemetry.age(Attitude) == pytest.approx(0.0, abs=0.03)
    rig.aircraft.stall_line()
    await anyio.sleep(1.5)
    assert client.telemetry.age(Attitude) == pytest.approx(1.5, abs=0.1)


async def test_leases_are_seen_by_all(rig: Rig, clients: list[AgentClient]) -> None:
    first, second = clients
    lease = await first.acquire("first")
    assert first.holds(lease)
    assert second.holder.name == "first"
    assert first.check(lease) is lease
    with pytest.raises(LeaseHeld) as caught:
        await second.acquire("second")
    assert caught.value.holder == "first"
    taken = await second.confirm((await second.ask_take_over("second")).token)
    assert not first.holds(lease)
    with pytest.raises(LeaseRefused, match="second has control"):
        first.check(lease)
    with pytest.raises(LeaseRefused):
        await first.ask(orders.RenewLease(lease.token))
    await second.release_lease(taken.token)
    assert first.holder.number == 0


async def test_errors_are_those_of_the_agent(rig: Rig, clients: list[AgentClient]) -> None:
    first, second = clients
    with pytest.raises(LeaseRefused):
        await first.ask(orders.TakeOff(), None)
    lease = await first.acquire("first")
    with pytest.raises(NoAuthority):
        await first.ask(orders.TakeOff(), lease)
    await first.ask(orders.Obtain(), lease)
    begun = anyio.Event()
    async with anyio.create_task_group() as group:

        async def alive() -> None:
            while True:
                first.keep(lease)
                await anyio.sleep(0.5)

        group.start_soon(alive)
        async with anyio.create_task_group() as flight:
            flight.start_soon(first.ask, orders.TakeOff(), lease, begun.set)
            await begun.wait()
            with pytest.raises(TaskRefused, match="during take off"):
                await first.ask(orders.Land(), lease)
            assert second.state.task == "take off"
        group.cancel_scope.cancel()
    with pytest.raises(M100Error, match="no simple task"):
        await first.ask(orders.FlyPattern(77), lease)


async def test_a_refused_setpoint_is_reported(rig: Rig, clients: list[AgentClient]) -> None:
    client = clients[0]
    told: list[tuple[int, M100Error]] = []
    client.on_steer_refused.append(lambda fence, error: told.append((fence, error)))
    lease = await client.acquire("first")
    client.steer(lease, NORTH)
    ((fence, error),) = told
    assert fence == lease.number
    assert isinstance(error, NoAuthority)


async def test_letting_go_stops_at_once(rig: Rig, clients: list[AgentClient]) -> None:
    client = clients[0]
    lease = await client.acquire("first")
    await client.ask(orders.Obtain(), lease)
    client.let_go(lease)
    assert not client.holds(lease)
    await rig.until(lambda: client.state.holding == "none", within=1.0)


async def test_a_pilot_who_takes_over_is_reported(rig: Rig, clients: list[AgentClient]) -> None:
    client = clients[0]
    lost: list[str] = []
    client.on_authority_taken.append(lambda error: lost.append(error.reason))
    lease = await client.acquire("first")
    await client.ask(orders.Obtain(), lease)
    rig.aircraft.leave_f()
    await rig.until(lambda: bool(lost), within=1.0)
    assert lost == ["mode_switch"]
    assert client.state.holding in ("paused", "taken")


async def test_a_lost_line_takes_the_values_with_it(rig: Rig, clients: list[AgentClient]) -> None:
    client = clients[0]
    await rig.until(lambda: client.telemetry is not None)
    rig.aircraft.unplug()
    await rig.until(lambda: not client.is_connected)
    assert client.telemetry is None
    assert client.state.connection_fault is not None
    with pytest.raises(LinkError):
        await client.ask(orders.AskVersion())
    rig.aircraft.replug()
    await rig.until(lambda: client.is_connected)
    assert client.telemetry is not None


async def test_an_agent_that_has_gone_is_reported_and_everything_grows_old(
    rig: Rig, clients: list[AgentClient]
) -> None:
    ours, its = memory_channels()
    async with AgentClient(ours, "front") as client:
        its.open(lambda message: None, lambda reason: None)
        its.send(State(at=0.0, connection="connected", has_authority=True, holding="held"))
        aircraft = rig.agent.connection.aircraft
        assert aircraft is not None
        async with aircraft.telemetry(Attitude) as samples:
            sample = await anext(samples)
        its.send(Telemetry(sample.value, sample.profile.name, rig.agent.now))
        async with anyio.create_task_group() as group:

            async def ask() -> None:
                with pytest.raises(LinkError, match="has gone: killed"):
                    await client.ask(orders.AskVersion())

            group.start_soon(ask)
            await anyio.sleep(0.1)
            its.close("killed")
        assert not client.is_connected
        assert not client.state.has_authority
        await anyio.sleep(5.0)
        assert client.telemetry is not None
        assert client.telemetry.age(Attitude) == pytest.approx(5.1, abs=0.01)
        with pytest.raises(LinkError, match="has gone"):
            await client.acquire("anybody")


async def test_an_agent_of_another_version_is_left(rig: Rig) -> None:
    ours, its = memory_channels()
    async with AgentClient(ours, "front") as client:
        its.send(Hello(VERSION + 1, "agent", 0.0))
        assert client.state.connection_fault is not None
        assert "version" in client.state.connection_fault.seen


async def test_telemetry_that_cannot_be_read_is_counted(rig: Rig) -> None:
    ours: MemoryChannel
    ours, its = memory_channels()
    async with AgentClient(ours, "front") as client:
        its.send(State(at=0.0, connection="connected"))
        its.send(Telemetry(b"\0", "1.0", 0.0))
        its.send(Telemetry(b"\0\0", "9.9", 0.0))
        assert client.unread == 2


async def test_another_agent_takes_the_place_of_one_that_has_gone(
    rig: Rig, clients: list[AgentClient]
) -> None:
    client = clients[0]
    lease = await client.acquire("first")
    told: list[str] = []
    client.on_event.append(lambda event: told.append(event.text))
    rig.agent.journal.note("before")
    await anyio.sleep(0.1)
    numbers = [event.number for event in client.events]
    client._channel.close("for the test")
    client._closed("for the test")
    assert client.is_gone
    assert not client.is_connected
    async with Agent(by_driver(rig.driver), leases_before=1_000_000) as other:
        ours, its = memory_channels(as_bytes=True)
        AgentServer(other).attach(its)
        client.reopen(ours)
        assert not client.holds(lease)
        other.journal.note("after")
        await anyio.sleep(0.1)
        assert told.count("after") == 1
        assert told.count("before") == 1
        assert [event.number for event in client.events][: len(numbers)] == numbers
        assert client.events[-1].number > numbers[-1]
        anew = await client.acquire("first")
        assert anew.number == 1_000_001
        assert client.holds(anew)
        assert not client.holds(lease)


async def test_an_agent_that_is_reached_again_tells_nothing_twice(
    rig: Rig, clients: list[AgentClient]
) -> None:
    client = clients[0]
    rig.agent.journal.note("once")
    await anyio.sleep(0.1)
    client._channel.close("for the test")
    client._closed("for the test")
    ours, its = memory_channels(as_bytes=True)
    AgentServer(rig.agent).attach(its)
    client.reopen(ours)
    await anyio.sleep(0.1)
    assert [event.text for event in client.events].count("once") == 1
    assert client.is_connected


async def test_where_somebody_points_and_the_plan_are_known_to_all(
    rig: Rig, clients: list[AgentClient]
) -> None:
    first, second = clients
    lease = await first.acquire("first")
    rig.agent.background.spawn(_keeping(first, lease), "keeping")
    await first.ask(orders.Obtain(), lease)
    await first.ask(orders.TakeOff(), lease)
    began: list[bool] = []
    await first.ask(ChangeHeight(6.0), lease, lambda: began.append(True))
    assert began == [True]
    assert rig.aircraft.height == pytest.approx(6.0, abs=0.5)
    with pytest.raises(GuardRefused, match="the envelope ends at 50 m"):
        await first.ask(ChangeHeight(60.0), lease)
    with pytest.raises(LeaseRefused):
        await second.ask(ChangeHeight(5.0), None)
    plan = WaypointPlan([Waypoint(52.1, 4.31, height=20), Waypoint(52.1003, 4.31, height=25)])
    await first.ask(orders.UploadPlan.of(plan), lease)
    assert second.plan == orders.UploadPlan.of(plan).plan()
    assert second.plan_by == "first"
    await first.release_lease(lease.token)
    assert [second.plan, second.plan_by] == [None, ""]


async def _keeping(client: AgentClient, lease: Lease) -> None:
    while True:
        await anyio.sleep(0.5)
        client.keep(lease)


async def test_a_plan_that_cannot_be_read_is_counted(rig: Rig) -> None:
    ours, its = memory_channels()
    async with AgentClient(ours, "front") as client:
        its.open(lambda _: None, lambda _: None)
        its.send(PlanChanged("somebody", orders.UploadPlan(b"\x02", (b"\xff",))))
        assert (client.plan, client.unread) == (None, 1)


async def test_the_old_name_of_hover_warns_and_hovers() -> None:
    ours, its = memory_channels()
    heard: list[object] = []
    async with AgentClient(ours, "front") as client:
        its.open(heard.append, lambda _: None)
        with pytest.warns(DeprecationWarning, match="AgentClient.halt is hover now"):
            client.halt("a child")
        await anyio.sleep(0.01)
    assert [one.order for one in heard if isinstance(one, Ask)] == [orders.Halt("a child")]


CALLS: dict[str, Callable[[AgentClient, Lease], Awaitable[object]]] = {
    "acquire": lambda c, lease: c.acquire("other"),
    "ask": lambda c, lease: c.ask(orders.Land(), lease),
    "confirm": lambda c, lease: c.confirm("code"),
    "enter": lambda c, lease: entered(c),
    "from_mobile": lambda c, lease: first_of(c.from_mobile(Newest(1))),
    "hover": lambda c, lease: plainly(lambda: c.hover("other", lease)),
    "keep": lambda c, lease: plainly(lambda: c.keep(lease)),
    "leave": lambda c, lease: c.__aexit__(None, None, None),
    "let_go": lambda c, lease: plainly(lambda: c.let_go(lease)),
    "note": lambda c, lease: plainly(lambda: c.note("other")),
    "reopen": lambda c, lease: plainly(lambda: c.reopen(memory_channels()[0])),
    "samples": lambda c, lease: first_of(c.samples(Newest(1))),
    "steer": lambda c, lease: plainly(lambda: c.steer(lease, NORTH.neutral())),
    "stop": lambda c, lease: c.stop(),
}


async def first_of(values: Subscription[Any]) -> object:
    async with values:
        return await anext(values)


async def test_another_event_loop_is_refused_and_the_owner_flies_on(
    rig: Rig, clients: list[AgentClient]
) -> None:
    client = clients[0]
    lease = await client.acquire("first")

    async def keep() -> None:
        while True:
            client.keep(lease)
            await anyio.sleep(0.5)

    client.background.spawn(keep(), "lease")
    await client.ask(orders.Obtain(), lease)
    await client.ask(orders.TakeOff(), lease)
    for name, call in CALLS.items():
        client.steer(lease, NORTH)
        told, before = len(rig.agent.journal.events), asyncio.all_tasks()
        assert_told(elsewhere(partial(call, client, lease)), name)
        assert asyncio.all_tasks() == before, name
        await anyio.sleep(0.2)
        assert rig.aircraft.autopilot.received_movements[-1].roll_or_x == NORTH.x, name
        assert client.holds(lease), name
        assert len(rig.agent.journal.events) == told, name
    await client.ask(orders.Release(), lease)


async def test_an_agent_that_is_started_again_is_heard_from_then_on(
    rig: Rig, clients: list[AgentClient]
) -> None:
    client = clients[0]
    client._channel.close("gone")
    await anyio.sleep(10.0)
    before = client.view
    client.reopen(memory_channels()[0])
    hearing = before.hearing, client.view.hearing
    assert hearing == (Hearing.SILENT, Hearing.HEARD)  # it has two seconds for its first word


# -- questions: asked, begun, over or unknown ------------------------------------------------------


REFUSED = RemoteError.of(TaskRefused("no"))
TOLD: dict[str, Callable[[PendingRequests, int], None]] = {
    "begun": lambda answers, number: answers.outcome(OrderOutcome(number, Stage.ACCEPTED)),
    "done": lambda answers, number: answers.outcome(OrderOutcome(number, Stage.DONE, text="it")),
    "refused": lambda answers, number: answers.outcome(OrderOutcome(number, Stage.FAILED, REFUSED)),
    "gone": lambda answers, _: answers.end(agent_gone("killed")),
    "another": lambda answers, number: answers.outcome(OrderOutcome(number + 1, Stage.DONE)),
}
ENDS: dict[str, object] = {"done": "it", "refused": TaskRefused, "gone": LinkLost}


async def became(asked: asyncio.Task[OrderOutcome]) -> object:
    """The answer that the asker got: a text, the kind of an error, or None for nothing."""
    for _ in range(3):
        await asyncio.sleep(0)
    if not asked.done():
        return None
    error = asked.exception()
    return asked.result().text if error is None else type(error)


# A state and the answer in it: how often it has begun then, and what the asker got.
# What is over stays as it is, whatever comes in the same turn of the loop.
AFTER: dict[tuple[str, str], tuple[int, object]] = {
    ("asked", "begun"): (1, None),
    ("asked", "done"): (0, "it"),
    ("asked", "refused"): (0, TaskRefused),
    ("asked", "gone"): (0, LinkLost),
    ("asked", "another"): (0, None),
    ("begun", "begun"): (1, None),
    ("begun", "done"): (1, "it"),
    ("begun", "refused"): (1, TaskRefused),
    ("begun", "gone"): (1, LinkLost),
    ("begun", "another"): (1, None),
    **{(state, told): (0, end) for state, end in ENDS.items() for told in TOLD},
}


@pytest.mark.parametrize(("state", "told"), AFTER)
async def test_what_becomes_of_a_question(state: str, told: str) -> None:
    begun: list[int] = []
    answers = PendingRequests(lambda _: None)
    asking = answers.question(orders.Land(), 0, lambda: begun.append(1))
    asked = asyncio.create_task(asking)
    await asyncio.sleep(0)
    if state != "asked":
        TOLD[state](answers, 1)
    TOLD[told](answers, 1)
    found = await became(asked)
    assert (len(begun), found) == AFTER[state, told]
    asked.cancel()
    await asyncio.wait({asked})
    TOLD["begun"](answers, 1)  # nobody waits for it any more
    assert len(begun) == AFTER[state, told][0]


def test_every_state_and_input_of_a_question_has_its_row() -> None:
    assert set(AFTER) == {(state, told) for state in ("asked", "begun", *ENDS) for told in TOLD}


@pytest.mark.parametrize("seed", range(5))
async def test_many_answers_in_any_order_reach_their_askers(seed: int) -> None:
    """Twice, after the end, of numbers that nobody asked; some wait no more, and the agent dies."""
    chance, sent = random.Random(seed), list[Message]()
    answers = PendingRequests(sent.append)
    begun: list[int] = []
    expected: dict[int, object] = {}
    asked: dict[int, asyncio.Task[OrderOutcome]] = {}
    for number in range(1, 301):
        began = partial(begun.append, number)
        asked[number] = asyncio.create_task(answers.question(orders.Land(), 0, began))
    await asyncio.sleep(0)
    assert [one.id for one in sent if isinstance(one, Ask)] == list(asked)
    left = set(chance.sample(list(asked), 30))
    for number in left:
        asked[number].cancel()
    for _ in range(1500):
        number, told = chance.randrange(-5, 320), chance.choice(["begun", "done", "refused"])
        TOLD[told](answers, number)
        if told != "begun":
            expected.setdefault(number, ENDS[told])
    answers.end(agent_gone("killed"))
    answers.gone = None  # another agent
    for number in asked:
        TOLD["done"](answers, number)
    for number, task in asked.items():
        if number not in left:
            assert await became(task) == expected.get(number, LinkLost)
    assert len(begun) == len(set(begun))
    assert not left & set(begun)


async def test_of_what_is_asked_in_the_instant_of_a_stop_the_stop_counts(
    clients: list[AgentClient],
) -> None:
    """And what this client asks for once it has heard of it is later than that."""
    client, other = clients
    asked_at = client.asked_at
    await other.stop()
    assert client.stopped_at == asked_at
    with pytest.raises(GuardRefused, match="STOP was pressed after acquire lease"):
        await client.acquire("first", asked_at)
    assert client.asked_at > client.stopped_at
    assert (await client.acquire("first")).name == "first"


async def test_a_stop_by_a_person_in_the_instant_of_an_order_overtakes_its_steps(
    clients: list[AgentClient],
) -> None:
    """That of the order itself does not; one more, whenever it came, does."""
    client, other = clients
    asked_at = client.asked_at
    assert await client.end_task(asked_at) > client.stopped_at
    await anyio.sleep(1.0)
    asked_at = client.asked_at
    await other.stop()
    assert client.stopped_at == asked_at
    assert await client.end_task(asked_at) == asked_at
