"""Command set 0x02: pushes of the aircraft (document 2.2.3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Self

from m100link.protocol.command import Notification
from m100link.protocol.commands.activation import MobileData
from m100link.protocol.fields import Laid, Layout, Number
from m100link.protocol.firmware import FirmwareProfile
from m100link.protocol.packet import TelemetryPacket

AUTHORITY_LOST = 0x04  # the fixed value of the authority notification


@dataclass(frozen=True, slots=True)
class PushTelemetry(Notification, address=(0x02, 0x00), name="telemetry"):
    """0x02/0x00, the telemetry package."""

    packet: TelemetryPacket

    def value(self, profile: FirmwareProfile) -> bytes:
        """The flag word and the items."""
        return self.packet.value

    @classmethod
    def parse(cls, value: bytes, profile: FirmwareProfile) -> Self:
        """A value whose length fits its flags under the profile."""
        return cls(TelemetryPacket(value, profile))

    def fields(self) -> dict[str, Any]:
        """Items by name, raw wire values."""
        return {"telemetry": self.packet.raw_items(), "flags": self.packet.flags}


@dataclass(frozen=True, slots=True)
class AuthorityChanged(Laid, Notification, address=(0x02, 0x01)):
    """0x02/0x01, control authority passed away from the onboard device.

    Sent once, on session 0 or on a session that wants an ack (errata 30).
    """

    LAYOUT: ClassVar[Layout] = Layout(Number("code"))

    code: int = AUTHORITY_LOST  # the document fixes it to 4

    @classmethod
    def when_unreadable(cls) -> Self:
        """A loss all the same: to believe in authority that is gone is the worse error."""
        return cls()


@dataclass(frozen=True, slots=True)
class FromMobile(MobileData, Notification, address=(0x02, 0x02)):
    """0x02/0x02, transparent data from the mobile device, 1 to 100 bytes, about 1 kB/s."""
