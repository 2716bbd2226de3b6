"""Every alarm in a browser: raised by what causes it, seen, sounded, spoken, announced, known."""

from __future__ import annotations

from typing import Any

import pytest

from m100link import Waypoint, WaypointPlan
from m100link.station.console.view.alarms import ALARMS, AlarmName
from tests.browser.conftest import Console, console_in_browser, until
from tests.browser.operator import airborne, banner, hold_until, look_at, press, shows

pytestmark = [pytest.mark.anyio, pytest.mark.timeout(900)]

N = AlarmName
LEVELS = {one.name: one.level.value for one in ALARMS}

IN_FLIGHT = (N.GPS, N.GUARD_NEAR, N.BATTERY_LOW, N.BATTERY_FLOOR)
WHILE_IT_LANDS = (N.BATTERY_CRITICAL, N.LANDS_ITSELF)
IN_A_MISSION = (N.AUTHORITY_LOST, N.MISSION_ABORTED)
OF_LEASE_AND_LINE = (N.LEASE_TAKEN, N.LINK_OLD, N.LINK_LOST)

# What a screen reader was given to say at once, all of it.
LISTEN = """() => {
  const loud = document.querySelector("#alarm-loud");
  window.announced = [];
  new MutationObserver(() => window.announced.push(loud.textContent))
    .observe(loud, {childList: true, characterData: true, subtree: true});
}"""

IS_TOLD = """([name, text]) => {
  const said = (texts) => texts.some((one) => one.includes(text));
  return document.querySelector(`[data-alarm=${name}] .what`).textContent.includes(text)
    && said(window.announced) && said(window.m100.heard.spoken);
}"""

IS_KNOWN = """(name) => {
  const one = document.querySelector(`[data-alarm=${name}]`);
  return one.matches(".acknowledged") || !one.checkVisibility();
}"""


def test_every_alarm_is_among_them() -> None:
    groups = (IN_FLIGHT, WHILE_IT_LANDS, IN_A_MISSION, OF_LEASE_AND_LINE)
    assert {name for group in groups for name in group} == set(AlarmName)


async def told(page: Any, name: AlarmName, text: str) -> None:
    """It is seen, announced, spoken, and something sounds."""
    alarm = f"[data-alarm={name.value}]"
    await page.wait_for_selector(f"{alarm}.raised.{LEVELS[name]}:visible")
    await page.wait_for_function(IS_TOLD, arg=[name.value, text])
    beeps = await page.evaluate("window.m100.heard.beeps")
    await page.wait_for_function(
        "(beeps) => window.m100.heard.level !== '' && window.m100.heard.beeps > beeps", arg=beeps
    )


async def acknowledge(page: Any, name: AlarmName) -> None:
    await page.click(f"[data-see={name.value}]")
    await page.wait_for_function(IS_KNOWN, arg=name.value)


async def over(page: Any, name: AlarmName) -> None:
    await page.wait_for_selector(f"[data-alarm={name.value}]", state="hidden")


async def silent(page: Any) -> None:
    await page.wait_for_function("window.m100.heard.level === ''")


async def set_number(page: Any, label: str, value: int) -> None:
    """Of the panel of the virtual aircraft."""
    await look_at(page, "settings")
    await page.get_by_label(label).fill(str(value))


async def written(page: Any, *names: AlarmName) -> None:
    """Each stands in the events, with its acknowledgement."""
    await look_at(page, "events")
    for name in names:
        text = await page.evaluate(
            "(name) => document.querySelector(`[data-alarm=${name}] .what`).textContent", name.value
        )
        said = text.removesuffix(" (over)")
        await shows(page, "#events", f"Alarm: {said}")
        await shows(page, "#events", f"Acknowledged: {said}")


async def climb(page: Any, height: int) -> None:
    """By the panel beside the map; done when it has begun."""
    await look_at(page, "fly")
    await page.click("#point-open")
    await page.click("[data-wish=height]")
    await page.fill("#click-height", str(height))
    await shows(page, "#click-preview", f"{height}")

    async def is_under_way() -> bool:
        return bool(await page.locator("#guided").is_visible())

    await hold_until(page, "guide", is_under_way)


