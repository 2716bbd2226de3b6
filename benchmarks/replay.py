"""A flight log read and replayed: how many times as fast as it was flown.

    python -m benchmarks.replay [ROW …] [--rounds 15] [--json]

A virtual aircraft that sends 100 packages a second is recorded on virtual time. What is timed is
CPU of one thread: from the file to samples in a loop, and from the file through the link, the
merged state and a subscription to ``async for``, as ``connect("replay://…?speed=max")`` gives them.
"""

from __future__ import annotations

import asyncio
import tempfile
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path

import m100link
from benchmarks.program import main
from benchmarks.rows import Absent, Costs, Program, Row, Setting, Side, at_least, timed
from m100link.sim import VirtualClockEventLoop

FLOWN_S = 300
RATE_HZ = 100
READ, REPLAYED = "a package read from a log", "a package replayed to async for"


async def _fly(path: Path, seconds: float) -> None:
    async with m100link.connect("sim://?seed=15", record=path):
        await asyncio.sleep(seconds)


async def _replay(url: str) -> int:
    count = 0
    async with m100link.connect(url) as aircraft:
        try:
            async for _ in aircraft.telemetry(policy=m100link.Lossless(1000)):
                count += 1
        except m100link.ReplayEnded:
            return count
    raise RuntimeError("a recording without an end")


def ours(setting: Setting, stack: ExitStack) -> Iterable[Side | Absent]:
    """Both ways out of one file."""
    if find_spec("mcap") is None:
        yield Absent(READ, "needs the extra log")
        yield Absent(REPLAYED, "needs the extra log")
        return
    from m100link.log import read

    path = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "flight.mcap"
    with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
        runner.run(_fly(path, max(2.0, setting.seconds(FLOWN_S))))
    count = sum(1 for _ in read(path).samples())
    yield timed(READ, count, lambda: sum(1 for _ in read(path).samples()))
    yield timed(REPLAYED, count, lambda: asyncio.run(_replay(f"replay://{path}?speed=max")))


def as_flown(name: str) -> Callable[[Costs], float]:
    """How many seconds of flight a second of CPU is."""
    return lambda costs: 1 / RATE_HZ / costs[name]


PROGRAM = Program(
    name="replay",
    rows=(
        Row("a flight log read, times as fast as flown", as_flown(READ), at_least(1000)),
        Row("the same replayed to async for", as_flown(REPLAYED), at_least(1000)),
    ),
    ours=ours,
)

if __name__ == "__main__":
    main(PROGRAM)
