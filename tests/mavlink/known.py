"""An aircraft of which everything is known, and no two numbers are alike: for tables of values."""

from __future__ import annotations

import math
from typing import Any, cast

from m100link.agent.lease import Lease
from m100link.agent.messages import LeaseChanged, Limits, State
from m100link.mavlink.world import World
from m100link.protocol.records import (
    Acceleration,
    AngularVelocity,
    Attitude,
    Battery,
    FlightPhase,
    FlightStatus,
    Magnetometer,
    Position,
    RemoteControl,
    Velocity,
)
from m100link.telemetry.integrity import Integrity, IntegrityState
from m100link.telemetry.state import AircraftState

ROLL, PITCH, YAW = 10.0, -20.0, -130.0
LATITUDE, LONGITUDE = -33.1234567, 151.2345678


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Scalar first: turned by yaw about down, then pitch about right, then roll about forward."""

    def times(a: tuple[float, ...], b: tuple[float, ...]) -> tuple[float, float, float, float]:
        return (
            a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
            a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
            a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
        )

    half = [math.radians(one) / 2 for one in (roll, pitch, yaw)]
    about = [
        (math.cos(half[0]), math.sin(half[0]), 0.0, 0.0),
        (math.cos(half[1]), 0.0, math.sin(half[1]), 0.0),
        (math.cos(half[2]), 0.0, 0.0, math.sin(half[2])),
    ]
    return times(times(about[2], about[1]), about[0])


def position(
    *,
    latitude: float = LATITUDE,
    longitude: float = LONGITUDE,
    altitude: float = 87.65,
    height: float = 12.34,
    health: int | None = 4,
) -> Position:
    return Position(math.radians(latitude), math.radians(longitude), altitude, height, health)


class Known:
    """What an agent would tell; each item can be taken away, or be another one."""

    def __init__(self, *values: Any) -> None:
        self.items: dict[type[Any], Any] = {type(one): one for one in (*EVERYTHING, *values)}
        self.state = State(0.0, connection="connected", discards=77)
        self.holder = LeaseChanged(0, "")
        self.telemetry: AircraftState | None = cast(AircraftState, self)
        self.is_connected = True
        self.has_authority = False
        self.newest_age: float | None = 0.0
        self.within: dict[type[Any], float] = {}
        self.integrity = Integrity(IntegrityState.GOOD, "", 0.25, 0.375)

    def get(self, record: type[Any]) -> Any:
        return self.items.get(record)

    def fresh(self, record: type[Any], *, within: float) -> Any:
        self.within[record] = within
        return self.items.get(record)

    def without(self, *records: type[Any]) -> Known:
        for one in records:
            del self.items[one]
        return self

    def limited(self, speed: float) -> Known:
        self.state = State(0.0, limits=Limits(max_speed_m_s=speed))
        return self

    def doubted(self, state: IntegrityState) -> Known:
        self.integrity = Integrity(state, "seen", 4.5, 0.375)
        return self

    def flown(self) -> Known:
        self.holder, self.has_authority = LeaseChanged(3, "mavlink"), True
        return self


EVERYTHING = (
    Attitude(*quaternion(ROLL, PITCH, YAW)),
    AngularVelocity(0.11, -0.23, 0.37),
    Acceleration(1.5, -2.5, 0.7),
    Velocity(3.21, -1.57, 0.84, 3),
    position(),
    Magnetometer(1.0, 2.0, 3.0),
    RemoteControl(1000, -2000, 3000, -4000, 8000, -4545),
    FlightStatus(FlightPhase.IN_AIR),
    Battery(63),
)


def world_of(known: Known, *, home: tuple[float, float, float] | None = None) -> World:
    """What the bridge makes of it.

    Args:
        known: What is told.
        home: How far north, east and up of home it is, m; None where nobody knows.
    """
    world = World(known)
    if home is not None:
        north, east, up = home
        here = position()
        latitude = here.latitude_deg - math.degrees(north / 6_371_000)
        across = 6_371_000 * math.cos(here.latitude_rad)
        longitude = here.longitude_deg - math.degrees(east / across)
        status = known.items[FlightStatus]
        known.items[Position] = position(latitude=latitude, longitude=longitude, altitude=10.5)
        known.items[FlightStatus] = FlightStatus(FlightPhase.STANDBY)
        world.look()
        known.items[FlightStatus] = status
        known.items[Position] = position(height=up)
    if known.has_authority:
        world.lease = Lease("mavlink", "token", known.holder.number)
    return world
