"""What was long on its way is seen, whatever the clocks show."""

from __future__ import annotations

import pytest

from m100link.apps.agent.latency import WayTime


@pytest.mark.parametrize("offset", [0.0, 1e9, -5e4])
def test_a_message_is_judged_against_the_fastest(offset: float) -> None:
    way = WayTime()
    delays = [0.08, 0.05, 0.06, 1.0, 0.05]
    late = [way.late(at + offset, at + delay) for at, delay in enumerate(delays)]
    assert late == pytest.approx([0.0, 0.0, 0.01, 0.95, 0.0], abs=1e-6)


def test_clocks_that_drift_are_learned_anew() -> None:
    way = WayTime()
    for second in range(3600):
        assert way.late(second * (1 - 1e-4), float(second)) < 0.01


def test_a_clock_that_stepped_is_believed_after_half_a_minute() -> None:
    way = WayTime()
    way.late(0.0, 0.0)
    assert way.late(-5.0, 1.0) == pytest.approx(6.0)
    late = [way.late(second - 6.0, second) for second in range(2, 40)]
    assert late[-1] == 0.0


def test_the_round_trip_leaves_out_what_the_client_waited() -> None:
    way = WayTime()
    assert way.round_trip is None
    way.echoed(told_at=10.0, held=0.5, now=10.7)
    assert way.round_trip == pytest.approx(0.2)
    way.echoed(told_at=11.0, held=5.0, now=10.0)
    assert way.round_trip == 0.0
