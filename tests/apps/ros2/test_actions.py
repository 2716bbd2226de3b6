"""Actions by their services and topics, as rclpy calls them."""

from __future__ import annotations

import math
from collections import OrderedDict
from random import Random
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import AsyncMock, MagicMock, call

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.messages import Event, EventTopic
from m100link.apps.agent.transports import memory_channels
from m100link.apps.bus.network import TokenChange
from m100link.apps.ros2.actions import (
    FLIGHTS,
    Actions,
    GoalStatus,
    _before,
    _Goal,
    _order,
    _wait,
)
from m100link.apps.ros2.graph import EntityKind, Names, NodeName, Qos, Seen, data_key
from m100link.errors import UsageError
from m100link.geodesy import LocalFrame
from m100link.log.cdr import ACTIONS, decode
from tests.apps.agent.conftest import has_begun, hears_late, task_of
from tests.apps.ros2.conftest import Program, Rig

pytestmark = pytest.mark.anyio


class Client(Program):
    """A program with clients of actions, whose tokens are in the graph."""

    def __init__(self, rig: Rig, number: int = 5) -> None:
        super().__init__(rig, number)
        node = NodeName(0, f"5e55{number:02d}", "/", f"program{number}")
        self.tokens = [
            node.token_of(
                place,
                EntityKind.CLIENT,
                self.inner(name, "send_goal"),
                f"{FLIGHTS[name][0]}_SendGoal",
                Qos(),
            )
            for place, name in enumerate(FLIGHTS)
        ]
        for token in self.tokens:
            rig.bus.changed.waiting.append(TokenChange(token, True))
        self.count = 0
        self.last = b""

    def leave(self) -> None:
        """As after kill -9."""
        for token in self.tokens:
            self.rig.bus.changed.waiting.append(TokenChange(token, False))

    def inner(self, name: str, part: str) -> str:
        return f"{self.rig.names.full(name)}/_action/{part}"

    async def send(self, name: str, **goal: Any) -> bytes | None:
        """Send a goal; its id when it was accepted."""
        answer = await self.ask_goal(name, **goal)
        return self.last if answer["accepted"] else None

    async def ask_goal(self, name: str, **goal: Any) -> dict[str, Any]:
        """Send a goal, and be content without an answer."""
        self.count += 1
        self.last = bytes([self.gid[0], self.count]) + bytes(14)
        return await self.call(
            self.inner(name, "send_goal"),
            f"{FLIGHTS[name][0]}_SendGoal",
            goal_id={"uuid": list(self.last)},
            goal=goal,
        )

    async def result(self, name: str, identity: bytes) -> tuple[GoalStatus, str]:
        answer = await self.call(
            self.inner(name, "get_result"),
            f"{FLIGHTS[name][0]}_GetResult",
            goal_id={"uuid": list(identity)},
        )
        status = GoalStatus(answer["status"])
        assert answer["result"]["success"] is (status is GoalStatus.SUCCEEDED)
        return status, answer["result"]["message"]

    async def cancel(self, name: str, identity: bytes = bytes(16), sec: int = 0) -> tuple[int, int]:
        """Return code, and how many goals are cancelled."""
        answer = await self.ask_cancel(name, identity, sec)
        return answer["return_code"], len(answer["goals_canceling"])

    async def ask_cancel(
        self, name: str, identity: bytes = bytes(16), sec: int = 0
    ) -> dict[str, Any]:
        """Cancel, and be content without an answer."""
        info = {"goal_id": {"uuid": list(identity)}, "stamp": {"sec": sec, "nanosec": 0}}
        kind = "action_msgs/srv/CancelGoal"
        return await self.call(self.inner(name, "cancel_goal"), kind, goal_info=info)

    def heard(self, name: str, part: str, kind: str) -> list[dict[str, Any]]:
        outlet = self.rig.bus.outlets[data_key(0, self.inner(name, part), kind)]
        return [decode(kind, payload) for payload, _ in outlet.sent]

    def place(self, north: float, east: float) -> dict[str, float]:
        settings = self.rig.aircraft.vehicle.settings
        frame = LocalFrame(settings.latitude_deg, settings.longitude_deg)
        latitude, longitude = frame.to_geodetic(north, east)
        return {"latitude": latitude, "longitude": longitude}


