"""One aircraft, shared by many fronts, one of which may move it.

The agent opens the aircraft and opens it again when the link was lost. A front that wants to move
it shows a lease; movement that nobody renews expires, and when the lease ends the aircraft hovers
and control authority goes back.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, Self
from warnings import warn

from m100link.aircraft import Aircraft
from m100link.apps.agent import orders
from m100link.apps.agent.background import TaskSet, call_each, goes_on, ignore
from m100link.apps.agent.lease import Flown, Lease, LeaseChange, LeaseManager, TakeOver
from m100link.apps.agent.messages import EventTopic, Journal, PlanChanged
from m100link.apps.agent.orders import ORDERS, SETPOINT_LIFETIME, AfterStop, Needs, Order
from m100link.apps.agent.server.authority import (
    ActivationManager,
    AuthorityManager,
    HoldingInput,
    HoldingState,
    Owed,
)
from m100link.apps.agent.server.connection import AircraftConnection, Connect
from m100link.apps.agent.server.flight import ActiveFlight, pattern
from m100link.apps.agent.server.replays import Replays, refused
from m100link.errors import AuthorityLost, GuardRefused, M100Error, UsageError
from m100link.flight.guards import Envelope, Guards, SuspendWatch
from m100link.flight.missions.hotpoint import HotpointFlight
from m100link.flight.missions.waypoint import WaypointFlight
from m100link.protocol.commands.activation import Credentials
from m100link.protocol.commands.control import Task
from m100link.protocol.commands.gimbal import GimbalAngleMode
from m100link.protocol.setpoint import Setpoint

_LEASE_CHECK = 0.1
# Seconds between two looks at the lease; in a longer time this program did not run, and nobody
# could renew.
_LONGEST_STEP = 0.3

_LOST_MEANWHILE, _STOPPED = "control was lost meanwhile", "STOP was pressed"
_HOVERED = "a hover was ordered"
_SUSPENDED = "the computer of the agent was suspended"
_LEAVES_S = 0.05  # in which the stop of a mission has left, before anybody hears of a STOP
_PAUSE_S = 1.0  # without a setpoint or order; the next is meant anew, though not after STOP

_LOST = (LeaseChange.EXPIRED, LeaseChange.FRONT_LOST)
"""How a lease ends when nobody wanted it to."""


class Agent:
    """The aircraft, the right to steer it, and its orders.

    Args:
        connect: Opens the aircraft.
        credentials: For activation; without them the aircraft can only be watched.
        lease_lifetime: Seconds that a lease lasts without renewal.
        leases_before: Number of the last lease that an earlier agent may have granted; above 0 the
            agent gives back the authority that one may have held, once the aircraft answers.
        envelope: How far the holder of the lease may fly; that of every control block by default.
        replay: The recording that stands in the place of an aircraft; nobody gets a lease.
    """

    def __init__(
        self,
        connect: Connect,
        *,
        credentials: Credentials | None = None,
        lease_lifetime: float = 3.0,
        leases_before: int = 0,
        envelope: Envelope | None = None,
        replay: Replays | None = None,
    ) -> None:
        self._clock = asyncio.get_running_loop().time
        self.replay = replay  #: as given
        self.journal = Journal(self._clock)  #: its events
        self.background = TaskSet()  #: tasks that end with the agent
        self.connection = AircraftConnection(connect, self.journal)  #: the line to the aircraft
        #: How the aircraft was activated.
        self.activation = ActivationManager(credentials, self.journal)
        #: The right to steer.
        self.leases = LeaseManager(
            lifetime=lease_lifetime,
            longest_step=_LONGEST_STEP,
            leases_before=leases_before,
            on_change=self._lease_changed,
        )
        guards = Guards(envelope=envelope or Envelope())
        #: Control authority, and the flights under it.
        self.holding = AuthorityManager(self.journal, self.background, guards)
        if leases_before > 0:
            self.holding.orphaned.owed = Owed.AT_ONCE
        # Why no stream of setpoints flies on, and no order that moves: their sender has to begin
        # anew. Empty: it may. And when it last wanted any of them.
        self._begin_anew, self._wanted_at = "", -math.inf
        self.steered_at = -math.inf  #: when the newest setpoint of a front was decided, s
        self._stopped_at = -math.inf  # when STOP came last, s
        # The same, or when a client without the lease ordered a hover, and which of both.
        self._overtaken = -math.inf, _STOPPED
        self._suspended = SuspendWatch()
        self.holding.on_lost.append(self._authority_lost)
        #: Called after each change with the reason, the lease in force, or None, and what was
        #: flown for the one before.
        self.on_lease: list[Callable[[LeaseChange, Lease | None, Flown], None]] = []
        self.plan = PlanChanged()  #: the plan that waits to be started under the lease, or flies
        self.on_plan: list[
            Callable[[PlanChanged], None]
        ] = []  #: called with each, and when it is void
        self.connection.on_aircraft.append(self._aircraft_changed)

    @property
    def now(self) -> float:
        """Time on the event loop's clock, s."""
        return self._clock()

    async def __aenter__(self) -> Self:
        self.background.spawn(self.connection.keep(), "connection")
        self.background.spawn(self._watch_lease(), "lease")
        self.background.spawn(self._look_for_suspends(), "suspends")
        return self

    async def __aexit__(self, *_: object) -> None:
        try:
            await self.give_back()  # first: the tasks that end next keep the line
        finally:
            await self.background.end()

    async def _look_for_suspends(self) -> None:
        while True:
            self._suspended.void_until(self.now)
            await asyncio.sleep(1.0)

    def _aircraft_changed(self, aircraft: Aircraft | None) -> None:
        if aircraft is not None and self.replay is not None:
            return
        version = self.connection.version
        if aircraft is None or version is None:
            self.holding.orphaned.connected(None, is_activated=False)
            return
        if version.is_activated:
            self.activation.adopt(aircraft)
        self.holding.orphaned.connected(aircraft, is_activated=version.is_activated)
        self._look_after_authority()

    # -- the lease -------------------------------------------------------------------------------

    async def _watch_lease(self) -> None:
        while True:
            await asyncio.sleep(_LEASE_CHECK)
            with goes_on("the watch of the lease"):
                self._look_after_authority()

    def _look_after_authority(self) -> None:
        has_holder = self.leases.holder(self.now) is not None
        if not has_holder:
            self.holding.let_go()  # again, in case the end of the lease failed half-way
        self.holding.look(has_holder=has_holder)

    def _lease_changed(self, why: LeaseChange, old: Lease | None, new: Lease | None) -> None:
        flown = self.holding.flown
        call_each(
            (
                lambda: self.hover("control changed hands"),  # before anybody hears of it
                lambda: self._hand_on(new),
                *(partial(callback, why, new, flown) for callback in self.on_lease),
                lambda: self.upload(PlanChanged()),  # nobody flies what somebody else left
            )
        )
        if new is not None:
            whom = f" from {old.name}" if old is not None else ""
            self.journal.note(f"{new.name} has control ({why.value}{whom})")
        elif old is not None:
            level = "warning" if why in _LOST else "info"
            how = "lost control" if why in _LOST else "gave control back"
            self.journal.note(f"{old.name} {how} ({why.value})", level)

    def _hand_on(self, new: Lease | None) -> None:
        self._begin_anew = "" if new is not None else self._begin_anew
        # By a take-over what is held stays held, and a request ends.
        self.holding.feed(HoldingInput.LET_GO if new is None else HoldingInput.TAKEN_OVER)

    # -- orders ----------------------------------------------------------------------------------

    async def ask(
        self, order: Order, token: str = "", accepted: Callable[[], None] = ignore
    ) -> Answer:
        """Do what an order asks for; ``accepted`` is called when the aircraft has begun.

        Returns the answer, where the order has one.

        Raises:
            LeaseRefused: It needs the lease, and the token is not in force.
            M100Error: The aircraft, a guard or the order itself refuses it. Nothing was sent, or
                the error says that it was.
        """
        doing = self.begin(order, token, accepted)
        answer: Answer = doing if order.is_at_once else await doing
        return answer

    def begin(
        self, order: Order, token: str, accepted: Callable[[], None], at: float = math.inf
    ) -> Any:
        """Begin as :meth:`ask`: returns the answer of what is done at once, else what to await.

        ``at``: when it was asked, s. An order from before a STOP moves nothing, and undoes none.
        """
        # A front or an agent that stood still reads and sends in another order than people acted.
        orders.require_newer(order, at, *self._overtaken)
        orders.require_newer(order, at, self._suspended.void_until(self.now), _SUSPENDED)
        if order.needs is Needs.LEASE_IF_HELD:
            if self.leases.holder(self.now) is not None:
                self.leases.check(token, self.now)
        elif order.needs is not Needs.NOTHING:
            self.leases.renew(token, self.now)
        if order.after_stop is AfterStop.ANEW:
            self._wanted()
            reason = self._begin_anew
            if reason and (reason != _LOST_MEANWHILE or self.holding.has_authority):
                self._require_anew(f"{order.label} that is asked for next is not begun")
            if (flying := self.holding.flying) and flying.only_ends and not order.ends:
                raise _unguarded(order.label)
        if at <= self._stopped_at and isinstance(order, orders.Halt):
            token = ""  # it begins nothing anew
        return HANDLERS[type(order)](OrderContext(self, token, accepted), order)

    def upload(self, plan: PlanChanged) -> None:
        """Keep the plan that may be started under the lease in force, and tell it."""
        if plan != self.plan:
            self.plan = plan
            for callback in self.on_plan:
                callback(plan)

    # -- control authority -----------------------------------------------------------------------

    async def obtain(self, token: str) -> None:
        """Obtain control authority for the holder of the lease.

        Raises:
            LeaseRefused: The token is not in force.
            AuthorityRefused, NotActivated, NoAuthority, LinkError, AckTimeout: See each class.
        """
        aircraft = self.connection.require_aircraft()
        self._begin_anew = ""  # a STOP from now on came after this was asked for
        await self.holding.settle()
        self.leases.check(token, self.now)  # it may have ended while authority went back
        await self.holding.obtain(aircraft)

    async def give_back(self) -> None:
        """Give control authority back; the lease stays."""
        self.hover()
        self.holding.let_go()
        await self.holding.settle()

    # -- flying ----------------------------------------------------------------------------------

    def steer(self, token: str, setpoint: Setpoint, lifetime: float = SETPOINT_LIFETIME) -> None:
        """Fly this setpoint until it is renewed or its lifetime ends. Ends a program.

        Raises:
            LeaseRefused, LinkError: The token is not in force. The aircraft is not connected.
            GuardRefused: Nothing began anew since STOP or a loss of control; or see below.
            NoAuthority, GuardRefused, UsageError: See :meth:`m100link.Control.send`.
        """
        self.leases.renew(token, self.now)
        self._wanted()
        self._require_anew("setpoints that go on are not flown")
        flying, is_held = self.holding.flying, self.holding.state is HoldingState.HELD
        if self.connection.aircraft is None or not (flying and is_held and flying.has_authority):
            self.connection.require_aircraft()  # which says why, if the line is lost
            flying = self.holding.require()
        if flying.only_ends:
            raise _unguarded("a setpoint")
        flying.steer(setpoint, lifetime)

    def _wanted(self) -> None:
        """The holder wants to move it: after a loss, a pause of a second makes that a new wish."""
        # A stream, or an order that a program repeats until it is begun, is none: it would fly on
        # over the hands of a pilot who is back in F.
        now = self.now
        since, self._wanted_at = now - self._wanted_at, now
        is_lost = self._begin_anew == _LOST_MEANWHILE
        if is_lost and since > _PAUSE_S and self.holding.has_authority:
            self._begin_anew = ""

    def _require_anew(self, what: str) -> None:
        if self._begin_anew:
            raise GuardRefused(
                f"{self._begin_anew}; {what}",
                guard="stopped",
                cause="the sender has not begun anew since",
                remedy="look at the aircraft, then ask for control again; at a page, let go of the "
                "keys, or press again",
            )

    def hover(self, why: str = "", token: str = "") -> None:
        """Have it hover; anybody may call this at any time. A task goes on in the autopilot.

        With the token of the lease it says that the holder let go: setpoints and orders fly again
        after STOP.
        """
        if self.holding.flying is not None:
            try:
                self.holding.flying.hover(why)
            except BaseException:
                self.holding.let_go()  # what could not be ended so ends with the control block
                raise
        holder = self.leases.holder(self.now)
        if token and holder is not None and token == holder.token:
            self._begin_anew = ""

    def halt(self, why: str = "", token: str = "") -> None:
        """Old name of :meth:`hover`."""
        warn("Agent.halt is hover now", DeprecationWarning, stacklevel=2)
        self.hover(why, token)

    def ordered_to_hover(self, order: orders.Halt, token: str) -> None:
        """Hover for a client; one without the lease ends the stream of its holder as STOP does."""
        holder = self.leases.holder(self.now)
        if holder is not None and token != holder.token and self._begin_anew != _STOPPED:
            self._overtaken, self._begin_anew = (self.now, _HOVERED), _HOVERED
        self.hover(order.why, token if order.begins_anew else "")

    def _authority_lost(self, _: AuthorityLost) -> None:
        """The pilot or the app has the aircraft: the present stream does not go on afterwards."""
        self._begin_anew = self._begin_anew or _LOST_MEANWHILE

    async def stop(self) -> None:
        """Stop whatever happens: motion, program, and the task that the aircraft flies.

        Setpoints that somebody goes on sending, and orders that move, are refused until the holder
        of the lease lets go (:meth:`hover` under it) or asks for control once more
        (:meth:`obtain`), or somebody else gets the lease.

        No command ends a task: giving control authority back is all that this side can do. It
        ends a mission, too, that does not answer its stop.

        Raises:
            NotObserved: The aircraft may fly on by itself: it does not confirm that it has control
                authority back.
        """
        self._begin_anew = _STOPPED
        try:
            self._stopped_at, self._overtaken = self.now, (self.now, _STOPPED)
            self.leases.void_take_overs()
            flying = self.holding.flying
            landing = flying.mission if flying and flying.mission.is_landing else None
            is_in_task = landing is not None or (flying is not None and flying.is_in_task)
            stopping: list[asyncio.Task[None]] = []
            try:
                if landing is None:
                    self.hover("stop")
                else:
                    # As long as it counts as flown by plan, authority would not be given back.
                    stopping.append(self.background.spawn(landing.let_go(), "stop of a mission"))
                    await asyncio.wait(stopping, timeout=_LEAVES_S)
            finally:  # behind it: a slow listener delays no stop
                self.journal.note("stop", topic=EventTopic.STOPPED)
            if stopping:
                await stopping[0]
                self.hover("stop")
            if flying is not None and not await self._is_rid_of_missions(flying):
                is_in_task = True
        except BaseException:
            self.holding.let_go()  # nobody knows what flies: the end of the control block ends it
            raise
        if is_in_task:
            await self.end_task()
        await self.holding.insist()

    async def end_task(self) -> None:
        """End what the autopilot flies by itself; no command does, so authority goes back."""
        await self.give_back()
        if self.holding.orphaned.owed is Owed.NOTHING:
            self.journal.note("control authority was given back to end the task", "warning")

    async def _is_rid_of_missions(self, flying: ActiveFlight) -> bool:
        """Wait for the stop of any mission; False: the aircraft may fly it on."""
        own, aircraft = flying.mission, self.connection.aircraft
        was_own = own.is_flying
        await own.ended()
        if own.is_flying or aircraft is None or not aircraft.mission.is_running:
            return not own.is_flying
        if was_own:  # it took the stop, and reports that it flies on
            return False
        try:
            await flying.order_mission("stop")  # somebody else's
        except M100Error as error:
            self.journal.note(error.seen, "error")
            return False
        return not own.is_flying


