"""``m100link map``: tiles for the console's map, fetched before the flight."""

from __future__ import annotations

import http.client
import math
import re
import sqlite3
import sys
import threading
import time
import urllib.error
import urllib.request
from collections import Counter
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from itertools import islice
from pathlib import Path
from typing import Annotated
from urllib.parse import urlsplit

from cyclopts import Parameter, validators

import m100link
from m100link.apps.cli.options import Above0, Counted, attribute_texts, group
from m100link.apps.cli.plan import degrees
from m100link.apps.cli.terminal import tell
from m100link.apps.station.config import Settings
from m100link.apps.station.web.tiles import (
    MOST_BYTES,
    MOST_ZOOM,
    Tile,
    default_tiles,
    licence_of,
    picture_type,
    read_metadata,
    tile_at,
)
from m100link.errors import Unreachable, UsageError
from m100link.geodesy import LocalFrame

app = group("map", "Fetch tiles for the console's map, before the flight.")

_CONNECTIONS = 2  # as many as OpenStreetMap's policy for tiles takes well
_AT_ONCE = 16  # tiles that are written together
_SILENCE_S = 15.0  # in which a server has to send something
_TRIES = 3
_LONGEST_PAUSE_S = 60.0
_DEGREE_M = 111_320.0  # of latitude, and of longitude at the equator

Zoom = Annotated[int, Parameter(validator=validators.Number(gte=0, lte=MOST_ZOOM))]
Tiles = Annotated[
    Path | None,
    Parameter(name="--tiles", help=" ".join(attribute_texts(Settings)["tiles"].split())),
]


# -- the file --------------------------------------------------------------------------------------

_TABLES = """
CREATE TABLE IF NOT EXISTS metadata (name TEXT PRIMARY KEY, value TEXT);
CREATE TABLE IF NOT EXISTS tiles (zoom_level INTEGER, tile_column INTEGER, tile_row INTEGER,
    tile_data BLOB, PRIMARY KEY (zoom_level, tile_column, tile_row));
"""


