"""What axe-core finds on the page: names, roles, contrast (WCAG 2.2, A and AA).

One view here; every view in every look is in ``long/``.
"""

from __future__ import annotations

from typing import Any

import pytest

from tests.browser.conftest import Console
from tests.browser.operator import look_at

axe = pytest.importorskip("axe_playwright_python.async_playwright", reason="axe is not installed")

pytestmark = [pytest.mark.anyio]

TAGS = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"]

LOOKED_AT = ((390, 844), (1440, 900))
"""A phone upright and a desk."""


async def violations(page: Any) -> list[str]:
    """What axe finds on the page as it is at each size, a line for each kind and place."""
    found = []
    for width, height in LOOKED_AT:
        await page.set_viewport_size({"width": width, "height": height})
        await page.wait_for_timeout(700)  # what is faded in is half transparent until then
        told = await axe.Axe().run(page, options={"runOnly": {"type": "tag", "values": TAGS}})
        found += [
            f"{one['id']} at {width}: {node['html'][:160]}"
            for one in told.response["violations"]
            for node in one["nodes"]
        ]
    return found


async def test_axe_finds_nothing_on_the_fly_view(console: Console) -> None:
    page = await console.open()
    await page.click("#point-open")
    assert await violations(page) == []


MOVES = """() => [...document.querySelectorAll("*")].filter((one) => {
  const {transitionDuration, animationDuration} = getComputedStyle(one);
  return [transitionDuration, animationDuration].some((all) => /[1-9]/.test(all));
}).map((one) => one.outerHTML.slice(0, 80))"""


async def test_nothing_moves_where_less_motion_is_wanted(console: Console) -> None:
    page = await console.open()
    assert len(await page.evaluate(MOVES)) > 10
    await page.emulate_media(reduced_motion="reduce")
    for view in ("fly", "plan", "settings"):
        await look_at(page, view)
        await page.wait_for_selector(f"section[data-view={view}] > *", state="attached")
        assert await page.evaluate(MOVES) == []
