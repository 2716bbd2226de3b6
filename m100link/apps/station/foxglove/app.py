"""The server that Foxglove and Lichtblick connect to, behind the gate of the station.

The server that Foxglove's own library brings takes pages of any origin: whatever site somebody
visits could read the flight. This one stands on the station's gate, and has nothing to send to.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from m100link.apps.agent.client import AgentClient
from m100link.apps.station.config import Settings
from m100link.apps.station.foxglove.feed import STATE_S, Feed
from m100link.apps.station.foxglove.session import SUBPROTOCOLS, Viewer
from m100link.apps.station.web.gate import Gate
from m100link.apps.station.web.logs import SparingLogger
from m100link.apps.station.web.protocol import WebSocketConnection
from m100link.telemetry.subscription import Newest

__all__ = ["FoxgloveServer"]

_POLICY_VIOLATION = 1008
_MAX_VIEWERS = 8
_WRITE_SIZE = 64 * 1024
_WAITING_SAMPLES = 20


class FoxgloveServer:
    """Viewers of some aircraft.

    Args:
        agents: By the name of their aircraft.
    """

    def __init__(self, agents: Mapping[str, AgentClient]) -> None:
        self._agents = agents
        self._viewers: dict[Viewer, None] = {}
        self._log = SparingLogger(logging.getLogger(__name__))
        offset = time.time() - asyncio.get_running_loop().time()
        self._session_id = f"{time.time_ns()}"
        self._feed = Feed(agents, offset, self._is_wanted, self._publish)

    def app(self, settings: Settings) -> Gate:
        """The application behind its gate."""
        routes = [WebSocketRoute("/{path:path}", self._serve), Route("/", self._greet)]
        return Gate(
            Starlette(routes=routes),
            hosts=settings.host_names(),
            origins=settings.allow_origin,
            access=settings.access(),
        )

    @asynccontextmanager
    async def feeding(self) -> AsyncIterator[None]:
        """While the block runs, viewers are told what the agents tell."""
        tasks = [
            asyncio.create_task(work)
            for name, agent in self._agents.items()
            for work in (self._telemetry(name, agent), self._states(name, agent))
        ]
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def _telemetry(self, name: str, agent: AgentClient) -> None:
        async with agent.samples(Newest(_WAITING_SAMPLES)) as samples:
            async for sample in samples:
                if self._viewers:
                    self._feed.hear(name, sample)

    async def _states(self, name: str, agent: AgentClient) -> None:
        while True:
            await asyncio.sleep(STATE_S)
            self._feed.hear_state(name, agent)

    def _is_wanted(self, channel: int) -> bool:
        return any(viewer.wants(channel) for viewer in self._viewers)

    def _publish(self, channel: int, at_ns: int, data: bytes) -> None:
        for viewer in self._viewers:
            viewer.publish(channel, at_ns, data)

    async def _greet(self, request: Request) -> Response:
        text = "m100link station: Foxglove and Lichtblick connect to this port by WebSocket.\n"
        return PlainTextResponse(text)

    async def _serve(self, websocket: WebSocket) -> None:
        offered = websocket.scope.get("subprotocols", ())
        spoken = next((one for one in SUBPROTOCOLS if one in offered), None)
        if spoken is None or len(self._viewers) >= _MAX_VIEWERS:
            why = "speaks another protocol" if spoken is None else "finds too many others"
            self._log.warning("a viewer was refused: it %s", why)
            await websocket.close(_POLICY_VIOLATION)
            return
        wake = asyncio.Event()
        viewer = Viewer(self._feed.channels, self._session_id, wake.set)
        self._viewers[viewer] = None
        try:
            await websocket.accept(subprotocol=spoken)
            reading = asyncio.create_task(self._read(websocket, viewer))
            writing = asyncio.create_task(self._write(websocket, viewer, wake))
            try:
                await asyncio.wait((reading, writing), return_when=asyncio.FIRST_COMPLETED)
            finally:
                for task in (reading, writing):
                    task.cancel()
                await asyncio.gather(reading, writing, return_exceptions=True)
        except WebSocketDisconnect:
            pass
        finally:
            del self._viewers[viewer]
            self._log.info("a viewer has gone (%d messages dropped)", viewer.dropped)

    async def _read(self, websocket: WebSocket, viewer: Viewer) -> None:
        loop = asyncio.get_running_loop()
        while True:
            message = await websocket.receive()
            if message["type"] == "websocket.disconnect":
                return
            data = message.get("text")
            viewer.receive(message.get("bytes", b"") if data is None else data, loop.time())
            await asyncio.sleep(0)  # others have their turn between two of them

    async def _write(self, websocket: WebSocket, viewer: Viewer, wake: asyncio.Event) -> None:
        # A viewer that does not read waits here alone: what it misses is dropped, and its pings
        # stay without an answer, for which the server cuts it off.
        connection: WebSocketConnection = websocket.scope["state"]["connection"]
        with contextlib.suppress(WebSocketDisconnect):
            while viewer.close_reason is None:
                wake.clear()
                frames = viewer.next_frames(_WRITE_SIZE)
                if not frames:
                    await wake.wait()
                    continue
                await connection.send_all(frames)
                await asyncio.sleep(0)
            await websocket.close(_POLICY_VIOLATION, viewer.close_reason)
