"""Programs for ``test_processes.py``: python -m tests.flight.foreign_programs PROGRAM PORT…

They fly the foreign aircraft, which is in the air already, north for ever, and never handle a
signal, a break or a failure: whatever happens then is the library's doing.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import sys
from collections.abc import AsyncIterator

import m100link
from tests.flight.foreign_aircraft import APP_ID, KEY
from tests.flight.missions.foreign import plan
from tests.rig import NORTH
from tests.waiting import PATIENCE


async def in_a_loop(aircraft: m100link.Aircraft) -> None:
    async with aircraft.control() as control:
        async for tick in control.ticks():
            control.send(NORTH)
            if tick.index == 20:
                print("flying", flush=True)  # noqa: T201 (the test waits for it)
    print("went on behind the block", flush=True)  # noqa: T201 (it must not)


async def in_a_generator(aircraft: m100link.Aircraft) -> None:
    async def legs() -> AsyncIterator[int]:
        async with aircraft.control() as control:
            for leg in range(100):
                control.send(NORTH, lifetime=1.0)
                await asyncio.sleep(0.1)
                yield leg

    async for leg in legs():
        if leg == 5:
            break
    for _ in range(600):  # the loop closes the generator, which takes its time on a busy machine
        await asyncio.sleep(0.2)
        with contextlib.suppress(m100link.UsageError):
            async with aircraft.control():
                print("entered again", flush=True)  # noqa: T201 (the test waits for it)
            return


async def in_a_task(aircraft: m100link.Aircraft) -> None:
    flying = asyncio.create_task(in_a_loop(aircraft))
    await asyncio.sleep(1.0)
    del flying  # main leaves connect() while it flies


async def in_a_group(aircraft: m100link.Aircraft) -> None:
    async def fail() -> None:
        await asyncio.sleep(0.7)
        raise ZeroDivisionError("a bug beside the flight")

    async with aircraft.control() as control, asyncio.TaskGroup() as group:
        group.create_task(control.follow(lambda _: NORTH))
        group.create_task(fail())


async def in_a_dropped_generator(aircraft: m100link.Aircraft) -> None:
    async def legs() -> AsyncIterator[int]:
        async with aircraft.control() as control:
            while True:
                control.send(NORTH, lifetime=1.0)
                await asyncio.sleep(0.1)
                yield 1

    flight = legs()
    for _ in range(6):
        await anext(flight)
    del flight
    gc.collect()
    await asyncio.sleep(2.0)


async def in_a_loop_that_stops(aircraft: m100link.Aircraft) -> None:
    asyncio.get_running_loop().call_later(0.7, asyncio.get_running_loop().stop)
    await in_a_loop(aircraft)


async def in_blocks(aircraft: m100link.Aircraft) -> None:
    has_flown = asyncio.Event()

    async def blocks() -> None:
        while True:
            async with aircraft.control() as control:
                control.send(NORTH)
                await asyncio.sleep(0.2)
                has_flown.set()

    flying = asyncio.create_task(blocks())
    await has_flown.wait()
    await asyncio.sleep(0.1)  # its stop path runs: main leaves connect()
    del flying


async def on_a_mission(aircraft: m100link.Aircraft) -> None:
    """The aircraft flies; this only looks."""
    async with aircraft.control() as control:
        async with control.waypoint_mission(plan(speed=1.0)) as mission:
            async for _ in mission:
                pass
    print("went on behind the block", flush=True)  # noqa: T201 (it must not)


PROGRAMS = {
    "mission": on_a_mission,
    "loop": in_a_loop,
    "generator": in_a_generator,
    "task": in_a_task,
    "group": in_a_group,
    "dropped": in_a_dropped_generator,
    "stopped": in_a_loop_that_stops,
    "blocks": in_blocks,
}


async def fly(program: str, port: str) -> None:
    async with m100link.connect(port) as aircraft:
        await aircraft.activate(m100link.Credentials(app_id=APP_ID, key=KEY))
        await aircraft.wait_for(lambda state: state.flight_status is not None, timeout=PATIENCE)
        await PROGRAMS[program](aircraft)


async def main(program: str, *ports: str) -> None:
    """One aircraft per port."""
    async with asyncio.TaskGroup() as group:
        for port in ports:
            group.create_task(fly(program, port))


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
