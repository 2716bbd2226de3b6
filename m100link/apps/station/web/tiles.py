"""Map tiles: pictures of the ground in an MBTiles file, which the station serves.

An MBTiles file is SQLite (https://github.com/mapbox/mbtiles-spec, 1.3). It counts rows from the
south; addresses and this module count them from the north (XYZ, as OpenStreetMap's
https://wiki.openstreetmap.org/wiki/Slippy_map_tilenames). ``m100link map`` fills such a file. The
station only reads it, and asks nobody else for a tile.
"""

from __future__ import annotations

import asyncio
import html
import math
import queue
import re
import sqlite3
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from contextlib import closing
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from m100link.errors.texts import read_path
from m100link.log.folder import state_folder

if TYPE_CHECKING:
    from starlette.types import Receive, Scope, Send

T = TypeVar("T")

MOST_BYTES = 1_000_000  # of a tile; usual ones have 5 to 100 kB
MOST_ZOOM = 22
_MOST_PIXELS = 1024  # of a side: a small file may stand for a picture that fills a memory

READ_S = 0.5
"""Seconds that a question may keep SQLite busy: a file may hold a view that never ends."""

PATIENCE_S = 2.0  # seconds that a client waits for a disk
_PLACES = 64  # questions that wait for it: two pages full of tiles

_LONGEST_LICENCE = 300

_READS = sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ
_FUNCTIONS = "length", "min", "max", "count"


class Tile(NamedTuple):
    """A square of the Web Mercator map: 2^zoom columns from the west, rows from the north."""

    zoom: int
    column: int
    row: int

    @property
    def stored(self) -> tuple[int, int, int]:
        """Zoom, column and row as an MBTiles file has them, with rows from the south."""
        return self.zoom, self.column, (1 << self.zoom) - 1 - self.row

    @property
    def exists(self) -> bool:
        side = 1 << self.zoom if 0 <= self.zoom <= MOST_ZOOM else 0
        return 0 <= self.column < side and 0 <= self.row < side


def tile_at(latitude_deg: float, longitude_deg: float, zoom: int) -> Tile:
    """The tile of a place, degrees; beyond 85.05° north or south the last one."""
    side = 1 << zoom
    east = (longitude_deg + 180.0) / 360.0
    north = math.asinh(math.tan(math.radians(max(-89.0, min(89.0, latitude_deg))))) / math.pi
    at = (int(max(0.0, min(side - 1, part * side))) for part in (east, (1.0 - north) / 2.0))
    return Tile(zoom, *at)


def default_tiles() -> Path:
    """The file that ``m100link map`` fills and the station serves, in the folder of the state."""
    return state_folder() / "map.mbtiles"


# -- pictures --------------------------------------------------------------------------------------


def picture_type(data: object) -> str | None:
    """The media type of a PNG, JPEG or WebP of a tile's size, by its own bytes; else None."""
    if not isinstance(data, bytes) or len(data) > MOST_BYTES:
        return None
    if data[:8] == b"\x89PNG\r\n\x1a\n" and data[12:16] == b"IHDR":
        kind, size = "png", (_big(data, 16, 4), _big(data, 20, 4))
    elif data[:2] == b"\xff\xd8":
        kind, size = "jpeg", _size_of_jpeg(data)
    elif data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        kind, size = "webp", _size_of_webp(data)
    else:
        return None
    return f"image/{kind}" if all(0 < one <= _MOST_PIXELS for one in size) else None


def _big(data: bytes, at: int, size: int) -> int:
    return int.from_bytes(data[at : at + size], "big")


def _size_of_jpeg(data: bytes) -> tuple[int, int]:
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):  # a start of frame
            return _big(data, at + 7, 2), _big(data, at + 5, 2)
        at += 1 if marker == 0xFF else 2 + max(2, _big(data, at + 2, 2))
    return 0, 0


def _size_of_webp(data: bytes) -> tuple[int, int]:
    form, head = data[12:16], data[16:32].ljust(16, b"\0")
    if form == b"VP8X":
        return 1 + int.from_bytes(head[8:11], "little"), 1 + int.from_bytes(head[11:14], "little")
    if form == b"VP8L":
        bits = int.from_bytes(head[5:9], "little")
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    size = int.from_bytes(head[10:14], "little") if form == b"VP8 " else 0
    return size & 0x3FFF, size >> 16 & 0x3FFF


# -- reading a file of strangers -------------------------------------------------------------------


def open_to_read(path: Path, seconds: float = READ_S) -> sqlite3.Connection:
    """The file, for reads that end: none takes longer, or makes a value larger than a tile.

    Raises ``sqlite3.Error``: it is not there, or SQLite cannot open it.
    """
    file = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=0.3)
    file.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, 2 * MOST_BYTES)
    file.execute("PRAGMA trusted_schema = OFF")
    # SQLite looks at the clock between two steps, and a call of instr() with a megabyte, in a view
    # of the file, is a step of hours.
    file.set_authorizer(_authorize)
    until = time.monotonic() + seconds
    file.set_progress_handler(lambda: time.monotonic() > until, 1_000)
    return file


def _authorize(action: int, _: str | None, name: str | None, *__: str | None) -> int:
    is_ours = action in _READS or (action == sqlite3.SQLITE_FUNCTION and name in _FUNCTIONS)
    return sqlite3.SQLITE_OK if is_ours else sqlite3.SQLITE_DENY


