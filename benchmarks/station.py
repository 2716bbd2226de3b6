"""From a key press to the movement frame on the line, through the station; alone and under load.

    python benchmarks/station.py [--presses 300] [--clients 10] [--json]

Three processes, as in use: the station (``m100link serve``), this one with the virtual aircraft
behind TCP and the client that presses keys, and one with the clients that only listen. A press is
timed from just before the WebSocket message is sent until the frame's bytes arrive at the aircraft,
by one clock: from rest, when the frame leaves at once, and 0.1 s after a release, when frames of
zeros still leave at 50 Hz and the press takes the next one. Then the lateness of 50 Hz ticks inside
the process that serves. All first with no other client, then with ten that subscribe to every topic
at full rate. Nothing here passes or fails.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import math
import os
import random
import statistics
import subprocess
import sys
import time
from collections.abc import AsyncIterator
from typing import Any

from websockets.asyncio.client import ClientConnection, connect

from m100link.flight.pacing import Ticker
from m100link.sim.ports.driver import Driver
from m100link.sim.ports.tcp import serve_tcp
from m100link.sim.vehicle.mobile import DEMO_APP_ID, DEMO_KEY
from m100link.sim.virtual import VirtualAircraft
from m100link.station.config import Settings
from m100link.station.run import running

MAIN = "from m100link.cli import main; main()"


class Line(Driver):
    """The aircraft's end of the line; notes when each movement frame came."""

    def __init__(self, aircraft: VirtualAircraft) -> None:
        super().__init__(aircraft)
        self.arrivals: list[float] = []
        self.news = asyncio.Event()

    def receive(self, data: bytes) -> None:
        before = self.aircraft.autopilot.counters.movements
        now = self.loop.time()
        super().receive(data)
        self.arrivals += [now] * (self.aircraft.autopilot.counters.movements - before)
        if self.aircraft.autopilot.counters.movements != before:
            self.news.set()


async def publish(client: ClientConnection, topic: str, kind: str, **message: float) -> None:
    await client.send(json.dumps({"op": "advertise", "topic": topic, "type": kind}))
    await client.send(json.dumps({"op": "publish", "topic": topic, "msg": message}))


async def steer(client: ClientConnection, **message: float) -> None:
    body = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.0} | message
    await client.send(json.dumps({"op": "publish", "topic": "/sdk_request_ctrl", "msg": body}))


async def presses(
    client: ClientConnection, line: Line, count: int, chance: random.Random, rest: float
) -> list[float]:
    """Seconds from press to frame, that long after the key before was released; inf if none."""
    times = []
    for _ in range(count):
        await steer(client)
        await asyncio.sleep(rest + chance.random() * 0.04)
        line.news.clear()
        pressed_at = line.loop.time()
        await steer(client, x=-2.0)
        try:
            async with asyncio.timeout(2):
                await line.news.wait()
        except TimeoutError:
            times.append(math.inf)  # on a machine that is busy enough a press may come to nothing
        else:
            times.append(line.arrivals[-1] - pressed_at)
    return times


async def lateness(clients: int, seconds: float = 8.0) -> dict[str, Any]:
    """How late 50 Hz ticks are in the process that serves, and what clients cost it."""
    result: dict[str, Any] = {}
    async with running(Settings(sim=True, port=0)) as station:
        command = (__file__, "--listen", f"ws://127.0.0.1:{station.ports[0]}")
        for case, count in (("alone", 0), ("loaded", clients)):
            async with process(*command, "--clients", str(count)):
                await asyncio.sleep(3.0)
                began, late = time.process_time(), []
                async for tick in Ticker(50):
                    late.append(tick.lateness)
                    if tick.elapsed >= seconds:
                        break
                busy = (time.process_time() - began) / seconds
                result[case] = summary(late) | {"busy": busy}
    return result


def percentile(values: list[float], part: float) -> float:
    return sorted(values)[min(len(values) - 1, int(len(values) * part))]


def summary(values: list[float]) -> dict[str, float]:
    return {
        "count": len(values),
        "p50_ms": 1e3 * percentile(values, 0.50),
        "p99_ms": 1e3 * percentile(values, 0.99),
        "worst_ms": 1e3 * max(values),
    }


async def listen(url: str, count: int) -> None:
    """Clients that take everything and say once a second how much it was."""
    received = 0

    async def one() -> None:
        nonlocal received
        async with connect(url, compression=None) as client:
            await client.send('{"op":"call_service","service":"/rosapi/topics"}')
            topics = json.loads(await client.recv())["values"]["topics"]
            for topic in topics:
                await client.send(json.dumps({"op": "subscribe", "topic": topic}))
            async for _ in client:
                received += 1

    async def report() -> None:
        while True:
            before = received
            await asyncio.sleep(1.0)
            print(received - before, flush=True)

    await asyncio.gather(report(), *(one() for _ in range(count)))


