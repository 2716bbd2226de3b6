"""Orders in, calls of the library out; and the numbers that an agent tells its fronts."""

from __future__ import annotations

import asyncio
import inspect
import math
from collections.abc import AsyncIterator
from functools import reduce
from types import SimpleNamespace
from typing import Any
from unittest.mock import ANY, AsyncMock, MagicMock, call

import anyio
import pytest

from m100link.apps.agent import messages, orders
from m100link.apps.agent.background import TaskSet
from m100link.apps.agent.lease import Flown, Lease, LeaseChange
from m100link.apps.agent.messages import GuardLimits, Journal
from m100link.apps.agent.orders import ORDERS, CameraUse
from m100link.apps.agent.server.agent import HANDLERS, Agent
from m100link.apps.agent.server.authority import (
    HoldingInput,
    HoldingState,
    OrphanedAuthority,
    Owed,
)
from m100link.apps.agent.server.connection import ConnectionState
from m100link.apps.agent.server.flight import ActiveFlight, GuidedFlightManager, pattern
from m100link.apps.agent.server.replays import Replays
from m100link.apps.agent.server.server import AgentLog, AgentServer
from m100link.apps.agent.transports import memory_channels
from m100link.errors import LossReason, NotObserved, UsageError
from m100link.flight.authority import AuthorityState
from m100link.flight.guidance import GuidanceProgress
from m100link.flight.mission_state import MissionKind, MissionState
from m100link.flight.missions.hotpoint import CircleHeading, CircleStart, HotpointFlight
from m100link.flight.missions.waypoint import WaypointFlight
from m100link.link.statistics import LinkStatistics, RoundTrips
from m100link.missions.plan import Waypoint, WaypointPlan
from m100link.protocol.codes import ActivationCode
from m100link.protocol.commands.control import Task
from m100link.protocol.commands.gimbal import GimbalAngle, GimbalSpeed
from m100link.protocol.commands.hotpoint import HotpointStart
from m100link.protocol.setpoint import ReferenceFrame, Setpoint

pytestmark = pytest.mark.anyio

PLAN = WaypointPlan([Waypoint(52.0, 4.3, 10.0), Waypoint(52.001, 4.3, 10.0)])
UPLOAD = orders.UploadPlan.of(PLAN)
CIRCLE = HotpointStart(0.5, -0.25, 20.0, 8.5, 3.5, clockwise=0, start_point=3, yaw_mode=2)
THERE = orders.FlyTo(52.0, 4.3, 10.0)
ABSOLUTE, KEEP_YAW, KEEP_ROLL, KEEP_PITCH = 1, 2, 4, 8

fly, switch = call.flying.fly, call.flying.switch_motors
of_plan, of_circle = (
    [call.flying.mission.flight(kind)] for kind in (WaypointFlight, HotpointFlight)
)
_circle = call.flying.mission.flight()
_points = call.aircraft.gimbal.set_angles

