"""The console as an ASGI application: NiceGUI for the page, one WebSocket for steering.

NiceGUI keeps its pages in one place per process, so a process serves one console.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from fastapi import FastAPI
from nicegui import Client, core, ui
from nicegui import app as nicegui_app
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import WebSocketRoute
from starlette.staticfiles import StaticFiles

from m100link.apps.station.console import installable
from m100link.apps.station.console.history import History
from m100link.apps.station.console.orders import Orders
from m100link.apps.station.console.page import Page
from m100link.apps.station.console.policy import Policy
from m100link.apps.station.console.tabs import Tabs
from m100link.apps.station.web.files import PublicFiles
from m100link.apps.station.web.gate import Gate
from m100link.apps.station.web.turnstile import Turnstile
from m100link.errors import UsageError

if TYPE_CHECKING:
    from m100link.apps.agent.client import AgentClient
    from m100link.apps.station.config import Settings

__all__ = ["console_app"]

STATIC = Path(__file__).parent / "static"

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
    settings: Settings,
    orders: Mapping[str, Orders],
    tabs: Tabs | None = None,
) -> Gate:
    """The application behind its gate.

    Args:
        agents: The agent that owns an aircraft, by its name; more may come.
        settings: Who may connect, and the folder with tiles.
        orders: What the panel does that plays pilot and weather of virtual aircraft.
        tabs: Where its tabs are kept; of its own by default.

    Raises:
        UsageError: The folder with tiles does not exist.
    """
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    tabs = tabs or Tabs(agents)
    histories: dict[str, History] = {}
    unheard = _Unheard()

    def history_of(name: str) -> History:
        if name not in histories:  # of one that came later from its first page on
            histories[name] = History()
            agents[name].background.spawn(histories[name].keep(agents[name]), "history")
        return histories[name]

    for name in agents:
        history_of(name)
    app.router.routes.append(WebSocketRoute("/steer/{key}", tabs.serve))
    app.router.routes.extend(installable.routes())
    app.mount("/console", Policy(StaticFiles(directory=STATIC)))
    if settings.tiles is not None:
        if not settings.tiles.is_dir():
            raise UsageError(f"{settings.tiles} is not a folder")
        app.mount("/tiles", PublicFiles(directory=settings.tiles))

    def page(client: Client, aircraft: str = "", moved: str = "") -> None:
        key, tab = tabs.open(aircraft, moved)
        client.on_delete(lambda: tabs.close(key))
        unheard.add(client)
        Page(
            tab.agent,
            tab,
            orders.get(tab.aircraft),
            has_tiles=settings.tiles is not None,
            history=history_of(tab.aircraft),
            tabs=tabs,
        ).build(key)

    # Quasar would draw a bar over the line of state for each request behind the page, and a bar
    # that has no name for who listens to it. The page says itself what it waits for.
    nicegui_app.config.quasar_config["loadingBar"]["skipHijack"] = True
    ui.page("/", title="m100link", viewport=_VIEWPORT)(page)
    _log_nothing_of_strangers()
    nicegui_app.add_middleware(Policy)  # it reads a page: before what compresses it
    ui.run_with(
        app,
        title="m100link",
        dark=None,
        show_welcome_message=False,
        reconnect_timeout=_RECONNECT_S,
    )
    return Gate(
        Turnstile(app, "/"),
        hosts=settings.host_names(),
        origins=settings.allow_origin,
        access=settings.access(),
    )


class _Unheard:
    """Pages whose browser has not opened its socket."""

    def __init__(self) -> None:
        self._clients: dict[str, Client] = {}

    def add(self, client: Client) -> None:
        """A page was asked for."""
        if len(self._clients) >= MOST_UNHEARD:
            self._clients.pop(next(iter(self._clients))).delete()
        self._clients[client.id] = client
        client.on_connect(lambda: self._clients.pop(client.id, None))
        client.on_delete(lambda: self._clients.pop(client.id, None))


def _log_nothing_of_strangers() -> None:
    """NiceGUI builds a page for each path that there is not, and logs the address as it came.

    What a page has to say it logs as well. Both may hold keys and tokens, and be without end.
    """
    nicegui_app.add_exception_handler(404, _not_found)
    core.sio.on("log", _forget)


async def _not_found(request: Request, error: Exception) -> Response:
    return PlainTextResponse("There is no such page.\n", status_code=404)


async def _forget(sender: str, message: object) -> None:
    """What a page wants logged is the affair of its browser."""
