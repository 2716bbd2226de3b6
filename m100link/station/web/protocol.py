"""HTTP and WebSocket on one connection: uvicorn's protocols with the station's headers.

The headers are put where bytes leave, so that they stand on every answer: of the application, of
the gate, and those that the server gives itself. A connection that asks nothing, or asks without
end, is closed: it would take the place of one that asks.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterable
from functools import lru_cache
from http import HTTPStatus
from typing import TYPE_CHECKING, Any, cast

import h11
import uvicorn
from starlette.websockets import WebSocketDisconnect
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import Frame, Opcode
from websockets.server import ServerProtocol

from m100link.station.web.door import Door
from m100link.station.web.logs import SparingLogger

if TYPE_CHECKING:
    from websockets.http11 import Request, Response

__all__ = ["HEADERS", "Config", "HttpConnection", "WebSocketConnection"]

PATIENCE = 5.0
"""Seconds in which a connection has to have asked something completely."""

_FLUSH_TIME = 2.0

_FRAMED = 512
"""Messages that are kept framed: more than ten clients with every topic are behind each other."""

ANSWER_TIME = 30.0
"""Seconds after which an answer that its client does not read to the end is given up."""

HEADERS = (
    # A page of another site that shows ours in an invisible frame would steer by clicks on itself.
    ("content-security-policy", "frame-ancestors 'none'"),
    ("x-frame-options", "DENY"),
    ("referrer-policy", "no-referrer"),
    ("x-content-type-options", "nosniff"),
)
"""On every answer of every port."""


class Config(uvicorn.Config):
    """What the connections of one server share.

    Attributes:
        door: Connections that speak HTTP.
        log: Where they complain.
    """

    def __init__(self, app: Any, **keywords: Any) -> None:
        # Proxy headers are not believed: anybody could say who and how he came.
        own: dict[str, Any] = {"http": HttpConnection, "ws": WebSocketConnection}
        super().__init__(app, **keywords, **own, headers=list(HEADERS), proxy_headers=False)
        self.door = Door()
        self.log = SparingLogger(logging.getLogger(__name__))


@lru_cache(maxsize=_FRAMED)
def _framed(message: str | bytes) -> bytes:
    """A message as a server sends it: the same bytes for every client, so they are made once."""
    if isinstance(message, str):
        return Frame(Opcode.TEXT, message.encode()).serialize(mask=False)
    return Frame(Opcode.BINARY, message).serialize(mask=False)


class _Handshake(ServerProtocol):
    def send_response(self, response: Response) -> None:
        """Accepted, refused or failed: each goes out here."""
        for name, value in HEADERS:
            if name not in response.headers:
                response.headers[name] = value
        super().send_response(response)


class WebSocketConnection(WebSocketsSansIOProtocol):
    """A WebSocket of the station."""

    config: Config

    def __init__(self, *args: Any, **keywords: Any) -> None:
        super().__init__(*args, **keywords)
        self.logger = cast(logging.Logger, self.config.log)
        self._heard_at = 0.0
        self.conn = _Handshake(max_size=self.config.ws_max_size, logger=self.logger)

    def handle_connect(self, event: Request) -> None:
        """Let the application find this connection as ``state["connection"]``."""
        super().handle_connect(event)
        if self.response.status_code == HTTPStatus.SWITCHING_PROTOCOLS:
            self.scope.setdefault("state", {})["connection"] = self

    def data_received(self, data: bytes) -> None:
        """A client that says anything is alive."""
        self._heard_at = self.loop.time()
        super().data_received(data)

    def keepalive_timeout(self) -> None:
        """No pong came in time: the client is gone, unless it said something else since.

        Its pong may stand behind what the station has not read yet, or came while the station
        itself did not run.
        """
        if self._heard_at > self.ping_sent_at or self.read_paused:
            self.pong_timer, self.pending_ping_payload = None, None
            self.schedule_ping()
            return
        super().keepalive_timeout()
        # What it does not read must not keep the connection.
        self.loop.call_later(_FLUSH_TIME, self.transport.abort)

    async def send_all(self, messages: Iterable[str | bytes]) -> None:
        """Send messages in one write, after what was written before has gone out.

        Raises:
            WebSocketDisconnect: The connection is closed.
        """
        await self.writable.wait()
        if self.disconnected or self.close_sent or self.transport.is_closing():
            raise WebSocketDisconnect(1006)
        self.transport.write(b"".join((*self.conn.data_to_send(), *map(_framed, messages))))


class HttpConnection(H11Protocol):
    """A connection that speaks HTTP, until it asks for a WebSocket.

    Attributes:
        peer: Address that it comes from.
    """

    config: Config

    def __init__(self, *args: Any, **keywords: Any) -> None:
        super().__init__(*args, **keywords)
        self.logger = cast(logging.Logger, self.config.log)
        self.peer = ""
        # Ends the connection unless it asks something, or its answer is on the way.
        self._patience: asyncio.TimerHandle | None = None
        self._waited = 0.0

    @property
    def is_answered(self) -> bool:
        """Whether it asked nothing that is being answered now."""
        cycle = self.cycle
        return cycle is None or cycle.response_complete or cycle.more_body

    def turn_out(self) -> None:
        """Close it at once."""
        self._end_patience()
        self.transport.abort()

    # uvicorn narrows the argument as well: what it is given is always a transport with both ways.
    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """A client has come."""
        super().connection_made(transport)
        self.peer = self.client[0] if self.client else ""
        self._begin_patience()
        self.config.door.enter(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """It has gone."""
        self._leave()
        super().connection_lost(exc)

    def on_response_complete(self) -> None:
        """It may ask again, within the same time."""
        self._begin_patience()
        self.config.door.answered(self)
        super().on_response_complete()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """From now on it is a WebSocket."""
        if not self.config.door.lets_through(self.peer, self.loop.time()):
            self.turn_out()
            return
        self._leave()
        super().handle_websocket_upgrade(event)

    def _leave(self) -> None:
        self._end_patience()
        self.config.door.leave(self)

    def _begin_patience(self) -> None:
        self._end_patience()
        self._waited = 0.0
        self._patience = self.loop.call_later(PATIENCE, self._look_again)

    def _end_patience(self) -> None:
        if self._patience is not None:
            self._patience.cancel()
            self._patience = None

    def _look_again(self) -> None:
        self._waited += PATIENCE
        if self.is_answered or self._waited >= ANSWER_TIME:
            self.turn_out()
        else:
            self._patience = self.loop.call_later(PATIENCE, self._look_again)

    def send_400_response(self, msg: str) -> None:
        """What is not HTTP has no application that could answer."""
        text = msg.encode("ascii")
        headers = [(name.encode(), value.encode()) for name, value in HEADERS]
        headers += [
            (b"content-type", b"text/plain; charset=utf-8"),
            (b"content-length", str(len(text)).encode()),
            (b"connection", b"close"),
        ]
        for event in (
            h11.Response(status_code=400, headers=headers, reason=b"Bad Request"),
            h11.Data(data=text),
            h11.EndOfMessage(),
        ):
            self.transport.write(self.conn.send(event) or b"")
        self.transport.close()
