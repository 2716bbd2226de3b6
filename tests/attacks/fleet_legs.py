"""One leg of a fleet's network cut in flight, without a word to anybody.

The pilot flies north at 3 m/s. Between him and the router, or between the router and the agent,
packets are dropped: all of them, or those of one direction, so that one end hears the other and
does not know that nobody hears itself. Nothing is closed: no FIN, no RST, as when a radio goes out
of range. The rules are of iptables, in a network of one's own::

    unshare -n sh -c 'ip link set lo up; python -m tests.attacks.fleet_legs'

Each end comes to the router by an address of its own, which is how the rules tell them apart.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
import time
from dataclasses import dataclass

from m100link.apps.fleet.client import connect
from tests.attacks.fleet import STILL_M_S, WITHIN_S, Site, flying
from tests.waiting import until

__all__ = ["CUTS", "Cut", "Seen", "cut"]

HOSTS = {"agent": "127.0.0.2", "pilot": "127.0.0.3", "watcher": "127.0.0.4"}
_TO, _FROM = "to the router", "from the router"


@dataclass(frozen=True)
class Cut:
    """What is cut.

    Attributes:
        leg: ``pilot`` or ``agent``: which of them has lost the router.
        ways: In which directions.
    """

    leg: str
    ways: tuple[str, ...] = (_TO, _FROM)

    def __str__(self) -> str:
        return f"{self.leg} {'both ways' if len(self.ways) == 2 else self.ways[0]}"

    def rules(self, port: int) -> list[list[str]]:
        """The arguments of iptables, behind ``-A`` or ``-D``."""
        host, number = HOSTS[self.leg], str(port)
        ends = {_TO: ("-d", host, "--dport", number), _FROM: ("-s", host, "--sport", number)}
        return [["INPUT", "-p", "tcp", *ends[way], "-j", "DROP"] for way in self.ways]


CUTS = tuple(
    Cut(leg, ways) for leg in ("pilot", "agent") for ways in ((_TO, _FROM), (_TO,), (_FROM,))
)

GONE_S = 2.0
TOLD_S = 6.0


@dataclass(frozen=True)
class Seen:
    """What was seen, s from the cut.

    Attributes:
        cut: Of what.
        still_s: Until the aircraft was below 0.3 m/s, and stayed there for a second.
        landed_s: Until it was down, by ``--lost land``.
        gone_s: Until a client that watches heard that the agent is gone; None when it did not.
        told_s: Until the operator's program heard of it.
        told: What it heard: the class, and what was seen.
        moved_m_s: Greatest horizontal speed in the three seconds after the leg was whole again.
    """

    cut: Cut
    still_s: float
    landed_s: float
    gone_s: float | None
    told_s: float
    told: dict[str, str]
    moved_m_s: float


async def _iptables(what: str, rules: list[list[str]]) -> None:
    for rule in rules:
        process = await asyncio.create_subprocess_exec("iptables", "-w", what, *rule)
        assert await process.wait() == 0, "only in a network of one's own"


async def _told(site: Site) -> tuple[float, dict[str, str]]:
    """When the operator's program said what it heard, and that."""
    stdout = site.processes["pilot"].stdout
    assert stdout is not None
    found: dict[str, str] = json.loads(await stdout.readline())
    return time.monotonic(), found


async def cut(what: Cut, seed: int = 1) -> Seen:
    """One cut and what follows."""
    async with flying(seed, HOSTS) as site, connect(site.place, name="watcher") as watcher:
        await until(lambda: "a1" in watcher.present)
        gone: list[float] = []

        async def watch() -> None:
            async for change in watcher.changes():
                if not change.is_there:
                    gone.append(time.monotonic())

        watching = asyncio.create_task(watch())
        telling = asyncio.create_task(_told(site))
        await _iptables("-A", what.rules(site.port))
        at = time.monotonic()
        still = await site.still_since(at)
        await until(lambda: site.aircraft.height < 0.1)
        landed = time.monotonic()
        await until(telling.done)
        await _iptables("-D", what.rules(site.port))
        moved = await site.fastest(3.0)
        watching.cancel()
        told_at, told = telling.result()
        gone_s = gone[0] - at if gone else None
        return Seen(what, still, landed - at, gone_s, told_at - at, told, moved)


def line(seen: Seen) -> str:
    """One line of a table."""
    gone = "–" if seen.gone_s is None else f"{seen.gone_s:.2f}s"
    return (
        f"{seen.cut!s:24} still {seen.still_s:5.2f}s  down {seen.landed_s:6.2f}s  gone {gone:>6}  "
        f"after it {seen.moved_m_s:.2f} m/s  told {seen.told_s:5.2f}s "
        f"{seen.told['told']}: {seen.told['seen']}"
    )


def is_as_it_should(seen: Seen) -> bool:
    """Whether it hovered in time, stayed where it was, and everybody heard what is true.

    While one operator is cut off, nobody else hears that the agent is gone: it is there. He himself
    knows of nothing that it did since.
    """
    if seen.cut.leg == "agent":
        is_seen_gone = seen.gone_s is not None and seen.gone_s < GONE_S
    else:
        is_seen_gone = seen.gone_s is None
    is_told = seen.told_s < TOLD_S and seen.told["told"] == "OutcomeUnknown"
    is_still = seen.still_s < WITHIN_S and seen.moved_m_s < STILL_M_S
    return is_still and is_seen_gone and is_told


async def _main(cuts: list[Cut], times: int) -> bool:
    is_good = True
    for seed in range(times):
        for one in cuts:
            seen = await cut(one, seed)
            print(line(seen), flush=True)
            is_good &= is_as_it_should(seen)
    return is_good


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=1)
    parser.add_argument("--only", choices=[str(one) for one in CUTS])
    given = parser.parse_args()
    chosen = [one for one in CUTS if given.only in (None, str(one))]
    sys.exit(0 if asyncio.run(_main(chosen, given.times)) else "not as it should be")
