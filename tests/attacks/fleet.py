"""Each process of a fleet killed or frozen in flight: ``python -m tests.attacks.fleet``.

The aircraft stands behind a pseudo-terminal in this process, so its truth is seen whatever happens
to the others: the router, the agent on board and the pilot, who flies north at 3 m/s. One of them
is killed (SIGKILL) or frozen (SIGSTOP); then it is measured when the aircraft is below 0.3 m/s,
what ``--lost`` leads to, when the pilots' view says that the agent is gone, and whether anything
moves when the lost one is back. A router that is frozen is a cable that was cut without a word.

``--cable`` cuts it indeed: between all three, by taking the loopback interface down. That is for a
network of one's own::

    unshare -n sh -c 'ip link set lo up; python -m tests.attacks.fleet --cable'
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import math
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

from m100link.apps.fleet.client import connect
from m100link.sim.ports.driver import Driver
from m100link.sim.ports.pty import PtyPort
from m100link.sim.vehicle.activation import DEMO_APP_ID, DEMO_KEY
from m100link.sim.virtual import VirtualAircraft
from tests.waiting import until

__all__ = [
    "LOSSES",
    "STILL_M_S",
    "WITHIN_S",
    "Loss",
    "Measured",
    "Site",
    "ended",
    "flying",
    "lose",
]

STILL_M_S = 0.3
WITHIN_S = 2.0
_LOST_AFTER_S = 2.0

_PILOT = """
import asyncio, json, sys
import m100link

async def main():
    north = m100link.Setpoint.velocity(north=3.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)
    async with m100link.fleet.connect(sys.argv[1], name="flier") as fleet:
        async with fleet["a1"].control() as control:
            await control.take_off()
            async with control.hold(north):
                await asyncio.sleep(600.0)

try:
    asyncio.run(main())
except m100link.M100Error as error:
    print(json.dumps({"told": type(error).__name__, "seen": error.seen}), flush=True)
"""


_PAGE = """
import asyncio, contextlib, sys
from types import SimpleNamespace
from m100link.apps.agent import orders
from m100link.apps.fleet.client import connect
from m100link.apps.station.fleet import Ships
from tests.apps.station.console.test_tab import Browser, keep_alive

async def main():
    async with connect(sys.argv[1], name="flier") as fleet, contextlib.AsyncExitStack() as stack:
        ships = Ships(fleet, stack)
        await ships.show("a1")
        far = ships.agents["a1"]
        while not far.is_connected:
            await asyncio.sleep(0.05)
        page = Browser(SimpleNamespace(front=far, agent=far), "page")
        page.say("alive")
        await page.tab.session.ask(orders.Activate())
        await page.tab.session.obtain()
        await keep_alive(page, page.tab.session.ask(orders.TakeOff()))
        while True:
            page.beat(2, y=3.0)
            await asyncio.sleep(0.05)

