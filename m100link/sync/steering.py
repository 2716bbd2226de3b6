"""Telemetry, ticks, holds and missions without ``await``: a ``with`` block, or iterated."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager
from typing import Any, Generic, Self, TypeVar

from m100link.aircraft import payload
from m100link.errors import M100Error, TelemetryStalled
from m100link.flight import pacing, setpoints
from m100link.flight.missions import hotpoint, mission_guard, waypoint
from m100link.flight.missions.events import MissionEvent
from m100link.flight.missions.hotpoint import Target
from m100link.flight.pacing import Tick
from m100link.missions.plan import WaypointPlan
from m100link.protocol.setpoint import Setpoint
from m100link.sync.portal import Caller, Handed, Portal, Reads, calls, waits
from m100link.telemetry import subscription

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


async def asked(
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
