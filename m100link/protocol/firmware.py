"""Firmware profiles: what differs between the aircraft that speak this protocol, as data.

The document describes the first public firmware; aircraft in the field run later ones. Where the
document contradicts itself or DJI's own programs, docs/explanation/errata.md says which reading was
taken and why. Nothing here decides anything: code asks the profile.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from struct import Struct

from m100link.errors import UsageError

__all__ = [
    "FIRMWARE_1_0",
    "FIRMWARE_1_0_DOCUMENT",
    "FIRMWARE_2_3",
    "FIRMWARE_3_1",
    "ITEM_NAMES",
    "PROFILES",
    "FirmwareProfile",
    "FlagBit0",
    "ItemLayout",
    "profile",
]

ITEM_NAMES = (
    "time",
    "quaternion",
    "acceleration",
    "velocity",
    "angular_velocity",
    "position",
    "magnetometer",
    "rc",
    "gimbal",
    "flight_status",
    "battery",
    "control_device",
)
"""The telemetry items in the order of their flag bits (document 2.2.3.1)."""


class FlagBit0(Enum):
    """Meaning of bit 0 of the movement control flag (errata 9)."""

    YAW_FRAME = "yaw frame: 0 ground, 1 body"
    STABLE_MODE = "stable mode: 1 brakes smoothly and holds the place"


@dataclass(frozen=True, slots=True)
class ItemLayout:
    """Bytes of one telemetry item: little-endian, packed.

    Attributes:
        format: Format characters of :mod:`struct`, without byte order.
        fields: Name per value, in wire order.
    """

    format: str
    fields: tuple[str, ...]

    @property
    def size(self) -> int:
        """Bytes on the wire."""
        return Struct("<" + self.format).size


@dataclass(frozen=True, slots=True)
class FirmwareProfile:
    """Everything in which one firmware differs from another.

    Attributes:
        name: ``"1.0"``, ``"2.3"``, ``"3.1"`` or ``"1.0-document"``.
        summary: One sentence for people.
        version_name: Text that the version query answers (errata 16).
        has_serial: The version ack carries a hardware serial (49 bytes instead of 38).
        activation_version: Version word of the activation request; None leaves it to the developer.
        has_level: The activation request carries the authorization level.
        tick_hz: Ticks per second of the telemetry clock (errata 42).
        items: Layout per telemetry item, in flag-bit order.
        throttle_before_yaw: Order of the last two movement values. The document prints yaw first,
            every program that DJI shipped sends throttle first (errata 1).
        flag_bit0: Meaning of bit 0 of the control flag.
        tilt_frame_selectable: Whether tilt obeys the frame bit; otherwise it is always body.
        authority_requests: Requests needed to obtain or release authority; with 2 the first is
            answered "in progress" (errata 24).
        needs_f_toggle: F already chosen at power-on needs the switch moved away and back.
        ioc_must_be_off: IOC forbids authority.
        has_rates_command: 0x00/0x10, telemetry rates from the serial side.
        has_arm_command: 0x01/0x05, motors on and off.
    """

    name: str
    summary: str
    version_name: str
    has_serial: bool
    activation_version: int | None
    has_level: bool
    tick_hz: int
    items: tuple[ItemLayout, ...]
    throttle_before_yaw: bool
    flag_bit0: FlagBit0
    tilt_frame_selectable: bool
    authority_requests: int
    needs_f_toggle: bool
    ioc_must_be_off: bool
    has_rates_command: bool
    has_arm_command: bool

    def __str__(self) -> str:
        return self.name


_XYZ = ("x", "y", "z")
_ITEMS_1_0 = (
    ItemLayout("I", ("tick",)),
    ItemLayout("4f", ("q0", "q1", "q2", "q3")),
    ItemLayout("3f", _XYZ),
    ItemLayout("3f", _XYZ),
    ItemLayout("3f", _XYZ),
    ItemLayout("2d2fB", ("latitude_rad", "longitude_rad", "altitude", "height", "gps_health")),
    ItemLayout("3h", _XYZ),
    ItemLayout("6h", ("roll", "pitch", "yaw", "throttle", "mode", "gear")),
    ItemLayout("3f", ("roll", "pitch", "yaw")),
    ItemLayout("B", ("status",)),
    ItemLayout("B", ("percent",)),
    ItemLayout("B", ("control",)),
)


def _with(items: tuple[ItemLayout, ...], **changes: ItemLayout) -> tuple[ItemLayout, ...]:
    changed = dict(zip(ITEM_NAMES, items, strict=True)) | changes
    return tuple(changed.values())


_ITEMS_2_3 = _with(_ITEMS_1_0, velocity=ItemLayout("3fB", (*_XYZ, "status")))
_ITEMS_3_1 = _with(
    _ITEMS_2_3,
    time=ItemLayout("2IB", ("tick", "nanoseconds", "sync")),
    gimbal=ItemLayout("3fB", ("roll", "pitch", "yaw", "limits")),
    control_device=ItemLayout("2B", ("mode", "control")),
)
_ITEMS_1_0_DOCUMENT = _with(
    _ITEMS_1_0,
    position=ItemLayout("2d2f", ("longitude_rad", "latitude_rad", "altitude", "height")),
    magnetometer=ItemLayout("3f", _XYZ),
    rc=ItemLayout("5h", ("roll", "pitch", "yaw", "throttle", "mode")),
)

FIRMWARE_1_0 = FirmwareProfile(
    name="1.0",
    summary="first public firmware, June 2015: the document as DJI's own sample reads it",
    version_name="SDK-v1.0 BETA M100-01.00.00.00",
    has_serial=False,
    activation_version=None,
    has_level=True,
    tick_hz=600,
    items=_ITEMS_1_0,
    throttle_before_yaw=True,
    flag_bit0=FlagBit0.YAW_FRAME,
    tilt_frame_selectable=False,
    authority_requests=1,
    needs_f_toggle=True,
    ioc_must_be_off=True,
    has_rates_command=False,
    has_arm_command=False,
)

FIRMWARE_2_3 = replace(
    FIRMWARE_1_0,
    name="2.3",
    summary="September 2015 to early 2016: velocity status byte, authority takes two requests",
    version_name="SDK-v1.0 BETA M100-02.03.10.00",
    activation_version=0x02030A00,
    items=_ITEMS_2_3,
    tilt_frame_selectable=True,
    authority_requests=2,
)

FIRMWARE_3_1 = replace(
    FIRMWARE_2_3,
    name="3.1",
    summary="2016 on, most aircraft still flying: longer telemetry items, 400 Hz tick",
    version_name="SDK-v1.0 BETA M100-03.01.01.00",
    has_serial=True,
    activation_version=0x03010A00,
    has_level=False,
    tick_hz=400,
    items=_ITEMS_3_1,
    flag_bit0=FlagBit0.STABLE_MODE,
    needs_f_toggle=False,
    ioc_must_be_off=False,
    has_rates_command=True,
    has_arm_command=True,
)

FIRMWARE_1_0_DOCUMENT = replace(
    FIRMWARE_1_0,
    name="1.0-document",
    summary="the V1.0.1 document's tables to the letter, to study it and old logs; "
    "no aircraft is known to speak it, so do not fly with it",
    items=_ITEMS_1_0_DOCUMENT,
    throttle_before_yaw=False,
)

PROFILES = {p.name: p for p in (FIRMWARE_1_0, FIRMWARE_2_3, FIRMWARE_3_1, FIRMWARE_1_0_DOCUMENT)}
"""Every profile by name."""


def profile(name: str | FirmwareProfile) -> FirmwareProfile:
    """Look a profile up by name.

    Raises:
        UsageError: There is none of that name; the message lists them.
    """
    if isinstance(name, FirmwareProfile):
        return name
    try:
        return PROFILES[name]
    except KeyError:
        raise UsageError(
            f"no firmware profile is called {name!r}",
            remedy=f"choose one of {', '.join(PROFILES)}",
        ) from None
