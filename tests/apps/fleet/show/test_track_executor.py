"""An aircraft of a fleet in a show: each order in each stage, and what ends it."""

from __future__ import annotations

import asyncio
import math
from dataclasses import replace
from random import Random
from types import SimpleNamespace
from typing import Any, cast

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.orders import ChangeHeight, FlyTo
from m100link.apps.fleet.payloads import (
    LeaveShow,
    LoadTrack,
    ShowOrder,
    ShowStage,
    StartShow,
    TakePlace,
)
from m100link.apps.fleet.show.plan.conflicts import Near, Neighbours, by_speed, by_track
from m100link.apps.fleet.show.plan.steering import (
    MOST_EARLY_S,
    LeftShow,
    ShowRefused,
    TrackSteering,
    Why,
)
from m100link.apps.fleet.show.plan.track import BadShow
from m100link.apps.fleet.show.track_executor import ALLOWED, ATTENDED_S, Leave, TrackExecutor
from m100link.errors import (
    AuthorityLost,
    GuardRefused,
    M100Error,
    NoAuthority,
    TelemetryStalled,
    UsageError,
)
from m100link.flight.guards import Envelope, Guards
from m100link.geodesy import LocalFrame
from m100link.protocol.records import Attitude, Position, Velocity
from m100link.protocol.setpoint import Setpoint
from m100link.sim.vehicle.settings import AircraftSettings
from m100link.sim.virtual import VirtualAircraft
from m100link.telemetry.state import AircraftState
from tests import known
from tests.apps.agent.conftest import has_begun, hears_late, task_of
from tests.apps.fleet.conftest import OnBoard, Rig, anyio_backend, rig
from tests.apps.fleet.show.shows import ORIGIN, track

__all__ = ["anyio_backend", "rig"]

pytestmark = pytest.mark.anyio

FLOWN = track("a1", (0, 0, 0, 4), (8, 12, 0, 5))
EMPTY, LOADED, PLACING, READY, FLYING, OVER, LEFT = ShowStage


class Stand:
    """One aircraft at its place, and what performs."""

    def __init__(self, one: OnBoard, rig: Rig) -> None:
        self.one, self.rig = one, rig
        self.performer = TrackExecutor(one.client, "a1")

    async def to(self, stage: ShowStage, *, leave: Leave = "hover") -> TrackExecutor:
        """Bring it to a stage as a conductor would."""
        performer = self.performer
        if stage is EMPTY:
            return performer
        performer.load(FLOWN.to_bytes(), leave)
        if stage in (LOADED,):
            return performer
        performer.place("anna", asked_at=0.0)
        if stage is PLACING:
            await anyio.sleep(1.0)
            return performer
        await self.rig.until(self.is_ready)
        if stage is READY:
            return performer
        if stage is LEFT:
            performer.leave()
            return performer
        performer.start(FLOWN.digest, self.one.client.now + 2.0, 0.0)
        if stage is OVER:
            await self.rig.until(lambda: performer.stage is OVER)
        return performer

    async def blown_off(self, performer: TrackExecutor) -> None:
        """Out of its tube of 1.5 m; a jump of 3 m is a place that cannot be true."""
        self.one.aircraft.vehicle.flight.dynamics.east += 2.0
        await self.rig.until(lambda: performer.stage is LEFT)

    def is_ready(self) -> bool:
        self.performer.heard()
        return self.performer.stage is READY

    @property
    def off(self) -> float:
        north, east = self.one.aircraft.position
        return math.dist((north, east), (12, 0))


@pytest.fixture
async def stand(rig: Rig) -> Stand:
    settings = AircraftSettings(latitude_deg=ORIGIN[0], longitude_deg=ORIGIN[1])
    one = await rig.aircraft("a1", virtual=VirtualAircraft(seed=5, settings=settings))
    return Stand(one, rig)


