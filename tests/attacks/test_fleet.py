"""A fleet whose router, agent or pilot is lost in flight hovers, and nothing resumes by itself."""

from __future__ import annotations

import signal

import pytest

pytest.importorskip("zenoh", reason="the extra fleet is not installed")

from tests.attacks.fleet import LOSSES, STILL_M_S, WITHIN_S, Loss, lose

pytestmark = [pytest.mark.anyio, pytest.mark.pty]


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


@pytest.mark.parametrize(
    "loss",
    [loss for loss in LOSSES if loss.how is signal.SIGSTOP or loss.who == "agent"],
    ids=lambda loss: f"{loss.who} {loss.how.name}",
)
async def test_it_hovers_then_does_what_was_configured(loss: Loss) -> None:
    measured = await lose(loss)
    assert measured.still_s < WITHIN_S
    assert (measured.landed_s is not None) is loss.lands
    assert measured.moved_m_s < STILL_M_S
