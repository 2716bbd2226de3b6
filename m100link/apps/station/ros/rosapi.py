"""rosapi: what roslib, roslibpy and Foxglove ask about topics, services, nodes and types.

There is one node here, and no parameter server.
"""

from __future__ import annotations

import json
from collections.abc import Callable

from m100link.apps.station.ros.graph import Call, Graph, Topic, canonical_name
from m100link.apps.station.ros.messages import (
    MESSAGES,
    SERVICES,
    Message,
    MessageType,
    canonical_type,
    present,
)
from m100link.apps.station.ros.serial import definition, nested

__all__ = ["NODE", "add_rosapi"]

NODE = "/m100link"
"""The node that publishes and subscribes everything here."""


class _Failed(Exception):
    """A question without an answer, in words for the client."""


def add_rosapi(graph: Graph) -> None:
    """Offer the services of rosapi about everything in the graph."""
    api = _RosApi(graph)
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
        ("nodes", "Nodes", api.nodes),
        ("node_details", "NodeDetails", api.node_details),
        ("message_details", "MessageDetails", api.message_details),
        ("service_request_details", "ServiceRequestDetails", api.request_details),
        ("service_response_details", "ServiceResponseDetails", api.response_details),
        ("get_time", "GetTime", api.get_time),
        ("get_param", "GetParam", api.get_param),
        ("get_param_names", "GetParamNames", api.get_param_names),
        ("has_param", "HasParam", api.has_param),
        ("search_param", "SearchParam", api.search_param),
        ("set_param", "SetParam", api.no_param),
        ("delete_param", "DeleteParam", api.no_param),
    ):
        graph.add_service(f"/rosapi/{name}", f"rosapi/{kind}", _answering(answer))


def _answering(answer: Callable[[Message], Message]) -> Callable[[Call], None]:
    def on_call(call: Call) -> None:
        try:
            call.respond(answer(call.request))
        except _Failed as error:
            call.fail(str(error))

    return on_call


class _RosApi:
    def __init__(self, graph: Graph) -> None:
        self._graph = graph

    def _topics(self) -> list[Topic]:
        return [self._graph.topics[name] for name in sorted(self._graph.topics)]

    def topics(self, _: Message) -> Message:
        found = self._topics()
        return {"topics": [one.name for one in found], "types": [one.type.name for one in found]}

    def topic_type(self, request: Message) -> Message:
        topic = self._graph.topics.get(canonical_name(request["topic"]))
        return {"type": topic.type.name if topic else ""}

    def topics_for_type(self, request: Message) -> Message:
        wanted = canonical_type(request["type"])
        return {"topics": [one.name for one in self._topics() if one.type.name == wanted]}

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

    def action_servers(self, _: Message) -> Message:
        return {"action_servers": []}

    def nodes(self, _: Message) -> Message:
        return {"nodes": [NODE]}

    def node_details(self, request: Message) -> Message:
        if canonical_name(request["node"]) != NODE:
            return {}
        topics = self._topics()
        return {
            "subscribing": [one.name for one in topics if one.on_publish is not None],
            "publishing": [one.name for one in topics if one.on_publish is None],
            "services": sorted(self._graph.services),
        }

    def message_details(self, request: Message) -> Message:
        kind = MESSAGES.get(canonical_type(request["type"]))
        if kind is None:
            raise _Failed(f"there is no message type {request['type'][:128]!r} here")
        return {"typedefs": [_typedef(one) for one in (kind, *nested(kind))]}

    def request_details(self, request: Message) -> Message:
        return self._half(request, lambda name: SERVICES[name].request)

    def response_details(self, request: Message) -> Message:
        return self._half(request, lambda name: SERVICES[name].response)

    def _half(self, request: Message, half: Callable[[str], MessageType]) -> Message:
        name = canonical_type(request["type"])
        if name not in SERVICES:
            raise _Failed(f"there is no service type {request['type'][:128]!r} here")
        kind = half(name)
        return {"typedefs": [_typedef(one) for one in (kind, *nested(kind))]}

    def get_time(self, _: Message) -> Message:
        return {"time": present()}

    def get_param(self, request: Message) -> Message:
        return {"value": request["default"] or json.dumps(None)}

    def get_param_names(self, _: Message) -> Message:
        return {"names": []}

    def has_param(self, _: Message) -> Message:
        return {"exists": False}

    def search_param(self, _: Message) -> Message:
        return {"global_name": ""}

    def no_param(self, _: Message) -> Message:
        raise _Failed("there are no parameters here that could be changed")


def _typedef(kind: MessageType) -> Message:
    fields = kind.fields
    return {
        "type": kind.type_name,
        "fieldnames": [field.name for field in fields],
        "fieldtypes": [field.type for field in fields],
        # -1 is not an array, 0 one of any length.
        "fieldarraylen": [-1 if field.length is None else field.length for field in fields],
        "examples": [_example(kind, field.name) for field in fields],
        "constnames": [],
        "constvalues": [],
    }


def _example(kind: MessageType, name: str) -> str:
    value = kind.default()[name]
    if isinstance(value, dict):
        return "{}"
    return json.dumps(list(value) if isinstance(value, list | bytes) else value)
