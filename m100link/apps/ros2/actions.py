"""Actions of ROS 2 by their three services and two topics: goal, feedback, result, cancel.

One goal flies at a time, whichever action it is of; the next one is rejected. Cancelled means
hover. When somebody who may have asked is not in the graph any more, its goal is cancelled.
"""

from __future__ import annotations

import asyncio
import math
from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import partial
from typing import Any

from m100link.apps.agent import orders
from m100link.apps.agent.background import is_set_within
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.messages import Event
from m100link.apps.agent.messages import EventTopic as EventTopic
from m100link.apps.agent.orders import ChangeHeight, FlyTo, GuidedOrder
from m100link.apps.agent.preview import require_inside
from m100link.apps.ros2.control import RosControl
from m100link.apps.ros2.endpoints import Endpoints, Heartbeat, PublishedTopic
from m100link.apps.ros2.graph import GraphDiscovery, Names, Qos, Seen
from m100link.errors import M100Error, UsageError
from m100link.protocol.records import Position

FEEDBACK_S = 0.5  # seconds between two messages of feedback
_KEPT = 32  # goals whose outcome is remembered
_MOST_WAITING = 32  # who can wait for the results of an action
_STATUS = Qos(is_latched=True, depth=1)
_NOBODY = bytes(16)
_NO_TIME = {"sec": 0, "nanosec": 0}

# Return codes of action_msgs/srv/CancelGoal.
_CANCELING, _UNKNOWN, _TERMINATED = 0, 2, 3


