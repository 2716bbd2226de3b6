"""Telemetry records: what each item says, in SI units, degrees and named axes (document 2.2.3.1).

A record's fields are the raw wire values under names that say unit, axis and frame; properties give
the other views. Ground frame: north, east, up (up is positive although the document's frame is
north-east-down; errata, vertical sign). Body frame: forward, right, down.

Everything in ``__all__`` is public as it is: :mod:`m100link` and its manual have it from here.
"""

from __future__ import annotations

import math
from enum import IntEnum, StrEnum
from math import cos, sin
from typing import NamedTuple

from m100link.wire.frame import quick

__all__ = [
    "Acceleration",
    "AccelerationMode",
    "AngularVelocity",
    "Attitude",
    "Battery",
    "ControlDevice",
    "Device",
    "FlightPhase",
    "FlightStatus",
    "Gimbal",
    "Magnetometer",
    "Position",
    "RcMode",
    "RemoteControl",
    "Time",
    "Velocity",
]


@quick
class Time(NamedTuple):
    """Clock of the aircraft."""

    tick: int  #: Counter since power-on, wraps at 2³².
    #: Nanosecond field of firmware 3.1; its relation to the tick is undocumented.
    nanoseconds: int | None
    sync: int | None  #: Sync flag of firmware 3.1; the Matrice 100 has no sync output.
    tick_hz: int  #: Ticks per second, 600 or 400 by firmware.

    @property
    def seconds(self) -> float:
        """The tick in seconds since power-on (modulo the wrap, 82 or 124 days)."""
        return self.tick / self.tick_hz