def read_metadata(file: sqlite3.Connection) -> dict[str, str]:
    """The metadata of an MBTiles file. Raises ``sqlite3.Error``: it has no such table."""
    rows = file.execute("SELECT name, value FROM metadata LIMIT 100")
    return {str(name): str(value) for name, value in rows}


def licence_of(metadata: Mapping[str, str]) -> str:
    """The attribution as plain text: in an MBTiles file it may be HTML."""
    plain = html.unescape(re.sub(r"<[^>]*>", "", metadata.get("attribution", "")))
    return " ".join(plain.split())[:_LONGEST_LICENCE]


class TileFault(StrEnum):
    """The reason why a page has no tiles; ``browser.tiles_<value>`` says it."""

    NONE = "none"  # there is no file
    DISK = "disk"  # it does not answer
    FILE = "file"  # no MBTiles, or a damaged one
    VECTOR = "vector"  # its tiles are no pictures


class Pictures(NamedTuple):
    zooms: tuple[int, int] | None = None  # the least and greatest zoom; None with a fault
    licence: str = ""
    version: int = 0  # another one with each change of the file
    fault: TileFault | None = None


class MapTiles:
    """An ASGI application: the tiles of a file, under ``…/{zoom}/{column}/{row}``.

    One thread reads the file. When its disk stands still, clients get no tiles, and everything else
    goes on. It may be written or replaced meanwhile.
    """

    def __init__(self, path: Path | None = None) -> None:
        self.path = default_tiles() if path is None else read_path(path)
        self.pictures: Pictures | None = None  # as they were looked at last
        self._asked: queue.Queue[tuple[Callable[[], Any], Future[Any]]] = queue.Queue(_PLACES)
        self._thread: threading.Thread | None = None
        # Nobody waits for a disk twice: a browser has six connections, and needs them for the page.
        self._is_stuck = False

    async def look(self) -> None:
        self.pictures = await self._ask(
            self._described, Pictures(fault=TileFault.DISK), Pictures(fault=TileFault.FILE)
        )

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer with a tile; 404 where there is none, 503 when the disk does not answer."""
        found = re.search(r"/([0-9]{1,2})/([0-9]{1,7})/([0-9]{1,7})$", scope["path"], re.ASCII)
        tile = Tile(*map(int, found.groups())) if found else Tile(-1, 0, 0)
        status, data = 404, b""
        if scope["method"] in ("GET", "HEAD") and tile.exists:
            status, data = await self._ask(lambda: self._read(tile), (503, b""), (503, b""))
        headers = {"content-length": str(len(data)), "cache-control": "no-store"}
        if kind := picture_type(data):
            # The page names the version of the file in the address.
            headers |= {"content-type": kind, "cache-control": "private, max-age=604800, immutable"}
        raw = [(name.encode(), value.encode()) for name, value in headers.items()]
        await send({"type": "http.response.start", "status": status, "headers": raw})
        await send({"type": "http.response.body", "body": data})

    async def _ask(self, work: Callable[[], T], no_disk: T, no_file: T) -> T:
        if self._is_stuck:
            return no_disk
        if self._thread is None:
            self._thread = threading.Thread(target=self._answer, name="map tiles", daemon=True)
            self._thread.start()
        done: Future[T] = Future()
        try:
            self._asked.put_nowait((work, done))
            async with asyncio.timeout(PATIENCE_S):
                return await asyncio.wrap_future(done)
        except TimeoutError:
            self._is_stuck = True
            return no_disk
        except queue.Full:
            return no_disk
        except Exception:  # noqa: BLE001 (SQLite raises many kinds for the bytes of a stranger)
            return no_file

    def _answer(self) -> None:
        while True:
            work, done = self._asked.get()
            if done.set_running_or_notify_cancel():  # else its client waits no more
                try:
                    done.set_result(work())
                except BaseException as error:  # noqa: BLE001 (the one who asks gets it)
                    done.set_exception(error)
            self._is_stuck = False

    def _read(self, tile: Tile) -> tuple[int, bytes]:
        with closing(open_to_read(self.path)) as file:
            found = file.execute(
                "SELECT tile_data FROM tiles WHERE zoom_level = ? AND tile_column = ? "
                "AND tile_row = ? AND length(tile_data) <= ? LIMIT 1",
                (*tile.stored, MOST_BYTES),
            ).fetchone()
        return (200, found[0]) if found and picture_type(found[0]) else (404, b"")

    def _described(self) -> Pictures:
        try:
            version = self.path.stat().st_mtime_ns
        except FileNotFoundError:
            return Pictures(fault=TileFault.NONE)
        with closing(open_to_read(self.path)) as file:
            said = read_metadata(file)
            if said.get("format") == "pbf":
                return Pictures(fault=TileFault.VECTOR)
            zooms = [int(said[name]) for name in ("minzoom", "maxzoom") if name in said]
            if len(zooms) < 2:
                query = "SELECT min(zoom_level), max(zoom_level) FROM tiles"
                zooms = list(file.execute(query).fetchone())
        low, high = (max(0, min(MOST_ZOOM, int(zoom))) for zoom in zooms)
        return Pictures((low, high), licence_of(said), version)
