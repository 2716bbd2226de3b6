"""The ends of a node: what it publishes, hears and serves, each with its token.

Payloads are read and written here, so that what is behind has mappings. A payload that cannot
be read is counted, and nothing else happens.
"""

from __future__ import annotations

import math
import re
from collections.abc import Awaitable, Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from m100link.apps.agent.background import TaskSet
from m100link.apps.agent.orders import AfterStop, Order
from m100link.apps.bus.network import Held, Inbox, Outlet, PolledBus, Question, Received
from m100link.apps.ros2 import graph
from m100link.errors import M100Error
from m100link.log.cdr import DEFINITIONS, SERVICES, decode, describe, encode, full_name, type_hash

_DEPTH = 8  # messages of a topic, and requests to a service, that wait for a step

_NEWEST = graph.Qos(is_reliable=False, depth=_DEPTH)
"""Of what is heard: DDS then takes it of every publisher, and repeats no lost setpoint late."""

_AT_ONCE = 8
"""Requests to one service that are carried out at once, but for those that end something."""

Call = Callable[[dict[str, Any]], Awaitable[Mapping[str, Any]]]
"""Answers a request; one of which it raises an M100Error has no answer."""


class PublishedTopic:
    """A topic that is published. ``utc``: POSIX time, s."""

    __slots__ = ("_gid", "_kind", "_outlet", "_sequence", "_utc", "is_wanted")

    def __init__(self, outlet: Outlet, kind: str, token: str, utc: Callable[[], float]) -> None:
        self._outlet, self._kind, self._utc = outlet, kind, utc
        self._gid = graph.gid_of(token)
        self._sequence = 0
        self.is_wanted = outlet.is_wanted()  # whether anybody listens, as of the last look

    def put(self, payload: bytes) -> None:
        """Send a message that is CDR already."""
        self._sequence += 1
        at_ns = round(self._utc() * 1e9)
        self._outlet.put(payload, graph.write_attachment(self._sequence, at_ns, self._gid))

    def say(self, message: Mapping[str, Any]) -> None:
        self.put(encode(self._kind, message))

    def look(self) -> None:
        self.is_wanted = self._outlet.is_wanted()


class Input:
    def __init__(self, inbox: Inbox[Received], kind: str, refuse: Callable[[str], None]) -> None:
        self._inbox, self._kind, self._refuse = inbox, kind, refuse

    def take(self) -> Iterator[tuple[graph.Attachment, dict[str, Any]]]:
        """The samples since the last call, oldest first."""
        for one in self._inbox.take():
            try:
                found = graph.read_attachment(one.attachment), decode(self._kind, one.payload)
            except ValueError:
                self._refuse("a message that cannot be read")
                continue
            yield found


@dataclass(slots=True)
class _Service:
    topic: str
    kind: str
    key: str  # where it is asked
    requests: Inbox[Question]  # what was asked
    call: Call
    at_once: int  # how many requests are carried out at once
    ends: type[Order] | None  # the order by which it ends something
    calls: int = 0  # how many are


