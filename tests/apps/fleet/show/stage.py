"""Virtual aircraft that stand where their tracks begin, with a clock each, on virtual time."""

from __future__ import annotations

import asyncio
import math
import random
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from itertools import combinations
from typing import Any

from m100link import Aircraft
from m100link.apps.fleet.show.clock import ClockEstimate, FleetClock, RemoteClock
from m100link.apps.fleet.show.follower import TrackFlown, TrackFollower
from m100link.apps.fleet.show.plan.track import TimedTrack, Vector
from m100link.flight.stop_path import StopAction
from m100link.geodesy import LocalFrame
from m100link.sim import AircraftSettings
from m100link.testing import ConnectableAircraft
from tests.apps.fleet.show.shows import track


def row(count: int, apart: float = 10.0) -> list[TimedTrack]:
    """Tracks of so many in a row, each 16 s long: forth, up, back and down."""
    return [
        track(
            f"a{index + 1}",
            (0, 0, index * apart, 4),
            (6, 12, index * apart, 6),
            (10, 12, index * apart + 2, 6),
            (16, 0, index * apart, 4),
        )
        for index in range(count)
    ]


def virtual(flown: TimedTrack, seed: int, **settings: Any) -> ConnectableAircraft:
    """One that stands below the first point of its track."""
    first = flown.points[0]
    latitude, longitude = LocalFrame(*flown.origin).to_geodetic(first.north, first.east)
    place = AircraftSettings(latitude_deg=latitude, longitude_deg=longitude, **settings)
    return ConnectableAircraft(seed=seed, settings=place)


@asynccontextmanager
async def ready(aircraft: ConnectableAircraft) -> AsyncIterator[Aircraft]:
    """Connected and activated."""
    async with aircraft.connect() as connected:
        await connected.activate(aircraft.credentials)
        await asyncio.sleep(1.1)
        yield connected
    aircraft.stop()


class Machine:
    """A machine with a clock of its own, which asks for the fleet's clock twice a second.

    Attributes:
        offset: Its own clock less the fleet's, which is the event loop's, s.
    """

    def __init__(self, chance: random.Random) -> None:
        self.offset = chance.uniform(-1000, 1000)
        self._drift = chance.uniform(-40e-6, 40e-6)
        self._chance = chance
        self.estimate = ClockEstimate()
        self.clock: FleetClock = RemoteClock(self.own, self.estimate)

    def own(self) -> float:
        now = asyncio.get_running_loop().time()
        return now * (1 + self._drift) + self.offset

    async def ask(self) -> None:
        """Round trips with ways of a wireless network, for ever."""
        fleet = asyncio.get_running_loop().time
        while True:
            sent = self.own()
            await asyncio.sleep(0.001 + self._chance.expovariate(200))
            there = fleet()
            await asyncio.sleep(0.001 + self._chance.expovariate(200))
            self.estimate.heard(sent, there, there, self.own())
            await asyncio.sleep(0.5)


class Stage:
    """Where everything really is, by the simulator and not by telemetry.

    Args:
        tracks: What is flown.
        aircraft: By whom, in the same order.
        start_at: When, by the event loop's clock.
    """

    def __init__(
        self, tracks: list[TimedTrack], aircraft: list[ConnectableAircraft], start_at: float
    ) -> None:
        self._flown = list(zip(tracks, aircraft, strict=True))
        self._start_at = start_at
        self.farthest = {one.name: 0.0 for one in tracks}
        self.left: dict[str, float] = {}
        self.nearest = math.inf

    def places(self) -> list[Vector]:
        found = []
        for one, aircraft in self._flown:
            first, (north, east) = one.points[0], aircraft.position
            found.append((first.north + north, first.east + east, aircraft.height))
        return found

    async def watch(self) -> None:
        """For ever, every 20 ms while the show goes on."""
        while True:
            await asyncio.sleep(0.02)
            at = asyncio.get_running_loop().time() - self._start_at
            places = self.places()
            self.nearest = min(self.nearest, *(math.dist(a, b) for a, b in combinations(places, 2)))
            for (one, _), place in zip(self._flown, places, strict=True):
                off = math.dist(place, one.moment(at).place)
                if 0 <= at <= one.end:
                    self.farthest[one.name] = max(self.farthest[one.name], off)
                # The first 30 cm of the way are flown within the first seconds.
                if at > -5 and math.dist(place, one.points[0].place) > 0.3:
                    self.left.setdefault(one.name, at)


async def perform(
    aircraft: Aircraft,
    flown: TimedTrack,
    clock: FleetClock,
    start_at: float,
    told: list[str],
    stop: StopAction = "land",
) -> TrackFlown:
    """What the agent of one aircraft does."""
    flown_how: TrackFlown | None = None
    async with aircraft.control(stop=stop, handle_signals=False) as control:
        follower = TrackFollower(control, flown, clock, tell=told.append)
        await follower.take_place()
        flown_how = await follower.fly(start_at)
    assert flown_how is not None, "a block hides no error"
    return flown_how
