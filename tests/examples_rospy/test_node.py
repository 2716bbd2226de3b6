"""What programs use of rospy, on a station; and names, parameters and times without one."""

from __future__ import annotations

import asyncio
import signal
from pathlib import Path
from typing import Any

import pytest
from rospy_stand_in import node

from tests.examples_rospy.conftest import programs
from tests.waiting import PATIENCE, until

SURFACE = """
    #!/usr/bin/env python3
    import sys
    import rospy
    from std_msgs.msg import Float32, String, UInt8
    from std_srvs.srv import SetBool, SetBoolResponse
    from sensor_msgs.msg import BatteryState, Joy
    from geometry_msgs.msg import QuaternionStamped, Vector3Stamped
    from dji_sdk.srv import *
    from dji_sdk.msg import MissionWaypointTask
    from tf.transformations import euler_from_quaternion

    rospy.init_node("surface", anonymous=False)
    print(rospy.get_name(), rospy.get_namespace(), rospy.myargv())
    print(rospy.get_param("~rate"), rospy.get_param("/none", 4), rospy.has_param("none"))
    battery = rospy.wait_for_message("/dji_sdk/battery_state", BatteryState, timeout=60)
    print(battery.percentage, battery.header.stamp.to_sec() > 1.6e9)
    attitude = rospy.wait_for_message("dji_sdk/attitude", QuaternionStamped)
    q = attitude.quaternion
    print(round(euler_from_quaternion([q.x, q.y, q.z, q.w])[2], 2))
    rospy.wait_for_service("dji_sdk/query_drone_version")
    version = rospy.ServiceProxy("dji_sdk/query_drone_version", QueryDroneVersion)()
    print(hex(version.version), version.hardware)
    try:
        rospy.ServiceProxy("dji_sdk/drone_task_control", DroneTaskControl)(task=4)
    except rospy.ServiceException as error:
        print("ServiceException", "has no control" in str(error))
    try:
        rospy.wait_for_service("nowhere", timeout=0.1)
    except rospy.ROSException:
        print("ROSException")
    control = rospy.ServiceProxy("dji_sdk/sdk_control_authority", SDKControlAuthority)
    print(control(SDKControlAuthorityRequest.REQUEST_CONTROL).result)
    task = rospy.ServiceProxy("dji_sdk/drone_task_control", DroneTaskControl)
    print(task.call(DroneTaskControlRequest(DroneTaskControlRequest.TASK_TAKEOFF)).result)
    status = []
    subscriber = rospy.Subscriber("dji_sdk/flight_status", UInt8, status.append, queue_size=1)
    rate = rospy.Rate(20)
    while not status or status[-1].data != 3:
        rate.sleep()
    velocity = {}
    rospy.Subscriber("/dji_sdk/velocity", Vector3Stamped,
                     lambda message, box: box.update(east=message.vector.x), velocity)
    setpoints = rospy.Publisher(
        "/dji_sdk/flight_control_setpoint_ENUvelocity_yawrate", Joy, queue_size=1)
    print(setpoints.get_num_connections())
    while velocity.get("east", 0.0) < 0.5:
        setpoints.publish(Joy(axes=[1.0, 0.0, 0.0, 0.0]))
        rate.sleep()
    print("east")
    # Inside the program: topics, services and timers.
    heard = []
    rospy.Subscriber("chatter", String, lambda message, box: box.append(message.data), heard)
    rospy.Publisher("/chatter", String, queue_size=10).publish("hello")
    rospy.Service("switch", SetBool, lambda asked: SetBoolResponse(asked.data, "switched"))
    print(rospy.ServiceProxy("switch", SetBool)(True).message)
    ticks = []
    timer = rospy.Timer(rospy.Duration(0.01), ticks.append)
    while len(ticks) < 3 or not heard:
        rospy.sleep(0.01)
    timer.shutdown()
    print(heard, ticks[2].last_real < ticks[2].current_real)
    try:
        setpoints.publish(Joy(axes=["fast"]))
    except rospy.ROSSerializationException as error:
        print("axes" in str(error))
    rospy.loginfo("at %.1f", 2.0)
    for _ in range(3):
        rospy.logwarn_throttle(60, "once")
    rospy.on_shutdown(lambda: print("hook", rospy.is_shutdown(), task(6).result))
    rospy.signal_shutdown("done")
    print(rospy.is_shutdown())
"""


