"""HTTP and WebSocket on one connection: uvicorn's protocols with the station's headers.

The headers are put where bytes leave, so that they stand on every answer: of the application, of
the gate, and those that the server gives itself. A connection that asks nothing, or asks without
end, is closed: it would take the place of one that asks.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
from collections.abc import AsyncIterator, Callable, Coroutine, Generator, Iterable
from functools import lru_cache
from http import HTTPStatus
from typing import TYPE_CHECKING, Any, Literal, cast

import h11
import uvicorn
from starlette.websockets import WebSocketDisconnect
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.exceptions import ProtocolError
from websockets.frames import CloseCode, Frame, Opcode
from websockets.server import ServerProtocol

from m100link.apps.agent.background import SparingLogger
from m100link.apps.station.web.intake import Intake, Metered, SocketListener
from m100link.apps.station.web.limits import FRAME_SIZE, ConnectionLimit
from m100link.errors import M100Error, UsageError

if TYPE_CHECKING:
    from starlette.types import ASGIApp
    from starlette.websockets import WebSocket
    from uvicorn._types import ASGISendEvent
    from websockets.http11 import Request, Response

    from m100link.apps.station.config import Settings
    from m100link.apps.station.listeners import Fronts


PING_INTERVAL, PING_TIMEOUT = 2.0, 3.0
_BACKLOG = 128
PATIENCE = 5.0  # seconds in which a connection has to have asked something completely

_FLUSH_TIME = 2.0

_LONGEST_HEAD = 16 * 1024
_REQUEST_COST = 16  # frames that a request stands for: 25 requests a second of one connection

_FRAMED = 512
"""Messages that are kept framed: more than ten clients with every topic are behind each other."""

ANSWER_TIME = 30.0
"""Seconds after which an answer that its client does not read to the end is given up."""

HEADERS = (
    # A page of another site that shows ours in an invisible frame would steer by clicks on itself.
    ("content-security-policy", "frame-ancestors 'none'"),
    ("x-frame-options", "DENY"),
    # A page that opens ours in another window would hold on to it, and move its focus about.
    ("cross-origin-opener-policy", "same-origin"),
    # Browsers that do not say whence they ask would hand it to a page of another site.
    ("cross-origin-resource-policy", "same-origin"),
    ("referrer-policy", "no-referrer"),
    ("x-content-type-options", "nosniff"),
)
"""On every answer of every port."""


class Config(uvicorn.Config):
    """The state that the connections of one server share."""

    def __init__(self, app: Any, intake: Intake | None = None, **keywords: Any) -> None:
        # Proxy headers are not believed: anybody could say who and how he came.
        own: dict[str, Any] = {"http": HttpConnection, "ws": WebSocketConnection}
        super().__init__(app, **keywords, **own, headers=list(HEADERS), proxy_headers=False)
        self.door = ConnectionLimit()  # connections that speak HTTP
        self.intake = intake or Intake()
        # Below warnings, uvicorn and websockets write addresses, headers and messages as they
        # came: tokens, cookies and the keys of pages stand in them.
        self.log = SparingLogger(logging.getLogger(__name__), least=logging.WARNING)


@lru_cache(maxsize=_FRAMED)
def _framed(message: str | bytes) -> bytes:
    """A message as a server sends it: the same bytes for every client, so they are made once."""
    if isinstance(message, str):
        return Frame(Opcode.TEXT, message.encode()).serialize(mask=False)
    return Frame(Opcode.BINARY, message).serialize(mask=False)


class _Frames(ServerProtocol):
    count = 0  # how many came

    def recv_frame(self, frame: Frame) -> None:
        """A frame has come.

        Raises ``ProtocolError``: it is of no use: a message of these would never be too long.
        """
        self.count += 1
        if frame.opcode is Opcode.CONT and not frame.data and not frame.fin:
            raise ProtocolError("empty continuation frame")
        super().recv_frame(frame)

    def send_response(self, response: Response) -> None:
        super().send_response(_with_headers(response))


def _with_headers(response: Response) -> Response:
    for name, value in HEADERS:
        if name not in response.headers:
            response.headers[name] = value
    return response


class WebSocketConnection(WebSocketsSansIOProtocol):
    config: Config

    def __init__(self, *args: Any, **keywords: Any) -> None:
        super().__init__(*args, **keywords)
        self.logger = cast(logging.Logger, self.config.log)
        self._heard_at = 0.0
        self.conn: _Frames = _Frames(max_size=self.config.ws_max_size, logger=self.logger)
        # Whether its client holds control of an aircraft, as its application knows.
        self.is_steering: Callable[[], bool] = lambda: False

    @property
    def events(self) -> int:
        return self.conn.count

    @property
    def steers(self) -> bool:
        return self.is_steering()

    def send_receive_event_to_app(self) -> None:
        """Pass a message on; a text that is none ends the connection by 1007, and is no report."""
        if self.curr_msg_data_type == "text" and not self.close_sent:
            try:
                b"".join(self.frames).decode()
            except UnicodeDecodeError:
                self.frames = []
                self.conn.send_close(CloseCode.INVALID_DATA)
                self.handle_parser_exception()
                return
        super().send_receive_event_to_app()

    def handle_ping(self) -> None:
        """Answer it; a client that reads nothing gets no answers that would pile up."""
        if self.writable.is_set():
            super().handle_ping()
        else:
            self.conn.data_to_send()

    def shutdown(self) -> None:
        """End it with the server; one that is closing already is left to its end."""
        if not self.transport.is_closing():
            super().shutdown()

    def handle_connect(self, event: Request) -> None:
        """Let the application find this connection as ``state["connection"]``."""
        super().handle_connect(event)
        if self.response.status_code == HTTPStatus.SWITCHING_PROTOCOLS:
            self.scope.setdefault("state", {})["connection"] = self
            # A client that does not wait for the answer has said nothing until there is one.
            self.transport.pause_reading()

    async def send(self, message: ASGISendEvent) -> None:
        await super().send(message)
        if message["type"] == "websocket.accept":
            self.transport.resume_reading()

    def data_received(self, data: bytes) -> None:
        """A client that says anything is alive; the first data are the head of its request."""
        self._heard_at = self.loop.time()
        super().data_received(data)
        if not self.handshake_initiated:
            # h11 took the head, and websockets does not: nobody else would answer it, or end this.
            refusal = self.conn.reject(HTTPStatus.BAD_REQUEST, "This cannot be read.")
            said = b"".join(self.conn.data_to_send()) or _with_headers(refusal).serialize()
            self.transport.write(said)
            self.transport.close()

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
        # A peer that does not read must not keep the connection.
        self.loop.call_later(_FLUSH_TIME, self.transport.abort)

    async def send_all(self, messages: Iterable[str | bytes]) -> None:
        """Send messages in one write, after what was written before has gone out.

        Raises ``WebSocketDisconnect``: the connection is closed.
        """
        await self.writable.wait()
        if self.disconnected or self.close_sent or self.transport.is_closing():
            raise WebSocketDisconnect(1006)
        self.transport.write(b"".join((*self.conn.data_to_send(), *map(_framed, messages))))


class _Requests(h11.Connection):
    """Requests, counted. None has a body: nothing that the station serves needs one."""

    count = 0  # of parsed events; a request counts for as many frames as it costs
    is_too_much = False  # whether a request came with a body

    def next_event(self) -> Any:
        """The next event of the connection.

        Raises ``RemoteProtocolError``: it is not HTTP, or it has a body.
        """
        event = super().next_event()
        if isinstance(event, h11.Request):
            self.count += _REQUEST_COST
            if any(_announces_body(*header) for header in event.headers):
                self.is_too_much = True
                raise h11.RemoteProtocolError("a request has no body here", 413)
        elif event is not h11.NEED_DATA and event is not h11.PAUSED:
            self.count += 1
        return event


def _announces_body(name: bytes, value: bytes) -> bool:
    return name == b"transfer-encoding" or (name == b"content-length" and value.strip(b"0") != b"")


class HttpConnection(H11Protocol):
    """A connection that speaks HTTP, until it asks for a WebSocket."""

    config: Config
    steers = False  # it does not

    def __init__(self, *args: Any, **keywords: Any) -> None:
        super().__init__(*args, **keywords)
        self.logger = cast(logging.Logger, self.config.log)
        self.conn: _Requests = _Requests(h11.SERVER, _LONGEST_HEAD)
        self.peer = ""  # address that it comes from
        # Ends the connection unless it asks something, or its answer is on the way.
        self._patience: asyncio.TimerHandle | None = None
        self._waited = 0.0

    @property
    def events(self) -> int:
        return self.conn.count

    @property
    def is_answered(self) -> bool:
        cycle = self.cycle
        return cycle is None or cycle.response_complete or cycle.more_body

    def turn_out(self) -> None:
        self._end_patience()
        self.transport.abort()

    def shutdown(self) -> None:
        """End it with the server; one that is closing already is left to its end."""
        if not self.transport.is_closing():
            super().shutdown()

    # uvicorn narrows the argument as well: what it is given is always a transport with both ways.
    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self.peer = self.client[0] if self.client else ""
        self._begin_patience()
        self.config.door.enter(self)

    def connection_lost(self, exc: Exception | None) -> None:
        self._leave()
        super().connection_lost(exc)

    def on_response_complete(self) -> None:
        """It may ask again, within the same time."""
        self._begin_patience()
        self.config.door.answered(self)
        super().on_response_complete()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        self._leave()
        super().handle_websocket_upgrade(event)
        cast(Metered, self.transport).put_back(len(self.conn.trailing_data[0]))

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
        """Answer here: bytes that are not HTTP, or too many, reach no application that could."""
        status = HTTPStatus.BAD_REQUEST
        if self.conn.is_too_much:
            status, msg = HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "A request has no body here."
        text = msg.encode("ascii")
        headers = [(name.encode(), value.encode()) for name, value in HEADERS]
        headers += [
            (b"content-type", b"text/plain; charset=utf-8"),
            (b"content-length", str(len(text)).encode()),
            (b"connection", b"close"),
        ]
        for event in (
            h11.Response(status_code=status, headers=headers, reason=status.phrase.encode()),
            h11.Data(data=text),
            h11.EndOfMessage(),
        ):
            self.transport.write(self.conn.send(event) or b"")
        self.transport.close()


# -- the server of one front -----------------------------------------------------------------------


class Server(uvicorn.Server):
    """uvicorn inside a program: signals stay with the program."""

    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None, None, None]:
        """Leave the signals alone; the program ends the server by ``should_exit``."""
        yield

    @classmethod
    def make(
        cls,
        app: ASGIApp,
        settings: Settings,
        *,
        lifespan: Literal["on", "off"] = "off",
        intake: Intake | None = None,
    ) -> Server:
        config = Config(
            app,
            intake,
            ws_max_size=FRAME_SIZE,
            ws_ping_interval=PING_INTERVAL,
            ws_ping_timeout=PING_TIMEOUT,
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=2,
            timeout_keep_alive=5,
            lifespan=lifespan,
            log_config=None,
            log_level="warning",  # its "info" prints addresses with their tokens
            access_log=False,
            server_header=False,
            ssl_certfile=settings.tls_cert,
            ssl_keyfile=settings.tls_key,
        )
        try:
            config.load()
        except OSError as error:  # that of OpenSSL is one
            key = settings.tls_key or "in the same file"
            raise UsageError(
                f"the TLS files cannot be used: {error.strerror or error}",
                remedy=f"the certificate is {settings.tls_cert}, its key {key}: check both paths, "
                "their permissions, and that both are PEM",
            ) from error
        return cls(config)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to listen. A TLS handshake has as little time as a first request."""
        await self.lifespan.startup()
        if self.lifespan.should_exit:
            raise M100Error("the page did not start", remedy="read the error in the log above")
        config = cast(Config, self.config)
        self.server_state.default_headers = list(config.encoded_headers)

        def connection() -> asyncio.Protocol:
            return HttpConnection(config, self.server_state, self.lifespan.state)

        self.servers = []
        for one in sockets or []:
            one.listen(_BACKLOG)
            listener = SocketListener(
                one, config.intake, config.door, connection, context=config.ssl, patience=PATIENCE
            )
            # uvicorn only closes it.
            self.servers.append(cast(asyncio.Server, listener))
        self.started = True

    def stop_listening(self) -> None:
        """Take no new connections; those that are there stay."""
        for one in self.servers:
            one.close()


