"""The Data view, and what is left of the page when its station is gone."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.browser.boxes import faults
from tests.browser.conftest import console_in_browser, context_of, running_console
from tests.browser.operator import airborne, look_at, shows
from tests.browser.test_console import child_of

pytestmark = [pytest.mark.anyio]

READY = "window.m100?.steering && window.m100.socket.heardAt > 0"
IS_GONE = """async () => {
  try { await fetch("/sw.js", {cache: "no-store"}); return false; } catch { return true; }
}"""
KEPT = """async () => (await Promise.all((await caches.keys()).map(async (name) =>
  (await (await caches.open(name)).keys()).map((one) => new URL(one.url).pathname)))).flat()"""
CHOOSE = "localStorage.setItem('m100link.settings', JSON.stringify({language: 'de'}))"
IS_DRAWN = """() => [...document.querySelectorAll("#plots canvas")].some((canvas) => {
  const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  return data.some((value) => value !== 0);
})"""
SIZES = ((390, 844), (1024, 768), (1440, 900))


async def test_plots_are_drawn_at_once_stand_still_and_come_as_a_file(
    browser: Any, tmp_path: Path
) -> None:
    async with console_in_browser(browser) as console:
        page = await airborne(console)
        await look_at(page, "data")
        await page.wait_for_selector("#plots canvas")
        await page.wait_for_function(IS_DRAWN)
        for width, height in SIZES:
            await page.set_viewport_size({"width": width, "height": height})
            assert await faults(page) == [], (width, height)
        await page.click("#plot-pause")
        await shows(page, "#plot-pause", "Go on")
        async with page.expect_download() as download:
            await page.click("#plot-csv")
        path = tmp_path / "plots.csv"
        await (await download.value).save_as(path)
        head, *rows = (await asyncio.to_thread(path.read_text, encoding="utf-8")).splitlines()
        assert head.startswith("utc,")
        assert len({row.count(",") for row in rows}) == 1
        assert rows


@asynccontextmanager
async def left_alone(browser: Any, *options: str, choose: str = "") -> AsyncIterator[Any]:
    """A page whose station has gone, opened again."""
    async with running_console(*options) as (report, process), context_of(browser) as tabs:
        page = await tabs.new_page()
        await page.goto(report["console"])
        await page.wait_for_function(READY)
        if choose:
            await page.evaluate(choose)
        await page.wait_for_function("navigator.serviceWorker.ready.then(() => true)")
        await page.wait_for_function(
            f"({KEPT})().then((kept) => kept.includes('/console/offline.html'))"
        )
        front = child_of(process.pid)
        process.kill()
        await process.wait()
        await page.wait_for_selector("#page-lost:visible")
        with contextlib.suppress(ProcessLookupError):
            os.kill(front, signal.SIGKILL)  # by itself it would say for 5 s what is missing
        await page.wait_for_function(IS_GONE)
        await page.goto(page.url)
        yield page


@pytest.mark.parametrize(
    ("choose", "title", "todo"),
    [
        ("", "not reached", "have the pilot take over"),
        (CHOOSE, "nicht erreicht", "den Piloten übernehmen lassen"),
    ],
)
async def test_without_its_station_the_page_says_so_in_the_chosen_language_and_keeps_no_value(
    browser: Any, choose: str, title: str, todo: str
) -> None:
    async with left_alone(browser, choose=choose) as page:
        assert title in await page.title()
        said = await page.inner_text("body")
        assert todo in said
        assert not any(letter.isdigit() for letter in said), "a value was kept"
        await page.wait_for_function("document.querySelector('#tries').textContent !== ''")
        assert await page.evaluate(KEPT) == ["/console/offline.html"]


async def test_behind_a_token_there_is_an_offline_page_too(browser: Any, tmp_path: Path) -> None:
    token = tmp_path / "token"
    token.write_text("a-token-of-16-characters")
    token.chmod(0o600)
    async with left_alone(browser, "--token-file", str(token)) as page:
        assert "not reached" in await page.title()
        assert await page.evaluate(KEPT) == ["/console/offline.html"]
