"""Missions that the aircraft flies by itself (firmware 3.1): a plan, its start, and the mission.

The plan is checked as a whole when it is uploaded, and lies with the agent until it is started:
nothing is in the aircraft that nobody watches.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from enum import IntEnum
from typing import Any, TypeVar

from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient
from m100link.apps.ros2.control import RosControl
from m100link.apps.ros2.endpoints import Call, Input, answering, trigger
from m100link.errors import M100Error, UsageError
from m100link.missions import waypoint
from m100link.missions.plan import WaypointPlan
from m100link.protocol.commands.gimbal import GimbalAngle, GimbalAngleMode, GimbalSpeed

E = TypeVar("E", bound=IntEnum)

_SPEED, _MAX_SPEED = 5.0, 10.0

ACTIONS: Mapping[str, Callable[[float], waypoint.WaypointAction]] = {
    "STAY": waypoint.Stay,
    "TAKE_PHOTO": lambda _: waypoint.TakePhoto(),
    "START_VIDEO": lambda _: waypoint.StartVideo(),
    "STOP_VIDEO": lambda _: waypoint.StopVideo(),
    "TURN_TO": waypoint.TurnTo,
    "GIMBAL_PITCH": waypoint.GimbalPitch,
}
"""The actions at a point, in the order of the numbers of m100_msgs/msg/MissionAction."""


def mission_services(control: RosControl) -> dict[str, Call]:
    async def upload(request: Mapping[str, Any]) -> None:
        control.session.held()
        await control.do(orders.UploadPlan.of(plan_of(request)))

    async def start(request: Mapping[str, Any]) -> None:
        control.session.held()
        control.require_free("a mission")
        await control.do(orders.StartMission(control.session.uploaded, request["take_off"]))

    def order(order: orders.Order, done: str) -> Call:
        return trigger(lambda: control.do(order), done)

    return {
        "~/mission/upload": answering(upload, "it waits for its start"),
        "~/mission/start": answering(start, "it flies"),
        "~/mission/pause": order(orders.PauseMission(), "it hovers"),
        "~/mission/resume": order(orders.ResumeMission(), "it flies on"),
        "~/mission/stop": order(orders.StopMission(), "it is over: the aircraft hovers"),
    }


def plan_of(request: Mapping[str, Any]) -> WaypointPlan:
    """The plan of m100_msgs/srv/UploadMission.

    Raises UsageError: a number that stands for nothing. Raises BadPlan: it cannot be flown: point,
    value, limit.
    """
    return WaypointPlan(
        [_point(one) for one in request["points"]],
        speed=request["speed"] or _SPEED,
        max_speed=request["max_speed"] or _MAX_SPEED,
        heading=_one_of(waypoint.Heading, "heading", request),
        trace=_one_of(waypoint.Trace, "trace", request),
        at_end=_one_of(waypoint.AtEnd, "at_end", request),
        on_rc_loss=_one_of(waypoint.OnRCLoss, "on_rc_loss", request),
        gimbal_by_waypoint=request["gimbal_by_point"],
        repeat=request["repeat"] or 1,
    )


def _point(given: Mapping[str, Any]) -> waypoint.Waypoint:
    return waypoint.Waypoint(
        given["latitude"],
        given["longitude"],
        height=given["height"],
        heading_deg=given["heading"],
        damping=given["damping"],
        gimbal_pitch_deg=given["gimbal_pitch"],
        turn_clockwise=not given["turn_counterclockwise"],
        actions=[_action(one) for one in given["actions"]],
    )


def _action(given: Mapping[str, Any]) -> waypoint.WaypointAction:
    number: int = given["kind"]
    makers = list(ACTIONS.values())
    if number >= len(makers):
        raise UsageError(
            f"an action {number}", remedy=f"0 to {len(makers) - 1}: {', '.join(ACTIONS)}"
        )
    return makers[number](given["value"])


def _one_of(kind: type[E], field: str, request: Mapping[str, Any]) -> E:
    try:
        return kind(request[field])
    except ValueError:
        there = ", ".join(f"{one.value} {one.name}" for one in kind)
        raise UsageError(f"{field} {request[field]}", remedy=f"choose one of {there}") from None


# -- the gimbal: where the camera points, and how fast it turns. Nobody confirms what is sent ------


_SECONDS = 1.0
_PAUSE_S = 0.05  # seconds between two rates that are sent: one turns it for half a second


class GimbalServices:
    """How fast ROS programs turn the gimbal."""

    def __init__(
        self,
        agent: AgentClient,
        control: RosControl,
        rates: Input,
        tell: Callable[[str, str], None],
    ) -> None:
        self._agent, self._control, self._rates, self._tell = agent, control, rates, tell
        self._due_at = agent.now
        self._is_busy = False

    def advance(self, *, is_deaf: bool) -> None:
        """Send the newest rates; to the deaf what comes now is old."""
        waiting, now = [message for _, message in self._rates.take()], self._agent.now
        if not waiting or is_deaf or self._is_busy or now < self._due_at:
            return
        self._due_at = now + _PAUSE_S
        self._is_busy = True
        self._agent.background.spawn(self._turn(waiting[-1]), "ROS gimbal")

    async def _turn(self, message: Mapping[str, Any]) -> None:
        try:
            await self._control.do(orders.TurnGimbal(rates_of(message["vector"])))
        except M100Error as error:
            self._tell(f"~/gimbal_speed: {error.seen}", "warning")
        finally:
            self._is_busy = False


def angles_of(request: Mapping[str, Any]) -> GimbalAngle:
    """The command of m100_msgs/srv/PointGimbal. Raises M100Error: no such angle."""
    mode = GimbalAngleMode(0) if request["is_relative"] else GimbalAngleMode.ABSOLUTE
    for axis in ("yaw", "roll", "pitch"):
        if request[f"keep_{axis}"]:
            mode |= GimbalAngleMode[f"KEEP_{axis.upper()}"]
    return GimbalAngle(
        yaw_deg=request["yaw"],
        roll_deg=request["roll"],
        pitch_deg=request["pitch"],
        mode=mode,
        duration_s=request["duration"] or _SECONDS,
    )


def rates_of(vector: Mapping[str, float]) -> GimbalSpeed:
    """The command of rad/s about the axes forward, left, up (REP 103)."""
    return GimbalSpeed(
        roll_deg_s=math.degrees(vector["x"]),
        pitch_deg_s=-math.degrees(vector["y"]),
        yaw_deg_s=-math.degrees(vector["z"]),
    )
