"""Eight strangers and eight clients with the token, each with whatever is dearest to be read.

Each of them sends one kind of flood for a second or so, as fast as it is taken, then another one:
``python -m tests.attacks.everything PORT CONSOLE_PORT TOKEN [--seconds 10] [--tls] [--seed 1]``.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import random
import ssl
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from importlib.metadata import version

__all__ = ["CLIENTS", "STRANGERS", "Target"]

EACH = 8
_KEY = "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
_UPGRADE = f"Connection: Upgrade\r\nUpgrade: websocket\r\n{_KEY}"
_CHUNKS = b"1\r\na\r\n" * 10_000


@dataclass(frozen=True, slots=True)
class Target:
    """A station on this machine.

    Attributes:
        port: Of rosbridge.
        console: Port of the console.
        token: What clients know.
        metrics: Port of the numbers for Prometheus.
        foxglove: Port of Foxglove's viewers.
        context: For TLS, None without it.
    """

    port: int
    console: int
    token: str
    metrics: int = 0
    foxglove: int = 0
    context: ssl.SSLContext | None = None

    async def open(
        self, port: int | None = None
    ) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        """A connection, of rosbridge by default."""
        return await asyncio.open_connection("127.0.0.1", port or self.port, ssl=self.context)

    def head(self, line: str, fields: str = "", *, token: str = "", host: str = "") -> bytes:
        """The head of a request."""
        host = host or f"127.0.0.1:{self.port}"
        bearer = f"Authorization: Bearer {token}\r\n" if token else ""
        return f"{line} HTTP/1.1\r\nHost: {host}\r\n{bearer}{fields}\r\n".encode()


def _frame(opcode: int, data: bytes = b"", *, is_last: bool = True) -> bytes:
    """A masked frame; the mask is zeros."""
    size = len(data)
    length = bytes([0x80 | size]) if size < 126 else b"\xfe" + size.to_bytes(2, "big")
    return bytes([0x80 * is_last | opcode]) + length + bytes(4) + data


_JSON = json.dumps({"op": "publish", "topic": "/rosout", "msg": [[0]] * 10_000})[:65_000]
_FRAMES = {
    "empty": (_frame(1, b"{", is_last=False), _frame(0, is_last=False) * 10_000),
    "one_byte": (_frame(1, b"{", is_last=False), _frame(0, b"x", is_last=False) * 10_000),
    "pings": (b"", _frame(9) * 10_000),
    "long_pings": (b"", _frame(9, bytes(125)) * 500),
    "json": (b"", _frame(1, _JSON.encode())),
    "small_json": (b"", _frame(1, b"{}") * 8_000),
    # A ping between two parts of a message, for ever; a budget's worth of parts in each.
    "between": (
        _frame(1, b"{", is_last=False),
        (_frame(0, b"x", is_last=False) + _frame(9)) * 5_000,
    ),
    "deflated": (b"", b"\xc1" + _frame(1, bytes(60_000))[1:]),  # it was not agreed on
}


async def _flood(target: Target, head: bytes, first: bytes, more: bytes, port: int = 0) -> None:
    reader, writer = await target.open(port)
    drained = asyncio.create_task(_drain(reader))
    try:
        writer.write(head)
        await asyncio.sleep(0.05)  # a WebSocket has to be open first
        writer.write(first)
        while not drained.done():
            writer.write(more)
            await writer.drain()
    finally:
        drained.cancel()
        writer.transport.abort()


async def _drain(reader: asyncio.StreamReader) -> None:
    with contextlib.suppress(OSError):
        while await reader.read(65536):
            pass


async def _chunks(target: Target, token: str) -> None:
    host = "" if token else "evil.example"
    head = target.head("POST /", "Transfer-Encoding: chunked\r\n", token=token, host=host)
    await _flood(target, head, b"", _CHUNKS)


async def _heads(target: Target, token: str) -> None:
    """A head that never ends."""
    await _flood(target, target.head("GET /", token=token)[:-2], b"", b"a: b\r\n" * 5_000)


async def _pages(target: Target, token: str) -> None:
    host = f"127.0.0.1:{target.console}"
    head = target.head("GET /", "Connection: close\r\n", token=token, host=host)
    await _flood(target, head, b"", b"", target.console)


async def _requests(target: Target, token: str) -> None:
    """Pipelined."""
    await _flood(target, b"", b"", target.head("GET /health", token=token) * 200)


async def _paths(target: Target, token: str, port: int, *paths: str, fields: str = "") -> None:
    """Pipelined, of a port that serves paths."""
    asked = b"".join(
        target.head(f"GET {path}", fields, token=token, host=f"127.0.0.1:{port}") for path in paths
    )
    await _flood(target, b"", b"", asked * 50, port)


async def _nowhere(target: Target, token: str) -> None:
    """Pages that the console does not have."""
    await _paths(target, token, target.console, "/nothing", "/console/nothing", "/_nicegui/x")


async def _files(target: Target, token: str) -> None:
    """The console's largest files, to be compressed."""
    at = f"/_nicegui/{version('nicegui')}/static"
    files = (f"{at}/quasar.umd.prod.js", f"{at}/sass.dart.js", "/console/console.css")
    await _paths(target, token, target.console, *files, fields="Accept-Encoding: gzip\r\n")


