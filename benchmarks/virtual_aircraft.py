"""What the virtual aircraft costs: ten minutes of flight, a hundred at once, an hour of memory.

    python -m benchmarks.virtual_aircraft [ROW …] [--rounds 5] [--json] [--beside TREE]

Ten simulated minutes are flown three times: by the aircraft alone, which receives movement at 50 Hz
and makes telemetry at 100 Hz without an event loop; with a host at the other end of a cable in
memory, whose program takes every package by ``async for``, on virtual time; and with a host that
sends movement and listens to nothing. What a test pays is ten minutes of a program that flies a
closed loop of its own over ``ticks()``, beside one that is connected and waits. A hundred aircraft
are in the air in real time, for the share of a CPU. Memory is what an hour on virtual time adds, by
tracemalloc, measured once.
"""

from __future__ import annotations

import asyncio
import time
import tracemalloc
from collections.abc import Awaitable, Callable, Iterable
from contextlib import ExitStack
from functools import cache
from random import Random

import m100link
from benchmarks.program import main
from benchmarks.rows import Program, Row, Setting, Side, at_most, ratio, times
from m100link.link import Link
from m100link.protocol import profile
from m100link.sim import (
    AircraftSettings,
    Autopilot,
    Driver,
    Vehicle,
    VirtualAircraft,
    VirtualClockEventLoop,
)
from m100link.wire import encode_frame

MOVE = encode_frame(bytes.fromhex("010348" + "0000803f" + 12 * "00"), session=0, sequence=1)
DEMO = m100link.Credentials(app_id=10086, key=bytes(range(32)))
FLIGHT_S = 600
MANY = 100
ALONE, HOST = "ten minutes, aircraft alone", "ten minutes, with host and async for"
FLOWN, IDLE = "ten minutes, flown by a program's loop", "ten minutes, connected and waiting"
CABLE = "ten minutes, steered over a cable in memory"
REAL = f"{MANY} aircraft in real time, share of a CPU"
MEMORY = "memory that a simulated hour adds, kB"


class Listener(asyncio.Protocol):
    """The end of a cable at which nobody reads."""


def on_virtual_time(run: Callable[[], Awaitable[float]]) -> float:
    """Run to the end on an event loop whose time jumps."""

    async def whole() -> float:
        return await run()

    with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
        return runner.run(whole())


def alone(seconds: int) -> float:
    """CPU time: movement received at 50 Hz, telemetry made at 100 Hz, no event loop."""
    settings = AircraftSettings(noise=1.0)
    autopilot = Autopilot(Vehicle(Random(1), profile("1.0"), settings=settings))
    autopilot.advance(0.0)
    autopilot.vehicle.flight.take_off()
    autopilot.advance(8.0)
    autopilot.vehicle.authority.is_requested = True
    began = time.thread_time()
    for index in range(seconds * 50):
        autopilot.receive_data(MOVE, 8.0 + index / 50)
        autopilot.data_to_send()
    return time.thread_time() - began


async def with_host(seconds: int) -> float:
    """CPU time of both ends, with a program that takes every package."""
    driver = Driver(VirtualAircraft(seed=1))
    link = Link()
    driver.connect(link)
    driver.start()
    await link.wait_connected()
    async with m100link.connect(link) as aircraft, aircraft.telemetry() as samples:
        began = time.thread_time()
        end = asyncio.get_running_loop().time() + seconds
        async for sample in samples:
            if sample.received_at >= end:
                break
        spent = time.thread_time() - began
    driver.stop()
    return spent


async def waiting(seconds: int) -> float:
    """CPU time of both ends, with a program that is connected, activated, and waits."""
    async with m100link.connect("sim://?seed=1") as aircraft:
        await aircraft.activate(DEMO)
        began = time.thread_time()
        await asyncio.sleep(seconds)
        return time.thread_time() - began


