"""What happens to an aircraft whose pilot is lost.

First of all it hovers, with no code for it: a setpoint that nobody renews expires in a fifth of a
second. What this adds is the end of the hovering: when the lease ended because its holder fell
silent, and nobody else took it, the aircraft lands or goes home after a while.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Literal, get_args

from m100link.agent.client import AgentClient
from m100link.agent.lease import LeaseChange
from m100link.agent.messages import LeaseChanged
from m100link.errors import M100Error, UsageError
from m100link.protocol.commands.control import Task

__all__ = ["Lost", "LostAction", "LostPlan"]

LostAction = Literal["hover", "land", "home"]

_TASKS: dict[LostAction, Task] = {"land": Task.LAND, "home": Task.GO_HOME}
_LOST = (LeaseChange.EXPIRED, LeaseChange.FRONT_LOST)
_AGAIN_S = 5.0
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
        descend: Brings it down, for a reason.
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
        client.on_lease.append(self._lease_changed)

    def _lease_changed(self, change: LeaseChanged) -> None:
        task = _TASKS.get(self._plan.action)
        is_somebody = change.number != 0 and not change.name.startswith(_WHO)
        if self._waiting is not None and is_somebody:
            self._waiting.cancel()
            self._waiting = None
        if change.number or change.why not in _LOST or task is None:
            return
        if self._waiting is None or self._waiting.done():
            self._waiting = self._client.background.spawn(self._bring_down(task), "pilot lost")

    async def _bring_down(self, task: Task) -> None:
        what = "lands" if task is Task.LAND else "goes home"
        after = self._plan.after_s
        self._client.note(f"the pilot is lost: it hovers, and {what} in {after:g} s", "warning")
        await asyncio.sleep(after)
        while True:
            try:
                await self._descend(task, f"{_WHO} ({self._plan.action})")
            except M100Error as error:
                self._client.note(f"the pilot is lost, and it did not land: {error.seen}", "error")
                await asyncio.sleep(_AGAIN_S)
            else:
                return


_WHO = "pilot lost"
"""Name under which the lease is taken for it."""
