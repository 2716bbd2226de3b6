"""A program of rclpy that knows nothing of m100link: `python real.py WHAT`, in a ROS 2.

``checks`` prints a line of each check, ``ok NAME`` or ``no NAME: why``.
"""

from __future__ import annotations

import math
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from statistics import median
from typing import Any

import rclpy
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped
from m100_msgs.action import FlyTo, TakeOff
from m100_msgs.msg import FlightStatus
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Log
from rclpy.action import ActionClient, get_action_names_and_types
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from sensor_msgs.msg import BatteryState, Imu, NavSatFix
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage
from type_description_interfaces.srv import GetTypeDescription

WAIT_S = 30.0
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
TOPICS = {
    "/m100/imu": "sensor_msgs/msg/Imu",
    "/m100/fix": "sensor_msgs/msg/NavSatFix",
    "/m100/odom": "nav_msgs/msg/Odometry",
    "/m100/pose": "geometry_msgs/msg/PoseStamped",
    "/m100/velocity": "geometry_msgs/msg/TwistStamped",
    "/m100/battery": "sensor_msgs/msg/BatteryState",
    "/m100/joy": "sensor_msgs/msg/Joy",
    "/m100/gimbal": "geometry_msgs/msg/QuaternionStamped",
    "/m100/flight_status": "m100_msgs/msg/FlightStatus",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "/m100/cmd_vel": "geometry_msgs/msg/TwistStamped",
}
TRIGGERS = ("obtain_control", "release_control", "takeoff", "land", "go_home", "arm", "stop")


def until(what: Callable[[], Any], within: float = WAIT_S) -> Any:
    ends = time.monotonic() + within
    while not (found := what()):
        if time.monotonic() > ends:
            raise AssertionError(f"not within {within:g} s")
        time.sleep(0.02)
    return found


def stamp_of(message: Any) -> float:
    stamp = message.header.stamp
    return float(stamp.sec + stamp.nanosec / 1e9)


class Program:
    """A node that listens, and whose executor runs beside."""

    def __init__(self, name: str) -> None:
        self.node = rclpy.create_node(name)
        self.heard: dict[str, list[Any]] = {}
        executor = SingleThreadedExecutor()
        executor.add_node(self.node)
        threading.Thread(target=executor.spin, daemon=True).start()
        self.speeds = self.node.create_publisher(TwistStamped, "/m100/cmd_vel", 10)

    def listen(self, kind: Any, topic: str, qos: Any = qos_profile_sensor_data) -> None:
        heard = self.heard.setdefault(topic, [])
        self.node.create_subscription(kind, topic, heard.append, qos)

    def some(self, topic: str, seconds: float) -> list[Any]:
        """What comes from now on."""
        self.heard[topic].clear()
        time.sleep(seconds)
        return list(self.heard[topic])

    def done(self, future: Any, within: float = WAIT_S) -> Any:
        until(future.done, within)
        return future.result()

    def ask(self, kind: Any, name: str, request: Any) -> Any:
        client = self.node.create_client(kind, name)
        assert client.wait_for_service(WAIT_S), f"no service {name}"
        return self.done(client.call_async(request))

    def call(self, name: str) -> Any:
        return self.ask(Trigger, f"/m100/{name}", Trigger.Request())

    @property
    def odom(self) -> Any:
        return self.heard["/m100/odom"][-1]

    @property
    def place(self) -> tuple[float, float, float]:
        at = self.odom.pose.pose.position
        return at.x, at.y, at.z

    @property
    def yaw(self) -> float:
        turned = self.odom.pose.pose.orientation
        return math.atan2(
            2 * (turned.w * turned.z + turned.x * turned.y), 1 - 2 * (turned.y**2 + turned.z**2)
        )

    @property
    def speed(self) -> float:
        """Horizontal, m/s."""
        moves = self.odom.twist.twist.linear
        return math.hypot(moves.x, moves.y)

    def say(self, x: float, y: float = 0.0, turn: float = 0.0, **more: Any) -> None:
        told = TwistStamped()
        told.header.frame_id = more.get("frame", "base_link")
        if made_at := more.get("made_at", 0.0):
            told.header.stamp.sec = int(made_at)
            told.header.stamp.nanosec = int(made_at % 1 * 1e9)
        told.twist.linear.x, told.twist.linear.y, told.twist.angular.z = x, y, turn
        (more.get("by") or self.speeds).publish(told)

    def fly(self, seconds: float, x: float, y: float = 0.0, turn: float = 0.0, **more: Any) -> None:
        for _ in range(round(20 * seconds)):
            self.say(x, y, turn, **more)
            time.sleep(0.05)

    def rests(self) -> None:
        until(lambda: self.speed < 0.3, 5.0)

    def goal(self, kind: Any, name: str, goal: Any, heard: list[Any] | None = None) -> Any:
        client = ActionClient(self.node, kind, f"/m100/{name}")
        assert client.wait_for_server(WAIT_S), f"no action {name}"
        hear = None if heard is None else heard.append
        return self.done(client.send_goal_async(goal, feedback_callback=hear))

    def north_of_here(self, metres: float) -> FlyTo.Goal:
        fix = self.heard["/m100/fix"][-1]
        latitude = fix.latitude + math.degrees(metres / 6_367_000.0)
        return FlyTo.Goal(latitude=latitude, longitude=fix.longitude, height=5.0, speed=4.0)


