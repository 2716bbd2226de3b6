"""A ROS program made of zenoh-ros2-sdk, which was written by others: `python sdk.py PORT WHAT …`.

Its message files come from rosbags: it would take them from the network otherwise.
"""

from __future__ import annotations

import json
import os
import re
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from rosbags.typesys import Stores, get_typestore

from m100link.apps.ros2 import MESSAGES

sdk: Any = import_module("zenoh_ros2_sdk")
registry: Any = import_module("zenoh_ros2_sdk.message_registry")

EMPTY = "uint8 structure_needs_at_least_one_member"
TRIGGER = {"request_definition": EMPTY, "response_definition": "bool success\nstring message"}
SEEN = {
    "imu": "sensor_msgs/msg/Imu",
    "fix": "sensor_msgs/msg/NavSatFix",
    "odom": "nav_msgs/msg/Odometry",
    "pose": "geometry_msgs/msg/PoseStamped",
    "velocity": "geometry_msgs/msg/TwistStamped",
    "battery": "sensor_msgs/msg/BatteryState",
    "magnetic_field": "sensor_msgs/msg/MagneticField",
    "joy": "sensor_msgs/msg/Joy",
    "gimbal": "geometry_msgs/msg/QuaternionStamped",
    "flight_status": "m100_msgs/msg/FlightStatus",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "/rosout": "rcl_interfaces/msg/Log",
    "/clock": "rosgraph_msgs/msg/Clock",
}

PACKAGES = {kind.partition("/")[0] for kind in SEEN.values()} | {"builtin_interfaces", "std_msgs"}


def write_messages(folder: Path) -> None:
    """The files of all messages, as the SDK looks for them."""
    store = get_typestore(Stores.LATEST)
    for name in store.fielddefs:
        if name.partition("/")[0] not in PACKAGES:
            continue
        text = str(store.generate_msgdef(name, ros_version=2)[0]).split("=" * 80)[0]
        path = folder / f"{name}.msg"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    for own in MESSAGES.rglob("*.msg"):
        path = folder / "m100_msgs" / "msg" / own.name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(own.read_text(encoding="utf-8"), encoding="utf-8")


class Program:
    """What the SDK makes of a router and a node's name."""

    def __init__(self, port: int, node: str = "/m100") -> None:
        self.node = node
        self.way: dict[str, Any] = {"router_ip": "127.0.0.1", "router_port": port}
        self.types = sdk.ZenohSession.get_instance("127.0.0.1", port).store.types

    def full(self, name: str) -> str:
        return name if name.startswith("/") else f"{self.node}/{name}"

    def hear(self, name: str, kind: str, callback: Callable[[Any], object], **more: Any) -> None:
        sdk.ROS2Subscriber(
            topic=self.full(name), msg_type=kind, callback=callback, **more, **self.way
        )

    def call(self, name: str) -> Any:
        client = sdk.ROS2ServiceClient(
            service_name=self.full(name),
            srv_type="std_srvs/srv/Trigger",
            timeout=30.0,
            **TRIGGER,
            **self.way,
        )
        return client.call(structure_needs_at_least_one_member=0)

    def speeds(self) -> Callable[..., None]:
        kind = "geometry_msgs/msg/TwistStamped"
        publisher = sdk.ROS2Publisher(topic=self.full("cmd_vel"), msg_type=kind, **self.way)
        vector, made = self.types["geometry_msgs/msg/Vector3"], self.types

        def send(x: float, y: float = 0.0, z: float = 0.0) -> None:
            stamp = made["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
            publisher.publish(
                header=made["std_msgs/msg/Header"](stamp=stamp, frame_id="base_link"),
                twist=made["geometry_msgs/msg/Twist"](
                    linear=vector(x=x, y=y, z=z), angular=vector(x=0.0, y=0.0, z=0.0)
                ),
            )

        return send


def told(message: Any) -> Any:
    """A message as JSON carries it."""
    if hasattr(message, "__dataclass_fields__"):
        fields = (one for one in message.__dataclass_fields__ if one != "__msgtype__")
        return {one: told(getattr(message, one)) for one in fields}
    if hasattr(message, "tolist"):
        return message.tolist()
    return [told(one) for one in message] if isinstance(message, list) else message


def keep(found: dict[str, Any], name: str, message: Any) -> None:
    found[name] = told(message)


def look(program: Program) -> None:
    """What is in the graph, and one message of each topic."""
    found: dict[str, Any] = {}
    for name, kind in SEEN.items():
        program.hear(name, kind, partial(keep, found, name))
    ends = time.monotonic() + 60.0
    # Of a simulator there is no magnetometer, of one in another process no clock, and what was said
    # before is not asked for.
    waited = SEEN.keys() - {"/clock", "/rosout", "magnetic_field"}
    while not found.keys() >= waited and time.monotonic() < ends:
        time.sleep(0.1)
    topics: dict[str, Any] = {}
    services: dict[str, Any] = {}
    seen, same = 0, 0
    while same < 5:  # it does not wait for all of the graph: until nothing new came five times
        topics |= dict(sdk.get_topic_names_and_types(**program.way))
        services |= dict(sdk.get_service_names_and_types(**program.way))
        before, seen = seen, len(topics) + len(services)
        same = same + 1 if seen == before else 0
        time.sleep(1.0)
    print(json.dumps({"topics": topics, "services": services, "messages": found}))


def fly(program: Program) -> None:
    """Up, along, down; what services answer."""
    for name in ("obtain_control", "takeoff"):
        answer = program.call(name)
        print(name, answer and answer.success, flush=True)
    time.sleep(8.0)
    send = program.speeds()
    for _ in range(100):
        send(2.0)
        time.sleep(0.05)
    time.sleep(2.0)
    answer = program.call("land")
    print("land", answer and answer.success, flush=True)


def steer(program: Program) -> None:
    """Forward, 3 m/s, for ever."""
    send = program.speeds()
    print("steers", flush=True)
    while True:
        send(3.0)
        time.sleep(0.05)


def main() -> None:
    port, node, what, *words = sys.argv[1:]
    with tempfile.TemporaryDirectory() as folder:
        write_messages(Path(folder))
        registry.get_registry().messages_dir = Path(folder)
        program = Program(int(port), node)
        if what == "call":
            for word in words:
                answer = program.call(word)
                shown = re.sub(r"\s+", " ", answer.message) if answer else "no answer"
                print(word, bool(answer and answer.success), shown, flush=True)
        else:
            {"look": look, "fly": fly, "steer": steer}[what](program)
    sys.stdout.flush()


if __name__ == "__main__":
    main()
    os._exit(0)  # its threads would go on
