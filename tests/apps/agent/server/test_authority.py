"""Holding as a table: every pair of state and input, written by hand; and what it does."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any

import anyio
import anyio.lowlevel
import pytest

from m100link.aircraft import Aircraft
from m100link.apps.agent import orders
from m100link.apps.agent.background import TaskSet, ignore
from m100link.apps.agent.lease import Flown, LeaseRefused
from m100link.apps.agent.messages import GuardLimits, Journal
from m100link.apps.agent.server.agent import Agent
from m100link.apps.agent.server.authority import AuthorityManager, HoldingInput, HoldingState
from m100link.apps.agent.server.connection import ConnectionState, by_driver
from m100link.errors import (
    AuthorityRefused,
    GuardianFailed,
    GuardRefused,
    LinkError,
    NoAuthority,
    NotObserved,
)
from m100link.flight.guardian import Guardian
from m100link.flight.guards import Envelope, Guards
from m100link.protocol.setpoint import Setpoint
from m100link.sim.line import NO_FAULTS, LineFaults
from tests.apps.agent.conftest import Rig, airborne

S, I = HoldingState, HoldingInput  # noqa: E741 - a table is read by its columns

# One line for each state; a dot means that nothing changes. The columns:
COLUMNS = (
    *(I.ASKED, I.OBTAINED, I.REFUSED, I.FAILED, I.LET_GO, I.TAKEN_OVER),
    *(I.PILOT_TOOK, I.SOMEBODY_TOOK, I.APP_TOOK, I.LINK_LOST, I.LEFT_F, I.IN_F, I.ENDED),
)
TABLE = """
           ASKED     OBTAINED REFUSED FAILED LET_GO    TAKEN_OVER PILOT  SOMEBODY APP  LINK LEFT_F IN_F     ENDED
