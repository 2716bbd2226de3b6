"""What an agent and its fronts tell each other: a few typed messages, and their bytes.

A front is what strangers reach: rosbridge, the console, a bridge to other protocols. It owns
nothing of the aircraft. What it knows comes in these messages, and what it wants goes out in them,
whatever carries them (``m100link.agent.carriers``).

==================  ========================================================================
Both ways           Hello, Goodbye
From the agent      Telemetry, FromMobile, Event, State, LeaseChanged, LeaseGranted,
                    TakeOverOffered, Activating, AuthorityTaken, SteerRefused, Outcome
From a front        LeaseAsk, Steer, Ask, Note
==================  ========================================================================

Bytes are JSON, one object for each message: its kind and its fields. Reading never raises anything
but :class:`~m100link.agent.fault.MessageError`; what is longer than :data:`MAX_SIZE` is not read.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from m100link.agent.codec import BadValue, Fields
from m100link.agent.fault import Fault, MessageError
from m100link.agent.lease import LeaseChange
from m100link.protocol.setpoint import (
    ControlMode,
    Horizontal,
    ReferenceFrame,
    Setpoint,
    Vertical,
    Yaw,
)

__all__ = [
    "MAX_SIZE",
    "VERSION",
    "Action",
    "Activating",
    "Ask",
    "AuthorityTaken",
    "Event",
    "FromMobile",
    "Goodbye",
    "Hello",
    "LeaseAction",
    "LeaseAsk",
    "LeaseChanged",
    "LeaseGranted",
    "Message",
    "Note",
    "Outcome",
    "Stage",
    "State",
    "Steer",
    "SteerRefused",
    "TakeOverOffered",
    "Telemetry",
    "decode",
    "encode",
]

VERSION = 1
"""Of these messages. Both ends name theirs in :class:`Hello` and part when they differ."""

MAX_SIZE = 64 * 1024
"""Longest message, bytes."""


# -- both ways ------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Hello:
    """The first message of each end.

    Attributes:
        version: :data:`VERSION` of the sender.
        name: Who it is, for people.
        at: Time of the sender's clock, s; both are on one machine and share the clock.
    """

    version: int
    name: str
    at: float


@dataclass(frozen=True, slots=True)
class Goodbye:
    """The last message of an end, where the carrier does not say it by itself.

    Attributes:
        reason: Why it closes, for people.
    """

    reason: str


# -- from the agent -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Telemetry:
    """One telemetry package, as it came.

    Attributes:
        value: Flag word and items.
        profile: Name of the firmware profile that reads them.
        received_at: When it arrived, s.
    """

    value: bytes
    profile: str
    received_at: float


@dataclass(frozen=True, slots=True)
class FromMobile:
    """Data of the app on the pilot's phone.

    Attributes:
        data: Up to 100 bytes.
    """

    data: bytes


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened, for people.

    Attributes:
        number: Counts events from 1.
        at: Time on the agent's clock, s.
        level: ``"info"``, ``"warning"`` or ``"error"``.
        text: What happened.
    """

    number: int
    at: float
    level: str
    text: str


@dataclass(frozen=True, slots=True)
class State:
    """Where the agent stands: after each change, and a few times a second.

    Attributes:
        at: When it was so, s.
        connection: ``"connecting"``, ``"connected"`` or ``"lost"``.
        connection_fault: Why it is not connected.
        firmware: Firmware profile in use; empty when not connected.
        is_activated: Whether the aircraft is active and its key in use.
        activation_code: Last answer to an activation.
        activation_fault: Why the last activation failed.
        holding: State of control authority, by the names of
            :class:`~m100link.agent.holding.HoldingState`.
        has_authority: Whether setpoints and tasks are obeyed.
        task: What the aircraft flies by itself; empty for nothing.
        pattern: Name of the program that flies; empty for none.
        lease_remaining: Seconds until the lease ends if nobody renews it.
        round_trip: Seconds to the aircraft and back.
        discards: Damaged frames.
        late_acks: Acks that came late or belong to nobody.
        dropped_writes: Frames that were not written.
        mismatches: Telemetry packages that do not fit the firmware.
    """

    at: float
    connection: str = "connecting"
    connection_fault: Fault | None = None
    firmware: str = ""
    is_activated: bool = False
    activation_code: int | None = None
    activation_fault: Fault | None = None
    holding: str = "none"
    has_authority: bool = False
    task: str = ""
    pattern: str = ""
    lease_remaining: float = 0.0
    round_trip: float | None = None
    discards: int = 0
    late_acks: int = 0
    dropped_writes: int = 0
    mismatches: int = 0