class GoalStatus(IntEnum):
    """States of a goal, as action_msgs/msg/GoalStatus numbers them."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6

    @property
    def is_over(self) -> bool:
        return self >= GoalStatus.SUCCEEDED


@dataclass(slots=True)
class _Goal:
    id: bytes
    action: _Action
    stamp: Mapping[str, int]  # when it was accepted
    flight: FlightGoal
    clients: Mapping[str, Seen]  # those who may have asked, by their tokens
    status: GoalStatus = GoalStatus.ACCEPTED  # where it stands
    message: str = ""  # why it ended as it did
    over: asyncio.Event = field(default_factory=asyncio.Event)  # set when it has

    @property
    def info(self) -> dict[str, Any]:
        return {"goal_id": {"uuid": list(self.id)}, "stamp": self.stamp}


@dataclass(frozen=True, slots=True)
class _Action:
    name: str  # private to the node
    topic: str
    make: Callable[
        [AgentClient, RosControl, Mapping[str, Any]], FlightGoal
    ]  # makes what flies of a goal
    feedback: PublishedTopic  # where it reports how far it is
    status: PublishedTopic  # where it reports the states of goals


class Actions:
    def __init__(
        self,
        agent: AgentClient,
        control: RosControl,  # where a goal says that it flies
        ends: Endpoints,  # where services and topics are offered
        names: Names,  # names of the node
        presence: GraphDiscovery,  # who is there
        heartbeat: Heartbeat,  # who of them still runs
        stamp: Callable[[], Mapping[str, int]],  # time now, as builtin_interfaces/Time
    ) -> None:
        self._agent, self._control, self._presence, self._stamp = agent, control, presence, stamp
        self._heartbeat = heartbeat
        self._goals: OrderedDict[bytes, _Goal] = OrderedDict()
        self._current: _Goal | None = None
        self._feedback_at = agent.now
        agent.on_event.append(self._hear)
        self._actions: list[_Action] = []
        for name, (kind, make, _) in FLIGHTS.items():
            inner = f"{names.full(name)}/_action"
            feedback = ends.publish(f"{inner}/feedback", f"{kind}_FeedbackMessage", Qos())
            status = ends.publish(f"{inner}/status", "action_msgs/GoalStatusArray", _STATUS)
            action = _Action(name, names.full(name), make, feedback, status)
            self._actions.append(action)
            ends.serve(f"{inner}/send_goal", f"{kind}_SendGoal", self._sending(action))
            result = f"{kind}_GetResult"
            ends.serve(f"{inner}/get_result", result, self._result, at_once=_MOST_WAITING)
            cancel, kind = self._canceling(action), "action_msgs/srv/CancelGoal"
            ends.serve(f"{inner}/cancel_goal", kind, cancel, ends=orders.Halt)

    # -- services --------------------------------------------------------------------------------

    def _sending(self, action: _Action) -> Callable[[dict[str, Any]], Any]:
        async def send(request: dict[str, Any]) -> Mapping[str, Any]:
            stamp = self._stamp()
            identity = bytes(request["goal_id"]["uuid"])
            try:
                if identity in self._goals:
                    raise ValueError("a goal with that id exists")
                self._control.session.held()
                self._control.require_free(action.name)
                flight = action.make(self._agent, self._control, request["goal"])
            except (M100Error, ValueError) as error:
                why = error.seen if isinstance(error, M100Error) else str(error)
                self._agent.note(f"{action.name}: {why}", "warning")
                return {"accepted": False, "stamp": stamp}
            clients = self._presence.clients(f"{action.topic}/_action/send_goal")
            goal = _Goal(identity, action, stamp, flight, clients)
            self._begin(goal)
            return {"accepted": True, "stamp": stamp}

        return send

    async def _result(self, request: dict[str, Any]) -> Mapping[str, Any]:
        goal = self._goals.get(bytes(request["goal_id"]["uuid"]))
        if goal is None:
            result = {"success": False, "message": "there is no such goal, or it ended long ago"}
            return {"status": GoalStatus.UNKNOWN, "result": result}
        await goal.over.wait()
        done = goal.status is GoalStatus.SUCCEEDED
        return {"status": goal.status, "result": {"success": done, "message": goal.message}}

    def _canceling(self, action: _Action) -> Callable[[dict[str, Any]], Any]:
        async def cancel(request: dict[str, Any]) -> Mapping[str, Any]:
            """Nobody is refused a hover."""
            wanted = request["goal_info"]
            identity, stamp = bytes(wanted["goal_id"]["uuid"]), wanted["stamp"]
            ours = {key: one for key, one in self._goals.items() if one.action is action}
            if identity != _NOBODY and identity not in ours:
                return {"return_code": _UNKNOWN, "goals_canceling": []}
            goal = None if self._current is None else ours.get(self._current.id)
            is_all = identity == _NOBODY and stamp == _NO_TIME
            if goal is None or not (is_all or identity == goal.id or _before(goal.stamp, stamp)):
                code = _CANCELING if identity == _NOBODY else _TERMINATED
                return {"return_code": code, "goals_canceling": []}
            self._cancel(goal, "the goal was cancelled")
            return {"return_code": _CANCELING, "goals_canceling": [goal.info]}

        return cancel

    # -- goals -----------------------------------------------------------------------------------

    def _begin(self, goal: _Goal) -> None:
        self._goals[goal.id] = self._current = goal
        while len(self._goals) > _KEPT:
            self._goals.popitem(last=False)
        self._control.goal = goal.action.name
        self._heartbeat.follow(frozenset(one.node[0] for one in goal.clients.values()))
        if goal.clients:
            who = ", ".join(sorted({one.node_name for one in goal.clients.values()}))
            self._agent.note(f"{goal.action.name} for {who}")
        else:
            self._agent.note(f"{goal.action.name}: its node is unknown, and not watched", "warning")
        self._agent.background.spawn(self._fly(goal), goal.action.name)

    async def _fly(self, goal: _Goal) -> None:
        outcome, message = GoalStatus.ABORTED, "the node ends"
        try:
            if goal.status is GoalStatus.ACCEPTED:  # else it was cancelled before it began
                goal.status = GoalStatus.EXECUTING
                self._tell_status(goal.action)
                goal.flight.require_inside()
                await goal.flight.run()
            outcome, message = GoalStatus.SUCCEEDED, "done"
        except M100Error as error:
            message = str(error)
        finally:
            if goal.status is GoalStatus.CANCELING:
                outcome, message = GoalStatus.CANCELED, goal.message
            goal.status, goal.message = outcome, message
            self._control.goal, self._current = "", None
            goal.over.set()
            self._tell_status(goal.action)

    def _cancel(self, goal: _Goal, why: str) -> None:
        if goal.status is not GoalStatus.CANCELING:
            goal.status, goal.message = GoalStatus.CANCELING, why
            goal.flight.end(why)
            self._tell_status(goal.action)

    def _tell_status(self, action: _Action) -> None:
        statuses = [
            {"goal_info": one.info, "status": one.status}
            for one in self._goals.values()
            if one.action is action
        ]
        action.status.say({"status_list": statuses})

    def _hear(self, event: Event) -> None:
        """Somebody, at whatever front, stopped what flies, or had it hover: more legs may come."""
        if event.topic in (EventTopic.STOPPED, EventTopic.HALTED):
            self.end(event.text)

    def end(self, why: str) -> None:
        if self._current is not None:
            self._cancel(self._current, why)

    def advance(self) -> None:
        """Look after the goal: who asked is there, and how far it is."""
        goal, now = self._current, self._agent.now
        if goal is None:
            return
        if self._presence.missing(goal.clients):
            self._cancel(goal, "the client of the goal has gone")
        elif self._heartbeat.is_missing(now):
            self._cancel(goal, "the client of the goal does not answer any more")
        if not goal.flight.is_ours:
            # Between two of its legs nothing of it flies that the agent could have ended.
            self._cancel(goal, "control was lost, or given back")
        if now - self._feedback_at >= FEEDBACK_S:
            self._feedback_at = now
            message = {"goal_id": {"uuid": list(goal.id)}, "feedback": goal.flight.feedback()}
            goal.action.feedback.say(message)


def _before(one: Mapping[str, int], other: Mapping[str, int]) -> bool:
    return (one["sec"], one["nanosec"]) <= (other["sec"], other["nanosec"])


# -- what actions fly: each a few orders to the agent, one by one, and a way to end them -----------


_CLOSE_M = 0.3  # a climb of less than this after the take-off is not asked for
_MOST_WAYPOINTS = 500
_SPEED, _FASTEST = 5.0, 10.0
_LONGEST_WAIT_S = 600.0


class FlightGoal(ABC):
    """A goal that flies: orders to the agent under the lease of their beginning."""

    legs: Sequence[GuidedOrder]  # what it flies, but for the autopilot's take-off

    def __init__(self, agent: AgentClient, control: RosControl) -> None:
        self._agent, self._lease = agent, control.session.held()
        # A STOP since the goal came overtakes each of its orders.
        self._ask = partial(agent.ask, lease=self._lease, asked_at=agent.asked_at)
        self._ended = asyncio.Event()

    def require_inside(self) -> None:
        """Raise GuardRefused before anything moves, where a later leg leaves the envelope."""
        require_inside(self.legs, self._agent.view.telemetry, self._agent.state.limits)

    @abstractmethod
    async def run(self) -> None:
        """Fly it; done when it is there.

        Raises M100Error: it was refused, or ended before its end.
        """

    @abstractmethod
    def feedback(self) -> Mapping[str, Any]:
        """How far it is."""

    def end(self, why: str) -> None:
        """End it with a hover, after the autopilot's take-off; nothing more is ordered."""
        self._ended.set()
        if self.is_ours:  # what somebody else flies by now goes on
            self._agent.hover(why, self._lease)

    @property
    def is_ours(self) -> bool:
        """Whether the lease of its beginning is in force."""
        return self._agent.holds(self._lease)

    async def guide(self, order: GuidedOrder) -> None:
        """Fly one order, unless it was ended."""
        if not self._ended.is_set():
            await self._ask(order)

    async def wait(self, seconds: float) -> None:
        """Hover for a while, unless it was ended."""
        await is_set_within(self._ended, seconds)

    def progress(self) -> Mapping[str, Any]:
        guided = self._agent.state.guided
        known = (None, None) if guided is None else (guided.distance_m, guided.seconds)
        distance, seconds = (math.nan if one is None else one for one in known)
        return {"distance": distance, "seconds": seconds}


