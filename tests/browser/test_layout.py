"""At every size, in every state of a flight: STOP is hit, confirms are in sight, the map is most.

More states of the other views are in ``long/``.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from tests.browser.boxes import SIZES, faults
from tests.browser.conftest import Console, console_in_browser, context_of
from tests.browser.operator import (
    airborne,
    fold,
    hold,
    in_control,
    look_around,
    look_at,
    press_until,
    shows,
)

pytestmark = [pytest.mark.anyio]


PHONES = ((390, 844), (844, 390))

# What has to be pressed for a flight to begin, go on or end: in sight, and hit where it is seen.
CONFIRMS = """() => {
  const isHit = (one, box) => ([across, down]) => one.contains(
    document.elementFromPoint(box.left + across * box.width, box.top + down * box.height));
  const corners = [[.1, .1], [.9, .1], [.5, .5], [.1, .9], [.9, .9]];
  return [...document.querySelectorAll(".act.hold, #strip .act, #confirm, [data-act=obtain]")]
    .filter((one) => one.checkVisibility({visibilityProperty: true}))
    .filter((one) => !corners.every(isHit(one, one.getBoundingClientRect())))
    .map((one) => `${one.dataset.act ?? one.id} is out of sight`);
}"""

# Percent of the page on which nothing but the map is seen and touched.
MAP_SHARE = """() => {
  let map = 0, all = 0;
  for (let x = 2; x < innerWidth; x += 5) for (let y = 2; y < innerHeight; y += 5) {
    all += 1;
    map += Boolean(document.elementFromPoint(x, y)?.closest("#map"));
  }
  return 100 * map / all;
}"""

TOP = (
    "#banner",
    *(f"#values [data-field={name}]" for name in ("battery", "gps", "height", "climb")),
)
TOP += ("#values [data-field=speed]", "#values [data-field=age]", "[data-act=stop]", "#strip")
"""What stands in every view."""


async def wrong_at(page: Any, size: tuple[int, int]) -> list[str]:
    await page.set_viewport_size({"width": size[0], "height": size[1]})
    found = await faults(page)
    found += await page.evaluate(CONFIRMS)
    for one in TOP:
        if not await page.locator(one).first.is_visible():
            found.append(f"{one} is not there")
    return found


class Walk:
    """A page that is looked at in one state after another."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.found: dict[str, list[str]] = {}

    async def see(self, state: str) -> None:
        for size in SIZES:
            if wrong := await wrong_at(self.page, size):
                self.found[f"{state} at {size[0]} x {size[1]}"] = wrong

    async def share_of_map(self, state: str, least: float) -> None:
        """While it flies, on phones."""
        for width, height in PHONES:
            await self.page.set_viewport_size({"width": width, "height": height})
            await self.page.wait_for_timeout(100)
            share = await self.page.evaluate(MAP_SHARE)
            if share < least:
                self.found[f"{state}: map at {width} x {height}"] = [f"{share:.1f} %"]


async def test_every_confirm_is_in_sight_in_every_state_of_a_flight(browser: Any) -> None:
    async with console_in_browser(browser, "--firmware", "3.1") as console:
        page = await console.open()
        walk = Walk(page)
        await walk.see("nobody has control")
        await in_control(page)
        await walk.see("on the ground")
        await airborne(console, page=page)
        for panel in ("horizon", "sticks", "camera"):
            await fold(page, panel, is_shown=False)
        await walk.see("hover")
        await walk.share_of_map("hover", 65.0)
        await fold(page, "sticks", is_shown=True)
        await walk.see("hover, sticks")
        await walk.share_of_map("hover, sticks", 60.0)
        await fold(page, "horizon", is_shown=True)
        await walk.see("sticks and instruments")
        await _point(page, walk)
        await fold(page, "sticks", is_shown=False)
        await walk.see("a circle, without sticks")
        await page.click("#point-close")
        await fold(page, "horizon", is_shown=False)
        await fold(page, "camera", is_shown=True)
        await walk.see("the camera")
        await fold(page, "camera", is_shown=False)
        await page.click("#point-open")
        await _fly_there(page, walk)
        await _plan(page, walk)
        assert walk.found == {}


