"""From the aircraft's tick to the time of this computer, with a bound that holds.

A package is received some delay after its tick was taken. The delay varies (serial buffers, USB,
scheduling) but is never negative, so the earliest arrivals tell most: of each second the one with
the least apparent delay is kept, and a line through these gives offset and skew. The constant part
of the delay cannot be seen from one side; it is not in the uncertainty, and is at least the time of
a package on the line (6 ms at 230400 baud).

A package costs a note of its tick and arrival. Notes are looked at together, when there are some or
somebody asks: what the clock says is the same as if each had been looked at when it came.

A late package may have waited in a buffer while this program was busy, or the device clock may
have stepped back: one package does not show which. The stated bound therefore reaches from the line
to the newest arrival, and only seconds whose packages come at their own pace move the line.
"""

from __future__ import annotations

import math
from collections import deque
from operator import mul, sub
from typing import NamedTuple

__all__ = ["DeviceClock", "HostTime"]

_WRAP = 1 << 32
_MASK = _WRAP - 1
_HALF = _WRAP // 2
_SECONDS = 60  # seconds that the line is fitted through
_SECOND_S = 1.0
_SECOND_COUNT = 20  # fewer arrivals do not show what an ordinary delay is
_FIT_COUNT = 5  # over fewer seconds, jitter would pass for skew
_LATE_COUNT = 5  # seconds late one after the other are a step back
_MAX_SKEW = 200e-6  # two crystals, each good to 100 ppm
_BACKLOG_S = 0.1  # lateness that only packages have which waited
_BACKLOG_GONE_S = 0.5  # without such lateness for so long, nothing waits any more
_NOTES = 64  # looked at together


class HostTime(NamedTuple):
    """An estimated time on the event loop's clock."""

    time: float  #: Seconds.
    #: Half width within which the truth lies, s; infinite while nothing is known.
    uncertainty_s: float


class _Second(NamedTuple):
    """The earliest arrival of a second."""

    device: float  # its device time, s
    offset: float  # its arrival minus its device time, s
    # By how much half of the arrivals were later, s. A second whose very earliest arrival is late
    # by more than that had to have every arrival in the upper part of their range.
    width: float


