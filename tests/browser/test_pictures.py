"""Tiles lie where they belong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from m100link.apps.station.web.tiles import Tile, tile_at
from tests.apps.station.web.test_tiles import mbtiles, png
from tests.browser.boxes import SIZES, faults
from tests.browser.conftest import Console, console_in_browser
from tests.browser.operator import shows

pytestmark = [pytest.mark.anyio]

HOME = (22.5431, 113.9589)  # of the virtual aircraft

# Where a place is within the tile of an address that holds it, as parts of its size from the north
# west; None until it is there.
WITHIN = """([latitude, longitude, zoom, column, row]) => {
  const map = window.m100?.map?.leaflet;
  const tile = document.querySelector(`img.leaflet-tile[src*="/tiles/${zoom}/${column}/${row}?"]`);
  if (!map || !tile?.complete || !tile.naturalWidth) return null;
  const at = map.latLngToContainerPoint([latitude, longitude]);
  const frame = map.getContainer().getBoundingClientRect(), box = tile.getBoundingClientRect();
  return [(frame.left + at.x - box.left) / box.width, (frame.top + at.y - box.top) / box.height];
}"""


def around(zoom: int) -> dict[tuple[int, int, int], bytes]:
    """Tiles around home: that of home is dark, the others are light."""
    here = tile_at(*HOME, zoom)
    tiles = {}
    for x in range(-6, 7):
        for y in range(-6, 7):
            tile = Tile(zoom, here.column + x, here.row + y)
            tiles[tile.stored] = png(shade=60 if (x, y) == (0, 0) else 200)
    return tiles


async def test_tiles_lie_below_the_map_at_their_place(browser: Any, tmp_path: Path) -> None:
    licence = "<a href='https://x'>© Anna</a>"
    file = mbtiles(tmp_path / "map", around(17) | around(19), attribution=licence)
    async with console_in_browser(browser, "--tiles", str(file)) as console:
        page = await console.open()
        await shows(page, "#map-source", "© Anna")
        # OpenStreetMap's wiki: (λ + 180) / 360 · 2^19, (1 - ln(tan φ + sec φ) / π) / 2 · 2^19.
        place = [*HOME, 19, 428108, 228431]
        await page.wait_for_function(f"(args) => ({WITHIN})(args) !== null", arg=place)
        across, down = await page.evaluate(WITHIN, place)
        assert across == pytest.approx(0.677, abs=0.01)
        assert down == pytest.approx(0.844, abs=0.01)
        assert (await page.evaluate("document.querySelector('#map-source').children.length")) == 0
        for dark in (False, True):
            await page.emulate_media(color_scheme="dark" if dark else "light")
            for wide, high in SIZES:
                await page.set_viewport_size({"width": wide, "height": high})
                assert await faults(page) == [], (wide, high, dark)
                assert await page.locator("#map-source").is_visible()
        # Somewhere else there are none, and the page says so.
        await page.click("[data-map=follow]")
        await page.evaluate("window.m100.map.leaflet.setView([10, 10], 19)")
        await shows(page, "#map-source", "No map tiles of this place")


async def test_without_tiles_the_grid_says_how_to_get_them(console: Console) -> None:
    page = await console.open()
    await shows(page, "#map-source", "m100link map download")
    assert await page.locator(".leaflet-tile-pane canvas").count() > 0
