"""What a command is: an address, a value, and the meaning of its ack.

Each command of the document is a frozen dataclass in the module of its command set. ``encode``
gives the data of a frame, ``parse`` reads them back on the other side of the cable, ``parse_ack``
reads the answer.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Self

from m100link.errors import BadAck
from m100link.protocol.codes import AckCode
from m100link.protocol.firmware import FirmwareProfile

__all__ = ["Address", "Command", "Unrecognised", "encode_code", "read_code"]


class Address(NamedTuple):
    """Command set and command id: the first two bytes of a command or push."""

    command_set: int
    command_id: int

    def __str__(self) -> str:
        return f"0x{self.command_set:02X}/0x{self.command_id:02X}"


class Command:
    """Base of every command and push.

    Attributes:
        ADDRESS: Command set and id.
        NAME: The word for it in logs, errors and the CLI.
        CODES: Enum of its ack code; None when the command has no ack.
    """

    __slots__ = ()

    ADDRESS: ClassVar[Address]
    NAME: ClassVar[str]
    CODES: ClassVar[type[AckCode] | None] = None
    ACK_CODE_SIZES: ClassVar[tuple[int, ...]] = (2,)

    _PREFIX: ClassVar[bytes]

    def __init_subclass__(cls) -> None:
        cls._PREFIX = bytes(cls.ADDRESS)

    def encode(self, profile: FirmwareProfile) -> bytes:
        """The data of the frame: set, id, value."""
        return self._PREFIX + self.value(profile)

    def value(self, profile: FirmwareProfile) -> bytes:
        """The command value alone."""
        raise TypeError(f"{type(self).__name__} has no value")  # every subclass overrides this

    @classmethod
    def parse(cls, value: bytes, profile: FirmwareProfile) -> Self:
        """Read a command value.

        Raises:
            ValueError: The value cannot be one of this command; the text says why.
        """
        raise ValueError(f"{cls.__name__} is never parsed")

    @classmethod
    def parse_ack(cls, payload: bytes) -> Any:
        """Read the data of an ack frame: the ack code, or what carries it.

        Raises:
            BadAck: Too short.
        """
        assert cls.CODES is not None, f"{cls.NAME} has no ack"
        return cls.CODES(read_code(cls.NAME, payload, cls.ACK_CODE_SIZES))

    def fields(self) -> dict[str, Any]:
        """The decoded fields as JSON-ready values."""
        return {name: plain(getattr(self, name)) for name in field_names(self)}


@dataclass(frozen=True, slots=True)
class Unrecognised:
    """A command or push that cannot be read.

    Attributes:
        address: Set and id, or None when there are fewer than two bytes.
        value: The bytes behind them.
        reason: Why it could not be read.
    """

    address: Address | None
    value: bytes
    reason: str


def field_names(command: Command) -> list[str]:
    """Names of the fields of a command, which is a dataclass."""
    # ``__dataclass_fields__`` would name the class variables, too.
    fields = dataclasses.fields(command)  # type: ignore[arg-type]  # the subclasses are dataclasses
    return [field.name for field in fields]


def plain(value: Any) -> Any:
    """A field as JSON can carry it."""
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, AckCode):
        return {"code": int(value), "name": value.name, "meaning": value.meaning}
    return value


def read_code(name: str, payload: bytes, sizes: tuple[int, ...] = (2,)) -> int:
    """The ack code at the start of an ack.

    Two bytes, little-endian; where ``sizes`` allows it one byte is taken as well (errata 12).

    Raises:
        BadAck: The ack is shorter than its code.
    """
    if len(payload) >= 2:
        return payload[0] | payload[1] << 8
    if payload and 1 in sizes:
        return payload[0]
    raise BadAck(
        f"the ack of {name} has {len(payload)} byte(s), its code alone takes 2",
        command=name,
        payload=payload,
        cause="another firmware than the chosen profile, or a damaged simulator",
        remedy="compare the firmware version with the profile in use",
    )


def encode_code(code: int) -> bytes:
    """An ack that is a code and nothing else."""
    return code.to_bytes(2, "little")
