"""Every way in which a finger, a key or a page ends what it steers: the aircraft stops."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import pytest

from tests.browser.boxes import faults
from tests.browser.conftest import Console, console_in_browser, context_of, until
from tests.browser.operator import GAMEPAD, Fingers, airborne, fold, is_still, steer

pytestmark = [pytest.mark.anyio]

LEFT, RIGHT = ".stick.climb", ".stick.move"


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
        hand = await Fingers.at(page)
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
