"""A front's end of an agent: the newest values, the view of them, and the orders that it can give.

Everything here is true as of the newest message. The agent decides again when an order arrives: it
refuses one whose lease has ended meanwhile, or whose authority was lost.
"""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import partial
from typing import Any, Self, TypeVar
from warnings import warn

from m100link.apps.agent import messages, orders
from m100link.apps.agent.background import TaskSet, call_each
from m100link.apps.agent.lease import Lease, TakeOver, not_in_force
from m100link.apps.agent.orders import SETPOINT_LIFETIME
from m100link.apps.agent.transports import Channel
from m100link.errors import AuthorityLost, BadPlan, LayoutMismatch, M100Error, NotObserved
from m100link.link.link import require_loop
from m100link.missions.plan import WaypointPlan
from m100link.protocol.codes import ActivationCode
from m100link.protocol.firmware import PROFILES
from m100link.protocol.records import FlightPhase, FlightStatus, Position, RcMode, RemoteControl
from m100link.protocol.setpoint import Setpoint
from m100link.telemetry.integrity import GOOD_GPS, Integrity, IntegrityState
from m100link.telemetry.sample import Sample
from m100link.telemetry.state import FRESH_S, STEER_S, AircraftState, is_possible
from m100link.telemetry.subscription import Hub, Policy, Subscription

# -- the view of the aircraft that a front may believe at one moment: an old item is unknown -------
# A front takes :attr:`AgentClient.view` where a step begins, and asks it alone. Silence of the
# agent, an agent that is gone and values that are old are decided here and nowhere else. How old an
# item may be stands in :data:`~m100link.telemetry.state.FRESH_S`, for the agent's guards as well.
# Unknown is None, never an old number.


R = TypeVar("R", bound=tuple[Any, ...])
T = TypeVar("T")

# Seconds without a word after which the agent counts as silent; it tells its state at 4 Hz.
MAX_SILENCE = 2.0
# Seconds for which an aircraft is heard that tells anything once a second.
HEARD_S = 1.2
# Seconds for which an item of another package belongs to this one.
TOGETHER_S = 0.3
# Seconds that a view is of one moment, if nothing arrives: no step of a front is shorter.
MOMENT_S = 0.005

_NOT_ASKED: Any = object()

PRESSED_AT: ContextVar[float] = ContextVar("pressed_at", default=math.inf)
"""When a person pressed what the present task carries out, s by the clock of its event loop."""


class Hearing(Enum):
    """How a front hears the agent that owns the aircraft."""

    HEARD = "heard"
    SILENT = "silent"  # for more than 2 s; it may hang, and may speak again
    GONE = "gone"  # for good


