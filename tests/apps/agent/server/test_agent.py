"""The agent as its clients use it: a lease for everything that moves."""

from __future__ import annotations

import asyncio
import logging
import re
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from functools import partial
from itertools import product
from random import Random
from types import FrameType
from unittest.mock import patch

import anyio
import pytest

from m100link.aircraft import Aircraft
from m100link.apps.agent import orders
from m100link.apps.agent.background import ignore
from m100link.apps.agent.lease import Flown, LeaseChange, LeaseRefused, TakeOver
from m100link.apps.agent.orders import ORDERS, AfterStop, ChangeHeight
from m100link.apps.agent.server.agent import Agent
from m100link.apps.agent.server.authority import HoldingState
from m100link.apps.agent.server.connection import ConnectionState, by_driver
from m100link.errors import (
    GuardRefused,
    M100Error,
    NoAuthority,
    NotObserved,
    TaskRefused,
    UsageError,
)
from m100link.flight.guards import SuspendWatch
from m100link.missions.plan import Waypoint, WaypointPlan
from m100link.protocol.commands.gimbal import GimbalAngle
from m100link.protocol.commands.hotpoint import HotpointStart
from m100link.protocol.records import Device
from m100link.protocol.setpoint import Setpoint
from tests.apps.agent.conftest import Rig, airborne, guided, task_of
from tests.apps.agent.examples import example
from tests.rig import know_app, put_in_the_air

pytestmark = pytest.mark.anyio

NORTH = Setpoint.velocity(north=1.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)
UP = Setpoint.velocity(north=0.0, east=0.0, up=1.0, yaw_rate_deg_s=0.0)


HOTPOINT = HotpointStart(0.9, 0.07, altitude=20.0, radius=10.0, angular_rate=5.0)


PLAN = WaypointPlan(
    [Waypoint(52.0, 4.3, height=10.0), Waypoint(52.001, 4.3, height=10.0)], speed=5.0
)


async def test_a_take_off_tells_when_it_is_accepted(rig: Rig) -> None:
    await rig.agent.ask(orders.Obtain(), rig.token)
    begun = anyio.Event()
    async with anyio.create_task_group() as group:
        group.start_soon(rig.agent.ask, orders.TakeOff(), rig.token, begun.set)
        await begun.wait()
        assert task_of(rig) == "take off"
        assert rig.aircraft.height < 1.0
    assert task_of(rig) is None
    assert rig.aircraft.height > 1.0


@pytest.mark.parametrize("name", ["hover", "halt"])
async def test_a_setpoint_expires_and_hover_ends_it_at_once(rig: Rig, name: str) -> None:
    """Also by the name that the order had in 0.2.0, which warns."""
    await airborne(rig)
    moves = rig.aircraft.autopilot.received_movements
    rig.agent.steer(rig.token, NORTH)
    await anyio.sleep(0.1)
    assert list(moves)[-1].roll_or_x == 1.0
    with nullcontext() if name == "hover" else pytest.warns(DeprecationWarning, match="is hover"):
        getattr(rig.agent, name)()
    await anyio.sleep(0.03)
    assert list(moves)[-1].roll_or_x == 0.0
    rig.agent.steer(rig.token, NORTH)
    await anyio.sleep(0.3)
    assert list(moves)[-1].roll_or_x == 0.0


async def test_the_first_wish_of_all_after_a_loss_is_a_new_one(rig: Rig) -> None:
    agent = Agent(by_driver(rig.driver))
    agent._begin_anew = "control was lost meanwhile"
    with patch.object(type(agent.holding), "has_authority", True):
        agent._wanted()
    assert agent._begin_anew == ""


