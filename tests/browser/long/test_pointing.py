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
from tests.browser.operator import (
    NOT_TAKEN,
    airborne,
    hold,
    hold_until,
    in_control,
    is_still,
    look_around,
    look_at,
    press,
    shows,
)
from tests.waiting import PATIENCE

pytestmark = [pytest.mark.anyio]

# What lies under the pointer when it is pressed, as the map is drawn at that moment.
NOTE_PRESS = """() => {
  const {leaflet, element} = window.m100.map;
  element.addEventListener("pointerdown", (event) => {
    const box = element.getBoundingClientRect();
    const at = [event.clientX - box.left, event.clientY - box.top];
    const place = leaflet.containerPointToLatLng(at);
    window.pressedAt = [place.lat, place.lng];
  }, {capture: true});
}"""
MARKED = """() => {
  let found = null;
  window.m100.map.leaflet.eachLayer((one) => {
    if (one.getElement?.()?.classList?.contains("pointed")) found = one.getLatLng();
  });
  return [found.lat, found.lng];
}"""


METRES_PER_PIXEL = """() => {
  const {leaflet, position} = window.m100.map;
  return 40075016.7 * Math.cos(position[0] * Math.PI / 180) / 256 / 2 ** leaflet.getZoom();
}"""
FOLLOW_FAR = """() => {
  const {map} = window.m100, at = map.position;
  map.position = [at[0] + 0.01, at[1], at[2]];
  map.keepInSight();
  map.position = at;
}"""
PIXEL_OF = """(place) => {
  const {leaflet, element} = window.m100.map, box = element.getBoundingClientRect();
  const at = leaflet.latLngToContainerPoint(place);
  return [box.left + at.x, box.top + at.y];
}"""


async def on_map(page: Any, across: float, down: float) -> tuple[float, float]:
    """A point of the window beside the middle of the map."""
    await page.wait_for_function("window.m100.map?.position")
    box = await page.locator("#map").bounding_box()
    return box["x"] + box["width"] / 2 + across, box["y"] + box["height"] / 2 + down


async def position(page: Any) -> tuple[float, float]:
    latitude, longitude, _ = await page.evaluate("window.m100.map.position")
    return latitude, longitude


async def beside_aircraft(page: Any, across: float, down: float) -> tuple[float, float]:
    """A point of the window beside the aircraft, which need not be in the middle of the map."""
    x, y = await page.evaluate(PIXEL_OF, list(await position(page)))
    return x + across, y + down


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

        async def is_under_way() -> bool:
            return "to waypoint" in await page.inner_text("#mission")

        await hold_until(page, "mission_start", is_under_way)
        await press(page, "mission_stop")
        await shows(page, "#mission", "no mission")
        await until(lambda: is_still(console))
        await page.click("[data-plan=clear]")
        await shows(page, "#plan-summary", "No points yet")
        await page.set_input_files("#plan-file", path)
        await shows(page, "#plan-summary", "3 waypoints")


async def _click_and_fly(page: Any) -> None:
    await on_map(page, 0, 0)
    await page.evaluate(NOTE_PRESS)
    spot = await on_map(page, 40, -110)
    await page.mouse.move(*spot)
    await page.mouse.down()
    target = await page.evaluate("window.pressedAt")
    # It would follow to somewhere else, but not under a finger that is about to point.
    await page.evaluate(FOLLOW_FAR)
    await page.mouse.up()
    await shows(page, "#click-preview", "min")
    await page.wait_for_selector(".point.pointed")
    assert distance_m(*await page.evaluate(MARKED), *target) < 0.4  # a pixel
    await _confirm_until_there(page, target)


async def _confirm_until_there(page: Any, target: tuple[float, float]) -> None:
    """Hold until it flew there; a flight that something cut short says what."""
    while True:
        await hold(page, "guide", 1.6)
        await page.wait_for_function(
            "document.querySelector('#guided-flying')?.textContent.includes('Flight to the point')"
            " || document.querySelector('#problem')?.textContent"
        )
        await page.wait_for_function(
            "/reached|ended|refused/.test(document.querySelector('#guided-flying').textContent)"
            " || document.querySelector('#problem')?.textContent"
        )
        if distance_m(*await position(page), *target) < 1.0:
            return
        told = await page.inner_text("#problem") + await page.inner_text("#guided-flying")
        assert "the aircraft hovers" in told or any(why in told for why in NOT_TAKEN)
        if "You have control" not in await page.inner_text("#banner"):
            await press(page, "obtain")
            await shows(page, "#banner", "You have control")
        if not await page.locator("#click").is_visible():
            spot = await page.evaluate(PIXEL_OF, list(target))
            await page.mouse.click(*spot)
        await page.wait_for_selector("[data-act=guide]:visible")


