"""The camera: 0x01/0x20 to 0x22 of firmware 2.3 on; the V1.0.1 document only announces them.

Nothing tells what became of these commands, in no firmware: a program can only say "sent".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Self

from m100link.protocol.command import Address, Push, in_range
from m100link.protocol.firmware import FirmwareProfile, Generation


class _CameraCommand(Push):
    """One byte that may be anything, as in the version query."""

    __slots__ = ()

    any: int

    LEVEL: ClassVar[int] = 1
    ENCRYPTED: ClassVar[bool] = True
    SINCE: ClassVar[Generation] = Generation.V2_3

    def value(self, profile: FirmwareProfile) -> bytes:
        """One byte.

        Raises ``BadValue``: it does not fit.
        """
        in_range("any", self.any, 0, 255)
        return bytes((self.any,))

    @classmethod
    def parse(cls, value: bytes, profile: FirmwareProfile) -> Self:
        """Any value will do."""
        return cls(value[0] if value else 0)  # type: ignore[call-arg]  # the three are dataclasses

    def fields(self) -> dict[str, Any]:
        """Nothing: the byte has no meaning."""
        return {}

    def raw(self) -> dict[str, Any]:
        """The byte that may be anything."""
        return {"any": self.any}


@dataclass(frozen=True, slots=True)
class TakePhoto(_CameraCommand):
    """0x01/0x20, take one photograph."""

    ADDRESS: ClassVar[Address] = Address(0x01, 0x20)
    NAME: ClassVar[str] = "take_photo"

    any: int = 0


@dataclass(frozen=True, slots=True)
class StartVideo(_CameraCommand):
    """0x01/0x21, start recording video."""

    ADDRESS: ClassVar[Address] = Address(0x01, 0x21)
    NAME: ClassVar[str] = "start_video"

    any: int = 0


@dataclass(frozen=True, slots=True)
class StopVideo(_CameraCommand):
    """0x01/0x22, stop recording video."""

    ADDRESS: ClassVar[Address] = Address(0x01, 0x22)
    NAME: ClassVar[str] = "stop_video"

    any: int = 0
