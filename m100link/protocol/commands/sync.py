"""Command set 0x04 of firmware 3.1: a pulse to synchronise sensors with.

The Matrice 100 has no output for it, and ignores the command.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Self

from m100link.protocol.command import Address, Push
from m100link.protocol.fields import Laid, Layout, Number
from m100link.protocol.firmware import FirmwareProfile, Generation

_WITH_TAG = 6


@dataclass(frozen=True, slots=True)
class Sync(Laid, Push):
    """0x04/0x00, pulses of a frequency; a Matrice 100 ignores it.

    Attributes:
        frequency: Hertz; 0 gives a single pulse.
        tag: Two more bytes that DJI's libraries from 3.3 on send; None without them.
    """

    ADDRESS: ClassVar[Address] = Address(0x04, 0x00)
    NAME: ClassVar[str] = "sync"
    ENCRYPTED: ClassVar[bool] = True
    SINCE: ClassVar[Generation] = Generation.V3_1
    LAYOUT: ClassVar[Layout] = Layout(Number("frequency", "I"))

    frequency: int
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
