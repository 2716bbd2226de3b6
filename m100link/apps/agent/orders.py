"""The orders of a front to an agent: each is a class with its fields and its class data.

``class Name(Order, …)`` makes a frozen dataclass with a place in ``ORDERS``; the codec of
messages reads and writes its fields. The defaults are the strictest: an order needs the lease and
the right to fly, moves the aircraft, is kept, and must not be old. Its handler is a row of
``HANDLERS`` in ``m100link.apps.agent.server.agent``; an order without one ends the import with an
error that names it.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import Enum, IntEnum
from typing import Any, ClassVar, Self, dataclass_transform

from m100link.errors import GuardRefused, UsageError
from m100link.missions.plan import WaypointPlan
from m100link.protocol.commands.gimbal import GimbalAngle, GimbalSpeed
from m100link.protocol.commands.hotpoint import HotpointStart
from m100link.protocol.commands.waypoint import WaypointMission, WaypointPoint
from m100link.protocol.firmware import FIRMWARE_3_1
from m100link.protocol.setpoint import ReferenceFrame, Setpoint


class Right(IntEnum):
    """A right on an aircraft of a fleet; each includes those before it."""

    WATCH = 1
    STOP = 2
    FLY = 3


class Needs(Enum):
    """Whether an agent wants to see a lease."""

    NOTHING = "nothing"
    LEASE_IF_HELD = "lease if held"  # while nobody has the lease, anybody may
    LEASE = "lease"  # the order renews it


class Age(Enum):
    """Whether a fleet refuses an order older than 5 s, by the clock of the agent."""

    ANY = "any"
    YOUNG_IF_KNOWN = "young if known"  # without a time nobody can say
    YOUNG = "young"  # without a time it counts as old


class AfterStop(Enum):
    """Whether an order is done behind a STOP: one rule for every front."""

    DONE = "done"  # it ends something, or moves nothing: done whenever it comes
    IF_NEWER = "if newer"  # done, unless it was asked for before the STOP
    # Likewise, and not before its client has begun anew: asked for control, or let go of keys.
    # A program whose steps are separate orders does not fly on after a STOP that it did not hear.
    ANEW = "anew"


@dataclass_transform(frozen_default=True, field_specifiers=(field,))
class Order:
    """Something that a front asks an agent for."""

    needs: ClassVar[Needs] = Needs.LEASE
    #: The right that it takes; an order under STOP revokes the orders that were made before it.
    right: ClassVar[Right] = Right.FLY
    #: Whether it moves the aircraft, or lets somebody move it; an end of movement does not.
    moves: ClassVar[bool] = True
    #: Whether the log of orders has to know it before it begins, because twice would be once too
    #: often. One that is not kept, or that ends a movement, waits for no disk.
    is_kept: ClassVar[bool] = True
    age: ClassVar[Age] = Age.YOUNG
    after_stop: ClassVar[AfterStop] = AfterStop.ANEW  #: DONE where it moves nothing
    #: Whether it is done as it is heard, before orders that were heard and have not begun.
    is_at_once: ClassVar[bool] = False
    #: Whether it ends a movement or gives control back. No limit of any front drops or delays it.
    ends: ClassVar[bool] = False
    label: ClassVar[str]  #: its name for people

    def __init_subclass__(cls, *, is_kind: bool = True, label: str = "", **data: Any) -> None:
        """The class data that are named; ``is_kind``: whether there are orders of this class."""
        if unknown := data.keys() - Order.__annotations__.keys():
            raise TypeError(f"{cls.__name__}: orders have no {', '.join(sorted(unknown))}")
        still = {} if data.get("moves", True) else {"after_stop": AfterStop.DONE}
        for name, value in (still | data).items():
            setattr(cls, name, value)
        # Such a field would be the sender's to fill in, and what nobody reads is not the strictest.
        taken = cls.__annotations__.keys() & {*Order.__annotations__, "kind"}
        own = Order.__annotations__.keys() - {"label"}
        wrong = {one for one in own if type(getattr(cls, one)) is not type(getattr(Order, one))}
        if taken or wrong:
            raise TypeError(f"{cls.__name__}: not so {', '.join(sorted(taken | wrong))}")
        cls.label = label or re.sub("(?<!^)(?=[A-Z])", " ", cls.__name__).lower()
        dataclass(frozen=True)(cls)
        if is_kind:
            ORDERS[cls.__name__] = cls


ORDERS: dict[str, type[Order]] = {}
"""Every order by its name."""

# -- orders that end a flight: they need no lease over a fleet, and wait for nobody ----------------


class EndingOrder(Order, is_kind=False, right=Right.STOP, moves=False, is_kept=False, ends=True):
    """Any order that ends a flight."""


class Stop(EndingOrder, needs=Needs.NOTHING, age=Age.ANY):
    """No motion, no program, and no task."""


class Halt(EndingOrder, label="hover", needs=Needs.NOTHING, age=Age.ANY, is_at_once=True):
    """Hover: no motion and no guided flight; a task goes on.

    Anybody may. Unless its holder gives it under the lease, the holder has to begin anew by then.
    """

    why: str = ""  #: for people
    begins_anew: bool = False  #: whether its holder let go, so that the next order flies


class Land(EndingOrder, after_stop=AfterStop.IF_NEWER):
    """Land in place. Minutes later it would surprise somebody, so it must not be old."""


# -- the lease: over a fleet it is proved, and its token stays on board ----------------------------


class LeaseOrder(
    Order,
    is_kind=False,
    needs=Needs.NOTHING,
    is_kept=False,
    is_at_once=True,
    after_stop=AfterStop.IF_NEWER,
):
    """Any order about the lease."""


class AcquireLease(LeaseOrder, age=Age.YOUNG_IF_KNOWN):
    """Take the lease if it is free; nobody waits for it, and nobody has it for three seconds."""

    name: str = ""  #: who wants it, for people


class RenewLease(LeaseOrder, moves=False):
    """Let the lease last; a recorded one must not do that later."""

    token: str = field(default="", repr=False)  #: proof of the lease


class ReleaseLease(LeaseOrder, moves=False, age=Age.ANY, ends=True):
    """Give the lease back."""

    token: str = field(default="", repr=False)  #: proof of the lease


class AskTakeOver(LeaseOrder, age=Age.ANY):
    """First step: name the client that would lose the lease."""

    name: str = ""  #: who wants it, for people


class ConfirmTakeOver(LeaseOrder):
    """Second step: take the lease from exactly that one, which an old order must not do."""

    token: str = field(default="", repr=False)  #: proof of the first step


# -- orders to an aircraft -------------------------------------------------------------------------


class Activate(Order, needs=Needs.LEASE_IF_HELD, after_stop=AfterStop.IF_NEWER):
    """Activate the aircraft."""


class Obtain(Order, after_stop=AfterStop.IF_NEWER):
    """Obtain control authority; its client begins anew by it after a STOP."""


class Release(Order, moves=False, is_kept=False, ends=True):
    """Give control authority back; the lease stays."""


class TakeOff(Order):
    """Start the motors and climb to about 1.2 m."""


class GoHome(Order, ends=True):
    """Fly to the home point and land."""


class FlyPattern(Order):
    """Fly a simple task of DJI's node of 2015."""

    number: int  #: 0 to 6


