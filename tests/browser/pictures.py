"""Makes the pictures of the README: the console in flight, and the end of the demo in a terminal.

    python -m tests.browser.pictures

Both are of this very code; nothing in them is drawn.
"""

from __future__ import annotations

import asyncio
import io
import os
import pty
import re
import subprocess
import sys
from pathlib import Path

from playwright.async_api import async_playwright
from rich.console import Console as Terminal
from rich.text import Text

from tests.browser.conftest import ARGUMENTS, CHROMIUM, console_in_browser
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


def demo() -> None:
    """What the first command of the README leaves on the terminal."""
    master, slave = pty.openpty()
    command = [
        sys.executable,
        "-c",
        "from m100link.cli import main; main()",
        "demo",
        "--speed",
        "10",
    ]
    size = {"COLUMNS": "92", "LINES": "40", "TERM": "xterm-256color"}
    with subprocess.Popen(
        command, stdout=slave, stderr=slave, env={**os.environ, **size}
    ) as running:
        os.close(slave)
        text = b""
        try:
            while chunk := os.read(master, 65536):
                text += chunk
        except OSError:  # the other end was closed
            pass
        assert running.wait() == 0
    os.close(master)
    terminal = Terminal(record=True, width=92, file=io.StringIO())
    terminal.print(Text.from_ansi(settled(text.decode())))
    svg = terminal.export_svg(title="m100link demo")
    # It would ask another site for a font.
    svg = re.sub(r"@font-face \{.*?\}", "", svg, flags=re.DOTALL)
    (IMAGES / "demo.svg").write_text(svg.replace("Fira Code", "monospace"), encoding="utf-8")


def settled(text: str) -> str:
    """The lines as they stand in the end, where a display was drawn over itself."""
    lines: list[str] = []
    row = 0
    for part in re.split(r"(\x1b\[\d*A|\n)", text.replace("\r", "")):
        up = re.fullmatch(r"\x1b\[(\d*)A", part)
        if up is not None:
            row = max(0, row - int(up[1] or 1))
        elif part == "\n":
            row += 1
        else:
            lines += [""] * (row + 1 - len(lines))
            clean = re.sub(r"\x1b\[\?\d+[hl]|\x1b\[\d*K", "", part)
            lines[row] = clean if clean or "\x1b[2K" in part else lines[row]
    return "\n".join(lines)


if __name__ == "__main__":
    IMAGES.mkdir(exist_ok=True)
    demo()
    asyncio.run(console())
