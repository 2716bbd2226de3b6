"""When packages were made, for the headers of messages: by the clock of the aircraft.

The clock is asked a few times a second and not for each package: in between, time goes on as its
ticks do.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from m100link.log.ros2_messages import Stamp
from m100link.protocol.records import Time
from m100link.telemetry.device_clock import DeviceClock
from m100link.telemetry.sample import Sample

__all__ = ["Stamps"]

_ASKED_S = 0.25
"""Seconds for which one answer of the clock holds: its skew makes 50 µs of them at most."""


class Stamps:
    """Times of packages as POSIX time.

    Args:
        now: Time of the event loop, s.
        utc: POSIX time, s.

    Attributes:
        clock: Of the aircraft; None before its first tick.
    """

    def __init__(self, now: Callable[[], float], utc: Callable[[], float]) -> None:
        self._now, self._utc = now, utc
        self.clock: DeviceClock | None = None
        # A tick, and when that was on the event loop's clock; None while nobody knows.
        self._known: tuple[int, float] | None = None

    def at(self, at: float) -> Stamp:
        """POSIX time of a time of the event loop."""
        nanoseconds = max(0, round((at - self._now() + self._utc()) * 1e9))
        return divmod(nanoseconds, 10**9)

    def hear(self, sample: Sample) -> None:
        """Let the clock know of a package; each has to come by here."""
        time = sample.get(Time)
        if time is None:
            return
        tick_hz = sample.profile.tick_hz
        if self.clock is None or self.clock.tick_hz != tick_hz:
            self.clock, self._known = DeviceClock(tick_hz), None
        self.clock.update(time.tick, sample.received_at)

    def of(self, sample: Sample) -> Stamp:
        """When the newest package was made: never later than it came."""
        return self.at(min(self._taken_at(sample), sample.received_at))

    def _taken_at(self, sample: Sample) -> float:
        time, clock = sample.get(Time), self.clock
        if time is None or clock is None:
            return sample.received_at
        tick_hz = clock.tick_hz
        if self._known is not None:
            tick, at = self._known
            # Ticks that went back, or far ahead, are asked about at once.
            if 0 <= time.tick - tick < _ASKED_S * tick_hz:
                return at + (time.tick - tick) / tick_hz
        found = clock.host_time(time.tick)
        if found is None or not math.isfinite(found.uncertainty_s):
            self._known = None
            return sample.received_at
        self._known = time.tick, found.time
        return found.time
