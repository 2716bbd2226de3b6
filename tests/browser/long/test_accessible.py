"""Every view in every look as axe-core reads it."""

from __future__ import annotations

from typing import Any

import pytest

from m100link.apps.station.console.page import VIEWS
from m100link.apps.station.console.view.texts import Theme
from tests.browser.conftest import Console
from tests.browser.operator import airborne, look_at, press, shows
from tests.browser.test_accessible import violations

pytestmark = [pytest.mark.anyio]

LOOKS = [theme.value for theme in Theme if theme is not Theme.AUTO]


async def choose_look(page: Any, look: str) -> None:
    """As it was chosen before, in this browser."""
    await page.evaluate(
        "(look) => localStorage.setItem('m100link.settings', JSON.stringify({theme: look}))", look
    )
    await page.reload()
    await page.wait_for_function("window.m100?.steering && window.m100.socket.heardAt > 0")
    expected = {"light": "body--light:not(.sun)", "dark": "body--dark", "sun": "sun"}[look]
    await page.wait_for_selector(f"body.{expected}")


@pytest.mark.parametrize("look", LOOKS)
async def test_axe_finds_nothing_on_any_view(console: Console, look: str) -> None:
    page = await console.open()
    await choose_look(page, look)
    found = {}
    for view in VIEWS:
        await look_at(page, view)
        await page.wait_for_selector(f"section[data-view={view}] > *:visible")
        if view == "plan":
            await page.click("[data-plan=add]")
            await page.wait_for_selector("[data-point='0']")
        if broken := await violations(page):
            found[view] = broken
    await look_at(page, "settings")
    await page.get_by_label("battery, %").fill("15")
    await shows(page, "[data-alarm=battery_low]", "Battery 15 %")
    if broken := await violations(page):
        found["alarm"] = broken
    assert found == {}


@pytest.mark.parametrize("look", LOOKS)
async def test_axe_finds_nothing_on_the_question_to_take_over(console: Console, look: str) -> None:
    await airborne(console)
    page = await console.open()
    await choose_look(page, look)
    await press(page, "obtain")
    await page.wait_for_selector("#take-over")
    assert await violations(page) == []
