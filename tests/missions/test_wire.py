"""Plans as the commands that upload them, and back."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest
from hypothesis import given

from m100link import (
    PROFILES,
    AtEnd,
    BadPlan,
    GimbalPitch,
    Heading,
    OnRCLoss,
    StartVideo,
    Stay,
    StopVideo,
    TakePhoto,
    Trace,
    TurnTo,
    Waypoint,
    WaypointPlan,
)
from m100link.protocol.commands.waypoint import WaypointMission, WaypointPoint
from tests.missions.plans import plans

PLAN = WaypointPlan(
    [
        Waypoint(52.1, 4.31, height=20),
        Waypoint(
            52.1003,
            4.31,
            height=25.3,
            heading_deg=-90,
            damping=0.7,
            gimbal_pitch_deg=-45,
            turn_clockwise=False,
            actions=[Stay(2), TakePhoto(), StartVideo(), StopVideo(), TurnTo(7), GimbalPitch(-60)],
            action_repeat=3,
            action_time_limit=None,
        ),
    ],
    speed=5.1,
    max_speed=12.5,
    heading=Heading.BY_WAYPOINT,
    at_end=AtEnd.GO_HOME,
    on_rc_loss=OnRCLoss.CONTINUE,
    gimbal_by_waypoint=True,
    repeat=2,
)


def test_every_value_has_its_field() -> None:
    mission, (_, point) = PLAN.to_wire()
    assert mission.raw() == {
        "count": 2,
        "max_speed": 12.5,
        "idle_speed": 5.099999904632568,
        "finish_action": 1,
        "repeat": 2,
        "yaw_mode": 3,
        "trace_mode": 0,
        "rc_lost_action": 1,
        "gimbal_pitch_mode": 1,
        "focus_latitude": 0.0,
        "focus_longitude": 0.0,
        "focus_altitude": 0.0,
    }
    assert point.raw() == {
        "index": 1,
        "latitude": 0.9093217762768017,
        "longitude": 0.0752236907609556,
        "altitude": 25.299999237060547,
        "damping": 0.699999988079071,
        "yaw": -90,
        "gimbal_pitch": -45,
        "turn_mode": 1,
        "has_action": 1,
        "action_time_limit": 65535,
        "action_count": 6,
        "action_repeat": 3,
        "actions": [0, 1, 2, 3, 4, 5] + 10 * [0],
        "parameters": [2000, 0, 0, 0, 7, -60] + 10 * [0],
    }


@given(plans())
def test_a_download_equals_the_upload(plan: WaypointPlan) -> None:
    """Through the bytes, its points in any order: every value, to the last bit."""
    mission, points = plan.to_wire()
    profile = PROFILES["3.1"]
    downloaded = WaypointMission.parse(mission.value(profile), profile)
    carried = [WaypointPoint.parse(point.value(profile), profile) for point in points]
    assert (downloaded, tuple(carried)) == (mission, points)
    random.Random(1).shuffle(carried)
    # A take-off is nothing that the aircraft stores.
    assert WaypointPlan.from_wire(downloaded, carried) == replace(plan, take_off=False)


def test_a_point_that_is_missing_or_too_many_is_named() -> None:
    mission, points = PLAN.to_wire()
    with pytest.raises(BadPlan, match="waypoint 1 is missing in a mission of 2") as caught:
        WaypointPlan.from_wire(mission, points[:1])
    assert caught.value.point == 1
    with pytest.raises(BadPlan, match="waypoint 1 is one too many in a mission of 1"):
        WaypointPlan.from_wire(replace(mission, count=1), points)


def test_what_an_aircraft_ignores_is_left_out() -> None:
    mission, (first, second) = PLAN.to_wire()
    downloaded = WaypointPlan.from_wire(
        replace(mission, yaw_mode=4, focus_latitude=1.0),
        [replace(first, action_count=15), replace(second, has_action=0)],
    )
    assert downloaded.heading is Heading.ALONG_PATH
    assert [point.actions for point in downloaded.waypoints] == [(), ()]


@pytest.mark.parametrize(
    ("field", "value", "name"),
    [
        ("finish_action", 9, "at_end"),
        ("yaw_mode", 5, "heading"),
        ("trace_mode", 2, "trace"),
        ("rc_lost_action", 2, "on_rc_loss"),
        ("gimbal_pitch_mode", 2, "gimbal_by_waypoint"),
        ("repeat", 0, "repeat"),
        ("idle_speed", float("nan"), "speed"),
    ],
)
def test_what_no_aircraft_flies_is_no_plan(field: str, value: float, name: str) -> None:
    mission, points = PLAN.to_wire()
    with pytest.raises(BadPlan) as caught:
        WaypointPlan.from_wire(replace(mission, **{field: value}), points)  # type: ignore[arg-type]
    assert caught.value.field == name


def test_an_action_that_does_not_exist_is_named_by_its_number() -> None:
    mission, (first, second) = PLAN.to_wire()
    second = replace(second, actions=(9,) * 16, turn_mode=28)
    with pytest.raises(BadPlan) as caught:
        WaypointPlan.from_wire(mission, [first, second])
    assert caught.value.field == "turn_clockwise"
    assert caught.value.others[0].seen == "waypoint 1: actions[0] is 'action 9'"


def test_curves_have_no_actions() -> None:
    assert (
        WaypointPlan(
            [Waypoint(1, 1, 1), Waypoint(1.001, 1, 1, damping=5)], trace=Trace.COORDINATED_TURNS
        )
        .to_wire()[1][1]
        .has_action
        == 0
    )
