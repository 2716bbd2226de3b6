"""Setpoints: the 14 legal control modes and their values (document 3.2).

Three constructors, one per way of steering horizontally, take the vertical and the yaw part by
keyword; exactly the 14 combinations of the document can be built:

====  ==========================  =========================  ===========================
 No   constructor                 vertical                   yaw
====  ==========================  =========================  ===========================
1, 2  ``Setpoint.tilt``           ``up`` (velocity)          ``yaw_deg``, ``yaw_rate_deg_s``
3, 4  ``Setpoint.velocity``       ``up``                     ``yaw_deg``, ``yaw_rate_deg_s``
5, 6  ``Setpoint.position_offset``  ``up``                   ``yaw_deg``, ``yaw_rate_deg_s``
7, 8  ``Setpoint.tilt``           ``height``                 ``yaw_deg``, ``yaw_rate_deg_s``
9,10  ``Setpoint.velocity``       ``height``                 ``yaw_deg``, ``yaw_rate_deg_s``
11,12 ``Setpoint.position_offset``  ``height``               ``yaw_deg``, ``yaw_rate_deg_s``
13,14 ``Setpoint.tilt``           ``thrust_percent``         ``yaw_deg``, ``yaw_rate_deg_s``
====  ==========================  =========================  ===========================
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import Enum, IntEnum
from functools import lru_cache
from struct import Struct
from typing import TYPE_CHECKING, NamedTuple, Self

from m100link.errors import BadSetpoint
from m100link.protocol.command import Movement
from m100link.protocol.firmware import FirmwareProfile, FlagBit0, Generation

if TYPE_CHECKING:
    from m100link.protocol.commands.control import Move

__all__ = ["LIMITS", "ControlMode", "Horizontal", "ReferenceFrame", "Setpoint", "Vertical", "Yaw"]


class Horizontal(IntEnum):
    """Bits 7 and 6 of the control flag."""

    TILT = 0
    VELOCITY = 1
    POSITION_OFFSET = 2


class Vertical(IntEnum):
    """Bits 5 and 4 of the control flag."""

    VELOCITY = 0
    HEIGHT = 1
    THRUST = 2


class Yaw(IntEnum):
    """Bit 3 of the control flag."""

    ANGLE = 0
    RATE = 1


class ReferenceFrame(IntEnum):
    """Bit 1 of the control flag: the frame of the horizontal values."""

    GROUND = 0
    BODY = 1


class ControlMode(NamedTuple):
    """One combination of horizontal, vertical and yaw control."""

    horizontal: Horizontal
    vertical: Vertical
    yaw: Yaw

    @property
    def number(self) -> int:
        """Number in the document's table, 1 to 14.

        Raises:
            KeyError: Thrust with velocity or position is not in the table.
        """
        return _NUMBERS[self]

    @property
    def is_legal(self) -> bool:
        """Whether the document lists the combination."""
        return self in _NUMBERS

    @property
    def flag(self) -> int:
        """Control flag without the frame bits."""
        return self.horizontal << 6 | self.vertical << 4 | self.yaw << 3


_NUMBERS = {
    ControlMode(horizontal, vertical, yaw): number
    for number, (vertical, horizontal, yaw) in enumerate(
        [
            (vertical, horizontal, yaw)
            for vertical in Vertical
            for horizontal in Horizontal
            for yaw in Yaw
            if vertical is not Vertical.THRUST or horizontal is Horizontal.TILT
        ],
        start=1,
    )
}


class _Range(NamedTuple):
    low: float
    high: float
    unit: str

    def nearest(self, value: float) -> float:
        return max(self.low, min(self.high, value))


_FLOAT32_MAX = (2 - 2**-23) * 2.0**127  # the wire carries no larger number

TILT_LIMIT_DEG = 30.0
"""Most tilt that every firmware takes (document 3.2)."""

LIMITS: dict[Enum, _Range] = {
    Horizontal.TILT: _Range(-35, 35, "°"),
    Horizontal.VELOCITY: _Range(-10, 10, "m/s"),
    Horizontal.POSITION_OFFSET: _Range(-_FLOAT32_MAX, _FLOAT32_MAX, "m"),
}
"""Range per way of control (document 3.2, the table of modes).