@pytest.fixture
def client(rig: Rig) -> Client:
    return Client(rig)


def test_each_flight_is_an_action_of_the_package() -> None:
    assert {kind for kind, _, _ in FLIGHTS.values()} == ACTIONS.keys()


async def test_a_take_off_to_a_height(rig: Rig, client: Client) -> None:
    await client.call("~/obtain_control")
    goal = await client.send("~/take_off", height=6.0)
    assert goal is not None
    assert await client.result("~/take_off", goal) == (GoalStatus.SUCCEEDED, "done")
    assert rig.height == pytest.approx(6.0, abs=0.5)
    told = client.heard("~/take_off", "feedback", "m100_msgs/action/TakeOff_FeedbackMessage")
    assert bytes(told[-1]["goal_id"]["uuid"]) == goal
    assert told[-1]["feedback"]["height"] > 3.0
    states = [
        one["status_list"][0]["status"]
        for one in client.heard("~/take_off", "status", "action_msgs/GoalStatusArray")
    ]
    assert states == [GoalStatus.EXECUTING, GoalStatus.SUCCEEDED]
    assert "~/take_off for /program5" in rig.texts


async def test_a_flight_to_a_place(rig: Rig, client: Client) -> None:
    await client.up()
    place = client.place(20.0, 5.0)
    goal = await client.send("~/fly_to", **place, height=4.0, speed=4.0)
    assert goal is not None
    await anyio.sleep(2.0)
    client.speed(-2.0)  # setpoints of a program do not push it aside
    assert (await client.result("~/fly_to", goal))[0] is GoalStatus.SUCCEEDED
    fix = rig.said("~/fix")[-1]
    assert fix["latitude"] == pytest.approx(place["latitude"], abs=1e-5)
    assert fix["longitude"] == pytest.approx(place["longitude"], abs=1e-5)
    told = client.heard("~/fly_to", "feedback", "m100_msgs/action/FlyTo_FeedbackMessage")
    left = [one["feedback"]["distance"] for one in told]
    assert left[-1] < left[1]
    assert "~/cmd_vel: ~/fly_to flies: cancel it first" in rig.texts


async def test_a_mission_from_place_to_place(rig: Rig, client: Client) -> None:
    await client.up()
    legs = [(5.0, 0.0), (5.0, 5.0), (0.0, 5.0)]
    waypoints = [{**client.place(*one), "height": 3.0, "wait": 1.0} for one in legs]
    goal = await client.send("~/fly_mission", waypoints=waypoints, speed=0.0)
    assert goal is not None
    assert (await client.result("~/fly_mission", goal))[0] is GoalStatus.SUCCEEDED
    told = client.heard("~/fly_mission", "feedback", "m100_msgs/action/FlyMission_FeedbackMessage")
    places = [one["feedback"]["waypoint"] for one in told]
    assert sorted(set(places)) == [0, 1, 2]
    assert places == sorted(places)


@pytest.mark.parametrize("by", ["id", "all", "time"])
async def test_cancelled_in_flight_means_hover(rig: Rig, client: Client, by: str) -> None:
    await client.up()
    goal = await client.send("~/fly_to", **client.place(60.0, 0.0), height=4.0, speed=6.0)
    assert goal is not None
    await rig.until(lambda: rig.speed > 3.0)
    asked = {
        "id": {"identity": goal},
        "all": {},
        "time": {"sec": 2_000_000_000},
    }[by]
    assert await client.cancel("~/fly_to", **asked) == (0, 1)  # type: ignore[arg-type]  # mixed
    status, why = await client.result("~/fly_to", goal)
    assert (status, why) == (GoalStatus.CANCELED, "the goal was cancelled")
    await anyio.sleep(2.0)
    assert rig.speed < 0.3
    assert await client.cancel("~/fly_to", goal) == (3, 0)
    assert await client.cancel("~/fly_to", bytes([9] * 16)) == (2, 0)
    # The next one may fly.
    assert await client.send("~/fly_to", **client.place(5.0, 0.0), height=4.0, speed=0.0)


