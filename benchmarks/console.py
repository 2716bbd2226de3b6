"""What an open console costs: bytes, processor time of the front, time to the first sight.

    python -m benchmarks.console [ROW …] [--rounds 3] [--json]

``m100link console --sim`` runs as a user starts it, and Chromium opens it over the loopback
interface. **Bytes** are what two pages that show the Fly view receive in a second, each by itself;
**processor time** is what the process of the fronts takes with them, less what it takes without.
**First sight** is the time from the beginning of the navigation, in a browser that has nothing of
this page, until the status line and the attitude of the aircraft are drawn from its own values.
**Scripts** are the lines and bytes of JavaScript that were written by hand.
"""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from benchmarks.program import ROOT, main
from benchmarks.rows import Absent, NotMeasured, Program, Row, Setting, Side, at_most, times

PAGES, SECONDS, SETTLE_S = 2, 8.0, 3.0
PATIENCE_MS = 60_000
OPEN, SCRIPTS = "an open console", "scripts written by hand"
STATIC = ROOT / "m100link/apps/station/console/static"
MAIN = "from m100link.apps.cli import main; main()"
CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
ARGUMENTS = ("--no-sandbox", "--enable-unsafe-swiftshader")

# Noted in the page by its own clock, which begins with the navigation.
FIRST_SIGHT = """
const look = () => {
  const text = (selector) => document.querySelector(selector)?.textContent.trim();
  const canvas = document.querySelector("#horizon");
  if (text("#banner") && window.m100?.socket?.live?.att && canvas && !canvas.dataset.stale)
    window.firstSight = performance.now();
  else requestAnimationFrame(look);
};
requestAnimationFrame(look);
"""


def scripts() -> dict[str, float]:
    """Lines and bytes of every module of the page."""
    texts = [path.read_text(encoding="utf-8") for path in sorted(STATIC.glob("*.js"))]
    lines = sum(bool(line.strip()) for text in texts for line in text.splitlines())
    return {"lines": lines, "bytes": sum(len(text.encode()) for text in texts)}


def children(process: int) -> list[int]:
    """Processes that a process has started."""
    path = Path(f"/proc/{process}/task/{process}/children")
    return [int(word) for word in path.read_text(encoding="ascii").split()]


def processor_time(process: int) -> float:
    """Seconds of all processors that a process has used."""
    fields = Path(f"/proc/{process}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def open_page(context: Any, url: str) -> tuple[Any, list[int]]:
    """A page, and where the sizes of what it receives are noted."""
    page, sizes = context.new_page(), [0]
    wire = context.new_cdp_session(page)
    wire.send("Network.enable")

    def frame(event: dict[str, Any]) -> None:
        sizes.append(len(event["response"]["payloadData"]))

    wire.on("Network.webSocketFrameReceived", frame)
    wire.on("Network.dataReceived", lambda event: sizes.append(event["encodedDataLength"]))
    page.goto(url)
    page.wait_for_function("window.firstSight > 0")
    return page, sizes


def costs(url: str, front: int, seconds: float, chromium: Any) -> dict[str, float]:
    """What the pages cost, one after the other."""

    def context() -> Any:
        made = chromium.new_context(viewport={"width": 1440, "height": 900})
        made.set_default_timeout(PATIENCE_MS)
        made.add_init_script(FIRST_SIGHT)
        return made

    first, _ = open_page(context(), url)  # what the front loads once is no cost of a page
    first.close()
    time.sleep(SETTLE_S)
    began, clock = processor_time(front), time.monotonic()
    time.sleep(seconds)
    alone = (processor_time(front) - began) / (time.monotonic() - clock)
    opened = [open_page(context(), url) for _ in range(PAGES)]
    sight = [page.evaluate("window.firstSight") for page, _ in opened]
    opened[0][0].wait_for_timeout(1000 * SETTLE_S)
    for _, sizes in opened:
        sizes.clear()
    began, clock = processor_time(front), time.monotonic()
    opened[0][0].wait_for_timeout(1000 * seconds)
    elapsed = time.monotonic() - clock
    busy = (processor_time(front) - began) / elapsed
    return {
        "bytes/s": sum(sum(sizes) for _, sizes in opened) / PAGES / elapsed,
        "part of a core": (busy - alone) / PAGES,
        "first sight": min(sight) / 1000.0,
    }


def consoles(seconds: float) -> dict[str, float]:
    """A console of its own, and a browser."""
    from playwright.sync_api import Error, sync_playwright

    command = ("console", "--sim", "--port", "0", "--console-port", "0", "--no-open-browser")
    station = subprocess.Popen(
        [sys.executable, "-c", MAIN, *command, "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    try:
        assert station.stdout is not None
        url = json.loads(station.stdout.readline())["console"]
        (front,) = children(station.pid)
        with sync_playwright() as started:
            chromium = started.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
            try:
                return costs(url, front, seconds, chromium)
            except Error as error:
                raise NotMeasured(f"the browser did not keep up: {error.message}") from error
            finally:
                chromium.close()
    finally:
        station.terminate()
        station.wait()


def ours(setting: Setting, stack: ExitStack) -> Iterable[Side | Absent]:
    """The console, where there is a browser for it."""
    yield Side(SCRIPTS, scripts, is_time=False)
    if setting.is_quick:
        yield Absent(OPEN, "a browser takes its time")
    elif CHROMIUM is None or importlib.util.find_spec("playwright") is None:
        yield Absent(OPEN, "needs Chromium and the package playwright")
    elif not Path("/proc/self/stat").exists():
        yield Absent(OPEN, "needs /proc")
    else:
        yield Side(OPEN, lambda: consoles(SECONDS), is_time=False)


PROGRAM = Program(
    name="console",
    rows=(
        Row(
            "an open console receives",
            times(f"{OPEN}, bytes/s", 1e-3),
            at_most(60),
            "kB/s",
        ),
        Row(
            "the front works for an open console",
            times(f"{OPEN}, part of a core", 1e2),
            at_most(10),
            "% of a core",
        ),
        Row("first sight of a console", times(f"{OPEN}, first sight", 1.0), at_most(1.5), "s"),
        Row("the console's own scripts, lines", times(f"{SCRIPTS}, lines", 1.0)),
        Row("the console's own scripts", times(f"{SCRIPTS}, bytes", 1e-3), unit="kB"),
    ),
    ours=ours,
    rounds=3,
    is_pinned=False,
)

if __name__ == "__main__":
    main(PROGRAM)
