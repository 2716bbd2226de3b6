"""Whole flights by topics and services, on virtual time and without a session."""

from __future__ import annotations

import asyncio
import math
import os
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from functools import partial
from random import Random
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import Mock, call

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.lease import Lease
from m100link.apps.agent.orders import Obtain
from m100link.apps.agent.transports import memory_channels
from m100link.apps.bus.network import Question, Received, TokenChange
from m100link.apps.ros2.graph import (
    Attachment,
    EntityKind,
    Names,
    NodeName,
    data_key,
    read_token,
)
from m100link.apps.ros2.node import Node
from m100link.apps.ros2.topics import INPUTS, OUTPUTS, SERVICES
from m100link.apps.station import ros2 as station_ros2
from m100link.apps.station.config import Settings
from m100link.errors import M100Error, TaskRefused
from m100link.log.cdr import encode
from m100link.protocol.records import AccelerationMode
from m100link.protocol.setpoint import Setpoint
from tests.apps.agent.conftest import task_of
from tests.apps.ros2.conftest import Program, RecordingBus, Rig
from tests.apps.ros2.test_actions import Client

pytestmark = pytest.mark.anyio


@pytest.mark.parametrize("firmware", ["1.0", "2.3", "3.1"])
async def test_up_along_and_down_again(firmware: str) -> None:
    async with Rig(firmware=firmware).running() as rig:
        program = rig.program
        await program.up()
        await program.fly(3.0, 2.0)
        assert rig.speed == pytest.approx(2.0, abs=0.3)
        assert (await program.call("~/land"))["success"]
        await rig.until(lambda: not rig.motors_on)
        await rig.until(lambda: not rig.client.holder.number)


@pytest.mark.parametrize("mode", AccelerationMode)
async def test_the_imu_is_right_whatever_the_pc_assistant_sends(mode: AccelerationMode) -> None:
    """Against the specific force of the body: on the ground, flying off at 5 m/s, and hovering."""
    one = Rig(firmware="3.1")
    arbiter = one.aircraft.vehicle.authority
    arbiter.assistant = replace(arbiter.assistant, acceleration=mode)
    felt: dict[int, tuple[float, float, float]] = {}  # by hundredths of a second

    async def feel() -> None:
        while True:
            forward, right, down = one.aircraft.vehicle.sensors._specific_force()
            felt[round(one.utc() * 100)] = forward, -right, -down
            await anyio.sleep(0.01)

    async with one.running() as rig:
        await anyio.sleep(3.0)  # at rest, until the mode is known
        rig.outlet("~/imu").sent.clear()
        watching = asyncio.ensure_future(feel())
        await rig.program.up()
        await rig.program.fly(2.0, 5.0)
        await anyio.sleep(2.0)
        watching.cancel()
        said = rig.said("~/imu")
    first, last = (one["header"]["stamp"] for one in (said[0], said[-1]))
    lasted = last["sec"] - first["sec"] + (last["nanosec"] - first["nanosec"]) / 1e9
    assert len(said) == pytest.approx(50.0 * lasted, abs=2.0)
    assert lasted > 7.0
    axes = []
    for message in said:
        at, found = message["header"]["stamp"], message["linear_acceleration"]
        axes.append((found["x"], found["y"], found["z"]))
        now = round(at["sec"] * 100 + at["nanosec"] / 1e7)
        near = [felt[one] for one in (now - 1, now, now + 1) if one in felt]
        assert not near or min(math.dist(axes[-1], one) for one in near) < 0.05
    forward, left, up = zip(*axes, strict=True)
    assert up[0] == pytest.approx(9.81, abs=0.15)
    assert max(up) > 10.5  # of the propellers, and along their axis alone
    assert min(forward) == pytest.approx(-0.6, abs=0.1)  # 5 m/s at a drag of 0.12 /s
    assert max(map(abs, left)) < 0.1


async def test_all_that_is_offered_has_a_token(rig: Rig) -> None:
    seen = [read_token(one) for one in rig.bus.tokens]
    assert all(one is not None and one.node_name == "/m100" for one in seen)
    ends = [(one.end, one.topic) for one in seen if one is not None]
    assert ends[0] == (EntityKind.NODE, "")
    full = rig.names.full
    assert set(ends[1:]) >= {
        *((EntityKind.PUBLISHER, full(name)) for name in OUTPUTS),
        *((EntityKind.SUBSCRIBER, full(name)) for name in INPUTS),
        *((EntityKind.SERVER, full(name)) for name in SERVICES),
    }
    assert len({one.split("/")[4] for one in rig.bus.tokens}) == len(rig.bus.tokens)


