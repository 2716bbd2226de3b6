"""Tiles of a file: at the right place, pictures alone, and whatever file or disk it is."""

from __future__ import annotations

import asyncio
import os
import random
import sqlite3
import struct
import time
import zlib
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from m100link.apps.station.web import tiles
from m100link.apps.station.web.tiles import (
    MapTiles,
    Pictures,
    Tile,
    TileFault,
    default_tiles,
    licence_of,
    picture_type,
    tile_at,
)
from tests.waiting import again_and_again

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


def png(width: int = 256, height: int = 256, shade: int = 128) -> bytes:
    """A grey picture, as the PNG specification has it."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    rows = (b"\0" + bytes([shade]) * width) * height
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    parts = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + parts


def mbtiles(path: Path, rows: dict[tuple[int, int, int], Any], **metadata: object) -> Path:
    """An MBTiles file, as its specification 1.3 has it."""
    with closing(sqlite3.connect(path)) as file, file:
        file.execute("CREATE TABLE metadata (name text, value text)")
        file.execute(
            "CREATE TABLE tiles (zoom_level integer, tile_column integer, tile_row integer, "
            "tile_data blob)"
        )
        file.executemany("INSERT INTO metadata VALUES (?, ?)", metadata.items())
        file.executemany(
            "INSERT INTO tiles VALUES (?, ?, ?, ?)", [(*key, data) for key, data in rows.items()]
        )
    return path


async def ask(app: MapTiles, path: str, method: str = "GET") -> tuple[int, dict[str, str], bytes]:
    sent: list[Any] = []

    async def send(message: Any) -> None:
        sent.append(message)

    async def receive() -> Any:
        raise AssertionError("nothing is read")

    await app({"type": "http", "method": method, "path": path}, receive, send)
    headers = {name.decode(): value.decode() for name, value in sent[0]["headers"]}
    return sent[0]["status"], headers, sent[1]["body"]


# -- places ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("place", "zoom", "tile"),
    [
        # Google's documentation of map coordinates: Chicago, pixel (525, 761) at zoom 3.
        ((41.85, -87.65), 3, (2, 2)),
        # OpenStreetMap's wiki, "Slippy map tilenames": the tile of a whole world, and its corners.
        ((0.0, 0.0), 0, (0, 0)),
        ((85.0511, -180.0), 1, (0, 0)),
        ((-85.0511, 179.999), 1, (1, 1)),
        ((0.0001, -0.0001), 1, (0, 0)),
        ((-0.0001, 0.0001), 1, (1, 1)),
        # Beyond the map: its edge.
        ((90.0, 180.0), 4, (15, 0)),
        ((-90.0, -180.0), 4, (0, 15)),
    ],
)
def test_a_place_has_the_tile_of_the_slippy_map(
    place: tuple[float, float], zoom: int, tile: tuple[int, int]
) -> None:
    assert tile_at(*place, zoom) == (zoom, *tile)


def test_a_file_counts_rows_from_the_south() -> None:
    # MBTiles 1.3: "the tile with XYZ coordinates 11/327/791 is inserted as 11, 327, 1256".
    assert Tile(11, 327, 791).stored == (11, 327, 1256)
    seed = 34
    chance = random.Random(seed)
    for _ in range(200):
        zoom = chance.randrange(23)
        tile = Tile(zoom, chance.randrange(1 << zoom), chance.randrange(1 << zoom))
        assert Tile(*tile.stored).stored == tile, seed
        assert tile.exists, seed


async def test_the_row_that_is_asked_for_from_the_north_is_read_from_the_south(
    tmp_path: Path,
) -> None:
    north, south = png(shade=10), png(shade=200)
    file = mbtiles(tmp_path / "map", {(11, 327, 1256): north, (11, 327, 791): south})
    app = MapTiles(file)
    assert (await ask(app, "/tiles/11/327/791"))[2] == north
    assert (await ask(app, "/tiles/11/327/1256"))[2] == south


# -- pictures --------------------------------------------------------------------------------------

JPEG = bytes.fromhex("ffd8ffe000104a46494600010100000100010000 ffc0000b08") + struct.pack(
    ">HHB", 256, 512, 1
)
WEBP = {
    "lossy": b"VP8 " + bytes(10) + struct.pack("<HH", 256, 512),
    "lossless": b"VP8L" + bytes(4) + b"\x2f" + struct.pack("<I", 255 | 511 << 14),
    "extended": b"VP8X" + bytes(8) + b"\xff\0\0\xff\x01\0",
}


def webp(body: bytes) -> bytes:
    return b"RIFF" + struct.pack("<I", len(body) + 4) + b"WEBP" + body


def test_the_bytes_of_a_picture_say_what_it_is() -> None:
    assert picture_type(png()) == "image/png"
    assert picture_type(JPEG + bytes(20)) == "image/jpeg"
    assert {picture_type(webp(body)) for body in WEBP.values()} == {"image/webp"}


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"<html><script>alert(1)</script></html>",
        b"GIF89a" + bytes(50),
        b"<svg xmlns='http://www.w3.org/2000/svg'/>",
        png()[:20],
        png() + bytes(1_000_000),
        png(40_000, 1),
        b"\x89PNG\r\n\x1a\n" + bytes(4) + b"IHDR" + struct.pack(">II", 65_535, 65_535),
        JPEG.replace(struct.pack(">HH", 256, 512), struct.pack(">HH", 65_000, 512)),
        JPEG.replace(struct.pack(">HH", 256, 512), struct.pack(">HH", 256, 65_000)),
        b"\xff\xd8" + b"\xff" * 5000,
        b"\xff\xd8" + b"\xff\xe0\0\0" * 5000,
        webp(WEBP["extended"].replace(b"\xff\0\0", b"\xff\xff\xff")),
        webp(b"VP9X" + bytes(20)),
        "text",
        None,
        7,
    ],
    ids=lambda data: repr(data)[:24],
)
def test_nothing_else_is_a_picture(data: object) -> None:
    assert picture_type(data) is None


def test_no_bytes_raise_out_of_the_look_at_them() -> None:
    seed = 35
    chance = random.Random(seed)
    whole = [png(), JPEG + bytes(20), *(webp(body) + bytes(8) for body in WEBP.values())]
    for _ in range(3000):
        data = bytearray(chance.choice(whole)[: chance.randrange(60)])
        for _ in range(chance.randrange(4)):
            if data:
                data[chance.randrange(len(data))] = chance.randrange(256)
        assert picture_type(bytes(data)) in (None, "image/png", "image/jpeg", "image/webp"), seed


# -- what is served --------------------------------------------------------------------------------


async def test_a_tile_is_served_as_what_it_is_and_kept_by_browsers(tmp_path: Path) -> None:
    app = MapTiles(mbtiles(tmp_path / "map", {(1, 0, 0): JPEG + bytes(9)}, format="png"))
    status, headers, body = await ask(app, "/tiles/1/0/1")
    assert (status, body) == (200, JPEG + bytes(9))
    assert headers["content-type"] == "image/jpeg"
    assert headers["content-length"] == str(len(body))
    assert headers["cache-control"] == "private, max-age=604800, immutable"


@pytest.mark.parametrize(
    "path",
    [
        "/tiles/1/0/1",  # not there
        "/tiles/1/2/0",  # beyond the map
        "/tiles/23/0/0",
        "/tiles/99/9999999/9999999",
        "/tiles/1/0/0.png",
        "/tiles/-1/0/0",
        "/tiles/1/0/²",
        "/tiles/١/0/0",
        "/tiles/../../etc/passwd",
        "/tiles/1/0/" + "9" * 5000,
        "/tiles/1/0/0%20OR%201=1",
        "/tiles/",
        "",
    ],
)
async def test_what_is_no_tile_is_not_found(path: str, tmp_path: Path) -> None:
    app = MapTiles(mbtiles(tmp_path / "map", {(1, 0, 1): png()}))
    status, headers, body = await ask(app, path)
    assert (status, body, headers["cache-control"]) == (404, b"", "no-store")


@pytest.mark.parametrize("data", [b"<html>", "text", 7, None, png() + bytes(1_000_000)])
async def test_a_row_that_is_no_picture_is_not_served(data: object, tmp_path: Path) -> None:
    app = MapTiles(mbtiles(tmp_path / "map", {(0, 0, 0): data}))
    assert (await ask(app, "/tiles/0/0/0"))[0] == 404


async def test_a_picture_of_a_hundred_megabytes_is_not_even_read(tmp_path: Path) -> None:
    file = mbtiles(tmp_path / "map", {(0, 0, 0): b""})
    with closing(sqlite3.connect(file)) as made, made:
        made.execute("UPDATE tiles SET tile_data = zeroblob(100000000)")
    app = MapTiles(file)
    began = time.thread_time()
    assert (await ask(app, "/tiles/0/0/0"))[0] in (404, 503)
    assert time.thread_time() - began < 0.5


HOSTILE = {
    "endless": "CREATE VIEW tiles AS WITH RECURSIVE n(i) AS "
    "(SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT 0 AS zoom_level, "
    "0 AS tile_column, i AS tile_row, x'00' AS tile_data FROM n",
    "bomb": "CREATE VIEW tiles AS SELECT 0 AS zoom_level, 0 AS tile_column, 0 AS tile_row, "
    "zeroblob(900000000) AS tile_data",
    "itself": "CREATE VIEW tiles AS SELECT * FROM tiles",
    "other columns": "CREATE TABLE tiles (a)",
    "nothing": "CREATE TABLE other (a)",
    "one step of hours": "CREATE VIEW tiles AS SELECT 0 AS zoom_level, 0 AS tile_column, "
    "0 AS tile_row, instr(zeroblob(1000000), zeroblob(600000) || x'01') AS tile_data",
    "long steps": "CREATE VIEW tiles AS WITH RECURSIVE n(i, y) AS (SELECT 1, zeroblob(900000) "
    "UNION ALL SELECT i + 1, y || '' FROM n) SELECT 0 AS zoom_level, 0 AS tile_column, "
    "0 AS tile_row, y AS tile_data FROM n WHERE i < 0",
    "many": "CREATE VIEW tiles AS SELECT 'x' AS zoom_level, 1e300 AS tile_column, 9 AS tile_row, "
    "randomblob(9) AS tile_data",
}


@pytest.mark.parametrize("name", HOSTILE)
async def test_a_hostile_file_ends_in_an_answer(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tiles, "READ_S", 0.05)
    monkeypatch.setattr(tiles.open_to_read, "__defaults__", (0.05,))
    with closing(sqlite3.connect(tmp_path / "map")) as file, file:
        file.execute("CREATE TABLE metadata (name, value)")
        file.execute(HOSTILE[name])
    app = MapTiles(tmp_path / "map")
    assert (await ask(app, "/tiles/0/0/0"))[0] in (404, 503)
    await app.look()
    assert app.pictures is not None
    assert app.pictures.fault is TileFault.FILE
    assert (await ask(app, "/tiles/0/0/0"))[0] in (404, 503)


async def test_a_view_of_tables_is_read_as_a_table(tmp_path: Path) -> None:
    """MBTiles 1.3 allows it: files of ``tippecanoe`` keep each picture once."""
    file = mbtiles(tmp_path / "map", {(0, 0, 0): png()})
    with closing(sqlite3.connect(file)) as made, made:
        made.execute("ALTER TABLE tiles RENAME TO images")
        made.execute("CREATE VIEW tiles AS SELECT a.* FROM images a JOIN images b USING (tile_row)")
    app = MapTiles(file)
    assert (await ask(app, "/tiles/0/0/0"))[0] == 200
    await app.look()
    assert app.pictures is not None
    assert app.pictures.zooms == (0, 0)


async def test_a_place_that_waits_for_a_writer_costs_tiles_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A named pipe: its reader waits until somebody opens it for writing."""
    monkeypatch.setattr(tiles, "PATIENCE_S", 0.05)
    os.mkfifo(tmp_path / "map")
    app = MapTiles(tmp_path / "map")
    assert [(await ask(app, "/tiles/0/0/0"))[0] for _ in range(3)] == [503] * 3
    os.close(os.open(tmp_path / "map", os.O_WRONLY))  # its thread goes on, and ends nothing