TABLE: list[tuple[orders.Order, list[Any]]] = [
    (orders.ReleaseLease("t"), [call.agent.leases.release("t", 12.5)]),
    (orders.AcquireLease("n"), [call.leases.acquire("n", 12.5)]),
    (orders.RenewLease("t"), [call.leases.renew("t", 12.5)]),
    (orders.AskTakeOver("n"), [call.leases.ask_take_over("n", 12.5)]),
    (orders.ConfirmTakeOver("t"), [call.leases.confirm("t", 12.5)]),
    (orders.Halt("why"), [call.agent.ordered_to_hover(orders.Halt("why"), "token")]),
    (orders.Stop(), [call.agent.stop()]),
    (orders.Activate(), [call.agent.activation.activate(ANY)]),
    (orders.AskVersion(), []),
    (orders.Obtain(), [call.agent.obtain("token")]),
    (orders.Release(), [call.agent.give_back()]),
    (orders.TakeOff(), [fly(Task.TAKE_OFF, "accepted")]),
    (orders.Land(), [fly(Task.LAND, "accepted")]),
    (orders.GoHome(), [fly(Task.GO_HOME, "accepted")]),
    (orders.StartMotors(), [switch(on=True)]),
    (orders.StopMotors(), [switch(on=False)]),
    (orders.FlyPattern(1), [call.flying.start_pattern("simple task 1", ANY)]),
    (THERE, [call.flying.guide(THERE, "accepted")]),
    *(
        (one, [call.flying.guide(one, "accepted")])
        for one in (
            orders.FlyAround(52.0, 4.3, 10.0, 5.0),
            orders.ChangeHeight(5.0),
            orders.ChangeHeading(5.0),
        )
    ),
    (
        orders.PointGimbal(GimbalAngle(10.0, -5.0, -20.0, ABSOLUTE, 2.5)),
        [_points(yaw=10.0, pitch=-20.0, roll=-5.0, seconds=2.5, relative=False)],
    ),
    (
        orders.PointGimbal(GimbalAngle(10.0, -5.0, -20.0, KEEP_YAW, 2.5)),
        [_points(yaw=None, pitch=-20.0, roll=-5.0, seconds=2.5, relative=True)],
    ),
    (
        orders.PointGimbal(GimbalAngle(10.0, -5.0, -20.0, ABSOLUTE | KEEP_ROLL, 2.5)),
        [_points(yaw=10.0, pitch=-20.0, roll=None, seconds=2.5, relative=False)],
    ),
    (
        orders.PointGimbal(GimbalAngle(10.0, -5.0, -20.0, ABSOLUTE | KEEP_PITCH, 2.5)),
        [_points(yaw=10.0, pitch=None, roll=-5.0, seconds=2.5, relative=False)],
    ),
    (
        orders.TurnGimbal(GimbalSpeed(10.0, -5.0, -20.0)),
        [call.aircraft.gimbal.set_angular_rates(yaw=10.0, pitch=-20.0, roll=-5.0)],
    ),
    (orders.UseCamera(CameraUse.PHOTO), [call.aircraft.camera.take_photo()]),
    (orders.UseCamera(CameraUse.START_VIDEO), [call.aircraft.camera.start_video()]),
    (orders.UseCamera(CameraUse.STOP_VIDEO), [call.aircraft.camera.stop_video()]),
    (orders.SendToMobile(b"x"), [call.aircraft.send_to_mobile(b"x")]),
    (orders.OrderReplay("seek 3"), [call.agent.replay.order("seek 3")]),
    (orders.StopMission(), [call.flying.order_mission("stop"), call.agent.end_task()]),
    (orders.PauseMission(), [call.flying.order_mission("pause")]),
    (orders.ResumeMission(), [call.flying.order_mission("resume")]),
    (orders.SetMissionSpeed(3.25), [*of_plan, _circle.set_speed(3.25)]),
    (orders.StartHotpoint(CIRCLE), [call.flying.start_hotpoint(CIRCLE)]),
    (orders.SetHotpointRadius(12.0), [*of_circle, _circle.set_radius(12.0, wait=False)]),
    (orders.SetHotpointRate(5.0), [*of_circle, _circle.set_rate(5.0, clockwise=True, wait=False)]),
    (
        orders.SetHotpointRate(-5.0),
        [*of_circle, _circle.set_rate(5.0, clockwise=False, wait=False)],
    ),
    (orders.ResetHotpointHeading(), [*of_circle, _circle.reset_heading()]),
    *(
        (
            orders.StartMission(UPLOAD.digest, take_off=up, until_over=over),
            [call.flying.start_mission(PLAN, take_off=up, begun="accepted" if over else None)],
        )
        for up, over in ((False, True), (True, False))
    ),
]
ANSWERS = {
    orders.AskVersion: ("M100", 0x1234),
    orders.SetMissionSpeed: ("", 3246),
}


def test_the_table_has_every_order() -> None:
    assert {type(order) for order, _ in TABLE} | {orders.UploadPlan} == set(ORDERS.values())


@pytest.mark.parametrize(("order", "expected"), TABLE, ids=lambda one: type(one).__name__)
async def test_what_the_library_is_asked_for(order: orders.Order, expected: list[Any]) -> None:
    context: Any = MagicMock()
    context.token, context.accepted, context.agent.now = "token", "accepted", 12.5
    context.flying.mission.stands = True
    context.agent.connection.version = SimpleNamespace(name="M100", crc=0x1234)
    context.agent.plan = messages.PlanChanged("n", UPLOAD)
    aircraft = context.aircraft
    for one in (context.agent.activation.activate, context.agent.replay.order):
        one.side_effect = AsyncMock(return_value=None)
    for one in (aircraft.gimbal.set_angles, aircraft.gimbal.set_angular_rates):
        one.side_effect = AsyncMock(return_value=None)
    flight = context.flying.mission.flight.return_value
    flight.set_speed.side_effect = AsyncMock(return_value=3.2456)  # what the aircraft flies
    for one in (context.flying.start_mission, context.flying.order_mission, context.agent.end_task):
        one.side_effect = AsyncMock(return_value=None)
    answer = HANDLERS[type(order)](context, order)
    if inspect.iscoroutine(answer):
        answer = await answer
    assert context.mock_calls == expected
    assert type(order) not in ANSWERS or answer == ANSWERS[type(order)]


