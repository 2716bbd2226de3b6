"""Event loops with a time of their own: N times faster, or virtual.

The virtual aircraft takes its time from the event loop, so a faster loop is a faster aircraft::

    with asyncio.Runner(loop_factory=virtual_clock_loop) as runner:
        runner.run(minutes_of_flight())            # half a second for each of them

The **virtual** clock does not wait for its timers: when nothing is ready to run, time jumps to the
next. It is exact and repeatable, for everything that stays inside the process. While a thread works
for the loop (``asyncio.to_thread``, ``loop.run_in_executor``), time stands still. Other threads and
processes do not know about it: while one of them works, virtual time may run on for hours. For real
ports use the **scaled** clock, which waits, only shorter.
"""

from __future__ import annotations

import asyncio
import math
import selectors
import threading
import time
import warnings
from collections.abc import Callable
from typing import Any, TypeVar, TypeVarTuple, Unpack

__all__ = [
    "LockstepEventLoop",
    "ScaledEventLoop",
    "VirtualClockEventLoop",
    "loop_factory",
    "virtual_clock_loop",
]

_Events = list[tuple[selectors.SelectorKey, int]]
_Result = TypeVar("_Result")
_Given = TypeVarTuple("_Given")


_LONGEST_STEP_S = 0.1
"""Loop seconds that may pass between two looks at the clock, besides a wait that was asked for.

A machine that is busy for 50 ms does not run the loop meanwhile, and a hundred times faster that
would be five seconds in which neither the aircraft nor its program did anything: time-outs and
watchdogs would tell of a broken line. So the clock waits for its loop, as long as it is faster
than real.
"""


class _ScaledSelector(selectors.DefaultSelector):
    """Waits a fraction of the time it is asked to wait."""

    speed = 1.0
    waited = 0.0  # loop seconds that it was asked to wait since the clock was looked at

    def select(self, timeout: float | None = None) -> _Events:
        if timeout is None:  # no timer at all, so nobody is late however long it takes
            self.waited = math.inf
            return super().select(None)
        self.waited += timeout
        return super().select(timeout / self.speed)


class ScaledEventLoop(asyncio.SelectorEventLoop):
    """An event loop whose seconds are shorter (speed above 1) or longer (below 1).

    Where it is faster than real and the machine does not keep up, it is as fast as that goes: a
    moment in which the loop was not run is at most 0.1 of its seconds.

    Args:
        speed: Loop seconds per real second, above 0.
        real_time: The clock that it follows, s.
    """

    def __init__(self, speed: float, *, real_time: Callable[[], float] = time.monotonic) -> None:
        self._real_time = real_time
        self._seen = self._now = real_time()
        self._speed = speed
        self._longest_step = _LONGEST_STEP_S if speed > 1.0 else math.inf
        self._scaled = _ScaledSelector()
        self._scaled.speed = speed
        super().__init__(self._scaled)
        if not speed > 0.0:
            self.close()  # a loop that was begun must be ended
            raise ValueError(f"speed must be above 0, got {speed}")

    @property
    def speed(self) -> float:
        """Loop seconds per real second."""
        return self._speed

    def time(self) -> float:
        """Loop seconds; equal to the monotonic clock when the loop was made."""
        seen = self._real_time()
        passed = (seen - self._seen) * self._speed
        self._seen = seen
        self._now += min(passed, self._scaled.waited + self._longest_step)
        self._scaled.waited = 0.0
        return self._now


_FAIR_S = 0.005  # real time; after which an interpreter asks a thread for its lock, too
_MOMENT_S = 0.0001
_HANGS_S = 20.0
"""Real seconds for which time stands still for a thread: longer than a log waits for its disk."""


class _JumpingSelector(selectors.DefaultSelector):
    """Instead of waiting, lets the clock jump over the time it was asked to wait."""

    now = 0.0
    waiters = 0  # only where time stands still without one
    _unpolled = 0
    _slept_at = 0.0  # real time, s

    def __init__(self) -> None:
        super().__init__()
        self.working: dict[object, float] = {}  # what threads work at, until when it is waited for

    def select(self, timeout: float | None = None) -> _Events:
        if timeout is None:  # no timer at all: only a thread or a file can end this wait
            return super().select(None)
        if self.working and timeout > 0.0:
            return self._wait_for_threads()
        # With nothing registered but the loop's own pipe, which only wakes a loop that waits,
        # there is no need to ask the system on every pass.
        self._unpolled += 1
        if self._unpolled < 50 and len(self.get_map()) <= 1:
            events: _Events = []
        else:
            self._unpolled = 0
            events = super().select(0)
        if not events and timeout > 0.0:
            self.now += timeout
            self._let_threads_run()
        return events

    def _wait_for_threads(self) -> _Events:
        """Wait in real time for a thread that calls back; no virtual time passes."""
        now = time.monotonic()
        if left := [until - now for until in self.working.values() if until > now]:
            return super().select(min(left))
        self.working.clear()
        warnings.warn(
            f"a thread has worked for {_HANGS_S:g} s: virtual time goes on without it\n"
            "  likely cause: it hangs, or it waits for what needs time of this event loop\n"
            "  what to do:   let it wait in a threading.Thread, which holds no virtual time",
            RuntimeWarning,
            stacklevel=2,
        )
        return []

    def _let_threads_run(self) -> None:
        """Sleep for a moment of real time, now and then, where there is anybody to run.

        A thread that never sleeps and polls all the time starves the others: each poll gives up
        the interpreter's lock and has it back before another thread has woken up.
        """
        if time.monotonic() - self._slept_at >= _FAIR_S:
            if threading.active_count() > 1 or len(self.get_map()) > 1:
                time.sleep(_MOMENT_S)
            self._slept_at = time.monotonic()


class VirtualClockEventLoop(asyncio.SelectorEventLoop):
    """An event loop without waiting: idle, its time jumps to the next timer. It starts at 0.

    Time stands still while a thread of an executor works for it; after 20 real seconds it goes on,
    with a ``RuntimeWarning``. A ``threading.Thread`` of your own does not hold it.
    """

    _selector_class = _JumpingSelector

    def __init__(self) -> None:
        self._jumping = self._selector_class()
        super().__init__(self._jumping)

    def time(self) -> float:
        """Virtual seconds since the loop was made."""
        return self._jumping.now

    def run_in_executor(
        self, executor: Any, func: Callable[[Unpack[_Given]], _Result], *args: *_Given
    ) -> asyncio.Future[_Result]:
        """Call it in a thread. Time stands still until its result is there, or is given up."""
        future = super().run_in_executor(executor, func, *args)
        self._jumping.working[future] = time.monotonic() + _HANGS_S
        future.add_done_callback(lambda done: self._jumping.working.pop(done, None))
        return future

    def call_exception_handler(self, context: dict[str, Any]) -> None:
        """As usual, but what is to end a program or a test (its time limit) ends the loop.

        asyncio goes on after an exception of a callback, and a callback may come again for ever
        without that any virtual time passes.
        """
        error = context.get("exception") if "handle" in context else None
        if error is not None and not isinstance(error, Exception | asyncio.CancelledError):
            raise error
        super().call_exception_handler(context)

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

    The program's own work between two calls takes no virtual time. So a flight from another thread
    is as exact and repeatable as one on the virtual clock.
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
