"""What ROS programs want of the aircraft: setpoints, control, missions, gimbal, and parameters.

Of all who send setpoints one is flown (pure logic, ``now`` is an argument).

One publisher has the stick at a time. It gets it by beginning to send while nobody has it, or by
being the only one that sends when control is obtained; it loses it by silence, and when control
ends. A refused publisher has to be silent first: nobody's setpoints begin to fly because another
publisher has died.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from functools import partial
from typing import Any, TypeVar

from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.control_session import ControlSession, ControlState, Terms
from m100link.apps.agent.latency import MAX_LATE, ClockEstimate
from m100link.apps.ros2.endpoints import Call, Endpoints, Input, answering, trigger
from m100link.apps.ros2.graph import Names
from m100link.apps.ros2.publishers import MessageMaker
from m100link.apps.ros2.topics import OUTPUTS
from m100link.errors import BadSetpoint, M100Error, UsageError
from m100link.log.ros2 import Deviations
from m100link.missions import waypoint
from m100link.missions.plan import WaypointPlan
from m100link.protocol.commands.gimbal import GimbalAngle, GimbalAngleMode, GimbalSpeed
from m100link.protocol.setpoint import Setpoint

E = TypeVar("E", bound=IntEnum)

SILENCE_S = 0.5  # seconds without a setpoint after which a publisher has let go
_JITTER_S = 0.1  # by how much a pause may be shorter where it is made than where it is heard
_MOST_SENDERS = 32


@dataclass(slots=True)
class _Sender:
    heard_at: float = -math.inf  # when it was heard last, s
    sent_at: float = 0.0  # when that was sent, s, by the clock of its sender
    sequence: int = 0  # how many it had sent by then, as it counts
    way: ClockEstimate = field(default_factory=ClockEstimate)
    made: ClockEstimate = field(default_factory=ClockEstimate)  # by the stamps in its headers


class SetpointMux:
    def __init__(self) -> None:
        self.holder: bytes | None = None  # id of who has it; None for nobody
        self.is_open = False  # whether anybody may have it: control is held
        # Setpoints that were not flown, by the reason.
        self.refused = {"late": 0, "other": 0, "closed": 0}
        self._senders: dict[bytes, _Sender] = {}  # who was heard last stands last
        # More of them send than are known: until then nobody counts as beginning.
        self._crowded_until = -math.inf

    def begin(self, now: float) -> None:
        """Control was obtained: who sends alone has the stick."""
        self.is_open = True
        sending = [one for one, sender in self._senders.items() if self._sends(sender, now)]
        is_alone = len(sending) == 1 and now >= self._crowded_until
        self.holder = sending[0] if is_alone else None

    def end(self) -> None:
        self.is_open, self.holder = False, None

    def hear(
        self, sender: bytes, sent_at: float, now: float, sequence: int = 0, made_at: float = 0.0
    ) -> str:
        """A setpoint came. Returns why it is not flown, empty where it is.

        ``sent_at``: when it was sent, s, by the clock of its sender. ``now``: s. ``made_at``: when
        it was made, s, by whichever clock: a relay sends an old one anew. 0: it says no time.
        """
        known = self._senders.pop(sender, None)
        if known is None:
            if not self._has_room(now):
                self._crowded_until = now + SILENCE_S
                return self._refuse("other" if self.is_open else "closed")
            known = _Sender()
        self._senders[sender] = known
        self.look(now)
        begins = self._begins(known, sent_at, now, sequence) and now >= self._crowded_until
        known.heard_at, known.sent_at, known.sequence = now, sent_at, sequence
        late = known.way.late(sent_at, now)
        if made_at:
            late = max(late, known.made.late(made_at, now))
        if not self.is_open:
            return self._refuse("closed")
        if self.holder is None and begins:
            self.holder = sender
        if self.holder != sender:
            return self._refuse("other")
        return self._refuse("late") if late > MAX_LATE else ""

    def _begins(self, known: _Sender, sent_at: float, now: float, sequence: int) -> bool:
        """Whether it was silent by its own account, too.

        A program that went on sending while its link was cut does not fly on when it is whole
        again: then numbers are missing, or waiting samples were sent without a pause.
        """
        if self._sends(known, now):
            return False
        was_silent = sent_at - known.sent_at >= SILENCE_S - _JITTER_S
        return known.heard_at == -math.inf or (was_silent and sequence <= known.sequence + 1)

    def _has_room(self, now: float) -> bool:
        """Whether one more can be known, once those who fell silent are forgotten."""
        while len(self._senders) >= _MOST_SENDERS:
            oldest, sender = next(iter(self._senders.items()))
            if self._sends(sender, now):
                return False
            del self._senders[oldest]
        return True

    def look(self, now: float) -> None:
        """Let time pass: who is silent lets go."""
        if self.holder is not None:
            holder = self._senders.get(self.holder)
            if holder is None or not self._sends(holder, now):
                self.holder = None

    def _refuse(self, why: str) -> str:
        self.refused[why] += 1
        return why

    @staticmethod
    def _sends(sender: _Sender, now: float) -> bool:
        return now - sender.heard_at < SILENCE_S


# -- setpoints of ROS programs in the words of the aircraft: speeds, and places to be flown to -----


_GAIN = 0.8  # metres per second for each metre that is missing
_FASTEST, _CLIMB = 5.0, 2.0
_NO_ROTATION, _NOT_UNIT = 1e-6, 0.01


class Frames:
    """Which frames mean the ground (east, north, up), and which the body (forward, left, up)."""

    def __init__(self, ground: Collection[str], body: Collection[str]) -> None:
        self._ground, self._body = set(ground), {"", *body}

    def is_body(self, name: str, kind: str) -> bool:
        """Whether a frame turns with the aircraft. Raises UsageError: nobody knows the frame."""
        if name in self._body:
            return True
        if name in self._ground:
            return False
        known = ", ".join(sorted((self._ground | self._body) - {""}))
        raise UsageError(f"{kind} in the frame {name!r}", remedy=f"frames are {known}")


def speed(twist: Mapping[str, Any], *, is_body: bool) -> Setpoint:
    """A geometry_msgs/Twist as a setpoint: m/s, and rad/s about the axis that points up.

    Raises BadSetpoint: a number that the aircraft does not take.
    """
    linear, angular = twist["linear"], twist["angular"]
    turn = -math.degrees(angular["z"])
    if is_body:
        return Setpoint.velocity(
            forward=linear["x"], right=-linear["y"], up=linear["z"], yaw_rate_deg_s=turn
        )
    return Setpoint.velocity(
        north=linear["y"], east=linear["x"], up=linear["z"], yaw_rate_deg_s=turn
    )


def toward(
    pose: Mapping[str, Any], here: tuple[float, float, float], *, fastest: float | None
) -> Setpoint:
    """A velocity that leads to a geometry_msgs/Pose: the slower, the nearer.

    ``pose``: east, north, up of the origin, m, and the heading; no rotation keeps the present one.
    ``here``: east, north, up of the aircraft, m. ``fastest``: horizontal speed that the guards
    allow, m/s. Raises BadSetpoint: a number that is not finite, or an orientation that is none.
    """
    place, turned = pose["position"], pose["orientation"]
    east, north, up = (_GAIN * (place[axis] - at) for axis, at in zip("xyz", here, strict=True))
    limit = _FASTEST if fastest is None else min(_FASTEST, fastest)
    scale = max(1.0, math.hypot(east, north) / limit)
    x, y, z, w = (turned[axis] for axis in "xyzw")
    climb = max(-_CLIMB, min(_CLIMB, up)) if math.isfinite(up) else up
    motion = {"north": north / scale, "east": east / scale, "up": climb}
    size = math.hypot(x, y, z, w)
    if size < _NO_ROTATION:
        return Setpoint.velocity(**motion, yaw_rate_deg_s=0.0)
    if not abs(size - 1.0) < _NOT_UNIT:
        raise BadSetpoint(
            f"an orientation that is no rotation: a quaternion of length {size:g}",
            remedy="give one of length 1, or zeros to keep the heading",
        )
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return Setpoint.velocity(**motion, yaw_deg=math.remainder(90.0 - math.degrees(yaw), 360.0))


# -- what ROS programs want of the aircraft, asked of its agent: one lease for all of them ---------
# Control is asked for and given back by services of any caller: a call from a shell is over
# before anything flies. The stick keeps programs with setpoints apart, and the goal those that fly
# by themselves.


LIFETIME = 0.3
"""Seconds that a setpoint flies when no other one comes: after that the aircraft brakes."""

IDLE_S = 60.0  # seconds on the ground without an order after which control is given back
TERMS = Terms(gives_way=True, idle_s=IDLE_S, who="ROS", remedy="call ~/obtain_control first")


class RosControl:
    """Control of the aircraft by ROS programs, and what is asked under it."""

    def __init__(self, agent: AgentClient) -> None:
        self._agent = agent
        self.session = ControlSession(agent, "ROS 2", TERMS)
        self.mux = SetpointMux()  # whose setpoints fly
        self.goal = ""  # what flies by itself for a program; empty for nothing
        # Tasks that have not begun, and when each was asked for: asked again, it is the same one.
        self._tasks: dict[orders.Order, tuple[asyncio.Task[Any], float]] = {}

    async def obtain(self) -> None:
        """Take the lease and obtain control authority. Raises as :meth:`ControlSession.obtain`."""
        await self.session.obtain()
        self.mux.begin(self._agent.now)

    async def release(self) -> None:
        """Give control back: motion ends, the pilot flies."""
        self.mux.end()
        self.session.let_go()

    async def fly(self, task: orders.Order) -> None:
        """Let the autopilot take off, land or go home; returns when it has begun.

        After a landing control is given back. Later failures are in the events. Raises M100Error:
        as :meth:`m100link.apps.agent.client.AgentClient.ask`.
        """
        lease = self.session.held()
        if isinstance(task, orders.TakeOff):
            self.require_free("take-off")
        else:
            self._agent.hover(f"{task.label} was requested", lease)
        # A STOP from now on overtakes each step.
        agent, at = self._agent, self._agent.asked_at
        before, asked_at = self._tasks.get(task, (None, at))
        if before is None or before.done() or asked_at <= agent.stopped_at:
            before = agent.background.spawn(
                agent.background.begin(partial(self._flown, at, task), task.label), task.label
            )
            self._tasks[task] = before, at
        await asyncio.wait([before])
        before.result()

    async def _flown(self, asked_at: float, task: orders.Order, begun: asyncio.Event) -> None:
        try:
            if isinstance(task, orders.TakeOff):
                await self._agent.ask(task, self.session.lease, begun.set, asked_at)
            else:
                await self.session.bring_down(task, asked_at, begun.set)
        except M100Error as error:
            if not begun.is_set():
                raise
            self._agent.note(f"{task.label}: {error.seen}", "error")
            return
        if not isinstance(task, orders.TakeOff) and self._agent.view.is_on_ground:
            await self.release()

    def require_free(self, what: str) -> None:
        """Nothing else flies for a program. Raises UsageError: something does."""
        if self.goal:
            raise UsageError(f"{what}: {self.goal} flies", remedy="cancel that goal first")

    async def do(self, order: orders.Order) -> None:
        """Something that needs the lease and is done when it is answered.

        Raises M100Error: as :meth:`m100link.apps.agent.client.AgentClient.ask`.
        """
        self.session.held()
        await self.session.ask(order)

    def refusal(self) -> str:
        """Why no setpoint can be flown now, empty where one can."""
        state = self._agent.state
        if not self.session.has_control:
            return "ROS has no control: call ~/obtain_control"
        if self.session.state is not ControlState.HOLDING:
            return "it was stopped: call ~/obtain_control"
        if self.goal:
            return f"{self.goal} flies: cancel it first"
        if state.task or (state.mission and state.mission != "no mission"):
            return f"{state.task or state.mission} flies"
        return "" if self._agent.view.is_airborne else "on the ground: call ~/takeoff first"

    def advance(self) -> None:
        """Keep the lease; give it back when nobody has use for it."""
        self.mux.look(self._agent.now)
        if self.session.state is not ControlState.HOLDING:
            self.mux.end()  # STOP, by whomever, is for those who send setpoints, too
        # An unknown status counts as the air: control is not let go of there.
        is_on_ground = self._agent.view.is_on_ground and not self._agent.state.task
        self.session.heard(is_idle=bool(is_on_ground) and not self.goal)


# -- missions that the aircraft flies by itself (firmware 3.1) -------------------------------------
# A plan is checked as a whole when it is uploaded, and lies with the agent until it is started:
# nothing is in the aircraft that nobody watches.


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


# -- parameters, by the services of rcl_interfaces: rates, deviations, and guards to read ----------


MOST_HZ = 100.0  # of a topic; the aircraft says nothing more often, and nothing errs more
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
        for name in Deviations._fields:
            self._rows[f"deviations.{name}"] = Parameter(
                _DOUBLE,
                "standard deviation for the covariances of imu, fix and odom; 0: unknown",
                lambda name=name: getattr(teller.deviations, name),  # type: ignore[misc] # keeps its name
                partial(teller.set_deviation, name),
            )
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