async def test_names_are_remapped_everywhere() -> None:
    names = Names.of("/fleet", "a1", ("~/imu:=/imu", "~/takeoff:=up"))
    async with Rig(names=names).running() as rig:
        keys = {key.rpartition("/RIHS")[0] for key in (*rig.bus.outlets, *rig.bus.inboxes)}
        assert "0/imu/sensor_msgs::msg::dds_::Imu_" in keys
        assert "0/fleet/up/std_srvs::srv::dds_::Trigger_" in keys
        assert "0/fleet/a1/land/std_srvs::srv::dds_::Trigger_" in keys
        assert rig.said("~/odom")[0]["header"]["frame_id"] == "fleet/odom"
        await rig.program.up()


# -- refusals -------------------------------------------------------------------------------------


async def test_nothing_flies_before_control_was_obtained(rig: Rig, program: Program) -> None:
    for name in ("~/takeoff", "~/land", "~/go_home", "~/arm", "~/take_photo"):
        answer = await program.call(name)
        assert not answer["success"]
        assert "what to do:   call ~/obtain_control first" in answer["message"]
    await program.fly(1.0, 2.0)
    assert not rig.motors_on
    assert "ROS has no control" in rig.texts


async def test_control_of_somebody_else_is_not_taken(rig: Rig, program: Program) -> None:
    await rig.client.acquire("the console")
    answer = await program.call("~/obtain_control")
    assert not answer["success"]
    assert "the console" in answer["message"]
    assert "the console" in (await program.call("~/takeoff"))["message"]


async def test_of_two_nodes_of_one_name_none_is_flown(rig: Rig, program: Program) -> None:
    other = NodeName(0, "anotherone", "/", "m100").token
    rig.bus.changed.waiting.append(TokenChange(rig.node.name.token, True))
    rig.bus.changed.waiting.append(TokenChange(other, True))
    await anyio.sleep(0.1)
    answer = await program.call("~/obtain_control")
    assert not answer["success"]
    assert "two nodes are called /m100" in answer["message"]
    rig.bus.changed.waiting.append(TokenChange(other, False))
    await anyio.sleep(0.1)
    assert (await program.call("~/obtain_control"))["success"]


def own_status(rig: Rig) -> tuple[int, str]:
    """Level and message of the node itself: OK 0, WARN 1 (diagnostic_msgs/DiagnosticStatus)."""
    newest = rig.said("/diagnostics")[-1]["status"]
    [node] = [one for one in newest if one["name"] == "m100: node"]
    return node["level"], node["message"]


def warnings(rig: Rig, words: str) -> int:
    return sum(words in one["msg"] and one["level"] == 30 for one in rig.said("/rosout"))


@pytest.fixture
def again_in_3_s(monkeypatch: pytest.MonkeyPatch) -> None:
    """A minute is a second of a processor; ``tests/limits.toml`` has the minute."""
    monkeypatch.setattr("m100link.apps.ros2.node._AGAIN_S", 3.0)


@pytest.mark.usefixtures("again_in_3_s")
async def test_a_namesake_is_reported_in_the_log_and_in_the_diagnostics(rig: Rig) -> None:
    other = NodeName(0, "anotherone", "/", "m100").token
    rig.bus.changed.waiting.append(TokenChange(other, True))
    await anyio.sleep(4.0)
    assert warnings(rig, "two nodes are called /m100") == 1
    level, message = own_status(rig)
    assert (level, "two nodes are called /m100" in message) == (1, True)
    await anyio.sleep(2.5)
    assert warnings(rig, "two nodes are called /m100") == 2
    rig.bus.changed.waiting.append(TokenChange(other, False))
    await anyio.sleep(2.0)
    assert own_status(rig)[0] == 0
    assert "no other of its name" in rig.said("/rosout")[-1]["msg"]


@pytest.mark.usefixtures("again_in_3_s")
async def test_without_a_router_it_says_so_after_two_seconds_and_again() -> None:
    rig = Rig()
    rig.bus.is_connected = False
    async with rig.running():
        await anyio.sleep(1.5)
        assert not warnings(rig, "no router of ROS 2 answers")
        await anyio.sleep(1.5)
        assert warnings(rig, "no router of ROS 2 answers") == 1
        assert own_status(rig)[0] == 1
        await anyio.sleep(3.0)
        assert warnings(rig, "no router of ROS 2 answers") == 2
        rig.bus.is_connected = True
        await anyio.sleep(2.0)
        assert own_status(rig)[0] == 0
        await anyio.sleep(7.0)
        assert warnings(rig, "no router of ROS 2 answers") == 2


async def test_home_is_the_place_that_the_aircraft_left(rig: Rig, program: Program) -> None:
    before = rig.said("~/fix")[-1]
    assert not rig.outlet("~/home").sent
    await program.up()
    await program.fly(4.0, 2.0)
    [home] = rig.said("~/home")
    for name in ("latitude", "longitude"):
        assert home[name] == pytest.approx(before[name], abs=1e-5)
    now = rig.said("~/fix")[-1]
    assert abs(now["latitude"] - home["latitude"]) > 2e-5, "2 m/s to the north for 4 s"