async def test_what_can_go_wrong_in_flight(console: Console) -> None:
    page = await airborne(console)
    await page.evaluate(LISTEN)
    await set_number(page, "GPS health", 2)
    await told(page, N.GPS, "GPS is weak")
    await acknowledge(page, N.GPS)
    await silent(page)
    await set_number(page, "GPS health", 5)
    await over(page, N.GPS)
    await climb(page, 47)
    await told(page, N.GUARD_NEAR, "high of 50 m")
    await acknowledge(page, N.GUARD_NEAR)
    for charge, name, text in (
        (25, N.BATTERY_LOW, "Battery 25 %: land soon"),
        (19, N.BATTERY_FLOOR, "below 20 % the station does not steer"),
    ):
        await set_number(page, "battery, %", charge)
        await told(page, name, text)
        await acknowledge(page, name)
        await silent(page)
    await written(page, *IN_FLIGHT)
    await set_number(page, "battery, %", 10)
    await told(page, N.BATTERY_CRITICAL, "Battery 10 %: the aircraft is about to land")
    await told(page, N.LANDS_ITSELF, "lands by itself: the battery is nearly empty")
    for name in WHILE_IT_LANDS:
        await acknowledge(page, name)
    await silent(page)
    await until(lambda: console.watch.status in (1, 4))  # it stands, or lands
    await written(page, *WHILE_IT_LANDS)


async def test_a_pilot_who_takes_it_out_of_a_mission(browser: Any) -> None:
    async with console_in_browser(browser, "--firmware", "3.1") as console:
        page = await airborne(console)
        await page.evaluate(LISTEN)
        places = [(22.5435, 113.9589), (22.5435, 113.9593), (22.5431, 113.9593)]
        plan = WaypointPlan([Waypoint(*place, height=6) for place in places], speed=3)
        await look_at(page, "plan")
        file = {"name": "plan.json", "mimeType": "application/json"}
        await page.set_input_files("#plan-file", file | {"buffer": plan.to_json().encode()})
        await shows(page, "#plan-summary", "3 waypoints")
        await press(page, "mission_upload")
        await shows(page, "#plan", "3 waypoints")

        async def is_under_way() -> bool:
            return "to waypoint" in await page.inner_text("#mission")

        await hold_until(page, "mission_start", is_under_way)
        await look_at(page, "settings")
        await page.click("#sim-mode >> text=P")
        await told(page, N.AUTHORITY_LOST, "The pilot took control with the mode switch")
        await told(page, N.MISSION_ABORTED, "the pilot moved the mode switch out of F")
        for name in IN_A_MISSION:
            await acknowledge(page, name)
        await silent(page)
        await written(page, *IN_A_MISSION)
        await look_at(page, "settings")
        await page.click("#sim-mode >> text=F")
        await over(page, N.AUTHORITY_LOST)
        await banner(page, "You have control")


async def test_who_takes_over_and_a_line_that_ends(console: Console) -> None:
    page = await airborne(console)
    await page.evaluate(LISTEN)
    other = await console.open()
    await press(other, "obtain")
    await other.click("#confirm")
    await banner(other, "You have control")
    await told(page, N.LEASE_TAKEN, "console 2 took control from you")
    await acknowledge(page, N.LEASE_TAKEN)
    await over(page, N.LEASE_TAKEN)
    await other.close()
    await silent(page)
    await look_at(page, "settings")
    await page.click("#sim-stall")
    await told(page, N.LINK_OLD, "The aircraft is silent")
    await page.click("#sim-stall")
    await acknowledge(page, N.LINK_OLD)
    await over(page, N.LINK_OLD)
    await page.click("#sim-plug")
    await told(page, N.LINK_LOST, "The line to the aircraft is lost")
    await acknowledge(page, N.LINK_LOST)
    await silent(page)
    await page.click("#sim-plug")
    await over(page, N.LINK_LOST)
    await written(page, *OF_LEASE_AND_LINE)