@pytest.mark.anyio
@pytest.mark.pty
async def test_what_programs_use_of_rospy(tmp_path: Path) -> None:
    async with programs(tmp_path) as one:
        said = await one.run(SURFACE, "_rate:=50", "5")
        infos = [line for line in said if line.startswith("[INFO]")]
        assert [line for line in said if line not in infos] == [
            f"/surface / ['{tmp_path}/program.py', '5']",
            "50 4 False",
            "100.0 True",
            "1.57",
            "0x3010a00 M100",
            "ServiceException True",
            "ROSException",
            "True",
            "True",
            "1",
            "east",
            "switched",
            "['hello'] True",
            "True",
            "hook False True",
            "True",
        ]
        assert infos[-1].endswith("]: at 2.0")
        assert one.error.count("]: once") == 1


@pytest.mark.anyio
@pytest.mark.pty
async def test_a_program_of_a_name_space_flies_another_aircraft_or_none(tmp_path: Path) -> None:
    program = """
        import rospy
        rospy.init_node("a")
        print(rospy.resolve_name("dji_sdk/rc"), rospy.resolve_name("b"))
    """
    async with programs(tmp_path) as one:
        said = await one.run(program, "__ns:=/m100_2", "b:=/c")
        assert said == ["/m100_2/dji_sdk/rc /c"]


HELD = """
    import rospy
    from sensor_msgs.msg import Joy
    from dji_sdk.srv import SDKControlAuthority
    rospy.init_node("held")
    rospy.ServiceProxy("dji_sdk/sdk_control_authority", SDKControlAuthority)(1)
    rospy.on_shutdown(lambda: print("hook"))
    print("ready")
    rospy.spin()
"""


@pytest.mark.anyio
@pytest.mark.pty
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
async def test_however_a_program_ends_control_goes_back(
    tmp_path: Path, how: signal.Signals
) -> None:
    async with programs(tmp_path) as one:
        process = await one.begin(HELD)
        assert process.stdout is not None
        async with asyncio.timeout(PATIENCE):
            assert await process.stdout.readline() == b"ready\n"
            assert one.station.agent.holding.has_authority
            process.send_signal(how)
            out, _ = await process.communicate()
        assert out == (b"" if how == signal.SIGKILL else b"hook\n")
        await until(lambda: not one.station.agent.holding.has_authority)


@pytest.mark.anyio
@pytest.mark.pty
async def test_an_error_ends_a_program_with_its_own_traceback(tmp_path: Path) -> None:
    async with programs(tmp_path) as one:
        await one.run("import rospy\nrospy.init_node('a')\nnone", status=1)
        assert one.error.splitlines()[0] == "Traceback (most recent call last):"
        assert "program.py" in one.error.splitlines()[1]
        assert "packages.py" not in one.error


# -- without a station ----------------------------------------------------------------------------


class NoStation:
    """A bridge to a station that has nothing."""

    topics: dict[str, str] = {}  # noqa: RUF012 - nobody changes it

    def is_of_station(self, name: str) -> bool:
        return False

    def close(self) -> None:
        pass


@pytest.fixture
def fresh(monkeypatch: pytest.MonkeyPatch) -> Any:
    made = node._Node()
    made.bridge = NoStation()  # type: ignore[assignment]  # as far as it is used here
    monkeypatch.setattr(node, "_node", made)
    monkeypatch.setattr("atexit.register", lambda *_: None)
    return made


