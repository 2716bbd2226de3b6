"""Action servers as actionlib has them: five topics each, and one goal at a time.

Any client may send a goal; what flies does so under the control session of that client. The newest
goal wins. A goal that is cancelled, replaced, or whose client leaves ends in a hover. A STOP
overtakes each step of the goals that came before it.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass
from enum import IntEnum
from functools import partial
from itertools import count
from typing import Any

from m100link.apps.agent.client import PRESSED_AT, AgentClient
from m100link.apps.station.ros.graph import Graph, GraphListener, stamped
from m100link.apps.station.ros.leases import Clients
from m100link.apps.station.ros.messages import Message, present
from m100link.errors import M100Error

_STATUS_S = 0.2  # actionlib tells the states of goals at 5 Hz
_KEPT = 16  # goals that are over and still in the status
_KEPT_S = 5.0

Tell = Callable[..., None]
"""Publishes the feedback of a goal: its fields by name."""

Work = Callable[[GraphListener, Message, Tell], Awaitable[None]]
"""Carries a goal out, for that client. Raises ``M100Error``: it ended otherwise."""


class GoalState(IntEnum):
    """Numbers of actionlib_msgs/GoalStatus."""

    PENDING = 0
    ACTIVE = 1
    PREEMPTED = 2
    SUCCEEDED = 3
    ABORTED = 4
    REJECTED = 5


@dataclass(eq=False, slots=True)
class _Goal:
    client: GraphListener
    identity: Message
    value: Message
    asked_at: float  # s; a STOP since then overtakes each of its steps
    state: GoalState = GoalState.PENDING
    text: str = ""
    ended_at: float | None = None
    why: str = ""  # it is ended from here
    task: asyncio.Task[None] | None = None

    @property
    def status(self) -> Message:
        return {"goal_id": self.identity, "status": int(self.state), "text": self.text}


class ActionServer:
    """``name/goal``, ``cancel``, ``status``, ``feedback`` and ``result``."""

    def __init__(
        self,
        agent: AgentClient,
        graph: Graph,
        clients: Clients,
        name: str,
        kind: str,  # package and name of the action, without ``Action``
        work: Work,
    ) -> None:
        self._agent, self._graph, self._clients, self._work = agent, graph, clients, work
        self._name, self._numbers = name, count(1)
        self._goals: list[_Goal] = []
        self._newest: _Goal | None = None
        self._goal = graph.add_topic(f"{name}/goal", f"{kind}ActionGoal", self._on_goal)
        graph.add_topic(f"{name}/cancel", "actionlib_msgs/GoalID", self._on_cancel)
        self._status = graph.add_topic(f"{name}/status", "actionlib_msgs/GoalStatusArray")
        self._feedback = graph.add_topic(f"{name}/feedback", f"{kind}ActionFeedback")
        self._result = graph.add_topic(f"{name}/result", f"{kind}ActionResult")
        graph.on_leave.append(self._left)
        agent.background.spawn(self._keep_telling(), f"{name} status")

    # -- what clients hear -----------------------------------------------------------------------

    async def _keep_telling(self) -> None:
        while True:
            await asyncio.sleep(_STATUS_S)
            self._tell_status()

    def _tell_status(self) -> None:
        now = self._agent.now
        # However many are refused meanwhile: one that flies has to be found by its cancel.
        ends = [(one, one.ended_at) for one in self._goals]
        over = [one for one, at in ends if at is not None and now - at <= _KEPT_S]
        self._goals = [one for one in self._goals if one.ended_at is None or one in over[-_KEPT:]]
        if self._status.subscribers:
            message = {"header": stamped(""), "status_list": [one.status for one in self._goals]}
            self._graph.publish(self._status, message, now)

    def _tell(self, goal: _Goal, part: str, **values: Any) -> None:
        topic = self._feedback if part == "feedback" else self._result
        message = topic.type.default()
        message |= {"header": stamped(""), "status": goal.status, part: message[part] | values}
        self._graph.publish(topic, message, self._agent.now)

    def _end(self, goal: _Goal, state: GoalState, text: str = "") -> None:
        goal.state, goal.text, goal.ended_at = state, text, self._agent.now
        self._tell_status()
        self._tell(goal, "result", result=state is GoalState.SUCCEEDED)

    # -- what clients ask ------------------------------------------------------------------------

    def _on_goal(self, client: GraphListener, message: Message, now: float) -> None:
        identity = dict(message["goal_id"])
        identity["id"] = identity["id"][:256] or f"{self._name}-{next(self._numbers)}"
        if not any(identity["stamp"].values()):
            identity["stamp"] = present()
        goal, before = _Goal(client, identity, message["goal"], now), self._newest
        self._goals.append(goal)
        if not (self._goal.ends(message) or self._clients.admits(client)):
            self._end(goal, GoalState.REJECTED, "more orders than one client may give")
            return
        self._newest = goal
        self._tell_status()
        if before is not None:
            self._cancel(before, "a newer goal came")
        work = self._run(goal, None if before is None else before.task)
        goal.task = self._agent.background.spawn(work, f"{self._name} for {client.name}")
        goal.task.add_done_callback(partial(self._over, goal))

    async def _run(self, goal: _Goal, before: asyncio.Task[None] | None) -> None:
        PRESSED_AT.set(goal.asked_at)
        try:
            if before is not None:
                await asyncio.wait({before})  # its hover goes out first
            goal.state = GoalState.ACTIVE
            self._tell_status()
            await self._work(
                goal.client, goal.value, lambda **values: self._tell(goal, "feedback", **values)
            )
        except M100Error as error:
            self._end(goal, GoalState.ABORTED, str(error))
            goal.client.status("error", f"{self._name}: {error}")
        except asyncio.CancelledError:
            # With the lease it was this client's flight that was under way, or a pause in it.
            if lease := self._clients.session(goal.client).lease:
                self._agent.hover(f"{goal.client.name}: {goal.why or 'the station ends'}", lease)
            raise
        else:
            self._end(goal, GoalState.SUCCEEDED)

    def _over(self, goal: _Goal, _: object) -> None:
        if goal.ended_at is None:  # it may have been cancelled before it began
            self._end(goal, GoalState.PREEMPTED, goal.why)

    def _on_cancel(self, client: GraphListener, message: Message, now: float) -> None:
        """A goal by its id; all of them without id and stamp; those before a stamp alone."""
        meant = []
        for goal in self._goals:
            stamp, until = (_seconds(one["stamp"]) for one in (goal.identity, message))
            is_named = goal.identity["id"] == message["id"]
            if is_named or (not message["id"] and (not until or stamp <= until)):
                meant.append(goal)
        self.cancel(meant, "it was cancelled", client)

    def cancel_all(self, why: str, client: GraphListener | None = None) -> None:
        self.cancel(self._goals, why, client)

    def cancel(self, goals: Iterable[_Goal], why: str, client: GraphListener | None = None) -> None:
        """Cancel goals; the client hears if none of them had an end to come."""
        cancelled = [self._cancel(goal, why) for goal in goals]
        if client is not None and not any(cancelled):
            client.status("warning", f"{self._name}: no such goal is active, nothing was cancelled")

    def _left(self, client: GraphListener, now: float) -> None:
        for goal in self._goals:
            if goal.client is client:
                self._cancel(goal, "its client has gone")

    def _cancel(self, goal: _Goal, why: str) -> bool:
        """Returns whether it had not ended."""
        is_under_way = goal.task is not None and not goal.task.done()
        if goal.task is not None and is_under_way:
            goal.why = goal.why or why
            goal.task.cancel()
        return is_under_way


def _seconds(stamp: Message) -> float:
    return float(stamp["secs"] + stamp["nsecs"] * 1e-9)
