"""Questions to an agent that are open at the same time.

Over a way of seconds the answer to the first question comes when two others have been asked. It is
an answer all the same, and what was lost is asked again without waiting for what may be under way.
"""

from __future__ import annotations

import asyncio
from types import TracebackType
from typing import Self

from m100link.apps.bus.network import Answer, Bus

__all__ = ["STEP_S", "Questions"]

STEP_S = 1.5
"""Seconds after which it is asked again, while earlier questions stay open."""

_MOST_DOUBLED = 5


class Questions:
    """Asks again and again; to be used as ``async with``, at whose end nothing is open.

    Args:
        bus: The network.
        step: Seconds after which the newest question waits for nothing that the next one would not
            tell sooner.
    """

    def __init__(self, bus: Bus, *, step: float = STEP_S) -> None:
        self._bus, self._step = bus, step
        self._clock = asyncio.get_running_loop().time
        self._open: dict[asyncio.Task[list[Answer]], int] = {}
        self._asked_at = 0.0
        self._unanswered = 0
        self.newest = 0

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        for task in self._open:
            task.cancel()
        await asyncio.gather(*self._open, return_exceptions=True)

    @property
    def is_due(self) -> bool:
        """Whether it is to be asked again: the newest question has ended, or waits for long."""
        return self.left <= 0.0

    @property
    def left(self) -> float:
        """Seconds until it is to be asked again."""
        if self.newest not in self._open.values():
            return 0.0
        return self._asked_at + self._step - self._clock()

    def ask(self, key: str, payload: bytes = b"", *, within: float) -> int:
        """Ask; those that were asked before stay open.

        A question waits for longer, the more before it got no answer: where two agents serve a key
        and one of them hangs, the other one's answer is seen when the wait is over.

        Args:
            key: Whom.
            payload: What.
            within: Seconds that an answer is of any use.

        Returns:
            The number of the question.
        """
        self._unanswered += 1
        longest = self._step * 2 ** min(self._unanswered, _MOST_DOUBLED)
        self.newest += 1
        self._asked_at = self._clock()
        asking = self._bus.ask(key, payload, timeout=min(within, longest))
        task = asyncio.create_task(asking, name="m100link: question to an agent")
        self._open[task] = self.newest
        return self.newest

    async def answered(self, within: float) -> tuple[int, list[Answer]] | None:
        """Wait until a question ends.

        Args:
            within: Seconds.

        Returns:
            Its number, and what was answered: nothing where nobody is there. None when none ended.
        """
        if not self._open:
            return None
        done, _ = await asyncio.wait(
            self._open, timeout=within, return_when=asyncio.FIRST_COMPLETED
        )
        if not done:
            return None
        task = min(done, key=self._open.__getitem__)
        number = self._open.pop(task)
        answers = task.result()
        if answers and number == self.newest:
            self._unanswered = 0
        return number, answers
