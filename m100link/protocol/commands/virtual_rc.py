"""Command sets 0x05 and 0x04 of firmware 3.1: the virtual remote control, and a pulse for sensors.

The remote control is made of commands, beside the pilot's own. It flies the aircraft without
control authority, so these are movement: no program sends them past what watches over flying.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

from m100link.protocol.command import Movement, Problem, Push, exactly
from m100link.protocol.fields import Laid, Layout, Number, Numbers
from m100link.protocol.firmware import FirmwareProfile, Generation

CENTRE, TRAVEL = 1024, 660  # each channel is 1024 ± 660

CHANNELS = ("roll", "pitch", "throttle", "yaw", "gear", "go_home", "mode")
"""The channels that mean something, in the order of the wire; nine more are spare."""


@dataclass(frozen=True, slots=True)
class VirtualRcSettings(Movement, address=(0x05, 0x00), encrypted=True, since=Generation.V3_1):
    """0x05/0x00, switch the virtual remote control on or off; at most every two seconds.

    DJI's header warns that more often locks the aircraft in a loop of checks in which even the mode
    switch does nothing. Bits 2 to 7 are uninitialised in DJI's programs and mean nothing.
    """

    is_on: bool  #: On or off.
    #: When the channels stop coming the real remote control flies; otherwise the aircraft behaves
    #: as if the remote control were lost.
    falls_back: bool = True
    #: Bits 2 to 7 as another program sent them; they have no meaning.
    rest: int = field(default=0, compare=False)

    @property
    def _flags(self) -> int:
        return self.is_on | self.falls_back << 1 | self.rest

    def value(self, profile: FirmwareProfile) -> bytes:
        """One byte.

        Raises:
            BadValue: A bit without a meaning.
        """
        for problem in self.problems():
            raise problem.error(self.NAME)
        return bytes((self._flags,))

    @classmethod
    def parse(cls, value: bytes, profile: FirmwareProfile) -> Self:
        """One byte. Later libraries of DJI send channels under this id, too: those are refused."""
        (flags,) = exactly(value, 1, cls.NAME)
        return cls(bool(flags & 1), bool(flags & 2), flags & ~3)

    def fields(self) -> dict[str, Any]:
        """The two bits that have a meaning."""
        return {"is_on": self.is_on, "falls_back": self.falls_back}

    def raw(self) -> dict[str, Any]:
        """All bits as one number."""
        return {"flags": self._flags}

    def problems(self) -> list[Problem]:
        """Bits that are uninitialised in DJI's programs; the aircraft ignores them."""
        return [Problem("flags", self._flags, "0 to 3")] if self.rest else []


@dataclass(frozen=True, slots=True)
class VirtualRcData(Laid, Movement, address=(0x05, 0x01), encrypted=True, since=Generation.V3_1):
    """0x05/0x01, sticks and switches, 2 to 25 times a second; a second without them ends it."""

    LAYOUT: ClassVar[Layout] = Layout(
        Numbers("channels", 16, Number("channel", "I", CENTRE - TRAVEL, CENTRE + TRAVEL))
    )

    #: 16 values of 1024 ± 660, the first seven as :data:`CHANNELS` names them. Gear is 1684 up and
    #: 1324 down; mode is 1552 for P, 1024 for A, 496 for F.
    channels: tuple[int, ...]

    def fields(self) -> dict[str, Any]:
        """The channels that mean something by name, and all of them as they are."""
        return dict(zip(CHANNELS, self.channels, strict=False)) | self.raw()


# -- command set 0x04 of firmware 3.1: a pulse to synchronise sensors with -------------------------
# The Matrice 100 has no output for it, and ignores the command.


_WITH_TAG = 6


@dataclass(frozen=True, slots=True)
class Sync(Laid, Push, address=(0x04, 0x00), encrypted=True, since=Generation.V3_1):
    """0x04/0x00, pulses of a frequency; a Matrice 100 ignores it."""

    LAYOUT: ClassVar[Layout] = Layout(Number("frequency", "I"))

    frequency: int  #: Hertz; 0 gives a single pulse.
    #: Two more bytes that DJI's libraries from 3.3 on send; None without them.
    tag: int | None = None

    def value(self, profile: FirmwareProfile) -> bytes:
        """4 bytes, or 6 with a tag."""
        tag = b"" if self.tag is None else self.tag.to_bytes(2, "little")
        return super(Sync, self).value(profile) + tag

    @classmethod
    def parse(cls, value: bytes, profile: FirmwareProfile) -> Self:
        """4 bytes, or 6 with a tag."""
        if len(value) != _WITH_TAG:
            return super(Sync, cls).parse(value, profile)
        return cls(int.from_bytes(value[:4], "little"), int.from_bytes(value[4:], "little"))

    def fields(self) -> dict[str, Any]:
        """In hertz."""
        return {"frequency_hz": self.frequency}
