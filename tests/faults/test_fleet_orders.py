"""In bad weather an order is carried out at most once, and every report is true."""

from __future__ import annotations

import pytest

from m100link.apps.fleet.payloads import Outcome
from tests.faults.fleet_orders import run


@pytest.mark.parametrize("seed", [1, 2])
def test_at_most_once_and_never_a_lie(seed: int) -> None:
    counted = run(seed, 400, restarts=3)
    assert counted.is_good, f"seed {seed}: {counted}"
    assert counted.outcomes[Outcome.OK] > 100, f"seed {seed}: {counted}"
    assert counted.outcomes.total() == 400
