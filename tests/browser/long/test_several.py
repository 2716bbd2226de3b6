"""Two aircraft in one console: both on the map, one steered, no order reaches the other."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any

import pytest

from tests.browser.boxes import faults
from tests.browser.conftest import Console, Watch, context_of, running_console, until
from tests.browser.operator import (
    airborne,
    banner,
    is_still,
    look_around,
    press,
    take_off,
)

pytestmark = [pytest.mark.anyio]

PLACES = """() => [...document.querySelectorAll(".aircraft")].map((one) => {
  const box = one.getBoundingClientRect();
  return [box.x, box.y, box.width, box.height];
})"""


@dataclass
class Two:
    """A console of two aircraft, each watched.

    Attributes:
        kite, crow: As a test of one aircraft knows it.
    """

    kite: Console
    crow: Console


@asynccontextmanager
async def two_in(browser: Any) -> AsyncIterator[Two]:
    async with (
        running_console(aircraft=("kite=sim://", "crow=sim://")) as (report, process),
        context_of(browser) as context,
    ):
        both = Two(*(Console(report["console"], process, context) for _ in range(2)))
        both.kite.watch, both.crow.watch = Watch(), Watch("/crow")
        works = [
            asyncio.create_task(one.watch.run(report["rosbridge"][0]))
            for one in (both.kite, both.crow)
        ]
        await until(lambda: all(len(one.watch.newest) == 4 for one in (both.kite, both.crow)))
        yield both
        for work in works:
            work.cancel()
        await asyncio.gather(*works, return_exceptions=True)
        assert both.kite.errors == []
        assert both.kite.foreign == []


async def turn_to(page: Any, name: str) -> None:
    await page.click(f"[data-ship={name}]")
    await page.wait_for_selector(f"[data-ship={name}][aria-current=page]")
    await page.wait_for_function("window.m100?.steering && window.m100.socket.heardAt > 0")


async def steer(page: Any) -> None:
    await page.click("#pad")
    await page.keyboard.press("Digit4")
    await page.keyboard.down("w")


async def test_two_aircraft_are_flown_and_no_order_reaches_the_other(browser: Any) -> None:
    async with two_in(browser) as two:
        page = await airborne(two.kite)
        assert await page.locator(".ship").count() == 2
        await page.wait_for_selector(".aircraft.other")
        assert all(width > 0 for _, _, width, _ in await page.evaluate(PLACES))
        assert two.crow.watch.status == 1, "the take-off of one was obeyed by the other"
        await _turns_and_leaves_it_hovering(two, page)
        await _flies_the_other(two, page)
        await _stops_each(two, page)


async def _turns_and_leaves_it_hovering(two: Two, page: Any) -> None:
    await steer(page)
    await until(lambda: two.kite.watch.speed[1] > 0.5)
    assert is_still(two.crow)
    await turn_to(page, "crow")
    await until(lambda: is_still(two.kite))
    await page.wait_for_selector(".ship.mine [data-ship=kite]:not([aria-current=page])")
    await page.wait_for_selector(".ship.free [data-ship=crow]")
    assert two.kite.watch.height > 0.8
    await page.keyboard.up("w")


async def _flies_the_other(two: Two, page: Any) -> None:
    await press(page, "obtain")
    await banner(page, "You have control")
    await page.wait_for_function("document.querySelectorAll('.ship.mine').length === 2")
    await look_around(page)
    await take_off(page, two.crow)
    await page.wait_for_selector("[data-act=land]:not([disabled])")
    await steer(page)
    await until(lambda: two.crow.watch.speed[1] > 0.5)
    assert is_still(two.kite)


async def _stops_each(two: Two, page: Any) -> None:
    """By somebody else, in the row above everything, without turning to either."""
    other = await two.kite.open()
    await other.wait_for_function("document.querySelectorAll('.ship.theirs').length === 2")
    await other.click("[data-stop=kite]")
    await asyncio.sleep(1.0)
    assert two.crow.watch.speed[1] > 0.5, "STOP of one stopped the other"
    await other.click("[data-stop=crow]")
    await until(lambda: is_still(two.crow))
    assert two.kite.watch.height > 0.8
    assert two.crow.watch.height > 0.8
    await page.keyboard.up("w")
    assert await faults(page) == []
    await page.set_viewport_size({"width": 390, "height": 844})
    assert await faults(page) == []
    await page.set_viewport_size({"width": 844, "height": 390})
    assert await faults(page) == []