@dataclass(frozen=True, slots=True)
class VehicleView:
    """One aircraft, as it may be believed to be at one moment; it does not change afterwards."""

    at: float  # the moment on the clock of the front, s
    heard_at: float  # when anything of the agent was heard last, by the same clock, s
    is_gone: bool  # whether the agent has gone
    state: messages.State  # where the agent stands, as it reported last
    holder: messages.LeaseChanged  # the holder of the lease, as reported last
    # Every arrival, however old: for statistics, and for previews of refusals. None while no
    # aircraft is connected.
    telemetry: AircraftState | None
    now: float = field(init=False)  # the moment on the clock of telemetry, s: a replay's own
    hearing: Hearing = field(init=False)
    is_connected: bool = field(init=False)  # the aircraft, by an agent that is heard
    has_authority: bool = field(init=False)  # whether setpoints and tasks are obeyed, by the same
    is_heard: bool = field(init=False)  # whether any telemetry is younger than a second or so
    _known: dict[Any, Any] = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        say, state = partial(object.__setattr__, self), self.state
        replay, telemetry = state.replay, self.telemetry
        # A time that is none, and one that is to come, is no word of anybody.
        is_there = not self.is_gone and abs(self.at - self.heard_at) <= MAX_SILENCE
        is_connected = is_there and state.connection == "connected"
        newest_at = None if telemetry is None else telemetry.newest_at
        now = self.at if replay is None else replay.time(newest_at)
        say("now", now)
        heard = Hearing.HEARD if is_there else Hearing.SILENT
        say("hearing", Hearing.GONE if self.is_gone else heard)
        say("is_connected", is_connected)
        say("has_authority", is_there and state.has_authority)
        is_new = newest_at is not None and abs(now - newest_at) <= HEARD_S
        say("is_heard", is_connected and is_new)
        say("_known", {})

    @property
    def connection(self) -> str:
        """As the agent reported it, or ``"silent"`` while the agent may hang."""
        return "silent" if self.hearing is Hearing.SILENT else self.state.connection

    # -- its items -------------------------------------------------------------------------------

    def get(self, record: type[R]) -> R | None:
        """The newest value of an item; None when it is old, impossible, or the agent is silent."""
        known: R | None = self._known.get(record, _NOT_ASKED)
        if known is _NOT_ASKED:
            known = self._known[record] = self._within(record, FRESH_S[record])
        return known

    def to_steer_by(self, record: type[R]) -> R | None:
        """The same where a loop is closed over it: none that is older than half a second."""
        return self._within(record, STEER_S)

    def together(self, record: type[R]) -> R | None:
        """The same where it is shown together with another item that has just arrived."""
        return self._within(record, TOGETHER_S)

    def _within(self, record: type[R], seconds: float) -> R | None:
        if self.telemetry is None or not self.is_connected:
            return None
        found = self.telemetry.fresh(record, within=seconds, now=self.now)
        return found if found is not None and is_possible(found) else None

    def age(self, record: type[Any]) -> float | None:
        """Seconds since an item arrived, None when it never did."""
        at = None if self.telemetry is None else self.telemetry.received_at(record)
        return None if at is None else self.now - at

    def is_new(self, record: type[Any]) -> bool:
        """Whether an item arrives, whatever it says."""
        age = self.age(record)
        return self.is_connected and age is not None and abs(age) <= FRESH_S[record]

    def rate_hz(self, record: type[Any]) -> float:
        """How often an item arrives, per second; 0 where it does not any more."""
        age = self.age(record)
        if self.telemetry is None or age is None or not abs(age) <= HEARD_S:
            return 0.0
        return self.telemetry.statistics(record).rate_hz or 0.0

    @property
    def telemetry_at(self) -> float | None:
        """When any telemetry arrived, by the clock of telemetry, s; None when none ever did."""
        return None if self.telemetry is None else self.telemetry.newest_at

    @property
    def integrity(self) -> Integrity:
        """Whether the reported navigation can be true."""
        if self.telemetry is None:
            return Integrity(IntegrityState.UNKNOWN)
        return self.telemetry.integrity

    @property
    def phase(self) -> FlightPhase | None:
        """On the ground or in the air, as it may be believed; None when nobody knows."""
        status = self.status
        return None if status is None else status.phase

    @property
    def status(self) -> FlightStatus | None:
        """The one that is believed: standing counts after several statuses in a row."""
        if self.telemetry is None or self.get(FlightStatus) is None:
            return None
        return self.telemetry.believed_status

    @property
    def is_on_ground(self) -> bool | None:
        """Whether the motors stand; None when nobody knows, which counts as in the air."""
        known: bool | None = self._known.get("ground", _NOT_ASKED)
        if known is _NOT_ASKED:
            is_new = self.get(FlightStatus) is not None  # a call less than by the property
            status = self.telemetry.believed_status if is_new and self.telemetry else None
            known = None if status is None else status.status == FlightPhase.STANDBY
            self._known["ground"] = known
        return known

    @property
    def is_airborne(self) -> bool:
        """Whether it is seen to be off the ground: setpoints move it."""
        status = self.status
        return status is not None and status.is_airborne

    @property
    def place(self) -> Position | None:
        """Where it is, if GPS says that it is good enough; where it says nothing, it is not."""
        found = self.get(Position)
        return found if found is not None and (found.gps_health or 0) >= GOOD_GPS else None

    @property
    def switch(self) -> RcMode | None:
        """The pilot's mode switch; None when nobody knows."""
        remote = self.get(RemoteControl)
        return remote.mode_switch if remote is not None and remote.is_heard else None


# -- the client: what comes in, and the orders that go out -----------------------------------------

