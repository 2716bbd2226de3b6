"""Aircraft in a show: each keeps to its track by its own clock, or leaves by its own stop path."""

from __future__ import annotations

import asyncio
import math
import random
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager

import pytest

from m100link import Aircraft, Control, FlightPhase, LinkLost
from m100link.apps.fleet.show.clock import OwnClock
from m100link.apps.fleet.show.follower import LeftShow, ShowRefused, TrackFlown, TrackFollower, Why
from m100link.apps.fleet.show.plan.track import TimedTrack
from m100link.testing import ConnectableAircraft
from tests.apps.fleet.show.shows import track
from tests.apps.fleet.show.stage import Machine, Stage, perform, ready, row, virtual

pytestmark = pytest.mark.anyio

START = 25.0
"""By then all have taken off, climbed to their places and wait."""


@pytest.fixture
def anyio_backend() -> object:
    from m100link.sim import VirtualClockEventLoop

    return "asyncio", {"loop_factory": VirtualClockEventLoop}


# -- five of them ---------------------------------------------------------------------------------


async def fly_together(
    tracks: list[TimedTrack], stage: Stage, all_of_them: list[ConnectableAircraft], seed: int
) -> tuple[list[TrackFlown | BaseException], list[str]]:
    told: list[str] = []
    async with AsyncExitStack() as stack:
        connected = [await stack.enter_async_context(ready(one)) for one in all_of_them]
        machines = [Machine(random.Random(seed + index)) for index in range(len(tracks))]
        besides = [asyncio.create_task(machine.ask()) for machine in machines]
        besides.append(asyncio.create_task(stage.watch()))
        outcomes = await asyncio.gather(
            *(
                perform(aircraft, one, machine.clock, START, told)
                for aircraft, one, machine in zip(connected, tracks, machines, strict=True)
            ),
            return_exceptions=True,
        )
        for task in besides:
            task.cancel()
    return outcomes, told


@pytest.mark.parametrize("seed", [1, 2])
async def test_five_begin_within_50_ms_and_keep_to_their_tubes(seed: int) -> None:
    """Each by a clock that is up to 1000 s off, over a network with ways of 1 to 30 ms."""
    tracks = row(5)
    all_of_them = [virtual(one, seed, wind_north=3, gusts=0.7, noise=0.5) for one in tracks]
    stage = Stage(tracks, all_of_them, START)
    outcomes, told = await fly_together(tracks, stage, all_of_them, seed)
    for outcome in outcomes:
        assert isinstance(outcome, TrackFlown), outcome
        assert outcome.farthest_m < 0.7
        assert outcome.bound_s < 0.05
        assert outcome.began_late_s < 0.0201  # within the period of its setpoints
    assert max(stage.farthest.values()) < 1.0, "the simulator says so"
    assert max(stage.left.values()) - min(stage.left.values()) < 0.3  # gusts
    assert stage.nearest > 8.0
    assert sum(text.endswith("is at the end of its track") for text in told) == 5
    assert all(one.height == 0 for one in all_of_them), "they landed"


async def test_without_wind_they_move_off_within_50_ms_of_each_other() -> None:
    tracks = row(5)
    all_of_them = [virtual(one, 3) for one in tracks]
    stage = Stage(tracks, all_of_them, START)
    outcomes, _ = await fly_together(tracks, stage, all_of_them, 3)
    assert all(isinstance(outcome, TrackFlown) for outcome in outcomes)
    assert max(stage.left.values()) - min(stage.left.values()) <= 0.05
    assert max(stage.farthest.values()) < 0.25