@pytest.mark.parametrize("token", ["", "wrong"])
async def test_without_the_lease_nothing_moves(rig: Rig, token: str) -> None:
    await airborne(rig)
    with pytest.raises(LeaseRefused):
        rig.agent.steer(token, NORTH)
    for work in (
        rig.agent.ask(orders.Obtain(), token),
        rig.agent.ask(orders.Release(), token),
        rig.agent.ask(orders.Land(), token),
        rig.agent.ask(orders.SendToMobile(b"x"), token),
        rig.agent.ask(orders.Activate(), token),
        rig.agent.ask(ChangeHeight(5.0), token),
        rig.agent.ask(orders.StopMotors(), token),
        rig.agent.ask(orders.PointGimbal(GimbalAngle(yaw_deg=10.0)), token),
        rig.agent.ask(orders.UseCamera(orders.CameraUse.PHOTO), token),
        rig.agent.ask(orders.UploadPlan.of(PLAN), token),
        rig.agent.ask(orders.StartMission(""), token),
        rig.agent.ask(orders.StartHotpoint(HOTPOINT), token),
        rig.agent.ask(orders.SetHotpointRadius(20.0), token),
        rig.agent.ask(orders.FlyPattern(0), token),
        rig.agent.ask(orders.StopMission(), token),
        rig.agent.ask(orders.SetMissionSpeed(3.0), token),
    ):
        with pytest.raises(LeaseRefused):
            await work
    await anyio.sleep(0.1)
    assert list(rig.aircraft.autopilot.received_movements) == []
    assert rig.holding.has_authority


async def test_without_authority_nothing_moves(rig: Rig) -> None:
    with pytest.raises(NoAuthority):
        rig.agent.steer(rig.token, NORTH)
    with pytest.raises(NoAuthority):
        await rig.agent.ask(orders.TakeOff(), rig.token)


async def test_a_stop_during_a_task_gives_authority_back(rig: Rig) -> None:
    await rig.agent.ask(orders.Obtain(), rig.token)
    async with anyio.create_task_group() as group:

        async def take_off() -> None:
            with pytest.raises(NotObserved, match="control ended"):
                await rig.agent.ask(orders.TakeOff(), rig.token)

        group.start_soon(take_off)
        await anyio.sleep(2.0)
        await rig.agent.stop()
    assert not rig.holding.has_authority


@pytest.mark.parametrize("after", [0.0, 0.001, 0.1, 3.0])
@pytest.mark.parametrize("knows_app", [False, True])  # then no flight status has come yet
async def test_a_stop_ends_motors_that_idle_on_the_ground(after: float, knows_app: bool) -> None:
    """As they start, too; in the air nothing stops them."""
    rig = Rig(firmware="3.1")
    if knows_app:
        know_app(rig.aircraft)
    async with rig.running():
        await rig.agent.ask(orders.Obtain(), rig.token)
        starting = asyncio.ensure_future(rig.agent.ask(orders.StartMotors(), rig.token))
        await anyio.sleep(after)
        await rig.agent.stop()
        await asyncio.wait([starting])
        assert isinstance(starting.exception(), NoAuthority | None)
        await anyio.sleep(1.0)
        assert not rig.aircraft.vehicle.flight.dynamics.motors_on
        await rig.agent.ask(orders.Obtain(), rig.token)
        await rig.agent.ask(orders.StartMotors(), rig.token)
        for _ in range(40):
            rig.agent.steer(rig.token, UP)
            await anyio.sleep(0.05)
        await rig.agent.stop()
        await anyio.sleep(2.0)
        assert rig.aircraft.height > 0.5
        assert rig.holding.has_authority