async def test_a_plan_is_kept_with_its_name_and_answered_by_its_digest() -> None:
    context: Any = MagicMock(token="token")
    context.agent.now, context.agent.leases.check.return_value.name = 12.5, "n"
    assert await HANDLERS[orders.UploadPlan](context, UPLOAD) == (UPLOAD.digest, 0)
    assert context.agent.mock_calls == [
        call.upload(messages.PlanChanged()),  # the one before is void, whatever comes of this one
        call.leases.check("token", 12.5),
        call.journal.note("n uploaded a plan of 2 waypoints"),
        call.upload(messages.PlanChanged("n", UPLOAD)),
    ]


async def test_control_goes_back_behind_the_hover(monkeypatch: pytest.MonkeyPatch) -> None:
    agent = Agent(AsyncMock())
    done: Any = MagicMock()
    done.holding.settle = AsyncMock()
    monkeypatch.setattr(agent, "hover", done.hover)
    monkeypatch.setattr(agent, "holding", done.holding)
    await agent.give_back()
    names = [name for name, _, _ in done.mock_calls]
    assert names == ["hover", "holding.let_go", "holding.settle"]


# -- one flight: what it asks of a control block ---------------------------------------------------


@pytest.fixture
async def flying() -> AsyncIterator[ActiveFlight]:
    """A flight over a control block that does nothing, and keeps what it is asked for."""
    background = TaskSet()
    yield ActiveFlight(MagicMock(), Journal(lambda: 0.0), background)
    await background.end()


async def test_a_circle_of_the_wire_is_one_of_degrees_and_metres(flying: ActiveFlight) -> None:
    control: Any = flying._control
    await flying.start_hotpoint(CIRCLE)
    assert control.hotpoint.mock_calls[0] == call(
        latitude_deg=pytest.approx(28.64788976),
        longitude_deg=pytest.approx(-14.32394488),
        height=20.0,
        radius=8.5,
        rate_deg_s=3.5,
        clockwise=False,
        start=CircleStart.EAST,
        heading=CircleHeading.OUTWARDS,
    )
    control.hotpoint.reset_mock()
    with pytest.raises(UsageError):
        await flying.mission.circle(HotpointStart(0.5, -0.25, 4.9, 8.5, 3.5))
    assert control.hotpoint.mock_calls == []


@pytest.mark.parametrize("what", ["pause", "resume", "stop"])
@pytest.mark.parametrize("is_own", [True, False])
async def test_an_order_to_a_mission_reaches_it_whoever_began_it(
    flying: ActiveFlight, what: Any, is_own: bool
) -> None:
    control, own = MagicMock(), MagicMock(is_flying=is_own)
    flying._control, flying.mission = control, own
    for one in ("pause", "resume", "stop"):
        setattr(control, f"{one}_mission", AsyncMock())
        setattr(own.flight.return_value, one, AsyncMock())
    own.stop = AsyncMock()
    await flying.order_mission(what)
    found = [name for name, _, _ in (*control.mock_calls, *own.mock_calls) if name != "flight"]
    of_own = "stop" if what == "stop" else f"flight().{what}"
    assert found == [of_own if is_own else f"{what}_mission"]


# The table of m100link/apps/agent/server/flight.py, which is that of DJI's node of 2015.
RIGHT, LEFT, BACK, FORWARD, STILL = (2.0, 0.0), (-2.0, 0.0), (0.0, 2.0), (0.0, -2.0), (0.0, 0.0)
VELOCITIES = [(0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5), *[(0.0, 0.0)] * 4]
UP_AND_TURN = [*[(0.0, 0.0)] * 4, (0.5, 0.0), (-0.5, 0.0), (0.0, 90.0), (0.0, -90.0)]
IN_ANGLES = [
    Setpoint.tilt(
        roll_deg=roll, pitch_deg=pitch, up=up, yaw_rate_deg_s=turn, frame=ReferenceFrame.BODY
    )
    for (roll, pitch), (up, turn) in zip(
        (RIGHT, LEFT, BACK, FORWARD, *[STILL] * 4), UP_AND_TURN, strict=True
    )
]
IN_VELOCITIES = [
    Setpoint.velocity(north=north, east=east, up=up, yaw_rate_deg_s=turn)
    for (north, east), (up, turn) in zip(VELOCITIES, UP_AND_TURN, strict=True)
]


class Block:
    """A control block that counts seconds, and keeps what is asked of it."""

    def __init__(self, seconds: float) -> None:
        self.log: list[Any] = []
        self._seconds = seconds
        self.most = 100  # so much is asked of it

    async def ticks(self) -> AsyncIterator[Any]:
        for second in range(int(self._seconds)):
            yield SimpleNamespace(elapsed=float(second))

    def __getattr__(self, name: str) -> Any:
        async def done() -> None:
            self.log.append(name)
            if len(self.log) == self.most:
                raise UsageError("enough")

        return done


