"""Flights cut off at random instants: whatever ends a program, the aircraft hovers and is released.

Cancellation, an exception, a signal, the end of the line, the loss of authority, one to three of
them a flight, between any two turns of the event loop.
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from functools import partial
from math import dist
from random import Random

import pytest

from m100link import (
    AuthorityState,
    LinkError,
    M100Error,
    NoAuthority,
    Position,
    Target,
    TaskRefused,
    Waypoint,
    WaypointPlan,
)
from m100link.geodesy import LocalFrame
from m100link.sim import LineFaults
from tests.flight.test_signals import acted, come
from tests.rig import FIRMWARES, NORTH, Rig, rig

__all__ = ["acted"]  # a fixture

pytestmark = pytest.mark.anyio

SEEDS = range(60)
PATIENCE = 120.0
"""Virtual seconds in which any of these programs has ended once it was cancelled."""


class Crash(Exception):
    """What a part of a program raises."""


# -- programs --------------------------------------------------------------------------------------


async def in_a_loop(flown: Rig) -> None:
    async with flown.aircraft.control() as control:
        await flown.fly_on(control)


async def in_a_loop_that_lands(flown: Rig) -> None:
    async with flown.aircraft.control(stop="land") as control:
        await flown.fly_on(control)


async def by_holding(flown: Rig) -> None:
    async with flown.aircraft.control() as control, control.hold(NORTH, lifetime=1.0) as hold:
        while True:
            await asyncio.sleep(0.5)
            hold.set(NORTH)


async def to_a_place(flown: Rig) -> None:
    async with flown.aircraft.control() as control:
        await control.fly_to(north=100.0, east=0.0, up=0.0)


async def by_one_long_setpoint(flown: Rig) -> None:
    async with flown.aircraft.control() as control:
        control.send(NORTH, lifetime=30.0, allow_long_lifetime=True, rate_hz=2.0)
        await asyncio.sleep(20.0)


async def in_a_task_beside(flown: Rig) -> None:
    async with flown.aircraft.control() as control:
        beside = asyncio.create_task(flown.fly_on(control))
        try:
            await asyncio.sleep(3.0)
        finally:
            beside.cancel()
            with contextlib.suppress(asyncio.CancelledError, M100Error):
                await beside


async def around_a_group(flown: Rig) -> None:
    async with flown.aircraft.control() as control, asyncio.TaskGroup() as group:
        group.create_task(flown.fly_on(control))
        group.create_task(asyncio.sleep(50.0))


async def under_a_time_out(flown: Rig) -> None:
    async with flown.aircraft.control() as control, asyncio.timeout(0.7):
        await flown.fly_on(control)


async def resuming(flown: Rig) -> None:
    async with flown.aircraft.control(on_pause="wait") as control:
        while True:
            try:
                await flown.fly_on(control)
            except NoAuthority:
                await control.wait_resumable()
                control.resume()


async def in_a_generator_that_breaks(flown: Rig) -> None:
    async def legs() -> AsyncIterator[int]:
        async with flown.aircraft.control() as control:
            for leg in range(100):
                control.send(NORTH, lifetime=1.0)
                await asyncio.sleep(0.1)
                yield leg

    async for leg in legs():
        if leg > 6:
            break
    await asyncio.sleep(2.0)


async def block_after_block(flown: Rig) -> None:
    for _ in range(4):
        try:
            async with flown.aircraft.control() as control:
                await flown.fly(control, 0.4)
        except M100Error:
            await asyncio.sleep(0.05)


# -- programs whose aircraft flies by itself -------------------------------------------------------


async def up_and_down(flown: Rig) -> None:
    async with flown.aircraft.control() as control:
        for _ in range(5):
            await control.land()
            await control.take_off()


async def home(flown: Rig) -> None:
    async with flown.aircraft.control() as control:
        await control.fly_to(north=15.0, east=3.0, up=3.0)
        await control.go_home()


async def around_a_place(flown: Rig) -> None:
    async with flown.aircraft.control() as control:
        await control.orbit(center_north=5.0, center_east=0.0, turns=4.0)


async def along_a_path(flown: Rig) -> None:
    async with flown.aircraft.control() as control:
        await control.fly_path([(5, 0, 3), (5, 5, 4), (0, 5, 3), (30, 30, 3)], speed=4.0)


def place(flown: Rig, north: float) -> tuple[float, float]:
    here = flown.aircraft.state.get(Position)
    assert here is not None
    return LocalFrame(here.latitude_deg, here.longitude_deg).to_geodetic(north, 0.0)


async def by_waypoints(flown: Rig) -> None:
    points = [Waypoint(*place(flown, north), height=8.0) for north in (8.0, 25.0, 200.0)]
    async with flown.aircraft.control() as control:
        async with control.waypoint_mission(WaypointPlan(points, speed=4.0)) as mission:
            async for _ in mission:
                pass


async def around_a_hotpoint(flown: Rig) -> None:
    async with flown.aircraft.control() as control:
        await control.climb_to(7.0)
        latitude_deg, longitude_deg = place(flown, 6.0)
        async with control.hotpoint(
            latitude_deg=latitude_deg,
            longitude_deg=longitude_deg,
            height=7.0,
            radius=6.0,
            rate_deg_s=10.0,
        ) as mission:
            async for _ in mission:
                pass


async def behind_a_target(flown: Rig) -> None:
    async with flown.aircraft.control() as control:
        await control.climb_to(7.0)
        targets = [Target(*place(flown, 6.0 + ahead)) for ahead in range(60)]
        async with control.follow_target(targets[0]) as mission:
            for target in targets:
                await asyncio.sleep(0.5)
                mission.set_target(target)


async def under_time_outs(flown: Rig) -> None:
    async with flown.aircraft.control() as control:
        fly_to = partial(control.fly_to, north=10.0, east=0.0, up=2.0)
        for turn in range(40):
            do = (control.land, control.take_off, fly_to, control.go_home)
            with contextlib.suppress(TimeoutError, TaskRefused):
                async with asyncio.timeout(0.05 + 0.07 * turn):
                    await do[turn % 4]()
            await asyncio.sleep(0.3)


BY_ITSELF: list[Callable[[Rig], Awaitable[None]]] = [
    up_and_down,
    home,
    around_a_place,
    along_a_path,
    by_waypoints,
    around_a_hotpoint,
    behind_a_target,
    under_time_outs,
]

PROGRAMS: list[Callable[[Rig], Awaitable[None]]] = [
    in_a_loop,
    in_a_loop_that_lands,
    by_holding,
    to_a_place,
    by_one_long_setpoint,
    in_a_task_beside,
    around_a_group,
    under_a_time_out,
    resuming,
    in_a_generator_that_breaks,
    block_after_block,
]


# -- what ends them --------------------------------------------------------------------------------


class Cuts:
    """What happens to one flight.

    Attributes:
        log: What happened, with its time.
        is_line_bad: Whether frames were lost or the line ended: a release may not have arrived.
    """

    def __init__(
        self, flown: Rig, seed: int, programs: Sequence[Callable[[Rig], Awaitable[None]]] = PROGRAMS
    ) -> None:
        self.flown = flown
        self.random = Random(seed)
        self.log: list[str] = []
        self.is_line_bad = False
        self.closing: asyncio.Task[None] | None = None
        self._others = asyncio.all_tasks()
        self._crash = asyncio.Event()
        program = self.random.choice(programs)
        self.log.append(program.__name__)
        self.task = asyncio.create_task(self._fly(program))

    async def _fly(self, program: Callable[[Rig], Awaitable[None]]) -> None:
        """The program beside a part that may raise."""
        async with asyncio.TaskGroup() as group:
            beside = group.create_task(self._crash_when_told())
            await program(self.flown)
            beside.cancel()

    async def _crash_when_told(self) -> None:
        await self._crash.wait()
        raise Crash

    def cancel(self) -> None:
        self.task.cancel()

    def crash(self) -> None:
        self._crash.set()

    def interrupt(self) -> None:
        self._signal(signal.SIGINT)

    def terminate(self) -> None:
        self._signal(signal.SIGTERM)

    def _signal(self, number: signal.Signals) -> None:
        """Where no block flies it is nobody's but the process's, which is not what is tested."""
        if signal.getsignal(number) not in (signal.SIG_DFL, signal.default_int_handler):
            come(number)

    def cancel_everything(self) -> None:
        """As asyncio.run() does with what is left."""
        for task in asyncio.all_tasks() - self._others:
            task.cancel()

    def cancel_the_sending(self) -> None:
        for task in asyncio.all_tasks():
            if task.get_name() == "m100link setpoints":
                task.cancel()

    def close(self) -> None:
        if self.closing is None:
            self.closing = asyncio.create_task(self.flown.aircraft.aclose())

    def unplug(self) -> None:
        self.is_line_bad = True
        self.flown.virtual.unplug()

    def lose_frames(self) -> None:
        self.is_line_bad = True
        loss = self.random.choice([0.3, 1.0])
        self.flown.virtual.set_faults(LineFaults(loss=loss))

    def find_frames(self) -> None:
        self.flown.virtual.set_faults()

    def leave_f(self) -> None:
        self.flown.virtual.leave_f()

    def return_to_f(self) -> None:
        self.flown.virtual.return_to_f()

    def app_takes_control(self) -> None:
        self.flown.virtual.app_takes_control()

    async def happen(self) -> None:
        random = self.random
        kinds = [
            *(self.cancel, self.cancel, self.crash, self.interrupt, self.terminate),
            *(self.cancel_everything, self.cancel_the_sending, self.close, self.unplug),
            *(self.lose_frames, self.find_frames, self.leave_f, self.return_to_f),
            self.app_takes_control,
        ]
        for _ in range(random.randint(1, 3)):
            await asyncio.sleep(random.choice([0.0, 0.005, 0.02, 0.05, 0.1, 0.3, 0.31, 0.5, 1.0]))
            for _ in range(random.randrange(25)):
                await asyncio.sleep(0)
            kind = random.choice(kinds)
            self.log.append(f"{self.flown.now:.3f} {kind.__name__}")
            kind()
        await asyncio.sleep(random.choice([0.0, 0.5]))

    async def end(self) -> None:
        """Whatever goes on yet is cancelled, and the line works again, if there is one."""
        self.task.cancel()
        self.find_frames()
        ending = [task for task in (self.task, self.closing) if task is not None]
        _, unended = await asyncio.wait(ending, timeout=PATIENCE)
        assert not unended


async def assert_left_in_order(flown: Rig, cuts: Cuts) -> None:
    """It hovers, nothing moves it any more, and it was given back or says that it was not."""
    await asyncio.sleep(1.3)  # the lifetime of what a generator sent
    count = len(flown.moves)
    flown.virtual.app_releases_control()
    flown.virtual.return_to_f()
    await asyncio.sleep(4.0)
    assert flown.speed < 0.1
    assert len(flown.moves) == count, "setpoints went on"
    if not flown.is_released:
        assert cuts.is_line_bad
        assert flown.aircraft.authority.state in (AuthorityState.UNRELEASED, AuthorityState.LOST)
    if cuts.closing is None and flown.aircraft.is_connected:
        async with flown.aircraft.control():
            pass


@pytest.mark.parametrize("seed", SEEDS)
async def test_a_flight_cut_off_at_random(seed: int, acted: list[signal.Signals]) -> None:
    async with rig(firmware=FIRMWARES[seed % len(FIRMWARES)]) as flown:
        async with flown.aircraft.control() as control:
            await control.take_off()
        flown.moves.clear()
        cuts = Cuts(flown, seed)
        try:
            await cuts.happen()
            await cuts.end()
            await assert_left_in_order(flown, cuts)
        except BaseException:
            print("\n".join(cuts.log))  # noqa: T201 (pytest shows it when the test fails)
            raise
        with contextlib.suppress(LinkError):
            await flown.aircraft.aclose()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(32))
async def test_a_flight_by_itself_cut_off_at_random(seed: int, acted: list[signal.Signals]) -> None:
    """A task, a closed loop or a mission: it hovers or stands wherever that ends."""
    async with rig(firmware="3.1") as flown:
        async with flown.aircraft.control() as control:
            await control.take_off()
        cuts = Cuts(flown, seed, BY_ITSELF)
        try:
            await asyncio.sleep(cuts.random.choice([0.0, 0.5, 2.0, 5.0, 9.0, 14.0]))
            await cuts.happen()
            await cuts.end()
            flown.virtual.app_releases_control()
            flown.virtual.return_to_f()
            await asyncio.sleep(8.0)
            count, place, height = len(flown.moves), flown.virtual.position, flown.virtual.height
            await asyncio.sleep(3.0)
            assert dist((*flown.virtual.position, flown.virtual.height), (*place, height)) < 0.3
            assert len(flown.moves) == count, "setpoints went on"
            assert flown.is_released or cuts.is_line_bad
        except BaseException:
            print("\n".join(cuts.log))  # noqa: T201 (pytest shows it when the test fails)
            raise
        with contextlib.suppress(LinkError):
            await flown.aircraft.aclose()