async def test_a_take_off_that_is_cancelled_ends_in_a_hover(rig: Rig, client: Client) -> None:
    await client.call("~/obtain_control")
    goal = await client.send("~/take_off", height=20.0)
    assert goal is not None
    await anyio.sleep(1.0)
    assert await client.cancel("~/take_off", goal) == (0, 1)
    assert (await client.result("~/take_off", goal))[0] is GoalStatus.CANCELED
    await anyio.sleep(5.0)
    assert 0.5 < rig.height < 2.0


async def test_when_the_client_of_a_goal_is_killed_it_hovers(rig: Rig, client: Client) -> None:
    await client.up()
    goal = await client.send("~/fly_to", **client.place(60.0, 0.0), height=4.0, speed=6.0)
    assert goal is not None
    await rig.until(lambda: rig.speed > 3.0)
    client.leave()
    status, why = await client.result("~/fly_to", goal)
    assert (status, why) == (GoalStatus.CANCELED, "the client of the goal has gone")
    await anyio.sleep(2.0)
    assert rig.speed < 0.3


async def test_when_the_client_of_a_goal_stands_still_it_hovers(rig: Rig, client: Client) -> None:
    rig.bus.answering = {"5e5505"}
    await client.up()
    goal = await client.send("~/fly_to", **client.place(60.0, 0.0), height=4.0, speed=6.0)
    assert goal is not None
    await rig.until(lambda: rig.speed > 3.0)
    rig.bus.answering = set()  # as after kill -STOP: its tokens stay
    began = rig.client.now
    status, why = await client.result("~/fly_to", goal)
    assert (status, why) == (GoalStatus.CANCELED, "the client of the goal does not answer any more")
    assert rig.client.now - began < 2.0
    await anyio.sleep(2.0)
    assert rig.speed < 0.3


async def test_one_goal_flies_at_a_time(rig: Rig, client: Client) -> None:
    await client.up()
    assert await client.send("~/fly_to", **client.place(60.0, 0.0), height=4.0, speed=3.0)
    other = Client(rig, 6)
    assert await other.send("~/fly_to", **client.place(-60.0, 0.0), height=4.0, speed=3.0) is None
    assert await other.send("~/take_off", height=9.0) is None
    assert "~/fly_to flies" in (await other.call("~/takeoff"))["message"]
    # A way to the ground is anybody's.
    assert (await other.call("~/land"))["success"]
    await rig.until(lambda: not rig.motors_on)
    assert rig.node.control.goal == ""


async def test_the_pilot_ends_a_goal(rig: Rig, client: Client) -> None:
    await client.up()
    goal = await client.send("~/fly_to", **client.place(60.0, 0.0), height=4.0, speed=3.0)
    assert goal is not None
    await anyio.sleep(2.0)
    rig.aircraft.vehicle.remote.set_mode("P")
    assert (await client.result("~/fly_to", goal))[0] is GoalStatus.ABORTED
    assert rig.node.control.goal == ""


@pytest.mark.parametrize(
    ("name", "goal"),
    [
        ("~/take_off", {"height": math.nan}),
        ("~/take_off", {"height": -3.0}),
        ("~/fly_to", {"latitude": 0.0, "longitude": 0.0, "height": -3.0, "speed": 1.0}),
        ("~/fly_to", {"latitude": 120.0, "longitude": 0.0, "height": 5.0, "speed": 1.0}),
        ("~/fly_to", {"latitude": math.inf, "longitude": 0.0, "height": 5.0, "speed": 1.0}),
        ("~/fly_to", {"latitude": 0.0, "longitude": 0.0, "height": 5.0, "speed": 99.0}),
        ("~/fly_mission", {"waypoints": [], "speed": 1.0}),
        (
            "~/fly_mission",
            {
                "waypoints": [{"latitude": 0, "longitude": 0, "height": 5, "wait": -1}],
                "speed": 1.0,
            },
        ),
    ],
)
async def test_a_goal_that_cannot_be_is_rejected(
    rig: Rig, client: Client, name: str, goal: dict[str, Any]
) -> None:
    await client.call("~/obtain_control")
    assert await client.send(name, **goal) is None
    assert f"{name}: " in rig.texts
    assert not rig.motors_on


