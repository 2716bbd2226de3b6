"""What the Plan view says of a draft, and of what is uploaded."""

from __future__ import annotations

import math

from m100link.apps.station.console.view.draft import Checked, Draft, text_of
from m100link.apps.station.console.view.units import Kind, Quantity, Units
from m100link.apps.station.console.view.words import Text, say
from m100link.missions.plan import WaypointPlan
from m100link.missions.waypoint import Waypoint

__all__ = ["drawing", "profile_options", "row_of", "summary_of", "upload_of"]


def summary_of(draft: Draft, found: Checked) -> Text:
    """A draft in one line."""
    if not draft.points:
        return say("plan.empty")
    if found.plan is None or found.estimate is None:
        return say("plan.not_flown", count=len(draft.points))
    low, high = map(Quantity.length, found.plan.heights)
    count, length = len(draft.points), Quantity.length(found.estimate.length_m)
    if math.isinf(found.estimate.duration_s):
        return say("plan.by_stick", count=count, length=length, low=low, high=high)
    minutes, seconds = divmod(round(found.estimate.duration_s), 60)
    time, battery = f"{minutes}:{seconds:02d}", round(found.estimate.battery_percent)
    return say(
        "plan.summary",
        count=count,
        length=length,
        low=low,
        high=high,
        time=time,
        battery=battery,
    )


def upload_of(plan: WaypointPlan | None, uploaded: WaypointPlan | None, name: str) -> Text:
    """Whether start would fly what is drawn here."""
    if uploaded is None:
        return say("plan.is_not_uploaded")
    if plan is not None and as_on_the_wire(plan) == as_on_the_wire(uploaded):
        return say("plan.is_uploaded")
    return say("plan.is_another", name=name)


def as_on_the_wire(plan: WaypointPlan) -> object:
    """What the aircraft gets of it: two plans that differ in nothing else fly the same."""
    return plan.to_wire()


def row_of(number: int, point: Waypoint) -> Text:
    """A waypoint in one line."""
    actions = text_of(point.actions)
    height = Quantity.length(point.height, 1)
    return say("plan.row", number=number, height=height, actions=f", {actions}" * bool(actions))


def drawing(draft: Draft, found: Checked, chosen: int | None) -> dict[str, object]:
    """What the map draws of it."""
    return {
        "points": [
            [point.latitude_deg, point.longitude_deg, any(n.is_error for n in found.at(index))]
            for index, point in enumerate(draft.points)
        ],
        "area": [list(corner) for corner in draft.area],
        "chosen": chosen,
    }


def profile_options(points: list[tuple[float, float]], units: Units) -> dict[str, object]:
    """The chart of heights by distance, as ECharts takes it.

    Args:
        points: Way and height, m.
        units: What they are drawn in.
    """
    data = [[round(units.convert(one, Kind.LENGTH), 1) for one in at] for at in points]
    axis = {
        "type": "value",
        "axisLabel": {"formatter": f"{{value}} {units.unit(Kind.LENGTH)}", "hideOverlap": True},
    }
    return {
        "animation": False,
        "grid": {"left": 52, "right": 14, "top": 12, "bottom": 28},
        "xAxis": axis,
        "yAxis": axis,
        "series": [
            {
                "type": "line",
                "data": data,
                "areaStyle": {"opacity": 0.15},
            }
        ],
    }
