"""Services: missions that the aircraft flies by itself, the gimbal, and the package m100_msgs."""

from __future__ import annotations

import math
import re
from collections.abc import AsyncIterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import anyio
import pytest

from m100link.apps.ros2 import MESSAGES
from m100link.apps.ros2.control import ACTIONS as MISSION_ACTIONS
from m100link.apps.ros2.control import GimbalServices, angles_of, plan_of, rates_of
from m100link.geodesy import LocalFrame
from m100link.log.cdr import ACTIONS, DEFINITIONS, OWN_PACKAGE, SERVICES, full_name, type_hash
from m100link.missions.waypoint import AtEnd, Heading, OnRCLoss, Stay, TakePhoto, Trace
from m100link.protocol.records import FlightPhase
from tests.apps.ros2.conftest import Program, Rig, judge

pytestmark = pytest.mark.anyio

UPLOAD, START = "m100_msgs/srv/UploadMission", "m100_msgs/srv/StartMission"
NO_ACTIONS: list[dict[str, Any]] = []


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    async with Rig(firmware="3.1").running() as one:
        yield one


def point(north: float, east: float, height: float = 8.0, **more: Any) -> dict[str, Any]:
    origin = LocalFrame(47.3977419, 8.5455938)
    latitude, longitude = origin.to_geodetic(north, east)
    return {
        "latitude": latitude,
        "longitude": longitude,
        "height": height,
        "heading": 0.0,
        "damping": 0.0,
        "gimbal_pitch": 0.0,
        "turn_counterclockwise": False,
        "actions": NO_ACTIONS,
        **more,
    }


def mission(*points: dict[str, Any], **more: Any) -> dict[str, Any]:
    choices = dict.fromkeys(("heading", "trace", "at_end", "on_rc_loss", "repeat"), 0)
    numbers = {"speed": 5.0, "max_speed": 0.0, "gimbal_by_point": False}
    return {"points": list(points), **numbers, **choices, **more}


def around(rig: Rig) -> list[dict[str, Any]]:
    """Two places near where it stands."""
    fix = rig.said("~/fix")[-1]
    frame = LocalFrame(fix["latitude"], fix["longitude"])
    points = []
    for north, east in ((40.0, 0.0), (40.0, 30.0)):
        latitude, longitude = frame.to_geodetic(north, east)
        points.append(point(0, 0) | {"latitude": latitude, "longitude": longitude})
    return points


async def begun(rig: Rig, program: Program) -> None:
    assert (await program.call("~/obtain_control"))["success"]
    answer = await program.call("~/mission/upload", UPLOAD, **mission(*around(rig)))
    assert answer["success"], answer
    answer = await program.call("~/mission/start", START, take_off=True)
    assert answer["success"], answer


async def test_it_is_flown_paused_resumed_and_over(rig: Rig, program: Program) -> None:
    await begun(rig, program)
    await rig.until(lambda: rig.speed > 3.0)
    assert (await program.call("~/mission/pause"))["success"]
    await anyio.sleep(4.0)
    assert rig.speed < 0.5
    assert (await program.call("~/mission/resume"))["success"]
    await rig.until(lambda: rig.speed > 3.0)
    events = rig.said("~/mission_event")
    await rig.until(lambda: any(one["event"] == 1 for one in rig.said("~/mission_event")), 120.0)
    assert len(rig.said("~/mission_event")) > len(events)
    pose = rig.said("~/odom")[-1]["pose"]["pose"]["position"]
    assert (pose["x"], pose["y"]) == pytest.approx((30.0, 40.0), abs=1.5)
    # It hovers, and flies for the holder of control.
    await anyio.sleep(1.0)
    await program.fly(2.0, 2.0)
    assert rig.speed > 1.5
    assert (await program.call("~/land"))["success"]
    await rig.until(lambda: not rig.motors_on)


async def test_stopped_it_hovers(rig: Rig, program: Program) -> None:
    await begun(rig, program)
    await rig.until(lambda: rig.speed > 3.0)
    assert (await program.call("~/mission/stop"))["success"]
    await anyio.sleep(4.0)
    assert rig.speed < 0.3
    assert rig.height > 5.0
    assert not (await program.call("~/mission/resume"))["success"]


@pytest.mark.parametrize("name", ["~/stop", "~/land", "~/go_home", "~/release_control"])
async def test_what_ends_everything_ends_a_mission(rig: Rig, program: Program, name: str) -> None:
    await begun(rig, program)
    await rig.until(lambda: rig.speed > 3.0)
    answer = await program.call(name)
    assert answer["success"], answer
    await anyio.sleep(4.0)
    if name != "~/go_home":
        assert rig.speed < 2.0  # a landing comes down
    assert rig.client.state.mission in ("", "no mission")
    if name in ("~/land", "~/go_home"):
        await rig.until(lambda: not rig.motors_on, 120.0)


