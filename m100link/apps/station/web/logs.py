"""Log lines that strangers cause: a few of a kind, then a number, and nothing that they show."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

__all__ = ["SparingLogger"]


class SparingLogger(logging.LoggerAdapter[logging.Logger]):
    """A logger that writes so many lines of a kind at once, and then one in a while.

    The kind of a line is its text before the arguments stand in it. The next line of a kind says
    how many were left out before it.

    Args:
        logger: Where the lines go.
        at_once: Lines of a kind that are written however fast they come.
        interval: Seconds after which one more may be written.
        clock: Seconds of a clock that never goes back.
        least: The lowest level that is written, whatever the log shows.
    """

    def __init__(
        self,
        logger: logging.Logger,
        *,
        at_once: int = 10,
        interval: float = 6.0,
        clock: Callable[[], float] = time.monotonic,
        least: int = logging.NOTSET,
    ) -> None:
        super().__init__(logger, None)
        self._least = least
        self._at_once, self._interval, self._clock = at_once, interval, clock
        # By kind: when the allowance will be full again, and lines left out. The kinds are the
        # texts in this program: strangers add none.
        self._kinds: dict[str, tuple[float, int]] = {}

    @property
    def level(self) -> int:
        """That of the logger."""
        return self.logger.level

    def isEnabledFor(self, level: int) -> bool:  # noqa: N802 - the name that logging gives it
        """Whether lines of that level are written."""
        return level >= self._least and super().isEnabledFor(level)

    def log(self, level: int, msg: object, *args: object, **keywords: Any) -> None:
        """Write a line, or count it."""
        if not self.isEnabledFor(level):
            return
        kind, now = str(msg), self._clock()
        full_at, left_out = self._kinds.get(kind, (now, 0))
        full_at = max(full_at, now) + self._interval
        if full_at - now > self._at_once * self._interval:
            self._kinds[kind] = (full_at - self._interval, left_out + 1)
            return
        self._kinds[kind] = (full_at, 0)
        if left_out:
            msg = f"{msg} (and {left_out} more before it)"
        super().log(level, msg, *args, **keywords)
