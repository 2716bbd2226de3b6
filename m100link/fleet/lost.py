"""What happens to an aircraft whose pilot is lost.

First of all it hovers, with no code for it: a setpoint that nobody renews expires in a fifth of a
second. What this adds is the end of the hovering: when the lease ended because its holder fell
silent while it flew, and nobody else took it, the aircraft lands or goes home after a while. It
stands down for everybody who shows that he is there: who takes the lease, who presses STOP, and the
pilot who moves a stick of the remote control, or its mode switch.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Literal, get_args

from m100link.agent.client import AgentClient
from m100link.agent.lease import LeaseChange, LeaseHeld
from m100link.agent.messages import Event, LeaseChanged, Topic
from m100link.errors import AuthorityLost, LossReason, M100Error, UsageError
from m100link.protocol.commands.control import Task
from m100link.protocol.records import RemoteControl

__all__ = ["Lost", "LostAction", "LostPlan"]

LostAction = Literal["hover", "land", "home"]

_TASKS: dict[LostAction, Task] = {"land": Task.LAND, "home": Task.GO_HOME}
_LOST = (LeaseChange.EXPIRED, LeaseChange.FRONT_LOST)
_AGAIN_S = 5.0
_LOOK_S = 0.1
_FRESH_S = 2.5
_STICK = 1000  # of 10000: more than a stick moves by itself
_MOST_S = 3600.0


@dataclass(frozen=True, slots=True)
class LostPlan:
    """What is done when whoever flies is lost.

    Attributes:
        action: ``hover``, and control authority goes back to the pilot with the remote control;
            ``land`` in place, or go ``home``.
        after_s: Seconds after the lease has ended.
    """

    action: LostAction = "hover"
    after_s: float = 10.0

    def __post_init__(self) -> None:
        if self.action not in get_args(LostAction):
            raise UsageError(
                f"nothing is known about {self.action!r} when the pilot is lost",
                remedy="choose hover, land or home",
            )
        if not 0.0 <= self.after_s <= _MOST_S:
            raise UsageError(
                f"the pilot cannot be lost for {self.after_s:g} s",
                remedy=f"choose 0 to {_MOST_S:g} s",
            )


class Lost:
    """Watches the lease of one aircraft.

    Args:
        client: What knows the agent.
        plan: What to do.
        descend: Brings it down, for a reason, and takes the lease from nobody.
    """

    def __init__(
        self,
        client: AgentClient,
        plan: LostPlan,
        descend: Callable[[Task, str], Awaitable[None]],
    ) -> None:
        self._client = client
        self._plan = plan
        self._descend = descend
        self._waiting: asyncio.Task[None] | None = None
        self._is_descending = False
        # Whether the line was lost under this lease: nobody took what was held.
        self._is_line_lost = False
        # Who showed that he is there; empty for nobody.
        self._somebody = ""
        client.on_lease.append(self._lease_changed)
        client.on_authority_taken.append(self._authority_taken)
        client.on_event.append(self._event)

    def _lease_changed(self, change: LeaseChanged) -> None:
        # The state is still that of the lease before: a lease alone flies nothing.
        was_flying = self._client.state.has_authority or self._is_line_lost
        self._is_line_lost = False
        if change.number:
            if self._waiting is not None and not self._is_descending:
                self._waiting.cancel()
            return
        task = _TASKS.get(self._plan.action)
        if change.why not in _LOST or task is None or not was_flying:
            return
        if self._waiting is None or self._waiting.done():
            self._somebody = ""
            self._waiting = self._client.background.spawn(self._bring_down(task), "pilot lost")

    def _authority_taken(self, error: AuthorityLost) -> None:
        self._is_line_lost = error.reason == LossReason.LINK
        if not self._is_line_lost:
            self._somebody = "control authority was taken"

    def _event(self, event: Event) -> None:
        if event.topic is Topic.STOPPED:
            self._somebody = "STOP was pressed"

    async def _bring_down(self, task: Task) -> None:
        what = "lands" if task is Task.LAND else "goes home"
        after = self._plan.after_s
        self._client.note(f"the pilot is lost: it hovers, and {what} in {after:g} s", "warning")
        while await self._nobody_came(after):
            self._is_descending = True
            try:
                await self._descend(task, f"pilot lost ({self._plan.action})")
            except LeaseHeld:
                return  # by somebody who is there
            except M100Error as error:
                self._client.note(f"the pilot is lost, and it did not land: {error.seen}", "error")
            else:
                return
            finally:
                self._is_descending = False
            if self._client.holder.number:
                return
            after = _AGAIN_S
        self._client.note(f"the pilot is lost, but {self._somebody}: it is left alone", "warning")

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
        """What the remote control shows of its pilot; empty when he leaves it alone."""
        telemetry = self._client.telemetry
        remote = None if telemetry is None else telemetry.fresh(RemoteControl, within=_FRESH_S)
        if remote is None:
            return ""
        if not remote.is_in_f:
            return "the remote control is not in F"
        sticks = (remote.roll, remote.pitch, remote.yaw, remote.throttle)
        return "a stick was moved" if max(map(abs, sticks)) > _STICK else ""
