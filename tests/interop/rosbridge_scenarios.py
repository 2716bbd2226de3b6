"""The same clients for both: what they send, and what both sides' answers look like compared."""

from __future__ import annotations

import base64
import json
import math
import struct
import zlib
from typing import Any, NamedTuple

import cbor2

from m100link.apps.station.ros.client import Client
from m100link.apps.station.ros.graph import Graph, GraphListener, ServiceCall
from m100link.apps.station.ros.messages import Message

WORLD: dict[str, Any] = {
    "published": {
        "/chatter": "std_msgs/String",
        "/joy": "sensor_msgs/Joy",
        "/level": "std_msgs/Float32",
        "/fix": "sensor_msgs/NavSatFix",
        "/log": "rosgraph_msgs/Log",
    },
    "heard": {
        "/in_string": "std_msgs/String",
        "/in_byte": "std_msgs/UInt8",
        "/in_bool": "std_msgs/Bool",
        "/in_float": "std_msgs/Float32",
        "/in_joy": "sensor_msgs/Joy",
        "/in_point": "geometry_msgs/PointStamped",
    },
    "services": {
        "/trigger": ["std_srvs/Trigger", {"success": True, "message": "so it is"}],
        "/empty": ["std_srvs/Empty", {}],
        "/broken": ["std_srvs/Trigger", None],
    },
}

WITHOUT_HEADER = ("std_msgs/String", "std_msgs/Float32")

HELLO = {"data": "hello"}
LONG = {"data": "0123456789" * 40}
STAMP = {"seq": 0, "stamp": {"secs": 7, "nsecs": 8}, "frame_id": "x"}
JOY = {"header": STAMP, "axes": [0.5, -1.0], "buttons": [1, 2]}
FIX = {
    "header": STAMP,
    "status": {"status": 0, "service": 1},
    **{"latitude": 47.25, "longitude": 8.5, "altitude": 400.0},
    "position_covariance": [float(n) for n in range(9)],
    "position_covariance_type": 1,
}
LOG = {
    **{"header": STAMP, "level": 2, "name": "n", "msg": "m", "file": "f", "function": "g"},
    **{"line": 3, "topics": ["a", "b"]},
}

Step = tuple[Any, ...]


def send(op: str | None = None, /, **fields: Any) -> Step:
    return ("send", json.dumps({"op": op, **fields} if op else fields))


def raw(text: str) -> Step:
    return ("send", text)


def world(topic: str, message: dict[str, Any]) -> Step:
    return ("publish", topic, message)


def wait(seconds: float) -> Step:
    return ("wait", seconds)


def subscribed(topic: str, message: dict[str, Any], **options: Any) -> list[Step]:
    return [send("subscribe", topic=topic, **options), world(topic, message)]


def told(topic: str, kind: str, message: Any, **options: Any) -> list[Step]:
    return [
        send("advertise", topic=topic, type=kind, **options),
        send("publish", topic=topic, msg=message),
    ]


def in_pieces(text: str, count: int, identity: str) -> list[Step]:
    size = math.ceil(len(text) / count)
    return [
        send("fragment", id=identity, num=n, total=count, data=text[n * size : (n + 1) * size])
        for n in range(count)
    ]


BURST = [world("/chatter", {"data": str(n)}) for n in range(6)]
CALL = json.dumps({"op": "call_service", "service": "/trigger", "id": "c"})

