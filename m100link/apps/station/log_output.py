"""What a process of ours logs, on standard error: as text, or as one JSON object per line.

Another thread writes, and what nobody reads in time is counted instead of shown: a terminal that
was stopped by Ctrl-S is no reason to hold up setpoints.
"""

from __future__ import annotations

import json
import logging
import queue
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from logging.handlers import QueueHandler
from typing import Any

from m100link.errors import M100Error

LEVELS = ("debug", "info", "warning", "error")

_MOST_UNREAD = 2000
_LAST_WORDS = 1.0  # seconds that the end waits for lines that are still to be read


@dataclass(frozen=True, slots=True)
class LogOutput:
    """What is shown of the log of a process, and how."""

    level: str = "warning"  # the lowest level that is shown, one of :data:`LEVELS`
    as_json: bool = False  # one JSON object per line


_in_force: LogOutput | None = None
_aircraft = ""


def in_force() -> LogOutput | None:
    """What this process shows, which those that it starts show too; None if nobody chose."""
    return _in_force


def log_of(aircraft: str) -> None:
    """Say whose log this process writes, where no line says it (``extra={"aircraft": …}``)."""
    global _aircraft
    _aircraft = aircraft


def tell_elsewhere(logger: str) -> None:
    """Keep what somebody tells in another way out of the log."""
    found = logging.getLogger(logger)
    found.addHandler(logging.NullHandler())  # without any, logging prints warnings by itself
    found.propagate = False


_TEXT_LINES = "%(asctime)s.%(msecs)03d %(levelname)s %(name)s: %(message)s", "%H:%M:%S"
"""For people: time of day, level, logger, message."""


class JsonLines(logging.Formatter):
    """One object per line: time (UTC, ISO 8601), level, logger, message, aircraft.

    With an exception come ``exception``, its traceback as text, and ``code`` where it has one.
    """

    def format(self, record: logging.LogRecord) -> str:
        """The line."""
        time = datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds")
        told = {
            "time": time.replace("+00:00", "Z"),
            "level": record.levelname,
            "logger": record.name,
            "message": record.getMessage(),
            "aircraft": getattr(record, "aircraft", _aircraft),
        }
        if record.exc_info:
            told["exception"] = self.formatException(record.exc_info)
            if isinstance(record.exc_info[1], M100Error):
                told["code"] = record.exc_info[1].error_code
        return json.dumps(told)


class LinesInThread(QueueHandler):
    """Formats where it is called, which must not wait, and writes in a thread."""

    def __init__(self, lines: logging.Formatter) -> None:
        self._lines: queue.Queue[str | None] = queue.Queue(_MOST_UNREAD)
        super().__init__(self._lines)
        self.setFormatter(lines)
        self._unread = 0
        self._thread = threading.Thread(target=self._write, name="m100link: log", daemon=True)
        self._thread.start()

    def prepare(self, record: logging.LogRecord) -> str:
        """The line, without what a record holds on to."""
        line = self.format(record)
        if not self._unread:
            return line
        text = f"{self._unread} lines of the log were not read in time, and left out"
        told = logging.LogRecord(__name__, logging.WARNING, __file__, 0, text, None, None)
        return f"{self.format(told)}\n{line}"

    def enqueue(self, record: Any) -> None:
        """Put a line where the thread finds it."""
        try:
            self._lines.put_nowait(record)
            self._unread = 0
        except queue.Full:
            self._unread += 1

    def wait_until_read(self) -> None:
        """Wait until all lines are written, however long that takes."""
        self._lines.join()

    def close(self) -> None:
        """Give what is left a moment to be read."""
        with suppress(queue.Full):
            self._lines.put(None, timeout=_LAST_WORDS)
            self._thread.join(_LAST_WORDS)
        super().close()

    def _write(self) -> None:
        with suppress(OSError, ValueError):  # nobody reads it any more
            while (line := self._lines.get()) is not None:
                # Asked for each time: a live display takes it over, and writes above itself.
                sys.stderr.write(f"{line}\n")
                sys.stderr.flush()
                self._lines.task_done()


@contextmanager
def writing_log(output: LogOutput | None) -> Iterator[None]:
    """Write the log of m100link to standard error while the block runs; None: as it was."""
    global _in_force
    if output is None:
        yield
        return
    logger = logging.getLogger("m100link")
    before, level = list(logger.handlers), logger.level
    handler = LinesInThread(JsonLines() if output.as_json else logging.Formatter(*_TEXT_LINES))
    for other in before:
        logger.removeHandler(other)
    logger.addHandler(handler)
    logger.setLevel(output.level.upper())
    _in_force = output
    try:
        yield
    finally:
        _in_force = None
        logger.setLevel(level)
        for other in before:
            logger.addHandler(other)
        logger.removeHandler(handler)
        with suppress(KeyboardInterrupt):  # only the last lines are lost
            handler.close()
