"""The same goes over the line from application, gate and server itself."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

pytest.importorskip("uvicorn")
pytest.importorskip("starlette")

from starlette.applications import Starlette
from starlette.routing import WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect
from websockets.frames import Frame

from m100link.apps.station.config import Settings
from m100link.apps.station.listeners import Fronts, Sockets
from m100link.apps.station.run import RunningStation, running
from m100link.apps.station.web import intake, protocol
from m100link.errors import M100Error
from m100link.sim.virtual import VirtualAircraft
from tests.sockets import connect
from tests.waiting import PATIENCE

pytestmark = pytest.mark.anyio

TOKEN = "0123456789abcdefXY"
UPGRADE = "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
KEY = "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
MANY = "X-Many: x\r\n" * 130
HOST = "Host: 127.0.0.1:{port}\r\n"


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"  # real time: sockets are not virtual


@contextlib.asynccontextmanager
async def station(**options: Any) -> AsyncIterator[RunningStation]:
    virtual = VirtualAircraft(seed=5)
    async with running(Settings(sim=True, port=0, **options), virtual=virtual) as one:
        yield one


async def until(predicate: Callable[[], bool], within: float = PATIENCE) -> None:
    async with asyncio.timeout(within):
        while not predicate():  # noqa: ASYNC110 - polls what has no event
            await asyncio.sleep(0.005)


async def ask(port: int, request: str, within: float = PATIENCE) -> str:
    """Bytes out as they stand, head of the answer in lower case back."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        writer.write(request.replace("{port}", str(port)).encode())
        async with asyncio.timeout(within):
            return (await reader.readuntil(b"\r\n\r\n")).decode().lower()
    finally:
        writer.close()


@pytest.mark.parametrize(
    ("request_text", "status"),
    [
        (f"GET / HTTP/1.1\r\n{HOST}\r\n", 200),
        (f"GET /page.html HTTP/1.1\r\n{HOST}\r\n", 200),
        (f"GET /none HTTP/1.1\r\n{HOST}\r\n", 404),
        (f"POST / HTTP/1.1\r\n{HOST}Content-Length: 0\r\n\r\n", 405),
        ("GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n", 403),
        (f"GET / HTTP/1.1\r\n{HOST}Origin: http://evil.example\r\n\r\n", 403),
        ("this is no HTTP\r\n\r\n", 400),
        (f"GET / HTTP/1.1\r\n{HOST}{UPGRADE}{KEY}\r\n", 101),
        (f"GET / HTTP/1.1\r\n{HOST}{UPGRADE}\r\n", 400),
        (f"GET / HTTP/1.1\r\n{HOST}{UPGRADE.replace('13', '7')}{KEY}\r\n", 400),
        (f"GET / HTTP/1.1\r\n{HOST}{UPGRADE}{KEY}Origin: http://evil.example\r\n\r\n", 403),
        # HTTP's parser takes these heads, and that of WebSockets does not.
        (f"GET / HTTP/1.1\r\n{HOST}{UPGRADE}{KEY}X-Odd: a\bb\r\n\r\n", 400),
        (f"GET / HTTP/1.1\r\n{HOST}{UPGRADE}{KEY}X-Long: {'x' * 9000}\r\n\r\n", 431),
        (f"GET / HTTP/1.1\r\n{HOST}{UPGRADE}{KEY}{MANY}\r\n", 431),
    ],
)
async def test_no_answer_may_stand_in_a_frame_of_another_page(
    request_text: str, status: int, tmp_path: Path
) -> None:
    (tmp_path / "index.html").write_text("<p>index</p>")
    (tmp_path / "page.html").write_text("<p>page</p>")
    async with station(pages=tmp_path) as one:
        head = await ask(one.sockets.port("rosbridge"), request_text)
    lines = head.split("\r\n")
    assert lines[0].startswith(f"http/1.1 {status}")
    for line in (
        "content-security-policy: frame-ancestors 'none'",
        "x-frame-options: deny",
        "cross-origin-opener-policy: same-origin",
        "cross-origin-resource-policy: same-origin",
        "referrer-policy: no-referrer",
        "x-content-type-options: nosniff",
    ):
        assert lines.count(line) == 1, head