@pytest.mark.parametrize("damage", ["junk", "cut", "folder", "none", "text"])
async def test_a_file_that_is_none_gives_no_tile(damage: str, tmp_path: Path) -> None:
    path = tmp_path / "map"
    if damage == "junk":
        path.write_bytes(random.Random(36).randbytes(50_000))
    elif damage == "cut":
        whole = mbtiles(path, {(0, 0, 0): png()}).read_bytes()
        path.write_bytes(whole[: len(whole) // 2])
    elif damage == "folder":
        path.mkdir()
    elif damage == "text":
        path.write_text("https://tiles.example")
    app = MapTiles(path)
    status, _, body = await ask(app, "/tiles/0/0/0")
    assert (status, body) == (503, b"")
    await app.look()
    assert app.pictures is not None
    assert app.pictures.zooms is None
    assert app.pictures.fault is (TileFault.NONE if damage == "none" else TileFault.FILE)


async def test_damaged_files_raise_nothing(tmp_path: Path) -> None:
    seed = 37
    chance = random.Random(seed)
    path = tmp_path / "map"
    whole = mbtiles(path, {(2, x, y): png(8, 8) for x in range(4) for y in range(4)}).read_bytes()
    app = MapTiles(path)
    for _ in range(60):
        data = bytearray(whole)
        for _ in range(chance.randrange(1, 30)):
            data[chance.randrange(len(data))] = chance.randrange(256)
        path.write_bytes(data)
        assert (await ask(app, "/tiles/2/1/1"))[0] in (200, 404, 503), seed
        await app.look()


async def test_a_locked_file_is_not_waited_for(tmp_path: Path) -> None:
    app = MapTiles(mbtiles(tmp_path / "map", {(0, 0, 0): png()}))
    with closing(sqlite3.connect(app.path)) as other:
        other.execute("BEGIN EXCLUSIVE")
        assert (await ask(app, "/tiles/0/0/0"))[0] == 503
    assert (await ask(app, "/tiles/0/0/0"))[0] == 200


async def test_a_file_that_is_replaced_or_filled_is_read_anew(tmp_path: Path) -> None:
    app = MapTiles(tmp_path / "map")
    await app.look()
    assert app.pictures == Pictures(fault=TileFault.NONE)
    mbtiles(tmp_path / "map", {(3, 0, 0): png(), (5, 0, 0): png()}, attribution="© Anna")
    await app.look()
    assert app.pictures.zooms == (3, 5)
    assert (await ask(app, "/tiles/3/0/7"))[0] == 200
    mbtiles(tmp_path / "new", {(4, 0, 0): png(shade=1)}, minzoom=4, maxzoom=4)
    (tmp_path / "new").replace(tmp_path / "map")
    before = app.pictures.version
    await app.look()
    assert app.pictures.zooms == (4, 4)
    assert app.pictures.version != before
    assert (await ask(app, "/tiles/3/0/7"))[0] == 404


async def test_a_disk_that_stands_still_costs_tiles_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A FIFO without a writer holds up its reader, as a disk that stands still does.
    os.mkfifo(tmp_path / "map")
    monkeypatch.setattr(tiles, "PATIENCE_S", 0.05)
    app = MapTiles(tmp_path / "map")
    open_as_before = tiles.open_to_read
    monkeypatch.setattr(tiles, "open_to_read", lambda path: path.open("rb").close())
    asked = [asyncio.create_task(ask(app, "/tiles/0/0/0")) for _ in range(200)]
    assert {(await one)[0] for one in asked} == {503}
    monkeypatch.setattr(tiles, "PATIENCE_S", 1e6)  # nobody waits for it again
    assert (await ask(app, "/tiles/0/0/0"))[0] == 503
    await app.look()
    assert app.pictures == Pictures(fault=TileFault.DISK)
    monkeypatch.setattr(tiles, "open_to_read", open_as_before)
    (tmp_path / "map").open("wb").close()  # the disk answers again
    (tmp_path / "map").unlink()
    mbtiles(tmp_path / "map", {(0, 0, 0): png()})
    for _ in again_and_again():
        if (await ask(app, "/tiles/0/0/0"))[0] == 200:
            break
        await asyncio.sleep(0.01)
    else:
        raise AssertionError("it is stuck for ever")


# -- licences --------------------------------------------------------------------------------------


def test_a_licence_is_plain_text() -> None:
    said = (
        '<a href="https://www.openstreetmap.org/copyright">&copy; OpenStreetMap</a>\n contributors'
    )
    assert licence_of({"attribution": said}) == "© OpenStreetMap contributors"
    assert licence_of({"attribution": "<script>" + "x" * 9999}) == "x" * 300
    assert licence_of({}) == ""


@pytest.mark.parametrize(
    ("metadata", "found"),
    [
        ({"minzoom": "14", "maxzoom": "19"}, (14, 19)),
        ({"minzoom": "-5", "maxzoom": "99"}, (0, 22)),
        ({}, (2, 2)),
        ({"minzoom": "9" * 5000, "maxzoom": "x"}, None),
        ({"format": "pbf"}, None),
    ],
)
async def test_the_zooms_are_those_of_the_file(
    metadata: dict[str, str], found: tuple[int, int] | None, tmp_path: Path
) -> None:
    rows = {(2, 0, 0): png()} | {(2, 1, row): b"" for row in range(1000)}
    app = MapTiles(mbtiles(tmp_path / "map", rows, **metadata))
    await app.look()
    assert app.pictures is not None
    assert app.pictures.zooms == found
    assert bool(app.pictures.fault) is (found is None)


def test_the_default_file_is_in_the_folder_of_the_state(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", "/state")
    assert default_tiles() == Path("/state/m100link/map.mbtiles")