async def test_without_control_no_goal_flies(rig: Rig, client: Client) -> None:
    assert await client.send("~/take_off", height=5.0) is None
    assert "~/take_off: ROS has no control" in rig.texts


async def test_a_place_outside_the_envelope_is_refused(rig: Rig, client: Client) -> None:
    await client.up()
    goal = await client.send("~/fly_to", **client.place(5000.0, 0.0), height=4.0, speed=3.0)
    assert goal is not None
    status, why = await client.result("~/fly_to", goal)
    assert status is GoalStatus.ABORTED
    assert "what to do" in why
    assert rig.speed < 0.3


IMPOSSIBLE = {
    "height": (math.nan, math.inf, -math.inf, -1.0, 50.1, 1e9, 3e38),
    "latitude": (math.nan, math.inf, -89.5, 1e9, 1e300),
    "longitude": (math.nan, -math.inf, 180.5, 1e9, 1e300),
    "speed": (math.nan, math.inf, -1.0, 10.1, 1e9),
    "wait": (math.nan, math.inf, -1.0, 601.0, 1e9),
}
"""Numbers that no goal flies, by the field: none, of nowhere, or outside the default envelope."""


@pytest.mark.parametrize("seed", range(2))
async def test_a_goal_with_a_number_that_cannot_be_flown_moves_nothing(
    rig: Rig, client: Client, seed: int
) -> None:
    """Nor does what precedes it: a take-off, or the legs before the wrong one."""
    draw = Random(seed)
    assert (await client.call("~/obtain_control"))["success"]

    async def refuse(name: str, **goal: Any) -> None:
        sent = await client.send(name, **goal)
        if sent is not None:  # else it is in the log
            status, why = await client.result(name, sent)
            assert (status, "what to do" in why) == (GoalStatus.ABORTED, True), (seed, goal)

    for height in IMPOSSIBLE["height"]:
        await refuse("~/take_off", height=height)
        assert not rig.motors_on, (seed, height)
    assert (await client.call("~/takeoff"))["success"]
    await rig.until(lambda: rig.height > 1.0 and not rig.client.state.task)
    await rig.until(lambda: rig.speed < 0.05)
    places = [client.place(20.0, 10.0 * n) | {"height": 4.0, "wait": 0.0} for n in range(3)]
    far = client.place(5000.0, 0.0)
    for _ in range(30):
        field = draw.choice([*IMPOSSIBLE])
        wrong = {field: draw.choice(IMPOSSIBLE[field])} if draw.random() < 0.9 else far
        legs, speed = list(places), wrong.pop("speed", 3.0)
        legs[draw.randrange(3)] = legs[0] | wrong
        if draw.random() < 0.5:
            await refuse("~/fly_mission", waypoints=legs, speed=speed)
        elif "wait" not in wrong:
            await refuse("~/fly_to", **places[0] | wrong, speed=speed)
        assert abs(rig.height - 1.2) < 0.2, (seed, wrong)
        assert rig.speed < 0.05, (seed, wrong)


async def test_a_goal_that_nobody_knows(rig: Rig, client: Client) -> None:
    status, why = await client.result("~/fly_to", bytes([4] * 16))
    assert status is GoalStatus.UNKNOWN
    assert "no such goal" in why


