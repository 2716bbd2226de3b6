"""Control ends when the aircraft is not heard any more, or what is heard cannot be true."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable

from m100link.errors import (
    ComputerSuspended,
    M100Error,
    NavigationLost,
    SetpointsIgnored,
    TelemetryStalled,
)
from m100link.flight.following import FollowCheck
from m100link.flight.guards import Guards
from m100link.flight.lifecycle import StopCause
from m100link.flight.suspension import SuspendWatch
from m100link.telemetry.state import AircraftState

__all__ = ["TelemetryWatchdog"]

_SLACK_S = 0.01  # so that a timer that is on time finds the limit passed
_BLOCKED_S = 0.1  # a timer that is later than this says that the program itself did not run
_GRACE_S = 0.05  # after that, time to read what came meanwhile
_LOOK_S = 0.1  # as ArduPilot's ekf_check
_WAIT_S = 0.2  # while nothing is sent: a mission, a take-off, a program that waits


class TelemetryWatchdog:
    """Looks at telemetry when asked, before each frame, and by a timer when nobody asks.

    It must be new: by its arrival, before each frame; and by the clock of the aircraft. It must be
    possible: see :class:`m100link.Integrity`. And what is asked for must begin to be flown. These
    are looked at ten times a second, five while nothing is sent: before each frame they would cost
    half of what flying does.

    Telemetry that never came cannot be missed. When this program itself did not run, what came
    meanwhile is read first: only telemetry that is still missing then counts as a stall. When the
    computer was suspended, no age says anything, and that alone is the end.

    Args:
        state: Telemetry.
        guards: ``stale_telemetry_s`` is the limit of its age, ``integrity`` whether the rest is
            looked at.
        end: Called with cause and error at each look that finds something.
        loop: Whose clock and timers are used.
        following: Whether setpoints are followed; None where nobody can know.
    """

    def __init__(
        self,
        state: AircraftState,
        guards: Guards,
        end: Callable[[StopCause, M100Error], None],
        loop: asyncio.AbstractEventLoop,
        following: FollowCheck | None = None,
    ) -> None:
        self._state = state
        self._limit = guards.stale_telemetry_s
        self._checks_integrity = guards.integrity
        self._following = following if guards.integrity else None
        self._suspended = SuspendWatch()
        self._end = end
        self._loop = loop
        self._clock = loop.time
        self._timer: asyncio.TimerHandle | None = None
        # Until when old telemetry is forgiven; None while it is not old.
        self._grace_ends_at: float | None = None
        self._looks_at = -math.inf  # when at what costs more

    def start(self) -> None:
        """Look now, and on and on; until something was found, or :meth:`stop`."""
        if self._timer is None:  # a sleep of before is not the flight's
            self._suspended = SuspendWatch()
        if self.is_quiet():
            rest = _WAIT_S
            age = self._state.newest_age or 0.0
            if self._limit is not None:
                rest = self._limit - age if age <= self._limit else _GRACE_S
            self._timer = self._loop.call_later(min(rest + _SLACK_S, _WAIT_S), self.start)

    def stop(self) -> None:
        """Look no more."""
        if self._timer is not None:
            self._timer.cancel()

    def hurry(self) -> None:
        """Look at all of it when asked next: something is strange, and this may be why."""
        self._looks_at = -math.inf

    def is_quiet(self) -> bool:
        """False when something is found here and now."""
        now = self._clock()
        slept = self._suspended.slept_s()
        if slept:
            seen = f"this computer was suspended for {slept:.1f} s while flying"
            self._end(StopCause.SUSPENDED, _usual(ComputerSuspended, seen))
            return False
        return self._is_heard(now) and (now < self._looks_at or self._is_right(now))

    def _is_right(self, now: float) -> bool:
        self._looks_at = now + _LOOK_S - _SLACK_S
        return (self._limit is None or self._is_timely()) and self._is_true()

    def _is_heard(self, now: float) -> bool:
        newest_at = self._state.newest_at
        if self._limit is None or newest_at is None:
            return True
        age = now - newest_at
        if age <= self._limit:
            self._grace_ends_at = None
            return True
        if self._is_forgiven():
            return True
        self._end(
            StopCause.TELEMETRY_STALLED,
            TelemetryStalled(
                f"no telemetry for {age:.1f} s while flying",
                cause="the line from the aircraft is broken, or this program was blocked",
                remedy="check the line; a program that blocks must not fly",
            ),
        )
        return False

    def _is_forgiven(self) -> bool:
        now = self._clock()
        if self._grace_ends_at is None:
            was_blocked = self._timer is not None and now - self._timer.when() > _BLOCKED_S
            self._grace_ends_at = now + _GRACE_S if was_blocked else now
        return now < self._grace_ends_at

    def _is_timely(self) -> bool:
        integrity = self._state.integrity
        if integrity.is_timely:
            return True
        self._end(
            StopCause.TELEMETRY_STALLED,
            TelemetryStalled(
                f"{integrity.seen} while flying",
                cause="a relay repeats what it has, or a radio or bridge carries less than is sent",
                remedy="connect directly, or set lower rates in the PC assistant",
            ),
        )
        return False

    def _is_true(self) -> bool:
        if not self._checks_integrity:
            return True
        integrity = self._state.integrity
        if not integrity.is_plausible:
            self._end(StopCause.NAVIGATION_LOST, _usual(NavigationLost, integrity.seen))
            return False
        ignored = self._following.look() if self._following is not None else ""
        if ignored:
            self._end(StopCause.SETPOINTS_IGNORED, _usual(SetpointsIgnored, ignored))
        return not ignored


def _usual(kind: type[M100Error], seen: str) -> M100Error:
    return kind(seen, cause=kind.usual_cause, remedy=kind.usual_remedy)
