"""Control of one pilot as a table: every pair of state and input, by hand; and what it does."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Coroutine
from contextlib import AsyncExitStack, nullcontext
from random import Random
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.control_session import (
    TRANSITIONS,
    ControlInput,
    ControlSession,
    ControlState,
    Terms,
)
from m100link.apps.agent.lease import Lease, LeaseHeld
from m100link.apps.agent.messages import (
    LeaseChanged,
)
from m100link.apps.agent.server.server import AgentServer
from m100link.apps.agent.transports import MemoryChannel, memory_channels
from m100link.errors import (
    AckTimeout,
    GuardRefused,
    LinkError,
    M100Error,
    MissionRunning,
    NoAuthority,
    NotObserved,
    StaleLease,
    TaskRefused,
)
from m100link.protocol.setpoint import Setpoint
from tests.apps.agent.conftest import Rig, hears_late, pattern_of
from tests.rig import put_in_the_air

S, I = ControlState, ControlInput  # noqa: E741 - a table is read by its columns

# One line for each state; a dot means that nothing changes. The columns:
COLUMNS = (
    *(I.ASKED, I.GRANTED, I.ACTIVATE, I.OBTAIN, I.OBEYED, I.REFUSED, I.STOP, I.BEGUN_ANEW),
    *(I.LET_GO, I.GIVEN_BACK, I.AUTHORITY_TAKEN, I.ENDED, I.OTHER),
)
TABLE = """
            ASKED  GRANTED ACTIVATE   OBTAIN    OBEYED  REFUSED    STOP    ANEW    LET_GO     BACK   TAKEN     ENDED  OTHER
ABSENT      ASKING LEASED  .          .         .       .          .       .       .          .      .         .      .
ASKING      .      LEASED  .          .         .       ABSENT     .       .       LETTING_GO .      .         .      .
LEASED      .      .       ACTIVATING OBTAINING .       .          .       .       LETTING_GO .      .         LOST   TAKEN_OVER
ACTIVATING  .      LEASED  .          OBTAINING .       .          .       .       LETTING_GO .      .         LOST   TAKEN_OVER
OBTAINING   .      LEASED  .          .         HOLDING .          STOPPED .       LETTING_GO .      .         LOST   TAKEN_OVER
HOLDING     .      LEASED  .          OBTAINING .       .          STOPPED .       LETTING_GO .      SUSPENDED LOST   TAKEN_OVER
STOPPED     .      LEASED  .          OBTAINING .       .          .       HOLDING LETTING_GO .      SUSPENDED LOST   TAKEN_OVER
SUSPENDED   .      LEASED  .          OBTAINING HOLDING .          .       .       LETTING_GO .      .         LOST   TAKEN_OVER
LETTING_GO  .      LEASED  .          .         .       ABSENT     .       .       .          ABSENT .         ABSENT ABSENT
LOST        ASKING LEASED  .          .         .       .          .       .       ABSENT     .      .         .      .
TAKEN_OVER  ASKING LEASED  .          .         .       .          .       .       ABSENT     .      .         .      .
"""  # noqa: E501 - a table

NORTH = Setpoint.velocity(north=1.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


def pairs() -> list[tuple[ControlState, ControlInput, ControlState]]:
    rows = [line.split() for line in TABLE.strip().splitlines()[1:]]
    assert [S[row[0]] for row in rows] == list(S)
    assert tuple(I) == COLUMNS
    return [
        (S[name], what, S[name] if cell == "." else S[cell])
        for name, *cells in rows
        for what, cell in zip(COLUMNS, cells, strict=True)
    ]


@pytest.mark.parametrize(("state", "what", "expected"), pairs())
def test_every_pair(state: ControlState, what: ControlInput, expected: ControlState) -> None:
    assert TRANSITIONS[state].get(what, state) is expected


# -- what it does ---------------------------------------------------------------------------------

pytestmark = pytest.mark.anyio


class Pilots:
    """Two fronts of one agent, each with its own way to it."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.service = AgentServer(rig.agent)
        self.ways: list[MemoryChannel] = []
        self.clients: list[AgentClient] = []


@pytest.fixture
async def pilots(rig: Rig) -> AsyncIterator[Pilots]:
    rig.renewing.cancel()
    rig.agent.leases.release(rig.token, rig.agent.now)
    found = Pilots(rig)
    async with AsyncExitStack() as stack:
        for name in ("first", "second"):
            ours, its = memory_channels(as_bytes=True)
            found.service.attach(its)
            found.ways.append(its)
            found.clients.append(await stack.enter_async_context(AgentClient(ours, name)))
        yield found


