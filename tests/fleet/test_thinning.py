"""A wall is told of each item at its own rate or five times a second, whatever comes together."""

from __future__ import annotations

from collections import Counter

import pytest

from m100link.fleet.thinning import Thinner

FAST, MIDDLE, SLOW = 1 << 1, 1 << 5, 1 << 10


@pytest.mark.parametrize("shift", range(10))
def test_each_item_at_five_hertz_or_its_own_rate(shift: int) -> None:
    thinner, told, packages = Thinner(5.0), Counter[int](), 0
    for tick in range(1000):  # ten seconds at 100 Hz, of which items come at 100, 50 and 1 Hz
        flags = FAST
        flags |= MIDDLE if tick % 2 == 0 else 0
        flags |= SLOW if tick % 100 == shift else 0
        if thinner.goes_on(flags, tick / 100):
            packages += 1
            told.update(bit for bit in (FAST, MIDDLE, SLOW) if flags & bit)
    assert told[SLOW] == 10
    assert 50 <= told[MIDDLE] <= 65
    assert packages <= 100  # of a thousand; an item may come with one that is due for another


def test_what_has_nothing_new_does_not_go_on() -> None:
    thinner = Thinner(5.0)
    assert thinner.goes_on(FAST, 0.0)
    assert not thinner.goes_on(FAST, 0.1)
    assert thinner.goes_on(FAST | SLOW, 0.1)
    assert not thinner.goes_on(0, 0.2)
