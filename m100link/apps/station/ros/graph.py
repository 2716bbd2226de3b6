"""Topics and services of the station, and who listens: what roscore is to ROS nodes.

The set of topics and services is fixed when the station starts. Clients can use it, not extend it:
nothing a client does makes it grow.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import count
from operator import attrgetter
from typing import Any, Protocol

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.messages import Event
from m100link.apps.station.ros.messages import (
    MESSAGES,
    SERVICES,
    Message,
    MessageType,
    ServiceType,
    canonical_type,
    definition,
    nested,
    present,
    serialise,
    to_cbor,
    to_png,
)


def canonical_name(name: str) -> str:
    """Names with and without a leading slash are the same topic."""
    return name if name.startswith("/") else f"/{name}"


_sequence = count(1)


def stamped(frame: str) -> Message:
    """A header: the present time, and a number that counts up."""
    return {"seq": next(_sequence) & 0xFFFFFFFF, "stamp": present(), "frame_id": frame}


class Publication:
    """A message on its way to any number of clients: packed once for all of them."""

    __slots__ = ("_json", "_packed", "message", "topic")

    def __init__(self, topic: RosTopic, message: Message) -> None:
        self.topic = topic
        self.message = message
        self._json: str | None = None
        self._packed: dict[tuple[str, str], str | bytes] = {}

    def text(self, name: str) -> str:
        """The ``publish`` frame, with the topic's name as the client wrote it."""
        if self._json is None:
            self._json = self.topic.type.to_json(self.message)
        return f'{{"op":"publish","topic":{json.dumps(name)},"msg":{self._json}}}'

    def pack(self, name: str, compression: str) -> str | bytes:
        """The frame in one of these forms; packed once for all clients."""
        frame = self._packed.get((name, compression))
        if frame is None:
            if compression == "cbor-raw":
                raw = {"bytes": serialise(self.topic.type, self.message), **present()}
                frame = to_cbor({"op": "publish", "topic": name, "msg": raw})
            elif compression == "cbor":
                message = self.topic.type.to_cbor(self.message)
                frame = to_cbor({"op": "publish", "topic": name, "msg": message})
            else:
                frame = self.text(name)
                if compression == "png":
                    frame = to_png(frame)
            self._packed[name, compression] = frame
        return frame


class GraphListener(Protocol):
    """A user of the topics and services, as they see it."""

    name: str  # who it is, for people
    data: dict[str, Any]  # for the nodes: what they know about this listener

    def deliver(self, publication: Publication, now: float) -> None:
        """A message was published on a topic that it subscribed."""

    def respond(self, call: ServiceCall, values: str, result: bool) -> None:
        """The answer to its call; ``values`` is JSON."""

    def status(self, level: str, text: str) -> None:
        """Report something, with the level ``error``, ``warning`` or ``info``."""


_DJI, _WEB = "/dji_sdk", "/dji_sdk_web_groundstation/map_nav_srv"
_STOP_OR_PAUSE = 1, 2

ENDING: Mapping[str, Callable[[Message], bool]] = {
    "/m100link/stop": lambda _: True,
    "/m100link/lease": lambda one: one["action"] == "release",
    "/sdk_request_cmd": lambda one: one["data"] in (1, 6),  # go-home, landing
    "/nav_open_close_request": lambda one: one["data"] == 0,
    "/sdk_request_simple_task": lambda one: one["data"] <= -1,
    "/sdk_request_ctrl": lambda one: not any(one.values()),  # keys are let go
    f"{_DJI}/sdk_control_authority": lambda one: one["control_enable"] == 0,
    f"{_DJI}/sdk_permission_control": lambda one: one["control_enable"] == 0,
    f"{_DJI}/drone_task_control": lambda one: one["task"] in (1, 6),
    f"{_DJI}/drone_task_action/goal": lambda one: one["goal"]["task"] in (2, 3),
    f"{_DJI}/drone_arm_control": lambda one: one["arm"] == 0,
    f"{_DJI}/mission_waypoint_action": lambda one: one["action"] in _STOP_OR_PAUSE,
    f"{_DJI}/mission_hotpoint_action": lambda one: one["action"] in _STOP_OR_PAUSE,
    f"{_DJI}/mission_pause": lambda one: one["pause"] == 0,
    f"{_DJI}/mission_cancel": lambda _: True,
    f"{_WEB}/ctrl": lambda one: not one["data"],
    f"{_WEB}/cmd": lambda one: one["cmdCode"] == ord("c"),
}
"""Whether a message stops, lands or gives control back, by its topic or service, and so does each
cancel of an action: no limit of a client counts or drops it."""

