"""Firmware profiles: what differs between the aircraft that speak this protocol, as data.

The document describes the first public firmware; aircraft in the field run later ones. Where the
document contradicts itself or DJI's own programs, docs/explanation/errata.md says which reading was
taken and why. Nothing here decides anything: code asks the profile.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum

from m100link.errors import UsageError
from m100link.protocol.items import BY_NAME, ItemLayout, layouts

__all__ = [
    "FIRMWARE_1_0",
    "FIRMWARE_1_0_DOCUMENT",
    "FIRMWARE_2_3",
    "FIRMWARE_3_1",
    "PROFILES",
    "FirmwareProfile",
    "FlagBit0",
    "profile",
]


class FlagBit0(Enum):
    """Meaning of bit 0 of the movement control flag (errata 9)."""

    YAW_FRAME = "yaw frame: 0 ground, 1 body"
    STABLE_MODE = "stable mode: 1 brakes smoothly and holds the place"


# Equal to itself only: what is worked out of a profile is kept under it, and looked up per frame.
@dataclass(frozen=True, slots=True, eq=False)
class FirmwareProfile:
    """Everything in which one firmware differs from another.

    A profile for another firmware is made of one of these with :func:`dataclasses.replace`, and
    goes wherever the name of one goes.

    Attributes:
        name: ``"1.0"``, ``"2.3"``, ``"3.1"`` or ``"1.0-document"``.
        summary: One sentence for people.
        version_name: Text that the version query answers (errata 16).
        has_serial: The version ack carries a hardware serial (49 bytes instead of 38).
        activation_version: Version word of the activation request; None leaves it to the developer.
        has_level: The activation request carries the authorization level.
        tick_hz: Ticks per second of the telemetry clock (errata 42).
        items: Layout per telemetry item, by name; an item that is left out is not sent.
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
        item_flags: The bits of its items in the flag word of telemetry.

    Raises:
        UsageError: An item that does not exist, or fields that it does not have.
    """

    name: str
    summary: str
    version_name: str
    has_serial: bool
    activation_version: int | None
    has_level: bool
    tick_hz: int
    items: Mapping[str, ItemLayout]
    throttle_before_yaw: bool
    flag_bit0: FlagBit0
    tilt_frame_selectable: bool
    authority_requests: int
    needs_f_toggle: bool
    ioc_must_be_off: bool
    has_rates_command: bool
    has_arm_command: bool
    item_flags: int = field(init=False, repr=False)

    def __post_init__(self) -> None:
        flags = 0
        for name, layout in self.items.items():
            item = BY_NAME.get(name)
            if item is None:
                raise UsageError(
                    f"no telemetry item is called {name!r}", remedy=f"items: {', '.join(BY_NAME)}"
                )
            item.check(layout)
            flags |= 1 << item.bit
        in_order = {name: self.items[name] for name in BY_NAME if name in self.items}
        object.__setattr__(self, "items", in_order)
        object.__setattr__(self, "item_flags", flags)

    def __str__(self) -> str:
        return self.name


FIRMWARE_1_0 = FirmwareProfile(
    name="1.0",
    summary="first public firmware, June 2015: the document as DJI's own sample reads it",
    version_name="SDK-v1.0 BETA M100-01.00.00.00",
    has_serial=False,
    activation_version=None,
    has_level=True,
    tick_hz=600,
    items=layouts("1.0"),
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
    items=layouts("1.0", "2.3"),
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
    items=layouts("1.0", "2.3", "3.1"),
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
    items=layouts("1.0", "1.0-document"),
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
