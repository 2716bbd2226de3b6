"""Control ends when the aircraft is not heard any more."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from m100link.errors import TelemetryStalled
from m100link.telemetry.state import AircraftState

__all__ = ["TelemetryWatchdog"]

_SLACK_S = 0.01  # so that a timer that is on time finds the limit passed
_BLOCKED_S = 0.1  # a timer that is later than this says that the program itself did not run
_GRACE_S = 0.05  # after that, time to read what came meanwhile


class TelemetryWatchdog:
    """Looks at the age of the newest telemetry when asked, and by a timer when nobody asks.

    Telemetry that never came cannot be missed. When this program itself did not run, what came
    meanwhile is read first: only telemetry that is still missing then counts as a stall.

    Args:
        state: Telemetry.
        limit: Seconds without telemetry that count as a stall; None: it never does.
        on_stall: Called with the error at each look that finds a stall.
        loop: Whose clock and timers are used.
    """

    def __init__(
        self,
        state: AircraftState,
        limit: float | None,
        on_stall: Callable[[TelemetryStalled], None],
        loop: asyncio.AbstractEventLoop,
    ) -> None:
        self._state = state
        self._limit = limit
        self._on_stall = on_stall
        self._loop = loop
        self._clock = loop.time
        self._timer: asyncio.TimerHandle | None = None
        # Until when old telemetry is forgiven; None while it is not old.
        self._grace_ends_at: float | None = None

    def start(self) -> None:
        """Look now, and whenever telemetry would be too old; until it was, or :meth:`stop`."""
        if self._limit is not None and self.is_quiet():
            age = self._state.newest_age or 0.0
            rest = self._limit - age if age <= self._limit else _GRACE_S
            self._timer = self._loop.call_later(rest + _SLACK_S, self.start)

    def stop(self) -> None:
        """Look no more."""
        if self._timer is not None:
            self._timer.cancel()

    def is_quiet(self) -> bool:
        """False when telemetry is found stalled here and now."""
        newest_at = self._state.newest_at
        if self._limit is None or newest_at is None:
            return True
        age = self._clock() - newest_at
        if age <= self._limit:
            self._grace_ends_at = None
            return True
        if self._is_forgiven():
            return True
        self._on_stall(
            TelemetryStalled(
                f"no telemetry for {age:.1f} s while flying",
                cause="the line from the aircraft is broken, or this program was blocked",
                remedy="check the line; a program that blocks must not fly",
            )
        )
        return False

    def _is_forgiven(self) -> bool:
        now = self._clock()
        if self._grace_ends_at is None:
            was_blocked = self._timer is not None and now - self._timer.when() > _BLOCKED_S
            self._grace_ends_at = now + _GRACE_S if was_blocked else now
        return now < self._grace_ends_at
