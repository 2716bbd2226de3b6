"""What the operator learns: seen, heard, acknowledged, kept; and take-off by the checklist."""

from __future__ import annotations

import asyncio
import csv
from pathlib import Path
from typing import Any

import pytest

from tests.browser.conftest import Console
from tests.browser.operator import banner, hold, look_at, press, press_for, press_until, shows

pytestmark = [pytest.mark.anyio]


async def heard(page: Any, level: str) -> None:
    await page.wait_for_function("(level) => window.m100.heard?.level === level", arg=level)


async def set_virtual(page: Any, label: str, value: int) -> None:
    """Change the virtual aircraft by its panel."""
    await look_at(page, "settings")
    await page.get_by_label(label).fill(str(value))


async def test_an_alarm_is_seen_heard_acknowledged_and_kept(console: Console) -> None:
    page = await console.open()
    await set_virtual(page, "battery, %", 20)
    alarm = "[data-alarm=battery_low]"
    await page.wait_for_selector(f"{alarm}.raised.warning:visible")
    await shows(page, alarm, "Battery 20 %: land soon")
    await shows(page, "#alarm-loud", "land soon")  # for an operator who looks away
    await heard(page, "warning")
    await page.wait_for_function("window.m100.heard.beeps > 0")
    # Once, whatever else there is to say on a busy machine: that nobody was heard for a second.
    spoken = await page.evaluate("window.m100.heard.spoken")
    assert spoken.count("Battery 20 %: land soon") == 1
    await page.get_by_role("button", name="Acknowledge: Battery 20 %").click()
    await page.wait_for_selector(f"{alarm}.acknowledged")
    await heard(page, "")
    await set_virtual(page, "battery, %", 90)
    await page.wait_for_selector(alarm, state="hidden")
    await look_at(page, "events")
    for text in ("Alarm: Battery 20 %", "Acknowledged:", "Over: Battery 20 %"):
        await shows(page, "#events", text)
    await page.get_by_label("Words to find").fill("over battery")
    await page.wait_for_function("document.querySelectorAll('#events > *').length === 1")
    async with page.expect_download() as download:
        await page.click("[data-save=csv]")
    saved = await (await download.value).path()
    text = await asyncio.to_thread(Path(saved).read_text, encoding="utf-8")
    [row] = csv.DictReader(text.splitlines())
    assert (row["source"], row["level"]) == ("page", "info")


async def test_sound_that_the_browser_blocks_is_reported_until_it_is_allowed(
    console: Console,
) -> None:
    # Nobody has touched the page yet. What playwright evaluates counts as a touch, so it is hidden.
    page = await console.open(
        "Object.defineProperty(navigator, 'userActivation', {value: {hasBeenActive: false}})"
    )
    await page.evaluate("document.querySelector('#alarm-sound').dataset.level = 'danger'")
    await page.wait_for_selector("#sound-blocked:visible")
    await page.click("#allow-sound")
    await page.wait_for_selector("#sound-blocked", state="hidden")
    await page.wait_for_function("window.m100.heard.beeps > 0")


async def test_take_off_needs_a_green_checklist_or_a_reason(console: Console) -> None:
    page = await console.open()
    await set_virtual(page, "GPS health", 2)
    await look_at(page, "check")
    take_off = "[data-act=take_off]"
    await shows(page, "#check-summary", "would refuse")
    await press(page, "obtain")
    await page.wait_for_selector("[data-check=activation].right")
    await page.wait_for_selector("[data-check=control].right")
    await page.get_by_role("checkbox", name="I have looked").click()
    await page.wait_for_selector("[data-check=free].right")
    await shows(page, "#check-summary", "Not passed")
    await shows(page, "[data-check=gps].wrong", "2 of 5")
    assert await page.locator(take_off).is_disabled()
    await page.get_by_label("Why do you take off").fill("a test of weak GPS")
    await page.wait_for_selector(f"{take_off}:not([disabled])")

    await press_until(page, "take_off", lambda: console.watch.height > 0.5, hold)
    await look_at(page, "events")
    await shows(page, "#events", "takes off despite failed checks: GPS")
    await shows(page, "#events", "Reason: a test of weak GPS")
    await page.wait_for_selector("[data-alarm=gps].raised")
    await look_at(page, "check")
    assert not await page.get_by_role(
        "checkbox", name="I have looked"
    ).is_checked()  # the next one is another


async def test_what_was_chosen_is_kept_by_the_browser(console: Console) -> None:
    page = await console.open()
    await look_at(page, "settings")
    await page.get_by_label("Language").click()
    await page.get_by_role("option", name="Deutsch").click()
    await page.get_by_label("Höhen und Längen").click()
    await page.get_by_role("option", name="ft").click()
    await page.get_by_label("Ihr Name").fill("Anna")
    # It goes by the station, which takes its time on a busy machine.
    await page.wait_for_function("localStorage.getItem('m100link.settings')?.includes('Anna')")
    await banner(page, "nicht aktiviert")
    await page.reload()
    await banner(page, "nicht aktiviert")
    assert await page.evaluate("document.documentElement.lang") == "de"
    await look_at(page, "check")
    await shows(page, "[data-check=guards]", "164 ft hoch")
    await look_at(page, "fly")
    other = await console.open()
    await press_for(page, "obtain", "#banner", "Sie haben die Steuerung")
    await banner(other, "Anna hat die Steuerung")
