"""Missions: the pushes 0x02/0x03 and 0x02/0x04 of firmware 3.1, and command set 0x03.

Layouts and readings are from DJI's libraries and documents of 2015 to 2019.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, Self, TypeAlias, TypeVar, cast, get_args

from m100link.errors import BadAck
from m100link.protocol.codes import AckCode, MissionCode, SystemCode
from m100link.protocol.command import (
    Acknowledged,
    Command,
    Movement,
    Notification,
    Problem,
    Request,
    encode_code,
    exactly,
    field_names,
    plain,
)
from m100link.protocol.fields import Laid, Layout, Number, Record, Reserved
from m100link.protocol.firmware import FirmwareProfile, Generation

COMMAND_SET = 0x03

# -- pushes ----------------------------------------------------------------------------------------

_MISSIONS = ("none", "waypoint", "hotpoint", "follow", "ioc")


class _Reported(Record):
    """One kind of a push: its first byte and what it says."""

    __slots__ = ()

    KIND: ClassVar[int]
    WORD: ClassVar[str]  # the kind in a word

    def __init_subclass__(cls, *, kind: int | None = None, word: str = "") -> None:
        super().__init_subclass__()
        if kind is not None:
            cls.KIND = kind
        if word:  # a dataclass with slots is made a second time, without them
            cls.WORD = word

    @property
    def kind(self) -> int:
        return self.KIND


@dataclass(frozen=True, slots=True)
class OtherKind(_Reported, word="unknown"):
    """A kind that no source lists."""

    first: int  #: The first byte.
    data: bytes  #: The bytes behind it.

    @property
    def kind(self) -> int:
        """The first byte."""
        return self.first

    def raw(self) -> dict[str, Any]:
        """The bytes as hex."""
        return {"data": self.data.hex()}

    def shown(self) -> dict[str, Any]:
        """Nothing is known about it."""
        return {"unknown": self.data.hex()}

    def problems(self) -> list[Problem]:
        """That nobody knows it."""
        return [Problem("kind", self.first, "a kind that DJI's programs know")]

    def to_wire(self, name: str) -> bytes:
        """The bytes as they came."""
        return self.data


@dataclass(frozen=True, slots=True)
class _LastMission(_Reported):
    """The status while no mission runs."""

    LAYOUT: ClassVar[Layout] = Layout(
        Number("last_mission"), Number("flags"), Number("reason"), Reserved(2)
    )

    last_mission: int = 0
    flags: int = 0
    reason: int = 0

    @property
    def is_broken_off(self) -> bool:
        """Whether the last mission was broken off and did not end by itself."""
        return bool(self.flags & 1)

    def shown(self) -> dict[str, Any]:
        """The last mission in a word, and why it was broken off."""
        last = self.last_mission
        return {
            "last_mission": _MISSIONS[last] if last < len(_MISSIONS) else last,
            "is_broken_off": self.is_broken_off,
            "reason": plain(MissionCode(self.reason)),
        }


@dataclass(frozen=True, slots=True)
class IdleStatus(_LastMission, kind=0, word="none"):
    """Kind 0: no mission runs.

    Attributes:
        last_mission: Kind of the last one, 0 when there was none.
        flags: Bit 0: it was broken off.
        reason: Why, a :class:`~m100link.protocol.MissionCode`.
    """


@dataclass(frozen=True, slots=True)
class IocStatus(_LastMission, kind=4, word="ioc"):
    """Kind 4: intelligent orientation control is on; fields as in :class:`IdleStatus`."""


@dataclass(frozen=True, slots=True)
class WaypointStatus(_Reported, kind=1, word="waypoint"):
    """Kind 1: a waypoint mission."""

    LAYOUT: ClassVar[Layout] = Layout(
        Number("index"), Number("status"), Number("error"), Reserved(2)
    )

    index: int  #: The waypoint that it flies to.
    #: 0 on the way to the first point, 1 flying, 2 turning, 3 an action begins, 4 in an action, 5
    #: first point reached or action finished, 6 reached.
    status: int = 0
    error: int = 0  #: A :class:`~m100link.protocol.MissionCode`.

    def shown(self) -> dict[str, Any]:
        """The status in words, and what the error means."""
        return {
            "index": self.index,
            "status": _word(_WAYPOINT_STATUS, self.status),
            "error": plain(MissionCode(self.error)),
        }


@dataclass(frozen=True, slots=True)
class HotpointStatus(_Reported, kind=2, word="hotpoint"):
    """Kind 2: a hotpoint."""

    LAYOUT: ClassVar[Layout] = Layout(
        Number("status"),
        Number("radius_cm", "H", unit="cm"),
        Number("reason"),
        Number("rate", unit="0.1 °/s"),
    )

    status: int  #: 0 on the way to the start, 1 circling, 2 paused.
    radius_cm: int = 0  #: Present distance from the centre, 655 m at most.
    reason: int = 0  #: A :class:`~m100link.protocol.MissionCode`.
    rate: int = 0  #: Present rate in tenths of a degree per second, 25.5 °/s at most.

    def shown(self) -> dict[str, Any]:
        """Metres, degrees per second, words."""
        return self.LAYOUT.shown(self) | {
            "status": _word(_HOTPOINT_STATUS, self.status),
            "reason": plain(MissionCode(self.reason)),
        }


@dataclass(frozen=True, slots=True)
class FollowStatus(_Reported, kind=3, word="follow"):
    """Kind 3: following a target; the push has no further fields."""

    LAYOUT: ClassVar[Layout] = Layout(Reserved(5))


_WAYPOINT_STATUS = (
    "to_first_point",
    "flying",
    "turning",
    "action_begins",
    "in_action",
    "first_point_or_action_finished",
    "reached",
)
_HOTPOINT_STATUS = ("to_start_point", "circling", "paused")


def _word(words: tuple[str, ...], number: int) -> str | int:
    return words[number] if number < len(words) else number


@dataclass(frozen=True, slots=True)
class Uploaded(_Reported, kind=0, word="uploaded"):
    """Kind 0: all waypoints have come and were checked together."""

    LAYOUT: ClassVar[Layout] = Layout(
        Number("valid"), Number("estimated_time", "H", unit="s"), Reserved(2)
    )

    valid: int  #: 1 when the mission may be started.
    estimated_time: int = 0  #: Seconds that it will take.


@dataclass(frozen=True, slots=True)
class Finished(_Reported, kind=1, word="finished"):
    """Kind 1: the last waypoint was reached and its actions are done."""

    LAYOUT: ClassVar[Layout] = Layout(Number("repeat"), Reserved(4))

    repeat: int = 0  #: Runs still to come.


@dataclass(frozen=True, slots=True)
class Reached(_Reported, kind=2, word="reached"):
    """Kind 2: a waypoint was reached."""

    LAYOUT: ClassVar[Layout] = Layout(Number("index"), Number("status"), Reserved(3))

    index: int  #: Its index.
    status: int = 6  #: 4 before its actions, 6 after them.


Status: TypeAlias = (
    IdleStatus | WaypointStatus | HotpointStatus | FollowStatus | IocStatus | OtherKind
)
Event: TypeAlias = Uploaded | Finished | Reached | OtherKind

STATUSES = (IdleStatus, WaypointStatus, HotpointStatus, FollowStatus, IocStatus)
"""The classes of a status, by its kind."""

EVENTS = (Uploaded, Finished, Reached)  # what a waypoint mission may tell, by its kind

_PUSH_SIZE = 6


class _KindPush(Notification, since=Generation.V3_1):
    """A push whose first byte is the kind of what it tells."""

    __slots__ = ()

    KINDS: ClassVar[tuple[type[_Reported], ...]]

    @property
    def content(self) -> _Reported:
        content: _Reported = getattr(self, field_names(self)[0])
        return content

    @property
    def kind(self) -> int:
        """Its number; the words are those of :attr:`KINDS`."""
        return self.content.kind

    @property
    def name(self) -> str:
        return f"{self.NAME}_{self.content.WORD}"

    def value(self, profile: FirmwareProfile) -> bytes:
        return bytes((self.kind,)) + self.content.to_wire(self.name)

    @classmethod
    def parse(cls, value: bytes, profile: FirmwareProfile) -> Self:
        tail = exactly(value, _PUSH_SIZE, cls.NAME)[1:]
        known = value[0] < len(cls.KINDS)
        content = cls.KINDS[value[0]].from_wire(tail) if known else OtherKind(value[0], tail)
        return cls(content)  # type: ignore[call-arg]  # the two are dataclasses of what they tell

    def fields(self) -> dict[str, Any]:
        """The kind in a word, and the fields in metres, degrees, seconds and words."""
        return {"kind": self.content.WORD} | self.content.shown()

    def raw(self) -> dict[str, Any]:
        return {"kind": self.kind} | self.content.raw()

    def problems(self) -> list[Problem]:
        return self.content.problems()


@dataclass(frozen=True, slots=True)
class MissionStatus(_KindPush, address=(0x02, 0x03)):
    """0x02/0x03, which mission runs and how far it is; about ten times a second.

    The box "Ground Station Status" has to be ticked in the PC assistant.
    """

    KINDS: ClassVar[tuple[type[_Reported], ...]] = STATUSES

    #: The status by the kind of mission, 0 none, 1 waypoint, 2 hotpoint, 3 follow, 4 IOC.
    status: Status


@dataclass(frozen=True, slots=True)
class WaypointEvent(_KindPush, address=(0x02, 0x04)):
    """0x02/0x04, a step of a waypoint mission, sent once."""

    KINDS: ClassVar[tuple[type[_Reported], ...]] = EVENTS

    event: Event  #: The event by its kind, 0 uploaded, 1 finished, 2 reached.

    @classmethod
    def parse(cls, value: bytes, profile: FirmwareProfile) -> Self:
        """6 bytes; 5 for a waypoint reached, as DJI's last library lists that."""
        if len(value) == _PUSH_SIZE - 1 and value[0] == Reached.KIND:
            value += b"\0"
        return super(WaypointEvent, cls).parse(value, profile)


