"""The tabs that are open, and their sockets: beats in, instruments out."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from dataclasses import dataclass

from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from m100link.agent.client import AgentClient
from m100link.station.console.tab import Tab
from m100link.station.console.view.instruments import live
from m100link.station.web.places import who_makes_room

__all__ = ["LIVE_INTERVAL", "PLACES", "Tabs"]

LIVE_INTERVAL = 0.05
"""Seconds between two updates of the instruments."""

PLACES = 32
"""Tabs that may have a socket."""

_POLICY_VIOLATION = 1008


@dataclass(slots=True, eq=False)
class _Place:
    """A tab with its socket, as whoever gives places away sees it.

    Attributes:
        tab: The tab.
        peer: Address that it comes from.
        heard_at: When it last said anything; when it came, if it never did.
        leaving: Set when another one gets the place.
        has_spoken: Whether it ever said anything.
        subscribes: Whether it gets anything: every tab does.
    """

    tab: Tab
    peer: str
    heard_at: float
    leaving: asyncio.Event
    has_spoken: bool = False
    subscribes: bool = True


class Tabs:
    """The tabs that are open, by the secret part of their socket's address.

    Args:
        agent: The agent that owns the aircraft.
    """

    def __init__(self, agent: AgentClient) -> None:
        self._agent = agent
        self._count = 0
        self.tabs: dict[str, Tab] = {}
        self._places: dict[str, _Place] = {}

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
        """The socket of a tab, until either end leaves."""
        key = websocket.path_params["key"]
        peer = websocket.client.host if websocket.client else ""
        tab = self.tabs.get(key)
        if tab is None or key in self._places or not self._make_room(peer):
            await websocket.close(_POLICY_VIOLATION)
            return
        place = self._places[key] = _Place(tab, peer, self._agent.now, asyncio.Event())
        try:
            await websocket.accept()
            await self._talk(websocket, place)
        except WebSocketDisconnect:
            pass
        finally:
            tab.lost()
            if self._places.get(key) is place:
                del self._places[key]

    def _make_room(self, peer: str) -> bool:
        """Whether one more may come, for which another may have to go.

        Whoever steers needs no place, and loses none.
        """
        others = [one for one in self._places.values() if not one.tab.has_lease]
        if len(others) < PLACES:
            return True
        goes = who_makes_room(others, peer, self._agent.now)
        if goes is None:
            return False
        goes.leaving.set()
        self._places = {key: one for key, one in self._places.items() if one is not goes}
        return True

    async def _talk(self, websocket: WebSocket, place: _Place) -> None:
        works = [
            asyncio.create_task(self._read(websocket, place)),
            asyncio.create_task(self._write(websocket)),
            asyncio.create_task(place.leaving.wait()),
        ]
        try:
            await asyncio.wait(works, return_when=asyncio.FIRST_COMPLETED)
        finally:
            place.tab.lost()  # first of all: motion stops
            for work in works:
                work.cancel()
            await asyncio.gather(*works, return_exceptions=True)
        if place.leaving.is_set() and websocket.client_state is WebSocketState.CONNECTED:
            await websocket.close(_POLICY_VIOLATION, "another tab needs the place")

    async def _read(self, websocket: WebSocket, place: _Place) -> None:
        while True:
            message = await websocket.receive()
            if message["type"] == "websocket.disconnect":
                return
            place.heard_at, place.has_spoken = self._agent.now, True
            answer = place.tab.receive(message.get("text") or message.get("bytes") or "")
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
