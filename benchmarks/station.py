"""The ground station on a busy machine, and from a key press to the movement frame on the line.

    python -m benchmarks.station [ROW …] [--rounds 3] [--json] [--beside TREE]

**Busy**: the station runs in this process, ten clients in another subscribe to every topic at full
rate, and beside them as many processes as there are CPUs compute without end. Told are the messages
that the station dropped because a client was slow, the lateness of 50 Hz ticks in its loop, and
what the clients got.

**Drop and delivery**: CPU time for a message to one client, by the station's own parts without a
socket; one client takes its messages, the other never does.

**Key to frame**: ``m100link serve`` in its processes, this one with the virtual aircraft behind TCP
and the client that presses keys. A press is timed from just before the WebSocket message is sent
until the frame's bytes arrive at the aircraft, by one clock: from rest, when the frame leaves at
once, and 0.1 s after a release, when frames of zeros still leave at 50 Hz and the press takes the
next one. First with no other client, then with ten.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import random
import subprocess
import sys
from collections.abc import AsyncIterator, Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import WebSocketException

from benchmarks.program import main
from benchmarks.rows import (
    NotMeasured,
    Program,
    Row,
    Setting,
    Side,
    at_most,
    percentile,
    ratio,
    timed,
    times,
)
from m100link.apps.station.config import Settings
from m100link.apps.station.ros.client import Client
from m100link.apps.station.ros.graph import Graph, Publication
from m100link.apps.station.run import running
from m100link.flight.pacing import Ticker
from m100link.sim.ports.driver import Driver, serve_tcp
from m100link.sim.vehicle.activation import DEMO_APP_ID, DEMO_KEY
from m100link.sim.virtual import VirtualAircraft

CLIENTS = 10
COUNT = 3000  # messages per timing
TOPICS = 30
PRESSES = 12
SEED = 1
PATIENCE_S = 60.0  # for anything that a busy machine may delay
BUSY = f"{CLIENTS} clients, every topic, both cores busy"
DROP, DELIVERY = "a message dropped", "a message delivered"
KEYS, KEYS_LOADED = "key to frame, alone", f"key to frame, with {CLIENTS} clients"
LISTENER = str(Path(__file__).with_name("listener.py"))
MAIN = "from m100link.apps.cli import main; main()"


@contextlib.asynccontextmanager
async def process(*command: str, **more: Any) -> AsyncIterator[asyncio.subprocess.Process]:
    """A Python program while the block runs."""
    started = await asyncio.create_subprocess_exec(
        sys.executable, *command, stdout=subprocess.PIPE, **more
    )
    try:
        yield started
    finally:
        with contextlib.suppress(ProcessLookupError):
            started.terminate()
        try:
            async with asyncio.timeout(5):
                await started.wait()
        except TimeoutError:
            started.kill()
            await started.wait()


# -- busy ------------------------------------------------------------------------------------------


async def busy(clients: int, burners: int, seconds: float) -> dict[str, float]:
    """What ten clients and busy cores do to the station."""
    async with contextlib.AsyncExitStack() as stack:
        station = await stack.enter_async_context(running(Settings(sim=True, port=0)))
        url = f"ws://127.0.0.1:{station.sockets.port('rosbridge')}"
        listeners = await stack.enter_async_context(process(LISTENER, url, str(clients)))
        assert listeners.stdout is not None
        await until_connected(listeners.stdout, clients)
        for _ in range(burners):
            await stack.enter_async_context(process("-c", "while True: pass"))
        await asyncio.sleep(min(1.0, seconds))
        before = dropped(station.bridge.graph)
        counting = asyncio.create_task(count(listeners.stdout, clients))
        late = []
        async for tick in Ticker(50):
            late.append(tick.lateness)
            if tick.elapsed >= seconds:
                break
        counting.cancel()
        rates, connected = await counting
        return {
            "dropped": dropped(station.bridge.graph) - before,
            "cut off": clients - connected,
            "messages/s": percentile(rates, 0.5) if rates else 0.0,
            "loop late p50, ms": percentile(late, 0.5) * 1e3,
            "loop late p99, ms": percentile(late, 0.99) * 1e3,
        }


def dropped(graph: Graph) -> int:
    """Messages that clients lost because they were slow."""
    return sum(one.outbox.dropped for one in graph.sessions if isinstance(one, Client))


async def until_connected(lines: asyncio.StreamReader, clients: int) -> None:
    """Wait for the clients."""
    try:
        async with asyncio.timeout(PATIENCE_S):
            async for line in lines:
                if line.split()[1:] == [str(clients).encode()]:
                    return
        raise NotMeasured("the clients ended before they were connected")
    except TimeoutError:
        raise NotMeasured(f"the clients were not connected after {PATIENCE_S:g} s") from None


async def count(lines: asyncio.StreamReader, connected: int) -> tuple[list[int], int]:
    """Messages of each second, and how many clients there were in the last; until cancelled."""
    rates = []
    with contextlib.suppress(asyncio.CancelledError):
        async for line in lines:
            rate, connected = map(int, line.split())
            rates.append(rate)
    return rates, connected


# -- drop and delivery -----------------------------------------------------------------------------


def messages(name: str, number: int, *, takes: bool) -> Side:
    """Messages of many topics to one client that takes them, or never does."""
    graph = Graph()
    topics = [graph.add_topic(f"/topic{n}", "std_msgs/Float32") for n in range(TOPICS)]
    client = Client(graph)
    for topic in topics:
        client.receive(json.dumps({"op": "subscribe", "topic": topic.name}), 0.0)
    publications = [Publication(topic, {"data": 1.0}) for topic in topics]
    for one in publications:
        one.pack(one.topic.name, "none")  # packed once for all clients, so it is nobody's cost
    for _ in range(client.limits.waiting if not takes else 0):
        client.deliver(publications[0], 0.0)

    def run() -> int:
        before, taken = client.outbox.dropped, 0
        for index in range(number):
            client.deliver(publications[index % TOPICS], 0.0)
            if takes:
                taken += client.outbox.next_frame() is not None
        return taken if takes else client.outbox.dropped - before

    return timed(name, number, run)


# -- key to frame ----------------------------------------------------------------------------------


class Line(Driver):
    """The aircraft's end of the line; notes when each movement frame came."""

    def __init__(self, aircraft: VirtualAircraft) -> None:
        super().__init__(aircraft)
        self.arrivals: list[float] = []
        self.news = asyncio.Event()

    def receive(self, data: bytes) -> None:
        """Bytes from the station."""
        before = self.aircraft.autopilot.counters.movements
        now = self.loop.time()
        super().receive(data)
        self.arrivals += [now] * (self.aircraft.autopilot.counters.movements - before)
        if self.aircraft.autopilot.counters.movements != before:
            self.news.set()


