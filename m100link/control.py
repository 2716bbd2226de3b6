"""Flying: authority while a block runs, setpoints that expire, tasks that end when seen to end."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Literal, Protocol, Self

import anyio

from m100link.authority import Authority, AuthorityInput, AuthorityState
from m100link.errors import (
    AckTimeout,
    AuthorityLost,
    AuthorityRefused,
    CommandRefused,
    LinkError,
    M100Error,
    NoAuthority,
    NotObserved,
    TaskFailed,
    TaskRefused,
    UsageError,
)
from m100link.pacing import MAX_RATE_HZ, Ticker
from m100link.protocol.codes import AuthorityCode, TaskResultCode, TaskStartCode
from m100link.protocol.control import QueryTask, RequestAuthority, StartTask, Task
from m100link.protocol.firmware import FirmwareProfile
from m100link.protocol.setpoint import Setpoint
from m100link.protocol.telemetry import FlightPhase

if TYPE_CHECKING:
    from m100link.protocol.command import Command
    from m100link.subscription import AircraftState

__all__ = ["Control", "Hold", "StopAction", "TaskProgress"]

_logger = logging.getLogger("m100link.authority")

StopAction = Literal["hover", "land"]
"""What the stop path does after the neutral setpoint."""

SETPOINT_LIFETIME = 0.2
"""Seconds that a setpoint is repeated when the program does not renew it."""

NEUTRAL_TIME = 0.3
"""Seconds of neutral after a setpoint expired; then silence, on which the aircraft hovers."""

AUTHORITY_PAUSE = 0.05
"""Seconds between the requests of a firmware that wants two (DJI's C library waits as long)."""

_AUTHORITY_REQUESTS = 10
_RELEASE_DEADLINE = 2.0
_LAND_DEADLINE = 60.0
_TASK_POLL = 0.25
_TASK_QUERY_INTERVAL = 1.0
_TAKE_OFF_HEIGHT = 1.0


@dataclass(frozen=True, slots=True)
class TaskProgress:
    """How far a take-off, landing or go-home is.

    Attributes:
        task: Which one.
        elapsed: Seconds since it was accepted.
        phase: Flight phase by telemetry, None when unknown.
        height_m: Height by telemetry, None when unknown.
        result: Newest answer to the result query, None before the first.
    """

    task: Task
    elapsed: float
    phase: FlightPhase | None
    height_m: float | None
    result: TaskResultCode | None


class Commander(Protocol):
    """What :class:`Control` needs of the aircraft."""

    authority: Authority
    state: AircraftState

    @property
    def firmware(self) -> FirmwareProfile:
        """Firmware profile in use."""
        ...

    async def execute(
        self,
        command: Command,
        *,
        timeout: float,
        tries: int,
        refusal: type[CommandRefused] = CommandRefused,
    ) -> int:
        """Send a command, return its ack code; system codes raise."""
        ...

    def push(self, command: Command) -> bool:
        """Send without ack."""
        ...

    def next_task_sequence(self) -> int:
        """A number for the next task."""
        ...


class _SetpointLoop:
    """The one task that sends setpoints.

    A setpoint goes out at once when the last transmission is a period ago, and is repeated each
    period until it is renewed, replaced, or expires. After expiry: the mode's neutral for a
    moment, then silence. Nothing older than its lifetime is ever repeated.
    """

    def __init__(self, send: Callable[[Setpoint], bool]) -> None:
        self._send = send
        self._loop = asyncio.get_running_loop()
        self._period = 1.0 / MAX_RATE_HZ
        self._setpoint: Setpoint | None = None
        self._expires_at = 0.0
        self._silent_at = 0.0
        self._last_sent_at = float("-inf")
        self._news = asyncio.Event()
        self._task: asyncio.Task[None] | None = None
        self.sent = 0
        self.expired = 0

    def set(self, setpoint: Setpoint, lifetime: float) -> None:
        now = self._loop.time()
        self._setpoint = setpoint
        self._expires_at = now + lifetime
        self._silent_at = self._expires_at + NEUTRAL_TIME
        # A caller that ticks at the full rate jitters around the period; half of it is early.
        if now - self._last_sent_at >= self._period * 0.5:
            self._transmit(setpoint, now)
        if self._task is None:
            self._task = asyncio.create_task(self._run(), name="m100link setpoints")
        self._news.set()

    def _transmit(self, setpoint: Setpoint, now: float) -> None:
        self._last_sent_at = now
        self.sent += 1
        self._send(setpoint)

    async def _run(self) -> None:
        while True:
            if self._setpoint is None:
                self._news.clear()
                await self._news.wait()
            due = self._last_sent_at + self._period
            delay = due - self._loop.time()
            if delay > 0:
                await asyncio.sleep(delay)
                if self._last_sent_at + self._period > self._loop.time() + 1e-9:
                    continue  # the program sent one itself meanwhile
            now = self._loop.time()
            setpoint = self._setpoint
            if setpoint is None:
                continue
            if now < self._expires_at:
                self._transmit(setpoint, now)
            elif now < self._silent_at:
                neutral = setpoint.neutral()
                if setpoint != neutral:
                    self.expired += 1
                    _logger.warning("a setpoint was not renewed in time: sending neutral")
                    self._setpoint = neutral
                self._transmit(neutral, now)
            else:
                self._setpoint = None

    def neutralise(self) -> None:
        """Replace the setpoint by its neutral, which then falls silent by itself."""
        if self._setpoint is not None:
            neutral = self._setpoint.neutral()
            now = self._loop.time()
            self._setpoint = neutral
            self._expires_at = now
            self._silent_at = now + NEUTRAL_TIME
            self._transmit(neutral, now)
            self._news.set()

    def silence(self) -> None:
        """Send nothing more until the next setpoint."""
        self._setpoint = None

    @property
    def current(self) -> Setpoint | None:
        return self._setpoint

    async def stop(self) -> None:
        self._setpoint = None
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait([self._task])
            self._task = None


class Hold:
    """A setpoint that is being sent; :meth:`set` renews or replaces it."""

    def __init__(self, control: Control, lifetime: float) -> None:
        self._control = control
        self._lifetime = lifetime

    def set(self, setpoint: Setpoint) -> None:
        """Send this setpoint from now on, for another lifetime.

        Raises:
            NoAuthority: See :meth:`Control.send`.
        """
        self._control.send(setpoint, lifetime=self._lifetime)


class Control:
    """Control of the aircraft while an ``async with aircraft.control()`` block runs.

    Entering obtains authority, leaving always stops and releases it: neutral setpoint, hover or
    land as chosen, then release, bounded in time and whatever ends the block. When authority or
    the link is lost the block is cancelled and :class:`AuthorityLost` or :class:`LinkLost` raised.
    """

    def __init__(self, commander: Commander, *, stop: StopAction = "hover") -> None:
        if stop not in ("hover", "land"):
            raise UsageError(f"there is no stop action {stop!r}", remedy="use 'hover' or 'land'")
        self._commander = commander
        self._stop_action: StopAction = stop
        self._scope = anyio.CancelScope()
        self._failure: M100Error | None = None
        self._is_entered = False
        self._is_task_running = False
        self._setpoints = _SetpointLoop(self._transmit)

    # -- the block -------------------------------------------------------------------------------

    async def __aenter__(self) -> Self:
        if self._is_entered:
            raise UsageError("this control block was entered before; ask for a new one")
        self._is_entered = True
        try:
            await self._obtain()
        except BaseException:
            # The ack may be lost and authority ours all the same.
            await _finish(self._release())
            raise
        self._scope.__enter__()
        return self

    async def __aexit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> bool:
        swallowed = bool(self._scope.__exit__(exc_type, exc, traceback))
        await _finish(self._stop_path())
        if self._failure is not None and (exc is None or swallowed):
            raise self._failure
        return swallowed

    def fail(self, error: M100Error) -> None:
        """Authority or link are gone: end the block with this error."""
        if self._failure is None:
            self._failure = error
            self._setpoints.silence()
            self._scope.cancel()

    async def _obtain(self) -> None:
        authority, firmware = self._commander.authority, self._commander.firmware
        authority.feed(AuthorityInput.OBTAIN)
        code = AuthorityCode.NOT_CHANGED
        try:
            for _ in range(_AUTHORITY_REQUESTS if firmware.authority_requests > 1 else 1):
                code = AuthorityCode(await self._request_authority(obtain=True))
                if code == AuthorityCode.OBTAINED:
                    authority.feed(AuthorityInput.OBTAINED)
                    _logger.info("control authority obtained")
                    return
                if code != AuthorityCode.NOT_CHANGED:
                    break
                await asyncio.sleep(AUTHORITY_PAUSE)
        finally:
            if authority.state is AuthorityState.OBTAINING:
                authority.feed(AuthorityInput.REFUSED)
        situation = self._commander.state.situation()
        raise AuthorityRefused(
            f"the aircraft did not give control authority: {code.meaning or code.name} "
            f"(code 0x{code:04X}; mode switch {situation['mode_switch'] or 'unknown'})",
            command=RequestAuthority.NAME,
            code=int(code),
            cause=code.cause,
            remedy=code.remedy,
        )

    async def _request_authority(self, *, obtain: bool) -> int:
        return await self._commander.execute(
            RequestAuthority(obtain=obtain), timeout=0.5, tries=2, refusal=AuthorityRefused
        )

    async def _release(self) -> None:
        authority, firmware = self._commander.authority, self._commander.firmware
        authority.feed(AuthorityInput.RELEASE)
        try:
            async with asyncio.timeout(_RELEASE_DEADLINE):
                for _ in range(_AUTHORITY_REQUESTS if firmware.authority_requests > 1 else 1):
                    code = await self._request_authority(obtain=False)
                    if code not in (AuthorityCode.NOT_CHANGED, AuthorityCode.RELEASING):
                        break
                    await asyncio.sleep(AUTHORITY_PAUSE)
            _logger.info("control authority released")
        except (M100Error, TimeoutError) as error:
            # The block ends all the same: without setpoints the aircraft hovers.
            _logger.warning("control authority may not be released: %s", error)
        finally:
            authority.feed(AuthorityInput.RELEASED)

    async def _stop_path(self) -> None:
        if isinstance(self._failure, LinkError):
            await self._setpoints.stop()
            return
        was_flying = self._setpoints.current is not None
        if self.has_authority:
            self._setpoints.neutralise()
            if was_flying:
                await asyncio.sleep(NEUTRAL_TIME)
        await self._setpoints.stop()
        if self._stop_action == "land" and self.has_authority and self._is_airborne():
            try:
                await self.land(timeout=_LAND_DEADLINE)
            except M100Error as error:
                _logger.error("the stop path could not land: %s", error)
        await self._release()

    def _is_airborne(self) -> bool:
        status = self._commander.state.flight_status
        return status is not None and status.status != FlightPhase.STANDBY

    # -- setpoints -------------------------------------------------------------------------------

    @property
    def has_authority(self) -> bool:
        """Whether setpoints are obeyed."""
        return self._commander.authority.state is AuthorityState.HELD

    @property
    def setpoints_sent(self) -> int:
        """Movement frames sent in this block, neutrals included."""
        return self._setpoints.sent

    def send(self, setpoint: Setpoint, *, lifetime: float = SETPOINT_LIFETIME) -> None:
        """Send a setpoint now, and repeat it at 50 Hz until it is renewed or expires.

        Args:
            setpoint: What to fly.
            lifetime: Seconds after which it is not repeated any more; then the mode's neutral is
                sent for 0.3 s, then nothing.

        Raises:
            NoAuthority: Authority is not held, or a task is flying the aircraft.
            BadSetpoint: The firmware cannot express it.
        """
        self._require_authority("a setpoint")
        if self._is_task_running:
            raise NoAuthority(
                "a setpoint was sent while a task flies the aircraft",
                cause="the aircraft ignores movement during take-off, landing and go-home",
                remedy="await the task first",
            )
        if not lifetime > 0:
            raise UsageError(f"a lifetime of {lifetime} s is no time at all")
        setpoint.control_flag(self._commander.firmware)  # refuse before anything is sent
        self._setpoints.set(setpoint, lifetime)

    def _transmit(self, setpoint: Setpoint) -> bool:
        if not self.has_authority:
            return False
        try:
            return self._commander.push(setpoint.to_move(self._commander.firmware))
        except LinkError:
            return False  # fail() has been or is about to be called with the same error

    def ticks(self, rate_hz: float = MAX_RATE_HZ) -> Ticker:
        """Ticks for a control loop in the caller's own task.

        Raises:
            UsageError: Not within 0 to 50 Hz.
        """
        return Ticker(rate_hz)

    @asynccontextmanager
    async def hold(
        self, setpoint: Setpoint, *, lifetime: float = SETPOINT_LIFETIME
    ) -> AsyncIterator[Hold]:
        """Keep sending a setpoint while the block runs and renews it by :meth:`Hold.set`.

        On the way out the mode's neutral is sent.

        Args:
            setpoint: The first setpoint.
            lifetime: Seconds that each setpoint lasts when it is not renewed.

        Raises:
            NoAuthority, BadSetpoint: See :meth:`send`.
        """
        hold = Hold(self, lifetime)
        hold.set(setpoint)
        try:
            yield hold
        finally:
            self._setpoints.neutralise()

    async def stop(self) -> None:
        """Send the neutral of the present mode for a moment, then nothing: the aircraft hovers."""
        self._setpoints.neutralise()
        await asyncio.sleep(NEUTRAL_TIME)
        self._setpoints.silence()

    def _require_authority(self, what: str) -> None:
        if self._failure is not None:
            raise self._failure
        if not self.has_authority:
            state = self._commander.authority.state
            raise NoAuthority(
                f"{what} was asked for while authority is {state.value}; nothing was sent",
                remedy="use it inside `async with aircraft.control()`",
            )

    # -- tasks -----------------------------------------------------------------------------------

    async def take_off(
        self,
        *,
        timeout: float = 20.0,
        progress: Callable[[TaskProgress], None] | None = None,
    ) -> None:
        """Start the motors and climb to about 1.2 m.

        Done when the aircraft reports success, or telemetry shows it in the air at 1 m or more;
        the ack alone proves nothing.

        Args:
            timeout: Seconds to wait after the aircraft accepted.
            progress: Called about four times a second.

        Raises:
            NoAuthority: Authority is not held.
            TaskRefused, TaskFailed: With the situation that explains it.
            NotObserved: Neither success nor failure showed in time.
            AckTimeout: Nobody knows whether it began.
        """
        await self._run_task(Task.TAKE_OFF, self._has_taken_off, timeout, progress)

    async def land(
        self,
        *,
        timeout: float = 60.0,
        progress: Callable[[TaskProgress], None] | None = None,
    ) -> None:
        """Land in place and stop the motors. See :meth:`take_off` for arguments and errors."""
        await self._run_task(Task.LAND, self._is_standing, timeout, progress)

    async def go_home(
        self,
        *,
        timeout: float = 300.0,
        progress: Callable[[TaskProgress], None] | None = None,
    ) -> None:
        """Fly to the home point and land. See :meth:`take_off` for arguments and errors."""
        await self._run_task(Task.GO_HOME, self._is_standing, timeout, progress)

    def _has_taken_off(self) -> bool:
        state = self._commander.state
        status, position = state.flight_status, state.position
        if status is None or position is None:
            return False
        return status.status == FlightPhase.IN_AIR and position.height_m >= _TAKE_OFF_HEIGHT

    def _is_standing(self) -> bool:
        status = self._commander.state.flight_status
        return status is not None and status.status == FlightPhase.STANDBY

    async def _run_task(
        self,
        task: Task,
        is_observed: Callable[[], bool],
        timeout: float,
        progress: Callable[[TaskProgress], None] | None,
    ) -> None:
        name = task.name.lower().replace("_", " ")
        self._require_authority(name)
        if self._is_task_running:
            raise TaskRefused(
                f"{name} was asked for while another task runs",
                remedy="await one task before the next",
            )
        self._is_task_running = True
        self._setpoints.silence()
        try:
            sequence = self._commander.next_task_sequence()
            code = TaskStartCode(
                await self._commander.execute(
                    StartTask(sequence, task), timeout=0.5, tries=3, refusal=TaskRefused
                )
            )
            if code != TaskStartCode.STARTED:
                raise TaskRefused(
                    f"{name} was refused: {code.meaning} (code 0x{code:04X})",
                    command=name,
                    code=int(code),
                    situation=self._commander.state.situation(),
                    cause=code.cause,
                    remedy=code.remedy,
                )
            await self._watch_task(task, sequence, is_observed, timeout, progress)
        finally:
            self._is_task_running = False

    async def _watch_task(
        self,
        task: Task,
        sequence: int,
        is_observed: Callable[[], bool],
        timeout: float,
        progress: Callable[[TaskProgress], None] | None,
    ) -> None:
        loop = asyncio.get_running_loop()
        state = self._commander.state
        name = task.name.lower().replace("_", " ")
        began_at = loop.time()
        next_query_at = began_at + _TASK_QUERY_INTERVAL
        result: TaskResultCode | None = None
        while True:
            now = loop.time()
            if now >= next_query_at:
                next_query_at = now + _TASK_QUERY_INTERVAL
                result = await self._query_task(sequence)
            status, position = state.flight_status, state.position
            if progress is not None:
                progress(
                    TaskProgress(
                        task,
                        now - began_at,
                        status.phase if status else None,
                        position.height_m if position else None,
                        result,
                    )
                )
            if result == TaskResultCode.SUCCEEDED:
                return
            if result == TaskResultCode.FAILED:
                raise TaskFailed(
                    f"{name} began and failed",
                    command=name,
                    code=int(result),
                    situation=state.situation(),
                    cause=result.cause,
                    remedy=result.remedy,
                )
            # While the aircraft says that it is executing it would ignore what comes next.
            if result != TaskResultCode.EXECUTING and self._is_settled(result, is_observed):
                return
            if now - began_at >= timeout:
                raise NotObserved(
                    f"{name} was accepted {timeout:g} s ago and is not seen to be done",
                    situation=state.situation(),
                    cause="flight status or position is not among the telemetry items, "
                    "or something holds the aircraft",
                    remedy="watch the aircraft; the task may still be running",
                )
            await asyncio.sleep(_TASK_POLL)

    @staticmethod
    def _is_settled(result: TaskResultCode | None, is_observed: Callable[[], bool]) -> bool:
        """Observation decides once the first query went unanswered or knows nothing."""
        return result is not None and is_observed()

    async def _query_task(self, sequence: int) -> TaskResultCode:
        try:
            return TaskResultCode(
                await self._commander.execute(QueryTask(sequence), timeout=0.2, tries=2)
            )
        except (AckTimeout, CommandRefused) as error:
            _logger.debug("no result of the task: %s", error)
            return TaskResultCode.NOT_CURRENT


async def _finish(work: Awaitable[None]) -> None:
    """Await work to its end whatever cancels the caller meanwhile, then let the cancellation on.

    A shielded scope alone holds off cancellation by scopes; a second ``Task.cancel()`` would still
    cut the stop path short. Every wait inside ``work`` is bounded, so this is too.
    """
    task = asyncio.ensure_future(work)
    cancelled: asyncio.CancelledError | None = None
    with anyio.CancelScope(shield=True):
        while not task.done():
            try:
                await asyncio.shield(task)
            except asyncio.CancelledError as error:
                cancelled = error
    task.result()
    if cancelled is not None:
        raise cancelled


def authority_lost(reason: str) -> AuthorityLost:
    """The error for a loss of authority with that reason."""
    meaning, remedy = {
        "mode_switch": (
            "the pilot moved the mode switch out of F",
            "the pilot has the aircraft; back in F, start a new control block",
        ),
        "app": (
            "the mobile app took control",
            "let the app release control, then start a new control block",
        ),
        "released": ("authority was released", "start a new control block"),
    }.get(reason, ("the aircraft says that authority passed away", "ask the pilot what happened"))
    return AuthorityLost(meaning, reason=reason, remedy=remedy)
