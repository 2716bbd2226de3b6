"""A thousand aircraft on one site: is all received, what does it cost, does anything grow?

``nox -s thousand``, or ``python -m tests.soak.fleet --seconds 60 --aircraft 200``.

A router, agents in two processes and one that watches, by zenoh over loopback: five packages a
second of each aircraft, fifty of one. A thousand virtual aircraft with their physics are more than
two cores can fly, so most are *told*: their packages are a virtual aircraft's, recorded before, and
all behind is what a fleet has (see :mod:`tests.soak.fleet_end`). Some fly, in a process of their
own. What agents cost without a fleet is measured first, and taken away: what is left is the road.
Before and after, zenoh alone carries the same messages: see :mod:`tests.soak.bare_zenoh`.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from m100link.apps.fleet.publisher import WALL_HZ
from tests.soak.fleet_end import FULL_HZ, LOOKED_AT
from tests.soak.run import Grown, Level, require_flat

__all__ = ["Measured", "measure"]

MOST_US = 30.0
"""Microseconds of a processor for one message, of agent, router and watcher together."""

LEAST_RECEIVED = 0.999
SETTLE_S = 5.0
"""Seconds in which agents that have just come are reported to each other."""

_LOOK_S = 10.0
_HERTZ = os.sysconf("SC_CLK_TCK")


def cpu_of(pid: int) -> float:
    """Seconds of a processor that a process has taken."""
    words = Path(f"/proc/{pid}/stat").read_text("ascii").rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / _HERTZ


def level_of(pid: int) -> Level:
    """What a process holds, as its system sees it."""
    pages = int(Path(f"/proc/{pid}/statm").read_text("ascii").split()[1])
    kilobytes = pages * os.sysconf("SC_PAGE_SIZE") // 1024
    return Level(0, kilobytes, 0, len(list(Path(f"/proc/{pid}/fd").iterdir())))


class _End:
    """A process that gets orders and reports what it saw."""

    def __init__(self, stack: ExitStack, *words: str) -> None:
        self.process = subprocess.Popen(
            (sys.executable, "-m", *words),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        stack.callback(self._end)

    def _end(self) -> None:
        self.process.kill()
        self.process.communicate()

    def say(self, line: str) -> None:
        """Tell it what to do."""
        assert self.process.stdin is not None
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def hear(self) -> dict[str, Any]:
        """Its next line."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError(f"{self.process.args!r} has ended")
        found: dict[str, Any] = json.loads(line)
        return found


