"""The mission: its plan, and how far it is."""

from __future__ import annotations

from dataclasses import dataclass

from m100link.apps.station.console.view.inputs import Inputs
from m100link.apps.station.console.view.units import Quantity
from m100link.apps.station.console.view.words import Text, say
from m100link.missions.plan import WaypointPlan

__all__ = ["MissionView", "mission_of", "name_of", "progress", "summary"]

_NAMES = {
    "": "mission.unknown",
    "no mission": "mission.none",
    "waypoint mission": "mission.waypoint",
    "hotpoint": "mission.hotpoint",
    "follow mission": "mission.follow",
}


@dataclass(frozen=True, slots=True)
class MissionView:
    """What is known of the mission.

    Attributes:
        plan: The plan in one line.
        state: What flies.
        part: How much of it is flown, 0 to 1.
    """

    plan: Text
    state: Text
    part: float


def mission_of(inputs: Inputs) -> MissionView:
    """The mission as it is now."""
    plan, state = inputs.plan, inputs.state
    text, part = progress(plan, state.mission, state.mission_index)
    return MissionView(summary(plan), text, part)


def summary(plan: WaypointPlan | None) -> Text:
    """A plan in one line."""
    if plan is None:
        return say("mission.no_plan")
    low, high = map(Quantity.length, plan.heights)
    return say(
        "mission.plan",
        count=len(plan.waypoints),
        length=Quantity.length(plan.length_m),
        speed=Quantity.speed(plan.speed),
        low=low,
        high=high,
    )


def name_of(mission: str) -> Text:
    """What an agent calls a mission, to be said."""
    key = _NAMES.get(mission)
    return Text(key) if key is not None else say("mission.other", name=mission)


def progress(plan: WaypointPlan | None, mission: str, index: int) -> tuple[Text, float]:
    """What flies, to be said, and how much of it is flown, as a part of 1."""
    what = name_of(mission)
    if mission in ("", "no mission") or index < 0:
        return what, 0.0
    if plan is None or index >= len(plan.waypoints):
        return say("mission.to", what=what, number=index + 1), 0.0
    count = len(plan.waypoints)
    return say("mission.to_of", what=what, number=index + 1, count=count), index / count