class Checks(Program):
    """Its checks, in the order of one flight."""

    def listens(self) -> None:
        self.listen(Odometry, "/m100/odom")
        self.listen(Imu, "/m100/imu")
        self.listen(NavSatFix, "/m100/fix")
        self.listen(BatteryState, "/m100/battery")
        self.listen(FlightStatus, "/m100/flight_status", LATCHED)
        self.listen(TFMessage, "/tf", 100)
        self.listen(TFMessage, "/tf_static", LATCHED)
        self.listen(DiagnosticArray, "/diagnostics", 10)
        self.listen(PoseStamped, "/m100/pose")
        late = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.listen(Log, "/rosout", late)
        until(lambda: all(self.heard[one] for one in self.heard))

    # -- the graph -------------------------------------------------------------------------------

    def node_is_in_the_graph(self) -> None:
        assert ("m100", "/") in self.node.get_node_names_and_namespaces()

    def topics_have_their_types(self) -> None:
        there = dict(self.node.get_topic_names_and_types())
        for topic, kind in TOPICS.items():
            assert there.get(topic) == [kind], (topic, there.get(topic))

    def services_have_their_types(self) -> None:
        there = dict(self.node.get_service_names_and_types())
        for name in TRIGGERS:
            assert there.get(f"/m100/{name}") == ["std_srvs/srv/Trigger"], name

    def actions_are_listed(self) -> None:
        there = dict(get_action_names_and_types(self.node))
        assert there["/m100/take_off"] == ["m100_msgs/action/TakeOff"]
        assert there["/m100/fly_to"] == ["m100_msgs/action/FlyTo"]

    def qualities_are_as_told(self) -> None:
        for topic, reliable, latched in (
            ("/m100/imu", False, False),
            ("/tf", True, False),
            ("/tf_static", True, True),
            ("/m100/flight_status", True, True),
        ):
            [one] = self.node.get_publishers_info_by_topic(topic)
            qos = one.qos_profile
            assert (qos.reliability is ReliabilityPolicy.RELIABLE) is reliable, topic
            assert (qos.durability is DurabilityPolicy.TRANSIENT_LOCAL) is latched, topic

    def type_hashes_are_those_of_this_ros(self) -> None:
        ours = self.node.create_publisher(FlightStatus, "/mine", 1)
        [mine] = until(lambda: self.node.get_publishers_info_by_topic("/mine"))
        [there] = self.node.get_publishers_info_by_topic("/m100/flight_status")
        assert str(there.topic_type_hash) == str(mine.topic_type_hash)
        self.node.destroy_publisher(ours)

    def types_are_described(self) -> None:
        asked = GetTypeDescription.Request(type_name="m100_msgs/msg/FlightStatus")
        told = self.ask(GetTypeDescription, "/m100/get_type_description", asked)
        assert told.successful, told.failure_reason
        names = [one.name for one in told.type_description.type_description.fields]
        assert names[:2] == ["header", "phase"]

    # -- what the node reports ------------------------------------------------------------------

    def rates_are_as_told(self) -> None:
        for topic, pause in (("/m100/imu", 0.02), ("/m100/odom", 0.02), ("/m100/fix", 0.1)):
            stamps = [stamp_of(one) for one in self.some(topic, 4.0)]
            pauses = [after - before for before, after in pairwise(stamps)]
            assert min(pauses) > 0.0, f"{topic}: stamps go back"
            assert abs(median(pauses) - pause) < 0.1 * pause, (topic, median(pauses))

    def stamps_are_of_now(self) -> None:
        assert abs(stamp_of(self.odom) - time.time()) < 1.0

    def odometry_is_in_its_frames(self) -> None:
        assert (self.odom.header.frame_id, self.odom.child_frame_id) == ("odom", "base_link")
        turned = self.odom.pose.pose.orientation
        assert abs(math.hypot(turned.x, turned.y, turned.z, turned.w) - 1.0) < 1e-3

    def gravity_is_felt(self) -> None:
        assert abs(self.heard["/m100/imu"][-1].linear_acceleration.z - 9.81) < 0.5

    def transforms_are_the_odometry(self) -> None:
        self.heard["/tf"].clear()
        poses = {stamp_of(one): one.pose.pose for one in self.some("/m100/odom", 2.0)}
        moves = [one.transforms[0] for one in self.heard["/tf"]]
        same = [one for one in moves if stamp_of(one) in poses]
        assert len(same) > 50, f"{len(same)} of {len(moves)} share a stamp"
        for one in same:
            at, moved = poses[stamp_of(one)].position, one.transform.translation
            assert (moved.x, moved.y, moved.z) == (at.x, at.y, at.z)

    def who_comes_late_gets_what_stands(self) -> None:
        self.listen(TFMessage, "/tf_static", LATCHED)
        [standing] = until(lambda: self.heard["/tf_static"])[-1].transforms
        assert (standing.header.frame_id, standing.child_frame_id) == ("map", "odom")
        assert any("connected" in one.msg for one in self.heard["/rosout"])

    def battery_is_a_part_of_one(self) -> None:
        assert 0.5 < self.heard["/m100/battery"][-1].percentage <= 1.0

    def it_stands_on_the_ground(self) -> None:
        assert self.heard["/m100/flight_status"][-1].phase == 1

    def diagnostics_are_ok(self) -> None:
        told = {one.name: one for one in self.heard["/diagnostics"][-1].status}
        assert told["m100: line"].level == b"\0", told["m100: line"].message
        assert told["m100: navigation"].level == b"\0", told["m100: navigation"].message

    # -- parameters ------------------------------------------------------------------------------

    def parameters_are_listed_and_set(self) -> None:
        there = AsyncParameterClient(self.node, "m100")
        assert there.wait_for_services(WAIT_S)
        assert "rates.imu" in self.done(there.list_parameters([], 0)).result.names
        [known] = self.done(there.describe_parameters(["rates.imu"])).descriptors
        assert not known.read_only

        def set_to(name: str, value: float) -> Any:
            wanted = [Parameter(name, Parameter.Type.DOUBLE, value)]
            return self.done(there.set_parameters(wanted)).results[0]

        assert set_to("rates.imu", 5.0).successful
        stamps = [stamp_of(one) for one in self.some("/m100/imu", 4.0)][3:]
        pauses = [after - before for before, after in pairwise(stamps)]
        assert abs(median(pauses) - 0.2) < 0.02, median(pauses)
        assert set_to("rates.imu", 50.0).successful
        for name, value in (("rates.imu", math.nan), ("guards.max_height_m", 500.0), ("x", 1.0)):
            refused = set_to(name, value)
            assert not refused.successful, name
            assert refused.reason, name

    # -- a flight --------------------------------------------------------------------------------

    def nothing_flies_without_control(self) -> None:
        refused = self.call("takeoff")
        assert not refused.success
        assert "obtain_control" in refused.message
        self.fly(1.0, 2.0)
        assert self.place[2] < 0.3

    def a_goal_takes_off(self) -> None:
        assert self.call("obtain_control").success
        heard: list[Any] = []
        goal = self.goal(TakeOff, "take_off", TakeOff.Goal(height=5.0), heard)
        assert goal.accepted
        told = self.done(goal.get_result_async(), 60.0)
        assert told.status == GoalStatus.STATUS_SUCCEEDED, told.result.message
        assert heard
        assert abs(heard[-1].feedback.height - self.place[2]) < 3.0
        assert abs(self.place[2] - 5.0) < 0.6, self.place

    def forward_is_x_of_the_body(self) -> None:
        self.fly(3.0, 1.0)
        assert abs(self.odom.twist.twist.linear.x - 1.0) < 0.25

    def silence_is_a_hover(self) -> None:
        self.fly(1.5, 2.0)
        self.rests()

    def left_is_y_of_the_body(self) -> None:
        self.fly(3.0, 0.0, 1.0)
        assert abs(self.odom.twist.twist.linear.y - 1.0) < 0.25
        self.rests()

    def x_of_odom_is_east(self) -> None:
        before = self.place
        self.fly(3.0, 1.0, frame="odom")
        east, north = self.place[0] - before[0], self.place[1] - before[1]
        assert east > 1.5, (east, north)
        assert abs(north) < 0.7, (east, north)
        self.rests()

    def a_turn_is_counter_clockwise(self) -> None:
        before = self.yaw
        self.fly(2.0, 0.0, turn=0.5)
        turned = math.remainder(self.yaw - before, math.tau)
        assert 0.6 < turned < 1.4, turned

    def what_is_no_speed_is_not_flown(self) -> None:
        self.fly(1.0, math.nan)
        self.fly(1.0, 2.0, frame="nowhere")
        self.fly(1.0, 1e9)
        self.rests()
        assert self.speed < 0.3

    def one_publisher_flies_at_a_time(self) -> None:
        other = self.other()
        for _ in range(60):
            self.say(1.0)
            self.say(-3.0, by=other)
            time.sleep(0.05)
        assert abs(self.odom.twist.twist.linear.x - 1.0) < 0.4
        before = self.place
        self.fly(3.0, -3.0, by=other)  # the first one is silent: nobody takes over in its stride
        assert self.speed < 0.3
        assert math.dist(before[:2], self.place[:2]) < 2.5
        time.sleep(0.8)
        self.fly(1.5, -1.0, by=other)
        assert self.odom.twist.twist.linear.x < -0.5, "who paused may fly"
        self.node.destroy_publisher(other)
        self.rests()

    def other(self) -> Any:
        made = self.node.create_publisher(TwistStamped, "/m100/cmd_vel", 10)
        until(lambda: made.get_subscription_count() > 0)
        time.sleep(1.0)
        return made

    def a_flood_flies_as_it_asks(self) -> None:
        other, ends, fastest = self.other(), time.monotonic() + 3.0, 0.0
        while time.monotonic() < ends:
            for _ in range(20):
                self.say(2.0, by=other)
            fastest = max(fastest, self.speed)
            time.sleep(0.001)
        assert 1.0 < fastest < 2.6, fastest
        self.rests()

    def a_late_stamp_is_not_flown(self) -> None:
        time.sleep(1.0)
        self.fly(2.0, 1.0, made_at=time.time())  # constant: its delay grows
        self.rests()
        time.sleep(1.0)
        before = self.place
        self.fly(2.0, 2.0, made_at=time.time() - 3600.0)
        assert math.dist(before, self.place) < 1.0

    def a_goal_flies_to_a_place(self) -> None:
        wanted, before = self.north_of_here(12.0), self.place
        goal = self.goal(FlyTo, "fly_to", wanted)
        refused = self.goal(FlyTo, "fly_to", wanted)
        assert goal.accepted
        assert not refused.accepted
        told = self.done(goal.get_result_async(), 60.0)
        assert told.status == GoalStatus.STATUS_SUCCEEDED, told.result.message
        assert abs(self.place[1] - before[1] - 12.0) < 1.5

    def a_goal_is_cancelled(self) -> None:
        heard: list[Any] = []
        goal = self.goal(FlyTo, "fly_to", self.north_of_here(60.0), heard)
        until(lambda: self.speed > 2.5)
        assert self.done(goal.cancel_goal_async()).goals_canceling
        told = self.done(goal.get_result_async())
        assert told.status == GoalStatus.STATUS_CANCELED
        assert heard
        self.rests()

    def a_goal_outside_is_aborted(self) -> None:
        before = self.place
        goal = self.goal(FlyTo, "fly_to", self.north_of_here(5000.0))
        told = self.done(goal.get_result_async())
        assert told.status == GoalStatus.STATUS_ABORTED
        assert "envelope" in told.result.message or "m" in told.result.message
        assert math.dist(before, self.place) < 1.0

    def it_lands_and_gives_control_back(self) -> None:
        assert self.call("land").success
        until(lambda: self.heard["/m100/flight_status"][-1].phase == 1, 60.0)
        until(lambda: not self.heard["/m100/flight_status"][-1].has_authority)


