"""What waits for a slow client, and what it costs to drop it."""

from __future__ import annotations

import gc
import json
import sys
import weakref
from types import FrameType

from m100link.station.ros.graph import Graph, Publication, Topic
from m100link.station.ros.outbox import Outbox, Wish


class Bench:
    def __init__(self, waiting: int, topics: int = 3) -> None:
        graph = Graph()
        self.topics = [graph.add_topic(f"/{n}", "std_msgs/Float32") for n in range(topics)]
        self.outbox = Outbox(waiting, lambda: None)
        for topic in self.topics:
            subscription = self.outbox.subscription(topic, topic.name)
            subscription.wishes["1"] = Wish()
            subscription.merge()

    def put(self, topic: Topic, value: float) -> None:
        self.outbox.deliver(Publication(topic, {"data": value}), 0.0)

    def take(self) -> list[tuple[str, float]]:
        frames = []
        while (frame := self.outbox.next_frame()) is not None:
            message = json.loads(frame)
            frames.append((message["topic"], message["msg"]["data"]))
        return frames


def test_the_oldest_of_the_busiest_topic_is_dropped_and_the_order_kept() -> None:
    bench = Bench(waiting=6)
    rare, fast, other = bench.topics
    bench.put(rare, 1)
    for value in range(100):
        bench.put(fast, value)
        if not value % 50:
            bench.put(other, value)
    assert bench.take() == [
        ("/0", 1),
        ("/2", 0),
        ("/2", 50),
        *(("/1", 97), ("/1", 98), ("/1", 99)),
    ]
    assert bench.outbox.dropped == 97
    bench.put(rare, 2)
    assert bench.take() == [("/0", 2)]


class WatchedPublication(Publication):
    """One that tells whether anybody still has it."""

    __slots__ = ("__weakref__",)


def test_what_was_dropped_is_not_kept() -> None:
    bench = Bench(waiting=10)
    kept: list[weakref.ref[WatchedPublication]] = []
    for value in range(10_000):
        publication = WatchedPublication(bench.topics[value % 3], {"data": value})
        kept.append(weakref.ref(publication))
        bench.outbox.deliver(publication, 0.0)
    del publication
    gc.collect()
    # Those that wait, and no more dropped ones that are still in line between them.
    assert 10 <= sum(reference() is not None for reference in kept) <= 20
    assert [value for _, value in bench.take()] == list(range(9990, 10_000))


def test_a_dropped_message_is_not_dearer_than_a_delivered_one() -> None:
    """Counted in calls, of Python and of C, which no other work on the machine adds to."""
    count, waiting = 500, 200

    def calls(takes: bool) -> int:
        bench = Bench(waiting=waiting, topics=24)
        publications = [
            Publication(bench.topics[n % 24], {"data": float(n)}) for n in range(count + waiting)
        ]
        for one in publications[:waiting]:
            bench.outbox.deliver(one, 0.0)
        counted = 0

        def count_calls(frame: FrameType, event: str, argument: object) -> None:
            nonlocal counted
            counted += event in ("call", "c_call")

        sys.setprofile(count_calls)
        try:
            for one in publications[waiting:]:
                bench.outbox.deliver(one, 0.0)
                if takes:
                    bench.outbox.next_frame()
        finally:
            sys.setprofile(None)
        return counted

    dropped, delivered = calls(takes=False), calls(takes=True)
    assert count < dropped <= delivered
