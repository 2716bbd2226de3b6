"""Pointing and planning in a real browser: a click is flown to, a plan is drawn, kept and flown."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest

from m100link import WaypointPlan
from m100link.geodesy import distance_m
from tests.browser.conftest import console_in_browser, until
from tests.browser.test_console import airborne, hold, is_still, look_at, press, shows

pytestmark = [pytest.mark.anyio]

PLACE_AT = """([x, y]) => {
  const {leaflet, element} = window.m100.map, box = element.getBoundingClientRect();
  const place = leaflet.containerPointToLatLng([x - box.left, y - box.top]);
  return [place.lat, place.lng];
}"""


async def on_map(page: Any, across: float, down: float) -> tuple[float, float]:
    """A point of the window beside the middle of the map."""
    await page.wait_for_function("window.m100.map?.position")
    box = await page.locator("#map").bounding_box()
    return box["x"] + box["width"] / 2 + across, box["y"] + box["height"] / 2 + down


async def position(page: Any) -> tuple[float, float]:
    latitude, longitude, _ = await page.evaluate("window.m100.map.position")
    return latitude, longitude


async def test_a_click_is_flown_to_and_a_plan_is_drawn_kept_and_flown(
    browser: Any, tmp_path: Path
) -> None:
    async with console_in_browser(browser, "--firmware", "3.1") as console:
        page = await airborne(console)
        await _click_and_fly(page)
        await _refused_beside_the_click(page)
        await look_at(page, "plan")
        await page.wait_for_selector("#plan-summary")
        await shows(page, "#plan-summary", "No points yet")
        path = await _draw_and_keep(page, tmp_path)
        await press(page, "mission_upload")
        await shows(page, "#plan-uploaded", "Uploaded")
        await hold(page, "mission_start")
        await shows(page, "#mission", "to waypoint")
        await press(page, "mission_stop")
        await shows(page, "#mission", "no mission")
        await until(lambda: is_still(console))
        await page.click("[data-plan=clear]")
        await shows(page, "#plan-summary", "No points yet")
        await page.set_input_files("#plan-file input", path)
        await shows(page, "#plan-summary", "3 waypoints")


async def _click_and_fly(page: Any) -> None:
    spot = await on_map(page, 40, -110)
    target = await page.evaluate(PLACE_AT, list(spot))
    await page.mouse.click(*spot)
    await shows(page, "#click-preview", "min")
    await hold(page, "guide", 1.6)
    await shows(page, "#guided-flying", "Flies to the point")
    await page.wait_for_selector("#guided", state="hidden")
    assert distance_m(*await position(page), *target) < 1.0


async def _refused_beside_the_click(page: Any) -> None:
    await page.click("#point-open")
    await page.fill("#click-distance", "900")
    await page.fill("#click-bearing", "90")
    await shows(page, "#click-refusals", "the envelope ends at 150 m")
    await shows(page, "#click-refusals", "Point inside")
    assert not await page.locator("[data-act=guide]").is_visible()
    await page.click("#point-close")


async def _draw_and_keep(page: Any, folder: Path) -> Path:
    for number, (across, down) in enumerate(((60, -60), (160, -60), (160, 60), (60, 60)), 1):
        spot = await on_map(page, across, down)
        await asyncio.sleep(0.3)  # two clicks at once would be a double click
        await page.mouse.click(*spot)
        await page.wait_for_selector(f"[data-point='{number - 1}']")
    await page.click("[data-plan=undo]")
    await shows(page, "#plan-summary", "3 waypoints")
    await page.click("[data-point='1']")
    await page.fill("#waypoint-height", "25")
    await page.fill("#waypoint-actions", "pitch -60, photo")
    await shows(page, "#plan-rows", "25.0 m, pitch -60, photo")
    async with page.expect_download() as download:
        await page.click("[data-plan=export_plan]")
    path = folder / "drawn.plan"
    await (await download.value).save_as(path)
    assert json.loads(path.read_text())["fileType"] == "Plan"
    plan = WaypointPlan.read(path)
    assert [one.height for one in plan.waypoints].count(25.0) == 1
    return path
