"""What a front can make an agent do, by messages alone."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace
from typing import Any, TypeVar

import anyio
import pytest

from m100link.aircraft import AircraftCamera
from m100link.apps.agent.guided import FlyTo
from m100link.apps.agent.lease import Flown, LeaseChange
from m100link.apps.agent.messages import (
    VERSION,
    Action,
    Ask,
    Event,
    Hello,
    LeaseAction,
    LeaseAsk,
    LeaseChanged,
    LeaseGranted,
    Limits,
    Message,
    Note,
    Outcome,
    PlanTold,
    Stage,
    State,
    Steer,
    SteerRefused,
    TakeOverOffered,
    Telemetry,
)
from m100link.apps.agent.server.flight import limits_of
from m100link.apps.agent.server.server import MAX_SETPOINT_AGE, STATE_INTERVAL, Orders, Service
from m100link.apps.agent.transports import memory_channels
from m100link.errors import M100Error, UsageError
from m100link.flight.guards import Envelope, Guards
from m100link.geodesy import LocalFrame
from m100link.missions.plan import Waypoint, WaypointPlan
from m100link.protocol.commands.control import Task
from m100link.protocol.commands.gimbal import GimbalAngle, GimbalSpeed
from m100link.protocol.commands.waypoint import WaypointMission, WaypointPoint
from m100link.protocol.firmware import FIRMWARE_3_1
from m100link.protocol.setpoint import Setpoint
from m100link.telemetry.sample import Sample
from tests.apps.agent.conftest import Rig

pytestmark = pytest.mark.anyio

NORTH = Setpoint.velocity(north=1.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)

M = TypeVar("M")


class Front:
    """A front by hand: sends messages, keeps what comes."""

    def __init__(self, rig: Rig, service: Service, *, greets: bool = True) -> None:
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

    def lease(self, **fields: Any) -> LeaseGranted:
        self.send(LeaseAsk(99, LeaseAction.ACQUIRE, **({"name": "pilot"} | fields)))
        return self.all(LeaseGranted)[-1]

    async def outcome(self, identity: int, stage: Stage = Stage.DONE) -> Outcome:
        def found() -> list[Outcome]:
            return [one for one in self.all(Outcome) if (one.id, one.stage) == (identity, stage)]

        await self.rig.until(lambda: bool(found()))
        return found()[0]

    async def airborne(self) -> int:
        fence = self.lease().number
        self.rig.agent.background.spawn(self._alive(), "alive")
        self.send(Ask(1, Action.OBTAIN, fence))
        await self.outcome(1)
        self.send(Ask(2, Action.TAKE_OFF, fence))
        await self.outcome(2)
        return fence

    async def _alive(self) -> None:
        token = self.all(LeaseGranted)[-1].token
        while True:
            await anyio.sleep(0.5)
            self.send(LeaseAsk(0, LeaseAction.RENEW, token=token))

    @property
    def moves(self) -> list[Any]:
        return list(self.rig.aircraft.autopilot.received_movements)


@pytest.fixture
async def service(rig: Rig) -> Service:
    rig.agent.desk.release(rig.token, rig.agent.now)  # the lease is the front's to take
    return Service(rig.agent)


async def test_a_front_is_greeted_with_everything_it_has_to_know(
    rig: Rig, service: Service
) -> None:
    front = Front(rig, service)
    hello, lease, state, plan, *events = front.inbox
    assert plan == PlanTold()
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
    assert len(front.all(State)) - states == pytest.approx(2.0 / STATE_INTERVAL, abs=1.1)


async def test_a_flight_by_messages(rig: Rig, service: Service) -> None:
    front = Front(rig, service)
    fence = await front.airborne()
    assert front.all(State)[-1].has_authority
    stages = [one.stage for one in front.all(Outcome) if one.id == 2]
    assert stages == [Stage.ACCEPTED, Stage.DONE]
    front.send(Steer(fence, rig.agent.now, 0.3, NORTH))
    await anyio.sleep(0.1)
    assert front.moves[-1].roll_or_x == 1.0
    front.send(Ask(0, Action.HALT))
    await anyio.sleep(0.03)
    assert front.moves[-1].roll_or_x == 0.0
    front.send(Ask(3, Action.RELEASE, fence))
    await front.outcome(3)
    assert front.all(State)[-1].holding == "none"
    front.send(Ask(4, Action.VERSION))
    assert "M100" in (await front.outcome(4)).text


async def test_a_front_knows_the_limits_and_from_where_they_are_measured(
    rig: Rig, service: Service
) -> None:
    front = Front(rig, service)
    before = front.all(State)[-1].limits
    assert before == Limits(50.0, 150.0, 10.0, 20)
    await front.airborne()
    await anyio.sleep(0.5)
    during = front.all(State)[-1].limits
    settings = rig.aircraft.vehicle.settings
    assert during.latitude_deg == pytest.approx(settings.latitude_deg, abs=1e-6)
    assert during.longitude_deg == pytest.approx(settings.longitude_deg, abs=1e-6)


def test_a_limit_that_is_off_is_told_as_none() -> None:
    open_above = Guards(envelope=Envelope(max_height_m=math.inf), battery_floor_percent=None)
    assert limits_of(open_above, (1.0, 2.0)) == Limits(None, 150.0, 10.0, None, 1.0, 2.0)
    assert limits_of(Guards(envelope=None), None) == Limits(battery_floor_percent=20)


async def test_the_state_is_told_before_the_outcome(rig: Rig, service: Service) -> None:
    front = Front(rig, service)
    front.send(Ask(1, Action.OBTAIN, front.lease().number))
    await front.outcome(1)
    place = front.inbox.index(Outcome(1, Stage.DONE))
    states = [one for one in front.inbox[:place] if isinstance(one, State)]
    assert states[-1].has_authority


async def test_a_front_that_has_gone_costs_a_hover(rig: Rig, service: Service) -> None:
    front = Front(rig, service)
    fence = await front.airborne()
    front.send(Steer(fence, rig.agent.now, 1.0, NORTH))
    await anyio.sleep(0.5)
    front.channel.close("killed")
    await anyio.sleep(0.03)
    assert front.moves[-1].roll_or_x == 0.0
    assert rig.agent.desk.holder(rig.agent.now) is None
    await rig.until(lambda: not rig.aircraft.vehicle.authority.is_requested, within=2.0)
    assert rig.aircraft.height > 1.0
    other = Front(rig, service)  # and another one flies on
    assert other.lease().number > fence


async def test_authority_is_kept_for_a_front_that_is_lost_and_not_for_one_that_is_ended() -> None:
    async with Rig(keep_authority=10.0).running() as rig:
        rig.agent.desk.release(rig.token, rig.agent.now)
        service = Service(rig.agent)
        front = Front(rig, service)
        await front.airborne()
        front.channel.close("killed")
        await anyio.sleep(1.0)
        assert rig.holding.has_authority
        other = Front(rig, service)
        other.send(Ask(1, Action.OBTAIN, other.lease().number))
        await other.outcome(1)
        service.close()
        await rig.until(lambda: not rig.aircraft.vehicle.authority.is_requested, within=1.0)


async def test_a_front_that_hangs_loses_its_lease(rig: Rig, service: Service) -> None:
    front = Front(rig, service)
    fence = front.lease().number
    front.send(Ask(1, Action.OBTAIN, fence))
    await front.outcome(1)
    await rig.until(lambda: front.all(LeaseChanged)[-1].number == 0, within=3.5)
    await rig.until(lambda: not rig.holding.has_authority, within=1.0)


async def test_a_setpoint_that_was_long_on_its_way_is_not_flown(rig: Rig, service: Service) -> None:
    front = Front(rig, service)
    fence = await front.airborne()
    front.send(Steer(fence, rig.agent.now - MAX_SETPOINT_AGE - 0.01, 0.3, NORTH))
    await anyio.sleep(0.1)
    assert front.moves == []
    (refused,) = front.all(SteerRefused)
    assert refused.fault.details["guard"] == "setpoint_age"
    front.send(Steer(fence, rig.agent.now - MAX_SETPOINT_AGE + 0.01, 0.3, NORTH))
    await anyio.sleep(0.1)
    assert front.moves[-1].roll_or_x == 1.0


async def test_a_setpoint_from_the_future_is_not_flown(rig: Rig, service: Service) -> None:
    front = Front(rig, service)
    fence = await front.airborne()
    front.send(Steer(fence, rig.agent.now + 100.0, 0.3, NORTH))
    await anyio.sleep(0.1)
    assert front.moves == []
    (refused,) = front.all(SteerRefused)
    assert "ahead" in refused.fault.cause


async def test_a_fence_of_another_front_moves_nothing(rig: Rig, service: Service) -> None:
    fence = await Front(rig, service).airborne()
    other = Front(rig, service)
    other.send(Steer(fence, rig.agent.now, 0.3, NORTH))
    for number, action in enumerate((Action.LAND, Action.RELEASE, Action.PATTERN), start=10):
        other.send(Ask(number, action, fence))
        outcome = await other.outcome(number, Stage.FAILED)
        assert outcome.fault is not None
        assert outcome.fault.kind == "LeaseRefused"
    await anyio.sleep(0.1)
    assert other.moves == []
    assert other.all(SteerRefused)[0].fault.kind == "LeaseRefused"
    assert rig.holding.has_authority


async def test_an_old_fence_moves_nothing(rig: Rig, service: Service) -> None:
    front = Front(rig, service)
    fence = await front.airborne()
    token = front.all(LeaseGranted)[-1].token
    front.send(LeaseAsk(5, LeaseAction.RELEASE, token=token))
    await front.outcome(5)
    new = front.lease().number
    assert new > fence
    front.send(Steer(fence, rig.agent.now, 0.3, NORTH))
    assert front.all(SteerRefused)[-1].fence == fence


async def test_a_take_over_names_who_loses_it(rig: Rig, service: Service) -> None:
    first, second = Front(rig, service), Front(rig, service)
    first.lease(name="first")
    second.send(LeaseAsk(1, LeaseAction.ACQUIRE, "second"))
    refused = await second.outcome(1, Stage.FAILED)
    assert refused.fault is not None
    assert refused.fault.details["holder"] == "first"
    second.send(LeaseAsk(2, LeaseAction.TAKE_OVER, "second"))
    (offer,) = second.all(TakeOverOffered)
    assert offer.from_name == "first"
    second.send(LeaseAsk(3, LeaseAction.CONFIRM, token=offer.token))
    assert second.all(LeaseGranted)[-1].id == 3
    assert first.all(LeaseChanged)[-1].name == "second"


async def test_another_version_is_not_served(rig: Rig, service: Service) -> None:
    front = Front(rig, service, greets=False)
    front.send(Hello(VERSION + 1, "from the future", 0.0))
    assert front.closed == [f"this agent speaks version {VERSION}, not {VERSION + 1}"]


@pytest.mark.parametrize("greets", [False, True])
async def test_what_a_front_does_not_send_ends_it(rig: Rig, service: Service, greets: bool) -> None:
    front = Front(rig, service, greets=greets)
    front.send(Telemetry(b"", "1.0", 0.0) if greets else Ask(1, Action.HALT))
    assert len(front.closed) == 1
    assert front.all(Outcome) == []


async def test_notes_and_questions_are_bounded(rig: Rig, service: Service) -> None:
    front = Front(rig, service)
    for number in range(1000):
        front.send(Note("info", f"note {number}"))
        front.send(Ask(number + 1, Action.VERSION))
    notes = [one for one in rig.agent.journal.events if one.text.startswith("note ")]
    assert len(notes) == 20
    refused = [one for one in front.all(Outcome) if one.stage is Stage.FAILED]
    assert len(refused) == 1000 - 64
    front.send(Note("shout", "x"))
    assert rig.agent.journal.events[-1].level != "shout"
    for seconds, more in ((1.0, 5), (100.0, 20)):  # five of each second, twenty at most
        await anyio.sleep(seconds)
        for _ in range(100):
            front.send(Note("info", "note"))
        later = [one for one in rig.agent.journal.events if one.text == "note"]
        assert len(later) == {5: 5, 20: 25}[more]


async def test_a_note_is_one_line_that_no_terminal_obeys(rig: Rig, service: Service) -> None:
    front = Front(rig, service)
    front.send(Note("info", "flies for /\x1b]0;x\x07\x1b[2J\r\nconnection lost: größer"))
    told = rig.agent.journal.events[-1].text
    assert told.isprintable()
    assert told.startswith("flies for /\N{REPLACEMENT CHARACTER}]0;x")
    assert told.endswith("connection lost: größer")


async def test_telemetry_of_a_profile_of_ones_own_is_not_told_under_a_known_name(
    rig: Rig, service: Service
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
        service = Service(rig.agent)
        rig.renewing.cancel()
        rig.agent.desk.release(rig.token, rig.agent.now)
        front = Front(rig, service)
        value = GimbalAngle(pitch_deg=-45.0).value(FIRMWARE_3_1)
        front.send(Ask(11, Action.GIMBAL_ANGLES, data=value))
        await front.outcome(11)
        front.send(Ask(12, Action.GIMBAL_RATES, data=GimbalSpeed().value(FIRMWARE_3_1)))
        await front.outcome(12)
        for identity, data in ((13, b""), (14, b"\xff" * 8), (15, value[:-1])):
            front.send(Ask(identity, Action.GIMBAL_ANGLES, data=data))
            assert (await front.outcome(identity, Stage.FAILED)).fault is not None
        for identity, action in ((16, Action.TAKE_PHOTO), (17, Action.START_VIDEO)):
            front.send(Ask(identity, action))
            await front.outcome(identity)
        camera = rig.aircraft.vehicle.camera
        await rig.until(lambda: camera.is_recording)
        assert camera.photos == 1
        front.send(Ask(18, Action.ARM))
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


async def test_a_flight_to_a_place_by_messages(rig: Rig, service: Service) -> None:
    front, watcher = Front(rig, service), Front(rig, service)
    fence = await front.airborne()
    order = ahead(rig, 30.0)
    front.send(replace(order, id=7, fence=fence))
    await front.outcome(7, Stage.ACCEPTED)
    await anyio.sleep(2.0)
    for one in (front, watcher):  # whoever draws it
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
    watcher.send(replace(order, id=8, fence=fence))
    fault = (await watcher.outcome(8, Stage.FAILED)).fault
    assert fault is not None
    assert fault.kind == "LeaseRefused"


async def test_telling_what_remains_does_not_tell_the_state_more_often(
    rig: Rig, service: Service
) -> None:
    front = Front(rig, service)
    fence = await front.airborne()
    front.send(replace(ahead(rig, 60.0), id=7, fence=fence))
    await anyio.sleep(1.0)
    states = len(front.all(State))
    await anyio.sleep(4.0)
    assert len(front.all(State)) - states == pytest.approx(4.0 / STATE_INTERVAL, abs=2)


@pytest.mark.parametrize("how", ["closes", "hangs", "halts"])
async def test_a_flight_to_a_place_ends_with_its_front(
    rig: Rig, service: Service, how: str
) -> None:
    front, watcher = Front(rig, service), Front(rig, service)
    fence = await front.airborne()
    front.send(replace(ahead(rig, 100.0), id=7, fence=fence))
    await anyio.sleep(5.0)
    assert speed_of(rig) > 3.0
    if how == "closes":
        front.channel.close("killed")
    elif how == "hangs":
        for task in tuple(rig.agent.background._tasks):
            if "alive" in task.get_name():
                task.cancel()
    else:
        watcher.send(Ask(0, Action.HALT, text="another console"))
    await rig.until(lambda: rig.holding.guided_order is None, within=4.0)
    await anyio.sleep(3.0)
    assert speed_of(rig) < 0.1
    assert watcher.all(State)[-1].guided is None


async def test_a_halt_that_is_heard_together_with_a_flight_ends_it(
    rig: Rig, service: Service
) -> None:
    """Both are read in one go when the agent was held up: the newest wins all the same."""
    front = Front(rig, service)
    fence = await front.airborne()
    front.send(replace(ahead(rig, 100.0), id=7, fence=fence))
    front.send(Ask(8, Action.HALT, fence))
    await anyio.sleep(5.0)
    assert speed_of(rig) < 0.1
    assert rig.holding.guided_order is None


async def test_a_flight_that_is_heard_together_with_a_halt_before_it_is_flown(
    rig: Rig, service: Service
) -> None:
    front = Front(rig, service)
    fence = await front.airborne()
    front.send(replace(ahead(rig, 50.0), id=7, fence=fence))
    front.send(Ask(8, Action.HALT, fence))
    front.send(replace(ahead(rig, 100.0), id=9, fence=fence))
    await anyio.sleep(5.0)
    assert speed_of(rig) > 3.0


async def test_a_plan_is_told_to_all_until_its_lease_ends() -> None:
    async with Rig(firmware="3.1").running() as rig:
        rig.agent.desk.release(rig.token, rig.agent.now)
        service = Service(rig.agent)
        front, watcher = Front(rig, service), Front(rig, service)
        assert watcher.all(PlanTold) == [PlanTold()]
        fence = front.lease().number
        plan = WaypointPlan([Waypoint(52.1, 4.31, height=20), Waypoint(52.1003, 4.31, height=25)])
        mission, points = plan.to_wire()
        front.send(Ask(1, Action.MISSION_PLAN, fence, data=mission.value(FIRMWARE_3_1)))
        for number, point in enumerate(points, 2):
            front.send(Ask(number, Action.MISSION_POINT, fence, data=point.value(FIRMWARE_3_1)))
            await front.outcome(number)
        told = watcher.all(PlanTold)[-1]
        assert told.name == "pilot"
        parsed = [WaypointPoint.parse(one, FIRMWARE_3_1) for one in told.points]
        assert WaypointPlan.from_wire(
            WaypointMission.parse(told.mission, FIRMWARE_3_1), parsed
        ) == WaypointPlan.from_wire(mission, points)
        assert Front(rig, service).all(PlanTold) == [told]  # who comes later sees it, too
        assert any("pilot uploaded a plan of 2" in one.text for one in watcher.all(Event))
        front.channel.close("gone")
        await rig.until(lambda: watcher.all(PlanTold)[-1] == PlanTold())


class Asked:
    """An agent that keeps what it is asked, and does nothing."""

    def __init__(self) -> None:
        self.calls: list[tuple[Any, ...]] = []
        self.desk, self.now = self, 0.0

    def check(self, token: str, now: float) -> None:
        assert (token, now) == ("proof", 0.0)

    def __getattr__(self, name: str) -> Any:
        async def asked(*what: Any, **how: Any) -> Any:
            self.calls.append((name, *what, *sorted(how.items())))
            return what[-1] if name == "set_mission_speed" else None

        return asked


def orders(agent: Asked, plans: list[WaypointPlan] | None = None) -> Orders:
    one: Any = agent
    return Orders(one, ([] if plans is None else plans).append)


def begun() -> None:
    """The aircraft has begun."""


# Speeds in mm/s, radii in mm, rates in thousandths of a degree per second.
ASKED: list[tuple[Action, int, tuple[Any, ...]]] = [
    (Action.OBTAIN, 0, ("obtain", "proof")),
    (Action.RELEASE, 0, ("release", "proof")),
    (Action.TAKE_OFF, 0, ("fly", "proof", Task.TAKE_OFF, begun)),
    (Action.LAND, 0, ("fly", "proof", Task.LAND, begun)),
    (Action.GO_HOME, 0, ("fly", "proof", Task.GO_HOME, begun)),
    (Action.STOP, 0, ("stop",)),
    (Action.ARM, 0, ("switch_motors", "proof", ("on", True))),
    (Action.DISARM, 0, ("switch_motors", "proof", ("on", False))),
    (Action.HOTPOINT_RADIUS, 12_345, ("set_hotpoint", "proof", ("radius", 12.345))),
    (Action.HOTPOINT_RATE, -7_525, ("set_hotpoint", "proof", ("rate", -7.525))),
    (Action.HOTPOINT_HEADING, 9, ("set_hotpoint", "proof")),
    (Action.MISSION_STOP, 0, ("order_mission", "proof", "stop")),
    (Action.MISSION_PAUSE, 0, ("order_mission", "proof", "pause")),
    (Action.MISSION_RESUME, 0, ("order_mission", "proof", "resume")),
    (Action.MISSION_SPEED, 4_567, ("set_mission_speed", "proof", 4.567)),
    (Action.TAKE_PHOTO, 0, ("use_camera", "proof", AircraftCamera.take_photo)),
    (Action.START_VIDEO, 0, ("use_camera", "proof", AircraftCamera.start_video)),
    (Action.STOP_VIDEO, 0, ("use_camera", "proof", AircraftCamera.stop_video)),
]

# Judged by tests of their own, which have their bytes, their lease or their answer.
ASKED_ELSEWHERE = {
    *(Action.HALT, Action.VERSION, Action.ACTIVATE, Action.PATTERN, Action.REPLAY),
    *(Action.MISSION_PLAN, Action.MISSION_POINT, Action.MISSION_START, Action.HOTPOINT_START),
    *(Action.GIMBAL_ANGLES, Action.GIMBAL_RATES, Action.SEND_TO_MOBILE),
}


def test_each_action_is_in_a_table_by_hand() -> None:
    listed = {action for action, *_ in ASKED} | ASKED_ELSEWHERE
    missing = [one.name for one in Action if one not in listed]
    assert missing == [], f"no row of ASKED says what the agent is asked for {missing}"


@pytest.mark.parametrize(("action", "number", "call"), ASKED)
async def test_what_is_asked_for_is_asked_of_the_agent_with_its_unit(
    action: Action, number: int, call: tuple[Any, ...]
) -> None:
    agent = Asked()
    done = await orders(agent).doing(Ask(1, action, 3, number), "proof", begun)
    assert agent.calls == [call]
    assert done == (("", 4_567) if action is Action.MISSION_SPEED else None)


@pytest.mark.parametrize(
    "action", [one for one in Action if one is not Action.HALT], ids=lambda one: one.name
)
async def test_every_action_has_a_row(action: Action) -> None:
    """A question without one would end as a fault of the agent; a halt waits for no table."""
    work: Any
    with suppress(M100Error):  # its data is none: that is another refusal
        work = orders(Asked()).doing(Ask(1, action), "proof", begun)
        work.close()


@pytest.mark.parametrize(
    ("number", "take_off", "until"), [(0, False, False), (1, True, False), (2, False, True)]
)
async def test_a_plan_is_started_under_the_lease_that_it_came_under_and_no_other(
    number: int, take_off: bool, until: bool
) -> None:
    """What somebody else left behind is not flown, and not added to."""
    agent, plans = Asked(), list[WaypointPlan]()
    one = orders(agent, plans)
    plan = WaypointPlan([Waypoint(52.1, 4.31, height=20), Waypoint(52.1003, 4.31, height=25)])
    mission, points = plan.to_wire()
    data = [points[0].value(FIRMWARE_3_1), points[1].value(FIRMWARE_3_1)]

    async def ask(action: Action, fence: int, **fields: Any) -> None:
        await one.doing(Ask(1, action, fence, **fields), "proof", begun)

    await ask(Action.MISSION_PLAN, 3, data=mission.value(FIRMWARE_3_1))
    await ask(Action.MISSION_POINT, 3, data=data[0])
    with pytest.raises(UsageError, match="under this lease"):
        await ask(Action.MISSION_POINT, 4, data=data[1])
    assert plans == []
    await ask(Action.MISSION_POINT, 3, data=data[1])
    [whole] = plans
    with pytest.raises(UsageError, match="under this lease"):
        await ask(Action.MISSION_START, 4, number=number)
    assert agent.calls == []
    await ask(Action.MISSION_START, 3, number=number)
    how = ("begun", begun if until else None), ("take_off", take_off)
    assert agent.calls == [("fly_mission", "proof", whole, *how)]


async def begin(flown: Flown, front: Front, fence: int) -> None:
    """Let it fly something for the holder of the lease."""
    rig = front.rig
    if flown is Flown.SETPOINTS:
        front.send(Steer(fence, rig.agent.now, 0.5, NORTH))
    elif flown is Flown.GUIDED:
        front.send(replace(ahead(rig, 60.0), id=7, fence=fence))
    elif flown is Flown.PROGRAM:
        front.send(Ask(7, Action.PATTERN, fence, number=1))
    elif flown is Flown.LAND:
        front.send(Ask(7, Action.LAND, fence))
    elif flown is Flown.MISSION:
        far = ahead(rig, 80.0)
        points = [Waypoint(far.latitude_deg, far.longitude_deg + lon, 10) for lon in (0.0, 3e-4)]
        mission, wire = WaypointPlan(points, speed=4).to_wire()
        front.send(Ask(20, Action.MISSION_PLAN, fence, data=mission.value(FIRMWARE_3_1)))
        for number, point in enumerate(wire, 21):
            front.send(Ask(number, Action.MISSION_POINT, fence, data=point.value(FIRMWARE_3_1)))
            await front.outcome(number)
        front.send(Ask(30, Action.MISSION_START, fence))
        await front.outcome(30)
    await anyio.sleep(1.0)


@pytest.mark.parametrize(
    "flown",
    [
        *(Flown.NOTHING, Flown.SETPOINTS, Flown.GUIDED, Flown.PROGRAM),
        *(Flown.MISSION, Flown.LAND),
    ],
)
async def test_who_loses_the_lease_is_told_what_was_flown(flown: Flown) -> None:
    async with Rig(firmware="3.1").running() as rig:
        rig.agent.desk.release(rig.token, rig.agent.now)
        service = Service(rig.agent)
        front, other = Front(rig, service), Front(rig, service)
        fence = await front.airborne()
        await begin(flown, front, fence)
        other.send(LeaseAsk(2, LeaseAction.TAKE_OVER, "other"))
        other.send(LeaseAsk(3, LeaseAction.CONFIRM, token=other.all(TakeOverOffered)[-1].token))
        told = front.all(LeaseChanged)[-1]
        assert (told.name, told.why, told.flown) == ("other", LeaseChange.TAKEN_OVER, flown)
        await anyio.sleep(6.0)
        assert speed_of(rig) < 0.1
        has_landed = not rig.aircraft.vehicle.flight.dynamics.motors_on
        assert has_landed is (flown is Flown.LAND)
