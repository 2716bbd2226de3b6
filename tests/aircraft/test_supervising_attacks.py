"""Lines that do whatever chance makes of them, and programs that end at any moment."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from random import Random

import pytest

import m100link
from m100link import (
    Aircraft,
    AuthorityState,
    BackOff,
    Gap,
    LinkError,
    M100Error,
    Position,
    Sample,
    Setpoint,
    Supervised,
    SupervisionState,
)
from m100link.errors import PortBusy
from m100link.sim import LineFaults
from m100link.testing import ConnectableAircraft
from tests.aircraft.test_supervising import APP, Cable, anyio_backend, supervised, until, virtual

__all__ = ["anyio_backend"]

pytestmark = pytest.mark.anyio

QUICK = BackOff(first=0.5, most=2.0)
NORTH = Setpoint.velocity(north=1.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


async def test_a_stream_does_not_go_round_over_a_line_that_nobody_has_noticed_to_be_gone() -> None:
    async with supervised(Cable(virtual())) as one:
        first = await one.connected()
        got: list[Sample | Gap] = []

        async def consume() -> None:
            async for sample in one.telemetry(Position):
                got.append(sample)
                if len(got) > 1000:
                    return

        consumer = asyncio.create_task(consume())
        await asyncio.sleep(1.0)
        await first.link.close()
        await until(lambda: one.aircraft not in (None, first))
        await asyncio.sleep(1.0)
        assert not consumer.done()
        assert sum(isinstance(item, Gap) for item in got) == 1
    await consumer


class Chance:
    """What may happen to an aircraft, its line and its phone."""

    def __init__(self, end: ConnectableAircraft, random: Random) -> None:
        self.end, self._random = end, random

    def strike(self) -> None:
        """One of them."""
        faults = LineFaults(
            loss=0.6 * self._random.random(), damage=0.3 * self._random.random(), duplicate=0.2
        )
        strikes: list[Callable[[], object]] = [
            self.end.unplug,
            self.end.stall_line,
            self.end.reboot,
            self._switch_off,
            self.end.disconnect_app,
            lambda: self.end.set_faults(faults),
        ]
        self._random.choice(strikes)()

    def _switch_off(self) -> None:
        self.end.reboot()
        self.end.vehicle.activation.active = None

    def mend(self) -> None:
        """All of it."""
        self.end.stall_line(False)
        if not self.end.line.is_plugged:
            self.end.replug()
        self.end.connect_app(internet=True)
        self.end.set_faults()


async def _fly(one: Supervised) -> None:
    """As a program does that does not think of losses."""
    aircraft = await one.connected()
    async with aircraft.control() as control:
        await control.take_off()
        while True:
            control.send(NORTH)
            await asyncio.sleep(0.05)


async def _live(one: Supervised, chance: Chance, random: Random) -> None:
    """Thirty strikes; somebody flies whenever it is possible."""
    flight: asyncio.Task[None] | None = None
    for _ in range(30):
        chance.strike()
        if flight is None or flight.done():
            assert flight is None or isinstance(flight.exception(), M100Error)
            flight = asyncio.create_task(_fly(one))
        await asyncio.sleep(random.random() * random.choice([0.01, 0.3, 3.0, 10.0]))
        if random.random() < 0.6:
            chance.mend()
    chance.mend()
    assert flight is not None
    flight.cancel()
    await asyncio.wait([flight])


@pytest.mark.parametrize("seed", range(8))
async def test_whatever_happens_it_comes_back_nothing_flies_on_and_nothing_is_left(
    seed: int,
) -> None:
    random = Random(seed)
    end = ConnectableAircraft(seed=seed, firmware=random.choice(["1.0", "2.3", "3.1"]))
    cable, opened = Cable(end), list[Aircraft]()

    async def open_it() -> Aircraft:
        opened.append(await cable.open())
        return opened[-1]

    before = asyncio.all_tasks()
    got: list[Sample | Gap] = []
    async with Supervised(open_it, credentials=APP, back_off=QUICK, random=random) as one:

        async def consume() -> None:
            async for sample in one.telemetry(Position, rate_hz=10.0):
                got.append(sample)

        consumer = asyncio.create_task(consume())
        await _live(one, Chance(end, random), random)
        async with asyncio.timeout(60.0):
            aircraft = await one.connected()
        end.autopilot.received_movements.clear()
        await asyncio.sleep(10.0)
        assert not end.autopilot.received_movements
        assert aircraft.authority.state is not AuthorityState.HELD
        assert sum(one.is_connected for one in opened) <= 1
    await consumer
    assert not any(one.is_connected for one in opened)
    gaps = sum(isinstance(item, Gap) for item in got)
    assert gaps <= len(opened)
    end.stop()
    await asyncio.sleep(5.0)
    assert asyncio.all_tasks() == before


async def test_a_program_that_is_cancelled_at_any_moment_leaves_nothing() -> None:
    """At each pass of the loop, from the first on until it would be connected, and in between."""
    for passes in range(120):
        end = virtual()
        cable, opened = Cable(end), list[Aircraft]()

        async def open_it(cable: Cable = cable, opened: list[Aircraft] = opened) -> Aircraft:
            opened.append(await cable.open())
            return opened[-1]

        async def run(open_it: object = open_it) -> None:
            assert callable(open_it)
            async with Supervised(
                open_it, credentials=APP, back_off=QUICK, random=Random(1)
            ) as one:
                await one.connected()

        before = asyncio.all_tasks()
        program = asyncio.create_task(run())
        for _ in range(passes):
            await asyncio.sleep(0)
        program.cancel()
        await asyncio.wait([program])
        assert program.cancelled()
        end.stop()
        await asyncio.sleep(3.0)
        assert asyncio.all_tasks() == before
        assert not any(one.is_connected for one in opened)


async def test_a_task_cancelled_while_it_closes_is_cancelled_and_it_closes_all_the_same() -> None:
    end = virtual()
    one = supervised(Cable(end))
    await one.__aenter__()
    aircraft = await one.connected()
    closing = asyncio.create_task(one.aclose())
    await asyncio.sleep(0)
    closing.cancel()
    await asyncio.wait([closing])
    assert closing.cancelled()
    await asyncio.sleep(2.0)
    assert not aircraft.is_connected
    assert one.state is SupervisionState.CLOSED


async def test_of_two_on_one_port_the_second_waits_until_the_first_has_gone() -> None:
    end, owner = virtual(), list[Aircraft]()

    async def open_port() -> Aircraft:
        if owner and owner[-1].is_connected:
            raise PortBusy("the port is in use", owners=())
        owner.append(await m100link.connect(await end.open_link()))
        return owner[-1]

    def kept() -> Supervised:
        return Supervised(open_port, credentials=APP, back_off=QUICK, random=Random(2))

    async with kept() as first:
        await first.connected()
        async with kept() as second:
            await asyncio.sleep(60.0)
            assert (first.state, second.state) == (
                SupervisionState.CONNECTED,
                SupervisionState.WAITING,
            )
            assert isinstance(second.error, PortBusy)
            await first.aclose()
            async with asyncio.timeout(3.0):
                await second.connected()


async def test_an_open_line_of_which_the_end_is_reported_late_is_nobodys() -> None:
    async with supervised(Cable(virtual())) as one:
        first = await one.connected()
        first.link.connection_lost(OSError("unplugged"))
        async with asyncio.timeout(10.0):
            assert await one.connected() is not first
        assert isinstance(first.link.failure, LinkError)
