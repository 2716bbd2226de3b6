"""A fleet that grows, simulated with the costs that were measured: who becomes too busy, and when.

    python -m benchmarks.growth [--aircraft 10 100 1000 10000] [--hz 5] [--site 1000]
                                [--seconds 10] [--seed 2015]

Time is virtual and nothing here opens a socket: every process is one queue that takes what comes in
its order, and each message costs what zenoh's cost on two cores with Python at both ends
(:data:`COSTS`). Aircraft tell the wall of their site where they are, five times a second, and their
headquarters how they are, every five seconds. A third of the way somebody stops all of them; half
of the way the cable of one router is cut, and its aircraft go to the other one.

What is not in it: whole machines that are busy with something else, batches (which make it
cheaper), radio links that lose, and people.
"""

from __future__ import annotations

import argparse
import heapq
import itertools
import math
import random
from collections.abc import Sequence
from dataclasses import dataclass

SEED = 2015
WALL_HZ = 5.0
STATE_HZ = 0.2
SITE = 1000
ROUTERS = 2  # of a site, and of the region


@dataclass(frozen=True)
class Costs:
    """Seconds. The first three are of zenoh 1.10 with Python, measured at 5 000 messages/s.

    Attributes:
        publish: Processor time of who sends one message.
        route: Of a router, for each copy that goes on.
        take: Of who gets it.
        hop: On the way inside of a site: half of a measured round trip.
        far: On the way between a site and its region; assumed.
        lost_after: Until a silent connection counts as gone; measured.
        join: Processor time of a router for one who comes anew; assumed.
        spread: Over which those who lost their router come anew; assumed.
    """

    publish: float = 8.4e-6
    route: float = 9.8e-6
    take: float = 10.8e-6
    hop: float = 0.2e-3
    far: float = 20e-3
    lost_after: float = 1.26
    join: float = 1e-3
    spread: float = 0.5


COSTS = Costs()


@dataclass(frozen=True)
class Growth:
    """What a fleet of one size came to.

    Attributes:
        aircraft: How many.
        sites: How many places with two routers and a wall each.
        router: Share of one core of the busiest router, before anything happens.
        left_router: Of the one that is left in the site where the other was cut off; NaN where it
            ended before all had come there.
        wall: Share of one core of the busiest wall.
        median_s: Age of telemetry as a wall has taken it, before anything happens.
        worst_s: The oldest of these.
        reached_s: From the order to stop all until the last aircraft had it.
        known_s: Until whoever ordered it had the last answer.
        answered: Answers that came.
        silent_s: The longest time without telemetry of an aircraft whose router was cut off.
    """

    aircraft: int
    sites: int
    router: float
    left_router: float
    wall: float
    median_s: float
    worst_s: float
    reached_s: float
    known_s: float
    answered: int
    silent_s: float


class Process:
    """One core that takes what comes in its order.

    Attributes:
        busy: Seconds of work so far.
        is_cut: Whether its cable is.
    """

    __slots__ = ("_free_at", "busy", "is_cut")

    def __init__(self) -> None:
        self.busy = 0.0
        self.is_cut = False
        self._free_at = 0.0

    def work(self, now: float, cost: float) -> float:
        """When something that comes now is done."""
        self.busy += cost
        self._free_at = max(now, self._free_at) + cost
        return self._free_at


