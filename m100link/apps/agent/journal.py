"""What happened, for people."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable

from m100link.apps.agent.messages import Event, Topic

JOURNAL_LOG = __name__
"""Name of the log that has every event, for whoever shows events in another way."""

_logger = logging.getLogger(JOURNAL_LOG)

_MAX_EVENTS = 200
_LEVELS = {"info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}


class Journal:
    """The newest events, and who wants to hear of each."""

    def __init__(self, clock: Callable[[], float]) -> None:  # s
        self._clock = clock
        self._count = 0
        self.events: deque[Event] = deque(maxlen=_MAX_EVENTS)
        self.on_event: list[Callable[[Event], None]] = []  # called with each event

    def note(self, text: str, level: str = "info", topic: Topic = Topic.NONE) -> None:
        """Add an event."""
        self._count += 1
        event = Event(self._count, self._clock(), level, text, topic)
        self.events.append(event)
        _logger.log(_LEVELS[level], "%s", text)
        for callback in self.on_event:
            callback(event)
