"""rosbridge v2, operation by operation, without a socket."""

from __future__ import annotations

import json
import struct
import time
from typing import Any

import cbor2
import pytest
from hypothesis import given
from hypothesis import strategies as st

from m100link.apps.station.ros.client import Client, ClientLimits
from m100link.apps.station.ros.graph import MAY_END, Graph, GraphListener, ServiceCall, add_rosapi
from m100link.apps.station.ros.messages import Message
from tests.apps.station.ros.test_messages import unpack_png


class Bench:
    """A graph with one topic each way, one service, and one client."""

    def __init__(self, limits: ClientLimits | None = None) -> None:
        self.graph = Graph()
        self.published: list[Message] = []
        self.calls: list[ServiceCall] = []
        self.height = self.graph.add_topic("/height", "std_msgs/Float32")
        self.joy = self.graph.add_topic("/joy", "sensor_msgs/Joy")
        self.graph.add_topic(
            "/steer", "std_msgs/Float32", lambda _, message, __: self.published.append(message)
        )
        self.graph.add_service("/task", "dji_sdk/DroneTaskControl", self.calls.append)
        add_rosapi(self.graph)
        self.client = Client(self.graph, limits=limits)
        self.now = 0.0

    def send(self, op: str, **fields: Any) -> list[Any]:
        self.client.receive(json.dumps({"op": op, **fields}), self.now)
        return self.output()

    def output(self) -> list[Any]:
        frames: list[str | bytes] = []
        while (frame := self.client.outbox.next_frame()) is not None:
            frames.append(frame)
        return [cbor2.loads(f) if isinstance(f, bytes) else json.loads(f) for f in frames]

    def publish(self, *values: float, every: float = 0.0) -> None:
        for value in values:
            self.client.outbox.advance(self.now)
            self.graph.publish(self.height, {"data": value}, self.now)
            self.now += every

    def values(self) -> list[float]:
        return [frame["msg"]["data"] for frame in self.output()]


def test_a_subscriber_gets_what_is_published_under_the_name_it_used() -> None:
    bench = Bench()
    assert bench.send("subscribe", topic="height", type="std_msgs/msg/Float32") == []
    bench.publish(1.5)
    assert bench.output() == [{"op": "publish", "topic": "height", "msg": {"data": 1.5}}]
    assert bench.send("unsubscribe", topic="height") == []
    bench.publish(2.5)
    assert bench.output() == []


def test_publishing_needs_a_topic_that_takes_it_and_a_valid_message() -> None:
    bench = Bench()
    assert bench.send("publish", topic="/steer", msg={"data": 1}) == []  # known: no advertisement
    (refused,) = bench.send("publish", topic="/height", msg={"data": 1}, id="p1")
    assert (refused["op"], refused["level"], refused["id"]) == ("status", "error", "p1")
    assert "station alone" in refused["msg"]
    assert bench.send("advertise", topic="/steer", type="std_msgs/Float32", id="a") == []
    assert bench.send("publish", topic="/steer", msg={"data": 2}) == []
    (mistyped,) = bench.send("publish", topic="/steer", msg={"data": "fast"})
    assert "data is not a number" in mistyped["msg"]
    assert bench.send("unadvertise", topic="/steer", id="a") == []
    assert bench.published == [{"data": 1.0}, {"data": 2.0}]