class StartMotors(Order):
    """Start the motors on the ground."""


class StopMotors(Order, moves=False, is_kept=False, ends=True):
    """Stop the motors on the ground; nothing of the kind is ever sent in the air."""


class PointGimbal(Order, needs=Needs.LEASE_IF_HELD, after_stop=AfterStop.IF_NEWER):
    """Point the gimbal; nobody confirms it."""

    angles: GimbalAngle


class TurnGimbal(Order, needs=Needs.LEASE_IF_HELD, after_stop=AfterStop.IF_NEWER):
    """Turn the gimbal for half a second; nobody confirms it."""

    rates: GimbalSpeed


class CameraUse(Enum):
    """The actions of the camera."""

    PHOTO = "take_photo"
    START_VIDEO = "start_video"
    STOP_VIDEO = "stop_video"


class UseCamera(Order, needs=Needs.LEASE_IF_HELD, after_stop=AfterStop.IF_NEWER):
    """Take a photograph, start or stop video; nobody confirms it."""

    use: CameraUse


class AskVersion(
    Order, needs=Needs.NOTHING, right=Right.WATCH, moves=False, is_kept=False, age=Age.ANY
):
    """Tell the version of the aircraft: name and CRC."""


class SendToMobile(Order, after_stop=AfterStop.IF_NEWER):
    """Send data to the app on the pilot's phone."""

    data: bytes  #: up to 100 bytes


