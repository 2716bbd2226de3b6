"""What happened, by the clock on the wall: the station's events and those of this page.

The agent's times are on a clock that nobody reads. The wall's time is given to an event when it is
first seen here and then kept: a clock that is set meanwhile moves no event.
"""

from __future__ import annotations

import csv
import io
import json
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from enum import Enum

from m100link.apps.agent.messages import Event
from m100link.apps.station.console.view.words import Speaker, Text

__all__ = ["LEVELS", "MIME", "Diary", "Format", "Line", "export", "select"]

LEVELS = ("info", "warning", "error")
"""The levels of events, the least urgent first."""

_MAX_LINES = 1000


class Format(Enum):
    """How the list is written down; the value is the ending of the file's name."""

    TEXT = "txt"
    JSON = "json"
    CSV = "csv"


MIME = {Format.TEXT: "text/plain", Format.JSON: "application/json", Format.CSV: "text/csv"}
"""What each is told to be."""


@dataclass(frozen=True, slots=True)
class Line:
    """One event.

    Attributes:
        number: Counts the lines of this page from 1.
        at: Seconds since 1970, UTC.
        level: One of :data:`LEVELS`.
        source: ``"station"``, or ``"page"`` for what only this page knows.
        text: What happened: English from the station, and to be said in the operator's language
            from this page.
    """

    number: int
    at: float
    level: str
    source: str
    text: str | Text

    def said(self, speaker: Speaker) -> str:
        """What happened, as it is shown."""
        return self.text if isinstance(self.text, str) else speaker(self.text)

    def time(self, utc_offset_min: int) -> datetime:
        """When, by a clock so many minutes ahead of UTC."""
        return datetime.fromtimestamp(self.at, timezone(timedelta(minutes=utc_offset_min)))


class Diary:
    """The lines of one page, oldest first; the oldest of very many are forgotten."""

    def __init__(self) -> None:
        self.lines: deque[Line] = deque(maxlen=_MAX_LINES)
        self._count = 0
        self._last_event = 0

    def take(self, events: Iterable[Event], now: float, wall: float) -> None:
        """Take over what the agent told.

        Args:
            events: Its newest events, oldest first; those known already are left out.
            now: Time on the agent's clock, s.
            wall: The same moment in seconds since 1970.
        """
        for event in events:
            if event.number > self._last_event:
                self._last_event = event.number
                self._add(wall - (now - event.at), event.level, "station", event.text)

    def write(self, text: Text, wall: float, level: str = "info") -> None:
        """Add something that only this page knows."""
        self._add(wall, level, "page", text)

    def _add(self, at: float, level: str, source: str, text: str | Text) -> None:
        self._count += 1
        self.lines.append(Line(self._count, at, level, source, text))


def select(
    lines: Iterable[Line], speaker: Speaker, *, least: str = "info", words: str = ""
) -> list[Line]:
    """The lines of that level or above that hold every word, whatever its case."""
    wanted = words.casefold().split()
    lowest = LEVELS.index(least)
    return [
        line
        for line in lines
        if LEVELS.index(line.level) >= lowest
        and all(word in line.said(speaker).casefold() for word in wanted)
    ]


def export(lines: Iterable[Line], how: Format, speaker: Speaker, utc_offset_min: int = 0) -> str:
    """The lines as a file; times are those of the operator's clock, with their zone."""
    rows = [
        (line.time(utc_offset_min).isoformat(timespec="milliseconds"), line, line.said(speaker))
        for line in lines
    ]
    if how is Format.JSON:
        return json.dumps(
            [
                {"time": time, "level": line.level, "source": line.source, "text": text}
                for time, line, text in rows
            ],
            ensure_ascii=False,
            indent=1,
        )
    if how is Format.TEXT:
        return "".join(f"{time}  {line.level:7}  {text}\n" for time, line, text in rows)
    written = io.StringIO()
    table = csv.writer(written)
    table.writerow(("time", "level", "source", "text"))
    table.writerows((time, line.level, line.source, _harmless(text)) for time, line, text in rows)
    return written.getvalue()


def _harmless(text: str) -> str:
    """A cell that no spreadsheet takes for a formula: names of strangers stand in events."""
    return f"'{text}" if text.startswith(("=", "+", "-", "@", "\t", "\r")) else text