# -- a handler for each order ----------------------------------------------------------------------

Answer = tuple[str, int] | Lease | TakeOver | None
"""The result of an order: a text and a number, a lease, or the token of a take-over."""


def _unguarded(what: str) -> GuardRefused:
    seen = f"no guardian watches this flight; {what} is not flown"
    remedy = "land or go home, and give control back; the journal says what failed"
    return GuardRefused(seen, guard="guardian", remedy=remedy)


class OrderContext(NamedTuple):
    agent: Agent
    token: str  # proof of the lease; empty without one
    accepted: Callable[[], None]  # called when the aircraft has begun

    @property
    def aircraft(self) -> Aircraft:
        """The aircraft. Raises LinkError: it is not connected."""
        return self.agent.connection.require_aircraft()

    @property
    def flying(self) -> ActiveFlight:
        """The present flight. Raises NoAuthority: control authority is not held."""
        return self.agent.holding.require()

    @property
    def leases(self) -> LeaseManager:
        """The manager of leases. Raises OnlyRecorded: nobody gets one of a replay."""
        if self.agent.replay is not None:
            raise refused()
        return self.agent.leases


async def _activate(call: OrderContext, _: orders.Activate) -> None:
    await call.agent.activation.activate(call.aircraft)


async def _version(call: OrderContext, _: orders.AskVersion) -> Answer:
    aircraft = call.aircraft  # LinkError without one; its version was asked at connecting
    version = call.agent.connection.version or await aircraft.version()
    return version.name, version.crc