class OrderReplay(Order, needs=Needs.NOTHING, after_stop=AfterStop.IF_NEWER):
    """Move, stop or go on with a recording."""

    text: str  #: in words of :meth:`m100link.apps.agent.server.replays.Replays.order`


# -- missions that the aircraft flies by itself ----------------------------------------------------


class UploadPlan(Order, moves=False, is_kept=False, age=Age.ANY):
    """Bring a plan on board, where it waits for its start: whole, or not at all.

    The answer is its digest. It is void when another one comes, and when the lease ends.
    """

    mission: bytes  #: the command 0x03/0x10, as on the wire
    points: tuple[bytes, ...]  #: the commands 0x03/0x11, in order

    @classmethod
    def of(cls, plan: WaypointPlan) -> Self:
        """The order that brings a plan."""
        return cls.of_commands(*plan.to_wire())

    @classmethod
    def of_commands(cls, mission: WaypointMission, points: Iterable[WaypointPoint]) -> Self:
        """The order that brings these commands; an agent looks whether they make a plan."""
        values = tuple(point.value(FIRMWARE_3_1) for point in points)
        return cls(mission.value(FIRMWARE_3_1), values)

    def plan(self) -> WaypointPlan:
        """The plan.

        Raises:
            BadPlan, ValueError: It cannot be flown; this version cannot read it.
        """
        points = [WaypointPoint.parse(one, FIRMWARE_3_1) for one in self.points]
        return WaypointPlan.from_wire(WaypointMission.parse(self.mission, FIRMWARE_3_1), points)

    @property
    def digest(self) -> str:
        """The SHA-256 over the commands, hex: it names the plan."""
        return hashlib.sha256(b"".join((self.mission, *self.points))).hexdigest()


class StartMission(Order):
    """Let the plan fly that was uploaded under the same lease; accepted when it has begun."""

    digest: str  #: of the plan; another one, which somebody uploaded meanwhile, does not fly
    take_off: bool = False  #: take off before it
    until_over: bool = False  #: done when it is over, not when it has begun


class StopMission(Order, moves=False, is_kept=False, ends=True):
    """End the mission that flies, of whatever kind; done when something else may fly."""


class PauseMission(Order, moves=False, is_kept=False, ends=True):
    """Let the aircraft hover in the mission, of whatever kind."""


class ResumeMission(Order):
    """Let a paused mission go on, of whatever kind."""


class SetMissionSpeed(Order):
    """Change the speed of a waypoint mission; the answer is the one in force, mm/s."""

    speed: float  #: m/s


class StartHotpoint(Order):
    """Fly around a place."""

    circle: HotpointStart


class SetHotpointRadius(Order):
    """Change the circle that is flown."""

    radius: float  #: m


class SetHotpointRate(Order):
    """Change how fast the circle is flown."""

    rate: float  #: degrees per second, clockwise positive


class ResetHotpointHeading(Order):
    """Turn the nose back to where it is to point."""


# -- orders of an operator who points: fly there, around that, to this height, look that way -------
# Each is flown by a closed loop of the agent, under the lease and through the guards, and ends as a
# program of the agent ends: when it is there, when the stick is moved, when something else is asked
# for, and when the lease, the front, the page or control authority is lost. The aircraft hovers
# then. The newest one wins.


class FlyTo(Order, label="flight to a place"):
    """Fly straight to a place and hover there."""

    latitude_deg: float  #: WGS 84
    longitude_deg: float  #: WGS 84
    height: float  #: metres above the take-off point
    speed: float = 5.0  #: horizontally, at most, m/s up to 10
    yaw_deg: float | None = None  #: heading to fly with, °; None for the present one