@pytest.mark.parametrize("late", [0.05, 0.3])
async def test_a_stop_that_the_node_did_not_hear_ends_the_legs_to_come(
    rig: Rig, client: Client, late: float
) -> None:
    hears_late(rig.channels[1], late)
    assert (await client.call("~/obtain_control"))["success"]
    assert await client.send("~/take_off", height=20.0)
    await rig.until(lambda: task_of(rig.agent) is not None)
    await rig.until(lambda: task_of(rig.agent) is None)
    await anyio.sleep(late / 2)
    await rig.agent.stop()
    await anyio.sleep(6.0)
    assert rig.height < 2.0
    assert not has_begun(rig.agent, "change of height")


@pytest.mark.parametrize("at", ["wait", "flight", "take-off"])
@pytest.mark.parametrize("how", ["halt", "stop"])
async def test_a_halt_or_a_stop_of_another_front_ends_the_goal(
    rig: Rig, client: Client, how: str, at: str
) -> None:
    """The legs to come do not begin, neither now nor after the wait at a place."""
    ours, its = memory_channels()
    rig.service.attach(its)
    async with AgentClient(ours, "another front") as other:
        if at == "take-off":
            name = "~/take_off"
            await client.call("~/obtain_control")
            goal = await client.send(name, height=20.0)
            await rig.until(lambda: rig.motors_on)
        else:
            name = "~/fly_mission"
            await client.up()
            legs = [(6.0, 0.0), (30.0, 0.0)] if at == "wait" else [(30.0, 0.0), (0.0, 0.0)]
            points = [{**client.place(*leg), "height": 3.0, "wait": 3.0} for leg in legs]
            goal = await client.send(name, waypoints=points, speed=4.0)
            await rig.until(lambda: rig.speed > 2.0)
            if at == "wait":
                await rig.until(lambda: rig.client.state.guided is None)
        assert goal is not None
        if how == "halt":
            other.hover("a person wants it to hover")
        else:
            await other.stop()
        status, why = await client.result(name, goal)
        assert (status, rig.node.control.goal) == (GoalStatus.CANCELED, "")
        assert why == ("a person wants it to hover" if how == "halt" else "stop")
        await anyio.sleep(5.0)
        assert rig.speed < 0.3
        assert not has_begun(rig.agent, "change of height")
        assert sum(one.text == "flight to a place begins" for one in rig.agent.journal.events) < 2


# -- values: what a goal may say, and which of two times comes first -------------------------------

PLACE = {"latitude": -33.5, "longitude": 151.75, "height": 17.5}


@pytest.mark.parametrize(
    ("changed", "speed", "is_one"),
    [
        ({}, 3.5, True),
        ({"latitude": 89.0, "longitude": 180.0}, 10.0, True),
        ({"latitude": -89.0, "longitude": -180.0}, 0.0, True),
        ({"latitude": 89.1}, 3.5, False),
        ({"latitude": -89.1}, 3.5, False),
        ({"longitude": 180.1}, 3.5, False),
        ({"longitude": -180.1}, 3.5, False),
        ({}, 10.1, False),
        ({}, -0.1, False),
        ({}, math.inf, False),
        ({"latitude": math.nan}, 3.5, False),
        ({"longitude": math.inf}, 3.5, False),
        ({"height": math.nan}, 3.5, False),
    ],
)
def test_which_places_are_flown_to(changed: dict[str, float], speed: float, is_one: bool) -> None:
    given = PLACE | changed
    if not is_one:
        with pytest.raises(UsageError):
            _order(given, speed)
        return
    order = _order(given, speed)
    found = (order.latitude_deg, order.longitude_deg, order.height, order.speed, order.yaw_deg)
    assert found == (given["latitude"], given["longitude"], 17.5, speed or 5.0, None)


@pytest.mark.parametrize(
    ("seconds", "is_one"),
    [(0.0, True), (600.0, True), (600.1, False), (-0.1, False), (math.nan, False)],
)
def test_a_wait_is_ten_minutes_at_most(seconds: float, is_one: bool) -> None:
    if is_one:
        assert _wait(seconds) == seconds
    else:
        with pytest.raises(UsageError):
            _wait(seconds)


