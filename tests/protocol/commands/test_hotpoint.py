"""Hotpoints on the wire."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from m100link.errors import BadValue
from m100link.protocol import PROFILES, MissionCode
from m100link.protocol.commands.hotpoint import (
    FollowStart,
    FollowTarget,
    HotpointDownload,
    HotpointDownloadAnswer,
    HotpointSetRate,
    HotpointStart,
    HotpointStartAnswer,
)

FIRMWARE = PROFILES["3.1"]
HOTPOINT = HotpointStart(latitude=0.9, longitude=0.1, altitude=20.0, radius=30.0, angular_rate=10.0)


@pytest.mark.parametrize(
    "change",
    [
        {"radius": 4.9},
        {"radius": 501.0},
        {"altitude": 4.9},
        {"angular_rate": 30.5},
        {"start_point": 5},
        {"yaw_mode": 5},
        {"version": 1},
        {"latitude": math.nan},
    ],
    ids=str,
)
def test_what_no_circle_has_is_refused_before_it_is_sent(change: dict[str, Any]) -> None:
    assert HOTPOINT.encode(FIRMWARE)
    with pytest.raises(BadValue, match=next(iter(change))):
        replace(HOTPOINT, **change).encode(FIRMWARE)


def test_the_largest_radius_stands_behind_the_code() -> None:
    answer = HotpointStartAnswer(MissionCode.BAD_RADIUS, 250.0)
    payload = HotpointStart.encode_ack(answer)
    assert len(payload) == 5
    assert HotpointStart.parse_ack(payload) == answer
    assert HotpointStart.ack_raw(answer) == {"code": 0xC2, "max_radius": 250.0}
    assert HotpointStart.ack_fields(answer)["largest_radius_m"] == 250.0


def test_the_circle_that_is_flown_can_be_downloaded() -> None:
    answer = HotpointDownloadAnswer(MissionCode.SUCCESS, HOTPOINT)
    payload = HotpointDownload.encode_ack(answer)
    assert len(payload) == 52
    assert HotpointDownload.parse_ack(payload) == answer
    assert HotpointDownload.ack_fields(answer)["radius_m"] == 30.0


def test_the_direction_is_shown_in_words() -> None:
    assert HOTPOINT.fields()["clockwise"] == "clockwise"
    assert HotpointSetRate(0, 5.0).fields() == {
        "clockwise": "counter_clockwise",
        "angular_rate_deg_s": 5.0,
    }


# -- following on the wire -------------------------------------------------------------------------


def test_the_target_of_the_start_is_that_of_the_updates() -> None:
    start = FollowStart(0.9, 0.1, altitude=30).value(FIRMWARE)
    target = FollowTarget(0.9, 0.1, altitude=30).value(FIRMWARE)
    assert (len(start), len(target)) == (23, 20)
    assert start[2:22] == target


def test_one_turns_the_nose_to_the_target() -> None:
    """DJI's header has it the other way round; its documents and the phone's library agree."""
    assert FollowStart(0.9, 0.1).yaw_mode == 1
    assert FollowStart(0.9, 0.1, yaw_mode=1).fields()["yaw_mode"] == "to_target"
    assert FollowStart(0.9, 0.1, yaw_mode=0).fields()["yaw_mode"] == "by_rc"


@pytest.mark.parametrize(
    ("command", "field"),
    [
        (FollowTarget(0.9, 0.1, altitude=-1), "altitude"),
        (FollowTarget(0.9, 0.1, altitude=65536), "altitude"),
        (FollowTarget(0.9, 0.1, angle=1), "angle"),
        (FollowTarget(1.6, 0.1), "latitude"),
        (FollowStart(0.9, 0.1, mode=1), "mode"),
    ],
)
def test_what_a_target_is_not_is_refused(command: FollowTarget | FollowStart, field: str) -> None:
    with pytest.raises(BadValue) as caught:
        command.encode(FIRMWARE)
    assert caught.value.field == field
