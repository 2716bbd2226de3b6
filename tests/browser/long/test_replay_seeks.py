"""Replays that are sought to and fro on a busy machine: they claim nothing that the file has not.

A replaying computer that is late once raised alarms of its own, and a seek drew lines that nobody
flew. ``REPLAYS=20`` in the environment makes the search as long as that of a release.
"""

from __future__ import annotations

import asyncio
import json
import math
import os
import random
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mcap", reason="the extra `log` is not installed")

from m100link import Credentials, connect
from m100link.apps.station.console.kept import analyse
from m100link.sim.ports.driver import Driver, serve_tcp
from m100link.sim.vehicle.activation import DEMO_APP_ID, DEMO_KEY
from m100link.sim.virtual import VirtualAircraft
from tests.browser.test_replay import RUNS, replayed

pytestmark = [pytest.mark.anyio, pytest.mark.timeout(900)]

SEEKS = 50

# All that the page of this tab ever showed: alarms, and its longest line. A page that has lost its
# station loads itself anew.
WATCH = f"""() => {{
  const seen = JSON.parse(sessionStorage.seen ?? '{{"alarms": {{}}, "longest": 0, "looks": 0}}');
  setInterval(() => {{
    if (!window.m100?.map) return;
    for (const row of document.querySelectorAll("#alarms > [data-alarm]"))
      if (row.offsetParent) seen.alarms[row.dataset.alarm] = true;
    seen.longest = Math.max(seen.longest, ({RUNS})().longest);
    seen.looks += 1;
    sessionStorage.seen = JSON.stringify(seen);
  }}, 100);
}}"""


@pytest.fixture(scope="module")
async def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A flight with an alarm, a battery that is low towards its end."""
    path: Path = tmp_path_factory.mktemp("flights") / "a flight.mcap"
    line = Driver(VirtualAircraft(seed=7))
    line.start()
    server = await serve_tcp(line)
    async with connect(f"tcp://127.0.0.1:{server.port}", record=path) as aircraft:
        await aircraft.activate(Credentials(app_id=DEMO_APP_ID, key=DEMO_KEY))
        async with aircraft.control() as control:
            await control.take_off()
            await control.fly_to(north=30.0, east=-20.0, up=6.0)
            line.aircraft.battery_percent = 22.0
            await control.fly_to(north=-10.0, east=25.0, up=-3.0)
            await control.land()
    await server.stop()
    line.stop()
    return path


async def seek(page: Any, chance: random.Random) -> None:
    """As an operator does: on the slider, by the buttons, and pausing here and there."""
    how = chance.choice(["slider"] * 5 + ["back", "on", "toggle"])
    if how == "slider":
        box = await page.locator("#replay-slider").bounding_box()
        at = chance.uniform(2.0, box["width"] - 2.0)
        await page.mouse.click(box["x"] + at, box["y"] + box["height"] / 2)
    else:
        await page.click(f"[data-replay={how}]")
    await asyncio.sleep(chance.uniform(0.0, 0.4))


@pytest.mark.parametrize("seed", range(int(os.environ.get("REPLAYS", "2"))))
async def test_a_replay_that_is_sought_claims_what_its_file_says(
    browser: Any, flight: Path, seed: int
) -> None:
    found = analyse(str(flight), "")
    assert not isinstance(found, str)
    story = found.story
    places = pairwise(story.track.places())
    longest_m = max(math.dist(one[1:3], other[1:3]) for one, other in places if other.is_joined)
    assert [one.name for one in story.alarms] == ["battery_low"]
    chance = random.Random(seed)
    async with replayed(browser, flight) as page:
        await page.wait_for_function("window.m100?.map?.track.length > 5")
        await page.add_init_script(f"({WATCH})()")
        await page.evaluate(WATCH)
        for _ in range(SEEKS):
            await seek(page, chance)
        seen = json.loads(await page.evaluate("sessionStorage.seen"))
    print(f"seed {seed}: {seen}")  # noqa: T201 - for the manual
    assert seen["looks"] > SEEKS
    assert set(seen["alarms"]) <= {one.name for one in story.alarms}
    assert seen["longest"] < longest_m + 0.02, "a line that was never flown"
