"""The agent's side of its fronts: the messages to each of them, and their times."""

from __future__ import annotations

import asyncio
import math
from collections import Counter, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import partial
from operator import itemgetter
from typing import Any

from m100link.aircraft import Aircraft
from m100link.apps.agent import messages
from m100link.apps.agent.background import TokenBucket, call_each, goes_on, ignore
from m100link.apps.agent.lease import Flown, Lease, LeaseChange, LeaseRefused, TakeOver
from m100link.apps.agent.orders import Halt, PointGimbal, RenewLease, TurnGimbal
from m100link.apps.agent.server.agent import Agent, Answer
from m100link.apps.agent.server.authority import HoldingInput, HoldingState
from m100link.apps.agent.server.mission import push_of
from m100link.apps.agent.transports import Channel
from m100link.errors import AuthorityLost, GuardRefused, M100Error, NotObserved, UsageError
from m100link.errors.texts import printable, shortened
from m100link.flight.mission_state import MissionKind, MissionState
from m100link.flight.missions.events import MissionEvent
from m100link.link.statistics import ROUND_TRIP_BOUNDS_S
from m100link.protocol.codes import ActivationCode
from m100link.protocol.firmware import PROFILES
from m100link.telemetry.sample import Sample

_AT = itemgetter(0)
STATE_INTERVAL = 0.25
"""Seconds between two states that nothing changed in."""

_NONE = MissionKind.NONE
_BOUNDS = (*(str(bound) for bound in ROUND_TRIP_BOUNDS_S), "inf")


