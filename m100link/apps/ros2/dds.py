"""The node on DDS: rclpy, of an installed ROS 2 or of wheels, as the bus that a node speaks on.

A node declares rmw_zenoh's tokens, which say everything of an end: of each, rclpy makes one here.
Nothing of rclpy runs by itself: its queues are emptied at each step, as zenoh's rings are, and it
handles no signal.
"""

from __future__ import annotations

import asyncio
import ctypes
import logging
import os
import threading
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import aclosing, asynccontextmanager, contextmanager
from functools import partial
from importlib import import_module
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Generic, TypeVar

from m100link.apps.agent.background import goes_on
from m100link.apps.bus.network import Held, Inbox, Outlet, Question, Received, TokenChange
from m100link.apps.ros2.graph import EntityKind, NodeName, Qos, read_token, write_attachment
from m100link.errors import UsageError
from m100link.log.cdr import OWN_PACKAGE, decode

_logger = logging.getLogger(__name__)

T = TypeVar("T")

WHEELS = "pip install 'ros-jazzy-rclpy[fastrtps]' ros-jazzy-common-interfaces"

_GOALS, _FEEDBACK = "/_action/send_goal", "/_action/feedback"
_SHORT = ("/std_srvs::", "/action_msgs::")  # types whose requests have one length, in keys
_HEADER = 24  # bytes of rmw_request_id_t: the client, and its number of the request
_APART_S = 0.05
_LOOK_S = 0.5  # between two looks at the graph, which take a millisecond each
_OF_ACTION = {"SendGoal": "SendGoalService", "GetResult": "GetResultService"}

_PROFILES = """<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
<participant profile_name="m100link" is_default_profile="true"><rtps><builtin><discovery_config>
<leaseDuration><sec>3</sec></leaseDuration><leaseAnnouncement><sec>1</sec></leaseAnnouncement>
</discovery_config></builtin></rtps></participant>
<data_writer profile_name="m100link" is_default_profile="true"><times><{period}>
<nanosec>200000000</nanosec></{period}></times></data_writer></profiles>"""
"""Of Fast DDS, where its defaults are too slow for a flight: others know for 20 s of a node that
was killed, and it asks its listeners every 3 s whether they have everything."""

_PERIOD = {
    "FASTRTPS_DEFAULT_PROFILES_FILE": "heartbeatPeriod",  # Fast DDS 2: Jazzy
    "FASTDDS_DEFAULT_PROFILES_FILE": "heartbeat_period",  # Fast DDS 3: Kilted
}
"""The name of a setting in the profiles, by the variable that names their file."""


class _Allocator(ctypes.Structure):
    """rcutils_allocator_t: four functions, and what they share."""

    _fields_ = (("parts", ctypes.c_void_p * 5),)


