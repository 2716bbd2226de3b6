"""Fly again what was recorded: look for the highest place, as fast as the file is read.

A short flight is recorded first, and replayed: nothing flies then, and an order is refused with
nothing sent. Needs the extra ``log``.

python examples/replay_a_flight.py                      # a virtual aircraft
python examples/replay_a_flight.py /dev/ttyUSB0         # a real one: it takes off
python examples/replay_a_flight.py replay://flight.mcap # what was recorded before
"""

import asyncio
import sys
import tempfile
from pathlib import Path

import m100link
from m100link import Lossless, Position
from m100link.sim import DEMO_APP_ID, DEMO_KEY


async def fly(url: str, path: Path) -> None:
    """Up to five metres and down again, recorded."""
    async with m100link.connect(url, record=path) as aircraft:
        await aircraft.activate(m100link.Credentials(app_id=DEMO_APP_ID, key=DEMO_KEY))
        async with aircraft.control(stop="land") as control:
            await control.take_off()
            await control.fly_to(north=0.0, east=0.0, up=5.0)
            await control.land()


async def look_again(path: Path) -> None:
    """The same program as for a flight; only the URL says that it is a recording."""
    highest, at, count = 0.0, 0.0, 0
    async with m100link.connect(f"replay://{path}?speed=max") as aircraft:
        began = aircraft.link.clock()
        try:
            async for sample in aircraft.telemetry(Position, policy=Lossless(1000)):
                count += 1
                height = sample[Position].height_m
                if height > highest:
                    highest, at = height, sample.received_at - began
        except m100link.ReplayEnded as end:
            print(end.seen)
    print(f"highest: {highest:.1f} m, {at:.1f} s after its beginning, of {count} packages")

    async with m100link.connect(f"replay://{path}?from={at:.2f}") as aircraft:
        try:
            await aircraft.control().__aenter__()
        except m100link.OnlyRecorded as refused:
            print(refused.seen)


async def main(url: str) -> None:
    if url.startswith("replay://"):
        await look_again(Path(url.removeprefix("replay://")))
        return
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight.mcap"
        await fly(url, path)
        await look_again(path)


if __name__ == "__main__":
    asyncio.run(main(*(sys.argv[1:] or ["sim://"])))
