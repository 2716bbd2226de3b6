"""A recorded flight in a browser: it is said to be one, is moved, and nobody can fly it."""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mcap", reason="the extra `log` is not installed")

from m100link import connect
from tests.browser.conftest import context_of, playwright
from tests.waiting import PATIENCE

expect = playwright.expect

pytestmark = pytest.mark.anyio


async def test_a_replay_is_said_to_be_one_is_moved_and_offers_no_control(
    browser: Any, tmp_path: Path
) -> None:
    path = tmp_path / "a flight.mcap"
    async with connect("sim://?seed=3", record=path):
        await asyncio.sleep(4)
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "m100link", "replay", str(path), "--json", "--no-open-browser"),
        *("--port", "0", "--console-port", "0"),
        stdout=asyncio.subprocess.PIPE,
    )
    assert process.stdout is not None
    try:
        async with asyncio.timeout(PATIENCE):
            report = json.loads(await process.stdout.readline())
        async with context_of(browser) as context:
            page = await context.new_page()
            errors: list[object] = []
            page.on("pageerror", lambda error: errors.append(error))
            await page.goto(report["console"])
            title = page.locator("#replay-title")
            await title.wait_for(state="visible")
            assert await title.inner_text() == "REPLAY a flight.mcap"
            assert "nothing flies" in await page.inner_text("#replay")
            for hidden in ("stop", "obtain", "take_off", "land"):
                assert not await page.is_visible(f"[data-act={hidden}]"), hidden
            for hidden in ("#pad", "[data-go=plan]", "[data-go=check]"):
                assert not await page.is_visible(hidden), hidden
            # At its end it stands; from its beginning it goes on, until it is paused.
            note, place = page.locator("#replay-note"), page.locator("#replay-place")
            await expect(note).to_have_text("at its end", timeout=1000 * PATIENCE)
            await asyncio.sleep(3.0)
            assert not await page.is_visible("#page-lost"), "the page is heard while time stands"
            await page.click("[data-replay=back]")
            await expect(place).to_contain_text("0:00 of")
            await page.click("[data-replay=toggle]")
            await expect(page.locator("[data-replay=toggle]")).to_have_text("Play")
            before = await place.inner_text()
            await asyncio.sleep(0.7)
            assert await place.inner_text() == before
            await page.click("[data-replay=on]")
            await expect(place).to_contain_text("0:04 of")
            assert errors == []
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.terminate()
        async with asyncio.timeout(PATIENCE):
            assert await process.wait() == 0
