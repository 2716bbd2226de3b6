"""A plan of waypoints that the aircraft flies by itself, for the time of a block."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from functools import partial
from typing import TYPE_CHECKING

from m100link.errors import BadAck, MissionRefused, UsageError
from m100link.flight.mission_state import MissionKind
from m100link.flight.missions.context import (
    MissionContext,
    WaypointTracker,
    check_battery,
    check_plan,
    require_airborne,
)
from m100link.flight.missions.events import Uploaded, Uploading, mission_refused
from m100link.flight.missions.mission_guard import MissionFlight, MissionGuard
from m100link.flight.missions.mission_session import MissionSession
from m100link.missions.plan import OnRCLoss, WaypointPlan
from m100link.protocol.codes import MissionCode
from m100link.protocol.commands.waypoint import (
    WaypointDownloadMission,
    WaypointDownloadPoint,
    WaypointMission,
    WaypointPoint,
    WaypointSetIdleSpeed,
    WaypointStartStop,
)

if TYPE_CHECKING:
    from m100link.link.requests import Requests

__all__ = ["WaypointFlight"]

_logger = logging.getLogger(__name__)


UploadListener = Callable[[Uploading], None]  # gets each waypoint that the aircraft has taken

_TIMEOUT_S, _TRIES = 0.5, 6  # of what may be sent again at will: nothing flies by it
_UPLOADED_S = 0.3  # in which the event that follows the last waypoint has come, if any comes

_OF_ONE_POINT = frozenset(
    {
        MissionCode.WRONG_INDEX,
        MissionCode.BAD_POINT,
        MissionCode.INDEX_TOO_LARGE,
        MissionCode.BAD_ACTION,
    }
)
"""Refusals of the newest waypoint; that of the last one may concern the whole."""


class WaypointFlight(MissionFlight):
    """A waypoint mission: ``async with control.waypoint_mission(plan) as mission``.

    Entering checks, uploads and starts it; the rest is that of :class:`m100link.MissionFlight`.
    """

    _FIRST = WaypointMission

    def __init__(
        self,
        context: MissionContext,
        guard: MissionGuard,
        plan: WaypointPlan,
        *,
        take_off: Callable[[], Awaitable[None]] | None,
        allow_far: bool,
        progress: UploadListener | None,
    ) -> None:
        self._track = WaypointTracker(plan)
        run = MissionSession(
            context,
            MissionKind.WAYPOINT,
            self._track,
            flies_without_rc=plan.on_rc_loss is OnRCLoss.CONTINUE,
        )
        super().__init__(context, guard, run)
        self._take_off = take_off
        self._allow_far = allow_far
        self._progress = progress
        self.plan = plan

    def __repr__(self) -> str:
        return f"<WaypointFlight {self._run.state.name.lower()}, to waypoint {self._track.index}>"

    async def _begin(self) -> None:
        is_on_ground = await require_airborne(
            self._context, "the waypoint mission", may_take_off=self._take_off is not None
        )
        guards, state = self._context.guards, self._context.commander.state
        check_plan(guards, state, self.plan, allow_far=self._allow_far)
        check_battery(guards, state, self.plan)
        # Uploaded on the ground: a plan that the aircraft refuses costs no take-off.
        await self._upload()
        if is_on_ground and self._take_off is not None:
            self._run.require_wanted()
            await self._take_off()
        await self._context.make_way(f"the {self._run.name}")
        await self._run.start(WaypointStartStop(stop=0), int)

    async def _upload(self) -> None:
        """Send the plan: one that is refused here, as ``MissionRefused``, never flew."""
        # Before the first byte: the event of the upload comes on the heels of the last waypoint.
        self._run.listen()
        mission, points = self.plan.to_wire()
        requests = self._context.commander.requests
        code = await requests.execute(
            mission, timeout=_TIMEOUT_S, tries=_TRIES, refusal=MissionRefused
        )
        if code is not MissionCode.SUCCESS:
            raise mission_refused("the waypoint mission", code)
        for point in points:
            await self._upload_point(point, len(points))
        deadline = self._context.commander.link.loop.time() + _UPLOADED_S
        while self._track.estimated_time is None:
            rest = deadline - self._context.commander.link.loop.time()
            if rest <= 0:
                break
            await asyncio.sleep(min(rest, 0.02))
        self._run.events.add(Uploaded(len(points), self._track.estimated_time))
        _logger.info("waypoint mission uploaded: %d waypoints", len(points))

    async def _upload_point(self, point: WaypointPoint, total: int) -> None:
        requests = self._context.commander.requests
        answer = await requests.execute(
            point, timeout=_TIMEOUT_S, tries=_TRIES, refusal=MissionRefused
        )
        if answer.code is not MissionCode.SUCCESS:
            is_whole = point.index == total - 1 and answer.code not in _OF_ONE_POINT
            raise mission_refused(
                "the waypoint mission" if is_whole else "the upload of the waypoint mission",
                answer.code,
                point=None if is_whole else point.index,
            )
        if answer.index != point.index:
            raise BadAck(
                f"waypoint {point.index} was acknowledged as waypoint {answer.index}",
                command=point.NAME,
                remedy="upload the mission again",
            )
        if self._progress is not None:
            self._progress(Uploading(point.index, total))

    # -- while it flies --------------------------------------------------------------------------

    @property
    def index(self) -> int | None:
        """Waypoint that it flies to, counted from 0; None while nobody knows."""
        return self._track.index

    @property
    def estimated_time(self) -> float | None:
        """Seconds that the aircraft expects it to take; None if it did not say."""
        return self._track.estimated_time

    async def set_speed(self, speed: float) -> float:
        """Change the speed along the way, from here on.

        Args:
            speed: m/s, up to the plan's ``max_speed``; below 0 it flies the way backwards.

        Returns:
            The speed in force, as the aircraft says.

        Raises:
            UsageError: Beyond ``max_speed``.
            GuardRefused: Beyond the envelope.
            MissionRefused, MissionAborted, AckTimeout: As :meth:`pause`.
        """
        self._run.require_in_the_air("another speed")
        if not abs(speed) <= self.plan.max_speed:
            raise UsageError(
                f"a speed of {speed:g} m/s is beyond the plan's max_speed",
                remedy=f"stay within {self.plan.max_speed:g} m/s",
            )
        self._context.guards.check_target("the waypoint mission", speed=abs(speed))
        with self._context.block.waiting(self._run.name):
            answer = await self._context.commander.requests.execute(
                WaypointSetIdleSpeed(speed), timeout=0.5, tries=3, refusal=MissionRefused
            )
        if answer.code is not MissionCode.SUCCESS:
            raise mission_refused("another speed of the waypoint mission", answer.code)
        return answer.idle_speed


# -- reading back the plan that the aircraft has stored --------------------------------------------


_WHEN = "download it while it flies: the aircraft forgets a mission at its end"


async def download_waypoint_plan(requests: Requests) -> WaypointPlan:
    """See :meth:`m100link.Aircraft.download_waypoint_plan`."""
    what = "the download of the waypoint mission"
    execute = partial(requests.execute, timeout=_TIMEOUT_S, tries=_TRIES, refusal=MissionRefused)
    head = await execute(WaypointDownloadMission())
    is_empty = head.code is MissionCode.SUCCESS and head.mission.count == 0
    code = MissionCode.NO_MISSION if is_empty else head.code
    if code is not MissionCode.SUCCESS:
        raise mission_refused(what, code, remedy=_WHEN if code is MissionCode.NO_MISSION else "")
    points = []
    for index in range(head.mission.count):
        answer = await execute(WaypointDownloadPoint(index))
        if answer.code is not MissionCode.SUCCESS:
            raise mission_refused(what, answer.code, point=index)
        points.append(answer.point)
    return WaypointPlan.from_wire(head.mission, points)