Tilt is that of firmware 3.1 (errata 73); others take :data:`TILT_LIMIT_DEG`.
"""

VERTICAL_LIMITS = {
    Vertical.VELOCITY: _Range(-4, 4, "m/s"),
    Vertical.HEIGHT: _Range(0, _FLOAT32_MAX, "m"),
    Vertical.THRUST: _Range(0, 100, "%"),
}
YAW_LIMITS = {Yaw.ANGLE: _Range(-180, 180, "°"), Yaw.RATE: _Range(-100, 100, "°/s")}


def tilt_range(profile: FirmwareProfile) -> _Range:
    """Roll and pitch that a firmware takes, °."""
    if profile.generation < Generation.V3_1:
        return _Range(-TILT_LIMIT_DEG, TILT_LIMIT_DEG, "°")
    return LIMITS[Horizontal.TILT]


# The arguments of the constructors; tilt has one pair in both frames.
_HORIZONTAL_NAMES = {
    (horizontal, frame): names
    for horizontal in (Horizontal.VELOCITY, Horizontal.POSITION_OFFSET)
    for frame, names in (
        (ReferenceFrame.GROUND, ("north", "east")),
        (ReferenceFrame.BODY, ("forward", "right")),
    )
}
_VERTICAL_NAMES = {
    Vertical.VELOCITY: "up",
    Vertical.HEIGHT: "height",
    Vertical.THRUST: "thrust_percent",
}
_SET, _ID = 0x01, 0x03
_pack_data = Struct("<3B4f").pack  # command set, command id, control flag, four values

_YAW_NAMES = {Yaw.ANGLE: "yaw_deg", Yaw.RATE: "yaw_rate_deg_s"}


@dataclass(frozen=True, slots=True)
class Setpoint(Movement, address=(_SET, _ID), name="move", level=2, encrypted=True):
    """One movement command with units: :class:`Move` with a meaning.

    Build one with :meth:`tilt`, :meth:`velocity` or :meth:`position_offset`; all values are
    checked there and again here, so a setpoint that exists can be sent.

    Raises:
        BadSetpoint: A value is not finite or outside its range, or the mode is not in the table.
    """

    mode: ControlMode  #: Control mode.
    x: float  #: North or forward, velocity (m/s) or offset (m); in tilt mode the roll angle (°).
    y: float  #: East or right, velocity (m/s) or offset (m); in tilt mode the pitch angle (°).
    z: float  #: Climb rate (m/s, up positive), height above take-off (m) or thrust (%).
    yaw: float  #: Heading (°, 0 north, clockwise) or yaw rate (°/s, clockwise positive).
    #: Frame of x and y. Tilt is always in the body frame under firmware 1.0.
    frame: ReferenceFrame = ReferenceFrame.GROUND
    stable: bool = False  #: Brake smoothly, then hold the place (firmware 3.1, bit 0).
    # The control flag where all firmwares have the same one, worked out once: a setpoint is sent
    # more often than it is made. None: it depends on the firmware.
    _flag: int | None = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        horizontal, vertical, yaw = self.mode
        if self.mode not in _NUMBERS:
            raise BadSetpoint(
                f"{vertical.name} control does not go with {horizontal.name} control",
                cause="the document lists 14 modes; thrust goes with tilt only",
            )
        flat, climb, turn = LIMITS[horizontal], VERTICAL_LIMITS[vertical], YAW_LIMITS[yaw]
        if not (
            flat.low <= self.x <= flat.high
            and flat.low <= self.y <= flat.high
            and climb.low <= self.z <= climb.high
            and turn.low <= self.yaw <= turn.high
        ):
            raise self._outside(flat, flat, climb, turn)
        flag = None if self._is_steep else _common_flag(self.mode, self.frame, self.stable)
        object.__setattr__(self, "_flag", flag)

    @property
    def _is_steep(self) -> bool:
        """Whether not every firmware takes so much tilt."""
        is_tilt = self.mode.horizontal is Horizontal.TILT
        return is_tilt and max(abs(self.x), abs(self.y)) > TILT_LIMIT_DEG

    def _outside(self, *limits: _Range) -> BadSetpoint:
        """The first value outside, by the name that the program gave it."""
        names = (
            *_HORIZONTAL_NAMES.get((self.mode.horizontal, self.frame), ("roll_deg", "pitch_deg")),
            _VERTICAL_NAMES[self.mode.vertical],
            _YAW_NAMES[self.mode.yaw],
        )
        values = zip(names, (self.x, self.y, self.z, self.yaw), limits, strict=True)
        name, value, limit = next(one for one in values if not one[2].low <= one[1] <= one[2].high)
        if not math.isfinite(value):
            return BadSetpoint(f"{name} is {value}", cause="a computation that went wrong upstream")
        return BadSetpoint(
            f"{name} {value:g} {limit.unit} is outside {limit.low:g} to {limit.high:g}",
            remedy="limit the value before it becomes a setpoint",
        )

    @classmethod
    def tilt(
        cls,
        *,
        roll_deg: float,
        pitch_deg: float,
        up: float | None = None,
        height: float | None = None,
        thrust_percent: float | None = None,
        yaw_deg: float | None = None,
        yaw_rate_deg_s: float | None = None,
        frame: ReferenceFrame = ReferenceFrame.BODY,
        stable: bool = False,
    ) -> Self:
        """Modes 1, 2, 7, 8, 13 and 14: tilt the aircraft.

        Args:
            roll_deg: −30 to 30, positive to the right; −35 to 35 with firmware 3.1.
            pitch_deg: The same, **negative flies forward**.
            up: Climb rate, −4 to 4 m/s.
            height: Height above take-off, 0 m and more.
            thrust_percent: 0 to 100; direct thrust, with precaution.
            yaw_deg: Heading, −180 to 180, 0 north, 90 east, always ground frame.
            yaw_rate_deg_s: −100 to 100, positive clockwise from above.
            frame: Body by default; ground is possible from firmware 2.3 on.
            stable: Stable mode, firmware 3.1 only.
        """
        vertical, z = _one(up=up, height=height, thrust_percent=thrust_percent)
        yaw_mode, yaw = _yaw(yaw_deg, yaw_rate_deg_s)
        mode = ControlMode(Horizontal.TILT, vertical, yaw_mode)
        return cls(mode, roll_deg, pitch_deg, z, yaw, frame, stable)

    @classmethod
    def velocity(
        cls,
        *,
        north: float | None = None,
        east: float | None = None,
        forward: float | None = None,
        right: float | None = None,
        up: float | None = None,
        height: float | None = None,
        yaw_deg: float | None = None,
        yaw_rate_deg_s: float | None = None,
        stable: bool = False,
    ) -> Self:
        """Modes 3, 4, 9 and 10: fly at a velocity. Needs GPS health of 3 or more.

        Args:
            north: With ``east``: ground frame, −10 to 10 m/s.
            east: See ``north``.
            forward: With ``right``: body frame, −10 to 10 m/s.
            right: See ``forward``.
            up: Climb rate, −4 to 4 m/s.
            height: Height above take-off, 0 m and more.
            yaw_deg: Heading, −180 to 180, 0 north, 90 east, always ground frame.
            yaw_rate_deg_s: −100 to 100, positive clockwise from above.
            stable: Stable mode, firmware 3.1 only.
        """
        frame, x, y = _horizontal(north, east, forward, right)
        vertical, z = _one(up=up, height=height)
        yaw_mode, yaw = _yaw(yaw_deg, yaw_rate_deg_s)
        return cls(
            ControlMode(Horizontal.VELOCITY, vertical, yaw_mode), x, y, z, yaw, frame, stable
        )

    @classmethod
    def position_offset(
        cls,
        *,
        north: float | None = None,
        east: float | None = None,
        forward: float | None = None,
        right: float | None = None,
        up: float | None = None,
        height: float | None = None,
        yaw_deg: float | None = None,
        yaw_rate_deg_s: float | None = None,
        stable: bool = False,
    ) -> Self:
        """Modes 5, 6, 11 and 12: fly to an offset **from the present place**.

        The offset is not a target: the sender measures what remains and sends it anew each time.
        Needs GPS health of 3 or more.

        Args:
            north: With ``east``: ground frame, m.
            east: See ``north``.
            forward: With ``right``: body frame, m.
            right: See ``forward``.
            up: Climb rate, −4 to 4 m/s.
            height: Height above take-off, 0 m and more.
            yaw_deg: Heading, −180 to 180, 0 north, 90 east, always ground frame.
            yaw_rate_deg_s: −100 to 100, positive clockwise from above.
            stable: Stable mode, firmware 3.1 only.
        """
        frame, x, y = _horizontal(north, east, forward, right)
        vertical, z = _one(up=up, height=height)
        yaw_mode, yaw = _yaw(yaw_deg, yaw_rate_deg_s)
        mode = ControlMode(Horizontal.POSITION_OFFSET, vertical, yaw_mode)
        return cls(mode, x, y, z, yaw, frame, stable)

    def neutral(self) -> Setpoint:
        """Stop and stay: same horizontal mode and frame with zeros, no climb, no turn.

        Height and thrust turn into a climb rate of zero: repeating either would be repeating a
        stale command.
        """
        mode = ControlMode(self.mode.horizontal, Vertical.VELOCITY, Yaw.RATE)
        return replace(self, mode=mode, x=0.0, y=0.0, z=0.0, yaw=0.0)

    def control_flag(self, profile: FirmwareProfile) -> int:
        """The flag byte under a firmware profile.

        Raises:
            BadSetpoint: Stable mode, tilt in the ground frame, or more than 30° of tilt, where the
                firmware has none.
        """
        flag = self.mode.flag | self.frame << 1
        if self.stable:
            if profile.flag_bit0 is not FlagBit0.STABLE_MODE:
                raise BadSetpoint(
                    f"firmware {profile} has no stable mode",
                    cause="bit 0 of the control flag means the yaw frame before firmware 3.1",
                    remedy="leave stable=False",
                )
            flag |= 1
        if self._is_steep and profile.generation < Generation.V3_1:
            raise BadSetpoint(
                f"firmware {profile} tilts by at most {TILT_LIMIT_DEG:g}°",
                remedy="limit roll and pitch before they become a setpoint",
            )
        is_ground_tilt = (
            self.mode.horizontal is Horizontal.TILT and self.frame is ReferenceFrame.GROUND
        )
        if is_ground_tilt and not profile.tilt_frame_selectable:
            raise BadSetpoint(
                f"firmware {profile} takes tilt angles in the body frame only",
                remedy="use frame=ReferenceFrame.BODY and turn the angles by the heading",
            )
        return flag

    def encode(self, profile: FirmwareProfile) -> bytes:
        """The data of the frame, those of ``to_move(profile)``.

        Raises:
            BadSetpoint: See :meth:`control_flag`.
        """
        flag = self._flag
        if flag is None:
            flag = self.control_flag(profile)
        if profile.throttle_before_yaw:
            return _pack_data(_SET, _ID, flag, self.x, self.y, self.z, self.yaw)
        return _pack_data(_SET, _ID, flag, self.x, self.y, self.yaw, self.z)

    def value(self, profile: FirmwareProfile) -> bytes:
        """17 bytes; raises as :meth:`encode`."""
        return self.encode(profile)[2:]

    def to_move(self, profile: FirmwareProfile) -> Move:
        """The movement command under a firmware profile.

        Raises:
            BadSetpoint: See :meth:`control_flag`.
        """
        from m100link.protocol.commands.control import Move  # as the virtual aircraft reads it

        return Move(self.control_flag(profile), self.x, self.y, self.z, self.yaw)

    @classmethod
    def from_move(cls, move: Move, profile: FirmwareProfile) -> Self:
        """Read a movement command.

        Args:
            move: The command.
            profile: Firmware of the receiver.

        Raises:
            BadSetpoint: The flag names no mode or frame, or a value is out of range.
        """
        return cls(*ReceivedMove.read(move, profile))


class ReceivedMove(NamedTuple):
    """A movement command as an aircraft reads it: a :class:`Setpoint` of any finite values.

    The aircraft flies it as far as it can.
    """

    mode: ControlMode
    x: float
    y: float
    z: float
    yaw: float
    frame: ReferenceFrame = ReferenceFrame.GROUND
    stable: bool = False

    @classmethod
    def read(cls, move: Move, profile: FirmwareProfile) -> Self:
        """Read the flag as a firmware does.

        Raises:
            BadSetpoint: Illegal flag (bits that mean nothing, thrust without tilt), or a value that
                is not finite.
        """
        flag = move.control_flag
        try:
            mode = ControlMode(Horizontal(flag >> 6), Vertical(flag >> 4 & 3), Yaw(flag >> 3 & 1))
        except ValueError:
            raise BadSetpoint(f"control flag 0x{flag:02X} names no control mode") from None
        if flag & 0x04:
            raise BadSetpoint(f"control flag 0x{flag:02X} has its reserved bit 2 set")
        values = (move.roll_or_x, move.pitch_or_y, move.throttle_or_z, move.yaw)
        if not (mode.is_legal and all(map(math.isfinite, values))):
            raise BadSetpoint(
                f"control flag 0x{flag:02X} with {values}",
                cause="a value is not finite, or thrust does not go with tilt",
            )
        frame = ReferenceFrame(flag >> 1 & 1)
        if mode.horizontal is Horizontal.TILT and not profile.tilt_frame_selectable:
            frame = ReferenceFrame.BODY
        stable = bool(flag & 1) and profile.flag_bit0 is FlagBit0.STABLE_MODE
        return cls(mode, *values, frame=frame, stable=stable)

    def in_words(self) -> str:
        """Its values with unit and name: ``2 m/s north, 0 m/s east, 0 m/s up, 0 °/s yaw rate``."""
        horizontal, vertical, turn = self.mode
        flat, tilt = LIMITS[horizontal], ("roll", "pitch")
        limits = (flat, flat, VERTICAL_LIMITS[vertical], YAW_LIMITS[turn])
        names = (
            *_HORIZONTAL_NAMES.get((horizontal, self.frame), tilt),
            _VERTICAL_NAMES[vertical].removesuffix("_percent"),
            "yaw" if turn is Yaw.ANGLE else "yaw rate",
        )
        said = zip(self[1:5], limits, names, strict=True)
        return ", ".join(
            f"{round(value, 3) + 0.0:g} {limit.unit} {name}" for value, limit, name in said
        )

    def limited(self, profile: FirmwareProfile) -> Setpoint:
        """The nearest setpoint: tilt, velocities, thrust and yaw rate end at their limits.

        A heading may have any number of turns.

        Raises:
            BadSetpoint: A value is not finite, a height is negative, or the mode is illegal.
        """
        if not all(map(math.isfinite, self[1:5])):
            return Setpoint(*self)  # which names the value
        flat = LIMITS[self.mode.horizontal]
        if self.mode.horizontal is Horizontal.TILT:
            flat = tilt_range(profile)
        x, y = flat.nearest(self.x), flat.nearest(self.y)
        is_height = self.mode.vertical is Vertical.HEIGHT
        z = self.z if is_height else VERTICAL_LIMITS[self.mode.vertical].nearest(self.z)
        is_rate = self.mode.yaw is Yaw.RATE
        turn = YAW_LIMITS[Yaw.RATE].nearest(self.yaw) if is_rate else self.yaw
        turn = turn if abs(turn) <= 180 else math.remainder(turn, 360)
        return Setpoint(self.mode, x, y, z, turn, self.frame, self.stable)


@lru_cache(maxsize=64)
def _common_flag(mode: ControlMode, frame: ReferenceFrame, stable: bool) -> int | None:
    is_ground_tilt = mode.horizontal is Horizontal.TILT and frame is ReferenceFrame.GROUND
    return None if stable or is_ground_tilt else mode.flag | frame << 1


def _one(
    *, up: float | None, height: float | None, thrust_percent: float | None = None
) -> tuple[Vertical, float]:
    given = up, height, thrust_percent
    if given.count(None) == 2:
        for vertical, value in zip(_VERTICAL_NAMES, given, strict=True):
            if value is not None:
                return vertical, value
    raise BadSetpoint(
        f"{3 - given.count(None)} vertical values were given, exactly one is needed",
        remedy="give one of up (m/s), height (m) and, with tilt, thrust_percent",
    )


def _yaw(yaw_deg: float | None, yaw_rate_deg_s: float | None) -> tuple[Yaw, float]:
    if yaw_deg is not None and yaw_rate_deg_s is None:
        return Yaw.ANGLE, yaw_deg
    if yaw_rate_deg_s is not None and yaw_deg is None:
        return Yaw.RATE, yaw_rate_deg_s
    raise BadSetpoint("exactly one yaw value is needed", remedy="give yaw_deg or yaw_rate_deg_s")


def _horizontal(
    north: float | None, east: float | None, forward: float | None, right: float | None
) -> tuple[ReferenceFrame, float, float]:
    if north is not None and east is not None and forward is None and right is None:
        return ReferenceFrame.GROUND, north, east
    if forward is not None and right is not None and north is None and east is None:
        return ReferenceFrame.BODY, forward, right
    raise BadSetpoint(
        "the horizontal values do not make one frame",
        remedy="give north and east (ground frame), or forward and right (body frame)",
    )