@pytest.mark.parametrize(
    ("one", "other", "is_before"),
    [
        ((5, 10), (5, 10), True),  # at it counts as before it: CancelGoal says "at or before"
        ((5, 10), (5, 11), True),
        ((5, 11), (5, 10), False),
        ((4, 99), (5, 0), True),
        ((5, 0), (4, 99), False),
    ],
)
def test_which_of_two_times_is_before(
    one: tuple[int, int], other: tuple[int, int], is_before: bool
) -> None:
    first, second = (dict(zip(("sec", "nanosec"), time, strict=True)) for time in (one, other))
    assert _before(first, second) is is_before


def test_states_and_codes_are_those_of_action_msgs() -> None:
    assert [(one.name, one.value) for one in GoalStatus] == [
        ("UNKNOWN", 0),
        ("ACCEPTED", 1),
        ("EXECUTING", 2),
        ("CANCELING", 3),
        ("SUCCEEDED", 4),
        ("CANCELED", 5),
        ("ABORTED", 6),
    ]
    assert [one.value for one in GoalStatus if one.is_over] == [4, 5, 6]


class Flown:
    """The actions of a node, and one goal that flies."""

    def __init__(self) -> None:
        self.said: dict[str, list[dict[str, Any]]] = {"feedback": [], "status": []}
        self.ended: list[str] = []
        self.is_missing = self.is_silent = False

        def topic(name: str) -> Any:
            return SimpleNamespace(say=self.said[name].append)

        self.flight = cast(
            Any,
            SimpleNamespace(is_ours=True, end=self.ended.append, feedback=lambda: {"height": 12.5}),
        )
        self.action = cast(
            Any,
            SimpleNamespace(name="~/fly_to", feedback=topic("feedback"), status=topic("status")),
        )
        stamp = {"sec": 50, "nanosec": 7}
        self.goal = _Goal(ID, self.action, stamp, self.flight, {}, GoalStatus.EXECUTING)
        self.actions = cast(Any, object.__new__(Actions))
        self.actions._agent = SimpleNamespace(now=20.0)
        self.actions._presence = SimpleNamespace(missing=lambda _clients: self.is_missing)
        self.actions._heartbeat = SimpleNamespace(is_missing=lambda _now: self.is_silent)
        self.actions._goals, self.actions._current = OrderedDict({ID: self.goal}), self.goal
        self.actions._feedback_at = 20.0


ID = bytes(range(16))


@pytest.mark.parametrize(
    ("identity", "stamp", "code", "is_ended"),
    [
        (ID, (0, 0), 0, True),
        (bytes(16), (0, 0), 0, True),  # all of this action
        (bytes(16), (50, 7), 0, True),
        (bytes(16), (50, 6), 0, False),  # accepted after that time: it flies on
        (ID, (50, 6), 0, True),  # by its id, whenever it was accepted
        (bytes([9]) * 16, (0, 0), 2, False),  # nobody knows it
        (bytes([8]) * 16, (0, 0), 3, False),  # it has ended
        (bytes([8]) * 16, (50, 7), 0, True),  # and all from before that time
        (bytes([8]) * 16, (50, 6), 3, False),
    ],
)
async def test_which_goals_a_cancel_means(
    identity: bytes, stamp: tuple[int, int], code: int, is_ended: bool
) -> None:
    one = Flown()
    one.actions._goals[bytes([8]) * 16] = one.goal
    time = {"sec": stamp[0], "nanosec": stamp[1]}
    wanted = {"goal_info": {"goal_id": {"uuid": list(identity)}, "stamp": time}}
    answer = await one.actions._canceling(one.action)(wanted)
    assert answer["return_code"] == code
    assert answer["goals_canceling"] == [one.goal.info] * is_ended
    assert one.goal.info["goal_id"] == {"uuid": list(range(16))}
    assert one.goal.info["stamp"] == {"sec": 50, "nanosec": 7}
    assert one.ended == ["the goal was cancelled"] * is_ended
    other: Any = SimpleNamespace(name="~/take_off")
    again = Flown()
    code = 0 if identity == bytes(16) else 2
    answer = await again.actions._canceling(other)(wanted)
    assert (answer["return_code"], again.ended) == (code, []), "it is another action's goal"


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({}, []),
        ({"is_missing": True}, ["the client of the goal has gone"]),
        ({"is_silent": True}, ["the client of the goal does not answer any more"]),
        ({"is_ours": False}, ["control was lost, or given back"]),
    ],
)
def test_whose_goal_ends_and_how_often_it_tells(changed: dict[str, bool], why: list[str]) -> None:
    one = Flown()
    one.is_missing = changed.get("is_missing", False)
    one.is_silent = changed.get("is_silent", False)
    one.flight.is_ours = changed.get("is_ours", True)
    for tick in range(1, 27):  # 1.625 s
        one.actions._agent.now = 20.0 + tick / 16
        one.actions.advance()
    assert one.ended == why
    assert len(one.said["feedback"]) == 3, "every half second"
    assert one.said["feedback"][0] == {
        "goal_id": {"uuid": list(range(16))},
        "feedback": {"height": 12.5},
    }
    assert (one.goal.status is GoalStatus.CANCELING) is bool(why)


