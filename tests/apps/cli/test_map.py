"""Tiles are fetched politely and stored whole, from servers and files of strangers."""

from __future__ import annotations

import json
import sqlite3
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, cast

import pytest

from m100link.apps.cli import map as map_verbs
from m100link.apps.cli.terminal import ExitCode
from tests.apps.cli.conftest import CommandLine
from tests.apps.station.web.test_tiles import png

HERE = "52.1,4.31"
MAP = ("--attribution", "© Anna", "--json")
SMALL = (*MAP, "--margin", "100")


class Server:
    """A server of tiles: what it was asked, and what it answers."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.agents: set[str] = set()
        self.at_once = self.most_at_once = 0
        self.answer: Callable[[str], tuple[int, dict[str, str], bytes]] = lambda _: (200, {}, png())
        self._lock = threading.Lock()
        whole = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                with whole._lock:
                    whole.asked.append(self.path)
                    whole.agents.add(self.headers["User-Agent"])
                    whole.at_once += 1
                    whole.most_at_once = max(whole.at_once, whole.most_at_once)
                    status, headers, body = whole.answer(self.path)
                self.send_response(status)
                for name, value in headers.items():
                    self.send_header(name, value)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                with whole._lock:  # before the body: the next one may come as soon as that is there
                    whole.at_once -= 1
                self.wfile.write(body)

            def log_message(self, *_: Any) -> None:
                """Nothing of it is printed."""

        self.http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.http.server_address[1]}"

    @property
    def template(self) -> str:
        return f"{self.url}/{{z}}/{{x}}/{{y}}.png?key=secret"


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Server]:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    monkeypatch.setattr(map_verbs, "_LONGEST_PAUSE_S", 0.0)
    made = Server()
    thread = threading.Thread(target=made.http.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield made
    made.http.shutdown()
    thread.join()
    made.http.server_close()


def stored(path: Path) -> dict[tuple[int, int, int], bytes]:
    with closing(sqlite3.connect(path)) as file:
        return {(z, x, y): data for z, x, y, data in file.execute("SELECT * FROM tiles")}


def metadata(path: Path) -> dict[str, str]:
    with closing(sqlite3.connect(path)) as file:
        return dict(file.execute("SELECT name, value FROM metadata"))


def test_an_area_is_fetched_into_the_file_that_the_station_serves(
    cli: CommandLine, server: Server, tmp_path: Path
) -> None:
    words = (
        "map",
        "download",
        server.template,
        HERE,
        *SMALL,
        "--min-zoom",
        "15",
        "--max-zoom",
        "16",
    )
    told = json.loads(cli(*words).out)
    path = tmp_path / "m100link" / "map.mbtiles"
    assert told["file"] == str(path)
    # OpenStreetMap's wiki: x = (λ + 180) / 360 · 2^z, y = (1 - ln(tan φ + sec φ) / π) / 2 · 2^z:
    # 16776.3, 10809.0 at zoom 15; 33552.6, 21617.9 at zoom 16, where a tile is 375 m wide.
    assert "/16/33552/21617.png?key=secret" in server.asked
    assert "/15/16776/10808.png?key=secret" in server.asked
    # MBTiles counts rows from the south: 2^16 - 1 - 21617.
    assert stored(path)[16, 33552, 43918] == png()
    assert told["stored"] == len(server.asked) == len(stored(path))
    assert server.most_at_once <= 2
    assert all(agent.startswith("m100link/") for agent in server.agents)
    said = metadata(path)
    assert (said["minzoom"], said["maxzoom"], said["format"]) == ("15", "16", "png")
    assert said["attribution"] == "© Anna"
    assert "secret" not in repr(said)


def test_rows_from_the_south_are_asked_for_by_tms(cli: CommandLine, server: Server) -> None:
    tms = f"{server.url}/{{z}}/{{x}}/{{-y}}"
    cli("map", "download", tms, HERE, *SMALL, "--min-zoom", "16", "--max-zoom", "16")
    assert "/16/33552/43918" in server.asked


def test_a_download_goes_on_where_it_ended(
    cli: CommandLine, server: Server, tmp_path: Path
) -> None:
    zooms = ("--min-zoom", "18", "--max-zoom", "18")
    words = ("map", "download", server.template, HERE, *MAP, *zooms, "--margin", "250")
    fails_after = 20

    def answer(_: str) -> tuple[int, dict[str, str], bytes]:
        if len(server.asked) > fails_after:
            return 503, {"Retry-After": "1"}, b"busy"
        return 200, {}, png()

    server.answer = answer
    outcome = cli(*words)
    assert outcome.status != ExitCode.OK
    assert "503" in outcome.err
    assert "goes on" in outcome.err
    assert "secret" not in outcome.err
    first = stored(tmp_path / "m100link" / "map.mbtiles")
    assert 0 < len(first) <= fails_after
    asked = set(server.asked)
    server.answer = lambda _: (200, {}, png())
    server.asked.clear()
    told = json.loads(cli(*words).out)
    assert told["present"] == len(first)
    assert told["stored"] == len(server.asked)
    assert len(set(server.asked) & asked) <= len(asked) - len(first)


def test_a_tile_that_the_server_lacks_is_left_out(cli: CommandLine, server: Server) -> None:
    answers: dict[str, Any] = {
        "33552/21617": (200, {}, png()),
        "33552": (404, {}, b""),
        "": (204, {}, b""),
    }
    server.answer = lambda path: next(it for words, it in answers.items() if words in path)
    told = json.loads(
        cli(
            "map", "download", server.template, HERE, *MAP, "--min-zoom", "16", "--max-zoom", "16"
        ).out
    )
    assert told["absent"] == len(server.asked) - 1 > 0
    assert told["stored"] == 1


@pytest.mark.parametrize(
    ("answer", "seen"),
    [
        ((200, {}, b"<html>Log in to the network</html>"), "something else"),
        ((200, {}, png() + bytes(2_000_000)), "something else"),
        ((403, {}, b"no"), "403"),
        ((401, {}, b"no"), "401"),
        ((302, {"Location": "file:///etc/passwd"}, b""), "302"),
        ((500, {}, b""), "500"),
        ((200, {"Content-Encoding": "x"}, b""), "something else"),
    ],
)
def test_a_server_that_gives_no_pictures_ends_it(
    answer: tuple[int, dict[str, str], bytes], seen: str, cli: CommandLine, server: Server
) -> None:
    server.answer = lambda _: answer
    outcome = cli("map", "download", server.template, HERE, *MAP)
    assert outcome.status != ExitCode.OK
    assert seen in outcome.err
    assert "secret" not in outcome.err
    assert len(server.asked) <= 3 * map_verbs._AT_ONCE
    tries = max(Counter(server.asked).values())
    assert tries == (3 if seen == "500" else 1)  # what may pass is tried again


def test_an_answer_that_drips_does_not_hold_it_up(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0

    class Dripping:
        def read1(self, size: int) -> bytes:
            nonlocal now
            now += 10.0
            return b"x"

    monkeypatch.setattr(time, "monotonic", lambda: now)
    with pytest.raises(TimeoutError):
        map_verbs._body_of(cast(Any, Dripping()))
    assert 30.0 < now <= 40.0


@pytest.mark.parametrize(
    ("words", "seen"),
    [
        (["https://h/{z}/{x}.png", HERE], "braces"),
        (["https://{s}.h/{z}/{x}/{y}", HERE], "one of the provider's names"),
        (["ftp://{z}/{x}/{y}", HERE], "is none"),
        (["h/{z}/{x}/{y}", HERE], "is none"),
        (["https://h/{z}/{x}/{y}"], "no tile"),
        (["https://h/{z}/{x}/{y}", "91,0"], "a place"),
        (["https://h/{z}/{x}/{y}", "here"], "a place"),
        (["https://h/{z}/{x}/{y}", HERE, "--min-zoom", "19", "--max-zoom", "18"], "no tile"),
        (["https://h/{z}/{x}/{y}", HERE, "--attribution", " "], "--attribution is empty"),
        (["https://h/{z}/{x}/{y}", HERE, "53,5"], "more than 5000"),
        (
            ["https://h/{z}/{x}/{y}", HERE, "53,5", "--min-zoom", "18", "--max-zoom", "18"],
            "at zoom 18 to 18: more than 5000",
        ),
        (["https://h/{z}/{x}/{y}", "0,-180", "0,180", "--margin", "9e9"], "more than 5000"),
    ],
)
def test_an_area_that_cannot_be_fetched_is_refused(
    words: list[str], seen: str, cli: CommandLine, server: Server, tmp_path: Path
) -> None:
    known = () if "--attribution" in words else ("--attribution", "© Anna")
    outcome = cli("map", "download", *words, *known)
    assert outcome.status == ExitCode.USAGE
    assert seen in " ".join(outcome.err.split())
    assert not (tmp_path / "m100link").exists()


def test_a_file_that_is_no_map_is_not_written(
    cli: CommandLine, server: Server, tmp_path: Path
) -> None:
    (tmp_path / "text").write_text("no map" * 300)
    words = ("map", "download", server.template, HERE, *MAP, "--tiles", str(tmp_path / "text"))
    outcome = cli(*words)
    assert outcome.status == ExitCode.USAGE
    assert "cannot be written" in outcome.err
    assert (tmp_path / "text").read_text() == "no map" * 300
    assert server.asked == []


# -- a folder --------------------------------------------------------------------------------------


def test_a_folder_of_tiles_is_copied(cli: CommandLine, server: Server, tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    for name, data in (("16/33552/21617.png", png(shade=1)), ("16/33552/9.png", b"<html>")):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    source = f"{folder.as_uri()}/{{z}}/{{x}}/{{y}}.png"
    zooms = ("--min-zoom", "16", "--max-zoom", "16")
    told = json.loads(cli("map", "download", source, HERE, *MAP, *zooms).out)
    assert (told["stored"], told["absent"] > 0) == (1, True)
    assert stored(tmp_path / "m100link" / "map.mbtiles") == {(16, 33552, 43918): png(shade=1)}
