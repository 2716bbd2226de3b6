"""A plan on its way between an agent and its fronts."""

from __future__ import annotations

from m100link.apps.agent.messages import PlanTold
from m100link.errors import BadPlan
from m100link.missions.plan import WaypointPlan
from m100link.protocol.commands.waypoint import WaypointMission, WaypointPoint
from m100link.protocol.firmware import FIRMWARE_3_1

__all__ = ["plan_of", "told_of"]


def told_of(plan: WaypointPlan, name: str) -> PlanTold:
    """What fronts are told of a plan that somebody of that name has uploaded."""
    mission, points = plan.to_wire()
    return PlanTold(
        name, mission.value(FIRMWARE_3_1), tuple(point.value(FIRMWARE_3_1) for point in points)
    )


def plan_of(message: PlanTold) -> WaypointPlan | None:
    """The plan again; None where there is none, or none that this version can read."""
    if not message.mission:
        return None
    try:
        mission = WaypointMission.parse(message.mission, FIRMWARE_3_1)
        points = [WaypointPoint.parse(one, FIRMWARE_3_1) for one in message.points]
        return WaypointPlan.from_wire(mission, points)
    except (ValueError, BadPlan):
        return None
