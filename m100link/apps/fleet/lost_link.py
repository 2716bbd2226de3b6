"""The lost-link action: what does when does without its operator.

It hovers first, without any code here: a setpoint that nobody renews expires in a fifth of a
second. This module ends the hovering: when the lease ended because its holder fell silent in
flight, and nobody else took it, the aircraft lands or goes home after a while. That is cancelled
when anybody is present: an operator takes the lease or presses STOP, or the pilot moves a stick of
the remote control or its mode switch.

A killed agent takes its operator's lease with it. For the next agent the order log says under which
lease the aircraft is flown, from the moment at which it obeys until somebody lets go.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Literal, get_args

from m100link.apps.agent.background import is_set_within
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.lease import LeaseChange, LeaseHeld
from m100link.apps.agent.messages import Event, EventTopic, LeaseChanged
from m100link.apps.agent.orders import GoHome, Land, Order
from m100link.apps.fleet.order_log import LastFlightRecord, OrderLog
from m100link.errors import AuthorityLost, LossReason, M100Error, UsageError
from m100link.protocol.records import FlightPhase, RemoteControl

INHERITED_S = 300.0
"""Seconds after which the next agent leaves an aircraft in the air alone: the pilot with the remote
control may have flown it since, unseen by the agent."""

LostAction = Literal["hover", "land", "home"]

_TASKS: dict[LostAction, Order] = {"land": Land(), "home": GoHome()}
_WHAT: dict[Order, str] = {Land(): "lands", GoHome(): "goes home"}
_GROUND = (FlightPhase.STANDBY, FlightPhase.FINISHING_LANDING)
_LOST = (LeaseChange.EXPIRED, LeaseChange.FRONT_LOST)
_AGAIN_S = 5.0
_LOOK_S = 0.1
_STICK = 1000  # of 10000: more than a stick moves by itself
_MOST_S = 3600.0


@dataclass(frozen=True, slots=True)
class LostLinkPlan:
    # ``hover``, and control authority goes back to the pilot with the remote control; ``land`` in
    # place, or go ``home``.
    action: LostAction = "hover"
    after_s: float = 10.0  # seconds after the lease has ended

    def __post_init__(self) -> None:
        if self.action not in get_args(LostAction):
            raise UsageError(
                f"there is no action {self.action!r} for a lost operator",
                remedy="choose hover, land or home",
            )
        if not 0.0 <= self.after_s <= _MOST_S:
            raise UsageError(
                f"lost_after is {self.after_s:g} s", remedy=f"choose 0 to {_MOST_S:g} s"
            )


class LostLinkAction:
    def __init__(
        self,
        client: AgentClient,  # what knows the agent
        plan: LostLinkPlan,  # what to do
        # Brings it down, for a reason, and takes the lease from nobody.
        descend: Callable[[Order, str], Awaitable[None]],
        last_flight: LastFlight,  # keeps who flies for the agent after this one
    ) -> None:
        self._client = client
        self._last_flight = last_flight
        self._plan = plan
        self._descend = descend
        self._waiting: asyncio.Task[None] | None = None
        self._is_descending = False
        # Whether the line was lost under this lease: nobody took what was held.
        self._is_line_lost = False
        # The sign that somebody is there; empty for none.
        self._somebody = ""
        client.on_lease.append(self._lease_changed)
        client.on_authority_taken.append(self._authority_taken)
        client.on_event.append(self._event)

    def _lease_changed(self, change: LeaseChanged) -> None:
        # The state is still that of the lease before: a lease alone flies nothing.
        was_flying = self._client.state.has_authority or self._is_line_lost
        self._is_line_lost = False
        if change.number:
            if not self._is_descending:
                if self._waiting is not None:
                    self._waiting.cancel()
                    self._waiting = None
                self._last_flight.flown_under(change.number if was_flying else 0)
            return
        if change.why in _LOST and was_flying:
            self._bereave()
        elif not self._is_waiting:
            self._last_flight.flown_under(0)

    @property
    def _is_waiting(self) -> bool:
        return self._waiting is not None and not self._waiting.done()

    def _bereave(self) -> None:
        task = _TASKS.get(self._plan.action)
        if task is None:
            self._last_flight.flown_under(0)
        elif not self._is_waiting:
            self._somebody = ""
            self._waiting = self._client.background.spawn(self._bring_down(task), "operator lost")

    def _authority_taken(self, error: AuthorityLost) -> None:
        self._is_line_lost = error.reason == LossReason.LINK
        if not self._is_line_lost:
            self._somebody = "control authority was taken"
            if not self._is_waiting:
                self._last_flight.flown_under(0)  # the pilot flies; back in F it is obtained anew

    def _event(self, event: Event) -> None:
        if event.topic is EventTopic.STOPPED:
            self._somebody = "STOP was pressed"
        # The agent reports its state before the events that follow from it.
        client = self._client
        if client.holder.number and client.state.has_authority:
            self._last_flight.flown_under(client.holder.number)
        elif client.holder.number and client.state.holding == "releasing" and not self._is_waiting:
            self._last_flight.flown_under(0)

    # -- whom the agent before lost --------------------------------------------------------------

    def inherit(self, left: LastFlightRecord | None) -> None:
        """Take care of an aircraft that the previous agent left in the air.

        ``left``: what its order log says; None: no operator of the fleet flew.
        """
        if left is not None:
            self._waiting = self._client.background.spawn(self._inherit(left), "operator lost")

    async def _inherit(self, left: LastFlightRecord) -> None:
        client, task = self._client, _TASKS.get(self._plan.action)
        whose = f"the previous agent ended while the aircraft flew under lease {left.fence}"
        ago = INHERITED_S if left.ago_s is None else left.ago_s
        phase = await self._phase_within(INHERITED_S - ago)
        if phase in _GROUND:
            client.note(f"{whose}, which is on the ground now")
        elif phase is None:
            client.note(
                f"{whose}, perhaps more than {INHERITED_S:g} s ago: if the aircraft is in the air, "
                "it is left to the pilot with the remote control",
                "error",
            )
        elif task is None:
            client.note(f"{whose}: it is left to the pilot with the remote control", "warning")
        else:
            client.note(whose, "warning")
            self._somebody = ""
            await self._bring_down(task)
            return
        self._last_flight.flown_under(0)

    async def _phase_within(self, seconds: float) -> FlightPhase | None:
        """The flight phase as soon as the aircraft reports one; None: not in time."""
        client = self._client
        until = client.now + seconds
        while client.now < until:
            if (phase := client.view.phase) is not None:
                return phase
            await asyncio.sleep(_LOOK_S)
        return None

    # -- down ------------------------------------------------------------------------------------

    async def _bring_down(self, task: Order) -> None:
        after = self._plan.after_s
        text = f"the operator is lost: the aircraft hovers, and {_WHAT[task]} in {after:g} s"
        self._client.note(text, "warning")
        while await self._nobody_came(after):
            self._is_descending = True
            try:
                await self._descend(task, f"operator lost ({self._plan.action})")
            except LeaseHeld:
                return  # by somebody who is there
            except Exception as error:  # noqa: BLE001 (reported): whatever failed, nobody else lands it
                why = error.seen if isinstance(error, M100Error) else "the agent failed"
                self._client.note(f"the operator is lost, and it did not land: {why}", "error")
            else:
                self._last_flight.flown_under(0)
                return
            finally:
                self._is_descending = False
            if self._client.holder.number:
                return
            after = _AGAIN_S
        text = f"the operator is lost, but {self._somebody}: the aircraft is left alone"
        self._client.note(text, "warning")
        self._last_flight.flown_under(0)

    async def _nobody_came(self, within: float) -> bool:
        """Wait; whether nobody showed meanwhile that he is there."""
        clock = asyncio.get_running_loop().time
        until = clock() + within
        while True:
            self._somebody = self._somebody or self._by_remote()
            left = until - clock()
            if self._somebody or left <= 0.0:
                return not self._somebody
            await asyncio.sleep(min(_LOOK_S, left))

    def _by_remote(self) -> str:
        """The control's action on the pilot does; empty when it is left alone."""
        remote = self._client.view.get(RemoteControl)
        if remote is None:
            return ""
        if not remote.is_heard:
            return "the remote control is not heard"
        if not remote.is_in_f:
            return "the remote control is not in F"
        sticks = (remote.roll, remote.pitch, remote.yaw, remote.throttle)
        return "a stick was moved" if max(map(abs, sticks)) > _STICK else ""


# -- under which lease an aircraft flies, kept in the order log for the agent after this one -------


KEPT_AGAIN_S = 30.0
"""Seconds after which it is written again while somebody flies, so that its age means something."""


class LastFlight:
    def __init__(self, client: AgentClient, order_log: OrderLog) -> None:
        self._client = client
        self._order_log = order_log
        self._number = 0 if order_log.last_flight is None else order_log.last_flight.fence
        self._changed = asyncio.Event()

    def flown_under(self, number: int) -> None:
        """From now on it is flown under the lease of that number; 0: under none."""
        if number != self._number:
            self._number = number
            self._changed.set()

    async def keep(self) -> None:
        """Write what changes, until this is cancelled.

        An order under a lease, given after control was obtained, is written behind it, so no task
        begins of which the agent after this one would not know whose it was.
        """
        is_kept = True
        while True:
            is_due = self._number or not is_kept  # it still flies, or nobody would know
            await is_set_within(self._changed, KEPT_AGAIN_S if is_due else None)
            self._changed.clear()
            try:
                await self._order_log.flies(self._number)
                is_kept = True
            except M100Error as error:
                is_kept = False
                self._client.note(f"the order log does not keep who flies: {error.seen}", "error")
