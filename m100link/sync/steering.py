"""Ticks, holds and missions without ``await``: each is a ``with`` block, or iterated."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager
from types import TracebackType
from typing import Generic, Self, TypeVar

from m100link.aircraft import payload
from m100link.flight import pacing, setpoints
from m100link.flight.missions import hotpoint, mission_guard, waypoint
from m100link.flight.missions.events import MissionEvent
from m100link.flight.missions.hotpoint import Target
from m100link.flight.pacing import Tick
from m100link.missions.plan import WaypointPlan
from m100link.protocol.setpoint import Setpoint
from m100link.sync.portal import Caller, Portal


class Ticks:
    """Ticks at a steady rate: ``for tick in control.ticks(20):``."""

    def __init__(self, portal: Portal, ticker: pacing.Ticker) -> None:
        self._portal = portal
        self._ticker = ticker

    @property
    def period(self) -> float:
        """Seconds between ticks."""
        return self._ticker.period

    @property
    def missed(self) -> int:
        """Deadlines skipped in all."""
        return self._ticker.missed

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Tick:
        return self._portal.wait(lambda _: self._ticker.__anext__())


class Hold:
    """A setpoint that is being sent while a ``with`` block runs; :meth:`set` renews it."""

    def __init__(
        self, portal: Portal, holding: AbstractAsyncContextManager[setpoints.Hold]
    ) -> None:
        self._portal = portal
        self._holding = holding
        self._hold: setpoints.Hold | None = None  # while the block runs

    def set(self, setpoint: Setpoint) -> None:
        """Send this setpoint from now on, for another lifetime.

        Raises:
            NoAuthority, GuardRefused, BadSetpoint: See :meth:`Control.send`.
        """
        assert self._hold is not None, "use it inside its `with` block"
        self._portal.call(self._hold.set, setpoint)

    def __enter__(self) -> Self:
        self._hold = self._portal.wait(lambda _: self._holding.__aenter__())
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._portal.wait(lambda _: self._holding.__aexit__(exc_type, exc, traceback))


class GimbalRates:
    """Angular rates that are repeated while a ``with`` block runs; :meth:`set` replaces them."""

    def __init__(
        self, portal: Portal, holding: AbstractAsyncContextManager[payload.GimbalRates]
    ) -> None:
        self._portal = portal
        self._holding = holding
        self._rates: payload.GimbalRates | None = None  # while the block runs

    def set(self, *, yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> None:
        """Turn at these rates from the next repetition on, within 0.1 s.

        Raises:
            UsageError: Beyond 180 degrees per second, or not a number.
        """
        assert self._rates is not None, "use it inside its `with` block"
        self._portal.call(self._rates.set, yaw=yaw, pitch=pitch, roll=roll)

    def __enter__(self) -> Self:
        self._rates = self._portal.wait(lambda _: self._holding.__aenter__())
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._portal.wait(lambda _: self._holding.__aexit__(exc_type, exc, traceback))


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


F = TypeVar("F", bound=mission_guard.MissionFlight)


class MissionFlight(Generic[F]):
    """A mission while a ``with`` block runs; ``for event in mission:`` tells of it.

    The error that ends the control block is raised by the call that waits, or by the next one.
    **It flies on when this program is killed, loses its power or its cable.**
    """

    def __init__(self, portal: Portal, make: Callable[[Caller], F]) -> None:
        self._portal = portal
        self._make = make
        self._made: F | None = None  # once it was entered

    def __repr__(self) -> str:
        return f"<{type(self).__name__}, not entered>" if self._made is None else repr(self._made)

    @property
    def _flight(self) -> F:
        assert self._made is not None, "use it inside its `with` block"
        return self._made

    def __enter__(self) -> Self:
        async def enter(caller: Caller) -> None:
            self._made = self._make(caller)
            await self._made.__aenter__()

        self._portal.wait(enter)
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._portal.wait(lambda _: self._flight.__aexit__(exc_type, exc, traceback))

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> MissionEvent:
        try:
            return self._portal.wait(lambda _: self._flight.__anext__())
        except StopAsyncIteration:
            raise StopIteration from None

    @property
    def is_over(self) -> bool:
        """Whether it does not fly any more, or the program let go of it."""
        return self._flight.is_over

    @property
    def is_paused(self) -> bool:
        """Whether it hovers by order of the program."""
        return self._flight.is_paused

    def pause(self) -> None:
        """See :meth:`m100link.MissionFlight.pause`."""
        self._portal.wait(lambda _: self._flight.pause())

    def resume(self) -> None:
        """See :meth:`m100link.MissionFlight.resume`."""
        self._portal.wait(lambda _: self._flight.resume())

    def stop(self) -> None:
        """See :meth:`m100link.MissionFlight.stop`."""
        self._portal.wait(lambda _: self._flight.stop())

    def detach(self) -> None:
        """See :meth:`m100link.MissionFlight.detach`: the aircraft flies on."""
        self._portal.call(self._flight.detach)


class WaypointFlight(MissionFlight[waypoint.WaypointFlight]):
    """A waypoint mission: ``with control.waypoint_mission(plan) as mission:``."""

    @property
    def plan(self) -> WaypointPlan:
        """The plan that it flies."""
        return self._flight.plan

    @property
    def index(self) -> int | None:
        """Waypoint that it flies to, counted from 0; None while nobody knows."""
        return self._flight.index

    @property
    def estimated_time(self) -> float | None:
        """Seconds that the aircraft expects it to take; None if it did not say."""
        return self._flight.estimated_time

    def set_speed(self, speed: float) -> float:
        """See :meth:`m100link.WaypointFlight.set_speed`."""
        return self._portal.wait(lambda _: self._flight.set_speed(speed))


class HotpointFlight(MissionFlight[hotpoint.HotpointFlight]):
    """A circle around a place: ``with control.hotpoint(...) as circle:``."""

    @property
    def distance_m(self) -> float | None:
        """Present distance from the centre as the aircraft says, m; None before it did."""
        return self._flight.distance_m

    @property
    def rate_deg_s(self) -> float | None:
        """Present angular rate as the aircraft says, °/s; None before it did."""
        return self._flight.rate_deg_s

    @property
    def largest_radius(self) -> float | None:
        """The largest radius that the aircraft allows here, m; None before the start."""
        return self._flight.largest_radius

    def set_radius(self, radius: float, *, wait: bool = True, timeout: float = 30.0) -> None:
        """See :meth:`m100link.HotpointFlight.set_radius`."""
        self._portal.wait(lambda _: self._flight.set_radius(radius, wait=wait, timeout=timeout))

    def set_rate(
        self,
        rate_deg_s: float,
        *,
        clockwise: bool | None = None,
        wait: bool = True,
        timeout: float = 30.0,
    ) -> None:
        """See :meth:`m100link.HotpointFlight.set_rate`."""
        self._portal.wait(
            lambda _: self._flight.set_rate(
                rate_deg_s, clockwise=clockwise, wait=wait, timeout=timeout
            )
        )

    def reset_heading(self) -> None:
        """See :meth:`m100link.HotpointFlight.reset_heading`."""
        self._portal.wait(lambda _: self._flight.reset_heading())


class FollowFlight(MissionFlight[hotpoint.FollowFlight]):
    """Following a target: ``with control.follow_target(first) as mission:``."""

    @property
    def target(self) -> Target | None:
        """The newest target that was sent."""
        return self._flight.target

    def set_target(self, target: Target) -> bool:
        """See :meth:`m100link.FollowFlight.set_target`."""
        return self._portal.call(self._flight.set_target, target)
