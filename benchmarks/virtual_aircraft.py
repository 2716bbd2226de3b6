"""What the virtual aircraft costs: ten minutes of flight, a hundred at once, an hour of memory.

    python benchmarks/virtual_aircraft.py [flight|fleet|memory]

Prints one JSON object per measurement. ``fleet`` takes real time (20 s).
"""

from __future__ import annotations

import asyncio
import json
import statistics
import sys
import time
import tracemalloc
from random import Random

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
FLIGHT_S = 600


class Listener(asyncio.Protocol):
    def __init__(self) -> None:
        self.bytes = 0

    def data_received(self, data: bytes) -> None:
        self.bytes += len(data)


def flight_of_the_core() -> float:
    """Ten minutes: movement received at 50 Hz, telemetry made at 100 Hz, no event loop."""
    settings = AircraftSettings(noise=1.0)
    autopilot = Autopilot(Vehicle(Random(1), profile("1.0"), settings=settings))
    autopilot.advance(0.0)
    autopilot.vehicle.flight.take_off()
    autopilot.advance(8.0)
    autopilot.vehicle.authority.is_requested = True
    began = time.perf_counter()
    for index in range(FLIGHT_S * 50):
        autopilot.receive_data(MOVE, 8.0 + index / 50)
        autopilot.data_to_send()
    return time.perf_counter() - began


def flight_through_the_loop() -> float:
    """The same through a virtual event loop and a cable in memory."""

    async def main() -> float:
        loop = asyncio.get_running_loop()
        driver = Driver(VirtualAircraft(seed=1, settings=AircraftSettings(noise=1.0)))
        transport = driver.connect(Listener())
        driver.start()
        driver.aircraft.vehicle.flight.take_off()
        await asyncio.sleep(8.0)
        driver.aircraft.vehicle.authority.is_requested = True
        left = FLIGHT_S * 50

        def send() -> None:
            nonlocal left
            transport.write(MOVE)
            left -= 1
            if left:
                loop.call_later(0.02, send)

        began = time.perf_counter()
        send()
        await asyncio.sleep(FLIGHT_S)
        elapsed = time.perf_counter() - began
        driver.stop()
        return elapsed

    with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
        return runner.run(main())


async def fleet(count: int = 100, seconds: float = 20.0) -> dict[str, float]:
    """Aircraft in the air at default rates, in real time: share of a core, lateness."""
    loop = asyncio.get_running_loop()
    drivers = [Driver(VirtualAircraft(seed=seed)) for seed in range(count)]
    for driver in drivers:
        driver.connect(Listener())
        driver.start()
        driver.aircraft.vehicle.flight.take_off()
        await asyncio.sleep(0.01 / count)  # real aircraft are not switched on together
    await asyncio.sleep(1.0)
    flown = [driver.aircraft.vehicle.time for driver in drivers]
    began, used = loop.time(), time.process_time()
    late = []
    while loop.time() - began < seconds:
        due = loop.time() + 0.05
        await asyncio.sleep(0.05)
        late.append(loop.time() - due)
    elapsed, used = loop.time() - began, time.process_time() - used
    flown = [d.aircraft.vehicle.time - t for d, t in zip(drivers, flown, strict=True)]
    for driver in drivers:
        driver.stop()
    late.sort()
    return {
        "aircraft": count,
        "core_percent": round(100 * used / elapsed, 1),
        "slowest_flew_percent_of_real_time": round(100 * min(flown) / elapsed, 2),
        "late_ms_p99": round(1000 * late[int(0.99 * len(late))], 2),
    }


def memory() -> dict[str, float]:
    """A simulated hour with a listener: what is allocated after five minutes and at the end."""

    async def main() -> dict[str, float]:
        driver = Driver(VirtualAircraft(seed=1))
        driver.connect(Listener())
        await asyncio.sleep(300.0)
        tracemalloc.start()
        await asyncio.sleep(1.0)
        before, _ = tracemalloc.get_traced_memory()
        await asyncio.sleep(3600.0)
        after, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        driver.stop()
        return {"grown_kb_in_an_hour": (after - before) / 1000, "peak_kb": peak / 1000}

    with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
        return runner.run(main())


def show(name: str, result: object) -> None:
    print(json.dumps({"benchmark": name, "result": result}))


def main() -> None:
    wanted = sys.argv[1:] or ["flight", "fleet", "memory"]
    if "flight" in wanted:
        for flight in (flight_of_the_core, flight_through_the_loop):
            times = sorted(flight() for _ in range(5))
            show(
                flight.__name__,
                {"median_s": round(statistics.median(times), 3), "worst_s": round(times[-1], 3)},
            )
    if "fleet" in wanted:
        show("fleet", asyncio.run(fleet()))
    if "memory" in wanted:
        show("memory", memory())


if __name__ == "__main__":
    main()
