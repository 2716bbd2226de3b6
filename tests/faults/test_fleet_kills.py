"""Cables that are cut and an agent that is killed: every report is true."""

from __future__ import annotations

import pytest

from m100link.apps.fleet.payloads import Outcome
from tests.faults.fleet_kills import run

pytest.importorskip("zenoh", reason="the extra fleet is not installed")

pytestmark = [pytest.mark.anyio, pytest.mark.pty]


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


async def test_at_most_once_and_never_a_lie_over_cables_that_are_cut() -> None:
    told: list[str] = []
    counted, cuts = await run(60, 2, told.append)
    about = f"{told} {cuts} {counted}"
    assert counted.is_good, about
    assert counted.outcomes.total() == 60, about
    assert counted.outcomes[Outcome.OK] > 10, about
    assert cuts > 0, about
    assert len(told) == 2, about
