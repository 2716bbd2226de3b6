"""Topics and services of the station, and who listens: what roscore is to ROS nodes.

The set of topics and services is fixed when the station starts. Clients can use it, not extend it:
nothing a client does makes it grow.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

from m100link.apps.station.ros.encoding import to_cbor, to_png
from m100link.apps.station.ros.messages import (
    MESSAGES,
    SERVICES,
    Message,
    MessageType,
    ServiceType,
    present,
)
from m100link.apps.station.ros.serial import serialise

__all__ = ["Call", "Graph", "Listener", "Publication", "Service", "Topic", "canonical_name"]


def canonical_name(name: str) -> str:
    """Names with and without a leading slash are the same topic."""
    return name if name.startswith("/") else f"/{name}"


class Publication:
    """A message on its way to any number of clients: packed once for all of them."""

    __slots__ = ("_json", "_packed", "message", "topic")

    def __init__(self, topic: Topic, message: Message) -> None:
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
        """The frame in one of these forms; packed once, whoever else wants it."""
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


class Listener(Protocol):
    """Who uses the topics and services, as they see it.

    Attributes:
        name: Who it is, for people.
        data: For the nodes: what they know about this listener.
    """

    name: str
    data: dict[str, Any]

    def deliver(self, publication: Publication, now: float) -> None:
        """A message was published on a topic that it subscribed."""

    def deliver_alone(self, publication: Publication, now: float) -> None:
        """The same for a message that is meant for this listener only."""

    def respond(self, call: Call, values: str, result: bool) -> None:
        """The answer to its call; ``values`` is JSON."""

    def status(self, level: str, text: str) -> None:
        """Something to be told, with the level ``error``, ``warning`` or ``info``."""


@dataclass(slots=True, eq=False)
class Topic:
    """A topic.

    Attributes:
        name: Its name, with a leading slash.
        type: Type of its messages.
        on_publish: What a client's message does; None on topics that only the station publishes.
        latched: Whether a new subscriber gets the last message at once.
        subscribers: Sessions that listen.
        last: Last message of a latched topic.
    """

    name: str
    type: MessageType
    on_publish: Callable[[Listener, Message, float], None] | None = None
    latched: bool = False
    subscribers: set[Listener] = field(default_factory=set)
    last: Message | None = None


@dataclass(slots=True, eq=False)
class Call:
    """A service call of a client, to be answered once.

    Attributes:
        session: Who called.
        request: The checked request.
        now: When it came.
    """

    session: Listener
    service: Service
    request: Message
    identity: Any
    now: float
    is_answered: bool = False

    def respond(self, response: Message) -> None:
        """Answer with the fields given; the others have their defaults."""
        if not self.is_answered:
            self.is_answered = True
            type_ = self.service.type.response
            self.session.respond(self, type_.to_json(type_.default() | response), True)

    def fail(self, reason: str) -> None:
        """Answer that the call failed."""
        if not self.is_answered:
            self.is_answered = True
            self.session.respond(self, json.dumps(reason), False)


@dataclass(slots=True, eq=False)
class Service:
    """A service.

    Attributes:
        name: Its name, with a leading slash.
        type: Its type.
        on_call: Answers a call, at once or later.
    """

    name: str
    type: ServiceType
    on_call: Callable[[Call], None]


class Graph:
    """The topics and services, and the sessions that use them.

    With several aircraft each has a namespace in it: :meth:`namespace`.

    Args:
        prefix: What stands before the name of each topic and service that is added here, such as
            ``/m100_2``.
        whole: The graph that this one is a namespace of.

    Attributes:
        topics: Topics by name, those of all namespaces.
        services: Services by name, those of all namespaces.
        sessions: Clients connected now.
        prefix: As given.
    """

    def __init__(self, prefix: str = "", whole: Graph | None = None) -> None:
        self.prefix = prefix
        self.topics: dict[str, Topic] = {} if whole is None else whole.topics
        self.services: dict[str, Service] = {} if whole is None else whole.services
        self.sessions: set[Listener] = set() if whole is None else whole.sessions
        self._on_leave: list[Callable[[Listener, float], None]] = (
            [] if whole is None else whole._on_leave
        )

    def namespace(self, name: str) -> Graph:
        """A part of this graph: whatever is added to it is called ``/name/…``."""
        return Graph(f"{self.prefix}/{name}", self)

    def known(self, session: Listener) -> dict[str, Any]:
        """What the nodes of this namespace know about a listener."""
        known: dict[str, Any] = session.data.setdefault(f"nodes of {self.prefix or '/'}", {})
        return known

    def add_topic(
        self,
        name: str,
        type_name: str,
        on_publish: Callable[[Listener, Message, float], None] | None = None,
        *,
        latched: bool = False,
    ) -> Topic:
        """A topic that the station publishes, or takes messages from."""
        name = self.prefix + name
        topic = Topic(name, MESSAGES[type_name], on_publish, latched)
        self.topics[name] = topic
        return topic

    def add_service(self, name: str, type_name: str, on_call: Callable[[Call], None]) -> None:
        """A service that the station offers."""
        name = self.prefix + name
        self.services[name] = Service(name, SERVICES[type_name], on_call)

    def on_leave(self, callback: Callable[[Listener, float], None]) -> None:
        """Call this when a client has gone."""
        self._on_leave.append(callback)

    def publish(self, topic: Topic, message: Message, now: float) -> None:
        """Give a message to every subscriber."""
        if topic.latched:
            topic.last = message
        if topic.subscribers:
            publication = Publication(topic, message)
            for session in topic.subscribers:
                session.deliver(publication, now)

    def leave(self, session: Listener, now: float) -> None:
        """A client has gone."""
        if session in self.sessions:
            self.sessions.discard(session)
            for topic in self.topics.values():
                topic.subscribers.discard(session)
            for callback in self._on_leave:
                callback(session, now)
