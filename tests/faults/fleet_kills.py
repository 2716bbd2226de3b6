"""Orders to a fleet over real zenoh whose cables are cut, by an agent that is killed.

``python -m tests.faults.fleet_kills``

The aircraft stands behind a pseudo-terminal in this process and counts what arrives at its app.
Router and agent are processes. Between them, and between the pilot and the router, is a proxy that
breaks all connections every two seconds; now and then the agent is killed (SIGKILL) and started
anew, with nothing but its ledger. What may not be is said in :mod:`tests.faults.fleet_orders`.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import signal
import socket
import sys
import tempfile
import time
from collections import deque
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

from m100link.apps.fleet.client import connect
from m100link.sim.ports.driver import Driver
from m100link.sim.ports.pty import PtyPort
from m100link.sim.vehicle.activation import DEMO_APP_ID, DEMO_KEY
from m100link.sim.virtual import VirtualAircraft
from tests.faults.fleet_orders import Counted, Ordering
from tests.waiting import until

__all__ = ["Proxy", "run"]

CUT_S = 2.0
"""Seconds between two cuts."""

_WHILE_KILLED = 10


class Proxy:
    """A way to the router that can be cut.

    Args:
        port: Of the router.

    Attributes:
        port: Its own.
        cuts: Connections that were broken.
    """

    def __init__(self, port: int) -> None:
        self._router = port
        self._writers: set[asyncio.StreamWriter] = set()
        self._background: set[asyncio.Task[None]] = set()
        self.port = self.cuts = 0

    @asynccontextmanager
    async def running(self) -> AsyncIterator[Proxy]:
        """Be there while the block runs."""
        server = await asyncio.start_server(self._accept, "127.0.0.1", 0)
        self.port = server.sockets[0].getsockname()[1]
        try:
            yield self
        finally:
            server.close()
            self.cut()

    def cut(self) -> None:
        """Break all connections, as by a reset: what is on its way is lost."""
        self.cuts += len(self._writers) // 2
        for writer in list(self._writers):
            writer.transport.abort()

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            there, back = await asyncio.open_connection("127.0.0.1", self._router)
        except OSError:
            writer.transport.abort()
            return
        self._writers |= {writer, back}
        for source, sink in ((reader, back), (there, writer)):
            task = asyncio.ensure_future(self._pump(source, sink))
            self._background.add(task)
            task.add_done_callback(self._background.discard)

    async def _pump(self, source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
        # One end of it has gone: then the other one goes, too.
        with contextlib.suppress(OSError):
            while data := await source.read(65536):
                sink.write(data)
                await sink.drain()
        self._writers.discard(sink)
        sink.transport.abort()


class Site:
    """Router and agent as processes, and the proxy between them."""

    def __init__(self, stack: AsyncExitStack, url: str, folder: Path) -> None:
        self._stack, self._url, self._folder = stack, url, folder

    async def begin(self) -> None:
        """Start all."""
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        await self._start("router", "--listen", f"tcp/127.0.0.1:{port}", "--json")
        self.proxy = await self._stack.enter_async_context(Proxy(port).running())
        self.place = f"tcp/127.0.0.1:{self.proxy.port}"
        await self.start_agent()

    async def start_agent(self) -> None:
        """Start the agent, with the ledger that it had."""
        self.agent = await self._start(
            *("agent", self._url, "--name", "a1", "--connect", self.place, "--json"),
            *("--order-log", str(self._folder), "--no-record"),
        )

    async def kill_agent(self) -> None:
        """Kill it, and start it anew."""
        self.agent.send_signal(signal.SIGKILL)
        await self.agent.wait()
        await self.start_agent()

    async def _start(self, *words: str) -> asyncio.subprocess.Process:
        app = {"M100LINK_APP_ID": str(DEMO_APP_ID), "M100LINK_KEY": DEMO_KEY.reveal().hex()}
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "m100link", "fleet", *words),
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.DEVNULL,
            env=os.environ | app,
        )
        self._stack.push_async_callback(_ended, process)
        assert process.stdout is not None
        assert json.loads(await process.stdout.readline())
        return process


async def _ended(process: asyncio.subprocess.Process) -> None:
    with contextlib.suppress(ProcessLookupError):
        process.kill()
    await process.wait()


async def _cut_again_and_again(proxy: Proxy) -> None:
    while True:
        await asyncio.sleep(CUT_S)
        proxy.cut()


async def _kill_now_and_then(
    site: Site, ordering: Ordering, due: list[int], tell: Callable[[str], None]
) -> None:
    count = ordering.most
    for at, after in zip(due, [*due[1:], count], strict=True):
        # Some are given while it is killed and begins anew; the rest wait until it is back.
        ordering.most = min(at + _WHILE_KILLED, after)
        while len(ordering.told) < at:  # noqa: ASYNC110 - what is waited for has no event
            await asyncio.sleep(0.01)
        await site.kill_agent()
        ordering.most = after
        tell(f"{len(ordering.told)} orders, {site.proxy.cuts} connections cut, agent killed")


async def run(
    count: int, kills: int, tell: Callable[[str], None], *, seed: int = 1
) -> tuple[Counted, int]:
    """Send so many orders; what was counted, and how many connections were cut.

    Args:
        count: Orders.
        kills: How often the agent is killed.
        tell: Called with how far it is.
        seed: Of the virtual aircraft.
    """
    aircraft = VirtualAircraft(seed=seed)
    aircraft.vehicle.app.received = received = deque[bytes]()
    async with AsyncExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        driver = Driver(aircraft)
        port = PtyPort(driver)
        driver.start()
        stack.callback(driver.stop)
        site = Site(stack, f"{port.device}:230400", folder)
        await site.begin()
        fleet = await stack.enter_async_context(connect(site.place))
        await until(lambda: "a1" in fleet.present)
        asker, ordering = fleet["a1"].asker, Ordering(count, activates=True)
        due = [count * number // (kills + 1) for number in range(1, kills + 1)]
        async with asyncio.TaskGroup() as group:
            beside = [
                group.create_task(ordering.keep(asker)),
                group.create_task(_cut_again_and_again(site.proxy)),
            ]
            killing = group.create_task(_kill_now_and_then(site, ordering, due, tell))
            await ordering.order(asker)
            await killing
            for one in beside:
                one.cancel()
        await asyncio.sleep(2.0)  # what was late has come
        return ordering.counted(received, kills), site.proxy.cuts


def main() -> int:
    """Run it; 1 when something was that may not be."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--orders", type=int, default=3000)
    parser.add_argument("--kills", type=int, default=20)
    given = parser.parse_args()

    def tell(text: str) -> None:
        sys.stdout.write(f"{text}\n")
        sys.stdout.flush()

    began = time.monotonic()
    found, cuts = asyncio.run(run(given.orders, given.kills, tell))
    load = os.getloadavg()[0]
    tell(f"{time.monotonic() - began:.0f} s, load {load:.1f}, {cuts} connections cut: {found}")
    return 0 if found.is_good else 1


if __name__ == "__main__":
    sys.exit(main())
