"""Setpoints of a program: SET_POSITION_TARGET_LOCAL_NED and SET_ATTITUDE_TARGET.

The newest one is flown for as long as COM_OF_LOSS_T. A place is flown to by velocities that are
worked out anew at each step, so nothing that was sent long ago goes on moving the aircraft.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from m100link.apps.mavlink.translator.codec import MavlinkMessage
from m100link.apps.mavlink.translator.numbers import MavFrame
from m100link.apps.mavlink.translator.vehicle_state import VehicleState
from m100link.protocol.firmware import FIRMWARE_1_0, PROFILES
from m100link.protocol.records import Attitude, Position
from m100link.protocol.setpoint import Setpoint, tilt_range

_PLACE, _HEIGHT = 0b11, 0b100
_SPEED, _CLIMB = 0b11000, 0b100000
_NO_FORCE, _YAW, _YAW_RATE = 0x1C0, 0x400, 0x800
_NO_ATTITUDE, _NO_THRUST = 0x80, 0x40
_BODY_RATES = ((1, "body_roll_rate"), (2, "body_pitch_rate"), (4, "body_yaw_rate"))

_GAIN = 0.8  # metres per second for each metre that is missing

_HOVER, _FULL = 0.5, 0.5
"""Thrust that hovers, and what is above it: PX4's thrust is read as a climb rate."""

_MOST_TURN = 100.0
_UP_M = 0.5
_CLIMB_M_S = 0.1


@dataclass(frozen=True, slots=True)
class OffboardTarget:
    """The target of a program; None where it says nothing."""

    at: float  # when it came, s
    place: tuple[float, float] | None = None  # north and east of home, m
    height: float | None = None  # above home, m
    velocity: tuple[float, float] | None = None  # north and east, or forward and right, m/s
    climb: float | None = None  # up, m/s
    is_body: bool = False  # velocities are forward and right
    tilt: tuple[float, float] | None = None  # roll and pitch, °
    yaw_deg: float | None = None  # heading, °
    yaw_rate: float | None = None  # turn, °/s, clockwise


def _fastest(world: VehicleState, settings: Mapping[str, float]) -> float:
    """Horizontal speed that is asked for at most, m/s."""
    limit = world.known.view.state.limits.max_speed_m_s
    return min(settings["MPC_XY_VEL_MAX"], 10.0 if limit is None else limit)


def _turn(yaw: float) -> float:
    return math.remainder(math.degrees(yaw), 360.0)


class Offboard:
    def __init__(self, world: VehicleState, settings: Mapping[str, float]) -> None:
        self._world = world
        self._settings = settings  # of the bridge, by the names of its parameters
        self.target: OffboardTarget | None = None  # the newest one; None before the first

    def receive(self, message: MavlinkMessage, now: float) -> str:
        """Take a setpoint over. Returns why it cannot be flown, empty where it can."""
        if message.name == "SET_ATTITUDE_TARGET":
            return self._attitude(message, now)
        fields = message.fields
        mask, frame = fields["type_mask"], fields["coordinate_frame"]
        if any(map(math.isinf, fields.values())):
            return "a setpoint that is not finite"
        # The bit that makes a force of an acceleration means nothing where there is none.
        if mask & _NO_FORCE != _NO_FORCE and any(fields[f"af{axis}"] for axis in "xyz"):
            return "the M100 takes no acceleration and no force"
        is_body = frame in (MavFrame.BODY_NED, MavFrame.BODY_OFFSET_NED, MavFrame.BODY_FRD)
        if not is_body and frame != MavFrame.LOCAL_NED:
            return f"frame {frame} of setpoints is not known"
        # A target flown in part is another flight than the one that is asked for.
        if mask & _PLACE not in (0, _PLACE) or mask & _SPEED not in (0, _SPEED):
            return "only one of two coordinates: give both, or neither"
        has_place, has_height = not mask & _PLACE, not mask & _HEIGHT
        has_speed, has_climb = not mask & _SPEED, not mask & _CLIMB
        if is_body and (has_place or has_height):
            return f"a place in frame {frame}: places count from home, in LOCAL_NED"
        target = OffboardTarget(
            now,
            place=(fields["x"], fields["y"]) if has_place else None,
            height=-fields["z"] if has_height else None,
            velocity=(fields["vx"], fields["vy"]) if has_speed else None,
            climb=-fields["vz"] if has_climb else None,
            is_body=is_body,
            yaw_deg=None if mask & _YAW else _turn(fields["yaw"]),
            yaw_rate=None if mask & _YAW_RATE else math.degrees(fields["yaw_rate"]),
        )
        return self._take(target)

    def _attitude(self, message: MavlinkMessage, now: float) -> str:
        mask, thrust = message["type_mask"], message["thrust"]
        if mask & (_NO_ATTITUDE | _NO_THRUST) or not 0.0 <= thrust <= 1.0:
            return "the M100 takes attitudes with a thrust of 0 to 1, no body rates"
        if any(message[name] for bit, name in _BODY_RATES if not mask & bit):
            return "the M100 takes no body rates beside an attitude"
        size = math.hypot(*message["q"])
        if not 0.5 < size < 2.0:
            return "a setpoint that is not an attitude"
        attitude = Attitude(*(one / size for one in message["q"]))
        up = (thrust - _HOVER) / _FULL * self._settings["MPC_Z_VEL_MAX_UP"]
        if thrust == 0.0:
            up = 0.0  # "no thrust" while a program begins; the M100 does not fall
        tilt = attitude.roll_deg, attitude.pitch_deg
        return self._take(OffboardTarget(now, tilt=tilt, climb=up, yaw_deg=attitude.yaw_deg))

    def _take(self, target: OffboardTarget) -> str:
        pairs = (*(target.place or ()), *(target.velocity or ()), *(target.tilt or ()))
        ones = (target.height, target.climb, target.yaw_deg, target.yaw_rate)
        kinds = {*pairs, *ones} - {None}
        if not kinds or not all(map(math.isfinite, kinds)):
            return "a setpoint without values, or not a number"
        self.target = target
        return ""

    def is_fresh(self, now: float) -> bool:
        return self.target is not None and now - self.target.at <= self._settings["COM_OF_LOSS_T"]

    # -- what is flown ---------------------------------------------------------------------------

    def wants_up(self, now: float) -> bool:
        target = self.target
        if target is None or not self.is_fresh(now):
            return False
        if target.height is not None:
            return target.height > _UP_M
        return target.climb is not None and target.climb > _CLIMB_M_S

    def setpoint(self, now: float) -> Setpoint | None:
        """The setpoint of now; None when no program sends it any more, or the place is unknown."""
        target = self.target
        if target is None or not self.is_fresh(now):
            return None
        climb = self._climb(target)
        yaw_deg, yaw_rate = target.yaw_deg, target.yaw_rate
        yaw_rate = max(-_MOST_TURN, min(_MOST_TURN, yaw_rate or 0.0)) if yaw_deg is None else None
        if target.tilt is not None:
            firmware = self._world.known.view.state.firmware
            limits = tilt_range(PROFILES.get(firmware, FIRMWARE_1_0))
            roll, pitch = map(limits.nearest, target.tilt)
            return Setpoint.tilt(
                roll_deg=roll, pitch_deg=pitch, up=climb, yaw_deg=yaw_deg, yaw_rate_deg_s=yaw_rate
            )
        first, second = self._speed(target)
        if target.is_body:
            return Setpoint.velocity(
                forward=first, right=second, up=climb, yaw_deg=yaw_deg, yaw_rate_deg_s=yaw_rate
            )
        return Setpoint.velocity(
            north=first, east=second, up=climb, yaw_deg=yaw_deg, yaw_rate_deg_s=yaw_rate
        )

    def _climb(self, target: OffboardTarget) -> float:
        climb = target.climb or 0.0
        if target.height is not None:
            height = self._world.height if self._is_located else None
            climb = 0.0 if height is None else climb + _GAIN * (target.height - height)
        if climb < 0.0:
            return max(-self._settings["MPC_Z_VEL_MAX_DN"], climb)
        return min(self._settings["MPC_Z_VEL_MAX_UP"], climb)

    def _speed(self, target: OffboardTarget) -> tuple[float, float]:
        first, second = target.velocity or (0.0, 0.0)
        if target.place is not None:
            here = self._world.local if self._is_located else None
            if here is None:
                return 0.0, 0.0  # without a place of its own nothing leads there
            first += _GAIN * (target.place[0] - here[0])
            second += _GAIN * (target.place[1] - here[1])
        fastest = _fastest(self._world, self._settings)
        scale = max(1.0, math.hypot(first, second) / fastest)
        return first / scale, second / scale

    @property
    def _is_located(self) -> bool:
        """Whether a loop may be closed over where it is; where it was a second ago leads astray."""
        return self._world.known.view.to_steer_by(Position) is not None


