"""Control, telemetry, ticks and missions without ``await``: ``with`` blocks, or iterated.

Every call is handed to the thread of the one with ``await``.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager
from typing import Any, Generic, Self, TypeVar

from m100link.aircraft import payload
from m100link.errors import M100Error, TelemetryStalled
from m100link.flight import control as aio
from m100link.flight import pacing, setpoints
from m100link.flight.guards import Guards
from m100link.flight.missions import hotpoint, mission_guard, waypoint
from m100link.flight.missions.events import MissionEvent
from m100link.flight.missions.hotpoint import Target
from m100link.flight.pacing import MAX_RATE_HZ, Tick
from m100link.flight.setpoints import Pace
from m100link.missions.plan import WaypointPlan
from m100link.protocol.commands.control import Task
from m100link.protocol.setpoint import Setpoint
from m100link.sync.portal import Caller, Handed, Portal, Reads, calls, like, waits
from m100link.sync.signals import SIGNALS
from m100link.telemetry import subscription
from m100link.telemetry.state import AircraftState

__all__ = ["Control"]

T = TypeVar("T")


class Ticks(Handed):
    """Ticks at a steady rate: ``for tick in control.ticks(20):``."""

    @property
    def period(self) -> float:
        """Seconds between ticks."""
        return float(self._aio.period)

    @property
    def missed(self) -> int:
        """Deadlines skipped in all."""
        return int(self._aio.missed)

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Tick:
        tick: Tick = self._portal.wait(lambda _: self._aio.__anext__())
        return tick


class Subscription(Handed, Generic[T]):
    """Values as they arrive: ``for sample in aircraft.telemetry(Attitude, timeout=1):``.

    Attributes:
        timeout: Seconds that iterating waits for a value; None: for ever.
    """

    def __init__(
        self, portal: Portal, values: subscription.Subscription[T], timeout: float | None
    ) -> None:
        super().__init__(portal, values)
        self.timeout = timeout

    def get(self, timeout: float | None = None) -> T:
        """The next value.

        Args:
            timeout: Seconds to wait; None: for ever.

        Raises:
            TelemetryStalled: None came in time.
            LinkLost, LinkClosed, TelemetryOverflow: See :meth:`m100link.Aircraft.telemetry`.
        """
        value = self.get_nowait()
        if value is not None:
            return value

        async def take() -> T:
            async with asyncio.timeout(timeout):
                value: T = await anext(self._aio)
                return value

        try:
            return self._portal.wait(lambda _: take())
        except StopAsyncIteration:
            raise StopIteration from None
        except TimeoutError as error:
            if isinstance(error, M100Error):
                raise
            raise TelemetryStalled(
                f"no value came for {timeout:g} s",
                cause="the item is not sent, or the line is broken",
                remedy="see which items arrive: m100link hz",
            ) from None

    def get_nowait(self) -> T | None:
        """The next queued value, None when there is none."""
        value: T | None = self._aio.get_nowait()
        return value

    received = Reads[int](subscription.Subscription.received)
    dropped = Reads[int](subscription.Subscription.dropped)
    thinned = Reads[int](subscription.Subscription.thinned)

    def close(self) -> None:
        """Stop receiving. May be called any number of times."""
        if self._portal.is_open:
            self._portal.call(self._aio.close)

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> T:
        return self.get(self.timeout)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class _Block(Generic[T]):
    """An async context manager of the one with ``await``, as a ``with`` block."""

    def __init__(
        self, portal: Portal, make: Callable[[Caller], AbstractAsyncContextManager[T]]
    ) -> None:
        self._portal = portal
        self._make = make
        self._holding: AbstractAsyncContextManager[T] | None = None  # entered, and not left
        self._entered: T | None = None

    def __repr__(self) -> str:
        is_new = self._entered is None
        return f"<{type(self).__name__}, not entered>" if is_new else repr(self._entered)

    @property
    def _aio(self) -> T:
        assert self._entered is not None, "use it inside its `with` block"
        return self._entered

    def __enter__(self) -> Self:
        async def enter(caller: Caller) -> None:
            holding = self._make(caller)
            self._entered = await holding.__aenter__()
            self._holding = holding

        try:
            self._portal.wait(enter)
            return self
        except BaseException as error:
            if not isinstance(error, M100Error):  # entered all the same, nobody is to leave it
                self._portal.soon_await(self._leave)
            raise

    def __exit__(self, *error: Any) -> None:
        try:
            self._portal.wait(lambda _: self._leave(*error))
        except BaseException:
            self._portal.soon_await(self._leave)  # a signal may raise before it was asked for
            raise

    async def _leave(self, *error: Any) -> None:
        holding, self._holding = self._holding, None
        if holding is not None:
            await holding.__aexit__(*error or (None, None, None))


class Hold(_Block[setpoints.Hold]):
    """A setpoint that is being sent while a ``with`` block runs; :meth:`set` renews it."""

    set = calls(setpoints.Hold.set)


class GimbalRates(_Block[payload.GimbalRates]):
    """Angular rates that are repeated while a ``with`` block runs; :meth:`set` replaces them."""

    set = calls(payload.GimbalRates.set)


async def _asked(
    caller: Caller, source: Callable[[Tick], Setpoint | None], ticks: pacing.Ticker
) -> AsyncIterator[Setpoint]:
    """At each tick what ``source`` says in the thread of the caller, until that is None."""
    async for tick in ticks:
        wanted = await caller.ask(source, tick)
        if wanted is None:
            return
        yield wanted


# -- missions: ``with control.waypoint_mission(plan) as mission:`` --------------------------------


class MissionFlight(_Block[Any]):
    """A mission while a ``with`` block runs; ``for event in mission:`` tells of it.

    The error that ends the control block is raised by the call that waits, or by the next one.
    **It flies on when this program is killed, loses its power or its cable.**
    """

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> MissionEvent:
        try:
            event: MissionEvent = self._portal.wait(lambda _: self._aio.__anext__())
        except StopAsyncIteration:
            raise StopIteration from None
        return event

    is_over = Reads[bool](mission_guard.MissionFlight.is_over)
    is_paused = Reads[bool](mission_guard.MissionFlight.is_paused)
    is_unstopped = Reads[bool](mission_guard.MissionFlight.is_unstopped)
    pause = waits(mission_guard.MissionFlight.pause)
    resume = waits(mission_guard.MissionFlight.resume)
    stop = waits(mission_guard.MissionFlight.stop)
    detach = calls(mission_guard.MissionFlight.detach)


class WaypointFlight(MissionFlight):
    """A waypoint mission: ``with control.waypoint_mission(plan) as mission:``."""

    @property
    def plan(self) -> WaypointPlan:
        """The plan that it flies."""
        plan: WaypointPlan = self._aio.plan
        return plan

    index = Reads[int | None](waypoint.WaypointFlight.index)
    estimated_time = Reads[float | None](waypoint.WaypointFlight.estimated_time)
    set_speed = waits(waypoint.WaypointFlight.set_speed)


class HotpointFlight(MissionFlight):
    """A circle around a place: ``with control.hotpoint(...) as circle:``."""

    distance_m = Reads[float | None](hotpoint.HotpointFlight.distance_m)
    rate_deg_s = Reads[float | None](hotpoint.HotpointFlight.rate_deg_s)
    largest_radius = Reads[float | None](hotpoint.HotpointFlight.largest_radius)
    set_radius = waits(hotpoint.HotpointFlight.set_radius)
    set_rate = waits(hotpoint.HotpointFlight.set_rate)
    reset_heading = waits(hotpoint.HotpointFlight.reset_heading)


class FollowFlight(MissionFlight):
    """Following a target: ``with control.follow_target(first) as mission:``."""

    target = Reads[Target | None](hotpoint.FollowFlight.target)
    set_target = calls(hotpoint.FollowFlight.set_target)


# -- the block -------------------------------------------------------------------------------------


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

    @property
    def is_flying(self) -> bool:
        """Whether control was asked for, and nothing has ended it."""
        return bool(self._aio.is_flying)

    @property
    def is_stopping(self) -> bool:
        """Whether its stop path runs."""
        return bool(self._aio.is_stopping)

    @property
    def is_over(self) -> bool:
        """Whether the stop path has ended."""
        return bool(self._aio.is_over)

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
        how = {"rate_hz": rate_hz, "lifetime": lifetime, "allow_long_lifetime": allow_long_lifetime}
        self._portal.wait(
            lambda caller: self._aio.follow(_asked(caller, source, self._aio.ticks(rate_hz)), **how)
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
