"""The one task that sends setpoints."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable

from m100link.flight.pacing import MAX_RATE_HZ, Alarm
from m100link.protocol.setpoint import Setpoint

__all__ = ["NEUTRAL_TIME", "SETPOINT_LIFETIME", "SetpointLoop"]

_logger = logging.getLogger("m100link.flight")

SETPOINT_LIFETIME = 0.2
"""Seconds that a setpoint is repeated when the program does not renew it."""

NEUTRAL_TIME = 0.3
"""Seconds of neutral after a setpoint expired; then silence, on which the aircraft hovers."""

_SLACK = 0.1
"""Part of a period by which a program that ticks itself may be early or late on our grid."""


class SetpointLoop:
    """Sends the present setpoint at a steady rate until it expires.

    A setpoint goes out at once when the last transmission is a period ago, else at the end of that
    period, and is repeated each period until it is renewed, replaced, or expires. After expiry: the
    mode's neutral for a moment, then silence. Nothing older than its lifetime is ever repeated.

    Time is cut into periods, and no period gets two frames, however often the program sends: faster
    than 50 Hz the autopilot is said to ignore commands at random. A program that ticks at the same
    rate jitters around our grid; so what comes a little early goes out at once, and while a
    program renews, repeating waits that little for it. Otherwise every frame would carry the
    value of the tick before.

    Args:
        send: Puts a setpoint on the line.

    Attributes:
        sent: Frames sent, neutrals included.
        expired: Setpoints that were not renewed in time.
    """

    def __init__(self, send: Callable[[Setpoint], bool]) -> None:
        self._send = send
        self._loop = asyncio.get_running_loop()
        self._period = 1.0 / MAX_RATE_HZ
        self._setpoint: Setpoint | None = None
        self._expires_at = 0.0
        self._silent_at = 0.0
        self._next_at = float("-inf")
        self._is_renewed = False
        self._news = asyncio.Event()
        self._task: asyncio.Task[None] | None = None
        self.sent = 0
        self.expired = 0

    @property
    def current(self) -> Setpoint | None:
        """What is being sent, None in silence."""
        return self._setpoint

    def set(
        self, setpoint: Setpoint, *, lifetime: float, period: float = 1.0 / MAX_RATE_HZ
    ) -> None:
        """Send this from now on, for its lifetime."""
        now = self._loop.time()
        self._setpoint = setpoint
        self._period = period
        self._expires_at = now + lifetime
        self._silent_at = self._expires_at + NEUTRAL_TIME
        self._is_renewed = True
        self._send_if_due(now)

    def _send_if_due(self, now: float) -> None:
        """Send now unless this period has had its frame; the task sends it when the next begins."""
        assert self._setpoint is not None
        if now >= self._next_at - _SLACK * self._period:
            self._transmit(self._setpoint, now)
        if self._task is None or self._task.done():  # done: somebody cancelled every task
            self._task = asyncio.create_task(self._run(), name="m100link setpoints")
        self._news.set()

    def neutralise(self) -> None:
        """Replace the setpoint by its neutral, which then falls silent by itself."""
        if self._setpoint is not None:
            now = self._loop.time()
            self._setpoint = self._setpoint.neutral()
            self._expires_at = now
            self._silent_at = now + NEUTRAL_TIME
            self._is_renewed = False
            self._send_if_due(now)

    def silence(self) -> None:
        """Send nothing more until the next setpoint."""
        self._setpoint = None

    async def stop(self) -> None:
        """End the task."""
        self._setpoint = None
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait([self._task])
            self._task = None

    def _transmit(self, setpoint: Setpoint, now: float) -> None:
        # The grid is kept through small lateness and taken up anew after a gap: no drift, no burst.
        is_on_grid = abs(now - self._next_at) < self._period / 2
        self._next_at = (self._next_at if is_on_grid else now) + self._period
        self.sent += 1
        self._send(setpoint)

    async def _run(self) -> None:
        with Alarm() as alarm:
            while True:
                if self._setpoint is None:
                    self._news.clear()
                    await self._news.wait()
                    continue
                due = self._next_at + (_SLACK * self._period if self._is_renewed else 0.0)
                if self._loop.time() < due:
                    await alarm.sleep_until(due)
                    continue  # the program may have sent one itself meanwhile
                self._is_renewed = False
                self._repeat(self._loop.time())
                # A send that blocks for longer than a period must not starve the other tasks.
                await asyncio.sleep(0)

    def _repeat(self, now: float) -> None:
        setpoint = self._setpoint
        assert setpoint is not None
        if now < self._expires_at:
            self._transmit(setpoint, now)
        elif now < self._silent_at:
            neutral = setpoint.neutral()
            if setpoint != neutral:
                self.expired += 1
                self._setpoint = neutral
                _logger.warning("a setpoint was not renewed in time: sending neutral")
            self._transmit(neutral, now)
        else:
            self._setpoint = None