@pytest.mark.parametrize(("number", "legs"), [(0, IN_ANGLES), (1, IN_VELOCITIES)])
async def test_a_simple_task_flies_the_legs_of_djis_node(number: int, legs: list[Setpoint]) -> None:
    """Five seconds each, and all of them again."""
    block: Any = Block(51.0)
    await pattern(number)(block, block.log.append)
    expected = [leg for leg in legs for _ in range(5)]
    assert block.log == [*expected, *expected[:11]]


async def test_the_longer_tasks_are_made_of_those_and_of_the_autopilots() -> None:
    block: Any = Block(60.0)
    await pattern(4)(block, block.log.append)
    assert block.log[0] == "take_off"
    assert [block.log[28], block.log[29]] == [IN_ANGLES[5], IN_VELOCITIES[0]], "28 s, then 40 s"
    assert (len(block.log), block.log[-2:]) == (70, [IN_VELOCITIES[7], "go_home"])
    block = Block(0.0)
    block.most = 13
    with pytest.raises(UsageError, match="enough"):
        await pattern(2)(block, block.log.append)
    assert block.log == [*["take_off", "land", "take_off", "go_home"] * 3, "take_off"]
    for number, why in ((3, "random commands"), (5, "no simple task 5"), (-1, "no simple task")):
        with pytest.raises(UsageError, match=why):
            pattern(number)


AROUND = orders.FlyAround(1.0, 2.0, 8.0, 10.0, turns=1.5)


@pytest.mark.parametrize(
    ("order", "found", "rest"),
    [
        # 40 m at 4 m/s take ten seconds and more, and 60 m of height twenty.
        (orders.FlyTo(1.0, 2.0, 8.0, 4.0, 90.0), (40.0, 3.0, 5.0), (40.0, 10.0, 20.0)),
        (orders.FlyTo(1.0, 2.0, 8.0, 4.0, 90.0), (40.0, -60.0, 5.0), (40.0, 20.0, 20.0)),
        # 12 m to the circle, and one turn and a half of 2 pi 10 m at 2 m/s.
        (AROUND, (12.0, 0.0, 540.0), (106.25, 51.1, 60.0)),
        (AROUND, (0.0, -30.0, 540.0), (94.25, 57.1, 57.2)),
        (AROUND, (0.0, 0.0, -9.0), (0.0, 0.0, 0.0)),
        (orders.ChangeHeight(8.0), (7.0, -6.0, 5.0), (6.0, 2.0, 2.0)),
        (orders.ChangeHeading(-45.0), (7.0, -6.0, -45.0), (None, 0.5, 0.5)),
    ],
)
async def test_how_far_a_guided_flight_is(
    order: orders.GuidedOrder,
    found: tuple[float, float, float],
    rest: tuple[float | None, float, float],
) -> None:
    """Metres to go, up, and degrees in; metres and seconds, at least and at most, out."""
    flown = asyncio.Event()
    told: list[orders.GuidedFlight | None] = []
    background, begun = TaskSet(), list[int]()

    async def loop(*_: Any, progress: Any, approach: Any = None, **__: Any) -> None:
        told.append(guiding.current())
        progress(GuidanceProgress(1.0, *found))
        if found[2] == 540.0:  # on the way to a circle, all turns remain
            approach(GuidanceProgress(1.0, *found[:2], 7.0))
        else:
            progress(GuidanceProgress(1.0, *found))
        told.append(guiding.current())
        flown.set()

    names = ("fly_to", "orbit", "climb_to", "turn_to")
    control: Any = SimpleNamespace(state=None, **dict.fromkeys(names, loop))
    guiding = GuidedFlightManager(control, Journal(lambda: 0.0), background)
    await guiding.fly(order, lambda: begun.append(1))
    before, during = told
    assert before is not None
    assert during is not None
    assert (before.distance_m, before.seconds, begun) == (None, None, [1])
    metres, least, most = rest
    assert during.distance_m == (None if metres is None else pytest.approx(metres, abs=0.01))
    assert during.seconds is not None
    assert least - 0.05 <= during.seconds <= most + 0.05
    turns = isinstance(order, orders.ChangeHeading)
    is_there = isinstance(order, orders.FlyTo | orders.FlyAround)
    assert during.what == order.label
    assert (during.latitude_deg, during.longitude_deg) == ((1.0, 2.0) if is_there else (None, None))
    assert during.height == (None if turns else 8.0)
    assert during.radius == (10.0 if isinstance(order, orders.FlyAround) else 0.0)
    assert during.yaw_deg == {orders.FlyTo: 90.0, orders.ChangeHeading: -45.0}.get(type(order))
    await background.end()