async def half_open(port: int, begin: bytes = b"") -> socket.socket:
    """A connection that begins to ask, and does not go on."""
    one = socket.socket()
    one.setblocking(False)
    loop = asyncio.get_running_loop()
    await loop.sock_connect(one, ("127.0.0.1", port))
    if begin:
        await loop.sock_sendall(one, begin)
    return one


@pytest.mark.parametrize("begin", [b"", b"GET / HTTP/1.1\r\nHost: 127.0", b"POST / HTTP/1.1\r\n"])
async def test_connections_that_ask_nothing_lock_nobody_out(
    begin: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(protocol, "PATIENCE", 2 * PATIENCE)  # none of them is let go meanwhile
    async with station() as one:
        port = one.sockets.port("rosbridge")
        await until(lambda: one.agent.connection.aircraft is not None)
        sockets = [await half_open(port, begin) for _ in range(300)]
        async with asyncio.timeout(PATIENCE):
            head = await ask(port, f"GET /health HTTP/1.1\r\n{HOST}\r\n")
            assert head.startswith("http/1.1 200")
            async with connect(f"ws://127.0.0.1:{port}") as client:
                await client.send('{"op":"subscribe","topic":"/flight_status"}')
                await client.recv()
        for each in sockets:
            each.close()


@pytest.mark.parametrize(
    "begin",
    [
        b"",
        b"GET / HTT",
        b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 10\r\n\r\n12",
        b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\nGET / HT",
    ],
)
async def test_a_request_has_to_come_in_time(begin: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("m100link.apps.station.web.protocol.PATIENCE", 0.2)
    async with station() as one:
        reader, writer = await asyncio.open_connection("127.0.0.1", one.sockets.port("rosbridge"))
        writer.write(begin)

        async def drip() -> None:  # a byte now and then is not a request
            with contextlib.suppress(ConnectionError):
                while True:
                    await asyncio.sleep(0.05)
                    writer.write(b"x")
                    await writer.drain()

        dripping = asyncio.create_task(drip())
        async with asyncio.timeout(PATIENCE):
            with contextlib.suppress(ConnectionError):
                while await reader.read(1000):
                    pass
        dripping.cancel()
        await asyncio.gather(dripping, return_exceptions=True)
        writer.close()
        with contextlib.suppress(ConnectionError):
            await writer.wait_closed()


async def test_an_answer_that_is_not_read_is_given_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("m100link.apps.station.web.protocol.PATIENCE", 0.1)
    monkeypatch.setattr("m100link.apps.station.web.protocol.ANSWER_TIME", 0.4)
    (tmp_path / "large").write_bytes(bytes(50_000_000))
    async with station(pages=tmp_path) as one:
        lazy = await half_open(
            one.sockets.port("rosbridge"), b"GET /large HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
        )
        await asyncio.sleep(1.0)
        received = 0
        with contextlib.suppress(ConnectionError):
            while data := await asyncio.get_running_loop().sock_recv(lazy, 1 << 20):
                received += len(data)
        assert received < 50_000_000
        lazy.close()


ONE_BYTE_CHUNK = b"1\r\na\r\n"


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1"])
@pytest.mark.parametrize(
    "body", ["Transfer-Encoding: chunked", "Content-Length: 240000", "Content-Length: 1"]
)
async def test_a_request_with_a_body_is_refused_and_nothing_of_the_body_is_parsed(
    host: str, body: str
) -> None:
    async with station() as one:
        reader, writer = await asyncio.open_connection("127.0.0.1", one.sockets.port("rosbridge"))
        writer.write(f"POST / HTTP/1.1\r\nHost: {host}\r\n{body}\r\n\r\n".encode())
        head = (await reader.readuntil(b"\r\n\r\n")).decode().lower()
        assert head.startswith("http/1.1 413")
        assert "connection: close" in head
        with contextlib.suppress(ConnectionError):  # it is closed, whatever is still to come
            for _ in range(1000):
                writer.write(ONE_BYTE_CHUNK * 400)
                await writer.drain()
            pytest.fail("a refused connection takes 2.4 MB more")
        writer.close()


async def test_a_refused_request_is_the_last_of_its_connection() -> None:
    async with station() as one:
        reader, writer = await asyncio.open_connection("127.0.0.1", one.sockets.port("rosbridge"))
        request = b"GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n"
        writer.write(request * 20)
        answers = b""
        with contextlib.suppress(ConnectionError):
            answers = await reader.read(100_000)
            answers += await reader.read(100_000)
        assert answers.count(b"HTTP/1.1 403") == 1
        assert b"connection: close" in answers.lower()
        writer.close()


def frame(opcode: int, data: bytes = b"", *, is_last: bool = True) -> bytes:
    """A short masked frame, RFC 6455 section 5.2; the mask is zeros."""
    return bytes((0x80 * is_last | opcode, 0x80 | len(data))) + bytes(4) + data


TEXT, CONTINUATION, PING, CLOSE = 0x1, 0x0, 0x9, 0x8


async def opened(port: int) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(f"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n{UPGRADE}{KEY}\r\n".encode())
    assert (await reader.readuntil(b"\r\n\r\n")).startswith(b"HTTP/1.1 101")
    return reader, writer


async def test_an_empty_continuation_frame_that_is_not_the_last_ends_the_connection() -> None:
    async with station() as one:
        reader, writer = await opened(one.sockets.port("rosbridge"))
        writer.write(frame(TEXT, b"{", is_last=False) + frame(CONTINUATION, is_last=False))
        answer = await asyncio.wait_for(reader.readexactly(4), PATIENCE)
        assert answer[0] == 0x80 | CLOSE
        assert int.from_bytes(answer[2:], "big") == 1002  # protocol error
        writer.close()


async def test_a_message_in_pieces_is_taken_and_may_end_by_an_empty_one() -> None:
    async with station() as one:
        reader, writer = await opened(one.sockets.port("rosbridge"))
        call = b'{"op":"call_service","service":"/rosapi/topics","id":"7"}'
        pieces = [frame(TEXT, call[:1], is_last=False)]
        pieces += [frame(CONTINUATION, call[n : n + 1], is_last=False) for n in range(1, len(call))]
        writer.write(b"".join(pieces) + frame(CONTINUATION))
        async with asyncio.timeout(PATIENCE):
            await reader.readuntil(b'"id": "7"')
        writer.close()


async def test_a_client_that_speaks_before_it_was_let_in_is_heard_afterwards() -> None:
    async with station() as one:
        reader, writer = await asyncio.open_connection("127.0.0.1", one.sockets.port("rosbridge"))
        call = b'{"op":"call_service","service":"/rosapi/get_time","id":"early"}'
        head = f"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n{UPGRADE}{KEY}\r\n".encode()
        writer.write(head + frame(TEXT, call))
        async with asyncio.timeout(PATIENCE):
            await reader.readuntil(b'"early"')
        writer.close()


@pytest.mark.parametrize(
    "flood",
    [frame(PING), frame(TEXT, b"x"), frame(CONTINUATION, b"x", is_last=False)],
    ids=["pings", "messages", "one-byte continuations"],
)
async def test_more_frames_than_a_client_may_send_end_its_connection(
    flood: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After 5 s, which are shorter here: how long is tested on virtual time."""
    monkeypatch.setattr(intake, "_STRAIN", 0.5)
    async with station() as one, connect(f"ws://127.0.0.1:{one.sockets.port('rosbridge')}") as calm:
        reader, writer = await opened(one.sockets.port("rosbridge"))
        draining = asyncio.create_task(reader.read())
        if not flood[0] & 0x8F:
            writer.write(frame(TEXT, b"{", is_last=False))
        with contextlib.suppress(ConnectionError):
            async with asyncio.timeout(PATIENCE):
                while not draining.done():
                    writer.write(flood * 1000)
                    await writer.drain()
        await asyncio.wait((draining,))
        await calm.send('{"op":"call_service","service":"/rosapi/get_time"}')
        await calm.recv()
        writer.close()


@pytest.mark.parametrize(
    "said",
    [frame(TEXT, b"{\xff}"), frame(TEXT, b"{\xc3", is_last=False) + frame(CONTINUATION, b"\x28}")],
    ids=["whole", "fragmented"],
)
async def test_a_text_that_is_none_ends_its_connection_and_is_no_report(
    said: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    async with station() as one:
        reader, writer = await opened(one.sockets.port("rosbridge"))
        writer.write(said)
        async with asyncio.timeout(PATIENCE):
            rest = await reader.read()
        writer.close()
    assert b"\x88\x02\x03\xef" in rest  # a close frame with 1007
    assert not [line for line in caplog.records if line.exc_info]


async def read_later(reader: asyncio.StreamReader) -> None:
    await asyncio.sleep(0.3)  # the server has told its connections to end by then
    await reader.read()


async def test_a_socket_that_is_closing_keeps_no_server_from_its_end(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its application ends in order, and not by a traceback when the process ends."""
    ended: list[str] = []
    closing = asyncio.Event()
    closed = protocol.WebSocketConnection.handle_close

    def watched(self: protocol.WebSocketConnection, event: Frame) -> None:
        closed(self, event)
        closing.set()

    monkeypatch.setattr(protocol.WebSocketConnection, "handle_close", watched)

    @contextlib.asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        yield
        ended.append("in order")

    async def talk(websocket: WebSocket) -> None:
        await websocket.accept()
        with contextlib.suppress(WebSocketDisconnect):
            await websocket.send_bytes(bytes(20_000_000))  # more than its client takes
            await websocket.receive_bytes()

    app = Starlette(routes=[WebSocketRoute("/", talk)], lifespan=lifespan)
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.setblocking(False)
        async with contextlib.AsyncExitStack() as stack:
            sockets = Sockets({"here": [listening]})
            fronts = Fronts(stack, Settings(), sockets, {}, {}, is_kept=False)
            await protocol.serve_http(fronts, "here", app, lifespan="on")
            reader, writer = await opened(sockets.port("here"))
            writer.write(frame(CLOSE, (1000).to_bytes(2, "big")))
            await asyncio.wait_for(closing.wait(), PATIENCE)
            draining = asyncio.create_task(read_later(reader))
        await draining
        writer.close()
    assert ended == ["in order"]
    assert not [line for line in caplog.records if line.levelname == "ERROR"]


async def test_a_page_that_does_not_start_is_no_page_that_is_served() -> None:
    """Without shared memory or files NiceGUI failed, and the station printed its address."""

    @contextlib.asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        for refused in (OSError(24, "Too many open files"),):
            raise refused
        yield

    with socket.create_server(("127.0.0.1", 0)) as listening:
        async with contextlib.AsyncExitStack() as stack:
            sockets = Sockets({"here": [listening]})
            fronts = Fronts(stack, Settings(), sockets, {}, {}, is_kept=False)
            with pytest.raises(M100Error, match="the page did not start"):
                await protocol.serve_http(
                    fronts, "here", Starlette(lifespan=lifespan), lifespan="on"
                )


@pytest.mark.parametrize(
    "ended", [(True, False, False), (False, True, False), (False, False, True)]
)
async def test_nothing_is_written_to_a_client_that_has_gone(ended: tuple[bool, ...]) -> None:
    one = object.__new__(protocol.WebSocketConnection)
    one.disconnected, one.close_sent, is_closing = ended
    one.writable, one.transport = asyncio.Event(), Mock()
    one.transport.is_closing.return_value = is_closing
    one.writable.set()
    with pytest.raises(WebSocketDisconnect):
        await one.send_all(["{}"])
    assert one.transport.write.call_count == 0


async def test_a_client_that_pings_and_reads_nothing_grows_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("EVENTS_RATE", "EVENTS_AT_ONCE", "BYTES_RATE", "BYTES_AT_ONCE"):
        monkeypatch.setattr(intake, name, 1e9)
    sizes: list[int] = []
    answered = protocol.WebSocketConnection.handle_ping

    def watched(self: protocol.WebSocketConnection) -> None:
        answered(self)
        sizes.append(self.transport.get_write_buffer_size())

    monkeypatch.setattr(protocol.WebSocketConnection, "handle_ping", watched)
    async with station() as one:
        loop, client = asyncio.get_running_loop(), socket.socket()
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        client.setblocking(False)
        await loop.sock_connect(client, ("127.0.0.1", one.sockets.port("rosbridge")))
        head = f"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n{UPGRADE}{KEY}\r\n"
        await loop.sock_sendall(client, head.encode())
        while len(sizes) < 40_000:
            await loop.sock_sendall(client, frame(PING, bytes(125)) * 100)
        client.close()
    assert 0 < max(sizes) < 100_000  # 65,536 is where asyncio says that it is full
