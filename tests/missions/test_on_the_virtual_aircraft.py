"""What plans promise: the virtual aircraft takes them, keeps them, and flies them in time."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings

from m100link import (
    GimbalPitch,
    Heading,
    Stay,
    TakePhoto,
    Trace,
    Waypoint,
    WaypointPlan,
)
from m100link.geodesy import LocalFrame
from m100link.missions.patterns import survey
from m100link.protocol.codes import MissionCode
from m100link.protocol.commands.waypoint import (
    WaypointDownloadMission,
    WaypointDownloadPoint,
    WaypointStartStop,
)
from tests.missions.plans import plans
from tests.sim.host import Host
from tests.sim.vehicle.missions.flights import fly, host, where

OK = MissionCode.SUCCESS


def aircraft_at(plan: WaypointPlan, **options: Any) -> Host:
    """An aircraft that stands below the first waypoint."""
    first = plan.waypoints[0]
    place = {"latitude_deg": first.latitude_deg, "longitude_deg": first.longitude_deg}
    return host(place | options)


@given(plans())
@settings(max_examples=25, deadline=None)
def test_every_plan_is_taken_and_given_back(plan: WaypointPlan) -> None:
    program = aircraft_at(plan)
    mission, points = plan.to_wire()
    assert program.ask(mission) == OK
    assert [program.ask(point).code for point in points] == [OK] * len(points)
    answer = program.ask(WaypointDownloadMission())
    kept = [program.ask(WaypointDownloadPoint(index)).point for index in range(len(points))]
    assert (answer.mission, tuple(kept)) == (mission, points)
    assert WaypointPlan.from_wire(answer.mission, kept) == replace(plan, take_off=False)


FRAME = LocalFrame(52.1, 4.31)


def at(north: float, east: float, height: float, **values: Any) -> Waypoint:
    return Waypoint(*FRAME.to_geodetic(north, east), height, **values)


SQUARE = [at(0, 0, 15), at(60, 0, 15), at(60, 60, 25), at(0, 60, 15)]
FIELD = survey([(0, 0), (0, 60), (40, 60), (40, 0)], spacing=20, height=20)


@pytest.mark.parametrize(
    "plan",
    [
        WaypointPlan(SQUARE, speed=5),
        WaypointPlan(SQUARE, speed=2, heading=Heading.AS_AT_START),
        WaypointPlan(SQUARE, speed=10, repeat=2),
        WaypointPlan([at(0, 0, 15), at(200, 0, 15), at(200, 200, 60)], speed=8),
        WaypointPlan(
            [at(0, 0, 15), *(at(60, 60 * n, 15, damping=10) for n in range(4)), at(0, 200, 15)],
            trace=Trace.COORDINATED_TURNS,
        ),
        WaypointPlan(
            Waypoint.along(FIELD, frame=FRAME, every=20, actions=[GimbalPitch(-90), TakePhoto()]),
            speed=4,
        ),
        WaypointPlan([at(0, 0, 10), at(0, 30, 10, actions=[Stay(20)]), at(0, 60, 10)]),
    ],
    ids=["square", "slow", "twice", "long", "curves", "survey", "stay"],
)
def test_a_flight_takes_about_as_long_as_estimated(plan: WaypointPlan) -> None:
    """Between first and last waypoint: how it gets there and home is the aircraft's affair."""
    program = aircraft_at(plan)
    mission, points = plan.to_wire()
    assert program.ask(mission) == OK
    assert {program.ask(point).code for point in points} == {OK}
    assert program.ask(WaypointStartStop(0)) == OK
    begin, step = (0.0, 0.0, plan.waypoints[0].height), 0.1
    while math.dist(where(program), begin) > 1:
        program.wait(step, step)
    flown = len(fly(program, 1200.0, step)) * step
    assert flown == pytest.approx(plan.estimate().duration_s, rel=0.15)
