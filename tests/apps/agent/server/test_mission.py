"""A plan in pieces, and what is told of its mission."""

from __future__ import annotations

import random

import pytest

from m100link import BadPlan, UsageError
from m100link.apps.agent.server.mission import StagedPlan, push_of
from m100link.flight.missions.events import (
    ActionsDone,
    Finished,
    MissionEvent,
    Paused,
    Reached,
    Started,
    Uploaded,
)
from m100link.geodesy import LocalFrame
from m100link.missions.plan import WaypointPlan
from m100link.missions.waypoint import Waypoint
from m100link.protocol.commands.control import Task
from tests.apps.agent.conftest import Rig

PLAN = WaypointPlan(
    [Waypoint(52.0 + index * 1e-4, 4.3, height=10 + index) for index in range(9)], speed=5
)


def test_points_come_in_any_order_and_the_last_makes_it_whole() -> None:
    mission, points = PLAN.to_wire()
    staged = StagedPlan()
    staged.begin(mission)
    shuffled = random.Random(3).sample(points, len(points))
    for point in shuffled[:-1]:
        staged.add(point)
        assert staged.plan is None
    with pytest.raises(UsageError, match="1 waypoints are missing"):
        staged.require()
    staged.add(shuffled[-1])
    assert staged.require().to_wire() == PLAN.to_wire()


def test_what_belongs_to_no_plan_is_refused() -> None:
    _, points = PLAN.to_wire()
    staged = StagedPlan()
    with pytest.raises(UsageError, match="there is no plan"):
        staged.require()
    with pytest.raises(UsageError, match="came before the plan"):
        staged.add(points[0])
    staged.begin(WaypointPlan(PLAN.waypoints[:3], speed=5).to_wire()[0])
    with pytest.raises(UsageError, match="no number 3"):
        staged.add(points[3])


def test_a_plan_that_cannot_be_flown_is_told_with_its_last_point() -> None:
    mission, points = PLAN.to_wire()
    staged = StagedPlan()
    staged.begin(mission)
    for point in points[:-1]:
        staged.add(point)
    beside = PLAN.to_wire()[1][-2]
    with pytest.raises(BadPlan):
        staged.add(
            type(beside)(
                index=8,
                latitude=beside.latitude,
                longitude=beside.longitude,
                altitude=beside.altitude,
            )
        )
    assert staged.plan is None
    staged.begin(mission)  # another plan forgets the one before
    with pytest.raises(UsageError, match="9 waypoints are missing"):
        staged.require()


@pytest.mark.parametrize(
    ("event", "push"),
    [
        (Uploaded(3, 300.4), (0, b"\x01\x2c\x01\0\0")),
        (Uploaded(3, None), (0, b"\x01\0\0\0\0")),
        (Reached(7), (2, b"\x07\x04\0\0\0")),
        (ActionsDone(7), (2, b"\x07\x06\0\0\0")),
        (Finished(), (1, bytes(5))),
        (Started(), None),
        (Paused(), None),
    ],
)
def test_what_djis_push_says_of_an_event(
    event: MissionEvent, push: tuple[int, bytes] | None
) -> None:
    assert push_of(event) == push


@pytest.mark.anyio
async def test_what_a_mission_reaches_is_told_to_people() -> None:
    async with Rig(firmware="3.1").running() as rig:
        await rig.agent.obtain(rig.token)
        await rig.agent.fly(rig.token, Task.TAKE_OFF)
        state = rig.agent.connection.require_aircraft().state.position
        assert state is not None
        frame = LocalFrame(state.latitude_deg, state.longitude_deg)
        places = [Waypoint(*frame.to_geodetic(north, 0.0), height=6) for north in (5.0, 10.0)]
        await rig.agent.fly_mission(rig.token, WaypointPlan(places, speed=5), begun=lambda: None)
        told = [event.text for event in rig.agent.journal.events]
        assert told[-4:] == [
            "a mission of 2 waypoints begins",
            "waypoint 0 reached",
            "waypoint 1 reached",
            "the mission of 2 waypoints is over",
        ]
