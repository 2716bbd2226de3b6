"""What may run in a page of the console."""

from __future__ import annotations

import base64
import hashlib
from types import SimpleNamespace
from typing import Any, cast

import pytest

pytest.importorskip("starlette")
from starlette.responses import HTMLResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route, WebSocketRoute

from m100link.apps.station.config import Settings
from m100link.apps.station.console import app as module
from m100link.apps.station.console.app import MOST_UNHEARD, Policy, console_app

pytestmark = pytest.mark.anyio

HOST = "127.0.0.1:8080"


async def rules_of(response: Response, *videos: str) -> tuple[dict[str, list[str]], bytes]:
    """The policy of an answer, by its directives, and the answer's body."""
    sent: list[Any] = []

    async def send(message: Any) -> None:
        sent.append(message)

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": b"", "more_body": False}

    scope: dict[str, Any] = {"type": "http", "method": "GET", "path": "/", "query_string": b""}
    scope |= {"headers": [(b"host", HOST.encode())], "asgi": {"spec_version": "2.4"}}
    await Policy(response, videos)(scope, receive, send)
    told = dict(sent[0]["headers"]).get(b"content-security-policy", b"").decode()
    pairs = (part.split() for part in told.split(";") if part.strip())
    body = b"".join(message.get("body", b"") for message in sent[1:])
    return {name: values for name, *values in pairs}, body


