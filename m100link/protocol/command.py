"""Base classes of commands, which declare address, sender, session and both directions.

Each command of the document is a frozen dataclass in the module of its command set, and one of
four kinds: a :class:`Request` wants an ack and says what the ack tells, a :class:`Push` has none, a
:class:`Movement` is a push that flies, a :class:`Notification` comes from the aircraft. ``encode``
gives the data of a frame, ``parse`` reads them back on the other side of the cable; ``parse_ack``
and ``encode_ack`` do the same for the answer.
"""

from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, NamedTuple, Self, TypeVar, get_args, get_origin

from m100link.errors import BadAck, BadValue
from m100link.protocol.codes import AckCode, SystemCode
from m100link.protocol.firmware import FirmwareProfile, Generation
from m100link.session.events import SessionMode

A = TypeVar("A")

_INNER_CAPITAL = re.compile("(?<=.)(?=[A-Z])")


class Address(NamedTuple):
    """Command set and command id: the first two bytes of a command or push."""

    command_set: int
    command_id: int

    def __str__(self) -> str:
        return f"0x{self.command_set:02X}/0x{self.command_id:02X}"


class Problem(NamedTuple):
    """A value outside its documented range."""

    field: str  #: Name of the field on the wire.
    value: Any  #: Its value.
    limit: str  #: The permitted values, in words.

    def __str__(self) -> str:
        return f"{self.field} is {self.value!r}, allowed: {self.limit}"

    def error(self, name: str) -> BadValue:
        """The same as an error, of the command of that name."""
        return BadValue(
            f"{name}: {self.field} {self.value!r} cannot be sent",
            field=self.field,
            value=self.value,
            limit=self.limit,
            remedy=f"allowed: {self.limit}",
        )


class Command:
    """Base of the four kinds of commands.

    Attributes:
        ADDRESS: Command set and id.
        NAME: The word for it in logs, errors and the CLI: ``start_task`` for ``StartTask``.
        LEVEL: Authorization level that the aircraft asks for (document 2.1).
        ENCRYPTED: Whether it is sent encrypted as soon as there is a key.
        SESSION_MODE: How it is sent; follows from the kind.
        SINCE: The first generation of firmware that knows it.
        NEEDS_ACTIVATION: Whether the aircraft refuses it before activation.
        MOVES: Whether each one sets the aircraft in motion: :attr:`sets_in_motion`.
    """

    __slots__ = ()

    ADDRESS: ClassVar[Address]
    NAME: ClassVar[str]
    LEVEL: ClassVar[int] = 0
    ENCRYPTED: ClassVar[bool] = False
    SESSION_MODE: ClassVar[SessionMode] = SessionMode.NO_ACK
    SINCE: ClassVar[Generation] = Generation.V1_0
    NEEDS_ACTIVATION: ClassVar[bool] = True
    MOVES: ClassVar[bool] = False

    _PREFIX: ClassVar[bytes]

    def __init_subclass__(cls, *, address: tuple[int, int] | None = None, **data: Any) -> None:
        """The class data that are named, in lower case.

        A dataclass with slots is made a second time, without them: then they stand in the class.
        """
        super().__init_subclass__()
        for name, value in data.items():
            if name.upper() not in Command.__annotations__:
                raise TypeError(f"{cls.__name__}: commands have no {name}")
            setattr(cls, name.upper(), value)
        if address is not None:
            cls.ADDRESS = Address(*address)
        if hasattr(cls, "ADDRESS"):  # the four kinds have none
            cls._PREFIX = bytes(cls.ADDRESS)
            if "NAME" not in vars(cls):
                cls.NAME = _INNER_CAPITAL.sub("_", cls.__name__).lower()

    @property
    def needs_known_firmware(self) -> bool:
        """Whether it is kept back from an unknown firmware: set 0x00 is alike in all of them."""
        return self.ADDRESS.command_set != 0x00

    @classmethod
    def is_known_to(cls, profile: FirmwareProfile) -> bool:
        """Whether a firmware has this command."""
        return profile.generation >= cls.SINCE

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

    @property
    def name(self) -> str:
        """The word for this one: ``NAME``, except where an address has several kinds."""
        return self.NAME

    @property
    def sets_in_motion(self) -> bool:
        """Whether the aircraft begins to fly a mission, or flies it otherwise, because of it.

        Such a request leaves through a control block alone, as movement does.
        """
        return self.MOVES

    def fields(self) -> dict[str, Any]:
        """The decoded fields as JSON-ready values, in units for people."""
        return {name: plain(getattr(self, name)) for name in field_names(self)}

    def raw(self) -> dict[str, Any]:
        """The fields as on the wire; empty for a command of the document without a layout."""
        return {}

    def problems(self) -> list[Problem]:
        """The values of a later command outside their documented range, for people."""
        return []


