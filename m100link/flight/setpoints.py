"""The one task that sends setpoints, and whether it keeps their rate."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable

from m100link.errors import UsageError
from m100link.flight.cancellation import new_task
from m100link.flight.pacing import INSTANT, MAX_RATE_HZ, DeadlineTimer
from m100link.protocol.setpoint import Setpoint

_logger = logging.getLogger(__name__)

SETPOINT_LIFETIME = 0.2
"""Seconds that a setpoint is repeated when the program does not renew it."""

NEUTRAL_TIME = 0.3
"""Seconds of neutral after a setpoint expired; then silence, on which the aircraft hovers."""

LONG_LIFETIME = 1.0  # seconds above which a lifetime needs an argument that says so

_PERIOD = 1.0 / MAX_RATE_HZ  # shortest time between two frames, on average

# By how much a program that ticks itself may be early or late on our grid, s: without it every
# frame would carry the value of the tick before.
_SLACK = 0.1 * _PERIOD

KEPT = 0.9  # share of the frames of a second that have to go out: below it the rate is not kept
_WINDOW_S = 1.0  # in which that share is measured
_QUIET_S = 60.0  # between two reports that it is not: a log is read in flight


def check_lifetime(lifetime: float, *, is_long_allowed: bool) -> None:
    """Raise ``UsageError`` for one that does not end, or is long and nobody said so."""
    if not 0 < lifetime < math.inf:
        raise UsageError(f"a lifetime of {lifetime} s is not a time that ends")
    if lifetime > LONG_LIFETIME and not is_long_allowed:
        raise UsageError(
            f"a lifetime of {lifetime:g} s is long: a program that hangs flies on for that long",
            remedy=f"renew it within {LONG_LIFETIME:g} s, or say allow_long_lifetime=True",
        )


class Hold:
    """A setpoint that is being sent; :meth:`set` renews or replaces it."""

    def __init__(self, send: Callable[[Setpoint], None]) -> None:
        self._send = send

    def set(self, setpoint: Setpoint) -> None:
        """Send this setpoint from now on, for another lifetime.

        Raises:
            NoAuthority, GuardRefused, BadSetpoint: See :meth:`Control.send`.
        """
        self._send(setpoint)


class Pace:
    """Measures whether setpoints go out at the requested rate.

    A computer that does not keep up flies by fewer setpoints, and nothing else would show it.

    Args:
        on_missed: Called with how many frames were missed, after the frame behind them.
        on_slow: Called when the rate is not kept, after that frame; once a minute at most.

    Attributes:
        missed: Frames that did not go out in their time, in all.
        rate_hz: Frames a second, of the newest second in which something was sent; None before it.
        is_kept: Whether at least 0.9 of those that were asked for went out in that second.
    """

    def __init__(self, on_missed: Callable[[int], None], on_slow: Callable[[], None]) -> None:
        self._on_missed, self._on_slow = on_missed, on_slow
        self.missed = 0
        self.rate_hz: float | None = None
        self.is_kept = True
        self._last: float | None = None  # time of the frame before, None after silence
        self._period = 0.0  # at which the next frame was to follow it
        self._elapsed = self._asked = 0.0
        self._frames = 0
        self._quiet_until = -math.inf

    def sent(self, now: float, period: float) -> None:
        """A frame went out, and another one is to follow within a period."""
        last, expected = self._last, max(self._period, period)
        self._last, self._period = now, period
        if last is None:
            return
        periods = (now - last) / expected
        missed = round(periods) - 1
        if missed > 0:
            self.missed += missed
            self._on_missed(missed)
        self._elapsed += now - last
        self._asked += periods
        self._frames += 1
        if self._elapsed >= _WINDOW_S:
            self._judge(now)

    def _judge(self, now: float) -> None:
        self.is_kept = self._frames >= KEPT * self._asked
        self.rate_hz = self._frames / self._elapsed
        self._elapsed = self._asked = 0.0
        self._frames = 0
        if not self.is_kept and now >= self._quiet_until:
            self._quiet_until = now + _QUIET_S
            self._on_slow()

    def silence(self) -> None:
        """Nothing follows until the next frame."""
        self._last = None


class SetpointLoop:
    """Sends the present setpoint at a steady rate until it expires.

    Time is cut into periods of 20 ms, and no period gets two frames, however often the program
    sends: faster than 50 Hz the autopilot is said to ignore commands at random. A setpoint that
    differs from the last frame goes out at once, or when the present period ends. It is repeated at
    the rate asked for until it is renewed, replaced, or expires; then the mode's neutral goes out
    at 50 Hz for a moment, then nothing. Nothing older than its lifetime is ever repeated.

    A program that ticks at the same rate jitters around our grid; so what comes a little early goes
    out at once, and while a program renews, repeating waits that little for it.
    """

    def __init__(
        self,
        # Puts a setpoint on the line; False when the line takes no more.
        send: Callable[[Setpoint], bool],
        # Asked before each frame that goes out by itself; the caller of :meth:`set` has checked
        # the one that goes out at once.
        admits: Callable[[Setpoint], bool],
        # Called with the error that ended the task; the next setpoint begins another.
        on_failure: Callable[[Exception], None],
        loop: asyncio.AbstractEventLoop,  # where the task runs
        # Called with how many frames did not go out in their time.
        on_missed: Callable[[int], None] = lambda _: None,
    ) -> None:
        self._send = send
        self.pace = Pace(on_missed, self._on_slow)  # whether the rate is kept
        self._admits = admits
        self._on_failure = on_failure
        self._loop = loop
        self._setpoint: Setpoint | None = None
        self._frame: Setpoint | None = None  # the newest that went out, None before and in silence
        self._slot = float("-inf")  # where the last frame stands on the grid
        self._period = _PERIOD  # between repetitions of the same setpoint
        self._expires_at = 0.0
        self._silent_at = 0.0
        self._is_renewed = False  # by the program, since the last frame
        # A neutral that was asked for and did not go out yet; a process that stands still for as
        # long as it would be sent must not end without one.
        self._owed: Setpoint | None = None
        self._news = asyncio.Event()
        self._task: asyncio.Task[None] | None = None
        self.sent = 0  # frames sent, neutrals included
        self.expired = 0  # setpoints that were not renewed in time
        self._logged = 0  # of those, in the log

    @property
    def current(self) -> Setpoint | None:
        """The setpoint that is being sent, None in silence."""
        return self._setpoint

    def set(self, setpoint: Setpoint, *, lifetime: float, period: float = _PERIOD) -> None:
        """Send this from now on, for its lifetime."""
        now = self._loop.time()
        self._setpoint = setpoint
        self._period = period
        self._expires_at = now + lifetime
        self._silent_at = self._expires_at + NEUTRAL_TIME
        self._is_renewed = True
        self._send_if_due(now, is_checked=True)

    def _send_if_due(self, now: float, *, is_checked: bool) -> None:
        """Send now unless its time is still to come; then the task does it."""
        assert self._setpoint is not None
        # First the task that ends it; and by the event loop: on the last frames of a stack the task
        # would not be woken, and not even by its cancellation from then on.
        if self._task is None or self._task.done():  # done: somebody cancelled every task
            self._task = new_task(self._run(), "m100link setpoints")
        if not self._news.is_set():
            self._loop.call_soon(self._news.set)
        if now >= self._due_at(0.0) - _SLACK and (is_checked or self._admits(self._setpoint)):
            self._transmit(self._setpoint, now)

    def _due_at(self, patience: float) -> float:
        """When the present setpoint goes out next; a repetition waits so many seconds longer."""
        if self._setpoint is not self._frame and self._setpoint != self._frame:
            return self._slot + _PERIOD
        return self._slot + self._period + patience

    def neutralise(self) -> None:
        """Replace the setpoint by its neutral, which then falls silent by itself."""
        if self._setpoint is not None:
            # Before anything that may raise: whatever sends later sends this.
            self._owed = self._setpoint = self._setpoint.neutral()
            now = self._loop.time()
            self._period = _PERIOD
            self._expires_at = now
            self._silent_at = now + NEUTRAL_TIME
            self._is_renewed = False
            self._send_if_due(now, is_checked=False)

    def silence(self) -> None:
        """Send nothing more until the next setpoint."""
        self._setpoint = self._frame = self._owed = None
        self.pace.silence()

    def pay(self) -> None:
        """Send the neutral that was asked for, if it never went out."""
        if self._owed is not None and self._admits(self._owed):
            self._transmit(self._owed, self._loop.time())

    async def hover(self) -> None:
        """Neutral for a moment, then silence."""
        if self._setpoint is not None:
            self.neutralise()
            over_at = self._silent_at  # the sleep may end a rounding error before it
            await asyncio.sleep(NEUTRAL_TIME)
            # Unless somebody has sent something new.
            self._expire(max(over_at, self._loop.time()))

    async def stop(self) -> None:
        """End the task."""
        self.silence()
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait([self._task])
            self._task = None

    def _take_turn(self, setpoint: Setpoint, now: float) -> None:
        """Send the frame that is due; a refused one is not tried again, unless it was replaced."""
        if self._admits(setpoint):
            self._transmit(setpoint, now)
        elif self._setpoint is setpoint:
            self.silence()

    def _transmit(self, setpoint: Setpoint, now: float) -> None:
        # The grid is kept through small lateness and taken up anew after a gap: no drift, no burst.
        for slot in (self._slot + self._period, self._slot + _PERIOD):
            if abs(now - slot) < _PERIOD / 2:
                self._slot = slot
                break
        else:
            self._slot = now
        before = self._frame, self._owed
        self._frame = setpoint
        if setpoint == self._owed:
            self._owed = None
        is_sent = False  # when the line takes no more, or sending raises: it is still to be sent
        try:
            is_sent = self._send(setpoint)
        finally:
            if not is_sent:
                self._frame, self._owed = before
        if is_sent:
            self.sent += 1
            self.pace.sent(now, self._period)

    def _on_slow(self) -> None:
        # The frame is out; reported behind whatever else is due, which must not be late for that.
        if not self._loop.is_closed():
            self._loop.call_soon(self._tell_slow)

    def _tell_slow(self) -> None:
        _logger.warning(
            "setpoints go out at %.0f Hz, less than %.0f %% of what is asked for: this computer is "
            "too busy, or the program blocks its event loop. End other programs, or ask for fewer: "
            "m100link docs on-board",
            self.pace.rate_hz,
            100 * KEPT,
        )

    async def _run(self) -> None:
        """Repeat, and never end in silence: the program that flies by this has to hear of it."""
        try:
            await self._repeat()
        except asyncio.CancelledError:
            if self._setpoint is not None:  # not by stop(), which silences first
                self._fail(RuntimeError("the task that repeats setpoints was cancelled"))
            raise
        except Exception as error:  # noqa: BLE001 (whatever it is, it goes to the block)
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        if self._task is asyncio.current_task():
            self._task = None  # so that the neutral gets a task of its own
        self._on_failure(error)

    async def _repeat(self) -> None:
        with DeadlineTimer() as alarm:
            while True:
                now = self._loop.time()
                self._expire(now)
                if self._setpoint is None:
                    self._news.clear()
                    await self._news.wait()
                    continue
                due_at = self._due_at(_SLACK if self._is_renewed else 0.0)
                if due_at - now > INSTANT:
                    # News must not wait for the end of a long period: look once in a short one.
                    free_at = self._slot + _PERIOD
                    look_at = free_at if free_at - now > INSTANT else now + _PERIOD
                    await alarm.sleep_until(min(due_at, look_at))
                    continue  # the program may have sent one itself meanwhile
                self._is_renewed = False
                self._take_turn(self._setpoint, now)
                if self.expired > self._logged:  # the neutral first: a log can take its time
                    self._logged = self.expired
                    _logger.warning("a setpoint was not renewed in time: sending neutral")
                # A send that blocks for longer than a period must not starve the other tasks.
                await asyncio.sleep(0)

    def _expire(self, now: float) -> None:
        """Go from the setpoint to its neutral, and from there to silence, when it is time."""
        if self._setpoint is None:
            return
        if now < self._expires_at:
            return
        neutral = self._setpoint.neutral()
        if self._setpoint != neutral:
            self.expired += 1
            self._setpoint = neutral
            self._period = _PERIOD
            if now >= self._silent_at:  # the process stood still: the aircraft flies on by it
                self._silent_at = now + NEUTRAL_TIME
        elif now >= self._silent_at:
            self._setpoint = self._frame = None  # what is owed stays so
            self.pace.silence()
