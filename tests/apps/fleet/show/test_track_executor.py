"""An aircraft of a fleet in a show: each order in each stage, and what ends it."""

from __future__ import annotations

import asyncio
import math
from random import Random
from types import SimpleNamespace
from typing import Any, cast

import anyio
import pytest

from m100link.apps.fleet.payloads import (
    LeaveShow,
    LoadTrack,
    ShowOrder,
    ShowStage,
    StartShow,
    TakePlace,
)
from m100link.apps.fleet.show.plan.steering import (
    MOST_EARLY_S,
    LeftShow,
    ShowRefused,
    TrackSteering,
    Why,
)
from m100link.apps.fleet.show.plan.track import BadShow
from m100link.apps.fleet.show.track_executor import ALLOWED, ATTENDED_S, Leave, TrackExecutor
from m100link.errors import AuthorityLost, M100Error, NoAuthority, TelemetryStalled, UsageError
from m100link.protocol.records import Attitude, Velocity
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