async def test_speeds_are_not_flown_meanwhile(rig: Rig, program: Program) -> None:
    await begun(rig, program)
    await rig.until(lambda: rig.speed > 3.0)
    await program.fly(1.0, -3.0)
    assert "mission flies" in rig.texts
    assert rig.client.state.mission == "waypoint mission"


async def test_nothing_is_uploaded_or_started_without_control(rig: Rig, program: Program) -> None:
    answer = await program.call("~/mission/upload", UPLOAD, **mission(*around(rig)))
    assert not answer["success"]
    answer = await program.call("~/mission/start", START, take_off=True)
    assert "what to do:   call ~/obtain_control first" in answer["message"]
    for name in ("pause", "resume", "stop"):
        assert not (await program.call(f"~/mission/{name}"))["success"]
    assert not rig.motors_on


async def test_what_cannot_be_flown_is_refused_at_the_upload(rig: Rig, program: Program) -> None:
    assert (await program.call("~/obtain_control"))["success"]
    far = point(0, 0) | {"latitude": 10.0}
    bad = {
        "from the one before it": mission(*around(rig), far),
        "waypoints": mission(around(rig)[0]),
        "is no number": mission(*around(rig), point(0, 0) | {"latitude": math.nan}),
        "speed": mission(*around(rig), speed=40.0),
        "an action 9": mission(*around(rig), point(0, 0, actions=[{"kind": 9, "value": 0.0}])),
        "choose one of 0 HOVER": mission(*around(rig), at_end=9),
    }
    for what, request in bad.items():
        answer = await program.call("~/mission/upload", UPLOAD, **request)
        assert not answer["success"], what
        assert what in answer["message"] or what == "is no number", answer
    answer = await program.call("~/mission/start", START, take_off=True)
    assert "no plan" in answer["message"]
    assert not rig.motors_on


async def test_older_firmware_has_no_missions() -> None:
    async with Rig(firmware="1.0").running() as rig:
        assert (await rig.program.call("~/obtain_control"))["success"]
        await rig.program.call("~/mission/upload", UPLOAD, **mission(*around(rig)))
        answer = await rig.program.call("~/mission/start", START, take_off=True)
        assert not answer["success"]
        assert "3.1" in answer["message"]
        assert not rig.motors_on


def test_a_plan_has_all_that_was_asked() -> None:
    actions = [{"kind": 0, "value": 2.5}, {"kind": 1, "value": 0.0}]
    first = point(0, 0, heading=90.0, gimbal_pitch=-45.0, damping=2.0, actions=actions)
    second = point(50, 0, turn_counterclockwise=True)
    plan = plan_of(
        mission(
            first,
            second,
            heading=3,
            at_end=1,
            on_rc_loss=1,
            repeat=2,
            gimbal_by_point=True,
        )
    )
    assert (plan.heading, plan.trace) == (Heading.BY_WAYPOINT, Trace.STOP_AT_POINTS)
    assert (plan.at_end, plan.on_rc_loss) == (AtEnd.GO_HOME, OnRCLoss.CONTINUE)
    assert (plan.repeat, plan.gimbal_by_waypoint, plan.max_speed) == (2, True, 10.0)
    one, other = plan.waypoints
    assert (one.heading_deg, one.gimbal_pitch_deg, one.damping) == (90, -45, 2.0)
    assert one.actions == (Stay(2.5), TakePhoto())
    assert (one.turn_clockwise, other.turn_clockwise) == (True, False)


# -- the gimbal by a service and a topic; the truth is the aircraft's ------------------------------


POINT = "m100_msgs/srv/PointGimbal"


def asked(**more: Any) -> dict[str, Any]:
    angles = dict.fromkeys(("yaw", "pitch", "roll", "duration"), 0.0)
    flags = dict.fromkeys(("is_relative", "keep_yaw", "keep_pitch", "keep_roll"), False)
    return {**angles, **flags, **more}


