"""Every order at every stage: the code that the aircraft answers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from m100link.protocol.codes import MissionCode as Code
from m100link.protocol.commands.hotpoint import (
    FollowPauseResume,
    FollowStart,
    FollowStop,
    HotpointDownload,
    HotpointPauseResume,
    HotpointStop,
)
from m100link.protocol.commands.waypoint import (
    WaypointDownloadMission,
    WaypointDownloadPoint,
    WaypointGetIdleSpeed,
    WaypointMission,
    WaypointPauseResume,
    WaypointSetIdleSpeed,
    WaypointStartStop,
)
from m100link.sim.vehicle.missions.plan import (
    CIRCLE_REFUSALS,
    WAYPOINT_REFUSALS,
    MissionOrder,
    MissionPhase,
)
from tests.sim.host import Host
from tests.sim.vehicle.missions.flights import OK, SQUARE, host, hotpoint, point, upload

POINTS = [point(index, *place) for index, place in enumerate(SQUARE)]
HERE = hotpoint()


def flying() -> Host:
    program = host()
    program.take_off()
    program.motion.place(0.0, 0.0, 15.0)
    return program


def at_stage(stage: MissionPhase) -> Host:
    program = flying()
    if stage is not MissionPhase.EMPTY:
        program.ask(WaypointMission(len(POINTS), 10.0, 5.0))
    if stage is MissionPhase.PLANNED:
        program.ask(POINTS[0])
    elif stage is not MissionPhase.EMPTY:
        upload(program, POINTS)
    if stage in (MissionPhase.FLYING, MissionPhase.PAUSED):
        assert program.ask(WaypointStartStop(0)) == OK
    if stage is MissionPhase.PAUSED:
        assert program.ask(WaypointPauseResume(0)) == OK
    if stage is MissionPhase.OTHER:
        assert program.ask(HERE).code == OK
    program.wait(0.05)
    return program


E, P, R, F, S = (
    MissionPhase.EMPTY,
    MissionPhase.PLANNED,
    MissionPhase.READY,
    MissionPhase.FLYING,
    MissionPhase.PAUSED,
)
ON_GROUND = (E, P, R)
ORDERS: dict[MissionOrder, Any] = {
    MissionOrder.UPLOAD: WaypointMission(4, 10.0, 5.0),
    MissionOrder.ADD: POINTS[1],
    MissionOrder.START: WaypointStartStop(0),
    MissionOrder.STOP: WaypointStartStop(1),
    MissionOrder.PAUSE: WaypointPauseResume(0),
    MissionOrder.RESUME: WaypointPauseResume(1),
    MissionOrder.DOWNLOAD: WaypointDownloadMission(),
    MissionOrder.DOWNLOAD_POINT: WaypointDownloadPoint(0),
    MissionOrder.SPEED: WaypointSetIdleSpeed(4.0),
}
# From DJI's list of codes, not from our table.
# One row per order: EMPTY, PLANNED, READY, FLYING, PAUSED.
WAYPOINTS: dict[MissionOrder, tuple[Code, Code, Code, Code, Code]] = {
    MissionOrder.UPLOAD: (OK, OK, OK, Code.RUNNING, Code.RUNNING),
    MissionOrder.ADD: (Code.NO_MISSION, OK, OK, Code.RUNNING, Code.RUNNING),
    MissionOrder.START: (Code.NO_POINTS, Code.NO_POINTS, OK, Code.ALREADY_SO, Code.ALREADY_SO),
    MissionOrder.STOP: (Code.NOT_STARTED, Code.NOT_STARTED, Code.NOT_STARTED, OK, OK),
    MissionOrder.PAUSE: (Code.NOT_STARTED, Code.NOT_STARTED, Code.NOT_STARTED, OK, Code.ALREADY_SO),
    MissionOrder.RESUME: (
        Code.NOT_STARTED,
        Code.NOT_STARTED,
        Code.NOT_STARTED,
        Code.ALREADY_SO,
        OK,
    ),
    MissionOrder.DOWNLOAD: (Code.NO_MISSION, OK, OK, OK, OK),
    MissionOrder.DOWNLOAD_POINT: (Code.NO_POINTS, OK, OK, OK, OK),
    MissionOrder.SPEED: (Code.NO_MISSION, OK, OK, OK, OK),
}
AFTERWARDS: dict[tuple[MissionOrder, MissionPhase], MissionPhase] = {
    (MissionOrder.UPLOAD, E): P,
    (MissionOrder.UPLOAD, R): P,
    (MissionOrder.START, R): F,
    (MissionOrder.STOP, F): E,
    (MissionOrder.STOP, S): E,
    (MissionOrder.PAUSE, F): S,
    (MissionOrder.RESUME, S): F,
}


def code_of(answer: Any) -> Code:
    return answer if isinstance(answer, Code) else answer.code


@pytest.mark.parametrize("order", MissionOrder)
@pytest.mark.parametrize("number", range(5))
def test_waypoints(order: MissionOrder, number: int) -> None:
    stage = (E, P, R, F, S)[number]
    program = at_stage(stage)
    assert program.vehicle.missions.stage is stage
    expected = WAYPOINTS[order][number]
    assert code_of(program.ask(ORDERS[order])) == expected
    assert WAYPOINT_REFUSALS.get((order, stage), OK) == expected
    assert program.vehicle.missions.stage is AFTERWARDS.get((order, stage), stage)


def test_asking_for_the_speed_is_refused_where_setting_it_is() -> None:
    for stage in (E, P, R, F, S):
        asked = at_stage(stage).ask(WaypointGetIdleSpeed()).code
        assert asked == WAYPOINTS[MissionOrder.SPEED][(E, P, R, F, S).index(stage)]


CIRCLES: dict[MissionOrder, tuple[Code, Code, Code, Code]] = {  # EMPTY, OTHER, FLYING, PAUSED
    MissionOrder.START: (OK, Code.OTHER_RUNNING, Code.RUNNING, Code.RUNNING),
    MissionOrder.STOP: (Code.NOT_RUNNING, Code.NOT_RUNNING, OK, OK),
    MissionOrder.PAUSE: (Code.NOT_RUNNING, Code.NOT_RUNNING, OK, Code.ALREADY_PAUSED),
    MissionOrder.RESUME: (Code.NOT_RUNNING, Code.NOT_RUNNING, Code.NOT_PAUSED, OK),
    MissionOrder.DOWNLOAD: (Code.NOT_RUNNING, Code.NOT_RUNNING, OK, OK),
}
HOTPOINT: dict[MissionOrder, Any] = {
    MissionOrder.START: HERE,
    MissionOrder.STOP: HotpointStop(),
    MissionOrder.PAUSE: HotpointPauseResume(0),
    MissionOrder.RESUME: HotpointPauseResume(1),
    MissionOrder.DOWNLOAD: HotpointDownload(),
}
FOLLOW: dict[MissionOrder, Any] = {
    MissionOrder.START: FollowStart(HERE.latitude, HERE.longitude),
    MissionOrder.STOP: FollowStop(),
    MissionOrder.PAUSE: FollowPauseResume(0),
    MissionOrder.RESUME: FollowPauseResume(1),
}


def _waypoints(program: Host) -> None:
    upload(program, POINTS)
    assert program.ask(WaypointStartStop(0)) == OK


@pytest.mark.parametrize("orders", [HOTPOINT, FOLLOW], ids=["hotpoint", "follow"])
@pytest.mark.parametrize("number", range(4))
def test_hotpoint_and_follow(orders: dict[MissionOrder, Any], number: int) -> None:
    stage = (E, MissionPhase.OTHER, F, S)[number]
    for order, command in orders.items():
        program = flying()
        if stage in (F, S):
            assert code_of(program.ask(orders[MissionOrder.START])) == OK
        if stage is S:
            assert program.ask(orders[MissionOrder.PAUSE]) == OK
        if stage is MissionPhase.OTHER:
            _waypoints(program)
        expected = CIRCLES[order][number]
        assert code_of(program.ask(command)) == expected, order
        assert CIRCLE_REFUSALS.get((order, stage), OK) == expected, order


@pytest.mark.parametrize(
    "begin_other",
    [lambda program: program.ask(HERE), lambda program: program.ask(FOLLOW[MissionOrder.START])],
    ids=["hotpoint", "follow"],
)
def test_waypoints_wait_for_a_mission_of_another_kind(
    begin_other: Callable[[Host], Any],
) -> None:
    program = flying()
    assert code_of(begin_other(program)) == OK
    assert upload(program, POINTS) == (OK, [OK] * 4)
    assert program.ask(WaypointStartStop(0)) == Code.OTHER_RUNNING
    assert program.ask(WaypointStartStop(1)) == Code.NOT_STARTED
