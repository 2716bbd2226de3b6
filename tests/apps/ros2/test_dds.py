"""The bus on DDS, on an rclpy that is made up; the real one is in ``tests/interop/ros2``."""

from __future__ import annotations

import asyncio
import ctypes
import os
import threading
from collections import deque
from collections.abc import Iterator
from datetime import date, datetime_CAPI
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import pytest

from m100link.apps.bus.network import TokenChange
from m100link.apps.ros2 import dds
from m100link.apps.ros2.graph import (
    Attachment,
    EntityKind,
    GraphDiscovery,
    NodeName,
    Qos,
    data_key,
    read_attachment,
    read_token,
)
from m100link.apps.station.config import Settings
from m100link.apps.station.ros2 import serving_ros2
from m100link.errors import UsageError
from m100link.log.cdr import encode
from tests.apps.ros2.conftest import Rig
from tests.waiting import PATIENCE

pytestmark = pytest.mark.anyio

NAME = NodeName(7, "0", "/", "m100")
CMD_VEL, SEND = "/m100/cmd_vel", "/m100/fly_to/_action/send_goal"
FEEDBACK = "/m100/fly_to/_action/feedback"
LARGEST = 1000
FAST_DDS_2, FAST_DDS_3 = "FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"


class End:
    """A publisher, a subscription or a service, with what was said of it."""

    def __init__(self, kind: Any, topic: str, qos: Any = None) -> None:
        self.kind, self.topic, self.qos, self.srv_type = kind, topic, qos, kind
        self.sent: list[Any] = []
        self.waiting: deque[Any] = deque()
        self.listeners, self.is_acked, self.is_over = 0, True, False
        self.handle = SimpleNamespace(pointer=id(self))

    def publish(self, payload: bytes) -> None:
        if self.is_over:
            raise RuntimeError("context is invalid")
        self.sent.append(payload)

    def get_subscription_count(self) -> int:
        return self.listeners

    def wait_for_all_acked(self, _: Any) -> bool:
        return self.is_acked


class Half:
    """Room for one message, which is its bytes."""

    def __init__(self, kind: Any) -> None:
        self.support, self.message = kind, {"payload": b""}

    def renew(self) -> None:
        self.message = {"payload": b""}


class Node:
    def __init__(self, name: str, namespace: str) -> None:
        self.name, self.namespace = name, namespace
        self.there = [(name, namespace)]
        self.listening: dict[str, list[Any]] = {}
        self.ends: dict[str, End] = {}

    def get_name(self) -> str:
        return self.name

    def get_namespace(self) -> str:
        return self.namespace

    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]:
        return self.there

    def get_subscriptions_info_by_topic(self, topic: str, *, no_mangle: bool) -> list[Any]:
        assert no_mangle
        return self.listening.get(topic, [])

    def create_publisher(self, kind: Any, topic: str, qos: Any) -> End:
        return self.ends.setdefault(topic, End(kind, topic, qos))

    def create_subscription(self, kind: Any, topic: str, call: Any, qos: Any, *, raw: bool) -> End:
        assert raw
        assert call(b"") is None
        return self.ends.setdefault(topic, End(kind, topic, qos))

    def create_service(self, kind: Any, topic: str, _: Any) -> End:
        return self.ends.setdefault(topic, End(kind, topic))


