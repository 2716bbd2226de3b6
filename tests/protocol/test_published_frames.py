"""The frames of the fact sheet's appendix A: bytes on one side, their meaning on the other."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import pytest

from m100link.protocol import (
    Acceleration,
    Activate,
    ActivationCode,
    AngularVelocity,
    Attitude,
    AuthorityChanged,
    AuthorityCode,
    Battery,
    Command,
    ControlDevice,
    FlightStatus,
    GetVersion,
    Gimbal,
    Magnetometer,
    Move,
    Position,
    PushTelemetry,
    RemoteControl,
    Request,
    RequestAuthority,
    SendToMobile,
    StartTask,
    Task,
    Time,
    Velocity,
    Version,
    VersionCode,
    parse_command,
    profile,
)
from m100link.wire import Cipher, FrameDecoder, encode_frame
from tests.support import KEY

FIRMWARE = profile("3.1")
DIGITS = "12345678901234567890123456789012"


class Published(NamedTuple):
    """One row of the appendix."""

    wire: str
    session: int
    sequence: int
    encrypted: bool
    padding: int
    meaning: object


COMMANDS = {
    "version query": Published(
        "aa130002 00000000 0000007e 000000c7 d99b72", 2, 0, False, 0, GetVersion()
    ),
    "activation": Published(
        "aa3e0002 00000000 0100c0bf 00017856 34120200 0000000a 01033132 33343536 37383930 31323334"
        "35363738 39303132 33343536 37383930 31320c49 52d0",
        2,
        1,
        False,
        0,
        Activate(0x12345678, 2, 0x03010A00, DIGITS),
    ),
    "obtain control, encrypted": Published(
        "aa200002 2d000000 02004792 55c88b20 88550f02 e256bb58 64386315 f7c85683",
        2,
        2,
        True,
        13,
        RequestAuthority(obtain=True),
    ),
    "movement": Published(
        "aa230000 00000000 0400757f 01034800 00803f00 00000000 00003f00 00204163 c2ab89",
        0,
        4,
        False,
        0,
        Move(0x48, 1.0, 0.0, 0.5, 10.0),
    ),
    "movement, encrypted": Published(
        "aa300000 2d000000 0500aba2 53cc0251 551a828c 879a128f f4032f22 a79b57fa e59a7d3b 5813d93e"
        "ccc2c79c 7dd746bf",
        0,
        5,
        True,
        13,
        Move(0x48, 1.0, 0.0, 0.5, 10.0),
    ),
    "14 bytes to the mobile device, encrypted with a full block of padding": Published(
        "aa300002 30000000 06008b1f 58255a07 fb35a50f f955634e 7fb6a141 f29000b6 2a499fd0 a9f39a6a"
        "dd2e7780 7423e56c",
        2,
        6,
        True,
        16,
        SendToMobile(bytes(range(14))),
    ),
    "take-off": Published(
        "aa140002 00000000 0700247e 01010104 e37583af", 2, 7, False, 0, StartTask(1, Task.TAKE_OFF)
    ),
    "authority lost": Published(
        "aa130002 00000000 0900062e 02010420 47bcbe", 2, 9, False, 0, AuthorityChanged(4)
    ),
}

ACKS = {
    "of the version query, 2.3": Published(
        "aa360022 00000000 0000872d 00000418 d2d35344 4b2d7631 2e302042 45544120 4d313030 2d30322e"
        "30332e31 302e3030 00004228 f8f9",
        2,
        0,
        False,
        0,
        Version(VersionCode.ACTIVATED, 0xD3D21804, "SDK-v1.0 BETA M100-02.03.10.00"),
    ),
    "of the version query, 3.1, not activated": Published(
        "aa410022 00000000 0000c4df 01ffac3a 45a63031 32333435 36373839 0053444b 2d76312e 30204245"
        "5441204d 3130302d 30332e30 312e3031 2e303000 00c4a783 64",
        2,
        0,
        False,
        0,
        Version(VersionCode(0xFF01), 0xA6453AAC, "SDK-v1.0 BETA M100-03.01.01.00", "0123456789"),
    ),
    "of the activation": Published(
        "aa120022 00000000 01002dbc 0000fcf2 9bcc", 2, 1, False, 0, ActivationCode.SUCCESS
    ),
    "of obtain control, plain": Published(
        "aa120022 00000000 02002d4c 030041a0 e6d4", 2, 2, False, 0, AuthorityCode.NOT_CHANGED
    ),
    "of obtain control, encrypted": Published(
        "aa200022 2e000000 030067f3 4ef4b88b ebd54953 c37ffaf6 6efaca7b b93bd323",
        2,
        3,
        True,
        14,
        AuthorityCode.OBTAINED,
    ),
}


def _check_frame(row: Published, is_ack: bool) -> bytes:
    """Decode, compare the header, encode again; the data."""
    wire = bytes.fromhex(row.wire)
    (frame,) = FrameDecoder(Cipher(KEY)).feed(wire)
    assert frame[:5] == (row.session, is_ack, row.sequence, row.encrypted, row.padding)
    again = encode_frame(
        frame.data,
        session=row.session,
        sequence=row.sequence,
        is_ack=is_ack,
        cipher=Cipher(KEY) if row.encrypted else None,
    )
    assert again == wire
    return frame.data


@pytest.mark.parametrize("name", COMMANDS)
def test_published_command_means_what_it_says_and_is_built_again(name: str) -> None:
    row = COMMANDS[name]
    data = _check_frame(row, is_ack=False)
    assert parse_command(data, FIRMWARE) == row.meaning
    assert isinstance(row.meaning, Command)
    assert row.meaning.encode(FIRMWARE) == data


@pytest.mark.parametrize("name", ACKS)
def test_published_ack_means_what_it_says(name: str) -> None:
    row = ACKS[name]
    data = _check_frame(row, is_ack=True)
    kind: dict[type, type[Request[Any]]] = {
        Version: GetVersion,
        ActivationCode: Activate,
        AuthorityCode: RequestAuthority,
    }
    assert kind[type(row.meaning)].parse_ack(data) == row.meaning
    if isinstance(row.meaning, Version):
        assert row.meaning.encode() == data


@pytest.mark.parametrize(
    ("wire", "session", "is_ack", "sequence"),
    [
        ("aa0c0000 00000000 0000af8e", 0, False, 0),
        ("aa0c0022 00000000 0700afbc", 2, True, 7),
    ],
)
def test_published_header_without_data(
    wire: str, session: int, is_ack: bool, sequence: int
) -> None:
    (frame,) = FrameDecoder().feed(bytes.fromhex(wire))
    assert frame == (session, is_ack, sequence, False, 0, b"")
    again = encode_frame(b"", session=session, is_ack=is_ack, sequence=sequence)
    assert again == bytes.fromhex(wire)


def test_published_telemetry_has_every_item_where_it_belongs() -> None:
    wire = bytes.fromhex(
        "aa8e0000 00000000 0a00d188 0200ff0f 90010000 00ca9a3b 00000080 3f000000 00000000 00000000"
        "00000000 00000000 00000000 00000080 3f000000 40000040 40010000 00000000 00000000 0000182d"
        "4454fb21 d93f353a e2b48fce ff3f0000 20410000 c03f0501 00020003 00000000 00000000 00401f3f"
        "ee000000 00000020 c1000000 0000035a 040af609 7d3f"
    )
    (frame,) = FrameDecoder().feed(wire)
    assert (len(wire), frame.session, frame.sequence) == (142, 0, 10)
    push = parse_command(frame.data, FIRMWARE)
    assert isinstance(push, PushTelemetry)
    packet = push.packet
    assert packet.flags == 0x0FFF
    assert packet.records() == [
        Time(400, 1_000_000_000, 0, tick_hz=400),
        Attitude(1, 0, 0, 0),
        Acceleration(0, 0, 0),
        Velocity(1, 2, 3, status=1),
        AngularVelocity(0, 0, 0),
        Position(math.radians(22.5), math.radians(113.9), 10, 1.5, gps_health=5),
        Magnetometer(1, 2, 3),
        RemoteControl(0, 0, 0, 0, mode=8000, gear=-4545),
        Gimbal(0, -10, 0, limits=0),
        FlightStatus(3),
        Battery(90),
        ControlDevice(control=0x0A, mode=0x04),
    ]
    assert push.encode(FIRMWARE) == frame.data
