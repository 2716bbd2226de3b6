"""Control by ROS programs: who has the stick, what a setpoint says, and orders that cross."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from types import SimpleNamespace
from typing import Any, cast

import anyio
import pytest

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.control_session import ControlState
from m100link.apps.agent.transports import memory_channels
from m100link.apps.ros2.actions import GoalStatus
from m100link.apps.ros2.control import (
    IDLE_S,
    SILENCE_S,
    TERMS,
    Frames,
    RosControl,
    SetpointMux,
    speed,
    toward,
)
from m100link.errors import BadSetpoint, UsageError
from m100link.protocol.records import FlightPhase, FlightStatus, Velocity
from m100link.protocol.setpoint import Setpoint
from tests.apps.ros2.conftest import Program, Rig
from tests.apps.ros2.test_actions import Client
from tests.known import KnownAgent, quaternion

pytestmark = pytest.mark.anyio

ONE, OTHER = b"1" * 16, b"2" * 16


@pytest.fixture
def stick() -> SetpointMux:
    made = SetpointMux()
    made.begin(0.0)
    return made


def test_a_setpoint_is_as_late_as_the_older_of_its_two_stamps(stick: SetpointMux) -> None:
    """0.3 s above the fastest: by the attachment, the header, or each; a header may have none."""
    assert stick.hear(ONE, 0.0, 0.0, 0, 500.0) == ""
    assert stick.hear(ONE, 0.1, 0.1, 1, 499.81) == ""
    assert stick.hear(ONE, 0.2, 0.2, 2, 499.89) == "late"
    assert stick.hear(ONE, 0.0, 0.31, 3, 500.31) == "late"
    assert stick.hear(ONE, 0.4, 0.4, 4, 0.0) == ""
    assert stick.hear(ONE, 0.5, 0.5, 5, 500.5) == ""


def test_a_program_that_begins_first_has_it(stick: SetpointMux) -> None:
    assert stick.hear(ONE, 0.0, 0.0, 7) == ""  # six before it were not heard
    assert stick.hear(OTHER, 0.1, 0.1) == "other"
    assert stick.hear(ONE, 0.2, 0.2) == ""
    assert stick.refused == {"late": 0, "other": 1, "closed": 0}


def test_a_program_that_was_refused_has_to_be_silent_first(stick: SetpointMux) -> None:
    stick.hear(ONE, 0.0, 0.0)
    for step in range(1, 20):
        assert stick.hear(OTHER, step / 10, step / 10) == "other"
    assert stick.holder is None
    assert stick.hear(OTHER, 2.5, 2.5) == ""


def test_a_program_that_was_silent_begins_anew(stick: SetpointMux) -> None:
    stick.hear(ONE, 0.0, 0.0)
    assert stick.hear(ONE, 5.0, 5.0) == ""


def steer(stick: SetpointMux, begin: float, end: float, number: int = 0) -> int:
    """Send at 20 Hz, 50 ms late; returns the newest number."""
    for step in range(round((end - begin) * 20)):
        number += 1
        at = begin + 0.05 * step
        stick.hear(ONE, at, at + 0.05, number)
    return number


def test_a_program_that_paused_and_begins_anew_flies_whatever_it_counts(stick: SetpointMux) -> None:
    number = steer(stick, 0.0, 2.0)
    assert stick.hear(ONE, 4.0, 4.05, number + 1) == ""
    assert stick.hear(ONE, 6.0, 6.05, number + 1) == ""  # it does not count
    assert stick.hear(ONE, 8.0, 8.05, 1) == ""  # it counts anew


@pytest.mark.parametrize(("made_s", "answer"), [(0.41, ""), (0.39, "other")])
def test_a_pause_may_be_a_tenth_shorter_where_it_is_made(
    stick: SetpointMux, made_s: float, answer: str
) -> None:
    stick.hear(ONE, 0.0, 0.0, 1)
    assert stick.hear(ONE, made_s, 0.55, 2) == answer


def test_a_program_that_was_cut_off_while_it_sent_does_not_fly_on(stick: SetpointMux) -> None:
    number = steer(stick, 0.0, 2.0)
    # What it sent between is lost.
    number = steer(stick, 3.0, 6.0, number + 20)
    assert stick.holder is None
    assert stick.refused["other"] == 60
    assert stick.hear(ONE, 7.0, 7.05, number + 1) == ""  # it paused by itself


def test_what_waited_on_a_way_that_was_cut_begins_nothing(stick: SetpointMux) -> None:
    number = steer(stick, 0.0, 2.0)
    for place in range(20):
        number += 1
        assert stick.hear(ONE, 2.0 + 0.05 * place, 3.05, number) == "other"
    assert steer(stick, 3.0, 4.0, number) == number + 20
    assert stick.holder is None


def test_before_control_nobody_has_it() -> None:
    stick = SetpointMux()
    assert stick.hear(ONE, 0.0, 0.0) == "closed"
    stick.begin(0.1)
    assert stick.holder == ONE  # the only sender while control is obtained


def test_of_two_that_send_nobody_gets_it() -> None:
    stick = SetpointMux()
    stick.hear(ONE, 0.0, 0.0)
    stick.hear(OTHER, 0.0, 0.0)
    stick.begin(0.1)
    assert stick.hear(ONE, 0.2, 0.2) == stick.hear(OTHER, 0.2, 0.2) == "other"
    assert stick.hear(ONE, 1.0, 0.3 + SILENCE_S) == ""


def test_after_the_end_nothing_goes_on(stick: SetpointMux) -> None:
    stick.hear(ONE, 0.0, 0.0)
    stick.end()
    assert stick.hear(ONE, 0.1, 0.1) == "closed"


def test_what_waited_is_late_by_whatever_clock(stick: SetpointMux) -> None:
    assert stick.hear(ONE, 1000.0, 0.0) == ""
    assert stick.hear(ONE, 1000.1, 0.45) == "late"
    assert stick.hear(ONE, 1000.5, 0.5) == ""


def test_a_thousand_senders_are_not_kept(stick: SetpointMux) -> None:
    stick.hear(ONE, 0.0, 0.0)
    for number in range(1000):
        stick.hear(number.to_bytes(16, "little"), 0.0, 0.01)
    assert len(stick._senders) <= 32
    assert stick.hear(ONE, 0.1, 0.1) == ""  # nor do they push anybody out


def test_very_many_who_send_push_nobody_off_the_stick() -> None:
    stick = SetpointMux()
    stick.begin(0.0)
    for step in range(100):
        now = 0.05 * step
        assert stick.hear(b"first", now, now) == ""
        for number in range(20):
            assert stick.hear(b"%d of step %d" % (number, step), now, now) == "other"
    assert stick.holder == b"first"
    # It dies, and they go on: nobody of them had been silent.
    for step in range(100, 200):
        now = 0.05 * step
        for number in range(20):
            assert stick.hear(b"%d of step %d" % (number, step), now, now) == "other"
        assert stick.holder == (b"first" if now < 4.95 + SILENCE_S else None)
    assert stick.hear(b"one who begins", 20.0, 20.0) == ""


def test_of_very_many_who_send_when_control_is_obtained_nobody_has_the_stick() -> None:
    stick = SetpointMux()
    for number in range(40):
        stick.hear(b"%d" % number, 0.0, 0.01 * number)
    stick.begin(0.5)
    assert stick.holder is None


@pytest.mark.parametrize(("at", "holder"), [(0.49, ONE), (0.5, None)])
def test_half_a_second_of_silence_lets_go(
    stick: SetpointMux, at: float, holder: bytes | None
) -> None:
    stick.hear(ONE, 0.0, 0.0)
    stick.look(at)
    assert stick.holder == holder


@pytest.mark.parametrize(("late", "answer"), [(0.3, ""), (0.3125, "late")])
def test_a_setpoint_may_be_0_3_s_later_than_the_fastest(
    stick: SetpointMux, late: float, answer: str
) -> None:
    stick.hear(ONE, 8.0, 0.0)
    assert stick.hear(ONE, 8.0625, 0.0625 + late) == answer


def test_when_control_is_obtained_who_sent_within_half_a_second_and_alone_has_it() -> None:
    for age, other, holder in ((0.49, None, ONE), (0.5, None, None), (0.49, 0.49, None)):
        stick = SetpointMux()
        stick.hear(ONE, 0.0, 0.0)
        if other is not None:
            stick.hear(OTHER, 0.0, 0.0)
        stick.begin(age)
        assert stick.holder == holder


@pytest.mark.parametrize(
    ("is_on_ground", "task", "goal", "is_idle"),
    [
        (True, "", "", True),
        (False, "", "", False),
        (None, "", "", False),  # it may be in the air
        (True, "take off", "", False),
        (True, "", "~/fly_to", False),
    ],
)
def test_control_is_idle_on_the_ground_and_goes_back_after_a_minute(
    is_on_ground: bool | None, task: str, goal: str, is_idle: bool
) -> None:
    control, idle = object.__new__(RosControl), list[bool]()
    view = SimpleNamespace(is_on_ground=is_on_ground)
    agent = SimpleNamespace(now=0.1, view=view, state=SimpleNamespace(task=task))
    control._agent, control.goal, control.mux = cast(Any, agent), goal, SetpointMux()
    heard = lambda *, is_idle: idle.append(is_idle)  # noqa: E731
    control.session = cast(Any, SimpleNamespace(state=ControlState.HOLDING, heard=heard))
    control.advance()
    assert idle == [is_idle]
    assert (TERMS.idle_s, TERMS.gives_way, TERMS.begins_anew) == (60.0, True, False)


@pytest.mark.parametrize(
    ("changed", "refused"),
    [
        ({}, ""),
        ({"has_control": False}, "ROS has no control: call ~/obtain_control"),
        ({"held": ControlState.STOPPED}, "it was stopped: call ~/obtain_control"),
        ({"goal": "~/fly_to"}, "~/fly_to flies: cancel it first"),
        ({"task": "go home"}, "go home flies"),
        ({"mission": "hotpoint"}, "hotpoint flies"),
        ({"mission": "no mission"}, ""),
        ({"task": "land", "mission": "hotpoint"}, "land flies"),
        ({"airborne": False}, "on the ground: call ~/takeoff first"),
        ({"airborne": None}, "on the ground: call ~/takeoff first"),
    ],
)
def test_why_no_setpoint_flies(changed: dict[str, Any], refused: str) -> None:
    given: dict[str, Any] = {
        "has_control": True,
        "held": ControlState.HOLDING,
        "goal": "",
        "airborne": True,
    }
    given |= {"task": "", "mission": ""} | changed
    control = object.__new__(RosControl)
    state = SimpleNamespace(task=given["task"], mission=given["mission"])
    view = SimpleNamespace(is_airborne=given["airborne"])
    control._agent, control.goal = cast(Any, SimpleNamespace(state=state, view=view)), given["goal"]
    session = SimpleNamespace(has_control=given["has_control"], state=given["held"])
    control.session = cast(Any, session)
    assert control.refusal() == refused


# -- speeds and places of ROS, in the words of the aircraft ----------------------------------------


@pytest.mark.parametrize("state", ControlState)
def test_a_stop_ends_the_stick_with_the_control(state: ControlState) -> None:
    """By any client: a program that goes on sending setpoints does not fly on by them."""
    control = object.__new__(RosControl)
    view = SimpleNamespace(is_on_ground=False)
    agent = SimpleNamespace(now=0.1, view=view, state=SimpleNamespace(task=""))
    control._agent, control.goal, control.mux = cast(Any, agent), "", SetpointMux()
    control.session = cast(Any, SimpleNamespace(state=state, heard=lambda *, is_idle: None))
    control.mux.begin(0.0)
    control.mux.hear(ONE, 0.0, 0.0)
    control.advance()
    is_kept = state is ControlState.HOLDING
    assert (control.mux.is_open, control.mux.holder) == (is_kept, ONE if is_kept else None)


def twist(x: float, y: float, z: float, turn: float) -> dict[str, Any]:
    return {
        "linear": {"x": x, "y": y, "z": z},
        "angular": {"x": 0.0, "y": 0.0, "z": turn},
    }


def test_speeds() -> None:
    turn = math.radians(30)
    turned = math.degrees(-turn)
    body = Setpoint.velocity(forward=1.0, right=-2.0, up=3.0, yaw_rate_deg_s=turned)
    assert speed(twist(1.0, 2.0, 3.0, turn), is_body=True) == body
    ground = Setpoint.velocity(north=2.0, east=1.0, up=3.0, yaw_rate_deg_s=turned)
    assert speed(twist(1.0, 2.0, 3.0, turn), is_body=False) == ground


@pytest.mark.parametrize("bad", [math.nan, math.inf, -1e6])
def test_numbers_that_fly_nowhere(bad: float) -> None:
    for place in range(4):
        numbers = [0.0] * 4
        numbers[place] = bad
        with pytest.raises(BadSetpoint):
            speed(twist(*numbers), is_body=True)


def test_frames() -> None:
    frames = Frames(("odom", "map"), ("base_link",))
    assert frames.is_body("", "a speed")
    assert frames.is_body("base_link", "a speed")
    assert not frames.is_body("map", "a speed")
    with pytest.raises(UsageError, match="'camera'") as refusal:
        frames.is_body("camera", "a speed")
    assert refusal.value.remedy == "frames are base_link, map, odom"


def pose(x: float, y: float, z: float, *turned: float) -> dict[str, Any]:
    return {
        "position": {"x": x, "y": y, "z": z},
        "orientation": dict(zip("xyzw", turned or (0.0, 0.0, 0.0, 0.0), strict=True)),
    }


def test_places() -> None:
    found = toward(pose(1.0, 2.0, 3.0), (0.0, 2.0, 2.0), fastest=None)
    assert found == Setpoint.velocity(north=0.0, east=0.8, up=0.8, yaw_rate_deg_s=0.0)
    far = toward(pose(300.0, 400.0, 90.0, 0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0), fastest=2.0)
    assert (far.x, far.y, far.z, far.yaw) == pytest.approx((1.6, 1.2, 2.0, 90.0))


@pytest.mark.parametrize(
    ("place", "fastest", "north", "east", "up"),
    [
        ((12.5, -3.0, 4.75), None, -0.8, 2.0, 0.6),  # 0.8 m/s for each metre
        ((9.0, -2.0, 2.0), None, 0.0, -0.8, -1.6),
        ((10.0, -2.0, 1.0), None, 0.0, 0.0, -2.0),
        ((10.0, -2.0, 99.0), None, 0.0, 0.0, 2.0),
        ((70.0, 78.0, 4.0), None, 4.0, 3.0, 0.0),  # 5 m/s at most
        ((70.0, 78.0, 4.0), 20.0, 4.0, 3.0, 0.0),
        ((70.0, 78.0, 4.0), 2.5, 2.0, 1.5, 0.0),
    ],
)
def test_a_place_leads_there_the_slower_the_nearer(
    place: tuple[float, float, float], fastest: float | None, north: float, east: float, up: float
) -> None:
    """From 10 m east, 2 m south, 4 m up."""
    found = toward(pose(*place), (10.0, -2.0, 4.0), fastest=fastest)
    assert (found.x, found.y, found.z, found.yaw) == pytest.approx((north, east, up, 0.0))


@pytest.mark.parametrize(
    ("yaw", "heading"),
    [(0.0, 90.0), (90.0, 0.0), (130.0, -40.0), (-35.0, 125.0), (-100.0, -170.0), (180.0, -90.0)],
)
@pytest.mark.parametrize("roll", [0.0, 15.0])
@pytest.mark.parametrize("pitch", [0.0, -25.0])
def test_yaw_from_east_to_the_left_is_a_heading_from_north_to_the_right(
    yaw: float, heading: float, roll: float, pitch: float
) -> None:
    w, x, y, z = quaternion(roll, pitch, yaw)
    found = toward(pose(0.0, 0.0, 1.0, x, y, z, w), (0.0, 0.0, 1.0), fastest=None)
    assert found.yaw == pytest.approx(heading)
    again = toward(pose(0.0, 0.0, 1.0, -x, -y, -z, -w), (0.0, 0.0, 1.0), fastest=None)
    assert again.yaw == pytest.approx(heading)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("place", range(7))
def test_places_that_are_nowhere(bad: float, place: int) -> None:
    numbers = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    numbers[place] = bad
    with pytest.raises(BadSetpoint):
        toward(pose(*numbers), (0.0, 0.0, 0.0), fastest=5.0)


@pytest.mark.parametrize(
    "turned", [(0.0, 0.0, 1.0, 1.0), (1e200, 1e200, 1e200, 1e200), (0.0, 0.0, 0.0, 0.5)]
)
def test_what_is_no_rotation_is_no_heading(turned: tuple[float, ...]) -> None:
    with pytest.raises(BadSetpoint, match="no rotation"):
        toward(pose(0.0, 0.0, 1.0, *turned), (0.0, 0.0, 0.0), fastest=5.0)
    # As float32 has it.
    toward(pose(0.0, 0.0, 1.0, 0.0, 0.0, 0.70710677, 0.70710677), (0.0, 0.0, 0.0), fastest=5.0)


# -- orders that cross each other: whatever wins, nothing flies that somebody ended ----------------


@pytest.fixture
def client(rig: Rig) -> Client:
    return Client(rig)


def north(rig: Rig) -> float:
    return float(rig.aircraft.vehicle.flight.dynamics.north)


# -- a goal and its end in one step of the node ---------------------------------------------------


async def test_a_goal_that_is_cancelled_with_it_does_not_fly(rig: Rig, client: Client) -> None:
    await client.call("~/obtain_control")
    goal, cancelled = await asyncio.gather(
        client.send("~/take_off", height=5.0), client.cancel("~/take_off")
    )
    assert goal is not None
    assert cancelled == (0, 1)
    assert (await client.result("~/take_off", goal))[0] is GoalStatus.CANCELED
    await anyio.sleep(5.0)
    assert not rig.motors_on


async def test_a_goal_that_comes_with_a_landing_does_not_fly(rig: Rig, client: Client) -> None:
    await client.up()
    place = client.place(60.0, 0.0)
    goal, landed = await asyncio.gather(
        client.send("~/fly_to", **place, height=4.0, speed=6.0), client.call("~/land")
    )
    assert landed["success"]
    assert goal is None or (await client.result("~/fly_to", goal))[0] is not GoalStatus.SUCCEEDED
    await rig.until(lambda: not rig.motors_on)
    assert abs(north(rig)) < 1.0


# -- a mission that hovers between two legs -------------------------------------------------------


async def _pilot(rig: Rig) -> None:
    rig.aircraft.vehicle.remote.set_mode("P")
    await anyio.sleep(1.0)
    rig.aircraft.vehicle.remote.set_mode("F")
    await anyio.sleep(1.0)


async def _stop(rig: Rig) -> None:
    assert (await Program(rig, 9).call("~/stop"))["success"]


async def _stop_at_the_console(rig: Rig) -> None:
    await rig.agent.stop()


async def _hover_at_the_console(rig: Rig) -> None:
    ours, its = memory_channels()
    rig.service.attach(its)
    async with AgentClient(ours, "the console") as console:
        console.hover("hover, said somebody")
        await anyio.sleep(0.1)


async def _given_back(rig: Rig) -> None:
    assert (await Program(rig, 9).call("~/release_control"))["success"]


@pytest.mark.parametrize(
    "end", [_pilot, _stop, _stop_at_the_console, _hover_at_the_console, _given_back]
)
@pytest.mark.parametrize("obtained", [True, False])
async def test_a_mission_that_waits_is_ended_for_good(
    rig: Rig, client: Client, end: Callable[[Rig], Awaitable[None]], obtained: bool
) -> None:
    await client.up()
    legs = [{**client.place(3.0, 0.0), "height": 3.0, "wait": 60.0}]
    legs += [{**client.place(60.0, 0.0), "height": 3.0, "wait": 0.0}]
    goal = await client.send("~/fly_mission", waypoints=legs, speed=5.0)
    assert goal is not None
    await anyio.sleep(15.0)
    await end(rig)
    assert (await client.result("~/fly_mission", goal))[0] is GoalStatus.CANCELED
    if obtained:
        assert (await client.call("~/obtain_control"))["success"]
    await anyio.sleep(80.0)
    assert north(rig) < 5.0


# -- those who ask for much -----------------------------------------------------------------------


async def test_a_program_that_waits_for_results_keeps_nobody_from_stopping_and_landing(
    rig: Rig, client: Client
) -> None:
    await client.up()
    place = client.place(60.0, 0.0)
    goal = await client.send("~/fly_to", **place, height=4.0, speed=2.0)
    assert goal is not None
    asked = {"goal_id": {"uuid": list(goal)}}
    waiting = []
    for number in range(80):
        asking = Program(rig, 100 + number).call(
            client.inner("~/fly_to", "get_result"), "m100_msgs/action/FlyTo_GetResult", **asked
        )
        waiting.append(asyncio.ensure_future(asking))
        if number % 8 == 7:
            await anyio.sleep(0.1)
    assert (await client.cancel("~/fly_to", goal)) == (0, 1)
    assert (await client.call("~/stop"))["success"]
    assert (await client.call("~/land"))["success"]
    answers = await asyncio.gather(*waiting)
    assert {one.get("status") for one in answers} == {GoalStatus.CANCELED, None}


async def test_a_program_that_asks_for_very_many_parameters_has_no_answer(
    rig: Rig, program: Program
) -> None:
    for name in ("get_parameters", "describe_parameters", "get_parameter_types"):
        kind = "rcl_interfaces/srv/" + "".join(one.capitalize() for one in name.split("_"))
        for many in (65, 4000, 60000):
            assert await program.call(f"~/{name}", kind, names=["x"] * many) == {"success": None}
        assert len(await program.call(f"~/{name}", kind, names=["x"] * 64)) == 1
    assert rig.node.ends.refused == 9


# -- stop -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("stop", [_stop, _stop_at_the_console])
async def test_a_program_that_sends_speeds_during_a_goal_does_not_fly_after_stop(
    rig: Rig, client: Client, stop: Callable[[Rig], Awaitable[None]]
) -> None:
    await client.up()
    assert await client.send("~/fly_to", **client.place(60.0, 0.0), height=4.0, speed=3.0)
    program = Program(rig, 9)
    await program.fly(3.0, 2.0)
    await stop(rig)
    await program.fly(2.0, 2.0)  # brakes
    for _ in range(100):
        await program.fly(0.05, 2.0)
        assert rig.speed < 0.3


async def test_a_cancel_after_stop_lets_nobody_fly_on(rig: Rig, client: Client) -> None:
    await client.up()
    assert await client.send("~/fly_to", **client.place(60.0, 0.0), height=4.0, speed=3.0)
    program = Program(rig, 9)
    await program.fly(3.0, 2.0)
    stopped = asyncio.ensure_future(rig.agent.stop())
    await client.cancel("~/fly_to")
    await stopped
    await program.fly(2.0, 2.0)  # brakes
    for _ in range(100):
        await program.fly(0.05, 2.0)
        assert rig.speed < 0.3


@pytest.mark.parametrize(
    ("told", "is_kept"),
    [
        ([FlightStatus(FlightPhase.STANDBY), Velocity(0.0, 0.0, 0.0, 7)], False),
        ([FlightStatus(FlightPhase.IN_AIR)], True),
        ([], True),  # nobody knows, which counts as the air
    ],
    ids=["ground", "air", "unknown"],
)
async def test_control_is_given_back_for_lack_of_orders_where_it_is_seen_to_stand(
    told: list[Any], *, is_kept: bool
) -> None:
    ours, its = memory_channels()
    agent = KnownAgent(its)
    async with AgentClient(ours, "ROS 2") as client:
        control = RosControl(client)
        await control.obtain()
        for _ in range(round(IDLE_S) + 2):
            agent.tell(agent.state)
            agent.tell_package(client.now, changed=told, without=() if told else (FlightStatus,))
            control.advance()
            await anyio.sleep(1.0)
        assert control.session.has_lease is is_kept
