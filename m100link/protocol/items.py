"""The telemetry items: one table, from which everything that enumerates items is derived.

An item has a bit in the flag word, a name, a record that users see, and a layout on the wire, which
some firmwares changed (document 2.2.3.1; the later layouts are those of DJI's own programs). To add
one: a record in :mod:`m100link.protocol.records`, a row and a view here, and a reader in
:mod:`m100link.sim.vehicle.sensors`.
"""

from __future__ import annotations

import struct
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from m100link.errors import UsageError
from m100link.protocol.records import (
    Acceleration,
    AngularVelocity,
    Attitude,
    Battery,
    ControlDevice,
    FlightStatus,
    Gimbal,
    Magnetometer,
    Position,
    RemoteControl,
    Time,
    Velocity,
)

R = TypeVar("R", bound=tuple[Any, ...])


@dataclass(frozen=True, slots=True)
class ItemLayout:
    """Bytes of one telemetry item: little-endian, packed.

    Raises:
        UsageError: The format is not one, or has another number of values than there are names.
    """

    format: str  #: Format characters of :mod:`struct`, without byte order.
    fields: tuple[str, ...]  #: Name per value, in wire order.

    def __post_init__(self) -> None:
        try:
            count = len(struct.unpack("<" + self.format, bytes(self.size)))
        except struct.error as error:
            raise UsageError(f"{self.format!r} is not a layout: {error}") from None
        if count != len(self.fields):
            raise UsageError(f"layout {self.format!r} has {count} values, not {self.fields}")

    @property
    def size(self) -> int:
        """Bytes on the wire."""
        return struct.calcsize("<" + self.format)

    def span(self, field: str) -> slice:
        """Which of the item's bytes are that field's: those without which it has another value.

        Raises:
            ValueError: The layout has no such field.
        """
        place = self.fields.index(field)
        unpack = struct.Struct("<" + self.format).unpack
        zero = unpack(bytes(self.size))[place]
        own = [
            at
            for at in range(self.size)
            if unpack(bytes(at) + b"\xff" + bytes(self.size - at - 1))[place] != zero
        ]
        return slice(own[0], own[-1] + 1) if own else slice(0, 0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Item:
    """One telemetry item.

    Raises ``UsageError``: the parts do not fit each other.
    """

    bit: int  # its bit in the flag word
    name: str  # its name in rates, columns and logs
    record: type[Any]  # the record that users see
    rate_hz: int  # default rate (document 2.2.3.1): 0 (not sent), 1, 10, 50 or 100 Hz
    fields: tuple[str, ...]  # wire name of each field of the record, in the record's order
    # The last fields of the record, which are attributes of the profile and not on the wire.
    profile_fields: tuple[str, ...] = ()
    layouts: Mapping[str, ItemLayout]  # its layout by the name of the firmware that brought it
    views: tuple[str, ...] = ()  # properties of the record that are columns beside its fields

    def __post_init__(self) -> None:
        if len(self.record._fields) != len(self.fields) + len(self.profile_fields):
            raise UsageError(f"{self.name}: {self.record.__name__} has other fields than its item")
        for view in self.views:
            if not hasattr(self.record, view):
                raise UsageError(f"{self.name}: {self.record.__name__} has no view {view}")
        for layout in self.layouts.values():
            self.check(layout)

    def check(self, layout: ItemLayout) -> None:
        """Refuse a layout with values that are not in the record.

        Raises ``UsageError``: there is one, or there are none at all.
        """
        strangers = set(layout.fields) - set(self.fields)
        if strangers or not layout.fields:
            raise UsageError(
                f"item {self.name} cannot have the fields {layout.fields}",
                remedy=f"its fields: {', '.join(self.fields)}",
            )


def _layout(format_: str, fields: str) -> ItemLayout:
    return ItemLayout(format_, tuple(fields.split()))


_XYZ = ("x", "y", "z")

ITEMS: tuple[Item, ...] = (
    Item(
        bit=0,
        name="time",
        record=Time,
        rate_hz=100,
        fields=("tick", "nanoseconds", "sync"),
        profile_fields=("tick_hz",),
        layouts={"1.0": _layout("I", "tick"), "3.1": _layout("2IB", "tick nanoseconds sync")},
        views=("seconds",),
    ),
    Item(
        bit=1,
        name="quaternion",
        record=Attitude,
        rate_hz=100,
        fields=("q0", "q1", "q2", "q3"),
        layouts={"1.0": _layout("4f", "q0 q1 q2 q3")},
        views=("roll_deg", "pitch_deg", "yaw_deg"),
    ),
    Item(
        bit=2,
        name="acceleration",
        record=Acceleration,
        rate_hz=100,
        fields=_XYZ,
        layouts={"1.0": ItemLayout("3f", _XYZ)},
    ),
    Item(
        bit=3,
        name="velocity",
        record=Velocity,
        rate_hz=100,
        fields=(*_XYZ, "status"),
        layouts={"1.0": ItemLayout("3f", _XYZ), "2.3": ItemLayout("3fB", (*_XYZ, "status"))},
        views=("ground_speed_m_s",),
    ),
    Item(
        bit=4,
        name="angular_velocity",
        record=AngularVelocity,
        rate_hz=100,
        fields=_XYZ,
        layouts={"1.0": ItemLayout("3f", _XYZ)},
        views=("roll_rate_deg_s", "pitch_rate_deg_s", "yaw_rate_deg_s"),
    ),
    Item(
        bit=5,
        name="position",
        record=Position,
        rate_hz=100,
        fields=("latitude_rad", "longitude_rad", "altitude", "height", "gps_health"),
        layouts={
            "1.0": _layout("2d2fB", "latitude_rad longitude_rad altitude height gps_health"),
            "1.0-document": _layout("2d2f", "longitude_rad latitude_rad altitude height"),
        },
        views=("latitude_deg", "longitude_deg"),
    ),
    Item(
        bit=6,
        name="magnetometer",
        record=Magnetometer,
        rate_hz=0,
        fields=_XYZ,
        layouts={"1.0": ItemLayout("3h", _XYZ), "1.0-document": ItemLayout("3f", _XYZ)},
    ),
    Item(
        bit=7,
        name="rc",
        record=RemoteControl,
        rate_hz=50,
        fields=("roll", "pitch", "yaw", "throttle", "mode", "gear"),
        layouts={
            "1.0": _layout("6h", "roll pitch yaw throttle mode gear"),
            "1.0-document": _layout("5h", "roll pitch yaw throttle mode"),
        },
        views=("mode_switch",),
    ),
    Item(
        bit=8,
        name="gimbal",
        record=Gimbal,
        rate_hz=50,
        fields=("roll", "pitch", "yaw", "limits"),
        layouts={
            "1.0": _layout("3f", "roll pitch yaw"),
            "3.1": _layout("3fB", "roll pitch yaw limits"),
        },
    ),
    Item(
        bit=9,
        name="flight_status",
        record=FlightStatus,
        rate_hz=10,
        fields=("status",),
        layouts={"1.0": _layout("B", "status")},
        views=("phase",),
    ),
    Item(
        bit=10,
        name="battery",
        record=Battery,
        rate_hz=1,
        fields=("percent",),
        layouts={"1.0": _layout("B", "percent")},
    ),
    Item(
        bit=11,
        name="control_device",
        record=ControlDevice,
        rate_hz=0,
        fields=("control", "mode"),
        layouts={"1.0": _layout("B", "control"), "3.1": _layout("2B", "mode control")},
        views=("device",),
    ),
)
"""Every telemetry item, in the order of the flag bits."""

BY_NAME: dict[str, Item] = {item.name: item for item in ITEMS}
"""The items by name, in the order of the flag bits."""

BY_RECORD: dict[type[Any], Item] = {item.record: item for item in ITEMS}
"""The items by record class, in the order of the flag bits."""


def item_of(record: type[Any]) -> Item:
    """The item that becomes that record.

    Raises ``UsageError``: not a telemetry record.
    """
    for item in ITEMS:
        if item.record is record:
            return item
    raise UsageError(
        f"{record!r} is not a telemetry record",
        remedy="use m100link.Attitude, m100link.Position, …",
    )


def layouts(*firmwares: str) -> dict[str, ItemLayout]:
    """Layout per item name of a firmware that descends from these.

    ``firmwares``: names of the firmwares that brought layouts, the oldest first. A later layout
    replaces an earlier one; an item that none of them brought is left out. Raises ``UsageError``:
    one of them brought no layout at all.
    """
    found: dict[str, ItemLayout] = {}
    for firmware in firmwares:
        brought = {i.name: i.layouts[firmware] for i in ITEMS if firmware in i.layouts}
        if not brought:
            raise UsageError(f"no telemetry item has a layout of firmware {firmware!r}")
        found |= brought
    return found


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
        """The device that controls the aircraft."""
        return self.get(ControlDevice)
