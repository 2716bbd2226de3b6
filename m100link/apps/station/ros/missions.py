"""Waypoint missions and hotpoints under the names of DJI's later ``dji_sdk`` node, and of 3.1's.

``mission_waypoint_upload`` gives the plan to the agent, which checks it as a whole and asks nothing
of the aircraft yet; ``mission_waypoint_action`` 0 uploads it there and starts it. So a plan that
cannot be flown is refused at once, and nothing lies in the aircraft that nobody watches. Both need
control. The mission stops when the client that started it loses control. A hotpoint waits here for
its start in the same way.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Mapping
from functools import partial

from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.messages import MissionReport
from m100link.apps.agent.orders import Order
from m100link.apps.station.ros.graph import Graph, ServiceCall
from m100link.apps.station.ros.leases import Clients
from m100link.apps.station.ros.messages import Message
from m100link.errors import UsageError
from m100link.protocol.commands.hotpoint import HotpointStart
from m100link.protocol.commands.waypoint import WaypointMission, WaypointPoint
from m100link.protocol.firmware import FIRMWARE_3_1

_STATUS_S = 0.25
_CIRCLE, _LATEST = "hotpoint", "latest upload"
_MOST_POINTS = 99
_MOST_ACTIONS = 15  # of the 16 places that the wire has
_LONGEST_LIMIT_S, _NO_LIMIT = 999, 65535  # of all actions at a point
_ROS_DEMO_YAW_MODE = 4  # DJI's demo sends it, and means 0

_KINDS = {"no mission": 0, "waypoint mission": 1, "hotpoint": 2, "follow mission": 3, "IOC": 4}
"""Numbers of the status push, by the kind that the agent tells."""


class MissionTopics:
    def __init__(self, agent: AgentClient, graph: Graph, clients: Clients) -> None:
        self._agent, self._graph, self._clients = agent, graph, clients
        self._task: Message | None = None  # what was uploaded last, as it came
        self._speed = 0.0
        self._status = graph.add_topic("/dji_sdk/mission_status", "dji_sdk/MissionPushInfo")
        self._event = graph.add_topic("/dji_sdk/mission_event", "dji_sdk/MissionPushInfo")
        for name, kind, handler in (
            ("mission_waypoint_upload", "MissionWpUpload", self._upload),
            ("mission_waypoint_action", "MissionWpAction", self._act),
            ("mission_waypoint_getInfo", "MissionWpGetInfo", self._info),
            ("mission_waypoint_getSpeed", "MissionWpGetSpeed", self._get_speed),
            ("mission_waypoint_setSpeed", "MissionWpSetSpeed", self._set_speed),
            ("mission_hotpoint_upload", "MissionHpUpload", self._upload_circle),
            ("mission_hotpoint_action", "MissionHpAction", self._act_circle),
            ("mission_hotpoint_getInfo", "MissionHpGetInfo", self._circle_info),
            ("mission_hotpoint_updateRadius", "MissionHpUpdateRadius", self._set_radius),
            ("mission_hotpoint_updateYawRate", "MissionHpUpdateYawRate", self._set_rate),
            ("mission_hotpoint_resetYaw", "MissionHpResetYaw", self._reset_heading),
            ("mission_status", "MissionStatus", self._count),
            ("mission_start", "MissionStart", self._start),
            ("mission_pause", "MissionPause", self._pause),
            ("mission_cancel", "MissionCancel", self._cancel),
            ("mission_waypoint_download", "MissionWpDownload", self._info),
            ("mission_waypoint_get_speed", "MissionWpGetSpeed", self._get_speed),
            ("mission_waypoint_set_speed", "MissionWpSetSpeed", self._set_speed),
            ("mission_hotpoint_download", "MissionHpDownload", self._circle_info),
            ("mission_hotpoint_set_speed", "MissionHpSetSpeed", self._set_rate),
            ("mission_hotpoint_set_radius", "MissionHpSetRadius", self._set_radius),
            ("mission_hotpoint_reset_yaw", "MissionHpResetYaw", self._reset_heading),
        ):
            clients.offer(name, kind, handler)
        agent.on_mission_report.append(self._on_report)
        agent.background.spawn(self._keep_telling(), "mission status")

    # -- what clients hear -----------------------------------------------------------------------

    async def _keep_telling(self) -> None:
        while True:
            await asyncio.sleep(_STATUS_S)
            state = self._agent.state
            kind = _KINDS.get(state.mission)
            if kind is None or not self._status.subscribers:
                continue  # nobody knows, or nobody wants to
            index, status = max(0, state.mission_index), max(0, state.mission_status)
            values = (index, status) if kind == 1 else (status, 0)
            self._graph.publish(self._status, _push(kind, bytes((*values, 0, 0, 0))), self._now)

    def _on_report(self, report: MissionReport) -> None:
        self._graph.publish(self._event, _push(report.event, report.data), self._now)

    @property
    def _now(self) -> float:
        return self._agent.now

    # -- what is asked ---------------------------------------------------------------------------

    async def _upload(self, call: ServiceCall) -> Message:
        task = call.request["waypoint_task"]
        mission, points = _commands(task)
        await self._clients.order(call, orders.UploadPlan.of_commands(mission, points))
        self._task, self._speed = task, mission.idle_speed
        self._graph.known(call.session)[_LATEST] = orders.StartMission
        return _done(WaypointMission.ADDRESS)

    async def _act(self, call: ServiceCall) -> Message:
        return await self._acted(call, partial(self._plan, call), (0x12, 0x12, 0x13, 0x13))

    def _plan(self, call: ServiceCall) -> Order:
        return orders.StartMission(self._clients.session(call.session).uploaded)

    async def _act_circle(self, call: ServiceCall) -> Message:
        def start() -> Order:
            return orders.StartHotpoint(self._circle(call)[1])

        return await self._acted(call, start, (0x20, 0x21, 0x22, 0x22))

    async def _acted(
        self, call: ServiceCall, start: Callable[[], Order], commands: tuple[int, ...]
    ) -> Message:
        number = call.request["action"]
        if number >= len(commands):
            raise UsageError("action is 0 (start), 1 (stop), 2 (pause) or 3 (resume)")
        others = (orders.StopMission(), orders.PauseMission(), orders.ResumeMission())
        await self._clients.order(call, others[number - 1] if number else start())
        return _done((0x03, commands[number]))

    async def _start(self, call: ServiceCall) -> Message:
        """Start what that client uploaded last: this service does not say which kind."""
        if self._graph.known(call.session).get(_LATEST) is not orders.StartHotpoint:
            return await self._clients.order(call, self._plan(call))
        return await self._clients.order(call, orders.StartHotpoint(self._circle(call)[1]))

    async def _pause(self, call: ServiceCall) -> Message:
        wanted = call.request["pause"]
        if wanted > 1:
            raise UsageError("pause is 0 (pause) or 1 (resume)")
        return await self._clients.order(
            call, orders.ResumeMission() if wanted else orders.PauseMission()
        )

    async def _cancel(self, call: ServiceCall) -> Message:
        return await self._clients.order(call, orders.StopMission())

    async def _count(self, call: ServiceCall) -> Message:
        """How many missions wait for this client's start, by kind."""
        has_circle = self._graph.known(call.session).get(_CIRCLE) is not None
        waypoints = bool(self._clients.session(call.session).uploaded)
        return {
            "waypoint_mission_count": int(waypoints),
            "hotpoint_mission_count": int(has_circle),
        }

    async def _info(self, call: ServiceCall) -> Message:
        return {"waypoint_task": self._uploaded()}

    async def _get_speed(self, call: ServiceCall) -> Message:
        self._uploaded()
        return {"speed": self._speed, "cmd_set": 0x03, "cmd_id": 0x17}

    def _uploaded(self) -> Message:
        if self._task is None:
            raise UsageError("no mission was uploaded through this station")
        return self._task

    async def _set_speed(self, call: ServiceCall) -> Message:
        speed = call.request["speed"]
        if not math.isfinite(speed):
            raise UsageError("speed is a number of m/s")
        order = orders.SetMissionSpeed(speed)
        outcome = await self._clients.session(call.session).ask(order)
        self._speed = outcome.number / 1000
        return {"result": True}

    # -- hotpoint --------------------------------------------------------------------------------

    async def _upload_circle(self, call: ServiceCall) -> Message:
        self._clients.session(call.session).held()
        given = call.request["hotpoint_task"]
        request = HotpointStart(
            latitude=math.radians(given["latitude"]),
            longitude=math.radians(given["longitude"]),
            altitude=given["altitude"],
            radius=given["radius"],
            angular_rate=given["angular_speed"],
            clockwise=given["is_clockwise"],
            start_point=given["start_point"],
            yaw_mode=given["yaw_mode"],
        )
        request.value(FIRMWARE_3_1)  # refused at once, not at its start
        self._graph.known(call.session)[_CIRCLE] = given, request
        self._graph.known(call.session)[_LATEST] = orders.StartHotpoint
        return _done(HotpointStart.ADDRESS)

    def _circle(self, call: ServiceCall) -> tuple[Message, HotpointStart]:
        found: tuple[Message, HotpointStart] | None = self._graph.known(call.session).get(_CIRCLE)
        if found is None:
            raise UsageError("this client has uploaded no hotpoint", remedy="upload it first")
        return found

    async def _circle_info(self, call: ServiceCall) -> Message:
        return {"hotpoint_task": self._circle(call)[0]} | _done((0x03, 0x26))

    async def _set_radius(self, call: ServiceCall) -> Message:
        await self._change(call, orders.SetHotpointRadius, call.request["radius"])
        return _done((0x03, 0x24))

    async def _set_rate(self, call: ServiceCall) -> Message:
        asked = call.request
        rate = asked["yaw_rate" if "yaw_rate" in asked else "speed"]
        signed = rate if asked["direction"] else -rate
        await self._change(call, orders.SetHotpointRate, signed)
        return _done((0x03, 0x23))

    async def _reset_heading(self, call: ServiceCall) -> Message:
        await self._clients.order(call, orders.ResetHotpointHeading())
        return _done((0x03, 0x25))

    async def _change(
        self, call: ServiceCall, make: Callable[[float], Order], value: float
    ) -> None:
        """Sent; nobody acknowledges it (errata 58)."""
        if not math.isfinite(value):
            raise UsageError("each value of an order is a number")
        await self._clients.order(call, make(value))