def order(performer: TrackExecutor, what: type[ShowOrder], now: float) -> None:
    if what is LoadTrack:
        performer.load(FLOWN.to_bytes(), "hover")
    elif what is TakePlace:
        performer.place("anna", asked_at=0.0)
    elif what is StartShow:
        performer.start(FLOWN.digest, now + 2.0, 0.0)
    else:
        performer.leave()


# By hand: what each order makes of each stage; what is not here is refused and changes nothing.
TABLE = {
    (LoadTrack, EMPTY): LOADED,
    (LoadTrack, LOADED): LOADED,
    (LoadTrack, OVER): LOADED,
    (LoadTrack, LEFT): LOADED,
    (TakePlace, LOADED): PLACING,
    (StartShow, READY): FLYING,
    (LeaveShow, EMPTY): EMPTY,
    (LeaveShow, LOADED): LEFT,  # an order to take its place may be on its way
    (LeaveShow, PLACING): LEFT,
    (LeaveShow, READY): LEFT,
    (LeaveShow, FLYING): LEFT,
    (LeaveShow, OVER): OVER,
    (LeaveShow, LEFT): LEFT,
}


@pytest.mark.parametrize("stage", ShowStage)
@pytest.mark.parametrize("what", ALLOWED)
async def test_every_order_in_every_stage(
    stand: Stand, stage: ShowStage, what: type[ShowOrder]
) -> None:
    performer = await stand.to(stage)
    after = TABLE.get((what, stage))
    assert (stage in ALLOWED[what]) == (after is not None)
    if after is None:
        with pytest.raises(UsageError, match=r"cannot (load|place|start)"):
            order(performer, what, stand.one.client.now)
        assert performer.stage is stage
    else:
        order(performer, what, stand.one.client.now)
        assert performer.stage is after


async def test_it_flies_its_track_and_lands(stand: Stand) -> None:
    performer = await stand.to(OVER, leave="land")
    assert performer.fault is None
    assert performer.farthest_m < 0.3
    assert stand.off < 0.5
    await stand.rig.until(lambda: stand.one.height == 0.0)
    await stand.rig.until(lambda: stand.one.client.holder.number == 0)


async def test_an_activation_that_takes_longer_than_a_lease_lasts_is_waited_for(
    stand: Stand,
) -> None:
    stand.one.aircraft.vehicle.activation._delay = 6.0
    performer = await stand.to(READY)
    assert performer.fault is None


@pytest.mark.parametrize("stage", [PLACING, READY])
@pytest.mark.parametrize("leave", ["hover", "land"])
async def test_the_conductor_is_missed_before_the_beginning(
    stand: Stand, stage: ShowStage, leave: Leave
) -> None:
    performer = await stand.to(stage, leave=leave)
    await anyio.sleep(ATTENDED_S - 2.0)
    assert performer.stage is not LEFT
    await anyio.sleep(3.0)
    fault = performer.fault
    assert isinstance(fault, LeftShow)
    assert fault.why is Why.CONDUCTOR
    await anyio.sleep(15.0)
    assert (stand.one.height == 0.0) is (leave == "land")
    assert stand.one.client.holder.number == 0


async def test_no_network_is_needed_once_it_flies(stand: Stand) -> None:
    performer = await stand.to(FLYING)
    stand.rig.network.cut(stand.one.bus)
    await stand.rig.until(lambda: performer.stage is OVER)
    assert stand.off < 0.5
    assert stand.one.height > 4.0


@pytest.mark.parametrize("leave", ["hover", "land"])
async def test_out_of_its_tube_it_leaves_as_it_was_ordered(stand: Stand, leave: Leave) -> None:
    performer = await stand.to(FLYING, leave=leave)
    await anyio.sleep(5.0)
    await stand.blown_off(performer)
    assert isinstance(performer.fault, LeftShow)
    assert performer.fault.why is Why.TUBE
    await anyio.sleep(15.0)
    assert (stand.one.height == 0.0) == (leave == "land")
    assert stand.one.speed < 0.1
    assert stand.one.client.holder.number == 0, "the next client may have control"


