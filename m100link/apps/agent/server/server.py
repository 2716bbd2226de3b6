"""The agent's side of its fronts: what each of them is told, and when."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import asdict
from typing import Any

from m100link.aircraft import Aircraft, AircraftCamera
from m100link.apps.agent.codec import told_of
from m100link.apps.agent.guided import GuidedOrder, name_of
from m100link.apps.agent.lease import Flown, Lease, LeaseChange, LeaseRefused
from m100link.apps.agent.messages import (
    LEVELS,
    TAKE_OFF_FIRST,
    UNTIL_OVER,
    VERSION,
    Action,
    Activating,
    Ask,
    AuthorityTaken,
    Event,
    FromMobile,
    Hello,
    LeaseAction,
    LeaseAsk,
    LeaseChanged,
    LeaseGranted,
    LinkCounted,
    Message,
    MissionTold,
    Note,
    Outcome,
    PlanTold,
    Stage,
    State,
    Steer,
    SteerRefused,
    TakeOverOffered,
    Telemetry,
    Topic,
)
from m100link.apps.agent.remote_error import Fault, MessageError, fault_of
from m100link.apps.agent.server.agent import Agent
from m100link.apps.agent.server.connection import ConnectionState
from m100link.apps.agent.server.flight import pattern
from m100link.apps.agent.server.mission import StagedPlan, push_of
from m100link.apps.agent.server.mission import read_command as read
from m100link.apps.agent.server.replays import refused
from m100link.apps.agent.transports import Channel
from m100link.errors import AuthorityLost, GuardRefused, M100Error, UsageError
from m100link.flight.mission_state import MissionKind, MissionState
from m100link.flight.missions.events import MissionEvent
from m100link.link.statistics import ROUND_TRIP_BOUNDS_S
from m100link.missions.plan import WaypointPlan
from m100link.protocol.codes import ActivationCode
from m100link.protocol.commands.control import Task
from m100link.protocol.commands.gimbal import GimbalAngle, GimbalSpeed
from m100link.protocol.commands.hotpoint import HotpointStart
from m100link.protocol.commands.waypoint import WaypointMission, WaypointPoint
from m100link.protocol.firmware import PROFILES
from m100link.telemetry.sample import Sample

STATE_INTERVAL = 0.25
"""Seconds between two states that nothing changed in."""

_NONE = MissionKind.NONE
_BOUNDS = (*(str(bound) for bound in ROUND_TRIP_BOUNDS_S), "inf")


class Service:
    """Serves any number of fronts."""

    def __init__(self, agent: Agent) -> None:
        self._agent = agent
        self._fronts: set[Front] = set()
        self._told: tuple[object, ...] = ()
        self._plan = PlanTold()  # of the lease in force: what came under another one is void
        agent.connection.on_sample.append(self._sample)
        agent.connection.on_aircraft.append(self._aircraft_changed)
        agent.journal.on_event.append(self._event)
        agent.activation.on_code.append(self._activating)
        agent.holding.on_lost.append(self._authority_taken)
        agent.holding.on_mission_event = self._mission_event
        agent.on_lease.append(self._lease_changed)
        agent.background.spawn(self._keep_telling(), "state")

    def attach(self, channel: Channel) -> None:
        """Serve the front at the other end of this channel."""
        front = Front(
            self._agent,
            channel,
            on_gone=self._gone,
            before_outcome=self._tell_state,
            on_plan=self._plan_uploaded,
        )
        self._fronts.add(front)
        front.greet(self._state(), self._plan)

    def close(self) -> None:
        """Close the channels of all fronts."""
        for front in list(self._fronts):
            front.close("the agent ends")

    def _gone(self, front: Front) -> None:
        self._fronts.discard(front)

    # -- what fronts are told --------------------------------------------------------------------

    def _tell(self, message: Message) -> None:
        for front in tuple(self._fronts):
            front.tell(message)

    def _sample(self, sample: Sample) -> None:
        self._tell_state()
        # A profile of one's own is not known to a front under its name.
        if self._fronts and PROFILES.get(sample.profile.name) is sample.profile:
            self._tell(Telemetry(sample.value, sample.profile.name, sample.received_at))

    def _aircraft_changed(self, aircraft: Aircraft | None) -> None:
        self._tell_state()
        if aircraft is not None:
            self._agent.background.spawn(self._watch_mobile(aircraft), "data of the app")

    async def _watch_mobile(self, aircraft: Aircraft) -> None:
        async with aircraft.from_mobile() as messages:
            async for data in messages:
                self._tell(FromMobile(data))

    def _event(self, event: Event) -> None:
        self._tell_state()
        self._tell(event)

    def _activating(self, code: ActivationCode) -> None:
        self._tell(Activating(int(code)))

    def _authority_taken(self, error: AuthorityLost) -> None:
        self._tell_state()
        self._tell(AuthorityTaken(Fault.of(error)))

    def _mission_event(self, event: MissionEvent) -> None:
        push = push_of(event)
        if push is not None:
            self._tell(MissionTold(*push))

    def _lease_changed(self, why: LeaseChange, lease: Lease | None, flown: Flown) -> None:
        number, name = (lease.number, lease.name) if lease is not None else (0, "")
        for front in self._fronts:
            front.forget_leases(but=number)
        self._tell(LeaseChanged(number, name, why, flown))
        self._tell_state()
        if self._plan != PlanTold():
            self._plan_uploaded(PlanTold())

    def _plan_uploaded(self, plan: PlanTold) -> None:
        self._plan = plan
        self._tell(plan)

    async def _keep_telling(self) -> None:
        lags: list[float] = []
        while True:
            due = self._agent.now + STATE_INTERVAL
            await asyncio.sleep(STATE_INTERVAL)
            lags.append(max(0.0, self._agent.now - due))
            self._told = ()
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
            del counters["round_trips"]
            trips = counted.round_trips
            classes = dict(zip(_BOUNDS, trips.counts, strict=True))
            self._tell(
                LinkCounted(self._agent.now, counters, discards, lag, classes, trips.total_s)
            )

    def _tell_state(self) -> None:
        """Tell the state if it has changed: always before what is told because of it."""
        agent = self._agent
        holding, connection = agent.holding, agent.connection
        told = (
            connection.state,
            connection.error,
            connection.aircraft is not None and connection.aircraft.is_activated,
            agent.activation.code,
            agent.activation.error,
            holding.state,
            holding.has_authority,
            holding.task,
            holding.pattern,
            holding.guided_order,
            connection.aircraft.mission if connection.aircraft is not None else None,
            self._replay_told(),
        )
        if told != self._told:
            self._told = told
            if self._fronts:
                self._tell(self._state())

    def _replay_told(self) -> object:
        """What people change of a replay; its place changes by itself."""
        told = None if self._agent.replay is None else self._agent.replay.told()
        return None if told is None else (told.rate, told.is_paused, told.clock - told.position_s)

    def _state(self) -> State:
        agent = self._agent
        connection, activation, holding = agent.connection, agent.activation, agent.holding
        is_connected = connection.state is ConnectionState.CONNECTED
        aircraft = connection.aircraft if is_connected else None
        link = aircraft.statistics() if aircraft is not None else None
        mission = aircraft.mission if aircraft is not None else MissionState()
        flying = holding.flying
        return State(
            at=agent.now,
            connection=connection.state.value,
            connection_fault=None if is_connected else fault_of(connection.error),
            firmware=str(aircraft.firmware) if aircraft is not None else "",
            is_activated=aircraft is not None and aircraft.is_activated,
            activation_code=None if activation.code is None else int(activation.code),
            activation_fault=fault_of(activation.error),
            holding=holding.state.value,
            has_authority=holding.has_authority,
            task=holding.task or "",
            pattern=holding.pattern or "",
            guided=flying.guiding.told() if flying is not None else None,
            mission=mission.kind.value if mission.is_running or mission.kind is _NONE else "",
            mission_index=-1 if mission.index is None else mission.index,
            mission_status=-1 if mission.status is None else mission.status,
            lease_remaining=agent.desk.remaining(agent.now),
            round_trip=connection.round_trip,
            discards=sum(link.discards.values()) if link else 0,
            late_acks=link.late_acks + link.foreign_acks if link else 0,
            dropped_writes=link.dropped_writes if link else 0,
            mismatches=aircraft.telemetry_mismatches if aircraft is not None else 0,
            limits=holding.limits,
            replay=None if agent.replay is None else agent.replay.told(),
        )


# -- one front, as its agent sees it: what it says, what it is told, and the leases that it has ----
# Nothing that a front sends raises out of here: a question has an outcome, a setpoint that is not
# flown has an answer, and what has no meaning ends the connection. When a front has gone, the
# leases that it was granted end: the aircraft hovers, and control authority goes back.


MAX_SETPOINT_AGE = 0.3
"""Seconds that a setpoint may have been on its way."""

_MAX_ASKS = 64
_MAX_NOTE = 200
_NOTES_PER_S, _MAX_NOTES = 5.0, 20.0


class Front:
    """One front."""

    def __init__(
        self,
        agent: Agent,
        channel: Channel,
        *,
        on_gone: Callable[[Front], None],
        # Called before each outcome, so that the state is there first.
        before_outcome: Callable[[], None],
        on_plan: Callable[[PlanTold], None],  # called with each plan that it has uploaded
    ) -> None:
        self._agent = agent
        self._channel = channel
        self._on_gone = on_gone
        self._before_outcome = before_outcome
        self._name = ""  # empty until it has said hello
        # Tokens of the leases that were granted over this channel, by number.
        self._tokens: dict[int, str] = {}
        self._asks = 0
        # Of these, those that were heard in this turn of the loop and begin in the next one.
        self._unbegun = 0
        self._orders = Orders(agent, self._uploaded)
        self._on_plan = on_plan
        self._notes = _MAX_NOTES
        self._noted_at = agent.now
        self._handlers: dict[type[Any], Callable[[Any], None]] = {
            LeaseAsk: self._on_lease_ask,
            Steer: self._on_steer,
            Ask: self._on_ask,
            Note: self._on_note,
            **dict.fromkeys(GuidedOrder.__args__, self._on_guided),
        }

    # -- the connection --------------------------------------------------------------------------

    def greet(self, state: State, plan: PlanTold) -> None:
        """Say hello and where everything stands, then listen."""
        agent = self._agent
        self.tell(Hello(VERSION, "agent", agent.now))
        lease = agent.desk.holder(agent.now)
        self.tell(LeaseChanged(lease.number, lease.name) if lease else LeaseChanged(0, ""))
        self.tell(state)
        self.tell(plan)
        for event in agent.journal.events:
            self.tell(event)
        self._channel.open(self._receive, self._closed)

    def tell(self, message: Message) -> None:
        """Send it a message."""
        self._channel.send(message)

    def close(self, reason: str) -> None:
        """End the connection."""
        self._channel.close(reason)
        self._leave(LeaseChange.RELEASED)

    def _closed(self, reason: str) -> None:
        self._leave(LeaseChange.FRONT_LOST)

    def _leave(self, why: LeaseChange) -> None:
        self._on_gone(self)
        for token in list(self._tokens.values()):
            try:
                self._agent.desk.release(token, self._agent.now, why)
            except LeaseRefused:
                pass  # another one has it by now
            else:
                self._agent.journal.note(f"{self._name} has gone", "warning")
        self._tokens.clear()

    def forget_leases(self, *, but: int) -> None:
        """Leases that have ended are of no use."""
        self._tokens = {number: one for number, one in self._tokens.items() if number == but}

    def _receive(self, message: Message) -> None:
        if isinstance(message, Hello) and not self._name:
            if message.version != VERSION:
                self.close(f"this agent speaks version {VERSION}, not {message.version}")
                return
            self._name = message.name or "a front"
            return
        handler = self._handlers.get(type(message))
        if handler is None or not self._name:
            self.close(f"a front does not send {type(message).__name__} now")
        else:
            handler(message)

    # -- the lease -------------------------------------------------------------------------------

    def _token(self, fence: int) -> str:
        """Proof of the lease with that number; empty when it was not granted over this channel."""
        return self._tokens.get(fence, "")

    def _on_lease_ask(self, ask: LeaseAsk) -> None:
        answer: Message
        try:
            answer = self._lease(ask)
        except M100Error as error:
            answer = Outcome(ask.id, Stage.FAILED, Fault.of(error))
        self._before_outcome()
        if ask.id:
            self.tell(answer)

    def _lease(self, ask: LeaseAsk) -> Message:
        desk, now = self._agent.desk, self._agent.now
        if self._agent.replay is not None and ask.action is not LeaseAction.RELEASE:
            raise refused()
        if ask.action is LeaseAction.RELEASE:
            desk.release(ask.token, now)
            return Outcome(ask.id, Stage.DONE)
        if ask.action is LeaseAction.TAKE_OVER:
            wanted = desk.ask_take_over(ask.name, now)
            return TakeOverOffered(
                ask.id,
                wanted.name,
                wanted.from_name,
                wanted.token,
                wanted.number,
                wanted.expires_at,
            )
        if ask.action is LeaseAction.ACQUIRE:
            lease = desk.acquire(ask.name, now)
        elif ask.action is LeaseAction.RENEW:
            lease = desk.renew(ask.token, now)
        else:
            lease = desk.confirm(ask.token, now)
        self._tokens[lease.number] = lease.token
        return LeaseGranted(ask.id, lease.name, lease.token, lease.number)

    # -- setpoints -------------------------------------------------------------------------------

    def _on_steer(self, steer: Steer) -> None:
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
            self._agent.steer(self._token(steer.fence), steer.setpoint, steer.lifetime)
        except M100Error as error:
            self._before_outcome()
            self.tell(SteerRefused(steer.fence, Fault.of(error)))

    # -- everything else -------------------------------------------------------------------------

    def _may_note(self) -> bool:
        """Whether one more event of this front is not one of very many."""
        now = self._agent.now
        gained = (now - self._noted_at) * _NOTES_PER_S
        self._notes, self._noted_at = min(_MAX_NOTES, self._notes + gained), now
        if self._notes < 1.0:
            return False
        self._notes -= 1.0
        return True

    def _on_note(self, note: Note) -> None:
        if note.level in LEVELS and self._may_note():
            self._agent.journal.note(_line(note.text), note.level)

    def _on_ask(self, ask: Ask) -> None:
        if ask.action is Action.HALT:
            self._agent.halt(ask.text, self._token(ask.fence))
            self._tell_halt(ask.text)
            if self._unbegun:
                # What was asked for before it begins first, and is halted then.
                self._agent.background.spawn(self._halt(ask), f"halt for {self._name}")
            self._answer(ask, Stage.DONE)
            return
        self._spawn(
            ask,
            ask.action.value,
            lambda: self._orders.doing(
                ask, self._token(ask.fence), lambda: self._answer(ask, Stage.ACCEPTED)
            ),
        )

    async def _halt(self, ask: Ask) -> None:
        self._agent.halt(ask.text, self._token(ask.fence))

    def _tell_halt(self, why: str) -> None:
        """Tell whoever flies that somebody else had it hover: more may be to come of its flight."""
        holder = self._agent.desk.holder(self._agent.now)
        if holder is not None and holder.number not in self._tokens and self._may_note():
            self._agent.journal.note(_line(why or f"{self._name}: hover"), "info", Topic.HALTED)

    def _on_guided(self, order: GuidedOrder) -> None:
        self._spawn(
            order,
            name_of(order),
            lambda: self._agent.guide(
                self._token(order.fence), order, lambda: self._answer(order, Stage.ACCEPTED)
            ),
        )

    def _uploaded(self, plan: WaypointPlan) -> None:
        lease = self._agent.desk.holder(self._agent.now)
        who = lease.name if lease is not None else self._name
        self._agent.journal.note(f"{who} uploaded a plan of {len(plan.waypoints)} waypoints")
        self._on_plan(told_of(plan, who))

    def _spawn(
        self, ask: Ask | GuidedOrder, name: str, doing: Callable[[], Awaitable[Result | None]]
    ) -> None:
        if self._asks >= _MAX_ASKS:
            error = UsageError(f"{self._asks} questions of this front wait already")
            self._answer(ask, Stage.FAILED, error)
        else:
            self._asks += 1
            self._unbegun += 1
            self._agent.background.spawn(self._carry_out(ask, doing), f"{name} for {self._name}")

    def _answer(
        self,
        ask: Ask | GuidedOrder,
        stage: Stage,
        error: M100Error | None = None,
        result: Result = ("", 0),
    ) -> None:
        self._before_outcome()
        if ask.id:
            self.tell(Outcome(ask.id, stage, fault_of(error), *result))

    async def _carry_out(
        self, ask: Ask | GuidedOrder, doing: Callable[[], Awaitable[Result | None]]
    ) -> None:
        self._unbegun -= 1
        try:
            result = await doing()
        except M100Error as error:
            self._answer(ask, Stage.FAILED, error)
        except Exception:
            fault = MessageError("the agent failed", remedy="see its log; report it")
            self._answer(ask, Stage.FAILED, fault)
            raise
        else:
            self._answer(ask, Stage.DONE, result=result or ("", 0))
        finally:
            self._asks -= 1


def _line(text: str) -> str:
    """One line that is fit to be shown: strangers' names are in it, and a terminal obeys some."""
    return "".join(
        one if one.isprintable() else "\N{REPLACEMENT CHARACTER}" for one in text[:_MAX_NOTE]
    )


