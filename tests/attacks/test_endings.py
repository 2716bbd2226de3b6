"""Some endings beside losses, by seed; ten thousand are ``python -m tests.attacks.endings``."""

from __future__ import annotations

import pytest

from tests.attacks.endings import draw_in_memory

SEED = 28


@pytest.mark.parametrize("first", range(0, 100, 20))
def test_a_drawn_flight_ends_in_order_whatever_the_system_has_lost(first: int) -> None:
    for number in range(first, first + 20):
        draw, troubles = draw_in_memory(SEED, number)
        assert troubles == [], f"seed {SEED}, draw {number}: {draw}"
