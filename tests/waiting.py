"""Waiting in real time, for tests with sockets, terminals and processes.

A test waits for what is to happen, never for a time in which it should have happened: on a machine
that is busy with other things everything takes longer.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterator
from pathlib import Path

PATIENCE = 120.0
"""Seconds for what takes one on an idle machine; more means that it does not happen."""


async def until(predicate: Callable[[], bool], within: float = PATIENCE) -> None:
    """Wait until it is so."""
    async with asyncio.timeout(within):
        while not predicate():  # noqa: ASYNC110 - what is waited for has no event
            await asyncio.sleep(0.01)


def again_and_again(within: float = PATIENCE) -> Iterator[None]:
    """Attempts at what a busy machine may refuse any number of times, but not for so long."""
    deadline = time.monotonic() + within
    while time.monotonic() < deadline:
        yield


def kept_waiting(process: int | None = None, thread: int | None = None) -> float:
    """Seconds for which a thread was ready to run while others ran; 0 where nobody counts.

    What is left of a gap without them is what it would have been on a machine of its own.

    Args:
        process: Whose thread; by default it is this thread.
        thread: Which; by default the main thread of the process.
    """
    place = "thread-self" if process is None else f"{process}/task/{thread or process}"
    try:
        counted = Path(f"/proc/{place}/schedstat").read_text(encoding="ascii")
    except OSError:
        return 0.0
    return int(counted.split()[1]) / 1e9


def kept_waiting_altogether(process: int) -> float:
    """The same, added up over all threads of a process: one may have waited for another."""
    threads = [int(place.name) for place in Path(f"/proc/{process}/task").glob("*")]
    return sum(kept_waiting(process, thread) for thread in threads)


class Standing:
    """For how long the running event loop stood still while a block ran.

    Attributes:
        total_s: Seconds altogether: what is left of a gap without them is no fault of the machine.
    """

    def __init__(self) -> None:
        self.total_s = 0.0

    async def __aenter__(self) -> Standing:
        self._looking = asyncio.create_task(self._look())
        return self

    async def __aexit__(self, *_: object) -> None:
        self._looking.cancel()
        await asyncio.wait([self._looking])

    async def _look(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            due = loop.time() + 0.01
            await asyncio.sleep(0.01)
            self.total_s += loop.time() - due


def blocking_until(predicate: Callable[[], bool], within: float = PATIENCE) -> None:
    """The same for tests without an event loop."""
    deadline = time.monotonic() + within
    while not predicate():
        assert time.monotonic() < deadline, f"not within {within} s"
        time.sleep(0.01)