class Endpoints:
    """All ends of a node. ``utc``: POSIX time, s."""

    def __init__(
        self, bus: PolledBus, name: graph.NodeName, background: TaskSet, utc: Callable[[], float]
    ) -> None:
        self._bus, self._name, self._background, self._utc = bus, name, background, utc
        self._count = name.number * 1000  # an end has a number of its own in the session
        self.topics: dict[str, PublishedTopic] = {}  # what is published, by full name
        self._services: list[_Service] = []
        self.refused = 0  # messages and requests that could not be read, or were too many
        self.refusal = ""  # which topic or service the newest of them was for, and why
        # Tokens end when nobody holds them.
        self._tokens: list[Held] = [bus.declare(name.token)]

    def _show(self, end: graph.EntityKind, topic: str, kind: str, qos: graph.Qos) -> str:
        self._count += 1
        token = self._name.token_of(self._count, end, topic, kind, qos)
        self._tokens.append(self._bus.declare(token))
        return token

    def publish(self, topic: str, kind: str, qos: graph.Qos) -> PublishedTopic:
        token = self._show(graph.EntityKind.PUBLISHER, topic, kind, qos)
        kept = qos.depth if qos.is_latched else 0
        outlet = self._bus.publish(graph.data_key(self._name.domain, topic, kind), kept=kept)
        made = self.topics[topic] = PublishedTopic(outlet, kind, token, self._utc)
        return made

    def subscribe(self, topic: str, kind: str) -> Input:
        self._show(graph.EntityKind.SUBSCRIBER, topic, kind, _NEWEST)
        inbox = self._bus.inbox(graph.data_key(self._name.domain, topic, kind), _DEPTH)
        return Input(inbox, kind, partial(self._refuse, topic))

    def serve(
        self,
        topic: str,
        kind: str,
        call: Call,
        *,
        at_once: int = _AT_ONCE,
        ends: type[Order] | None = None,
    ) -> None:
        """Offer a service; requests beyond so many at once are not answered, unless it ends."""
        key = graph.data_key(self._name.domain, topic, kind)
        self._show(graph.EntityKind.SERVER, topic, kind, graph.Qos())
        requests = self._bus.questions(key, _DEPTH)
        self._services.append(_Service(topic, kind, key, requests, call, at_once, ends))

    def _refuse(self, topic: str, why: str) -> None:
        self.refused += 1
        self.refusal = f"{topic}: {why}"

    def look(self) -> None:
        for topic in self.topics.values():
            topic.look()

    def take_requests(self, *, is_deaf: bool) -> None:
        """Begin to answer what was asked since; to the deaf what comes now is old.

        It is done all the same where that is done behind any STOP, too.
        """
        for service in self._services:
            for request in service.requests.take():
                self._take(service, request, is_deaf)

    def _take(self, service: _Service, request: Question, is_deaf: bool) -> None:
        ends = service.ends
        try:
            if request.key != service.key:
                raise ValueError("a wildcard would take off, land and disarm at once")
            attachment = graph.read_attachment(request.attachment)
            message = decode(f"{service.kind}_Request", request.payload)
            is_late = is_deaf and (ends is None or ends.after_stop is not AfterStop.DONE)
            if is_late or (ends is None and service.calls >= service.at_once):
                raise ValueError("too late, or too many")
        except ValueError as error:
            self._refuse(service.topic, f"a request without an answer: {error}")
            request.drop()
            return
        service.calls += 1
        work = self._answer(service, message, attachment, request)
        self._background.spawn(work, f"ROS {service.topic}")

    async def _answer(
        self,
        service: _Service,
        message: dict[str, Any],
        attachment: graph.Attachment,
        request: Question,
    ) -> None:
        try:
            answer = encode(f"{service.kind}_Response", await service.call(message))
        except M100Error as error:
            self._refuse(service.topic, f"a request without an answer: {error.seen}")
            request.drop()
            return
        except BaseException:
            request.drop()
            raise
        finally:
            service.calls -= 1
        at_ns = round(self._utc() * 1e9)
        ours = graph.write_attachment(attachment.sequence, at_ns, attachment.gid)
        request.answer(request.key, answer, ours)


# -- services that do something: done, or why not, with cause and remedy ---------------------------


def answering(doing: Callable[[Mapping[str, Any]], Awaitable[None]], done: str) -> Call:
    """A service that answers ``success`` and ``message``; an error of the doing is the refusal."""

    async def call(request: dict[str, Any]) -> Mapping[str, Any]:
        try:
            await doing(request)
        except M100Error as error:
            return {"success": False, "message": str(error)}
        return {"success": True, "message": done}

    return call


def trigger(doing: Callable[[], Awaitable[None]], done: str) -> Call:
    return answering(lambda _: doing(), done)


# -- what the types of the node are, for who asks: a service of each node of rclcpp ----------------


