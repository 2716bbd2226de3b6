"""Reading back the plan that the aircraft has stored (facts W21)."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from m100link.errors import MissionRefused
from m100link.flight.missions.refusal import mission_refused
from m100link.missions.plan import WaypointPlan
from m100link.protocol.codes import MissionCode
from m100link.protocol.commands.waypoint import WaypointDownloadMission, WaypointDownloadPoint

if TYPE_CHECKING:
    from m100link.link.requests import Requests

__all__ = ["download_waypoint_plan"]

_TIMEOUT_S, _TRIES = 0.5, 6
_WHEN = "download it while it flies: the aircraft forgets a mission at its end"


async def download_waypoint_plan(requests: Requests) -> WaypointPlan:
    """See :meth:`m100link.Aircraft.download_waypoint_plan`."""
    what = "the download of the waypoint mission"
    execute = partial(requests.execute, timeout=_TIMEOUT_S, tries=_TRIES, refusal=MissionRefused)
    head = await execute(WaypointDownloadMission())
    is_empty = head.code is MissionCode.SUCCESS and head.mission.count == 0
    if is_empty or head.code is MissionCode.NO_MISSION:
        raise mission_refused(what, MissionCode.NO_MISSION, remedy=_WHEN)
    if head.code is not MissionCode.SUCCESS:
        raise mission_refused(what, head.code)
    points = []
    for index in range(head.mission.count):
        answer = await execute(WaypointDownloadPoint(index))
        if answer.code is not MissionCode.SUCCESS:
            raise mission_refused(what, answer.code, point=index)
        points.append(answer.point)
    return WaypointPlan.from_wire(head.mission, points)