async def test_one_is_killed_and_stops_while_the_others_fly_on() -> None:
    """Its agent is gone with the cable: nobody is there who could stop it but the aircraft."""
    tracks = row(5)
    all_of_them = [virtual(one, 4) for one in tracks]
    stage = Stage(tracks, all_of_them, START)
    killed = all_of_them[2]
    speeds: list[float] = []

    async def kill() -> None:
        await asyncio.sleep(START + 4.0 - asyncio.get_running_loop().time())
        killed.unplug()
        await asyncio.sleep(2.0)
        for _ in range(50):
            speeds.append(killed.vehicle.flight.dynamics.speed)
            await asyncio.sleep(0.1)

    killer = asyncio.create_task(kill())
    outcomes, told = await fly_together(tracks, stage, all_of_them, 4)
    await killer
    assert isinstance(outcomes[2], LinkLost)
    assert max(speeds) < 0.3, "2 s later it hovers"
    assert killed.height > 3.0
    for index in (0, 1, 3, 4):
        assert isinstance(outcomes[index], TrackFlown), outcomes[index]
        assert stage.farthest[tracks[index].name] < 0.25
        assert f"a{index + 1} is at the end of its track" in told
    assert stage.nearest > 7.0
    assert "a3 is at the end of its track" not in told


# -- leaving --------------------------------------------------------------------------------------


@asynccontextmanager
async def one_alone(
    flown: TimedTrack, **settings: float
) -> AsyncIterator[tuple[ConnectableAircraft, Aircraft]]:
    aircraft = virtual(flown, 5, **settings)
    async with ready(aircraft) as connected:
        yield aircraft, connected


async def test_whoever_is_blown_out_of_its_tube_leaves_and_lands() -> None:
    [flown] = row(1)
    told: list[str] = []
    async with one_alone(flown) as (aircraft, connected):
        clock = OwnClock(asyncio.get_running_loop().time)
        dynamics = aircraft.vehicle.flight.dynamics

        async def push() -> None:
            """A gust that no autopilot holds against."""
            await asyncio.sleep(START + 3.0 - asyncio.get_running_loop().time())
            for _ in range(20):
                dynamics.east += 0.2
                await asyncio.sleep(0.02)

        gust = asyncio.create_task(push())
        with pytest.raises(LeftShow) as caught:
            await perform(connected, flown, clock, START, told)
        await gust
        assert aircraft.vehicle.flight.phase is FlightPhase.STANDBY
    error = caught.value
    assert (error.why, error.limit) == (Why.TUBE, 1.5)
    assert 1.5 < error.measured < 2.5
    assert 3.0 < error.at < 4.0
    assert "left its track" in str(error)
    assert not any("end of its track" in text for text in told)


class Unsure:
    """A clock that may be wrong, from the beginning of the show on by more every second."""

    def __init__(self, bound: float, growing: float = 0.0) -> None:
        self._bound = bound
        self._growing = growing

    def now(self) -> float:
        return asyncio.get_running_loop().time()

    def bound(self) -> float:
        return self._bound + self._growing * max(0.0, self.now() - START)


async def test_whoever_does_not_know_the_time_any_more_leaves_and_hovers() -> None:
    [flown] = row(1)
    async with one_alone(flown) as (aircraft, connected):
        clock = Unsure(0.01, growing=0.01)
        with pytest.raises(LeftShow) as caught:
            await perform(connected, flown, clock, START, [], stop="hover")
        assert (caught.value.why, caught.value.limit) == (Why.CLOCK, 0.05)
        assert caught.value.at == pytest.approx(4.0, abs=0.03)
        await asyncio.sleep(3.0)
        assert aircraft.vehicle.flight.dynamics.speed < 0.1
        assert 4 < aircraft.height < 6


async def test_a_clock_that_says_nothing_any_more_is_not_flown_by() -> None:
    """Its time is none, too: it must not be compared with where the aircraft is."""
    [flown] = row(1)
    async with one_alone(flown) as (_, connected):

        class Silent(Unsure):
            def now(self) -> float:
                now = super().now()
                return now if now < START + 3 else -1e9

            def bound(self) -> float:
                return 0.0 if super().now() < START + 3 else math.inf

        with pytest.raises(LeftShow, match="by any amount") as caught:
            await perform(connected, flown, Silent(0.0), START, [])
        assert caught.value.why is Why.CLOCK


