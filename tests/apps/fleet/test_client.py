"""A pilot's end: who is there, what each is asked, and what is left when a network goes."""

from __future__ import annotations

import anyio
import pytest

from m100link.apps.fleet.client import Change
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.payloads import Card, Outcome, pack
from m100link.errors import OutcomeUnknown
from tests.apps.bus.memory import Weather
from tests.apps.fleet.conftest import SITE, Rig

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


async def test_what_can_be_no_name_is_nobody(rig: Rig) -> None:
    """One token of a stranger ended the list, the console and what is done with all."""
    rig.network.session().declare(f"m100-live/{SITE}/no name/9f")
    pilot = await rig.pilot()
    await rig.aircraft("a1")
    assert await pilot.names() == sorted(await pilot.cards()) == sorted(pilot.present) == ["a1"]


async def test_a_card_of_another_name_than_that_of_its_key_is_not_shown_as_it(rig: Rig) -> None:
    """Rules of a router go by keys: what is told under one's own may say anything."""
    await rig.aircraft("a1")
    other = rig.network.session()
    keys = Keys(SITE, "a2")
    lie = Card("a1", "00", 0.0, "connected", task="none at all")
    other.serve(keys.state, lambda question: question.answer(keys.state, pack(lie)))
    found = await (await rig.pilot()).cards()
    assert found["a1"].task == ""
    assert found["a2"].connection == "unreadable"


async def test_who_was_never_told_the_time_lands_all_the_same(rig: Rig) -> None:
    """The first word of a program: its age is not known, and asked for."""
    one, pilot = await rig.aircraft("a1"), await rig.pilot()
    await pilot["a1"].take_off()
    assert (await (await rig.pilot("another")).land())["a1"].is_ok
    assert one.height < 0.1


async def test_who_was_told_the_time_long_ago_lands_all_the_same(rig: Rig) -> None:
    one, pilot = await rig.aircraft("a1"), await rig.pilot()
    aircraft = pilot["a1"]
    await aircraft.take_off()
    await anyio.sleep(600.0)
    await aircraft.land()
    assert one.height < 0.1


@pytest.mark.parametrize("has_asked_before", [True, False])
async def test_a_landing_that_was_given_up_does_not_end_the_flight_of_another(
    rig: Rig, has_asked_before: bool
) -> None:
    """It is on its way for a minute, and was told as unknown after five seconds."""
    one, pilot, other = await rig.aircraft("a1"), await rig.pilot(), await rig.pilot("other")
    aircraft = pilot["a1"]
    if has_asked_before:
        await aircraft.stop()
    rig.network.weather = Weather(delay_s=60.0)
    with pytest.raises(OutcomeUnknown):
        await aircraft.land()
    rig.network.weather = Weather()
    async with other["a1"].control() as control:
        await control.take_off()
        await anyio.sleep(90.0)
        assert one.height > 1.0
        assert one.client.holder.name == "other"