@pytest.mark.parametrize(
    ("name", "resolved"),
    [
        ("rc", "/drone/rc"),
        ("/rc", "/rc"),
        ("~rate", "/drone/pilot/rate"),
        ("", "/drone/"),
        ("a/b/", "/drone/a/b"),
        ("old", "/elsewhere/new"),
        ("/drone/old", "/elsewhere/new"),
    ],
)
def test_names_are_resolved_as_ros_does(fresh: Any, name: str, resolved: str) -> None:
    argv = ["program", "__ns:=drone", "__name:=pilot", "old:=/elsewhere/new", "_rate:=2.5", "-x"]
    node.init_node("given", argv, disable_signals=True)
    assert node.resolve_name(name) == resolved
    assert node.get_param("~rate") == 2.5
    assert node.myargv(argv) == ["program", "-x"]


def test_a_node_begins_once_with_one_name(fresh: Any) -> None:
    node.init_node("a", [], disable_signals=True)
    node.init_node("a", [], disable_signals=True)
    with pytest.raises(node.ROSException):
        node.init_node("b", [], disable_signals=True)
    fresh.is_initialised = False
    with pytest.raises(ValueError, match="slash"):
        node.init_node("a/b")


def test_parameters_are_those_that_were_set(fresh: Any) -> None:
    node.set_param("/pid/p", 1.0)
    node.set_param("pid/i", 2.0)
    assert node.get_param("/pid") == {"p": 1.0, "i": 2.0}
    assert node.has_param("pid/p")
    node.delete_param("/pid/p")
    assert not node.has_param("pid/p")
    assert node.get_param("pid/p", 7) == 7
    with pytest.raises(KeyError, match="_name:=value"):
        node.get_param("~p")
    node.set_param("/a", {"b": {"c": 1, "d": [2]}, "e": "f"})
    assert (node.get_param("/a/b/c"), node.get_param("/a/b")) == (1, {"c": 1, "d": [2]})
    node.set_param("/a/b", 3)
    assert node.get_param("/a") == {"b": 3, "e": "f"}
    node.delete_param("/a")
    assert not node.has_param("/a/e")
    with pytest.raises(KeyError):
        node.delete_param("/a")


def test_a_shutdown_runs_its_hooks_once_and_ends_every_wait(fresh: Any) -> None:
    node.init_node("a", [], disable_signals=True)
    ran: list[bool] = []
    node.on_shutdown(lambda: ran.append(node.is_shutdown()))
    node.on_shutdown(lambda: 1 / 0)  # is printed, and ends nothing else
    node.on_shutdown(lambda: ran.append(True))
    node.signal_shutdown("now")
    node.signal_shutdown("again")
    assert ran == [False, True]
    with pytest.raises(node.ROSInterruptException):
        node.sleep(60)
    with pytest.raises(node.ROSInterruptException):
        node.Rate(1).sleep()
    with pytest.raises(node.ROSInterruptException):
        node.wait_for_service("a")
    node.spin()


@pytest.mark.parametrize("error", [node.ROSInterruptException, node.ROSSerializationException])
def test_errors_are_of_their_kinds(error: type[Exception]) -> None:
    assert issubclass(error, node.ROSException)
    assert issubclass(node.ROSInterruptException, KeyboardInterrupt)


def test_what_is_no_type_is_refused_at_once(fresh: Any) -> None:
    with pytest.raises(ValueError, match="no message class"):
        node.Publisher("a", str)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="no service class"):
        node.ServiceProxy("a", str)  # type: ignore[arg-type]
    with pytest.raises(TypeError):
        node.on_shutdown(5)  # type: ignore[arg-type]


def test_a_log_is_written_whatever_its_values(
    fresh: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    node.loginfo("%d percent", 50)
    node.loginfo("100 %")
    node.loginfo("a", 5)
    node.logdebug("not at this level")
    node.logerr("broken")
    said = capsys.readouterr()
    assert [line.partition("]: ")[2] for line in said.out.splitlines()] == [
        "50 percent",
        "100 %",
        "a 5",
    ]
    assert said.err.endswith("]: broken\n")
