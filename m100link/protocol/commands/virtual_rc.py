"""Command set 0x05 of firmware 3.1: a remote control made of commands, beside the pilot's own.

It flies the aircraft without control authority, so these are movement: no program sends them past
what watches over flying.
"""

from __future__ import annotations

from dataclasses import dataclass
from struct import Struct
from typing import Any, ClassVar, Self

from m100link.protocol.command import Address, Movement, exactly, in_range
from m100link.protocol.firmware import FirmwareProfile, Generation

__all__ = ["CENTRE", "CHANNELS", "TRAVEL", "VirtualRcData", "VirtualRcSettings"]

CENTRE, TRAVEL = 1024, 660
"""Each channel is 1024 ± 660."""

CHANNELS = ("roll", "pitch", "throttle", "yaw", "gear", "go_home", "mode")
"""The channels that mean something, in the order of the wire; nine more are spare."""

_DATA = Struct("<16I")


@dataclass(frozen=True, slots=True)
class VirtualRcSettings(Movement):
    """0x05/0x00, switch the virtual remote control on or off; at most every two seconds.

    DJI's header warns that more often locks the aircraft in a loop of checks in which even the mode
    switch does nothing. Bits 2 to 7 are uninitialised in DJI's programs and mean nothing.

    Attributes:
        is_on: On or off.
        falls_back: When the channels stop coming the real remote control flies; otherwise the
            aircraft behaves as if the remote control were lost.
    """

    ADDRESS: ClassVar[Address] = Address(0x05, 0x00)
    NAME: ClassVar[str] = "virtual_rc_settings"
    ENCRYPTED: ClassVar[bool] = True
    SINCE: ClassVar[Generation] = Generation.V3_1

    is_on: bool
    falls_back: bool = True

    def value(self, profile: FirmwareProfile) -> bytes:
        """One byte."""
        return bytes((self.is_on | self.falls_back << 1,))

    @classmethod
    def parse(cls, value: bytes, profile: FirmwareProfile) -> Self:
        """One byte. Later libraries of DJI send channels under this id, too: those are refused."""
        (flags,) = exactly(value, 1, cls.NAME)
        return cls(bool(flags & 1), bool(flags & 2))


@dataclass(frozen=True, slots=True)
class VirtualRcData(Movement):
    """0x05/0x01, sticks and switches, 2 to 25 times a second; a second without them ends it.

    Attributes:
        channels: 16 values of 1024 ± 660, the first seven as :data:`CHANNELS` names them. Gear is
            1684 up and 1324 down; mode is 1552 for P, 1024 for A, 496 for F.
    """

    ADDRESS: ClassVar[Address] = Address(0x05, 0x01)
    NAME: ClassVar[str] = "virtual_rc_data"
    ENCRYPTED: ClassVar[bool] = True
    SINCE: ClassVar[Generation] = Generation.V3_1

    channels: tuple[int, ...]

    def value(self, profile: FirmwareProfile) -> bytes:
        """64 bytes.

        Raises:
            UsageError: Not 16 channels, or one beyond its range.
        """
        in_range("number of channels", len(self.channels), 16, 16)
        for channel, value in enumerate(self.channels):
            in_range(f"channel {channel}", value, CENTRE - TRAVEL, CENTRE + TRAVEL)
        return _DATA.pack(*self.channels)

    @classmethod
    def parse(cls, value: bytes, profile: FirmwareProfile) -> Self:
        """64 bytes; channels beyond their range are kept as they came."""
        return cls(_DATA.unpack(exactly(value, _DATA.size, cls.NAME)))

    def fields(self) -> dict[str, Any]:
        """The channels that mean something by name, and all of them as they are."""
        return dict(zip(CHANNELS, self.channels, strict=False)) | {"channels": list(self.channels)}
