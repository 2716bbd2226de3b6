"""The console as an ASGI application: NiceGUI for the page, one WebSocket for steering.

NiceGUI keeps its pages in one place per process, so a process serves one console.
"""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Iterable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

from fastapi import FastAPI
from nicegui import Client, core, ui
from nicegui import app as nicegui_app
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from m100link.apps.station.console.kept import PlotHistory
from m100link.apps.station.console.page import STATIC, Page, worker
from m100link.apps.station.console.tabs import Tabs
from m100link.apps.station.listeners import Fronts
from m100link.apps.station.web.access_control import AccessControl
from m100link.apps.station.web.limits import PageRateLimit
from m100link.apps.station.web.protocol import serve_http
from m100link.apps.station.web.tiles import MapTiles

if TYPE_CHECKING:
    from m100link.apps.agent.client import AgentClient
    from m100link.apps.station.config import Settings
    from m100link.sim.orders import SimulatorOrders


# A keyboard on the screen makes the page smaller; the bar with STOP stays above it.
_VIEWPORT = (
    "width=device-width, initial-scale=1, viewport-fit=cover, interactive-widget=resizes-content"
)

# A page whose texts could not come for so long is thrown away and loaded again, and with it what
# its operator was about; a busy computer is late by 3 s at times. Steering and the lease do not
# wait for it: they have a socket of their own, and after 2 s the page says that its texts are old.
_RECONNECT_S = 10.0

MOST_UNHEARD = 16
"""Pages that wait for the socket of their browser at most; the oldest gives way to a new one.

A program that only asks for pages would have NiceGUI keep a minute of them. The garbage collector
walks through all that are kept, and NiceGUI deletes them in one go: both hold up keys and STOP. A
browser opens its socket within seconds.
"""


def console_app(
    agents: Mapping[str, AgentClient],
    settings: Settings,  # who may connect, tiles and videos
    orders: Mapping[str, SimulatorOrders],
    tabs: Tabs | None = None,  # where its tabs are kept; of its own by default
) -> AccessControl:
    """The application behind its gate.

    Raises ``UsageError``: a video cannot be one.
    """
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    tabs = tabs or Tabs(agents)
    histories: dict[str, PlotHistory] = {}
    unheard: dict[str, Client] = {}

    def history_of(name: str) -> PlotHistory:
        if name not in histories:  # of one that came later from its first page on
            histories[name] = PlotHistory()
            agents[name].background.spawn(histories[name].keep(agents[name]), "history")
        return histories[name]

    for name in agents:
        history_of(name)
    app.router.routes += [WebSocketRoute("/steer/{key}", tabs.serve), Route("/sw.js", worker)]
    app.mount("/console", Policy(StaticFiles(directory=STATIC)))
    tiles = MapTiles(settings.tiles)
    app.router.routes.append(Route("/tiles/{tile:path}", tiles))
    videos = settings.videos(tuple(agents))

    async def page(client: Client, aircraft: str = "", moved: str = "") -> None:
        key, tab = tabs.open(aircraft, moved)
        client.on_delete(lambda: tabs.close(key))
        _wait_to_hear(client, unheard)
        more: Any = {"tiles": tiles, "video": videos.get(tab.aircraft), "tabs": tabs}
        shell = Page(tab.agent, tab, orders.get(tab.aircraft), history_of=history_of, **more)
        await shell.build(key)

    # Quasar would draw a bar over the line of state for each request behind the page, and a bar
    # without a name for screen readers. The page says itself what it waits for.
    nicegui_app.config.quasar_config["loadingBar"]["skipHijack"] = True
    ui.page("/", title="m100link", viewport=_VIEWPORT, response_timeout=_RECONNECT_S)(page)
    # NiceGUI builds a page for each path that there is not. It logs the address as it came, and the
    # messages of pages. Both may hold keys and tokens, and be without end.
    nicegui_app.add_exception_handler(404, _not_found)
    core.sio.on("log", _forget)
    origins = sorted({video.origin for video in videos.values()})
    nicegui_app.add_middleware(Policy, videos=origins)  # it reads a page: before what compresses it
    ui.run_with(
        app,
        title="m100link",
        dark=None,
        show_welcome_message=False,
        reconnect_timeout=_RECONNECT_S,
        # It would make styles in the browser, at each page; console.css has the few that are used.
        tailwind=False,
        # The strongest takes three times as long for 4 % less.
        gzip_middleware_factory=partial(GZipMiddleware, compresslevel=4),
    )
    return settings.gate(PageRateLimit(app, "/"))