def session(pilots: Pilots, number: int = 0, **terms: object) -> ControlSession:
    name = ("first", "second")[number]
    return ControlSession(pilots.clients[number], name, Terms(**terms))  # type: ignore[arg-type]


def at(one: ControlSession) -> ControlState:
    return one.state


async def test_taken_kept_and_given_back(pilots: Pilots) -> None:
    one, agent = session(pilots), pilots.rig.agent
    assert (at(one), one.lease_end, one.loss) == (S.ABSENT, None, None)
    with pytest.raises(NoAuthority, match=r"this client has no control; nothing was sent"):
        one.held()
    await one.obtain()
    assert at(one) is S.HOLDING
    assert one.has_control
    for _ in range(20):  # longer than three lifetimes of a lease
        await anyio.sleep(0.5)
        one.heard()
    assert agent.holding.has_authority
    with patch.object(pilots.clients[0], "keep") as keep:
        for _ in range(20):
            await anyio.sleep(0.05)
            one.heard()
    assert 2 <= keep.call_count <= 3, "twice a second, however often it is heard"
    await one.give_back()
    assert at(one) is S.ABSENT
    assert pilots.clients[0].holder.number == 0
    await pilots.rig.until(lambda: not agent.holding.has_authority)


async def test_a_client_that_falls_silent_loses_it_after_a_lifetime(pilots: Pilots) -> None:
    one = session(pilots)
    await one.obtain()
    await anyio.sleep(2.9)
    assert one.has_lease
    await anyio.sleep(0.3)
    assert at(one) is S.LOST
    assert one.lease_end is not None
    one.heard()  # too late: an ended lease never returns
    await anyio.sleep(0.1)
    assert pilots.clients[0].holder.number == 0
    await one.obtain()
    assert at(one) is S.HOLDING
    assert one.lease_end is None


async def test_another_pilot_takes_over(pilots: Pilots) -> None:
    one, other = session(pilots), session(pilots, 1)
    await one.obtain()
    with pytest.raises(LeaseHeld):
        await other.obtain()
    assert at(other) is S.ABSENT
    await other.obtain(take_over=True)
    assert (at(one), at(other)) == (S.TAKEN_OVER, S.HOLDING)
    assert one.lease_end is not None
    assert one.lease_end.name == "second"
    one.let_go()  # which takes nothing from anybody
    await anyio.sleep(0.1)
    assert other.has_control


@pytest.mark.parametrize("told", [LeaseChanged(0, ""), LeaseChanged(1000, "nobody")])
async def test_a_lease_that_was_reported_as_ended_and_is_in_force(
    pilots: Pilots, told: LeaseChanged
) -> None:
    """As by a stranger on a network, or after a silence there: control is asked for anew."""
    one, client = session(pilots), pilots.clients[0]
    await one.obtain()
    true = client.holder
    client._receive(told)
    assert at(one) in (S.LOST, S.TAKEN_OVER)
    assert not one.has_control
    client._receive(true)
    assert at(one) is S.LEASED
    assert one.lease_end is None
    await one.obtain()
    assert at(one) is S.HOLDING


async def test_stop_stands_until_it_is_begun_anew(pilots: Pilots) -> None:
    one, other = session(pilots), pilots.clients[1]
    await one.obtain()
    await other.stop()
    assert at(one) is S.STOPPED
    refused: list[M100Error] = []
    pilots.clients[0].on_steer_refused.append(lambda _, error: refused.append(error))
    one.steer(NORTH)
    await anyio.sleep(0.1)
    assert "STOP was pressed" in refused[0].seen
    one.begin_anew()
    assert at(one) is S.HOLDING


async def obtaining(one: ControlSession) -> asyncio.Task[None]:
    """A request for control that has come so far."""
    has_begun = asyncio.Event()
    one.on_change = lambda state: has_begun.set() if state is S.OBTAINING else None
    asking = asyncio.create_task(one.obtain())
    await has_begun.wait()
    return asking


@pytest.mark.parametrize("turns", [0, 2, 5])
async def test_stop_while_control_is_obtained_stands(pilots: Pilots, turns: int) -> None:
    """The agent flies no setpoint then, and the front has to say so from the beginning."""
    one, other = session(pilots), pilots.clients[1]
    asking = await obtaining(one)
    for _ in range(turns):
        await asyncio.sleep(0.0)
    assert at(one) is S.OBTAINING
    await other.stop()
    await asking
    refused: list[M100Error] = []
    one.on_refused = refused.append
    assert at(one) is S.STOPPED
    one.steer(NORTH)
    await anyio.sleep(0.1)
    assert [type(error).__name__ for error in refused] == ["GuardRefused"]
    one.begin_anew()
    assert at(one) is S.HOLDING
    one.steer(NORTH)
    await anyio.sleep(0.1)
    assert len(refused) == 1


