"""What the executor asks of the agent, order by order; peers and datagrams of the bridge."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Callable
from types import SimpleNamespace
from typing import Any

import anyio
import pytest

from m100link import errors
from m100link.apps.agent import orders
from m100link.apps.agent.background import TaskSet
from m100link.apps.agent.messages import MissionReport, State
from m100link.apps.agent.orders import ChangeHeight, FlyTo
from m100link.apps.mavlink.bridge import Bridge, Peers, read_address, signature_time
from m100link.apps.mavlink.order_executor import MissionFlights, OrderExecutor
from m100link.apps.mavlink.translator.codec import MavlinkMessage, MessageReader, Peer, write_frame
from m100link.apps.mavlink.translator.missions import MissionProtocol
from m100link.apps.mavlink.translator.orders import (
    CancelTakeOff,
    Drop,
    FlightSequence,
    HoldPosition,
    LandInPlace,
    MissionCommand,
    ObtainControl,
    ReleaseControl,
    ReturnToLaunch,
    TakeOffAndClimb,
    VehicleOrder,
)
from m100link.missions.plan import Waypoint, WaypointPlan
from m100link.protocol.setpoint import Setpoint
from tests import limits
from tests.apps.mavlink.conftest import Told
from tests.apps.mavlink.translator.test_route import item
from tests.known import Known

pytestmark = pytest.mark.anyio

HERE, THERE = ("127.0.0.1", 1), ("127.0.0.1", 2)
FIRST, SECOND, NEIGHBOUR = Peer(HERE, 245, 190), Peer(THERE, 246, 191), Peer(HERE, 247, 1)
UNANSWERED = errors.AckTimeout("no answer")


# -- orders to the agent ---------------------------------------------------------------------------


class Agent:
    """Stand-ins for agent, session, world and manager, which note their calls in order."""

    def __init__(self) -> None:
        self.log: list[tuple[Any, ...]] = []
        self.fails: dict[type[Any], errors.M100Error] = {}  # by the order
        self.lasts: dict[type[Any], float] = {}  # s, by the order
        self.background = TaskSet()
        self.is_connected, self.is_obeyed, self.has_lease = True, True, True
        self.lease: Any = "lease"
        self.height: float | None = 1.2
        self.is_on_ground: bool | None = False
        self.flies_mission, self.may_take_off = False, False
        self.is_due: Callable[[Any], bool] = lambda _: True
        self.name = ""
        self.orders: list[Any] = []
        self.ways_made: list[tuple[Any, ...]] = []  # the call before each
        self.known = SimpleNamespace(view=self)
        one: Any = self
        self.session = one
        self.executor = OrderExecutor(one, one, one, one)

    @property
    def now(self) -> float:
        return asyncio.get_running_loop().time()

    def __getattr__(self, name: str) -> Callable[..., None]:
        """Any other call is one to manager, session or flights, which is only noted."""
        if name == "way_made":
            return lambda: self.ways_made.append(self.log[-1])
        return lambda *given, **named: self.log.append((name, *given, *named.values()))

    async def ask(self, order: Any, lease: Any = "", accepted: Any = None, at: Any = None) -> None:
        self.log.append((order, *(() if (lease, at) == ("lease", None) else (lease, at))))
        await anyio.sleep(self.lasts.get(type(order), 0.0))
        if type(order) in self.fails:
            raise self.fails[type(order)]
        if accepted is not None:
            accepted()

    async def end_task(self, at: float) -> float:
        self.log.append(("end task", at))
        return at + 0.25

    async def obtain(self, *, asked_at: float) -> None:
        self.log.append(("obtain", self.name, asked_at))

    async def give_back(self) -> None:
        self.log.append(("give back", self.may_take_off))

    async def bring_down(self, task: Any, at: float) -> None:
        self.log.append(("bring down", task, at))

    async def carries_out(self, *wanted: Any, within: float = 0.0) -> list[tuple[Any, ...]]:
        """What is done of orders that came since the look a second ago."""
        self.executor.advance()
        await anyio.sleep(1.0)
        self.log.clear()
        self.orders = list(wanted)
        self.asked_at = self.now - 1.0
        self.executor.advance()
        await anyio.sleep(within)
        return [one for one in self.log if one[0] != "heard"]


@pytest.fixture
async def agent() -> AsyncIterator[Agent]:
    one = Agent()
    yield one
    await one.background.end()


@pytest.mark.parametrize(
    ("order", "height", "expected"),
    [
        (TakeOffAndClimb(6.0), 1.2, [ChangeHeight(6.0)]),
        (TakeOffAndClimb(6.0), None, [ChangeHeight(6.0)]),
        (TakeOffAndClimb(1.6), 1.2, [ChangeHeight(1.6)]),
        (TakeOffAndClimb(0.8), 1.2, [ChangeHeight(0.8)]),
        (TakeOffAndClimb(1.4), 1.2, []),  # it is there within 0.3 m
        (TakeOffAndClimb(), 1.2, []),
    ],
)
async def test_a_take_off_climbs_to_its_height(
    agent: Agent, order: TakeOffAndClimb, height: float | None, expected: list[Any]
) -> None:
    agent.height = height
    done = await agent.carries_out(order, within=0.1)
    at, now = agent.asked_at, agent.asked_at + 1.0
    asked = [(one, "lease", at) for one in expected]
    assert done == [
        (orders.TakeOff(), "lease", at),
        ("took_off", order, now),
        *asked,
        ("ended", order, None, now),
    ]


DOWN = [
    (LandInPlace(), "landing", orders.Land()),
    (ReturnToLaunch(), "going home", orders.GoHome()),
]


@pytest.mark.parametrize(("order", "why", "task"), DOWN)
async def test_a_way_down_ends_what_the_aircraft_flies_by_itself(
    agent: Agent, order: LandInPlace | ReturnToLaunch, why: str, task: orders.Order
) -> None:
    done = await agent.carries_out(order, within=0.1)
    at = agent.asked_at
    down = [("hover", why, "lease"), (task, "lease", at)]
    assert done[:-1] == down
    agent.flies_mission = True
    done = await agent.carries_out(order, within=0.1)
    at = agent.asked_at
    down = [("hover", why, "lease"), (task, "lease", at)]
    assert done[:-1] == [(orders.StopMission(), "lease", at), *down]
    done = await agent.carries_out(type(order)(is_interrupting=True), within=0.1)
    at = agent.asked_at
    assert done[:-1] == [
        ("end task", at),
        (orders.Release(), "lease", at + 0.25),
        (orders.Obtain(), "lease", at + 0.25),
        ("hover", why, "lease"),
        (task, "lease", at + 0.25),
    ]


@pytest.mark.parametrize(
    "order", [LandInPlace(is_interrupting=True), HoldPosition(is_interrupting=True)]
)
async def test_a_task_has_ended_when_control_is_held_again(
    agent: Agent, order: VehicleOrder
) -> None:
    agent.lasts = {orders.Obtain: 5.0}
    await agent.carries_out(order, within=4.9)
    assert agent.ways_made == []
    await anyio.sleep(0.2)
    assert agent.ways_made[0][0] == orders.Obtain()


@pytest.mark.parametrize("flight", [None, FlightSequence(())])
async def test_a_mission_is_paused_when_the_aircraft_has_answered(
    agent: Agent, flight: FlightSequence | None
) -> None:
    agent.lasts = {orders.PauseMission: 5.0}
    await agent.carries_out(MissionCommand(orders.PauseMission(), flight), within=4.9)
    assert agent.ways_made == []
    await anyio.sleep(0.2)
    assert len(agent.ways_made) == (flight is not None)


@pytest.mark.parametrize(("order", "why", "task"), DOWN)
@pytest.mark.parametrize("error", [UNANSWERED, errors.NoAuthority("gone")])
async def test_a_landing_needs_no_answer_to_the_stop_of_a_mission_and_a_way_home_does(
    agent: Agent, order: VehicleOrder, why: str, task: orders.Order, error: errors.M100Error
) -> None:
    agent.flies_mission, agent.fails = True, {orders.StopMission: error}
    done = await agent.carries_out(order, within=0.1)
    goes_on = isinstance(order, LandInPlace) and error is UNANSWERED
    assert ((task, "lease", agent.asked_at) in done) is goes_on
    assert done[-1] == ("ended", order, None if goes_on else error, agent.now - 0.1)


@pytest.mark.parametrize(
    ("order", "why"),
    [
        (HoldPosition(), "hold"),
        (HoldPosition(why="setpoints stopped"), "setpoints stopped"),
        (HoldPosition(why="STOP", follows_stop=True), "STOP"),
    ],
)
async def test_a_hold_is_of_its_time_but_that_of_a_stop(
    agent: Agent, order: HoldPosition, why: str
) -> None:
    done = await agent.carries_out(order, within=0.1)
    assert done[0] == ("begin_anew", why, math.inf if order.follows_stop else agent.asked_at)


async def test_control_is_obtained_under_a_name_and_given_back(agent: Agent) -> None:
    arm, disarm = ObtainControl("MAVLink 245"), ReleaseControl()
    done = await agent.carries_out(arm, within=0.1)
    assert done == [
        ("obtain", "MAVLink 245", agent.asked_at),
        ("armed", arm, None, agent.asked_at + 1.0),
    ]
    assert (await agent.carries_out(disarm, within=0.1))[0] == ("give back", False)


@pytest.mark.parametrize("is_on_ground", [True, False, None])
async def test_a_take_off_that_was_called_off_is_watched_and_brought_down(
    agent: Agent, is_on_ground: bool | None
) -> None:
    """For two and a half seconds, in which it counts as one that may fly."""
    agent.is_on_ground = True
    order = CancelTakeOff()
    done = await agent.carries_out(order, within=2.4)
    at = agent.asked_at
    assert (done, agent.may_take_off) == ([(orders.Release(), "lease", at)], True)
    agent.is_on_ground = is_on_ground
    await anyio.sleep(0.2)
    down = (
        [] if is_on_ground else [(orders.Obtain(), "lease", at), ("bring down", orders.Land(), at)]
    )
    assert agent.log[2:-1] == [*down, ("give back", False)]
    assert agent.log[-1][:3] == ("ended", order, None)


LEGS = FlyTo(1.0, 2.0, 8.0, 4.0), FlyTo(1.5, 2.0, 9.0, 4.0), FlyTo(1.5, 2.5, 9.0, 6.0)


async def test_legs_are_flown_one_after_the_other_with_their_waits(agent: Agent) -> None:
    flight = FlightSequence(LEGS, (2.0, 0.0), takes_off=True)
    await agent.carries_out(flight, within=1.9)
    at, now = agent.asked_at, agent.asked_at + 1.0
    first, second, third = ((leg, "lease", at) for leg in LEGS)
    begun = [
        (orders.TakeOff(), "lease", at),
        ("took_off", flight, now),
        ("leg", flight, 0, False),
        first,
    ]
    done = [one for one in agent.log if one[0] != "heard"]
    assert done == begun
    await anyio.sleep(0.2)
    assert [one for one in agent.log if one[0] != "heard"][len(begun) :] == [
        ("leg", flight, 0, True),
        ("leg", flight, 1, False),
        second,
        ("leg", flight, 1, True),
        ("leg", flight, 2, False),
        third,
        ("leg", flight, 2, True),
        ("ended", flight, None, now + 2.0),
    ]


PLAN = WaypointPlan([Waypoint(1.5, 2.0, 9.0), Waypoint(1.5, 2.001, 9.0)])
BY_AIRCRAFT = FlightSequence(LEGS, (0.0, 0.0, 3.0), items=(4, 5, 7), plan=PLAN, edition=2)
START = orders.StartMission(orders.UploadPlan.of(PLAN).digest, until_over=True)


async def test_the_rest_of_a_mission_is_uploaded_and_flown_by_the_aircraft(agent: Agent) -> None:
    done = await agent.carries_out(BY_AIRCRAFT, within=0.1)
    at = agent.asked_at
    assert done == [
        ("leg", BY_AIRCRAFT, 0, False),
        (LEGS[0], "lease", at),
        ("leg", BY_AIRCRAFT, 0, True),
        (orders.UploadPlan.of(PLAN), "lease", at),
        (START, "lease", at),
        ("begun", BY_AIRCRAFT),
        ("ended", BY_AIRCRAFT, None, at + 1.0),
    ]


NORTH = Setpoint.velocity(north=1.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


async def test_until_a_mission_is_over_or_its_stop_is_heard_it_is_owed_a_stop(
    agent: Agent,
) -> None:
    agent.lasts = {orders.StartMission: 100.0}
    await agent.carries_out(BY_AIRCRAFT, within=0.1)
    assert await agent.carries_out(NORTH) == [], "the aircraft would ignore it"
    done = await agent.carries_out(Drop())
    why = "the bridge does not know whether it has control"
    assert done[0] == ("hover", why, "lease")
    done = await agent.carries_out(HoldPosition(), within=0.1)
    assert [one[0] for one in done] == [orders.StopMission(), "begin_anew", "ended"]
    assert await agent.carries_out(NORTH) == [("steer", NORTH, 0.25)]
    assert (await agent.carries_out(HoldPosition(), within=0.1))[0][0] == "begin_anew"
    for ends in ("refused", "control lost", "given back"):
        agent.fails = {orders.StartMission: UNANSWERED} if ends == "refused" else {}
        agent.lasts = {} if ends == "refused" else {orders.StartMission: 100.0}
        done = await agent.carries_out(BY_AIRCRAFT, within=0.1)
        assert (done[-1][:3] == ("ended", BY_AIRCRAFT, UNANSWERED)) is (ends == "refused")
        agent.is_obeyed = ends != "control lost"
        await agent.carries_out(*([ReleaseControl()] if ends == "given back" else []))
        await anyio.sleep(0.1)
        agent.is_obeyed = True
        assert await agent.carries_out(NORTH) == [("steer", NORTH, 0.25)], ends


async def test_an_order_ends_the_one_before_it_and_a_stop_is_begun_anew(agent: Agent) -> None:
    agent.lasts = {FlyTo: 100.0}
    flight, land = FlightSequence(LEGS[:1]), LandInPlace()
    await agent.carries_out(flight, within=0.1)
    done = await agent.carries_out(land, within=0.1)
    [broken_off] = [one for one in done if one[:2] == ("ended", flight)]
    assert str(broken_off[2].seen) == "it was broken off"
    stopped = errors.GuardRefused("STOP was pressed", guard="stopped")
    for error, anew in ((stopped, 1), (errors.GuardRefused("too far", guard="envelope"), 0)):
        agent.fails = {orders.Land: error}
        done = await agent.carries_out(land, within=0.1)
        assert [one for one in done if one[0] == "begin_anew"] == [
            ("begin_anew", agent.now - 0.1)
        ] * anew
        assert done[-1][:3] == ("ended", land, error)


async def test_orders_to_a_mission_go_out_while_they_are_wanted(agent: Agent) -> None:
    pause = MissionCommand(orders.PauseMission(), BY_AIRCRAFT)
    assert await agent.carries_out(pause, within=0.1) == [(orders.PauseMission(), "", None)]
    agent.fails = {orders.PauseMission: UNANSWERED}
    assert (await agent.carries_out(pause, within=0.1))[-1] == ("failed", pause, UNANSWERED)
    agent.is_due = lambda _: False
    assert await agent.carries_out(pause, within=0.1) == []


async def test_at_the_end_nothing_flies_on_and_control_goes_back(agent: Agent) -> None:
    agent.lasts = {FlyTo: 100.0}
    await agent.carries_out(FlightSequence(LEGS[:1]), within=0.1)
    await agent.executor.end()
    await anyio.sleep(0.1)
    assert ("give back", False) in agent.log
    assert agent.log[-1][0] == "ended"


# -- how far a mission is --------------------------------------------------------------------------


class Flights:
    """The mission as a flight: the calls of the manager, and messages to the stations."""

    def __init__(self, flight: FlightSequence | None = BY_AIRCRAFT) -> None:
        self.told: list[Any] = []
        self.orders: list[Any] = []
        self.flight, self.is_flown_by_aircraft = flight, True
        self.mission_flown: Callable[[Any], None] = lambda _: self.told.append("over")
        self.mission_begun: Callable[[Any], bool] = lambda _: True
        self.missions = MissionProtocol(
            lambda message, _: self.told.append(message.fields.get("seq")),
            lambda _, text: self.told.append(text),
            ground=lambda: 0.0,
            speed=lambda: 5.0,
            may_change=lambda *_: "",
            refusal_of=lambda _: "",
        )
        self.missions._stored[0] = tuple(item(16, z=10.0 + number) for number in range(8))
        one: Any = self
        self.view = SimpleNamespace(is_on_ground=False, state=State(0.0, firmware="1.0"))
        world: Any = SimpleNamespace(known=SimpleNamespace(view=self.view))
        self.flights = MissionFlights(world, one, self.missions, lambda _, text: None)

    def report(self, event: int, *data: int) -> list[Any]:
        self.told.clear()
        self.flights.report(MissionReport(event, bytes((*data, 0, 0, 0))))
        return list(self.told)


def test_items_are_reached_as_the_aircraft_reports_them() -> None:
    """Event 2 is a waypoint: index, and 4 before its actions, 6 behind them. Event 1 is the end."""
    one = Flights()
    one.flights.begun(BY_AIRCRAFT)
    assert (one.flights.flown, one.missions.current) == (LEGS[1], 5)
    assert one.report(0, 1, 0) == one.report(2, 2, 4) == [], "uploaded; there is no third"
    assert one.report(2, 0, 4) == [5]
    assert (one.flights.flown, one.missions.current) == (LEGS[2], 7)
    assert [order.order for order in one.orders] == [orders.SetMissionSpeed(6.0)]
    assert one.report(2, 1, 4) == [], "it hovers there for three seconds"
    assert one.report(2, 1, 6) == [7]
    assert (one.flights.flown, one.missions.is_over) == (None, True)
    assert one.report(1, 0) == ["over"]


@pytest.mark.parametrize("is_lost", [False, True])
def test_a_report_that_was_lost_is_made_up_for_by_the_next(is_lost: bool) -> None:
    one = Flights()
    one.flights.begun(BY_AIRCRAFT)
    if not is_lost:
        one.report(2, 0, 6)
    assert one.report(1, 0) == ([5, 7, "over"] if is_lost else [7, "over"])
    one = Flights()
    one.is_flown_by_aircraft = not is_lost
    assert one.report(1, 0) == ([] if is_lost else [5, 7, "over"])


def test_a_mission_that_nobody_wants_any_more_is_not_begun() -> None:
    one = Flights()
    one.mission_begun = lambda _: False
    one.flights.begun(BY_AIRCRAFT)
    assert (one.flights.flown, one.told) == (None, [])
    other = FlightSequence(LEGS)
    one.flights.leg(other, 0, False)
    assert one.flights.flown is None


@pytest.mark.parametrize("on_ground", [True, False, None])
def test_a_mission_begins_with_a_climb_where_it_stands(on_ground: bool | None) -> None:
    one = Flights(None)
    one.view.is_on_ground = on_ground
    take_off = item(22, z=4.5)
    one.missions._stored[0] = (take_off, *one.missions.items[1:3], item(20))
    for number, (first, height) in enumerate(((None, 4.5), (2, 4.5))):
        request = one.flights.mission_request(FIRST, first)
        assert request is not None
        flight = request.order
        assert isinstance(flight, FlightSequence)
        climbs = on_ground is not False
        assert flight.takes_off is climbs
        items = (1, 2)[number:]
        assert flight.items == ((None, *items) if climbs else items)
        if climbs:
            assert flight.legs[0] == ChangeHeight(height)
        assert (len(flight.legs), len(flight.waits)) == (len(flight.items),) * 2
        assert (flight.then, flight.edition) == (ReturnToLaunch(), number)
        assert flight.why == "firmware 1.0 has no missions"
        assert (request.peer, request.is_anew) == (FIRST, True)
        one.flight = flight
    again = one.flights.mission_request(SECOND, None)
    assert again is not None
    assert not again.is_anew, "it is the one that flies"
    assert one.flights.mission_request(FIRST, 4) is None, "there is no such item"
    one.missions.over()
    assert one.flights.mission_request(FIRST, None) is not None
    assert one.missions.current == 0, "one that is over begins again"


# -- who is there ----------------------------------------------------------------------------------


def test_a_peer_is_lost_after_three_seconds_and_forgotten_after_ten() -> None:
    peers = Peers((("192.0.2.1", 9),))
    assert (peers.knows(FIRST, 0.0), peers.is_lost(FIRST, 0.0)) == (False, True)
    peers.heartbeat(FIRST, 100.0)
    peers.heartbeat(SECOND, 100.0)
    peers.heartbeat(NEIGHBOUR, 105.0)
    assert [peers.is_lost(FIRST, at) for at in (102.99, 103.0)] == [False, True]
    assert [peers.knows(SECOND, at) for at in (109.99, 110.0)] == [True, False]
    there: dict[Any, tuple[Peer, ...]] = {
        ("192.0.2.1", 9): (),
        HERE: (FIRST, NEIGHBOUR),
        THERE: (SECOND,),
    }
    assert peers.audience(109.99) == there
    assert peers.audience(110.0) == {("192.0.2.1", 9): (), HERE: (NEIGHBOUR,)}
    assert [peers.is_known(one) for one in (HERE, THERE)] == [True, False]
    assert peers.is_lost(FIRST, 100.0), "nothing is left of it"


def test_a_seventeenth_peer_waits_until_one_was_forgotten() -> None:
    peers = Peers()
    for number in range(16):
        peers.heartbeat(Peer(HERE, number, 1), 0.0)
    peers.heartbeat(SECOND, 1.0)
    assert (peers.knows(SECOND, 1.0), peers.refused) == (False, 1)
    peers.heartbeat(SECOND, 10.0)
    assert peers.knows(SECOND, 10.0)


def test_signatures_count_ten_microseconds_since_2015(monkeypatch: pytest.MonkeyPatch) -> None:
    """1 January 2015, 00:00 UTC, is 1420070400 of POSIX."""
    monkeypatch.setattr("time.time", lambda: 1_420_070_400 + 86_400 + 0.25)
    assert signature_time() == 86_400 * 100_000 + 25_000


@pytest.mark.parametrize(
    ("url", "address"),
    [
        ("udp://127.0.0.1:14550", ("127.0.0.1", 14550)),
        ("udp://0.0.0.0:1", ("0.0.0.0", 1)),
        *(
            (url, None)
            for url in ("tcp://127.0.0.1:1", "udp://127.0.0.1", "udp://:1", "127.0.0.1:1")
        ),
        *((url, None) for url in ("udp://127.0.0.1:70000", "udp://127.0.0.1:x", "udp://[::1:1")),
        ("udp://no..name:1", None),
    ],
)
def test_an_address_is_one_of_datagrams(url: str, address: tuple[str, int] | None) -> None:
    if address is None:
        with pytest.raises(
            errors.UsageError, match=r"is not an address for MAVLink|has no address"
        ):
            read_address(url)
    else:
        assert read_address(url) == address


# -- datagrams -------------------------------------------------------------------------------------


class Datagrams:
    """A bridge for aircraft that say nothing by themselves, and what it sends."""

    def __init__(self, *systems: int, **options: Any) -> None:
        self.sent: list[tuple[bytes, tuple[str, int]]] = []
        agents: dict[int, Any] = {}
        for system in systems:
            known: Any = Known()
            known.on_mission_report = []
            agents[system] = Told(known)
        self.bridge = Bridge(agents, lambda *one: self.sent.append(one), **options)

    def flush(self, *waiting: Any) -> list[tuple[int, list[tuple[int, str]], tuple[str, int]]]:
        """Of each datagram: its size, its messages with the number of their frames, its address."""
        self.sent.clear()
        self.bridge.vehicles[0].outbox += waiting
        self.bridge._flush(0.0)
        found = []
        for data, address in self.sent:
            at, frames = 0, []
            while at < len(data):
                frames.append((data[at + 4], next(iter(MessageReader(data[at:]))).name))
                at += data[at + 1] + 12
            found.append((len(data), frames, address))
        return found


async def test_messages_go_to_whom_they_are_for_in_few_datagrams() -> None:
    always = ("192.0.2.1", 9)
    one = Datagrams(7, to=(always,))
    one.bridge.peers.heartbeat(FIRST, 0.0)
    one.bridge.peers.heartbeat(NEIGHBOUR, 0.0)
    one.bridge.peers.heartbeat(SECOND, 0.0)
    ping, beat = MavlinkMessage("PING", {"seq": 1}), MavlinkMessage("HEARTBEAT", {})
    told = one.flush((ping, FIRST), (beat, None), (ping, (THERE, always)))
    assert [(frames, address) for _, frames, address in told] == [
        ([(1, "PING"), (2, "HEARTBEAT")], HERE),
        ([(1, "HEARTBEAT"), (2, "PING")], always),
        ([(1, "HEARTBEAT"), (2, "PING")], THERE),
    ]
    wrong = MavlinkMessage("PING", {"seq": -1})
    assert one.flush((wrong, None)) == []
    assert one.bridge.unsent == 1, "of three that would have got it"


async def test_a_datagram_is_not_cut_up_on_its_way() -> None:
    """1400 bytes fit into any network's."""
    one = Datagrams(7)
    one.bridge.peers.heartbeat(FIRST, 0.0)
    text = MavlinkMessage(
        "STATUSTEXT", {"severity": 6, "text": "x" * 50, "id": 0x101, "chunk_seq": 1}
    )
    told = one.flush(*[(text, FIRST)] * 50)  # 12 bytes around 54 each
    assert [size for size, _, _ in told] == [21 * 66, 21 * 66, 8 * 66]
    assert 21 * 66 <= 1400 < 22 * 66


