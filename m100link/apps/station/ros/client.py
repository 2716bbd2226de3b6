"""rosbridge v2 with one client, without a transport and without a clock.

Frames go in by :meth:`Client.receive` with the present time, frames come out of
:meth:`Outbox.next_frame`; :meth:`Outbox.next_wakeup` says when to look again. Everything a client
can make grow has a limit, and a client that is slow, noisy or malicious costs itself messages, not
others.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from m100link.apps.agent.background import TokenBucket
from m100link.apps.station.ros.graph import (
    MAY_END,
    Graph,
    Publication,
    RosTopic,
    ServiceCall,
    canonical_name,
)
from m100link.apps.station.ros.messages import (
    BadMessage,
    Reassembly,
    canonical_type,
    fragments,
    to_cbor,
    to_png,
)
from m100link.apps.station.web.limits import FRAME_SIZE
from m100link.errors.texts import read_json

_Packing = tuple[int | None, str]

_SMALLEST_FRAGMENT = 100  # characters of a fragment; who wants smaller ones gets these
_SHORT = 1024  # characters of a frame that is looked at beyond every limit: it may be a STOP
_COMPLAINT_PAUSE = 1.0  # seconds between two statuses that tell a client that it does too much

_LEVELS = ("none", "error", "warning", "info")


@dataclass(frozen=True, slots=True)
class ClientLimits:
    message_size: int = FRAME_SIZE
    bytes_rate: float = 128 * 1024  # bytes per second over time; four messages of full size at once
    # Seconds of processor time per second over time, for what it sends and gets.
    work_rate: float = 0.1
    work_burst: float = 0.2  # the same at once
    rate: float = 200.0  # frames per second over time
    burst: float = 400.0  # frames at once
    subscriptions: int = 100  # subscriptions in force
    calls: int = 16  # service calls without an answer yet, but for those that end something
    # Messages that wait for a slow client; beyond it the oldest of the busiest topic are dropped.
    waiting: int = 500
    answers: int = 500  # answers and statuses that wait; beyond it the client is disconnected
    queue_length: int = 100  # longest queue of a throttled subscription
    # Frames beyond a limit or without meaning until the client is disconnected; each is forgotten
    # after a while.
    faults: int = 1000


class _Overdone(Exception):
    """The client uses more than it may, in words for it."""


class _Fault(Exception):
    """Something the client did wrong, in words for it."""


class Client:
    def __init__(
        self,
        graph: Graph,  # topics and services
        name: str = "client",  # who it is, for people
        *,
        limits: ClientLimits | None = None,  # what it may use
        on_output: Callable[[], None] = lambda: None,  # called when there may be something to send
        # Called when the client has to be disconnected.
        on_disconnect: Callable[[], None] = lambda: None,
    ) -> None:
        self.graph = graph
        self.name = name
        self.limits = limits or ClientLimits()
        self._on_output = on_output
        self._on_disconnect = on_disconnect
        self.refused = 0  # frames not carried out
        self.close_reason: str | None = None  # set when the client has to be disconnected
        self.recent_work = 0.0  # seconds of work that it caused; the reader sets it back to 0
        # Whether it holds control of an aircraft, as the station knows.
        self.is_steering: Callable[[], bool] = lambda: False
        self.peer = ""  # address that it comes from
        self.heard_at = float("-inf")  # when it last said anything; when it came, if it never did
        self.has_spoken = False  # whether it ever said anything
        self.data: dict[str, Any] = {}  # for the node: what it knows about this client
        self.outbox = Outbox(self.limits.waiting, on_output)  # what waits for it
        self._reassembly = Reassembly(self.limits.message_size)
        self._level = _LEVELS.index("error")
        self._calls = 0  # without an answer, but for those that end something
        self._frames = TokenBucket(self.limits.rate, self.limits.burst)
        self._bytes = TokenBucket(self.limits.bytes_rate, 4 * self.limits.message_size)
        self._work = TokenBucket(self.limits.work_rate, self.limits.work_burst)
        self._faults = TokenBucket(self.limits.faults / 1000.0, self.limits.faults)
        # When it last heard that it does too much.
        self._complained_at = float("-inf")
        self._operations: dict[str, Callable[[dict[str, Any], float], None]] = {
            "advertise": self._advertise,
            "unadvertise": self._unadvertise,
            "publish": self._publish,
            "subscribe": self._subscribe,
            "unsubscribe": self._unsubscribe,
            "call_service": self._call_service,
            "fragment": self._fragment,
            "set_level": self._set_level,
            "status": lambda *_: None,  # what a client tells about itself changes nothing
        }
        graph.sessions.add(self)

    def close(self, now: float) -> None:
        self.outbox.clear()
        self.graph.leave(self, now)

    # -- what comes in ---------------------------------------------------------------------------

    def receive(self, frame: str | bytes, now: float) -> None:
        """Take a frame of the client. Never raises: the client hears what is wrong with it."""
        identity = None
        self.heard_at, self.has_spoken = now, True
        try:
            self._admit(frame, now)
            message = self._parse(frame)
            given = message.get("id")
            identity = given if isinstance(given, int) else str(given)[:256] if given else None
            self._execute(message, now)
        except _Overdone as fault:
            if self.is_steering():  # cut off, it would hover: the newest of its setpoints fly
                self.refused += 1
            else:
                self._count_fault(now)
            if now - self._complained_at >= _COMPLAINT_PAUSE:
                self._complained_at = now
                self.status("error", f"{fault}: frame dropped")
        except (_Fault, BadMessage) as fault:
            self._count_fault(now)
            self.status("error", str(fault), identity)

    def _count_fault(self, now: float) -> None:
        self.refused += 1
        if not self._faults.take(now):
            self.disconnect("too many frames that could not be carried out")

    def _admit(self, frame: str | bytes, now: float) -> None:
        """Refuse a frame before anything in it is looked at, unless it is a short one that ends.

        Raises ``_Overdone``: the client uses more than it may.
        """
        limits, why = self.limits, ""
        if not self._frames.take(now):
            why = f"more than {limits.rate:g} frames per second"
        elif not self._bytes.take(now, len(frame)):
            why = f"more than {limits.bytes_rate:g} bytes per second"
        elif self._work.wait(now) > 0.0:
            why = "more work per second than one client may cause"
        if why and not self._ends(frame):
            raise _Overdone(why)

    def _ends(self, frame: str | bytes) -> bool:
        """Whether it ends a movement or gives control back; the intake bounds what this costs."""
        text = frame if isinstance(frame, str) else frame.decode(errors="replace")
        if len(frame) > _SHORT or not MAY_END.search(text):
            return False
        try:
            message = self._parse(frame)
            if message.get("op") == "publish":
                topic = self._topic({"topic": message.get("topic")})
                return topic.ends(topic.type.read(message.get("msg", {})))
            name = str(message.get("service", "")).partition("#")[0]
            service = self.graph.services.get(canonical_name(name))
            request = message.get("args")
            return service is not None and service.ends(service.type.read_request(request))
        except (_Fault, BadMessage):
            return False

    def charge(self, seconds: float, now: float) -> None:
        """The client has made the station work for so long."""
        self._work.spend(now, seconds)
        self.recent_work += seconds

    def work_pause(self, now: float) -> float:
        """Seconds until more may be done for this client."""
        return self._work.wait(now)

    def _parse(self, frame: str | bytes) -> dict[str, Any]:
        if len(frame) > self.limits.message_size:
            raise _Fault(f"a frame has at most {self.limits.message_size} bytes")
        try:
            message = read_json(frame, constant=_refuse_constant)
        except ValueError as error:
            raise _Fault(f"this is not JSON: {str(error)[:200]}") from None
        if not isinstance(message, dict):
            raise _Fault("a frame is a JSON object")
        return message

    def _execute(self, message: dict[str, Any], now: float) -> None:
        operation = message.get("op")
        handler = self._operations.get(operation) if isinstance(operation, str) else None
        if handler is None:
            raise _Fault(f"there is no operation {str(operation)[:64]!r} here")
        handler(message, now)

    def _topic(self, message: dict[str, Any]) -> RosTopic:
        name = _text(message, "topic")
        known = self.graph.topic(name)
        if known is None:
            raise _Fault(
                f"there is no topic {name[:128]!r} here; /rosapi/topics lists those there are"
            )
        if message.get("type") is None:
            return known
        given = canonical_type(_text(message, "type"))
        topic = self.graph.topic(name, given)
        if topic is None:
            raise _Fault(f"{known.name} is of type {known.type.name}, not {given[:128]}")
        return topic

    def _advertise(self, message: dict[str, Any], now: float) -> None:
        _text(message, "type")
        topic = self._topic(message)
        if topic.on_publish is None:
            raise _Fault(f"{topic.name} is published by the station alone")

    def _unadvertise(self, message: dict[str, Any], now: float) -> None:
        _text(message, "topic")  # nothing is kept of an advertisement

    def _publish(self, message: dict[str, Any], now: float) -> None:
        topic = self._topic({"topic": message.get("topic")})
        if topic.on_publish is None:
            raise _Fault(f"{topic.name} is published by the station alone")
        value = topic.type.read(message.get("msg", {}))
        topic.on_publish(self, value, now)
        self.graph.publish(topic, value, now)

    def _subscribe(self, message: dict[str, Any], now: float) -> None:
        topic = self._topic(message)
        name = message["topic"]
        options = self._options_of(message)
        count = sum(len(one.requested) for one in self.outbox.subscriptions.values())
        if count >= self.limits.subscriptions:
            raise _Fault(f"at most {self.limits.subscriptions} subscriptions are possible")
        subscription = self.outbox.subscription(topic, name)
        if subscription.topic is not topic:
            had = subscription.topic.type.name
            raise _Fault(f"{name[:128]!r} is subscribed as {had} already, not {topic.type.name}")
        topic.subscribers.add(self)
        subscription.requested[str(message.get("id"))] = options
        subscription.merge()

    def _options_of(self, message: dict[str, Any]) -> SubscribeOptions:
        size, compression = self._packing(message)
        return SubscribeOptions(
            max(0, _number(message, "throttle_rate", -86_400_000, 86_400_000)) / 1000.0,
            min(_number(message, "queue_length", 0, 1_000_000), self.limits.queue_length),
            size,
            compression,
        )

    def _unsubscribe(self, message: dict[str, Any], now: float) -> None:
        name = _text(message, "topic")
        subscription = self.outbox.subscriptions.get(name)
        if subscription is None:
            self._count_fault(now)
            self.status("warning", f"{name[:128]!r} was not subscribed", message.get("id"))
            return
        if "id" in message:
            subscription.requested.pop(str(message["id"]), None)
        else:
            subscription.requested.clear()
        if subscription.requested:
            subscription.merge()
        elif self.outbox.unsubscribe(name):
            subscription.topic.subscribers.discard(self)

    def _call_service(self, message: dict[str, Any], now: float) -> None:
        name = _text(message, "service")
        wanted, _, tail = name.partition("#")  # as clients once wrote the id
        identity = message.get("id") or tail or None
        packing: _Packing = (None, "none")
        service = self.graph.services.get(canonical_name(wanted))
        try:
            if service is None:
                raise _Fault(f"there is no service {name[:128]!r}; /rosapi/services lists them")
            packing = self._packing(message)
            request = service.type.read_request(message.get("args"))
            counts = not service.ends(request)
            if counts and self._calls >= self.limits.calls:
                raise _Fault(f"{self._calls} calls wait for their answers already")
        except (_Fault, BadMessage) as fault:
            # The answer says why: a status would say it twice.
            self._count_fault(now)
            self._respond(name, identity, packing, json.dumps(str(fault)), False)
            return
        self._calls += counts
        call = ServiceCall(self, service, request, (name, identity, packing), now)
        service.on_call(call)

    def _packing(self, message: dict[str, Any]) -> _Packing:
        """Size of fragments, None for whole messages, and compression."""
        compression = message.get("compression") or "none"
        if not isinstance(compression, str):
            raise _Fault("compression is not a string")
        if compression not in COMPRESSIONS:
            wanted = f"there is no compression {compression[:64]!r} here"
            self.status("warning", f"{wanted}, but {', '.join(COMPRESSIONS)}: sent without any")
            compression = "none"
        if message.get("fragment_size") is None:
            return None, compression
        size = _number(message, "fragment_size", 0, 1 << 31)
        return max(size, _SMALLEST_FRAGMENT), compression

    def _fragment(self, message: dict[str, Any], now: float) -> None:
        try:
            text = self._reassembly.add(message, now)
        except ValueError as error:
            raise _Fault(str(error)) from None
        if text is not None:
            whole = self._parse(text)
            if whole.get("op") == "fragment":
                raise _Fault("a fragment of fragments")
            self._execute(whole, now)

    def _set_level(self, message: dict[str, Any], now: float) -> None:
        level = message.get("level")
        if level not in _LEVELS:
            raise _Fault(f"there is no level {str(level)[:64]!r}, but {', '.join(_LEVELS)}")
        self._level = _LEVELS.index(level)

    # -- what goes out ---------------------------------------------------------------------------

    def status(self, level: str, text: str, identity: object = None) -> None:
        """Tell the client something, if it wants to hear of this level."""
        if _LEVELS.index(level) <= self._level:
            message: dict[str, object] = {"op": "status", "level": level, "msg": text}
            if identity is not None:
                message["id"] = identity
            self._answer(json.dumps(message))

    def respond(self, call: ServiceCall, values: str, result: bool) -> None:
        self._calls -= not call.ends
        name, identity, packing = call.identity
        self._respond(name, identity, packing, values, result)

    def _respond(
        self, name: str, identity: object, packing: _Packing, values: str, result: bool
    ) -> None:
        size, compression = packing
        begin: dict[str, object] = {"op": "service_response", "service": name, "result": result}
        if identity is not None:
            begin["id"] = identity
        text = f'{json.dumps(begin)[:-1]}, "values": {values}}}'
        if compression in ("cbor", "cbor-raw"):
            self._answer(to_cbor(read_json(text)))
            return
        if compression == "png":
            text = to_png(text)
        if size is None:
            self._answer(text)
            return
        for frame in self.outbox.fragmented(text, size):
            self._answer(frame)

    def deliver(self, publication: Publication, now: float) -> None:
        """A message was published on a topic that this client subscribed."""
        self.outbox.deliver(publication, now)

    def _answer(self, frame: str | bytes) -> None:
        self.outbox.answers.append(frame)
        if len(self.outbox.answers) > self.limits.answers:
            self.disconnect("the client does not read")
        self._on_output()

    def disconnect(self, reason: str) -> None:
        """Let go of this client; the holder of its socket closes that."""
        if self.close_reason is None:
            self.close_reason = reason
            self._on_disconnect()
            self._on_output()

    @property
    def subscribes(self) -> bool:
        return bool(self.outbox.subscriptions)


def _refuse_constant(text: str) -> float:
    raise ValueError(f"{text} is not JSON; null stands for no number")


def _text(message: dict[str, Any], name: str) -> str:
    value = message.get(name)
    if not isinstance(value, str) or not value:
        raise _Fault(f"{name} is missing, or no string")
    return value


def _number(message: dict[str, Any], name: str, low: int, high: int) -> int:
    value = message.get(name)
    if value is None:
        return 0
    if not isinstance(value, int | float) or isinstance(value, bool) or not low <= value <= high:
        raise _Fault(f"{name} is a number from {low} to {high}")
    return int(value)


# -- what waits for one client ---------------------------------------------------------------------

COMPRESSIONS = ("none", "png", "cbor", "cbor-raw")
"""How a message may be packed; a later one is preferred when subscriptions merge."""


@dataclass(frozen=True, slots=True)
class SubscribeOptions:
    throttle: float = 0.0  # seconds between two messages, at least
    queue_length: int = 0  # messages that are kept while the throttle holds them back
    fragment_size: int | None = None  # characters of a fragment, None for whole messages
    compression: str = "none"  # one of :data:`COMPRESSIONS`


class TopicSubscription:
    """All subscriptions of one client to one topic under one spelling, merged."""

    __slots__ = ("dropped", "held", "name", "next_at", "options", "pending", "requested", "topic")

    def __init__(self, topic: RosTopic, name: str) -> None:
        self.topic = topic
        self.name = name  # its name as the client spelled it
        self.requested: dict[
            str, SubscribeOptions
        ] = {}  # what was asked for, by the client's id for it
        # The most generous of them: every message that any of them asked for.
        self.options = SubscribeOptions()
        self.pending = 0  # messages in the outbox that were not dropped
        # Messages that stand in the outbox and have to be passed over, the oldest first.
        self.dropped = 0
        self.held: deque[Publication] = deque()  # messages that the throttle holds back
        self.next_at = float("-inf")  # when the throttle lets the next one through

    def merge(self) -> None:
        requested = self.requested.values()
        sizes = [one.fragment_size for one in requested if one.fragment_size is not None]
        self.options = SubscribeOptions(
            min(one.throttle for one in requested),
            max(one.queue_length for one in requested),
            min(sizes, default=None),
            max((one.compression for one in requested), key=COMPRESSIONS.index),
        )

    def advance(self, now: float) -> None:
        """A message goes out now: the next one an interval later.

        A late message does not shift those after it; a microsecond makes up for rounding.
        """
        throttle = self.options.throttle
        due = self.next_at if now - self.next_at < throttle else now
        self.next_at = due + throttle - 1e-6


class Outbox:
    """Messages and answers on their way to one client.

    When more messages wait than may, the oldest of the topic with the most is dropped: a rare
    message is not pushed out by a fast topic. Dropping costs no more than sending: it counts, and
    what was dropped is passed over when its turn comes.
    """

    def __init__(self, waiting: int, on_output: Callable[[], None]) -> None:
        self.subscriptions: dict[str, TopicSubscription] = {}  # by name, as the client spelled it
        # Answers and statuses: they go first, and none is dropped.
        self.answers: deque[str | bytes] = deque()
        self.dropped = 0  # messages dropped because the client was slow
        self._limit = waiting
        self._on_output = on_output
        self._by_topic: dict[RosTopic, list[TopicSubscription]] = {}
        self._queue: deque[tuple[TopicSubscription, Publication]] = deque()
        # Messages in the queue that were not dropped.
        self._count = 0
        # Subscriptions by how many of their messages wait, and how many the busiest has: so that
        # dropping costs the same however many topics there are.
        self._crowds: list[dict[TopicSubscription, None]] = [{}]
        self._most = 0
        # The rest of a message that is sent in pieces.
        self._ready: Iterator[str | bytes] = iter(())
        self._fragment_count = 0

    def subscription(self, topic: RosTopic, name: str) -> TopicSubscription:
        """The subscription under this spelling; a new one if there is none."""
        found = self.subscriptions.get(name)
        if found is None:
            found = self.subscriptions[name] = TopicSubscription(topic, name)
            self._by_topic.setdefault(topic, []).append(found)
        return found

    def unsubscribe(self, name: str) -> bool:
        """End a subscription; returns whether it was the last of its topic."""
        subscription = self.subscriptions.pop(name)
        rest = self._by_topic[subscription.topic]
        rest.remove(subscription)
        if not rest:
            del self._by_topic[subscription.topic]
        return not rest

    def clear(self) -> None:
        self.subscriptions.clear()
        self._by_topic.clear()
        self._queue.clear()
        self.answers.clear()
        self._count = self._most = 0
        self._crowds = [{}]

    def deliver(self, publication: Publication, now: float) -> None:
        """A message was published; those of its topic get it."""
        for subscription in self._by_topic.get(publication.topic, ()):
            self.offer(subscription, publication, now)

    def offer(self, subscription: TopicSubscription, publication: Publication, now: float) -> None:
        """A message for one subscription, as far as its throttle lets it through."""
        options = subscription.options
        if not options.throttle:
            self._put(subscription, publication)
        elif now >= subscription.next_at and not subscription.held:
            subscription.advance(now)
            self._put(subscription, publication)
        elif options.queue_length:
            subscription.held.append(publication)
            while len(subscription.held) > options.queue_length:
                subscription.held.popleft()
            self._on_output()

    def _put(self, subscription: TopicSubscription, publication: Publication) -> None:
        self._queue.append((subscription, publication))
        crowds, pending = self._crowds, subscription.pending + 1
        if pending > 1:
            del crowds[pending - 1][subscription]
        if pending > self._most:
            self._most = pending
            if pending == len(crowds):
                crowds.append({})
        crowds[pending][subscription] = None
        subscription.pending = pending
        self._count += 1
        if self._count > self._limit:
            self._drop_one()
        self._on_output()

    def _take(self, subscription: TopicSubscription) -> None:
        crowds, pending = self._crowds, subscription.pending
        del crowds[pending][subscription]
        if pending > 1:
            crowds[pending - 1][subscription] = None
        if pending == self._most and not crowds[pending]:
            self._most = pending - 1
        subscription.pending = pending - 1
        self._count -= 1

    def _drop_one(self) -> None:
        busiest = next(iter(self._crowds[self._most]))
        self._take(busiest)
        busiest.dropped += 1
        self.dropped += 1
        if len(self._queue) > 2 * self._limit:
            self._sweep()

    def _sweep(self) -> None:
        """Take out what was dropped: as many as were dropped since the last time."""
        kept: deque[tuple[TopicSubscription, Publication]] = deque()
        for subscription, publication in self._queue:
            if subscription.dropped:
                subscription.dropped -= 1
            else:
                kept.append((subscription, publication))
        self._queue = kept

    def advance(self, now: float) -> None:
        """Let time pass: release what throttled subscriptions held back."""
        for subscription in self.subscriptions.values():
            while subscription.held and now >= subscription.next_at:
                subscription.advance(now)
                self._put(subscription, subscription.held.popleft())

    def next_wakeup(self) -> float | None:
        """When :meth:`advance` has something to do."""
        times = [one.next_at for one in self.subscriptions.values() if one.held]
        return min(times, default=None)

    def next_frame(self) -> str | bytes | None:
        """The next frame to send; packed now, so that what is dropped was never packed."""
        frame = next(self._ready, None)
        if frame is not None:
            return frame
        if self.answers:
            return self.answers.popleft()
        while self._queue:
            subscription, publication = self._queue.popleft()
            if subscription.dropped:
                subscription.dropped -= 1
                continue
            self._take(subscription)
            return self._pack(subscription, publication)
        return None

    def _pack(self, subscription: TopicSubscription, publication: Publication) -> str | bytes:
        options = subscription.options
        frame = publication.pack(subscription.name, options.compression)
        if isinstance(frame, bytes) or options.fragment_size is None:
            return frame
        self._ready = self.fragmented(frame, options.fragment_size)
        return next(self._ready)

    def fragmented(self, text: str, size: int) -> Iterator[str | bytes]:
        """The frames of a text in pieces."""
        self._fragment_count += 1
        return fragments(text, size, str(self._fragment_count))
