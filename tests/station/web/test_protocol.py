"""What goes over the line whoever answers: the application, the gate or the server itself."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("uvicorn")
pytest.importorskip("starlette")
from websockets.asyncio.client import connect

from m100link.sim.virtual import VirtualAircraft
from m100link.station.config import Settings
from m100link.station.run import Running, running
from tests.waiting import PATIENCE

pytestmark = pytest.mark.anyio

TOKEN = "0123456789abcdefXY"
UPGRADE = "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
KEY = "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
HOST = "Host: 127.0.0.1:{port}\r\n"


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"  # real time: sockets are not virtual


@contextlib.asynccontextmanager
async def station(**options: Any) -> AsyncIterator[Running]:
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
    ],
)
async def test_no_answer_may_stand_in_a_frame_of_another_page(
    request_text: str, status: int, tmp_path: Path
) -> None:
    (tmp_path / "index.html").write_text("<p>index</p>")
    (tmp_path / "page.html").write_text("<p>page</p>")
    async with station(pages=tmp_path) as one:
        head = await ask(one.ports[0], request_text)
    lines = head.split("\r\n")
    assert lines[0].startswith(f"http/1.1 {status}")
    for line in (
        "content-security-policy: frame-ancestors 'none'",
        "x-frame-options: deny",
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
async def test_connections_that_ask_nothing_lock_nobody_out(begin: bytes) -> None:
    async with station() as one:
        port = one.ports[0]
        await until(lambda: one.agent.connection.aircraft is not None)
        sockets = [await half_open(port, begin) for _ in range(300)]
        began = asyncio.get_running_loop().time()
        head = await ask(port, f"GET /health HTTP/1.1\r\n{HOST}\r\n")
        assert head.startswith("http/1.1 200")
        async with connect(f"ws://127.0.0.1:{port}") as client:
            await client.send('{"op":"subscribe","topic":"/flight_status"}')
            await client.recv()
        assert asyncio.get_running_loop().time() - began < 3.0
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
    monkeypatch.setattr("m100link.station.web.protocol.PATIENCE", 0.2)
    async with station() as one:
        reader, writer = await asyncio.open_connection("127.0.0.1", one.ports[0])
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
    monkeypatch.setattr("m100link.station.web.protocol.PATIENCE", 0.1)
    monkeypatch.setattr("m100link.station.web.protocol.ANSWER_TIME", 0.4)
    (tmp_path / "large").write_bytes(bytes(50_000_000))
    async with station(pages=tmp_path) as one:
        lazy = await half_open(one.ports[0], b"GET /large HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        await asyncio.sleep(1.0)
        received = 0
        with contextlib.suppress(ConnectionError):
            while data := await asyncio.get_running_loop().sock_recv(lazy, 1 << 20):
                received += len(data)
        assert received < 50_000_000
        lazy.close()