async def test_stop_by_anybody_ends_what_has_not_taken_off_yet(stand: Stand) -> None:
    performer = await stand.to(LOADED)
    await (await stand.rig.pilot("anybody"))["a1"].stop()
    assert performer.stage is LEFT
    with pytest.raises(UsageError, match="left and cannot place") as caught:
        performer.place("anna", asked_at=0.0)
    assert "a1 was stopped" in caught.value.cause
    await anyio.sleep(10.0)
    assert stand.one.height == 0.0


async def test_one_that_lands_because_it_left_lands_on_whatever_else_is_ordered(
    stand: Stand,
) -> None:
    """The conductor lets all leave because one did: that one is not to hover half-way down."""
    performer = await stand.to(FLYING, leave="land")
    await anyio.sleep(5.0)
    await stand.blown_off(performer)
    await anyio.sleep(1.5)
    performer.leave()
    with pytest.raises(UsageError, match="left and landing and cannot load"):
        performer.load(FLOWN.to_bytes(), "land")
    await stand.rig.until(lambda: stand.one.height == 0.0, within=15.0)
    await stand.rig.until(lambda: stand.one.client.holder.number == 0, within=5.0)
    performer.load(FLOWN.to_bytes(), "land")


@pytest.mark.parametrize("stage", [PLACING, READY, FLYING])
async def test_stop_by_anybody_ends_it_and_it_does_not_even_land(
    stand: Stand, stage: ShowStage
) -> None:
    performer = await stand.to(stage, leave="land")
    if stage is not READY:
        await anyio.sleep(4.0)
    await (await stand.rig.pilot("bert"))["a1"].stop()
    await stand.rig.until(lambda: performer.stage is LEFT, within=1.0)
    assert isinstance(performer.fault, NoAuthority)
    await anyio.sleep(8.0)
    assert stand.one.height > 0.5
    assert stand.one.speed < 0.1


async def test_the_client_that_takes_over_has_the_aircraft(stand: Stand) -> None:
    performer = await stand.to(FLYING, leave="land")
    await anyio.sleep(4.0)
    pilot = await stand.rig.pilot("bert")
    async with pilot["a1"].control(take_over=True):
        await stand.rig.until(lambda: performer.stage is LEFT, within=1.0)
        await anyio.sleep(5.0)
        assert stand.one.height > 2.0


async def test_the_pilot_who_leaves_f_has_it(stand: Stand) -> None:
    performer = await stand.to(FLYING, leave="land")
    await anyio.sleep(4.0)
    stand.one.aircraft.leave_f()
    await stand.rig.until(lambda: performer.stage is LEFT, within=2.0)
    await anyio.sleep(5.0)
    assert stand.one.height > 2.0


async def test_the_taker_is_reported_also_when_a_setpoint_was_refused_first(stand: Stand) -> None:
    performer, client = await stand.to(FLYING), stand.one.client
    await anyio.sleep(1.0)
    for callback in client.on_steer_refused:
        callback(client.holder.number, NoAuthority("nothing was sent"))
    await stand.rig.until(lambda: performer.stage is LEFT, within=2.0)
    for told in client.on_authority_taken:
        told(AuthorityLost("the pilot moved the mode switch out of F"))
    assert isinstance(performer.fault, AuthorityLost)


@pytest.mark.parametrize(
    ("early", "bound", "why"),
    [
        (2.0, 0.051, Why.CLOCK),
        (2.0, -0.001, Why.CLOCK),
        (2.0, math.nan, Why.CLOCK),
        (-0.1, 0.0, Why.LATE),
        (math.nan, 0.0, Why.LATE),
        (MOST_EARLY_S + 0.1, 0.0, Why.EARLY),
        (1e9, 0.0, Why.EARLY),
        (math.inf, 0.0, Why.EARLY),
    ],
)
async def test_it_does_not_begin_by_a_wrong_time(
    stand: Stand, early: float, bound: float, why: Why
) -> None:
    performer = await stand.to(READY)
    with pytest.raises(ShowRefused) as caught:
        performer.start(FLOWN.digest, stand.one.client.now + early, bound)
    assert caught.value.why is why
    assert caught.value.remedy
    assert performer.stage is READY


