"""A mission by fingers alone, on a phone: from an empty map to the end of what was flown."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from tests.browser.boxes import faults
from tests.browser.conftest import console_in_browser, context_of
from tests.browser.operator import banner, press_until, shows

pytestmark = [pytest.mark.anyio, pytest.mark.timeout(900)]

PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}

CORNERS = ((90, -150), (90, -60), (-90, -60))
"""Points of the plan, pixels from the middle of what is seen of the map, right and down."""


class Thumb:
    """A finger that taps and holds, by Chromium's own input."""

    def __init__(self, page: Any, session: Any) -> None:
        self.page, self._session = page, session

    async def _tell(self, kind: str, *points: dict[str, float]) -> None:
        told = {"type": kind, "touchPoints": list(points)}
        await self._session.send("Input.dispatchTouchEvent", told)

    async def hold(self, page: Any, name: str) -> None:
        """Until the page has counted its second."""
        button = f"[data-act={name}]:visible"
        one = page.locator(button).first
        await one.scroll_into_view_if_needed()
        box = await one.bounding_box()
        at = {"x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2}
        await self._tell("touchStart", at)
        await page.wait_for_function(
            "(name) => !document.querySelector(`[data-act=${name}].holding`)", arg=name
        )
        await self._tell("touchEnd")

    async def hold_until(self, name: str, done: Callable[[], bool | Awaitable[bool]]) -> None:
        await press_until(self.page, name, done, self.hold)

    async def tap_map(self, across: float, down: float) -> None:
        box = await self.page.locator("#map").bounding_box()
        x, y = box["x"] + box["width"] / 2 + across, box["y"] + box["height"] / 2 + down
        await self.page.touchscreen.tap(x, y)


async def look_at(page: Any, view: str) -> None:
    await page.tap(f"#bar [data-go={view}]")


async def tap_until(page: Any, name: str, selector: str, text: str) -> None:
    async def is_shown() -> bool:
        return text in (await page.text_content(selector) or "")

    await press_until(
        page, name, is_shown, lambda page, name: page.tap(f"[data-act={name}]:visible")
    )


async def test_a_mission_by_touch_from_an_empty_map_to_the_ground(browser: Any) -> None:
    async with (
        console_in_browser(browser, "--firmware", "3.1") as console,
        context_of(browser, **PHONE) as phone,
    ):
        console.context, desk = phone, console.context
        page, watch = await console.open(), console.watch
        console.context = desk
        thumb = Thumb(page, await phone.new_cdp_session(page))
        await tap_until(page, "obtain", "#banner", "You have control")
        await _draw(page, thumb)
        await tap_until(page, "mission_upload", "#plan-uploaded", "Uploaded")
        await look_at(page, "fly")
        await page.get_by_role("checkbox", name="I have looked").tap()
        await thumb.hold_until("take_off", lambda: watch.height > 1.0)
        await page.wait_for_selector("[data-act=land]:not([disabled])")
        await look_at(page, "plan")
        assert await faults(page) == []

        async def is_under_way() -> bool:
            return "to waypoint" in await page.inner_text("#mission")

        await thumb.hold_until("mission_start", is_under_way)
        for number in (2, 3):
            await shows(page, "#mission", f"to waypoint {number} of 3")
        await shows(page, "#mission", "no mission")
        await look_at(page, "fly")
        await thumb.hold_until("land", lambda: watch.status == 1)
        await page.wait_for_function("document.querySelector('#task').textContent === ''")
        await page.tap("[data-act=release]")
        await banner(page, "Nobody has control")
        assert await page.inner_text("#problem") == ""


async def _draw(page: Any, thumb: Thumb) -> None:
    await look_at(page, "plan")
    await page.wait_for_selector("#plan-summary")
    await shows(page, "#plan-summary", "No points yet")
    await page.wait_for_function("window.m100.map?.position")
    for number, corner in enumerate(CORNERS, 1):
        await thumb.tap_map(*corner)
        await page.wait_for_selector(f"[data-point='{number - 1}']", state="attached")
        await asyncio.sleep(0.5)  # two taps at once would be a double tap
    await shows(page, "#plan-summary", "3 waypoints")