asyncio.run(main())
"""
"""A console of the fleet and its page in one process: both are lost with it."""


@dataclass(frozen=True)
class Loss:
    """What happens to whom.

    Attributes:
        who: ``router``, ``agent``, ``pilot`` or ``page``; ``cable`` for what is between them.
        how: The signal; None for a cable, which is cut without a word to either end.
        lands: Whether ``--lost land`` can follow: somebody has to be left who does it, or come
            after him.
    """

    who: str
    how: signal.Signals | None
    lands: bool


LOSSES = (
    Loss("pilot", signal.SIGKILL, True),
    Loss("pilot", signal.SIGSTOP, True),
    Loss("page", signal.SIGKILL, True),
    Loss("router", signal.SIGKILL, True),
    Loss("router", signal.SIGSTOP, True),
    Loss("agent", signal.SIGKILL, True),  # by the next one
    Loss("agent", signal.SIGSTOP, False),
)


CABLE = Loss("cable", None, True)


@dataclass(frozen=True)
class Measured:
    """What was seen.

    Attributes:
        loss: Of what.
        still_s: Seconds until it was below 0.3 m/s, and stayed there for a second.
        landed_s: Seconds until it was down; None where nobody was left to land it.
        gone_s: Seconds until a client that watches heard that the agent is gone; None where it
            is not, or the watcher itself is cut off.
        moved_m_s: Greatest horizontal speed in the three seconds after the lost one was back.
    """

    loss: Loss
    still_s: float
    landed_s: float | None
    gone_s: float | None
    moved_m_s: float


class Site:
    """Aircraft, and the processes beside it."""

    def __init__(
        self, stack: AsyncExitStack, seed: int, folder: Path, hosts: dict[str, str] | None = None
    ) -> None:
        self._stack = stack
        self._folder = folder
        self.aircraft = VirtualAircraft(seed=seed)
        driver = Driver(self.aircraft)
        port = PtyPort(driver)
        driver.start()
        stack.callback(driver.stop)
        self.url = f"{port.device}:230400"
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        # Each may come to the router by an address of its own.
        self._hosts = hosts or {}
        self.place = self.place_of("watcher")
        self.processes: dict[str, asyncio.subprocess.Process] = {}

    def place_of(self, who: str) -> str:
        """Where somebody reaches the router."""
        return f"tcp/{self._hosts.get(who, '127.0.0.1')}:{self.port}"

    @property
    def speed(self) -> float:
        return float(self.aircraft.vehicle.flight.dynamics.speed)

    async def start(self, who: str) -> None:
        """Start router, agent or pilot."""
        fleet = (sys.executable, "-m", "m100link", "fleet")
        places = dict.fromkeys((self.place, *map(self.place_of, self._hosts)))
        listens = [word for place in places for word in ("--listen", place)]
        commands = {
            "router": (*fleet, "router", *listens, "--json"),
            "agent": (
                *(*fleet, "agent", self.url, "--name", "a1", "--json"),
                *("--connect", self.place_of("agent")),
                *("--lost", "land", "--lost-after", f"{_LOST_AFTER_S:g}"),
                *("--order-log", str(self._folder)),
            ),
            "pilot": (sys.executable, "-c", _PILOT, self.place_of("pilot")),
            "page": (sys.executable, "-c", _PAGE, self.place_of("pilot")),
        }
        process = await asyncio.create_subprocess_exec(
            *commands[who],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=os.environ
            | {"M100LINK_APP_ID": str(DEMO_APP_ID), "M100LINK_KEY": DEMO_KEY.reveal().hex()},
        )
        self.processes[who] = process
        self._stack.push_async_callback(ended, process)
        if who not in ("pilot", "page"):
            assert process.stdout is not None
            assert json.loads(await process.stdout.readline())

    async def lose(self, loss: Loss) -> None:
        """Let it happen."""
        if loss.how is None:
            await _set_loopback("down")
        else:
            self.processes[loss.who].send_signal(loss.how)

    async def bring_back(self, loss: Loss) -> None:
        """What was lost is there again."""
        if loss.how is None:
            await _set_loopback("up")
        elif loss.how is signal.SIGSTOP:
            self.processes[loss.who].send_signal(signal.SIGCONT)
        else:
            await self.processes[loss.who].wait()
            await self.start(loss.who)

    async def still_since(self, lost_at: float) -> float:
        """Seconds from then until it was slow, and stayed so for a second."""
        slow_at = math.inf
        while time.monotonic() - slow_at < 1.0:
            slow_at = min(slow_at, time.monotonic()) if self.speed < STILL_M_S else math.inf
            if time.monotonic() - lost_at > 20.0:
                return math.inf
            await asyncio.sleep(0.01)
        return slow_at - lost_at

    async def fastest(self, seconds: float) -> float:
        """Greatest speed in that time."""
        ends, found = time.monotonic() + seconds, 0.0
        while time.monotonic() < ends:
            found = max(found, self.speed)
            await asyncio.sleep(0.01)
        return found


async def _set_loopback(state: str) -> None:
    process = await asyncio.create_subprocess_exec("ip", "link", "set", "lo", state)
    assert await process.wait() == 0, "only in a network of one's own"


async def ended(process: asyncio.subprocess.Process) -> None:
    """A process has, frozen or not."""
    with contextlib.suppress(ProcessLookupError):
        process.send_signal(signal.SIGCONT)
        process.kill()
    await process.wait()


@asynccontextmanager
async def flying(
    seed: int, hosts: dict[str, str] | None = None, *, by: str = "pilot"
) -> AsyncIterator[Site]:
    """A site whose aircraft flies north."""
    async with AsyncExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        site = Site(stack, seed, folder, hosts)
        for who in ("router", "agent", by):
            await site.start(who)
        await until(lambda: site.speed > 2.5)
        yield site


async def lose(loss: Loss, seed: int = 1) -> Measured:
    """One loss and what follows."""
    by = "page" if loss.who == "page" else "pilot"
    async with flying(seed, by=by) as site, connect(site.place, name="watcher") as watcher:
        await until(lambda: "a1" in watcher.present)
        gone: list[float] = []

        async def watch() -> None:
            async for change in watcher.changes():
                if not change.is_there:
                    gone.append(time.monotonic())

        watching = asyncio.create_task(watch())
        await site.lose(loss)
        lost_at = time.monotonic()
        still = await site.still_since(lost_at)
        landed = None
        if loss.how is signal.SIGKILL and loss.who == "agent":
            await site.bring_back(loss)
        if loss.lands:
            await until(lambda: site.aircraft.height < 0.1)
            landed = time.monotonic() - lost_at
        elif loss.how is signal.SIGSTOP:
            await until(lambda: bool(gone))
        if loss.how is not signal.SIGKILL or loss.who == "router":
            await site.bring_back(loss)
        moved = await site.fastest(3.0)
        watching.cancel()
        gone_s = gone[0] - lost_at if gone else None
        return Measured(loss, still, landed, gone_s, moved)


def table(measured: Measured) -> str:
    """One line."""

    def told(seconds: float | None) -> str:
        return "      –" if seconds is None else f"{seconds:6.2f}s"

    loss = measured.loss
    how = "cut" if loss.how is None else loss.how.name
    return (
        f"{loss.who:7} {how:8} still {told(measured.still_s)}  down "
        f"{told(measured.landed_s)}  gone {told(measured.gone_s)}  "
        f"after it {measured.moved_m_s:.2f} m/s"
    )


async def _main(losses: Sequence[Loss], times: int, tell: Callable[[str], None]) -> bool:
    is_good = True
    for seed in range(times):
        for loss in losses:
            measured = await lose(loss, seed)
            tell(table(measured))
            is_good &= measured.still_s < WITHIN_S and measured.moved_m_s < STILL_M_S
            is_good &= (measured.landed_s is not None) is loss.lands
    return is_good


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=1)
    parser.add_argument("--cable", action="store_true")
    given = parser.parse_args()
    good = asyncio.run(_main((CABLE,) if given.cable else LOSSES, given.times, print))
    sys.exit(0 if good else "something went on flying")