async def drag(page: Any, selector: str, across: float, down: float) -> None:
    box = await page.locator(selector).bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    await page.mouse.move(x, y)
    await page.mouse.down()
    await page.mouse.move(x + across, y + down, steps=6)
    await page.mouse.up()


async def test_handles_on_the_map_set_radius_and_heading_with_control(
    browser: Any,
) -> None:
    async with console_in_browser(browser, "--firmware", "3.1") as console:
        page = await airborne(console)
        await page.mouse.click(*await on_map(page, 80, -60))
        await page.click("[data-kind=circle]")
        await page.wait_for_selector(".point.handle.radius")
        await drag(page, ".point.handle.radius", 40, 0)
        await page.wait_for_function("Number(document.querySelector('#click-radius').value) > 25")
        radius = float(await page.input_value("#click-radius"))
        assert radius == pytest.approx(15 + 40 * await page.evaluate(METRES_PER_PIXEL), abs=2.0)
        await page.click("[data-kind=heading]")
        await page.wait_for_selector(".point.handle.radius", state="detached")
        await page.wait_for_selector(".point.handle.yaw")  # at 0°, ahead of the aircraft
        ahead = 30.0 / await page.evaluate(METRES_PER_PIXEL)
        await drag(page, ".point.handle.yaw", ahead, ahead)  # from ahead of it to its right
        await page.wait_for_function("Number(document.querySelector('#click-yaw').value) > 20")
        assert float(await page.input_value("#click-yaw")) == pytest.approx(90, abs=4)
        await press(page, "release")
        await page.wait_for_selector(".point.handle.yaw", state="detached")


async def test_a_hold_flies_nothing_when_the_point_changed_meanwhile(browser: Any) -> None:
    async with console_in_browser(browser, "--firmware", "3.1") as console:
        page = await airborne(console)
        before = await position(page)
        await page.mouse.click(*await on_map(page, 40, -110))
        await shows(page, "#click-preview", "min")
        box = await page.locator("[data-act=guide]").bounding_box()
        await page.mouse.move(box["x"] + 10, box["y"] + 10)
        await page.mouse.down()
        # As an event that was long on its way, or a second hand on the map.
        place = [before[0] + 0.0003, before[1]]
        await page.evaluate("(place) => emitEvent('map_pointed', {view: 'fly', place})", place)
        await asyncio.sleep(1.8)
        await page.mouse.up()
        await shows(page, "#problem", "the point changed while the button was held")
        assert is_still(console)
        assert distance_m(*await position(page), *before) < 1.0
        await _confirm_until_there(page, (place[0], place[1]))


async def _refused_beside_the_click(page: Any) -> None:
    await page.click("#point-open")
    await page.fill("#click-distance", "900")
    await page.fill("#click-bearing", "90")
    await shows(page, "#click-refusals", "the envelope ends at 150 m")
    await shows(page, "#click-refusals", "Point inside")
    assert not await page.locator("[data-act=guide]").is_visible()
    await page.click("#point-close")


async def _draw_and_keep(page: Any, folder: Path) -> Path:
    # 0.28 m for each pixel: inside of the envelope, wherever the aircraft has flown to before.
    for number, (across, down) in enumerate(((60, 20), (160, 20), (160, 120), (60, 120)), 1):
        spot = await beside_aircraft(page, across, down)
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


async def test_a_plan_takes_off_flies_an_orbit_and_lands(browser: Any) -> None:
    async with console_in_browser(browser, "--firmware", "3.1") as console:
        page = await console.open()
        await in_control(page)
        await look_around(page)
        await look_at(page, "plan")
        await page.click("[data-plan=area]")
        await page.mouse.click(*await on_map(page, 40, -60))
        await page.wait_for_selector(".waypoint.corner")
        await page.fill("#survey-radius", "8")
        await page.fill("#survey-height", "9")
        await page.locator("label:has(#plan-at_end)").click()
        await page.get_by_role("option", name="land", exact=True).click()
        await page.click("[data-plan=orbit]")
        await shows(page, "#plan-summary", "25 waypoints")
        await shows(page, "#plan-summary", "at the end: land")
        await press(page, "mission_upload")
        await shows(page, "#plan-uploaded", "takes off first")
        summary = await page.inner_text("#plan-summary")
        assert await page.inner_text("#plan") == summary
        await hold_until(page, "mission_start", lambda: console.watch.height > 5.0)
        await shows(page, "#mission", "to waypoint")
        await until(lambda: console.watch.height < 0.3, within=4 * PATIENCE)
        await shows(page, "#mission", "no mission")
