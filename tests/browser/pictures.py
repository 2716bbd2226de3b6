"""Makes the pictures of the README: the console in flight, and the demo in a terminal.

    python -m tests.browser.pictures [console] [demo]

Both are of this very code; nothing in them is drawn.
"""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

from playwright.async_api import async_playwright

from tests.browser.conftest import ARGUMENTS, CHROMIUM, console_in_browser
from tests.browser.recording import film, record
from tests.browser.test_console import airborne

IMAGES = Path(__file__).parents[2] / "docs/images"


async def console() -> None:
    """A page that has just flown a leg."""
    async with async_playwright() as started:
        browser = await started.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        async with console_in_browser(browser) as one:
            page = await airborne(one)
            await page.click("#pad")
            await page.keyboard.down("w")
            await asyncio.sleep(4.0)
            await page.keyboard.up("w")
            await page.keyboard.down("d")
            await asyncio.sleep(3.0)
            await page.screenshot(path=IMAGES / "console.png")
            await page.keyboard.up("d")
        await browser.close()


COMMAND = (sys.executable, "-c", "from m100link.cli import main; main()")


def demo() -> None:
    """What the first command of the README does on the terminal, three times as fast."""
    command = (*COMMAND, "demo", "--speed", "3")
    frames = record(command, columns=100, lines=40)
    picture = film(frames, title="m100link demo --speed 3", columns=100, hold_s=6.0)
    (IMAGES / "demo.svg").write_text(picture, encoding="utf-8")


if __name__ == "__main__":
    IMAGES.mkdir(exist_ok=True)
    wanted = sys.argv[1:] or ["demo", "console"]
    if "demo" in wanted:
        demo()
    if "console" in wanted:
        asyncio.run(console())