async def publish(client: ClientConnection, topic: str, kind: str, **message: float) -> None:
    """One message on a topic of its own."""
    await client.send(json.dumps({"op": "advertise", "topic": topic, "type": kind}))
    await client.send(json.dumps({"op": "publish", "topic": topic, "msg": message}))


async def steer(client: ClientConnection, **message: float) -> None:
    """What a key of DJI's web page sends."""
    body = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.0} | message
    await client.send(json.dumps({"op": "publish", "topic": "/sdk_request_ctrl", "msg": body}))


async def press(client: ClientConnection, line: Line, rest: float) -> float | None:
    """Seconds from press to frame, so long after the key before was released; None: no frame."""
    await steer(client)
    await asyncio.sleep(rest)
    line.news.clear()
    pressed_at = line.loop.time()
    await steer(client, x=-2.0)
    try:
        async with asyncio.timeout(2):
            await line.news.wait()
    except TimeoutError:
        return None  # on a machine that is busy enough a press may come to nothing
    return line.arrivals[-1] - pressed_at


async def key_to_frame(clients: int, presses: int) -> dict[str, float]:
    """Presses from rest and between frames, with so many other clients."""
    chance = random.Random(SEED)
    line = Line(VirtualAircraft(seed=SEED))
    environment = os.environ | {
        "M100LINK_APP_ID": str(DEMO_APP_ID),
        "M100LINK_KEY": DEMO_KEY.reveal().hex(),
    }
    async with contextlib.AsyncExitStack() as stack:
        server = await serve_tcp(line)
        stack.push_async_callback(server.stop)
        command = ("serve", f"tcp://127.0.0.1:{server.port}", "--port", "0", "--json")
        station = await stack.enter_async_context(
            process("-c", MAIN, *command, stderr=subprocess.DEVNULL, env=environment)
        )
        assert station.stdout is not None
        url = json.loads(await station.stdout.readline())["rosbridge"][0]
        client = await stack.enter_async_context(
            connect(url, compression=None, open_timeout=PATIENCE_S, ping_interval=None)
        )
        async with asyncio.timeout(PATIENCE_S):
            await take_off(client, line)
        if clients:
            listeners = await stack.enter_async_context(process(LISTENER, url, str(clients)))
            assert listeners.stdout is not None
            await until_connected(listeners.stdout, clients)
        found: dict[str, float] = {}
        for what, rest in (("from rest", 0.6), ("between frames", 0.1)):
            answers = [
                await press(client, line, rest + chance.random() * 0.04) for _ in range(presses)
            ]
            seen = [seconds for seconds in answers if seconds is not None]
            if len(seen) * 2 < presses:
                raise NotMeasured(f"{presses - len(seen)} of {presses} presses moved nothing")
            found[f"{what}, p50"] = percentile(seen, 0.5)
            found[f"{what}, worst"] = max(seen)
        return found