async def test_on_the_ground_speeds_move_nothing(rig: Rig, program: Program) -> None:
    assert (await program.call("~/obtain_control"))["success"]
    await program.fly(1.0, 2.0, z=1.0)
    assert not rig.motors_on
    assert "on the ground" in rig.texts


async def test_control_that_nobody_uses_goes_back(rig: Rig, program: Program) -> None:
    assert (await program.call("~/obtain_control"))["success"]
    await anyio.sleep(58.0)
    assert rig.client.holder.number
    await anyio.sleep(3.0)
    assert not rig.client.holder.number
    assert "gives control back" in rig.texts


# -- setpoints ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("frame", "heading"), [("base_link", "forward"), ("odom", "east"), ("map", "east")]
)
async def test_frames_say_where_to(rig: Rig, program: Program, frame: str, heading: str) -> None:
    await program.up()
    await program.fly(3.0, 2.0, frame=frame)
    linear = rig.said("~/velocity")[-1]["twist"]["linear"]
    # It looks north.
    assert linear["x" if heading == "east" else "y"] == pytest.approx(2.0, abs=0.3)
    odometry = rig.said("~/odom")[-1]["twist"]["twist"]["linear"]
    assert odometry["y" if heading == "east" else "x"] == pytest.approx(
        -2.0 if heading == "east" else 2.0, abs=0.3
    )


async def test_a_frame_that_nobody_knows_moves_nothing(rig: Rig, program: Program) -> None:
    await program.up()
    await program.fly(1.0, 2.0, frame="camera")
    assert rig.speed < 0.3
    assert "in the frame 'camera'" in rig.texts


async def test_it_turns_about_the_axis_that_points_up(rig: Rig, program: Program) -> None:
    await program.up()
    before = rig.said("/tf")[-1]["transforms"][0]["transform"]["rotation"]
    await program.fly(2.0, turn=0.5)
    after = rig.said("/tf")[-1]["transforms"][0]["transform"]["rotation"]
    turned = [2 * math.atan2(one["z"], one["w"]) for one in (before, after)]
    assert math.remainder(turned[1] - turned[0], math.tau) == pytest.approx(1.0, abs=0.25)


async def test_a_dead_publisher_means_hover(rig: Rig, program: Program) -> None:
    await program.up()
    await program.fly(3.0, 3.0)
    await anyio.sleep(0.5)
    assert rig.speed < 2.9  # it brakes
    await anyio.sleep(1.5)
    assert rig.speed < 0.3
    assert rig.node.control.mux.holder is None


async def test_a_second_publisher_is_not_flown_and_does_not_follow(
    rig: Rig, program: Program
) -> None:
    await program.up()
    other = Program(rig, 2)
    for _ in range(40):
        program.speed(2.0)
        other.speed(-2.0)
        await anyio.sleep(0.05)
    forward = rig.said("~/odom")[-1]["twist"]["twist"]["linear"]["x"]
    assert forward == pytest.approx(2.0, abs=0.3)
    assert "another publisher is active" in rig.texts
    await other.fly(3.0, -2.0)  # the first one has died
    assert rig.speed < 0.3
    await anyio.sleep(0.6)  # it lets go, and begins anew
    await other.fly(2.0, -2.0)
    assert rig.speed > 1.5


async def test_setpoints_that_waited_are_not_flown(rig: Rig, program: Program) -> None:
    await program.up()
    program.speed()
    program.late = 0.5
    await program.fly(1.0, 3.0)
    assert rig.speed < 0.3
    assert rig.node.control.mux.refused["late"] == 20


async def test_a_relay_keeps_no_queue_alive_whose_program_has_ended(
    rig: Rig, program: Program
) -> None:
    """It takes one of 20 messages a second every 0.1 s, and its own attachments are young."""
    await program.up()
    for _ in range(40):
        program.speed(2.0, made_at=rig.utc() - 0.01)
        await anyio.sleep(0.05)
    assert rig.speed > 1.5, "without a queue it flies by the same stamps"
    began_at = rig.utc()
    for number in range(40):  # 2 s of messages, in 4 s
        if number == 30:
            assert rig.speed < 0.3, "what flies now was made 1.5 s ago"
        program.speed(2.0, made_at=began_at + 0.05 * number)
        await anyio.sleep(0.1)
    # Those that are at most 0.3 s later than the fastest fly: seven.
    assert rig.node.control.mux.refused["late"] == pytest.approx(33, abs=1)


