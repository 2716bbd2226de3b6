"""Ticks at a steady rate: absolute deadlines, missed ones skipped and counted, never a burst."""

from __future__ import annotations

import asyncio
import ctypes
import math
import os
import sys
import time
import weakref
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import Self

from m100link.errors import UsageError

__all__ = ["Tick", "Ticker"]

MAX_RATE_HZ = 50.0
"""The highest rate at which the autopilot takes movement commands (errata, section on rates)."""


@dataclass(frozen=True, slots=True)
class Tick:
    """One tick of a control loop."""

    index: int  #: Number of the deadline, from 0; missed ones are counted in.
    elapsed: float  #: Seconds from the first deadline to this one.
    missed: int  #: Deadlines skipped since the tick before, because the loop was late.
    lateness: float  #: Seconds from the deadline to now; never negative.


class Ticker:
    """An async iterator of :class:`Tick`.

    Args:
        rate_hz: Ticks per second, more than 0, at most 50.

    Attributes:
        period: Seconds between ticks.
        missed: Deadlines skipped in all.

    Raises:
        UsageError: A rate outside that range.
    """

    def __init__(self, rate_hz: float = MAX_RATE_HZ) -> None:
        self.period = period_of(rate_hz)
        self.missed = 0
        self._start: float | None = None
        self._index = -1
        self._alarm = DeadlineTimer()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Tick:
        loop = asyncio.get_running_loop()
        now = loop.time()
        if self._start is None:
            self._start = now
        index = self._index + 1
        if now >= self._start + (index + 1) * self.period:
            # More than a whole period late: take up the grid at its next point instead of
            # making up for lost ticks all at once.
            index = math.ceil((now - self._start) / self.period)
        missed = index - self._index - 1
        self.missed += missed
        self._index = index
        deadline = self._start + index * self.period
        if deadline - now > INSTANT:
            await self._alarm.sleep_until(deadline)
        else:  # a consumer that is always late must not starve the others
            await asyncio.sleep(0)
        return Tick(index, index * self.period, missed, max(0.0, loop.time() - deadline))


@cache  # asked for each setpoint
def period_of(rate_hz: float) -> float:
    """Seconds between ticks; ``UsageError`` unless above 0 and at most 50 Hz."""
    if not 0 < rate_hz <= MAX_RATE_HZ:
        raise UsageError(
            f"a control loop cannot run at {rate_hz} Hz",
            cause=f"the autopilot takes movement commands at up to {MAX_RATE_HZ:g} Hz",
            remedy=f"choose a rate up to {MAX_RATE_HZ:g}",
        )
    return 1.0 / rate_hz


INSTANT = 1e-9
"""Seconds that an event loop takes for none: it runs a timer beside another one that is due."""


class Lead:
    """How much earlier than its deadline an alarm is set, because waking takes its time.

    From the system's timer to the waiting task some tens of microseconds pass, on each machine its
    own. The lead follows the lower quartile of that: three wakings of four come late by the rest,
    and one waits a moment more. That wait is passes of the event loop, which serve everybody else.
    """

    STEP = 2e-6
    MOST = 200e-6  # whatever the machine does: one percent of a processor at 50 Hz

    def __init__(self) -> None:
        self.seconds = 0.0  # the lead, 0 to 200 µs

    def woke(self, too_early: bool) -> None:
        """Follow what a waking showed."""
        # In balance where one waking of four is too early: that is the lower quartile.
        change = -3 * self.STEP if too_early else self.STEP
        self.seconds = min(max(self.seconds + change, 0.0), self.MOST)


