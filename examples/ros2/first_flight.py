"""Take off, fly five metres by cmd_vel and land, as a program of ROS 2 without ROS.

python examples/ros2/first_flight.py                        # with a virtual aircraft of its own
python examples/ros2/first_flight.py tcp/localhost:7447     # m100link ros2 URL, rmw_zenohd there

On the wire a node of ROS 2 is plain zenoh with CDR, which rosbags writes: pip install rosbags
"""

import contextlib
import json
import math
import os
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import zenoh
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

NODE, DOMAIN = "m100", 0
# Each type has a hash by which ROS tells it from others of that name.
TRIGGER = (
    "std_srvs::srv::dds_::Trigger_/"
    "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
)
ANSWER = "std_srvs/msg/Trigger_Response"
EMPTY = b"\0\1\0\0\0"  # a request without fields has a byte all the same
PATIENCE = 90.0

store = get_typestore(Stores.LATEST)
store.register(get_types_from_msg("bool success\nstring message", ANSWER))
types = store.types


class Program:
    """A program that calls services, publishes speeds and hears the odometry."""

    def __init__(self, session: Any) -> None:
        self.session = session
        # Each end of a node has an id and counts what it sends; a publisher whose numbers are
        # missing was cut off, and is not flown on.
        self.sent: dict[str, int] = {}
        self.ids: dict[str, bytes] = {}
        odometry = f"{DOMAIN}/{NODE}/odom/nav_msgs::msg::dds_::Odometry_/*"
        self.poses = session.declare_subscriber(odometry, zenoh.handlers.RingChannel(1))

    def attachment(self, end: str) -> bytes:
        """The attachment that rmw_zenoh sends with everything: count, time and sender."""
        self.sent[end] = self.sent.get(end, 0) + 1
        identity = self.ids.setdefault(end, os.urandom(16))
        return struct.pack("<qqB16s", self.sent[end], time.time_ns(), 16, identity)

    def call(self, name: str) -> None:
        """Call a service without a question; a refusal ends the program."""
        key = f"{DOMAIN}/{NODE}/{name}/{TRIGGER}"
        ends = time.monotonic() + PATIENCE
        while time.monotonic() < ends:  # the service may not be there yet
            with_it = {"payload": EMPTY, "attachment": self.attachment(name), "timeout": 30.0}
            for reply in self.session.get(key, **with_it):
                if reply.ok is not None:
                    answer: Any = store.deserialize_cdr(bytes(reply.ok.payload), ANSWER)
                    print(f"{name}: {answer.message}")
                    if answer.success:
                        return
                    raise SystemExit(1)
            time.sleep(0.5)
        raise SystemExit(f"nobody offers {name}")

    def steer(self, forward: float, up: float) -> None:
        """m/s along the nose and up; it flies as long as this is repeated."""
        kind = "geometry_msgs/msg/TwistStamped"
        vector, stamp = types["geometry_msgs/msg/Vector3"], types["builtin_interfaces/msg/Time"]
        twist = types["geometry_msgs/msg/Twist"](vector(forward, 0.0, up), vector(0.0, 0.0, 0.0))
        header = types["std_msgs/msg/Header"](stamp(0, 0), "base_link")
        data = bytes(store.serialize_cdr(types[kind](header, twist), kind))
        key = f"{DOMAIN}/{NODE}/cmd_vel/geometry_msgs::msg::dds_::TwistStamped_"
        where = f"{key}/{store.hash_rihs01(kind)}"
        self.session.put(where, data, attachment=self.attachment(key))

    def place(self) -> tuple[float, float, float]:
        """East, north, up, m."""
        message = self.poses.recv().payload
        pose: Any = store.deserialize_cdr(bytes(message), "nav_msgs/msg/Odometry")
        at = pose.pose.pose.position
        return at.x, at.y, at.z


def fly(program: Program) -> None:
    program.call("obtain_control")
    program.call("takeoff")
    try:
        ends = time.monotonic() + PATIENCE
        while program.place()[2] < 4.0 and time.monotonic() < ends:
            program.steer(0.0, 1.0)  # not flown before the take-off has ended
            time.sleep(0.05)
        x, y, _ = program.place()
        flown = 0.0
        while flown < 5.0 and time.monotonic() < ends:
            program.steer(1.5, 0.0)
            time.sleep(0.05)
            east, north, _ = program.place()
            flown = math.hypot(east - x, north - y)
        print(f"{flown:.1f} m flown")
    finally:  # whatever happened
        program.call("land")
    while program.place()[2] > 0.3:
        pass
    print("landed")


def opened(mode: str, endpoints: str, place: str) -> Any:
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5(endpoints, json.dumps([place]))
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config)


@contextlib.contextmanager
def virtual_aircraft() -> Iterator[Any]:
    """A session that is a router, too, and ``m100link ros2 sim://`` as a program of its own."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        place = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    override = {"ZENOH_CONFIG_OVERRIDE": f'connect/endpoints=["{place}"]'}
    command = [sys.executable, "-m", "m100link", "ros2", "sim://"]
    command += ["--node", NODE, "--domain", str(DOMAIN)]
    with (
        opened("router", "listen/endpoints", place) as session,
        subprocess.Popen(command, env=os.environ | override) as node,
    ):
        try:
            yield session
        finally:
            node.terminate()


if __name__ == "__main__":
    with (
        opened("peer", "connect/endpoints", sys.argv[1])
        if len(sys.argv) > 1
        else virtual_aircraft()
    ) as session:
        fly(Program(session))