async def test_a_place_is_flown_to(rig: Rig, program: Program) -> None:
    await program.up()
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "odom"}
    place = {"x": 4.0, "y": -3.0, "z": 3.0}
    east = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    for _ in range(300):
        pose = {"position": place, "orientation": east}
        program.publish("~/setpoint_position", {"header": header, "pose": pose})
        await anyio.sleep(0.05)
    pose = rig.said("~/pose")[-1]["pose"]
    for axis, value in place.items():
        assert pose["position"][axis] == pytest.approx(value, abs=0.7)
    assert abs(pose["orientation"]["z"]) < 0.1


# -- losses ---------------------------------------------------------------------------------------


async def test_what_is_sent_on_when_the_way_is_whole_again_is_not_flown(
    rig: Rig, program: Program
) -> None:
    await program.up()
    await program.fly(2.0, 2.0)
    program.is_cut = True
    await program.fly(3.0, 2.0)
    assert rig.speed < 0.3
    program.is_cut = False
    await program.fly(2.0, 2.0)
    assert rig.speed < 0.3
    assert "was cut off while it published" in rig.texts
    await anyio.sleep(0.6)
    await program.fly(2.0, 2.0)
    assert rig.speed > 1.5


async def test_after_stop_nothing_resumes_by_itself(rig: Rig, program: Program) -> None:
    await program.up()
    await program.fly(2.0, 2.0)
    assert (await Program(rig, 7).call("~/stop"))["success"]
    await program.fly(2.0, 2.0)
    assert rig.speed < 0.3
    assert (await program.call("~/obtain_control"))["success"]
    await program.fly(2.0, 2.0)
    assert rig.speed > 1.5


async def test_the_pilot_takes_it_and_nothing_resumes(rig: Rig, program: Program) -> None:
    await program.up()
    rig.aircraft.vehicle.remote.set_mode("P")
    await program.fly(2.0, 2.0)
    assert not rig.client.holder.number
    rig.aircraft.vehicle.remote.set_mode("F")
    await program.fly(2.0, 2.0)
    assert rig.speed < 0.3


async def test_junk_is_counted_and_moves_nothing(rig: Rig, program: Program) -> None:
    await program.up()
    random = Random(3)
    for name, row in INPUTS.items():
        inbox = rig.inbox(name, row.kind)
        for _ in range(50):
            inbox.waiting.append(
                Received(random.randbytes(random.randrange(120)), program.attachment())
            )
            head = b"\0\1\0\0" + random.randbytes(random.randrange(200))
            inbox.waiting.append(Received(head, program.attachment()))
            inbox.waiting.append(Received(head, random.randbytes(9)))
            await anyio.sleep(0.02)
    dropped: list[int] = []
    for name, service in SERVICES.items():
        key = data_key(0, rig.names.full(name), service.kind)
        for data in (b"", b"\1\1\0\0", random.randbytes(20)):
            end = partial(dropped.append, 1)
            asked = Question(key, data, print, end, program.attachment())
            rig.inbox(name, service.kind).waiting.append(asked)
            await anyio.sleep(0.02)
        if name == "~/takeoff":
            await anyio.sleep(1.0)
            assert "/m100/takeoff: a request without an answer: " in rig.texts
    assert "/m100/cmd_vel: a message that cannot be read" in rig.texts
    assert len(dropped) >= 2 * len(SERVICES)
    assert rig.node.ends.refused > 200
    assert rig.speed < 1.0
    assert not rig.work.done()
    assert (await program.call("~/land"))["success"]


async def test_a_program_that_asks_all_services_at_once_asks_none(
    rig: Rig, program: Program
) -> None:
    assert (await program.call("~/obtain_control"))["success"]
    for pattern in ("0/m100/**", "0/*/takeoff/**"):
        assert await program.ask(pattern, "~/takeoff", SERVICES["~/takeoff"].kind) is None
    await anyio.sleep(3.0)
    assert rig.height < 0.5
    assert rig.node.ends.refused == 2


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e9])
async def test_numbers_that_are_none_are_reported(rig: Rig, program: Program, value: float) -> None:
    await program.up()
    await program.fly(1.0, value)
    assert rig.speed < 0.3
    assert "~/cmd_vel: " in rig.texts


def bare(**given: Any) -> Any:
    """A node of which only these parts are there."""
    node = cast(Any, object.__new__(Node))
    for name, value in given.items():
        setattr(node, f"_{name}", value)
    return node


def test_a_reason_is_told_every_two_seconds() -> None:
    agent = SimpleNamespace(now=5.0, note=Mock())
    node = bare(agent=agent, reported={})
    told = []
    for now, text in ((5.0, "a"), (6.9, "a"), (6.9, "b"), (7.0, "a"), (8.9, "a"), (9.0, "a")):
        agent.now = now
        node._tell(text, "warning")
        told.append(agent.note.call_count)
    assert told == [1, 1, 2, 3, 3, 4]
    assert agent.note.mock_calls[0].args == ("a", "warning")