@dataclass(frozen=True)
class Measured:
    """What was seen.

    Attributes:
        seconds: For how long.
        told: Aircraft whose packages were recorded.
        flying: Virtual aircraft with their physics.
        sent: Messages, by the last word of their key: ``5hz``, ``tel`` and ``state``.
        heard: Those that came.
        slowest: Packages a second for the wall of that aircraft that had fewest.
        agents_us: CPU of agents for a message, beyond what they take without a fleet, µs.
        router_us: Of the router.
        watcher_us: Of who watches.
        bare_us: CPU of zenoh alone for the same messages, before and after, µs.
        alone_s: CPU that agents of told aircraft take in a second without a fleet.
        flying_s: CPU that one virtual aircraft and its agent take in a second without a fleet.
        levels: What each process held, by its name.
        load: Load of the machine at the end.
    """

    seconds: float
    told: int
    flying: int
    sent: Counter[str]
    heard: Counter[str]
    slowest: float
    agents_us: float
    router_us: float
    watcher_us: float
    bare_us: tuple[float, float]
    alone_s: float
    flying_s: float
    levels: dict[str, list[Level]]
    load: float

    @property
    def received(self) -> float:
        """Share of the telemetry that came.

        The watcher begins to count a moment before the others. Cards of states are for the agents
        themselves: an operator asks for them.
        """
        sent = self.sent.total() - self.sent["state"]
        return sum(min(self.heard[k], self.sent[k]) for k in ("5hz", "tel")) / sent

    @property
    def us(self) -> float:
        """CPU for one message, µs."""
        return self.agents_us + self.router_us + self.watcher_us

    @property
    def text(self) -> str:
        """In lines."""
        kinds = ", ".join(f"{self.heard[k]} of {n} {k}" for k, n in sorted(self.sent.items()))
        load, rate = f"load {self.load:.1f}", f"{self.sent.total() / self.seconds:.0f} messages/s"
        parts = f"agents {self.agents_us:.1f}, router {self.router_us:.1f}"
        alone = f"{self.alone_s:.3f} of a core for all that are told"
        before, after = self.bare_us
        bare = f"{before:.1f} µs before and {after:.1f} after"
        engine = f"zenoh {version('eclipse-zenoh')}, Python {platform.python_version()}"
        lines = [
            f"{engine}, {os.cpu_count()} processors, {platform.machine()}",
            f"{self.told} told and {self.flying} flying, {self.seconds:g} s, {load}: {rate}",
            f"received {self.received:.4%}: {kinds}; fewest {self.slowest:.2f} packages/s",
            f"CPU for a message {self.us:.1f} µs: {parts}, watcher {self.watcher_us:.1f}",
            f"zenoh alone: {bare}, so {2 * self.us / (before + after):.1f} times that",
            f"without a fleet: {alone}, {self.flying_s:.4f} for each that flies",
        ]
        for name, levels in self.levels.items():
            seen = [level.memory_kb / 1024 for level in levels]
            lines.append(
                f"{name}: {seen[0]:.1f} MB, {max(seen):.1f} at most, {seen[-1]:.1f} at the end"
            )
        return "\n".join(lines)

    def faults(self) -> list[str]:
        """What is not as it is to be."""
        found = []
        if self.received < LEAST_RECEIVED:
            found.append(f"received {self.received:.4%}")
        if self.us > MOST_US:
            found.append(f"{self.us:.1f} µs for a message")
        if self.slowest < 0.97 * WALL_HZ:
            found.append(f"one had {self.slowest:.2f} packages/s")
        if self.sent["tel"] < 0.97 * FULL_HZ * self.seconds:
            found.append(f"{self.sent['tel']} packages of the one looked at")
        for name, levels in self.levels.items():
            try:
                require_flat(levels)
            except Grown as grown:
                found.append(f"{name}: {grown}")
        return found


def _free_place() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def _names(told: int, flying: int, processes: int) -> dict[str, list[str]]:
    names = [LOOKED_AT, *(f"a{number}" for number in range(1, told))]
    found = {f"told {place}": names[place::processes] for place in range(processes)}
    if flying:
        found["flying"] = [f"v{number}" for number in range(flying)]
    return found


def measure(
    told: int,
    flying: int,
    seconds: float,
    tell: Callable[[str], None],
    *,
    processes: int = 2,
    alone_s: float = 30.0,
    bare_s: float = 20.0,
) -> Measured:
    """Let a fleet run.

    Args:
        told: Aircraft whose packages are recorded.
        flying: Virtual aircraft.
        seconds: For how long.
        tell: Called with how far it is.
        processes: In which those who are told are.
        alone_s: Seconds for which agents run without a fleet before.
        bare_s: Seconds for which zenoh alone carries the same, before and after.
    """
    before = _bare(told + flying, bare_s)
    tell(f"zenoh alone: {before:.1f} µs for a message")
    place = _free_place()
    names = _names(told, flying, processes)
    with ExitStack() as stack:
        router = _End(stack, "m100link", "fleet", "router", "--listen", place, "--json")
        router.hear()
        agents = {
            role: _End(stack, "tests.soak.fleet_end", role.split()[0], place, *its)
            for role, its in names.items()
        }
        for one in agents.values():
            one.hear()
        tell(f"{told} told and {flying} flying aircraft are there")
        # One after the other: the next one would make the caches of this one colder.
        alone = {role: _alone(one, alone_s) for role, one in agents.items()}
        watcher = _End(stack, "tests.soak.fleet_end", "watch", place, str(told + flying))
        watcher.hear()
        time.sleep(SETTLE_S)
        tell("all are seen")
        ends = {"router": router, **agents, "watcher": watcher}
        levels, router_s = _run(ends, seconds, tell)
        results = {role: one.hear() for role, one in agents.items()}
        time.sleep(2.0)  # what was sent last is on its way
        watcher.say("end")
        seen = watcher.hear()
        for one in agents.values():
            one.say("end")
    sent = sum((Counter(one["sent"]) for one in results.values()), Counter[str]())
    walls = Counter(seen["walls"])
    count = sent.total()
    more = sum(one["cpu"] - alone[role] * seconds for role, one in results.items())
    return Measured(
        seconds=seconds,
        told=told,
        flying=flying,
        sent=sent,
        heard=Counter({kind: seen["heard"].get(kind, 0) for kind in sent}),
        slowest=min(walls[name] for its in names.values() for name in its) / seconds,
        agents_us=more / count * 1e6,
        router_us=router_s / count * 1e6,
        watcher_us=seen["cpu"] / count * 1e6,
        bare_us=(before, _bare(told + flying, bare_s)),
        alone_s=sum(cost for role, cost in alone.items() if role != "flying"),
        flying_s=alone.get("flying", 0.0) / max(1, flying),
        levels=levels,
        load=os.getloadavg()[0],
    )