class DeviceClock:
    """Relates device ticks to host time.

    Args:
        tick_hz: Ticks per second, 600 or 400 by firmware.

    Attributes:
        tick_hz: As given.
    """

    __slots__ = (
        *("_arrivals", "_arrivals_since", "_backlog", "_backlog_at", "_device", "_floor"),
        *("_intercept", "_last_tick", "_late", "_newest", "_notes", "_received_at"),
        *("_resets", "_seconds", "_silence", "_slope", "_spread", "tick_hz"),
    )

    def __init__(self, tick_hz: int) -> None:
        self.tick_hz = tick_hz
        self._notes: list[tuple[int, float]] = []  # tick and arrival, not looked at yet
        self._resets = 0
        self._start()

    def _start(self) -> None:
        self._last_tick: int | None = None
        self._device = 0.0  # unwrapped device time of the newest tick, s
        self._received_at = 0.0  # when it arrived: packages of one read share it
        self._newest = 0.0  # and its offset
        self._silence = 0.0  # how long nothing was read before it
        self._arrivals: list[tuple[float, float]] = []  # device time and offset, one per read
        self._arrivals_since = 0.0
        self._seconds: deque[_Second] = deque(maxlen=_SECONDS)
        self._late: list[_Second] = []  # seconds outside the bound since the last one within
        self._backlog = 0.0  # the worst lateness of what waited
        self._backlog_at = 0.0
        self._slope = 0.0
        self._intercept = math.inf
        self._spread = 0.0
        self._floor = (-math.inf, 0.0)  # intercept and slope of where the bound ends below

    def update(self, tick: int, received_at: float) -> None:
        """A package with this tick arrived."""
        notes = self._notes
        notes.append((tick, received_at))
        if len(notes) >= _NOTES:
            self._look()

    def _look(self) -> None:
        """Look at the notes. Whatever is asked of the clock begins with it."""
        # Every package of every line comes by, so what is of one package alone stays in locals
        # until somebody else wants it.
        notes, self._notes = self._notes, []
        if not notes:
            return
        tick_hz, since, before = self.tick_hz, self._arrivals_since, self._silence
        last_tick, last_device, last_at = self._last_tick, self._device, self._received_at
        arrivals, newest = self._arrivals, self._newest
        slope, intercept = self._slope, self._intercept
        floor, floor_slope = self._floor
        if last_tick is None:
            last_tick = notes[0][0]
            last_device = last_tick / tick_hz
        for tick, received_at in notes:
            step = tick - last_tick
            if not 0 <= step < _HALF:  # it wrapped, or went back
                step &= _MASK
                step -= _WRAP if step >= _HALF else 0
            gap = step / tick_hz
            device = last_device + gap
            offset = received_at - device
            # The tick went back, or a package came before it can have been sent: the clock jumped.
            if step < 0 or offset < floor + floor_slope * device:
                self._resets += 1
                self._start()
                last_device, last_at, arrivals = self._device, self._received_at, self._arrivals
                slope, intercept = self._slope, self._intercept
                floor, floor_slope = self._floor
                device = tick / tick_hz
                offset = received_at - device
                before = self._silence
            silence = received_at - last_at
            if not arrivals:
                since = received_at
            elif silence > 0:  # the read before this one is complete
                if newest - (intercept + slope * last_device) > _BACKLOG_S:
                    self._device, self._received_at = last_device, last_at
                    self._newest, self._silence = newest, before
                    self._note_backlog()
                if received_at - since >= _SECOND_S and len(arrivals) >= _SECOND_COUNT:
                    self._end_second()
                    slope, intercept = self._slope, self._intercept
                    floor, floor_slope = self._floor
                    self._arrivals = arrivals = []
                    since = received_at
            if silence > 0:
                before = silence
            # This package follows sooner than its tick: the one before waited, and shows no delay.
            if silence < gap / 2 and arrivals:
                arrivals[-1] = (device, offset)
            else:
                arrivals.append((device, offset))
            last_tick, last_device, last_at, newest = tick, device, received_at, offset
            if offset < intercept and not self._seconds:
                self._intercept = intercept = offset
        self._last_tick, self._device, self._received_at = last_tick, last_device, last_at
        self._newest, self._silence, self._arrivals_since = newest, before, since

    def _note_backlog(self) -> None:
        """The newest package, the last of its read, may have waited."""
        if self._seconds:
            waited = self._waited()
            is_over = self._received_at > self._backlog_at + _BACKLOG_GONE_S
            self._backlog = waited if is_over else max(self._backlog, waited)
            self._backlog_at = self._received_at

    def _end_second(self) -> None:
        slope = self._slope
        delays = [offset - slope * device for device, offset in self._arrivals]
        delay = min(delays)
        device, offset = self._arrivals[delays.index(delay)]
        second = _Second(device, offset, sorted(delays)[len(delays) // 2] - delay)
        if offset - self._offset_at(device) > self._bound_at(device):
            self._late.append(second)
            if len(self._late) < _LATE_COUNT:
                return
            self._resets += 1
            self._seconds = deque(self._late, maxlen=_SECONDS)
        else:
            # A second that this one shows to have been late from end to end says nothing.
            slack = second.width + 1.0 / self.tick_hz
            latest = offset + slack
            kept = [
                earlier
                for earlier in self._seconds
                if earlier.offset <= latest + _MAX_SKEW * abs(device - earlier.device)
            ]
            self._seconds = deque([*kept, second], maxlen=_SECONDS)
        self._late = []
        self._fit()

    def _fit(self) -> None:
        """Least squares through the earliest arrival of each second."""
        devices, offsets, widths = zip(*self._seconds, strict=True)
        count = len(devices)
        mean_x, mean_y = sum(devices) / count, sum(offsets) / count
        slope = 0.0
        if count >= _FIT_COUNT:
            aside = [x - mean_x for x in devices]
            square = sum([x**2 for x in aside])
            product = sum(map(mul, aside, [y - mean_y for y in offsets]))
            if square:  # a tick that stands still has no slope
                slope = max(-_MAX_SKEW, min(_MAX_SKEW, product / square))
        intercept = mean_y - slope * mean_x
        residual = max(map(abs, map(sub, offsets, [intercept + slope * x for x in devices])))
        self._slope, self._intercept = slope, intercept
        self._spread = residual + sum(widths) / count + 1.0 / self.tick_hz
        last, drift = devices[-1], self._drift()
        self._floor = (self._intercept - self._spread + drift * last, self._slope - drift)

    def _drift(self) -> float:
        """How fast the line may leave the truth beyond the seconds that it goes through."""
        if len(self._seconds) < _FIT_COUNT:
            return _MAX_SKEW
        span = self._seconds[-1].device - self._seconds[0].device
        return min(_MAX_SKEW, 2 * self._spread / span) if span else _MAX_SKEW

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

        A package that waited during a jump of the clock comes less late than it waited.
        """
        late = self._newest - self._offset_at(self._device)
        return max(late, self._silence) if late > _BACKLOG_S else abs(late)

    def _uncertainty_at(self, device: float) -> float:
        bound = max(self._bound_at(device), self._waited())
        waiting = self._received_at <= self._backlog_at + _BACKLOG_GONE_S
        return max(bound, self._backlog) if waiting else bound

    @property
    def resets(self) -> int:
        """How often the tick jumped, either way, as after a reboot of the aircraft."""
        self._look()
        return self._resets

    @property
    def offset_s(self) -> float | None:
        """Host time minus device time now, s; None before the first package."""
        self._look()
        return None if self._last_tick is None else self._offset_at(self._device)

    @property
    def skew_ppm(self) -> float:
        """How much faster the host clock runs, parts per million; 0 in the first seconds."""
        self._look()
        return self._slope * 1e6

    @property
    def uncertainty_s(self) -> float:
        """Half width of the estimate for the newest package, s.

        Infinite until a second of arrivals at their own pace. It is what the earliest arrivals
        scatter, what half of the arrivals are later, and one tick; more while packages come late.
        """
        self._look()
        return self._uncertainty_at(self._device)

    def host_time(self, tick: int) -> HostTime | None:
        """When that tick was, for a tick within a month of the newest; None before the first.

        The further from the packages of the last minute, the less certain.
        """
        self._look()
        if self._last_tick is None:
            return None
        step = (tick - self._last_tick) & _MASK
        device = self._device + (step if step < _HALF else step - _WRAP) / self.tick_hz
        return HostTime(device + self._offset_at(device), self._uncertainty_at(device))
