"""Two consumers of telemetry at their own rates: neither delays the other, nor the line.

One prints the newest height twice a second; what it does not see does not matter to it. The other
takes every package at 100 Hz, to find the largest acceleration, and is slow now and then.

python examples/two_consumers.py                      # a virtual aircraft inside this program
python examples/two_consumers.py /dev/ttyUSB0         # another one, or a real one
"""

import asyncio
import contextlib
import math
import sys

import m100link
from m100link import Acceleration, Aircraft, Latest, Lossless, Position

SECONDS = 5


async def print_height(aircraft: Aircraft) -> None:
    async with aircraft.telemetry(Position, policy=Latest(), rate_hz=2) as samples:
        async for sample in samples:
            print(f"height {sample[Position].height_m:5.2f} m")


async def find_peak(aircraft: Aircraft) -> None:
    count, peak = 0, 0.0
    # Acceleration is known once the aircraft has stood still for a second.
    async with aircraft.telemetry(Acceleration, policy=Lossless(1000)) as samples:
        try:
            async for sample in samples:
                count += 1
                peak = max(peak, math.hypot(*sample[Acceleration]))
                if count % 200 == 0:
                    await asyncio.sleep(0.5)  # it may: 1000 packages can wait for it
        finally:
            print(f"{count} packages, {samples.dropped} lost, peak {peak:.2f} m/s²")


async def main(url: str) -> None:
    async with m100link.connect(url) as aircraft:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(SECONDS), asyncio.TaskGroup() as group:
                group.create_task(print_height(aircraft))
                group.create_task(find_peak(aircraft))


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1] if len(sys.argv) > 1 else "sim://"))
