"""Acks of command set 0x03: they begin with a code of one byte, where all others have two.

Where two bytes 0xFF00, 0xFF01 or 0xFF02 stand alone they are taken for the system code that they
are: no waypoint has index 0xFF.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar, Generic, Self, TypeVar, cast, get_args

from m100link.errors import BadAck
from m100link.protocol.codes import AckCode, MissionCode, SystemCode
from m100link.protocol.command import (
    Acknowledged,
    Command,
    Movement,
    Problem,
    Request,
    encode_code,
    plain,
)
from m100link.protocol.fields import Record
from m100link.protocol.firmware import Generation

A = TypeVar("A")
R = TypeVar("R", bound=Record)

_SYSTEM_CODES = frozenset(map(int, SystemCode))


class _MissionCommand(Command):
    """What all commands of the set have in common."""

    __slots__ = ()

    LEVEL: ClassVar[int] = 2
    ENCRYPTED: ClassVar[bool] = True
    SINCE: ClassVar[Generation] = Generation.V3_1


class Answer(Record):
    """An ack of set 0x03 with more than its code; ``LAYOUT`` is what stands behind that.

    Attributes:
        code: The code.
    """

    __slots__ = ()

    code: MissionCode

    @classmethod
    def size(cls) -> int:
        """Bytes behind the code."""
        return cls.LAYOUT.size

    @classmethod
    def of(cls, code: MissionCode, tail: bytes) -> Self:
        """An answer from its code and the bytes behind it."""
        return cls(code=code, **cls.LAYOUT.read(tail))  # type: ignore[call-arg]  # a dataclass

    def tail(self) -> bytes:
        """The bytes behind the code."""
        return self.LAYOUT.write(self)

    def raw(self) -> dict[str, Any]:
        """The code and the fields behind it, as on the wire: a system code stands alone."""
        code = {"code": int(self.code)}
        return code if self.code.is_system else code | self._tail_raw()

    def _tail_raw(self) -> dict[str, Any]:
        return self.LAYOUT.raw(self)


class DownloadAnswer(Answer, ABC, Generic[R]):
    """A code and what was uploaded, as the aircraft has it; zeros when it has none.

    ``class X(DownloadAnswer[Y])`` is a dataclass of a code and a Y.
    """

    __slots__ = ()

    RECORD: ClassVar[type[Record]]

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        for base in cls.__dict__.get("__orig_bases__", ()):
            (cls.RECORD,) = get_args(base)

    @classmethod
    def size(cls) -> int:
        """As the upload."""
        return cls.RECORD.LAYOUT.size

    @classmethod
    def of(cls, code: MissionCode, tail: bytes) -> Self:
        """The tail is the value of the upload."""
        return cls(code, cls.RECORD.from_wire(tail))  # type: ignore[call-arg]  # a dataclass

    @property
    @abstractmethod
    def record(self) -> R:
        """What was uploaded."""

    def tail(self) -> bytes:
        """What the aircraft has is sent as it is."""
        return self.record.LAYOUT.write(self.record)

    def _tail_raw(self) -> dict[str, Any]:
        return self.record.raw()

    def problems(self) -> list[Problem]:
        """Those of the upload."""
        return self.record.problems()

    def shown(self) -> dict[str, Any]:
        """The upload for people."""
        return self.record.shown()


class _MissionAck(Acknowledged[A]):
    """Acks that begin with a code of one byte."""

    __slots__ = ()

    UNREADABLE: ClassVar[AckCode] = MissionCode.BAD_PARAMETERS

    @classmethod
    def _tail_size(cls) -> int:
        return cls.ANSWER.size() if issubclass(cls.ANSWER, Answer) else 0

    @classmethod
    def parse_ack(cls, payload: bytes) -> A:
        """A code and what stands behind it.

        A refusal may be its code alone; what should stand behind it is then zero. A download that
        is longer than the upload was is none that anybody knows: DJI's programs drop it, and zeros
        at its beginning do not mean that nothing is stored.

        Raises ``BadAck``: empty, a success that is too short, or a download that is too long.
        """
        size = cls._tail_size()
        if issubclass(cls.ANSWER, DownloadAnswer) and len(payload) > 1 + size:
            raise _bad_size(cls.NAME, payload, size)
        code, tail = _split(cls.NAME, payload, size)
        answer: Any = cls.ANSWER.of(code, tail) if issubclass(cls.ANSWER, Answer) else code
        return cast(A, answer)

    @classmethod
    def encode_ack(cls, answer: AckCode | Answer) -> bytes:
        """One byte of code and its tail; a system code is two bytes and nothing else.

        ``answer``: an answer of this command, or a code alone, whose tail is zeros.
        """
        code, tail = (
            (answer.code, answer.tail())
            if isinstance(answer, Answer)
            else (answer, bytes(cls._tail_size()))
        )
        return encode_code(code) if code > 0xFF else bytes((code,)) + tail

    @classmethod
    def code_of(cls, answer: AckCode | Answer) -> AckCode:
        """The code at its beginning."""
        return answer.code if isinstance(answer, Answer) else answer

    @classmethod
    def ack_raw(cls, answer: AckCode | Answer) -> dict[str, Any]:
        """The code and the fields behind it."""
        return answer.raw() if isinstance(answer, Answer) else {"code": int(answer)}

    @classmethod
    def ack_problems(cls, answer: AckCode | Answer) -> list[Problem]:
        """Those of the fields behind the code."""
        return answer.problems() if isinstance(answer, Answer) else []

    @classmethod
    def ack_fields(cls, answer: AckCode | Answer) -> dict[str, Any]:
        """The code in words, and the fields behind it for people."""
        tail = answer.shown() if isinstance(answer, Answer) else {}
        return {"ack": plain(cls.code_of(answer))} | tail


class MissionRequest(_MissionCommand, _MissionAck[A], Request[A]):
    """A request of set 0x03."""

    __slots__ = ()


class Unconfirmed(_MissionCommand, _MissionAck[MissionCode], Movement):
    """A command of set 0x03 that is sent on session 0 and never confirmed.

    DJI's code and documents disagree about acks of 0x23 to 0x25; no Matrice 100 was seen to answer.
    What became of it shows in the status push. Where a firmware does answer, the ack is a code.
    """

    __slots__ = ()


def _split(name: str, payload: bytes, size: int) -> tuple[MissionCode, bytes]:
    """The code of an ack, and as many bytes behind it as wanted."""
    if len(payload) == 2 and payload[1] == 0xFF and payload[0] | 0xFF00 in _SYSTEM_CODES:
        return MissionCode(payload[0] | 0xFF00), b"\xff".ljust(size, b"\0")[:size]
    if len(payload) > size:
        return MissionCode(payload[0]), payload[1 : 1 + size]
    if len(payload) == 1 and payload[0] != MissionCode.SUCCESS:
        return MissionCode(payload[0]), bytes(size)
    raise _bad_size(name, payload, size)


def _bad_size(name: str, payload: bytes, size: int) -> BadAck:
    return BadAck(
        f"the ack of {name} has {len(payload)} byte(s), it takes {1 + size}",
        command=name,
        payload=payload,
        cause="another firmware than the chosen profile, or a damaged simulator",
        remedy="compare the firmware version with the profile in use",
    )