@pytest.mark.parametrize(
    ("topic", "is_ended"),
    [
        (EventTopic.STOPPED, True),
        (EventTopic.HALTED, True),
        (EventTopic.MISSION_ABORTED, False),
        (EventTopic.NONE, False),
    ],
)
def test_which_events_end_the_goal(topic: EventTopic, is_ended: bool) -> None:
    one = Flown()
    event = Event(3, 20.0, "info", "somebody wants it to hover", topic)
    one.actions._hear(event)
    one.actions._hear(event)
    assert one.ended == ["somebody wants it to hover"] * is_ended, "once, with the reason"
    statuses = [said["status_list"][0]["status"] for said in one.said["status"]]
    assert statuses == [GoalStatus.CANCELING] * is_ended
    one.actions._current = None
    one.actions._hear(event)  # nothing flies any more


@pytest.mark.parametrize(("is_ours", "hovers"), [(True, [("why", 7)]), (False, [])])
async def test_the_end_of_a_flight_hovers_under_its_own_lease_alone(
    is_ours: bool, hovers: list[tuple[str, int]]
) -> None:
    """Another program that flies by then flies on; nothing more of the goal is ordered."""
    hovered, asked = [], []

    async def ask(order: Any, **_: Any) -> None:
        asked.append(order)

    agent: Any = SimpleNamespace(
        holds=lambda lease: is_ours and lease == 7,
        hover=lambda why, lease: hovered.append((why, lease)),
        ask=ask,
        asked_at=4.0,
    )
    control: Any = SimpleNamespace(session=SimpleNamespace(held=lambda: 7))
    point = PLACE | {"wait": 600.0}
    flight = FLIGHTS["~/fly_mission"][1](agent, control, {"waypoints": [point] * 2, "speed": 1.0})
    flight.end("why")
    assert hovered == hovers
    await flight.run()  # neither a leg nor a wait
    assert asked == []


def test_each_action_has_three_services_and_two_topics() -> None:
    """A state is there for who comes late; a cancel ends something and waits behind nothing."""
    ends, agent = MagicMock(), MagicMock(now=20.0, on_event=[])
    actions = Actions(agent, MagicMock(), ends, NAMES, *NOBODY)
    assert agent.on_event == [actions._hear]
    for name, (kind, _, _) in FLIGHTS.items():
        inner = f"/m100/{name[2:]}/_action"
        published = {one.args[0]: one.args[1:] for one in ends.publish.mock_calls}
        assert published[f"{inner}/feedback"] == (f"{kind}_FeedbackMessage", Qos())
        latched = Qos(is_latched=True, depth=1)
        assert published[f"{inner}/status"] == ("action_msgs/GoalStatusArray", latched)
        served = {one.args[0]: (one.args[1], one.kwargs) for one in ends.serve.mock_calls}
        assert served[f"{inner}/send_goal"] == (f"{kind}_SendGoal", {})
        assert served[f"{inner}/get_result"] == (f"{kind}_GetResult", {"at_once": 32})
        cancel = ("action_msgs/srv/CancelGoal", {"ends": orders.Halt})
        assert served[f"{inner}/cancel_goal"] == cancel


