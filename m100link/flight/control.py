"""Flying: authority while a block runs, setpoints that expire, one way to stop."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import AsyncIterable, AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from types import TracebackType
from typing import Literal, Self

import anyio

from m100link.errors import (
    AuthorityLost,
    LinkError,
    LossReason,
    M100Error,
    NoAuthority,
    TaskRefused,
    TelemetryStalled,
    UsageError,
)
from m100link.flight.authority import AuthorityState
from m100link.flight.guards import GuardKeeper, Guards
from m100link.flight.guidance import GuidedFlight
from m100link.flight.handover import (
    authority_lost,
    explained_loss,
    obtain_authority,
    release_authority,
)
from m100link.flight.pacing import MAX_RATE_HZ, Tick, Ticker, period_of
from m100link.flight.setpoints import NEUTRAL_TIME, SETPOINT_LIFETIME, SetpointLoop
from m100link.flight.signals import SignalWatch, finish
from m100link.flight.tasks import Commander, TaskProgress, run_task, task_name
from m100link.protocol.commands.control import Move, Task
from m100link.protocol.records import FlightPhase
from m100link.protocol.setpoint import Setpoint
from m100link.telemetry.state import AircraftState

__all__ = ["Control", "Hold", "PauseAction", "StopAction"]

_logger = logging.getLogger("m100link.flight")

StopAction = Literal["hover", "land"]
"""What the stop path does after the neutral setpoint."""

PauseAction = Literal["raise", "wait"]
"""What happens when the pilot takes the aircraft: end the block, or wait for the pilot."""

_STOP_LANDING_DEADLINE = 60.0
_LANDING_RETRY = 0.5

SetpointSource = Callable[[Tick], Setpoint | None] | AsyncIterable[Setpoint]
"""Feeds :meth:`Control.follow`: called at each tick until it returns None, or iterated."""


class Hold:
    """A setpoint that is being sent; :meth:`set` renews or replaces it."""

    def __init__(self, control: Control, lifetime: float, rate_hz: float) -> None:
        self._control = control
        self._lifetime = lifetime
        self._rate_hz = rate_hz

    def set(self, setpoint: Setpoint) -> None:
        """Send this setpoint from now on, for another lifetime.

        Raises:
            NoAuthority, GuardRefused, BadSetpoint: See :meth:`Control.send`.
        """
        self._control.send(setpoint, lifetime=self._lifetime, rate_hz=self._rate_hz)


class Control:
    """Control of the aircraft while an ``async with aircraft.control()`` block runs.

    Entering obtains authority. Leaving, in whatever way, takes one path: the mode's neutral, hover
    or land as chosen, release; shielded from cancellation and bounded in time. When authority, the
    link or telemetry is lost, the block is cancelled and the plain reason raised.

    ``fly_to``, ``climb_to``, ``turn_to`` and ``orbit`` are those of
    :class:`~m100link.flight.guidance.GuidedFlight`.
    """

    def __init__(
        self,
        commander: Commander,
        *,
        stop: StopAction = "hover",
        on_pause: PauseAction = "raise",
        guards: Guards | None = None,
        handle_signals: bool = True,
        claim: Callable[[Control], None] | None = None,
    ) -> None:
        if stop not in ("hover", "land"):
            raise UsageError(f"there is no stop action {stop!r}", remedy="use 'hover' or 'land'")
        if on_pause not in ("raise", "wait"):
            raise UsageError(f"on_pause cannot be {on_pause!r}", remedy="use 'raise' or 'wait'")
        self._commander = commander
        self._requests = commander.requests
        self._stop_action: StopAction = stop
        self._on_pause: PauseAction = on_pause
        self._guards = GuardKeeper(guards or Guards(), commander.state)
        self._claim = claim
        self._scope = anyio.CancelScope()
        self._signals = SignalWatch(self._scope.cancel) if handle_signals else None
        self._failure: M100Error | None = None
        self._is_entered = self._is_over = False
        self._is_paused = False
        self._is_stopping = False
        self._running_task: Task | None = None
        self._setpoints = SetpointLoop(self._transmit)
        self._watchdog: asyncio.TimerHandle | None = None
        guided = GuidedFlight(self)
        self.fly_to, self.climb_to = guided.fly_to, guided.climb_to
        self.turn_to, self.orbit = guided.turn_to, guided.orbit

    # -- the block -------------------------------------------------------------------------------

    async def __aenter__(self) -> Self:
        if self._is_entered:
            raise UsageError("this control block was entered before; ask for a new one")
        if self._claim is not None:
            self._claim(self)
        self._is_entered = True
        if self._signals is not None:
            self._signals.begin()
        try:
            await obtain_authority(self._commander)
        except BaseException:
            # The ack may be lost and authority ours all the same.
            await self._end(lambda: release_authority(self._commander))
            raise
        self._guards.start()
        self._watch_telemetry()
        self._scope.__enter__()
        return self

    async def __aexit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> bool:
        swallowed = bool(self._scope.__exit__(exc_type, exc, traceback))
        await self._end(self._stop_path)
        if self._failure is not None and (exc is None or swallowed):
            raise self._failure
        return swallowed

    async def _end(self, how: Callable[[], Awaitable[None]]) -> None:
        try:
            await finish(how)
        finally:
            self._is_over = True
            if self._watchdog is not None:
                self._watchdog.cancel()
            if self._signals is not None:
                self._signals.end()

    @property
    def is_active(self) -> bool:
        """Whether the block was entered and its stop path has not ended."""
        return self._is_entered and not self._is_over

    def fail(self, error: M100Error) -> None:
        """Authority, link or telemetry are gone: end the block with this error."""
        if self._failure is None and not self._is_over:
            self._failure = error
            if isinstance(error, TelemetryStalled):
                self._setpoints.neutralise()  # the aircraft may hear us although we do not hear it
            else:
                self._setpoints.silence()
            self._scope.cancel()

    def authority_changed(
        self, before: AuthorityState, after: AuthorityState, reason: LossReason
    ) -> None:
        """Called by the aircraft after each change of authority."""
        if self._is_over or self._is_stopping:
            return
        if after is AuthorityState.PAUSED and self._on_pause == "wait":
            self._is_paused = True
            self._setpoints.silence()
        elif after is AuthorityState.PAUSED or (
            after is AuthorityState.LOST and before in (AuthorityState.HELD, AuthorityState.PAUSED)
        ):
            self.fail(authority_lost(reason))

    async def _stop_path(self) -> None:
        """Neutral, hover or land, release. Every wait in it is bounded."""
        if isinstance(self._failure, LinkError):
            await self._setpoints.stop()
            return
        self._is_stopping = True
        if isinstance(self._failure, AuthorityLost):
            self._failure = await explained_loss(self._commander, self._failure)
        if self.has_authority and self._setpoints.current is not None:
            self._setpoints.neutralise()
            await asyncio.sleep(NEUTRAL_TIME)
        await self._setpoints.stop()
        if self._stop_action == "land":
            await self._land_at_last()
        await release_authority(self._commander)

    async def _land_at_last(self) -> None:
        """Land, although another task may be under way: the aircraft rejects it until that ended.

        A landing that was under way already ends here too. Releasing authority in the middle of
        either would leave the aircraft in the air.
        """
        clock = asyncio.get_running_loop().time
        deadline = clock() + _STOP_LANDING_DEADLINE
        while self.has_authority and self._is_airborne():
            try:
                await run_task(self._commander, Task.LAND, timeout=max(1.0, deadline - clock()))
            except TaskRefused as error:
                if clock() < deadline:
                    await asyncio.sleep(_LANDING_RETRY)
                    continue
                _logger.error("the stop path could not land: %s", error)
            except M100Error as error:
                _logger.error("the stop path could not land: %s", error)
            return

    def _is_airborne(self) -> bool:
        status = self._commander.state.flight_status
        return status is not None and status.status != FlightPhase.STANDBY

    # -- setpoints -------------------------------------------------------------------------------

    @property
    def has_authority(self) -> bool:
        """Whether setpoints are obeyed."""
        return self._commander.authority.state is AuthorityState.HELD

    @property
    def is_paused(self) -> bool:
        """With ``on_pause="wait"``: the pilot took the aircraft and :meth:`resume` is needed."""
        return self._is_paused

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
    ) -> None:
        """Send a setpoint now, and repeat it until it is renewed or expires.

        Args:
            setpoint: What to fly.
            lifetime: Seconds after which it is not repeated any more; then the mode's neutral is
                sent for 0.3 s, then nothing.
            rate_hz: Repetitions per second, at most 50; another setpoint and the neutral do not
                wait for it.

        Raises:
            NoAuthority: Authority is not held, is paused, or a task is flying the aircraft.
            GuardRefused: A guard said no; nothing was sent.
            BadSetpoint: The firmware cannot express it.
        """
        self._check_telemetry()  # first: guards would complain of values that are only old
        self._require_authority("a setpoint")
        if self._running_task is not None:
            raise NoAuthority(
                f"a setpoint was sent during {task_name(self._running_task)}; nothing was sent",
                cause="the aircraft ignores movement during take-off, landing and go-home",
                remedy="await the task first",
            )
        if not 0 < lifetime < math.inf:
            raise UsageError(f"a lifetime of {lifetime} s is no time that ends")
        setpoint.control_flag(self._requests.firmware)  # refused here, not in the sending task
        self._guards.check(setpoint)
        self._setpoints.set(setpoint, lifetime=lifetime, period=period_of(rate_hz))

    def send_raw_move_as_expert(self, move: Move) -> bool:
        """Send one raw movement command, unchecked and unrepeated. For experts.

        No range, no guard and no lifetime protects anybody here; only authority is required.

        Returns:
            False when the line does not drain.

        Raises:
            NoAuthority: Authority is not held.
        """
        self._require_authority("a raw movement command")
        return self._requests.push(move)

    def _transmit(self, setpoint: Setpoint) -> bool:
        if not self.has_authority or not self._check_telemetry():
            return False
        try:
            return self._requests.push(setpoint.to_move(self._requests.firmware))
        except LinkError as error:
            self.fail(error)
            return False

    def _watch_telemetry(self) -> None:
        """Telemetry can stall while nothing is sent, too."""
        limit = self._guards.guards.stale_telemetry_s
        self._check_telemetry()
        if limit is not None and self._failure is None:
            age = self._commander.state.newest_age or 0.0
            loop = asyncio.get_running_loop()
            self._watchdog = loop.call_later(limit - age + 0.01, self._watch_telemetry)

    def _check_telemetry(self) -> bool:
        """False when telemetry is found stalled here and now; that ends the block."""
        limit = self._guards.guards.stale_telemetry_s
        age = self._commander.state.newest_age
        if limit is None or age is None or age <= limit:
            return True
        if self._is_stopping or self._failure is not None:
            return True
        self.fail(
            TelemetryStalled(
                f"no telemetry for {age:.1f} s while flying",
                cause="the line from the aircraft is broken, or this program was blocked",
                remedy="check the line; a program that blocks must not fly",
            )
        )
        return False

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
    ) -> AsyncIterator[Hold]:
        """A task keeps sending a setpoint while the block runs and renews it by :meth:`Hold.set`.

        On the way out the mode's neutral is sent.

        Args:
            setpoint: The first setpoint.
            rate_hz: Repetitions per second, at most 50.
            lifetime: Seconds that each setpoint lasts when it is not renewed.

        Raises:
            NoAuthority, GuardRefused, BadSetpoint, UsageError: See :meth:`send`.
        """
        hold = Hold(self, lifetime, rate_hz)
        hold.set(setpoint)
        try:
            yield hold
        finally:
            self._setpoints.neutralise()

    async def follow(
        self,
        source: SetpointSource,
        *,
        rate_hz: float = MAX_RATE_HZ,
        lifetime: float | None = None,
    ) -> None:
        """Send what a source gives until it ends, then the mode's neutral.

        Args:
            source: A callable that gets each :class:`Tick` and returns a setpoint, or None to end;
                or an async iterable of setpoints, which sets its own pace.
            rate_hz: Ticks per second for a callable.
            lifetime: Seconds that each setpoint lasts when the next one does not come; by default
                0.2 s, or two ticks where these are longer.

        Raises:
            NoAuthority, GuardRefused, BadSetpoint, UsageError: See :meth:`send`.
        """
        if lifetime is None:
            lifetime = max(SETPOINT_LIFETIME, 2 * period_of(rate_hz))
        try:
            if isinstance(source, AsyncIterable):
                async for setpoint in source:
                    self.send(setpoint, lifetime=lifetime)
                return
            async for tick in self.ticks(rate_hz):
                wanted = source(tick)
                if wanted is None:
                    return
                self.send(wanted, lifetime=lifetime)
        finally:
            self._setpoints.neutralise()

    async def stop(self) -> None:
        """Send the neutral of the present mode for a moment, then nothing: the aircraft hovers."""
        if self._setpoints.current is not None:
            self._setpoints.neutralise()
            await asyncio.sleep(NEUTRAL_TIME)
            self._setpoints.silence()

    async def wait_resumable(self) -> None:
        """With ``on_pause="wait"``: wait until the pilot has given the aircraft back."""
        await self._commander.authority.wait_for(AuthorityState.HELD)

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
        self._is_paused = False

    def _require_authority(self, what: str) -> None:
        if self._failure is not None:
            raise self._failure
        if self._is_over or not self.has_authority or self._is_paused:
            state = (
                "over with this block" if self._is_over else self._commander.authority.state.value
            )
            if self._is_paused:
                state = "paused by the pilot"
            raise NoAuthority(
                f"{what} was asked for while authority is {state}; nothing was sent",
                remedy="wait_resumable() and resume()"
                if self._is_paused
                else "use it inside `async with aircraft.control()`",
            )

    # -- tasks -----------------------------------------------------------------------------------

    async def take_off(
        self,
        *,
        timeout: float | None = None,
        progress: Callable[[TaskProgress], None] | None = None,
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
        self._require_authority(task_name(Task.TAKE_OFF))
        await self._guards.admit_take_off()
        await self._run(Task.TAKE_OFF, timeout, progress)

    async def land(
        self,
        *,
        timeout: float | None = None,
        progress: Callable[[TaskProgress], None] | None = None,
    ) -> None:
        """Land in place and stop the motors; 60 s. See :meth:`take_off` for the errors."""
        await self._run(Task.LAND, timeout, progress)

    async def go_home(
        self,
        *,
        timeout: float | None = None,
        progress: Callable[[TaskProgress], None] | None = None,
    ) -> None:
        """Fly to the home point and land; 300 s. See :meth:`take_off` for the errors."""
        await self._run(Task.GO_HOME, timeout, progress)

    async def _run(
        self, task: Task, timeout: float | None, progress: Callable[[TaskProgress], None] | None
    ) -> None:
        self._require_authority(task_name(task))
        if self._running_task is not None:
            raise TaskRefused(
                f"{task_name(task)} was asked for during {task_name(self._running_task)}",
                remedy="await one task before the next",
            )
        self._running_task = task
        self._setpoints.silence()
        try:
            await run_task(self._commander, task, timeout=timeout, progress=progress)
        finally:
            self._running_task = None