class AgentServer:
    """Serves any number of fronts, and the flight log."""

    def __init__(self, agent: Agent) -> None:
        self._agent = agent
        self._fronts: set[ClientSession] = set()
        self._sent: tuple[Any, ...] = ()  # of the state, when it was sent last
        agent.connection.on_sample.append(self._sample)
        agent.connection.on_aircraft.append(self._aircraft_changed)
        agent.journal.on_event.append(self._event)
        agent.activation.on_code.append(self._activating)
        agent.holding.on_lost.append(self._authority_taken)
        agent.holding.on_mission_event = self._mission_event
        agent.on_lease.append(self._lease_changed)
        agent.on_plan.append(self._tell)
        self._log = AgentLog(agent, self._fronts)  # last: it hears of everything behind others
        agent.background.spawn(self._keep_telling(), "state")

    def attach(self, channel: Channel) -> None:
        front = ClientSession(
            self._agent,
            self._log,
            channel,
            on_gone=self._fronts.discard,
            before_outcome=self._tell_state,
        )
        self._tell_state()
        self._fronts.add(front)
        front.greet(self._state())

    def close(self) -> None:
        for front in list(self._fronts):
            front.close("the agent ends")

    # -- messages to fronts ----------------------------------------------------------------------

    def _tell(self, message: messages.Message) -> None:
        call_each([front.tell for front in self._fronts], message)

    def _sample(self, sample: Sample) -> None:
        self._tell_state()
        # A profile of one's own is not known to a front under its name.
        if self._fronts and PROFILES.get(sample.profile.name) is sample.profile:
            self._tell(messages.Telemetry(sample.value, sample.profile.name, sample.received_at))

    def _aircraft_changed(self, aircraft: Aircraft | None) -> None:
        self._tell_state()
        if aircraft is not None:
            self._agent.background.spawn(self._watch_mobile(aircraft), "data of the app")

    async def _watch_mobile(self, aircraft: Aircraft) -> None:
        async with aircraft.from_mobile() as came:
            async for data in came:
                self._tell(messages.MobileMessage(data))

    def _event(self, event: messages.Event) -> None:
        self._tell_state()
        self._tell(event)

    def _activating(self, code: ActivationCode) -> None:
        self._tell(messages.Activating(int(code)))

    def _authority_taken(self, error: AuthorityLost) -> None:
        self._tell_state()
        self._tell(messages.AuthorityTaken(messages.RemoteError.of(error)))

    def _mission_event(self, event: MissionEvent) -> None:
        self._log.note("mission", report=type(event).__name__, values=event)
        push = push_of(event)
        if push is not None:
            self._tell(messages.MissionReport(*push))

    def _lease_changed(self, why: LeaseChange, lease: Lease | None, flown: Flown) -> None:
        number, name = (lease.number, lease.name) if lease is not None else (0, "")
        for front in self._fronts:
            front.forget_leases(but=number)
        self._tell(messages.LeaseChanged(number, name, why, flown))
        self._tell_state()

    async def _keep_telling(self) -> None:
        lags: list[float] = []
        while True:
            due = self._agent.now + STATE_INTERVAL
            await asyncio.sleep(STATE_INTERVAL)
            with goes_on("the telling of the state"):
                lags.append(max(0.0, self._agent.now - due))
                # Sent although nothing changed: fronts take silence of 2 s for an agent that hangs.
                self._sent = ()
                self._tell_state()
                if len(lags) * STATE_INTERVAL >= 1.0:
                    self._tell_counters(max(lags))
                    lags.clear()

    def _tell_counters(self, lag: float) -> None:
        aircraft = self._agent.connection.aircraft
        if aircraft is not None:
            counted = aircraft.statistics()
            counters = asdict(counted)
            discards = counters.pop("discards")
            del counters["round_trips"], counters["round_trip_s"]  # no number before an answer
            trips = counted.round_trips
            classes = dict(zip(_BOUNDS, trips.counts, strict=True))
            self._tell(
                messages.LinkCounted(
                    self._agent.now, counters, discards, lag, classes, trips.total_s
                )
            )

    def _tell_state(self) -> None:
        """Send the state if it has changed, always before the messages that follow from it."""
        agent = self._agent
        holding, connection = agent.holding, agent.connection
        aircraft, flying = connection.aircraft, holding.flying
        now = (
            connection.state,
            connection.error,
            aircraft and aircraft.is_activated,
            agent.activation.code,
            agent.activation.error,
            holding.state,
            holding.has_authority,
            flying and (flying.seen_task, flying.pattern, flying.guiding.order),
            flying is not None and flying.is_steered,
            aircraft and aircraft.mission,
            agent.replay and self._replay_changed(agent.replay.progress()),
        )
        if now != self._sent:
            self._sent = now
            if self._fronts:
                self._tell(self._state())

    def _replay_changed(self, its: messages.Replay | None) -> object:
        """The settings of a replay that people change; its place changes by itself."""
        return its and (its.speed, its.is_paused, its.is_at_end, its.since)

    def _state(self) -> messages.State:
        """The state as :meth:`_tell_state` saw it last, with what changes all the time."""
        agent, now = self._agent, self._agent.now
        connection, error, is_activated, code, fault, holding, has_authority, *rest = self._sent
        flown, is_steered, mission, _ = rest
        task, pattern, _ = flown or (None, None, None)
        mission = mission or MissionState()
        aircraft, flying = agent.connection.aircraft, agent.holding.flying
        link = aircraft.statistics() if aircraft is not None else None
        return messages.State(
            at=now,
            connection=connection.value,
            connection_fault=messages.fault_of(error),
            firmware=str(aircraft.firmware) if aircraft is not None else "",
            is_activated=bool(is_activated),
            activation_code=None if code is None else int(code),
            activation_fault=messages.fault_of(fault),
            holding=holding.value,
            has_authority=has_authority,
            setpoint_age=now - agent.steered_at if is_steered else None,
            task=task or "",
            pattern=pattern or "",
            guided=flying.guiding.current() if flying is not None else None,
            mission=mission.kind.value if mission.is_running or mission.kind is _NONE else "",
            mission_index=-1 if mission.index is None else mission.index,
            mission_status=-1 if mission.status is None else mission.status,
            lease_remaining=agent.leases.remaining(now),
            round_trip=agent.connection.round_trip,
            discards=sum(link.discards.values()) if link else 0,
            late_acks=link.late_acks + link.foreign_acks if link else 0,
            dropped_writes=link.dropped_writes if link else 0,
            mismatches=aircraft.telemetry_mismatches if aircraft is not None else 0,
            limits=agent.holding.limits,
            replay=None if agent.replay is None else agent.replay.progress(),
        )


