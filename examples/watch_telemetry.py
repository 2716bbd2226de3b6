"""Print attitude and height twice a second, for five seconds. Sends nothing that moves anything.

python examples/watch_telemetry.py                    # a virtual aircraft inside this program
python examples/watch_telemetry.py /dev/ttyUSB0       # another one, or a real one
"""

import asyncio
import contextlib
import sys

import m100link
from m100link import Attitude, Position


async def main(url: str) -> None:
    async with m100link.connect(url) as aircraft:
        print(f"firmware {aircraft.firmware}")
        # Packages with both items only; the newest one is kept, at most two a second.
        async with aircraft.telemetry(Attitude, Position, rate_hz=2) as samples:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(5):
                    async for sample in samples:
                        attitude, position = sample[Attitude], sample[Position]
                        print(f"yaw {attitude.yaw_deg:6.1f}°  height {position.height_m:5.2f} m")
        print(f"battery: {aircraft.state.battery or 'not received yet'}")


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1] if len(sys.argv) > 1 else "sim://"))
