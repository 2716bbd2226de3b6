"""What waits for one client: subscriptions, throttles, and what is dropped when it is slow."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from m100link.apps.station.ros.encoding import fragments
from m100link.apps.station.ros.graph import Publication, Topic

__all__ = ["COMPRESSIONS", "Outbox", "Subscription", "Wish"]

COMPRESSIONS = ("none", "png", "cbor", "cbor-raw")
"""How a message may be packed; a later one is preferred when subscriptions merge."""


@dataclass(frozen=True, slots=True)
class Wish:
    """What one subscription asked for.

    Attributes:
        throttle: Seconds between two messages, at least.
        queue_length: Messages that are kept while the throttle holds them back.
        fragment_size: Characters of a fragment, None for whole messages.
        compression: One of :data:`COMPRESSIONS`.
    """

    throttle: float = 0.0
    queue_length: int = 0
    fragment_size: int | None = None
    compression: str = "none"


class Subscription:
    """All subscriptions of one client to one topic under one spelling, merged.

    Attributes:
        topic: The topic.
        name: Its name as the client spelled it.
        wishes: What was asked for, by the client's id for it.
        wish: The most generous of the wishes: every message that any of them asked for.
        pending: Messages in the outbox that were not dropped.
        dropped: Messages that stand in the outbox and have to be passed over, the oldest first.
        held: Messages that the throttle holds back.
        next_at: When the throttle lets the next one through.
    """

    __slots__ = ("dropped", "held", "name", "next_at", "pending", "topic", "wish", "wishes")

    def __init__(self, topic: Topic, name: str) -> None:
        self.topic = topic
        self.name = name
        self.wishes: dict[str, Wish] = {}
        self.wish = Wish()
        self.pending = 0
        self.dropped = 0
        self.held: deque[Publication] = deque()
        self.next_at = float("-inf")

    def merge(self) -> None:
        """The wishes have changed."""
        wishes = self.wishes.values()
        sizes = [one.fragment_size for one in wishes if one.fragment_size is not None]
        self.wish = Wish(
            min(one.throttle for one in wishes),
            max(one.queue_length for one in wishes),
            min(sizes, default=None),
            max((one.compression for one in wishes), key=COMPRESSIONS.index),
        )

    def advance(self, now: float) -> None:
        """A message goes out now: the next one an interval later.

        A late message does not shift those after it; a microsecond makes up for rounding.
        """
        throttle = self.wish.throttle
        due = self.next_at if now - self.next_at < throttle else now
        self.next_at = due + throttle - 1e-6


class Outbox:
    """Messages and answers on their way to one client.

    When more messages wait than may, the oldest of the topic with the most is dropped: a rare
    message is not pushed out by a fast topic. Dropping costs no more than sending: it counts, and
    what was dropped is passed over when its turn comes.

    Args:
        waiting: Messages that may wait.
        on_output: Called when there may be something to send.

    Attributes:
        subscriptions: By name, as the client spelled it.
        answers: Answers and statuses: they go first, and none is dropped.
        dropped: Messages dropped because the client was slow.
    """

    def __init__(self, waiting: int, on_output: Callable[[], None]) -> None:
        self.subscriptions: dict[str, Subscription] = {}
        self.answers: deque[str | bytes] = deque()
        self.dropped = 0
        self._limit = waiting
        self._on_output = on_output
        self._by_topic: dict[str, list[Subscription]] = {}
        self._queue: deque[tuple[Subscription, Publication]] = deque()
        # Messages in the queue that were not dropped.
        self._count = 0
        # Subscriptions by how many of their messages wait, and how many the busiest has: so that
        # dropping costs the same however many topics there are.
        self._crowds: list[dict[Subscription, None]] = [{}]
        self._most = 0
        # What is left of a message that is sent in pieces.
        self._ready: Iterator[str | bytes] = iter(())
        self._fragment_count = 0

    def subscription(self, topic: Topic, name: str) -> Subscription:
        """The subscription under this spelling; a new one if there is none."""
        found = self.subscriptions.get(name)
        if found is None:
            found = self.subscriptions[name] = Subscription(topic, name)
            self._by_topic.setdefault(topic.name, []).append(found)
        return found

    def unsubscribe(self, name: str) -> bool:
        """End a subscription; returns whether it was the last of its topic."""
        subscription = self.subscriptions.pop(name)
        rest = self._by_topic[subscription.topic.name]
        rest.remove(subscription)
        if not rest:
            del self._by_topic[subscription.topic.name]
        return not rest

    def clear(self) -> None:
        """The client has gone."""
        self.subscriptions.clear()
        self._by_topic.clear()
        self._queue.clear()
        self.answers.clear()
        self._count = self._most = 0
        self._crowds = [{}]

    def deliver(self, publication: Publication, now: float) -> None:
        """A message was published; those of its topic get it."""
        for subscription in self._by_topic.get(publication.topic.name, ()):
            self.offer(subscription, publication, now)

    def offer(self, subscription: Subscription, publication: Publication, now: float) -> None:
        """A message for one subscription, as far as its throttle lets it through."""
        wish = subscription.wish
        if not wish.throttle:
            self._put(subscription, publication)
        elif now >= subscription.next_at and not subscription.held:
            subscription.advance(now)
            self._put(subscription, publication)
        elif wish.queue_length:
            subscription.held.append(publication)
            while len(subscription.held) > wish.queue_length:
                subscription.held.popleft()
            self._on_output()

    def _put(self, subscription: Subscription, publication: Publication) -> None:
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

    def _take(self, subscription: Subscription) -> None:
        """One message of it less."""
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
        kept: deque[tuple[Subscription, Publication]] = deque()
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

    def _pack(self, subscription: Subscription, publication: Publication) -> str | bytes:
        wish = subscription.wish
        frame = publication.pack(subscription.name, wish.compression)
        if isinstance(frame, bytes) or wish.fragment_size is None:
            return frame
        self._ready = self.fragmented(frame, wish.fragment_size)
        return next(self._ready)

    def fragmented(self, text: str, size: int) -> Iterator[str | bytes]:
        """The frames of a text in pieces."""
        self._fragment_count += 1
        return fragments(text, size, str(self._fragment_count))