@pytest.mark.parametrize("how", ["stop", "begin_anew"])
async def test_a_front_that_fails_to_show_it_has_stopped_it(pilots: Pilots, how: str) -> None:
    one, rig, client = session(pilots), pilots.rig, pilots.clients[0]

    def fails(_: ControlState) -> None:
        raise RuntimeError("no picture can be drawn")

    await one.obtain()
    async with one.kept():
        await client.ask(orders.TakeOff(), one.lease)
        if how == "begin_anew":
            await pilots.clients[1].stop()
            await client.ask(orders.Obtain(), one.lease)  # past the session, which is stopped
        await client.ask(orders.FlyPattern(1), one.lease)
        await rig.until(lambda: rig.aircraft.vehicle.flight.dynamics.speed > 0.3)
        one.on_change = fails
        with pytest.raises(RuntimeError):
            one.begin_anew() if how == "begin_anew" else await one.stop()
        assert pattern_of(rig.agent) is None
        await anyio.sleep(1.5)
        assert rig.aircraft.vehicle.flight.dynamics.speed < 0.1


@pytest.mark.parametrize("state", [S.ASKING, S.LEASED])
async def test_control_that_was_asked_for_before_a_stop_is_not_obtained(
    pilots: Pilots, state: ControlState
) -> None:
    one, agent = session(pilots), pilots.rig.agent
    hears_late(pilots.ways[0], 0.01)

    def changed(now: ControlState) -> None:
        if now is state:
            agent.background.spawn(agent.stop(), "stop")

    one.on_change = changed
    with pytest.raises(GuardRefused, match="STOP was pressed after"):
        await one.obtain()
    await anyio.sleep(0.5)
    assert at(one) is S.ABSENT
    assert agent.leases.holder(agent.now) is None
    assert not agent.holding.has_authority
    one.on_change = lambda _: None
    await one.obtain()  # asked for after it
    assert at(one) is S.HOLDING


async def test_a_request_that_a_stop_overtook_is_refused_where_its_front_hears_of_none(
    pilots: Pilots,
) -> None:
    """Drawn (seed 1002): its front stands still, and takes its last step after the STOP."""
    one, client = session(pilots), pilots.clients[0]
    client.on_event.clear()

    async def slow(_: float) -> Lease:
        await anyio.sleep(1.0)
        return await client.acquire("first")

    asked = [asyncio.create_task(one.take(slow)), asyncio.create_task(one.obtain())]
    await anyio.sleep(0.5)
    await pilots.clients[1].stop()
    _, end = await asyncio.gather(*asked, return_exceptions=True)
    assert isinstance(end, GuardRefused)
    assert end.seen == "STOP was pressed after obtain was asked for; nothing was sent"
    assert at(one) is S.ABSENT


