"""A pilot's end: who is there, what each is asked, and what is left when a network goes."""

from __future__ import annotations

import anyio
import pytest

from m100link.fleet.client import Change
from m100link.fleet.outcome import Outcome
from tests.fleet.conftest import Rig

pytestmark = pytest.mark.anyio


async def test_all_take_off_and_land(rig: Rig) -> None:
    ones = [await rig.aircraft(name) for name in ("a1", "a2")]
    pilot = await rig.pilot()
    results = await pilot.each(lambda one: one.take_off())
    assert {name: str(one) for name, one in results.items()} == {"a1": "ok", "a2": "ok"}
    assert all(one.height > 1.0 for one in ones)
    results = await pilot.land()
    assert {name: str(one) for name, one in results.items()} == {"a1": "ok", "a2": "ok"}
    assert all(one.height < 0.1 for one in ones)


async def test_a_name_that_is_not_there_is_unreachable(rig: Rig) -> None:
    results = await (await rig.pilot()).land(["a7"])
    assert results["a7"].outcome is Outcome.UNREACHABLE


async def test_who_appears_and_who_is_gone(rig: Rig) -> None:
    pilot = await rig.pilot()
    one = await rig.aircraft("a1")
    changes = pilot.changes()
    assert await anext(changes) == Change("a1", True)
    await anyio.sleep(2.0)
    rig.network.cut(one.bus)
    began = anyio.current_time()
    change = await anext(changes)
    assert (change.name, change.is_there) == ("a1", False)
    assert anyio.current_time() - began < 2.0
