"""The log of a process on standard error: as text, or as one JSON object per line.

Another thread writes, and what nobody reads in time is counted instead of shown: a terminal that
was stopped by Ctrl-S is no reason to hold up setpoints.
"""

from __future__ import annotations

import json
import logging
import queue
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from typing import Self

from m100link.errors import M100Error

LEVELS = ("debug", "info", "warning", "error")

_MOST_UNREAD = 2000
_LAST_WORDS = 1.0  # seconds that the end waits for lines still to be written


@dataclass(frozen=True, slots=True)
class LogOutput:
    level: str = "warning"  # the lowest level that is shown, one of :data:`LEVELS`
    as_json: bool = False  # one JSON object per line


_in_force: LogOutput | None = None
_aircraft = ""


def in_force() -> LogOutput | None:
    """The log output of this process and of those that it starts; None if nobody chose."""
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
        time = datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds")
        fields = {
            "time": time.replace("+00:00", "Z"),
            "level": record.levelname,
            "logger": record.name,
            "message": record.getMessage(),
            "aircraft": getattr(record, "aircraft", _aircraft),
        }
        if record.exc_info:
            fields["exception"] = self.formatException(record.exc_info)
            if isinstance(record.exc_info[1], M100Error):
                fields["code"] = record.exc_info[1].error_code
        return json.dumps(fields)


class FlightProgress:
    """Tells in a thread of its own what happens while an aircraft flies.

    A terminal that was stopped by Ctrl-S and a pipe that nobody reads or that was closed are no
    reason to hold up setpoints, or to raise where something happened.
    """

    def __init__(self, name: str, most: int) -> None:
        self._work: queue.Queue[Callable[[], object] | None] = queue.Queue(most)
        self._thread = threading.Thread(target=self._run, name=f"m100link: {name}", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(queue.Full, KeyboardInterrupt):  # only the last words are lost
            self._work.put(None, timeout=_LAST_WORDS)
            self._thread.join(_LAST_WORDS)

    def do(self, print_it: Callable[[], object]) -> bool:
        """Have something printed; False: nobody read in time what came before, and it is not."""
        try:
            self._work.put_nowait(print_it)
        except queue.Full:
            return False
        return True

    def _run(self) -> None:
        with suppress(OSError):  # nobody reads it any more
            while (print_it := self._work.get()) is not None:
                print_it()


class LinesInThread(logging.Handler):
    """Formats where it is called, which must not wait, and has the line written in a thread."""

    def __init__(self, lines: logging.Formatter, teller: FlightProgress) -> None:
        super().__init__()
        self.setFormatter(lines)
        self._teller, self._unread = teller, 0

    def emit(self, record: logging.LogRecord) -> None:
        try:
            line = self.format(record)
            if self._unread:
                text = f"{self._unread} lines of the log were not read in time, and left out"
                note = logging.LogRecord(__name__, logging.WARNING, __file__, 0, text, None, None)
                line = f"{self.format(note)}\n{line}"
            self._unread = 0 if self._teller.do(partial(_write, line)) else self._unread + 1
        except Exception:  # noqa: BLE001 - a line that cannot be made raises nowhere, as in logging
            self.handleError(record)


def _write(line: str) -> None:
    # Asked for each time: a live display takes it over, and writes above itself.
    with suppress(ValueError):  # it was closed
        sys.stderr.write(f"{line}\n")
        sys.stderr.flush()


@contextmanager
def writing_log(output: LogOutput, lines: logging.Formatter | None = None) -> Iterator[None]:
    """Write the log of m100link to standard error while the block runs; by default as asked for."""
    global _in_force
    logger = logging.getLogger("m100link")
    before, level = list(logger.handlers), logger.level
    lines = lines or (JsonLines() if output.as_json else logging.Formatter(*_TEXT_LINES))
    with FlightProgress("log", _MOST_UNREAD) as teller:
        handler = LinesInThread(lines, teller)
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
            handler.close()
