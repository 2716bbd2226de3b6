"""Who has the stick, and who does not get it by the death of another."""

from __future__ import annotations

import pytest

from m100link.apps.ros2.control import SILENCE_S, Stick

ONE, OTHER = b"1" * 16, b"2" * 16


@pytest.fixture
def stick() -> Stick:
    made = Stick()
    made.begin(0.0)
    return made


def test_who_begins_first_has_it(stick: Stick) -> None:
    assert stick.hear(ONE, 0.0, 0.0) == ""
    assert stick.hear(OTHER, 0.1, 0.1) == "other"
    assert stick.hear(ONE, 0.2, 0.2) == ""
    assert stick.refused == {"late": 0, "other": 1, "closed": 0}


def test_who_was_refused_has_to_be_silent_first(stick: Stick) -> None:
    stick.hear(ONE, 0.0, 0.0)
    for step in range(1, 20):
        assert stick.hear(OTHER, step / 10, step / 10) == "other"
    assert stick.holder is None
    assert stick.hear(OTHER, 2.5, 2.5) == ""


def test_who_was_silent_begins_anew(stick: Stick) -> None:
    stick.hear(ONE, 0.0, 0.0)
    assert stick.hear(ONE, 5.0, 5.0) == ""


def steer(stick: Stick, begin: float, end: float, number: int = 0) -> int:
    """Send at 20 Hz, 50 ms late; returns the newest number."""
    for step in range(round((end - begin) * 20)):
        number += 1
        at = begin + 0.05 * step
        stick.hear(ONE, at, at + 0.05, number)
    return number


def test_who_paused_and_begins_anew_flies_whatever_it_counts(stick: Stick) -> None:
    number = steer(stick, 0.0, 2.0)
    assert stick.hear(ONE, 4.0, 4.05, number + 1) == ""
    assert stick.hear(ONE, 6.0, 6.05, number + 1) == ""  # it does not count
    assert stick.hear(ONE, 8.0, 8.05, 1) == ""  # it counts anew


def test_who_was_cut_off_while_it_sent_does_not_fly_on(stick: Stick) -> None:
    number = steer(stick, 0.0, 2.0)
    # What it sent between is lost.
    number = steer(stick, 3.0, 6.0, number + 20)
    assert stick.holder is None
    assert stick.refused["other"] == 60
    assert stick.hear(ONE, 7.0, 7.05, number + 1) == ""  # it paused by itself


def test_what_waited_on_a_way_that_was_cut_begins_nothing(stick: Stick) -> None:
    number = steer(stick, 0.0, 2.0)
    for place in range(20):
        number += 1
        assert stick.hear(ONE, 2.0 + 0.05 * place, 3.05, number) == "other"
    assert steer(stick, 3.0, 4.0, number) == number + 20
    assert stick.holder is None


def test_before_control_nobody_has_it() -> None:
    stick = Stick()
    assert stick.hear(ONE, 0.0, 0.0) == "closed"
    stick.begin(0.1)
    assert stick.holder == ONE  # whoever sends alone while control is obtained


def test_of_two_that_send_nobody_gets_it() -> None:
    stick = Stick()
    stick.hear(ONE, 0.0, 0.0)
    stick.hear(OTHER, 0.0, 0.0)
    stick.begin(0.1)
    assert stick.hear(ONE, 0.2, 0.2) == stick.hear(OTHER, 0.2, 0.2) == "other"
    assert stick.hear(ONE, 1.0, 0.3 + SILENCE_S) == ""


def test_after_the_end_nothing_goes_on(stick: Stick) -> None:
    stick.hear(ONE, 0.0, 0.0)
    stick.end()
    assert stick.hear(ONE, 0.1, 0.1) == "closed"


def test_what_waited_is_late_by_whatever_clock(stick: Stick) -> None:
    assert stick.hear(ONE, 1000.0, 0.0) == ""
    assert stick.hear(ONE, 1000.1, 0.45) == "late"
    assert stick.hear(ONE, 1000.5, 0.5) == ""


def test_a_thousand_senders_are_not_kept(stick: Stick) -> None:
    stick.hear(ONE, 0.0, 0.0)
    for number in range(1000):
        stick.hear(number.to_bytes(16, "little"), 0.0, 0.01)
    assert len(stick._senders) <= 32
    assert stick.hear(ONE, 0.1, 0.1) == ""  # nor do they push anybody out


def test_very_many_who_send_push_nobody_off_the_stick() -> None:
    stick = Stick()
    stick.begin(0.0)
    for step in range(100):
        now = 0.05 * step
        assert stick.hear(b"first", now, now) == ""
        for number in range(20):
            assert stick.hear(b"%d of step %d" % (number, step), now, now) == "other"
    assert stick.holder == b"first"
    # It dies, and they go on: nobody of them had been silent.
    for step in range(100, 200):
        now = 0.05 * step
        for number in range(20):
            assert stick.hear(b"%d of step %d" % (number, step), now, now) == "other"
        assert stick.holder == (b"first" if now < 4.95 + SILENCE_S else None)
    assert stick.hear(b"one who begins", 20.0, 20.0) == ""


def test_of_very_many_who_send_when_control_is_obtained_nobody_has_the_stick() -> None:
    stick = Stick()
    for number in range(40):
        stick.hear(b"%d" % number, 0.0, 0.01 * number)
    stick.begin(0.5)
    assert stick.holder is None