@pytest.mark.parametrize("step", ["AcquireLease", "AskTakeOver", "ConfirmTakeOver", "Obtain"])
async def test_a_stop_before_a_step_of_a_take_over_ends_all_of_it(
    pilots: Pilots, step: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its front hears of no STOP, and makes every step that is left after it."""
    one, other, agent = session(pilots), session(pilots, 1), pilots.rig.agent
    client, asked = pilots.clients[0], pilots.clients[0].ask
    client.on_event.clear()
    await other.obtain()
    steps: list[str] = []

    async def ask(order: orders.Order, *rest: Any, **more: Any) -> Any:
        await anyio.sleep(0.05)
        steps.append(type(order).__name__)
        if steps[-1] == step:
            await agent.stop()
        return await asked(order, *rest, **more)

    monkeypatch.setattr(client, "ask", ask)
    with pytest.raises(GuardRefused, match="STOP was pressed after"):
        await one.obtain(take_over=True)
    assert steps[-1] == step
    assert at(one) is S.ABSENT
    await anyio.sleep(0.1)
    # The other's lease was not taken, or the own one, from before the STOP, went back.
    assert client.holder.number == (0 if step == "Obtain" else 2)


async def test_a_client_that_let_go_before_a_stop_does_not_undo_it(pilots: Pilots) -> None:
    one, client = session(pilots), pilots.clients[0]
    await one.obtain()
    await anyio.sleep(1.0)
    let_go_at = client.now
    await anyio.sleep(0.1)
    await pilots.clients[1].stop()
    refused: list[M100Error] = []
    one.on_refused = refused.append
    assert not one.begin_anew(at=let_go_at)
    assert not one.begin_anew(at=client.stopped_at)  # of both in one instant the STOP counts
    assert at(one) is S.STOPPED
    one.steer(NORTH)
    await anyio.sleep(0.1)
    assert "STOP was pressed" in refused[0].seen
    assert one.begin_anew(at=client.now)
    one.steer(NORTH)
    await anyio.sleep(0.1)
    assert len(refused) == 1


@pytest.mark.parametrize("begins_anew", [False, True])
async def test_stop_while_control_is_obtained_in_vain(pilots: Pilots, begins_anew: bool) -> None:
    one, other, rig = session(pilots), pilots.clients[1], pilots.rig
    rig.aircraft.set_rc_mode("P")
    asking = await obtaining(one)
    await other.stop()
    assert at(one) is S.STOPPED
    if begins_anew:
        one.begin_anew()
    with pytest.raises(M100Error):
        await asking
    assert at(one) is S.ABSENT
    await anyio.sleep(0.1)
    assert pilots.clients[0].holder.number == 0


async def test_the_agent_goes_while_control_is_obtained(pilots: Pilots) -> None:
    one = session(pilots)
    asking = await obtaining(one)
    pilots.ways[0].close("killed")
    with pytest.raises(LinkError):
        await asking
    assert at(one) is S.ABSENT


@pytest.mark.parametrize("gives_way", [False, True])
async def test_the_pilot_takes_it_and_comes_back(pilots: Pilots, gives_way: bool) -> None:
    one, rig = session(pilots, gives_way=gives_way), pilots.rig
    await one.obtain()
    async with one.kept():
        rig.aircraft.set_rc_mode("P")
        await anyio.sleep(1.0)
        assert at(one) is (S.ABSENT if gives_way else S.SUSPENDED)
        assert one.has_lease is not gives_way
        assert not one.has_control
        rig.aircraft.set_rc_mode("F")
        await anyio.sleep(4.0)
        assert at(one) is (S.ABSENT if gives_way else S.HOLDING)
        assert one.has_control is not gives_way


async def test_an_idle_pilot_gives_it_back(pilots: Pilots) -> None:
    one = session(pilots, idle_s=5.0)
    await one.obtain()
    began = pilots.clients[0].now
    while one.has_lease:
        one.heard(is_idle=True)
        await anyio.sleep(0.5)
    assert pilots.clients[0].now - began == pytest.approx(5.5, abs=0.6)


async def test_the_agent_goes(pilots: Pilots) -> None:
    one = session(pilots)
    await one.obtain()
    pilots.ways[0].close("killed")
    await anyio.sleep(0.1)
    assert at(one) is S.LOST
    assert not one.has_control
    with pytest.raises(NoAuthority, match=r"the agent .* has gone; nothing was sent"):
        one.steer(NORTH)
    with pytest.raises(LinkError):
        await one.obtain()
    assert at(one) is S.ABSENT


@pytest.mark.parametrize("is_looked_at", [False, True])
async def test_a_lease_of_the_same_number_at_the_next_agent_is_somebody_elses(
    pilots: Pilots, is_looked_at: bool
) -> None:
    """As of an agent without its order log, which counts anew."""
    one, client = session(pilots), pilots.clients[0]
    await one.obtain()
    number = one.held().number
    pilots.ways[0].close("killed")
    if is_looked_at:
        assert at(one) is S.LOST
    ours, its = memory_channels(as_bytes=True)
    its.send(LeaseChanged(number, "somebody else"))
    client.reopen(ours)
    assert client.holder.number == number
    assert not one.has_lease
    assert one.is_others
    assert at(one) in (S.LOST, S.TAKEN_OVER)
    with pytest.raises(NoAuthority):
        one.steer(NORTH)


async def test_whenever_it_is_let_go_nothing_stays_held(pilots: Pilots) -> None:
    """Let go, or cancelled, at any moment of the request: drawn, 60 of them."""
    seed, agent = 31, pilots.rig.agent
    draw = Random(seed)
    for attempt in range(60):
        one = session(pilots)
        asking = asyncio.create_task(one.obtain())
        for _ in range(draw.randrange(1, 40)):
            await asyncio.sleep(draw.choice([0.0, 0.0, 0.0, 0.02]))
        had_ended = asking.done()
        if is_cancelled := draw.random() < 0.5:
            asking.cancel()
        else:
            one.let_go()
        (ended,) = await asyncio.gather(asking, return_exceptions=True)
        assert ended is None or isinstance(ended, NoAuthority | asyncio.CancelledError)
        assert is_cancelled or (ended is None) is had_ended, (seed, attempt)
        if is_cancelled and ended is None:
            one.let_go()
        await anyio.sleep(0.5)
        assert at(one) is S.ABSENT, (seed, attempt)
        assert agent.leases.holder(agent.now) is None, (seed, attempt)
        assert not agent.holding.has_authority, (seed, attempt)
        one.close()


@pytest.mark.parametrize("error", [None, TaskRefused("busy")])
async def test_control_that_is_let_go_while_it_is_asked_for_is_not_obtained(
    pilots: Pilots, error: M100Error | None
) -> None:
    one, client = session(pilots), pilots.clients[0]
    asks = client.ask

    async def ask(order: orders.Order, *rest: Any, **more: Any) -> Any:
        if not isinstance(order, orders.Obtain):
            return await asks(order, *rest, **more)
        one.let_go()
        if error is not None:
            raise error
        return None

    with patch.object(client, "ask", ask), pytest.raises(NoAuthority):
        await one.obtain()
    assert at(one) is S.ABSENT


async def test_what_waits_behind_a_request_that_is_let_go_is_not_wanted_either(
    pilots: Pilots,
) -> None:
    one, agent = session(pilots), pilots.rig.agent
    asked = [asyncio.create_task(one.obtain()) for _ in range(3)]
    await asyncio.sleep(0.0)
    await one.give_back()
    ends = await asyncio.gather(*asked, return_exceptions=True)
    assert all(isinstance(end, NoAuthority) for end in ends), ends
    assert at(one) is S.ABSENT
    await anyio.sleep(0.5)
    assert agent.leases.holder(agent.now) is None
    await one.obtain()  # which was asked for later
    assert one.has_control


@pytest.mark.parametrize("turns", range(4))
async def test_control_is_had_again_after_giving_it_back_was_broken_off(
    pilots: Pilots, turns: int
) -> None:
    one = session(pilots)
    await one.obtain()
    ending = asyncio.create_task(one.give_back())
    for _ in range(turns):
        await asyncio.sleep(0.0)
    ending.cancel()
    await asyncio.gather(ending, return_exceptions=True)
    assert at(one) in (S.ABSENT, S.HOLDING)
    await one.obtain()
    assert at(one) is S.HOLDING


async def test_a_client_that_sends_while_the_pilot_flies_keeps_the_lease(pilots: Pilots) -> None:
    """The aircraft obeys again when the switch comes back to F."""
    one = session(pilots)
    refused: list[type[M100Error]] = []
    one.on_refused = lambda error: refused.append(type(error))
    await one.obtain()
    pilots.rig.aircraft.set_rc_mode("P")
    await anyio.sleep(1.0)
    for _ in range(60):
        await anyio.sleep(0.1)
        one.steer(NORTH)
    assert set(refused) == {GuardRefused}
    assert at(one) is S.SUSPENDED
    assert one.has_lease


async def test_an_operator_is_obeyed_that_knows_it_and_was_heard_since_the_last_loss(
    pilots: Pilots,
) -> None:
    one, rig = session(pilots), pilots.rig
    asking = asyncio.create_task(one.obtain())
    while not one.has_control:
        await asyncio.sleep(0.0)
        assert not one.is_obeyed
    await asking
    assert one.is_obeyed
    for mode, is_ours in (("P", False), ("F", True)):
        rig.aircraft.set_rc_mode(mode)
        await rig.until(lambda is_ours=is_ours: one.has_control is is_ours)  # type: ignore[misc]
        assert not one.is_obeyed
    one.heard()
    assert one.is_obeyed
    await pilots.clients[1].stop()
    assert one.is_obeyed, "it hovers, by this pilot's leave"


async def test_a_lease_on_its_way_back_is_nobody_elses(pilots: Pilots) -> None:
    one, other = session(pilots), session(pilots, 1)
    await one.obtain()
    assert (one.is_others, other.is_others) == (False, True)
    held = pilots.clients[0].holder
    one.let_go()
    pilots.clients[0].holder = held  # where it takes a while until the agent tells
    assert not one.is_others
    await anyio.sleep(0.1)
    await other.obtain()
    assert (one.is_others, other.is_others) == (True, False)


async def test_closed_it_hears_no_more(pilots: Pilots) -> None:
    client = pilots.clients[0]
    before = [len(one) for one in (client.on_lease, client.on_event, client.on_steer_refused)]
    one = session(pilots)
    await one.obtain()
    one.close()
    one.close()
    assert before == [
        len(one) for one in (client.on_lease, client.on_event, client.on_steer_refused)
    ]
    await anyio.sleep(0.1)
    assert client.holder.number == 0


async def test_without_the_lease_nothing_that_needs_it_is_sent(pilots: Pilots) -> None:
    one, other = session(pilots), session(pilots, 1)
    await other.obtain()
    with pytest.raises(NoAuthority, match=r"no control: second has control; nothing was sent"):
        await one.ask(orders.Land())
    await one.ask(orders.AskVersion())  # which needs none


async def test_a_request_that_waits_for_another_ends_with_it(pilots: Pilots) -> None:
    one = session(pilots)
    asking = [asyncio.create_task(one.obtain()) for _ in range(3)]
    await asyncio.sleep(0.0)
    one.let_go()
    ends = await asyncio.gather(*asking, return_exceptions=True)
    assert [type(end) for end in ends] == [NoAuthority] * 3
    await anyio.sleep(0.1)
    assert pilots.clients[0].holder.number == 0


async def test_giving_back_may_be_cancelled(
    pilots: Pilots, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, client = session(pilots), pilots.clients[0]
    await one.obtain()
    with monkeypatch.context() as slow:
        slow.setattr(client, "release_lease", lambda token: asyncio.sleep(9.0))
        lease = one.held()
        giving = asyncio.create_task(one.give_back())
        await anyio.sleep(0.1)
        giving.cancel()
        await asyncio.gather(giving, return_exceptions=True)
    assert at(one) is S.ABSENT
    client.let_go(lease)
    await one.obtain()
    assert at(one) is S.HOLDING


async def test_to_whom_it_was_lost_is_known_until_it_is_held_again(pilots: Pilots) -> None:
    one, other = session(pilots), session(pilots, 1)
    await one.obtain()
    await other.obtain(take_over=True)
    one.let_go()
    with pytest.raises(LeaseHeld):
        await one.obtain()
    assert getattr(one.lease_end, "name", None) == "second"
    await one.confirm(await one.ask_take_over())
    assert getattr(one.lease_end, "name", None) is None
    assert at(one) is S.HOLDING


async def test_a_client_that_wants_to_hear_it_hears_each_state_and_refusal(pilots: Pilots) -> None:
    one, other = session(pilots), session(pilots, 1)
    states: list[ControlState] = []
    refused: list[M100Error] = []
    one.on_change, one.on_refused = states.append, refused.append
    await one.obtain()
    await pilots.clients[1].stop()
    one.steer(NORTH)
    await anyio.sleep(0.1)
    await other.obtain(take_over=True)
    other.steer(NORTH)
    held = [S.ASKING, S.LEASED, S.OBTAINING, S.HOLDING]
    assert states == [*held, S.STOPPED, S.TAKEN_OVER]
    assert [error.seen for error in refused] == [
        "STOP was pressed; setpoints that go on are not flown"
    ]


async def test_a_closed_session_holds_nothing_that_comes_later(pilots: Pilots) -> None:
    one, client = session(pilots), pilots.clients[0]
    asking = asyncio.create_task(one.obtain())
    await asyncio.sleep(0.0)
    one.close()
    with pytest.raises(NoAuthority):
        await asking
    with pytest.raises(NoAuthority):
        await one.obtain()
    one.adopt(await client.acquire("late"))
    await anyio.sleep(0.1)
    assert client.holder.number == 0


@pytest.mark.parametrize("how", ["let_go", "give_back", "close", "obtain", "idle", "switch"])
async def test_control_ends_whatever_its_listeners_raise(
    pilots: Pilots, how: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, agent = session(pilots, gives_way=True, idle_s=1.0), pilots.rig.agent
    if how != "obtain":
        await one.obtain()

    def raising(*_: object) -> None:
        raise ZeroDivisionError

    async def letting_go() -> None:
        one.let_go()

    async def closing() -> None:
        one.close()

    if how == "idle":
        monkeypatch.setattr(pilots.clients[0], "note", raising)
    else:
        one.on_change = lambda state: None if state in (S.ASKING, S.LEASED) else raising()
    if how == "switch":
        pilots.rig.aircraft.set_rc_mode("P")
    elif how == "idle":
        await anyio.sleep(1.1)
        with pytest.raises(ZeroDivisionError):
            one.heard(is_idle=True)
    else:
        ways = {"let_go": letting_go, "close": closing}
        with pytest.raises(ZeroDivisionError):
            await ways.get(how, getattr(one, how))()
    await anyio.sleep(1.0)
    assert agent.leases.holder(agent.now) is None
    assert not agent.holding.has_authority
    assert at(one) is S.ABSENT
    one.on_change = lambda _: None
    if how not in ("close", "switch"):  # it can be had again
        await one.obtain()
        assert at(one) is S.HOLDING


async def test_whatever_one_raises_the_next_one_is_called(pilots: Pilots) -> None:
    """Many tabs share a client: the one that has control hears, whichever came before it."""
    first, one = session(pilots), session(pilots, gives_way=True)

    def raising(*_: object) -> None:
        raise ZeroDivisionError

    for callbacks in (pilots.clients[0].on_authority_taken, pilots.clients[0].on_event):
        callbacks.insert(0, raising)
    await one.obtain()
    await pilots.clients[1].stop()
    assert at(one) is S.STOPPED
    pilots.rig.aircraft.set_rc_mode("P")
    await anyio.sleep(1.0)
    assert (at(one), at(first)) == (S.ABSENT, S.ABSENT)
    assert pilots.clients[0].holder.number == 0


async def test_a_log_that_raises_keeps_no_loss_from_being_reported(pilots: Pilots) -> None:
    one, journal = session(pilots), pilots.rig.agent.journal
    await one.obtain()

    def raising(*_: object) -> None:
        raise ZeroDivisionError("a handler of the log")

    journal.on_event.insert(0, raising)
    pilots.rig.aircraft.set_rc_mode("P")
    await anyio.sleep(1.0)
    assert at(one) is S.SUSPENDED
    assert one.loss is not None
    told = [event.text for event in journal.events if "listener" in event.text]
    assert told == ["a listener failed at an event: ZeroDivisionError('a handler of the log')"]


@pytest.mark.parametrize("how", ["a pause", "a new beginning", "control once more"])
async def test_a_stream_that_went_on_without_control_needs_a_new_beginning(
    pilots: Pilots, how: str
) -> None:
    """All of it reaches the agent, which would take it for a new one after a pause."""
    one, rig = session(pilots), pilots.rig
    put_in_the_air(rig.aircraft)
    await one.obtain()

    async def stream(seconds: float) -> list[type[Exception]]:
        raised: list[type[Exception]] = []
        one.on_refused = lambda error: raised.append(type(error))
        for _ in range(round(seconds / 0.05)):
            one.heard()
            try:
                one.steer(NORTH)
            except M100Error as error:
                raised.append(type(error))
            await anyio.sleep(0.05)
        return raised

    flight = rig.aircraft.vehicle.flight.dynamics
    assert await stream(2.0) == []
    assert flight.speed > 0.9
    rig.aircraft.set_rc_mode("P")
    await stream(3.0)
    rig.aircraft.set_rc_mode("F")
    await stream(3.0)
    assert one.has_control
    assert await stream(3.0) == [GuardRefused] * 60
    assert flight.speed < 0.1
    if how == "a pause":
        for _ in range(11):
            one.heard()
            await anyio.sleep(0.1)
    elif how == "a new beginning":
        one.begin_anew()
    else:
        await one.obtain()
    assert await stream(2.0) == []
    assert flight.speed > 0.9


# -- by chance -----------------------------------------------------------------------------------


class Chaos:
    """One pilot who does everything at any moment, beside another one, with an agent that dies."""

    def __init__(self, pilots: Pilots, seed: int) -> None:
        self.pilots, self.draw = pilots, Random(seed)
        self.one, self.other = session(pilots), session(pilots, 1)
        self.asking: list[asyncio.Task[object]] = []

    async def begin(self, work: Coroutine[Any, Any, object]) -> None:
        self.asking.append(asyncio.create_task(work))
        await asyncio.sleep(0.0)  # it was asked for

    async def confirm(self) -> None:
        try:
            wanted = await self.one.ask_take_over()
        except M100Error:
            return  # there is nobody
        await self.begin(self.one.confirm(wanted))

    async def anew(self) -> None:
        """The way to the agent goes, which both ends hear, and is found again."""
        client = self.pilots.clients[0]
        client._channel.close("killed")
        client._closed("killed")
        ours, its = memory_channels(as_bytes=True)
        self.pilots.service.attach(its)
        self.pilots.ways[0] = its
        client.reopen(ours)

    async def step(self) -> None:
        one, other, client = self.one, self.other, self.pilots.clients[0]
        what = self.draw.randrange(11)
        if what < 2:
            await self.begin(one.obtain(take_over=self.draw.random() < 0.3))
        elif what == 2:
            await self.begin(one.take(lambda asked_at: client.acquire("first", asked_at)))
        elif what == 3:
            await self.confirm()
        elif what == 4:
            one.let_go()
        elif what == 5:
            await self.begin(one.give_back())
        elif what == 6 and self.asking:
            self.draw.choice(self.asking).cancel()
        elif what == 7:
            await self.begin(other.obtain(take_over=True))
        elif what == 8:
            other.let_go()
        elif what == 9:
            await self.anew()
        else:
            one.heard()
        for _ in range(self.draw.randrange(6)):
            await asyncio.sleep(self.draw.choice([0.0, 0.0, 0.0, 0.02]))


@pytest.mark.parametrize("seed", range(3))
async def test_in_whatever_order_nothing_stays_held_that_was_let_go(
    pilots: Pilots, seed: int
) -> None:
    for attempt in range(12):
        chaos, agent = Chaos(pilots, 100 * seed + attempt), pilots.rig.agent
        for _ in range(25):
            await chaos.step()
        chaos.other.close()
        chaos.one.let_go()
        ends = await asyncio.gather(*chaos.asking, return_exceptions=True)
        for end in ends:
            assert end is None or isinstance(end, M100Error | asyncio.CancelledError | Lease), end
        await anyio.sleep(0.5)
        where = (seed, attempt, at(chaos.one))
        assert agent.leases.holder(agent.now) is None, where
        assert not agent.holding.has_authority, where
        assert not chaos.one.has_lease, where
        await chaos.one.obtain()
        assert at(chaos.one) is S.HOLDING, where
        chaos.one.close()
        await anyio.sleep(0.1)
        assert agent.leases.holder(agent.now) is None, where


@pytest.mark.parametrize("how", ["raises", "is cancelled"])
async def test_a_request_whose_work_ends_by_an_error_that_nobody_expected_is_answered(
    pilots: Pilots, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    """Its front waited for ever, and could not ask again."""
    one, aircraft = session(pilots), pilots.rig.agent.connection.require_aircraft()

    def fails(**_: object) -> None:
        if how == "raises":
            raise MemoryError
        task = asyncio.current_task()
        assert task is not None
        task.cancel()
        raise asyncio.CancelledError

    with monkeypatch.context() as broken:
        broken.setattr(aircraft, "control", fails)
        with pytest.raises(M100Error, match="control was not obtained"):
            await asyncio.wait_for(one.obtain(), 5.0)
    await asyncio.wait_for(one.obtain(), 5.0)
    assert one.is_obeyed


async def test_an_order_whose_work_is_cancelled_is_answered(pilots: Pilots) -> None:
    one = session(pilots)
    await one.obtain()
    asked = asyncio.create_task(one.ask(orders.TakeOff()))
    await anyio.sleep(0.5)
    for task in asyncio.all_tasks():
        if task.get_name() == "m100link: take off for first":
            task.cancel()
    with pytest.raises(NotObserved, match="gave it up"):
        await asyncio.wait_for(asked, 5.0)


@pytest.mark.parametrize(
    ("error", "is_repeated"),
    [
        (TaskRefused("busy"), True),
        (AckTimeout("no answer"), True),
        (MissionRunning("it flies"), True),
        (StaleLease("not in force"), False),
        (GuardRefused("stopped", guard="stopped"), False),
    ],
)
async def test_a_landing_that_is_refused_is_asked_for_again_for_a_minute(
    error: M100Error, is_repeated: bool
) -> None:
    """Twice a second, with the time at which it was wanted."""
    began, lease = anyio.current_time(), Lease("front", "token", 7)
    asked: list[tuple[float, orders.Order, Any, Any]] = []

    async def ask(
        order: orders.Order, lease: Any, accepted: Any = None, asked_at: Any = None
    ) -> None:
        assert accepted is None
        asked.append((round(anyio.current_time() - began, 3), order, lease, asked_at))
        if isinstance(order, orders.Land):
            raise error

    class Agent:
        now = property(lambda _: anyio.current_time() - began)
        view = SimpleNamespace(is_on_ground=False)
        state = SimpleNamespace(task=None)
        has_authority = False  # as where the flight had ended that was not seen to end

    agent: Any = Agent()
    agent.ask, agent.holds = ask, lambda held: held is lease
    session: Any = object.__new__(ControlSession)
    session._agent, session._lease, session._ways_down = agent, lease, 0
    session.kept = nullcontext
    with pytest.raises(type(error)):
        await session.bring_down(orders.Land(), 3.5)
    landings = [at for at, order, *_ in asked if isinstance(order, orders.Land)]
    assert landings == pytest.approx([n / 2 for n in range(120)] if is_repeated else [0.0])
    assert all((found, at) == (lease, 3.5) for _, _, found, at in asked)
    asked.clear()
    agent.view.is_on_ground = True
    await session.bring_down(orders.Land(), 3.5)
    assert asked == [], "it is where it is wanted"
    ends = iter([NotObserved("it went on")] * 130)  # each is another minute

    async def unseen(order: orders.Order, *_: Any) -> None:
        if isinstance(order, orders.Land) and (end := next(ends, None)) is not None:
            raise end

    agent.ask, agent.view.is_on_ground, agent.has_authority = unseen, False, True
    await session.bring_down(orders.Land(), 3.5)
    assert next(ends, None) is None


def test_how_long_an_agent_was_silent_is_told_in_seconds() -> None:
    one: Any = object.__new__(ControlSession)
    view = SimpleNamespace(hearing=None, is_gone=False, at=104.2, heard_at=100.0)
    one._agent, one._terms = SimpleNamespace(view=view, holder=None), SimpleNamespace(who="it")
    assert "has said nothing for 4 s; nothing was sent" in one._no_control().seen