@pytest.mark.parametrize(("seconds", "timeout"), [(0.0, 30.0), (20.0, 90.0)])
async def test_a_guided_flight_is_given_three_times_as_long_and_half_a_minute(
    seconds: float, timeout: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    foreseen = SimpleNamespace(seconds=seconds)
    monkeypatch.setattr("m100link.apps.agent.server.flight.preview", lambda *_: foreseen)
    given: list[float] = []

    async def loop(*_: Any, timeout: float, **__: Any) -> None:
        given.append(timeout)

    names = ("fly_to", "orbit", "climb_to", "turn_to")
    control: Any = SimpleNamespace(state=None, **dict.fromkeys(names, loop))
    background = TaskSet()
    guiding = GuidedFlightManager(control, Journal(lambda: 0.0), background)
    around = orders.FlyAround(52.0, 4.3, 10.0, 5.0)
    for order in (THERE, around, orders.ChangeHeight(5.0), orders.ChangeHeading(5.0)):
        await guiding.fly(order, lambda: None)
    assert given == [timeout] * 4
    await background.end()


@pytest.mark.parametrize("begun", [False, True])
@pytest.mark.parametrize("work", ["watch", "stopping", ""])
async def test_a_mission_that_is_cut_off_is_named_if_it_had_begun(
    flying: ActiveFlight, begun: bool, work: str
) -> None:
    mission, task = flying.mission, MagicMock()
    mission._what, mission._flight = "circle", MagicMock() if begun else None
    if work:
        setattr(mission, work, task)
    is_named = begun and bool(work)
    assert mission.cut_off() == ("circle" if is_named else "")
    assert mission._is_cut_off is is_named
    assert task.cancel.called is (is_named or work == "watch")


# -- authority that nobody holds -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("state", "reason", "owed"),
    [
        (AuthorityState.UNRELEASED, LossReason.NONE, Owed.AT_ONCE),
        (AuthorityState.HELD, LossReason.NONE, Owed.AFTER_STOP),
        (AuthorityState.NONE, LossReason.RELEASED, Owed.NOTHING),
        (AuthorityState.PAUSED, LossReason.MODE_SWITCH, Owed.NOTHING),
        (AuthorityState.LOST, LossReason.APP, Owed.NOTHING),
        (AuthorityState.LOST, LossReason.LINK, Owed.AFTER_LEASE),
        (AuthorityState.UNRELEASED, LossReason.LINK, Owed.AFTER_LEASE),
    ],
)
@pytest.mark.parametrize("least", [Owed.AFTER_STOP, Owed.AFTER_LEASE, Owed.AT_ONCE])
async def test_what_a_block_leaves_goes_back_when_that_much_is_owed(
    state: AuthorityState, reason: LossReason, owed: Owed, least: Owed
) -> None:
    background, journal = TaskSet(), Journal(lambda: 0.0)
    orphaned = OrphanedAuthority(journal, background)
    aircraft: Any = MagicMock(release_authority=AsyncMock(return_value=True))
    aircraft.authority.state, aircraft.authority.reason = state, reason
    orphaned.connected(aircraft, is_activated=True)
    orphaned.block_ended(aircraft)
    assert orphaned.owed is owed
    orphaned.look(least)
    await anyio.sleep(0.1)
    goes_back = owed is not Owed.NOTHING and owed >= least
    assert aircraft.release_authority.called is goes_back
    assert orphaned.owed is (Owed.NOTHING if goes_back else owed)
    told = [(event.level, event.text.partition(" is given")[0]) for event in journal.events]
    said = "control authority that this agent may have left"
    assert told == [("warning", said)] * goes_back
    await background.end()


async def test_a_release_goes_out_again_each_second_and_is_reported_once() -> None:
    background, journal = TaskSet(), Journal(lambda: 0.0)
    orphaned = OrphanedAuthority(journal, background)
    orphaned.owed = Owed.AT_ONCE
    aircraft: Any = MagicMock(release_authority=AsyncMock(return_value=False))
    orphaned.look(Owed.AT_ONCE)
    assert orphaned.work is None, "nobody is connected"
    orphaned.connected(aircraft, is_activated=True)
    for _ in range(61):
        orphaned.look(Owed.AT_ONCE)
        await anyio.sleep(0.05)
    assert aircraft.release_authority.call_count == 3
    assert [event.level for event in journal.events] == ["error"]
    assert journal.events[0].text.startswith("the agent before may have left control authority")
    with pytest.raises(NotObserved, match="does not confirm"):
        await orphaned.insist()
    assert aircraft.release_authority.call_count == 4, "at once, whenever it went out"
    orphaned.connected(None, is_activated=False)
    owed = [orphaned.owed]
    orphaned.connected(aircraft, is_activated=False)  # which obeys nobody
    assert [*owed, orphaned.owed] == [Owed.AT_ONCE, Owed.NOTHING]
    await orphaned.insist()
    assert aircraft.release_authority.call_count == 4
    await background.end()