class Fleet:
    """The whole of it.

    Args:
        aircraft: How many.
        seconds: For how long.
        hz: Telemetry that each gives to its wall.
        site: Aircraft of a site at most.
        seed: Of the phases, and of who comes anew when.
        costs: Of everything.
    """

    def __init__(
        self,
        aircraft: int,
        *,
        seconds: float = 10.0,
        hz: float = WALL_HZ,
        site: int = SITE,
        seed: int = SEED,
        costs: Costs = COSTS,
    ) -> None:
        self._period = 1 / hz
        self._costs = costs
        self._seconds = seconds
        self._chance = random.Random(seed)
        self._count = aircraft
        sites = math.ceil(aircraft / site)
        self._routers = [[Process() for _ in range(ROUTERS)] for _ in range(sites)]
        self._walls = [Process() for _ in range(sites)]
        # One site alone needs no region: its wall is where orders come from.
        self._region = [Process() for _ in range(ROUTERS)] if sites > 1 else []
        self._head = Process() if sites > 1 else self._walls[0]
        self._agents = [Process() for _ in range(aircraft)]
        self._router_of = [index // sites % ROUTERS for index in range(aircraft)]
        self._events: list[tuple[float, int, int, int, float]] = []
        self._number = itertools.count()
        self._steps = (
            *(self._tell, self._route, self._show, self._state, self._up, self._above),
            *(self._note, self._order, self._down, self._there, self._obey, self._back),
            *(self._home, self._answer, self._cut, self._anew, self._join),
        )
        self._which = {step.__name__: index for index, step in enumerate(self._steps)}
        self._ages: list[float] = []
        self._heard = [0.0] * aircraft
        self._silent = 0.0
        self._reached = self._known = 0.0
        self._answered = 0
        self._cut_at, self._ordered_at = seconds / 2, seconds / 3
        self._busy_before: list[list[float]] = []
        self._walls_before: list[float] = []
        self._left_from = 0.0, 0.0

    def _at(self, time: float, step: str, aircraft: int, value: float = 0.0) -> None:
        heapq.heappush(self._events, (time, next(self._number), self._which[step], aircraft, value))

    def _site(self, aircraft: int) -> int:
        return aircraft % len(self._routers)

    def _router(self, aircraft: int) -> Process:
        return self._routers[self._site(aircraft)][self._router_of[aircraft]]

    def _regional(self, aircraft: int) -> Process:
        return self._region[self._site(aircraft) % ROUTERS]

    def run(self) -> Growth:
        """Let it run."""
        for aircraft in range(self._count):
            self._at(self._chance.uniform(0, self._period), "_tell", aircraft)
            self._at(self._chance.uniform(0, 1 / STATE_HZ), "_state", aircraft)
        self._at(self._ordered_at, "_order", 0)
        self._at(self._cut_at, "_cut", 0)
        while self._events:
            now, _, step, aircraft, value = heapq.heappop(self._events)
            self._steps[step](now, aircraft, value)
        return self._result()

    # -- telemetry -------------------------------------------------------------------------------

    def _tell(self, now: float, aircraft: int, _value: float) -> None:
        if now + self._period < self._seconds:
            self._at(now + self._period, "_tell", aircraft)
        sent = self._agents[aircraft].work(now, self._costs.publish)
        self._at(sent + self._costs.hop, "_route", aircraft, now)

    def _route(self, now: float, aircraft: int, told: float) -> None:
        router = self._router(aircraft)
        if router.is_cut:
            return  # lost: nothing repeats what is old a moment later
        gone_on = router.work(now, self._costs.route)
        self._at(gone_on + self._costs.hop, "_show", aircraft, told)

    def _show(self, now: float, aircraft: int, told: float) -> None:
        if self._router(aircraft).is_cut:
            return
        taken = self._walls[self._site(aircraft)].work(now, self._costs.take)
        if taken < self._ordered_at:
            self._ages.append(taken - told)
        if self._heard[aircraft]:
            self._silent = max(self._silent, taken - self._heard[aircraft])
        self._heard[aircraft] = taken

    # -- how they are: up to the headquarters ----------------------------------------------------

    def _state(self, now: float, aircraft: int, _value: float) -> None:
        if now + 1 / STATE_HZ < self._seconds:
            self._at(now + 1 / STATE_HZ, "_state", aircraft)
        sent = self._agents[aircraft].work(now, self._costs.publish)
        self._at(sent + self._costs.hop, "_up", aircraft)

    def _up(self, now: float, aircraft: int, _value: float) -> None:
        router = self._router(aircraft)
        if router.is_cut:
            return
        gone_on = router.work(now, self._costs.route)
        on_the_way = self._costs.far if self._region else self._costs.hop
        self._at(gone_on + on_the_way, "_above" if self._region else "_note", aircraft)

    def _above(self, now: float, aircraft: int, _value: float) -> None:
        gone_on = self._regional(aircraft).work(now, self._costs.route)
        self._at(gone_on + self._costs.hop, "_note", aircraft)

    def _note(self, now: float, _aircraft: int, _value: float) -> None:
        self._head.work(now, self._costs.take)

    # -- stop all --------------------------------------------------------------------------------

    def _order(self, now: float, _aircraft: int, _value: float) -> None:
        self._busy_before = [[one.busy for one in pair] for pair in self._routers]
        self._walls_before = [wall.busy for wall in self._walls]
        for aircraft in range(self._count):  # one question each: none waits for another one
            asked = self._head.work(now, self._costs.publish)
            self._at(asked + self._costs.hop, "_down" if self._region else "_there", aircraft)

    def _down(self, now: float, aircraft: int, _value: float) -> None:
        gone_on = self._regional(aircraft).work(now, self._costs.route)
        self._at(gone_on + self._costs.far, "_there", aircraft)

    def _there(self, now: float, aircraft: int, _value: float) -> None:
        gone_on = self._router(aircraft).work(now, self._costs.route)
        self._at(gone_on + self._costs.hop, "_obey", aircraft)

    def _obey(self, now: float, aircraft: int, _value: float) -> None:
        taken = self._agents[aircraft].work(now, self._costs.take)
        self._reached = max(self._reached, taken - self._ordered_at)
        sent = self._agents[aircraft].work(taken, self._costs.publish)
        self._at(sent + self._costs.hop, "_back", aircraft)

    def _back(self, now: float, aircraft: int, _value: float) -> None:
        gone_on = self._router(aircraft).work(now, self._costs.route)
        on_the_way = self._costs.far if self._region else self._costs.hop
        self._at(gone_on + on_the_way, "_home" if self._region else "_answer", aircraft)

    def _home(self, now: float, aircraft: int, _value: float) -> None:
        gone_on = self._regional(aircraft).work(now, self._costs.route)
        self._at(gone_on + self._costs.hop, "_answer", aircraft)

    def _answer(self, now: float, _aircraft: int, _value: float) -> None:
        self._known = max(self._known, self._head.work(now, self._costs.take) - self._ordered_at)
        self._answered += 1

    # -- a router is cut off ---------------------------------------------------------------------

    def _cut(self, now: float, _aircraft: int, _value: float) -> None:
        self._routers[0][0].is_cut = True
        for aircraft in range(self._count):
            if self._router(aircraft).is_cut:
                noticed = now + self._costs.lost_after
                self._at(noticed + self._chance.uniform(0, self._costs.spread), "_anew", aircraft)

    def _anew(self, now: float, aircraft: int, _value: float) -> None:
        other = self._routers[self._site(aircraft)][1]
        self._at(other.work(now, self._costs.join), "_join", aircraft)

    def _join(self, now: float, aircraft: int, _value: float) -> None:
        self._router_of[aircraft] = 1
        self._left_from = (now, self._routers[0][1].busy)

    # -- what it came to -------------------------------------------------------------------------

    def _result(self) -> Growth:
        ages = sorted(self._ages)
        since, busy = self._left_from
        left = self._seconds - since
        return Growth(
            aircraft=self._count,
            sites=len(self._routers),
            router=max(map(max, self._busy_before)) / self._ordered_at,
            left_router=(self._routers[0][1].busy - busy) / left if left > 0.5 else math.nan,
            wall=max(self._walls_before) / self._ordered_at,
            median_s=ages[len(ages) // 2],
            worst_s=ages[-1],
            reached_s=self._reached,
            known_s=self._known,
            answered=self._answered,
            silent_s=self._silent,
        )


_HEAD = (
    f"{'aircraft':>8} {'sites':>5} {'router':>7} {'left':>7} {'wall':>7} {'age':>8} {'oldest':>8} "
    f"{'stopped':>8} {'known':>8} {'silent':>7}"
)


def line(found: Growth) -> str:
    """A row of the table."""
    return (
        f"{found.aircraft:>8} {found.sites:>5} {found.router:>7.1%} {found.left_router:>7.1%} "
        f"{found.wall:>7.1%} {found.median_s * 1e3:>5.2f} ms {found.worst_s * 1e3:>5.2f} ms "
        f"{found.reached_s * 1e3:>5.0f} ms {found.known_s * 1e3:>5.0f} ms {found.silent_s:>5.2f} s"
    )


def main(words: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="benchmarks.growth", description=__doc__)
    parser.add_argument("--aircraft", type=int, nargs="+", default=[10, 100, 1000, 10_000])
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--hz", type=float, default=WALL_HZ)
    parser.add_argument("--site", type=int, default=SITE)
    parser.add_argument("--seed", type=int, default=SEED)
    given = parser.parse_args(words)
    print(
        f"simulated: {given.hz:g} Hz to a wall, up to {given.site} aircraft at a site, "
        f"{given.seconds:g} s of virtual time, seed {given.seed}"
    )
    print(_HEAD)
    for aircraft in given.aircraft:
        fleet = Fleet(
            aircraft, seconds=given.seconds, hz=given.hz, site=given.site, seed=given.seed
        )
        print(line(fleet.run()))


if __name__ == "__main__":
    main()