SCENARIOS: dict[str, list[Step]] = {
    # advertise, publish
    "advertise and publish": told("/in_string", "std_msgs/String", HELLO),
    "advertise twice": told("/in_string", "std_msgs/String", HELLO)[:1] * 2,
    "advertise with the type of ROS 2": told("/in_string", "std_msgs/msg/String", HELLO),
    "advertise with another type": told("/in_string", "std_msgs/Bool", {"data": True}),
    "advertise with a type that does not exist": [send("advertise", topic="/x", type="no/Such")],
    "advertise a new topic": told("/new", "std_msgs/String", HELLO),
    "advertise without a type": [send("advertise", topic="/in_string")],
    "advertise without a topic": [send("advertise", type="std_msgs/String")],
    "advertise with a topic that is a number": [send("advertise", topic=5, type="std_msgs/String")],
    "advertise latched, with a queue": told(
        "/in_string", "std_msgs/String", HELLO, latch=True, queue_size=5
    ),
    "publish without advertise": [
        send("publish", topic="/in_string", msg=HELLO),
        send("publish", topic="/in_string", msg=HELLO),
    ],
    "publish without advertise on a new topic": [send("publish", topic="/newer", msg=HELLO)],
    "publish without msg": [
        send("advertise", topic="/in_string", type="std_msgs/String"),
        send("publish", topic="/in_string"),
    ],
    "publish without a topic": [send("publish", msg=HELLO)],
    "publish an unknown field": told("/in_string", "std_msgs/String", {"text": "x"}),
    "publish a number as a string": told("/in_string", "std_msgs/String", {"data": 5}),
    "publish a string as a number": told("/in_byte", "std_msgs/UInt8", {"data": "5"}),
    "publish a byte beyond 255": told("/in_byte", "std_msgs/UInt8", {"data": 256}),
    "publish a byte below 0": told("/in_byte", "std_msgs/UInt8", {"data": -1}),
    "publish a whole float as a byte": told("/in_byte", "std_msgs/UInt8", {"data": 5.0}),
    "publish a fraction as a byte": told("/in_byte", "std_msgs/UInt8", {"data": 5.5}),
    "publish true as a byte": told("/in_byte", "std_msgs/UInt8", {"data": True}),
    "publish a bool": told("/in_bool", "std_msgs/Bool", {"data": True}),
    "publish 1 as a bool": told("/in_bool", "std_msgs/Bool", {"data": 1}),
    "publish an integer as a float": told("/in_float", "std_msgs/Float32", {"data": 3}),
    "publish null as a float": told("/in_float", "std_msgs/Float32", {"data": None}),
    "publish a list": told("/in_joy", "sensor_msgs/Joy", JOY),
    "publish a list of the wrong kind": told("/in_joy", "sensor_msgs/Joy", {"axes": ["x"]}),
    "publish what is not a list": told("/in_joy", "sensor_msgs/Joy", {"axes": 1.0}),
    "publish a long list": told("/in_joy", "sensor_msgs/Joy", {"axes": [0.0] * 40}),
    "publish part of a message": told(
        "/in_point", "geometry_msgs/PointStamped", {"header": STAMP, "point": {"x": 1.5}}
    ),
    "publish a stamp of ROS 2": told(
        "/in_point",
        "geometry_msgs/PointStamped",
        {"header": {"stamp": {"sec": 7, "nanosec": 8}, "frame_id": "x"}},
    ),
    "publish the stamp now": told(
        "/in_point", "geometry_msgs/PointStamped", {"header": {"stamp": "now"}}
    ),
    "publish without a header": told(
        "/in_point", "geometry_msgs/PointStamped", {"point": {"z": 1.0}}
    ),
    "publish a header without a stamp": told(
        "/in_point", "geometry_msgs/PointStamped", {"header": {"frame_id": "x"}}
    ),
    "publish a message that is not an object": told("/in_string", "std_msgs/String", "hello"),
    "unadvertise": [
        *told("/in_string", "std_msgs/String", HELLO)[:1],
        send("unadvertise", topic="/in_string"),
    ],
    "unadvertise what was not advertised": [send("unadvertise", topic="/in_string")],
    "unadvertise without a topic": [send("unadvertise")],
    # subscribe
    "subscribe": subscribed("/chatter", HELLO),
    "subscribe with its type": subscribed("/chatter", HELLO, type="std_msgs/String"),
    "subscribe with another type": subscribed("/chatter", HELLO, type="std_msgs/Bool"),
    "subscribe with an id": subscribed("/chatter", HELLO, id="s1"),
    "subscribe twice": [*subscribed("/chatter", HELLO, id="a")[:1], *subscribed("/chatter", HELLO)],
    "subscribe without a slash": [send("subscribe", topic="chatter"), world("/chatter", HELLO)],
    "subscribe to what does not exist": [send("subscribe", topic="/nowhere")],
    "subscribe without a topic": [send("subscribe")],
    "subscribe with a throttle that is text": subscribed("/chatter", HELLO, throttle_rate="5"),
    "subscribe with a throttle that is a fraction": subscribed(
        "/chatter", HELLO, throttle_rate=0.5
    ),
    "subscribe with a negative throttle": subscribed("/chatter", HELLO, throttle_rate=-5),
    "subscribe with a queue that is text": subscribed("/chatter", HELLO, queue_length="5"),
    "subscribe with a throttle": [
        send("subscribe", topic="/chatter", throttle_rate=2000),
        *BURST,
    ],
    "subscribe with a throttle and a queue": [
        send("subscribe", topic="/chatter", throttle_rate=700, queue_length=2),
        *BURST,
        wait(1.6),
    ],
    "subscribe with a queue alone": [send("subscribe", topic="/chatter", queue_length=3), *BURST],
    "subscribe in fragments": subscribed("/chatter", LONG, fragment_size=150),
    "subscribe in small fragments": subscribed("/chatter", LONG, fragment_size=50),
    "subscribe in fragments that are not needed": subscribed("/chatter", HELLO, fragment_size=500),
    "subscribe with fragments that are text": subscribed("/chatter", HELLO, fragment_size="5"),
    "subscribe as png": subscribed("/chatter", HELLO, compression="png"),
    "subscribe as cbor": subscribed("/chatter", HELLO, compression="cbor"),
    "subscribe to arrays as cbor": subscribed("/joy", JOY, compression="cbor"),
    "subscribe to fixed arrays as cbor": subscribed("/fix", FIX, compression="cbor"),
    "subscribe to bytes and texts as cbor": subscribed("/log", LOG, compression="cbor"),
    "subscribe as cbor-raw": subscribed("/chatter", HELLO, compression="cbor-raw"),
    "subscribe to arrays as cbor-raw": subscribed("/joy", JOY, compression="cbor-raw"),
    "subscribe to fixed arrays as cbor-raw": subscribed("/fix", FIX, compression="cbor-raw"),
    "subscribe to bytes and texts as cbor-raw": subscribed("/log", LOG, compression="cbor-raw"),
    "subscribe as what does not exist": subscribed("/chatter", HELLO, compression="zip"),
    "subscribe as a number": subscribed("/chatter", HELLO, compression=5),
    "subscribe to arrays": subscribed("/joy", JOY),
    "subscribe to fixed arrays": subscribed("/fix", FIX),
    "subscribe to bytes and texts": subscribed("/log", LOG),
    "subscribe to no number": subscribed("/level", {"data": math.nan}),
    "subscribe to infinity": subscribed("/level", {"data": math.inf}),
    "subscribe to no number as cbor": subscribed("/level", {"data": math.nan}, compression="cbor"),
    "unsubscribe": [
        send("subscribe", topic="/chatter"),
        send("unsubscribe", topic="/chatter"),
        world("/chatter", HELLO),
    ],
    "unsubscribe one of two": [
        send("subscribe", topic="/chatter", id="a"),
        send("subscribe", topic="/chatter", id="b"),
        send("unsubscribe", topic="/chatter", id="a"),
        world("/chatter", HELLO),
    ],
    "unsubscribe both of two": [
        send("subscribe", topic="/chatter", id="a"),
        send("subscribe", topic="/chatter", id="b"),
        send("unsubscribe", topic="/chatter"),
        world("/chatter", HELLO),
    ],
    "unsubscribe what was not subscribed": [send("unsubscribe", topic="/chatter")],
    # call_service
    "call": [send("call_service", service="/trigger")],
    "call with an id": [raw(CALL)],
    "call with a number as id": [send("call_service", service="/trigger", id=7)],
    "call with an id in the name": [send("call_service", service="/trigger#9")],
    "call without a slash": [send("call_service", service="trigger", id="c")],
    "call with no arguments as a list": [send("call_service", service="/trigger", args=[])],
    "call with no arguments as an object": [send("call_service", service="/trigger", args={})],
    "call with too many arguments": [send("call_service", service="/trigger", args=[1], id="c")],
    "call with an unknown argument": [
        send("call_service", service="/trigger", args={"x": 1}, id="c")
    ],
    "call what is empty": [send("call_service", service="/empty", id="c")],
    "call what fails": [send("call_service", service="/broken", id="c")],
    "call what does not exist": [send("call_service", service="/nothing", id="c")],
    "call without a service": [send("call_service", id="c")],
    "call a service that is a number": [send("call_service", service=5, id="c")],
    "call in fragments": [send("call_service", service="/trigger", id="c", fragment_size=100)],
    "call as png": [send("call_service", service="/trigger", id="c", compression="png")],
    "call as cbor": [send("call_service", service="/trigger", id="c", compression="cbor")],
    # fragments of the client
    "a call in two fragments": in_pieces(CALL, 2, "two"),
    "a call in one fragment": in_pieces(CALL, 1, "one"),
    "fragments the other way round": in_pieces(CALL, 3, "three")[::-1],
    "a fragment without data": [send("fragment", id="g", num=0, total=2)],
    "a fragment beyond the total": [send("fragment", id="h", num=5, total=2, data="x")],
    "the same fragment twice": in_pieces(CALL, 2, "twice")[:1] * 2,
    # what is wrong altogether
    "an unknown operation": [send("dance")],
    "no operation": [send(topic="/chatter")],
    "an operation that is a number": [raw('{"op": 5}')],
    "a list": [raw("[1, 2]")],
    "a text": [raw('"hello"')],
    "no JSON": [raw("hello")],
    "set_level": [send("set_level", level="info")],
    "set_level that does not exist": [send("set_level", level="loud")],
    "status of a client": [send("status", level="info", msg="hello")],
    "advertise_service": [send("advertise_service", service="/mine", type="std_srvs/Empty")],
    "unadvertise_service": [send("unadvertise_service", service="/mine")],
}


