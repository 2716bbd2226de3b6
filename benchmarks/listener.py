"""Clients of the ground station that take everything; started by :mod:`benchmarks.station`.

    python benchmarks/listener.py URL CLIENTS

Each subscribes to every topic at full rate. Once a second a line says how many messages came since
the last one and how many clients are connected.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys

from websockets.asyncio.client import connect
from websockets.exceptions import WebSocketException


async def listen(url: str, count: int) -> None:
    """Until it is killed."""
    received = connected = 0

    async def one() -> None:
        nonlocal received, connected
        # A busy machine answers late, and a connection that is cut off is to be seen.
        async with connect(url, compression=None, open_timeout=60, ping_interval=None) as client:
            await client.send('{"op":"call_service","service":"/rosapi/topics"}')
            topics = json.loads(await client.recv())["values"]["topics"]
            for topic in topics:
                await client.send(json.dumps({"op": "subscribe", "topic": topic}))
            connected += 1
            with contextlib.suppress(WebSocketException):
                async for _ in client:
                    received += 1
            connected -= 1

    async def report() -> None:
        while True:
            before = received
            await asyncio.sleep(1.0)
            print(received - before, connected, flush=True)

    await asyncio.gather(report(), *(one() for _ in range(count)), return_exceptions=True)


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(listen(sys.argv[1], int(sys.argv[2])))
