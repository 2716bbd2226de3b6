"""Every wish in every phase, and over everything that flies; and what races."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import anyio
import pytest

from m100link.apps.agent.messages import LeaseChanged, State
from m100link.apps.agent.orders import ChangeHeight, FlyTo, PauseMission, ResumeMission
from m100link.apps.mavlink.crew import MissionFlights
from m100link.apps.mavlink.translator.deck import REMEMBERED_S, Deck
from m100link.apps.mavlink.translator.modes import (
    ARM_VERDICTS,
    DISARM_VERDICTS,
    RUNNING,
    VERDICTS,
    Mode,
    Phase,
    Running,
    Step,
    Verdict,
)
from m100link.apps.mavlink.translator.numbers import Command, Result, Severity
from m100link.apps.mavlink.translator.orders import (
    Arm,
    CallOff,
    Disarm,
    Do,
    Flight,
    GoHome,
    Halt,
    Land,
    Order,
    TakeOff,
    Wish,
)
from m100link.apps.mavlink.translator.peers import Peer
from m100link.apps.mavlink.translator.world import World
from m100link.errors import GuardRefused, LinkError, NoAuthority, TaskRefused
from m100link.missions.plan import Waypoint, WaypointPlan
from m100link.protocol.setpoint import Setpoint
from tests.apps.mavlink.conftest import Ground, Rig, session_of
from tests.known import Known

PEER, OTHER = Peer(("127.0.0.1", 1), 245, 190), Peer(("127.0.0.1", 2), 255, 190)

BY_AIRCRAFT = Flight(
    (FlyTo(22.5, 113.9, 8.0, 5.0), FlyTo(22.5001, 113.9, 8.0, 5.0)),
    (0.0, 0.0),
    then=GoHome(),
    items=(0, 1),
    plan=WaypointPlan([Waypoint(22.5, 113.9, 8.0), Waypoint(22.5001, 113.9, 8.0)]),
)
PAUSE, RESUME = Do(PauseMission(), BY_AIRCRAFT), Do(ResumeMission(), BY_AIRCRAFT)
ORDERS: dict[Mode, Order | None] = {
    Mode.HOLD: Halt(),
    Mode.TAKEOFF: TakeOff(5.0),
    Mode.MISSION: Flight((ChangeHeight(5.0),)),
    Mode.RTL: GoHome(),
    Mode.LAND: Land(),
    Mode.OFFBOARD: None,
    Mode.POSCTL: None,
    Mode.ALTCTL: None,
    Mode.ORBIT: Flight((ChangeHeight(6.0),)),
    Mode.GOTO: Flight((ChangeHeight(7.0),)),
}
FLYING: dict[Running, Wish | None] = {
    Running.NOTHING: None,
    Running.TAKE_OFF: Wish(Mode.TAKEOFF, TakeOff(5.0), PEER),
    Running.LAND: Wish(Mode.LAND, Land(), PEER),
    Running.GO_HOME: Wish(Mode.RTL, GoHome(), PEER),
    Running.FLIGHT: Wish(Mode.GOTO, Flight((ChangeHeight(9.0),)), PEER),
    Running.STREAM: Wish(Mode.OFFBOARD, None, PEER),
    Running.MISSION: Wish(Mode.MISSION, BY_AIRCRAFT, PEER),
    Running.PAUSED: Wish(Mode.MISSION, BY_AIRCRAFT, PEER),
}
RESULTS = {Verdict.DENY: Result.DENIED, Verdict.REJECT: Result.TEMPORARILY_REJECTED}


class Still(World):
    """A world that stands where the test says."""

    def __init__(self, phase: Phase) -> None:
        known: Any = Known()
        known.is_connected, known.holder = False, LeaseChanged(3, "the console")
        super().__init__(known, session_of(known))
        self.now_phase = phase

    @property
    def phase(self) -> Phase:
        return self.now_phase

    def mode_of_others(self) -> Mode:
        return Mode.POSCTL


class Setpoints:
    """A stream that always has one."""

    def is_fresh(self, now: float) -> bool:
        return True

    def wants_up(self, now: float) -> bool:
        return False

    def setpoint(self, now: float) -> Setpoint | None:
        return Setpoint.velocity(north=1.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


def deck_in(phase: Phase) -> tuple[Deck, Still, list[tuple[Severity, str]]]:
    told: list[tuple[Severity, str]] = []
    world = Still(phase)
    streams: Any = dict.fromkeys((Mode.OFFBOARD, Mode.POSCTL, Mode.ALTCTL), Setpoints())
    return Deck(world, lambda *one: told.append(one), streams), world, told


def let_fly(deck: Deck, running: Running) -> Wish | None:
    """Bring it about that this flies; what begins on the ground has begun in the air."""
    flying = FLYING[running]
    if flying is None:
        return None
    deck._begin(flying)
    if running in (Running.MISSION, Running.PAUSED):
        assert deck.mission_begun(BY_AIRCRAFT)
    if running is Running.PAUSED:
        assert deck.wish(Wish(Mode.HOLD, Halt(), PEER), 0.0) is Result.ACCEPTED
    deck.orders.clear()
    assert deck.running is running
    return flying


def shown(deck: Deck) -> Mode:
    return deck.mode


def flies(deck: Deck) -> Running:
    return deck.running


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("phase", Phase)
def test_a_wish_in_a_phase(phase: Phase, mode: Mode) -> None:
    deck, _, told = deck_in(phase)
    verdict = VERDICTS[phase][mode]
    result = deck.wish(Wish(mode, ORDERS[mode], PEER), 0.0)
    assert result is RESULTS.get(verdict, Result.ACCEPTED)
    assert bool(told) == (verdict in RESULTS), "a refusal has its reason, and nothing else has one"
    if verdict is Verdict.START:
        assert deck.orders == ([ORDERS[mode]] if ORDERS[mode] else [])
        assert (deck.running is Running.STREAM) == (ORDERS[mode] is None)
    elif verdict is Verdict.OBTAIN:
        assert deck.orders == [Arm(PEER.name)]
    else:
        assert deck.orders == []
    assert (deck.operator == PEER) == (verdict in (Verdict.START, Verdict.REMEMBER, Verdict.OBTAIN))


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("running", Running)
def test_a_wish_over_what_flies(running: Running, mode: Mode) -> None:
    deck, _, told = deck_in(Phase.AIRBORNE)
    flying = let_fly(deck, running)
    wish = Wish(mode, ORDERS[mode], PEER)
    if VERDICTS[Phase.AIRBORNE][mode] is Verdict.DENY:
        assert deck.wish(wish, 0.0) is Result.DENIED
        return
    step = RUNNING[running][mode]
    result = deck.wish(wish, 0.0)
    if step is Step.REFUSE:
        assert result is Result.TEMPORARILY_REJECTED
        assert told
    else:
        assert result is Result.ACCEPTED
    if step in (Step.REFUSE, Step.KEEP, Step.WAIT):
        assert deck.orders == []
        assert deck.running is running
    if step is Step.INTERRUPT:
        [order] = deck.orders
        assert isinstance(order, Land | GoHome | Halt)
        assert order.is_interrupting
    if step is Step.PAUSE:
        assert (deck.orders, deck.running) == ([PAUSE], Running.PAUSED)
        assert deck.mode is Mode.HOLD
    if step is Step.RESUME:
        assert (deck.orders, deck.running) == ([RESUME], Running.MISSION)
        assert deck.mode is Mode.MISSION
    if step is Step.STOP:
        # The crew stops the mission before whatever takes over; setpoints have no order of theirs.
        assert deck.orders == [ORDERS[mode] or Halt(why=f"{mode.value} was requested")]
        assert not deck.is_flown_by_aircraft
    if step is Step.REPLACE and ORDERS[mode] is not None:
        assert deck.orders == [ORDERS[mode]]
    if step is Step.WAIT and flying is not None and flying.order is not None:
        assert deck.mode is (Mode.HOLD if mode is Mode.GOTO else mode)
        deck.took_off(flying.order, 1.0)
        assert deck.running is not Running.TAKE_OFF


@pytest.mark.parametrize("mode", Mode)
def test_what_waits_to_come_down_after_a_take_off_is_not_put_off(mode: Mode) -> None:
    deck, _, _ = deck_in(Phase.AIRBORNE)
    let_fly(deck, Running.TAKE_OFF)
    assert RUNNING[Running.TAKE_OFF][Mode.LAND] is Step.WAIT
    assert deck.wish(Wish(Mode.LAND, Land(), PEER), 0.0) is Result.ACCEPTED
    if VERDICTS[Phase.AIRBORNE][mode] is Verdict.DENY:
        return
    step = RUNNING[Running.TAKE_OFF][mode]
    is_later = step is Step.WAIT and mode not in (Mode.LAND, Mode.RTL)
    refused = is_later or step is Step.REFUSE
    expected = Result.TEMPORARILY_REJECTED if refused else Result.ACCEPTED
    assert deck.wish(Wish(mode, ORDERS[mode], PEER), 0.0) is expected


@pytest.mark.parametrize("mode", Mode)
def test_a_wish_over_a_take_off_whose_motors_stand(mode: Mode) -> None:
    deck, _, told = deck_in(Phase.ARMED)
    deck.wish(Wish(Mode.TAKEOFF, TakeOff(5.0), PEER), 0.0)
    deck.orders.clear()
    told.clear()
    result = deck.wish(Wish(mode, ORDERS[mode], PEER), 0.0)
    if mode in (Mode.LAND, Mode.RTL):
        assert result is Result.ACCEPTED
        assert deck.orders == [CallOff()]
        assert deck.mode is mode, "ground stations wait for it"
        assert "called off" in told[-1][1]
    else:
        assert deck.orders == []
        assert flies(deck) is Running.TAKE_OFF
    assert deck.disarm(PEER) is Result.ACCEPTED
    assert deck.orders == [CallOff()], "once"
    assert deck.mode is Mode.HOLD, "whoever disarms waits for no landing"


@pytest.mark.parametrize("phase", Phase)
def test_arming_and_disarming_in_a_phase(phase: Phase) -> None:
    deck, _, _ = deck_in(phase)
    expected = {Verdict.START: None, Verdict.NOTHING: Result.ACCEPTED}
    verdict = ARM_VERDICTS[phase]
    assert deck.arm(PEER, 0.0) is expected.get(verdict, RESULTS.get(verdict))
    deck, _, _ = deck_in(phase)
    verdict = DISARM_VERDICTS[phase]
    assert deck.disarm(PEER) is RESULTS.get(verdict, Result.ACCEPTED)
    assert (Disarm() in deck.orders) == (verdict is Verdict.START)


@pytest.mark.parametrize("mode", Mode)
def test_another_ground_station_only_ends_a_flight(mode: Mode) -> None:
    deck, _, told = deck_in(Phase.AIRBORNE)
    deck.wish(Wish(Mode.GOTO, ORDERS[Mode.GOTO], PEER), 0.0)
    result = deck.wish(Wish(mode, ORDERS[mode], OTHER), 0.0)
    if mode in (Mode.HOLD, Mode.LAND, Mode.RTL):
        assert result is Result.ACCEPTED
    else:
        assert result is Result.TEMPORARILY_REJECTED
        assert PEER.name in told[-1][1]
    assert deck.operator == PEER


@pytest.mark.parametrize("running", Running)
def test_an_operator_that_is_lost_holds_unless_it_is_on_its_way_down(running: Running) -> None:
    deck, _, _ = deck_in(Phase.AIRBORNE)
    flying = let_fly(deck, running)
    deck.operator = PEER
    deck.operator_lost()
    assert not deck.operator
    if running in (Running.LAND, Running.GO_HOME, Running.TAKE_OFF):
        assert deck.orders == []
    else:
        assert [type(order) for order in deck.orders] == [Halt]
    if running is Running.TAKE_OFF and flying is not None and flying.order is not None:
        deck.took_off(flying.order, 1.0)
        assert [type(order) for order in deck.orders] == [Halt], "it does not climb on"


@pytest.mark.parametrize("running", [Running.MISSION, Running.PAUSED])
def test_a_mission_that_was_changed_begins_anew_over_one_that_flies(running: Running) -> None:
    deck, _, _ = deck_in(Phase.AIRBORNE)
    let_fly(deck, running)
    changed = replace(BY_AIRCRAFT, edition=1)
    assert deck.wish(Wish(Mode.MISSION, changed, PEER, True), 0.0) is Result.ACCEPTED
    assert deck.orders == [changed]
    assert deck.flight is changed
    assert flies(deck) is Running.FLIGHT, "the aircraft has not begun it"


def flights_of(deck: Deck, told: list[tuple[Severity, str]]) -> MissionFlights:
    missions: Any = None
    return MissionFlights(deck._world, deck, missions, lambda *one: told.append(one))


@pytest.mark.parametrize("errand", [PAUSE, RESUME])
def test_an_aircraft_that_does_not_pause_or_go_on_loses_what_it_flies(errand: Do) -> None:
    deck, _, told = deck_in(Phase.AIRBORNE)
    let_fly(deck, Running.PAUSED if errand is PAUSE else Running.MISSION)
    flights_of(deck, told).failed(errand, LinkError("no answer"))
    [halt] = deck.orders
    assert isinstance(halt, Halt)
    assert halt.is_interrupting
    assert "no answer" in told[0][1]


def test_what_is_told_to_a_mission_late_is_not_told_at_all() -> None:
    deck, _, told = deck_in(Phase.AIRBORNE)
    flights = flights_of(deck, told)
    let_fly(deck, Running.PAUSED)
    assert (flights.is_due(PAUSE), flights.is_due(RESUME)) == (True, False)
    deck.wish(Wish(Mode.MISSION, BY_AIRCRAFT, PEER), 0.0)
    assert (flights.is_due(PAUSE), flights.is_due(RESUME)) == (False, True)
    deck.wish(Wish(Mode.LAND, Land(), PEER), 0.0)
    assert (flights.is_due(PAUSE), flights.is_due(RESUME)) == (False, False)
    flights.failed(PAUSE, LinkError("no answer"))
    assert flies(deck) is Running.LAND
    assert told == []


def test_a_hold_that_comes_with_the_end_of_the_mission_holds() -> None:
    """The aircraft has begun its way home before the pause reaches it, and knows none there."""
    deck, _, _ = deck_in(Phase.AIRBORNE)
    let_fly(deck, Running.PAUSED)
    deck.mission_flown(BY_AIRCRAFT)
    [halt] = deck.orders
    assert isinstance(halt, Halt)
    assert halt.is_interrupting
    assert shown(deck) is Mode.HOLD


@pytest.mark.parametrize("order", [Land(), GoHome()])
def test_a_way_down_that_is_refused_for_what_flies_ends_that(order: Land | GoHome) -> None:
    deck, _, _ = deck_in(Phase.AIRBORNE)
    let_fly(deck, Running.MISSION)
    mode = Mode.LAND if isinstance(order, Land) else Mode.RTL
    deck.wish(Wish(mode, order, PEER), 0.0)
    deck.orders.clear()
    deck.ended(order, TaskRefused("it goes home"), 1.0)
    again = replace(order, is_interrupting=True)
    assert deck.orders == [again]
    deck.orders.clear()
    deck.ended(again, TaskRefused("no"), 2.0)
    assert deck.orders == [], "once"


@pytest.mark.parametrize(
    ("then", "running"),
    [(GoHome(), Running.GO_HOME), (Land(), Running.LAND), (None, Running.MISSION)],
)
def test_the_way_down_behind_a_mission_is_the_mode_that_is_shown(
    then: GoHome | Land | None, running: Running
) -> None:
    deck, world, _ = deck_in(Phase.AIRBORNE)
    flight = replace(BY_AIRCRAFT, then=then)
    deck._begin(Wish(Mode.MISSION, flight, PEER))
    assert deck.mission_begun(flight)
    deck.mission_flown(flight)
    assert deck.running is running
    deck.orders.clear()
    world.now_phase = Phase.ARMED
    deck.ended(flight, None, 1.0)
    assert deck.orders == ([Disarm()] if then is not None else [])
    assert flies(deck) is Running.NOTHING


def test_a_stop_that_was_not_heard_ends_the_stream_that_waits_for_it() -> None:
    deck, _, told = deck_in(Phase.AIRBORNE)
    let_fly(deck, Running.MISSION)
    deck.wish(Wish(Mode.OFFBOARD, None, PEER), 0.0)
    [halt] = deck.orders
    assert isinstance(halt, Halt)
    deck.ended(halt, LinkError("no answer"), 1.0)
    assert flies(deck) is Running.NOTHING
    assert "no answer" in told[-1][1]


def test_a_mission_of_somebody_who_is_gone_is_shown_and_ends_when_it_is_armed() -> None:
    deck, world, told = deck_in(Phase.AIRBORNE)
    known: Any = world.known
    known.state, known.is_connected = State(at=0.0, mission="waypoint mission"), True
    assert shown(deck) is Mode.MISSION
    deck._arming = order = Arm(PEER.name)
    deck.armed(order, None, 0.0)
    assert [type(order) for order in deck.orders] == [Halt]
    assert "is stopped" in told[-1][1]


def test_what_ends_late_means_nothing() -> None:
    deck, _, told = deck_in(Phase.AIRBORNE)
    first = Flight((ChangeHeight(5.0),))
    deck.wish(Wish(Mode.GOTO, first, PEER), 0.0)
    deck.wish(Wish(Mode.LAND, Land(), PEER), 0.0)
    deck.ended(first, LinkError("cut"), 1.0)
    assert deck.running is Running.LAND
    assert told == []


def test_disarming_while_authority_is_obtained_gives_it_back() -> None:
    deck, world, told = deck_in(Phase.DISARMED)
    assert deck.arm(PEER, 0.0) is None
    assert deck.disarm(PEER) is Result.ACCEPTED
    assert deck.orders == [Arm(PEER.name), Disarm()]
    first = deck.orders[0]
    deck.wish(Wish(Mode.TAKEOFF, TakeOff(), PEER), 0.0)
    world.now_phase = Phase.ARMED
    deck.orders.clear()
    assert isinstance(first, Arm)
    deck.armed(first, None, 1.0)
    assert "disarmed before arming" in told[-1][1]
    assert deck.orders == [], "nothing begins"
    assert deck.phase is Phase.DISARMED


def test_armed_again_while_a_request_that_is_not_wanted_ends() -> None:
    deck, _, told = deck_in(Phase.DISARMED)
    answered: list[object] = []
    deck.on_armed = answered.append
    deck.arm(PEER, 0.0)
    deck.disarm(PEER)
    assert deck.arm(PEER, 0.0) is None
    first, _, second = deck.orders
    assert isinstance(first, Arm)
    assert isinstance(second, Arm)
    assert first is not second
    deck.armed(first, NoAuthority("let go"), 0.1)
    assert (answered, told) == ([], [])
    deck.armed(second, None, 0.2)
    assert answered == [None]


@pytest.mark.parametrize("wish", ["arm", Mode.HOLD, Mode.LAND, Mode.RTL])
def test_nothing_is_armed_while_a_take_off_is_called_off(wish: Mode | str) -> None:
    deck, world, told = deck_in(Phase.ARMED)
    deck.wish(Wish(Mode.TAKEOFF, TakeOff(), PEER), 0.0)
    assert deck.disarm(PEER) is Result.ACCEPTED
    world.now_phase = Phase.FREE  # it takes off all the same, and is landed
    deck.orders.clear()
    if isinstance(wish, str):
        result = deck.arm(PEER, 0.0)
    else:
        result = deck.wish(Wish(wish, ORDERS[wish], PEER), 0.0)
    assert result is (Result.ACCEPTED if wish is Mode.LAND else Result.TEMPORARILY_REJECTED)
    assert deck.orders == []
    assert "called off" in told[-1][1]


def test_a_remembered_wish_ends() -> None:
    deck, world, told = deck_in(Phase.DISARMED)
    deck.wish(Wish(Mode.MISSION, ORDERS[Mode.MISSION], PEER), 0.0)
    assert shown(deck) is Mode.MISSION
    deck.advance(REMEMBERED_S)
    assert shown(deck) is Mode.POSCTL
    assert "not armed" in told[-1][1]
    world.now_phase = Phase.ARMED
    deck._arming = order = Arm(PEER.name)
    deck.armed(order, None, REMEMBERED_S + 1)
    assert deck.orders == []


@pytest.mark.parametrize("phase", [Phase.PILOT, Phase.FREE, Phase.OTHER, Phase.AWAY])
def test_control_that_is_lost_forgets_what_was_wanted(phase: Phase) -> None:
    deck, world, _ = deck_in(Phase.AIRBORNE)
    deck.wish(Wish(Mode.OFFBOARD, None, PEER), 0.0)
    world.now_phase = phase
    deck.advance(1.0)
    assert flies(deck) is Running.NOTHING
    world.now_phase = Phase.AIRBORNE
    deck.orders.clear()
    deck.advance(2.0)
    assert deck.orders == [], "it comes back to a hover"
    assert shown(deck) is Mode.HOLD


@pytest.mark.parametrize("running", [Running.STREAM, Running.FLIGHT, Running.TAKE_OFF])
def test_control_that_came_back_before_somebody_looked_was_lost(running: Running) -> None:
    deck, world, _ = deck_in(Phase.AIRBORNE)
    let_fly(deck, running)
    world.now_phase = Phase.FREE  # for one look
    deck.advance(1.0)
    world.now_phase = Phase.AIRBORNE
    assert flies(deck) is Running.NOTHING
    assert shown(deck) is Mode.HOLD


def test_what_ends_a_landing_gives_control_back_itself_and_goes_on() -> None:
    deck, world, _ = deck_in(Phase.AIRBORNE)
    let_fly(deck, Running.LAND)
    assert deck.wish(Wish(Mode.HOLD, Halt(), PEER), 0.0) is Result.ACCEPTED
    ending = list(deck.orders)
    world.now_phase = Phase.FREE
    deck.advance(1.0)
    assert deck.orders == ending


def test_a_stop_of_somebody_else_ends_the_stream_and_a_guard_is_told() -> None:
    deck, _, told = deck_in(Phase.AIRBORNE)
    deck.wish(Wish(Mode.OFFBOARD, None, PEER), 0.0)
    deck.steer_refused(GuardRefused("too far", guard="envelope"))
    assert flies(deck) is Running.STREAM
    assert "too far" in told[-1][1]
    deck.steer_refused(GuardRefused("STOP was pressed", guard="stopped"))
    assert flies(deck) is Running.NOTHING
    assert shown(deck) is Mode.HOLD


@pytest.fixture
def anyio_backend() -> Any:
    from m100link.sim.clock import virtual_clock_loop

    return "asyncio", {"loop_factory": virtual_clock_loop}


@pytest.mark.anyio
async def test_armed_and_disarmed_at_once_is_disarmed(rig: Rig, ground: Ground) -> None:
    ground.command(Command.COMPONENT_ARM_DISARM, 1)
    ground.command(Command.COMPONENT_ARM_DISARM, 0)
    await anyio.sleep(5.0)
    assert not ground.armed()
    assert not rig.client.holder.number


@pytest.mark.anyio
async def test_a_stop_of_the_console_is_not_flown_over(rig: Rig, ground: Ground) -> None:
    await ground.fly(5.0)

    def north() -> None:
        fields = {"coordinate_frame": 1, "type_mask": 0b1101_1100_0111, "vx": 3.0}
        ground.send("SET_POSITION_TARGET_LOCAL_NED", target_system=1, **fields)

    north()
    assert await ground.set_mode(Mode.OFFBOARD) is Result.ACCEPTED
    for step in range(120):
        north()
        await anyio.sleep(0.05)
        if step == 40:
            await rig.agent.stop()
    assert rig.speed < 0.1
    assert ground.mode is Mode.HOLD
    await rig.until(lambda: "STOP was pressed" in ground.texts)
