"""The module ``actionlib`` of a program: clients of action servers."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from itertools import count
from typing import Any

from rospy_stand_in import node
from rospy_stand_in.genpy import RosMessage, RosTime, message_class

_STEP_S = 0.02
_NUMBERS = count(1)


class GoalStateNames:
    """Constants of actionlib_msgs/GoalStateNames."""

    (PENDING, ACTIVE, PREEMPTED, SUCCEEDED, ABORTED, REJECTED, PREEMPTING, RECALLING, RECALLED,
     LOST) = range(10)  # fmt: skip

    @staticmethod
    def to_string(status: int) -> str:
        return _NAMES[status] if 0 <= status < len(_NAMES) else f"UNKNOWN_STATE_{status}"


_NAMES = (
    *("PENDING", "ACTIVE", "PREEMPTED", "SUCCEEDED", "ABORTED", "REJECTED", "PREEMPTING"),
    *("RECALLING", "RECALLED", "LOST"),
)


class SimpleGoalState:
    PENDING, ACTIVE, DONE = range(3)

    @staticmethod
    def to_string(state: int) -> str:
        return ("PENDING", "ACTIVE", "DONE")[state]


class SimpleActionClient:
    """One goal at a time: a newer goal is another one's end."""

    def __init__(self, ns: str, action: type[RosMessage]) -> None:
        self.action_client = self
        name, kind = node.resolve_name(ns), action._type.removesuffix("Action")
        self.ns = name
        self._goal_class = message_class(f"{kind}ActionGoal")
        self._goals = node.Publisher(f"{name}/goal", self._goal_class, queue_size=10)
        identity = message_class("actionlib_msgs/GoalID")
        self._cancels = node.Publisher(f"{name}/cancel", identity, queue_size=10)
        status = message_class("actionlib_msgs/GoalStatusArray")
        self._heard = threading.Event()
        self._over = threading.Condition()
        self._identity: Any = None
        self._state, self._text, self._result = GoalStateNames.LOST, "", None
        self._is_done = True
        self._callbacks: dict[str, Callable[..., Any] | None] = {}
        node.Subscriber(f"{name}/status", status, self._on_status)
        feedback, result = (message_class(f"{kind}Action{one}") for one in ("Feedback", "Result"))
        node.Subscriber(f"{name}/feedback", feedback, self._on_feedback)
        node.Subscriber(f"{name}/result", result, self._on_result)

    # -- what comes in ---------------------------------------------------------------------------

    def _is_ours(self, status: Any) -> bool:
        return self._identity is not None and status.goal_id.id == self._identity.id

    def _on_status(self, array: Any) -> None:
        self._heard.set()
        for status in array.status_list:
            if not self._is_ours(status) or self._is_done:
                continue
            pending = GoalStateNames.PENDING
            is_begun = self._state == pending and status.status != pending
            if status.status in (pending, GoalStateNames.ACTIVE):
                self._state, self._text = status.status, status.text
            if is_begun:
                self._call("active")

    def _on_feedback(self, message: Any) -> None:
        if self._is_ours(message.status) and not self._is_done:
            self._call("feedback", message.feedback)

    def _on_result(self, message: Any) -> None:
        if not self._is_ours(message.status):
            return
        with self._over:
            self._state, self._text = message.status.status, message.status.text
            self._result, self._is_done = message.result, True
            self._over.notify_all()
        node.note_goal(self.ns, is_under_way=False)
        self._call("done", self._state, self._result)

    def _call(self, name: str, *values: Any) -> None:
        callback = self._callbacks.get(name)
        if callback is not None:
            callback(*values)

    # -- what is asked ---------------------------------------------------------------------------

    def wait_for_server(self, timeout: Any = None) -> bool:
        ends_at = _end(timeout)
        while not self._heard.is_set():
            if node.is_shutdown() or time.monotonic() >= ends_at:
                return False
            self._heard.wait(_STEP_S)
        return True

    def send_goal(
        self,
        goal: Any,
        done_cb: Callable[..., Any] | None = None,
        active_cb: Callable[..., Any] | None = None,
        feedback_cb: Callable[..., Any] | None = None,
    ) -> None:
        self._callbacks = {"done": done_cb, "active": active_cb, "feedback": feedback_cb}
        now = RosTime.now()
        identity: Any = message_class("actionlib_msgs/GoalID")()
        identity.stamp, identity.id = now, f"{node.get_name()}-{next(_NUMBERS)}-{now.to_sec():.9f}"
        message: Any = self._goal_class()
        message.header.stamp, message.goal_id, message.goal = now, identity, goal
        with self._over:
            self._identity, self._result, self._is_done = identity, None, False
            self._state, self._text = GoalStateNames.PENDING, ""
        self._goals.publish(message)
        node.note_goal(self.ns, is_under_way=True)

    def send_goal_and_wait(
        self, goal: Any, execute_timeout: Any = None, preempt_timeout: Any = None
    ) -> int:
        self.send_goal(goal)
        if not self.wait_for_result(_or_none(execute_timeout)):
            self.cancel_goal()
            self.wait_for_result(_or_none(preempt_timeout))
        return self.get_state()

    def wait_for_result(self, timeout: Any = None) -> bool:
        if self._identity is None:
            node.logerr("called wait_for_result when no goal exists")
            return False
        ends_at = _end(timeout)
        with self._over:
            while not self._is_done:
                if node.is_shutdown() or time.monotonic() >= ends_at:
                    return False
                self._over.wait(_STEP_S)
        return True

    def get_result(self) -> Any:
        return self._result

    def get_state(self) -> int:
        """The state of the goal, a number of GoalStateNames."""
        return self._state

    def get_goal_status_text(self) -> str:
        return self._text

    @property
    def simple_state(self) -> int:
        if self._is_done:
            return SimpleGoalState.DONE
        return int(self._state == GoalStateNames.ACTIVE)

    def cancel_goal(self) -> None:
        if self._identity is not None:
            self._cancels.publish(id=self._identity.id)

    def cancel_all_goals(self) -> None:
        self._cancels.publish()

    def cancel_goals_at_and_before_time(self, at: Any) -> None:
        self._cancels.publish(stamp=at)

    def stop_tracking_goal(self) -> None:
        self._identity = None


def _or_none(timeout: Any) -> Any:
    """A time of zero means without end."""
    return (
        timeout
        if timeout is not None and (timeout.to_sec() if hasattr(timeout, "to_sec") else timeout)
        else None
    )


def _end(timeout: Any) -> float:
    wanted = _or_none(timeout)
    if wanted is None:
        return float("inf")
    return time.monotonic() + float(wanted.to_sec() if hasattr(wanted, "to_sec") else wanted)