@pytest.mark.parametrize(
    ("why", "begins", "ends", "text", "level"),
    [
        (LeaseChange.ACQUIRED, True, False, "new has control (acquired)", "info"),
        (LeaseChange.TAKEN_OVER, True, True, "new has control (taken over from old)", "info"),
        (LeaseChange.RELEASED, False, True, "old gave control back (released)", "info"),
        (LeaseChange.EXPIRED, False, True, "old lost control (expired)", "warning"),
        (LeaseChange.FRONT_LOST, False, True, "old lost control (its front has gone)", "warning"),
    ],
)
async def test_what_a_change_of_the_lease_ends_and_says(
    why: LeaseChange,
    begins: bool,
    ends: bool,
    text: str,
    level: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    agent = Agent(AsyncMock())
    holding: Any = MagicMock(has_authority=True, flown=Flown.PROGRAM)
    monkeypatch.setattr(agent, "holding", holding)
    agent.plan, told = messages.PlanChanged("old", UPLOAD), list[Any]()
    agent.on_lease.append(lambda *one: told.append(one))
    old, new = (Lease(name, "t", number) for number, name in enumerate(("old", "new")))
    agent._lease_changed(why, old if ends else None, new if begins else None)
    assert holding.flying.hover.mock_calls == [call("control changed hands")]
    assert told == [(why, new if begins else None, Flown.PROGRAM)]
    assert agent.plan == messages.PlanChanged(), "nobody flies what somebody else left"
    fed = HoldingInput.TAKEN_OVER if begins else HoldingInput.LET_GO
    assert [one.args[0] for one in holding.feed.mock_calls] == [fed]
    assert [(one.text, one.level) for one in agent.journal.events] == [(text, level)]


async def test_what_an_agent_notes_in_the_log_of_a_flight() -> None:
    """Places in degrees, north before east, and metres; times in seconds."""
    agent: Any = MagicMock(now=7.0, plan=messages.PlanChanged(), on_lease=[], on_plan=[])
    agent.holding = SimpleNamespace(on_change=[], cause=HoldingInput.LET_GO, limits="limits")
    agent.holding.flying = MagicMock(seen_task="take off", pattern=None, is_steered=True)
    agent.holding.flying.guiding.order = THERE
    agent.connection = SimpleNamespace(on_aircraft=[], aircraft=None)
    agent.journal.events = [messages.Event(4, 10.5, "warning", "wind")]
    agent.leases.holder.return_value = Lease("anna", "token", 3)
    front: Any = MagicMock(take_notes=lambda: [])
    front.name = "console"
    log = AgentLog(agent, {front})
    log.note("early", number=1)
    agent.now, aircraft = 10.0, MagicMock(mission=MissionState(MissionKind.WAYPOINT, 2))
    agent.connection.aircraft = aircraft
    agent.connection.on_aircraft[0](aircraft)
    take = aircraft.note_from.call_args.args[0]
    agent.now = 11.0
    agent.on_plan[0](messages.PlanChanged("field", UPLOAD))
    agent.on_lease[0](LeaseChange.EXPIRED, None, Flown.PROGRAM)
    for holder, at in ((None, 12.0), (Lease("anna", "token", 3), 13.0)):
        agent.leases.holder.return_value, agent.now = holder, at
        agent.holding.on_change[0](HoldingState.HELD, HoldingState.RELEASING)
    way = [(52.0, 4.3, 10.0), (52.001, 4.3, 10.0)]
    changed = {"event": "control", "before": HoldingState.HELD, "after": HoldingState.RELEASING}
    assert take() == [
        {"event": "early", "number": 1, "earlier_s": 3.0, "at": 10.0},
        {"event": "clients", "names": ["console"], "at": 10.0},
        {"event": "lease", "why": "in force", "number": 3, "holder": "anna", "at": 10.0},
        {"event": "plan", "name": "", "waypoints": [], "at": 10.0},
        {"event": "journal", "level": "warning", "text": "wind", "topic": ANY, "at": 10.5},
        {"event": "plan", "name": "field", "waypoints": way, "at": 11.0},
        {
            "event": "lease",
            "why": LeaseChange.EXPIRED,
            "number": 0,
            "holder": "",
            "flown": Flown.PROGRAM,
            "at": 11.0,
        },
        {**changed, "why": "the lease has ended", "at": 12.0},
        {**changed, "why": "its client gives it back", "at": 13.0},
        {
            "event": "state",
            "task": "take off",
            "pattern": "",
            "guided": THERE.label,
            "steered": True,
            "mission": "",  # one is pushed, but not of late
            "waypoint": 2,
            "limits": "limits",
            "at": 13.0,
        },
    ]
    assert take() == [], "nothing has changed since"
    agent.holding.flying.seen_task, agent.now = None, 14.0
    aircraft.mission = MissionState(MissionKind.WAYPOINT, 2, is_running=True)
    news = {"task": "", "mission": MissionKind.WAYPOINT.value}
    assert take() == [{"event": "state", **news, "at": 14.0}]


# -- messages to fronts ----------------------------------------------------------------------------

STATISTICS = LinkStatistics(
    bytes_received=1001,
    bytes_sent=1002,
    frames_received=1003,
    frames_sent=1004,
    discards={"crc16": 3, "crc32": 4},
    discarded_bytes=1005,
    dropped_writes=7,
    acks=1006,
    duplicate_acks=1007,
    late_acks=5,
    foreign_acks=6,
    repeats=1008,
    expired=1009,
    round_trips=RoundTrips(tuple(range(12)), 2.75),
    missed_setpoints=1010,
    round_trip_s=0.125,
)


def telling(**changed: Any) -> Any:
    """An agent of which everything is known, and a front of it."""
    agent: Any = MagicMock(now=50.0, replay=None)
    agent.background.spawn = lambda work, _: work.close()
    agent.connection.state, agent.connection.error = ConnectionState.CONNECTED, None
    agent.connection.round_trip = 0.25
    aircraft = agent.connection.aircraft
    aircraft.is_activated, aircraft.firmware, aircraft.telemetry_mismatches = True, "3.1", 8
    aircraft.statistics.return_value = STATISTICS
    aircraft.mission = MissionState(MissionKind.WAYPOINT, 4, 2, 45.0, is_running=True)
    agent.activation.code, agent.activation.error = ActivationCode.SUCCESS, None
    agent.holding.state, agent.holding.has_authority = HoldingState.HELD, True
    agent.holding.limits = GuardLimits(50.0, 150.0, 10.0, 20, 52.0, 4.3)
    flying = agent.holding.flying
    flying.seen_task, flying.pattern = "land", "simple task 1"
    flying.is_steered, agent.steered_at = True, 49.75
    flying.guiding.current.return_value = orders.GuidedFlight("flight", 52.0, 4.3)
    agent.leases.remaining.side_effect = lambda at: 52.5 - at
    agent.leases.holder.return_value = None
    agent.plan, agent.journal.events = messages.PlanChanged(), []
    for name, value in changed.items():
        *places, last = name.split(".")
        setattr(reduce(getattr, places, agent), last, value)
    return agent


def heard(agent: Any) -> tuple[AgentServer, list[messages.Message]]:
    service, inbox = AgentServer(agent), list[messages.Message]()
    ours, its = memory_channels(as_bytes=True)
    ours.open(inbox.append, lambda _: None)
    service.attach(its)
    return service, inbox


async def test_the_state_has_each_number_in_its_place() -> None:
    _, (_, _, state, _) = heard(telling())
    assert state == messages.State(
        at=50.0,
        connection="connected",
        firmware="3.1",
        is_activated=True,
        activation_code=int(ActivationCode.SUCCESS),
        holding="held",
        has_authority=True,
        setpoint_age=0.25,
        task="land",
        pattern="simple task 1",
        guided=orders.GuidedFlight("flight", 52.0, 4.3),
        mission="waypoint mission",
        mission_index=4,
        mission_status=2,
        lease_remaining=2.5,
        round_trip=0.25,
        discards=3 + 4,
        late_acks=5 + 6,
        dropped_writes=7,
        mismatches=8,
        limits=GuardLimits(50.0, 150.0, 10.0, 20, 52.0, 4.3),
    )


async def test_what_nobody_knows_is_not_in_the_state() -> None:
    gone = {"connection.aircraft": None, "holding.flying": None, "activation.code": None}
    _, (_, _, state, _) = heard(telling(**gone))
    assert isinstance(state, messages.State)
    assert (state.firmware, state.is_activated, state.activation_code) == ("", False, None)
    assert (state.task, state.pattern, state.guided, state.mission) == ("", "", None, "")
    numbers = state.discards, state.late_acks, state.dropped_writes, state.mismatches
    assert (*numbers, state.mission_index, state.mission_status) == (0, 0, 0, 0, -1, -1)


@pytest.mark.parametrize(
    ("kind", "is_running", "told"),
    [
        (MissionKind.HOTPOINT, True, "hotpoint"),
        (MissionKind.HOTPOINT, False, ""),
        (MissionKind.NONE, False, "no mission"),
        (MissionKind.UNKNOWN, False, ""),
    ],
)
async def test_a_mission_is_told_while_it_flies(
    kind: MissionKind, is_running: bool, told: str
) -> None:
    state = MissionState(kind, None, None, None, is_running)
    _, (_, _, found, _) = heard(telling(**{"connection.aircraft.mission": state}))
    assert isinstance(found, messages.State)
    assert (found.mission, found.mission_index, found.mission_status) == (told, -1, -1)


async def test_counters_of_the_line_go_by_their_names() -> None:
    service, inbox = heard(telling())
    service._tell_counters(0.75)
    told = inbox[-1]
    assert isinstance(told, messages.LinkCounted)
    counters = {name: 1001 + place for place, name in enumerate(COUNTED)}
    expected = {"dropped_writes": 7, "late_acks": 5, "foreign_acks": 6}
    assert told.counters == counters | expected
    bounds = ("0.001", "0.002", "0.005", "0.01", "0.02", "0.05", "0.1", "0.2", "0.5")
    classes = {bound: place for place, bound in enumerate((*bounds, "1.0", "2.0", "inf"))}
    assert told == messages.LinkCounted(
        50.0, told.counters, {"crc16": 3, "crc32": 4}, 0.75, classes, 2.75
    )


COUNTED = (
    *("bytes_received", "bytes_sent", "frames_received", "frames_sent", "discarded_bytes"),
    *("acks", "duplicate_acks", "repeats", "expired", "missed_setpoints"),
)


@pytest.mark.parametrize(
    "name",
    [
        *("connection.state", "connection.error", "connection.aircraft.is_activated"),
        *("activation.code", "activation.error", "holding.state", "holding.has_authority"),
        *("holding.flying.seen_task", "holding.flying.pattern", "holding.flying.guiding.order"),
        "holding.flying.is_steered",
        "connection.aircraft.mission",
    ],
)
async def test_each_change_of_the_state_is_told_at_once_and_once(name: str) -> None:
    agent = telling()
    service, inbox = heard(agent)
    before = len(inbox)
    service._tell_state()
    assert len(inbox) == before
    changed: dict[str, Any] = {
        "connection.state": ConnectionState.LOST,
        "connection.error": UsageError("x"),
        "connection.aircraft.is_activated": False,
        "activation.code": ActivationCode.ENCRYPTED,
        "activation.error": UsageError("x"),
        "holding.state": HoldingState.NONE,
        "holding.has_authority": False,
        "holding.flying.is_steered": False,
        "connection.aircraft.mission": MissionState(),
    }
    *places, last = name.split(".")
    setattr(reduce(getattr, places, agent), last, changed.get(name, ""))
    for _ in range(2):
        service._tell_state()
    assert [type(one) for one in inbox[before:]] == [messages.State]


# -- a replay --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("order", "expected"),
    [
        ("pause", [call.pause()]),
        ("resume", [call.resume()]),
        ("toggle", [call.pause()]),
        ("speed 2.5", [call.set_speed(2.5)]),
        ("speed max", [call.set_speed(math.inf)]),
        ("seek 30", [call.seek(30.0)]),
        ("by -10", [call.seek(90.0)]),
    ],
)
async def test_an_order_to_a_replay_moves_it(order: str, expected: list[Any]) -> None:
    player: Any = MagicMock(is_at_end=False, is_paused=False, speed=4.0, position_s=100.0)
    replays = object.__new__(Replays)
    replays._player = player
    await replays.order(order)
    assert player.mock_calls == expected


async def test_a_replay_at_its_end_begins_again() -> None:
    player: Any = MagicMock(is_at_end=True, is_paused=False, position_s=100.0)
    replays = object.__new__(Replays)
    replays._player = player
    await replays.order("toggle")
    player.is_at_end, player.is_paused = False, True
    await replays.order("toggle")
    assert player.mock_calls == [call.seek(0.0), call.resume(), call.resume()]
    for wrong in ("seek", "seek x", "by nan", "speed inf", "somewhere 3", ""):
        with pytest.raises(UsageError):
            await replays.order(wrong)
    replays._player = None
    with pytest.raises(UsageError, match="nothing is played"):
        await replays.order("pause")


@pytest.mark.parametrize(("before", "owed"), [(0, Owed.NOTHING), (1, Owed.AT_ONCE)])
async def test_after_an_agent_that_may_have_granted_a_lease_control_is_given_back(
    before: int, owed: Owed
) -> None:
    agent = Agent(AsyncMock(), leases_before=before)
    assert agent.holding.orphaned.owed is owed
