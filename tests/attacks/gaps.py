"""The time between two setpoints while strangers do their worst: ``python -m tests.attacks.gaps``.

Three processes, as in use: the station (``m100link console``, which is two of them), the attacker,
and this one with the virtual aircraft behind TCP and the client that holds a key. Setpoints leave
every 20 ms. Each attack is measured beside the same time without one, in turn, because the machine
may have other work. Shown twice are the gaps: as they were, and without the time for which the
agent and this process were ready to run while others ran, which Linux counts. Nothing here passes
or fails.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import math
import os
import ssl
import subprocess
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

from websockets.asyncio.client import ClientConnection

from m100link.sim.ports.driver import Driver, serve_tcp
from m100link.sim.vehicle.activation import DEMO_APP_ID, DEMO_KEY
from m100link.sim.virtual import VirtualAircraft
from tests.attacks.common import publish
from tests.sockets import connect
from tests.waiting import kept_waiting, until

__all__ = ["ATTACKS", "Gaps", "Line", "Station", "be_nice", "flying", "measure", "table"]

ATTACKS = ("large_arrays", "half_open", "idle_sockets", "orders", "greedy_readers", "pages")
"""Modules beside this one."""

_KEY_INTERVAL = 1 / 30
_CONSOLE_OF = ("pages",)
_ATTACKERS_NICENESS = 10  # strangers are on other machines: they take no time from the station


class Line(Driver):
    """The aircraft's end of the line.

    Attributes:
        station: Process ids of the agent and its front, once they run.
        arrivals: When each movement frame came, and how long others kept it waiting until then.
        moving: Of each, whether it moves the aircraft.
    """

    def __init__(self, aircraft: VirtualAircraft) -> None:
        super().__init__(aircraft)
        self.station: tuple[int, ...] = ()
        self.arrivals: list[tuple[float, float]] = []
        self.moving: list[bool] = []

    def now(self) -> tuple[float, float]:
        """The time, and for how long others kept the station and this process waiting."""
        return self.loop.time(), kept_waiting() + sum(map(kept_waiting, self.station))

    def receive(self, data: bytes) -> None:
        """Bytes came from the station."""
        counters = self.aircraft.autopilot.counters
        before, now = counters.movements, self.now()
        super().receive(data)
        if count := counters.movements - before:
            self.arrivals += [now] * count
            moves = list(self.aircraft.autopilot.received_movements)[-count:]
            self.moving += [any(move[1:]) for move in moves]


@dataclass
class Gaps:
    """What was seen beside one attack, or beside none.

    Attributes:
        gaps: Times between two setpoints, s.
        own: The same without what others took.
        unflown: Times between two setpoints that carry the key, without what others took, s.
        is_in_control: Whether the client that flies had control at the end of each.
    """

    gaps: list[float] = field(default_factory=list)
    own: list[float] = field(default_factory=list)
    unflown: list[float] = field(default_factory=list)
    is_in_control: bool = True

    def add(self, other: Gaps) -> None:
        """What was seen another time."""
        self.gaps += other.gaps
        self.own += other.own
        self.unflown += other.unflown
        self.is_in_control &= other.is_in_control


def _part(times: Sequence[float], share: float) -> float:
    """What that share of them is not longer than; NaN where there are none."""
    return sorted(times)[min(len(times) - 1, int(len(times) * share))] if times else math.nan


class Station:
    """A station whose aircraft flies, and the client that flies it."""

    def __init__(self, announced: dict[str, Any], line: Line, pilot: ClientConnection) -> None:
        rosbridge, console = announced["rosbridge"][0], announced["console"]
        self.line, self.pilot, self.name = line, pilot, ""
        self.ports = {
            name: _port(console if name in _CONSOLE_OF else rosbridge) for name in ATTACKS
        }
        for more in ("metrics", "foxglove"):
            self.ports[more] = _port(announced[more]) if more in announced else 0

    async def take_off(self) -> None:
        """Activate, take control, take off."""
        aircraft = self.line.aircraft
        await self.pilot.send(publish("/sdk_request_activation", data=1))
        await until(lambda: aircraft.vehicle.activation.active is not None)
        for _ in range(100):  # it may not know yet that it is activated
            if await self._call("/dji_sdk/sdk_control_authority", control_enable=1):
                break
            await asyncio.sleep(0.2)
        assert await self._call("/dji_sdk/drone_task_control", task=4)
        self.name = await self._holder()
        await until(lambda: aircraft.height > 1.0)
        await asyncio.sleep(3.0)

    async def _call(self, service: str, **args: int) -> bool:
        answer = await self._answer(service, args)
        return bool(answer["result"] and answer["values"].get("result"))

    async def _holder(self) -> str:
        answer = await self._answer("/m100link/lease", {"action": "status"})
        return str(answer["values"]["holder"])

    async def _answer(self, service: str, args: dict[str, Any]) -> Any:
        await self.pilot.send(json.dumps({"op": "call_service", "service": service, "args": args}))
        while True:
            answer = json.loads(await self.pilot.recv())
            if answer["op"] == "service_response":
                return answer

    async def hold_a_key(self, is_over: Callable[[], bool]) -> Gaps:
        """Hold a key until it is over; the times between the setpoints meanwhile."""
        loop, seen = asyncio.get_running_loop(), Gaps()
        key = publish("/sdk_request_ctrl", z=1.0)
        due = loop.time()
        line = self.line
        begin = len(line.arrivals)
        while not is_over():
            await self.pilot.send(key)
            due += _KEY_INTERVAL
            await asyncio.sleep(due - loop.time())
        arrivals = [*line.arrivals[begin:], line.now()]
        flown = [
            one for one, is_moving in zip(arrivals, line.moving[begin:], strict=False) if is_moving
        ]
        for (earlier, waited_before), (later, waited) in pairwise([*flown, arrivals[-1]]):
            seen.unflown.append(later - earlier - (waited - waited_before))
        for (earlier, waited_before), (later, waited) in pairwise(arrivals):
            seen.gaps.append(later - earlier)
            seen.own.append(later - earlier - (waited - waited_before))
        seen.is_in_control = await self._holder() == self.name
        return seen

    async def attacked(self, name: str, seconds: float) -> Gaps:
        """The times between setpoints beside an attack."""
        attacker = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", f"tests.attacks.{name}", str(self.ports[name])),
            *("--seconds", str(seconds)),
            preexec_fn=be_nice,
        )
        seen = await self.hold_a_key(lambda: attacker.returncode is not None)
        assert attacker.returncode == 0, name
        return seen

    async def left_alone(self, seconds: float) -> Gaps:
        """The same beside nothing."""
        loop = asyncio.get_running_loop()
        until_then = loop.time() + seconds
        return await self.hold_a_key(lambda: loop.time() >= until_then)


def be_nice() -> None:
    """For an attacker's process."""
    os.nice(_ATTACKERS_NICENESS)


