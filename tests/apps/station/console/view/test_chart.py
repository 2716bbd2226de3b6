"""What stands on the map: the envelope where it is known, and the plan."""

from __future__ import annotations

from m100link.apps.agent.messages import Limits, State
from m100link.apps.station.console.view.chart import Fence, chart_of
from m100link.apps.station.console.view.inputs import Inputs
from m100link.missions.plan import WaypointPlan
from m100link.missions.waypoint import Waypoint

LIMITS = Limits(max_radius_m=150.0, latitude_deg=22.5, longitude_deg=113.9)


def test_the_envelope_lies_around_where_control_was_obtained() -> None:
    state = State(0.0, "connected", limits=LIMITS)
    assert chart_of(Inputs(state=state)).fence == Fence(22.5, 113.9, 150.0)
    assert chart_of(Inputs(state=state, is_silent=True)).fence is None
    assert chart_of(Inputs(state=State(0.0, limits=Limits(max_radius_m=150.0)))).fence is None
    assert chart_of(Inputs()).fence is None


def test_the_route_is_that_of_the_plan() -> None:
    places = [(22.54325, 113.9589), (22.54325, 113.95905)]
    plan = WaypointPlan([Waypoint(*place, height=6) for place in places], speed=5)
    assert chart_of(Inputs(plan=plan)).route == tuple(places)
    assert chart_of(Inputs()).route == ()