def _bare(aircraft: int, seconds: float) -> float:
    """µs of a processor that zenoh alone takes for one message of so many aircraft."""
    place, half = _free_place(), aircraft // 2
    with ExitStack() as stack:

        def end(*words: object) -> _End:
            one = _End(stack, "tests.soak.bare_zenoh", *map(str, words))
            one.hear()
            return one

        router = end("route", place)
        ends = [
            end("take", place, seconds + 1.0),
            end("publish", place, 0, half, seconds),
            end("publish", place, half, aircraft - half, seconds),
        ]
        time.sleep(SETTLE_S)
        before = cpu_of(router.process.pid)
        for one in ends:
            one.say("")
        results = [one.hear() for one in ends]
        router_s = cpu_of(router.process.pid) - before
        ends_s = sum(float(one["cpu"]) for one in results)
        return (router_s + ends_s) / int(results[0]["heard"]) * 1e6


def _alone(one: _End, seconds: float) -> float:
    """Seconds of a processor that agents take in a second without a fleet."""
    one.say(f"alone {seconds}")
    return float(one.hear()["cpu"]) / seconds


def _run(
    ends: dict[str, _End], seconds: float, tell: Callable[[str], None]
) -> tuple[dict[str, list[Level]], float]:
    """Let all run; what each held now and then, and what the router took."""
    pid = ends["router"].process.pid
    before = cpu_of(pid)
    ends["watcher"].say("together")
    for role, one in ends.items():
        if role not in ("router", "watcher"):
            one.say(f"together {seconds}")
    began = time.monotonic()
    levels: dict[str, list[Level]] = {name: [] for name in ends}
    looks = max(6, round(seconds / _LOOK_S))
    for look in range(1, looks + 1):
        time.sleep(max(0.0, began + look * seconds / looks - time.monotonic()))
        for name, one in ends.items():
            levels[name].append(level_of(one.process.pid))
        held = ", ".join(f"{name} {its[-1].memory_kb // 1024} MB" for name, its in levels.items())
        tell(f"{look * seconds / looks:.0f} s, load {os.getloadavg()[0]:.1f}: {held}")
    return levels, cpu_of(pid) - before


def main() -> int:
    """Run it; 1 when something is not as it is to be."""
    parser = argparse.ArgumentParser(prog="nox -s thousand --", description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--aircraft", type=int, default=1000, help="in all")
    parser.add_argument("--flying", type=int, default=20, help="of them with their physics")
    options = parser.parse_args()

    def tell(text: str) -> None:
        sys.stdout.write(f"{text}\n")
        sys.stdout.flush()

    measured = measure(options.aircraft - options.flying, options.flying, options.seconds, tell)
    tell(measured.text)
    faults = measured.faults()
    for fault in faults:
        tell(f"not as it is to be: {fault}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
