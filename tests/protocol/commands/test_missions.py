"""The reports of missions, in words, metres and degrees."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from m100link.errors import BadAck
from m100link.protocol import PROFILES, MissionCode, SystemCode, Unrecognised, parse_command
from m100link.protocol.command import Acknowledged
from m100link.protocol.commands.hotpoint import HotpointDownload, HotpointSetRadius, HotpointStart
from m100link.protocol.commands.missions import (
    COMMAND_SET,
    HotpointStatus,
    IdleStatus,
    MissionStatus,
    OtherKind,
    Reached,
    Uploaded,
    WaypointEvent,
    WaypointStatus,
)
from m100link.protocol.commands.registry import COMMANDS
from m100link.protocol.commands.waypoint import (
    IdleSpeedAnswer,
    WaypointDownloadMission,
    WaypointDownloadPoint,
    WaypointGetIdleSpeed,
    WaypointPoint,
    WaypointPointAnswer,
    WaypointStartStop,
)

FIRMWARE = PROFILES["3.1"]


def test_a_waypoint_reached_is_reported_in_six_bytes_and_read_in_five_as_well() -> None:
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


def test_what_is_reported_is_shown_in_words_metres_and_degrees() -> None:
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


# -- acks of missions: one byte of code, a tail, and system codes that stand in their place --------


ACKNOWLEDGED: list[type[Acknowledged[Any]]] = [
    kind
    for address, kind in COMMANDS.items()
    if address.command_set == COMMAND_SET and issubclass(kind, Acknowledged)
]


@pytest.mark.parametrize("kind", ACKNOWLEDGED)
@pytest.mark.parametrize("code", SystemCode)
def test_a_system_code_in_the_place_of_the_ack_is_seen(
    code: SystemCode, kind: type[Acknowledged[Any]]
) -> None:
    payload = kind.encode_ack(code)
    assert payload == bytes((code & 0xFF, 0xFF))
    seen = kind.code_of(kind.parse_ack(payload))
    assert seen == code
    assert seen is not None
    assert seen.is_system
    assert seen.meaning == code.meaning


def test_code_and_index_are_shown_as_they_stand_even_where_they_make_a_system_code() -> None:
    answer = WaypointPoint.parse_ack(b"\x01\xff")
    assert answer.code.is_system
    assert WaypointPoint.ack_raw(answer) == {"code": 1, "index": 255}


@pytest.mark.parametrize("kind", ACKNOWLEDGED)
def test_a_refusal_may_be_a_code_alone(kind: type[Acknowledged[Any]]) -> None:
    answer = kind.parse_ack(b"\xd1")
    assert kind.code_of(answer) is MissionCode.AUTHORITY_NEEDED
    assert kind.parse_ack(kind.encode_ack(MissionCode.AUTHORITY_NEEDED)) == answer


@pytest.mark.parametrize(
    "kind",
    [
        WaypointPoint,
        WaypointGetIdleSpeed,
        WaypointDownloadMission,
        WaypointDownloadPoint,
        HotpointStart,
    ],
)
def test_a_success_without_what_was_asked_for_is_a_bad_ack(kind: type[Acknowledged[Any]]) -> None:
    with pytest.raises(BadAck, match="it takes"):
        kind.parse_ack(b"\0")


@pytest.mark.parametrize("kind", [WaypointDownloadMission, WaypointDownloadPoint, HotpointDownload])
def test_a_download_that_is_longer_than_the_upload_is_a_bad_ack(
    kind: type[Acknowledged[Any]],
) -> None:
    size = kind.ANSWER.size()
    assert kind.code_of(kind.parse_ack(bytes(1 + size))) is MissionCode.SUCCESS
    with pytest.raises(BadAck, match=f"has {2 + size} byte.s., it takes {1 + size}"):
        kind.parse_ack(bytes(2 + size))


@given(st.sampled_from(ACKNOWLEDGED), st.binary(max_size=100))
def test_no_ack_raises_anything_else(kind: type[Acknowledged[Any]], payload: bytes) -> None:
    try:
        answer = kind.parse_ack(payload)
    except BadAck:
        return
    raw = kind.ack_raw(answer)
    assert raw["code"] in (payload[0], payload[0] | 0xFF00)
    kind.ack_fields(answer)


def test_the_code_of_an_ack_has_its_meaning() -> None:
    assert WaypointStartStop.parse_ack(b"\xeb") is MissionCode.NO_POINTS
    unknown = WaypointStartStop.parse_ack(b"\x77")
    assert (int(unknown), unknown.is_known) == (0x77, False)
    answer = WaypointPoint.parse_ack(b"\xe6\x02")
    assert answer == WaypointPointAnswer(MissionCode.POINTS_TOO_FAR, 2)
    assert WaypointPoint.ack_fields(answer)["ack"]["meaning"] == MissionCode(0xE6).meaning


def test_the_speed_in_force_stands_behind_its_code() -> None:
    answer = IdleSpeedAnswer(MissionCode.SUCCESS, 4.5)
    payload = WaypointGetIdleSpeed.encode_ack(answer)
    assert payload == b"\0\0\0\x90\x40"
    assert WaypointGetIdleSpeed.parse_ack(payload) == answer
    assert WaypointGetIdleSpeed.ack_fields(answer)["idle_speed_m_s"] == 4.5


def test_what_nobody_would_send_stands_behind_the_code_of_a_download_and_is_named() -> None:
    size = WaypointDownloadPoint.ANSWER.size()
    zeros = WaypointDownloadPoint.parse_ack(bytes(1 + size))
    ones = WaypointDownloadPoint.parse_ack(b"\0" + b"\xff" * size)
    assert WaypointDownloadPoint.ack_problems(ones) == ones.record.problems()
    assert {one.field for one in WaypointDownloadPoint.ack_problems(ones)} > {
        one.field for one in WaypointDownloadPoint.ack_problems(zeros)
    }
    assert WaypointPoint.ack_problems(WaypointPoint.parse_ack(b"\0\2")) == []
    assert WaypointDownloadPoint.ack_problems(MissionCode.AUTHORITY_NEEDED) == []


def test_an_unconfirmed_command_that_is_answered_all_the_same_is_answered_by_a_code() -> None:
    assert HotpointSetRadius.parse_ack(b"\xc2") is MissionCode.BAD_RADIUS