class Rclpy:
    """A world with one participant; messages are bytes, and their types have names alone."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.nodes: list[Node] = []
        self.waiting: dict[int, deque[tuple[bytes, int, int, bytes]]] = {}
        self.up: list[Any] = []
        self.refuses, self.middleware = "", "rmw_fastrtps_cpp"
        self.fields = ["goal_id", "goal"]
        self.monkeypatch = monkeypatch
        self.module = SimpleNamespace(
            context=SimpleNamespace(Context=object),
            signals=SimpleNamespace(SignalHandlerOptions=SimpleNamespace(NO="no")),
            init=self.init,
            shutdown=lambda context: self.up.remove(context),
            create_node=self.create_node,
            duration=SimpleNamespace(Duration=lambda: 0),
            utilities=SimpleNamespace(get_rmw_implementation_identifier=lambda: self.middleware),
            parameter=SimpleNamespace(Parameter=lambda name, value: (name, value)),
            serialization=SimpleNamespace(serialize_message=lambda message: message.payload),
            qos=SimpleNamespace(
                QoSProfile=lambda **found: found,
                ReliabilityPolicy=SimpleNamespace(BEST_EFFORT="best", RELIABLE="reliable"),
                DurabilityPolicy=SimpleNamespace(TRANSIENT_LOCAL="latched", VOLATILE="volatile"),
            ),
        )
        monkeypatch.setattr(dds, "import_module", self.imported)
        monkeypatch.setattr(ctypes, "CDLL", lambda _: self)
        monkeypatch.setattr(dds, "_Half", Half)
        monkeypatch.setattr(dds, "_LOOK_S", 0.0)
        self.freed, self.has_failed = 0, False
        self.rcl_take_serialized_message: Any = lambda *what: self.taken(*what)
        self.rcl_take_request: Any = lambda *what: self.taken_request(*what)
        self.rcl_send_response: Any = lambda *what: self.sent(*what)
        self.rmw_serialize: Any = lambda message, _, into: self.put(into, message["payload"])
        self.rmw_deserialize: Any = lambda *what: self.read(*what)
        self.rcutils_get_default_allocator: Any = lambda: dds._Allocator()
        self.rcutils_uint8_array_fini: Any = lambda _: self.free()
        self.rcutils_error_is_set: Any = lambda: self.has_failed
        self.rcutils_reset_error: Any = lambda: setattr(self, "has_failed", False)
        for name in dds._PERIOD:
            monkeypatch.delenv(name, raising=False)

    def imported(self, name: str) -> Any:
        if name.startswith("rclpy"):
            return self.module
        if name.startswith("tf2_msgs"):
            raise ModuleNotFoundError("No module named 'tf2_msgs'")
        return AnyModule(name, self)

    def init(self, *, context: Any, domain_id: int, signal_handler_options: str, args: Any) -> None:
        assert (domain_id, signal_handler_options, args) == (7, "no", [])
        names = (one for one in (FAST_DDS_2, FAST_DDS_3) if one in os.environ)
        self.profiles = [Path(os.environ[one]).read_text(encoding="utf-8") for one in names]
        if self.refuses:
            raise RuntimeError(self.refuses)
        self.up.append(context)

    def create_node(self, name: str, *, namespace: str, **more: Any) -> Node:
        assert more["parameter_overrides"] == [("start_type_description_service", False)]
        assert not any(more[one] for one in ("enable_rosout", "start_parameter_services"))
        self.nodes.append(Node(name, namespace))
        return self.nodes[-1]

    def taken(self, pointer: int, taken: Any, info: Any, _: None) -> int:
        waiting = self.waiting.get(pointer)
        if not waiting:
            return 401  # RCL_RET_SUBSCRIPTION_TAKE_FAILED
        payload, at_ns, sequence, gid = waiting.popleft()
        self.put(taken, payload)
        info._obj.source_ns, info._obj.sequence = at_ns, sequence
        info._obj.gid[:] = gid
        return 0

    def put(self, taken: Any, payload: bytes) -> None:
        self.held = ctypes.create_string_buffer(payload, len(payload))
        taken._obj.buffer, taken._obj.length = ctypes.addressof(self.held), len(payload)
        taken._obj.capacity = len(payload)

    def free(self) -> None:
        self.freed += 1

    def end_at(self, pointer: int) -> End:
        ends = (end for node in self.nodes for end in node.ends.values())
        return next(end for end in ends if end.handle.pointer == pointer)

    def taken_request(self, pointer: int, header: Any, message: dict[str, bytes]) -> int:
        waiting = self.end_at(pointer).waiting
        one = waiting.popleft() if waiting else None
        self.has_failed = one == "cannot be read"
        if callable(one):
            one = one()
        if not isinstance(one, tuple):
            return 601  # RCL_RET_SERVICE_TAKE_FAILED, for both
        message["payload"], header.value = one
        return 0

    def read(self, data: Any, kind: Any, message: dict[str, bytes]) -> None:
        assert kind is not None
        message["payload"] = ctypes.string_at(data._obj.buffer, data._obj.length)

    def sent(self, pointer: int, header: Any, message: dict[str, bytes]) -> int:
        end = self.end_at(pointer)
        self.has_failed = end.is_over
        if not end.is_over:
            end.sent.append((message["payload"], header.value))
        return int(end.is_over)


class AnyModule(ModuleType):
    """``std_srvs.srv`` and others: a class of each name."""

    def __init__(self, name: str, rclpy: Rclpy) -> None:
        super().__init__(name)
        self.rclpy = rclpy

    def __getattr__(self, name: str) -> Any:
        def part(of: str) -> Any:
            def made() -> Any:
                full = f"m100_msgs/action/FlyTo_SendGoal_{of}"
                empty = {
                    "Request": {
                        "goal_id": {"uuid": [0] * 16},
                        "goal": dict.fromkeys(("latitude", "longitude", "height", "speed"), 0.0),
                    },
                    "Response": {"accepted": False, "stamp": {"sec": 0, "nanosec": 0}},
                }[of]
                return SimpleNamespace(payload=encode(full, empty))

            fields = self.rclpy.fields if of == "Request" else ["accepted", "stamp"]
            made.get_fields_and_field_types = lambda: dict.fromkeys(fields)  # type: ignore[attr-defined] # as a class has it
            return made

        halves = {"Request": part("Request"), "Response": part("Response")}
        service = SimpleNamespace(name=name, **(halves if "srv" in self.__name__ else {}))
        service.Impl = SimpleNamespace(SendGoalService=SimpleNamespace(**halves))
        return service


@pytest.fixture
def rclpy(monkeypatch: pytest.MonkeyPatch) -> Iterator[Rclpy]:
    with monkeypatch.context() as patched:
        yield Rclpy(patched)


def declared(bus: dds.DdsBus, end: EntityKind, topic: str, kind: str, qos: Qos = Qos()) -> str:  # noqa: B008 - frozen
    bus.declare(NAME.token_of(1, end, topic, kind, qos)).close()
    return data_key(7, topic, kind)


async def test_a_publisher_is_one_of_rclpy(rclpy: Rclpy) -> None:
    async with dds.open_dds(7, LARGEST) as bus:
        bus.declare(NAME.token)
        [node] = rclpy.nodes
        assert (node.name, node.namespace) == ("m100", "/")
        qos = Qos(is_reliable=False, depth=3)
        key = declared(bus, EntityKind.PUBLISHER, "/m100/imu", "sensor_msgs/Imu", qos)
        outlet, end = bus.publish(key), node.ends["/m100/imu"]
        assert end.kind.name == "Imu"
        assert end.qos == {"depth": 3, "reliability": "best", "durability": "volatile"}
        assert not outlet.is_wanted()
        end.listeners = 1
        assert outlet.is_wanted()
        outlet.put(b"one", b"attachment")
        end.is_over = True
        outlet.put(b"two")
        outlet.close()
        outlet.put(b"three")
        assert end.sent == [b"one"]
        latched = Qos(is_latched=True, depth=1)
        declared(bus, EntityKind.PUBLISHER, "/rosout", "rcl_interfaces/Log", latched)
        assert node.ends["/rosout"].qos["durability"] == "latched"
        with pytest.raises(ValueError, match="no token"):
            bus.declare("anything")
    assert not rclpy.up
    assert not set(dds._PERIOD) & set(os.environ)
    # As their schemas name it: fastRTPS_profiles.xsd of 2.14, fastdds_profiles.xsd of 3.2.
    for text, tag in zip(rclpy.profiles, ("heartbeatPeriod", "heartbeat_period"), strict=True):
        [period] = ElementTree.fromstring(text).iterfind(f".//{{*}}{tag}/{{*}}nanosec")
        assert period.text == "200000000"
        assert "<leaseDuration><sec>3</sec></leaseDuration>" in text


async def test_profiles_of_the_user_stay(rclpy: Rclpy, tmp_path: Path) -> None:
    mine = tmp_path / "mine.xml"
    mine.write_text("<profiles/>", encoding="utf-8")
    rclpy.monkeypatch.setenv(FAST_DDS_2, str(mine))
    async with dds.open_dds(7, LARGEST):
        assert rclpy.profiles == ["<profiles/>"]


async def test_a_message_comes_with_its_sender(rclpy: Rclpy) -> None:
    async with dds.open_dds(7, LARGEST) as bus:
        bus.declare(NAME.token)
        key = declared(bus, EntityKind.SUBSCRIBER, CMD_VEL, "geometry_msgs/TwistStamped")
        inbox = bus.inbox(key, 2)
        assert inbox.take() == []
        one, two = bytes(range(16)), bytes(range(16, 32))
        pointer = rclpy.nodes[0].ends[CMD_VEL].handle.pointer
        rclpy.waiting[pointer] = deque(
            [(b"a", 5, 1, one), (b"b" * 1001, 6, 1, two), (b"c", -1, 2, one)]
        )
        first, long = inbox.take()
        assert (first.payload, read_attachment(first.attachment)) == (b"a", Attachment(1, 5, one))
        assert (long.payload, read_attachment(long.attachment).gid) == (b"", two)
        assert read_attachment(inbox.take()[0].attachment).at_ns == 0, "a clock before 1970"


async def test_a_request_is_answered_to_who_asked(rclpy: Rclpy) -> None:
    async with dds.open_dds(7, LARGEST) as bus:
        bus.declare(NAME.token)
        key = declared(bus, EntityKind.SERVER, "/m100/land", "std_srvs/srv/Trigger")
        inbox, end = bus.questions(key, 8), rclpy.nodes[0].ends["/m100/land"]
        assert inbox.take() == []
        end.waiting.append((b"asked", b"anna"))
        [question] = inbox.take()
        assert (question.key, question.payload) == (key, b"asked")
        read_attachment(question.attachment)
        question.answer(key, b"done", b"")
        assert end.sent == [(b"done", b"anna")]
        end.is_over = True
        question.answer(key, b"again", b"")
        question.drop()
        end.waiting.append((b"x" * 1001, b"anna"))
        assert inbox.take()[0].payload == b""


async def test_requests_that_cannot_be_read_hold_up_none_behind_them(rclpy: Rclpy) -> None:
    async with dds.open_dds(7, LARGEST) as bus:
        bus.declare(NAME.token)
        key = declared(bus, EntityKind.SERVER, "/m100/stop", "std_srvs/srv/Trigger")
        inbox, end = bus.questions(key, 8), rclpy.nodes[0].ends["/m100/stop"]
        end.waiting.extend(["cannot be read"] * 7 + [(b"stop", b"anna"), (b"more", b"bert")])
        assert [one.payload for one in inbox.take()] == [b"stop"]
        assert [one.payload for one in inbox.take()] == [b"more"], "eight in a step"
        assert not rclpy.has_failed


async def test_what_takes_long_to_be_read_holds_up_no_step(rclpy: Rclpy) -> None:
    """rcl made a million parameters of a megabyte that says so: 1.8 s, in which nobody flew."""
    async with dds.open_dds(7, LARGEST) as bus:
        bus.declare(NAME.token)
        kind = "rcl_interfaces/srv/SetParameters"
        key = declared(bus, EntityKind.SERVER, "/m100/set_parameters", kind)
        inbox, end = bus.questions(key, 8), rclpy.nodes[0].ends["/m100/set_parameters"]
        reads, goes_on = threading.Event(), threading.Event()

        def long() -> tuple[bytes, bytes]:
            reads.set()
            assert goes_on.wait(PATIENCE)
            return b"long", b"anna"

        def too_long() -> tuple[bytes, bytes]:
            raise MemoryError

        end.waiting.extend([too_long, long, (b"next", b"bert")])
        assert await asyncio.to_thread(reads.wait, PATIENCE)
        assert inbox.take() == []
        goes_on.set()
        found: list[bytes] = []
        while len(found) < 2:
            more = [one.payload for one in inbox.take()]
            assert len(more) <= 1, "one in a step"
            found += more
            await asyncio.sleep(0.01)
        assert found == [b"long", b"next"]


async def test_of_requests_that_wait_as_many_are_kept_as_its_depth_the_newest(
    rclpy: Rclpy,
) -> None:
    """As for every topic of ROS: a node that asks without an end takes no memory without one."""
    async with dds.open_dds(7, LARGEST) as bus:
        bus.declare(NAME.token)
        kind = "rcl_interfaces/srv/SetParameters"
        key = declared(bus, EntityKind.SERVER, "/m100/set_parameters", kind)
        inbox, end = bus.questions(key, 2), rclpy.nodes[0].ends["/m100/set_parameters"]
        end.waiting.extend((b"%d" % number, b"anna") for number in range(9))
        while end.waiting:  # noqa: ASYNC110 - a thread takes them
            await asyncio.sleep(0.01)
    assert [one.payload for _ in range(9) for one in inbox.take()] == [b"7", b"8"]


async def test_rclpy_stays_as_long_as_c_reads_a_request(rclpy: Rclpy) -> None:
    """A request of a megabyte took 1.8 s, and rclpy went after one."""
    reads, goes_on, leaves = threading.Event(), threading.Event(), asyncio.Event()

    def long() -> tuple[bytes, bytes]:
        reads.set()
        assert goes_on.wait(PATIENCE)
        return b"long", b"anna"

    async def ended() -> None:
        async with dds.open_dds(7, LARGEST) as bus:
            bus.declare(NAME.token)
            kind = "rcl_interfaces/srv/SetParameters"
            bus.questions(declared(bus, EntityKind.SERVER, "/m100/set_parameters", kind), 8)
            rclpy.nodes[0].ends["/m100/set_parameters"].waiting.extend([long, long])
            assert await asyncio.to_thread(reads.wait, PATIENCE)
            leaves.set()

    ending = asyncio.create_task(ended())
    await leaves.wait()
    for _ in range(100):
        await asyncio.sleep(0)
    assert rclpy.up
    assert not ending.done()
    reads.clear()
    goes_on.set()
    await ending
    assert not rclpy.up
    assert not reads.is_set(), "the next one was not begun"


async def test_room_for_a_long_message_is_given_back(rclpy: Rclpy) -> None:
    async with dds.open_dds(7, LARGEST) as bus:
        bus.declare(NAME.token)
        key = declared(bus, EntityKind.SUBSCRIBER, CMD_VEL, "geometry_msgs/TwistStamped")
        inbox = bus.inbox(key, 2)
        pointer = rclpy.nodes[0].ends[CMD_VEL].handle.pointer
        rclpy.waiting[pointer] = deque([(b"a" * 1000, 5, 1, bytes(16))])
        inbox.take()
        assert rclpy.freed == 0
        rclpy.waiting[pointer].append((b"b" * 1001, 6, 2, bytes(16)))
        inbox.take()
        assert rclpy.freed == 1


def test_what_a_capsule_holds_is_found() -> None:
    found = dds._inside(datetime_CAPI)
    table = ctypes.cast(ctypes.c_void_p(found), ctypes.POINTER(ctypes.py_object))
    assert table[0] is date, "PyDateTime_CAPI.DateType is its first member"


async def test_the_graph_is_asked_twice_a_second_and_for_each_goal(rclpy: Rclpy) -> None:
    rclpy.monkeypatch.setattr(dds, "_LOOK_S", 3600.0)
    async with dds.open_dds(7, LARGEST) as bus:
        bus.declare(NAME.token)
        key = declared(bus, EntityKind.SERVER, SEND, "m100_msgs/action/FlyTo_SendGoal")
        inbox, [node] = bus.questions(key, 8), rclpy.nodes
        presence = GraphDiscovery(lambda: bus.changes("@ros2_lv/7/**"))
        presence.look()
        asker = SimpleNamespace(endpoint_gid=list(range(16)), node_namespace="/", node_name="pilot")
        node.listening[f"rr{SEND}Reply"] = [asker]
        for _ in range(3):
            presence.look()
            assert not presence.clients(SEND)
        node.ends[SEND].waiting.append((b"goal", b"anna"))
        while not inbox.take():  # noqa: ASYNC110 - a thread brings it
            await asyncio.sleep(0.01)
        assert [one.node_name for one in presence.clients(SEND).values()] == ["/pilot"]


async def test_a_type_that_is_not_built_is_left_out_and_named(rclpy: Rclpy) -> None:
    async with dds.open_dds(7, LARGEST) as bus:
        bus.declare(NAME.token)
        key = declared(bus, EntityKind.PUBLISHER, "/tf", "tf2_msgs/TFMessage")
        outlet = bus.publish(key)
        outlet.put(b"nowhere")
        assert not outlet.is_wanted()
        rclpy.fields = ["goal"]  # of another version of m100_msgs
        key = declared(bus, EntityKind.SERVER, SEND, "m100_msgs/action/FlyTo_SendGoal")
        assert bus.questions(key, 8).take() == []
        key = declared(bus, EntityKind.SUBSCRIBER, "/x", "tf2_msgs/TFMessage")
        assert bus.inbox(key, 8).take() == []
        assert bus.missing == {"tf2_msgs": ["/tf", "/x"], "m100_msgs": [SEND]}


async def test_clients_of_goals_and_namesakes_are_tokens(rclpy: Rclpy) -> None:
    async with dds.open_dds(7, LARGEST) as bus:
        bus.declare(NAME.token)
        declared(bus, EntityKind.SERVER, SEND, "m100_msgs/action/FlyTo_SendGoal")
        [node], changes = rclpy.nodes, bus.changes("@ros2_lv/7/**")
        assert changes.take() == []
        assert not bus.is_alone(), "DDS has no router that could be missing"
        gid = bytes(range(16))
        asker = SimpleNamespace(
            endpoint_gid=list(gid), node_namespace="/", node_name="_NODE_NAME_UNKNOWN_"
        )
        node.listening[f"rr{SEND}Reply"] = [asker]
        [there] = changes.take()
        seen = read_token(there.key)
        assert there.is_there
        assert seen is not None
        assert (seen.end, seen.topic) == (EntityKind.CLIENT, SEND)
        assert seen.node[0] == gid[:12].hex(), "its participant"
        asker.node_name = "pilot"  # known a moment later: it is the same one
        assert changes.take() == []
        node.there.append(("m100", "/"))
        [namesake] = changes.take()
        seen = read_token(namesake.key)
        assert seen is not None
        assert (seen.node_name, seen.node[0] != bus.session) == ("/m100", True)
        node.listening.clear()
        node.there.pop()
        assert sorted(changes.take(), key=lambda one: one.key) == sorted(
            [TokenChange(there.key, False), TokenChange(namesake.key, False)],
            key=lambda one: one.key,
        )


async def test_a_name_in_the_graph_that_cannot_be_read_ends_nothing(rclpy: Rclpy) -> None:
    """Anybody may write bytes there that rclpy takes for UTF-8: seen with Cyclone, as 0xff 0xfe."""
    async with dds.open_dds(7, LARGEST) as bus:
        bus.declare(NAME.token)
        declared(bus, EntityKind.SERVER, SEND, "m100_msgs/action/FlyTo_SendGoal")
        [node], changes = rclpy.nodes, bus.changes("@ros2_lv/7/**")
        asker = SimpleNamespace(endpoint_gid=list(range(16)), node_namespace="/", node_name="pilot")
        node.listening[f"rr{SEND}Reply"] = [asker]

        def unreadable(*_: str, **__: bool) -> Any:
            return b"\xff\xfe".decode()

        with rclpy.monkeypatch.context() as patched:
            patched.setattr(node, "get_node_names_and_namespaces", unreadable)
            [there] = changes.take()
            assert there.is_there, "a client of a goal is found beside a bad node name"
            patched.setattr(node, "get_subscriptions_info_by_topic", unreadable)
            assert changes.take() == [TokenChange(there.key, False)], "unknown: its goal ends"
        assert changes.take() == [there]


async def test_who_listens_to_feedback_and_takes_none_does_not_answer(rclpy: Rclpy) -> None:
    async with dds.open_dds(7, LARGEST) as bus:
        bus.declare(NAME.token)
        rclpy.module.serialization.serialize_message = lambda _: pytest.fail("no type of ours")
        rclpy.monkeypatch.setattr(bus, "_type", lambda _: None)
        declared(bus, EntityKind.PUBLISHER, FEEDBACK, "m100_msgs/action/FlyTo_FeedbackMessage")
        probe = bus.probe("@/00/*", timeout=1.0)
        assert probe.take() == [True]
        rclpy.nodes[0].ends[FEEDBACK].is_acked = False
        assert probe.take() == []


@pytest.mark.parametrize("slow", ["rmw_connextdds", "profiles of the user"])
async def test_who_acknowledges_slowly_is_left_to_the_lease(rclpy: Rclpy, slow: str) -> None:
    """Fast DDS asks for it every 3 s by default: a program that runs looked like one that hangs."""
    if slow.startswith("rmw"):
        rclpy.middleware = slow
    else:
        rclpy.monkeypatch.setenv(FAST_DDS_3, os.devnull)
    async with dds.open_dds(7, LARGEST) as bus:
        assert bus.probe("@/00/*", timeout=1.0).take() == []


async def test_a_node_on_dds_names_what_it_leaves_out(rclpy: Rclpy, rig: Rig) -> None:
    settings = Settings(ros2=True, ros2_rmw="dds", ros2_domain=7)
    async with serving_ros2({"": rig.client}, settings) as [node]:
        assert node.name.full == "/m100"
        [made] = rclpy.nodes
        assert {"/m100/odom", "/m100/cmd_vel", "/m100/land", "/diagnostics"} <= made.ends.keys()
        texts = [one.text for one in rig.client.events]
        assert "tf2_msgs is not built here: there is no /tf, /tf_static" in texts
    assert not rclpy.up


async def test_without_rclpy_the_error_names_how_to_get_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def imported(name: str) -> Any:
        raise ModuleNotFoundError(f"No module named {name!r}")

    monkeypatch.setattr(dds, "import_module", imported)
    with pytest.raises(UsageError, match="needs rclpy") as caught:
        async with dds.open_dds(7, LARGEST):
            """Not reached."""
    assert "ros-jazzy-rclpy[fastrtps]" in str(caught.value)


async def test_an_rclpy_that_cannot_begin_is_an_error_of_usage(rclpy: Rclpy) -> None:
    rclpy.refuses = "failed to load librmw_x.so"
    with pytest.raises(UsageError, match="librmw_x"):
        async with dds.open_dds(7, LARGEST):
            """Not reached."""