async def take_off(client: ClientConnection, line: Line) -> None:
    """Activated, authority held, in the air."""
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


def keys(name: str, clients: int, presses: int) -> Side:
    """Presses; what a busy machine spoils is told and not raised."""

    def run() -> dict[str, float]:
        try:
            return asyncio.run(key_to_frame(clients, presses))
        except (TimeoutError, OSError, WebSocketException) as error:
            raise NotMeasured(f"the station did not keep up: {error!r}") from error

    return Side(name, run)


# -- sides and rows --------------------------------------------------------------------------------


def ours(setting: Setting, stack: ExitStack) -> Iterable[Side]:
    """The station."""
    clients = setting.count(CLIENTS)
    burners = 1 if setting.is_quick else os.cpu_count() or 1
    seconds, number = setting.seconds(6.0), setting.count(COUNT)
    yield Side(BUSY, lambda: asyncio.run(busy(clients, burners, seconds)), is_time=False)
    yield messages(DROP, number, takes=False)
    yield messages(DELIVERY, number, takes=True)
    if not setting.is_quick:  # a flight takes its time
        yield keys(KEYS, 0, PRESSES)
        yield keys(KEYS_LOADED, clients, PRESSES)


PROGRAM = Program(
    name="station",
    rows=(
        Row(
            "station, both cores busy: dropped for readers",
            times(f"{BUSY}, dropped", 1),
            at_most(0),
        ),
        Row(
            "the same: lateness of its loop, p99",
            times(f"{BUSY}, loop late p99, ms", 1),
            at_most(20),
            "ms",
        ),
        Row("a message dropped ÷ a message delivered", ratio(DROP, DELIVERY), at_most(1)),
        Row("key to frame from rest, alone, p50", times(f"{KEYS}, from rest, p50", 1e3), unit="ms"),
        Row(
            f"key to frame from rest, {CLIENTS} clients, p50",
            times(f"{KEYS_LOADED}, from rest, p50", 1e3),
            unit="ms",
        ),
    ),
    ours=ours,
    rounds=3,
    is_pinned=False,
)

if __name__ == "__main__":
    main(PROGRAM)
