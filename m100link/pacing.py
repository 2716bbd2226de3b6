"""Ticks at a steady rate: absolute deadlines, missed ones skipped and counted, never a burst."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import Self

from m100link.errors import UsageError

__all__ = ["MAX_RATE_HZ", "Tick", "Ticker"]

MAX_RATE_HZ = 50.0
"""The highest rate at which the autopilot takes movement commands (errata, section on rates)."""


@dataclass(frozen=True, slots=True)
class Tick:
    """One tick of a control loop.

    Attributes:
        index: Number of the deadline, from 0; missed ones are counted in.
        elapsed: Seconds from the first deadline to this one.
        missed: Deadlines skipped since the tick before, because the loop was late.
        lateness: Seconds from the deadline to now; never negative.
    """

    index: int
    elapsed: float
    missed: int
    lateness: float


class Ticker:
    """An async iterator of :class:`Tick`.

    Args:
        rate_hz: Ticks per second, more than 0, at most 50.

    Attributes:
        missed: Deadlines skipped in all.

    Raises:
        UsageError: A rate outside that range.
    """

    def __init__(self, rate_hz: float = MAX_RATE_HZ) -> None:
        if not 0 < rate_hz <= MAX_RATE_HZ:
            raise UsageError(
                f"a control loop cannot run at {rate_hz} Hz",
                cause=f"the autopilot takes movement commands at up to {MAX_RATE_HZ:g} Hz",
                remedy=f"choose a rate up to {MAX_RATE_HZ:g}",
            )
        self.period = 1.0 / rate_hz
        self.missed = 0
        self._start: float | None = None
        self._index = -1

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Tick:
        loop = asyncio.get_running_loop()
        now = loop.time()
        if self._start is None:
            self._start = now
        index = self._index + 1
        if now > self._start + (index + 1) * self.period:
            # More than a whole period late: take up the grid at its next point instead of
            # making up for lost ticks all at once.
            index = int((now - self._start) / self.period) + 1
        missed = index - self._index - 1
        self.missed += missed
        self._index = index
        deadline = self._start + index * self.period
        await self._sleep_until(loop, deadline)
        return Tick(index, index * self.period, missed, max(0.0, loop.time() - deadline))

    async def _sleep_until(self, loop: asyncio.AbstractEventLoop, deadline: float) -> None:
        # At least one pass of the loop, so that a loop that is always late does not starve others.
        await asyncio.sleep(0)
        if loop.time() < deadline:
            waiter: asyncio.Future[None] = loop.create_future()
            handle = loop.call_at(deadline, _wake, waiter)
            try:
                await waiter
            finally:
                handle.cancel()


def _wake(waiter: asyncio.Future[None]) -> None:
    if not waiter.done():
        waiter.set_result(None)