def _done(address: tuple[int, int]) -> Message:
    return {"result": True, "cmd_set": address[0], "cmd_id": address[1]}


def _push(kind: int, data: bytes) -> Message:
    return {"type": kind} | {f"data_{place}": value for place, value in enumerate(data[:5], 1)}


def _commands(task: Mapping[str, object]) -> tuple[WaypointMission, list[WaypointPoint]]:
    """The task as the commands that upload it; degrees become radians.

    Raises ``UsageError, BadValue``: too many points; a value that the wire does not carry.
    """
    given: Message = dict(task)
    waypoints = given["mission_waypoint"]
    if not 2 <= len(waypoints) <= _MOST_POINTS:
        raise UsageError(f"a mission has 2 to {_MOST_POINTS} waypoints, not {len(waypoints)}")
    mission = WaypointMission(
        count=len(waypoints),
        max_speed=given["velocity_range"],
        idle_speed=given["idle_velocity"],
        finish_action=given["action_on_finish"],
        repeat=given["mission_exec_times"],
        yaw_mode=0 if given["yaw_mode"] == _ROS_DEMO_YAW_MODE else given["yaw_mode"],
        trace_mode=given["trace_mode"],
        rc_lost_action=given["action_on_rc_lost"],
        gimbal_pitch_mode=given["gimbal_pitch_mode"],
    )
    return mission, [_point(index, one) for index, one in enumerate(waypoints)]


