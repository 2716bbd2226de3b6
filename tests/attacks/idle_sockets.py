"""WebSockets that say nothing, to take every place."""

from __future__ import annotations

import asyncio
import contextlib

from websockets.exceptions import WebSocketException

from tests.attacks.common import main
from tests.sockets import connect


async def attack(host: str, port: int) -> None:
    """64, and each again when it is closed."""

    async def one() -> None:
        while True:
            with contextlib.suppress(OSError, WebSocketException, TimeoutError):
                async with connect(f"ws://{host}:{port}") as client:
                    await client.recv()
            await asyncio.sleep(0.2)

    await asyncio.gather(*(one() for _ in range(64)))


if __name__ == "__main__":
    main(attack)
