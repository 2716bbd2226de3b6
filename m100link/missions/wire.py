"""Plans as the commands that upload them, and back.

Every value is given as it is after the bytes: single precision is rounded here already, so that the
commands of a plan equal those of its download.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from m100link.errors import BadPlan
from m100link.missions.waypoint import (
    ACTIONS,
    AtEnd,
    GimbalPitch,
    Heading,
    OnRCLoss,
    PlanValues,
    Stay,
    Trace,
    TurnTo,
    Waypoint,
    WaypointAction,
    single,
)
from m100link.protocol.commands.waypoint import WaypointMission, WaypointPoint

_SLOTS = 16  # places for actions in a point; 15 of them are used (errata 55)
_NO_TIME_LIMIT = 0xFFFF  # what DJI's programs send for none
_ROS_DEMO_YAW_MODE = 4  # DJI's ROS demo sends it; taken as 0

_ACTIONS = tuple(ACTIONS.values())  # by their numbers on the wire


def _action_to_wire(action: WaypointAction) -> tuple[int, int]:
    number = _ACTIONS.index(type(action))
    match action:
        case Stay(seconds):
            return number, round(seconds * 1000)
        case TurnTo(degrees) | GimbalPitch(degrees):
            return number, int(degrees)
        case _:
            return number, 0


def _action_from_wire(number: int, parameter: int) -> Any:
    """An action, or a value that is none for the checks of the plan to name."""
    if number >= len(_ACTIONS):
        return f"action {number}"
    kind = _ACTIONS[number]
    if kind is Stay:
        return Stay(parameter / 1000)
    return kind(parameter) if kind.__match_args__ else kind()


def to_wire(plan: PlanValues) -> tuple[WaypointMission, tuple[WaypointPoint, ...]]:
    """See :meth:`m100link.WaypointPlan.to_wire`."""
    mission = WaypointMission(
        count=len(plan.waypoints),
        max_speed=single(plan.max_speed),
        idle_speed=single(plan.speed),
        finish_action=int(plan.at_end),
        repeat=int(plan.repeat),
        yaw_mode=int(plan.heading),
        trace_mode=int(plan.trace),
        rc_lost_action=int(plan.on_rc_loss),
        gimbal_pitch_mode=int(plan.gimbal_by_waypoint),
        focus_latitude=0.0,
        focus_longitude=0.0,
        focus_altitude=0.0,
    )
    return mission, tuple(_point(index, point) for index, point in enumerate(plan.waypoints))


def _point(index: int, waypoint: Waypoint) -> WaypointPoint:
    coded = [_action_to_wire(action) for action in waypoint.actions]
    coded += [(0, 0)] * (_SLOTS - len(coded))
    limit = waypoint.action_time_limit
    return WaypointPoint(
        index=index,
        latitude=math.radians(waypoint.latitude_deg),
        longitude=math.radians(waypoint.longitude_deg),
        altitude=single(waypoint.height),
        damping=single(waypoint.damping),
        yaw=int(waypoint.heading_deg),
        gimbal_pitch=int(waypoint.gimbal_pitch_deg),
        turn_mode=int(not waypoint.turn_clockwise),
        has_action=int(bool(waypoint.actions)),
        action_time_limit=_NO_TIME_LIMIT if limit is None else int(limit),
        action_count=len(waypoint.actions),
        action_repeat=int(waypoint.action_repeat),
        actions=tuple(code for code, _ in coded),
        parameters=tuple(parameter for _, parameter in coded),
    )


def from_wire(mission: WaypointMission, points: Iterable[WaypointPoint]) -> dict[str, Any]:
    """Arguments of a plan; see :meth:`m100link.WaypointPlan.from_wire`."""
    by_index = {point.index: point for point in points}
    missing = [index for index in range(mission.count) if index not in by_index]
    extra = sorted(by_index.keys() - range(mission.count))
    if missing or extra:
        index = (missing or extra)[0]
        raise BadPlan(
            f"waypoint {index} is {'missing' if missing else 'one too many'} in a mission of "
            f"{mission.count}",
            point=index,
            field="waypoints",
            value=len(by_index),
            limit=mission.count,
            remedy="every index from 0 to count - 1",
        )
    is_ros_demo = mission.yaw_mode == _ROS_DEMO_YAW_MODE
    return {
        "waypoints": [_waypoint(by_index[index]) for index in range(mission.count)],
        "speed": mission.idle_speed,
        "max_speed": mission.max_speed,
        "heading": Heading.ALONG_PATH if is_ros_demo else _known(Heading, mission.yaw_mode),
        "trace": _known(Trace, mission.trace_mode),
        "at_end": _known(AtEnd, mission.finish_action),
        "on_rc_loss": _known(OnRCLoss, mission.rc_lost_action),
        "gimbal_by_waypoint": _flag(mission.gimbal_pitch_mode),
        "repeat": mission.repeat,
    }


def _known(kind: Any, value: int) -> Any:
    # The number of no member is kept: the checks of the plan name it, with its limits.
    return kind(value) if value in kind.__members__.values() else value


def _flag(value: int) -> Any:
    return bool(value) if value in (0, 1) else value


def _waypoint(point: WaypointPoint) -> Waypoint:
    # The aircraft ignores actions behind has_action 0: they are no part of the plan.
    count = point.action_count if point.has_action else 0
    coded = zip(point.actions[:count], point.parameters[:count], strict=True)
    limit = point.action_time_limit
    direction = _flag(point.turn_mode)
    actions = [_action_from_wire(number, parameter) for number, parameter in coded]
    return Waypoint(
        math.degrees(point.latitude),
        math.degrees(point.longitude),
        point.altitude,
        heading_deg=point.yaw,
        damping=point.damping,
        gimbal_pitch_deg=point.gimbal_pitch,
        turn_clockwise=not direction if isinstance(direction, bool) else direction,
        actions=actions,
        action_repeat=point.action_repeat,
        action_time_limit=None if limit == _NO_TIME_LIMIT else limit,
    )
