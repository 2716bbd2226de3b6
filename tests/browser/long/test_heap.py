"""Three minutes of flight in a page: nothing piles up, and no work of the page delays an order."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import pytest

from tests.browser.conftest import Console
from tests.browser.operator import airborne, hold_key, in_control, is_still, look_at
from tests.waiting import until

pytestmark = [pytest.mark.anyio, pytest.mark.timeout(900)]

MINUTES = 3
ALLOWED_BYTES, ALLOWED_NODES, ALLOWED_LISTENERS = 600_000, 150, 20
"""By which a minute of flight may enlarge what stays: the track and the curves become longer, and
the list of events, until it is full."""

LONGEST_S = 0.2
"""Of a processor, for one piece of work of the page: a beat lasts 0.3 s."""


async def kept(session: Any) -> dict[str, float]:
    """The sizes of what stays when all garbage is collected."""
    for _ in range(2):  # what the first frees, others may have held
        await session.send("HeapProfiler.collectGarbage")
    counted = (await session.send("Performance.getMetrics"))["metrics"]
    wanted = ("JSHeapUsedSize", "Nodes", "JSEventListeners")
    return {one["name"]: one["value"] for one in counted if one["name"] in wanted}


async def fly_a_minute(console: Console, page: Any) -> None:
    """To and fro, and through the views, as operators look around."""
    loop = asyncio.get_running_loop()
    ends = loop.time() + 60.0
    while loop.time() < ends:
        for key, sign in (("w", 1.0), ("s", -1.0)):
            await look_at(page, "fly")
            await in_control(page)
            await page.click("#pad")
            await page.keyboard.press("Digit4")
            await hold_key(page, key, lambda sign=sign: sign * console.watch.speed[1] > 0.5)  # type: ignore[misc] # mypy knows no type of a default
            await page.keyboard.up(key)
            await until(lambda: is_still(console))
        for view in ("data", "events", "plan", "settings"):
            await look_at(page, view)
            await asyncio.sleep(0.5)
    await look_at(page, "fly")


def longest_work(trace: bytes) -> float:
    """Seconds of a processor for the longest task of a page's own thread."""
    events = json.loads(trace)["traceEvents"]
    mains = {
        (one["pid"], one["tid"])
        for one in events
        if one["name"] == "thread_name" and one["args"]["name"] == "CrRendererMain"
    }
    tasks = [float(one.get("tdur", 0)) for one in events if (one["pid"], one["tid"]) in mains]
    assert len(tasks) > 1000, "tasks were not counted"
    return max(tasks) / 1e6


async def test_three_minutes_of_flight_leave_the_heap_as_it_was(
    console: Console, browser: Any
) -> None:
    page = await airborne(console)
    session = await console.context.new_cdp_session(page)
    await session.send("Performance.enable")
    await fly_a_minute(console, page)  # what is loaded and filled once
    sizes = [await kept(session)]
    for _ in range(MINUTES):
        await fly_a_minute(console, page)
        sizes.append(await kept(session))
    # A trace takes memory of the page: it comes last.
    await browser.start_tracing(page=page, categories=["toplevel"])
    await fly_a_minute(console, page)
    longest = longest_work(await browser.stop_tracing())
    grown = {name: (sizes[-1][name] - sizes[0][name]) / MINUTES for name in sizes[0]}
    told = f"{grown} a minute: {sizes}; longest work {longest:.3f} s"
    print(told)  # noqa: T201 - for the manual
    assert grown["JSHeapUsedSize"] < ALLOWED_BYTES, told
    assert grown["Nodes"] < ALLOWED_NODES, told
    assert grown["JSEventListeners"] < ALLOWED_LISTENERS, told
    assert longest < LONGEST_S, told
