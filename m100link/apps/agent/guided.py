"""What an operator points at: where to fly, what to fly around, how high, which way to look.

These are messages of a front and values of its program. Each is flown by a closed loop of the
agent, under the lease and through the guards, and ends as a program of the agent ends: when it is
there, when the stick is moved, when something else is asked for, and when the lease, the front, the
page or control authority is lost. The aircraft hovers then. The newest one wins.
"""

from __future__ import annotations

from dataclasses import dataclass

from m100link.errors import UsageError
from m100link.protocol.setpoint import ReferenceFrame, Setpoint


@dataclass(frozen=True, slots=True)
class FlyTo:
    """Fly straight to a place and hover there."""

    latitude_deg: float  #: WGS 84
    longitude_deg: float  #: WGS 84
    height: float  #: metres above the take-off point
    speed: float = 5.0  #: horizontally, at most, m/s up to 10
    yaw_deg: float | None = None  #: heading to fly with, °; None for the present one
    id: int = 0  #: comes back in each outcome; 0 asks for none
    fence: int = 0  #: number of the lease it is asked under


@dataclass(frozen=True, slots=True)
class FlyAround:
    """Fly a circle around a place, looking at it, and hover at its end."""

    latitude_deg: float  #: of the centre, WGS 84
    longitude_deg: float  #: of the centre, WGS 84
    height: float  #: metres above the take-off point
    radius: float  #: m, 1 or more
    speed: float = 2.0  #: along the circle, m/s up to 10
    turns: float = 1.0  #: how many, more than 0
    clockwise: bool = True  #: seen from above
    id: int = 0  #: comes back in each outcome; 0 asks for none
    fence: int = 0  #: number of the lease it is asked under


@dataclass(frozen=True, slots=True)
class ChangeHeight:
    """Climb or descend in place."""

    height: float  #: metres above the take-off point
    id: int = 0  #: comes back in each outcome; 0 asks for none
    fence: int = 0  #: number of the lease it is asked under


@dataclass(frozen=True, slots=True)
class ChangeHeading:
    """Turn in place."""

    yaw_deg: float  #: heading, °, 0 north, 90 east; any number of turns is taken off
    id: int = 0  #: comes back in each outcome; 0 asks for none
    fence: int = 0  #: number of the lease it is asked under


GuidedOrder = FlyTo | FlyAround | ChangeHeight | ChangeHeading
"""Any of them."""

_NAMES: dict[type[GuidedOrder], str] = {
    FlyTo: "flight to a place",
    FlyAround: "flight around a place",
    ChangeHeight: "change of height",
    ChangeHeading: "change of heading",
}


def name_of(order: GuidedOrder) -> str:
    """What it is called in the journal, and in the state."""
    return _NAMES[type(order)]


@dataclass(frozen=True, slots=True)
class GuidedFlight:
    """What of them flies now, for whoever draws it."""

    what: str  #: by the names of :func:`name_of`
    latitude_deg: float | None = None  #: of the target or the centre; None where the place stays
    longitude_deg: float | None = None  #: likewise
    height: float | None = None  #: metres above the take-off point; None where it stays
    radius: float = 0.0  #: of the circle, m; 0 for none
    yaw_deg: float | None = None  #: heading at the end; None where nobody asked for one
    distance_m: float | None = None  #: what remains of the way, m; None before it is known
    seconds: float | None = None  #: what it will take, roughly; None before it is known


# -- what keys, sticks and the 2015 Quaternion mean as setpoints -----------------------------------


SETPOINT_LIFETIME = 0.2
"""Seconds that a setpoint of a program lasts when it is not renewed."""

ANGLE_MODE = 1
"""Tilt angles in the body frame, climb rate, yaw rate (key 8, mode 2 of the document, 0x0a)."""

VELOCITY_MODE = 2
"""Velocities over ground, climb rate, yaw rate (key 9, mode 4 of the document, 0x48)."""


def setpoint_of(mode: int, x: float, y: float, z: float, w: float) -> Setpoint:
    """The setpoint for the four numbers of ``/sdk_request_ctrl``.

    The first movement value is ``y`` and the second is ``x``, as DJI's node has it; ``z`` is the
    yaw rate and ``w`` the climb rate.

    Args:
        mode: :data:`ANGLE_MODE` or :data:`VELOCITY_MODE`.
        x: Pitch (°, negative flies forward), or velocity to the east (m/s).
        y: Roll (°, positive to the right), or velocity to the north (m/s).
        z: Yaw rate, °/s, clockwise from above.
        w: Climb rate, m/s.

    Raises:
        UsageError: There is no such mode.
        BadSetpoint: A value outside its range.
    """
    if mode == ANGLE_MODE:
        return Setpoint.tilt(
            roll_deg=y, pitch_deg=x, up=w, yaw_rate_deg_s=z, frame=ReferenceFrame.BODY
        )
    if mode == VELOCITY_MODE:
        return Setpoint.velocity(north=y, east=x, up=w, yaw_rate_deg_s=z)
    raise UsageError(f"there is no control mode {mode}", remedy="1 is angles, 2 is velocities")
