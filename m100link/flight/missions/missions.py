"""Missions of a program: the methods of :class:`m100link.Control` that begin them."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable

from m100link.errors import UsageError
from m100link.flight.mission_state import MissionKind
from m100link.flight.missions.context import MissionContext
from m100link.flight.missions.hotpoint import (
    CircleHeading,
    CircleStart,
    FollowFlight,
    HotpointFlight,
    TargetSource,
)
from m100link.flight.missions.mission_guard import MissionGuard
from m100link.flight.missions.waypoint import UploadListener, WaypointFlight
from m100link.missions.plan import WaypointPlan
from m100link.protocol.commands.hotpoint import HotpointStart


class Missions:
    """Missions of one control block."""

    def __init__(
        self,
        context: MissionContext,  # what they stand on
        guard: MissionGuard,  # one at a time
        take_off: Callable[[], Awaitable[None]],  # the task of the control block
    ) -> None:
        self._context = context
        self._guard = guard
        self._take_off = take_off

    def waypoint_mission(
        self,
        plan: WaypointPlan,
        *,
        take_off: bool = False,
        allow_far: bool = False,
        progress: UploadListener | None = None,
    ) -> WaypointFlight:
        """Let the aircraft fly a plan of waypoints by itself, for the time of a block.

        ::

            async with control.waypoint_mission(plan) as mission:
                async for event in mission:
                    print(event)

        Entering asks the guards about the whole plan, uploads it and starts it. While it flies,
        everything else that moves the aircraft raises :class:`MissionRunning`. Leaving stops it if
        it still flies, and the aircraft hovers. **It flies on when this program is killed, loses
        its power or its cable**: only the pilot, its own end or a stop ends it.

        Args:
            plan: The waypoints.
            take_off: Take off first when the aircraft stands on the ground, once the plan is
                uploaded, as a plan with ``take_off`` does. Without either a mission on the ground
                is refused.
            allow_far: Let the first waypoint be more than 500 m away.
            progress: Called for each waypoint that the aircraft has taken.

        Raises:
            GuardRefused: The plan leaves the envelope, begins too far away, or battery or GPS do
                not allow it: nothing was sent. Or a guard ended it, and the control block, in
                flight.
            CommandNotSupported: Firmware before 3.1; nothing was sent.
            MissionRefused: The aircraft's reason, with the waypoint; nothing flies.
            MissionRunning, NoAuthority, UsageError, TelemetryStalled: Another mission flies; no
                authority; on the ground; the flight status is unknown.
            AckTimeout, LinkError: See each class. A start that may have been heard is stopped.
            NotObserved: It was stopped before it began.
            MissionAborted: While it flew the aircraft broke it off, with its reason.
        """
        if not isinstance(plan, WaypointPlan):
            raise UsageError(
                f"the plan is {plan!r}",
                remedy='a WaypointPlan: WaypointPlan.read("plan.json") reads a file',
            )
        return WaypointFlight(
            self._context,
            self._guard,
            plan,
            take_off=self._take_off if take_off or plan.take_off else None,
            allow_far=allow_far,
            progress=progress,
        )

    def hotpoint(
        self,
        *,
        latitude_deg: float,
        longitude_deg: float,
        height: float,
        radius: float,
        rate_deg_s: float,
        clockwise: bool = True,
        start: CircleStart = CircleStart.NEAREST,
        heading: CircleHeading = CircleHeading.TO_CENTRE,
        allow_far: bool = False,
    ) -> HotpointFlight:
        """Let the aircraft circle around a place by itself: an orbit, DJI's hotpoint.

        ::

            async with control.hotpoint(
                latitude_deg=52.1, longitude_deg=4.31, height=20, radius=30, rate_deg_s=10
            ) as circle:
                await asyncio.sleep(30)
                await circle.set_radius(40)

        It flies to the circle at that height and then along it until it is stopped; leaving the
        block does that. **It flies on when this program is killed.** While it flies, everything
        else that moves the aircraft raises :class:`MissionRunning`.

        Args:
            latitude_deg: Of the centre, WGS 84.
            longitude_deg: Of the centre, WGS 84.
            height: 5 to 500 m **above the take-off point**, and not above the sea, which
                ``aircraft.state`` tells as well.
            radius: 5 to 500 m.
            rate_deg_s: 0 to 30 °/s, and no more than 10 m/s along the circle: 573 divided by the
                radius.
            clockwise: Direction, seen from above.
            start: Where the circle is entered.
            heading: Where the nose points.
            allow_far: Let the centre be more than 500 m away.

        Raises:
            UsageError: A value out of range, or too fast for the radius; on the ground.
            GuardRefused, CommandNotSupported, MissionRefused, MissionRunning, NoAuthority,
            TelemetryStalled, AckTimeout, MissionAborted, NotObserved: See :meth:`waypoint_mission`.
        """
        request = HotpointStart(
            latitude=math.radians(latitude_deg),
            longitude=math.radians(longitude_deg),
            altitude=height,
            radius=radius,
            angular_rate=rate_deg_s,
            clockwise=int(clockwise),
            start_point=int(start),
            yaw_mode=int(heading),
        )
        return HotpointFlight(self._context, self._guard, request, allow_far=allow_far)

    def follow_target(
        self, source: TargetSource, *, face_target: bool = True, allow_far: bool = False
    ) -> FollowFlight:
        """Let the aircraft follow a target by itself, at the distance that it has at the beginning.

        ::

            async with control.follow_target(targets()) as mission:  # an async generator
                async for event in mission:
                    print(event)

        It is stopped when the source ends, and when the block is left; the aircraft hovers. When
        nothing new comes for 6 s, the aircraft waits where it is. ``Control.follow`` is another
        thing: it sends setpoints.

        Args:
            source: Targets as they are known, of which ten a second are taken at most; or the first
                one, to be renewed by :meth:`m100link.FollowFlight.set_target`.
            face_target: The nose points to the target; otherwise the pilot's stick turns it.
            allow_far: Let the first target be more than 500 m away.

        Raises:
            UsageError: Below 5 m; the source is empty, a target is not a place, or jumps by more
                than 200 m.
            GuardRefused, CommandNotSupported, MissionRefused, MissionRunning, NoAuthority,
            TelemetryStalled, AckTimeout, MissionAborted, NotObserved: See :meth:`waypoint_mission`.
        """
        return FollowFlight(
            self._context, self._guard, source, face_target=face_target, allow_far=allow_far
        )

    async def stop_mission(self) -> MissionKind:
        """Stop any mission that flies, also somebody else's: the aircraft hovers.

        :attr:`m100link.Aircraft.mission` shows a mission of a phone, or of a program that is gone.
        Where the aircraft pushes nothing, it gets a stop for every kind.

        Returns:
            The kind that was stopped; :attr:`MissionKind.NONE` when the aircraft knows of none.

        Raises:
            MissionRefused: With the aircraft's reason.
            NotObserved: It took the stop, and reports that the mission flies on.
            NoAuthority, CommandNotSupported, AckTimeout, LinkError: See each class.
        """
        self._context.block.require_flying("the stop of a mission")
        with self._context.block.waiting("stop_mission"):
            return await self._guard.stopped_any()

    async def pause_mission(self) -> MissionKind:
        """Pause any mission that flies, also somebody else's: done when it is seen to hover.

        Raises as :meth:`stop_mission`; ``UsageError``: none flies; ``NotObserved``: it flies on.
        """
        self._context.block.require_flying("the pause of a mission")
        with self._context.block.waiting("pause_mission"):
            return await self._guard.order_any("pause")

    async def resume_mission(self) -> MissionKind:
        """Let it go on. Raises as :meth:`stop_mission`; ``UsageError``: none flies."""
        self._context.block.require_flying("the resumption of a mission")
        with self._context.block.waiting("resume_mission"):
            return await self._guard.order_any("resumption")

    def detach_mission(self) -> MissionKind:
        """Leave whatever mission flies in flight when this control block ends.

        Authority is not given back then: that would break it off. See
        :meth:`m100link.MissionFlight.detach`.

        Raises:
            UsageError, NoAuthority: No mission flies as far as it tells, or authority is not held.
        """
        self._context.block.require_flying("detaching a mission")
        return self._guard.detach_any()