@dataclass(frozen=True, slots=True)
class LeaseChanged:
    """Who has the lease.

    Attributes:
        number: Number of the lease in force, 0 for none.
        name: Who holds it; empty for nobody.
        why: Why it changed hands; None when a front is told for the first time.
    """

    number: int
    name: str
    why: LeaseChange | None = None


@dataclass(frozen=True, slots=True)
class LeaseGranted:
    """Answer to :class:`LeaseAsk`: the lease.

    Attributes:
        id: Of the question.
        name: Who holds it, as others see it.
        token: Proof of it, for whoever holds it and nobody else.
        number: Fence of its setpoints: a later lease has a greater one.
    """

    id: int
    name: str
    token: str = field(repr=False)
    number: int


@dataclass(frozen=True, slots=True)
class TakeOverOffered:
    """Answer to the first step of a take-over.

    Attributes:
        id: Of the question.
        name: Who wants the lease.
        from_name: Who would lose it.
        token: What the second step takes.
        number: Number of the lease that would end.
        expires_at: Time after which it is void, s.
    """

    id: int
    name: str
    from_name: str
    token: str = field(repr=False)
    number: int
    expires_at: float


@dataclass(frozen=True, slots=True)
class Activating:
    """An answer of the aircraft to an activation.

    Attributes:
        code: :class:`~m100link.protocol.codes.ActivationCode`.
    """

    code: int


@dataclass(frozen=True, slots=True)
class AuthorityTaken:
    """Somebody else took control authority.

    Attributes:
        fault: An :class:`~m100link.errors.AuthorityLost`, with its reason.
    """

    fault: Fault


@dataclass(frozen=True, slots=True)
class SteerRefused:
    """A setpoint was not flown; what flew before is stopped, or expires.

    Attributes:
        fence: Of the setpoint.
        fault: Why.
    """

    fence: int
    fault: Fault