class FlyAround(Order, label="flight around a place"):
    """Fly a circle around a place, looking at it, and hover at its end."""

    latitude_deg: float  #: of the centre, WGS 84
    longitude_deg: float  #: of the centre, WGS 84
    height: float  #: metres above the take-off point
    radius: float  #: m, 1 or more
    speed: float = 2.0  #: along the circle, m/s up to 10
    turns: float = 1.0  #: how many, more than 0
    clockwise: bool = True  #: seen from above


class ChangeHeight(Order, label="change of height"):
    """Climb or descend in place."""

    height: float  #: metres above the take-off point


class ChangeHeading(Order, label="change of heading"):
    """Turn in place."""

    yaw_deg: float  #: heading, °, 0 north, 90 east; any number of turns is taken off


GuidedOrder = FlyTo | FlyAround | ChangeHeight | ChangeHeading
"""Any of them."""


def require_newer(
    order: Order, asked_at: float, stopped_at: float, by: str = "STOP was pressed"
) -> None:
    """Raise ``GuardRefused``: a STOP came when an order, or its first step, was asked for; s."""
    if asked_at <= stopped_at and order.after_stop is not AfterStop.DONE:
        raise GuardRefused(
            f"{by} after {order.label} was asked for; nothing was sent",
            guard="stopped",
            cause="it is a later step of an order, or a computer on the way stood still",
            remedy="look at the aircraft, and ask anew",
        )


@dataclass(frozen=True, slots=True)
class GuidedFlight:
    """The flight of the agent that is under way, with the values that a map draws."""

    what: str  #: label of the order
    latitude_deg: float | None = None  #: of the target or the centre; None where the place stays
    longitude_deg: float | None = None  #: likewise
    height: float | None = None  #: metres above the take-off point; None where it stays
    radius: float = 0.0  #: of the circle, m; 0 for none
    yaw_deg: float | None = None  #: heading at the end; None where nobody asked for one
    distance_m: float | None = None  #: the rest of the path, m; None before it is known
    seconds: float | None = None  #: the rest of the time, roughly; None before it is known


# -- the life of an order: of a button, and of one press of keys or sticks -------------------------


class Life(Enum):
    """How far an order has come, by what the agent and telemetry say."""

    SENT = "sent"  # nobody has answered
    ACCEPTED = "accepted"  # the agent carries it out, and the aircraft does not show it
    FLOWN = "flown"  # and telemetry shows it
    OLD = "old"  # it was carried out, and no news of it is young enough
    REFUSED = "refused"  # it was not carried out
    DONE = "done"
    ENDED = "ended"  # something else ended it, or it failed, after it had begun


class News(Enum):
    """The inputs of the table."""

    TAKEN = "taken"  # the agent carries it out
    LEFT = "left"  # it does not any more, and nobody said why
    SEEN = "seen"  # telemetry shows what is wanted
    UNSEEN = "unseen"  # it shows something else
    SILENCE = "silence"  # nothing is heard
    DONE = "done"
    FAILED = "failed"  # an error, or the end of control


_L, _N = Life, News

_BEGUN = {_N.LEFT: _L.SENT, _N.SILENCE: _L.OLD, _N.DONE: _L.DONE, _N.FAILED: _L.ENDED}
LIVES: dict[Life, dict[News, Life]] = {
    _L.SENT: {_N.TAKEN: _L.ACCEPTED, _N.DONE: _L.DONE, _N.FAILED: _L.REFUSED},
    _L.ACCEPTED: _BEGUN | {_N.SEEN: _L.FLOWN},
    _L.FLOWN: _BEGUN | {_N.UNSEEN: _L.ACCEPTED},
    _L.OLD: {_N.TAKEN: _L.ACCEPTED, _N.LEFT: _L.SENT, _N.DONE: _L.DONE, _N.FAILED: _L.ENDED},
    _L.REFUSED: {},
    _L.DONE: {},
    _L.ENDED: {},
}
"""Life, news, next life. A pair that is not in the table changes nothing."""


# -- keys, sticks and the 2015 Quaternion as setpoints ---------------------------------------------


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
