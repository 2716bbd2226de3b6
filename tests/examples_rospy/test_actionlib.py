"""Clients of action servers, against the station's own server without a socket."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from rospy_stand_in import actionlib, node
from rospy_stand_in.actionlib import GoalStateNames as GoalStatus
from rospy_stand_in.actionlib import SimpleActionClient, SimpleGoalState
from rospy_stand_in.genpy import RosDuration as Duration
from rospy_stand_in.genpy import RosTime as Time
from rospy_stand_in.genpy import message_class

from m100link.apps.station.ros.messages import Message

ACTION = message_class("dji_sdk/LocalPositionNavigationAction")
GOAL: Any = message_class("dji_sdk/LocalPositionNavigationGoal")
NAME = "/dji_sdk/local_position_navigation_action"


class Played:
    """A bridge to a station that a test plays: callbacks run where it publishes."""

    topics: dict[str, str] = {}  # noqa: RUF012 - nobody changes it

    def __init__(self) -> None:
        self.sent: list[tuple[str, Message]] = []
        self._callbacks: dict[str, Callable[[Message], None]] = {}

    def is_of_station(self, name: str) -> bool:
        return True

    def advertise(self, name: str, kind: str) -> None:
        pass

    def subscribe(self, name: str, kind: str, callback: Callable[[Message], None]) -> None:
        self._callbacks[name.removeprefix(f"{NAME}/")] = callback

    def publish(self, name: str, message: Message, *, latch: bool = False) -> None:
        self.sent.append((name.removeprefix(f"{NAME}/"), message))

    def tell(self, part: str, **message: Any) -> None:
        self._callbacks[part](message)

    def close(self) -> None:
        pass


@pytest.fixture
def played(monkeypatch: pytest.MonkeyPatch) -> Played:
    made, bridge = node._Node(), Played()
    made.bridge = bridge  # type: ignore[assignment]  # as far as it is used here
    made.is_initialised = True
    monkeypatch.setattr(node, "_node", made)
    return bridge


def state(identity: str, number: int, text: str = "") -> Message:
    stamp = {"secs": 0, "nsecs": 0}
    return {"goal_id": {"id": identity, "stamp": stamp}, "status": number, "text": text}


def test_a_goal_is_sent_followed_and_ended(played: Played) -> None:
    client = SimpleActionClient("dji_sdk/local_position_navigation_action", ACTION)
    assert not client.wait_for_server(Duration(0.01))
    played.tell("status", status_list=[])
    assert client.wait_for_server()
    called: list[Any] = []
    client.send_goal(
        GOAL(x=1.0, y=2.0, z=3.0),
        done_cb=lambda state, result: called.append((state, result.result)),
        active_cb=lambda: called.append("active"),
        feedback_cb=lambda feedback: called.append(feedback.x_progress),
    )
    [(part, goal)] = played.sent
    assert (part, goal["goal"]) == ("goal", {"x": 1.0, "y": 2.0, "z": 3.0})
    identity = goal["goal_id"]["id"]
    assert (client.get_state(), client.simple_state) == (
        GoalStatus.PENDING,
        SimpleGoalState.PENDING,
    )
    played.tell("status", status_list=[state("other", 3), state(identity, 1)])
    played.tell("feedback", status=state(identity, 1), feedback={"x_progress": 40})
    played.tell("feedback", status=state("other", 1), feedback={"x_progress": 99})
    assert client.simple_state == SimpleGoalState.ACTIVE
    assert not client.wait_for_result(Duration(0.01))
    played.tell("result", status=state("other", 4), result={"result": False})
    played.tell("result", status=state(identity, 3, "there"), result={"result": True})
    assert client.wait_for_result()
    assert client.get_result().result is True
    assert (client.get_state(), client.get_goal_status_text()) == (GoalStatus.SUCCEEDED, "there")
    assert client.simple_state == SimpleGoalState.DONE
    assert called == ["active", 40, (3, True)]
    assert GoalStatus.to_string(client.get_state()) == "SUCCEEDED"


def test_cancels_name_a_goal_all_of_them_or_a_time(played: Played) -> None:
    client = SimpleActionClient("dji_sdk/local_position_navigation_action", ACTION)
    client.cancel_goal()  # there is none
    assert not client.wait_for_result()
    assert client.send_goal_and_wait(GOAL(), Duration(0.01), Duration(0.01)) == GoalStatus.PENDING
    client.cancel_all_goals()
    client.cancel_goals_at_and_before_time(Time(5, 6))
    client.stop_tracking_goal()
    client.cancel_goal()
    (_, goal), *cancels = played.sent
    none = {"secs": 0, "nsecs": 0}
    assert cancels == [
        ("cancel", {"id": goal["goal_id"]["id"], "stamp": none}),
        ("cancel", {"id": "", "stamp": none}),
        ("cancel", {"id": "", "stamp": {"secs": 5, "nsecs": 6}}),
    ]


def test_a_newer_goal_is_the_one_that_is_followed(played: Played) -> None:
    client = SimpleActionClient("dji_sdk/local_position_navigation_action", ACTION)
    client.send_goal(GOAL(x=1.0))
    client.send_goal(GOAL(x=2.0))
    first, second = (goal["goal_id"]["id"] for _, goal in played.sent)
    assert first != second
    played.tell("result", status=state(first, 2), result={"result": False})
    assert client.get_result() is None
    played.tell("result", status=state(second, 4), result={"result": False})
    assert client.get_state() == GoalStatus.ABORTED


def test_a_shutdown_ends_a_wait(played: Played) -> None:
    client = SimpleActionClient("dji_sdk/local_position_navigation_action", ACTION)
    client.send_goal(GOAL())
    node.signal_shutdown("now")
    assert not client.wait_for_result()
    assert not client.wait_for_server()


@pytest.mark.parametrize("number", range(10))
def test_the_states_have_the_names_and_numbers_of_actionlib(number: int) -> None:
    name = GoalStatus.to_string(number)
    assert getattr(GoalStatus, name) == number
    kind: Any = message_class("actionlib_msgs/GoalStatus")
    assert getattr(kind, name) == number
    assert SimpleGoalState.to_string(2) == "DONE"
    assert actionlib.GoalStateNames.to_string(99) == "UNKNOWN_STATE_99"
