"""Connections that ask nothing do not keep those out that ask."""

from __future__ import annotations

from dataclasses import dataclass, field

from m100link.apps.station.web.door import Door


@dataclass(eq=False)
class Visitor:
    peer: str = "a"
    is_answered: bool = True
    is_out: bool = field(default=False)

    def turn_out(self) -> None:
        self.is_out = True


def enter(door: Door, *visitors: Visitor) -> None:
    for one in visitors:
        door.enter(one)


def test_the_longest_idle_of_a_peer_goes_for_its_newcomer() -> None:
    door = Door(per_peer=3)
    old = [Visitor(), Visitor(is_answered=False), Visitor(), Visitor("b")]
    enter(door, *old)
    new = Visitor()
    enter(door, new)
    assert [one.is_out for one in (*old, new)] == [True, False, False, False, False]
    door.answered(old[2])
    enter(door, Visitor())
    assert new.is_out  # it came later, but the other one asked something since
    assert not old[2].is_out


def test_a_newcomer_is_turned_out_where_all_are_busy() -> None:
    door = Door(per_peer=2)
    enter(door, Visitor(is_answered=False), Visitor(is_answered=False))
    new = Visitor()
    enter(door, new)
    assert new.is_out
    assert len(door) == 2


def test_beyond_the_total_the_peer_with_the_most_loses_one() -> None:
    door = Door(per_peer=10, total=5)
    many, few = [Visitor("a") for _ in range(4)], Visitor("b")
    enter(door, *many, few, Visitor("c"))
    assert [one.is_out for one in many] == [True, False, False, False]
    assert not few.is_out
    assert len(door) == 5


def test_who_left_does_not_count() -> None:
    door = Door(per_peer=1)
    for _ in range(10):
        one = Visitor()
        enter(door, one)
        door.leave(one)
        door.leave(one)  # twice is once
        assert not one.is_out
    assert len(door) == 0
