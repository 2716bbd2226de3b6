"""Services of the node: missions that the aircraft flies by itself, the gimbal, and parameters.

The plan of a mission (firmware 3.1) is checked as a whole when it is uploaded, and lies with the
agent until it is started: nothing is in the aircraft that nobody watches.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from functools import partial
from typing import Any, TypeVar

from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient
from m100link.apps.ros2.control import RosControl
from m100link.apps.ros2.endpoints import Call, Endpoints, Input, answering, trigger
from m100link.apps.ros2.graph import Names
from m100link.apps.ros2.publishers import MessageMaker
from m100link.apps.ros2.topics import OUTPUTS
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


# -- parameters, by the services of rcl_interfaces: rates to set, guards to read -------------------


MOST_HZ = 100.0  # of a topic; the aircraft says nothing more often
_MOST_NAMES = 64  # of one request, which has to be answered within a step

# Types of rcl_interfaces/msg/ParameterType.
_NOT_SET, _BOOL, _DOUBLE = 0, 1, 3
_FIELDS = {_BOOL: "bool_value", _DOUBLE: "double_value"}
_EMPTY: Mapping[str, Any] = {
    "type": _NOT_SET,
    "bool_value": False,
    "integer_value": 0,
    "double_value": 0.0,
    "string_value": "",
    **{f"{kind}_array_value": [] for kind in ("byte", "bool", "integer", "double", "string")},
}


@dataclass(frozen=True, slots=True)
class Parameter:
    kind: int
    text: str  # what it is
    value: Callable[[], float | bool | None]  # its value now; None where there is none
    # Takes a new value; None for one that cannot be set.
    take: Callable[[float], None] | None = None


class Parameters:
    def __init__(
        self, agent: AgentClient, teller: MessageMaker, ends: Endpoints, names: Names
    ) -> None:
        self._rows: dict[str, Parameter] = {
            "use_sim_time": Parameter(
                _BOOL, "stamps are POSIX time here; /clock is for other nodes", lambda: False
            )
        }
        for name in ("max_height_m", "max_radius_m", "max_speed_m_s", "battery_floor_percent"):
            self._rows[f"guards.{name}"] = Parameter(
                _DOUBLE,
                "a limit of the agent's guards; set where the aircraft is",
                lambda name=name: getattr(agent.state.limits, name),  # type: ignore[misc] # keeps its name
            )
        for topic, row in OUTPUTS.items():
            if row.hz:
                self._add_rate(topic, teller)
        services: dict[str, Callable[[dict[str, Any]], Mapping[str, Any]]] = {
            "list_parameters": self._list,
            "get_parameters": lambda asked: {"values": [*map(self._value, asked["names"])]},
            "get_parameter_types": lambda asked: {
                "types": [self._value(one)["type"] for one in asked["names"]]
            },
            "describe_parameters": lambda asked: {
                "descriptors": [*map(self._described, asked["names"])]
            },
            "set_parameters": lambda asked: {
                "results": [self._set([one]) for one in asked["parameters"]]
            },
            "set_parameters_atomically": lambda asked: {"result": self._set(asked["parameters"])},
        }
        for name, answer in services.items():
            kind = "".join(word.capitalize() for word in name.split("_"))
            ends.serve(names.full(f"~/{name}"), f"rcl_interfaces/srv/{kind}", _at_once(answer))

    def _add_rate(self, topic: str, teller: MessageMaker) -> None:
        take = partial(teller.set_hz, topic)
        word = topic.rpartition("/")[2]
        text = f"most messages per second of {topic}, 0 to {MOST_HZ:g}; 0 for all"
        self._rows[f"rates.{word}"] = Parameter(_DOUBLE, text, lambda: teller.hz[topic], take)

    def _list(self, asked: dict[str, Any]) -> Mapping[str, Any]:
        prefixes = asked["prefixes"]
        names = [
            one
            for one in self._rows
            if not prefixes or any(one == p or one.startswith(f"{p}.") for p in prefixes)
        ]
        found = sorted({one.partition(".")[0] for one in names if "." in one})
        return {"result": {"names": names, "prefixes": found}}

    def _value(self, name: str) -> Mapping[str, Any]:
        row = self._rows.get(name)
        value = None if row is None else row.value()
        if row is None or value is None:
            return _EMPTY
        return {**_EMPTY, "type": row.kind, _FIELDS[row.kind]: value}

    def _described(self, name: str) -> Mapping[str, Any]:
        row = self._rows.get(name)
        is_set = row is not None and row.take is not None
        span = {"from_value": 0.0, "to_value": MOST_HZ, "step": 0.0}
        return {
            "name": name,
            "type": _NOT_SET if row is None else row.kind,
            "description": "" if row is None else row.text,
            "additional_constraints": "",
            "read_only": not is_set,
            "dynamic_typing": False,
            "floating_point_range": [span] if is_set else [],
            "integer_range": [],
        }

    def _set(self, parameters: list[dict[str, Any]]) -> Mapping[str, Any]:
        for one in parameters:
            refusal = self._refusal(one["name"], one["value"])
            if refusal:
                return {"successful": False, "reason": refusal}
        for one in parameters:
            take = self._rows[one["name"]].take
            if take is not None:
                take(one["value"]["double_value"])
        return {"successful": True, "reason": ""}

    def _refusal(self, name: str, value: Mapping[str, Any]) -> str:
        row = self._rows.get(name)
        if row is None:
            return f"there is no parameter {name}"
        if row.take is None:
            is_same = row.value() == value.get(_FIELDS[row.kind]) and value["type"] == row.kind
            return "" if is_same else f"{name} cannot be set here: {row.text}"
        number = value["double_value"]
        if value["type"] != _DOUBLE or not math.isfinite(number) or not 0.0 <= number <= MOST_HZ:
            return f"{name} is a double, 0 to {MOST_HZ:g}"
        return ""


def _at_once(
    answer: Callable[[dict[str, Any]], Mapping[str, Any]],
) -> Callable[[dict[str, Any]], Any]:
    async def call(asked: dict[str, Any]) -> Mapping[str, Any]:
        for what in asked.values():
            if isinstance(what, list) and len(what) > _MOST_NAMES:
                raise UsageError(f"{len(what)} parameters", remedy=f"ask for {_MOST_NAMES} at most")
        return answer(asked)

    return call