class Acknowledged(Generic[A]):
    """A command that has an ack, or had one in some firmware.

    Attributes:
        ANSWER: Class of the ack's data: the class in the brackets.
        ACK_CODE_SIZES: Sizes that the code of the ack may have.
        ACK_IS_PLAIN: Whether the ack is plain even when the request was encrypted; all others are
            encrypted as their request.
        UNREADABLE: Answer of the aircraft to a value that it cannot read; where the sources
            are silent, that there is no such command.
    """

    __slots__ = ()

    NAME: ClassVar[str]
    ANSWER: ClassVar[type[Any]]
    ACK_CODE_SIZES: ClassVar[tuple[int, ...]] = (2,)
    ACK_IS_PLAIN: ClassVar[bool] = False
    UNREADABLE: ClassVar[AckCode] = SystemCode.NOT_SUPPORTED

    def __init_subclass__(cls, **data: Any) -> None:
        super().__init_subclass__(**data)
        for base in cls.__dict__.get("__orig_bases__", ()):
            origin = get_origin(base)
            if isinstance(origin, type) and issubclass(origin, Acknowledged):
                (answer,) = get_args(base)
                if isinstance(answer, type):  # and not the letter of a class between
                    cls.ANSWER = answer

    @classmethod
    def parse_ack(cls, payload: bytes) -> A:
        """Read the data of an ack frame.

        Raises:
            BadAck: Too short.
        """
        answer: A = cls.ANSWER(read_code(cls.NAME, payload, cls.ACK_CODE_SIZES))
        return answer

    @classmethod
    def ack_fields(cls, answer: Any) -> dict[str, Any]:
        """The decoded ack as JSON-ready values, in units for people."""
        return {"ack": plain(answer)}

    @classmethod
    def ack_raw(cls, answer: Any) -> dict[str, Any]:
        """The fields of the ack as on the wire."""
        return {"code": int(answer)} if isinstance(answer, AckCode) else {}

    @classmethod
    def ack_problems(cls, answer: Any) -> list[Problem]:
        """The values of the ack outside their documented range, for people."""
        return []

    @classmethod
    def code_of(cls, answer: Any) -> AckCode | None:
        """The code in an answer by which the request was taken or refused."""
        return answer if isinstance(answer, AckCode) else None

    @classmethod
    def unreadable(cls, profile: FirmwareProfile) -> AckCode:
        """The answer of a firmware to a value that it cannot read."""
        return cls.UNREADABLE

    @classmethod
    def encode_ack(cls, answer: Any) -> bytes:
        """The data of an ack frame with that answer, or with a system code in its place."""
        return encode_code(answer)


class Request(Acknowledged[A], Command):
    """A command with an ack. ``class Arm(Request[ArmCode])`` says that its ack is that code."""

    __slots__ = ()

    SESSION_MODE: ClassVar[SessionMode] = SessionMode.RELIABLE


class Push(Command):
    """A command without an ack: sent, and nobody says whether it arrived."""

    __slots__ = ()


class Movement(Command):
    """A push that flies the aircraft. It leaves through :class:`m100link.Control` alone."""

    __slots__ = ()


class Notification(Command):
    """A command that the aircraft sends unasked."""

    __slots__ = ()

    @classmethod
    def when_unreadable(cls) -> Self | None:
        """The substitute for one whose value cannot be read, or None to ignore it."""
        return None


@dataclass(frozen=True, slots=True)
class Unrecognised:
    """A command or push that cannot be read."""

    address: Address | None  #: Set and id, or None when there are fewer than two bytes.
    value: bytes  #: The bytes behind them.
    reason: str  #: Why it could not be read.


def field_names(command: Command) -> list[str]:
    """Names of the fields of a command, which is a dataclass."""
    # ``__dataclass_fields__`` would name the class variables, too.
    fields = dataclasses.fields(command)  # type: ignore[arg-type]  # the subclasses are dataclasses
    return [field.name for field in fields if field.init]  # the others follow from these


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

    Raises ``BadAck``: the ack is shorter than its code.
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


def exactly(value: bytes, size: int, name: str) -> bytes:
    """The value, if it has that size.

    Raises ``ValueError``: it has another.
    """
    if len(value) != size:
        raise ValueError(f"{name} takes {size} byte(s), there are {len(value)}")
    return value


def in_range(name: str, number: float, low: float, high: float, unit: str = "") -> None:
    """Check a number before it is sent.

    Raises ``BadValue``: it lies outside, or is not a number.
    """
    if not low <= number <= high:
        limit = f"{low:g} to {high:g} {unit}".rstrip()
        raise BadValue(
            f"{name} {number:g} {unit}".rstrip() + " cannot be sent",
            field=name,
            value=number,
            limit=limit,
            remedy=f"stay within {limit}",
        )


def encode_code(code: int) -> bytes:
    """An ack that is a code and nothing else."""
    return code.to_bytes(2, "little")