# -- what an agent does when a front asks for it ---------------------------------------------------


Result = tuple[str, int]
"""Text and number of an outcome."""

_TASKS = {Action.TAKE_OFF: Task.TAKE_OFF, Action.LAND: Task.LAND, Action.GO_HOME: Task.GO_HOME}


class Orders:
    """What one front may ask for, and the plan that it has uploaded."""

    def __init__(self, agent: Agent, on_plan: Callable[[WaypointPlan], None]) -> None:
        self._agent = agent
        self._on_plan = on_plan
        self._staged, self._staged_under = StagedPlan(), 0  # the lease that it came under

    def doing(self, ask: Ask, token: str, accepted: Callable[[], None]) -> Awaitable[Result | None]:
        """What carries a question out, to be awaited; without a lease the token is empty."""
        agent = self._agent
        task = _TASKS.get(ask.action)
        if task is not None:
            return agent.fly(token, task, accepted)
        doing: dict[Action, Callable[[], Awaitable[Result | None]]] = {
            Action.ACTIVATE: lambda: self._activate(token),
            Action.OBTAIN: lambda: agent.obtain(token),
            Action.RELEASE: lambda: agent.release(token),
            Action.PATTERN: lambda: self._start_pattern(token, ask.number),
            Action.STOP: agent.stop,
            Action.GIMBAL_ANGLES: lambda: agent.move_gimbal(token, read(GimbalAngle, ask.data)),
            Action.GIMBAL_RATES: lambda: agent.move_gimbal(token, read(GimbalSpeed, ask.data)),
            Action.TAKE_PHOTO: lambda: agent.use_camera(token, AircraftCamera.take_photo),
            Action.START_VIDEO: lambda: agent.use_camera(token, AircraftCamera.start_video),
            Action.STOP_VIDEO: lambda: agent.use_camera(token, AircraftCamera.stop_video),
            Action.ARM: lambda: agent.switch_motors(token, on=True),
            Action.DISARM: lambda: agent.switch_motors(token, on=False),
            Action.MISSION_PLAN: lambda: self._stage(token, ask),
            Action.MISSION_POINT: lambda: self._stage(token, ask),
            Action.MISSION_START: lambda: self._start_mission(token, ask, accepted),
            Action.HOTPOINT_START: lambda: agent.fly_hotpoint(token, read(HotpointStart, ask.data)),
            Action.HOTPOINT_RADIUS: lambda: agent.set_hotpoint(token, radius=ask.number / 1000),
            Action.HOTPOINT_RATE: lambda: agent.set_hotpoint(token, rate=ask.number / 1000),
            Action.HOTPOINT_HEADING: lambda: agent.set_hotpoint(token),
            Action.MISSION_STOP: lambda: agent.order_mission(token, "stop"),
            Action.MISSION_PAUSE: lambda: agent.order_mission(token, "pause"),
            Action.MISSION_RESUME: lambda: agent.order_mission(token, "resume"),
            Action.MISSION_SPEED: lambda: self._set_speed(token, ask.number / 1000),
            Action.VERSION: self._version,
            Action.REPLAY: lambda: agent.order_replay(ask.data.decode("ascii", "replace")),
            Action.SEND_TO_MOBILE: lambda: agent.send_to_mobile(token, ask.data),
        }
        return doing[ask.action]()

    async def _activate(self, token: str) -> None:
        await self._agent.activate(token or None)

    async def _start_pattern(self, token: str, number: int) -> None:
        self._agent.start_pattern(token, f"simple task {number}", pattern(number))

    async def _stage(self, token: str, ask: Ask) -> None:
        """A piece of a plan: nothing is asked of the aircraft before the start."""
        self._agent.desk.check(token, self._agent.now)
        if ask.action is Action.MISSION_PLAN:
            self._staged_under = ask.fence
            self._staged.begin(read(WaypointMission, ask.data))
        else:
            staged = self._plan_of(ask)
            staged.add(read(WaypointPoint, ask.data))
            if staged.plan is not None:
                self._on_plan(staged.plan)

    async def _start_mission(self, token: str, ask: Ask, accepted: Callable[[], None]) -> None:
        await self._agent.fly_mission(
            token,
            self._plan_of(ask).require(),
            take_off=bool(ask.number & TAKE_OFF_FIRST),
            begun=accepted if ask.number & UNTIL_OVER else None,
        )

    def _plan_of(self, ask: Ask) -> StagedPlan:
        """The plan that came under this lease: nobody flies what somebody else left."""
        if self._staged_under != ask.fence:
            raise UsageError(
                "no plan was uploaded under this lease", remedy="upload it again, then start"
            )
        return self._staged

    async def _set_speed(self, token: str, speed: float) -> Result:
        return "", round(await self._agent.set_mission_speed(token, speed) * 1000)

    async def _version(self) -> Result:
        version = await self._agent.version()
        return version.name, version.crc
