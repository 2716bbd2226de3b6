"""Sessions that answer, never did, or do so no more; the time is an argument."""

from __future__ import annotations

import pytest

from m100link.apps.bus.network import Inbox
from m100link.apps.ros2.endpoints import ASK_S, SILENCE_S, Heartbeat
from tests.apps.bus.memory import MemoryInbox
from tests.apps.ros2.conftest import RecordingBus

STEP_S = 0.02


class Clock:
    def __init__(self, bus: RecordingBus, *sessions: str) -> None:
        self.now = 0.0
        self.heartbeat = Heartbeat(bus)
        self.heartbeat.follow(sessions)

    def until_missing(self, seconds: float) -> float | None:
        """After how long one is missing; None if none is."""
        ends = self.now + seconds
        began = self.now
        while self.now < ends:
            self.now += STEP_S
            if self.heartbeat.is_missing(self.now):
                return self.now - began
        return None


@pytest.fixture
def bus() -> RecordingBus:
    made = RecordingBus()
    made.answering = {"aa", "bb"}
    return made


def test_who_stops_answering_is_missing_within_two_seconds(bus: RecordingBus) -> None:
    clock = Clock(bus, "aa", "bb")
    assert clock.until_missing(5.0) is None
    bus.answering.remove("bb")
    took = clock.until_missing(5.0)
    assert took is not None
    assert SILENCE_S - ASK_S <= took <= SILENCE_S + 2 * STEP_S


def test_who_never_answers_is_left_to_its_lease(bus: RecordingBus) -> None:
    clock = Clock(bus, "aa", "cc")
    assert clock.until_missing(10.0) is None
    assert "cc" in bus.asked


def test_one_answer_that_is_lost_is_not_missed(bus: RecordingBus) -> None:
    clock = Clock(bus, "aa")
    for _ in range(10):
        assert clock.until_missing(1.2) is None
        bus.answering = set()
        assert clock.until_missing(0.6) is None
        bus.answering = {"aa"}


def test_a_late_answer_is_one(bus: RecordingBus) -> None:
    clock = Clock(bus, "aa")
    assert clock.until_missing(2.0) is None
    waiting: list[tuple[float, MemoryInbox[bool]]] = []

    class Slow(RecordingBus):
        def probe(self, key: str, *, timeout: float) -> Inbox[bool]:
            waiting.append((clock.now, inbox := MemoryInbox[bool](1)))
            return inbox

    clock.heartbeat._bus = Slow()
    for _ in range(500):
        assert clock.until_missing(STEP_S) is None
        for at, inbox in waiting:
            if clock.now - at >= 0.9:
                inbox.waiting.append(True)
        waiting = [one for one in waiting if clock.now - one[0] < 0.9]


def test_those_of_before_are_not_asked_any_more(bus: RecordingBus) -> None:
    clock = Clock(bus, "aa")
    assert clock.until_missing(1.0) is None
    clock.heartbeat.follow(["bb"])
    bus.answering = {"bb"}
    bus.asked.clear()
    assert clock.until_missing(5.0) is None
    assert set(bus.asked) == {"bb"}


def test_what_a_stranger_calls_his_session_is_not_asked_unless_it_can_be_one(
    bus: RecordingBus,
) -> None:
    bad = ("**", "", "a/b", "A1", "g", "a" * 33, "a?b", "aa$*")
    clock = Clock(bus, *bad, *(f"{number:x}" for number in range(1000)))
    assert clock.until_missing(ASK_S) is None
    assert not set(bad) & set(bus.asked)
    assert len(set(bus.asked)) == 16