class _TakeOff(FlightGoal):
    def __init__(self, agent: AgentClient, control: RosControl, goal: Mapping[str, Any]) -> None:
        super().__init__(agent, control)
        self._height = _height(goal["height"])
        self.legs = [ChangeHeight(self._height)]

    async def run(self) -> None:
        await self._ask(orders.TakeOff())
        if self._height and abs(self._now() - self._height) >= _CLOSE_M:
            await self.guide(*self.legs)

    def _now(self) -> float:
        position = self._agent.view.get(Position)
        return math.nan if position is None else position.height_m

    def feedback(self) -> Mapping[str, Any]:
        return {"height": self._now()}


class _FlyTo(FlightGoal):
    def __init__(self, agent: AgentClient, control: RosControl, goal: Mapping[str, Any]) -> None:
        super().__init__(agent, control)
        self.legs = [_order(goal, goal["speed"])]

    async def run(self) -> None:
        await self.guide(*self.legs)

    def feedback(self) -> Mapping[str, Any]:
        return self.progress()


class _FlyMission(FlightGoal):
    def __init__(self, agent: AgentClient, control: RosControl, goal: Mapping[str, Any]) -> None:
        super().__init__(agent, control)
        points = goal["waypoints"]
        if not 0 < len(points) <= _MOST_WAYPOINTS:
            raise UsageError(f"a mission has 1 to {_MOST_WAYPOINTS} waypoints, not {len(points)}")
        self.legs = [_order(one, goal["speed"]) for one in points]
        self._waits = [_wait(one["wait"]) for one in points]
        self._place = 0

    async def run(self) -> None:
        for place, (order, wait) in enumerate(zip(self.legs, self._waits, strict=True)):
            self._place = place
            await self.guide(order)
            if wait:
                await self.wait(wait)

    def feedback(self) -> Mapping[str, Any]:
        return {"waypoint": self._place, **self.progress()}