NONE       OBTAINING .        .       .      .         .          .      .        .    .    .      .        .
OBTAINING  .         HELD     NONE    NONE   RELEASING RELEASING  NONE   NONE     NONE NONE .      .        NONE
HELD       .         .        .       NONE   RELEASING .          PAUSED TAKEN    NONE NONE .      .        NONE
TAKEN      OBTAINING .        .       .      NONE      NONE       .      .        .    NONE PAUSED .        .
PAUSED     OBTAINING .        .       .      NONE      NONE       .      .        .    NONE .      RESUMING .
RESUMING   OBTAINING HELD     TAKEN   NONE   RELEASING RELEASING  PAUSED TAKEN    NONE NONE .      .        NONE
RELEASING  .         .        NONE    NONE   .         .          NONE   NONE     NONE NONE .      .        NONE
"""  # noqa: E501 - a table


def pairs() -> list[tuple[HoldingState, HoldingInput, HoldingState]]:
    rows = [line.split() for line in TABLE.strip().splitlines()[1:]]
    assert [S[row[0]] for row in rows] == list(S)
    assert set(COLUMNS) == set(I)
    return [
        (S[name], what, S[name] if cell == "." else S[cell])
        for name, *cells in rows
        for what, cell in zip(COLUMNS, cells, strict=True)
    ]


@pytest.mark.parametrize(("state", "what", "expected"), pairs())
def test_every_pair(state: HoldingState, what: HoldingInput, expected: HoldingState) -> None:
    holding = AuthorityManager(Journal(lambda: 0.0), TaskSet())
    holding.state = state
    changes: list[Any] = []
    holding.on_change.append(lambda before, after: changes.append((before, after)))
    assert holding.feed(what) is (expected is not state)
    assert holding.state is expected
    assert changes == ([] if expected is state else [(state, expected)])


def test_without_a_flight_the_limits_are_those_of_the_guards_and_nothing_is_flown() -> None:
    """Metres, m/s and percent; nobody knows where control began."""
    guards = Guards(envelope=Envelope(40.0, 70.0, 6.0), battery_floor_percent=33)
    given = AuthorityManager(Journal(lambda: 0.0), TaskSet(), guards)
    usual: Any = AuthorityManager(Journal(lambda: 0.0), TaskSet())
    assert given.limits == GuardLimits(40.0, 70.0, 6.0, 33, None, None)
    assert usual.limits == GuardLimits(50.0, 150.0, 10.0, 20, None, None)
    assert usual.flown is Flown.NOTHING
    with pytest.raises(NoAuthority) as caught:
        usual.require()
    assert caught.value.remedy == "obtain control first"


@pytest.mark.parametrize("state", S)
@pytest.mark.parametrize("has_authority", [True, False])
def test_it_flies_where_the_agent_and_the_aircraft_agree_on_it(
    state: HoldingState, has_authority: bool
) -> None:
    holding: Any = AuthorityManager(Journal(lambda: 0.0), TaskSet())
    limits = GuardLimits(1.0, 2.0, 3.0, 4, 5.0, 6.0)
    holding.state = state
    holding.flying = SimpleNamespace(
        has_authority=has_authority, flown=Flown.MISSION, limits=limits
    )
    assert (holding.flown, holding.limits) == (Flown.MISSION, limits)
    assert holding.has_authority is (has_authority and state is S.HELD)
    if holding.has_authority:
        assert holding.require() is holding.flying
    else:
        with pytest.raises(NoAuthority):
            holding.require()


# -- what it does ---------------------------------------------------------------------------------

pytestmark = pytest.mark.anyio


async def test_obtained_held_and_given_back(rig: Rig) -> None:
    await rig.agent.ask(orders.Obtain(), rig.token)
    assert rig.holding.has_authority
    await rig.agent.ask(orders.Release(), rig.token)
    assert rig.holding.flying is None
    assert rig.states == [S.OBTAINING, S.HELD, S.RELEASING, S.NONE]
    with pytest.raises(NoAuthority):
        rig.holding.require()


async def test_a_release_that_nobody_answers_is_not_noted_as_one(rig: Rig) -> None:
    await rig.agent.ask(orders.Obtain(), rig.token)
    rig.aircraft.set_faults(LineFaults(loss=1.0), to_aircraft=NO_FAULTS)
    await rig.agent.ask(orders.Release(), rig.token)
    assert "may not be released" in rig.agent.journal.events[-1].text


# Orders that begin, or go on with, a movement that no guardian would end.
UNGUARDED_REFUSED: tuple[type[orders.Order], ...] = (
    *(orders.TakeOff, orders.StartMotors, orders.FlyPattern, orders.StartMission),
    *(orders.ResumeMission, orders.SetMissionSpeed, orders.StartHotpoint, orders.SetHotpointRadius),
    *(orders.SetHotpointRate, orders.ResetHotpointHeading, orders.FlyTo, orders.FlyAround),
    *(orders.ChangeHeight, orders.ChangeHeading),
)


@pytest.mark.parametrize("down", [orders.Land(), orders.GoHome(), None])
async def test_an_aircraft_that_flies_is_landed_where_no_guardian_can_be_started(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, down: orders.Order | None
) -> None:
    """No descriptor, no process, no Python any more: on the ground no flight begins so."""

    async def start(self: Any) -> None:
        if self._is_asked_for:
            raise GuardianFailed("the guardian did not start: Too many open files")

    if down is not None:
        await airborne(rig)
        await rig.agent.ask(orders.Release(), rig.token)
    monkeypatch.setattr(Guardian, "start", start)
    if down is None:
        with pytest.raises(GuardianFailed):
            await rig.agent.ask(orders.Obtain(), rig.token)
        assert rig.holding.state is S.NONE
        return
    await rig.agent.ask(orders.Obtain(), rig.token)
    texts = [event.text for event in rig.agent.journal.events if event.level == "error"]
    seen = "the guardian did not start: Too many open files"
    assert texts == [f"{seen}; control without a guardian lands or flies home, no more"]
    for kind in UNGUARDED_REFUSED:  # its values are not looked at
        with pytest.raises(GuardRefused, match=f"{kind.label} is not flown") as caught:
            rig.agent.begin(kind.__new__(kind), rig.token, ignore)
        assert caught.value.guard == "guardian"
    with pytest.raises(GuardRefused, match="no guardian watches this flight; a setpoint"):
        rig.agent.steer(rig.token, orders.setpoint_of(orders.VELOCITY_MODE, 0.0, 1.0, 0.0, 0.0))
    await rig.agent.ask(down, rig.token)
    assert rig.aircraft.height == pytest.approx(0.0, abs=0.1)
    with pytest.raises(GuardRefused, match="take off is not flown"):
        await rig.agent.ask(orders.TakeOff(), rig.token)
    await rig.agent.ask(orders.Release(), rig.token)
    with pytest.raises(GuardianFailed):  # it stands: control as ever, or none
        await rig.agent.ask(orders.Obtain(), rig.token)


async def test_two_that_ask_at_once_ask_the_aircraft_once(rig: Rig) -> None:
    async with anyio.create_task_group() as group:
        group.start_soon(rig.agent.obtain, rig.token)
        group.start_soon(rig.agent.obtain, rig.token)
    assert rig.states == [S.OBTAINING, S.HELD]


async def test_a_refusal_is_reported_and_leaves_nothing(rig: Rig) -> None:
    rig.aircraft.leave_f()
    await anyio.sleep(0.2)
    with pytest.raises(AuthorityRefused):
        await rig.agent.ask(orders.Obtain(), rig.token)
    assert rig.states == [S.OBTAINING, S.NONE]
    rig.aircraft.return_to_f()
    await anyio.sleep(1.0)
    assert rig.states == [S.OBTAINING, S.NONE]  # the client knows: it asks anew


async def test_a_lease_that_ends_while_authority_is_obtained_gives_it_back(rig: Rig) -> None:
    rig.aircraft.set_faults(LineFaults(delay=0.05))
    async with anyio.create_task_group() as group:

        async def obtain() -> None:
            with pytest.raises(NoAuthority, match="given back"):
                await rig.agent.ask(orders.Obtain(), rig.token)

        group.start_soon(obtain)
        await rig.until(lambda: rig.holding.state is S.OBTAINING)
        rig.agent.leases.release(rig.token, rig.agent.now)
    await rig.until(lambda: rig.holding.state is S.NONE)
    assert rig.states == [S.OBTAINING, S.RELEASING, S.NONE]


async def test_a_lease_that_ends_while_authority_goes_back_obtains_nothing(rig: Rig) -> None:
    """Nobody would hold the lease, and nobody would give authority back."""
    await rig.agent.ask(orders.Obtain(), rig.token)
    rig.holding.let_go()
    async with anyio.create_task_group() as group:

        async def obtain() -> None:
            with pytest.raises(Exception, match="not in force"):
                await rig.agent.ask(orders.Obtain(), rig.token)

        group.start_soon(obtain)
        await anyio.lowlevel.checkpoint()
        rig.agent.leases.release(rig.token, rig.agent.now)
    await anyio.sleep(2.0)
    assert rig.holding.state is S.NONE
    assert rig.states.count(S.OBTAINING) == 1


async def test_a_pilot_who_comes_back_gives_it_back(rig: Rig) -> None:
    await rig.agent.ask(orders.Obtain(), rig.token)
    rig.aircraft.leave_f()
    await rig.until(lambda: rig.holding.state is S.PAUSED)
    rig.aircraft.return_to_f()
    await rig.until(lambda: rig.holding.has_authority)
    assert S.RESUMING in rig.states


async def test_a_return_that_was_refused_is_waited_for_once_more(rig: Rig) -> None:
    """The pilot touched F: the switch was out of it again before the request arrived."""
    await rig.agent.ask(orders.Obtain(), rig.token)
    rig.aircraft.leave_f()
    await rig.until(lambda: rig.holding.state is S.PAUSED)
    rig.aircraft.set_faults(LineFaults(delay=0.05))
    rig.aircraft.return_to_f()
    await rig.until(lambda: rig.holding.state is S.RESUMING)
    rig.aircraft.leave_f()
    await rig.until(lambda: rig.holding.state is S.TAKEN)  # the aircraft refused it
    await anyio.sleep(1.0)
    assert not rig.holding.has_authority
    rig.aircraft.return_to_f()
    await rig.until(lambda: rig.holding.has_authority)


async def test_a_pilot_who_comes_back_does_not_fly_for_another_client(rig: Rig) -> None:
    await rig.agent.ask(orders.Obtain(), rig.token)
    rig.aircraft.leave_f()
    await rig.until(lambda: rig.holding.state is S.PAUSED)
    wanted = rig.agent.leases.ask_take_over("other", rig.agent.now)
    rig.token = rig.agent.leases.confirm(wanted.token, rig.agent.now).token
    assert rig.holding.state is S.NONE
    rig.aircraft.return_to_f()
    await anyio.sleep(2.0)
    assert rig.holding.state is S.NONE


@pytest.mark.parametrize("state", [S.OBTAINING, S.RESUMING])
async def test_a_client_that_takes_over_while_another_one_is_given_authority_has_to_ask(
    rig: Rig, state: HoldingState
) -> None:
    async def take_over() -> None:
        rig.aircraft.set_faults(LineFaults(delay=0.05))
        await rig.until(lambda: rig.holding.state is state)
        wanted = rig.agent.leases.ask_take_over("other", rig.agent.now)
        rig.token = rig.agent.leases.confirm(wanted.token, rig.agent.now).token

    if state is S.RESUMING:
        await rig.agent.ask(orders.Obtain(), rig.token)
        rig.aircraft.leave_f()
        await rig.until(lambda: rig.holding.state is S.PAUSED)
        rig.aircraft.return_to_f()
        await take_over()
    else:
        async with anyio.create_task_group() as group:
            group.start_soon(take_over)
            with pytest.raises(NoAuthority, match="given back"):
                await rig.agent.ask(orders.Obtain(), rig.token)
    await rig.until(lambda: rig.holding.state is S.NONE)
    await anyio.sleep(2.0)
    assert rig.holding.state is S.NONE
    assert not rig.aircraft.vehicle.authority.is_requested
    await rig.agent.ask(orders.Obtain(), rig.token)
    assert rig.holding.has_authority


async def test_what_the_app_took_stays_with_it(rig: Rig) -> None:
    await rig.agent.ask(orders.Obtain(), rig.token)
    assert rig.aircraft.app_takes_control()
    await rig.until(lambda: not rig.holding.has_authority)
    rig.aircraft.app_releases_control()
    await anyio.sleep(3.0)
    assert not rig.holding.has_authority


async def test_a_lost_link_ends_the_wish(rig: Rig) -> None:
    await rig.agent.ask(orders.Obtain(), rig.token)
    rig.aircraft.leave_f()
    await rig.until(lambda: rig.holding.state is S.PAUSED)
    rig.aircraft.unplug()
    await rig.until(lambda: rig.holding.state is S.NONE)
    with pytest.raises(LinkError):
        await rig.agent.ask(orders.Obtain(), rig.token)
    assert rig.states.count(S.OBTAINING) == 1


async def test_a_client_that_waits_for_control_no_more_takes_it_from_nobody(rig: Rig) -> None:
    """Two clients wait for one request, and one of them is cancelled."""
    done: list[str] = []

    async def obtain(name: str) -> None:
        await rig.agent.ask(orders.Obtain(), rig.token)
        done.append(name)

    gone = anyio.CancelScope()

    async def cancelled() -> None:
        with gone:
            await obtain("the one that is gone")

    async with anyio.create_task_group() as group:
        group.start_soon(obtain, "the one that stays")
        group.start_soon(cancelled)
        while S.OBTAINING not in rig.states:
            await anyio.lowlevel.checkpoint()
        await anyio.lowlevel.checkpoint()
        assert rig.holding.state is S.OBTAINING
        assert not done
        gone.cancel()
    assert done == ["the one that stays"]
    assert rig.holding.has_authority
    assert rig.states == [S.OBTAINING, S.HELD]


# -- what an agent that was killed in flight held goes back to the pilot --------------------------


NORTH = Setpoint.velocity(north=1.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)
SAID = "the agent before may have left"


async def killed_in_flight(rig: Rig) -> None:
    """The aircraft flies and is held, and its holder does and says nothing any more."""
    await airborne(rig)
    rig.agent.steer(rig.token, NORTH)
    await anyio.sleep(0.1)
    assert rig.aircraft.vehicle.authority.is_requested
    rig.driver.stop()


@asynccontextmanager
async def next_agent(rig: Rig, leases_before: int = 1_000_000) -> AsyncIterator[Agent]:
    agent = Agent(
        by_driver(rig.driver), credentials=rig.aircraft.credentials, leases_before=leases_before
    )
    async with agent:
        await rig.until(lambda: agent.connection.state is ConnectionState.CONNECTED)
        yield agent


def told(agent: Agent) -> list[str]:
    return [event.text for event in agent.journal.events if SAID in event.text]


@pytest.mark.parametrize("firmware", ["1.0", "2.3", "3.1"])
async def test_it_is_given_back_and_said(firmware: str) -> None:
    async with Rig(firmware=firmware).running() as rig:
        await killed_in_flight(rig)
        async with next_agent(rig) as agent:
            await rig.until(lambda: not rig.aircraft.vehicle.authority.is_requested, within=3.0)
            await rig.until(lambda: bool(told(agent)), within=3.0)
            assert len(told(agent)) == 1
            assert agent.holding.state is HoldingState.NONE
            await anyio.sleep(3.0)
            before = rig.aircraft.position
            await anyio.sleep(1.0)
            assert math.dist(rig.aircraft.position, before) < 0.1  # it hovers
            assert rig.aircraft.height > 1.0


async def test_the_first_agent_of_a_station_takes_nothing_from_anybody(rig: Rig) -> None:
    await killed_in_flight(rig)
    async with next_agent(rig, 0) as agent:
        await anyio.sleep(3.0)
        assert rig.aircraft.vehicle.authority.is_requested
        assert told(agent) == []


async def test_a_client_that_asks_at_once_has_it_and_keeps_it(rig: Rig) -> None:
    await killed_in_flight(rig)
    async with next_agent(rig) as agent:
        aircraft = agent.connection.aircraft
        assert aircraft is not None
        assert aircraft.link.cipher is not None, "the key counts without a new activation"
        token = agent.leases.acquire("the next", agent.now).token
        await agent.ask(orders.Obtain(), token)
        assert agent.holding.has_authority
        for _ in range(6):
            await anyio.sleep(0.5)
            agent.leases.renew(token, agent.now)
        assert agent.holding.has_authority
        assert rig.aircraft.vehicle.authority.is_requested


async def test_an_aircraft_that_does_not_answer_is_asked_again_when_it_is_back(rig: Rig) -> None:
    await killed_in_flight(rig)
    agent = Agent(
        by_driver(rig.driver), credentials=rig.aircraft.credentials, leases_before=1_000_000
    )
    unplugged = False

    def unplug(aircraft: Aircraft | None) -> None:
        nonlocal unplugged
        if not unplugged:
            unplugged = True
            rig.aircraft.unplug()

    agent.connection.on_aircraft.append(unplug)
    async with agent:
        await rig.until(lambda: "does not say" in "".join(told(agent)), within=10.0)
        assert rig.aircraft.vehicle.authority.is_requested
        rig.aircraft.replug()
        await rig.until(lambda: not rig.aircraft.vehicle.authority.is_requested)
        await rig.until(lambda: "is given back" in told(agent)[-1])


async def test_a_request_that_is_refused_does_not_forget_what_goes_back(rig: Rig) -> None:
    """It waits for the release; its lease has ended by then, and nobody else asks."""
    await killed_in_flight(rig)
    agent = Agent(
        by_driver(rig.driver), credentials=rig.aircraft.credentials, leases_before=1_000_000
    )
    asked: list[asyncio.Task[Any]] = []

    def ask(aircraft: Aircraft | None) -> None:
        if aircraft is not None and not asked:
            rig.aircraft.set_faults(NO_FAULTS, to_aircraft=LineFaults(loss=1.0))
            token = agent.leases.acquire("the next", agent.now).token
            asked.append(asyncio.create_task(agent.ask(orders.Obtain(), token)))
            agent.leases.release(token, agent.now)

    agent.connection.on_aircraft.append(ask)
    async with agent:
        await rig.until(lambda: bool(asked) and asked[0].done(), within=10.0)
        assert isinstance(asked[0].exception(), LeaseRefused)
        assert rig.aircraft.vehicle.authority.is_requested
        rig.aircraft.set_faults()
        await rig.until(lambda: not rig.aircraft.vehicle.authority.is_requested, within=5.0)


async def test_a_release_that_was_not_heard_goes_out_again(rig: Rig) -> None:
    await airborne(rig)
    rig.aircraft.set_faults(NO_FAULTS, to_aircraft=LineFaults(loss=1.0))
    await rig.agent.ask(orders.Release(), rig.token)
    await anyio.sleep(4.0)
    assert rig.aircraft.vehicle.authority.is_requested
    with pytest.raises(NotObserved, match="does not confirm"):
        await rig.agent.ask(orders.Stop())
    rig.aircraft.set_faults()
    await rig.until(lambda: not rig.aircraft.vehicle.authority.is_requested, within=4.0)
    await rig.agent.ask(orders.Stop())
    await rig.agent.ask(orders.Obtain(), rig.token)
    await anyio.sleep(3.0)
    assert rig.holding.has_authority, "nothing is owed any more"
