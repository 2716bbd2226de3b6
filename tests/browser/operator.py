"""What an operator does at the page: presses, holds, steers, and again where the page says why not.

A page on a busy machine stands still for a second now and then. It then drops what was held, says
so and asks for a new press; an operator gives that, and so do these.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any

from tests.browser.conftest import Console, until
from tests.waiting import PATIENCE, again_and_again

NOT_TAKEN = (
    *("stood still", "s late", "shifted", "not offered", "was withdrawn"),
    "has no time",  # its connection has just come back, and the station's clock with the next word
)
"""What the page says when it asks for another press."""

STEERS = "window.m100.steering.wasActive"


GAMEPAD = """
window.pad = {connected: true, axes: [0, 0, 0, 0], buttons: Array(6).fill({pressed: false})};
navigator.getGamepads = () => [window.pad];
"""
"""A gamepad of which the test sets sticks and buttons."""


class Fingers:
    """Fingers on a screen, by Chromium's own input: what a page gets is what a phone sends."""

    def __init__(self, page: Any, session: Any) -> None:
        self.page, self._session = page, session
        self._points: dict[int, dict[str, float]] = {}

    @classmethod
    async def at(cls, page: Any) -> Fingers:
        return cls(page, await page.context.new_cdp_session(page))

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


async def press(page: Any, name: str) -> None:
    await page.click(f"[data-act={name}]")


async def look_at(page: Any, view: str) -> None:
    await page.click(f"[data-go={view}]")


async def hold(page: Any, name: str, seconds: float = 2.0) -> None:
    # It waits until the button stands still and nothing lies over it.
    await page.locator(f"[data-act={name}]").first.hover(position={"x": 10, "y": 10})
    await page.mouse.down()
    await asyncio.sleep(seconds)
    await page.mouse.up()


async def banner(page: Any, text: str) -> None:
    await shows(page, "#banner", text)


async def shows(page: Any, selector: str, text: str) -> None:
    await page.wait_for_function(
        "([selector, text]) => document.querySelector(selector)?.textContent.includes(text)",
        arg=[selector, text],
    )


async def fold(page: Any, name: str, *, is_shown: bool) -> None:
    """Let a panel over the map be shown, or not."""
    if await page.evaluate(f"document.body.classList.contains('with-{name}')") is not is_shown:
        await page.click(f"[data-fold={name}]")


async def look_around(page: Any) -> None:
    """What the operator has to say before take-off."""
    # It is checked when the station has taken it, which a busy machine does in its own time.
    await page.get_by_role("checkbox", name="I have looked").click()
    await page.wait_for_selector("#ground [role=checkbox][aria-checked=true]")


async def press_until(
    page: Any,
    name: str,
    done: Callable[[], bool | Awaitable[bool]],
    pressed: Callable[[Any, str], Awaitable[None]] = press,
    mend: Callable[[], Awaitable[None]] | None = None,
) -> None:
    """Press a button as people do: again when the page says that it was too slow.

    And when nothing comes of it: a button that is grey as the finger comes down takes no press.

    Args:
        done: Whether it is so.
        pressed: How it is pressed.
        mend: What is done while the button is grey, for what makes it grey.
    """
    problem = before = ""

    async def is_done() -> bool:
        result = done()
        return result if isinstance(result, bool) else await result

    async def answered() -> bool:
        nonlocal problem
        problem = await page.inner_text("#problem")
        if problem == before:  # of an earlier press, until this one has arrived
            problem = ""
        return bool(problem) or await is_done()

    async def is_offered() -> bool:
        if await page.locator(f"[data-act={name}]").first.is_enabled() or await is_done():
            return True
        if mend is not None:
            await mend()
        return False

    for _ in again_and_again():
        await until(is_offered, what=name)
        if await is_done():
            return
        before = await page.inner_text("#problem")
        await pressed(page, name)
        with suppress(AssertionError):
            await until(answered, within=PATIENCE / 6)
        if await is_done():
            return
        assert not problem or any(why in problem for why in NOT_TAKEN), problem
    raise AssertionError(f"{name} was pressed again and again, and nothing came of it")


async def hold_until(page: Any, name: str, done: Callable[[], bool | Awaitable[bool]]) -> None:
    """The same for a button that has to be held."""
    await press_until(page, name, done, hold)


async def steer(
    page: Any,
    begin: Callable[[], Awaitable[Any]],
    end: Callable[[], Awaitable[Any]],
    moves: Callable[[], bool],
) -> None:
    """Hold something until the aircraft moves so; it is held on.

    Begun again where the page let go by itself, or the station asks for that.
    """

    async def answered() -> bool:
        if moves() or not await page.evaluate(STEERS):
            return True
        return "still hold" in await page.inner_text("#problem")

    for _ in again_and_again():
        await begin()
        await until(answered)
        if moves():
            return
        await end()
    raise AssertionError("it was held again and again, and the page let go each time")


async def hold_key(page: Any, key: str, moves: Callable[[], bool]) -> None:
    """The same with a key."""
    keys = page.keyboard
    await steer(page, lambda: keys.down(key), lambda: keys.up(key), moves)


async def take_off(page: Any, console: Console) -> None:
    # Control is taken from a page that is not heard for too long, on a busy machine, too.
    await press_until(
        page,
        "take_off",
        lambda: console.watch.height > 1.0,
        hold,
        mend=lambda: in_control(page),
    )


async def press_for(page: Any, name: str, selector: str, text: str) -> None:
    """Press a button until the page says so."""

    async def is_shown() -> bool:
        return text in (await page.text_content(selector) or "")

    await press_until(page, name, is_shown)


async def in_control(page: Any) -> None:
    """Take control, which activates."""
    await press_for(page, "obtain", "#banner", "You have control")


async def airborne(console: Console, script: str = "", page: Any = None) -> Any:
    """A page that has control of an aircraft in the air.

    Args:
        script: Runs in the page before its own.
        page: One that is open; by default another is opened. To open one costs so much that a busy
            machine may hear nothing of another for too long: a test of two opens both first.
    """
    page = page or await console.open(script)
    await in_control(page)
    await look_around(page)
    await take_off(page, console)
    await page.wait_for_selector("[data-act=land]:not([disabled])")
    return page


def is_still(console: Console) -> bool:
    return math.hypot(*console.watch.speed) < 0.15