MAY_END = re.compile("|".join([*(re.escape(one[1:]) for one in ENDING), "cancel", r"\\"]))
"""Finds a name of them in a frame, or a backslash, which may hide one; cheaper than to read all."""


def _ends(name: str, message: Message) -> bool:
    return name.endswith("/cancel") or (name in ENDING and ENDING[name](message))


@dataclass(slots=True, eq=False)
class RosTopic:
    name: str  # its name, with a leading slash
    type: MessageType  # type of its messages
    # The effect of a client's message; None on topics that only the station publishes.
    on_publish: Callable[[GraphListener, Message, float], None] | None = None
    ends: Callable[[Message], bool] = lambda _: False  # as :data:`ENDING`
    subscribers: set[GraphListener] = field(default_factory=set)  # sessions that listen


@dataclass(slots=True, eq=False)
class ServiceCall:
    session: GraphListener
    service: RosService
    request: Message  # the checked request
    identity: Any
    now: float  # when it came
    is_answered: bool = False

    @property
    def ends(self) -> bool:
        return self.service.ends(self.request)

    def respond(self, response: Message) -> None:
        """Answer with the fields given; the others have their defaults."""
        if not self.is_answered:
            self.is_answered = True
            type_ = self.service.type.response
            self.session.respond(self, type_.to_json(type_.default() | response), True)

    def fail(self, reason: str) -> None:
        if not self.is_answered:
            self.is_answered = True
            self.session.respond(self, json.dumps(reason), False)


@dataclass(slots=True, eq=False)
class RosService:
    name: str  # its name, with a leading slash
    type: ServiceType
    on_call: Callable[[ServiceCall], None]  # answers a call, at once or later
    ends: Callable[[Message], bool] = lambda _: False  # as :data:`ENDING`, by its request


class Graph:
    """The topics and services, and the sessions that use them.

    With several aircraft each has a namespace in it: :meth:`namespace`.
    """

    def __init__(self, prefix: str = "", whole: Graph | None = None) -> None:
        self.prefix = prefix
        # Topics by name, those of all namespaces.
        self.topics: dict[str, RosTopic] = {} if whole is None else whole.topics
        # Topics whose name has another type in an earlier node of DJI's, by name and type.
        self.others: dict[tuple[str, str], RosTopic] = {} if whole is None else whole.others
        # Services by name, those of all namespaces.
        self.services: dict[str, RosService] = {} if whole is None else whole.services
        self.sessions: set[GraphListener] = set() if whole is None else whole.sessions
        # Called when a client has gone.
        self.on_leave: list[Callable[[GraphListener, float], None]] = (
            [] if whole is None else whole.on_leave
        )

    def namespace(self, name: str) -> Graph:
        """A part of this graph: whatever is added to it is called ``/name/…``."""
        return Graph(f"{self.prefix}/{name}", self)

    def known(self, session: GraphListener) -> dict[str, Any]:
        """The data about a listener that the nodes of this namespace keep."""
        known: dict[str, Any] = session.data.setdefault(f"nodes of {self.prefix or '/'}", {})
        return known

    def add_topic(
        self,
        name: str,
        type_name: str,
        on_publish: Callable[[GraphListener, Message, float], None] | None = None,
    ) -> RosTopic:
        """A topic that the station publishes, or takes messages from.

        DJI's nodes have a name more than once, with another type: a client says which it wants.
        """
        name, ends = self.prefix + name, partial(_ends, name)
        topic = RosTopic(name, MESSAGES[type_name], on_publish, ends)
        if self.topics.setdefault(name, topic) is not topic:
            self.others[name, type_name] = topic
        return topic

    def topic(self, name: str, type_name: str | None = None) -> RosTopic | None:
        """The topic of a name, and of that type where one is given."""
        found = self.topics.get(canonical_name(name))
        if found is None or type_name in (None, found.type.name):
            return found
        return self.others.get((found.name, str(type_name)))

    def all_topics(self) -> Iterator[RosTopic]:
        yield from self.topics.values()
        yield from self.others.values()

    def add_service(
        self, name: str, type_name: str, on_call: Callable[[ServiceCall], None]
    ) -> None:
        name, ends = self.prefix + name, partial(_ends, name)
        self.services[name] = RosService(name, SERVICES[type_name], on_call, ends)

    def publish(self, topic: RosTopic, message: Message, now: float) -> None:
        if topic.subscribers:
            publication = Publication(topic, message)
            for session in topic.subscribers:
                session.deliver(publication, now)

    def leave(self, session: GraphListener, now: float) -> None:
        if session in self.sessions:
            self.sessions.discard(session)
            for topic in self.all_topics():
                topic.subscribers.discard(session)
            for callback in self.on_leave:
                callback(session, now)