class Seen(NamedTuple):
    """What one client and the world around it saw, in a form that both sides share.

    Attributes:
        frames: Answers and messages, decoded; statuses are among the complaints.
        complaints: Levels of what was said about mistakes: to the client, or in the log.
        heard: Topic and message of what arrived from the client.
    """

    frames: list[Any]
    complaints: list[str]
    heard: list[Any]


def _unfilter(rows: bytes, stride: int) -> bytes:
    """The pixels of a PNG with three bytes each."""
    before, pixels = bytes(stride), bytearray()
    for at in range(0, len(rows), stride + 1):
        kind, row = rows[at], bytearray(rows[at + 1 : at + 1 + stride])
        for i in range(len(row)):
            left, up = (row[i - 3] if i > 2 else 0), before[i]
            corner = before[i - 3] if i > 2 else 0
            estimate = left + up - corner
            nearest = min((left, up, corner), key=lambda one: abs(estimate - one))
            row[i] = (row[i] + (0, left, up, (left + up) // 2, nearest)[kind]) & 0xFF
        pixels += row
        before = bytes(row)
    return bytes(pixels)


def unpack_png(data: str) -> Any:
    """The JSON in the pixels."""
    image, at, packed, width = base64.b64decode(data), 8, b"", 0
    while at < len(image):
        length, kind = struct.unpack(">I4s", image[at : at + 8])
        chunk = image[at + 8 : at + 8 + length]
        width = struct.unpack(">I", chunk[:4])[0] if kind == b"IHDR" else width
        packed += chunk if kind == b"IDAT" else b""
        at += 12 + length
    return json.loads(_unfilter(zlib.decompress(packed), 3 * width).rstrip(b"\n\0"))


def plain(value: Any) -> Any:
    """As JSON, with the tags of CBOR shown; without the time, and the count of rospy's headers."""
    if isinstance(value, cbor2.CBORTag):
        return {f"tag {value.tag}": value.value.hex()}
    if isinstance(value, bytes):
        return {"bytes": value.hex()}
    if isinstance(value, dict):
        if {"seq", "stamp"} <= set(value):
            value = {**value, "seq": "any"}
        if {"secs", "nsecs"} <= set(value) and value["secs"] > 1_000_000_000:
            value = {**value, "secs": "now", "nsecs": "now"}
        return {name: plain(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    return repr(value) if isinstance(value, float) and not math.isfinite(value) else value


def read(frame: str | bytes) -> Any:
    """A frame, decoded."""
    if isinstance(frame, bytes):
        message = cbor2.loads(frame)
        raw = message.get("msg", {}).get("bytes")
        if raw is not None and WORLD["published"][message["topic"]] not in WITHOUT_HEADER:
            message["msg"]["bytes"] = b"any " + raw[4:]  # the count of the header
        return {"cbor": plain(message)}
    message = json.loads(frame)
    if message.get("op") == "png":
        return {"png": plain(unpack_png(message["data"]))}
    if message.get("op") == "service_response" and not message["result"]:
        message["values"] = "in words"
    return plain(message)


def joined(frames: list[Any]) -> list[Any]:
    """Frames with what came in fragments as one; blanks decide how many there are."""
    whole: list[Any] = []
    for frame in frames:
        if frame.get("op") != "fragment":
            whole.append(frame)
            continue
        if frame["num"] == 0:
            total = frame["total"]
            whole.append({"in fragments": "", "of": 0, "total is whole": total == int(total)})
        whole[-1]["in fragments"] += frame["data"]
        whole[-1]["of"] = max(whole[-1]["of"], len(frame["data"]))
    for frame in whole:
        if "in fragments" in frame:
            frame["in fragments"] = plain(json.loads(frame["in fragments"]))
    return whole


def theirs(answer: dict[str, Any]) -> Seen:
    """What the reference saw."""
    frames = [
        read(base64.b64decode(frame["base64"]) if isinstance(frame, dict) else frame)
        for frame in answer["frames"]
    ]
    return Seen(joined(frames), answer["complaints"], plain(answer["heard"]))


def ours(steps: list[Step]) -> Seen:
    """What the station's rosbridge makes of the same."""
    heard: list[Any] = []

    def hear(name: str) -> Any:
        def take(_: GraphListener, message: Message, __: float) -> None:
            text = graph.topics[name].type.to_json(message)
            heard.append([name, json.loads(text)])

        return take

    def answering(outcome: dict[str, Any] | None) -> Any:
        def answer(call: ServiceCall) -> None:
            if outcome is None:
                call.fail("it does not work")
            else:
                call.respond(outcome)

        return answer

    graph, now = Graph(), 100.0
    for name, kind in WORLD["published"].items():
        graph.add_topic(name, kind)
    for name, kind in WORLD["heard"].items():
        graph.add_topic(name, kind, hear(name))
    for name, (kind, outcome) in WORLD["services"].items():
        graph.add_service(name, kind, answering(outcome))
    client = Client(graph)
    client.receive(json.dumps({"op": "set_level", "level": "warning"}), now)
    frames: list[Any] = []
    for kind, *rest in [*steps, ("wait", 0.12)]:
        if kind == "send":
            client.receive(rest[0], now)
            now += 0.25
        elif kind == "publish":
            topic = graph.topics[rest[0]]
            graph.publish(topic, topic.type.read(rest[1]), now)
            now += 0.12
        else:
            now += rest[0]
        client.outbox.advance(now)
        while (frame := client.outbox.next_frame()) is not None:
            frames.append(read(frame))
    statuses = [frame["level"][:4] for frame in frames if frame.get("op") == "status"]
    rest_of = [frame for frame in frames if frame.get("op") != "status"]
    return Seen(joined(rest_of), statuses, plain(heard))
