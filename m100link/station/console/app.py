"""The console as an ASGI application: NiceGUI for the page, one WebSocket for steering.

NiceGUI keeps its pages in one place per process, so a process serves one console.
"""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from pathlib import Path
from typing import TYPE_CHECKING

from fastapi import FastAPI
from nicegui import Client, ui
from starlette.routing import WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from m100link.errors import UsageError
from m100link.station.console.fields import live
from m100link.station.console.orders import Orders
from m100link.station.console.page import Page
from m100link.station.console.tab import Tab
from m100link.station.web.files import PublicFiles
from m100link.station.web.gate import Gate
from m100link.station.web.turnstile import Turnstile

if TYPE_CHECKING:
    from m100link.agent.client import AgentClient
    from m100link.station.config import Settings

__all__ = ["console_app"]

STATIC = Path(__file__).parent / "static"
LIVE_INTERVAL = 0.05
"""Seconds between two updates of the instruments."""

_POLICY_VIOLATION = 1008
_MAX_TABS = 32


class Tabs:
    """The tabs that are open, by the secret part of their socket's address."""

    def __init__(self, agent: AgentClient) -> None:
        self._agent = agent
        self._count = 0
        self.tabs: dict[str, Tab] = {}
        self._connected: set[str] = set()

    def open(self) -> tuple[str, Tab]:
        """A new tab."""
        self._count += 1
        key = secrets.token_urlsafe(16)
        tab = Tab(self._agent, f"console {self._count}")
        self.tabs[key] = tab
        return key, tab

    def close(self, key: str) -> None:
        """A tab is gone for good."""
        tab = self.tabs.pop(key, None)
        if tab is not None:
            tab.close()

    async def serve(self, websocket: WebSocket) -> None:
        """The socket of a tab: beats in, instruments out."""
        key = websocket.path_params["key"]
        tab = self.tabs.get(key)
        if tab is None or key in self._connected or len(self._connected) >= _MAX_TABS:
            await websocket.close(_POLICY_VIOLATION)
            return
        self._connected.add(key)
        try:
            await websocket.accept()
            writing = asyncio.create_task(self._write(websocket))
            try:
                await self._read(websocket, tab)
            finally:
                tab.lost()  # first of all: motion stops
                writing.cancel()
                await asyncio.gather(writing, return_exceptions=True)
        except WebSocketDisconnect:
            pass
        finally:
            tab.lost()
            self._connected.discard(key)

    async def _read(self, websocket: WebSocket, tab: Tab) -> None:
        while True:
            message = await websocket.receive()
            if message["type"] == "websocket.disconnect":
                return
            answer = tab.receive(message.get("text") or message.get("bytes") or "")
            if answer is not None and self._is_up_to_date():
                await websocket.send_json(answer)
            await asyncio.sleep(0)

    async def _write(self, websocket: WebSocket) -> None:
        with contextlib.suppress(WebSocketDisconnect):
            while True:
                if self._is_up_to_date():
                    await websocket.send_json(live(self._agent.telemetry, self._agent.now))
                await asyncio.sleep(LIVE_INTERVAL)

    def _is_up_to_date(self) -> bool:
        """Whether the agent is heard. A page that hears nothing shows everything as old."""
        return not self._agent.is_gone and not self._agent.is_silent


def console_app(agent: AgentClient, settings: Settings, orders: Orders | None) -> Gate:
    """The application behind its gate.

    Args:
        agent: The agent that owns the aircraft.
        settings: Who may connect, and the folder with tiles.
        orders: What the panel does that plays pilot and weather of a virtual aircraft.

    Raises:
        UsageError: The folder with tiles does not exist.
    """
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    tabs = Tabs(agent)
    app.router.routes.append(WebSocketRoute("/steer/{key}", tabs.serve))
    app.mount("/console", StaticFiles(directory=STATIC))
    if settings.tiles is not None:
        if not settings.tiles.is_dir():
            raise UsageError(f"{settings.tiles} is not a folder")
        app.mount("/tiles", PublicFiles(directory=settings.tiles))

    def page(client: Client) -> None:
        key, tab = tabs.open()
        client.on_delete(lambda: tabs.close(key))
        Page(agent, tab, orders).build(key, has_tiles=settings.tiles is not None)

    ui.page("/", title="m100link")(page)
    ui.run_with(app, title="m100link", dark=None, show_welcome_message=False, reconnect_timeout=3.0)
    return Gate(
        Turnstile(app, "/"),
        hosts=settings.host_names(),
        origins=settings.allow_origin,
        access=settings.access(),
    )
