"""Messages and their bytes: what goes in comes out, and nonsense is refused by one error."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import struct
from collections.abc import Mapping
from dataclasses import replace
from enum import Enum
from typing import Any, get_args, get_type_hints

import pytest
from hypothesis import given
from hypothesis import strategies as st

from m100link.apps.agent import codec, orders
from m100link.apps.agent.codec import (
    MAX_BYTES,
    MAX_SIZE,
    MAX_TEXT,
    Fields,
    InvalidValue,
    decode,
    encode,
    require_possible,
)
from m100link.apps.agent.lease import Lease, LeaseChange, TakeOver
from m100link.apps.agent.messages import (
    VERSION,
    Activating,
    Ask,
    AuthorityTaken,
    Event,
    Goodbye,
    GuardLimits,
    Hello,
    JournalNote,
    LeaseChanged,
    LinkCounted,
    Message,
    MessageError,
    MissionReport,
    MobileMessage,
    OrderOutcome,
    PlanChanged,
    RemoteError,
    Replay,
    Stage,
    State,
    Steer,
    SteerRefused,
    Telemetry,
)
from m100link.apps.agent.orders import GuidedFlight
from m100link.protocol.codes import ActivationCode
from m100link.protocol.setpoint import ReferenceFrame, Setpoint
from tests.apps.agent.examples import EXAMPLES as ORDERS

FAULT = RemoteError(
    "LinkLost", "the port went away", "a cable", "plug it in", {"code": 3, "who": None}
)
NORTH = Setpoint.velocity(north=1.5, east=-0.1, up=0.25, yaw_rate_deg_s=-3.0, stable=True)
TILT = Setpoint.tilt(roll_deg=1, pitch_deg=2, thrust_percent=40, yaw_deg=-180)

EXAMPLES: list[Message] = [
    Hello(VERSION, "console", 12.5),
    Goodbye("the agent ends"),
    Telemetry(bytes(range(200)), "3.1", 1e6),
    MobileMessage(b"\0\xff"),
    Event(7, 3.25, "warning", 'umlaut ü and a quote "'),
    State(at=1.0),
    State(
        at=2.0,
        connection="lost",
        connection_fault=FAULT,
        firmware="1.0",
        is_activated=True,
        activation_code=3,
        activation_fault=FAULT,
        holding="held",
        has_authority=True,
        task="land",
        pattern="simple task 0",
        guided=GuidedFlight("flight to a place", 52.1, 4.31, 20.0, distance_m=12.5),
        limits=GuardLimits(50.0, None, 10.0, 20, latitude_deg=52.1, longitude_deg=4.31),
        lease_remaining=2.5,
        round_trip=0.01,
        discards=1,
        late_acks=2,
        dropped_writes=3,
        mismatches=4,
    ),
    LinkCounted(1.5, {"acks": 3}, {"crc32": 2}, 0.001, {"0.005": 7, "inf": 1}, 0.125),
    LeaseChanged(0, ""),
    LeaseChanged(3, "tab", LeaseChange.TAKEN_OVER),
    OrderOutcome(1, Stage.DONE, lease=Lease("tab", "secret", 3)),
    OrderOutcome(2, Stage.DONE, offer=TakeOver("other", "tab", "secret", 3, 12.0)),
    Activating(6),
    AuthorityTaken(FAULT),
    MissionReport(2, b"\x07\x04\0\0\0"),
    PlanChanged(),
    PlanChanged("tab", orders.UploadPlan(b"\x02", (b"", b"\x01\xff"))),
    SteerRefused(3, FAULT),
    OrderOutcome(5, Stage.FAILED, FAULT),
    OrderOutcome(6, Stage.DONE, None, "SDK-v1.0", 0xFFFFFFFF),
    Steer(3, 12.125, 0.3, NORTH),
    Steer(3, 12.125, 0.3, Setpoint.tilt(roll_deg=1, pitch_deg=2, thrust_percent=40, yaw_deg=-180)),
    Steer(
        1,
        0.0,
        0.2,
        Setpoint.tilt(roll_deg=1, pitch_deg=2, height=9, yaw_deg=1, frame=ReferenceFrame.GROUND),
    ),
    *(Ask(9, order, 3) for order in ORDERS),
    JournalNote("info", "something"),
]


@pytest.mark.parametrize("message", EXAMPLES, ids=lambda one: type(one).__name__)
def test_what_goes_in_comes_out(message: Message) -> None:
    assert decode(encode(message)) == message


def test_every_kind_has_an_example() -> None:
    assert {type(one) for one in EXAMPLES} == set(Message.__args__)


@pytest.mark.parametrize("message", EXAMPLES, ids=lambda one: type(one).__name__)
def test_tokens_are_not_shown(message: Message) -> None:
    assert "secret" not in repr(message)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"{",
        b"[]",
        b"null",
        b"\xff\xfe",
        b"[" * 5000,
        b'{"kind":"Nothing"}',
        b'{"kind":5}',
        b'{"kind":["Hello"]}',
        b'{"kind":"Hello","version":1,"name":"x"}',
        b'{"kind":"Hello","version":1,"name":"x","at":1,"more":1}',
        b'{"kind":"Hello","version":true,"name":"x","at":1}',
        b'{"kind":"Hello","version":1,"name":"x","at":NaN}',
        b'{"kind":"Hello","version":1,"name":"x","at":1e999}',
        b'{"kind":"Hello","version":%s,"name":"x","at":1}' % (b"9" * 40),
        b'{"kind":"Hello","version":1,"name":%s,"at":1}'
        % json.dumps("x" * (MAX_TEXT + 1)).encode(),
        b'{"kind":"FromMobile","data":"?"}',
        b'{"kind":"Activating","code":1.0}',
        b'{"kind":"Ask","id":1,"order":{"kind":"Explode"},"fence":0}',
        b'{"kind":"Ask","id":1,"order":{"kind":"Hello","version":1,"name":"x","at":1},"fence":0}',
        b'{"kind":"Ask","id":1,"order":[],"fence":0}',
        b'{"kind":"Land"}',
        b'{"kind":"Steer","fence":1,"sent_at":0,"lifetime":1,"setpoint":[72,0,0,0,0]}',
        b" " * (MAX_SIZE + 1),
    ],
)
def test_what_is_not_a_message_is_refused(data: bytes) -> None:
    with pytest.raises(MessageError) as caught:
        decode(data)
    assert len(str(caught.value)) < 500


@given(
    st.sampled_from(EXAMPLES),
    st.lists(st.tuples(st.integers(0, 10_000), st.integers(0, 255)), max_size=4),
)
def test_damaged_bytes_are_a_message_or_the_one_error(
    message: Message, damage: list[tuple[int, int]]
) -> None:
    data = bytearray(encode(message))
    for place, value in damage:
        data[place % len(data)] = value
    try:
        found = decode(bytes(data))
    except MessageError:
        return
    assert decode(encode(found)) == found


_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=5,
)


IN_JSON = [one for one in EXAMPLES if encode(one).startswith(b"{")]
PACKED = [one for one in EXAMPLES if one not in IN_JSON]


def test_what_goes_often_is_packed() -> None:
    assert {type(one) for one in PACKED} == {Steer, Telemetry}


@pytest.mark.parametrize("message", PACKED, ids=lambda one: type(one).__name__)
def test_what_is_packed_has_no_byte_too_few(message: Message) -> None:
    data = encode(message)
    shortest = data[: 10 + len(message.profile)] if isinstance(message, Telemetry) else data
    for size in range(1, len(shortest)):
        with pytest.raises(MessageError):
            decode(data[:size])


def test_a_packed_setpoint_has_no_byte_too_many() -> None:
    with pytest.raises(MessageError):
        decode(encode(Steer(3, 12.125, 0.3, NORTH)) + b"\0")


def test_a_packed_package_is_not_too_long() -> None:
    with pytest.raises(MessageError):
        decode(encode(Telemetry(bytes(MAX_BYTES), "3.1", 1.0)) + b"\0")


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (1, struct.pack("<Q", 1 << 53)),  # a fence that the answer, which is JSON, cannot say
        (1 + 8, struct.pack("<d", math.nan)),  # sent_at
        (1 + 8, struct.pack("<d", -1.1e300)),
        (1 + 16, struct.pack("<d", math.inf)),  # lifetime
        (1 + 24, b"\xf8"),  # a flag without a mode
        (1 + 25, struct.pack("<d", 11.0)),  # faster than the mode goes
        (1 + 25, struct.pack("<d", math.nan)),
    ],
)
def test_a_packed_setpoint_that_cannot_be_is_refused(place: int, value: bytes) -> None:
    data = bytearray(encode(Steer(3, 12.125, 0.3, NORTH)))
    data[place : place + len(value)] = value
    with pytest.raises(MessageError):
        decode(bytes(data))


@given(st.sampled_from(IN_JSON), st.data())
def test_fields_of_any_other_value_are_refused_or_fit(message: Message, data: Any) -> None:
    value = json.loads(encode(message))
    value[data.draw(st.sampled_from(sorted(value)))] = data.draw(_VALUES)
    try:
        found = decode(json.dumps(value).encode())
    except MessageError:
        return
    for field in dataclasses.fields(found):
        one = getattr(found, field.name)
        assert not isinstance(one, float) or math.isfinite(one)


@pytest.mark.parametrize(
    "message",
    [
        Hello(1, "x", math.nan),
        Hello(1, "x", math.inf),
        MobileMessage(bytes(MAX_BYTES + 1)),
        Telemetry(bytes(MAX_BYTES + 1), "3.1", 1.0),
        Telemetry(b"", "3.1", math.inf),
        Telemetry(b"", "p" * 256, 1.0),
        Steer(3, math.nan, 0.3, NORTH),
        Steer(3, 1.0, math.inf, NORTH),
        Steer(-1, 1.0, 0.3, NORTH),
    ],
)
def test_what_cannot_be_sent_is_refused_by_the_sender(message: Message) -> None:
    with pytest.raises(MessageError):
        encode(message)


def test_long_texts_are_cut() -> None:
    found = decode(encode(Event(1, 0.0, "info", "ü" * 10_000)))
    assert isinstance(found, Event)
    assert len(found.text) == MAX_TEXT
    assert found.text.endswith("…")


def test_a_field_of_a_kind_that_no_message_carries_is_named() -> None:
    @dataclasses.dataclass
    class Wide:
        times: set[int]

    with pytest.raises(TypeError, match=r"Wide\.times: a message cannot carry set"):
        Fields(Wide)


FIELDS: list[tuple[str, Any, Any]] = [
    ("text", "x" * 4096, "x" * (4096 + 1)),
    ("payload", "AAAA" * (2048 // 3), "AAAA" * (2048 // 3 + 1)),
    (
        "details",
        {str(n): n for n in range(32)},
        {str(n): n for n in range(32 + 1)},
    ),
    ("pieces", [""] * 99, [""] * (99 + 1)),
    ("flag", True, 1),
]


@dataclasses.dataclass
class Limited:
    text: str = ""
    payload: bytes = b""
    details: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    pieces: tuple[bytes, ...] = ()
    flag: bool = False


@pytest.mark.parametrize(("name", "most", "more"), FIELDS, ids=lambda one: str(one)[:9])
def test_a_field_has_a_greatest_size(name: str, most: Any, more: Any) -> None:
    """2 kB of bytes, 4096 characters, 32 entries and 99 pieces, whatever the sender says."""
    fields = Fields(Limited)
    value = fields.write(Limited())
    found = fields.read(value | {name: most})
    assert getattr(found, name)
    with pytest.raises(InvalidValue, match=name):
        fields.read(value | {name: more})


def test_words_that_are_too_long_are_cut_as_they_are_written() -> None:
    """Or the other end would refuse the whole message."""
    fields, long = Fields(Limited), "x" * 5000
    written = fields.write(Limited(text=long, details={long: long, "height": math.inf, "n": 3}))
    cut = "x" * 4095 + "…"
    assert (written["text"], written["details"]) == (cut, {cut: cut, "height": "inf", "n": 3})
    assert fields.read(written).details == {cut: cut, "height": "inf", "n": 3}


# -- messages of the right types that cannot be true are refused as they are read ------------------


REPLAY = Replay("x.mcap", 1.8e9, 5.0, 1.0, None, 3.0, 60.0, 1.0, False, False, False)


@pytest.mark.parametrize(
    "message",
    [
        State(1.0, "lost", activation_code=int(ActivationCode.SUCCESS), replay=REPLAY),
        *(State(1.0, "connected", activation_code=int(code)) for code in ActivationCode),
        LinkCounted(1.0, {"acks": 3}, {"crc": 0}, 0.1, {"0.1": 3, "inf": 0}, 0.5),
        Event(1, -5.0, "warning", "what"),
        Hello(10, "a", 1e9),
        Activating(int(ActivationCode.SUCCESS)),
    ],
)
def test_what_agents_tell_is_possible(message: Message) -> None:
    require_possible(message)
    assert decode(encode(message)) == message


@pytest.mark.parametrize(
    ("message", "field"),
    [
        (State(1e300, "lost"), "at"),
        (State(1.0, "cheerful"), "connection"),
        (State(1.0, "lost", activation_code=-1), "activation_code"),
        (State(1.0, "lost", replay=replace(REPLAY, utc=1e300)), "utc"),
        (State(1.0, "lost", replay=replace(REPLAY, utc=-1.0)), "utc"),
        (State(1.0, "lost", replay=replace(REPLAY, duration_s=1e300)), "flight"),
        (LinkCounted(1.0, {"acks": "many"}, {}, 0.1), "counters"),
        (LinkCounted(1.0, {}, {"crc": None}, 0.1), "discards"),
        (LinkCounted(1.0, {}, {}, 0.1, {"0.1": True}), "round_trips"),
        (LinkCounted(-1e300, {}, {}, 0.1), "at"),
        (Event(1, 1e17, "info", "what"), "at"),
        (Event(1, 1.0, "shout", "what"), "level"),
        (Hello(10, "a", -1e300), "at"),
        (Activating(1 << 40), "code"),
    ],
)
def test_what_cannot_be_is_refused_by_its_name(message: Message, field: str) -> None:
    with pytest.raises(InvalidValue, match=field):
        require_possible(message)
    with pytest.raises(MessageError, match=field):
        decode(encode(message))


# What each kind of message was in this version: its name, and a digest of its fields and of what
# stands in them.
KNOWN_VERSION = 17
KNOWN = """
AcquireLease:2c1866 Activate:e3b0c4 Activating:ba3e9c Ask:4aa9db AskTakeOver:798194
AskVersion:e3b0c4 AuthorityTaken:b544c6 ChangeHeading:ee0844 ChangeHeight:2fe874
ConfirmTakeOver:565b7b Event:bfcc65 FlyAround:34354f FlyPattern:674527 FlyTo:13c862
GoHome:e3b0c4 Goodbye:ea9649 Halt:00c6f1 Hello:b217f9 JournalNote:98aa92 Land:e3b0c4
LeaseChanged:f4fb81 LinkCounted:b15a94 MissionReport:260962 MobileMessage:99a016 Obtain:e3b0c4
OrderOutcome:6d2a84 OrderReplay:78621e PauseMission:e3b0c4 PlanChanged:5bdddd PointGimbal:fa1de6
Release:e3b0c4 ReleaseLease:c5b21e RenewLease:a4144d ResetHotpointHeading:e3b0c4
ResumeMission:e3b0c4 SendToMobile:cfbaf4 SetHotpointRadius:7a7d47 SetHotpointRate:315188
SetMissionSpeed:b82e67 StartHotpoint:428563 StartMission:94e50f StartMotors:e3b0c4 State:071f83
Steer:6c4be2 SteerRefused:70fa65 Stop:e3b0c4 StopMission:e3b0c4 StopMotors:e3b0c4 TakeOff:e3b0c4
Telemetry:f0a4a0 TurnGimbal:4b1ef4 UploadPlan:20efaf UseCamera:9b369c
"""


def words(kind: type[Any]) -> set[str]:
    """Fields of a message and of what stands in it, their kinds, and each word that one may be."""
    found, hints = set(), get_type_hints(kind)
    for name in (field.name for field in dataclasses.fields(kind)):
        hint = hints[name]
        parts = [one for one in (hint, *get_args(hint)) if isinstance(one, type)]
        enums = [one for one in parts if issubclass(one, Enum)]
        kinds = " | ".join(one.__name__ for one in parts)
        told = [word.value for one in enums for word in one]
        found.add(f"{kind.__name__}.{name}: {kinds} {told}")
        found |= {word for one in parts if dataclasses.is_dataclass(one) for word in words(one)}
    return found


def digest(kind: type[Any]) -> str:
    return hashlib.sha256("\n".join(sorted(words(kind))).encode()).hexdigest()[:6]


def test_other_messages_are_another_version() -> None:
    """Two ends that count differently part; two that count alike understand each other."""
    kinds = (*Message.__args__, *(type(order) for order in ORDERS))
    told = {f"{kind.__name__}:{digest(kind)}" for kind in kinds}
    changed = sorted(told ^ set(KNOWN.split()))
    raised = "raise VERSION of m100link/apps/agent/messages.py, and KNOWN_VERSION and KNOWN here"
    assert not changed, f"messages have changed: {raised}: {changed}"
    assert VERSION == KNOWN_VERSION, f"messages have changed: {raised}"


def test_a_message_may_be_as_long_as_the_longest_and_no_byte_longer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    message = Ask(1, orders.UploadPlan(b"{}", (b"point",)))
    size = len(encode(message))
    monkeypatch.setattr(codec, "MAX_SIZE", size)
    assert len(encode(message)) == size
    monkeypatch.setattr(codec, "MAX_SIZE", size - 1)
    with pytest.raises(MessageError, match=f"would have {size} bytes, at most {size - 1} go"):
        encode(message)
