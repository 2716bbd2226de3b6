"""How long STOP takes while a stranger floods an agent with long orders.

``python -m tests.attacks.fleet_flood``: a router, an agent with a virtual aircraft and the flooder
are processes of their own. The flooder asks as fast as the router takes it, with payloads that are
orders as far as they can be read, and waits for no answer. STOP is asked for by a pilot in this
process, again and again, and its answers are timed: beside the flood, and beside none.
"""

from __future__ import annotations

import argparse
import asyncio
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass

from m100link.apps.fleet.client import connect
from m100link.errors import M100Error
from tests.waiting import until

__all__ = ["Flood", "measure"]

_FLOODERS = 3

_FLOODER = """
import json, os, sys, zenoh

os.nice(10)  # strangers are on other machines: they take no time from the agent
place, size = sys.argv[1], int(sys.argv[2])
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([place]))
config.insert_json5("scouting/multicast/enabled", "false")
order = {"id": "ab" * 16, "aircraft": "a1", "by": "x" * size, "fence": 0, "at": 0.0,
         "message": "", "clock": 0.0, "proof": "", "signer": "", "signature": ""}
payload = b"\\x01" + json.dumps(order).encode()[:size]
with zenoh.open(config) as session:
    print("floods", flush=True)
    while True:
        session.get("m100/site/a1/cmd", handler=lambda reply: None, payload=payload, timeout=0.5)
"""


@dataclass(frozen=True)
class Flood:
    """What was seen.

    Attributes:
        size: Bytes of each order of the flood; 0: none.
        slowest_s: The longest that a STOP took.
        middle_s: Their median.
        failed: How many were not ``ok``.
    """

    size: int
    slowest_s: float
    middle_s: float
    failed: int


def _free_place() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@asynccontextmanager
async def _running(*command: str) -> AsyncIterator[None]:
    """A process that has said its first line."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, *command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    try:
        assert process.stdout is not None
        assert await process.stdout.readline()
        yield
    finally:
        process.kill()
        await process.wait()


async def measure(size: int, times: int = 20) -> Flood:
    """Time STOP while orders of that size come; 0 for none."""
    place = _free_place()
    fleet = ("-m", "m100link", "fleet")
    took: list[float] = []
    failed = 0
    async with (
        _running(*fleet, "router", "--listen", place, "--json"),
        _running(*fleet, "agent", "sim://", "--name", "a1", "--connect", place, "--json"),
        connect(place, name="anna") as pilot,
    ):
        await until(lambda: "a1" in pilot.present)
        aircraft = pilot["a1"]
        await aircraft.stop()
        async with AsyncExitStack() as flood:
            for _ in range(_FLOODERS if size else 0):
                await flood.enter_async_context(_running("-c", _FLOODER, place, str(size)))
            await asyncio.sleep(2.0)
            for _ in range(times):
                began = time.monotonic()
                try:
                    await aircraft.stop()
                except M100Error:
                    failed += 1
                took.append(time.monotonic() - began)
                await asyncio.sleep(0.2)
    return Flood(size, max(took), sorted(took)[len(took) // 2], failed)


async def _main(sizes: list[int]) -> bool:
    is_good = True
    for size in sizes:
        found = await measure(size)
        sys.stdout.write(f"{found}\n")
        is_good &= found.slowest_s < 1.0 and not found.failed
    return is_good


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="*", default=[0, 1_000, 60_000, 900_000])
    sys.exit(0 if asyncio.run(_main(parser.parse_args().sizes)) else "STOP took too long")