NAMES = Names.of("/", "m100")
NOBODY: Any = [MagicMock() for _ in range(3)]


def test_a_goal_that_begins_is_watched_and_the_newest_goals_are_remembered() -> None:
    one, notes = Flown(), list[tuple[str, ...]]()
    one.actions._agent = MagicMock(note=lambda *told: notes.append(told))
    one.actions._control = control = SimpleNamespace(goal="")
    one.actions._heartbeat, one.actions._fly = heartbeat, fly = MagicMock(), MagicMock()
    clients = {
        "token 1": Seen(("5e55", "0"), "/program5", EntityKind.CLIENT, "topic"),
        "token 2": Seen(("f00d", "3"), "/program6", EntityKind.CLIENT, "topic"),
    }
    one.actions._begin(_Goal(ID, one.action, {}, one.flight, clients))
    assert control.goal == "~/fly_to"
    assert heartbeat.follow.mock_calls == [call(frozenset({"5e55", "f00d"}))]
    one.actions._agent.background.spawn.assert_called_once_with(fly.return_value, "~/fly_to")
    for number in range(40):
        one.actions._begin(_Goal(bytes([number] * 16), one.action, {}, one.flight, {}))
    assert list(one.actions._goals) == [bytes([number] * 16) for number in range(8, 40)]
    unwatched = ("~/fly_to: its node is unknown, and not watched", "warning")
    assert notes[:2] == [("~/fly_to for /program5, /program6",), unwatched]


@pytest.mark.parametrize(("count", "is_one"), [(0, False), (1, True), (500, True), (501, False)])
def test_a_mission_has_500_places_at_most(count: int, is_one: bool) -> None:
    goal = {"waypoints": [PLACE | {"wait": 2.5}] * count, "speed": 3.5}
    make = FLIGHTS["~/fly_mission"][1]
    if not is_one:
        with pytest.raises(UsageError):
            make(MagicMock(), MagicMock(), goal)
        return
    flight: Any = make(MagicMock(), MagicMock(), goal)
    assert len(flight.legs) == len(flight._waits) == count
    flight._place, flight._agent.state.guided = 7, SimpleNamespace(distance_m=12.5, seconds=3.25)
    assert flight.feedback() == {"waypoint": 7, "distance": 12.5, "seconds": 3.25}


@pytest.mark.parametrize(
    ("wanted", "here", "climbs"),
    [
        (0.0, 1.2, False),  # no height was asked for
        (1.4, 1.2, False),
        (1.5, 1.2, True),
        (0.9, 1.2, True),
        (1.0, 1.2, False),
        (6.0, 1.2, True),
    ],
)
async def test_a_climb_of_less_than_thirty_centimetres_is_not_asked_for(
    wanted: float, here: float, climbs: bool
) -> None:
    agent: Any = MagicMock(ask=AsyncMock(), asked_at=4.0)
    agent.view.get.return_value = SimpleNamespace(
        height_m=here - math.copysign(1e-9, wanted - here)
    )
    flight = FLIGHTS["~/take_off"][1](agent, MagicMock(), {"height": wanted})
    await flight.run()
    under = {"lease": cast(Any, flight)._lease, "asked_at": 4.0}
    asked = [call(orders.TakeOff(), **under), call(orders.ChangeHeight(wanted), **under)]
    assert agent.ask.mock_calls == asked[: 1 + climbs]
    agent.view.get.return_value = None
    assert math.isnan(flight.feedback()["height"])
