"""Gimbal: tenths of a degree on the wire, limits before anything is sent."""

from __future__ import annotations

import math
import re
from typing import Any

import pytest

from m100link.errors import UsageError
from m100link.protocol import PROFILES, Push, parse_command
from m100link.protocol.commands.gimbal import (
    GimbalAngle,
    GimbalAngleMode,
    GimbalSpeed,
    StartVideo,
    StopVideo,
    TakePhoto,
)
from tests.support import load_vectors

FIRMWARE = PROFILES["3.1"]
ROWS = [row for row in load_vectors("later-commands") if row["name"].startswith("gimbal")]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row["value"])
def test_the_fields_are_those_of_the_wire_in_degrees(row: dict[str, Any]) -> None:
    raw = row["fields"]
    value = bytes.fromhex(row["value"])
    tenths = raw["yaw"] / 10, raw["roll"] / 10, raw["pitch"] / 10
    if row["name"] == "gimbal_speed":
        assert GimbalSpeed.parse(value, FIRMWARE) == GimbalSpeed(*tenths, raw["flags"])
    else:
        command = GimbalAngle(*tenths, raw["mode"], raw["duration"] / 10)
        assert GimbalAngle.parse(value, FIRMWARE) == command


@pytest.mark.parametrize(
    "command",
    [
        GimbalSpeed(yaw_deg_s=180.1),
        GimbalSpeed(pitch_deg_s=math.nan),
        GimbalSpeed(flags=256),
        GimbalSpeed(flags=0x81),
        GimbalAngle(yaw_deg=-320.1),
        GimbalAngle(roll_deg=36.0),
        GimbalAngle(pitch_deg=31.0),
        GimbalAngle(duration_s=26.0),
        GimbalAngle(mode=-1),
        GimbalAngle(mode=16),
    ],
    ids=str,
)
def test_what_a_gimbal_does_not_do_is_refused_before_it_is_sent(
    command: GimbalSpeed | GimbalAngle,
) -> None:
    with pytest.raises(UsageError, match="cannot be sent") as caught:
        command.encode(FIRMWARE)
    assert re.search("stay within|allowed", caught.value.remedy)


# Little endian, tenths of a degree: yaw, roll, pitch, and flags, or mode and tenths of a second.
@pytest.mark.parametrize(
    ("command", "value"),
    [
        (GimbalSpeed(180.0, -180.0, 12.3, 0xE0), "0807 f8f8 7b00 e0"),
        (GimbalSpeed(-180.0, 180.0, -12.3, 0x00), "f8f8 0807 85ff 00"),
        (GimbalAngle(320.0, -35.0, 30.0, 0, 25.5), "800c a2fe 2c01 00 ff"),
        (GimbalAngle(-320.0, 35.0, -90.0, 15, 0.0), "80f3 5e01 7cfc 0f 00"),
        (TakePhoto(0), "00"),
        (StopVideo(255), "ff"),
    ],
    ids=str,
)
def test_what_a_gimbal_and_a_camera_do_reaches_to_these_ends(command: Push, value: str) -> None:
    assert command.value(FIRMWARE) == bytes.fromhex(value)
    assert command.problems() == []


@pytest.mark.parametrize(
    ("command", "fields"),
    [
        (GimbalSpeed(180.1, -180.1, 180.0), ["yaw", "roll"]),
        (GimbalSpeed(pitch_deg_s=-180.1), ["pitch"]),
        (GimbalSpeed(flags=-0x80), ["flags"]),
        (GimbalSpeed(flags=0x180), ["flags"]),
        (GimbalSpeed(flags=0x90), ["flags"]),
        (GimbalAngle(320.1, 35.1, 30.1, 16), ["yaw", "roll", "pitch", "mode"]),
        (GimbalAngle(-320.1, -35.1, -90.1, -1), ["yaw", "roll", "pitch", "mode"]),
    ],
    ids=str,
)
def test_what_another_program_sent_and_no_gimbal_does_is_named(
    command: GimbalSpeed | GimbalAngle, fields: list[str]
) -> None:
    assert [problem.field for problem in command.problems()] == fields


@pytest.mark.parametrize("byte", [-1, 256])
def test_a_camera_is_sent_one_byte(byte: int) -> None:
    with pytest.raises(UsageError, match=f"any {byte} cannot be sent"):
        TakePhoto(byte).encode(FIRMWARE)


def test_the_mode_is_shown_in_words() -> None:
    mode = GimbalAngleMode.ABSOLUTE | GimbalAngleMode.KEEP_ROLL
    assert GimbalAngle(mode=mode).fields()["mode_bits"] == ["absolute", "keep_roll"]
    assert GimbalAngle(mode=0x80).fields()["mode_bits"] == []


# -- camera: whatever the byte says ----------------------------------------------------------------


@pytest.mark.parametrize("kind", [TakePhoto, StartVideo, StopVideo])
@pytest.mark.parametrize("value", [b"", b"\0", b"\xff", b"\1\2"])
def test_any_value_will_do(kind: type[Push], value: bytes) -> None:
    for firmware in PROFILES.values():
        command = parse_command(bytes(kind.ADDRESS) + value, firmware)
        assert isinstance(command, kind)
        assert command.raw() == {"any": value[0] if value else 0}
