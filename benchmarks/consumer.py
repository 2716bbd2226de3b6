"""From bytes on the line to a consumer's hand: the whole road of a telemetry package.

    python -m benchmarks.consumer [ROW …] [--rounds 15] [--json] [--beside TREE]

Timed without the system calls: ``data_received`` of the link, sessions, typed sample, merged state,
clock model, authority, subscription, and the consumer taking it. Beside it in the same rounds:
pymavlink parsing messages of like size, which a program on it does before it does anything. With
``async for`` a task takes the packages, and a pass of the event loop per package is part of it.
The aircraft has been at rest for its first second, by which it is known how its acceleration comes.
Until then, and where it comes raw, a package costs what another row has.
Memory is what a thousand kept values add, by tracemalloc.
"""

from __future__ import annotations

import asyncio
import gc
import time
import tracemalloc
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from typing import Any

import m100link
from benchmarks import peers
from benchmarks.frames import FIRMWARE, telemetry_frame, telemetry_frames, telemetry_value
from benchmarks.program import main
from benchmarks.rows import (
    Absent,
    Costs,
    Program,
    Row,
    Setting,
    Side,
    at_least,
    at_most,
    ratio,
    timed,
)
from m100link.link import Link

COUNT = 3000
KEPT = 1000
REST_S = 0.6  # twice: a second is judged
MANY = 100
HAND, LOOP = "bytes to the consumer's hand", "the same through async for"
UNKNOWN = "the same before it was at rest"
HAND_OF_MANY = f"the same for {MANY} consumers"
SAMPLE, MESSAGE = "a kept sample, bytes", "a kept pymavlink message, bytes"


async def make_aircraft(has_rested: bool = True) -> tuple[m100link.Aircraft, Link]:
    """An aircraft on a link without a line."""
    link = Link()
    aircraft = m100link.Aircraft(link, firmware=FIRMWARE)
    if has_rested:
        for tick in range(3):
            link.data_received(telemetry_frame(tick, up=0.0))
            await asyncio.sleep(REST_S)
    return aircraft, link


def taking(name: str, count: int, consumers: int, has_rested: bool = True) -> Side:
    """Packages that consumers take as soon as they are there."""
    aircraft, link = asyncio.run(make_aircraft(has_rested))
    frames = telemetry_frames(count)
    takers = [aircraft.telemetry() for _ in range(consumers)]

    def deliver() -> int:
        taken = 0
        receive = link.data_received
        for frame in frames:
            receive(frame)
            for taker in takers:
                taken += taker.get_nowait() is not None
        return taken // consumers

    return timed(name, count, deliver)


def iterating(name: str, count: int) -> Side:
    """Packages that a task takes by ``async for``, one for each pass of the event loop."""
    frames = telemetry_frames(count)

    async def deliver() -> float:
        loop = asyncio.get_running_loop()
        aircraft, link = await make_aircraft()
        waiting = iter(frames)

        def receive() -> None:
            frame = next(waiting, None)
            if frame is not None:
                link.data_received(frame)
                loop.call_soon(receive)

        left = count
        async with aircraft.telemetry() as samples:
            began = time.thread_time()
            loop.call_soon(receive)
            async for _ in samples:
                left -= 1
                if not left:
                    break
            return (time.thread_time() - began) / count

    return Side(name, lambda: asyncio.run(deliver()))


def memory(name: str, make: Callable[[int], Any], more: int = 0) -> Side:
    """Bytes per kept value."""

    def run() -> float:
        tracemalloc.start()
        kept = [make(index) for index in range(KEPT)]
        size, _ = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        gc.collect()
        return size / len(kept) + more

    return Side(name, run, is_time=False)


def ours(setting: Setting, stack: ExitStack) -> Iterable[Side]:
    """The whole road, and what is kept of it."""
    count = setting.count(COUNT)
    yield taking(HAND, count, 1)
    yield taking(UNKNOWN, count, 1, has_rested=False)
    yield taking(HAND_OF_MANY, setting.count(COUNT // 10), MANY)
    yield iterating(LOOP, count)
    value = telemetry_value(1)
    yield memory(SAMPLE, lambda _: m100link.Sample(bytes(value), FIRMWARE, 0.0), len(value))


def others(setting: Setting, stack: ExitStack) -> Iterable[Side | Absent]:
    """pymavlink's bare parsing, and what it keeps."""
    yield peers.parsing(peers.MIX, peers.mix, setting.count(COUNT))
    mavlink = peers.dialect()
    if mavlink is None:
        yield Absent(MESSAGE, peers.MISSING)
    else:
        wire = peers.imu(mavlink, 1)[0]
        yield memory(MESSAGE, lambda _: mavlink.MAVLink(None).parse_buffer(bytes(wire)))


def per_consumer(costs: Costs) -> float:
    """What one consumer more adds to a package, µs."""
    return (costs[HAND_OF_MANY] - costs[HAND]) / (MANY - 1) * 1e6


PROGRAM = Program(
    name="consumer",
    rows=(
        Row(
            "bytes → consumer, pymavlink's parsing ÷ ours", ratio(peers.MIX, HAND), at_least(3, 3.5)
        ),
        Row("the same through async for ÷ the row above", ratio(LOOP, HAND), at_most(2.7, 2.2)),
        Row("the same before it was at rest ÷ the first row", ratio(UNKNOWN, HAND)),
        Row("consumers 1 → 100, per package and consumer", per_consumer, at_most(0.35), "µs"),
        Row("a kept pymavlink message ÷ a kept sample, memory", ratio(MESSAGE, SAMPLE)),
    ),
    ours=ours,
    others=others,
)

if __name__ == "__main__":
    main(PROGRAM)
