"""A plan in pieces, and the reports of its mission."""

from __future__ import annotations

import asyncio

import pytest

from m100link.apps.agent.server.mission import push_of
from m100link.errors import NotObserved
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
from m100link.protocol.setpoint import Setpoint
from tests.apps.agent.conftest import Rig, airborne, mission


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
async def test_what_a_mission_reaches_is_reported_to_people() -> None:
    async with Rig(firmware="3.1").running() as rig:
        await airborne(rig)
        state = rig.agent.connection.require_aircraft().state.position
        assert state is not None
        frame = LocalFrame(state.latitude_deg, state.longitude_deg)
        places = [Waypoint(*frame.to_geodetic(north, 0.0), height=6) for north in (5.0, 10.0)]
        await mission(rig, WaypointPlan(places, speed=5), begun=lambda: None)
        told = [event.text for event in rig.agent.journal.events]
        assert told[-4:] == [
            "a mission of 2 waypoints begins",
            "waypoint 0 reached",
            "waypoint 1 reached",
            "the mission of 2 waypoints is over",
        ]


@pytest.mark.anyio
async def test_a_hover_in_the_turn_of_the_loop_in_which_a_mission_is_asked_for_ends_it() -> None:
    async with Rig(firmware="3.1").running() as rig:
        await airborne(rig)
        state = rig.agent.connection.require_aircraft().state.position
        assert state is not None
        frame = LocalFrame(state.latitude_deg, state.longitude_deg)
        places = [Waypoint(*frame.to_geodetic(north, 0.0), height=6) for north in (5.0, 10.0)]
        plan = WaypointPlan(places, speed=5)
        flying = rig.holding.require()
        asked = asyncio.create_task(flying.start_mission(plan, take_off=False))
        asyncio.get_running_loop().call_soon(flying.hover, "hover")
        with pytest.raises(NotObserved, match="stopped before it began"):
            await asyncio.wait_for(asked, 5.0)
        assert not flying.mission.is_flying
        flying.steer(Setpoint.velocity(north=1.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0))
