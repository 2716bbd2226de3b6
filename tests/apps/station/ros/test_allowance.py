"""So much at once, so much per second."""

from __future__ import annotations

import pytest

from m100link.apps.station.ros.allowance import Allowance


def test_so_much_at_once_and_so_much_per_second() -> None:
    one = Allowance(rate=2.0, burst=5.0)
    assert [one.take(100.0) for _ in range(7)] == [True] * 5 + [False] * 2
    assert not one.take(100.4)
    assert one.take(100.5)
    assert [one.take(1000.0) for _ in range(7)] == [True] * 5 + [False] * 2


def test_what_is_too_dear_costs_nothing() -> None:
    one = Allowance(rate=1.0, burst=10.0)
    assert not one.take(0.0, 11.0)
    assert one.take(0.0, 10.0)


def test_what_was_used_already_has_to_be_waited_for() -> None:
    one = Allowance(rate=0.5, burst=1.0)
    assert one.wait(0.0) == 0.0
    one.spend(0.0, 3.0)
    assert one.wait(0.0) == pytest.approx(4.0)
    assert one.wait(3.0) == pytest.approx(1.0)
    assert one.wait(5.0) == 0.0
