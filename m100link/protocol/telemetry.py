"""Telemetry: item records, and packets that read them from the wire when asked (document 2.2.3.1).

A packet is a flag word and the items whose bits are set, in bit order and without gaps. Sizes and
fields per firmware stand in :mod:`m100link.protocol.firmware`; here they become records.

A record's fields are the raw wire values under names that say unit, axis and frame; properties give
the other views. Ground frame: north, east, up (up is positive although the document's frame is
north-east-down; errata, vertical sign). Body frame: forward, right, down.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import IntEnum, IntFlag
from functools import lru_cache
from operator import itemgetter
from struct import Struct
from typing import Any, NamedTuple, TypeVar

from m100link.errors import LayoutMismatch
from m100link.protocol.firmware import ITEM_NAMES, PROFILES, FirmwareProfile, ItemLayout

__all__ = [
    "RECORDS",
    "RECORD_NAMES",
    "Acceleration",
    "AngularVelocity",
    "Attitude",
    "Battery",
    "ControlDevice",
    "Device",
    "FlightPhase",
    "FlightStatus",
    "Gimbal",
    "ItemFlag",
    "Magnetometer",
    "Position",
    "RcMode",
    "Record",
    "RecordViews",
    "RemoteControl",
    "TelemetryPacket",
    "Time",
    "Velocity",
    "encode_telemetry",
    "fitting_profiles",
    "telemetry_size",
]


class ItemFlag(IntFlag):
    """Presence bits of the flag word."""

    TIME = 1 << 0
    QUATERNION = 1 << 1
    ACCELERATION = 1 << 2
    VELOCITY = 1 << 3
    ANGULAR_VELOCITY = 1 << 4
    POSITION = 1 << 5
    MAGNETOMETER = 1 << 6
    RC = 1 << 7
    GIMBAL = 1 << 8
    FLIGHT_STATUS = 1 << 9
    BATTERY = 1 << 10
    CONTROL_DEVICE = 1 << 11


ALL_ITEMS = (1 << len(ITEM_NAMES)) - 1


class Time(NamedTuple):
    """Clock of the aircraft.

    Attributes:
        tick: Counter since power-on, wraps at 2³².
        nanoseconds: Nanosecond field of firmware 3.1; its relation to the tick is undocumented.
        sync: Sync flag of firmware 3.1; the Matrice 100 has no sync output.
        tick_hz: Ticks per second, 600 or 400 by firmware.
    """

    tick: int
    nanoseconds: int | None
    sync: int | None
    tick_hz: int

    @property
    def seconds(self) -> float:
        """The tick in seconds since power-on (modulo the wrap, 82 or 124 days)."""
        return self.tick / self.tick_hz


class Attitude(NamedTuple):
    """Attitude as a unit quaternion from ground (north-east-down) to body (forward-right-down).

    Attributes:
        q0: Scalar part. Level and facing north is (1, 0, 0, 0).
        q1: Forward axis.
        q2: Right axis.
        q3: Down axis.
    """

    q0: float
    q1: float
    q2: float
    q3: float

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


class _AccelerationFields(NamedTuple):
    north_m_s2: float
    east_m_s2: float
    up_m_s2: float


class Acceleration(_AccelerationFields, _GroundVector):
    """Linear acceleration, ground frame, m/s² (the assistant can switch it to raw, errata 44)."""

    __slots__ = ()


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


class Position(NamedTuple):
    """Position by GPS and barometer.

    Attributes:
        latitude_rad: WGS 84 latitude, as on the wire.
        longitude_rad: WGS 84 longitude, as on the wire.
        altitude_m: Barometric altitude.
        height_m: Height above the take-off point; meaningless before the first take-off.
        gps_health: 0 to 5; from 3 on good enough for position control. None under
            ``1.0-document``, whose table has no such byte.
    """

    latitude_rad: float
    longitude_rad: float
    altitude_m: float
    height_m: float
    gps_health: int | None

    @property
    def latitude_deg(self) -> float:
        """Latitude in degrees, north positive."""
        return math.degrees(self.latitude_rad)

    @property
    def longitude_deg(self) -> float:
        """Longitude in degrees, east positive."""
        return math.degrees(self.longitude_rad)


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


class Battery(NamedTuple):
    """Battery charge."""

    percent: int


class Device(IntEnum):
    """Who controls the aircraft."""

    RC = 0
    APP = 1
    ONBOARD = 2


class ControlDevice(NamedTuple):
    """Who controls the aircraft (CTRL_DEVICE).

    Attributes:
        control: Raw byte: a number in firmware 1.0, bit fields later (errata 47).
        mode: Present control mode of firmware 3.1 (0 none, 1 to 14 as the setpoints), else None.
    """

    control: int
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


Record = (
    Time
    | Attitude
    | Acceleration
    | Velocity
    | AngularVelocity
    | Position
    | Magnetometer
    | RemoteControl
    | Gimbal
    | FlightStatus
    | Battery
    | ControlDevice
)
"""Any telemetry record."""

RECORDS: tuple[type[Any], ...] = (
    Time,
    Attitude,
    Acceleration,
    Velocity,
    AngularVelocity,
    Position,
    Magnetometer,
    RemoteControl,
    Gimbal,
    FlightStatus,
    Battery,
    ControlDevice,
)
"""Record class per item, in the order of the flag bits."""

RECORD_NAMES: dict[type[Any], str] = dict(zip(RECORDS, ITEM_NAMES, strict=True))
"""Item name per record class."""

_INDEX: dict[type[Any], int] = {record: index for index, record in enumerate(RECORDS)}

# Wire name of each record field, in the record's order; a layout may lack some or reorder them.
_WIRE_FIELDS: tuple[tuple[str, ...], ...] = (
    ("tick", "nanoseconds", "sync"),
    ("q0", "q1", "q2", "q3"),
    ("x", "y", "z"),
    ("x", "y", "z", "status"),
    ("x", "y", "z"),
    ("latitude_rad", "longitude_rad", "altitude", "height", "gps_health"),
    ("x", "y", "z"),
    ("roll", "pitch", "yaw", "throttle", "mode", "gear"),
    ("roll", "pitch", "yaw", "limits"),
    ("status",),
    ("percent",),
    ("control", "mode"),
)

R = TypeVar("R", bound=tuple[Any, ...])
_Values = tuple[Any, ...]
_Pick = Callable[[_Values], _Values]
_new = tuple.__new__

_LACKING, _TICK_HZ = -2, -1  # behind unpacked values stand None and the tick rate


def _picker(index: int, layout: ItemLayout, start: int) -> _Pick:
    """How the fields of a record are picked out of unpacked values, those of the item at start."""
    places = [
        start + layout.fields.index(name) if name in layout.fields else _LACKING
        for name in _WIRE_FIELDS[index]
    ]
    if RECORDS[index] is Time:
        places.append(_TICK_HZ)
    first, end = places[0], places[0] + len(places)
    if places == list(range(first, end)):
        return itemgetter(slice(first, end))
    return itemgetter(*places)


class _Plan:
    """Where everything is in a packet with one set of flags under one profile.

    Attributes:
        size: Bytes of the packet.
        pack: Makes a packet of flag word and values.
        unpack: Reads all of them at once.
        extras: What has to follow unpacked values before records are picked out of them.
        items: Per item its offset, how to read it alone, and how to pick its record.
        records: Record class per item, and how to pick it out of all values.
    """

    __slots__ = ("extras", "items", "pack", "records", "size", "unpack")

    def __init__(self, flags: int, profile: FirmwareProfile) -> None:
        self.extras = (None, profile.tick_hz)
        self.items: dict[int, tuple[int, Callable[[bytes, int], _Values], _Pick]] = {}
        self.records: list[tuple[type[Any], _Pick]] = []
        whole, start = Struct("<H"), 1
        for index, layout in enumerate(profile.items):
            if flags >> index & 1:
                alone = Struct("<" + layout.format)
                self.items[index] = (whole.size, alone.unpack_from, _picker(index, layout, 0))
                self.records.append((RECORDS[index], _picker(index, layout, start)))
                whole = Struct(whole.format + layout.format)
                start += len(layout.fields)
        self.size, self.pack, self.unpack = whole.size, whole.pack, whole.unpack


@lru_cache(maxsize=4 * 4096)
def _plan(flags: int, profile_name: str) -> _Plan:
    return _Plan(flags, PROFILES[profile_name])


def telemetry_size(flags: int, profile: FirmwareProfile) -> int:
    """Bytes of a telemetry value with these flags, flag word included."""
    return _plan(flags & ALL_ITEMS, profile.name).size


def fitting_profiles(value: bytes) -> list[str]:
    """Names of the profiles under which a telemetry value has the right length."""
    if len(value) < 2:
        return []
    flags = value[0] | value[1] << 8
    return [p.name for p in PROFILES.values() if telemetry_size(flags, p) == len(value)]


class RecordViews(ABC):
    """A property per record, for whatever can look one up by its class."""

    __slots__ = ()

    @abstractmethod
    def get(self, record: type[R]) -> R | None:
        """The record of that class, None when there is none."""

    @property
    def time(self) -> Time | None:
        """Clock of the aircraft."""
        return self.get(Time)

    @property
    def attitude(self) -> Attitude | None:
        """Attitude quaternion."""
        return self.get(Attitude)

    @property
    def acceleration(self) -> Acceleration | None:
        """Linear acceleration."""
        return self.get(Acceleration)

    @property
    def velocity(self) -> Velocity | None:
        """Linear velocity."""
        return self.get(Velocity)

    @property
    def angular_velocity(self) -> AngularVelocity | None:
        """Angular velocity."""
        return self.get(AngularVelocity)

    @property
    def position(self) -> Position | None:
        """Position, altitude, height and GPS health."""
        return self.get(Position)

    @property
    def magnetometer(self) -> Magnetometer | None:
        """Magnetometer."""
        return self.get(Magnetometer)

    @property
    def remote_control(self) -> RemoteControl | None:
        """Channels of the remote controller."""
        return self.get(RemoteControl)

    @property
    def gimbal(self) -> Gimbal | None:
        """Gimbal attitude."""
        return self.get(Gimbal)

    @property
    def flight_status(self) -> FlightStatus | None:
        """Flight status."""
        return self.get(FlightStatus)

    @property
    def battery(self) -> Battery | None:
        """Battery charge."""
        return self.get(Battery)

    @property
    def control_device(self) -> ControlDevice | None:
        """Who controls the aircraft."""
        return self.get(ControlDevice)


class TelemetryPacket(RecordViews):
    """One telemetry package. Items are read from the bytes when they are asked for.

    Args:
        value: The command value: flag word and items.
        profile: Firmware profile of the sender.

    Raises:
        LayoutMismatch: The length does not fit the flags under this profile, or reserved bits
            are set. (It is also what :meth:`Command.parse` callers see as a ``ValueError``.)
    """

    __slots__ = ("_plan", "flags", "profile", "value")

    def __init__(self, value: bytes, profile: FirmwareProfile) -> None:
        size = len(value)
        flags = value[0] | value[1] << 8 if size >= 2 else ~ALL_ITEMS
        plan = _plan(flags & ALL_ITEMS, profile.name)
        if flags & ~ALL_ITEMS or size != plan.size:
            raise _mismatch(value, profile)
        self.value = value
        self.profile = profile
        self.flags = flags
        self._plan = plan

    @property
    def indices(self) -> Iterable[int]:
        """Bit numbers of the items that the packet carries, ascending."""
        return self._plan.items

    def get(self, record: type[R]) -> R | None:
        """The record of that class, None when the packet does not carry it."""
        plan = self._plan
        place = plan.items.get(_INDEX[record])
        if place is None:
            return None
        offset, unpack, pick = place
        return _new(record, pick(unpack(self.value, offset) + plan.extras))

    def row(self) -> tuple[float, ...]:
        """Every raw value that the packet carries, in wire order, named by :attr:`columns`.

        The fastest way to read a whole packet, for logs and arrays.
        """
        return self._plan.unpack(self.value)[1:]

    @property
    def columns(self) -> tuple[str, ...]:
        """Name of each value of :meth:`row`: item and wire field, such as ``position.height``."""
        return tuple(
            f"{ITEM_NAMES[index]}.{field}"
            for index in self._plan.items
            for field in self.profile.items[index].fields
        )

    def records(self) -> list[Any]:
        """Every record that the packet carries, in bit order."""
        plan = self._plan
        values = plan.unpack(self.value) + plan.extras
        return [_new(record, pick(values)) for record, pick in plan.records]

    def raw_items(self) -> dict[str, dict[str, Any]]:
        """Raw values by item name and wire field name, for dumps and golden vectors."""
        return {
            ITEM_NAMES[index]: dict(
                zip(
                    self.profile.items[index].fields,
                    unpack(self.value, offset),
                    strict=True,
                )
            )
            for index, (offset, unpack, _) in self._plan.items.items()
        }

    def __repr__(self) -> str:
        return f"TelemetryPacket({', '.join(map(repr, self.records()))})"


def _mismatch(value: bytes, profile: FirmwareProfile) -> LayoutMismatch:
    others = [name for name in fitting_profiles(value) if name != profile.name]
    if len(value) < 2:
        seen = f"a telemetry value of {len(value)} byte(s) has no flag word"
    else:
        flags = value[0] | value[1] << 8
        seen = (
            f"telemetry with flags 0x{flags:04X} takes {telemetry_size(flags, profile)} bytes "
            f"under firmware {profile}, there are {len(value)}"
        )
        if flags > ALL_ITEMS:
            seen = f"telemetry flags 0x{flags:04X} have reserved bits set"
    return LayoutMismatch(
        seen,
        cause=f"the aircraft speaks firmware {' or '.join(others)}" if others else "",
        remedy=f"choose firmware={others[0]!r}" if others else "compare the firmware version",
    )


def encode_telemetry(items: Mapping[str, Sequence[float]], profile: FirmwareProfile) -> bytes:
    """Build a telemetry value.

    Args:
        items: Raw values per item name in wire order.
        profile: Layout to use.

    Raises:
        struct.error: Values that do not fit the layout.
        KeyError: An item name that does not exist.
    """
    unknown = set(items) - set(ITEM_NAMES)
    if unknown:
        raise KeyError(unknown.pop())
    flags = 0
    values: list[float] = []
    for bit, name in enumerate(ITEM_NAMES):
        if name in items:
            flags |= 1 << bit
            values += items[name]
    return _plan(flags, profile.name).pack(flags, *values)