async def serve_http(
    fronts: Fronts, name: str, app: ASGIApp, *, lifespan: Literal["on", "off"] = "off"
) -> None:
    server = Server.make(app, fronts.settings, lifespan=lifespan, intake=fronts.intake)
    await fronts.stack.enter_async_context(_serving(server, fronts.take(name)))
    fronts.leave_port.append(server.stop_listening)


@contextlib.asynccontextmanager
async def _serving(server: Server, sockets: list[socket.socket]) -> AsyncIterator[None]:
    serving = asyncio.create_task(server.serve(sockets=sockets), name="m100link station: server")
    try:
        while not (server.started or serving.done()):  # noqa: ASYNC110 - uvicorn has no event
            await asyncio.sleep(0.01)
        if serving.done():
            await serving
        yield
    finally:
        server.should_exit = True  # uvicorn closes the clients' connections
        (met,) = await asyncio.gather(serving, return_exceptions=True)
        if server.started and isinstance(met, Exception):
            logging.getLogger(__name__).error("a server did not end in order", exc_info=met)
        for one in sockets:
            one.close()


async def frames_of(websocket: WebSocket) -> AsyncIterator[str | bytes]:
    while True:
        message = await websocket.receive()
        if message["type"] == "websocket.disconnect":
            return
        data = message.get("text")
        yield message.get("bytes", b"") if data is None else data
        # Frames may wait in a row: others have their turn between them.
        await asyncio.sleep(0)


async def until_one_ends(
    *works: Coroutine[Any, Any, object],
    at_once: Callable[[], None] = lambda: None,  # called before the others are ended
) -> None:
    """Run them together until the first one ends, whatever it met, and end the others."""
    tasks = [asyncio.create_task(work) for work in works]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        at_once()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
