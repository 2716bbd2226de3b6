"""Clients that subscribe to everything in the dearest form, some of which do not read."""

from __future__ import annotations

import asyncio
import json

from tests.attacks.common import again_and_again, main

TOPICS = ("attitude", "imu", "gps_position", "velocity", "acceleration_ground_fused", "rc")


async def attack(host: str, port: int) -> None:
    """Ten clients with pictures in small pieces, five of which never read."""
    frames = [
        json.dumps(
            {
                "op": "subscribe",
                "topic": f"/dji_sdk/{name}",
                "compression": "png",
                "fragment_size": 100,
            }
        )
        for name in TOPICS
    ]
    await asyncio.gather(
        *(
            again_and_again(host, port, *frames, rate=20.0, reads=bool(number % 2))
            for number in range(10)
        )
    )


if __name__ == "__main__":
    main(attack)
