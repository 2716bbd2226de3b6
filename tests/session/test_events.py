"""How long answers take, from acks that came in time, late, and after lost frames."""

from __future__ import annotations

from random import Random

import pytest

from m100link.session.endpoint import Sender
from m100link.session.events import LONGEST_WAIT_S, SLOW_S, Latency
from m100link.wire.frame import Frame, FrameDecoder


def _ack(wire: bytes) -> Frame:
    (frame,) = FrameDecoder().feed(wire)
    return Frame(frame.session, True, frame.sequence, False, 0, b"")


def _answers(sender: Sender, *seconds: float) -> None:
    """One request after the other, each answered after so long, and never repeated."""
    for taken in seconds:
        sender.request(b"x", now=0.0, timeout=100.0)
        sender.receive_ack(_ack(sender.output.pop()), taken)
        sender.output.clear()


def test_before_the_first_answer_nobody_knows() -> None:
    latency = Latency()
    assert latency.round_trip_s is None
    assert not latency.is_slow
    assert latency.slack_s == 0.0
    assert latency.wait_s(0.5) == 0.5
    assert "nobody has measured" in str(latency)


@pytest.mark.parametrize(
    ("seconds", "waited"),
    [
        ([1.0], 3.0),  # RFC 6298, 2.2: SRTT = R, RTTVAR = R/2; SRTT + 4 RTTVAR
        ([1.0, 0.2], 3.2),  # 2.3: RTTVAR = 3/4 0.5 + 1/4 0.8 = 0.575; SRTT = 7/8 + 0.2/8 = 0.9
        ([1.0, 1.8], 3.4),  # as far off the other way: SRTT = 1.1
        ([1.0, 1.0], 2.5),  # RTTVAR = 0.375
    ],
)
def test_an_answer_is_waited_for_as_the_rfc_says(seconds: list[float], waited: float) -> None:
    latency = Latency()
    for one in seconds:
        latency.note(one)
    assert latency.wait_s(0.0) == pytest.approx(waited)


def test_a_quick_line_is_waited_for_as_long_as_ever() -> None:
    latency = Latency()
    for _ in range(9):
        latency.note(0.02)
    assert (latency.wait_s(0.2), latency.slack_s) == (0.2, 0.0)
    assert str(latency) == "the line is quick: 0.02 s round trip"


def test_a_slow_line_is_told_and_waited_for() -> None:
    latency = Latency()
    latency.note(1.2)
    assert latency.round_trip_s == 1.2
    assert latency.is_slow
    assert str(latency) == "the line is slow: 1.2 s round trip"
    assert latency.slack_s == pytest.approx(1.8)
    assert latency.wait_s(0.5) == pytest.approx(3.6)  # RFC 6298, 2.2: R and four times R / 2
    for _ in range(20):
        latency.note(1.2)
    assert latency.wait_s(0.5) == pytest.approx(1.8)


def test_answers_that_scatter_are_waited_for_longer() -> None:
    latency = Latency()
    for taken in (1.0, 2.0):
        latency.note(taken)
    # RFC 6298, 2.3: the deviation is 3/4 of 0.5 and 1/4 of 1.0, the mean 7/8 of 1 and 1/8 of 2.
    assert latency.wait_s(0.5) == pytest.approx(1.125 + 4 * 0.625)


def test_one_lost_frame_makes_no_line_slow() -> None:
    latency = Latency()
    for taken in (0.02, 0.52, 1.02):
        latency.note(taken)
    assert not latency.is_slow
    assert latency.slack_s == 0.0


def test_what_was_long_ago_does_not_count() -> None:
    latency = Latency()
    for taken in (5.0, *[0.02] * 40):
        latency.note(taken)
    assert latency.wait_s(0.5) == 0.5
    assert not latency.is_slow


def test_no_wait_is_longer_than_half_a_minute() -> None:
    latency = Latency()
    latency.note(1000.0)
    assert latency.wait_s(0.5) == LONGEST_WAIT_S == 30.0


def test_the_last_transmission_is_waited_for_as_long_as_answers_take() -> None:
    sender = Sender()
    _answers(sender, *[2.0] * 20)
    sender.request(b"y", now=10.0, timeout=0.5, tries=3)
    for now in (10.5, 11.0, 11.5, 13.9):
        sender.handle_timer(now)
    assert len(sender.output) == 3  # the pause between repeats is what it was
    assert sender.next_event() is None
    assert sender.next_wakeup() == pytest.approx(14.0)  # 11 s, and one and a half times 2 s
    sender.handle_timer(14.0)
    assert sender.next_event() is not None


def test_an_ack_that_comes_too_late_is_measured() -> None:
    sender = Sender()
    sender.request(b"x", now=0.0, timeout=0.5, tries=1)
    wire = sender.output.pop()
    sender.handle_timer(0.5)
    assert sender.next_event() is not None
    assert sender.receive_ack(_ack(wire), 4.0) is None
    assert sender.latency.round_trip_s == 4.0
    assert sender.receive_ack(_ack(wire), 9.0) is None  # a second one measures nothing
    assert sender.latency.wait_s(0.5) == 12.0
    assert (sender.statistics.late_acks, sender.statistics.duplicate_acks) == (1, 1)


def test_a_request_under_way_gains_by_what_is_found_meanwhile() -> None:
    sender = Sender()
    sender.request(b"x", now=0.0, timeout=0.5, tries=1)
    late = sender.output.pop()
    sender.handle_timer(0.5)
    sender.next_event()
    sender.request(b"y", now=1.8, timeout=0.5, tries=1)
    sender.receive_ack(_ack(late), 2.0)  # 2 s: the next will come at 3.8 s
    sender.handle_timer(2.3)
    assert sender.next_event() is None
    assert sender.receive_ack(_ack(sender.output.pop()), 3.8) is not None


@pytest.mark.parametrize("seed", range(20))
def test_at_any_latency_and_a_tenth_lost_no_answer_that_came_is_thrown_away(seed: int) -> None:
    print(f"seed {seed}")  # noqa: T201 (pytest shows it when the test fails)
    random = Random(seed)
    trip = random.uniform(SLOW_S, 12.0)
    sender, now = Sender(), 0.0
    _answers(sender, trip)
    for _ in range(50):
        sender.request(b"x", now=now, timeout=0.5, tries=3)
        arrivals = []
        for at in (now, now + 0.5, now + 1.0):
            sender.handle_timer(at)
            wire = sender.output.pop()
            if random.random() > 0.19:  # neither it nor its answer is lost
                arrivals.append((at + trip, wire))
        if arrivals:
            now, wire = arrivals[0]
            sender.handle_timer(now - 0.001)
            assert sender.next_event() is None
            assert sender.receive_ack(_ack(wire), now) is not None
        else:
            now += 1.0 + sender.latency.wait_s(0.5)
            sender.handle_timer(now)
            assert sender.next_event() is not None
    assert sender.latency.round_trip_s == pytest.approx(trip)
