"""Two sessions of zenoh that meet over loopback."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable
from contextlib import AsyncExitStack

import anyio

from m100link.apps.bus.session import LARGEST, Opening, ZenohBus, open_session
from tests.waiting import PATIENCE

__all__ = ["free_place", "opening", "two", "until"]


def free_place() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


async def until(predicate: Callable[[], object]) -> None:
    with anyio.fail_after(PATIENCE):
        while not predicate():  # noqa: ASYNC110 - other threads bring it
            await anyio.sleep(0.01)


def opening(mode: str, *, largest: int = LARGEST, **options: object) -> Opening:
    """A session that looks for nobody by itself; options by name, with _ for each /."""
    given = {"mode": json.dumps(mode), "scouting/multicast/enabled": "false"}
    given["timestamping/enabled"] = "true"
    given["transport/link/rx/max_message_size"] = str(LARGEST)
    given |= {name.replace("_", "/"): json.dumps(value) for name, value in options.items()}
    return Opening("a test", "fleet", given, largest=largest)


async def two(
    stack: AsyncExitStack, *, largest: int = LARGEST, **second: object
) -> tuple[ZenohBus, ZenohBus]:
    """Two peers, one of which listens where the other one connects."""
    place = [free_place()]
    first = opening("peer", largest=largest, listen_endpoints=place)
    other = opening("peer", largest=largest, connect_endpoints=place, **second)
    return (
        await stack.enter_async_context(open_session(first)),
        await stack.enter_async_context(open_session(other)),
    )
