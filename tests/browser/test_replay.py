"""A recorded flight in a browser: it is said to be one, is moved, and nobody can fly it."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import sys
from collections.abc import AsyncIterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mcap", reason="the extra `log` is not installed")

from m100link import Credentials, connect
from m100link.log import read
from m100link.log.story import FlightPath, FlightSummary, read_story
from tests.browser.conftest import context_of, playwright
from tests.log.flight import APP_ID, KEY, URL
from tests.waiting import PATIENCE

expect = playwright.expect

pytestmark = pytest.mark.anyio

# The longest line between two points that is drawn as flown, m, and home.
RUNS = """() => {
  const far = (one, other) => m100.map.leaflet.distance(one, other);
  const lines = m100.map.runs.map((run) => run.getLatLngs());
  const steps = lines.flatMap((line) => line.slice(1).map((at, i) => far(line[i], at)));
  return {longest: Math.max(0, ...steps), home: m100.map.home};
}"""


@contextlib.asynccontextmanager
async def replayed(browser: Any, path: Path) -> AsyncIterator[Any]:
    """A page of a replay, which raises no error and opens no other port."""
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "m100link", "replay", str(path), "--json", "--no-open-browser"),
        *("--console-port", "0"),
        stdout=asyncio.subprocess.PIPE,
    )
    assert process.stdout is not None
    try:
        async with asyncio.timeout(PATIENCE):
            report = json.loads(await process.stdout.readline())
        assert "rosbridge" not in report
        async with context_of(browser) as context:
            page = await context.new_page()
            errors: list[object] = []
            page.on("pageerror", lambda error: errors.append(error))
            await page.goto(report["console"])
            yield page
            assert errors == []
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.terminate()
        async with asyncio.timeout(PATIENCE):
            assert await process.wait() == 0


async def check_track(page: Any, flight: FlightPath) -> None:
    # The whole track and home are there at once, and each piece of it is the file's.
    await page.wait_for_function("window.m100?.map?.track.length > 5")
    await page.wait_for_function("m100.map.home !== null")
    await page.click("[data-replay=on]")
    for place in (0.2, 0.7, 0.4):
        await page.evaluate(f"m100.map.leaflet && window.scrollTo(0, {place})")
        await page.locator("#replay-slider").click(position={"x": 80 * place, "y": 5})
        await asyncio.sleep(0.6)
    drawn = await page.evaluate(RUNS)
    far = max(math.dist(one[1:3], other[1:3]) for one, other in pairwise(flight.track.places()))
    assert drawn["longest"] <= far + 0.5, "no line that was never flown"
    home = flight.homes[0]
    assert drawn["home"] == pytest.approx([home.latitude_deg, home.longitude_deg], abs=1e-6)
    assert await page.locator("#alarms li:visible").count() == 0


async def check_moves(page: Any) -> None:
    # At its end it stands; from its beginning it goes on, until it is paused.
    note, place = page.locator("#replay-note"), page.locator("#replay-place")
    await expect(note).to_have_text("at its end", timeout=1000 * PATIENCE)
    await asyncio.sleep(3.0)
    assert not await page.is_visible("#page-lost"), "the page is heard while time stands"
    await page.click("[data-replay=back]")
    await page.click("[data-replay=toggle]")
    await expect(page.locator("[data-replay=toggle]")).to_have_text("Play")
    for _ in range(2):  # it may have gone on for more than ten seconds before it was paused
        await page.click("[data-replay=back]")
    await expect(place).to_contain_text("0:00 of")
    before = await place.inner_text()
    await asyncio.sleep(0.7)
    assert await place.inner_text() == before
    await page.click("[data-replay=on]")
    await expect(place).to_contain_text("0:10 of")


async def check_jumps(page: Any, story: FlightSummary) -> None:
    place, flight = page.locator("#replay-place"), story.path
    # A press on an event moves it there; the cursor stands in every plot.
    await page.click("[data-go=events]")
    event = page.locator("#events .jump", has_text="take_off").first
    await event.click()
    begun = flight.homes[0].at_s
    await expect(place).to_contain_text(f"0:{int(begun):02d} of", timeout=1000 * PATIENCE)
    await page.click("[data-go=data]")
    await page.wait_for_selector("#plots[data-cursor]")
    at = float(await page.get_attribute("#plots", "data-cursor") or 0.0) / 1000.0
    assert 0.0 < at - (story.began_utc or 0.0) <= story.duration_s


async def test_a_replay_is_said_to_be_one_is_moved_and_offers_no_control(
    browser: Any, tmp_path: Path
) -> None:
    path = tmp_path / "a flight.mcap"
    async with connect(URL, record=path) as aircraft:
        await aircraft.activate(Credentials(app_id=APP_ID, key=KEY))
        async with aircraft.control() as control:
            await control.take_off()
            await control.fly_to(north=4.0, east=-3.0, up=1.0)
            await control.land()
    story = read_story(read(path))
    async with replayed(browser, path) as page:
        title = page.locator("#replay-title")
        await title.wait_for(state="visible")
        assert await title.inner_text() == "REPLAY a flight.mcap"
        assert "nothing flies" in await page.inner_text("#replay")
        for hidden in ("stop", "obtain", "take_off", "land"):
            assert not await page.is_visible(f"[data-act={hidden}]"), hidden
        for hidden in ("#pad", "[data-go=plan]", "[data-go=check]"):
            assert not await page.is_visible(hidden), hidden
        await check_track(page, story.path)
        await check_moves(page)
        await check_jumps(page, story)