async def test_a_clock_that_nobody_asks_again_becomes_ever_less_sure(stand: Stand) -> None:
    """Two cheap crystals part by 100 ppm: half a millisecond is gone after five seconds."""
    performer = await stand.to(READY)
    performer.start(FLOWN.digest, stand.one.client.now + 2.0, 0.0495)
    await stand.rig.until(lambda: performer.stage is LEFT)
    assert isinstance(performer.fault, LeftShow)
    assert performer.fault.why is Why.CLOCK
    assert performer.fault.at == pytest.approx(3.0, abs=0.2)


async def test_two_minutes_are_waited_and_the_track_is_flown_then(stand: Stand) -> None:
    performer = await stand.to(READY)
    performer.start(FLOWN.digest, stand.one.client.now + MOST_EARLY_S, 0.0)
    await anyio.sleep(MOST_EARLY_S - 1.0)
    assert (performer.stage, stand.one.speed < 0.1) == (FLYING, True)
    await stand.rig.until(lambda: performer.stage is OVER)


async def test_a_track_of_another_or_of_none(stand: Stand) -> None:
    performer = stand.performer
    for data in (track("a2", (0, 0, 0, 4), (8, 12, 0, 5)).to_bytes(), b"", FLOWN.to_bytes()[:-1]):
        with pytest.raises(BadShow):
            performer.load(data, "hover")
    assert performer.stage is EMPTY
    with pytest.raises(UsageError, match="another track"):
        (await stand.to(READY)).start("0" * 64, stand.one.client.now + 2.0, 0.0)


async def test_an_aircraft_that_stands_elsewhere_never_takes_off(stand: Stand) -> None:
    performer = stand.performer
    performer.load(track("a1", (0, 5, 0, 4), (8, 12, 0, 5)).to_bytes(), "land")
    performer.place("anna", asked_at=0.0)
    await stand.rig.until(lambda: performer.stage is LEFT)
    assert isinstance(performer.fault, ShowRefused)
    assert not stand.one.aircraft.vehicle.flight.dynamics.motors_on
    assert stand.one.client.holder.number == 0


@pytest.mark.parametrize(
    ("points", "limit"),
    [
        (((0, 0, 0, 61), (8, 0, 0, 61)), 50.0),  # its place
        (((0, 0, 0, 4), (60, 0, 0, 61), (120, 0, 0, 4)), 50.0),
        (((0, 0, 0, 4), (60, 160, 0, 4), (120, 0, 0, 4)), 150.0),
    ],
)
async def test_a_track_that_the_envelope_would_end_takes_off_nowhere(
    stand: Stand, points: tuple[tuple[float, float, float, float], ...], limit: float
) -> None:
    performer = stand.performer
    with pytest.raises(GuardRefused, match="the envelope ends") as caught:
        performer.load(track("a1", *points).to_bytes(), "land")
    assert (caught.value.limit, performer.stage) == (limit, EMPTY)
    performer.track, performer.stage = track("a1", *points), LOADED  # by wider guards
    with pytest.raises(GuardRefused, match="the envelope ends"):
        performer.place("anna", asked_at=0.0)
    assert performer.stage is LOADED
    await anyio.sleep(3.0)
    assert not stand.one.aircraft.vehicle.flight.dynamics.motors_on


async def test_guards_slower_than_the_way_to_its_place_slow_that_down(stand: Stand) -> None:
    stand.one.agent.holding._guards = Guards(envelope=Envelope(max_speed_m_s=2.0))
    await anyio.sleep(1.0)
    performer = stand.performer
    performer.load(track("a1", (0, 0, 0, 4), (30, 12, 0, 5)).to_bytes(), "land")
    performer.place("anna", asked_at=0.0)
    await stand.rig.until(stand.is_ready)