# -- rosapi ----------------------------------------------------------------------------------------
# There is one node here, and no parameter server.

NODE = "/m100link"  # the node that publishes and subscribes everything here


class _Failed(Exception):
    """A question without an answer, in words for the client."""


def add_rosapi(graph: Graph) -> None:
    api, of_service = _RosApi(graph), partial(_details, "service", SERVICES)
    for name, kind, answer in (
        ("topics", "Topics", api.topics),
        ("topic_type", "TopicType", api.topic_type),
        ("topics_for_type", "TopicsForType", api.topics_for_type),
        ("topics_and_raw_types", "TopicsAndRawTypes", api.topics_and_raw_types),
        ("publishers", "Publishers", api.publishers),
        ("subscribers", "Subscribers", api.subscribers),
        ("services", "Services", api.services),
        ("service_type", "ServiceType", api.service_type),
        ("services_for_type", "ServicesForType", api.services_for_type),
        ("service_providers", "ServiceProviders", api.service_providers),
        ("service_node", "ServiceNode", api.service_node),
        ("service_host", "ServiceHost", api.service_host),
        ("action_servers", "GetActionServers", api.action_servers),
        ("nodes", "Nodes", lambda _: {"nodes": [NODE]}),
        ("node_details", "NodeDetails", api.node_details),
        ("message_details", "MessageDetails", _details("message", MESSAGES, lambda one: one)),
        ("service_request_details", "ServiceRequestDetails", of_service(attrgetter("request"))),
        ("service_response_details", "ServiceResponseDetails", of_service(attrgetter("response"))),
        ("get_time", "GetTime", lambda _: {"time": present()}),
        ("get_param", "GetParam", lambda asked: {"value": asked["default"] or json.dumps(None)}),
        ("get_param_names", "GetParamNames", lambda _: {"names": []}),
        ("has_param", "HasParam", lambda _: {"exists": False}),
        ("search_param", "SearchParam", lambda _: {"global_name": ""}),
        ("set_param", "SetParam", _no_parameters),
        ("delete_param", "DeleteParam", _no_parameters),
    ):
        graph.add_service(f"/rosapi/{name}", f"rosapi/{kind}", _answering(answer))


def _answering(answer: Callable[[Message], Message]) -> Callable[[ServiceCall], None]:
    def on_call(call: ServiceCall) -> None:
        try:
            call.respond(answer(call.request))
        except _Failed as error:
            call.fail(str(error))

    return on_call


def _no_parameters(_: Message) -> Message:
    raise _Failed("there are no parameters here that could be changed")


