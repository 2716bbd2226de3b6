"""Firmware profiles: the differences between aircraft that speak this protocol, as data.

The document describes the first public firmware; aircraft in the field run later ones. Where the
document contradicts itself or DJI's own programs, docs/explanation/errata.md says which reading was
taken and why. Nothing here decides anything: code asks the profile.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum, IntEnum
from typing import Any

from m100link.errors import UsageError
from m100link.protocol.items import BY_NAME, ItemLayout, layouts


class Generation(IntEnum):
    """Firmware as the commands see it: each generation knows those of the earlier ones, too."""

    V1_0 = 1
    V2_3 = 2
    V3_1 = 3

    def __str__(self) -> str:
        return self.name[1:].replace("_", ".")


class FlagBit0(Enum):
    """Meaning of bit 0 of the movement control flag (errata 9)."""

    YAW_FRAME = "yaw frame: 0 ground, 1 body"
    STABLE_MODE = "stable mode: 1 brakes smoothly and holds the place"


_HARDWARE_VERSION = re.compile(r"\S+-\d\d\.\d\d\.\d+\.\d+")
# "SDK vX.X XXXX": all that the document of 1.0 prints, and nobody has a text of such an aircraft.
_WITHOUT_HARDWARE = re.compile(r"SDK[ -]v\d+\.\d+( \w+)?")


# Equal to itself only: what is worked out of a profile is kept under it, and looked up per frame.
@dataclass(frozen=True, slots=True, eq=False)
class FirmwareProfile:
    """Everything in which one firmware differs from another.

    A profile for another firmware is made of one of these with :func:`dataclasses.replace`, and
    goes wherever the name of one goes.

    Raises:
        UsageError: An item that does not exist, or fields that it does not have.
    """

    name: str  #: ``"1.0"``, ``"2.3"``, ``"3.1"`` or ``"1.0-document"``.
    summary: str  #: One sentence for people.
    version_name: str  #: Text that the version query answers (errata 16).
    has_serial: bool  #: The version ack carries a hardware serial (49 bytes instead of 38).
    #: Beginnings of the hardware version, in that text, by which an aircraft is recognised; ``""``
    #: means a text of the document's form "SDK vX.X XXXX", without any. None at all, only when
    #: forced.
    hardware_versions: tuple[str, ...]
    #: As what the telemetry of an unknown firmware is read whose version ack is of the same size.
    reads_unknown: bool
    #: Version word of the activation request; None leaves it to the developer.
    activation_version: int | None
    has_level: bool  #: The activation request carries the authorization level.
    tick_hz: int  #: Ticks per second of the telemetry clock (errata 42).
    #: Layout per telemetry item, by name; an item that is left out is not sent.
    items: Mapping[str, ItemLayout]
    #: Order of the last two movement values. The document prints yaw first, every program that DJI
    #: shipped sends throttle first (errata 1).
    throttle_before_yaw: bool
    flag_bit0: FlagBit0  #: Meaning of bit 0 of the control flag.
    tilt_frame_selectable: bool  #: Whether tilt obeys the frame bit; otherwise it is always body.
    #: Requests needed to obtain or release authority; with 2 the first is answered "in progress"
    #: (errata 24).
    authority_requests: int
    authority_refusal_has_reason: bool  #: A refusal tells "not in F" from "IOC is on".
    #: The control device item shows whether authority is requested (errata 47).
    shows_authority_request: bool
    #: The velocity status byte names the source of the value (errata 46).
    velocity_names_sensor: bool
    needs_f_toggle: bool  #: F already chosen at power-on needs the switch moved away and back.
    ioc_must_be_off: bool  #: IOC forbids authority.
    generation: Generation  #: Which commands it knows, as each command says since when it exists.
    #: The bits of its items in the flag word of telemetry.
    item_flags: int = field(init=False, repr=False)
    #: What ``m100link.protocol.packet`` has worked out, per flag word of these items.
    plans: dict[int, Any] = field(init=False, repr=False, default_factory=dict)

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

    def recognises(self, version_name: str, *, has_serial: bool) -> bool:
        """Whether a version answer is that of this firmware.

        Args:
            version_name: Text of the answer.
            has_serial: Whether it carried a hardware serial.
        """
        hardware = _HARDWARE_VERSION.search(version_name)
        if hardware is None and not _WITHOUT_HARDWARE.fullmatch(version_name):
            return False
        begins = f"{hardware[0] if hardware else ''}.".startswith
        return has_serial is self.has_serial and any(
            begins(f"{version}.") for version in self.hardware_versions
        )


FIRMWARE_1_0 = FirmwareProfile(
    name="1.0",
    summary="first public firmware, June 2015: the document as DJI's own sample reads it",
    version_name="SDK-v1.0 BETA M100-01.00.00.00",
    has_serial=False,
    hardware_versions=("M100-01", ""),
    reads_unknown=True,
    activation_version=None,
    has_level=True,
    tick_hz=600,
    items=layouts("1.0"),
    throttle_before_yaw=True,
    flag_bit0=FlagBit0.YAW_FRAME,
    tilt_frame_selectable=False,
    authority_requests=1,
    authority_refusal_has_reason=False,
    shows_authority_request=False,
    velocity_names_sensor=False,
    needs_f_toggle=True,
    ioc_must_be_off=True,
    generation=Generation.V1_0,
)

FIRMWARE_2_3 = replace(
    FIRMWARE_1_0,
    name="2.3",
    summary="September 2015 to early 2016: velocity status byte, authority takes two requests",
    version_name="SDK-v1.0 BETA M100-02.03.10.00",
    hardware_versions=("M100-02.03",),
    reads_unknown=False,
    activation_version=0x02030A00,
    items=layouts("1.0", "2.3"),
    tilt_frame_selectable=True,
    authority_requests=2,
    authority_refusal_has_reason=True,
    shows_authority_request=True,
    velocity_names_sensor=True,
    generation=Generation.V2_3,
)

FIRMWARE_3_1 = replace(
    FIRMWARE_2_3,
    name="3.1",
    summary="2016 on, most aircraft still flying: longer telemetry items, 400 Hz tick",
    version_name="SDK-v1.0 BETA M100-03.01.01.00",
    has_serial=True,
    hardware_versions=("M100-03.01",),
    reads_unknown=True,
    activation_version=0x03010A00,
    has_level=False,
    tick_hz=400,
    items=layouts("1.0", "2.3", "3.1"),
    flag_bit0=FlagBit0.STABLE_MODE,
    needs_f_toggle=False,
    ioc_must_be_off=False,
    velocity_names_sensor=False,
    generation=Generation.V3_1,
)

FIRMWARE_1_0_DOCUMENT = replace(
    FIRMWARE_1_0,
    name="1.0-document",
    summary="the V1.0.1 document's tables to the letter, to study it and old logs; "
    "no aircraft is known to speak it, so do not fly with it",
    hardware_versions=(),
    reads_unknown=False,
    items=layouts("1.0", "1.0-document"),
    throttle_before_yaw=False,
)

PROFILES = {p.name: p for p in (FIRMWARE_1_0, FIRMWARE_2_3, FIRMWARE_3_1, FIRMWARE_1_0_DOCUMENT)}
"""Every profile by name."""


def names_hardware(version_name: str) -> bool:
    """Whether a version text says which aircraft it is, in which version."""
    return _HARDWARE_VERSION.search(version_name) is not None


def recognised(version_name: str, *, has_serial: bool) -> FirmwareProfile | None:
    """The listed profile of the aircraft that answers so; None for an unknown firmware."""
    answers = (p for p in PROFILES.values() if p.recognises(version_name, has_serial=has_serial))
    return next(answers, None)


def reads_unknown(*, has_serial: bool) -> FirmwareProfile:
    """As what the telemetry of an unknown firmware is read: what does not fit is refused anyway."""
    alike = (p for p in PROFILES.values() if p.reads_unknown and p.has_serial is has_serial)
    return next(alike, FIRMWARE_1_0)


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
