"""Every alarm in a browser: raised by what causes it, seen, sounded, spoken, announced, known."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from m100link import Waypoint, WaypointPlan
from m100link.apps.station.console.view.alarms import ALARMS, AlarmName
from m100link.sim.orders import perform
from m100link.sim.virtual import VirtualAircraft
from tests.browser.conftest import Console, context_of, until
from tests.browser.long.test_disturbances import Line, console_of
from tests.browser.operator import banner, hold_until, in_control, look_at, press, press_for, shows

pytestmark = [pytest.mark.anyio, pytest.mark.timeout(900)]

N = AlarmName
PLACES = ((22.5435, 113.9589), (22.5435, 113.9593), (22.5431, 113.9593))
PLAN = WaypointPlan([Waypoint(*place, height=6) for place in PLACES], speed=3)

LEVELS = {one.name: one.level.value for one in ALARMS}

TEXTS = {
    N.GPS: "GPS is weak",
    N.BATTERY_LOW: "Battery 25 %: land soon",
    N.BATTERY_CRITICAL: "Battery 10 %: the aircraft is about to land",
    N.LANDS_ITSELF: "lands by itself: the battery is nearly empty",
    N.GUARD_NEAR: "of 50 m",
    N.BATTERY_FLOOR: "below 20 % the station does not steer",
    N.LEASE_TAKEN: "console 2 took control from you",
    N.AUTHORITY_LOST: "The pilot took control with the mode switch",
    N.MISSION_ABORTED: "the pilot moved the mode switch out of F",
    N.LINK_OLD: "The aircraft is silent",
    N.LINK_LOST: "The link to the aircraft is lost",
}

WITHOUT_CONTROL = (N.GPS, N.BATTERY_LOW, N.BATTERY_CRITICAL, N.LANDS_ITSELF)
WITH_CONTROL = (N.GUARD_NEAR, N.BATTERY_FLOOR, N.LEASE_TAKEN)
IN_A_MISSION = (N.AUTHORITY_LOST, N.MISSION_ABORTED)
OF_THE_LINE = (N.LINK_OLD, N.LINK_LOST)

# What was seen of each alarm, and what a screen reader was given to say at once: a busy page may
# show for a moment only what comes before something worse.
LISTEN = """
window.announced = [];
window.seen = {};
const listen = () => {
  const loud = document.querySelector("#alarm-loud"), list = document.querySelector("#alarms");
  if (!loud || !list) return setTimeout(listen, 20);
  const note = () => {
    if (loud.textContent) window.announced.push(loud.textContent);
    for (const one of list.querySelectorAll(".alarm.raised"))
      if (one.checkVisibility())
        (window.seen[one.dataset.alarm] ??= []).push(`${one.className} ${one.textContent}`);
  };
  const what = {childList: true, characterData: true, attributes: true, subtree: true};
  for (const one of [loud, list]) new MutationObserver(note).observe(one, what);
  note();
};
listen();
"""

IS_TOLD = """([name, level, text]) => {
  const said = (texts) => texts?.some((one) => one.includes(text));
  return said(window.seen[name]?.filter((one) => one.includes(level)))
    && said(window.announced) && said(window.m100.heard.spoken);
}"""

IS_WRITTEN = """([what, text]) => [...document.querySelectorAll("#events > *")]
  .some((one) => one.textContent.includes(what) && one.textContent.includes(text))"""

IS_KNOWN = """(name) => {
  const one = document.querySelector(`[data-alarm=${name}]`);
  return one.matches(".acknowledged") || !one.checkVisibility();
}"""


def test_every_alarm_is_among_them() -> None:
    groups = (WITHOUT_CONTROL, WITH_CONTROL, IN_A_MISSION, OF_THE_LINE)
    # Telemetry that cannot be true is flown without a browser, in test_alarms_in_flight.py.
    seen = {name for group in groups for name in group} | {N.NAVIGATION}
    assert seen == set(AlarmName)


@asynccontextmanager
async def in_flight(browser: Any, height: float = 1.1) -> AsyncIterator[tuple[Console, Line, Any]]:
    """An aircraft that the pilot has flown up, and a page that looks at it."""
    line = Line(VirtualAircraft(seed=5, firmware="3.1"))
    line.start()
    line.aircraft.pilot_takes_off()
    await until(lambda: line.aircraft.height > 1.1)
    if height > 2.0:
        perform(line.aircraft, "stick throttle=1")
        await until(lambda: line.aircraft.height > height)
        perform(line.aircraft, "release-sticks")
    async with console_of(line) as (url, station), context_of(browser) as tabs:
        console = Console(url, station, tabs)
        page = await console.open(LISTEN)
        yield console, line, page
        assert console.errors == []
    line.stop()


async def told(page: Any, name: AlarmName) -> None:
    """It is seen, announced and spoken, and something sounds."""
    await page.wait_for_function(IS_TOLD, arg=[name.value, LEVELS[name], TEXTS[name]])
    await page.wait_for_function("window.m100.heard.beeps > 0")


async def acknowledge(page: Any, *names: AlarmName) -> None:
    """Each; then nothing sounds."""
    for name in names:
        await page.click(f"[data-see={name.value}]")
        await page.wait_for_function(IS_KNOWN, arg=name.value)
    await page.wait_for_function("window.m100.heard.level === ''")


async def over(page: Any, name: AlarmName) -> None:
    await page.wait_for_selector(f"[data-alarm={name.value}]", state="hidden")


async def written(page: Any, *names: AlarmName) -> None:
    """Each stands in the events, with its acknowledgement."""
    await look_at(page, "events")
    for name in names:
        for what in ("Alarm: ", "Acknowledged: "):
            await page.wait_for_function(IS_WRITTEN, arg=[what, TEXTS[name]])


async def test_what_a_viewer_hears(browser: Any) -> None:
    async with in_flight(browser) as (_, line, page):
        perform(line.aircraft, "gps 2")
        await told(page, N.GPS)
        await acknowledge(page, N.GPS)
        perform(line.aircraft, "gps 5")
        await over(page, N.GPS)
        perform(line.aircraft, "battery 25")
        await told(page, N.BATTERY_LOW)
        await acknowledge(page, N.BATTERY_LOW)
        perform(line.aircraft, "battery 10")
        await told(page, N.BATTERY_CRITICAL)
        await told(page, N.LANDS_ITSELF)
        await acknowledge(page, N.BATTERY_CRITICAL, N.LANDS_ITSELF)
        await written(page, *WITHOUT_CONTROL)


async def test_what_the_client_in_control_hears(browser: Any) -> None:
    async with in_flight(browser, height=45.5) as (console, line, page):
        await in_control(page)
        await told(page, N.GUARD_NEAR)
        await acknowledge(page, N.GUARD_NEAR)
        perform(line.aircraft, "battery 19")
        await told(page, N.BATTERY_FLOOR)
        await acknowledge(page, N.BATTERY_FLOOR)
        other = await console.open()
        await press(other, "obtain")
        await other.click("#confirm")
        await banner(other, "You have control")
        await told(page, N.LEASE_TAKEN)
        await acknowledge(page, N.LEASE_TAKEN)
        await over(page, N.LEASE_TAKEN)
        await written(page, *WITH_CONTROL)


async def test_a_pilot_who_takes_it_out_of_a_mission(browser: Any) -> None:
    async with in_flight(browser) as (_, line, page):
        await look_at(page, "plan")
        await page.wait_for_selector("#plan-file", state="attached")
        file = {"name": "plan.json", "mimeType": "application/json"}
        await page.set_input_files("#plan-file", file | {"buffer": PLAN.to_json().encode()})
        await shows(page, "#plan-summary", "3 waypoints")
        await look_at(page, "fly")
        await in_control(page)
        await look_at(page, "plan")
        await press_for(page, "mission_upload", "#plan", "3 waypoints")

        async def is_under_way() -> bool:
            return "to waypoint" in await page.inner_text("#mission")

        await hold_until(page, "mission_start", is_under_way)
        perform(line.aircraft, "rc-mode P")
        await told(page, N.AUTHORITY_LOST)
        await told(page, N.MISSION_ABORTED)
        await acknowledge(page, *IN_A_MISSION)
        await written(page, *IN_A_MISSION)
        perform(line.aircraft, "rc-mode F")
        await over(page, N.AUTHORITY_LOST)
        await banner(page, "You have control")


async def test_a_line_that_falls_silent(browser: Any) -> None:
    async with in_flight(browser) as (_, line, page):
        perform(line.aircraft, "stall on")
        await told(page, N.LINK_OLD)
        await told(page, N.LINK_LOST)
        await acknowledge(page, N.LINK_LOST)  # and with it what it covers
        perform(line.aircraft, "stall off")
        await over(page, N.LINK_LOST)
        await over(page, N.LINK_OLD)
        await written(page, *OF_THE_LINE)