@pytest.mark.parametrize("system", [0, 251, -1])
async def test_a_system_id_is_one_of_an_aircraft(system: int) -> None:
    with pytest.raises(errors.UsageError, match=f"{system} is not a system id"):
        Datagrams(system)
    assert [one.system for one in Datagrams(1, 250).bridge.vehicles] == [1, 250]


def frame(system: int, name: str = "HEARTBEAT") -> bytes:
    return write_frame(MavlinkMessage(name, {}, component=190), system=system, sequence=0)


async def test_nobody_is_one_of_our_own_aircraft_and_strangers_are_not_answered() -> None:
    one = Datagrams(7, 9)
    for system in (0, 7, 9):
        one.bridge.received(frame(system), HERE)
        assert not one.bridge.peers.is_known(HERE)
    one.bridge.received(frame(245, "PARAM_REQUEST_READ"), HERE)
    assert one.sent == [], "it has said no heartbeat"
    one.bridge.received(frame(245), HERE)
    assert one.bridge.peers.knows(FIRST, one.bridge._clock())
    one.sent.clear()  # the greeting
    one.bridge.received(frame(245, "PARAM_REQUEST_READ"), HERE)
    [(data, address)] = one.sent
    assert ([two.system for two in MessageReader(data)], address) == ([7, 9], HERE)


async def test_bytes_that_are_skipped_cost_a_32th_of_those_that_are_read() -> None:
    one = Datagrams(7)
    for left in (32768 - 20, 32768 - 40):
        one.bridge.received(bytes(640), HERE)
        assert one.bridge._shares[None] == left


def test_each_limit_is_as_agreed() -> None:
    assert limits.differences("apps/mavlink") == []
