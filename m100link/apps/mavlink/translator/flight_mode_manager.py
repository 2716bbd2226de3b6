"""Mode requests of ground stations become orders to the agent, one at a time.

The tables of :mod:`m100link.apps.mavlink.translator.vehicle_state` decide about each mode request.
There is no I/O here: :attr:`FlightModeManager.orders` collects orders, the order executor carries
them out and reports how each ended, and the time is an argument.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

from m100link.apps.agent.orders import PauseMission, ResumeMission
from m100link.apps.mavlink.translator.codec import Peer
from m100link.apps.mavlink.translator.numbers import MavResult, Severity
from m100link.apps.mavlink.translator.offboard import Manual, Offboard
from m100link.apps.mavlink.translator.orders import (
    CancelTakeOff,
    Drop,
    FlightSequence,
    HoldPosition,
    LandInPlace,
    MissionCommand,
    ModeRequest,
    ObtainControl,
    PayloadOrder,
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
from m100link.errors import GuardRefused, M100Error, NoAuthority, TaskRefused
from m100link.protocol.setpoint import Setpoint

REMEMBERED_S = 10.0  # seconds that a take-off or mission waits for the aircraft to be armed
IDLE_S = 10.0  # seconds armed on the ground without a take-off after which it is disarmed

_LANDS_WITHIN_M = 20.0
"""Nearer than this to home DJI's autopilots land where they are, by documents of later aircraft."""

_TO_THE_GROUND = (Mode.LAND, Mode.RTL)
_ENDS = (Mode.HOLD, *_TO_THE_GROUND)
_CALLED_OFF = "the take-off is being called off: if it starts all the same, the aircraft lands"
_REFUSED = {ModeVerdict.DENY: MavResult.DENIED, ModeVerdict.REJECT: MavResult.TEMPORARILY_REJECTED}
_TO_BE_ENDED = (FlightSource.LAND, FlightSource.GO_HOME, FlightSource.MISSION, FlightSource.PAUSED)
"""These fly on until the aircraft has heard their end."""
_CONTROLLED = (VehiclePhase.ARMED, VehiclePhase.AIRBORNE)


