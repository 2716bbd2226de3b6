"""Boxes in every state, at every size, dark and light: STOP is hit, nothing lies over anything."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from tests.browser.boxes import SIZES, faults
from tests.browser.conftest import Console, until
from tests.browser.operator import airborne, look_at, press

pytestmark = [pytest.mark.anyio]


async def flying(console: Console) -> Any:
    """In the air, a key held."""
    page = await airborne(console)
    await page.click("#pad")
    await page.keyboard.down("w")
    return page


async def refused(console: Console) -> Any:
    """The longest problem that is easily had: an activation that was refused."""
    page = await console.open()
    await look_at(page, "settings")
    await page.click("#sim-refuse")
    await page.wait_for_selector("#sim-refuse[aria-checked=true]")
    await look_at(page, "fly")
    await press(page, "obtain")
    await page.wait_for_selector("#problem:not(:empty)")
    return page


async def asked(console: Console) -> Any:
    """The question whether to take over."""
    await airborne(console)
    second = await console.open()

    async def is_asked() -> bool:
        if not await second.locator("#take-over").is_visible():
            await press(second, "obtain")  # again, where a busy page was loaded anew meanwhile
            await second.wait_for_timeout(2000)
        return bool(await second.locator("#take-over").is_visible())

    await until(is_asked)
    await second.wait_for_timeout(600)  # it comes with a movement
    return second


async def heading_up(console: Console) -> Any:
    page = await console.open()
    await page.click("[data-map=turn]")
    return page


async def typing(console: Console) -> Any:
    """A name is typed: on a phone the keyboard takes half of the page."""
    page = await console.open()
    await look_at(page, "settings")
    await page.locator("#name").focus()
    return page


STATES: tuple[Callable[[Console], Awaitable[Any]], ...] = (
    flying,
    refused,
    asked,
    heading_up,
    typing,
)


@pytest.mark.parametrize("state", STATES)
async def test_in_this_state(console: Console, state: Callable[[Console], Awaitable[Any]]) -> None:
    page = await state(console)
    found: dict[str, list[str]] = {}
    for scheme in ("light", "dark"):
        await page.emulate_media(color_scheme=scheme)
        for width, height in SIZES:
            shown = height if state is not typing or width > 800 else height * 55 // 100
            await page.set_viewport_size({"width": width, "height": shown})
            seen = await faults(page)
            if seen:
                found[f"{scheme}, {width} x {shown}"] = seen
    assert found == {}


async def test_the_station_that_is_lost(console: Console) -> None:
    page = await console.open()
    await page.evaluate("m100.socket.connect = () => {}; m100.socket.socket.close()")
    await page.wait_for_selector("body.station-lost")
    await page.evaluate(
        "() => { window.socket.io.reconnection(false); window.socket.disconnect(); }"
    )
    await press(page, "stop")
    await page.wait_for_selector("#unanswered:visible")  # what the header has to say at most
    found = {}
    for width, height in SIZES:
        await page.set_viewport_size({"width": width, "height": height})
        if seen := await faults(page):
            found[f"{width} x {height}"] = seen
    assert found == {}


@pytest.mark.parametrize("scheme", ["light", "dark"])
async def test_every_view(console: Console, scheme: str) -> None:
    page = await console.open()
    await page.emulate_media(color_scheme=scheme)
    found: dict[str, list[str]] = {}
    for view in ("fly", "plan", "check", "events", "settings", "data"):
        await look_at(page, view)
        await page.wait_for_selector(f"section[data-view={view}] > *", state="attached")
        for width, height in SIZES:
            await page.set_viewport_size({"width": width, "height": height})
            seen = await faults(page)
            if seen:
                found[f"{view} at {width} x {height}"] = seen
    assert found == {}