async def _polls(target: Target, token: str) -> None:
    """Long polls of a socket of the console."""
    path = "/_nicegui_ws/socket.io/?EIO=4&transport=polling"
    await _paths(target, token, target.console, path)


async def _metrics(target: Target, token: str) -> None:
    await _paths(target, token, target.metrics, "/metrics")


async def _viewers(target: Target, token: str) -> None:
    """64 kB of subscriptions at a time."""
    host = f"127.0.0.1:{target.foxglove}"
    fields = f"{_UPGRADE}Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n"
    asked = {"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 1}] * 1_800}
    more = _frame(1, json.dumps(asked).encode())
    await _flood(
        target, target.head("GET /", fields, token=token, host=host), b"", more, target.foxglove
    )


async def _bodies(target: Target, token: str) -> None:
    """Upgrades with bodies, and requests of HTTP/1.0."""
    body = target.head("GET /", f"{_UPGRADE}Content-Length: 65000\r\n", token=token)
    old = target.head("GET /health", token=token).replace(b"HTTP/1.1", b"HTTP/1.0")
    for one in (body + bytes(65_000), old * 200):
        await _flood(target, b"", one, b"")


async def _lines(target: Target, token: str) -> None:
    """The longest head there may be, by a byte at a time and then again and again."""
    more = target.head("GET /health", f"a: {'b' * 15_000}\r\n", token=token)
    await _flood(target, b"", b"", more * 4)


async def _drips(target: Target, token: str) -> None:
    """Sixty connections, each of which sends its head, or what may be a handshake, slowly."""
    head = target.head("GET /", token=token) if target.context is None else b"\x16\x03\x01\x20\x00"
    opened = await asyncio.gather(
        *(asyncio.open_connection("127.0.0.1", target.port) for _ in range(60)),
        return_exceptions=True,
    )
    writers = [one[1] for one in opened if not isinstance(one, BaseException)]
    try:
        for at in range(len(head)):
            for writer in writers:
                writer.write(head[at : at + 1])
            await asyncio.sleep(0.05)
    finally:
        for writer in writers:
            writer.transport.abort()


async def _connections(target: Target, token: str) -> None:
    """Handshakes, with TLS."""
    _, writer = await target.open()
    writer.write(target.head("GET /", _UPGRADE, token=token))
    writer.transport.abort()


def _frames(name: str) -> Callable[[Target, str], Awaitable[None]]:
    async def flood(target: Target, token: str) -> None:
        await _flood(target, target.head("GET /", _UPGRADE, token=token), *_FRAMES[name])

    return flood


STRANGERS = {
    "chunks": _chunks,
    "heads": _heads,
    "pages": _pages,
    "requests": _requests,
    "connections": _connections,
    "nowhere": _nowhere,
    "files": _files,
    "polls": _polls,
    "metrics": _metrics,
    "viewers": _viewers,
    "bodies": _bodies,
    "lines": _lines,
    "drips": _drips,
}
"""What can be done without a token."""

CLIENTS = STRANGERS | {name: _frames(name) for name in _FRAMES}
"""What can be done with it."""


async def attack(target: Target, seconds: float, seed: int, only: str = "") -> None:
    """Sixteen at once, for at most a minute."""

    async def one(number: int) -> None:
        drawn = random.Random(f"{seed} {number}")
        token = target.token if number >= EACH else ""
        kinds = CLIENTS if token else STRANGERS
        names = [name for name in kinds if not only or name == only] or list(kinds)
        while True:
            name = drawn.choice(names)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(0.5 + drawn.random()):
                    while True:
                        with contextlib.suppress(OSError):
                            await kinds[name](target, token)
                        await asyncio.sleep(0.001)

    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(min(seconds, 60.0)):
            await asyncio.gather(*(one(number) for number in range(2 * EACH)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("port", type=int)
    parser.add_argument("console", type=int)
    parser.add_argument("token")
    parser.add_argument("--metrics", type=int, default=0)
    parser.add_argument("--foxglove", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help=f"of {', '.join(CLIENTS)}")
    parser.add_argument("--tls", action="store_true")
    options = parser.parse_args()
    context = None
    if options.tls:
        context = ssl.create_default_context()
        context.check_hostname = False
        context.verify_mode = ssl.CERT_NONE  # an attacker does not mind
    target = Target(
        options.port, options.console, options.token, options.metrics, options.foxglove, context
    )
    asyncio.run(attack(target, options.seconds, options.seed, options.only))


if __name__ == "__main__":
    main()
