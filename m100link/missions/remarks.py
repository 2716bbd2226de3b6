"""What a plan says and does not mean, or means and does not say: legal, and worth a look."""

from __future__ import annotations

from collections.abc import Iterator

from m100link.missions.estimate import estimate, seconds_of_actions
from m100link.missions.waypoint import AtEnd, Heading, OnRCLoss, PlanValues, Trace

__all__ = ["remarks"]

FACTORY_HEIGHT_M = 120.0
"""Up to here an aircraft flies until its app allows more."""


def remarks(plan: PlanValues) -> Iterator[str]:
    """A sentence for each thing that may surprise whoever flies the plan."""
    yield from _on_the_whole(plan)
    yield from _on_what_is_ignored(plan)
    if plan.trace is Trace.STOP_AT_POINTS:
        for index, seconds in enumerate(seconds_of_actions(plan)):
            limit = plan.waypoints[index].action_time_limit
            if limit is not None and seconds > limit:
                yield (
                    f"waypoint {index}: its actions take about {seconds:.0f} s and are cut off "
                    f"after {limit:g} s"
                )


def _on_the_whole(plan: PlanValues) -> Iterator[str]:
    heights = [point.height for point in plan.waypoints]
    if plan.on_rc_loss is OnRCLoss.CONTINUE:
        yield "without the RC it flies on, and no pilot can stop it"
    if plan.speed <= 0:
        yield f"speed is {plan.speed:g}: it moves only as the pilot's pitch stick says"
    if plan.at_end is AtEnd.ENDLESS:
        yield "it never ends by itself: after the last waypoint it hovers, still in the mission"
    if max(heights) > FACTORY_HEIGHT_M:
        yield (
            f"it climbs to {max(heights):g} m; a height limit of {FACTORY_HEIGHT_M:g} m, as set in "
            "the factory, refuses it"
        )
    if min(heights) < 0:
        yield f"it descends to {-min(heights):g} m below the take-off point"
    if plan.speed > 0 and (share := estimate(plan).battery_percent) > 100:
        yield f"it takes about {share:.0f} % of a battery"


def _on_what_is_ignored(plan: PlanValues) -> Iterator[str]:
    points = plan.waypoints
    if plan.heading is not Heading.BY_WAYPOINT and any(point.heading_deg for point in points):
        yield "headings of waypoints are ignored: heading is not Heading.BY_WAYPOINT"
    if not plan.gimbal_by_waypoint and any(point.gimbal_pitch_deg for point in points):
        yield "gimbal pitches of waypoints are ignored: gimbal_by_waypoint is False"
    if plan.trace is Trace.STOP_AT_POINTS and any(point.damping for point in points):
        yield "dampings are ignored: it stops at waypoints"