class _Bytes(ctypes.Structure):
    _fields_ = (
        ("buffer", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    )


class _Info(ctypes.Structure):
    """rmw_message_info_t, and room for what a later version adds."""

    _fields_ = (
        ("source_ns", ctypes.c_int64),
        ("received_ns", ctypes.c_int64),
        ("sequence", ctypes.c_uint64),
        ("received", ctypes.c_uint64),
        ("middleware", ctypes.c_char_p),
        ("gid", ctypes.c_ubyte * 16),
        ("room", ctypes.c_ubyte * 64),
    )


class _Half:
    """The requests of a service, or its responses, with room in C for one of them."""

    def __init__(self, kind: Any) -> None:
        self._make = ctypes.CFUNCTYPE(ctypes.c_void_p)(_inside(kind._CREATE_ROS_MESSAGE))
        self._end = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(_inside(kind._DESTROY_ROS_MESSAGE))
        self.support, self.message = _inside(kind._TYPE_SUPPORT), self._make()

    def renew(self) -> None:
        """Give back what a long one takes."""
        self._end(self.message)
        self.message = self._make()


def _inside(capsule: Any) -> int:
    """The address in a capsule of Python."""
    of = ctypes.pythonapi
    of.PyCapsule_GetName.restype, of.PyCapsule_GetPointer.restype = ctypes.c_char_p, ctypes.c_void_p
    name = ctypes.c_char_p(of.PyCapsule_GetName(ctypes.py_object(capsule)))
    return int(of.PyCapsule_GetPointer(ctypes.py_object(capsule), name))


class _Polled(Generic[T]):
    """An inbox of what is there when it is asked."""

    def __init__(self, take: Callable[[], list[T]]) -> None:
        self.take = take


def _some(take: Callable[[], T | None], depth: int) -> list[T]:
    """So many at most of what is taken one by one."""
    return list(islice(iter(take, None), depth))


def _asked(ask: Callable[..., list[T]], *of: str, **more: bool) -> list[T]:
    """An answer of rclpy about the graph; empty where a name in it cannot be read."""
    try:
        return ask(*of, **more)
    except (RuntimeError, ValueError) as error:  # rclpy's own, and of a name that is no UTF-8
        _logger.debug("the graph cannot be read: %s", error)
        return []


class _Outlet(Outlet):
    def __init__(self, publisher: Any = None) -> None:
        self._publisher: Any = publisher  # None where its type is not built here

    def put(self, payload: bytes, attachment: bytes | None = None) -> None:
        if self._publisher is not None:
            try:
                self._publisher.publish(payload)
            except RuntimeError as error:  # rclpy's own: it has ended
                _logger.debug("not sent: %s", error)

    def is_wanted(self) -> bool:
        return self._publisher is not None and self._publisher.get_subscription_count() > 0

    def close(self) -> None:
        self._publisher = None  # it ends with its node


class DdsBus:
    """A :class:`m100link.apps.bus.network.PolledBus` of rclpy, in one domain."""

    session = "0"  # of this process, in the tokens that stand for the graph

    def __init__(
        self,
        rclpy: Any,
        context: Any,
        domain: int,
        largest: int,
        *,
        hears_acks: bool,  # whether listeners that run acknowledge at once, and not after seconds
    ) -> None:
        self._rclpy, self._context, self._hears_acks = rclpy, context, hears_acks
        self._domain, self._largest = domain, largest
        self._nodes: dict[str, Any] = {}  # by their full names
        self._ends: dict[str, Any] = {}  # what was declared last, by topic or service
        self._goals: dict[str, str] = {}  # services that take goals, with their types
        self._feedback: list[Any] = []  # publishers to which clients of goals listen
        self._clients: dict[bytes, str] = {}  # tokens by the gids of those clients
        self._looks_at = 0.0  # at the graph, by the clock that never goes back, s
        # Topics and services whose types are not built here, by the package of those types.
        self.missing: dict[str, list[str]] = {}
        c = ctypes.CDLL("librcl.so")  # rclpy has loaded it, and it the others: rmw and rcutils
        self._take, self._take_request = c.rcl_take_serialized_message, c.rcl_take_request
        self._send, self._serialize = c.rcl_send_response, c.rmw_serialize
        self._deserialize, self._free = c.rmw_deserialize, c.rcutils_uint8_array_fini
        self._has_failed, self._forget = c.rcutils_error_is_set, c.rcutils_reset_error
        self._take.argtypes = [ctypes.c_void_p] * 4
        for call in (self._take_request, self._send, self._serialize, self._deserialize):
            call.argtypes = [ctypes.c_void_p] * 3
        self._has_failed.restype = ctypes.c_bool
        self._info, self._allocator = _Info(), c.rcutils_get_default_allocator
        self._allocator.restype = _Allocator
        self._taken = _Bytes(allocator=self._allocator())
        self._apart: list[tuple[Callable[[], list[Question]], deque[Question]]] = []
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._take_apart, name="m100link: DDS", daemon=True)

    # -- what a node has: each end is made when it is declared -----------------------------------

    def declare(self, token: str) -> Held:
        seen, parts = read_token(token), token.split("/")
        if seen is None:
            raise ValueError(f"{token!r} is no token")
        if seen.end is EntityKind.NODE:
            self._nodes[seen.node_name] = self._node(*seen.node_name.rpartition("/")[::2])
            return _Outlet()
        *_, kind, _, text = parts
        kind = kind.replace("::dds_", "").replace("::", "/").removesuffix("_")
        made, topic, qos = None, seen.topic, self._qos(text)
        try:
            node, found = self._nodes[seen.node_name], self._type(kind)
            if seen.end is EntityKind.PUBLISHER:
                made = node.create_publisher(found, topic, qos)
            elif seen.end is EntityKind.SUBSCRIBER:
                made = node.create_subscription(found, topic, _nothing, qos, raw=True)
            else:
                made = node.create_service(found, topic, _nothing)
        except Exception as error:  # noqa: BLE001 - rosidl's loaders raise classes of their own
            _logger.debug("%s: %s is not built here: %r", topic, kind, error)
            self.missing.setdefault(kind.partition("/")[0], []).append(topic)
        self._ends[topic] = made
        if made is not None and topic.endswith(_GOALS):
            self._goals[topic] = kind
        if made is not None and topic.endswith(_FEEDBACK):
            self._feedback.append(made)
        return _Outlet()

    def _type(self, kind: str) -> Any:
        """The class of a type. Raises ValueError: it is built of other definitions than ours."""
        package, folder, name = kind.split("/")
        name, _, part = name.partition("_")
        found = getattr(import_module(f"{package}.{folder}"), name)
        found = getattr(found.Impl, _OF_ACTION.get(part, part)) if part else found
        halves = ("Request", "Response") if hasattr(found, "Request") else ()
        parts = {f"{kind}_{half}": getattr(found, half) for half in halves} or {kind: found}
        for name, one in parts.items():
            if package == OWN_PACKAGE:
                empty = self._rclpy.serialization.serialize_message(one())
                ours = decode(name.replace("/msg/", "/"), empty)
                if list(ours) != list(one.get_fields_and_field_types()):
                    raise ValueError(f"{name} is built of an older definition")
        return found

    def _node(self, namespace: str, name: str) -> Any:
        own = self._rclpy.parameter.Parameter("start_type_description_service", value=False)
        return self._rclpy.create_node(
            name,
            namespace=namespace or "/",
            context=self._context,
            # The node serves parameters and logs by itself, as it does on zenoh.
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[own],
        )

    def _qos(self, text: str) -> Any:
        """Of a token: ``reliability:durability:history,depth:…``, a default left empty."""
        qos, (reliability, durability, history, *_) = self._rclpy.qos, text.split(":")
        best, latched = qos.ReliabilityPolicy.BEST_EFFORT, qos.DurabilityPolicy.TRANSIENT_LOCAL
        return qos.QoSProfile(
            depth=int(history.partition(",")[2]),
            reliability=best if reliability == "2" else qos.ReliabilityPolicy.RELIABLE,
            durability=latched if durability == "1" else qos.DurabilityPolicy.VOLATILE,
        )

    def _end(self, key: str) -> Any:
        """The end of a key, which is ``domain/topic/type/hash``."""
        return self._ends["/" + "/".join(key.split("/")[1:-2])]

    # -- what goes through its ends ---------------------------------------------------------------

    def publish(self, key: str, *, kept: int = 0) -> Outlet:
        return _Outlet(self._end(key))

    def inbox(self, pattern: str, depth: int) -> Inbox[Received]:
        end = self._end(pattern)
        return _Polled(partial(_some, partial(self._received, end) if end else _nothing, depth))

    def _received(self, end: Any) -> Received | None:
        """The oldest that waits. rclpy hides its sender; rcl, below it, does not."""
        taken, info = self._taken, self._info
        if self._take(end.handle.pointer, ctypes.byref(taken), ctypes.byref(info), None):
            return None
        sender = write_attachment(info.sequence, max(0, info.source_ns), bytes(info.gid))
        return Received(self._payload(taken), sender)

    def _payload(self, taken: _Bytes) -> bytes:
        """The bytes that C has there, but for what is too long: that is not kept either."""
        is_read = 0 < taken.length <= self._largest
        payload = ctypes.string_at(taken.buffer, taken.length) if is_read else b""
        if taken.capacity > self._largest:
            self._free(ctypes.byref(taken))
            taken.allocator = self._allocator()
        return payload

    def questions(self, key: str, depth: int) -> Inbox[Question]:
        end = self._end(key)
        if end is None:
            return _Polled(list)
        kind = end.srv_type
        take = partial(self._asked_of, end, key, _Half(kind.Request), _Half(kind.Response), depth)
        if any(one in key for one in _SHORT):
            return _Polled(take)
        # One in a step: to read it takes some milliseconds here, too.
        found: deque[Question] = deque(maxlen=depth)
        self._apart.append((take, found))
        if not self._thread.is_alive():
            self._thread.start()
        return _Polled(lambda: [found.popleft()] if found else [])

    def _take_apart(self) -> None:
        """By a thread: C needs seconds for a request whose length is a lie."""
        while not self._is_over.wait(_APART_S):
            for take, found in self._apart:
                with goes_on("requests on DDS"):  # the thread serves the others, too
                    found.extend(take())

    async def aclose(self) -> None:
        """What C reads belongs to rclpy: it must not go before."""
        self._is_over.set()
        if self._thread.is_alive():
            await asyncio.to_thread(self._thread.join)

    def _asked_of(
        self, end: Any, key: str, request: _Half, response: _Half, depth: int
    ) -> list[Question]:
        """The requests that wait. C says of one that it cannot read that it took nothing."""
        found: list[Question] = []
        for _ in range(depth):
            header = ctypes.create_string_buffer(_HEADER)
            gone = self._is_over.is_set()
            if gone or self._take_request(end.handle.pointer, header, request.message):
                if not self._has_failed():
                    break
                self._forget()
                continue
            taken = _Bytes(allocator=self._allocator())
            self._serialize(request.message, request.support, ctypes.byref(taken))
            request.renew()
            if "SendGoal_" in key:  # its client may be new in the graph
                self._looks_at = 0.0
            answer = partial(self._answer, end, header, response)
            nobody = write_attachment(0, 0, bytes(16))
            found.append(Question(key, self._payload(taken), answer, _nothing, nobody))
            self._free(ctypes.byref(taken))
        return found

    def _answer(
        self, end: Any, header: Any, half: _Half, key: str, payload: bytes, attachment: bytes = b""
    ) -> None:
        held = ctypes.create_string_buffer(payload, len(payload))
        data = _Bytes(ctypes.addressof(held), len(payload), len(payload), self._allocator())
        self._deserialize(ctypes.byref(data), half.support, half.message)
        if self._send(end.handle.pointer, header, half.message):
            _logger.debug("%s: not answered", key)  # rclpy has ended, or the client has
            self._forget()

    # -- the rest of the graph --------------------------------------------------------------------

    def changes(self, pattern: str) -> Inbox[TokenChange]:
        """Nodes of our names, and clients of goals: nobody asks about the rest of the graph."""
        known: set[str] = set()

        def look() -> list[TokenChange]:
            nonlocal known
            if time.monotonic() < self._looks_at:
                return []
            self._looks_at = time.monotonic() + _LOOK_S
            before, known = known, set(self._others())
            changed = sorted(before ^ known, key=known.__contains__)  # those that are gone first
            return [TokenChange(one, one in known) for one in changed]

        return _Polled(look)

    def _others(self) -> Iterator[str]:
        for full, node in self._nodes.items():
            there = _asked(node.get_node_names_and_namespaces)
            if [f"{where.rstrip('/')}/{name}" for name, where in there].count(full) > 1:
                yield NodeName(self._domain, "1", node.get_namespace(), node.get_name()).token
        node, clients = next(iter(self._nodes.values())), {}
        ask = node.get_subscriptions_info_by_topic
        for goals, kind in self._goals.items():
            for one in _asked(ask, f"rr{goals}Reply", no_mangle=True):
                gid = bytes(one.endpoint_gid)
                who = NodeName(self._domain, gid[:12].hex(), one.node_namespace, one.node_name)
                number = int.from_bytes(gid[12:], "big")
                token = who.token_of(number, EntityKind.CLIENT, goals, kind, Qos())
                # The name of its node comes a moment after it: that does not make it another one.
                clients[gid] = self._clients.get(gid, token)
        self._clients = clients
        yield from clients.values()

    def is_alone(self) -> bool:
        return False  # DDS needs no router, and nobody else has to be there

    def probe(self, key: str, *, timeout: float) -> Inbox[bool]:
        """Whether each listener to the feedback of goals has all of it.

        A program that was killed acknowledges nothing; DDS misses it after 10 to 20 s. Nobody
        answers where a program that runs would take seconds for it, too: then the lease decides.
        """
        now, ends = self._rclpy.duration.Duration(), self._feedback

        def take() -> list[bool]:
            is_there = self._hears_acks and all(one.wait_for_all_acked(now) for one in ends)
            return [True] if is_there else []

        return _Polled(take)