@contextlib.asynccontextmanager
async def process(*command: str, **more: Any) -> AsyncIterator[asyncio.subprocess.Process]:
    running = await asyncio.create_subprocess_exec(
        sys.executable, *command, stdout=subprocess.PIPE, **more
    )
    try:
        yield running
    finally:
        with contextlib.suppress(ProcessLookupError):
            running.terminate()
        await running.wait()


async def measure(options: argparse.Namespace) -> dict[str, Any]:
    chance = random.Random(options.seed)
    line = Line(VirtualAircraft(seed=options.seed))
    server = await serve_tcp(line)
    environment = os.environ | {
        "M100LINK_APP_ID": str(DEMO_APP_ID),
        "M100LINK_KEY": DEMO_KEY.reveal().hex(),
    }
    serve = ("serve", f"tcp://127.0.0.1:{server.port}", "--port", "0", "--json")
    result: dict[str, Any] = {"seed": options.seed, "clients": options.clients}
    quiet = {"stderr": subprocess.DEVNULL, "env": environment}
    async with process("-c", MAIN, *serve, **quiet) as station:
        assert station.stdout is not None
        url = json.loads(await station.stdout.readline())["rosbridge"][0]
        async with connect(url, compression=None) as client:
            await take_off(client, line)
            result["alone"] = await both(client, line, options, chance)
            command = (__file__, "--listen", url, "--clients", str(options.clients))
            async with process(*command) as listeners:
                assert listeners.stdout is not None
                rates = asyncio.create_task(read_rates(listeners.stdout))
                await asyncio.sleep(3.0)
                result["loaded"] = await both(client, line, options, chance)
            # The listeners have ended: the first and the last second were not whole ones.
            result["messages_per_s"] = statistics.median((await rates)[1:-1] or [0])
    await server.stop()
    ticks = await lateness(options.clients)
    for case in ("alone", "loaded"):
        result[case]["ticks"] = ticks[case]
    return result


async def read_rates(stream: asyncio.StreamReader) -> list[int]:
    """Messages of each second, until the listeners end."""
    return [int(text) async for text in stream if text.strip().isdigit()]


async def both(
    client: ClientConnection, line: Line, options: argparse.Namespace, chance: random.Random
) -> dict[str, Any]:
    return {
        "press": summary(await presses(client, line, options.presses, chance, 0.6)),
        "change": summary(await presses(client, line, options.presses, chance, 0.1)),
    }


async def take_off(client: ClientConnection, line: Line) -> None:
    vehicle = line.aircraft.vehicle
    await publish(client, "/sdk_request_activation", "std_msgs/Float32", data=1)
    while vehicle.activation.active is None:  # noqa: ASYNC110 - the virtual aircraft has no events
        await asyncio.sleep(0.05)
    await asyncio.sleep(0.5)
    await publish(client, "/nav_open_close_request", "std_msgs/Float32", data=1)
    await asyncio.sleep(1.0)
    await publish(client, "/sdk_request_cmd", "std_msgs/Float32", data=4)
    while line.aircraft.height < 1.0:  # noqa: ASYNC110 - nor here
        await asyncio.sleep(0.05)
    await asyncio.sleep(3.0)
    await publish(client, "/sdk_request_ctrl", "geometry_msgs/Quaternion", x=0.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--presses", type=int, default=100)
    parser.add_argument("--clients", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--listen", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.listen:
        with contextlib.suppress(KeyboardInterrupt):
            asyncio.run(listen(options.listen, options.clients))
        return
    result = asyncio.run(measure(options))
    if options.json:
        print(json.dumps(result))
        return
    print(f"seed {result['seed']}; load: {result['clients']} clients with every topic, ", end="")
    print(f"{result['messages_per_s']} messages/s")
    for what, text in (
        ("press", "key press to frame"),
        ("change", "the same between frames"),
        ("ticks", "50 Hz tick late"),
    ):
        for case in ("alone", "loaded"):
            one = result[case][what]
            numbers = "  ".join(
                f"{name} {one[f'{name}_ms']:6.2f}" for name in ("p50", "p99", "worst")
            )
            busy = f", CPU {one['busy']:.0%}" if "busy" in one else ""
            print(f"{text:25} {case:7} {numbers}  ms  (n = {one['count']}{busy})")


if __name__ == "__main__":
    main()
