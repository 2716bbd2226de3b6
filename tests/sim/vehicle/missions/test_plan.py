from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest

from m100link.protocol.codes import MissionCode
from m100link.protocol.commands.waypoint import WaypointMission
from m100link.sim.vehicle.missions.plan import StoredPlan, mission_code, point_code
from m100link.sim.vehicle.missions.route import LocalPlace, MissionSettings, NoFlyZone, Site
from tests.sim.vehicle.missions.flights import doing, point

MISSION = WaypointMission(2, 10.0, 5.0)
POINT = point(0, 0.0, 0.0, 10.0)


@pytest.mark.parametrize(
    ("field", "good", "bad"),
    [
        ("count", [2, 99], [0, 1, 100, 255]),
        ("max_speed", [5.0, 15.0], [1.9, 15.1, math.nan, math.inf]),
        ("idle_speed", [-10.0, 0.0, 10.0], [10.5, -10.5, math.nan]),
        ("finish_action", [0, 4], [5, 255]),
        ("repeat", [1, 2, 255], [0]),
        ("yaw_mode", [0, 3, 4], [5]),
        ("trace_mode", [0, 1], [2]),
        ("rc_lost_action", [0, 1], [2]),
        ("gimbal_pitch_mode", [0, 1], [2]),
        ("focus_latitude", [0.0, 99.0, math.nan], []),
    ],
)
def test_a_mission_is_judged_field_by_field(field: str, good: list[Any], bad: list[Any]) -> None:
    for value in good:
        assert mission_code(dataclasses.replace(MISSION, **{field: value})) == 0
    for value in bad:
        code = mission_code(dataclasses.replace(MISSION, **{field: value}))
        assert code == MissionCode.BAD_MISSION, value


@pytest.mark.parametrize(
    ("field", "good", "bad"),
    [
        ("latitude", [-1.5, 1.5], [1.58, -1.58, math.nan, math.inf]),
        ("longitude", [-3.14, 3.14], [3.15, -3.15, math.nan]),
        ("altitude", [-200.0, 0.0, 500.0], [-200.1, 500.1, math.nan]),
        ("damping", [0.0, 0.2, 1000.0], [0.1, -1.0, 1000.1, math.nan]),
        ("yaw", [-180, 180], [181, -181]),
        ("gimbal_pitch", [-90, 30], [31, -91]),
        ("turn_mode", [0, 1], [2]),
    ],
)
def test_a_point_is_judged_field_by_field(field: str, good: list[Any], bad: list[Any]) -> None:
    for value in good:
        assert point_code(dataclasses.replace(POINT, **{field: value})) == 0
    for value in bad:
        code = point_code(dataclasses.replace(POINT, **{field: value}))
        assert code == MissionCode.BAD_POINT, value


@pytest.mark.parametrize(
    ("action", "good", "bad"),
    [
        (0, [0, 32767], [-1]),
        (1, [-5, 5], []),
        (2, [0], []),
        (3, [0], []),
        (4, [-180, 180], [181, -181]),
        (5, [-90, 0], [-91, 31]),
        (6, [], [0]),
        (255, [], [0]),
    ],
)
def test_actions_and_their_parameters(action: int, good: list[int], bad: list[int]) -> None:
    for parameter in good:
        assert point_code(point(0, 0, 0, 10, **doing((0, 100), (action, parameter)))) == 0
    for parameter in bad:
        fields = doing((0, 100), (action, parameter))
        assert point_code(point(0, 0, 0, 10, **fields)) == MissionCode.BAD_ACTION
        # Where the point has no action, nobody looks at the list.
        assert point_code(point(0, 0, 0, 10, **(fields | {"has_action": 0}))) == 0
        # Nor at what stands behind the count.
        assert point_code(point(0, 0, 0, 10, **(fields | {"action_count": 1}))) == 0


@pytest.mark.parametrize(("limit", "is_good"), [(0, 1), (999, 1), (65535, 1), (1000, 0)])
def test_the_time_limit_of_actions(limit: int, is_good: int) -> None:
    code = point_code(point(0, 0, 0, 10, **doing((1, 0), limit=limit)))
    assert (code == 0) is bool(is_good)


def test_has_action_is_0_or_1() -> None:
    assert point_code(dataclasses.replace(POINT, has_action=2)) == MissionCode.BAD_ACTION


