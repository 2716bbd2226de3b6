"""An aircraft of firmware 3.1, and plans around it."""

from __future__ import annotations

from typing import Any

from m100link.geodesy import LocalFrame
from m100link.missions.plan import AtEnd, WaypointPlan
from m100link.missions.waypoint import Waypoint
from m100link.sim.virtual import VirtualAircraft
from tests.apps.fleet.conftest import OnBoard, Rig


def virtual() -> VirtualAircraft:
    return VirtualAircraft(seed=5, firmware="3.1")


async def on_board(rig: Rig, name: str = "a1", **options: Any) -> OnBoard:
    return await rig.aircraft(name, virtual=virtual(), **options)


def away(one: OnBoard, *north: float, at_end: AtEnd = AtEnd.HOVER) -> WaypointPlan:
    """Points so many metres north of where it stands, 6 m high."""
    told = one.aircraft.vehicle.settings
    frame = LocalFrame(told.latitude_deg, told.longitude_deg)
    points = [Waypoint(*frame.to_geodetic(each, 0), height=6) for each in north]
    return WaypointPlan(points, speed=5, at_end=at_end)


def kind(one: OnBoard) -> str:
    """What the aircraft itself says it flies."""
    return one.client.state.mission
