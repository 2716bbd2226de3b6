"""An order and its answer: what the page says by itself when the one or the other is lost."""

from __future__ import annotations

import asyncio

import pytest

from m100link.apps.station.console.view.fly import HELD
from tests.browser.conftest import Console
from tests.browser.operator import airborne, hold, look_around, look_at, press, shows

pytestmark = [pytest.mark.anyio]

ACTS = """() => [...document.querySelectorAll("[data-act]")].map(
  (one) => [one.dataset.act, one.matches(".hold")])"""

CUT = """() => {
  window.socket.io.reconnection(false);
  window.socket.disconnect();
}"""
"""NiceGUI's connection is cut and stays away; the one for steering goes on."""

CUT_BOTH = """() => {
  window.socket.io.reconnection(false);
  window.socket.disconnect();
  m100.socket.connect = () => {};
  m100.socket.socket.close();
}"""

CUT_WHILE_HELD = f"""() => document.addEventListener(
  "pointerdown", () => setTimeout({CUT_BOTH}, 300), {{once: true}})"""


async def test_a_hold_that_is_lost_with_the_connection_is_reported_by_the_page(
    console: Console,
) -> None:
    page = await airborne(console)
    await page.evaluate(CUT_WHILE_HELD)
    await page.locator("[data-act=land]").hover(position={"x": 10, "y": 10})
    await page.mouse.down()
    await page.wait_for_function(
        "document.querySelector('#unanswered-said').textContent.includes('Land')"
    )
    await page.mouse.up()
    await page.wait_for_selector("#unanswered:visible")
    await shows(page, "#unanswered-said", "no answer")
    assert console.watch.height > 0.8
    await page.reload()
    await page.wait_for_function("window.m100?.steering && window.m100.socket.heardAt > 0")
    await shows(page, "#unanswered-said", "Land")
    await page.click("#unanswered-seen")
    await page.wait_for_selector("#unanswered", state="hidden")
    await page.reload()
    await page.wait_for_function("window.m100?.steering && window.m100.socket.heardAt > 0")
    assert await page.locator("#unanswered").is_hidden()


async def test_stop_is_answered_by_either_path_and_reported_when_both_are_cut(
    console: Console,
) -> None:
    page = await airborne(console)
    await page.evaluate(CUT)
    await press(page, "stop")
    await asyncio.sleep(3.5)  # longer than an answer may take
    assert await page.locator("#unanswered").is_hidden()
    # The instruments go on, and what the banner says is of before: nobody is to believe it.
    await page.wait_for_selector("#page-lost:visible")
    await page.wait_for_selector("#banner", state="hidden")
    await page.evaluate(CUT_BOTH)
    await press(page, "stop")
    await page.wait_for_selector("#unanswered:visible")
    await shows(page, "#unanswered-said", "STOP")


async def test_an_answer_that_comes_late_ends_the_report(console: Console) -> None:
    page = await console.open()
    await page.evaluate("window.socket.disconnect()")
    await press(page, "obtain")
    await page.wait_for_selector("#unanswered:visible")
    await shows(page, "#unanswered-said", "Obtain control")
    await page.evaluate("window.socket.connect()")
    await page.wait_for_selector("#unanswered", state="hidden")
    await look_at(page, "events")
    await shows(page, "#events", "s late; nothing was done")


async def test_what_flies_by_itself_is_held_and_a_short_press_says_so(console: Console) -> None:
    page = await airborne(console)
    for view in ("plan", "fly"):  # of the others none has an order
        await look_at(page, view)
        # It is built now; its first button may wait for a point on the map.
        await page.wait_for_selector(f"section[data-view={view}] [data-act]", state="attached")
    found: dict[str, bool] = dict(await page.evaluate(ACTS))
    assert {name for name, is_held in found.items() if is_held} == HELD
    await page.click("[data-act=go_home]")
    await shows(page, "#page-said", "Hold the button for a second")
    await page.wait_for_function("document.querySelector('#page-said').textContent === ''")
    assert await page.inner_text("#task") == ""
    await hold(page, "go_home")
    await shows(page, "#task", "going home")


async def test_a_reload_goes_on_where_the_page_was_and_asks_again_what_was_seen(
    console: Console,
) -> None:
    page = await console.open()
    await look_around(page)
    await look_at(page, "plan")
    await page.wait_for_selector("#plan-summary")
    await page.reload()
    await page.wait_for_selector("[data-go=plan][aria-current=page]")
    await page.wait_for_selector("#plan-summary:visible")
    await look_at(page, "check")
    await page.wait_for_selector("[data-check=free].wrong")
