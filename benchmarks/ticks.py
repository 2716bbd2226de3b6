"""How late a control loop is at 50 and 100 Hz, while telemetry streams at 100 Hz over a pty.

    python -m benchmarks.ticks [ROW …] [--rounds 15] [--json] [--beside TREE]

The virtual aircraft flies in a process of its own. Beside ours in the same rounds and on the same
event loop: a chain of ``loop.call_at``; and in a process of its own a loop of timerfd and epoll in
C, where a compiler is. At 100 Hz it is the alarm below the ticker, whose own limit is 50 Hz. On a
busy machine all of them measure how long a thread waits for a processor, and the ratios go to 1:
``chrt -f 5 python -m benchmarks.ticks`` keeps that out where the user may.
"""

from __future__ import annotations

import asyncio
import json
import random
import subprocess
import sys
from collections.abc import Awaitable, Callable, Iterable
from contextlib import ExitStack

import m100link
from benchmarks.compiled import compiled
from benchmarks.program import SEED, main
from benchmarks.request import process, read_line
from benchmarks.rows import (
    Absent,
    NotMeasured,
    Program,
    Row,
    Setting,
    Side,
    at_most,
    percentile,
    ratio,
)
from m100link.flight.pacing import DeadlineTimer, Ticker

SECONDS = 2.0
RATES = (50, 100)
SOURCE = "timer.c"

Measure = Callable[[int], Awaitable[list[float]]]


def ticks(hz: int) -> str:
    """The name of our side."""
    return f"ticks at {hz} Hz"


def call_at(hz: int) -> str:
    """The name of the event loop's own timers."""
    return f"call_at at {hz} Hz"


def in_c(hz: int) -> str:
    """The name of the floor."""
    return f"a C timer loop at {hz} Hz"


def by_ticker(hz: int) -> Measure:
    """The ticker that control loops use."""
    ticker = Ticker(hz)  # lives as long as a control loop does

    async def measure(count: int) -> list[float]:
        return [(await anext(ticker)).lateness for _ in range(count)]

    return measure


def by_alarm(hz: int) -> Measure:
    """The alarm below it, which knows no limit."""
    alarm = DeadlineTimer()

    async def measure(count: int) -> list[float]:
        clock = asyncio.get_running_loop().time
        start, late = clock(), []
        for index in range(1, count + 1):
            await alarm.sleep_until(start + index / hz)
            late.append(clock() - (start + index / hz))
        return late

    return measure


def by_call_at(hz: int) -> Measure:
    """The event loop's own timers, each set by the one before."""

    async def measure(count: int) -> list[float]:
        loop = asyncio.get_running_loop()
        late: list[float] = []
        done: asyncio.Future[None] = loop.create_future()
        start = loop.time()

        def on_tick(index: int) -> None:
            late.append(loop.time() - (start + index / hz))
            if index == count:
                done.set_result(None)
            else:
                loop.call_at(start + (index + 1) / hz, on_tick, index + 1)

        loop.call_at(start + 1 / hz, on_tick, 1)
        await done
        return late

    return measure


async def made(make: Callable[[int], Measure], hz: int) -> Measure:
    """A way to measure, which may want a running loop."""
    return make(hz)


def ours(setting: Setting, stack: ExitStack) -> Iterable[Side]:
    """Ticks, and what the event loop alone can do, while telemetry comes in."""
    dice = random.Random(SEED)
    simulator = stack.enter_context(
        subprocess.Popen(
            [sys.executable, "-m", "m100link", "sim", "--seed", "1"],
            stdout=subprocess.PIPE,
            text=True,
        )
    )
    stack.callback(simulator.terminate)
    port = json.loads(read_line(simulator))["port"]
    runner = stack.enter_context(asyncio.Runner())
    connection = m100link.connect(port)
    runner.run(connection.__aenter__())
    stack.callback(lambda: runner.run(connection.__aexit__(None, None, None)))

    def side(name: str, make: Callable[[int], Measure], hz: int) -> Side:
        measure = runner.run(made(make, hz))
        count = max(4, int(setting.seconds(SECONDS) * hz))

        async def run() -> dict[str, float]:
            await asyncio.sleep(dice.random() * 0.01)  # a random phase against whole ms
            late = await measure(count)
            return {"p50": percentile(late, 0.5), "p99": percentile(late, 0.99)}

        return Side(name, lambda: runner.run(run()))

    for hz in RATES:
        yield side(ticks(hz), by_ticker if hz == RATES[0] else by_alarm, hz)
        yield side(call_at(hz), by_call_at, hz)


def others(setting: Setting, stack: ExitStack) -> Iterable[Side | Absent]:
    """The floor."""
    for hz in RATES:
        try:
            yield floor(hz, max(4, int(setting.seconds(SECONDS) * hz)), stack)
        except NotMeasured as reason:
            yield Absent(in_c(hz), str(reason))


def floor(hz: int, count: int, stack: ExitStack) -> Side:
    """The loop in C."""
    started = process([str(compiled(SOURCE, stack)), str(hz)], stack)

    def run() -> dict[str, float]:
        print(count, file=started.stdin, flush=True)
        middle, late = map(float, read_line(started).split())
        return {"p50": middle, "p99": late}

    return Side(in_c(hz), run)


def rows(hz: int) -> Iterable[Row]:
    """Medians and tails at one rate."""
    mine, theirs, least = ticks(hz), call_at(hz), in_c(hz)
    yield Row(
        f"{mine}, p50 ÷ loop.call_at", ratio(f"{mine}, p50", f"{theirs}, p50"), at_most(0.2, 0.15)
    )
    yield Row(
        f"{mine}, p50 ÷ a C timer loop", ratio(f"{mine}, p50", f"{least}, p50"), at_most(1.6, 1.3)
    )
    yield Row(f"{mine}, p99 ÷ loop.call_at", ratio(f"{mine}, p99", f"{theirs}, p99"))
    yield Row(f"{mine}, p99 ÷ a C timer loop", ratio(f"{mine}, p99", f"{least}, p99"))


PROGRAM = Program(
    name="ticks",
    rows=tuple(row for hz in RATES for row in rows(hz)),
    ours=ours,
    others=others,
    is_pinned=False,
)

if __name__ == "__main__":
    main(PROGRAM)