def test_a_setpoint_is_as_old_as_its_attachment_says() -> None:
    """Nanoseconds there, seconds here; of what came together the newest flies."""
    heard: list[tuple[Any, ...]] = []
    control = SimpleNamespace(
        mux=SimpleNamespace(hear=lambda *what: heard.append(what)),
        refusal=lambda: "",
        session=SimpleNamespace(steer=Mock()),
    )
    node = bare(agent=SimpleNamespace(now=40.0), deaf_until=40.0)
    node.control = control
    came = [(Attachment(3 + n, 1_500_000_000 + n, b"g" * 16), {"number": n}) for n in range(2)]
    source: Any = SimpleNamespace(take=lambda: came)
    node._hear("~/cmd_vel", source, lambda message: message["number"])
    assert heard == [(b"g" * 16, 1.5, 40.0, 3, 0), (b"g" * 16, pytest.approx(1.5), 40.0, 4, 0)]
    assert control.session.steer.mock_calls == [call(1, 0.3)]
    node._deaf_until = 40.1  # what comes now was sent while it stood still
    node._hear("~/cmd_vel", source, lambda message: message["number"])
    assert (len(heard), control.session.steer.call_count) == (4, 1)


@pytest.mark.parametrize(("pause", "deaf_until"), [(0.99, -1.0), (1.0, 31.3), (5.0, 35.3)])
def test_after_a_second_without_a_step_what_comes_for_0_3_s_is_old(
    pause: float, deaf_until: float
) -> None:
    parts = Mock()
    parts.ends.refusal = ""
    node = bare(
        agent=SimpleNamespace(now=30.0 + pause),
        ran_at=30.0,
        deaf_until=-1.0,
        presence=parts,
        inputs=[],
        is_even=False,
        payload=parts.payload,
        looked_at=30.0,
        look_at_graph=Mock(),
    )
    node.actions, node.control, node.ends, node.teller = Mock(), parts, parts.ends, parts
    node.step()
    is_deaf = deaf_until > 0
    assert node._deaf_until == pytest.approx(deaf_until)
    assert node._ran_at == 30.0 + pause
    assert node.actions.end.called is is_deaf
    assert parts.ends.take_requests.mock_calls == [call(is_deaf=is_deaf)]
    assert parts.payload.advance.mock_calls == [call(is_deaf=is_deaf)]
    assert node.ends.look.called, "half a second has gone"


async def test_what_came_while_it_stood_still_is_not_done(rig: Rig, program: Program) -> None:
    await program.up()
    rig.node._ran_at -= 5.0  # as after SIGSTOP and SIGCONT
    assert (await program.call("~/land"))["success"] is None
    assert rig.height > 1.0


async def test_a_stop_that_came_while_it_stood_still_is_done(rig: Rig, program: Program) -> None:
    """What ends a flight is done whenever it comes: the aircraft flew on by itself meanwhile."""
    await program.up()
    assert (await program.call("~/land"))["success"]
    await rig.until(lambda: rig.client.state.task == "land")
    rig.node._ran_at -= 2.0  # as after SIGSTOP and SIGCONT
    assert (await program.call("~/stop"))["success"]
    await rig.until(lambda: not rig.agent.holding.has_authority)
    assert task_of(rig.agent) is None


# What ends something, and is done when it comes from before a standstill of the node, too.
ENDING = {
    **dict.fromkeys(("~/land", "~/go_home"), False),
    **dict.fromkeys(("~/stop", "~/release_control", "~/disarm"), True),
    **dict.fromkeys(("~/mission/pause", "~/mission/stop"), True),
    **{f"~/{name}/_action/cancel_goal": True for name in ("take_off", "fly_to", "fly_mission")},
}


