"""Orders of the bridge to the agent: the manager decides, the executor carries them out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from m100link.apps.agent import orders
from m100link.apps.agent.orders import FlyTo, GuidedOrder
from m100link.apps.mavlink.translator.codec import MavlinkMessage, Peer
from m100link.apps.mavlink.translator.numbers import MavCommand, MavFrame
from m100link.apps.mavlink.translator.vehicle_state import FlightSource, Mode
from m100link.errors import M100Error
from m100link.missions.plan import WaypointPlan

_NO_PLACE = 0x7FFFFFFF


class VehicleOrder:
    """An order that takes time and has an end; the newest one replaces the one before it."""

    __slots__ = ()

    running: ClassVar[FlightSource] = FlightSource.NOTHING  # what flies while it is carried out


@dataclass(frozen=True, slots=True)
class ObtainControl(VehicleOrder):
    name: str  # for whom, for people


@dataclass(frozen=True, slots=True)
class ReleaseControl(VehicleOrder):
    """Give lease and authority back: motion ends, the pilot flies."""


@dataclass(frozen=True, slots=True)
class TakeOffAndClimb(VehicleOrder):
    running: ClassVar[FlightSource] = FlightSource.TAKE_OFF

    # To climb to, m above the take-off point; None stays where the autopilot ends.
    height: float | None = None


@dataclass(frozen=True, slots=True)
class CancelTakeOff(VehicleOrder):
    """Keep a take-off that was ordered from being flown, and give lease and authority back.

    Giving back is all that can be done on the ground: a landing is refused there, and nothing stops
    the motors (document, 2.2.2). Whether it ends a take-off that the aircraft has accepted is not
    reported anywhere, so it is watched; an aircraft that takes off all the same is landed.
    """


@dataclass(frozen=True, slots=True)
class LandInPlace(VehicleOrder):
    running: ClassVar[FlightSource] = FlightSource.LAND

    # End the autopilot's task first, by giving authority back and asking anew.
    is_interrupting: bool = False


@dataclass(frozen=True, slots=True)
class ReturnToLaunch(VehicleOrder):
    running: ClassVar[FlightSource] = FlightSource.GO_HOME

    is_interrupting: bool = False  # as in LandInPlace


@dataclass(frozen=True, slots=True)
class HoldPosition(VehicleOrder):
    is_interrupting: bool = False  # as in LandInPlace
    why: str = ""
    follows_stop: bool = False  # of somebody else: the next mode request flies


@dataclass(frozen=True, slots=True)
class FlightSequence(VehicleOrder):
    running: ClassVar[FlightSource] = FlightSource.FLIGHT

    legs: tuple[GuidedOrder, ...]  # each an order of the agent
    waits: tuple[float, ...] = ()  # seconds to hover after each
    takes_off: bool = False  # take off first
    then: LandInPlace | ReturnToLaunch | None = (
        None  # the way to the ground that follows them; None hovers
    )
    # Number of the mission's item of each leg, None for a leg of none; empty where no mission is
    # flown.
    items: tuple[int | None, ...] = ()
    edition: int = 0  # of the mission
    # The part that the aircraft flies by itself in place of the last legs; None where the agent
    # flies them all.
    plan: WaypointPlan | None = None
    why: str = ""  # why it does, of a mission

    @property
    def by_agent(self) -> int:
        """How many legs the agent flies."""
        return len(self.legs) - (0 if self.plan is None else len(self.plan.waypoints))

    def speed_of(self, number: int) -> float:
        """Of a leg to a place, m/s; 0 of others."""
        leg = self.legs[number]
        return leg.speed if isinstance(leg, FlyTo) else 0.0


@dataclass(frozen=True, slots=True)
class MissionCommand:
    """An order to the mission that the aircraft flies; it replaces nothing."""

    order: orders.Order  # to pause it, to go on, or for another speed
    flight: FlightSequence | None = None  # which is paused or goes on; None for whichever flies


@dataclass(frozen=True, slots=True)
class PayloadOrder:
    """An order to the camera or the gimbal; it replaces nothing."""

    order: orders.Order
    done: Callable[[M100Error | None], None]  # called with its outcome


@dataclass(frozen=True, slots=True)
class Drop:
    """Leave the order under way as it is: control was lost, and what was to come is not flown."""


# -- a mode request of a ground station: a value for the manager -----------------------------------


@dataclass(frozen=True, slots=True)
class ModeRequest:
    mode: Mode  # in which mode
    order: VehicleOrder | None  # what the agent is asked for; None where setpoints fly
    peer: Peer | None = None  # who wants it; None for the bridge itself
    is_anew: bool = False  # whether it is another mission than the one that flies or is paused


# -- a command of a ground station: a value for all who carry one out ------------------------------


@dataclass(frozen=True, slots=True)
class Asked:
    command: int
    parameters: tuple[float, float, float, float]  # the first four, NaN where nothing is said
    peer: Peer
    x: float = math.nan  # latitude, °, or the fifth parameter
    y: float = math.nan  # longitude, °, or the sixth
    z: float = math.nan  # altitude, or the seventh
    # The zero of the altitude: sea level where the message does not say it.
    frame: int = MavFrame.GLOBAL
    component: int = 0  # that it is for; 0 for all
    raw_x: float = math.nan  # the fifth parameter of a command without a place

    @property
    def key(self) -> tuple[Peer, str]:
        """Equal for copies of one command: NaN is not equal to itself."""
        return self.peer, str(self)

    def __str__(self) -> str:
        name = next((one.name for one in MavCommand if one == self.command), str(self.command))
        values = [*self.parameters, self.x, self.y, self.z]
        said = ", ".join("" if math.isnan(one) else f"{one:.10g}" for one in values)
        return f"{name}({said.rstrip(', ')})"


def read_command(message: MavlinkMessage, peer: Peer) -> Asked:
    four = tuple(message[f"param{place}"] for place in range(1, 5))
    command, component = message["command"], message.fields.get("target_component", 0)
    if message.name == "COMMAND_LONG":
        x, y, z = (message[f"param{place}"] for place in (5, 6, 7))
        return Asked(command, four, peer, x, y, z, MavFrame.GLOBAL, component, x)
    raw_x, raw_y = (math.nan if one == _NO_PLACE else one for one in (message["x"], message["y"]))
    place = (raw_x / 1e7, raw_y / 1e7, message["z"])
    return Asked(command, four, peer, *place, message["frame"], component, raw_x)