def checks() -> None:
    program = Checks("checker")
    program.listens()
    for name, check in vars(Checks).items():
        if name.startswith("_") or name in ("listens", "other"):
            continue
        try:
            check(program)
        except Exception as error:  # noqa: BLE001 - the report names it
            print(f"no {name}: {error!r}", flush=True)
        else:
            print(f"ok {name}", flush=True)


@contextmanager
def flying(name: str) -> Iterator[Program]:
    program = Program(name)
    program.listen(Odometry, "/m100/odom")
    program.listen(NavSatFix, "/m100/fix")
    until(lambda: all(program.heard.values()))
    assert program.call("obtain_control").success
    goal = program.goal(TakeOff, "take_off", TakeOff.Goal(height=5.0))
    program.done(goal.get_result_async(), 60.0)
    print("flies", flush=True)
    yield program


def steer() -> None:
    """Fly forward at 3 m/s, until killed."""
    with flying("steerer") as program:
        program.fly(1e6, 3.0)


def goal() -> None:
    """Fly to a place far away."""
    with flying("asker") as program:
        program.goal(FlyTo, "fly_to", program.north_of_here(120.0))
        time.sleep(1e6)


def call() -> None:
    program = Program("caller")
    for name in sys.argv[2:]:
        told = program.call(name)
        print(name, told.success, told.message, flush=True)


if __name__ == "__main__":
    rclpy.init()
    {"checks": checks, "steer": steer, "goal": goal, "call": call}[sys.argv[1]]()
    sys.stdout.flush()
    os._exit(0)  # the executor's thread spins still