async def test_a_stop_gives_back_control_where_no_flight_status_comes(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Motors may idle; they may fly, too, so nothing stops them, and the log says so."""
    rig = Rig(firmware="3.1")
    rig.aircraft.set_rates(flight_status=0)
    async with rig.running():
        await rig.agent.ask(orders.Obtain(), rig.token)
        await rig.agent.ask(orders.StartMotors(), rig.token)
        await rig.agent.stop()
        assert not rig.holding.has_authority
        assert rig.aircraft.vehicle.flight.dynamics.motors_on
    assert "the motors were not stopped: nobody knows whether it stands" in caplog.messages
    assert not [one for one in caplog.messages if "did not land" in one]


async def test_after_stop_a_stream_of_setpoints_is_refused_until_it_begins_anew(rig: Rig) -> None:
    await airborne(rig)
    for asks_anew in (True, False):
        rig.agent.steer(rig.token, NORTH)
        await rig.agent.stop()
        for _ in range(60):  # longer than any setpoint lives
            with pytest.raises(GuardRefused, match="STOP was pressed"):
                rig.agent.steer(rig.token, NORTH)
            await anyio.sleep(0.05)
        rig.agent.hover("somebody presses hover")
        rig.agent.hover("", "of a lease that is not this one")
        with pytest.raises(GuardRefused, match="STOP was pressed"):
            rig.agent.steer(rig.token, NORTH)
        assert list(rig.aircraft.autopilot.received_movements)[-1].roll_or_x == 0.0
        if asks_anew:
            await rig.agent.ask(orders.Obtain(), rig.token)
        else:
            rig.agent.hover("let go", rig.token)
        rig.agent.steer(rig.token, NORTH)
        await anyio.sleep(0.1)
        assert list(rig.aircraft.autopilot.received_movements)[-1].roll_or_x > 0.0


async def test_what_was_asked_before_a_stop_and_comes_after_it_moves_nothing(rig: Rig) -> None:
    """The agent stood still, and reads the ways of its fronts in any order then."""
    await airborne(rig)
    agent, asked_at = rig.agent, rig.agent.now
    await anyio.sleep(0.1)
    await agent.stop()
    for kind in ORDERS.values():  # one rule for all of them
        order = example(kind)
        if kind.after_stop is orders.AfterStop.DONE:
            continue
        for at in (asked_at, agent.now):  # of what is asked at the same instant, STOP comes last
            with pytest.raises(GuardRefused, match=f"STOP was pressed after {order.label} was"):
                agent.begin(order, rig.token, ignore, at)
    agent.begin(orders.Halt(begins_anew=True), rig.token, ignore, agent.now)
    with pytest.raises(GuardRefused, match="STOP was pressed"):
        agent.steer(rig.token, NORTH)
    agent.begin(orders.Halt(), rig.token, ignore, asked_at)
    with pytest.raises(GuardRefused, match="STOP was pressed"):
        agent.steer(rig.token, NORTH)
    agent.begin(orders.RenewLease(rig.token), "", ignore, asked_at)
    await agent.begin(orders.Release(), rig.token, ignore, asked_at)
    is_still_held = rig.holding.has_authority
    assert not is_still_held
    await anyio.sleep(0.01)
    await agent.begin(orders.Obtain(), rig.token, ignore, agent.now)
    assert rig.holding.has_authority
    with pytest.raises(GuardRefused, match="STOP was pressed after land was asked"):
        agent.begin(orders.Land(), rig.token, ignore, asked_at)
    await agent.begin(orders.Land(), rig.token, ignore, agent.now)
    assert rig.aircraft.height < 0.1


@pytest.mark.parametrize("kind", ORDERS.values(), ids=ORDERS)
async def test_a_program_that_did_not_hear_of_a_stop_does_not_fly_on(
    rig: Rig, kind: type[orders.Order]
) -> None:
    """Its next step is an order after the STOP: what moves waits until it has begun anew."""
    await airborne(rig)
    agent = rig.agent
    await agent.stop()
    flies = (
        *("TakeOff", "GoHome", "FlyPattern", "StartMotors", "StartMission", "ResumeMission"),
        *("SetMissionSpeed", "StartHotpoint", "SetHotpointRadius", "SetHotpointRate"),
        *("ResetHotpointHeading", "FlyTo", "FlyAround", "ChangeHeight", "ChangeHeading"),
    )
    assert (kind.after_stop is orders.AfterStop.ANEW) == (kind.__name__ in flies)
    if kind.__name__ not in flies:
        return
    await anyio.sleep(0.01)
    with pytest.raises(GuardRefused, match=f"STOP was pressed; {kind.label} that is asked") as met:
        agent.begin(example(kind), rig.token, ignore, agent.now)
    assert met.value.guard == "stopped"
    await agent.ask(orders.Obtain(), rig.token)
    going = agent.begin(ChangeHeight(5.0), rig.token, ignore, agent.now)
    going.close()


async def test_a_hover_of_somebody_else_ends_the_stream_and_the_holders_own_does_not(
    rig: Rig,
) -> None:
    await airborne(rig)
    agent = rig.agent
    for again in (partial(agent.ask, orders.Obtain()), None):
        agent.steer(rig.token, NORTH)
        await agent.ask(orders.Halt("its own"), rig.token)
        agent.steer(rig.token, NORTH)
        await agent.ask(orders.Halt("of somebody"))
        for _ in range(30):
            with pytest.raises(GuardRefused, match="a hover was ordered; setpoints that go on"):
                agent.steer(rig.token, NORTH)
            await anyio.sleep(0.05)
        with pytest.raises(GuardRefused, match="a hover was ordered; change of height"):
            await agent.ask(ChangeHeight(5.0), rig.token)
        await agent.ask(orders.Halt("its own"), rig.token)
        await agent.ask(orders.Halt("let go", begins_anew=True), "a lease that has ended")
        with pytest.raises(GuardRefused, match="a hover was ordered"):
            agent.steer(rig.token, NORTH)
        if again is not None:
            await again(rig.token)
        else:
            await agent.ask(orders.Halt("let go", begins_anew=True), rig.token)
    agent.steer(rig.token, NORTH)


@pytest.mark.parametrize(
    "order",
    [
        orders.FlyPattern(1),
        orders.StartMotors(),
        example(orders.StartHotpoint),
    ],
    ids=lambda one: one.label,
)
async def test_what_would_be_flown_beside_a_task_is_refused(rig: Rig, order: orders.Order) -> None:
    """A program of setpoints over a landing ends it, or is ended by it: nobody meant either."""
    await airborne(rig)
    async with anyio.create_task_group() as group:
        group.start_soon(rig.agent.ask, orders.Land(), rig.token)
        await anyio.sleep(0.2)
        with pytest.raises(TaskRefused, match="was asked for during land"):
            await rig.agent.ask(order, rig.token)
    assert rig.aircraft.height < 0.1


@pytest.mark.parametrize("pauses", [True, False])
async def test_a_stream_does_not_go_on_after_the_pilot_gave_the_aircraft_back(
    rig: Rig, pauses: bool
) -> None:
    await airborne(rig)
    rig.agent.steer(rig.token, NORTH)
    rig.aircraft.leave_f()
    await rig.until(lambda: not rig.holding.has_authority)
    await anyio.sleep(1.5)  # a pause while the pilot flies is none
    for step in range(60):
        if step == 20:
            rig.aircraft.return_to_f()
        with pytest.raises(GuardRefused, match="control was lost meanwhile"):
            rig.agent.steer(rig.token, NORTH)
        await anyio.sleep(0.05)
    assert rig.holding.has_authority
    if pauses:
        await anyio.sleep(1.1)
    else:
        rig.agent.hover("let go", rig.token)
    rig.agent.steer(rig.token, NORTH)


@pytest.mark.parametrize("how", ["pauses", "lets go", "asks for control"])
@pytest.mark.parametrize(
    "order", [orders.ChangeHeight(10.0), orders.GoHome(), orders.FlyPattern(1)]
)
async def test_an_order_that_is_repeated_until_it_is_begun_is_not_when_the_pilot_comes_back(
    rig: Rig, order: orders.Order, how: str
) -> None:
    """A program that tries again flies on over the hands of a pilot who is back in F."""
    await airborne(rig)
    rig.agent.steer(rig.token, NORTH)
    rig.aircraft.leave_f()
    await rig.until(lambda: not rig.holding.has_authority)
    for step in range(20):
        if step == 10:
            rig.aircraft.return_to_f()
        with pytest.raises((NoAuthority, GuardRefused)) as raised:
            await rig.agent.ask(order, rig.token)
        await anyio.sleep(0.4)
    assert raised.value.seen.startswith("control was lost meanwhile")
    assert rig.holding.has_authority
    assert rig.aircraft.vehicle.flight.dynamics.speed < 0.1
    if how == "pauses":
        await anyio.sleep(1.1)
    elif how == "lets go":
        rig.agent.hover("let go", rig.token)
    else:
        await rig.agent.ask(orders.Obtain(), rig.token)
    with anyio.move_on_after(3.0):
        await rig.agent.ask(order, rig.token)


async def test_a_stop_is_not_undone_by_control_that_was_asked_for_before_it(rig: Rig) -> None:
    await airborne(rig)
    await rig.agent.stop()
    async with anyio.create_task_group() as group:
        group.start_soon(rig.agent.ask, orders.Release(), rig.token)
        group.start_soon(rig.agent.ask, orders.Obtain(), rig.token)
        await anyio.lowlevel.checkpoint()
        assert rig.holding.state is HoldingState.RELEASING
        await rig.agent.stop()
    assert rig.holding.has_authority
    with pytest.raises(GuardRefused, match="STOP was pressed"):
        rig.agent.steer(rig.token, NORTH)
    await rig.agent.ask(orders.Obtain(), rig.token)
    rig.agent.steer(rig.token, NORTH)


async def test_no_setpoint_flies_while_authority_goes_back(rig: Rig) -> None:
    await airborne(rig)
    async with anyio.create_task_group() as group:
        group.start_soon(rig.agent.ask, orders.Release(), rig.token)
        await anyio.lowlevel.checkpoint()
        assert rig.holding.state is HoldingState.RELEASING
        with pytest.raises(NoAuthority):
            rig.agent.steer(rig.token, NORTH)


async def test_a_take_over_whose_first_step_came_before_a_stop_is_not_confirmed(rig: Rig) -> None:
    """Its client may have decided by what flew before the STOP, and would begin anew by it."""
    await airborne(rig)
    offer = await rig.agent.ask(orders.AskTakeOver("other"))
    assert isinstance(offer, TakeOver)
    await anyio.sleep(0.5)
    await rig.agent.stop()
    with pytest.raises(LeaseRefused):
        await rig.agent.ask(orders.ConfirmTakeOver(offer.token))
    assert rig.agent.leases.check(rig.token, rig.agent.now).name == "client"
    offer = await rig.agent.ask(orders.AskTakeOver("other"))
    assert isinstance(offer, TakeOver)
    await rig.agent.ask(orders.ConfirmTakeOver(offer.token))


async def test_a_client_that_takes_over_after_a_stop_begins_anew(rig: Rig) -> None:
    await airborne(rig)
    await rig.agent.stop()
    leases, now = rig.agent.leases, rig.agent.now
    rig.renewing.cancel()
    rig.token = leases.confirm(leases.ask_take_over("other", now).token, now).token
    rig.agent.steer(rig.token, NORTH)


async def test_the_end_of_a_lease_stops_the_motion_and_gives_authority_back(rig: Rig) -> None:
    await airborne(rig)
    rig.agent.steer(rig.token, NORTH, 1.0)
    await anyio.sleep(0.5)
    rig.agent.leases.release(rig.token, rig.agent.now)
    await anyio.sleep(0.03)
    assert list(rig.aircraft.autopilot.received_movements)[-1].roll_or_x == 0.0
    await rig.until(lambda: not rig.aircraft.vehicle.authority.is_requested, within=2.0)
    assert not rig.holding.has_authority


async def test_a_lost_line_is_opened_again_and_the_key_stays_in_use(rig: Rig) -> None:
    connection = rig.agent.connection
    rig.aircraft.unplug()
    await rig.until(lambda: connection.state is not ConnectionState.CONNECTED)
    assert connection.error is not None
    rig.aircraft.replug()
    await rig.until(lambda: connection.state is ConnectionState.CONNECTED)
    await rig.agent.ask(orders.Obtain(), rig.token)
    assert rig.holding.has_authority


async def test_an_aircraft_that_is_not_there_is_reported_once(rig: Rig) -> None:
    rig.aircraft.unplug()
    await anyio.sleep(10.0)
    told = [event.text for event in rig.agent.journal.events if "not connected" in event.text]
    assert len(told) == 1
    with pytest.raises(M100Error):
        await rig.agent.ask(orders.AskVersion())


# -- authority that is kept when the client that flew is lost --------------------------------------

LOST = pytest.mark.parametrize("why", [LeaseChange.FRONT_LOST, LeaseChange.EXPIRED])


async def lose(rig: Rig, why: LeaseChange) -> None:
    """A front that flies dies, or hangs; the aircraft hovers at once or when the setpoint ends."""
    rig.agent.steer(rig.token, NORTH, 1.0)
    await anyio.sleep(0.5)
    rig.renewing.cancel()
    if why is LeaseChange.FRONT_LOST:
        rig.agent.leases.release(rig.token, rig.agent.now, why)
    await rig.until(lambda: rig.agent.leases.holder(rig.agent.now) is None, within=3.5)
    await anyio.sleep(0.03)
    assert list(rig.aircraft.autopilot.received_movements)[-1].roll_or_x == 0.0


@LOST
async def test_by_default_authority_goes_back_with_a_lost_client(why: LeaseChange) -> None:
    async with Rig().running() as rig:
        await airborne(rig)
        await lose(rig, why)
        await rig.until(lambda: not rig.aircraft.vehicle.authority.is_requested, within=1.0)


async def test_a_client_that_gives_the_lease_back_leaves_no_authority_behind() -> None:
    async with Rig().running() as rig:
        await airborne(rig)
        rig.agent.leases.release(rig.token, rig.agent.now)
        await rig.until(lambda: not rig.aircraft.vehicle.authority.is_requested, within=1.0)


async def test_a_lease_that_nobody_renews_ends_and_what_flies_by_it(rig: Rig) -> None:
    await airborne(rig)
    rig.renewing.cancel()
    flight = rig.agent.background.spawn(rig.agent.ask(ChangeHeight(50.0), rig.token), "flight")
    await rig.until(lambda: guided(rig) is not None)
    await rig.until(lambda: rig.agent.leases.holder(rig.agent.now) is None, within=5.0)
    await rig.until(lambda: guided(rig) is None, within=0.5)
    await rig.until(flight.done, within=1.0)
    await rig.until(lambda: not rig.holding.has_authority, within=5.0)


@pytest.mark.parametrize(("rate", "is_clockwise"), [(0.5, True), (-0.5, False), (12.0, True)])
async def test_a_circle_is_turned_the_way_of_its_sign(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, rate: float, is_clockwise: bool
) -> None:
    told: list[tuple[float, bool]] = []

    class Circle:
        async def set_rate(self, rate: float, *, clockwise: bool, wait: bool) -> None:
            assert not wait
            told.append((rate, clockwise))

    await airborne(rig)
    mission = rig.holding.require().mission
    monkeypatch.setattr(type(mission), "flight", lambda self, kind: Circle())
    await rig.agent.ask(orders.SetHotpointRate(rate), rig.token)
    assert told == [(abs(rate), is_clockwise)]


async def test_an_activation_that_fails_is_noted(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    async def refuse(*_: object, **__: object) -> None:
        raise UsageError("the app has no internet")

    with monkeypatch.context() as patched:
        patched.setattr(Aircraft, "activate", refuse)
        with pytest.raises(M100Error) as caught:
            await rig.agent.ask(orders.Activate(), rig.token)
    last = list(rig.agent.journal.events)[-1]
    assert (last.text, last.level) == (f"activation failed: {caught.value.seen}", "error")
    assert rig.agent.activation.error is caught.value
    await rig.agent.ask(orders.Activate(), rig.token)
    assert rig.agent.activation.error is None


_ROOMS = re.compile(r"m100link/(apps/agent|flight)/")


@contextmanager
def no_memory_at(number: int) -> Iterator[None]:
    """The call of that number in the agent, or in what flies, finds no memory."""
    left, before = number, sys.gettrace()

    def trace(frame: FrameType, event: str, _: object) -> None:
        nonlocal left
        code = frame.f_code
        is_ours = event == "call" and _ROOMS.search(code.co_filename)
        if is_ours and code.co_name != "__del__":
            left -= 1
            if left < 0:
                sys.settrace(before)
                raise MemoryError(f"call {number}")

    sys.settrace(trace)
    try:
        yield
    finally:
        sys.settrace(before)


class SlowLog(logging.Handler):
    """Blocks another thread until it is let go; keeps what the loop's own thread waited for."""

    def __init__(self, is_over: Callable[[], bool]) -> None:
        super().__init__()
        self._is_over, self._here = is_over, threading.get_ident()
        self.gate = threading.Event()
        self.waited_for: list[str] = []

    def handle(self, record: logging.LogRecord) -> bool:  # without the lock of a handler
        if threading.get_ident() != self._here:
            self.gate.wait(10.0)
        elif not self._is_over():
            self.waited_for.append(record.getMessage())
        return True


@pytest.mark.parametrize(
    ("flown", "end"),
    [
        *product(("setpoints", "program", "task"), ("release", "stop")),
        *product(("program", "task"), ("silence",)),
        *product(("setpoints", "program"), ("take-over",)),
    ],
)
async def test_no_end_of_a_flight_waits_for_a_log(rig: Rig, flown: str, end: str) -> None:
    """First it acts: a library's user may log to a disk that stands still."""
    agent, holding = rig.agent, rig.holding
    put_in_the_air(rig.aircraft)
    await agent.ask(orders.Obtain(), rig.token)
    if flown == "setpoints":
        agent.steer(rig.token, NORTH, 1.0)
    elif flown == "program":
        await agent.ask(orders.FlyPattern(1), rig.token)
    else:
        agent.background.spawn(agent.ask(orders.GoHome(), rig.token), "task")
    await anyio.sleep(0.2)

    def is_over() -> bool:
        """It hovers, or the pilot has it; of a task nobody says that it hovers."""
        flying = holding.flying
        if flying is None:
            return rig.aircraft.vehicle.authority.device is Device.RC
        return (
            flown != "task"
            and flying.flown is Flown.NOTHING
            and getattr(holding.flying, "pattern", None) is None
        )

    rig.renewing.cancel()
    if end == "silence":
        await anyio.sleep(agent.leases.remaining(agent.now) - 0.05)
    told_early: list[str] = []  # to fronts, which may take their time as well
    agent.journal.on_event.append(
        lambda event: None if flown == "task" or is_over() else told_early.append(event.text)
    )
    log, logger = SlowLog(is_over), logging.getLogger("m100link")
    level = logger.level
    logger.setLevel(logging.INFO)
    logger.addHandler(log)
    try:
        if end == "release":
            agent.leases.release(rig.token, agent.now)
        elif end == "stop":
            await agent.stop()
        elif end == "take-over":
            agent.leases.confirm(agent.leases.ask_take_over("other", agent.now).token, agent.now)
        await anyio.sleep(1.0)
    finally:
        logger.removeHandler(log)
        logger.setLevel(level)
        log.gate.set()
    assert log.waited_for == [], log.waited_for
    assert not told_early, told_early
    assert is_over()


@pytest.mark.parametrize("end", ["release", "silence", "stop"])
async def test_no_memory_as_a_flight_ends_lets_nothing_fly_on(
    rig: Rig, end: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Seeded: one call of the end of a lease, or of a STOP, fails; a program flies until then."""
    agent, holding, draw = rig.agent, rig.holding, Random(31)
    # What fails in a callback of the loop is its own to tell.
    monkeypatch.setattr(asyncio.get_running_loop(), "_exception_handler", ignore)
    rig.renewing.cancel()
    agent.leases.release(rig.token, agent.now)
    put_in_the_air(rig.aircraft)
    numbers = [*range(1, 14, 2), *draw.sample(range(14, 120), 4)]
    for number in numbers:
        await rig.until(lambda: agent.connection.aircraft is not None)
        token = agent.leases.acquire("client", agent.now).token
        await agent.ask(orders.Obtain(), token)
        await agent.ask(orders.FlyPattern(1), token)
        await anyio.sleep(0.2)
        if end == "silence":
            await anyio.sleep(agent.leases.remaining(agent.now) - 0.05)
        with no_memory_at(number), suppress(MemoryError):
            if end == "release":
                agent.leases.release(token, agent.now)
            elif end == "stop":
                await agent.stop()
            await anyio.sleep(0.2)
        await anyio.sleep(0.5)
        if end == "stop":
            assert getattr(holding.flying, "pattern", None) is None, number
            last = list(rig.aircraft.autopilot.received_movements)[-1]
            assert last.roll_or_x == 0.0 or not holding.has_authority, number
        # Where the very call that ends the lease failed, nobody renews it any more.
        await anyio.sleep(agent.leases.remaining(agent.now) + 0.5)
        assert getattr(holding.flying, "pattern", None) is None, number
        assert holding.state is HoldingState.NONE, number


@pytest.mark.parametrize("ends", ["STOP", "hover", "lease"])
@pytest.mark.parametrize(
    "order",
    [orders.FlyTo(10.0, 10.0, 10.0), orders.ChangeHeight(1e6), orders.StartHotpoint(HOTPOINT)],
    ids=lambda order: order.label,
)
async def test_a_setpoint_does_not_outlive_an_end_behind_an_order_that_was_refused(
    rig: Rig, order: orders.Order, ends: str
) -> None:
    """It may live for a second, and the order that replaces it is refused at once."""
    await airborne(rig)
    rig.agent.steer(rig.token, NORTH, 1.0)
    await anyio.sleep(0.1)
    with pytest.raises(M100Error):
        await rig.agent.ask(order, rig.token)
    if ends == "STOP":
        await rig.agent.ask(orders.Stop())
    elif ends == "hover":
        rig.agent.hover("somebody")
    else:
        rig.renewing.cancel()
        rig.agent.leases.release(rig.token, rig.agent.now)
    await anyio.sleep(0.1)
    newest = rig.aircraft.autopilot.received_movements[-1]
    assert (newest.roll_or_x, newest.pitch_or_y, newest.throttle_or_z) == (0.0, 0.0, 0.0)


async def test_an_end_that_is_cancelled_leaves_no_task_of_the_agent_behind() -> None:
    """Its release gets no answer, and the task that ends it is cancelled."""
    rig = Rig()

    async def until_cancelled() -> None:
        async with rig.running():
            await airborne(rig)
            rig.aircraft.stall_line()

    work = asyncio.ensure_future(until_cancelled())
    await rig.until(lambda: rig.agent.holding.state is HoldingState.RELEASING)
    tasks = {one.get_name() for one in asyncio.all_tasks()}
    assert {"m100link: connection", "m100link: lease", "m100link: authority"} <= tasks
    work.cancel()
    with pytest.raises(asyncio.CancelledError):
        await work
    assert work.cancelled()
    left = {one.get_name() for one in asyncio.all_tasks()} & tasks
    assert not {name for name in left if name.startswith("m100link: ")}
    assert rig.agent.connection.aircraft is None
    rig.driver.stop()


@pytest.mark.parametrize("woke_s_ago", [0.0, 0.9])
async def test_what_waited_in_the_line_of_a_suspended_computer_moves_nothing(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, woke_s_ago: float
) -> None:
    """Both clocks stood still, so it looks new: of a laptop that was opened after an hour."""
    agent, slept = rig.agent, [0.0]
    monkeypatch.setattr("m100link.flight.guards.asleep_s", lambda: slept[0])
    agent._suspended = SuspendWatch()
    await airborne(rig)
    slept[0] = 3600.0
    await asyncio.sleep(woke_s_ago)
    for kind in (order for order in ORDERS.values() if order.after_stop is not AfterStop.DONE):
        with pytest.raises(GuardRefused, match="the computer of the agent was suspended after"):
            agent.begin(example(kind), rig.token, ignore, agent.now)
    agent.begin(orders.Halt(), rig.token, ignore, agent.now)
    await agent.begin(orders.Release(), rig.token, ignore, agent.now)
    slept[0] = 7200.0  # again, and the agent notices it within a second without an order
    await asyncio.sleep(2.1)
    await agent.begin(orders.Obtain(), rig.token, ignore, agent.now)
