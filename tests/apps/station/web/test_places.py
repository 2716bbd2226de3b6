"""Whose place a newcomer gets."""

from __future__ import annotations

from dataclasses import dataclass

from m100link.apps.station.web.places import who_makes_room


@dataclass(eq=False)
class Guest:
    heard_at: float
    peer: str = "a"
    has_spoken: bool = True
    subscribes: bool = False


def test_nobody_goes_while_all_talk() -> None:
    assert who_makes_room([], "a", 100.0) is None
    assert (
        who_makes_room([Guest(95.0), Guest(99.0), Guest(99.9, has_spoken=False)], "a", 100) is None
    )


def test_first_who_never_said_anything() -> None:
    mute = Guest(99.0, has_spoken=False)
    guests = [Guest(0.0), Guest(99.4, has_spoken=False), mute]
    assert who_makes_room(guests, "a", 100.0) is mute


def test_then_one_of_the_address_with_the_most() -> None:
    longest = Guest(98.0, subscribes=True)
    guests = [Guest(99.0), longest, Guest(99.5), Guest(10.0, peer="b")]
    assert who_makes_room(guests, "c", 100.0) is longest
    assert who_makes_room(guests, "b", 100.0) is longest
    assert who_makes_room(guests[:2] + guests[3:], "b", 100.0) is guests[3]  # as many as that


def test_then_who_was_silent_for_long_and_gets_nothing() -> None:
    guests = [Guest(10.0, subscribes=True), Guest(89.0), Guest(88.0), Guest(91.0)]
    assert who_makes_room(guests, "a", 100.0) is guests[2]
    assert who_makes_room(guests[:1], "a", 100.0) is guests[0]