@pytest.mark.slow
async def test_what_ends_a_flight_waits_behind_no_number_of_requests(
    rig: Rig, program: Program, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Calls that get no answer, such as STOP while the aircraft confirms nothing."""
    begun: list[str] = []
    for service in rig.node.ends._services:

        async def hang(_: object, topic: str = service.topic) -> Any:
            begun.append(topic)
            await anyio.sleep_forever()

        monkeypatch.setattr(service, "call", hang)
    nobody = {"goal_id": {"uuid": [0] * 16}, "stamp": {"sec": 0, "nanosec": 0}}
    cancel = "action_msgs/srv/CancelGoal"
    requests = {"std_srvs/srv/Trigger": {}, cancel: {"goal_info": nobody}}
    names = {rig.names.full(name): name for name in (*ENDING, *SERVICES)}
    for service in rig.node.ends._services:
        if service.topic not in names or service.kind not in requests:
            continue
        name, request = (
            names[service.topic],
            encode(f"{service.kind}_Request", requests[service.kind]),
        )

        def ask(key: str = service.key, request: bytes = request) -> None:
            asked = Question(key, request, print, lambda: None, program.attachment())
            rig.bus.inboxes[key].waiting.append(asked)

        begun.clear()
        for _ in range(10):
            for _ in range(3):
                ask()
            await anyio.sleep(0.1)
        count = 30 if name in ENDING else 8
        assert len(begun) == count, name
        rig.node._ran_at -= 5.0  # as after SIGSTOP and SIGCONT
        ask()
        await anyio.sleep(0.1)
        assert len(begun) == count + ENDING.get(name, False), name
        await anyio.sleep(0.5)


async def test_a_landing_that_is_asked_for_again_and_again_is_one(
    rig: Rig, program: Program, monkeypatch: pytest.MonkeyPatch
) -> None:
    await program.up()
    asked: list[orders.Order] = []
    ask = rig.client.ask

    async def refused(order: orders.Order, *rest: Any, **more: Any) -> Any:
        asked.append(order)
        if isinstance(order, orders.Land) and len(asked) < 4:
            raise TaskRefused("not now")
        return await ask(order, *rest, **more)

    monkeypatch.setattr(rig.client, "ask", refused)
    async with anyio.create_task_group() as group:
        for _ in range(8):
            group.start_soon(program.call, "~/land")
    assert asked.count(orders.Land()) == 4
    await rig.until(lambda: rig.height < 0.1)


async def test_a_landing_behind_a_stop_is_another_one(
    rig: Rig, program: Program, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The one before was overtaken by the STOP, and ends with it."""
    await program.up()
    with monkeypatch.context() as patched:

        async def never(*_: Any, **__: Any) -> Any:
            await anyio.sleep_forever()

        patched.setattr(rig.client, "ask", never)
        async with anyio.create_task_group() as group:
            group.start_soon(program.call, "~/land")
            await anyio.sleep(0.2)
            patched.undo()
            await rig.agent.stop()
            await anyio.sleep(0.2)
            assert (await program.call("~/land"))["success"]
            group.cancel_scope.cancel()
    await rig.until(lambda: rig.height < 0.1)


async def test_without_telemetry_it_answers_all_the_same(rig: Rig, program: Program) -> None:
    rig.aircraft.stall_line()
    await anyio.sleep(0.5)
    began = rig.client.now
    assert not (await program.call("~/takeoff"))["success"]
    assert rig.client.now - began < 0.1


async def test_the_end_of_the_node_gives_control_back(rig: Rig, program: Program) -> None:
    await program.up()
    rig.work.cancel()
    await rig.until(lambda: not rig.client.holder.number)


def test_an_empty_request_is_one_byte() -> None:
    assert encode("std_srvs/srv/Trigger_Request", {}) == b"\0\1\0\0\0"


# -- random programs: whatever crosses whatever, an aircraft that nobody wants to move hovers ------
# ``ROS2_SEEDS`` sets how many programs are tried.


SEEDS = range(int(os.environ.get("ROS2_SEEDS", "6")))

FIRMWARE = ("1.0", "2.3", "3.1")

QUIET_S = 2.0
"""Braking from 3 m/s: 0.3 s of lifetime, and one second and a half for the aircraft."""

AT_REST = 0.3


class World:
    """Two publishers, a program of services and goals, a console, a pilot, and who wants what."""

    def __init__(self, rig: Rig, console: AgentClient, random: Random) -> None:
        self.rig, self.console, self.random = rig, console, random
        self.client = Client(rig)
        self.publishers = [Program(rig, 1), Program(rig, 2)]
        self.streaming: list[str] = ["", ""]
        self.console_lease: Lease | None = None
        self.console_steers = False
        self.wanted_at = rig.client.now
        # Since somebody stopped it, and until somebody asks for something anew.
        self.is_stopped = False
        # Whether a goal may fly: sent, and not ended since by anybody.
        self.has_goal = False
        self.log: list[str] = []
        self.calls: set[asyncio.Task[Any]] = set()

    def told(self, text: str) -> None:
        self.log.append(f"{self.rig.client.now:7.2f} {text}")

    # -- what happens ----------------------------------------------------------------------------

    def call(self, name: str, after: Callable[[bool], None] = lambda _: None) -> None:
        """Begin to call a service; others happen meanwhile."""

        async def run() -> None:
            answer = await self.client.call(name)
            self.told(f"{name} -> {answer['success']} {answer.get('message', '')[:60]!r}")
            after(bool(answer["success"]))

        self.told(name)
        self._spawn(run())

    def _spawn(self, work: Awaitable[None]) -> None:
        task = asyncio.ensure_future(work)
        self.calls.add(task)
        task.add_done_callback(self.calls.discard)

    def anew(self, _: bool = True) -> None:
        self.is_stopped = False

    def stopped(self, success: bool) -> None:
        self.is_stopped = self.is_stopped or success
        self.ended(success)

    def ended(self, success: bool) -> None:
        self.has_goal = self.has_goal and not success

    def down(self, success: bool) -> None:
        self.anew()
        self.ended(success)

    def goal(self) -> None:
        name = self.random.choice(["~/take_off", "~/fly_to", "~/fly_mission", "~/fly_mission"])
        far = self.random.choice((2.0, 30.0))
        place = self.client.place(self.random.uniform(-far, far), self.random.uniform(-far, far))
        leg = {**place, "height": self.random.uniform(1.0, 8.0)}
        goals: dict[str, dict[str, Any]] = {
            "~/take_off": {"height": leg["height"]},
            "~/fly_to": {**leg, "speed": self.random.uniform(1.0, 4.0)},
            "~/fly_mission": {
                "speed": 3.0,
                "waypoints": [
                    {**leg, "wait": self.random.uniform(0.0, 30.0)},
                    {**leg, "latitude": place["latitude"] + 2e-4, "wait": 1.0},
                ],
            },
        }

        async def run() -> None:
            self.anew()
            answer = await self.client.ask_goal(name, **goals[name])
            self.has_goal = self.has_goal or bool(answer.get("accepted"))
            self.told(f"{name} -> {answer}")

        self.told(f"goal {name}")
        self._spawn(run())

    def cancel(self) -> None:
        async def run() -> None:
            for name in ("~/take_off", "~/fly_to", "~/fly_mission"):
                answer = await self.client.ask_cancel(name)
                self.ended(bool(answer.get("goals_canceling")))
                self.told(f"cancel {name} -> {answer}")

        self._spawn(run())

    def stream(self) -> None:
        which = self.random.randrange(2)
        kinds = ["", "speed", "speed", "place", "wild"]
        self.streaming[which] = self.random.choice(kinds)
        self.told(f"publisher {which}: {self.streaming[which] or 'silent'}")

    def pilot(self) -> None:
        mode = self.random.choice("PPFFFF")
        self.told(f"pilot {mode}")
        self.rig.aircraft.vehicle.remote.set_mode(mode)
        self.ended(mode == "P")

    def take_over(self) -> None:
        async def run() -> None:
            try:
                if self.console.holder.number:
                    offer = await self.console.ask_take_over("the console")
                    self.console_lease = await self.console.confirm(offer.token)
                else:
                    self.console_lease = await self.console.acquire("the console")
                self.told("console has the lease")
                self.ended(True)
                await self.console.ask(Obtain(), self.console_lease)
                self.anew()
                self.console_steers = self.random.random() < 0.5
                self.told(f"console has control, steers: {self.console_steers}")
            except M100Error as error:
                self.told(f"console: {error.seen}")

        self.told("console takes over")
        self._spawn(run())

    def let_go(self) -> None:
        self.console_steers = False
        if self.console_lease is not None:
            self.told("console lets go")
            self.console.let_go(self.console_lease)

    def halt(self) -> None:
        self.told("console halts")
        self.console.hover("hover")
        self.ended(True)

    def stop(self) -> None:
        async def run() -> None:
            await self.console.stop()
            self.told("console stopped it")
            self.stopped(True)

        self.told("console stops")
        self._spawn(run())

    def stand_still(self) -> None:
        self.told("node stood still")
        self.rig.node._ran_at -= 5.0
        self.ended(True)

    def leave(self) -> None:
        self.told("client is gone, and back")
        self.client.leave()
        self.ended(True)
        self.client = Client(self.rig)

    def happen(self) -> None:
        what: list[tuple[float, Callable[[], None]]] = [
            (3, lambda: self.call("~/obtain_control", self.anew)),
            (1, lambda: self.call("~/release_control", self.ended)),
            (3, lambda: self.call("~/takeoff", self.anew)),
            (1, lambda: self.call("~/land", self.down)),
            (0.5, lambda: self.call("~/go_home", self.down)),
            (1, lambda: self.call("~/stop", self.stopped)),
            (0.3, lambda: self.call("~/disarm")),
            (5, self.goal),
            (1, self.cancel),
            (6, self.stream),
            (1.5, self.pilot),
            (0.7, self.take_over),
            (0.7, self.let_go),
            (0.7, self.halt),
            (2, self.stop),
            (0.3, self.stand_still),
            (0.5, self.leave),
        ]
        weights = [weight for weight, _ in what]
        self.random.choices([do for _, do in what], weights)[0]()

    # -- what is sent, and what is true ----------------------------------------------------------

    def send(self) -> None:
        for program, what in zip(self.publishers, self.streaming, strict=True):
            if what == "speed":
                program.speed(3.0, 0.0)
            elif what == "place":
                header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "odom"}
                place = {"x": 20.0, "y": 20.0, "z": 4.0}
                turned = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.0}
                pose = {"position": place, "orientation": turned}
                program.publish("~/setpoint_position", {"header": header, "pose": pose})
            elif what == "wild":
                odd = [math.nan, math.inf, 1e308, -1e308, 50.0, -0.0]
                program.speed(self.random.choice(odd), self.random.choice(odd))
        if self.console_steers and self.console_lease is not None:
            if self.console.holds(self.console_lease):
                forward = Setpoint.velocity(forward=2.0, right=0.0, up=0.0, yaw_rate_deg_s=0.0)
                self.console.steer(self.console_lease, forward)
            else:
                self.console_steers = False

    @property
    def is_wanted(self) -> bool:
        """Whether somebody wants it to move now."""
        flight = self.rig.aircraft.vehicle.flight
        if flight.tasks.is_executing or flight.phase.name in ("LANDING", "FINISHING_LANDING"):
            return True  # the autopilot flies
        if (flying := self.rig.agent.holding.flying) and flying.guiding.order:
            return self.has_goal
        return (self.console_steers or any(self.streaming)) and not self.is_stopped

    def check(self) -> None:
        now = self.rig.client.now
        if self.is_wanted:
            self.wanted_at = now
        quiet = now - self.wanted_at
        motion = self.rig.aircraft.vehicle.flight.dynamics
        speed = math.hypot(motion.speed, motion.velocity_up)
        assert quiet < QUIET_S or speed < AT_REST, f"{speed:.2f} m/s after {quiet:.2f} s"
        assert not self.rig.work.done()

    async def pass_by(self, seconds: float) -> None:
        for _ in range(round(20 * seconds)):
            self.send()
            await anyio.sleep(0.05)
            self.check()


