"""Hours in the air and a thousand connections: does anything grow? `nox -s soak`.

The simulated day has a host that reads every package and flies for a while in each hour, on a
virtual clock. The real hour is the same over a pseudo-terminal, with the virtual aircraft in
another process. Looked at are memory, blocks of the allocator, tasks and file descriptors.
"""

from __future__ import annotations

import argparse
import asyncio
import gc
import json
import os
import sys
import time
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import m100link
from m100link import Setpoint
from m100link.sim import DEMO_APP_ID, DEMO_KEY, VirtualClockEventLoop
from m100link.testing import ConnectableAircraft

__all__ = ["Grown", "Level", "connects", "day", "hour", "require_flat"]

_BLOCKS_MAY_VARY = 4000  # caches that fill, histories of a fixed length
_MEMORY_MAY_VARY_KB = 4096
_STEP_S = 0.1
_CREDENTIALS = m100link.Credentials(app_id=DEMO_APP_ID, key=DEMO_KEY)
_NORTH = Setpoint.velocity(north=1.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)
_SOUTH = Setpoint.velocity(north=-1.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


class Grown(Exception):
    """Something is more than it was, and goes on growing."""


@dataclass(frozen=True, slots=True)
class Level:
    """What a process holds.

    Attributes:
        blocks: Of the allocator, after a collection of garbage.
        memory_kb: Resident, 0 where the system does not tell.
        tasks: Of the running loop.
        descriptors: Open ones, 0 where the system does not tell.
    """

    blocks: int
    memory_kb: int
    tasks: int
    descriptors: int

    @classmethod
    def now(cls) -> Level:
        """Look."""
        gc.collect()
        memory, files = Path("/proc/self/statm"), Path("/proc/self/fd")
        pages = int(memory.read_text("ascii").split()[1]) if memory.exists() else 0
        return cls(
            blocks=sys.getallocatedblocks(),
            memory_kb=pages * os.sysconf("SC_PAGE_SIZE") // 1024,
            tasks=len(asyncio.all_tasks()),
            descriptors=len(list(files.iterdir())) if files.exists() else 0,
        )


def require_flat(levels: list[Level]) -> None:
    """The second half holds no more than the first.

    Raises:
        Grown: It does, with both.
    """
    half = len(levels) // 2
    before, after = levels[:half], levels[half:]
    for name, may_vary in (
        ("tasks", 0),
        ("descriptors", 0),
        ("blocks", _BLOCKS_MAY_VARY),
        ("memory_kb", _MEMORY_MAY_VARY_KB),
    ):
        first = max(getattr(one, name) for one in before)
        last = min(getattr(one, name) for one in after[-3:])
        if last > first + may_vary:
            raise Grown(f"{name}: at most {first} in the first half, {last} at the end: {levels}")


@asynccontextmanager
async def _read(aircraft: m100link.Aircraft) -> AsyncIterator[m100link.Subscription[Any]]:
    """A task takes every package."""
    samples = aircraft.telemetry()

    async def take() -> None:
        async for _ in samples:
            pass

    task = asyncio.create_task(take())
    try:
        yield samples
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def _fly(aircraft: m100link.Aircraft, seconds: float) -> None:
    async with aircraft.control(stop="land") as control:
        await control.take_off()
        async with control.hold(_NORTH) as held:
            for step in range(round(seconds / _STEP_S)):
                held.set(_NORTH if step * _STEP_S < seconds / 2 else _SOUTH)
                await asyncio.sleep(_STEP_S)
        await control.land()


Told = Callable[[str], None]


async def _watched(
    aircraft: m100link.Aircraft,
    rounds: int,
    round_s: float,
    flight_s: float,
    told: Told,
    *,
    charge: Callable[[], None] = lambda: None,
) -> list[Level]:
    """Fly a little in each round and look at its end."""
    levels = []
    loop = asyncio.get_running_loop()
    async with _read(aircraft) as samples:
        for number in range(rounds):
            ends_at = loop.time() + round_s
            frames, before = aircraft.statistics().frames_received, samples.received
            charge()
            try:
                await _fly(aircraft, flight_s)
            except m100link.TelemetryStalled as error:
                if isinstance(loop, VirtualClockEventLoop):
                    raise
                told(f"a guard ended the flight: {error.seen}")  # a machine that is busy
            await asyncio.sleep(max(0.0, ends_at - loop.time()))
            frames = aircraft.statistics().frames_received - frames
            # Against what came: on a busy machine the simulator sends less.
            if samples.received - before < max(round_s, 0.9 * frames):
                raise Grown(f"round {number}: {samples.received - before} packages of {frames}")
            levels.append(Level.now())
            told(f"round {number + 1} of {rounds}: {levels[-1]}")
    return levels


async def day(hours: float, told: Told) -> list[Level]:
    """Simulated hours on the virtual clock."""
    virtual = ConnectableAircraft(seed=1)
    async with virtual.connect() as aircraft:
        await aircraft.activate(virtual.credentials)
        await asyncio.sleep(1.1)
        rounds = max(6, round(hours))

        def charge() -> None:
            virtual.battery_percent = 100.0

        round_s = hours * 3600 / rounds
        levels = await _watched(aircraft, rounds, round_s, 20.0, told, charge=charge)
    virtual.stop()
    return levels


async def hour(seconds: float, told: Told) -> list[Level]:
    """Real seconds over a pseudo-terminal."""
    simulator = await asyncio.create_subprocess_exec(
        sys.executable,
        *("-m", "m100link", "sim", "--json", "--seed", "1"),
        stdout=asyncio.subprocess.PIPE,
    )
    assert simulator.stdout is not None
    try:
        url = json.loads(await simulator.stdout.readline())["port"]
        async with m100link.connect(url) as aircraft:
            await aircraft.activate(_CREDENTIALS)
            await asyncio.sleep(1.5)
            rounds = max(4, round(seconds / 120))
            return await _watched(aircraft, rounds, seconds / rounds, 5.0, told)
    finally:
        simulator.terminate()
        await simulator.wait()


async def connects(count: int, told: Told) -> list[Level]:
    """Connect, read a package, leave; all in memory."""
    levels = []
    virtual = ConnectableAircraft(seed=1)
    for number in range(count):
        async with virtual.connect() as aircraft:
            async for _ in aircraft.telemetry():
                break
        if number % max(1, count // 10) == 0:
            levels.append(Level.now())
            told(f"{number + 1} of {count}: {levels[-1]}")
    virtual.stop()
    return levels


def main() -> int:
    """Run all of it; 1 when something grows."""
    parser = argparse.ArgumentParser(prog="nox -s soak --", description=__doc__)
    parser.add_argument("--hours", type=float, default=24.0, help="simulated")
    parser.add_argument("--seconds", type=float, default=3600.0, help="over a pseudo-terminal")
    parser.add_argument("--connects", type=int, default=1000)
    options = parser.parse_args()
    if options.connects < 2:
        parser.error("one connection cannot be compared with another")

    def told(text: str) -> None:
        sys.stdout.write(f"{text}\n")
        sys.stdout.flush()

    work: dict[str, tuple[Coroutine[Any, Any, list[Level]], Any]] = {
        f"{options.connects} connects": (connects(options.connects, told), VirtualClockEventLoop),
        f"{options.hours:g} simulated hours": (day(options.hours, told), VirtualClockEventLoop),
        f"{options.seconds:g} s over a pseudo-terminal": (hour(options.seconds, told), None),
    }
    status = 0
    for name, (one, factory) in work.items():
        begin = time.process_time()
        with asyncio.Runner(loop_factory=factory) as runner:
            try:
                levels = runner.run(one)
                require_flat(levels)
            except Grown as grown:
                told(f"{name}: {grown}")
                status = 1
            else:
                told(f"{name}: flat, {time.process_time() - begin:.0f} s of CPU, {levels[-1]}")
    return status


if __name__ == "__main__":
    sys.exit(main())
