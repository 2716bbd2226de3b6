"""A show of five processes behind TLS and rules: three of them are attacked."""

from __future__ import annotations

import pytest

pytest.importorskip("zenoh", reason="the extra fleet is not installed")

from m100link.apps.cli.terminal import ExitCode
from tests.attacks.fleet_show import ATTACKED, NAMES, STOOD_M, attacked, company

pytestmark = [pytest.mark.anyio, pytest.mark.pty]


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


async def test_of_five_who_is_attacked_hovers_and_is_named() -> None:
    """How exactly the others fly depends on the machine: the program of this attack measures it."""
    async with company() as made:
        flown = await attacked(made)
    assert flown.status == ExitCode.FAILED
    assert set(flown.stages) == set(NAMES)
    assert len(flown.begun) == len(NAMES)
    for name in ATTACKED:
        assert flown.stages[name][0] in ("silent", "left"), flown
        assert flown.moved_m[name] <= STOOD_M, flown
        assert any(text.startswith(f"{name} ") and "fly on" in text for text in flown.told), flown