def is_down(rig: Rig) -> bool:
    return not rig.motors_on


async def fly(rig: Rig, seed: int) -> None:
    random = Random(seed)
    ours, its = memory_channels()
    rig.service.attach(its)
    async with AgentClient(ours, "the console") as console:
        world = World(rig, console, random)
        try:
            await world.client.up()
            for _ in range(30):
                for _ in range(random.choice((1, 1, 1, 2, 3))):
                    world.happen()
                await world.pass_by(random.choice((0.05, 0.1, 0.5, 1.0, 3.0, 6.0)))
            await end(world)
        except BaseException:
            sys.stdout.write("\n".join([f"seed {seed}", *world.log, ""]))
            raise


async def end(world: World) -> None:
    """Stop wins over everything that goes on; then landing does."""
    rig = world.rig
    world.console_steers = False
    world.let_go()
    rig.aircraft.vehicle.remote.set_mode("F")
    world.streaming = ["speed", "place"]
    await world.pass_by(1.0)
    world.call("~/stop", world.stopped)
    await world.pass_by(6.0)
    assert rig.speed < AT_REST
    if is_down(rig):
        return
    accepted: list[bool] = []
    world.call("~/obtain_control", world.anew)
    await world.pass_by(1.0)
    with anyio.fail_after(60.0):  # it is refused while the autopilot takes off
        while not any(accepted) and not is_down(rig):
            world.cancel()
            world.goal()
            world.call("~/land", accepted.append)
            await world.pass_by(1.0)
    with anyio.fail_after(40.0):
        while not is_down(rig):
            world.goal()
            await world.pass_by(0.5)


