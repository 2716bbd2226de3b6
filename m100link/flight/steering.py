"""Setpoints of the program: who may send one now, and the gate in front of the wire."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from m100link.errors import GuardRefused, LineBlocked, LinkError, M100Error, NoAuthority
from m100link.flight.authority import AuthorityState
from m100link.flight.block import ControlBlock
from m100link.flight.guards import GuardKeeper
from m100link.flight.lifecycle import BlockState, StopCause
from m100link.flight.missions.keeper import MissionKeeper
from m100link.flight.pacing import MAX_RATE_HZ, period_of
from m100link.flight.setpoints import SETPOINT_LIFETIME, SetpointLoop, check_lifetime
from m100link.flight.tasks import Commander, task_name
from m100link.protocol.commands.control import Task
from m100link.protocol.setpoint import Setpoint

__all__ = ["BLOCKED_S", "Steering"]

_logger = logging.getLogger(__name__)

BLOCKED_S = 0.5
"""Seconds in which no setpoint leaves, although one is due, after which a block ends: for so long a
line may be busy, and the aircraft does not fly on by the last one for much longer."""


class Steering:
    """Sends setpoints for whoever may steer: the program, or the closed loop that flies.

    Args:
        commander: The aircraft.
        guards: Asked before each frame.
        missions: While one flies, nothing else steers.

    Attributes:
        setpoints: What sends them.
        block: The control block, to be set before the first setpoint.
        running_task: Flown by the autopilot, which ignores setpoints meanwhile; None: none is.
    """

    block: ControlBlock

    def __init__(self, commander: Commander, guards: GuardKeeper, missions: MissionKeeper) -> None:
        self._requests = commander.requests
        self._authority = commander.authority
        self._guards = guards
        self._missions = missions
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
        setpoint.control_flag(self._requests.firmware)  # refused here, not in the sending task
        try:
            self._guards.check(setpoint)
        except GuardRefused:
            self.block.hurry()
            self.block.require_flying("a setpoint")
            raise
        self._refused = None
        self.setpoints.set(setpoint, lifetime=lifetime, period=period_of(rate_hz))

    def require_autopilot_idle(self, what: str) -> None:
        """Raise while the aircraft flies by itself and would ignore movement.

        Raises:
            NoAuthority: During a task; MissionRunning during a mission.
        """
        if self.running_task is not None:
            raise NoAuthority(
                f"{what} was sent during {task_name(self.running_task)}; nothing was sent",
                cause="the aircraft ignores movement during take-off, landing and go-home",
                remedy="await the task first",
            )
        self._missions.require_none(what)

    @contextmanager
    def ends_neutral(self) -> Iterator[None]:
        """Neutral on the way out, and the refusal if a guard ended what was sent last."""
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
            failure = LineBlocked(
                f"the line took no setpoint for {blocked_s:.1f} s while flying",
                cause=LineBlocked.usual_cause,
                remedy=LineBlocked.usual_remedy,
            )
            self.block.end(StopCause.LINE_BLOCKED, failure)

    def _on_send_failed(self, error: Exception) -> None:
        """The task that repeats setpoints has ended, and not because of the line."""
        failure = M100Error(
            f"setpoints cannot be sent: {error!r}",
            cause="an error that nobody expected: a bug, of m100link or of what it stands on",
            remedy="report it with the traceback in the log",
        )
        failure.__cause__ = error
        self.block.end(StopCause.SENDING_FAILED, failure)
        _logger.error("setpoints cannot be sent", exc_info=error)

    def _admits(self, setpoint: Setpoint) -> bool:
        """The gate in front of the wire, for each frame that :meth:`steer` did not check itself."""
        if self._authority.state is not AuthorityState.HELD:
            return False
        if self.block.state is BlockState.STOPPING:
            return True  # the neutral
        return self.block.admits() and self._guards_admit(setpoint)

    def _guards_admit(self, setpoint: Setpoint) -> bool:
        """Ask again: a setpoint may live longer than what it was checked against."""
        try:
            self._guards.check(setpoint)
        except GuardRefused as error:
            self.block.hurry()
            if setpoint != setpoint.neutral():  # standing still is never refused
                self._refused = error
                self.setpoints.neutralise()
                _logger.warning("sending neutral: %s", error.seen)
                return False
        return True
