"""rosbridge on a WebSocket: the sessions of :mod:`m100link.apps.station.ros.client` on uvicorn.

Needs the extra ``station``.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from starlette.applications import Starlette
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import BaseRoute, Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.status import WS_1008_POLICY_VIOLATION
from starlette.websockets import WebSocket, WebSocketDisconnect

from m100link.apps.agent.background import SparingLogger, is_set_within
from m100link.apps.agent.client import AgentClient
from m100link.apps.station.config import namespace_of
from m100link.apps.station.listeners import Fronts
from m100link.apps.station.ros.client import Client
from m100link.apps.station.ros.dji_sdk import DjiSdk
from m100link.apps.station.ros.graph import Graph, add_rosapi, add_rosout
from m100link.apps.station.ros.leases import Clients
from m100link.apps.station.ros.node_2015 import Node2015
from m100link.apps.station.web.access_control import AccessControl
from m100link.apps.station.web.limits import to_evict
from m100link.apps.station.web.protocol import (
    WebSocketConnection,
    frames_of,
    serve_http,
    until_one_ends,
)
from m100link.errors import UsageError

if TYPE_CHECKING:
    from starlette.requests import Request

    from m100link.apps.station.config import Settings


_GUARD_INTERVAL = 0.05
_LAG = 0.1
_PACKING_TIME = 0.001
"""Seconds after which what was packed for a client is written, and others have their turn."""
_WRITE_SIZE = 64 * 1024


class RosbridgeServer:
    """Everything that rosbridge clients reach: topics, services, sockets."""

    def __init__(
        self,
        # The agent that owns an aircraft, by its name. The topics and services of the first are
        # called as DJI's are, those of the others stand in a namespace of their name.
        agents: Mapping[str, AgentClient],
        *,
        max_clients: int = 32,  # clients at once
        pages: Path | None = None,  # folder with web pages to serve on the same port
    ) -> None:
        self.agents = agents
        self._max_clients = max_clients
        self._log = SparingLogger(logging.getLogger(__name__))
        self.graph = Graph()  # topics and services
        self.clients: dict[str, Clients] = {}  # who holds the lease of which aircraft
        for name, agent in agents.items():
            part = self.graph.namespace(namespace_of(name)) if self.clients else self.graph
            clients = self.clients[name] = Clients(agent, part)
            Node2015(agent, part, clients)
            DjiSdk(agent, part, clients)
        add_rosout(agents, self.graph)
        add_rosapi(self.graph)
        self.agent.background.spawn(self._guard(), "lag")
        routes: list[BaseRoute] = [
            WebSocketRoute("/{path:path}", self._serve),
            Route("/health", self._health),
        ]
        if pages is not None:
            if not os.path.isdir(pages):
                raise UsageError(f"{pages} is not a folder", remedy="name the folder of the pages")
            routes.append(Mount("/", PublicFiles(directory=pages, html=True)))
        else:
            routes.append(Route("/", self._greet))
        self._app = Starlette(routes=routes)

    @property
    def agent(self) -> AgentClient:
        return next(iter(self.agents.values()))

    def app(self, settings: Settings) -> AccessControl:
        # A page of DJI's has one port in it, and is served on each of rosbridge.
        return settings.gate(self._app, (settings.port, *settings.also_ports))

    async def _greet(self, request: Request) -> Response:
        return PlainTextResponse("m100link station: rosbridge v2 on this port, by WebSocket.\n")

    async def _health(self, request: Request) -> Response:
        every = {name: _health_of(agent) for name, agent in self.agents.items()}
        report = _health_of(self.agent) | {"clients": len(self.graph.sessions)}
        if len(every) > 1:
            report["aircraft"] = every
        is_well = all(agent.is_connected for agent in self.agents.values())
        return JSONResponse(report, status_code=200 if is_well else 503)

    # -- all clients -----------------------------------------------------------------------------

    @property
    def _sessions(self) -> list[Client]:
        return [one for one in self.graph.sessions if isinstance(one, Client)]

    def dropped(self) -> dict[str, int]:
        """Messages that clients did not get because they are slow, by their names."""
        return {one.name: one.outbox.dropped for one in self._sessions}

    def _make_room(self, peer: str) -> bool:
        """Whether one more client may come, for which another may have to go.

        The holder of the lease needs no place, and loses none.
        """
        now = self.agent.now
        others = [one for one in self._sessions if not self._steers(one)]
        if len(others) < self._max_clients:
            return True
        goes = to_evict(others, peer, now)
        if goes is None:
            return False
        goes.disconnect(
            f"another client needs the place; this one was silent for {now - goes.heard_at:.1f} s"
        )
        goes.close(now)
        return True

    def _steers(self, session: Client) -> bool:
        return any(clients.session(session).has_lease for clients in self.clients.values())

    async def _guard(self) -> None:
        """Let go of a client that keeps the loop from running: setpoints wait for it, too."""
        while True:
            due = self.agent.now + _GUARD_INTERVAL
            await asyncio.sleep(_GUARD_INTERVAL)
            lag = self.agent.now - due
            sessions = self._sessions
            heaviest = max(sessions, key=lambda one: one.recent_work, default=None)
            if heaviest is not None and lag >= _LAG and heaviest.recent_work >= _LAG / 2:
                heaviest.disconnect(
                    f"it blocked the station for {1000 * heaviest.recent_work:.0f} ms"
                )
                heaviest.close(self.agent.now)
            for one in sessions:
                one.recent_work = 0.0

    # -- one client ------------------------------------------------------------------------------

    async def _serve(self, websocket: WebSocket) -> None:
        peer = websocket.client.host if websocket.client else ""
        if not self._make_room(peer):
            self._log.warning("a client was refused: %d are connected", len(self.graph.sessions))
            await websocket.close(WS_1008_POLICY_VIOLATION)
            return
        name = f"rosbridge {peer}:{websocket.client.port}" if websocket.client else "rosbridge"
        wake, closing = asyncio.Event(), asyncio.Event()
        session = Client(self.graph, name, on_output=wake.set, on_disconnect=closing.set)
        session.heard_at, session.peer = self.agent.now, peer
        try:
            await websocket.accept()
            connection: WebSocketConnection = websocket.scope["state"]["connection"]
            connection.is_steering = session.is_steering = lambda: self._steers(session)
            self._log.info("%s connected", name)
            await until_one_ends(
                self._write(websocket, session, wake, closing),
                self._read(websocket, session),
                # The motion stops now, not when both have ended.
                at_once=lambda: session.close(self.agent.now),
            )
        except WebSocketDisconnect:
            pass
        finally:
            session.close(self.agent.now)
            self._log.info("%s has gone (%d messages dropped)", name, session.outbox.dropped)

    async def _read(self, websocket: WebSocket, session: Client) -> None:
        async for frame in frames_of(websocket):
            began, now = time.thread_time(), self.agent.now
            session.receive(frame, now)
            session.charge(time.thread_time() - began, now)

    async def _write(
        self, websocket: WebSocket, session: Client, wake: asyncio.Event, closing: asyncio.Event
    ) -> None:
        # A client that does not read does not answer pings either: the server cuts it off then,
        # and a send that waits for it ends.
        connection: WebSocketConnection = websocket.scope["state"]["connection"]
        with contextlib.suppress(WebSocketDisconnect):
            while session.close_reason is None:
                wake.clear()
                began, now = time.thread_time(), self.agent.now
                session.outbox.advance(now)
                frames = _frames(session)
                if not frames:
                    await self._wait(session, wake)
                    continue
                packed_at = time.thread_time()
                await connection.send_all(frames)
                session.charge(packed_at - began, now)
                # The loop that flies has its turn in between; a client that wants too much waits
                # longer, and loses messages.
                await asyncio.sleep(0)
                pause = session.work_pause(self.agent.now)
                if pause:  # who is to go does not stay for the seconds that its work has cost
                    await is_set_within(closing, pause)
            self._log.warning("%s is disconnected: %s", session.name, session.close_reason)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(1.0):
                    await websocket.close(WS_1008_POLICY_VIOLATION, session.close_reason[:120])

    async def _wait(self, session: Client, wake: asyncio.Event) -> None:
        due = session.outbox.next_wakeup()
        await is_set_within(wake, None if due is None else due - self.agent.now)


def _health_of(agent: AgentClient) -> dict[str, Any]:
    fault = agent.state.connection_fault
    return {"connection": agent.view.connection, "error": str(fault.error()) if fault else ""}


def _frames(session: Client) -> list[str | bytes]:
    """Frames that wait for a client, as many as pack in a short time and fit one write."""
    frames: list[str | bytes] = []
    size, until = 0, time.perf_counter() + _PACKING_TIME
    while size < _WRITE_SIZE and (frame := session.outbox.next_frame()) is not None:
        frames.append(frame)
        size += len(frame)
        if time.perf_counter() > until:
            break
    return frames


# -- as a front ------------------------------------------------------------------------------------


async def serve(fronts: Fronts) -> None:
    agents = await fronts.reached("rosbridge")
    settings = fronts.settings
    bridge = RosbridgeServer(agents, max_clients=settings.max_clients, pages=settings.pages)
    fronts.made["rosbridge"], fronts.dropped["rosbridge"] = bridge, bridge.dropped
    await serve_http(fronts, "rosbridge", bridge.app(settings))


# -- folders that the station serves ---------------------------------------------------------------


class PublicFiles(StaticFiles):
    """The files of a folder without those whose name, or that of a folder above, has a dot first.

    ``.git``, ``.env`` and the like lie in many a folder, and nobody means to publish them. A link
    counts as what it points to.
    """

    def lookup_path(self, path: str) -> tuple[str, os.stat_result | None]:
        found, status = super().lookup_path(path)
        for directory in self.all_directories if status is not None else ():
            inside = os.path.relpath(os.path.realpath(found), os.path.realpath(directory))
            parts = [*Path(path).parts, *Path(inside).parts]
            if any(part.startswith(".") and part not in (".", "..") for part in parts):
                return "", None
        return found, status
