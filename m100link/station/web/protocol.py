"""HTTP and WebSocket on one connection: uvicorn's protocols with the station's headers.

The headers are put where bytes leave, so that they stand on every answer: of the application, of
the gate, and those that the server gives itself.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.server import ServerProtocol

if TYPE_CHECKING:
    from websockets.http11 import Response

__all__ = ["HEADERS", "HttpConnection", "WebSocketConnection"]

HEADERS = (
    # A page of another site that shows ours in an invisible frame would steer by clicks on itself.
    ("content-security-policy", "frame-ancestors 'none'"),
    ("x-frame-options", "DENY"),
    ("referrer-policy", "no-referrer"),
    ("x-content-type-options", "nosniff"),
)
"""On every answer of every port."""


class _Handshake(ServerProtocol):
    def send_response(self, response: Response) -> None:
        """Accepted, refused or failed: each goes out here."""
        for name, value in HEADERS:
            if name not in response.headers:
                response.headers[name] = value
        super().send_response(response)


class WebSocketConnection(WebSocketsSansIOProtocol):
    """A WebSocket of the station."""

    def __init__(self, *args: Any, **keywords: Any) -> None:
        super().__init__(*args, **keywords)
        self.conn = _Handshake(max_size=self.config.ws_max_size, logger=self.logger)


class HttpConnection(H11Protocol):
    """A connection that speaks HTTP, until it asks for a WebSocket."""

    def send_400_response(self, msg: str) -> None:
        """What is no HTTP has no application that could answer."""
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
