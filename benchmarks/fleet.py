"""Many aircraft in one process, beside as many pymavlink parsers in the same harness.

    python -m benchmarks.fleet [ROW …] [--rounds 15] [--json] [--beside TREE]

Each of two hundred lines is a pair of sockets that the event loop reads by ``add_reader``, in one
``os.read`` each. A line has a package every 10 ms, at a phase of its own, and time is told in steps
of 1 ms: in each, the packages that fall into it are written, and then the loop runs until all are
read. Only the reading is timed, so neither the writer nor a busy machine is part of it, and no two
packages of a line come together.

Of ours the whole stack is there: link, sessions, state, clock, authority. With a task each, a
subscription of ``async for`` takes every package. pymavlink parses and counts, without a task.
"""

from __future__ import annotations

import asyncio
import os
import random
import socket
import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack

import m100link
from benchmarks import peers
from benchmarks.consumer import make_aircraft
from benchmarks.frames import telemetry_frames
from benchmarks.program import main
from benchmarks.rows import Absent, Program, Row, Setting, Side, at_most, ratio
from m100link.link import Link

AIRCRAFT = 200
PERIOD_MS = 10
PERIODS = 20  # packages of each line per timing
SEED = 2015
BARE = f"{AIRCRAFT} aircraft, per package"
TASKS = f"{AIRCRAFT} aircraft with a task each, per package"
PEER = f"{AIRCRAFT} pymavlink parsers, per message"

Receive = Callable[[bytes], None]


class Harness:
    """Lines that are written and read in this process.

    Args:
        receivers: Who gets what a line carries.
        wires: What each line carries, one after the other.
        count: How many have arrived at those whose work is timed.
    """

    def __init__(
        self, receivers: list[Receive], wires: list[bytes], count: Callable[[], int]
    ) -> None:
        self._receivers = receivers
        self._wires = wires
        self._count = count

    async def run(self, periods: int) -> float:
        """CPU seconds per package."""
        loop = asyncio.get_running_loop()
        pairs = [socket.socketpair() for _ in self._receivers]
        try:
            for (_, end), receive in zip(pairs, self._receivers, strict=True):
                end.setblocking(False)
                loop.add_reader(end, self._read, end.fileno(), receive)
            return await self._deliver([begin for begin, _ in pairs], periods)
        finally:
            for begin, end in pairs:
                loop.remove_reader(end)
                begin.close()
                end.close()

    @staticmethod
    def _read(fd: int, receive: Receive) -> None:
        receive(os.read(fd, 65536))

    async def _deliver(self, begins: list[socket.socket], periods: int) -> float:
        dice = random.Random(SEED)
        slots: list[list[socket.socket]] = [[] for _ in range(PERIOD_MS)]
        for begin in begins:
            slots[dice.randrange(PERIOD_MS)].append(begin)
        await asyncio.sleep(0)
        sent, spent = self._count(), 0.0
        for period in range(periods):
            wire = self._wires[period]
            for slot in slots:
                for begin in slot:
                    begin.send(wire)
                sent += len(slot)
                began = time.thread_time()
                while self._count() < sent:  # noqa: ASYNC110 - a pass of the loop is what is timed
                    await asyncio.sleep(0)
                spent += time.thread_time() - began
        return spent / (periods * len(begins))


def ours(setting: Setting, stack: ExitStack) -> Iterable[Side]:
    """Aircraft alone, and with a task each."""
    number, periods = setting.count(AIRCRAFT), max(2, setting.count(PERIODS))
    wires = telemetry_frames(periods)

    async def make(count: int) -> list[tuple[m100link.Aircraft, Link]]:
        return await asyncio.gather(*(make_aircraft() for _ in range(count)))

    async def alone() -> float:
        links = [link for _, link in await make(number)]
        taken = 0

        def receiver(data_received: Receive) -> Receive:
            def receive(data: bytes) -> None:
                nonlocal taken
                data_received(data)
                taken += 1

            return receive

        receivers = [receiver(link.data_received) for link in links]
        return await Harness(receivers, wires, lambda: taken).run(periods)

    async def with_tasks() -> float:
        made = await make(number)
        taken = 0

        async def take(aircraft: m100link.Aircraft) -> None:
            nonlocal taken
            async with aircraft.telemetry() as samples:
                async for _ in samples:
                    taken += 1

        tasks = [asyncio.create_task(take(aircraft)) for aircraft, _ in made]
        receivers: list[Receive] = [link.data_received for _, link in made]
        try:
            return await Harness(receivers, wires, lambda: taken).run(periods)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    yield Side(BARE, lambda: asyncio.run(alone()))
    yield Side(TASKS, lambda: asyncio.run(with_tasks()))


def others(setting: Setting, stack: ExitStack) -> Iterable[Side | Absent]:
    """pymavlink's parsers."""
    mavlink = peers.dialect()
    if mavlink is None:
        yield Absent(PEER, peers.MISSING)
        return
    number, periods = setting.count(AIRCRAFT), max(2, setting.count(PERIODS))
    wires = peers.mix(mavlink, periods)

    async def run() -> float:
        parsed = 0

        def receiver() -> Receive:
            parse = peers.parser(mavlink)

            def receive(data: bytes) -> None:
                nonlocal parsed
                parsed += parse(data)

            return receive

        return await Harness([receiver() for _ in range(number)], wires, lambda: parsed).run(
            periods
        )

    yield Side(PEER, lambda: asyncio.run(run()))


PROGRAM = Program(
    name="fleet",
    rows=(
        Row(
            "aircraft at 100 Hz in one process, ours ÷ pymavlink",
            ratio(BARE, PEER),
            at_most(0.85, 0.65),
        ),
        Row("the same with a consuming task each", ratio(TASKS, PEER), at_most(1.0, 0.8)),
    ),
    ours=ours,
    others=others,
)

if __name__ == "__main__":
    main(PROGRAM)