async def _point_gimbal(call: OrderContext, order: orders.PointGimbal) -> None:
    angles, mode = order.angles, order.angles.mode
    await call.aircraft.gimbal.set_angles(
        yaw=None if mode & GimbalAngleMode.KEEP_YAW else angles.yaw_deg,
        pitch=None if mode & GimbalAngleMode.KEEP_PITCH else angles.pitch_deg,
        roll=None if mode & GimbalAngleMode.KEEP_ROLL else angles.roll_deg,
        seconds=angles.duration_s,
        relative=not mode & GimbalAngleMode.ABSOLUTE,
    )


async def _turn_gimbal(call: OrderContext, order: orders.TurnGimbal) -> None:
    rates = order.rates
    await call.aircraft.gimbal.set_angular_rates(
        yaw=rates.yaw_deg_s, pitch=rates.pitch_deg_s, roll=rates.roll_deg_s
    )


async def _order_replay(call: OrderContext, order: orders.OrderReplay) -> None:
    if call.agent.replay is None:
        raise UsageError("this is not a replay", remedy="m100link replay FILE")
    await call.agent.replay.order(order.text)


async def _fly_pattern(call: OrderContext, order: orders.FlyPattern) -> None:
    call.flying.start_pattern(f"simple task {order.number}", pattern(order.number))


