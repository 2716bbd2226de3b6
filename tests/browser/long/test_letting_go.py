"""Every way in which a finger, a key or a page ends what it steers: the aircraft stops."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import pytest

from tests.browser.boxes import faults
from tests.browser.conftest import Console, console_in_browser, context_of, until
from tests.browser.operator import GAMEPAD, airborne, fold, is_still, steer

pytestmark = [pytest.mark.anyio]

LEFT, RIGHT = ".stick.climb", ".stick.move"


class Fingers:
    """Fingers on a screen, by Chromium's own input: what a page gets is what a phone sends."""

    def __init__(self, page: Any, session: Any) -> None:
        self.page, self._session = page, session
        self._points: dict[int, dict[str, float]] = {}

    async def place_of(self, selector: str) -> tuple[float, float]:
        box = await self.page.locator(selector).bounding_box()
        return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    async def down(self, finger: int, selector: str) -> None:
        x, y = await self.place_of(selector)
        self._points[finger] = {"x": x, "y": y, "id": finger}
        await self._tell("touchStart")

    async def move(self, finger: int, across: float, down: float) -> None:
        self._points[finger]["x"] += across
        self._points[finger]["y"] += down
        await self._tell("touchMove")

    async def up(self) -> None:
        """All of them: the protocol has no end of one of two."""
        self._points.clear()
        await self._tell("touchEnd")

    async def lift(self, selector: str) -> None:
        """The end of one of two, as the page would hear it."""
        await self.page.evaluate(
            """(selector) => {
              const stick = m100.steering.sticks.find((one) => one.element.matches(selector));
              const end = new PointerEvent("pointerup", {pointerId: stick.pointer});
              stick.element.dispatchEvent(end);
            }""",
            selector,
        )

    async def cancel(self) -> None:
        self._points.clear()
        await self._tell("touchCancel")

    async def _tell(self, kind: str) -> None:
        points = list(self._points.values())
        await self._session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})


@pytest.fixture
async def fingers(browser: Any) -> AsyncIterator[tuple[Console, Fingers]]:
    """A phone that flies: its right stick is pushed forward."""
    async with (
        console_in_browser(browser) as console,
        context_of(browser, has_touch=True, viewport={"width": 390, "height": 844}) as phone,
    ):
        console.context, desk = phone, console.context
        page = await airborne(console)
        console.context = desk
        hand = Fingers(page, await phone.new_cdp_session(page))
        await fold(page, "sticks", is_shown=True)
        for _ in range(4):
            await page.tap("[data-steer=faster]")

        async def push() -> None:
            await hand.down(1, RIGHT)
            await asyncio.sleep(0.5)
            assert is_still(console)  # to touch is not to move
            await hand.move(1, 0, -60)

        await steer(page, push, hand.up, lambda: console.watch.speed[1] > 0.5)
        yield console, hand


async def stays_still(console: Console) -> None:
    await until(lambda: is_still(console))
    await asyncio.sleep(1.0)
    assert is_still(console)


async def test_stop_by_a_second_finger_while_a_stick_is_held(
    fingers: tuple[Console, Fingers],
) -> None:
    console, hand = fingers
    assert await faults(hand.page) == []
    await hand.down(2, "[data-act=stop]")
    await stays_still(console)  # the first finger is still there
    await hand.move(1, 0, 10)
    await stays_still(console)


async def test_a_finger_that_is_lifted(fingers: tuple[Console, Fingers]) -> None:
    console, hand = fingers
    await hand.up()
    await stays_still(console)


async def test_a_touch_that_the_system_takes_away(fingers: tuple[Console, Fingers]) -> None:
    console, hand = fingers
    await hand.cancel()
    await stays_still(console)


async def test_a_second_finger_on_the_same_stick(fingers: tuple[Console, Fingers]) -> None:
    console, hand = fingers
    await hand.down(2, RIGHT)
    await stays_still(console)
    await hand.move(1, 0, 5)
    await stays_still(console)


async def test_two_sticks_at_once_and_each_ends_its_own(fingers: tuple[Console, Fingers]) -> None:
    console, hand = fingers
    await hand.down(2, LEFT)
    await hand.move(2, 0, -60)
    await until(lambda: console.watch.speed[2] > 0.15)
    await hand.lift(RIGHT)
    await until(lambda: abs(console.watch.speed[1]) < 0.15)
    assert console.watch.speed[2] > 0.1
    await hand.up()
    await stays_still(console)


async def test_another_view(fingers: tuple[Console, Fingers]) -> None:
    console, hand = fingers
    await hand.page.evaluate("document.querySelector('[data-go=events]').click()")
    await stays_still(console)


async def test_a_gamepad_that_is_held_while_the_page_loses_the_focus(console: Console) -> None:
    page = await airborne(console, GAMEPAD)
    await page.click("#pad")
    await page.keyboard.press("Digit4")

    async def press() -> None:
        await page.evaluate("window.pad.axes = [0, 0, 0, -1]")
        await page.evaluate("window.pad.buttons.fill({pressed: true}, 4)")

    async def lift() -> None:
        await page.evaluate("window.pad.axes = [0, 0, 0, 0]")
        await page.evaluate("window.pad.buttons.fill({pressed: false}, 4)")
        await asyncio.sleep(0.2)

    await steer(page, press, lift, lambda: console.watch.speed[1] > 0.5)
    await page.click("#banner")
    await until(lambda: is_still(console))
    await page.click("#pad")  # the shoulder button is still held
    await stays_still(console)
    await lift()
    await steer(page, press, lift, lambda: console.watch.speed[1] > 0.5)


async def test_a_key_that_is_held_through_stop(console: Console) -> None:
    page = await airborne(console)
    await page.click("#pad")
    await page.keyboard.press("Digit4")
    await page.keyboard.down("w")
    await until(lambda: console.watch.speed[1] > 0.5)
    other = await console.open()  # somebody else
    await other.click("[data-act=stop]")
    await stays_still(console)
    await page.bring_to_front()
    await page.keyboard.up("w")