# -- the flight log --------------------------------------------------------------------------------

_MOST_NOTES = 300  # that wait for the log; without a connection, for that of the next one
_ORDERS_PER_S, _MOST_ORDERS = 20.0, 100  # notes of a front; the others are counted
_USUAL = (RenewLease, TurnGimbal, PointGimbal)  # of many alike the first is noted, or none
_STREAM_S = 0.5  # setpoints, or turns of the gimbal, that follow each other sooner are one stream

Note = tuple[float, str, dict[str, Any]]
"""When, s; what it is about; its values."""


class AgentLog:
    """The orders of clients and their outcomes, for the flight log of the connection.

    Nothing waits for it, and little is done for it before the log asks, ten times a second.
    """

    def __init__(self, agent: Agent, fronts: set[ClientSession]) -> None:
        self._agent, self._fronts = agent, fronts
        self._notes: deque[Note] = deque(maxlen=_MOST_NOTES)
        self._known: dict[str, Any] = {}  # of the state, as it was noted last
        self._event = 0  # number of the last event that was noted
        self._began_at = 0.0
        agent.holding.on_change.append(self._control)
        agent.on_lease.append(self._lease)
        agent.on_plan.append(self._plan)
        agent.connection.on_aircraft.append(self._begin)
        self._begin(agent.connection.aircraft)

    def note(self, event: str, **values: Any) -> None:
        self._notes.append((self._agent.now, event, values))

    def left(self, front: ClientSession, reason: str) -> None:
        self._notes.extend(front.take_notes())
        self.note("client", name=front.name, is_there=False, reason=reason)

    def _begin(self, aircraft: Aircraft | None) -> None:
        if aircraft is None:
            return
        agent, self._began_at, self._known = self._agent, self._agent.now, {}
        self.note("clients", names=sorted(front.name for front in self._fronts))
        holder = agent.leases.holder(agent.now)
        number, name = (holder.number, holder.name) if holder is not None else (0, "")
        self.note("lease", why="in force", number=number, holder=name)
        self._plan(agent.plan)
        aircraft.note_from(self._take)

    def _take(self) -> list[dict[str, Any]]:
        """The notes since the last time, in their order."""
        for front in self._fronts:
            self._notes.extend(front.take_notes())
        for event in self._agent.journal.events:
            if event.number > self._event:
                self._event = event.number
                said = {"level": event.level, "text": event.text, "topic": event.topic.value}
                self._notes.append((event.at, "journal", said))
        self._note_state()
        notes, self._notes = sorted(self._notes, key=_AT), deque(maxlen=_MOST_NOTES)
        return [
            {"event": event, **values, "at": at}
            if at >= self._began_at
            else {"event": event, **values, "earlier_s": self._began_at - at, "at": self._began_at}
            for at, event, values in notes
        ]

    def _control(self, before: HoldingState, after: HoldingState) -> None:
        why: object = self._agent.holding.cause
        if why is HoldingInput.LET_GO:
            has_holder = self._agent.leases.holder(self._agent.now) is not None
            why = "its client gives it back" if has_holder else "the lease has ended"
        self.note("control", before=before, after=after, why=why)

    def _lease(self, why: LeaseChange, lease: Lease | None, flown: Flown) -> None:
        number, name = (lease.number, lease.name) if lease is not None else (0, "")
        self.note("lease", why=why, number=number, holder=name, flown=flown)

    def _plan(self, plan: messages.PlanChanged) -> None:
        uploaded = plan.plan
        waypoints = uploaded.plan().waypoints if uploaded is not None else ()
        places = [(one.latitude_deg, one.longitude_deg, one.height) for one in waypoints]
        self.note("plan", name=plan.name, waypoints=places)

    def _note_state(self) -> None:
        """Note what changed of what flies, and of the limits."""
        aircraft, flying = self._agent.connection.aircraft, self._agent.holding.flying
        mission = aircraft.mission if aircraft is not None else MissionState()
        guided = flying.guiding.order if flying is not None else None
        now = {
            "task": (flying and flying.seen_task) or "",
            "pattern": (flying and flying.pattern) or "",
            "guided": guided.label if guided is not None else "",
            "steered": flying is not None and flying.is_steered,
            "mission": mission.kind.value if mission.is_running else "",
            "waypoint": mission.index,
            "limits": self._agent.holding.limits,
        }
        changed = {name: one for name, one in now.items() if self._known.get(name) != one}
        self._known = now
        if changed:
            self.note("state", **changed)


