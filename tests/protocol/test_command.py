"""What every command has in common: it comes back as it went, and its ack is read with care."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from m100link.errors import BadAck
from m100link.protocol import (
    PROFILES,
    Activate,
    ActivationCode,
    Address,
    Arm,
    AuthorityChanged,
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
    TelemetryPacket,
    Unrecognised,
    encode_code,
    encode_telemetry,
    parse_command,
    profile,
)
from m100link.protocol.commands.registry import COMMANDS, address_of
from m100link.protocol.items import BY_NAME
from m100link.session import SessionMode

FIRMWARE = profile("3.1")
FIRMWARES = st.sampled_from(list(PROFILES.values()))
KINDS: tuple[type[Command], ...] = (Request, Push, Movement, Notification)
BYTE, U32 = st.integers(0, 0xFF), st.integers(0, 0xFFFFFFFF)
F32 = st.floats(width=32, allow_nan=False)

COMMAND = st.one_of(
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
    st.builds(FromMobile, st.binary(min_size=1, max_size=100)),
)


@given(COMMAND, FIRMWARES)
def test_every_command_comes_back_as_it_went(command: Command, firmware: FirmwareProfile) -> None:
    data = command.encode(firmware)
    assert data[:2] == bytes(command.ADDRESS)
    assert parse_command(data, firmware) == command


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
    # Sets and ids as the document's section 2.2 numbers them, with the two later commands.
    wanted = {
        *((0x00, number) for number in (0x00, 0x01, 0x10, 0xFE)),
        *((0x01, number) for number in (0x00, 0x01, 0x02, 0x03, 0x05)),
        *((0x02, number) for number in (0x00, 0x01, 0x02)),
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
    (SetTelemetryRates, b"\x06" + bytes(15)),
    (SendToMobile, b""),
    (SendToMobile, bytes(101)),
    (RequestAuthority, b""),
    (RequestAuthority, b"\x02"),
    (RequestAuthority, b"\x01\x00"),
    (StartTask, b"\x01"),
    (QueryTask, b""),
    (Move, bytes(16)),
    (Move, bytes(18)),
    (Arm, b"\x02"),
    (AuthorityChanged, b""),
    (FromMobile, bytes(101)),
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
PLAIN_ACKS = [kind for kind in REQUESTS if kind is not GetVersion]


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


@pytest.mark.parametrize("kind", [k for k in REQUESTS if k not in (StartTask, QueryTask)])
def test_an_ack_of_one_byte_is_a_bad_ack_elsewhere(kind: type[AnyRequest]) -> None:
    with pytest.raises(BadAck) as caught:
        kind.parse_ack(b"\x02")
    assert caught.value.payload == b"\x02"


def test_bytes_behind_a_code_are_ignored() -> None:
    assert Activate.parse_ack(b"\x03\x00garbage") is ActivationCode.NEW_DEVICE


def test_each_command_is_of_one_kind() -> None:
    kinds = {kind: [c for c in COMMANDS.values() if issubclass(c, kind)] for kind in KINDS}
    assert kinds[Movement] == [Move]
    assert kinds[Notification] == [PushTelemetry, AuthorityChanged, FromMobile]
    assert sum(map(len, kinds.values())) == len(COMMANDS)


@pytest.mark.parametrize("kind", COMMANDS.values())
def test_only_requests_want_an_ack(kind: type[Command]) -> None:
    wants_ack = kind.SESSION_MODE is SessionMode.RELIABLE
    assert wants_ack is issubclass(kind, Request)