# Messages that do not show that the agent runs: a network's channel makes the first three itself
# when nothing arrives any more, and an agent sends events however old they are.
_NO_SIGN = frozenset(
    {messages.OrderOutcome, messages.SteerRefused, messages.LeaseChanged, messages.Event}
)
_MAX_EVENTS = 200
_MADE_IN = "the loop in which the client was made"


class AgentClient:
    """One front's end of the channel to an agent; to be used as ``async with``.

    Args:
        channel: The channel, not opened yet.
        name: The name of this front, for people.
    """

    def __init__(self, channel: Channel, name: str) -> None:
        self._loop = asyncio.get_running_loop()
        self._clock = self._loop.time
        self._channel, self._name = channel, name
        self.state = messages.State(at=self.now)  #: where the agent stands
        self.heard_at = self.now  #: when a sign that the agent runs was heard last, s
        self.holder = messages.LeaseChanged(0, "")  #: the holder of the lease
        self.agents_before = 0  #: how many have gone; each counts its leases from 1, maybe
        #: Counters of the line to the aircraft; None before the first, and while there is no line.
        self.link: messages.LinkCounted | None = None
        #: Newest values and their ages; None while no aircraft is connected. When the agent itself
        #: is gone the values stay, and grow old.
        self.telemetry: AircraftState | None = None
        self._view: VehicleView | None = None  # of this moment; None once something has arrived
        self.events: deque[messages.Event] = deque(maxlen=_MAX_EVENTS)  #: the newest events
        self.background = TaskSet()  #: tasks that end with this client
        self.unread = 0  #: telemetry packages and plans that this version cannot read
        #: The plan that was uploaded and may be started, or flies; None for none.
        self.plan: WaypointPlan | None = None
        self.plan_by = ""  #: the name of its uploader, for people
        self.on_event: list[Callable[[messages.Event], None]] = []  #: called with each event
        #: Called with each telemetry package; :meth:`samples` wakes a task for each.
        self.on_sample: list[Callable[[Sample], None]] = []
        #: Called with each answer of the aircraft to an activation.
        self.on_activating: list[Callable[[ActivationCode], None]] = []
        #: Called when somebody else took control authority.
        self.on_authority_taken: list[Callable[[AuthorityLost], None]] = []
        #: Called with the fence and the reason when a setpoint was not flown.
        self.on_steer_refused: list[Callable[[int, M100Error], None]] = []
        self.on_mission_report: list[Callable[[messages.MissionReport], None]] = []
        #: Called when the lease changed hands.
        self.on_lease: list[Callable[[messages.LeaseChanged], None]] = []
        self._samples: Hub[Sample] = Hub()
        self._from_mobile: Hub[bytes] = Hub()
        self._answers = PendingRequests(self._send)
        #: Time of the newest STOP that was heard of, s by this clock. Older orders are refused, and
        #: keys that a person released before it do not undo the STOP.
        self.stopped_at = self._after_stop = -math.inf  # and the instant behind it
        self._stops = 0  # how many were heard of
        # Time of the last event of the agent before, whose events another way tells again.
        self._known_until = -math.inf
        self._handlers: dict[type[Any], Callable[[Any], None]] = {
            messages.Hello: self._on_hello,
            messages.State: self._on_state,
            messages.Telemetry: self._on_telemetry,
            messages.MobileMessage: lambda one: self._from_mobile.publish(one.data, self.now),
            messages.Event: self._on_event,
            messages.LinkCounted: partial(setattr, self, "link"),
            messages.LeaseChanged: self._on_lease_changed,
            messages.OrderOutcome: self._answers.outcome,
            messages.Activating: lambda one: call_each(
                self.on_activating, ActivationCode(one.code)
            ),
            messages.AuthorityTaken: self._on_authority_taken,
            messages.SteerRefused: lambda one: call_each(
                self.on_steer_refused, one.fence, one.fault.error()
            ),
            messages.MissionReport: partial(call_each, self.on_mission_report),
            messages.PlanChanged: self._on_plan_changed,
        }

    @property
    def now(self) -> float:
        """Time on the event loop's clock, s."""
        return self._clock()

    @property
    def is_gone(self) -> bool:
        """Whether the agent has gone, and no other was found by :meth:`reopen`."""
        return self._answers.gone is not None

    @property
    def view(self) -> VehicleView:
        """The view of the aircraft now: one for a step, until something arrives."""
        now, view = self._clock(), self._view
        if view is None or now - view.at > MOMENT_S:
            view = self._view = VehicleView(
                now,
                self.heard_at,
                self._answers.gone is not None,
                self.state,
                self.holder,
                self.telemetry,
            )
        return view

    @property
    def is_connected(self) -> bool:
        """Whether the aircraft is connected, by an agent that is heard."""
        return self.view.is_connected

    @property
    def has_authority(self) -> bool:
        """Whether setpoints and tasks are obeyed, by an agent that is heard."""
        return self.view.has_authority

    async def __aenter__(self) -> Self:
        self._greet()
        return self

    def _send(self, message: messages.Message) -> None:
        require_loop(self._loop, _MADE_IN)  # a call of another thread would break its messages
        self._channel.send(message)

    def _greet(self) -> None:
        self._send(messages.Hello(messages.VERSION, self._name, self.now))
        self._channel.open(self._receive, self._closed)

    async def __aexit__(self, *_: object) -> None:
        require_loop(self._loop, _MADE_IN)
        await self.background.end()
        self._channel.close("the front ends")
        self._closed("it was closed here")

    def reopen(self, channel: Channel) -> None:
        """Go on with the agent at the end of this channel: the one before has gone.

        Leases of the earlier agent do not hold here.
        """
        require_loop(self._loop, _MADE_IN)
        if self.events:
            self._known_until = self.events[-1].at
        # Counted, because another agent may give the same number of a lease to somebody else.
        self.agents_before += 1
        self.state, self.heard_at = messages.State(at=self.now), self.now
        self.telemetry = self.link = None  # of another aircraft, maybe
        self._channel, self._answers.gone = channel, None
        self._view = None  # of the agent before
        self._greet()

    # -- what comes in ---------------------------------------------------------------------------

    def _receive(self, message: messages.Message) -> None:
        self._view = None
        if type(message) not in _NO_SIGN:
            self.heard_at = self._clock()
        handler = self._handlers.get(type(message))
        if handler is not None:
            handler(message)

    def _closed(self, reason: str, remedy: str = "") -> None:
        if self.is_gone:
            return
        gone = messages.agent_gone(reason, remedy)
        self.state = replace(
            self.state,
            connection="lost",
            connection_fault=messages.RemoteError.of(gone),
            has_authority=False,
            setpoint_age=None,
            holding="none",
            task="",
            pattern="",
            guided=None,
        )
        self.holder = messages.LeaseChanged(0, "")
        self._answers.end(gone)
        self._view = None

    def _on_hello(self, hello: messages.Hello) -> None:
        if hello.version != messages.VERSION:
            reason = f"it speaks version {hello.version}, this front {messages.VERSION}"
            self._channel.close(reason)
            self._closed(reason, messages.OTHER_RELEASE)

    def _on_state(self, state: messages.State) -> None:
        before, self.state = self.state.replay, state
        is_moved = state.replay is not None and state.replay.since != (before and before.since)
        if state.connection != "connected":
            self.telemetry = self.link = None
        elif self.telemetry is None or is_moved:
            self.telemetry = AircraftState(lambda: self.view.now)

    def _on_telemetry(self, message: messages.Telemetry) -> None:
        try:
            sample = Sample(message.value, PROFILES[message.profile], message.received_at)
        except (KeyError, LayoutMismatch):
            sample = None
        if sample is None or self.telemetry is None:
            self.unread += 1
            return
        if self.state.replay is not None and sample.received_at < self.state.replay.since:
            return  # of another place of the recording
        self.telemetry.update(sample)
        call_each(self.on_sample, sample)
        self._samples.publish(sample, self.now)

    def _on_event(self, event: messages.Event) -> None:
        if event.at <= self._known_until:
            return
        if self.events and event.number <= self.events[-1].number:
            # Another agent counts anew, and pages tell events apart by their numbers.
            event = replace(event, number=self.events[-1].number + 1)
        self.events.append(event)
        if event.topic is messages.EventTopic.STOPPED:
            self.stopped_at = self._clock()
            self._after_stop = math.nextafter(self.stopped_at, math.inf)
            self._stops += 1
        call_each(self.on_event, event)

    def _on_lease_changed(self, message: messages.LeaseChanged) -> None:
        self.holder = message
        call_each(self.on_lease, message)

    def _on_authority_taken(self, message: messages.AuthorityTaken) -> None:
        error = message.fault.error()
        if isinstance(error, AuthorityLost):
            call_each(self.on_authority_taken, error)

    def _on_plan_changed(self, message: messages.PlanChanged) -> None:
        self.plan, self.plan_by = None, message.name
        if message.plan is not None:
            try:
                self.plan = message.plan.plan()
            except (ValueError, BadPlan):
                self.unread += 1

    async def ask(
        self,
        order: orders.Order,
        lease: Lease | None = None,
        accepted: Callable[[], None] | None = None,
        asked_at: float | None = None,
    ) -> messages.OrderOutcome:
        """Give an order, and wait for its outcome.

        ``accepted`` is called when the aircraft has begun, where it takes a while. ``asked_at``:
        when it was wanted, s, if not :attr:`asked_at`: a STOP since then overtakes it.

        Raises:
            M100Error: The agent's error; see :meth:`m100link.apps.agent.server.agent.Agent.ask`.
            LinkError: It has gone.
        """
        fence = lease.number if lease is not None else 0
        asked_at = self.asked_at if asked_at is None else asked_at
        orders.require_newer(order, asked_at, self.stopped_at)
        return await self._answers.question(order, fence, accepted, asked_at)

    @property
    def asked_at(self) -> float:
        """When what is asked now was wanted, s: now, or at the press that this task carries out."""
        return min(max(self._clock(), self._after_stop), PRESSED_AT.get())

    def samples(self, policy: Policy) -> Subscription[Sample]:
        """Subscribe to the telemetry of this and every later aircraft."""
        return self._samples.subscribe(policy)

    def from_mobile(self, policy: Policy) -> Subscription[bytes]:
        """Subscribe to the data of the app on the pilot's phone."""
        return self._from_mobile.subscribe(policy)

    # -- the lease: calls of LeaseManager with their errors, and LinkError without an answer -----

    def holds(self, lease: Lease | None) -> bool:
        """Whether that lease is in force, as far as is known here."""
        return lease is not None and lease.number == self.holder.number

    def check(self, lease: Lease | None) -> Lease:
        """The lease, if it is in force as far as is known here.

        Raises:
            LeaseRefused: It is not.
        """
        if lease is None or not self.holds(lease):
            raise not_in_force(self.holder.name if self.holder.number else None)
        return lease

    async def acquire(self, name: str, asked_at: float | None = None) -> Lease:
        """As :meth:`~m100link.apps.agent.lease.LeaseManager.acquire`. Raises LinkError, too."""
        return given((await self.ask(orders.AcquireLease(name), asked_at=asked_at)).lease)

    async def release_lease(self, token: str) -> None:
        """As ``LeaseManager.release``: motion stops, and authority goes back."""
        await self.ask(orders.ReleaseLease(token))

    async def ask_take_over(self, name: str, asked_at: float | None = None) -> TakeOver:
        """As in LeaseManager: the client that would lose control."""
        return given((await self.ask(orders.AskTakeOver(name), asked_at=asked_at)).offer)

    async def confirm(self, token: str, asked_at: float | None = None) -> Lease:
        """As in LeaseManager: take the lease from the client that the first step named."""
        return given((await self.ask(orders.ConfirmTakeOver(token), asked_at=asked_at)).lease)

    def keep(self, lease: Lease) -> None:
        """Renew a lease without waiting for the answer."""
        self._send(messages.Ask(0, orders.RenewLease(lease.token)))

    def let_go(self, lease: Lease) -> None:
        """Give a lease back without waiting for the answer: motion stops at once."""
        self._send(messages.Ask(0, orders.ReleaseLease(lease.token)))

    # -- flying ----------------------------------------------------------------------------------

    def steer(self, lease: Lease, setpoint: Setpoint, lifetime: float = SETPOINT_LIFETIME) -> None:
        """Fly this for its lifetime; renews the lease. A refusal comes to ``on_steer_refused``."""
        self._send(messages.Steer(lease.number, self._clock(), lifetime, setpoint))

    def hover(
        self,
        why: str = "",
        lease: Lease | None = None,
        *,
        begins_anew: bool = False,
        at: float = math.inf,
    ) -> None:
        """Hover; anybody may. Without the lease, its holder has to begin anew.

        ``begins_anew``: the holder let go of everything at that time, s, by default now. Orders
        after it fly, unless a STOP came since.
        """
        fence, sent_at = lease.number if lease else 0, min(at, max(self._clock(), self._after_stop))
        self._send(messages.Ask(0, orders.Halt(why, begins_anew), fence, sent_at))

    def halt(self, why: str = "", lease: Lease | None = None) -> None:
        """Old name of :meth:`hover`."""
        warn("AgentClient.halt is hover now", DeprecationWarning, stacklevel=2)
        self.hover(why, lease)

    async def stop(self, name: str = "") -> None:
        """Stop whatever happens: motion, program, and the task that the aircraft flies.

        ``name``: the person or program that wants it, for the flight log.
        """
        try:
            await self.ask(orders.Stop())
        finally:
            if name:
                self.note(f"{name}: STOP", messages.LOG_ONLY)

    async def end_task(self, asked_at: float) -> float:
        """End the task that flies, by a STOP that is a step of an order of that time, s.

        Returns the time that the next steps say: this STOP overtakes none of them, and another one
        since then, pressed by a person, overtakes all.
        """
        stops = self._stops - (self.stopped_at >= asked_at)
        with suppress(NotObserved):  # the next step shows whether it flies on
            await self.stop()
        return max(self._clock(), self._after_stop) if self._stops <= stops + 1 else asked_at

    def note(self, text: str, level: str = "info") -> None:
        """Add an event to the agent's journal, or to its log alone; many at once are dropped."""
        self._send(messages.JournalNote(level, text))