def _nothing(*_: object) -> None:
    """Nothing waits, or is to be done."""


@contextmanager
def _asking_often() -> Iterator[bool]:
    """Have Fast DDS read :data:`_PROFILES`; false where the user has profiles, which stay."""
    if any(os.environ.get(name) for name in _PERIOD):
        yield False
        return
    with TemporaryDirectory(prefix="m100link-dds-") as folder:
        for name, period in _PERIOD.items():
            path = Path(folder, f"{period}.xml")
            path.write_text(_PROFILES.format(period=period), encoding="utf-8")
            os.environ[name] = str(path)
        try:
            yield True
        finally:
            for name in _PERIOD:
                del os.environ[name]


def no_rclpy(why: str) -> UsageError:
    return UsageError(
        f"DDS needs rclpy: {why}",
        cause="no ROS 2 is sourced here, and there are no wheels of it",
        remedy=f"source a ROS 2 (Jazzy or later), or on Linux x86-64: {WHEELS}",
    )


@asynccontextmanager
async def open_dds(domain: int, largest: int) -> AsyncIterator[DdsBus]:
    """A bus on DDS while the block runs. Raises UsageError: rclpy is missing, or cannot begin."""
    try:
        rclpy: Any = import_module("rclpy")
        for part in ("duration", "parameter", "qos", "serialization", "signals", "utilities"):
            import_module(f"rclpy.{part}")
    except ImportError as error:
        raise no_rclpy(str(error)) from error
    with _asking_often() as is_fast:
        context = rclpy.context.Context()
        handlers = rclpy.signals.SignalHandlerOptions.NO
        try:
            rclpy.init(args=[], context=context, domain_id=domain, signal_handler_options=handlers)
        except RuntimeError as error:
            remedy = "check RMW_IMPLEMENTATION, and the variables of that middleware"
            raise UsageError(f"rclpy cannot begin: {error}", remedy=remedy) from error
        try:
            middleware = rclpy.utilities.get_rmw_implementation_identifier()
            acks = is_fast and middleware.startswith("rmw_fastrtps")
            async with aclosing(DdsBus(rclpy, context, domain, largest, hears_acks=acks)) as bus:
                yield bus
        finally:
            rclpy.shutdown(context=context)