def check(
    *places: tuple[float, float, float],
    damping: float = 0.0,
    trace: int = 0,
    home: LocalPlace | None = None,
    **settings: Any,
) -> MissionCode:
    missions = MissionSettings(**settings)
    mission = WaypointMission(len(places), 10.0, 5.0, trace_mode=trace)
    points = tuple(point(i, *place, damping=damping) for i, place in enumerate(places))
    plan = StoredPlan(mission, points, tuple(LocalPlace(*place) for place in places))
    return plan.check(missions, home, Site(22.5431, 113.9589, 120.0, missions))


FAR = [(1900.0 * index, 0.0, 10.0) for index in range(17)]  # 30.4 km


@pytest.mark.parametrize(
    ("code", "found"),
    [
        (MissionCode.SUCCESS, partial(check, (0, 0, 10), (30, 0, 10))),
        (MissionCode.SUCCESS, partial(check, (0, 0, 10), (0, 0, 12))),
        (MissionCode.POINTS_TOO_CLOSE, partial(check, (0, 0, 10), (1, 1, 11))),
        (MissionCode.SUCCESS, partial(check, (0, 0, 10), (1, 0, 10), closest_points=0.5)),
        (MissionCode.SUCCESS, partial(check, (0, 0, 10), (2000, 0, 10))),
        (MissionCode.POINTS_TOO_FAR, partial(check, (0, 0, 10), (2000, 0, 60))),
        (
            MissionCode.BAD_DAMPING,
            partial(check, *[(9 * i, 0, 9) for i in range(4)], damping=5, trace=1),
        ),
        (
            MissionCode.SUCCESS,
            partial(check, *[(9 * i, 0, 9) for i in range(4)], damping=5, trace=0),
        ),
        (
            MissionCode.SUCCESS,
            partial(check, *[(10 * i, 0, 9) for i in range(4)], damping=5, trace=1),
        ),
        (MissionCode.SUCCESS, partial(check, (0, 0, 9), (9, 0, 9), damping=9, trace=1)),
        (MissionCode.LEG_TOO_LONG, partial(check, *FAR)),
        (MissionCode.SUCCESS, partial(check, *FAR[:16])),
        (MissionCode.LEG_TOO_LONG, partial(check, *FAR[:9], longest_route=15_000.0)),
        # 40 km with the paths from and to home (DJI's support): 19 km out, and 20.9 km.
        (MissionCode.SUCCESS, partial(check, *FAR[:11], home=LocalPlace(0, 0, 0))),
        (MissionCode.ROUTE_TOO_LONG, partial(check, *FAR[:12], home=LocalPlace(0, 0, 0))),
        (
            MissionCode.CROSSES_NO_FLY_ZONE,
            partial(
                check, (0, 0, 10), (100, 0, 10), no_fly_zones=(NoFlyZone(22.5435, 113.9589, 10.0),)
            ),
        ),
        (
            MissionCode.SUCCESS,
            partial(
                check, (0, 0, 10), (100, 0, 10), no_fly_zones=(NoFlyZone(22.5455, 113.9589, 10.0),)
            ),
        ),
    ],
)
def test_the_whole_is_checked(code: MissionCode, found: Callable[[], MissionCode]) -> None:
    assert found() == code


def test_the_estimate_counts_speed_stops_and_actions() -> None:
    def seconds(points: list[Any], **fields: Any) -> float:
        mission = WaypointMission(len(points), 10.0, **({"idle_speed": 5.0} | fields))
        places = tuple(LocalPlace(100.0 * index, 0.0, 10.0) for index in range(len(points)))
        return StoredPlan(mission, tuple(points), places).estimate()

    plain = [point(index, 100.0 * index, 0, 10) for index in range(3)]
    busy = [point(index, 0, 0, 10, **doing((0, 10_000), repeat=2)) for index in range(3)]
    hasty = [point(index, 0, 0, 10, **doing((0, 10_000), limit=5)) for index in range(3)]
    assert seconds(plain) == pytest.approx(200 / 5 + 3 * 4)
    assert seconds(plain, idle_speed=10.0) == pytest.approx(200 / 10 + 3 * 4)
    assert seconds(plain, idle_speed=0.0) == seconds(plain, idle_speed=10.0)
    assert seconds(busy) == pytest.approx(seconds(plain) + 60.0)
    assert seconds(hasty) == pytest.approx(seconds(plain) + 15.0)
    assert seconds(busy, trace_mode=1) == pytest.approx(200 / 5 + 2 * 4)
