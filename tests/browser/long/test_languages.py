"""The page in German: no text of it stays English, nothing is cut off, and units are followed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from m100link.apps.station.console.page import VIEWS
from tests.browser.boxes import SIZES, faults
from tests.browser.conftest import Console
from tests.browser.operator import airborne, banner, hold, look_at, press, shows

pytestmark = [pytest.mark.anyio]

HERE = Path(__file__).parent
TEXTS = (HERE / "texts.js").read_text(encoding="utf-8")
CUT = (HERE / "cut.js").read_text(encoding="utf-8")

SAME = frozenset(
    (
        *("STOP", "GPS", "Link", "Firmware", "CSV", "JSON", "Position", "Mission", "Plan", "Pause"),
        *("Radius", "English", "Deutsch", "Alarm", "Version", "Jitter", "Gamepad", "App"),
        "Magnetometer",
        *("QGroundControl", "plan", "pitch", "photo", "stay", "turn", "video", "cut", "min"),
    )
)
"""What reads the same in both languages: names, units and letters."""


def is_same_allowed(text: str) -> bool:
    """Whether a text may read the same in both languages: no word of a language is in it."""
    words = [one.strip(".,:;()°%·") for one in text.split()]
    return all(len(one) < 3 or one in SAME or not one.isalpha() for one in words)


async def choose(page: Any, **settings: str) -> None:
    """As somebody chose it before, in this browser."""
    await page.evaluate(
        "(kept) => localStorage.setItem('m100link.settings', kept)", json.dumps(settings)
    )
    await page.reload()
    await page.wait_for_function("window.m100?.steering && window.m100.socket.heardAt > 0")
    if "language" in settings:
        await page.wait_for_function(f"document.documentElement.lang === '{settings['language']}'")


async def texts_of(page: Any, view: str) -> set[str]:
    await look_at(page, view)
    await page.wait_for_selector(f"section[data-view={view}] > *", state="attached")
    if view == "fly":
        await page.click("#point-open")
    await page.wait_for_timeout(1500)
    return set(await page.evaluate(TEXTS))


async def test_no_text_of_the_page_stays_english(console: Console) -> None:
    page = await console.open()
    seen: dict[str, dict[str, set[str]]] = {}
    for language in ("en", "de"):
        await choose(page, language=language)
        seen[language] = {view: await texts_of(page, view) for view in VIEWS}
    left = {
        view: sorted(
            text
            for text in seen["de"][view] & seen["en"][view]
            if not is_same_allowed(text) and not text.startswith(("console ", "rosbridge "))
        )
        for view in VIEWS
    }
    assert {view: texts for view, texts in left.items() if texts} == {}


async def test_nothing_is_cut_off_or_covered_in_german(console: Console) -> None:
    page = await console.open()
    await choose(page, language="de")
    found = {}
    for view in VIEWS:
        await look_at(page, view)
        await page.wait_for_selector(f"section[data-view={view}] > *", state="attached")
        for width, height in SIZES:
            await page.set_viewport_size({"width": width, "height": height})
            wrong = [*await faults(page), *(f"cut: {one}" for one in await page.evaluate(CUT))]
            if wrong:
                found[f"{view} at {width} x {height}"] = wrong
    assert found == {}


async def test_a_flight_in_german_in_feet_and_knots(console: Console) -> None:
    page = await airborne(console)
    await press(page, "release")
    await banner(page, "Nobody has control")
    await choose(page, language="de", length="ft", speed="kn")
    await press(page, "obtain")
    await banner(page, "Sie haben die Steuerung")
    height = await page.inner_text("[data-field=height]")
    assert height.endswith(" ft")
    assert float(height.split()[0].replace(",", ".")) == pytest.approx(
        console.watch.height / 0.3048, abs=1.0
    )
    assert (await page.inner_text("[data-field=speed]")).endswith(" kn")
    await shows(page, "#map-home", " ft")  # the page came in flight, and the station saw it
    assert "ft" in await page.inner_text(".leaflet-control-scale")
    await page.click("#pad")
    await page.keyboard.down("w")
    await shows(page, "#did", "W: vorwärts")
    await page.keyboard.up("w")
    await shows(page, "#did", "losgelassen")
    await page.click("#point-open")
    await page.fill("#click-distance", "100")  # feet
    await page.fill("#click-bearing", "90")
    await page.wait_for_function(
        "/^(9[5-9]|10[0-5]) ft, etwa/.test(document.querySelector('#click-preview').textContent)"
    )
    await page.click("#point-close")
    await hold(page, "land")
    await shows(page, "#task", "Landung")
