"""Control of one aircraft in the hands of one client of its agent: a table of states and inputs.

Every front that steers has a :class:`ControlSession` for each of its operators. It takes the lease,
activates the aircraft, obtains control authority, renews the lease while its operator is heard, and
ends when the operator lets go, falls silent, is taken over, or loses the agent. Fronts differ in
:class:`Terms`. The agent decides each time again; what stands here is what it reported last.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from enum import Enum
from functools import partial
from typing import Any

from m100link import errors
from m100link.apps.agent import orders
from m100link.apps.agent.background import goes_on, ignore
from m100link.apps.agent.client import AgentClient, Hearing
from m100link.apps.agent.lease import Lease, LeaseHeld, LeaseRefused, TakeOver
from m100link.apps.agent.messages import Event, EventTopic, LeaseChanged, OrderOutcome
from m100link.apps.agent.orders import SETPOINT_LIFETIME
from m100link.protocol.setpoint import Setpoint

RENEWAL_S = 0.5
"""Seconds between two renewals; a lease lasts 3 s without one."""

_DUE_S = 0.45  # a timer of 0.5 s that wakes a moment early is not to wait for another 0.5 s

_TAKE_OVERS = 3
"""Attempts to take a lease over that changes hands meanwhile."""

BROUGHT_DOWN_S = 60.0
"""Seconds in which a landing that is refused or unanswered is asked for again."""

_BROUGHT_DOWN_AGAIN = (
    errors.AckTimeout,
    errors.BadAck,
    errors.MissionRunning,
    errors.NotObserved,  # from a height a landing lasts longer than anybody waits to see its end
    errors.OutcomeUnknown,
    errors.TaskRefused,
)

_WAYS_DOWN = (orders.Land.label, orders.GoHome.label)

Grant = Callable[[float], Coroutine[Any, Any, Lease]]
"""Asks the agent for a lease that was wanted at that time, s: a STOP since then overtakes it."""


@dataclass(frozen=True, slots=True)
class Terms:
    """How the holders of control differ."""

    #: Whether control authority brings an activation with it, where the aircraft is not active.
    activates: bool = True
    #: Whether the lease goes back when somebody takes authority. Otherwise it is kept, and the
    #: aircraft obeys again when the pilot comes back to F, after a pause of a second.
    gives_way: bool = False
    #: Whether an order of the operator, who sees that STOP was pressed, begins anew after it.
    begins_anew: bool = False
    idle_s: float = math.inf  #: seconds without use after which control is given back
    who: str = "this client"  #: the client without control, in the error
    remedy: str = "take control first"  #: how control is taken, in the error


class ControlState(Enum):
    """Where control stands for one operator."""

    ABSENT = "absent"  # nothing is held
    ASKING = "asking"  # for the lease
    LEASED = "leased"  # the lease is held, and authority was not asked for
    ACTIVATING = "activating"
    OBTAINING = "obtaining"  # authority
    HOLDING = "holding"  # setpoints and tasks are obeyed, as far as is known
    STOPPED = "stopped"  # somebody pressed STOP: setpoints fly once the operator begins anew
    SUSPENDED = "suspended"  # somebody else took authority; the lease is kept
    LETTING_GO = "letting go"
    LOST = "lost"  # the lease expired, or the agent has gone
    TAKEN_OVER = "taken over"  # somebody else has the lease


class ControlInput(Enum):
    """The inputs of the table."""

    ASKED = "asked"  # the operator wants the lease
    GRANTED = "granted"  # the agent gave it, or another session handed it on
    ACTIVATE = "activate"
    OBTAIN = "obtain"
    OBEYED = "obeyed"  # authority is held
    REFUSED = "refused"  # the lease, to this operator
    STOP = "stop"  # by anybody
    BEGUN_ANEW = "begun anew"  # the operator let go of everything after a STOP
    LET_GO = "let go"
    GIVEN_BACK = "given back"
    AUTHORITY_TAKEN = "authority taken"  # by the switch, the app, or unknown
    ENDED = "ended"  # nobody has the lease any more
    OTHER = "other"  # somebody else has it


_S, _I = ControlState, ControlInput

_OBEYED = (_S.HOLDING, _S.STOPPED)
_FREE = {_I.ASKED: _S.ASKING, _I.GRANTED: _S.LEASED}
_LEASE = {
    _I.OBTAIN: _S.OBTAINING,
    _I.GRANTED: _S.LEASED,  # another one: a take-over of one's own
    _I.LET_GO: _S.LETTING_GO,
    _I.ENDED: _S.LOST,
    _I.OTHER: _S.TAKEN_OVER,
}
_TAKEN = {_I.AUTHORITY_TAKEN: _S.SUSPENDED}

TRANSITIONS: dict[ControlState, dict[ControlInput, ControlState]] = {
    _S.ABSENT: _FREE,
    _S.ASKING: {_I.GRANTED: _S.LEASED, _I.REFUSED: _S.ABSENT, _I.LET_GO: _S.LETTING_GO},
    _S.LEASED: _LEASE | {_I.ACTIVATE: _S.ACTIVATING},
    _S.ACTIVATING: _LEASE,
    _S.OBTAINING: _LEASE | {_I.OBEYED: _S.HOLDING, _I.STOP: _S.STOPPED},
    _S.HOLDING: _LEASE | _TAKEN | {_I.STOP: _S.STOPPED},
    _S.STOPPED: _LEASE | _TAKEN | {_I.BEGUN_ANEW: _S.HOLDING},
    _S.SUSPENDED: _LEASE | {_I.OBEYED: _S.HOLDING},  # the pilot came back to F
    _S.LETTING_GO: {
        _I.GRANTED: _S.LEASED,  # another one, that was handed on meanwhile
        **dict.fromkeys((_I.GIVEN_BACK, _I.REFUSED, _I.ENDED, _I.OTHER), _S.ABSENT),
    },
    _S.LOST: _FREE | {_I.LET_GO: _S.ABSENT},
    _S.TAKEN_OVER: _FREE | {_I.LET_GO: _S.ABSENT},
}
"""State, input, next state. A pair that is not in the table changes nothing."""


class ControlSession:
    """Control of one aircraft, for one operator.

    A front calls :meth:`heard` twice a second while its operator is there: three seconds after the
    last call, or the last setpoint, the lease ends. It sets ``on_refused``, the only sign of a
    setpoint that the agent did not fly, and calls :meth:`leave` or :meth:`close` when its operator
    has gone. A landing or go-home that was asked for goes on until the aircraft is on the ground.
    """

    def __init__(
        self,
        agent: AgentClient,
        name: str,  # of the operator, for people
        terms: Terms = Terms(),
    ) -> None:
        self._agent = agent
        self.name = name
        self._terms = terms
        self._state = ControlState.ABSENT
        self._lease: Lease | None = None  # the newest one, in force or not
        self._agents_before = agent.agents_before  # as that one was granted
        self._number = 0  # of the newest lease that was granted here, wanted or not
        #: How the lease was lost, and to whom; None while it is held or went back.
        self.lease_end: LeaseChanged | None = None
        #: Why authority was lost; None while it is held, and without a lease.
        self.loss: errors.LossReason | None = None
        #: Digest of the plan that this operator uploaded last, and starts; empty for none.
        self.uploaded = ""
        #: Called with each new state.
        self.on_change: Callable[[ControlState], None] = ignore
        #: Called with why a setpoint of this operator was not flown.
        self.on_refused: Callable[[errors.M100Error], None] = ignore
        # One request for control, or its end, at a time: they would cross.
        self._changing = asyncio.Lock()
        self._let_gos = 0  # what was asked for before the newest one is not wanted any more
        # The newest landing or go-home that its operator asked for, and how many there were.
        self._way_down: asyncio.Task[OrderOutcome] | None = None
        self._ways_down = 0
        self._renewed_at = self._used_at = agent.now
        self._heard: list[tuple[list[Any], Callable[..., None]]] = [
            (agent.on_lease, self._lease_changed),
            (agent.on_authority_taken, self._authority_taken),
            (agent.on_event, self._event),
            (agent.on_steer_refused, self._steer_refused),
        ]
        for callbacks, callback in self._heard:
            callbacks.append(callback)

    def close(self) -> None:
        """As :meth:`leave`, and hear no more: it never holds a lease again."""
        # First: a request that is under way gives its lease back from here on (adopt).
        heard, self._heard = self._heard, []
        for callbacks, callback in heard:
            callbacks.remove(callback)
        self.leave()

    # -- where it stands -------------------------------------------------------------------------

    @property
    def state(self) -> ControlState:
        """The state of control, as far as the agent has reported it."""
        self._look()
        return self._state

    def _look(self) -> None:
        if self._lease is not None and not self._agent.holds(self._lease):
            # An agent that has gone, or was started anew, tells of no end.
            self.feed(_I.OTHER if self._agent.holder.number else _I.ENDED)

    @property
    def lease(self) -> Lease | None:
        """The lease, if it is in force."""
        return self._lease if self.has_lease else None

    @property
    def has_lease(self) -> bool:
        """Whether this operator may steer."""
        return self._lease is not None and self._lease.number == self._agent.holder.number

    @property
    def has_control(self) -> bool:
        """Whether the aircraft obeys this operator."""
        return self.has_lease and self._agent.has_authority

    @property
    def is_obeyed(self) -> bool:
        """The same, and its operator heard so, and was heard again since the last loss.

        True after a STOP, too: tasks are obeyed then, and setpoints after :meth:`begin_anew`.
        """
        lease, view = self._lease, self._agent.view  # asked many times in each step
        if lease is None or lease.number != view.holder.number:
            return False
        return self._state in _OBEYED and view.has_authority

    @property
    def is_others(self) -> bool:
        """Whether another client has the lease, perhaps a later one than any of this operator."""
        return self._agent.holder.number not in (0, self._number)

    @property
    def is_changing(self) -> bool:
        """Whether control is being asked for or given back."""
        return self._changing.locked()

    def held(self) -> Lease:
        """The lease, where the aircraft obeys this operator.

        Raises:
            NoAuthority: Control is not held, or the agent is not heard.
        """
        lease, view = self._lease, self._agent.view
        if lease is None or lease.number != view.holder.number or not view.has_authority:
            raise self._no_control()
        return lease

    def _no_control(self) -> errors.NoAuthority:
        view, holder, who = self._agent.view, self._agent.holder, self._terms.who
        if view.hearing is not Hearing.HEARD:
            silent = f"has said nothing for {view.at - view.heard_at:.0f} s"
            why = "has gone" if view.is_gone else silent
            return errors.NoAuthority(
                f"the agent that owns the aircraft {why}; nothing was sent",
                cause="its process, or the way to it, has ended or stands still",
                remedy="look at the aircraft; the pilot gets it by leaving F",
            )
        other = f": {holder.name} has control" if holder.number and not self.has_lease else ""
        return errors.NoAuthority(
            f"{who} has no control{other}; nothing was sent",
            cause="control was not asked for, or was lost since",
            remedy=self._terms.remedy,
        )

    def feed(self, what: ControlInput) -> None:
        """Go where the table leads; a pair that it does not have changes nothing."""
        after = TRANSITIONS[self._state].get(what)
        if after is None or after is self._state:
            return
        self._state = after
        if after is _S.HOLDING:
            self.loss = None
        self.on_change(after)

    # -- control is taken ------------------------------------------------------------------------

    @asynccontextmanager
    async def _request(self, at: float | None = None) -> AsyncIterator[float]:
        """One request at a time; a request that waits for another ends by :meth:`let_go`, too.

        Yields when it was made: a STOP since then overtakes each of its steps.
        """
        began, made_at = self._let_gos, self._agent.asked_at if at is None else at
        async with self._changing:
            if began != self._let_gos or not self._heard:
                raise self._not_wanted()
            yield made_at

    async def take(self, grant: Grant | None = None, *, take_over: bool = False) -> Lease:
        """Take the lease, if it is not held already: from its holder, too, where ``take_over``.

        With ``grant``, a question of the caller's own, whatever lease that brings is held.

        Raises:
            LeaseHeld: Somebody else has it.
            NoAuthority: It was let go before it came.
            LinkError: The agent has gone.
        """
        async with self._request() as asked_at:
            held = None if grant is not None else self.lease
            return held or await self._take(grant or partial(self._granted, take_over), asked_at)

    async def _take(self, grant: Grant, asked_at: float) -> Lease:
        # Counted, because it may be let go while the agent is asked: then a late lease goes back.
        began = self._let_gos
        self._look()
        if not self.has_lease:
            self._forget()
        self.feed(_I.ASKED)
        asking = self._agent.background.spawn(grant(asked_at), "lease")
        # Shielded: a lease that is granted behind a cancellation would be held by nobody for 3 s.
        try:
            await asyncio.wait([asking])
            lease: Lease = asking.result()
        except BaseException as error:
            if isinstance(error, asyncio.CancelledError):
                asking.add_done_callback(self._unwanted)  # it gives a late lease back
            self.feed(_I.REFUSED)
            raise
        self._number = lease.number
        if began != self._let_gos:
            self._agent.let_go(lease)
            self.feed(_I.GIVEN_BACK)
            raise self._not_wanted()
        self.adopt(lease)
        return lease

    async def _granted(self, take_over: bool, asked_at: float) -> Lease:
        agent = self._agent
        for left in reversed(range(_TAKE_OVERS)):
            try:
                return await agent.acquire(self.name, asked_at)
            except LeaseHeld:
                if not take_over:
                    raise
            try:
                offer = await agent.ask_take_over(self.name, asked_at)
                return await agent.confirm(offer.token, asked_at)
            except (LeaseRefused, errors.StaleLease):  # it ended, or went to another one, meanwhile
                if not left:
                    raise
        raise AssertionError("the last attempt returns or raises")

    def _unwanted(self, asking: asyncio.Task[Lease]) -> None:
        if not asking.cancelled() and asking.exception() is None:
            self._number = asking.result().number
            self._agent.let_go(asking.result())

    async def obtain(self, *, take_over: bool = False, asked_at: float | None = None) -> None:
        """Take the lease and control authority; a STOP is over. A failure gives the lease back.

        ``asked_at``: when it was wanted, s, if not now: a STOP since then overtakes it.

        Raises:
            LeaseHeld: Somebody else has the lease.
            NoAuthority: Control was let go before it was obtained.
            M100Error: As :meth:`m100link.apps.agent.client.AgentClient.ask`.
        """
        async with self._request(asked_at) as made_at:
            lease = self.lease or await self._take(partial(self._granted, take_over), made_at)
            await self._obtain(lease, made_at)

    async def _obtain(self, lease: Lease, asked_at: float) -> None:
        try:
            if self._terms.activates and not self._agent.state.is_activated:
                self.feed(_I.ACTIVATE)
                await self._agent.ask(orders.Activate(), lease, asked_at=asked_at)
                self._require(lease)
            self.feed(_I.OBTAIN)
            await self._agent.ask(orders.Obtain(), lease, asked_at=asked_at)
            self._require(lease)
            self.feed(_I.OBEYED)
        except BaseException as error:
            is_unwanted = self._lease is not lease
            self._end(lease)
            if is_unwanted and isinstance(error, errors.M100Error):
                raise self._not_wanted() from error
            raise
        self._used_at = self._agent.now

    def _require(self, lease: Lease) -> None:
        if self._lease is not lease:
            raise self._not_wanted()

    def _not_wanted(self) -> errors.NoAuthority:
        return errors.NoAuthority(
            f"{self.name} gave control back before it was obtained", remedy="take control again"
        )

    async def ask_take_over(self) -> TakeOver:
        """First step of a take-over. Raises as the agent's client."""
        return await self._agent.ask_take_over(self.name)

    async def confirm(self, wanted: TakeOver) -> None:
        """Second step: take the lease from the client that the first step named, and authority.

        Raises:
            LeaseRefused: There is nothing to confirm any more.
            M100Error: As :meth:`obtain`.
        """
        async with self._request() as made_at:
            lease = await self._take(partial(self._agent.confirm, wanted.token), made_at)
            await self._obtain(lease, made_at)

    def adopt(self, lease: Lease) -> None:
        """Hold a lease that was granted to this operator."""
        if not self._heard:
            self._agent.let_go(lease)
        elif self._lease != lease:
            self._forget()
            self._lease, self._number, self.lease_end = lease, lease.number, None
            self._agents_before = self._agent.agents_before
            self._renewed_at = self._used_at = self._agent.now
            self.feed(_I.GRANTED)

    def _forget(self) -> None:
        self._lease = self.loss = None

    # -- control is given back -------------------------------------------------------------------

    def let_go(self) -> None:
        """Give the lease back at once: motion stops, and authority goes back."""
        self._let_gos += 1
        if (lease := self._lease) is not None:
            self._end(lease)
        self.feed(_I.LET_GO)

    def leave(self) -> None:
        """The operator has gone: :meth:`let_go`, at the end of a landing that was asked for."""
        down = self._way_down
        if down is None or down.done() or not self.has_lease:
            self.let_go()
        else:
            down.add_done_callback(lambda _: self.let_go())

    def _end(self, lease: Lease) -> None:
        is_newest, is_in_force = self._lease is lease, self._agent.holds(lease)
        if is_newest:
            self._forget()
        if is_in_force:
            self._agent.let_go(lease)  # before the callbacks, which may raise
        if is_newest:
            try:
                if self._state not in (_S.LOST, _S.TAKEN_OVER):  # which stay as they are
                    self.feed(_I.LET_GO)
            finally:
                self.feed(_I.GIVEN_BACK)

    async def give_back(self) -> None:
        """Give the lease back; done when it is, or when nobody can tell any more."""
        if self.is_changing:
            self.let_go()  # the request under way ends by that, and may wait for long
            return
        self._let_gos += 1  # at once: one may be next in the line, and would obtain control first
        async with self._changing:
            lease = self.lease
            self._forget()
            try:
                self.feed(_I.LET_GO)
            finally:
                try:
                    if lease is not None:
                        with suppress(errors.M100Error):  # it ended meanwhile, as wanted
                            await self._agent.release_lease(lease.token)
                finally:
                    self.feed(_I.GIVEN_BACK)

    # -- while it is held ------------------------------------------------------------------------

    def heard(self, *, is_idle: bool = False) -> None:
        """The operator is there: the lease lasts three more seconds.

        A front that calls this for an operator who is silent keeps the aircraft from all others.
        ``is_idle``: nothing is wanted of the aircraft.
        """
        agent, lease, now = self._agent, self._lease, self._agent.now
        if lease is None or lease.number != agent.holder.number:
            self._look()
            return
        if self._state is _S.SUSPENDED and agent.has_authority:
            self.feed(_I.OBEYED)
        if not is_idle:
            self._used_at = now
        if now - self._used_at >= self._terms.idle_s and not self.is_changing:
            self.let_go()
            idle = f"no order in {self._terms.idle_s:g} s"
            agent.note(f"{self._terms.who} gives control back: {idle}")
        elif now - self._renewed_at >= _DUE_S:
            self._renewed_at = now
            agent.keep(lease)

    async def keep(self) -> None:
        """Call :meth:`heard` twice a second until it is cancelled; nobody looks at the operator."""
        while self._heard or self.has_lease:  # until the session is closed, too
            with goes_on("the renewal of a lease"):  # it is that of a landing, maybe
                self.heard()
            await asyncio.sleep(RENEWAL_S)

    @asynccontextmanager
    async def kept(self) -> AsyncIterator[None]:
        """The same while the block runs: the operator is the task in it."""
        keeping = self._agent.background.spawn(self.keep(), f"lease of {self.name}")
        try:
            yield
        finally:
            keeping.cancel()

    async def ask(
        self, order: orders.Order, accepted: Callable[[], None] | None = None
    ) -> OrderOutcome:
        """Ask for something under the lease; returns its outcome, for a task seconds later.

        The front renews the lease meanwhile: a take-off lasts longer than a lease.

        Raises:
            NoAuthority: It needs the lease, which is not held; nothing was sent.
            M100Error: As the agent's client.
        """
        if (lease := self.lease) is None and order.needs is orders.Needs.LEASE:
            raise self._no_control()
        self._used_at, asked_at = self._agent.now, self._agent.asked_at
        try:
            is_anew = self._terms.begins_anew and order.after_stop is orders.AfterStop.ANEW
            if is_anew and self._state is _S.STOPPED:
                await self._agent.ask(orders.Obtain(), lease, asked_at=asked_at)
                self.feed(_I.BEGUN_ANEW)
            is_down = isinstance(order, orders.Land | orders.GoHome)
            if is_down and self._agent.state.task not in _WAYS_DOWN:
                work = self._brought_down(order, asked_at, accepted)
                way_down = self._way_down = self._agent.background.spawn(work, order.label)
                await asyncio.wait([way_down])
                outcome: OrderOutcome = way_down.result()
            else:
                outcome = await self._agent.ask(order, lease, accepted, asked_at)
        except errors.GuardRefused as error:
            self._met(error)
            raise
        if isinstance(order, orders.UploadPlan):
            self.uploaded = order.digest
        return outcome

    def steer(self, setpoint: Setpoint, lifetime: float = SETPOINT_LIFETIME) -> None:
        """Fly this for its lifetime, s. A refusal comes to ``on_refused``, after this returned.

        It goes to an agent that is heard, even while somebody else has authority.

        Raises:
            NoAuthority: The lease is not held, or the agent is not heard.
        """
        lease, view = self._lease, self._agent.view
        # Sent without authority, too: held back here, a stream that goes on while the pilot flies
        # would look to the agent like a pause, and fly on when the switch comes back to F.
        if lease is None or lease.number != view.holder.number or view.hearing is not Hearing.HEARD:
            raise self._no_control()
        if self._state is _S.SUSPENDED and view.has_authority:
            self.feed(_I.OBEYED)
        self._used_at = self._renewed_at = view.at  # it renews the lease
        self._agent.steer(lease, setpoint, lifetime)

    async def bring_down(
        self, task: orders.Order, asked_at: float, accepted: Callable[[], None] | None = None
    ) -> None:
        """Land, here or at home, unless it stands. Raises as :meth:`ask`.

        Asked again for a minute while it is refused or unanswered: a task that was broken off takes
        its time to end, and without an answer nobody knows. A STOP since ``asked_at`` ends it.
        """
        if self._is_down:
            return
        try:
            await self._brought_down(task, asked_at, accepted)
        except _BROUGHT_DOWN_AGAIN:
            if not self._is_down:
                raise

    @property
    def _is_down(self) -> bool:
        return self._agent.view.is_on_ground is True and not self._agent.state.task

    async def _brought_down(
        self, task: orders.Order, asked_at: float, accepted: Callable[[], None] | None
    ) -> OrderOutcome:
        agent, lease, until = self._agent, self._lease, self._agent.now + BROUGHT_DOWN_S
        self._ways_down = number = self._ways_down + 1
        async with self.kept():  # its operator may have gone
            while True:
                try:
                    return await agent.ask(task, lease, accepted, asked_at)
                except _BROUGHT_DOWN_AGAIN as error:
                    is_unseen = isinstance(error, errors.NotObserved)
                    until = agent.now + BROUGHT_DOWN_S if is_unseen else until
                    await asyncio.sleep(RENEWAL_S)
                    is_late = agent.now >= until or number != self._ways_down
                    is_lost = not agent.holds(lease) or (is_unseen and not agent.has_authority)
                    if is_late or is_lost or self._is_down:
                        raise

    async def stop(self) -> None:
        """Stop all that flies, without a lease, too; :meth:`begin_anew` lets setpoints fly."""
        try:
            self.feed(_I.STOP)
        finally:  # whatever a front makes of it
            await self._agent.stop(self.name)

    def begin_anew(self, why: str = "", at: float = math.inf) -> bool:
        """The operator let go of everything: motion stops, and a STOP is over. Needs the lease.

        ``at``: when at the earliest, s of the client's clock. A STOP since then stands: returns
        whether none does.
        """
        is_anew = at > self._agent.stopped_at
        if (lease := self.lease) is not None:
            self._agent.hover(why, lease, begins_anew=is_anew, at=at)
            if is_anew:
                self.feed(_I.BEGUN_ANEW)
        return is_anew

    # -- what others do --------------------------------------------------------------------------

    def _lease_changed(self, message: LeaseChanged) -> None:
        lease = self._lease
        if lease is None:
            return
        if self._agents_before != self._agent.agents_before:
            self.feed(_I.OTHER if message.number else _I.ENDED)
            self._forget()  # this agent may give the same number to somebody else
            self._number = 0
            return
        # Late: of a lease before this one.
        if 0 < message.number < lease.number:
            return
        if message.number == lease.number:  # the report of its end was wrong
            self.lease_end = None
            if self._state in (_S.LOST, _S.TAKEN_OVER):
                self.feed(_I.GRANTED)
            return
        if self.lease_end is None:
            self.lease_end, self.loss = message, None
        self.feed(_I.OTHER if message.number else _I.ENDED)

    def _authority_taken(self, error: errors.AuthorityLost) -> None:
        if not self.has_lease:
            return
        self.loss = errors.LossReason(error.reason)  # a text once it has been a message
        try:
            self.feed(_I.AUTHORITY_TAKEN)
        finally:
            if self._terms.gives_way:
                self.let_go()

    def _event(self, event: Event) -> None:
        if event.topic is EventTopic.STOPPED:
            self.feed(_I.STOP)

    def _steer_refused(self, fence: int, error: errors.M100Error) -> None:
        lease = self._lease
        if lease is None or lease.number != fence:
            return
        self._met(error)
        self.on_refused(error)

    def _met(self, error: errors.M100Error) -> None:
        if isinstance(error, errors.GuardRefused) and error.guard == "stopped":
            self.feed(_I.STOP)