@contextmanager
def _writing(path: Path) -> Iterator[sqlite3.Connection]:
    """The file, made if there is none. A program that is killed leaves whole tiles in it.

    Raises ``UsageError``: it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with closing(sqlite3.connect(path, timeout=10.0)) as file:
            file.executescript(_TABLES)
            yield file
    except (sqlite3.Error, OSError) as error:
        raise UsageError(
            f"{path} cannot be written: {error}",
            remedy="make room on the disk, or name another file with --tiles",
        ) from error


def _store(file: sqlite3.Connection, pictures: Iterable[tuple[Tile, bytes]]) -> None:
    with file:
        file.executemany(
            "INSERT OR REPLACE INTO tiles VALUES (?, ?, ?, ?)",
            [(*tile.stored, data) for tile, data in pictures],
        )


def _describe(file: sqlite3.Connection, licence: str) -> None:
    """Write what the file holds; it may be of several sources, each with its licence."""
    old = licence_of(read_metadata(file))
    low, high = file.execute("SELECT min(zoom_level), max(zoom_level) FROM tiles").fetchone()
    first = file.execute("SELECT tile_data FROM tiles LIMIT 1").fetchone()
    said = {
        "name": "m100link",
        "type": "baselayer",
        "format": (picture_type(first[0]) or "image/png")[6:].replace("jpeg", "jpg"),
        "minzoom": low,
        "maxzoom": high,
        "attribution": old if licence in old else " | ".join(filter(None, (old, licence))),
    }
    with file:
        for name, value in said.items():
            file.execute("DELETE FROM metadata WHERE name = ?", (name,))
            file.execute("INSERT INTO metadata VALUES (?, ?)", (name, str(value)))


# -- downloads -------------------------------------------------------------------------------------


@app.command
def download(
    url: str,
    /,
    *area: Annotated[str, Parameter(allow_leading_hyphen=True)],
    attribution: str,
    margin: Annotated[float, Above0] = 500.0,
    min_zoom: Zoom = 14,
    max_zoom: Zoom = 19,
    most: Annotated[int, Counted] = 5000,
    tiles: Tiles = None,
) -> int:
    """Fetch the tiles of an area, from a server that you name, into the file of the console's map.

    The command goes on where an earlier one ended. It uses two connections, waits when the server
    asks for it, and stores nothing but PNG, JPEG and WebP. Ask the provider first whether its terms
    allow to fetch an area: many do not.

    Args:
        url: Address with {z}, {x} and {y}, or {-y} for rows from the south (TMS). A folder of files
            is one, too: file:///home/me/tiles/{z}/{x}/{y}.png.
        area: Places in the area, each LATITUDE,LONGITUDE: tiles of the box around them.
        attribution: Licence text of the provider; the map shows it.
        margin: Metres around the places.
        min_zoom: Least zoom; 14 shows some kilometres.
        max_zoom: Greatest zoom; at 19 a pixel is about 0.3 m.
        most: Refuse an area with more tiles.
    """
    server, path = _server_of(url), tiles or default_tiles()
    wanted = _tiles_of(area, margin, range(min_zoom, max_zoom + 1), most)
    licence = licence_of({"attribution": attribution})
    if not licence:
        raise UsageError("--attribution is empty", remedy="the provider's terms say its text")
    count: Counter[str] = Counter()
    with _writing(path) as file:
        there = {
            tuple(row)
            for row in file.execute("SELECT zoom_level, tile_column, tile_row FROM tiles")
        }
        missing = iter([tile for tile in wanted if tile.stored not in there])
        count["present"] = sum(tile.stored in there for tile in wanted)
        stop = threading.Event()
        with ThreadPoolExecutor(_CONNECTIONS) as connections:
            try:
                while some := list(islice(missing, _AT_ONCE)):
                    got = connections.map(lambda tile: _fetch(url, server, tile, stop), some)
                    found = [(tile, data) for tile, data in zip(some, got, strict=True) if data]
                    _store(file, found)
                    count["stored"] += len(found)
                    count["absent"] += len(some) - len(found)
                    sys.stderr.write(f"\r{sum(count.values())} of {len(wanted)} tiles")
            finally:
                stop.set()  # a Ctrl-C does not wait for pauses
                sys.stderr.write("\n")
                if count["stored"] or count["present"]:
                    _describe(file, licence)
    done = ", ".join(f"{number} {name}" for name, number in count.items())
    return tell({"file": str(path), "attribution": licence, **count}, f"{path}: {done}")


def _server_of(url: str) -> str:
    """The server of a template. Raises UsageError: it cannot be one."""
    names = set(re.findall(r"\{([^}]*)\}", url))
    parts = urlsplit(url)
    server = "the folder" if parts.scheme == "file" else parts.hostname
    if parts.scheme not in ("http", "https", "file") or not server:
        raise UsageError("the address of the tiles is none", remedy="https://host/{z}/{x}/{y}.png")
    if names not in ({"z", "x", "y"}, {"z", "x", "-y"}):
        raise UsageError(
            f"the address of the tiles has {', '.join(sorted(names)) or 'nothing'} in braces",
            remedy="it needs {z}, {x} and {y}; {-y} for rows from the south. For {s} write one of "
            "the provider's names",
        )
    return server


def _tiles_of(area: tuple[str, ...], margin: float, zooms: range, most: int) -> list[Tile]:
    """The tiles of an area. Raises UsageError: there are none, or more than so many."""
    places = [degrees("a place", word, LocalFrame) for word in area]
    if not places or not zooms:
        raise UsageError(
            "the area has no tile", remedy="name a LATITUDE,LONGITUDE, and the lower zoom first"
        )
    north = margin / _DEGREE_M
    latitudes, longitudes = zip(*places, strict=True)
    south_edge, north_edge = min(latitudes) - north, max(latitudes) + north
    east = north / max(0.01, math.cos(math.radians(max(abs(south_edge), abs(north_edge)))))
    west_edge, east_edge = min(longitudes) - east, max(longitudes) + east
    boxes = []
    for zoom in zooms:
        first, last = tile_at(north_edge, west_edge, zoom), tile_at(south_edge, east_edge, zoom)
        boxes.append((zoom, range(first.column, last.column + 1), range(first.row, last.row + 1)))
    count = sum(len(columns) * len(rows) for _, columns, rows in boxes)
    if count > most:
        raise UsageError(
            f"the area has {count} tiles at zoom {zooms[0]} to {zooms[-1]}: more than {most}",
            remedy="choose a smaller area or --max-zoom, or raise --most if the provider allows it",
        )
    return [Tile(zoom, x, y) for zoom, columns, rows in boxes for x in columns for y in rows]


def _fetch(url: str, server: str, tile: Tile, stop: threading.Event) -> bytes | None:
    """A tile; None where the server has none. Raises UsageError, Unreachable."""
    address = url.replace("{z}", str(tile.zoom)).replace("{x}", str(tile.column))
    address = address.replace("{y}", str(tile.row)).replace("{-y}", str(tile.stored[2]))
    agent = f"m100link/{m100link.__version__} (map download)"
    request = urllib.request.Request(address, headers={"User-Agent": agent, "Accept": "image/*"})
    why = ""
    for attempt in range(1, _TRIES + 1):
        try:
            with urllib.request.urlopen(request, timeout=_SILENCE_S) as answer:
                data = _body_of(answer)
            if answer.status == http.HTTPStatus.NO_CONTENT:
                return None
            if picture_type(data) is None:
                raise UsageError(
                    f"{server} answered with something else than a small PNG, JPEG or WebP",
                    cause="the address, a key in it, or a login page between",
                    remedy="open the address of one tile in a browser",
                )
            return data
        except urllib.error.HTTPError as error:
            error.close()
            if error.code in (404, 410):
                return None
            if error.code not in (429, 500, 502, 503, 504):
                raise UsageError(
                    f"{server} refuses tiles: {error.code} {error.reason}",
                    remedy="look at the address, its key, and the provider's terms",
                ) from error
            why, pause = f"{error.code} {error.reason}", error.headers.get("Retry-After", "")
        except (OSError, http.client.HTTPException) as error:
            if isinstance(getattr(error, "reason", None), FileNotFoundError):
                return None
            why, pause = f"{getattr(error, 'reason', error)}", ""
        if attempt < _TRIES:
            seconds = float(pause) if pause.isdecimal() else 2.0**attempt
            if stop.wait(min(seconds, _LONGEST_PAUSE_S)):
                break
    raise Unreachable(
        f"{server} gave no tile in {_TRIES} attempts: {why}",
        remedy="the same command goes on later with the tiles that are missing",
    )


def _body_of(answer: http.client.HTTPResponse) -> bytes:
    """The body, up to a byte too many. Raises ``TimeoutError``: it does not end."""
    data, until = b"", time.monotonic() + 2 * _SILENCE_S
    while len(data) <= MOST_BYTES and (part := answer.read1(1 << 16)):
        data += part
        if time.monotonic() > until:
            raise TimeoutError("the answer does not end")
    return data