# -- one front, as its agent sees it: its messages, the answers, and its leases --------------------
# Nothing that a front sends raises out of here: a question has an outcome, a setpoint that is not
# flown has an answer, and a message without a meaning ends the connection. When a front has gone,
# the leases that it was granted end: the aircraft hovers, and control authority goes back.


MAX_SETPOINT_AGE = 0.3
"""Seconds that a setpoint may have been on its way: an older one moves after the stick let go."""

_MAX_ASKS = 64
_MAX_NOTE, _MAX_LOGGED = 200, 4000  # characters; the second of what the flight log alone gets
_NOTES_PER_S, _MAX_NOTES = 5.0, 20.0  # the others are dropped


class ClientSession:
    def __init__(
        self,
        agent: Agent,
        log: AgentLog,
        channel: Channel,
        *,
        on_gone: Callable[[ClientSession], None],
        # Called before each outcome, so that the state is there first.
        before_outcome: Callable[[], None],
    ) -> None:
        self._agent, self._log = agent, log
        self._channel = channel
        self._on_gone = on_gone
        self._before_outcome = before_outcome
        self.name = ""  # empty until it has said hello
        # The leases that were granted over this channel, by number.
        self._leases: dict[int, Lease] = {}
        # Questions under way, by lease, 0 without one: several operators may be behind a front, and
        # those without the lease cost its holder nothing, nor the holder them.
        self._asks: Counter[int] = Counter()
        # Of these, those that were heard in this turn of the loop and begin in the next one.
        self._unbegun = 0
        self._notes = TokenBucket(_NOTES_PER_S, _MAX_NOTES)
        self._noted: deque[Note] = deque(maxlen=_MOST_ORDERS)  # for the flight log
        self._allowed = TokenBucket(_ORDERS_PER_S, _MOST_ORDERS)
        self._left_out = 0  # notes that the log does not get, since the last that it got
        # The time of the newest of each stream, and the last refusal that was noted.
        self._streams: dict[type[Any], float] = {}
        self._refused: tuple[object, float] = (None, -math.inf)
        self._handlers: dict[type[Any], Callable[[Any], None]] = {
            messages.Steer: self._on_steer,
            messages.Ask: self._on_ask,
            messages.JournalNote: self._on_note,
        }

    # -- the connection --------------------------------------------------------------------------

    def greet(self, state: messages.State) -> None:
        """Say hello and where everything stands, then listen."""
        agent = self._agent
        # First, so that a front of another version parts before it reads anything else.
        self.tell(messages.Hello(messages.VERSION, "agent", agent.now))
        lease = agent.leases.holder(agent.now)
        self.tell(
            messages.LeaseChanged(lease.number, lease.name)
            if lease
            else messages.LeaseChanged(0, "")
        )
        self.tell(state)
        self.tell(agent.plan)
        for event in agent.journal.events:
            self.tell(event)
        self._channel.open(self._receive, self._closed)

    def tell(self, message: messages.Message) -> None:
        self._channel.send(message)

    def close(self, reason: str) -> None:
        self._channel.close(reason)
        self._leave(LeaseChange.RELEASED, reason)

    def _closed(self, reason: str) -> None:
        self._leave(LeaseChange.FRONT_LOST, reason)

    def _leave(self, why: LeaseChange, reason: str) -> None:
        self._on_gone(self)
        for lease in list(self._leases.values()):
            try:
                self._agent.leases.release(lease.token, self._agent.now, why)
            except LeaseRefused:
                pass  # another one has it by now
            else:
                self._agent.journal.note(f"{self.name} has gone", "warning")
        self._leases.clear()
        if self.name:
            self._log.left(self, reason)

    def forget_leases(self, *, but: int) -> None:
        self._leases = {number: one for number, one in self._leases.items() if number == but}

    def _receive(self, message: messages.Message) -> None:
        if isinstance(message, messages.Hello) and not self.name:
            # Fields of another version may have another meaning: nobody flies by a guess.
            if message.version != messages.VERSION:
                self.close(f"this agent speaks version {messages.VERSION}, not {message.version}")
                return
            self.name = message.name or "a front"
            self._log.note("client", name=self.name, is_there=True)
            return
        handler = self._handlers.get(type(message))
        if handler is None or not self.name:
            self.close(f"a front does not send {type(message).__name__} now")
        else:
            handler(message)

    # -- setpoints -------------------------------------------------------------------------------

    def _on_steer(self, steer: messages.Steer) -> None:
        age = self._agent.now - steer.sent_at
        try:
            # A time ahead of ours would make it young for as long.
            if abs(age) > MAX_SETPOINT_AGE:
                raise GuardRefused(
                    f"a setpoint was {age:.2f} s on its way; it was not flown",
                    guard="setpoint_age",
                    measured=age,
                    limit=MAX_SETPOINT_AGE,
                    cause="the front, or what is before it, is slow"
                    if age > 0
                    else "the clock of the front is ahead of the agent's",
                )
            lease = self._leases.get(steer.fence)
            self._agent.steer(
                lease.token if lease is not None else "", steer.setpoint, steer.lifetime
            )
            self._agent.steered_at = steer.sent_at
        except M100Error as error:
            self._before_outcome()
            self.tell(messages.SteerRefused(steer.fence, messages.RemoteError.of(error)))
            self._note_refusal(steer, error)
        else:
            if self._begins_stream(messages.Steer):
                self._note("setpoints", steer.fence, setpoint=steer.setpoint)

    # -- the flight log --------------------------------------------------------------------------

    def take_notes(self) -> Iterator[Note]:
        """The notes since the last time; of a flood some, and how many are left out."""
        while self._noted:
            at, event, values = self._noted.popleft()
            if not self._allowed.take(at, 0.1 if values.pop("ends") else 1.0):
                self._left_out += 1
                continue
            more = {"left_out": self._left_out} if self._left_out else {}
            self._left_out = 0
            yield at, event, values | more

    def _note(self, event: str, fence: int, *, ends: bool = False, **values: Any) -> None:
        lease = self._leases.get(fence)
        self._left_out += len(self._noted) == _MOST_ORDERS
        values["client"], values["by"] = self.name, lease.name if lease is not None else ""
        values["ends"] = ends
        self._noted.append((self._agent.now, event, values))

    def _note_refusal(self, steer: messages.Steer, error: M100Error) -> None:
        kind, now = (type(error), getattr(error, "guard", "")), self._agent.now
        if kind != self._refused[0] or now - self._refused[1] > 1.0:
            self._refused = kind, now
            self._note("setpoints", steer.fence, stage="refused", **_why(error))

    def _note_outcome(
        self, ask: messages.Ask, stage: messages.Stage, error: M100Error | None
    ) -> None:
        order = ask.order
        is_usual = isinstance(order, _USUAL) and error is None
        if not is_usual or (not order.is_at_once and self._begins_stream(type(order))):
            said: dict[str, Any] = {"arguments": order} if order.is_at_once else {}
            said |= {"order": order.label, "id": ask.id, "stage": stage} | _why(error)
            self._note("order", ask.fence, ends=order.ends, **said)

    def _begins_stream(self, kind: type[Any]) -> bool:
        now = self._agent.now
        before, self._streams[kind] = self._streams.get(kind, -math.inf), now
        return now - before > _STREAM_S

    # -- everything else -------------------------------------------------------------------------

    def _on_note(self, note: messages.JournalNote) -> None:
        if note.level in messages.LEVELS and self._notes.take(self._agent.now):
            self._agent.journal.note(printable(shortened(note.text, _MAX_NOTE)), note.level)
        elif note.level == messages.LOG_ONLY:
            self._note("text", 0, text=printable(shortened(note.text, _MAX_LOGGED)))

    def _on_ask(self, ask: messages.Ask) -> None:
        order, lease = ask.order, ask.fence if ask.fence in self._leases else 0
        if order.is_at_once:
            with self._answering(ask):
                answer = self._begin(ask)
                if isinstance(order, Halt):
                    if self._unbegun:
                        # Orders heard earlier begin first, and end then.
                        self._agent.background.spawn(self._hover(ask), f"hover for {self.name}")
                    self._report_hover(order.why)
                self._answer(ask, messages.Stage.DONE, answer=answer)
        elif self._asks[lease] >= _MAX_ASKS and not order.ends:
            too_many = UsageError(f"{self._asks[lease]} questions of this front wait already")
            self._answer(ask, messages.Stage.FAILED, too_many)
        else:
            self._asks[lease] += 1
            self._unbegun += 1
            name = f"{order.label} for {self.name}"
            if not isinstance(order, _USUAL):  # first: it may be over before this goes on
                asked = {"order": order.label, "id": ask.id, "stage": "asked", "arguments": order}
                self._note("order", ask.fence, ends=order.ends, **asked)
            self._agent.background.spawn(self._carry_out(ask, lease), name)

    async def _hover(self, ask: messages.Ask) -> None:
        self._begin(ask)

    def _report_hover(self, why: str) -> None:
        """Tell the holder that another front had it hover: its flight may have more to come."""
        agent, now = self._agent, self._agent.now
        holder = agent.leases.holder(now)
        if holder is not None and holder.number not in self._leases and self._notes.take(now):
            text = printable(shortened(why or f"{self.name}: hover", _MAX_NOTE))
            agent.journal.note(text, "info", messages.EventTopic.HALTED)

    def _begin(self, ask: messages.Ask) -> Any:
        lease = self._leases.get(ask.fence)
        token = lease.token if lease is not None else ""
        accepted = (
            partial(self._answer, ask, messages.Stage.ACCEPTED) if ask.hears_begin else ignore
        )
        asked_at = math.inf if ask.sent_at is None else ask.sent_at
        return self._agent.begin(ask.order, token, accepted, asked_at)

    def _answer(
        self,
        ask: messages.Ask,
        stage: messages.Stage,
        error: M100Error | None = None,
        answer: Answer = None,
    ) -> None:
        self._before_outcome()
        outcome = messages.OrderOutcome(ask.id, stage, messages.fault_of(error))
        if isinstance(answer, Lease):
            self._leases[answer.number] = answer
            outcome = replace(outcome, lease=answer)
        elif isinstance(answer, TakeOver):
            outcome = replace(outcome, offer=answer)
        elif answer is not None:
            outcome = replace(outcome, text=answer[0], number=answer[1])
        if ask.id:
            self.tell(outcome)
        self._note_outcome(ask, stage, error)

    async def _carry_out(self, ask: messages.Ask, lease: int) -> None:
        self._unbegun -= 1
        try:
            with self._answering(ask):
                self._answer(ask, messages.Stage.DONE, answer=await self._begin(ask))
        finally:
            self._asks[lease] -= 1
            if not self._asks[lease]:
                del self._asks[lease]

    @contextmanager
    def _answering(self, ask: messages.Ask) -> Iterator[None]:
        try:
            yield
        except M100Error as error:
            self._answer(ask, messages.Stage.FAILED, error)
        except asyncio.CancelledError:  # of its work, or the agent ends: nobody waits for ever
            given_up = NotObserved(f"{ask.order.label}: the agent gave it up before its end")
            self._answer(ask, messages.Stage.FAILED, given_up)
            raise
        except Exception:
            fault = messages.MessageError("the agent failed", remedy="see its log; report it")
            self._answer(ask, messages.Stage.FAILED, fault)
            raise


def _why(error: M100Error | None) -> dict[str, Any]:
    if error is None:
        return {}
    return {"error": error.error_code, "seen": printable(shortened(error.seen, _MAX_NOTE))}