def rates(program: Program, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> None:
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    program.publish("~/gimbal_speed", {"header": header, "vector": {"x": x, "y": y, "z": z}})


async def test_it_points_where_it_is_ordered(rig: Rig, program: Program) -> None:
    assert (await program.call("~/obtain_control"))["success"]
    answer = await program.call("~/point_gimbal", POINT, **asked(pitch=-60.0, keep_yaw=True))
    assert answer["success"], answer
    await anyio.sleep(3.0)
    assert rig.aircraft.vehicle.gimbal.pitch == pytest.approx(-60.0, abs=1.0)


async def test_it_turns_as_long_as_ordered(rig: Rig, program: Program) -> None:
    assert (await program.call("~/obtain_control"))["success"]
    before = rig.aircraft.vehicle.gimbal.pitch
    for _ in range(20):
        rates(program, y=math.radians(20.0))  # about the axis to the left: down
        await anyio.sleep(0.05)
    await anyio.sleep(2.0)
    turned = rig.aircraft.vehicle.gimbal.pitch - before
    assert turned == pytest.approx(-29.0, abs=6.0)  # a second, and half of one after the last
    await anyio.sleep(2.0)
    assert rig.aircraft.vehicle.gimbal.pitch - before == pytest.approx(turned, abs=0.1)


async def test_without_control_it_stays(rig: Rig, program: Program) -> None:
    before = rig.aircraft.vehicle.gimbal.pitch
    answer = await program.call("~/point_gimbal", POINT, **asked(pitch=-60.0))
    assert "what to do:   call ~/obtain_control first" in answer["message"]
    rates(program, y=1.0)
    await anyio.sleep(2.0)
    assert rig.aircraft.vehicle.gimbal.pitch == before
    assert "~/gimbal_speed: ROS has no control" in rig.texts


@pytest.mark.parametrize("value", [math.nan, math.inf, 100.0])
async def test_angles_that_it_does_not_have_are_refused(
    rig: Rig, program: Program, value: float
) -> None:
    assert (await program.call("~/obtain_control"))["success"]
    answer = await program.call("~/point_gimbal", POINT, **asked(pitch=value))
    assert not answer["success"]
    assert "pitch" in answer["message"]
    rates(program, y=value)
    await anyio.sleep(0.5)
    assert "~/gimbal_speed: " in rig.texts


async def test_older_firmware_says_so() -> None:
    async with Rig(firmware="1.0").running() as rig:
        assert (await rig.program.call("~/obtain_control"))["success"]
        answer = await rig.program.call("~/point_gimbal", POINT, **asked(pitch=-60.0))
        assert not answer["success"]
        assert "2.3" in answer["message"]


def test_each_axis_can_be_left_alone() -> None:
    assert angles_of(asked()).mode == 1
    assert angles_of(asked(is_relative=True)).mode == 0
    assert angles_of(asked(keep_yaw=True)).mode == 3
    assert angles_of(asked(keep_roll=True)).mode == 5
    assert angles_of(asked(keep_pitch=True)).mode == 9


def given() -> tuple[GimbalServices, Any, Any, list[Any]]:
    """What turns the gimbal, its agent, what waits, and what was asked of the agent."""
    asks: list[Any] = []
    waiting: Any = SimpleNamespace(messages=[])
    waiting.take = lambda: [(None, one) for one in waiting.messages]

    def spawn(work: Any, _name: str) -> None:
        asks.append(work.cr_frame.f_locals["message"])
        work.close()

    agent: Any = SimpleNamespace(now=7.0, background=SimpleNamespace(spawn=spawn))
    nobody: Any = None
    return GimbalServices(agent, nobody, waiting, nobody), agent, waiting, asks


@pytest.mark.parametrize(
    ("pause", "is_deaf", "count", "is_busy", "is_sent"),
    [
        (0.0, False, 2, False, True),
        (0.0, True, 2, False, False),  # what came while it stood still is old
        (0.0, False, 0, False, False),
        (0.0, False, 2, True, False),  # one at a time
        (0.049, False, 1, False, False),
        (0.05, False, 1, False, True),
    ],
)
def test_rates_go_out_twenty_times_a_second_the_newest_first(
    pause: float, is_deaf: bool, count: int, is_busy: bool, is_sent: bool
) -> None:
    one, agent, waiting, sent = given()
    if pause:
        waiting.messages = [{"vector": {}}]
        one.advance(is_deaf=False)
        sent.clear()
        agent.now = 7.0 + pause
        one._is_busy = False
    one._is_busy = is_busy or one._is_busy
    waiting.messages = [{"vector": number} for number in range(count)]
    one.advance(is_deaf=is_deaf)
    assert sent == [{"vector": count - 1}] * is_sent
    assert one._is_busy is (is_sent or is_busy)


def test_rad_s_about_forward_left_and_up_are_degrees_of_the_gimbal() -> None:
    """Roll about forward; pitch up, which REP 103 has negative about left; yaw clockwise."""
    rates = rates_of({"x": 0.1, "y": -0.2, "z": 0.3})
    found = (rates.roll_deg_s, rates.pitch_deg_s, rates.yaw_deg_s)
    assert found == pytest.approx((5.729578, 11.459156, -17.188734))


# -- the package m100_msgs, as rosbags reads its files: the same fields and hashes as here ---------


FILES = sorted(MESSAGES.rglob("*.msg"))
OWN = [one for one in DEFINITIONS if one.startswith(f"{OWN_PACKAGE}/") and one.count("/") == 1]


OWN_SERVICES = [one for one in SERVICES if one.startswith(f"{OWN_PACKAGE}/")]


def of_file(path: Path) -> str:
    return f"{OWN_PACKAGE}/{path.stem}"


def test_each_message_has_a_file_and_is_built() -> None:
    assert {of_file(path) for path in FILES} == set(OWN)
    built = re.findall(
        r'"((?:msg|srv|action)/\w+\.\w+)"', (MESSAGES / "CMakeLists.txt").read_text()
    )
    there = [str(one.relative_to(MESSAGES)) for one in MESSAGES.rglob("*.*")]
    assert sorted(built) == sorted(
        one for one in there if one.endswith((".msg", ".srv", ".action"))
    )


@pytest.mark.parametrize("release", ["ROS2_JAZZY", "ROS2_KILTED", "LATEST"])
@pytest.mark.parametrize("path", FILES, ids=of_file)
def test_files_have_the_hashes_of_the_node(path: Path, release: str) -> None:
    typesys = judge()
    store = typesys.get_typestore(getattr(typesys.Stores, release))
    for one in FILES:  # they stand in each other
        store.register(typesys.get_types_from_msg(one.read_text(), full_name(of_file(one))))
    name = full_name(of_file(path))
    assert store.hash_rihs01(name) == type_hash(of_file(path))


@pytest.mark.parametrize("name", ACTIONS)
def test_actions_have_the_fields_of_their_files(name: str) -> None:
    text = (MESSAGES / "action" / f"{name.rpartition('/')[2]}.action").read_text()
    text = re.sub(r"#.*", "", text)
    parts = ["\n".join(one.split("\n")) for one in text.split("---")]
    fields = ["\n".join(line for line in part.splitlines() if line.strip()) for part in parts]
    assert tuple(fields) == ACTIONS[name]


@pytest.mark.parametrize("name", OWN_SERVICES)
def test_services_have_the_fields_of_their_files(name: str) -> None:
    text = (MESSAGES / "srv" / f"{name.rpartition('/')[2]}.srv").read_text()
    parts = re.sub(r"#.*|uint8 \w+=\d+", "", text).split("---")
    fields = ["\n".join(line for line in part.splitlines() if line.strip()) for part in parts]
    assert tuple(fields) == SERVICES[name]


@pytest.mark.parametrize("name", ACTIONS)
def test_parts_of_actions_have_the_hashes_of_rosbags(name: str) -> None:
    typesys = judge()
    store = typesys.get_typestore(typesys.Stores.LATEST)
    for path in FILES:
        store.register(typesys.get_types_from_msg(path.read_text(), full_name(of_file(path))))
    for part in ("Goal", "Result", "Feedback", "FeedbackMessage"):
        text = DEFINITIONS[f"{name}_{part}"].replace(f"{name}_Feedback ", "Feedback_ ")
        inner = f"{name}_Feedback"
        if part == "FeedbackMessage":
            text = DEFINITIONS[f"{name}_{part}"]
            assert inner in text
            continue  # rosbags has no messages named by three words within another
        store.register(typesys.get_types_from_msg(text, f"{name}_{part}"))
        assert store.hash_rihs01(f"{name}_{part}") == type_hash(f"{name}_{part}")


def constants(file: str) -> dict[str, int]:
    text = (MESSAGES / file).read_text()
    return {name: int(number) for name, number in re.findall(r"uint8 (\w+)=(\d+)", text)}


def test_numbers_of_missions_are_those_of_the_library() -> None:
    found = constants("srv/UploadMission.srv")
    expected = {one.name: one.value for kind in (Heading, Trace, AtEnd, OnRCLoss) for one in kind}
    expected["BY_POINT"] = expected.pop("BY_WAYPOINT")  # they are called points here
    assert found == expected
    assert list(constants("msg/MissionAction.msg")) == list(MISSION_ACTIONS)
    assert list(constants("msg/MissionAction.msg").values()) == list(range(len(MISSION_ACTIONS)))


def test_phases_are_those_of_the_protocol() -> None:
    assert constants("msg/FlightStatus.msg") == {one.name: one.value for one in FlightPhase} | {
        "UNKNOWN": 255
    }
