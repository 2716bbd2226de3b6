"""Missions for programs without ``await``: ``with control.waypoint_mission(plan) as mission:``."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import Self

from m100link.flight.missions import waypoint
from m100link.flight.missions.events import MissionEvent
from m100link.missions.plan import WaypointPlan
from m100link.sync.portal import Caller, Portal

__all__ = ["WaypointFlight"]


class WaypointFlight:
    """A waypoint mission while a ``with`` block runs; ``for event in mission:`` tells of it.

    What ends the control block is raised by the call that waits, or by the next one. **It flies on
    when this program is killed, loses its power or its cable.**
    """

    def __init__(self, portal: Portal, make: Callable[[Caller], waypoint.WaypointFlight]) -> None:
        self._portal = portal
        self._make = make
        self._made: waypoint.WaypointFlight | None = None  # once it was entered

    def __repr__(self) -> str:
        return "<WaypointFlight, not entered>" if self._made is None else repr(self._made)

    @property
    def _flight(self) -> waypoint.WaypointFlight:
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
    def plan(self) -> WaypointPlan:
        """What is flown."""
        return self._flight.plan

    @property
    def is_over(self) -> bool:
        """Whether it does not fly any more, or the program let go of it."""
        return self._flight.is_over

    @property
    def is_paused(self) -> bool:
        """Whether it hovers by order of the program."""
        return self._flight.is_paused

    @property
    def index(self) -> int | None:
        """Waypoint that it flies to, counted from 0; None while nobody knows."""
        return self._flight.index

    @property
    def estimated_time(self) -> float | None:
        """Seconds that the aircraft expects it to take; None if it did not say."""
        return self._flight.estimated_time

    def pause(self) -> None:
        """See :meth:`m100link.WaypointFlight.pause`."""
        self._portal.wait(lambda _: self._flight.pause())

    def resume(self) -> None:
        """See :meth:`m100link.WaypointFlight.resume`."""
        self._portal.wait(lambda _: self._flight.resume())

    def stop(self) -> None:
        """See :meth:`m100link.WaypointFlight.stop`."""
        self._portal.wait(lambda _: self._flight.stop())

    def set_speed(self, speed: float) -> float:
        """See :meth:`m100link.WaypointFlight.set_speed`."""
        return self._portal.wait(lambda _: self._flight.set_speed(speed))

    def detach(self) -> None:
        """See :meth:`m100link.WaypointFlight.detach`: the aircraft flies on."""
        self._portal.call(self._flight.detach)
