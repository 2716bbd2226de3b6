"""Questions of a front that wait for the agent's answer."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from m100link.apps.agent.fault import agent_gone, agent_lost
from m100link.apps.agent.lease import Lease, TakeOver
from m100link.apps.agent.messages import (
    LeaseGranted,
    Message,
    Outcome,
    Stage,
    TakeOverOffered,
)

__all__ = ["Answers"]


class Answers:
    """What was asked and has no answer yet, by number.

    Args:
        send: Puts a question on its way.

    Attributes:
        gone: Why the agent will answer no more, once it has gone; None before.
    """

    def __init__(self, send: Callable[[Message], None]) -> None:
        self._send = send
        self._create_future = asyncio.get_running_loop().create_future
        self._count = 0
        self._waiting: dict[int, asyncio.Future[Any]] = {}
        self._accepted: dict[int, Callable[[], None]] = {}
        self.gone: str | None = None

    async def question(
        self, ask: Callable[[int], Message], accepted: Callable[[], None] | None = None
    ) -> Any:
        """Send what ``ask`` makes of a number, and wait for the answer to that number.

        Args:
            ask: Makes the question.
            accepted: Called when the aircraft has begun.

        Raises:
            M100Error: What the agent tells.
            LinkError: It has gone; nothing was asked.
            LinkLost: It goes meanwhile, and may have done it.
        """
        if self.gone is not None:
            raise agent_gone(self.gone)
        self._count += 1
        number = self._count
        answer = self._waiting[number] = self._create_future()
        if accepted is not None:
            self._accepted[number] = accepted
        try:
            self._send(ask(number))
            return await answer
        finally:
            self._waiting.pop(number, None)
            self._accepted.pop(number, None)

    def begin(self, send: Callable[[Message], None]) -> None:
        """Another agent answers from now on; nothing that the one before was asked is left."""
        self._send, self.gone = send, None

    def end(self, reason: str) -> None:
        """The agent has gone: nobody waits for it any longer."""
        self.gone = reason
        waiting, self._waiting = list(self._waiting.values()), {}
        for answer in waiting:
            if not answer.done():
                answer.set_exception(agent_lost(reason))

    # -- what comes in ---------------------------------------------------------------------------

    def granted(self, message: LeaseGranted) -> None:
        """The lease that was asked for."""
        self._resolve(message.id, Lease(message.name, message.token, message.number))

    def offered(self, message: TakeOverOffered) -> None:
        """Who would lose the lease."""
        offer = TakeOver(
            message.name, message.from_name, message.token, message.number, message.expires_at
        )
        self._resolve(message.id, offer)

    def outcome(self, outcome: Outcome) -> None:
        """What became of a question."""
        if outcome.stage is Stage.ACCEPTED:
            accepted = self._accepted.get(outcome.id)
            if accepted is not None:
                accepted()
            return
        answer = self._waiting.get(outcome.id)
        if outcome.fault is None:
            self._resolve(outcome.id, outcome)
        elif answer is not None and not answer.done():
            answer.set_exception(outcome.fault.error())

    def _resolve(self, number: int, value: object) -> None:
        answer = self._waiting.get(number)
        if answer is not None and not answer.done():
            answer.set_result(value)
