"""One flight after another in one page: what steers, and every way to let go of it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import pytest

from tests.browser.conftest import Console, console_in_browser, until
from tests.browser.operator import (
    GAMEPAD,
    airborne,
    banner,
    hold_key,
    in_control,
    is_still,
    look_at,
    shows,
    steer,
)

pytestmark = [pytest.mark.anyio]

Flight = tuple[Console, Any]


@pytest.fixture(scope="module")
async def in_the_air(browser: Any) -> AsyncIterator[Flight]:
    async with console_in_browser(browser) as console:
        yield console, await airborne(console, GAMEPAD)


@pytest.fixture
async def flight(in_the_air: Flight) -> AsyncIterator[Flight]:
    """A page that has control of an aircraft which hovers, its pad in focus; nothing is held."""
    console, page = in_the_air
    await look_at(page, "fly")
    await in_control(page)  # a busy machine may have taken it from a page that it did not hear
    await page.click("#pad")
    await page.keyboard.press("Digit4")
    yield in_the_air
    for key in ("w", "Meta"):
        await page.keyboard.up(key)
    await page.mouse.up()
    await page.evaluate("window.m100.steering.rest()")
    await until(lambda: is_still(console))


@pytest.mark.parametrize("how", ["click elsewhere", "escape", "hide"])
async def test_losing_focus_stops_although_the_key_is_held(flight: Flight, how: str) -> None:
    console, page = flight
    await hold_key(page, "w", lambda: console.watch.speed[1] > 0.5)
    if how == "click elsewhere":
        await page.click("#banner")
    elif how == "escape":
        await page.keyboard.press("Escape")
    else:
        await page.evaluate(
            """() => {
                Object.defineProperty(document, 'hidden', {get: () => true, configurable: true});
                document.dispatchEvent(new Event('visibilitychange'));
                delete document.hidden;
            }"""
        )
    await until(lambda: is_still(console))
    await banner(page, "You have control")


@pytest.mark.smoke
async def test_a_key_whose_release_is_not_reported_stops(flight: Flight) -> None:
    console, page = flight
    await hold_key(page, "w", lambda: console.watch.speed[1] > 0.5)
    await page.keyboard.down("Meta")  # macOS sends no keyup from now on
    await until(lambda: is_still(console))
    assert await page.evaluate("window.m100.steering.held.size") == 0


async def test_keys_do_nothing_until_the_pad_has_the_focus(flight: Flight) -> None:
    console, page = flight
    await page.click("#banner")
    await page.keyboard.down("w")
    await asyncio.sleep(1.0)
    assert is_still(console)


SHOULDER_IS_SEEN = """(is) => {
  const {wasActive, pad} = window.m100.steering;
  return (wasActive || pad.dataset.fate === "let_go_first") === is;
}"""


async def test_a_gamepad_flies_while_its_shoulder_button_is_held(flight: Flight) -> None:
    console, page = flight
    await page.evaluate("window.pad.axes = [0, 0, 0, -1]")
    await asyncio.sleep(0.7)
    assert is_still(console)  # the stick alone moves nothing

    async def shoulder(is_pressed: bool) -> None:
        # A press begins with its sticks at rest.
        await page.evaluate("(up) => { window.pad.axes = [0, 0, 0, up]; }", -int(is_pressed))
        await page.evaluate("(pressed) => window.pad.buttons.fill({pressed}, 4)", is_pressed)
        # The page let go, or steers; either ends as it sees the button come up.
        await page.wait_for_function(SHOULDER_IS_SEEN, arg=is_pressed)

    await steer(
        page,
        lambda: shoulder(True),
        lambda: shoulder(False),
        lambda: console.watch.speed[1] > 0.5,
    )
    await shoulder(False)
    await until(lambda: is_still(console))


COUNT_STOPS = """() => {
  window.stops = 0;
  document.querySelector("[data-act=stop]").addEventListener("stopped", () => window.stops++);
}"""


async def test_the_card_of_a_gamepad_moves_sticks_and_not_the_aircraft(
    flight: Flight,
) -> None:
    console, page = flight
    await page.evaluate("Object.assign(window.pad, {id: 'Pad of a test', index: 0})")
    await look_at(page, "settings")
    await shows(page, "#gamepad .which", "Pad of a test")

    async def shoulder(is_pressed: bool) -> None:
        # A press begins with its sticks at rest.
        await page.evaluate("(up) => { window.pad.axes = [0, 0, 0, up]; }", -int(is_pressed))
        await page.evaluate("(pressed) => window.pad.buttons.fill({pressed}, 4)", is_pressed)
        await asyncio.sleep(0.2)

    await page.evaluate("window.pad.axes = [0, 0, 0, -1]")
    await shoulder(True)
    await page.wait_for_selector("#gamepad .row.down >> text=Button 4")
    right = page.locator("#gamepad .stick").nth(1)
    assert await right.evaluate("(one) => one.style.getPropertyValue('--up')") == "1"
    await page.get_by_label("inverted").nth(3).check()  # of the last direction, forward
    await page.wait_for_function(
        "document.querySelectorAll('#gamepad .stick')[1].style.getPropertyValue('--up') === '-1'"
    )
    await asyncio.sleep(0.7)
    assert is_still(console)
    await look_at(page, "fly")
    await page.click("#pad")
    await asyncio.sleep(0.7)
    assert is_still(console)  # the shoulder button is held since before
    await shoulder(False)
    await steer(
        page,
        lambda: shoulder(True),
        lambda: shoulder(False),
        lambda: console.watch.speed[1] < -0.5,
    )
    await page.evaluate("navigator.getGamepads = () => [null]")  # out of reach, or unplugged
    await until(lambda: is_still(console))
    await page.evaluate("navigator.getGamepads = () => [window.pad]")
    await asyncio.sleep(0.7)
    assert is_still(console)
    await shoulder(False)
    await look_at(page, "settings")
    await page.click("#gamepad button >> text=As usual")
    # The fields are drawn anew at the page's next look at the gamepad.
    await page.wait_for_selector("#gamepad .row:nth-child(4) [type=checkbox]:not(:checked)")
    await page.evaluate(COUNT_STOPS)
    await page.evaluate("window.pad.buttons[1] = {pressed: true}")
    await page.wait_for_function("window.stops === 1")  # in this view, too
    await page.evaluate("window.pad.buttons[1] = {pressed: false}")
    await look_at(page, "fly")


async def test_the_stick_on_the_screen_flies_while_it_is_held(flight: Flight) -> None:
    console, page = flight
    box = await page.locator(".stick.move").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    async def deflect() -> None:
        await page.mouse.move(x, y)
        await page.mouse.down()
        await page.mouse.move(x, y - box["height"] / 2)

    await steer(page, deflect, page.mouse.up, lambda: console.watch.speed[1] > 0.5)
    await page.mouse.up()
    await until(lambda: is_still(console))


async def test_the_pilots_switch_shows_in_the_banner(flight: Flight) -> None:
    _, page = flight
    await look_at(page, "settings")
    await page.click("#sim-mode >> text=P")
    await banner(page, "The pilot has control: mode switch in P")
    await page.click("#sim-mode >> text=F")
    await banner(page, "You have control")