@pytest.mark.parametrize(
    ("frame", "says"),
    [
        ({"op": "advertise", "topic": "/steer", "type": "std_msgs/String"}, "of type std_msgs/Fl"),
        ({"op": "subscribe", "topic": "/height", "type": "std_msgs/UInt8"}, "of type std_msgs/Fl"),
        ({"op": "advertise", "topic": "/nothing", "type": "std_msgs/String"}, "no topic"),
        ({"op": "subscribe", "topic": "/nothing"}, "/rosapi/topics"),
        ({"op": "publish", "topic": "/nothing", "msg": {}}, "no topic"),
        ({"op": "advertise", "topic": "/height", "type": "std_msgs/Float32"}, "station alone"),
        ({"op": "advertise", "topic": "/steer"}, "type is missing"),
        ({"op": "subscribe"}, "topic is missing"),
        ({"op": "subscribe", "topic": 5}, "topic is missing"),
        ({"op": "subscribe", "topic": "/height", "compression": 5}, "compression is not"),
        ({"op": "subscribe", "topic": "/height", "throttle_rate": "slow"}, "throttle_rate"),
        ({"op": "subscribe", "topic": "/height", "queue_length": "many"}, "queue_length"),
        ({"op": "subscribe", "topic": "/height", "fragment_size": "x"}, "fragment_size"),
        ({"op": "set_level", "level": "loud"}, "no level"),
        ({"op": "advertise_service", "service": "/x"}, "no operation"),
        ({"op": "fragment"}, "fragment needs"),
        ({"op": ["publish"]}, "no operation"),
        ({}, "no operation"),
        ([], "JSON object"),
        ("nonsense", "JSON object"),
    ],
)
def test_what_is_wrong_is_said(frame: Any, says: str) -> None:
    bench = Bench()
    bench.client.receive(json.dumps(frame), 0.0)
    (status,) = bench.output()
    assert (status["op"], status["level"]) == ("status", "error")
    assert says in status["msg"]


@pytest.mark.parametrize(
    "frame", ["", "{", "[" * 5000, '{"op":NaN}', b"\xff\xfe", b"\0", '{"a":' * 3000, "1" * 5000]
)
def test_what_is_no_json_is_refused(frame: str | bytes) -> None:
    bench = Bench()
    bench.client.receive(frame, 0.0)
    (status,) = bench.output()
    assert status["level"] == "error"
    assert ("null stands for no number" in status["msg"]) is (frame == '{"op":NaN}')


@given(st.binary(max_size=200) | st.text(max_size=200))
def test_no_frame_raises(frame: str | bytes) -> None:
    bench = Bench()
    bench.client.receive(frame, 0.0)
    assert all(one["op"] == "status" for one in bench.output())


_JSON = st.recursive(
    st.none() | st.booleans() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=5,
)
_FIELDS = ["topic", "type", "id", "msg", "service", "args", "throttle_rate", "queue_length"]
_FIELDS += ["fragment_size", "compression", "level", "num", "total", "data"]
_NAMES = st.sampled_from(["/height", "steer", "/joy", "/task", "std_msgs/Float32"])
_OPERATIONS = st.sampled_from(
    [
        *("advertise", "unadvertise", "publish", "subscribe", "unsubscribe"),
        *("call_service", "fragment", "set_level"),
    ]
)


@given(
    st.lists(
        st.fixed_dictionaries({"op": _OPERATIONS, "topic": _NAMES | _JSON}).flatmap(
            lambda base: st.dictionaries(st.sampled_from(_FIELDS), _NAMES | _JSON).map(
                lambda more: base | more
            )
        ),
        max_size=8,
    )
)
def test_no_sequence_of_operations_raises(frames: list[Any]) -> None:
    bench = Bench()
    for frame in frames:
        bench.client.receive(json.dumps(frame), 0.0)
        bench.publish(1.0)
    bench.output()
    bench.client.close(0.0)
    assert not bench.height.subscribers


def test_throttling_without_a_queue_drops_what_comes_between() -> None:
    bench = Bench()
    bench.send("subscribe", topic="/height", throttle_rate=100)
    bench.publish(*range(10), every=0.05)
    assert bench.values() == [0, 2, 4, 6, 8]
    assert bench.client.outbox.next_wakeup() is None


def test_throttling_with_a_queue_keeps_the_newest_and_sends_them_later() -> None:
    bench = Bench()
    bench.send("subscribe", topic="/height", throttle_rate=100, queue_length=2)
    bench.publish(*range(6))
    assert bench.values() == [0]
    assert bench.client.outbox.next_wakeup() == pytest.approx(0.1, abs=1e-5)
    for bench.now in (0.1, 0.2, 0.3):
        bench.client.outbox.advance(bench.now)
    assert bench.values() == [4, 5]