def _point(index: int, given: Message) -> WaypointPoint:
    count, times, actions, parameters = _actions(given["waypoint_action"])
    limit: int = given["action_time_limit"]
    return WaypointPoint(
        index=index,
        latitude=math.radians(given["latitude"]),
        longitude=math.radians(given["longitude"]),
        altitude=given["altitude"],
        damping=given["damping_distance"],
        yaw=given["target_yaw"],
        gimbal_pitch=given["target_gimbal_pitch"],
        turn_mode=given["turn_mode"],
        has_action=given["has_action"],
        # Programs send 64000 for no limit, which is 65535.
        action_time_limit=limit if limit <= _LONGEST_LIMIT_S else _NO_LIMIT,
        action_count=count,
        action_repeat=times,
        actions=actions,
        parameters=parameters,
    )


def _actions(given: Message) -> tuple[int, int, tuple[int, ...], tuple[int, ...]]:
    """How many actions, how often, and the two lists at the length of the wire.

    DJI's nodes of 2016 and later say "15 actions" whatever comes, and send ``action_repeat`` as the
    runs: 15 is taken as far as the list is filled, since the rest are stays of no time. The later
    definition's comment, and what that node tells of a mission, has the number in the lower and the
    runs in the upper four bits: a value that has upper bits is read so.
    """
    actions = tuple(given["command_list"])
    parameters = tuple(_signed(value) for value in given["command_parameter"])
    times, count = divmod(given["action_repeat"], 16)
    if not times:
        times = count
        filled = (
            place
            for place, pair in enumerate(zip(actions, parameters, strict=False), 1)
            if any(pair)
        )
        count = min(_MOST_ACTIONS, max(filled, default=0))
    return count, times, _padded(actions), _padded(parameters)


def _padded(values: tuple[int, ...]) -> tuple[int, ...]:
    return values + (0,) * (_MOST_ACTIONS + 1 - len(values))


def _signed(value: int) -> int:
    """The definition says unsigned, the wire signed: angles are negative."""
    return value - 0x10000 if value >= 0x8000 else value