async def flown(seconds: int) -> float:
    """CPU time of both ends, with a program that steers by position at 50 Hz, to and fro."""
    async with m100link.connect("sim://?seed=1") as aircraft:
        await aircraft.activate(DEMO)
        async with aircraft.control() as control:
            await control.take_off()
            home = control.local_frame()
            began = time.thread_time()
            async for tick in control.ticks(rate_hz=50):
                if tick.elapsed >= seconds:
                    break
                position = aircraft.state.position
                assert position is not None
                north, east = home.to_local(position.latitude_deg, position.longitude_deg)
                away = 20.0 * (int(tick.elapsed) // 10 % 2) - north
                control.send(
                    m100link.Setpoint.velocity(
                        north=max(-5.0, min(5.0, 0.5 * away)),
                        east=max(-5.0, min(5.0, -0.5 * east)),
                        up=0.0,
                        yaw_rate_deg_s=0.0,
                    )
                )
            spent = time.thread_time() - began
    return spent


async def over_cable(seconds: int) -> float:
    """CPU time, with movement sent at 50 Hz by a timer."""
    loop = asyncio.get_running_loop()
    driver = Driver(VirtualAircraft(seed=1, settings=AircraftSettings(noise=1.0)))
    transport = driver.connect(Listener())
    driver.start()
    driver.aircraft.vehicle.flight.take_off()
    await asyncio.sleep(8.0)
    driver.aircraft.vehicle.authority.is_requested = True
    left = seconds * 50

    def send() -> None:
        nonlocal left
        transport.write(MOVE)
        left -= 1
        if left:
            loop.call_later(0.02, send)

    began = time.thread_time()
    send()
    await asyncio.sleep(seconds)
    spent = time.thread_time() - began
    driver.stop()
    return spent


async def in_real_time(number: int, seconds: float) -> float:
    """Share of a CPU that aircraft in the air at default rates take."""
    drivers = [Driver(VirtualAircraft(seed=seed)) for seed in range(number)]
    for driver in drivers:
        driver.connect(Listener())
        driver.start()
        driver.aircraft.vehicle.flight.take_off()
        await asyncio.sleep(0.01 / number)  # real aircraft are not switched on together
    began, used = time.perf_counter(), time.thread_time()
    await asyncio.sleep(seconds)
    share = (time.thread_time() - used) / (time.perf_counter() - began)
    for driver in drivers:
        driver.stop()
    return share


async def memory(minutes: int) -> float:
    """Kilobytes that so many minutes add, after a twelfth of them that is not counted."""
    driver = Driver(VirtualAircraft(seed=1))
    driver.connect(Listener())
    await asyncio.sleep(5.0 * minutes)
    tracemalloc.start()
    await asyncio.sleep(1.0)
    before, _ = tracemalloc.get_traced_memory()
    await asyncio.sleep(60.0 * minutes)
    after, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    driver.stop()
    return (after - before) / 1000


def ours(setting: Setting, stack: ExitStack) -> Iterable[Side]:
    """Flights, a crowd, an hour."""
    flight, minutes = setting.count(FLIGHT_S), max(1, setting.count(60))
    number, seconds = setting.count(MANY), setting.seconds(4.0)
    measured_once = cache(lambda: on_virtual_time(lambda: memory(minutes)))
    yield Side(ALONE, lambda: alone(flight))
    yield Side(HOST, lambda: on_virtual_time(lambda: with_host(flight)))
    yield Side(IDLE, lambda: on_virtual_time(lambda: waiting(flight)))
    yield Side(FLOWN, lambda: on_virtual_time(lambda: flown(flight)))
    yield Side(CABLE, lambda: on_virtual_time(lambda: over_cable(flight)))
    yield Side(REAL, lambda: asyncio.run(in_real_time(number, seconds)), is_time=False)
    yield Side(MEMORY, measured_once, is_time=False)


PROGRAM = Program(
    name="virtual_aircraft",
    rows=(
        Row("ten simulated minutes, aircraft alone, CPU", times(ALONE, 1.0), at_most(0.8), "s"),
        Row("the same with host and async for, CPU", times(HOST, 1.0), at_most(1.5), "s"),
        Row("ten simulated minutes flown at 50 Hz ÷ waited through", ratio(FLOWN, IDLE)),
        Row("the same by a timer, without the library ÷ waited through", ratio(CABLE, IDLE)),
    ),
    ours=ours,
    rounds=5,
)

if __name__ == "__main__":
    main(PROGRAM)