_KIND = "type_description_interfaces/srv/GetTypeDescription"
_NOTHING: Mapping[str, Any] = {
    "type_description": {
        "type_description": {"type_name": "", "fields": []},
        "referenced_type_descriptions": [],
    },
    "type_sources": [],
    "extra_information": [],
}
_NAMES = {full_name(one): one for one in DEFINITIONS}


def serve_descriptions(ends: Endpoints, names: graph.Names) -> None:
    ends.serve(names.full("~/get_type_description"), _KIND, _answer)


async def _answer(asked: dict[str, Any]) -> Mapping[str, Any]:
    name, known = asked["type_name"], _NAMES.get(asked["type_name"])
    if known is None:
        return _refused(f"this node has no type {name!r}")
    if asked["type_hash"] not in ("", type_hash(known)):
        return _refused(f"{name} has the hash {type_hash(known)} here")
    described = describe(known)
    types = [described["type_description"], *described["referenced_type_descriptions"]]
    for one in types:
        for each in one["fields"]:
            each["default_value"] = ""
    sources = [_source(one["type_name"]) for one in types] if asked["include_type_sources"] else []
    return {
        "successful": True,
        "failure_reason": "",
        "type_description": described,
        "type_sources": sources,
        "extra_information": [],
    }


def _source(name: str) -> Mapping[str, str]:
    """The text that a type is made of; parts of services and actions have none of their own."""
    known = _NAMES[name]
    if known in SERVICES:
        request, response = SERVICES[known]
        text, encoding = f"{request}\n---\n{response}\n", "srv"
    elif name.split("/")[1] == "msg":
        text, encoding = f"{DEFINITIONS[known]}\n", "msg"
    else:
        text, encoding = "", "implicit"
    return {"type_name": name, "encoding": encoding, "raw_file_contents": text}


def _refused(why: str) -> Mapping[str, Any]:
    return {"successful": False, "failure_reason": why, **_NOTHING}


# -- whether programs of others still run: a frozen one keeps its tokens for a lease ---------------
# That is 10 s by zenoh's default and 60 s by rmw_zenoh's. Both have an answer at their admin space
# though (rmw_zenoh's sessions by default), given by threads of zenoh's however busy the program is.
# A session that has answered and does so no more is gone; the lease decides for the others.


ASK_S = 0.5  # seconds between two questions
SILENCE_S = 1.5  # seconds without an answer after which a session that had answered counts as gone
_ANSWER_S = 2.0  # seconds for which an answer of a session is waited for
_WAITING = 3  # questions whose answers are still looked for, beside the newest
_SESSION = re.compile(r"[0-9a-f]{1,32}")
_MOST = 16  # sessions that are asked


@dataclass(slots=True)
class _Session:
    answered_at: float = math.inf  # when it answered last, s; infinite before it did
    asked: list[Inbox[bool]] = field(default_factory=list)  # where its answers come


class Heartbeat:
    """Asks those sessions that something depends on."""

    def __init__(self, bus: PolledBus) -> None:
        self._bus = bus
        self.follow(())

    def follow(self, sessions: Collection[str]) -> None:
        """Ask these from now on, and no others. Ids that are of no session are left out."""
        known = [one for one in sorted(set(sessions)) if _SESSION.fullmatch(one)][:_MOST]
        self._sessions: dict[str, _Session] = {one: _Session() for one in known}
        self._asks_at = 0.0

    def is_missing(self, now: float) -> bool:
        """Whether any of them has answered and does so no more. To be called at each step.

        ``now``: s.
        """
        for one in self._sessions.values():
            for inbox in one.asked:
                if any(inbox.take()):
                    one.answered_at = now
        if now >= self._asks_at:
            self._asks_at = now + ASK_S
            for name, one in self._sessions.items():
                asked = self._bus.probe(f"@/{name}/*", timeout=_ANSWER_S)  # its admin space
                one.asked = [*one.asked[-_WAITING:], asked]
        return any(one.answered_at < now - SILENCE_S for one in self._sessions.values())
