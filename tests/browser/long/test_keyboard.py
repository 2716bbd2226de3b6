"""A whole mission by keyboard alone; what has the focus is seen."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from tests.browser.conftest import console_in_browser, until
from tests.browser.operator import NOT_TAKEN, banner, hold_key, is_still, shows
from tests.waiting import again_and_again

pytestmark = [pytest.mark.anyio, pytest.mark.timeout(600)]

# Whether somebody who sees the page sees what has the focus: an outline, or Quasar's own marks.
IS_SEEN = """() => {
  const one = document.activeElement, style = getComputedStyle(one);
  const field = one.closest(".q-field--focused, .q-toggle, .q-checkbox, .q-slider");
  const label = one.matches(".unseen") && getComputedStyle(one.nextElementSibling).outlineStyle;
  return one === document.body || style.outlineStyle !== "none" || Boolean(field)
    || (label && label !== "none") || one.matches("#pad");
}"""

MOST_STOPS = 120


async def go(page: Any, selector: str) -> None:
    """Go on with Tab until the element has the focus; each stop on the way is seen."""
    for _ in range(MOST_STOPS):
        await page.keyboard.press("Tab")
        assert await page.evaluate(IS_SEEN), await page.evaluate("document.activeElement.outerHTML")
        if await page.evaluate("(one) => document.activeElement.matches(one)", selector):
            return
    raise AssertionError(f"{selector} is not reached by Tab")


async def press(page: Any, selector: str, key: str = "Enter") -> None:
    await page.wait_for_selector(f"{selector}:not([disabled]):visible")
    await go(page, f"{selector}:not([disabled])")
    await page.keyboard.press(key)


async def hold(page: Any, selector: str, key: str, done: Callable[[], Awaitable[bool]]) -> None:
    """Hold it until the page has counted the second; again when that says why it was not taken."""
    problem = ""

    async def is_answered() -> bool:
        nonlocal problem
        problem = await page.inner_text("#problem")
        return bool(problem) or await done()

    for _ in again_and_again():
        await page.wait_for_selector(f"{selector}:not([disabled]):visible")
        await go(page, selector)
        await page.keyboard.down(key)
        await page.wait_for_selector(f"{selector}:not(.holding)")
        await page.keyboard.up(key)
        await until(is_answered)
        if await done():
            return
        assert any(why in problem for why in NOT_TAKEN), problem
    raise AssertionError(f"{selector} was held again and again: {problem}")


def seen(what: Callable[[], bool]) -> Callable[[], Awaitable[bool]]:
    async def is_so() -> bool:
        return what()

    return is_so


def shown(page: Any, selector: str, text: str) -> Callable[[], Awaitable[bool]]:
    async def is_so() -> bool:
        return text in await page.inner_text(selector)

    return is_so


@pytest.mark.parametrize("key", ["Space", "Enter"])
async def test_a_whole_mission_by_keyboard_alone(browser: Any, key: str) -> None:
    async with console_in_browser(browser, "--firmware", "3.1") as console:
        page, watch = await console.open(), console.watch
        await press(page, "[data-act=obtain]", key)
        await banner(page, "You have control")
        await press(page, "#ground [role=checkbox]", "Space")
        await hold(page, "[data-act=take_off]", key, seen(lambda: watch.height > 1.0))
        await page.wait_for_selector("[data-act=land]:not([disabled])")
        await go(page, "#pad")
        await hold_key(page, "w", lambda: watch.speed[1] > 0.3)
        await page.keyboard.up("w")
        await until(lambda: is_still(console))
        await page.keyboard.press("Escape")
        await press(page, "[data-go=plan]", key)
        for number in range(3):
            await press(page, "[data-plan=add]", key)
            await page.wait_for_selector(f"[data-point='{number}']")
        await press(page, "[data-act=mission_upload]", key)
        await shows(page, "#plan-uploaded", "Uploaded")
        await hold(page, "[data-act=mission_start]", key, shown(page, "#mission", "to waypoint"))
        await press(page, "[data-act=mission_stop]", key)
        await shows(page, "#mission", "no mission")
        await until(lambda: is_still(console))
        await press(page, "[data-act=stop]", key)
        await press(page, "#bar [data-go=fly]", key)
        await hold(page, "[data-act=land]", key, seen(lambda: watch.status == 1))
        await page.wait_for_function("document.querySelector('#task').textContent === ''")
        await press(page, "[data-act=release]", key)
        await banner(page, "Nobody has control")
