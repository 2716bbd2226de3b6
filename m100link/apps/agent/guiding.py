"""Flying to where an operator points: one at a time, and the newest wins."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from m100link.apps.agent.background import BackgroundTasks
from m100link.apps.agent.guided import (
    ChangeHeading,
    ChangeHeight,
    FlyAround,
    FlyTo,
    GuidedFlight,
    GuidedOrder,
    name_of,
)
from m100link.apps.agent.journal import Journal
from m100link.apps.agent.messages import Limits
from m100link.apps.agent.preview import preview
from m100link.errors import M100Error, NotObserved
from m100link.flight.control import Control
from m100link.flight.foresight import (
    APPROACH_M_S,
    frame_at,
    seconds_around,
    seconds_climbing,
    seconds_straight,
    seconds_turning,
)
from m100link.flight.guidance import GuidanceProgress

__all__ = ["Guiding"]

_PATIENCE = 3.0  # times what it was thought to take, until it gives up
_PATIENCE_S = 30.0


@dataclass(slots=True, eq=False)
class _Flight:
    """One of them.

    Attributes:
        order: What was asked for.
        accepted: Called when it has begun.
        work: The task in which it flies.
        progress: How far it is; None before it has begun.
        ended_because: Why something else ended it; empty while nothing did.
        hovers: Whether the aircraft hovers then, as far as this side decides it.
    """

    order: GuidedOrder
    accepted: Callable[[], None]
    work: asyncio.Task[None] | None = None
    progress: GuidanceProgress | None = None
    ended_because: str = ""
    hovers: bool = True


class Guiding:
    """The guided flight of one control block, if there is one.

    Args:
        control: The block.
        journal: Where it is told what happens.
        background: Where it flies.
    """

    def __init__(self, control: Control, journal: Journal, background: BackgroundTasks) -> None:
        self._control = control
        self._journal = journal
        self._background = background
        self._flight: _Flight | None = None
        # Those whose neutral may still be going out: the next one waits for them.
        self._works: set[asyncio.Task[None]] = set()

    @property
    def order(self) -> GuidedOrder | None:
        """What flies, None for nothing."""
        return None if self._flight is None else self._flight.order

    async def fly(self, order: GuidedOrder, accepted: Callable[[], None]) -> None:
        """Fly there; done when it is there. What flew before ends.

        Args:
            order: What is asked for.
            accepted: Called when it has begun.

        Raises:
            NotObserved: Something else ended it, or it did not arrive in time.
            GuardRefused, NoAuthority, TelemetryStalled, UsageError: See
                :meth:`m100link.Control.fly_to`.
        """
        self.end("another place was pointed at")
        flight = self._flight = _Flight(order, accepted)
        work = flight.work = self._background.spawn(self._run(flight), name_of(order))
        self._works.add(work)
        work.add_done_callback(self._works.discard)
        try:
            await asyncio.shield(work)
        except asyncio.CancelledError:
            if work.cancelled():
                state = ", and the aircraft hovers" if flight.hovers else ""
                why = flight.ended_because or "the agent ends"
                raise NotObserved(f"the {name_of(order)} was ended{state}: {why}") from None
            self.end("nobody waits for it")
            raise

    async def _run(self, flight: _Flight) -> None:
        name = name_of(flight.order)
        ended, level = f"{name} is done", "info"
        try:
            before = self._works - {asyncio.current_task()}
            if before:
                await asyncio.wait(before)
            await self._steer(flight)
        except M100Error as error:
            ended, level = f"{name} ended: {error.seen}", "error"
            raise
        except asyncio.CancelledError:
            ended = f"{name} ended: {flight.ended_because or 'the agent ends'}"
            raise
        finally:
            if self._flight is flight:
                self._flight = None
            if flight.progress is not None:
                self._journal.note(ended, level)

    async def _steer(self, flight: _Flight) -> None:
        control, order = self._control, flight.order

        def progress(found: GuidanceProgress) -> None:
            is_first, flight.progress = flight.progress is None, found
            if is_first:
                self._journal.note(f"{name_of(order)} begins")
                flight.accepted()

        expected = preview(order, control.state, Limits()).seconds
        timeout = _PATIENCE_S + _PATIENCE * expected
        if isinstance(order, FlyTo):
            await control.fly_to(
                latitude_deg=order.latitude_deg,
                longitude_deg=order.longitude_deg,
                height=order.height,
                yaw_deg=order.yaw_deg,
                speed=order.speed,
                timeout=timeout,
                progress=progress,
            )
        elif isinstance(order, FlyAround):
            await control.orbit(
                center_north=0.0,
                center_east=0.0,
                frame=frame_at(order.latitude_deg, order.longitude_deg),
                radius=order.radius,
                height=order.height,
                speed=order.speed,
                turns=order.turns,
                clockwise=order.clockwise,
                timeout=timeout,
                progress=progress,
                approach=lambda found: progress(
                    replace(found, heading_error_deg=360.0 * order.turns)
                ),
            )
        elif isinstance(order, ChangeHeight):
            await control.climb_to(order.height, timeout=timeout, progress=progress)
        else:
            turn = math.remainder(order.yaw_deg, 360.0)
            await control.turn_to(turn, timeout=timeout, progress=progress)

    def told(self) -> GuidedFlight | None:
        """What flies, with what remains of it; None for nothing."""
        if self._flight is None:
            return None
        order, found = self._flight.order, self._flight.progress
        place: tuple[float | None, float | None] = None, None
        if isinstance(order, FlyTo | FlyAround):
            place = order.latitude_deg, order.longitude_deg
        far, seconds = (None, None) if found is None else _left(order, found)
        return GuidedFlight(
            name_of(order),
            *place,
            height=None if isinstance(order, ChangeHeading) else order.height,
            radius=order.radius if isinstance(order, FlyAround) else 0.0,
            yaw_deg=order.yaw_deg if isinstance(order, FlyTo | ChangeHeading) else None,
            distance_m=far,
            seconds=seconds,
        )

    def end(self, why: str, *, hovers: bool = True) -> None:
        """End it: neutral goes out, the aircraft hovers. Not waited for.

        Args:
            why: For people.
            hovers: Whether it does; when control is lost somebody else flies, or nobody sees it.
        """
        flight, self._flight = self._flight, None
        if flight is not None and flight.work is not None:
            flight.ended_because, flight.hovers = why, hovers
            flight.work.cancel()

    async def ended(self) -> None:
        """Wait until nothing of it is sent any more."""
        if self._works:
            await asyncio.wait(self._works)


def _left(order: GuidedOrder, found: GuidanceProgress) -> tuple[float | None, float]:
    """Metres and seconds that remain, roughly."""
    climbing = seconds_climbing(found.height_error_m)
    if isinstance(order, FlyTo):
        return found.distance_m, max(seconds_straight(found.distance_m, order.speed), climbing)
    if isinstance(order, FlyAround):
        turns = max(0.0, found.heading_error_deg) / 360.0
        far = found.distance_m + math.tau * order.radius * turns
        there = max(seconds_straight(found.distance_m, APPROACH_M_S), climbing)
        return far, there + seconds_around(order.radius, order.speed, turns)
    if isinstance(order, ChangeHeight):
        return abs(found.height_error_m), climbing
    return None, seconds_turning(found.heading_error_deg)