class Stage(Enum):
    """How far something that was asked for has come."""

    ACCEPTED = "accepted"  # the aircraft has begun; another outcome follows
    DONE = "done"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of an :class:`Ask` or a :class:`LeaseAsk`.

    Attributes:
        id: Of the question.
        stage: How far it came.
        fault: Why it failed.
        text: What was asked for, where that is a text.
        number: What was asked for, where that is a number.
    """

    id: int
    stage: Stage
    fault: Fault | None = None
    text: str = ""
    number: int = 0


# -- from a front ---------------------------------------------------------------------------------


class LeaseAction(Enum):
    """What a front may want of the lease."""

    ACQUIRE = "acquire"
    RENEW = "renew"
    RELEASE = "release"
    TAKE_OVER = "take_over"  # first step: who would lose it?
    CONFIRM = "confirm"  # second step: take it from exactly that one


@dataclass(frozen=True, slots=True)
class LeaseAsk:
    """Something about the lease.

    Attributes:
        id: Comes back in the answer; 0 asks for none.
        action: What is wanted.
        name: Who wants it, for people (acquire, take over).
        token: Proof of the lease, or of the take-over that is confirmed.
    """

    id: int
    action: LeaseAction
    name: str = ""
    token: str = field(default="", repr=False)


@dataclass(frozen=True, slots=True)
class Steer:
    """A setpoint for as long as its lifetime.

    Attributes:
        fence: Number of the lease it is sent under, granted over this connection.
        sent_at: When the sender decided it, s. What was long on its way is refused.
        lifetime: Seconds that it lasts when it is not renewed.
        setpoint: What to fly.
    """

    fence: int
    sent_at: float
    lifetime: float
    setpoint: Setpoint


class Action(Enum):
    """What the agent can be asked to do."""

    ACTIVATE = "activate"
    OBTAIN = "obtain"  # control authority
    RELEASE = "release"
    TAKE_OFF = "take_off"
    LAND = "land"
    GO_HOME = "go_home"
    PATTERN = "pattern"  # the simple task of that number
    HALT = "halt"  # no motion; a task goes on
    STOP = "stop"  # no motion, and no task
    VERSION = "version"
    SEND_TO_MOBILE = "send_to_mobile"


@dataclass(frozen=True, slots=True)
class Ask:
    """Something to be done, with an :class:`Outcome`.

    Attributes:
        id: Comes back in each outcome; 0 asks for none.
        action: What.
        fence: Number of the lease it is asked under; 0 for none.
        number: Of the simple task.
        data: For the app on the pilot's phone.
        text: Why, for people (halt).
    """

    id: int
    action: Action
    fence: int = 0
    number: int = 0
    data: bytes = b""
    text: str = ""


@dataclass(frozen=True, slots=True)
class Note:
    """Something that happened in the front, for the journal.

    Attributes:
        level: ``"info"``, ``"warning"`` or ``"error"``.
        text: What happened.
    """

    level: str
    text: str


Message = (
    Hello
    | Goodbye
    | Telemetry
    | FromMobile
    | Event
    | State
    | LeaseChanged
    | LeaseGranted
    | TakeOverOffered
    | Activating
    | AuthorityTaken
    | SteerRefused
    | Outcome
    | LeaseAsk
    | Steer
    | Ask
    | Note
)
"""Any of them."""


# -- bytes ----------------------------------------------------------------------------------------


def _write_setpoint(setpoint: Setpoint) -> list[float]:
    flag = setpoint.mode.flag | setpoint.frame << 1 | setpoint.stable
    return [flag, setpoint.x, setpoint.y, setpoint.z, setpoint.yaw]


def _read_setpoint(value: Any) -> Setpoint:
    if type(value) is not list or len(value) != 5:
        raise BadValue("not a control flag and four numbers")
    flag, *axes = value
    if type(flag) is not int or not 0 <= flag <= 0xFF:
        raise BadValue("not a control flag")
    if any(type(one) not in (int, float) for one in axes):
        raise BadValue("not four numbers")
    try:
        mode = ControlMode(Horizontal(flag >> 6), Vertical(flag >> 4 & 3), Yaw(flag >> 3 & 1))
        x, y, z, yaw = axes
        return Setpoint(mode, x, y, z, yaw, ReferenceFrame(flag >> 1 & 1), bool(flag & 1))
    except (ValueError, OverflowError) as error:  # a flag without a mode, or a value out of range
        raise BadValue(f"not a setpoint: {str(error)[:200]}") from None


_KINDS: dict[str, type[Any]] = {kind.__name__: kind for kind in Message.__args__}
_FIELDS = {
    kind: Fields(kind, {Setpoint: (_write_setpoint, _read_setpoint)}) for kind in _KINDS.values()
}


def encode(message: Message) -> bytes:
    """The bytes of a message, at most :data:`MAX_SIZE`.

    Raises:
        MessageError: A number in it is not finite, or it is too long. Long texts are cut.
    """
    kind = type(message)
    try:
        text = json.dumps(
            {"kind": kind.__name__, **_FIELDS[kind].write(message)}, separators=(",", ":")
        )
    except BadValue as error:
        raise MessageError(f"{kind.__name__} cannot be sent: {error}") from None
    data = text.encode("ascii")
    if len(data) > MAX_SIZE:
        raise MessageError(f"{kind.__name__} would have {len(data)} bytes, at most {MAX_SIZE} go")
    return data


def decode(data: bytes) -> Message:
    """The message of these bytes.

    Raises:
        MessageError: They are none.
    """
    if len(data) > MAX_SIZE:
        raise MessageError(f"{len(data)} bytes are not a message: at most {MAX_SIZE} are")
    try:
        value = json.loads(data, parse_constant=_refuse)
    except (ValueError, RecursionError):
        raise MessageError("not a message: this is not JSON") from None
    name = value.pop("kind", None) if isinstance(value, dict) else None
    kind = _KINDS.get(name) if isinstance(name, str) else None
    if kind is None:
        raise MessageError("not a message: it names no kind that this version knows")
    try:
        message: Message = _FIELDS[kind].read(value)
    except BadValue as error:
        raise MessageError(f"not a message: {kind.__name__}: {error}") from None
    return message


def _refuse(text: str) -> float:
    raise ValueError(f"{text} is not JSON")
