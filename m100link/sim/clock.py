"""Event loops with a time of their own: N times faster, or virtual.

The virtual aircraft takes its time from the event loop, so a faster loop is a faster aircraft::

    with asyncio.Runner(loop_factory=virtual_clock_loop) as runner:
        runner.run(minutes_of_flight())            # half a second for each of them

The **virtual** clock never waits: when nothing is ready to run, time jumps to the next timer. It is
exact and repeatable, for everything that stays inside the process. Threads and other processes do
not know about it: while one of them works, virtual time may run on for hours. For real ports use
the **scaled** clock, which waits, only shorter.
"""

from __future__ import annotations

import asyncio
import selectors
import time
from collections.abc import Callable
from typing import Any

__all__ = [
    "LockstepEventLoop",
    "ScaledEventLoop",
    "VirtualClockEventLoop",
    "loop_factory",
    "virtual_clock_loop",
]

_Events = list[tuple[selectors.SelectorKey, int]]


class _ScaledSelector(selectors.DefaultSelector):
    """Waits a fraction of the time it is asked to wait."""

    speed = 1.0

    def select(self, timeout: float | None = None) -> _Events:
        return super().select(None if timeout is None else timeout / self.speed)


class ScaledEventLoop(asyncio.SelectorEventLoop):
    """An event loop whose seconds are shorter (speed above 1) or longer (below 1).

    Args:
        speed: Loop seconds per real second, above 0.
    """

    def __init__(self, speed: float) -> None:
        selector = _ScaledSelector()
        selector.speed = speed
        self._speed = speed
        self._start: float | None = None
        super().__init__(selector)
        if not speed > 0.0:
            self.close()  # a loop that was begun must be ended
            raise ValueError(f"speed must be above 0, got {speed}")
        self._start = super().time()
        # Timers due within one tick of the clock count as due; the tick is scaled, too.
        self._clock_resolution = time.get_clock_info("monotonic").resolution * speed

    @property
    def speed(self) -> float:
        """Loop seconds per real second."""
        return self._speed

    def time(self) -> float:
        """Loop seconds; equal to the monotonic clock when the loop was made."""
        now = super().time()
        return now if self._start is None else self._start + (now - self._start) * self._speed


class _JumpingSelector(selectors.DefaultSelector):
    """Instead of waiting, lets the clock jump over the time it was asked to wait."""

    now = 0.0
    waiters = 0  # only where time stands still without one
    _unpolled = 0
    _registered = 0

    def register(self, *args: Any, **options: Any) -> selectors.SelectorKey:
        key = super().register(*args, **options)
        self._registered = len(self.get_map())
        return key

    def unregister(self, *args: Any, **options: Any) -> selectors.SelectorKey:
        key = super().unregister(*args, **options)
        self._registered = len(self.get_map())
        return key

    def select(self, timeout: float | None = None) -> _Events:
        if timeout is None:  # no timer at all: only a thread or a file can end this wait
            return super().select(None)
        # With nothing registered but the loop's own pipe, which only wakes a loop that waits,
        # there is no need to ask the system on every pass.
        self._unpolled += 1
        if self._unpolled < 50 and self._registered <= 1:
            events: _Events = []
        else:
            self._unpolled = 0
            events = super().select(0)
        if not events and timeout > 0.0:
            self.now += timeout
        return events


class VirtualClockEventLoop(asyncio.SelectorEventLoop):
    """An event loop without waiting: idle, its time jumps to the next timer. It starts at 0."""

    _selector_class = _JumpingSelector

    def __init__(self) -> None:
        self._jumping = self._selector_class()
        super().__init__(self._jumping)

    def time(self) -> float:
        """Virtual seconds since the loop was made."""
        return self._jumping.now

    async def shutdown_default_executor(self, timeout: float | None = None) -> None:
        """Wait for the executor's threads, however long they take.

        They work in real time: virtual time would jump over the limit (Python 3.13) at once.
        """
        await super().shutdown_default_executor()


class _LockstepSelector(_JumpingSelector):
    """Jumps while somebody waits for what will be; otherwise it sleeps until somebody does."""

    def select(self, timeout: float | None = None) -> _Events:
        if self.waiters == 0 and timeout != 0.0:
            return selectors.DefaultSelector.select(self, None)
        return super().select(timeout)


class LockstepEventLoop(VirtualClockEventLoop):
    """A virtual clock for a program in another thread: it stands still unless that one waits.

    What the program does between two calls takes no time, however long it takes. So a flight from
    another thread is as exact and repeatable as one on the virtual clock.
    """

    _selector_class = _LockstepSelector

    def begin_waiting(self) -> None:
        """From here on time passes. Call it in the loop's own thread."""
        self._jumping.waiters += 1

    def end_waiting(self) -> None:
        """Time stands still again, when everybody who waited has called this."""
        self._jumping.waiters -= 1


def virtual_clock_loop() -> asyncio.AbstractEventLoop:
    """A new loop with a virtual clock, as ``loop_factory`` for :class:`asyncio.Runner`."""
    return VirtualClockEventLoop()


def loop_factory(speed: float = 1.0) -> Callable[[], asyncio.AbstractEventLoop]:
    """A ``loop_factory`` for a speed: 1 is the ordinary loop, infinity the virtual clock."""
    if speed == 1.0:
        return asyncio.new_event_loop
    if speed == float("inf"):
        return virtual_clock_loop
    if not speed > 0.0:
        raise ValueError(f"speed must be above 0, got {speed}")
    return lambda: ScaledEventLoop(speed)
