"""Measure a line for two seconds: damage, repeats, how long answers take. Nothing moves.

python examples/line_quality.py                       # a virtual aircraft with a noisy line
python examples/line_quality.py /dev/ttyUSB0          # a real one
"""

import asyncio
import sys

import m100link
from m100link import AckTimeout, Position

NOISY = "sim://?damage=0.1&seed=7"


async def main(url: str = NOISY) -> None:
    async with m100link.connect(url) as aircraft:
        for _ in range(40):
            try:
                await aircraft.version()
            except AckTimeout:
                print("a question without an answer")
            await asyncio.sleep(0.05)
        counted = aircraft.statistics()
        rate = aircraft.state.statistics(Position).rate_hz
        print(f"{counted.frames_received} frames, position at {rate or 0.0:.0f} Hz")
        for cause, count in counted.discards.items():
            print(f"damaged, {cause}: {count}")
        trips = counted.round_trips
        print(f"{trips.count} answers after {1000 * (trips.mean_s or 0.0):.1f} ms on average")
        print(f"95 % of them within {1000 * (trips.within_s(0.95) or 0.0):g} ms")
        print(f"{counted.repeats} questions were asked again, {counted.late_acks} acks were late")


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
