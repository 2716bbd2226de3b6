"""What rosbridge_suite's own library answers: runs under the Python that has rospy.

Reads ``{"world": …, "scenarios": […]}`` from stdin and writes what each scenario saw to stdout, one
JSON object per line, in its own words. Stands alone: nothing of m100link is imported here.
"""

from __future__ import annotations

import base64
import json
import os
import socket
import sys
import threading
import time
from importlib import import_module
from typing import Any

SETTLE_S = 0.25  # until a subscription or a publication has found its other side
STEP_S = 0.12  # until a message or an answer has arrived


def start_master() -> None:
    """A roscore in this process, as far as topics, services and parameters need one."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{port}"
    os.environ["ROS_HOSTNAME"] = "127.0.0.1"
    import_module("rosmaster.master").Master(port).start()


class World:
    """What is there beside the client: topics of others, listeners to its own, services."""

    def __init__(self, world: dict[str, Any]) -> None:
        self._rospy = import_module("rospy")
        self._conversion = import_module("rosbridge_library.internal.message_conversion")
        self._loader = import_module("rosbridge_library.internal.ros_loader")
        self.heard: list[Any] = []
        self._out = {
            name: self._rospy.Publisher(name, self._loader.get_message_class(kind), queue_size=50)
            for name, kind in world["published"].items()
        }
        for name, kind in world["heard"].items():
            self._rospy.Subscriber(name, self._loader.get_message_class(kind), self._hear, name)
        for name, (kind, outcome) in world["services"].items():
            service = self._loader.get_service_class(kind)
            self._rospy.Service(name, service, self._answer(service, outcome))

    def _hear(self, message: Any, name: str) -> None:
        self.heard.append([name, self._conversion.extract_values(message)])

    def _answer(self, service: Any, outcome: Any) -> Any:
        def answer(_: Any) -> Any:
            if outcome is None:
                raise self._rospy.ServiceException("it does not work")
            return service._response_class(**outcome)

        return answer

    def publish(self, name: str, message: dict[str, Any]) -> None:
        instance = self._out[name].data_class()
        self._out[name].publish(self._conversion.populate_instance(message, instance))


def play(world: World, steps: list[Any], number: int) -> dict[str, Any]:
    """One client from its coming to its going."""
    protocol_class = import_module("rosbridge_library.rosbridge_protocol").RosbridgeProtocol
    frames: list[Any] = []
    complaints: list[str] = []
    lock = threading.Lock()

    class Protocol(protocol_class):  # type: ignore[valid-type, misc]  # known at run time only
        def outgoing(self, message: Any, compression: str = "none") -> None:
            is_binary = isinstance(message, bytes | bytearray)
            with lock:
                frames.append(
                    {"base64": base64.b64encode(message).decode()} if is_binary else message
                )

        def log(self, level: str, message: str, lid: Any = None) -> None:
            if level in ("error", "err", "warn", "warning"):
                complaints.append({"err": "erro"}.get(level, level[:4]))

    world.heard.clear()
    client = Protocol(f"client{number}")
    for kind, *rest in steps:
        if kind == "send":
            client.incoming(rest[0])
            time.sleep(SETTLE_S)
        elif kind == "publish":
            world.publish(rest[0], rest[1])
            time.sleep(STEP_S)
        else:
            time.sleep(rest[0])
    time.sleep(STEP_S)
    client.finish()
    return {"frames": frames, "complaints": complaints, "heard": list(world.heard)}


def main() -> None:
    """All scenarios, in their order."""
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # the library prints
    order = json.load(sys.stdin)
    start_master()
    # The messages are importable; their manifests are in packages for building, not needed here.
    launcher: Any = import_module("roslib.launcher")
    launcher.load_manifest = lambda _: None
    import_module("rospy").init_node("rosbridge", disable_signals=True, disable_rosout=True)
    world = World(order["world"])
    time.sleep(1.0)
    for number, (name, steps) in enumerate(order["scenarios"].items()):
        print(json.dumps({"name": name, **play(world, steps, number)}), file=out, flush=True)
    os._exit(0)  # its threads have no end


if __name__ == "__main__":
    main()
