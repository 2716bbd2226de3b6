"""Command set 0x01: authority, flight mode commands, movement (document 2.2.2 and 3.2)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from struct import Struct
from typing import Any, ClassVar, NamedTuple, Self

from m100link.protocol.codes import AckCode, ArmCode, AuthorityCode, TaskResultCode, TaskStartCode
from m100link.protocol.command import Movement, Problem, Request, exactly
from m100link.protocol.fields import Laid, Layout, Number
from m100link.protocol.firmware import FirmwareProfile, Generation


@dataclass(frozen=True, slots=True)
class RequestAuthority(Request[AuthorityCode], address=(0x01, 0x00), level=2, encrypted=True):
    """0x01/0x00, obtain (True) or release (False) control authority."""

    obtain: bool

    @property
    def needs_known_firmware(self) -> bool:
        """A release is alike in every firmware, and must be possible in an unknown one too."""
        return self.obtain

    def value(self, profile: FirmwareProfile) -> bytes:
        """1 obtains, 0 releases."""
        return bytes((self.obtain,))

    @classmethod
    def parse(cls, value: bytes, profile: FirmwareProfile) -> Self:
        """One byte, 0 or 1."""
        (request,) = exactly(value, 1, cls.NAME)
        if request > 1:
            raise ValueError(f"authority request {request} does not exist")
        return cls(bool(request))

    @classmethod
    def unreadable(cls, profile: FirmwareProfile) -> AckCode:
        """The final refusal, which has another number where code 3 is "in progress" (errata 24)."""
        has_reason = profile.authority_refusal_has_reason
        return AuthorityCode.NOT_IN_F if has_reason else AuthorityCode.NOT_CHANGED


class Task(IntEnum):
    """The flight mode commands of the document. Earlier lists name more; none was ever allowed."""

    GO_HOME = 1
    TAKE_OFF = 4
    LAND = 6


@dataclass(frozen=True, slots=True)
class StartTask(Laid, Request[TaskStartCode], address=(0x01, 0x01), level=2, encrypted=True):
    """0x01/0x01, begin take-off, landing or go-home."""

    ACK_CODE_SIZES: ClassVar[tuple[int, ...]] = (1, 2)
    UNREADABLE: ClassVar[AckCode] = TaskStartCode.REJECTED
    LAYOUT: ClassVar[Layout] = Layout(Number("task_sequence"), Number("task"))

    task_sequence: int  #: Number of this command, 0 to 255; the result is asked for by it.
    task: int  #: The task as its number; numbers outside :class:`Task` are kept and rejected.

    def fields(self) -> dict[str, Any]:
        """With the name of the task."""
        known = self.task in Task.__members__.values()
        return {
            "task_sequence": self.task_sequence,
            "task": Task(self.task).name.lower() if known else int(self.task),
        }


@dataclass(frozen=True, slots=True)
class QueryTask(Laid, Request[TaskResultCode], address=(0x01, 0x02), level=2, encrypted=True):
    """0x01/0x02, ask for the result of the task with that number."""

    ACK_CODE_SIZES: ClassVar[tuple[int, ...]] = (1, 2)
    UNREADABLE: ClassVar[AckCode] = TaskResultCode.NOT_CURRENT
    LAYOUT: ClassVar[Layout] = Layout(Number("task_sequence"))

    task_sequence: int


_MOVE = Struct("<B4f")


class _MoveFields(NamedTuple):
    control_flag: int
    roll_or_x: float
    pitch_or_y: float
    throttle_or_z: float
    yaw: float


class Move(_MoveFields, Movement, address=(0x01, 0x03), level=2, encrypted=True):
    """0x01/0x03, movement: a control flag and four raw values, without an ack.

    :mod:`m100link.protocol.setpoint` defines the meaning of flag and values. On the wire the
    order is flag, roll/x, pitch/y, throttle/z, yaw; under ``1.0-document`` yaw comes before
    throttle, as the document prints it (errata 1).

    A named tuple, unlike the other commands: this one is made fifty times a second, and a frozen
    dataclass takes longer to make than to send.
    """

    __slots__ = ()

    def value(self, profile: FirmwareProfile) -> bytes:
        """17 bytes."""
        flag, x, y, throttle, yaw = self
        if profile.throttle_before_yaw:
            return _MOVE.pack(flag, x, y, throttle, yaw)
        return _MOVE.pack(flag, x, y, yaw, throttle)

    @classmethod
    def parse(cls, value: bytes, profile: FirmwareProfile) -> Self:
        """17 bytes."""
        flag, x, y, third, fourth = _MOVE.unpack(exactly(value, _MOVE.size, cls.NAME))
        if not profile.throttle_before_yaw:
            third, fourth = fourth, third
        return cls(flag, x, y, third, fourth)

    def fields(self) -> dict[str, Any]:
        """All five under ``movement``."""
        return {"movement": self._asdict()}


@dataclass(frozen=True, slots=True)
class Arm(Request[ArmCode], address=(0x01, 0x05), level=2, encrypted=True, since=Generation.V3_1):
    """0x01/0x05, motors on (True) or off (False); firmware 3.1."""

    on: int  #: True or False; another number of another program is kept and refused.

    def value(self, profile: FirmwareProfile) -> bytes:
        """1 arms, 0 disarms.

        Raises:
            BadValue: Another number.
        """
        for problem in self.problems():
            raise problem.error(self.NAME)
        return bytes((self.on,))

    @classmethod
    def parse(cls, value: bytes, profile: FirmwareProfile) -> Self:
        """One byte; 0 and 1 are False and True."""
        (on,) = exactly(value, 1, cls.NAME)
        return cls(bool(on) if on <= 1 else on)

    def raw(self) -> dict[str, Any]:
        """The byte."""
        return {"arm": int(self.on)}

    def problems(self) -> list[Problem]:
        """Neither 0 nor 1."""
        return [] if self.on in (0, 1) else [Problem("arm", self.on, "0 disarm, 1 arm")]
