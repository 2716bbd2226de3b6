"""Makes the pictures of README and manual: the console in flight, and the demo in a terminal.

    python -m tests.browser.pictures [console] [demo] [flight] [manual]

All are of this very code; nothing in them is drawn.
"""

from __future__ import annotations

import asyncio
import base64
import io
import sys
import tempfile
from pathlib import Path
from typing import Any

from PIL import Image
from PIL.Image import Quantize
from playwright.async_api import async_playwright

from m100link.log import read
from m100link.log.picture import picture as picture_of
from m100link.log.story import read_story
from m100link.sim import VirtualClockEventLoop
from tests.browser.conftest import ARGUMENTS, CHROMIUM, console_in_browser
from tests.browser.operator import airborne, fold
from tests.browser.recording import film, record
from tests.test_examples import load

IMAGES = Path(__file__).parents[2] / "docs/images"


async def console() -> None:
    """A page that has just flown a leg."""
    async with async_playwright() as started:
        browser = await started.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        async with console_in_browser(browser, "--firmware", "3.1") as one:
            page = await airborne(one)
            await page.click("#pad")
            await page.keyboard.down("w")
            await asyncio.sleep(4.0)
            await page.keyboard.up("w")
            await page.keyboard.down("d")
            await asyncio.sleep(3.0)
            seen = await page.screenshot()
            await page.keyboard.up("d")
        await browser.close()
    packed = Image.open(io.BytesIO(seen)).convert("RGB").quantize(256, Quantize.MAXCOVERAGE)
    packed.save(IMAGES / "console.png", optimize=True)


SIZES = {
    "phone": (390, 844),
    "phone-across": (844, 390),
    "tablet": (768, 1024),
    "laptop": (1440, 900),
}
"""What the manual shows the Fly view at: width and height by name."""

WIDEST = 1280  # of a picture in the manual; larger ones are scaled down

TO_WEBP = """
async ([png, width]) => {
  const image = new Image();
  image.src = "data:image/png;base64," + png;
  await image.decode();
  const canvas = document.createElement("canvas"), scale = Math.min(1, width / image.width);
  canvas.width = image.width * scale;
  canvas.height = image.height * scale;
  canvas.getContext("2d").drawImage(image, 0, 0, canvas.width, canvas.height);
  return canvas.toDataURL("image/webp", 0.7).split(",")[1];
}
"""


async def picture(page: Any, name: str) -> None:
    """What the page shows, small enough for a manual; the browser itself packs it."""
    png = base64.b64encode(await page.screenshot()).decode()
    packed = await page.evaluate(TO_WEBP, [png, WIDEST])
    (IMAGES / f"console-{name}.webp").write_bytes(base64.b64decode(packed))


async def manual() -> None:
    """An aircraft in the air, seen at every size, for the manual's page."""
    async with async_playwright() as started:
        browser = await started.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        async with console_in_browser(browser, "--firmware", "3.1") as one:
            page = await airborne(one)
            for name, (width, height) in SIZES.items():
                await page.set_viewport_size({"width": width, "height": height})
                is_phone = min(width, height) < 500  # as it comes up there
                for panel in ("horizon", "sticks", "camera"):
                    is_shown = not is_phone or (panel == "sticks" and width > height)
                    await fold(page, panel, is_shown=is_shown)
                await page.evaluate("document.activeElement.blur()")
                await asyncio.sleep(2.0)
                await picture(page, name)
        await browser.close()


COMMAND = (sys.executable, "-c", "from m100link.apps.cli import main; main()")


def demo() -> None:
    """What the first command of the README does on the terminal, three times as fast."""
    words = ("demo", "--speed", "3", "--record", "flights")  # a folder that says nothing of us
    with tempfile.TemporaryDirectory() as folder:
        frames = record((*COMMAND, *words), columns=100, lines=40, folder=Path(folder))
    picture = film(frames, title=" ".join(("m100link", *words)), columns=100, hold_s=6.0)
    (IMAGES / "demo.svg").write_text(picture, encoding="utf-8")


def flight() -> None:
    """What `m100link log plot` makes of the flight of the example, with a gusty wind."""
    with tempfile.TemporaryDirectory() as place:
        log = Path(place) / "flight.mcap"
        url = "sim://?seed=7&wind-north=3&wind-east=2&gusts=2"
        with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
            runner.run(load("plot_a_flight").main(url, str(log)))
        (IMAGES / "flight.png").write_bytes(picture_of(read_story(read(log)), width_px=1100))


if __name__ == "__main__":
    IMAGES.mkdir(exist_ok=True)
    wanted = sys.argv[1:] or ["demo", "console", "flight", "manual"]
    if "demo" in wanted:
        demo()
    if "console" in wanted:
        asyncio.run(console())
    if "flight" in wanted:
        flight()
    if "manual" in wanted:
        asyncio.run(manual())