def _children(process: int) -> list[int]:
    try:
        text = Path(f"/proc/{process}/task/{process}/children").read_text(encoding="ascii")
    except OSError:
        return []
    return [int(one) for one in text.split()]


def _trusting() -> ssl.SSLContext:
    context = ssl.create_default_context()
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE  # a certificate of this test's own
    return context


def _port(url: str) -> int:
    return int(url.partition("://")[2].partition("/")[0].rpartition(":")[2])


@asynccontextmanager
async def flying(*options: str, token: str = "") -> AsyncIterator[Station]:
    """A station in processes of its own, with an aircraft in the air.

    Args:
        options: For ``m100link console``.
        token: What its clients have to know.
    """
    line = Line(VirtualAircraft(seed=1))
    server = await serve_tcp(line)
    environment = os.environ | {
        "M100LINK_APP_ID": str(DEMO_APP_ID),
        "M100LINK_KEY": DEMO_KEY.reveal().hex(),
    }
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "m100link", "console", f"tcp://127.0.0.1:{server.port}"),
        *("--port", "0", "--console-port", "0", "--no-open-browser", "--json", *options),
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=environment,
    )
    async with AsyncExitStack() as stack:
        stack.push_async_callback(server.stop)
        stack.push_async_callback(_ended, process)
        assert process.stdout is not None
        announced = json.loads(await process.stdout.readline())
        line.station = (process.pid, *_children(process.pid))
        rosbridge = announced["rosbridge"][0]
        context = _trusting() if rosbridge.startswith("wss") else None
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        pilot = await stack.enter_async_context(
            connect(rosbridge, compression=None, ssl=context, additional_headers=headers)
        )
        station = Station(announced, line, pilot)
        await station.take_off()
        yield station


async def _ended(process: asyncio.subprocess.Process) -> None:
    process.terminate()
    await process.wait()


async def measure(
    attacks: Sequence[str],
    *options: str,
    seconds: float,
    rounds: int,
    tell: Callable[[str], None] = lambda text: None,
) -> list[tuple[str, Gaps, Gaps]]:
    """Each attack and the time beside it without one.

    Args:
        attacks: Some of :data:`ATTACKS`.
        options: For ``m100link console``.
        seconds: How long each lasts.
        rounds: How often each comes.
        tell: Called with what is being done.
    """
    found = {name: (Gaps(), Gaps()) for name in attacks}
    async with flying(*options) as station:
        works: list[tuple[int, Callable[[str], Awaitable[Gaps]]]] = [
            (0, lambda name: station.attacked(name, seconds)),
            (1, lambda name: station.left_alone(seconds)),
        ]
        for number in range(rounds):
            for name in attacks:
                tell(f"{number + 1} of {rounds}: {name}")
                for place, work in works:
                    found[name][place].add(await work(name))
    return [(name, *pair) for name, pair in found.items()]


def table(rows: Sequence[tuple[str, Gaps, Gaps]]) -> str:
    """The table, times in ms."""
    columns = "".join(f"{name:>9}" for name in ("p50", "p99", "worst", "own p99", "worst"))
    lines = [f"{'ms between setpoints':20}{'setpoints':>10}{columns}  control"]
    for name, attacked, alone in rows:
        for what, seen in ((name, attacked), ("  left alone", alone)):
            times = [_part(seen.gaps, share) for share in (0.5, 0.99, 1.0)]
            times += [_part(seen.own, share) for share in (0.99, 1.0)]
            numbers = "".join(f"{1000 * one:9.1f}" for one in times)
            control = "kept" if seen.is_in_control else "LOST"
            lines.append(f"{what:20}{len(seen.gaps):10}{numbers}  {control}")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("attacks", nargs="*", help=f"of {', '.join(ATTACKS)}; all by default")
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--single-process", action="store_true")
    options = parser.parse_args()
    more = ("--single-process",) if options.single_process else ()
    rows = asyncio.run(
        measure(
            options.attacks or ATTACKS,
            *more,
            seconds=options.seconds,
            rounds=options.rounds,
            tell=lambda text: print(text, file=sys.stderr, flush=True),
        )
    )
    print(table(rows))


if __name__ == "__main__":
    main()