@quick
class Attitude(NamedTuple):
    """Attitude as a unit quaternion from ground (north-east-down) to body (forward-right-down)."""

    q0: float  #: Scalar part. Level and facing north is (1, 0, 0, 0).
    q1: float  #: Forward axis.
    q2: float  #: Right axis.
    q3: float  #: Down axis.

    @property
    def roll_deg(self) -> float:
        """Roll, positive right side down, −180 to 180."""
        q0, q1, q2, q3 = self
        return math.degrees(math.atan2(2 * (q0 * q1 + q2 * q3), 1 - 2 * (q1 * q1 + q2 * q2)))

    @property
    def pitch_deg(self) -> float:
        """Pitch, positive nose up, −90 to 90."""
        q0, q1, q2, q3 = self
        return math.degrees(math.asin(max(-1.0, min(1.0, 2 * (q0 * q2 - q1 * q3)))))

    @property
    def yaw_deg(self) -> float:
        """Heading, 0 north, 90 east, −180 to 180."""
        q0, q1, q2, q3 = self
        return math.degrees(math.atan2(2 * (q0 * q3 + q1 * q2), 1 - 2 * (q2 * q2 + q3 * q3)))

    @property
    def wxyz(self) -> tuple[float, float, float, float]:
        """Scalar first, as on the wire."""
        return tuple(self)  # type: ignore[return-value]  # a NamedTuple of four floats

    @property
    def xyzw(self) -> tuple[float, float, float, float]:
        """Scalar last, the order of ROS and scipy; same rotation, same frames."""
        return (self.q1, self.q2, self.q3, self.q0)

    @property
    def enu_flu_xyzw(self) -> tuple[float, float, float, float]:
        """The attitude for ROS (REP 103): from body forward-left-up to ground east-north-up."""
        q0, q1, q2, q3 = self
        h = math.sqrt(0.5)
        return ((q1 + q2) * h, (q1 - q2) * h, (q0 - q3) * h, (q0 + q3) * h)


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Scalar first, ground (north, east, down) to body (forward, right, down), z-y-x angles, rad.

    Level and facing north is (1, 0, 0, 0); facing east (0.7071, 0, 0, 0.7071).
    """
    half_roll, half_pitch, half_yaw = 0.5 * roll, 0.5 * pitch, 0.5 * yaw
    cr, sr = cos(half_roll), sin(half_roll)
    cp, sp = cos(half_pitch), sin(half_pitch)
    cy, sy = cos(half_yaw), sin(half_yaw)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def in_body(
    xyzw: tuple[float, float, float, float], ground: tuple[float, float, float]
) -> tuple[float, float, float]:
    """A vector of the ground in the axes of the body.

    ``xyzw``: how the body is turned, scalar last: :attr:`Attitude.xyzw` for north, east, down and
    forward, right, down; :attr:`Attitude.enu_flu_xyzw` for the axes of ROS.
    """
    x, y, z, w = xyzw
    a, b, c = ground
    # The inverse rotation: t = 2 v × q, then v + w t + t × q.
    tx, ty, tz = 2 * (b * z - c * y), 2 * (c * x - a * z), 2 * (a * y - b * x)
    return (
        a + w * tx + ty * z - tz * y,
        b + w * ty + tz * x - tx * z,
        c + w * tz + tx * y - ty * x,
    )


class _GroundVector:
    """Other views of a ground-frame vector whose first three fields are north, east, up."""

    __slots__ = ()

    @property
    def ned(self) -> tuple[float, float, float]:
        """North, east, down."""
        north, east, up = self[:3]  # type: ignore[index]  # mixed into NamedTuples only
        return (north, east, -up)

    @property
    def enu(self) -> tuple[float, float, float]:
        """East, north, up."""
        north, east, up = self[:3]  # type: ignore[index]  # mixed into NamedTuples only
        return (east, north, up)


@quick
class _AccelerationFields(NamedTuple):
    north_m_s2: float
    east_m_s2: float
    up_m_s2: float


class Acceleration(_AccelerationFields, _GroundVector):
    """Linear acceleration, ground frame, m/s², without gravity, in both :class:`AccelerationMode`.

    None until the mode is known (errata 44).
    """

    __slots__ = ()


class AccelerationMode(StrEnum):
    """The setting of the PC assistant by which the aircraft sends acceleration (errata 44)."""

    FUSED = "fused"
    """In m/s² of the ground frame without gravity. At rest it is 0, 0, 0."""

    RAW = "raw"
    """In g of the body frame with gravity. Forward, right and down are 0, 0 and −1 at rest."""


@quick
class _VelocityFields(NamedTuple):
    north_m_s: float
    east_m_s: float
    up_m_s: float
    status: int | None


class Velocity(_VelocityFields, _GroundVector):
    """Linear velocity, ground frame, m/s.

    ``status`` is the status byte of firmware 2.3 and 3.1, None before.
    """

    __slots__ = ()

    @property
    def is_valid(self) -> bool | None:
        """Whether the aircraft trusts the value; None where the firmware does not say."""
        return None if self.status is None else bool(self.status & 1)

    @property
    def sensor(self) -> int | None:
        """Source of the value in firmware 2.3: 3 GPS, 4 monocular, 5 stereo."""
        return None if self.status is None else self.status >> 1 & 0x0F

    @property
    def ground_speed_m_s(self) -> float:
        """Horizontal speed."""
        return math.hypot(self.north_m_s, self.east_m_s)


@quick
class AngularVelocity(NamedTuple):
    """Angular velocity about the body axes, rad/s (errata 43), right-handed."""

    forward_rad_s: float
    right_rad_s: float
    down_rad_s: float

    @property
    def roll_rate_deg_s(self) -> float:
        """About the forward axis, positive right side down."""
        return math.degrees(self.forward_rad_s)

    @property
    def pitch_rate_deg_s(self) -> float:
        """About the right axis, positive nose up."""
        return math.degrees(self.right_rad_s)

    @property
    def yaw_rate_deg_s(self) -> float:
        """About the down axis, positive clockwise from above."""
        return math.degrees(self.down_rad_s)


_MAX_LATITUDE_RAD = math.radians(89.0)


@quick
class Position(NamedTuple):
    """Position by GPS and barometer."""

    latitude_rad: float  #: WGS 84 latitude, as on the wire.
    longitude_rad: float  #: WGS 84 longitude, as on the wire.
    altitude_m: float  #: Barometric altitude.
    height_m: float  #: Height above the take-off point; meaningless before the first take-off.
    #: 0 to 5; from 3 on good enough for position control. None under ``1.0-document``, whose table
    #: has no such byte.
    gps_health: int | None

    @property
    def is_possible(self) -> bool:
        """Whether this can be a place: finite numbers, a latitude within ±89°.

        Nearer to a pole there is no local frame to measure in.
        """
        return (
            abs(self.latitude_rad) <= _MAX_LATITUDE_RAD
            and abs(self.longitude_rad) <= 2 * math.pi
            and math.isfinite(self.altitude_m)
            and math.isfinite(self.height_m)
        )

    @property
    def latitude_deg(self) -> float:
        """Latitude in degrees, north positive."""
        return math.degrees(self.latitude_rad)

    @property
    def longitude_deg(self) -> float:
        """Longitude in degrees, east positive."""
        return math.degrees(self.longitude_rad)


@quick
class Magnetometer(NamedTuple):
    """Magnetometer, raw numbers; a magnitude of 1000 to 2000 is normal."""

    x: float
    y: float
    z: float


class RcMode(IntEnum):
    """Mode switch of the remote controller, by its telemetry value."""

    P = -8000
    A = 0
    F = 8000


@quick
class RemoteControl(NamedTuple):
    """Channels of the remote controller, raw.

    Sticks run from −10000 (left, down) to 10000 (right, up). ``gear`` is −10000 up, −4545 down;
    None under ``1.0-document``.
    """

    roll: int
    pitch: int
    yaw: int
    throttle: int
    mode: int
    gear: int | None

    @property
    def mode_switch(self) -> RcMode:
        """The nearest position of the mode switch."""
        if self.mode > RcMode.F // 2:
            return RcMode.F
        return RcMode.A if self.mode >= RcMode.P // 2 else RcMode.P

    @property
    def is_in_f(self) -> bool:
        """Whether the mode switch stands in F, the position that allows API control."""
        return self.mode_switch is RcMode.F

    @property
    def is_heard(self) -> bool:
        """False while all channels read 0, as ETHZ's driver expects of a remote that is off.

        Neither position of the gear is 0. Such channels are not in F.
        """
        return self.gear is None or any(self)


@quick
class Gimbal(NamedTuple):
    """Gimbal attitude, ground frame; roll and yaw are unreliable near pitch −90.

    ``limits`` (firmware 3.1): bit 0 pitch, 1 roll, 2 yaw at its stop.
    """

    roll_deg: float
    pitch_deg: float
    yaw_deg: float
    limits: int | None


class FlightPhase(IntEnum):
    """Values of the flight status item; the document has the item but not its values."""

    STANDBY = 1
    TAKING_OFF = 2
    IN_AIR = 3
    LANDING = 4
    FINISHING_LANDING = 5


@quick
class FlightStatus(NamedTuple):
    """Flight status, raw; ``phase`` gives it a name."""

    status: int

    @property
    def phase(self) -> FlightPhase | None:
        """The phase, None for a number that no source lists."""
        try:
            return FlightPhase(self.status)
        except ValueError:
            return None

    @property
    def is_airborne(self) -> bool:
        """Off the ground: in the air or landing."""
        return self.status in (FlightPhase.IN_AIR, FlightPhase.LANDING)


@quick
class Battery(NamedTuple):
    """Battery charge."""

    percent: int

    @property
    def is_possible(self) -> bool:
        """Whether this can be a charge: 100 % or less."""
        return self.percent <= 100


class Device(IntEnum):
    """A device that can control the aircraft."""

    RC = 0
    APP = 1
    ONBOARD = 2


@quick
class ControlDevice(NamedTuple):
    """The device that controls the aircraft (CTRL_DEVICE)."""

    control: int  #: Raw byte, a number in firmware 1.0, bit fields later (errata 47).
    #: Present control mode of firmware 3.1 (0 none, 1 to 14 as the setpoints), else None.
    mode: int | None

    @property
    def device(self) -> Device | None:
        """The device, None for a number that no source lists."""
        try:
            return Device(self.control & 0x07)
        except ValueError:
            return None

    @property
    def is_requested(self) -> bool:
        """Whether the onboard device has asked for control (firmware 2.3 and 3.1)."""
        return bool(self.control & 0x08)

    @property
    def is_virtual_rc(self) -> bool:
        """Whether the virtual remote controller is on (firmware 3.1)."""
        return bool(self.control & 0x10)