class FlightModeManager:
    def __init__(
        self,
        world: VehicleState,  # what is known of it
        tell: Callable[[Severity, str], None],  # takes what people have to know: severity and text
        streams: Mapping[Mode, Offboard | Manual],  # where setpoints come from, by mode
    ) -> None:
        self._world = world
        self._tell = tell
        self._streams = streams
        # Orders for the executor, oldest first.
        self.orders: list[VehicleOrder | Setpoint | MissionCommand | PayloadOrder | Drop] = []
        # The peer that armed the aircraft, or moved it first after that one was lost.
        self.operator: Peer | None = None
        self.steering: Peer | None = None  # whose setpoints came last
        self.running = FlightSource.NOTHING
        # The request for authority that is wanted, and has no answer yet.
        self._arming: ObtainControl | None = None
        # Called with whether and why not, when a request for authority has ended.
        self.on_armed: Callable[[M100Error | None], None] = lambda _: None
        # The mode requested last, while it is in force.
        self._mode = Mode.HOLD
        # The order under way; what ends later than the one that replaced it means nothing.
        self._current: VehicleOrder | None = None
        # The order that still has to end a flight, and the mode that is shown until then.
        self._making_way: tuple[VehicleOrder | None, Mode] = None, Mode.HOLD
        # Begins when the autopilot's take-off is over.
        self._waiting: ModeRequest | None = None
        # Begins when the aircraft is armed, until a time.
        self._remembered: tuple[ModeRequest, float] | None = None
        self._idle_since: float | None = None

    # -- where it stands -------------------------------------------------------------------------

    @property
    def phase(self) -> VehiclePhase:
        """Where the flight stands; a take-off that was ordered counts as flown."""
        phase = self._world.phase
        if phase is VehiclePhase.ARMED and isinstance(
            self._current, ReleaseControl | CancelTakeOff
        ):
            return VehiclePhase.DISARMED  # it was requested, and holds before it is carried out
        is_flying = self.running not in (FlightSource.NOTHING, FlightSource.STREAM)
        return VehiclePhase.AIRBORNE if phase is VehiclePhase.ARMED and is_flying else phase

    @property
    def mode(self) -> Mode:
        phase = self.phase
        if phase is VehiclePhase.AIRBORNE and self._is_flown_by_a_stranger:
            return Mode.MISSION
        if phase in _CONTROLLED or self._is_interrupting:
            shown = self._mode_flown
            return Mode.HOLD if shown is Mode.GOTO else shown
        if self._remembered is not None and phase in (VehiclePhase.DISARMED, VehiclePhase.FREE):
            return self._remembered[0].mode
        return self._world.mode_of_others()

    @property
    def _mode_flown(self) -> Mode:
        """The mode requested last, or the one that still flies: its end was not heard yet."""
        order, flown = self._making_way
        return self._mode if order is None or order is not self._current else flown

    def way_made(self) -> None:
        """The flight before the current order has ended."""
        self._making_way = None, Mode.HOLD

    @property
    def flight(self) -> FlightSequence | None:
        """The flight under way, if what is under way is one."""
        return self._current if isinstance(self._current, FlightSequence) else None

    @property
    def is_flown_by_aircraft(self) -> bool:
        """Whether the aircraft has a mission that it flies by itself, or has paused, for us."""
        return self.running in (FlightSource.MISSION, FlightSource.PAUSED)

    @property
    def _is_flown_by_a_stranger(self) -> bool:
        """Whether it tells of a mission where nothing of ours flies: a stop was not heard, say."""
        return self.running is FlightSource.NOTHING and self._world.flies_mission

    @property
    def _is_interrupting(self) -> bool:
        order = self._current
        is_ending = (
            isinstance(order, LandInPlace | ReturnToLaunch | HoldPosition) and order.is_interrupting
        )
        return is_ending or isinstance(order, CancelTakeOff)

    @property
    def _can_be_called_off(self) -> bool:
        """Whether a take-off was ordered, and the motors stand as far as anybody knows."""
        return self.running is FlightSource.TAKE_OFF and self._world.phase is VehiclePhase.ARMED

    def explain(self) -> str:
        return self._world.explain(self.phase)

    # -- mode requests ---------------------------------------------------------------------------

    def request_mode(self, request: ModeRequest, now: float) -> MavResult:
        """Somebody wants a mode. Everybody hears refusals, with the reason."""
        what, verdict = request.mode.value, VERDICTS[self.phase][request.mode]
        if request.mode not in _ENDS and self.is_others(request.peer, what):
            return MavResult.TEMPORARILY_REJECTED
        if verdict in _REFUSED:
            return self._refuse(what, self.explain(), _REFUSED[verdict])
        if verdict is ModeVerdict.NOTHING:
            self._settle()
        elif verdict is ModeVerdict.START:
            return self._start(request, now)
        elif isinstance(self._current, CancelTakeOff) and verdict is ModeVerdict.OBTAIN:
            if request.mode is not Mode.LAND:  # which is what comes of it
                return self._refuse(what, _CALLED_OFF)
        else:
            self._remembered = request, now + REMEMBERED_S
            self._take_operator(request.peer)
            if verdict is ModeVerdict.OBTAIN:
                self._arm(request.peer)
        return MavResult.ACCEPTED

    def _refuse(
        self, what: str, why: str, result: MavResult = MavResult.TEMPORARILY_REJECTED
    ) -> MavResult:
        self._tell(Severity.WARNING, f"{what}: {why}")
        return result

    def is_others(self, peer: Peer | None, what: str) -> bool:
        """Whether another one flies than the one that asks; everybody hears it."""
        other = self.other_operator(peer)
        if other is not None:
            self._refuse(what, f"{other.name} flies")
        return other is not None

    def other_operator(self, peer: Peer | None) -> Peer | None:
        """The peer that flies, if another one asks; None asks for the bridge itself."""
        is_taken = self._arming is not None or self.phase in _CONTROLLED
        return self.operator if is_taken and peer not in (None, self.operator) else None

    def _take_operator(self, peer: Peer | None) -> None:
        if peer is not None and (self.operator is None or self.other_operator(peer) is None):
            self.operator = peer

    def _settle(self) -> None:
        """Nothing is wanted on the ground."""
        self._remembered = self._waiting = None
        if self.running is FlightSource.STREAM:
            self.running = FlightSource.NOTHING
        self._mode = Mode.HOLD

    def _call_off(self, mode: Mode, why: str) -> None:
        """A landing asked for on the ground does not take off first."""
        self._settle()
        self._mode, self.operator = mode, None
        self._current, self.running = CancelTakeOff(), FlightSource.NOTHING
        self.orders.append(self._current)
        self._tell(Severity.WARNING, f"the take-off is called off: {why}")

    def _start(self, request: ModeRequest, now: float) -> MavResult:
        if request.mode in _TO_THE_GROUND and self._can_be_called_off:
            self._call_off(request.mode, f"{request.mode.value} was requested")
            return MavResult.ACCEPTED
        step = RUNNING[self.running][request.mode]
        is_later = step is ModeTransition.WAIT and request.mode not in _TO_THE_GROUND
        if is_later and self._waiting is not None and self._waiting.mode in _TO_THE_GROUND:
            step = ModeTransition.REFUSE
        if step is ModeTransition.REFUSE:
            return self._refuse(request.mode.value, f"{self._mode.value} goes on")
        self._take_operator(request.peer)
        if step is ModeTransition.WAIT:
            self._waiting, self._mode = request, request.mode
            self._tell(Severity.NOTICE, f"{request.mode.value}: when the take-off is over")
        elif step is ModeTransition.INTERRUPT and isinstance(
            request.order, LandInPlace | ReturnToLaunch | HoldPosition
        ):
            self._begin(replace(request, order=replace(request.order, is_interrupting=True)))
        elif step is ModeTransition.PAUSE and self.flight is not None:
            self._making_way = self.flight, self._mode
            self._mode, self.running = request.mode, FlightSource.PAUSED
            self.orders.append(MissionCommand(PauseMission(), self.flight))
        elif step is ModeTransition.RESUME and self.flight is not None and not request.is_anew:
            self._mode, self.running = request.mode, FlightSource.MISSION
            self.orders.append(MissionCommand(ResumeMission(), self.flight))
        elif step is not ModeTransition.KEEP or request.is_anew:
            self._begin(request)
        return MavResult.ACCEPTED

    def _begin(self, request: ModeRequest) -> None:
        flown = self._mode_flown
        self._waiting, self._mode, self._idle_since = None, request.mode, None
        order = request.order
        if self.running in _TO_BE_ENDED:
            self._making_way = order, flown
        if order is None:
            # A mission of a lost client ignores setpoints, too.
            flies = self.running is FlightSource.FLIGHT or self.is_flown_by_aircraft
            if flies or self._is_flown_by_a_stranger:
                self.orders.append(HoldPosition(why=f"{request.mode.value} was requested"))
            self._current, self.running = None, FlightSource.STREAM
            return
        self._current, self.running = order, order.running
        if isinstance(order, FlightSequence):
            if order.takes_off:
                self.running = FlightSource.TAKE_OFF
            if order.why:
                self._tell(Severity.NOTICE, f"mission: flown from here, {order.why}")
        if isinstance(order, ReturnToLaunch):
            self._tell_return()
        self.orders.append(order)

    def _tell_return(self) -> None:
        """Near home DJI's autopilot does not fly there: people stand where it comes down."""
        place = self._world.local
        if place is not None and (away := math.hypot(*place[:2])) < _LANDS_WITHIN_M:
            near = f"{Mode.RTL.value}: home is {away:.0f} m away"
            self._tell(Severity.WARNING, f"{near}: within {_LANDS_WITHIN_M:g} m it lands in place")

    # -- arming ----------------------------------------------------------------------------------

    def arm(self, peer: Peer, now: float) -> MavResult | None:
        """Obtain authority; None while that takes time, and :attr:`on_armed` is called then."""
        if self.is_others(peer, "arm"):
            return MavResult.TEMPORARILY_REJECTED
        verdict = ARM_VERDICTS[self.phase]
        if verdict is ModeVerdict.REJECT:
            return self._refuse("arm", self.explain())
        if verdict is ModeVerdict.START and isinstance(self._current, CancelTakeOff):
            return self._refuse("arm", _CALLED_OFF)
        self._take_operator(peer)
        if verdict is ModeVerdict.NOTHING:
            return MavResult.ACCEPTED
        self._arm(peer)
        return None

    def _arm(self, peer: Peer | None) -> None:
        if self._arming is None:
            self._arming = ObtainControl(peer.name if peer is not None else "MAVLink")
            self._idle_since = None
            self.orders.append(self._arming)

    def disarm(self, peer: Peer) -> MavResult:
        if self.is_others(peer, "disarm"):
            return MavResult.TEMPORARILY_REJECTED
        # An ordered take-off counts as flown for all other requests. For this one it does not: a
        # person may stand beside motors that do not turn yet.
        verdict = DISARM_VERDICTS[self._world.phase]
        if verdict is ModeVerdict.REJECT:
            return self._refuse("disarm", self.explain())
        if verdict is ModeVerdict.DENY:
            why = "not in the air, the M100 cannot stop motors there"
            return self._refuse("disarm", why, MavResult.DENIED)
        if isinstance(self._current, CancelTakeOff):
            # It gives control back, and looks whether the aircraft stays on the ground.
            self._settle()
        elif self._can_be_called_off:
            self._call_off(Mode.HOLD, "disarmed")
        elif verdict is ModeVerdict.START or self._arming is not None:
            self._disarm()
        return MavResult.ACCEPTED

    def _disarm(self) -> None:
        self._settle()
        self._arming = None
        self._current, self.running, self.operator = ReleaseControl(), FlightSource.NOTHING, None
        self.orders.append(self._current)

    # -- reports of the executor ---------------------------------------------------------------

    def armed(self, order: ObtainControl, error: M100Error | None, now: float) -> None:
        """A request for authority has ended."""
        wanted, self._arming = self._arming, None
        if wanted is None:
            error = NoAuthority("disarmed before arming was complete", remedy="arm again")
        elif wanted is not order:
            self._arming = wanted  # it was armed again meanwhile, which answers both
            return
        remembered, self._remembered = self._remembered, None
        if error is not None:
            self._tell(Severity.ERROR, f"arm: {error.seen}")
            self.operator = None
        else:
            self._mode, self._current, self.running = Mode.HOLD, None, FlightSource.NOTHING
            if remembered is not None and now < remembered[1]:
                self.request_mode(remembered[0], now)
            elif self._world.flies_mission and self.phase is VehiclePhase.AIRBORNE:
                self.hold("hold: the mission that flew at arming is stopped")
        self.on_armed(error)

    def took_off(self, order: VehicleOrder, now: float) -> None:
        """The autopilot's take-off is over; the rest of the order can be replaced."""
        if order is self._current and self.running is FlightSource.TAKE_OFF:
            self.running = FlightSource.FLIGHT
            if self._waiting is not None:
                self._begin(self._waiting)

    def mission_begun(self, flight: FlightSequence) -> bool:
        """The aircraft flies the mission of a flight; False where nobody wants that any more."""
        if flight is not self._current or self.running is not FlightSource.FLIGHT:
            return False
        self.running = FlightSource.MISSION
        return True

    def mission_flown(self, flight: FlightSequence) -> None:
        """The aircraft was at the last place of the mission, and goes home or lands by its plan."""
        if flight is not self._current or not self.is_flown_by_aircraft or flight.then is None:
            return
        is_paused = self.running is FlightSource.PAUSED
        self.running = flight.then.running
        self.way_made()
        self._mode = Mode.LAND if isinstance(flight.then, LandInPlace) else Mode.RTL
        if self._mode is Mode.RTL:
            self._tell_return()
        if is_paused:  # it was there before the pause: what it flies now knows none
            self.interrupt("hold: the mission is over")

    def ended(self, order: VehicleOrder, error: M100Error | None, now: float) -> None:
        """An order has ended; what was replaced meanwhile means nothing."""
        if order is not self._current:
            if (
                error is not None
                and isinstance(order, HoldPosition)
                and self.running is FlightSource.STREAM
            ):
                self.hold(f"hold: {error.seen}")  # a mission that may fly on ignores setpoints
            return
        if error is not None:
            self._tell(Severity.ERROR, f"{self._mode.value}: {error.seen}")
        is_refused = isinstance(error, TaskRefused) and self.phase is VehiclePhase.AIRBORNE
        if (
            is_refused
            and isinstance(order, LandInPlace | ReturnToLaunch)
            and not order.is_interrupting
        ):
            # Something flies that nobody here knows of: the end of a mission, say.
            self._begin(ModeRequest(self._mode, replace(order, is_interrupting=True)))
            return
        waiting, self._waiting = self._waiting, None
        self._current, self.running, self._idle_since = None, FlightSource.NOTHING, None
        self._mode = Mode.HOLD
        lands = (
            isinstance(order, FlightSequence) and order.plan is not None and order.then is not None
        )
        if error is None and (lands or isinstance(order, LandInPlace | ReturnToLaunch)):
            self._disarm()
        elif waiting is None and error is None and isinstance(order, FlightSequence) and order.then:
            mode = Mode.LAND if isinstance(order.then, LandInPlace) else Mode.RTL
            self._begin(ModeRequest(mode, order.then))
        elif waiting is not None and self._world.phase is VehiclePhase.AIRBORNE:
            self._begin(waiting)

    # -- time passes -----------------------------------------------------------------------------

    def advance(self, now: float) -> None:
        """Look at what has changed by itself, and steer."""
        phase = self.phase
        if self._remembered is not None and now >= self._remembered[1]:
            self._tell(Severity.NOTICE, f"{self._remembered[0].mode.value}: not armed in time")
            self._remembered = None
        if phase in _CONTROLLED:
            if self.running is FlightSource.STREAM:
                self._stream(phase, now)
            self._look_idle(phase, now)
        elif not (self._is_interrupting or self._arming is not None):
            self._forget()
            if phase in (VehiclePhase.DISARMED, VehiclePhase.OTHER) and self._remembered is None:
                self.operator = None
            is_disarming = isinstance(self._current, ReleaseControl)
            if (
                phase is VehiclePhase.DISARMED
                and self._world.session.has_lease
                and not is_disarming
            ):
                self._disarm()

    def _forget(self) -> None:
        """Forget requests from before control was lost: another client flies now."""
        self._waiting, self._mode, self.running = None, Mode.HOLD, FlightSource.NOTHING
        if self._current is not None and not isinstance(self._current, ReleaseControl):
            self._current = None
            self.orders.append(Drop())

    def stopped(self, why: str) -> None:
        """Somebody else had it hover: nothing of a flight comes after it.

        A landing or a way home goes on; STOP ends them by giving control back.
        """
        self._remembered = None  # nor at the next arming
        if self.running not in (FlightSource.NOTHING, FlightSource.LAND, FlightSource.GO_HOME):
            self.hold(f"{self._mode.value}: {why}", follows_stop=True)

    def _look_idle(self, phase: VehiclePhase, now: float) -> None:
        if phase is VehiclePhase.AIRBORNE or self.running is FlightSource.STREAM:
            self._idle_since = None
        elif self._idle_since is None:
            self._idle_since = now
        elif now - self._idle_since >= IDLE_S and not isinstance(self._current, ReleaseControl):
            self._disarm()
            self._tell(Severity.NOTICE, f"disarmed: no take-off in {IDLE_S:g} s")

    def _stream(self, phase: VehiclePhase, now: float) -> None:
        stream = self._streams[self._mode]
        try:
            # Nobody is flown by setpoints that another one sent before.
            setpoint = stream.setpoint(now) if self.steering == self.operator else None
        except M100Error as error:
            self.hold(f"{self._mode.value}: {error.seen}")
            return
        if setpoint is None:
            self.hold(f"{self._mode.value}: setpoints stopped")
        elif phase is VehiclePhase.AIRBORNE:
            self.orders.append(setpoint)
        elif stream.wants_up(now):
            # Motors stand still: the aircraft ignores movement until an order to take off.
            request = ModeRequest(self._mode, None)
            self._begin(ModeRequest(self._mode, TakeOffAndClimb()))
            self._waiting = request

    def has_setpoint(self, mode: Mode, peer: Peer, now: float) -> bool:
        return self.steering == peer and self._streams[mode].is_fresh(now)

    def interrupt(self, why: str) -> None:
        """Hover, whatever the aircraft flies by itself: authority goes back, which ends it."""
        self._begin(ModeRequest(Mode.HOLD, HoldPosition(is_interrupting=True, why=why)))
        self._tell(Severity.WARNING, why)

    def hold(self, why: str, *, follows_stop: bool = False) -> None:
        """The bridge itself wants a hover, and says why."""
        hold = ModeRequest(Mode.HOLD, HoldPosition(why=why, follows_stop=follows_stop))
        if self.phase is VehiclePhase.ARMED:
            self._settle()
        elif self.running is FlightSource.TAKE_OFF:
            self._waiting, self._mode = hold, Mode.HOLD
        else:
            self._begin(hold)
        self._tell(Severity.WARNING, why)

    @property
    def flies_mission(self) -> bool:
        return self._mode is Mode.MISSION and self.phase is VehiclePhase.AIRBORNE

    def steer_refused(self, error: M100Error) -> None:
        """The agent did not fly a setpoint: what the guards refuse ends with its reason.

        After a STOP of somebody else the stream is over; it begins anew with its mode.
        """
        if self.running is not FlightSource.STREAM:
            return
        if isinstance(error, GuardRefused) and error.guard != "stopped":
            self._tell(Severity.WARNING, f"{self._mode.value}: {error.seen}")
        else:
            is_stop = isinstance(error, GuardRefused)
            self.hold(f"{self._mode.value}: {error.seen}", follows_stop=is_stop)

    def operator_lost(self) -> None:
        """The peer that flew is silent: hover, unless the aircraft is landing."""
        lost, self.operator = self.operator, None
        if self._remembered is not None and self._remembered[0].mode not in _TO_THE_GROUND:
            self._remembered = None
        phase = self.phase
        if lost is None:
            return
        if self._can_be_called_off:
            self._call_off(Mode.HOLD, f"{lost.name} is lost")
        elif phase is VehiclePhase.ARMED or (
            phase is VehiclePhase.DISARMED and self._arming is not None
        ):
            self._disarm()
            self._tell(Severity.WARNING, f"{lost.name} is lost: disarmed")
        elif phase is VehiclePhase.AIRBORNE and self.running not in (
            FlightSource.LAND,
            FlightSource.GO_HOME,
        ):
            is_down = self._waiting is not None and self._waiting.mode in _TO_THE_GROUND
            if not is_down:
                self.hold(f"{lost.name} is lost: hold")
