"""Tiles lie where they belong; a video is shown, swapped, and never more than it is."""

from __future__ import annotations

import asyncio
import contextlib
import io
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from m100link.apps.station.web.tiles import Tile, tile_at
from tests.apps.station.web.test_tiles import mbtiles, png
from tests.browser.boxes import SIZES, faults, steady
from tests.browser.conftest import ARGUMENTS, CHROMIUM, Console, console_in_browser, until
from tests.browser.operator import fold, look_at, shows

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


# -- video -----------------------------------------------------------------------------------------


IS_FIRST = "document.body.classList.contains('video-first')"


class Camera:
    """A stream of JPEG pictures by HTTP, as mjpg-streamer sends them."""

    status = "200 OK"
    is_running = True
    has_cors = True
    has_length = True
    asked = 0
    path = ""

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.asked += 1
        with contextlib.suppress(ConnectionError, asyncio.IncompleteReadError):
            self.path = (await reader.readuntil(b"\r\n\r\n")).split()[1].decode()
            cors = "Access-Control-Allow-Origin: *\r\n" if self.has_cors else ""
            kind = "Content-Type: multipart/x-mixed-replace;boundary=b\r\nConnection: close\r\n"
            writer.write(f"HTTP/1.1 {self.status}\r\n{cors}{kind}\r\n".encode())
            count = 0
            while self.status.startswith("200"):
                if self.is_running:
                    count += 1
                    stream = io.BytesIO()
                    Image.new("RGB", (320, 240), (250, count % 250, 0)).save(stream, "JPEG")
                    data = stream.getvalue()
                    length = f"Content-Length: {len(data)}\r\n" if self.has_length else ""
                    head = f"--b\r\nContent-Type: image/jpeg\r\n{length}\r\n"
                    writer.write(head.encode() + data + b"\r\n")
                    await writer.drain()
                await asyncio.sleep(0.1)
        writer.close()


@contextlib.asynccontextmanager
async def filmed(browser: Any) -> AsyncIterator[tuple[Console, Camera]]:
    camera = Camera()
    server = await asyncio.start_server(camera.serve, "127.0.0.1", 0)
    url = f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}"
    video = f"{url}/stream?key=secret"
    async with server, console_in_browser(browser, "--video", video) as console:
        yield console, camera
        console.foreign = [one for one in console.foreign if not one.startswith(url)]


async def is_state(page: Any, state: str) -> None:
    """Whether it is live, without a word; or what is wrong, with one."""
    await page.wait_for_function(
        "(state) => { const picture = document.querySelector('#picture');"
        " return picture.dataset.state === state && !picture.textContent === (state === 'live'); }",
        arg=state,
    )


async def test_a_video_is_shown_swapped_and_says_its_age(browser: Any) -> None:
    async with filmed(browser) as (console, camera):
        page = await console.open()
        await is_state(page, "live")
        assert camera.path == "/stream?key=secret"
        for is_first in (False, True):
            for wide, high in SIZES:
                await page.set_viewport_size({"width": wide, "height": high})
                await fold(page, "video", is_shown=True)
                await steady(page)
                if is_first is not await page.evaluate(
                    "document.body.classList.contains('video-first')"
                ):
                    await page.click("#video")
                assert await faults(page) == [], (wide, high, is_first)
                areas = await page.evaluate(
                    "['#picture', '#map-frame'].map((one) => document.querySelector(one)"
                    ".getBoundingClientRect()).map(({width, height}) => width * height)"
                )
                assert (areas[0] > areas[1]) is is_first, (wide, high, areas)
        await look_at(page, "events")
        await shows(page, "#events", "a page shows it")
        assert "secret" not in await page.inner_text("#events")
        await look_at(page, "fly")
        await is_state(page, "live")
        # It stands still: it says since when, is grey, and covers nothing.
        camera.is_running = False
        await is_state(page, "old")
        await shows(page, "#picture .state", "last picture")
        assert await faults(page) == []
        camera.is_running = True
        await is_state(page, "live")
        camera.status = "403 Forbidden"
        await page.click("[data-fold=video]")
        await page.click("[data-fold=video]")
        await shows(page, "#picture .state", "No video: 403")


async def test_a_camera_that_no_page_may_read_is_shown_without_an_age(browser: Any) -> None:
    async with filmed(browser) as (console, camera):
        camera.has_cors = False
        page = await console.open()
        await is_state(page, "undated")
        await shows(page, "#picture .state", "age of the picture unknown")
        assert await page.evaluate("document.querySelector('#picture img').naturalWidth") == 320


async def test_pictures_without_a_length_are_found(browser: Any) -> None:
    async with filmed(browser) as (console, camera):
        camera.has_length = False
        page = await console.open()
        await is_state(page, "live")


ANSWER = """async (offer) => {
  const canvas = document.body.appendChild(document.createElement("canvas"));
  const drawing = canvas.getContext("2d");
  let count = 0;
  window.drawing = setInterval(() => { drawing.fillRect(count++ % 300, 0, 5, 90); }, 50);
  window.peer = new RTCPeerConnection();
  canvas.captureStream(20).getTracks().forEach((track) => window.peer.addTrack(track));
  await window.peer.setRemoteDescription({type: "offer", sdp: offer});
  await window.peer.setLocalDescription();
  await new Promise((done) => {
    window.peer.onicecandidate = ({candidate}) => candidate || done();
    setTimeout(done, 2000);
  });
  return window.peer.localDescription.sdp;
}"""


async def test_a_video_by_whep_is_shown_and_ended() -> None:
    from playwright.async_api import async_playwright

    asked: list[str] = []
    async with async_playwright() as started:
        more = "--disable-features=WebRtcHideLocalIpsWithMdns"
        browser = await started.chromium.launch(executable_path=CHROMIUM, args=[*ARGUMENTS, more])
        url = "http://camera.test:8889/front/whep"
        async with console_in_browser(browser, "--video", url) as console:
            other = await console.context.new_page()

            async def answer(route: Any) -> None:
                request = route.request
                asked.append(request.method)
                headers = {
                    "access-control-allow-origin": "*",
                    "access-control-allow-methods": "POST, DELETE",
                    "access-control-allow-headers": "*",
                    "access-control-expose-headers": "location",
                    "location": "/front/whep/1",
                }
                body = ""
                if request.method == "POST":
                    assert request.headers["content-type"] == "application/sdp"
                    body = await other.evaluate(ANSWER, request.post_data)
                status = {"POST": 201, "OPTIONS": 204}.get(request.method, 200)
                await route.fulfill(status=status, headers=headers, body=body)

            await console.context.route("http://camera.test:8889/**", answer)
            page = await console.open()
            await is_state(page, "live")
            await other.evaluate("clearInterval(window.drawing), window.peer.close()")
            await is_state(page, "old")
            await fold(page, "video", is_shown=False)
            await until(lambda: "DELETE" in asked)
            console.foreign = [one for one in console.foreign if "camera.test" not in one]
        await browser.close()