# -- sticks of a ground station: MANUAL_CONTROL, as velocities (POSCTL) or as tilts (ALTCTL) -------


STICKS_LIFETIME = 0.5  # seconds after which sticks that are not sent any more are let go
_FULL_STICK = 1000.0
_DEAD = 0.03


def _stick(value: float) -> float:
    """-1 to 1, with nothing around the middle, and where there is no such axis.

    A value out of range is no axis, as PX4 has it: INT16_MAX, by which the definitions say so, and
    nonsense, which nobody means as a full stick.
    """
    found = value / _FULL_STICK
    return found if _DEAD <= abs(found) <= 1.0 else 0.0


class Manual:
    def __init__(
        self, world: VehicleState, settings: Mapping[str, float], *, is_tilt: bool
    ) -> None:
        self._world = world
        self._settings = settings
        self._is_tilt = is_tilt
        self._sticks = (0.0, 0.0, 0.0, 0.0)
        self._at = float("-inf")

    def receive(self, message: MavlinkMessage, now: float) -> None:
        """Take sticks over: pitch, roll, climb (0 to 1000, 500 stays), turn."""
        x, y, z, r = (message[axis] for axis in "xyzr")
        first, second, third, fourth = map(_stick, (x, y, (z - _FULL_STICK / 2) * 2, r))
        self._sticks, self._at = (first, second, third, fourth), now

    def is_fresh(self, now: float) -> bool:
        return now - self._at <= STICKS_LIFETIME

    def wants_up(self, now: float) -> bool:
        """Sticks do not leave the ground: a take-off is asked for."""
        return False

    def setpoint(self, now: float) -> Setpoint | None:
        """The setpoint of now; None when nobody holds the sticks."""
        if not self.is_fresh(now):
            return None
        pitch, roll, climb, turn = self._sticks
        up = climb * self._settings["MPC_Z_VEL_MAX_UP" if climb > 0 else "MPC_Z_VEL_MAX_DN"]
        yaw_rate = turn * self._settings["MPC_MAN_Y_MAX"]
        if self._is_tilt:
            tilt = self._settings["MPC_MAN_TILT_MAX"]
            return Setpoint.tilt(
                roll_deg=roll * tilt, pitch_deg=-pitch * tilt, up=up, yaw_rate_deg_s=yaw_rate
            )
        speed = _fastest(self._world, self._settings)
        scale = max(1.0, (pitch * pitch + roll * roll) ** 0.5)
        return Setpoint.velocity(
            forward=pitch * speed / scale,
            right=roll * speed / scale,
            up=up,
            yaw_rate_deg_s=yaw_rate,
        )
