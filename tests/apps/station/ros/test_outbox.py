"""What waits for a slow client, and what it costs to drop it."""

from __future__ import annotations

import gc
import json
import sys
import weakref
from collections import Counter
from types import FrameType
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from m100link.apps.station.ros.client import Outbox, SubscribeOptions
from m100link.apps.station.ros.graph import Graph, Publication, RosTopic


class Bench:
    def __init__(self, waiting: int, topics: int = 3) -> None:
        graph = Graph()
        self.topics = [graph.add_topic(f"/{n}", "std_msgs/Float32") for n in range(topics)]
        self.outbox = Outbox(waiting, lambda: None)
        for topic in self.topics:
            subscription = self.outbox.subscription(topic, topic.name)
            subscription.requested["1"] = SubscribeOptions()
            subscription.merge()

    def put(self, topic: RosTopic, value: float) -> None:
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


@given(st.lists(st.integers(-1, 3), max_size=200), st.integers(1, 12))
def test_what_is_dropped_is_of_a_topic_that_none_has_more_of(steps: list[int], limit: int) -> None:
    bench = Bench(waiting=limit, topics=4)
    waiting: list[tuple[str, float]] = []
    for value, step in enumerate(steps):
        if step < 0:
            frame = bench.outbox.next_frame()
            assert (frame is None) == (not waiting)
            if frame is not None:
                message = json.loads(frame)
                assert (message["topic"], message["msg"]["data"]) == waiting.pop(0)
            continue
        before = bench.outbox.dropped
        bench.put(bench.topics[step], value)
        waiting.append((f"/{step}", value))
        if bench.outbox.dropped > before:
            counts = Counter(topic for topic, _ in waiting)
            pending = {name: one.pending for name, one in bench.outbox.subscriptions.items()}
            (busiest,) = (name for name in counts if pending[name] < counts[name])
            assert counts[busiest] == max(counts.values())
            waiting.remove(next(one for one in waiting if one[0] == busiest))
        assert len(waiting) <= limit
    assert bench.take() == waiting


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


def test_a_drop_costs_the_same_however_many_topics_there_are() -> None:
    """Counted in lines of Python, so that a loop shows."""

    def lines(topics: int) -> int:
        bench = Bench(waiting=200, topics=topics)
        publications = [
            Publication(bench.topics[n % topics], {"data": float(n)}) for n in range(400)
        ]
        counted = 0

        def count_lines(frame: FrameType, event: str, argument: object) -> Any:
            nonlocal counted
            counted += event == "line"
            return count_lines

        for one in publications[:200]:
            bench.outbox.deliver(one, 0.0)
        before = sys.gettrace()  # what measures coverage has to go on
        sys.settrace(count_lines)
        try:
            for one in publications[200:]:
                bench.outbox.deliver(one, 0.0)
        finally:
            sys.settrace(before)
        return counted

    assert lines(100) < 1.2 * lines(2)