def test_subscriptions_of_one_client_merge() -> None:
    bench = Bench()
    bench.send("subscribe", topic="/height", id="slow", throttle_rate=1000, fragment_size=1000)
    bench.send("subscribe", topic="/height", id="fast", throttle_rate=0, compression="png")
    bench.publish(1, 2)
    frames = bench.output()
    assert [frame["op"] for frame in frames] == ["png", "png"]  # once each, at the lowest throttle
    assert json.loads(unpack_png(json.dumps(frames[1])))["msg"] == {"data": 2}
    bench.send("unsubscribe", topic="/height", id="fast")
    bench.publish(3, 4)
    assert bench.values() == [3]  # only the slow one is left
    bench.send("unsubscribe", topic="/height", id="slow")
    bench.publish(5)
    assert bench.values() == []


def test_fragments_both_ways() -> None:
    bench = Bench()
    bench.send("subscribe", topic="/joy", fragment_size=100)
    message = bench.joy.type.default() | {"axes": [1.0] * 50}
    bench.graph.publish(bench.joy, message, 0.0)
    pieces = bench.output()
    assert len(pieces) > 3
    assert {piece["op"] for piece in pieces} == {"fragment"}
    assert all(len(piece["data"]) <= 100 for piece in pieces)
    whole = json.loads("".join(piece["data"] for piece in pieces))
    assert whole["msg"]["axes"] == [1.0] * 50

    bench.send("advertise", topic="/steer", type="std_msgs/Float32")
    text = json.dumps({"op": "publish", "topic": "/steer", "msg": {"data": 3}})
    for number, at in enumerate(range(0, len(text), 20)):
        piece = text[at : at + 20]
        total = -(-len(text) // 20)
        assert bench.send("fragment", id="f", data=piece, num=number, total=total) == []
    assert bench.published == [{"data": 3.0}]


def test_fragments_do_not_nest() -> None:
    bench = Bench()
    inner = json.dumps({"op": "fragment", "id": "x", "data": "{}", "num": 0, "total": 1})
    (status,) = bench.send("fragment", id="f", data=inner, num=0, total=1)
    assert "fragments" in status["msg"]


def test_cbor_is_a_binary_frame_with_typed_arrays() -> None:
    bench = Bench()
    bench.send("subscribe", topic="/joy", compression="cbor")
    bench.graph.publish(bench.joy, bench.joy.type.read({"axes": [1.0]}), 0.0)
    (frame,) = bench.output()
    assert (frame["op"], frame["topic"], frame["msg"]["axes"].tag) == ("publish", "/joy", 85)


def test_a_service_answers_once_now_or_later() -> None:
    bench = Bench()
    assert bench.send("call_service", service="task", args={"task": 4}, id="c1") == []
    (call,) = bench.calls
    assert call.request == {"task": 4}
    call.respond({"result": True})
    call.fail("too late")
    assert bench.output() == [
        {
            "op": "service_response",
            "service": "task",
            "result": True,
            "id": "c1",
            "values": {"result": True, "cmd_set": 0, "cmd_id": 0, "ack_data": 0},
        }
    ]


def test_a_failed_call_says_why() -> None:
    bench = Bench()
    bench.send("call_service", service="/task", args=[4])
    bench.calls[0].fail('"no"')
    (answer,) = bench.output()
    assert (answer["result"], answer["values"]) == (False, '"no"')
    for name, args in (("/none", {}), ("/task", {"task": 999})):
        refused = bench.client.refused
        (answer,) = bench.send("call_service", service=name, args=args, id=5)
        assert (answer["op"], answer["result"], answer["id"]) == ("service_response", False, 5)
        assert answer["values"]
        assert bench.client.refused == refused + 1


def test_calls_without_an_answer_are_limited() -> None:
    bench = Bench(ClientLimits(calls=2))
    for _ in range(2):
        assert bench.send("call_service", service="/task") == []
    (answer,) = bench.send("call_service", service="/task")
    assert "2 calls wait" in answer["values"]
    bench.calls[0].respond({})
    bench.output()
    assert bench.send("call_service", service="/task") == []


def test_a_call_that_ends_a_flight_is_not_counted() -> None:
    bench = Bench(ClientLimits(calls=2))
    stops: list[ServiceCall] = []
    bench.graph.add_service("/m100link/stop", "std_srvs/Trigger", stops.append)
    for _ in range(2):
        assert bench.send("call_service", service="/task") == []
    for _ in range(20):
        assert bench.send("call_service", service="/m100link/stop") == []
    for stop in stops:
        stop.respond({})
    bench.output()
    (answer,) = bench.send("call_service", service="/task")
    assert "2 calls wait" in answer["values"]
    bench.calls[0].respond({})
    bench.output()
    assert bench.send("call_service", service="/task") == []
    assert len(stops) == 20


def test_the_level_decides_which_statuses_are_sent() -> None:
    bench = Bench()
    bench.client.status("warning", "w")
    assert bench.output() == []
    bench.send("set_level", level="warning")
    bench.client.status("warning", "w")
    bench.client.status("info", "i")
    assert [frame["msg"] for frame in bench.output()] == ["w"]
    bench.send("set_level", level="none")
    assert bench.send("publish", topic="/nothing") == []


def test_a_flood_is_dropped_and_in_the_end_disconnected() -> None:
    bench = Bench(ClientLimits(rate=10, burst=20, faults=50))
    bench.send("advertise", topic="/steer", type="std_msgs/Float32")
    for _ in range(60):
        bench.send("publish", topic="/steer", msg={"data": 1})
    assert len(bench.published) == 19
    assert bench.client.close_reason is None
    bench.now = 1.0
    bench.send("publish", topic="/steer", msg={"data": 1})
    assert len(bench.published) == 20  # a calm client is heard again
    for _ in range(40):
        bench.send("publish", topic="/steer", msg={"data": 1})
    assert bench.client.close_reason is not None


def test_a_holder_of_control_that_floods_is_served_and_heard_and_not_disconnected() -> None:
    """Its aircraft would hover: of its setpoints the newest fly, as many as it may send."""
    bench = Bench(ClientLimits(rate=10, burst=20, faults=50))
    bench.client.is_steering = lambda: True
    told = []
    for number in range(1000):
        bench.now = number / 100
        told += bench.send("publish", topic="/steer", msg={"data": number})
    assert bench.client.close_reason is None
    assert 110 <= len(bench.published) <= 121
    assert bench.published[-1]["data"] > 985
    assert {one["msg"] for one in told} == {"more than 10 frames per second: frame dropped"}
    assert 9 <= len(told) <= 11
    bench.client.is_steering = lambda: False
    for _ in range(60):
        bench.send("publish", topic="/steer", msg={"data": 1})
    assert bench.client.close_reason is not None


@pytest.mark.parametrize(
    "frame",
    [
        '{"op":"publish","topic":"/m100link/halt/cancel","msg":{}}',
        '{"op":"call_service","service":"/m100link/stop"}',
        '{"op":"call_service","service":"m100link/stop#7","args":{}}',
        '{"op":"call_service","service":"\\/m100link\\/stop"}',
        '{"op":"call_service","service":"\\u002fm100link\\u002fst\\u006fp"}',
    ],
)
def test_no_way_to_write_a_name_hides_what_ends_something_from_the_quick_look(frame: str) -> None:
    assert MAY_END.search(frame)


def test_a_slow_reader_loses_its_oldest_messages_and_nothing_else() -> None:
    bench = Bench(ClientLimits(waiting=5))
    other = Client(bench.graph)
    for client in (bench.client, other):
        client.receive('{"op":"subscribe","topic":"/height"}', 0.0)
    bench.publish(*range(8))
    assert (bench.values(), bench.client.outbox.dropped) == ([3, 4, 5, 6, 7], 3)
    assert other.outbox.dropped == 0


def test_a_rare_message_is_not_pushed_out_by_a_fast_topic() -> None:
    bench = Bench(ClientLimits(waiting=5))
    bench.send("subscribe", topic="/joy")
    bench.send("subscribe", topic="/height")
    bench.graph.publish(bench.joy, bench.joy.type.default(), 0.0)
    bench.publish(*range(50))
    assert [frame["topic"] for frame in bench.output()] == ["/joy", *["/height"] * 4]


def test_a_client_that_asks_and_never_reads_is_disconnected() -> None:
    bench = Bench(ClientLimits(answers=10))
    for _ in range(11):
        bench.client.receive("{", 0.0)
    assert bench.client.close_reason == "the client does not read"


def test_a_thousand_subscriptions_are_a_hundred() -> None:
    bench = Bench()
    for number in range(300):
        bench.send("subscribe", topic="/height", id=str(number))
    for number in range(700):
        bench.now += 0.01
        bench.send("subscribe", topic=f"/nothing{number}", id=str(number))
    bench.publish(1)
    assert bench.values() == [1]  # merged: one message, however many subscriptions
    assert bench.client.refused == 900


def test_an_oversized_frame_is_refused_before_it_is_read() -> None:
    bench = Bench(ClientLimits(message_size=100))
    bench.client.receive("[" * 101, 0.0)
    (status,) = bench.output()
    assert "at most 100 bytes" in status["msg"]


def test_a_client_that_leaves_leaves_nothing() -> None:
    bench = Bench()
    left: list[GraphListener] = []
    bench.graph.on_leave.append(lambda session, now: left.append(session))
    bench.send("subscribe", topic="/height")
    bench.send("call_service", service="/task")
    bench.client.close(0.0)
    bench.client.close(0.0)
    bench.calls[0].respond({})  # the answer comes after the client
    assert (left, bench.graph.sessions, bench.height.subscribers) == ([bench.client], set(), set())


def test_an_array_is_judged_by_its_size_before_an_element_is_read() -> None:
    bench = Bench()
    bench.graph.add_topic("/mobile", "dji_sdk/MobileData", lambda _, message, __: None)
    bench.graph.topics["/joy"].on_publish = lambda _, message, __: bench.published.append(message)
    for topic, msg in (
        ("/joy", {"axes": ["not read"] * 17}),
        ("/joy", {"buttons": ["not read"] * 17}),
        ("/mobile", {"data": "A" * 137}),
        ("/mobile", {"data": ["not read"] * 101}),
    ):
        bench.send("advertise", topic=topic, type=bench.graph.topics[topic].type.name)
        (status,) = bench.send("publish", topic=topic, msg=msg)
        assert "more than" in status["msg"]
    assert bench.send("publish", topic="/joy", msg={"axes": [1.0] * 16}) == []
    assert len(bench.published) == 1


def test_bytes_are_a_budget() -> None:
    bench = Bench(ClientLimits(message_size=1000, bytes_rate=1000.0))
    frame = json.dumps({"op": "status", "msg": "x" * 900})
    for _ in range(10):
        bench.client.receive(frame, 0.0)
    assert bench.client.refused == 6  # four messages of full size at once
    (status,) = bench.output()  # one complaint a second
    assert "bytes per second" in status["msg"]
    bench.client.receive(frame, 1.0)
    assert bench.client.refused == 6


def test_work_is_a_budget() -> None:
    bench = Bench(ClientLimits(work_rate=0.1, work_burst=0.2))
    bench.client.charge(0.5, 0.0)
    assert bench.client.work_pause(0.0) == pytest.approx(3.0)
    bench.send("status")
    assert bench.client.refused == 1
    bench.now = 3.1
    bench.send("status")
    assert bench.client.refused == 1


def test_faults_are_forgotten_after_a_while() -> None:
    bench = Bench(ClientLimits(faults=10))
    for _ in range(10):
        bench.send("nonsense")
    bench.now = 1001.0
    bench.send("nonsense")
    assert bench.client.close_reason is None
    for _ in range(10):
        bench.send("nonsense")
    assert bench.client.close_reason is not None


def test_what_had_not_to_be_done_is_a_warning() -> None:
    bench = Bench()
    assert bench.send("unsubscribe", topic="/height") == []  # warnings have to be asked for
    bench.send("set_level", level="warning")
    (status,) = bench.send("unsubscribe", topic="/steer", id="s1")
    assert (status["level"], status["id"]) == ("warning", "s1")
    assert "not subscribed" in status["msg"]
    assert bench.client.refused == 2
    assert bench.send("unadvertise", topic="/steer") == []  # as rosbridge_suite has it


def test_small_fragments_are_made_larger() -> None:
    bench = Bench()
    bench.send("subscribe", topic="/joy", fragment_size=1)
    bench.graph.publish(bench.joy, bench.joy.type.default() | {"axes": [1.0] * 50}, 0.0)
    assert {len(piece["data"]) for piece in bench.output()[:-1]} == {100}


def test_cbor_raw_has_the_bytes_of_ros() -> None:
    bench = Bench()
    bench.send("subscribe", topic="/height", compression="cbor-raw")
    bench.publish(1.5)
    (frame,) = bench.output()
    assert (frame["op"], frame["topic"]) == ("publish", "/height")
    assert frame["msg"]["bytes"] == struct.pack("<f", 1.5)
    assert abs(frame["msg"]["secs"] - time.time()) < 60


def test_an_answer_is_packed_as_the_call_asks() -> None:
    bench = Bench()
    call = {"service": "/rosapi/topics", "id": "c"}
    (plain,) = bench.send("call_service", **call)
    (packed,) = bench.send("call_service", **call, compression="cbor")
    assert packed == plain
    (picture,) = bench.send("call_service", **call, compression="png")
    assert json.loads(unpack_png(json.dumps(picture))) == plain
    pieces = bench.send("call_service", **call, fragment_size=100)
    assert len(pieces) > 1
    assert json.loads("".join(piece["data"] for piece in pieces)) == plain
    (answer,) = bench.send("call_service", **call, compression=5)
    assert (answer["op"], answer["result"]) == ("service_response", False)


def test_a_compression_that_does_not_exist_is_none_with_a_warning() -> None:
    bench = Bench()
    bench.send("set_level", level="warning")
    (status,) = bench.send("subscribe", topic="/height", compression="zip")
    assert (status["level"], "'zip'" in status["msg"]) == ("warning", True)
    status, answer = bench.send("call_service", service="/rosapi/topics", compression="zip")
    assert (status["level"], answer["result"]) == ("warning", True)
    bench.publish(1.0)
    assert [frame["op"] for frame in bench.output()] == ["publish"]


def test_a_negative_throttle_is_none() -> None:
    bench = Bench()
    assert bench.send("subscribe", topic="/height", throttle_rate=-1) == []
    for height in (1.0, 2.0):
        bench.publish(height)
    assert len(bench.output()) == 2


@pytest.mark.parametrize(("given", "told"), [({}, "9"), ({"id": "c"}, "c")])
def test_a_call_may_have_its_id_behind_the_name(given: dict[str, str], told: str) -> None:
    (answer,) = Bench().send("call_service", service="/rosapi/topics#9", **given)
    assert (answer["result"], answer["id"]) == (True, told)
    assert answer["service"] == "/rosapi/topics#9"


def test_the_stamp_of_a_header_may_be_now() -> None:
    bench = Bench()
    taken: list[Message] = []
    bench.graph.add_topic("/head", "std_msgs/Header", lambda _, message, __: taken.append(message))
    for msg in ({"stamp": "now"}, {"frame_id": "x"}):
        assert bench.send("publish", topic="/head", msg=msg) == []
        assert abs(taken[-1]["stamp"]["secs"] - time.time()) < 60
    bench.send("publish", topic="/head", msg={"stamp": {"secs": 7}})
    assert taken[-1]["stamp"] == {"secs": 7, "nsecs": 0}
