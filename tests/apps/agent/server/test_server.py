"""What a front can make an agent do, by messages alone."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.lease import Flown, Lease, LeaseChange, TakeOver
from m100link.apps.agent.messages import (
    LOG_ONLY,
    VERSION,
    Ask,
    Event,
    GuardLimits,
    Hello,
    JournalNote,
    LeaseChanged,
    Message,
    OrderOutcome,
    PlanChanged,
    Stage,
    State,
    Steer,
    SteerRefused,
    Telemetry,
)
from m100link.apps.agent.orders import FlyTo
from m100link.apps.agent.server.agent import HANDLERS
from m100link.apps.agent.server.flight import limits_of
from m100link.apps.agent.server.server import AgentServer
from m100link.apps.agent.transports import memory_channels
from m100link.errors import UsageError
from m100link.flight.control import Control
from m100link.flight.guards import Envelope, Guards
from m100link.geodesy import LocalFrame
from m100link.missions.plan import Waypoint, WaypointPlan
from m100link.protocol.commands.control import Task
from m100link.protocol.commands.gimbal import GimbalAngle, GimbalSpeed
from m100link.protocol.setpoint import Setpoint
from m100link.telemetry.sample import Sample
from tests.apps.agent.conftest import Rig, guided
from tests.apps.agent.examples import EXAMPLES

pytestmark = pytest.mark.anyio

NORTH = Setpoint.velocity(north=1.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)

M = TypeVar("M")


class Front:
    """A front by hand: sends messages, keeps what comes."""

    def __init__(self, rig: Rig, service: AgentServer, *, greets: bool = True) -> None:
        self.rig = rig
        self.channel, its = memory_channels(as_bytes=True)
        service.attach(its)
        self.inbox: list[Message] = []
        self.closed: list[str] = []
        self.channel.open(self.inbox.append, self.closed.append)
        if greets:
            self.send(Hello(VERSION, "front", rig.agent.now))

    def send(self, message: Message) -> None:
        self.channel.send(message)

    def all(self, kind: type[M]) -> list[M]:
        return [one for one in self.inbox if isinstance(one, kind)]

    def lease(self, name: str = "pilot") -> Lease:
        self.send(Ask(99, orders.AcquireLease(name)))
        return self.granted

    @property
    def granted(self) -> Lease:
        return [one.lease for one in self.all(OrderOutcome) if one.lease is not None][-1]

    @property
    def offer(self) -> TakeOver:
        [found] = [one.offer for one in self.all(OrderOutcome) if one.offer is not None]
        return found

    async def outcome(self, identity: int, stage: Stage = Stage.DONE) -> OrderOutcome:
        def found() -> list[OrderOutcome]:
            return [
                one for one in self.all(OrderOutcome) if (one.id, one.stage) == (identity, stage)
            ]

        await self.rig.until(lambda: bool(found()))
        return found()[0]

    async def airborne(self) -> int:
        fence = self.lease().number
        self.rig.agent.background.spawn(self._alive(), "alive")
        self.send(Ask(1, orders.Obtain(), fence))
        await self.outcome(1)
        self.send(Ask(2, orders.TakeOff(), fence))
        await self.outcome(2)
        return fence

    async def _alive(self) -> None:
        token = self.granted.token
        while True:
            await anyio.sleep(0.5)
            self.send(Ask(0, orders.RenewLease(token)))

    @property
    def moves(self) -> list[Any]:
        return list(self.rig.aircraft.autopilot.received_movements)


@pytest.fixture
async def service(rig: Rig) -> AgentServer:
    rig.agent.leases.release(rig.token, rig.agent.now)  # the lease is the front's to take
    return AgentServer(rig.agent)


@pytest.mark.parametrize(
    ("hears_begin", "stages"), [(True, [Stage.ACCEPTED, Stage.DONE]), (False, [Stage.DONE])]
)
async def test_a_begin_is_told_to_a_front_that_hears_it(
    rig: Rig, service: AgentServer, hears_begin: bool, stages: list[Stage]
) -> None:
    front = Front(rig, service)
    await front.airborne()
    front.send(Ask(3, orders.Land(), front.granted.number, hears_begin=hears_begin))
    await front.outcome(3)
    assert [one.stage for one in front.all(OrderOutcome) if one.id == 3] == stages


async def test_a_front_is_greeted_with_everything_it_has_to_know(
    rig: Rig, service: AgentServer
) -> None:
    front = Front(rig, service)
    hello, lease, state, plan, *events = front.inbox
    assert plan == PlanChanged()
    assert isinstance(hello, Hello)
    assert hello.version == VERSION
    assert lease == LeaseChanged(0, "")
    assert isinstance(state, State)
    assert (state.connection, state.is_activated, state.holding) == ("connected", True, "none")
    assert [one.text for one in events if isinstance(one, Event)] == [
        one.text for one in rig.agent.journal.events
    ]
    await anyio.sleep(1.0)
    assert len(front.all(Telemetry)) > 40
    states = len(front.all(State))
    await anyio.sleep(2.0)
    assert len(front.all(State)) - states == pytest.approx(8, abs=1.1)


async def test_a_flight_by_messages(rig: Rig, service: AgentServer) -> None:
    front = Front(rig, service)
    fence = await front.airborne()
    assert front.all(State)[-1].has_authority
    front.send(Steer(fence, rig.agent.now, 0.3, NORTH))
    await anyio.sleep(0.1)
    assert front.moves[-1].roll_or_x == 1.0
    front.send(Ask(0, orders.Halt()))
    await anyio.sleep(0.03)
    assert front.moves[-1].roll_or_x == 0.0
    front.send(Ask(3, orders.Release(), fence))
    await front.outcome(3)
    assert front.all(State)[-1].holding == "none"
    front.send(Ask(4, orders.AskVersion()))
    assert "M100" in (await front.outcome(4)).text


async def test_a_front_knows_the_limits_and_from_where_they_are_measured(
    rig: Rig, service: AgentServer
) -> None:
    front = Front(rig, service)
    before = front.all(State)[-1].limits
    assert before == GuardLimits(50.0, 150.0, 10.0, 20)
    await front.airborne()
    await anyio.sleep(0.5)
    during = front.all(State)[-1].limits
    settings = rig.aircraft.vehicle.settings
    assert during.latitude_deg == pytest.approx(settings.latitude_deg, abs=1e-6)
    assert during.longitude_deg == pytest.approx(settings.longitude_deg, abs=1e-6)


def test_a_limit_that_is_off_is_reported_as_none() -> None:
    open_above = Guards(envelope=Envelope(max_height_m=math.inf), battery_floor_percent=None)
    assert limits_of(open_above, (1.0, 2.0)) == GuardLimits(None, 150.0, 10.0, None, 1.0, 2.0)
    assert limits_of(Guards(envelope=None), None) == GuardLimits(battery_floor_percent=20)


async def test_the_state_is_reported_before_the_outcome(rig: Rig, service: AgentServer) -> None:
    front = Front(rig, service)
    front.send(Ask(1, orders.Obtain(), front.lease().number))
    await front.outcome(1)
    place = front.inbox.index(OrderOutcome(1, Stage.DONE))
    states = [one for one in front.inbox[:place] if isinstance(one, State)]
    assert states[-1].has_authority


async def test_a_front_that_has_gone_costs_a_hover(rig: Rig, service: AgentServer) -> None:
    front = Front(rig, service)
    fence = await front.airborne()
    front.send(Steer(fence, rig.agent.now, 1.0, NORTH))
    await anyio.sleep(0.5)
    front.channel.close("killed")
    await anyio.sleep(0.03)
    assert front.moves[-1].roll_or_x == 0.0
    assert rig.agent.leases.holder(rig.agent.now) is None
    await rig.until(lambda: not rig.aircraft.vehicle.authority.is_requested, within=2.0)
    assert rig.aircraft.height > 1.0
    other = Front(rig, service)  # and another one flies on
    assert other.lease().number > fence


async def test_a_front_that_hangs_loses_its_lease(rig: Rig, service: AgentServer) -> None:
    front = Front(rig, service)
    fence = front.lease().number
    front.send(Ask(1, orders.Obtain(), fence))
    await front.outcome(1)
    await rig.until(lambda: front.all(LeaseChanged)[-1].number == 0, within=3.5)
    await rig.until(lambda: not rig.holding.has_authority, within=1.0)


async def test_a_setpoint_that_was_long_on_its_way_is_not_flown(
    rig: Rig, service: AgentServer
) -> None:
    front = Front(rig, service)
    fence = await front.airborne()
    front.send(Steer(fence, rig.agent.now - 0.31, 0.3, NORTH))
    await anyio.sleep(0.1)
    assert front.moves == []
    (refused,) = front.all(SteerRefused)
    assert refused.fault.details["guard"] == "setpoint_age"
    front.send(Steer(fence, rig.agent.now - 0.29, 0.3, NORTH))
    await anyio.sleep(0.1)
    assert front.moves[-1].roll_or_x == 1.0


async def test_a_setpoint_from_the_future_is_not_flown(rig: Rig, service: AgentServer) -> None:
    front = Front(rig, service)
    fence = await front.airborne()
    front.send(Steer(fence, rig.agent.now + 0.31, 0.3, NORTH))
    await anyio.sleep(0.1)
    assert front.moves == []
    (refused,) = front.all(SteerRefused)
    assert "ahead" in refused.fault.cause


async def test_a_fence_of_another_front_moves_nothing(rig: Rig, service: AgentServer) -> None:
    fence = await Front(rig, service).airborne()
    other = Front(rig, service)
    other.send(Steer(fence, rig.agent.now, 0.3, NORTH))
    for number, action in enumerate(
        (orders.Land(), orders.Release(), orders.FlyPattern(0)), start=10
    ):
        other.send(Ask(number, action, fence))
        outcome = await other.outcome(number, Stage.FAILED)
        assert outcome.fault is not None
        assert outcome.fault.kind == "LeaseRefused"
    await anyio.sleep(0.1)
    assert other.moves == []
    assert other.all(SteerRefused)[0].fault.kind == "LeaseRefused"
    assert rig.holding.has_authority


async def test_an_old_fence_moves_nothing(rig: Rig, service: AgentServer) -> None:
    front = Front(rig, service)
    fence = await front.airborne()
    token = front.granted.token
    front.send(Ask(5, orders.ReleaseLease(token)))
    await front.outcome(5)
    new = front.lease().number
    assert new > fence
    front.send(Steer(fence, rig.agent.now, 0.3, NORTH))
    assert front.all(SteerRefused)[-1].fence == fence


async def test_a_take_over_names_who_loses_it(rig: Rig, service: AgentServer) -> None:
    first, second = Front(rig, service), Front(rig, service)
    first.lease(name="first")
    second.send(Ask(1, orders.AcquireLease("second")))
    refused = await second.outcome(1, Stage.FAILED)
    assert refused.fault is not None
    assert refused.fault.details["holder"] == "first"
    second.send(Ask(2, orders.AskTakeOver("second")))
    offer = second.offer
    assert offer.from_name == "first"
    second.send(Ask(3, orders.ConfirmTakeOver(offer.token)))
    assert second.all(OrderOutcome)[-1] == OrderOutcome(3, Stage.DONE, lease=second.granted)
    assert first.all(LeaseChanged)[-1].name == "second"


async def test_another_version_is_not_served(rig: Rig, service: AgentServer) -> None:
    front = Front(rig, service, greets=False)
    front.send(Hello(VERSION + 1, "from the future", 0.0))
    assert front.closed == [f"this agent speaks version {VERSION}, not {VERSION + 1}"]


@pytest.mark.parametrize("greets", [False, True])
async def test_what_a_front_does_not_send_ends_it(
    rig: Rig, service: AgentServer, greets: bool
) -> None:
    front = Front(rig, service, greets=greets)
    front.send(Telemetry(b"", "1.0", 0.0) if greets else Ask(1, orders.Halt()))
    assert len(front.closed) == 1
    assert front.all(OrderOutcome) == []


async def test_notes_and_questions_are_bounded(rig: Rig, service: AgentServer) -> None:
    front = Front(rig, service)
    for number in range(1000):
        front.send(JournalNote("info", f"note {number}"))
        front.send(Ask(number + 1, orders.AskVersion()))
    notes = [one for one in rig.agent.journal.events if one.text.startswith("note ")]
    assert len(notes) == 20
    front.send(Ask(2000, orders.Stop()))  # what ends a flight waits behind nobody
    refused = [one for one in front.all(OrderOutcome) if one.stage is Stage.FAILED]
    assert len(refused) == 1000 - 64
    await front.outcome(2000)
    front.send(JournalNote("shout", "x"))
    assert rig.agent.journal.events[-1].level != "shout"
    for seconds, more in ((1.0, 5), (100.0, 20)):  # five of each second, twenty at most
        await anyio.sleep(seconds)
        for _ in range(100):
            front.send(JournalNote("info", "note"))
        later = [one for one in rig.agent.journal.events if one.text == "note"]
        assert len(later) == {5: 5, 20: 25}[more]


@pytest.mark.parametrize(("level", "most"), [("info", 200), (LOG_ONLY, 4000)])
async def test_a_note_that_is_too_long_says_that_it_was_cut(
    rig: Rig, service: AgentServer, level: str, most: int
) -> None:
    """A long mission would else seem to end with the last item that fitted."""
    front = Front(rig, service)
    front.send(JournalNote(level, "x" * (most + 1)))
    (session,) = service._fronts
    told = [one.text for one in rig.agent.journal.events]
    told += [values["text"] for _, _, values in session.take_notes()]
    assert "x" * (most - 3) + "..." in told
    assert "x" * (most - 2) not in "".join(told)


async def test_questions_without_the_lease_cost_its_holder_behind_the_same_front_nothing(
    rig: Rig, service: AgentServer
) -> None:
    front = Front(rig, service)
    fence = await front.airborne()
    for number in range(100, 300):  # somebody else's, who has no lease
        front.send(Ask(number, orders.AskVersion(), fence + 1))
    front.send(Ask(3, orders.ChangeHeading(90.0), fence, hears_begin=True))
    await front.outcome(3, Stage.ACCEPTED)
    for number in range(300, 500):  # nor do those of the holder cost others anything
        front.send(Ask(number, orders.SetHotpointRate(5.0), fence))
    front.send(Ask(4, orders.AskVersion()))
    await front.outcome(4)
    refused = [
        one for one in front.all(OrderOutcome) if one.fault and "wait already" in one.fault.seen
    ]
    assert len([one for one in refused if one.id < 300]) == 200 - 64
    assert {one.id for one in refused}.isdisjoint({3, 4})


async def test_an_order_that_ends_something_waits_behind_no_questions(
    rig: Rig, service: AgentServer
) -> None:
    front = Front(rig, service)
    fence = front.lease().number
    for number in range(100):
        front.send(Ask(1000 + number, orders.SetHotpointRate(5.0), fence))
    for number, order in enumerate(EXAMPLES):
        front.send(Ask(2000 + number, order, fence))
        refused = [one.id for one in front.all(OrderOutcome) if "wait already" in str(one.fault)]
        assert (2000 + number not in refused) is (order.ends or order.is_at_once), order


@pytest.mark.parametrize("fails", [False, True])
async def test_an_order_that_is_done_at_once_needs_its_lease_and_is_answered(
    rig: Rig, service: AgentServer, monkeypatch: pytest.MonkeyPatch, *, fails: bool
) -> None:
    done = []

    def doing(call: object, order: object) -> None:
        done.append(order)
        if fails:
            raise ZeroDivisionError

    monkeypatch.setattr(orders.RenewLease, "needs", orders.Needs.LEASE)
    monkeypatch.setitem(HANDLERS, orders.RenewLease, doing)
    front = Front(rig, service)
    for number, fence in ((1, 0), (2, 7), (3, front.lease().number)):
        front.send(Ask(number, orders.RenewLease(), fence))
    stages = [(one.id, one.stage) for one in front.all(OrderOutcome) if one.id < 99]
    third = Stage.FAILED if fails else Stage.DONE
    assert stages == [(1, Stage.FAILED), (2, Stage.FAILED), (3, third)]
    assert len(done) == 1


async def test_a_note_is_one_line_that_no_terminal_obeys(rig: Rig, service: AgentServer) -> None:
    front = Front(rig, service)
    front.send(JournalNote("info", "flies for /\x1b]0;x\x07\x1b[2J\r\nconnection lost: größer"))
    told = rig.agent.journal.events[-1].text
    assert told.isprintable()
    assert told.startswith("flies for /\N{REPLACEMENT CHARACTER}]0;x")
    assert told.endswith("connection lost: größer")


async def test_telemetry_of_a_profile_of_ones_own_is_not_reported_under_a_known_name(
    rig: Rig, service: AgentServer
) -> None:
    front = Front(rig, service)
    aircraft = rig.agent.connection.aircraft
    assert aircraft is not None
    own = replace(aircraft.firmware, summary="one's own")
    for callback in rig.agent.connection.on_sample:
        callback(Sample(b"\0\0", own, 0.0))
    assert front.all(Telemetry) == []


async def test_gimbal_camera_and_motors_by_messages() -> None:
    async with Rig(firmware="3.1").running() as rig:
        service = AgentServer(rig.agent)
        rig.renewing.cancel()
        rig.agent.leases.release(rig.token, rig.agent.now)
        front = Front(rig, service)
        front.send(Ask(11, orders.PointGimbal(GimbalAngle(pitch_deg=-45.0))))
        await front.outcome(11)
        front.send(Ask(12, orders.TurnGimbal(GimbalSpeed())))
        await front.outcome(12)
        for identity, wrong in ((13, 31.0), (14, -91.0), (15, 1e300)):
            front.send(Ask(identity, orders.PointGimbal(GimbalAngle(pitch_deg=wrong))))
            assert (await front.outcome(identity, Stage.FAILED)).fault is not None
        for identity, action in (
            (16, orders.UseCamera(orders.CameraUse.PHOTO)),
            (17, orders.UseCamera(orders.CameraUse.START_VIDEO)),
        ):
            front.send(Ask(identity, action))
            await front.outcome(identity)
        camera = rig.aircraft.vehicle.camera
        await rig.until(lambda: camera.is_recording)
        assert camera.photos == 1
        front.send(Ask(18, orders.StartMotors()))
        fault = (await front.outcome(18, Stage.FAILED)).fault
        assert fault is not None
        assert not rig.aircraft.vehicle.flight.dynamics.motors_on


def ahead(rig: Rig, north: float) -> FlyTo:
    position = rig.agent.connection.require_aircraft().state.position
    assert position is not None
    frame = LocalFrame(position.latitude_deg, position.longitude_deg)
    return FlyTo(*frame.to_geodetic(north, 0.0), height=position.height_m)


def speed_of(rig: Rig) -> float:
    dynamics = rig.aircraft.vehicle.flight.dynamics
    return math.hypot(dynamics.velocity_north, dynamics.velocity_east)


async def test_a_flight_to_a_place_by_messages(rig: Rig, service: AgentServer) -> None:
    front, watcher = Front(rig, service), Front(rig, service)
    fence = await front.airborne()
    order = ahead(rig, 30.0)
    front.send(Ask(7, order, fence, hears_begin=True))
    await front.outcome(7, Stage.ACCEPTED)
    await anyio.sleep(2.0)
    for one in (front, watcher):  # whichever draws it
        guided = one.all(State)[-1].guided
        assert guided is not None
        assert (guided.latitude_deg, guided.longitude_deg) == (
            order.latitude_deg,
            order.longitude_deg,
        )
        assert guided.distance_m is not None
        assert 5.0 < guided.distance_m < 30.0
    await front.outcome(7)
    assert front.all(State)[-1].guided is None
    watcher.send(Ask(8, order, fence))
    fault = (await watcher.outcome(8, Stage.FAILED)).fault
    assert fault is not None
    assert fault.kind == "LeaseRefused"


async def test_telling_what_remains_does_not_tell_the_state_more_often(
    rig: Rig, service: AgentServer
) -> None:
    front = Front(rig, service)
    fence = await front.airborne()
    front.send(Ask(7, ahead(rig, 60.0), fence))
    await anyio.sleep(1.0)
    states = len(front.all(State))
    await anyio.sleep(4.0)
    assert len(front.all(State)) - states == pytest.approx(16, abs=2)


@pytest.mark.parametrize("how", ["closes", "hangs", "halts"])
async def test_a_flight_to_a_place_ends_with_its_front(
    rig: Rig, service: AgentServer, how: str
) -> None:
    front, watcher = Front(rig, service), Front(rig, service)
    fence = await front.airborne()
    front.send(Ask(7, ahead(rig, 100.0), fence))
    await anyio.sleep(5.0)
    assert speed_of(rig) > 3.0
    if how == "closes":
        front.channel.close("killed")
    elif how == "hangs":
        for task in tuple(rig.agent.background._tasks):
            if "alive" in task.get_name():
                task.cancel()
    else:
        watcher.send(Ask(0, orders.Halt("another console")))
    await rig.until(lambda: guided(rig) is None, within=4.0)
    await anyio.sleep(3.0)
    assert speed_of(rig) < 0.1
    assert watcher.all(State)[-1].guided is None


async def test_a_halt_that_is_heard_together_with_a_flight_ends_it(
    rig: Rig, service: AgentServer
) -> None:
    """Both are read in one go when the agent was held up: the newest wins all the same."""
    front = Front(rig, service)
    fence = await front.airborne()
    front.send(Ask(7, ahead(rig, 100.0), fence))
    front.send(Ask(8, orders.Halt(), fence))
    await anyio.sleep(5.0)
    assert speed_of(rig) < 0.1
    assert guided(rig) is None


async def test_a_flight_that_is_heard_together_with_a_halt_before_it_is_flown(
    rig: Rig, service: AgentServer
) -> None:
    front = Front(rig, service)
    fence = await front.airborne()
    front.send(Ask(7, ahead(rig, 50.0), fence))
    front.send(Ask(8, orders.Halt(), fence))
    front.send(Ask(9, ahead(rig, 100.0), fence))
    await anyio.sleep(5.0)
    assert speed_of(rig) > 3.0


async def test_a_plan_is_sent_to_all_until_its_lease_ends() -> None:
    async with Rig(firmware="3.1").running() as rig:
        rig.agent.leases.release(rig.token, rig.agent.now)
        service = AgentServer(rig.agent)
        front, watcher = Front(rig, service), Front(rig, service)
        assert watcher.all(PlanChanged) == [PlanChanged()]
        fence = front.lease().number
        plan = WaypointPlan([Waypoint(52.1, 4.31, height=20), Waypoint(52.1003, 4.31, height=25)])
        upload = orders.UploadPlan.of(plan)
        front.send(Ask(1, upload, fence))
        assert (await front.outcome(1)).text == upload.digest
        told = watcher.all(PlanChanged)[-1]
        assert told == PlanChanged("pilot", upload)
        assert upload.plan().to_wire() == plan.to_wire()
        assert Front(rig, service).all(PlanChanged) == [told]  # who comes later sees it, too
        assert any("pilot uploaded a plan of 2" in one.text for one in watcher.all(Event))
        front.channel.close("gone")
        await rig.until(lambda: watcher.all(PlanChanged)[-1] == PlanChanged())


PLANS = [
    WaypointPlan([Waypoint(52.1, 4.31, height=up), Waypoint(52.1003, 4.31, height=25)])
    for up in (20, 30)
]


class Flies:
    """What flies: keeps its orders."""

    def __init__(self) -> None:
        self.calls: list[tuple[Any, ...]] = []
        self.mission = self

    def flight(self, kind: type[Any]) -> Any:
        return self

    def __getattr__(self, name: str) -> Any:
        async def asked(*what: Any, **how: Any) -> Any:
            self.calls.append((name, *what, *how.items()))
            return what[0] if name == "set_speed" else None

        return asked


@pytest.fixture
def flies(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> Flies:
    found = Flies()
    monkeypatch.setattr(rig.holding, "require", lambda: found)
    return found


def begun() -> None:
    """The aircraft has begun."""


# In metres, m/s and degrees per second, clockwise positive.
@pytest.mark.parametrize(
    ("order", "call"),
    [
        (orders.TakeOff(), ("fly", Task.TAKE_OFF, begun)),
        (orders.Land(), ("fly", Task.LAND, begun)),
        (orders.GoHome(), ("fly", Task.GO_HOME, begun)),
        (orders.StartMotors(), ("switch_motors", ("on", True))),
        (orders.StopMotors(), ("switch_motors", ("on", False))),
        (orders.SetHotpointRadius(12.345), ("set_radius", 12.345, ("wait", False))),
        (
            orders.SetHotpointRate(-7.525),
            ("set_rate", 7.525, ("clockwise", False), ("wait", False)),
        ),
        (orders.ResetHotpointHeading(), ("reset_heading",)),
        (orders.StopMission(), ("order_mission", "stop")),
        (orders.PauseMission(), ("order_mission", "pause")),
        (orders.ResumeMission(), ("order_mission", "resume")),
        (orders.SetMissionSpeed(4.567), ("set_speed", 4.567)),
    ],
    ids=lambda one: type(one).__name__,
)
async def test_what_is_asked_for_is_flown_with_its_unit(
    rig: Rig, flies: Flies, order: orders.Order, call: tuple[Any, ...]
) -> None:
    done = await rig.agent.ask(order, rig.token, begun)
    assert flies.calls == [call]
    assert done == (("", 4_567) if isinstance(order, orders.SetMissionSpeed) else None)


@pytest.mark.parametrize(("take_off", "until"), [(False, False), (True, False), (False, True)])
async def test_a_plan_is_started_under_the_lease_that_it_came_under_and_no_other(
    rig: Rig, flies: Flies, take_off: bool, until: bool
) -> None:
    """What somebody else left behind is not flown."""
    first, second = map(orders.UploadPlan.of, PLANS)
    start = orders.StartMission(first.digest, take_off, until)
    with pytest.raises(UsageError, match="under this lease"):
        await rig.agent.ask(start, rig.token)
    await rig.agent.ask(first, rig.token)
    await rig.agent.ask(start, rig.token, begun)
    how = ("take_off", take_off), ("begun", begun if until else None)
    assert flies.calls == [("start_mission", first.plan(), *how)]
    await rig.agent.ask(second, rig.token)
    for digest in (first.digest, ""):
        with pytest.raises(UsageError, match="not the one on board"):
            await rig.agent.ask(replace(start, digest=digest), rig.token)
    await rig.agent.ask(replace(start, digest=second.digest), rig.token, begun)
    assert flies.calls[1:] == [("start_mission", second.plan(), *how)]
    rig.renewing.cancel()
    rig.agent.leases.release(rig.token, rig.agent.now)
    other = rig.agent.leases.acquire("other", rig.agent.now).token
    with pytest.raises(UsageError, match="under this lease"):
        await rig.agent.ask(start, other)
    assert len(flies.calls) == 2


async def test_a_plan_that_cannot_be_flown_voids_the_one_before(rig: Rig, flies: Flies) -> None:
    whole = orders.UploadPlan.of(PLANS[0])
    for bad in (
        replace(whole, points=whole.points[:1]),
        replace(whole, points=(whole.points[0], whole.points[0])),
        replace(whole, points=(whole.points[0], b"")),
        replace(whole, mission=b""),
    ):
        await rig.agent.ask(whole, rig.token)
        with pytest.raises(UsageError):
            await rig.agent.ask(bad, rig.token)
        with pytest.raises(UsageError, match="no plan was uploaded"):
            await rig.agent.ask(orders.StartMission(whole.digest), rig.token)
    assert flies.calls == []


async def begin(flown: Flown, front: Front, fence: int) -> None:
    """Let it fly something for the holder of the lease."""
    rig = front.rig
    if flown is Flown.SETPOINTS:
        front.send(Steer(fence, rig.agent.now, 0.5, NORTH))
    elif flown is Flown.GUIDED:
        front.send(Ask(7, ahead(rig, 60.0), fence))
    elif flown is Flown.PROGRAM:
        front.send(Ask(7, orders.FlyPattern(1), fence))
    elif flown is Flown.LAND:
        front.send(Ask(7, orders.Land(), fence))
    elif flown is Flown.MISSION:
        far = ahead(rig, 80.0)
        points = [Waypoint(far.latitude_deg, far.longitude_deg + lon, 10) for lon in (0.0, 3e-4)]
        upload = orders.UploadPlan.of(WaypointPlan(points, speed=4))
        front.send(Ask(20, upload, fence))
        await front.outcome(20)
        front.send(Ask(30, orders.StartMission(upload.digest), fence))
        await front.outcome(30)
    await anyio.sleep(1.0)


@pytest.mark.parametrize(
    "flown",
    [
        *(Flown.NOTHING, Flown.SETPOINTS, Flown.GUIDED, Flown.PROGRAM),
        *(Flown.MISSION, Flown.LAND),
    ],
)
async def test_the_loser_of_the_lease_hears_what_was_flown(flown: Flown) -> None:
    async with Rig(firmware="3.1").running() as rig:
        rig.agent.leases.release(rig.token, rig.agent.now)
        service = AgentServer(rig.agent)
        front, other = Front(rig, service), Front(rig, service)
        fence = await front.airborne()
        await begin(flown, front, fence)
        other.send(Ask(2, orders.AskTakeOver("other")))
        other.send(Ask(3, orders.ConfirmTakeOver(other.offer.token)))
        told = front.all(LeaseChanged)[-1]
        assert (told.name, told.why, told.flown) == ("other", LeaseChange.TAKEN_OVER, flown)
        await anyio.sleep(6.0)
        assert speed_of(rig) < 0.1
        has_landed = not rig.aircraft.vehicle.flight.dynamics.motors_on
        assert has_landed is (flown is Flown.LAND)


# -- which setpoints go out ------------------------------------------------------------------------


async def test_the_state_tells_whether_the_holders_setpoint_goes_out_and_since_when() -> None:
    async with Rig().running() as rig:
        front = Front(rig, AgentServer(rig.agent))
        rig.agent.leases.release(rig.token, rig.agent.now)
        fence = await front.airborne()

        async def told(seconds: float) -> list[float | None]:
            """The newest, and each that comes in this time."""
            count = len(front.all(State)) - 1
            await anyio.sleep(seconds)
            return [state.setpoint_age for state in front.all(State)[count:]]

        assert set(await told(0.6)) == {None}
        decided_at = rig.agent.now - 0.2  # it was so long on its way
        front.send(Steer(fence, decided_at, 0.3, NORTH))
        assert (await told(0.05))[-1] is not None, "with the next telemetry"
        state = front.all(State)[-1]
        assert state.setpoint_age == pytest.approx(state.at - decided_at)
        assert None not in (await told(0.2))
        assert (await told(0.1))[-1] is None, "it expired"
        front.send(Steer(fence, rig.agent.now, 0.3, NORTH))
        assert (await told(0.05))[-1] is not None
        front.send(Ask(0, orders.Halt(), fence))
        assert (await told(0.05))[-1] is None, "it hovers"
        for wrong in (Steer(fence + 1, rig.agent.now, 0.3, NORTH), Steer(fence, 0.0, 0.3, NORTH)):
            front.send(wrong)
            assert set(await told(0.3)) == {None}
        assert len(front.all(SteerRefused)) == 2
        front.send(Ask(7, orders.FlyPattern(1), fence))
        await front.outcome(7)
        assert set(await told(1.0)) == {None}, "the setpoints of a program are not its holder's"

        async def ends_at_once(_: Control, send: Callable[[Setpoint], None]) -> None:
            send(NORTH)

        rig.holding.require().start_pattern("briefly", ends_at_once)
        assert set(await told(1.0)) == {None}, "nor is its last one, which lives for 0.2 s"
