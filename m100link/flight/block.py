"""The life of a control block: entered, ended by whatever comes first, left by one path."""

from __future__ import annotations

import asyncio
import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import Literal

from m100link.errors import (
    GuardianTookOver,
    GuardRefused,
    LineBlocked,
    LinkClosed,
    LinkError,
    LinkLost,
    LossReason,
    M100Error,
    NoAuthority,
    UsageError,
)
from m100link.flight.authority import AuthorityInput, AuthorityState
from m100link.flight.cancellation import SIGNALS, ProgramTask, ShieldedTask
from m100link.flight.guardian import Guardian, control_plan
from m100link.flight.guards import GuardKeeper
from m100link.flight.handover import authority_lost, is_unexplained, obtain_authority
from m100link.flight.lifecycle import BlockClaim, BlockInput, BlockState, Lifecycle, StopCause
from m100link.flight.missions.mission_guard import MissionGuard
from m100link.flight.pacing import MAX_RATE_HZ, period_of
from m100link.flight.reserves import free, reserve
from m100link.flight.setpoints import SETPOINT_LIFETIME, SetpointLoop, check_lifetime
from m100link.flight.stop_path import StopAction, StopPath
from m100link.flight.tasks import Commander, task_name
from m100link.flight.watchdog import FollowCheck, TelemetryWatchdog
from m100link.protocol.commands.control import Task
from m100link.protocol.setpoint import Setpoint

_logger = logging.getLogger(__name__)

PauseAction = Literal["raise", "wait"]
"""The reaction to a pilot who takes the aircraft: end the block, or wait for the pilot."""


