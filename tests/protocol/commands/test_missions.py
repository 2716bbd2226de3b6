"""What is told of missions, in words, metres and degrees."""

from __future__ import annotations

import pytest

from m100link.protocol import PROFILES, Unrecognised, parse_command
from m100link.protocol.commands.missions import (
    HotpointStatus,
    IdleStatus,
    MissionStatus,
    OtherKind,
    Reached,
    Uploaded,
    WaypointEvent,
    WaypointStatus,
)

FIRMWARE = PROFILES["3.1"]


def test_a_waypoint_reached_is_told_in_six_bytes_and_read_in_five_as_well() -> None:
    told = WaypointEvent(Reached(7, 4))
    assert told.value(FIRMWARE) == b"\x02\x07\x04\0\0\0"
    assert WaypointEvent.parse(b"\x02\x07\x04\0\0\0", FIRMWARE) == told
    assert WaypointEvent.parse(b"\x02\x07\x04\0\0", FIRMWARE) == told


@pytest.mark.parametrize("kind", [MissionStatus, WaypointEvent])
@pytest.mark.parametrize("value", [b"", b"\x01", b"\x00" * 5, b"\x01" * 5, b"\x01" * 7])
def test_a_push_of_another_size_is_not_read(
    kind: type[MissionStatus | WaypointEvent], value: bytes
) -> None:
    command = parse_command(bytes(kind.ADDRESS) + value, FIRMWARE)
    assert isinstance(command, Unrecognised)
    assert "takes 6 byte(s)" in command.reason


@pytest.mark.parametrize("kind", [MissionStatus, WaypointEvent])
def test_a_kind_that_nobody_knows_keeps_its_bytes(
    kind: type[MissionStatus | WaypointEvent],
) -> None:
    told = kind.parse(b"\x09abcde", FIRMWARE)
    assert told.kind == 9
    assert told.name == f"{kind.NAME}_unknown"
    assert told.raw() == {"kind": 9, "data": b"abcde".hex()}
    assert told.fields() == {"kind": "unknown", "unknown": b"abcde".hex()}
    [problem] = told.problems()
    assert (problem.field, problem.value) == ("kind", 9)
    assert told.value(FIRMWARE) == b"\x09abcde"
    assert OtherKind(9, b"abcde") == (
        told.status if isinstance(told, MissionStatus) else told.event
    )


def test_what_is_told_is_shown_in_words_metres_and_degrees() -> None:
    circle = MissionStatus(HotpointStatus(1, radius_cm=2850, rate=115)).fields()
    assert (circle["kind"], circle["status"]) == ("hotpoint", "circling")
    assert (circle["radius_m"], circle["rate_deg_s"]) == (28.5, 11.5)
    waypoint = MissionStatus(WaypointStatus(3, 4, 0xD1)).fields()
    assert (waypoint["index"], waypoint["status"]) == (3, "in_action")
    assert waypoint["error"]["name"] == "AUTHORITY_NEEDED"
    assert MissionStatus(WaypointStatus(3, 99)).fields()["status"] == 99
    ended = MissionStatus(IdleStatus(1, 1, 0xF2)).fields()
    assert (ended["last_mission"], ended["is_broken_off"]) == ("waypoint", True)
    assert ended["reason"]["name"] == "GOING_HOME"
    assert MissionStatus(IdleStatus(9)).fields()["last_mission"] == 9
    uploaded = WaypointEvent(Uploaded(1, 90)).fields()
    assert uploaded == {"kind": "uploaded", "valid": 1, "estimated_time_s": 90}
