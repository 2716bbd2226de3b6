"""The mission: its plan, and how far it is."""

from __future__ import annotations

from dataclasses import dataclass

from m100link.missions.plan import WaypointPlan
from m100link.station.console.view.inputs import Inputs

__all__ = ["MissionView", "mission_of", "progress", "summary"]


@dataclass(frozen=True, slots=True)
class MissionView:
    """What is known of the mission.

    Attributes:
        plan: The plan in one line.
        state: What flies, in words.
        part: How much of it is flown, 0 to 1.
    """

    plan: str
    state: str
    part: float


def mission_of(inputs: Inputs) -> MissionView:
    """The mission as it is now."""
    plan, state = inputs.plan, inputs.state
    text, part = progress(plan, state.mission, state.mission_index)
    return MissionView(summary(plan), text, part)


def summary(plan: WaypointPlan | None) -> str:
    """A plan in one line."""
    if plan is None:
        return "no plan"
    lowest, highest = plan.heights
    return (
        f"{len(plan.waypoints)} waypoints, {plan.length_m:.0f} m at {plan.speed:g} m/s, "
        f"height {lowest:.0f} to {highest:.0f} m"
    )


def progress(plan: WaypointPlan | None, mission: str, index: int) -> tuple[str, float]:
    """What flies, in words and as a part of 1."""
    if mission in ("", "no mission"):
        return mission or "nothing is known of missions", 0.0
    if index < 0:
        return mission, 0.0
    if plan is None or index >= len(plan.waypoints):
        return f"{mission}: to waypoint {index + 1}", 0.0
    count = len(plan.waypoints)
    return f"{mission}: to waypoint {index + 1} of {count}", index / count