async def _upload_plan(call: OrderContext, order: orders.UploadPlan) -> Answer:
    agent = call.agent
    agent.upload(PlanChanged())  # the one before is void, whatever comes of this one
    try:
        plan = order.plan()
    except ValueError as error:
        raise UsageError(
            f"the upload is no plan that can be flown: {error}",
            cause="the program that uploaded it belongs to another release",
            remedy="install the same release on both sides",
        ) from None
    name = agent.leases.check(call.token, agent.now).name
    agent.journal.note(f"{name} uploaded a plan of {len(plan.waypoints)} waypoints")
    agent.upload(PlanChanged(name, order))
    return order.digest, 0


async def _start_mission(call: OrderContext, order: orders.StartMission) -> None:
    uploaded = call.agent.plan.plan
    if uploaded is None:
        raise UsageError(
            "no plan was uploaded under this lease", remedy="upload it again, then start"
        )
    if order.digest != uploaded.digest:
        raise UsageError(
            "the plan that is to start is not the one on board; nothing was started",
            cause="another one was uploaded since",
            remedy="upload it again, then start",
        )
    begun = call.accepted if order.until_over else None
    await call.flying.start_mission(uploaded.plan(), take_off=order.take_off, begun=begun)


async def _set_speed(call: OrderContext, order: orders.SetMissionSpeed) -> Answer:
    flight = call.flying.mission.flight(WaypointFlight)
    return "", round(await flight.set_speed(order.speed) * 1000)