async def test_a_program_that_stood_still_is_out_of_its_tube_or_catches_up() -> None:
    """It hovers meanwhile; what is behind by more than the tube is not flown after."""
    flown = track("a1", (0, 0, 0, 4), (20, 40, 0, 4))
    async with one_alone(flown) as (_, connected):

        class Jumping:
            """As if the process had stood still for 2 s: its clock goes on, nothing else did."""

            def now(self) -> float:
                now = asyncio.get_running_loop().time()
                return now + (2.0 if now > START + 8 else 0.0)

            def bound(self) -> float:
                return 0.0

        with pytest.raises(LeftShow) as caught:
            await perform(connected, flown, Jumping(), START, [])
        assert caught.value.why is Why.TUBE
        assert caught.value.at == pytest.approx(10, abs=0.1)


# -- not beginning --------------------------------------------------------------------------------


@asynccontextmanager
async def in_place(flown: TimedTrack) -> AsyncIterator[tuple[ConnectableAircraft, Control]]:
    async with (
        one_alone(flown) as (aircraft, connected),
        connected.control(stop="land") as control,
    ):
        await TrackFollower(control, flown, Unsure(0.0)).take_place()
        yield aircraft, control


@pytest.mark.parametrize(
    ("bound", "is_refused"), [(0.0499, False), (0.051, True), (math.inf, True)]
)
async def test_nothing_begins_by_a_clock_that_may_be_50_ms_wrong(
    bound: float, is_refused: bool
) -> None:
    [flown] = row(1)
    async with in_place(flown) as (_, control):
        follower = TrackFollower(control, flown, Unsure(bound))
        if not is_refused:
            assert (await follower.fly(START)).bound_s == bound
            return
        sent = control.setpoints_sent
        with pytest.raises(ShowRefused) as caught:
            await follower.fly(START)
        assert caught.value.why is Why.CLOCK
        assert control.setpoints_sent == sent


async def test_nothing_begins_too_late() -> None:
    [flown] = row(1)
    async with in_place(flown) as (_, control):
        follower = TrackFollower(control, flown, Unsure(0.0))
        for start_at in (asyncio.get_running_loop().time() - 0.5, -math.inf, math.nan):
            with pytest.raises(ShowRefused) as caught:
                await follower.fly(start_at)
            assert caught.value.why is Why.LATE


async def test_nothing_begins_elsewhere() -> None:
    [flown] = row(1)
    async with in_place(flown) as (_, control):
        await control.fly_to(north=3, east=0, up=0)
        with pytest.raises(ShowRefused) as caught:
            await TrackFollower(control, flown, Unsure(0.0)).fly(START)
        assert caught.value.why is Why.PLACE
        assert caught.value.measured == pytest.approx(3, abs=0.6)


async def test_whoever_stands_elsewhere_does_not_take_off() -> None:
    flown, elsewhere = row(2, apart=5)
    async with one_alone(elsewhere) as (aircraft, connected), connected.control() as control:
        with pytest.raises(ShowRefused) as caught:
            await TrackFollower(control, flown, Unsure(0.0)).take_place()
        assert caught.value.why is Why.PLACE
        assert caught.value.measured == pytest.approx(5, abs=0.1)
        assert aircraft.height == 0
        assert not aircraft.vehicle.flight.dynamics.motors_on


# -- ground and heading ---------------------------------------------------------------------------


async def test_it_flies_at_the_heights_of_the_show_where_its_ground_is_lower() -> None:
    flown = track("a1", (0, 0, 0, 4), (8, 6, 0, 4), ground_m=-3, heading_deg=90)
    async with one_alone(flown) as (aircraft, connected):
        async with connected.control() as control:
            follower = TrackFollower(control, flown, Unsure(0.0))
            await follower.take_place()
            assert (await follower.fly(START)).farthest_m < 0.5
        assert aircraft.height == pytest.approx(7, abs=0.2)
        yaw = math.degrees(aircraft.vehicle.flight.dynamics.yaw)
        assert yaw == pytest.approx(90, abs=3)
