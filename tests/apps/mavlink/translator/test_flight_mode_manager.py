"""Every request in every phase, and over everything that flies; and what races."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import anyio
import pytest

from m100link.apps.agent.messages import LeaseChanged, State
from m100link.apps.agent.orders import ChangeHeight, FlyTo, PauseMission, ResumeMission
from m100link.apps.mavlink.order_executor import MissionFlights
from m100link.apps.mavlink.translator.codec import Peer
from m100link.apps.mavlink.translator.flight_mode_manager import FlightModeManager
from m100link.apps.mavlink.translator.numbers import MavCommand, MavResult, Severity
from m100link.apps.mavlink.translator.orders import (
    CancelTakeOff,
    FlightSequence,
    HoldPosition,
    LandInPlace,
    MissionCommand,
    ModeRequest,
    ObtainControl,
    ReleaseControl,
    ReturnToLaunch,
    TakeOffAndClimb,
    VehicleOrder,
)
from m100link.apps.mavlink.translator.vehicle_state import (
    ARM_VERDICTS,
    DISARM_VERDICTS,
    RUNNING,
    VERDICTS,
    FlightSource,
    Mode,
    ModeTransition,
    ModeVerdict,
    VehiclePhase,
    VehicleState,
)
from m100link.errors import GuardRefused, LinkError, NoAuthority, TaskRefused
from m100link.missions.plan import Waypoint, WaypointPlan
from m100link.protocol.setpoint import Setpoint
from tests.apps.mavlink.conftest import Ground, Rig, session_of
from tests.known import Known

PEER, OTHER = Peer(("127.0.0.1", 1), 245, 190), Peer(("127.0.0.1", 2), 255, 190)

BY_AIRCRAFT = FlightSequence(
    (FlyTo(22.5, 113.9, 8.0, 5.0), FlyTo(22.5001, 113.9, 8.0, 5.0)),
    (0.0, 0.0),
    then=ReturnToLaunch(),
    items=(0, 1),
    plan=WaypointPlan([Waypoint(22.5, 113.9, 8.0), Waypoint(22.5001, 113.9, 8.0)]),
)
PAUSE, RESUME = (
    MissionCommand(PauseMission(), BY_AIRCRAFT),
    MissionCommand(ResumeMission(), BY_AIRCRAFT),
)
ORDERS: dict[Mode, VehicleOrder | None] = {
    Mode.HOLD: HoldPosition(),
    Mode.TAKEOFF: TakeOffAndClimb(5.0),
    Mode.MISSION: FlightSequence((ChangeHeight(5.0),)),
    Mode.RTL: ReturnToLaunch(),
    Mode.LAND: LandInPlace(),
    Mode.OFFBOARD: None,
    Mode.POSCTL: None,
    Mode.ALTCTL: None,
    Mode.ORBIT: FlightSequence((ChangeHeight(6.0),)),
    Mode.GOTO: FlightSequence((ChangeHeight(7.0),)),
}
FLYING: dict[FlightSource, ModeRequest | None] = {
    FlightSource.NOTHING: None,
    FlightSource.TAKE_OFF: ModeRequest(Mode.TAKEOFF, TakeOffAndClimb(5.0), PEER),
    FlightSource.LAND: ModeRequest(Mode.LAND, LandInPlace(), PEER),
    FlightSource.GO_HOME: ModeRequest(Mode.RTL, ReturnToLaunch(), PEER),
    FlightSource.FLIGHT: ModeRequest(Mode.GOTO, FlightSequence((ChangeHeight(9.0),)), PEER),
    FlightSource.STREAM: ModeRequest(Mode.OFFBOARD, None, PEER),
    FlightSource.MISSION: ModeRequest(Mode.MISSION, BY_AIRCRAFT, PEER),
    FlightSource.PAUSED: ModeRequest(Mode.MISSION, BY_AIRCRAFT, PEER),
}
RESULTS = {ModeVerdict.DENY: MavResult.DENIED, ModeVerdict.REJECT: MavResult.TEMPORARILY_REJECTED}


class Still(VehicleState):
    """A world that stands where the test says."""

    def __init__(self, phase: VehiclePhase) -> None:
        known: Any = Known()
        known.is_connected, known.holder = False, LeaseChanged(3, "the console")
        super().__init__(known, session_of(known))
        self.now_phase = phase

    @property
    def phase(self) -> VehiclePhase:
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


def manager_in(phase: VehiclePhase) -> tuple[FlightModeManager, Still, list[tuple[Severity, str]]]:
    told: list[tuple[Severity, str]] = []
    world = Still(phase)
    streams: Any = dict.fromkeys((Mode.OFFBOARD, Mode.POSCTL, Mode.ALTCTL), Setpoints())
    return FlightModeManager(world, lambda *one: told.append(one), streams), world, told


def let_fly(manager: FlightModeManager, running: FlightSource) -> ModeRequest | None:
    """Bring it about that this flies; what begins on the ground has begun in the air."""
    flying = FLYING[running]
    if flying is None:
        return None
    manager._begin(flying)
    if running in (FlightSource.MISSION, FlightSource.PAUSED):
        assert manager.mission_begun(BY_AIRCRAFT)
    if running is FlightSource.PAUSED:
        assert (
            manager.request_mode(ModeRequest(Mode.HOLD, HoldPosition(), PEER), 0.0)
            is MavResult.ACCEPTED
        )
    manager.orders.clear()
    assert manager.running is running
    return flying


def shown(manager: FlightModeManager) -> Mode:
    return manager.mode


def flies(manager: FlightModeManager) -> FlightSource:
    return manager.running


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("phase", VehiclePhase)
def test_a_wish_in_a_phase(phase: VehiclePhase, mode: Mode) -> None:
    manager, _, told = manager_in(phase)
    verdict = VERDICTS[phase][mode]
    result = manager.request_mode(ModeRequest(mode, ORDERS[mode], PEER), 0.0)
    assert result is RESULTS.get(verdict, MavResult.ACCEPTED)
    assert bool(told) == (verdict in RESULTS), "a refusal has its reason, and nothing else has one"
    if verdict is ModeVerdict.START:
        assert manager.orders == ([ORDERS[mode]] if ORDERS[mode] else [])
        assert (manager.running is FlightSource.STREAM) == (ORDERS[mode] is None)
    elif verdict is ModeVerdict.OBTAIN:
        assert manager.orders == [ObtainControl(PEER.name)]
    else:
        assert manager.orders == []
    assert (manager.operator == PEER) == (
        verdict in (ModeVerdict.START, ModeVerdict.REMEMBER, ModeVerdict.OBTAIN)
    )


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("running", FlightSource)
def test_a_wish_over_what_flies(running: FlightSource, mode: Mode) -> None:
    manager, _, told = manager_in(VehiclePhase.AIRBORNE)
    flying = let_fly(manager, running)
    request = ModeRequest(mode, ORDERS[mode], PEER)
    if VERDICTS[VehiclePhase.AIRBORNE][mode] is ModeVerdict.DENY:
        assert manager.request_mode(request, 0.0) is MavResult.DENIED
        return
    step = RUNNING[running][mode]
    result = manager.request_mode(request, 0.0)
    if step is ModeTransition.REFUSE:
        assert result is MavResult.TEMPORARILY_REJECTED
        assert told
    else:
        assert result is MavResult.ACCEPTED
    if step in (ModeTransition.REFUSE, ModeTransition.KEEP, ModeTransition.WAIT):
        assert manager.orders == []
        assert manager.running is running
    if step is ModeTransition.INTERRUPT:
        [order] = manager.orders
        assert isinstance(order, LandInPlace | ReturnToLaunch | HoldPosition)
        assert order.is_interrupting
    if step is ModeTransition.PAUSE:
        assert (manager.orders, manager.running) == ([PAUSE], FlightSource.PAUSED)
    if step is ModeTransition.RESUME:
        assert (manager.orders, manager.running) == ([RESUME], FlightSource.MISSION)
        assert manager.mode is Mode.MISSION
    if step is ModeTransition.STOP:
        # The executor stops the mission first; setpoints have no order of their own.
        assert manager.orders == [ORDERS[mode] or HoldPosition(why=f"{mode.value} was requested")]
        assert not manager.is_flown_by_aircraft
    if step is ModeTransition.REPLACE and ORDERS[mode] is not None:
        assert manager.orders == [ORDERS[mode]]
    if step is ModeTransition.WAIT and flying is not None and flying.order is not None:
        assert manager.mode is (Mode.HOLD if mode is Mode.GOTO else mode)
        manager.took_off(LandInPlace(), 1.0)
        assert manager.running is FlightSource.TAKE_OFF, "it was another order that is over"
        manager.took_off(flying.order, 1.0)
        assert manager.running is not FlightSource.TAKE_OFF


_UNTIL_HEARD = (ModeTransition.INTERRUPT, ModeTransition.STOP, ModeTransition.PAUSE)


@pytest.mark.parametrize("mode", [mode for mode, order in ORDERS.items() if order is not None])
@pytest.mark.parametrize("running", FlightSource)
def test_a_mode_is_shown_once_what_flew_before_has_ended(running: FlightSource, mode: Mode) -> None:
    """HOLD stood in the heartbeat while the aircraft went on down."""
    manager, _, _ = manager_in(VehiclePhase.AIRBORNE)
    if RUNNING[running][mode] not in _UNTIL_HEARD or mode is Mode.TAKEOFF:
        return
    let_fly(manager, running)
    manager.way_made()
    before = shown(manager)
    manager.request_mode(ModeRequest(mode, ORDERS[mode], PEER), 0.0)
    assert shown(manager) is before
    manager.way_made()
    assert shown(manager) is (Mode.HOLD if mode is Mode.GOTO else mode)


def test_a_mode_of_an_order_that_another_replaced_is_shown_no_more() -> None:
    manager, _, _ = manager_in(VehiclePhase.AIRBORNE)
    let_fly(manager, FlightSource.GO_HOME)
    manager.request_mode(ModeRequest(Mode.HOLD, HoldPosition(), PEER), 0.0)
    manager.request_mode(ModeRequest(Mode.OFFBOARD, None, PEER), 0.1)
    assert shown(manager) is Mode.OFFBOARD


@pytest.mark.parametrize(
    ("north", "east", "text"),
    [
        (0.0, 12.0, "Return: home is 12 m away: within 20 m it lands in place"),
        (-15.0, -13.0, "Return: home is 20 m away: within 20 m it lands in place"),  # 19.85
        (0.0, 0.0, "Return: home is 0 m away: within 20 m it lands in place"),
        (14.2, 14.2, None),  # 20.08
        (0.0, 20.5, None),
    ],
)
def test_a_return_that_lands_in_place_says_so(
    monkeypatch: pytest.MonkeyPatch, north: float, east: float, text: str | None
) -> None:
    manager, world, told = manager_in(VehiclePhase.AIRBORNE)
    monkeypatch.setattr(type(world), "local", property(lambda _: (north, east, 9.0)))
    manager.request_mode(ModeRequest(Mode.RTL, ReturnToLaunch(), PEER), 0.0)
    assert told == ([] if text is None else [(Severity.WARNING, text)])
    let_fly(manager, FlightSource.MISSION)
    told.clear()
    manager.mission_flown(BY_AIRCRAFT)
    assert told == ([] if text is None else [(Severity.WARNING, text)])


@pytest.mark.parametrize("mode", Mode)
def test_what_waits_to_come_down_after_a_take_off_is_not_put_off(mode: Mode) -> None:
    manager, _, told = manager_in(VehiclePhase.AIRBORNE)
    let_fly(manager, FlightSource.TAKE_OFF)
    assert RUNNING[FlightSource.TAKE_OFF][Mode.LAND] is ModeTransition.WAIT
    assert (
        manager.request_mode(ModeRequest(Mode.LAND, LandInPlace(), PEER), 0.0) is MavResult.ACCEPTED
    )
    if VERDICTS[VehiclePhase.AIRBORNE][mode] is ModeVerdict.DENY:
        return
    step = RUNNING[FlightSource.TAKE_OFF][mode]
    is_later = step is ModeTransition.WAIT and mode not in (Mode.LAND, Mode.RTL)
    refused = is_later or step is ModeTransition.REFUSE
    expected = MavResult.TEMPORARILY_REJECTED if refused else MavResult.ACCEPTED
    assert manager.request_mode(ModeRequest(mode, ORDERS[mode], PEER), 0.0) is expected
    refusals = [text for _, text in told if "goes on" in text]
    assert refusals == [f"{mode.value}: Land goes on"] * refused


@pytest.mark.parametrize("mode", Mode)
def test_a_wish_over_a_take_off_whose_motors_stand(mode: Mode) -> None:
    manager, _, told = manager_in(VehiclePhase.ARMED)
    manager.request_mode(ModeRequest(Mode.TAKEOFF, TakeOffAndClimb(5.0), PEER), 0.0)
    manager.orders.clear()
    told.clear()
    result = manager.request_mode(ModeRequest(mode, ORDERS[mode], PEER), 0.0)
    if mode in (Mode.LAND, Mode.RTL):
        assert result is MavResult.ACCEPTED
        assert manager.orders == [CancelTakeOff()]
        assert manager.mode is mode, "ground stations wait for it"
        assert "called off" in told[-1][1]
    else:
        assert manager.orders == []
        assert flies(manager) is FlightSource.TAKE_OFF
    assert manager.disarm(PEER) is MavResult.ACCEPTED
    assert manager.orders == [CancelTakeOff()], "once"
    assert manager.mode is Mode.HOLD, "an order to disarm waits for no landing"


@pytest.mark.parametrize("phase", VehiclePhase)
def test_arming_and_disarming_in_a_phase(phase: VehiclePhase) -> None:
    manager, _, _ = manager_in(phase)
    expected = {ModeVerdict.START: None, ModeVerdict.NOTHING: MavResult.ACCEPTED}
    verdict = ARM_VERDICTS[phase]
    assert manager.arm(PEER, 0.0) is expected.get(verdict, RESULTS.get(verdict))
    manager, _, _ = manager_in(phase)
    verdict = DISARM_VERDICTS[phase]
    assert manager.disarm(PEER) is RESULTS.get(verdict, MavResult.ACCEPTED)
    assert (ReleaseControl() in manager.orders) == (verdict is ModeVerdict.START)


@pytest.mark.parametrize("mode", Mode)
def test_another_ground_station_only_ends_a_flight(mode: Mode) -> None:
    manager, _, told = manager_in(VehiclePhase.AIRBORNE)
    manager.request_mode(ModeRequest(Mode.GOTO, ORDERS[Mode.GOTO], PEER), 0.0)
    result = manager.request_mode(ModeRequest(mode, ORDERS[mode], OTHER), 0.0)
    if mode in (Mode.HOLD, Mode.LAND, Mode.RTL):
        assert result is MavResult.ACCEPTED
    else:
        assert result is MavResult.TEMPORARILY_REJECTED
        assert PEER.name in told[-1][1]
    assert manager.operator == PEER


@pytest.mark.parametrize("running", FlightSource)
def test_an_operator_that_is_lost_holds_unless_it_is_on_its_way_down(running: FlightSource) -> None:
    manager, _, _ = manager_in(VehiclePhase.AIRBORNE)
    flying = let_fly(manager, running)
    manager.operator = PEER
    manager.operator_lost()
    assert not manager.operator
    if running in (FlightSource.LAND, FlightSource.GO_HOME, FlightSource.TAKE_OFF):
        assert manager.orders == []
    else:
        assert [type(order) for order in manager.orders] == [HoldPosition]
    if running is FlightSource.TAKE_OFF and flying is not None and flying.order is not None:
        manager.took_off(flying.order, 1.0)
        assert [type(order) for order in manager.orders] == [HoldPosition], "it does not climb on"


@pytest.mark.parametrize("running", [FlightSource.MISSION, FlightSource.PAUSED])
def test_a_mission_that_was_changed_begins_anew_over_one_that_flies(running: FlightSource) -> None:
    manager, _, _ = manager_in(VehiclePhase.AIRBORNE)
    let_fly(manager, running)
    changed = replace(BY_AIRCRAFT, edition=1)
    assert (
        manager.request_mode(ModeRequest(Mode.MISSION, changed, PEER, True), 0.0)
        is MavResult.ACCEPTED
    )
    assert manager.orders == [changed]
    assert manager.flight is changed
    assert flies(manager) is FlightSource.FLIGHT, "the aircraft has not begun it"


def flights_of(manager: FlightModeManager, told: list[tuple[Severity, str]]) -> MissionFlights:
    missions: Any = None
    return MissionFlights(manager._world, manager, missions, lambda *one: told.append(one))


@pytest.mark.parametrize("command", [PAUSE, RESUME])
def test_an_aircraft_that_does_not_pause_or_go_on_loses_what_it_flies(
    command: MissionCommand,
) -> None:
    manager, _, told = manager_in(VehiclePhase.AIRBORNE)
    let_fly(manager, FlightSource.PAUSED if command is PAUSE else FlightSource.MISSION)
    flights_of(manager, told).failed(command, LinkError("no answer"))
    [halt] = manager.orders
    assert isinstance(halt, HoldPosition)
    assert halt.is_interrupting
    assert "no answer" in told[0][1]


def test_an_order_that_comes_late_to_a_mission_is_not_sent_at_all() -> None:
    manager, _, told = manager_in(VehiclePhase.AIRBORNE)
    flights = flights_of(manager, told)
    let_fly(manager, FlightSource.PAUSED)
    assert (flights.is_due(PAUSE), flights.is_due(RESUME)) == (True, False)
    manager.request_mode(ModeRequest(Mode.MISSION, BY_AIRCRAFT, PEER), 0.0)
    assert (flights.is_due(PAUSE), flights.is_due(RESUME)) == (False, True)
    manager.request_mode(ModeRequest(Mode.LAND, LandInPlace(), PEER), 0.0)
    assert (flights.is_due(PAUSE), flights.is_due(RESUME)) == (False, False)
    flights.failed(PAUSE, LinkError("no answer"))
    assert flies(manager) is FlightSource.LAND
    assert told == []


def test_a_hold_that_comes_with_the_end_of_the_mission_holds() -> None:
    """The aircraft has begun its way home before the pause reaches it, and knows none there."""
    manager, _, _ = manager_in(VehiclePhase.AIRBORNE)
    let_fly(manager, FlightSource.PAUSED)
    manager.mission_flown(BY_AIRCRAFT)
    [halt] = manager.orders
    assert isinstance(halt, HoldPosition)
    assert halt.is_interrupting
    assert shown(manager) is Mode.RTL, "which it flies"
    manager.way_made()
    assert shown(manager) is Mode.HOLD


@pytest.mark.parametrize("order", [LandInPlace(), ReturnToLaunch()])
def test_a_way_down_that_is_refused_for_what_flies_ends_that(
    order: LandInPlace | ReturnToLaunch,
) -> None:
    manager, _, _ = manager_in(VehiclePhase.AIRBORNE)
    let_fly(manager, FlightSource.MISSION)
    mode = Mode.LAND if isinstance(order, LandInPlace) else Mode.RTL
    manager.request_mode(ModeRequest(mode, order, PEER), 0.0)
    manager.orders.clear()
    manager.ended(order, TaskRefused("it goes home"), 1.0)
    again = replace(order, is_interrupting=True)
    assert manager.orders == [again]
    manager.orders.clear()
    manager.ended(again, TaskRefused("no"), 2.0)
    assert manager.orders == [], "once"


@pytest.mark.parametrize(
    ("then", "running"),
    [
        (ReturnToLaunch(), FlightSource.GO_HOME),
        (LandInPlace(), FlightSource.LAND),
        (None, FlightSource.MISSION),
    ],
)
def test_the_way_down_behind_a_mission_is_the_mode_that_is_shown(
    then: ReturnToLaunch | LandInPlace | None, running: FlightSource
) -> None:
    manager, world, _ = manager_in(VehiclePhase.AIRBORNE)
    flight = replace(BY_AIRCRAFT, then=then)
    manager._begin(ModeRequest(Mode.MISSION, flight, PEER))
    assert manager.mission_begun(flight)
    manager.mission_flown(flight)
    assert manager.running is running
    manager.orders.clear()
    world.now_phase = VehiclePhase.ARMED
    manager.ended(flight, None, 1.0)
    assert manager.orders == ([ReleaseControl()] if then is not None else [])
    assert flies(manager) is FlightSource.NOTHING


def test_a_stop_that_was_not_heard_ends_the_stream_that_waits_for_it() -> None:
    manager, _, told = manager_in(VehiclePhase.AIRBORNE)
    let_fly(manager, FlightSource.MISSION)
    manager.request_mode(ModeRequest(Mode.OFFBOARD, None, PEER), 0.0)
    [halt] = manager.orders
    assert isinstance(halt, HoldPosition)
    manager.ended(halt, LinkError("no answer"), 1.0)
    assert flies(manager) is FlightSource.NOTHING
    assert "no answer" in told[-1][1]


def test_a_mission_of_somebody_who_is_gone_is_shown_and_ends_when_it_is_armed() -> None:
    manager, world, told = manager_in(VehiclePhase.AIRBORNE)
    known: Any = world.known
    known.state, known.is_connected = State(at=0.0, mission="waypoint mission"), True
    assert shown(manager) is Mode.MISSION
    manager._arming = order = ObtainControl(PEER.name)
    manager.armed(order, None, 0.0)
    assert [type(order) for order in manager.orders] == [HoldPosition]
    assert "is stopped" in told[-1][1]


@pytest.mark.parametrize(("mission", "halts"), [("waypoint mission", 1), ("", 0)])
def test_setpoints_wait_until_the_mission_of_somebody_who_is_gone_was_stopped(
    mission: str, halts: int
) -> None:
    manager, world, _ = manager_in(VehiclePhase.AIRBORNE)
    known: Any = world.known
    known.state, known.is_connected = State(at=0.0, mission=mission), True
    manager.request_mode(ModeRequest(Mode.OFFBOARD, None, PEER), 0.0)
    assert [type(order) for order in manager.orders] == [HoldPosition] * halts


@pytest.mark.parametrize(
    ("phase", "mission"),
    [(VehiclePhase.AIRBORNE, ""), (VehiclePhase.ARMED, "waypoint mission")],
)
def test_arming_stops_nothing_but_a_mission_in_the_air(phase: VehiclePhase, mission: str) -> None:
    manager, world, told = manager_in(phase)
    known: Any = world.known
    known.state, known.is_connected = State(at=0.0, mission=mission), True
    manager._arming = order = ObtainControl(PEER.name)
    manager.armed(order, None, 0.0)
    assert (manager.orders, told) == ([], [])


def test_what_ends_late_means_nothing() -> None:
    manager, _, told = manager_in(VehiclePhase.AIRBORNE)
    first = FlightSequence((ChangeHeight(5.0),))
    manager.request_mode(ModeRequest(Mode.GOTO, first, PEER), 0.0)
    manager.request_mode(ModeRequest(Mode.LAND, LandInPlace(), PEER), 0.0)
    manager.ended(first, LinkError("cut"), 1.0)
    assert manager.running is FlightSource.LAND
    assert told == []


def test_disarming_while_authority_is_obtained_gives_it_back() -> None:
    manager, world, told = manager_in(VehiclePhase.DISARMED)
    assert manager.arm(PEER, 0.0) is None
    assert manager.disarm(PEER) is MavResult.ACCEPTED
    assert manager.orders == [ObtainControl(PEER.name), ReleaseControl()]
    first = manager.orders[0]
    manager.request_mode(ModeRequest(Mode.TAKEOFF, TakeOffAndClimb(), PEER), 0.0)
    world.now_phase = VehiclePhase.ARMED
    manager.orders.clear()
    assert isinstance(first, ObtainControl)
    manager.armed(first, None, 1.0)
    assert "disarmed before arming" in told[-1][1]
    assert manager.orders == [], "nothing begins"
    assert manager.phase is VehiclePhase.DISARMED


def test_armed_again_while_a_request_that_is_not_wanted_ends() -> None:
    manager, _, told = manager_in(VehiclePhase.DISARMED)
    answered: list[object] = []
    manager.on_armed = answered.append
    manager.arm(PEER, 0.0)
    manager.disarm(PEER)
    assert manager.arm(PEER, 0.0) is None
    first, _, second = manager.orders
    assert isinstance(first, ObtainControl)
    assert isinstance(second, ObtainControl)
    assert first is not second
    manager.armed(first, NoAuthority("let go"), 0.1)
    assert (answered, told) == ([], [])
    manager.armed(second, None, 0.2)
    assert answered == [None]


@pytest.mark.parametrize("wanted", ["arm", Mode.HOLD, Mode.LAND, Mode.RTL])
def test_nothing_is_armed_while_a_take_off_is_called_off(wanted: Mode | str) -> None:
    manager, world, told = manager_in(VehiclePhase.ARMED)
    manager.request_mode(ModeRequest(Mode.TAKEOFF, TakeOffAndClimb(), PEER), 0.0)
    assert manager.disarm(PEER) is MavResult.ACCEPTED
    world.now_phase = VehiclePhase.FREE  # it takes off all the same, and is landed
    manager.orders.clear()
    if isinstance(wanted, str):
        result = manager.arm(PEER, 0.0)
    else:
        result = manager.request_mode(ModeRequest(wanted, ORDERS[wanted], PEER), 0.0)
    assert result is (MavResult.ACCEPTED if wanted is Mode.LAND else MavResult.TEMPORARILY_REJECTED)
    assert manager.orders == []
    assert "called off" in told[-1][1]


def test_a_remembered_wish_ends() -> None:
    manager, world, told = manager_in(VehiclePhase.DISARMED)
    manager.request_mode(ModeRequest(Mode.MISSION, ORDERS[Mode.MISSION], PEER), 0.0)
    assert shown(manager) is Mode.MISSION
    manager.advance(9.9)
    assert shown(manager) is Mode.MISSION
    manager.advance(10.0)
    assert shown(manager) is Mode.POSCTL
    assert "not armed" in told[-1][1]
    world.now_phase = VehiclePhase.ARMED
    manager._arming = order = ObtainControl(PEER.name)
    manager.armed(order, None, 11.0)
    assert manager.orders == []


@pytest.mark.parametrize(
    "phase", [VehiclePhase.PILOT, VehiclePhase.FREE, VehiclePhase.OTHER, VehiclePhase.AWAY]
)
def test_control_that_is_lost_forgets_what_was_wanted(phase: VehiclePhase) -> None:
    manager, world, _ = manager_in(VehiclePhase.AIRBORNE)
    manager.request_mode(ModeRequest(Mode.OFFBOARD, None, PEER), 0.0)
    world.now_phase = phase
    manager.advance(1.0)
    assert flies(manager) is FlightSource.NOTHING
    world.now_phase = VehiclePhase.AIRBORNE
    manager.orders.clear()
    manager.advance(2.0)
    assert manager.orders == [], "it comes back to a hover"
    assert shown(manager) is Mode.HOLD


@pytest.mark.parametrize(
    "running", [FlightSource.STREAM, FlightSource.FLIGHT, FlightSource.TAKE_OFF]
)
def test_control_that_came_back_before_somebody_looked_was_lost(running: FlightSource) -> None:
    manager, world, _ = manager_in(VehiclePhase.AIRBORNE)
    let_fly(manager, running)
    world.now_phase = VehiclePhase.FREE  # for one look
    manager.advance(1.0)
    world.now_phase = VehiclePhase.AIRBORNE
    assert flies(manager) is FlightSource.NOTHING
    assert shown(manager) is Mode.HOLD


def test_what_ends_a_landing_gives_control_back_itself_and_goes_on() -> None:
    manager, world, _ = manager_in(VehiclePhase.AIRBORNE)
    let_fly(manager, FlightSource.LAND)
    assert (
        manager.request_mode(ModeRequest(Mode.HOLD, HoldPosition(), PEER), 0.0)
        is MavResult.ACCEPTED
    )
    ending = list(manager.orders)
    world.now_phase = VehiclePhase.FREE
    manager.advance(1.0)
    assert manager.orders == ending


def test_a_stop_of_somebody_else_ends_the_stream_and_a_guard_is_named() -> None:
    manager, _, told = manager_in(VehiclePhase.AIRBORNE)
    manager.request_mode(ModeRequest(Mode.OFFBOARD, None, PEER), 0.0)
    manager.steer_refused(GuardRefused("too far", guard="envelope"))
    assert flies(manager) is FlightSource.STREAM
    assert "too far" in told[-1][1]
    manager.steer_refused(GuardRefused("STOP was pressed", guard="stopped"))
    assert flies(manager) is FlightSource.NOTHING
    assert shown(manager) is Mode.HOLD


@pytest.fixture
def anyio_backend() -> Any:
    from m100link.sim.clock import virtual_clock_loop

    return "asyncio", {"loop_factory": virtual_clock_loop}


@pytest.mark.anyio
async def test_armed_and_disarmed_at_once_is_disarmed(rig: Rig, ground: Ground) -> None:
    ground.command(MavCommand.COMPONENT_ARM_DISARM, 1)
    ground.command(MavCommand.COMPONENT_ARM_DISARM, 0)
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
    assert await ground.set_mode(Mode.OFFBOARD) is MavResult.ACCEPTED
    for step in range(120):
        north()
        await anyio.sleep(0.05)
        if step == 40:
            await rig.agent.stop()
    assert rig.speed < 0.1
    assert ground.mode is Mode.HOLD
    await rig.until(lambda: "STOP was pressed" in ground.texts)


@pytest.mark.parametrize(
    ("running", "phase"),
    [
        (FlightSource.NOTHING, VehiclePhase.ARMED),
        (FlightSource.STREAM, VehiclePhase.ARMED),  # by setpoints it may have landed
        (FlightSource.TAKE_OFF, VehiclePhase.AIRBORNE),
        (FlightSource.MISSION, VehiclePhase.AIRBORNE),
    ],
)
def test_on_the_ground_what_was_ordered_counts_as_flown_and_a_stream_does_not(
    running: FlightSource, phase: VehiclePhase
) -> None:
    world = cast(Any, SimpleNamespace(phase=VehiclePhase.ARMED))
    manager = FlightModeManager(world, lambda *_: None, {})
    manager.running = running
    assert manager.phase is phase
