"""The control block without ``await``: it hands every call to the thread of the one with it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Self

from m100link.errors import M100Error
from m100link.flight import control as aio
from m100link.flight.guards import Guards
from m100link.flight.missions.hotpoint import Target
from m100link.flight.pacing import MAX_RATE_HZ, Tick
from m100link.flight.setpoints import Pace
from m100link.protocol.commands.control import Task
from m100link.protocol.setpoint import Setpoint
from m100link.sync.portal import Handed, Portal, Reads, calls, like, waits
from m100link.sync.signals import SIGNALS
from m100link.sync.steering import FollowFlight, Hold, HotpointFlight, Ticks, WaypointFlight, asked
from m100link.telemetry.state import AircraftState

__all__ = ["Control"]


class Control(Handed):
    """Control of the aircraft without ``await``: ``with aircraft.control() as control:``.

    Leaving takes the stop path, after an error, Ctrl-C and SIGTERM too. The reason that would
    cancel a block with ``await`` is raised here by the call that waits, or by the next one.
    """

    def __init__(self, portal: Portal, control: aio.Control, *, handle_signals: bool) -> None:
        super().__init__(portal, control)
        self._handles_signals = handle_signals

    def __enter__(self) -> Self:
        return self.obtain()

    def __exit__(self, _: object, exc: BaseException | None, __: object) -> None:
        try:
            self.release()
        except M100Error:
            if exc is None:
                raise

    @like(aio.Control.obtain)
    def obtain(self) -> Self:
        if self._handles_signals:
            SIGNALS.join(self)
        try:
            self._portal.wait(lambda _: self._aio.obtain())
            return self
        except BaseException as error:
            if not isinstance(error, M100Error):
                self.interrupt()  # it may be obtained all the same, and nobody is to leave it
            SIGNALS.leave(self)
            raise

    @like(aio.Control.release)
    def release(self) -> None:
        try:
            self._portal.wait(lambda _: self._aio.release())
        except BaseException:
            self.interrupt()  # a signal may raise before it was asked for
            raise
        finally:
            SIGNALS.leave(self)

    is_flying = Reads[bool](aio.Control.is_flying)
    is_stopping = Reads[bool](aio.Control.is_stopping)
    is_over = Reads[bool](aio.Control.is_over)
    has_guardian = Reads[bool](aio.Control.has_guardian)

    def interrupt(self) -> None:
        """Begin the stop path without waiting for its end: for signal handlers, other threads."""
        self._portal.soon(self._aio.interrupt)

    # -- setpoints -------------------------------------------------------------------------------

    has_authority = Reads[bool](aio.Control.has_authority)
    unended_task = Reads[Task | None](aio.Control.unended_task)
    is_paused = Reads[bool](aio.Control.is_paused)
    state = Reads[AircraftState](aio.Control.state)
    guards = Reads[Guards](aio.Control.guards)
    origin = Reads[tuple[float, float] | None](aio.Control.origin)
    setpoint = Reads[Setpoint | None](aio.Control.setpoint)
    setpoints_sent = Reads[int](aio.Control.setpoints_sent)
    setpoints_expired = Reads[int](aio.Control.setpoints_expired)
    pace = Reads[Pace](aio.Control.pace)
    send = calls(aio.Control.send)

    @like(aio.Control.ticks)
    def ticks(self, rate_hz: float = MAX_RATE_HZ) -> Ticks:
        return Ticks(self._portal, self._portal.call(self._aio.ticks, rate_hz))

    @like(aio.Control.hold)
    def hold(self, setpoint: Setpoint, **how: Any) -> Hold:
        return Hold(self._portal, lambda _: self._aio.hold(setpoint, **how))

    def follow(
        self,
        source: Callable[[Tick], Setpoint | None],
        *,
        rate_hz: float = MAX_RATE_HZ,
        lifetime: float | None = None,
        allow_long_lifetime: bool = False,
    ) -> None:
        """Send what a source gives until it ends, then the mode's neutral.

        Args:
            source: A callable that gets each :class:`Tick` and returns a setpoint, or None to end.
            rate_hz: Ticks per second for a callable.
            lifetime: Seconds that each setpoint lasts when the next one does not come; by default
                0.2 s, or two ticks where these are longer.
            allow_long_lifetime: Allow more than 1 s, as a rate below 2 Hz needs it.

        Raises:
            NoAuthority, GuardRefused, BadSetpoint, UsageError: See :meth:`send`.
        """
        how = {
            "rate_hz": rate_hz,
            "lifetime": lifetime,
            "allow_long_lifetime": allow_long_lifetime,
        }
        self._portal.wait(
            lambda caller: self._aio.follow(asked(caller, source, self._aio.ticks(rate_hz)), **how)
        )

    stop = waits(aio.Control.stop)
    wait_resumable = waits(aio.Control.wait_resumable)
    resume = calls(aio.Control.resume)

    # -- closed loops ----------------------------------------------------------------------------

    local_frame = calls(aio.Control.local_frame)
    fly_to = waits(aio.Control.fly_to)
    fly_path = waits(aio.Control.fly_path)
    climb_to = waits(aio.Control.climb_to)
    turn_to = waits(aio.Control.turn_to)
    orbit = waits(aio.Control.orbit)

    # -- missions: the aircraft flies by itself --------------------------------------------------

    @like(aio.Control.waypoint_mission)
    def waypoint_mission(self, *plan: Any, **how: Any) -> WaypointFlight:
        return WaypointFlight(
            self._portal, lambda caller: caller.begin(self._aio.waypoint_mission, *plan, **how)
        )

    @like(aio.Control.hotpoint)
    def hotpoint(self, **how: Any) -> HotpointFlight:
        return HotpointFlight(self._portal, lambda _: self._aio.hotpoint(**how))

    def follow_target(
        self, source: Target, *, face_target: bool = True, allow_far: bool = False
    ) -> FollowFlight:
        """Let the aircraft follow a target by itself, at the distance that it has at the beginning.

        ::

            with control.follow_target(first) as mission:
                for event in mission:
                    print(event)

        It is stopped when the block is left; the aircraft hovers. When nothing new comes for 6 s,
        the aircraft waits where it is. ``Control.follow`` is another thing: it sends setpoints.

        Args:
            source: The first one, to be renewed by :meth:`m100link.FollowFlight.set_target`.
            face_target: The nose points to the target; otherwise the pilot's stick turns it.
            allow_far: Let the first target be more than 500 m away.

        Raises:
            UsageError: Below 5 m; a target is not a place, or jumps by more than 200 m.
            GuardRefused, CommandNotSupported, MissionRefused, MissionRunning, NoAuthority,
            TelemetryStalled, AckTimeout, MissionAborted: See :meth:`waypoint_mission`.
        """
        how = {"face_target": face_target, "allow_far": allow_far}
        return FollowFlight(self._portal, lambda _: self._aio.follow_target(source, **how))

    stop_mission = waits(aio.Control.stop_mission)
    pause_mission = waits(aio.Control.pause_mission)
    resume_mission = waits(aio.Control.resume_mission)
    detach_mission = calls(aio.Control.detach_mission)

    # -- motors and tasks ------------------------------------------------------------------------

    arm = waits(aio.Control.arm)
    disarm = waits(aio.Control.disarm)
    take_off = waits(aio.Control.take_off)
    land = waits(aio.Control.land)
    go_home = waits(aio.Control.go_home)
