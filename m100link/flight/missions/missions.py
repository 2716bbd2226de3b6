"""What a program can do with missions: the methods of :class:`m100link.Control` that begin them."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from m100link.flight.mission_state import MissionKind
from m100link.flight.missions.deck import Deck
from m100link.flight.missions.keeper import MissionKeeper
from m100link.flight.missions.waypoint import UploadListener, WaypointFlight
from m100link.missions.plan import WaypointPlan

__all__ = ["Missions"]


class Missions:
    """Missions of one control block.

    Args:
        deck: What they stand on.
        keeper: One at a time.
        make_way: Lets nothing else steer.
        take_off: The task of the control block.
    """

    def __init__(
        self,
        deck: Deck,
        keeper: MissionKeeper,
        *,
        make_way: Callable[[str], Awaitable[None]],
        take_off: Callable[[], Awaitable[None]],
    ) -> None:
        self._deck = deck
        self._keeper = keeper
        self._make_way = make_way
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
                uploaded. Without it a mission on the ground is refused.
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
            MissionAborted: While it flew the aircraft broke it off, with its reason.
        """
        return WaypointFlight(
            self._deck,
            self._keeper,
            plan,
            make_way=self._make_way,
            take_off=self._take_off if take_off else None,
            allow_far=allow_far,
            progress=progress,
        )

    async def stop_mission(self) -> MissionKind:
        """Stop whatever mission flies, whoever started it: the aircraft hovers.

        A mission of a phone, or of a program that is gone, is found as
        :attr:`m100link.Aircraft.mission`. Where nothing is pushed, every kind is told to stop.

        Returns:
            The kind that was stopped; :attr:`MissionKind.NONE` when the aircraft knows of none.

        Raises:
            MissionRefused: With the aircraft's reason.
            NoAuthority, AckTimeout, LinkError: See each class.
        """
        self._deck.block.require_flying("the stop of a mission")
        with self._deck.block.waiting("stop_mission"):
            return await self._keeper.stop_any()

    async def pause_mission(self) -> MissionKind:
        """Pause whatever mission flies, whoever started it. Raises as :meth:`stop_mission`."""
        self._deck.block.require_flying("the pause of a mission")
        with self._deck.block.waiting("pause_mission"):
            return await self._keeper.order_any("pause")

    async def resume_mission(self) -> MissionKind:
        """Let it go on. Raises as :meth:`stop_mission`."""
        self._deck.block.require_flying("the resumption of a mission")
        with self._deck.block.waiting("resume_mission"):
            return await self._keeper.order_any("resumption")

    def detach_mission(self) -> MissionKind:
        """Leave whatever mission flies in flight when this control block ends.

        Authority is not given back then: that would break it off. See
        :meth:`WaypointFlight.detach`.

        Raises:
            UsageError: No mission flies, as far as the aircraft tells.
        """
        self._deck.block.require_flying("detaching a mission")
        return self._keeper.detach_any()