def _finite(what: str, value: float) -> float:
    if not math.isfinite(value):
        raise UsageError(f"{what} that is not a number")
    return value


def _height(metres: float) -> float:
    if _finite("a height", metres) < 0.0:
        raise UsageError("a height below the take-off point")
    return metres


def _wait(seconds: float) -> float:
    if not 0.0 <= _finite("a time", seconds) <= _LONGEST_WAIT_S:
        raise UsageError(f"a wait of {seconds:g} s", remedy=f"0 to {_LONGEST_WAIT_S:g} s")
    return seconds


def _order(place: Mapping[str, Any], speed: float) -> FlyTo:
    latitude = _finite("a latitude", place["latitude"])
    longitude = _finite("a longitude", place["longitude"])
    height = _height(place["height"])
    if abs(latitude) > 89.0 or abs(longitude) > 180.0:
        raise UsageError(f"{latitude:g}, {longitude:g} is not a place", remedy="degrees are needed")
    if not 0.0 <= _finite("a speed", speed) <= _FASTEST:
        raise UsageError(f"a speed of {speed:g} m/s", remedy=f"0 to {_FASTEST:g} m/s")
    return FlyTo(latitude, longitude, height, speed or _SPEED)


FLIGHTS: Mapping[
    str, tuple[str, Callable[[AgentClient, RosControl, Mapping[str, Any]], FlightGoal], str]
] = {
    "~/take_off": ("m100_msgs/action/TakeOff", _TakeOff, "take off, and climb to a height"),
    "~/fly_to": ("m100_msgs/action/FlyTo", _FlyTo, "fly straight to a place, and hover there"),
    "~/fly_mission": (
        "m100_msgs/action/FlyMission",
        _FlyMission,
        "fly from place to place by the agent, with every firmware; hover at the last one",
    ),
}
"""Actions: type, what flies, and what it does for the manual."""
