"""From the aircraft's tick to the time of this computer, with a stated uncertainty.

A package is received some delay after its tick was taken. The delay varies (serial buffers, USB,
scheduling) but is never negative, so the earliest arrivals tell most: of each second the one with
the least apparent delay is kept, and a line through these gives offset and skew. The constant part
of the delay cannot be seen from one side; it is not in the uncertainty, and is at least the time of
a package on the line (6 ms at 230400 baud).
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

__all__ = ["DeviceClock", "HostTime"]

_WRAP = 1 << 32
_BIN_S = 1.0
_BINS = 60
_RESET_S = 2.0


class HostTime(NamedTuple):
    """An estimated time on the event loop's clock.

    Attributes:
        time: Seconds.
        uncertainty_s: Half width within which the estimate moves, s.
    """

    time: float
    uncertainty_s: float


class DeviceClock:
    """Relates device ticks to host time.

    Args:
        tick_hz: Ticks per second, 600 or 400 by firmware.

    Attributes:
        tick_hz: As given.
        resets: How often the tick jumped, as after a reboot of the aircraft.
    """

    def __init__(self, tick_hz: int) -> None:
        self.tick_hz = tick_hz
        self.resets = 0
        self._start()

    def _start(self) -> None:
        self._last_tick: int | None = None
        self._device = 0.0  # unwrapped device time of the newest tick, s
        self._bins: deque[tuple[float, float]] = deque(maxlen=_BINS)  # device time, apparent offset
        self._best: tuple[float, float] | None = None
        self._bin_end = 0.0
        self._slope = 0.0
        self._intercept = 0.0
        self._spread = 0.0

    def update(self, tick: int, received_at: float) -> None:
        """A package with this tick arrived."""
        if self._last_tick is None:
            self._device = tick / self.tick_hz
        else:
            step = (tick - self._last_tick) % _WRAP
            if step >= _WRAP // 2:
                step -= _WRAP
            device = self._device + step / self.tick_hz
            expected = device + self._offset_at(device)
            if step < 0 or abs(received_at - expected) > _RESET_S:
                self.resets += 1
                self._start()
                device = tick / self.tick_hz
            self._device = device
        self._last_tick = tick
        self._count(self._device, received_at - self._device)

    def _count(self, device: float, offset: float) -> None:
        if self._best is None:
            self._best = (device, offset)
            self._bin_end = device + _BIN_S
            if not self._bins:
                self._intercept = offset
            return
        if offset < self._best[1]:
            self._best = (device, offset)
            if not self._bins:
                self._intercept = offset
        if device >= self._bin_end:
            self._bins.append(self._best)
            self._best = None
            self._fit()

    def _fit(self) -> None:
        """Least squares through the earliest arrival of each second."""
        points = self._bins
        count = len(points)
        mean_x = sum(x for x, _ in points) / count
        mean_y = sum(y for _, y in points) / count
        square = sum((x - mean_x) ** 2 for x, _ in points)
        # Over less than some seconds, jitter would pass for skew.
        if count >= 5:
            self._slope = sum((x - mean_x) * (y - mean_y) for x, y in points) / square
        self._intercept = mean_y - self._slope * mean_x
        self._spread = max(abs(y - self._offset_at(x)) for x, y in points)

    def _offset_at(self, device: float) -> float:
        return self._intercept + self._slope * device

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
        """Half width of the estimate, s: what the earliest arrivals scatter, and one tick."""
        unsettled = 0.02 if len(self._bins) < 2 else 0.0
        return self._spread + 1.0 / self.tick_hz + unsettled

    def host_time(self, tick: int) -> HostTime | None:
        """When that tick was, for a tick within a month of the newest; None before the first."""
        if self._last_tick is None:
            return None
        step = (tick - self._last_tick) % _WRAP
        if step >= _WRAP // 2:
            step -= _WRAP
        device = self._device + step / self.tick_hz
        return HostTime(device + self._offset_at(device), self.uncertainty_s)