async def serve(fronts: Fronts) -> None:
    agents = await fronts.reached("console")
    tabs = Tabs(agents, fronts.dropped.get("rosbridge", dict))
    app = console_app(agents, fronts.settings, fronts.orders, tabs)
    fronts.access, fronts.shown, fronts.dropped["console"] = app.access, tabs.shown, tabs.dropped
    await serve_http(fronts, "console", app, lifespan="on")


def _wait_to_hear(client: Client, unheard: dict[str, Client]) -> None:
    """Keep a page that was asked for, until its browser opens its socket."""
    if len(unheard) >= MOST_UNHEARD:
        unheard.pop(next(iter(unheard))).delete()
    unheard[client.id] = client
    client.on_connect(lambda: unheard.pop(client.id, None))
    client.on_delete(lambda: unheard.pop(client.id, None))


async def _not_found(request: Request, error: Exception) -> Response:
    return PlainTextResponse("There is no such page.\n", status_code=404)


async def _forget(sender: str, message: object) -> None:
    """The log messages of a page are the affair of its browser."""


# -- content security policy -----------------------------------------------------------------------
# Beside the station's own, a page reaches the origins of the videos that the user named.
# The browser runs scripts of the station's own files, and those in the page as the station sent it:
# the header has the hash of each. It does not run scripts that get into a page later, such as a
# handler in an attribute or a ``<script>`` in a text.
# NiceGUI and Vue build functions from texts that come over the page's own socket, so
# ``'unsafe-eval'`` has to stay. The policy does not stop an attacker that writes into that socket.

_INLINE = re.compile(rb"<script\b(?![^>]*\ssrc\s*=)[^>]*>(.*?)</script>", re.DOTALL | re.IGNORECASE)

_RULES = (
    "default-src 'self'; base-uri 'none'; form-action 'none'; frame-src 'none'; object-src 'none'; "
    "frame-ancestors 'none'; img-src 'self' data: blob:{videos}; media-src 'self' data: blob:; "
    # Looks alone: attributes of style are everywhere in it.
    "font-src 'self' data:; style-src 'self' 'unsafe-inline'; "
    "connect-src 'self'{sockets}{videos}; script-src 'self' 'unsafe-eval'{hashes}"
)


class Policy:
    """An ASGI application whose pages carry the policy."""

    def __init__(self, app: ASGIApp, videos: Iterable[str] = ()) -> None:
        self._app = app
        self._videos = "".join(f" {origin}" for origin in videos)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on; keep a page until it is whole."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        start: Message = {}
        body = bytearray()

        async def keep_pages(message: Message) -> None:
            nonlocal start
            if message["type"] == "http.response.start":
                start = message
                if _is_page(message):
                    return
            elif _is_page(start):
                body.extend(message.get("body", b""))
                if message.get("more_body", False):
                    return
                headers = MutableHeaders(raw=start["headers"])
                headers["content-security-policy"] = _rules(
                    bytes(body), Headers(scope=scope), self._videos
                )
                await send(start)
                message = {"type": "http.response.body", "body": bytes(body)}
            await send(message)

        await self._app(scope, receive, keep_pages)


def _is_page(start: Message) -> bool:
    kind = Headers(raw=start.get("headers", [])).get("content-type", "")
    return kind.startswith("text/html")


def _rules(page: bytes, asked: Headers, videos: str) -> str:
    found = (hashlib.sha256(script).digest() for script in _INLINE.findall(page))
    hashes = "".join(f" 'sha256-{base64.b64encode(one).decode()}'" for one in found)
    # Not every browser takes 'self' for a socket of the same host. The gate has checked the name.
    host = asked.get("host", "")
    return _RULES.format(sockets=f" ws://{host} wss://{host}", hashes=hashes, videos=videos)
