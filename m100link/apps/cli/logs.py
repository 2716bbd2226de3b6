"""What is logged on standard error, and the options that say it."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TextIO

from cyclopts import Parameter

from m100link.errors import UsageError


@Parameter(name="*", group="Log")
@dataclass(frozen=True)
class LogOptions:
    """What is logged on standard error.

    Attributes:
        log_level: Lowest level that is shown (M100LINK_LOG): warning by default; debug has every
            frame, cut short. No key, no token and no app id is in it.
        log_json: One JSON object per line: time, level, logger, message, aircraft.
    """

    log_level: Literal["debug", "info", "warning", "error"] | None = None
    log_json: Annotated[bool, Parameter(negative=())] = False


AS_IT_IS = LogOptions()
"""Nothing was asked for."""


class _ToStandardError(logging.StreamHandler[TextIO]):
    """To what standard error is now: a live display takes it over, and writes above itself."""

    def emit(self, record: logging.LogRecord) -> None:
        self.stream = sys.stderr  # the one before is flushed by each line, and may be closed
        super().emit(record)


def _level() -> str:
    """The level that the environment asks for."""
    level = os.environ.get("M100LINK_LOG", "WARNING").upper()
    if level not in logging.getLevelNamesMapping():
        raise UsageError(
            f"M100LINK_LOG is {level!r}", remedy="set it to DEBUG, INFO, WARNING or ERROR"
        )
    return level


def show_warnings() -> None:
    """Warnings of the library go to standard error, like everything that is not data.

    Raises:
        UsageError: The environment names a level that does not exist.
    """
    handler = _ToStandardError()
    handler.setFormatter(logging.Formatter("%(levelname)s: %(message)s"))
    logger = logging.getLogger("m100link")
    logger.addHandler(handler)
    logger.setLevel(_level())


@contextmanager
def logging_as_asked(arguments: Iterable[Any]) -> Iterator[None]:
    """Log as the options of a verb say while the block runs; without them it stays as it is.

    The options are one of the verb's arguments, or the attribute ``log`` of one, or of how a
    station is run.
    """
    runs = (getattr(argument, "run", argument) for argument in arguments)
    found = (getattr(run, "log", run) for run in runs)
    asked = next((one for one in found if isinstance(one, LogOptions)), AS_IT_IS)
    if asked == AS_IT_IS:
        yield
        return
    from m100link.apps.station.log_output import LogOutput, writing_log

    with writing_log(LogOutput(asked.log_level or _level().lower(), asked.log_json)):
        yield