class ControlBlock:
    """One control block: watches for the causes of its end, and then runs the stop path."""

    def __init__(
        self,
        commander: Commander,
        claim: BlockClaim,  # kept while the block lives: one at a time
        setpoints: SetpointLoop,  # sends the block's setpoints
        missions: MissionGuard,  # answers for the block's mission
        guards: GuardKeeper,  # their clock starts when authority was obtained
        *,
        stop: StopAction,  # of the stop path after the neutral setpoint
        on_pause: PauseAction,  # when the pilot takes the aircraft
        handle_signals: bool,  # let signals that end programs take the stop path first
        # How long the event loop may stand still until a guardian ends the flight; None: there is
        # none.
        patience_s: float | None = None,
    ) -> None:
        self._commander = commander
        self._authority = commander.authority
        self._claim = claim
        self._setpoints = setpoints
        self._guards = guards
        self._on_pause: PauseAction = on_pause
        self._handles_signals = handle_signals
        self._life = Lifecycle()
        # The tasks to cancel when the block ends: the one that entered it; when it was entered by
        # hand, those that wait in a call of it at that moment.
        self._programs: list[ProgramTask] = []
        self._is_by_hand = False
        self._is_raised = False  # by hand: a call of the program raised what ended the block
        self._stop_path = StopPath(commander, self._life, setpoints, missions, stop)
        self.armed = self._stop_path.armed
        first_sequence = int.from_bytes(os.urandom(2))
        self.guardian = Guardian(  # ends the flight when this program cannot
            commander.link,
            lambda: self._stop_path.wanted,
            lambda wanted: control_plan(commander, wanted, first_sequence),
            self._on_guardian,
            patience_s,
        )
        self._stopping = ShieldedTask(self._stop, self._on_stopped)
        self._on_signal = partial(self.end, StopCause.SIGNALLED)
        loop = commander.link.loop
        self._watchdog = TelemetryWatchdog(
            commander.state,
            guards.guards,
            self.end,
            loop,
            FollowCheck(
                commander.state,
                lambda: setpoints.current,
                loop.time,
                lambda: commander.link.latency.slack_s,
            ),
            commander.link.latency,
        )

    @property
    def state(self) -> BlockState:
        """Where it is in its life."""
        return self._life.state

    @property
    def is_open(self) -> bool:
        """Whether the program is in it, and nothing has ended it."""
        return self._life.is_open

    @property
    def is_flying(self) -> bool:
        """Whether it was entered, and nothing has ended it."""
        return self._life.state in (BlockState.ENTERING, BlockState.FLYING, BlockState.PAUSED)

    # -- in and out ------------------------------------------------------------------------------

    async def enter(self) -> None:
        """As :meth:`obtain`; the end of the block cancels the task that entered it."""
        self._begin()
        program = self._join()
        try:
            await self._obtain()
        except BaseException as error:
            await self._leave(program, error)
            raise
        if not self._life.is_open:  # lost, closed or signalled between the request and here
            await self._leave(program, None)
            raise asyncio.CancelledError

    async def leave(self, error: BaseException | None) -> bool:
        """End the block, if nothing did before, and wait for the end of the stop path.

        Returns whether ``error`` was the cancellation by this block alone. Raises ``M100Error``:
        what ended the block, unless an error of the program is under way.
        """
        self.end(StopCause.LEFT)
        return await self._leave(self._programs[0], error)

    async def _leave(self, program: ProgramTask, error: BaseException | None) -> bool:
        program.leave()
        try:
            await self._stopping.ended()
        finally:
            is_ours = program.take_back(error)
        failure = self._life.failure
        if failure is not None and (error is None or is_ours or is_unexplained(error)):
            raise failure.again() from failure.__cause__
        # Whatever else ended it, the program does not go on behind the block as if it had flown.
        return is_ours and self._life.cause in (StopCause.LEFT, StopCause.NOT_ENTERED)

    async def obtain(self) -> None:
        """Obtain authority by hand; the next call that needs it raises the error that ended it.

        Raises ``UsageError``: it was entered before, another block of this program is running, or
        the firmware is unknown. Raises ``AuthorityRefused, NotActivated, LevelTooLow, KeyRejected,
        AckTimeout, LinkError``: see each class.
        """
        self._begin()
        self._is_by_hand = True
        with self.waiting("control"):
            try:
                await self._obtain()
            except BaseException:
                await self._stopping.ended()
                raise
        if not self._life.is_open:
            await self._stopping.ended()
            self.require_flying("control")

    def _abandoned(self) -> None:
        """The task that waits to run the stop path was cancelled, and so begins to run it."""
        # asyncio.run cancels every task on its way out, and waits for those and for no other. The
        # program is over then. It left control by hand, or could not get as far as leaving its
        # block: its stack was used up, or nobody closed its generator.
        if self._is_by_hand:
            self.end(StopCause.LEFT)
            _logger.warning("control was obtained and not released when the program ended")
            return
        failure = M100Error(
            "the task that ends this flight was cancelled, and so it has ended",
            cause="every task of the event loop was cancelled, by the program or at its end",
            remedy="cancel the tasks of the program alone",
        )
        self.end(StopCause.SENDING_FAILED, failure)

    async def release(self) -> None:
        """End it by hand, wait, and raise the error that ended it, unless a call has done so."""
        self._commander.link.require_loop()
        if self._life.state is BlockState.NEW:
            return
        self.end(StopCause.LEFT)
        await self._stopping.ended()
        failure = self._life.failure
        if self._is_by_hand and failure is not None and not self._is_raised:
            self._is_raised = True
            raise failure.again() from failure.__cause__

    def _begin(self) -> None:
        self._commander.link.require_loop()
        if self._life.state is not BlockState.NEW:
            raise UsageError("this control block was entered before; ask for a new one")
        self._claim.take(self._close)  # first: what flies already keeps its firmware
        try:
            self._commander.requests.fix_firmware()
            # A system without descriptors, threads or modules refuses here, and not at the end.
            reserve("control", self._close)
        except M100Error:
            self._claim.give_back()
            self._commander.requests.free_firmware()
            raise
        # Made now: at the end, the stack or the system may have no room for a new task.
        self._stopping.park(self._abandoned)
        self._life.feed(BlockInput.ENTER)
        self._unsubscribe = self._authority.subscribe(self._on_authority_changed)
        if self._handles_signals:
            SIGNALS.join(self._on_signal)

    async def _obtain(self) -> None:
        try:
            await self.guardian.start()  # first: without its guardian no flight may begin
            await obtain_authority(self._commander)
            self._life.feed(BlockInput.OBTAINED)
            self._guards.start()
            self._watchdog.start()
        except BaseException:
            self.end(StopCause.NOT_ENTERED)
            raise

    def _join(self) -> ProgramTask:
        """The present task is cancelled when the block ends."""
        program = ProgramTask(self._commander.link.loop)
        program.enter()
        self._programs.append(program)
        return program

    @contextmanager
    def waiting(self, what: str) -> Iterator[None]:
        """End a wait in here with the block, also when that was entered by hand.

        Raises ``NoAuthority``: the program released it meanwhile. Raises ``M100Error``: what ended
        the block.
        """
        if not self._is_by_hand:  # then the program is cancelled as a whole
            yield
            return
        program = self._join()
        try:
            yield
        except BaseException as error:
            if program.take_back(error):
                self.require_flying(what)
            raise
        finally:
            program.leave()
            self._programs.remove(program)

    def end(self, cause: StopCause, failure: M100Error | None = None) -> None:
        """Something ends the block: the stop path begins at once, in a task of its own."""
        is_first = self._life.state is not BlockState.STOPPING
        # After the first cause, only a lost line and the guardian change anything (TRANSITIONS).
        if not self._life.feed(cause, failure):
            return
        # The program is not waited for: it may clean up slowly, swallow its cancellation, be gone.
        if is_first:
            try:
                self._stopping.begin()  # first: it takes less of the stack than to send a frame
            except Exception:  # noqa: BLE001 (without stack or memory its timer begins it, soon)
                self._stopping.is_wanted = True
        with suppress(Exception):  # the stop path lets go first of all, and logs what it cannot
            self._stop_path.let_go()
        if is_first:
            # Left, or not entered, the program is on its way out: its own error comes through.
            is_left = cause is StopCause.LEFT and not self._is_by_hand
            if not is_left and cause is not StopCause.NOT_ENTERED:
                for program in self._programs:
                    program.cancel()

    async def _stop(self) -> None:
        """The stop path, and behind it the end of the guardian. May be begun again."""
        try:
            await self._stop_path.run()
        finally:
            # Last: killed in the middle of the stop path, the program leaves the rest to it.
            await self.guardian.end()

    def _on_guardian(self, error: GuardianTookOver) -> None:
        # Its frames give authority back and it reads no acks: the state is UNRELEASED then.
        self._authority.feed(AuthorityInput.RELEASE)
        self._authority.feed(AuthorityInput.NOT_RELEASED)
        self.end(StopCause.GUARDIAN, error)

    @contextmanager
    def taking_off(self) -> Iterator[None]:
        """A take-off is commanded: from here on it counts as flown, for the guardian as well."""
        with self._stop_path.taking_off():
            self.guardian.update()
            yield

    async def _close(self) -> None:
        """The connection is about to be closed."""
        error = LinkClosed("the aircraft was disconnected while this block was flying it")
        self.end(StopCause.CLOSED, error)
        await self._stopping.ended()

    def _on_authority_changed(self, before: AuthorityState, after: AuthorityState) -> None:
        reason = self._authority.reason
        # A lost line comes first: by its state it is LOST like authority that the app took.
        if reason is LossReason.LINK:
            lost = self._commander.link.failure or LinkLost("the line is gone")
            self.end(StopCause.LINK_LOST, lost.again())
        elif after is AuthorityState.PAUSED and self._on_pause == "wait":
            if self._life.feed(BlockInput.PAUSE):
                self._setpoints.silence()
        elif after in (AuthorityState.PAUSED, AuthorityState.LOST):
            lost_by = authority_lost(reason, self._commander.state.remote_control)
            self.end(StopCause.AUTHORITY_LOST, lost_by)
        self.guardian.update()  # behind what ends the block

    def _on_stopped(self) -> None:
        self._life.feed(BlockInput.STOPPED)
        self._unsubscribe()
        self._watchdog.stop()
        self._commander.requests.free_firmware()
        self._claim.give_back()
        free(self._close)
        SIGNALS.leave(self._on_signal)  # last: a signal that came may end the process here

    # -- permission to send ----------------------------------------------------------------------

    def admits(self) -> bool:
        """Whether the program's setpoints may go out: it is flying, and telemetry is true."""
        return self._life.state is BlockState.FLYING and self._watchdog.is_quiet()

    def hurry(self) -> None:
        """A guard refused. Where telemetry cannot be true, the block ends by that error instead."""
        self._watchdog.hurry()

    def require_flying(self, what: str) -> None:
        """Raise unless the block may send: the error that ended it, or the way back to sending.

        Raises ``NoAuthority``: authority is not held, or is paused. Raises ``M100Error``: what
        ended the block.
        """
        self._commander.link.require_loop()
        # Telemetry first: a stall ends the block, where guards would complain of old values.
        if self.admits() and self._authority.state is AuthorityState.HELD:
            return
        life = self._life
        if life.failure is not None:
            self._is_raised = True
            raise life.failure.again()
        state = self._authority.state.value
        remedy = "use it inside `async with aircraft.control()`, or obtain() it"
        if life.state in (BlockState.STOPPING, BlockState.OVER):
            state, remedy = "over with this block", "ask for a new one: aircraft.control()"
            if life.state is BlockState.STOPPING:
                remedy = f"release() waits until it has landed or hovers; then {remedy}"
        elif life.state is BlockState.PAUSED:
            state, remedy = "paused by the pilot", "wait_resumable() and resume()"
        raise NoAuthority(
            f"{what} was asked for while authority is {state}; nothing was sent", remedy=remedy
        )

    def resume(self) -> None:
        """The program goes on; ``NoAuthority`` unless the pilot gave the aircraft back."""
        self._commander.link.require_loop()
        if self._authority.state is not AuthorityState.HELD:
            raise NoAuthority(
                "the pilot has not given the aircraft back",
                remedy="await control.wait_resumable() first",
            )
        self._life.feed(BlockInput.RESUME)


