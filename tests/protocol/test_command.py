"""What every command has in common: it comes back as it went, and its ack is read with care."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import pytest
from hypothesis import given
from hypothesis import strategies as st

from m100link.errors import BadAck, BadValue
from m100link.protocol import (
    PROFILES,
    Activate,
    ActivationCode,
    Address,
    Arm,
    AuthorityChanged,
    AuthorityCode,
    Command,
    FirmwareProfile,
    FromMobile,
    GetVersion,
    Move,
    Movement,
    Notification,
    Push,
    PushTelemetry,
    QueryTask,
    Request,
    RequestAuthority,
    SendToMobile,
    SetTelemetryRates,
    StartTask,
    TaskStartCode,
    TelemetryPacket,
    Unrecognised,
    encode_code,
    encode_telemetry,
    parse_command,
    profile,
)
from m100link.protocol.command import plain
from m100link.protocol.commands.gimbal import (
    GimbalAngle,
    GimbalSpeed,
    StartVideo,
    StopVideo,
    TakePhoto,
)
from m100link.protocol.commands.hotpoint import (
    FollowTarget,
    HotpointResetYaw,
    HotpointSetRadius,
    HotpointSetRate,
)
from m100link.protocol.commands.missions import (
    COMMAND_SET,
    MissionRequest,
    MissionStatus,
    WaypointEvent,
)
from m100link.protocol.commands.registry import COMMANDS, address_of
from m100link.protocol.commands.virtual_rc import Sync, VirtualRcData, VirtualRcSettings
from m100link.protocol.fields import Laid, Number, Numbers
from m100link.protocol.firmware import Generation
from m100link.protocol.items import BY_NAME
from m100link.session import SessionMode

T = TypeVar("T")

FIRMWARE = profile("3.1")
FIRMWARES = st.sampled_from(list(PROFILES.values()))
KINDS: tuple[type[Command], ...] = (Request, Push, Movement, Notification)
BYTE, U32 = st.integers(0, 0xFF), st.integers(0, 0xFFFFFFFF)


def tenths(low: int, high: int) -> st.SearchStrategy[float]:
    return st.integers(low, high).map(lambda number: number / 10.0)


F32 = st.floats(width=32, allow_nan=False)

LAID = [kind for kind in COMMANDS.values() if issubclass(kind, Laid)]


def inside(number: Number) -> st.SearchStrategy[int | float]:
    """Whatever the declaration of a number allows."""
    low, high = number.bounds
    if isinstance(low, int) and isinstance(high, int):
        return st.integers(low, high)
    values = st.floats(low, high)
    return values.map(as_f32).filter(number.fits) if number.format == "f" else values


def as_f32(number: float) -> float:
    """As a wire that has 32 bits rounds it."""
    [rounded] = struct.unpack("<f", struct.pack("<f", number))
    return float(rounded)


def laid(kind: type[Laid]) -> st.SearchStrategy[Command]:
    """Commands of a fixed layout whose values are inside their ranges."""
    values: dict[str, st.SearchStrategy[Any]] = {}
    for _, part in kind.LAYOUT.offsets():
        if isinstance(part, Number):
            values[part.name] = inside(part)
        elif isinstance(part, Numbers):
            values[part.name] = st.tuples(*[inside(part.each)] * part.many)
        else:
            values |= dict.fromkeys(part.names, st.integers(0, 15))
    return st.builds(kind, **values).filter(lambda command: not command.problems())


COMMAND = st.one_of(
    *map(laid, LAID),
    st.just(GetVersion()),
    st.builds(
        Activate,
        U32,
        U32,
        U32,
        st.text(st.characters(min_codepoint=1, max_codepoint=127), max_size=32),
    ),
    st.builds(
        SetTelemetryRates,
        st.dictionaries(st.sampled_from(list(BY_NAME)), st.sampled_from((0, 1, 10, 50, 100))),
    ),
    st.builds(SendToMobile, st.binary(min_size=1, max_size=100)),
    st.builds(RequestAuthority, st.booleans()),
    st.builds(StartTask, BYTE, BYTE),
    st.builds(QueryTask, BYTE),
    st.builds(Move, BYTE, F32, F32, F32, F32),
    st.builds(Arm, st.booleans()),
    st.builds(AuthorityChanged, BYTE),
    st.builds(
        GimbalSpeed, *(tenths(-1800, 1800) for _ in range(3)), st.sampled_from((0, 0x80, 0xE0))
    ),
    st.builds(
        GimbalAngle,
        *(
            tenths(-3200, 3200),
            tenths(-350, 350),
            tenths(-900, 300),
            st.integers(0, 15),
            tenths(0, 255),
        ),
    ),
    st.sampled_from((TakePhoto(), StartVideo(), StopVideo())),
    st.builds(VirtualRcSettings, st.booleans(), st.booleans()),
    st.builds(VirtualRcData, st.tuples(*[st.integers(364, 1684)] * 16)),
    st.builds(FromMobile, st.binary(min_size=1, max_size=100)),
)


@given(COMMAND, FIRMWARES)
def test_every_command_comes_back_as_it_went(command: Command, firmware: FirmwareProfile) -> None:
    data = command.encode(firmware)
    assert data[:2] == bytes(command.ADDRESS)
    assert parse_command(data, firmware) == command


@given(st.data(), FIRMWARES)
def test_a_command_with_a_fixed_layout_is_read_whatever_it_holds(
    data: st.DataObject, firmware: FirmwareProfile
) -> None:
    kind = data.draw(st.sampled_from(LAID))
    value = data.draw(st.binary(min_size=kind.LAYOUT.size, max_size=kind.LAYOUT.size))
    command = kind.parse(value, firmware)
    assert repr(kind.from_wire(kind.LAYOUT.write(command))) == repr(command)  # NaN is not NaN
    assert command.fields() or command.raw().keys() == {"any"}  # a byte without a meaning
    if not command.problems():
        assert kind.parse(command.value(firmware), firmware) == command
        return
    with pytest.raises(BadValue) as caught:
        command.value(firmware)
    assert repr(caught.value.value) == repr(command.problems()[0].value)


@given(COMMAND)
def test_the_fields_of_every_command_are_json(command: Command) -> None:
    fields = command.fields()
    if "movement" not in fields:  # infinity is a float that JSON lacks
        assert json.loads(json.dumps(fields)) == fields


def test_fields_are_the_values_of_a_command_and_nothing_else() -> None:
    assert GetVersion().fields() == {}
    assert QueryTask(7).fields() == {"task_sequence": 7}
    assert StartTask(7, 4).fields() == {"task_sequence": 7, "task": "take_off"}
    assert StartTask(7, 99).fields() == {"task_sequence": 7, "task": 99}
    names = ("control_flag", "roll_or_x", "pitch_or_y", "throttle_or_z", "yaw")
    values = (0x48, 1.0, 2.0, 3.0, 4.0)
    assert Move(*values).fields() == {"movement": dict(zip(names, values, strict=True))}


@given(st.binary(max_size=200), FIRMWARES)
def test_no_data_make_parsing_raise(data: bytes, firmware: FirmwareProfile) -> None:
    parse_command(data, firmware)


@given(st.sampled_from(sorted(COMMANDS)), st.binary(max_size=130), FIRMWARES)
def test_no_value_of_a_known_address_makes_parsing_raise(
    address: Address, value: bytes, firmware: FirmwareProfile
) -> None:
    command = parse_command(bytes(address) + value, firmware)
    if isinstance(command, Unrecognised):
        assert (command.address, command.value) == (address, value)
        assert command.reason


def test_every_address_of_the_document_is_known() -> None:
    # Sets and ids as the document's section 2.2 numbers them, with the later commands.
    wanted = {
        *((0x00, number) for number in (0x00, 0x01, 0x10, 0xFE)),
        *((0x01, number) for number in (0x00, 0x01, 0x02, 0x03, 0x05)),
        *((0x01, number) for number in (0x1A, 0x1B, 0x20, 0x21, 0x22)),
        *((0x02, number) for number in (0x00, 0x01, 0x02, 0x03, 0x04)),
        *((0x03, number) for number in range(0x10, 0x18)),
        *((0x03, number) for number in range(0x20, 0x28)),
        *((0x03, number) for number in range(0x30, 0x34)),
        (0x04, 0x00),
        *((0x05, number) for number in (0x00, 0x01)),
    }
    assert set(COMMANDS) == wanted
    assert len({command.NAME for command in COMMANDS.values()}) == len(wanted)


@pytest.mark.parametrize("data", [b"", b"\x01"])
def test_data_too_short_for_an_address_are_unrecognised(data: bytes) -> None:
    assert address_of(data) is None
    command = parse_command(data, FIRMWARE)
    assert isinstance(command, Unrecognised)
    assert (command.address, command.value) == (None, data)
    assert "too short" in command.reason


def test_an_unknown_address_is_named() -> None:
    command = parse_command(b"\x07\x2a\x01", FIRMWARE)
    assert isinstance(command, Unrecognised)
    assert command.address == (7, 0x2A)
    assert "0x07/0x2A" in command.reason


BAD_VALUES = [
    (Activate, bytes(40)),  # the release notes of 3.1 strike a field out; 44 stays
    (Activate, bytes(45)),
    (SetTelemetryRates, bytes(12)),
    (SendToMobile, b""),
    (SendToMobile, bytes(101)),
    (RequestAuthority, b""),
    (RequestAuthority, b"\x02"),
    (RequestAuthority, b"\x01\x00"),
    (StartTask, b"\x01"),
    (QueryTask, b""),
    (Move, bytes(16)),
    (Move, bytes(18)),
    (Arm, b""),
    (AuthorityChanged, b""),
    (FromMobile, bytes(101)),
    (GimbalSpeed, bytes(8)),
    (GimbalAngle, bytes(7)),
    (VirtualRcSettings, bytes(64)),  # as DJI's libraries from 3.3 on send channels
    (VirtualRcData, bytes(63)),
    (PushTelemetry, b"\x01"),
]


@pytest.mark.parametrize(("kind", "value"), BAD_VALUES)
def test_a_value_that_cannot_be_says_why(kind: type[Command], value: bytes) -> None:
    command = parse_command(bytes(kind.ADDRESS) + value, FIRMWARE)
    assert isinstance(command, Unrecognised)
    assert any(character.isdigit() for character in command.reason), command.reason


def test_a_telemetry_push_carries_its_packet() -> None:
    value = encode_telemetry({"battery": [55]}, FIRMWARE)
    push = parse_command(b"\x02\x00" + value, FIRMWARE)
    assert isinstance(push, PushTelemetry)
    assert push.fields() == {"telemetry": {"battery": {"percent": 55}}, "flags": 0x0400}
    assert push.encode(FIRMWARE) == b"\x02\x00" + value
    assert PushTelemetry(TelemetryPacket(value, FIRMWARE)).value(FIRMWARE) == value


# -- acks ------------------------------------------------------------------------------------------

AnyRequest = Request[Any]
REQUESTS = [kind for kind in COMMANDS.values() if issubclass(kind, Request)]
MISSIONS = [kind for kind in REQUESTS if issubclass(kind, MissionRequest)]
PLAIN_ACKS = [kind for kind in REQUESTS if kind not in (GetVersion, *MISSIONS)]


@pytest.mark.parametrize("kind", PLAIN_ACKS)
@pytest.mark.parametrize("number", [0, 1, 3, 0x4D, 0xC9, 0xFF00, 0xFF01, 0xFF02, 0xFFFF])
def test_two_bytes_of_an_ack_are_its_code_little_endian(
    kind: type[AnyRequest], number: int
) -> None:
    code = kind.parse_ack(bytes((number & 0xFF, number >> 8)))
    assert code == number
    assert isinstance(code, kind.ANSWER)
    assert encode_code(code) == bytes((number & 0xFF, number >> 8))


@pytest.mark.parametrize("kind", REQUESTS)
def test_an_empty_ack_is_a_bad_ack_that_names_its_command(kind: type[AnyRequest]) -> None:
    with pytest.raises(BadAck, match=kind.NAME) as caught:
        kind.parse_ack(b"")
    assert (caught.value.command, caught.value.payload) == (kind.NAME, b"")


@pytest.mark.parametrize("kind", [StartTask, QueryTask])
def test_acks_of_tasks_may_be_one_byte_as_the_document_prints_them(
    kind: type[AnyRequest],
) -> None:
    assert kind.parse_ack(b"\x01") == kind.parse_ack(b"\x01\x00") == 1


@pytest.mark.parametrize("kind", [k for k in PLAIN_ACKS if k not in (StartTask, QueryTask)])
def test_an_ack_of_one_byte_is_a_bad_ack_elsewhere(kind: type[AnyRequest]) -> None:
    with pytest.raises(BadAck) as caught:
        kind.parse_ack(b"\x02")
    assert caught.value.payload == b"\x02"


def test_bytes_behind_a_code_are_ignored() -> None:
    assert Activate.parse_ack(b"\x03\x00garbage") is ActivationCode.NEW_DEVICE


def test_each_command_is_of_one_kind() -> None:
    kinds = {kind: {c for c in COMMANDS.values() if issubclass(c, kind)} for kind in KINDS}
    on_a_circle = {HotpointSetRate, HotpointSetRadius, HotpointResetYaw}
    assert kinds[Movement] == {Move, VirtualRcSettings, VirtualRcData, FollowTarget} | on_a_circle
    assert kinds[Push] == {GimbalSpeed, GimbalAngle, TakePhoto, StartVideo, StopVideo, Sync}
    pushes = {PushTelemetry, AuthorityChanged, FromMobile, MissionStatus, WaypointEvent}
    assert kinds[Notification] == pushes
    assert sum(map(len, kinds.values())) == len(COMMANDS)


@pytest.mark.parametrize("kind", COMMANDS.values())
def test_requests_want_an_ack_and_pushes_do_not(kind: type[Command]) -> None:
    if not issubclass(kind, Notification):  # the aircraft may want one
        assert (kind.SESSION_MODE is SessionMode.RELIABLE) is issubclass(kind, Request)


# -- what a declaration says ----------------------------------------------------------------------


def test_levels_are_those_of_the_document() -> None:
    """2.1: level 1 moves camera and gimbal, 2 controls flight; the rest asks for none."""
    levels = {kind: kind.LEVEL for kind in COMMANDS.values()}
    flight = {RequestAuthority, StartTask, QueryTask, Move, Arm}
    mount = {GimbalSpeed, GimbalAngle, TakePhoto, StartVideo, StopVideo}
    flight |= {kind for kind in levels if kind.ADDRESS.command_set == COMMAND_SET}
    wanted = {kind: 2 if kind in flight else 1 if kind in mount else 0 for kind in levels}
    assert levels == wanted


def test_commands_came_with_their_firmware() -> None:
    every = COMMANDS.values()
    known = {name: {k for k in every if k.is_known_to(p)} for name, p in PROFILES.items()}
    of_2_3 = {GimbalSpeed, GimbalAngle, TakePhoto, StartVideo, StopVideo}
    of_3_1 = {SetTelemetryRates, Arm, VirtualRcSettings, VirtualRcData, Sync}
    of_3_1 |= {MissionStatus, WaypointEvent}
    of_3_1 |= {kind for kind in every if kind.ADDRESS.command_set == COMMAND_SET}
    assert known["3.1"] == set(COMMANDS.values())
    assert known["3.1"] - known["2.3"] == of_3_1
    assert known["2.3"] - known["1.0"] == of_2_3
    assert known["1.0"] == known["1.0-document"]


@pytest.mark.parametrize("kind", REQUESTS)
@pytest.mark.parametrize("firmware", PROFILES.values(), ids=str)
def test_the_answer_to_an_unreadable_value_is_a_refusal(
    kind: type[AnyRequest], firmware: FirmwareProfile
) -> None:
    code = kind.unreadable(firmware)
    assert code not in (TaskStartCode.STARTED, AuthorityCode.OBTAINED)
    assert kind is RequestAuthority or code != 0
    if kind is not GetVersion:
        assert kind.code_of(kind.parse_ack(kind.encode_ack(code))) == code


def test_a_command_that_declares_neither_value_nor_parse_says_so() -> None:
    class Empty(Push):
        ADDRESS = Address(0x7F, 0x01)
        NAME = "empty"

    with pytest.raises(TypeError, match="Empty has no value"):
        Empty().encode(FIRMWARE)
    with pytest.raises(ValueError, match="Empty is never parsed"):
        Empty.parse(b"", FIRMWARE)


def test_a_class_line_names_the_data_of_a_command_and_no_others() -> None:
    @dataclass(frozen=True, slots=True)
    class Odd(Push, address=(0x7F, 0x03), name="strange", level=1, since=Generation.V3_1):
        number: int

    assert (Address(0x7F, 0x03), "strange", 1) == (Odd.ADDRESS, Odd.NAME, Odd.LEVEL)
    assert (Odd.SINCE, Odd.ENCRYPTED, Odd.MOVES) == (Generation.V3_1, False, False)
    with pytest.raises(TypeError, match="Wrong: commands have no speed"):
        type("Wrong", (Push,), {}, speed=3)
    assert PushTelemetry.NAME == "telemetry"
    assert RequestAuthority.NAME == "request_authority"


def test_bytes_and_codes_are_shown_as_json_can_carry_them() -> None:
    assert plain(b"\x01\xff") == "01ff"
    assert plain(1.5) == 1.5
    shown = plain(AuthorityCode(2))
    assert (shown["code"], shown["name"]) == (2, AuthorityCode(2).name)
    assert shown["meaning"] == AuthorityCode(2).meaning


def test_the_answer_of_a_request_is_found_beside_other_generic_bases() -> None:
    class Labelled(Generic[T]):
        """Something else with brackets."""

    class Odd(Labelled[int], Request[AuthorityCode]):
        ADDRESS = Address(0x7F, 0x02)
        NAME = "odd"

    assert Odd.ANSWER is AuthorityCode
    assert Odd.parse_ack(b"\x02\x00") is AuthorityCode(2)


def test_the_fields_of_an_ack_are_its_code_in_words() -> None:
    assert RequestAuthority.ack_fields(AuthorityCode(2)) == {"ack": plain(AuthorityCode(2))}


def test_set_0_and_a_release_are_alike_in_every_firmware_and_the_rest_needs_a_known_one() -> None:
    assert not GetVersion().needs_known_firmware
    assert not RequestAuthority(obtain=False).needs_known_firmware
    assert RequestAuthority(obtain=True).needs_known_firmware
    assert QueryTask(7).needs_known_firmware


def test_a_command_of_the_document_shows_its_fields_and_knows_no_others() -> None:
    command = RequestAuthority(obtain=True)
    assert command.value(profile("1.0")) == b"\x01"
    assert command.fields() == {"obtain": True}
    assert command.raw() == {}
    assert QueryTask(7).value(profile("1.0")) == b"\x07"
    assert QueryTask(7).fields() == QueryTask(7).raw() == {"task_sequence": 7}
    assert QueryTask.ack_problems(QueryTask.UNREADABLE) == []