@pytest.mark.parametrize("seed", SEEDS)
async def test_what_nobody_wants_to_move_hovers(seed: int) -> None:
    async with Rig(firmware=FIRMWARE[seed % 3]).running() as rig:
        await fly(rig, seed)


# -- the time of a virtual aircraft, for other nodes -----------------------------------------------


@pytest.mark.parametrize(
    ("settings", "virtual"),
    [
        (Settings(url="sim://"), True),
        (Settings(url="sim://?firmware=2.3&latitude=52.1"), True),
        (Settings(sim=True), True),
        (Settings(url="/dev/ttyUSB0"), False),
        (Settings(url="tcp://sim:5760"), False),
    ],
)
async def test_a_virtual_aircraft_publishes_clock_whatever_its_url_says(
    monkeypatch: pytest.MonkeyPatch, settings: Settings, virtual: bool
) -> None:
    """As the node of its station is made; a second aircraft of a station publishes none."""
    async with Rig().running() as rig:
        bus: Any = RecordingBus()
        bus.missing = {}

        @asynccontextmanager
        async def opened(*_: object) -> AsyncIterator[Any]:
            yield bus

        monkeypatch.setattr(station_ros2, "open_ros2", opened)
        agents = {"a1": rig.client, "a2": rig.client}
        async with station_ros2.serving_ros2(agents, settings):
            clocks = [key for key in bus.outlets if key.split("/")[1] == "clock"]
        assert len(clocks) == virtual