# -- acks of command set 0x03: they begin with a code of one byte, where all others have two -------
# Where two bytes 0xFF00, 0xFF01 or 0xFF02 stand alone they are taken for the system code that they
# are: no waypoint has index 0xFF.


A = TypeVar("A")
R = TypeVar("R", bound=Record)

_SYSTEM_CODES = frozenset(map(int, SystemCode))


class _MissionCommand(Command, level=2, encrypted=True, since=Generation.V3_1):
    """Base of all commands of the set."""

    __slots__ = ()


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


class DownloadAnswer(Answer, Generic[R]):
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
    def record(self) -> R:
        """The uploaded record: the field behind the code."""
        found: R = getattr(self, dataclasses.fields(self)[1].name)  # type: ignore[arg-type]  # is one
        return found

    def tail(self) -> bytes:
        """The stored record as bytes, unchanged."""
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
        return answer.code if isinstance(answer, Answer) else answer

    @classmethod
    def ack_raw(cls, answer: AckCode | Answer) -> dict[str, Any]:
        return answer.raw() if isinstance(answer, Answer) else {"code": int(answer)}

    @classmethod
    def ack_problems(cls, answer: AckCode | Answer) -> list[Problem]:
        return answer.problems() if isinstance(answer, Answer) else []

    @classmethod
    def ack_fields(cls, answer: AckCode | Answer) -> dict[str, Any]:
        tail = answer.shown() if isinstance(answer, Answer) else {}
        return {"ack": plain(cls.code_of(answer))} | tail


class MissionRequest(_MissionCommand, _MissionAck[A], Request[A]):
    """A request of set 0x03."""

    __slots__ = ()


class Unconfirmed(_MissionCommand, _MissionAck[MissionCode], Movement):
    """A command of set 0x03 that is sent on session 0 and never confirmed.

    DJI's code and documents disagree about acks of 0x23 to 0x25; no Matrice 100 was seen to answer.
    The status push shows its effect. Where a firmware does answer, the ack is a code.
    """

    __slots__ = ()


@dataclass(frozen=True, slots=True)
class PauseResume(Laid, MissionRequest[MissionCode]):
    """Pause (0) or resume (1) a mission."""

    LAYOUT: ClassVar[Layout] = Layout(Number("resume", words=("pause", "resume")))

    resume: int

    @property
    def sets_in_motion(self) -> bool:
        """Resuming does."""
        return self.resume != 0


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
