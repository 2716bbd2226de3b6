"""Flying: authority while a block runs, setpoints that expire, one way to stop."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterable, AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager, nullcontext
from functools import partial
from types import TracebackType
from typing import Literal, Self

from m100link.errors import (
    GuardRefused,
    LinkClosed,
    LinkError,
    LinkLost,
    LossReason,
    M100Error,
    NoAuthority,
    TaskRefused,
    UsageError,
)
from m100link.flight.authority import AuthorityState
from m100link.flight.cancellation import Errand, ProgramTask
from m100link.flight.guards import GuardKeeper, Guards
from m100link.flight.guidance import GuidedFlight
from m100link.flight.handover import authority_lost, obtain_authority
from m100link.flight.lifecycle import BlockClaim, BlockInput, BlockState, Lifecycle, StopCause
from m100link.flight.pacing import MAX_RATE_HZ, Tick, Ticker, period_of
from m100link.flight.setpoints import SETPOINT_LIFETIME, Hold, SetpointLoop, check_lifetime
from m100link.flight.signals import SIGNALS
from m100link.flight.stop_path import StopAction, StopPath
from m100link.flight.tasks import Commander, TaskListener, run_task, task_name
from m100link.flight.watchdog import TelemetryWatchdog
from m100link.protocol.commands.control import Move, Task
from m100link.protocol.setpoint import Setpoint
from m100link.telemetry.state import AircraftState

__all__ = ["Control", "Hold", "PauseAction"]

_logger = logging.getLogger("m100link.flight")

PauseAction = Literal["raise", "wait"]
"""What happens when the pilot takes the aircraft: end the block, or wait for the pilot."""

SetpointSource = Callable[[Tick], Setpoint | None] | AsyncIterable[Setpoint]
"""Feeds :meth:`Control.follow`: called at each tick until it returns None, or iterated."""


class Control:
    """Control of the aircraft while an ``async with aircraft.control()`` block runs.

    Entering obtains authority. Leaving, in whatever way and by whatever task, takes one path: the
    mode's neutral, hover or land as chosen, release; shielded from cancellation and bounded in
    time. When authority, the link or telemetry is lost, that path begins at once, the block is
    cancelled and the plain reason raised.

    ``fly_to``, ``climb_to``, ``turn_to`` and ``orbit`` are those of
    :class:`~m100link.flight.guidance.GuidedFlight`.
    """

    def __init__(
        self,
        commander: Commander,
        claim: BlockClaim,
        *,
        stop: StopAction = "hover",
        on_pause: PauseAction = "raise",
        guards: Guards | None = None,
        handle_signals: bool = True,
    ) -> None:
        if stop not in ("hover", "land"):
            raise UsageError(f"there is no stop action {stop!r}", remedy="use 'hover' or 'land'")
        if on_pause not in ("raise", "wait"):
            raise UsageError(f"on_pause cannot be {on_pause!r}", remedy="use 'raise' or 'wait'")
        self._commander = commander
        self._requests = commander.requests
        self._authority = commander.authority
        self._claim = claim
        self._on_pause: PauseAction = on_pause
        self._guards = GuardKeeper(guards or Guards(), commander.state)
        self._handles_signals = handle_signals
        self._life = Lifecycle()
        self._program = ProgramTask()
        self._running_task: Task | None = None  # flown by the autopilot: it ignores setpoints
        self._prepared: tuple[Setpoint, Move] | None = None  # the newest setpoint, for the wire
        self._refused: GuardRefused | None = None  # why the newest setpoint was ended
        self._setpoints = SetpointLoop(self._transmit, self._admits)
        self._stop_path = StopPath(commander, self._life, self._setpoints, stop)
        self._on_signal = partial(self._stop, StopCause.SIGNALLED)
        self._stopping = Errand(self._stop_path.run, self._on_stopped)
        self._watchdog = TelemetryWatchdog(
            commander.state,
            self._guards.guards.stale_telemetry_s,
            on_stall=partial(self._stop, StopCause.TELEMETRY_STALLED),
        )
        guided = GuidedFlight(self, self._guards)
        self.fly_to, self.climb_to = guided.fly_to, guided.climb_to
        self.turn_to, self.orbit = guided.turn_to, guided.orbit

    # -- the block -------------------------------------------------------------------------------

    async def __aenter__(self) -> Self:
        if self._life.state is not BlockState.NEW:
            raise UsageError("this control block was entered before; ask for a new one")
        self._requests.fix_firmware()
        self._claim.take(self._close)
        self._life.feed(BlockInput.ENTER)
        self._program.enter()
        self._unsubscribe = self._authority.subscribe(self._on_authority_changed)
        if self._handles_signals:
            SIGNALS.join(self._on_signal)
        try:
            await obtain_authority(self._commander)
            self._life.feed(BlockInput.OBTAINED)
            self._guards.start()
            self._watchdog.start()
        except BaseException as error:
            self._stop(StopCause.NOT_ENTERED)
            await self._leave(error)
            raise
        if not self._life.is_open:  # lost, closed or signalled between the request and here
            await self._leave(None)
            raise asyncio.CancelledError
        return self

    async def __aexit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> bool:
        self._stop(StopCause.LEFT)
        return await self._leave(exc)

    async def _leave(self, error: BaseException | None) -> bool:
        """Wait for the end of the stop path. Returns whether ``error`` was its cancellation alone.

        Raises:
            M100Error: What ended the block, unless an error of the program is under way.
        """
        self._program.leave()
        try:
            await self._stopping.ended()
        finally:
            is_ours = self._program.take_back(error)
        failure = self._life.failure
        if failure is not None and (error is None or is_ours):
            raise failure.again() from failure.__cause__
        # After a signal the program does not go on behind the block as if it had flown.
        return is_ours and self._life.cause is not StopCause.SIGNALLED

    def _stop(self, cause: StopCause, failure: M100Error | None = None) -> None:
        """Something ends the block: the stop path begins at once, in a task of its own.

        It does not wait for the program, which may clean up slowly, swallow its cancellation, or be
        gone. After the first cause only a lost line changes anything.
        """
        is_first = self._life.state is not BlockState.STOPPING
        if not self._life.feed(cause, failure):
            return
        self._stop_path.let_go()
        if is_first:
            self._stopping.begin()
            if cause not in (StopCause.LEFT, StopCause.NOT_ENTERED):
                self._program.cancel()

    async def _close(self) -> None:
        """The connection is about to be closed."""
        error = LinkClosed("the aircraft was disconnected while this block was flying it")
        self._stop(StopCause.CLOSED, error)
        await self._stopping.ended()

    def _on_authority_changed(self, before: AuthorityState, after: AuthorityState) -> None:
        reason = self._authority.reason
        if reason is LossReason.LINK:
            lost = self._commander.link.failure or LinkLost("the line is gone")
            self._stop(StopCause.LINK_LOST, lost.again())
        elif after is AuthorityState.PAUSED and self._on_pause == "wait":
            if self._life.feed(BlockInput.PAUSE):
                self._setpoints.silence()
        elif after in (AuthorityState.PAUSED, AuthorityState.LOST):
            self._stop(StopCause.AUTHORITY_LOST, authority_lost(reason))

    def _on_stopped(self) -> None:
        self._life.feed(BlockInput.STOPPED)
        self._unsubscribe()
        self._watchdog.stop()
        self._requests.free_firmware()
        self._claim.give_back()
        SIGNALS.leave(self._on_signal)  # last: a signal that came may end the process here

    # -- setpoints -------------------------------------------------------------------------------

    @property
    def has_authority(self) -> bool:
        """Whether setpoints are obeyed."""
        return self._authority.state is AuthorityState.HELD

    @property
    def is_paused(self) -> bool:
        """With ``on_pause="wait"``: the pilot took the aircraft and :meth:`resume` is needed."""
        return self._life.state is BlockState.PAUSED

    @property
    def state(self) -> AircraftState:
        """Telemetry of the aircraft."""
        return self._commander.state

    @property
    def setpoints_sent(self) -> int:
        """Movement frames sent in this block, neutrals included."""
        return self._setpoints.sent

    @property
    def setpoints_expired(self) -> int:
        """Setpoints that the program did not renew in time."""
        return self._setpoints.expired

    def send(
        self,
        setpoint: Setpoint,
        *,
        lifetime: float = SETPOINT_LIFETIME,
        rate_hz: float = MAX_RATE_HZ,
        allow_long_lifetime: bool = False,
    ) -> None:
        """Send a setpoint now, and repeat it until it is renewed or expires.

        Args:
            setpoint: What to fly.
            lifetime: Seconds after which it is not repeated any more; then the mode's neutral is
                sent for 0.3 s, then nothing. At most 1 s, unless ``allow_long_lifetime``.
            rate_hz: Repetitions per second, at most 50; another setpoint and the neutral do not
                wait for it.
            allow_long_lifetime: Allow more than 1 s: a program that hangs flies on for that long.

        The guards are asked before each frame. One that refuses later replaces the setpoint by its
        neutral; the next call raises the refusal.

        Raises:
            NoAuthority: Authority is not held, is paused, or a task is flying the aircraft.
            GuardRefused: A guard said no; nothing was sent.
            UsageError: The lifetime does not end, or is longer than allowed.
            BadSetpoint: The firmware cannot express it.
        """
        self._require_flying("a setpoint")
        if self._running_task is not None:
            raise NoAuthority(
                f"a setpoint was sent during {task_name(self._running_task)}; nothing was sent",
                cause="the aircraft ignores movement during take-off, landing and go-home",
                remedy="await the task first",
            )
        check_lifetime(lifetime, is_long_allowed=allow_long_lifetime)
        # Refused here, not in the sending task.
        self._prepared = setpoint, setpoint.to_move(self._requests.firmware)
        self._guards.check(setpoint)
        self._refused = None
        self._setpoints.set(setpoint, lifetime=lifetime, period=period_of(rate_hz))

    def send_raw_move_as_expert(self, move: Move) -> bool:
        """Send one raw movement command, unchecked and unrepeated. For experts.

        No range, no guard and no lifetime protects anybody here; only authority is required.

        Returns:
            False when the line does not drain.

        Raises:
            NoAuthority: Authority is not held.
        """
        self._require_flying("a raw movement command")
        return self._requests.push(move)

    def _transmit(self, setpoint: Setpoint) -> bool:
        if self._prepared is None or self._prepared[0] is not setpoint:  # it is the neutral
            self._prepared = setpoint, setpoint.to_move(self._requests.firmware)
        try:
            return self._requests.push(self._prepared[1])
        except LinkError as error:
            self._stop(StopCause.LINK_LOST, error.again())
            return False

    def _admits(self, setpoint: Setpoint) -> bool:
        """The gate in front of the wire, for each frame that :meth:`send` did not check itself."""
        if self._authority.state is not AuthorityState.HELD:
            return False
        if self._life.state is BlockState.FLYING:
            return self._watchdog.is_quiet() and self._guards_admit(setpoint)
        return self._life.state is BlockState.STOPPING  # the neutral

    def _guards_admit(self, setpoint: Setpoint) -> bool:
        """Ask again: a setpoint may live longer than what it was checked against."""
        try:
            self._guards.check(setpoint)
        except GuardRefused as error:
            if setpoint != setpoint.neutral():  # standing still is never refused
                _logger.warning("sending neutral: %s", error.seen)
                self._refused = error
                self._setpoints.neutralise()
                return False
        return True

    def ticks(self, rate_hz: float = MAX_RATE_HZ) -> Ticker:
        """Ticks for a control loop in the caller's own task.

        Raises:
            UsageError: Not within 0 to 50 Hz.
        """
        return Ticker(rate_hz)

    @asynccontextmanager
    async def hold(
        self,
        setpoint: Setpoint,
        *,
        rate_hz: float = MAX_RATE_HZ,
        lifetime: float = SETPOINT_LIFETIME,
        allow_long_lifetime: bool = False,
    ) -> AsyncIterator[Hold]:
        """A task keeps sending a setpoint while the block runs and renews it by :meth:`Hold.set`.

        On the way out the mode's neutral is sent.

        Args:
            setpoint: The first setpoint.
            rate_hz: Repetitions per second, at most 50.
            lifetime: Seconds that each setpoint lasts when it is not renewed.
            allow_long_lifetime: Allow more than 1 s.

        Raises:
            NoAuthority, GuardRefused, BadSetpoint, UsageError: See :meth:`send`.
            GuardRefused: On the way out, when a guard ended the setpoint that was held last.
        """
        send = partial(self.send, lifetime=lifetime, rate_hz=rate_hz)
        hold = Hold(partial(send, allow_long_lifetime=allow_long_lifetime))
        hold.set(setpoint)
        with self._ends_neutral():
            yield hold

    @contextmanager
    def _ends_neutral(self) -> Iterator[None]:
        """Neutral on the way out, and the refusal if a guard ended what was sent last."""
        self._refused = None
        try:
            yield
        finally:
            self._setpoints.neutralise()
        if self._refused is not None:
            raise self._refused.again()

    async def follow(
        self,
        source: SetpointSource,
        *,
        rate_hz: float = MAX_RATE_HZ,
        lifetime: float | None = None,
        allow_long_lifetime: bool = False,
    ) -> None:
        """Send what a source gives until it ends, then the mode's neutral.

        Args:
            source: A callable that gets each :class:`Tick` and returns a setpoint, or None to end;
                or an async iterable of setpoints, which sets its own pace.
            rate_hz: Ticks per second for a callable.
            lifetime: Seconds that each setpoint lasts when the next one does not come; by default
                0.2 s, or two ticks where these are longer.
            allow_long_lifetime: Allow more than 1 s, as a rate below 2 Hz needs it.

        Raises:
            NoAuthority, GuardRefused, BadSetpoint, UsageError: See :meth:`send`.
        """
        if lifetime is None:
            lifetime = max(SETPOINT_LIFETIME, 2 * period_of(rate_hz))
        send = partial(self.send, lifetime=lifetime, allow_long_lifetime=allow_long_lifetime)
        with self._ends_neutral():
            if isinstance(source, AsyncIterable):
                async for setpoint in source:
                    send(setpoint)
                return
            async for tick in self.ticks(rate_hz):
                if (wanted := source(tick)) is None:
                    return
                send(wanted)

    async def stop(self) -> None:
        """Send the neutral of the present mode for a moment, then nothing: the aircraft hovers."""
        await self._setpoints.halt()

    async def wait_resumable(self) -> None:
        """With ``on_pause="wait"``: wait until the pilot has given the aircraft back."""
        await self._authority.wait_for(AuthorityState.HELD)

    def resume(self) -> None:
        """With ``on_pause="wait"``: setpoints may be sent again.

        The pilot's return to F gives authority back without a request, but nothing flies before
        the program says so here.

        Raises:
            NoAuthority: The pilot has not given the aircraft back.
        """
        if not self.has_authority:
            raise NoAuthority(
                "the pilot has not given the aircraft back",
                remedy="await control.wait_resumable() first",
            )
        self._life.feed(BlockInput.RESUME)

    def _require_flying(self, what: str) -> None:
        """Raise unless the block may send: what ended it, or how to come to where it may.

        Telemetry comes first: guards would complain of values that are only old.
        """
        life = self._life
        is_flying = life.state is BlockState.FLYING and self._watchdog.is_quiet()
        if is_flying and self._authority.state is AuthorityState.HELD:
            return
        if life.failure is not None:
            raise life.failure.again()
        state, remedy = self._authority.state.value, "use it inside `async with aircraft.control()`"
        if life.state in (BlockState.STOPPING, BlockState.OVER):
            state = "over with this block"
        elif life.state is BlockState.PAUSED:
            state, remedy = "paused by the pilot", "wait_resumable() and resume()"
        raise NoAuthority(
            f"{what} was asked for while authority is {state}; nothing was sent", remedy=remedy
        )

    # -- tasks -----------------------------------------------------------------------------------

    async def take_off(
        self, *, timeout: float | None = None, progress: TaskListener | None = None
    ) -> None:
        """Start the motors and climb to about 1.2 m.

        Done when the aircraft reports success, or telemetry shows it in the air at 1 m or more;
        the ack alone proves nothing.

        Args:
            timeout: Seconds to wait after the aircraft accepted; 20 by default.
            progress: Called about four times a second.

        Raises:
            NoAuthority: Authority is not held.
            GuardRefused: Battery below its floor; battery or position did not come within 1.5 s.
            TaskRefused, TaskFailed: With the situation that explains it.
            NotObserved: Neither success nor failure showed in time.
            AckTimeout: Nobody knows whether it began.
        """
        self._require_flying(task_name(Task.TAKE_OFF))
        await self._guards.admit_take_off()
        await self._run(Task.TAKE_OFF, timeout, progress)

    async def land(
        self, *, timeout: float | None = None, progress: TaskListener | None = None
    ) -> None:
        """Land in place and stop the motors; 60 s. See :meth:`take_off` for the errors."""
        await self._run(Task.LAND, timeout, progress)

    async def go_home(
        self, *, timeout: float | None = None, progress: TaskListener | None = None
    ) -> None:
        """Fly to the home point and land; 300 s. See :meth:`take_off` for the errors."""
        await self._run(Task.GO_HOME, timeout, progress)

    async def _run(self, task: Task, timeout: float | None, progress: TaskListener | None) -> None:
        self._require_flying(task_name(task))
        if self._running_task is not None:
            raise TaskRefused(
                f"{task_name(task)} was asked for during {task_name(self._running_task)}",
                remedy="await one task before the next",
            )
        self._running_task = task
        self._setpoints.silence()
        watch = self._stop_path.taking_off() if task is Task.TAKE_OFF else nullcontext()
        try:
            with watch:
                await run_task(self._commander, task, timeout=timeout, progress=progress)
        finally:
            self._running_task = None
