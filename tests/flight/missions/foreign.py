"""A foreign aircraft on virtual time, the program's end of its cable, and a plan around it."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import Any

import m100link
from m100link import Aircraft, Waypoint, WaypointPlan
from m100link.link import Link, connect_in_memory
from tests.flight.foreign_aircraft import APP_ID, KEY, STANDBY, ForeignInMemory
from tests.flight.foreign_missions import COS_LATITUDE, EARTH_M, LATITUDE_DEG, LONGITUDE_DEG

CORNERS = ((20.0, 0.0), (20.0, 20.0), (0.0, 20.0), (0.0, 0.0))


def spot(north: float, east: float) -> tuple[float, float]:
    """Latitude and longitude of a place near the aircraft, degrees."""
    return (
        LATITUDE_DEG + math.degrees(north / EARTH_M),
        LONGITUDE_DEG + math.degrees(east / EARTH_M) / COS_LATITUDE,
    )


def plan(corners: Sequence[tuple[float, float]] = CORNERS, **options: Any) -> WaypointPlan:
    """A plan along these places, metres north and east of the start."""
    points = [Waypoint(*spot(*corner), height=10.0) for corner in corners]
    return WaypointPlan(points, **{"speed": 5.0, **options})


@asynccontextmanager
async def foreign(
    firmware: str = "3.1", **options: Any
) -> AsyncIterator[tuple[ForeignInMemory, Aircraft]]:
    """Both ends, activated."""
    there = ForeignInMemory(firmware, **options)
    link = Link()
    connect_in_memory(link, there)
    await link.wait_connected()
    try:
        async with m100link.connect(link) as aircraft:
            await aircraft.activate(m100link.Credentials(app_id=APP_ID, key=KEY))
            await asyncio.sleep(0.5)
            yield there, aircraft
    finally:
        there.close()


def orders(there: ForeignInMemory, *numbers: int) -> list[tuple[int, int | None]]:
    """Ids and answers of those commands of set 0x03, oldest first; of all without numbers."""
    return [
        (order.number, order.answer)
        for order in there.missions.orders
        if not numbers or order.number in numbers
    ]


def tell_standby_once(there: ForeignInMemory) -> None:
    """One false flight status, and no other until the item is sent again."""
    status, there.status = there.status, STANDBY
    there.step()
    there.status = status
    there.items.discard("status")


async def assert_rests(there: ForeignInMemory, seconds: float = 10.0) -> None:
    """Nothing flies it any more."""
    await asyncio.sleep(0.05)
    assert there.missions.flying == ""
    flown, moves = there.missions.flown_m, len(there.movements)
    await asyncio.sleep(seconds)
    assert there.missions.flown_m == flown
    assert len(there.movements) == moves