async def _point(page: Any, walk: Walk) -> None:
    await page.click("#point-open")
    await walk.see("no point yet")
    await page.fill("#click-distance", "20")
    await page.fill("#click-bearing", "90")
    await page.wait_for_selector("[data-act=guide]:visible")
    await walk.see("a point")
    await page.click("[data-kind=circle]")
    await walk.see("a circle")
    await page.fill("#click-distance", "900")
    await shows(page, "#click-refusals", "the envelope ends at 150 m")
    await walk.see("a point that is refused")
    await page.fill("#click-distance", "20")


async def _fly_there(page: Any, walk: Walk) -> None:
    await in_control(page)  # a busy machine may have taken it from a page that it did not hear
    await page.fill("#click-bearing", "180")
    await page.wait_for_selector("[data-act=guide]:visible")
    flying = page.locator("#guided-flying:visible").is_visible
    await press_until(page, "guide", flying, hold, mend=lambda: in_control(page))
    await walk.see("it flies around a point")
    await walk.share_of_map("it flies around a point", 60.0)
    landing = page.locator("#task", has_text="landing")
    await press_until(page, "land", landing.is_visible, hold, mend=lambda: in_control(page))
    assert await page.inner_text("#problem") == ""  # the circle ended as it was wished
    await walk.see("it lands")


async def _plan(page: Any, walk: Walk) -> None:
    await look_at(page, "plan")
    await page.click("[data-plan=add]")
    await page.wait_for_selector("[data-point='0']")
    await walk.see("a plan")


async def test_a_phone_takes_off_in_three_taps_and_flies_to_a_point_in_two(browser: Any) -> None:
    """From an open page to the hover; where it is, and why it does not take off, need no tap."""
    phone = {"viewport": {"width": 390, "height": 844}, "has_touch": True}
    async with (
        console_in_browser(browser) as console,
        context_of(browser, **phone) as context,
    ):
        console.context, desk = context, console.context
        page = await console.open()
        console.context = desk
        taps = 0

        async def tapped(page: Any, name: str) -> None:
            await page.tap(f"[data-act={name}]")

        async def held(page: Any, name: str) -> None:
            box = await page.locator(f"[data-act={name}]").bounding_box()
            await page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
            await page.mouse.down()
            await page.wait_for_timeout(1800)
            await page.mouse.up()

        async def tap(
            name: str, how: Callable[[Any, str], Awaitable[None]], done: Callable[[], Any]
        ) -> None:
            nonlocal taps
            taps += 1
            await press_until(page, name, done, how)

        await page.wait_for_function("window.m100.map?.aircraft")
        await shows(page, "#why-not", "to check before take-off")
        in_hand = page.locator("#banner", has_text="You have control")
        await tap("obtain", tapped, in_hand.is_visible)
        await look_around(page)
        taps += 1
        await tap("take_off", held, lambda: console.watch.height > 1.0)
        assert taps == 3
        await page.wait_for_selector("[data-act=land]:not([disabled])")
        box = await page.locator("#map").bounding_box()
        await page.touchscreen.tap(box["x"] + box["width"] / 2, box["y"] + 120)
        await page.wait_for_selector("[data-act=guide]:visible")
        await tap("guide", held, lambda: page.is_visible("#guided-flying"))
        assert taps == 4
        await page.tap("[data-act=stop]")
        await page.wait_for_selector("#guided-flying", state="hidden")
        assert await page.inner_text("#problem") == ""  # it went as it was wished


async def test_stop_is_hit_and_nothing_covers_anything(console: Console) -> None:
    page = await console.open()
    found: dict[str, list[str]] = {}
    for view in ("check", "data", "events", "settings"):
        await look_at(page, view)
        await page.wait_for_selector(f"section[data-view={view}] > *", state="attached")
        for size in PHONES:
            if seen := await wrong_at(page, size):
                found[f"{view} at {size}"] = seen
    assert found == {}