async def _stop_mission(call: OrderContext, _: orders.StopMission) -> None:
    # No command ends the take-off before it: the aircraft would climb to its 1.2 m all the same.
    # In the air it shall hover, and go on to obey: a landing often comes next.
    stands = call.flying.mission.stands
    try:
        await call.flying.order_mission("stop")
    finally:
        if stands:
            await call.agent.end_task()


def _circle(call: OrderContext) -> HotpointFlight:
    return call.flying.mission.flight(HotpointFlight)


HANDLERS: dict[type[Order], Callable[[OrderContext, Any], Any]] = {
    # A lease of a replay cannot be had, and be given back all the same.
    orders.ReleaseLease: lambda call, one: call.agent.leases.release(one.token, call.agent.now),
    orders.AcquireLease: lambda call, one: call.leases.acquire(one.name, call.agent.now),
    orders.RenewLease: lambda call, one: call.leases.renew(one.token, call.agent.now),
    orders.AskTakeOver: lambda call, one: call.leases.ask_take_over(one.name, call.agent.now),
    orders.ConfirmTakeOver: lambda call, one: call.leases.confirm(one.token, call.agent.now),
    orders.Halt: lambda call, one: call.agent.ordered_to_hover(one, call.token),
    orders.Stop: lambda call, _: call.agent.stop(),
    orders.Activate: _activate,
    orders.AskVersion: _version,
    orders.Obtain: lambda call, _: call.agent.obtain(call.token),
    orders.Release: lambda call, _: call.agent.give_back(),
    orders.TakeOff: lambda call, _: call.flying.fly(Task.TAKE_OFF, call.accepted),
    orders.Land: lambda call, _: call.flying.fly(Task.LAND, call.accepted),
    orders.GoHome: lambda call, _: call.flying.fly(Task.GO_HOME, call.accepted),
    orders.StartMotors: lambda call, _: call.flying.switch_motors(on=True),
    orders.StopMotors: lambda call, _: call.flying.switch_motors(on=False),
    orders.FlyPattern: _fly_pattern,
    **dict.fromkeys(
        orders.GuidedOrder.__args__, lambda call, one: call.flying.guide(one, call.accepted)
    ),
    # Need no authority, but the lease if one is held: its holder looks ahead. Done when sent.
    orders.PointGimbal: _point_gimbal,
    orders.TurnGimbal: _turn_gimbal,
    orders.UseCamera: lambda call, one: getattr(call.aircraft.camera, one.use.value)(),
    orders.SendToMobile: lambda call, one: call.aircraft.send_to_mobile(one.data),
    orders.OrderReplay: _order_replay,
    orders.UploadPlan: _upload_plan,
    orders.StartMission: _start_mission,
    orders.StopMission: _stop_mission,
    orders.PauseMission: lambda call, _: call.flying.order_mission("pause"),
    orders.ResumeMission: lambda call, _: call.flying.order_mission("resume"),
    orders.SetMissionSpeed: _set_speed,
    orders.StartHotpoint: lambda call, one: call.flying.start_hotpoint(one.circle),
    orders.SetHotpointRadius: lambda call, one: _circle(call).set_radius(one.radius, wait=False),
    orders.SetHotpointRate: lambda call, one: _circle(call).set_rate(
        abs(one.rate), clockwise=one.rate > 0, wait=False
    ),
    orders.ResetHotpointHeading: lambda call, _: _circle(call).reset_heading(),
}
"""The handler of each order, by its class; an order that is at once has one that never waits."""

if _without := [name for name, kind in ORDERS.items() if kind not in HANDLERS]:
    raise TypeError(f"no row of HANDLERS in {__name__} for {', '.join(_without)}")