async def test_it_flies_at_the_heights_of_the_show_where_its_ground_is_lower(stand: Stand) -> None:
    flown = track("a1", (0, 0, 0, 4), (8, 6, 0, 4), ground_m=-3, heading_deg=90)
    performer = stand.performer
    performer.load(flown.to_bytes(), "hover")
    performer.place("anna", asked_at=0.0)
    await stand.rig.until(stand.is_ready)
    performer.start(flown.digest, stand.one.client.now + 2.0, 0.0)
    await stand.rig.until(lambda: performer.stage is OVER)
    assert performer.farthest_m < 0.5
    assert stand.one.height == pytest.approx(7, abs=0.2)
    yaw = math.degrees(stand.one.aircraft.vehicle.flight.dynamics.yaw)
    assert yaw == pytest.approx(90, abs=3)


async def test_somebody_who_has_control_keeps_it(stand: Stand) -> None:
    pilot = await stand.rig.pilot("bert")
    async with pilot["a1"].control():
        performer = await stand.to(LOADED)
        performer.place("anna", asked_at=0.0)
        await stand.rig.until(lambda: performer.stage is LEFT)
        assert isinstance(performer.fault, M100Error)
        assert "has control" in performer.fault.seen


async def test_whenever_it_leaves_nobody_has_control_then(stand: Stand) -> None:
    """While it takes control and off, at drawn moments."""
    seed, performer, client = 31, stand.performer, stand.one.client
    draw = Random(seed)
    for attempt in range(30):
        performer.load(FLOWN.to_bytes(), "hover")
        performer.place("anna", asked_at=0.0)
        for _ in range(draw.randrange(1, 40)):
            await asyncio.sleep(draw.choice([0.0, 0.0, 0.02]))
        performer.leave()
        await anyio.sleep(0.5)
        assert performer.stage is LEFT, (seed, attempt)
        assert client.holder.number == 0, (seed, attempt)
        assert not client.state.has_authority, (seed, attempt)


async def test_what_is_no_number_is_neither_flown_by_nor_sent_to_the_others() -> None:
    """A place of NaN is near to nobody: the others would fly into it."""
    state = AircraftState(lambda: 0.25)
    state.update(known.sample(changed=[Attitude(math.nan, 0, 0, 1), Velocity(math.nan, 1, 2, 7)]))
    client: Any = SimpleNamespace(
        view=known.seen(state, 0.25),
        now=5.0,
        on_event=[],
        on_lease=[],
        on_steer_refused=[],
        on_authority_taken=[],
        agents_before=0,
    )
    performer = TrackExecutor(client, "a1")
    with pytest.raises(TelemetryStalled, match="heading"):
        performer._heading()
    performer.track, performer.stage, performer._start_at = FLOWN, LEFT, 0.0
    performer.neighbours = cast(Any, SimpleNamespace(show="show"))
    ahead = performer.ahead()
    assert ahead is not None
    assert all(math.isfinite(number) for place in ahead.places for number in place)


@pytest.mark.parametrize("after", [0.1, 0.4])
async def test_a_stop_that_is_not_heard_yet_ends_the_steps_to_its_place(
    stand: Stand, after: float
) -> None:
    performer, agent = stand.performer, stand.one.agent
    performer.load(FLOWN.to_bytes(), "hover")
    hears_late(stand.one.channels[1], 0.5)
    performer.place("anna", stand.one.client.now)
    await stand.rig.until(lambda: task_of(agent) is not None)
    await stand.rig.until(lambda: task_of(agent) is None)
    await anyio.sleep(after)
    await agent.stop()
    await anyio.sleep(6.0)
    assert stand.one.height < 2.0
    assert not has_begun(agent, "change of height")
    assert performer.stage is LEFT


async def test_a_stop_that_is_not_heard_yet_ends_the_landing_behind_the_track(
    stand: Stand,
) -> None:
    performer = await stand.to(FLYING, leave="land")
    await anyio.sleep(6.0)
    hears_late(stand.one.channels[1], 0.4)
    over_at = (performer._start_at or 0.0) + FLOWN.end + 1.0
    await anyio.sleep(over_at - 0.1 - stand.one.client.now)
    assert performer.stage is FLYING
    stand.one.agent.background.spawn(stand.one.agent.stop(), "STOP")
    await anyio.sleep(6.0)
    assert not has_begun(stand.one.agent, "land")
    assert stand.one.height > 2.0


