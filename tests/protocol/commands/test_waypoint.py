"""Waypoint missions on the wire: what belongs together is checked together."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from m100link.errors import BadValue
from m100link.protocol import PROFILES, MissionCode
from m100link.protocol.commands.waypoint import (
    WaypointDownloadedPoint,
    WaypointDownloadMission,
    WaypointDownloadPoint,
    WaypointMission,
    WaypointMissionAnswer,
    WaypointPoint,
    WaypointSetIdleSpeed,
)

FIRMWARE = PROFILES["3.1"]
MISSION = WaypointMission(count=3, max_speed=10.0, idle_speed=5.0)
POINT = WaypointPoint(index=0, latitude=0.9, longitude=0.1, altitude=20.0)


def with_actions(*pairs: tuple[int, int], **others: Any) -> WaypointPoint:
    rest = (0,) * (16 - len(pairs))
    return replace(
        POINT,
        **{"has_action": 1, "action_count": len(pairs)} | others,
        actions=(*(action for action, _ in pairs), *rest),
        parameters=(*(parameter for _, parameter in pairs), *rest),
    )


def test_a_mission_does_not_fly_on_without_its_remote_control_unless_ordered() -> None:
    assert MISSION.rc_lost_action == 0


@pytest.mark.parametrize("speed", [10.5, -10.5])
def test_the_cruise_is_not_beyond_the_largest_speed(speed: float) -> None:
    with pytest.raises(BadValue, match=r"idle_speed .* cannot be sent") as caught:
        replace(MISSION, idle_speed=speed).encode(FIRMWARE)
    assert (caught.value.field, caught.value.value) == ("idle_speed", speed)
    assert "10 m/s" in caught.value.limit
    assert replace(MISSION, idle_speed=-10.0).encode(FIRMWARE)


@pytest.mark.parametrize(
    ("slot", "pairs"),
    [
        (0, [(0, -1)]),
        (1, [(1, 0), (4, 181)]),
        (2, [(2, 5), (3, -7), (5, 1)]),
    ],
)
def test_a_parameter_fits_its_action(slot: int, pairs: list[tuple[int, int]]) -> None:
    point = with_actions(*pairs)
    with pytest.raises(BadValue) as caught:
        point.encode(FIRMWARE)
    assert caught.value.field == f"parameters[{slot}]"
    with_actions(*pairs, has_action=0).encode(FIRMWARE)
    with_actions(*pairs, action_count=slot).encode(FIRMWARE)


def test_the_actions_that_count_are_shown_with_their_parameter() -> None:
    point = with_actions((0, 1500), (1, 0), (4, -90), (5, -60), (0, 9), action_count=4)
    assert point.fields()["actions"] == [
        {"action": "stay", "time_s": 1.5},
        {"action": "take_photo"},
        {"action": "turn_to", "angle_deg": -90},
        {"action": "gimbal_pitch", "angle_deg": -60},
    ]
    assert replace(point, has_action=0).fields()["actions"] == []
    assert replace(point, actions=(9,) * 16).fields()["actions"][0] == {"action": 9}


def test_what_is_downloaded_is_what_was_uploaded() -> None:
    mission = WaypointMissionAnswer(MissionCode.SUCCESS, MISSION)
    payload = WaypointDownloadMission.encode_ack(mission)
    assert len(payload) == 52
    assert payload[1:] == MISSION.value(FIRMWARE)
    assert WaypointDownloadMission.parse_ack(payload) == mission
    point = WaypointDownloadedPoint(MissionCode.SUCCESS, with_actions((0, 1000), (1, 0)))
    payload = WaypointDownloadPoint.encode_ack(point)
    assert len(payload) == 91
    assert WaypointDownloadPoint.parse_ack(payload).point.actions[:2] == (0, 1)
    assert WaypointDownloadPoint.ack_fields(point)["actions"][1] == {"action": "take_photo"}


def test_without_a_mission_zeros_are_downloaded() -> None:
    payload = WaypointDownloadMission.encode_ack(MissionCode.NO_MISSION)
    assert payload == b"\xea" + bytes(51)
    answer = WaypointDownloadMission.parse_ack(payload)
    assert (answer.code, answer.mission.count) == (MissionCode.NO_MISSION, 0)


@pytest.mark.parametrize("size", [86, 88, 89, 91])
def test_a_point_of_another_size_is_not_read(size: int) -> None:
    with pytest.raises(ValueError, match=f"waypoint_point takes 90 .* there are {size}"):
        WaypointPoint.parse(bytes(size), FIRMWARE)


def test_a_cruise_backwards_can_be_sent() -> None:
    assert WaypointSetIdleSpeed(-15.0).encode(FIRMWARE)
    with pytest.raises(BadValue):
        WaypointSetIdleSpeed(-15.1).encode(FIRMWARE)