class _RosApi:
    def __init__(self, graph: Graph) -> None:
        self._graph = graph

    def _topics(self) -> list[RosTopic]:
        return [self._graph.topics[name] for name in sorted(self._graph.topics)]

    def topics(self, _: Message) -> Message:
        found = self._topics()
        return {"topics": [one.name for one in found], "types": [one.type.name for one in found]}

    def topic_type(self, request: Message) -> Message:
        topic = self._graph.topics.get(canonical_name(request["topic"]))
        return {"type": topic.type.name if topic else ""}

    def topics_for_type(self, request: Message) -> Message:
        wanted = canonical_type(request["type"])
        found = (one.name for one in self._graph.all_topics() if one.type.name == wanted)
        return {"topics": sorted(found)}

    def action_servers(self, _: Message) -> Message:
        goals = (one for one in self._topics() if one.type.name.endswith("ActionGoal"))
        return {"action_servers": [one.name.removesuffix("/goal") for one in goals]}

    def topics_and_raw_types(self, request: Message) -> Message:
        texts = [definition(one.type) for one in self._topics()]
        return {**self.topics(request), "typedefs_full_text": texts}

    def publishers(self, request: Message) -> Message:
        topic = self._graph.topics.get(canonical_name(request["topic"]))
        return {"publishers": [NODE] if topic and topic.on_publish is None else []}

    def subscribers(self, request: Message) -> Message:
        topic = self._graph.topics.get(canonical_name(request["topic"]))
        return {"subscribers": [NODE] if topic and topic.on_publish is not None else []}

    def services(self, _: Message) -> Message:
        return {"services": sorted(self._graph.services)}

    def service_type(self, request: Message) -> Message:
        service = self._graph.services.get(canonical_name(request["service"]))
        return {"type": service.type.name if service else ""}

    def services_for_type(self, request: Message) -> Message:
        services, wanted = self._graph.services, canonical_type(request["type"])
        return {"services": sorted(n for n, one in services.items() if one.type.name == wanted)}

    def service_providers(self, request: Message) -> Message:
        found = self.services_for_type({"type": request["service"]})["services"]
        return {"providers": [NODE] if found else []}

    def service_node(self, request: Message) -> Message:
        return {"node": NODE if canonical_name(request["service"]) in self._graph.services else ""}

    def service_host(self, request: Message) -> Message:
        is_here = canonical_name(request["service"]) in self._graph.services
        return {"host": "localhost" if is_here else ""}

    def node_details(self, request: Message) -> Message:
        if canonical_name(request["node"]) != NODE:
            return {}
        topics = self._topics()
        return {
            "subscribing": [one.name for one in topics if one.on_publish is not None],
            "publishing": [one.name for one in topics if one.on_publish is None],
            "services": sorted(self._graph.services),
        }


def _details(
    what: str, known: Mapping[str, Any], half: Callable[[Any], MessageType]
) -> Callable[[Message], Message]:
    def answer(request: Message) -> Message:
        found = known.get(canonical_type(request["type"]))
        if found is None:
            raise _Failed(f"there is no {what} type {request['type'][:128]!r} here")
        kind = half(found)
        return {"typedefs": [_typedef(one) for one in (kind, *nested(kind))]}

    return answer


def _typedef(kind: MessageType) -> Message:
    fields = kind.fields
    return {
        "type": kind.type_name,
        "fieldnames": [field.name for field in fields],
        "fieldtypes": [field.type for field in fields],
        # -1 is not an array, 0 one of any length.
        "fieldarraylen": [-1 if field.length is None else field.length for field in fields],
        "examples": [_example(kind, field.name) for field in fields],
        "constnames": [name for name, _ in kind.constants],
        "constvalues": [str(value) for _, value in kind.constants],
    }


def _example(kind: MessageType, name: str) -> str:
    value = kind.default()[name]
    if isinstance(value, dict):
        return "{}"
    return json.dumps(list(value) if isinstance(value, list | bytes) else value)


# -- the station's events as ROS has them: the topic ``/rosout`` -----------------------------------

LEVELS = {"info": 2, "warning": 4, "error": 8}
"""Level of an event, and its number in rosgraph_msgs/Log."""


def add_rosout(agents: Mapping[str, AgentClient], graph: Graph) -> None:
    topic = graph.add_topic("/rosout", "rosgraph_msgs/Log")

    def tell(agent: AgentClient, node: str, event: Event) -> None:
        message = topic.type.default() | {
            "header": {"seq": event.number & 0xFFFFFFFF, "stamp": present(), "frame_id": ""},
            "level": LEVELS.get(event.level, 2),
            "name": node,
            "msg": event.text,
        }
        graph.publish(topic, message, agent.now)

    for name, agent in agents.items():
        node = f"{NODE}/{name}" if len(agents) > 1 else NODE
        agent.on_event.append(partial(tell, agent, node))
