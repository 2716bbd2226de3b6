"""The console's page, asked for again and again: the dearest thing a stranger can ask for."""

from __future__ import annotations

import asyncio
import contextlib

from tests.attacks.common import main


async def attack(host: str, port: int) -> None:
    """Four connections that ask without a pause."""
    request = f"GET / HTTP/1.1\r\nHost: {host}:{port}\r\nConnection: close\r\n\r\n".encode()

    async def one() -> None:
        while True:
            with contextlib.suppress(OSError):
                reader, writer = await asyncio.open_connection(host, port)
                try:
                    writer.write(request)
                    await reader.read()
                finally:
                    writer.close()

    await asyncio.gather(*(one() for _ in range(4)))


if __name__ == "__main__":
    main(attack)
