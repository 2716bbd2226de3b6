"""One front, as its agent sees it: what it says, what it is told, and the leases that it has.

Nothing that a front sends raises out of here: a question has an outcome, a setpoint that is not
flown has an answer, and what has no meaning ends the connection. When a front has gone, the leases
that it was granted end: the aircraft hovers, and control authority goes back.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from m100link.apps.agent.agent import Agent
from m100link.apps.agent.carriers import Channel
from m100link.apps.agent.fault import Fault, MessageError, fault_of
from m100link.apps.agent.guided import GuidedOrder, name_of
from m100link.apps.agent.lease import LeaseChange, LeaseRefused
from m100link.apps.agent.messages import (
    VERSION,
    Action,
    Ask,
    Hello,
    LeaseAction,
    LeaseAsk,
    LeaseChanged,
    LeaseGranted,
    Message,
    Note,
    Outcome,
    PlanTold,
    Stage,
    State,
    Steer,
    SteerRefused,
    TakeOverOffered,
    Topic,
)
from m100link.apps.agent.orders import Orders, Result
from m100link.apps.agent.plan_told import told_of
from m100link.apps.agent.replays import refused
from m100link.errors import GuardRefused, M100Error, UsageError
from m100link.missions.plan import WaypointPlan

__all__ = ["MAX_SETPOINT_AGE", "Front"]

MAX_SETPOINT_AGE = 0.3
"""Seconds that a setpoint may have been on its way."""

_MAX_ASKS = 64
_MAX_NOTE = 200
_NOTES_PER_S, _MAX_NOTES = 5.0, 20.0
_LEVELS = ("info", "warning", "error")


class Front:
    """One front.

    Args:
        agent: What it asks.
        channel: The way to it.
        on_gone: Called when it has gone.
        before_outcome: Called before each outcome, so that the state is there first.
        on_plan: Called with each plan that it has uploaded.
    """

    def __init__(
        self,
        agent: Agent,
        channel: Channel,
        *,
        on_gone: Callable[[Front], None],
        before_outcome: Callable[[], None],
        on_plan: Callable[[PlanTold], None],
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
        if note.level in _LEVELS and self._may_note():
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
