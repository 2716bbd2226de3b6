"""At every size STOP is hit and nothing covers anything. More states are in ``long/``."""

from __future__ import annotations

import pytest

from tests.browser.boxes import SIZES, faults
from tests.browser.conftest import Console

pytestmark = [pytest.mark.anyio]


PHONES = ((390, 844), (844, 390))


async def test_stop_is_hit_and_nothing_covers_anything(console: Console) -> None:
    page = await console.open()
    found: dict[str, list[str]] = {}
    for view, sizes in (("fly", SIZES), ("plan", PHONES), ("settings", PHONES)):
        await page.click(f"[data-go={view}]")
        await page.wait_for_selector(f"section[data-view={view}] > *", state="attached")
        for width, height in sizes:
            await page.set_viewport_size({"width": width, "height": height})
            seen = await faults(page)
            if seen:
                found[f"{view} at {width} x {height}"] = seen
    assert found == {}