@pytest.mark.parametrize(
    ("kind", "name"), [(TrackExecutor, "_take_place"), (TrackSteering, "step")]
)
async def test_an_agent_that_fails_in_the_show_leaves_it(
    stand: Stand, monkeypatch: pytest.MonkeyPatch, kind: type[object], name: str
) -> None:
    """In its stage it would count as flying its track, for its conductor and its neighbours."""

    def fail(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(kind, name, fail)
    performer = await stand.to(FLYING if name == "step" else LOADED)
    if name != "step":
        performer.place("anna", asked_at=0.0)
    await stand.rig.until(lambda: performer.stage is LEFT)
    assert performer.fault is not None
    assert performer.fault.seen == "the agent of a1 failed in the show"
    assert not stand.one.agent.holding.has_authority


# -- values, by a client that is given: where it is, where it is sent, and when --------------------


class Given:
    """A client that says where the aircraft is, and keeps what it was asked."""

    def __init__(self) -> None:
        self.items: dict[type[Any], Any] = {
            # 60 m north and 45 m west of the origin of the shows.
            Position: known.position(latitude=52.100_539_2, longitude=4.309_343_1, height=7.25),
            Velocity: Velocity(1.5, -2.25, 0.75, 7),
            Attitude: Attitude(*known.quaternion(0.0, 0.0, 130.0)),
        }
        self.is_airborne = True
        self.speed: float | None = 8.0
        self.asked: list[orders.Order] = []
        self.steered: list[tuple[float, Setpoint]] = []
        self.began_at = anyio.current_time()
        self.on_event: list[Any] = []
        self.on_lease: list[Any] = []
        self.on_steer_refused: list[Any] = []
        self.on_authority_taken: list[Any] = []
        self.agents_before = 0

    @property
    def now(self) -> float:
        return anyio.current_time() - self.began_at

    @property
    def state(self) -> Any:
        return SimpleNamespace(limits=SimpleNamespace(max_speed_m_s=self.speed))

    @property
    def view(self) -> Any:
        return SimpleNamespace(to_steer_by=self.items.get, is_airborne=self.is_airborne)

    def check(self, lease: Any) -> Any:
        return lease

    def steer(self, _lease: Any, setpoint: Setpoint) -> None:
        self.steered.append((self.now, setpoint))

    def note(self, _text: str, _level: str = "info") -> None:
        """Nobody reads it."""

    async def ask(self, order: orders.Order) -> None:
        self.asked.append(order)


def given(**more: Any) -> tuple[Given, TrackExecutor]:
    client = Given()
    for name, value in more.items():
        setattr(client, name, value)
    return client, TrackExecutor(cast(Any, client), "a1")


AWAY = track("a1", (0, 60, -45, 9), (8, 60, -33, 9), ground_m=1.75, heading_deg=-35)


async def test_heights_of_a_show_are_those_of_the_aircraft_and_of_its_ground() -> None:
    _, performer = given()
    assert performer._here(AWAY) == pytest.approx((60.0, -45.0, 9.0), abs=0.05)


@pytest.mark.parametrize("is_airborne", [False, True])
async def test_it_is_sent_to_the_first_point_of_its_track(is_airborne: bool) -> None:
    client, performer = given(is_airborne=is_airborne)
    await performer._take_place(client.ask, AWAY)
    there = client.asked[-1]
    assert isinstance(there, FlyTo)
    assert there.latitude_deg == pytest.approx(52.100_539_2, abs=5e-7)
    assert there.longitude_deg == pytest.approx(4.309_343_1, abs=5e-7)
    assert (there.height, there.yaw_deg) == (7.25, -35)
    assert client.asked[:-1] == [orders.TakeOff()] * (not is_airborne) + [ChangeHeight(7.25)]


@pytest.mark.parametrize(("asked", "most"), [(None, 10.0), (8.0, 8.0), (20.0, 10.0)])
async def test_it_flies_as_fast_as_the_guards_of_its_agent_allow(
    asked: float | None, most: float
) -> None:
    _, performer = given(speed=asked)
    assert most * (1 - 2e-6) < performer._fastest < most


async def test_a_track_that_its_guards_do_not_allow_is_not_begun() -> None:
    """60 m in 8 s from rest to rest: 11.25 m/s in the middle."""
    _, performer = given(speed=11.0)
    with pytest.raises(ShowRefused) as caught:
        performer.load(track("a1", (0, 0, 0, 4), (8, 60, 0, 4)).to_bytes(), "hover")
    assert (caught.value.why, performer.stage) == (Why.SPEED, EMPTY)
    with pytest.raises(UsageError, match="leave cannot be 'dive'"):
        performer.load(FLOWN.to_bytes(), cast(Any, "dive"))


async def test_a_beginning_that_is_over_by_the_clock_of_the_agent_is_refused() -> None:
    client, performer = given()
    performer.track, performer.stage = AWAY, READY
    await anyio.sleep(30.0)
    with pytest.raises(ShowRefused, match=r"a1 should have begun 0\.50 s ago") as caught:
        performer.start(AWAY.digest, client.now - 0.5, 0.0)
    assert (caught.value.why, performer.stage) == (Why.LATE, READY)


async def test_where_it_will_be_is_told_from_its_start_until_ten_minutes_after_its_end() -> None:
    client, performer = given()
    performer.track, performer.stage = AWAY, LEFT
    assert performer.ahead() is None, "not before it knows when it begins"
    performer.neighbours = Neighbours("show", "a1", 3.0)
    assert performer.ahead() is None
    performer._start_at = 2.5
    one = performer.ahead()
    assert one is not None
    assert (one.at, one.down_from) == (-2.5, -2.5)
    moved = [b - a for a, b in zip(one.places[0], one.places[2], strict=True)]
    assert moved == pytest.approx((1.5, -2.25, 0.75)), "in a second: north, east, up"
    performer.stage = FLYING
    one = performer.ahead()
    assert one is not None
    assert one.down_from == 8.0
    del client.items[Velocity]
    performer.stage = LEFT
    performer._start_at = client.now - 608.0
    one = performer.ahead()
    assert one is not None
    assert one.places[0] == one.places[-1]
    performer._start_at = client.now - 608.1
    assert performer.ahead() is None
    performer._start_at = 0.0
    del client.items[Position]
    assert performer.ahead() is None


@pytest.mark.parametrize(("heading", "yaw"), [(None, 130.0), (-35.0, -35.0)])
async def test_all_are_looked_for_a_second_before_the_beginning(
    heading: float | None, yaw: float
) -> None:
    flown = track("a1", (0, 60, -45, 9), (8, 60, -33, 9), ground_m=1.75, heading_deg=heading)
    client, performer = given()
    performer.track, performer.stage = flown, READY
    performer.neighbours = Neighbours("show", "a1", 3.0, 1)
    with pytest.raises(LeftShow, match="1 of the others are silent") as caught:
        await performer._fly(flown, TrackSteering(flown, 8.0), 4.0, 0.0)
    assert client.now == pytest.approx(3.0, abs=0.05)
    assert (caught.value.why, caught.value.at, caught.value.measured) == (Why.NEAR, 0.0, 1)
    assert all(setpoint.yaw == pytest.approx(yaw) for _, setpoint in client.steered)
    assert len(client.steered) == pytest.approx(150, abs=3), "fifty times a second"
    performer.neighbours.hear(by_speed("show", "a2", 3.0, (0.0, 0.0, 9.0), (0.0, 0.0, 0.0)), 3.0)
    client.steered.clear()
    with pytest.raises(LeftShow) as caught:  # it stands still, and its track does not
        await performer._fly(flown, TrackSteering(flown, 8.0), 4.0, 0.0)
    assert caught.value.why is Why.TUBE
    # It leaves when its track is 1.5 m away, and was asked to follow it eastwards until then.
    at = next(n / 100 for n in range(800) if flown.moment(n / 100).place[1] > -43.5)
    assert caught.value.at == pytest.approx(at, abs=0.05)
    setpoint = client.steered[-1][1]
    assert setpoint.x == pytest.approx(0.0, abs=0.05)
    assert setpoint.y > 1.5


async def test_an_aircraft_of_another_show_in_its_way_is_left_in_time() -> None:
    """It hovers 20 m to the north, by its own origin, time and show; the track leads through it."""
    flown = track("a1", (0, 60, -45, 9), (20, 100, -45, 9), ground_m=1.75)
    client, performer = given()
    performer.track, performer.stage = flown, READY
    performer.neighbours = Neighbours("show", "a1", 3.0)
    other = LocalFrame(*flown.origin).to_geodetic(500.0, 0.0)
    told = by_speed("other", "b1", 99.0, (-420.0, -45.0, 2.0), (0.0, 0.0, 0.0))
    performer.hear(replace(told, origin=other))
    assert performer.neighbours.near(by_track("show", flown, 5.0, (70.0, -45.0, 9.0)), 5.0) is None
    performer._start_at = client.now
    performer.hear(replace(told, origin=other))
    near = performer.neighbours.near(by_track("show", flown, 0.0, (60.0, -45.0, 9.0)), client.now)
    assert near is not None
    assert near.name == "b1"
    assert 0.0 < near.at < 10.0
    await anyio.sleep(7.0)
    heard: list[tuple[float, float]] = []
    others = SimpleNamespace(show="show", hear=lambda one, now: heard.append((one.at, now)))
    performer.neighbours, performer._start_at = cast(Any, others), 2.0
    performer.hear(replace(told, origin=other))
    assert heard[0] == pytest.approx((5.0, 7.0)), "by the time of this show"


async def test_a_conductor_is_missed_after_ten_seconds() -> None:
    client, performer = given()
    waiting = asyncio.create_task(performer._attend())
    ends: list[float] = []

    def leave(_work: Any) -> None:
        ends.append(client.now)

    performer._do = leave  # type: ignore[assignment,method-assign] # for this test
    performer.run = "b"
    await anyio.sleep(4.0)
    performer.heard("c")
    performer.heard("b")
    await anyio.sleep(30.0)
    await waiting
    assert ends == [pytest.approx(14.0)]
    performer.track, performer.stage, performer._heard_at = FLOWN, LOADED, client.now - 10.0
    with pytest.raises(UsageError, match="another conductor"):
        performer.require_run("a")
    performer._heard_at -= 0.125
    performer.require_run("a")
    performer.stage = READY
    with pytest.raises(UsageError, match="another conductor"):
        performer.require_run("a")
    performer.require_run("b")
    with pytest.raises(LeftShow, match="the conductor was silent for 10 s") as caught:
        await performer._abandoned()
    assert (caught.value.measured, caught.value.limit) == pytest.approx((10.125, 10.0))


async def test_another_one_that_comes_near_is_named_with_its_distance_and_time() -> None:
    _, performer = given()
    performer.track, performer.stage, performer._start_at = FLOWN, LEFT, -1.5
    near = Near("a2", 8.75, 2.5, 0.0)
    silent = Near("a2", 8.75, 2.5, 3.75)
    for found, seen in (
        (near, "a1 left the show at 1.5 s: a2 would come as near as 2.5 m in 7.2 s; 4 m are"),
        (silent, "1.5 s: a2 has been silent for 3.8 s and may stand there: a2 would come as"),
    ):
        others = SimpleNamespace(show="show", least_m=4.0, near=lambda *_, found=found: found)
        performer.neighbours = cast(Any, others)
        with pytest.raises(LeftShow) as caught:
            performer._require_apart()
        assert seen in caught.value.seen
        assert (caught.value.why, caught.value.measured, caught.value.limit) == (Why.NEAR, 2.5, 4.0)
