"""The page is told what became of a press: never more than the aircraft's side did."""

from __future__ import annotations

import random
from typing import Any

import anyio
import pytest

from m100link.apps.station.console.fate import Fate
from m100link.apps.station.console.tab import Tab
from tests.apps.station.conftest import Rig
from tests.apps.station.console.test_tab import Browser, airborne

pytestmark = pytest.mark.anyio


async def hold(browser: Browser, seconds: float, **axes: float) -> list[str]:
    """Beats for a time; what was told of each."""
    told = []
    for _ in range(round(seconds / 0.05)):
        answer = browser.beat(1, **axes)
        assert answer is not None
        told.append(answer["fate"])
        await anyio.sleep(0.05)
    return told


async def test_sent_becomes_flown_once_the_agent_has_taken_it(rig: Rig) -> None:
    browser = await airborne(rig)
    for _ in range(2):
        told = await hold(browser, 1.0, x=-4)
        assert told[0] == Fate.SENT
        assert told[-1] == Fate.FLOWN
        assert set(told) == {Fate.SENT, Fate.FLOWN}
        assert told == sorted(told, reverse=True)  # sent, then flown, and not back
        browser.say("rest")


async def test_nobody_in_control_flies_nothing_by_its_pad(rig: Rig) -> None:
    browser = Browser(rig)
    assert set(await hold(browser, 0.5, x=-4)) == {Fate.NO_CONTROL}
    await browser.tab.activate()
    await browser.tab.obtain()
    browser.say("rest")
    # It has control, and stands with its motors off.
    assert set(await hold(browser, 0.5, x=-4)) == {Fate.ON_GROUND}
    other = Browser(rig, "another")
    assert set(await hold(other, 0.5, x=-4)) == {Fate.NO_CONTROL}


async def test_a_pilot_who_takes_it_ends_what_is_flown(rig: Rig) -> None:
    browser = await airborne(rig)
    assert (await hold(browser, 0.5, x=-4))[-1] == Fate.FLOWN
    rig.aircraft.leave_f()
    assert (await hold(browser, 1.0, x=-4))[-1] == Fate.NO_CONTROL


async def test_what_is_held_through_stop_is_told_as_such(rig: Rig) -> None:
    browser = await airborne(rig)
    assert (await hold(browser, 0.5, x=-4))[-1] == Fate.FLOWN
    await browser.tab.stop()
    assert set(await hold(browser, 0.5, x=-4)) == {Fate.LET_GO}
    browser.say("rest")
    assert (await hold(browser, 0.5, x=-4))[-1] == Fate.FLOWN


async def test_late_beats_are_told_as_slow(rig: Rig) -> None:
    browser = await airborne(rig)
    await hold(browser, 0.5, x=-4)
    waiting = [browser.message("beat", mode=1, x=-4, y=0, z=0, w=0) for _ in range(3)]
    await anyio.sleep(0.6)
    for text in waiting:
        answer = browser.hear(browser.tab.receive(text))
        assert answer is not None
        assert answer["fate"] == Fate.SLOW


@pytest.mark.parametrize("seed", range(5))
async def test_flown_is_told_only_while_the_tab_flies(rig: Rig, seed: int) -> None:
    """Drawn: whatever happens in whatever order, "flown" means control, in the air, not refused."""
    chance = random.Random(seed)
    browser = await airborne(rig)
    tab: Tab = browser.tab

    async def stop() -> None:
        await tab.stop()

    async def nothing() -> None:
        await anyio.sleep(chance.random())

    async def rest() -> None:
        browser.say("rest")

    async def leave_f() -> None:
        rig.aircraft.leave_f()

    async def return_to_f() -> None:
        rig.aircraft.return_to_f()

    async def lose() -> None:
        tab.lost()

    async def obtain() -> None:
        await tab.attempt(tab.obtain)

    events: list[Any] = [stop, nothing, rest, leave_f, return_to_f, lose, obtain]
    flown = 0
    for _ in range(60):
        await chance.choice(events)()
        await hold(browser, chance.uniform(0.0, 0.3), x=-1)
        fates = await hold(browser, 0.3, x=-1)  # for so long what was true may be told on
        flown += fates.count(Fate.FLOWN)
        if fates and fates[-1] == Fate.FLOWN:
            assert tab.has_lease
            assert tab.problem == ""
            assert rig.agent.holding.has_authority
            assert rig.aircraft.height > 0.3
    assert flown
