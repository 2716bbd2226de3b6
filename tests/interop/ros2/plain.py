"""Programs of plain zenoh: `python plain.py PORT WHAT …`, a router, a client of goals, a bag."""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import zenoh

from m100link.apps.ros2.graph import (
    EntityKind,
    NodeName,
    Qos,
    data_key,
    read_attachment,
    write_attachment,
)
from m100link.log.cdr import decode, encode

FLY_TO = "m100_msgs/action/FlyTo"


def session_of(port: int, *, is_router: bool = False) -> Any:
    config = zenoh.Config()
    place = json.dumps([f"tcp/127.0.0.1:{port}"])
    config.insert_json5("mode", '"router"' if is_router else '"peer"')
    config.insert_json5("listen/endpoints" if is_router else "connect/endpoints", place)
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("adminspace/enabled", "true")  # as rmw_zenoh has it
    return zenoh.open(config)


def router(port: int) -> None:
    with session_of(port, is_router=True):
        print("routes", flush=True)
        time.sleep(1e6)


def attachment(sequence: int) -> bytes:
    return write_attachment(sequence, time.time_ns(), b"plain zenoh here")


def goal(port: int, node: str, latitude: str, longitude: str) -> None:
    """Send a goal of fly_to, as a node with a token, and wait for its result."""
    session = session_of(port)
    name = NodeName(0, str(session.zid()), "/", "commander")
    inner = f"{node}/fly_to/_action"
    kind = f"{FLY_TO}_SendGoal"
    token = name.token_of(1, EntityKind.CLIENT, f"{inner}/send_goal", kind, Qos())
    held = [session.liveliness().declare_token(one) for one in (name.token, token)]
    time.sleep(1.0)
    place = {"latitude": float(latitude), "longitude": float(longitude)}
    asked = {"goal_id": {"uuid": [7] * 16}, "goal": {**place, "height": 5.0, "speed": 6.0}}
    for part, request in ((kind, asked), (f"{FLY_TO}_GetResult", {"goal_id": asked["goal_id"]})):
        word = "send_goal" if part == kind else "get_result"
        answers = session.get(
            data_key(0, f"{inner}/{word}", part),
            payload=encode(f"{part}_Request", request),
            attachment=attachment(1),
            timeout=600.0,
        )
        for answer in answers:
            print(word, decode(f"{part}_Response", bytes(answer.ok.payload)), flush=True)
    del held


def flood(port: int, node: str, seconds: str) -> None:
    """Junk and speeds of a stranger, as fast as they go, and calls that nobody waits for."""
    session = session_of(port)
    speeds = data_key(0, f"{node}/cmd_vel", "geometry_msgs/TwistStamped")
    call = data_key(0, f"{node}/land", "std_srvs/srv/Trigger")
    sent, ends = 0, time.monotonic() + float(seconds)
    while time.monotonic() < ends:
        for _ in range(100):
            session.put(speeds, os.urandom(80), attachment=attachment(sent))
            sent += 1
        session.get(call, payload=os.urandom(9), attachment=os.urandom(9), timeout=1.0)
    print(json.dumps({"sent": sent}), flush=True)


def watch(port: int) -> None:
    """Tokens of nodes, as they come and go, with their times."""
    session = session_of(port)
    tokens = session.liveliness().declare_subscriber("@ros2_lv/0/*/*/*/NN/**", history=True)
    for change in tokens:
        print(time.time(), change.kind == zenoh.SampleKind.PUT, change.key_expr, flush=True)


def store_of_types() -> Any:
    """Types as rosbags has them, and those of m100_msgs by their files."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    from m100link.apps.ros2 import MESSAGES

    store = get_typestore(Stores.LATEST)
    for path in sorted(MESSAGES.rglob("*.msg")):
        text = path.read_text(encoding="utf-8")
        store.register(get_types_from_msg(text, f"m100_msgs/msg/{path.stem}"))
    return store


def bag(port: int, seconds: str, folder: str) -> None:
    """Record all topics of domain 0 into a bag, as they come; what came, as lines on stdout."""
    from rosbags.rosbag2 import Writer

    session, store = session_of(port), store_of_types()
    ring: Any = zenoh.handlers.FifoChannel(100_000)
    subscriber = session.declare_subscriber("0/**", ring)
    ends = time.monotonic() + float(seconds)
    topics: dict[str, Any] = {}
    with Writer(Path(folder), version=9) as writer:
        while time.monotonic() < ends:
            sample = subscriber.try_recv()
            if sample is None:
                time.sleep(0.01)
                continue
            key, data = str(sample.key_expr), bytes(sample.payload)
            topic, kind = told_by(key)
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=store)
            at = read_attachment(bytes(sample.attachment)).at_ns
            writer.write(topics[topic], at, data)
            print(topic, kind, at, data.hex())


def told_by(key: str) -> tuple[str, str]:
    """Topic and type of a key of rmw_zenoh: ``0/m100/imu/sensor_msgs::msg::dds_::Imu_/RIHS…``."""
    *topic, kind, _ = key.split("/")[1:]
    return "/" + "/".join(topic), kind.replace("::dds_::", "::").rstrip("_").replace("::", "/")


if __name__ == "__main__":
    programs = {"router": router, "goal": goal, "flood": flood, "bag": bag, "watch": watch}
    what: Any = programs[sys.argv[2]]
    what(int(sys.argv[1]), *sys.argv[3:])
    sys.stdout.flush()
    os._exit(0)
