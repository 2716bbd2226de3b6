"""What the attacks share: they are programs of their own, bounded in time, loopback only."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
from collections.abc import Awaitable, Callable
from typing import Any

from websockets.exceptions import WebSocketException

from tests.sockets import connect

__all__ = ["again_and_again", "main", "publish"]


def main(attack: Callable[[str, int], Awaitable[None]]) -> None:
    """Run an attack for some seconds: ``python -m tests.attacks.NAME PORT [--seconds 3]``."""
    parser = argparse.ArgumentParser()
    parser.add_argument("port", type=int)
    parser.add_argument("--seconds", type=float, default=3.0)
    options = parser.parse_args()

    async def bounded() -> None:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(min(options.seconds, 60.0)):
                await attack("127.0.0.1", options.port)

    asyncio.run(bounded())


def publish(topic: str, **message: Any) -> str:
    """A ``publish`` frame."""
    return json.dumps({"op": "publish", "topic": topic, "msg": message})


async def again_and_again(
    host: str, port: int, *frames: str, rate: float, reads: bool = True
) -> None:
    """Send frames at a rate, in their order, and connect again when cut off."""
    while True:
        with contextlib.suppress(OSError, WebSocketException):
            async with connect(f"ws://{host}:{port}", max_size=None, compression=None) as client:
                reading = asyncio.create_task(_drain(client) if reads else asyncio.sleep(3600))
                try:
                    while True:
                        for frame in frames:
                            await client.send(frame)
                            await asyncio.sleep(1.0 / rate)
                finally:
                    reading.cancel()
        await asyncio.sleep(0.05)


async def _drain(client: Any) -> None:
    with contextlib.suppress(WebSocketException):
        async for _ in client:
            pass