# -- setpoints of the program, and the gate in front of the wire -----------------------------------


# Seconds in which no setpoint leaves, although one is due, after which a block ends: for so long a
# line may be busy, and the aircraft does not fly on by the last one for much longer.
BLOCKED_S = 0.5


class SetpointSender:
    """Sends setpoints of the program, or of the closed loop that flies."""

    block: ControlBlock  # the control block, to be set before the first setpoint

    def __init__(self, commander: Commander, guards: GuardKeeper, missions: MissionGuard) -> None:
        self._requests = commander.requests
        self._authority = commander.authority
        self._guards = guards  # asked before each frame
        self._missions = missions  # while one flies, nothing else steers
        self._pushes = commander.missions
        # Flown by the autopilot, which ignores setpoints meanwhile; None: none is.
        self.running_task: Task | None = None
        self._refused: GuardRefused | None = None  # why the newest setpoint was ended
        self._require_loop = commander.link.require_loop
        self._clock = commander.link.loop.time
        # When the line took no setpoint, the first and the newest time; None since it took one.
        self._blocked: tuple[float, float] | None = None
        self._mode: object = None  # of the newest frame
        self.setpoints = SetpointLoop(
            self._transmit,
            self._admits,
            self._on_send_failed,
            commander.link.loop,
            on_missed=commander.link.missed,
        )

    def steer(
        self,
        setpoint: Setpoint,
        lifetime: float = SETPOINT_LIFETIME,
        rate_hz: float = MAX_RATE_HZ,
        *,
        is_long_allowed: bool = False,
    ) -> None:
        """Send it now and repeat it while it lives. Raises as :meth:`m100link.Control.send`."""
        self.block.require_flying("a setpoint")
        self.require_autopilot_idle("a setpoint")
        check_lifetime(lifetime, is_long_allowed=is_long_allowed)
        setpoint.encode(self._requests.firmware)  # refused here, not in the sending task
        try:
            self._guards.check(setpoint)
        except GuardRefused:
            # A position that cannot be true makes guards refuse: that error comes before theirs.
            self.block.hurry()
            self.block.require_flying("a setpoint")
            raise
        self._refused = None
        self.setpoints.set(setpoint, lifetime=lifetime, period=period_of(rate_hz))

    def require_autopilot_idle(self, what: str) -> None:
        """Raise ``NoAuthority`` during a task or a mission: the aircraft would ignore movement."""
        if self.running_task is not None:
            raise NoAuthority(
                f"{what} was sent during {task_name(self.running_task)}; nothing was sent",
                cause="the aircraft ignores movement during take-off, landing and go-home",
                remedy="await the task first",
            )
        if self._pushes.may_fly:
            self._missions.require_none(what)

    @contextmanager
    def ends_neutral(self) -> Iterator[None]:
        """Neutral on the way out, and the refusal if a guard ended the last setpoint."""
        self._require_loop()
        self._refused = None
        try:
            yield
        finally:
            self.setpoints.neutralise()
        if self._refused is not None:
            raise self._refused.again()

    def _transmit(self, setpoint: Setpoint) -> bool:
        mode = setpoint.mode, setpoint.frame, setpoint.stable
        if mode != self._mode:  # the guardian's neutral has to be one of this mode
            self._mode = mode
            self.block.guardian.update()
        try:
            is_sent = self._requests.push(setpoint)
        except LinkError as error:
            self.block.end(StopCause.LINK_LOST, error.again())
            return False
        if is_sent:
            self._blocked = None
        else:
            self._on_blocked(self._clock())
        return is_sent

    def _on_blocked(self, now: float) -> None:
        since, newest = self._blocked or (now, now)
        if now - newest > BLOCKED_S:  # nothing was due meanwhile, and it may have taken something
            since = now
        self._blocked = since, now
        blocked_s = now - since
        if blocked_s >= BLOCKED_S:
            seen = f"the line took no setpoint for {blocked_s:.1f} s while flying"
            self.block.end(StopCause.LINE_BLOCKED, LineBlocked.usual(seen))

    def _on_send_failed(self, error: Exception) -> None:
        """The task that repeats setpoints has ended, and not because of the line."""
        failure = M100Error(
            f"setpoints cannot be sent: {error!r}",
            cause="an error that nobody expected: a bug, of m100link or of what it stands on",
            remedy="report it with the traceback in the log",
        )
        failure.__cause__ = error
        # Before the log, whose handlers may raise or block.
        self.block.end(StopCause.SENDING_FAILED, failure)
        _logger.error("setpoints cannot be sent", exc_info=error)

    def _admits(self, setpoint: Setpoint) -> bool:
        """The gate in front of the wire, for each frame that :meth:`steer` did not check itself."""
        if self._authority.state is not AuthorityState.HELD:
            return False
        if self.block.state is BlockState.STOPPING:
            return True  # the neutral
        if not self.block.admits():
            return False
        try:  # again: a setpoint may live longer than the values that it was checked against
            self._guards.check(setpoint)
        except GuardRefused as error:
            self.block.hurry()
            if setpoint != setpoint.neutral():  # standing still is never refused
                self._refused = error
                self.setpoints.neutralise()
                _logger.warning("sending neutral: %s", error.seen)
                return False
        return True