def hash_of(script: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"


async def test_scripts_of_the_page_as_it_was_sent_run_and_no_others() -> None:
    page = (
        '<script type="importmap">{"a": 1}</script><SCRIPT>one()\n</SCRIPT>'
        '<script defer src="/x.js"></script><script type="module">import "/y.js"</script>'
    )
    rules, body = await rules_of(HTMLResponse(page))
    assert rules["script-src"] == [
        "'self'",
        "'unsafe-eval'",
        *map(hash_of, ('{"a": 1}', "one()\n", 'import "/y.js"')),
    ]
    assert rules["connect-src"] == ["'self'", f"ws://{HOST}", f"wss://{HOST}"]
    for name in ("base-uri", "form-action", "frame-src", "object-src", "frame-ancestors"):
        assert rules[name] == ["'none'"]
    assert body.decode() == page


async def test_a_page_reaches_the_origins_of_videos_for_pictures_and_connections_alone() -> None:
    camera = "http://camera.test:8889"
    plain, _ = await rules_of(HTMLResponse("<p>"))
    rules, _ = await rules_of(HTMLResponse("<p>"), camera)
    for name in ("img-src", "connect-src"):
        assert rules.pop(name) == [*plain.pop(name), camera]
    assert rules == plain


async def test_a_page_in_pieces_is_judged_as_a_whole() -> None:
    async def pieces() -> Any:
        for piece in ("<scr", "ipt>tw", "o()</scri", "pt>"):
            yield piece

    rules, body = await rules_of(StreamingResponse(pieces(), media_type="text/html"))
    assert hash_of("two()") in rules["script-src"]
    assert body == b"<script>two()</script>"


async def test_what_is_no_page_passes_as_it_is() -> None:
    rules, body = await rules_of(PlainTextResponse("<script>x</script>"))
    assert rules == {}
    assert body == b"<script>x</script>"


async def test_what_is_no_request_passes_as_it_is() -> None:
    seen: list[Any] = []

    async def app(*what: Any) -> None:
        seen.append(what)

    socket: Any = {"type": "websocket"}
    await Policy(app)(socket, cast(Any, "receive"), cast(Any, "send"))
    assert seen == [(socket, "receive", "send")]


# -- what a page is given -------------------------------------------------------------------------


class Browser:
    """A page that was asked for, whose browser may open its socket, or go."""

    def __init__(self, name: str) -> None:
        self.id = name
        self.connects: list[Any] = []
        self.deletes: list[Any] = []

    def on_connect(self, done: Any) -> None:
        self.connects.append(done)

    def on_delete(self, done: Any) -> None:
        self.deletes.append(done)

    def delete(self) -> None:
        for done in self.deletes:
            done()


class Tab(SimpleNamespace):
    """The tabs of a console of two aircraft."""

    def __init__(self) -> None:
        super().__init__(opened=[], closed=[], shown="shown", dropped="dropped of the console")

    def open(self, aircraft: str, moved: str) -> tuple[str, Any]:
        self.opened.append((aircraft, moved))
        return f"key {len(self.opened)}", SimpleNamespace(aircraft=aircraft, agent=f"of {aircraft}")

    def close(self, key: str) -> None:
        self.closed.append(key)

    async def serve(self, *_: object) -> None:
        """Nobody steers."""


def agent_named(works: list[str]) -> Any:
    def spawn(work: Any, name: str) -> None:
        work.close()
        works.append(name)

    return SimpleNamespace(background=SimpleNamespace(spawn=spawn))


def noting_page(made: list[tuple[tuple[Any, ...], dict[str, Any]]]) -> type[Any]:
    class Page:
        def __init__(self, *what: Any, **more: Any) -> None:
            made.append((what, more))

        async def build(self, key: str) -> None:
            made[-1][1]["key"] = key

    return Page


async def test_a_page_is_given_its_aircraft_and_what_was_flown(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One history for each aircraft, which is kept from the beginning; one later from its page."""
    made: list[tuple[tuple[Any, ...], dict[str, Any]]] = []
    ran: list[tuple[Any, dict[str, Any]]] = []
    works: list[str] = []
    pages: list[Any] = []
    middle: list[tuple[Any, Any]] = []

    given = SimpleNamespace(
        config=SimpleNamespace(quasar_config={"loadingBar": {}}),
        add_middleware=lambda kind, *, videos: middle.append((kind, videos)),
        add_exception_handler=lambda code, _: pages.append(code),
    )
    heard = SimpleNamespace(on=lambda name, _: pages.append(name))

    def page_at(path: str, **_: object) -> Any:
        pages.append(path)
        return pages.append

    ui = SimpleNamespace(page=page_at, run_with=lambda app, **how: ran.append((app, how)))
    for name, fake in (
        *(("nicegui_app", given), ("ui", ui), ("Page", noting_page(made))),
        ("core", SimpleNamespace(sio=heard)),
    ):
        monkeypatch.setattr(module, name, fake)
    agents: dict[str, Any] = {name: agent_named(works) for name in ("a1", "a2")}
    tabs, orders = Tab(), {"a2": "orders of a2"}
    settings = Settings(video=("a1=http://127.0.0.1:8889/x",))
    gate = console_app(agents, settings, cast(Any, orders), cast(Any, tabs))
    assert works == ["history", "history"]
    [(app, how)] = ran
    assert (how["dark"], how["tailwind"], how["reconnect_timeout"]) == (None, False, 10.0)
    routes = {one.path: type(one) for one in app.router.routes}
    assert routes["/steer/{key}"] is WebSocketRoute
    assert routes["/sw.js"] is routes["/tiles/{tile:path}"] is Route
    assert given.config.quasar_config["loadingBar"] == {"skipHijack": True}
    path, page, *others = pages
    assert (path, others) == ("/", [404, "log"])
    assert middle == [(Policy, ["http://127.0.0.1:8889"])]
    assert gate is not None
    one, other = Browser("one"), Browser("other")
    await page(one, "a1", "from")
    await page(other, "a2")
    assert tabs.opened == [("a1", "from"), ("a2", "")]
    (first, of_first), (second, of_second) = made
    assert (first[0], first[2], second[0], second[2]) == ("of a1", None, "of a2", "orders of a2")
    assert (of_first["key"], of_second["key"]) == ("key 1", "key 2")
    assert (of_first["video"].origin, of_second["video"]) == ("http://127.0.0.1:8889", None)
    assert of_first["tabs"] is tabs
    history_of = of_first["history_of"]
    assert history_of("a1") is history_of("a1") is of_second["history_of"]("a1")
    assert history_of("a1") is not history_of("a2")
    agents["a3"] = agent_named(works)
    history_of("a3")
    history_of("a3")
    assert works == ["history"] * 3
    one.delete()
    assert tabs.closed == ["key 1"]


def test_pages_whose_browser_never_comes_give_way() -> None:
    unheard: dict[str, Any] = {}
    browsers = [Browser(str(n)) for n in range(MOST_UNHEARD + 1)]
    for one in browsers[:-1]:
        module._wait_to_hear(cast(Any, one), unheard)
    assert len(unheard) == MOST_UNHEARD
    module._wait_to_hear(cast(Any, browsers[-1]), unheard)
    assert list(unheard) == [one.id for one in browsers[1:]], "the oldest"
    for done in browsers[3].connects:
        done()
    browsers[4].delete()
    assert list(unheard) == [one.id for n, one in enumerate(browsers) if n not in (0, 3, 4)]


async def test_the_console_gives_what_others_need_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    served: list[tuple[Any, ...]] = []
    tabs = Tab()

    def made(agents: Any, dropped: Any) -> Tab:
        served.append((agents, dropped))
        return tabs

    def app_of(*what: Any) -> Any:
        served.append(what)
        return SimpleNamespace(access="the access")

    async def serve_http(fronts: Any, name: str, app: Any, *, lifespan: str) -> None:
        served.append((name, app.access, lifespan))

    async def reached(name: str) -> str:
        return f"agents of the {name}"

    for name, fake in (("Tabs", made), ("console_app", app_of), ("serve_http", serve_http)):
        monkeypatch.setattr(module, name, fake)
    fronts = SimpleNamespace(
        reached=reached, settings="settings", orders="orders", dropped={"rosbridge": "lost"}
    )
    await module.serve(cast(Any, fronts))
    assert served == [
        ("agents of the console", "lost"),
        ("agents of the console", "settings", "orders", tabs),
        ("console", "the access", "on"),
    ]
    assert (fronts.access, fronts.shown) == ("the access", "shown")
    assert fronts.dropped == {"rosbridge": "lost", "console": "dropped of the console"}
