"""From the aircraft's tick to the time of this computer, with a bound that holds.

A package is received some delay after its tick was taken. The delay varies (serial buffers, USB,
scheduling) but is never negative, so the earliest arrivals tell most: of each second the one with
the least apparent delay is kept, and a line through these gives offset and skew. The constant part
of the delay cannot be seen from one side; it is not in the uncertainty, and is at least the time of
a package on the line (6 ms at 230400 baud).

What arrives late may have waited in a buffer while this program was busy, or the device clock may
have stepped back: one package does not tell which. The stated bound therefore reaches from the line
to the newest arrival, and only seconds whose packages come at their own pace move the line.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

__all__ = ["DeviceClock", "HostTime"]

_WRAP = 1 << 32
_SECONDS = 60  # seconds that the line is fitted through
_SECOND_S = 1.0
_SECOND_COUNT = 20  # fewer arrivals do not show what an ordinary delay is
_FIT_COUNT = 5  # over fewer seconds, jitter would pass for skew
_LATE_COUNT = 5  # seconds late one after the other are a step back
_MAX_SKEW = 200e-6  # two crystals, each good to 100 ppm
_BACKLOG_S = 0.1  # lateness that only packages have which waited
_BACKLOG_GONE_S = 0.5  # without such lateness for so long, nothing waits any more


class HostTime(NamedTuple):
    """An estimated time on the event loop's clock.

    Attributes:
        time: Seconds.
        uncertainty_s: Half width within which the truth lies, s; infinite while nothing is known.
    """

    time: float
    uncertainty_s: float


class _Second(NamedTuple):
    """The earliest arrival of a second.

    Attributes:
        device: Its device time, s.
        offset: Its arrival minus its device time, s.
        width: By how much half of the arrivals were later, s. A second whose very earliest arrival
            is late by more than that had to have every arrival in the upper part of their range.
    """

    device: float
    offset: float
    width: float


class DeviceClock:
    """Relates device ticks to host time.

    Args:
        tick_hz: Ticks per second, 600 or 400 by firmware.

    Attributes:
        tick_hz: As given.
        resets: How often the tick jumped, either way, as after a reboot of the aircraft.
    """

    def __init__(self, tick_hz: int) -> None:
        self.tick_hz = tick_hz
        self.resets = 0
        self._start()

    def _start(self) -> None:
        self._last_tick: int | None = None
        self._device = 0.0  # unwrapped device time of the newest tick, s
        self._received_at = -math.inf  # when it arrived: packages of one read share it
        self._newest = 0.0  # and its offset
        self._silence = 0.0  # how long nothing was read before it
        self._arrivals: list[tuple[float, float]] = []  # device time and offset, one per read
        self._arrivals_since = 0.0
        self._seconds: deque[_Second] = deque(maxlen=_SECONDS)
        self._late: list[_Second] = []  # seconds outside the bound since the last one within
        self._backlog = 0.0  # the worst lateness of what waited
        self._backlog_at = -math.inf
        self._slope = 0.0
        self._intercept = math.inf
        self._spread = 0.0
        self._floor = (-math.inf, 0.0)  # intercept and slope of where the bound ends below

    def update(self, tick: int, received_at: float) -> None:
        """A package with this tick arrived."""
        device = tick / self.tick_hz if self._last_tick is None else self._unwrapped(tick)
        offset = received_at - device
        intercept, slope = self._floor
        # The tick went back, or a package came before it can have been sent: the clock jumped.
        if offset < intercept + slope * device or device < self._device:
            self.resets += 1
            self._start()
            device = tick / self.tick_hz
            offset = received_at - device
        silence = received_at - self._received_at
        if silence > 0:
            self._end_read(received_at)
            self._silence = silence
        # What follows sooner than its tick: the one before waited, and says nothing about delay.
        if self._arrivals and silence < (device - self._device) / 2:
            self._arrivals[-1] = (device, offset)
        else:
            self._arrivals.append((device, offset))
        self._last_tick = tick
        self._device = device
        self._received_at = received_at
        self._newest = offset
        if not self._seconds and offset < self._intercept:
            self._intercept = offset

    def _unwrapped(self, tick: int) -> float:
        step = (tick - (self._last_tick or 0)) % _WRAP
        return self._device + (step - _WRAP if step >= _WRAP // 2 else step) / self.tick_hz

    def _end_read(self, now: float) -> None:
        """The newest package stays the last of its read."""
        if not self._arrivals:
            self._arrivals_since = now
            return
        if self._seconds and self._newest - self._offset_at(self._device) > _BACKLOG_S:
            waited = self._waited()
            is_over = self._received_at > self._backlog_at + _BACKLOG_GONE_S
            self._backlog = waited if is_over else max(self._backlog, waited)
            self._backlog_at = self._received_at
        if len(self._arrivals) >= _SECOND_COUNT and now - self._arrivals_since >= _SECOND_S:
            self._end_second()
            self._arrivals = []
            self._arrivals_since = now

    def _end_second(self) -> None:
        by_delay = sorted((offset - self._slope * d, d, offset) for d, offset in self._arrivals)
        delay, device, offset = by_delay[0]
        second = _Second(device, offset, by_delay[len(by_delay) // 2][0] - delay)
        if offset - self._offset_at(device) > self._bound_at(device):
            self._late.append(second)
            if len(self._late) < _LATE_COUNT:
                return
            self.resets += 1
            self._seconds = deque(self._late, maxlen=_SECONDS)
        else:
            # A second that this one shows to have been late from end to end says nothing.
            slack = second.width + 1.0 / self.tick_hz
            kept = [
                earlier
                for earlier in self._seconds
                if earlier.offset <= offset + slack + _MAX_SKEW * abs(device - earlier.device)
            ]
            self._seconds = deque([*kept, second], maxlen=_SECONDS)
        self._late = []
        self._fit()

    def _fit(self) -> None:
        """Least squares through the earliest arrival of each second."""
        points = self._seconds
        count = len(points)
        mean_x = sum(point.device for point in points) / count
        mean_y = sum(point.offset for point in points) / count
        self._slope = 0.0
        if count >= _FIT_COUNT:
            square = sum((point.device - mean_x) ** 2 for point in points)
            product = sum((p.device - mean_x) * (p.offset - mean_y) for p in points)
            self._slope = max(-_MAX_SKEW, min(_MAX_SKEW, product / square))
        self._intercept = mean_y - self._slope * mean_x
        residual = max(abs(p.offset - self._offset_at(p.device)) for p in points)
        self._spread = residual + sum(p.width for p in points) / count + 1.0 / self.tick_hz
        last, drift = points[-1].device, self._drift()
        self._floor = (self._intercept - self._spread + drift * last, self._slope - drift)

    def _drift(self) -> float:
        """How fast the line may leave the truth beyond the seconds that it goes through."""
        if len(self._seconds) < _FIT_COUNT:
            return _MAX_SKEW
        span = self._seconds[-1].device - self._seconds[0].device
        return min(_MAX_SKEW, 2 * self._spread / span)

    def _offset_at(self, device: float) -> float:
        return self._intercept + self._slope * device

    def _bound_at(self, device: float) -> float:
        """Half width of the estimate for that device time, as far as the line goes, s."""
        if not self._seconds:
            return math.inf
        first, last = self._seconds[0].device, self._seconds[-1].device
        beyond = max(0.0, first - device, device - last)
        return self._spread + self._drift() * beyond

    def _waited(self) -> float:
        """How far the newest package is from the line; if it waited, as long as nothing was read.

        What waited during a jump of the clock comes less late than it waited.
        """
        late = self._newest - self._offset_at(self._device)
        return max(late, self._silence) if late > _BACKLOG_S else abs(late)

    def _uncertainty_at(self, device: float) -> float:
        bound = max(self._bound_at(device), self._waited())
        waiting = self._received_at <= self._backlog_at + _BACKLOG_GONE_S
        return max(bound, self._backlog) if waiting else bound

    @property
    def offset_s(self) -> float | None:
        """Host time minus device time now, s; None before the first package."""
        return None if self._last_tick is None else self._offset_at(self._device)

    @property
    def skew_ppm(self) -> float:
        """How much faster the host clock runs, parts per million; 0 in the first seconds."""
        return self._slope * 1e6

    @property
    def uncertainty_s(self) -> float:
        """Half width of the estimate for the newest package, s.

        Infinite until a second of arrivals at their own pace. It is what the earliest arrivals
        scatter, what half of the arrivals are later, and one tick; more while packages come late.
        """
        return self._uncertainty_at(self._device)

    def host_time(self, tick: int) -> HostTime | None:
        """When that tick was, for a tick within a month of the newest; None before the first.

        The further from the packages of the last minute, the less certain.
        """
        if self._last_tick is None:
            return None
        device = self._unwrapped(tick)
        return HostTime(device + self._offset_at(device), self._uncertainty_at(device))