# -- questions of a front that wait for the agent's answer -----------------------------------------


class PendingRequests:
    def __init__(self, send: Callable[[messages.Message], None]) -> None:
        self._send = send
        self._create_future = asyncio.get_running_loop().create_future
        self._count = 0
        # By number, with the callback for its begin.
        self._waiting: dict[
            int, tuple[asyncio.Future[messages.OrderOutcome], Callable[[], None] | None]
        ] = {}
        # Why the agent will answer no more, once it has gone; None before.
        self.gone: M100Error | None = None

    async def question(
        self,
        order: orders.Order,
        fence: int,
        accepted: Callable[[], None] | None,
        asked_at: float | None = None,
    ) -> messages.OrderOutcome:
        """Ask for something, and wait for the answer.

        Raises M100Error: the agent's. Raises LinkError: it has gone; nothing was asked. Raises
        LinkLost: it goes meanwhile, and may have done it.
        """
        if self.gone is not None:
            raise self.gone.again()
        self._count += 1
        number = self._count
        # Known before it leaves: inside one process the answer is here when send() returns.
        answer: asyncio.Future[messages.OrderOutcome] = self._create_future()
        self._waiting[number] = answer, accepted
        try:
            self._send(messages.Ask(number, order, fence, asked_at, accepted is not None))
            return await answer
        finally:
            self._waiting.pop(number, None)

    def end(self, gone: M100Error) -> None:
        """The agent has gone: nobody waits for it any longer."""
        self.gone = gone
        waiting, self._waiting = list(self._waiting.values()), {}
        for answer, _ in waiting:
            if not answer.done():
                answer.set_exception(messages.agent_lost(gone))

    def outcome(self, outcome: messages.OrderOutcome) -> None:
        """The end of a question. It stays the end, and a question begins once."""
        answer, accepted = self._waiting.get(outcome.id, (None, None))
        if answer is None or answer.done():
            return
        if outcome.stage is messages.Stage.ACCEPTED:
            self._waiting[outcome.id] = answer, None
            if accepted is not None:
                accepted()
        elif outcome.fault is None:
            answer.set_result(outcome)
        else:
            answer.set_exception(outcome.fault.error())


def given(value: T | None) -> T:
    """The value of an answer. Raises MessageError: it has none."""
    if value is None:
        raise messages.MessageError("the agent answered without what was asked for")
    return value
