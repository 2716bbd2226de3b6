"""What happened, for people; and the tasks of the station, whose errors are told there."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any

from m100link.errors import M100Error

__all__ = ["Event", "Journal"]

_logger = logging.getLogger("m100link.station")

_MAX_EVENTS = 200
_LEVELS = {"info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened, for people.

    Attributes:
        number: Counts events from 1.
        at: Time on the event loop's clock, s.
        level: ``"info"``, ``"warning"`` or ``"error"``.
        text: What happened.
    """

    number: int
    at: float
    level: str
    text: str


class Journal:
    """Events, and tasks that run as long as their owner.

    Attributes:
        events: What happened lately.
        on_event: Called with each event.
    """

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self.events: deque[Event] = deque(maxlen=_MAX_EVENTS)
        self.on_event: list[Callable[[Event], None]] = []
        self._event_count = 0
        self._tasks: set[asyncio.Task[Any]] = set()

    @property
    def now(self) -> float:
        """Time on the event loop's clock."""
        return self._loop.time()

    def note(self, text: str, level: str = "info") -> None:
        """Add an event."""
        self._event_count += 1
        event = Event(self._event_count, self.now, level, text)
        self.events.append(event)
        _logger.log(_LEVELS[level], "%s", text)
        for callback in self.on_event:
            callback(event)

    def spawn(self, work: Coroutine[Any, Any, Any], name: str) -> asyncio.Task[Any]:
        """Run something in a task; an error that is not one of this package is logged."""
        task = asyncio.create_task(work, name=f"m100link station: {name}")
        self._tasks.add(task)
        task.add_done_callback(self._done)
        return task

    def _done(self, task: asyncio.Task[Any]) -> None:
        self._tasks.discard(task)
        if task.cancelled():
            return
        error = task.exception()
        if error is not None and not isinstance(error, M100Error):
            _logger.error("%s ended by an error", task.get_name(), exc_info=error)

    async def end_tasks(self) -> None:
        """Cancel every task and wait for its end."""
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