class DeadlineTimer:
    """Sleeps until an absolute time of the event loop's clock, never less than an instant before.

    The event loop rounds its time-outs up to whole milliseconds. Where the system has timerfd
    (Linux), it is used instead, a :class:`Lead` before the deadline; on event loops with a clock of
    their own (virtual or scaled time, uvloop), and elsewhere, ``asyncio.sleep`` does it.
    """

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._fd = -1
        # A loop with a clock of its own (virtual time, uvloop) would be woken by the wrong one.
        if type(self._loop).time is asyncio.BaseEventLoop.time:
            self._fd = _create_timer()
        self._waiter: asyncio.Future[None] | None = None
        self._lead = Lead()
        if self._fd >= 0:
            # The loop must not keep it alive: a Ticker has no end that its user would mark.
            alarm: weakref.ref[DeadlineTimer] = weakref.ref(self)
            self._loop.add_reader(self._fd, _ring, alarm)
            _alarms.add(self)

    async def sleep_until(self, deadline: float) -> None:
        """Return at ``deadline`` or a little later; at once when it has passed."""
        if self._fd >= 0:
            await self._sleep_by_timer(deadline)
            return
        left = deadline - self._loop.time()
        while left > INSTANT:  # a timer may come a moment early
            await asyncio.sleep(left)
            left = deadline - self._loop.time()

    async def _sleep_by_timer(self, deadline: float) -> None:
        clock, lead = self._loop.time, self._lead
        while (left := deadline - clock()) > lead.seconds:
            self._waiter = self._loop.create_future()
            # The loop's clock is the monotonic one. A nanosecond more: rounding is not early.
            _arm_timer(self._fd, deadline - lead.seconds + 1e-9)
            await self._waiter
            lead.woke(clock() < deadline)
        while left > 0:
            await asyncio.sleep(0)
            left = deadline - clock()

    def _on_alarm(self) -> None:
        # First: where that fails for want of memory, the loop calls again, because nothing was
        # read. A task that sleeps on sends no neutral.
        if self._waiter is not None and not self._waiter.done():
            self._waiter.set_result(None)
        with suppress(BlockingIOError):  # it was set again before it was read
            os.read(self._fd, 8)

    def close(self) -> None:
        """Give the timer back. May be called any number of times."""
        if self._fd >= 0:
            if not self._loop.is_closed():
                self._loop.remove_reader(self._fd)
            os.close(self._fd)
            self._fd = -1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        if getattr(self, "_fd", -1) >= 0:
            self.close()


def _ring(reference: weakref.ref[DeadlineTimer]) -> None:
    alarm = reference()
    if alarm is not None:
        alarm._on_alarm()


def _after_fork() -> None:
    """A child has the parent's timers, and would set and hear them in its place."""
    for alarm in [each for each in _alarms if each._fd >= 0]:
        own = _create_timer()
        if own >= 0:
            os.dup2(own, alarm._fd, inheritable=False)
            os.close(own)
        else:
            os.close(alarm._fd)


_alarms: weakref.WeakSet[DeadlineTimer] = weakref.WeakSet()
if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_after_fork)


class _Timespec(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


class _TimerSpec(ctypes.Structure):
    _fields_ = (("interval", _Timespec), ("value", _Timespec))


_TFD_TIMER_ABSTIME = 1
_libc: ctypes.CDLL | None = None


def _create_timer() -> int:
    """A non-blocking timerfd on the monotonic clock; -1 where there is none.

    By ctypes because :func:`os.timerfd_create` came with Python 3.13.
    """
    global _libc
    if not sys.platform.startswith("linux"):
        return -1
    if _libc is None:
        _libc = ctypes.CDLL(None, use_errno=True)
    create = getattr(_libc, "timerfd_create", None)
    if create is None:
        return -1
    return int(create(time.CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC))


def _arm_timer(fd: int, deadline: float) -> None:
    assert _libc is not None
    seconds = int(deadline)
    spec = _TimerSpec(_Timespec(0, 0), _Timespec(seconds, int((deadline - seconds) * 1e9)))
    if _libc.timerfd_settime(fd, _TFD_TIMER_ABSTIME, ctypes.byref(spec), None) != 0:
        raise OSError(ctypes.get_errno(), "timerfd_settime failed")
