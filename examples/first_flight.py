"""Take off, fly two metres north, land.

python examples/first_flight.py                       # a virtual aircraft inside this program
python examples/first_flight.py /dev/ttyUSB0          # another one, or a real one
"""

import asyncio
import sys

import m100link
from m100link import Credentials, Setpoint

# The app id and key of the virtual aircraft. A real aircraft needs those of your own app.
CREDENTIALS = Credentials(app_id=10086, key=bytes(range(32)))


async def main(url: str) -> None:
    async with m100link.connect(url) as aircraft:
        print((await aircraft.version()).name)
        await aircraft.activate(CREDENTIALS)
        async with aircraft.control(stop="land") as control:
            await control.take_off()
            await control.climb_to(4.0)
            print("in the air")
            async for tick in control.ticks(rate_hz=50):
                if tick.elapsed >= 2.0:
                    break
                control.send(Setpoint.velocity(north=1.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0))
            await control.stop()
            await control.land()
            print("landed")


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1] if len(sys.argv) > 1 else "sim://"))
